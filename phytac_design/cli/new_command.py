"""``phytac new``: a design file to edit, from another one, from a STEP file, or by questions."""

import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from phytac_design.cli.options import check_out, complete_design, say
from phytac_design.cli.output import next_step, resumable
from phytac_shapes.errors import DesignError, OutputError

if TYPE_CHECKING:
    from phytac_design.design.shell_materials import ShellMaterial
    from phytac_design.design.spec import Design

Choice = TypeVar("Choice")


def new(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(help="Name of the new design. Without it, a terminal asks questions."),
    ] = "",
    source: Annotated[
        str,
        typer.Option(
            "--from",
            help="Design to start from; cylinder60 if not given.",
            autocompletion=complete_design,
        ),
    ] = "",
    out: Annotated[
        Path | None, typer.Option(callback=check_out, help="File to write; NAME.toml if not given.")
    ] = None,
    from_step: Annotated[
        Path | None, typer.Option(help="STEP file; the design is a patch on one of its faces.")
    ] = None,
    face: Annotated[
        int | None, typer.Option(help="Number of the face, from 0; the largest face if not given.")
    ] = None,
    rows: Annotated[
        int, typer.Option(help="Number of points sampled along the face.", min=2, max=200)
    ] = 9,
    columns: Annotated[
        int, typer.Option(help="Number of points sampled across the face.", min=2, max=200)
    ] = 9,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="After questions: write every field, commented, in place of what differs from "
            "the defaults.",
        ),
    ] = False,
) -> None:
    """Write a commented design file to edit; without a name, ask for shape, camera and forces."""
    from phytac_design.design.design_file import load_design, write_new_design
    from phytac_design.design.field_of_view import fields_of_view_deg
    from phytac_design.workflows.design_from_step import patch_changes

    if from_step and not name:
        name = re.sub(r"[^A-Za-z0-9._-]", "-", from_step.stem)
    if not name:
        if not in_terminal() or source:
            context.fail("Missing argument 'name'.")
        _ask_design(out, full=full)
        return
    target = out or Path(f"{name}.toml")
    if from_step is None:
        typer.echo(f"wrote {write_new_design(name, source or 'cylinder60', target)}")
        next_step(f"edit it, then phytac check {target}")
        return
    changes, said = patch_changes(from_step, face=face, rows=rows, columns=columns)
    typer.echo(
        f"wrote {write_new_design(name, source or 'patch', target, changes=changes)}: {said}"
    )
    made = load_design(str(target))
    across, down = fields_of_view_deg(made.camera.lens())
    typer.echo(
        f"all else is that of {source or 'patch'}: a camera of {made.camera.width_px} x "
        f"{made.camera.height_px} px and {across:.0f}° x {down:.0f}° (table camera), forces of "
        f"{made.training.force_min_N:g} to {made.training.force_max_N:g} N (table training)"
    )
    next_step(f"edit it, then phytac check {target}")


def in_terminal() -> bool:
    """Whether a person can answer questions."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _ask_design(out: Path | None, *, full: bool) -> None:
    """Ask for shape, sizes, camera and forces; write a design that passes ``phytac check``."""
    from phytac_design.design.design_file import to_short_toml, to_toml, write_design_file
    from phytac_design.study.advice.first_design import first_design

    with resumable("stopped; nothing was written"):
        name = _ask_name()
        target = out or Path(f"{name}.toml")
        if target.exists():
            raise OutputError(
                "output-exists", f"{target} exists already; choose another name or remove it"
            )
        while True:
            kind, sizes_mm = _ask_shape()
            camera = _ask_camera()
            least_N = _ask_number("Smallest force of a contact, N", 0.5, 1e-3, 1e4)
            most_N = _ask_number("Largest force of a contact, N", 25.0, least_N * 1.001, 1e4)
            try:
                design = first_design(
                    name,
                    kind,
                    sizes_mm,
                    camera,
                    force_min_N=least_N,
                    force_max_N=most_N,
                    material=_ask_material(),
                    progress=say,
                )
                break
            except DesignError as error:
                say(f"error[{error.code}]: {error}")
                typer.confirm("Answer again?", default=True, abort=True)
        design, switches = _switches_of(design, least_N)
        if design.camera.stand_off_mm != "fit":  # nearer, so that it reads the switches
            camera = {**camera, "stand_off_mm": design.camera.stand_off_mm}
    text = to_toml(design) if full else to_short_toml(design, camera=camera)
    typer.echo(f"wrote {write_design_file(text, target)}")
    typer.echo(
        f"{design.layout.wanted} markers, wall {design.wall.thickness_mm:g} mm: every marker is "
        "visible and can be distinguished"
    )
    typer.echo(_body_words(design))
    typer.echo(_precision_words(design))
    typer.echo(switches)
    next_step(f"phytac check {target}, then phytac build {target}")


def _body_words(design: "Design") -> str:
    """How large the sensing face is, with what stands out beyond it, and whether it is open."""
    import numpy as np

    surface = design.surface()
    steps = [np.linspace(low, high, 65) for low, high in surface.domain]
    uv = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    size_mm = np.ptp(surface.point(uv), axis=0)
    words = "sensing face of {:.3g} x {:.3g} x {:.3g} mm".format(*size_mm)
    if design.wall.rim_length_mm:
        words += f", and clamped rims of {design.wall.rim_length_mm:g} mm beyond its open edges"
    if design.shape.model_dump().get("end") == "open":
        words += '; its far end is open (shape.end = "cap" closes it with a dome)'
    return words


def _precision_words(design: "Design") -> str:
    """Predicted precision of forces, and what would help where it is poor."""
    from phytac_design.design.shell_materials import SHELL_MATERIALS
    from phytac_design.study.advice.first_design import ERROR_MAX
    from phytac_design.study.advice.force_precision import force_sd_N

    material, most_N = design.material, design.training.force_max_N
    label = next(
        (one.words() for one in SHELL_MATERIALS if one.modulus_MPa == material.modulus_MPa),
        f"{material.modulus_MPa:g} MPa",
    )
    sd_N = force_sd_N(design)
    words = f"shell of {label} (assumed): {most_N:g} N is read to about ± {sd_N:.2g} N at best"
    if sd_N <= ERROR_MAX * most_N:
        return words
    return (
        f"{words}, which is poor: the wall hardly moves. A softer material (material.modulus_MPa), "
        "a larger body, or a finer camera helps; phytac build measures it"
    )


def _switches_of(design: "Design", least_N: float) -> tuple["Design", str]:
    """The design with switches that the smallest force trips, and a sentence on that force.

    Thresholds stay as they are where no bowl of any rubber has the wanted ones.
    """
    from phytac_design.study.advice.design_variables import with_fields
    from phytac_design.study.advice.first_design import trip_force_N
    from phytac_design.workflows.switch_feasibility import threshold_fields

    design, seen = _with_readable(design)
    if not design.has_switches:
        return design, seen
    design, rubber = _with_rubber(design)
    factor = least_N / trip_force_N(design)
    if factor < 0.95:  # numbers of design files are rounded to two digits
        with suppress(DesignError):
            design, rubber = _with_rubber(with_fields(design, threshold_fields(design, factor)))
    trip_N = trip_force_N(design)
    share = design.switch.threshold_N / trip_N
    spread = f", of which the bowl bears {share:.0%}" if share < 0.99 else ""
    return design, (
        f"a contact trips a switch from about {trip_N:.2g} N on (wanted: {least_N:g} N){spread}: "
        f"switch.threshold_N = {design.switch.threshold_N:g}{rubber}{seen}"
    )


def _with_readable(design: "Design") -> tuple["Design", str]:
    """The design with switches that its camera can read, else without any, and words on it."""
    from phytac_design.rules.check import check_design
    from phytac_design.study.advice.design_variables import with_fields
    from phytac_design.study.advice.quick_repair import readable_switches, seen_at_rest
    from phytac_design.workflows.design_check import unreadable_fault

    seen = seen_at_rest(check_design(design)).switch_unreadable
    blind, count = int(seen.sum()), len(seen)
    if unreadable_fault(blind, count) is None:
        return design, ""

    def fits(changed: "Design") -> None:
        _with_rubber(changed)

    cures = [
        one
        for one in readable_switches(design, fits=fits, progress=say)
        if unreadable_fault(one.after, count) is None and not one.reason
    ]
    for one in cures:
        # The lens and the number of cameras are those that the user has.
        if not one.fields.keys() & {"camera.focal_px", "camera.width_px", "camera.ends"}:
            return one.design, f"; so that the camera reads most switches: {one.words}"
    lens = f"; it would with {cures[0].words}" if cures else ""
    return with_fields(design, {"receptor.diameter_hole_mm": 0.0}), (
        f"this camera cannot read {blind} of {count} switches{lens}: receptors are solid posts "
        "without switches (receptor.diameter_hole_mm = 0), and contacts are found by the markers' "
        "motion alone"
    )


def _with_rubber(design: "Design") -> tuple["Design", str]:
    """The design with a rubber whose bowls have its thresholds, and words on it if it is new.

    Thresholds become a little lower where a rubber with data has those alone.

    Raises
    ------
    DesignError
        If no bowl of any rubber has them.
    """
    from phytac_design.study.advice.design_variables import with_fields
    from phytac_design.workflows.switch_feasibility import (
        check_thresholds,
        known_rubbers,
        modulus_for,
        threshold_range,
    )

    try:
        check_thresholds(design, progress=say)
    except DesignError:
        found = threshold_range(design, progress=say)
        if found is None:
            raise
    else:
        return design, ""
    for fields in known_rubbers(design, found):
        with suppress(DesignError):
            own = with_fields(design, fields)
            check_thresholds(own, progress=say)
            return own, f"; bowls of {own.switch.material} have it (switch.material)"
    modulus_MPa = modulus_for(design.switch.threshold_N, found)
    words = (
        f"; the switches' rubber must have {modulus_MPa:g} MPa (switch.modulus_MPa), and none of "
        "those with data has: measure yours (phytac switch --help)"
    )
    return with_fields(design, {"switch.modulus_MPa": modulus_MPa}), words


def _ask_name() -> str:
    """Name that a design may have."""
    from phytac_design.design.spec import Design

    rule = Design.model_json_schema()["properties"]["name"]
    while True:
        name = str(typer.prompt("Name of the sensor", default="mine"))
        if re.fullmatch(rule["pattern"], name):
            return name
        say(f"{name!r} is no name: {rule['description']}")


def _ask_shape() -> tuple[str, dict[str, float]]:
    """Family and sizes."""
    from dataclasses import fields

    import phytac_shapes
    from phytac_design.design.design_file import load_design
    from phytac_design.design.unit_hints import unit_hints
    from phytac_design.study.advice.first_design import FAMILIES

    say(
        "Other shapes: phytac new NAME --from grip, or from a face of your CAD by phytac new NAME "
        "--from-step FILE"
    )
    kind = _choose("Shape", {kind: kind for kind in FAMILIES})
    base = load_design(FAMILIES[kind].template).shape.model_dump()
    sizes_mm = {}
    known = {item.name: item for item in fields(phytac_shapes.family(kind))}  # type: ignore[arg-type]  # every family is a dataclass
    for field in (*FAMILIES[kind].across, *FAMILIES[kind].along):
        item = known[field].metadata
        text = f"{field}: {item['doc'].rstrip('.')}"
        while True:
            size = _ask_number(text, base[field], item["minimum"], item["maximum"])
            hints = unit_hints({"shape": {field: size}})
            if not hints or typer.confirm(f"{hints[0]}. Keep {size:g} mm?", default=False):
                break
        sizes_mm[field] = size
    return kind, sizes_mm


def _ask_camera() -> dict[str, Any]:
    """Table ``camera``."""
    from phytac_design.design.camera_catalogue import CAMERAS
    from phytac_design.design.field_of_view import FIELD_OF_VIEW_MAX_deg, STRAIGHT_MAX_deg

    listed = {camera.words(): camera.table() for camera in CAMERAS}
    table = _choose("Camera", listed | {"another one": {}})
    if table:
        return table
    table = {
        "width_px": int(_ask_number("Image width, px", 1280, 16, 20000)),
        "height_px": int(_ask_number("Image height, px", 720, 16, 20000)),
        "field_of_view_deg": _ask_number(
            "Horizontal field of view, degrees (sellers often state the diagonal)",
            70.0,
            5.0,
            FIELD_OF_VIEW_MAX_deg,
        ),
    }
    angle = table["field_of_view_deg"]
    if fisheye := angle > STRAIGHT_MAX_deg:
        say(f"{angle:g}° is taken as a fisheye lens (camera.model); calibrate yours before use")
    else:
        fisheye = typer.confirm("Is it a fisheye lens?", default=angle > 120.0)
    return {"model": "kannala_brandt", **table} if fisheye else table


def _ask_material() -> "ShellMaterial | None":
    """Material of the shell; None for one that suits the forces."""
    from phytac_design.design.shell_materials import SHELL_MATERIALS

    suited: dict[str, ShellMaterial | None] = {"the stiffest that suits these forces": None}
    return _choose("Shell", suited | {one.words(): one for one in SHELL_MATERIALS})


def _choose(title: str, items: dict[str, Choice]) -> Choice:
    """One of several items by its number, or by the start of its words."""
    for number, words in enumerate(items, start=1):
        typer.echo(f"  {number}. {words}")
    by_number = {str(number): words for number, words in enumerate(items, start=1)}
    while True:
        answer = str(typer.prompt(f"{title}, number", default="1")).strip()
        named = [words for words in items if answer and words.lower().startswith(answer.lower())]
        if answer in by_number or len(named) == 1:
            return items[by_number.get(answer) or named[0]]
        if answer.isdecimal():
            say(f"{answer} is not between 1 and {len(items)}")
        else:
            say(f"{answer!r} is {'several' if named else 'none'} of these: give a number")


def _ask_number(text: str, default: float, low: float, high: float) -> float:
    """A number within limits; asks again until it is one."""
    while True:
        answer = str(typer.prompt(text, default=f"{default:g}")).strip()
        try:
            value = float(answer)
        except ValueError:
            like = re.fullmatch(r"(\d+(?:[.,]\d+)?)\s*(?:mm|N|px|°)?", answer)
            fix = (
                f"write {like[1].replace(',', '.')}" if like else "it must be in the unit asked for"
            )
            say(f"{answer!r} is not a number: {fix}")
            continue
        if low <= value <= high:
            return value
        say(f"{value:g} is not between {low:g} and {high:g}")
