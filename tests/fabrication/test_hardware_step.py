import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.spec import WallSection
from phytac_design.engine.stage import graphics_libraries
from phytac_design.fabrication.hardware.by_cad import CadKernel, hardware_bodies, sensor_bodies
from phytac_design.fabrication.hardware.by_mesh import MeshKernel
from phytac_design.fabrication.hardware.parts import COLOURS
from phytac_design.fabrication.hardware.sensor_solids import switch_mesh
from phytac_design.fabrication.hardware.solid_nodes import (
    Circle,
    Difference,
    Far,
    Intersection,
    Node,
    Polygon,
    Prism,
    Rect,
    Rod,
    Slab,
    Union,
)
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.cad import cad_facts, read_solid, shell_cad, write_assembly, write_solid
from phytac_design.stages.hardware_stage import HARDWARE
from tests.fabrication.cad_files import read_assembly, read_step
from tests.fabrication.cases import design
from tests.fabrication.hardware_cases import case, changed, context, solids, switches
from tests.refusals import refused

pytestmark = pytest.mark.skipif(
    not all(graphics_libraries().values()), reason="CadQuery needs graphics libraries; see README"
)
AGAIN = 1e-4
"""The design asks for volumes of an opened file to 0.01 %."""
DISC = Prism(outline=Circle(radius_mm=4.0, centre_mm=(1.0, 2.0)), low_mm=-1.0, high_mm=2.0)
BLOCK = Prism(outline=Rect(size_mm=(8.0, 6.0), centre_mm=(1.0, 2.0)), low_mm=0.0, high_mm=4.0)
ROUNDED = Prism(outline=Rect(size_mm=(10.0, 8.0), corner_mm=2.0), low_mm=0.0, high_mm=1.0)
QUAD = Prism(
    outline=Polygon(points_mm=((0.0, 0.0), (4.0, 0.0), (5.0, 3.0), (0.0, 2.0))),
    low_mm=1.0,
    high_mm=3.0,
)
ROD = Rod(start_mm=(0.0, 0.0, 0.0), end_mm=(6.0, 3.0, 2.0), radius_mm=1.0)


@pytest.mark.parametrize(
    ("node", "volume"),
    [
        (DISC, np.pi * 16.0 * 3.0),
        (BLOCK, 8.0 * 6.0 * 4.0),
        (ROUNDED, 80.0 - (4.0 - np.pi) * 4.0),
        (QUAD, 22.0),
        (ROD, np.pi * 7.0),
        (Slab(wall=WallSection()), None),
        (Union(parts=(DISC, BLOCK)), None),
        (Difference(body=BLOCK, tools=(DISC, ROD)), None),
        (Intersection(first=DISC, second=BLOCK), None),
        (Far(node=QUAD, z_mm=7.0), 22.0),
    ],
)
def test_both_kernels_make_the_same_solid(node: Node, volume: float | None) -> None:
    surface = case("cylinder60")[1]
    mesh, cad = MeshKernel(surface, 0.002).solid(node), CadKernel(surface).solid(node)
    facts = cad_facts(cad)
    assert facts.valid
    assert mesh.volume() == pytest.approx(facts.volume_mm3, rel=2e-4)
    if volume is not None:
        assert facts.volume_mm3 == pytest.approx(volume, rel=1e-9)
    box = cad.BoundingBox()
    found = [box.xmin, box.ymin, box.zmin, box.xmax, box.ymax, box.zmax]
    assert found == pytest.approx(list(mesh.bounding_box()), abs=0.01)


@pytest.mark.parametrize("name", ["cylinder60", pytest.param("patch", marks=pytest.mark.long)])
def test_parts_agree_and_come_back_from_step(name: str, tmp_path: Path) -> None:
    _, surface, _, kit = case(name)
    kernel = CadKernel(surface)
    shapes = {part.name: kernel.solid(part.node) for part in kit.parts}
    before = {name: cad_facts(shape) for name, shape in shapes.items()}
    for part in kit.parts:
        facts = before[part.name]
        assert (facts.valid, facts.solids) == (True, 1), part.name
        assert solids(name)[part.name].volume() == pytest.approx(facts.volume_mm3, rel=1e-3)
    path = tmp_path / "assembly.step"
    write_assembly(hardware_bodies(kit, shapes), path, name=name)
    again = read_assembly(path)
    assert set(again) == {part.name for part in kit.parts}
    for part in kit.parts:
        after = cad_facts(again[part.name].shape)
        assert after.valid
        assert after.volume_mm3 == pytest.approx(before[part.name].volume_mm3, rel=AGAIN)
        assert again[part.name].colour == pytest.approx(COLOURS[part.material], abs=0.01)
        box, old = again[part.name].shape.BoundingBox(), shapes[part.name].BoundingBox()
        assert (box.zmin, box.zmax) == pytest.approx((old.zmin, old.zmax), abs=1e-4)


def test_whole_sensor_in_one_assembly(tmp_path: Path) -> None:
    small = design(layout={"rows": 2, "columns": 4})
    surface = small.surface()
    markers = make_markers(small, surface)
    made = switches(small, surface, markers)
    sensor = Sensor.of(small, surface, markers)
    bodies = sensor_bodies(sensor, made, shell_cad(sensor))
    write_assembly(bodies, tmp_path / "sensor.step", name="case")
    again = read_assembly(tmp_path / "sensor.step")
    assert set(again) == {"shell"} | {f"switch_{k:04d}" for k in range(8)}
    total = sum(cad_facts(body.shape).volume_mm3 for name, body in again.items() if name != "shell")
    mesh = switch_mesh(surface, markers, made)
    assert total == pytest.approx(mesh.volume_mm3, rel=1e-3)
    # Each stands where its mesh does.
    for k in range(8):
        centre = again[f"switch_{k:04d}"].shape.Center().toTuple()
        axis = markers.normal[k]
        foot = surface.point(markers.uv[k : k + 1])[0]
        aside = np.array(centre) - foot
        assert np.linalg.norm(aside - (aside @ axis) * axis) < 1e-3


def test_a_solid_is_read_as_it_was_written(tmp_path: Path) -> None:
    *parts, _ = _tiny()
    shell = shell_cad(Sensor.of(*parts))
    write_solid(shell, tmp_path / "shell.bin")
    assert cad_facts(read_solid(tmp_path / "shell.bin")) == cad_facts(shell)


def test_stage_writes_the_same_bytes_again(tmp_path: Path) -> None:
    def run(folder: Path) -> dict[str, str]:
        out = folder / "out"
        out.mkdir(parents=True)
        HARDWARE.run(context(changed("hemisphere"), folder), out)
        return {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(out.rglob("*.*"))
        }

    first, second = run(tmp_path / "a"), run(tmp_path / "b")
    assert first == second
    assert {"assembly.step", "mount.step", "mount.stl", "cover.step", "cover.stl"} <= set(first)
    fixtures = tmp_path / "a" / "out" / "export" / "fixtures"
    assembly = read_assembly(fixtures / "assembly.step")
    assert "shell_without_receptors" in assembly
    alone, inside = read_step(fixtures / "mount.step"), assembly["mount"].shape
    assert alone.Volume() == pytest.approx(inside.Volume(), rel=AGAIN)


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    *parts, made = _tiny()
    sensor = Sensor.of(*parts)
    bodies: list[Any] = sensor_bodies(sensor, made, shell_cad(sensor))[:1]
    with refused("output-not-writable"):
        write_assembly(bodies, tmp_path / "none" / "a.step", name="case")


def _tiny() -> tuple[Any, ...]:
    small = design(layout={"rows": 1, "columns": 2})
    surface = small.surface()
    markers = make_markers(small, surface)
    return small, surface, markers, switches(small, surface, markers)
