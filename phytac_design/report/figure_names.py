"""What the figures of ``report.json`` are called on the page, and why some of them do not exist.

Names go by the dotted path in ``report.json``; what is not listed is shown by its path. Assumptions
keep the names of the design file, where they are set.
"""

NAMES: dict[str, str] = {
    "visibility.occluded": "hidden markers",
    "visibility.fused": "markers fused with another of their colour",
    "visibility.min_visible_fraction": "smallest visible fraction of a marker",
    "visibility.min_visible_px": "smallest visible area of a marker (px)",
    "visibility.min_gap_px": "smallest gap to a marker of the same colour (px)",
    "visibility.min_gap_other_colour_px": "smallest gap to a marker of another colour (px)",
    "visibility.min_red_on_px": "smallest red of a tip that is out (px)",
    "visibility.max_red_rest_px": "most red of a tip at rest (px)",
    "visibility.switch_unreadable": "switches whose tip looks alike at rest and out",
    "camera.stand_off_mm": "stand-off: camera to its rim (mm)",
    "camera.picture": "pictures made by",
    "camera.rest_centroid_bias_px": "error of predicted rest positions, root mean square (px)",
    "camera.end": "end that the camera stands at",
    "under_load.presses": "places pressed",
    "under_load.force_N": "largest force pressed with (N)",
    "under_load.patch_radius_mm": "radius of the patch (mm)",
    "under_load.hidden_most": "most markers hidden at once",
    "under_load.fused_most": "most markers fused at once",
    "under_load.first_force_N": "smallest force at which a marker hides or fuses (N)",
    "under_load.first_place_uv": "chart position of that press (u, v)",
    "under_load.first_place": "place of that press",
    "under_load.first_marker": "marker that hides or fuses there",
    "under_load.least_visible_fraction": "smallest visible fraction of a marker",
    "under_load.least_gap_same_colour_px": "smallest gap to a marker of the same colour (px)",
    "under_load.least_gap_other_colour_px": "smallest gap to a marker of another colour (px)",
    "under_load.crosstalk_px": "largest crosstalk (px)",
    "under_load.crosstalk_marker": "marker with that crosstalk",
    "under_load.crosstalk_still_px": "largest crosstalk of a marker that stands still (px)",
    "under_load.greatest_shift_px": "largest shift of a marker in the picture (px)",
    "under_load.dent_mm": "deepest dent (mm)",
    "under_load.theory": "how the wall's motion was found",
    "under_load.not_solved": "presses that could not be solved",
    "under_load.flagged": "solves with a warning",
    "under_load.why": "why some could not be solved",
    "under_load.sector_only": "pressed in one sector only, the others repeat it",
    "resolution.cameras": "cameras",
    "resolution.noise_px": "noise of a centroid (px)",
    "resolution.radius_mm": "radius of the contact (mm)",
    "resolution.prior_place_mm": "known of the place beforehand, standard deviation (mm)",
    "resolution.prior_radius_mm": "known of the radius beforehand, standard deviation (mm)",
    "markers.count": "markers",
    "markers.layout": "layout",
    "markers.rows": "rows",
    "markers.columns": "columns",
    "markers.density_per_cm2": "density (per cm²)",
    "markers.density_local_min_per_cm2": "smallest local density (per cm²)",
    "markers.density_local_max_per_cm2": "largest local density (per cm²)",
    "markers.density_times_paper": "density over the paper's 1.63 per cm²",
    "markers.sensing_area_cm2": "sensing area (cm²)",
    "markers.surface_class": "surface to the optical axis",
    "markers.height_least_mm": "shortest receptor (mm)",
    "markers.height_greatest_mm": "tallest receptor (mm)",
    "markers.colours.nearest_paints": "paints that are nearest",
    "markers.colours.min_uv_distance": "their distance in CIE 1976 u'v'",
    "markers.colours.min_hue_deg": "smallest angle of hue between paints (°)",
    "markers.colours.min_hue_sigmas": "smallest angle of hue over the noise of a pixel",
    "markers.colours.min_floor_sigmas": "smallest colour above the decoder's floor, over the noise",
    "shell.volume_mm3": "volume (mm³)",
    "shell.area_mm2": "area of all faces (mm²)",
    "shell.watertight": "watertight",
    "shell.bodies": "bodies",
    "shell.genus": "handles (genus)",
    "shell.bounds_mm": "bounding box, smallest and largest corner (mm)",
    "shell.triangles": "triangles of the STL",
    "shell.step_volume_mm3": "volume of the STEP solid (mm³)",
    "shell.step_valid": "STEP solid is valid",
    "shell.step_solids": "solids in the STEP file",
    "shell.3mf_left_out": "why there is no 3MF file",
    "shell.step_left_out": "why there is no STEP file",
    "shell.volume_difference": "volume of the STL over the STEP's, less 1",
    "switch.red.worst_marker": "marker with the worst readable tip",
    "switch.red.worst_on_px": "its red when out (px)",
    "switch.red.worst_needed_px": "red that the decoder needs there (px)",
    "switch.red.farthest_marker": "marker farthest from the camera",
    "switch.red.farthest_on_px": "its red when out (px)",
    "switch.red.farthest_needed_px": "red that the decoder needs there (px)",
    "switch.red.unreadable": "switches that show too little red",
    "switch.parts": "parts to make and to buy",
    "switch.parts.part": "part",
    "switch.parts.count": "count",
    "switch.parts.material": "material",
    "switch.parts.volume_mm3": "volume (mm³)",
    "switch.parts.file": "file",
    "switch.parts.note": "note",
    "fabrication.mass_g.resin": "resin, all printed parts (g)",
    "fabrication.mass_g.tpu": "rubber, switches and what runs over (g)",
    "fabrication.mass_g.silicone": "silicone (g)",
    "fabrication.poured_mm3.rubber": "rubber to pour (mm³)",
    "fabrication.poured_mm3.switches": "of it, in the switches (mm³)",
    "fabrication.poured_mm3.silicone_dome": "silicone to pour, dome half (mm³)",
    "fabrication.poured_mm3.silicone_core": "silicone to pour, core half (mm³)",
    "fabrication.mold.way": "mold: way",
    "fabrication.mold.cavities": "mold: cavities",
    "fabrication.mold.volume_error": "mold: worst error of a cavity, shrinkage counted in",
    "fabrication.mold.hausdorff_mm": "mold: farthest from the switch's shape (mm)",
    "fabrication.mold.least_draft_deg": "mold: smallest draft (°)",
    "fabrication.mold.undercut_rays": "mold: rays caught along the pull",
    "fabrication.mold.shared_mm3": "mold: volume that closed halves share (mm³)",
    "fabrication.interference_mm3": "assembly: volume that parts share (mm³)",
    "fabrication.light_leaks": "assembly: lines of sight from outside",
    "fabrication.hardware_left_out": "fixtures left out",
    "fabrication.mold_left_out": "molds left out",
    "fabrication.print_process": "print rules of",
    "fabrication.print_violations": "places that break them",
    "fabrication.pieces": "pieces of the shell, if it is parted for the bed",
    "fabrication.regions_to_calibrate": "receptors that calibration must press",
    "mesh.nodes": "nodes",
    "mesh.elements": "elements",
    "mesh.load_N": "force of the ready load step (N)",
    "mesh.load_radius_mm": "radius of its patch (mm)",
    "mesh.load_marker": "marker under it",
    "mesh.inward_mm_at_load": "inward motion there, linear (mm)",
    "frames.frames": "frames",
    "frames.renderer": "made by",
    "frames.contacts": "contacts",
    "frames.tripped_no_switch": "contacts that tripped no switch",
    "frames.koi": "switches that were on",
    "frames.koi_missed": "of these, missed",
    "frames.koi_false": "switches taken as on that were off",
    "frames.markers_not_found": "markers not found, in all frames",
    "frames.refused": "frames that could not be decoded",
    "frames.first_refusal": "why the first of them could not",
    "training.key_nodes": "switched receptors to learn from",
    "training.samples": "samples",
    "twin.model": "simulated sensor",
    "twin.nodes": "nodes of its mesh",
    "twin.dent_mm_largest": "deepest dent, linear (mm)",
    "accuracy.cad_tolerance_mm": "chordal tolerance of printed meshes (mm)",
    "accuracy.refine": "elements per marker pitch, decoder's mesh",
    "accuracy.receptors": "receptors stiffen the wall",
    "accuracy.truth_refine": "elements per marker pitch, simulated sensor's mesh",
    "accuracy.sample_share": "share of the samples simulated",
    "accuracy.frames": "frames rendered and decoded",
    "accuracy.place_share": "spacing of auto's places over the patches' radius",
    "accuracy.place_orders": "powers of the force in auto's tables",
    "accuracy.press_places": "places pressed",
    "accuracy.press_tolerance": "error of linear theory accepted under load",
    "seed": "seed",
    "timing_s.total": "all stages (s)",
}
for _set, _named in (
    ("train", "to learn from"),
    ("test", "held out, on receptors"),
    ("anywhere", "held out, anywhere"),
):
    NAMES[f"twin.samples.{_set}"] = f"samples {_named}"
    NAMES[f"twin.contacts.{_set}"] = f"contacts {_named}"
    NAMES[f"twin.tripped_no_switch.{_set}"] = f"of these, tripped no switch ({_set})"
for _net in ("fem_nn", "fem_nn_identity"):
    NAMES[f"training.{_net}.seconds"] = f"{_net}: time (s)"
    NAMES[f"training.{_net}.rounds"] = f"{_net}: rounds"
    NAMES[f"training.{_net}.rmse_train_N"] = f"{_net}: error on its own data (N)"
    NAMES[f"training.{_net}.rmse_validation_N"] = f"{_net}: error on the validation part (N)"
    NAMES[f"training.{_net}.rmse_test_split_N"] = f"{_net}: error on the test part (N)"

ONE_OF_A_COLOUR = "no two markers of one colour"
ABSENT: dict[str, str] = {
    "markers.rows": "this layout has no rows",
    "markers.columns": "this layout has no columns",
    "markers.density_times_paper": "compares only with surfaces parallel to the optical axis",
    "visibility.min_gap_px": ONE_OF_A_COLOUR,
    "visibility.min_gap_other_colour_px": "one colour only",
    "under_load.first_force_N": "nothing hides or fuses",
    "under_load.first_place_uv": "nothing hides or fuses",
    "under_load.first_marker": "nothing hides or fuses",
    "under_load.least_gap_same_colour_px": ONE_OF_A_COLOUR,
    "under_load.least_gap_other_colour_px": "one colour only",
    "under_load.why": "all were solved",
    "frames.first_refusal": "all were decoded",
    "training.fem_nn.rmse_test_split_N": "too few samples to keep some apart",
    "training.fem_nn_identity.rmse_test_split_N": "too few samples to keep some apart",
}
"""Why a figure may be missing."""
_ORDER = {path: number for number, path in enumerate(NAMES)}


def name_of(path: str) -> str:
    """Name of a figure by its path in ``report.json``, units included; the path if not known."""
    if path.startswith("timing_s.") and path not in NAMES:
        return f"stage {path.removeprefix('timing_s.')} (s)"
    if path.startswith("shell.body_volume_mm3."):
        return f"volume of the {path.rsplit('.', 1)[1]} body (mm³)"
    return NAMES.get(path, path.removeprefix("assumptions."))


def place_of(path: str) -> int:
    """Where a figure stands among those of its table: as listed here, others after them."""
    return _ORDER.get(path, len(_ORDER))


def absent_why(path: str) -> str:
    """Why a figure does not exist; "" if not known."""
    return ABSENT.get(path, "")
