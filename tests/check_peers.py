"""Networks of snnTorch, Norse and sinabs: spikes and classes in these tools, and in nsim after an import.

usage: check_peers.py NSIM FOLDER [SAMPLES]

needs: pip install torch snntorch norse sinabs nirtorch, then pip install --no-deps nir==1.0.8
(sinabs asks for an older nir, which the exporter of snnTorch no longer takes).

Each network has random weights and two to five layers, recurrent ones too. It runs in its tool over random recordings
that look like those of a tactile sensor, in single and in double precision. Its file, NIR or a state dict, is what the
tool writes in single precision. nsim imports it and runs it with the reference engine.

Prints a line a network. A sample differs where nsim's spikes of the last layer are neither those of single nor those of
double precision: rounding explains what lies between the two. The status is 1 when a sample differs or has another
class, when a network is refused, or when one is too silent or too loud to say anything.
"""

import json
import os
import re
import shutil
import subprocess
import sys

import numpy
import torch
from torch import nn

CHANNELS, CLASSES, STEPS = 20, 5, 50
SIZES = {2: [16], 3: [16, 12], 4: [16, 14, 12], 5: [16, 14, 12, 10]}


class Linear(nn.Linear):
    """A layer that takes spikes of any precision: some tools send them in single precision always."""

    def forward(self, x):
        return super().forward(x.to(self.weight.dtype))


def recordings(samples):
    """Presses of a sensor: a class excites some channels, from an onset on and for a while."""
    draw = numpy.random.default_rng(1)
    rates = draw.uniform(0.02, 0.5, (CLASSES, CHANNELS))
    spikes = numpy.zeros((samples, CHANNELS, STEPS), dtype=numpy.uint8)
    for sample in range(samples):
        first, length = draw.integers(0, 10), draw.integers(25, 40)
        pressed = (numpy.arange(STEPS) >= first) & (numpy.arange(STEPS) < first + length)
        chance = 0.01 + rates[sample % CLASSES][:, None] * pressed
        spikes[sample] = draw.random((CHANNELS, STEPS)) < chance
    return spikes


def weights(shape, draw, gain, low=-0.6):
    """Weights of both signs, more of them positive, so that deep layers still spike."""
    values = draw.uniform(low, 1.0, shape) * gain * 4 / shape[1]
    return nn.Parameter(torch.tensor(values, dtype=torch.float32))


def linear(sources, targets, draw, gain, bias=False):
    layer = Linear(sources, targets, bias=bias)
    layer.weight = weights((targets, sources), draw, gain)
    if bias:
        layer.bias = nn.Parameter(torch.tensor(draw.uniform(-0.02, 0.05, targets), dtype=torch.float32))
    return layer


def stepped(modules, spikes, fresh):
    """Spikes of the last of some modules, [sample, step, unit], for modules that take a step at a time."""
    fresh()
    outputs = []
    with torch.no_grad():
        for step in range(spikes.shape[2]):
            x = spikes[:, :, step]
            for module in modules:
                x = module(x)
            outputs.append(x)
    return torch.stack(outputs, 1)


class SnnTorch:
    """Leaky, Synaptic, RLeaky and RSynaptic."""

    def __init__(self, form, neuron, reset, layers, recurrent):
        import snntorch

        self.form, self.reset = form, reset
        self.name = f"snnTorch {'R' if recurrent else ''}{neuron} ({reset}), {form}"
        draw = numpy.random.default_rng([layers, recurrent, neuron == "Leaky"])
        own = dict(init_hidden=True, reset_mechanism=reset)
        gain = 0.28 if neuron == "Synaptic" else 0.8
        modules, sources = [], CHANNELS
        for place, targets in enumerate(SIZES[layers] + [CLASSES]):
            modules.append(linear(sources, targets, draw, gain * (1 if place == 0 else 2.5), bias=place < 2))
            # One number a neuron: the exporter loses the shape of a layer where one counts for all.
            each = lambda low, high: torch.tensor(draw.uniform(low, high, targets), dtype=torch.float32)
            own.update(beta=each(0.85, 0.95), threshold=each(0.9, 1.1))
            if neuron == "Synaptic":
                own["alpha"] = each(0.6, 0.8)
            if recurrent and place < layers - 1:
                unit = getattr(snntorch, "R" + neuron)(linear_features=targets, **own)
                unit.recurrent = linear(targets, targets, draw, gain, bias=place == 0)
                unit.recurrent.weight.data -= gain * 2 / targets
                modules.append(unit)
            else:
                modules.append(getattr(snntorch, neuron)(**own))
            sources = targets
        self.net = nn.Sequential(*modules)

    def run(self, spikes):
        def fresh():
            for module in self.net:
                for name in ("mem", "syn", "spk"):
                    if hasattr(module, name):
                        setattr(module, name, torch.zeros(0, dtype=spikes.dtype))

        return stepped(list(self.net), spikes, fresh)

    def write(self, folder):
        if self.form == "state dict":
            path = os.path.join(folder, "net.pt")
            torch.save(self.net.state_dict(), path)
            return path, []
        import nir
        from snntorch.export_nir import export_to_nir

        path = os.path.join(folder, "net.nir")
        nir.write(path, export_to_nir(self.net, torch.zeros(1, CHANNELS), ignore_dims=[0]))
        if self.reset == "zero":
            return path, []
        return without_reset(path), ["--reset", "subtract-later"]


class Norse:
    """LIFBoxCell as NIR; LIFCell and LIFRecurrentCell, which have a current, as state dicts."""

    CONFIG = "neuron: {type: LIF, tau_syn_inv: 300, tau_mem_inv: 120, v_th: 0.5}\nsimulation: {Ts: 1.0}\n"

    def __init__(self, form, layers, recurrent):
        import norse.torch as norse

        self.form = form
        cell = "LIFBoxCell" if form == "NIR" else "LIFRecurrentCell" if recurrent else "LIFCell"
        self.name = f"Norse {cell}, {form}"
        draw = numpy.random.default_rng([layers, recurrent, 7])
        full = norse.LIFParameters(tau_syn_inv=torch.as_tensor(300.0), tau_mem_inv=torch.as_tensor(120.0), v_th=torch.as_tensor(0.5))
        gain = 6.0 if form == "NIR" else 1.6
        modules, sources = [], CHANNELS
        for place, targets in enumerate(SIZES[layers] + [CLASSES]):
            scale = gain * (1 if place == 0 else 1.8)
            if recurrent:
                unit = norse.LIFRecurrentCell(sources, targets, p=full)
                unit.input_weights = weights((targets, sources), draw, scale)
                own = weights((targets, targets), draw, gain, low=-1.2)
                own.data.fill_diagonal_(0.0)
                unit.recurrent_weights = own
                modules.append(unit)
            else:
                modules.append(linear(sources, targets, draw, scale, bias=place < 2))
                # One number a neuron: the exporter loses the shape of a layer where one counts for all.
                each = lambda x: torch.full((targets,), x)
                box = norse.LIFBoxParameters(tau_mem_inv=each(120.0), v_leak=each(0.0), v_th=each(0.5))
                modules.append(norse.LIFBoxCell(p=box) if form == "NIR" else norse.LIFCell(p=full))
            sources = targets
        self.net = norse.SequentialState(*modules)

    def run(self, spikes):
        state, outputs = None, []
        with torch.no_grad():
            for step in range(spikes.shape[2]):
                x, state = self.net(spikes[:, :, step], state)
                outputs.append(x)
        return torch.stack(outputs, 1)

    def write(self, folder):
        if self.form == "state dict":
            path, config = os.path.join(folder, "net.pt"), os.path.join(folder, "neuron.yml")
            torch.save(self.net.state_dict(), path)
            with open(config, "w") as file:
                file.write(self.CONFIG)
            return path, ["--neuron", config]
        import nir
        from norse.torch.utils.export_nir import to_nir

        path = os.path.join(folder, "net.nir")
        nir.write(path, to_nir(self.net, torch.zeros(CHANNELS)))
        # Norse writes dt / tau_mem_inv for a time constant of 1 / tau_mem_inv: a step of 1 ms is dt dt.
        return path, ["--dt", "0.001"]


class Sinabs:
    """IAF and LIF with one spike a step at most."""

    def __init__(self, neuron, layers):
        import sinabs.layers

        self.name, self.neuron = f"sinabs {neuron}, NIR", neuron
        draw = numpy.random.default_rng([layers, neuron == "IAF", 9])
        own = dict(spike_fn=sinabs.activation.SingleSpike, batch_size=1)
        gain = 0.7
        if neuron == "LIF":
            gain = 8.0
        modules, sources = [], CHANNELS
        for place, targets in enumerate(SIZES[layers] + [CLASSES]):
            modules.append(linear(sources, targets, draw, gain * (1 if place == 0 else 2.5), bias=place == 1))
            own["spike_threshold"] = torch.ones(targets)
            if neuron == "LIF":
                own["tau_mem"] = torch.tensor(draw.uniform(6, 12, targets), dtype=torch.float32)
            modules.append(getattr(sinabs.layers, neuron + "Squeeze")(**own))
            sources = targets
        self.net = nn.Sequential(*modules)

    def run(self, spikes):
        outputs = []
        with torch.no_grad():
            for sample in spikes:
                for module in self.net:
                    if hasattr(module, "reset_states"):
                        module.v_mem = torch.zeros_like(module.v_mem, dtype=spikes.dtype)
                outputs.append(self.net(sample.T))
        return torch.stack(outputs)

    def write(self, folder):
        import nir
        import sinabs.nir

        path = os.path.join(folder, "net.nir")
        nir.write(path, sinabs.nir.to_nir(self.net, torch.zeros(1, CHANNELS)))
        options = ["--reset", "subtract"]
        if self.neuron == "LIF":
            # Its time constants are in steps, which stand as seconds in the file.
            options += ["--dt", "1000", "--decay", "exponential"]
        return without_reset(path), options


def without_reset(path):
    """The file without v_reset, which exporters write as 0 whatever the network does at a spike (as nsim advises)."""
    import h5py

    with h5py.File(path, "r+") as file:
        found = []
        file.visit(lambda name: found.append(name) if name.endswith("/v_reset") else None)
        for name in found:
            del file[name]
    return path


def command(*args):
    done = subprocess.run(args, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    return json.loads(done.stdout)


def nsim(program, folder, path, options):
    """Spikes of the output, [sample, step, unit], their counts, the classes, and the step at which the output starts."""
    model, out = os.path.join(folder, "model.ron"), os.path.join(folder, "out")
    found = command(program, "import", path, *options, "-o", model, "--force", "--format", "json")
    source = next(population["name"] for population in found["populations"] if population["kind"] == "input")
    report = command(program, "run", model, "--input", f"{source}={folder}/in.npy", "--engine", "reference", "--probe",
                     f"{found['output']}.spikes", "-o", out, "--force", "--format", "json")
    spikes = numpy.load(os.path.join(out, found["output"] + ".spikes.npy"))
    start = next(population["start_step"] for population in found["populations"] if population["name"] == found["output"])
    predicted = [-1 if one is None else one for one in report["predicted"]]
    return spikes.transpose(0, 2, 1) > 0, numpy.array(report["output_counts"]), predicted, start


def classes(spikes):
    """The unit with most spikes, the first of equal ones; -1 where none spikes."""
    counts = spikes.sum(1)
    return [int(count.argmax()) if count.any() else -1 for count in counts]


def compare(program, folder, peer, layers, spikes):
    """A network in its tool and in nsim: whether they agree, and a line about it."""
    os.makedirs(folder, exist_ok=True)
    numpy.save(os.path.join(folder, "in.npy"), spikes)
    path, options = peer.write(folder)
    given = torch.tensor(spikes)
    single = peer.run(given.float()).numpy() > 0
    peer.net.double()
    double = peer.run(given.double()).numpy() > 0
    rate = single.mean()
    line = f"{peer.name:42} {layers} layers {rate:6.3f} "
    try:
        ours, counts, predicted, start = nsim(program, folder, path, options)
    except RuntimeError as problem:
        return False, f"{line} refused: {problem}"
    # A probe has the steps of the input; the counts have what the output answers to the last of them too.
    equal = lambda k, right: (ours[k, start:] == right[k, : STEPS - start]).all() and (counts[k] == right[k].sum(0)).all()
    differ = sum(not equal(k, single) and not equal(k, double) for k in range(len(ours)))
    right = [mine in pair for mine, *pair in zip(predicted, classes(single), classes(double))]
    ok = differ == 0 and all(right) and 0.01 < rate < 0.6
    return ok, f"{line} {sum(right):3} of {len(right)} classes, spikes of {differ:2} samples differ"


def peers():
    for neuron in ("Leaky", "Synaptic"):
        for form in ("state dict", "NIR"):
            for reset in ("subtract", "zero"):
                for layers, recurrent in ((2, 0), (4, 0), (5, 0), (2, 1), (4, 1)):
                    # NIR's reset takes effect at the spike. Those of snnTorch's other neurons cost the next step too.
                    if form == "NIR" and reset == "zero" and (neuron == "Synaptic" or recurrent):
                        continue
                    yield layers, SnnTorch(form, neuron, reset, layers, recurrent)
    for layers in (2, 4, 5):
        yield layers, Norse("NIR", layers, 0)
        yield layers, Norse("state dict", layers, 0)
        yield layers, Norse("state dict", layers, 1)
        yield layers, Sinabs("IAF", layers)
        yield layers, Sinabs("LIF", layers)


def rewritten(program, folder):
    """Files of HDF5 that nsim refuses, after the command that the refusal prints: whether all are read, and lines about them."""
    import h5py

    layouts = os.path.join(os.path.dirname(os.path.abspath(__file__)), "layouts")
    linked = os.path.join(folder, "soft_link")
    shutil.copy(os.path.join(layouts, "chunks_implicit"), linked)
    with h5py.File(linked, "r+", libver="latest") as file:
        file.move("layer/0/weight", "elsewhere")
        file["layer/0/weight"] = h5py.SoftLink("/elsewhere")
    good = []
    for path in [os.path.join(layouts, name) for name in ("layout_5", "chunks_b_tree_2", "virtual")] + [linked]:
        new = os.path.join(folder, "rewritten.net")
        refusal = " ".join(subprocess.run([program, "import", path], capture_output=True, text=True).stderr.split())
        found = re.search('python3 -c "(.*?)"', refusal)
        if found:
            subprocess.run([sys.executable, "-c", found.group(1).replace("FILE", path).replace("NEW", new)])
        good.append(bool(found) and subprocess.run([program, "import", new], capture_output=True).returncode == 0)
        print(f"{os.path.basename(path):42} rewritten as nsim says: {'read' if good[-1] else refusal}")
    return all(good)


def main():
    program, folder = sys.argv[1:3]
    os.makedirs(folder, exist_ok=True)
    spikes = recordings(int(sys.argv[3]) if len(sys.argv) > 3 else 60)
    good = []
    print(f"{'network':42} layers   rate")
    for index, (layers, peer) in enumerate(peers()):
        ok, line = compare(program, os.path.join(folder, str(index)), peer, layers, spikes)
        print(line + ("" if ok else "  <--"), flush=True)
        good.append(ok)
    print(f"{sum(good)} of {len(good)} networks agree")
    sys.exit(not (rewritten(program, folder) and all(good)))


if __name__ == "__main__":
    main()
