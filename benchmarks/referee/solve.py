"""Solve the frozen contacts: ``python -m benchmarks.referee.solve --design cylinder60``."""

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, replace
from functools import cache
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import phytac_design.mechanics.solid as solid_package
from benchmarks.referee.contacts import COUNTS, Contact, load_contacts
from benchmarks.referee.read import Solved, data_file, read_solved, sensor_hash, write_solved
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.solid.load import solid_patch_load
from phytac_design.mechanics.solid.solid_mesh_tets import SolidSizes
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError, PhytacError
from verification.calculix import ccx_version, read_convergence, run_ccx, write_reference_inp
from verification.partial_solid import AS_TABLES, PartMesh, PartSizes, part_mesh
from verification.tip_motion import tips_motion, tips_turn

SEVERAL = 3
"""Contacts of more patches are solved after all others."""
REACHES = (1.0, 1.06, 0.94, 1.12)
"""Shares of the region with true receptors that are tried in turn."""


@cache
def sensor(name: str) -> Sensor:
    """Sensor of a shipped design."""
    return Sensor(load_design(name))


def sizes_for(design: Design, contact: Contact) -> PartSizes:
    """Mesh of a contact."""
    thickness, receptor = design.wall.thickness_mm, design.receptor
    tube_wall = (receptor.diameter_outer_mm - receptor.diameter_hole_mm) / 2.0
    return PartSizes(
        near=SolidSizes(
            wall_mm=1.5 * thickness,
            foot_mm=0.25 * thickness,
            tube_mm=1.4 * tube_wall,
            contact_mm=1.1 * thickness,
        ),
        middle=SolidSizes(
            wall_mm=1.75 * thickness,
            foot_mm=0.3 * thickness,
            tube_mm=1.4 * tube_wall,
            contact_mm=1.75 * thickness,
        ),
        far_mm=2.8 * thickness,
        near_mm=5.0,
        reach_mm=20.0 if len(contact.uv) == 1 else 15.0,
    )


def input_key(this: Sensor, contact: Contact, sizes: PartSizes) -> str:
    """Hash of all that a solution depends on but versions of programs."""
    text = json.dumps(
        # The first number is raised when a change of this script makes solved contacts void.
        [1, sensor_hash(this.design, this.markers), asdict(contact), asdict(sizes)]
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def script_hash() -> str:
    """Hash of the code that meshes and solves."""
    files = [Path(__file__), *sorted(Path(str(solid_package.__file__)).parent.glob("*.py"))]
    total = hashlib.sha256()
    for path in files:
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()[:16]


def part_of(this: Sensor, contact: Contact, sizes: PartSizes) -> PartMesh:
    """Mesh for a contact."""
    return part_mesh(
        this.design,
        this.surface,
        this.markers,
        contacts_uv=contact.centres,
        radii_mm=np.array(contact.radius_mm),
        sizes=sizes,
        smear=AS_TABLES,
    )


def total_load(this: Sensor, mesh: PartMesh, contact: Contact) -> FloatArray:
    """Nodal forces (N, 3) of all patches."""
    load = np.zeros_like(mesh.nodes_mm)
    for uv, radius, force in zip(contact.centres, contact.radius_mm, contact.force_N, strict=True):
        load += force * solid_patch_load(mesh, this.surface, uv, radius)
    return load


def solve_contact(
    name: str, index: int, contact: Contact, sizes: PartSizes | None = None
) -> Solved:
    """Solve one contact.

    Raises
    ------
    NumericalError
        If CalculiX does not reach the full load.
    """
    this = sensor(name)
    design = this.design
    sizes = sizes_for(design, contact) if sizes is None else sizes
    start = time.perf_counter()
    mesh = part_of(this, contact, sizes)
    load = total_load(this, mesh, contact)
    meshed = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = write_reference_inp(
            Path(folder) / "job.inp",
            mesh,
            modulus_MPa=design.material.modulus_MPa * mesh.modulus_ratio,
            poisson=design.material.poisson,
            load=load,
            name=design.name,
            large=True,
            # Large loads begin with a half.
            first=1.0 if max(contact.force_N) <= 6.0 else 0.5,
        )
        tables = run_ccx(path)
        went = asdict(read_convergence(path))
    if abs(went["factor"] - 1.0) > 1e-6:
        raise NumericalError(
            "calculix-stopped-early",
            f"ccx stopped at {went['factor']:.4g} of the load of contact {index}",
        )
    nodes, found = tables[-1]["displacements", "ALL"]
    motion = np.zeros_like(mesh.nodes_mm)
    motion[nodes] = found
    tips = tips_motion(mesh, this.markers, motion, far_mm=sizes.far_mm)
    return Solved(
        index=index,
        contact=contact,
        motion_mm=tips,
        kept=mesh.kept,
        turn_rad=tips_turn(mesh, motion),
        facts={
            **went,
            "peak_mm": float(np.linalg.norm(tips, axis=1).max()),
            "wall_peak_mm": float(np.linalg.norm(motion, axis=1).max()),
            "resultant_N": np.round(load.sum(axis=0), 6).tolist(),
            "nodes": len(mesh.nodes_mm),
            "tets": len(mesh.tets),
            "mesh_s": round(meshed - start, 1),
            "ccx_s": round(time.perf_counter() - meshed, 1),
            "ccx": ccx_version(),
            "gmsh": version("gmsh"),
            "script": script_hash(),
            "key": input_key(this, contact, sizes),
        },
    )


def solve_with_patience(name: str, index: int, contact: Contact) -> Solved:
    """Solve one contact; where the mesher fails at some tangency, with a slightly other region.

    Raises
    ------
    NumericalError
        If no mesh is found, or CalculiX does not reach the full load.
    """
    this = sensor(name)
    sizes = sizes_for(this.design, contact)
    for reach in REACHES:
        try:
            done = solve_contact(
                name, index, contact, replace(sizes, reach_mm=reach * sizes.reach_mm)
            )
        except NumericalError as error:
            if error.code != "gmsh-failed" or reach == REACHES[-1]:
                raise
            continue
        return replace(
            done, facts={**done.facts, "key": input_key(this, contact, sizes), "reach": reach}
        )
    raise NumericalError("referee-mesh-missing", f"no mesh for contact {index}")


def waiting(name: str) -> Iterator[tuple[int, Contact]]:
    """Contacts that are not solved yet, or not with these inputs."""
    this = sensor(name)
    keys = {item.index: item.facts["key"] for item in stored(name)}
    for index, contact in enumerate(load_contacts(name)):
        if keys.get(index) != input_key(this, contact, sizes_for(this.design, contact)):
            yield index, contact


def stored(name: str) -> list[Solved]:
    """What is solved so far; nothing where there is no file."""
    this = sensor(name)
    path = data_file(name)
    return read_solved(path, this.design, this.markers) if path.is_file() else []


def keep(name: str, item: Solved) -> int:
    """Add a contact to the file, or replace it; how many there are now."""
    this = sensor(name)
    others = [old for old in stored(name) if old.index != item.index]
    write_solved(data_file(name), this.design, this.markers, [*others, item])
    return len(others) + 1


def run(name: str, *, limit: int | None, processes: int) -> int:
    """Solve what waits; how many failed."""
    # The most expensive last: a part of the set then has all kinds in it, and is soon there.
    queue = sorted(waiting(name), key=lambda item: len(item[1].uv) > SEVERAL)[:limit]
    print(f"{name}: {len(queue)} of {len(load_contacts(name))} contacts to solve", flush=True)
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        futures = {pool.submit(solve_with_patience, name, k, one): k for k, one in queue}
        return sum(not _finish(name, done, futures[done]) for done in as_completed(futures))


def _finish(name: str, future: "Future[Solved]", index: int) -> bool:
    """Store a contact and say so; False if it failed."""
    try:
        item = future.result()
    except PhytacError as error:
        print(f"{name} {index}: FAILED: {error}", flush=True)
        return False
    count = keep(name, item)
    facts: dict[str, Any] = dict(item.facts)
    print(
        f"{time.strftime('%H:%M')} {name} {index} ({item.contact.kind}, "
        f"{'+'.join(f'{f:.3g}' for f in item.contact.force_N)} N): peak {item.peak_mm:.4f} mm, "
        f"{facts['nodes']} nodes, {facts['increments']} increments, {facts['iterations']} "
        f"iterations, mesh {facts['mesh_s']} s, ccx {facts['ccx_s']} s; {count} solved",
        flush=True,
    )
    return True


def main() -> int:
    """Solve the contacts of one design."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--design", default="cylinder60", choices=list(COUNTS))
    parser.add_argument("--limit", type=int, help="solve at most this many")
    parser.add_argument("--processes", type=int, default=1, help="of one core and 1 to 3 GB each")
    given = parser.parse_args()
    return 1 if run(given.design, limit=given.limit, processes=given.processes) else 0


if __name__ == "__main__":
    sys.exit(main())
