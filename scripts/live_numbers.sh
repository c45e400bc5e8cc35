#!/usr/bin/env bash
# The live node's numbers among real rclpy peers on 127.0.0.1: from start to first diagnostics; a 720p
# camera at 30 Hz for a minute, raw and compressed, with what was sent, received, lost and dropped,
# CPU and memory; and how long a scan of 20 MB takes to an early and to a late subscriber.
#
#   scripts/live_numbers.sh [VENEER] [SECONDS]      SECONDS of 0: the scan alone
set -euo pipefail
cd "$(dirname "$0")/.."
veneer=$(realpath "${1:-target/release/veneer}")
seconds=${2:-60}
python=target/tmp/venv/jazzy-live/bin/python
[ -x "$python" ] || { echo "run the live tests once: they make $python" >&2; exit 1; }
"$python" -c 'import PIL' 2>/dev/null || "$python" -m pip install --quiet pillow
export ROS_DOMAIN_ID=$((100 + RANDOM % 100)) ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
peer=("$python" tests/all/live_peer.py)
work=$(mktemp -d)
node=
# Peers run until their standard input ends, and rclpy has its own mind about SIGTERM: all of them read
# this, which ends when the script does.
mkfifo "$work/open"
exec 9<>"$work/open"
end() { kill $node 2>/dev/null || true; rm -rf "$work"; }
trap end EXIT
# The subscribers' sockets have the default size: the larger, the fewer fragments are sent again.
echo "net.core.rmem_max $(cat /proc/sys/net/core/rmem_max)," \
    "net.core.rmem_default $(cat /proc/sys/net/core/rmem_default), $(nproc) cores"

# background NAME ARGS…: a peer that runs until the end, what it says in $work/NAME
background() {
    local name=$1
    shift
    "${peer[@]}" "$@" <"$work/open" >"$work/$name" 9>&- &
}
wait_for() { # FILE WORDS SECONDS
    for ((i = 0; i < 10 * $3; i++)); do
        grep -q "$2" "$1" 2>/dev/null && return
        sleep 0.1
    done
    echo "no $2 in $(basename "$1")" >&2
    return 1
}
start_node() { # ARGS…
    "$veneer" node --ros-args -p pose_source:=pose -p mesh_frame:=map --log-level error "$@" 2>/dev/null 9>&- &
    node=$!
}
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

kinds="raw compressed"; [ "$seconds" != 0 ] || kinds=
for kind in $kinds; do
    flags=(); [ $kind = compressed ] && flags=(--jpeg)
    background watch watch
    wait_for "$work/watch" watching 20
    begun=$(date +%s.%N)
    start_node -p paint_period:=5.0
    wait_for "$work/watch" resident 20
    background camera camera --seconds "$seconds" "${flags[@]}"
    wait_for "$work/camera" matched 30
    streaming=$(date +%s.%N)
    before=$(cpu_ticks "$node" '^veneer-(receive|ingest)|^RustDDS')
    wait_for "$work/camera" sent $((seconds + 30))
    after=$(cpu_ticks "$node" '^veneer-(receive|ingest)|^RustDDS')
    sleep 3
    "${peer[@]}" take /diagnostics diagnostic_msgs/msg/DiagnosticArray >"$work/diagnostics"
    "$python" - "$kind" "$work" "$begun" "$streaming" "$((after - before))" "$seconds" <<'PYTHON'
import json, sys
kind, work, begun, streaming, ticks, seconds = sys.argv[1:7]
lines = lambda name: [json.loads(line) for line in open(f"{work}/{name}")]
watched = [said for said in lines("watch") if "wall" in said]
[message] = lines("diagnostics")[-1]["messages"]
camera = lines("camera")[-1]
num, took = camera["sent"], camera["seconds"]
parts = {status["name"].split(": ")[1]: status for status in message["status"]}
values = {pair["key"]: pair["value"] for pair in parts["inputs"]["values"]}
print(f"\n{kind}: start to first diagnostics {watched[0]['wall'] - float(begun):.2f} s")
print(f"{num} frames in {took:.1f} s")
print("| topic | sent | received | lost | dropped | taken |\n|---|---|---|---|---|---|")
for topic in sorted({key.split()[0] for key in values}):
    counts = [values[topic + " " + what] for what in ("received", "lost", "dropped", "taken")]
    print("|", topic, "|", 1 if topic == "/mesh" else num, "|", " | ".join(counts), "|")
print(f"reception and decoding: {float(ticks) / float(seconds):.0f} % of a core")
print("| after s | resident MB | keyframes MB | decoded for painting MB | the rest MB |\n|---|---|---|---|---|")
next_at = 10.0
for said in watched:
    at = said["wall"] - float(streaming)
    if at >= next_at:
        next_at += 10.0
        resident, kept, decoded = (said[key] / 1e6 for key in ("resident", "keyframes", "decoded"))
        print(f"| {at:.0f} | {resident:.0f} | {kept:.0f} | {decoded:.0f} | {resident - kept - decoded:.0f} |")
PYTHON
    exec 9>&-
    kill -TERM "$node"
    wait
    exec 9<>"$work/open"
done

# 20 MB of markers: a table-top whose texture is fine enough.
"$veneer" --quiet synth tabletop -o "$work/scan.mcap" --frames 24 --width 640 --height 480
markers=/veneer/markers=visualization_msgs/msg/MarkerArray
# Painted a second time when all has come: then everything is new.
start_node -p publish.rate_mb:=40.0 -p publish.viewer_textures:=png -p texinit.texels_per_m:=4000.0 \
    -p paint_period:=15.0
background early listen "$markers" --chatty
wait_for "$work/early" listening 20
background player play "$work/scan.mcap"
wait_for "$work/player" '"sent"' 60
settled() { # NAME SECONDS: something has come, and for so long nothing more
    local last=-1 now
    # The first line says that it listens, the second that nothing has come.
    while now=$(wc -l <"$work/$1"); [ "$now" != "$last" ] || [ "$now" -le 2 ]; do
        last=$now
        sleep "$2"
    done
}
settled early 20
background late listen "$markers" --chatty --latched
settled late 5
"$python" - "$work" <<'PYTHON'
import json, sys
work = sys.argv[1]
lines = {name: [json.loads(line) for line in open(f"{work}/{name}")] for name in ("early", "late")}
counts = {name: [said["counts"]["/veneer/markers"] for said in lines[name][1:]] for name in lines}
# The last painting is what came after the last pause.
early = [count for count in counts["early"] if count["num"]]
at = max((i for i in range(1, len(early)) if early[i]["last"] - early[i - 1]["last"] > 2), default=1)
before, first, last = early[at - 1], early[at], early[-1]
num, size = last["num"] - before["num"], last["bytes"] - before["bytes"]
print(f"\nearly subscriber: {num} messages, {size / 1e6:.1f} MB in {last['last'] - first['last']:.2f} s")
last = counts["late"][-1]
print(f"late subscriber: {last['num']} messages, {last['bytes'] / 1e6:.1f} MB, "
      f"the first {last['first']:.2f} s and the last {last['last']:.2f} s after it began to listen")
PYTHON
