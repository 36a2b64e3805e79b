"""Networks in memory equal networks of files; SciPy and nir are used where they are installed, and their absence is reported."""

import os
import sys
import tempfile
import unittest
import warnings

import numpy as np

import nsim

try:
    import scipy.sparse as sparse
except ImportError:
    sparse = None
    print("absent: scipy, networks of sparse arrays were not tested", file=sys.stderr)
try:
    import nir
except ImportError:
    nir = None
    print("absent: nir, graphs in memory were not tested", file=sys.stderr)
try:
    import snntorch
    import snntorch.utils
    import torch
except ImportError:
    torch = None
    print("absent: torch with snntorch, its modules were not tested", file=sys.stderr)

WEIGHTS = np.array([[40, -20, 0], [0, 62, 8]])
TEXT = """Network(
    name: "small",
    timestep_ms: 1,
    populations: [
        Input(name: "in", shape: [3]),
        Loihi(name: "out", shape: [2], du: 4096, dv: 128, vth_mant: [3, 2]),
    ],
    projections: [Dense(from: ["in"], to: "out", weights: [[40, -20, 0], [0, 62, 8]], delay: 1)],
    output: "out",
    classes: ["a", "b"],
)
"""


def small(weights=WEIGHTS, **changed):
    populations = [
        {"name": "in", "shape": 3, "kind": "Input"},
        {"name": "out", "shape": [2], "du": 4096, "dv": 128, "vth_mant": np.array([3, 2])},
    ]
    projections = [{"from": "in", "to": "out", "weights": weights, "delay": 1, **changed}]
    return nsim.Network("small", populations, projections, output="out", classes=["a", "b"])


def of_file(text):
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "small.ron")
        with open(path, "w") as file:
            file.write(text)
        return nsim.load(path)


def figures(network, channels=3):
    spikes = (np.random.default_rng(5).random((4, channels, 80)) < 0.4).astype(np.uint8)
    mapping = network.map()
    run = mapping.run(spikes)
    return run.digest, run.counts.tolist(), run.activity, mapping.energy(spikes).json()["rows"]


class InMemory(unittest.TestCase):
    def test_rules_are_those_of_a_file(self):
        signal, trace = nsim.Signal("reward"), (16, 10.5)
        rule = nsim.Rule("2^-2*x1*y0 + u0*y2*r1", dt="x0", epoch=4, x1=trace, y1=(3, 2), y2=signal, r1=("in", 2, 1), tags=[[1, 2, 3], [4, 5, 6]], until=90)
        stated = """Rule(dw: "2^-2*x1*y0 + u0*y2*r1", dt: "x0", epoch: 4, x1: (impulse: 16, tau: 10.5), y1: (impulse: 3, tau: 2),
            y2: Signal("reward"), r1: (from: "in", impulse: 2, tau: 1), tags: [[1, 2, 3], [4, 5, 6]], until: 90)"""
        lines = TEXT.replace("delay: 1", f'delay: 1, name: "p", learning: {stated}')
        file = of_file(lines.replace("Loihi(", 'Signal(name: "reward", shape: [2]),\n        Loihi('))

        def network(learning):
            populations = [
                {"name": "in", "shape": 3, "kind": "Input"},
                {"name": "reward", "shape": 2, "kind": "Signal"},
                {"name": "out", "shape": [2], "du": 4096, "dv": 128, "vth_mant": np.array([3, 2])},
            ]
            projections = [{"name": "p", "from": "in", "to": "out", "weights": WEIGHTS, "delay": 1, "learning": learning}]
            return nsim.Network("small", populations, projections, output="out", classes=["a", "b"], learning_semantics="Silicon")

        written = []
        for given in (file, network(rule), network(stated)):
            with tempfile.TemporaryDirectory() as folder:
                given.save(os.path.join(folder, "saved.ron"))
                with open(os.path.join(folder, "saved.ron")) as text:
                    written.append(text.read().replace("    learning_semantics: Silicon,\n", ""))
        self.assertEqual(written, written[:1] * 3)
        for wrong, says in [("Rule(dw: \"2*\")", "model.learning"), (nsim.Rule("x1"), "a product needs"), ("Rule(dx: 1)", "dx")]:
            with self.assertRaises(nsim.Error) as caught:
                network(wrong)
            self.assertIn(says, f"{caught.exception.code} {caught.exception}")
        with self.assertRaisesRegex(nsim.Error, "learning_semantics is 'Chip'"):
            nsim.Network("small", [], [], output="out", learning_semantics="Chip")

    def test_arrays_are_a_file(self):
        network, file = small(), of_file(TEXT)
        self.assertEqual((network.name, network.populations, network.classes), (file.name, file.populations, file.classes))
        theirs = figures(file)
        self.assertGreater(sum(map(sum, theirs[1])), 0)
        self.assertEqual(figures(network), theirs)
        self.assertEqual(figures(small(np.asfortranarray(WEIGHTS.astype(np.float32)))), theirs)

    def test_a_parameter_without_axes_is_its_number(self):
        for kind in (int, float, np.int16, np.float32, np.array, lambda number: np.array(number, ">i4")):
            populations = [
                {"name": "in", "shape": 3, "kind": "Input"},
                {"name": "out", "shape": [2], "du": kind(4096), "dv": kind(128), "vth_mant": kind(3)},
            ]
            network = nsim.Network("small", populations, [{"from": "in", "to": "out", "weights": WEIGHTS}], output="out")
            with tempfile.TemporaryDirectory() as folder:
                path, *_ = network.save(os.path.join(folder, "small.ron"))
                with open(path) as file:
                    self.assertIn("du: 4096, dv: 128, vth_mant: 3)", file.read())

    @unittest.skipIf(sparse is None, "scipy is absent")
    def test_sparse_arrays(self):
        listed = TEXT.replace("Dense(", "Sparse(")
        listed = listed.replace("weights: [[40, -20, 0], [0, 62, 8]]", "synapses: [(0, 0, 40), (1, 0, -20), (1, 1, 62), (2, 1, 8)]")
        theirs = figures(of_file(listed))
        for form in [sparse.csr_array, sparse.csc_array, sparse.coo_matrix]:
            self.assertEqual(figures(small(form(WEIGHTS))), theirs)

    def test_a_convolution(self):
        populations = [
            {"name": "in", "shape": (1, 4, 4), "kind": "Input"},
            {"name": "out", "shape": (2, 2, 2), "kind": "If", "vth_mant": 1},
        ]
        kernel = np.arange(-4, 14).reshape(2, 1, 3, 3) * 2
        projections = [{"from": ["in"], "to": "out", "weights": kernel, "stride": (2, 2), "padding": (1, 1)}]
        network = nsim.Network("convolved", populations, projections, output="out")
        self.assertEqual(network.populations[1], ("out", "integers", [2, 2, 2]))
        self.assertGreater(network.map().run(np.ones((1, 4, 4, 9), np.uint8)).counts.sum(), 0)

    def test_problems_name_what_they_are_in(self):
        def raised(call):
            with self.assertRaises(nsim.Error) as caught:
                call()
            return str(caught.exception)

        self.assertIn("small (in memory)", raised(lambda: small(WEIGHTS.T)))
        self.assertIn("in -> out", raised(lambda: small(np.zeros(3))))
        self.assertIn("sign", raised(lambda: small(sign="Both")))
        self.assertIn("'to'", raised(lambda: nsim.Network("x", [], [{"from": "a"}], output="a")))
        out = {"name": "out", "shape": 2, "vth_mant": [1, 2, 3]}
        self.assertIn("'out': vth_mant", raised(lambda: nsim.Network("x", [out], [], output="out")))
        with self.assertRaises(TypeError):
            small(weigth_exp=1)

    @unittest.skipIf(nir is None, "nir is absent")
    def test_a_graph_of_nir_to_energy(self):
        rng = np.random.default_rng(1)
        graph = nir.NIRGraph.from_list(
            nir.Input({"input": np.array([6])}),
            nir.Affine(rng.normal(0.3, 0.6, (4, 6)), np.zeros(4)),
            nir.CubaLIF(*[np.full(4, x) for x in [5e-3, 1e-2, 1.0, 0.0, 0.5]], w_in=np.full(4, 1.0), v_reset=np.zeros(4)),
            nir.Output({"output": np.array([4])}),
        )
        with warnings.catch_warnings(record=True) as issued:
            warnings.simplefilter("always")
            network = nsim.from_nir(graph, dt_ms=1.0)
        self.assertTrue(network.notes)
        self.assertIn("does not state the reset", " ".join(str(one.message) for one in issued))
        with self.assertRaises(nsim.Error) as refused:
            nsim.from_nir("network.nir")
        self.assertIn("nsim.load(path)", refused.exception.help)
        self.assertGreater(network.map().energy(np.ones((6, 40), np.uint8)).energy_uj, 0)
        # This graph as a file.
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "network.nir")
            nir.write(path, graph)
            folded = nsim.from_nir(nir.read(path), dt_ms=1.0)
            with open(path, "rb") as file:
                content = file.read()
        of_bytes = nsim._nsim.from_bytes("network", content, dt_ms=1.0)
        self.assertEqual(figures(network, 6), figures(of_bytes, 6))
        self.assertEqual(figures(network, 6), figures(folded, 6))

    @unittest.skipIf(nir is None, "nir is absent")
    def test_recorded_spikes_decide_whose_conventions_hold(self):
        graph = nir.NIRGraph.from_list(
            nir.Input({"input": np.array([2])}), nir.Linear(np.eye(2)), nir.IF(np.ones(2), np.ones(2)), nir.Output({"output": np.array([2])})
        )
        spikes = np.random.default_rng(1).random((3, 2, 20)) < 0.4
        # v equals the threshold at each spike, where spikingjelly spikes.
        warnings.simplefilter("ignore", nsim.Warning)
        nsim.from_nir(graph, tool="spikingjelly", check=(spikes, spikes))
        with self.assertRaises(nsim.Error) as refused:
            nsim.from_nir(graph, check=(spikes, spikes))
        self.assertEqual(refused.exception.code, "check.differs")
        self.assertIn("with tool='spikingjelly': 0 of 120", refused.exception.help)

    @unittest.skipIf(torch is None or nir is None, "torch, snntorch or nir is absent")
    def test_a_module_of_snntorch_to_energy(self):
        torch.manual_seed(1)
        leaky = {"init_hidden": True, "reset_mechanism": "zero"}
        module = torch.nn.Sequential(
            torch.nn.Linear(20, 12), snntorch.Leaky(beta=0.9, **leaky),
            torch.nn.Linear(12, 3), snntorch.Leaky(beta=0.8, output=True, **leaky),
        )
        for weights in module.parameters():
            weights.data *= 3
        spikes = np.random.default_rng(1).random((6, 20, 50)) < 0.3
        mapping = nsim.from_torch(module, torch.zeros(1, 20)).map()
        run = mapping.run(spikes)
        self.assertGreater(mapping.energy(spikes).energy_uj, 0)
        snntorch.utils.reset(module)
        with torch.no_grad():
            theirs = [module(torch.tensor(spikes[:, :, t], dtype=torch.float32))[0] for t in range(50)]
        # Weights and decays were rounded: nearly all samples have equal numbers of spikes.
        equal = (torch.stack(theirs).sum(0).numpy() == run.counts).all(axis=1)
        self.assertGreater(int(run.counts.sum()), 5)
        self.assertGreaterEqual(int(equal.sum()), 5)


if __name__ == "__main__":
    unittest.main()
