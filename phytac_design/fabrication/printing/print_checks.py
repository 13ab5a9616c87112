"""All print rules on one body, and on a sensor's shell."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.overhang import (
    Orientation,
    Overhang,
    overhangs,
    stand,
    suggest,
)
from phytac_design.fabrication.printing.receptors import check_receptors, owners
from phytac_design.fabrication.printing.surface_samples import sample_faces, welded
from phytac_design.fabrication.printing.thickness import check_thickness
from phytac_design.fabrication.printing.violations import Violation, in_order, violation
from phytac_design.fabrication.printing.voids import cups, sealed, undrained
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.sensor import Sensor
from phytac_shapes.arrays import BoolArray, FloatArray

SPACING_mm = 0.7
"""Default distance between the points at which thickness is measured."""


@dataclass(frozen=True, kw_only=True)
class PrintReport:
    """Result of all print rules on a body.

    Attributes
    ----------
    violations : tuple of Violation
        Every place that breaks a rule.
    standing : Orientation
        How the body stands in its build direction.
    supports : tuple of Overhang
        Parts of its surface that need supports there, largest first.
    wall_mm : float
        Thinnest wall that was measured off the receptors; inf if none is thin.
    tried : int
        Build directions that were compared; 0 where the design sets one.
    """

    violations: tuple[Violation, ...]
    standing: Orientation
    supports: tuple[Overhang, ...]
    wall_mm: float
    tried: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for files and reports."""
        listed = 20  # supported regions that a report lists, the largest first
        return {
            "violations": [item.as_dict() for item in self.violations],
            "orientation": self.standing.as_dict() | {"directions_compared": self.tried},
            "supports": {
                "regions": len(self.supports),
                "area_mm2": sum(item.area_mm2 for item in self.supports),
                "largest": [
                    {
                        "point_mm": [round(x, 3) for x in item.point_mm],
                        "area_mm2": round(item.area_mm2, 3),
                        "slope_deg": round(item.slope_deg, 2),
                    }
                    for item in self.supports[:listed]
                ],
            },
            "wall_least_mm": None if np.isinf(self.wall_mm) else round(self.wall_mm, 4),
        }


def check_body(
    mesh: TriangleMesh,
    rules: PrintSection,
    *,
    spacing_mm: float = SPACING_mm,
    tolerance_mm: float = 0.01,
    up: FloatArray | None = None,
) -> PrintReport:
    """All print rules on any closed body: a shell, a mold, a fixture.

    Parameters
    ----------
    mesh : TriangleMesh
        Closed, one or more bodies that are printed as they stand to each other.
    rules : PrintSection
        The printer's.
    spacing_mm : float
        Distance between the points at which thickness is measured.
    tolerance_mm : float
        Distance of the facets from the true faces.
    up : (3,) float, optional
        Build direction; by default that of the rules.
    """
    return _check(mesh, rules, spacing_mm, tolerance_mm, up=up)


def check_shell(
    sensor: Sensor,
    mesh: TriangleMesh,
    *,
    spacing_mm: float = SPACING_mm,
    tolerance_mm: float = 0.01,
) -> PrintReport:
    """All print rules on a sensor's shell: its receptors from the design, the rest measured."""
    design, markers = sensor.design, sensor.markers
    rules = design.print_rules

    def known(points: FloatArray) -> BoolArray:
        return owners(sensor, points) >= 0

    report = _check(mesh, rules, spacing_mm, tolerance_mm, known=known)
    at = np.array([item.point_mm for item in report.violations]).reshape(-1, 3)
    owned = owners(sensor, at)
    measured = [
        replace(item, marker=int(k)) if k >= 0 else item
        for item, k in zip(report.violations, owned, strict=True)
    ]
    violations = in_order(measured + check_receptors(design, markers))
    return replace(report, violations=tuple(violations))


def _check(
    mesh: TriangleMesh,
    rules: PrintSection,
    spacing_mm: float,
    tolerance_mm: float,
    *,
    up: FloatArray | None = None,
    known: Any = None,
) -> PrintReport:
    support_min_mm2 = 0.2  # smaller overhangs bridge themselves
    mesh = welded(mesh)
    tree = RayTree(mesh)
    tried = 0
    if up is None and rules.build_direction != "suggested":
        up = np.array(rules.build_direction)
    if up is None:
        standing, tried = suggest(mesh, tree, rules)
    else:
        standing = stand(mesh, tree, up / np.linalg.norm(up), rules)
    way = np.array(standing.up)
    samples = sample_faces(tree, spacing_mm)
    thin, wall_mm = check_thickness(
        tree,
        samples,
        rules,
        spacing_mm=spacing_mm,
        tolerance_mm=tolerance_mm,
        known=np.zeros(len(samples.triangle), dtype=np.bool_)
        if known is None
        else known(samples.point_mm),
    )
    supports = [
        item for item in overhangs(mesh, tree, way, rules) if item.area_mm2 > support_min_mm2
    ]
    shut = sealed(mesh, rules)
    found = [*thin, *shut, *_other_hollows(undrained(mesh, rules), shut)]
    if rules.process == "sla":
        found += cups(mesh, way, rules)
    if rules.supports == "none":
        found += [_overhang(item, rules) for item in supports]
    if not standing.fits:
        found.append(_too_large(mesh, standing, rules))
    return PrintReport(
        violations=tuple(in_order(found)),
        standing=standing,
        supports=tuple(supports),
        wall_mm=wall_mm,
        tried=tried,
    )


def _other_hollows(slow: list[Violation], shut: list[Violation]) -> list[Violation]:
    """Hollows of the grid that are not also known as closed faces."""
    at = np.array([item.point_mm for item in shut]).reshape(-1, 3)
    return [
        item
        for item in slow
        if item.measured > 0.0
        or not len(at)
        or np.linalg.norm(at - np.array(item.point_mm), axis=1).min() > item.asked
    ]


def _overhang(item: Overhang, rules: PrintSection) -> Violation:
    fix = f"{item.area_mm2:.1f} mm² hang free; turn the part or slope the face"
    point, required = np.array(item.point_mm), rules.overhang_deg
    return violation("overhang", point, item.slope_deg, required, fix, unit="deg")


def _too_large(mesh: TriangleMesh, standing: Orientation, rules: PrintSection) -> Violation:
    size = np.array([*standing.footprint_mm, standing.height_mm])
    worst = int(np.argmax(size / np.array(rules.bed_mm)))
    middle = (mesh.vertices_mm.max(axis=0) + mesh.vertices_mm.min(axis=0)) / 2.0
    fix = "print it in parts (they are written where it can be parted), or on a larger printer"
    return violation("bed", middle, size[worst], rules.bed_mm[worst], fix)
