"""The bundle: the whole contract between design tool and decoder. JSON + safetensors, no pickles.

Schema policy: ``schema_version`` is ``MAJOR.MINOR``. A reader takes any bundle of its own major
version whose minor is not newer than its own; fields are added with a minor step, and removed or
given another meaning only with a major one.
"""

import json
from dataclasses import dataclass, field, replace
from hashlib import file_digest
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.cascade_network import ACTIVATIONS, INPUTS, CascadeNetwork
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.force_regions import Region, regions_from_table, regions_to_table
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle_camera import camera_from, camera_table
from phytac_decoder.io.bundle_check import (
    above_zero,
    check_arrays,
    check_count,
    check_indices,
    check_shown,
    fault_of,
    no_number,
    numbers,
    positive,
)
from phytac_decoder.io.bundle_locator import locator_arrays, locator_from, locator_table
from phytac_decoder.io.sensor_limits import NOISE_SHARE_MAX, check_scene, limits_of, markers_in_play
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.bounded_reader import check_file, read_text
from phytac_shapes.errors import InputError, cause_of

SCHEMA = (1, 11)
FORMAT = "phytac-decoder-bundle"
ENDS = ("near", "far")
META_BYTES_MAX = 1 << 26
ARRAYS_BYTES_MAX = 1 << 33
"""Largest files of a bundle that are read; that of a thousand markers has some 100 MB."""
"""Ends of a sensor with two cameras, in their order."""


@dataclass(frozen=True, kw_only=True)
class CameraView:
    """What one camera shows of the unloaded sensor, of markers that another one reads too.

    Attributes
    ----------
    rest_px : (n, 2) float
        Predicted rest positions; NaN for markers that it does not show.
    tips : TipModel
        What it shows of the red tips.
    """

    rest_px: FloatArray
    tips: TipModel


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A trained decoder of one sensor.

    Attributes
    ----------
    design : str
        Name of the design.
    design_hash : str
        Hash of the resolved design it was made from.
    cameras : tuple of Camera
        The cameras it expects, one or two; the near end's first.
    read_by : (n,) int
        Camera that each marker is read through; all that is in px, is in that camera's image.
    colours : ColourModel
        Paints; the markers' colours first, ``red`` among them.
    colour : (n,) int
        Class of each marker's paint.
    position_mm : (n, 3) float
        Marker on the outer face: where its force acts.
    rest_px : (n, 2) float
        Predicted rest positions.
    tip_bias_px : (n, 2) float
        Shift of a marker's own centroid because its red tip is out and covers some of its paint.
    tips : TipModel
        What is seen of the red tips.
    model : ForceModel
        Matrices and networks.
    threshold_N : (n,) float
        Force on each switch's footprint that turns it on: a receptor that is on carries some.
    noise_centroid_px : float
        Standard deviation of each coordinate of a marker's centroid.
    force_max_N : float
        Largest force that the sensor is meant for.
    shown : tuple of Shown
        What each camera shows; empty for one camera, which shows what it reads.
    regions : tuple of Region
        Named parts of the surface, such as fingers.
    notes : dict
        Provenance: training data, seconds, accuracy; free of meaning to the decoder.
    """

    design: str
    design_hash: str
    cameras: tuple[Camera, ...]
    read_by: IntArray
    colours: ColourModel
    colour: IntArray
    position_mm: FloatArray
    rest_px: FloatArray
    tip_bias_px: FloatArray
    tips: TipModel
    model: ForceModel
    threshold_N: FloatArray
    noise_centroid_px: float = 0.04
    force_max_N: float = 25.0
    shown: tuple[CameraView, ...] = ()
    regions: tuple[Region, ...] = ()
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def camera(self) -> Camera:
        """The camera; of two, the near end's."""
        return self.cameras[0]

    def shown_by(self, number: int) -> CameraView:
        """What a camera shows."""
        return (
            self.shown[number] if self.shown else CameraView(rest_px=self.rest_px, tips=self.tips)
        )

    def of_camera(self, number: int) -> str:
        """Which camera, in a sentence; "" if there is but one."""
        return f" of the {ENDS[number]} camera" if len(self.cameras) > 1 else ""

    @property
    def stiffness_usable(self) -> BoolArray:
        """Markers (n,) at which K·u, and the networks on top of it, can tell a force from noise."""
        noise = self.noise_centroid_px * self.model.stiffness_noise_N_px
        return np.asarray(noise <= NOISE_SHARE_MAX * self.force_max_N)

    @property
    def force_readable(self) -> BoolArray:
        """Markers (n,) at which any estimator can tell a force from noise."""
        noise = self.noise_centroid_px * self.model.inverse_noise_N_px
        return np.asarray(noise <= NOISE_SHARE_MAX * self.force_max_N)

    def limits(self) -> list[str]:
        """What this sensor cannot read whatever the frame, each as a sentence; empty for none."""
        return limits_of(self)


def save_bundle(bundle: Bundle, folder: Path) -> None:
    """Write ``bundle.json`` and ``bundle.safetensors`` into ``folder``."""
    model = bundle.model
    meta = {
        "format": FORMAT,
        "schema_version": f"{SCHEMA[0]}.{SCHEMA[1]}",
        "design": bundle.design,
        "design_hash": bundle.design_hash,
        "markers": len(bundle.colour),
        "units": {"length": "mm", "force": "N", "image": "px", "stiffness": "N/mm"},
        # The first camera also by itself: a field keeps its meaning within a major version.
        "camera": camera_table(bundle.camera),
        "cameras": [camera_table(camera) for camera in bundle.cameras],
        "colours": {
            "names": list(bundle.colours.names),
            "chroma": bundle.colours.chroma.tolist(),
            "floor": bundle.colours.floor,
            "ramp": bundle.colours.ramp,
        },
        "networks": {
            name: {
                "activation": net.activation,
                "scale_in": net.scale_in.tolist(),
                "scale_out": net.scale_out,
            }
            for name, net in model.networks.items()
        },
        # The most usual one: up to schema 1.2 it was every marker's.
        "threshold_N": float(np.median(bundle.threshold_N)),
        "noise_centroid_px": float(bundle.noise_centroid_px),
        "force_max_N": float(bundle.force_max_N),
        "notes": bundle.notes,
    }
    if model.locator is not None:
        meta["auto"] = locator_table(model.locator)
    if bundle.regions:
        meta["regions"] = regions_to_table(bundle.regions)
    arrays = {
        "colour": bundle.colour,
        "position_mm": bundle.position_mm,
        "rest_px": bundle.rest_px,
        "tip_bias_px": bundle.tip_bias_px,
        "tip_on_px": bundle.tips.on_px,
        "tip_red_rest_px": bundle.tips.red_rest_px,
        "tip_red_on_px": bundle.tips.red_on_px,
        "shift_to_mm": model.shift_to_mm,
        "stiffness": model.stiffness,
        "compliance_px": model.compliance_px,
        "height_z_mm": model.height_z_mm,
        "neighbours": model.neighbours,
        "read_by": bundle.read_by,
        "threshold_N": bundle.threshold_N,
    } | {f"network.{name}": net.parameters for name, net in model.networks.items()}
    if model.locator is not None:
        arrays |= locator_arrays(model.locator)
    if bundle.shown:
        arrays |= {
            "shown_rest_px": np.stack([item.rest_px for item in bundle.shown]),
            "shown_tip_on_px": np.stack([item.tips.on_px for item in bundle.shown]),
            "shown_tip_red_rest_px": np.stack([item.tips.red_rest_px for item in bundle.shown]),
            "shown_tip_red_on_px": np.stack([item.tips.red_on_px for item in bundle.shown]),
        }
    folder.mkdir(parents=True, exist_ok=True)
    save_file(
        {name: np.ascontiguousarray(value) for name, value in sorted(arrays.items())},
        folder / "bundle.safetensors",
    )
    meta["arrays_sha256"] = _sha256(folder)
    text = json.dumps(meta, indent=1, sort_keys=True, ensure_ascii=False)
    (folder / "bundle.json").write_text(text + "\n", encoding="utf-8")


def _sha256(folder: Path) -> str:
    with (folder / "bundle.safetensors").open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def load_bundle(folder: Path) -> Bundle:
    """Read a bundle back, checking version, sizes and that every number is finite.

    Raises
    ------
    InputError
        If a file is missing, truncated, of a newer schema, its arrays don't fit together, or its
        files are of two decoders.
    """
    meta = _read_meta(folder)
    try:
        check_file(folder / "bundle.safetensors", bytes_max=ARRAYS_BYTES_MAX)
        arrays = load_file(folder / "bundle.safetensors")
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{folder}/bundle.safetensors cannot be read ({cause_of(error)}); rebuild the decoder"
        ) from error
    try:
        count = int(meta["markers"])
        check_count(arrays, count, folder)
        # Up to schema 1.2 there was one camera and one threshold.
        tables = meta.get("cameras", [meta["camera"]])
        arrays.setdefault("read_by", np.zeros(count, dtype=np.int64))
        arrays.setdefault("threshold_N", np.full(count, float(meta["threshold_N"])))
        check_arrays(arrays, count, sorted(meta["networks"]), folder)
        check_indices(arrays, count, len(meta["colours"]["names"]), len(tables), folder)
        check_shown(arrays, count, len(tables), folder)
        locator = None
        # Up to schema 1.3 there was none.
        if "auto" in meta:
            locator = locator_from(
                meta["auto"],
                arrays,
                position_mm=arrays["position_mm"],
                neighbours=arrays["neighbours"],
                threshold_N=arrays["threshold_N"],
                folder=folder,
            )
        cameras = tuple(camera_from(table, folder) for table in tables)
        bundle = _assemble(meta, arrays, cameras, locator)
        check_scene(bundle)
        if locator is not None:
            locator = replace(locator, blind=bundle.tips.blind(markers_in_play(bundle)))
            bundle = replace(bundle, model=replace(bundle.model, locator=locator))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(
            f"{folder}/bundle.json is not a decoder bundle: {fault_of(error)}; rebuild the decoder"
        ) from error
    # A copy that was cut short leaves one file of each. Up to schema 1.10 none was told.
    if "arrays_sha256" in meta and meta["arrays_sha256"] != _sha256(folder):
        raise InputError(
            f"{folder}: bundle.json and bundle.safetensors are of two decoders; build or train "
            "this one again"
        )
    return bundle


def _read_meta(folder: Path) -> dict[str, Any]:
    path = folder / "bundle.json"
    try:
        meta = json.loads(read_text(path, bytes_max=META_BYTES_MAX), parse_constant=no_number)
    except OSError as error:
        raise InputError(
            f"no decoder bundle in {folder} ({error.strerror}); give the folder that holds "
            "bundle.json, such as exports/cylinder60/decoder"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({cause_of(error)}); rebuild the decoder") from error
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise InputError(
            f"{path} is not a decoder bundle (format is not {FORMAT!r}); give the folder of a "
            "decoder, such as exports/cylinder60/decoder"
        )
    try:
        major, minor = (int(part) for part in str(meta["schema_version"]).split("."))
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path} has no schema_version such as '{SCHEMA[0]}.{SCHEMA[1]}'; rebuild the decoder"
        ) from error
    if major != SCHEMA[0] or minor > SCHEMA[1]:
        raise InputError(
            f"{path} has schema {major}.{minor}, this decoder reads {SCHEMA[0]}.0 to "
            f"{SCHEMA[0]}.{SCHEMA[1]}; update phytac-design or rebuild the bundle"
        )
    return meta


def _assemble(
    meta: dict[str, Any],
    arrays: dict[str, Any],
    cameras: tuple[Camera, ...],
    locator: ContactLocator | None,
) -> Bundle:
    for name, item in meta["networks"].items():
        if item["activation"] not in ACTIVATIONS:
            raise ValueError(f"network {name!r} has an unknown activation {item['activation']!r}")
    networks = {
        name: CascadeNetwork(
            parameters=arrays[f"network.{name}"],
            activation=item["activation"],
            scale_in=np.array([above_zero(each) for each in numbers(item["scale_in"], INPUTS)]),
            scale_out=float(numbers([item["scale_out"]], 1)[0]),
        )
        for name, item in meta["networks"].items()
    }
    several = len(cameras) > 1
    return Bundle(
        design=str(meta["design"]),
        design_hash=str(meta["design_hash"]),
        cameras=cameras,
        read_by=arrays["read_by"],
        colours=ColourModel(
            names=tuple(meta["colours"]["names"]),
            chroma=np.asarray(meta["colours"]["chroma"], dtype=np.float64),
            floor=float(meta["colours"]["floor"]),
            # Up to schema 1.5 there was none.
            ramp=float(meta["colours"].get("ramp", 0.0)),
        ),
        colour=arrays["colour"],
        position_mm=arrays["position_mm"],
        rest_px=arrays["rest_px"],
        tip_bias_px=arrays["tip_bias_px"],
        tips=TipModel(
            on_px=arrays["tip_on_px"],
            red_rest_px=arrays["tip_red_rest_px"],
            red_on_px=arrays["tip_red_on_px"],
        ),
        model=ForceModel(
            shift_to_mm=arrays["shift_to_mm"],
            stiffness=arrays["stiffness"],
            compliance_px=arrays["compliance_px"],
            height_z_mm=arrays["height_z_mm"],
            neighbours=arrays["neighbours"],
            networks=networks,
            locator=locator,
        ),
        threshold_N=arrays["threshold_N"],
        # Up to schema 1.1 these were not stored.
        noise_centroid_px=positive(meta.get("noise_centroid_px", 0.04), "noise_centroid_px"),
        force_max_N=positive(meta.get("force_max_N", 25.0), "force_max_N"),
        shown=tuple(_shown(arrays, number) for number in range(len(cameras) if several else 0)),
        # Up to schema 1.4 there were none.
        regions=regions_from_table(meta.get("regions", []), len(arrays["colour"])),
        notes=dict(meta["notes"]),
    )


def _shown(arrays: dict[str, Any], number: int) -> CameraView:
    """What one of several cameras shows."""
    return CameraView(
        rest_px=arrays["shown_rest_px"][number],
        tips=TipModel(
            on_px=arrays["shown_tip_on_px"][number],
            red_rest_px=arrays["shown_tip_red_rest_px"][number],
            red_on_px=arrays["shown_tip_red_on_px"][number],
        ),
    )
