"""A discretised model of nengo-loihi as a network of nsim.

Input: a `nengo_loihi.builder.Model` whose blocks have integers. Output: an `nsim.Network`, in which blocks are populations, SpikeInputs are
inputs, and the synapses between a source and a group of axons are a projection; and the synapses that learn. Nothing is rounded: every
integer is the tool's, so spikes, u and v are equal bit for bit. Errors: `nengo.not-served` for what nsim can't compute exactly.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse
from nengo_loihi.inputs import SpikeInput

import nsim

from .._neurons import refusal

UNIT = 64
"""Least amount that a static synapse adds to a compartment's sum."""

LEAST_V = 1 - 2**23
"""Least v of 24 bits; the tool's may be lower."""

WEIGHTS = {"Mixed": (-256, 254, 2), "Excitatory": (0, 255, 1), "Inhibitory": (-255, 0, 1)}
"""Least and greatest weight of 8 bits and their step, by sign."""


def not_served(whose, feature, help):
    """The exception for a feature of a block or input that nsim can't compute exactly."""
    return refusal(f"{whose}: {feature}", help, "nengo.not-served")


def unique_names(things):
    """A name for each block or input, from its label: `<Ensemble 'a'>` is `a`. A label without a name loses its address."""
    names = {}
    for thing in things:
        kind = type(thing).__name__
        text = re.sub(r"""<\w+ (['"])(.*?)\1>""", r"\2", thing.label or kind)
        text = re.sub(r"\(unlabeled\) at 0x[0-9a-f]+", "", text)
        text = re.sub(r"[^\w()\[\],+*-]+", "-", text).strip("-") or kind
        same = sum(re.fullmatch(re.escape(text) + r"(~\d+)?", name) is not None for name in names.values())
        names[thing] = f"{text}~{same + 1}" if same else text
    return names


def population(block, name):
    """A block as a population of `nsim.Network`."""
    compartment, whose = block.compartment, f"block '{name}'"
    refractory, vth = np.asarray(compartment.refract_delay), np.asarray(compartment.vth).astype(np.int64)
    if refractory.max() > 255:
        raise not_served(whose, f"a refractory period of {refractory.max()} timesteps", "at most 255 are supported: reduce tau_ref")
    bias = np.asarray(compartment.bias).astype(np.int64)
    mantissa, exponent = bias, np.zeros_like(bias)
    while (is_large := np.abs(mantissa) > 4095).any():
        mantissa, exponent = np.where(is_large, mantissa // 2, mantissa), exponent + is_large
    vmin, vmax = (int(np.log2(float(size) + 1)) for size in (-compartment.vmin, compartment.vmax))
    exact = {"vth": vth // UNIT * UNIT, "bias": mantissa << exponent, "vmin": 1 - 2**vmin, "vmax": 2 ** (9 + (vmax - 9) // 2 * 2) - 1}
    for parameter, value in exact.items():
        if np.any(value != getattr(compartment, parameter)):
            raise not_served(whose, f"a {parameter} that the chip's registers lack", "leave it to the tool's discretize_model")
    return {
        "name": name,
        "shape": block.n_neurons,
        "du": np.asarray(compartment.decay_u) + 1,
        "dv": np.asarray(compartment.decay_v),
        "vth_mant": vth // UNIT,
        "bias_mant": mantissa,
        "bias_exp": exponent,
        "refractory": refractory,
        "vmin_exp": min(vmin, 23),
        "vmax_exp": (vmax - 9) // 2,
    }


def units_of(axon, size):
    """Units of a source of this size that have an axon of the group: units, axons, atoms."""
    axons = np.arange(size) if axon.compartment_map is None else np.asarray(axon.compartment_map)
    atoms = np.zeros_like(axons) if axon.compartment_atoms is None else np.asarray(axon.compartment_atoms)
    units = np.flatnonzero((axons >= 0) & (axons < axon.target.n_axons))
    return units, axons[units], atoms[units]


def synapses_of(axon, size):
    """Synapses of a group of axons: sources, targets, and weights as the tool adds them to q."""
    sources, targets, weights = [], [], []
    for unit, number, atom in zip(*units_of(axon, size)):
        base = axon.target.axon_compartment_base(number)
        if base is None:
            continue
        row, indices = axon.target.axon_weights_indices(number, atom=atom)
        if len(np.unique(indices)) < len(indices):
            # The tool adds only the last weight of an axon to a compartment.
            last = len(indices) - 1 - np.unique(indices[::-1], return_index=True)[1]
            row, indices = row[last], indices[last]
        sources.append(np.full(len(row), unit))
        targets.append(base + indices)
        weights.append(row)
    return [np.concatenate(part).astype(np.int64) if part else np.zeros(0, np.int64) for part in (sources, targets, weights)]


def projection(names, sources, targets, weights, synapse):
    """A projection of `nsim.Network`; names, and sizes, are of its ends. It is dense where each pair has a synapse."""
    (source, size), (target, units) = names
    whose, exponent = f"block '{target}', synapses from {source}", synapse.synapse_cfg.weight_exp
    # 2^-6 of UNIT, in which the tool stores weights, to integers of the format.
    scaled = weights >> 6 + exponent if exponent >= -6 else weights << -6 - exponent
    if (weights % (UNIT if exponent < 0 and not synapse.learning else 2 ** max(6 + exponent, 0))).any():
        raise not_served(whose, f"weights finer than their weight_exp of {exponent}", "leave them to the tool's discretize_model")
    fits = [sign for sign, (low, high, step) in WEIGHTS.items() if ((low <= scaled) & (scaled <= high) & (scaled % step == 0)).all()]
    if not fits:
        raise not_served(whose, "weights that don't fit 8 bits", "leave them to the tool's discretize_model")
    matrix = scipy.sparse.coo_matrix((scaled, (targets, sources)), shape=(units, size))
    is_full = len(weights) == units * size and not synapse.learning
    return {"from": source, "to": target, "weights": matrix.toarray() if is_full else matrix, "weight_exp": exponent, "sign": fits[0]}


@dataclass
class Learner:
    """Synapses that learn by PES. Their sources are the units of all `sources`, numbered in sequence."""

    synapse: Any
    block: Any
    projection: str
    signal: str
    """Population of the error, of half as many channels as there are targets."""
    sources: list
    """(block or SpikeInput, number of its first unit among the sources)."""
    axons: np.ndarray
    """Axon of each source, or -1."""
    weights: np.ndarray
    """`[axons, targets]`, in units of 2^-6 of `UNIT`; the tool's synapse has views of its rows."""
    used: Any
    """Axons of the sources that have one, as an index: all is a slice, which is faster."""
    noted: np.ndarray
    """Whether a spike of each source arrived since traces changed, where `can_lose`."""

    @cached_property
    def exponent(self):
        """A weight is an integer of nsim times 2^exponent."""
        return self.synapse.synapse_cfg.real_weight_exp

    @cached_property
    def is_fine(self):
        """Whether learned weights aren't multiples of `UNIT`."""
        return self.exponent + self.synapse.synapse_cfg.shift_bits < 6

    @cached_property
    def can_lose(self):
        """Whether a source may spike in two timesteps in a row, of which a trace counts one."""
        return not all(rests(source) for source, _ in self.sources)

    @cached_property
    def no_error(self):
        """An error of 0 for each channel of the signal."""
        return np.zeros(self.weights.shape[1] // 2, np.int32)

    def take_weights(self, learned):
        """Sets the weights from integers of nsim, by source and target."""
        rows = learned.reshape(-1, self.weights.shape[1])
        self.weights[self.used] = rows << self.exponent


def rests(source):
    """Whether a block or SpikeInput never spikes in two timesteps in a row."""
    if isinstance(source, SpikeInput):
        return False
    compartment = source.compartment
    return np.min(compartment.refract_delay) >= 2 and np.min(compartment.vth) >= 0


def learner(synapse, block, name, sent, counted):
    """Synapses of a block that learn, and their projection; `sent` are (block or SpikeInput, its name, axons)."""
    whose, targets = f"block '{name}'", block.n_neurons
    firsts = np.cumsum([0] + [source.n_neurons for source, _, _ in sent])
    axons = np.full(firsts[-1], -1)
    for first, (source, _, axon) in zip(firsts, sent):
        units, numbers, _ = units_of(axon, source.n_neurons)
        axons[first + units] = numbers
    used = axons[axons >= 0]
    is_plain = synapse.axon_to_weight_map is None and synapse.axon_compartment_bases is None
    is_whole = all(np.array_equal(indices, [np.arange(targets)]) for indices in synapse.indices)
    if not (is_plain and is_whole and len(set(used)) == len(used) > 0 and len({source for source, _, _ in sent}) == len(sent)):
        raise not_served(whose, "learning synapses that share weights, axons or targets", "connect whole ensembles with PES")
    if any(source in counted for source, _, _ in sent):
        raise not_served(whose, "PES from an input whose channels spike twice in a timestep", "give each spike once")
    if (synapse._lr_int, synapse._lr_exp, synapse.learn_epoch, targets % 2) != (1, -7, 4, 0) or synapse.synapse_cfg.real_weight_exp < 0:
        raise not_served(whose, "PES with other settings than the tool's builder makes", "use nengo.PES, with a greater pes_wgt_exp")
    weights = np.concatenate(synapse.weights)
    synapse.weights = list(weights[:, None, :])
    sources = [(source, first) for first, (source, _, _) in zip(firsts, sent)]
    index = slice(None) if np.array_equal(used, np.arange(len(weights))) else used
    found = Learner(synapse, block, f"{name}~PES", f"{name}~error", sources, axons, weights, index, np.zeros(len(axons), bool))
    ends = ([source for _, source, _ in sent], len(axons)), (name, targets)
    rows, columns = np.repeat(np.flatnonzero(axons >= 0), targets), np.tile(np.arange(targets), len(used))
    fields = projection(ends, rows, columns, weights[used].ravel().astype(np.int64), synapse)
    x1 = (float(synapse.tracing_mag), float(synapse.tracing_tau))
    return found, {**fields, "sign": "Mixed", "name": found.projection, "learning": nsim.Pes(found.signal, x1=x1)}


def translate(model, names, counted):
    """The network of a model, and its `Learner`s. Channels of SpikeInputs in `counted` may spike several times in a step."""
    blocks, inputs = list(model.blocks), list(model.inputs)
    populations, projections, learners = [], [], []
    for source in inputs:
        if not isinstance(source, SpikeInput):
            raise not_served(f"input '{names[source]}'", f"inputs of type {type(source).__name__}", "use a SpikeInput")
        width = {"message_bits": 16} if source in counted else {}
        populations.append({"name": names[source], "shape": source.n_neurons, "kind": "Input", **width})
    populations += [population(block, names[block]) for block in blocks]
    sent = {synapse: [] for block in blocks for synapse in block.synapses}
    for source in inputs + blocks:
        for axon in source.axons:
            sent[axon.target].append((source, names[source], axon))
    for block, synapse in [(block, synapse) for block in blocks for synapse in block.synapses]:
        if synapse.learning:
            found, fields = learner(synapse, block, names[block], sent[synapse], counted)
            learners.append(found)
            projections.append(fields)
            populations.append({"name": found.signal, "shape": block.n_neurons // 2, "kind": "Signal"})
            continue
        for source, name, axon in sent[synapse]:
            synapses = synapses_of(axon, source.n_neurons)
            if len(synapses[0]):
                ends = (name, source.n_neurons), (names[block], block.n_neurons)
                projections.append(projection(ends, *synapses, synapse))
    semantics = {"learning_semantics": "Nengo"} if learners else {}
    output = names[blocks[-1]]
    return nsim.Network("nengo", populations, projections, output=output, timestep_ms=1000 * model.dt, **semantics), learners
