"""Reads a bag of what veneer publishes with two independent decoders, puts it together again by the
rules of the messages' own files, and compares with the files that the same run exported.

usage: published.py BAG OUT_FOLDER MAX_BYTES
"""

import io
import json
import struct
import sys
import warnings
from pathlib import Path

import numpy as np
from PIL import Image
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

warnings.simplefilter("ignore")
from mcap_ros2.reader import read_ros2_messages

bag, out, max_bytes = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
ros = get_typestore(Stores.ROS2_JAZZY)

TOPICS = {
    "/veneer/textured_mesh": "veneer/msg/TexturedMeshBlock",
    "/veneer/markers": "visualization_msgs/msg/MarkerArray",
    "/veneer/scene": "foxglove_msgs/msg/SceneUpdate",
    "/veneer/mesh_geometry": "mesh_msgs/msg/MeshGeometryStamped",
    "/veneer/mesh_materials": "mesh_msgs/msg/MeshMaterialsStamped",
    "/veneer/keyframes": "geometry_msgs/msg/PoseArray",
    "/veneer/status": "veneer/msg/Status",
}

by_topic = {topic: [] for topic in TOPICS}
with AnyReader([bag]) as reader:
    kinds = {c.topic: c.msgtype for c in reader.connections}
    assert kinds == TOPICS, kinds
    store = reader.typestore
    for connection, _, raw in reader.messages():
        kind, raw = connection.msgtype, bytes(raw)
        assert len(raw) <= max_bytes, (connection.topic, len(raw))
        message = store.deserialize_cdr(raw, kind)
        assert bytes(store.serialize_cdr(message, kind)) == raw, kind
        by_topic[connection.topic].append(message)
    for kind in ("visualization_msgs/msg/MarkerArray", "geometry_msgs/msg/PoseArray"):
        assert store.hash_rihs01(kind) == ros.hash_rihs01(kind), kind

# The other decoder, message by message.
counts = {topic: 0 for topic in TOPICS}
last_status = None
with open(bag, "rb") as stream:
    for decoded in read_ros2_messages(stream):
        topic = decoded.channel.topic
        ours = by_topic[topic][counts[topic]]
        counts[topic] += 1
        theirs = decoded.ros_msg
        if topic == "/veneer/textured_mesh":
            assert theirs.block_index == ours.block_index
            assert [c.id for c in theirs.charts] == [c.id for c in ours.charts]
            assert [bytes(t.data) for t in theirs.tiles] == [bytes(t.data) for t in ours.tiles]
        if topic == "/veneer/scene" and theirs.entities:
            assert bytes(theirs.entities[0].models[0].data) == bytes(ours.entities[0].models[0].data)
        if topic == "/veneer/status":
            assert theirs.num_triangles == ours.num_triangles
assert counts == {topic: len(messages) for topic, messages in by_topic.items()}
for topic in ("textured_mesh", "markers", "scene", "mesh_geometry"):
    assert counts[f"/veneer/{topic}"] > 3, counts


def read_glb(data):
    """Corners (n, 3, 3) and coordinates (n, 3, 2) of all triangles, z up, and the images."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    blob = data[28 + size :]

    def view(index):
        v = document["bufferViews"][index]
        return blob[v.get("byteOffset", 0) : v.get("byteOffset", 0) + v["byteLength"]]

    def accessor(index):
        a = document["accessors"][index]
        kind = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}[a["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[a["type"]]
        return np.frombuffer(view(a["bufferView"]), kind)[: a["count"] * width].reshape(-1, width)

    assert "KHR_materials_unlit" in document["extensionsUsed"]
    corners, coordinates = [], []
    for primitive in document["meshes"][0]["primitives"]:
        indices = accessor(primitive["indices"]).reshape(-1)
        corners.append(accessor(primitive["attributes"]["POSITION"])[indices].reshape(-1, 3, 3))
        coordinates.append(accessor(primitive["attributes"]["TEXCOORD_0"])[indices].reshape(-1, 3, 2))
    images = [Image.open(io.BytesIO(view(i["bufferView"]))).convert("RGB") for i in document["images"]]
    return np.concatenate(corners), np.concatenate(coordinates), images


def rows(*parts):
    """Triangles as sorted rows, so that order does not matter."""
    table = np.concatenate([np.asarray(p, np.float32).reshape(len(parts[0]), -1) for p in parts], axis=1)
    return table[np.lexsort(table.T[::-1])]


def colors(coordinates, image):
    """The texel at each coordinate."""
    pixels = np.asarray(image)
    height, width = pixels.shape[:2]
    at = (coordinates.reshape(-1, 2).astype(np.float64) * [width, height]).astype(int)
    at = np.minimum(at, [width - 1, height - 1])
    return pixels[at[:, 1], at[:, 0]].reshape(len(coordinates), 3, 3)


corners, coordinates, images = read_glb((out / "scan.glb").read_bytes())
assert len(images) == 1, "one page, so that no page has to be told from another"
texel_colors = colors(coordinates, images[0])

# textured_mesh: by the comments of its file.
blocks = by_topic["/veneer/textured_mesh"]
assert all(b.base_revision == 0 and b.num_blocks == len(blocks) for b in blocks)
assert sorted(b.block_index for b in blocks) == list(range(len(blocks)))
pages = np.zeros((blocks[0].num_pages, blocks[0].page_height, blocks[0].page_width, 3), np.uint8)
charts = {}
for block in blocks:
    for chart in block.charts:
        assert chart.id not in charts
        charts[chart.id] = chart
    for tile in block.tiles:
        assert tile.format == "png"
        image = np.asarray(Image.open(io.BytesIO(bytes(tile.data))))
        assert image.shape == (tile.height, tile.width, 3)
        pages[tile.page, tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] = image
for i, page in enumerate(pages):
    assert np.array_equal(page, np.asarray(Image.open(out / f"atlas/page_{i}.png"))), f"page {i}"
held = []
for chart in charts.values():
    points = np.array([(p.x, p.y, p.z) for p in chart.vertices])
    uv = np.asarray(chart.uvs).reshape(-1, 2)
    triangles = np.asarray(chart.triangles).reshape(-1, 3)
    held.append((points[triangles], uv[triangles]))
    texels = uv * [blocks[0].page_width, blocks[0].page_height]
    low, high = texels.min(axis=0), texels.max(axis=0)
    assert (low >= [chart.x, chart.y]).all(), "outside its rectangle"
    assert (high <= [chart.x + chart.width, chart.y + chart.height]).all(), "outside its rectangle"
held = [np.concatenate(part) for part in zip(*held)]
assert np.array_equal(rows(*held), rows(corners, coordinates)), "other triangles than scan.glb"


def assert_same_surface(shown, shown_colors, what):
    """The same triangles with the same colours at their corners. A corner that lies on the border
    between two texels may show either, as coordinates are rounded."""
    ours, theirs = rows(shown, shown_colors), rows(corners, texel_colors)
    assert ours.shape == theirs.shape, (what, ours.shape, theirs.shape)
    assert np.array_equal(ours[:, :9], theirs[:, :9]), what
    assert (ours != theirs).any(axis=1).mean() < 0.01, what


# markers: by the rules of rviz2's triangle lists.
shown, shown_colors, names = [], [], set()
for array in by_topic["/veneer/markers"]:
    for marker in array.markers:
        if marker.action == 3:
            assert not shown
            continue
        assert (marker.action, marker.type) == (0, 11)
        assert marker.texture.format == "png" and marker.texture_resource.startswith("embedded://")
        names.add(marker.texture_resource)
        points = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3, 3)
        uv = np.array([(c.u, c.v) for c in marker.uv_coordinates]).reshape(-1, 3, 2)
        assert len(points) == len(uv) and uv.min() >= 0 and uv.max() <= 1
        image = Image.open(io.BytesIO(bytes(marker.texture.data))).convert("RGB")
        shown.append(points)
        shown_colors.append(colors(uv, image))
assert len(names) == len(shown)
assert_same_surface(np.concatenate(shown), np.concatenate(shown_colors), "markers")

# scene: each model a GLB file of its own.
shown, shown_colors, names = [], [], set()
for update in by_topic["/veneer/scene"]:
    for entity in update.entities:
        names.add(entity.id)
        (model,) = entity.models
        assert model.media_type == "model/gltf-binary"
        points, uv, (image,) = read_glb(bytes(model.data))
        shown.append(points)
        shown_colors.append(colors(uv, image))
assert len(names) == len(shown)
assert_same_surface(np.concatenate(shown), np.concatenate(shown_colors), "scene")

# mesh_msgs.
looks = {m.uuid: m.mesh_materials for m in by_topic["/veneer/mesh_materials"]}
shown = []
for geometry in by_topic["/veneer/mesh_geometry"]:
    mesh, look = geometry.mesh_geometry, looks.pop(geometry.uuid)
    faces = np.array([f.vertex_indices for f in mesh.faces])
    assert len(look.vertex_tex_coords) == len(mesh.vertices) == len(mesh.vertex_normals)
    assert list(look.clusters[0].face_indices) == list(range(len(faces)))
    shown.append(np.array([(p.x, p.y, p.z) for p in mesh.vertices])[faces])
assert not looks
assert np.array_equal(rows(np.concatenate(shown)), rows(corners))

# keyframes and status: as the report says.
report = json.loads((out / "report.json").read_text())
(keyframes,) = by_topic["/veneer/keyframes"]
(status,) = by_topic["/veneer/status"]
assert len(keyframes.poses) == status.num_keyframes == len(report["keyframes"])
assert status.num_triangles == report["mesh"]["num_triangles"] == len(corners)
assert abs(status.coverage - report["coverage"]["keyframe_share"]) < 1e-6
assert all(t.num_used + t.num_refused == t.num_received for t in status.inputs)
print(counts)
print("all as exported")
