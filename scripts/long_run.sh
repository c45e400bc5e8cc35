#!/usr/bin/env bash
# Whether the node's memory stays flat: an hour of scanning, as fast as the machine goes. An apartment
# that grows, scanned over and over with room for half of its keyframes, and a synthetic room, a new one
# each time; each begins with a new mesh. Fails where memory grows or a count does not add up.
#
#   scripts/long_run.sh [CAPTURE_DIR] [SECONDS]
set -euo pipefail
cd "$(dirname "$0")/.."

capture=${1:-../shared/data/apt0_structure}
seconds=${2:-3600}
[ -d "$capture" ] || { echo "no capture at $capture" >&2; exit 2; }
cargo build --release --locked --quiet --bin veneer --example long_run
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

target/release/veneer --quiet import capture "$capture" -o "$work/capture.mcap" --grow 24
target/release/veneer synth room --quiet -o "$work/room.mcap" --frames 200 --width 320 --height 240 \
    --color jpeg --edge-length-m 0.08 --grow 24

table() {
    python3 - "$1" <<'PY'
import json, sys

*rows, last = [json.loads(line) for line in open(sys.argv[1])]
print("| scanned, s | resident MB | keyframes | evicted | rejected | charts gone | pages | paintings | "
      "painting, ms | journal MB |\n|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
shown = sorted({round(i * (len(rows) - 1) / 8) for i in range(9)})
for row in (rows[i] for i in shown):
    print(f"| {row['scan_s']:.0f} | {row['peak_mb']:.0f} | {row['keyframes']} | {row['evicted']} | "
          f"{sum(row['rejected'].values())} | {row['charts_gone']} | {row['pages']} | "
          f"{row['paintings']} | {row['paint_ms'][0]:.0f}–{row['paint_ms'][2]:.0f} | {row['journal_mb']} |")
print(f"\nmean of the last quarter over that of the quarter before: {last['growth']:.3f}\n")
PY
}
run() { # NAME ARGS…
    local name=$1
    shift
    printf '\n%s\n\n' "$name"
    target/release/examples/long_run "$@" >"$work/rows.json" || { tail -n 3 "$work/rows.json"; exit 1; }
    table "$work/rows.json"
}
run "$(basename "$capture"), the same place" "$work/capture.mcap" "$seconds" --period 20 \
    keyframe.budget_mb:=12
run "synthetic rooms" "$work/room.mcap" "$seconds" --period 20 --step 7 \
    keyframe.budget_mb:=6 stream.page_size_texel:=512
