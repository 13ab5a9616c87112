"""What a decoder makes of one frame: forces on switches, contacts, reasons to distrust them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import Measured
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a decoder makes of one frame.

    Attributes
    ----------
    koi : (m,) int
        Key nodes of interest: markers whose switch is on, or cannot be read and must be.
    forces_N : (n,) float
        Inward force on every marker; zero off the key nodes of interest.
    warnings : sequence of str
        Reasons to distrust them.
    valid : bool
        Whether the frame could be decoded at all.
    found : Found, optional
        Contacts, by an estimator that finds them itself (``auto``); their forces are those on the
        switches, and besides those of contacts that tripped none.
    """

    koi: IntArray
    forces_N: FloatArray
    warnings: Sequence[str] = ()
    valid: bool = True
    found: ContactDetection | None = None

    @classmethod
    def none(cls, reason: str) -> "Reading":
        """Of a frame that could not be decoded, with the reason."""
        nothing: IntArray = np.zeros(0, dtype=np.int64)
        return cls(koi=nothing, forces_N=np.zeros(0), warnings=(reason,), valid=False)

    @property
    def silent(self) -> list[LocatedContact]:
        """Contacts that tripped no switch."""
        contacts = self.found.contacts if self.found else []
        return [contact for contact in contacts if not len(contact.markers)]


@dataclass(frozen=True, kw_only=True)
class MarkerLoads:
    """Where forces are summed: on key nodes, and on the markers nearest to contacts without one.

    Attributes
    ----------
    markers : (k,) int
        A marker may be named more than once.
    force_N : (k,) float
        On each.
    """

    markers: IntArray
    force_N: FloatArray


def marker_loads(reading: Reading, koi: IntArray, position_mm: FloatArray) -> MarkerLoads:
    """Forces on some key nodes, and of contacts that tripped none.

    Parameters
    ----------
    reading : Reading
        Of a frame.
    koi : (m,) int
        Key nodes whose forces are numbers.
    position_mm : (n, 3) float
        Markers on the outer face.
    """
    silent = reading.silent
    beside = [nearest_marker(contact.point_mm, position_mm) for contact in silent]
    return MarkerLoads(
        markers=np.concatenate([koi, np.array(beside, dtype=np.int64)]),
        force_N=np.concatenate([reading.forces_N[koi], [contact.force_N for contact in silent]]),
    )


def nearest_marker(point_mm: FloatArray, position_mm: FloatArray) -> int:
    """Number of the marker, of those at (n, 3), that is nearest to a point (3,)."""
    return int(np.argmin(np.linalg.norm(position_mm - point_mm, axis=1)))


def read(
    bundle: Bundle, measured: Measured, estimator: str, *, before: Reading | None = None
) -> Reading:
    """Forces and contacts of what one frame shows, each solved for once.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    measured : Measured
        Markers and switches.
    estimator : str
        One of the decoder's.
    before : Reading, optional
        Of the frame before, by the same estimator: ``auto`` goes on from its contacts.
    """
    koi = measured.koi
    if estimator == "auto":
        last = before.found if before else None
        found = bundle.model.contacts(measured.shift_px, koi, before=last)
        forces = found.receptor_forces_N(len(measured.shift_px))
        warnings = measured.warnings(bundle, forces, estimator=estimator, found=found)
        return Reading(
            koi=np.union1d(koi, np.flatnonzero(forces)),
            forces_N=forces,
            warnings=warnings,
            found=found,
        )
    forces = measured.forces_N(bundle, estimator)
    warnings = measured.warnings(bundle, forces, estimator=estimator)
    return Reading(koi=koi, forces_N=forces, warnings=warnings)
