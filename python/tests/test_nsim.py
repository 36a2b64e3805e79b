"""Each call gives the result of the command line; NSIM names the program to compare with."""

import json
import os
import subprocess
import tempfile
import unittest

import numpy as np

import nsim

NSIM = os.environ.get("NSIM", "nsim")
MODELS = ["vtsnn-slip", "container-tactile", "vtsnn-slip-srm"]
# Measured times differ from call to call.
# Warnings advise in the words of a shell or of Python (test_warnings.py), and the checksum covers them.
TIMES = {"wall_s", "us_per_timestep", "warnings", "checksum"}
# Only a shell has the next command.
TYPED = {"next", "warnings", "checksum"}


def command(*words):
    done = subprocess.run([NSIM, *words, "--format", "json"], capture_output=True, text=True)
    return json.loads(done.stdout)


def without(result, fields=TIMES):
    return {key: value for key, value in result.items() if key not in fields}


def recorded(network, samples=3, steps=60):
    """Random spikes for each input population, `[samples, channels.., T]`."""
    rng = np.random.default_rng(7)
    shapes = {name: shape for name, kind, shape in network.populations if kind == "input"}
    return {name: (rng.random((samples, *shape, steps)) < 0.05).astype(np.uint8) for name, shape in shapes.items()}


class SameAsTheCommandLine(unittest.TestCase):
    def test_runs_on_the_scene(self):
        for model in MODELS:
            with self.subTest(model=model):
                theirs = command("run", model, "--engine", "fast")
                run = nsim.load(model).map().run()
                self.assertEqual(run.digest, theirs["digest"])
                self.assertEqual(run.counts.tolist(), theirs["output_counts"])
                self.assertEqual(run.predicted, theirs["predicted"])
                self.assertEqual(run.activity, theirs["activity"])
                self.assertEqual(without(run.json()), without(theirs))

    def test_energy(self):
        for model in MODELS:
            with self.subTest(model=model):
                theirs = command("energy", model, "--baseline")
                energy = nsim.load(model).energy()
                self.assertEqual(without(energy.json()), without(theirs))
                total = next(row for row in theirs["rows"] if (row["hardware"], row["unit"]) == ("loihi", "total"))
                self.assertEqual((energy.energy_uj, energy.latency_us), (total["energy_uj"], total["latency_us"]))

    def test_agreement(self):
        for line, options in [
            (["vtsnn-slip-srm", "--samples", "0..3"], {}),
            (["vtsnn-slip-srm", "--samples", "1..3", "--seed", "5", "--conversion", "analytic"], {"seed": 5, "conversion": "analytic"}),
            (["vtsnn-slip", "--samples", "0..3", "--against", "golden", "--steps", "40"], {"against": "golden", "steps": 40}),
        ]:
            with self.subTest(line=line):
                first, last = map(int, line[2].split(".."))
                agreement = nsim.load(line[0]).agree(samples=(first, last), **options)
                self.assertEqual(without(agreement.json(), TYPED), without(command("agree", *line), TYPED))
                self.assertIn("<table>", agreement._repr_html_())
        with self.assertRaises(nsim.Error) as raised:
            nsim.load("vtsnn-slip").agree(against="srm")
        self.assertEqual(raised.exception.code, "usage")

    def test_notebooks_show_tables(self):
        mapping = nsim.load("vtsnn-slip").map()
        run, energy = mapping.run(samples=(0, 1)), mapping.energy(samples=(0, 1))
        self.assertEqual(run._repr_html_().count("<tr>"), 1 + len(run.json()["populations"]))
        self.assertEqual(energy._repr_html_().count("<tr>"), 1 + len(energy.rows))
        self.assertIn("energy_uj", energy._repr_html_())
        self.assertIn("80 % interval (uJ)", energy._repr_html_())
        # Constants of Loihi 2 are modelled: their intervals are bounds.
        on_loihi_2 = nsim.load("vtsnn-slip").map("oheo-gulch").energy(samples=(0, 1))
        self.assertIn("model's bounds (uJ)", on_loihi_2._repr_html_())

    def test_options_of_energy(self):
        theirs = command("energy", "vtsnn-slip", "--baseline", "--copies", "2", "--mode", "realtime", "--samples", "1..3")
        energy = nsim.load("vtsnn-slip").energy(copies=2, mode="realtime", samples=(1, 3))
        self.assertEqual(without(energy.json()), without(theirs))

    def test_energy_without_spikes_needs_a_scene(self):
        text = """Network(name: "own", timestep_ms: 1.0, populations: [Input(name: "in", shape: [2]),
            Loihi(name: "out", shape: [2], du: 1024, dv: 128, vth_mant: 10)],
            projections: [Dense(from: ["in"], to: "out", weights: [[20, 4], [2, 30]])], output: "out")"""
        with tempfile.TemporaryDirectory() as folder:
            path, page = os.path.join(folder, "own.ron"), os.path.join(folder, "p.html")
            with open(path, "w") as file:
                file.write(text)
            network = nsim.load(path)
            theirs = command("energy", path, "--baseline")
            mapping = network.map()
            for call in (network.energy, mapping.energy, lambda: network.report(page), lambda: mapping.report(page)):
                with self.assertRaises(nsim.Error) as refused:
                    call()
                self.assertEqual(refused.exception.code, theirs["code"])
            self.assertEqual(theirs["code"], "energy.input")
            self.assertFalse(os.path.exists(page))
            # What the message offers.
            self.assertGreater(mapping.energy("scene:noise").energy_uj, 0)

    def test_arrays(self):
        for model in MODELS:
            with self.subTest(model=model), tempfile.TemporaryDirectory() as folder:
                network = nsim.load(model)
                spikes, words = recorded(network), []
                for name, array in spikes.items():
                    np.save(os.path.join(folder, name + ".npy"), array)
                    words += ["--input", f"{name}={folder}/{name}.npy"]
                theirs = command("run", model, "--engine", "fast", *words)
                mapping = network.map()
                run = mapping.run(spikes)
                self.assertEqual((run.digest, run.counts.tolist()), (theirs["digest"], theirs["output_counts"]))
                self.assertEqual(run.activity, theirs["activity"])
                of_files = [word for word in words if word != "--input"]
                self.assertEqual(mapping.run(of_files).digest, run.digest)

    def test_a_saved_mapping(self):
        network = nsim.load("vtsnn-slip")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "m.ron")
            with open(path, "w") as file:
                file.write(network.map(copies=2, strategy="sequential").to_ron())
            mapping = network.map(mapping=path)
            self.assertEqual(mapping.copies, 2)
            self.assertEqual(mapping.run().digest, network.map().run().digest)
            self.assertEqual(command("run", "vtsnn-slip", "--mapping", path)["digest"], mapping.run().digest)
            with self.assertRaises(nsim.Error) as caught:
                network.map(mapping=path, copies=3)
            self.assertEqual(caught.exception.code, "mapping.copies")
            self.assertIn("the mapping has 2 copies, not 3", str(caught.exception))
            self.assertEqual(network.map(mapping=path, copies=2).copies, 2)


class Arrays(unittest.TestCase):
    def setUp(self):
        self.mapping = nsim.load("container-tactile").map()

    def test_forms_of_an_array_mean_the_same(self):
        rng = np.random.default_rng(3)
        spikes = (rng.random((4, 78, 50)) < 0.1).astype(np.uint8)
        want = self.mapping.run(spikes).digest
        for same in [
            spikes.astype(bool),
            spikes.astype(np.float64) * 2.0,
            np.asfortranarray(spikes),
            np.repeat(spikes, 2, axis=2)[:, :, ::2],
        ]:
            self.assertEqual(self.mapping.run(same).digest, want)
        time_first = np.ascontiguousarray(spikes.transpose(0, 2, 1))
        self.assertEqual(self.mapping.run(time_first, time_first=True).digest, want)
        first = self.mapping.run(spikes[0])
        self.assertEqual(first.counts[0].tolist(), self.mapping.run(spikes).counts[0].tolist())
        self.assertEqual(self.mapping.run(spikes, samples=(0, 1)).digest, first.digest)

    def test_events_mean_what_arrays_mean(self):
        rng = np.random.default_rng(3)
        spikes = (rng.random((4, 78, 50)) < 0.1).astype(np.uint8)
        want = self.mapping.run(spikes, labels=[0, 1, 2, 3])
        sample, channel, step = np.nonzero(spikes)
        events = np.stack([sample, step, channel], axis=1)
        shuffled = rng.permutation(events)
        for rows in [events, shuffled, shuffled.astype(np.uint16), np.concatenate([events, events[:5]])]:
            run = self.mapping.run(nsim.Events(rows, steps=50), labels=[0, 1, 2, 3])
            self.assertEqual((run.digest, run.activity), (want.digest, want.activity))
        self.assertEqual(len(self.mapping.run(nsim.Events(events, samples=6, steps=50))), 6)
        both = recorded(nsim.load("vtsnn-slip"))
        as_events = {}
        for name, array in both.items():
            sample, channel, step = np.nonzero(array.reshape(len(array), -1, array.shape[-1]))
            as_events[name] = nsim.Events(np.stack([sample, step, channel], axis=1), samples=len(array), steps=array.shape[-1])
        slip = nsim.load("vtsnn-slip").map()
        self.assertEqual(slip.run(as_events).digest, slip.run(both).digest)
        for code, make in {
            "usage": lambda: nsim.Events(events[:, :2], steps=50),
            "input.shape": lambda: nsim.Events(events, steps=10),
        }.items():
            with self.assertRaises(nsim.Error) as caught:
                make()
            self.assertEqual(caught.exception.code, code)
        with self.assertRaises(nsim.Error) as caught:
            self.mapping.run(nsim.Events([[0, 0, 78]], steps=50))
        self.assertIn("event 0: channel 78 is not below 78", str(caught.exception))

    def test_data_frames(self):
        try:
            import pandas
        except ImportError:
            self.skipTest("pandas is absent")
        spikes = np.ones((2, 78, 40), np.uint8)
        run, energy = self.mapping.run(spikes), self.mapping.energy(spikes)
        self.assertIsInstance(run.table(), pandas.DataFrame)
        self.assertEqual(list(run.table()["spikes"]), [row["spikes"] for row in run.json()["populations"]])
        self.assertEqual(list(energy.table()["unit"]), [row["unit"] for row in energy.rows])

    def test_labels_and_spikes(self):
        run = self.mapping.run(np.ones((2, 78, 40), np.uint8), labels=[0, 1])
        self.assertEqual((run.labels, len(run)), ([0, 1], 2))
        self.assertEqual(run.spikes.shape[1], 3)
        counted = np.zeros_like(run.counts)
        np.add.at(counted, (run.spikes[:, 0], run.spikes[:, 2]), 1)
        self.assertEqual(counted.tolist(), run.counts.tolist())


class Errors(unittest.TestCase):
    def raised(self, call):
        with self.assertRaises(nsim.Error) as caught:
            call()
        return caught.exception

    def test_errors_have_code_place_and_help(self):
        error = self.raised(lambda: nsim.load("no-such-model"))
        self.assertEqual(error.code, "model.unknown")
        self.assertIn("path to a .ron file", error.help)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "m.ron")
            with open(path, "w") as file:
                file.write('Network(name: "x",\n  oops: 1)')
            error = self.raised(lambda: nsim.load(path))
            self.assertTrue(error.place.startswith(path + ":2:"), error.place)

    def test_options_of_load_are_for_files_of_other_tools(self):
        self.assertEqual(self.raised(lambda: nsim.load("vtsnn-slip", dt_ms=2.0)).code, "usage")
        with self.assertRaises(TypeError):
            nsim.load("vtsnn-slip", dt=2.0)

    def test_a_bias_beyond_its_field_is_refused_once_with_its_bounds(self):
        def network(bias):
            populations = [{"name": "in", "shape": 3, "kind": "Input"}, {"name": "out", "shape": 2, "du": 4096, "dv": 128, "vth": 1, "bias": bias}]
            return nsim.Network("x", populations, [{"from": "in", "to": "out", "weights": np.full((2, 3), 0.4)}], output="out")

        error = self.raised(lambda: network(np.array([0.1, 50])))
        self.assertEqual((error.code, len(error.reasons), str(error).count("compartment 1")), ("model.range", 1, 1))
        most = float(error.help.split("limit it to ")[1].split(" ")[0])
        network(np.array([0.1, 0.999 * most]))
        self.assertEqual(self.raised(lambda: network(np.array([0.1, 1.001 * most]))).code, "model.range")

    def test_what_does_not_fit_is_refused(self):
        network = nsim.load("vtsnn-slip")
        self.assertEqual(self.raised(lambda: network.map("tiny", copies=4096)).code, "map.does-not-fit")
        mapping = nsim.load("container-tactile").map()
        self.assertEqual(self.raised(lambda: mapping.run(np.zeros((3, 7, 9)))).code, "input.shape")
        self.assertEqual(self.raised(lambda: mapping.run(samples=(5, 2))).code, "usage")
        self.assertEqual(self.raised(lambda: network.map(strategy="best")).code, "usage")
        with self.assertRaises(TypeError):
            mapping.run(sample=3)


if __name__ == "__main__":
    unittest.main()
