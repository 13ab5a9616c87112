"""A plan in words: how each stage is made, what asks for it, what is lost without it."""

from phytac_design.study.planning.counts import Counts
from phytac_design.study.planning.resolve import STAGES_OF, Resolved

LOST = {
    "views": "no pictures; nothing is known of what the camera sees",
    "switch": "no switch files",
    "compare": "no comparison with straight rows",
    "underload": "what hides or fuses under load is not known",
    "resolution": "the least possible error of a force is not known",
    "shell": "no STL, no 3MF",
    "step": "no STEP",
    "hardware": "no camera mount, cover, bar or connector",
    "mold": "no molds",
    "kit": "no calibration kit",
    "printing": "print rules are not checked",
    "bench": "no paint map, bill of materials or recipe",
    "mesh": "no mesh for other solvers",
    "response": "no matrices of a decoder",
    "places": "no `auto`: koi_inverse errs by about 8 % of a force in the middle, auto by 2 %",
    "twin": "no simulated data",
    "decoder": "no forces",
    "frames": "what the decoder's eyes miss is not known",
    "report": "no report page",
}
"""What is not there without a stage."""


def how_of(name: str, resolved: Resolved, counts: Counts) -> str:
    """How finely a stage is modelled, and of how much."""
    accuracy, scene = resolved.accuracy, resolved.scene
    played = f"{counts.in_play} of {counts.markers} receptors"
    sector = f", one of {counts.repeats} sectors solved" if counts.repeats > 1 else ""
    pictures = "pictures" if scene.pictures else "no pictures"
    theory = "linear" if accuracy.press_tolerance >= 1.0 else "large where linear is not enough"
    powers = "1 power" if accuracy.place_orders == 1 else f"{accuracy.place_orders} powers"
    local = ", fine in the regions alone" if resolved.scope else ""
    networks = "networks trained" if scene.networks else "no networks"
    solid = f"{counts.markers} receptors, chords within {accuracy.cad_tolerance_mm:g} mm"
    said = dict.fromkeys(("shell", "hardware", "mold", "kit", "printing", "bench"), solid) | {
        "views": f"{counts.markers} markers, {counts.megapixels:.1f} Mpx, {pictures}",
        "underload": f"{counts.presses} presses on {counts.nodes} nodes, {theory}",
        "resolution": f"{played}, {counts.nodes} nodes",
        "mesh": f"{counts.nodes} nodes",
        "response": f"{played}, {counts.nodes} nodes, {counts.response_loads} loads{sector}",
        "places": f"{counts.places} places, {counts.place_solves} solved, {powers} of the force, "
        f"{counts.nodes} nodes",
        "twin": f"{counts.contacts} contacts, {counts.twin_loads} loads, {counts.truth_nodes} "
        f"nodes{local}",
        "decoder": f"{played}, {networks}, {scene.estimator}",
        "frames": f"{counts.frames} frames of {counts.megapixels:.1f} Mpx",
    }
    return said.get(name, f"{counts.markers} receptors")


def why_of(name: str, resolved: Resolved) -> str:
    """What asks for a stage, or that nothing does."""
    outputs = [o for o in resolved.scene.outputs if name in STAGES_OF[o]]
    if outputs:
        return "output " + ", ".join(outputs)
    readers = [stage.name for stage in resolved.stages if name in stage.needs]
    if readers:
        return "read by " + ", ".join(readers)
    if name == "places" and "decoder" in {stage.name for stage in resolved.stages}:
        return resolved.why.get("estimator", "the estimator does without")
    return "no output needs it"


def lost_by(name: str, resolved: Resolved, counts: Counts) -> str:
    """What leaving a stage out, or limiting it, costs; "" if nothing."""
    scene, limited = resolved.scene, resolved.scope is not None
    if name not in {stage.name for stage in resolved.stages}:
        return LOST[name]
    outside = counts.markers - counts.in_play
    told = {
        "views": "" if scene.pictures else "no pictures",
        "response": f"no forces on {outside} receptors, told of in the decoder's limits"
        if outside
        else "",
        "places": "none in the regions, whose places are the whole table's; outside nothing is read"
        if limited
        else "",
        "twin": ""
        if scene.samples
        else "judged on few contacts; where the wall is not touched its mesh is coarse",
        "decoder": "" if scene.networks else "no networks of the paper",
        "underload": "presses elsewhere are not looked at" if limited else "",
    }
    return told.get(name, "")
