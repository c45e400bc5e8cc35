"""What the peers play to the node: a bag of `veneer synth`, its topics under the names that the node reads,
and its mesh in plain numbers."""

import json
import struct

# Topics of the bag, and what the node reads them as.
TOPICS = {
    "/camera/color/image_raw": "/rgb/image",
    "/camera/color/image_raw/compressed": "/rgb/image/compressed",
    "/camera/depth/image_raw": "/depth/image",
    "/camera/depth/image_raw/compressedDepth": "/depth/image/compressedDepth",
    "/camera/color/camera_info": "/rgb/camera_info",
    "/camera/depth/camera_info": "/depth/camera_info",
    "/camera/pose": "/pose",
    "/mesh": "/mesh",
}


def say(**words):
    print(json.dumps(words), flush=True)


def read_bag(path):
    """Stamps in nanoseconds, topics, types and serialised messages."""
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            yield message.log_time, channel.topic, schema.name, bytes(message.data)


def mesh_numbers(data):
    """Vertices (x, y, z) and triangles (a, b, c) of a mesh_msgs/MeshGeometryStamped."""
    at = 4

    def align(size):
        nonlocal at
        at = 4 + (at - 4 + size - 1) // size * size

    def u32():
        nonlocal at
        align(4)
        (value,) = struct.unpack_from("<I", data, at)
        at += 4
        return value

    def tuples(format):
        nonlocal at
        num = u32()
        if num:
            align(struct.calcsize(format[:1] + format[-1]))
        found = []
        for _ in range(num):
            found.append(struct.unpack_from(format, data, at))
            at += struct.calcsize(format)
        return found

    u32(), u32()
    for _ in range(2):  # frame_id, uuid
        length = u32()
        at += length
    vertices = tuples("<3d")
    tuples("<3d")  # normals
    return vertices, tuples("<3I")
