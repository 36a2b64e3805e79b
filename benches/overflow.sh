#!/usr/bin/env bash
# Shows 1,000 generated scenes to every shipped model, spike response models converted, and fails when a register wraps or clips.
# Needs a release build.
set -euo pipefail
cd "$(dirname "$0")/.."
seed="${1:-31}"
failed=0
report=$(mktemp)
trap 'rm -f "$report"' EXIT
check() {
    target/release/nsim run "$1" --engine fast --input "$2" --format json > "$report" 2> /dev/null
    python3 - "$1" "$report" <<'PY' || failed=1
import json, sys
with open(sys.argv[2]) as file:
    overflow = json.load(file)["overflow"]
print(f"{sys.argv[1]}: {overflow['q_wrapped']} accumulators and {overflow['u_wrapped']} currents wrapped, "
      f"{overflow['v_clipped']} voltages clipped")
sys.exit(any(overflow[key] for key in ("q_wrapped", "u_wrapped", "v_clipped")))
PY
}
for model in vtsnn-slip slip-tactile slip-vision vtsnn-slip-srm; do
    check "$model" "scene:slip?samples=1000&seed=$seed"
done
check vtsnn-container "scene:container?samples=1000&seed=$seed"
for model in container-tactile container-tactile-srm; do
    check "$model" "scene:noise?samples=1000&steps=325&rate=0.1&seed=$seed"
done
exit "$failed"
