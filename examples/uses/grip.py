#!/usr/bin/env python
"""How firmly does each finger hold? A grip with two to five fingers, each finger's force apart.

Simulates five strengths of a grip with two, three, four and five fingers, decodes them, and
compares the force in each finger's region with that finger's true one.
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from recorded import decode, hand, handle, moving, press, quick_of, record, region_forces, words

from phytac_shapes.arrays import FloatArray

SHARES = np.array([1.6, 1.0, 1.0, 0.8, 0.6])
"""Thumb to little finger, of a grip's force."""
LEVELS_N = np.array([12.0, 20.0, 28.0, 36.0, 44.0])
"""All fingers together; the thumb presses as much as the others can balance."""


def forces(levels_N: FloatArray) -> FloatArray:
    """True force (s, 5) N of each finger: four hands, each at every level."""
    rows = []
    for fingers in (2, 3, 4, 5):
        share = np.where(np.arange(5) < fingers, SHARES, 0.0)
        share *= (4.0 + fingers) / 9.0 / share.sum()
        rows.append(np.multiply.outer(levels_N, share))
    return np.concatenate(rows)


def main(out: Path, *, quick: bool = False) -> dict[str, FloatArray]:
    """Run the example; true and decoded forces (s, 5) N."""
    sensor = handle(out)
    truth = forces(LEVELS_N[1::3] if quick else LEVELS_N)
    scenario = moving(hand("grip"), truth)
    samples = press(sensor, quick_of(scenario) if quick else scenario, workers=0 if quick else 2)
    messages = decode(sensor, samples, fps=30.0)
    record(sensor, messages, "grip")
    found = region_forces(messages)
    fingers = (truth > 0.0).sum(axis=1)
    print(f"{'fingers':>8} {'MAE N':>7} {'of force':>9} {'sum':>7} {'not felt':>9}")
    for count in (2, 3, 4, 5):
        own = fingers == count
        pressed = own[:, None] & (truth > 0.0)
        error = np.abs(found - truth)[pressed]
        total = np.abs(found.sum(axis=1) / truth.sum(axis=1) - 1.0)[own]
        print(
            f"{count:8d} {error.mean():7.2f} {error.mean() / truth[pressed].mean():9.1%} "
            f"{total.mean():7.1%} {int((found[pressed] == 0.0).sum()):4d} of {pressed.sum():d}"
        )
    fig, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for number, name in enumerate(sensor.names):
        on = truth[:, number] > 0.0
        axes[0].plot(truth[on, number], found[on, number], "o", label=name)
    most = 1.1 * max(truth.max(), found.max())
    axes[0].plot([0, most], [0, most], "k-", lw=0.7)
    axes[0].set(xlabel="true force of a finger, N", ylabel="decoded, N", title="Each finger")
    axes[0].legend()
    for count in (2, 3, 4, 5):
        own = fingers == count
        axes[1].plot(truth[own].sum(axis=1), found[own].sum(axis=1), "o-", label=f"{count} fingers")
    axes[1].plot([0, truth.sum(axis=1).max()], [0, truth.sum(axis=1).max()], "k-", lw=0.7)
    axes[1].set(xlabel="true grip force, N", ylabel="decoded, N", title="The whole hand")
    axes[1].legend()
    fig.savefig(out / "grip.png", dpi=110)
    plt.close(fig)
    print(f"wrote {out / 'grip.png'}")
    return {"truth_N": truth, "found_N": found}


if __name__ == "__main__":
    given = words(__doc__)
    main(given.out, quick=given.quick)
