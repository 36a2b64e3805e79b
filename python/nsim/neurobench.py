"""nsim as a model of NeuroBench's harness (`neurobench` 2.3, with torch and snntorch).

>>> from neurobench.benchmarks import Benchmark
>>> from nsim.neurobench import Model, classes
>>> Benchmark(Model(nsim.load("net.ron").map()), loader, [], [classes], [static, workload]).run()

Batches are `[samples, T, channels..]`, the channels of all input populations in sequence; the model returns output spikes
`[samples, T, outputs]`. Samples run on the simulated cores; their spikes and voltages then pass through layers that the harness measures:
each projection is a linear or convolutional layer with integer weights, each population a layer of spiking neurons.
`Run.neurobench()` gives the same metrics without torch.
"""

import numpy as np
import snntorch
import torch
from neurobench.models import NeuroBenchModel
from torch.nn import functional


class _Linear(torch.nn.Linear):
    """A projection that is a matrix."""

    def __init__(self, weights):
        torch.nn.Module.__init__(self)
        self.out_features, self.in_features = weights.shape
        self.weight = torch.nn.Parameter(_narrow(weights), requires_grad=False)
        self.register_parameter("bias", None)

    def forward(self, spikes):
        # Sums of integers are exact in 64 bits.
        return functional.linear(spikes.double(), self.weight.double())


class _Conv2d(torch.nn.Conv2d):
    """A projection that is a kernel."""

    def __init__(self, weights, window):
        torch.nn.Module.__init__(self)
        self.window = {name: window[name] for name in ("stride", "padding", "dilation", "groups")}
        self.source = tuple(window["source"])
        self.weight = torch.nn.Parameter(_narrow(weights), requires_grad=False)
        self.register_parameter("bias", None)

    def forward(self, spikes):
        return functional.conv2d(spikes.double(), self.weight.double(), None, **self.window)


class _Neurons(snntorch.SpikingNeuron):
    """A population, with the recorded state after a timestep."""

    def __init__(self, compartments):
        torch.nn.Module.__init__(self)
        self.init_hidden, self.output = True, False
        self.register_buffer("current", torch.zeros(compartments, dtype=torch.int32))
        self.register_buffer("mem", torch.zeros(compartments, dtype=torch.int32))
        self.next = None

    def forward(self, spikes):
        self.mem = self.next
        return spikes


def _narrow(weights):
    if np.abs(weights).max(initial=0) > np.iinfo(np.int16).max:
        raise ValueError("synapses of one pair add up to a weight beyond 16 bits")
    return torch.from_numpy(np.ascontiguousarray(weights, dtype=np.int16))


class _Network(torch.nn.Module):
    """The layers of a mapping, in the order of its model."""

    def __init__(self, mapping, populations):
        super().__init__()
        self.projections = mapping.projections()
        layers = [_Conv2d(p["weights"], p["window"]) if "window" in p else _Linear(p["weights"]) for p in self.projections]
        self.connections = torch.nn.ModuleList(layers)
        self.populations = torch.nn.ModuleDict({f"population {i}": _Neurons(n) for i, (_, n) in enumerate(populations)})
        self.names = [name for name, _ in populations]

    def replay(self, spikes, voltages):
        """Passes the spikes and voltages of a run through the layers; `spikes` of all populations, `[samples, T, n]`."""
        steps = next(iter(spikes.values())).shape[1]
        layers = list(zip(self.names, self.populations.values()))
        rest = {layer: layer.mem for _, layer in layers}
        for step in range(steps):
            for projection, layer in zip(self.projections, self.connections):
                sent = spikes[projection["source"]][:, step] * float(projection["factor"])
                layer(sent.reshape(len(sent), *layer.source) if hasattr(layer, "source") else sent)
            for name, layer in layers:
                layer.next = voltages[name][:, step]
                layer(spikes[name][:, step])
        for layer, mem in rest.items():
            layer.mem, layer.next = mem, None


class Model(NeuroBenchModel):
    """A mapping that the harness runs; all spikes and voltages of its network have to fit memory."""

    def __init__(self, mapping):
        super().__init__()
        self.add_activation_module(snntorch.SpikingNeuron)
        self.mapping = mapping
        shapes = [(name, kind == "input", shape) for name, kind, shape in mapping.populations]
        self.inputs = [(name, shape) for name, is_input, shape in shapes if is_input]
        populations = [(name, int(np.prod(shape))) for name, is_input, shape in shapes if not is_input]
        self.probes = [name for name, _ in populations]
        self.net = _Network(mapping, populations)

    def __net__(self):
        return self.net

    def __call__(self, batch):
        samples, steps = batch.shape[:2]
        flat = batch.reshape(samples, steps, -1)
        sizes = [int(np.prod(shape)) for _, shape in self.inputs]
        if flat.shape[2] != sum(sizes):
            raise ValueError(f"a batch has {flat.shape[2]} channels, the inputs of the network {sum(sizes)}")
        parts = dict(zip([name for name, _ in self.inputs], torch.split(flat, sizes, dim=2)))
        arrays = {
            name: parts[name].reshape(samples, steps, *shape).cpu().numpy() for name, shape in self.inputs
        }
        names = [f"{name}.{what}" for name in self.probes for what in ("spikes", "v")]
        run = self.mapping.run(arrays, time_first=True, probe=names)
        recorded = {name: torch.from_numpy(run.probe(name)).transpose(1, 2) for name in names}
        spikes = {name: recorded[f"{name}.spikes"] for name in self.probes}
        # Any number other than 0 is one spike.
        spikes.update({name: (part != 0).to(torch.int32) for name, part in parts.items()})
        self.net.replay(spikes, {name: recorded[f"{name}.v"] for name in self.probes})
        return spikes[self.mapping.output]


def classes(spikes):
    """A postprocessor: the class with most spikes, the lowest on a tie, -1 where all are silent."""
    counts = spikes.sum(dim=1)
    return torch.where(counts.sum(dim=1) > 0, counts.argmax(dim=1), -1)
