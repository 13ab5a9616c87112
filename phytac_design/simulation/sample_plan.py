"""What a scenario does to a sensor, sample by sample, before anything is solved."""

from dataclasses import dataclass

from phytac_design.simulation.contacts import Contacts, Switching
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class ChartBox:
    """Box of the chart that a scenario's contacts lie in, patches included.

    Attributes
    ----------
    low, high : (2,) float
        Of u and v. On a periodic axis ``low`` may exceed ``high``: the box then runs over the seam.
    whole : (2,) bool
        Axes that are covered from end to end.
    """

    low: FloatArray
    high: FloatArray
    whole: BoolArray


@dataclass(frozen=True, kw_only=True)
class SamplePlan:
    """All samples of a scenario on one sensor instance; cheap to make, the same for every worker.

    Attributes
    ----------
    touches : Contacts
        Contacts with the force that a gauge behind the indenter reads.
    felt_N : (c,) float
        Force of the elastic shell that moves as this one does: ``touches.force_N`` with the
        history of creep in it.
    time_s : (s,) float
        When each sample is taken.
    sequence : (s,) int
        Samples of one press with a common history share a number: keep them on one side of a
        split.
    light : (s,) float
        Brightness of the light over that at the start.
    switching : Switching
        Switches with their hysteresis, and the truth per receptor.
    region : ChartBox
        Where contacts lie.
    """

    touches: Contacts
    felt_N: FloatArray
    time_s: FloatArray
    sequence: IntArray
    light: FloatArray
    switching: Switching
    region: ChartBox
