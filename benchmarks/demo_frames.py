"""Share of contacts inside their 95 % intervals, in frames like the demo frame of the README.

The demo frame of a build (``views/frame_pressed.png``) is the one of 50 that has the most switches
on. Here frames with as many contacts are drawn with another seed, at random places with random
forces and sizes, solved with large displacements as the demo is, rendered, and decoded as ``phytac
decode`` does, with a rest frame. Judgement is that of :mod:`benchmarks.camera`. ::

    python -m benchmarks.demo_frames [--quick]
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.camera import Bench, Outcome, decode
from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.harness import Table, run_parts
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.contacts import Contacts, draw_contacts, switch_states
from phytac_design.stages.renders_stage import FrameContacts, draw_frame_contacts
from phytac_design.stages.response_stage import truth_solver

DESIGN, FRAMES = "cylinder60", 300
SEED = 101
"""Of the contacts; a build's are drawn with its own seed, 0."""


class DemoBench(Bench):
    """A built decoder, and frames like its demo frame."""

    def __init__(self, design: Design, frames: int) -> None:
        self.context = mechanics(design, "standard")
        self.bundle = by_design(self.context)
        demo = draw_frame_contacts(replace(self.context, seed=0))
        self.contacts_each = int(demo.contacts.counts[demo.switching.example])
        contacts = self._like(frames)
        markers = self.context.markers.count
        self.pressed = FrameContacts(
            contacts=contacts,
            switching=switch_states(self.context.sensor, contacts),
            motion=np.zeros((contacts.samples, markers, 6)),
        )
        self.scenes = PressedScene(self.context.sensor, self.context.sensor.cameras[0])
        self._truth = truth_solver(self.context)

    def _like(self, frames: int) -> Contacts:
        """Draw samples of as many contacts as the demo has."""
        rng = np.random.default_rng(SEED)
        drawn = draw_contacts(self.context.sensor, samples=20 * frames, rng=rng)
        samples = np.flatnonzero(drawn.counts == self.contacts_each)[:frames]
        return drawn.pick(np.flatnonzero(np.isin(drawn.sample, samples)), samples)

    def solve(self, index: int) -> bool:
        """Solve the motion of one frame; return whether it converged."""
        pressed = self.pressed.contacts.of(index)
        found = self._truth.solve(pressed, pressed.force_N).motion
        if found is not None:
            self.pressed.motion[index] = found
        return found is not None


def judge_frames(bench: DemoBench) -> tuple[Outcome, int]:
    """Decode all frames; also return how many did not converge."""
    camera = bench.context.sensor.cameras[0]
    bundle = calibrate_rest(bench.bundle, [bench.frame(None, camera)])
    out, failed = Outcome(), 0
    for index in range(bench.count):
        if bench.solve(index):
            bench.judge(out, index, decode(bundle, bench.frame(index, camera)))
        else:
            failed += 1
    return out, failed


def add_rows(table: Table, bench: DemoBench, out: Outcome, failed: int) -> None:
    """Rows of one design."""
    name = f"{bench.context.design.name}, {out.frames} demo-like frames"
    note = f"{bench.contacts_each} contacts each, {failed} frames did not converge; {out}"
    share = 100.0 * out.inside / max(out.contacts, 1)
    table.goal(f"{name}: contacts inside 95 % intervals", share, "%", ">= 95", note=note)
    table.goal(f"{name}: silently wrong contacts", out.silent, "", "== 0")
    warned = 100.0 * out.warned / out.frames
    source = "all contacts are sound, so that each warning is false or of a real ambiguity"
    table.add(f"{name}: frames with a warning", warned, "%", 0.0, source)
    table.add(f"{name}: contacts that turned a switch on and are not found", out.missed, "", 0.0,
              "pressed contacts")  # fmt: skip


def add_frames(table: Table, *, quick: bool) -> None:
    """Decode the frames, and add the rows."""
    bench = DemoBench(load_design(DESIGN), 3 if quick else FRAMES)
    add_rows(table, bench, *judge_frames(bench))


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Return the only part."""
    return {DESIGN: partial(add_frames, quick=quick)}


if __name__ == "__main__":
    run_parts("demo_frames", parts, __doc__ or "")
