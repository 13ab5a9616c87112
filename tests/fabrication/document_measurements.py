"""Measurements on what the bench and kit stages write, made from the files alone."""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray

DPI = 400
MM = 25.4 / DPI
"""Millimetres to a pixel."""
RED = (40, 40, 214)
"""Ink of the tips, BGR."""
CLOSE = 60
"""Largest difference of a channel that is still that ink."""


def rasterise_pdf(path: Path, folder: Path, *, last: int) -> list[NDArray[np.uint8]]:
    """First pages of a PDF as pictures (h, w, 3), BGR, by poppler's pdftoppm."""
    words = ["pdftoppm", "-r", str(DPI), "-l", str(last), str(path), str(folder / "page")]
    subprocess.run(words, check=True, capture_output=True)
    found = sorted(folder.glob("page-*.ppm"))
    return [np.asarray(cv2.imread(str(item)), dtype=np.uint8) for item in found]


def tick_places_mm(image: NDArray[np.uint8], length_mm: float = 100.0) -> FloatArray:
    """Where the ticks of the lower scale bar stand, mm from the page's left edge.

    The bar is the longest dark run of the picture's lowest eighth; its ticks stand on it.
    """
    dark = image.max(axis=2) < 128
    low = 7 * len(dark) // 8
    run = _longest_runs(dark[low:])
    row = low + int(run.argmax())
    if run.max() < 0.9 * length_mm / MM:
        raise ValueError(f"no scale bar of {length_mm:g} mm in the picture")
    set_pixels = np.flatnonzero(dark[row])
    start = int(set_pixels[np.argmax(_runs_from(dark[row])[set_pixels])])
    stop = start + int(run.max())
    above = np.zeros(dark.shape[1], dtype=np.bool_)
    reach = np.s_[max(start - round(1.0 / MM), 0) : stop + round(1.0 / MM)]
    above[reach] = dark[row - round(1.0 / MM)][reach]
    starts = np.flatnonzero(np.diff(above.astype(np.int8)) == 1) + 1
    ink = 255.0 - image[row - round(1.0 / MM)].min(axis=1)
    windows = [np.arange(start - 2, start + 6) for start in starts.tolist()]
    return np.array([((own + 0.5) * ink[own]).sum() / ink[own].sum() * MM for own in windows])


def _longest_runs(dark: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Longest run of set pixels in each row."""
    out = np.zeros(len(dark), dtype=np.int64)
    run = np.zeros(len(dark), dtype=np.int64)
    for column in dark.T:
        run = np.where(column, run + 1, 0)
        out = np.maximum(out, run)
    return out


def _runs_from(dark: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Length of the run of set pixels that begins at each pixel of a row."""
    out = np.zeros(len(dark) + 1, dtype=np.int64)
    for k in range(len(dark) - 1, -1, -1):
        out[k] = out[k + 1] + 1 if dark[k] else 0
    return out[:-1]


def red_centres_mm(image: NDArray[np.uint8], tip_diameter_mm: float) -> FloatArray:
    """Centres (n, 2) mm of the red discs, from the page's top left corner; x right, y down.

    Partly covered pixels count by how red they are; the legend's disc is of another size.
    """
    colour = np.array(RED, dtype=np.float64)
    low, high = (tuple(float(c + side * CLOSE) for c in RED) for side in (-1, 1))
    near = np.asarray(cv2.inRange(image, low, high)) > 0
    count, label, stats, _ = cv2.connectedComponentsWithStats(near.astype(np.uint8))
    area = np.pi / 4.0 * tip_diameter_mm**2 / MM**2
    out = []
    for k in range(1, count):
        x, y, width, height, size = (int(value) for value in stats[k])
        if not 0.7 * area < size < 1.3 * area:
            continue
        window = np.s_[y - 2 : y + height + 2, x - 2 : x + width + 2]
        # White to red: how much of the pixel's blue is gone.
        share = np.clip((255.0 - image[window][:, :, 0]) / (255.0 - colour[0]), 0.0, 1.0)
        share *= cv2.dilate((label[window] == k).astype(np.uint8), np.ones((3, 3))) > 0
        rows, columns = np.mgrid[y - 2 : y + height + 2, x - 2 : x + width + 2]
        total = share.sum()
        out.append([((columns + 0.5) * share).sum() / total, ((rows + 0.5) * share).sum() / total])
    return np.array(out).reshape(-1, 2) * MM


def fit_shift_mm(seen: FloatArray, due: FloatArray) -> FloatArray:
    """Distances (n,) of each due place from the nearest seen one, after one common shift."""
    shift = seen.min(axis=0) - due.min(axis=0)
    pairs = np.zeros(len(due), dtype=np.int64)
    for _ in range(50):
        gap = np.linalg.norm(seen[None] - (due + shift)[:, None], axis=2)
        pairs = gap.argmin(axis=1)
        shift = (seen[pairs] - due).mean(axis=0)
    return np.asarray(np.linalg.norm(seen[pairs] - due - shift, axis=1))


@dataclass(frozen=True, kw_only=True)
class Move:
    """One move of a G-code program.

    Attributes
    ----------
    at : (6,) float
        X, Y, Z, A, B, C where it ends, mm and degrees.
    tool : int
        Tool in the spindle.
    region : int
        Region named in the last comment; -1 before.
    logs : tuple of (str, float, int)
        Macros that follow before the next move: name, P, Q.
    """

    at: FloatArray
    tool: int
    region: int
    logs: tuple[tuple[str, float, int], ...]


def read_gcode(text: str) -> list[Move]:
    """Moves of a program, in order."""
    axes = {name: k for k, name in enumerate("XYZABC")}
    now, tool, region = np.full(6, np.nan), 0, -1
    moves: list[Move] = []
    for line in text.splitlines():
        code, _, comment = line.partition(";")
        found = re.match(r"\s*region (\d+)", comment)
        region = int(found[1]) if found else region
        words = {word[0]: float(word[1:]) for word in code.split()}
        tool = int(words.get("T", tool))
        if words.get("G") in (0.0, 1.0) and set(words) & set(axes):
            now = now.copy()
            for name, k in axes.items():
                now[k] = words.get(name, now[k])
            moves.append(Move(at=now, tool=tool, region=region, logs=()))
        if words.get("M") in (100.0, 101.0):
            last = moves[-1]
            log = (f"M{words['M']:.0f}", words["P"], int(words["Q"]))
            moves[-1] = Move(at=last.at, tool=last.tool, region=last.region, logs=(*last.logs, log))
    return moves


def in_sensor(at: FloatArray) -> FloatArray:
    """Tool's middle (n, 3) mm in the sensor's frame, of positions (n, 6)."""
    from scipy.spatial.transform import Rotation

    # machine = Ry(B) Rz(C) sensor
    turn = Rotation.from_euler("ZY", np.stack([-at[:, 5], -at[:, 4]], axis=1), degrees=True)
    return np.asarray(turn.apply(at[:, :3]))


def tool_axis(at: FloatArray) -> FloatArray:
    """Way out of the sensor along the tool (n, 3), in the sensor's frame."""
    out = at.copy()
    out[:, :3] = [1.0, 0.0, 0.0]
    return in_sensor(out)


def tool_x(at: FloatArray) -> FloatArray:
    """Way in which the tool's notch points (n, 3), in the sensor's frame."""
    out = at.copy()
    roll = np.radians(at[:, 3])
    out[:, :3] = np.column_stack([np.zeros(len(at)), np.sin(roll), np.cos(roll)])
    return in_sensor(out)
