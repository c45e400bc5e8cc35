#!/usr/bin/env bash
# What an update of a kept-up texture costs as the scan grows, and making the messages of it: walks
# through copies of a synthetic room, side by side, and prints a table and docs/stream_scale.svg of the
# times over the size of the scan.
#
#   scripts/stream_scale.sh [NUM_ROOMS]
set -euo pipefail
cd "$(dirname "$0")/.."

num_rooms=${1:-12}
cargo build --release --locked --quiet --bin veneer --example stream_scale
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
target/release/veneer synth room --quiet -o "$work/room.mcap" --frames 60 --width 320 --height 240 \
    --color jpeg --edge-length-m 0.08
target/release/examples/stream_scale "$work/room.mcap" "$num_rooms" 4 \
    texinit.max_texels:=4000000000 >"$work/rows.json"

python3 - "$work/rows.json" docs/stream_scale.svg <<'PY'
import json, math, sys

rows = [json.loads(line) for line in open(sys.argv[1])]
print("| triangles | keyframes | updates of the room, ms | textured_mesh, ms | markers, ms | state, MB |")
print("|--:|--:|--:|--:|--:|--:|")
shown = sorted({round((len(rows) - 1) ** (i / 8)) for i in range(9)} | {0, len(rows) - 1})
for row in (rows[i] for i in shown if i < len(rows)):
    spans = [sorted(row[kind]) for kind in ("updates_ms", "textured_mesh_ms", "markers_ms")]
    spans = " | ".join(f"{times[0]:.0f}–{times[-1]:.0f}" for times in spans)
    print(f"| {row['triangles']:,} | {row['keyframes']:,} | {spans} | {row['num_bytes'] / 1e6:.0f} |")

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 720, 380, 70, 50, 20
most = max(row["triangles"] for row in rows)
highest = max(max(row["updates_ms"]) for row in rows)
step = 10 ** math.floor(math.log10(highest))
step = next(s for s in (step / 5, step / 2, step, 2 * step) if highest / s <= 8)
x = lambda n: LEFT + (WIDTH - LEFT - 45) * n / most
y = lambda ms: HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * ms / highest
parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
         'font-family="sans-serif" font-size="13">',
         f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>']
ms = 0.0
while ms <= highest:
    parts.append(f'<path d="M{LEFT} {y(ms):.1f}H{WIDTH - 45}" stroke="#ddd"/>'
                 f'<text x="{LEFT - 8}" y="{y(ms) + 4:.1f}" text-anchor="end">{ms:g}</text>')
    ms += step
for i in range(5):
    n = most * i // 4
    parts.append(f'<text x="{x(n):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{n:,}</text>')
for row in rows:
    for kind, colour in (("updates_ms", "#2166ac"), ("textured_mesh_ms", "#b2182b")):
        for ms in row[kind]:
            parts.append(f'<circle cx="{x(row["triangles"]):.1f}" cy="{y(ms):.1f}" r="2.5" '
                         f'fill="{colour}" fill-opacity="0.6"/>')
for line, (words, colour) in enumerate((("one update", "#2166ac"), ("its textured_mesh messages", "#b2182b"))):
    parts.append(f'<circle cx="{LEFT + 20}" cy="{TOP + 12 + 18 * line}" r="4" fill="{colour}"/>'
                 f'<text x="{LEFT + 30}" y="{TOP + 16 + 18 * line}">{words}</text>')
parts.append(f'<text x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 8}" text-anchor="middle">'
             'triangles of the scan</text>'
             f'<text x="16" y="{HEIGHT / 2}" text-anchor="middle" '
             f'transform="rotate(-90 16 {HEIGHT / 2})">ms</text></svg>')
open(sys.argv[2], "w").write("\n".join(parts) + "\n")
PY
