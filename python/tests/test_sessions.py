"""Steps give the result of a run; snapshots are restored; the page's loop runs."""

import contextlib
import io
import os
import re
import tempfile
import threading
import unittest
from pathlib import Path
from unittest import mock

import numpy as np

import nsim

PAGE = (Path(__file__).parents[2] / "docs/session.md").resolve()
NSIM = os.environ.get("NSIM", "nsim")


def recorded(mapping, steps=60, rate=0.1, seed=7):
    """Random spikes for each input population, `[channels, T]`."""
    draw = np.random.default_rng(seed)
    shapes = {name: shape for name, kind, shape in mapping.populations if kind == "input"}
    return {name: draw.random((int(np.prod(shape)), steps)) < rate for name, shape in shapes.items()}


def stepped(mapping, session, spikes, first=0, end=None, how=np.flatnonzero):
    """Spikes, membranes and currents of every population after each step."""
    seen = []
    names = [name for name, kind, _ in mapping.populations if kind != "input"]
    for t in range(first, end or next(iter(spikes.values())).shape[1]):
        session.step({name: how(array[:, t]) for name, array in spikes.items()})
        populations = [session[name] for name in names]
        seen.append([array.tolist() for p in populations for array in (p.spikes, p.v, p.u)])
    return seen


def compare_energies(test, ours, theirs):
    """The energy of a session is that of a sample, without the published job and decisions before the end."""
    figures = lambda rows: [row for row in rows if "paper" not in row["hardware"]]
    differ = {"input", "checksum", "rows", "parts", "per_decision", "per_sample", "ratios"}
    for name in set(ours) | set(theirs):
        if name not in differ:
            test.assertEqual(ours.get(name), theirs.get(name), name)
    test.assertEqual(figures(ours["rows"]), figures(theirs["rows"]))
    test.assertGreater(len(figures(ours["rows"])), 1)
    test.assertFalse(ours.get("parts") or ours.get("per_decision"))


class Sessions(unittest.TestCase):
    def test_stepping_is_running(self):
        for model, copies in [("vtsnn-slip", 1), ("container-tactile", 3)]:
            mapping = nsim.load(model).map(copies=copies)
            spikes = recorded(mapping)
            names = [name for name, kind, _ in mapping.populations if kind != "input"]
            probes = [f"{name}.{what}" for name in names for what in ("spikes", "v", "u")]
            run = mapping.run({name: array.astype(np.uint8) for name, array in spikes.items()}, probe=probes)
            probed = [run.probe(probe)[0] for probe in probes]
            # Numbers, lists, truth values and other integers are equivalent.
            listed = lambda array: np.flatnonzero(array).tolist()
            narrow = lambda array: np.flatnonzero(array)[::-1].astype(np.int16)
            for how in (np.flatnonzero, np.asarray, listed, narrow):
                with self.subTest(model=model), mapping.session() as session:
                    seen = stepped(mapping, session, spikes, how=how)
                    for t, values in enumerate(seen):
                        for at, probe in enumerate(probed):
                            expected = np.flatnonzero(probe[:, t]) if at % 3 == 0 else probe[:, t]
                            self.assertEqual(values[at], expected.tolist(), f"{probes[at]}, step {t}")
                    self.assertGreater(sum(len(values[at]) for values in seen for at in range(0, len(probes), 3)), 30)
                    self.assertEqual(session.steps, 60)
                    theirs = mapping.energy({name: array.astype(np.uint8) for name, array in spikes.items()}).json()
                    ours = session.energy().json()
                    compare_energies(self, ours, theirs)

    def test_integers_go_in_and_come_out(self):
        # A neuron that sends changes of at least 2, and one that sums its messages.
        text = """Network(name: "change", timestep_ms: 1.0, target: "oheo-gulch", populations: [
            Input(name: "x", shape: [3], message_bits: 8), Delta(name: "d", shape: [3], vth_mant: 2),
            Sigma(name: "s", shape: [3])], projections: [
            SumPool2d(from: ["x"], to: "d", kernel: (1, 1), weight: 1, sign: Excitatory),
            SumPool2d(from: ["d"], to: "s", kernel: (1, 1), weight: 1, sign: Excitatory)], output: "s")"""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "change.ron"
            path.write_text(text.replace("[3]", "[3, 1, 1]"))
            mapping = nsim.load(path).map()
        shown = np.array([[5, 6, 9, 9, 0], [0, -1, -2, -3, 7], [0, 0, 0, 0, 0]])
        # The changes that are sent, and their sums, by hand.
        sent = [[5, 0, 4, 0, -9], [0, 0, -2, 0, 9], [0] * 5]
        run = mapping.run(shown.astype(np.int8).reshape(1, 3, 5), probe=["d.message", "s.sigma"])
        self.assertEqual(run.probe("d.message")[0].tolist(), sent)
        self.assertEqual(run.probe("s.sigma")[0][:, 1:].tolist(), np.cumsum(sent, axis=1)[:, :-1].tolist())
        with mapping.session() as session:
            for t in range(5):
                session.step(shown[:, t])
                values = np.zeros(3, int)
                values[session["d"].spikes] = session["d"].values
                self.assertEqual(values.tolist(), [row[t] for row in sent])
                self.assertEqual(session["x"].values.tolist(), [x for x in shown[:, t] if x])
                self.assertEqual(session["d"].state("act").tolist(), shown[:, t].tolist())
            session.step(shown[:, 0].reshape(3, 1, 1))
            with self.assertRaisesRegex(nsim.Error, "shape \\[3, 2\\]"):
                session.step(np.zeros((3, 2), int))
            with self.assertRaisesRegex(nsim.Error, "no v"):
                session["d"].v
            with self.assertRaisesRegex(nsim.Error, "3 channels"):
                session.step([1, 2])

    def test_several_steps_in_a_call_are_single_steps(self):
        for model, copies in [("vtsnn-slip", 2), ("container-tactile", 1)]:
            mapping = nsim.load(model).map(copies=copies)
            spikes = recorded(mapping)
            names = [name for name, kind, _ in mapping.populations if kind != "input"]
            probes = [f"{name}.{what}" for name in names for what in ("u", "v", "spikes")]
            with mapping.session(energy=False) as single, mapping.session(energy=False) as session:
                seen = stepped(mapping, single, spikes)
                first, rest = ({name: array[:, part].astype(np.uint8) for name, array in spikes.items()} for part in (np.s_[:20], np.s_[20:]))
                # Events are the rows (sample, step, channel).
                events = {name: np.argwhere(array.T) for name, array in rest.items()}
                events = {name: nsim.Events(np.insert(rows, 0, 0, axis=1), steps=40) for name, rows in events.items()}
                runs = [session.run(first, probes=probes), session.run(events, steps=40, probes=probes)]
                self.assertEqual(session.steps, 60)
                for step, populations in enumerate(seen):
                    run, at = (runs[0], step) if step < 20 else (runs[1], step - 20)
                    for name, (fired, v, u) in zip(names, zip(*[iter(populations)] * 3)):
                        self.assertEqual(np.flatnonzero(run[f"{name}.spikes"][at]).tolist(), fired)
                        self.assertEqual([run[f"{name}.{what}"][at].tolist() for what in "vu"], [v, u])
                # In silence the number of steps is given.
                silent = session.run(steps=3, probes=probes[:1])[probes[0]]
                self.assertEqual((silent.shape[0], silent.dtype, session.steps), (3, np.int32, 63))
                name = next(iter(spikes))
                units = spikes[name].shape[0]
                for arguments, words in [
                    (((None,), {}), "no input has the number"),
                    ((({name: np.zeros((units, 4), np.uint8)}, 5), {}), "the inputs have 4 timesteps"),
                    ((({"nobody": np.zeros((1, 4))},), {}), "not an input population"),
                    (((None, 2, ["nobody.v"]), {}), "no probe 'nobody.v'"),
                    ((({name: np.zeros((2, units, 4), np.uint8)},), {}), "2 samples"),
                ]:
                    with self.assertRaisesRegex(nsim.Error, words):
                        session.run(*arguments[0], **arguments[1])
                self.assertEqual(session.steps, 63)

    def test_integers_are_added_to_one_timestep(self):
        populations = [{"name": "in", "shape": 1, "kind": "Input"}, {"name": "out", "shape": 3, "du": 4096, "dv": 0, "vth_mant": 2000}]
        network = nsim.Network("added", populations, [{"from": "in", "to": "out", "weights": np.full((3, 1), 2)}], output="out")
        with network.map(copies=2).session(energy=False) as session:
            out = session["out"]
            session.added["out.q"] = [5, -7, 0]
            session.added["out.bias"] = np.array([0, 100, 1], np.int16)
            self.assertEqual(session.added["out.q"].tolist(), [5, -7, 0])
            session.step([True])
            # A weight of 2 adds 128; only u decays.
            self.assertEqual((out.u.tolist(), out.v.tolist()), ([133, 121, 128], [133, 221, 129]))
            session.step()
            self.assertEqual((out.u.tolist(), out.v.tolist()), ([0, 0, 0], [133, 221, 129]))
            self.assertEqual(session.overflow, {"q": 0, "u": 0, "v": 0})
            # Beyond 22 bits the accumulator wraps, in both copies.
            session.added["out.q"] = np.array([1 << 21, 0, 0])
            session.run(steps=2)
            self.assertEqual((session.overflow, out.v.tolist()[0]), ({"q": 2, "u": 0, "v": 0}, 133 - (1 << 21)))
            session.added["out.q"] = [1, 1, 1]
            session.reset()
            session.step()
            self.assertEqual((out.u.tolist(), session.overflow["q"]), ([0, 0, 0], 0))
            for name, given, words in [
                ("out.w", [1, 1, 1], "takes no integers"),
                ("in.q", [1], "takes no integers"),
                ("out.q", [1, 1], "2 integers for 3 compartments"),
                ("out.q", [0, 0.5, 0], "an integer of 32 bits is expected"),
                ("out.q", [0, 0, 2**31 - 1], "adds 2147483647"),
            ]:
                with self.assertRaisesRegex(nsim.Error, words):
                    session.added[name] = given

    def test_a_snapshot_is_gone_back_to(self):
        mapping = nsim.load("vtsnn-slip").map()
        spikes = recorded(mapping, steps=100)
        with mapping.session() as session, mapping.session() as other:
            stepped(mapping, session, spikes, 0, 50)
            middle = session.snapshot()
            whole = stepped(mapping, session, spikes, 50)
            for one in (session, other):
                one.restore(middle)
                self.assertEqual(one.steps, 50)
                self.assertEqual(stepped(mapping, one, spikes, 50), whole)
            session.reset()
            self.assertEqual(stepped(mapping, session, spikes, 0)[50:], whole)
            with self.assertRaisesRegex(nsim.Error, "another mapping"):
                nsim.load("vtsnn-slip").map().session().restore(middle)

    def test_input_populations_and_values(self):
        mapping = nsim.load("container-tactile").map()
        with mapping.session() as session:
            session.step([3, 1])
            self.assertEqual((session["tactile"].spikes.tolist(), session["tactile"].values.tolist()), ([1, 3], [1, 1]))
            self.assertEqual(session["tactile"].spikes.dtype, np.int32)
            session.step()
            self.assertEqual(len(session["tactile"].spikes), 0)
            self.assertEqual((len(session["out"]), session["out"].v.dtype), (20, np.int32))

    def test_truth_values_are_no_numbers_of_channels(self):
        mapping = nsim.load("container-tactile").map()
        units = dict((name, shape) for name, _, shape in mapping.populations)["tactile"]
        spikes = np.random.default_rng(3).random(units) < 0.2
        with mapping.session() as session:
            for same in [spikes, spikes.tolist(), tuple(spikes.tolist()), list(spikes), np.flatnonzero(spikes), np.flatnonzero(spikes).tolist()]:
                for given in (same, {"tactile": same}):
                    session.step(given)
                    self.assertEqual(session["tactile"].spikes.tolist(), np.flatnonzero(spikes).tolist())
            for nothing in ([], (), np.array([], int), None, {}):
                session.step(nothing)
                self.assertEqual(len(session["tactile"].spikes), 0)
            for wrong, says in [
                (spikes.astype(np.uint8), "a byte for each"),
                (np.arange(spikes.size).astype(np.int8), "a byte for each"),
                (spikes.astype(int), "channel numbers or a truth value for each"),
                (spikes.astype(int).tolist(), "channel numbers or a truth value for each"),
                (np.ma.array([3, 1], mask=[True, False]), "mask"),
                ([3, 1, 3], "channel 3 of 'tactile' is given twice"),
                (spikes.astype(float), "whole numbers"),
                (spikes[:, None] & np.array([True, False]), "truth values of shape"),
            ]:
                with self.assertRaisesRegex(nsim.Error, says) as caught:
                    session.step(wrong)
                remedies = ("array > 0", "one for each channel", "array.filled(0)")
                self.assertTrue(any(remedy in caught.exception.help for remedy in remedies), caught.exception.help)
            # The printed remedy.
            session.step(spikes.astype(np.uint8) > 0)
            self.assertEqual(session["tactile"].spikes.tolist(), np.flatnonzero(spikes).tolist())

    def test_what_was_learned_is_read_and_written(self):
        text = """Network(name: "m", timestep_ms: 1.0, populations: [Input(name: "in", shape: [2]),
            Loihi(name: "out", shape: [3], du: 4096, dv: 2048, vth_mant: 1)], projections: [Dense(name: "p", from: ["in"],
            to: "out", weights: [[8, 2], [4, 6], [2, 8]], learning: Rule(dw: "8*x0*y0", epoch: 2))], output: "out")"""
        with tempfile.TemporaryDirectory() as folder:
            model = Path(folder, "m.ron")
            model.write_text(text)
            mapping = nsim.load(str(model)).map()
            spikes = np.ones((2, 12), bool)
            run = mapping.run(spikes, probe=["p.weight", "p.x1", "p.weight.last"], seed=3)
            shapes = [run.probe(name).shape for name in ("p.weight", "p.x1", "p.weight.last")]
            self.assertEqual(shapes, [(1, 6, 12), (1, 2, 12), (1, 6, 1)])
            self.assertEqual(run.json()["learning"][0]["name"], "p")
            self.assertEqual(len(run.learned(Path(folder, "after.ron"))), 2)
            self.assertEqual(len(nsim.load(str(Path(folder, "after.ron"))).map().run(spikes, fresh=True)), 1)
            for options, said in [({"draws": {"q": "q.npz"}}, "are: p"), ({"draws": {"p": "q.npz"}}, "q.npz")]:
                with self.assertRaises(nsim.Error) as refused:
                    mapping.run(spikes, **options)
                self.assertIn(said, f"{refused.exception} {refused.exception.help} {refused.exception.place}")
            with mapping.session(seed=3) as session:
                session.step({"in": np.ones(2, bool)})
                session.reset()
                session.reset(learned=False)
                self.assertEqual(session.steps, 0)

    def test_rules_are_steered(self):
        text = """Network(name: "m", timestep_ms: 1.0, populations: [Input(name: "in", shape: [2]), Signal(name: "reward", shape: [1]),
            Signal(name: "each", shape: [3]), Loihi(name: "out", shape: [3], du: 4096, dv: 2048, vth_mant: 1)], projections: [
            Dense(name: "p", from: ["in"], to: "out", weights: [[8, 2], [4, 6], [2, 8]], learning: Rule(dw: "u0*y2", dt: "x0",
            x1: (impulse: 16, tau: 10), y2: Signal("reward"), y3: Signal("each")))], output: "out")"""
        first = [8, 2, 4, 6, 2, 8]
        with tempfile.TemporaryDirectory() as folder:
            model = Path(folder, "m.ron")
            model.write_text(text)
            mapping = nsim.load(str(model)).map()
        with mapping.session() as session, mapping.session() as other:
            self.assertEqual(session.weights["p"].tolist(), first)
            self.assertEqual((session.weights.keys(), session.signal.keys()), (["p"], ["reward", "each"]))
            # A value holds for one timestep, whose learning acts on the delivery after the next one.
            session.signal["reward"] = 4
            session.signal["each"] = [0, -7, 0]
            self.assertEqual((session.signal["reward"].tolist(), session.signal["each"].tolist()), ([4], [0, -7, 0]))
            before = session.snapshot()
            for _ in range(2):
                session.step({"in": [1]})
                self.assertEqual((session.signal["reward"].tolist(), session.weights["p"].tolist()), ([0], first))
                session.step({"in": [1]})
                self.assertEqual(session.weights["p"].tolist(), [w + 4 for w in first])
                self.assertEqual((session.traces["p.x1"].tolist(), session.tags["p"].tolist()), ([0, 16], [0, 1] * 3))
                self.assertEqual(session.delays["p"].tolist(), [0] * 6)
                session.restore(before)
            for inputs in ({"in": [1], "reward": 4, "each": [0, -7, 0]}, {"in": [1]}):
                other.step(inputs)
            self.assertEqual(other.weights["p"].tolist(), [w + 4 for w in first])
            other.weights["p"] = np.array([[0, 2], [-256, 254], [4, 6]])
            other.step()
            self.assertEqual(other.weights["p"].tolist(), [0, 2, -256, 254, 4, 6])
            other.reset(learned=False)
            self.assertEqual(other.weights["p"].tolist(), first)
            for refused, says in [
                (lambda: session.weights.__setitem__("p", [1]), "1 weights for 'p', which has 6 synapses"),
                (lambda: session.weights.__setitem__("p", [3] + [0] * 5), "weight 3 of synapse 0 of 'p'.* from -256 to 254"),
                (lambda: session.weights.__setitem__("p", [0.5] * 6), "weights\\['p'\\]\\[0\\] is 0.5"),
                (lambda: session.signal.__setitem__("reward", 40_000), "cannot send 40000.* from -32768 to 32767"),
                (lambda: session.signal.__setitem__("each", 1), "'each' has 3 channels"),
                (lambda: session.step({"reward": 1}), "set for this step by session.signal"),
                (lambda: session.draws["p"], "draws for each synapse"),
            ]:
                with self.assertRaises(nsim.Error) as caught:
                    refused()
                self.assertRegex(f"{caught.exception} {caught.exception.help}", f"(?s){says}")
            for unknown, says in [
                (lambda: session.weights["q"], "no projection that learns 'q'; there are: p"),
                (lambda: session.signal["in"], "no signal 'in'; there are: reward, each"),
                (lambda: session.traces["p"], "NAME.x1"),
            ]:
                self.assertRaisesRegex(KeyError, says, unknown)
            self.assertRaisesRegex(TypeError, "only be read", session.tags.__setitem__, "p", [0] * 6)
        self.assertRaisesRegex(nsim.Error, "closed", lambda: session.weights)

    def test_random_numbers_are_given_step_by_step(self):
        draw = np.random.default_rng(5)
        network = nsim.Network(
            "pes",
            [
                {"name": "in", "shape": 3, "kind": "Input"},
                {"name": "err", "shape": 1, "kind": "Signal"},
                {"name": "out", "shape": 2, "du": 4096, "dv": 4096, "vth_mant": 131071},
            ],
            [{"name": "pes", "from": "in", "to": "out", "weights": np.zeros((2, 3)), "learning": nsim.Pes("err", x1=(28.8, 5))}],
            output="out",
            learning_semantics="Nengo",
        )
        mapping, steps = network.map("oheo-gulch"), 24
        spikes, errors = draw.random((3, steps)) < 0.5, draw.integers(-90, 90, (1, steps))
        numbers = {"draw_trace": draw.random((steps // 2, 3)), "draw_weight": draw.random((steps // 4, 3, 2))}
        with tempfile.TemporaryDirectory() as folder:
            np.savez(Path(folder, "draws.npz"), **numbers)
            run = mapping.run({"in": spikes, "err": errors}, draws={"pes": Path(folder, "draws.npz")}, probe=["pes.weight"])
        expected = run.probe("pes.weight")[0]
        self.assertGreater(np.count_nonzero(expected[:, -1]), 2)
        with mapping.session() as session:
            for t in range(steps):
                trace, weight = (t + 1) % 2 == 0, (t + 1) % 4 == 0
                self.assertEqual(session.draws["pes"], {"draw_trace": 3 * trace, "draw_weight": 6 * weight})
                given = {"draw_trace": numbers["draw_trace"][t // 2]} if trace else {}
                given |= {"draw_weight": numbers["draw_weight"][t // 4]} if weight else {}
                session.draws["pes"] = given
                session.step({"in": spikes[:, t], "err": errors[:, t]})
                self.assertEqual(session.weights["pes"].tolist(), expected[:, t].tolist(), f"step {t}")
            session.step()
            for given, says in [
                ({"draw_trace": [0.5] * 2}, "takes 3 numbers of draw_trace in step 25, but 2 are given"),
                ({"draw_trace": [0.5, 1, 0.5]}, "number 1 is 1, not from 0 to below 1"),
                ({"draw_x": [0.5]}, "unknown key 'draw_x'"),
            ]:
                with self.assertRaisesRegex(nsim.Error, says):
                    session.draws["pes"] = given
            with self.assertRaisesRegex(nsim.Error, "takes 3 numbers of draw_trace in step 25, but 0 are given") as caught:
                session.step()
            self.assertIn("give it before the step: 3 of draw_trace, 0 of draw_weight", caught.exception.help)
            self.assertEqual(session.steps, 25)

    def test_a_session_that_learns_has_the_energy_of_its_steps(self):
        network = nsim.Network(
            "learner",
            [{"name": "in", "shape": 6, "kind": "Input"}, {"name": "out", "shape": 5, "du": 4096, "dv": 512, "vth_mant": 20}],
            [{"name": "p", "from": "in", "to": "out", "weights": np.full((5, 6), 20), "delay": 3,
              "learning": nsim.Rule("2^-2*x1*y0", dd="x0*y0", x1=(16, 10), epoch=4)}],
            output="out",
        )  # fmt: skip
        for copies, options in [(1, {}), (3, {"transport": "analytic"}), (1, {"host": "none", "mode": "realtime"})]:
            mapping = network.map("oheo-gulch", copies=copies)
            spikes = recorded(mapping, steps=42, rate=0.4)
            with mapping.session(seed=4, energy=options or None) as session, mapping.session() as other:
                stepped(mapping, session, spikes)
                session.reset(learned=False)
                stepped(mapping, session, spikes)
                self.assertNotEqual(session.weights["p"].tolist(), [20] * 30)
                theirs = mapping.energy(spikes, seed=4, **options).json()
                compare_energies(self, session.energy().json(), theirs)
                # A snapshot has the counts.
                snapshot = session.snapshot()
                session.step()
                other.restore(snapshot)
                compare_energies(self, other.energy().json(), theirs)

    def test_what_is_refused_changes_nothing(self):
        mapping = nsim.load("vtsnn-slip").map()
        channels = dict((name, int(np.prod(shape))) for name, kind, shape in mapping.populations if kind == "input")
        with mapping.session() as session:
            for wrong, says in [
                ({"tactile": [channels["tactile"]]}, "cannot spike"),
                ({"tactile": [-1]}, "whole numbers"),
                ({"tactile": [0.5]}, "whole numbers"),
                ({"tactile": np.array([0.0])}, "whole numbers"),
                ({"tactile": np.zeros(3, bool)}, "truth values of shape \\[3\\]"),
                ({"touch": [1]}, "the input populations are: tactile, vision"),
                ([1], "several input populations"),
            ]:
                with self.assertRaisesRegex(nsim.Error, says):
                    session.step(wrong)
                self.assertEqual(session.steps, 0)
            for wrong in ({"tactile": 3}, {"tactile": "3"}, {"tactile": {3: 1}}):
                self.assertRaises(TypeError, session.step, wrong)
            self.assertRaises(KeyError, lambda: session["no"])
            with self.assertRaisesRegex(nsim.Error, "has no v"):
                session["tactile"].v
        with mapping.session(energy=False) as session:
            session.step()
            with self.assertRaisesRegex(nsim.Error, "does not count") as caught:
                session.energy()
            self.assertEqual(caught.exception.help, "open it without energy=False")
        with mapping.session() as session, self.assertRaisesRegex(nsim.Error, "no timestep"):
            session.energy()
        for options, says in [
            ({"baselines": ["cpu"]}, "runs samples again"),
            ({"early_exit": "certain"}, "end of a sample"),
            ({"reset_words": 3}, "length of a sample"),
            ({"deployment": "paper"}, "another network"),
            ({"host": "fridge"}, "host is 'fridge'"),
        ]:
            with self.assertRaisesRegex(nsim.Error, says):
                mapping.session(energy=options)
        self.assertRaises(TypeError, mapping.session, energy={"hosts": 1})
        self.assertRaises(TypeError, mapping.session, energy="True")
        for closed in (session.step, session.snapshot, session.reset, lambda: session["out"], lambda: session.steps):
            with self.assertRaisesRegex(nsim.Error, "with mapping.session"):
                closed()

    def test_the_loop_of_the_page(self):
        scope = {}
        for loop in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S):
            exec(compile(loop, str(PAGE), "exec"), scope)
        lead = np.sort(scope["counts"])[-1] - np.sort(scope["counts"])[-2]
        self.assertEqual(lead, 3)
        self.assertGreater(scope["counts"].sum(), 0)

    def test_tutorials_that_learn_print_what_they_show(self):
        here = os.getcwd()
        self.addCleanup(os.chdir, here)
        # Where the pages find the program.
        program = str(Path(NSIM).resolve().parent) if os.sep in NSIM else ""
        with mock.patch.dict(os.environ, PATH=program + os.pathsep + os.environ["PATH"]):
            for name in ["cartpole", "few-shot", "pes"]:
                page = (PAGE.parent / f"tutorials/{name}.md").read_text()
                scope, printed = {}, io.StringIO()
                with tempfile.TemporaryDirectory() as folder:
                    os.chdir(folder)
                    for kind, body in re.findall(r"```(python|text) session\n(.*?)```", page, re.S):
                        if kind == "text":
                            self.assertEqual(printed.getvalue(), body, name)
                            continue
                        printed = io.StringIO()
                        with contextlib.redirect_stdout(printed):
                            exec(compile(body, f"{name}.md", "exec"), scope)
                    os.chdir(here)

    def test_threads_use_a_session_one_after_another(self):
        mapping = nsim.load("container-tactile").map()
        spikes = np.flatnonzero(recorded(mapping)["tactile"][:, 0])
        with mapping.session() as session:
            problems = []

            def loop(action):
                try:
                    for _ in range(300):
                        action()
                except Exception as problem:  # noqa: BLE001
                    problems.append(problem)

            actions = [lambda: session.step(spikes), lambda: session["out"].v, session.snapshot, lambda: session.step(spikes)]
            threads = [threading.Thread(target=loop, args=[action]) for action in actions]
            [thread.start() for thread in threads]
            [thread.join() for thread in threads]
            self.assertEqual((problems, session.steps), ([], 600))

    def test_the_loop_and_the_chip_of_the_readme(self):
        readme = (PAGE.parents[1] / "README.md").read_text()
        loop = next(block for block in re.findall(r"```python\n(.*?)```", readme, re.S) if "session(" in block)
        scope = {"nsim": nsim}
        exec(compile(loop, "README.md", "exec"), scope)
        with tempfile.TemporaryDirectory() as folder:
            chip = Path(folder) / "mine.ron"
            chip.write_text(re.search(r"```ron\n(.*?)```", readme, re.S).group(1))
            self.assertEqual(nsim.load("vtsnn-slip").map(chip).target, "mine")


if __name__ == "__main__":
    unittest.main()
