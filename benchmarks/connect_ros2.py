"""ROS 2 topics at 480 frames a second to three subscribers, one of which stalls.

Subscribers are processes with the types that ``tests/ros2_subscriber.py`` has by hand; as a
program, this module is one of them.
"""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter

import numpy as np

from benchmarks.harness import Table
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.core.ros2_topics import Ros2Topics
from tests.decoder.toy_sensor import toy_bundle

DOMAIN = 87
RATE_Hz = 480.0
PRESSED_N = {7: 3.0, 14: 1.0, 28: 0.5}
"""Receptors; the first two are one contact."""
CONTACTS = 2
STALLS_AT = 0.1
"""Share of the time after which the third subscriber is stopped for the rest of it."""


def streamed(table: Table, *, quick: bool) -> None:
    """Publish all topics; two subscribers count contacts, a third is stopped (SIGSTOP)."""
    seconds = 5.0 if quick else 60.0
    os.environ |= {
        "ROS_DOMAIN_ID": str(DOMAIN),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    make = MessageBuilder(bundle=toy_bundle(), estimator="fem", started_unix_s=time.time())
    forces = np.zeros(30)
    forces[list(PRESSED_N)] = list(PRESSED_N.values())
    reading = Reading(koi=np.array(list(PRESSED_N)), forces_N=forces, warnings=[])
    one = make.frame(reading, sequence=0, timestamp_s=0.0, decoded_s=0.0)
    words = [sys.executable, "-m", "benchmarks.connect_ros2"]
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
    whole = min(each["whole"] for each in found)
    late_ms = np.concatenate([each["late_ms"] for each in found])
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
    table.goal("ROS 2: processor time of a frame", cost_ms, "ms", "<= 2", note="all topics")


def listen() -> None:
    """One subscriber: counts contacts until standard input says something."""
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from tests.ros2_subscriber import LOCAL, RELIABLE, TactileContact

    own = Domain(DOMAIN, LOCAL)
    here = DomainParticipant(DOMAIN)
    where = Topic(here, "rt/phytac/contacts", TactileContact)
    reader = DataReader(here, where, qos=RELIABLE)
    while not reader.get_matched_publications():
        time.sleep(0.02)
    print("ready", flush=True)
    contacts, late_ms = Counter[tuple[int, int]](), []
    ended = False
    while not ended:
        for contact in reader.take(N=100):
            now_s, stamp = time.time(), contact.header.stamp
            contacts[stamp.sec, stamp.nanosec] += 1
            late_ms.append(1e3 * (now_s - stamp.sec - 1e-9 * stamp.nanosec))
        ended = bool(select.select([sys.stdin], [], [], 0.001)[0])
    whole = sum(number == CONTACTS for number in contacts.values())
    print(json.dumps({"whole": whole, "late_ms": [round(late, 3) for late in late_ms]}))
    del own


if __name__ == "__main__":
    listen()
