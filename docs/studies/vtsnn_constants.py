"""Writes mapping/constants/vtsnn-calibrated.ron: constants that reproduce the VT-SNN paper's offline table.

Usage: python3 docs/studies/vtsnn_constants.py [path of nsim] > mapping/constants/vtsnn-calibrated.ron

Four constants follow from four cells of the table, on the activity of the shipped model and scene in the paper's job:
static power of a core, power of an x86 core at work, the energy of an event, the time of an injected spike. The others
are those of loihi1-evidence. Nothing is taken from the real-time table. This reproduces; it does not predict.
"""

import json
import pathlib
import re
import subprocess
import sys

NSIM = sys.argv[1] if len(sys.argv) > 1 else "nsim"
ROOT = pathlib.Path(__file__).resolve().parents[2]
BASE = "loihi1-evidence"
SOURCE = "fitted to VT-SNN (Taunyazov et al. 2020, extended version), appendix, table of offline inference: "


def cell(unit, figure):
    text = (ROOT / "mapping/measurements/vtsnn-offline.ron").read_text()
    found = re.search(rf'unit: "{unit}", figure: "{figure}", printed: "([0-9.]+)"', text)
    return float(found.group(1))


def estimate(changes):
    line = [NSIM, "energy", "--deployment", "paper", "--baseline", "--constants", BASE, "--format", "json"]
    for name, value in changes.items():
        line += ["--set", f"constants.{name}={value}"]
    report = json.loads(subprocess.run(line, check=True, capture_output=True, text=True).stdout)
    rows = {row["unit"]: row for row in report["rows"] if row["hardware"] == "loihi"}
    constants = {constant["name"]: constant for constant in report["constants"]}
    return rows, report["time_us_per_timestep"], constants


rows, times, constants = estimate({})
job = (ROOT / "mapping/scenarios/vtsnn-slip-paper.ron").read_text()
copies, cores = (int(re.search(rf"\b{name}: (\d+)", job).group(1)) for name in ("copies", "cores_used"))

latency = cell("total", "latency_us")
fitted = {"core_static_power": (cell("neuron", "static_mw") * copies / cores, "mW", "neuron static power")}
clock, share = constants["x86_clock_power"]["value"], constants["x86_injecting_share"]["value"]
fitted["x86_active_power"] = ((cell("x86", "dynamic_mw") - clock) / share, "mW", "x86 dynamic power")

# Cores handle spikes while others are injected, so that time is not quite linear in the time of a spike.
injection = constants["injection_time"]["value"]
spikes = times["injection"] / injection
for _ in range(4):
    found, _, _ = estimate({"injection_time": f"{injection:.4f}us"})
    injection += (latency - found["total"]["latency_us"]) / spikes
fitted["injection_time"] = (injection, "us", "latency of a step")

energy = rows["neuron"]["dynamic_mw"] * rows["neuron"]["latency_us"]
factor = cell("neuron", "dynamic_mw") * latency / energy
for name, constant in constants.items():
    if name.endswith("_energy") and constant["value"] > 0:
        fitted[name] = (constant["value"] * factor, "pJ", f"neuron dynamic power, all events by {factor:.3f}")

print("// Written by docs/studies/vtsnn_constants.py: a reproduction of the paper's tables, not a prediction.")
print("Constants(")
print(f'    base: "{BASE}",')
print('    name: "vtsnn-calibrated",')
print('    notes: "Four constants from four cells of the offline table of the VT-SNN paper; the others are the default\'s.",')
for name, (value, unit, why) in fitted.items():
    print(f'    {name}: (value: {value:.4f}, unit: {unit}, source: "{SOURCE}{why}", status: calibrated),')
print(")")
