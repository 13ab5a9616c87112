"""Messages of a force stream: their contents and framing, described in ``docs/streaming.md``."""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_grouping import Contact, ContactGrouper, Place
from phytac_decoder.estimation.contact_tracker import ContactTracker
from phytac_decoder.estimation.force_regions import Region, RegionForces
from phytac_decoder.estimation.net_wrench import Wrench, wrench_of_contacts, wrench_of_forces
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.sensor_limits import id_list
from phytac_decoder.pipeline.frame_reading import Reading, marker_loads, nearest_marker
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError, cause_of

FRAMINGS = ("lines", "length")
"""JSON lines, or each message after its length in bytes (4 bytes, big-endian)."""
MESSAGE_MAX_BYTES = 1 << 24
"""A longer message means a broken stream."""

Message = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class MessageBuilder:
    """Builds the messages of one sensor's stream, frame after frame: contacts keep their ids.

    Attributes
    ----------
    bundle : Bundle
        The sensor's decoder.
    estimator : str
        Force estimator.
    source : str
        Description of where frames come from.
    clock : str
        What ``timestamp_s`` counts, see :class:`phytac_decoder.io.frame.Source`.
    started_unix_s : float
        Unix time at which ``decoded_s`` is 0.
    regions : sequence of Region
        See :func:`phytac_decoder.estimation.force_regions.load_regions`.
    moment_about_mm : (x, y, z)
        Point about which moments are taken, in the sensor's frame.

    Raises
    ------
    InputError
        If that point is not finite, or farther away than a kilometre.
    """

    force_limit_N: ClassVar[float] = 1e6
    """A larger force is an error of the computation."""
    about_limit_mm: ClassVar[float] = 1e6
    """Largest coordinate of the point about which moments are taken."""

    bundle: Bundle
    estimator: str
    source: str = ""
    clock: str = ""
    started_unix_s: float = 0.0
    regions: Sequence[Region] = ()
    moment_about_mm: Place = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        # False for NaN.
        if not all(abs(part) <= self.about_limit_mm for part in self.moment_about_mm):
            x, y, z = self.moment_about_mm
            raise InputError(
                "moment-reference-invalid",
                f"moments cannot be taken about ({x:g}, {y:g}, {z:g}) mm; give a point in the "
                f"sensor's frame with coordinates of at most {self.about_limit_mm:g} mm",
            )

    @cached_property
    def finder(self) -> ContactGrouper:
        """Finds contacts among key nodes."""
        bundle = self.bundle
        return ContactGrouper(position_mm=bundle.position_mm, neighbours=bundle.model.neighbours)

    @cached_property
    def tracker(self) -> ContactTracker:
        """Tracks contacts over frames."""
        return ContactTracker(spacing_mm=self.finder.spacing_mm)

    @cached_property
    def outward(self) -> FloatArray:
        """Outward unit normals (n, 3) at the markers."""
        return self.normals(self.bundle.position_mm)

    def normals(self, points_mm: FloatArray) -> FloatArray:
        """Return outward unit normals (m, 3) at points (m, 3) of the outer face.

        They are those of the tables of ``auto``; without tables, of quadrics through the markers.
        """
        bundle = self.bundle
        if bundle.model.locator is not None:
            return bundle.model.locator.places.normals(points_mm)
        cameras = np.array([camera.position_mm for camera in bundle.cameras])
        return self.finder.normals(points_mm, cameras[bundle.read_by])

    def wrench(self, reading: Reading) -> Wrench:
        """Return the net force and moment of a frame.

        Contacts that the estimator found count at their centres, with standard deviations; other
        estimators' forces count at the markers, without.
        """
        about = np.array(self.moment_about_mm)
        if reading.found is None:
            koi = reading.koi
            force = -reading.forces_N[koi, None] * self.outward[koi]
            return wrench_of_forces(force, self.bundle.position_mm[koi], about)
        contacts, locator = reading.found.contacts, self.bundle.model.locator
        points = np.array([one.point_mm for one in contacts]).reshape(-1, 3)
        return wrench_of_contacts(
            contacts,
            self.normals(points),
            about,
            places=locator.places if locator else None,
            shear_sd=locator.prior.shear_sd if locator else 0.0,
        )

    @cached_property
    def region_forces(self) -> RegionForces:
        """Sums forces over regions."""
        return RegionForces(regions=self.regions, markers=len(self.bundle.position_mm))

    def hello(self, *, positions: bool = True) -> Message:
        """The first message; serial ports get it without the markers' ``positions``."""
        bundle = self.bundle
        out: Message = {
            "type": "hello",
            "format": "phytac-stream",
            "version": "1.7",
            "design": bundle.design,
            "design_hash": bundle.design_hash,
            "estimator": self.estimator,
            "source": self.source,
            "clock": self.clock,
            "started_unix_s": round(self.started_unix_s, 6),
            "cameras": len(bundle.cameras),
            "markers": len(bundle.position_mm),
            "force_max_N": float(bundle.force_max_N),
            "units": {
                "force": "N",
                "length": "mm",
                "moment": "N mm",
                "time": "s",
                "latency": "ms",
                "frame": "sensor",
            },
            "limits": bundle.limits(self.estimator),
        }
        if self.regions:
            out["regions"] = [
                {"name": region.name, "markers": list(region.markers)} for region in self.regions
            ]
        if positions:
            out["positions_mm"] = np.round(bundle.position_mm, 3).tolist()
        return out

    def frame(
        self,
        reading: Reading,
        *,
        sequence: int,
        timestamp_s: float,
        decoded_s: float = 0.0,
        latency_ms: float = 0.0,
        missed: int = 0,
        gap_s: float = 0.0,
        imu: Message | None = None,
    ) -> Message:
        """One frame's forces; those that are not finite are left out, with a warning.

        Parameters
        ----------
        reading : Reading
            Of the frame.
        sequence : int
            Number of the frame in its source.
        timestamp_s : float
            When it was taken.
        decoded_s, latency_ms : float
            When it was decoded, and how long after it was available.
        missed : int
            Frames before this one that were not decoded.
        gap_s : float
            Time without pictures before it, where the camera was lost; else 0.
        imu : dict, optional
            Motion sample that belongs to it.
        """
        forces, koi = reading.forces_N, reading.koi
        # False for NaN.
        good = np.abs(forces[koi]) <= self.force_limit_N
        warnings, broken = list(reading.warnings), koi[~good]
        if len(broken):
            warnings.append(
                f"the forces on {len(broken)} markers ({id_list(broken)}) are not finite; "
                "they are left out"
            )
        koi = koi[good]
        if reading.found is not None:
            sound = [one for one in reading.found.contacts if _is_sound(one)]
            reading = replace(reading, found=replace(reading.found, contacts=sound))
        reading = replace(reading, koi=koi)
        markers, force_N = marker_loads(reading, koi, self.bundle.position_mm)
        out: Message = {
            "type": "frame",
            "sequence": sequence,
            "timestamp_s": _rounded(timestamp_s, 6),
            "decoded_s": _rounded(decoded_s, 6),
            "latency_ms": _rounded(latency_ms, 3),
            "valid": reading.valid and not len(broken),
            "total_N": _rounded(force_N.sum(), 4),
            "contacts": self._contacts(reading, koi, timestamp_s),
            "koi": koi.tolist(),
            "forces_N": np.round(forces[koi], 4).tolist(),
            "warnings": warnings,
            "missed": missed,
            **wrench_fields(self.wrench(reading), self.moment_about_mm),
        }
        if reading.code:
            out["code"] = reading.code
        if gap_s:
            out["gap_s"] = _rounded(gap_s, 3)
        if self.regions:
            sums = self.region_forces.of(markers, force_N)
            out["regions"] = [
                {"name": region.name, "force_N": _rounded(force, 4)}
                for region, force in zip(self.regions, sums, strict=True)
            ]
        if imu is not None:
            out["imu"] = imu
        return out

    def _contacts(self, reading: Reading, koi: IntArray, time_s: float) -> list[Message]:
        """Contacts with their ids, the strongest first."""
        if not reading.valid:
            return []
        if reading.found is None:
            contacts = self.finder.find(reading.forces_N, koi)
        else:
            strongest = sorted(reading.found.contacts, key=lambda one: -one.force_N)
            contacts = [_as_found(one) for one in strongest]
        found = self.tracker.update(contacts, time_s)
        points = np.array([contact.position_mm for contact in found]).reshape(-1, 3)
        return [
            self._contact(contact, normal, reading.forces_N)
            for contact, normal in zip(found, self.normals(points), strict=True)
        ]

    def _contact(self, contact: Contact, normal: FloatArray, forces_N: FloatArray) -> Message:
        out: Message = {
            "markers": list(contact.markers),
            "force_N": _rounded(contact.force_N, 4),
            "position_mm": [_rounded(part, 3) for part in contact.position_mm],
            "normal": [_rounded(part, 5) for part in normal],
            "id": contact.id,
            "size_mm": _rounded(contact.size_mm, 2),
            "since_s": _rounded(contact.since_s, 6),
        }
        if contact.sd_N is not None:
            out["sd_N"] = _rounded(contact.sd_N, 4)
        if contact.shear_N is not None and contact.shear_sd_N is not None:
            out["shear_N"] = [_rounded(part, 4) for part in contact.shear_N]
            out["shear_sd_N"] = [_rounded(part, 4) for part in contact.shear_sd_N]
        if self.regions:
            markers = list(contact.markers)
            if not markers:
                place = np.array(contact.position_mm)
                markers = [nearest_marker(place, self.bundle.position_mm)]
            out["region"] = self.region_forces.home(markers, forces_N[markers].tolist())
        return out


def _is_sound(located: LocatedContact) -> bool:
    others = [located.sd_N, located.radius_mm, *located.point_mm]
    if located.shear_observed:
        others += [*located.shear_N, *located.shear_sd_N]
    limit_N = MessageBuilder.force_limit_N
    return abs(located.force_N) <= limit_N and bool(np.isfinite(others).all())


def _as_found(located: LocatedContact) -> Contact:
    x, y, z = located.point_mm.tolist()
    seen = located.shear_observed
    return Contact(
        markers=tuple(sorted(located.markers.tolist())),
        force_N=located.force_N,
        position_mm=(x, y, z),
        size_mm=2.0 * located.radius_mm,
        sd_N=located.sd_N,
        shear_N=tuple(located.shear_N.tolist()) if seen else None,
        shear_sd_N=tuple(located.shear_sd_N.tolist()) if seen else None,
    )


def wrench_fields(wrench: Wrench, about_mm: Sequence[float]) -> Message:
    """Fields of a message: net force and moment, and the point about which it is taken."""
    out: Message = {
        "net_force_N": [_rounded(part, 4) for part in wrench.force_N],
        "net_moment_Nmm": [_rounded(part, 3) for part in wrench.moment_Nmm],
        "moment_about_mm": [_rounded(part, 3) for part in about_mm],
    }
    force_sd, moment_sd = wrench.force_sd_N, wrench.moment_sd_Nmm
    if force_sd is not None and moment_sd is not None:
        out["net_force_sd_N"] = [_rounded(part, 4) for part in force_sd]
        out["net_moment_sd_Nmm"] = [_rounded(part, 3) for part in moment_sd]
    return out


def end_message(reason: str, code: str = "") -> Message:
    """The last message, with the reason why the stream ends and the code of the error, if any."""
    return {"type": "end", "reason": reason} | ({"code": code} if code else {})


def _rounded(value: float, digits: int) -> float:
    # Adding 0.0 makes -0.0 a plain zero.
    return round(float(value), digits) + 0.0


def json_bytes(message: Message) -> bytes:
    """JSON on one line of ASCII, because some readers split lines at other characters too.

    Raises InputError for a number that is not finite.
    """
    try:
        text = json.dumps(message, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise InputError(
            "message-not-finite", f"a message holds a number that is not finite ({error})"
        ) from None
    return text.encode()


def framed(text: bytes, framing: str) -> bytes:
    """One message's JSON with its framing; raises InputError if the message is too long."""
    check_framing(framing)
    if len(text) > MESSAGE_MAX_BYTES:
        raise InputError(
            "message-too-long", f"a message of {len(text)} bytes is longer than {MESSAGE_MAX_BYTES}"
        )
    return text + b"\n" if framing == "lines" else struct.pack(">I", len(text)) + text


def encode(message: Message, framing: str) -> bytes:
    """A message as bytes; raises InputError as :func:`json_bytes` and :func:`framed` do."""
    return framed(json_bytes(message), framing)


def with_dropped(text: bytes, dropped: int) -> bytes:
    """A message's JSON with the number of messages that were dropped for its receiver."""
    return text[:-1] + b',"dropped":%d}' % dropped


def check_framing(framing: str) -> None:
    """Raise InputError if there is no framing of this name."""
    if framing not in FRAMINGS:
        raise InputError(
            "stream-format-unknown",
            f"no format {framing!r} for a stream; known: {', '.join(FRAMINGS)}",
        )


class MessageSplitter:
    """Splits bytes that arrive in pieces of any size into messages.

    Parameters
    ----------
    framing : str
        One of ``FRAMINGS``.
    """

    def __init__(self, framing: str) -> None:
        check_framing(framing)
        self._framing = framing
        self._held = b""

    def feed(self, data: bytes) -> list[Message]:
        """Messages that these bytes complete; raises InputError if they are no stream."""
        self._held += data
        out = []
        try:
            while (text := self._next()) is not None:
                out.append(_parsed(text))
        except (ValueError, RecursionError) as error:
            raise InputError(
                "message-invalid",
                f"not a message of a stream: {cause_of(error)}; read it in the format that phytac "
                "serve was given (--format)",
            ) from None
        return out

    def _next(self) -> bytes | None:
        """The next whole message; None if it has not all come."""
        if self._framing == "lines":
            text, end, rest = self._held.partition(b"\n")
            whole, length = bool(end), len(text)
        else:
            head, rest = self._held[:4], self._held[4:]
            length = struct.unpack(">I", head)[0] if len(head) == 4 else 0
            whole = len(head) == 4 and len(rest) >= length
            text, rest = rest[:length], rest[length:]
        if length > MESSAGE_MAX_BYTES:
            raise ValueError(f"a message of {length} bytes or more")
        if not whole:
            return None
        self._held = rest
        return text


def _parsed(text: bytes) -> Message:
    message = json.loads(text, parse_constant=_reject)
    if isinstance(message, dict) and isinstance(message.get("type"), str):
        return message
    raise ValueError("no object with a 'type'")


def _reject(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")
