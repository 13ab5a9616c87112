"""Calibration by a rest frame: what paints look like in this light, and where markers are.

White balance, exposure and aged paint change the hue and chroma of each paint, and tint the wall.
All of it is measured where markers are expected, which show paint of a known name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.pipeline.decode import Frames, locate_in, prepared_frames
from phytac_decoder.pipeline.light_response import with_light_response
from phytac_decoder.pipeline.print_identity import for_this_print
from phytac_decoder.pipeline.shell_turn import oriented
from phytac_decoder.vision.marker_edges import MarkerEdges
from phytac_decoder.vision.matching import areas_px
from phytac_decoder.vision.picture_quality import FocusCheck, LightCheck
from phytac_decoder.vision.segmentation import HUE_COSINE_MIN, ColourModel, check_image
from phytac_decoder.vision.switch_detection import TipModel, red_areas
from phytac_decoder.vision.white_balance import WhiteBalance
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ColourSettings:
    """How colours are measured; set on rendered frames in lights of 2700 to 9000 K.

    Attributes
    ----------
    lit : float
        Share of its full chroma that paint shows with the light's fall-off: the floor is a share of
        what is measured instead.
    across : int
        Samples across the window of each marker.
    half_px : (float, float)
        Least and largest distance from a marker's position to the edge of its window,
    half_share : float
        and that distance over the distance to the nearest other marker.
    hue_cosine_min : float
        Chroma within 60 degrees of a paint's expected hue may be that paint's.
    core : float
        Samples of this share of a marker's strongest chroma, and more, are without edges.
    core_samples : int
        A marker shows its paint in at least so many samples.
    chroma_min : float
        Least chroma of paint, grey levels.
    shown_min : float
        Share of each paint's markers that must show it.
    separation_min_deg : float
        Nearer hues cannot be distinguished.
    floor_max, floor_step : float
        Largest share of full chroma that is required of paint, and the steps towards it.
    floor_above, growth, growth_anyway : float
        From this much above a floor down to it, paint may grow by the factor ``growth`` and by the
        share ``growth_anyway`` of all samples.
    paint_max, tip_max : float
        Largest share of all samples that may be of one marker's paint, and of the tips'.
    edge_sds : float
        Edges of markers count down to so many standard deviations of the bare wall.
    """

    lit: float = 0.88
    across: int = 21
    half_px: tuple[float, float] = (3.0, 60.0)
    half_share: float = 0.6
    hue_cosine_min: float = 0.5
    core: float = 0.7
    core_samples: int = 4
    chroma_min: float = 4.0
    shown_min: float = 0.5
    separation_min_deg: float = 50.0
    floor_max: float = 0.6
    floor_step: float = 0.05
    floor_above: float = 0.1
    growth: float = 1.3
    growth_anyway: float = 0.005
    paint_max: float = 0.5
    tip_max: float = 0.1
    edge_sds: float = 3.0


SETTINGS = ColourSettings()


def calibrate_rest(bundle: Bundle, rest_frames: Frames) -> Bundle:
    """Bundle for this sensor in this light: colours, rest positions, tips, response to light.

    What the rest frame does not show stays as it was. A trained decoder recognises the print that
    it was trained on, see :mod:`phytac_decoder.pipeline.print_identity`.

    Parameters
    ----------
    bundle : Bundle
        The design's decoder.
    rest_frames : (h, w, 3) uint8, or a sequence of them
        Frame of the unloaded sensor; of several cameras one of each.

    Raises
    ------
    InputError
        If paints cannot be distinguished in the frame, or it is none of this sensor.
    """
    frames = prepared_frames(bundle, rest_frames)
    lit = oriented(replace(bundle, colours=calibrated_colours(bundle, frames)), frames)
    shown, count, marks_px, weights = [], len(bundle.colour), lit.marks.rest_px, []
    for number, frame in enumerate(frames):
        old = lit.shown_by(number)
        matched, blobs = locate_in(lit, number, frame)
        weights.append(blobs.usual_weight(len(lit.colours.names)))
        moved = np.where(
            matched.found[:, None], matched.position_px - lit.spots_shown_by(number), 0
        )
        move, of_marks = moved[:count], moved[count:]
        marks_px = marks_px + of_marks
        tips = replace(old.tips, on_px=old.tips.on_px + move)
        red = lit.colours.names.index("red")
        tips = tips.as_at_rest(red_areas(blobs, tips, red_index=red, shift_px=np.zeros_like(move)))
        shown.append(CameraView(rest_px=old.rest_px + move, tips=tips))
    own = np.arange(len(bundle.colour))

    def read(each: list[FloatArray]) -> FloatArray:
        return np.asarray(np.stack(each)[bundle.read_by, own])

    calibrated = replace(
        lit,
        colours=replace(lit.colours, usual_weight=np.stack(weights)),
        shown=tuple(shown) if bundle.shown else (),
        marks=replace(lit.marks, rest_px=marks_px),
        rest_px=read([item.rest_px for item in shown]),
        tips=TipModel(
            **{
                name: read([getattr(item.tips, name) for item in shown])
                for name in ("on_px", "red_rest_px", "red_on_px")
            },
            gradual=lit.tips.gradual,
        ),
    )
    calibrated = with_pictures_at_rest(calibrated, frames)
    return with_light_response(for_this_print(calibrated), rest_frames)


def with_pictures_at_rest(bundle: Bundle, frames: Sequence[ImageArray]) -> Bundle:
    """Bundle that compares focus, light and edges of each frame with those of rest frames.

    Parameters
    ----------
    bundle : Bundle
        With the colours and positions of these.
    frames : sequence of (h, w, 3) uint8
        One of each camera, of :func:`.decode.prepared_frames`.
    """
    count, focus, light, balance, edges = len(bundle.colour), [], [], [], []
    for number, frame in enumerate(frames):
        matched, blobs = locate_in(bundle, number, frame)
        area = areas_px(matched, blobs, bundle.spot_colour)[:count]
        area = np.where(bundle.read_by == number, area, np.nan)
        place_px = matched.position_px[:count]
        own_px = np.where(np.isfinite(area)[:, None], place_px, np.nan)
        focus.append(FocusCheck.at_rest(frame, place_px, area))
        light.append(LightCheck.at_rest(frame, own_px))
        balance.append(WhiteBalance.at_rest(frame, bundle.colours, own_px))
        edges.append(MarkerEdges.at_rest(frame, bundle.colours, own_px, area))
    return replace(
        bundle,
        focus=tuple(focus),
        light=tuple(light),
        white_balance=tuple(balance),
        edges=tuple(edges),
    )


def calibrated_colours(bundle: Bundle, frames: Sequence[ImageArray]) -> ColourModel:
    """Paints as one rest frame of each camera shows them.

    Raises
    ------
    InputError
        If fewer than half of a paint's markers show it, or two paints look alike.
    """
    each = [_sampled(bundle, number, frame) for number, frame in enumerate(frames)]
    ids, chroma = (np.concatenate(part) for part in zip(*each, strict=True))
    return fit_colours(bundle.colours, chroma, bundle.colour[ids])


def _sampled(bundle: Bundle, number: int, frame: ImageArray) -> tuple[IntArray, FloatArray]:
    """Markers (n,) that a camera shows, and chroma (n, p, 2) around their expected positions."""
    camera, rest = bundle.cameras[number], bundle.shown_by(number).rest_px
    check_image(frame, width_px=camera.width_px, height_px=camera.height_px)
    ids = np.flatnonzero(np.isfinite(rest).all(axis=1))
    place = rest[ids]
    gap = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    half = np.clip(SETTINGS.half_share * gap.min(axis=1, initial=np.inf), *SETTINGS.half_px)
    step = np.linspace(-1.0, 1.0, SETTINGS.across)
    x, y = (
        np.clip(np.rint(place[:, k, None] + half[:, None] * step), 0, size - 1).astype(np.int64)
        for k, size in enumerate((camera.width_px, camera.height_px))
    )
    pixels = frame[y[:, :, None], x[:, None, :]].reshape(len(ids), -1, 3)
    ycc = cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_BGR2YCrCb)
    return ids, ycc[:, :, 1:].astype(np.float64) - 128.0


def fit_colours(model: ColourModel, chroma: FloatArray, paint: IntArray) -> ColourModel:
    """Colour model of samples around markers of known paint.

    Parameters
    ----------
    model : ColourModel
        Paints as they are expected.
    chroma : (n, p, 2) float
        (Cr - 128, Cb - 128) of samples around n markers.
    paint : (n,) int
        Paint of each marker.
    """
    now, seen = model, np.unique(paint)
    for _ in range(3):  # hues far off are seen in part at first
        level = _levels(now, chroma, paint)
        _check_seen(model, level, paint)
        centre = np.stack([np.nanmedian(level[paint == k], axis=0) for k in seen])
        now = replace(model, chroma=_full(model, centre, seen))
    now = replace(now, floor=_floor(now, chroma, seen))
    bare, edge = _bare(now, chroma)
    return replace(now, bare=bare, edge=edge)


def _bare(model: ColourModel, chroma: FloatArray) -> tuple[FloatArray, float]:
    """Share (k,) of each paint that the unpainted samples show, and one above their noise."""
    full = np.linalg.norm(model.chroma, axis=1)
    share = chroma.reshape(-1, 2) @ (model.chroma / full[:, None]).T / full
    unpainted = share[(share < 0.5 * model.floor).all(axis=1)]
    bare = np.median(unpainted, axis=0)
    spread = 1.4826 * float(np.median(np.abs(unpainted - bare), axis=0).max())
    edge = np.clip(SETTINGS.edge_sds * spread, model.edge, model.floor)
    # Subtracted where it adds to paint only: elsewhere it keeps noise below the edge.
    return np.maximum(bare, 0.0), float(edge)


def _levels(model: ColourModel, chroma: FloatArray, paint: IntArray) -> FloatArray:
    """Chroma (n, 2) of each marker's own paint, NaN where it shows none."""
    unit = model.chroma / np.linalg.norm(model.chroma, axis=1)[:, None]
    along = chroma @ unit.T
    size = np.linalg.norm(chroma, axis=2)
    ahead = np.take_along_axis(along, paint[:, None, None], axis=2)[:, :, 0]
    own = (ahead >= along.max(axis=2)) & (ahead >= SETTINGS.hue_cosine_min * size)
    own &= size >= SETTINGS.chroma_min
    own &= own.sum(axis=1, keepdims=True) >= SETTINGS.core_samples
    shows = own.any(axis=1)
    peak = np.full(len(paint), np.inf)
    peak[shows] = _quantile(np.where(own, ahead, np.nan)[shows], 0.9)
    core = own & (ahead >= SETTINGS.core * peak[:, None])
    level = np.full((len(paint), 2), np.nan)
    for k in range(2):
        level[shows, k] = _quantile(np.where(core, chroma[:, :, k], np.nan)[shows], 0.5)
    return level


def _quantile(values: FloatArray, share: float) -> FloatArray:
    """Quantile (n,) of each row (n, p) of numbers and NaN: ``np.nanquantile``, but faster."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    at = share * (np.isfinite(values).sum(axis=1) - 1)
    low, high = np.floor(at), np.ceil(at)
    a, b = (
        np.take_along_axis(ordered, k.astype(np.int64)[:, None], axis=1)[:, 0] for k in (low, high)
    )
    rest = at - low
    return np.asarray(np.where(rest < 0.5, a + (b - a) * rest, b - (b - a) * (1.0 - rest)))


def _full(model: ColourModel, centre: FloatArray, seen: IntArray) -> FloatArray:
    """Full chroma (k, 2) of all paints: as measured, and of others as these have changed.

    Raises
    ------
    InputError
        If two hues are nearly the same.
    """
    usual = np.linalg.norm(centre, axis=1) / np.linalg.norm(model.chroma[seen], axis=1)
    full = model.chroma * float(np.exp(np.log(usual).mean()))
    full[seen] = centre
    unit = full / np.linalg.norm(full, axis=1)[:, None]
    cosine = unit @ unit.T
    np.fill_diagonal(cosine, -1.0)
    i, j = np.unravel_index(int(np.argmax(cosine)), cosine.shape)
    apart = float(np.degrees(np.arccos(np.clip(cosine[i, j], -1.0, 1.0))))
    if apart < SETTINGS.separation_min_deg:
        raise InputError(
            "colours-not-separable",
            f"{model.names[i]} and {model.names[j]} cannot be distinguished in the rest frame: "
            f"their hues are {apart:.0f} degrees apart (needed: {SETTINGS.separation_min_deg:g}); "
            "set the camera's white balance, and its exposure so that paint is not clipped",
        )
    return full


def _floor(model: ColourModel, chroma: FloatArray, seen: IntArray) -> float:
    """Least share of full chroma that counts as paint.

    It is raised until, from a little above the floor down to it, paint grows by its edges only and
    is the smaller part of the samples: otherwise wall or noise would count as paint.

    Parameters
    ----------
    model : ColourModel
        As measured.
    chroma : (n, p, 2) float
        Samples.
    seen : (k,) int
        Paints of markers; of others little shows at rest.

    Raises
    ------
    InputError
        If paint does not stand out of those.
    """
    full = np.linalg.norm(model.chroma, axis=1)
    off = chroma.reshape(-1, 2)
    along = off @ (model.chroma / full[:, None]).T
    best = np.argmax(along, axis=1)
    ahead = along[np.arange(len(off)), best]
    hued = ahead >= HUE_COSINE_MIN * np.linalg.norm(off, axis=1)
    share = np.where(hued, ahead / full[best], 0.0)

    def painted(floor: float) -> FloatArray:
        return np.bincount(best[share >= floor], minlength=len(full)) / len(off)

    lowest = model.floor / SETTINGS.lit
    most = np.where(np.isin(np.arange(len(full)), seen), SETTINGS.paint_max, SETTINGS.tip_max)
    for floor in np.arange(lowest, SETTINGS.floor_max, SETTINGS.floor_step):
        steady = SETTINGS.growth * painted(floor + SETTINGS.floor_above) + SETTINGS.growth_anyway
        if (painted(floor) <= np.minimum(steady, most)).all():
            return float(floor)
    raise InputError(
        "paint-contrast-low",
        f"paint does not stand out of the rest frame: its chroma is {full.min():.0f} grey levels, "
        "and wall or noise have as much; give more light or a longer exposure, and set the "
        "camera's white balance",
    )


def _check_seen(model: ColourModel, level: FloatArray, paint: IntArray) -> None:
    for k in np.unique(paint):
        shows = np.isfinite(level[paint == k, 0])
        if shows.mean() < SETTINGS.shown_min:
            raise InputError(
                "markers-without-colour",
                f"{int(shows.sum())} of {len(shows)} {model.names[k]} markers show their colour in "
                "the rest frame; is it in colour, lit, in focus, and of this sensor?",
            )
