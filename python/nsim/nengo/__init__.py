"""nengo-loihi's networks on nsim: scripts run unchanged, with the spikes, u, v and probes of nengo-loihi's own emulator, bit for bit.

>>> import nengo, nsim.nengo
>>> with nsim.nengo.Simulator(network, board="nahuku-32") as sim:
...     sim.run(1.0)
...     print(sim.data[probe], sim.mapping.cores, sim.energy().energy_uj)

`install()`, or `python -m nsim.nengo script.py`, does it for scripts that use `nengo_loihi.Simulator`. Where a network can't be computed
exactly, an `nsim.Error` names the block and the feature (`nengo.not-served`). Only blocks of real numbers, which nengo-loihi didn't
discretise (`target="simreal"`), run on its own emulator, with a warning that names them.
"""

import warnings

import numpy as np

import nsim

from .._neurons import refusal

try:
    import nengo_loihi
    import nengo_loihi.emulator
    import nengo_loihi.simulator
except (ImportError, AttributeError) as error:
    # NumPy of other versions lacks attributes that it uses.
    message = f"nsim.nengo needs nengo-loihi: {error}"
    help = "on Python 3.8 to 3.11: pip install nengo-loihi==1.1.0 'nengo<4' 'numpy<1.24' 'scipy<1.12' 'setuptools<70'"
    raise refusal(message, help, "nengo.absent") from error

from nengo.exceptions import SimulationError, SimulatorClosed
from nengo_loihi.builder.discretize import scale_pes_errors
from nengo_loihi.emulator.interface import EmulatorInterface
from nengo_loihi.probe import ProbeFilter

from ._translate import LEAST_V, UNIT, not_served, translate, unique_names

__all__ = ["Emulator", "Simulator", "install"]

WORDS = {"current": "u", "voltage": "v", "spiked": "spikes", "spike_count": "spikes"}
"""What nsim calls the state that a probe reads."""

FREE = "boundless"
"""Target without limits, for a network without a board."""

MOST_STEPS = 1000
"""Timesteps of a call of nsim; several take more memory, not less time."""

NONE = np.zeros(0, np.int64)
"""No channels."""

OVERFLOWS = {"q": "Overflow in q0", "u": "Overflow in current or u2"}
"""nengo-loihi's warnings; nsim counts u and u + bias (u2) together."""


class RealEmulator(EmulatorInterface):
    """nengo-loihi's own emulator, for blocks of real numbers."""


class Compartment:
    """Reports what the chip's registers lost."""

    def __init__(self, strict):
        self.strict = strict

    def error(self, message):
        """A warning, or a SimulationError with `strict`."""
        if self.strict:
            raise SimulationError(message)
        warnings.warn(message)


def noisy(blocks):
    """Blocks with noise: (block, its compartments among all, factor, offset, register that noise is added to)."""
    found, first = [], 0
    for block in blocks:
        compartment, own = block.compartment, slice(first, first + block.n_neurons)
        first += block.n_neurons
        if np.any(compartment.enable_noise):
            factor = np.where(compartment.enable_noise, 2.0 ** (compartment.noise_exp - 7), 0)
            found.append((block, own, factor, 64 * compartment.noise_offset, "bias" if compartment.noise_at_membrane else "q"))
    return found


def weighted(probe, rows):
    """What a probe's `weight_outputs` gives for the states of its targets, each `[steps, units]`; it takes a few microseconds less."""
    if len(rows) == 1 and probe.weights[0] is not None and probe.weights[0].ndim == 2:
        # Theirs sums over targets from 0, which makes -0.0 to 0.0.
        return 0 + rows[0].dot(probe.weights[0])
    return probe.weight_outputs(rows)


class Emulator:
    """An `EmulatorInterface` of nengo-loihi on nsim.

    `model` is a `nengo_loihi.builder.Model`, `seed` that of its random numbers, and `board` a target of nsim whose limits
    hold; without one no limit holds. Attributes: `mapping`, an `nsim.Mapping`; `session`; `closed`; `t`, timesteps so far.
    Errors: `nsim.Error` as of the module and of `Network.map`.
    """

    strict = False
    """Whether an overflow is a SimulationError; else it is a warning."""

    def __new__(cls, model, seed=None, board=None):
        names = unique_names(model.blocks)
        real = [name for block, name in names.items() if block.compartment.vth.dtype == np.float32]
        if not real:
            return super().__new__(cls)
        if board is not None:
            raise not_served(f"block '{real[0]}'", f"real numbers, which {board} lacks", "leave out target='simreal', or board=")
        warnings.warn(f"blocks of real numbers run on nengo-loihi's own emulator: {', '.join(real)}", nsim.Warning)
        RealEmulator.strict = cls.strict
        return RealEmulator(model, seed=seed)

    def __init__(self, model, seed=None, board=None):
        self.closed = True
        self.seed = np.random.randint(2**31 - 1) if seed is None else seed
        self.rng = np.random.RandomState(self.seed)
        self.blocks, self.inputs, self.dt, self.t = list(model.blocks), list(model.inputs), model.dt, 0
        self.names = unique_names(self.blocks + self.inputs)
        self.counted = {source for source in self.inputs if any(len(set(spikes)) < len(spikes) for spikes in source.spikes.values())}
        self.unbounded = [block for block in self.blocks if block.compartment.vmin < LEAST_V]
        self.compartment = Compartment(self.strict)
        self.error_scale = getattr(model, "pes_error_scale", 1.0)
        with warnings.catch_warnings():
            # Their remedies, such as other weights, are not for a model that the tool has built.
            warnings.simplefilter("ignore", nsim.Warning)
            network, self.learners = translate(model, self.names, self.counted)
            self.mapping = network.map(board) if board else network.map(FREE, strategy="sequential")
            self.session = self.mapping.session(energy=None if board else False)
        self.board = board
        self.noise, self.compartments = noisy(self.blocks), sum(block.n_neurons for block in self.blocks)
        self.is_stepwise = bool(self.noise or self.learners)
        self.undrawn = 0
        """Random numbers without effect that the tool has drawn since ours were."""
        self.errors = []
        self.overflow = self.session.overflow
        self.filter = ProbeFilter(dt=self.dt)
        # Rows [steps, units] of each target of each probe.
        self.recorded = {probe: [[] for _ in probe.target] for probe in model.probes}
        self.read = {(block, probe.key) for probe in model.probes for block in probe.target}
        self.places = sorted({self.place(*read) for read in self.read} | {self.place(block, "voltage") for block in self.unbounded})
        self.populations = {block: self.session[self.names[block]] for block in self.blocks}
        self.spike_counts = {block: np.zeros(block.n_neurons, np.int32) for block, key in self.read if key == "spike_count"}
        self.closed = False

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def close(self):
        """Ends the simulation. Probes can still be read, and the energy on a board."""
        self.closed = True

    def check_open(self):
        if self.closed:
            raise SimulatorClosed("the emulator is closed")

    def clear_probes(self):
        """Does nothing: reading a probe clears it."""

    def host2chip(self, spikes, errors):
        """Takes spikes (SpikeInput, timestep, indices) and errors (synapse, timestep, vector), which replace those before.

        Every fourth timestep learns; only then its errors are scaled and clipped, with the tool's warning.
        """
        for spike_input, time, indices in spikes:
            spike_input.add_spikes(time, indices)
        self.errors = errors

    def chip2host(self, probes_receivers):
        """Sends what was recorded since the last call to receivers, with the time at which the host has it."""
        for probe, receiver in probes_receivers.items():
            rows = self.taken(probe)
            if len(rows[0]):
                for step, row in enumerate(weighted(probe, rows), self.t - len(rows[0]) + 1):
                    receiver.receive(self.dt * (step + 1), row)

    def collect_probe_output(self, probe):
        """Weighted and filtered values `[steps, size]` since the last call."""
        return self.filter(probe, weighted(probe, self.taken(probe)))

    def taken(self, probe):
        """Recorded values of each target of a probe, `[steps, units]`; they are forgotten."""
        rows = []
        for chunks, part, block in zip(self.recorded[probe], probe.slice, probe.target):
            values = chunks[0] if len(chunks) == 1 else np.concatenate(chunks or [np.zeros((0, block.n_neurons), np.int32)])
            rows.append(np.ascontiguousarray(values[:, part]))
            chunks.clear()
        return rows

    def step(self):
        """Runs one timestep."""
        self.check_open()
        spikes, inputs = {}, {}
        # In step 0 the tool has no input.
        for source in self.inputs if self.t else ():
            channels = source.spike_idxs(self.t)
            if len(channels):
                spikes[source] = np.asarray(channels, np.int64)
                inputs[self.names[source]] = self.input_of(source, spikes[source])
        if self.is_stepwise:
            self.set_added(spikes)
        self.session.step(inputs)
        self.t += 1
        self.record({read: self.state(*read)[None] for read in self.read})
        for block in self.unbounded:
            self.check_v(block, self.populations[block].v)
        self.update()

    def run_steps(self, steps):
        """Runs timesteps: many in a call of nsim, unless random numbers or errors enter each of them."""
        if self.is_stepwise or steps == 1:
            for _ in range(steps):
                self.step()
            return
        for first in range(0, steps, MOST_STEPS):
            self.advance(min(MOST_STEPS, steps - first))

    def advance(self, steps):
        """Runs timesteps in one call of nsim."""
        self.check_open()
        inputs = {self.names[source]: self.inputs_of(source, steps) for source in self.inputs}
        run = self.session.run(inputs, steps=steps, probes=self.places)
        self.t += steps
        rows = {(block, key): run[self.place(block, key)] for block, key in self.read}
        for block, key in self.read:
            if key == "spiked":
                rows[block, key] = rows[block, key].astype(bool)
            if key == "spike_count":
                rows[block, key] = self.spike_counts[block] + np.cumsum(rows[block, key], axis=0, dtype=np.int32)
                self.spike_counts[block] = rows[block, key][-1]
        self.record(rows)
        for block in self.unbounded:
            self.check_v(block, run[self.place(block, "voltage")])
        self.update()

    def place(self, block, key):
        """What nsim calls the state of a block that a probe reads."""
        return f"{self.names[block]}.{WORDS[key]}"

    def state(self, block, key):
        """State of a block after the last timestep, `[units]`; of `spike_count` it is asked once a timestep."""
        population = self.populations[block]
        if key == "current":
            return population.u
        if key == "voltage":
            return population.v
        if key == "spike_count":
            self.spike_counts[block] = self.spike_counts[block].copy()
            self.spike_counts[block][population.spikes] += 1
            return self.spike_counts[block]
        spiked = np.zeros(block.n_neurons, bool)
        spiked[population.spikes] = True
        return spiked

    def input_of(self, source, channels):
        """Spikes of a SpikeInput in a timestep as nsim takes them, from the channels that spike."""
        if source in self.counted:
            return np.bincount(channels, minlength=source.n_neurons)
        if len(set(channels.tolist())) < len(channels):
            self.refuse_repeated(source)
        return channels if len(channels) < source.n_neurons else np.ones(source.n_neurons, bool)

    def inputs_of(self, source, steps):
        """Spikes of a SpikeInput in the next timesteps as nsim takes them, `[channels, steps]`."""
        counts = np.zeros((steps, source.n_neurons), np.int32)
        for step in range(max(self.t, 1), self.t + steps):
            channels = np.asarray(source.spike_idxs(step), np.int64)
            counts[step - self.t] = np.bincount(channels, minlength=source.n_neurons)
        if source in self.counted:
            return counts.T
        if counts.max() > 1:
            self.refuse_repeated(source)
        return counts.T > 0

    def refuse_repeated(self, source):
        """Refuses a channel that spikes twice in a timestep."""
        help = "add such spikes before the Emulator is made"
        raise not_served(f"input '{self.names[source]}'", "a channel that spikes twice in a timestep", help)

    def update(self):
        """Takes over what nsim has learned, and reports the registers that left their width."""
        for learner in self.learners if self.t % 4 == 0 else ():
            learner.take_weights(self.session.weights[learner.projection])
        before, self.overflow = self.overflow, self.session.overflow
        if self.overflow != before:
            for register, message in OVERFLOWS.items():
                if self.overflow[register] > before[register]:
                    self.compartment.error(message)

    def check_v(self, block, v):
        """Refuses a v, of any shape, at the least of nsim's register where the tool's is lower."""
        if (v <= LEAST_V).any():
            help = "raise min_voltage of its neurons"
            raise not_served(f"block '{self.names[block]}'", f"v below {LEAST_V}, the least of 24 bits", help)

    def set_added(self, spikes):
        """Sets what enters the next step: errors, remainders of fine weights, and random numbers in the tool's order."""
        added = {}
        for learner in self.learners:
            if not (learner.is_fine or learner.can_lose):
                continue
            arriving = self.arrivals(learner, spikes)
            if learner.can_lose:
                if learner.noted[arriving].any():
                    self.compartment.error("Synaptic trace spikes lost")
                learner.noted[arriving] = True
            if learner.is_fine:
                place = f"{self.names[learner.block]}.q"
                added[place] = added.get(place, 0) + np.fmod(learner.weights[learner.axons[arriving]], UNIT).sum(axis=0)
        if self.t % 2:
            self.set_learning(has_weights=self.t % 4 == 3)
        self.undrawn += self.compartments
        if self.noise:
            random = self.drawn()
        for block, own, factor, offset, register in self.noise:
            place = f"{self.names[block]}.{register}"
            added[place] = added.get(place, 0) + ((random[own] + offset) * factor).astype(np.int32)
        for place, integers in added.items():
            self.session.added[place] = integers

    def drawn(self):
        """The tool's random numbers of noise since the last call; it draws them in networks without noise, too."""
        size, self.undrawn = self.undrawn, 0
        return self.rng.randint(-127, 128, size=size, dtype=np.int32)

    def arrivals(self, learner, spikes):
        """Sources of a learner whose spikes arrive in the next step."""
        found = []
        for source, first in learner.sources:
            population = self.populations.get(source)
            found.append(first + (spikes.get(source, NONE) if population is None else population.spikes))
        found = np.concatenate(found)
        return found[learner.axons[found] >= 0]

    def set_learning(self, has_weights):
        """Sets the errors and random numbers of a step in which traces, and weights, change."""
        if self.undrawn:
            self.drawn()
        # Sources without an axon have no synapse; their random number has no effect.
        draws = [{"draw_trace": self.rng.rand(len(learner.weights))[learner.axons]} for learner in self.learners]
        for learner, own in zip(self.learners, draws) if has_weights else ():
            own["draw_weight"] = self.rng.rand(*learner.weights.shape)[learner.axons].ravel()
            self.session.signal[learner.signal] = self.error_of(learner)
        for learner, own in zip(self.learners, draws):
            self.session.draws[learner.projection] = own
            if learner.can_lose:
                learner.noted[:] = False

    def error_of(self, learner):
        """Errors of a learner as integers, one for each channel of its signal."""
        vectors = [vector for synapse, _, vector in self.errors if synapse is learner.synapse]
        error = sum((self.scaled(vector) for vector in vectors), learner.no_error)
        # Each is at most 127.
        if len(vectors) > 1 and np.abs(error).max() > 127:
            whose = f"block '{self.names[learner.block]}'"
            raise not_served(whose, f"a sum of PES errors of {np.abs(error).max()}", "send one error a timestep")
        return error

    def scaled(self, vector):
        """An error as integers of at most 127."""
        error = np.rint(self.error_scale * vector)
        # Their function clips, with their warning. Of NaN every comparison is false.
        return error.astype(np.int32) if np.abs(error).max() <= 127 else scale_pes_errors(vector, scale=self.error_scale)

    def record(self, rows):
        """Appends states `[steps, units]`, by block and key, to the probes that read them."""
        for probe, targets in self.recorded.items():
            for block, chunks in zip(probe.target, targets):
                chunks.append(rows[block, probe.key])

    def energy(self):
        """Energy of the timesteps so far, an `nsim.Energy`."""
        if self.board is None:
            message = "the energy of a network needs a board, on whose cores it runs"
            raise refusal(message, 'give one: nsim.nengo.Simulator(network, board="nahuku-32")', "nengo.board")
        if self.t == 0:
            raise refusal("no timestep has run, so none has an energy", "call sim.run(SECONDS) first", "nengo.board")
        with warnings.catch_warnings():
            # Decode neurons of probes never spike.
            warnings.filterwarnings("ignore", ".*never spikes", nsim.Warning)
            return self.session.energy()


class Simulator(nengo_loihi.simulator.Simulator):
    """nengo-loihi's Simulator on nsim, with its arguments.

    `board` is a target of nsim whose limits hold, such as "nahuku-32", or the path of one; without it no limit holds. With
    `target="loihi"` it is "nahuku-32" unless given. `mapping` is the `nsim.Mapping`.
    """

    def __init__(self, network, dt=0.001, seed=None, model=None, precompute=None, target=None, *rest, board=None, **options):
        if target == "loihi":
            board = board or "nahuku-32"
        target = "sim" if target in (None, "loihi") else target
        super().__init__(network, dt, seed, model, precompute, target, *rest, **options)
        theirs = self.sims["emulator"]
        if board is None and isinstance(theirs, (Emulator, RealEmulator)):
            return
        try:
            self.sims["emulator"] = Emulator(self.model, seed=theirs.seed, board=board)
        except Exception:
            self.close()
            raise
        self._runner = nengo_loihi.simulator.StepRunner(self.model, self.sims, self.precompute, self.timers)

    @property
    def emulator(self):
        """The network's `Emulator`."""
        if isinstance(self.sims["emulator"], Emulator):
            return self.sims["emulator"]
        raise not_served("the network", "real numbers have neither a mapping nor an energy", "leave out target='simreal'")

    @property
    def mapping(self):
        return self.emulator.mapping

    def energy(self):
        """Energy of the timesteps so far on the board, an `nsim.Energy`."""
        return self.emulator.energy()


def install():
    """Puts nsim in place of nengo-loihi's emulator, for scripts that use `nengo_loihi.Simulator`."""
    nengo_loihi.emulator.EmulatorInterface = Emulator
    nengo_loihi.simulator.EmulatorInterface = Emulator
    nengo_loihi.Simulator = Simulator
    nengo_loihi.simulator.Simulator = Simulator
