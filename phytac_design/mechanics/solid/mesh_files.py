"""Meshes of a sensor as files for other programs: the shell, and the solid."""

import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.pressing.contact_patch import ContactPatch
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.mesh_writers import write_inp, write_msh, write_vtu
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.solid.load import solid_patch_load
from phytac_design.mechanics.solid.solid_mesh_tets import (
    SolidSizes,
    check_nodes,
    coarsened,
    solid_mesh,
)
from phytac_design.mechanics.solid.solid_writers import (
    write_solid_inp,
    write_solid_msh,
    write_solid_vtu,
)
from phytac_shapes.errors import DesignError, OutputError

FORMATS = ("inp", "msh", "vtu")


def check_formats(formats: Collection[str]) -> None:
    """Refuse formats that are not known, or none.

    Raises
    ------
    DesignError
        If there is no format, or an unknown one.
    """
    wrong = sorted(set(formats) - set(FORMATS))
    if wrong or not formats:
        raise DesignError(
            "mesh-format-unknown",
            f"formats are {', '.join(FORMATS)} (got {', '.join(wrong) or 'none'}); e.g. inp,vtu",
        )


def make_folder(folder: Path) -> None:
    """Make a folder for files, before any long work.

    Raises
    ------
    OutputError
        If it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.write_text("")
        probe.unlink()
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {folder}: {error.strerror}; choose another --out"
        ) from None


def write_shell_files(
    folder: Path,
    sensor: Sensor,
    place: ContactPatch,
    *,
    refine: int,
    formats: Collection[str] = FORMATS,
) -> dict[str, Any]:
    """Write ``shell.{inp,msh,vtu}``: the plain wall, markers as nodes, the press as a load step.

    The wall has no tubes and holes here, so that one section serves every program; the ``.vtu``
    holds the linear motion that the ``.inp`` gives.

    Returns
    -------
    dict
        ``nodes``, ``elements`` and ``inward_mm_at_load`` (at the node nearest the contact).
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    check_formats(formats)
    material = design.material
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=refine)
    load = place.force_N * patch_loads(mesh, surface, place.uv[None], place.radius_mm)
    model = sensor_model(design, markers, mesh, receptors=False)
    motion = model.solve(load).motion[:, :, 0]
    if "inp" in formats:
        write_inp(
            folder / "shell.inp",
            mesh,
            modulus_MPa=material.modulus_MPa,
            poisson=material.poisson,
            load=load,
            name=design.name,
        )
    if "msh" in formats:
        write_msh(folder / "shell.msh", mesh)
    if "vtu" in formats:
        write_vtu(folder / "shell.vtu", mesh, motion=motion)
    centre = surface.point(place.uv[None])
    at = int(np.argmin(np.linalg.norm(mesh.nodes_mm - centre, axis=1)))
    return {
        "nodes": len(mesh.nodes_mm),
        "elements": len(mesh.quads),
        "inward_mm_at_load": float(-motion[at, :3] @ mesh.normals[at]),
    }


def check_solid(
    sensor: Sensor, place: ContactPatch, *, size: float | None
) -> tuple[float, SolidSizes, int]:
    """Factor, sizes and expected nodes of a solid (:func:`solid.mesh.coarsened`), before any work.

    Raises
    ------
    DesignError
        If the shape is not closed around and open at both ends, the mesh would be too large, or
        the patch has no radius.
    """
    surface = sensor.surface
    if surface.periodic != (False, True) or any(surface.poles):
        raise DesignError(
            "solid-shape-unsupported",
            f"solid meshes are made of shapes that close around and are open at both ends, so far "
            f"(got {surface.name!r}); leave out --solid for the shell",
        )
    if not place.radius_mm > 0.0:
        raise DesignError(
            "solid-radius-missing", "a solid is pressed on a disc: give --radius above 0 (got 0)"
        )
    return coarsened(sensor, size)


def write_solid_files(
    folder: Path,
    sensor: Sensor,
    place: ContactPatch,
    *,
    size: float | None = None,
    formats: Collection[str] = FORMATS,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write ``solid.{inp,msh,vtu}``: quadratic tetrahedra of the true CAD, and the same press.

    Parameters
    ----------
    folder : Path
        Existing folder.
    design, surface, markers, place
        The sensor and the press.
    size : float, optional
        Factor on the sizes of :func:`solid.mesh.default_sizes`; if left out, the least of 1 or more
        that is expected to keep the mesh at :data:`solid.mesh.SETTINGS`.
    formats : collection of str
        Of ``inp``, ``msh``, ``vtu``.
    progress : callable
        Called with a line about what is being done.

    Returns
    -------
    dict
        ``nodes``, ``elements``, ``size``, ``expected_nodes`` and ``seconds``.

    Raises
    ------
    DesignError
        As :func:`check_solid`.
    MissingPartError
        If Gmsh or CadQuery is not installed.
    """
    design, surface = sensor.design, sensor.surface
    check_formats(formats)
    start = time.perf_counter()
    factor, sizes, expected = check_solid(sensor, place, size=size)
    progress(
        f"mesh: solid of about {round(expected, -4)} nodes (sizes × {factor:.2g}), CAD and gmsh …"
    )
    mesh = solid_mesh(
        sensor, sizes=sizes, contacts_uv=place.uv[None], contact_radius_mm=place.radius_mm
    )
    check_nodes(len(mesh.nodes_mm), factor)
    progress(f"mesh: {len(mesh.nodes_mm)} nodes, writing")
    if "inp" in formats:
        write_solid_inp(
            folder / "solid.inp",
            mesh,
            modulus_MPa=design.material.modulus_MPa,
            poisson=design.material.poisson,
            load=place.force_N * solid_patch_load(mesh, surface, place.uv, place.radius_mm),
            name=design.name,
        )
    if "msh" in formats:
        write_solid_msh(folder / "solid.msh", mesh)
    if "vtu" in formats:
        write_solid_vtu(folder / "solid.vtu", mesh)
    return {
        "nodes": len(mesh.nodes_mm),
        "elements": len(mesh.tets),
        "size": round(factor, 4),
        "expected_nodes": expected,
        "seconds": round(time.perf_counter() - start, 1),
    }
