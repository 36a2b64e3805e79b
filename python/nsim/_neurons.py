"""Neurons of each tool: the equations of a step, the test of the threshold, the reset, and where a tool has the axis of time.

Sources: snnTorch 1.0.0, Norse 1.1.0, spikingjelly 2.0.0, sinabs 3.1.3 and Rockpool 3.1.0. A value that no neuron of nsim has is refused
by its name.
"""

import dataclasses
from typing import Any, Optional

import numpy as np

from . import _nsim

TOOLS = {"snntorch": "snnTorch", "norse": "Norse", "spikingjelly": "spikingjelly", "sinabs": "sinabs", "rockpool": "Rockpool"}
"""Packages whose neurons are read."""

OF_SNNTORCH = {"Lapicque", "Leaky", "Synaptic", "RLeaky", "RSynaptic"}

OF_NORSE = {"LIFCell", "LIFRecurrentCell", "LIFBoxCell", "IAFCell", "LICell", "LIBoxCell"}

OF_SPIKINGJELLY = {"IFNode", "LIFNode", "ParametricLIFNode", "CUBALIFNode"}

OF_SINABS = {f"sinabs.{kind}{form}" for kind in ("IAF", "LIF", "ExpLeak") for form in ("", "Squeeze")}

OF_ROCKPOOL = {"LIFTorch", "ExpSynTorch"}

OF_POTENTIAL = {"LICell", "LIBoxCell", "sinabs.ExpLeak", "sinabs.ExpLeakSqueeze", "ExpSynTorch"}
"""Neurons that never spike: they return their potential."""

NEURONS = OF_SNNTORCH | OF_NORSE | OF_SPIKINGJELLY | OF_SINABS | OF_ROCKPOOL

TIMESTEP_MS = {"snntorch": 0.1, "spikingjelly": 0.1, "sinabs": 1.0}
"""Timesteps of modules that have none: of the tools' own exporters, and of sinabs's examples, whose time constants count steps."""

ENDLESS = 2.0**52
"""Steps of a time constant without decay."""

PATCHED = "TorchModulePatch"
"""Class that Rockpool puts before the class of a module of torch."""


def refusal(message, help, code="import.torch"):
    """The exception for an unsupported module or value, with its remedy."""
    error = _nsim.Error(f"{message}\n  help: {help}")
    error.code, error.place, error.help = code, None, help
    error.reasons = [{"code": code, "message": message, "place": None, "help": help}]
    return error


def package_of(module):
    return type(module).__module__.split(".")[0]


def kind_of(module):
    """The name of a module's class, with its package's name if it is not of torch or one of the tools."""
    kind = type(module)
    if hasattr(module, "parametrizations") or kind.__name__ == PATCHED:
        kind = kind.__mro__[1]
    place = kind.__module__
    if place.startswith("sinabs."):
        return f"sinabs.{kind.__name__}"
    ours = place.split(".")[0] in ("torch", "snntorch", "norse", "rockpool") or place.startswith("spikingjelly.activation_based.")
    return kind.__name__ if ours else f"{place}.{kind.__name__}"


def parts_of(module):
    """All modules of a module; Rockpool replaces `modules()`."""
    return [part for _, part in module.named_modules()]


def reals(tensor, shape=None):
    """Numbers of a tensor; single precision becomes its shortest decimals, as in files."""
    array = tensor.detach().cpu().numpy()
    array = array.astype(str).astype(np.float64) if array.dtype == np.float32 else array.astype(np.float64)
    return array if shape is None else np.broadcast_to(array, shape).copy()


def torch_of(value):
    """A number or tensor as a tensor."""
    import torch

    return torch.as_tensor(value)


def is_head(module):
    """Whether only the potential of neurons is read: without a reset, snnTorch's neurons never return from a spike."""
    return kind_of(module) in OF_POTENTIAL or getattr(module, "reset_mechanism", None) == "none"


@dataclasses.dataclass
class Rule:
    """A step of neurons: `i <- (1 - alpha) i + w x`, `v <- (1 - beta) v + gain i + bias`; without `alpha` i is x."""

    beta: Any
    gain: Any = 1.0
    threshold: Any = None
    alpha: Any = None
    w: Any = 1.0
    bias: Any = 0.0
    reset: Optional[str] = "zero"
    """'zero' or 'subtract'."""
    later: bool = False
    """Whether the reset takes effect in the step after the spike."""
    inclusive: bool = True
    """Whether a potential that equals the threshold spikes."""

    def node(self, shape, dt):
        """The node of NIR that has these equations in steps of `dt` seconds; without a threshold it never spikes."""
        full = lambda value: np.broadcast_to(np.asarray(value, np.float64), shape).copy()
        steps = lambda share: np.where(share > 0, 1 / np.maximum(share, 1 / ENDLESS), ENDLESS)
        beta = full(self.beta)
        mem = steps(beta)
        # NIR multiplies what it adds to v by the share that a step removes.
        node = {"r": mem * self.gain, "v_leak": mem * self.bias}
        kind = "LI" if self.threshold is None else "LIF"
        if self.threshold is not None:
            node["v_threshold"] = full(self.threshold)
        if self.alpha is None:
            return {"type": kind, "tau": mem * dt, **node}
        syn = steps(full(self.alpha))
        return {"type": f"Cuba{kind}", "tau_syn": syn * dt, "w_in": syn * self.w, "tau_mem": mem * dt, **node}


def rule(module, shape, name):
    """The rule of a layer of neurons; shares of decay outside 0 to 1 are refused."""
    kind = kind_of(module)
    for kinds, read in READERS:
        if kind in kinds:
            found = read(module, shape, f"'{name}' ({kind})")
    for state, share in (("current", found.alpha), ("voltage", found.beta)):
        if share is not None and not np.all((np.asarray(share) >= 0) & (np.asarray(share) <= 1)):
            message = f"'{name}' ({kind}): a step removes {np.max(share):.4g} of its {state}, which is outside 0 to 1"
            raise refusal(message, "train with time constants above 0, and a decay that leaves from 0 to all of the state in a step")
    return found


def snntorch(module, shape, who):
    taken = {key: 1 - np.clip(reals(getattr(module, key), shape), 0, 1) for key in ("alpha", "beta") if hasattr(module, key)}
    gain = 1.0
    if kind_of(module) == "Lapicque":
        step, resistance, capacity = (reals(getattr(module, key), shape) for key in ("time_step", "R", "C"))
        taken["beta"], gain = step / (resistance * capacity), step / capacity
        if np.any((taken["beta"] < 0) | (taken["beta"] > 1)):
            message = f"{who}: a step removes time_step / (R C) = {taken['beta'].max():.4g} of the voltage, which is outside 0 to 1"
            raise refusal(message, "give R C of at least time_step, or, with beta only, a beta of at least 0.3679")
    threshold = None if is_head(module) else reals(module.threshold, shape)
    later = getattr(module, "reset_delay", True)
    return Rule(**taken, gain=gain, threshold=threshold, reset=module.reset_mechanism, later=later, inclusive=False)


def norse(module, shape, who):
    """`v <- v + dt tau_mem_inv (v_leak - v + i)` and `i <- i - dt tau_syn_inv i`; a network counts v from v_leak."""
    given = module.p
    how = getattr(getattr(given, "reset_method", None), "__name__", "reset_value")
    if how not in ("reset_value", "reset_subtract"):
        raise refusal(f"{who}: reset_method is {how}", "train with reset_value, or with reset_subtract")
    rest, reset = (reals(torch_of(getattr(given, key, 0.0)), shape) for key in ("v_leak", "v_reset"))
    if how == "reset_subtract" or is_head(module):
        reset = np.zeros(shape)
    if np.any(rest != reset):
        key, value = ("v_leak", rest) if np.any(rest != 0) else ("v_reset", reset)
        wrong = value[rest != reset].max()
        raise refusal(f"{who}: {key} is {wrong:g}, but a neuron resets to the potential at which it rests", "train with v_leak and v_reset 0, or equal")
    taken = {}
    for state, key in (("alpha", "tau_syn_inv"), ("beta", "tau_mem_inv")):
        if hasattr(given, key):
            taken[state] = module.dt * reals(torch_of(getattr(given, key)), shape)
            if np.any((taken[state] < 0) | (taken[state] > 1)):
                message = f"{who}: a step removes dt {key} = {taken[state].max():.4g} of its state, which is outside 0 to 1"
                raise refusal(message, f"train with {key} of at most 1 / dt = {1 / module.dt:g}")
    # A current is multiplied by the share of the voltage that a step removes; without decay by 1.
    beta = taken.setdefault("beta", np.zeros(shape))
    threshold = None if is_head(module) else reals(torch_of(given.v_th), shape) - rest
    reset = "zero" if how == "reset_value" else "subtract"
    return Rule(**taken, gain=np.where(beta > 0, beta, 1.0), threshold=threshold, reset=reset, inclusive=False)


def spikingjelly(module, shape, who):
    """`v <- v - (v - v_reset) / tau + x`, where `decay_input` divides x, too; a network counts v from v_reset."""
    if not getattr(module.surrogate_function, "spiking", True):
        raise refusal(f"{who}: its surrogate function has spiking=False", "set it to True: module.surrogate_function.set_spiking_mode(True)")
    rest = module.v_reset or 0.0
    own = dict(threshold=module.v_threshold - rest, reset="subtract" if module.v_reset is None else "zero")
    if own["threshold"] <= 0:
        message = f"{who}: v_threshold is {module.v_threshold:g} and v_reset {rest:g}, and only a threshold above v_reset is supported"
        raise refusal(message, "train with v_threshold above v_reset")
    kind = kind_of(module)
    if kind == "IFNode":
        return Rule(beta=0.0, **own)
    if kind == "CUBALIFNode":
        if rest:
            raise refusal(f"{who}: v_reset is {rest:g}, but its voltage decays to 0", "train with v_reset=0.0, or with None, which subtracts")
        return Rule(alpha=1 - module.c_decay, beta=1 - module.v_decay, **own)
    share = 1 / module.tau if kind == "LIFNode" else 1 / (1 + np.exp(-reals(module.w)))
    return Rule(beta=share, gain=share if module.decay_input else 1.0, **own)


def sinabs(module, shape, who):
    """`i <- a (i + x)`, `v <- b v + i`, where `norm_input` multiplies i with 1 - b; a and b are exp(-1 / tau)."""
    if module.min_v_mem is not None:
        message = f"{who}: min_v_mem is {reals(module.min_v_mem).min():g}, and a neuron of nsim has no lower bound"
        raise refusal(message, "train with min_v_mem=None")
    kept = {}
    for state in ("mem", "syn"):
        if module.train_alphas:
            own = getattr(module, f"alpha_{state}")
            kept[state] = None if own is None else reals(own, shape)
        else:
            own = getattr(module, f"tau_{state}")
            kept[state] = None if own is None else np.exp(-1 / reals(own, shape))
    # IAF has no tau_mem.
    mem = np.ones(shape) if kept["mem"] is None else kept["mem"]
    current = {} if kept["syn"] is None else {"alpha": 1 - kept["syn"], "w": kept["syn"]}
    found = Rule(beta=1 - mem, gain=1 - mem if module.norm_input else 1.0, **current)
    if is_head(module):
        return found
    spikes = module.spike_fn
    of = getattr(spikes, "__name__", type(spikes).__name__)
    if of != "SingleSpike" and getattr(spikes, "max_num_spikes_per_bin", None) != 1:
        most = getattr(spikes, "max_num_spikes_per_bin", "any number of")
        message = f"{who}: spike_fn is {of}, which sends {most} spikes in a step, but a core sends one"
        raise refusal(message, "train with spike_fn=sinabs.activation.SingleSpike, and read its spikes")
    found.threshold, how = reals(module.spike_threshold, shape), module.reset_fn
    value = getattr(how, "reset_value", getattr(how, "subtract_value", None))
    found.reset = {"MembraneReset": "zero", "MembraneSubtract": "subtract"}.get(type(how).__name__)
    usual = [0] if found.reset == "zero" else [None]
    if found.reset is None or (value not in usual and not (found.reset == "subtract" and np.all(found.threshold == value))):
        raise refusal(f"{who}: reset_fn is {how}", "train with MembraneReset(), which sets v to 0, or MembraneSubtract(), which subtracts the threshold")
    return found


def rockpool(module, shape, who):
    """`i <- b (i + x + recurrent)`, `v <- a v + i + bias`, with a and b of `leak_mode`; a spike subtracts the threshold."""
    if float(module.noise_std) != 0:
        raise refusal(f"{who}: noise_std is {float(module.noise_std):g}", "read the network without noise: module.noise_std = 0")
    if kind_of(module) == "ExpSynTorch":
        kept = np.exp(-module.dt / reals(module.tau, shape))
        return Rule(beta=1 - kept, gain=kept)
    if module.size_in != module.size_out:
        raise refusal(f"{who}: its shape is ({module.size_in}, {module.size_out}), and a compartment has one current", "train with one synapse a neuron")
    if float(module.max_spikes_per_dt) != 1:
        message = f"{who}: max_spikes_per_dt is {float(module.max_spikes_per_dt):g}, but a core sends one spike in a step"
        raise refusal(message, "train with max_spikes_per_dt=1")
    kept = []
    for tau, decay, dash in (("tau_mem", "alpha", "dash_mem"), ("tau_syn", "beta", "dash_syn")):
        key = {"taus": tau, "decays": decay, "bitshifts": dash}[module.leak_mode]
        own = reals(getattr(module, key)).reshape(-1)
        own = np.exp(-module.dt / own) if key == tau else 1 - 0.5**own if key == dash else own
        kept.append(np.broadcast_to(own, shape))
    mem, syn = kept
    threshold, bias = (reals(getattr(module, key), shape) for key in ("threshold", "bias"))
    return Rule(beta=1 - mem, alpha=1 - syn, w=syn, threshold=threshold, bias=bias, reset="subtract")


READERS = [(OF_SNNTORCH, snntorch), (OF_NORSE, norse), (OF_SPIKINGJELLY, spikingjelly), (OF_SINABS, sinabs), (OF_ROCKPOOL, rockpool)]
"""Kinds of neurons, and the function that reads their rule."""


def layout_of(names):
    """Where neurons have the axis of time: 'steps' (a call a step), 'first', 'second', or 'rows' of all samples' steps."""
    found = {}
    for module, name in names.items():
        kind = kind_of(module)
        if kind in OF_SPIKINGJELLY:
            found.setdefault("first" if module.step_mode == "m" else "steps", f"'{name}' ({kind}, step_mode={module.step_mode!r})")
        elif kind in NEURONS:
            whole = kind in OF_SINABS | OF_ROCKPOOL
            found.setdefault("rows" if kind.endswith("Squeeze") else "second" if whole else "steps", f"'{name}' ({kind})")
    if len(found) > 1:
        places = {"steps": "no axis of time", "first": "time as its first axis", "second": "time as its second axis", "rows": "time in its rows"}
        message = ", but ".join(f"{who} takes {places[layout]}" for layout, who in found.items())
        raise refusal(message, "give all neurons one form: functional.set_step_mode(net, 'm') of spikingjelly, or all with Squeeze of sinabs")
    return next(iter(found), "steps")


def arranged(given, layout):
    """A tensor `[samples, channels.., steps]` as modules of a layout take it; 'steps' has a step in each tensor."""
    import torch

    if layout == "first":
        return torch.movedim(given, -1, 0)
    given = torch.movedim(given, -1, 1)
    return given if layout == "second" else given.flatten(0, 1)


def by_sample(out, layout, samples):
    """The result of a layer as `[samples, units, steps]`."""
    if layout == "first":
        return out.reshape(len(out), samples, -1).permute(1, 2, 0)
    steps = out.shape[1] if layout == "second" else len(out) // samples
    return out.reshape(samples, steps, -1).permute(0, 2, 1)


def cleared(module, samples=1):
    """Clears the states of all neurons, and prepares them for a number of samples."""
    import torch

    for part in parts_of(module):
        for state in ("mem", "syn", "spk") if package_of(part) != "sinabs" else ("v_mem", "i_syn"):
            if isinstance(getattr(part, state, None), torch.Tensor):
                setattr(part, state, torch.zeros(0))
        if package_of(part) == "spikingjelly" and hasattr(part, "reset"):
            part.reset()
        if kind_of(part) in OF_ROCKPOOL:
            # In the precision of the module, which `reset_state` loses.
            for state in part.state().values():
                state.data.zero_()
        if kind_of(part) in OF_SINABS and kind_of(part).endswith("Squeeze"):
            part.batch_size, part.num_timesteps = samples, -1
