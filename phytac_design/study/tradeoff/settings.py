"""Every knob that trades time for truth: its values, the stages it acts on, how it errs."""

from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

from phytac_design.stages import STAGES
from phytac_shapes.errors import DesignError

Quantity = Literal["force", "visibility", "volume", "score"]
QUANTITIES: dict[Quantity, str] = {
    "force": "root mean square of the relative error of the force read, standard contacts",
    "visibility": "least visible fraction of each marker under load, greatest difference",
    "volume": "relative error of the printed shell's volume",
    "score": "relative error of what the report says of the decoder: 1/√n of n contacts, and the "
    "force error of the simulated sensor's own mesh",
}
"""What each error is an error of."""


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One knob.

    Attributes
    ----------
    name : str
        Of the setting, or of the choice.
    values : tuple
        From the cheapest to the finest.
    quantity : str
        What it errs in; a key of ``QUANTITIES``.
    unit : str
        Of the error.
    of_build : bool
        Whether it is a setting of a build (:class:`accuracy.Accuracy`) or a choice of use.
    says : str
        What it is, for people.
    """

    name: str
    values: tuple[float | str, ...]
    quantity: Quantity
    unit: str
    of_build: bool
    says: str

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages of a build that read it."""
        return tuple(stage.name for stage in STAGES if self.name in stage.knobs)


def _setting(name: str, values: tuple[float, ...], quantity: Quantity, says: str) -> Knob:
    return Knob(
        name=name, values=values, quantity=quantity, unit="relative", of_build=True, says=says
    )


def _choice(
    name: str, values: tuple[float | str, ...], quantity: Quantity, unit: str, says: str
) -> Knob:
    return Knob(name=name, values=values, quantity=quantity, unit=unit, of_build=False, says=says)


KNOBS: tuple[Knob, ...] = (
    _setting("cad_tolerance_mm", (0.1, 0.05, 0.02, 0.01, 0.005), "volume", "CAD tessellation"),
    _setting("refine", (2, 3, 4, 5, 6, 8), "force", "mesh refinement"),
    _setting("receptors", (0, 1), "force", "receptors' stiffness and holes"),
    _setting("place_share", (1.2, 0.8, 0.55, 0.4), "force", "spacing of the decoder's tables"),
    _setting("place_orders", (1, 2, 3, 4, 5), "force", "linear theory, a series, or solved"),
    _setting("truth_refine", (5, 7, 9, 13), "score", "mesh of the simulated sensor"),
    _setting("sample_share", (0.1, 0.3, 1.0), "score", "simulated training and test samples"),
    _setting("frames", (5, 20, 50, 100), "score", "rendered frames that are decoded"),
    _setting("press_places", (8, 20, 40, 120), "visibility", "places pressed under the camera"),
    _setting("press_tolerance", (1.0, 0.1, 0.05, 0.02), "visibility", "linear or large there"),
    _choice("image_size", (0.25, 0.5, 0.75, 1.0), "visibility", "px", "pixels each way"),
    _choice("visibility", ("sampled", "exact"), "visibility", "fraction", "rays or every pixel"),
    _choice(
        "facets",
        (16.0, 4.0, 2.0, 1.0, 0.25),
        "visibility",
        "px",
        "tessellation of the camera scene, in times a quarter of a pixel's footprint",
    ),
    _choice("displacement", ("linear", "auto", "large"), "force", "relative", "the twin's theory"),
    _choice("route", ("points", "frames"), "visibility", "px", "centroids given or rendered"),
    _choice("estimator", ("koi_inverse", "fem", "auto"), "force", "relative", "of the decoder"),
    _choice("precision", ("float32", "float64"), "force", "relative", "of the decoder's tables"),
)
"""All knobs; finest values are last, and errors are against them or the quantity's own limit."""


def knob_named(name: str) -> Knob:
    """Knob by its name.

    Raises
    ------
    DesignError
        If there is none.
    """
    known = {knob.name: knob for knob in KNOBS}
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(f"no knob {name!r}{hint}; choose of {', '.join(known)}")
    return known[name]
