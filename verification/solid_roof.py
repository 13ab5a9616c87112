"""The hinged roof as a solid of quadratic bricks (C3D20R) with NLGEOM, for CalculiX.

An independent model of :func:`large_shells.hinged_roof`: the sag of the middle is prescribed and
the force read from the reaction. At the hinge the middle line is held, the section stays straight
(held at its middle line alone, a solid gives way locally, and the limit load falls by 3 %).
CalculiX' own quadratic shells do not serve here: they clamp that edge.
"""

import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from phytac_shapes.errors import NumericalError

LAYERS = 2
"""Bricks through the thickness; the middle face is where they meet."""
ABOUT = 2 * LAYERS
MODULUS_MPa, POISSON = 3102.75, 0.3
QUARTER_N = 750.0
"""Force on the quarter at load factor 1."""
BRICK = (
    *((0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)),
    *((1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)),
    *((0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)),
)
"""Nodes of a brick in half elements."""
Grid = dict[tuple[int, int, int], int]


def solid_roof(
    folder: Path,
    n: int,
    *,
    thickness_mm: float,
    sags_mm: Iterable[float],
    flatter: float = 1.0,
    neo_hooke: bool = False,
) -> list[float]:
    """Load factors at given sags of the middle; ``ccx`` must be on PATH.

    Parameters
    ----------
    folder : Path
        Where the job runs.
    n : int
        Bricks along each side of the quarter.
    thickness_mm : float
        Wall thickness h.
    sags_mm : iterable of float
        Sags, in order, mm.
    flatter : float
        k: the radius grows k times and the half-angle shrinks k times (the width stays). With h
        and the sags k times smaller, shallow-shell theory gives the same load over k⁴, and effects
        of finite strain and thickness shrink k² times.
    neo_hooke : bool
        Neo-Hookean instead of CalculiX' linear law between Green-Lagrange strains and second
        Piola-Kirchhoff stresses, with the same E and ν.

    Raises
    ------
    NumericalError
        If CalculiX does not finish.
    """
    sags = list(sags_mm)
    grid, lines = _mesh(n, thickness_mm, flatter)
    G = MODULUS_MPa / (2.0 * (1.0 + POISSON))
    bulk = MODULUS_MPa / (3.0 * (1.0 - 2.0 * POISSON))
    law = (
        ("*HYPERELASTIC, NEO HOOKE", f"{G / 2.0:.15g}, {2.0 / bulk:.15g}")
        if neo_hooke
        else ("*ELASTIC", f"{MODULUS_MPa}, {POISSON}")
    )
    lines += ["*MATERIAL, NAME=M", *law, "*SOLID SECTION, ELSET=SOLID, MATERIAL=M"]
    lines += _supports(grid, n)
    middle = [grid[0, 0, k] for k in range(ABOUT + 1)]
    lines += ["*NSET, NSET=MIDDLE", ", ".join(map(str, middle))]
    for sag in sags:
        lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", "0.5, 1.", "*BOUNDARY"]
        lines += [f"{node}, 3, 3, {-sag:.12g}" for node in middle]
        lines += ["*NODE PRINT, NSET=MIDDLE, TOTALS=ONLY", "RF", "*END STEP"]
    (folder / "roof.inp").write_text("\n".join(lines) + "\n", encoding="ascii")
    run = subprocess.run(["ccx", "roof"], cwd=folder, capture_output=True, text=True, check=False)
    found: dict[float, float] = {}
    time = 0.0
    for line in (folder / "roof.dat").read_text(encoding="ascii").splitlines():
        words = line.split()
        if "time" in words:
            time = float(words[-1])
        elif len(words) == 3:
            found[time] = -float(words[2]) / QUARTER_N
    if run.returncode or any(float(k + 1) not in found for k in range(len(sags))):
        raise NumericalError("calculix-failed", f"ccx did not finish: {run.stdout[-400:]}")
    return [found[float(k + 1)] for k in range(len(sags))]


def _mesh(n: int, thickness: float, flatter: float) -> tuple[Grid, list[str]]:
    half = 2 * n
    grid: Grid = {}
    lines = ["*NODE, NSET=ALL"]
    for i in range(half + 1):
        for j in range(half + 1):
            for k in range(ABOUT + 1):
                if i % 2 + j % 2 + k % 2 > 1:
                    continue
                grid[i, j, k] = len(grid) + 1
                radius = 2540.0 * flatter + (k / ABOUT - 0.5) * thickness
                angle = 0.1 / flatter * i / half
                x, y, z = radius * np.sin(angle), 254.0 * j / half, radius * np.cos(angle)
                lines.append(f"{len(grid)}, {x:.14e}, {y:.14e}, {z:.14e}")
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=SOLID")
    corners = [
        (i, j, k) for i in range(0, half, 2) for j in range(0, half, 2) for k in range(0, ABOUT, 2)
    ]
    for number, (i, j, k) in enumerate(corners, start=1):
        nodes = [str(grid[i + x, j + y, k + z]) for x, y, z in BRICK]
        lines += [f"{number}, {', '.join(nodes[:15])},", ", ".join(nodes[15:])]
    return grid, lines


def _supports(grid: Grid, n: int) -> list[str]:
    """Symmetry at i = 0 and j = 0; at the hinge the middle held, the section straight."""
    held, ties = ["*BOUNDARY"], []
    for (i, j, k), node in grid.items():
        held += [f"{node}, 1, 1"] if i == 0 else []
        held += [f"{node}, 2, 2"] if j == 0 else []
        if i < 2 * n:
            continue
        axes = (1, 3) if j == 0 else (1, 2, 3)
        if k == LAYERS:
            held += [f"{node}, {axis}, {axis}" for axis in axes]
        elif k < ABOUT:  # motion over the thickness is that of the top, in proportion
            share = k / LAYERS - 1.0
            top = grid[i, j, ABOUT]
            ties += [
                line
                for axis in axes
                for line in ("*EQUATION", "2", f"{node}, {axis}, 1., {top}, {axis}, {-share:.15g}")
            ]
    return ties + held
