"""Groups of contacts: by data set, by kind, by force, by place."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from phytac_design.datasets.samples import Samples
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.heights_along import MIDDLE, along_mm, length_mm
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts
from phytac_design.training.training_data import DataSet
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError

FORCE_EDGES_N = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, np.inf)
"""The paper distinguishes 0.5 to 25 N and below 5 N; the other ranges are ours."""
KINDS = ("single", "several", "grip")

Groups = dict[str, dict[str, BoolArray]]


@dataclass(frozen=True, kw_only=True)
class ContactPositions:
    """Positions of contacts (c) on the surface.

    Attributes
    ----------
    along : (c,) float
        Distance from the near rim over that of the far rim, along the surface.
    around : (c,) float
        Share of the circumference, or of the width of a sheet: of the chart's v.
    """

    along: FloatArray
    around: FloatArray


def contact_positions(design: Design, uv: FloatArray) -> ContactPositions:
    """Return positions of chart coordinates ``uv`` (c, 2) on a design's surface."""
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0)
    low, high = context.surface.domain[1]
    return ContactPositions(
        along=along_mm(context.surface, uv) / length_mm(context.surface),
        around=(uv[:, 1] - low) / (high - low) % 1.0,
    )


def kinds(sets: Sequence[DataSet], samples: Samples, decoded: DecodedContacts) -> IntArray:
    """Return the index into ``KINDS`` of every contact, (c,)."""
    scenarios = [item.meta.notes.get("scenario") for item in sets]
    grips = [isinstance(each, dict) and each.get("kind") == "grips" for each in scenarios]
    grip = np.repeat(grips, [item.samples.count for item in sets])
    alone = samples.contacts[decoded.sample] <= 1
    return np.where(grip[decoded.sample], 2, np.where(alone, 0, 1))


def groups_of(
    sets: Sequence[DataSet],
    samples: Samples,
    decoded: DecodedContacts,
    where: ContactPositions | None,
) -> Groups:
    """Return groups as masks (c,) of contacts that turned on a switch; empty groups are left out.

    Parameters
    ----------
    sets, samples : list of DataSet, Samples
        The data sets, and the same joined.
    decoded : DecodedContacts
        Contacts of the joined samples.
    where : ResponseTable or None
        Positions of the contacts; None without the design.

    Raises
    ------
    InputError
        If no contact turned on a switch.
    """
    on, force = decoded.tripped, decoded.force_N
    if not on.any():
        raise InputError(
            "no-switch-tripped",
            f"none of {len(on)} contacts tripped a switch: there is nothing to evaluate; press "
            "harder, or on receptors",
        )
    kind = kinds(sets, samples, decoded)
    first = np.cumsum([0] + [item.samples.count for item in sets])
    names = _distinct([item.meta.what for item in sets])
    own = [(decoded.sample >= a) & (decoded.sample < b) for a, b in pairwise(first)]
    out: Groups = {
        "all": {"all": on},
        "contact": {name: kind == k for k, name in enumerate(KINDS)},
        "small": {"below 5 N": force < 5.0, "from 5 N": force >= 5.0},
        "force": {_range(a, b): (force >= a) & (force < b) for a, b in pairwise(FORCE_EDGES_N)},
    }
    if where is not None:
        heights, sides = 10, 8
        middle = (where.along >= MIDDLE[0]) & (where.along <= MIDDLE[1])
        tenth = np.clip((where.along * heights).astype(np.int64), 0, heights - 1)
        side = np.clip((where.around * sides).astype(np.int64), 0, sides - 1)
        out["height"] = {
            f"middle, {100 * MIDDLE[0]:g} to {100 * MIDDLE[1]:g} %": middle,
            "towards the rims": ~middle,
        }
        out["along"] = {
            f"{100 * k // heights} to {100 * (k + 1) // heights} %": tenth == k
            for k in range(heights)
        }
        out["around"] = {
            f"{360 * k / sides:g} to {360 * (k + 1) / sides:g}°": side == k for k in range(sides)
        }
    if len(sets) > 1:
        out["data"] = dict(zip(names, own, strict=True))
    return {
        section: {name: mask & on for name, mask in members.items() if (mask & on).any()}
        for section, members in out.items()
    }


def _range(low_N: float, high_N: float) -> str:
    return f"{low_N:g} to {high_N:g} N" if np.isfinite(high_N) else f"from {low_N:g} N"


def _distinct(names: Sequence[str]) -> list[str]:
    """Append a number where several names are the same."""
    return [
        f"{name} ({names[: k + 1].count(name)})" if names.count(name) > 1 else name
        for k, name in enumerate(names)
    ]
