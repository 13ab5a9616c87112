"""One row, or one marker: its part in the figures, and moves of it alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, with_heights
from phytac_design.simulation.cramer_rao import ContactSignals
from phytac_design.study.advice.design_evaluation import EvaluatedDesign
from phytac_design.study.advice.design_variables import (
    ROW,
    ROWS,
    DesignVariable,
    Fields,
    is_row,
    with_fields,
)
from phytac_design.study.advice.local_model import LocalModel, View
from phytac_design.study.search.surrogate import FORCE_N
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

STEP_MM = 0.5
REACH_STEPS = 8
SAME = 1e-6
"""Positions whose u differ by less than this share of the chart are one row."""
OUTLIER = 0.8
"""A row stands out if its gap is below this share of the least gap of rows apart from it."""


def rows_of(markers: Markers, span_u: float) -> IntArray:
    """Row of each marker (n,); where the layout has none, positions of one u, else each its own."""
    if markers.in_rows:
        return markers.row
    u = markers.uv[:, 0]
    order = np.argsort(u, kind="stable")
    first = np.concatenate([[0], np.diff(u[order]) > SAME * span_u])
    out = np.empty(len(u), dtype=np.int64)
    out[order] = np.cumsum(first)
    return out if out.max() < len(u) / 2 else np.arange(len(u))


def as_explicit(design: Design, markers: Markers) -> Design:
    """The same markers, listed: only then can one row be moved.

    Raises
    ------
    DesignError
        If the list is no layout.
    """
    layout = design.layout
    if layout.kind == "explicit" and layout.position_heights_mm:
        return design
    return with_fields(design, _listed(design, markers, markers.uv, markers.height_mm))


def _listed(design: Design, markers: Markers, uv: FloatArray, height_mm: FloatArray) -> Fields:
    """Fields of a layout that lists its markers."""
    colours = design.layout.colours
    fields: dict[str, object] = {
        "layout.kind": "explicit",
        "layout.positions": uv.tolist(),
        "layout.positions_csv": "",
        "layout.position_colours": [colours[k] for k in markers.colour],
        "layout.position_heights_mm": height_mm.tolist(),
    }
    regions = [region.model_dump(mode="json") for region in design.switch.regions]
    for region in regions:
        if region.get("rows"):
            first, last = region["rows"]
            inside = (markers.row >= first) & (markers.row <= last)
            region |= {"rows": None, "markers": np.flatnonzero(inside).tolist()}
            region.pop("rows")
    if regions:
        fields["switch.regions"] = regions
    return fields


def row_variables(
    base: EvaluatedDesign, row: IntArray, wanted: Iterable[int]
) -> list[DesignVariable]:
    """Heights and places of some rows; amounts are mm up, and mm away from the near end."""
    design, surface, markers = base.design, base.surface, base.markers
    per_mm = 1.0 / np.linalg.norm(surface.tangents(markers.uv)[:, 0], axis=1)
    single = len(np.unique(row)) == markers.count
    out = []
    for number in wanted:
        own = row == number
        name = f"{'marker' if single else 'row'} {number}"
        least = float(markers.height_mm[own].min())

        def raised(amount: float, own: BoolArray = own) -> Fields:
            height = np.where(own, np.maximum(markers.height_mm + amount, 0.05), markers.height_mm)
            return _listed(design, markers, markers.uv, np.asarray(np.round(height, 6)))

        def pushed(amount: float, own: BoolArray = own, name: str = name) -> Fields:
            u = markers.uv[:, 0] + np.where(own, amount * per_mm, 0.0)
            if np.any(np.diff(u) < 0.0):
                raise DesignError(
                    f"{name} would pass its neighbours (moved by {amount:g} mm); move it less"
                )
            uv = np.column_stack([u, markers.uv[:, 1]])
            return _listed(design, markers, uv, markers.height_mm)

        for what, fields in (("height", raised), ("away", pushed)):
            out.append(
                DesignVariable(
                    name=f"rows.{name} {what}",
                    unit="mm",
                    value=least if what == "height" else 0.0,
                    step=STEP_MM,
                    reach=REACH_STEPS * STEP_MM,
                    why="half a millimetre",
                    kind=ROW,
                    fields=fields,
                )
            )
    return out


def suspects(base: EvaluatedDesign, row: IntArray) -> list[int]:
    """Rows to move: few that are at fault, or one that stands out; with those next to them."""
    worst = np.unique(row[base.bad()])
    last = int(row.max())
    if len(worst) == 0:
        gap = np.minimum(base.views["gap_same_colour_px"], base.load["least_gap_same_px"])
        least = np.array([gap[row == k].min() for k in range(last + 1)])
        k = int(least.argmin())
        rest = np.delete(least, [n for n in (k - 1, k, k + 1) if 0 <= n <= last])
        worst = np.array([k] if len(rest) and least[k] < OUTLIER * rest.min() else [], dtype=int)
    if not 0 < len(worst) <= 3:
        return []
    near = np.unique(np.concatenate([worst - 1, worst, worst + 1]))
    return [int(k) for k in near if 0 <= k <= last]


def named_rows(only: Iterable[str], row: IntArray) -> set[int]:
    """Rows that are asked for by number, as ``rows.3``.

    Raises
    ------
    DesignError
        If there is no such row.
    """
    found = {int(name[len(ROWS) :]) for name in only if is_row(name)}
    last = int(row.max())
    if found and max(found) > last:
        raise DesignError(f"--only rows.{max(found)}: this design has rows 0 to {last}")
    return found


@dataclass(frozen=True, kw_only=True)
class RowSlope:
    """What half a millimetre more of one row's height does to the force over the middle heights."""

    row: int
    share: float


def row_sensitivities(probe: LocalModel, base: EvaluatedDesign, row: IntArray) -> list[RowSlope]:
    """Slopes by the height of each row, the strongest first; three looks serve all rows.

    Markers add to the Fisher information one by one, so that one row's may be exchanged for what
    it would be at another height, the shell's motion held.
    """
    views = []
    for rise in (0.0, STEP_MM, -STEP_MM):
        height = np.maximum(base.markers.height_mm + rise, 0.05)
        markers = with_heights(base.design, base.surface, base.markers, height)
        views.append(probe.view(base.design, markers=markers, held=True))
    parts = [_information(view, row) for view in views]
    whole = parts[0].sum(axis=1)
    middle = views[0].middle
    here = _force(views[0], whole)[middle].mean()
    out = []
    for k in range(parts[0].shape[1]):
        each = [
            _force(views[0], whole - parts[0][:, k] + part[:, k])[middle].mean()
            for part in parts[1:]
        ]
        out.append(RowSlope(row=k, share=float((each[0] - each[1]) / (2.0 * here))))
    return sorted(out, key=lambda slope: slope.share)


def _columns(signals: ContactSignals) -> FloatArray:
    """Derivatives (c, 2 n cameras, 4) of all coordinates by force, place and size."""
    return np.concatenate([signals.shift[:, :, None], FORCE_N * signals.slopes], axis=2)


def _information(view: View, row: IntArray) -> FloatArray:
    """Fisher information of each contact by row, (c, rows, 4, 4)."""
    G = _columns(view.signals)
    noise = view.design.camera.noise_centroid_px
    of = np.tile(np.repeat(row, 2), G.shape[1] // (2 * len(row)))
    out = np.zeros((len(G), int(row.max()) + 1, 4, 4))
    for k in range(out.shape[1]):
        own = G[:, of == k]
        out[:, k] = np.swapaxes(own, 1, 2) @ own / noise**2
    return out


def _force(view: View, information: FloatArray) -> FloatArray:
    """Bound of force (c,) of an information (c, 4, 4)."""
    prior = view.prior
    known = np.diag([0.0, prior.place_mm**-2, prior.place_mm**-2, prior.radius_mm**-2])
    return np.asarray(np.sqrt(np.linalg.inv(information + known)[:, 0, 0]))
