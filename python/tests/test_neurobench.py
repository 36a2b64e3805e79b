"""NeuroBench's metrics equal those of the command line, and of the harness itself where it is installed with torch and snntorch."""

import json
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np

import nsim

try:
    import torch
    from neurobench.benchmarks import Benchmark
    from neurobench.metrics.static import ConnectionSparsity, Footprint
    from neurobench.metrics.workload import ActivationSparsity, ClassificationAccuracy, MembraneUpdates, SynapticOperations
except ImportError as problem:
    torch = None
    print(f"absent: neurobench with torch and snntorch ({problem}), its harness was not compared with", file=sys.stderr)

NSIM = os.environ.get("NSIM", "nsim")
CONVOLUTIONS = """Network(
    name: "convolutions",
    timestep_ms: 1,
    populations: [
        Input(name: "in", shape: [2, 8, 8]),
        Loihi(name: "c1", shape: [4, 4, 4], du: 2048, dv: 512, vth_mant: 3),
        Loihi(name: "p", shape: [4, 2, 2], du: 4095, dv: 4095, vth_mant: 2),
        Loihi(name: "out", shape: [3], du: 2048, dv: 512, vth_mant: 3),
    ],
    projections: [
        Conv2d(from: ["in"], to: "c1", weights: Npy("w.npy"), stride: (2, 2), padding: (1, 1), groups: 2, delay: 3),
        SumPool2d(from: ["c1"], to: "p", weight: 40, kernel: (2, 2)),
        Random(from: ["p"], to: "out", fan_out: 5, low: -32, high: 64, seed: 3, delay: 1),
    ],
    output: "out",
)
"""


GRADED = """Network(
    name: "graded",
    timestep_ms: 1,
    populations: [
        Input(name: "in", shape: [20]),
        Loihi(name: "a", shape: [12], du: 1024, dv: 256, vth_mant: 40, payload: 3),
        Loihi(name: "b", shape: [9], du: 1024, dv: 256, vth_mant: 40, payload: -1),
        Loihi(name: "out", shape: [4], du: 1024, dv: 256, vth_mant: 40),
    ],
    projections: [PROJECTIONS],
    output: "out",
)
"""


def loaded(text, weights):
    """A network whose weights are in files next to it."""
    with tempfile.TemporaryDirectory() as folder:
        for name, array in weights.items():
            np.save(os.path.join(folder, f"{name}.npy"), array.astype(np.int64))
        path = os.path.join(folder, "model.ron")
        with open(path, "w") as file:
            file.write(text)
        return nsim.load(path)


def with_zeros(rng, shape):
    return 2 * rng.integers(-10, 25, shape) * (rng.random(shape) < 0.6)


def graded(rng):
    """Spikes that carry 3, others that carry -1, a recurrent projection."""
    sizes = {"in": 20, "a": 12, "b": 9, "out": 4}
    pairs = [("in", "a"), ("a", "a"), ("a", "b"), ("in", "b"), ("b", "out"), ("a", "out")]
    dense = [f'Dense(from: ["{source}"], to: "{target}", weights: Npy("{source}_{target}.npy"))' for source, target in pairs]
    weights = {f"{source}_{target}": with_zeros(rng, (sizes[target], sizes[source])) for source, target in pairs}
    return loaded(GRADED.replace("PROJECTIONS", ", ".join(dense)), weights)


def networks():
    rng = np.random.default_rng(11)
    return [nsim.load("vtsnn-slip"), loaded(CONVOLUTIONS, {"w": with_zeros(rng, (4, 1, 3, 3))}), graded(rng)]


def batch(mapping, samples=5, steps=60, rate=0.08):
    """Random spikes `[samples, T, channels of all inputs]`, and a class for each sample."""
    rng = np.random.default_rng(3)
    channels = sum(int(np.prod(shape)) for _, kind, shape in mapping.populations if kind == "input")
    return (rng.random((samples, steps, channels)) < rate).astype(np.uint8), rng.integers(0, 2, samples)


def by_population(mapping, spikes):
    inputs = [(name, shape) for name, kind, shape in mapping.populations if kind == "input"]
    ends = np.cumsum([int(np.prod(shape)) for _, shape in inputs])[:-1]
    parts = np.split(spikes, ends, axis=2)
    return {name: part.reshape(*spikes.shape[:2], *shape) for (name, shape), part in zip(inputs, parts)}


class NeuroBench(unittest.TestCase):
    def test_python_gives_what_the_command_line_gives(self):
        for model in ["vtsnn-slip", "container-tactile"]:
            done = subprocess.run(
                [NSIM, "run", model, "--neurobench", "--samples", "0..3", "--format", "json"], capture_output=True, text=True
            )
            theirs = json.loads(done.stdout)["neurobench"]
            run = nsim.load(model).map().run(samples=(0, 3))
            self.assertEqual(run.neurobench(), theirs)
            self.assertEqual(nsim.load(model).map(copies=2).run(samples=(0, 3)).neurobench(), theirs)

    def test_probes_are_those_of_the_command_line(self):
        with tempfile.TemporaryDirectory() as folder:
            line = ["run", "vtsnn-slip", "--samples", "0..2", "--probe", "out.v", "--probe", "touch.spikes", "-o", folder]
            subprocess.run([NSIM, *line], capture_output=True, check=True)
            run = nsim.load("vtsnn-slip").map().run(samples=(0, 2), probe=["out.v", "touch.spikes"])
            for name in ["out.v", "touch.spikes"]:
                theirs = np.load(os.path.join(folder, f"{name}.npy"))
                np.testing.assert_array_equal(run.probe(name), theirs)
        with self.assertRaises(nsim.Error) as raised:
            nsim.load("vtsnn-slip").map().run(probe=["nothing.v"])
        self.assertEqual(raised.exception.code, "usage")

    @unittest.skipIf(torch is None, "neurobench is not installed")
    def test_metrics_equal_those_of_the_harness(self):
        from nsim.neurobench import Model, classes

        for network in networks():
            mapping = network.map()
            spikes, labels = batch(mapping)
            data = torch.utils.data.TensorDataset(torch.from_numpy(spikes), torch.from_numpy(labels))
            loader = torch.utils.data.DataLoader(data, batch_size=len(labels))
            static = [ConnectionSparsity, Footprint]
            workload = [ActivationSparsity, ClassificationAccuracy, MembraneUpdates, SynapticOperations]
            theirs = Benchmark(Model(mapping), loader, [], [classes], [static, workload]).run(quiet=True)
            run = mapping.run(by_population(mapping, spikes), time_first=True, labels=labels.tolist())
            ours = run.neurobench()
            operations = ours["synaptic_operations"]
            with self.subTest(network=network.name):
                self.assertGreater(run.activity["spikes"], 0)
                self.assertEqual(ours["connection_sparsity"], theirs["ConnectionSparsity"])
                self.assertEqual(ours["footprint_bytes"], theirs["Footprint"])
                self.assertEqual(ours["activation_sparsity"], theirs["ActivationSparsity"])
                self.assertEqual(ours["classification_accuracy"], theirs["ClassificationAccuracy"])
                self.assertEqual(ours["membrane_updates"], theirs["MembraneUpdates"])
                self.assertEqual(operations["dense"], theirs["SynapticOperations"]["Dense"])
                self.assertEqual(operations["effective_acs"], theirs["SynapticOperations"]["Effective_ACs"])
                self.assertEqual(operations["effective_macs"], theirs["SynapticOperations"]["Effective_MACs"])


if __name__ == "__main__":
    unittest.main()
