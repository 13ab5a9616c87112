#!/usr/bin/env python
"""When does the egg break? Virtual objects that respond to the force of the hand.

A hand closes around the handle up to 92 N, opens, and closes gently; an egg that is crushed at
50 N, a vase at 80 N and a soft ball that gives between 5 and 20 N are in it in turn. Their state
is driven by the decoded force alone, and compared with what the true force would have done.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from recorded import decode, hand, handle, moving, press, quick_of, record, words

from phytac_shapes.arrays import FloatArray

FPS = 30.0
SHARES = np.array([1.6, 1.0, 1.0, 0.8, 0.6]) / 5.0
HELD_N = 1.0
"""Below this an object is not held."""


@dataclass(kw_only=True)
class Brittle:
    """An object that breaks for good."""

    name: str
    crushed_N: float
    state: str = "free"

    def feel(self, force_N: float) -> str:
        """State after one frame."""
        if self.state == "crushed" or force_N >= self.crushed_N:
            self.state = "crushed"
        else:
            self.state = "held" if force_N > HELD_N else "free"
        return self.state


@dataclass(kw_only=True)
class Soft:
    """A ball that is compressed between two forces, and recovers."""

    name: str
    first_N: float = 5.0
    full_N: float = 20.0
    squeezed: float = 0.0

    def feel(self, force_N: float) -> str:
        """State after one frame; ``squeezed`` is 0 to 1."""
        share = (force_N - self.first_N) / (self.full_N - self.first_N)
        self.squeezed = float(np.clip(share, 0.0, 1.0))
        if self.squeezed == 1.0:
            return "flat"
        return "squeezed" if self.squeezed > 0.0 else "held" if force_N > HELD_N else "free"


def objects() -> list[Brittle | Soft]:
    """The paper's three."""
    return [
        Brittle(name="egg", crushed_N=50.0),
        Brittle(name="vase", crushed_N=80.0),
        Soft(name="soft ball"),
    ]


def happened(total_N: Sequence[float] | FloatArray) -> dict[str, list[str]]:
    """State of each object in each frame of a grip force (s,)."""
    return {thing.name: [thing.feel(float(force)) for force in total_N] for thing in objects()}


def closing(count: int) -> FloatArray:
    """Grip force (s,) N: up to 92 N, open, and up to 18 N."""
    corner = np.array([0.0, 0.55, 0.65, 0.7, 0.9, 1.0])
    return np.interp(np.linspace(0, 1, count), corner, [0.0, 92.0, 0.0, 0.0, 18.0, 0.0])


def main(out: Path, *, quick: bool = False) -> dict[str, FloatArray]:
    """Run the example; true and decoded grip force (s,) N."""
    sensor = handle(out)
    truth = closing(15 if quick else 80)
    scenario = moving(hand("squeeze"), np.multiply.outer(truth, SHARES))
    samples = press(sensor, quick_of(scenario) if quick else scenario, workers=0 if quick else 2)
    messages = decode(sensor, samples, fps=FPS)
    record(sensor, messages, "objects")
    found = np.array([message["total_N"] for message in messages])
    true_states, states = happened(truth), happened(found)
    for name, line in states.items():
        changes = [k for k in range(1, len(line)) if line[k] != line[k - 1]]
        events = [f"{line[k]} at {truth[k]:.0f} N ({found[k]:.0f} decoded)" for k in changes]
        same = np.mean([a == b for a, b in zip(line, true_states[name], strict=True)])
        print(f"{name}: {', '.join(events)}")
        print(f"  as the true force would have it in {same:.0%} of frames")
    fig, axis = plt.subplots(figsize=(9, 4), layout="constrained")
    time_s = np.arange(len(truth)) / FPS
    axis.plot(time_s, truth, "k-", lw=0.8, label="true grip force")
    axis.plot(time_s, found, ".-", label="decoded")
    brittle = [thing for thing in objects() if isinstance(thing, Brittle)]
    for thing, colour in zip(brittle, ("C1", "C3"), strict=True):
        axis.axhline(thing.crushed_N, color=colour, ls="--", lw=0.8)
        axis.text(0, thing.crushed_N + 1, f"{thing.name} breaks", color=colour)
        if "crushed" in states[thing.name]:
            at = states[thing.name].index("crushed")
            axis.plot(time_s[at], found[at], "x", color=colour, ms=10, mew=3)
    axis.axhspan(5.0, 20.0, color="C2", alpha=0.15)
    axis.text(0, 12, "soft ball gives", color="C2")
    axis.set(xlabel="time, s", ylabel="N", title="Virtual objects in a simulated hand")
    axis.legend()
    fig.savefig(out / "objects.png", dpi=110)
    plt.close(fig)
    print(f"wrote {out / 'objects.png'}")
    return {"truth_N": truth, "found_N": found}


if __name__ == "__main__":
    given = words(__doc__)
    main(given.out, quick=given.quick)
