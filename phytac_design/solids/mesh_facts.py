"""Volume, area, bodies and genus of a solid mesh, by manifold3d and independently by trimesh."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import Markers
from phytac_design.solids.solid_mesh import to_triangles
from phytac_shapes import Surface
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class ShellFacts:
    """Properties of a solid for the printer and the report.

    Attributes
    ----------
    volume_mm3, area_mm2 : float
        Enclosed volume and total surface area.
    watertight : bool
        Every edge has exactly two triangles, of opposite direction.
    bodies : int
        Connected components.
    genus : int
        Handles, summed over bodies.
    bounds_mm : (2, 3) nested tuple of float
        Least and greatest corner of the bounding box.
    triangles : int
        Number of triangles.
    """

    volume_mm3: float
    area_mm2: float
    watertight: bool
    bodies: int
    genus: int
    bounds_mm: tuple[tuple[float, ...], tuple[float, ...]]
    triangles: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``report.json``."""
        return asdict(self)


def expected_genus(surface: Surface, markers: Markers, *, holes: bool = True) -> int:
    """Genus of a shell with one through-hole for each marker, or with none.

    The wall of a tube is a solid torus (genus 1), that of a dome or a sheet a ball (genus 0).
    Receptors add none; every through-hole joins inside and outside once more and adds one (derived
    here).
    """
    tube = surface.periodic[1] and not any(surface.poles)
    return int(tube) + markers.count * holes


def manifold_facts(solid: Any) -> ShellFacts:
    """Facts of a ``manifold3d.Manifold``, which is watertight by construction if not empty."""
    parts = solid.decompose()
    box = solid.bounding_box()
    return ShellFacts(
        volume_mm3=float(solid.volume()),
        area_mm2=float(solid.surface_area()),
        watertight=not solid.is_empty(),
        bodies=len(parts),
        genus=sum(int(part.genus()) for part in parts),
        bounds_mm=(tuple(map(float, box[:3])), tuple(map(float, box[3:]))),
        triangles=int(solid.num_tri()),
    )


def trimesh_facts(mesh: TriangleMesh) -> ShellFacts:
    """Return the same facts by trimesh, an independent program, from nothing but the triangles."""
    import trimesh

    body = trimesh.Trimesh(mesh.vertices_mm, mesh.triangles, process=False)
    bodies = int(body.body_count)
    low, high = np.asarray(body.bounds, dtype=np.float64)
    return ShellFacts(
        volume_mm3=float(body.volume),
        area_mm2=float(body.area),
        watertight=bool(body.is_watertight and body.is_winding_consistent),
        bodies=bodies,
        genus=bodies - int(body.euler_number) // 2,
        bounds_mm=(tuple(map(float, low)), tuple(map(float, high))),
        triangles=len(mesh.triangles),
    )


def shell_facts(
    solid: Any, surface: Surface, markers: Markers, *, holes: bool = True
) -> ShellFacts:
    """Facts of a finished shell; rejected unless it is one watertight body of the right genus.

    ``holes`` says whether receptors are tubes with a through-hole, not solid posts.

    Raises
    ------
    NumericalError
        If manifold3d and trimesh disagree, or bodies or genus are not what the holes make them.
    """
    facts = manifold_facts(solid)
    other = trimesh_facts(to_triangles(solid))
    genus = expected_genus(surface, markers, holes=holes)
    seen = {(f.watertight, f.bodies, f.genus) for f in (facts, other)}
    if seen != {(True, 1, genus)}:
        raise NumericalError(
            "shell-not-watertight",
            f"the shell is not one watertight body of genus {genus} (got watertight "
            f"{facts.watertight}, {facts.bodies} bodies, genus {facts.genus}; by trimesh "
            f"{other.watertight}, {other.bodies}, {other.genus}): receptors probably meet; "
            "run `phytac check` on the design",
        )
    return facts
