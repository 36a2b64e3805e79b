"""Spikes of other tools' own modules, compared with nsim's after each way into nsim.

usage: check_peers.py NSIM FOLDER TOOL [SAMPLES]

Each tool has an environment of its own, with nsim for Python: sinabs and snnTorch want different versions of nir. `.ci/nightly` makes
them. A network has three layers of a module, at its defaults and
two other settings, and random weights. Its file is what the tool's own exporter writes, and the forms are `nsim.from_torch`, `nsim
import` of the file, and the same with `--from`.

Prints a line a form. The result is "equal in 60 of 60 samples", "a question" (a refusal, or a warning of what a file does not state),
or DIFFERS. A sample is equal if nsim's spikes of the last layer are those of single or of double precision: rounding explains what lies
between the two. The status is 1 if a sample differs without a question, or a network is too silent or too loud to say anything.
"""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import warnings

# Layers of a few units take longer on several threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy

CHANNELS, STEPS, SIZES = 20, 50, (16, 12, 5)
WARNED = ("reset", "threshold", "lower bound", "decay", "gain", "timestep", "equal")
"""What a warning names that is a question; with `--from` it is a parameter that is not the tool's default, or its several spikes a step."""


RESETS = {"zero": "zero", "MembraneReset": "zero", "subtract": "subtract"}
"""Values and names of settings, and the reset that they state."""


def recordings(samples):
    """Presses of a sensor: each excites some channels, from an onset on and for a while."""
    draw = numpy.random.default_rng(1)
    rates = draw.uniform(0.02, 0.5, (5, CHANNELS))
    spikes = numpy.zeros((samples, CHANNELS, STEPS), dtype=numpy.uint8)
    for sample in range(samples):
        first, length = draw.integers(0, 10), draw.integers(25, 40)
        pressed = (numpy.arange(STEPS) >= first) & (numpy.arange(STEPS) < first + length)
        spikes[sample] = draw.random((CHANNELS, STEPS)) < 0.01 + rates[sample % 5][:, None] * pressed
    return spikes


def weights(targets, sources, draw, gain, low=-0.6):
    """Weights of both signs, more of them positive, so that deep layers still spike."""
    return (draw.uniform(low, 1.0, (targets, sources)) * gain / sources).astype(numpy.float32)


def linear(targets, sources, draw, gain, bias=True):
    from torch import nn, tensor

    layer = nn.Linear(sources, targets, bias=bias)
    layer.weight.data = tensor(weights(targets, sources, draw, gain))
    if bias:
        layer.bias.data = tensor(draw.uniform(-0.01, 0.02, targets).astype(numpy.float32) * gain / 8)
    return layer


class Tool:
    """Networks of a tool whose modules are those of torch."""

    PRECISIONS = ("float32", "float64")
    # Numbers at their defaults, where each neuron has its own of all of them.
    USUAL = {}
    ENGINE = "reference"
    # The setting of one spike a step, and what a warning calls several.
    SINGLE = {}

    def __init__(self, module, setting, each):
        self.module, self.setting, self.each = module, setting, each

    def given(self, targets, setting):
        """Numbers of a setting as tensors, one a neuron where exporters lose the shape of a layer otherwise."""
        import torch

        each = self.each and self.module not in ("Lapicque", "LIFRecurrentCell")
        spread = numpy.random.default_rng(targets).uniform(0.95, 1.0, targets) if each else 1.0
        full = lambda value: value * torch.tensor(spread, dtype=torch.float32)
        usual = self.USUAL.get(self.module, {}) if each else {}
        return {key: full(value) if isinstance(value, float) else value for key, value in {**usual, **setting}.items()}

    def dense(self, targets, sources, draw, gain):
        return linear(targets, sources, draw, gain)

    def chain(self, layers):
        from torch import nn

        return nn.Sequential(*layers)

    def build(self, gain):
        draw, layers, sources = numpy.random.default_rng(7), [], CHANNELS
        for targets in SIZES:
            layers += [self.dense(targets, sources, draw, gain), self.neurons(targets, **self.setting)]
            sources = targets
        self.net = self.chain(layers)

    def both(self, spikes):
        """Spikes `[sample, step, unit]` in single and in double precision."""
        import torch

        found = []
        for dtype in self.PRECISIONS:
            dtype = getattr(torch, dtype)
            self.net.to(dtype)
            cast = lambda one: one.to(dtype) if isinstance(one, torch.Tensor) and one.is_floating_point() else one
            # Some tools send spikes in single precision always.
            hooks = [part.register_forward_pre_hook(lambda _, args: tuple(map(cast, args))) for _, part in self.net.named_modules()]
            with torch.no_grad():
                found.append(self.run(torch.tensor(spikes).to(dtype)).numpy() > 0)
            for hook in hooks:
                hook.remove()
        self.net.float()
        return found[0], found[-1]

    def by_steps(self, spikes):
        import torch

        return torch.stack([self.net(spikes[:, :, step]) for step in range(STEPS)], 1)


class SnnTorch(Tool):
    PACKAGE = "snntorch"
    USUAL = {kind: {"threshold": 1.0} for kind in ("Leaky", "Synaptic", "RLeaky", "RSynaptic")}
    CASES = {
        "Leaky": [dict(beta=0.9), dict(beta=0.9, reset_mechanism="zero"), dict(beta=0.8, threshold=0.6)],
        "Synaptic": [dict(alpha=0.7, beta=0.9), dict(alpha=0.7, beta=0.9, reset_mechanism="zero"), dict(alpha=0.5, beta=0.8, threshold=0.6)],
        "RLeaky": [dict(beta=0.9), dict(beta=0.9, reset_mechanism="zero"), dict(beta=0.8, all_to_all=False, V=-0.2)],
        "RSynaptic": [dict(alpha=0.7, beta=0.9), dict(alpha=0.7, beta=0.9, reset_mechanism="zero"), dict(alpha=0.5, beta=0.8, threshold=0.6)],
        "Lapicque": [dict(beta=0.9), dict(beta=0.9, reset_mechanism="zero"), dict(R=5.1, C=2.0, time_step=1.0)],
        "Alpha": [dict(alpha=0.9, beta=0.8)],
    }

    def neurons(self, targets, **setting):
        import snntorch

        if self.module.startswith("R") and setting.get("all_to_all", True):
            setting["linear_features"] = targets
        return getattr(snntorch, self.module)(init_hidden=True, **self.given(targets, setting))

    def run(self, spikes):
        import torch

        for module in self.net:
            for name in ("mem", "syn", "spk", "syn_exc", "syn_inh"):
                if hasattr(module, name):
                    setattr(module, name, torch.zeros(0, dtype=spikes.dtype))
        return self.by_steps(spikes)

    def export(self, path):
        import nir
        import torch
        from snntorch.export_nir import export_to_nir

        nir.write(path, export_to_nir(self.net, torch.zeros(1, CHANNELS), ignore_dims=[0]))


class Norse(Tool):
    PACKAGE = "norse"
    BOX = dict(tau_mem_inv=100.0, v_leak=0.0, v_th=1.0)
    USUAL = {"LIFBoxCell": BOX, "LIFCell": {**BOX, "tau_syn_inv": 200.0}, "IAFCell": dict(v_th=1.0)}
    CASES = {
        "LIFBoxCell": [dict(), dict(tau_mem_inv=200.0, v_th=0.5), dict(subtract=True)],
        "LIFCell": [dict(), dict(tau_mem_inv=120.0, tau_syn_inv=300.0, v_th=0.5), dict(v_leak=-0.2, v_reset=-0.2)],
        "LIFRecurrentCell": [dict(), dict(tau_mem_inv=120.0, tau_syn_inv=300.0, v_th=0.5), dict(v_leak=-0.2, v_reset=-0.2)],
        "IAFCell": [dict(), dict(v_th=0.5), dict(v_reset=-0.2)],
    }

    def neurons(self, targets, subtract=False, **setting):
        import norse.torch as norse

        given = self.given(targets, setting)
        if subtract:
            given["reset_method"] = norse.functional.reset.reset_subtract
        kind = self.module.removesuffix("Cell").replace("Recurrent", "")
        own = getattr(norse, kind + "Parameters")(**given)
        return getattr(norse, self.module)(*[targets, targets] * self.module.startswith("LIFRec"), p=own)

    def dense(self, targets, sources, draw, gain):
        # A recurrent cell multiplies a bias with its input weights.
        return linear(targets, sources, draw, gain, bias=self.module != "LIFRecurrentCell")

    def chain(self, layers):
        import norse.torch as norse

        return norse.SequentialState(*layers)

    def run(self, spikes):
        import torch

        state, outputs = None, []
        for step in range(STEPS):
            out, state = self.net(spikes[:, :, step], state)
            outputs.append(out)
        return torch.stack(outputs, 1)

    def export(self, path):
        import nir
        import torch
        from norse.torch.utils.export_nir import to_nir

        nir.write(path, to_nir(self.net, torch.zeros(CHANNELS)))


class Sinabs(Tool):
    PACKAGE = "sinabs"
    SINGLE = {"spike_fn": "MultiSpike"}
    USUAL = {kind: {"spike_threshold": 1.0} for kind in ("IAF", "IAFSqueeze", "LIF", "LIFSqueeze")}
    IAF = [dict(), dict(spike_fn="SingleSpike"), dict(spike_fn="SingleSpike", reset_fn="MembraneReset", spike_threshold=0.6)]
    CASES = {
        "IAF": IAF,
        "IAFSqueeze": [dict(one, batch_size=1) for one in IAF] + [dict(batch_size=1, spike_fn="SingleSpike", min_v_mem=-1)],
        "LIF": [dict(one, tau_mem=10.0) for one in IAF] + [dict(tau_mem=10.0, tau_syn=5.0, norm_input=False, spike_fn="SingleSpike")],
        "LIFSqueeze": [dict(one, tau_mem=10.0, batch_size=1, norm_input=False) for one in IAF],
    }

    def neurons(self, targets, **setting):
        import sinabs.activation
        import sinabs.layers

        given = {key: getattr(sinabs.activation, value) if isinstance(value, str) else value for key, value in self.given(targets, setting).items()}
        for key in {"reset_fn"} & set(given):
            given[key] = given[key]()
        return getattr(sinabs.layers, self.module)(**given)

    def run(self, spikes):
        import torch

        outputs = []
        for sample in spikes:
            for module in self.net[1::2]:
                for name, buffer in module.named_buffers():
                    setattr(module, name, torch.zeros(0, dtype=spikes.dtype))
            outputs.append(self.net(sample.T) if self.module.endswith("Squeeze") else self.net(sample.T[None])[0])
        return torch.stack(outputs)

    def export(self, path):
        import nir
        import sinabs.nir
        import torch

        nir.write(path, sinabs.nir.to_nir(self.net, torch.zeros(1, CHANNELS) if self.module.endswith("Squeeze") else torch.zeros(1, 1, CHANNELS)))


class Spikingjelly(Tool):
    PACKAGE = "spikingjelly"
    CASES = {
        "IFNode": [dict(), dict(step_mode="m", v_reset=-0.2), dict(v_reset=None, v_threshold=0.6)],
        "LIFNode": [dict(), dict(step_mode="m", decay_input=False, v_reset=-0.2), dict(v_reset=None, tau=4.0)],
        "ParametricLIFNode": [dict(), dict(step_mode="m", decay_input=False, init_tau=3.0), dict(v_reset=None, v_threshold=0.6)],
        "CUBALIFNode": [dict(), dict(c_decay=0.7, v_threshold=1.0), dict(v_reset=None)],
    }

    def neurons(self, targets, **setting):
        from spikingjelly.activation_based import neuron

        return getattr(neuron, self.module)(**setting)

    def dense(self, targets, sources, draw, gain):
        from spikingjelly.activation_based import layer

        plain = linear(targets, sources, draw, gain)
        own = layer.Linear(sources, targets, step_mode=self.setting.get("step_mode", "s"))
        own.load_state_dict(plain.state_dict())
        return own

    def run(self, spikes):
        import torch
        from spikingjelly.activation_based import functional

        functional.reset_net(self.net)
        whole = self.setting.get("step_mode") == "m"
        return torch.movedim(self.net(torch.movedim(spikes, 2, 0)), 0, 1) if whole else self.by_steps(spikes)

    def export(self, path):
        import torch
        from spikingjelly.activation_based import functional
        from spikingjelly.activation_based.nir_exchange import export_to_nir

        functional.reset_net(self.net)
        export_to_nir(self.net, torch.zeros(*[1] * (1 + (self.setting.get("step_mode") == "m")), CHANNELS), path)


class Rockpool(Tool):
    PACKAGE = "rockpool"
    SINGLE = {"max_spikes_per_dt": "max_spikes_per_dt"}
    # Its spikes are in single precision, and do not meet recurrent weights of another.
    PRECISIONS = ("float32",)
    CASES = {
        "LIFTorch": [dict(), dict(max_spikes_per_dt=1), dict(max_spikes_per_dt=1, tau_mem=0.01, tau_syn=0.005, threshold=0.6, bias=0.01),
                     dict(max_spikes_per_dt=1, leak_mode="bitshifts", dash_mem=4.0, dash_syn=3.0), dict(max_spikes_per_dt=1, has_rec=True)],
    }

    def neurons(self, targets, **setting):
        import torch
        from rockpool.nn.modules import LIFTorch

        given = self.given(targets, setting)
        if setting.get("has_rec"):
            given["w_rec"] = torch.tensor(weights(targets, targets, numpy.random.default_rng(3), 1, low=-1.2))
        return LIFTorch(targets, **given)

    def dense(self, targets, sources, draw, gain):
        import torch
        from rockpool.nn.modules import LinearTorch

        return LinearTorch((sources, targets), weight=torch.tensor(weights(targets, sources, draw, gain)).T)

    def chain(self, layers):
        from rockpool.nn.combinators import Sequential

        return Sequential(*layers)

    def run(self, spikes):
        self.net.reset_state()
        return self.net(spikes.movedim(2, 1))[0]

    def export(self, path):
        import nir
        from rockpool.nn.modules.torch.nir import to_nir

        nir.write(path, to_nir(self.net))


class Spyx(Tool):
    """Modules of JAX, which only their exporter to NIR reaches."""

    PACKAGE = "spyx"
    CASES = {
        "IF": [dict(), dict(threshold=0.6), dict(threshold=1.5)],
        "LIF": [dict(beta=0.9), dict(beta=0.8, threshold=0.6), dict()],
        "CuBaLIF": [dict(alpha=0.5, beta=0.9), dict(alpha=0.7, beta=0.8, threshold=0.6), dict()],
    }

    def neurons(self, targets, **setting):
        import spyx.nn
        from flax import nnx

        return getattr(spyx.nn, self.module)((targets,), rngs=nnx.Rngs(targets), **setting)

    def dense(self, targets, sources, draw, gain):
        from flax import nnx

        layer = nnx.Linear(sources, targets, use_bias=False, rngs=nnx.Rngs(0))
        layer.kernel[...] = weights(targets, sources, draw, gain).T
        return layer

    def chain(self, layers):
        import spyx.nn

        return spyx.nn.Sequential(*layers)

    def both(self, spikes):
        import spyx.nn

        # Each layer spikes a step after its potential has passed the threshold.
        longer = numpy.pad(spikes, ((0, 0), (0, 0), (0, len(SIZES))))
        outputs, _ = spyx.nn.run(self.net, longer.transpose(2, 0, 1).astype(numpy.float32))
        single = numpy.asarray(outputs).transpose(1, 0, 2)[:, len(SIZES) :] > 0
        return single, single

    def export(self, path):
        import nir
        import spyx.nir

        sizes = ({"input": numpy.array([CHANNELS])}, {"output": numpy.array([SIZES[-1]])})
        nir.write(path, spyx.nir.to_nir(self.net, *sizes))


class LavaDl(Tool):
    """Blocks of lava-dl, in integers; their file is netx, as its tutorials write it."""

    PACKAGE = "lava-dl"
    ENGINE = "fast"
    CASES = {
        "cuba": [dict(threshold=1.0, current_decay=0.25, voltage_decay=0.1), dict(threshold=0.6, current_decay=0.9, voltage_decay=0.03),
                 dict(threshold=1.0, current_decay=0.25, voltage_decay=0.1, delay=True)],
    }

    def build(self, gain):
        import lava.lib.dl.slayer as slayer
        import torch

        draw, blocks, sources = numpy.random.default_rng(7), [], CHANNELS
        own = dict(self.setting)
        delay = own.pop("delay", False)
        for targets in SIZES:
            block = getattr(slayer.block, self.module).Dense(own, sources, targets, delay=delay)
            block.synapse.weight.data = torch.tensor(weights(targets, sources, draw, gain)).reshape(targets, sources, 1, 1, 1)
            if delay:
                block.delay.delay.data = torch.tensor(draw.integers(0, 8, targets).astype(numpy.float32)).reshape(-1, 1)
            blocks.append(block)
            sources = targets
        self.net = torch.nn.Sequential(*blocks)

    def both(self, spikes):
        import torch

        # A block delays its spikes by a step. The chip does so between layers.
        longer = torch.nn.functional.pad(torch.tensor(spikes).float(), (0, 1))
        with torch.no_grad():
            found = self.net(longer).numpy().transpose(0, 2, 1)[:, 1:] > 0
        return found, found

    def export(self, path):
        import h5py

        with h5py.File(path, "w") as file:
            for place, block in enumerate(self.net):
                block.export_hdf5(file.create_group(f"layer/{place}"))


TOOLS = [SnnTorch, Norse, Sinabs, Spikingjelly, Rockpool, Spyx, LavaDl]


class Question(Exception):
    """A refusal, of a tool or of nsim."""


def command(*args):
    """The answer of nsim, and what it wrote on stderr."""
    done = subprocess.run(args, capture_output=True, text=True)
    answer = json.loads(done.stdout)
    if done.returncode:
        raise Question(f"{answer['message']} (exit {done.returncode})")
    return answer, done.stderr


def imported(program, folder, path, options, spikes, engine):
    """Spikes `[sample, step, unit]` of a file's output and the step at which they begin, and the warnings of its import."""
    model, out = os.path.join(folder, "model.ron"), os.path.join(folder, "out")
    found, said = command(program, "import", path, *options, "-o", model, "--force", "--format", "json")
    numpy.save(os.path.join(folder, "in.npy"), numpy.concatenate([spikes, numpy.zeros_like(spikes[..., :8])], axis=2))
    source = next(one["name"] for one in found["populations"] if one["kind"] == "input")
    command(program, "run", model, "--input", f"{source}={folder}/in.npy", "--engine", engine, "--probe",
            f"{found['output']}.spikes", "-o", out, "--force", "--format", "json")
    start = next(one["start_step"] for one in found["populations"] if one["name"] == found["output"])
    ours = numpy.load(os.path.join(out, found["output"] + ".spikes.npy")).transpose(0, 2, 1) > 0
    return ours[:, start : start + STEPS], said


def read(tool, spikes):
    """Spikes of the last layer of `nsim.from_torch`."""
    import nsim
    import torch

    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", nsim.Warning)
            network = nsim.from_torch(tool.net, torch.zeros(1, CHANNELS))
    except nsim.Error as refused:
        raise Question(" ".join(str(refused).split())) from refused
    silent = numpy.zeros_like(spikes[..., :8])
    name, rows = [one for one in nsim._nsim.real_spikes(network, numpy.concatenate([spikes, silent], axis=2)) if one[0] != "always"][-1]
    ours = numpy.zeros((len(spikes), STEPS, SIZES[-1]), bool)
    rows = rows[rows[:, 1] < STEPS]
    ours[rows[:, 0], rows[:, 1], rows[:, 2]] = True
    if warned:
        # What is equal has nothing to be warned of.
        raise RuntimeError(str(warned[0].message))
    return ours, ""


def result(form, single, double, words):
    """A line about a form, and whether it is right or a question: a refusal, or a warning that has one of some words."""
    try:
        ours, said = form()
    except Question as question:
        return True, f"a question: {str(question)[:130]}"
    equal = sum(bool((mine == one).all() or (mine == two).all()) for mine, one, two in zip(ours, single, double))
    line = f"equal in {equal} of {len(ours)} samples"
    if equal == len(ours):
        return True, line
    warned = [word for word in words if word in " ".join(re.findall("WARN (.*)", said))]
    return bool(warned), f"a question: {line}, with a warning of {', '.join(warned)}" if warned else f"DIFFERS: {line}"


def compared(tool, program, folder, spikes):
    """Lines about each form of a module with a setting."""
    for gain in 0.5 * 1.3 ** numpy.arange(24):
        tool.build(gain)
        if 0.05 < tool.both(spikes[:5])[0].mean() < 0.5:
            break
    else:
        return [("network", False, "too silent or too loud to say anything")]
    single, double = tool.both(spikes)
    forms = [] if tool.PACKAGE in ("spyx", "lava-dl") else [("from_torch", lambda: read(tool, spikes))]
    path = os.path.join(folder, "net.net" if tool.PACKAGE == "lava-dl" else "net.nir")

    def of_file(options):
        return lambda: imported(program, folder, path, options, spikes, tool.ENGINE)

    found, own = [(name, *result(form, single, double, ())) for name, form in forms], os.path.splitext(path)[1][1:]
    try:
        tool.export(path)
    except Exception as stopped:
        return [*found, (own, True, f"a question: its exporter stops: {type(stopped).__name__}: {' '.join(str(stopped).split())[:80]}")]
    named = "--from" in subprocess.run([program, "import", "--help"], capture_output=True, text=True).stdout
    # What the setting has in place of the tool's default.
    reset = next((how for value, how in RESETS.items() if value in tool.setting.values() or value in tool.setting), None)
    more = [] if reset is None else ["--reset", reset]
    forms = [(own, [])] + [(" ".join([own, "--from", *more]), ["--from", tool.PACKAGE, *more])] * named
    parameters = [key for key in tool.setting if key not in tool.SINGLE] + [many for key, many in tool.SINGLE.items() if key not in tool.setting]
    return found + [(name, *result(of_file(options), single, double, parameters if options else WARNED)) for name, options in forms]


def rewritten(program, folder):
    """Files of HDF5 that nsim refuses, after the command that the refusal prints: whether all are read."""
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
        print(f"{os.path.basename(path):14} rewritten as nsim says: {'read' if good[-1] else refusal}")
    return all(good)


def main():
    program, folder, tool = sys.argv[1:4]
    os.makedirs(folder, exist_ok=True)
    spikes, good = recordings(int(sys.argv[4]) if len(sys.argv) > 4 else 60), []
    kind = next(kind for kind in TOOLS if kind.PACKAGE == tool)
    version = importlib.metadata.version(tool)
    for module, settings in kind.CASES.items():
        for place, setting in enumerate(settings):
            named = ", ".join(f"{key}={value}" for key, value in setting.items()) or "defaults"
            for form, ok, line in compared(kind(module, setting, place > 0), program, folder, spikes):
                print(f"{tool} {version} | {module} | {named} | {form} | {line}{'' if ok else '  <--'}", flush=True)
                good.append(ok)
    print(f"{sum(good)} of {len(good)} are equal or a question")
    # Once: the tools agree about HDF5.
    sys.exit(not (all(good) and (tool != "sinabs" or rewritten(program, folder))))


if __name__ == "__main__":
    main()
