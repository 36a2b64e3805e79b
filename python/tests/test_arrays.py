"""Arrays of every type, layout and size for every argument: the spikes equal NumPy's counts, and other arrays are refused with a remedy.

Calls that could end the interpreter or never return run in a process of their own, with little memory."""

import json
import os
import re
import subprocess
import sys
import tempfile
import textwrap
import unittest
import warnings

import numpy as np

import nsim

try:
    import scipy.sparse as sparse
except ImportError:
    sparse = None
    print("absent: scipy, sparse weights were not tested", file=sys.stderr)

CHANNELS, STEPS = 4, 40
TYPES = ["?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8", ">u2", ">i4", ">i8", ">f4", ">f8"]


def network(weights=None, inputs=CHANNELS, neurons=2, **changed):
    weights = np.full((neurons, inputs), 60) if weights is None else weights
    populations = [
        {"name": "in", "shape": inputs, "kind": "Input"},
        {"name": "out", "shape": neurons, "du": 4095, "dv": 0, "vth_mant": 3, **changed},
    ]
    return nsim.Network("small", populations, [{"from": "in", "to": "out", "weights": weights}], output="out")


def camera(steps_ms=1.0):
    populations = [
        {"name": "in", "shape": [2, 3, 5], "kind": "Input"},
        {"name": "out", "shape": 2, "du": 4095, "dv": 0, "vth_mant": 3},
    ]
    projections = [{"from": "in", "to": "out", "weights": np.full((2, 30), 60)}]
    return nsim.Network("camera", populations, projections, output="out", timestep_ms=steps_ms).map("loihi1-chip")


def records(t, x, y, p, time="t"):
    array = np.zeros(len(t), [("x", "<i2"), ("y", "<i2"), ("p", "?"), (time, "<i8")])
    array["x"], array["y"], array["p"], array[time] = x, y, p, t
    return array


def layouts(array):
    """Arrays with these numbers in other layouts."""
    yield array
    yield np.asfortranarray(array)
    yield np.repeat(array, 2, axis=-1)[..., ::2]
    yield np.flip(np.flip(array, -1).copy(), -1)
    yield np.moveaxis(np.moveaxis(array, -1, 0).copy(), 0, -1)
    packed = np.zeros(array.shape, [("a", "u1"), ("b", array.dtype)])
    packed["b"] = array
    yield packed["b"]
    array = array.copy()
    array.flags.writeable = False
    yield array


class Case(unittest.TestCase):
    def setUp(self):
        self.mapping = network().map("loihi1-chip")
        warnings.simplefilter("ignore", nsim.Warning)

    def refused(self, call, *words, code=None):
        with self.assertRaises(nsim.Error) as caught:
            call()
        error = caught.exception
        for word in words:
            self.assertIn(word, str(error))
        self.assertTrue(error.help, error)
        self.assertIn(error.help, str(error))
        self.assertEqual([reason["code"] for reason in error.reasons][0], error.code)
        if code is not None:
            self.assertEqual(error.code, code, error)
        return error

    def alone(self, body, memory_kib=4_000_000):
        """Runs lines with `mapping` in an interpreter of its own; returns its output."""
        script = "import os, numpy as np, nsim, test_arrays\nmapping = test_arrays.network().map('loihi1-chip')\n"
        words = ["bash", "-c", f"ulimit -v {memory_kib}; exec \"$0\" -c \"$1\"", sys.executable, script + textwrap.dedent(body)]
        here = os.path.dirname(os.path.abspath(__file__))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "2"}
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, env=environment, cwd=here)
        self.assertEqual(done.returncode, 0, done.stderr[-2000:])
        return done.stdout.split()


class Spikes(Case):
    def test_truth_values_are_counted_as_numpy_counts_them(self):
        rng = np.random.default_rng(1)
        for _ in range(20):
            mask = (rng.integers(0, 256, (3, CHANNELS, STEPS)) * (rng.random((3, CHANNELS, STEPS)) < 0.3)).astype("u1")
            spikes = mask.view(bool)
            for array in [spikes, spikes[::2], spikes.transpose(0, 2, 1).copy().transpose(0, 2, 1), spikes[0]]:
                run = self.mapping.run(array)
                self.assertEqual(run.activity["spikes_in"], np.count_nonzero(array))
                self.assertEqual(run.digest, self.mapping.run((array.view("u1") != 0).astype("i4")).digest)

    def test_every_type_in_every_layout_means_the_same(self):
        rng = np.random.default_rng(2)
        spikes = rng.random((2, CHANNELS, STEPS)) < 0.4
        want = self.mapping.run(spikes.astype("u1")).digest
        for name in TYPES:
            for number, array in enumerate(layouts(spikes.astype(name))):
                with self.subTest(type=name, layout=number):
                    self.assertEqual(self.mapping.run(array).digest, want)
                    self.assertEqual(self.mapping.run(array[0]).activity["spikes_in"], spikes[0].sum())
                    time_first = np.moveaxis(array, -1, 1)
                    self.assertEqual(self.mapping.run(time_first, time_first=True).digest, want)
        self.assertEqual(self.mapping.run(spikes.tolist()).digest, want)
        self.assertEqual(self.mapping.run({"in": spikes}).digest, want)
        repeated = np.broadcast_to(spikes[0], (7, CHANNELS, STEPS))
        self.assertEqual(self.mapping.run(repeated).digest, self.mapping.run(repeated.copy()).digest)

    def test_one_value_is_a_spike_and_several_are_counts_and_minus_zero_is_none(self):
        for kind in ["i1", "u1", "i8", "u8", "f4"]:
            greatest = 127 if "1" in kind else np.iinfo(kind).max if "8" in kind else 3e38
            for one in (1, greatest):
                spikes = np.zeros((CHANNELS, 40), kind)
                spikes[2, 33] = spikes[3, 1] = one
                self.assertEqual(self.mapping.run(spikes).activity["spikes_in"], 2)
            spikes[2, 33], spikes[2, 35] = 1, 2
            words = ("2 of 3 entries other than 0 are greater than 1",)
            error = self.refused(lambda: self.mapping.run(spikes), *words, code="input.value")
            # The printed remedies.
            self.assertRegex(error.help, "array != 0 .* array >= 2 .* message_bits")
            self.assertEqual(self.mapping.run(spikes != 0).activity["spikes_in"], 3)
            self.assertEqual(self.mapping.run(spikes >= 2).activity["spikes_in"], 2)
        spikes = np.zeros((CHANNELS, 4))
        spikes[2] = [-0.0, 0, 0, 1]
        self.assertEqual(self.mapping.run(spikes).activity["spikes_in"], 1)

    def test_a_negative_number_is_no_spike(self):
        for kind in ["i1", "i2", "i8", "f2", "f8"]:
            spikes = np.zeros((2, CHANNELS, 40), kind)
            spikes[1, 2, 35], spikes[0, 1, 3] = -1, 1
            for array in layouts(spikes):
                error = self.refused(lambda: self.mapping.run(array), "spikes[1, 2, 35] is -1", code="input.value")
            self.assertEqual(self.mapping.run(spikes != 0).activity["spikes_in"], 2)
        self.assertIn("array != 0", error.help)

    def test_time_before_samples_is_not_guessed(self):
        spikes = np.random.default_rng(4).random((3, CHANNELS, 7)) < 0.4
        want = self.mapping.run(spikes).digest
        for array, words in [(np.moveaxis(spikes, -1, 0), "[T, samples, channels..]"), (np.moveaxis(spikes, -1, 1), "[samples, T, channels..]")]:
            help = self.refused(lambda: self.mapping.run(array), code="input.shape").help
            for word in ("[T, samples, channels..]", "[samples, T, channels..]", "time_first=True", words):
                self.assertIn(word, help)
            remedy = re.search(r"numpy\.moveaxis\(.*\)", help).group()
            moved = eval(remedy, {"numpy": np, "array": array})
            self.assertEqual([want], [self.mapping.run(moved).digest] if words.startswith("[T") else [self.mapping.run(array, time_first=True).digest])
        # The remedy of one reading for the other.
        early = np.moveaxis(spikes, -1, 0)
        help = self.refused(lambda: self.mapping.run(early, time_first=True, labels=[0] * 3), "7 samples", code="usage").help
        self.assertIn("numpy.moveaxis(numpy.asarray(array), 0, -1)", help)
        # Without time.
        step = spikes[..., 0]
        help = self.refused(lambda: self.mapping.run(step)).help
        self.assertIn("array[..., None]", help)
        self.assertEqual(self.mapping.run(step[..., None]).steps, [1] * 3)

    def test_channels_are_one_axis_or_those_of_the_population(self):
        mapping, draw = camera(), np.random.default_rng(5)
        spikes = draw.random((4, 2, 3, 5, 6)) < 0.3
        want = mapping.run(spikes).digest
        for same in [spikes.reshape(4, 30, 6), spikes.reshape(4, 2, 1, 3, 5, 6), spikes.reshape(4, 1, 30, 6)]:
            self.assertEqual(mapping.run(same).digest, want)
        for other in [spikes.transpose(0, 2, 3, 1, 4), spikes.reshape(4, 6, 5, 6), spikes.reshape(4, 5, 3, 2, 6), spikes[0].transpose(1, 2, 0, 3)]:
            error = self.refused(lambda: mapping.run(other), "[2, 3, 5] channels", code="input.shape")
            self.assertIn("numpy.moveaxis(array, FROM, TO)", error.help)
        last = spikes.transpose(0, 2, 3, 1, 4)
        self.assertEqual(mapping.run(np.moveaxis(last, 3, 1)).digest, want)
        first = np.moveaxis(spikes, -1, 1)
        self.assertEqual(mapping.run(first, time_first=True).digest, want)
        self.refused(lambda: mapping.run(first.transpose(0, 1, 3, 4, 2), time_first=True), code="input.shape")

    def test_what_is_no_number_is_refused(self):
        good = np.zeros((CHANNELS, STEPS))
        for value in [np.nan, np.inf, -np.inf]:
            bad = good.copy()
            bad[3, 7] = value
            for array in layouts(bad):
                self.refused(lambda: self.mapping.run(array), "spikes[3, 7]", "finite", code="input.array")
            self.refused(lambda: self.mapping.run({"in": bad.astype("f4")}), "spikes['in'][3, 7]")
        masked = np.ma.masked_array(good, good == 0)
        for array in [masked, [masked, masked], (masked,)]:
            self.refused(lambda: self.mapping.run(array), "masked", code="input.array")
        self.mapping.run(masked.filled(0))
        for array, word in [
            (good.astype("c16"), "complex"),
            (good.astype("O"), "objects"),
            (good.astype("S3"), "text"),
            (good.astype("U3"), "text"),
            (good.astype("m8[us]"), "durations"),
            (good.astype("M8[us]"), "durations"),
            (good.astype("V8"), "raw"),
            (good.view([("a", "f4"), ("b", "f4")]), "records"),
            ([[0, 1], [1]], "spikes"),
            ([None], "objects"),
            (object(), "objects"),
            ({1, 2}, "objects"),
            (iter([1]), "objects"),
        ]:
            self.refused(lambda: self.mapping.run(array), word, code="input.array")
        if np.dtype("g").itemsize > 8:
            self.refused(lambda: self.mapping.run(good.astype("g")), "long")
        if sparse is not None:
            self.refused(lambda: self.mapping.run(sparse.csr_matrix(good)), "toarray")

    def test_shapes_that_hold_no_sample_are_refused(self):
        for array in [5, np.float32(1), np.array(True), np.zeros(0), np.zeros((CHANNELS, 0)), np.zeros((0, CHANNELS, STEPS)), b"abc"]:
            self.refused(lambda: self.mapping.run(array))
        for array in [np.zeros(0), np.zeros((CHANNELS, 0)), np.zeros((0, CHANNELS, STEPS))]:
            self.refused(lambda: self.mapping.run(array), "is empty", code="input.shape")
        self.refused(lambda: self.mapping.run([]), "empty", code="usage")
        error = self.refused(lambda: self.mapping.run(np.zeros((STEPS, CHANNELS))), code="input.shape")
        self.assertIn("time_first=True", error.help)
        self.mapping.run(np.zeros((STEPS, CHANNELS)), time_first=True)

    def test_a_tensor_that_numpy_does_not_take_is_answered_with_what_makes_it_an_array(self):
        class Tensor:
            detach = None

            def __array__(self, *_, **__):
                raise TypeError("Got unsupported ScalarType BFloat16")

        self.refused(lambda: self.mapping.run(Tensor()), "BFloat16", ".to_dense()", ".float().numpy()", code="input.array")

    def test_fractions_are_refused_in_the_words_of_files(self):
        spikes = np.zeros((CHANNELS, STEPS))
        spikes[1, 2], spikes[2, 3] = 0.3, 0.7
        error = self.refused(lambda: self.mapping.run(spikes), "spikes[1, 2] is 0.3", code="input.value")
        self.refused(lambda: self.mapping.run([spikes.astype("f4")]), code="input.value")
        least = np.zeros((CHANNELS, STEPS))
        least[3, 4] = 5e-324
        self.refused(lambda: self.mapping.run(least), "spikes[3, 4] is 5e-324", code="input.value")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "fractions.npy")
            np.save(path, spikes)
            of_file = self.refused(lambda: self.mapping.run(path), code="input.value")
            words = "spikes are whole numbers"
            self.assertIn(words, str(of_file))
            self.assertIn(words, str(error))
            kept = self.mapping.run(f"{path}?least=0.5").activity["spikes_in"]
        # The printed remedy.
        self.assertTrue(error.help.endswith("array >= 0.5"), error.help)
        self.assertEqual(self.mapping.run(spikes >= 0.5).activity["spikes_in"], kept)
        self.mapping.run(2.0 * (spikes >= 0.5))

    def test_labels_are_whole_numbers(self):
        spikes = np.ones((3, CHANNELS, STEPS), "u1")
        for labels in [[0, 1, 1], (0, 1, 1), np.array([0.0, 1, 1]), np.array([0, 1, 1], ">i8"), np.array([0, 255, 2], "u1").view(bool)]:
            self.assertEqual(self.mapping.run(spikes, labels=labels).labels, [0, 1, 1])
        for labels in [
            [0, 1], [[0], [1], [1]], [0, 1, -1], [0, 1, 1.5], [0, 1, np.nan], [0, 1, 2**32], [0, 1, 2**70], [0, 1, None],
            ["a", "b", "c"], [0, 1, 1j], np.ma.array([0, 1, 1], mask=[0, 0, 1]), 5, np.eye(3), [[0], [1, 2], 1],
        ]:
            self.refused(lambda: self.mapping.run(spikes, labels=labels), "labels")
        # The printed remedies.
        labels, unknown = np.array([[0], [1], [1]]), np.array([0, 1, np.nan])
        with self.assertRaisesRegex(nsim.Error, r"labels\[:, 0\]"):
            self.mapping.run(spikes, labels=labels)
        self.assertEqual(self.mapping.run(spikes, labels=labels[:, 0]).labels, [0, 1, 1])
        with self.assertRaisesRegex(nsim.Error, r"spikes\[numpy.isfinite\(labels\)\]"):
            self.mapping.run(spikes, labels=unknown)
        kept = np.isfinite(unknown)
        self.assertEqual(self.mapping.run(spikes[kept], labels=unknown[kept]).labels, [0, 1])
        self.refused(lambda: self.mapping.run(spikes, labels=[0, 1.5, 1]), "labels[1] is 1.5", code="input.labels")
        self.refused(lambda: self.mapping.run(spikes, labels=[0, 1, 2]), "labels[2] is 2", "from 0 to 1", code="input.labels")


class EventRows(Case):
    def test_every_type_and_layout_means_the_same(self):
        rows = np.array([[0, 1, 2], [1, 39, 3], [0, 5, 0]])
        want = self.mapping.run(nsim.Events(rows, steps=STEPS)).digest
        for name in [kind for kind in TYPES if kind != "?"]:
            for array in layouts(rows.astype(name)):
                self.assertEqual(self.mapping.run(nsim.Events(array, steps=STEPS)).digest, want, name)
        self.assertEqual(self.mapping.run(nsim.Events(rows.tolist(), steps=np.int16(STEPS))).digest, want)
        for empty in [[], np.zeros((0, 3)), np.zeros((0, 3), "u1")]:
            run = self.mapping.run(nsim.Events(empty, steps=STEPS))
            self.assertEqual((len(run), run.activity["spikes_in"]), (1, 0))

    def test_what_is_no_index_is_refused_with_its_place(self):
        good = np.array([[0, 1, 2], [1, 3, 3]])
        for column, value, what in [
            (0, 0.5, "sample"), (1, 1.9, "step"), (2, 2.7, "channel"), (0, -1, "sample"), (1, -1, "step"), (2, -1, "channel"),
            (1, 40, "step"), (1, np.nan, "finite"), (2, np.inf, "finite"), (0, 2**63, "sample"), (2, 1e300, "channel"),
        ]:
            rows = good.astype("f8")
            rows[1, column] = value
            code = "input.shape" if np.isfinite(value) else "input.array"
            self.refused(lambda: nsim.Events(rows, steps=40), f"events[1, {column}]", what, code=code)
        for rows in [
            np.array([[0, 0, 2**64 - 1]], "u8"), np.array([[0, 2**64 - 1, 0]], "u8"), good.astype("c8"), good.astype("O"),
            good.astype("U2"), good.astype(bool), np.ma.array(good, mask=good > 2), [[0, 1], [0]], [[0, 0, None]], good[:, :2], good[0], 7, None,
        ]:
            self.refused(lambda: nsim.Events(rows, steps=40))
        events = nsim.Events([[0, 0, CHANNELS]], steps=40)
        self.refused(lambda: self.mapping.run(events), "channel 4", code="input.shape")

    def test_sizes_are_bounded(self):
        for steps in [0, -1, 2**24 + 1, 10**12, 10**40]:
            self.refused(lambda: nsim.Events([[0, 0, 0]], steps=steps), "steps", code="usage")
        for samples in [0, -1, 2**24, 2**24 + 1, 10**12]:
            self.refused(lambda: nsim.Events([[0, 0, 0]], steps=5, samples=samples), "samples", code="usage")
        self.refused(lambda: nsim.Events([[2**24 - 1, 0, 0]], steps=5), "16777216 samples")
        self.refused(lambda: nsim.Events([[9, 0, 0]], steps=2**24), "samples")
        self.refused(lambda: nsim.Events([[2**24, 0, 0]], steps=5), "events[0, 0]")
        with self.assertRaises(TypeError):
            nsim.Events([[0, 0, 0]], steps=1.5)
        self.refused(lambda: nsim.Events([[0, 0, 0]]), "steps", code="usage")


class EventRecords(Case):
    def test_records_are_what_a_file_of_them_is(self):
        rng = np.random.default_rng(3)
        mapping = camera()
        made = [records(np.sort(rng.integers(0, 30_000, 60)), rng.integers(0, 5, 60), rng.integers(0, 3, 60), rng.random(60) < 0.5) for _ in range(2)]
        with tempfile.TemporaryDirectory() as folder:
            digests = []
            for array in made:
                path = os.path.join(folder, "events.csv")
                text = np.column_stack([array[name] for name in ("t", "x", "y", "p")])
                np.savetxt(path, text, fmt="%d", delimiter=",", header="t_us,x,y,p", comments="")
                digests.append(mapping.run(path).digest)
        for array, digest in zip(made, digests):
            for same in [array, array[::-1][::-1], array.view(np.recarray), [array], nsim.Events(array), nsim.Events(array, unit="us")]:
                self.assertEqual(mapping.run(same).digest, digest)
            self.assertEqual(mapping.run({"in": array}).digest, digest)
            flags = array.copy()
            flags["p"] = (array["p"].astype("u1") * 255).view(bool)
            self.assertEqual(mapping.run(flags).digest, digest)
        self.assertEqual(mapping.run(made, labels=[0, 1]).labels, [0, 1])
        self.assertEqual(len(nsim.Events(made[0])), 60)
        self.assertEqual(mapping.run(nsim.Events(made[0], steps=200)).steps, [200])
        slow = made[0].copy()
        slow["t"] *= 1000
        self.assertEqual(mapping.run(nsim.Events(slow, unit="ns")).digest, digests[0])

    def test_records_that_are_no_events_are_refused(self):
        mapping = camera()
        good = records([0, 1000], [1, 2], [0, 1], [True, False])
        for name, value in [("x", -1), ("y", -2)]:
            bad = good.copy()
            bad[name][1] = value
            self.refused(lambda: mapping.run(bad), name)
        bad = np.zeros(2, [("x", "f8"), ("y", "f8"), ("p", "f8"), ("t", "f8")])
        for name, value in [("x", 0.5), ("y", np.nan), ("p", 2), ("t", np.inf), ("t", 0.5)]:
            one = bad.copy()
            one[name][1] = value
            self.refused(lambda: mapping.run(one))
        self.refused(lambda: mapping.run(good[["x", "y"]]))
        self.refused(lambda: mapping.run(good.reshape(1, 2)), "one axis")
        self.assertIn("steps=N", self.refused(lambda: mapping.run(good[:0])).help)
        self.assertEqual(mapping.run(nsim.Events(good[:0], steps=7)).steps, [7])
        late = records([0, 10**15], [1, 2], [0, 1], [True, False])
        self.assertIn("steps=N", self.refused(lambda: mapping.run(late), code="input.too-long").help)
        self.assertEqual(mapping.run(nsim.Events(late, steps=7, unit="us")).steps, [7])
        self.refused(lambda: nsim.Events(good, samples=2), "samples")
        self.refused(lambda: nsim.Events(good, unit="min"), "unit")
        self.refused(lambda: nsim.Events([[0, 0, 0]], steps=4, unit="us"), "unit")
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            mapping.run(records([0, 1000], [1, 7], [0, 1], [True, False]))
        self.assertTrue(any("1 of 2 events" in str(one.message) for one in said))

    def test_the_remedy_for_a_file_of_records_works(self):
        mapping = camera()
        array = records([0, 2000, 9000], [1, 2, 4], [0, 1, 2], [True, False, True], time="timestamp")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "events.npy")
            np.save(path, array)
            error = self.refused(lambda: mapping.run(path), code="npy.dtype")
            advice = re.search(r"numpy\.savetxt\(.*comments=''\)", error.help).group()
            exec(advice.replace("events.csv", f"{folder}/events.csv"), {"numpy": np, "array": array})
            self.assertEqual(mapping.run(f"{folder}/events.csv").digest, mapping.run(array).digest)


class Weights(Case):
    def test_every_type_and_layout_means_the_same(self):
        rng = np.random.default_rng(4)
        weights = rng.integers(0, 60, (2, CHANNELS)) * 2
        spikes = (rng.random((3, CHANNELS, STEPS)) < 0.5).astype("u1")
        want = network(weights).map("loihi1-chip").run(spikes).digest
        for name in [kind for kind in TYPES if kind != "?"]:
            for array in layouts(weights.astype(name)):
                self.assertEqual(network(array).map("loihi1-chip").run(spikes).digest, want, name)
        flags = np.array([[255, 0, 2, 1], [0, 4, 0, 8]], "u1")
        ones = network((flags != 0).astype("i4")).map("loihi1-chip").run(spikes).digest
        self.assertEqual(network(flags.view(bool)).map("loihi1-chip").run(spikes).digest, ones)
        if sparse is not None:
            for form in [sparse.csr_array, sparse.csc_array, sparse.coo_array, sparse.coo_matrix]:
                self.assertEqual(network(form(weights)).map("loihi1-chip").run(spikes).digest, want)

    def test_what_is_no_number_is_refused(self):
        good = np.full((2, CHANNELS), 4.0)
        for value in [np.nan, np.inf]:
            bad = good.copy()
            bad[1, 2] = value
            self.refused(lambda: network(bad), "in -> out", "weights[1, 2]", code="input.array")
        for bad in [good * 1j, good.astype("O"), good.astype("U3"), np.ma.array(good, mask=good > 3), [[1, 2], [1]], "no", None and 0]:
            if bad is not None:
                self.refused(lambda: network(bad), "weights")
        self.refused(lambda: network(good[0]), "axes")
        self.refused(lambda: network(good[:, :2]))
        for bad in [np.nan, [3, np.nan], [3, 3, 3], [[3], [3, 4]], 3j, "three", np.ma.array([3, 3], mask=[0, 1]), np.array([3, None])]:
            self.refused(lambda: network(vth_mant=bad), "'out': vth_mant")
        self.refused(lambda: network(vth_mant=2**70))

    @unittest.skipIf(sparse is None, "scipy is absent")
    def test_sparse_indices_lie_within(self):
        def made(row, col, data=(4, 4), shape=(2, CHANNELS)):
            array = sparse.coo_array((np.ones(2), ([0, 1], [0, 1])), shape=shape)
            array.row, array.col = (array.coords if hasattr(array, "coords") else (None, None))
            coords = tuple(np.asarray(part) for part in (row, col))
            if hasattr(array, "coords"):
                array.coords = coords
            else:
                array.row, array.col = coords
            array.data = np.asarray(data)
            return array

        network(made([0, 1], [0, 3]))
        for row, col, word in [
            ([0, -1], [0, 1], "weights.row[1] is -1"), ([0, 2], [0, 1], "weights.row[1] is 2"),
            ([0, 1], [0, -1], "weights.col[1] is -1"), ([0, 1], [0, 4], "weights.col[1] is 4"),
            ([0, 0.5], [0, 1], "weights.row[1] is 0.5"), ([0, 1], [0, np.nan], "weights.col[1]"),
        ]:
            self.refused(lambda: network(made(row, col)), word, code="input.array")
        self.refused(lambda: network(made([0, 1, 1], [0, 1])))
        self.refused(lambda: network(made(np.broadcast_to(0, 2**40), [0, 1])))
        self.refused(lambda: network(made(np.array([False, True]), [0, 1])), "weights.row")
        for index in [-1, 4]:
            rows = sparse.csr_matrix(np.ones((2, CHANNELS)))
            rows.indices[3] = index
            self.refused(lambda: network(rows), "in -> out")
        for data in [[4, np.nan], [4, np.inf], [4, 1j], [4, None]]:
            self.refused(lambda: network(made([0, 1], [0, 1], data)), "weights.data")
        error = self.refused(lambda: network(sparse.coo_array(np.ones((CHANNELS, 2)))), "[4, 2]")
        self.assertIn(".T", error.help)
        self.refused(lambda: network(sparse.coo_array(np.ones((3, 3)))), "[3, 3]")


class Sizes(Case):
    def test_numbers_out_of_range_are_refused(self):
        spikes = np.ones((CHANNELS, 5), "u1")
        for repeat in [0, -1, 10**6 + 1, 10**12, 2**63, 10**40, -(10**40), 10**5000]:
            self.refused(lambda: self.mapping.run(spikes, repeat=repeat), "repeat", code="usage")
        self.refused(lambda: self.mapping.run(np.ones((5, CHANNELS, 5), "u1"), repeat=10**6), "5000000 runs")
        self.assertEqual(len(self.mapping.run(spikes, repeat=1000)), 1000)
        for samples in [(0, 2), (1, 1), (-1, 1), (0, 10**30)]:
            self.refused(lambda: self.mapping.run(spikes, samples=samples), "samples", code="usage")
        for copies in [0, -1, 2**32, 10**30]:
            self.refused(lambda: network().map("loihi1-chip", copies=copies), "copies", code="usage")
            self.refused(lambda: network().energy(spikes, copies=copies), "copies", code="usage")
        for steps in [0, -1, 10**12]:
            self.refused(lambda: network().agree(spikes, steps=steps), "steps", code="usage")
        for keyword in ["seed", "probe", "repeat"]:
            with self.assertRaises((TypeError, nsim.Error)) as caught:
                self.mapping.run(spikes, **{keyword: 1.5})
            self.assertIn(keyword, str(caught.exception))

    def test_claims_are_bounded_before_memory_is_taken(self):
        said = self.alone("""
            def refused(call):
                try:
                    call()
                except nsim.Error as error:
                    assert error.help, error
                    print("refused")
            one = np.ones((4, 5), "u1")
            refused(lambda: mapping.run(one, repeat=10**12))
            refused(lambda: nsim.Events([[2**24 - 1, 0, 0]], steps=5))
            refused(lambda: nsim.Events([[0, 0, 0]], steps=2**24, samples=2**24))
            for kind in ["u1", "f4", "?"]:
                many = np.broadcast_to(np.ones((), kind), (2**27, 4, 1))
                refused(lambda: mapping.run(many))
                refused(lambda: mapping.run(np.broadcast_to(np.ones((), kind), (4, 2**24))))
                refused(lambda: mapping.run(np.broadcast_to(np.ones((), kind), (2**40, 4, 2**10))))
                refused(lambda: mapping.run(one, labels=np.broadcast_to(np.ones((), kind), 2**40)))
                refused(lambda: nsim.Events(np.broadcast_to(np.zeros((), kind), (2**40, 3)), steps=5))
                refused(lambda: test_arrays.network(np.broadcast_to(np.ones((), kind), (2**20, 2**20))))
                refused(lambda: test_arrays.network(vth_mant=np.broadcast_to(np.ones((), kind), 2**40)))
            refused(lambda: mapping.run(one, probe=["out.v"] * 10**6, repeat=10**6))
            refused(lambda: test_arrays.network(inputs=2**40, weights=np.ones((2, 4))))
        """)
        self.assertEqual(len(said), 3 + 3 * 7 + 2)


@unittest.skipUnless(hasattr(os, "fork"), "there is no fork here")
class Forks(Case):
    def test_children_run(self):
        said = self.alone("""
            import signal, multiprocessing, sys
            spikes = np.ones((20, 4, 50), "u1")
            want = mapping.run(spikes).digest
            sys.stdout.flush()
            def child(depth):
                if os.fork() == 0:
                    signal.alarm(60)
                    same = mapping.run(spikes).digest == want and test_arrays.network().map("loihi1-chip").run(spikes).digest == want
                    ran = mapping.energy(spikes).energy_uj > 0 and nsim.load("vtsnn-slip").map().run(samples=(0, 2)).steps
                    if depth:
                        child(depth - 1)
                    os._exit(0 if same and ran else 3)
                assert os.wait()[1] == 0
            child(1)
            def length(spikes):
                return len(mapping.run(spikes))
            with multiprocessing.get_context("fork").Pool(2) as pool:
                print(pool.map(length, [spikes] * 4))
            print(mapping.run(spikes).digest == want)
        """, memory_kib=16_000_000)
        self.assertEqual(said, ["[20,", "20,", "20,", "20]", "True"])


class Reasons(Case):
    def test_names_in_messages_stay_as_they_are(self):
        with self.assertRaises(nsim.Error) as caught:
            nsim.load("absent--dt.ron")
        self.assertIn("absent--dt.ron", str(caught.exception))

    def test_all_reasons_are_given(self):
        with self.assertRaises(nsim.Error) as caught:
            nsim.load("vtsnn-slip").map("tiny", copies=4096)
        error = caught.exception
        self.assertEqual(error.code, "map.does-not-fit")
        program = os.environ.get("NSIM", "nsim")
        done = subprocess.run([program, "map", "vtsnn-slip", "--target", "tiny", "--copies", "4096", "--format", "json"], capture_output=True, text=True)
        self.assertEqual(error.reasons, json.loads(done.stdout)["reasons"])
        self.assertGreater(len(error.reasons), 1)
        for reason in error.reasons:
            # The message names options as Python does.
            self.assertIn(reason["help"].replace("--prune ", "prune= "), str(error))


if __name__ == "__main__":
    unittest.main()
