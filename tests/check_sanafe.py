"""Energy and time of random mapped networks, in nsim and in SANA-FE 2.2 (pip install sanafe numpy).

usage: check_sanafe.py NSIM FOLDER [NETWORKS]

Each network is mapped by nsim onto a chip with small cores, run, and exported; SANA-FE runs the export. Every compartment
is biased, so that both programs agree on which are updated (nsim also updates one whose current alone is not zero),
currents have no memory, so that voltages agree bit for bit, and inputs have delay 1, so that both programs send them in the
same step. Prints a line a network and ends with status 1 when spikes or
dynamic energy differ, or the time of the run by more than 5 %.

SANA-FE's `detailed` schedule takes messages that are ready at the same time in an order that differs from run to run of the
same files (also with one thread), and the time with it. So it is run several times, and nsim, which gives a tie to the lower
core, is held to the mean; the line says how far the runs are apart and how far nsim is from the nearest.
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
    width: 8, height: 4, cores_per_tile: 4, cores: 128, x86_cores: 3, x86_cores_in_use: 1, power_unit: Tile,
    limits: (compartments: %d, axons_in: 4096, axons_out: 4096, axon_out_slots: 1, axon_out_slots_off_chip: 2,
        axons_out_per_compartment: 511, synapse_words: 16384, synapse_words_per_axon: 256, synapses_per_entry: 64,
        synapse_formats: 15, compartment_profiles: 32, threshold_profiles: 16, accumulators: 8192, packing: Nengo),
)
"""
TARGET = """Target(name: "small-cores", notes: "one chip", chip: "small-cores", chips_x: 1, chips_y: 1,
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


def network(folder, index, draw):
    """Writes a network of about so many cores; returns its model, target and input."""
    cores = [1, 2, 3, 4, 5, 8, 11, 16, 22, 27, 32, 40, 48, 56, 64, 72, 80, 96, 112, 128][index % 20]
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
    for name, text in (("model.ron", MODEL % values), ("target.ron", TARGET), ("small-cores.ron", CHIP % size)):
        with open(os.path.join(folder, name), "w") as file:
            file.write(text)
    numpy.save(os.path.join(folder, "in.npy"), spikes.astype(numpy.uint8))
    return steps


def even(folder):
    """The preset with dense and sparse lists at the same cost.

    SANA-FE knows one kind of synapse a compartment; nsim picks the kind of each list, so some compartments have both.
    """
    preset = os.path.join(os.path.dirname(__file__), "..", "mapping", "constants", "sanafe-calibrated.ron")
    with open(preset) as file:
        text = file.read()
    text = text.replace("(value: 33.6,", "(value: 35.5,").replace("(value: 4.7,", "(value: 3.8,")
    path = os.path.join(folder, "even.ron")
    with open(path, "w") as file:
        file.write(text)
    return path


def nsim(program, folder, transport, constants):
    """nsim's report, and the files for SANA-FE."""
    at = lambda name: os.path.join(folder, name)
    command = [program, "energy", at("model.ron"), "--target", at("target.ron"), "--input", at("in.npy"), "--copies", "1",
               "--constants", constants, "--transport", transport, "--baseline", "--format", "json", "--force",
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


# The network that varies most has a standard deviation of 3 %, so the mean of these is known to 1 %.
REPEATS = 15


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


def main():
    program, folder = sys.argv[1:3]
    networks = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    worst_energy = worst_time = worst_busy = worst_analytic = worst_spread = worst_nearest = 0.0
    bad = []
    most = 0
    for index in range(networks):
        here = os.path.join(folder, str(index))
        os.makedirs(here, exist_ok=True)
        draw = numpy.random.default_rng(index)
        steps = network(here, index, draw)
        constants = "sanafe-calibrated"
        report = nsim(program, here, "queued", constants)
        if exported(here)[1]:
            constants = even(here)
            report = nsim(program, here, "queued", constants)
        analytic = nsim(program, here, "analytic", constants)
        runs = [peer(here, "detailed") for _ in range(REPEATS)]
        energy, _, fired, hops = runs[0]
        assert all(run[0] == energy and run[2:] == (fired, hops) for run in runs), runs
        ours = sum(report["breakdown_pj_per_timestep"].values()) * report["timesteps"] * 1e-12
        took = sum(report["time_us_per_timestep"].values()) * report["timesteps"] * 1e-6
        times = sorted({run[1] for run in runs})
        time = sum(run[1] for run in runs) / REPEATS
        nearest = min(abs(took / time - 1) for time in times)
        worst_nearest = max(worst_nearest, nearest)
        spread = times[-1] / times[0] - 1
        worst_spread = max(worst_spread, spread)
        simple = sum(analytic["time_us_per_timestep"].values()) * report["timesteps"] * 1e-6
        off, late = ours / energy - 1, took / time - 1
        worst_energy, worst_time = max(worst_energy, abs(off)), max(worst_time, abs(late))
        worst_analytic = max(worst_analytic, abs(simple / time - 1))
        # The barrier is the same constant in both: without it the mesh and the cores are seen alone.
        barrier = report["time_us_per_timestep"]["barrier"] * steps * 1e-6
        busy = (took - barrier) / (time - barrier) - 1
        worst_busy = max(worst_busy, abs(busy))
        most = max(most, report["cores_used"])
        print(f"{index:3} cores {report['cores_used']:3} steps {steps:2} fired {fired:6} hops {hops:7}: "
              f"energy {ours:.6e} J ({off:+.1e}), queued {took / steps * 1e6:.4f} us a step ({100 * late:+.2f} %, without barrier "
              f"{100 * busy:+.2f} %), "
              f"analytic {100 * (simple / time - 1):+.1f} %, {len(times)} times within {100 * spread:.2f} %, "
              f"the nearest {100 * nearest:.2f} % away")
        if abs(off) > 1e-9:
            bad.append(f"network {index}: energy {ours} against {energy}")
        if abs(late) > 0.05:
            bad.append(f"network {index}: time {took} against {time}")
    print(f"{networks} networks of up to {most} cores: energy within {worst_energy:.1e}, queued within "
          f"{100 * worst_time:.2f} % ({100 * worst_busy:.2f} % without the barrier), analytic within {100 * worst_analytic:.1f} %, "
          f"times of {REPEATS} runs up to {100 * worst_spread:.2f} % apart, "
          f"the nearest within {100 * worst_nearest:.2f} %")
    for line in bad:
        print(line, file=sys.stderr)
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
