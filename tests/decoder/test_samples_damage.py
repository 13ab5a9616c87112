"""Whatever happens to a data set's files: refused, or the very same numbers."""

import io
import json
import zipfile
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.datasets.samples import Samples
from phytac_design.datasets.samples_file import read_samples, table_hash, write_samples
from phytac_shapes.errors import InputError
from tests.decoder.drawn_samples import META, assert_same, drawn
from tests.refusals import refused


def refused_or_same(folder: Path, made: Samples) -> bool:
    """Whether a data set is refused; if it is not, its numbers must be right."""
    try:
        got, meta = read_samples(folder)
    except InputError as error:
        return "\n" not in str(error) and str(folder) in str(error)
    assert_same(got, made, exact=True)
    assert meta == META
    return False


def sign(folder: Path, **changes: Any) -> None:
    """Change ``dataset.json``, and make its checksums fit: somebody did it on purpose."""
    path = folder / "dataset.json"
    table = json.loads(path.read_text())
    table |= changes
    data = (folder / "samples.npz").read_bytes()
    table["file"] |= {"bytes": len(data), "sha256": sha256(data).hexdigest()}
    table["checksum"] = table_hash(table)
    path.write_text(json.dumps(table))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Samples]:
    folder = tmp_path_factory.mktemp("whole")
    write_samples(folder, drawn(11), META)
    return folder, read_samples(folder)[0]


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Samples]:
    """Large enough that some of its arrays are packed with LZMA."""
    folder = tmp_path_factory.mktemp("large")
    write_samples(folder, drawn(11, 140, 10), META)
    with zipfile.ZipFile(folder / "samples.npz") as file:
        assert {info.compress_type for info in file.infolist()} == {8, 14}
    return folder, read_samples(folder)[0]


def test_damaged_files_are_rejected(large: tuple[Path, Samples], tmp_path: Path) -> None:
    folder, made = large
    files = {name: (folder / name).read_bytes() for name in ("samples.npz", "dataset.json")}
    for name, data in files.items():
        for other, same in files.items():
            (tmp_path / other).write_bytes(same)
        rng = np.random.default_rng(0)
        refused = 0
        for offset in rng.choice(len(data), 120, replace=False):
            broken = bytearray(data)
            broken[offset] ^= 1 << int(rng.integers(8))
            (tmp_path / name).write_bytes(broken)
            refused += refused_or_same(tmp_path, made)
        for length in np.linspace(0, len(data) - 1, 20).astype(int):
            (tmp_path / name).write_bytes(data[:length])
            # A text's last line end says nothing.
            assert refused_or_same(tmp_path, made) or (
                name == "dataset.json" and length == len(data) - 1
            )
        assert refused == 120 if name == "samples.npz" else refused > 90


def test_damaged_arrays_with_right_hashes_are_rejected(
    large: tuple[Path, Samples], tmp_path: Path
) -> None:
    """The zip's own checks hold alone: only fields that say nothing of the data may change."""
    folder, made = large
    data = (folder / "samples.npz").read_bytes()
    (tmp_path / "dataset.json").write_bytes((folder / "dataset.json").read_bytes())
    rng = np.random.default_rng(1)
    refused = 0
    for offset in rng.choice(len(data), 150, replace=False):
        broken = bytearray(data)
        broken[offset] ^= 1 << int(rng.integers(8))
        (tmp_path / "samples.npz").write_bytes(broken)
        sign(tmp_path)
        refused += refused_or_same(tmp_path, made)
    assert refused > 120
    for length in np.linspace(0, len(data) - 1, 20).astype(int):
        (tmp_path / "samples.npz").write_bytes(data[:length])
        sign(tmp_path)
        assert refused_or_same(tmp_path, made)


def packed(arrays: dict[str, Any], *, pickles: bool = False, more: bytes = b"") -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, array in arrays.items():
            part = io.BytesIO()
            np.lib.format.write_array(part, np.asarray(array), (1, 0), allow_pickle=pickles)
            file.writestr(f"{name}.npy", part.getvalue() + more)
    return out.getvalue()


BAD: dict[str, tuple[str, Any, str]] = {
    "dtype": ("light", lambda a: a.astype(np.float32), "data-set-unreadable"),
    "swapped": ("time_s", lambda a: a.astype(">f8"), "data-set-unreadable"),
    "shape": ("time_s", lambda a: a[:-1], "data-set-unreadable"),
    "columns": ("touch_uv", np.asfortranarray, "data-set-unreadable"),
    "pickle": ("light", lambda a: a.astype(object), "data-set-unreadable"),
    "not finite": ("touch_force_N", lambda a: a * np.nan, "samples-not-finite"),
    "negative": ("touch_force_N", lambda a: -a - 1, "samples-value-range"),
    "id": ("truth_marker", lambda a: a + 9, "samples-id-unknown"),
    "sample id": ("touch_sample", lambda a: a + 7, "samples-id-unknown"),
    "reason id": ("reason_index", lambda a: a + 2, "samples-id-unknown"),
    "touch id": ("truth_touch", lambda a: a + 90, "samples-id-unknown"),
    "other's touch": ("truth_touch", lambda a: a * 0 + a.max(), "samples-ids-inconsistent"),
    "status": ("status", lambda a: a + 2, "samples-value-range"),
    "silent": ("status", lambda a: a * 0 + 1, "samples-status-inconsistent"),
    "loud": ("status", lambda a: a * 0, "samples-status-inconsistent"),
    "order": ("touch_sample", lambda a: a[::-1].copy(), "samples-not-ordered"),
    "double": ("truth_marker", lambda a: a * 0, "samples-not-ordered"),
    "count": ("contacts", lambda a: a + 1, "samples-counts-differ"),
    "half": (
        "shift_px",
        lambda a: np.where(np.arange(2) == 1, np.int16(-(2**15)), a),
        "samples-shift-incomplete",
    ),
    "bool": ("bits", lambda a: (a + np.uint8(2)).view(np.bool_), "data-set-unreadable"),
    "missing": ("light", lambda _: None, "data-set-unreadable"),
}


@pytest.mark.parametrize("case", BAD)
def test_wrong_arrays_are_rejected(whole: tuple[Path, Samples], tmp_path: Path, case: str) -> None:
    name, change, code = BAD[case]
    arrays = dict(np.load(whole[0] / "samples.npz"))
    changed = change(arrays[name])
    arrays = {key: value for key, value in (arrays | {name: changed}).items() if value is not None}
    (tmp_path / "dataset.json").write_bytes((whole[0] / "dataset.json").read_bytes())
    (tmp_path / "samples.npz").write_bytes(packed(arrays, pickles=case == "pickle"))
    sign(tmp_path)
    with refused(code):
        read_samples(tmp_path)


TABLES: dict[str, tuple[dict[str, Any], str]] = {
    "foreign": ({"format": "coco"}, "data-set-unknown-format"),
    "newer": ({"schema_version": "1.1"}, "data-set-schema-version"),
    "other": ({"schema_version": "2.0"}, "data-set-schema-version"),
    "no version": ({"schema_version": None}, "data-set-schema-version"),
    "counts": ({"counts": {"samples": -1}}, "data-set-table-invalid"),
    "huge": (
        {"counts": dict.fromkeys(
            ("samples", "markers", "contacts", "truth", "key_nodes", "remarks"), 2**31 - 1
        )},
        "data-set-too-large",
    ),
    "words": ({"statuses": ["failed", "ok", "flagged"]}, "data-set-table-invalid"),
    "parts": ({"parts": ["samples", "fields"]}, "data-set-table-invalid"),
    "meta": ({"what": 7}, "data-set-table-invalid"),
    "simulated": ({"simulated": "no"}, "data-set-table-invalid"),
    "frame": ({"frames": {"../../secret.png": "ab"}}, "samples-picture-name"),
    "arrays": ({"arrays": {}}, "data-set-table-invalid"),
    "reasons": ({"reasons": "abc"}, "data-set-table-invalid"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_wrong_tables_are_rejected(whole: tuple[Path, Samples], tmp_path: Path, case: str) -> None:
    for name in ("samples.npz", "dataset.json"):
        (tmp_path / name).write_bytes((whole[0] / name).read_bytes())
    changes, code = TABLES[case]
    sign(tmp_path, **changes)
    with refused(code):
        read_samples(tmp_path)


def test_a_zip_bomb_is_not_unpacked(whole: tuple[Path, Samples], tmp_path: Path) -> None:
    """A small file that says it holds a gigabyte is refused by its size, before any memory."""
    (tmp_path / "dataset.json").write_bytes((whole[0] / "dataset.json").read_bytes())
    arrays = dict(np.load(whole[0] / "samples.npz"))
    arrays["light"] = np.zeros(2**21)
    (tmp_path / "samples.npz").write_bytes(packed(arrays))
    sign(tmp_path)
    with refused("data-set-unreadable"):
        read_samples(tmp_path, bytes_max=2**20)
    with refused("data-set-unreadable") as caught:
        read_samples(tmp_path)
    caught.match(r"light\.npy")


def test_arrays_longer_than_they_say(whole: tuple[Path, Samples], tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_bytes((whole[0] / "dataset.json").read_bytes())
    arrays = dict(np.load(whole[0] / "samples.npz"))
    (tmp_path / "samples.npz").write_bytes(packed(arrays, more=b"1"))
    sign(tmp_path)
    with refused("data-set-unreadable") as caught:
        read_samples(tmp_path)
    caught.match(r"time_s\.npy")


def test_what_is_not_a_data_set(tmp_path: Path) -> None:
    with refused("data-set-not-found"):
        read_samples(tmp_path / "nowhere")
    (tmp_path / "dataset.json").write_text("[" * 100_000)
    with refused("data-set-table-invalid"):
        read_samples(tmp_path)
    (tmp_path / "dataset.json").write_bytes(b"\xff\xfe")
    with refused("data-set-table-invalid"):
        read_samples(tmp_path)
    (tmp_path / "dataset.json").write_text("[1, 2]")
    with refused("data-set-unknown-format"):
        read_samples(tmp_path)
    with refused("output-foreign"):
        write_samples(tmp_path, drawn(0), META)
    assert (tmp_path / "dataset.json").read_text() == "[1, 2]"


def test_missing_arrays_file(whole: tuple[Path, Samples], tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_bytes((whole[0] / "dataset.json").read_bytes())
    with refused("data-set-unreadable"):
        read_samples(tmp_path)


def test_another_design_is_rejected(whole: tuple[Path, Samples]) -> None:
    with refused("data-set-other-design"):
        read_samples(whole[0], expect_design_hash="12" * 32)


def test_a_refusal_quotes_no_more_of_a_file_than_one_can_read(
    whole: tuple[Path, Samples], tmp_path: Path
) -> None:
    for name in ("dataset.json", "samples.npz"):
        (tmp_path / name).write_bytes((whole[0] / name).read_bytes())
    sign(tmp_path, theories=["rest"] * 50_000)
    with refused("data-set-table-invalid") as caught:
        read_samples(tmp_path)
    assert len(str(caught.value)) < 3000
