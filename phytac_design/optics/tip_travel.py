"""How far a red tip must come out until the camera counts its switch as on."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import owner_sums, rasterise
from phytac_design.optics.render_scene import build_scene, red_owner
from phytac_shapes.arrays import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True)
class TipRed:
    """Red area of each tip over its travel, in the camera that sees most of it.

    Attributes
    ----------
    travel_mm : (k,) float
        Travels from the end face, where a tip shows what it shows at rest, to the stroke.
    red_px : (k, n) float
        Visible red, which does not fall.
    threshold_px : (n,) float
        Area above which the decoder reads a switch as on.
    readable : (n,) bool
        Switches that it can read.
    """

    travel_mm: FloatArray
    red_px: FloatArray
    threshold_px: FloatArray
    readable: BoolArray

    @property
    def travel_on_mm(self) -> FloatArray:
        """Travel (n,) mm at which each tip's area reaches the threshold; NaN if unreadable."""
        found = [
            np.interp(threshold, column, self.travel_mm)
            for threshold, column in zip(self.threshold_px, self.red_px.T, strict=True)
        ]
        return np.where(self.readable, found, np.nan)

    def red_at(self, marker: int, travel_mm: FloatArray) -> FloatArray:
        """Visible red (m,) px of a marker's tip at travels (m,)."""
        return np.asarray(np.interp(travel_mm, self.travel_mm, self.red_px[:, marker]))


def tip_red(sensor: Sensor) -> TipRed:
    """Red of all tips, counted in the map of visible parts at rest and at three travels."""
    switch, markers = sensor.design.switch, sensor.markers
    out = switch.stroke_mm - switch.tip_recess_mm
    travels = switch.tip_recess_mm + out * np.array([0.25, 0.5, 1.0])
    rest = _red_px(sensor, switch.stroke_mm, on=False)
    area = np.stack([rest, *(_red_px(sensor, float(s), on=True) for s in travels)])
    tips = TipModel(on_px=np.zeros((markers.count, 2)), red_rest_px=rest, red_on_px=area[-1])
    return TipRed(
        travel_mm=np.array([switch.tip_recess_mm, *travels]),
        red_px=np.maximum.accumulate(area),
        threshold_px=tips.threshold_px,
        readable=tips.readable,
    )


def tip_travel_on_mm(sensor: Sensor) -> FloatArray:
    """Travel of each tip at which its red area reaches the decoder's threshold, (n,) mm.

    NaN where the camera cannot read the switch.
    """
    return tip_red(sensor).travel_on_mm


def _red_px(sensor: Sensor, stroke_mm: float, *, on: bool) -> FloatArray:
    """Visible red of each tip with this stroke, (n,) px."""
    design, markers = sensor.design, sensor.markers
    switch = design.switch.model_copy(update={"stroke_mm": stroke_mm})
    other = Sensor.of(design.model_copy(update={"switch": switch}), sensor.surface, sensor.markers)
    state = np.full(markers.count, on)
    shown = []
    for camera in sensor.cameras:
        scene = build_scene(other, tolerance_mm=tolerance_mm(camera, markers), switch_on=state)
        owner = red_owner(rasterise(scene, camera).part)
        shown.append(owner_sums(owner, markers.count)[:, 0])
    return np.asarray(np.max(shown, axis=0))
