"""Section of the mechanics: how soft the shell is, its mesh, how well the model is conditioned."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.engine.stage import Context
from phytac_design.report import page
from phytac_design.report.drawing import Drawing
from phytac_design.report.explorer import softness_um_N


def mechanics_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Softness of each receptor's place, the wall's motion under the shown press, figures."""
    load = report["under_load"]
    kept = context.arrays("underload")
    maps = [
        draw.on_surface(
            softness_um_N(context),
            "Softness: inward motion of each marker under 1 N on its own cell",
            "µm/N",
            name="softness",
        )
    ]
    if len(kept["shown_uv"]):
        inward = -np.einsum("ni,ni->n", kept["shown_motion"][0][:, :3], context.markers.normal)
        maps.append(
            draw.on_surface(
                inward,
                f"Inward motion of the wall, pressed with {load['force_N']:g} N where the cross is",
                "mm",
                name="motion",
                cross=kept["shown_uv"][0],
            )
        )
    figures = {
        "how the wall's motion was found": load["theory"],
        "deepest dent (mm)": load["dent_mm"],
        "receptors stiffen the wall": report["response"]["receptors"],
        "nodes of the decoder's mesh": report["response"]["nodes"],
        "condition number of its compliance": report["condition_compliance"],
        "least image shift of a marker for inward motion (px/mm)": report["response"][
            "sensitivity_px_mm_least"
        ],
        "its median (px/mm)": report["response"]["sensitivity_px_mm_median"],
    }
    unknown = report["response"]["receptors_unknown"]
    note = f'<p class="foot">The wall is taken as plain: {unknown}.</p>' if unknown else ""
    return (
        page.side_by_side(*maps)
        + page.table(("figure", "value"), list(figures.items()))
        + note
        + "<h3>Mesh for other solvers, and the printed shell</h3>"
        + page.side_by_side(
            page.facts(report["mesh"], "mesh"), page.facts(report["shell"], "shell")
        )
    )
