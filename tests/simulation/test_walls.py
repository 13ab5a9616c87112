"""Flat walls under tension: against a plate in closed form, and against large displacements."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_fit import ContactPrior, initial_state
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import Readers, cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.simulation.flat_walls import StretchedWall, add_membrane_walls, flat_walls
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_design.simulation.response_tables import TabulatedResponse, tabulate_responses
from phytac_shapes.arrays import FloatArray
from tests.designs import of_shape

STRAIGHT = {"kind": "straight", "rows": 5, "columns": 7}


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A small sensor, its shell and its tables."""

    pressed: DiscResponse
    see: ImageResponse
    made: TabulatedResponse

    @property
    def places(self) -> ResponseTable:
        return self.made.places


@cache
def bench(shape: str, orders: int = 4) -> Bench:
    sizes: dict[str, Any] = {"width_mm": 48.0, "height_mm": 36.0}
    refine, spacing_mm = 4, 5.0
    if shape == "cuboid":
        refine, spacing_mm, orders = 3, 6.0, 2  # of the box only signs and bounds are asked
        sizes = {"width_mm": 36.0, "depth_mm": 36.0, "length_mm": 48.0, "edge_radius_mm": 5.0}
    design = of_shape(shape, sizes, dict(STRAIGHT))
    surface = design.surface()
    markers = make_markers(design, surface)
    readers = Readers(
        cameras=cameras_of(design, surface), read_by=np.zeros(markers.count, dtype=np.int64)
    )
    see = ImageResponse(readers, markers.mid_mm, markers.tip_mm - markers.mid_mm)
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=refine)
    model = sensor_model(design, markers, mesh, receptors=False)
    made = tabulate_responses(
        Sensor.of(design, surface, markers),
        mesh=mesh,
        model=model,
        see=see,
        spacing_mm=spacing_mm,
        orders=orders,
    )
    pressed = DiscResponse(design, surface, markers, mesh=mesh, model=model, orders=orders)
    return Bench(pressed=pressed, see=see, made=made)


def wall_of(one: Bench) -> StretchedWall:
    ((_, elements),) = flat_walls(one.pressed.model, one.places)
    return StretchedWall(one.pressed.model, elements)


def test_an_even_stretch_stiffens_a_plate_by_its_tension() -> None:
    r"""Of a deflection w Berger has e = ∫|∇w|² / (2 A (1 + ν))."""
    one = bench("plane")
    model = one.pressed.model
    low, size = model.nodes_mm.min(axis=0), np.ptp(model.nodes_mm, axis=0)
    flat = int(np.argmin(size))
    a, b = (k for k in range(3) if k != flat)
    x, y = (2.0 * np.pi * (model.nodes_mm[:, k] - low[k]) / size[k] for k in (a, b))
    motion = np.zeros((len(x), 6))
    motion[:, flat] = (1.0 - np.cos(x)) * (1.0 - np.cos(y))
    slope = np.zeros((len(x), 3))
    slope[:, a] = 2.0 * np.pi / size[a] * np.sin(x) * (1.0 - np.cos(y))
    slope[:, b] = 2.0 * np.pi / size[b] * (1.0 - np.cos(x)) * np.sin(y)
    # A fibre along the normal n leans by -∇w: its turn is n × (-∇w).
    motion[:, 3:] = np.cross(np.eye(3)[flat], -slope)
    field = motion.reshape(-1, 1)
    # ∫ sin² (1 - cos)² over both, means 1/2 and 3/2.
    square = 0.75 * (2.0 * np.pi) ** 2 * (size[a] ** -2.0 + size[b] ** -2.0)
    found = wall_of(one).stretching(field, field)[0, 0]
    assert found == pytest.approx(square / (2.0 * (1.0 + model.poisson)), rel=0.02)


def test_at_the_half_stretch_a_wall_is_half_as_soft() -> None:
    one = bench("plane")
    wall = wall_of(one)
    middle = one.pressed.surface.domain.mean(axis=1)[None]
    loads, _ = one.pressed.linear(middle, one.places.radius_mm)
    still = wall.at(0.0)(loads)
    half = wall.halved_at(loads[:, 0], still[:, 0])
    softness = [float(loads[:, 0] @ wall.at(e)(loads)[:, 0]) for e in (0.0, half, 3.0 * half)]
    # Exactly, were there one mode of deflection.
    assert softness[1] / softness[0] == pytest.approx(1.0 / 2.0, abs=0.05)
    assert softness[2] / softness[0] == pytest.approx(1.0 / 4.0, abs=0.06)


def seen_and_predicted(
    one: Bench, forces: list[float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shifts (2n,) of discs at once: by large displacements, by the tables, and were each alone."""
    uv = one.pressed.surface.domain.mean(axis=1) + np.array(
        [[-9.0, -5.0], [8.0, -4.0], [1.0, 8.0]][: len(forces)]
    )
    loads, still = one.pressed.linear(uv, one.places.radius_mm)
    weight = np.array(forces)
    large = one.pressed.shell.approximate(loads @ weight, still @ weight)
    assert large is not None
    seen = one.see.shift(one.pressed.kinematics.large(large)).ravel()
    points = one.pressed.surface.point(uv)
    predicted = []
    for places in (one.places, replace(one.places, walls=None, shift_px=powers(one.places))):
        states = [
            initial_state(places, ContactPrior(place_mm=1.0), p, f)
            for p, f in zip(points, forces, strict=True)
        ]
        predicted.append(np.sum([shifts for shifts, _ in predicted_shifts(places, states)], axis=0))
    return seen, predicted[0], predicted[1]


def powers(places: ResponseTable) -> Any:
    return places.shift_px[:, : places.orders]


def test_discs_at_once_move_the_markers_as_large_displacements_have_it() -> None:
    seen, predicted, alone = seen_and_predicted(bench("plane"), [15.0, 20.0, 12.0])
    size = np.linalg.norm(seen)
    assert np.linalg.norm(alone - seen) > 0.3 * size
    assert np.linalg.norm(predicted - seen) < 0.06 * size


def test_one_disc_answers_as_before() -> None:
    seen, predicted, alone = seen_and_predicted(bench("plane"), [20.0])
    # To rounding: processors add 32-bit numbers in different orders.
    np.testing.assert_allclose(predicted, alone, rtol=1e-5, atol=1e-6)
    assert np.linalg.norm(predicted - seen) < 0.03 * np.linalg.norm(seen)


def test_edges_that_hold_still_give_all_the_tension_and_those_of_a_box_little() -> None:
    (clamped,) = bench("plane").made.give
    assert clamped == pytest.approx(1.0, abs=0.25)
    box = bench("cuboid")
    assert len(box.made.give) >= 4
    assert max(box.made.give) < 0.5
    walls = box.places.walls
    assert walls is not None
    # Its corners are round: places there are on no wall.
    assert set(np.unique(walls.wall)) == set(range(-1, len(box.made.give)))
    normal = np.cross(box.places.along, box.places.around)
    for number in range(len(box.made.give)):
        own = normal[walls.wall == number]
        assert np.min(own @ own[0]) > 0.9998


@pytest.mark.parametrize("shape", ["plane", "cuboid"])
def test_elements_of_a_wall_lie_in_its_plane_and_in_no_other(shape: str) -> None:
    one = bench(shape)
    model, places = one.pressed.model, one.places
    corner = model.nodes_mm[model.quads]
    across = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normal = np.cross(places.along, places.around)
    taken = np.zeros(len(corner), dtype=np.int64)
    for own, elements in flat_walls(model, places):
        taken += elements
        assert np.abs(across[elements] @ normal[own[0]]).min() > 0.9998
        height = (corner[elements] - places.point_mm[own[0]]) @ normal[own[0]]
        assert np.ptp(height) < 1e-3 * np.ptp(model.nodes_mm)
    assert taken.max() == 1
    assert (taken > 0).all() == (shape == "plane")


def test_walls_of_softer_tables_are_as_much_softer() -> None:
    """As those are that are extrapolated from finer meshes."""
    one = bench("plane")
    plain = replace(one.places, walls=None, shift_px=powers(one.places))
    rows = plain.shift_px.copy()
    rows[:, 0] *= np.float32(1.1)
    uv = one.pressed.surface.chart(plain.point_mm)
    own, softer = (
        add_membrane_walls(one.pressed, one.see, places, uv)[0]
        for places in (plain, replace(plain, shift_px=rows))
    )
    orders = one.pressed.orders
    np.testing.assert_allclose(
        softer.shift_px[:, orders:], 1.1 * own.shift_px[:, orders:], rtol=1e-4, atol=1e-6
    )
    assert np.abs(own.shift_px[:, orders:]).max() > 1e-3
    assert own.walls is not None
    assert softer.walls is not None
    np.testing.assert_allclose(softer.walls.slopes, 1.1 * own.walls.slopes, rtol=1e-4, atol=1e-6)


def test_linear_tables_have_no_walls() -> None:
    one = bench("plane", orders=1)
    assert one.places.walls is None
    assert one.made.give == []
    assert one.places.orders == 1
