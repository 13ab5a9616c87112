"""What the referee's own choices cost: regions, mesh, increments, measured on one contact.

``python -m benchmarks.referee.check [--cases a,b]`` solves cases that are not in
``data/checks.json`` yet. The whole sensor with all its tubes takes about an hour and 6 GB.
"""

import argparse
import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.referee.contacts import DATA, Contact
from benchmarks.referee.read import Solved
from benchmarks.referee.solve import input_key, sensor, sizes_for, solve_contact
from phytac_design.mechanics.shell import receptor_stiffness as rc
from phytac_design.mechanics.solid.cell import Cell, cell_stiffness, ratio
from phytac_design.mechanics.solid.partial_solid import AS_TABLES, PartSizes
from phytac_design.mechanics.solid.solid_mesh_tets import SolidSizes
from phytac_shapes.arrays import FloatArray

FILE = DATA / "checks.json"
DESIGN, MARKER = "cylinder60", 184
"""At half height, where a closed wall bends farthest around."""
RADIUS_MM, FORCE_N = 5.0, 25.0
WHOLE_MM = 1e4
COARSE = SolidSizes(wall_mm=1.4, foot_mm=0.98, tube_mm=1.12, contact_mm=0.88)
STEP_MM = 1e-5
"""Tips are kept in whole steps of this."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A way to solve the contact.

    Attributes
    ----------
    sizes : callable
        Changes the mesh of the referee.
    large : bool
        Whether with large displacements.
    smear : callable
        Factors on the smeared wall's stiffness.
    """

    sizes: Callable[[PartSizes], PartSizes]
    large: bool = False
    smear: Callable[[], tuple[float, float] | None] = lambda: AS_TABLES


def _same(sizes: PartSizes) -> PartSizes:
    return sizes


def _coarse(sizes: PartSizes) -> PartSizes:
    """Tubes that a whole sensor has room for in memory."""
    return replace(sizes, near=COARSE, middle=COARSE)


def _coarse_whole(sizes: PartSizes) -> PartSizes:
    return replace(_coarse(sizes), reach_mm=WHOLE_MM)


@cache
def coarse_factors() -> tuple[float, float]:
    """How much stiffer than the tables cells with tubes as coarse as ``COARSE`` are.

    Tables are of fine meshes. A part compared with a coarse whole has to be smeared alike.
    """
    this = sensor(DESIGN)
    receptor, wall = this.design.receptor, this.design.wall.thickness_mm
    rows, columns = this.design.layout.rows, this.design.layout.columns
    pitch_y = 2.0 * np.pi * (float(np.hypot(*this.markers.mid_mm[0, :2]))) / columns
    pitch_x = this.surface.area_mm2() / (rows * columns) / pitch_y
    height = float(np.median(this.markers.height_mm))
    nu = this.design.material.poisson
    cell = Cell(
        pitch_x_mm=pitch_x,
        pitch_y_mm=pitch_y,
        thickness_mm=wall,
        height_mm=height,
        diameter_outer_mm=receptor.diameter_outer_mm,
        diameter_hole_mm=receptor.diameter_hole_mm,
        poisson=nu,
    )
    coarse = cell_stiffness(cell, size_mm=COARSE.foot_mm)
    share = np.array(np.pi / 4.0 * receptor.diameter_outer_mm**2 / (pitch_x * pitch_y))
    effect = rc.receptor_effect(
        receptor.diameter_outer_mm / wall,
        receptor.diameter_hole_mm / receptor.diameter_outer_mm,
        height / wall,
    )
    mixing = (rc.MIXING_MEMBRANE, rc.MIXING_BENDING)
    membrane, bending = (
        ratio(matrix, nu) / float(rc.mixture(share, e, s))
        for matrix, e, s in zip((coarse.membrane, coarse.bending), effect, mixing, strict=True)
    )
    return membrane, bending


CASES: dict[str, Case] = {
    "linear": Case(sizes=_same),
    "coarse part linear": Case(sizes=_coarse, smear=coarse_factors),
    "coarse part by the tables linear": Case(sizes=_coarse),
    "coarse part plain linear": Case(sizes=_coarse, smear=lambda: None),
    "coarse whole linear": Case(sizes=_coarse_whole),
    "wider linear": Case(sizes=lambda s: replace(s, reach_mm=2.0 * s.reach_mm)),
    "narrower linear": Case(sizes=lambda s: replace(s, reach_mm=0.75 * s.reach_mm)),
    "finer linear": Case(sizes=lambda s: s.scaled(0.75)),
    "large": Case(sizes=_same, large=True),
    "finer large": Case(sizes=lambda s: s.scaled(0.75), large=True),
    "coarse part large": Case(sizes=_coarse, large=True, smear=coarse_factors),
    "coarse whole large": Case(sizes=_coarse_whole, large=True),
}
ALIKE = "tubes meshed alike, smeared wall of cells meshed alike"
SOFT = "a smeared wall is a little softer than one with tubes: the part moves by as much more"
ROWS: tuple[tuple[str, str, str, str, str], ...] = (
    (
        "part against the whole sensor, linear",
        "coarse part linear",
        "coarse whole linear",
        "<= 1",
        f"{ALIKE}; {SOFT}",
    ),
    (
        "part against the whole sensor, 25 N",
        "coarse part large",
        "coarse whole large",
        "<= 1",
        ALIKE,
    ),
    (
        "part smeared by the tables against the whole sensor, linear",
        "coarse part by the tables linear",
        "coarse whole linear",
        "",
        "coarse tubes stiffen the wall, the tables are of fine ones",
    ),
    (
        "part with a plain wall against the whole sensor, linear",
        "coarse part plain linear",
        "coarse whole linear",
        "",
        "no smearing",
    ),
    ("true receptors within 20 mm against 40 mm, linear", "linear", "wider linear", "<= 1", SOFT),
    (
        "true receptors within 15 mm against 40 mm, linear",
        "narrower linear",
        "wider linear",
        "<= 1",
        SOFT,
    ),
    ("mesh against sizes × 0.75, linear", "linear", "finer linear", "<= 1", ""),
    ("mesh against sizes × 0.75, 25 N", "large", "finer large", "<= 1", ""),
)
"""Case, what is judged, by what, target, note."""


def contact() -> Contact:
    """The contact that is solved in every way."""
    uv = sensor(DESIGN).markers.uv[MARKER].tolist()
    return Contact(
        kind="receptor", uv=((uv[0], uv[1]),), radius_mm=(RADIUS_MM,), force_N=(FORCE_N,)
    )


def key_of(case: Case) -> str:
    """Hash of a case's inputs."""
    this, load = sensor(DESIGN), contact()
    mesh = input_key(this, load, case.sizes(sizes_for(this.design, load)))
    text = f"{mesh} {case.large} {case.smear()}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def gap(ours: FloatArray, truth: FloatArray) -> float:
    """Largest distance of tips (n, 3), in % of the largest true motion."""
    far = np.linalg.norm(ours - truth, axis=1).max()
    return float(100.0 * far / np.linalg.norm(truth, axis=1).max())


def read_checks(path: Path = FILE) -> dict[str, Any]:
    """Cases solved so far and the rows they give."""
    if not path.is_file():
        return {"cases": {}, "rows": []}
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return data


def record(case: Case, solved: Solved) -> dict[str, Any]:
    """What is kept of a case."""
    facts = {k: v for k, v in solved.facts.items() if k != "key"}
    return {
        "key": key_of(case),
        "facts": facts,
        "tips_steps": np.rint(solved.motion_mm / STEP_MM).astype(int).tolist(),
    }


def tips_mm(record: dict[str, Any]) -> FloatArray:
    """Displacement of tips (n, 3) of a case, mm."""
    return np.asarray(STEP_MM * np.array(record["tips_steps"]))


def rows_of(cases: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows whose two cases are solved."""
    out = []
    for name, judged, by, target, note in ROWS:
        if judged in cases and by in cases:
            ours, truth = (tips_mm(cases[key]) for key in (judged, by))
            nodes = [cases[key]["facts"]["nodes"] for key in (judged, by)]
            row: dict[str, Any] = {
                "case": name,
                "value": gap(ours, truth),
                "scale_percent": 100.0 * (float(np.sum(ours * truth) / np.sum(truth**2)) - 1.0),
                "source": f"CalculiX, {nodes[1]} nodes against {nodes[0]}",
            }
            row |= {"target": target} if target else {}
            out.append(row | ({"note": note} if note else {}))
    return out


def write(cases: dict[str, Any]) -> list[dict[str, Any]]:
    """Write cases and the rows they give; the rows."""
    rows = rows_of(cases)
    data = {"contact": asdict(contact()), "rows": rows, "cases": cases}
    FILE.write_text(json.dumps(data) + "\n", encoding="utf-8", newline="\n")
    return rows


def run(chosen: list[str]) -> None:
    """Solve what is missing; the file is written after each case."""
    load = contact()
    sizes = sizes_for(sensor(DESIGN).design, load)
    for name in chosen:
        case = CASES[name]
        if read_checks()["cases"].get(name, {}).get("key") == key_of(case):
            continue
        solved = solve_contact(
            DESIGN, 0, load, case.sizes(sizes), large=case.large, smear=case.smear()
        )
        rows = write(read_checks()["cases"] | {name: record(case, solved)})
        facts = solved.facts
        print(
            f"{name}: peak {solved.peak_mm:.5f} mm, {facts['nodes']} nodes, mesh "
            f"{facts['mesh_s']} s, ccx {facts['ccx_s']} s",
            flush=True,
        )
        for row in rows:
            print(f"    {row['case']}: {row['value']:.2f} % ({row['scale_percent']:+.2f} %)")
    write(read_checks()["cases"])


def main() -> None:
    """Solve the cases asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", default=",".join(CASES), help="comma separated")
    chosen = parser.parse_args().cases.split(",")
    unknown = [name for name in chosen if name not in CASES]
    if unknown:
        parser.error(f"no case {unknown[0]!r}; known: {', '.join(CASES)}")
    run(chosen)


if __name__ == "__main__":
    main()
