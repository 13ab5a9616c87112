"""A sensor in MuJoCo: contacts become frames of a virtual print, read by its decoder."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle, save_bundle, stamp_bundle
from phytac_design.design.design_file import design_hash, to_toml
from phytac_design.design.spec import Design
from phytac_design.mechanics.indenter import Indentations
from phytac_design.optics.exposure import Exposure
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.simulation.solver import Solver
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import assemble_bundle, untrained_model
from phytac_design.stages.virtual_sensor_stage import virtual_sensor
from phytac_design.workflows import mujoco_sensor
from phytac_design.workflows.export_simulator import export_simulator
from phytac_design.workflows.mujoco_sensor import PhytacMujoco
from phytac_design.workflows.train_decoder import MECHANICS
from phytac_shapes.arrays import FloatArray
from tests.designs import COARSE, tiny
from tests.refusals import refused

UNIT = 3
FINER = replace(COARSE, refine=4, place_share=0.8, truth_refine=6)


def design() -> Design:
    return tiny(
        shape={"length_mm": 40.0},
        layout={"rows": 4, "columns": 8},
        wall={"thickness_mm": 0.6},
        receptor={"diameter_hole_mm": 0.0},
        camera={"width_px": 864, "height_px": 648, "focal_px": 323.3},
    )


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    """Decoder of the design that has seen no data."""
    of = design()
    context = run_stages(
        of, select_stages(MECHANICS), accuracy=FINER, seed=0, force=True, progress=lambda _: None
    )[0]
    plain = assemble_bundle(context, untrained_model(context), {})
    return replace(plain, design=of.name, design_hash=design_hash(of))


@pytest.fixture(scope="module")
def sensor() -> VirtualSensor:
    return virtual_sensor(design(), unit=UNIT, accuracy=FINER)


def pressed(
    sensor: VirtualSensor,
    uv: FloatArray,
    force_N: list[float],
    *,
    radius_mm: float = 4.0,
    friction: tuple[float, float] = (0.0, 0.0),
) -> Contacts:
    plain = Contacts.flat(
        sample=np.zeros(len(uv), dtype=np.int64),
        uv=uv,
        radius_mm=np.full(len(uv), radius_mm),
        force_N=np.array(force_N),
        samples=1,
    )
    return replace(plain, friction=np.tile(friction, (len(uv), 1)))


@pytest.mark.parametrize("friction", [(0.0, 0.0), (1.5, 2.0)])
def test_tables_move_markers_as_the_solved_wall_does(
    sensor: VirtualSensor, friction: tuple[float, float]
) -> None:
    uv = np.array([[14.0, 1.0], [25.0, 4.0]])
    touches = pressed(sensor, uv, [6.0, 3.0], friction=friction)
    solver = Solver(
        sensor.design,
        sensor.surface,
        sensor.unit,
        refine=FINER.truth_refine,
        displacement="linear",
    )
    motion = solver.solve(touches, touches.force_N).motion
    assert motion is not None
    imaging = ImagingModel(
        sensor.design, sensor.surface, sensor.unit, exposure=Exposure(noise_pixel=2.0)
    )
    solved = imaging.exact(motion, np.zeros(32, dtype=np.bool_))
    found = sensor.shifts_px(touches)
    size = np.sqrt(np.mean(solved**2))
    assert np.sqrt(np.mean((found - solved) ** 2)) < 0.08 * size
    assert size > 0.05


def test_switches_stay_on_down_to_their_lower_threshold(sensor: VirtualSensor) -> None:
    uv = sensor.unit.markers.uv[13:14]
    on_N, off_N = float(sensor.unit.on_N[13]), float(sensor.unit.off_N[13])
    alone = pressed(sensor, uv, [1.0], radius_mm=1.0)  # the footprint carries it all
    strong, between, weak = (
        replace(alone, force_N=np.array([force]))
        for force in (1.01 * on_N, (on_N + off_N) / 2.0, 0.99 * off_N)
    )
    assert np.flatnonzero(sensor.switched(strong)).tolist() == [13]
    assert not sensor.switched(between).any()
    on = sensor.switched(strong)
    assert np.flatnonzero(sensor.switched(between, on)).tolist() == [13]
    assert not sensor.switched(weak, on).any()


def test_a_print_is_made_once_and_differs_from_others(sensor: VirtualSensor) -> None:
    said: list[str] = []
    again = virtual_sensor(design(), unit=UNIT, accuracy=FINER, progress=said.append)
    assert said == []
    assert np.array_equal(again.places.shift_px, sensor.places.shift_px)
    touches = pressed(sensor, np.array([[12.0, 2.0]]), [5.0])
    plain = virtual_sensor(design(), accuracy=FINER)
    ours, theirs = sensor.shifts_px(touches), plain.shifts_px(touches)
    gap = np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)
    assert 0.01 < gap < 0.3
    with refused("unit-invalid"):
        virtual_sensor(design(), unit=-1)


@pytest.fixture(scope="module")
def mujoco() -> Any:
    return pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra simulators)")


@pytest.fixture(scope="module")
def rig(mujoco: Any) -> Any:
    from benchmarks.connect_presses import PressRig

    return PressRig.of(design())


@pytest.fixture
def felt(rig: Any, bundle: Bundle, sensor: VirtualSensor) -> PhytacMujoco:
    return PhytacMujoco(
        rig.model,
        rig.data,
        design=design(),
        bundle=bundle,
        body="palm/base",
        patch_radius_mm=lambda _: rig.radius_mm,
        sensor=sensor,
    )


def test_a_pressed_ball_is_decoded(rig: Any, felt: PhytacMujoco) -> None:
    uv, normal = felt.sensor.unit.markers.uv, felt.sensor.surface.normal(rig.sensor.markers.uv)
    errors = []
    for marker, force in ((10, 4.0), (12, 10.0), (14, 6.0)):
        rig.press(rig.sensor.markers.uv[marker], force, 4.0)
        felt.reset(marker)
        message = felt.message()
        contacts = felt.contacts()
        # Sphere and facets touch within 3.3 degrees of the normal.
        assert contacts.force_N[0] @ normal[marker] == pytest.approx(-force, rel=2e-3)
        assert felt.pressed.uv[0] == pytest.approx(rig.sensor.markers.uv[marker], abs=0.1)
        assert felt.elsewhere_N == 0.0
        (one,) = message["contacts"]
        assert marker in one["markers"]
        at = felt.sensor.surface.point(uv[marker : marker + 1])[0]
        assert np.linalg.norm(np.array(one["position_mm"]) - at) < 4.0
        assert abs(one["force_N"] - force) < 3.0 * one["sd_N"]
        errors.append(one["force_N"] / force - 1.0)
    assert np.abs(errors).max() < 0.25
    assert message["timestamp_s"] == pytest.approx(rig.data.time)


def test_the_same_seed_gives_the_same_noise(rig: Any, felt: PhytacMujoco) -> None:
    rig.press(rig.sensor.markers.uv[12], 10.0, 4.0)
    readings = []
    for seed in (1, 1, 2):
        felt.reset(seed)
        readings.append(felt.read().forces_N)
    assert np.array_equal(readings[0], readings[1])
    assert not np.array_equal(readings[0], readings[2])


def test_a_step_ends_at_the_next_frame(rig: Any, felt: PhytacMujoco) -> None:
    rig.press(rig.sensor.markers.uv[12], 10.0, 4.0)
    start_s, rate_Hz = float(rig.data.time), design().camera.frame_rate_Hz
    readings = [felt.step() for _ in range(2)]
    assert felt.steps_per_frame == round(1000.0 / rate_Hz)
    assert rig.data.time - start_s == pytest.approx(2.0 / rate_Hz, abs=1e-3)
    # Noise of two frames, one contact.
    assert not np.array_equal(readings[0].forces_N, readings[1].forces_N)


def test_what_presses_on_a_rim_is_not_felt(rig: Any, felt: PhytacMujoco) -> None:
    rig.press(np.array([12.0, 0.0]), 5.0, 4.0)
    felt.read()
    assert len(felt.pressed.force_N) == 1
    rig.data.mocap_pos[0][2] = 1e-3 * 2.0  # the near rim is 4 mm long
    rig.data.qfrc_applied[0] = -5.0
    import mujoco

    mujoco.mj_step(rig.model, rig.data, nstep=250)
    felt.reset()
    reading = felt.read()
    assert felt.elsewhere_N == pytest.approx(5.0, rel=0.02)
    assert len(felt.pressed.force_N) == 0
    assert not reading.forces_N.any()


def test_points_of_one_geom_are_one_patch(
    felt: PhytacMujoco, monkeypatch: pytest.MonkeyPatch
) -> None:
    from phytac_design.workflows.mujoco_sensor import GeomContacts

    surface = felt.sensor.surface
    uv = np.array([[11.0, 1.0], [13.0, 1.0], [12.0, 4.0], [11.5, 1.0]])
    given = GeomContacts(
        point_mm=surface.point(uv),
        force_N=-np.array([[2.0], [2.0], [1.0], [3.0]]) * surface.normal(uv),
        other=np.array([7, 7, 7, 8]),
    )
    monkeypatch.setattr(felt, "contacts", lambda: given)
    felt._radius_mm = lambda _: 4.0
    felt.read()
    patches: Indentations = felt.pressed
    assert sorted(patches.force_N.tolist()) == pytest.approx([1.0, 3.0, 4.0])
    strongest = int(np.argmax(patches.force_N))
    assert patches.uv[strongest] == pytest.approx([12.0, 1.0])
    # Second moment of a disc, a quarter of the square, and of two points 1 mm from the middle,
    # one half in the mean of both directions.
    assert patches.radius_mm[strongest] ** 2 / 4.0 == pytest.approx(16.0 / 4.0 + 0.5)


def test_what_does_not_fit_is_refused(rig: Any, bundle: Bundle, sensor: VirtualSensor) -> None:
    given = {"design": design(), "bundle": bundle, "sensor": sensor}
    with refused("body-unknown") as found:
        PhytacMujoco(rig.model, rig.data, **given)
    assert "palm/base" in str(found.value)
    with refused("patch-pressure-unknown"):
        PhytacMujoco(rig.model, rig.data, body="palm/base", indenter="cone", **given)
    with refused("decoder-of-other-design"):
        PhytacMujoco(rig.model, rig.data, body="palm/base", **given | {"design": tiny()})


def test_the_guide_runs(
    mujoco: Any,
    bundle: Bundle,
    sensor: VirtualSensor,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    guide = Path(__file__).parents[2] / "docs" / "guides" / "simulators.md"
    attach, run = (part.partition("```")[0] for part in guide.read_text().split("```python\n")[1:])
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(to_toml(design()), encoding="utf-8")
    Path("robot.xml").write_text('<mujoco><worldbody><body name="hand"/></worldbody></mujoco>')
    save_bundle(bundle, Path("exports/mine/decoder"))
    stamp_bundle(Path("exports/mine/decoder"), design=bundle.design, design_hash=bundle.design_hash)
    export_simulator(design(), Path("mine-mjcf"), to="mjcf", progress=lambda _: None)
    Path("mine-mjcf/small.xml").rename("mine-mjcf/mine.xml")
    asked: dict[str, Any] = {}

    def made(_: Design, **given: Any) -> VirtualSensor:
        asked.update(given)
        return sensor

    monkeypatch.setattr(mujoco_sensor, "virtual_sensor", made)
    names: dict[str, Any] = {}
    exec(attach + run, names)  # noqa: S102 - our own guide
    assert (asked["unit"], asked["accuracy"]) == (1, "standard")
    assert names["frame"]["type"] == "frame"
    assert names["frame"]["sequence"] == 31
    assert len(names["truth"].force_N) == 0


def test_without_mujoco_the_error_names_the_extra(
    bundle: Bundle, sensor: VirtualSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with refused("missing-library") as found:
        PhytacMujoco(None, None, design=design(), bundle=bundle, sensor=sensor)
    assert "phytac-design[simulators]" in str(found.value)
