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
    truth_refine : int
        The same of the simulated sensor's own, finer mesh, which is not nested in the decoder's.
    sample_share : float
        Fraction of the design's training and test samples that is simulated.
    frames : int
        Rendered frames that are decoded for the report.
    """

    cad_tolerance_mm: float
    refine: int
    truth_refine: int
    sample_share: float
    frames: int

    def as_dict(self) -> dict[str, float]:
        """Plain values, for hashing and reports."""
        return asdict(self)


PRESETS: dict[str, Accuracy] = {
    "draft": Accuracy(
        cad_tolerance_mm=0.05,
        refine=3,
        truth_refine=5,
        sample_share=0.3,
        frames=5,
    ),
    "standard": Accuracy(
        cad_tolerance_mm=0.01,
        refine=4,
        truth_refine=9,
        sample_share=1.0,
        frames=50,
    ),
    "fine": Accuracy(
        cad_tolerance_mm=0.005,
        refine=6,
        truth_refine=13,
        sample_share=1.0,
        frames=100,
    ),
}
