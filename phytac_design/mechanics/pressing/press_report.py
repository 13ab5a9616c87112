"""A press as text for people and as plain values for machines."""

from typing import Any

import numpy as np

from phytac_design.layout import Markers
from phytac_design.mechanics.large.quasi_newton import LINEAR_ERROR_SAFETY
from phytac_design.mechanics.pressing.press import Press


def press_warnings(result: Press, *, tolerance: float) -> list[str]:
    """What a reader should know before using the figures."""
    # Bending strain from which tough printing resins may yield: E·ε is then about 45 MPa.
    strain_limit, mesh_error_limit = 0.02, 0.1
    out = []
    if not result.large and result.linear_error > tolerance:
        out.append(
            f"linear theory is about {100 * result.linear_error:.2g} % off here (accepted "
            f"{100 * tolerance:g} %); --theory large is right"
        )
    if result.jumped:
        out.append(
            "the shell snaps, or may snap, before this force is reached; what is shown lies beyond"
        )
    if result.stable is False:
        out.append("the shell does not stay in the state shown while the force is held")
    if result.mesh_error is None or result.mesh_error > mesh_error_limit:
        out.append(f"the error of the mesh is {_mesh_error(result)}; raise --refine")
    if result.strain > strain_limit:
        out.append(
            f"the wall bends to a strain of about {100 * result.strain:.2g} %; beyond "
            f"{100 * strain_limit:g} % printing resins yield or break, which is not modelled"
        )
    return out


def press_dict(result: Press, markers: Markers, *, name: str, tolerance: float) -> dict[str, Any]:
    """Plain values; markers are the nearest ones, nearest first."""
    table = [
        {
            "marker": i,
            "row": int(markers.row[i]),
            "column": int(markers.column[i]),
            "distance_mm": round(away, 4),
            "wall_inward_mm": float(result.inward_mm[i]),
            "tip_mm": result.tip_mm[i].tolist(),
            "tip_px": None if result.tip_px is None else result.tip_px[i].tolist(),
        }
        for i, away in zip(result.near.tolist(), result.distance_mm.tolist(), strict=True)
    ]
    place = result.place
    return {
        "design": name,
        "force_N": place.force_N,
        "radius_mm": place.radius_mm,
        "uv": place.uv.tolist(),
        "theory": "large" if result.large else "linear",
        "linear_error": result.linear_error,
        "tolerance": tolerance,
        "receptors": result.receptors,
        "mesh_error": result.mesh_error,
        "stable": result.stable,
        "jumped": result.jumped,
        "peak_inward_mm": result.peak_mm,
        "peak_at_mm": result.peak_at_mm.tolist(),
        "centre_inward_mm": result.centre_mm,
        "bending_strain": result.strain,
        "markers": table,
        "unknowns": 6 * len(result.mesh.nodes_mm),
        "rounding_error": result.rounding,
        "residual": result.residual,
        "seconds": round(result.seconds, 3),
        "warnings": press_warnings(result, tolerance=tolerance),
    }


def press_text(result: Press, markers: Markers, *, name: str, tolerance: float) -> str:
    """Lines for a terminal."""
    place, (x, y, z) = result.place, result.peak_at_mm.tolist()
    error = 100.0 * result.linear_error
    if result.large:
        theory = f"large displacements; linear is about {error:.2g} % off"
    else:
        theory = f"linear, about {error:.2g} % off"
    where = f"radius {place.radius_mm:g} mm at (u, v) = ({place.uv[0]:.4g}, {place.uv[1]:.4g})"
    wall = "wall with receptors" if result.receptors else "plain wall"
    accepted = 100.0 * tolerance / LINEAR_ERROR_SAFETY
    peak = f"peak {result.peak_mm:.4g} mm inward at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
    lines = [
        f"{name}: {place.force_N:g} N inward on a disc of {where}",
        f"theory: {theory} (estimate; accepted {accepted:.2g} %); {wall}",
        f"{peak}, {result.centre_mm:.4g} mm at the contact's centre",
        "marker  row column  away mm          tip x, y, z mm               px  wall inward mm",
    ]
    for i, away in zip(result.near.tolist(), result.distance_mm.tolist(), strict=True):
        moved = " ".join(f"{value:9.4f}" for value in result.tip_mm[i].tolist())
        px = "-" if result.tip_px is None else f"{float(np.linalg.norm(result.tip_px[i])):.2f}"
        lines.append(
            f"{i:6d} {int(markers.row[i]):4d} {int(markers.column[i]):6d} {away:8.2f}  {moved} "
            f"{px:>7s} {result.inward_mm[i]:15.4f}"
        )
    lines.append(
        f"error of the mesh {_mesh_error(result)} of the largest motion, extrapolated; "
        f"{6 * len(result.mesh.nodes_mm)} unknowns, rounding error {result.rounding:.0e}, "
        f"{result.seconds:.1f} s"
    )
    return "\n".join(lines)


def _mesh_error(result: Press) -> str:
    if result.mesh_error is None:
        return "not known"
    return f"up to {100.0 * result.mesh_error:.2g} %"
