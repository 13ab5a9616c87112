"""Draws of the simulation: within range, spread as said, the same for the same seed."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.datasets.samples import STATUSES
from phytac_design.datasets.samples_file import read_samples
from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import draw_contacts, switch_states
from phytac_design.simulation.linear_response import motion_responses, superpose
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.instance_scatter import (
    draw_sensor_instance,
)
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection, parse_scenario
from phytac_design.simulation.sensor_instance import thickness_factor
from phytac_design.stages.build import copy_of
from phytac_design.workflows.simulate import simulate
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import SHAPES, design_of, numbers_of
from verification.faces import face_of

CUT_SD = 3.0

UNLIKELY = 1e-6
"""Probability that a correct draw fails a test of its spread."""


def check_contacts(values: Mapping[str, Any], found: Evidence) -> None:
    """Places on the face, forces and radii in range and evenly spread, shares that sum up."""
    from scipy.stats import kstest

    design = design_of(values)
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(5)
    kinds = {"samples": 300, "placement": values["placement"]}
    contacts = draw_contacts(Sensor.of(design, surface, markers), rng=rng, **kinds)
    again = draw_contacts(
        Sensor.of(design, surface, markers), rng=np.random.default_rng(5), **kinds
    )
    found.true("the same for the same seed", np.array_equal(contacts.uv, again.uv))
    t = design.training
    found.true("every sample has a contact", contacts.counts >= 1)
    found.true(
        "forces in range", (contacts.force_N >= t.force_min_N) & (contacts.force_N <= t.force_max_N)
    )
    found.true(
        "radii in range",
        (contacts.radius_mm >= t.patch_radius_min_mm)
        & (contacts.radius_mm <= t.patch_radius_max_mm),
    )
    span = t.force_max_N - t.force_min_N
    chance = kstest((contacts.force_N - t.force_min_N) / span, "uniform").pvalue
    found.true(
        f"forces are even (Kolmogorov and Smirnov, chance {chance:.2g})",
        chance > UNLIKELY,
        kind="reference",
    )
    low, high = surface.domain.T
    slack = 1e-9 * (high - low)
    inside = (contacts.uv >= low - slack) & (contacts.uv <= high + slack)
    found.true("centres within the open edges", inside | np.array(surface.periodic))
    table = numbers_of(surface)
    known = face_of(surface.name, table)
    point = surface.point(contacts.uv)
    if known.gap is not None:
        size = float(np.ptp(point, axis=0).max())
        found.add("centres on the face's equation", known.gap(point) / max(size, 1.0), 1e-9)
    _apart(design, contacts, point, found)
    _shares(design, surface, markers, contacts, found)


def _apart(design: Any, contacts: Any, point: Any, found: Evidence) -> None:
    """Contacts of one sample do not overlap."""
    first, second = np.triu_indices(len(point), 1)
    same = contacts.sample[first] == contacts.sample[second]
    first, second = first[same], second[same]
    gap = np.linalg.norm(point[first] - point[second], axis=1)
    need = contacts.radius_mm[first] + contacts.radius_mm[second]
    need = need + design.switch.footprint_diameter_mm
    found.true("contacts of a sample keep apart", gap > need)


def _shares(design: Any, surface: Any, markers: Any, contacts: Any, found: Evidence) -> None:
    """Forces on receptors sum to those of the contacts that tripped any."""
    state = switch_states(Sensor.of(design, surface, markers), contacts)
    total = np.bincount(
        contacts.sample, weights=contacts.force_N * state.tripped, minlength=contacts.samples
    )
    found.close(
        "receptors' forces sum to the contacts'",
        state.receptor_force_N.sum(axis=1),
        total,
        1e-12,
        kind="balance",
    )
    found.true(
        "only switches that are on carry force", (state.receptor_force_N == 0.0) | state.bits
    )


def check_unit(values: Mapping[str, Any], found: Evidence) -> None:
    """A print differs from its design by at most its tolerances."""
    design = design_of(values)
    surface = design.surface()
    markers = make_markers(design, surface)
    section = SensorInstanceSection.model_validate(values["unit"])
    unit = draw_sensor_instance(Sensor.of(design, surface, markers), section, values["seed"])
    again = draw_sensor_instance(Sensor.of(design, surface, markers), section, values["seed"])
    found.true("the same for the same seed", np.array_equal(unit.on_N, again.on_N))
    nominal = section.number == 0
    off = abs(unit.modulus - 1.0)
    found.add(
        "modulus within its cut scatter",
        max(off - (0.0 if nominal else CUT_SD * section.modulus_share), 0.0),
        1e-12,
    )
    threshold = np.full(markers.count, design.switch.threshold_N)
    off = np.abs(unit.on_N / threshold - 1.0).max()
    found.add(
        "thresholds within their cut scatter",
        max(off - (0.0 if nominal else CUT_SD * section.threshold_share), 0.0),
        1e-12,
    )
    found.true("switches release no later than they trip", unit.off_N <= unit.on_N)
    moved = np.linalg.norm(unit.markers.mid_mm - markers.mid_mm, axis=1).max()
    # A step in the tangent plane is brought back to the face: shorter on convex ones.
    most = 0.0 if nominal else np.sqrt(2.0) * CUT_SD * section.marker_mm * 1.05
    found.add("markers within their cut scatter, mm", max(moved - most, 0.0), 1e-9)
    found.true("receptors keep a height", unit.markers.height_mm > 0.0)
    rng = np.random.default_rng(0)
    low, high = surface.domain.T
    wall = thickness_factor(unit.wall, rng.uniform(low, high, (500, 2)))
    found.true("the wall stays a wall", (wall > 0.0) & np.isfinite(wall))
    for camera in unit.cameras:
        turn = camera.rotation @ camera.rotation.T - np.eye(3)
        found.add("cameras are turned, not bent", turn, 1e-12)


def check_response(values: Mapping[str, Any], found: Evidence) -> None:
    """Responses by adjoints, turned from one column, against each contact solved by itself."""
    from phytac_design.mechanics.meshing.mesh import plain_mesh
    from phytac_design.mechanics.shell.compliance import probe_motion
    from phytac_design.mechanics.shell.loads import patch_loads
    from phytac_design.mechanics.shell.solve import clamped_model

    design = design_of(values)
    surface = design.surface()
    markers = make_markers(design, surface)
    section = design.material
    mesh = plain_mesh(surface, thickness_mm=design.wall.thickness_mm, size_mm=4.0)
    model = clamped_model(mesh, modulus_MPa=section.modulus_MPa, poisson=section.poisson)
    contacts = draw_contacts(
        Sensor.of(design, surface, markers), samples=200, rng=np.random.default_rng(1)
    )
    many = motion_responses(
        model, mesh, surface, markers, uv=contacts.uv, radius_mm=contacts.radius_mm
    )
    few = np.arange(5)
    loads = patch_loads(mesh, surface, contacts.uv[few], contacts.radius_mm[few])
    solution = model.solve(loads)
    direct = np.moveaxis(probe_motion(mesh, solution, markers.uv), 2, 0)
    found.close(
        "each contact solved by itself",
        many[few],
        direct,
        max(1e-9, 10.0 * solution.error),
        kind="symmetry",
    )
    whole = superpose(many, contacts)
    last = contacts.sample == contacts.samples - 1
    one = np.einsum("c,cnd->nd", contacts.force_N[last], many[last])
    found.close("a sample is the sum of its contacts", whole[-1], one, 1e-12, kind="balance")
    narrow = np.einsum(
        "c,cnd->nd", contacts.force_N[last].astype(np.float32), many[last].astype(np.float32)
    )
    spread = np.einsum("c,cnd->nd", contacts.force_N[last], np.abs(many[last])).max()
    found.add(
        "motion in single precision, of its terms",
        np.abs(narrow - one).max() / spread,
        8.0 * float(np.finfo(np.float32).eps),
        kind="float32",
    )


def check_sample(values: Mapping[str, Any], found: Evidence) -> None:
    """One sample of contacts given by hand, simulated: finite, or flagged with the reason."""
    data = {"name": "extreme", "touch": {"samples": 1, "at": values["at"]}}
    # A small sensor, a coarse camera, few points a pixel: nothing depends on how well it is seen.
    solve = {"displacement": "auto", "samples_per_pixel": 8}
    scenario = parse_scenario(data | {"solve": solve}, "extreme")
    small = {
        "shape": {"length_mm": 60.0},
        "layout": {"rows": 8, "columns": 16, "height_far_mm": 6.0},
        "camera": {"width_px": 648, "height_px": 486, "focal_px": 242.5},
    }
    design = copy_of(load_design("cylinder60"), **small)
    job = Job(design=design, scenario=scenario, seed=11, accuracy="draft")
    with tempfile.TemporaryDirectory() as folder:
        simulate(job, Path(folder) / "data", workers=0, progress=lambda _: None)
        samples, _ = read_samples(Path(folder) / "data")
    ok = STATUSES[int(samples.status[0])] == "ok"
    finite = samples.shift_px is not None and np.isfinite(samples.shift_px[0]).all()
    found.true("finite, or flagged with the reason", finite if ok else bool(samples.why(0)))


def press(along: float, around: float, force: float, radius: float = 5.0) -> dict[str, float]:
    """One contact by shares of the chart."""
    return {"along": along, "around": around, "force_N": force, "radius_mm": radius}


SAMPLES = {
    "0.05 N": [press(0.5, 0.3, 0.05)],
    "60 N": [press(0.5, 0.3, 60.0)],
    "on the near rim": [press(0.0, 0.3, 10.0)],
    "on the far rim": [press(1.0, 0.3, 10.0)],
    "on the seam": [press(0.5, 0.0, 10.0)],
    "between two receptors": [press(0.5, 0.28125, 10.0, 1.5)],
    "two dozen at once": [press(a / 5, b / 6, 8.0) for a in range(1, 5) for b in range(6)],
    "a patch larger than the sensor": [press(0.5, 0.3, 20.0, 500.0)],
    "a point": [press(0.5, 0.3, 5.0, 1e-3)],
    "no contact": [],
    "no force": [press(0.5, 0.3, 0.0)],
}


def cases() -> Cases:
    """Contacts and prints of every family: minimum and maximum forces, radii, scatter."""
    out = Cases()
    large = {
        "threshold_share": 0.3,
        "modulus_share": 0.3,
        "marker_mm": 0.5,
        "height_mm": 0.3,
        "camera_mm": 1.0,
        "camera_deg": 2.0,
        "focal_share": 0.02,
        "thickness_share": 0.15,
        "thickness_wave_share": 0.1,
        "paint_share": 0.2,
    }
    trainings: dict[str, dict[str, Any]] = {
        "forces of a micronewton apart": {"force_min_N": 24.999999, "force_max_N": 25.0},
        "patches of a micrometre": {"patch_radius_min_mm": 1e-3, "patch_radius_max_mm": 1e-3},
        "patches as large as the sensor": {
            "patch_radius_min_mm": 15.0,
            "patch_radius_max_mm": 16.0,
        },
        "always several": {"multi_contact": 1.0},
    }
    prints: tuple[tuple[str, Expect, dict[str, Any], int], ...] = (
        ("print number 0", "right", {"number": 0}, 1),
        ("print number 3", "right", {"number": 3}, 2),
        ("print of large scatter", "either", {"number": 5, **large}, 3),
        ("print of a seed of 2³¹ − 1", "right", {"number": 1}, 2**31 - 1),
    )
    for shape in SHAPES:
        for where in ("receptor", "anywhere"):
            out.add_design(shape, f"contacts {where}", check_contacts, {}, placement=where)
        for name, training in trainings.items():
            changes: dict[str, Any] = {"training": training}
            out.add_design(shape, name, check_contacts, changes, placement="anywhere")
        one = {"layout": {"kind": "straight", "rows": 1, "columns": 1}}
        out.add_design(shape, "one marker", check_contacts, one, placement="receptor")
        for name, expect, unit, seed in prints:
            out.add_design(shape, name, check_unit, {}, expect, unit=unit, seed=seed)
        out.add_design(shape, "responses", check_response, {})
    for name, at in SAMPLES.items():
        out.add(f"sample: {name}", check_sample, "either", at=at)
    return out


CASES = cases()


@CASES.parametrize
def test_simulation(case: Case, record_property: Recorder) -> None:
    """Contacts, prints and responses of the simulation."""
    verify(case, record_property)
