#!/usr/bin/env python
"""What do five fingers feel when a racket hits a ball? A stroke at 480 fps, a curve for each.

The hand grips, swings, and 110 ms later the ball is on the strings for 5 ms: the handle kicks
against index finger and the heel of the thumb, slips by 1.5 mm and rings. Each finger's curve is
compared with its true one: the greatest force, when it comes, and the error all along.
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from recorded import decode, hand, handle, moving, press, quick_of, record, region_forces, words

from phytac_shapes.arrays import FloatArray

FPS = 480.0
SECONDS = 0.2
HIT_S, ON_STRINGS_S, RINGS_HZ, FADES_S = 0.11, 0.005, 55.0, 0.02
HELD_N = np.array([6.0, 4.5, 5.0, 4.5, 4.0])
SWUNG_N = np.array([4.0, 2.0, 3.0, 3.5, 3.0])
"""More in the swing, thumb to little finger."""
KICKED_N = np.array([9.0, 11.0, 5.0, -1.5, 6.0])
"""And at the hit."""
SLIP_SHARE = 1.5 / 80.0


def stroke(time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """True force (s, 5) N of each finger, and how far the handle has slipped, share of it, (s,)."""
    swing = np.clip(time_s / HIT_S, 0.0, 1.0) ** 2 * np.exp(-np.clip(time_s - HIT_S, 0, 1) / 0.06)
    after = np.clip(time_s - HIT_S, 0.0, 1.0)
    pulse = np.where(after < ON_STRINGS_S, np.sin(np.pi * after / ON_STRINGS_S), 0.0)
    ringing = np.exp(-after / FADES_S) * np.sin(2.0 * np.pi * RINGS_HZ * after)
    kick = np.where(time_s >= HIT_S, pulse + 0.5 * ringing, 0.0)
    force = HELD_N + np.multiply.outer(swing, SWUNG_N) + np.multiply.outer(kick, KICKED_N)
    return np.maximum(force, 0.5), SLIP_SHARE * (1.0 - np.exp(-after / 0.01))


def main(out: Path, *, quick: bool = False) -> dict[str, FloatArray]:
    """Run the example; times (s,) s, true and decoded forces (s, 5) N."""
    sensor = handle(out)
    time_s = np.arange(round(SECONDS * FPS)) / FPS
    if quick:
        time_s = time_s[48:64]
    truth, slip = stroke(time_s)
    scenario = moving(hand("stroke"), truth, np.repeat(slip[:, None], 5, axis=1))
    samples = press(sensor, quick_of(scenario) if quick else scenario, workers=0 if quick else 2)
    messages = decode(sensor, samples, fps=FPS)
    record(sensor, messages, "stroke")
    found = region_forces(messages)
    print(f"{'finger':>8} {'peak N':>7} {'true':>6} {'late by':>8} {'RMS N':>6}")
    for number, name in enumerate(sensor.names):
        true, got = truth[:, number], found[:, number]
        late_ms = 1000.0 * (time_s[got.argmax()] - time_s[true.argmax()])
        rms = np.sqrt(np.mean((got - true) ** 2))
        print(f"{name:>8} {got.max():7.2f} {true.max():6.2f} {late_ms:5.1f} ms {rms:6.2f}")
    names = {contact["id"] for message in messages for contact in message["contacts"]}
    most = max(len(message["contacts"]) for message in messages)
    print(f"{len(messages)} frames: at most {most} contacts at once, {len(names)} in all")
    fig, axes = plt.subplots(5, 1, figsize=(8, 9), sharex=True, layout="constrained")
    for number, axis in enumerate(axes):
        axis.plot(1000.0 * time_s, truth[:, number], "k-", lw=0.8, label="true")
        axis.plot(1000.0 * time_s, found[:, number], ".-", color=f"C{number}", label="decoded")
        axis.set(ylabel=f"{sensor.names[number]}, N", ylim=(0, None))
    axes[0].legend(loc="upper left")
    axes[0].set_title("A stroke at 480 fps")
    axes[-1].set_xlabel("time, ms")
    fig.savefig(out / "stroke.png", dpi=110)
    plt.close(fig)
    print(f"wrote {out / 'stroke.png'}")
    return {"time_s": time_s, "truth_N": truth, "found_N": found}


if __name__ == "__main__":
    given = words(__doc__)
    main(given.out, quick=given.quick)
