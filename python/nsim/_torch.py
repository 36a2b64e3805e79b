"""Networks of PyTorch's spiking tools: the meaning of each module on a chip, and the check that the network spikes as the module.

Input: a module and one timestep of input. It is called once; every module that runs becomes nodes of a NIR graph with the equations of
its tool (`_neurons`). Output: a network whose spikes in real numbers are those of the module, layer by layer, on random samples.

A module, a value of a parameter or a computation that is not in the tables below is refused by its name. A network whose spikes differ
is refused too.
"""

import contextlib
import copy
import functools
import re

import numpy as np

from . import _nsim
from ._neurons import (
    NEURONS,
    OF_NORSE,
    OF_SNNTORCH,
    TIMESTEP_MS,
    arranged,
    by_sample,
    cleared,
    is_head,
    kind_of,
    layout_of,
    package_of,
    parts_of,
    reals,
    refusal,
    rule,
)

SAMPLES, STEPS, SEED = 4, 30, 1
"""Random input with which both networks are compared; the rate grows from sample to sample."""

ROUNDED = 0.01
"""Share of a layer's spikes that may differ, as sums in another order round differently."""

PASSED = {"Identity", "Dropout", "Dropout1d", "Dropout2d", "Dropout3d", "AlphaDropout", "Flatten", "Unflatten"}
"""Modules that change no number of a trained network, or only its shape."""

AXES = {"Linear": 2, "LinearTorch": 2, "Conv1d": 3, "Conv2d": 4, "AvgPool2d": 4, "sinabs.SumPool2d": 4, "BatchNorm1d": None, "BatchNorm2d": 4}
"""Layers between neurons, with the axes of their input, the batch included."""

ONE_STEP = "write forward() for one timestep: neurons with init_hidden=True, no init_leaky(), no loop over time, a sample [batch, channels..] " \
    "(docs/tutorials/from-pytorch.md#one-timestep)"

OUTSIDE = "between modules, only sums of layers and changes of shape are supported: put other computations of forward() into weights and biases"

OF_TIME = {"getitem", "select", "unbind", "index_select", "narrow", "split", "chunk", "stack", "cat"}
"""Functions that extract timesteps from a tensor or join them."""

STATE = "the state of "
"""Prefix of the description of a neuron's state."""

VIEWS = {"flatten", "unflatten", "view", "reshape", "squeeze", "unsqueeze", "detach", "clone", "contiguous", "float", "double", "to"}
"""Functions that change only the shape or type of a tensor, if the batch stays its first axis."""

WRAPPERS = {"OptimizedModule": "_orig_mod", "DataParallel": "module", "DistributedDataParallel": "module"}
"""Classes that wrap another module, with the name of its attribute."""

SPIKING = " ".join(sorted(OF_SNNTORCH))

CARRIED = [
    ("Conv1d Conv2d", "padding_mode", ("zeros",), "pad with zeros: beyond the edge there are no neurons"),
    ("AvgPool2d sinabs.SumPool2d", "ceil_mode", (False,), "choose a size that divides the plane, or padding="),
    ("AvgPool2d", "divisor_override", (None,), "scale the weights of the next layer instead"),
    ("BatchNorm1d BatchNorm2d", "track_running_stats", (True,), "train with track_running_stats=True: otherwise its result depends on the batch"),
    (SPIKING, "inhibition", (False,), "train without inhibition: a core does not support winner-take-all"),
    (SPIKING, "state_quant", (False,), "train without state_quant: nsim rounds states as the chip does"),
    (SPIKING, "graded_spikes_factor", (1,), "train with 1: a Loihi 1 core does not support graded spikes"),
    (SPIKING, "reset_mechanism", ("zero", "subtract"), "train with reset_mechanism='zero'; where the potential of the last layer decides, "
     "decision='GreatestV' (or 'SumOfV', 'LastV') reads it"),
]
"""Classes, one of their parameters, its supported values, and the remedy for others."""

BY_MODE = "take the modules of spikingjelly.activation_based.layer without it, and functional.set_step_mode(net, 'm')"

BY_ROWS = "take neurons with Squeeze, such as IAFSqueeze(batch_size=1), for all layers: time and samples are then one axis"

INSTEAD = {
    "MaxPool": "a core does not support a maximum of sums: put the neurons before it, which changes the network, or train with torch.nn.AvgPool2d",
    "ReLU": "put a spiking neuron in its place, such as snntorch.Leaky: a core sends spikes",
    "LayerNorm": "use torch.nn.BatchNorm1d or BatchNorm2d, whose numbers are constants once trained",
    "Alpha": "train with snntorch.Synaptic, whose current decays too",
    "SeqToANNContainer": BY_MODE,
    "MultiStepContainer": BY_MODE,
    "LinearRecurrentContainer": "train without it, or build a nir.NIRGraph of the loop for nsim.from_nir",
    "ElementWiseRecurrentContainer": "train without it, or build a nir.NIRGraph of the loop for nsim.from_nir",
    "sinabs.Repeat": BY_ROWS,
    "sinabs.FlattenTime": BY_ROWS,
    "sinabs.UnflattenTime": BY_ROWS,
    "sinabs.LIFRecurrent": "train with LIF, or build a nir.NIRGraph of the loop for nsim.from_nir",
    "sinabs.IAFRecurrent": "train with IAF, or build a nir.NIRGraph of the loop for nsim.from_nir",
    "BatchNormTT": "use torch.nn.BatchNorm1d or BatchNorm2d: weights are the same in every timestep",
}
"""Replacements of classes, by the beginning of their names."""

WHOLE = ("spikingjelly.activation_based.neuron", "sinabs.layers")
"""Packages whose modules are read or refused as a whole."""

OF_SPIKES = "for spikes, AvgPool2d(k) followed by snntorch.Leaky(beta=0, threshold=0.5 / k**2, reset_mechanism='zero', init_hidden=True) " \
    "is equivalent without training"
"""Replacement of a maximum of spikes."""


def check(module, name, by_potential=False):
    """Refuses an unsupported value of a parameter; only neurons whose potential decides may have no reset."""
    kind = kind_of(module)
    for kinds, key, values, remedy in CARRIED:
        value = getattr(module, key, values[0])
        value = value.item() if hasattr(value, "item") and len(value.reshape(-1)) == 1 else value
        if key == "reset_mechanism" and value == "none" and by_potential and not kind.startswith("R"):
            continue
        if kind in kinds.split() and not any(value is one or (isinstance(value, (int, float, str)) and value == one) for one in values):
            said = " or ".join(map(repr, values))
            raise refusal(f"'{name}' ({kind}): {key} is {value!r}, but only {said} is supported", remedy)
    if kind == "AvgPool2d" and not module.count_include_pad and np.any(np.array(module.padding)):
        message = f"'{name}' (AvgPool2d): count_include_pad is False, and its padding is not 0"
        raise refusal(message, "set count_include_pad=True: every window then has the same weights")


def leaves(module, name=""):
    """The modules that compute, each once, with their names."""
    known = kind_of(module) in PASSED | set(AXES) | NEURONS | set(INSTEAD)
    # Neurons of these packages have parts, such as a surrogate function.
    whole = known or any(kind.__module__.startswith(WHOLE) for kind in type(module).__mro__)
    children = [] if whole else [(f"{name}.{child}" if name else child, part) for child, part in module.named_children()]
    if not children:
        return {module: name or "module"}
    found = {}
    for child, part in children:
        found = {**leaves(part, child), **found}
    return found


def weights(module):
    """The node of a linear or convolutional layer."""
    kind, bias = kind_of(module), module.bias
    node = {"type": kind, "weight": module.weight.detach().cpu().numpy()}
    if kind == "LinearTorch":
        # Rockpool has a row for each source.
        kind, node = "Linear", {"type": "Linear", "weight": node["weight"].T.copy()}
    if kind != "Linear":
        padding = module.padding
        node.update({key: np.array(getattr(module, key)) for key in ("stride", "dilation", "groups")})
        node["padding"] = padding if isinstance(padding, str) else np.array(padding)
    elif bias is not None:
        node["type"] = "Affine"
    return node if bias is None else {**node, "bias": bias.detach().cpu().numpy()}


def read(module, sample):
    """The module to read, without its wrappers; refuses other objects, and a sample that is no tensor."""
    if not hasattr(module, "named_modules"):
        message = f"module is a {type(module).__name__}, expected a torch.nn.Module"
        help = "give the network itself; a state dict has no forward(), so it is loaded into its network: net.load_state_dict(state)"
        raise refusal(message, help)
    if not hasattr(sample, "detach"):
        message = f"sample is a {type(sample).__name__}, expected a tensor with one timestep of input"
        raise refusal(message, "give torch.zeros(1, channels..); a network of several inputs is built with nir for nsim.from_nir")
    while type(module).__name__ in WRAPPERS:
        module = module._modules[WRAPPERS[type(module).__name__]]
    return module


def casting(module, dtype):
    """Casts the input of each part of a module to `dtype`, as spikes of snnTorch always have single precision; returns the hooks."""
    import torch

    cast = lambda one: one.to(dtype) if isinstance(one, torch.Tensor) and one.is_floating_point() else one
    return [part.register_forward_pre_hook(lambda _, args: tuple(map(cast, args))) for part in parts_of(module)]


def called(module, given):
    """The result of a module for an input."""
    try:
        return module(given)
    except _nsim.Error:
        raise
    except Exception as error:
        message = f"the module stopped at input of shape {list(given.shape)}: {type(error).__name__}: {error}"
        raise refusal(message, "the sample is one timestep of input, [batch, channels..], and forward() takes any batch") from error


def copied(module):
    """A copy without states and gradients, in evaluation mode, on the processor."""
    import torch

    memo = {}
    for part in parts_of(module):
        held = [one for value in vars(part).values() for one in (value.values() if isinstance(value, dict) else [value])]
        for value in held:
            if isinstance(value, torch.Tensor) and value.grad_fn is not None:
                memo[id(value)] = value.detach().clone()
    module = copy.deepcopy(module, memo).cpu().eval()
    cleared(module)
    return module


@contextlib.contextmanager
def listed(module):
    """Limits snnTorch's lists of neurons to a module's neurons: `reset_hidden()` and `utils.reset` iterate over them."""
    parts = parts_of(module)
    owners = {owner for part in parts for owner in type(part).__mro__ if isinstance(vars(owner).get("instances"), list)}
    kept = [(owner, owner.instances) for owner in owners]
    try:
        for owner in owners:
            owner.instances = [part for part in parts if isinstance(part, owner)]
        yield
    finally:
        for owner, instances in kept:
            owner.instances = instances


def remedy(what):
    """The remedy for a tensor with this description."""
    if what.startswith(STATE):
        return "pass on the spikes, the first result of a neuron: its state stays on its core"
    if any(f"'{name}'" in what for name in OF_TIME):
        return ONE_STEP
    return OUTSIDE


class Trace:
    """The graph of one call: each module that runs is a node, edges are the tensors that pass from one to the next."""

    def __init__(self, module, sample, dt, layout, output=None, by_potential=False):
        import torch

        self.names = leaves(module)
        self.nodes = {"input": {"type": "Input", "shape": np.array(sample.shape[1:])}}
        self.shapes = {"input": sample.shape[1:]}
        self.edges, self.neurons, self.rules, self.dt, self.inside, self.by_potential = [], {}, {}, dt, 0, by_potential
        # The axes before those of the units: samples, and time where a call has all timesteps.
        self.lead = 2 if layout in ("first", "second") else 1
        sample, self.time = arranged(sample[..., None], layout), {"first": 0, "second": 1}.get(layout)
        # The module of each node, and the modules before each layer of neurons.
        self.modules, self.before = {}, {}
        # For each tensor the nodes whose sum it is, or a description; tensors are stored, as Python reuses the ids of freed ones.
        self.known, self.kept, self.counts = {}, [], set()
        self.learn(sample, {"input"})
        hooks = [part.register_forward_pre_hook(self.enter, with_kwargs=True) for part in self.names]
        hooks += [part.register_forward_hook(self.leave, with_kwargs=True) for part in self.names]
        try:
            with torch.no_grad(), self.watching():
                out = called(module, sample)
        finally:
            for hook in hooks:
                hook.remove()
        self.nodes["output"] = {"type": "Output"}
        self.decide(out if isinstance(out, (tuple, list)) and len(out) > 0 else [out], output)

    def watching(self):
        """Watches computations outside of modules: a sum adds edges, a change of shape nothing; any other result belongs to no node."""
        import torch
        from torch.overrides import TorchFunctionMode

        trace = self

        class Watch(TorchFunctionMode):
            def __torch_function__(self, func, types, args=(), kwargs=None):
                result = func(*args, **(kwargs or {}))
                given = [one for one in args if isinstance(one, torch.Tensor)]
                sources = [trace.known[id(one)] for one in given if id(one) in trace.known]
                if trace.inside or not sources:
                    return result
                name = getattr(func, "__name__", str(func))
                whole = len(sources) == len(args) and not kwargs and not any(isinstance(one, str) for one in sources)
                lead = given[0].shape[: trace.lead]
                same = isinstance(result, torch.Tensor) and result.shape[: trace.lead] == lead and result.numel() == given[0].numel()
                for one in result if isinstance(result, (tuple, list)) else [result]:
                    if not isinstance(one, torch.Tensor) or not one.is_floating_point():
                        continue
                    if name.strip("_") in ("add", "radd", "iadd") and whole and len({tuple(part.shape) for part in given}) == 1:
                        # A sum of a tensor with itself counts twice, but one edge counts once.
                        doubled = sum(map(len, sources)) > len(set().union(*sources))
                        trace.learn(one, "a sum that counts a layer twice" if doubled else set().union(*sources))
                    elif name in VIEWS and same:
                        trace.learn(one, sources[0])
                    elif name in ("mean", "sum") and trace.time is not None and (*args[1:], *(kwargs or {}).values())[:1] == (trace.time,):
                        trace.learn(one, sources[0])
                        trace.counts.add(id(one))
                    elif id(one) not in trace.known:
                        trace.learn(one, f"a result of '{name.strip('_')}' outside of a module")
                return result

        return Watch()

    def learn(self, tensor, what):
        self.known[id(tensor)] = what
        self.kept.append(tensor)

    def connect(self, tensor, to, what):
        """Adds edges to a node from the nodes whose sum a tensor is."""
        sources = self.known.get(id(tensor), "no output of a module of the network")
        if isinstance(sources, str):
            message = f"{what} is {sources}, which is not supported on a chip"
            raise refusal(message, remedy(sources))
        if id(tensor) in self.counts and to != "output":
            raise refusal(f"{what} is a sum or mean over time, which is not supported on a chip", "count spikes only of the last layer")
        for head in [self.modules[source] for source in sources if to != "output" and is_head(self.modules.get(source))]:
            message = f"{what} is the potential of '{self.names[head]}' ({kind_of(head)}), but a core sends spikes"
            raise refusal(message, "put a spiking neuron in its place: only the last layer may have no reset")
        self.edges += [(source, to) for source in sorted(sources)]

    def decide(self, outs, wanted):
        """Adds the edge to the output: from the layer `wanted`, else from the first result of forward()."""
        layers = {self.names[module]: node for module, node in self.neurons.items()}
        if wanted is not None:
            if wanted not in layers:
                raise refusal(f"output is {wanted!r}, but no layer of neurons has that name", f"output= is one of {', '.join(layers)}")
            self.edges.append((layers[wanted], "output"))
            return
        first = self.known.get(id(outs[0]), "")
        if isinstance(first, str) and first.startswith(STATE):
            message = f"the first result of forward() is {first}, expected the spikes of a layer"
            help = "return spikes first; with decision='GreatestV' (or 'SumOfV', 'LastV') the potential of that layer still decides"
            raise refusal(message, help)
        self.connect(outs[0], "output", "the network's output")
        before = {"output"}
        while more := {source for source, to in self.edges if to in before} - before:
            before |= more
        for one in outs[1:]:
            sources = self.known.get(id(one), "")
            for node in [] if isinstance(sources, str) else sources - before:
                first = ", ".join(f"'{name}'" for name, known in layers.items() if known in self.known[id(outs[0])])
                name = next((name for name, known in layers.items() if known == node), node)
                message = f"forward() returns first the result of {first or 'no neuron'}, then of '{name}', and the first is used as the output"
                raise refusal(message, f"return the layer that decides first, or name it: output='{name}'")

    def enter(self, module, args, kwargs):
        name, kind = self.names[module], kind_of(module)
        self.inside += 1
        if kind not in PASSED | set(AXES) | NEURONS:
            instead = next((remedy for begin, remedy in INSTEAD.items() if kind.startswith(begin)), None)
            sources = self.known.get(id((*args, *kwargs.values())[0]), "")
            if kind.startswith("MaxPool") and not isinstance(sources, str) and sources <= {"input", *self.neurons.values()}:
                instead = OF_SPIKES
            if f"{kind}Cell" in NEURONS:
                instead = f"use norse.torch.{kind}Cell: forward() computes one timestep"
            others = "supported are " + ", ".join(sorted(PASSED | set(AXES) | NEURONS)) + ", and modules made of these"
            raise refusal(f"'{name}' ({kind}) is not supported on the chips of nsim", instead or others)
        check(module, name, self.by_potential)
        given = (*args, *kwargs.values())[0]
        if not hasattr(given, "dim"):
            message = f"'{name}' ({kind}) receives a {type(given).__name__}, expected a tensor of spikes"
            raise refusal(message, "use neurons with init_hidden=True and without output=True, which return only their spikes")
        # Without the axis of time.
        shape = list(given.shape[self.lead - 1 :])
        axes = AXES.get(kind) or max(len(shape), 2)
        if len(shape) != axes:
            wanted = ", ".join(["batch", "channels", "height", "width"][: 4 if axes == 4 else 2] + ["length"] * (axes == 3))
            message = f"'{name}' ({kind}) receives shape {shape}, expected [{wanted}]"
            if isinstance(self.known.get(id(given)), str):
                help = remedy(self.known[id(given)])
            elif self.known.get(id(given)) != {"input"}:
                help = "change the shape in forward() so that the batch stays its first axis, such as torch.nn.Flatten()"
            elif len(shape) < axes:
                help = "give one timestep with its batch axis, such as sample.unsqueeze(0)"
            else:
                help = "give one timestep, such as sample[..., 0] where time comes last; forward() has no loop over time"
            raise refusal(message, help)

    def leave(self, module, args, kwargs, out):
        self.inside -= 1
        name, kind, given = self.names[module], kind_of(module), (*args, *kwargs.values())[0]
        spikes, *states = out if isinstance(out, tuple) else (out,)
        for state in states:
            # Norse gives a named tuple of tensors.
            for one in state if isinstance(state, tuple) else (state,):
                self.learn(one, f"{STATE}'{name}'")
        if kind in PASSED:
            self.learn(spikes, self.known.get(id(given), "no output of a module of the network"))
            return
        if kind.startswith("BatchNorm"):
            self.fold(module, name, given, spikes)
            return
        if kind in ("Conv1d", "Conv2d", "AvgPool2d", "sinabs.SumPool2d"):
            given = self.reshaped(given, f"{name}.input")
        node = self.add(name)
        units = tuple(spikes.shape[self.lead :])
        self.shapes[node], self.modules[node] = units, module
        if kind in NEURONS:
            sources = self.known.get(id(given), "")
            before = {self.modules.get(source) for source in sources} if not isinstance(sources, str) else sources
            if module in self.neurons:
                message = f"'{name}' ({kind}) runs more than once in a call, but a neuron of the chip runs once in a timestep"
                shared = before != self.before[module] and not isinstance(before, str)
                raise refusal(message, "give each layer its own neurons" if shared else ONE_STEP)
            self.neurons[module], self.before[module] = node, before
            self.rules[module] = rule(module, units, name)
            self.nodes[node] = self.rules[module].node(units, self.dt)
            if kind.startswith("R") or kind == "LIFRecurrentCell" or getattr(module, "_has_rec", False):
                back = self.add(f"{name}.recurrent")
                self.nodes[back] = recurrent(module, units, f"{name}.recurrent")
                self.edges += [(node, back), (back, node)]
            if kind == "LIFRecurrentCell":
                into, sources = self.add(f"{name}.input"), self.known.get(id(given), "")
                for source in () if isinstance(sources, str) else sources:
                    if np.any(self.nodes.get(source, {}).get("bias", 0)):
                        message = f"'{name}' (LIFRecurrentCell) multiplies the bias of '{self.names[self.modules[source]]}' with its input weights"
                        raise refusal(message, "train that layer with bias=False, or remove it: the cell has its own input weights")
                self.nodes[into] = {"type": "Linear", "weight": module.input_weights.detach().cpu().numpy()}
                self.edges.append((into, node))
                self.connect(given, into, f"the input of '{name}' ({kind})")
                self.learn(spikes, {node})
                return
        elif kind == "AvgPool2d":
            stride = module.kernel_size if module.stride is None else module.stride
            sizes = {"kernel_size": module.kernel_size, "stride": stride, "padding": module.padding}
            self.nodes[node] = {"type": kind, **{key: np.array(size) for key, size in sizes.items()}}
        elif kind == "sinabs.SumPool2d":
            pair = lambda size: np.broadcast_to(np.array(size), 2).copy()
            stride = module.kernel_size if module.stride is None else module.stride
            self.nodes[node] = {"type": "SumPool2d", "kernel_size": pair(module.kernel_size), "stride": pair(stride), "padding": pair(0)}
        else:
            self.nodes[node] = weights(module)
        self.connect(given, node, f"the input of '{name}' ({kind})")
        self.learn(spikes, {node})

    def reshaped(self, given, name):
        """A tensor with the axes of its nodes, else its view after a new node that reshapes them."""
        sources = self.known.get(id(given), "")
        units = given.shape[self.lead :]
        if isinstance(sources, str) or all(self.shapes[source] == units for source in sources):
            return given
        node = self.add(name)
        self.nodes[node] = {"type": "Pass", "shape": np.array(units)}
        self.shapes[node] = units
        self.connect(given, node, f"'{name}'")
        view = given[:]
        self.learn(view, {node})
        return view

    def add(self, name):
        """Adds a node and returns its name, which its population gets too."""
        name = re.sub(r"[^\w-]", "_", name)
        while name in self.nodes or name == "output":
            name += "_"
        self.nodes[name] = {}
        return name

    def fold(self, module, name, given, out):
        """Folds a normalisation into the weights before it: in a trained network it scales and shifts each channel."""
        sources = self.known.get(id(given), "")
        before = next(iter(sources)) if len(sources) == 1 and not isinstance(sources, str) else None
        node = self.nodes.get(before, {})
        if "weight" not in node or any(source == before for source, _ in self.edges):
            message = f"'{name}' ({kind_of(module)}) does not directly follow a linear or convolutional layer"
            raise refusal(message, "put it directly after the layer whose channels it scales: its numbers become weights and biases there")
        channels = node["weight"].shape[0]
        given_or = lambda tensor, usual: np.full(channels, usual) if tensor is None else reals(tensor)
        scale = given_or(module.weight, 1.0) / np.sqrt(reals(module.running_var) + module.eps)
        old = {key: value.astype(str).astype(np.float64) for key, value in node.items() if key in ("weight", "bias")}
        node["weight"] = old["weight"] * scale.reshape(-1, *[1] * (old["weight"].ndim - 1))
        node["bias"] = (old.get("bias", 0.0) - reals(module.running_mean)) * scale + given_or(module.bias, 0.0)
        node["type"] = node["type"].replace("Linear", "Affine")
        self.learn(given, f"what '{name}' normalises")
        self.learn(out, {before})


def recurrent(module, shape, name):
    """The node of the connection of a layer of neurons to itself."""
    if hasattr(module, "recurrent_weights"):
        return {"type": "Linear", "weight": module.recurrent_weights.detach().cpu().numpy()}
    if kind_of(module) == "LIFTorch":
        return {"type": "Linear", "weight": module.w_rec.detach().cpu().numpy().T.copy()}
    module = module.recurrent
    if hasattr(module, "V"):
        return {"type": "Scale", "scale": reals(module.V, shape)}
    check(module, name)
    return weights(module)


def resets(trace):
    """The reset and the test of the threshold of all neurons, and the names of nodes that stay at 0 for the step after a spike."""
    rules = {module: rule for module, rule in trace.rules.items() if not is_head(module)}
    name = lambda module: f"'{trace.names[module]}'"
    tests = {rule.inclusive for rule in rules.values()}
    if len(tests) > 1:
        each = ", ".join(f"{name(module)} {'>=' if rule.inclusive else '>'}" for module, rule in rules.items())
        raise refusal(f"the layers compare with their thresholds differently: {each}", "take the neurons of one tool for all layers")
    threshold = {"threshold": "inclusive"} if tests == {True} else {}
    how = {rule.reset for rule in rules.values()}
    later = {rule.later for rule in rules.values()}
    if len(how) > 1 or ("subtract" in how and len(later) > 1):
        each = ", ".join(f"{name(one)} {rule.reset!r}{'' if rule.later or kind_of(one) not in OF_SNNTORCH else ' without reset_delay'}" for one, rule in rules.items())
        raise refusal(f"the layers have different resets: {each}", "train all layers with a reset to zero")
    at_once = [name(one) for one, rule in rules.items() if kind_of(one) in OF_SNNTORCH and not rule.later]
    if how == {"subtract"} and at_once:
        message = f"{', '.join(at_once)}: reset_delay=False lets snnTorch subtract before it compares where a neuron stays above its threshold"
        raise refusal(message, "train with reset_delay=True, or with reset_mechanism='zero'")
    if how == {"subtract"}:
        return {"reset": "subtract-later" if later == {True} else "subtract", **threshold}, []
    held = [trace.neurons[module] for module, rule in rules.items() if rule.later and kind_of(module) != "Leaky"]
    return {**({"reset": "zero"} if how else {}), **threshold}, held


def remembering(neurons):
    """Makes each cell of Norse continue from its last state, which its module would pass on; returns the hooks."""
    states = {}
    cells = [one for one in neurons if kind_of(one) in OF_NORSE]
    given = lambda one, args, kwargs: (((*args, *kwargs.values())[0], states.get(one)), {})
    hooks = [cell.register_forward_pre_hook(given, with_kwargs=True) for cell in cells]
    return hooks + [cell.register_forward_hook(lambda one, _, out: states.update({one: out[1]})) for cell in cells]


def timestep_ms(module):
    """The timestep of the neurons, or the usual one of a tool whose neurons have none."""
    steps = {part.dt for part in parts_of(module) if kind_of(part) in NEURONS and hasattr(part, "dt")}
    if len(steps) > 1:
        raise refusal(f"the cells have different timesteps: dt is {', '.join(map(str, sorted(steps)))}", "train all with the same dt")
    usual = [TIMESTEP_MS[package_of(part)] for part in parts_of(module) if package_of(part) in TIMESTEP_MS]
    return 1e3 * steps.pop() if steps else (usual or [TIMESTEP_MS["snntorch"]])[0]


def network_of(module, sample, name="network", dt_ms=None, reset=None, output=None, check=None, **options):
    """A module with neurons of one of the tools as a network, which spikes as the module does.

    `output` names the layer that decides, by default the first that forward() returns. `check` are spikes `[samples, channels.., T]` on
    which the network is compared with the module, beyond the random ones, or a pair of them and the recorded output.
    """
    import torch

    dt_ms = timestep_ms(module) if dt_ms is None else dt_ms
    check, recorded = check if isinstance(check, tuple) else (check, None)
    layout = layout_of(leaves(module))
    traced = copied(module)
    dtype = torch.float64 if any(one.dtype == torch.float64 for _, one in traced.named_parameters()) else torch.float32
    traced, shape = traced.to(dtype), tuple(sample.shape[1:])
    shown = [drawn(shape)] if check is None else [drawn(shape), checked(check, shape)]
    hooks = casting(traced, dtype)
    with listed(traced):
        by_potential = options.get("decision") not in (None, "Spikes")
        cleared(traced, len(sample))
        trace = Trace(traced, sample.detach().cpu().to(dtype), dt_ms / 1e3, layout, output, by_potential)
    for hook in hooks:
        hook.remove()
    own, held = resets(trace)
    given = {"reset": reset} if reset else {}
    said = "; ".join(f"{what} of {given.shape[-1]} steps" for what, given in zip((f"{SAMPLES} random samples", f"{len(shown[-1])} of check="), shown))
    note = f"spikes in real numbers as the module does on {said}" + ("" if check is not None else "; check=array compares on others")
    notes = [note, *training(module)]
    network = _nsim.from_nodes(name, trace.nodes, trace.edges, held, notes, dt_ms=dt_ms, **{**own, **given, **options})
    with listed(traced):
        for given in shown:
            compare(network, traced, trace, given, layout)
    if recorded is not None:
        differing, said = _nsim.check_recording(network, shown[-1], recording(recorded))
        if differing:
            raise refusal(said, "record the output of the same module, on the same spikes", "check.differs")
    return network


def recording(spikes):
    """Recorded spikes of the output, `[samples, neurons, T]` or `[neurons, T]`: the steps and the (step, neuron) of each sample."""
    spikes = np.asarray(spikes.detach().cpu() if hasattr(spikes, "detach") else spikes) != 0
    spikes = spikes if spikes.ndim > 2 else spikes[None]
    return [(one.shape[-1], list(map(tuple, np.argwhere(one.reshape(-1, one.shape[-1]).T).tolist()))) for one in spikes]


def training(module):
    """A note on the modules that behave differently in training."""
    differ = [(name, kind_of(part)) for name, part in module.named_modules() if part.training]
    named = [f"'{name}' ({kind})" for name, kind in differ if "Dropout" in kind or kind.startswith("BatchNorm")]
    return [f"these modules are in training mode, but are read as after net.eval(): {', '.join(named)}"] if named else []


def drawn(shape):
    """Random spikes, `[samples, channels.., T]`."""
    rates = np.linspace(0.1, 0.7, SAMPLES).reshape(-1, *[1] * (len(shape) + 1))
    return (np.random.default_rng(SEED).random((SAMPLES, *shape, STEPS)) < rates).astype(np.uint8)


def checked(check, shape):
    """Spikes of a caller, `[samples, channels.., T]`."""
    array = np.asarray(check.detach().cpu().to_dense().float() if hasattr(check, "detach") else check)
    if array.ndim != len(shape) + 2 or array.shape[1:-1] != shape or not array.size:
        empty = "" if array.size else " and is empty"
        raise refusal(f"check has shape {list(array.shape)}{empty}", f"give spikes [samples, {', '.join(map(str, shape))}, T]", "input.shape")
    if not np.isin(array, (0, 1)).all():
        raise refusal("check holds numbers other than 0 and 1", "give check=array > 0", "input.value")
    return array.astype(np.uint8)


def spikes_of(module, neurons, given, layout):
    """Spikes `[samples, units, steps]` of the neurons of a module on spikes `[samples, channels.., steps]`."""
    import torch

    samples, spikes = len(given), {node: [] for node in neurons.values()}

    def keep(one, _, out):
        spikes[neurons[one]].append(by_sample(out[0] if isinstance(out, tuple) else out, layout, samples) != 0)

    hooks = casting(module, torch.float64) + remembering(neurons) + [part.register_forward_hook(keep) for part in neurons]
    calls = [given[..., step : step + 1] for step in range(given.shape[-1])] if layout == "steps" else [given]
    cleared(module, samples)
    with torch.no_grad():
        for call in calls:
            called(module, arranged(torch.from_numpy(call).double(), layout))
    for hook in hooks:
        hook.remove()
    return {node: torch.cat(parts, dim=2).numpy() for node, parts in spikes.items()}


def in_double(function, *args):
    return function(*args).double()


def compare(network, module, trace, given, layout):
    """Refuses a network whose spikes in real numbers differ from the module's on spikes `[samples, channels.., T]`."""
    import torch

    samples, steps = len(given), given.shape[-1]
    module = module.double()
    for part in [part for part in trace.neurons if kind_of(part) == "LIFTorch"]:
        # Rockpool's spikes have single precision always, also where they meet recurrent weights.
        part.spike_generation_fn = functools.partial(in_double, part.spike_generation_fn)
    with torch.no_grad():
        for _, tensor in (*module.named_parameters(), *module.named_buffers()):
            if tensor.is_floating_point():
                tensor.copy_(torch.from_numpy(np.asarray(reals(tensor.float()))))
    # All neurons run, as those of Norse continue from their states.
    found = spikes_of(module, trace.neurons, given, layout)
    spiking = {one: node for one, node in trace.neurons.items() if not is_head(one)}
    # Spikes need one step per layer, so steps of silence follow.
    silence = np.zeros((*given.shape[:-1], len(trace.neurons)), np.uint8)
    ours = dict(_nsim.real_spikes(network, np.concatenate([given, silence], axis=-1)))
    for module, node in spiking.items():
        theirs = found[node]
        mine = np.zeros_like(theirs)
        rows = ours[node][ours[node][:, 1] < steps]
        mine[rows[:, 0], rows[:, 2], rows[:, 1]] = True
        differing, all_of = int((theirs != mine).sum()), int(theirs.sum() + mine.sum())
        if differing > ROUNDED * all_of:
            message = f"'{trace.names[module]}' ({kind_of(module)}) spikes {int(theirs.sum())} times in PyTorch and {int(mine.sum())} " \
                f"times in nsim, with {differing} differences, in {samples} samples of {steps} steps: the network was read wrongly"
            raise refusal(message, f"its forward() may reset neurons in each call, or depend on the batch, on numbers or on time: {ONE_STEP}")
