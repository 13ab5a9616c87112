"""The bundle: the contract between design tool and decoder. JSON and safetensors, no pickles.

Schema policy: ``schema_version`` is ``MAJOR.MINOR``. A reader accepts any bundle of its own major
version whose minor version is not newer than its own. A minor step adds fields; only a major step
removes fields or changes their meaning.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import file_digest
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.camera_motion import (
    MOUNTS,
    CameraMotion,
    Mount,
    tabulate_camera_motion,
)
from phytac_decoder.estimation.cascade_network import ACTIVATIONS, BASES, INPUTS, CascadeNetwork
from phytac_decoder.estimation.estimators import ForceModel, TIP_SD_px
from phytac_decoder.estimation.force_regions import Region, regions_from_table, regions_to_table
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.io.bundle_camera import camera_from, camera_table
from phytac_decoder.io.bundle_check import (
    ARRAYS,
    COVERS,
    MARKS,
    SHOWN,
    bounded,
    check_bundle,
    describe_fault,
    finite_float,
    number,
    numbers,
    reject_constant,
)
from phytac_decoder.io.bundle_locator import locator_arrays, locator_from, locator_table
from phytac_decoder.io.sensor_limits import (
    NOISE_SHARE_MAX,
    check_scene,
    limits_of,
    markers_in_play,
    orientation_notes,
    symmetric_turns,
)
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_decoder.vision.marker_edges import MarkerEdges
from phytac_decoder.vision.picture_quality import FocusCheck, LightCheck
from phytac_decoder.vision.reference_marks import ReferenceMarks, with_marks
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.switch_detection import TipCovers, TipModel
from phytac_decoder.vision.white_balance import WhiteBalance
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.bounded_reader import check_file, read_text
from phytac_shapes.errors import InputError, cause_of

SCHEMA, FORMAT = (1, 24), "phytac-decoder-bundle"
TIPS = {"tip_on_px": "on_px", "tip_red_rest_px": "red_rest_px", "tip_red_on_px": "red_on_px"}
"""Attributes of a tip model by name of the array."""


@dataclass(frozen=True, kw_only=True)
class CameraView:
    """One camera's view of the unloaded sensor, also of markers that the other camera reads.

    Attributes
    ----------
    rest_px : (n, 2) float
        Predicted rest positions; NaN for markers that it does not see.
    tips : TipModel
        Appearance of the red tips.
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
        One or two cameras; the near end's first.
    read_by : (n,) int
        Camera that reads each marker; pixels of a marker are those of this camera.
    colours : ColourModel
        Paints; the markers' colours first, ``red`` among them.
    colour : (n,) int
        Class of each marker's paint.
    position_mm : (n, 3) float
        Marker on the outer face: where its force acts.
    head_mm : (n, 3) float
        Marker's paint on the end face of its receptor, unloaded.
    rest_px : (n, 2) float
        Predicted rest positions.
    tip_bias_px : (n, 2) float
        Shift of a marker's own centroid because its red tip is out and covers some of its paint.
    tips : TipModel
        Appearance of the red tips.
    model : ForceModel
        Force estimators.
    threshold_N : (n,) float
        Force on each switch's footprint that turns the switch on.
    noise_centroid_px : float
        Standard deviation of each coordinate of a marker's centroid.
    force_max_N : float
        Largest force that the sensor is designed for.
    shown : tuple of CameraView
        View of each of two cameras; empty for one camera.
    regions : tuple of Region
        Named parts of the surface, such as fingers.
    marks : ReferenceMarks
        Dots on the clamped rims; none in a sensor without.
    covers : TipCovers
        Tips that cover the paint of other markers.
    turned_deg : float
        Angle by which the shell sits turned about the axis against the design, where reference
        marks show it.
    learnt_rest_px : (k, n, 2) float
        Rest positions of the prints that it was trained on, NaN where a marker was not found.
    other_print_mm : float
        How far markers are from there, where the rest frame shows another print; 0 for the same.
    focus : tuple of FocusCheck or None
        How the focus of each camera's frames is measured; empty without a rest frame.
    light : tuple of LightCheck or None
        Levels of each camera's markers at rest; empty without a rest frame.
    white_balance : tuple of WhiteBalance or None
        The wall's levels in each camera's rest frame; empty without a rest frame.
    edges : tuple of MarkerEdges or None
        Edges of each camera's markers at rest, where markers are small; empty without a rest frame.
    notes : dict
        Provenance: training data, seconds, accuracy. The decoder uses only ``scene``.
    """

    design: str
    design_hash: str
    cameras: tuple[Camera, ...]
    read_by: IntArray
    colours: ColourModel
    colour: IntArray
    position_mm: FloatArray
    head_mm: FloatArray
    rest_px: FloatArray
    tip_bias_px: FloatArray
    tips: TipModel
    model: ForceModel
    threshold_N: FloatArray
    noise_centroid_px: float = 0.04
    force_max_N: float = 25.0
    shown: tuple[CameraView, ...] = ()
    regions: tuple[Region, ...] = ()
    marks: ReferenceMarks = field(default_factory=ReferenceMarks)
    covers: TipCovers = field(default_factory=TipCovers)
    turned_deg: float = 0.0
    learnt_rest_px: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 2)))
    other_print_mm: float = 0.0
    focus: tuple[FocusCheck | None, ...] = ()
    light: tuple[LightCheck | None, ...] = ()
    white_balance: tuple[WhiteBalance | None, ...] = ()
    edges: tuple[MarkerEdges | None, ...] = ()
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def camera(self) -> Camera:
        """The camera; the near end's of two."""
        return self.cameras[0]

    @property
    def spot_colour(self) -> IntArray:
        """Class of the paint of each marker, then of each reference mark, (n + r,)."""
        return np.append(self.colour, self.marks.colour)

    @property
    def spot_read_by(self) -> IntArray:
        """Camera that reads each marker and reference mark, (n + r,)."""
        return np.append(self.read_by, self.marks.read_by)

    @property
    def spot_neighbours(self) -> IntArray:
        """Neighbours of each marker and reference mark, (n + r, 8)."""
        return with_marks(self.model.neighbours, self.marks.neighbours)

    @property
    def spot_rest_px(self) -> FloatArray:
        """Predicted rest positions of markers and reference marks, (n + r, 2)."""
        return np.concatenate([self.rest_px, self.marks.rest_px])

    def spots_shown_by(self, number: int) -> FloatArray:
        """Return the same (n + r, 2) in one camera's image; NaN for what it does not show."""
        own = (self.marks.read_by == number)[:, None]
        marks = np.where(own, self.marks.rest_px, np.nan)
        return np.concatenate([self.shown_by(number).rest_px, marks])

    @cached_property
    def symmetric_turns(self) -> list[IntArray]:
        """Turns of the shell that map its markers onto one another; the first is none."""
        return symmetric_turns(self.position_mm, self.head_mm, self.colour)

    @property
    def symmetry_order(self) -> int:
        """Number of turns at which the shell without reference marks looks the same."""
        return len(self.symmetric_turns)

    @cached_property
    def mark_motion(self) -> CameraMotion | None:
        """Shifts of the reference marks by motion of the cameras; None without marks."""
        motion = self.model.camera_motion
        if motion is None or not self.marks.count:
            return None
        marks = self.marks
        table = tabulate_camera_motion(self.cameras, marks.read_by, marks.point_mm, MOUNTS["bench"])
        return replace(table, sd=motion.sd[: motion.motions])

    def shown_by(self, number: int) -> CameraView:
        """Return the view of a camera."""
        return (
            self.shown[number] if self.shown else CameraView(rest_px=self.rest_px, tips=self.tips)
        )

    def of_camera(self, number: int) -> str:
        """Return " of the near camera" or " of the far camera"; "" for a single camera."""
        return f" of the {('near', 'far')[number]} camera" if len(self.cameras) > 1 else ""

    @property
    def stiffness_usable(self) -> BoolArray:
        """Markers (n,) at which the noise of K·u, and of the networks, is below the limit."""
        noise = self.noise_centroid_px * self.model.stiffness_noise_N_px
        return np.asarray(noise <= NOISE_SHARE_MAX * self.force_max_N)

    @property
    def force_readable(self) -> BoolArray:
        """Markers (n,) at which the noise of the best estimator is below the limit."""
        noise = self.noise_centroid_px * self.model.inverse_noise_N_px
        return np.asarray(noise <= NOISE_SHARE_MAX * self.force_max_N)

    def tip_shift_px(self, switch_on: BoolArray) -> FloatArray:
        """Return the shift (n, 2) px of markers because tips (n,) are out and cover paint."""
        return np.where(switch_on[:, None], self.tip_bias_px, 0.0) + self.covers.shift(switch_on)

    def with_mount(self, mount: Mount = "bench") -> "Bundle":
        """Return the decoder for cameras that may move as far as a mount allows."""
        motion = tabulate_camera_motion(self.cameras, self.read_by, self.head_mm, MOUNTS[mount])
        return replace(self, model=self.model.with_camera_motion(motion, self.noise_centroid_px))

    def limits(self, estimator: str | None = None) -> list[str]:
        """Return what this sensor cannot read in any frame, one sentence each.

        Limits of other estimators are left out where one is given.
        """
        return [*orientation_notes(self), *limits_of(self, estimator)]


def save_bundle(bundle: Bundle, folder: Path) -> None:
    """Write ``bundle.json`` and ``bundle.safetensors`` into ``folder``."""
    model = bundle.model
    meta = {
        "format": FORMAT,
        "schema_version": f"{SCHEMA[0]}.{SCHEMA[1]}",
        "design": bundle.design,
        "design_hash": bundle.design_hash,
        "markers": len(bundle.colour),
        "symmetry_order": bundle.symmetry_order,
        "units": {"length": "mm", "force": "N", "image": "px", "stiffness": "N/mm"},
        # The first camera also by itself: a field keeps its meaning within a major version.
        "camera": camera_table(bundle.camera),
        "cameras": [camera_table(camera) for camera in bundle.cameras],
        "colours": {
            "names": list(bundle.colours.names),
            "chroma": bundle.colours.chroma.tolist(),
            "floor": bundle.colours.floor,
            "edge": bundle.colours.edge,
        },
        "networks": {
            name: {
                "activation": net.activation,
                "scale_in": net.scale_in.tolist(),
                "scale_out": net.scale_out,
                "base": net.base,
                **({} if net.low is None else {"low": net.low.tolist()}),
                **({} if net.high is None else {"high": net.high.tolist()}),
            }
            for name, net in model.networks.items()
        },
        # The median; up to schema 1.2 all markers had the same threshold.
        "threshold_N": float(np.median(bundle.threshold_N)),
        "noise_centroid_px": float(bundle.noise_centroid_px),
        "tip_sd_px": float(model.tip_sd_px),
        **({} if model.modulus is None else {"modulus": float(model.modulus)}),
        "force_max_N": float(bundle.force_max_N),
        "notes": bundle.notes,
    }
    arrays = {name: attrgetter(attribute)(bundle) for name, (attribute, _) in ARRAYS.items()}
    arrays |= {f"network.{name}": net.parameters for name, net in model.networks.items()}
    arrays |= _switch_arrays(bundle)
    if model.locator is not None:
        meta["auto"] = locator_table(model.locator)
        arrays |= locator_arrays(model.locator)
    if bundle.regions:
        meta["regions"] = regions_to_table(bundle.regions)
    if bundle.marks.count:
        arrays |= {name: getattr(bundle.marks, name[5:]) for name in MARKS}
    if len(bundle.covers.marker):
        arrays |= {name: getattr(bundle.covers, name[6:]) for name in COVERS}
    if len(bundle.learnt_rest_px):
        arrays["learnt_rest_px"] = bundle.learnt_rest_px
    arrays |= _learnt_arrays(model)
    if bundle.shown:
        attributes = ("rest_px", *(f"tips.{attribute}" for attribute in TIPS.values()))
        for name, attribute in zip(SHOWN, attributes, strict=True):
            arrays[name] = np.stack([attrgetter(attribute)(view) for view in bundle.shown])
    folder.mkdir(parents=True, exist_ok=True)
    save_file(
        {name: np.ascontiguousarray(value) for name, value in sorted(arrays.items())},
        folder / "bundle.safetensors",
    )
    _write_meta(folder, meta | {"arrays_sha256": _sha256(folder)})


def _learnt_arrays(model: ForceModel) -> dict[str, Any]:
    """Return what training has found of forces on receptors."""
    arrays: dict[str, Any] = {}
    measured, receptors = model.measured, model.receptors
    if measured is not None:
        arrays["measured_marker"] = measured.marker
        arrays["measured_px"] = measured.shift_px.astype(np.float32)
        if measured.square_px.size:
            arrays["measured_square_px"] = measured.square_px.astype(np.float32)
            arrays["measured_pair"] = measured.pair
            arrays["measured_pair_px"] = measured.pair_px.astype(np.float32)
    if receptors is not None:
        arrays |= {
            "receptor_px": receptors.shift_px,
            "receptor_marker": receptors.marker,
            "receptor_pair": receptors.pair,
            "receptor_pair_px": receptors.pair_px,
            "receptor_top_N": np.array([receptors.top_N]),
        }
    return arrays


def stamp_bundle(
    folder: Path, *, design: str, design_hash: str, regions: Sequence[Region] = ()
) -> None:
    """Write a design's name, hash and named regions into a finished bundle's ``bundle.json``."""
    meta = json.loads((folder / "bundle.json").read_text(encoding="utf-8"))
    meta |= {"design": design, "design_hash": design_hash}
    meta.pop("regions", None)
    if regions:
        meta["regions"] = regions_to_table(regions)
    _write_meta(folder, meta)


def _write_meta(folder: Path, meta: dict[str, Any]) -> None:
    text = json.dumps(meta, indent=1, sort_keys=True, ensure_ascii=False)
    (folder / "bundle.json").write_text(text + "\n", encoding="utf-8")


def _sha256(folder: Path) -> str:
    with (folder / "bundle.safetensors").open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


STIFFNESS_CHANGE = 0.02
"""Relative standard deviation of a wall's stiffness against that when its decoder was trained:
it is assumed that printed polymers lose 0.5 % per kelvin, and that rooms vary by some kelvins."""


def load_bundle(
    folder: Path, *, mount: Mount = "bench", stiffness_change: float = STIFFNESS_CHANGE
) -> Bundle:
    """Read a bundle; check its version, its sizes and that every number is finite.

    Files above 64 MiB (JSON) and 8 GiB are rejected; that of a thousand markers has about 100 MB.

    Parameters
    ----------
    folder : Path
        Folder of ``bundle.json``.
    mount : str
        How firmly the cameras are held against the shell, one of ``MOUNTS``.
    stiffness_change : float
        How much the wall's stiffness may have changed since the decoder was trained: a relative
        standard deviation, which forces then have at least.

    Raises
    ------
    InputError
        If a file is missing, truncated or of a newer schema, if its arrays do not fit together,
        or if the two files are of different decoders.
    """
    meta = _read_meta(folder)
    try:
        check_file(folder / "bundle.safetensors", bytes_max=1 << 33)
        arrays = load_file(folder / "bundle.safetensors")
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "bundle-unreadable",
            f"{folder}/bundle.safetensors cannot be read ({cause_of(error)}); rebuild the decoder",
        ) from error
    try:
        bundle = _assemble(meta, arrays, folder).with_mount(mount)
        if bundle.model.locator:
            locator = replace(bundle.model.locator, stiffness_change=stiffness_change)
            bundle = replace(bundle, model=replace(bundle.model, locator=locator))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(
            "bundle-invalid",
            f"{folder}/bundle.json is not a decoder bundle: {describe_fault(error)}; rebuild the "
            "decoder",
        ) from error
    # An interrupted copy leaves files of two decoders. Up to schema 1.10 there was no hash.
    if "arrays_sha256" in meta and meta["arrays_sha256"] != _sha256(folder):
        raise InputError(
            "bundle-files-differ",
            f"{folder}: bundle.json and bundle.safetensors are of two decoders; build or train "
            "this one again",
        )
    return bundle


def _read_meta(folder: Path) -> dict[str, Any]:
    path = folder / "bundle.json"
    try:
        meta = json.loads(
            read_text(path, bytes_max=1 << 26),
            parse_constant=reject_constant,
            parse_float=finite_float,
        )
    except OSError as error:
        raise InputError(
            "bundle-not-found",
            f"no decoder bundle in {folder} ({error.strerror}); give the folder that holds "
            "bundle.json, such as exports/cylinder60/decoder",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            "bundle-unreadable", f"{path} cannot be read ({cause_of(error)}); rebuild the decoder"
        ) from error
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise InputError(
            "bundle-unknown-format",
            f"{path} is not a decoder bundle (format is not {FORMAT!r}); give the folder of a "
            "decoder, such as exports/cylinder60/decoder",
        )
    try:
        major, minor = (int(part) for part in str(meta["schema_version"]).split("."))
    except (KeyError, ValueError) as error:
        raise InputError(
            "bundle-schema-version",
            f"{path} has no schema_version such as '{SCHEMA[0]}.{SCHEMA[1]}'; rebuild the decoder",
        ) from error
    if major != SCHEMA[0] or minor > SCHEMA[1]:
        raise InputError(
            "bundle-schema-version",
            f"{path} has schema {major}.{minor}, this decoder reads {SCHEMA[0]}.0 to "
            f"{SCHEMA[0]}.{SCHEMA[1]}; update phytac-design or rebuild the bundle",
        )
    return meta


def _assemble(meta: dict[str, Any], arrays: dict[str, Any], folder: Path) -> Bundle:
    """Check the arrays and make the bundle."""
    count = int(bounded(meta["markers"], "markers"))
    if "rest_px" not in arrays:
        raise InputError(
            "bundle-array-missing",
            f"{folder}/bundle.safetensors lacks 'rest_px'; rebuild the decoder",
        )
    rows = len(np.atleast_1d(arrays["rest_px"]))
    # Before any array is made of that size.
    if count != rows:
        raise InputError(
            "bundle-array-shape",
            f"{folder}/bundle.safetensors: rest_px has {rows} rows, expected {count} for {count} "
            "markers; the two files are of different builds",
        )
    # Up to schema 1.2 there was one camera and one threshold.
    tables = meta.get("cameras", [meta["camera"]])
    cameras = tuple(camera_from(table, folder) for table in tables)
    arrays.setdefault("read_by", np.zeros(count, dtype=np.int64))
    arrays.setdefault("threshold_N", np.full(count, float(meta["threshold_N"])))
    if "head_mm" not in arrays:  # up to schema 1.11
        arrays["head_mm"] = _heads_on_rays(arrays, cameras)
    check_bundle(
        arrays,
        markers=count,
        colours=len(meta["colours"]["names"]),
        cameras=len(tables),
        networks=meta["networks"],
        folder=folder,
    )
    marks = ReferenceMarks(**{name[5:]: arrays[name] for name in MARKS if name in arrays})
    model = ForceModel(
        shift_to_mm=arrays["shift_to_mm"],
        stiffness=arrays["stiffness"],
        compliance_px=arrays["compliance_px"],
        height_z_mm=arrays["height_z_mm"],
        neighbours=arrays["neighbours"],
        networks={
            name: _network(name, table, arrays[f"network.{name}"])
            for name, table in meta["networks"].items()
        },
        # Up to schema 1.15 it was not used.
        tip_sd_px=bounded(meta.get("tip_sd_px", TIP_SD_px), "tip_sd_px"),
        # Up to schema 1.20 large displacements were left out.
        modulus=bounded(meta["modulus"], "modulus", least=1e-3) if "modulus" in meta else None,
        # Up to schema 1.16 there were none.
        measured=_measured(arrays),
    )
    bundle = Bundle(
        design=str(meta["design"]),
        design_hash=str(meta["design_hash"]),
        cameras=cameras,
        read_by=arrays["read_by"],
        colours=ColourModel(
            names=tuple(meta["colours"]["names"]),
            chroma=np.asarray(meta["colours"]["chroma"], dtype=np.float64),
            floor=float(meta["colours"]["floor"]),
            # Up to schema 1.12 there was none.
            edge=float(meta["colours"].get("edge", ColourModel.edge)),
        ),
        colour=arrays["colour"],
        position_mm=arrays["position_mm"],
        head_mm=arrays["head_mm"],
        rest_px=arrays["rest_px"],
        tip_bias_px=arrays["tip_bias_px"],
        tips=TipModel(
            **{attribute: arrays[name] for name, attribute in TIPS.items()},
            gradual=_gradual(arrays),
        ),
        model=model,
        threshold_N=arrays["threshold_N"],
        # Up to schema 1.1 these were not stored.
        noise_centroid_px=bounded(meta.get("noise_centroid_px", 0.04), "noise_centroid_px"),
        force_max_N=bounded(meta.get("force_max_N", 25.0), "force_max_N"),
        shown=tuple(_view(arrays, number) for number in range(len(tables))) if tables[1:] else (),
        # Up to schema 1.4 there were none.
        regions=regions_from_table(meta.get("regions", []), count),
        # Up to schema 1.12 there were none.
        marks=marks,
        # Up to schema 1.13 there were none.
        covers=TipCovers(**{name[6:]: arrays[name] for name in COVERS if name in arrays}),
        # Up to schema 1.14 there were none.
        learnt_rest_px=arrays.get("learnt_rest_px", np.zeros((0, count, 2))),
        notes=dict(meta["notes"]),
    )
    check_scene(bundle)
    # Up to schema 1.3 there was no locator.
    if "auto" not in meta:
        return bundle
    locator = locator_from(
        meta["auto"],
        arrays,
        position_mm=bundle.position_mm,
        neighbours=model.neighbours,
        threshold_N=bundle.threshold_N,
        # Up to schema 1.19 all spread alike.
        threshold_sd=arrays.get("threshold_sd"),
        folder=folder,
    )
    locator = replace(locator, blind=bundle.tips.blind(markers_in_play(bundle)))
    # Up to schema 1.22 there were no receptors.
    receptors = _receptors(arrays, locator.places.orders)
    return replace(bundle, model=replace(model, locator=locator, receptors=receptors))


def _switch_arrays(bundle: Bundle) -> dict[str, Any]:
    """Return what a bundle has of switches that do not snap, or whose thresholds were learnt."""
    found, locator = {}, bundle.model.locator
    if locator is not None and locator.threshold_sd is not None:
        found["threshold_sd"] = locator.threshold_sd
    if bundle.tips.gradual is not None:
        found["tip_gradual"] = bundle.tips.gradual.astype(np.uint8)
    return found


def _gradual(arrays: dict[str, Any]) -> BoolArray | None:
    """Return the switches (n,) that do not snap; None up to schema 1.19, and for bowls."""
    stored = arrays.get("tip_gradual")
    return None if stored is None else stored.astype(np.bool_)


def _heads_on_rays(arrays: dict[str, Any], cameras: Sequence[Camera]) -> FloatArray:
    """Return the points (n, 3) nearest to the markers on the rays of their rest positions."""
    out = np.array(arrays["position_mm"], dtype=np.float64)
    for which, camera in enumerate(cameras):
        own = arrays["read_by"] == which
        ray = camera.rays(arrays["rest_px"][own])
        arm = out[own] - camera.position_mm
        out[own] = camera.position_mm + np.einsum("ni,ni->n", arm, ray)[:, None] * ray
    return out


def _measured(arrays: dict[str, Any]) -> MeasuredColumns | None:
    """Return the measured columns of the compliance, if there are any."""
    if "measured_px" not in arrays:
        return None
    columns = MeasuredColumns(marker=arrays["measured_marker"], shift_px=arrays["measured_px"])
    if "measured_square_px" not in arrays:  # Up to schema 1.21, and without large displacements.
        return columns
    return replace(
        columns,
        square_px=arrays["measured_square_px"],
        pair=arrays["measured_pair"],
        pair_px=arrays["measured_pair_px"],
    )


def _receptors(arrays: dict[str, Any], orders: int) -> ReceptorTable | None:
    """Return large displacements by forces on receptors, if there are any.

    Raises
    ------
    ValueError
        If they are not those of the same receptors and orders.
    """
    if "receptor_px" not in arrays:
        return None
    table = ReceptorTable(
        marker=arrays["receptor_marker"],
        shift_px=arrays["receptor_px"],
        pair=arrays["receptor_pair"],
        pair_px=arrays["receptor_pair_px"],
        top_N=float(arrays["receptor_top_N"][0]),
    )
    if table.shift_px.shape[1] != orders - 1:
        raise ValueError(f"receptor_px has {table.shift_px.shape[1]} powers, not {orders - 1}")
    strangers = np.setdiff1d(table.pair, table.marker)
    if len(strangers):
        raise ValueError(f"receptor_pair names {strangers[0]}, which receptor_marker lacks")
    if not table.top_N > 0.0:
        raise ValueError(f"receptor_top_N is {table.top_N:g}, not above zero")
    return table


def _network(name: str, table: dict[str, Any], parameters: FloatArray) -> CascadeNetwork:
    if table["activation"] not in ACTIVATIONS:
        raise ValueError(f"network {name!r} has an unknown activation {table['activation']!r}")
    # Up to schema 1.15 all networks added to K·U, without limits.
    base = table.get("base", "stiffness")
    if base not in BASES:
        raise ValueError(f"network {name!r} has an unknown base {base!r}")
    return CascadeNetwork(
        parameters=parameters,
        activation=table["activation"],
        scale_in=numbers(table["scale_in"], INPUTS, positive=True),
        scale_out=number(table["scale_out"]),
        base=base,
        low=numbers(table["low"], INPUTS) if "low" in table else None,
        high=numbers(table["high"], INPUTS) if "high" in table else None,
    )


def _view(arrays: dict[str, Any], number: int) -> CameraView:
    """Return the view of one of two cameras."""
    rest_px, *tips = (arrays[name][number] for name in SHOWN)
    named = dict(zip(TIPS.values(), tips, strict=True))
    return CameraView(rest_px=rest_px, tips=TipModel(**named, gradual=_gradual(arrays)))
