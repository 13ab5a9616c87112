"""Named regions: files that say where they are, and what they say of a mistake."""

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from phytac_decoder.estimation.force_regions import (
    NAME_MAX,
    REGIONS_MAX,
    MarkerChart,
    Region,
    RegionForces,
    load_regions,
)
from phytac_decoder.io.bundle import SCHEMA, load_bundle, save_bundle
from phytac_design.cli.serve_command import named_regions
from phytac_design.design.design_file import design_hash, parse_design, to_toml
from phytac_design.layout import make_markers
from phytac_design.layout.region_chart import chart_of_design, design_regions
from phytac_design.rules.check import check_design
from tests.decoder.toy_sensor import toy_bundle
from tests.designs import changed, small
from tests.refusals import refused

ROW, COLUMN = np.divmod(np.arange(24), 6)
PLACES = np.column_stack([10.0 * COLUMN, 10.0 * ROW, np.zeros(24)])
CHART = MarkerChart(
    row=ROW, column=COLUMN, along=(ROW + 0.5) / 4.0, around=COLUMN / 6.0, closed=True
)


def load(folder: Path, text: str, chart: MarkerChart | None = CHART) -> tuple[Region, ...]:
    path = folder / "regions.toml"
    path.write_text(text)
    return load_regions(path, PLACES, chart)


def markers(folder: Path, place: str) -> list[int]:
    (region,) = load(folder, f'[[regions]]\nname = "thumb"\n{place}\n')
    return list(region.markers)


def test_every_selector(tmp_path: Path) -> None:
    assert markers(tmp_path, "markers = [3, 1, 3]") == [1, 3]
    assert markers(tmp_path, "rows = [1, 1]") == list(range(6, 12))
    assert markers(tmp_path, "columns = [0, 1]") == [0, 1, 6, 7, 12, 13, 18, 19]
    assert markers(tmp_path, "along = [0.0, 0.2]") == list(range(6))
    assert markers(tmp_path, "along = [0.3, 0.7]\naround = [0.3, 0.55]") == [8, 9, 14, 15]
    # Over the seam.
    assert markers(tmp_path, "rows = [0, 0]\naround = [0.8, 0.2]") == [0, 1, 5]
    assert markers(tmp_path, "point_mm = [20, 10.0, 3]\nradius_mm = 10.5") == [2, 7, 8, 9, 14]
    # All conditions must hold.
    assert markers(tmp_path, "point_mm = [20, 10, 3]\nradius_mm = 10.5\nrows = [1, 1]") == [7, 8, 9]


def test_tables_of_one_name_are_one_region(tmp_path: Path) -> None:
    text = "".join(f'[[regions]]\nname = "{n}"\nmarkers = [{m}]\n' for n, m in ("a4", "b2", "a1"))
    assert load(tmp_path, text) == (
        Region(name="a", markers=(1, 4)),
        Region(name="b", markers=(2,)),
    )


def test_json_is_equivalent(tmp_path: Path) -> None:
    path = tmp_path / "regions.json"
    path.write_text(json.dumps({"regions": [{"name": "палец 1", "rows": [0, 0]}]}))
    assert load_regions(path, PLACES, CHART) == (Region(name="палец 1", markers=tuple(range(6))),)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "regions-file-invalid"),
        ("regions = []", "regions-file-invalid"),
        ("regions = 3", "regions-file-invalid"),
        ("regions = [3]", "region-not-table"),
        ("colour = 3", "regions-file-invalid"),
        ("[[regions", "file-syntax"),
        ("[[regions]]\nrows = [0, 1]", "region-name-invalid"),
        ('[[regions]]\nname = ""\nrows = [0, 1]', "region-name-invalid"),
        (f'[[regions]]\nname = "{"x" * (NAME_MAX + 1)}"\nrows = [0, 1]', "region-name-invalid"),
        ('[[regions]]\nname = "a\\nb"\nrows = [0, 1]', "region-name-invalid"),
        ('[[regions]]\nname = " a"\nrows = [0, 1]', "region-name-invalid"),
        ('[[regions]]\nname = "a"', "region-without-condition"),
        ('[[regions]]\nname = "a"\nrow = [0, 1]', "region-unknown-key"),
        ('[[regions]]\nname = "a"\nrows = 3', "region-number-invalid"),
        ('[[regions]]\nname = "a"\nrows = [0, true]', "region-number-invalid"),
        ('[[regions]]\nname = "a"\nrows = [2, 1]', "region-range-invalid"),
        ('[[regions]]\nname = "a"\nrows = [0.5, 1]', "region-range-invalid"),
        ('[[regions]]\nname = "a"\nrows = [7, 9]', "region-empty"),
        ('[[regions]]\nname = "a"\nalong = [0.5, 0.1]', "region-share-invalid"),
        ('[[regions]]\nname = "a"\nalong = [0, nan]', "region-number-invalid"),
        ('[[regions]]\nname = "a"\naround = [0, 1.5]', "region-share-invalid"),
        ('[[regions]]\nname = "a"\nmarkers = []', "region-markers-invalid"),
        ('[[regions]]\nname = "a"\nmarkers = [24]', "region-markers-invalid"),
        ('[[regions]]\nname = "a"\nmarkers = [-1]', "region-markers-invalid"),
        ('[[regions]]\nname = "a"\nmarkers = [true]', "region-markers-invalid"),
        ('[[regions]]\nname = "a"\npoint_mm = [0, 0, 0]', "region-point-incomplete"),
        ('[[regions]]\nname = "a"\nradius_mm = 3', "region-without-condition"),
        ('[[regions]]\nname = "a"\npoint_mm = [0, 0]\nradius_mm = 3', "region-number-invalid"),
        (
            '[[regions]]\nname = "a"\npoint_mm = [0, 0, 0]\nradius_mm = -3',
            "region-radius-not-positive",
        ),
        ('[[regions]]\nname = "a"\npoint_mm = [0, 0, 0]\nradius_mm = inf', "region-number-invalid"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, code: str) -> None:
    with refused(code):
        load(tmp_path, text)


def test_rows_and_shares_need_the_design(tmp_path: Path) -> None:
    text = '[[regions]]\nname = "a"\nmarkers = [3]\n[[regions]]\nname = "b"\nalong = [0, 1]\n'
    with refused("region-needs-design"):
        load(tmp_path, text, chart=None)


def test_files_that_are_none(tmp_path: Path) -> None:
    with refused("file-unreadable"):
        load_regions(tmp_path / "none.toml", PLACES)
    for name, data, code in (
        ("a.json", b"[1]", "regions-file-invalid"),
        ("b.json", b"[" * 100000, "file-syntax"),
        (
            "c.json",
            b'{"regions": [{"name": "a", "rows": [0, 1' + b"0" * 400 + b"]}]}",
            "region-number-invalid",
        ),
        ("d.toml", b"\xff\xfe\x00", "file-unreadable"),
    ):
        (tmp_path / name).write_bytes(data)
        with refused(code):
            load_regions(tmp_path / name, PLACES, CHART)
    many = [{"name": f"r{k}", "markers": [0]} for k in range(REGIONS_MAX + 1)]
    (tmp_path / "many.json").write_text(json.dumps({"regions": many}))
    with refused("regions-too-many"):
        load_regions(tmp_path / "many.json", PLACES)


def test_forces_add_up_and_a_contact_is_where_most_of_it_is() -> None:
    regions = (Region(name="a", markers=(1, 2)), Region(name="b", markers=(2, 3)))
    sums = RegionForces(regions=regions, markers=24)
    assert sums.of(np.array([1, 2, 9]), np.array([1.0, 2.0, 4.0])) == [3.0, 2.0]
    assert sums.of(np.zeros(0, dtype=np.int64), np.zeros(0)) == [0.0, 0.0]
    assert sums.home((1, 3), [1.0, 2.0]) == "b"
    assert sums.home((2,), [1.0]) == "a"
    assert sums.home((1, 3), [-1.0, 0.0]) == "a"
    assert sums.home((2, 3), [0.0, -1.0]) == "b"
    assert sums.home((9,), [1.0]) == ""


NAMED = (Region(name="thumb", markers=(3, 7)), Region(name="palm", markers=(7, 8, 29)))


def test_a_bundle_carries_regions_and_a_file_replaces_them(tmp_path: Path) -> None:
    folder = tmp_path / "decoder"
    save_bundle(replace(toy_bundle(), regions=NAMED), folder)
    bundle = load_bundle(folder)
    assert bundle.regions == NAMED
    assert named_regions(None, bundle, folder, None) == NAMED
    path = tmp_path / "regions.toml"
    path.write_text('[[regions]]\nname = "tip"\nmarkers = [5]\n')
    assert named_regions(path, bundle, folder, None) == (Region(name="tip", markers=(5,)),)


def _older(meta: dict[str, Any]) -> None:
    meta["schema_version"] = "1.4"
    del meta["regions"]


def test_older_bundles_have_none_and_newer_ones_are_rejected(tmp_path: Path) -> None:
    save_bundle(replace(toy_bundle(), regions=NAMED), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    assert meta["schema_version"] == f"{SCHEMA[0]}.{SCHEMA[1]}"
    assert SCHEMA >= (1, 5)
    _older(meta)
    path.write_text(json.dumps(meta))
    assert load_bundle(tmp_path).regions == ()
    path.write_text(json.dumps(meta | {"schema_version": f"{SCHEMA[0]}.{SCHEMA[1] + 1}"}))
    with refused("bundle-schema-version"):
        load_bundle(tmp_path)


@pytest.mark.parametrize(
    ("corrupt", "message"),
    [
        (lambda found: found[0].update(markers=[30]), r"a list of markers, 0 to 29 \(got \[30\]"),
        (lambda found: found[0].update(markers=[]), "a list of markers"),
        (lambda found: found[1].update(name=""), "name must be 1 to 40 printable letters"),
        (lambda found: found[1].update(rows=[0, 1]), "a list of names with markers"),
        (lambda found: found[1].pop("name"), "a list of names with markers"),
        (lambda found: found.append(3), "a list of names with markers"),
    ],
)
def test_malformed_regions_of_a_bundle_are_rejected(
    tmp_path: Path, corrupt: Callable[[list[Any]], None], message: str
) -> None:
    save_bundle(replace(toy_bundle(), regions=NAMED), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    corrupt(meta["regions"])
    path.write_text(json.dumps(meta))
    with refused("bundle-invalid") as caught:
        load_bundle(tmp_path)
    caught.match(f"is not a decoder bundle: .*{message}")


TABLES: list[dict[str, Any]] = [
    {"name": "thumb", "along": [0.5, 1.0], "around": [0.9, 0.1]},
    {"name": "palm", "rows": [0, 1], "columns": [3, 5]},
    {"name": "palm", "markers": [100]},
    {"name": "spot", "point_mm": [30.0, 0.0, 30.0], "radius_mm": 9.0},
]


def test_a_design_names_regions_as_a_file_does(tmp_path: Path) -> None:
    design = small(regions=TABLES)
    found = design_regions(design)
    assert [region.name for region in found] == ["thumb", "palm", "spot"]
    path = tmp_path / "regions.json"
    path.write_text(json.dumps({"regions": TABLES}))
    surface = design.surface()
    position_mm = surface.point(make_markers(design, surface).uv)
    assert found == load_regions(path, position_mm, chart_of_design(design))
    assert {3 + 14, 100} <= set(found[1].markers)
    # The resolved file names the same ones, and the sensor is the same with or without.
    again = parse_design(tomllib.loads(to_toml(design)), "again")
    assert again == design
    assert design_hash(design) == design_hash(small())
    assert design_regions(small()) == ()


def test_heights_by_line_of_sight_do_not_matter_to_regions() -> None:
    names = [{"name": "a", "rows": [2, 3]}]
    with mock.patch("phytac_design.layout.marker_layout.sight_heights_mm") as dear:
        dense = changed("cylinder60-dense", regions=names)
        (region,) = design_regions(dense)
    assert not dear.called
    columns = dense.layout.columns
    assert region.markers == tuple(range(2 * columns, 4 * columns))


@pytest.mark.parametrize(
    ("table", "code"),
    [
        ({"name": "a", "rows": [40, 50]}, "region-empty"),
        ({"name": "a"}, "region-without-condition"),
        ({"name": "a", "row": [1, 2]}, "field-invalid"),
        ({"name": "a", "along": [0.5, 0.1]}, "region-share-invalid"),
        ({"name": "a", "along": [0.5]}, "region-number-invalid"),
        ({"name": "a", "along": [0.0, 1.5]}, "field-invalid"),
        ({"name": "a", "radius_mm": 3.0}, "field-invalid"),
        ({"name": "a", "markers": [1.5]}, "field-invalid"),
        ({"name": "a", "markers": [999]}, "region-markers-invalid"),
        ({"rows": [0, 1]}, "field-invalid"),
        ({"name": "a ", "rows": [0, 1]}, "region-name-invalid"),
        ({"name": "", "rows": [0, 1]}, "field-invalid"),
    ],
)
def test_regions_of_a_design_that_cannot_be_are_rejected(table: dict[str, Any], code: str) -> None:
    with refused(code):
        check_design(small(regions=[table]))
