"""Verification of the solid of revolution: closed forms, and a published snapping cap."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from phytac_design.mechanics.switch import switch_path
from phytac_design.mechanics.switch.bowl_mesh import AxiMesh, block, join
from phytac_design.mechanics.switch.buckling import CircumferentialModes
from phytac_design.mechanics.switch.hyperelastic import Material, Yeoh, bulk_of, neo_hookean
from phytac_design.mechanics.switch.model import AxiModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from verification.arc_length import ArcLengthControl

CAP = {"radius": 4.758, "base": 0.9, "thickness": 0.01576, "ring": 0.42}
"""Clamped cap of Mescall (1966), inches; ring load at this share of the base radius."""
NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A figure and what it should be."""

    value: float
    exact: float

    @property
    def error(self) -> float:
        """Relative error."""
        return abs(self.value / self.exact - 1.0)


@dataclass(frozen=True, kw_only=True)
class StVenantKirchhoff:
    """W = ½ Λ (Σe)² + μ Σe², e = ½ (λ² − 1): linear in Green's strain, for small strains.

    Attributes
    ----------
    modulus_MPa, poisson : float
        Young's modulus and Poisson's ratio.
    """

    modulus_MPa: float
    poisson: float

    @property
    def bulk_MPa(self) -> float:
        """None is projected."""
        return 0.0

    def derivatives(self, stretch: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :class:`Material`."""
        shear = self.modulus_MPa / (2.0 * (1.0 + self.poisson))
        lame = 2.0 * shear * self.poisson / (1.0 - 2.0 * self.poisson)
        # (λ − 1)(λ + 1) keeps the digits of small strains that λ² − 1 loses.
        strain = 0.5 * (stretch - 1.0) * (stretch + 1.0)
        trace = strain.sum(axis=-1)
        stress = lame * trace[..., None] + 2.0 * shear * strain
        energy = 0.5 * np.sum(stress * strain, axis=-1)
        curve = lame * stretch[..., :, None] * stretch[..., None, :]
        np.einsum("...ii->...i", curve)[...] += stress + 2.0 * shear * stretch**2
        return energy, stress * stretch, curve

    def scaled(self, factor: float) -> "StVenantKirchhoff":
        """Return the material with all stresses multiplied."""
        return replace(self, modulus_MPa=self.modulus_MPa * factor)


def rectangle(
    inner_mm: float, outer_mm: float, height_mm: float, cells: tuple[int, int]
) -> AxiMesh:
    """Ring of rectangular section from r = ``inner_mm`` to ``outer_mm`` and z = 0 to the height."""
    r = np.linspace(inner_mm, outer_mm, 2 * cells[0] + 1)
    low = np.stack([r, np.zeros_like(r)], axis=1)
    return join([block(low, low + np.array([0.0, height_mm]), cells[1])])


def cap(radius_mm: float, base_mm: float, thickness_mm: float, cells: tuple[int, int]) -> AxiMesh:
    """Spherical cap of mid-surface radius and base radius, its edge along the normal, apex on +z.

    Nodes lie at equal steps of r on the mid-surface; z = 0 in the base's plane.
    """
    angle = np.arcsin(np.linspace(0.0, base_mm / radius_mm, 2 * cells[0] + 1))
    normal = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    drop = np.array([0.0, radius_mm * np.cos(angle[-1])])
    half = 0.5 * thickness_mm
    return join(
        [block((radius_mm - half) * normal - drop, (radius_mm + half) * normal - drop, cells[1])]
    )


def quarter_sphere(inner_mm: float, outer_mm: float, cells: tuple[int, int]) -> AxiMesh:
    """Upper half of a thick hollow sphere: ``cells`` along the meridian and through the wall."""
    angle = np.linspace(0.0, 0.5 * np.pi, 2 * cells[0] + 1)
    normal = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return join([block(inner_mm * normal, outer_mm * normal, cells[1])])


def edge_load(mesh: AxiMesh, line: IntArray, traction: FloatArray) -> FloatArray:
    """Nodal forces (N, 2) of a dead traction (2m + 1, 2), MPa, along a line of nodes in order."""
    gauss, weight = np.polynomial.legendre.leggauss(3)
    value = np.stack([0.5 * gauss * (gauss - 1), 1 - gauss**2, 0.5 * gauss * (gauss + 1)], axis=1)
    slope = np.stack([gauss - 0.5, -2 * gauss, gauss + 0.5], axis=1)
    window = np.lib.stride_tricks.sliding_window_view(np.arange(len(line)), 3)[::2]
    nodes = mesh.nodes_mm[line[window]]
    at, along = value @ nodes, slope @ nodes
    area = 2.0 * np.pi * at[..., 0] * np.hypot(along[..., 0], along[..., 1]) * weight
    part = np.einsum("eg,gk,egc->ekc", area, value, value @ traction[window])
    out = np.zeros_like(mesh.nodes_mm)
    np.add.at(out, line[window], part)
    return out


def _ordered(nodes: IntArray, key: FloatArray) -> IntArray:
    return nodes[np.argsort(key[nodes])]


def _sphere(material: Material, cells: tuple[int, int]) -> tuple[AxiModel, FloatArray, int]:
    """Half of a sphere of radii 1 and 2, dead unit pressure inside, and its inner u_r."""
    mesh = quarter_sphere(1.0, 2.0, cells)
    r, z = mesh.nodes_mm.T
    held = np.zeros((len(r), 2), dtype=bool)
    held[mesh.where(z), 1] = True
    model = AxiModel(mesh=mesh, material=material, held=held, tied=NONE)
    inside = _ordered(mesh.where(np.hypot(r, z) - 1.0), np.arctan2(r, z))
    load = edge_load(mesh, inside, mesh.nodes_mm[inside])
    return model, model.reduced(load), model.node_unknown(mesh.at(1.0, 0.0), 0)


def thick_sphere(poisson: float, cells: tuple[int, int] = (8, 6)) -> Comparison:
    """Small motion of the inner wall of a thick sphere under pressure (Lamé)."""
    from scipy.sparse.linalg import spsolve

    model, load, inner = _sphere(neo_hookean(modulus_MPa=1.0, poisson=poisson), cells)
    state = model.state(np.zeros(model.count))
    assert state is not None  # noqa: S101 - the body at rest is not inside out
    moved = spsolve(state.tangent, load)
    exact = ((1.0 - 2.0 * poisson) + (1.0 + poisson) * 8.0 / 2.0) / 7.0
    return Comparison(value=float(moved[inner]), exact=exact)


def inflated_sphere(stretch: float, poisson: float = 0.4999) -> Comparison:
    """Pressure at a large stretch of the inner wall of a thick neo-Hookean sphere, μ = 1 MPa."""
    material = Yeoh(coefficients_MPa=(0.5,), bulk_MPa=bulk_of(1.0, poisson))
    model, load, inner = _sphere(material, (6, 6))
    control = switch_path.PathControl(unknown=inner, end_mm=stretch - 1.0, steps=8)
    point = switch_path.trace(model, load, control)[-1]
    outer = ((stretch**3 + 7.0) / 8.0) ** (1.0 / 3.0)

    def part(x: float) -> float:
        return 2.0 / x + 0.5 / x**4

    # The dead traction acts on the area at rest; pressure is force over the area as it is.
    return Comparison(value=point.load_factor / stretch**2, exact=part(outer) - part(stretch))


def pulled_bar(material: Material, stretch: float) -> float:
    """Nominal stress, MPa, of a bar of two elements pulled to a stretch."""
    mesh = rectangle(0.0, 1.0, 1.0, (1, 2))
    z = mesh.nodes_mm[:, 1]
    held = np.zeros((len(z), 2), dtype=bool)
    held[mesh.where(z), 1] = True
    model = AxiModel(mesh=mesh, material=material, held=held, tied=mesh.where(z - 1.0))
    top = model.node_unknown(int(model.tied[0]), 1)
    load = np.zeros(model.count)
    load[top] = np.pi
    control = switch_path.PathControl(unknown=top, end_mm=stretch - 1.0, steps=8)
    return switch_path.trace(model, load, control)[-1].load_factor


def clamped_plate(cells: int = 20, poisson: float = 0.3) -> Comparison:
    """Deflection of a thin clamped disc under pressure (Kirchhoff, and Timoshenko's shear)."""
    from scipy.sparse.linalg import spsolve

    radius, thick = 10.0, 0.2
    mesh = rectangle(0.0, radius, thick, (cells, 1))
    r, z = mesh.nodes_mm.T
    held = np.zeros((len(r), 2), dtype=bool)
    held[mesh.where(r - radius)] = True
    material = neo_hookean(modulus_MPa=1e3, poisson=poisson)
    model = AxiModel(mesh=mesh, material=material, held=held, tied=NONE)
    over = _ordered(mesh.where(z - thick), r)
    load = edge_load(mesh, over, np.tile([0.0, 1.0], (len(over), 1)))
    state = model.state(np.zeros(model.count))
    assert state is not None  # noqa: S101 - the body at rest is not inside out
    moved = spsolve(state.tangent, model.reduced(load))
    bending = 1e3 * thick**3 / (12.0 * (1.0 - poisson**2))
    shear = 1e3 / (2.0 * (1.0 + poisson))
    exact = radius**4 / (64.0 * bending) + radius**2 / (4.0 * 5.0 / 6.0 * shear * thick)
    return Comparison(value=float(moved[model.node_unknown(mesh.at(0.0, 0.1), 1)]), exact=exact)


def squeezed_ring(mode: int = 2, cells: tuple[int, int] = (1, 1)) -> Comparison:
    """Dead radial load at which a long tube buckles with ``mode`` waves (Singer and Babcock 1970).

    q = n² E′ I / R³ per unit of mid-surface for loads that keep their direction, plane strain.
    """
    radius, thick, poisson = 10.0, 0.2, 0.3
    mesh = rectangle(radius - 0.5 * thick, radius + 0.5 * thick, 0.2, cells)
    held: BoolArray = np.zeros((len(mesh.nodes_mm), 2), dtype=bool)
    held[:, 1] = True
    model = AxiModel(
        mesh=mesh,
        material=cast("Material", StVenantKirchhoff(modulus_MPa=1e3, poisson=poisson)),
        held=held,
        tied=NONE,
    )
    r, z = mesh.nodes_mm.T
    middle = _ordered(mesh.where(r - radius), z)
    load = model.reduced(edge_load(mesh, middle, np.tile([-1.0, 0.0], (len(middle), 1))))
    unknown = model.node_unknown(int(middle[0]), 0)
    stiff = 1e3 / (1.0 - poisson**2)
    exact = mode**2 * stiff * thick**3 / (12.0 * radius**3)
    waves = CircumferentialModes(model=model)
    low, high = 0.0, 4.0 * exact * radius**2 / (stiff * thick)
    load_at = 0.0
    for _ in range(14):
        way = 0.5 * (low + high)
        control = switch_path.PathControl(unknown=unknown, end_mm=-way, steps=1)
        point = switch_path.trace(model, load, control)[-1]
        load_at = point.load_factor
        low, high = (low, way) if waves.negatives(point, mode) else (way, high)
    return Comparison(value=load_at, exact=exact)


@dataclass(frozen=True, kw_only=True)
class CapPath:
    """Path of the clamped cap: apex way (in), load (lb), its slope; the load's pattern."""

    apex: FloatArray
    load: FloatArray
    slope: FloatArray
    pattern: FloatArray
    model: AxiModel
    points: list[switch_path.PathPoint]

    def extremes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Peak and valley, each as way and load, by the cubic through points and slopes."""
        from scipy.interpolate import CubicHermiteSpline

        curve = CubicHermiteSpline(self.apex, self.load, self.slope)
        turns = [float(x) for x in curve.derivative().roots() if 0.0 < x < self.apex[-1]]
        peak, valley = turns[0], turns[1]
        return (peak, float(curve(peak))), (valley, float(curve(valley)))


def clamped_cap(
    *,
    ring: bool = True,
    cells: tuple[int, int] = (50, 1),
    steps: int = 40,
    end: float = 0.09,
    scale: float = 1.0,
    arc: bool = False,
) -> CapPath:
    """Cap of 10⁷ psi and ν 0.3 under a ring load, or under a load on its apex.

    ``scale`` multiplies the wall; ``arc`` follows it by arc-length (a thinner one snaps back).
    """
    radius, base = CAP["radius"], CAP["base"]
    thick = scale * CAP["thickness"]
    mesh = cap(radius, base, thick, cells)
    drop = float(np.sqrt(radius**2 - base**2))
    angle = np.arctan2(mesh.nodes_mm[:, 0], mesh.nodes_mm[:, 1] + drop)
    held = np.zeros(mesh.nodes_mm.shape, dtype=bool)
    held[np.abs(angle - np.arcsin(base / radius)) < 1e-9] = True
    material = cast("Material", StVenantKirchhoff(modulus_MPa=1e7, poisson=0.3))
    model = AxiModel(mesh=mesh, material=material, held=held, tied=NONE)
    at = CAP["ring"] * base if ring else 0.0
    load = np.zeros(mesh.nodes_mm.shape)
    load[mesh.at(at, float(np.sqrt(radius**2 - at**2)) - drop), 1] = -1.0
    apex = model.node_unknown(mesh.at(0.0, radius - drop), 1)
    control = (ArcLengthControl if arc else switch_path.PathControl)(
        unknown=apex, end_mm=-end, steps=steps
    )
    points = switch_path.trace(model, model.reduced(load), control)
    return CapPath(
        apex=np.array([-p.unknowns[apex] for p in points]),
        load=np.array([p.load_factor for p in points]),
        slope=np.array([-1.0 / p.drive[apex] for p in points]),
        pattern=model.reduced(load),
        model=model,
        points=points,
    )
