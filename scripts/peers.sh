#!/usr/bin/env bash
# Unwrap and pack, ours beside xatlas and Open3D's UVAtlas, on this machine, in one run: prints a
# Markdown table. Meshes: both real captures (where they lie beside the checkout), a synthetic room
# of 200,000 triangles, and a block of cubes of which nearly no edge is manifold. Everything in the
# table is measured from the texture coordinates that each tool gave, by the same code
# (scripts/peers.py). Needs python3.11, for which Open3D 0.19 has packages.
#
#   scripts/peers.sh [LIMIT_S] [MESH...]     time limit per tool and mesh (600), and which meshes
set -euo pipefail
cd "$(dirname "$0")/.."

limit_s=${1:-600}
[ $# -eq 0 ] || shift
work=target/peers
python=$work/venv/bin/python
mkdir -p "$work"
if [ ! -f "$work/venv/complete" ]; then
    python3.11 -m venv "$work/venv"
    "$python" -m pip install --quiet --disable-pip-version-check \
        numpy==2.2.6 scipy==1.15.3 xatlas==0.0.11 open3d-cpu==0.19.0
    touch "$work/venv/complete"
fi

cargo build --release --locked --quiet --bins --example unwrap
if [ ! -f "$work/room.ply" ]; then
    # Two frames suffice: only the mesh is used.
    target/release/veneer --quiet synth room -o "$work/room.mcap" --frames 2 --width 160 \
        --height 120 --edge-length-m 0.0345
    target/release/veneer --quiet replay "$work/room.mcap" --out "$work/room"
    mv "$work/room/scan.ply" "$work/room.ply"
    rm -r "$work/room" "$work/room.mcap"
fi

exec "$python" scripts/peers.py --work "$work" --limit-s "$limit_s" "$@"
