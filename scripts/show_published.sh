#!/usr/bin/env bash
# What is published, drawn by VTK, which knows nothing of veneer: the textured markers as rviz2 reads
# them and the GLB files of the scene, side by side.
# usage: scripts/show_published.sh BAG OUT.png      BAG as `veneer replay --record BAG` writes it
# PYTHON names an interpreter with pyvista, rosbags, numpy and pillow; without it one is made under
# target/peers.
set -euo pipefail
folder=$(cd "$(dirname "$0")/.." && pwd)
if [ -z "${PYTHON:-}" ]; then
    venv=$folder/target/peers/show
    if ! "$venv/bin/python" -c 'import pyvista, rosbags, numpy, PIL' 2>/dev/null; then
        python3 -m venv "$venv"
        "$venv/bin/pip" install --quiet --disable-pip-version-check pyvista rosbags==0.11.9 numpy pillow
    fi
    PYTHON=$venv/bin/python
fi
exec "$PYTHON" "$folder/scripts/show_published.py" "$@"
