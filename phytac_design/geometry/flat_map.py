"""Flat maps of a surface: positions of the markers, and labels of the axes.

Three families. *Tubes* unroll: around to the right, along upwards, as seen from outside. *Sheets*
and *domes* face the camera, and are drawn as it sees them from inside, so that map and picture have
the same sense: sheets in their own two lengths, domes by the azimuthal equidistant projection from
the pole (distances from the pole are true along the surface; those around grow towards the rim).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

Topology = Literal["tube", "sheet", "dome"]


@dataclass(frozen=True, kw_only=True)
class FlatMap:
    """Places on a flat map and what is needed to draw it.

    Attributes
    ----------
    points : (n, 2) float
        Places, to the right and along the vertical axis.
    outline : tuple of (m, 2) float
        Edges of what is mapped.
    x_label, y_label : str
        Of the axes, with units.
    y_down : bool
        Whether the vertical axis points down, as in a picture.
    note : str
        How the map is drawn, for a reader.
    """

    points: FloatArray
    outline: tuple[FloatArray, ...]
    x_label: str
    y_label: str
    y_down: bool
    note: str

    @property
    def limits(self) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]] with a margin, lower values first."""
        whole = np.concatenate([self.points, *self.outline])
        low, high = np.nanmin(whole, axis=0), np.nanmax(whole, axis=0)
        margin = 0.03 * float((high - low).max())
        return np.asarray(np.stack([low - margin, high + margin]))


@dataclass(frozen=True, kw_only=True)
class DirectionNames:
    """What the two directions on a surface are called in sentences."""

    along: str
    around: str
    along_short: str
    around_short: str


DIRECTION_NAMES: dict[Topology, DirectionNames] = {
    "tube": DirectionNames(
        along="along the sensor",
        around="around the sensor",
        along_short="along",
        around_short="around",
    ),
    "sheet": DirectionNames(
        along="along the sheet's u side",
        around="along the sheet's v side",
        along_short="along u",
        around_short="along v",
    ),
    "dome": DirectionNames(
        along="along the meridian to the pole",
        around="around the axis",
        along_short="to the pole",
        around_short="around",
    ),
}


def surface_topology(surface: Surface) -> Topology:
    """Whether a surface closes around (tube), also ends in a pole (dome), or neither (sheet)."""
    if not surface.periodic[1]:
        return "sheet"
    return "dome" if any(surface.poles) else "tube"


def direction_names(surface: Surface) -> DirectionNames:
    """Names of the directions along (u) and around (v)."""
    return DIRECTION_NAMES[surface_topology(surface)]


def flat_map(surface: Surface, uv: FloatArray) -> FlatMap:
    """Map chart positions (n, 2) to the plane, mm."""
    kind = surface_topology(surface)
    if kind == "dome":
        return FlatMap(
            points=_azimuthal(surface, uv),
            outline=tuple(_azimuthal(surface, edge) for edge in _edges(surface)),
            x_label="from the pole, to the right (mm)",
            y_label="from the pole, downwards (mm)",
            y_down=True,
            note="spread out from the pole along the surface, as the camera sees it from inside",
        )
    flat = surface.unwrap(uv)
    outline = tuple(surface.unwrap(edge) for edge in _edges(surface))
    if kind == "sheet":
        middle = surface.unwrap(surface.domain.mean(axis=1)[None])
        where = "centre" if np.allclose(middle, 0.0) else "corner"
        return FlatMap(
            points=flat,
            outline=outline,
            x_label=f"across the sheet, along v, from its {where} (mm)",
            y_label=f"along u, from its {where} (mm)",
            y_down=True,
            note="laid flat, as the camera sees it from behind",
        )
    return FlatMap(
        points=flat,
        outline=outline,
        x_label="around the sensor (mm)",
        y_label="along, from the near rim (mm)",
        y_down=False,
        note="unrolled, as seen from outside",
    )


def picture_map(pixels: FloatArray, size_px: tuple[int, int], end: str = "") -> FlatMap:
    """Map of one camera's picture: places (n, 2) px, the frame (width, height) px as outline."""
    width, height = size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]]) - 0.5
    return FlatMap(
        points=pixels,
        outline=(corners,),
        x_label="picture, to the right (px)",
        y_label="picture, down (px)",
        y_down=True,
        note=f"in the picture of the {end} camera" if end else "in the camera's picture",
    )


def _edges(surface: Surface) -> list[FloatArray]:
    """Chart positions along the chart's edges, poles left out; a tube's seam is an edge of it."""
    border = 181  # points along each edge of an outline
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, border), np.linspace(v0, v1, border)
    out = [
        np.column_stack([np.full(border, at), v])
        for at, pole in zip((u0, u1), surface.poles, strict=True)
        if not pole
    ]
    if surface_topology(surface) != "dome":
        out += [np.column_stack([u, np.full(border, at)]) for at in (v0, v1)]
    return out


def _azimuthal(surface: Surface, uv: FloatArray) -> FloatArray:
    """Distance from the pole along the surface, in the direction of the angle v, (n, 2) mm."""
    end = surface.poles.index(True)
    pole = np.array([[surface.domain[0, end], np.pi]])
    away = np.abs(surface.unwrap(uv)[:, 1] - surface.unwrap(pole)[0, 1])
    return np.asarray(away[:, None] * np.column_stack([np.cos(uv[:, 1]), np.sin(uv[:, 1])]))
