"""What a changed field runs again: what stages say they read is what they read."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from phytac_decoder.io.bundle import load_bundle
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.design.field_groups import PARTS, fields_of, values_of
from phytac_design.design.layout_table import LayoutSection
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, _sensor_of
from phytac_design.layout import marker_layout as layout_make
from phytac_design.layout.markers import Markers
from phytac_design.stages import STAGES, decoder_stage
from phytac_design.stages.build import build
from tests.designs import CAMERA, COARSE, changed, tiny
from tests.places_alone import places_alone


@pytest.fixture(autouse=True)
def _places_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In a cache of its own: no other test takes what is decoded so for the exact result."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    with places_alone():
        yield


def test_every_field_of_the_layout_is_of_one_part() -> None:
    parts = [
        *(name for name in PARTS["places"] if name.startswith("layout.")),
        *PARTS["heights"],
        *PARTS["colours"],
    ]
    assert sorted(parts) == sorted(f"layout.{name}" for name in LayoutSection.model_fields)


def test_every_name_is_of_the_design_file() -> None:
    for stage in STAGES:
        for design in (load_design("cylinder60-dense"), load_design("hemisphere")):
            assert values_of(design, stage.design_fields)


def test_reads_depend_on_the_layout() -> None:
    plain = fields_of(load_design("cylinder60"), ("tubes",))
    assert not any(name.startswith(("camera", "light", "switch")) for name in plain)
    assert "layout.colours" not in plain
    assert "camera.focal_px" in fields_of(load_design("cylinder60-dense"), ("tubes",))
    assert "camera.focal_px" not in fields_of(load_design("cylinder60-dense"), ("bases",))
    assert "switch.footprint_diameter_mm" in fields_of(load_design("hemisphere"), ("bases",))
    both = fields_of(load_design("cylinder60"), ("bases", "wall", "wall.thickness_mm"))
    assert "wall" in both
    assert "wall.thickness_mm" not in both


class Trace:
    """Fields that stages read while it is watched, by stage."""

    def __init__(self) -> None:
        self.stage = ""
        self.paused = 0
        self.reads: dict[str, set[str]] = defaultdict(set)
        self.tables: dict[int, str] = {}

    def follow(self, design: Design) -> None:
        """Know the tables of a design by their identity."""
        self.tables = {
            id(getattr(design, name)): name
            for name in type(design).model_fields
            if isinstance(getattr(design, name), BaseModel)
        } | {id(design): ""}

    @contextmanager
    def watched(self, stage: str) -> Iterator[None]:
        """Note reads as this stage's."""
        self.stage = stage
        yield
        self.stage = ""

    def note(self, owner: Any, field: str) -> None:
        """Remember one read; of tables as wholes only those that are not models."""
        table = self.tables.get(id(owner))
        if not self.stage or self.paused or table is None or field not in type(owner).model_fields:
            return
        if table or id(object.__getattribute__(owner, field)) not in self.tables:
            self.reads[self.stage].add(f"{table}.{field}" if table else field)


@pytest.fixture
def trace(monkeypatch: pytest.MonkeyPatch) -> Trace:
    """Watch every read of a design's fields and of markers' colours.

    Making markers reads the whole layout; what of the markers is used counts.
    """
    found = Trace()

    def read_model(owner: Any, name: str) -> Any:
        if not name.startswith("_"):
            found.note(owner, name)
        return object.__getattribute__(owner, name)

    def read_markers(owner: Any, name: str) -> Any:
        if name == "colour" and found.stage and not found.paused:
            found.reads[found.stage].add("layout.colours")
        return object.__getattribute__(owner, name)

    def quietly(function: Any) -> Any:
        def call(*args: Any, **named: Any) -> Any:
            found.paused += 1
            try:
                return function(*args, **named)
            finally:
                found.paused -= 1

        return call

    monkeypatch.setattr(BaseModel, "__getattribute__", read_model, raising=False)
    monkeypatch.setattr(Markers, "__getattribute__", read_markers, raising=False)
    for name in ("_lattice_markers", "_scattered", "with_heights", "sight_heights_mm"):
        monkeypatch.setattr(layout_make, name, quietly(getattr(layout_make, name)))
    return found


def allowed(design: Design, reads: tuple[str, ...]) -> set[str]:
    """Fields and whole tables."""
    return set(fields_of(design, reads))


def undeclared(design: Design, trace: Trace) -> dict[str, list[str]]:
    """Fields read by stages that do not say so."""
    out = {}
    for stage in STAGES:
        mine = allowed(design, stage.design_fields)
        wrong = [
            name
            for name in sorted(trace.reads[stage.name])
            # What kind of layout it is decides what it reads: part of where receptors stand.
            if name not in mine and name.partition(".")[0] not in mine
        ]
        if wrong:
            out[stage.name] = wrong
    return out


def watch(design: Design, trace: Trace, folder: Path, stages: set[str]) -> None:
    """Run stages under watch, at the least accuracy."""
    trace.follow(design)
    folders: dict[str, Path] = {}
    for stage in STAGES:
        if stage.name not in stages:
            continue
        own = folder / stage.name
        own.mkdir()
        _sensor_of.cache_clear()  # what an earlier stage has read of the sensor is read again
        context = Context(
            design=design,
            accuracy=COARSE,
            seed=0,
            progress=lambda _: None,
            folders={name: folders[name] for name in stage.depends_on},
            array_names=stage.arrays,
        )
        # Made before: what of them is used is watched, not how they are made.
        assert context.markers.count
        with trace.watched(stage.name):
            stage.run(context, own)
            if stage.gate:
                stage.gate(replace(context, folders={**folders, stage.name: own}, array_names={}))
        folders[stage.name] = own


@pytest.mark.usefixtures("coarse_switches")
def test_stages_read_what_they_say(trace: Trace, tmp_path: Path) -> None:
    design = tiny()
    watch(design, trace, tmp_path, {stage.name for stage in STAGES} - {"report"})
    assert undeclared(design, trace) == {}
    # The watch sees something: these are read.
    assert "material.modulus_MPa" in trace.reads["response"]
    assert "camera.noise_pixel" in trace.reads["frames"]
    assert "layout.colours" in trace.reads["shell"]
    assert "layout.colours" not in trace.reads["step"] | trace.reads["mesh"]


@pytest.mark.parametrize("name", ["scattered", "sight", "two cameras", "inserts"])
def test_other_layouts_read_what_they_say(trace: Trace, tmp_path: Path, name: str) -> None:
    design = {
        "scattered": lambda: changed("hemisphere", layout={"count": 30}, camera=CAMERA),
        "sight": lambda: tiny(layout={"heights": "line-of-sight"}),
        "two cameras": lambda: tiny(camera={"ends": "both"}),
        "inserts": lambda: tiny(receptor={"colouring": "insert"}),
    }[name]()
    stages = {"views", "compare", "shell", "mesh", "response", "places", "resolution", "underload"}
    watch(design, trace, tmp_path, stages | ({"inserts"} if name == "inserts" else set()))
    assert undeclared(design, trace) == {}


def test_an_undeclared_read_is_seen(trace: Trace, tmp_path: Path) -> None:
    design = tiny()
    watch(design, trace, tmp_path, {"mesh"})
    trace.reads["mesh"].add("light.bar_radius_mm")
    assert undeclared(design, trace) == {"mesh": ["light.bar_radius_mm"]}


MECHANICS = {"response", "places", "twin", "resolution"}
CHANGES: dict[str, tuple[dict[str, Any], set[str]]] = {
    "words": ({"description": "other words"}, set()),
    "a region's name": ({"regions": [{"name": "palm", "rows": [0, 1]}]}, set()),
    # What mechanics asks of the pictures did not change, but the noise that decoders expect.
    "noise": ({"camera": {"noise_pixel": 1.1}}, {"views", "decoder", "frames"}),
    # A marker's image moves as its paint shows: a little otherwise in another colour.
    "colours": (
        {"layout": {"colours": ["green", "blue"]}},
        {"views", "underload", "decoder", "renders", "frames"} | MECHANICS,
    ),
    "camera": (
        {"camera": {"stand_off_mm": 40.0}},
        {"views", "underload", "decoder", "renders", "frames"} | MECHANICS,
    ),
    "threshold": ({"switch": {"threshold_N": 0.55}}, {"twin", "decoder", "renders", "frames"}),
    "resin": (
        {"material": {"modulus_MPa": 1800.0}},
        {"underload", "decoder", "renders", "frames"} | MECHANICS,
    ),
    "one height": (
        {"layout": {"height_far_mm": 4.2}},
        {"views", "underload", "decoder", "renders", "frames"} | MECHANICS,
    ),
    "rubber, mold, print rules, hardware": (
        {
            "switch": {"modulus_MPa": 0.55},
            "mold": {"land_mm": 0.7},
            "print_rules": {"gap_min_mm": 0.31},
            "hardware": {"wall_mm": 3.5},
        },
        set(),
    ),
}
SIDES = ("frames", "underload", "resolution")
"""Stages without fabrication, which is slow and reads whole tables."""


def test_a_change_runs_just_what_depends_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = decoder_stage.decode_points
    # The quickest estimator in place of each: what runs does not depend on how well it decodes.
    monkeypatch.setattr(
        decoder_stage, "decode_points", lambda model, data, _: exact(model, data, "fem")
    )

    def run(design: Design, folder: str) -> set[str]:
        result = build(
            design, tmp_path / folder, accuracy=COARSE, only=SIDES, progress=lambda _: None
        )
        return set(result.ran)

    run(tiny(), "plain")
    found = {name: run(tiny(**change), name) for name, (change, _) in CHANGES.items()}
    assert found == {name: stages for name, (_, stages) in CHANGES.items()}
    bundle = load_bundle(tmp_path / "a region's name" / "decoder")
    assert [region.name for region in bundle.regions] == ["palm"]
    assert bundle.design_hash == design_hash(tiny())
