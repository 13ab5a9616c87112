"""Readers: bundles, streams, calibrations, positions, bodies, cut short and corrupt; or intact."""

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.cascade_network import CascadeNetwork
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.serving.wire_protocol import MessageSplitter, encode
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.design.camera_files import read_lens, write_lens
from phytac_design.design.fixture_table import read_stl
from phytac_design.design.positions import read_positions
from phytac_design.layout import make_markers
from phytac_design.mechanics.calibration.measurements import read_measurements
from phytac_design.simulation.scenario.scenario_file import load_scenario
from phytac_shapes.errors import DesignError, InputError
from verification.case import Case, Cases, Evidence, Expect, Recorder, unreadable, verify
from verification.designs import design_of

COUNT = 12
MONSTERS: tuple[Any, ...] = (
    *(None, "text", [], {}, -1, 0, 10**400, 1e308, float("nan"), True, [[[]]], "1", [None] * 3),
)
"""What may stand in the place of any value of a JSON file."""


def bundle() -> Bundle:
    """A made-up decoder of twelve markers."""
    rng = np.random.default_rng(0)
    apparent = 0.03 * (np.eye(COUNT) + 0.3 * rng.uniform(size=(COUNT, COUNT)))
    network = CascadeNetwork(
        parameters=rng.normal(size=351),
        activation="rectified",
        scale_in=rng.uniform(0.5, 2.0, 10),
        scale_out=3.0,
    )
    model = ForceModel(
        shift_to_mm=rng.normal(size=(COUNT, 2)) / 20.0,
        stiffness=np.asarray(np.linalg.inv(apparent), dtype=np.float64),
        compliance_px=rng.normal(size=(2 * COUNT, COUNT)),
        height_z_mm=np.linspace(0.0, 100.0, COUNT),
        neighbours=rng.integers(-1, COUNT, (COUNT, 8)),
        networks={"fem_nn": network},
    )
    return Bundle(
        design="made-up",
        design_hash="0" * 64,
        cameras=(Camera.on_axis(width_px=640, height_px=480, focal_px=240, stand_off_mm=30),),
        read_by=np.zeros(COUNT, dtype=np.int64),
        colours=ColourModel.from_rgb({"blue": (28, 72, 214), "red": (214, 30, 34)}),
        colour=np.zeros(COUNT, dtype=np.int64),
        position_mm=rng.normal(size=(COUNT, 3)),
        head_mm=rng.normal(size=(COUNT, 3)),
        rest_px=rng.normal(size=(COUNT, 2)),
        tip_bias_px=np.zeros((COUNT, 2)),
        tips=TipModel(
            on_px=rng.normal(size=(COUNT, 2)), red_rest_px=np.zeros(COUNT), red_on_px=np.ones(COUNT)
        ),
        model=model,
        threshold_N=np.linspace(0.4, 0.8, COUNT),
    )


def _read_or_reject(what: str, read: Callable[[], Any], found: Evidence) -> None:
    """Read a damaged file: it is read, or rejected with a message that a user understands."""
    try:
        read()
    except (InputError, DesignError) as error:
        poor = unreadable(str(error).replace("nan", "NaN"))
        found.true(
            f"{what}: {poor or 'readable'}{': ' + str(error)[:200] if poor else ''}", not poor
        )
    else:
        found.true(f"{what}: read", True)


def check_bundle_key(values: Mapping[str, Any], found: Evidence) -> None:
    """One value of ``bundle.json`` missing, or of another kind."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_bundle(bundle(), folder)
        path = folder / "bundle.json"
        whole = json.loads(path.read_text())
        for monster in ("missing", *MONSTERS):
            meta = json.loads(json.dumps(whole))
            at = meta
            for key in values["keys"][:-1]:
                at = at[key]
            if monster == "missing":
                del at[values["keys"][-1]]
            else:
                at[values["keys"][-1]] = monster
            path.write_text(json.dumps(meta))
            what = f"{'.'.join(map(str, values['keys']))} {monster!r:.20}"
            _read_or_reject(what, lambda: _use(load_bundle(folder)), found)


def _use(read: Bundle) -> None:
    """A bundle that was read must also work."""
    got = read.model.forces("koi_inverse", np.ones((COUNT, 2)), np.array([1, 4]))
    if not np.isfinite(got).all():
        raise ArithmeticError("the bundle was read, but its forces are not finite")
    read.limits()
    read.camera.project(np.array([[1.0, 2.0, 30.0]]))


def check_bundle_bytes(values: Mapping[str, Any], found: Evidence) -> None:
    """Files of a bundle cut short, or with some bytes changed."""
    rng = np.random.default_rng(values["seed"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = bundle()
        save_bundle(made, folder)
        back = load_bundle(folder)
        found.close("an intact bundle", back.model.stiffness, made.model.stiffness, 0.0)
        path = folder / values["file"]
        whole = path.read_bytes()
        for _ in range(40):
            data = bytearray(whole)
            if values["how"] == "cut":
                data = data[: int(rng.integers(len(data)))]
            else:
                # The header says what is where; the numbers behind it are any bytes anyway.
                most = len(data) if values["file"].endswith("json") else 1500
                for at in rng.integers(most, size=int(rng.integers(1, 6))):
                    data[int(at)] = int(rng.integers(256))
            path.write_bytes(bytes(data))
            _read_or_reject(values["how"], lambda: load_bundle(folder), found)


def check_stream(values: Mapping[str, Any], found: Evidence) -> None:
    """Messages in pieces of any size come out whole; corrupt ones are rejected."""
    rng = np.random.default_rng(values["seed"])
    messages = [{"type": "frame", "number": k, "text": "ü" * k} for k in range(30)]
    framing = values["framing"]
    data = b"".join(encode(message, framing) for message in messages)
    splitter, got = MessageSplitter(framing), []
    at = 0
    while at < len(data):
        step = int(rng.integers(1, 40))
        got += splitter.feed(data[at : at + step])
        at += step
    found.true("all messages, whole and in order", got == messages, kind="reference")
    for _ in range(60):
        corrupt = bytearray(data)
        for k in rng.integers(len(corrupt), size=5):
            corrupt[int(k)] = int(rng.integers(256))

        def feed(corrupt: bytes = bytes(corrupt)) -> None:
            MessageSplitter(framing).feed(corrupt)

        _read_or_reject("five bytes changed", feed, found)


def _measurements(path: Path) -> Any:
    """Measurements of a small cylinder."""
    design = design_of({"shape": "cylinder"})
    surface = design.surface()
    return read_measurements(
        path, surface, make_markers(design, surface), wall_mm=design.wall.thickness_mm
    )


TEXTS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "positions": ("x.csv", read_positions),
    "lens": ("x.yaml", read_lens),
    "body": ("x.stl", read_stl),
    "measurements": ("x.csv", _measurements),
    "scenario": ("x.toml", lambda path: load_scenario(str(path))),
}


def check_text(values: Mapping[str, Any], found: Evidence) -> None:
    """A text file of a kind, intact or not."""
    name, read = TEXTS[values["kind"]]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(values["text"].encode("latin-1"))
        read(path)
    found.true("it was read", True)


def check_corrupt(values: Mapping[str, Any], found: Evidence) -> None:
    """A sound text file with bytes changed, or cut short, many times."""
    name, read = TEXTS[values["kind"]]
    rng = np.random.default_rng(values["seed"])
    whole = values["text"].encode("latin-1")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(whole)
        read(path)
        for _ in range(60):
            data = bytearray(whole)
            for at in rng.integers(len(data), size=int(rng.integers(1, 4))):
                data[int(at)] = int(rng.integers(256))
            data = data[: int(rng.integers(1, len(data)))] if rng.random() < 0.3 else data
            path.write_bytes(bytes(data))
            _read_or_reject("bytes changed", lambda: read(path), found)


def check_lens_file(values: Mapping[str, Any], found: Evidence) -> None:
    """A lens written as a calibration file and read again is itself."""
    section = design_of({"shape": "plane", "changes": {"camera": values["camera"]}}).camera
    lens = section.lens()
    with tempfile.TemporaryDirectory() as folder:
        path = write_lens(lens, Path(folder) / "x.yaml", values["format"])
        back = read_lens(path)
    point = np.array([[0.1, -0.2, 1.0], [0.0, 0.0, 2.0]])
    found.add(
        "pixels of the lens that was read, px", back.project(point) - lens.project(point), 1e-6
    )


POSITIONS = "u,v,colour,height_mm\n1.0,2.0,blue,3.0\n4.0,5.0,green,2.5\n"
LENS = (
    "image_width: 640\nimage_height: 480\ncamera_name: a\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [240.0, 0.0, 319.5, 0.0, 240.0, 239.5, 0.0, 0.0, 1.0]\n"
    "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
    "  data: [-0.1, 0.01, 0.0, 0.0, 0.0]\n"
)
BODY = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    "endfacet\nendsolid a\n"
)


def cases() -> Cases:
    """Every key of a bundle, bytes of its files, streams, and text files of every kind."""
    out = Cases()
    keys: list[list[Any]] = [
        [key]
        for key in (
            *("format", "schema_version", "design", "design_hash", "markers", "camera", "cameras"),
            *("colours", "networks", "threshold_N", "noise_centroid_px", "force_max_N", "notes"),
        )
    ]
    keys += [["colours", key] for key in ("names", "chroma", "floor")]
    keys += [["networks", "fem_nn", key] for key in ("activation", "scale_in", "scale_out")]
    camera = ("model", "width_px", "height_px", "focal_px", "centre_px", "distortion")
    keys += [["cameras", 0, key] for key in (*camera, "position_mm", "rotation")]
    for path in keys:
        name = f"bundle: {'.'.join(map(str, path))} missing or of another kind"
        out.add(name, check_bundle_key, keys=path)
    for file in ("bundle.json", "bundle.safetensors"):
        for how in ("cut", "changed"):
            out.add(f"bundle: {file}, {how}", check_bundle_bytes, file=file, how=how, seed=1)
    for framing in ("lines", "length"):
        out.add(
            f"stream as {framing}, in pieces and corrupt", check_stream, framing=framing, seed=2
        )
    for kind, text in (("positions", POSITIONS), ("lens", LENS), ("body", BODY)):
        out.add(f"{kind}: corrupt", check_corrupt, kind=kind, text=text, seed=3)
    fisheye, omni = {"model": "kannala_brandt"}, {"model": "omnidirectional"}
    cameras: dict[str, dict[str, Any]] = {
        "a pinhole": {},
        "a fisheye": fisheye | {"focal_px": 150.0, "distortion": [-0.01, 0.004, -0.003, 5e-4]},
        "an omnidirectional lens": omni
        | {"focal_px": 300.0, "distortion": [1.2, 0.01, 0.0, 1e-3, 0.0]},
        "a barrel lens": {"model": "brown_conrady", "distortion": [-0.2, 0.03, 1e-3, 0.0]},
        "focal length 1e-3": {"focal_px": 1e-3},
    }
    for name, lens in cameras.items():
        for file_format in ("opencv", "ros", "kalibr"):
            title = f"lens file: {name} as {file_format}"
            out.add(title, check_lens_file, "either", camera=lens, format=file_format)
    deep = "[" * 5000 + "]" * 5000
    bad = {
        "nothing": "",
        "no text": "\xff\xfe\x00\x80",
        "a million letters": "x" * 10**6,
        "lists nested 5000 deep": deep,
        "a key with nested lists": f"a: {deep}",
        "an alias of itself": "a: &a [*a]",
        "zeros": "\x00" * 100,
        "a quote that is not closed": 'u,v\n1.0,"2.0\n3.0,4.0\n',
        "another file's text": POSITIONS + LENS + BODY,
    }
    for kind in TEXTS:
        for name, text in bad.items():
            # A body may stand behind other text in its file.
            either = (kind, name) == ("body", "another file's text")
            expect: Expect = "either" if either else "refused"
            out.add(f"{kind}: {name}", check_text, expect, kind=kind, text=text)
    return out


CASES = cases()


@CASES.parametrize
def test_readers(case: Case, record_property: Recorder) -> None:
    """Bundles, streams, calibrations, positions, bodies: cut short and corrupt."""
    verify(case, record_property)
