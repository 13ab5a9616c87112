"""Every reader of user files, each with valid files to start from."""

import json
import random
import struct
import tomllib
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

from tests.fuzz.corruption import changed, changed_table, json_text, toml_text

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "phytac_design" / "data"
TABLES = 0.6
"""Share of inputs with changed values; the others have changed bytes."""

Files = dict[str, bytes]


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One reader.

    Attributes
    ----------
    make : callable
        Random generator to the files of an input, by name.
    read : callable
        Reads them from a folder.
    """

    make: Callable[[random.Random], Files]
    read: Callable[[Path], Any]


def texts(
    name: str, seeds: Sequence[bytes], *, parse: Any = None, write: Any = None
) -> Callable[[random.Random], Files]:
    """Inputs of one file; with ``parse`` and ``write``, mostly by changed values."""
    tables = [parse(seed.decode()) for seed in seeds] if parse else []

    def make(rng: random.Random) -> Files:
        if tables and rng.random() < TABLES:
            return {name: write(changed_table(rng, rng.choice(tables)))}
        return {name: changed(rng, rng.choice(seeds), seeds)}

    return make


def shipped(kind: str) -> list[bytes]:
    """TOML files of the package."""
    return [path.read_bytes() for path in sorted((PACKAGE / kind).glob("*.toml"))]


def _toml(name: str, seeds: list[bytes]) -> Callable[[random.Random], Files]:
    return texts(name, seeds, parse=tomllib.loads, write=toml_text)


def _design() -> Reader:
    from phytac_design.design.design_file import load_design

    # 80 kB of points of a patch would take most of the changes.
    small = [seed for seed in shipped("designs") if len(seed) < 20_000]
    regions = b'\n[[regions]]\nname = "tip"\nmarkers = [0, 1]\n'
    body = (
        b'\n[[fixtures]]\nname = "rod"\nkind = "cylinder"\nradius_mm = 1.0\nfrom_mm = [0, 0, 1]\n'
    )
    seeds = [*small, small[0] + regions, small[0] + body + b"to_mm = [0, 0, 9]\n"]
    make = _toml("x.toml", seeds)
    return Reader(make=make, read=lambda at: load_design(str(at / "x.toml")))


def _tables(kind: str, load: Callable[[str], Any]) -> Reader:
    """Reader of a kind of TOML file that the package contains."""
    make = _toml("x.toml", shipped(kind))
    return Reader(make=make, read=lambda at: load(str(at / "x.toml")))


def _study() -> Reader:
    from phytac_design.study.search.study_file import load_study

    return _tables("studies", load_study)


def _scene() -> Reader:
    from phytac_design.design.scene import load_scene

    return _tables("scenes", load_scene)


def _scenario() -> Reader:
    from phytac_design.simulation.scenario.scenario_file import load_scenario

    return _tables("scenarios", load_scenario)


def _folder_of(write: Callable[[Path], Any]) -> Files:
    """Files that ``write`` leaves in a folder."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        write(Path(name))
        return {path.name: path.read_bytes() for path in Path(name).iterdir() if path.is_file()}


def _written(number: int, folder: Path) -> None:
    from phytac_design.datasets.samples_file import write_samples
    from tests.decoder.drawn_samples import META, drawn

    write_samples(folder, drawn(number), META)


def _dataset() -> Reader:
    from phytac_design.datasets.samples_file import read_samples, table_hash

    seeds = [_folder_of(partial(_written, number)) for number in range(3)]
    tables = [json.loads(seed["dataset.json"]) for seed in seeds]

    def make(rng: random.Random) -> Files:
        number = rng.randrange(len(seeds))
        files, table = dict(seeds[number]), tables[number]
        if rng.random() < 0.2:
            name = rng.choice(sorted(files))
            return files | {name: changed(rng, files[name], [files[name]])}
        if rng.random() < 0.5:
            files["samples.npz"] = _changed_zip(rng, files["samples.npz"])
        else:
            table = changed_table(rng, table)
        # Corrected checksums, or no code after their check would be reached.
        file = {
            "bytes": len(files["samples.npz"]),
            "sha256": sha256(files["samples.npz"]).hexdigest(),
        }
        if isinstance(table.get("file"), dict) and table["file"] == tables[number]["file"]:
            table = {**table, "file": table["file"] | file}
        try:
            table = {**table, "checksum": table_hash(table)}
        except (TypeError, ValueError, RecursionError):
            return files | {"dataset.json": json_text(table)}
        return files | {"dataset.json": json_text(table)}

    return Reader(make=make, read=read_samples)


def _changed_zip(rng: random.Random, data: bytes) -> bytes:
    """A zip with changed, renamed, missing or mislabelled members."""
    with zipfile.ZipFile(BytesIO(data)) as file:
        members = {name: file.read(name) for name in file.namelist()}
    name = rng.choice(sorted(members))
    how = rng.randrange(6)
    if how == 0:
        members[name] = changed(rng, members[name], list(members.values()))
    elif how == 1:
        head = rng.choice(
            (
                b"{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
                b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999,), }",
                b"{'descr': '<f8', 'fortran_order': True, 'shape': (-1,), }",
                b"{'descr': [('a', '<f8'), ('a', '<f8')], 'fortran_order': False, 'shape': (), }",
                b"(" * 3000,
                b"__import__('os').system('true')",
            )
        )
        members[name] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) + 1) + head + b"\n"
    elif how == 2:
        members["../" + name] = members.pop(name)
    elif how == 3:
        members[name] = bytes(rng.choice((10**5, 10**6)))
    elif how == 4:
        del members[name]
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for member, content in members.items():
            file.writestr(member, content)
    whole = out.getvalue()
    return changed(rng, whole, [whole]) if how == 5 else whole


def _bundle() -> Reader:
    from phytac_decoder.io.bundle import load_bundle, save_bundle
    from verification.test_readers import bundle

    seed = _folder_of(lambda at: save_bundle(bundle(), at))
    table = json.loads(seed["bundle.json"])
    arrays = seed["bundle.safetensors"]
    (size,) = struct.unpack("<Q", arrays[:8])
    head, body = json.loads(arrays[8 : 8 + size]), arrays[8 + size :]

    def make(rng: random.Random) -> Files:
        how = rng.random()
        if how < 0.4:
            return seed | {"bundle.json": json_text(changed_table(rng, table))}
        if how < 0.5:
            name = "bundle.json"
            return seed | {name: changed(rng, seed[name], [seed[name]])}
        if how < 0.6:
            return seed | {"bundle.safetensors": changed(rng, arrays, [arrays])}
        if how < 0.7:
            length = rng.choice((0, 1, size - 1, size + 1, 10**8, 2**40, 2**63, 2**64 - 1))
            return seed | {"bundle.safetensors": struct.pack("<Q", length) + arrays[8:]}
        text = json_text(_changed_head(rng, head))
        return seed | {"bundle.safetensors": struct.pack("<Q", len(text)) + text + body}

    return Reader(make=make, read=load_bundle)


def _changed_head(rng: random.Random, head: dict[str, Any]) -> dict[str, Any]:
    """A header of safetensors with other types, shapes and offsets of its arrays."""
    out: dict[str, Any] = json.loads(json.dumps(head))
    if rng.random() < 0.4:
        changed_head: dict[str, Any] = changed_table(rng, out)
        return changed_head
    entry = out[rng.choice(sorted(out))]
    how = rng.randrange(4)
    if how == 0:
        kinds = ("F16", "BF16", "F8_E4M3", "I8", "U64", "BOOL", "F4", "C64", "x", "F32")
        entry["dtype"] = rng.choice(kinds)
    elif how == 1:
        entry["shape"] = [rng.choice((0, 1, 12, 2**31, 2**62)) for _ in range(rng.randrange(4))]
    elif how == 2:
        entry["data_offsets"] = [rng.choice((0, 8, 96, 2**40, 2**63)) for _ in range(2)]
    else:
        first, second = rng.sample(sorted(out), 2)
        out[first], out[second] = out[second], out[first]
    return out


MEASURED = (
    b"contact_marker,patch_radius_mm,force_N,displacement_mm\n16,4,0.52,0.0171\n3,4,0.52,0.02\n",
    (
        b"contact_x_mm,contact_y_mm,contact_z_mm,patch_radius_mm,force_N,displacement_mm\n"
        b"20,0,20,4,0.5,0.01\n0,20,20,4,0.5,0.01\n"
    ),
    (
        b"# a log\ncontact_u,contact_v,probe_marker,patch_radius_mm,force_N,displacement_mm\n"
        b"20,1,3,0,0.5,0.01\n"
    ),
)


def _calibration() -> Reader:
    from phytac_design.layout import make_markers
    from phytac_design.mechanics.calibration.measurements import read_measurements
    from verification.designs import design_of

    design = design_of({"shape": "cylinder"})
    surface = design.surface()
    markers = make_markers(design, surface)

    def read(at: Path) -> Any:
        return read_measurements(at / "x.csv", surface, markers, wall_mm=design.wall.thickness_mm)

    return Reader(make=texts("x.csv", MEASURED), read=read)


def _stream() -> Reader:
    from phytac_decoder.serving.wire_protocol import MessageSplitter, encode

    messages: list[dict[str, Any]] = [
        {"type": "hello", "format": "phytac-stream", "version": "1.1", "units": {"force": "N"}},
        {"type": "frame", "sequence": 5, "timestamp_s": 0.25, "forces_N": [1.0], "koi": [7]},
        {"type": "end", "reason": "ü"},
    ]
    valid = {
        framing: [encode(message, framing) for message in messages]
        for framing in ("lines", "length")
    }

    def make(rng: random.Random) -> Files:
        framing = rng.choice(("lines", "length"))
        parts = list(valid[framing])
        if rng.random() < 0.3:
            text = json_text(changed_table(rng, rng.choice(messages)))
            ends = (b"", b"\n") if framing == "lines" else (struct.pack(">I", len(text)), b"")
            parts.insert(rng.randrange(4), ends[0] + text + ends[1])
            return {framing: b"".join(parts)}
        return {framing: changed(rng, b"".join(parts), parts)}

    def read(at: Path) -> None:
        (path,) = at.iterdir()
        framing, data = path.name, path.read_bytes()
        splitter = MessageSplitter(framing)
        step = max(len(data) // 3, 1)
        for first in range(0, len(data), step):
            splitter.feed(data[first : first + step])

    return Reader(make=make, read=read)


POSITIONS = (
    b"u,v,colour,height_mm\n1.0,2.0,blue,3.0\n4.0,5.0,green,2.5\n",
    b"x_mm,y_mm,z_mm\n1,2,3\n# a\n4,5,6\n",
)
BODIES = (
    (
        b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        b"endloop\nendfacet\nendsolid a\n"
    ),
    b"\0" * 80 + struct.pack("<I", 2) + struct.pack("<12fH", *range(12), 0) * 2,
)
STRETCHED = (b"stretch,stress_MPa\n1.1,0.2\n1.2,0.3\n1.3,0.35\n",)


def _positions() -> Reader:
    from phytac_design.design.positions import read_positions

    make = texts("x.csv", POSITIONS)
    return Reader(make=make, read=lambda at: read_positions(at / "x.csv"))


def _body() -> Reader:
    from phytac_design.design.fixture_table import read_stl

    make = texts("x.stl", BODIES)
    return Reader(make=make, read=lambda at: read_stl(at / "x.stl"))


def _tensile() -> Reader:
    from phytac_design.mechanics.switch.material_fit import read_test

    make = texts("x.csv", STRETCHED)
    return Reader(make=make, read=lambda at: read_test(at / "x.csv"))


def _lens() -> Reader:
    from phytac_decoder.camera.lens import Pinhole
    from phytac_design.design.camera_files import FileFormat, read_lens, write_lens

    lens = Pinhole(width_px=640, height_px=480, fx_px=240, fy_px=240, cx_px=319, cy_px=239)
    kinds: tuple[FileFormat, ...] = ("opencv", "ros", "kalibr")

    def seed(kind: FileFormat) -> bytes:
        (data,) = _folder_of(lambda at: write_lens(lens, at / "x.yaml", kind)).values()
        return data

    seeds = [seed(kind) for kind in kinds]
    make = texts("x.yaml", seeds)
    return Reader(make=make, read=lambda at: read_lens(at / "x.yaml"))


def _regions() -> Reader:
    import numpy as np

    from phytac_decoder.estimation.force_regions import load_regions

    place = np.random.default_rng(0).normal(size=(20, 3))
    seed = (
        b'[[regions]]\nname = "a"\nmarkers = [0, 1]\n[[regions]]\nname = "b"\n'
        b"point_mm = [0, 0, 0]\nradius_mm = 9\n"
    )
    make = _toml("x.toml", [seed])
    return Reader(make=make, read=lambda at: load_regions(at / "x.toml", place))


def _logs() -> Reader:
    from phytac_design.simulation.rig_import.rig_log import RowProblems, read_rig_log

    bench = (
        b"# step 17, frame 203, 41.250 s\ncontact_marker,patch_radius_mm,force_N,displacement_mm\n"
        b"# step 17, frame 203, 41.250 s\n16,4,0.52,0.0171\n"
    )
    rig = (ROOT / "examples" / "rig" / "log.csv").read_bytes()[:600].rpartition(b"\n")[0]
    make = texts("x.csv", [bench, rig])

    return Reader(make=make, read=lambda at: read_rig_log(at / "x.csv", RowProblems(where="x.csv")))


READERS: dict[str, Callable[[], Reader]] = {
    "design": _design,
    "study": _study,
    "scene": _scene,
    "scenario": _scenario,
    "dataset": _dataset,
    "bundle": _bundle,
    "calibration": _calibration,
    "stream": _stream,
    "positions": _positions,
    "body": _body,
    "lens": _lens,
    "regions": _regions,
    "logs": _logs,
    "tensile test": _tensile,
}
"""By name; created on demand."""
