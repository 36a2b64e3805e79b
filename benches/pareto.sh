#!/usr/bin/env bash
# Measures run time against error and writes the section of docs/benchmarks.md with its chart. Needs a release build.
set -euo pipefail
cd "$(dirname "$0")/.."
target/release/nsim bench pareto vtsnn-slip --samples 0..50 --force --update docs/benchmarks.md "$@"
