#!/usr/bin/env bash
# The live node's numbers among real rclpy peers on 127.0.0.1: a 720p camera at 30 Hz for a minute,
# raw and compressed. Prints what was sent, received, lost and dropped, CPU and memory.
#
#   scripts/live_numbers.sh [VENEER] [SECONDS]
set -euo pipefail
cd "$(dirname "$0")/.."
veneer=${1:-target/release/veneer}
seconds=${2:-60}
python=target/tmp/venv/jazzy-live/bin/python
[ -x "$python" ] || { echo "run the live tests once: they make $python" >&2; exit 1; }
"$python" -c 'import PIL' 2>/dev/null || "$python" -m pip install --quiet pillow
export ROS_DOMAIN_ID=$((100 + RANDOM % 100)) ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
peer=("$python" tests/all/live_peer.py)
echo "net.core.rmem_max $(cat /proc/sys/net/core/rmem_max), $(nproc) cores"

cpu_ticks() { # of a process' threads whose name matches
    local sum=0 task
    for task in /proc/"$1"/task/*; do
        if [[ $(cat "$task/comm" 2>/dev/null) =~ $2 ]]; then
            read -r user system < <(sed 's/.*) //' "$task/stat" | cut -d' ' -f12,13) || continue
            sum=$((sum + user + system))
        fi
    done
    echo "$sum"
}

for kind in raw compressed; do
    flags=(); [ $kind = compressed ] && flags=(--jpeg)
    "$veneer" node --ros-args -p pose_source:=pose -p mesh_frame:=map -p paint_period:=5.0 \
        --log-level error 2>/dev/null &
    node=$!
    sleep 1
    coproc camera { "${peer[@]}" camera --seconds "$seconds" "${flags[@]}"; }
    read -r matched <&"${camera[0]}"
    before=$(cpu_ticks "$node" '^veneer-(receive|ingest)|^RustDDS')
    memory=()
    for ((i = 0; i < seconds; i += 10)); do
        sleep 10
        memory+=("$(awk '/VmRSS/ { print int($2 / 1024) }' /proc/"$node"/status)")
    done
    read -r sent <&"${camera[0]}"
    after=$(cpu_ticks "$node" '^veneer-(receive|ingest)|^RustDDS')
    sleep 3
    "${peer[@]}" take /diagnostics diagnostic_msgs/msg/DiagnosticArray | "$python" -c '
import json, sys
kind, matched, sent, ticks, seconds, memory = sys.argv[1:7]
sent = json.loads(sent)
num, took = sent["sent"], sent["seconds"]
[message] = json.load(sys.stdin)["messages"]
parts = {status["name"].split(": ")[1]: status for status in message["status"]}
values = {pair["key"]: pair["value"] for pair in parts["inputs"]["values"]}
print(f"\n{kind}: {num} frames in {took:.1f} s")
print("| topic | sent | received | lost | dropped | taken |\n|---|---|---|---|---|---|")
for topic in sorted({key.split()[0] for key in values}):
    counts = [values[topic + " " + what] for what in ("received", "lost", "dropped", "taken")]
    print("|", topic, "|", 1 if topic == "/mesh" else num, "|", " | ".join(counts), "|")
share = float(ticks) / float(seconds)
print(f"reception and decoding: {share:.0f} % of a core; resident MB every 10 s: {memory}")
' "$kind" "$matched" "$sent" "$((after - before))" "$seconds" "${memory[*]}"
    kill -TERM "$node" "$camera_PID" 2>/dev/null || true
    wait "$node" || true
done
