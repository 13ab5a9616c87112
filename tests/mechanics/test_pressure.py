"""Loads of shaped indenters: resultants, moments, moments of second order, rims, friction."""

import numpy as np
import pytest
from scipy.special import j1

from phytac_design.mechanics.indenter import CYLINDER, FLAT, INDENTERS, SPHERE
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh, plain_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.pressure import (
    Holes,
    PressureWithHoles,
    check_indentations,
    contact_frames,
    indentation_loads,
    tangent_frame,
)
from phytac_design.mechanics.shell.pressure_sharing import near_pairs, on_shell_share
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Plane, Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.cylinder import Cylinder
from tests.mechanics.families import FAMILIES, WALL_MM
from tests.mechanics.touches import make_touches
from tests.refusals import refused

TUBE = Cylinder(diameter_outer_mm=60.0, length_mm=80.0)
TUBE_MESH = chart_mesh(TUBE, thickness_mm=WALL_MM, n_along=32, n_around=72)
SHEET = Plane(width_mm=60.0, height_mm=60.0)
SHEET_MESH = plain_mesh(SHEET, thickness_mm=WALL_MM, size_mm=1.5)
DOME = FAMILIES["hemisphere"]
DOME_MESH = plain_mesh(DOME, thickness_mm=WALL_MM, size_mm=2.5)
KINDS = (FLAT, SPHERE, CYLINDER)
E_MPA, NU = 2200.0, 0.38


def shaped(uv: FloatArray, kind: int, friction: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """A contact about 8 mm across of each kind at every place."""
    radius, length = (1.0, 9.0) if kind == CYLINDER else (4.0, 0.0)
    return make_touches(
        uv, kind, radius_mm=radius, length_mm=length, turn_rad=0.7, friction=friction
    )


def nodal(mesh: ShellMesh, surface: Surface, touches: object) -> FloatArray:
    """Loads (N, 6, c)."""
    load = indentation_loads(mesh, surface, touches).toarray()
    return load.reshape(len(mesh.nodes_mm), 6, -1)


def moments(mesh: ShellMesh, load: FloatArray, about: FloatArray) -> FloatArray:
    """Moment (c, 3) of loads (N, 6, c) about points (c, 3)."""
    arm = mesh.nodes_mm[:, None] - about
    return np.sum(np.cross(arm, load[:, :3].transpose(0, 2, 1)), axis=0) + load[:, 3:].sum(0).T


def test_numbers_of_the_indenters() -> None:
    assert [INDENTERS[k] for k in KINDS] == ["flat", "sphere", "cylinder"]


@pytest.mark.parametrize("radius", [0.0, 0.1, 2.0, 6.0, 25.0])
def test_flat_without_friction_is_a_patch(radius: float) -> None:
    uv = np.array([[40.0, 0.0], [0.0, 1.0], [33.3, 6.28], [79.0, 2.0]])
    ours = indentation_loads(TUBE_MESH, TUBE, make_touches(uv, FLAT, radius_mm=radius))
    theirs = patch_loads(TUBE_MESH, TUBE, uv, radius)
    assert abs(ours - theirs).max() < 1e-15


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("surface", "mesh"), [(TUBE, TUBE_MESH), (SHEET, SHEET_MESH), (DOME, DOME_MESH)]
)
def test_resultants_are_the_given_ones(kind: int, surface: Surface, mesh: ShellMesh) -> None:
    rng = np.random.default_rng(5)
    low, high = surface.domain.T
    uv = np.concatenate([[low, high, [low[0], high[1]]], rng.uniform(low, high, (24, 2))])
    u, v = tangent_frame(surface, uv)
    normal, friction = surface.normal(uv), np.array([0.5, -0.3])
    wanted = friction[0] * u + friction[1] * v
    for radius, length in ((4.0, 12.0), (1e-3, 1e-3), (1e-3, 9.0), (0.9, 0.2)):
        size = {"radius_mm": radius, "length_mm": length, "turn_rad": 0.3}
        touches = make_touches(uv, kind, friction=friction, **size)
        load = nodal(mesh, surface, touches)
        bare = nodal(mesh, surface, make_touches(uv, kind, **size))
        for total in (load[:, :3].sum(axis=0).T, bare[:, :3].sum(axis=0).T):
            np.testing.assert_allclose(np.sum(total * normal, axis=1), -1.0, atol=1e-12)
        assert np.all(bare[:, 3:] == 0.0)
        side = (load - bare)[:, :3].sum(axis=0).T
        # Away from rims both are symmetric: no other component, and no moment about the centre,
        # but that of a strip askew on a tube, whose ends press past each other.
        free = (
            on_shell_share(surface, uv, 1.2 * contact_frames(surface, touches).reach_mm + 3.0)
            == 1.0
        )
        assert free.sum() >= 5
        slack = 1e-9 if surface is SHEET else 0.02
        assert np.abs(bare[:, :3].sum(axis=0).T + normal)[free].max() < slack
        assert np.abs(side - wanted)[free].max() < slack
        about, askew = surface.point(uv), 0.0
        if surface is TUBE and kind == CYLINDER:
            askew = (radius**2 / 4.0 - length**2 / 12.0) * np.sin(0.6) / 2.0 / 30.0
        gap = np.linalg.norm(moments(mesh, bare, about) - askew * normal, axis=1)[free]
        assert gap.max() < (0.012 if radius > 0.1 else 0.2)  # a line: to half a cell
        if surface is SHEET:
            assert np.abs(moments(mesh, load, about))[free].max() < (0.012 if radius > 0.1 else 0.2)
            # Without the nodes' own moments it would be half a thickness times the friction.
            lever = np.linalg.norm(load[:, 3:].sum(axis=0).T, axis=1)
            np.testing.assert_allclose(lever, 0.5 * WALL_MM * np.hypot(*friction), rtol=1e-9)


def test_moment_of_friction_on_a_bent_face() -> None:
    # About the centre, traction along a tube's arc lies in front of it, traction across does not:
    # Here by a fine sum over the face itself; half a thickness too many would be 0.16 N mm.
    mesh = chart_mesh(TUBE, thickness_mm=WALL_MM, n_along=60, n_around=180)
    uv = np.array([[40.0, 0.3]])
    radius, R = 9.0, 30.0
    z, arc = np.meshgrid(*[(np.arange(-300, 300) + 0.5) / 30.0] * 2, indexing="ij")
    turn = arc / R
    chord = np.sqrt(z**2 + (2.0 * R * np.sin(turn / 2.0)) ** 2)
    press = np.sqrt(np.maximum(1.0 - (chord / radius) ** 2, 0.0))
    depth = R * (np.cos(turn) - 1.0)  # along the normal at the centre
    u, v = tangent_frame(TUBE, uv)
    outward = TUBE.normal(uv)
    arms = [z[..., None] * u[0] + (R * np.sin(turn))[..., None] * v[0] + depth[..., None] * outward]
    for friction in ((0.4, 0.0), (0.0, 0.4)):
        touches = make_touches(uv, SPHERE, radius_mm=radius, friction=friction)
        bare = nodal(mesh, TUBE, make_touches(uv, SPHERE, radius_mm=radius))
        got = moments(mesh, nodal(mesh, TUBE, touches) - bare, TUBE.point(uv))[0]
        along = np.cos(turn)[..., None] * v[0] - np.sin(turn)[..., None] * outward
        pull = np.broadcast_to(u[0], along.shape) if friction[0] else along
        weight = press / np.sum(press * (pull @ (u if friction[0] else v)[0]))
        want = 0.4 * np.sum(weight[..., None] * np.cross(arms[0], pull), axis=(0, 1))
        assert np.linalg.norm(want) > 0.05
        np.testing.assert_allclose(got, want, atol=0.02 * np.linalg.norm(want))


@pytest.mark.parametrize(("kind", "along", "across"), [(0, 4, 4), (1, 5, 5), (2, 12, 4)])
def test_second_moments_converge_with_the_mesh(kind: int, along: float, across: float) -> None:
    # Σ F x²: a²/4 of an even disc, a²/5 of Hertz's; L²/12 along a strip and b²/4 across it.
    radius, length, turn = 5.0, 18.0, 0.5
    want = np.array([(length if kind == CYLINDER else radius) ** 2 / along, radius**2 / across])
    uv = np.array([[0.7, -1.1]])
    touches = make_touches(uv, kind, radius_mm=radius, length_mm=length, turn_rad=turn)
    frames = contact_frames(SHEET, touches)
    errors = []
    for size in (2.0, 1.0, 0.5):
        mesh = plain_mesh(SHEET, thickness_mm=WALL_MM, size_mm=size)
        weight = -nodal(mesh, SHEET, touches)[:, :3, 0] @ SHEET.normal(uv)[0]
        arm = mesh.nodes_mm - frames.at
        x, y = arm @ frames.axis[0], arm @ frames.across[0]
        errors.append(np.array([weight @ x**2, weight @ y**2]) / want - 1.0)
        assert abs(weight @ (x * y)) < 0.02 * want.max()
    worst = np.abs(errors).max(axis=1)
    assert worst[2] < 0.01
    assert worst[0] > 3.0 * worst[1] > 9.0 * worst[2]


def test_turning_with_the_sensor_changes_nothing() -> None:
    step = 2.0 * np.pi / 72
    for kind in KINDS:
        uv = np.array([[31.0, 0.01], [31.0, 0.01 + 70 * step], [31.0, 0.01 + 73 * step]])
        load = nodal(TUBE_MESH, TUBE, shaped(uv, kind, (0.3, 0.2)))
        around = load.reshape(-1, 72, 2, 3, 3)
        for k, columns in ((1, 70), (2, 73)):
            c, s = np.cos(columns * step), np.sin(columns * step)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            want = np.roll(around[..., 0], columns, axis=1) @ turn.T
            np.testing.assert_allclose(around[..., k], want, atol=1e-12)


def test_a_pole_is_a_place_like_any_other() -> None:
    top = DOME.domain[0, 1]
    uv = np.array([[top, 0.0], [top, np.pi], [top, 1.0], [top - 1e-6, 0.0]])
    turn = np.array([0.4, 0.4, -0.6, 0.4])
    for kind in KINDS:
        touches = make_touches(uv, kind, radius_mm=2.0, length_mm=9.0, turn_rad=turn)
        load = nodal(DOME_MESH, DOME, touches)
        # Growing u points away over the pole: turned by -v, seen from outside.
        for k in (1, 3) if kind == CYLINDER else (1, 2, 3):
            np.testing.assert_allclose(load[..., k], load[..., 0], atol=2e-5)
    frames = contact_frames(
        DOME, make_touches(uv, CYLINDER, radius_mm=2.0, length_mm=9.0, turn_rad=turn)
    )
    np.testing.assert_allclose(frames.axis[0], -frames.axis[1], atol=1e-9)


def test_rims_take_part_of_a_touch_away() -> None:
    uv = np.array([[-30.0, 4.0]])
    inward = -SHEET.normal(uv)[0]
    # Centroid of half of Hertz's pressure: 3a/8 from its straight side.
    load = nodal(SHEET_MESH, SHEET, make_touches(uv, SPHERE, radius_mm=8.0))[:, :3, 0] @ inward
    assert load.sum() == pytest.approx(1.0, abs=1e-12)
    assert load @ SHEET_MESH.uv[:, 0] + 30.0 == pytest.approx(3.0, abs=0.02)
    # A strip square to the rim keeps its half, one along it half its width: 4b/3π.
    for turn, want in ((0.0, 6.0), (np.pi / 2.0, 4.0 * 5.0 / (3.0 * np.pi))):
        strip = make_touches(uv, CYLINDER, radius_mm=5.0, length_mm=24.0, turn_rad=turn)
        load = nodal(SHEET_MESH, SHEET, strip)[:, :3, 0] @ inward
        assert load @ SHEET_MESH.uv[:, 0] + 30.0 == pytest.approx(want, rel=0.01)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["cylinder", "capped", "plane"])
def test_touches_larger_than_the_sensor(name: str, kind: int) -> None:
    surface = FAMILIES[name]
    mesh = plain_mesh(surface, thickness_mm=WALL_MM, size_mm=5.0)
    uv = surface.domain.mean(axis=1)[None]
    size = {"radius_mm": 150.0, "length_mm": 400.0}
    load = nodal(mesh, surface, make_touches(uv, kind, friction=(0.0, 0.2), **size))
    normal = surface.normal(uv)[0]
    total = load[:, :3, 0].sum(axis=0)
    assert total @ normal == pytest.approx(-1.0, abs=1e-12)
    assert total @ tangent_frame(surface, uv)[1][0] == pytest.approx(0.2, abs=0.02)
    facing = mesh.normals @ normal
    assert np.all(load[facing < -0.3] == 0.0)
    assert (np.abs(load[facing > 0.3]).sum(axis=(1, 2)) > 0.0).all()


def test_friction_that_wraps_around_an_edge_is_refused() -> None:
    box = FAMILIES["cuboid"]
    mesh = plain_mesh(box, thickness_mm=WALL_MM, size_mm=4.0)
    strip = {"radius_mm": 3.0, "length_mm": 20.0, "turn_rad": np.pi / 2.0}
    uv = np.array([[30.0, 14.0]])
    indentation_loads(mesh, box, make_touches(uv, CYLINDER, friction=(0.0, -0.2), **strip))
    with refused("patch-beyond-edge"):
        indentation_loads(mesh, box, make_touches(uv, CYLINDER, friction=(0.0, -4.0), **strip))


def navier(touches: object, at: FloatArray) -> FloatArray:
    """Deflection (c, k) of a simply supported Mindlin plate under 1 N at points ``at`` (k, 2)."""
    side, t = 60.0, WALL_MM
    k = np.pi * np.arange(1, 400) / side
    kx, ky = (grid.ravel() for grid in np.meshgrid(k, k))
    D, G = E_MPA * t**3 / 12.0 / (1.0 - NU**2), E_MPA / 2.0 / (1.0 + NU)
    kk = kx**2 + ky**2
    stiff = D * kk**2 / (1.0 + D * kk / (5.0 / 6.0 * G * t))

    def spectrum(c: int, kx: FloatArray, ky: FloatArray) -> FloatArray:
        a, L = touches.radius_mm[c], touches.length_mm[c]
        turn = -touches.turn_rad[c]  # seen from outside, v runs clockwise from u on a sheet
        if touches.indenter[c] == CYLINDER:
            x = (np.cos(turn) * kx + np.sin(turn) * ky) * L / 2.0
            y = np.abs(-np.sin(turn) * kx + np.cos(turn) * ky) * a
            return np.sinc(x / np.pi) * 2.0 * j1(y + 1e-9) / (y + 1e-9)
        x = np.hypot(kx, ky) * a
        if touches.indenter[c] == FLAT:
            return 2.0 * j1(x) / x
        return 3.0 * (np.sin(x) - x * np.cos(x)) / x**3

    out = []
    for c, (x0, y0) in enumerate(touches.uv + side / 2.0):
        q = np.cos(kx * x0 - ky * y0) * spectrum(c, kx, -ky)
        q -= np.cos(kx * x0 + ky * y0) * spectrum(c, kx, ky)
        x, y = (at + side / 2.0).T
        w = np.sin(np.outer(x, kx)) * np.sin(np.outer(y, ky)) @ (2.0 / side**2 * q / stiff)
        out.append(w)
    return np.array(out)


def test_a_plate_bends_as_the_series_says() -> None:
    fixed = np.zeros((len(SHEET_MESH.nodes_mm), 6), dtype=np.bool_)
    normal, (e_u, e_v) = SHEET.normal(np.zeros((1, 2)))[0], SHEET.tangents(np.zeros((1, 2)))[0]
    axes = [int(np.argmax(np.abs(e))) for e in (e_u, e_v, normal)]
    fixed[:, [axes[0], axes[1], 3 + axes[2]]] = True  # bending only
    for k in (0, 1):
        edge = np.abs(np.abs(SHEET_MESH.uv[:, k]) - 30.0) < 1e-9
        fixed[edge, axes[2]] = fixed[edge, 3 + axes[k]] = True
    model = ShellModel(
        SHEET_MESH.nodes_mm,
        SHEET_MESH.quads,
        SHEET_MESH.normals,
        thickness_mm=WALL_MM,
        modulus_MPa=E_MPA,
        poisson=NU,
        fixed=fixed,
    )
    uv = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [-9.0, 6.0]])
    touches = make_touches(
        uv,
        SPHERE,
        radius_mm=np.array([14.0, 14.0, 5.0, 4.0]),
        length_mm=np.array([0.0, 0.0, 28.0, 22.0]),
        turn_rad=np.array([0.0, 0.0, 0.0, 0.6]),
    )
    touches.indenter[:] = [FLAT, SPHERE, CYLINDER, CYLINDER]
    nodes = np.array([int(np.argmin(np.abs(SHEET_MESH.uv - p).sum(1))) for p in uv[[0, 3]]])
    moved = model.solve(indentation_loads(SHEET_MESH, SHEET, touches)).motion[nodes, :3]
    got = -np.einsum("nkc,k->cn", moved, normal)
    want = navier(touches, SHEET_MESH.uv[nodes])
    np.testing.assert_allclose(got, want, rtol=0.003)
    # The shapes differ by far more than that.
    assert want[1, 0] / want[0, 0] > 1.03
    assert want[0, 0] / want[2, 0] < 0.98 or want[0, 0] / want[2, 0] > 1.02


BAD = [
    ({"radius_mm": np.nan}, "contact-not-finite"),
    ({"radius_mm": -1.0}, "contact-radius-negative"),
    ({"length_mm": 0.0}, "contact-length-not-positive"),
    ({"turn_rad": np.inf}, "contact-not-finite"),
    ({"friction": (0.0, 6.0)}, "contact-friction-too-large"),
    ({"friction": (np.nan, 0.0)}, "contact-not-finite"),
]


@pytest.mark.parametrize(("change", "code"), BAD)
def test_touches_without_sense_are_refused(change: dict[str, float], code: str) -> None:
    good = {"radius_mm": 2.0, "length_mm": 9.0}
    uv = np.array([[10.0, 1.0]])
    check_indentations(TUBE, make_touches(uv, CYLINDER, **good))
    with refused(code):
        indentation_loads(TUBE_MESH, TUBE, make_touches(uv, CYLINDER, **(good | change)))


def test_places_and_kinds_without_sense_are_refused() -> None:
    with refused("contact-off-surface"):
        check_indentations(
            TUBE, make_touches(np.array([[1.0, 9.0], [80.1, 0.0]]), 0, radius_mm=1.0)
        )
    with refused("indenter-unknown"):
        check_indentations(TUBE, make_touches(np.array([[1.0, 0.0]]), 3, radius_mm=1.0))
    with refused("contact-not-finite"):
        check_indentations(TUBE, make_touches(np.array([[np.nan, 0.0]]), 0, radius_mm=1.0))
    pulled = make_touches(np.array([[1.0, 0.0]]), 0, radius_mm=1.0)
    pulled.force_N[0] = -1.0
    with refused("contact-force-negative"):
        check_indentations(TUBE, pulled)


def test_loads_do_not_depend_on_other_contacts() -> None:
    rng = np.random.default_rng(2)
    uv = rng.uniform(*DOME.domain.T, (60, 2))
    touches = make_touches(uv, SPHERE, radius_mm=rng.uniform(2.1, 3.9, 60), friction=(0.1, 0.2))
    touches.indenter[:30], touches.length_mm[:30] = CYLINDER, 15.0
    both = indentation_loads(DOME_MESH, DOME, touches).toarray()
    for k in range(20, 40):
        one = touches.pick(np.array([k]), [0])
        np.testing.assert_array_equal(
            indentation_loads(DOME_MESH, DOME, one).toarray()[:, 0], both[:, k]
        )
    none = touches.pick(np.zeros(0, dtype=np.int64), [])
    assert indentation_loads(DOME_MESH, DOME, none).shape == (len(both), 0)


def test_pairs_are_all_those_near_and_in_order() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.uniform(0.0, 10.0, (70, 3)), rng.uniform(0.0, 10.0, (400, 3))
    reach, size = 10.0 ** rng.uniform(-3.0, 0.7, 70), rng.uniform(0.0, 0.5, 400)
    reach[0] = 0.0
    i, j, gap = near_pairs(a, reach, b, size)
    every = np.linalg.norm(a[:, None] - b, axis=2)
    near = every <= reach[:, None] + size
    np.testing.assert_array_equal(np.column_stack([i, j]), np.argwhere(near))
    np.testing.assert_allclose(gap, every[near], rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_presses_on_a_hole(kind: int) -> None:
    at = np.array([[0.3, 0.2], [9.0, 5.0]])
    holes = Holes.of(SHEET, at[:1], 1.5)
    assert holes is not None
    touches = shaped(at, kind, friction=(0.1, 0.2))
    pressure = PressureWithHoles(whole=contact_frames(SHEET, touches), holes=holes)
    radii = np.array([0.0, 1.2, 1.8])
    width = np.array([0.1])
    turned = np.cross(SHEET.normal(at[:1]), [[1.0, 0.0, 0.0]])
    along = contact_frames(SHEET, touches).axis[:1] if kind == CYLINDER else turned
    arm = radii[None, :, None] * along[:, None]
    whole = pressure.whole(np.array([0]), arm, width, width)[0]
    np.testing.assert_allclose(pressure(np.array([0]), arm, width, width)[0], whole * [0, 0, 1])
    assert whole.min() > 0.5
    # 1 N all the same; the touch beside it is as it was.
    open_, plain = (
        indentation_loads(SHEET_MESH, SHEET, touches, holes=given).toarray()
        for given in (holes, None)
    )
    np.testing.assert_array_equal(open_[:, 1], plain[:, 1])
    for load in (open_, plain):
        total = load.reshape(-1, 6, 2)[:, :3].sum(axis=0)
        np.testing.assert_allclose(total[2], -1.0, atol=1e-12)
    # The pressure that the hole lacks is outside it: the second moment grows as theory says.
    if kind == FLAT:
        arm_xy = SHEET_MESH.nodes_mm[:, :2] - SHEET.point(at[:1])[0, :2]
        second = [
            -np.sum(load.reshape(-1, 6, 2)[:, 2, 0] * np.sum(arm_xy**2, axis=1))
            for load in (plain, open_)
        ]
        ring = (4.0**4 - 1.5**4) / (4.0**2 - 1.5**2) / 2.0 - 4.0**2 / 2.0
        assert second[1] - second[0] == pytest.approx(ring, rel=0.03)


def test_a_touch_on_nothing_but_a_hole_is_a_point_force() -> None:
    at = np.array([[0.3, 0.2]])
    touches = make_touches(at, FLAT, radius_mm=1.0)
    load = indentation_loads(SHEET_MESH, SHEET, touches, holes=Holes.of(SHEET, at, 1.5))
    point = indentation_loads(SHEET_MESH, SHEET, make_touches(at, FLAT, radius_mm=0.0))
    assert abs(load - point).max() < 1e-15
    assert Holes.of(SHEET, at, 0.0) is None
    assert Holes.of(SHEET, at[:0], 1.0) is None
