"""What about a design can be moved: fields, in steps that a workshop can make."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_shapes.errors import DesignError

FREE, CHOICE, SIZE, COUNT, ROW = "free", "choice", "size", "count", "row"
"""Kinds of knobs: of no matter to the user; parts to buy; the body; markers; one row alone."""
STEP_HEIGHT_MM, STEP_SHARE, STEP_RESIN = 0.5, 0.05, 0.05
SMALL_MM = 20.0
"""Shapes' lengths below this move by half a millimetre, others by one."""

ROWS = "rows."
"""How names of single rows begin."""

Fields = Mapping[str, Any]
"""Values of fields by TABLE.FIELD."""


@dataclass(frozen=True, kw_only=True)
class DesignVariable:
    """A field, or several that move together.

    Attributes
    ----------
    name : str
        Field of the design file, or a word for several.
    unit : str
        Unit of ``value``, ``step`` and ``reach``; "" for numbers without.
    value : float
        Where it stands.
    step : float
        Least change that a workshop or the design file can make.
    reach : float
        Farthest that slopes are trusted.
    why : str
        What the step is.
    kind : str
        ``FREE``, ``CHOICE``, ``SIZE``, ``COUNT`` or ``ROW``.
    fields : callable
        Amount to values of fields.
    """

    name: str
    unit: str
    value: float
    step: float
    reach: float
    why: str
    kind: str
    fields: Callable[[float], Fields]

    def moved(self, design: Design, amount: float) -> Design:
        """Design with this knob moved by an amount.

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
        """What to do, for a reader."""
        unit = f" {self.unit}" if self.unit else ""
        if self.kind == ROW:
            return f"{self.name} by {amount:+.3g}{unit}"
        return f"{self.name} {self.value:.5g} → {self.value + amount:.5g}{unit}"


def with_fields(design: Design, fields: Fields) -> Design:
    """Design with other values of fields.

    Raises
    ------
    DesignError
        If they do not go together.
    """
    data = design.model_dump(mode="json")
    for field, value in fields.items():
        table, _, name = field.partition(".")
        data[table] = {**data[table], name: value}
    return parse_design(data, design.name)


def variables_of(
    design: Design, markers: Markers, stand_off_mm: float | None
) -> list[DesignVariable]:
    """All knobs that a design has, with its own values.

    Parameters
    ----------
    stand_off_mm : float or None
        Of its first camera; None where that is not known.
    """
    found = [*_wall(design), *_heights(design), *_layout(design, markers), *_receptor(design)]
    return [*found, *_camera(design, stand_off_mm), *_shape(design)]


def is_row(name: str) -> bool:
    """Whether a name is of one row, as ``rows.3``."""
    return name.startswith(ROWS) and name[len(ROWS) :].isdecimal()


def choose(knobs: list[DesignVariable], only: list[str]) -> list[DesignVariable]:
    """Those of some names, or of some tables (``layout``, ``rows``); all if none is given.

    Raises
    ------
    DesignError
        If a name is neither.
    """
    known = {knob.name for knob in knobs} | {knob.name.partition(".")[0] for knob in knobs}
    for name in only:
        if name not in known | {"rows"} and not is_row(name):
            listed = ", ".join(knob.name for knob in knobs)
            raise DesignError(
                f"--only {name!r}: no such knob (this design has {listed}, rows, rows.0)"
            )
    if not only:
        return knobs
    return [knob for knob in knobs if {knob.name, knob.name.partition(".")[0]} & set(only)]


def _field(
    field: str, value: float, unit: str, step: float, reach: float, why: str, kind: str = FREE
) -> DesignVariable:
    """One field that holds a number."""
    whole = isinstance(value, int)

    def fields(amount: float) -> Fields:
        return {field: round(value + amount) if whole else round(value + amount, 9)}

    return DesignVariable(
        name=field, unit=unit, value=value, step=step, reach=reach, why=why, kind=kind,
        fields=fields,
    )  # fmt: skip


def _neat(value: float) -> float:
    """A step of three significant digits."""
    return float(f"{value:.3g}")


def _wall(design: Design) -> list[DesignVariable]:
    thickness, modulus = design.wall.thickness_mm, design.material.modulus_MPa
    resin = _neat(STEP_RESIN * modulus)
    return [
        _field("wall.thickness_mm", thickness, "mm", 0.05, 0.125 * thickness, "a printed layer"),
        _field("material.modulus_MPa", modulus, "MPa", resin, 4.0 * resin, "another resin", CHOICE),
    ]


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

    scale = DesignVariable(
        name="layout.heights (all, times)", unit="", value=1.0, step=STEP_SHARE,
        reach=3.0 * STEP_SHARE, why="a twentieth of each", kind=FREE, fields=scaled,
    )  # fmt: skip
    out = [scale]
    if len(own):
        return out
    if layout.heights != "constant":
        why = "a step of the published sensor"
        out.append(
            _field("layout.height_far_mm", far, "mm", STEP_HEIGHT_MM, max(0.15 * far, 0.5), why)
        )
        near_step = min(0.1, 0.2 * near)
        out.append(
            _field("layout.height_near_mm", near, "mm", near_step, 5.0 * near_step, "two layers")
        )
    if layout.heights in {"linear", "power"}:
        value = layout.height_exponent if layout.heights == "power" else 1.0

        def bent(amount: float) -> Fields:
            return {"layout.heights": "power", "layout.height_exponent": round(value + amount, 6)}

        out.append(
            DesignVariable(
                name="layout.height_exponent",
                unit="",
                value=value,
                step=0.1,
                reach=0.3,
                why="a tenth",
                kind=FREE,
                fields=bent,
            )
        )
    if layout.heights == "line-of-sight":
        margin = layout.sight_margin_mm
        out.append(_field("layout.sight_margin_mm", margin, "mm", 0.05, 0.1, "a printed layer"))
    return out


def _layout(design: Design, markers: Markers) -> list[DesignVariable]:
    layout = design.layout
    if layout.kind == "explicit":
        return []
    if layout.kind == "phyllotaxis":
        step = max(1, round(0.02 * markers.count))
        return [_field("layout.count", layout.count, "", step, 2.0 * step, "markers", COUNT)]
    set_of = len(layout.colours)
    out = [
        _field("layout.rows", layout.rows, "", 1, 1.0, "a row", COUNT),
        _field("layout.columns", layout.columns, "", set_of, set_of, "a column a colour", COUNT),
    ]
    if layout.rows > 2:
        value = layout.row_pitch_exponent
        out.append(_field("layout.row_pitch_exponent", value, "", 0.02, 0.06, "a fiftieth"))
    if layout.kind == "spiral":
        value = layout.spiral_angle_deg
        out.append(_field("layout.spiral_angle_deg", value, "°", 0.5, 2.0, "half a degree"))
    return out


def _receptor(design: Design) -> list[DesignVariable]:
    receptor = design.receptor
    out = [
        _field(
            "receptor.diameter_outer_mm", receptor.diameter_outer_mm, "mm", 0.1, 0.3, "two layers"
        ),
    ]
    if receptor.band_marker_mm > 0.0:
        out.append(
            _field(
                "receptor.band_marker_mm", receptor.band_marker_mm, "mm", 0.1, 0.3, "a pen's stroke"
            )
        )
    if receptor.direction == "tilted":
        out.append(_field("receptor.tilt_deg", receptor.tilt_deg, "°", 1.0, 4.0, "a degree"))
    return out


def _camera(design: Design, stand_off_mm: float | None) -> list[DesignVariable]:
    camera, bar = design.camera, design.light.bar_radius_mm
    step = _neat(0.02 * camera.focal_px)
    out = [
        _field("camera.focal_px", camera.focal_px, "px", step, 5.0 * step, "another lens", CHOICE)
    ]
    if stand_off_mm is not None:
        out.append(
            _field("camera.stand_off_mm", round(stand_off_mm, 2), "mm", 0.5, 2.0, "a spacer")
        )
    if bar > 0.0:
        out.append(_field("light.bar_radius_mm", bar, "mm", 0.25, 0.5, "another bar", CHOICE))
    return out


def _shape(design: Design) -> list[DesignVariable]:
    """Lengths of the body; lists of them move together."""
    out = []
    for name, value in design.shape.model_dump(exclude={"kind"}).items():
        if not name.endswith("_mm"):
            continue
        field = f"shape.{name}"
        if isinstance(value, float) and value > 0.0:
            step = 1.0 if value >= SMALL_MM else 0.5
            out.append(_field(field, value, "mm", step, max(0.05 * value, step), "the body", SIZE))
        elif isinstance(value, tuple | list) and value and isinstance(value[0], float):
            out.append(_list(field, np.array(value, dtype=np.float64)))
    return out


def _list(field: str, values: Any) -> DesignVariable:
    """Lengths in a list, moved by the same."""

    def fields(amount: float) -> Fields:
        return {field: np.round(values + amount, 6).tolist()}

    mean = float(values.mean())
    return DesignVariable(
        name=f"{field} (all)", unit="mm", value=_neat(mean), step=1.0, reach=max(0.05 * mean, 1.0),
        why="the body", kind=SIZE, fields=fields,
    )  # fmt: skip
