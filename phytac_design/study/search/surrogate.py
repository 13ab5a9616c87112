r"""Deflection of a thin wall under a contact in closed form: a surrogate of finite elements.

The shallow-shell equations of Donnell, Mushtari and Vlasov for a wall of thickness t and modulus E
with curvatures k_u, k_v (V. Z. Vlasov, General theory of shells, 1949), D = E t³/12(1 - ν²)::

    D ∇⁸ w + E t (k_v ∂²/∂x² + k_u ∂²/∂y²)² w = ∇⁴ p

on the sensor's flattened face, by products of the vibration modes of a clamped beam along and,
where the face does not close, around, and of cosines where it closes (the diagonal of Galerkin's
equations; A. W. Leissa, Vibration of plates, NASA SP-160, 1969, §1)::

    w(x, y) = Σ p_mn φ_m(x) ψ_n(y) / (D r_mn + E t (k_v a_m² + k_u b_n²)² / (a_m² + b_n²)²)
    r_mn = ∫φ_m''² + 2 a_m² b_n² + ∫ψ_n''²    a_m² = ∫φ_m'²    b_n² = ∫ψ_n'²    (means of the face)

The load is a disc of uniform pressure. On a sphere without edges this is Reissner's solution, at
its centre w = √12(1 - ν²) P R / 8 E t². A pole is no edge: the face continues beyond it. Curvatures
are the means of a quarter of the girth around the load. Receptors and holes change both stiffnesses
by the mean of their factors (:mod:`phytac_design.mechanics.shell.receptor_stiffness`).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import j1

from phytac_decoder.camera.camera import Camera, stack_views
from phytac_design.core.kernels import kernel
from phytac_design.design.spec import Design
from phytac_design.geometry.curvature import curvatures
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.receptor_stiffness import mean_factors
from phytac_design.simulation.cramer_rao import CramerRaoBound, cell_prior, contact_signals
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.discs import cut_disc_centroid

FORCE_N = 10.0
"""Force at which bounds are stated."""


@dataclass(frozen=True, kw_only=True)
class Flat:
    """The outer face unrolled around a load.

    ``length`` and ``girth`` mm along and around, whether it closes around, and the mean curvatures
    along and around near the load, 1/mm, positive where the face is convex. Ends that do not close
    are clamped.
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
        # Beyond a pole the face continues by its own length.
        near, far = surface.poles
        self.before = float(self.along[-1]) * near
        self.length = float(self.along[-1]) * (1.0 + near + far)

    def x_mm(self, uv: FloatArray) -> FloatArray:
        """Length (n,) along from the near end."""
        return np.asarray(self.before + np.interp(uv[:, 0], self.edges, self.along))

    def girth_mm(self, u: FloatArray) -> FloatArray:
        """Length (n,) once around."""
        return np.asarray(np.interp(u, self.middle, self.width))

    def y_mm(self, uv: FloatArray, source: FloatArray) -> FloatArray:
        """Length (n,) around: from a source (2,) the short way if it closes, else from its edge.

        Also from sources (2, n), one for each point.
        """
        v0, v1 = self.surface.domain[1]
        if not self.surface.periodic[1]:
            return np.asarray((uv[:, 1] - v0) / (v1 - v0) * self.girth_mm(source[0]))
        away = (uv[:, 1] - source[1] + (v1 - v0) / 2.0) % (v1 - v0) - (v1 - v0) / 2.0
        return np.asarray(away / (v1 - v0) * self.girth_mm((uv[:, 0] + source[0]) / 2.0))

    def at(self, sources: FloatArray) -> list[Flat]:
        """The face unrolled around each of some sources (s, 2); not too narrow near a pole."""
        girth = np.maximum(self.girth_mm(sources[:, 0]), 0.3 * float(self.width.max()))
        # A flat side between rounded edges is held by them: curvatures of a quarter of the girth.
        around = np.linspace(-0.125, 0.125, 9) * np.ptp(self.surface.domain[1])
        near = sources[:, None] + np.stack([0.0 * around, around], axis=1)
        bent = curvatures(self.surface, near.reshape(-1, 2)).reshape(-1, 9, 2).mean(axis=1)
        return [
            Flat(
                length=self.length,
                girth=float(own),
                closed=self.surface.periodic[1],
                # Equal curvatures are equal numbers, so that they are looked up.
                k_u=round(float(k_u), 12),
                k_v=round(float(k_v), 12),
            )
            for own, (k_u, k_v) in zip(girth, bent, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class Wall:
    """Bending stiffness D (N mm) and stretching stiffness E t (N/mm) of a wall, thickness mm."""

    bending: float
    stretching: float
    thickness: float


def wall_of(design: Design, markers: Markers, area_mm2: float) -> Wall:
    """Wall of a design with the mean effect of its receptors, if that is known."""
    t, modulus, poisson = (
        design.wall.thickness_mm,
        design.material.modulus_MPa,
        design.material.poisson,
    )
    stretch, bend = mean_factors(design, markers, area_mm2)
    return Wall(
        bending=bend * modulus * t**3 / (12.0 * (1.0 - poisson**2)),
        stretching=stretch * modulus * t,
        thickness=t,
    )


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Functions of one direction whose square has the mean 1 over ``length`` mm.

    Cosines of the distance from the load where the face closes, else modes of a clamped beam.

    Attributes
    ----------
    second, fourth : (m,) float
        Means of the squared slope (1/mm²) and of the squared second derivative (1/mm⁴).
    """

    length: float
    closed: bool
    number: FloatArray
    second: FloatArray
    fourth: FloatArray

    def at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and slopes (1/mm), (n, m) each, at x (n,) mm."""
        k = self.number / self.length
        if self.closed:
            value, slope = np.empty((2, len(x), len(k)))
            _cosines(x, k, value, slope)
            return value, slope
        angle = np.outer(x, k)
        sine, cosine = np.sin(angle), np.cos(angle)
        down, up, sigma = self._edges(angle)
        return down + up - cosine + sigma * sine, k * (up - down + sine + sigma * cosine)

    def second_at(self, x: float) -> FloatArray:
        """Second derivatives (m,), 1/mm²."""
        k = self.number / self.length
        if self.closed:
            return np.asarray(-np.where(k > 0.0, np.sqrt(2.0), 1.0) * k * k * np.cos(k * x))
        down, up, sigma = self._edges(k * x)
        return np.asarray(k * k * (down + up + np.cos(k * x) - sigma * np.sin(k * x)))

    def _edges(self, angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Parts of a clamped beam's modes that decay from its ends, at x times k, and sigma."""
        # (1 - sigma) exp(number) / 2 without differences of large numbers.
        n, small, sigma = self.number, np.exp(-self.number), clamped_sigma(self.number)
        end = (np.cos(n) - np.sin(n) - small) / (1.0 - small**2 - 2.0 * small * np.sin(n))
        return (1.0 + sigma) / 2.0 * np.exp(-angle), end * np.exp(angle - n), sigma


@kernel
def _cosines(x: FloatArray, k: FloatArray, value: FloatArray, slope: FloatArray) -> None:
    """Write cosines of multiples k (m,) of one wave at x (n,), whose mean square is 1, and slopes.

    By powers of one phase factor: far cheaper than a cosine for each wave.
    """
    high = np.sqrt(2.0)
    for i in range(len(x)):
        step_re, step_im = np.cos(k[1] * x[i]), np.sin(k[1] * x[i])
        re, im = 1.0, 0.0
        value[i, 0], slope[i, 0] = 1.0, 0.0
        for j in range(1, len(k)):
            re, im = re * step_re - im * step_im, re * step_im + im * step_re
            value[i, j], slope[i, j] = high * re, -high * k[j] * im


@kernel
def _sum_products(
    mixed: FloatArray, leaning: FloatArray, value: FloatArray, slope: FloatArray, out: FloatArray
) -> None:
    """Write sums (n, 3) over k of mixed value, leaning value and mixed slope, (n, k) each."""
    for i in range(len(out)):
        a, b, c = 0.0, 0.0, 0.0
        for j in range(mixed.shape[1]):
            a += mixed[i, j] * value[i, j]
            b += leaning[i, j] * value[i, j]
            c += mixed[i, j] * slope[i, j]
        out[i, 0], out[i, 1], out[i, 2] = a, b, c


def clamped_sigma(number: FloatArray) -> FloatArray:
    """(cosh - cos) / (sinh - sin) of a clamped beam's modes (m,), which cannot overflow."""
    small = np.exp(-number)
    above = 1.0 + small**2 - 2.0 * small * np.cos(number)
    return np.asarray(above / (1.0 - small**2 - 2.0 * small * np.sin(number)))


@lru_cache(maxsize=64)
def waves(length: float, *, closed: bool, count: int = 36) -> Waves:
    """Return the first ``count`` functions of a direction of a face."""
    if closed:
        number = 2.0 * np.pi * np.arange(float(count))
        second, fourth = number**2, number**4
    else:
        number = (np.arange(1.0, count + 1.0) + 0.5) * np.pi
        # Roots of cos = 1 / cosh: all but the first few have these values to machine precision.
        for _ in range(3):
            small = 2.0 * np.exp(-number) / (1.0 + np.exp(-2.0 * number))
            number = number + (np.cos(number) - small) / (np.sin(number) - small * np.tanh(number))
        slope = clamped_sigma(number) * number
        second, fourth = slope * (slope - 2.0), number**4
    return Waves(
        length=length,
        closed=closed,
        number=number,
        second=second / length**2,
        fourth=fourth / length**4,
    )


@dataclass(frozen=True, kw_only=True)
class Deflection:
    """Deflection per newton: amplitudes (m, k) of products of waves along and around."""

    amplitude: FloatArray
    along: Waves
    around: Waves

    def motion(self, along: tuple[FloatArray, ...], y: FloatArray) -> FloatArray:
        """Inward motion (mm/N) and its slopes along and around at n points, (n, 3).

        ``along`` is :meth:`Waves.at` of the points, ``y`` (n,) their lengths around.
        """
        out = np.empty((len(y), 3))
        mixed, leaning = along[0] @ self.amplitude, along[1] @ self.amplitude
        _sum_products(mixed, leaning, *self.around.at(y), out)
        return out

    def curvature(self, x: float, y: float) -> float:
        """Greatest second derivative of the motion at a point, 1/mm per newton."""
        here, there = self.along.at(np.array([x]))[0][0], self.around.at(np.array([y]))[0][0]
        along = self.along.second_at(x) @ self.amplitude @ there
        around = here @ self.amplitude @ self.around.second_at(y)
        return max(abs(float(along)), abs(float(around)))


def inside(x: float, length: float, radius_mm: float) -> float:
    """Centre of the part of a disc that lies between 0 and a length."""
    gap = min(x, length - x)
    moved = float(cut_disc_centroid(np.array(gap), max(radius_mm, 1e-6))) - gap
    return float(x + np.sign(length / 2.0 - x) * moved)


@lru_cache(maxsize=32)
def _softness(wall: Wall, flat: Flat, radius_mm: float, count: int) -> FloatArray:
    """Amplitudes (m, k) of waves by a disc's newton where all are 1, mm."""
    along = waves(flat.length, closed=False, count=count)
    around = waves(flat.girth, closed=flat.closed, count=count)
    a, b = along.second[:, None], around.second[None]
    bend = along.fourth[:, None] + 2.0 * a * b + around.fourth[None]
    curved = (flat.k_v * a + flat.k_u * b) / (a + b)
    resistance = wall.bending * bend + wall.stretching * curved**2
    reach = np.sqrt(a + b) * max(radius_mm, 1e-6)
    load = np.where(reach > 1e-6, 2.0 * j1(reach) / np.maximum(reach, 1e-12), 1.0)
    return np.asarray(load / resistance / (flat.length * flat.girth))


def deflections_under_discs(
    wall: Wall,
    flats: list[Flat],
    x: FloatArray,
    y: FloatArray,
    radius_mm: FloatArray,
    count: int = 36,
) -> list[Deflection]:
    """Deflection under each of discs (s,) at the lengths x and y, 1 N inward.

    ``flats`` are of one face: equally long, all closed or none.
    """
    along = waves(flats[0].length, closed=False, count=count)
    middle = [inside(*each) for each in zip(x, [along.length] * len(x), radius_mm, strict=True)]
    values = along.at(np.array(middle))[0]
    found = []
    for flat, value, place, radius in zip(flats, values, y, radius_mm, strict=True):
        around = waves(flat.girth, closed=flat.closed, count=count)
        across = place if flat.closed else inside(place, flat.girth, radius)
        amplitude = np.outer(value, around.at(np.array([across]))[0][0])
        amplitude *= _softness(wall, flat, float(radius), count)
        found.append(Deflection(amplitude=amplitude, along=along, around=around))
    return found


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


def spread_out(x: FloatArray, v: FloatArray, count: int) -> IntArray:
    """Ids of at most ``count`` of n markers, even along x (n,), and varied across v (n,)."""
    bands = np.array_split(np.argsort(x, kind="stable"), min(count, len(x)))
    # Multiples of the golden ratio: far from each other modulo 1, however many there are.
    share = (0.5 + 0.618034 * np.arange(len(bands))) % 1.0
    return np.array(
        [
            band[np.argsort(v[band], kind="stable")[int(each * len(band))]]
            for band, each in zip(bands, share, strict=True)
        ]
    )


class _Deflections:
    """Deflections of a sensor's wall by the closed form, along and around its unrolled face."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.unrolled = sensor, MetricLengths(sensor.surface)
        self.wall = wall_of(sensor.design, sensor.markers, sensor.surface.area_mm2())
        self.x_mm = self.unrolled.x_mm(sensor.markers.uv)
        self.along = waves(self.unrolled.length, closed=False).at(self.x_mm)

    def sources(self, count: int) -> IntArray:
        """Ids of at most ``count`` receptors, from the near end to the far one."""
        return spread_out(self.x_mm, self.sensor.markers.uv[:, 1], count)

    def dents(self, uv: FloatArray, radius_mm: FloatArray) -> list[Deflection]:
        """Deflection by a newton on each of discs (s,)."""
        unrolled = self.unrolled
        y = unrolled.y_mm(uv, uv.T)
        return deflections_under_discs(self.wall, unrolled.at(uv), unrolled.x_mm(uv), y, radius_mm)

    def greatest(self, sources: IntArray) -> tuple[FloatArray, FloatArray]:
        """Deflection mm and strain at receptors (s,) under the greatest force, least patch."""
        training, markers = self.sensor.design.training, self.sensor.markers
        deepest, strains = [], []
        least = np.full(len(sources), training.patch_radius_min_mm)
        for marker, dent in zip(sources, self.dents(markers.uv[sources], least), strict=True):
            place = markers.uv[marker]
            y = self.unrolled.y_mm(place[None], place)
            here = tuple(each[[marker]] for each in self.along)
            deepest.append(float(dent.motion(here, y)[0, 0]))
            curvature = dent.curvature(float(self.x_mm[marker]), float(y[0]))
            strains.append(self.wall.thickness / 2.0 * curvature)
        force = training.force_max_N
        return force * np.array(deepest), force * np.array(strains)


SOURCES = 5
"""Receptors at which a design is predicted."""


def strain_of(sensor: Sensor) -> float:
    """Greatest bending strain at the greatest force, as :func:`predict` finds it, alone."""
    shell = _Deflections(sensor)
    return float(shell.greatest(shell.sources(SOURCES))[1].max())


def predict(
    sensor: Sensor, cameras: tuple[Camera, ...], seen: BoolArray, *, sources: int = SOURCES
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
    shell = _Deflections(sensor)
    chosen = shell.sources(sources)
    slopes = np.where(seen[:, None, None], stack_views(cameras, markers.tip_mm), 0.0)
    slopes = np.nan_to_num(slopes)
    # (n, 2c, 3): px per mm of motion and per unit of slope.
    image = slopes @ tip_basis(sensor)

    def shifts(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
        motions = [
            dent.motion(shell.along, shell.unrolled.y_mm(markers.uv, place))
            for place, dent in zip(uv, shell.dents(uv, radius_mm), strict=True)
        ]
        return np.moveaxis(image @ np.stack(motions, axis=2), 2, 0)

    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    signals = contact_signals(surface, shifts, uv=markers.uv[chosen], radius_mm=radius)
    prior = cell_prior(
        surface.area_mm2(),
        markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    bound = signals.bound(FORCE_N, noise_px=camera.noise_centroid_px, prior=prior)
    dent_mm, strain = shell.greatest(chosen)
    return Predicted(bound=bound, dent_mm=dent_mm, strain=strain)
