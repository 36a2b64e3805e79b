"""Networks that Python makes: converted, trained, saved; each as by the command line. NSIM names the program to compare with."""

import json
import os
import subprocess
import tempfile
import unittest
import warnings
from pathlib import Path

import numpy as np

import nsim

NSIM = os.environ.get("NSIM", "nsim")
# The program is started in other folders.
NSIM = os.path.abspath(NSIM) if os.sep in NSIM else NSIM
# Wall-clock seconds differ from call to call, and Python names no files.
APART = {"seconds", "output", "model", "next", "warnings", "checksum"}

CONFIG = """Training(
    name: "small",
    timestep_ms: 1.0,
    inputs: [(name: "touch", shape: [12])],
    layers: [(name: "hidden", from: ["touch"], size: 8), (name: "out", from: ["hidden"], size: 2)],
    neuron: Loihi(tau_u_ms: Same(5), tau_v_ms: Same(8), weight_scale: 16, theta: 10, refractory: 2, credit: UpToReset),
    loss: SpikeCount(right: 12, wrong: 2),
    optimiser: Adam(rate: 0.1),
    batch: 4,
    epochs: 12,
    seed: 3,
)"""


def command(*words, folder=None):
    done = subprocess.run([NSIM, *words, "--format", "json"], capture_output=True, text=True, cwd=folder)
    if not done.stdout:
        raise AssertionError(done.stderr)
    return json.loads(done.stdout)


def without(result, apart=APART):
    return {key: value for key, value in result.items() if key not in apart}


def contents(folder, stem):
    return [Path(folder, stem + end).read_bytes() for end in (".ron", ".safetensors")]


def two_classes(samples=16, steps=40):
    """Spikes `[samples, 12, T]` and labels: a class fires its own half of the channels more often."""
    rng = np.random.default_rng(5)
    labels = np.arange(samples) % 2
    often = np.where((np.arange(12) >= 6)[None, :] == labels[:, None], 0.4, 0.1)
    return (rng.random((samples, 12, steps)) < often[:, :, None]).astype(np.uint8), labels.tolist()


def small(inputs, threshold, weights):
    """A network of two outputs in integers."""
    populations = [
        {"name": "in", "shape": inputs, "kind": "Input"},
        {"name": "out", "shape": 2, "du": 4096, "dv": 300, "vth_mant": threshold},
    ]
    return nsim.Network("small", populations, [{"from": "in", "to": "out", "weights": weights}], output="out")


class Converted(unittest.TestCase):
    def both(self, line, spikes=None, **options):
        with tempfile.TemporaryDirectory() as folder:
            theirs = command("convert", *line, "-o", "a.ron", folder=folder)
            conversion = nsim.load(line[0]).convert(spikes, **options)
            conversion.save(os.path.join(folder, "b.ron"))
            ours, (model, weights) = conversion.json(), contents(folder, "a")
            self.assertEqual(without(ours), without(theirs))
            self.assertEqual(contents(folder, "b"), [model.replace(b"a.safetensors", b"b.safetensors"), weights])
            digest = command("run", "a.ron", "--input", "scene:slip?samples=2", "--engine", "fast", folder=folder)["digest"]
        self.assertEqual(conversion.network.map().run("scene:slip?samples=2").digest, digest)
        self.assertIn("<table>", conversion._repr_html_())

    def test_as_the_command_line(self):
        self.both(["vtsnn-slip-srm", "--samples", "0..3", "--calibration-samples", "4"], samples=(0, 3), calibration_samples=4)

    def test_fine_tuned(self):
        line = ["vtsnn-slip-srm", "--samples", "0..2", "--calibration-samples", "3", "--fine-tune", "1"]
        train = "scene:slip?samples=6&seed=1"
        self.both([*line, "--train", train], samples=(0, 2), calibration_samples=3, fine_tune=1, train=train)

    def test_what_cannot_be_converted(self):
        for code, call in {
            "convert.integers": lambda: small(4, 90, np.ones((2, 4))).convert(np.ones((1, 4, 10), np.uint8)),
            "convert.training": lambda: nsim.load("vtsnn-slip-srm").convert(samples=(0, 1), fine_tune=1, training="none"),
            "usage": lambda: nsim.load("vtsnn-slip-srm").convert(train="scene:slip"),
        }.items():
            with self.assertRaises(nsim.Error) as raised:
                call()
            self.assertEqual(raised.exception.code, code)


class Agreed(unittest.TestCase):
    def test_with_a_network_and_with_its_file(self):
        trained = nsim.load("vtsnn-slip-srm")
        conversion = trained.convert(samples=(0, 3), calibration_samples=4)
        network = conversion.network
        said = " ".join(str(conversion).split())
        self.assertRegex(said, r"accuracy [01]\.\d+ as trained, [01]\.\d+ converted, on 3 ")
        agreement = trained.agree(samples=(0, 3), against=conversion)
        said = " ".join(str(agreement).split())
        self.assertIn("vtsnn-slip-srm, the trained network (a) and vtsnn-slip-srm, the converted network as deployed", said)
        self.assertEqual(conversion.json()["held_out"]["accuracy"], agreement.json()["accuracy_b"])
        with self.assertRaises(nsim.Error) as raised:
            trained.agree(samples=(0, 3), conversion=conversion)
        self.assertIn("against=", raised.exception.help)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "b.ron")
            network.save(path)
            theirs = command("agree", "vtsnn-slip-srm", "--samples", "0..3", "--against", path)
            ours = [trained.agree(samples=(0, 3), against=other).json() for other in (network, path)]
        self.assertEqual([without(one) for one in ours], [without(theirs)] * 2)
        self.assertEqual(ours[0]["against"], "another model")
        # The conversion compared with itself is not the trained network.
        said = " ".join(str(network.agree(samples=(0, 3))).split())
        self.assertIn("was converted from vtsnn-slip-srm", said)
        self.assertIn("network.agree(spikes, against=conversion)", said)
        self.assertIn("(a: the conversion, real numbers)", said)
        for wrong in ("nothing.ron", 3):
            with self.assertRaises(nsim.Error) as raised:
                trained.agree(samples=(0, 1), against=wrong)
            self.assertIn("nsim.Network", raised.exception.help)

    def test_a_picture_and_what_to_do_next(self):
        trained = nsim.load("vtsnn-slip-srm")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "first.svg")
            agreement = trained.agree(samples=(0, 3), calibration_samples=4, plot=path)
            self.assertIn("<svg", Path(path).read_text())
            with self.assertRaises(nsim.Error) as raised:
                trained.agree(samples=(0, 3), plot=path)
            self.assertIn("force=True", raised.exception.help)
        following = agreement.json()["next"]
        self.assertTrue(following["command"].startswith("network."), following)
        self.assertIn("next:", str(agreement))
        self.assertEqual(agreement._repr_html_().count("<table>"), 2)

    def test_spikes_that_carry_a_value(self):
        populations = [
            {"name": "in", "shape": 4, "kind": "Input", "payload": 3},
            {"name": "out", "shape": 2, "du": 4096, "dv": 300, "vth_mant": 900},
        ]
        weights = [{"from": "in", "to": "out", "weights": np.full((2, 4), 40)}]
        spikes = np.ones((1, 4, 9), np.uint8)
        build = lambda: nsim.Network("valued", populations, weights, output="out").map("oheo-gulch").run(spikes).counts.sum()
        three = build()
        populations[0]["payload"] = 1
        self.assertGreater(three, build())
        populations[0] = {"name": "in", "shape": 4, "kind": "Input", "message_bits": 8}
        self.assertGreater(build(), 0)
        populations[1]["message_bits"] = 8
        with self.assertRaisesRegex(TypeError, "message_bits"):
            build()

    def test_neurons_that_subtract(self):
        populations = [
            {"name": "in", "shape": 4, "kind": "Input"},
            {"name": "out", "shape": 2, "kind": "SoftReset", "du": 4096, "dv": 300, "vth_mant": 3},
        ]
        network = nsim.Network("soft", populations, [{"from": "in", "to": "out", "weights": np.full((2, 4), 40)}], output="out")
        spikes = np.ones((2, 4, 12), np.uint8)
        with self.assertWarnsRegex(nsim.Warning, "nahuku-32, .* for oheo-gulch"):
            self.assertEqual(network.agree(spikes).json()["target"], "oheo-gulch")
        # A network that does not fit on the target of the other is compared in the opposite order, as the help says.
        reset = small(4, 40, np.full((2, 4), 40))
        with self.assertRaises(nsim.Error) as raised:
            reset.agree(spikes, against=network)
        self.assertIn("call agree of that network, with this one as against=", raised.exception.help)
        with self.assertWarns(nsim.Warning):
            network.agree(spikes, against=reset)
        with self.assertRaises(nsim.Error) as raised:
            network.map()
        for word in ("target='oheo-gulch'", "network.convert(spikes)", "reset_mechanism='zero'"):
            self.assertIn(word, raised.exception.help)
        with self.assertRaises(nsim.Error) as raised:
            network.map("loihi2")
        self.assertIn("'oheo-gulch'", raised.exception.help)


class NotHelped(unittest.TestCase):
    """Networks in real numbers whose weights round, which no conversion can improve."""

    def setUp(self):
        rng = np.random.default_rng(2)
        lif = {key: np.full(6, value) for key, value in (("tau", 1e-3), ("r", 10.0), ("v_leak", 0.0), ("v_threshold", 1.0))}
        nodes = {
            "input": {"type": "Input", "shape": np.array([12])},
            "fc": {"type": "Linear", "weight": np.where(np.arange(12) == 0, 30.0, rng.normal(0.05, 0.3, (6, 12)))},
            "lif": {"type": "LIF", **lif},
            "output": {"type": "Output"},
        }
        way = list(nodes)
        self.nodes, self.edges = nodes, list(zip(way, way[1:]))
        self.spikes = rng.random((8, 12, 60)) < 0.3

    def network(self, reset):
        return nsim._nsim.from_nodes("x", self.nodes, self.edges, [], dt_ms=0.1, reset=reset)

    def test_agree_names_its_target_and_nothing_that_gains_nothing(self):
        network = self.network("subtract")
        for options, named in (({}, "oheo-gulch"), ({"target": "kapoho-point"}, "kapoho-point")):
            agreement = network.agree(self.spikes, **options)
            following = agreement.json()["next"]["command"]
            self.assertEqual(following, f"network.agree(spikes, target='{named}', plot='first.svg')")
            with tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, "first.svg")
                again = eval(following.replace("first.svg", path), {"network": network, "spikes": self.spikes})
                self.assertIn("<svg", Path(path).read_text())
            self.assertEqual(again.json()["layers"], agreement.json()["layers"])
            said = " ".join(str(agreement).split())
            self.assertIn("Remedy: weights of a layer that are similar in size", said)
            self.assertNotIn("conversion", said)

    def test_a_conversion_runs_where_it_is_deployed_and_is_told_from_what_was_trained(self):
        network = self.network("subtract")
        with warnings.catch_warnings():
            warnings.simplefilter("error", nsim.Warning)
            conversion = network.convert(self.spikes)
            said = " ".join(str(network.agree(self.spikes, against=conversion)).split())
        self.assertIn("x, the trained network (a) and x, the converted network as deployed on simulated cores of nahuku-32 (b)", said)
        self.assertIn("(a: the trained network, real numbers)", " ".join(str(network.agree(self.spikes)).split()))
        with self.assertRaises(nsim.Error) as raised:
            conversion.network.agree(self.spikes, against=network)
        self.assertNotIn("other.", raised.exception.help)
        with self.assertRaises(nsim.Error) as raised:
            network.convert(self.spikes, fine_tune=3)
        self.assertIn("reset to zero", raised.exception.help)
        with self.assertRaises(nsim.Error) as raised:
            network.map()
        for word in ("needs no conversion", "network.convert(spikes)", "target='oheo-gulch'"):
            self.assertIn(word, raised.exception.help)

    def test_a_model_is_not_written_under_the_name_of_another_format(self):
        with tempfile.TemporaryDirectory() as folder:
            for ending in ("pt", "nir", "npy"):
                with self.assertRaises(nsim.Error) as raised:
                    self.network("zero").save(os.path.join(folder, f"q.{ending}"), force=True)
                self.assertEqual((raised.exception.code, raised.exception.help), ("write.ending", f"name it {os.path.join(folder, 'q.ron')}"))
            self.assertEqual(os.listdir(folder), [])

    def test_a_conversion_searches_on_arrays_and_is_not_fine_tuned(self):
        network = self.network("zero")
        halves = network.convert(self.spikes)
        named = network.convert(self.spikes[4:], calibrate=self.spikes[:4])
        self.assertEqual((named.stages, named.class_agreement), (halves.stages, halves.class_agreement))
        turned = network.convert(np.moveaxis(self.spikes[4:], -1, 1), calibrate=np.moveaxis(self.spikes[:4], -1, 1), time_first=True)
        self.assertEqual(turned.stages, halves.stages)
        with self.assertRaises(nsim.Error) as raised:
            network.convert(self.spikes, fine_tune=2)
        self.assertEqual(raised.exception.code, "convert.fine-tune")
        self.assertIn("spike response neurons", raised.exception.help)
        self.assertIn("docs/tutorials/rounded-weights.md", raised.exception.help)


class Tables(unittest.TestCase):
    def setUp(self):
        try:
            import pandas  # noqa: F401
        except ImportError:
            self.skipTest("pandas is absent")

    def test_no_cell_holds_a_dictionary(self):
        mapping = nsim.load("vtsnn-slip").map()
        run = mapping.run(samples=(0, 3))
        energy = mapping.energy(samples=(0, 3)).table()
        for frame in (run.table(), run.samples(), energy):
            self.assertFalse(any(isinstance(cell, dict) for column in frame for cell in frame[column]))
        self.assertTrue({"energy_low_uj", "energy_high_uj", "latency_low_us"} <= set(energy.columns), energy.columns)
        samples = run.samples()
        self.assertEqual(samples["predicted"].tolist(), run.predicted)
        self.assertEqual(samples[["counts_0", "counts_1"]].to_numpy().tolist(), run.counts.tolist())


class Trained(unittest.TestCase):
    def test_as_the_command_line(self):
        spikes, labels = two_classes()
        with tempfile.TemporaryDirectory() as folder:
            np.save(os.path.join(folder, "x.npy"), spikes)
            np.save(os.path.join(folder, "y.npy"), np.array(labels))
            with open(os.path.join(folder, "c.ron"), "w") as file:
                file.write(CONFIG)
            entries = [f'(files: {{"touch": "{n}.npy"}}, label: {label})' for n, label in enumerate(labels)]
            for n, sample in enumerate(spikes):
                np.save(os.path.join(folder, f"{n}.npy"), sample)
            with open(os.path.join(folder, "set.ron"), "w") as file:
                file.write(f'DataSet(name: "set", populations: {{"touch": "touch"}}, steps: 40, samples: [{", ".join(entries)}])')
            line = ["--train", "set.ron", "--test", "set.ron", "--folds", "2", "--set", "batch=8", "--seed", "4"]
            theirs = command("train", "c.ron", *line, "-o", "a.ron", "--log", "a.csv", folder=folder)
            pair = (spikes, labels)
            path = os.path.join(folder, "c.ron")
            training = nsim.train(path, train=pair, test=pair, folds=2, set={"batch": 8}, seed=4)
            self.assertEqual(without(training.json()), without(theirs))
            self.assertEqual(training.csv(), Path(folder, "a.csv").read_text())
            training.save(os.path.join(folder, "b.ron"))
            model, weights = contents(folder, "a")
            self.assertEqual(contents(folder, "b"), [model.replace(b"a.safetensors", b"b.safetensors").replace(b'name: "a"', b'name: "b"'), weights])
            with self.assertRaises(nsim.Error) as raised:
                training.save(os.path.join(folder, "b.ron"))
            self.assertTrue(raised.exception.code.startswith("write."), raised.exception.code)
        # The trained network runs.
        run = training.network.map().run(spikes, labels=labels)
        self.assertEqual((run.digest, run.accuracy), (training.digest, training.test_accuracy))
        self.assertGreater(training.train_accuracy, 0.5)
        self.assertEqual(len(training.history), 12)

    def test_text_time_first_and_checkpoints(self):
        spikes, labels = two_classes()
        whole = nsim.train(CONFIG, train=(spikes, labels))
        turned = np.ascontiguousarray(spikes.transpose(0, 2, 1))
        self.assertEqual(nsim.train(CONFIG, train=(turned, labels), time_first=True).digest, whole.digest)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "state.safetensors")
            nsim.train(CONFIG, train=(spikes, labels), checkpoint=path)
            again = nsim.train(CONFIG, train=(spikes, labels), checkpoint=path)
        self.assertEqual((again.digest, again.history), (whole.digest, whole.history))

    def test_what_cannot_be_trained(self):
        spikes, labels = two_classes(4)
        for code, call in {
            "train.label": lambda: nsim.train(CONFIG, train=(spikes, [0, 1, 2, 3])),
            "usage": lambda: nsim.train(CONFIG),
            "input.shape": lambda: nsim.train(CONFIG, train=(spikes[:, :5], labels)),
            "train.syntax": lambda: nsim.train(CONFIG.replace("batch", "batches"), train=(spikes, labels)),
        }.items():
            with self.assertRaises(nsim.Error) as raised:
                call()
            self.assertEqual(raised.exception.code, code)
        with self.assertRaises(nsim.Error):
            nsim.train(CONFIG, train=(spikes, labels), folds=1)
        with self.assertRaises(TypeError):
            nsim.train(CONFIG, train=(spikes, labels), epoch=3)


class Kept(unittest.TestCase):
    def test_a_network_is_saved(self):
        network = small(12, 90, np.arange(-12, 12).reshape(2, 12) * 2)
        spikes, _ = two_classes()
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "small.ron")
            files = network.save(path)
            self.assertEqual([os.path.exists(file) for file in files], [True] * len(files))
            self.assertEqual(nsim.load(path).map().run(spikes).digest, network.map().run(spikes).digest)

    def test_a_page(self):
        with tempfile.TemporaryDirectory() as folder:
            ours, theirs = (os.path.join(folder, name) for name in ("a.html", "b.html"))
            nsim.load("vtsnn-slip-srm").report(ours, samples=(0, 2), baselines=["rtx-2080-ti"])
            line = ["report", "vtsnn-slip-srm", "--samples", "0..2", "--baseline", "rtx-2080-ti", "-o", theirs]
            subprocess.run([NSIM, *line], check=True, capture_output=True)
            pages = [Path(path).read_text(encoding="utf-8") for path in (ours, theirs)]
            self.assertIn("coincidence", pages[0])
            # They differ only in the command and in the name of the model.
            differing = [pair for pair in zip(*(page.splitlines() for page in pages)) if pair[0] != pair[1]]
            self.assertLessEqual(len(differing), 2)
            with self.assertRaises(nsim.Error):
                nsim.load("vtsnn-slip").map().report(ours)
            nsim.load("vtsnn-slip").map().report(ours, samples=(0, 1), force=True)


class Warned(unittest.TestCase):
    def mapping(self, threshold):
        return small(4, threshold, np.full((2, 4), 10)).map()

    def test_the_first_run_warns(self):
        spikes = np.ones((1, 4, 10), np.uint8)
        mapping = self.mapping(100_000)
        with self.assertWarnsRegex(nsim.Warning, "'out': the output never spikes"):
            run = mapping.run(spikes)
        self.assertEqual([warning["code"] for warning in run.warnings], ["silent-output"])
        self.assertEqual(run.json()["warnings"], run.warnings)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            mapping.run(spikes)
            self.mapping(3).run(spikes)

    def test_energies_warn_too(self):
        with self.assertWarns(nsim.Warning):
            self.mapping(100_000).energy(np.ones((1, 4, 10), np.uint8))


class Timed(unittest.TestCase):
    def test_steps_are_counted(self):
        timed = nsim.load("vtsnn-slip").map(copies=2).bench(seconds=0.05)
        self.assertGreater(timed["us_per_timestep"], 0)
        self.assertLessEqual(timed["fastest_us"], timed["us_per_timestep"])
        self.assertGreater(timed["synaptic_events"], 0)
        with self.assertRaises(nsim.Error):
            nsim.load("vtsnn-slip").map().bench(seconds=0)


if __name__ == "__main__":
    unittest.main()
