"""The settings and choices that trade speed for accuracy: values, stages, and quantity of error."""

from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

from phytac_design.stages import STAGES
from phytac_shapes.errors import DesignError

Quantity = Literal["force", "visibility", "volume", "score"]
QUANTITIES: dict[Quantity, str] = {
    "force": "root mean square of the relative error of the force, standard contacts",
    "visibility": "smallest clearance of each marker under load, largest difference",
    "volume": "relative error of the printed shell's volume",
    "score": "relative error of the decoder's scores in the report: 1/√n of n contacts, and the "
    "force error of the simulated sensor's own meshes",
}
"""Definition of each error."""


@dataclass(frozen=True)
class Setting:
    """One setting of a build (a field of :class:`accuracy.Accuracy`), or a choice of use.

    Attributes
    ----------
    values : tuple
        From the cheapest to the finest.
    quantity : str
        Of its error; a key of ``QUANTITIES``.
    description : str
        For people.
    unit : str
        Of the error.
    of_build : bool
        False for a choice of use.
    """

    name: str
    values: tuple[float | str, ...]
    quantity: Quantity
    description: str
    unit: str = "relative"
    of_build: bool = True

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages of a build that depend on it."""
        return tuple(stage.name for stage in STAGES if self.name in stage.settings)


SETTINGS: tuple[Setting, ...] = (
    Setting("cad_tolerance_mm", (0.1, 0.05, 0.02, 0.01, 0.005), "volume", "CAD tessellation"),
    Setting("refine", (2, 3, 4, 5, 6, 8), "force", "mesh refinement"),
    Setting("receptors", (0, 1), "force", "receptors' stiffness and holes"),
    Setting("place_share", (1.2, 0.8, 0.55, 0.4), "force", "spacing of the decoder's tables"),
    Setting("place_orders", (1, 2, 3, 4, 5), "force", "linear theory, a series, or solved"),
    Setting("truth_refine", (5, 7, 9, 13), "score", "meshes of the simulated sensor"),
    Setting("sample_share", (0.1, 0.3, 1.0), "score", "simulated training and test samples"),
    Setting("frames", (5, 20, 50, 100), "score", "rendered frames that are decoded"),
    Setting("press_places", (8, 20, 40, 120), "visibility", "places pressed under the camera"),
    Setting("press_tolerance", (1.0, 0.1, 0.05, 0.02), "visibility", "linear or large there"),
    Setting(
        "image_size", (0.25, 0.5, 0.75, 1.0), "visibility", "pixels each way", "px", of_build=False
    ),
    Setting(
        "visibility",
        ("sampled", "exact"),
        "visibility",
        "rays or every pixel",
        "fraction",
        of_build=False,
    ),
    Setting(
        "facets",
        (16.0, 4.0, 2.0, 1.0, 0.25),
        "visibility",
        "tessellation of the camera scene, in multiples of a quarter of a pixel's footprint",
        "px",
        of_build=False,
    ),
    Setting(
        "displacement",
        ("linear", "auto", "large"),
        "force",
        "theory of the simulation",
        of_build=False,
    ),
    Setting(
        "route",
        ("points", "frames"),
        "visibility",
        "centroids given or rendered",
        "px",
        of_build=False,
    ),
    Setting("estimator", ("koi_inverse", "fem", "auto"), "force", "of the decoder", of_build=False),
    Setting(
        "precision", ("float32", "float64"), "force", "of the decoder's tables", of_build=False
    ),
)
"""All settings and choices; errors are against the last value or the quantity's own limit."""


def setting_named(name: str) -> Setting:
    """Setting or choice by its name.

    Raises
    ------
    DesignError
        If there is none.
    """
    known = {setting.name: setting for setting in SETTINGS}
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(
            "setting-unknown", f"no setting {name!r}{hint}; choose one of {', '.join(known)}"
        )
    return known[name]
