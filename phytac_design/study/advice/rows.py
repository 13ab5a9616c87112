"""Single rows, or single markers: their part in the figures, and changes of them alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, with_heights
from phytac_design.study.advice.design_evaluation import EvaluatedDesign
from phytac_design.study.advice.design_variables import (
    ROW,
    DesignVariable,
    Fields,
    is_row,
    with_fields,
)
from phytac_design.study.advice.local_model import ContactView, LocalModel
from phytac_design.study.search.surrogate import FORCE_N
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

STEP_MM = 0.5


def rows_of(markers: Markers, span_u: float) -> IntArray:
    """Row of each marker (n,).

    Where the layout has none, markers of one u (to a millionth of the domain's span) are a row, or
    each marker is its own.
    """
    if markers.in_rows:
        return markers.row
    u = markers.uv[:, 0]
    order = np.argsort(u, kind="stable")
    out = np.empty(len(u), dtype=np.int64)
    out[order] = np.cumsum(np.concatenate([[0], np.diff(u[order]) > 1e-6 * span_u]))
    return out if out.max() < len(u) / 2 else np.arange(len(u))


def as_explicit(design: Design, markers: Markers) -> Design:
    """The same markers as an explicit list: only then can one row be changed.

    Raises
    ------
    DesignError
        If the list is not a valid layout.
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
            first, last = region.pop("rows")
            inside = (markers.row >= first) & (markers.row <= last)
            region["markers"] = np.flatnonzero(inside).tolist()
    if regions:
        fields["switch.regions"] = regions
    return fields


def row_variables(
    base: EvaluatedDesign, row: IntArray, wanted: Iterable[int]
) -> list[DesignVariable]:
    """Heights and places of some rows; amounts are mm up, and mm away from the near end."""
    design, markers = base.design, base.markers
    u_per_mm = 1.0 / np.linalg.norm(base.surface.tangents(markers.uv)[:, 0], axis=1)
    kind = "marker" if len(np.unique(row)) == markers.count else "row"
    out = []
    for number in wanted:
        own, name = row == number, f"{kind} {number}"

        def raised(amount: float, own: BoolArray = own) -> Fields:
            height = np.where(own, np.maximum(markers.height_mm + amount, 0.05), markers.height_mm)
            return _listed(design, markers, markers.uv, np.asarray(np.round(height, 6)))

        def shifted(amount: float, own: BoolArray = own, name: str = name) -> Fields:
            u = markers.uv[:, 0] + np.where(own, amount * u_per_mm, 0.0)
            if np.any(np.diff(u) < 0.0):
                raise DesignError(
                    "row-passes-neighbour",
                    f"{name} would pass its neighbours (moved by {amount:g} mm); move it less",
                )
            uv = np.column_stack([u, markers.uv[:, 1]])
            return _listed(design, markers, uv, markers.height_mm)

        least = float(markers.height_mm[own].min())
        reach, why = 8.0 * STEP_MM, "half a millimetre"
        for what, value, fields in (("height", least, raised), ("away", 0.0, shifted)):
            full = f"rows.{name} {what}"
            out.append(DesignVariable(full, "mm", value, STEP_MM, reach, why, fields, ROW))
    return out


def suspects(base: EvaluatedDesign, row: IntArray) -> list[int]:
    """Up to three faulty rows, or an outlier by its gap, with their neighbours."""
    worst = np.unique(row[base.faulty()])
    last = int(row.max())
    if len(worst) == 0:
        gap = np.minimum(base.views["gap_same_colour_px"], base.load["least_gap_same_px"])
        least = np.array([gap[row == k].min() for k in range(last + 1)])
        k = int(least.argmin())
        rest = np.delete(least, [n for n in (k - 1, k, k + 1) if 0 <= n <= last])
        # An outlier's gap is below 0.8 of the least gap of the other rows.
        worst = np.array([k] if len(rest) and least[k] < 0.8 * rest.min() else [], dtype=int)
    if not 0 < len(worst) <= 3:
        return []
    near = np.unique(np.concatenate([worst - 1, worst, worst + 1]))
    return [int(k) for k in near if 0 <= k <= last]


def named_rows(only: Iterable[str], row: IntArray) -> set[int]:
    """Rows given by number, as ``rows.3``.

    Raises
    ------
    DesignError
        If there is no such row.
    """
    found = {int(name.removeprefix("rows.")) for name in only if is_row(name)}
    last = int(row.max())
    if found and max(found) > last:
        raise DesignError(
            "row-out-of-range", f"--only rows.{max(found)}: this design has rows 0 to {last}"
        )
    return found


@dataclass(frozen=True)
class RowSensitivity:
    """Relative change of the force bound at middle heights per half millimetre of row height."""

    row: int
    share: float


def row_sensitivities(
    model: LocalModel, base: EvaluatedDesign, row: IntArray
) -> list[RowSensitivity]:
    """Sensitivities to the height of each row, the most negative first.

    Markers add to the Fisher information one by one, so that one row's part can be exchanged for
    that at another height, with the wall motion of the base.
    """
    views, parts = [], []
    for rise in (0.0, STEP_MM, -STEP_MM):
        height = np.maximum(base.markers.height_mm + rise, 0.05)
        markers = with_heights(base.design, base.surface, base.markers, height)
        views.append(model.view(base.design, markers=markers, held=True))
        parts.append(_information(views[-1], row))
    total, middle = parts[0].sum(axis=1), views[0].middle

    def force(information: FloatArray) -> float:
        prior = views[0].prior
        known = np.diag([0.0, prior.place_mm**-2, prior.place_mm**-2, prior.radius_mm**-2])
        bound = np.sqrt(np.linalg.inv(information + known)[:, 0, 0])
        return float(bound[middle].mean())

    here, out = force(total), []
    for k in range(parts[0].shape[1]):
        up, down = (force(total - parts[0][:, k] + part[:, k]) for part in parts[1:])
        out.append(RowSensitivity(k, (up - down) / (2.0 * here)))
    return sorted(out, key=lambda one: one.share)


def _information(view: ContactView, row: IntArray) -> FloatArray:
    """Fisher information of each contact by row, (c, rows, 4, 4)."""
    signals = view.signals
    G = np.concatenate([signals.shift[:, :, None], FORCE_N * signals.slopes], axis=2)
    of = np.tile(np.repeat(row, 2), G.shape[1] // (2 * len(row)))
    rows = [G[:, of == k] for k in range(int(row.max()) + 1)]
    parts = [np.swapaxes(own, 1, 2) @ own for own in rows]
    return np.asarray(np.stack(parts, axis=1) / view.design.camera.noise_centroid_px**2)
