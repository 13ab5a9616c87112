"""The command of the threshold switch."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.output import print_json
from phytac_shapes.errors import DesignError, InputError

if TYPE_CHECKING:
    from phytac_design.design.spec import Design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.mechanics.switch.family_spread import FamilyTolerance
    from phytac_design.mechanics.switch.rubbers import Rubber
    from phytac_design.mechanics.switch.switch_families import FamilyCandidate
    from phytac_design.mechanics.switch.switch_space import SwitchSpace


def switch(
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a file.")
    ] = "cylinder60",
    threshold: Annotated[
        float | None, typer.Option("--threshold-N", help="Threshold, N; the design's if not given.")
    ] = None,
    material: Annotated[
        str | None,
        typer.Option(help="Rubber, such as tpu-8400n; the design's if not given."),
    ] = None,
    modulus: Annotated[
        float | None, typer.Option("--modulus-MPa", help="Young's modulus of the rubber.")
    ] = None,
    test: Annotated[
        Path | None, typer.Option(help="CSV of a tensile test (stretch, stress_MPa) to fit.")
    ] = None,
    law: Annotated[str, typer.Option(help="For --test: neo-hookean, yeoh or ogden.")] = "yeoh",
    wall_min: Annotated[
        float | None, typer.Option("--wall-min-mm", help="Thinnest wall that the mold can cast.")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance-mm", help="Tolerance of the wall, ±, at two standard deviations."
        ),
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(
            help="Family to compare: bowl, membrane, plunger, or auto for all. All rubbers are "
            "compared if none is given here or, with a family, by the design. Takes minutes; the "
            "smallest spread comes first."
        ),
    ] = None,
    molds: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the molds of the recommended membrane or plunger; with --family."
        ),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Force–stroke curve to write, SVG.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Design the threshold switch: a soft bowl that snaps at the given force, or another family.

    Missing options come from the switch table of the design. With --family, or where the design's
    family is not bowl, it compares families of switches by the spread of their threshold.
    """
    from phytac_design.design.design_file import load_design
    from phytac_design.mechanics.switch.design import design_switch
    from phytac_design.mechanics.switch.family_spread import FamilyTolerance
    from phytac_design.mechanics.switch.line_plot import check_svg, write_svg
    from phytac_design.mechanics.switch.switch_inputs import (
        chosen_rubber,
        known_rubbers,
        rubbers_of,
        space_of,
    )
    from phytac_design.mechanics.switch.switch_report import (
        curve_plot,
        release_notes,
        switch_dict,
        switch_text,
        warnings,
    )
    from phytac_design.mechanics.switch.switch_space import Tolerance

    if plot:
        check_svg(plot)
    loaded = load_design(design)
    own, compared = loaded.switch, family is not None
    if not (material is None and modulus is None and test is None):
        rubbers = [chosen_rubber(material or own.material, modulus_MPa=modulus, test=test, law=law)]
    else:
        rubbers = rubbers_of(loaded) if family is None else known_rubbers(loaded)
    family = own.family if family is None else family
    asked = own.threshold_N if threshold is None else threshold
    thickness = own.wall_tolerance_mm if tolerance is None else tolerance
    if compared or family != "bowl":
        _compare(
            loaded,
            family,
            asked,
            rubbers,
            space_of(loaded, wall_min_mm=wall_min),
            FamilyTolerance(thickness_mm=thickness, modulus=own.modulus_tolerance),
            plot=plot,
            molds=molds,
            as_json=as_json,
        )
        return
    if molds:
        raise InputError(
            "switch-molds-without-family",
            "--molds writes those of a membrane or plunger: give --family; phytac build --only "
            "mold writes those of the bowls",
        )
    made = design_switch(
        asked,
        rubbers[0],
        space_of(loaded, wall_min_mm=wall_min),
        Tolerance(thickness_mm=thickness, modulus=own.modulus_tolerance),
    )
    if plot:
        say(f"wrote {write_svg(plot, curve_plot(made))}")
    minded = warnings(made) + release_notes(made, own)
    others = sorted({region.threshold_N for region in own.regions} - {made.threshold_N})
    if threshold is None and others:
        more = ", ".join(f"{other:g}" for other in others)
        minded.append(f"this design also has regions with {more} N: see --threshold-N")
    if as_json:
        plain = switch_dict(made) | {"design": loaded.name, "warnings": minded}
        print_json(plain)
        return
    for warning in minded:
        say(f"warning: {warning}")
    typer.echo(switch_text(made))


def _compare(
    loaded: "Design",
    family: str,
    threshold_N: float,
    rubbers: "list[Rubber]",
    space: "SwitchSpace",
    tolerance: "FamilyTolerance",
    *,
    plot: Path | None,
    molds: Path | None,
    as_json: bool,
) -> None:
    """Families of one or more rubbers, smallest spread first."""
    from phytac_design.layout.sensor import Sensor
    from phytac_design.mechanics.switch.family_report import (
        candidate_dict,
        candidate_plot,
        candidates_text,
    )
    from phytac_design.mechanics.switch.line_plot import write_svg
    from phytac_design.mechanics.switch.switch_families import FAMILIES, compare_families
    from phytac_design.optics.tip_travel import tip_travel_on_mm

    chosen = [name for name in FAMILIES if family in {name, "auto", "best"}]
    if not chosen:
        raise InputError(
            "switch-family-unknown",
            f"no family {family!r} of switches; take auto, {', '.join(FAMILIES)}",
        )
    if molds and loaded.switch.regions:
        raise InputError(
            "switch-molds-of-regions",
            "--molds writes switches of one threshold, and the design has regions with others; "
            "take [[switch.regions]] out of a copy of the design",
        )
    if molds and chosen == ["bowl"]:
        raise _molds_of_bowl()
    sensor = Sensor(loaded)
    found = compare_families(
        threshold_N,
        rubbers,
        space,
        tip_travel_on_mm(sensor),
        families=chosen,
        tolerance=tolerance,
        progress=say,
    )
    best = found[0]
    if best.design is None:
        say(candidates_text(found, threshold_N=threshold_N))
        raise DesignError(
            "switch-infeasible",
            f"no switch of {threshold_N:g} N fits {space.diameter_mm:.3g} mm (families: "
            f"{', '.join(chosen)}; rubbers: {len(rubbers)}; each reason is above); take another "
            "rubber or threshold, or raise switch.footprint_diameter_mm",
        )
    if plot:
        say(f"wrote {write_svg(plot, candidate_plot(best))}")
    if as_json:
        print_json(
            {
                "design": loaded.name,
                "threshold_N": threshold_N,
                "tolerance": dict(vars(tolerance)),
                "recommended": {"family": best.family, "rubber": best.rubber.name},
                "candidates": [candidate_dict(one) for one in found],
            }
        )
    else:
        typer.echo(candidates_text(found, threshold_N=threshold_N))
    if molds:
        _write_molds(molds, sensor, best)


def _molds_of_bowl() -> InputError:
    return InputError(
        "switch-molds-of-bowl",
        "--molds writes molds of a membrane or plunger, and the recommended switch is a bowl: "
        "phytac build --only mold writes its molds; or give --family plunger",
    )


def _write_molds(folder: Path, sensor: "Sensor", best: "FamilyCandidate") -> None:
    """Checked molds of the recommended membrane or plunger, one cavity for each receptor."""
    import numpy as np

    from phytac_design.fabrication.molds.make import make_molds
    from phytac_design.fabrication.molds.mold_files import mold_files
    from phytac_design.fabrication.molds.rules import rule_rows
    from phytac_design.fabrication.switch_set import CupOutline, arrange_switches
    from phytac_design.mechanics.switch.cup_design import CupDesign

    made, design = best.design, sensor.design
    if not isinstance(made, CupDesign):
        raise _molds_of_bowl()
    outline = CupOutline(
        cup=made.cup, stop_mm=made.stop_mm, stem_diameter_mm=made.space.stem_diameter_mm
    )
    asked = np.full(sensor.markers.count, made.threshold_N)
    switches = arrange_switches(sensor, [outline], [made.threshold_N], asked)
    sets = make_molds(design.mold, design.print_rules, switches, tolerance_mm=0.02)
    for file, data in mold_files(sets, switches, progress=say).contents.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        say(f"wrote {path}")
    for row in rule_rows(sets[0].sizes):
        if not row["holds"]:
            say(
                f"warning: {row['detail']}: {row['got_mm']:.3g} mm, the printer needs "
                f"{row['needed_mm']:.3g} mm"
            )
