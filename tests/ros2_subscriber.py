"""A subscriber of ROS 2 topics over DDS, written from the published .msg files alone.

Prints ``ready`` when every topic has a publisher, then each message as a line of JSON, until
standard input closes or says ``tare``: then the service's reply, too. With ``count``, it counts
contacts instead.
"""

import dataclasses
import json
import select
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import (
    array,
    byte,
    float32,
    float64,
    int32,
    int64,
    sequence,
    uint8,
    uint32,
    uint64,
)  # fmt: skip
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class ColorRGBA(IdlStruct, typename="std_msgs::msg::dds_::ColorRGBA_"):
    r: float32
    g: float32
    b: float32
    a: float32


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@dataclass
class UInt8MultiArray(IdlStruct, typename="std_msgs::msg::dds_::UInt8MultiArray_"):
    layout: MultiArrayLayout
    data: sequence[uint8]


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector3
    torque: Vector3


@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header
    wrench: Wrench


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class UVCoordinate(IdlStruct, typename="visualization_msgs::msg::dds_::UVCoordinate_"):
    u: float32
    v: float32


@dataclass
class MeshFile(IdlStruct, typename="visualization_msgs::msg::dds_::MeshFile_"):
    filename: str
    data: sequence[uint8]


@dataclass
class Marker(IdlStruct, typename="visualization_msgs::msg::dds_::Marker_"):
    header: Header
    ns: str
    id: int32
    type: int32
    action: int32
    pose: Pose
    scale: Vector3
    color: ColorRGBA
    lifetime: Duration
    frame_locked: bool
    points: sequence[Point]
    colors: sequence[ColorRGBA]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool


@dataclass
class MarkerArray(IdlStruct, typename="visualization_msgs::msg::dds_::MarkerArray_"):
    markers: sequence[Marker]


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: byte
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class TactileContact(IdlStruct, typename="tactile_msgs::msg::dds_::TactileContact_"):
    header: Header
    name: str
    position: Point
    normal: Vector3
    wrench: Wrench


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


TOPICS = {
    "wrench": WrenchStamped,
    "regions/thumb/wrench": WrenchStamped,
    "regions/left_palm/wrench": WrenchStamped,
    "contacts": TactileContact,
    "markers": MarkerArray,
    "switches": UInt8MultiArray,
    "diagnostics": DiagnosticArray,
    "camera/camera_info": CameraInfo,
}
TYPES = {**TOPICS, "camera/image_raw": Image}
"""Those of pictures are there if they are asked for."""
LOCAL = """<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface
address='127.0.0.1'/></Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"""
RELIABLE = Qos(
    Policy.Reliability.Reliable(0), Policy.History.KeepAll, Policy.DataRepresentation(True, False)
)
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepAll)


def heard(reader: DataReader) -> bool:
    """Whether a publisher is there, by the name of the type alone, as ROS has it."""
    own = reader.topic.get_type_name()
    there = map(reader.get_matched_publication_data, reader.get_matched_publications())
    return own in [one.type_name for one in there if one]


def count(reader: DataReader) -> None:
    """Contacts of each time stamp, and when the last came, until standard input says something."""
    found = {}
    while not select.select([sys.stdin], [], [], 0.001)[0]:
        for contact in reader.take(N=100):
            stamp = contact.header.stamp
            at = f"{stamp.sec}.{stamp.nanosec:09}"
            late_ms = 1e3 * (time.time() - stamp.sec - 1e-9 * stamp.nanosec)
            so_far = found.get(at, {"contacts": 0})["contacts"]
            found[at] = {"contacts": so_far + 1, "late_ms": round(late_ms, 3)}
    print(json.dumps(found))


def main(domain: int, topics: list[str], *, counting: bool = False) -> None:
    _ = Domain(domain, LOCAL)
    here = DomainParticipant(domain)
    readers = {}
    for topic in topics:
        where = Topic(here, f"rt/phytac/{topic}", TYPES[topic])
        # Two of the other kind, as rclcpp::SensorDataQoS asks for.
        loose = topic in {"switches", "camera/image_raw"}
        readers[topic] = DataReader(here, where, qos=BEST_EFFORT if loose else RELIABLE)
    ask = DataWriter(here, Topic(here, "rq/phytac/tareRequest", TriggerRequest), qos=RELIABLE)
    replies = DataReader(here, Topic(here, "rr/phytac/tareReply", TriggerResponse), qos=RELIABLE)
    end_s = time.monotonic() + 20.0
    while not (all(map(heard, [*readers.values(), replies])) and ask.get_matched_subscriptions()):
        if time.monotonic() > end_s:
            sys.exit("a topic has no publisher")
        time.sleep(0.02)
    print("ready", flush=True)
    if counting:
        count(readers["contacts"])
        return
    if sys.stdin.readline().strip() == "tare":
        ask.write(TriggerRequest(guid=2**63 + 5, seq=3, structure_needs_at_least_one_member=0))
        while not (found := replies.take()):
            time.sleep(0.02)
        print(json.dumps({"tare": dataclasses.asdict(found[0])}))
    for topic, reader in readers.items():
        for one in (one for one in reader.take(N=1000) if isinstance(one, TYPES[topic])):
            print(json.dumps({topic: dataclasses.asdict(one)}, default=list))


if __name__ == "__main__":
    if sys.argv[2:] == ["count"]:
        main(int(sys.argv[1]), ["contacts"], counting=True)
    else:
        main(int(sys.argv[1]), sys.argv[2:] or list(TOPICS))
