"""What a contact at any place does to the markers' images: tables for the estimator ``auto``."""

from pathlib import Path

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle_locator import response_arrays, response_from_arrays
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_design.engine.stage import Context, Stage, write_arrays, write_facts
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.cramer_rao import cell_prior
from phytac_design.simulation.mesh_pair import mesh_pair
from phytac_design.simulation.pressed_series import DiscResponse
from phytac_design.simulation.receptor_tables import tabulate_receptors
from phytac_design.simulation.response_tables import (
    everywhere,
    place_spacing_mm,
    tabulate_responses,
)
from phytac_design.simulation.scenario.linear_error import linear_error
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.simulation.switch_law import switch_law
from phytac_design.stages.response_stage import (
    IMAGE_ARRAYS,
    cell_radius_mm,
    decoder_shell,
    image_response_of,
)
from phytac_design.training.uneven_wall import UnevenWall
from phytac_shapes.arrays import IntArray

EXTRAPOLATED_REFINE_MIN = 3
"""Elements a pitch of the coarsest mesh whose linear part is extrapolated from others.

Without, shifts per newton are 8 % off with 3 elements a pitch (13 % beside rims), 3 % with 4 (5 %).
"""
EXTRAPOLATED_MARKERS_MAX = 1400
"""Larger shells take more than ten seconds for that."""


def extrapolated_from(refine: int, markers: int) -> tuple[int, int] | None:
    """Elements a pitch of two meshes that linear tables are extrapolated from, the finer first.

    None where they are not. Even numbers divide receptors alike; with 2 elements a pitch a wall may
    be 24 % too stiff, from which nothing can be extrapolated.
    """
    if refine < EXTRAPOLATED_REFINE_MIN or markers > EXTRAPOLATED_MARKERS_MAX:
        return None
    return max(refine + refine % 2, 6), 4


def run_places(context: Context, folder: Path) -> None:
    """Tabulate linear and large-displacement shifts over the surface."""
    design = context.design
    training, accuracy, scope = design.training, context.accuracy, scope_of(context)
    mesh, model, _ = decoder_shell(context)

    def shell(refine: int) -> tuple[ShellMesh, ShellModel]:
        return (mesh, model) if refine == accuracy.refine else decoder_shell(context, refine)[:2]

    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    done = tabulate_responses(
        context.sensor,
        mesh=mesh,
        model=model,
        see=image_response_of(context),
        spacing_mm=place_spacing_mm(context.surface, accuracy.place_share, radius),
        orders=accuracy.place_orders,
        near=scope.near if scope else everywhere,
        pair=mesh_pair(shell, extrapolated_from(accuracy.refine, context.markers.count)),
        progress=context.progress,
    )
    places = done.places
    write_arrays(folder, response_arrays(places))
    write_facts(
        folder,
        {
            "places": len(places.point_mm),
            "solves": done.solves,
            "bent": done.bent,
            "large": done.large,
            "unsure": done.unsure,
            "orders": places.orders,
            "pairs": len(places.pairs.grid.point_mm) if places.pairs else 0,
            "walls": [round(give, 6) for give in done.give],
            "radius_mm": places.radius_mm,
            **_mesh_error(done.claimed),
            **(
                {"top_N": places.top_N}
                if places.orders > 1
                else {
                    "linear_error": float(f"{min(linear_error(context.sensor, scope), 10.0):.3g}")
                }
            ),
            "spacing_mm": places.spacing_mm,
        },
    )


def _mesh_error(claimed: list[float]) -> dict[str, float]:
    """Claimed error of the tables because of the meshes: median and largest of all places."""
    if not claimed:
        return {}
    median, most = np.median(claimed), np.max(claimed)
    return {"mesh_error": float(f"{median:.3g}"), "mesh_error_largest": float(f"{most:.3g}")}


def locator_of(context: Context) -> ContactLocator:
    """The estimator ``auto`` by design alone: no sample of the sensor has been seen."""
    design, surface, markers = context.design, context.surface, context.markers
    training = design.training
    arrays, facts = context.arrays("places"), context.facts("places")
    law = switch_law(design, markers)
    prior = cell_prior(
        surface.area_mm2(),
        markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    radius = float(facts["radius_mm"])
    # A disc's second moment is a quarter of its squared radius.
    spread = radius / 2.0 * prior.radius_mm
    return ContactLocator(
        places=response_from_arrays(arrays, radius, float(facts.get("top_N", "inf"))),
        position_mm=surface.point(markers.uv),
        neighbours=markers.neighbours,
        footprint_mm=design.switch.footprint_diameter_mm / 2.0,
        threshold_N=law.on_N,
        threshold_sd=law.threshold_sd,
        prior=ContactPrior(
            place_mm=prior.place_mm,
            moments_sd_mm2=(spread, spread / 2.0, spread),
            force_N=training.force_max_N,
        ),
        # Measured shifts are differences of two centroids.
        # A print's thickness differs by 3 % from place to place, its stiffness by 7 %. Markers of
        # pressed switches are 0.15 px off in frames of two prints, by tables fitted to them.
        linear_error=float(facts.get("linear_error", 0.0)),
        noise=ShiftNoise(
            centroid_px=1.4 * design.camera.noise_centroid_px, share=0.07, switched_px=0.2
        ),
    )


def receptor_table_of(
    context: Context, marker: IntArray, pair: IntArray, spread: float
) -> ReceptorTable | None:
    """Large displacements by forces on receptors (m,) and pairs (2, q) of them, for training.

    None without tables of interactions, which hold where this does. The forces spread over a disc
    between the footprint of a switch (0) and the cell of a marker (1).
    """
    accuracy, design = context.accuracy, context.design
    if accuracy.place_orders < 2 or not context.facts("places")["pairs"]:
        return None
    mesh, model, _ = decoder_shell(context)
    shell = DiscResponse(
        design,
        context.surface,
        context.markers,
        mesh=mesh,
        model=model,
        orders=accuracy.place_orders,
    )
    footprint_mm = design.switch.footprint_diameter_mm / 2.0
    radius_mm = footprint_mm + max(spread, 0.0) * (cell_radius_mm(context) - footprint_mm)
    return tabulate_receptors(
        shell,
        image_response_of(context),
        context.markers.uv,
        marker,
        pair,
        radius_mm,
        progress=context.progress,
    )


def uneven_wall_of(context: Context) -> UnevenWall | None:
    """The decoder's own shell, for the thickness of a print; None where it is too large."""
    mesh, model, _ = decoder_shell(context)
    if not UnevenWall.fits_in_memory(model, context.markers.count):
        return None
    shell = DiscResponse(
        context.design, context.surface, context.markers, mesh=mesh, model=model, orders=1
    )
    return UnevenWall(shell, image_response_of(context))


PLACES = Stage(
    name="places",
    design_fields=("mechanics", "touch"),
    settings=("refine", "receptors", "place_share", "place_orders"),
    depends_on=("views",),
    arrays=IMAGE_ARRAYS,
    scene=("regions", "reach_mm"),
    run=run_places,
)
