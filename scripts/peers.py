"""Unwraps meshes with veneer, xatlas and Open3D's UVAtlas, and measures what they give by one code.

Run by scripts/peers.sh. Each tool runs in a process of its own, under a time limit, on the same
triangles (vertices of equal position merged). From its texture coordinates follow:

- charts: sets of faces that hang together by edges with the same coordinates on either side;
- seam: length of edges between faces whose sides have different coordinates;
- stretch: Sander et al. 2001, normalised so that 1 is the best at the given area; L2 over the
  surface, L-infinity of all faces but the worst 0.1 % of the area;
- density: texels per metre, 5th to 95th percentile of the area;
- all on pages of at most 4096 × 4096 texels, larger ones scaled down;
- used: texel centres strictly inside a face, of all texels of the pages; twice: in several faces;
- lost: faces with area on the surface and none in the texture (or not given back at all).
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

PAGE = 4096
GUTTER = 4
TOOLS = ("veneer", "veneer --paper", "xatlas", "Open3D UVAtlas")
DOES = {
    "veneer": "Any soup. One density, whole pages with gutters around each chart.",
    "veneer --paper": "Any soup. One chart per component, as the paper has it.",
    "xatlas": "Any soup; faces that it takes for faulty get no place. One density.",
    "Open3D UVAtlas": "Manifold meshes only: others it refuses, or crashes on. One page.",
}


def read_mesh(path):
    import open3d as o3d

    mesh = o3d.io.read_triangle_mesh(str(path))
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.triangles, dtype=np.int64)


def tangled_block(side=32):
    """The surface of a random half of a block's cubes: edges of four faces all over."""
    rng = np.random.default_rng(9)
    full = np.zeros((side + 2,) * 3, dtype=bool)
    full[1:-1, 1:-1, 1:-1] = rng.random((side,) * 3) < 0.5
    quads = []
    for axis in range(3):
        for step in (1, -1):
            at = np.argwhere(full & ~np.roll(full, -step, axis))
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            base = at + (np.eye(3, dtype=int)[axis] if step == 1 else 0)
            ring = [base, base + u, base + u + v, base + v]
            quads.append(np.stack(ring if step == 1 else ring[::-1], axis=1))
    quads = np.concatenate(quads)
    places, index = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    return places * 0.1, np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])


def merged(vertices, faces):
    """Vertices of equal position as one; faces on fewer than three places left out, for all."""
    vertices, index = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    a, b, c = faces.T
    return vertices.astype(np.float64), faces[(a != b) & (b != c) & (c != a)]


def write_obj(path, vertices, faces):
    with open(path, "w") as file:
        file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices)
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in faces + 1)


# The tools: each gives texture coordinates in texels per corner, page per face (-1: none), page size.


def run_veneer(obj, out, limit_s, paper):
    given = out.with_suffix(".obj")
    command = ["target/release/examples/unwrap", obj, given, "--page", str(PAGE)]
    command += ["--paper"] * paper
    run = subprocess.run(command, capture_output=True, text=True, timeout=limit_s)
    if run.returncode != 0:
        raise RuntimeError(run.stderr.strip().splitlines()[-1])
    said = json.loads(run.stdout)
    seconds = sum(said["seconds"].values())
    width, height, _ = said["pages"]
    texture, corners, page_of, page = [], [], [], -1
    for line in open(given):
        if line.startswith("vt "):
            texture.append(line.split()[1:3])
        elif line.startswith("g page_"):
            page = int(line[7:])
        elif line.startswith("f "):
            corners.append([int(corner.split("/")[1]) - 1 for corner in line.split()[1:4]])
            page_of.append(page)
    corners = np.array(corners)
    # Three coordinates per face, in the order of faces.
    face = corners[:, 0] // 3
    uv = np.zeros((face.max() + 1, 3, 2))
    uv[face] = np.array(texture, dtype=np.float64)[corners]
    pages = np.full(len(uv), -1)
    pages[face] = page_of
    uv[..., 1] = 1.0 - uv[..., 1]
    return uv * (width, height), pages, (width, height), seconds


def run_xatlas(vertices, faces):
    import xatlas

    start = time.perf_counter()
    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    pack = xatlas.PackOptions()
    pack.resolution = PAGE
    pack.padding = 2 * GUTTER
    atlas.generate(xatlas.ChartOptions(), pack)
    seconds = time.perf_counter() - start
    _, indices, uv = atlas[0]
    corners = uv[indices].astype(np.float64)
    width, height = atlas.width, atlas.height
    pages = np.zeros(len(faces), dtype=int)
    if atlas.atlas_count > 1:
        raise RuntimeError(f"{atlas.atlas_count} pages, of which the Python package gives no account")
    if len(indices) != len(faces):
        raise RuntimeError(f"{len(indices)} faces of {len(faces)}")
    return corners * (width, height), pages, (width, height), seconds


def run_open3d(vertices, faces):
    import open3d as o3d

    mesh = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.int32))
    )
    start = time.perf_counter()
    mesh.compute_uvatlas(size=PAGE, gutter=GUTTER, nthreads=0)
    seconds = time.perf_counter() - start
    uv = mesh.triangle.texture_uvs.numpy().astype(np.float64)
    return uv * PAGE, np.zeros(len(faces), dtype=int), (PAGE, PAGE), seconds


def run_peer(tool, mesh, out):
    """In a process of its own: writes what the tool gives to `out`."""
    data = np.load(mesh)
    run = run_xatlas if tool == "xatlas" else run_open3d
    uv, pages, size, seconds = run(data["vertices"], data["faces"])
    np.savez(out, uv=uv, pages=pages, size=size, seconds=seconds)


def unwrap(tool, name, work, limit_s):
    out = work / f"{name}-{tool.replace(' ', '')}.npz"
    if tool.startswith("veneer"):
        return run_veneer(work / f"{name}.obj", out, limit_s, tool.endswith("--paper"))
    command = [sys.executable, __file__, "--tool", tool, "--mesh", work / f"{name}.npz", "--out", out]
    out.unlink(missing_ok=True)
    run = subprocess.run(command, capture_output=True, text=True, timeout=limit_s)
    if run.returncode != 0:
        plain = re.sub(r"\x1b\[[0-9;]*m", "", run.stdout + run.stderr)
        said = [line for line in plain.splitlines() if line.strip() and "INFO" not in line]
        last = said[-1].strip().rsplit(": ", 1)[-1][-160:] if said else "nothing said"
        if run.returncode < 0:
            last = f"crashes (signal {-run.returncode})"
        raise RuntimeError(last)
    data = np.load(out)
    return data["uv"], data["pages"], tuple(data["size"]), float(data["seconds"])


# Measures.


def claims(uv, pages, size):
    """Faces that have each texel's centre strictly inside, capped at 255."""
    width, height = (int(v) for v in size)
    num_pages = max(int(pages.max(initial=-1)) + 1, 1)
    count = np.zeros(num_pages * width * height, dtype=np.uint8)
    a, b, c = uv[:, 0], uv[:, 1], uv[:, 2]
    doubled = cross(b - a, c - a)
    low = np.floor(uv.min(axis=1)).astype(int)
    span = np.ceil(uv.max(axis=1)).astype(int) - low + 1
    reach = span.max(axis=1)
    usable = (pages >= 0) & (np.abs(doubled) > 0)
    block = 2
    while usable.any():
        chosen = np.flatnonzero(usable & (reach <= block))
        usable[chosen] = False
        step = max(1, 4_000_000 // (block * block))
        offset = np.stack(np.meshgrid(np.arange(block), np.arange(block)), axis=-1).reshape(-1, 2)
        for start in range(0, len(chosen), step):
            t = chosen[start : start + step]
            texel = low[t][:, None, :] + offset[None]
            p = texel + 0.5
            inside = np.ones(p.shape[:2], dtype=bool)
            for start_of, end_of in ((b, c), (c, a), (a, b)):
                from_ = start_of[t][:, None, :]
                weight = cross(end_of[t][:, None, :] - from_, p - from_) / doubled[t][:, None]
                inside &= weight > 1e-6
            inside &= (texel >= 0).all(axis=-1) & (texel < (width, height)).all(axis=-1)
            index = (pages[t][:, None] * height + texel[..., 1]) * width + texel[..., 0]
            index, times = np.unique(index[inside], return_counts=True)
            count[index] = np.minimum(count[index].astype(int) + times, 255)
        block *= 2
    return count


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def quantiles(values, weights, at):
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return [float(values[order][min(np.searchsorted(share, q), len(order) - 1)]) for q in at]


def stretch(points, uv, area, flat):
    """Sander's L2 of the surface, and its L-infinity but for the worst 0.1 % of the area."""
    (s1, t1), (s2, t2), (s3, t3) = (uv[:, k].T for k in range(3))
    q1, q2, q3 = (points[:, k] for k in range(3))
    doubled = cross(uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0])[:, None]
    along_s = (q1 * (t2 - t3)[:, None] + q2 * (t3 - t1)[:, None] + q3 * (t1 - t2)[:, None]) / doubled
    along_t = (q1 * (s3 - s2)[:, None] + q2 * (s1 - s3)[:, None] + q3 * (s2 - s1)[:, None]) / doubled
    a, b, c = ((x * y).sum(axis=1) for x, y in ((along_s,) * 2, (along_s, along_t), (along_t,) * 2))
    scale = np.sqrt(flat.sum() / area.sum())
    l2 = np.sqrt((area * (a + c) / 2).sum() / area.sum()) * scale
    largest = np.sqrt((a + c + np.sqrt((a - c) ** 2 + 4 * b**2)) / 2) * scale
    return float(l2), quantiles(largest, area, [0.999])[0]


def seams(vertices, faces, uv, pages):
    """Number of charts, and length of the seams between their faces."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    num = len(faces)
    side = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    flat = np.concatenate([uv[:, [k, (k + 1) % 3]] for k in range(3)])
    face = np.tile(np.arange(num), 3)
    turned = side[:, 0] > side[:, 1]
    side[turned], flat[turned] = side[turned][:, ::-1], flat[turned][:, ::-1]
    # A hundredth of a texel apart is apart.
    key = np.column_stack([side, np.round(flat.reshape(-1, 4) * 100).astype(np.int64), pages[face]])
    order = np.lexsort(key.T[::-1])
    key, face = key[order], face[order]
    same_edge = (key[1:, :2] == key[:-1, :2]).all(axis=1)
    same_place = same_edge & (key[1:] == key[:-1]).all(axis=1)
    links = (face[1:][same_place], face[:-1][same_place])
    graph = coo_matrix((np.ones(len(links[0])), links), shape=(num, num))
    placed = pages >= 0
    _, label = connected_components(graph, directed=False)
    cut = key[1:][same_edge & ~same_place]
    length = np.linalg.norm(vertices[cut[:, 0]] - vertices[cut[:, 1]], axis=1).sum()
    return len(np.unique(label[placed])), float(length)


def measure(vertices, faces, uv, pages, size):
    # A page as large for all: xatlas makes larger ones.
    scale = min(1.0, PAGE / max(size))
    uv, size = uv * scale, [round(side * scale) for side in size]
    if len(uv) < len(faces):
        missing = len(faces) - len(uv)
        uv = np.concatenate([uv, np.zeros((missing, 3, 2))])
        pages = np.concatenate([pages, np.full(missing, -1)])
    points = vertices[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1
    )
    flat = 0.5 * np.abs(cross(uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]))
    has_area = area > 1e-9 * np.median(area)
    is_lost = has_area & ((pages < 0) | (flat <= 0) | ~np.isfinite(flat))
    used = has_area & ~is_lost
    count = claims(np.nan_to_num(uv), np.where(is_lost, -1, pages), size)
    num_charts, seam_m = seams(vertices, faces, uv, pages)
    l2, worst = stretch(points[used], uv[used], area[used], flat[used])
    density = np.sqrt(flat[used] / area[used])
    low, high = quantiles(density, area[used], [0.05, 0.95])
    return {
        "charts": num_charts,
        "seam_m": seam_m,
        "l2": l2,
        "linf": worst,
        "density": (low, high),
        "used": float((count > 0).mean()),
        "twice": int((count > 1).sum()),
        "lost": int(is_lost.sum()),
        "pages": f"{len(count) // int(size[0] * size[1])} of {size[0]} × {size[1]}",
    }


def meshes(work):
    data = Path("../shared/data")
    for name, path in (
        ("apartment", data / "apt0_structure/mesh.ply"),
        ("board", data / "charuco_lidar/mesh.ply"),
        ("room", work / "room.ply"),
    ):
        if path.exists():
            yield name, *merged(*read_mesh(path))
        else:
            print(f"SKIPPED: no {path}", file=sys.stderr)
    yield "tangled block", *merged(*tangled_block())


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path)
    parser.add_argument("--limit-s", type=float, default=600)
    parser.add_argument("--tool")
    parser.add_argument("--mesh")
    parser.add_argument("--out")
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    if options.tool:
        run_peer(options.tool, options.mesh, options.out)
        return
    print(
        "| mesh | triangles | tool | s | charts | seam, m | L2 | L∞ | texels/m, 5–95 % | ratio "
        "| pages | used | claimed twice | faces lost |\n"
        "|---|--:|---|--:|--:|--:|--:|--:|--:|--:|---|--:|--:|--:|",
        flush=True,
    )
    for name, vertices, faces in meshes(options.work):
        if options.names and name not in options.names:
            continue
        file = name.replace(" ", "_")
        np.savez(options.work / f"{file}.npz", vertices=vertices, faces=faces)
        write_obj(options.work / f"{file}.obj", vertices, faces)
        for tool in TOOLS:
            start = f"| {name} | {len(faces)} | {tool} |"
            try:
                uv, pages, size, seconds = unwrap(tool, file, options.work, options.limit_s)
            except subprocess.TimeoutExpired:
                print(start, f"over {options.limit_s:.0f} |" + " |" * 10, flush=True)
                continue
            except RuntimeError as error:
                print(start, f"none: {str(error).replace('|', '/')} |" + " |" * 10, flush=True)
                continue
            m = measure(vertices, faces, uv, pages, size)
            low, high = m["density"]
            print(
                start,
                f"{seconds:.2f} | {m['charts']} | {m['seam_m']:.0f} | {m['l2']:.3f} | {m['linf']:.2f} "
                f"| {low:.0f}–{high:.0f} | {high / low:.2f} | {m['pages']} | {100 * m['used']:.1f} % "
                f"| {m['twice']} | {m['lost']} |",
                flush=True,
            )
    print("\n| tool | what it does |\n|---|---|")
    for tool in TOOLS:
        print(f"| {tool} | {DOES[tool]} |")


if __name__ == "__main__":
    main()
