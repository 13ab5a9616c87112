"""Contacts, the activation law, adjoint responses, condensation and scores."""

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.compliance import marker_compliance, probe_motion
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.simulation import linear_response as response_module
from phytac_design.simulation.condense import condense
from phytac_design.simulation.contacts import Contacts, draw_contacts, switch_states
from phytac_design.simulation.dataset import Dataset, decode_points, key_node_data
from phytac_design.simulation.force_errors import contact_forces, force_score
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import (
    motion_responses,
    point_motions,
    rigid_slope,
    superpose,
)
from phytac_design.stages.build import copy_of
from tests.designs import small

DESIGN = small()
SURFACE = DESIGN.surface()
MARKERS = make_markers(DESIGN, SURFACE)


def contacts_at(uv: np.ndarray, force: list[float], sample: list[int], radius: float) -> Contacts:
    return Contacts.flat(
        sample=np.array(sample),
        uv=uv,
        radius_mm=np.full(len(uv), radius),
        force_N=np.array(force),
        samples=max(sample) + 1,
    )


@pytest.mark.parametrize("placement", ["receptor", "anywhere"])
def test_drawn_contacts_keep_their_ranges_and_apart(placement: str) -> None:
    rng = np.random.default_rng(0)
    drawn = draw_contacts(
        Sensor.of(DESIGN, SURFACE, MARKERS), samples=200, rng=rng, placement=placement
    )
    limits = DESIGN.training
    assert set(drawn.sample) == set(range(200))
    assert (drawn.force_N >= limits.force_min_N).all()
    assert (drawn.force_N <= limits.force_max_N).all()
    assert drawn.counts.min() == 1
    assert 2 < drawn.counts.max() <= 5
    multi = float((drawn.counts > 1).mean())
    assert multi == pytest.approx(limits.multi_contact, abs=0.12)
    point = SURFACE.point(drawn.uv)
    for sample in np.flatnonzero(drawn.counts > 1):
        mine = np.flatnonzero(drawn.sample == sample)
        for i in mine:
            for j in mine[mine > i]:
                gap = np.linalg.norm(point[i] - point[j])
                assert gap > max(drawn.radius_mm[i], drawn.radius_mm[j])


def test_drawing_is_deterministic() -> None:
    a, b = (
        draw_contacts(Sensor.of(DESIGN, SURFACE, MARKERS), samples=20, rng=np.random.default_rng(4))
        for _ in range(2)
    )
    assert (a.uv == b.uv).all()
    assert (a.force_N == b.force_N).all()


def test_switches_follow_the_activation_law() -> None:
    # A patch larger than the footprint: the footprint carries force · (area ratio).
    foot, radius = DESIGN.switch.footprint_diameter_mm / 2, 5.0
    threshold = DESIGN.switch.threshold_N * (radius / foot) ** 2
    uv = MARKERS.uv[[33, 33]]
    contacts = contacts_at(uv, [0.98 * threshold, 1.02 * threshold], [0, 1], radius)
    state = switch_states(Sensor.of(DESIGN, SURFACE, MARKERS), contacts)
    assert state.bits[:, 33].tolist() == [False, True]
    assert state.tripped.tolist() == [False, True]
    assert state.owner[1, 33] == 1


def test_switches_of_a_region_follow_its_threshold() -> None:
    region = {"threshold_N": 2.0 * DESIGN.switch.threshold_N, "markers": [33]}
    design = copy_of(DESIGN, switch={"regions": [region]})
    foot, radius = DESIGN.switch.footprint_diameter_mm / 2, 5.0
    force = 1.5 * DESIGN.switch.threshold_N * (radius / foot) ** 2
    contacts = contacts_at(MARKERS.uv[[33]], [force], [0], radius)
    assert switch_states(Sensor.of(DESIGN, SURFACE, MARKERS), contacts).bits[0, 33]
    assert not switch_states(Sensor.of(design, SURFACE, MARKERS), contacts).bits[0, 33]


def test_receptor_truth_sums_to_the_contact() -> None:
    rng = np.random.default_rng(1)
    drawn = draw_contacts(
        Sensor.of(DESIGN, SURFACE, MARKERS), samples=60, rng=rng, placement="anywhere"
    )
    state = switch_states(Sensor.of(DESIGN, SURFACE, MARKERS), drawn)
    back = contact_forces(state.receptor_force_N, drawn, state)
    assert np.allclose(back[state.tripped], drawn.force_N[state.tripped])
    assert (back[~state.tripped] == 0).all()
    assert ((state.owner >= 0) == state.bits).all()


def test_adjoint_response_is_the_direct_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, model = truth_shell(DESIGN, SURFACE, 3)
    rng = np.random.default_rng(2)
    uv = rng.uniform(*SURFACE.domain.T, (50, 2))
    radius = rng.uniform(3.0, 8.0, 50)
    direct = probe_motion(mesh, model.solve(patch_loads(mesh, SURFACE, uv, radius)), MARKERS.uv)
    expected = np.moveaxis(direct, 2, 0)
    scale = np.abs(expected).max()

    def response(times: int = 1) -> np.ndarray:
        places, radii = np.tile(uv, (times, 1)), np.tile(radius, times)
        found = motion_responses(model, mesh, SURFACE, MARKERS, uv=places, radius_mm=radii)
        assert found.shape == (50 * times, MARKERS.count, 6)
        return found[-50:]

    # Fewer than the adjoints of one column's markers (6 x 8), then more.
    few = motion_responses(model, mesh, SURFACE, MARKERS, uv=uv[:4], radius_mm=radius[:4])
    assert np.abs(few - expected[:4]).max() < 1e-12 * scale
    solved: list[int] = []
    solve = response_module._adjoints
    monkeypatch.setattr(
        response_module, "_adjoints", lambda *given: solved.append(1) or solve(*given)
    )
    assert np.abs(response() - expected).max() < 1e-8 * scale
    # And the same without using the symmetry: 6 x 112 adjoints.
    monkeypatch.setattr(response_module, "column_turn", lambda *_: None)
    assert np.abs(response(14) - expected).max() < 1e-8 * scale
    assert len(solved) == 2


def test_tips_move_by_translation_and_rotation() -> None:
    motion = np.zeros((1, 2, 6))
    motion[0, :, :3] = [1.0, 2.0, 3.0]
    motion[0, 1, 3:] = [0.0, 0.0, 0.1]
    arm = np.array([[5.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    assert np.allclose(point_motions(motion, arm), [[[1, 2, 3], [1, 2.5, 3]]])


def small_model() -> tuple[ForceModel, np.ndarray, Camera]:
    """Decoder matrices of the small design, from tips rather than rendered paint."""
    mesh = marker_mesh(SURFACE, MARKERS, thickness_mm=DESIGN.wall.thickness_mm, refine=4)
    model = clamped_model(mesh, modulus_MPa=2200.0, poisson=0.38)
    compliance = marker_compliance(model, mesh, SURFACE, MARKERS, load_radius_mm=4.4)
    arm = MARKERS.tip_mm - MARKERS.mid_mm
    camera = Camera.on_axis(width_px=1296, height_px=972, focal_px=485, stand_off_mm=30)
    slope = rigid_slope(camera.jacobian(MARKERS.tip_mm), arm)
    parts = condense(slope, normal=MARKERS.normal, motion=compliance.motion)
    force = ForceModel(
        shift_to_mm=parts.shift_to_mm,
        stiffness=parts.stiffness,
        compliance_px=parts.compliance_px,
        height_z_mm=MARKERS.mid_mm[:, 2],
        neighbours=MARKERS.neighbours,
        networks={},
    )
    return force, arm, camera


def test_condensed_stiffness_inverts_what_the_camera_sees() -> None:
    model, _, _ = small_model()
    force = np.zeros(MARKERS.count)
    force[[12, 47]] = 4.0, 9.0
    shift = (model.compliance_px @ force).reshape(-1, 2)
    for name in ("fem", "koi_inverse"):
        got = model.forces(name, shift, np.array([12, 47]))
        assert np.allclose(got, force, atol=1e-6), name


def test_apparent_displacement_is_inward_millimetres() -> None:
    model, _, camera = small_model()
    step = -1e-4 * MARKERS.normal
    shift = camera.project(MARKERS.tip_mm + step) - camera.project(MARKERS.tip_mm)
    assert np.allclose(model.apparent_mm(shift), 1e-4, rtol=1e-4)


def test_decoding_another_mesh_is_close_but_not_exact() -> None:
    """Data of the finer mesh: not the decoder's own model, so neither nonsense nor perfect."""
    model, arm, camera = small_model()
    rng = np.random.default_rng(3)
    drawn = draw_contacts(Sensor.of(DESIGN, SURFACE, MARKERS), samples=80, rng=rng, most=3)
    mesh, shell = truth_shell(DESIGN, SURFACE, 9)
    unit = motion_responses(shell, mesh, SURFACE, MARKERS, uv=drawn.uv, radius_mm=drawn.radius_mm)
    moved = point_motions(superpose(unit, drawn), arm)
    at_rest = camera.project(MARKERS.tip_mm)
    image = camera.project((MARKERS.tip_mm + moved).reshape(-1, 3)).reshape(*moved.shape[:2], 2)
    state = switch_states(Sensor.of(DESIGN, SURFACE, MARKERS), drawn)
    data = Dataset(contacts=drawn, switching=state, shift_px=image - at_rest)
    seen = state.tripped
    estimate = contact_forces(decode_points(model, data, "koi_inverse"), drawn, state)
    result = force_score(estimate[seen], drawn.force_N[seen])
    assert 0.005 < result["relative_error"] < 0.2
    rows = key_node_data(model, data)
    assert len(rows.force_N) == state.bits.sum()
    assert np.allclose(rows.features[:, 0], rows.apparent_mm)


def test_scores_are_what_they_say() -> None:
    result = force_score(np.array([1.1, 1.8, 3.0]), np.array([1.0, 2.0, 3.0]))
    assert result["mae_N"] == pytest.approx(0.1)
    assert result["bias_N"] == pytest.approx(-0.1 / 3)
    assert result["relative_error"] == pytest.approx((0.1 + 0.1) / 3)
    assert np.isnan(force_score(np.array([]), np.array([]))["mae_N"])
