"""Guides and pages: their files work as described, their figures are the measured ones."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks import tables
from phytac_design.design.design_file import load_design
from phytac_design.design.print_rules_table import PROCESSES
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.study.search.design_space import make_space
from phytac_design.study.search.study_file import load_study
from tests.docs.pages import PAGES, ROOT, blocks, listing

GUIDES = ROOT / "docs" / "guides"
CAMERA, PRINTER = GUIDES / "own-camera.md", GUIDES / "own-printer.md"
FIGURES = (
    ("0.12 N, 1.2 %", "decoder", "cylinder60 unit 1, frames: auto, middle heights (651 contacts)"),
    ("0.38 N, 2.9 %", "decoder", "cylinder60 unit 1, frames: auto, all heights (991 contacts)"),
    ("0.18 N, 1.4 %", "decoder", "cone unit 1, frames: auto, middle heights (81 contacts)"),
    ("0.35 N, 2.9 %", "decoder", "hemisphere unit 1, frames: auto, middle heights (120 contacts)"),
    ("1.3 N, 11 %", "decoder", "plane unit 1, frames: auto, middle heights (35 contacts)"),
)
"""Figures of this project in the comparison, and the cases they come from."""


def python(code: str, path: Path) -> str:
    """Output of a program that finds changed packages in ``path`` first."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=path,
        env={**os.environ, "PYTHONPATH": f"{path / 'decoder'}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_calibration_file_makes_the_camera(tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").write_text(listing(CAMERA, "lens.yaml"))
    (tmp_path / "shot.toml").write_text(listing(CAMERA, "shot.toml"))
    design = load_design(str(tmp_path / "shot.toml"))
    assert design.camera.model == "brown_conrady"
    assert (design.camera.width_px, design.camera.focal_px) == (1296, 486.2)
    assert checkup(design)["clear"]


def test_a_lens_is_one_class_in_one_file(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "decoder", tmp_path / "decoder", ignore=shutil.ignore_patterns("__py*"))
    with (tmp_path / "decoder" / "phytac_decoder" / "camera" / "lens.py").open("a") as stream:
        stream.write("\n\n" + listing(CAMERA, "decoder/phytac_decoder/camera/lens.py"))
    code = """
import numpy as np
from phytac_design.rules.design_review import checkup
from phytac_design.stages.build import copy_of
from phytac_design.design.design_file import load_design
lens = {"model": "stereographic", "width_px": 864, "height_px": 648, "focal_px": 323.0}
shape = {"length_mm": 60.0}
few = {"rows": 6, "columns": 10, "height_far_mm": 4.0}
design = copy_of(load_design("cylinder60"), camera=lens, shape=shape, layout=few)
eye = design.camera.lens()
away = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 2.0, 1.0], [3.0, 1.0, -0.5]])
pixels = eye.project(away)
theta = np.arctan2(np.hypot(away[:, 0], away[:, 1]), away[:, 2])
radius = np.hypot(*(pixels - eye.centre_px).T) / 323.0
assert np.allclose(radius, 2.0 * np.tan(theta / 2.0), rtol=1e-12), radius
back = eye.unproject(pixels)
assert np.allclose(back, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-9), back
step = 1e-6
slope = (eye.project(away + [step, 0, 0]) - eye.project(away - [step, 0, 0])) / (2 * step)
assert np.allclose(slope, eye.jacobian(away)[:, :, 0], rtol=1e-6, atol=1e-6)
print(checkup(design)["visibility"]["occluded"])
"""
    assert python(code, tmp_path).strip() == "0"


def test_a_printer_is_numbers_in_the_design(tmp_path: Path) -> None:
    (tmp_path / "printed.toml").write_text(listing(PRINTER, "printed.toml"))
    rules = load_design(str(tmp_path / "printed.toml")).print_rules
    assert (rules.bed_mm, rules.accuracy_mm, rules.hole_min_mm) == ((120.0, 68.0, 155.0), 0.08, 0.5)
    check_design(load_design(str(tmp_path / "printed.toml")))


def changed(name: str, mark: str, new: str) -> ModuleType:
    """The module of a file in which ``mark``, which stands there once, is ``new``."""
    source = (ROOT / name).read_text()
    assert source.count(mark) == 1
    module = ModuleType(f"changed_{Path(name).stem}")
    sys.modules[module.__name__] = module  # dataclasses and models look their module up
    try:
        program = compile(source.replace(mark, new), name, "exec")
        exec(program, module.__dict__)  # noqa: S102 - our own source
    finally:
        del sys.modules[module.__name__]
    return module


def test_a_print_preset_is_one_entry_in_one_file() -> None:
    head = "PROCESSES: dict[str, dict[str, Any]] = {\n"
    name = "phytac_design/design/print_rules_table.py"
    section = changed(name, head, head + listing(PRINTER, name)).PrintSection
    rules = section.model_validate({"process": "dlp"})
    assert (rules.accuracy_mm, rules.bed_mm, rules.hole_min_mm) == (0.08, (143.0, 89.0, 175.0), 0.6)
    assert rules.model_fields_set == {*PROCESSES["sla"], "process"}
    with pytest.raises(ValidationError, match="'dlp'"):
        section.model_validate({"process": "dpl"})


def test_the_cluster_study_is_one(tmp_path: Path) -> None:
    path = tmp_path / "mine-study.toml"
    path.write_text(listing(GUIDES / "cluster.md", "mine-study.toml"))
    study, folder = load_study(str(path))
    assert study.budget.candidates == 8
    make_space(study, folder)


def test_an_estimator_goes_where_the_page_says() -> None:
    """The listing of the architecture page fits into ``ForceModel.forces``."""
    (code,) = [b for b in blocks(ROOT / "docs" / "architecture.md", "python") if "own" in b]
    mark = '        if estimator == "koi_inverse":\n'
    model = changed(
        "decoder/phytac_decoder/estimation/estimators.py", mark, code + mark
    ).ForceModel(
        shift_to_mm=np.array([[0.1, 0.0], [0.0, 0.2]]),
        stiffness=np.diag([30.0, 40.0]),
        compliance_px=np.eye(4)[:, :2],
        height_z_mm=np.zeros(2),
        neighbours=np.full((2, 8), -1),
        networks={},
    )
    found = model.forces("own", np.array([[2.0, 5.0], [1.0, 0.5]]), np.array([0, 1]))
    assert found.tolist() == pytest.approx([6.0, 4.0])


@pytest.mark.parametrize(("figure", "name", "case"), FIGURES)
def test_figures_of_the_comparison_are_measured(figure: str, name: str, case: str) -> None:
    text = (ROOT / "docs" / "published-sensors.md").read_text()
    rows = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())["rows"]
    value = {row["case"]: row["value"] for row in rows}
    newtons, percent = value[f"{case}: mean absolute error"], value[f"{case}: mean relative error"]
    assert figure in text
    said_N, said = (float(part.split()[0]) for part in figure.split(", "))
    assert said_N == float(f"{newtons:.2g}")
    assert said == float(f"{percent:.2g}")


def test_counts_of_the_comparison_are_those_of_the_designs() -> None:
    text = (ROOT / "docs" / "published-sensors.md").read_text()
    for name, count in (("cylinder60", 368), ("cylinder60-dense", 744), ("cone", 196),
                        ("hemisphere", 84), ("plane", 130)):  # fmt: skip
        markers = check_design(load_design(name)).markers
        assert markers.count == count
        (row,) = [line for line in text.splitlines() if f"**here**, `{name}`," in line]
        assert f" {count}" in row
    area = load_design("cylinder60-dense").surface().area_mm2() / 100.0
    assert f"{744 / area:.2f}" == "3.29"


def test_figures_of_the_photo_are_measured() -> None:
    text = (ROOT / "docs" / "published-sensors.md").read_text()
    rows = json.loads((ROOT / "benchmarks" / "results" / "real_photo.json").read_text())["rows"]
    value = {row["case"].partition(": ")[2]: row["value"] for row in rows}
    clear, found = value["dots predicted clear"], value["dots that the decoder finds"]
    agree = value["dots for which prediction and decoder agree"]
    for part in (
        f"RMS | – | {value['reprojection RMSE']:.1f} px",
        f"median {value['reprojection error, median']:.2g} px",
        f"| dots of their own | {clear} | {found} ",
        f"| hidden by others | {value['dots predicted hidden']} |",
        f"| fused with a neighbour | {value['dots predicted fused in our segmentation']},",
        f"agree on {agree:.0f} % of",
    ):
        assert part in text


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        name, _, heading = target.partition("#")
        path = (page.parent / name) if name else page
        assert path.exists(), target
        if heading:
            titles = re.findall(r"^#+ (.+)$", path.read_text("utf-8"), re.MULTILINE)
            assert heading in {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}


def test_the_index_names_every_page() -> None:
    text = (ROOT / "docs" / "README.md").read_text()
    known = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert {name for name in known - {"README.md"} if f"({name})" not in text} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_toml_and_json_of_the_pages_are_sound(page: Path) -> None:
    for text in blocks(page, "toml"):
        tomllib.loads(text)
    for text in blocks(page, "json"):
        for line in text.split("\n\n"):
            json.loads(line)


def test_all_figures_are_written_on_demand(monkeypatch: pytest.MonkeyPatch) -> None:
    # Which figures are current takes seconds to tell; test_provenance.py, test_docs.py.
    monkeypatch.setattr(tables, "is_current", lambda _: True)
    assert "Scordelis-Lo" in tables.page(tables.read())


def test_public_modules_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    (section,) = re.findall(r"^## Public modules$(.+?)^## ", text, re.MULTILINE | re.DOTALL)
    modules = re.findall(r"`(phytac_[\w.]+)`", section)
    assert len(modules) > 30
    assert [name for name in modules if not module_exists(name)] == []


def test_every_moved_module_is_where_the_table_says() -> None:
    text = (GUIDES.parent / "moved-modules.md").read_text("utf-8")
    rows = re.findall(r"^\| `([\w.]+)` \| (.+) \|$", text, re.MULTILINE)
    assert len(rows) > 400
    assert len({old for old, _ in rows}) == len(rows)
    for _, new in rows:
        for module in re.findall(r"`([\w.]+)`", new):
            assert module_exists(module), module


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_of_the_pages_exist(page: Path) -> None:
    for text in [*blocks(page, "python"), *blocks(page, "py")]:
        for line in re.findall(r"^from (phytac_\S+) import (.+)$", text, re.MULTILINE):
            module = import_module(line[0])
            assert [name for name in line[1].split(", ") if not hasattr(module, name)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_source_files_that_pages_name_exist(page: Path) -> None:
    if page.name == "moved-modules.md":
        return
    made = {"shapes/phytac_shapes/barrel.py"}  # by the reader of the guide
    named = re.findall(
        r"`((?:shapes|decoder|phytac_design|benchmarks|tests)/[\w/]+\.py)`", page.read_text("utf-8")
    )
    for name in set(named) - made:
        assert "NAME" in name or (ROOT / name).is_file(), name


def module_exists(name: str) -> bool:
    """Whether a file or package of the project has this import name."""
    roots = (ROOT, ROOT / "shapes", ROOT / "decoder")
    paths = [root / Path(*name.split(".")) for root in roots]
    return any(path.with_suffix(".py").is_file() or path.is_dir() for path in paths)
