"""The accuracy presets: every knob that trades time for truth, in one place."""

from dataclasses import asdict, dataclass
from typing import Literal

Preset = Literal["draft", "standard", "fine"]


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Settings of one preset.

    Attributes
    ----------
    cad_tolerance_mm : float
        Chordal tolerance of printed meshes.
    refine : int
        Elements of the decoder's mesh per marker pitch around the sensor.
    receptors : bool
        Whether the decoder's shell has the stiffness of receptor tubes and their holes.
    truth_refine : int
        The same of the simulated sensor's own, finer mesh, which is not nested in the decoder's.
    sample_share : float
        Fraction of the design's training and test samples that is simulated.
    frames : int
        Rendered frames that are decoded for the report.
    place_share : float
        Spacing of the places of the estimator ``auto``, over the patches' mean radius.
    place_orders : int
        Powers of the force in its tables: 1 is linear theory, 3 large displacements.
    press_places : int
        Places at which the sensor is pressed to see what hides or fuses under load.
    press_tolerance : float
        Error of linear theory that is accepted there; 1 takes it always.
    print_tools : bool
        Whether molds, fixtures and kit are held against the print rules too; the shell always is.
    """

    cad_tolerance_mm: float
    refine: int
    receptors: bool
    truth_refine: int
    sample_share: float
    frames: int
    place_share: float
    place_orders: int
    press_places: int
    press_tolerance: float
    print_tools: bool

    def as_dict(self) -> dict[str, float]:
        """Plain values, for hashing and reports."""
        return asdict(self)


PRESETS: dict[str, Accuracy] = {
    "draft": Accuracy(
        cad_tolerance_mm=0.05,
        refine=3,
        receptors=True,
        truth_refine=5,
        sample_share=0.3,
        frames=5,
        place_share=0.8,
        place_orders=1,
        press_places=8,
        press_tolerance=1.0,
        print_tools=False,
    ),
    "standard": Accuracy(
        cad_tolerance_mm=0.01,
        refine=4,
        receptors=True,
        truth_refine=9,
        sample_share=1.0,
        frames=50,
        place_share=0.55,
        place_orders=3,
        press_places=40,
        press_tolerance=0.05,
        print_tools=True,
    ),
    "fine": Accuracy(
        cad_tolerance_mm=0.005,
        refine=6,
        receptors=True,
        truth_refine=13,
        sample_share=1.0,
        frames=100,
        place_share=0.4,
        place_orders=3,
        press_places=120,
        press_tolerance=0.02,
        print_tools=True,
    ),
}
