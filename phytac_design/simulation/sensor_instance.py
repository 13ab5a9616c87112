"""One sensor instance: how it differs from its design."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.layout import Markers
from phytac_design.simulation.switch_law import SwitchLaw
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class ThicknessField:
    """Thickness over the nominal one, smooth over the wall.

    Attributes
    ----------
    mean : float
        Factor of the whole wall.
    waves : (k, 4) float
        Rows (amplitude, cycles along u, cycles along v, phase in rad) of cosine waves over the
        chart; whole cycles along periodic axes.
    domain : (2, 2) float
        The chart's (low, high) of u and v.
    """

    mean: float
    waves: FloatArray
    domain: FloatArray

    @classmethod
    def even(cls, surface: Surface) -> "ThicknessField":
        """Nominal thickness all over."""
        return cls(mean=1.0, waves=np.zeros((0, 4)), domain=surface.domain)


def thickness_factor(field: ThicknessField, uv: FloatArray) -> FloatArray:
    """Thickness over the nominal one at chart positions (m, 2), (m,).

    ``mean · (1 + Σ a cos(2π (cᵤ s + cᵥ t) + φ))`` with s and t the shares of the chart.
    """
    low, high = field.domain.T
    share = (np.asarray(uv, dtype=np.float64) - low) / (high - low)
    angle = 2.0 * np.pi * share @ field.waves[:, 1:3].T + field.waves[:, 3]
    return np.asarray(field.mean * (1.0 + np.cos(angle) @ field.waves[:, 0]))


@dataclass(frozen=True, kw_only=True)
class PrintedShell:
    """The shell of a virtual sensor.

    Attributes
    ----------
    markers : Markers
        As printed: moved along the wall, and their heights.
    wall : ThicknessField
        Thickness.
    modulus : float
        Young's modulus over the design's.
    """

    markers: Markers
    wall: ThicknessField
    modulus: float


def designed_shell(surface: Surface, markers: Markers) -> PrintedShell:
    """Shell of the design itself, without scatter."""
    return PrintedShell(markers=markers, wall=ThicknessField.even(surface), modulus=1.0)


@dataclass(frozen=True, kw_only=True)
class SensorInstance(PrintedShell):
    """A virtual sensor.

    Attributes
    ----------
    number : int
        0 is the design itself, without scatter.
    on_N, off_N : (n,) float
        Force on a footprint above which a switch comes on, and below which it goes off again.
    law : SwitchLaw, optional
        How the design's tips come out; None where all snap.
    cameras : tuple of Camera
        As mounted and focused.
    paint : (colours + 1, 3) float
        Factor on the linear RGB albedo of each of the layout's colours, and of red (last).
    """

    number: int
    on_N: FloatArray
    off_N: FloatArray
    cameras: tuple[Camera, ...]
    paint: FloatArray
    law: SwitchLaw | None = None
