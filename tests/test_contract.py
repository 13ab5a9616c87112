"""The contract of a family: any design of it passes every stage, to decoded forces.

STEP files of every family are tested in ``tests/fabrication/test_cad.py``.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phytac_decoder.estimation.estimators import ESTIMATORS
from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses, superpose
from phytac_design.stages.build import build, copy_of
from phytac_design.stages.renders_stage import FrameContacts, camera_scenes, noisy, render_sample
from phytac_design.stages.response_stage import cell_radius_mm
from phytac_shapes import REGISTRY
from tests.designs import DRAWN, drawn

FORCE_N = 15.0
ACCURACY = replace(PRESETS["draft"], sample_share=0.1, place_share=1.6)
"""Few samples and places: one press is judged."""
WHOLE = ("patch",)
"""Families of which every `make test` builds one, and `make test-all` one of each."""
seeds = st.integers(0, 2**32 - 1)
every_family = pytest.mark.parametrize("kind", sorted(REGISTRY))
again = settings(
    deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
)


def test_every_family_is_drawn() -> None:
    assert set(DRAWN) == set(REGISTRY)


def not_finite(value: Any, name: str = "") -> list[str]:
    """Names of the figures in nested tables that are NaN."""
    if isinstance(value, dict):
        return [bad for key, item in value.items() for bad in not_finite(item, f"{name}.{key}")]
    if isinstance(value, list | tuple):
        return [bad for item in value for bad in not_finite(item, name)]
    return [name] if isinstance(value, float) and math.isnan(value) else []


@every_family
@settings(again, max_examples=3)
@given(seed=seeds)
def test_markers_lie_on_the_wall_and_are_nodes_of_its_mesh(kind: str, seed: int) -> None:
    design = drawn(kind, seed)
    sensor = check_design(design)
    surface, markers = sensor.surface, sensor.markers
    wall = design.wall.thickness_mm
    size = float(np.ptp(surface.bounds_mm(), axis=0).max())
    on_face = markers.mid_mm + wall / 2.0 * markers.normal
    assert np.abs(surface.point(surface.chart(on_face)) - on_face).max() < 1e-9 * size
    mesh = marker_mesh(surface, markers, thickness_mm=wall, refine=2)
    assert np.abs(mesh.nodes_mm[mesh.marker_nodes] - markers.mid_mm).max() < 1e-9 * size
    assert len(np.unique(mesh.marker_nodes)) == markers.count


@every_family
@settings(again, max_examples=1)
@given(seed=seeds)
def test_any_design_is_checked(kind: str, seed: int) -> None:
    report = checkup(drawn(kind, seed))
    assert not_finite(report) == []
    assert report["clear"], report["advice"]
    assert report["markers"]["density_per_cm2"] > 0.5


def one_press(context: Context, marker: int) -> FrameContacts:
    """One patch the size of a marker's cell, on the simulated sensor's own mesh."""
    design, surface, markers = context.design, context.surface, context.markers
    contacts = Contacts.flat(
        sample=np.array([0]),
        uv=markers.uv[[marker]],
        radius_mm=np.array([cell_radius_mm(context)]),
        force_N=np.array([FORCE_N]),
        samples=1,
    )
    mesh, model = truth_shell(design, surface, context.accuracy.truth_refine)
    unit = motion_responses(
        model, mesh, surface, markers, uv=contacts.uv, radius_mm=contacts.radius_mm
    )
    return FrameContacts(
        contacts=contacts,
        switching=switch_states(context.sensor, contacts),
        motion=superpose(unit, contacts),
    )


def through_every_stage(design: Design, out: Path) -> None:
    built = build(
        design,
        out,
        accuracy=ACCURACY,
        only=["shell", "mesh", "decoder"],
        progress=lambda _: None,
    )
    folder = built.out
    assert (folder / "shell" / "shell.stl").stat().st_size > 0
    assert (folder / "mesh" / "shell.inp").stat().st_size > 0
    bundle = load_bundle(folder / "decoder")
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    assert len(bundle.colour) == context.markers.count
    # The marker that shows a force best, of those whose switch can be read.
    shown = np.linalg.norm(bundle.model.compliance_px, axis=0)
    marker = int(np.argmax(np.where(bundle.tips.readable, shown, 0.0)))
    pressed = one_press(context, marker)
    rest, frame = (
        noisy(context, render_sample(context, camera_scenes(context), pressed, index), index)
        for index in (None, 0)
    )
    measured = measure_frame(bundle, frame, rest_px=rest_positions(bundle, rest))
    on = pressed.switching.bits[0]
    assert on[marker]
    # Switches whose red hardly changes when they turn on may be missed, but none is invented.
    assert set(np.flatnonzero(on & bundle.tips.readable)) <= set(measured.koi)
    assert set(measured.koi) <= set(np.flatnonzero(on))
    assert measured.found.all()
    force = measured.forces_N(bundle, "koi_inverse")
    assert force.sum() == pytest.approx(FORCE_N, rel=0.35)
    assert force[marker] > 0.5 * force.sum()
    usable = bundle.stiffness_usable[measured.koi].all()
    warned = any("cannot be used" in text for text in measured.warnings(bundle, force))
    assert warned != usable
    for name in ESTIMATORS:
        assert np.isfinite(measured.forces_N(bundle, name)).all()
    assert (measured.forces_N(bundle, "koi_inverse")[~on] == 0.0).all()


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name not in WHOLE))
        for name in sorted(REGISTRY)
    ],
)
def test_a_drawn_design_goes_through_every_stage(kind: str, tmp_path: Path) -> None:
    """One design of each family, always the same one of few markers: whole builds are slow."""
    design = drawn(kind, 2)
    half = {"width_px": 648, "height_px": 486, "focal_px": 0.75 * design.camera.focal_px}
    through_every_stage(copy_of(design, camera=half), tmp_path / kind)
