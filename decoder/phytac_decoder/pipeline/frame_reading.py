"""The result of decoding one frame: forces, contacts, and reasons to distrust them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.plausibility import implausible
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The result of decoding one frame.

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
    code : str
        Code of the error that prevented it, see ``PhytacError``; empty for none.
    found : ContactDetection, optional
        Contacts, by an estimator that finds them itself (``auto``): those on switches, and those
        that tripped none.
    """

    koi: IntArray
    forces_N: FloatArray
    warnings: Sequence[str] = ()
    valid: bool = True
    code: str = ""
    found: ContactDetection | None = None

    @classmethod
    def none(cls, reason: str, code: str = "") -> "Reading":
        """Reading of a frame that could not be decoded, with the reason and the error's code."""
        nothing: IntArray = np.zeros(0, dtype=np.int64)
        return cls(koi=nothing, forces_N=np.zeros(0), warnings=(reason,), valid=False, code=code)

    @property
    def unswitched(self) -> list[LocatedContact]:
        """Contacts that tripped no switch."""
        contacts = self.found.contacts if self.found else []
        return [contact for contact in contacts if not len(contact.markers)]


def marker_loads(
    reading: Reading, koi: IntArray, position_mm: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Markers (k,) and the forces (k,) N on them; a marker may occur more than once.

    They are key nodes ``koi`` (m,), and for unswitched contacts the markers nearest to them, of
    those at ``position_mm`` (n, 3) on the outer face.
    """
    unswitched = reading.unswitched
    beside = [nearest_marker(contact.point_mm, position_mm) for contact in unswitched]
    markers = np.concatenate([koi, np.array(beside, dtype=np.int64)])
    return markers, np.append(reading.forces_N[koi], [contact.force_N for contact in unswitched])


def nearest_marker(point_mm: FloatArray, position_mm: FloatArray) -> int:
    """Number of the marker, of those at (n, 3), nearest to a point (3,)."""
    return int(np.argmin(np.linalg.norm(position_mm - point_mm, axis=1)))


def read(
    bundle: Bundle, measured: FrameMeasurement, estimator: str, *, before: Reading | None = None
) -> Reading:
    """Forces and contacts of one measured frame.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    measured : Measured
        Markers and switches.
    estimator : str
        One of the decoder's.
    before : Reading, optional
        Of the frame before, by the same estimator: ``auto`` starts from its contacts.
    """
    koi = measured.koi
    if estimator == "auto":
        last = before.found if before else None
        found = bundle.model.contacts(measured.shift_px, koi, before=last, marked=measured.marked)
        moved = measured.moved_cameras(bundle, found)
        if moved:
            return Reading.none("; ".join(moved), "rest-frame-outdated")
        forces = found.receptor_forces_N(len(measured.shift_px))
        # Switches that cannot be read are on where a force was found on them.
        koi = np.union1d(koi[bundle.tips.readable[koi]], np.flatnonzero(forces))
        inverse_N = bundle.model.forces("koi_inverse", measured.shift_px, koi)
        reasons = implausible(bundle, found, inverse_N)
        if reasons:
            text = f"this cannot be: {'; '.join(reasons)}; check light, focus and the rest frame"
            return Reading.none(text, "result-implausible")
        warnings = measured.warnings(bundle, forces, estimator=estimator, found=found)
        return Reading(
            koi=koi,
            forces_N=forces,
            warnings=warnings,
            found=found,
        )
    moved = measured.moved_cameras(bundle, None)
    if moved:
        return Reading.none("; ".join(moved), "rest-frame-outdated")
    forces = measured.forces_N(bundle, estimator)
    warnings = measured.warnings(bundle, forces, estimator=estimator)
    return Reading(koi=koi, forces_N=forces, warnings=warnings)
