"""Switches of a design: lengths follow the receptors, solids have their section's volume."""

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.fabrication.switch_set import (
    LENGTH_STEP_mm,
    make_switches,
    reach_mm,
    revolve,
    revolved_volume_mm3,
    switch_profile,
)
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.solids.solid_mesh import to_manifold
from phytac_design.stages.build import copy_of
from tests.refusals import refused

BOWL = {"diameter_mm": 4.6, "depth_mm": 1.77, "thickness_mm": 0.22, "stem_diameter_mm": 1.44}
BOWL |= {"pad_diameter_mm": 1.44, "pad_height_mm": 0.02, "fillet_mm": 0.24}
REGION = {"threshold_N": 0.8, "rows": [2, 3]}


def made(design: Design, *thresholds: float) -> list[dict[str, object]]:
    del design
    return [{"threshold_N": threshold, "bowl": BOWL} for threshold in thresholds]


def test_profile_of_a_sphere_cap_has_its_volume() -> None:
    """The bowl alone (outer less inner cap) by closed form, stem and pad apart."""
    bowl = Bowl(**BOWL)
    fine = revolved_volume_mm3(switch_profile(bowl, 6.0, 1.2, tolerance_mm=1e-4))
    longer = revolved_volume_mm3(switch_profile(bowl, 8.0, 1.44, tolerance_mm=1e-4))
    base = revolved_volume_mm3(switch_profile(bowl, 6.0, 1.44, tolerance_mm=1e-4))
    assert longer - base == pytest.approx(2.0 * np.pi * 0.72**2, rel=1e-9)
    radius, centre = bowl.outer_radius_mm, bowl.centre_mm

    def cap(sphere: float) -> float:
        height = sphere + centre
        return np.pi * height**2 * (3.0 * sphere - height) / 3.0

    shell = cap(radius) - cap(radius - bowl.thickness_mm)
    stem = np.pi * 0.72**2 * (6.0 + bowl.depth_mm)
    # Fillets, flank and pad add a little to bowl and stem.
    assert shell + stem < base < shell + stem + 0.9
    assert fine < base
    coarse = revolved_volume_mm3(switch_profile(bowl, 6.0, 1.2, tolerance_mm=0.02))
    assert coarse == pytest.approx(fine, rel=0.005)


def test_solid_is_closed_and_has_the_section_s_volume() -> None:
    profile = switch_profile(Bowl(**BOWL), 3.0, 1.2, tolerance_mm=0.01)
    solid = to_manifold(revolve(profile, 0.01))
    assert solid.genus() == 0
    assert solid.volume() == pytest.approx(revolved_volume_mm3(profile), rel=1e-9)


def test_stem_only_narrows_towards_the_tip() -> None:
    profile = switch_profile(Bowl(**BOWL), 12.0, 1.2)
    rim = int(np.flatnonzero(np.abs(profile[:, 1]) < 1e-12)[-1])
    stem = profile[rim:][profile[rim:, 1] < 1.0]
    below = stem[stem[:, 0] <= 0.72 + 1e-9]
    assert below[-2, 0] == pytest.approx(0.6)
    assert np.all(np.diff(below[:, 0]) <= 1e-12)


def test_every_stem_follows_its_receptor() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    switches = make_switches(
        Sensor.of(design, surface, markers), made(design, 0.5), np.full(368, 0.5)
    )
    wanted = markers.height_mm + design.wall.thickness_mm - design.switch.tip_recess_mm
    assert switches.reach_mm == pytest.approx(wanted)
    assert switches.lengths_mm[switches.length] == pytest.approx(wanted, abs=LENGTH_STEP_mm / 2)
    assert len(switches.kinds) == 23
    assert [switches.label(kind) for kind in switches.kinds][:3] == ["A0", "A1", "A2"]
    assert sum(len(switches.markers_of(kind)) for kind in switches.kinds) == 368
    taller = copy_of(design, layout={"height_far_mm": 12.0})
    longer = reach_mm(Sensor.of(taller, surface, make_markers(taller, surface)))
    assert longer.max() == pytest.approx(switches.reach_mm.max() + 0.5)


def test_regions_have_bowls_of_their_own() -> None:
    design = copy_of(load_design("cylinder60"), switch={"regions": [REGION]})
    surface = design.surface()
    markers = make_markers(design, surface)
    threshold = thresholds_N(design, markers)
    assert np.all((threshold == 0.8) == np.isin(markers.row, [2, 3]))
    switches = make_switches(Sensor.of(design, surface, markers), made(design, 0.5, 0.8), threshold)
    assert np.all(switches.threshold_N[switches.bowl] == threshold)
    assert {switches.label(kind) for kind in switches.kinds} >= {"A1", "B2", "B3", "A4"}


@pytest.mark.parametrize(
    ("name", "region", "code"),
    [
        ("cylinder60", {"threshold_N": 0.8, "rows": [20, 23]}, "row-out-of-range"),
        ("cylinder60", {"threshold_N": 0.8, "markers": [0, 368]}, "marker-out-of-range"),
        ("hemisphere", {"threshold_N": 0.8, "rows": [0, 1]}, "layout-without-rows"),
    ],
)
def test_regions_beyond_the_layout_are_refused(
    name: str, region: dict[str, object], code: str
) -> None:
    design = copy_of(load_design(name), switch={"regions": [region]})
    with refused(code):
        thresholds_N(design, make_markers(design, design.surface()))


@pytest.mark.parametrize(
    "bad", [{}, {"rows": [3, 2]}, {"rows": [1]}, {"rows": [0, 1], "markers": [0]}]
)
def test_unclear_regions_are_refused(bad: dict[str, object]) -> None:
    with refused("field-invalid"):
        copy_of(load_design("cylinder60"), switch={"regions": [{"threshold_N": 0.8, **bad}]})
