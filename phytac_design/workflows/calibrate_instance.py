"""``phytac calibrate-instance``: one print's decoder from a few presses of known force.

Each press is kept as it comes: its pictures and a line of ``presses.csv``, which ``phytac import``
reads as well. Where it pressed the decoder finds itself; only the force must be known.
"""

import csv
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.estimation.place_average import INTERVAL_SDS
from phytac_decoder.io.bundle import Bundle, save_bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest, calibrated_colours
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame, prepared_frames
from phytac_decoder.pipeline.frame_reading import nearest_marker, read
from phytac_decoder.pipeline.shell_turn import oriented
from phytac_design.core.json_values import finite
from phytac_design.datasets.samples import Samples
from phytac_design.design.design_file import design_hash
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES, encode_png
from phytac_design.simulation.rig_import.rig_samples import RigSetup, samples_of
from phytac_design.training.locator_calibration import calibrate_locator
from phytac_design.training.press_places import next_place
from phytac_design.training.result_folder import write_folder
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError

TABLE, LOG, FRAMES = "instance.json", "presses.csv", "frames"
FORMAT, SCHEMA = "phytac-instance", "1.0"
COLUMNS = ("frame", "x_mm", "y_mm", "z_mm", "radius_mm", "force_N")


@dataclass(frozen=True, kw_only=True)
class PressLimits:
    """Presses that are of no use."""

    sd_share_max: float = 0.1
    """Largest standard deviation of the force that the markers show, over the force."""
    ratio_max: float = 2.0
    """Largest ratio of the known force and the one read, or its reciprocal: prints differ by a
    third at most."""


LIMITS = PressLimits()


@dataclass(frozen=True, kw_only=True)
class KnownPress:
    """A press of known force.

    Attributes
    ----------
    measured : FrameMeasurement
        What its pictures show.
    contact : LocatedContact
        The contact, by the decoder before the calibration.
    force_N : float
        Known normal force.
    warnings : sequence of str
        Reasons to distrust its pictures.
    """

    measured: FrameMeasurement
    contact: LocatedContact
    force_N: float
    warnings: Sequence[str] = ()


def locator_of(bundle: Bundle) -> ContactLocator:
    """Estimator ``auto`` of a decoder.

    Raises
    ------
    InputError
        If it has none.
    """
    if bundle.model.locator is None:
        raise InputError(
            "decoder-without-tables",
            f"the decoder of {bundle.design!r} has no tables of contacts, which are what presses "
            "calibrate; build the design again, with all stages of the decoder",
        )
    return bundle.model.locator


def known_press(bundle: Bundle, measured: FrameMeasurement, force_N: float) -> KnownPress:
    """Return a press whose force the markers show well.

    Parameters
    ----------
    bundle : Bundle
        Decoder before the calibration, with the print's rest frame.

    Raises
    ------
    InputError
        If it is not one contact, its force is hardly read there, or another force was meant.
    """
    reading = read(bundle, measured, "auto")
    if not reading.valid:
        raise InputError("press-not-usable", reading.warnings[0])
    contacts = reading.found.contacts if reading.found else []
    if len(contacts) != 1:
        raise InputError(
            "press-not-single",
            f"{len(contacts) or 'no'} contacts are seen; press with one pad, hard enough to turn a "
            "switch on",
        )
    (contact,) = contacts
    if contact.raw_sd_N > LIMITS.sd_share_max * contact.raw_N:
        raise InputError(
            "press-not-usable",
            f"the markers show {contact.raw_N:.1f} ± {1.96 * contact.raw_sd_N:.1f} N there; press "
            "farther from the rims, or harder",
        )
    ratio = force_N / contact.raw_N
    if not 1.0 / LIMITS.ratio_max <= ratio <= LIMITS.ratio_max:
        raise InputError(
            "press-not-usable",
            f"the markers show {contact.raw_N:.1f} N, and {force_N:.3g} N were given; check the "
            "unit, that the scale was at zero, and that the whole force goes through the scale",
        )
    return KnownPress(
        measured=measured, contact=contact, force_N=force_N, warnings=reading.warnings
    )


def press_samples(sensor: Sensor, bundle: Bundle, presses: Sequence[KnownPress]) -> Samples:
    """Presses as samples of a data set; the radius of their contacts is taken as unknown."""
    points = np.stack([press.contact.point_mm for press in presses])
    count = len(presses)
    rig = RigSetup(
        design=sensor.design,
        surface=sensor.surface,
        markers=sensor.markers,
        bundle=bundle,
        sources=(),
    )
    touches = Contacts.flat(
        sample=np.arange(count),
        uv=sensor.surface.chart(points),
        radius_mm=np.array([press.contact.radius_mm for press in presses]),
        force_N=np.array([press.force_N for press in presses]),
        samples=count,
    )
    seen = [press.measured for press in presses]
    numbers = np.arange(count)
    samples, _ = samples_of(rig, touches, seen, time_s=numbers.astype(np.float64), sequence=numbers)
    table = replace(touches.table(sensor.surface), radius_mm=np.zeros(count))
    return replace(samples, touches=table)


def calibrate_to_presses(
    sensor: Sensor, bundle: Bundle, presses: Sequence[KnownPress]
) -> tuple[Bundle, dict[str, Any]]:
    """Calibrate the estimator ``auto`` to presses; return the decoder, and facts of the fit.

    Parameters
    ----------
    sensor : Sensor
        By design.
    bundle : Bundle
        Decoder before the calibration, with the print's rest frame.
    presses : sequence of KnownPress
        One at least.
    """
    samples = press_samples(sensor, bundle, presses)
    fitted, facts = calibrate_locator(
        locator_of(bundle), samples, np.arange(samples.count), force_max_N=bundle.force_max_N
    )
    return replace(bundle, model=replace(bundle.model, locator=fitted)), facts


def stated_share(bundle: Bundle, presses: Sequence[KnownPress]) -> float:
    """Half the 95 % interval of a press, over its force: the median as the decoder states it."""
    shares = []
    for press in presses:
        found = bundle.model.contacts(
            press.measured.shift_px, press.measured.koi, marked=press.measured.marked
        )
        shares += [INTERVAL_SDS * one.sd_N / one.force_N for one in found.contacts]
    return float(np.median(shares)) if shares else np.inf


class InstanceCalibration:
    """A print's presses so far, and its decoder by them; pictures and forces are kept in a folder.

    Parameters
    ----------
    sensor : Sensor
        By design.
    bundle : Bundle
        Decoder before the calibration.
    out : Path
        Folder of the result; it exists.
    rest : sequence of (h, w, 3) uint8
        Pictures of the unloaded sensor, one of each camera.

    Attributes
    ----------
    calibrated : Bundle
        The decoder by the presses so far.
    presses : list of KnownPress
        These.
    skipped_mm : list of (3,) float
        Places that were proposed and not pressed.

    Raises
    ------
    InputError
        If the decoder is of another design, or a picture shows no sensor.
    """

    def __init__(
        self, sensor: Sensor, bundle: Bundle, out: Path, rest: Sequence[ImageArray]
    ) -> None:
        if bundle.design_hash != design_hash(sensor.design):
            raise InputError(
                "decoder-of-other-design",
                f"the decoder was built for another state of the design {bundle.design!r}; build "
                f"{sensor.design.name!r} again, or name the design it was built from",
            )
        self._sensor, self._out, self._rest = sensor, out, rest
        # With the shell's orientation and nothing else of the rest frame: each run takes its own.
        images = prepared_frames(bundle, rest)
        colours = calibrated_colours(bundle, images)
        self._base = replace(
            oriented(replace(bundle, colours=colours), images), colours=bundle.colours
        )
        self._plain = self.calibrated = calibrate_rest(bundle, rest)
        self._places = locator_of(bundle).places
        self._facts: dict[str, Any] = {}
        self.presses: list[KnownPress] = []
        self.skipped_mm: list[FloatArray] = []

    @property
    def interval_share(self) -> float:
        """Half the 95 % interval of a force over the force, as the decoder states it by now."""
        if not self.presses:
            return INTERVAL_SDS * LOCATOR.stiffness_sd
        return stated_share(self.calibrated, self.presses)

    def proposal(self) -> str:
        """Say where to press next."""
        known = [press.contact.point_mm for press in self.presses] + self.skipped_mm
        self._proposed_mm = next_place(self._places, np.array(known).reshape(-1, 3))
        x, y, z = self._proposed_mm
        marker = nearest_marker(self._proposed_mm, self._plain.position_mm)
        markers = self._sensor.markers
        return (
            f"receptor {marker} (row {markers.row[marker]}, column {markers.column[marker]}), at "
            f"x {x:.0f}, y {y:.0f}, z {z:.0f} mm"
        )

    def skip(self) -> None:
        """Do not propose the last place again."""
        self.skipped_mm.append(self._proposed_mm)

    def add(self, images: Sequence[ImageArray], force_N: float) -> KnownPress:
        """Add a press, and calibrate to all of them.

        Parameters
        ----------
        images : sequence of (h, w, 3) uint8
            Pictures of the pressed sensor, one of each camera.
        force_N : float
            Known normal force.

        Raises
        ------
        InputError
            If it is of no use, see :func:`known_press`; it is then left out.
        """
        press = known_press(self._plain, measure_frame(self._plain, images), force_N)
        presses = [*self.presses, press]
        self.calibrated, self._facts = calibrate_to_presses(self._sensor, self._plain, presses)
        self.presses = presses
        if len(presses) == 1:
            for suffix in CAMERA_SUFFIXES:  # of an earlier run
                shutil.rmtree(self._out / f"{FRAMES}{suffix}", ignore_errors=True)
            self._keep("rest", self._rest)
        self._keep(f"press_{len(presses):03d}", images)
        self._write_log()
        return press

    def change_share(self, shots: Sequence[Sequence[ImageArray]]) -> float:
        """Change of the force read, over its mean, in pictures that follow one another."""
        forces = [
            read(self._plain, measure_frame(self._plain, images), "auto").forces_N.sum()
            for images in shots
        ]
        return float(np.ptp(forces) / max(np.mean(forces), 1e-9))

    def undo(self) -> None:
        """Take the last press back."""
        self.presses = self.presses[:-1]
        self.calibrated, self._facts = self._plain, {}
        if self.presses:
            self.calibrated, self._facts = calibrate_to_presses(
                self._sensor, self._plain, self.presses
            )
        self._write_log()

    def save(self) -> dict[str, Any]:
        """Write the decoder and ``instance.json``; return the latter's contents."""
        facts: dict[str, Any] = {
            "format": FORMAT,
            "schema_version": SCHEMA,
            "design": self._plain.design,
            "design_hash": self._plain.design_hash,
            "presses": len(self.presses),
            "interval_share": self.interval_share,
            "auto": self._facts,
        }
        notes = {"instance": {"presses": len(self.presses), "interval_share": self.interval_share}}
        model = replace(self._base.model, locator=self.calibrated.model.locator)
        done = replace(
            self._base,
            model=model,
            learnt_rest_px=self._plain.rest_px[None],
            notes=self._base.notes | notes,
        )
        with write_folder(self._out, TABLE) as folder:
            save_bundle(done, folder)
            text = json.dumps(finite(facts), indent=1, sort_keys=True, ensure_ascii=False)
            (folder / TABLE).write_text(text + "\n", encoding="utf-8")
        return facts

    def _keep(self, name: str, images: Sequence[ImageArray]) -> None:
        for image, suffix in zip(images, CAMERA_SUFFIXES, strict=False):
            folder = self._out / f"{FRAMES}{suffix}"
            folder.mkdir(exist_ok=True)
            (folder / f"{name}.png").write_bytes(encode_png(image))

    def _write_log(self) -> None:
        """Write all presses as a log that ``phytac import`` reads."""
        with (self._out / LOG).open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(COLUMNS)
            for number, press in enumerate(self.presses, start=1):
                contact = press.contact
                place = [f"{value:.3f}" for value in (*contact.point_mm, contact.radius_mm)]
                rows.writerow([f"press_{number:03d}.png", *place, f"{press.force_N:.6g}"])
