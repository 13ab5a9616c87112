"""Variables of a design: fields of the design file, with steps that a workshop can make.

Single rows of markers, or single markers, are variables too; they have no field of their own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import stand_off_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.study.advice.design_evaluation import EvaluatedDesign
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

FREE, CHOICE, SIZE, COUNT, ROW = "free", "choice", "size", "count", "row"
"""Kinds of variables: free to set; parts to buy; the body; numbers of markers; one row alone."""

Fields = Mapping[str, Any]
"""Values of fields by TABLE.FIELD."""


@dataclass(frozen=True)
class DesignVariable:
    """A field, or several that change together.

    Attributes
    ----------
    name : str
        Field of the design file, or a description of several.
    unit : str
        Unit of ``value``, ``step`` and ``reach``; "" for numbers without.
    value : float
        Present value.
    step : float
        Least change that a workshop or the design file can make.
    reach : float
        Largest change for which sensitivities are trusted.
    why : str
        What the step is.
    kind : str
        ``FREE``, ``CHOICE``, ``SIZE``, ``COUNT`` or ``ROW``.
    fields : callable
        From an amount to values of fields.
    text : str
        The change for a reader where several fields change at once; "" for one value.
    """

    name: str
    unit: str
    value: float
    step: float
    reach: float
    why: str
    fields: Callable[[float], Fields]
    kind: str = FREE
    text: str = ""

    def moved(self, design: Design, amount: float) -> Design:
        """Design with this variable changed by an amount.

        Raises
        ------
        DesignError
            If a field does not take that value.
        """
        return with_fields(design, self.fields(amount))

    def amounts(self, sign: float) -> list[float]:
        """Multiples of the step within reach, the largest first; at least one step."""
        most = max(int(self.reach / self.step + 1e-9), 1)
        counts = sorted({most, max(most // 2, 1), max(most // 4, 1), 1}, reverse=True)
        return [float(np.copysign(self.step * count, sign)) for count in counts]

    def words(self, amount: float) -> str:
        """A change of this variable, for a reader."""
        if self.text:
            return self.text
        unit = f" {self.unit}" if self.unit else ""
        if self.kind == ROW:
            return f"{self.name} by {amount:+.3g}{unit}"
        return f"{self.name} {self.value:.5g} → {self.value + amount:.5g}{unit}"


def together(fields: Fields, text: str) -> DesignVariable:
    """Fields that change together, once; ``text`` is the change for a reader."""
    return DesignVariable(
        name=", ".join(fields),
        unit="",
        value=0.0,
        step=1.0,
        reach=1.0,
        why="tried as a whole",
        fields=lambda _: fields,
        text=text,
    )


def with_fields(design: Design, fields: Fields) -> Design:
    """Design with other values of fields.

    Raises
    ------
    DesignError
        If they make no valid design.
    """
    data = design.model_dump(mode="json")
    for field, value in fields.items():
        table, _, name = field.partition(".")
        data[table] = {**data[table], name: value}
    return parse_design(data, design.name)


def is_row(name: str) -> bool:
    """Whether a name is of one row, as ``rows.3``."""
    return name.startswith("rows.") and name.removeprefix("rows.").isdecimal()


def choose(variables: Sequence[DesignVariable], only: Sequence[str]) -> list[DesignVariable]:
    """Variables of some names, or of some tables (``layout``, ``rows``); all if none is given.

    Raises
    ------
    DesignError
        If a name is neither.
    """
    names = [{one.name, one.name.partition(".")[0]} for one in variables]
    for name in only:
        if name not in {"rows"}.union(*names) and not is_row(name):
            listed = ", ".join(one.name for one in variables)
            raise DesignError(
                "variable-unknown",
                f"--only {name!r}: no such variable (this design has {listed}, rows, rows.0)",
            )
    if not only:
        return list(variables)
    return [one for one, own in zip(variables, names, strict=True) if own & set(only)]


def variables_of(sensor: Sensor) -> list[DesignVariable]:
    """All variables that a design has, with their values."""
    design = sensor.design
    camera, material, bar = design.camera, design.material, design.light.bar_radius_mm
    resin, lens = _rounded(0.05 * material.modulus_MPa), _rounded(0.02 * camera.focal_px)
    layer = 0.125 * design.wall.thickness_mm
    out = [
        _field(design, "wall.thickness_mm", 0.05, layer, "a printed layer"),
        _field(design, "material.modulus_MPa", resin, 4.0 * resin, "another resin", CHOICE),
        *_heights(design),
        *_layout(design, sensor.markers.count),
        _field(design, "receptor.diameter_outer_mm", 0.1, 0.3, "two layers"),
    ]
    if design.receptor.band_marker_mm > 0.0:
        out.append(_field(design, "receptor.band_marker_mm", 0.1, 0.3, "a pen's stroke"))
    if design.receptor.direction == "tilted":
        out.append(_field(design, "receptor.tilt_deg", 1.0, 4.0, "a degree"))
    out.append(_field(design, "camera.focal_px", lens, 5.0 * lens, "another lens", CHOICE))
    value: float | str
    try:
        value = round(stand_off_mm(design, sensor.surface, sensor.cameras[0]), 2)
    except DesignError:  # one that breaks a rule
        value = camera.stand_off_mm
    if value != "fit":
        out.append(_field(design, "camera.stand_off_mm", 0.5, 2.0, "a spacer", value=float(value)))
    if bar > 0.0:
        out.append(_field(design, "light.bar_radius_mm", 0.25, 0.5, "another bar", CHOICE))
    return out + _shape(design)


def _rounded(value: float) -> float:
    """A step of three significant digits."""
    return float(f"{value:.3g}")


def _field(
    design: Design,
    field: str,
    step: float,
    reach: float,
    why: str,
    kind: str = FREE,
    value: float | None = None,
) -> DesignVariable:
    """Variable of one field that holds a number; the unit is that of the field's name."""
    table, _, name = field.partition(".")
    now = getattr(getattr(design, table), name) if value is None else value
    units = {"mm": "mm", "MPa": "MPa", "px": "px", "deg": "°"}

    def fields(amount: float) -> Fields:
        return {field: round(now + amount, None if isinstance(now, int) else 9)}

    unit = units.get(name.rpartition("_")[2], "")
    return DesignVariable(field, unit, now, step, reach, why, fields, kind)


def _heights(design: Design) -> list[DesignVariable]:
    layout = design.layout
    near, far = layout.height_near_mm, layout.height_far_mm
    own = np.array(layout.position_heights_mm)

    def scaled(amount: float) -> Fields:
        if len(own):
            return {"layout.position_heights_mm": np.round(own * (1.0 + amount), 6).tolist()}
        fields = {"layout.height_near_mm": round(near * (1.0 + amount), 6)}
        if layout.heights != "constant":
            fields["layout.height_far_mm"] = round(far * (1.0 + amount), 6)
        return fields

    name = "layout.heights (all, times)"
    out = [DesignVariable(name, "", 1.0, 0.05, 0.15, "a twentieth of each", scaled)]
    if len(own):
        return out
    if layout.heights != "constant":
        low = min(0.1, 0.2 * near)
        why = "a step of the published sensor"
        out.append(_field(design, "layout.height_far_mm", 0.5, max(0.15 * far, 0.5), why))
        out.append(_field(design, "layout.height_near_mm", low, 5.0 * low, "two layers"))
    if layout.heights in {"linear", "power"}:
        value = layout.height_exponent if layout.heights == "power" else 1.0

        def bent(amount: float) -> Fields:
            return {"layout.heights": "power", "layout.height_exponent": round(value + amount, 6)}

        name = "layout.height_exponent"
        out.append(DesignVariable(name, "", value, 0.1, 0.3, "a tenth", bent))
    if layout.heights == "line-of-sight":
        out.append(_field(design, "layout.sight_margin_mm", 0.05, 0.1, "a printed layer"))
    return out


def _layout(design: Design, count: int) -> list[DesignVariable]:
    layout = design.layout
    if layout.kind == "explicit":
        return []
    if layout.kind == "phyllotaxis":
        step = max(1, round(0.02 * count))
        return [_field(design, "layout.count", step, 2.0 * step, "markers", COUNT)]
    colours = len(layout.colours)
    out = [
        _field(design, "layout.rows", 1, 1.0, "a row", COUNT),
        _field(design, "layout.columns", colours, colours, "a column a colour", COUNT),
    ]
    if layout.rows > 2:
        out.append(_field(design, "layout.row_pitch_exponent", 0.02, 0.06, "a fiftieth"))
    if layout.kind == "spiral":
        out.append(_field(design, "layout.spiral_angle_deg", 0.5, 2.0, "half a degree"))
    return out


def _shape(design: Design) -> list[DesignVariable]:
    """Lengths of the body; those in a list change together."""
    out = []
    for name, value in design.shape.model_dump(exclude={"kind"}).items():
        field = f"shape.{name}"
        if not name.endswith("_mm") or not value:
            continue
        if isinstance(value, float) and value > 0.0:
            step = 1.0 if value >= 20.0 else 0.5
            out.append(_field(design, field, step, max(0.05 * value, step), "the body", SIZE))
        elif isinstance(value, tuple | list) and isinstance(value[0], float):
            values = np.array(value, dtype=np.float64)

            def shifted(amount: float, field: str = field, values: Any = values) -> Fields:
                return {field: np.round(values + amount, 6).tolist()}

            mean = float(values.mean())
            reach = max(0.05 * mean, 1.0)
            out.append(
                DesignVariable(
                    f"{field} (all)", "mm", _rounded(mean), 1.0, reach, "the body", shifted, SIZE
                )
            )
    return out


def rows_of(sensor: Sensor) -> IntArray:
    """Row of each marker (n,).

    Where the layout has none, markers of one u (to a millionth of the domain's span) are a row, or
    each marker is its own.
    """
    markers = sensor.markers
    if markers.in_rows:
        return markers.row
    u, span = markers.uv[:, 0], np.ptp(sensor.surface.domain[0])
    order = np.argsort(u, kind="stable")
    out = np.empty(len(u), dtype=np.int64)
    out[order] = np.cumsum(np.concatenate([[0], np.diff(u[order]) > 1e-6 * span]))
    return out if out.max() < len(u) / 2 else np.arange(len(u))


def as_explicit(sensor: Sensor) -> Design:
    """The same markers as an explicit list: only then can one row be changed.

    Raises
    ------
    DesignError
        If the list is not a valid layout.
    """
    layout, markers = sensor.design.layout, sensor.markers
    if layout.kind == "explicit" and layout.position_heights_mm:
        return sensor.design
    return with_fields(sensor.design, _listed(sensor, markers.uv, markers.height_mm))


def _listed(sensor: Sensor, uv: FloatArray, height_mm: FloatArray) -> Fields:
    """Fields of a layout that lists its markers."""
    design, markers = sensor.design, sensor.markers
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
    sensor: Sensor, row: IntArray, wanted: Iterable[int], *, step_mm: float = 0.5
) -> list[DesignVariable]:
    """Heights and places of some rows; amounts are mm up, and mm away from the near end."""
    markers = sensor.markers
    u_per_mm = 1.0 / np.linalg.norm(sensor.surface.tangents(markers.uv)[:, 0], axis=1)
    kind = "marker" if len(np.unique(row)) == markers.count else "row"
    out = []
    for number in wanted:
        own, name = row == number, f"{kind} {number}"

        def raised(amount: float, own: BoolArray = own) -> Fields:
            height = np.where(own, np.maximum(markers.height_mm + amount, 0.05), markers.height_mm)
            return _listed(sensor, markers.uv, np.asarray(np.round(height, 6)))

        def shifted(amount: float, own: BoolArray = own, name: str = name) -> Fields:
            u = markers.uv[:, 0] + np.where(own, amount * u_per_mm, 0.0)
            if np.any(np.diff(u) < 0.0):
                raise DesignError(
                    "row-passes-neighbour",
                    f"{name} would pass its neighbours (moved by {amount:g} mm); move it less",
                )
            uv = np.column_stack([u, markers.uv[:, 1]])
            return _listed(sensor, uv, markers.height_mm)

        least = float(markers.height_mm[own].min())
        reach, why = 8.0 * step_mm, "half a millimetre"
        for what, value, fields in (("height", least, raised), ("away", 0.0, shifted)):
            full = f"rows.{name} {what}"
            out.append(DesignVariable(full, "mm", value, step_mm, reach, why, fields, ROW))
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
