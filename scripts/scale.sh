#!/usr/bin/env bash
# TexInit at the size of the paper's largest scene: synthesises a room of 200,000 triangles filmed
# by 350 frames of 960×720, textures it with 1, 2 and 4 threads, checks that all outputs but the
# report's times are equal to the last bit, and prints time and memory. The paper's program takes
# about two minutes.
#
#   scripts/scale.sh [BAG]      reuse (or keep) the recording at BAG
set -euo pipefail
cd "$(dirname "$0")/.."

cargo build --release --locked --quiet
veneer=target/release/veneer
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
bag=${1:-$work/scale.mcap}

[ -f "$bag" ] || "$veneer" synth room --quiet -o "$bag" --frames 350 --width 960 --height 720 \
    --color jpeg --edge-length-m 0.0345
for threads in 1 2 4; do
    # Every frame paints: no view is left out for being near another, none is held back.
    "$veneer" --quiet replay "$bag" --out "$work/out" --threads "$threads" --json \
        -p keyframe.min_translation_m:=0.0 -p keyframe.min_rotation_rad:=0.0 \
        -p keyframe.min_relative_sharpness:=0.0 -p eval.held_out_views:=0 \
        >"$work/report_$threads.json"
    # The report, named after the comment, has times in it.
    sed '/^#/,$d' "$work/out/hashes.txt" >"$work/hashes_$threads.txt"
    rm -rf "$work/out"
    cmp "$work/hashes_1.txt" "$work/hashes_$threads.txt"
done

python3 - "$work" <<'PY'
import json, sys

runs = {n: json.load(open(f"{sys.argv[1]}/report_{n}.json")) for n in (1, 2, 4)}
first = runs[1]
texinit = ["flatten charts", "separate overlaps", "choose frames", "pack pages", "transfer colour",
           "fill and gutter"]
seconds = {n: {s["name"]: s["seconds"] for s in run["stages"]} for n, run in runs.items()}
print(f"\n{first['mesh']['num_triangles']} triangles, {len(first['keyframes'])} keyframes; "
      "1, 2 and 4 threads gave the same bytes\n")
print("| stage | 1 thread, s | 2 threads, s | 4 threads, s |\n|---|---|---|---|")
for name in (s["name"] for s in first["stages"]):
    print(f"| {name} | " + " | ".join(f"{seconds[n][name]:.2f}" for n in runs) + " |")
print("| **TexInit** | " + " | ".join(
    f"{sum(seconds[n][name] for name in texinit):.2f}" for n in runs) + " |")
print("| peak memory, MB | " + " | ".join(
    f"{(run['peak_memory_bytes'] or 0) / 1e6:.0f}" for run in runs.values()) + " |")
PY
