"""The paper's 598 samples as inputs and outputs of its network: how large, how exact."""

from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.datasets.samples import (
    DataSetInfo,
    Samples,
    TouchRows,
    inputs_alone,
    key_nodes,
    truth_rows,
)
from phytac_design.datasets.samples_file import read_samples, write_samples
from phytac_design.design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts, draw_contacts, switch_states
from phytac_design.simulation.dataset import Dataset, key_node_data
from phytac_shapes.arrays import FloatArray

FORCE_STEP_N = 2.0**-10

NOISE_PX = 0.04
META = DataSetInfo(
    simulated=True, what="A test.", design="c", design_hash="0", route="points", seed=0
)
Made = tuple[Samples, ForceModel, Contacts, Markers]


def model_of(markers: Markers, points_mm: FloatArray) -> ForceModel:
    """A shell that dents like a bell 6 mm wide, before a camera at the near rim.

    Softness, resolution (0.03 to 0.15 mm/px) and so the noise of u are those of cylinder60.
    """
    away = np.linalg.norm(points_mm[:, None] - points_mm[None], axis=2)
    compliance = 0.02 * np.exp(-0.5 * (away / 6.0) ** 2)
    turn = np.arctan2(points_mm[:, 1], points_mm[:, 0])
    per_px = np.interp(points_mm[:, 2], [0.0, 120.0], [0.033, 0.15])
    toward = -np.column_stack([np.cos(turn), np.sin(turn)])
    compliance_px = (toward / per_px[:, None])[:, :, None] * compliance[:, None]
    return ForceModel(
        shift_to_mm=toward * per_px[:, None],
        stiffness=np.linalg.inv(compliance + 1e-3 * np.eye(len(away))),
        compliance_px=compliance_px.reshape(-1, len(away)),
        height_z_mm=markers.mid_mm[:, 2].copy(),
        neighbours=markers.neighbours,
        networks={},
    )


@pytest.fixture(scope="module", params=["as trained", "large patches"])
def made(request: pytest.FixtureRequest) -> Made:
    design = load_design("cylinder60")
    if request.param == "large patches":
        training = design.training.model_copy(
            update={"patch_radius_min_mm": 7.0, "patch_radius_max_mm": 9.0}
        )
        design = design.model_copy(update={"training": training})
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(0)
    contacts = draw_contacts(Sensor.of(design, surface, markers), samples=598, rng=rng)
    switching = switch_states(Sensor.of(design, surface, markers), contacts)
    model = model_of(markers, surface.point(markers.uv))
    shift = (switching.receptor_force_N @ model.compliance_px.T).reshape(598, -1, 2)
    shift += rng.normal(0.0, NOISE_PX, shift.shape)
    count = len(contacts.force_N)
    samples = Samples(
        markers=markers.count,
        # The worst to pack: every time and light another.
        time_s=np.cumsum(rng.uniform(1.0, 2.0, 598)),
        sequence=np.arange(598),
        light=1.0 - 0.01 * rng.random(598),
        status=np.zeros(598, dtype=np.int64),
        theory=rng.integers(1, 3, 598),
        total_N=np.bincount(contacts.sample, weights=contacts.force_N, minlength=598),
        contacts=contacts.counts,
        bits=switching.bits,
        bits_read=switching.bits,
        shift_px=shift,
        touches=TouchRows(
            sample=contacts.sample,
            uv=contacts.uv,
            point_mm=surface.point(contacts.uv),
            radius_mm=contacts.radius_mm,
            force_N=contacts.force_N,
            indenter=np.zeros(count, dtype=np.int64),
            length_mm=np.zeros(count),
            turn_rad=np.zeros(count),
            friction=np.zeros((count, 2)),
        ),
        truth=truth_rows(switching.bits, switching.owner, switching.receptor_force_N),
    )
    rows = key_nodes(model, samples, noise_px=NOISE_PX)
    expected = key_node_data(model, Dataset(contacts=contacts, switching=switching, shift_px=shift))
    np.testing.assert_allclose(rows.inputs_mm, expected.features, rtol=0.0, atol=1e-12)
    based = key_nodes(model, samples, noise_px=NOISE_PX, base="key_nodes")
    np.testing.assert_allclose(based.stiffness_force_N, expected.stiffness_force_N, atol=1e-9)
    np.testing.assert_allclose(rows.force_N, expected.force_N)
    return inputs_alone(samples, rows), model, contacts, markers


def test_it_takes_at_most_64_kilobytes(made: Made, tmp_path: Path) -> None:
    samples, _, contacts, _ = made
    rows = samples.key_nodes
    assert rows is not None
    per_sample, per_contact = len(contacts.force_N) / 598, len(rows.force_N) / len(contacts.force_N)
    assert per_sample > 2.0
    assert per_contact > 1.0
    write_samples(tmp_path, samples, META)
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert size <= 64 * 1024, f"{size} bytes for {len(rows.force_N)} rows"


def test_rounding_is_below_a_tenth_of_the_noise(made: Made, tmp_path: Path) -> None:
    samples, model, _, markers = made
    write_samples(tmp_path, samples, META)
    got, rows = read_samples(tmp_path)[0].key_nodes, samples.key_nodes
    assert rows is not None
    assert got is not None
    noise = NOISE_PX * np.append(np.linalg.norm(model.shift_to_mm, axis=1), np.inf)
    # Each input against its own marker's noise; beyond a rim there is neither.
    own = noise[np.column_stack([rows.marker, markers.neighbours[rows.marker]])]
    assert np.abs((got.u_mm - rows.u_mm) / own).max() < 0.1
    np.testing.assert_array_equal(got.inputs_mm[:, 9], rows.inputs_mm[:, 9])
    least = NOISE_PX * model.stiffness_noise_N_px[rows.marker]
    assert np.abs((got.stiffness_force_N - rows.stiffness_force_N) / least).max() < 0.1
    assert np.abs(got.force_N - rows.force_N).max() <= FORCE_STEP_N / 2
    # And it is rounded at all: the step is the largest power of two that keeps to this.
    assert np.abs((got.u_mm - rows.u_mm) / own).max() > 0.025
