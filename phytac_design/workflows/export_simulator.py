"""A design as a part for simulators of robots: its rules, its switches, and the folder."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, write_facts
from phytac_design.fabrication.simulators.model_files import FORMATS, piece_file, visual_file
from phytac_design.fabrication.simulators.simulator_part import (
    CameraFrame,
    SimulatorPart,
    make_part,
)
from phytac_design.fabrication.simulators.usd_stage import usd, usd_library
from phytac_design.fabrication.simulators.xml_values import obj_text
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.rules.check import check_design
from phytac_design.stages.build import run_stages
from phytac_design.stages.switch_stage import SWITCH, design_switches, refusal, switches_of
from phytac_design.training.result_folder import reserve_folder, write_folder
from phytac_shapes.errors import DesignError

TABLE = "export.json"
"""Figures of an export; marks its folder."""


def export_simulator(
    design: Design,
    out: Path,
    *,
    to: str,
    receptors: bool | None = None,
    prefix: str = "",
    force: bool = False,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Write a design as a part for a simulator; the same inputs give the same files.

    The switches are designed once and then come from the cache.

    Parameters
    ----------
    out : Path
        Folder of the export's own.
    to : str
        ``mjcf``, ``urdf``, ``sdf`` or ``usd``.
    receptors : bool, optional
        Whether receptors have frames; by default in all but URDF, where each is a link.
    prefix : str
        Before the names of mesh files, such as ``package://my_robot/sensor/``.
    force : bool
        Overwrite a folder that holds something else.

    Returns
    -------
    dict
        The contents of ``export.json``: mass, centre, inertia, cameras, numbers of pieces and
        receptors, files.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    OutputError
        If ``out`` cannot be written or holds something else.
    MissingPartError
        If USD is asked for and usd-core is not installed.
    """
    if to == "usd":
        usd_library()
    sensor = check_design(design)
    framed = to != "urdf" if receptors is None else receptors
    with reserve_folder(out, TABLE, design.name, force=force):
        part = make_part(sensor, switches_for(design, progress))
        texts = (FORMATS | {"usd": usd})[to](part, receptors=framed, prefix=prefix)
        before = _files_of(out / TABLE)
        with write_folder(out, TABLE) as folder:
            for name, text in texts.items():
                (folder / name).write_text(text, encoding="utf-8")
            meshes = {visual_file(name): mesh for name, (mesh, _) in part.visuals.items()}
            meshes |= {piece_file(number): mesh for number, mesh in enumerate(part.pieces)}
            # A stage of USD holds its meshes.
            for name, mesh in meshes.items() if to != "usd" else ():
                (folder / name).write_text(obj_text(mesh), encoding="ascii")
            files = sorted(path.name for path in folder.iterdir())
            facts = _facts(design, part, to, framed, files)
            text = json.dumps(finite(facts), indent=1, sort_keys=True)
            (folder / TABLE).write_text(text + "\n", encoding="utf-8")
        # Of an earlier state of the design, or for another simulator: they name these meshes.
        for name in before - {*files, TABLE}:
            (out / name).unlink(missing_ok=True)
    return facts


def _files_of(table: Path) -> set[str]:
    """Names of an earlier export's files, which lie beside its table; none if it has none."""
    try:
        names = json.loads(table.read_text(encoding="utf-8"))["files"]
        return {name for name in names if name == Path(name).name}
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _design_bowls(context: Context, folder: Path) -> None:
    """Design the switches, or record why they cannot be made."""
    try:
        made = design_switches(context, folder)
    except DesignError as error:
        write_facts(folder, {"refused": str(error), "switches": []})
        return
    write_facts(folder, {"refused": "", "switches": made})


BOWLS = replace(SWITCH, depends_on=(), arrays={}, run=_design_bowls)
"""The switch stage without the check of its red tips in the image, which needs all views."""


def switches_for(design: Design, progress: Callable[[str], None]) -> SwitchSet | None:
    """Switches of a design; none if it has none, or they cannot be made."""
    if not design.has_switches:
        return None
    context = run_stages(
        design, [BOWLS], accuracy="standard", seed=0, force=True, progress=progress
    )[0]
    reason = refusal(context)
    if reason:
        progress(f"warning: exported without switches: {reason}")
        return None
    return switches_of(context)


def _facts(
    design: Design, part: SimulatorPart, to: str, framed: bool, files: list[str]
) -> dict[str, Any]:
    """Figures of an export."""
    return {
        "format": "phytac-simulator",
        "schema_version": "1.0",
        "design": design.name,
        "design_hash": design_hash(design),
        "to": to,
        "mass_kg": part.mass.mass_kg,
        "centre_m": part.mass.centre_m.tolist(),
        "inertia_kg_m2": part.mass.inertia_kg_m2.tolist(),
        "collision_pieces": len(part.pieces),
        "collision_volume_mm3": sum(piece.volume_mm3 for piece in part.pieces),
        "receptors": len(part.receptors_m) if framed else 0,
        "cameras": [_camera_facts(camera) for camera in part.cameras],
        "files": files,
    }


def _camera_facts(camera: CameraFrame) -> dict[str, Any]:
    lens = camera.lens
    return {
        "name": camera.name,
        "model": lens.model,
        "size_px": [lens.width_px, lens.height_px],
        "focal_px": [lens.fx_px, lens.fy_px],
        "centre_px": lens.centre_px.tolist(),
        "distortion": list(lens.distortion),
        "position_m": camera.position_m.tolist(),
        "rate_Hz": camera.rate_Hz,
    }
