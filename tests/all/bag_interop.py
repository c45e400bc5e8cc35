"""Reads a bag that veneer wrote with two independent readers, checks every message against
ROS's own definitions, and writes it back with two independent writers.

usage: bag_interop.py BAG OUT_FOLDER
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

warnings.simplefilter("ignore")
from mcap.writer import CompressionType
from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer as McapRos2Writer

bag, out = Path(sys.argv[1]), Path(sys.argv[2])
ros = get_typestore(Stores.ROS2_JAZZY)


def same(ours, theirs, where):
    """Two decoders' views of one message, field by field."""
    if hasattr(ours, "__msgtype__"):
        for name in ours.__dataclass_fields__:
            if name != "__msgtype__" and not name.isupper():
                same(getattr(ours, name), getattr(theirs, name), f"{where}.{name}")
    elif isinstance(ours, np.ndarray) or isinstance(ours, list):
        if len(ours) and hasattr(ours[0], "__msgtype__"):
            assert len(ours) == len(theirs), where
            for i, (a, b) in enumerate(zip(ours, theirs)):
                same(a, b, f"{where}[{i}]")
        else:
            assert np.array_equal(np.asarray(ours), np.frombuffer(theirs, np.uint8)
                                  if isinstance(theirs, bytes) else np.asarray(theirs)), where
    else:
        assert ours == theirs, (where, ours, theirs)


with AnyReader([bag]) as reader:
    connections = {c.topic: c for c in reader.connections}
    messages = [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()]
    ours = reader.typestore
    for topic, _, raw in messages:
        kind = connections[topic].msgtype
        message = reader.deserialize(raw, kind)
        if kind in ros.types:
            # The definition we write is ROS's own, to the last field ...
            assert ours.hash_rihs01(kind) == ros.hash_rihs01(kind), kind
            # ... and so are the bytes.
            assert bytes(ros.serialize_cdr(ros.deserialize_cdr(raw, kind), kind)) == raw, kind
        assert bytes(ours.serialize_cdr(message, kind)) == raw, kind
    with open(bag, "rb") as stream:
        decoded = [(m.channel.topic, m.ros_msg) for m in read_ros2_messages(stream)]
    assert [t for t, _ in decoded] == [t for t, _, _ in messages]
    for (topic, theirs), (_, _, raw) in zip(decoded, messages):
        same(reader.deserialize(raw, connections[topic].msgtype), theirs, topic)
    by_topic = {t: reader.deserialize(raw, connections[t].msgtype) for t, _, raw in messages}

image = by_topic["/color/image_raw"]
assert (image.width, image.height, image.step, image.encoding) == (4, 2, 12, "rgb8")
assert image.header.frame_id == "cam" and image.header.stamp.nanosec == 500_000_000
assert list(image.data) == list(range(24))
pose = by_topic["/pose"].pose
assert (pose.position.x, pose.orientation.y, pose.orientation.w) == (1.0, 0.6, 0.8)
assert [b.key for b in by_topic["/mesh_update"].blocks] == [-5, 9]
assert list(by_topic["/nvblox"].blocks[0].triangles) == [0, 1, 2]
marker = by_topic["/marker_array"].markers[0]
assert (marker.type, marker.ns, len(marker.points)) == (11, "m", 3)


def swapped(raw, kind):
    message = ours.deserialize_cdr(raw, kind)
    return bytes(ours.serialize_cdr(message, kind, little_endian=False))


def rosbags_bag(name, convert, mode=CompressionMode.NONE):
    with_compression = Writer(out / name, version=9, storage_plugin=StoragePlugin.MCAP)
    with_compression.set_compression(mode, CompressionFormat.ZSTD)
    with with_compression as writer:
        opened = {
            topic: writer.add_connection(topic, c.msgtype, typestore=ours)
            for topic, c in connections.items()
        }
        for topic, time, raw in messages:
            writer.write(opened[topic], time, convert(raw, connections[topic].msgtype))


rosbags_bag("rosbags-little", lambda raw, kind: raw)
rosbags_bag("rosbags-big", swapped)
rosbags_bag("rosbags-zstd", swapped, CompressionMode.STORAGE)

for compression in CompressionType:
    with open(out / f"mcap-ros2-{compression.name.lower()}.mcap", "wb") as stream:
        writer = McapRos2Writer(stream, compression=compression, chunk_size=300)
        schemas = {}
        for (topic, message), (_, time, _) in zip(decoded, messages):
            kind = connections[topic].msgtype
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, connections[topic].msgdef.data)
            writer.write_message(topic, schemas[kind], message, log_time=time)
        writer.finish()

print(len(messages), "messages")
