"""Lens calibrations in files of other tools (OpenCV, ROS ``camera_info``, Kalibr), both ways.

Which of the three a file is shows in its keys. Poses are left out: they are of another setup.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import yaml

from phytac_decoder.camera.lens import LENSES, Lens
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import DesignError, InputError, OutputError, cause_of

FileFormat = Literal["opencv", "ros", "kalibr"]


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
    """YAML with the matrices of OpenCV."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix",
    lambda loader, node: loader.construct_mapping(node, deep=True)["data"],
)


def read_lens(path: Path) -> Lens:
    """Lens of a calibration file.

    Raises
    ------
    InputError
        If the file is missing, is none of the three kinds, or lacks or garbles a number.
    """
    again = "export it again from the calibration tool, as one of the kinds in docs/formats.md"
    try:
        # A calibration has a few hundred bytes, and YAML takes its time.
        text = read_text(path, bytes_max=1 << 17)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            "file-unreadable",
            f"camera calibration {path} cannot be read ({cause_of(error)}); give the path of a "
            "YAML file",
        ) from error
    try:
        opencv = text.lstrip().startswith("%YAML:1.0") or "!!opencv-matrix" in text
        # OpenCV's first line is no directive of YAML.
        data = yaml.load(re.sub(r"\A\s*%YAML:.*", "", text), _Loader)  # noqa: S506 - a safe one
        if opencv and isinstance(data, dict):
            return _read_opencv(data)
        if isinstance(data, dict) and "cam0" in data:
            return _read_kalibr(data["cam0"])
        if isinstance(data, dict) and "distortion_model" in data:
            return _read_ros(data)
    except RecursionError:
        raise InputError(
            "lens-file-invalid",
            f"camera calibration {path} is not usable: nested too deeply; {again}",
        ) from None
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, yaml.YAMLError) as error:
        what = (
            f"{error} is missing"
            if isinstance(error, KeyError)
            else " ".join(cause_of(error).split())
        )
        raise InputError(
            "lens-file-invalid", f"camera calibration {path} is not usable: {what[:300]}; {again}"
        ) from error
    except DesignError as error:
        raise InputError(error.code, f"camera calibration {path} is not usable: {error}") from error
    raise InputError(
        "lens-file-unknown-format",
        f"camera calibration {path} is of no known kind (known: OpenCV (camera_matrix), ROS "
        "camera_info (camera_matrix, distortion_model), Kalibr (cam0))",
    )


def calibrated_fields(name: str, folder: str | Path) -> dict[str, Any]:
    """Fields of a design's camera table from a calibration file, beside the design.

    Raises
    ------
    InputError
        As :func:`read_lens`.
    """
    lens = read_lens(Path(folder) / name)
    return {
        "model": lens.model,
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "focal_px": lens.fx_px,
        "focal_ratio": lens.fy_px / lens.fx_px,
        "centre_offset_px": (
            lens.cx_px - (lens.width_px - 1) / 2.0,
            lens.cy_px - (lens.height_px - 1) / 2.0,
        ),
        "distortion": lens.distortion,
    }


def write_lens(lens: Lens, path: Path, file_format: FileFormat, *, name: str = "phytac") -> Path:
    """Write a lens as another tool's calibration file; `name` is the camera's, for ROS.

    Raises
    ------
    DesignError
        If that kind of file cannot hold the model.
    OutputError
        If the file cannot be written.
    """
    writers = {"opencv": _opencv_text, "ros": _ros_text, "kalibr": _kalibr_text}
    text = writers[file_format](lens, name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {path}: {error.strerror}"
        ) from error
    return path


def _make(model: str, size: Any, matrix: Sequence[float], distortion: Any) -> Lens:
    """Lens from size (w, h), (fx, fy, cx, cy) and coefficients."""
    coefficients = tuple(float(value) for value in np.ravel(distortion))
    if model == "brown_conrady" and not any(coefficients):
        model, coefficients = "pinhole", ()
    fx, fy, cx, cy = (float(value) for value in matrix)
    return LENSES[model](
        width_px=int(size[0]),
        height_px=int(size[1]),
        fx_px=fx,
        fy_px=fy,
        cx_px=cx,
        cy_px=cy,
        distortion=coefficients,
    )


def _four(matrix: Any) -> list[float]:
    """(fx, fy, cx, cy) of nine numbers; skew is refused, no model here has it."""
    k = np.asarray(matrix, dtype=np.float64).reshape(3, 3)
    if abs(k[0, 1]) > 1e-9 * abs(k[0, 0]):
        raise ValueError(f"skewed pixels are not modelled (got skew {k[0, 1]:g} px)")
    return [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]


def _read_opencv(data: dict[str, Any]) -> Lens:
    """Read the file of OpenCV's calibration samples; ``camera_model`` or ``xi`` marks a fisheye."""
    matrix = data.get("camera_matrix", data.get("K"))
    bent = data.get("distortion_coefficients", data.get("D"))
    if matrix is None or bent is None:
        raise ValueError("camera_matrix or distortion_coefficients is missing")
    size = (data["image_width"], data["image_height"])
    if "xi" in data:
        return _make(
            "omnidirectional", size, _four(matrix), [*np.ravel(data["xi"]), *np.ravel(bent)]
        )
    fisheye = data.get("fisheye_model") or data.get("camera_model") == "fisheye"
    return _make("kannala_brandt" if fisheye else "brown_conrady", size, _four(matrix), bent)


def _read_ros(data: dict[str, Any]) -> Lens:
    """Read the file of ROS's ``camera_info_manager``, or an echoed message (K, D in place)."""
    models = {
        "plumb_bob": "brown_conrady",
        "rational_polynomial": "brown_conrady",
        "equidistant": "kannala_brandt",
        "fisheye": "kannala_brandt",
    }
    model = str(data["distortion_model"])
    if model not in models:
        raise ValueError(f"distortion_model {model!r} is not known (known: {', '.join(models)})")
    size = [data[key] if key in data else data[f"image_{key}"] for key in ("width", "height")]
    matrix = data["camera_matrix"]["data"] if "camera_matrix" in data else _either(data, "k")
    bent = (
        data["distortion_coefficients"]["data"]
        if "distortion_coefficients" in data
        else _either(data, "d")
    )
    return _make(models[model], size, _four(matrix), bent)


def _either(data: dict[str, Any], key: str) -> Any:
    """Value of a key in lower case (ROS 2) or upper case (ROS 1)."""
    return data[key] if key in data else data[key.upper()]


def _read_kalibr(data: dict[str, Any]) -> Lens:
    """Read one camera of Kalibr's ``camchain.yaml``."""
    camera, bent = str(data["camera_model"]), str(data.get("distortion_model", "none"))
    numbers = [float(value) for value in data["intrinsics"]]
    coefficients = [float(value) for value in data.get("distortion_coeffs", [])]
    size = data["resolution"]
    if camera == "pinhole" and bent == "equidistant":
        return _make("kannala_brandt", size, numbers, coefficients)
    if camera == "pinhole" and bent in ("radtan", "none"):
        return _make("brown_conrady", size, numbers, coefficients)
    if camera == "omni" and bent in ("radtan", "none"):
        return _make("omnidirectional", size, numbers[1:], [numbers[0], *coefficients])
    raise ValueError(
        f"camera model {camera!r} with distortion {bent!r} is not known (known: pinhole and omni "
        "with radtan or none, pinhole with equidistant)"
    )


def _matrix(lens: Lens) -> list[float]:
    """Nine numbers of the camera matrix, row by row."""
    return [lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0]


def _padded(lens: Lens, least: int) -> list[float]:
    """Coefficients, with zeros where the file wants at least some."""
    return [*lens.distortion, *[0.0] * (least - len(lens.distortion))]


def _opencv_text(lens: Lens, name: str) -> str:
    """YAML of ``cv2.FileStorage``."""
    store = cv2.FileStorage(
        ".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    )
    names = {"kannala_brandt": "fisheye", "omnidirectional": "omnidir"}
    store.write("camera_name", name)
    store.write("camera_model", names.get(lens.model, "pinhole"))
    store.write("image_width", lens.width_px)
    store.write("image_height", lens.height_px)
    store.write("camera_matrix", np.array(_matrix(lens)).reshape(3, 3))
    bent = _padded(lens, 4)
    if lens.model == "omnidirectional":
        store.write("xi", float(lens.distortion[0]))
        bent = _padded(lens, 5)[1:]
    store.write("distortion_coefficients", np.array([bent]))
    return str(store.releaseAndGetString())


def _ros_text(lens: Lens, name: str) -> str:
    """YAML of ``camera_info_manager``."""
    models = {"pinhole": "plumb_bob", "kannala_brandt": "equidistant"}
    if lens.model == "omnidirectional":
        raise DesignError(
            "lens-not-representable",
            "ROS camera_info has no omnidirectional model; write it as 'opencv' or 'kalibr'",
        )
    wide = len(lens.distortion) == 8
    models["brown_conrady"] = "rational_polynomial" if wide else "plumb_bob"
    bent = _padded(lens, 4 if lens.model == "kannala_brandt" else 5)
    k = _matrix(lens)
    data = {
        "image_width": lens.width_px,
        "image_height": lens.height_px,
        "camera_name": name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": k},
        "distortion_model": models[lens.model],
        "distortion_coefficients": {"rows": 1, "cols": len(bent), "data": bent},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {
            "rows": 3,
            "cols": 4,
            "data": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
        },
    }
    return _dump(data)


def _kalibr_text(lens: Lens, name: str) -> str:
    """YAML of Kalibr's camchain, one camera."""
    numbers, bent = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px], _padded(lens, 4)
    camera, kind = "pinhole", "radtan"
    if lens.model == "kannala_brandt":
        kind = "equidistant"
    elif lens.model == "omnidirectional":
        camera, numbers, bent = "omni", [lens.distortion[0], *numbers], _padded(lens, 5)[1:]
    if any(bent[4:]):
        raise DesignError(
            "lens-not-representable",
            "Kalibr's radtan model has k1 k2 p1 p2 only (got a distortion with k3 or more); write "
            "it as 'opencv' or 'ros'",
        )
    data = {
        "cam0": {
            "camera_model": camera,
            "intrinsics": numbers,
            "distortion_model": kind,
            "distortion_coeffs": bent[:4],
            "resolution": [lens.width_px, lens.height_px],
            "rostopic": f"/{name}/image_raw",
        }
    }
    return _dump(data)


def _dump(data: dict[str, Any]) -> str:
    if not all(math.isfinite(value) for value in _numbers(data)):
        raise DesignError("lens-not-finite", "the lens holds numbers that are not finite")
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None))


def _numbers(data: Any) -> list[float]:
    """Every number in nested tables and lists."""
    if isinstance(data, dict):
        return [n for value in data.values() for n in _numbers(value)]
    if isinstance(data, list):
        return [n for value in data for n in _numbers(value)]
    return [float(data)] if isinstance(data, int | float) else []
