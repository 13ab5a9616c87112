"""Design files: what is read, what is refused, and that the resolved file is the same design."""

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from phytac_design.design.base_table import descriptions
from phytac_design.design.design_file import (
    assumptions,
    design_hash,
    load_design,
    parse_design,
    shipped_designs,
    to_toml,
    write_new_design,
)
from phytac_design.design.spec import Design, WallSection
from tests.designs import small
from tests.refusals import refused

MINIMAL = {"name": "a", "shape": {"kind": "cylinder", "diameter_outer_mm": 60, "length_mm": 120}}


@pytest.mark.parametrize(
    ("table", "change", "field"),
    [
        ("print_rules", {"process": "fdm"}, "hole_min_mm"),
        ("hardware", {"board": "raspberry-pi-v2"}, "board_size_mm"),
    ],
)
def test_presets_that_written_numbers_would_undo_are_refused(
    table: str, change: dict, field: str
) -> None:
    written = small().model_dump(mode="json")
    with refused("field-invalid") as caught:
        parse_design({**written, table: {**written[table], **change}}, "new")
    caught.match(f"{field}.* are written out as those of")
    made = parse_design({**MINIMAL, table: change}, "made")
    again = parse_design(made.model_dump(mode="json"), "again")
    assert getattr(again, table) == getattr(made, table)
    own = {**getattr(made, table).model_dump(mode="json"), "wall_mm": 4.0}
    if table == "hardware":
        assert parse_design({**written, table: own}, "own").hardware.wall_mm == 4.0


@pytest.mark.parametrize("name", shipped_designs())
def test_resolved_design_is_the_same_design(name: str) -> None:
    design = load_design(name)
    again = parse_design(tomllib.loads(to_toml(design)), "resolved")
    assert again == design
    assert design_hash(again) == design_hash(design)
    assert to_toml(again) == to_toml(design)


def test_every_field_is_documented() -> None:
    schema = Design.model_json_schema()
    for name, model in [("Design", schema), *schema["$defs"].items()]:
        for key, info in model["properties"].items():
            described = "description" in info or "$ref" in info or "allOf" in info
            assert described, f"{name}.{key}"


def test_without_sources_design_files_are_written_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none(_: object) -> str:
        raise OSError("could not get source code")

    assert "thickness_mm" in descriptions.__wrapped__(WallSection)
    monkeypatch.setattr("phytac_design.design.base_table.inspect.getsource", none)
    assert descriptions.__wrapped__(WallSection) == {}


def test_assumptions_are_what_the_paper_does_not_state() -> None:
    named = assumptions(load_design("cylinder60"))
    assert named["camera.focal_px"] == 970.0
    assert named["receptor.band_marker_mm"] == 1.0
    assert named["material.modulus_MPa"] == 2200.0
    assert "wall.thickness_mm" not in named
    assert "layout.spiral_angle_deg" not in named


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"layuot": {}}, "unknown key 'layuot'; did you mean 'layout'"),
        (
            {"wall": {"thicknes_mm": 1}},
            "unknown key 'wall.thicknes_mm'; did you mean 'thickness_mm'",
        ),
        (
            {"wall": {"thickness_mm": -1}},
            r"wall.thickness_mm: input should be greater than 0 \(got -1\)",
        ),
        ({"wall": {"thickness_mm": "thick"}}, "wall.thickness_mm: input should be a valid number"),
        (
            {"wall": {"thickness_mm": "1.5 mm"}},
            r"wall.thickness_mm: write 1.5, without unit or quotes \(got '1.5 mm'\)",
        ),
        ({"layout": {"rows": "12 rows"}}, "layout.rows: write 12, without unit or quotes"),
        (
            {"wall": {"thickness_mm": float("nan")}},
            "wall.thickness_mm: input should be a finite number",
        ),
        ({"camera": {"width_px": 10**9}}, "camera.width_px: input should be less than or equal"),
        ({"shape": {"kind": "sphere"}}, "shape.kind"),
        ({"shape": {"kind": "cylinder", "length_mm": 1}}, "shape.diameter_outer_mm is missing"),
        ({"wall": {"rows": 8}}, r"unknown key 'wall.rows'; it belongs to \[layout\]"),
        (
            {"shape": {**MINIMAL["shape"], "rows": 8}},
            r"unknown key 'shape.rows'; it belongs to \[layout\]",
        ),
        ({"rows": 8}, r"unknown key 'rows'; it belongs to \[layout\]"),
        (
            {"layout": {"diameter_outer_mm": 5.0}},
            r"'layout.diameter_outer_mm'; it belongs to \[shape\] or \[receptor\]",
        ),
        # A field of another kind of shape, though [receptor] has one of this name too.
        ({"shape": {**MINIMAL["shape"], "tilt_deg": 8}}, r"unknown key 'shape.tilt_deg' \(known:"),
        ({"wall": {"thickness_mm": True}}, "thickness_mm must be a number or a text, not true"),
        ({"name": "../x"}, "name: string should match pattern"),
        ({"training": {"force_min_N": 9, "force_max_N": 2}}, "force_max_N must exceed force_min_N"),
    ],
)
def test_bad_values_are_explained(change: dict, message: str) -> None:
    with refused("field-invalid") as caught:
        parse_design({**MINIMAL, **change}, "bad.toml")
    caught.match(message)


def test_files_that_are_not_designs(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text("name = [unclosed")
    with refused("toml-syntax"):
        load_design(str(path))
    path.write_text('name = "x"\n[camera]\nstand_off_mm = fit\n')
    with refused("toml-syntax") as unquoted:
        load_design(str(path))
    unquoted.match("'stand_off_mm = fit'")
    path.write_bytes(b"\xff\xfe\x00binary")
    with refused("toml-syntax"):
        load_design(str(path))
    path.write_text('name = "s"\ndesign = "cylinder60"\n[[variable]]\nfield = "layout.rows"\n')
    with refused("field-invalid") as other:
        load_design(str(path))
    other.match("is a study, not a design")
    with refused("toml-file-not-found") as caught:
        load_design("cylinder6")
    caught.match("did you mean 'cylinder60'")


def test_new_design_is_commented_and_never_overwrites(tmp_path: Path) -> None:
    path = write_new_design("mine", "cylinder60", tmp_path / "mine.toml")
    assert "# Wall thickness, inward from the outer face." in path.read_text()
    assert "(assumed)" in path.read_text()
    assert load_design(str(path)).name == "mine"
    with refused("output-exists"):
        write_new_design("mine", "cylinder60", path)


def test_explicit_positions_survive_the_resolved_file() -> None:
    layout = {
        "kind": "explicit",
        "positions": [[10, 1.5], [20, 3]],
        "position_heights_mm": [2, 3],
        "position_colours": ["green", "blue"],
    }
    design = parse_design({**MINIMAL, "layout": layout}, "explicit")
    assert parse_design(tomllib.loads(to_toml(design)), "resolved") == design
    assert design.layout.wanted == 2


def test_old_names_of_the_colouring_are_read() -> None:
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0}
    base = {"name": "old", "shape": shape}
    plain = Design.model_validate(base)
    for old, new in (("pens", "paint"), ("printed", "multi-material")):
        read = Design.model_validate(base | {"effort": {"colouring": old, "glue_s": 1.0}})
        assert read.receptor.colouring == new
        assert read.effort.glue_s == 1.0
        assert design_hash(read) == design_hash(plain)
    # A whole file of then, changed now.
    both = base | {"effort": {"colouring": "pens"}, "receptor": {"colouring": "insert"}}
    assert Design.model_validate(both).receptor.colouring == "insert"
    assert design_hash(Design.model_validate(both)) != design_hash(plain)
    for wrong in (
        {"effort": {"colouring": "printed"}, "receptor": {"colouring": "paint"}},
        {"effort": {"colouring": "brush"}},
    ):
        with pytest.raises(ValidationError):
            Design.model_validate(base | wrong)


def test_fields_of_inserts_count_only_with_them() -> None:
    def of(**receptor: object) -> str:
        data = load_design("cylinder60").model_dump(mode="json")
        return design_hash(Design.model_validate(data | {"receptor": receptor}))

    assert of() == of(gap_insert_mm=0.3)
    assert of(colouring="insert") != of(colouring="insert", gap_insert_mm=0.3)
