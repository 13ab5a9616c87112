r"""Deflection of a thin wall under a contact in closed form: a surrogate of finite elements.

The shallow-shell equations of Donnell, Mushtari and Vlasov for a wall of thickness t and modulus E
with curvatures k_u, k_v (V. Z. Vlasov, General theory of shells, 1949), D = E t³/12(1 - ν²)::

    D ∇⁸ w + E t (k_v ∂²/∂x² + k_u ∂²/∂y²)² w = ∇⁴ p

solved on the sensor's flattened face, simply supported at open edges (sines), periodic where it
closes around (Timoshenko, Woinowsky-Krieger, Theory of plates and shells, 1959, §28, §34)::

    w(x, y) = Σ p_mn sin(a x) cos(b (y - y0)) / (D q² + E t (k_v a² + k_u b²)² / q²)    q = a² + b²

The load is a disc of uniform pressure. On a sphere without edges this is Reissner's solution, at
its centre w = √12(1 - ν²) P R / 8 E t². Curvatures are those at the load, rims (in fact clamped)
are simply supported, receptors and holes are neglected: accurate to some tens of per cent on tubes
and domes, 9 to 13 times too soft on flat walls, and good for ranking designs of one shape.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from phytac_decoder.camera.camera import Camera, stack_views
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.cramer_rao import CramerRaoBound, cell_prior, contact_signals
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

FORCE_N = 10.0
"""Force at which bounds are stated."""


@dataclass(frozen=True, kw_only=True)
class Flat:
    """The outer face unrolled around a load.

    ``length`` and ``girth`` mm along and around, whether it closes around, and the curvatures along
    and around at the load, 1/mm, positive where the face is convex.
    """

    length: float
    girth: float
    closed: bool
    k_u: float
    k_v: float


class MetricLengths:
    """Lengths along and around a surface from its metric."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        (u0, u1), (v0, v1) = surface.domain
        self.edges = np.linspace(u0, u1, 129)
        middle = (self.edges[:-1] + self.edges[1:]) / 2.0
        metric = surface.metric(np.column_stack([middle, np.full(len(middle), (v0 + v1) / 2.0)]))
        steps = np.sqrt(metric[:, 0, 0]) * np.diff(self.edges)
        self.along = np.concatenate([[0.0], np.cumsum(steps)])
        self.width = (v1 - v0) * np.sqrt(metric[:, 1, 1])
        self.middle = middle

    def x_mm(self, uv: FloatArray) -> FloatArray:
        """Length (n,) along from the near end."""
        return np.asarray(np.interp(uv[:, 0], self.edges, self.along))

    def girth_mm(self, u: FloatArray) -> FloatArray:
        """Length (n,) once around."""
        return np.asarray(np.interp(u, self.middle, self.width))

    def y_mm(self, uv: FloatArray, source: FloatArray) -> FloatArray:
        """Length (n,) around from a source (2,), the short way, at the mean height."""
        v0, v1 = self.surface.domain[1]
        away = uv[:, 1] - source[1]
        if self.surface.periodic[1]:
            away = (away + (v1 - v0) / 2.0) % (v1 - v0) - (v1 - v0) / 2.0
        return np.asarray(away / (v1 - v0) * self.girth_mm((uv[:, 0] + source[0]) / 2.0))

    def at(self, sources: FloatArray) -> list[Flat]:
        """The face unrolled around each of some sources (s, 2); not too narrow near a pole."""
        girth = np.maximum(self.girth_mm(sources[:, 0]), 0.3 * float(self.width.max()))
        bent = curvatures(self.surface, sources)
        return [
            Flat(
                length=float(self.along[-1]),
                girth=float(own),
                closed=self.surface.periodic[1],
                k_u=float(k_u),
                k_v=float(k_v),
            )
            for own, (k_u, k_v) in zip(girth, bent, strict=True)
        ]


def curvatures(surface: Surface, uv: FloatArray) -> FloatArray:
    """Curvatures (n, 2) along the chart's lines, 1/mm, positive where the outer face is convex."""
    out = []
    for axis, (low, high) in enumerate(surface.domain):
        step = np.zeros(2)
        step[axis] = 1e-4 * (high - low)
        inner = np.clip(uv, surface.domain[:, 0] + step, surface.domain[:, 1] - step)
        tangent = surface.tangents(inner)[:, axis]
        turn = (surface.normal(inner + step) - surface.normal(inner - step)) / (2.0 * step[axis])
        size = np.maximum(np.sum(tangent**2, axis=1), 1e-12)
        out.append(np.sum(turn * tangent, axis=1) / size)
    return np.stack(out, axis=1)


@dataclass(frozen=True, kw_only=True)
class Wall:
    """Thickness mm, modulus MPa and Poisson's ratio of a wall."""

    thickness: float
    modulus: float
    poisson: float

    @property
    def stiffness(self) -> float:
        """Bending stiffness D, N mm."""
        return self.modulus * self.thickness**3 / (12.0 * (1.0 - self.poisson**2))


@dataclass(frozen=True, kw_only=True)
class Deflection:
    """Deflection per newton as waves: amplitudes (m, k), wave numbers (m,), (k,) 1/mm."""

    amplitude: FloatArray
    a: FloatArray
    b: FloatArray

    def motion(self, along: tuple[FloatArray, FloatArray], y: FloatArray) -> FloatArray:
        """Inward motion (mm/N) and its slopes along and around at n points, (n, 3).

        ``along`` is :func:`waves_along` of the points, ``y`` (n,) their lengths around.
        """
        sine, cosine = along
        # Powers of one phase factor: far cheaper than a cosine for each wave.
        turn = np.repeat(np.exp(1j * self.b[1] * y)[:, None], len(self.b), axis=1)
        turn[:, 0] = 1.0
        around = np.cumprod(turn, axis=1)
        mixed = sine @ self.amplitude
        return np.stack(
            [
                np.einsum("nk,nk->n", mixed, around.real),
                np.einsum("nk,nk->n", cosine @ self.amplitude, around.real),
                -np.einsum("nk,nk,k->n", mixed, around.imag, self.b),
            ],
            axis=1,
        )

    def bending(self, x: float) -> float:
        """Greatest second derivative of the motion at (x, 0), 1/mm per newton."""
        sine = np.sin(self.a * x)
        along = float(np.sum((sine * self.a**2) @ self.amplitude))
        around = float(np.sum((sine @ self.amplitude) * self.b**2))
        return max(abs(along), abs(around))


def waves_along(length: float, x: FloatArray, waves: int = 36) -> tuple[FloatArray, FloatArray]:
    """Sines of a face's waves along at x (n,), and their slopes, (n, m) each."""
    a = np.pi * np.arange(1.0, waves + 1.0) / length
    return np.sin(np.outer(x, a)), np.cos(np.outer(x, a)) * a


def deflection_under_disc(
    wall: Wall, flat: Flat, x: float, radius_mm: float, waves: int = 36
) -> Deflection:
    """Deflection under a disc of a radius at length x, 1 N inward."""
    a: FloatArray = np.pi * np.arange(1.0, waves + 1.0) / flat.length
    # A face that does not close is taken as one of twice its width that does: no edge is near.
    period = flat.girth if flat.closed else 2.0 * flat.girth
    b: FloatArray = 2.0 * np.pi * np.arange(0.0, float(waves)) / period
    q = a[:, None] ** 2 + b[None] ** 2
    curved = flat.k_v * a[:, None] ** 2 + flat.k_u * b[None] ** 2
    stretch = wall.modulus * wall.thickness
    resistance = wall.stiffness * q**2 + stretch * (curved / q) ** 2
    reach = np.sqrt(q) * max(radius_mm, 1e-6)
    load = np.where(reach > 1e-6, 2.0 * j1(reach) / np.maximum(reach, 1e-12), 1.0)
    twice = np.where(np.arange(waves) == 0, 1.0, 2.0)
    share = 2.0 / (flat.length * period) * np.sin(a * x)[:, None] * twice
    return Deflection(amplitude=share * load / resistance, a=a, b=b)


def tip_basis(sensor: Sensor) -> FloatArray:
    """Motion (n, 3, 3) of receptors' tips by the wall's motion inwards and its slopes (columns).

    The wall's normal leans to where it moves in farther, and the tips, on its inner side, away.
    """
    surface, markers = sensor.surface, sensor.markers
    tangents = surface.tangents(markers.uv)
    unit = tangents / np.maximum(np.linalg.norm(tangents, axis=2, keepdims=True), 1e-12)
    arm = markers.height_mm + sensor.design.wall.thickness_mm / 2.0
    along, around = (-arm[:, None] * unit[:, axis] for axis in range(2))
    return np.stack([-markers.normal, along, around], axis=2)


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Bounds at the sources (s,), and deflection mm and strain there under the greatest force."""

    bound: CramerRaoBound
    dent_mm: FloatArray
    strain: FloatArray


def predict(
    sensor: Sensor, cameras: tuple[Camera, ...], seen: BoolArray, *, sources: int = 5
) -> Predicted:
    """Cramér-Rao bound and deflections of a design by the closed form.

    Parameters
    ----------
    seen : (n,) bool
        Markers that the camera sees; the others carry no information.
    sources : int
        Receptors at which the bound is taken, from the near end to the far one.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    training, camera = design.training, design.camera
    wall = Wall(
        thickness=design.wall.thickness_mm,
        modulus=design.material.modulus_MPa,
        poisson=design.material.poisson,
    )
    unrolled = MetricLengths(surface)
    x = unrolled.x_mm(markers.uv)
    along = waves_along(float(unrolled.along[-1]), x)
    order = np.argsort(x, kind="stable")
    share = (np.arange(sources) + 0.5) / sources
    chosen = np.unique(order[(share * markers.count).astype(int)])
    slopes = np.where(seen[:, None, None], stack_views(cameras, markers.tip_mm), 0.0)
    slopes = np.nan_to_num(slopes)
    # (n, 2c, 3): px per mm of motion and per unit of slope.
    image = slopes @ tip_basis(sensor)

    def shifts(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
        each = zip(uv, radius_mm, unrolled.at(uv), unrolled.x_mm(uv), strict=True)
        motions = [
            deflection_under_disc(wall, flat, float(here), float(radius)).motion(
                along, unrolled.y_mm(markers.uv, place)
            )
            for place, radius, flat, here in each
        ]
        return np.asarray(np.einsum("nij,snj->sni", image, np.stack(motions)))

    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    signals = contact_signals(surface, shifts, uv=markers.uv[chosen], radius_mm=radius)
    prior = cell_prior(
        surface.area_mm2(),
        markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    bound = signals.bound(FORCE_N, noise_px=camera.noise_centroid_px, prior=prior)
    dents, strains = [], []
    for flat, here in zip(unrolled.at(markers.uv[chosen]), x[chosen], strict=True):
        dent = deflection_under_disc(wall, flat, float(here), training.patch_radius_min_mm)
        there = waves_along(flat.length, np.array([here]))
        dents.append(float(dent.motion(there, np.zeros(1))[0, 0]))
        strains.append(wall.thickness / 2.0 * dent.bending(float(here)))
    force = training.force_max_N
    return Predicted(bound=bound, dent_mm=force * np.array(dents), strain=force * np.array(strains))
