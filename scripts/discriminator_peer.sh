#!/usr/bin/env bash
# The discriminator beside PyTorch's: gradients compared, steps timed in the same run.
# usage: scripts/discriminator_peer.sh [--side PX] [--steps N] [--threads N] [--pad]
# PYTHON names an interpreter with torch and numpy; without it one is made under target/peers
# (torch is a large download).
set -euo pipefail
cd "$(dirname "$0")/.."
if [ -z "${PYTHON:-}" ]; then
    folder=target/peers/torch
    if ! "$folder/bin/python" -c 'import torch, numpy' 2>/dev/null; then
        python3 -m venv "$folder"
        "$folder/bin/pip" install --quiet --disable-pip-version-check torch numpy
    fi
    PYTHON=$folder/bin/python
fi
cargo build --release --example discriminator
exec "$PYTHON" scripts/discriminator_peer.py target/release/examples/discriminator "$@"
