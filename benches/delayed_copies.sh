#!/usr/bin/env bash
# Converts the shipped spike response models with several numbers of delayed copies, and writes what each costs in cores and reaches in
# coincidence into docs/agreement.md. Needs a release build and jq; the real recordings are looked for under $NSIM_DATA (default
# ../shared/data).
set -euo pipefail
cd "$(dirname "$0")/.."
nsim=target/release/nsim
data="${NSIM_DATA:-../shared/data}"
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
{
    echo '| model | `--delayed-copies` | cores | classes agree | accuracy | coincidence by layer |'
    echo '|---|---|---|---|---|---|'
    for model in vtsnn-slip-srm container-tactile-srm; do
        case $model in
            vtsnn-slip-srm) shown=(--input 'scene:slip?samples=200&seed=7') calibrated=() ;;
            *) shown=(--input "$data/ev-containers/test") calibrated=(--calibrate "$data/ev-containers/train") ;;
        esac
        for copies in 1 4 15; do
            file="$folder/$model-$copies.ron"
            "$nsim" convert "$model" --delayed-copies "$copies" "${shown[@]}" "${calibrated[@]}" -o "$file" >/dev/null 2>&1
            cores=$("$nsim" map "$file" --format json 2>/dev/null | jq -r .cores_used)
            "$nsim" agree "$model" --against "$file" "${shown[@]}" --format json 2>/dev/null |
                jq -r --arg model "$model" --arg copies "$copies" --arg cores "$cores" '
                    def round4: . * 10000 | round / 10000;
                    "| \($model) | \($copies) | \($cores) | \(.class_agreement | round4) | \(.accuracy_b | round4) | " +
                    ([.layers[] | "\(.name) \(.coincidence | round4)"] | join(", ")) + " |"'
        done
    done
} > "$folder/table.md"
awk -v table="$folder/table.md" '
    /<!-- delayed copies -->/ { print; while ((getline line < table) > 0) print line; skip = 1; next }
    /<!-- end delayed copies -->/ { skip = 0 }
    !skip' docs/agreement.md > "$folder/page.md"
cp "$folder/page.md" docs/agreement.md
