r"""What the neighbour of a pressed switch on a strip feels: a solid of two bowls and their web.

Half of it, mirrored in y = 0. Bowl A stands at the origin, B at the pitch; stems end at the shell's
face. Pads are pressed (A) and held (B, as by a hand that rests on it)::

         A pad ↓                  B pad held
          .--.                     .--.
         /    \___________________/    \____     web, glued along its foot or loose
    ____|______|__glued rims_____|______|____    the shell's face, z = 0

The share is B's reaction over A's. Linear, and with large strain of the rubber's own law.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from phytac_design.mechanics.shell.mesh_writers import inp_material, inp_set, write_lines
from phytac_design.mechanics.solid.solid_writers import inp_solid
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra, tetrahedra
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_shapes.arrays import FloatArray, IntArray
from verification.bowl_calculix import hyperelastic_lines
from verification.calculix import run_ccx

Web = Literal["glued", "loose", "none"]


@dataclass(frozen=True, kw_only=True)
class BowlPair:
    """Two neighbours on a strip; mm.

    Attributes
    ----------
    profile : (k, 2) float
        Half section of the switch, as ``SwitchSet.profile`` gives it.
    pitch_mm : float
        Distance of the axes.
    web_mm, web_width_mm : float
        Thickness of the web, and its width, here the same all the way up.
    pad_radius_mm : float
        Radius of the pads that are moved and held.
    """

    profile: FloatArray
    pitch_mm: float
    web_mm: float
    web_width_mm: float
    pad_radius_mm: float


@dataclass(frozen=True, kw_only=True)
class PairForces:
    """Forces on the pads of a pair, N, at each printed time.

    Attributes
    ----------
    pressed_N, neighbour_N : (t,) float
        Along z, as the hand presses: positive inwards.
    nodes : int
        Nodes of the mesh.
    """

    pressed_N: FloatArray
    neighbour_N: FloatArray
    nodes: int

    @property
    def share(self) -> FloatArray:
        """Neighbour's force over that of the pressed one, without sign, (t,)."""
        return np.asarray(np.abs(self.neighbour_N) / np.abs(self.pressed_N))


def pair_mesh(pair: BowlPair, size_mm: float, *, web: bool = True) -> Tetrahedra:
    """Mesh of half the pair: ``size_mm`` in the bowls, up to twice it in the web."""
    rim = int(pair.profile[:, 0].argmax())
    profile = _cut_at_face(pair.profile)
    inside = np.array([[0.0, pair.profile[0, 1]], *pair.profile[1 : rim + 1], [0.0, 0.0]])
    at = (0.0, pair.pitch_mm)
    stub = 0.5 * pair.pitch_mm

    def turned(occ: Any, line: FloatArray, x: float) -> Any:
        points = [occ.addPoint(x + float(r), 0.0, float(z)) for r, z in line]
        ring = zip(points, [*points[1:], points[0]], strict=True)
        face = occ.addPlaneSurface([occ.addCurveLoop([occ.addLine(a, b) for a, b in ring])])
        parts = occ.revolve([(2, face)], x, 0.0, 0.0, 0.0, 0.0, 1.0, np.pi)
        return next(part for part in parts if part[0] == 3)

    def build(gmsh: Any) -> None:
        occ = gmsh.model.occ
        bowls = [turned(occ, profile, x) for x in at]
        if not web:
            return
        half = 0.5 * pair.web_width_mm
        bar = occ.addBox(-stub, 0.0, 0.0, pair.pitch_mm + 2.0 * stub, half, pair.web_mm)
        hollow = [turned(occ, inside, x) for x in at]
        bars = occ.cut([(3, bar)], hollow)[0]
        occ.fuse(bowls, bars)

    def size(gmsh: Any) -> int:
        field, tags = gmsh.model.mesh.field, []
        for x in at:
            tag = field.add("Cylinder")
            reach = float(pair.profile[:, 0].max()) + 2.0 * size_mm
            for name, number in (
                ("VIn", size_mm),
                ("VOut", 2.0 * size_mm),
                ("Radius", reach),
                ("XCenter", x),
                ("ZAxis", 100.0),
            ):
                field.setNumber(tag, name, number)
            tags.append(tag)
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", tags)
        return int(least)

    return tetrahedra(build, size)


def _cut_at_face(profile: FloatArray) -> FloatArray:
    """Section without its stem below z = 0."""
    (r0, z0), (r1, z1) = profile[-3:-1]
    share = z0 / (z0 - z1)
    return np.concatenate([profile[:-2], [[r0 + share * (r1 - r0), 0.0], [0.0, 0.0]]])


def pair_forces(
    pair: BowlPair,
    material: Material,
    *,
    web: Web,
    stroke_mm: float,
    steps: int = 0,
    size_mm: float = 0.11,
) -> PairForces:
    """Press A's pad by a stroke, B's held, and read both forces.

    Parameters
    ----------
    web : str
        ``glued`` along its foot; ``loose``, where only the bowls' rims are; ``none``.
    steps : int
        Equal steps with large strain; 0 for a linear job.

    Raises
    ------
    MissingPartError
        If Gmsh or CalculiX is not installed.
    NumericalError
        If meshing or solving fails.
    """
    mesh = pair_mesh(pair, size_mm, web=web != "none")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "pair.inp"
        write_lines(path, _job(pair, mesh, material, web, stroke_mm, steps))
        times = run_ccx(path)
    # Half of the solid: twice the force.
    pads = [
        np.array([-2.0 * float(time["forces", name][1][:, 2].sum()) for time in times])
        for name in ("PAD_A", "PAD_B")
    ]
    return PairForces(pressed_N=pads[0], neighbour_N=pads[1], nodes=len(mesh.nodes_mm))


def _sets(pair: BowlPair, mesh: Tetrahedra, web: Web) -> dict[str, IntArray]:
    near = 1e-6
    x, y, z = mesh.nodes_mm.T
    top, rim = float(pair.profile[0, 1]), float(pair.profile[:, 0].max())
    stem = float(_cut_at_face(pair.profile)[-2, 0])
    axis = np.stack([np.hypot(x - at, y) for at in (0.0, pair.pitch_mm)])
    pads = [(z > top - near) & (away < pair.pad_radius_mm + near) for away in axis]
    foot = (z < near) & (axis.min(axis=0) > stem + 0.05)
    if web != "glued":
        foot &= axis.min(axis=0) < rim + near
    return {
        "PAD_A": np.flatnonzero(pads[0]),
        "PAD_B": np.flatnonzero(pads[1]),
        "FOOT": np.flatnonzero(foot),
        "MIRROR": np.flatnonzero((y < near) & ~foot & ~pads[0] & ~pads[1]),
    }


def _job(
    pair: BowlPair,
    mesh: Tetrahedra,
    material: Material,
    web: Web,
    stroke_mm: float,
    steps: int,
) -> Iterator[str]:
    sets = _sets(pair, mesh, web)
    yield from inp_solid(mesh, {}, "two bowls on a web")
    for name, nodes in sets.items():
        yield from inp_set("NSET", name, nodes)
    if steps:
        yield from hyperelastic_lines(material)
    else:
        shear, bulk = material.shear_MPa, material.bulk_MPa
        modulus = 9.0 * bulk * shear / (3.0 * bulk + shear)
        yield from inp_material(modulus, modulus / (2.0 * shear) - 1.0, name="RUBBER")
    yield "*SOLID SECTION, ELSET=SHELL, MATERIAL=RUBBER"
    yield from ("*BOUNDARY", "FOOT, 1, 3", "PAD_B, 1, 3", "PAD_A, 1, 2", "MIRROR, 2, 2")
    if steps:
        yield from ("*STEP, NLGEOM, INC=500", "*STATIC, DIRECT", f"{1.0 / steps:.9g}, 1.")
    else:
        yield from ("*STEP", "*STATIC")
    yield from ("*BOUNDARY", f"PAD_A, 3, 3, {-stroke_mm:.9e}")
    yield from ("*NODE PRINT, NSET=PAD_A", "RF", "*NODE PRINT, NSET=PAD_B", "RF", "*END STEP")
