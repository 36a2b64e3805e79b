#!/usr/bin/env bash
# Measures run time against error and writes both sections of docs/benchmarks.md with their charts.
# Needs a release build; the real recordings are looked for under $NSIM_DATA (default ../shared/data).
set -euo pipefail
cd "$(dirname "$0")/.."
nsim=target/release/nsim
data="${NSIM_DATA:-../shared/data}"
"$nsim" bench pareto vtsnn-slip --samples 0..50 --force --update docs/benchmarks.md "$@"
"$nsim" bench pareto container-tactile-srm --input "$data/ev-containers/test" --calibrate "$data/ev-containers/train" \
    --force --update docs/benchmarks.md "$@"
