"""A peer on Cyclone DDS, without ROS: plays a bag to the node and hears what it publishes.

play BAG   publishes colour, intrinsics, poses and the mesh, then says what it sent; receives until
           stdin closes, then says what it heard
"""

import argparse
import dataclasses
import sys
import threading
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from played_bag import TOPICS, mesh_numbers, read_bag, say


@final
@dataclasses.dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclasses.dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@final
@dataclasses.dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@final
@dataclasses.dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@final
@dataclasses.dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@final
@dataclasses.dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    header: Header
    pose: Pose


@final
@dataclasses.dataclass
class PoseArray(IdlStruct, typename="geometry_msgs.msg.dds_.PoseArray_"):
    header: Header
    poses: sequence[Pose]


@final
@dataclasses.dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@final
@dataclasses.dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs.msg.dds_.RegionOfInterest_"):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@final
@dataclasses.dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs.msg.dds_.CameraInfo_"):
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


@final
@dataclasses.dataclass
class MeshTriangle(IdlStruct, typename="shape_msgs.msg.dds_.MeshTriangle_"):
    vertex_indices: array[uint32, 3]


@final
@dataclasses.dataclass
class Mesh(IdlStruct, typename="shape_msgs.msg.dds_.Mesh_"):
    triangles: sequence[MeshTriangle]
    vertices: sequence[Point]


@final
@dataclasses.dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs.msg.dds_.KeyValue_"):
    key: str
    value: str


@final
@dataclasses.dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@final
@dataclasses.dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


# What is played, as Cyclone knows it.
KINDS = {
    "/rgb/image/compressed": CompressedImage,
    "/rgb/camera_info": CameraInfo,
    "/pose": PoseStamped,
    "/mesh": Mesh,
}
HEARD = {"/veneer/keyframes": PoseArray, "/diagnostics": DiagnosticArray}


def qos(latched):
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)),
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(1000),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def shape_mesh(data):
    """mesh_msgs/MeshGeometryStamped as shape_msgs/Mesh: the same numbers."""
    vertices, triangles = mesh_numbers(data)
    return Mesh(
        triangles=[MeshTriangle(vertex_indices=list(three)) for three in triangles],
        vertices=[Point(*xyz) for xyz in vertices],
    )


def messages_of(bag):
    for stamp, topic, _, data in read_bag(bag):
        kind = KINDS.get(TOPICS.get(topic))
        if kind is not None:
            made = shape_mesh(data) if kind is Mesh else kind.deserialize(data)
            yield stamp, TOPICS[topic], made


def play(args):
    messages = list(messages_of(args.bag))
    participant = DomainParticipant(args.domain)
    writers = {
        topic: DataWriter(participant, Topic(participant, "rt" + topic, kind), qos(topic == "/mesh"))
        for topic, kind in KINDS.items()
    }
    readers = {
        topic: DataReader(participant, Topic(participant, "rt" + topic, kind), qos("keyframes" in topic))
        for topic, kind in HEARD.items()
    }
    deadline = time.monotonic() + args.wait
    lonely = list(writers)
    while lonely and time.monotonic() < deadline:
        lonely = [t for t, w in writers.items() if not w.get_matched_subscriptions()]
        time.sleep(0.05)
    say(matched=not lonely, missing=lonely)
    time.sleep(0.5)
    heard = dict.fromkeys(HEARD, 0)
    frames = 0
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()

    def hear():
        nonlocal frames
        for topic, reader in readers.items():
            for sample in reader.take(100):
                heard[topic] += 1
                if topic == "/veneer/keyframes":
                    frames = len(sample.poses)

    begun, first = time.monotonic(), messages[0][0]
    sent = dict.fromkeys(writers, 0)
    for stamp, topic, made in messages:
        while (left := begun + (stamp - first) * 1e-9 - time.monotonic()) > 0:
            time.sleep(min(left, 0.02))
            hear()
        writers[topic].write(made)
        sent[topic] += 1
    say(sent=sent)
    while not stop.is_set():
        hear()
        time.sleep(0.02)
    say(heard=heard, keyframes=frames)


def main():
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("play")
    one.add_argument("bag")
    one.add_argument("--domain", type=int, required=True)
    one.add_argument("--wait", type=float, default=15.0)
    play(parser.parse_args())


main()
