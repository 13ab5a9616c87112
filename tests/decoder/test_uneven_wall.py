"""Thickness of a print's wall, found from the motion of markers under known contacts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.layout.cameras import Readers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance, thickness_factor
from phytac_design.simulation.solver import Solver
from phytac_design.training import uneven_wall
from phytac_design.training.marker_gain import KnownContacts, PredictionResiduals
from phytac_design.training.uneven_wall import UnevenWall, WallThickness
from phytac_shapes.arrays import FloatArray, IntArray
from tests.designs import small

SENSOR = Sensor(small())
DESIGN, SURFACE, MARKERS = SENSOR.design, SENSOR.surface, SENSOR.markers
SEE = ImageResponse(
    Readers(cameras=SENSOR.cameras, read_by=np.zeros(MARKERS.count, dtype=np.int64)),
    MARKERS.mid_mm,
    MARKERS.tip_mm - MARKERS.mid_mm,
)
RADIUS_mm, FORCE_N, NOISE_px = 5.0, 8.0, 0.01
SAMPLES = 40


def shell_of(model: ShellModel) -> DiscResponse:
    return DiscResponse(DESIGN, SURFACE, MARKERS, mesh=mesh(), model=model, orders=1)


@cache
def mesh() -> ShellMesh:
    return marker_mesh(SURFACE, MARKERS, thickness_mm=DESIGN.wall.thickness_mm, refine=2)


@cache
def wall() -> UnevenWall:
    return UnevenWall(shell_of(sensor_model(DESIGN, MARKERS, mesh(), receptors=True)), SEE)


def print_model(factor: FloatArray) -> ShellModel:
    """The shell with another thickness of each element."""
    model = wall().shell.model
    return clamped_model(
        mesh(),
        thickness_mm=model.thickness_mm * factor,
        modulus_MPa=model.modulus_MPa,
        poisson=model.poisson,
    )


@cache
def touches() -> Contacts:
    """One contact a sample, and two in every other one, anywhere."""
    rng = np.random.default_rng(3)
    sample = np.sort(np.concatenate([np.arange(SAMPLES), np.arange(0, SAMPLES, 2)]))
    low, high = SURFACE.domain.T
    count = len(sample)
    inside = low + (high - low) * (0.1 + 0.8 * rng.random((count, 2)))
    return Contacts.flat(
        sample=sample,
        uv=inside,
        radius_mm=rng.uniform(3.0, 6.0, count),
        force_N=np.full(count, FORCE_N),
        samples=SAMPLES,
    )


def shifts(solver: Solver) -> FloatArray:
    """Linear shifts (s, n, 2) px of all samples."""
    out = np.zeros((SAMPLES, MARKERS.count, 2))
    for number in range(SAMPLES):
        some = touches().of(number)
        motion = solver.solve(some, some.force_N).motion
        assert motion is not None
        out[number] = SEE.shift(motion, linear=True)
    return out


def solver_of(instance: SensorInstance) -> Solver:
    # Not the mesh of the wall that is fitted.
    return Solver(DESIGN, SURFACE, instance, refine=3, displacement="linear", extrapolate=False)


def instance_of(share: float) -> SensorInstance:
    """A print whose thickness alone varies, as two waves."""
    designed = draw_sensor_instance(SENSOR, SensorInstanceSection(), 0)
    waves = np.array([[share, 1.0, 1.0, 0.4], [share, 0.5, 2.0, 2.0]])
    return replace(designed, wall=replace(designed.wall, waves=waves))


@cache
def compared(share: float) -> tuple[PredictionResiduals, KnownContacts]:
    """Samples of a print against the tables of the design."""
    rng = np.random.default_rng(4)
    even = shifts(solver_of(instance_of(0.0)))
    noise = NOISE_px * rng.standard_normal(even.shape)
    seen = PredictionResiduals(
        predicted_px=even,
        residual_px=shifts(solver_of(instance_of(share))) - even + noise,
        on=np.zeros(even.shape[:2], dtype=np.bool_),
    )
    count = len(touches().sample)
    known = KnownContacts(
        row=touches().sample,
        touch=np.arange(count),
        point_mm=SURFACE.point(touches().uv),
        linear_N=touches().force_N,
    )
    return seen, known


def fitted_to(
    seen: PredictionResiduals, known: KnownContacts, block: IntArray | None = None
) -> WallThickness | None:
    return wall().fit(
        seen,
        known,
        touches().table(SURFACE),
        np.arange(SAMPLES) if block is None else block,
        stiffness=1.0,
        radius_mm=RADIUS_mm,
        rest_px=NOISE_px,
    )


def fitted(share: float) -> WallThickness | None:
    return fitted_to(*compared(share))


def true_factor() -> FloatArray:
    """Thickness of each element of the uneven print."""
    centre = mesh().nodes_mm[mesh().quads].mean(axis=1)
    return thickness_factor(instance_of(0.04).wall, SURFACE.chart(centre))


def test_thickness_is_found() -> None:
    found, true = fitted(0.04), true_factor()
    assert found is not None
    assert np.corrcoef(found.factor, true)[0, 1] > 0.9
    off = found.factor / found.factor.mean() - true / true.mean()
    assert off.std() < 0.45 * true.std()
    assert found.explained > 0.01
    assert found.facts["thinnest"] == pytest.approx(true.min(), abs=0.03)
    assert found.facts["thickest"] == pytest.approx(true.max(), abs=0.03)


def test_an_even_wall_stays_even() -> None:
    found = fitted(0.0)
    assert found is None or found.factor.std() < 0.005


def test_samples_that_contradict_each_other_show_nothing() -> None:
    """Shifts of one sample that belong to another's contacts."""
    seen, known = compared(0.04)
    mixed = replace(seen, residual_px=np.roll(seen.residual_px, 7, axis=0))
    assert fitted_to(mixed, known) is None


def test_markers_whose_switch_is_on_do_not_count() -> None:
    """Their red tip covers paint, as far as the load goes."""
    seen, known = compared(0.04)
    near = np.zeros(seen.on.shape, dtype=np.bool_)
    near[:, 5:9] = True
    residual = np.where(near[:, :, None], 30.0, seen.residual_px)
    found = [
        fitted_to(replace(seen, residual_px=pixels, on=near), known)
        for pixels in (residual, seen.residual_px)
    ]
    assert found[0] is not None
    assert found[1] is not None
    np.testing.assert_array_equal(found[0].factor, found[1].factor)


def test_markers_that_were_never_found_show_nothing() -> None:
    seen, known = compared(0.04)
    dark = replace(seen, residual_px=np.full_like(seen.residual_px, np.nan))
    assert fitted_to(dark, known) is None


def test_an_unknown_radius_is_the_usual_one() -> None:
    _, known = compared(0.04)
    table, rows = touches().table(SURFACE), np.arange(4)
    unknown = replace(table, radius_mm=np.zeros_like(table.radius_mm))
    usual = replace(table, radius_mm=np.full_like(table.radius_mm, RADIUS_mm))
    loads = [wall()._load(known, one, rows, RADIUS_mm) for one in (table, unknown, usual)]
    np.testing.assert_array_equal(loads[1], loads[2])
    assert not np.array_equal(loads[0], loads[1])


def test_a_wall_keeps_half_of_its_thickness(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uneven_wall, "SETTINGS", replace(uneven_wall.SETTINGS, factor_min=0.97))
    found = fitted(0.04)
    assert found is not None
    assert found.factor.min() == 0.97


def test_samples_of_one_press_are_held_out_together() -> None:
    """One block cannot be predicted by others, of which there are none."""
    assert fitted_to(*compared(0.04), block=np.zeros(SAMPLES, dtype=np.int64)) is None


def test_slopes_are_those_of_a_shell_that_is_a_little_thicker() -> None:
    _, known = compared(0.04)
    rows = np.arange(3)
    load = wall()._load(known, touches().table(SURFACE), rows, RADIUS_mm)
    slopes = wall()._slopes(load)
    mode, step = slopes.shape[0] - 1, 1e-3
    kinematics = wall().shell.kinematics
    ends = []
    for sign in (-1.0, 1.0):
        model = print_model(1.0 + sign * step * wall()._modes[:, mode])
        motion = model.solve(load).motion.reshape(load.shape)
        ends.append([SEE.powers([kinematics.linear(m)], np.zeros(0))[0] for m in motion.T])
    expected = (np.array(ends[1]) - np.array(ends[0])) / (2.0 * step)
    np.testing.assert_allclose(slopes[mode], expected, atol=2e-3 * np.abs(expected).max())


def tables() -> ResponseTable:
    """The design's tables, of linear theory with another mesh's factor, and a made-up square."""
    point = SURFACE.point(MARKERS.uv)
    along, around = tangent_frame(SURFACE, MARKERS.uv)
    shell = wall().shell
    first = np.array(
        [SEE.powers(one, np.zeros(0))[0] for one in shell.motions(MARKERS.uv, RADIUS_mm)]
    )
    shear = np.array(
        [
            [SEE.powers([one], np.zeros(0))[0] for one in both]
            for both in shell.sheared(MARKERS.uv, RADIUS_mm)
        ]
    )
    rows = np.stack([1.02 * first, 0.01 * first], axis=1).astype(np.float32)
    plain = ResponseTable(
        point_mm=point, along=along, around=around, shift_px=rows, radius_mm=RADIUS_mm
    )
    return replace(plain, shear=replace(plain, shift_px=(1.02 * shear).astype(np.float32)))


def test_tables_are_those_of_the_print() -> None:
    true = true_factor()
    thickness = WallThickness(factor=true, common=1.0, explained=1.0)
    before, after = tables(), wall().table(tables(), thickness)
    shell = shell_of(print_model(true))
    exact = np.array(
        [SEE.powers(one, np.zeros(0))[0] for one in shell.motions(MARKERS.uv, RADIUS_mm)]
    )
    change = np.linalg.norm(before.shift_px[:, 0] - 1.02 * exact)
    assert np.linalg.norm(after.shift_px[:, 0] - 1.02 * exact) < 0.02 * change
    # Places at which the first power grows by r have r² times the square.
    ratio = np.einsum("pn,pn->p", after.shift_px[:, 0], before.shift_px[:, 0])
    ratio /= np.einsum("pn,pn->p", before.shift_px[:, 0], before.shift_px[:, 0])
    expected = ratio[:, None] ** 2 * before.shift_px[:, 1]
    np.testing.assert_allclose(after.shift_px[:, 1], expected, rtol=1e-4, atol=1e-7)
    assert after.shear is not None
    assert before.shear is not None
    dragged = np.array(
        [
            [SEE.powers([one], np.zeros(0))[0] for one in both]
            for both in shell.sheared(MARKERS.uv, RADIUS_mm)
        ]
    )
    change = np.linalg.norm(before.shear.shift_px - 1.02 * dragged)
    assert np.linalg.norm(after.shear.shift_px - 1.02 * dragged) < 0.05 * change


def test_tables_without_force_along_the_surface_have_none_afterwards() -> None:
    thickness = WallThickness(factor=true_factor(), common=1.0, explained=1.0)
    assert wall().table(replace(tables(), shear=None), thickness).shear is None


def test_the_most_samples_are_kept_to(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fitted(0.04)
    assert whole is not None
    monkeypatch.setattr(uneven_wall, "SETTINGS", replace(uneven_wall.SETTINGS, samples_max=10))
    few = fitted(0.04)
    assert few is not None
    assert not np.array_equal(few.factor, whole.factor)


def test_a_shell_that_is_too_large_is_taken_as_even() -> None:
    model = wall().shell.model
    most = uneven_wall.SETTINGS.numbers_max // (2 * model.fixed.size)
    assert UnevenWall.fits_in_memory(model, most)
    assert not UnevenWall.fits_in_memory(model, most + 1)
