"""The shell mesh for other solvers: Abaqus/CalculiX, Gmsh, VTK."""

from pathlib import Path

import numpy as np

from phytac_design.stage import Context, Stage, export_path, write_facts

LOAD_N = 10.0
"""Force of the ready load step: a fingertip in the middle of the sensor."""


def run(context: Context, folder: Path) -> None:
    """Write ``mesh/shell.{inp,msh,vtu}`` with a fingertip load step and its linear result."""
    from phytac_design.mechanics.export import write_inp, write_msh, write_vtu
    from phytac_design.mechanics.loads import patch_loads
    from phytac_design.mechanics.mesh import marker_mesh
    from phytac_design.mechanics.solve import clamped_model

    design, surface, markers = context.design, context.surface, context.markers
    mesh = marker_mesh(
        surface,
        markers,
        thickness_mm=design.wall.thickness_mm,
        refine=context.accuracy.refine,
    )
    middle = surface.domain.mean(axis=1)[None]
    nearest = int(
        np.argmin(np.linalg.norm(surface.point(middle) - surface.point(markers.uv), axis=1))
    )
    radius = design.training.patch_radius_max_mm
    load = LOAD_N * patch_loads(mesh, surface, markers.uv[[nearest]], np.array([radius]))
    model = clamped_model(
        mesh, modulus_MPa=design.material.modulus_MPa, poisson=design.material.poisson
    )
    motion = model.solve(load).motion[:, :, 0]
    write_inp(
        export_path(folder, "mesh/shell.inp"),
        mesh,
        modulus_MPa=design.material.modulus_MPa,
        poisson=design.material.poisson,
        load=load,
        name=design.name,
    )
    write_msh(export_path(folder, "mesh/shell.msh"), mesh)
    write_vtu(export_path(folder, "mesh/shell.vtu"), mesh, motion=motion)
    at = int(mesh.marker_nodes[nearest])
    write_facts(
        folder,
        {
            "nodes": len(mesh.nodes_mm),
            "elements": len(mesh.quads),
            "load_N": LOAD_N,
            "load_radius_mm": radius,
            "load_marker": nearest,
            "inward_mm_at_load": float(-motion[at, :3] @ mesh.normals[at]),
        },
    )


MESH = Stage(
    name="mesh",
    tables=("name", "shape", "wall", "layout", "material", "training"),
    knobs=("refine",),
    run=run,
)
