#!/usr/bin/env bash
# Builds veneer and textures a recording.
#
#   scripts/demo.sh [CAPTURE_DIR | BAG.mcap] [OUT_DIR]
#
# Without an argument: the apartment in ../shared/data (captured with a Structure sensor on an
# iPad) where that folder lies beside the checkout, else the table-top in bags/.
set -euo pipefail
cd "$(dirname "$0")/.."

for tool in cargo cc; do
    if ! command -v "$tool" >/dev/null; then
        echo "'$tool' is missing. Rust: https://rustup.rs; C compiler: sudo apt-get install build-essential" >&2
        exit 1
    fi
done

source=${1:-}
if [ -z "$source" ]; then
    source=../shared/data/apt0_structure
    [ -d "$source" ] || source=bags/tabletop.mcap
fi
out=${2:-out/$(basename "$source" .mcap)}

cargo build --release --locked
veneer=${CARGO_TARGET_DIR:-target}/release/veneer
if [ -d "$source" ]; then
    mkdir -p out
    bag=out/$(basename "$source").mcap
    "$veneer" import capture "$source" -o "$bag"
    source=$bag
fi
"$veneer" replay "$source" --out "$out"
