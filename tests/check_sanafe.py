"""Energy and time of random mapped networks, in nsim and in SANA-FE 2.2 (pip install sanafe numpy).

usage: check_sanafe.py NSIM FOLDER [NETWORKS] [NETWORKS OVER SEVERAL CHIPS]

Each network is mapped by nsim onto a chip with small cores, run, and exported; SANA-FE runs the export. Every compartment
is biased, so that both programs agree on which are updated (nsim also updates one whose current alone is not zero),
currents have no memory, so that voltages agree bit for bit, and inputs have delay 1, so that both programs send them in the
same step. Prints a line a network and ends with status 1 when spikes or
dynamic energy differ, or the time of the run by more than 3 %. nsim has no host here, as SANA-FE has none.

SANA-FE's `detailed` schedule orders the messages of one spike by the addresses of their receiving cores on the heap, so that a
second run in the same process may give another time. So each run has a process of its own, and two are held to be equal.

SANA-FE has no chips: over several of them, a link between chips passes messages as fast here as any other, and barriers take no
longer.
"""

import contextlib
import io
import json
import os
import re
import subprocess
import sys

import numpy
import sanafe

CHIP = """Chip(
    name: "small-cores", notes: "cores of few compartments, so that small networks take many",
    width: 8, height: 4, cores_per_tile: 4, cores: 128, x86_cores: 3, x86_cores_in_use: 1,
    limits: (compartments: %d, axons_in: 4096, axons_out: 4096, axon_out_slots: 1, axon_out_slots_off_chip: 2,
        axons_out_per_compartment: 511, synapse_words: 16384, synapse_words_per_axon: 256, synapses_per_entry: 64,
        synapse_formats: 15, compartment_profiles: 32, threshold_profiles: 16, accumulators: 8192, packing: Nengo),
)
"""
TARGET = """Target(name: "small-cores", notes: "one chip or several", chip: "small-cores", chips_x: %d, chips_y: %d,
    constants: ["sanafe-calibrated"])
"""
MODEL = """Network(name: "random", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [%(channels)d]),
    Loihi(name: "a", shape: [%(a)d], du: 4096, dv: %(dv)d, vth_mant: %(vth)d, bias_mant: %(bias)d, bias_exp: 0),
    Loihi(name: "out", shape: [%(b)d], du: 4096, dv: %(dv)d, vth_mant: %(vth)d, bias_mant: %(bias)d, bias_exp: 1),
], projections: [
    %(first)s,
    Random(from: ["a"], to: "out", fan_out: %(fan)d, low: -64, high: 126, seed: %(seed)d),
    Random(from: ["out"], to: "a", fan_out: %(fan)d, low: -126, high: 64, seed: %(other)d),
], output: "out")
"""


ONE_CHIP = [1, 2, 3, 4, 5, 8, 11, 16, 22, 27, 32, 40, 48, 56, 64, 72, 80, 96, 112, 128]
SEVERAL_CHIPS = [140, 160, 200, 240, 300, 360, 420, 500]


def network(folder, index, several):
    """Writes a network, its target and its input; returns its timesteps."""
    draw = numpy.random.default_rng(10000 + index if several else index)
    sizes = SEVERAL_CHIPS if several else ONE_CHIP
    cores = sizes[index % len(sizes)]
    size = int(draw.integers(8, 33))
    compartments = max(2, cores * size)
    a = max(1, compartments // 2 // size * size)
    b = max(1, compartments - a)
    channels = int(draw.integers(16, 129))
    fan = int(min(a, b, draw.integers(4, 25)))
    dense = index % 3 == 0 and channels * a < 20000
    if dense:
        weights = draw.integers(-20, 61, size=(a, channels)) * 2
        first = 'Dense(from: ["in"], to: "a", weights: %s, delay: 1)' % json.dumps(weights.tolist())
    else:
        first = 'Random(from: ["in"], to: "a", fan_out: %d, low: -20, high: 120, seed: %d, delay: 1)' % (
            min(a, 4 * fan), 100 + index)
    values = dict(channels=channels, a=a, b=b, fan=fan, first=first, seed=index, other=1000 + index,
                  dv=int(draw.integers(0, 1025)), vth=int(draw.integers(60, 301)), bias=int(draw.integers(1, 513)))
    steps = int(draw.integers(20, 61))
    spikes = draw.random((channels, steps)) < draw.choice([0.05, 0.2, 0.5])
    for name, text in (("model.ron", MODEL % values), ("target.ron", TARGET % ((2, 2) if several else (1, 1))), ("small-cores.ron", CHIP % size)):
        with open(os.path.join(folder, name), "w") as file:
            file.write(text)
    numpy.save(os.path.join(folder, "in.npy"), spikes.astype(numpy.uint8))
    return steps


def preset(folder, even, several):
    """A preset that both programs can follow.

    SANA-FE knows one kind of synapse a compartment; nsim picks the kind of each list, so some compartments have both, and
    then dense and sparse lists cost the same. SANA-FE knows no chips, so messages cross to another as fast as any link.
    """
    changes = {}
    if even:
        changes.update(synapse_sparse_energy=(35.5, "pJ"), synapse_sparse_time=(3.8, "ns"))
    if several:
        changes.update(link_chip_time=(0.291, "ns"), chip_hop_time=(0, "us"))
    constant = '%s: (value: %g, unit: %s, source: "as SANA-FE has it", status: assumed)'
    fields = "".join(", " + constant % (name, *value) for name, value in changes.items())
    text = 'Constants(base: "sanafe-calibrated", name: "peer", notes: "for both programs"%s)' % fields
    path = os.path.join(folder, "preset.ron")
    with open(path, "w") as file:
        file.write(text)
    return path


def nsim(program, folder, transport, constants):
    """nsim's report, and the files for SANA-FE."""
    at = lambda name: os.path.join(folder, name)
    command = [program, "energy", at("model.ron"), "--target", at("target.ron"), "--input", at("in.npy"), "--copies", "1",
               "--constants", constants, "--transport", transport, "--host", "none", "--baseline", "--format", "json", "--force",
               "--export-sanafe", folder]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"nsim: {done.stdout}{done.stderr}")
    return json.loads(done.stdout)


def exported(folder):
    """Timesteps to run, and compartments with both kinds of synapses."""
    with open(os.path.join(folder, "snn.yaml")) as file:
        run = re.search(r"# run: timesteps=(\d+) leading=(\d+) mixed=(\d+)", file.read())
    steps, leading, mixed = (int(number) for number in run.groups())
    assert leading == 0, run.group(0)
    return steps, mixed


def peer(folder, model):
    """SANA-FE's energy without the last step's synaptic events, its time, spikes and hops."""
    steps, _ = exported(folder)
    with contextlib.redirect_stdout(io.StringIO()):
        arch = sanafe.load_arch(os.path.join(folder, "arch.yaml"))
        chip = sanafe.SpikingChip(arch)
        chip.load(sanafe.load_net(os.path.join(folder, "snn.yaml"), arch))
        result = chip.sim(steps, timing_model=model, perf_trace=True)
    trace = result["perf_trace"]
    energy = result["energy"]["total"] - trace["synapse_energy"][-1]
    return energy, result["sim_time"], sum(trace["fired"]), sum(trace["hops"])


def fresh(folder, model):
    """The same from a process of its own."""
    done = subprocess.run([sys.executable, __file__, "--peer", folder, model], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"SANA-FE: {done.stdout}{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def compare(program, here, index, several):
    """One network in both programs: relative deviations of energy and of each model of the mesh, and a line about them."""
    os.makedirs(here, exist_ok=True)
    steps = network(here, index, several)
    constants = preset(here, False, several)
    reports = {"queued": nsim(program, here, "queued", constants)}
    if exported(here)[1]:
        constants = preset(here, True, several)
        reports["queued"] = nsim(program, here, "queued", constants)
    reports["analytic"] = nsim(program, here, "analytic", constants)
    runs = [fresh(here, "detailed") for _ in range(2)]
    energy, time, fired, hops = runs[0]
    queued = reports["queued"]
    assert queued["timesteps"] == exported(here)[0], queued["timesteps"]
    ours = sum(queued["breakdown_pj_per_timestep"].values()) * queued["timesteps"] * 1e-12
    took = lambda report: sum(report["time_us_per_timestep"].values()) * report["timesteps"] * 1e-6
    off = {"energy": ours / energy - 1, "again": max(abs(run[1] / time - 1) for run in runs)}
    off.update((name, took(report) / time - 1) for name, report in reports.items())
    assert all(run[0] == energy and run[2:] == [fired, hops] for run in runs), runs
    line = (f"{index:3} {'several chips' if several else 'one chip'}, cores {queued['cores_used']:3} steps {steps:2} fired {fired:6} "
            f"hops {hops:7}: energy {ours:.6e} J ({off['energy']:+.1e}), {time / steps * 1e6:.4f} us a step, "
            f"queued {100 * off['queued']:+.2f} %, analytic {100 * off['analytic']:+.2f} %, again {100 * off['again']:.2f} %")
    return off, line


def main():
    if sys.argv[1] == "--peer":
        print(json.dumps(peer(*sys.argv[2:4])))
        return
    program, folder = sys.argv[1:3]
    networks = int(sys.argv[3]) if len(sys.argv) > 3 else 30
    several = int(sys.argv[4]) if len(sys.argv) > 4 else 10
    found = []
    # In these two, long stalls of some senders meet messages of others.
    stalled = [18, 43][: several // 5]
    for name, index in [("one", n) for n in range(networks)] + [("several", n) for n in [*range(several), *stalled]]:
        off, line = compare(program, os.path.join(folder, f"{name}-{index}"), index, name == "several")
        print(line, flush=True)
        found.append(off)
    summary = []
    for name in ("energy", "queued", "analytic", "again"):
        every = sorted(abs(off[name]) for off in found)
        summary.append(f"{name} {100 * every[len(every) // 2]:.2g} % in the median, {100 * every[-1]:.2g} % at most")
    print(f"{networks} networks on one chip, {len(found) - networks} over several: " + "; ".join(summary))
    sys.exit(any(abs(off["energy"]) > 1e-9 or abs(off[DEFAULT]) > 0.03 for off in found))


# The model of the mesh that is held to 3 %: nsim's default.
DEFAULT = "queued"

if __name__ == "__main__":
    main()
