#!/usr/bin/env python3
"""Runs the tests of nengo-loihi's wheel on its own emulator and on nsim.nengo; the Python that runs this has both packages.

Usage: nengo_suite.py [PYTEST ARGUMENTS]

Exits 1 when a test that passes on its emulator does not pass on nsim, or when integer blocks were stepped by another engine.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

INI = """[pytest]
nengo_simloader = nengo_loihi.tests.make_test_sim
nengo_neurons =
    nengo.LIF
    nengo.SpikingRectifiedLinear
"""

# The wheel has the tests without their configuration, which this is.
PLUGIN = '''
import json, os

import matplotlib
matplotlib.use("Agg")
import nengo_loihi
import nengo_loihi.emulator as emulator
import numpy as np
import pytest
from nengo_loihi.builder.builder import Model, ValidationLevel

outcomes, steps = {}, {"own": 0}
own = emulator.EmulatorInterface
step = own.step

def counted(self):
    steps["own"] += int(self.block_info.dtype == np.int32)
    return step(self)

if os.environ["ENGINE"] == "nsim":
    own.step = counted
    import nsim.nengo
    nsim.nengo.install()

def pytest_addoption(parser):
    parser.addoption("--target", default="sim")

def pytest_configure(config):
    emulator.EmulatorInterface.strict = True
    nengo_loihi.set_defaults()
    Model.default_validation_level = ValidationLevel.FULL
    for name in ("target_sim", "target_loihi", "hang", "requires_multichip_snips"):
        config.addinivalue_line("markers", name)

def pytest_collection_modifyitems(items):
    for item in items:
        if "target_loihi" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="hardware"))

def pytest_runtest_logreport(report):
    if report.when == "call" or report.outcome != "passed":
        outcomes[report.nodeid.split("::", 1)[1] + " " + os.path.basename(report.nodeid.split("::")[0])] = report.outcome

def pytest_sessionfinish(session):
    with open(os.environ["OUTCOMES"], "w") as file:
        json.dump({"outcomes": outcomes, "own": steps["own"]}, file)
'''


def outcomes_on(engine, folder, arguments):
    """The outcome of each test on an engine, and the steps of integer blocks by another one."""
    import nengo_loihi

    file = folder / f"{engine}.json"
    environment = dict(os.environ, ENGINE=engine, OUTCOMES=str(file), PYTHONPATH=str(folder), MPLCONFIGDIR=str(folder))
    tests = str(Path(nengo_loihi.__file__).parent)
    line = [sys.executable, "-m", "pytest", "-c", "pytest.ini", "-p", "suite", "-p", "no:cacheprovider", "-q", "--slow", "--tb=line"]
    with open(folder / f"{engine}.txt", "w") as log:
        subprocess.run(line + [tests, *arguments], cwd=folder, env=environment, stdout=log, stderr=log)
    if not file.exists():
        sys.exit(f"the tests did not run on {engine}:\n{(folder / f'{engine}.txt').read_text()[-2000:]}")
    found = json.loads(file.read_text())
    return found["outcomes"], found["own"]


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pytest.ini").write_text(INI)
        (folder / "suite.py").write_text(PLUGIN)
        native, _ = outcomes_on("native", folder, sys.argv[1:])
        ours, own = outcomes_on("nsim", folder, sys.argv[1:])
        log = (folder / "nsim.txt").read_text()
    count = lambda outcomes, outcome: sum(found == outcome for found in outcomes.values())
    for name, outcomes in (("its emulator", native), ("nsim", ours)):
        print(f"{name}: {count(outcomes, 'passed')} passed, {count(outcomes, 'failed')} failed, {count(outcomes, 'skipped')} skipped")
    lost = [test for test, outcome in native.items() if outcome == "passed" and ours.get(test) != "passed"]
    print(f"{own} steps of integer blocks on another engine; passed on its emulator alone: {lost or 'none'}")
    if lost or own or count(native, "passed") == 0:
        sys.exit(log[-4000:])


if __name__ == "__main__":
    main()
