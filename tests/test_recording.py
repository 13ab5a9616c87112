"""Recordings as Parquet: the same numbers, with types."""

import contextlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.csv_recording import COLUMNS, Recorder, RegionRecorder
from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.cli.serve_command import open_recorders
from phytac_design.core.parquet_recording import to_parquet
from tests.decoder.toy_sensor import toy_bundle
from tests.refusals import refused
from tests.test_cli import phytac

parquet = pytest.importorskip("pyarrow.parquet")


def recorded(folder: Path) -> tuple[Path, Path]:
    """Recordings of three frames: two contacts, a black one, none."""
    contacts, sums = folder / "out.csv", folder / "regions.csv"
    regions = (Region(name="thumb", markers=(7, 8)),)
    make = MessageBuilder(bundle=toy_bundle(), estimator="fem", regions=regions)
    forces = np.zeros(30)
    forces[[7, 14, 28]] = (3.0, 1.0, 0.5)
    readings = (
        Reading(koi=np.array([7, 14, 28]), forces_N=forces),
        Reading.none("it is black"),
        Reading(koi=np.zeros(0, dtype=np.int64), forces_N=forces),
    )
    with Recorder(contacts) as rows, RegionRecorder(sums, ["thumb"]) as each:
        for number, reading in enumerate(readings):
            message = make.frame(reading, sequence=number, timestamp_s=0.25 * number)
            rows.add(message)
            each.add(message)
    return contacts, sums


def test_contacts_and_regions_come_back_with_their_types(tmp_path: Path) -> None:
    contacts, sums = recorded(tmp_path)
    assert to_parquet(contacts, tmp_path / "out.parquet") == (4, len(COLUMNS))
    table = parquet.read_table(tmp_path / "out.parquet")
    assert tuple(table.column_names) == COLUMNS
    vectors = [name for name in COLUMNS if name.startswith(("normal", "net_", "moment_"))]
    assert len(vectors) == 18
    # Without `auto` some are empty in every row.
    assert {str(table.schema.field(name).type) for name in vectors} == {"double"}
    first, second, black, none = table.to_pylist()
    assert [first[f"net_moment_{axis}_Nmm"] for axis in "xyz"] == [-70.0, 70.0, 0.0]
    assert (first["net_force_sd_x_N"], none["normal_x"], none["net_force_z_N"]) == (None, None, 0.0)
    assert (first["markers"], first["force_N"], first["id"]) == ([7, 14], 4.0, 0)
    assert (first["valid"], first["region"], first["sequence"]) == (True, "thumb", 0)
    assert (second["markers"], second["region"]) == ([28], None)
    assert (black["valid"], black["contacts"], black["markers"]) == (False, 0, None)
    assert (none["valid"], none["timestamp_s"], none["force_N"]) == (True, 0.5, None)
    to_parquet(sums, tmp_path / "regions.parquet")
    rows = parquet.read_table(tmp_path / "regions.parquet").to_pylist()
    assert [row["region_thumb_N"] for row in rows] == [3.0, 0.0, 0.0]


def test_invalid_recordings_are_rejected(tmp_path: Path) -> None:
    for text, message in (
        ("", "is no recording"),
        ("a,b\n1,2\n", "no columns sequence, timestamp_s and valid"),
        ("sequence,timestamp_s,valid\nx,0.1,1\n", "is no recording"),
        ("sequence,timestamp_s,valid,markers\n1,0.1,1,7 x\n", "is no recording: markers"),
    ):
        (tmp_path / "bad.csv").write_text(text)
        with refused("recording-invalid") as caught:
            to_parquet(tmp_path / "bad.csv", tmp_path / "out.parquet")
        caught.match(message)
    with refused("file-unreadable"):
        to_parquet(tmp_path / "none.csv", tmp_path / "out.parquet")
    assert not list(tmp_path.glob("out.parquet*"))


def test_a_truncated_last_row_is_left_out_and_reported(tmp_path: Path) -> None:
    contacts, _ = recorded(tmp_path)
    contacts.write_bytes(contacts.read_bytes()[:-8])
    target = tmp_path / "out.parquet"
    made = phytac("convert", str(contacts), str(target))
    assert (made.returncode, made.stdout) == (0, f"{target}: 3 rows, {len(COLUMNS)} columns\n")
    assert f"{contacts}: the last row does not end; it is left out" in made.stderr


def test_the_command_reports_its_output_and_overwrites_nothing(tmp_path: Path) -> None:
    contacts, _ = recorded(tmp_path)
    target = tmp_path / "out.parquet"
    made = phytac("convert", str(contacts), str(target))
    assert (made.returncode, made.stdout) == (0, f"{target}: 4 rows, {len(COLUMNS)} columns\n")
    with refused("output-exists") as caught:
        to_parquet(contacts, target)
    caught.match("--force")
    assert to_parquet(contacts, target, force=True)[0] == 4
    rows = contacts.read_bytes()
    with refused("file-ending") as other:
        to_parquet(contacts, contacts, force=True)
    other.match("end its name in .parquet")
    assert contacts.read_bytes() == rows


def test_csv_is_not_written_under_another_formats_name(tmp_path: Path) -> None:
    for name in ("press.parquet", "press.JSONL", "press.db3"):
        with contextlib.ExitStack() as stack, refused("output-kind-unknown"):
            open_recorders(stack, tmp_path / name, None, SimpleNamespace(regions=()))
    assert not list(tmp_path.iterdir())
