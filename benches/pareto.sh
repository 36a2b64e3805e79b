#!/usr/bin/env bash
# Measures run time against error and draws the picture of docs/benchmarks.md. Needs a release build.
set -euo pipefail
cd "$(dirname "$0")/.."
target/release/nsim bench pareto vtsnn-slip --samples 0..50 --force --plot docs/pareto-vtsnn-slip.svg "$@"
