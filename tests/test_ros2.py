"""ROS 2 topics, received by a process that knows the published definitions alone."""

import contextlib
import json
import os
import runpy
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock
from xml.etree import ElementTree as ET

import cv2
import pytest
import yaml

from phytac_design.core.ros2_messages import (
    DEFINITIONS,
    SENSOR_FRAME,
    camera_messages,
    frame_messages,
)
from phytac_design.core.ros2_topics import (
    LOCAL,
    QUEUE,
    TOPIC_TYPES,
    TYPE_HASHES,
    Ros2Topics,
    domain_id,
    local_only,
)
from tests.decoder.toy_sensor import toy_recording
from tests.docs.pages import ROOT, blocks
from tests.docs.parser import fault
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


def test_pictures_are_published_if_asked_for(domain: str, tmp_path: Path) -> None:
    decoder, pictures = toy_recording(tmp_path, [{}, {}])
    shown = [cv2.imread(str(path)) for path in sorted(pictures.iterdir())]
    words = ("--fps", "50", "--every", "--loop", "--rest-first", "1", "--port", "0")
    command = [*PHYTAC, "serve", str(decoder), str(pictures), *words, "--ros2-images"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as serving:
        try:
            with subscribed(domain, "wrench", "camera/image_raw") as other:
                assert other.stdout is not None
                assert other.stdout.readline() == "ready\n"
                time.sleep(0.6)
                printed, _ = other.communicate("end\n", timeout=PATIENCE_S)
        finally:
            serving.terminate()
            serving.wait(PATIENCE_S)
    found = received(printed)
    # Half of 50 frames: each 1/31 s, the next one.
    assert 5 < len(found["camera/image_raw"]) < 0.7 * len(found["wrench"])
    image, height = found["camera/image_raw"][-1], shown[0].shape[0]
    assert (image["height"], image["width"], image["step"]) == (height, shown[0].shape[1],
                                                                3 * shown[0].shape[1])  # fmt: skip
    assert (image["encoding"], image["header"]["frame_id"]) == ("bgr8", "camera_optical")
    assert any(image["data"] == each.ravel().tolist() for each in shown)
    stamps, forces = (
        [tuple(one["header"]["stamp"].values()) for one in found[topic]]
        for topic in ("camera/image_raw", "wrench")
    )
    assert len(set(stamps)) == len(stamps)
    assert len(set(stamps) & set(forces)) > 5


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


def test_the_guide_receives_wrenches(domain: str, tmp_path: Path) -> None:
    (code,) = blocks(ROOT / "docs" / "guides" / "ros2.md", "python")
    code = code.replace("DomainParticipant(0)", f"DomainParticipant({domain})").replace("5_", "1_")
    make = messages()
    environment = {**os.environ, "CYCLONEDDS_URI": LOCAL}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "text": True, "env": environment}
    with (
        Ros2Topics(make) as topics,
        subprocess.Popen([sys.executable, "-uc", code], **pipes) as other,
    ):
        end_s, sent = time.monotonic() + 3.0, frames(make, 2)[0]
        while (
            time.monotonic() < end_s and not topics._writers["wrench"].get_matched_subscriptions()
        ):
            time.sleep(0.02)
        time.sleep(0.1)
        topics.add(sent)
        printed, _ = other.communicate(timeout=PATIENCE_S)
    assert printed == "1700000000 -4.5\n"


def test_the_package_starts_this_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its launch file with stand-ins for ROS's modules, which are not installed here."""
    folder, made = ROOT / "examples" / "ros2" / "phytac_ros2", MagicMock()
    made.LaunchConfiguration.side_effect = lambda name: name.upper()
    for name in ("ament_index_python.packages", "launch", "launch.actions", "launch.conditions",
                 "launch.substitutions", "launch_ros.actions"):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, made)
    made.get_package_share_directory.return_value = str(folder)
    launch = folder / "launch" / "sensor.launch.py"
    runpy.run_path(str(launch))["generate_launch_description"]()
    command = made.ExecuteProcess.call_args.kwargs["cmd"]
    assert command[:4] == ["PHYTAC", "serve", "BUNDLE", "SOURCE"]
    assert fault(("phytac", *command[1:])) == ""
    mount, rviz = (call.kwargs for call in made.Node.call_args_list)
    frame = SENSOR_FRAME
    assert mount["arguments"] == ["--frame-id", "PARENT", "--child-frame-id", frame]
    shown = yaml.safe_load(Path(rviz["arguments"][1]).read_text())["Visualization Manager"]
    assert shown["Global Options"]["Fixed Frame"] == frame
    kinds = {one["Class"].rpartition("/")[2]: one["Topic"]["Value"].removeprefix("/phytac/")
             for one in shown["Displays"] if "Topic" in one}  # fmt: skip
    assert kinds == {"MarkerArray": "markers", "Wrench": "wrench"}
    assert set(kinds.values()) < set(TOPIC_TYPES)
    package = ET.parse(folder / "package.xml").getroot()  # noqa: S314 - our own
    assert package.findtext("name") == folder.name
    made.setup.reset_mock()
    monkeypatch.setattr("setuptools.setup", made.setup)
    monkeypatch.chdir(folder)
    runpy.run_path("setup.py")
    files = [Path(file) for _, some in made.setup.call_args.kwargs["data_files"] for file in some]
    assert all(file.is_file() for file in files)
    assert {launch.relative_to(folder), Path("package.xml")} < set(files)
