#!/usr/bin/env bash
# The whole-process table: imports a capture, replays it a few times, and prints for each stage the
# median time, with end-to-end time and peak memory. Then raw reading speed by the criterion bench.
#
#   scripts/bench.sh [CAPTURE_DIR] [RUNS]
set -euo pipefail
cd "$(dirname "$0")/.."

capture=${1:-../shared/data/apt0_structure}
runs=${2:-5}
[ -d "$capture" ] || { echo "no capture at $capture" >&2; exit 2; }

cargo build --release --locked --quiet
veneer=target/release/veneer
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$veneer" --quiet import capture "$capture" -o "$work/scan.mcap"
for run in $(seq "$runs"); do
    "$veneer" --quiet replay "$work/scan.mcap" --out "$work/out" --json >"$work/report_$run.json"
    rm -rf "$work/out"
done

python3 - "$work" "$(basename "$capture")" <<'PY'
import glob, json, statistics, sys

folder, name = sys.argv[1:]
reports = [json.load(open(path)) for path in sorted(glob.glob(folder + "/report_*.json"))]
first = reports[0]
median = statistics.median
print(f"\n{name}: {first['mesh']['num_triangles']} triangles, {len(first['keyframes'])} keyframes, "
      f"{first['num_threads']} threads, median of {len(reports)} runs\n")
print("| stage | s |\n|---|---|")
for index, stage in enumerate(first["stages"]):
    print(f"| {stage['name']} | {median(r['stages'][index]['seconds'] for r in reports):.2f} |")
print(f"| **whole run** (but drawing the report) | {median(r['total_s'] for r in reports):.2f} |")
peak = median(r["peak_memory_bytes"] or 0 for r in reports)
print(f"| peak memory | {peak / 1e6:.0f} MB |")
PY
cargo bench --locked --quiet --bench all -- 'bag'
