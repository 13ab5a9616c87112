"""A force stream as ROS 2 topics, over DDS from plain Python (Eclipse Cyclone DDS).

ROS's names: topic ``/a`` is ``rt/a`` in DDS, type ``p/T`` is ``p::msg::dds_::T_``, and a message is
CDR. Endpoints carry the hash of their type, as from ROS 2 Iron on.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Self

from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.sensor_loop import Decode
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_design.core.ros2_messages import (
    DEFINITIONS,
    TopicMessage,
    camera_messages,
    cdr_bytes,
    frame_messages,
    image_messages,
    parsed_fields,
    region_topic,
)
from phytac_shapes.errors import InputError, MissingPartError, OutputError

TOPICS = "/phytac/"
"""What the names of topics begin with, as in recordings."""
QUEUE = 64
"""Frames that may wait to be sent; beyond that the oldest are dropped."""
DEPTH = 256
"""Messages of a topic that are kept for a subscriber that asks again for what it lost."""
CAMERA_INFO_s, MARKERS_s = 1.0, 1.0 / 31.0
"""Least seconds between messages that describe the cameras, and between arrows (for display)."""
IMAGES_s = MARKERS_s
"""The same between pictures."""
POLL_s = 0.05
"""Longest time until a request is seen while no frame comes."""
TOPIC_TYPES = {
    "wrench": "geometry_msgs/WrenchStamped",
    "contacts": "tactile_msgs/TactileContact",
    "markers": "visualization_msgs/MarkerArray",
    "switches": "std_msgs/UInt8MultiArray",
    "diagnostics": "diagnostic_msgs/DiagnosticArray",
}
"""Topics of every sensor; those of its regions and cameras are beside them."""
TYPE_HASHES = {
    "diagnostic_msgs/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
    "geometry_msgs/WrenchStamped": (
        "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
    ),
    "sensor_msgs/CameraInfo": "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    "sensor_msgs/Image": "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "std_msgs/UInt8MultiArray": "5687e861b8d307a5e48b7515467ae7a5fc2daf805bd0ce6d8e9e604bade9f385",
    "tactile_msgs/TactileContact": (
        "94503ed59419d3bf0570843f2a5b7cb4e01130d3d7641a2fa5d7c731bc6b7bde"
    ),
    "visualization_msgs/MarkerArray": (
        "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
    ),
}
"""SHA-256 of each type's description, version 1 of ROS's interface hash."""
LOCAL = (
    "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface address='127.0.0.1'/>"
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32"
    "</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain>"
    "</CycloneDDS>"
)
"""Cyclone DDS on this machine alone."""


class Ros2Topics:
    """Publishes frames from a thread of its own, so that no subscriber delays the decoder.

    Quality of service: reliable, volatile, keep last :data:`DEPTH`. Reliable publishers serve
    subscribers that ask for best effort, too; those that stop reading are not waited for.

    Parameters
    ----------
    messages : MessageBuilder
        Of the stream.
    tare : callable
        Called when a client of the service ``tare`` asks for a new rest frame.
    images : bool
        Whether there are topics of pictures, see :meth:`with_images`. They are best effort: what a
        subscriber loses is not sent again.

    Raises
    ------
    MissingPartError
        If cyclonedds is not installed.
    InputError
        If one of ROS's environment variables is not valid.
    OutputError
        If DDS cannot be started.
    """

    def __init__(
        self,
        messages: MessageBuilder,
        tare: Callable[[], None] = lambda: None,
        *,
        images: bool = False,
    ) -> None:
        self._dds = _library()
        self.domain, self.local = domain_id(), local_only()
        self._bundle, self._tare = messages.bundle, tare
        self._started_ns = 1000 * round(1e6 * messages.started_unix_s)
        self.rows, self.dropped = 0, 0
        self._waiting = deque[Message](maxlen=QUEUE)
        self._arrived, self._ending = threading.Event(), threading.Event()
        self._requests = list[Any]()
        self._sent_s: dict[str, float] = {}
        self._images: Frame | None = None
        self._failed: str | None = None
        try:
            if self.local:
                more = os.environ.get("CYCLONEDDS_URI")
                self._own = self._dds.domain.Domain(
                    self.domain, f"{LOCAL},{more}" if more else LOCAL
                )
            self._participant = self._dds.domain.DomainParticipant(self.domain)
            # All at once: what is sent before subscribers know of a topic is lost.
            cameras = [one[:2] for one in camera_messages(messages.bundle.cameras, 0)]
            wrenches = [region_topic(region.name) for region in messages.regions]
            kinds = TOPIC_TYPES | dict.fromkeys(wrenches, TOPIC_TYPES["wrench"]) | dict(cameras)
            if images:
                pictures = [topic.replace("camera_info", "image_raw") for topic, _ in cameras]
                kinds |= dict.fromkeys(pictures, "sensor_msgs/Image")
            self._writers = {topic: self._writer(topic, kind) for topic, kind in kinds.items()}
            self._asked, self._replies = self._service("tare")
        except self._dds.core.DDSException as error:
            raise OutputError(
                "ros2-not-started", f"DDS does not start in ROS domain {self.domain} ({error})"
            ) from None
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._ending.set()
        self._arrived.set()
        self._thread.join(2.0)
        # DDS deletes them when it has sent what waits, or after a second.
        self._writers.clear()
        del self._asked, self._replies, self._participant

    def add(self, message: Message) -> None:
        """Hand over a frame; returns at once.

        Raises
        ------
        OutputError
            If DDS has failed.
        """
        if self._failed:
            raise OutputError("ros2-stopped", f"DDS takes no more messages ({self._failed})")
        self.dropped += len(self._waiting) == QUEUE
        self._waiting.append(message)
        self._arrived.set()

    def with_images(self, decode: Decode) -> Decode:
        """Return what decodes frames and hands over their pictures; 30 a second are sent."""

        def decode_and_show(frame: Frame) -> Reading:
            if self._due("images", IMAGES_s, frame.ready_s):
                self._images = frame
                self._arrived.set()
            return decode(frame)

        return decode_and_show

    def _run(self) -> None:
        try:
            while not self._ending.is_set() or self._waiting:
                self._arrived.wait(POLL_s)
                self._arrived.clear()
                self._take_requests()
                while self._waiting:
                    self._send(self._waiting.popleft())
                frame, self._images = self._images, None
                if frame:
                    stamp_ns = self._started_ns + round(1e9 * frame.timestamp_s)
                    self._write(image_messages(frame.images, stamp_ns))
            self._reply({"done": False, "reason": "the stream has ended"})
        except self._dds.core.DDSException as error:
            self._failed = str(error)

    def _send(self, message: Message) -> None:
        stamp_ns = self._started_ns + round(1e9 * message["timestamp_s"])
        out = list(frame_messages(message, stamp_ns, len(self._bundle.position_mm)))
        if self._due("camera", CAMERA_INFO_s, message["decoded_s"]):
            out += camera_messages(self._bundle.cameras, stamp_ns)
        self._write(
            one
            for one in out
            if one.topic != "markers" or self._due("markers", MARKERS_s, message["decoded_s"])
        )
        self.rows += 1
        if "tare" in message:
            self._reply(message["tare"])

    def _write(self, messages: Iterable[TopicMessage]) -> None:
        for topic, type_name, fields in messages:
            writer = self._writers[topic]
            sample = writer.data_type.__new__(writer.data_type)
            sample.cdr = cdr_bytes(type_name, fields)
            writer.write(sample)

    def _due(self, name: str, period_s: float, now_s: float) -> bool:
        """Whether what comes once in a period has to come now."""
        due = now_s - self._sent_s.get(name, -1e9) >= period_s
        if due:
            self._sent_s[name] = now_s
        return due

    def _writer(self, topic: str, type_name: str) -> Any:
        kind = dds_type(dds_name(type_name), parsed_fields(type_name))
        where = self._dds.topic.Topic(self._participant, f"rt{TOPICS}{topic}", kind)
        best_effort = type_name == "sensor_msgs/Image"
        user_data = f"typehash=RIHS01_{TYPE_HASHES[type_name]};"
        quality = self._quality(2 if best_effort else DEPTH, user_data, best_effort=best_effort)
        return self._dds.pub.DataWriter(self._participant, where, qos=quality)

    def _quality(self, depth: int, user_data: str = "", *, best_effort: bool = False) -> Any:
        policy = self._dds.qos.Policy
        reliable = policy.Reliability.Reliable(self._dds.util.duration(milliseconds=100))
        return self._dds.qos.Qos(
            policy.Reliability.BestEffort if best_effort else reliable,
            policy.Durability.Volatile,
            policy.History.KeepLast(depth),
            policy.WriterDataLifecycle(autodispose=False),
            policy.DataRepresentation(use_cdrv0_representation=True),
            policy.Userdata(user_data.encode()),
        )

    def _service(self, name: str) -> tuple[Any, Any]:
        """Reader of requests and writer of replies of a ``std_srvs/Trigger``.

        As rmw_cyclonedds has them: a request begins with its client and number, which come back.
        """
        types, head = (
            "std_srvs::srv::dds_::Trigger_",
            (("uint64", "", "guid"), ("int64", "", "seq")),
        )
        empty = ("uint8", "", "structure_needs_at_least_one_member")
        asked = dds_type(f"{types}Request_", (*head, empty), encoded=False)
        reply = dds_type(
            f"{types}Response_",
            (*head, ("bool", "", "success"), ("string", "", "message")),
            encoded=False,
        )
        topic, quality = self._dds.topic.Topic, self._quality(10)
        request = topic(self._participant, f"rq{TOPICS}{name}Request", asked)
        answer = topic(self._participant, f"rr{TOPICS}{name}Reply", reply)
        return (
            self._dds.sub.DataReader(self._participant, request, qos=quality),
            self._dds.pub.DataWriter(self._participant, answer, qos=quality),
        )

    def _take_requests(self) -> None:
        for request in self._asked.take(N=10):
            if request.sample_info.valid_data:
                self._requests.append(request)
                self._tare()

    def _reply(self, result: dict[str, Any]) -> None:
        """Answer all who wait for a tare."""
        text = result.get("reason", "a new rest frame was taken")
        for request in self._requests:
            words = {"success": result["done"], "message": text}
            answer = self._replies.data_type(guid=request.guid, seq=request.seq, **words)
            self._replies.write(answer)
        self._requests.clear()


def dds_name(type_name: str) -> str:
    """DDS's name of a ROS type ``package/Name``."""
    package, name = type_name.split("/")
    return f"{package}::msg::dds_::{name}_"


def dds_type(name: str, fields: tuple[tuple[str, str, str], ...], *, encoded: bool = True) -> Any:
    """Class of a DDS type; objects of an encoded one are their bytes ``cdr``.

    Parameters
    ----------
    name : str
        In DDS.
    fields : tuple of (str, str, str)
        Type, array suffix and name of each.
    encoded : bool
        See above.
    """
    from cyclonedds.idl import make_idl_struct, types

    def one(kind: str) -> Any:
        if kind in DEFINITIONS:
            return dds_type(dds_name(kind), parsed_fields(kind), encoded=False)
        return {"bool": bool, "string": str}.get(kind) or getattr(types, kind)

    parts = {}
    for kind, suffix, field in fields:
        inner = one(kind)
        if suffix:
            many = suffix == "]"
            inner = types.sequence[inner] if many else types.array[inner, int(suffix[:-1])]
        parts[field] = inner
    # A dot in Python is a double colon in DDS.
    made = make_idl_struct(name.rpartition("::")[2], name.replace("::", "."), parts)
    if encoded:
        made.serialize = lambda self, **_: self.cdr
    return made


def domain_id() -> int:
    """ROS's domain, of ROS_DOMAIN_ID; raises InputError if that is none."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= 232):
        raise InputError(
            "ros2-environment", f"ROS_DOMAIN_ID is a number from 0 to 232 (got {text!r})"
        )
    return int(text)


def local_only() -> bool:
    """Whether ROS's environment variables restrict topics to this machine.

    Raises
    ------
    InputError
        If ROS_AUTOMATIC_DISCOVERY_RANGE has another value than those that find topics.
    """
    if os.environ.get("ROS_LOCALHOST_ONLY", "0").strip() not in {"", "0"}:
        return True
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper()
    if reach not in {"", "SUBNET", "SYSTEM_DEFAULT", "LOCALHOST"}:
        raise InputError(
            "ros2-environment",
            f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach}: nobody would find the topics; use SUBNET "
            "or LOCALHOST",
        )
    return reach == "LOCALHOST"


def _library() -> Any:
    """The package cyclonedds, with its parts.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import cyclonedds.core
        import cyclonedds.domain
        import cyclonedds.pub
        import cyclonedds.qos
        import cyclonedds.sub
        import cyclonedds.topic
        import cyclonedds.util
    except ImportError:
        raise MissingPartError.of_library("--ros2", "cyclonedds", "ros2") from None
    return cyclonedds
