"""Holds flattened disks against libigl and numpy.

usage: flatten_peers.py CASES.json
CASES.json: [{"name", "vertices": [[x, y, z]], "triangles": [[a, b, c]], "boundary": [v],
              "laplacian": [[a, b, weight]],
              "isometric" and "circle": {"uv": [[u, v]], "log_scale": [u]}}]
with everything per vertex of the mesh. Prints one JSON object per case.
"""

import json
import sys

import igl
import numpy as np


def singular_values(v, f, uv):
    """Of the map from the surface to the plane, larger first; and areas on the surface."""
    p = v[f]
    along = p[:, 1] - p[:, 0]
    other = p[:, 2] - p[:, 0]
    x_axis = along / np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.cross(along, other)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    y_axis = np.cross(normal / (2 * area[:, None]), x_axis)
    dot = lambda a, b: np.einsum("ij,ij->i", a, b)
    surface = np.stack(
        [
            np.stack([dot(along, x_axis), dot(other, x_axis)], axis=1),
            np.stack([dot(along, y_axis), dot(other, y_axis)], axis=1),
        ],
        axis=1,
    )
    q = uv[f]
    plane = np.stack([q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]], axis=2)
    jacobian = plane @ np.linalg.inv(surface)
    return np.linalg.svd(jacobian, compute_uv=False), np.linalg.det(jacobian), area


def distortion(v, f, uv):
    values, determinant, area = singular_values(v, f, uv)
    larger, smaller = values[:, 0], values[:, 1]
    quasi_conformal = larger / smaller
    scale = np.sqrt((area * np.abs(determinant)).sum() / area.sum())
    # Area distortion without regard to the map's scale: the spread of the log of the area ratio.
    logs = np.log(np.abs(determinant))
    mean = (area * logs).sum() / area.sum()
    # Half the area is more nearly conformal than this: what slivers at the rim cannot sway.
    order = np.argsort(quasi_conformal)
    median = quasi_conformal[order][np.searchsorted(np.cumsum(area[order]), 0.5 * area.sum())]
    return {
        "quasi_conformal_median": median,
        "quasi_conformal_mean": (area * quasi_conformal).sum() / area.sum(),
        "quasi_conformal_max": quasi_conformal.max(),
        "area_ratio_min": determinant.min(),
        "area_ratio_max": determinant.max(),
        "stretch_l2": scale
        * np.sqrt((area * 0.5 * (1 / larger**2 + 1 / smaller**2)).sum() / area.sum()),
        "stretch_linf": scale * (1 / smaller).max(),
        "log_area_spread": np.sqrt((area * (logs - mean) ** 2).sum() / area.sum()),
        "num_flipped": int((determinant <= 0).sum()),
    }


def laplacian_error(cot, entries):
    """Largest difference of an entry, of slivers' large ones relative to them; every entry of igl's must be among ours and the reverse."""
    ours = {}
    for a, b, weight in entries:
        key = (min(a, b), max(a, b))
        ours[key] = ours.get(key, 0.0) + weight
    upper = cot.tocoo()
    theirs = {
        (int(i), int(j)): value for i, j, value in zip(upper.row, upper.col, upper.data) if i < j
    }
    if set(ours) != set(theirs):
        return float("inf")
    return max(abs(ours[key] - theirs[key]) / max(1.0, abs(theirs[key])) for key in theirs)


def check(case):
    v = np.array(case["vertices"], dtype=np.float64)
    f = np.array(case["triangles"], dtype=np.int64)
    boundary = np.array(case["boundary"], dtype=np.int64)
    interior = np.setdiff1d(np.arange(len(v)), boundary)
    cot = igl.cotmatrix(v, f)
    positive = -cot
    isometric = np.array(case["isometric"]["uv"])
    circle = np.array(case["circle"]["uv"])
    size = np.ptp(isometric, axis=0).max()

    # The two points farthest apart along the boundary, at their distance.
    loop = igl.boundary_loop(f)
    pins = np.array([loop[0], loop[len(loop) // 2]])
    length = np.linalg.norm(v[pins[0]] - v[pins[1]])
    lscm, _ = igl.lscm(v, f, pins, np.array([[0.0, 0.0], [length, 0.0]]))
    on_circle = igl.map_vertices_to_circle(np.asfortranarray(v), loop.astype(np.int32))
    harmonic = igl.harmonic(v, f, loop, np.ascontiguousarray(on_circle), 1)

    # Steps of the method by igl's operators: flatness inside, harmonic x, conjugate y.
    curvature = igl.gaussian_curvature(v, f)
    u = np.array(case["isometric"]["log_scale"])
    flatness = np.abs((positive @ u + curvature)[interior]).max() if len(interior) else 0.0
    x = igl.harmonic(v, f, boundary, np.ascontiguousarray(isometric[boundary][:, :1]), 1)[:, 0]
    flux = np.zeros(len(v))
    on_boundary = isometric[boundary, 0]
    flux[boundary] = -0.5 * (np.roll(on_boundary, -1) - np.roll(on_boundary, 1))
    conjugate = np.abs(positive @ isometric[:, 1] - flux).max()

    # The circle through all boundary points, by least squares.
    points = circle[boundary]
    system = np.column_stack([2 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    radii = np.linalg.norm(points - solution[:2], axis=1)
    return {
        "name": case["name"],
        "laplacian": laplacian_error(cot, case["laplacian"]),
        "flatness": flatness,
        "harmonic": np.abs(x - isometric[:, 0]).max() / size,
        "conjugate": conjugate / size,
        "roundness": (radii.max() - radii.min()) / radii.mean(),
        "isometric": distortion(v, f, isometric),
        "circle": distortion(v, f, circle),
        "lscm": distortion(v, f, lscm),
        "harmonic_circle": distortion(v, f, harmonic),
    }


for case in json.load(open(sys.argv[1])):
    print(json.dumps(check(case), default=float))
