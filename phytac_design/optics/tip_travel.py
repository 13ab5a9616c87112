"""How far a red tip must come out until the camera counts its switch as on."""

import numpy as np

from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import owner_sums, rasterise
from phytac_design.optics.render_scene import build_scene, red_owner
from phytac_shapes.arrays import FloatArray


def tip_travel_on_mm(sensor: Sensor) -> FloatArray:
    """Travel of each tip at which its red area reaches the decoder's threshold, (n,) mm.

    The area is counted in the map of visible parts, in the camera that sees most of the tip, and
    interpolated between rest, the end face and three travels beyond it. NaN where the camera cannot
    read the switch.
    """
    switch, markers = sensor.design.switch, sensor.markers
    out = switch.stroke_mm - switch.tip_recess_mm
    travels = switch.tip_recess_mm + out * np.array([0.25, 0.5, 1.0])
    rest = _red_px(sensor, switch.stroke_mm, on=False)
    area = np.stack([rest, *(_red_px(sensor, float(s), on=True) for s in travels)])
    tips = TipModel(on_px=np.zeros((markers.count, 2)), red_rest_px=rest, red_on_px=area[-1])
    # Behind the end face a tip shows what it shows at rest.
    at = np.array([switch.tip_recess_mm, *travels])
    found = [
        np.interp(threshold, np.maximum.accumulate(column), at)
        for threshold, column in zip(tips.threshold_px, area.T, strict=True)
    ]
    return np.where(tips.readable, found, np.nan)


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
