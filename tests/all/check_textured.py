"""Loads a textured mesh with trimesh and looks up the colour at the middle of given faces.

usage: check_textured.py FILE SAMPLES.json {z-up,y-up}
SAMPLES.json: [{"position": [x, y, z] (z up), "srgb": [r, g, b], "page": k}, ...]
Prints one JSON object.
"""

import json
import sys

import numpy as np
import trimesh

path, samples_path, up = sys.argv[1:]
samples = json.load(open(samples_path))
loaded = trimesh.load(path, process=False)
scene = loaded if isinstance(loaded, trimesh.Scene) else trimesh.Scene(loaded)

parts = []
for node in scene.graph.nodes_geometry:
    transform, name = scene.graph[node]
    mesh = scene.geometry[name].copy()
    mesh.apply_transform(transform)
    parts.append(mesh)

centroids, colors, sizes = [], [], []
uv_min, uv_max = np.inf, -np.inf
num_faces = 0
for mesh in parts:
    material = mesh.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    pixels = np.asarray(image.convert("RGB"))
    height, width = pixels.shape[:2]
    sizes.append([width, height])
    uv = np.asarray(mesh.visual.uv)
    uv_min, uv_max = min(uv_min, uv.min()), max(uv_max, uv.max())
    faces = np.asarray(mesh.faces)
    num_faces += len(faces)
    middle_uv = uv[faces].mean(axis=1)
    # trimesh holds v up for every format.
    column = np.clip((middle_uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - middle_uv[:, 1]) * height).astype(int), 0, height - 1)
    colors.append(pixels[row, column])
    middle = np.asarray(mesh.vertices)[faces].mean(axis=1)
    if up == "y-up":
        middle = np.stack([middle[:, 0], -middle[:, 2], middle[:, 1]], axis=1)
    centroids.append(middle)

centroids, colors = np.concatenate(centroids), np.concatenate(colors).astype(int)
worst_distance, differences = 0.0, []
for sample in samples:
    distance = np.linalg.norm(centroids - np.array(sample["position"]), axis=1)
    nearest = int(distance.argmin())
    worst_distance = max(worst_distance, float(distance[nearest]))
    differences.append(int(np.abs(colors[nearest] - np.array(sample["srgb"])).max()))

differences = np.array(differences)
print(
    json.dumps(
        {
            "num_parts": len(parts),
            "num_faces": num_faces,
            "sizes": sizes,
            "uv_min": float(uv_min),
            "uv_max": float(uv_max),
            "worst_distance_m": worst_distance,
            "share_within_8": float((differences <= 8).mean()),
            "mean_difference": float(differences.mean()),
        }
    )
)
