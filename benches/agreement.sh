#!/usr/bin/env bash
# Compares a shipped spike response model with its conversion and writes the section of docs/agreement.md, then prints the same of the
# real recordings. Needs a release build; the recordings are looked for under $NSIM_DATA (default ../shared/data).
set -euo pipefail
cd "$(dirname "$0")/.."
nsim=target/release/nsim
data="${NSIM_DATA:-../shared/data}"
"$nsim" agree vtsnn-slip-srm --input 'scene:slip?samples=1000&seed=7' --require-class-agreement 0.99 \
    --force --update docs/agreement.md "$@"
"$nsim" agree container-tactile-srm --input "$data/ev-containers/test" --calibrate "$data/ev-containers/train" "$@"
