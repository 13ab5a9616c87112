"""The sensor's loop: frames in, forces out, and how it goes, once a second."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.imu import Imu
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.csv_recording import Recorder, RegionRecorder
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError, OutputError, PhytacError

Decode = Callable[[Frame], Reading]
"""A frame to forces, in order; raises a PhytacError for one that it cannot read."""


def frame_decoder(
    bundle: Bundle, *, estimator: str = "koi_inverse", rest_px: FloatArray | None = None
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

    Raises
    ------
    InputError
        If there is no such estimator.
    """
    _known(bundle, estimator)

    def decode(frame: Frame) -> Reading:
        measured = measure_frame(bundle, frame.images, rest_px=rest_px)
        return read(bundle, measured, estimator)

    return decode


def follow_decoder(
    bundle: Bundle, rest: Sequence[ImageArray], *, estimator: str = "koi_inverse", stride: int = 1
) -> Decode:
    """Decode frames in their order, markers followed from each to the next: much faster.

    Frames may be missing; then the others' numbers tell for how long the markers have moved.

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

    Raises
    ------
    InputError
        If there is no such estimator, or the rest frame is none of this sensor.
    """
    _known(bundle, estimator)
    follower, last = Follower(bundle, rest, stride=stride), -1
    before: Reading | None = None

    def decode(frame: Frame) -> Reading:
        nonlocal last, before
        elapsed, last = max(frame.number - last, 1), frame.number
        seen = follower.follow(frame.images, elapsed=float(elapsed))
        before = read(bundle, seen, estimator, before=before)
        return replace(before, warnings=[*before.warnings, *seen.flags])

    return decode


def _known(bundle: Bundle, estimator: str) -> None:
    known = bundle.model.estimators
    if estimator not in known:
        raise InputError(f"the decoder has no estimator {estimator!r}; known: {', '.join(known)}")


@dataclass(kw_only=True)
class Progress:
    """How the stream goes.

    Attributes
    ----------
    seconds : float
        Since it began.
    frames : int
        Decoded, or tried, so far.
    unread : int
        Of these, those that gave no forces.
    fps : float
        Frames a second, since the last progress.
    latency_ms : list of float
        From a frame at hand to its message published, since the last progress.
    missed, skipped : int
        Frames so far that went by while another was decoded, and that could not be read.
    """

    seconds: float = 0.0
    frames: int = 0
    unread: int = 0
    fps: float = 0.0
    missed: int = 0
    skipped: int = 0
    latency_ms: list[float] = field(default_factory=list)

    def total(self) -> str:
        """How it went, in one line for people."""
        return (
            f"{self.frames} frames in {self.seconds:.1f} s, {self.unread} unread, {self.skipped} "
            f"skipped, {self.missed} missed"
        )

    def text(self, *, clients: int, dropped: int) -> str:
        """One line for people."""
        p50, p99 = np.percentile(self.latency_ms, (50, 99)) if self.latency_ms else (0.0, 0.0)
        more = "".join(
            f", {count} {name}"
            for count, name in (
                (self.missed, "missed"),
                (self.skipped, "skipped"),
                (self.unread, "unread"),
            )
            if count
        )
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
        Makes them; its ``started_unix_s`` is that of ``started_s``.
    publish : callable
        Takes each message and returns at once.
    started_s : float
        ``time.monotonic()`` at which ``decoded_s`` is 0.
    imu : Imu, optional
        Motion samples to merge in.
    recorders : list of Recorder or RegionRecorder
        Where contacts, and forces of regions, are kept.
    report : callable
        Told about frames that cannot be decoded and a disk that is full.
    each_second : callable
        Told how it goes.
    progress : Progress
        How it has gone so far.
    """

    source: Source
    decode: Decode
    messages: MessageBuilder
    publish: Callable[[Message], None]
    started_s: float = field(default_factory=time.monotonic)
    imu: Imu | None = None
    recorders: list[Recorder | RegionRecorder] = field(default_factory=list)
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
        reported_s, reported_frames, told_s = self.started_s, 0, -np.inf
        for frame in source:
            # Of the frames before this one; a camera goes on counting while it is decoded.
            message = self._message(frame, source.missed + source.skipped)
            self.publish(message)
            if not message["valid"]:
                now.unread += 1
                if frame.ready_s - told_s > 1.0:
                    told_s = frame.ready_s
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

    def _message(self, frame: Frame, missed: int) -> Message:
        try:
            reading = self.decode(frame)
        except (PhytacError, cv2.error, np.linalg.LinAlgError) as error:
            reading = Reading.none(f"the frame cannot be decoded: {error}")
        done_s = time.monotonic()
        return self.messages.frame(
            reading,
            sequence=frame.number,
            timestamp_s=frame.timestamp_s,
            decoded_s=done_s - self.started_s,
            latency_ms=1000.0 * (done_s - frame.ready_s),
            missed=missed,
            imu=self.imu.latest(frame.timestamp_s) if self.imu else None,
        )

    def _record(self, message: Message) -> None:
        for recorder in list(self.recorders):
            try:
                recorder.add(message)
            except OutputError as error:
                # A full disk is no reason to leave the robot without forces.
                self.report(f"recording stops: {error}")
                self.recorders.remove(recorder)
