"""Parts for simulators: collision pieces, mass, frames and files, and MuJoCo where installed."""

import contextlib
import importlib.util
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.outer_hull import outer_hull_mm3
from phytac_design.fabrication.simulators.convex_pieces import convex_pieces
from phytac_design.fabrication.simulators.model_files import FORMATS
from phytac_design.fabrication.simulators.simulator_part import (
    base_z_mm,
    make_part,
    mass_properties,
)
from phytac_design.fabrication.simulators.xml_values import roll_pitch_yaw
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import box, hull, shell_manifold, to_triangles
from phytac_design.workflows import export_simulator as workflow
from phytac_design.workflows.export_simulator import export_simulator
from phytac_shapes.errors import DesignError, OutputError
from tests.coarse_switches import coarse_bowls
from tests.designs import tiny
from tests.fabrication.cases import shipped
from tests.test_cli import phytac

SHAPES = ("cone", "cuboid", "cylinder40", "grip", "hemisphere", "patch", "plane")
RESIN_kg_m3, RUBBER_kg_m3 = 1150.0, 1100.0
LENS = {"model": "brown_conrady", "distortion": (-0.1, 0.02, 1e-3, -2e-3)}
OFFSET_px = (3.0, -2.0)


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_fill_the_outer_hull(name: str) -> None:
    sensor = Sensor(shipped(name))
    pieces = convex_pieces(sensor)
    volume = sum(piece.volume_mm3 for piece in pieces)
    assert volume == pytest.approx(outer_hull_mm3(sensor), rel=0.035)
    assert len(pieces) < 80
    for piece in pieces:
        assert hull(piece.vertices_mm).volume() == pytest.approx(piece.volume_mm3, rel=1e-9)
    # Every marker's point lies on the union of the pieces.
    points = sensor.surface.point(sensor.markers.uv)
    height = np.full(len(points), np.inf)
    for piece in pieces:
        a, b, c = np.moveaxis(piece.corners_mm, 1, 0)
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal, axis=1)
        normal, a = normal[size > 1e-9] / size[size > 1e-9, None], a[size > 1e-9]
        over = (points @ normal.T - np.sum(a * normal, axis=1)).max(axis=1)
        height = np.minimum(height, over)
    assert height.max() < 0.1
    assert height.min() > -0.7  # of the patch: hulls of its cells stand out a little


@pytest.mark.parametrize(("name", "pieces"), [("cylinder40", 3), ("hemisphere", 2), ("plane", 5)])
def test_convex_shapes_are_not_divided(name: str, pieces: int) -> None:
    assert len(convex_pieces(Sensor(shipped(name)))) == pieces


def second_moments(mesh: Any, density: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, first and second moments by tetrahedra from the origin; SI."""
    corners = 1e-3 * mesh.corners_mm
    a, b, c = np.moveaxis(corners, 1, 0)
    weight = density * np.einsum("ni,ni->n", a, np.cross(b, c))
    total = corners.sum(axis=1)
    outer = np.einsum("nki,nkj->nij", corners, corners) + np.einsum("ni,nj->nij", total, total)
    return (
        float(weight.sum() / 6.0),
        (weight[:, None] * total).sum(axis=0) / 24.0,
        (weight[:, None, None] * outer).sum(axis=0) / 120.0,
    )


@pytest.mark.parametrize("name", ["hemisphere", "plane"])
def test_mass_and_inertia_are_those_of_the_printed_shell(name: str) -> None:
    sensor = Sensor(shipped(name))
    found = make_part(sensor, None).mass
    shell = to_triangles(shell_manifold(sensor))
    assert found.mass_kg == pytest.approx(1e-9 * shell.volume_mm3 * RESIN_kg_m3, rel=5e-3)
    shift = np.array([0.0, 0.0, -base_z_mm(sensor)])
    mass, first, second = second_moments(shell.moved(shift), RESIN_kg_m3)
    centre = first / mass
    about = second - mass * np.outer(centre, centre)
    inertia = np.trace(about) * np.eye(3) - about
    assert found.centre_m == pytest.approx(centre, abs=2e-5)
    size = np.abs(inertia).max()
    assert found.inertia_kg_m2 == pytest.approx(inertia, abs=0.01 * size)
    assert np.diag(found.inertia_kg_m2) == pytest.approx(np.diag(inertia), rel=0.01)


def test_mass_properties_of_two_boxes() -> None:
    low = np.array([-10.0, -20.0, -5.0])
    first = to_triangles(box(low, -low))
    second = first.moved(np.array([0.0, 0.0, 80.0]))
    found = mass_properties([(first, 1000.0), (second, 3000.0)])
    mass, (a, b, c) = 8e-3, (0.02, 0.04, 0.01)
    assert found.mass_kg == pytest.approx(4.0 * mass)
    assert found.centre_m == pytest.approx([0.0, 0.0, 0.06], abs=1e-12)
    arms = mass * 0.06**2 + 3.0 * mass * 0.02**2
    own = 4.0 * mass / 12.0 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    assert found.inertia_kg_m2 == pytest.approx(
        np.diag(own + np.array([arms, arms, 0.0])), abs=1e-15
    )


def test_angles_give_the_rotation_back() -> None:
    turns = list(Rotation.random(20, random_state=1).as_matrix())
    turns += [
        Rotation.from_euler("xyz", [0.3, pitch, 0.5]).as_matrix()
        for pitch in (-np.pi / 2.0, np.pi / 2.0)
    ]
    for turn in turns:
        back = Rotation.from_euler("xyz", roll_pitch_yaw(turn)).as_matrix()
        assert back == pytest.approx(turn, abs=1e-9)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A tiny design with an off-centre lens in all formats, with all frames."""
    folder = tmp_path_factory.mktemp("simulators")
    with pytest.MonkeyPatch.context() as patch, coarse_bowls():
        patch.setenv("PHYTAC_CACHE", str(folder / "cache"))
        for to in FORMATS:
            export_simulator(_design(), folder / to, to=to, receptors=True, progress=lambda _: None)
    return {to: folder / to for to in FORMATS}


def _design() -> Any:
    return tiny(name="tiny", camera=LENS | {"centre_offset_px": OFFSET_px, "fill": 0.9})


def xml_root(source: Path | str) -> ET.Element:
    """Root of an exported file, or of its text."""
    text = source if isinstance(source, str) else source.read_text(encoding="utf-8")
    return ET.fromstring(text)  # noqa: S314 - our own files


def values(text: str | None) -> np.ndarray:
    return np.array((text or "").split(), dtype=np.float64)


def posed(xyz: np.ndarray, turn: Rotation) -> tuple[np.ndarray, np.ndarray]:
    return xyz, turn.as_matrix()


def mjcf_frames(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    sites = xml_root(folder / "tiny.xml").iter("site")
    return {
        site.attrib["name"]: posed(
            values(site.attrib["pos"]),
            Rotation.from_quat(values(site.attrib["quat"]), scalar_first=True),
        )
        for site in sites
    }


def urdf_frames(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    out = {}
    for joint in xml_root(folder / "tiny.urdf").iter("joint"):
        parts = {part.tag: part.attrib for part in joint}
        assert (joint.attrib["type"], parts["parent"]["link"]) == ("fixed", "base")
        angles = values(parts["origin"]["rpy"])
        at = posed(values(parts["origin"]["xyz"]), Rotation.from_euler("xyz", angles))
        out[parts["child"]["link"]] = at
    return out


def sdf_frames(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    out = {}
    for frame in xml_root(folder / "model.sdf").iter("frame"):
        assert frame.attrib["attached_to"] == "base"
        pose = values(frame.findtext("pose"))
        out[frame.attrib["name"]] = posed(pose[:3], Rotation.from_euler("xyz", pose[3:]))
    return out


READERS = {"mjcf": mjcf_frames, "urdf": urdf_frames, "sdf": sdf_frames}


@pytest.mark.parametrize("to", list(FORMATS))
def test_frames_are_where_the_design_has_them(to: str, exported: dict[str, Path]) -> None:
    sensor = Sensor(_design())
    markers, camera = sensor.markers, sensor.cameras[0]
    # The near rim ends 4 mm before the sensing surface.
    shift = np.array([0.0, 0.0, 4.0])
    frames = READERS[to](exported[to])
    assert list(frames) == ["camera_optical", *(f"receptor_{k}" for k in range(markers.count))]
    at = np.array([frames[f"receptor_{k}"][0] for k in range(markers.count)])
    outer = markers.mid_mm + sensor.design.wall.thickness_mm / 2.0 * markers.normal
    assert np.abs(1e3 * at - (outer + shift)).max() < 1e-6
    turn = np.array([frames[f"receptor_{k}"][1] for k in range(markers.count)])
    assert turn[:, :, 2] == pytest.approx(markers.normal, abs=1e-9)
    position, axes = frames["camera_optical"]
    assert 1e3 * position == pytest.approx(camera.position_mm + shift, abs=1e-6)
    assert axes == pytest.approx(camera.rotation.T, abs=1e-9)


def test_mass_counts_the_switches(exported: dict[str, Path]) -> None:
    from phytac_design.fabrication.switch_set import revolved_volume_mm3

    sensor = Sensor(_design())
    with pytest.MonkeyPatch.context() as patch, coarse_bowls():
        patch.setenv("PHYTAC_CACHE", str(exported["mjcf"].parent / "cache"))
        switches = workflow.switches_for(sensor.design, lambda _: None)
    assert switches
    rubber = sum(
        len(switches.markers_of(kind)) * revolved_volume_mm3(switches.profile(kind))
        for kind in switches.kinds
    )
    resin = shell_manifold(sensor).volume()
    mass = 1e-9 * (resin * RESIN_kg_m3 + rubber * RUBBER_kg_m3)
    files = {"mjcf": "tiny.xml", "urdf": "tiny.urdf", "sdf": "model.sdf"}
    roots = {to: xml_root(exported[to] / name) for to, name in files.items()}
    inertial = {to: root.find(".//inertial") for to, root in roots.items()}
    found = {
        "mjcf": float(inertial["mjcf"].attrib["mass"]),
        "urdf": float(inertial["urdf"].find("mass").attrib["value"]),
        "sdf": float(inertial["sdf"].findtext("mass")),
    }
    assert found == pytest.approx(dict.fromkeys(found, mass), rel=5e-3)
    assert rubber * RUBBER_kg_m3 > 0.02 * resin * RESIN_kg_m3
    order = ("xx", "yy", "zz", "xy", "xz", "yz")
    full = values(inertial["mjcf"].attrib["fullinertia"])
    urdf = inertial["urdf"].find("inertia").attrib
    sdf = inertial["sdf"].find("inertia")
    assert [float(urdf[f"i{name}"]) for name in order] == full.tolist()
    assert [float(sdf.findtext(f"i{name}")) for name in order] == full.tolist()
    # Frames of URDF weigh nothing.
    links = roots["urdf"].findall("link")
    masses = [float(link.find("inertial/mass").attrib["value"]) for link in links]
    assert sum(masses) == masses[0] > 0.0


def test_meshes_are_metres_and_all_files_exist(exported: dict[str, Path]) -> None:
    sdf = xml_root(exported["sdf"] / "model.sdf")
    urdf = xml_root(exported["urdf"] / "tiny.urdf")
    mjcf = xml_root(exported["mjcf"] / "tiny.xml")
    named = {
        "sdf": [uri.text for uri in sdf.iter("uri")],
        "urdf": [mesh.attrib["filename"] for mesh in urdf.iter("mesh")],
        "mjcf": [mesh.attrib["file"] for mesh in mjcf.iter("mesh")],
    }
    for to, names in named.items():
        facts = json.loads((exported[to] / "export.json").read_text())
        assert {path.name for path in exported[to].iterdir()} == {*facts["files"], "export.json"}
        assert {f"{name}" for name in names} == {n for n in facts["files"] if n.endswith(".obj")}
    assert {name.partition("_")[0] for name in named["urdf"]} == {"visual", "collision"}
    shell = (exported["mjcf"] / "visual_resin.obj").read_text().splitlines()
    points = np.array([line.split()[1:] for line in shell if line[0] == "v"], dtype=np.float64)
    assert np.ptp(points[:, 2]) == pytest.approx(0.024 + 2 * 0.004, abs=1e-6)
    assert points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    touch = [item.attrib["site"] for item in mjcf.iter("touch")]
    assert touch == [f"receptor_{k}" for k in range(16)]


def test_programs_for_urdf_and_sdf_load_it(exported: dict[str, Path], tmp_path: Path) -> None:
    loaders = pytest.importorskip("benchmarks.connect_loaders")
    facts = json.loads((exported["urdf"] / "export.json").read_text())
    ways = []
    if importlib.util.find_spec("yourdfpy"):
        ways.append(("urdf", "tiny.urdf", lambda path: loaders.in_yourdfpy(path, 16)))
    if importlib.util.find_spec("pybullet"):
        ways.append(("urdf", "tiny.urdf", loaders.in_bullet))
    if loaders.has_sdformat():
        ways.append(("sdf", "model.sdf", loaders.in_sdformat))
    for to, name, load in ways:
        found = load(exported[to] / name)
        assert found.said == []
        assert found.mass_kg == pytest.approx(facts["mass_kg"], rel=1e-6)
        assert found.pieces in {facts["collision_pieces"], -1}
        # A fault is seen, or the program stops.
        bad = shutil.copytree(exported[to], tmp_path / load.__name__) / name
        text = bad.read_text().replace("collision_0.obj", "none.obj")
        bad.write_text(text.replace('attached_to="base"', 'attached_to="none"'))
        with contextlib.suppress(subprocess.CalledProcessError):
            assert load(bad).said


def test_intrinsics(exported: dict[str, Path]) -> None:
    lens = Sensor(_design()).cameras[0].lens
    centre = np.array([lens.width_px, lens.height_px]) / 2.0
    middle = lens.centre_px + 0.5 - centre
    assert middle == pytest.approx(OFFSET_px)
    camera = xml_root(exported["mjcf"] / "tiny.xml").find(".//camera")
    assert camera is not None
    assert values(camera.attrib["focalpixel"]).tolist() == [lens.fx_px, lens.fy_px]
    # As MuJoCo renders it: image's middle minus principal point.
    assert values(camera.attrib["principalpixel"]) == pytest.approx(-middle)
    assert camera.attrib["resolution"] == f"{lens.width_px} {lens.height_px}"
    sdf = xml_root(exported["sdf"] / "model.sdf").find(".//camera")
    assert sdf is not None
    for name, value in zip(("k1", "k2", "p1", "p2"), lens.distortion, strict=True):
        assert float(sdf.findtext(f"distortion/{name}") or "") == value
    names = ("fx", "fy", "cx", "cy")
    found = [float(sdf.findtext(f"lens/intrinsics/{name}") or "") for name in names]
    assert found == pytest.approx([lens.fx_px, lens.fy_px, *(lens.centre_px + 0.5)])
    # Gazebo's camera looks along x with y to the left.
    pose = values(xml_root(exported["sdf"] / "model.sdf").findtext(".//sensor/pose"))
    axes = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    assert axes[:, 0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert axes[:, 1] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-9)


def test_a_fisheye_has_no_distortion_terms_of_another_model() -> None:
    from dataclasses import replace

    from phytac_decoder.camera.lens import KannalaBrandt

    part = make_part(Sensor(tiny()), None)
    wide = KannalaBrandt(
        width_px=432,
        height_px=324,
        fx_px=161.0,
        fy_px=161.0,
        cx_px=215.5,
        cy_px=161.5,
        distortion=(0.01, 0.0, 0.0, 0.0),
    )
    part = replace(part, cameras=[replace(part.cameras[0], lens=wide)])
    assert "<distortion>" not in FORMATS["sdf"](part, receptors=False, prefix="")["model.sdf"]


def test_two_cameras_have_two_frames() -> None:
    part = make_part(Sensor(tiny(camera={"ends": "both"})), None)
    text = FORMATS["urdf"](part, receptors=False, prefix="package://robot/")["small.urdf"]
    links = [link.attrib["name"] for link in xml_root(text).findall("link")]
    assert links == ["base", "camera_optical", "camera_far_optical"]
    assert 'filename="package://robot/visual_resin.obj"' in text
    assert part.cameras[1].rotation[:, 2].tolist() == [0.0, 0.0, -1.0]


def test_the_same_design_gives_the_same_files(tmp_path: Path) -> None:
    design = tiny(receptor={"diameter_hole_mm": 0.0})
    for out in ("first", "second"):
        export_simulator(design, tmp_path / out, to="mjcf", progress=lambda _: None)
    files = {path.name: path.read_bytes() for path in (tmp_path / "first").iterdir()}
    assert files == {path.name: path.read_bytes() for path in (tmp_path / "second").iterdir()}


def test_another_export_into_a_folder_leaves_no_model_with_foreign_meshes(tmp_path: Path) -> None:
    design, folder = tiny(receptor={"diameter_hole_mm": 0.0}), tmp_path / "out"
    first = export_simulator(design, folder, to="mjcf", progress=lambda _: None)
    assert f"{design.name}.xml" in first["files"]
    table = json.loads((folder / "export.json").read_text())
    table["files"] += ["collision_99.obj", "../outside"]
    (folder / "export.json").write_text(json.dumps(table))
    for name in ("collision_99.obj", "mine.txt", "../outside"):
        (folder / name).write_text("")
    second = export_simulator(design, folder, to="urdf", progress=lambda _: None)
    names = {path.name for path in folder.iterdir()}
    assert names == {*second["files"], "export.json", "mine.txt"}
    assert (tmp_path / "outside").exists()


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DesignError) as found:
        export_simulator(tiny(wall={"thickness_mm": 0.1}), tmp_path / "out", to="sdf")
    assert found.value.code == "wall-too-thin"
    assert not (tmp_path / "out").exists()
    (tmp_path / "notes.txt").write_text("not ours")
    with pytest.raises(OutputError) as other:
        export_simulator(tiny(), tmp_path, to="sdf")
    assert other.value.code == "output-foreign"


def test_switches_that_cannot_be_made_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def impossible(*_: object) -> None:
        raise DesignError("switch-infeasible", "no bowl snaps there")

    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(workflow, "design_switches", impossible)
    said: list[str] = []
    facts = export_simulator(tiny(), tmp_path / "out", to="urdf", progress=said.append)
    assert "warning: exported without switches: no bowl snaps there" in said
    assert "visual_switches.obj" not in facts["files"]
    assert facts["receptors"] == 0


def test_the_command(tmp_path: Path) -> None:
    from phytac_design.design.design_file import to_toml

    design = tiny(name="post", receptor={"diameter_hole_mm": 0.0})
    (tmp_path / "post.toml").write_text(to_toml(design), encoding="utf-8")
    done = phytac("export", "post.toml", "--to", "sdf", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (facts["out"], facts["receptors"]) == ("exports/post-sdf", 16)
    assert (tmp_path / "exports" / "post-sdf" / "model.config").is_file()
    done = phytac("export", "post.toml", "--to", "urdf", "--out", "part", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 convex collision pieces" in done.stdout
    assert phytac("export", "post.toml", "--to", "step", cwd=tmp_path).returncode == 2


@pytest.fixture(scope="module")
def mujoco() -> Any:
    return pytest.importorskip("mujoco")


def test_mujoco_loads_what_was_designed(mujoco: Any, exported: dict[str, Path]) -> None:
    model = mujoco.MjModel.from_xml_path(str(exported["mjcf"] / "tiny.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sensor = Sensor(_design())
    facts = json.loads((exported["mjcf"] / "export.json").read_text())
    base = model.body("base").id
    assert model.body_mass[base] == pytest.approx(facts["mass_kg"], rel=1e-9)
    moments = np.linalg.eigvalsh(facts["inertia_kg_m2"])
    assert np.sort(model.body_inertia[base]) == pytest.approx(moments, rel=1e-6)
    # MuJoCo's own integral over the meshes that are shown.
    parts = []
    for name, density in (
        *((name, RESIN_kg_m3) for name in ("resin", "blue", "green")),
        ("switches", RUBBER_kg_m3),
    ):
        path = exported["mjcf"] / f"visual_{name}.obj"
        text = (
            f'<mujoco><asset><mesh name="m" file="{path}" inertia="exact"/></asset><worldbody>'
            f'<body><geom type="mesh" mesh="m" density="{density}"/></body></worldbody></mujoco>'
        )
        parts.append(float(mujoco.MjModel.from_xml_string(text).body_mass[1]))
    assert sum(parts) == pytest.approx(facts["mass_kg"], rel=5e-3)
    ids = [model.site(f"receptor_{k}").id for k in range(sensor.markers.count)]
    outer = sensor.surface.point(sensor.markers.uv) + np.array([0.0, 0.0, 4.0])
    assert np.abs(1e3 * data.site_xpos[ids] - outer).max() < 1e-6
    assert (model.cam_resolution[0] == [432, 324]).all()
    # The view's borders on a plane at the focal length, pixels from the axis: right, bottom.
    scene, camera = mujoco.MjvScene(model, 100), mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    view, lens = scene.camera[0], sensor.cameras[0].lens
    scale = lens.fx_px / view.frustum_near
    right = scale * (view.frustum_center + view.frustum_width)
    assert right == pytest.approx(lens.width_px - (lens.cx_px + 0.5), abs=1e-2)
    low = -scale * view.frustum_bottom
    assert low == pytest.approx(lens.height_px - (lens.cy_px + 0.5), abs=1e-2)


def test_mujoco_feels_a_weight_at_the_receptors_under_it(
    mujoco: Any, exported: dict[str, Path]
) -> None:
    spec = mujoco.MjSpec.from_string("<mujoco/>")
    part = mujoco.MjSpec.from_file(str(exported["mjcf"] / "tiny.xml"))
    # The sensor lies: its x axis points up.
    frame = spec.worldbody.add_frame(quat=[np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])
    spec.attach(part, prefix="palm/", frame=frame)
    ball = spec.worldbody.add_body(pos=[-0.016, 0.0, 0.0349])
    ball.add_freejoint()
    ball.add_geom(size=[0.005, 0.0, 0.0], mass=0.1)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, data)
    felt = {model.sensor(k).name: x for k, x in enumerate(data.sensordata) if x > 0.0}
    assert felt
    assert list(felt.values()) == pytest.approx([0.981] * len(felt), rel=0.05)
    sites = [name.replace("touch", "receptor") for name in felt]
    at = np.array([data.site(name).xpos for name in sites])
    assert np.linalg.norm(at - data.qpos[:3], axis=1).max() < 0.02
