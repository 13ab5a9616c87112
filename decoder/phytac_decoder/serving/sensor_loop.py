"""The sensor's loop from frames to messages, with its progress once a second."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import cv2
import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.imu import Imu
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.drift import DriftReference
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError, OutputError, PhytacError

Decode = Callable[[Frame], Reading]
"""Decodes one frame after another; raises a PhytacError for one that it cannot read."""


def frame_decoder(
    bundle: Bundle,
    *,
    estimator: str = "koi_inverse",
    rest_px: FloatArray | None = None,
    drift: DriftReference | None = None,
) -> Decode:
    """Decode each frame by itself.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    estimator : str
        One of :data:`phytac_decoder.estimation.estimators.ESTIMATORS`.
    rest_px : (n, 2) float, optional
        From :func:`phytac_decoder.pipeline.decode.rest_positions`.
    drift : DriftReference, optional
        Of this bundle: frames are decoded relative to the slow motion of its cameras.

    Raises
    ------
    InputError
        If there is no such estimator.
    """
    check_estimator(bundle, estimator)

    def decode(frame: Frame) -> Reading:
        measured = measure_frame(bundle, frame.images, rest_px=rest_px)
        if drift:
            return drift.read(measured, estimator, frame.timestamp_s)
        return read(bundle, measured, estimator)

    return decode


def follow_decoder(
    bundle: Bundle,
    rest: Sequence[ImageArray],
    *,
    estimator: str = "koi_inverse",
    stride: int = 1,
    drift: DriftReference | None = None,
) -> Decode:
    """Decode frames in their order, markers followed from each to the next: much faster.

    Frames may be missing: the numbers of the others show for how long the markers have moved.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    rest : sequence of (h, w, 3) uint8
        A frame of the unloaded sensor of each camera.
    estimator : str
        One of :data:`phytac_decoder.estimation.estimators.ESTIMATORS`.
    stride : int
        See :class:`phytac_decoder.pipeline.tracker.Follower`.
    drift : DriftReference, optional
        See :func:`frame_decoder`.

    Raises
    ------
    InputError
        If there is no such estimator, or the rest frame is none of this sensor.
    """
    check_estimator(bundle, estimator)
    follower, last = Follower(bundle, rest, stride=stride), -1
    before: Reading | None = None

    def decode(frame: Frame) -> Reading:
        nonlocal last, before
        elapsed, last = max(frame.number - last, 1), frame.number
        seen = follower.follow(frame.images, elapsed=float(elapsed))
        if drift:
            before = drift.read(seen, estimator, frame.timestamp_s, before=before)
        else:
            before = read(bundle, seen, estimator, before=before)
        return replace(before, warnings=[*before.warnings, *seen.flags])

    return decode


def check_estimator(bundle: Bundle, estimator: str) -> None:
    """Raise InputError if the bundle has no such estimator."""
    known = bundle.model.estimators
    if estimator not in known:
        raise InputError(
            "estimator-unknown",
            f"the decoder has no estimator {estimator!r}; known: {', '.join(known)}",
        )


class MessageRecorder(Protocol):
    """Writes frames to a file as they come.

    Attributes
    ----------
    rows : int
        Rows, or frames, so far.
    """

    rows: int

    def add(self, message: Message) -> None:
        """Write a frame; raises OutputError if the disk is full."""


@dataclass(kw_only=True)
class Progress:
    """Progress of a stream.

    Attributes
    ----------
    seconds : float
        Since it began.
    frames : int
        Decoded, or tried, so far.
    unread : int
        Of these, those that gave no forces.
    fps : float
        Frames per second, since the last report.
    latency_ms : list of float
        From each frame's arrival to its published message, since the last report.
    missed, skipped : int
        Frames so far that passed while another was decoded, and that could not be read.
    """

    seconds: float = 0.0
    frames: int = 0
    unread: int = 0
    fps: float = 0.0
    missed: int = 0
    skipped: int = 0
    latency_ms: list[float] = field(default_factory=list)

    def total(self) -> str:
        """Summary in one line."""
        return (
            f"{self.frames} frames in {self.seconds:.1f} s, {self.unread} unread, {self.skipped} "
            f"skipped, {self.missed} missed"
        )

    def text(self, *, clients: int, dropped: int) -> str:
        """Report in one line."""
        p50, p99 = np.percentile(self.latency_ms, (50, 99)) if self.latency_ms else (0.0, 0.0)
        counts = {"missed": self.missed, "skipped": self.skipped, "unread": self.unread}
        more = "".join(f", {count} {name}" for name, count in counts.items() if count)
        return (
            f"{self.seconds:6.0f} s  {self.fps:6.1f} fps  latency p50 {p50:.2f} p99 {p99:.2f} ms  "
            f"{clients} client{'' if clients == 1 else 's'}, {dropped} dropped{more}"
        )


@dataclass(kw_only=True)
class Stream:
    """Decodes a source's frames and publishes their messages.

    Attributes
    ----------
    source : Source
        Of the frames.
    decode : callable
        A frame to a reading.
    messages : Messages
        Its ``started_unix_s`` is that of ``started_s``.
    publish : callable
        Takes each message and returns at once.
    started_s : float
        ``time.monotonic()`` at which ``decoded_s`` is 0.
    imu : Imu, optional
        Motion samples to merge in.
    recorders : list of MessageRecorder
        Files that frames are written to.
    tare_result : callable
        How a new rest frame that was asked for turned out, once, for the frame's message; else
        None. See :class:`phytac_decoder.serving.tare.TareDecoder`.
    report : callable
        Called with a line on frames that cannot be decoded and on a full disk.
    each_second : callable
        Called with the progress.
    progress : Progress
        So far.
    """

    source: Source
    decode: Decode
    messages: MessageBuilder
    publish: Callable[[Message], None]
    started_s: float = field(default_factory=time.monotonic)
    imu: Imu | None = None
    recorders: list[MessageRecorder] = field(default_factory=list)
    tare_result: Callable[[], Message | None] = lambda: None
    report: Callable[[str], None] = print
    each_second: Callable[[Progress], None] = lambda _: None
    progress: Progress = field(default_factory=Progress)

    def run(self) -> None:
        """Run to the source's end.

        Raises
        ------
        PhytacError
            If the source or the publisher fails. A frame that cannot be decoded is published as
            not valid, with the reason.
        """
        now, source = self.progress, self.source
        reported_s, reported_frames, warned_s = self.started_s, 0, -np.inf
        for frame in source:
            # Counted before decoding: a camera continues meanwhile.
            message = self._message(frame, source.missed + source.skipped)
            self.publish(message)
            if not message["valid"]:
                now.unread += 1
                if frame.ready_s - warned_s > 1.0:
                    warned_s = frame.ready_s
                    self.report(f"frame {frame.number}: {message['warnings'][-1]}")
            self._record(message)
            now.frames += 1
            now.latency_ms.append(message["latency_ms"])
            now.missed, now.skipped = source.missed, source.skipped
            done_s = time.monotonic()
            now.seconds = done_s - self.started_s
            if done_s - reported_s >= 1.0:
                now.fps = (now.frames - reported_frames) / (done_s - reported_s)
                self.each_second(now)
                reported_s, reported_frames = done_s, now.frames
                now.latency_ms.clear()
        now.missed, now.skipped = source.missed, source.skipped

    def _reading(self, frame: Frame) -> Reading:
        away = f"{self.source.description} gave no picture for {frame.gap_s:.1f} s"
        if not frame.images:
            return Reading.none(f"{away}; is it plugged in?", "camera-lost")
        try:
            reading = self.decode(frame)
        except (PhytacError, cv2.error, np.linalg.LinAlgError) as error:
            code = error.code if isinstance(error, PhytacError) else ""
            return Reading.none(f"the frame cannot be decoded: {error}", code)
        if frame.gap_s:
            note = f"{away}: if it was moved or its settings changed, take a new rest frame"
            return replace(reading, warnings=[*reading.warnings, note])
        return reading

    def _message(self, frame: Frame, missed: int) -> Message:
        reading = self._reading(frame)
        done_s = time.monotonic()
        message = self.messages.frame(
            reading,
            sequence=frame.number,
            timestamp_s=frame.timestamp_s,
            decoded_s=done_s - self.started_s,
            latency_ms=1000.0 * (done_s - frame.ready_s),
            missed=missed,
            gap_s=frame.gap_s,
            imu=self.imu.latest(frame.timestamp_s) if self.imu else None,
        )
        result = self.tare_result()
        if result is not None:
            message["tare"] = result
            self.report(f"tare: {result.get('reason', 'a new rest frame was taken')}")
        return message

    def _record(self, message: Message) -> None:
        for recorder in list(self.recorders):
            try:
                recorder.add(message)
            except OutputError as error:
                # The robot needs forces even if the disk is full.
                self.report(f"recording stops: {error}")
                self.recorders.remove(recorder)
