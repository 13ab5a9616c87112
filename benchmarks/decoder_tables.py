"""What closer places and higher powers of the force cost the estimator ``auto``, and what they buy.

Rows of part ``tables``: seconds and memory of the tables, milliseconds of a contact, and the error
on held-out contacts of a virtual print after it has learnt from others.
"""

import time
from dataclasses import replace

import numpy as np

from benchmarks.decoder_data import random_subset, units
from benchmarks.harness import Table
from phytac_decoder.estimation.locator import ContactLocator
from phytac_design.datasets.samples import Samples
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.simulation.response_tables import place_spacing_mm, tabulate_responses
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder import along_mm, middle_mm
from phytac_design.stages.places import locator_of
from phytac_design.stages.response import image_response_of
from phytac_design.training.locator_calibration import calibrate_locator, match_contacts

STEPS = ((0.8, 1), (0.8, 3), (0.55, 1), (0.55, 2), (0.55, 3), (0.55, 4), (0.4, 5))
"""Spacing over the patches' mean radius, and powers of the force."""
LEARN, JUDGE = 100, 100
"""Samples."""


def tables(context: Context, share: float, orders: int) -> tuple[ContactLocator, dict[str, float]]:
    """The estimator with other tables, and what they cost."""
    design, surface, markers = context.design, context.surface, context.markers
    standard = locator_of(context)
    begin = time.process_time()
    mesh = marker_mesh(
        surface, markers, thickness_mm=design.wall.thickness_mm, refine=context.accuracy.refine
    )
    places = tabulate_responses(
        design,
        surface,
        markers,
        mesh=mesh,
        model=sensor_model(design, markers, mesh, receptors=True),
        see=image_response_of(context),
        spacing_mm=place_spacing_mm(surface, share, standard.places.radius_mm),
        orders=orders,
    ).places
    cost = {"s of one core": time.process_time() - begin, "MB": places.shift_px.nbytes / 1e6}
    return replace(standard, places=places), cost


def judged(locator: ContactLocator, samples: Samples, context: Context) -> dict[str, float]:
    """Errors on held-out samples, and milliseconds of those with one contact."""
    chosen = np.arange(samples.count)
    assert samples.touches is not None
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    matches = match_contacts(locator, samples, chosen)
    learnt = locator.correction
    force = matches.force_N
    if learnt is not None:
        force = force * learnt.factor(matches.point_mm, force, matches.signal_px)
    height = along_mm(context, samples.touches.uv[matches.touch])
    low, high = middle_mm(context)
    middle = (height >= low) & (height <= high)
    error = np.abs(force - matches.truth_N) / matches.truth_N
    alone = np.flatnonzero((samples.contacts == 1) & samples.bits_read.any(axis=1))[:40]
    spent = []
    for sample in alone:
        begin = time.process_time()
        locator.find(samples.shift_px[sample], np.flatnonzero(samples.bits_read[sample]))
        spent.append(1e3 * (time.process_time() - begin))
    return {
        "mean relative error, middle heights, %": 100.0 * float(error[middle].mean()),
        "mean relative error, all heights, %": 100.0 * float(error.mean()),
        "ms of one core, one contact, median": float(np.median(spent)),
    }


def add_rows(table: Table, *, quick: bool) -> None:
    """The trade, step by step."""
    case = units(quick=quick)[0]
    design = case.job.design
    preset = "draft" if quick else "standard"
    context = run_stages(
        design,
        select_stages(["places"]),
        accuracy=preset,
        seed=0,
        force=True,
        progress=lambda _: None,
    )[0]
    learn, judge = (
        random_subset(part, count, seed=0)
        for part, count in zip(case.parts(), (LEARN, JUDGE), strict=True)
    )
    for share, orders in STEPS[:2] if quick else STEPS:
        locator, figures = tables(context, share, orders)
        taught, _ = calibrate_locator(
            locator,
            learn.samples,
            np.arange(learn.samples.count),
            force_max_N=design.training.force_max_N,
        )
        figures |= judged(taught, judge.samples, context)
        mine = PRESETS[preset]
        used = (share, orders) == (mine.place_share, mine.place_orders)
        for name, value in figures.items():
            table.add(
                f"auto's tables, spacing {share:g} of the patch radius, {orders} "
                f"power{'s' if orders > 1 else ''} of the force: {name}",
                value,
                name.rsplit(", ", 1)[-1] if "%" in name else name.split(" ")[0],
                reference="-",
                source=f"{case.name}: learnt from {learn.samples.count} samples, judged on "
                f"{judge.samples.count}" + (f"; the preset {preset}" if used else ""),
            )
