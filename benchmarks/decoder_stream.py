"""The force stream under load: ten clients of which one stalls, and a soak at 480 fps."""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.decoder_stream_clients import READERS, clients
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import rest_positions
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.force_server import ClientLimits, StreamServer
from phytac_decoder.serving.sensor_loop import Decode, Stream, frame_decoder
from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.design.design_file import load_design
from phytac_design.stages.build import build, copy_of
from phytac_shapes.arrays import ImageArray

DESIGN = "cylinder60"
FPS = 480.0
PERIOD_MS = 1000.0 / FPS
WARM_SHARE = 0.2
"""Memory counts as settled after this share of the soak."""
STAND_IN = (
    "a stand-in for the decoder gives made-up forces on 4 to 12 key nodes at no cost: transport "
    "alone; of a decoder's own speed it says nothing"
)


class Repeated(Source):
    """The same frames over and over; ``asked_s`` keeps when each was requested."""

    description, clock = "rendered frames", "number / 480 fps"

    def __init__(self, images: list[ImageArray]) -> None:
        self.images, self.first, self.count = images, 0, 0
        self.asked_s: list[float] = []

    def __iter__(self) -> Iterator[Frame]:
        for number in range(self.first, self.first + self.count):
            now = time.monotonic()
            self.asked_s.append(now)
            yield Frame(
                number=number,
                timestamp_s=number / FPS,
                images=(self.images[number % len(self.images)],),
                ready_s=now,
            )
        self.asked_s.append(time.monotonic())
        self.first += self.count

    def close(self) -> None:
        """Nothing is open."""


class Ticks(Source):
    """480 empty frames a second; one that is late by a whole period counts as missed."""

    description, clock = "a stand-in", "number / 480 fps"

    def __init__(self, seconds: float) -> None:
        self._count = round(seconds * FPS)
        self.rss_mib: list[float] = []

    def __iter__(self) -> Iterator[Frame]:
        started = time.monotonic()
        for number in range(self._count):
            due = started + number / FPS
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            now = time.monotonic()
            if now - due >= 1.0 / FPS:
                self.missed += 1
                continue
            if number % 48 == 0:
                self.rss_mib.append(rss_mib())
            yield Frame(number=number, timestamp_s=number / FPS, images=(), ready_s=now)

    def close(self) -> None:
        """Nothing is open."""


def rss_mib() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def sensor(folder: Path) -> tuple[Bundle, list[ImageArray], Decode]:
    """``cylinder60`` before a camera of 640×480, its frames at rest and pressed, its decoder."""
    focal_px = load_design(DESIGN).camera.focal_px * 640.0 / 2592.0
    camera = {"width_px": 640, "height_px": 480, "focal_px": focal_px}
    design = copy_of(load_design(DESIGN), camera=camera)
    # At 640×480 some of its markers fuse: good enough to time.
    build(
        design,
        folder / "build",
        accuracy="draft",
        only=["frames"],
        force=True,
        progress=lambda _: None,
    )
    bundle = load_bundle(folder / "build" / "decoder")
    views = folder / "build" / "views"
    images = [read_image(views / f"frame_{name}.png") for name in ("rest", "pressed")]
    decode = frame_decoder(bundle, rest_px=rest_positions(bundle, images[0]))
    return bundle, images, decode


def made_up(bundle: Bundle) -> Decode:
    """Random forces on 4 to 12 key nodes, computed in advance."""
    rng = np.random.default_rng(3)
    count = len(bundle.position_mm)
    readings = []
    for _ in range(64):
        koi = np.sort(rng.choice(count, rng.integers(4, 13), replace=False))
        forces = np.zeros(count)
        forces[koi] = rng.uniform(0.5, 25.0, len(koi))
        readings.append(Reading(koi=koi, forces_N=forces))
    return lambda frame: readings[frame.number % 64]


def add_stalled(table: Table, folder: Path, *, quick: bool) -> Bundle:
    """The sensor's own decoder with no client, and with ten of which one stalls."""
    bundle, images, decode = sensor(folder)
    rounds, frames = (3, 20) if quick else (20, 100)
    messages = MessageBuilder(bundle=bundle, estimator="koi_inverse")
    limits, started_s = ClientLimits(patience_s=600.0), time.monotonic()
    lone_ms: list[float] = []
    ten_ms: list[float] = []
    with (
        StreamServer(messages.hello(), port=0) as lone,
        StreamServer(messages.hello(), port=0, limits=limits) as busy,
        clients(busy, started_s, stalled=1) as heard,
    ):
        sources = {lone.port: Repeated(images), busy.port: Repeated(images)}
        for _ in range(rounds):
            for server, into in ((lone, lone_ms), (busy, ten_ms)):
                source = sources[server.port]
                source.count, source.asked_s = frames, []
                Stream(
                    source=source,
                    decode=decode,
                    messages=messages,
                    publish=server.publish,
                    started_s=started_s,
                ).run()
                into.extend((1000.0 * np.diff(source.asked_s)).tolist())
        sent = sources[busy.port].first
        dropped = busy.dropped
        busy.close()
        got = heard()
    lone_p50, lone_p99 = np.percentile(lone_ms, (50, 99))
    ten_p50, ten_p99 = np.percentile(ten_ms, (50, 99))
    head = f"{DESIGN} at 640x480, decoded and sent"
    same = "the same loop without clients, in turns, same run"
    row = f"{head}, no client: median time of a frame"
    table.add(row, float(lone_p50), "ms", "none", "frame by frame, koi_inverse")
    row = f"{head}: ten clients of which one stalls, over none: median time of a frame"
    table.add(row, float(ten_p50 / lone_p50), "ratio", float(lone_p50), same, "<= 1.1")
    row = f"{head}: ten clients of which one stalls, over none: p99 time of a frame"
    table.add(row, float(ten_p99 / lone_p99), "ratio", float(lone_p99), same)
    row = f"{head}: messages that the nine who read did not get ({READERS} × {sent} sent)"
    table.add(row, got.missing(sent), "messages", 0, "counted by the clients", "== 0")
    row = f"{head}: messages dropped for the one who stalls"
    table.add(row, dropped, "messages", "none", "kept to the end, though it never reads")
    return bundle


def add_soak(table: Table, bundle: Bundle, *, quick: bool) -> None:
    """480 frames a second to nine who read and one who stalls."""
    seconds = 3.0 if quick else 600.0
    # The loop alone first, without a server.
    alone_s = min(seconds / 3.0, 60.0)
    messages = MessageBuilder(bundle=bundle, estimator="stand-in")
    alone = Ticks(alone_s)
    Stream(source=alone, decode=made_up(bundle), messages=messages, publish=lambda _: None).run()
    started_s, source = time.monotonic(), Ticks(seconds)
    with (
        StreamServer(messages.hello(), port=0, limits=ClientLimits(patience_s=2.0)) as server,
        clients(server, started_s, stalled=1) as heard,
    ):
        stream = Stream(
            source=source,
            decode=made_up(bundle),
            messages=messages,
            publish=server.publish,
            started_s=started_s,
        )
        busy, begun = time.process_time(), time.monotonic()
        stream.run()
        share = (time.process_time() - busy) / (time.monotonic() - begun)
        server.close()
        got = heard()
    sent = stream.progress.frames
    head = f"stream at 480 fps for {seconds:g} s, nine clients read and one stalls"
    rss = source.rss_mib
    settled = float(np.median(rss[int(WARM_SHARE * len(rss)) :][:10]))
    p50, p99 = np.percentile(got.latency_ms, (50, 99))
    late = (
        f"{STAND_IN}; without any server the loop missed {alone.missed} in {alone_s:g} s too: "
        "other programs had the processor"
    )
    growth = float(np.median(rss[-10:])) - settled
    period = "a frame's period; clients in one other process"
    before = "late by a whole period; the loop alone before, without a server, in as long"
    row = f"{head}: frames that the loop missed"
    unit, reference = f"of {sent + source.missed}", alone.missed * seconds / alone_s
    note = late if alone.missed else STAND_IN
    table.add(row, source.missed, unit, reference, before, "== 0", note)
    row = f"{head}: messages that the nine did not get ({READERS} × {sent} sent)"
    counted = "counted by the clients"
    table.add(row, got.missing(sent), "messages", 0, counted, "== 0", STAND_IN)
    row = f"{head}: growth of resident memory"
    after = f"after {WARM_SHARE * seconds:g} s"
    table.add(row, growth, "MiB", settled, after, "<= 1", STAND_IN)
    row = f"{head}: from decoded to received: median"
    table.add(row, float(p50), "ms", PERIOD_MS, period, note=STAND_IN)
    row = f"{head}: from decoded to received: p99"
    table.add(row, float(p99), "ms", PERIOD_MS, period, f"<= {PERIOD_MS:.3f}", STAND_IN)
    row = f"{head}: processor time of loop and server"
    share_of = "process time over wall time"
    table.add(row, 100.0 * share, "% of a core", "none", share_of, note=STAND_IN)


def add_rows(table: Table, *, quick: bool) -> None:
    """All of the above."""
    with tempfile.TemporaryDirectory() as scratch:
        bundle = add_stalled(table, Path(scratch), quick=quick)
    add_soak(table, bundle, quick=quick)
