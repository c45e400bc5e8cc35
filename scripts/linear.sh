#!/usr/bin/env bash
# How flattening grows with the mesh: time, memory and charts from 10k to 1M triangles, the fit
# s = a * n^b over them, and whether 1, 2 and 4 threads give the same bits.
#
# usage: scripts/linear.sh [SHAPE...]      (blob terrain room, each also heavily non-manifold)
# environment: SIZES (triangle counts), THREADS (default 2), REPEATS (the fastest counts, default 2),
#              MODE (empty, or --paper), BROKEN ("no yes")
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet --example linear
linear=target/release/examples/linear
sizes=${SIZES:-10000 30000 100000 200000 300000 1000000}
threads=${THREADS:-2}
repeats=${REPEATS:-2}
mode=${MODE:-}
[ $# -gt 0 ] || set -- blob terrain room

# A number or a word of a row of JSON.
field() { sed -n "s/.*\"$1\":\"\{0,1\}\([^,\"}]*\).*/\1/p"; }

echo "flattening ${mode:-(streaming)}, $threads threads, fastest of $repeats"
printf '%-9s %-7s %9s %9s %9s %9s %9s %9s %8s %7s %9s\n' \
    shape broken triangles seconds cpu_s us/tri manifold charts solve MiB num_charts
for shape in "$@"; do
    for broken in ${BROKEN:-no yes}; do
        flag=; [ "$broken" = no ] || flag=--broken
        rows=
        for size in $sizes; do
            row=$("$linear" "$shape" "$size" $flag $mode --threads "$threads" --repeat "$repeats")
            n=$(echo "$row" | field triangles)
            s=$(echo "$row" | field seconds)
            cpu=$(echo "$row" | field cpu_s)
            echo "$shape $broken $n $s $cpu $(echo "$row" | field manifold_s) \
                $(echo "$row" | field charts_s) $(echo "$row" | field solve_s) \
                $(echo "$row" | field peak_mib) $(echo "$row" | field charts)" |
                awk '{ printf "%-9s %-7s %9d %9.3f %9.2f %9.3f %9.3f %9.3f %8.3f %7.0f %9d\n",
                       $1, $2, $3, $4, $5, 1e6 * $4 / $3, $6, $7, $8, $9, $10 }'
            rows="$rows$n $s $cpu
"
        done
        # Least squares of log s over log n.
        for column in 2 3; do
            printf '%s' "$rows" | awk -v what="$shape, broken: $broken" -v column="$column" '
                { x = log($1); y = log($column > 0 ? $column : 0.01); k++
                  sx += x; sy += y; sxx += x * x; sxy += x * y }
                END { if (k < 2) exit
                      b = (k * sxy - sx * sy) / (k * sxx - sx * sx); a = exp((sy - b * sx) / k)
                      printf "fit (%s): %s = %.3e * n^%.3f\n", what,
                             column == 2 ? "seconds" : "cpu_s", a, b }'
        done
        digests=$(for count in 1 2 4; do
            "$linear" "$shape" 100000 $flag $mode --threads "$count" | field digest
        done | sort -u | wc -l)
        if [ "$digests" = 1 ]; then
            echo "threads ($shape, broken: $broken): 1, 2 and 4 give the same bits at 100k"
        else
            echo "threads ($shape, broken: $broken): 1, 2 and 4 DIFFER at 100k"
            exit 1
        fi
    done
done
