"""ROS 2 topics, received by a process that knows the published definitions alone."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phytac_design.core.ros2_messages import DEFINITIONS, camera_messages, frame_messages
from phytac_design.core.ros2_topics import QUEUE, TYPE_HASHES, Ros2Topics, domain_id, local_only
from tests.decoder.toy_sensor import toy_recording
from tests.refusals import refused
from tests.test_cli import PHYTAC, phytac
from tests.test_mcap import START_s, frames, messages

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (extra ros2)")
PATIENCE_S = 30.0
SUBSCRIBER = Path(__file__).with_name("ros2_subscriber.py")


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> str:
    """A ROS domain of this machine alone that no other test uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = str(1 + free.getsockname()[1] % 100)
    monkeypatch.setenv("ROS_DOMAIN_ID", number)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    return number


@contextlib.contextmanager
def subscribed(*words: str) -> Iterator["subprocess.Popen[str]"]:
    """The subscriber's process."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, str(SUBSCRIBER), *words], **pipes) as process:  # type: ignore[call-overload]
        try:
            yield process
        finally:
            process.kill()


def received(printed: str) -> dict[str, list[dict[str, Any]]]:
    out = defaultdict(list)
    for line in printed.splitlines():
        for topic, fields in json.loads(line).items():
            out[topic].append(fields)
    return dict(out)


def plain(value: Any, kind: str = "") -> Any:
    """Fields as JSON has them, with single precision where their type has it."""
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple | bytes):
        return [plain(one) for one in value]
    return pytest.approx(value, rel=1e-6) if isinstance(value, float) else value


def test_a_stranger_receives_every_field(domain: str) -> None:
    make = messages()
    sent = frames(make, 3)
    with subscribed(domain) as other:
        with Ros2Topics(make) as topics:
            assert other.stdout is not None
            assert other.stdout.readline() == "ready\n"
            for message in sent:
                topics.add(message)
        # Nothing is lost at the end.
        time.sleep(0.5)
        printed, _ = other.communicate("end\n", timeout=PATIENCE_S)
    found, names = received(printed), set[str]()
    expected = defaultdict(list)
    for message in sent:
        stamp_ns = round(1e9 * START_s) + round(1e9 * message["timestamp_s"])
        for topic, type_name, fields in frame_messages(message, stamp_ns, 30):
            expected[topic].append(plain(fields))
            names.add(type_name)
    (info,) = camera_messages(make.bundle.cameras, round(1e9 * START_s))
    expected["camera/camera_info"].append(plain(info.fields))
    assert found == expected
    inner = {
        name for name in DEFINITIONS if any(name in DEFINITIONS[other] for other in DEFINITIONS)
    }
    assert len(inner | names | {"sensor_msgs/CameraInfo"}) >= 20
    assert (topics.rows, topics.dropped) == (3, 0)


def test_hashes_are_the_published_ones() -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    for edition in (typesys.Stores.ROS2_HUMBLE, typesys.Stores.ROS2_JAZZY):
        store = typesys.get_typestore(edition)
        own = DEFINITIONS["tactile_msgs/TactileContact"]
        store.register(typesys.get_types_from_msg(own, "tactile_msgs/msg/TactileContact"))
        for name, digest in TYPE_HASHES.items():
            assert store.hash_rihs01(name.replace("/", "/msg/")) == f"RIHS01_{digest}", name


def test_the_command_publishes_and_tares(tmp_path: Path, domain: str) -> None:
    decoder, pictures = toy_recording(tmp_path, [{}, {}])
    words = ("--fps", "50", "--every", "--loop", "--rest-first", "1", "--port", "0", "--ros2")
    command = [*PHYTAC, "serve", str(decoder), str(pictures), *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as serving:
        try:
            with subscribed(domain, "wrench") as other:
                assert other.stdout is not None
                assert other.stdout.readline() == "ready\n"
                printed, _ = other.communicate("tare\n", timeout=PATIENCE_S)
        finally:
            serving.terminate()
            _, reported = serving.communicate(timeout=PATIENCE_S)
    found = received(printed)
    assert found["tare"] == [
        {"guid": 2**63 + 5, "seq": 3, "success": True, "message": "a new rest frame was taken"}
    ]
    assert len(found["wrench"]) > 5
    assert found["wrench"][-1]["header"]["frame_id"] == "sensor"
    assert f"service /phytac/tare in domain {domain}" in reported
    assert "whoever is in this network" not in reported


def test_no_subscriber_delays_the_decoder(domain: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make = messages()
    with Ros2Topics(make) as topics:
        stuck, lost = os.pipe(), 3
        # As if DDS did not return.
        monkeypatch.setattr(topics, "_send", lambda _: os.read(stuck[0], 1))
        begin = time.monotonic()
        for message in frames(make, QUEUE + 1 + lost):
            topics.add(message)
            time.sleep(0.0 if topics._waiting else 0.1)
        assert time.monotonic() - begin < 2.0
        assert topics.dropped == lost
        os.write(stuck[1], bytes(2 * QUEUE))


def test_environment_and_missing_library(
    domain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (str(domain_id()), local_only()) == (domain, True)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    with refused("ros2-environment"):
        Ros2Topics(messages())
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert not local_only()
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    assert local_only()
    for wrong in ("233", "-1", "one"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with refused("ros2-environment"):
            Ros2Topics(messages())
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Wrong/></CycloneDDS>")
    with refused("ros2-not-started"):
        Ros2Topics(messages())
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    toy_recording(tmp_path, [{}])
    done = phytac("serve", "decoder", "frames", "--port", "0", "--ros2", cwd=tmp_path)
    assert done.returncode != 0
    assert "phytac-design[ros2]" in done.stderr
