"""ROS 2 topics at 480 frames a second to three subscribers, one of which stalls.

Subscribers are processes of ``tests/ros2_subscriber.py``, which knows the definitions alone.
"""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np

from benchmarks.decoder_data import small_design
from benchmarks.harness import Table
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.core.ros2_topics import Ros2Topics

DOMAIN = 87
RATE_Hz = 480.0
PRESSED_N = {20: 3.0, 21: 1.0, 80: 0.5}
"""Receptors; the first two are one contact."""
CONTACTS = 2
STALLS_AT = 0.1
"""Share of the time after which the third subscriber is stopped for the rest of it."""


def streamed(table: Table, *, quick: bool) -> None:
    """Publish all topics; two subscribers count contacts, a third is stopped (SIGSTOP)."""
    from phytac_design.environments.grasp_environment import designed_decoder

    seconds = 5.0 if quick else 60.0
    os.environ |= {
        "ROS_DOMAIN_ID": str(DOMAIN),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    bundle = designed_decoder(small_design(), "draft", print)
    make = MessageBuilder(bundle=bundle, estimator="koi_inverse", started_unix_s=time.time())
    forces = np.zeros(len(bundle.position_mm))
    forces[list(PRESSED_N)] = list(PRESSED_N.values())
    reading = Reading(koi=np.array(list(PRESSED_N)), forces_N=forces, warnings=[])
    one = make.frame(reading, sequence=0, timestamp_s=0.0, decoded_s=0.0)
    assert len(one["contacts"]) == CONTACTS
    words = [sys.executable, "tests/ros2_subscriber.py", str(DOMAIN), "count"]
    with Ros2Topics(make) as topics:
        others = [
            subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(3)
        ]
        for other in others:
            assert other.stdout is not None
            assert other.stdout.readline() == "ready\n"
        handed_ms, begin, used_s = [], time.perf_counter(), time.process_time()
        count = round(RATE_Hz * seconds)
        for number in range(count):
            time.sleep(max(begin + number / RATE_Hz - time.perf_counter(), 0.0))
            if number == round(STALLS_AT * count):
                others[2].send_signal(signal.SIGSTOP)
            now_s = time.time() - make.started_unix_s
            message = one | {"sequence": number, "timestamp_s": now_s, "decoded_s": now_s}
            start = time.perf_counter()
            topics.add(message)
            handed_ms.append(1e3 * (time.perf_counter() - start))
        took_s = time.perf_counter() - begin
        cost_ms = 1e3 * (time.process_time() - used_s) / count
        time.sleep(1.0)
        found = [json.loads(other.communicate("end\n", timeout=60.0)[0]) for other in others[:2]]
    others[2].kill()
    others[2].communicate()
    whole = min(sum(each["contacts"] == CONTACTS for each in of.values()) for of in found)
    late_ms = [each["late_ms"] for of in found for each in of.values()]
    load = f"{count} frames of {CONTACTS} contacts in {took_s:.1f} s, {topics.dropped} dropped here"
    table.goal(
        "ROS 2: frames whose contacts both other subscribers received, one of three stopped",
        100.0 * whole / count,
        "%",
        "== 100",
        note=f"{load}; the third was stopped after {STALLS_AT * seconds:g} s",
    )
    p50, p99, most = np.percentile(late_ms, (50, 99, 100))
    table.goal(
        "ROS 2: latency from a decoded frame to the subscriber's object, p99",
        p99,
        "ms",
        "<= 20",
        note=f"p50 {p50:.2f}, longest {most:.1f}; three subscribers in Python on {os.cpu_count()} "
        f"cores that other work shared, load {os.getloadavg()[0]:.1f}",
    )
    table.goal(
        "ROS 2: time that the decoder's loop waits for a frame to be handed over, p99",
        float(np.percentile(handed_ms, 99)),
        "ms",
        "<= 0.5",
        note=f"longest {max(handed_ms):.2f}",
    )
    table.goal(
        "ROS 2: processor time of a frame", cost_ms, "ms", "<= 2", note="all topics, 112 markers"
    )
