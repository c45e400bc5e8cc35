"""Draws what veneer published: `/veneer/markers` by the rules of rviz2's triangle lists on the left, the GLB
files of `/veneer/scene` on the right, from one point of view.

usage: show_published.py BAG OUT.png
"""

import io
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyvista
from PIL import Image
from rosbags.highlevel import AnyReader

bag, out = Path(sys.argv[1]), Path(sys.argv[2])
pyvista.OFF_SCREEN = True
SIZE = (900, 700)
DELETE, DELETE_ALL = 2, 3


def messages(topic):
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        for connection, _, raw in reader.messages(connections=connections):
            yield reader.deserialize(raw, connection.msgtype)


def picture(fill, eye, target, up):
    plotter = pyvista.Plotter(off_screen=True, window_size=SIZE)
    plotter.set_background("white")
    fill(plotter)
    plotter.camera_position = [tuple(eye), tuple(target), tuple(up)]
    return plotter.screenshot(None, return_img=True)


markers = {}
for array in messages("/veneer/markers"):
    for marker in array.markers:
        if marker.action == DELETE_ALL:
            markers.clear()
        elif marker.action == DELETE:
            del markers[marker.ns, marker.id]
        else:
            markers[marker.ns, marker.id] = marker

entities = {}
for update in messages("/veneer/scene"):
    for deletion in update.deletions:
        if deletion.type == 1:
            entities.clear()
        else:
            del entities[deletion.id]
    for entity in update.entities:
        entities[entity.id] = entity


def points_of(marker):
    origin = marker.pose.position
    points = np.array([(p.x, p.y, p.z) for p in marker.points])
    return points + [origin.x, origin.y, origin.z]


def fill_with_markers(plotter):
    for marker in markers.values():
        points = points_of(marker)
        # VTK counts v from below.
        uv = np.array([(c.u, 1 - c.v) for c in marker.uv_coordinates], np.float32)
        faces = np.arange(len(points)).reshape(-1, 3)
        mesh = pyvista.PolyData(points, np.c_[np.full(len(faces), 3), faces].ravel())
        mesh.active_texture_coordinates = uv
        image = Image.open(io.BytesIO(bytes(marker.texture.data))).convert("RGB")
        texture = pyvista.Texture(np.asarray(image))
        texture.interpolate, texture.repeat = True, False
        plotter.add_mesh(mesh, texture=texture, lighting=False)


def fill_with_models(plotter):
    for entity in entities.values():
        for model in entity.models:
            with tempfile.NamedTemporaryFile(suffix=".glb") as file:
                file.write(bytes(model.data))
                file.flush()
                plotter.import_gltf(file.name, set_camera=False)


points = np.concatenate([points_of(marker) for marker in markers.values()])
center = points.mean(axis=0)
offset = np.ptp(points, axis=0).max() * np.array([0.7, -0.8, 0.9])
left = picture(fill_with_markers, center + offset, center, (0, 0, 1))
# glTF has y up.
y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
right = picture(fill_with_models, y_up @ (center + offset), y_up @ center, (0, 1, 0))
Image.fromarray(np.concatenate([left, right], axis=1)).save(out)
difference = np.abs(left.astype(int) - right.astype(int))
print(f"{len(markers)} markers, {len(entities)} models; mean difference of the pictures {difference.mean():.2f}/255")
