"""Colour separability of a design's paints under its light, with the camera's noise.

Two measures. In *CIE 1976 u'v'* (CIE 15), the plane of colour meters, the distance between two
paints depends neither on shade nor on the camera. In *YCbCr*, the plane of the decoder, a pixel
belongs to the paint nearest in hue: the margin between two paints is the distance from a paint's
chroma to the line halfway between the two hues, and from its chroma to the floor below which a
pixel counts as unpainted. Noise of ``noise_pixel`` grey levels in each of
R, G and B is carried to both planes to first order, in the shade, where chroma is least.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from phytac_decoder.pipeline.colour_calibration import SETTINGS
from phytac_decoder.vision.brightness import DOTS
from phytac_decoder.vision.segmentation import HUE_COSINE_MIN, ColourModel
from phytac_design.design.paints_table import NOMINAL_PAINTS, PaintsSection, Rgb
from phytac_design.design.spec import Design
from phytac_design.optics.light import EVEN, FROM_AXIS, FROM_CAMERA
from phytac_design.optics.paint import paints_of, resin_of, to_linear, to_srgb
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Separability:
    """Paints and the pairs of them; k paints (red last), p pairs.

    Attributes
    ----------
    names, rgb : (k,) str, (k, 3) int
        Paints, and their sRGB.
    uv : (k, 2) float
        CIE 1976 u', v' of each paint.
    chroma : (k, 2) float
        (Cr, Cb) - 128 of each paint in the shade.
    uv_noise : (k,) float
        Largest standard deviation of u'v' of a pixel in the shade.
    chroma_noise : float
        Largest standard deviation of (Cr, Cb), in grey levels.
    floor_sigmas : (k,) float
        How far each paint in the shade is above the decoder's floor, in standard deviations.
    pairs : (p, 2) int
        Pairs of paints.
    uv_distance, uv_sigmas : (p,) float
        Distance in u'v'; the same in standard deviations of the noisier paint.
    hue_deg, hue_sigmas : (p,) float
        Angle between the hues; distance to the line halfway, in standard deviations of a pixel.
    """

    names: tuple[str, ...]
    rgb: tuple[Rgb, ...]
    uv: FloatArray
    chroma: FloatArray
    uv_noise: FloatArray
    chroma_noise: float
    floor_sigmas: FloatArray
    pairs: tuple[tuple[int, int], ...]
    uv_distance: FloatArray
    uv_sigmas: FloatArray
    hue_deg: FloatArray
    hue_sigmas: FloatArray

    def summary(self) -> dict[str, float | str]:
        """Figures of the report: the two paints that are nearest, and by how much."""
        worst = int(np.argmin(self.hue_sigmas))
        return {
            "nearest_paints": " and ".join(self.names[i] for i in self.pairs[worst]),
            "min_uv_distance": float(self.uv_distance.min()),
            "min_hue_deg": float(self.hue_deg.min()),
            "min_hue_sigmas": float(self.hue_sigmas.min()),
            "min_floor_sigmas": float(self.floor_sigmas.min()),
        }


def chromaticity(rgb: FloatArray) -> FloatArray:
    """CIE 1976 (u', v'), (k, 2), of sRGB values (k, 3) in [0, 255]."""
    # CIE XYZ of linear sRGB, white D65 (IEC 61966-2-1).
    xyz_of_rgb = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    x, y, z = (to_linear(rgb) @ xyz_of_rgb.T).T
    whole = np.maximum(x + 15.0 * y + 3.0 * z, 1e-30)
    return np.column_stack([4.0 * x / whole, 9.0 * y / whole])


def separability(
    names: tuple[str, ...],
    *,
    noise_pixel: float,
    light_rgb: FloatArray | None = None,
    table: PaintsSection = NOMINAL_PAINTS,
) -> Separability:
    """Separability of the paints, with the red of the tips.

    Parameters
    ----------
    names : tuple of str
        Paints of the markers.
    noise_pixel : float
        Standard deviation of the sensor noise, in grey levels of 255.
    light_rgb : (3,) float, optional
        Linear RGB of the light, its greatest channel 1; white by default.
    table : PaintsSection
        What the paints look like in white light.
    """
    # Least share of the full light that a painted surface gets: the even part alone.
    shade = EVEN / (EVEN + FROM_CAMERA + FROM_AXIS)
    # (Cr, Cb) of 8-bit RGB, as OpenCV's full-range YCrCb (ITU-R BT.601).
    chroma_of_rgb = np.array([[0.5, -0.4187, -0.0813], [-0.1687, -0.3313, 0.5]])
    paints = paints_of(names, table)
    shown = tuple(paints.values())
    wall = resin_of(names, table)
    full = ColourModel.from_rgb(paints, wall=wall)
    for dot in DOTS.keys() & paints.keys():
        # As the decoder sees it: blue by its contrast to the wall, in grey levels.
        paints[dot] = (0, 0, int(np.abs(np.subtract(paints[dot], wall)).mean()))
    light = np.ones(3) if light_rgb is None else np.asarray(light_rgb, dtype=np.float64)
    albedo = to_linear(np.array(list(paints.values()), dtype=np.float64)) * light
    shaded = to_srgb(shade * albedo)
    chroma = shaded @ chroma_of_rgb.T
    spread = noise_pixel * float(np.linalg.svd(chroma_of_rgb, compute_uv=False)[0])
    step = 0.5
    slopes = np.stack(
        [
            (chromaticity(shaded + step * e) - chromaticity(shaded - step * e)) / (2.0 * step)
            for e in np.eye(3)
        ],
        axis=2,
    )
    uv_noise = np.asarray(noise_pixel * np.linalg.svd(slopes, compute_uv=False)[:, 0], np.float64)
    uv = chromaticity(to_srgb(albedo))
    pairs = tuple(combinations(range(len(paints)), 2))
    first, second = np.array(pairs).T
    size = np.linalg.norm(chroma, axis=1)
    cosine = np.sum(chroma[first] * chroma[second], axis=1) / (size[first] * size[second])
    hue = np.arccos(np.clip(cosine, -1.0, 1.0))
    # Beyond its own cone a pixel belongs to no paint: no margin is wider than that.
    half = np.minimum(hue / 2.0, np.arccos(HUE_COSINE_MIN))
    away = np.linalg.norm(uv[first] - uv[second], axis=1)
    noise, noise_uv = max(spread, 1e-12), np.maximum(uv_noise, 1e-12)
    floor = full.floor * np.linalg.norm(full.chroma, axis=1)
    return Separability(
        names=full.names,
        rgb=shown,
        uv=uv,
        chroma=chroma,
        uv_noise=uv_noise,
        chroma_noise=spread,
        floor_sigmas=(size - floor) / noise,
        pairs=pairs,
        uv_distance=away,
        uv_sigmas=away / np.maximum(noise_uv[first], noise_uv[second]),
        hue_deg=np.degrees(hue),
        hue_sigmas=np.minimum(size[first], size[second]) * np.sin(half) / noise,
    )


def check_paints(design: Design) -> Separability:
    """Separability of a design's paints.

    Raises
    ------
    DesignError
        If two paints, or a paint and the bare resin, are too close for the camera's noise, or two
        hues for the decoder.
    """
    sigmas_min = 5.0  # least margin in standard deviations of the noise of one pixel (chosen here)
    # Least distance in u'v' (chosen here): about ten times the just noticeable difference.
    uv_min = 0.04
    noise = design.camera.noise_pixel
    found = separability(design.layout.colours, noise_pixel=noise, table=design.paints)
    worst = int(np.argmin(np.minimum(found.hue_sigmas / sigmas_min, found.uv_distance / uv_min)))
    close = found.hue_sigmas[worst] < sigmas_min or found.uv_distance[worst] < uv_min
    if close and not design.dots:  # beside dots there are no red tips
        first, second = (found.names[i] for i in found.pairs[worst])
        raise DesignError(
            "paints-not-separable",
            f"{first} and {second} cannot be distinguished: {found.uv_distance[worst]:.3f} in u'v' "
            f"(at least {uv_min:g}), {found.hue_sigmas[worst]:.1f} standard deviations of a pixel "
            f"in the shade (at least {sigmas_min:g}); choose other layout.colours or lower "
            "camera.noise_pixel",
        )
    _check_hues(design, found)
    faint = int(np.argmin(found.floor_sigmas))
    if found.floor_sigmas[faint] < sigmas_min:
        raise DesignError(
            "paint-like-resin",
            f"{found.names[faint]} in the shade cannot be distinguished from bare resin: "
            f"{found.floor_sigmas[faint]:.1f} standard deviations of a pixel (at least "
            f"{sigmas_min:g}); choose other layout.colours or lower camera.noise_pixel",
        )
    return found


def _check_hues(design: Design, found: Separability) -> None:
    """Reject hues that the calibration of the colours with a rest frame would reject."""
    least = SETTINGS.separation_min_deg
    worst = int(np.argmin(found.hue_deg))
    if found.hue_deg[worst] >= least or design.dots:
        return
    first, second = (found.names[i] for i in found.pairs[worst])
    raise DesignError(
        "paints-not-separable",
        f"the hues of {first} and {second} are {found.hue_deg[worst]:.1f} degrees apart (the "
        f"decoder needs {least:g}); choose other layout.colours, or give the paints' own RGB in "
        f"[paints] (red is that of the switches' tips)",
    )


def separability_svg(found: Separability) -> str:
    """Two plots side by side, as SVG: u'v', and the decoder's (Cb, Cr) plane with hue borders.

    Discs around the paints are three standard deviations of one pixel in the shade.
    """
    size, gap, pad = 300.0, 40.0, 36.0
    width, height = 2.0 * size + gap + 2.0 * pad, size + 2.0 * pad
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}"'
    parts = [f'{head} font-family="sans-serif" font-size="11">']
    colours = ["#{:02x}{:02x}{:02x}".format(*rgb) for rgb in found.rgb]

    def panel(left: float, title: str, xy: FloatArray, box: FloatArray, sd: FloatArray) -> None:
        low, high = box
        scale = size / (high - low)
        parts.append(
            f'<rect x="{left:g}" y="{pad:g}" width="{size:g}" height="{size:g}" fill="none" '
            f'stroke="#999"/><text x="{left:g}" y="{pad - 8:g}">{title}</text>'
        )
        for (x, y), colour, name, spread in zip(xy, colours, found.names, sd, strict=True):
            cx, cy = left + (x - low[0]) * scale[0], pad + size - (y - low[1]) * scale[1]
            parts.append(
                f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="{max(3.0 * spread * scale[0], 2.0):.1f}" '
                f'fill="{colour}"/><text x="{cx + 9:.1f}" y="{cy + 4:.1f}">{name}</text>'
            )

    limits = np.array([[0.0, 0.0], [0.63, 0.63]])
    panel(pad, "CIE 1976: u' right, v' up", found.uv, limits, found.uv_noise)
    left, most = pad + size + gap, 1.25 * float(np.linalg.norm(found.chroma, axis=1).max())
    noise = np.full(len(colours), found.chroma_noise)
    plane = found.chroma[:, ::-1]
    panel(left, "in the shade: Cb right, Cr up", plane, np.array([[-most] * 2, [most] * 2]), noise)
    middle = np.array([left + size / 2.0, pad + size / 2.0])
    turn = np.sort(np.arctan2(plane[:, 1], plane[:, 0]))
    for k, angle in enumerate(turn):
        ahead = turn[(k + 1) % len(turn)] + (2.0 * np.pi if k + 1 == len(turn) else 0.0)
        border = (angle + ahead) / 2.0
        end = middle + size / 2.0 * np.array([np.cos(border), -np.sin(border)])
        parts.append(
            f'<line x1="{middle[0]:.1f}" y1="{middle[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" '
            'stroke="#bbb" stroke-dasharray="4 3"/>'
        )
    return "\n".join([*parts, "</svg>"])
