"""Tables of the estimator ``auto`` against the simulated sensor's own, finer shell."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_fit import ContactPrior, initial_state
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import Readers, cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation import interaction_tables, response_tables
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.interaction_tables import (
    InteractionSettings,
    InteractionSolver,
    image_curvature,
    pair_spacing_mm,
)
from phytac_design.simulation.linear_response import turned_points
from phytac_design.simulation.mesh_pair import MeshPair, mesh_pair
from phytac_design.simulation.pressed_series import (
    DiscResponse,
    ExtrapolatedResponse,
    ImageResponse,
    scaled_powers,
)
from phytac_design.simulation.receptor_tables import tabulate_receptors
from phytac_design.simulation.response_tables import (
    NONE,
    TabulatedResponse,
    everywhere,
    interpolate_responses,
    place_spacing_mm,
    tabulate_responses,
)
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.solver import Solver
from phytac_design.simulation.turned_places import SectorSymmetry, rings, sectors_of, symmetry_of
from phytac_design.stages.places_stage import EXTRAPOLATED_MARKERS_MAX, extrapolated_from
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError
from tests.designs import FINE_CAMERA, drawn, of_shape, small


class Bench:
    """A small sensor, and what its one camera sees."""

    def __init__(self, design: Design) -> None:
        self.design, self.surface = design, design.surface()
        self.markers = make_markers(design, self.surface)
        self.sensor = Sensor.of(design, self.surface, self.markers)
        readers = Readers(
            cameras=cameras_of(design, self.surface),
            read_by=np.zeros(self.markers.count, dtype=np.int64),
        )
        mid = self.markers.mid_mm
        self.see = ImageResponse(readers, mid, self.markers.tip_mm - mid)

    def shell(self, refine: int) -> tuple[ShellMesh, ShellModel]:
        mesh = marker_mesh(
            self.surface,
            self.markers,
            thickness_mm=self.design.wall.thickness_mm,
            refine=refine,
        )
        return mesh, sensor_model(self.design, self.markers, mesh, receptors=True)

    def discs(self, mesh: ShellMesh, model: ShellModel, orders: int = 1) -> DiscResponse:
        return DiscResponse(
            self.design, self.surface, self.markers, mesh=mesh, model=model, orders=orders
        )

    def tables(self, shell: tuple[ShellMesh, ShellModel], **how: Any) -> TabulatedResponse:
        mesh, model = shell
        return tabulate_responses(self.sensor, mesh=mesh, model=model, see=self.see, **how)


DESIGN = small(camera=FINE_CAMERA)
SPACING_mm = 3.5
"""Of the places that most tests share; at 4 mm the median of what is interpolated misses 1 %."""
BENCH = Bench(DESIGN)
SURFACE, MARKERS, SEE = BENCH.surface, BENCH.markers, BENCH.see


def made(refine: int, **how: Any) -> TabulatedResponse:
    """Tables by a mesh of its own."""
    return BENCH.tables(BENCH.shell(refine), **how)


@cache
def tabulated(
    orders: int = 3, spacing_mm: float = SPACING_mm, refine: int = 4
) -> TabulatedResponse:
    return made(refine, spacing_mm=spacing_mm, orders=orders)


def truth(place: int, places: ResponseTable, force_N: float) -> FloatArray:
    """Shifts (2n,) px of a disc there, by the simulated sensor."""
    return true_shifts(SURFACE.chart(places.point_mm[[place]]), places.radius_mm, force_N)


@cache
def solver() -> Solver:
    unit = draw_sensor_instance(Sensor.of(DESIGN, SURFACE, MARKERS), SensorInstanceSection(), 0)
    return Solver(DESIGN, SURFACE, unit, refine=6, displacement="large")


def true_shifts(
    uv: FloatArray, radius_mm: float, force_N: float, *, friction: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """Shifts (2n,) px of discs at places (c, 2) at once, each of that force."""
    count = len(uv)
    touch = Contacts.flat(
        sample=np.zeros(count, dtype=np.int64),
        uv=uv,
        radius_mm=np.full(count, radius_mm),
        force_N=np.full(count, force_N),
        samples=1,
    )
    touch = replace(touch, friction=np.tile(friction, (count, 1)))
    motion = solver().solve(touch, np.full(count, force_N)).motion
    assert motion is not None
    tips, project = MARKERS.tip_mm, SEE.readers.project
    moved = project(tips + turned_points(motion, tips - MARKERS.mid_mm))
    return np.asarray(moved - project(tips)).ravel()


def test_force_along_the_surface_moves_markers_as_the_solved_wall_does() -> None:
    """At a place between those that were solved, by a finer mesh and a small force."""
    places = tabulated().places
    assert places.shear is not None
    assert len(places.shear.point_mm) < len(places.point_mm)
    u = SURFACE.domain[0].mean()
    uv = np.array([[u, SURFACE.domain[1] @ [0.39, 0.61]]])
    plain = true_shifts(uv, places.radius_mm, 0.01)
    table = places.shear_at(SURFACE.point(uv))[0]
    for axis, friction in enumerate(((0.5, 0.0), (0.0, 0.5))):
        shifts = true_shifts(uv, places.radius_mm, 0.01, friction=friction)
        # The tables are of one mesh, the other motion is extrapolated.
        assert off(table[axis], (shifts - plain) / 0.005) < 0.1


def predicted(places: ResponseTable, place: int, force_N: float) -> FloatArray:
    powers = force_N ** np.arange(1.0, places.orders + 1.0)
    return np.asarray(powers @ places.shift_px[place])


def off(one: FloatArray, two: FloatArray) -> float:
    return float(np.linalg.norm(one - two) / np.linalg.norm(two))


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_powers_of_the_force_are_those_of_large_displacements(share: float) -> None:
    places = tabulated().places
    middle = SURFACE.point(np.array([SURFACE.domain.mean(axis=1)]))
    place = int(places.nearest(middle)[0])
    force = share * DESIGN.training.force_max_N
    wanted = truth(place, places, force)
    large = off(predicted(places, place, force), wanted)
    linear = off(force * places.shift_px[place, 0], wanted)
    assert large < 0.08
    assert linear > 1.5 * large
    # The third power has its say at the greatest force, though linear theory is far off there.
    second = force * places.shift_px[place, 0] + force**2 * places.shift_px[place, 1]
    assert share < 1.0 or off(second, wanted) > large


def test_turned_copies_are_what_would_be_solved() -> None:
    done = tabulated()
    assert done.solves < 0.3 * len(done.places.point_mm)
    assert done.unsure == 0
    columns = MARKERS.lattice.columns if MARKERS.lattice else 1
    ring = rings(SURFACE, SPACING_mm, columns)
    place = int(np.argmax(ring.turns == 3))
    base = int(ring.base[place])
    # The camera stands on the axis: what is turned in space is turned in the image.
    angle = 3 * 2.0 * np.pi / columns
    c, s = np.cos(angle), np.sin(angle)
    own = done.places.shift_px[base, 0].reshape(-1, columns, 2) @ np.array([[c, s], [-s, c]])
    wanted = np.roll(own, 3, axis=1).ravel()
    assert off(done.places.shift_px[place, 0], wanted) < 1e-4


def test_a_square_box_is_solved_on_one_side_in_four() -> None:
    design = of_shape(
        "cuboid",
        {"width_mm": 40.0, "depth_mm": 40.0, "length_mm": 40.0, "edge_radius_mm": 8.0},
        {"rows": 4, "columns": 12},
    )
    bench = Bench(design)
    shell = bench.shell(3)
    done = bench.tables(shell, spacing_mm=7.0, orders=4)
    assert done.solves * 4 <= len(done.places.point_mm) + 4
    assert done.bent < done.solves
    ring = rings(bench.surface, done.spacing_mm, 4)
    discs = bench.discs(*shell)
    for turns in (1, 3):
        place = int(np.flatnonzero(ring.turns == turns)[7])
        ((own,),) = discs.motions(ring.uv[[place]], done.places.radius_mm)
        (wanted,) = bench.see.powers([own], discs.forces)
        assert off(done.places.shift_px[place, 0], wanted) < 1e-3


def test_higher_powers_between_places_are_those_that_would_be_solved() -> None:
    """They stand farther apart than the places, and are interpolated."""
    done = tabulated()
    assert 2 * done.bent < done.solves
    shell = BENCH.discs(*BENCH.shell(4), orders=3)
    columns = MARKERS.lattice.columns if MARKERS.lattice else 1
    ring = rings(SURFACE, SPACING_mm, columns)
    force = DESIGN.training.force_max_N
    gaps = []
    for place in np.arange(0, len(ring.uv), len(ring.uv) // 12).tolist():
        (motions,) = shell.motions(ring.uv[[place]], done.places.radius_mm)
        rows = SEE.powers(motions, shell.forces)
        gaps.append(off(predicted(done.places, place, force), force ** np.arange(1.0, 4.0) @ rows))
    assert max(gaps) < 0.05
    assert float(np.median(gaps)) < 0.01


@pytest.mark.parametrize(("far_mm", "way"), [(11.0, 0), (11.0, 1), (15.0, 0)])
def test_interactions_add_what_two_contacts_do_beyond_their_sum(far_mm: float, way: int) -> None:
    """On the simulated sensor's shell, with large displacements; along the axis and around it."""
    places = tabulated().places
    assert places.pairs is not None
    middle = SURFACE.domain.mean(axis=1)[None]
    one, frame = SURFACE.point(middle)[0], tangent_frame(SURFACE, middle)
    uv = SURFACE.chart(np.stack([one, one + far_mm * frame[way][0]]))
    force, radius = 2.0, places.radius_mm
    alone = [true_shifts(uv[[k]], radius, force) for k in (0, 1)]
    wanted = (true_shifts(uv, radius, force) - alone[0] - alone[1]) / force**2
    (predicted,) = places.pairs.between(SURFACE.point(uv))
    # Places are 12 mm apart, and the simulated sensor's mesh is 1.5 times as fine.
    assert off(predicted, wanted) < 0.4
    assert predicted @ wanted > 0.97 * np.linalg.norm(predicted) * np.linalg.norm(wanted)


def test_three_strong_contacts_soften_the_wall_together() -> None:
    """What they do beyond their sum, by large displacements on the simulated sensor's shell."""
    places = tabulated().places
    middle = SURFACE.domain.mean(axis=1)[None]
    one, (along, around) = SURFACE.point(middle)[0], tangent_frame(SURFACE, middle)
    uv = SURFACE.chart(np.concatenate([[one], one + 11.0 * along, one + 11.0 * around]))
    force, radius = 0.6 * DESIGN.training.force_max_N, places.radius_mm
    alone = [true_shifts(uv[[k]], radius, force) for k in range(3)]
    wanted = true_shifts(uv, radius, force) - np.sum(alone, axis=0)
    prior = ContactPrior(place_mm=1.0)

    def error(tables: ResponseTable) -> float:
        states = [initial_state(tables, prior, point, force) for point in SURFACE.point(uv)]
        single = [predicted_shifts(tables, [state])[0][0] for state in states]
        together = [shift for shift, _ in predicted_shifts(tables, states)]
        return off(np.sum(together, axis=0) - np.sum(single, axis=0), wanted)

    still = replace(places)
    still.__dict__["softening"] = np.zeros(len(places.point_mm))
    assert error(places) < 0.3
    assert error(still) > 0.45


def test_receptors_show_what_narrow_presses_do() -> None:
    """Beyond linear shifts, on the simulated sensor's shell; the tables are of wider discs."""
    places, radius = tabulated().places, 2.0
    middle = SURFACE.point(SURFACE.domain.mean(axis=1)[None])
    gap_mm = np.linalg.norm(SURFACE.point(MARKERS.uv) - middle, axis=1)
    marker, force = np.sort(np.argsort(gap_mm)[:2]), 0.5 * DESIGN.training.force_max_N
    shell = BENCH.discs(*BENCH.shell(4), orders=3)
    table = tabulate_receptors(shell, SEE, MARKERS.uv, marker, marker[::-1, None], radius)
    assert table is not None
    uv = MARKERS.uv[marker]
    slope = true_shifts(uv[:1], radius, 0.02) / 0.02
    wanted = true_shifts(uv[:1], radius, force) - force * slope
    powers = force ** np.arange(2.0, 4.0)
    near = places.shift_px[int(places.nearest(SURFACE.point(uv[:1]))[0]), 1:]
    assert off(powers @ table.shift_px[0], wanted) < 0.5 * off(powers @ near, wanted)
    alone = [true_shifts(uv[[k]], radius, 2.0) for k in range(2)]
    both = true_shifts(uv, radius, 2.0) - np.sum(alone, axis=0)
    assert places.pairs is not None
    (between,) = places.pairs.between(SURFACE.point(uv))
    assert off(table.pair_px[0], both / 4.0) < 0.5 * off(between, both / 4.0)


def test_receptors_that_only_linear_theory_knows_are_left_to_the_tables(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shell, said = BENCH.discs(*BENCH.shell(3), orders=3), list[str]()
    solved = shell.motions
    marker = np.array([9, 20, 21])
    pair = np.array([[20, 21, 21], [9, 9, 20]])

    def table(unknown: list[int]) -> ReceptorTable | None:
        def motions(uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
            each = solved(uv, radius_mm)
            return [own[:1] if k in unknown else own for k, own in enumerate(each)]

        monkeypatch.setattr(shell, "motions", motions)
        return tabulate_receptors(shell, SEE, MARKERS.uv, marker, pair, 2.0, said.append)

    whole, part = table([]), table([1])
    assert whole is not None
    assert part is not None
    assert part.marker.tolist() == [9, 21]
    assert part.pair.tolist() == [[21], [9]]
    np.testing.assert_array_equal(part.shift_px, whole.shift_px[[0, 2]])
    np.testing.assert_allclose(part.pair_px[0], whole.pair_px[1], rtol=1e-3, atol=1e-7)
    assert table([0, 1, 2]) is None
    assert "receptors: 3 of 3, large displacements" in said


def test_coordinates_of_pairs_are_those_of_their_own_images(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Along axes by the third derivative, and each solved for itself: two ways to one image."""
    monkeypatch.setattr(interaction_tables, "SETTINGS", InteractionSettings(axes_max=12))
    shell = BENCH.discs(*BENCH.shell(3))
    uv, radius = rings(SURFACE, 9.0, 1).uv, 4.0
    mixed = InteractionSolver(shell, SEE, uv, radius)
    made = mixed.pairs()
    axes = made.axes_px.astype(float)
    np.testing.assert_allclose(axes @ axes.T, np.eye(len(axes)), atol=1e-5)
    some = mixed.drawn()[::5]
    images = mixed.images(some)
    wanted = images @ axes.T
    size = np.linalg.norm(wanted, axis=1, keepdims=True)
    for i, k in (some.T, some.T[::-1]):
        assert np.abs((made.grid.shift_px[i, k] - wanted) / size).max() < 1e-3
    left = np.linalg.norm(images - wanted @ axes) / np.linalg.norm(images)
    assert left < 0.4


COLUMNS = 14
"""Of the small cylinder's markers, and its sectors."""


def turn_by(share: float) -> FloatArray:
    """Rotation about the axis by a share of a full turn."""
    c, s = np.cos(2.0 * np.pi * share), np.sin(2.0 * np.pi * share)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def symmetry_in(
    sectors: int, shell: DiscResponse, bench: Bench = BENCH, see: ImageResponse | None = None
) -> SectorSymmetry | None:
    """Symmetry of a small sensor with places 8 mm apart."""
    ring = rings(bench.surface, 8.0, sectors)
    turn = turn_by(1.0 / sectors)
    return symmetry_of(shell.mesh, bench.markers, see or bench.see, ring, sectors, turn)


@cache
def coarse_discs() -> DiscResponse:
    return BENCH.discs(*BENCH.shell(2))


@pytest.mark.parametrize(("sectors", "axes", "kept"), [(2, 96, 96), (14, 96, 95), (14, 98, 98)])
def test_motions_and_pairs_of_one_sector_turn_into_all(
    sectors: int, axes: int, kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two axes that turn into each other, none is kept without the other."""
    monkeypatch.setattr(interaction_tables, "SETTINGS", InteractionSettings(axes_max=axes))
    shell, symmetry = coarse_discs(), symmetry_in(sectors, coarse_discs())
    assert symmetry is not None
    ring = symmetry.ring
    each, turned = (InteractionSolver(shell, SEE, ring.uv, 4.0, how) for how in (None, symmetry))
    assert len(turned.base) * sectors == len(ring.uv)
    np.testing.assert_allclose(turned.motion, each.motion, atol=1e-7 * np.abs(each.motion).max())
    made = turned.pairs()
    assert len(made.axes_px) == kept
    later = np.flatnonzero(ring.turns == sectors - 1)
    pairs = each.drawn()
    some = pairs[np.isin(pairs[:, 0], later)][::3]
    assert len(some) > 6
    images = each.images(some)
    for i, k in (some.T, some.T[::-1]):
        found = made.grid.shift_px[i, k] @ made.axes_px
        # Not all of an image lies along so few axes.
        plain = images @ made.axes_px.T @ made.axes_px
        assert np.linalg.norm(found - plain) < 1e-4 * np.linalg.norm(images)
        assert np.linalg.norm(found - images) < 0.15 * np.linalg.norm(images)


def test_no_two_drawn_pairs_are_turned_copies() -> None:
    symmetry = symmetry_in(7, coarse_discs())
    assert symmetry is not None
    ring = symmetry.ring
    solver = InteractionSolver(coarse_discs(), SEE, ring.uv, 4.0, symmetry)
    drawn = solver.drawn()
    place, copies = np.arange(len(ring.uv)), []
    for _ in range(7):
        copies += [frozenset(pair) for pair in place[drawn].tolist()]
        place = symmetry.place[place]
    # With an even number, pairs half a turn apart would be their own copies.
    assert len(set(copies)) == len(copies) == 7 * len(drawn)
    use = InteractionSettings()
    count = use.pairs_per_axis * use.axes_max
    assert len(drawn) == round(use.copied_images * count / 7)
    half = symmetry_in(2, coarse_discs())
    assert half is not None
    assert len(InteractionSolver(coarse_discs(), SEE, half.ring.uv, 4.0, half).drawn()) == count


def test_more_turned_copies_make_better_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    symmetry = symmetry_in(14, coarse_discs())
    assert symmetry is not None
    each = InteractionSolver(coarse_discs(), SEE, symmetry.ring.uv, 4.0)
    pairs = each.drawn()[::4]
    images = each.images(pairs)
    missed = []
    for copied in (0.5, 4.0):
        settings = InteractionSettings(axes_max=40, copied_images=copied)
        monkeypatch.setattr(interaction_tables, "SETTINGS", settings)
        axes = InteractionSolver(coarse_discs(), SEE, symmetry.ring.uv, 4.0, symmetry).axes()
        missed.append(float(np.linalg.norm(images - images @ axes.T @ axes)))
    assert missed[1] < 0.9 * missed[0]


def off_axis() -> ImageResponse:
    """What the small sensor's camera would see from 0.5 mm beside the axis."""
    (camera,) = SEE.readers.cameras
    aside = replace(camera, position_mm=np.add(camera.position_mm, [0.5, 0.0, 0.0]))
    return ImageResponse(replace(SEE.readers, cameras=(aside,)), MARKERS.mid_mm, SEE.arm_mm)


def test_markers_and_both_meshes_have_to_repeat_themselves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mesh, model = BENCH.shell(2)
    assert sectors_of(model, mesh, MARKERS)[0] == COLUMNS
    moved = MARKERS.mid_mm.copy()
    moved[3] += 0.01
    assert sectors_of(model, mesh, replace(MARKERS, mid_mm=moved)) == (1, None)
    pair = MeshPair(finer=BENCH.shell(3), coarser=(mesh, model), ratio=1.5)
    whole = made(2, spacing_mm=8.0, orders=1, pair=pair)
    assert whole.solves < len(whole.places.point_mm) / 2
    monkeypatch.setattr(response_tables, "column_turn", lambda *_: None)
    alone = made(2, spacing_mm=8.0, orders=1, pair=pair)
    assert alone.solves == len(alone.places.point_mm)


def test_images_turn_about_a_camera_on_the_axis_alone() -> None:
    found = symmetry_in(7, coarse_discs())
    assert found is not None
    wanted = np.tile(turn_by(1.0 / 7)[:2, :2].T, (MARKERS.count, 1, 1))
    np.testing.assert_allclose(found.pixel_turn, wanted, atol=1e-9)
    assert symmetry_in(7, coarse_discs(), see=off_axis()) is None
    assert symmetry_in(1, coarse_discs()) is None


def test_images_of_cameras_at_both_ends_turn_either_way() -> None:
    design = small(camera=FINE_CAMERA | {"ends": "both"})
    bench = Bench(design)
    cameras = cameras_of(design, bench.surface)
    far = (bench.markers.uv[:, 0] > bench.surface.domain[0].mean()).astype(np.int64)
    mid = bench.markers.mid_mm
    see = ImageResponse(Readers(cameras=cameras, read_by=far), mid, bench.markers.tip_mm - mid)
    found = symmetry_in(7, bench.discs(*bench.shell(2)), bench, see)
    assert found is not None
    np.testing.assert_allclose(found.pixel_turn[0], found.pixel_turn[-1].T, atol=1e-9)


@pytest.mark.parametrize(
    ("more", "case", "sectors"),
    [
        (1.0, "whole", 2),
        (9.0, "whole", COLUMNS),
        (9.0, "camera off the axis", 1),
        (9.0, "part of the surface", 1),
    ],
)
def test_pairs_have_hardly_more_places_for_symmetry(
    more: float, case: str, sectors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rings hold as many places in each sector, which may be many more than they need."""
    settings = InteractionSettings(more_places=more, axes_max=2, spacing_share=2.9)
    monkeypatch.setattr(response_tables, "SETTINGS", settings)
    monkeypatch.setattr(interaction_tables, "SETTINGS", settings)
    used: list[SectorSymmetry | None] = []

    class Noted(InteractionSolver):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            used.append(self.symmetry)

    monkeypatch.setattr(response_tables, "InteractionSolver", Noted)
    mesh, model = BENCH.shell(2)

    def below(_: float, uv: FloatArray) -> BoolArray:
        return np.asarray(uv[:, 0] < SURFACE.domain[0].mean())

    done = tabulate_responses(
        BENCH.sensor,
        mesh=mesh,
        model=model,
        see=off_axis() if case.startswith("camera") else SEE,
        spacing_mm=8.0,
        orders=3,
        near=below if case.startswith("part") else everywhere,
    )
    pairs, (symmetry,) = done.places.pairs, used
    assert pairs is not None
    assert (symmetry.sectors if symmetry else 1) == sectors
    apart = pair_spacing_mm(SURFACE.area_mm2(), pairs.grid.radius_mm)
    plain, own, most = (rings(SURFACE, apart, each).uv for each in (1, sectors, COLUMNS))
    assert len(plain) < len(most)
    kept = below(apart, own) if case.startswith("part") else everywhere(apart, own)
    assert len(pairs.grid.point_mm) == kept.sum()


def test_shells_of_too_many_elements_have_no_tables_of_pairs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mesh, _ = BENCH.shell(2)
    has_pairs = []
    for most in (len(mesh.quads), len(mesh.quads) - 1):
        settings = InteractionSettings(elements_max=most, axes_max=2)
        monkeypatch.setattr(response_tables, "SETTINGS", settings)
        monkeypatch.setattr(interaction_tables, "SETTINGS", settings)
        done = made(2, spacing_mm=8.0, orders=3)
        has_pairs.append(done.places.pairs is not None)
    assert has_pairs == [True, False]


def test_images_bend_as_the_lens_and_the_arms_do() -> None:
    rng = np.random.default_rng(4)
    one, two = 1e-2 * rng.normal(size=(2, MARKERS.count, 6))
    bend = image_curvature(SEE, MARKERS.count)
    predicted = np.einsum("nj,nijk,nk->ni", one, bend, two)
    ends = [SEE.shift(a * one + b * two) for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    np.testing.assert_allclose(predicted, (ends[0] + ends[1] - ends[2] - ends[3]) / 4.0, atol=2e-4)
    assert np.abs(predicted).max() > 0.01


def short_bench() -> Bench:
    """Three rows of receptors, so that fine meshes are solved soon."""
    return Bench(small(shape={"length_mm": 22.5}, layout={"rows": 3, "height_far_mm": 4.0}))


def test_the_first_power_is_extrapolated_from_two_meshes() -> None:
    """Against a mesh of twelve elements a pitch, everywhere and beside rims."""
    bench = short_bench()
    coarse = bench.shell(4)
    plain, done = (
        bench.tables(coarse, spacing_mm=12.0, orders=1, pair=each)
        for each in (None, mesh_pair(bench.shell, (6, 4)))
    )
    assert done.solves == plain.solves < len(plain.places.point_mm)
    uv = bench.surface.chart(plain.places.point_mm)
    some = np.arange(0, len(uv), 11)
    fine = bench.discs(*bench.shell(12))
    rows = [
        bench.see.powers(one, NONE)[0] for one in fine.motions(uv[some], plain.places.radius_mm)
    ]
    before, after = (
        np.array([off(each.places.shift_px[k, 0], row) for k, row in zip(some, rows, strict=True)])
        for each in (plain, done)
    )
    assert before.mean() > 3.0 * after.mean()
    assert (after < 0.5 * before).all()


def test_powers_of_the_force_are_scaled_to_those_of_a_finer_mesh() -> None:
    """Against a mesh of nine elements a pitch, at each power's share of the greatest force."""
    bench = short_bench()
    coarse = bench.shell(3)
    uv = bench.surface.domain.mean(axis=1)[None]
    radius = bench.design.training.patch_radius_max_mm
    meshes = mesh_pair(bench.shell, (6, 4))
    assert meshes is not None
    pair = ExtrapolatedResponse(bench.design, bench.surface, bench.markers, meshes)
    first = bench.see.powers(pair.motions(uv, radius)[0], NONE)[0]
    force = 0.5 * bench.design.training.force_max_N

    def moved(rows: FloatArray) -> FloatArray:
        return np.asarray(force ** np.arange(1, len(rows) + 1) @ rows)

    def rows_of(mesh: Any) -> FloatArray:
        shell = bench.discs(*mesh, orders=4)
        return bench.see.powers(shell.motions(uv, radius)[0], shell.forces)

    plain, fine = rows_of(coarse), rows_of(bench.shell(9))
    done = scaled_powers(plain, first)
    np.testing.assert_array_equal(done[0], first)
    true = moved(fine)
    assert off(moved(done), true) < 0.35 * off(moved(plain), true)
    # The first power alone, put in the place of the plain one, is not enough.
    mixed = np.concatenate([first[None], plain[1:]])
    assert off(moved(done), true) < off(moved(mixed), true)
    # The claimed error of the linear part is larger than the true one.
    (claimed,) = pair.claimed
    assert off(first, fine[0]) < claimed < 0.2


def test_tables_of_several_powers_are_scaled_with_their_pairs() -> None:
    bench = short_bench()
    coarse = bench.shell(3)
    plain, done = (
        bench.tables(coarse, spacing_mm=4.0, orders=3, pair=pair)
        for pair in (None, mesh_pair(bench.shell, (6, 4)))
    )
    ratios, close, before = [], [], []
    for own, scaled in zip(plain.places.shift_px, done.places.shift_px, strict=True):
        wanted = scaled_powers(own.astype(np.float64), scaled[0].astype(np.float64))
        ratios.append(np.linalg.norm(scaled[0]) / np.linalg.norm(own[0]))
        close.append(off(scaled[1], wanted[1]))
        before.append(off(own[1], wanted[1]))
    assert np.median(close) < 0.2 * np.median(before)
    assert len(done.claimed) >= done.solves
    assert not plain.claimed
    assert plain.places.pairs is not None
    assert done.places.pairs is not None
    # By the median of all places.
    grown = done.places.pairs.axes_px / plain.places.pairs.axes_px
    assert np.ptp(grown) < 1e-5
    assert grown.mean() == pytest.approx(np.median(ratios) ** 2, rel=0.03)


def test_force_along_the_surface_is_extrapolated() -> None:
    """Against a mesh of twelve elements a pitch."""
    bench = short_bench()
    coarse = bench.shell(3)
    plain, done = (
        bench.tables(coarse, spacing_mm=6.0, orders=1, pair=pair).places.shear
        for pair in (None, mesh_pair(bench.shell, (6, 4)))
    )
    assert plain is not None
    assert done is not None
    some = slice(None, None, len(done.point_mm) // 4)
    fine = bench.discs(*bench.shell(12))
    motions = fine.sheared(bench.surface.chart(done.point_mm[some]), done.radius_mm)
    for axis in (0, 1):
        rows = [bench.see.powers([both[axis]], NONE)[0] for both in motions]
        before, after = (
            np.array(
                [off(own[axis], row) for own, row in zip(each.shift_px[some], rows, strict=True)]
            )
            for each in (plain, done)
        )
        assert after.mean() < 0.5 * before.mean()


def test_corrections_of_linear_motion_are_interpolated_between_close_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = short_bench()
    coarse, pair = bench.shell(3), mesh_pair(bench.shell, (6, 4))
    plain = bench.tables(coarse, spacing_mm=2.2, orders=1)
    solved, close = (
        _tables_with(monkeypatch, spacing_max, bench, coarse, pair) for spacing_max in (0.0, 1.0)
    )
    assert len(close.claimed) < 0.7 * len(solved.claimed)
    one, two, three = (each.places.shift_px[:, 0] for each in (plain, close, solved))
    missed = np.median([off(*each) for each in zip(one, three, strict=True)])
    assert np.median([off(*each) for each in zip(two, three, strict=True)]) < 0.15 * missed


def _tables_with(
    monkeypatch: pytest.MonkeyPatch, spacing_max: float, bench: Bench, coarse: Any, pair: Any
) -> TabulatedResponse:
    monkeypatch.setattr(response_tables, "CORRECTION_SPACING_MAX", spacing_max)
    return bench.tables(coarse, spacing_mm=2.2, orders=1, pair=pair)


def test_tables_of_all_but_the_coarsest_meshes_are_extrapolated() -> None:
    levels = {refine: extrapolated_from(refine, 100) for refine in (2, 3, 4, 6, 7, 8)}
    assert levels == {2: None, 3: (6, 4), 4: (6, 4), 6: (6, 4), 7: (8, 4), 8: (8, 4)}
    assert extrapolated_from(4, EXTRAPOLATED_MARKERS_MAX + 1) is None
    own = BENCH.shell(4)
    shells = {4: own, 6: BENCH.shell(6)}
    pair = mesh_pair(shells.__getitem__, (6, 4))
    assert pair is not None
    assert pair.each == [shells[6], own]
    assert pair.ratio == len(shells[6][0].quads) / len(own[0].quads)
    assert mesh_pair(shells.__getitem__, None) is None
    # Meshes that are too alike.
    assert mesh_pair(lambda _: own, (6, 4)) is None

    def refused_if_fine(refine: int) -> Any:
        if refine == 6:
            raise NumericalError("mesh-distorted", "its elements are too irregular")
        return own

    assert mesh_pair(refused_if_fine, (6, 4)) is None


def test_linear_theory_alone_is_the_first_power() -> None:
    one, three = tabulated(orders=1).places, tabulated().places
    assert one.orders == 1
    np.testing.assert_allclose(one.shift_px[:, 0], three.shift_px[:, 0], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    "kind", ["cylinder", "cone", "cuboid", "grip", "hemisphere", "plane", "patch"]
)
def test_no_place_is_far_from_the_tables(kind: str) -> None:
    design: Design = drawn(kind, 3)
    surface = design.surface()
    spacing = 0.08 * float(np.ptp(surface.bounds_mm(), axis=0).max())
    ring = rings(surface, spacing, 1)
    (u0, u1), (v0, v1) = surface.domain
    rng = np.random.default_rng(0)
    uv = np.column_stack([rng.uniform(u0, u1, 300), rng.uniform(v0, v1, 300)])
    gap = np.linalg.norm(surface.point(uv)[:, None] - surface.point(ring.uv)[None], axis=2)
    assert gap.min(axis=1).max() < spacing
    assert len(np.unique(np.round(surface.point(ring.uv), 6), axis=0)) == len(ring.uv)


def test_tables_that_would_fill_the_memory_are_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(tabulate_responses.__kwdefaults__, "bytes_max", 2e5)
    done = made(3, spacing_mm=1.0, orders=1)
    assert done.places.shift_px.nbytes < 4e5


def test_a_small_part_has_places_enough_for_the_higher_powers() -> None:
    middle = SURFACE.point(np.array([SURFACE.domain.mean(axis=1)]))[0]

    def near(spacing_mm: float, uv: FloatArray) -> BoolArray:
        del spacing_mm
        return np.asarray(np.linalg.norm(SURFACE.point(uv) - middle, axis=1) < 5.0)

    done = made(3, spacing_mm=3.0, orders=3, near=near)
    assert done.places.orders == 3
    assert done.bent == done.solves


def test_places_stand_closer_on_flat_walls() -> None:
    """Seen from its end a receptor shows the wall's slope, which changes sooner than its place."""
    assert place_spacing_mm(SURFACE, 0.8, 5.0) == 4.0
    design = of_shape(
        "plane",
        {"width_mm": 36.0, "height_mm": 29.0},
        {"kind": "straight", "rows": 4, "columns": 5},
    )
    bench = Bench(design)
    surface = bench.surface
    assert place_spacing_mm(surface, 0.8, 5.0) == 2.0
    shell = bench.shell(3)
    discs = bench.discs(*shell)
    at = surface.point(np.random.default_rng(1).uniform(*surface.domain.T, (20, 2)))
    error = {}
    for spacing in (4.0, 2.0):
        places = bench.tables(shell, spacing_mm=spacing, orders=1).places
        motions = discs.motions(surface.chart(at), places.radius_mm)
        wanted = np.stack([bench.see.powers(own, discs.forces)[0] for own in motions])
        found = interpolate_responses(places, at)[:, 0]
        error[spacing] = np.median([off(a, b) for a, b in zip(found, wanted, strict=True)])
    assert error[4.0] > 0.02
    assert error[2.0] < 0.01
