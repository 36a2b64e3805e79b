"""Each warning is in Python as in the text and JSON of the shell: of networks, runs, energies and inputs."""

import json
import os
import tempfile
import unittest
import warnings
from pathlib import Path

import numpy as np
import nsim

MODEL = """Network(name: "m", timestep_ms: 1.0, populations: [Input(name: "in", shape: [2, 1, 2]),
 Loihi(name: "out", shape: [2], du: 4096, dv: 1024, vth_mant: 1%s)],
 projections: [Dense(from: ["in"], to: "out", weights: [[63, 64, 65, 66], [64, -64, 64, 64]])], output: "out"%s)"""
EVENTS = "t_us,x,y,p\n0,1,0,1\n900,9,0,1\n1500,0,0,0\n"


def issued(call):
    """The result of a call, and the messages of the warnings that it issued."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    return result, [str(one.message) for one in found if one.category is nsim.Warning]


def told(record):
    """The line that the shell prints for a record."""
    population = record["population"]
    return f"'{population}': {record['message']}" if population else record["message"]


class Warnings(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def file(self, name, text):
        path = os.path.join(self.folder.name, name)
        with open(path, "w") as file:
            file.write(text)
        return path

    def test_a_network_a_run_and_an_energy_have_the_warnings_that_are_issued(self):
        model = self.file("m.ron", MODEL % (", refractory: 5", ", semantics: Lava"))
        network, said = issued(lambda: nsim.load(model))
        self.assertEqual([record["code"] for record in network.warnings], ["parameter-ignored", "weights-rounded"])
        self.assertEqual(said, [f"{model}: {told(record)}" for record in network.warnings])
        mapping, said = issued(network.map)
        self.assertEqual(said, [])
        spikes = np.ones((4, 5), bool)
        for call in (lambda: mapping.run(spikes), lambda: network.map().energy(spikes), lambda: network.energy(spikes)):
            result, said = issued(call)
            self.assertEqual(said, [])
            self.assertEqual(result.warnings, network.warnings)
            self.assertEqual(result.json()["warnings"], result.warnings)

    def test_changes_of_recordings_are_issued_for_each_input(self):
        mapping = nsim.load(self.file("m.ron", (MODEL % ("", "")).replace("63", "62").replace("65", "64"))).map()
        events = self.file("events.csv", EVENTS)
        records = np.array([(0, 1, 0, 1), (900, 9, 0, 1)], [("t", "i8"), ("x", "i4"), ("y", "i4"), ("p", "i4")])
        for spikes, words in [(f"in={events}?size=2,1&steps=2", "1 dropped"), (nsim.Events(records, unit="us", steps=2), "1 of 2 events")]:
            run, said = issued(lambda: mapping.run(spikes))
            changed = [record for record in run.warnings if record["code"] == "events-changed"]
            self.assertEqual(said, [told(record) for record in changed])
            self.assertIn(words, said[0])

    def test_conversion_of_spike_response_neurons_is_a_warning_of_the_mapping(self):
        network, said = issued(lambda: nsim.load("container-tactile-srm"))
        self.assertEqual((network.warnings, said), ([], []))
        mapping, said = issued(network.map)
        self.assertIn("spike response neurons become Loihi compartments", said[0])
        self.assertEqual(told(mapping.run(samples=(0, 1)).warnings[0]), said[0])

    def test_each_code_of_the_shell_is_in_python_too(self):
        """The cases of tests/cli/warnings.rs, which leaves its files beside the program."""
        folder = Path(os.environ.get("NSIM", "")).resolve().parents[1] / "tmp" / "warnings"
        if not (folder / "cases.json").exists():
            self.skipTest("the cases of cargo test --test cli warnings are not there")
        made = json.loads((folder / "cases.json").read_text())
        here = os.getcwd()
        self.addCleanup(os.chdir, here)
        os.chdir(folder)
        seen, without = set(), set()
        for commands, model, source, codes in made["cases"]:
            if "static" in commands[0]:
                # Python does not prune.
                without |= set(codes)
                continue
            file, *given = model.split()
            names = {"--from": "tool", "--dt": "dt_ms"}
            options = {names.get(name, name[2:]): value for name, value in zip(given[::2], given[1::2])}
            options |= {"dt_ms": float(options["dt_ms"])} if "dt_ms" in options else {}
            options |= {"decision": "GreatestV"} if "decision" in options else {}
            energy = any(command.startswith("energy") for command in commands)
            more = {"convention": "published"} if "published" in commands[0] else {}
            more |= {"mode": "realtime", "constants": "slow.ron"} if "realtime" in commands[0] else {}
            more |= {"baselines": ["rtx-2080-ti"]} if "baseline-missing" in codes else {}

            def call():
                network = nsim.load(file, **options)
                if "import" in commands or not source:
                    return network
                mapping = network.map()
                return mapping.energy(source, **more) if energy else mapping.run(source)

            result, said = issued(call)
            for code in codes:
                messages = [told(record) for record in result.warnings if record["code"] == code]
                self.assertTrue(messages, (code, model, result.warnings))
                for message in messages:
                    self.assertTrue(any(one.endswith(message) for one in said), (message, said))
                seen.add(code)
        for code in sorted(seen | without):
            page = "no page: nsim report lacks the option" if code in made["without_page"] else "page"
            python = "no Python: it does not prune" if code in without else "Python"
            print(f"{code:22} text  JSON  {python}  {page}")


if __name__ == "__main__":
    unittest.main()
