"""Variables of a design: fields of the design file, with steps that a workshop can make."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
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
    """

    name: str
    unit: str
    value: float
    step: float
    reach: float
    why: str
    fields: Callable[[float], Fields]
    kind: str = FREE

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
        unit = f" {self.unit}" if self.unit else ""
        if self.kind == ROW:
            return f"{self.name} by {amount:+.3g}{unit}"
        return f"{self.name} {self.value:.5g} → {self.value + amount:.5g}{unit}"


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


def choose(variables: list[DesignVariable], only: list[str]) -> list[DesignVariable]:
    """Variables of some names, or of some tables (``layout``, ``rows``); all if none is given.

    Raises
    ------
    DesignError
        If a name is neither.
    """
    known = {name for one in variables for name in (one.name, one.name.partition(".")[0])}
    for name in only:
        if name not in known | {"rows"} and not is_row(name):
            listed = ", ".join(one.name for one in variables)
            raise DesignError(
                "variable-unknown",
                f"--only {name!r}: no such variable (this design has {listed}, rows, rows.0)",
            )
    if not only:
        return variables
    return [one for one in variables if {one.name, one.name.partition(".")[0]} & set(only)]


def variables_of(
    design: Design, markers: Markers, stand_off_mm: float | None
) -> list[DesignVariable]:
    """All variables that a design has, with their values.

    Parameters
    ----------
    stand_off_mm : float or None
        Of its first camera; None where that is not known.
    """
    camera, material, bar = design.camera, design.material, design.light.bar_radius_mm
    resin, lens = _rounded(0.05 * material.modulus_MPa), _rounded(0.02 * camera.focal_px)
    out = [
        _field(
            design, "wall.thickness_mm", 0.05, 0.125 * design.wall.thickness_mm, "a printed layer"
        ),
        _field(design, "material.modulus_MPa", resin, 4.0 * resin, "another resin", CHOICE),
        *_heights(design),
        *_layout(design, markers),
        _field(design, "receptor.diameter_outer_mm", 0.1, 0.3, "two layers"),
    ]
    if design.receptor.band_marker_mm > 0.0:
        out.append(_field(design, "receptor.band_marker_mm", 0.1, 0.3, "a pen's stroke"))
    if design.receptor.direction == "tilted":
        out.append(_field(design, "receptor.tilt_deg", 1.0, 4.0, "a degree"))
    out.append(_field(design, "camera.focal_px", lens, 5.0 * lens, "another lens", CHOICE))
    if stand_off_mm is not None:
        value = round(stand_off_mm, 2)
        out.append(_field(design, "camera.stand_off_mm", 0.5, 2.0, "a spacer", value=value))
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


def _layout(design: Design, markers: Markers) -> list[DesignVariable]:
    layout = design.layout
    if layout.kind == "explicit":
        return []
    if layout.kind == "phyllotaxis":
        step = max(1, round(0.02 * markers.count))
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
