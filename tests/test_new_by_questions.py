"""``phytac new`` without a name: questions, a layout that passes the check, a short file."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from phytac_design.cli import new_command
from phytac_design.cli.app import app
from phytac_design.design.camera_catalogue import CAMERAS
from phytac_design.design.design_file import (
    load_design,
    parse_design,
    shipped_designs,
    to_short_toml,
    to_toml,
)
from phytac_design.design.field_of_view import fields_of_view_deg
from phytac_design.design.shell_materials import SHELL_MATERIALS, ShellMaterial
from phytac_design.design.spec import CameraSection
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.design_review import checkup
from phytac_design.study.advice import first_design as first_design_module
from phytac_design.study.advice.first_design import (
    ERROR_MAX,
    FAMILIES,
    first_design,
    trip_force_N,
)
from phytac_design.study.advice.force_precision import force_sd_N
from phytac_design.study.search.surrogate import strain_of
from phytac_design.workflows import switch_feasibility
from phytac_shapes.errors import DesignError
from tests.long_cases import with_long
from tests.refusals import refused

SMALL: dict[str, dict[str, float]] = {
    "cylinder": {"diameter_outer_mm": 34.0, "length_mm": 40.0},
    "cone": {"diameter_near_mm": 40.0, "diameter_far_mm": 30.0, "length_mm": 40.0},
    "cuboid": {"width_mm": 36.0, "depth_mm": 40.0, "edge_radius_mm": 8.0, "length_mm": 40.0},
    "hemisphere": {"diameter_outer_mm": 30.0},
    "plane": {"width_mm": 40.0, "height_mm": 30.0},
}
ROD = {
    "kind": "cylinder",
    "name": "rod",
    "radius_mm": 1.0,
    "from_mm": [0.0, 0.0, 5.0],
    "to_mm": [0.0, 0.0, 9.0],
}
ENDOSCOPE = next(one for one in CAMERAS if "endoscope" in one.label)


def made(
    kind: str,
    *,
    most_N: float = 25.0,
    camera: dict[str, Any] | None = None,
    material: ShellMaterial | None = None,
) -> Any:
    table = camera or ENDOSCOPE.table()
    forces = {"force_min_N": 0.5, "force_max_N": most_N}
    return first_design("a", kind, SMALL[kind], table, **forces, material=material)


def test_a_shell_is_soft_enough_for_its_forces() -> None:
    tough, *softer = SHELL_MATERIALS
    stiff, soft = made("hemisphere", most_N=8.0, material=tough), made("hemisphere", most_N=8.0)
    assert force_sd_N(stiff) > ERROR_MAX * 8.0 >= force_sd_N(soft)
    assert soft.material.modulus_MPa in {one.modulus_MPa for one in softer}
    # The stiffest that is soft enough.
    assert made("hemisphere", most_N=2000.0).material.modulus_MPa == tough.modulus_MPa
    # A chosen one stays, also where it is not.
    assert stiff.material.modulus_MPa == tough.modulus_MPa


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(new_command, "in_terminal", lambda: True)
    # Bowls take half a minute to solve.
    monkeypatch.setattr(switch_feasibility, "misfit", lambda *_: "")
    monkeypatch.setattr(switch_feasibility, "far_too_high", lambda *_: "")
    monkeypatch.setattr(switch_feasibility, "feasible_range", lambda *_: None)
    exact, known = first_design, dict[str, Any]()

    def once(name: str, *given: Any, progress: Any, **options: Any) -> Any:
        # Asked again with the same answers, for another file.
        if (key := repr((given, options))) not in known:
            known[key] = exact(name, *given, progress=progress, **options)
        return known[key].model_copy(update={"name": name})

    monkeypatch.setattr(first_design_module, "first_design", once)

    def answered(*answers: object, options: tuple[str, ...] = ()) -> Any:
        lines = "".join(f"{answer}\n" for answer in answers)
        return CliRunner().invoke(app, ["new", *options], input=lines)

    return answered


@pytest.mark.parametrize("kind", with_long(FAMILIES, ("cone", "cuboid")))
def test_a_first_design_passes_the_check(kind: str) -> None:
    design = made(kind)
    assert checkup(design)["clear"]
    assert design.shape.model_dump(exclude={"kind"}).items() >= SMALL[kind].items()
    assert design.layout.wanted >= 8


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda one: one.label)
def test_cameras_of_the_catalogue_are_cameras(camera: Any) -> None:
    section = CameraSection.model_validate(camera.table())
    assert fields_of_view_deg(section.lens())[0] == pytest.approx(
        camera.field_of_view_deg, abs=0.01
    )
    # Lenses of such modules have focal lengths of 1 to 6 mm.
    assert 1.0 < 1e-3 * section.focal_px * section.pixel_um < 6.0
    assert camera.words().startswith(f"{camera.label}: {camera.width_px} x ")


def test_forces_set_wall_and_switches() -> None:
    tough = SHELL_MATERIALS[0]
    weak, strong = (made("plane", most_N=most_N, material=tough) for most_N in (1.0, 60.0))
    assert strong.wall.thickness_mm > weak.wall.thickness_mm
    assert strain_of(Sensor(strong)) <= tough.strain_max
    assert weak.switch.threshold_N < strong.switch.threshold_N == 0.5
    assert trip_force_N(weak) <= 1.0
    # Share of the smallest patch's area that lies on the footprint.
    footprint = weak.switch.footprint_diameter_mm / 2.0 / weak.training.patch_radius_min_mm
    assert trip_force_N(weak) == pytest.approx(weak.switch.threshold_N / footprint**2)


def test_what_no_layout_can_do_is_refused() -> None:
    coarse = {"width_px": 40, "height_px": 30, "field_of_view_deg": 60.0}
    with refused("first-design-not-found") as caught:
        made("cylinder", camera=coarse)
    caught.match("phytac new a --from cylinder40")
    tiny = {"diameter_outer_mm": 6.0}
    with refused("first-design-not-found") as caught:
        first_design("a", "hemisphere", tiny, ENDOSCOPE.table(), force_min_N=0.5, force_max_N=9.0)
    caught.match("fewer than 8")


def test_questions_make_a_short_file(ask: Any, tmp_path: Path) -> None:
    done = ask("fingertip", "hemi", 30, "USB e", 0.2, 12, "")
    assert done.exit_code == 0, done.output
    text = (tmp_path / "fingertip.toml").read_text()
    data = tomllib.loads(text)
    assert data["shape"] == {"kind": "hemisphere", "diameter_outer_mm": 30.0}
    assert data["camera"] == ENDOSCOPE.table()
    assert data["training"]["force_max_N"] == 12.0
    assert data["material"]["modulus_MPa"] < 100.0
    assert "12 N is read to about ± 0.0" in done.stdout
    assert "sensing face of 30 x 30 x 15 mm" in done.stdout
    assert len(text.splitlines()) < 50
    design = load_design(str(tmp_path / "fingertip.toml"))
    assert checkup(design)["clear"]
    assert f"{design.layout.wanted} markers, wall" in done.stdout
    last = done.stdout.splitlines()[-1]
    assert last == "next: phytac check fingertip.toml, then phytac build fingertip.toml"
    # Nothing is overwritten, and that is said before the other questions.
    again = ask("fingertip")
    assert getattr(again.exception, "code", "") == "output-exists"


def test_the_full_file_is_the_same_design(ask: Any, tmp_path: Path) -> None:
    for name, options in (("short", ()), ("whole", ("--full",))):
        assert ask(name, 5, 40, 30, 6, 0.5, 9, 2, options=options).exit_code == 0
    short, whole = (load_design(str(tmp_path / f"{n}.toml")) for n in ("short", "whole"))
    assert whole.model_copy(update={"name": "short"}) == short
    assert (tmp_path / "whole.toml").read_text() == to_toml(whole)


def test_wrong_answers_are_asked_again(ask: Any, tmp_path: Path) -> None:
    shape = (9, "c", 4, 5000, "40,5 mm", "4 cm", "nan", 3, "n", 30)
    camera = (8, 1280, 720, 359, 130, "y")
    done = ask("../x", "tip", *shape, *camera, 0.5, 0.1, 9, "nylon", 2)
    assert done.exit_code == 0, done.output
    for words in (
        "'../x' is no name",
        "9 is not between 1 and 5",
        "'40,5 mm' is not a number: write 40.5",
        "'4 cm' is not a number: it must be in the unit asked for",
        "nan is not between",
        "'c' is several of these",
        "3 cm are 30 mm. Keep 3 mm?",
    ):
        assert words in done.output
    assert "5000 is not between" in done.output
    assert "359 is not between 5 and 280" in done.output
    assert "0.1 is not between 0.5" in done.output
    assert "'nylon' is none of these" in done.output
    assert "is read to about" in done.output
    assert "which is poor: the wall hardly moves" in done.output
    data = tomllib.loads((tmp_path / "tip.toml").read_text())
    own = {"model": "kannala_brandt", "width_px": 1280, "height_px": 720}
    assert data["camera"] == own | {"field_of_view_deg": 130.0}


def test_answers_that_no_layout_suits_are_asked_again(ask: Any, tmp_path: Path) -> None:
    tiny, able = (4, 6, "y", 6, 0.5, 9, 1), (4, 30, 6, 0.5, 9, 1)
    done = ask("tip", *tiny, "y", *able)
    assert done.exit_code == 0, done.output
    assert "error[first-design-not-found]" in done.output
    assert load_design(str(tmp_path / "tip.toml")).shape.model_dump()["diameter_outer_mm"] == 30.0
    assert ask("other", *tiny, "n").exit_code != 0


def test_without_a_terminal_the_usage_is_printed(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["new"])
    assert done.exit_code == 2
    assert "Usage: " in done.output
    assert "Missing argument 'name'" in done.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", shipped_designs())
def test_short_files_rebuild_the_shipped_designs(name: str) -> None:
    design = load_design(name)
    text = to_short_toml(design)
    assert parse_design(tomllib.loads(text), "short") == design
    assert len(text) < 0.2 * len(to_toml(design))


@pytest.mark.parametrize(
    "tables",
    [
        # The focal length would follow the width if it were left out.
        {"camera": {"width_px": 1280, "focal_px": 970.0}},
        {"camera": {"width_px": 1280}},
        {"camera": {"preset": "paper_480fps"}},
        {"print_rules": {"process": "fdm"}, "hardware": {"board": "32x32"}},
        {"fixtures": [ROD, ROD | {"name": "two", "to_mm": [0.0, 0.0, 7.0]}]},
        {"regions": [{"name": "tip", "along": [0.0, 0.2]}], "layout": {"kind": "straight"}},
    ],
)
def test_short_files_keep_what_follows_other_fields(tables: dict[str, Any]) -> None:
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0}
    design = parse_design({"name": "a", "shape": shape, **tables}, "design")
    assert parse_design(tomllib.loads(to_short_toml(design)), "short") == design


def test_a_rejected_wall_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = first_design_module._with_wall

    def rejecting(design: Any, material: ShellMaterial, thickness_mm: float) -> Any:
        if thickness_mm > 1.0:
            raise DesignError("wall-rejected", "too thick")
        return exact(design, material, thickness_mm)

    monkeypatch.setattr(first_design_module, "_with_wall", rejecting)
    design = made("hemisphere", most_N=8.0)
    assert design.wall.thickness_mm <= 1.0
    # Also where no wall that is left reads the force well.
    tough = made("hemisphere", most_N=8.0, material=SHELL_MATERIALS[0])
    assert tough.wall.thickness_mm <= 1.0
    assert force_sd_N(tough) > ERROR_MAX * 8.0


def test_a_wall_whose_strain_is_too_large_does_not_bear(monkeypatch: pytest.MonkeyPatch) -> None:
    """However nearly linear it is."""
    monkeypatch.setattr(first_design_module, "strain_of", lambda _: 0.5)
    monkeypatch.setattr(first_design_module, "linear_error", lambda *_: 0.0)
    design = load_design("cylinder40")
    found = first_design_module._with_wall(design, SHELL_MATERIALS[0], design.wall.thickness_mm)
    assert found[1:] == (False, float("inf"))
