#!/usr/bin/env bash
# Counts the instructions of a timestep of the two visual-tactile networks and holds them to benches/instructions.txt.
#
# Wall times on a shared machine vary by more than a regression; instructions do not: two runs differ by less than one in a
# thousand. Only `bench::measure::steps` is counted, so set-up and mapping do not matter. valgrind knows AVX2 but not AVX-512:
# where the program chooses its instructions by the processor, the AVX2 path is counted.
#
# Usage: benches/callgrind.sh [--bless]    --bless writes what was counted as the new limits.
set -euo pipefail
cd "$(dirname "$0")/.."

limits=benches/instructions.txt
steps=3000 # one period of the networks' input
slack=10   # percent

if ! command -v valgrind > /dev/null; then
    cat >&2 << 'NOTICE'
********************************************************************************
skipped: no valgrind on this machine. NO INSTRUCTION WAS COUNTED: a slower
timestep would go unnoticed. Install it (apt-get install valgrind), run again.
********************************************************************************
NOTICE
    # Nothing was found wrong; whoever needs a count asks for one.
    [ "${NSIM_REQUIRE_VALGRIND:-}" = 1 ] && exit 1
    exit 0
fi
cargo build --locked --release --quiet
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

# Whole instructions of a timestep of a network.
count() {
    valgrind --tool=callgrind --callgrind-out-file="$folder/out" --toggle-collect='nsim_energy::measure::steps*' \
        "${CARGO_TARGET_DIR:-target}/release/nsim" bench step --network "$1" --steps "$steps" --threads 1 --format csv \
        > "$folder/result" 2> "$folder/log" || { cat "$folder/log" >&2; return 1; }
    local sum
    sum=$(sed -n 's/^\(summary\|totals\): *//p' "$folder/out" | head -n 1)
    if [ "${sum:-0}" -eq 0 ]; then
        echo "callgrind counted nothing in nsim_energy::measure::steps: has it been renamed or inlined?" >&2
        return 1
    fi
    echo $((sum / steps))
}

failed=0
blessed=""
for network in vtsnn-1pct vtsnn-5pct; do
    counted=$(count "$network")
    limit=$(awk -v network="$network" '$1 == network { print $2 }' "$limits")
    blessed+="$network $counted"$'\n'
    if [ "${1:-}" = --bless ]; then
        echo "$network: $counted instructions a timestep (was ${limit:-unlimited})"
    elif [ -z "$limit" ]; then
        echo "$network: $counted instructions a timestep, and no limit in $limits"
        failed=1
    elif [ $((counted * 100)) -gt $((limit * (100 + slack))) ]; then
        echo "$network: $counted instructions a timestep, more than $slack % above the limit of $limit"
        failed=1
    else
        echo "$network: $counted instructions a timestep (limit $limit, and $slack %)"
    fi
done
if [ "${1:-}" = --bless ]; then
    { grep '^#' "$limits"; printf '%s' "$blessed"; } > "$folder/limits"
    cp "$folder/limits" "$limits"
fi
exit $failed
