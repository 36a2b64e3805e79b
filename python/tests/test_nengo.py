"""nengo-loihi's networks: drawn ones give the numbers of its own emulator; what isn't served is refused by name.

Without nengo-loihi only its absence is tested. NSIM_LONG draws 300 networks in place of 20.
"""

import os
import re
import subprocess
import sys
import tempfile
import unittest
import warnings
from pathlib import Path

import numpy as np

import nsim

try:
    import nengo
    import nengo_loihi
    from nengo.exceptions import SimulationError, SimulatorClosed
    from nengo_loihi.block import Axon, LoihiBlock, Synapse
    from nengo_loihi.builder import Model
    from nengo_loihi.builder.discretize import discretize_model
    from nengo_loihi.decode_neurons import NoisyDecodeNeurons
    from nengo_loihi.inputs import SpikeInput
    from nengo_loihi.probe import LoihiProbe
except ImportError as error:
    nengo = None
    print(f"absent: nengo-loihi ({error}), its networks were not tested", file=sys.stderr)
else:
    from nengo_loihi.emulator.interface import EmulatorInterface

    import nsim.nengo

PAGE = Path(__file__).resolve().parents[2] / "docs/tutorials/from-nengo.md"
NETWORKS = 300 if os.environ.get("NSIM_LONG") else 20
FEATURES = ["loop", "recurrent", "neurons", "convolution", "learning", "fine learning", "noise", "ahead"]


def ensemble(draw, size, dimensions=1):
    neurons = [nengo.LIF(tau_ref=0.003), nengo.LIF(min_voltage=-1), nengo.SpikingRectifiedLinear(), nengo_loihi.neurons.LoihiLIF()]
    rates = nengo.dists.Uniform(60, 200)
    return nengo.Ensemble(size, dimensions, neuron_type=neurons[draw.integers(4)], max_rates=rates, label=f"e{draw.integers(3)}")


def drawn(seed):
    """A network with two features, its model, and `precompute`."""
    draw = np.random.default_rng(seed)
    features = {FEATURES[seed % len(FEATURES)], FEATURES[draw.integers(len(FEATURES))]}
    model = Model(dt=0.001)
    if "noise" in features:
        model.decode_neurons = NoisyDecodeNeurons(5)
    if "fine learning" in features:
        model.pes_wgt_exp = -2
    with nengo.Network(seed=seed) as net:
        nengo_loihi.add_params(net)
        period = draw.uniform(5, 30)
        stim = nengo.Node(lambda t: np.sin(period * t))
        a, b = ensemble(draw, int(draw.integers(20, 80))), ensemble(draw, 40, 2)
        nengo.Connection(stim, a)
        nengo.Connection(a, b, transform=[[1], [-0.5]], synapse=draw.uniform(0.002, 0.02))
        if "recurrent" in features:
            nengo.Connection(b, b, transform=[[1.05, 0.6], [-0.6, 1.05]], synapse=0.1)
        if "neurons" in features:
            c = ensemble(draw, 30)
            nengo.Connection(b.neurons, c.neurons, transform=draw.normal(0, 2e-3, (30, 40)))
            nengo.Connection(c.neurons[::2], a.neurons, transform=draw.normal(0, 1e-3, (a.n_neurons, 15)))
        if "convolution" in features:
            images = nengo.Node(draw.uniform(-1, 1, 72))
            on = nengo.Ensemble(72, 1, neuron_type=nengo.SpikingRectifiedLinear(), gain=np.full(72, 100.0), bias=np.full(72, 20.0))
            net.config[on].on_chip = False
            nengo.Connection(images, on.neurons, synapse=None)
            first = nengo.Convolution(4, (6, 6, 2), kernel_size=(3, 3), strides=(2, 2), init=nengo.dists.Uniform(-0.02, 0.06))
            pop_type = int(draw.choice([16, 32]))
            if draw.integers(2):
                first, pop_type = nengo.Convolution(3, (2, 6, 6), channels_last=False, init=nengo.dists.Uniform(-0.02, 0.06)), 32
            size = int(np.prod(first.output_shape.shape))
            post = nengo.Ensemble(size, 1, neuron_type=nengo.SpikingRectifiedLinear(), gain=np.ones(size), bias=np.full(size, 10.0))
            last = nengo.Connection(on.neurons, post.neurons, transform=first)
            net.config[last].pop_type = pop_type
            nengo.Probe(post.neurons), nengo.Probe(post.neurons, "voltage")
        if features & {"learning", "fine learning"}:
            learned, error = nengo.Node(size_in=1), nengo.Node(size_in=1)
            rule = nengo.PES(learning_rate=draw.choice([1e-3, 1e-2]))
            learning = nengo.Connection(a, learned, function=lambda x: 0, learning_rule_type=rule)
            nengo.Connection(learned, error), nengo.Connection(stim, error, transform=-1)
            nengo.Connection(error, learning.learning_rule)
            nengo.Probe(learned, synapse=0.02)
        if "loop" in features:
            back = nengo.Node(lambda t, x: -0.3 * x, size_in=2, size_out=1 + 1)
            nengo.Connection(b, back), nengo.Connection(back, b)
        for one in (a, b):
            for what in ("output", "voltage", "input"):
                nengo.Probe(one.neurons, what)
            nengo.Probe(one, synapse=0.01), nengo.Probe(one.neurons[3:9:2], synapse=0.005)
    return net, model, None if "ahead" in features else False if draw.integers(2) else None


def outputs(simulator, seed, steps=(60, 1, 59)):
    """Data of every probe, and the learned weights."""
    net, model, precompute = drawn(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with simulator(net, model=model, precompute=precompute) as sim:
            for some in steps:
                sim.run_steps(some)
        learned = [w for block in model.blocks for synapse in block.synapses if synapse.learning for w in synapse.weights]
        return [np.array(sim.data[probe]) for probe in net.all_probes] + [np.array(learned)]


def chip(repeated=False, noise_at_membrane=None, refract_delay=3):
    """A model of one input and one block, and a probe of each of its states."""
    model, source, axon, block, synapse = Model(), SpikeInput(3), Axon(3), LoihiBlock(3, label="three"), Synapse(3)
    for time in range(1, 90, 2):
        source.add_spikes(time, [0, 0, 2] if repeated else [0, 2], permanent=True)
    block.compartment.configure_lif(tau_ref=0.003, min_voltage=-2)
    block.compartment.refract_delay[:] = refract_delay
    block.compartment.enable_noise[:2] = noise_at_membrane is not None
    block.compartment.noise_at_membrane, block.compartment.noise_exp, block.compartment.noise_offset = noise_at_membrane, -1.0, 1
    synapse.set_weights(60 * np.eye(3) - 12)
    axon.target = synapse
    source.add_axon(axon), block.add_synapse(synapse), model.add_input(source), model.add_block(block)
    probes = [LoihiProbe(target=block, key=key) for key in ("current", "voltage", "spiked", "spike_count")]
    for probe in probes:
        model.add_probe(probe)
    discretize_model(model)
    return model, block, probes


@unittest.skipIf(nengo is None, "nengo-loihi is absent")
class Nengo(unittest.TestCase):
    def refused(self, what, act, code="nengo.not-served"):
        with self.assertRaises(nsim.Error) as raised:
            act()
        self.assertEqual(raised.exception.code, code)
        self.assertIn(what, str(raised.exception))

    def test_drawn_networks_are_equal(self):
        compared = spikes = 0
        for seed in range(NETWORKS):
            with self.subTest(seed=seed):
                for theirs, ours in zip(outputs(nengo_loihi.Simulator, seed), outputs(nsim.nengo.Simulator, seed)):
                    np.testing.assert_array_equal(ours, theirs)
                    self.assertEqual(ours.dtype, theirs.dtype)
                    compared, spikes = compared + theirs.size, spikes + np.count_nonzero(theirs)
        print(f"{compared} values of nengo-loihi compared, {spikes} are not 0", file=sys.stderr)
        self.assertGreater(spikes, compared / 20)

    def test_models_made_by_hand_are_equal(self):
        for options in ({}, {"repeated": True}, {"noise_at_membrane": 0}, {"noise_at_membrane": 1}, {"refract_delay": 70}):
            values = []
            for emulator, runs in [(EmulatorInterface, [80]), (nsim.nengo.Emulator, [80]), (nsim.nengo.Emulator, [1] * 80)]:
                model, _, probes = chip(**options)
                with emulator(model, seed=1) as sim:
                    for steps in runs:
                        sim.run_steps(steps)
                values.append([sim.collect_probe_output(probe).tolist() for probe in probes])
            self.assertTrue(all(np.any(value) for value in values[0]))
            self.assertTrue(values[0] == values[1] == values[2], options)

    def test_what_is_not_served_is_refused(self):
        def emulate(change, act=lambda sim: None):
            model, block, _ = chip()
            change(block)
            act(nsim.nengo.Emulator(model))

        self.refused("'three': a refractory period of 256", lambda: emulate(lambda block: block.compartment.refract_delay.fill(256)))
        self.refused("'three': a vth", lambda: emulate(lambda block: block.compartment.vth.fill(65)))
        self.refused("synapses from SpikeInput: weights", lambda: emulate(lambda block: block.synapses[0].weights[0].fill(65)))

        def sink(block):
            block.compartment.vmin, block.compartment.bias[:], block.compartment.decay_v[:] = 1 - 2**31, -4095 * 128, 0

        def spikes_twice(sim, steps):
            sim.host2chip([(sim.inputs[0], 100, [1, 1])], [])
            for some in steps:
                sim.run_steps(some)

        for steps in ([101], [1] * 101):
            self.refused("least of 24 bits", lambda: emulate(sink, lambda sim: [sim.run_steps(some) for some in steps]))
            self.refused("'SpikeInput': a channel that spikes twice", lambda: emulate(lambda block: None, lambda sim: spikes_twice(sim, steps)))

    def test_what_is_closed_does_not_run(self):
        with nsim.nengo.Simulator(drawn(2)[0], board="kapoho-bay") as sim:
            self.refused("no timestep has run", sim.energy, "nengo.board")
            sim.run_steps(3)
        for run in (sim.step, sim.emulator.step, lambda: sim.emulator.run_steps(2)):
            self.assertRaises(SimulatorClosed, run)
        self.assertGreater(sim.energy().energy_uj, 0)

    def test_strict_reports_overflow(self):
        class Strict(nsim.nengo.Emulator):
            strict = True

        def flooded():
            model, block, _ = chip()
            (synapse,) = block.synapses
            synapse.weights, synapse.synapse_cfg.weight_exp = [weights * 0 + 254 * 64 * 128 for weights in synapse.weights], 7
            return model

        for emulator in (EmulatorInterface, nsim.nengo.Emulator):
            with self.assertWarnsRegex(UserWarning, "Overflow in q0"):
                emulator(flooded()).run_steps(3)
        self.assertRaisesRegex(SimulationError, "Overflow in q0", lambda: Strict(flooded()).run_steps(3))

    def test_real_numbers_stay_with_the_tool(self):
        net, _, _ = drawn(1)
        with self.assertWarnsRegex(nsim.Warning, "real numbers.*e[012]"), nsim.nengo.Simulator(net, target="simreal") as sim:
            self.assertIsInstance(sim.sims["emulator"], EmulatorInterface)
            self.refused("neither a mapping", lambda: sim.mapping)
        self.refused("real numbers, which tiny lacks", lambda: nsim.nengo.Simulator(net, target="simreal", board="tiny"))

    def test_a_board_has_limits_and_an_energy(self):
        with nsim.nengo.Simulator(drawn(2)[0], target="loihi") as sim, nsim.nengo.Simulator(drawn(2)[0], board="kapoho-bay") as other:
            sim.run_steps(20), other.run_steps(20)
        self.assertEqual((sim.mapping.target, other.mapping.target), ("nahuku-32", "kapoho-bay"))
        self.assertGreater(min(sim.energy().energy_uj, other.energy().energy_uj), 0)
        with nsim.nengo.Simulator(drawn(2)[0]) as sim:
            self.refused('board="nahuku-32"', sim.energy, "nengo.board")
        with nengo.Network() as net:
            nengo.Probe(nengo.Ensemble(900, 1, label="wide"))
        with self.assertRaises(nsim.Error) as raised:
            nsim.nengo.Simulator(net, board="tiny")
        self.assertEqual(raised.exception.code, "map.does-not-fit")
        self.assertIn("wide", str(raised.exception.reasons))

    def test_scripts_run_unchanged(self):
        script = """
import sys, nengo, nengo_loihi
from nengo_loihi.emulator import EmulatorInterface
with nengo.Network(seed=1) as net:
    probe = nengo.Probe(nengo.Ensemble(30, 1).neurons)
with nengo_loihi.Simulator(net, target=sys.argv[1]) as sim:
    sim.run(0.1)
print(type(sim).__module__, EmulatorInterface.__module__, int(sim.data[probe].sum()))
"""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "script.py")
            path.write_text(script)
            said = [subprocess.run([sys.executable, *how, path, target], capture_output=True, text=True, check=True).stdout.split()
                    for how, target in [([], "sim"), (["-m", "nsim.nengo"], "sim"), (["-m", "nsim.nengo"], "loihi")]]  # fmt: skip
        self.assertEqual(said[1][:2], ["nsim.nengo", "nsim.nengo"])
        self.assertEqual(said[0][0], "nengo_loihi.simulator")
        self.assertTrue(said[0][2] == said[1][2] == said[2][2] != "0")
        absent = subprocess.run([sys.executable, "-m", "nsim.nengo", "absent.py"], capture_output=True, text=True, check=False)
        self.assertEqual((absent.returncode, absent.stderr), (1, "python -m nsim.nengo: there is no script 'absent.py'\n"))


    def test_the_page_prints_what_it_shows(self):
        blocks = {kind: re.search(rf"^```{kind} nengo\n(.*?)^```", PAGE.read_text(), re.M | re.S)[1] for kind in ("python", "text")}
        said = subprocess.run([sys.executable, "-W", "ignore", "-c", blocks["python"]], capture_output=True, text=True, check=True).stdout
        self.assertEqual(said, blocks["text"])


class Absent(unittest.TestCase):
    def test_a_missing_package_is_named(self):
        code = "import sys; sys.modules['nengo_loihi'] = None; import nsim.nengo"
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stderr
        self.assertIn("pip install nengo-loihi==1.1.0", said)


if __name__ == "__main__":
    unittest.main()
