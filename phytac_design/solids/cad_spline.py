"""Smooth curves and faces for CAD: cubic B-splines through samples of the exact geometry.

Samples are taken at equal steps of the parameters and refined until the spline is within
``FIT_mm`` half-way between them. Every spline along one edge has the same knots and end
conditions, so faces that share an edge share its curve exactly.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

FIT_mm = 1e-3
"""Largest distance between a spline and what it stands for, half-way between its samples."""


def cells_for(points_at: Callable[[FloatArray], FloatArray], knots: int) -> int:
    """Cells of [0, 1] whose cubic spline keeps to ``FIT_mm``; a multiple of ``knots``.

    Parameters
    ----------
    points_at : callable
        Points (n, ..., 3) of one or more curves at parameters (n,) in [0, 1].
    knots : int
        Equal spans of [0, 1] within which the curves are smooth.
    """
    cells_max = 512
    spans = 4
    while True:
        cells = knots * spans
        t = np.linspace(0.0, 1.0, 2 * cells + 1)
        points = points_at(t)
        spline = make_interp_spline(t[::2], points[::2], k=3)
        if float(np.linalg.norm(spline(t[1::2]) - points[1::2], axis=-1).max()) <= FIT_mm:
            return cells
        if 2 * cells > cells_max:
            raise NumericalError(
                "spline-too-many-cells",
                f"a curve of the wall needs more than {cells_max} spline cells to be exact to "
                f"{FIT_mm} mm; smooth the shape",
            )
        spans *= 2


def _array(kind: Any, values: list[Any]) -> Any:
    """OpenCASCADE array of a kind, which counts from 1."""
    array = kind(1, len(values))
    for k, value in enumerate(values, start=1):
        array.SetValue(k, value)
    return array


def _knot_arrays(spline: BSpline) -> tuple[Any, Any]:
    """Knots of a spline and their multiplicities, for OpenCASCADE."""
    from OCP.TColStd import TColStd_Array1OfInteger, TColStd_Array1OfReal

    knots, counts = np.unique(spline.t, return_counts=True)
    reals = _array(TColStd_Array1OfReal, knots.tolist())
    return reals, _array(TColStd_Array1OfInteger, counts.tolist())


def spline_edge(points_mm: FloatArray) -> Any:
    """``TopoDS_Edge`` of the cubic spline through points (n, 3) at equal parameter steps."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.Geom import Geom_BSplineCurve
    from OCP.gp import gp_Pnt
    from OCP.TColgp import TColgp_Array1OfPnt

    spline = make_interp_spline(np.linspace(0.0, 1.0, len(points_mm)), points_mm, k=3)
    poles = _array(TColgp_Array1OfPnt, [gp_Pnt(*point) for point in spline.c.tolist()])
    curve = Geom_BSplineCurve(poles, *_knot_arrays(spline), 3)
    return BRepBuilderAPI_MakeEdge(curve).Edge()


def spline_face(points_mm: FloatArray) -> Any:
    """``TopoDS_Face`` of the tensor spline through a grid (n, m, 3), at equal parameter steps.

    Cubic along a direction of four samples or more, straight along one of two.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.Geom import Geom_BSplineSurface
    from OCP.gp import gp_Pnt
    from OCP.TColgp import TColgp_Array2OfPnt

    degrees = [1 if count == 2 else 3 for count in points_mm.shape[:2]]
    first = make_interp_spline(
        np.linspace(0.0, 1.0, points_mm.shape[0]), points_mm, k=degrees[0], axis=0
    )
    second = make_interp_spline(
        np.linspace(0.0, 1.0, points_mm.shape[1]), first.c, k=degrees[1], axis=1
    )
    coefficients = np.moveaxis(second.c, 0, 1)
    rows, columns = coefficients.shape[:2]
    poles = TColgp_Array2OfPnt(1, rows, 1, columns)
    for i, row in enumerate(coefficients.tolist(), start=1):
        for j, point in enumerate(row, start=1):
            poles.SetValue(i, j, gp_Pnt(*point))
    (u, count_u), (v, count_v) = _knot_arrays(first), _knot_arrays(second)
    surface = Geom_BSplineSurface(poles, u, v, count_u, count_v, *degrees)
    return BRepBuilderAPI_MakeFace(surface, 1e-6).Face()


def flat_face(corners_mm: FloatArray) -> Any:
    """``TopoDS_Face`` of a plane polygon, corners (n, 3)."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
    from OCP.gp import gp_Pnt

    polygon = BRepBuilderAPI_MakePolygon()
    for point in corners_mm.tolist():
        polygon.Add(gp_Pnt(*point))
    polygon.Close()
    return BRepBuilderAPI_MakeFace(polygon.Wire(), True).Face()
