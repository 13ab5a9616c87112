"""``phytac calibrate-instance``: one print's decoder from a few presses of known force.

Each press is kept as it comes: its pictures and a line of ``presses.csv``, which ``phytac import``
reads as well. Where it pressed the decoder finds itself; only the force must be known.
"""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.estimation.place_average import INTERVAL_SDS
from phytac_decoder.io.bundle import Bundle, save_bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.frame_reading import nearest_marker, read
from phytac_decoder.pipeline.rest_frames import pressed_note
from phytac_design.core.json_values import finite
from phytac_design.datasets.samples import Samples
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES, encode_png
from phytac_design.simulation.rig_import.rig_samples import RigSetup, samples_of
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.places_stage import uneven_wall_of
from phytac_design.training.locator_calibration import SETTINGS as CALIBRATION
from phytac_design.training.locator_calibration import calibrate_locator
from phytac_design.training.press_places import next_press, pressable_receptors
from phytac_design.training.result_folder import write_folder
from phytac_design.training.uneven_wall import SETTINGS as UNEVEN
from phytac_design.training.uneven_wall import UnevenWall, WallSolver
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError, OutputError

TABLE, LOG, FRAMES = "instance.json", "presses.csv", "frames"
FORMAT, SCHEMA = "phytac-instance", "1.0"
COLUMNS = ("frame", "x_mm", "y_mm", "z_mm", "radius_mm", "force_N")


@dataclass(frozen=True, kw_only=True)
class PressLimits:
    """Presses that are of no use."""

    sd_share_max: float = 0.1
    """Largest standard deviation of the force that the markers show, over the force."""
    ratio_max: float = 2.0
    """Largest ratio of the known force and the one read, or its reciprocal: beyond it the unit is
    wrong, or not the whole force went through the scale."""
    doubtful_sds: float = 3.0
    """Standard deviations by which the stiffness of a print is doubtful, or a press against the
    others."""


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


def designed_locator(bundle: Bundle) -> ContactLocator:
    """Estimator ``auto`` of a decoder by design.

    Raises
    ------
    InputError
        If it has none, it needs switches that the design has not, or it has learnt from data.
    """
    locator = bundle.model.locator
    if locator is None:
        raise InputError(
            "decoder-without-tables",
            f"the decoder of {bundle.design!r} has no tables of contacts, which are what presses "
            "calibrate; build the design again, with all stages of the decoder",
        )
    if bundle.model.without_switches:
        raise InputError(
            "training-without-switches",
            f"{bundle.design} has no switches that can be read, and presses are assigned by them: "
            "use the decoder of its build, or give the design switches",
        )
    if locator.correction is not None or bundle.model.measured is not None:
        raise InputError(
            "decoder-already-trained",
            "this decoder has learnt from data already; give that of the build, such as "
            f"exports/{bundle.design}/decoder",
        )
    return locator


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
    if len(contacts) > 1:
        raise InputError(
            "press-not-single", f"{len(contacts)} contacts are seen; press with one pad alone"
        )
    if not contacts or not len(contacts[0].markers):
        raise InputError(
            "press-not-single", "no contact is seen that turns a switch on; press harder"
        )
    (contact,) = contacts
    share = contact.raw_sd_N / contact.raw_N
    if share > LIMITS.sd_share_max:
        raise InputError(
            "press-not-usable",
            f"the markers show {contact.raw_N:.1f} N there with a standard deviation of "
            f"{100.0 * share:.0f} % (at most {100.0 * LIMITS.sd_share_max:.0f} %); press farther "
            "from the rims, or harder",
        )
    ratio = force_N / contact.raw_N
    if not 1.0 / LIMITS.ratio_max <= ratio <= LIMITS.ratio_max:
        raise InputError(
            "press-not-usable",
            f"the markers show {contact.raw_N:.1f} N, and {force_N:.4g} N were given; check the "
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
        uv=np.clip(sensor.surface.chart(points), *sensor.surface.domain.T),
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
    sensor: Sensor,
    bundle: Bundle,
    presses: Sequence[KnownPress],
    *,
    wall: WallSolver | None = None,
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
    wall : WallSolver, optional
        The design's shell, for the print's own thickness.
    """
    samples = press_samples(sensor, bundle, presses)
    plain = designed_locator(bundle)
    fitted, facts = calibrate_locator(
        plain,
        samples,
        np.arange(samples.count),
        force_max_N=bundle.force_max_N,
        wall=wall,
    )
    if facts["contacts"] < CALIBRATION.contacts_min and fitted.correction is not None:
        # One factor does not hold the error of linear tables.
        fitted = replace(fitted, correction=replace(fitted.correction, linear=True))
    return replace(bundle, model=replace(bundle.model, locator=fitted)), facts


def designed_wall(design: Design, progress: Callable[[str], None]) -> UnevenWall | None:
    """The shell of a design, and what its cameras see of it; None where it is too large."""
    context = run_stages(
        design,
        select_stages(["views"]),
        accuracy="standard",
        seed=0,
        force=True,
        progress=progress,
    )[0]
    return uneven_wall_of(context)


def stated_shares(bundle: Bundle, presses: Sequence[KnownPress]) -> FloatArray:
    """Half the 95 % interval of each press that is found, over its force, (k,)."""
    shares = []
    for press in presses:
        seen = press.measured
        found = bundle.model.contacts(seen.shift_px, seen.koi, marked=seen.marked)
        shares += [INTERVAL_SDS * one.sd_N / one.force_N for one in found.contacts]
    return np.array(shares)


def doubts(presses: Sequence[KnownPress]) -> list[str]:
    """Reasons to distrust presses: one against the others, or all of them."""
    ratio = np.array([press.force_N / press.contact.raw_N for press in presses])
    noise = np.array([press.contact.raw_sd_N / press.contact.raw_N for press in presses])
    sd = np.hypot(noise, CALIBRATION.spread_prior[0])
    log, out = np.log(ratio), []
    for number in range(len(presses) if len(presses) > 2 else 0):
        others = float(np.median(np.delete(log, number)))
        if abs(log[number] - others) > LIMITS.doubtful_sds * sd[number]:
            out.append(
                f"by press {number + 1} the print is {ratio[number]:.2f} times as stiff as the "
                f"design, by the others {np.exp(others):.2f} times: one of them is wrong"
            )
    if abs(np.median(log)) > LIMITS.doubtful_sds * LOCATOR.stiffness_sd:
        out.append(
            f"the print seems {np.exp(np.median(log)):.2f} times as stiff as the design, more than "
            "prints differ: check the unit, the scale's zero, and that this is the design's "
            "material and thickness"
        )
    return out


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
    skipped : list of int
        Receptors that were proposed and not pressed.

    Raises
    ------
    InputError
        If the decoder is of another design or not by design alone, or a picture shows no unloaded
        sensor.
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
        designed_locator(bundle)
        self._sensor, self._out, self._rest = sensor, out, rest
        self._base, self._plain = bundle, calibrate_rest(bundle, rest)
        self.calibrated = self._plain
        if self._plain.turned_deg != bundle.turned_deg:
            raise InputError(
                "shell-turned",
                f"the shell sits turned by {self._plain.turned_deg:g} degrees about the axis; "
                "mount it as the design has it, so that places are right, and start again",
            )
        pressed = pressed_note(measure_frame(self._plain, rest).koi)
        if pressed:
            raise InputError("rest-frame-pressed", f"{pressed}; give one of the unloaded sensor")
        locator = designed_locator(self._plain)
        self._radius_mm = locator.places.radius_mm
        self._receptors = pressable_receptors(self._plain, locator)
        self._proposed: int | None = None
        self._facts: dict[str, Any] = {}
        self.presses: list[KnownPress] = []
        self.skipped: list[int] = []

    @property
    def interval_share(self) -> float:
        """Half the 95 % interval of a press over its force, median; without any the stiffness's."""
        shares = stated_shares(self.calibrated, self.presses)
        return float(np.median(shares)) if len(shares) else INTERVAL_SDS * LOCATOR.stiffness_sd

    def proposal(self) -> str:
        """Say where to press next."""
        known = [press.contact.point_mm for press in self.presses]
        known += [self._plain.position_mm[receptor] for receptor in self.skipped]
        at = next_press(
            self._plain.position_mm[self._receptors],
            np.array(known).reshape(-1, 3),
            radius_mm=self._radius_mm,
        )
        self._proposed = int(self._receptors[at])
        return self._place(self._proposed)

    def skip(self) -> None:
        """Do not propose the last receptor again."""
        if self._proposed is not None:
            self.skipped.append(self._proposed)

    def seen_at(self, press: KnownPress) -> str:
        """Say where a press was seen."""
        return self._place(nearest_marker(press.contact.point_mm, self._plain.position_mm))

    def _place(self, receptor: int) -> str:
        markers = self._sensor.markers
        x, y, z = self._plain.position_mm[receptor]
        return (
            f"receptor {receptor} (row {markers.row[receptor]}, column {markers.column[receptor]}; "
            f"x {x:.0f}, y {y:.0f}, z {z:.0f} mm)"
        )

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
        calibrated, facts = calibrate_to_presses(self._sensor, self._plain, presses)
        if facts["contacts"] < len(presses):
            raise InputError(
                "press-not-single", "its switches do not show one contact; press in another place"
            )
        with writing(self._out):
            if len(presses) == 1:
                self._remove_old()
                self._keep("rest", self._rest)
            self._keep(f"press_{len(presses):03d}", images)
            self._write_log(presses)
        self.presses, self.calibrated, self._facts = presses, calibrated, facts
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
        if not self.presses:
            return
        presses = self.presses[:-1]
        with writing(self._out):
            for folder in self._folders:
                (folder / f"press_{len(self.presses):03d}.png").unlink(missing_ok=True)
            if not presses:
                self._remove_old()
            self._write_log(presses)
        self.presses, self.calibrated, self._facts = presses, self._plain, {}
        if presses:
            self.calibrated, self._facts = calibrate_to_presses(self._sensor, self._plain, presses)

    @property
    def shows_wall(self) -> bool:
        """Whether there are enough presses for the thickness of the wall."""
        return len(self.presses) >= UNEVEN.blocks_min

    def fit_wall(self, wall: WallSolver) -> None:
        """Calibrate to the presses again, with the thickness of the print's wall.

        It takes ten seconds or more, so that it is not done after each press.
        """
        self.calibrated, self._facts = calibrate_to_presses(
            self._sensor, self._plain, self.presses, wall=wall
        )

    def save(self) -> dict[str, Any]:
        """Write the decoder and ``instance.json``; return the latter's contents."""
        facts: dict[str, Any] = {
            "format": FORMAT,
            "schema_version": SCHEMA,
            "design": self._plain.design,
            "design_hash": self._plain.design_hash,
            "presses": len(self.presses),
            "interval_share": self.interval_share,
            "doubts": doubts(self.presses),
            "auto": self._facts,
        }
        notes = {"instance": finite({name: facts[name] for name in ("presses", "interval_share")})}
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

    @property
    def _folders(self) -> list[Path]:
        """Folder of each camera's pictures."""
        suffixes = CAMERA_SUFFIXES[: len(self._rest)]
        return [self._out / f"{FRAMES}{suffix}" for suffix in suffixes]

    def _remove_old(self) -> None:
        """Remove what an earlier run has left."""
        (self._out / TABLE).unlink(missing_ok=True)
        for suffix in CAMERA_SUFFIXES:
            folder = self._out / f"{FRAMES}{suffix}"
            for path in (*folder.glob("press_*.png"), folder / "rest.png"):
                path.unlink(missing_ok=True)
            with suppress(OSError):  # it is not there, or the user keeps something in it
                folder.rmdir()

    def _keep(self, name: str, images: Sequence[ImageArray]) -> None:
        for folder, image in zip(self._folders, images, strict=True):
            folder.mkdir(exist_ok=True)
            (folder / f"{name}.png").write_bytes(encode_png(image))

    def _write_log(self, presses: Sequence[KnownPress]) -> None:
        """Write presses as a log that ``phytac import`` reads; remove it if there is none."""
        log = self._out / LOG
        if not presses:
            log.unlink(missing_ok=True)
            return
        new = log.with_suffix(".part")
        with new.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(COLUMNS)
            for number, press in enumerate(presses, start=1):
                contact = press.contact
                place = [f"{value:.3f}" for value in (*contact.point_mm, contact.radius_mm)]
                rows.writerow([f"press_{number:03d}.png", *place, f"{press.force_N:.6g}"])
        new.replace(log)


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Context in which files of a folder are written.

    Raises
    ------
    OutputError
        If they cannot be.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {out}: {error.strerror}; make room, or choose another --out",
        ) from None
