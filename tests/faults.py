"""Faults of the disk from outside: commands that write run under strace, which lets one system call fail or kills the process at it.

Usage: python3 tests/faults.py PATH_OF_NSIM [WORD OF A COMMAND]

A command runs for the old files and then, with --force, for the new ones. Then it runs with the N-th call of each kind failing, for N = 1,
2, .. until nothing is left to fail. Afterwards every file is the old one or the new one, whole; a command that failed leaves no temporary
file and ends with status 2 or 3; one that says that it is done has written all; and the same command again completes it.
Needs strace, and the right to trace. It says how many faults there were.
"""

import pathlib
import re
import subprocess
import sys
import tempfile

MODEL = """Network(name: "m", timestep_ms: 1.0, populations: [
    Input(name: "in", shape: [9]), Loihi(name: "o", shape: [4], du: 2048, dv: 1024, vth_mant: VTH, refractory: 1),
], projections: [Dense(from: ["in"], to: "o", weights: WEIGHTS)], output: "o")"""
SWEEP = 'Sweep(model: "GEN.ron", input: ["scene:noise?samples=1&steps=9"], grid: [(paths: ["populations.o.dv"], values: [512, 1024])])'

# What is between two generations: the name of the model.
COMMANDS = [
    "map GEN.ron -o m.ron",
    "map GEN.ron -o deep/m.ron --plot m.svg",
    "run GEN.ron --input scene:noise?samples=1&steps=9 --probe o.spikes --probe o.v -o p",
    "run GEN.ron --input scene:noise?samples=1&steps=9 --steps s.csv",
    "energy GEN.ron --input scene:noise?samples=1&steps=9 --baseline --export-sanafe s",
    "export GEN.ron -o m.nir",
    "import GEN.nir -o m.ron",
    "report GEN.ron --input scene:noise?samples=1&steps=9 --baseline -o page.html",
    "sweep GEN-sweep.ron -o t.csv",
    "scene slip --samples 2 --seed GEN -o s",
]
CALLS = {
    "write": ["error=ENOSPC", "error=EIO", "signal=KILL"],
    "fsync,fdatasync": ["error=EIO", "signal=KILL"],
    "rename,renameat,renameat2,link,linkat": ["error=ENOSPC", "signal=KILL"],
    "mkdir,mkdirat": ["error=ENOSPC"],
    "ftruncate": ["error=ENOSPC"],
}
# Times, and checksums over them.
MEASURED = re.compile(rb'"?(wall_s|seconds|us_per_timestep|checksum)"?:[^,}\n]*|[0-9.]+ s\b')


def inputs(folder):
    """Models of two generations, and what follows from them."""
    weights = [[(7 * source + 5 * target) % 20 * 2 - 8 for source in range(9)] for target in range(4)]
    for generation, threshold in (("a", 20), ("b", 30)):
        (folder / f"{generation}.ron").write_text(MODEL.replace("VTH", str(threshold)).replace("WEIGHTS", str(weights)))
        (folder / f"{generation}-sweep.ron").write_text(SWEEP.replace("GEN", generation))


def files(folder, given):
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: content for name, content in found.items() if name not in given}


def steady(content):
    """What two runs have in common: all but measured times, whatever else a file says."""
    return content and MEASURED.sub(b"", content)


def steady_all(content):
    return {name: steady(one) for name, one in content.items()}


def is_temporary(name):
    return pathlib.Path(name).name.startswith(".nsim-") or name.endswith(".journal")


def run(line, folder, fault=None):
    """Exit status, and whether the fault happened."""
    command = [NSIM, *line.split(" "), "--threads", "1"]
    log = folder.parent / "strace"
    if fault:
        calls, what, number = fault
        # Only strace knows the calls of another architecture by these names; `?` passes over those that this one lacks.
        calls = ",".join("?" + call for call in calls.split(","))
        command = ["strace", "-f", "-qq", "-o", str(log), "-e", f"trace={calls}", "-e", f"inject={calls}:{what}:when={number}", *command]
    ended = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    text = log.read_text() if fault else ""
    return ended.returncode, "INJECTED" in text or "killed by SIGKILL" in text, ended.stderr.decode(errors="replace")


class Trial:
    """A command that replaces old files by new ones."""

    def __init__(self, arguments, given):
        generations = ("1", "2") if arguments.startswith("scene") else ("a", "b")
        old, self.new = (arguments.replace("GEN", name) for name in generations)
        self.new += " --force"
        self.given, self.before = given, {}
        self.before = self.written(old)
        self.after = steady_all(self.written(self.new))

    def folder(self):
        """A folder with the inputs and the old files."""
        place = tempfile.TemporaryDirectory()
        for name, content in {**self.given, **self.before}.items():
            path = pathlib.Path(place.name) / "work" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return place

    def written(self, line):
        with self.folder() as place:
            folder = pathlib.Path(place) / "work"
            status, _, said = run(line, folder)
            assert status == 0, f"{line}: {said}"
            return files(folder, self.given)

    def with_fault(self, fault):
        """Whether the fault happened; what is wrong afterwards is an assertion."""
        with self.folder() as place:
            folder = pathlib.Path(place) / "work"
            status, happened, said = run(self.new, folder, fault)
            if not happened:
                return False
            there = steady_all(files(folder, self.given))
            what = f"{self.new} with {fault} ends with {status}: {said.strip()}"
            assert status in (0, 1, 2, 3) or fault[1] == "signal=KILL", what
            for name, content in there.items():
                if not is_temporary(name):
                    assert content in (steady(self.before.get(name)), self.after.get(name)), f"{what}\n{name} is neither old nor new"
            if fault[1] != "signal=KILL":
                left = [name for name in there if name.endswith(".tmp")]
                assert not left, f"{what}\n{left} is left"
            if status == 0:
                assert there == self.after, f"{what}\nit is not complete"
            status, _, said = run(self.new, folder)
            there = {name: content for name, content in steady_all(files(folder, self.given)).items() if not name.endswith(".tmp")}
            assert status == 0 and there == self.after, f"{what}\nthen again: {status}: {said.strip()}"
        return True


def main():
    faults = 0
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place) / "work"
        folder.mkdir()
        inputs(folder)
        for generation in ("a", "b"):
            status, _, said = run(f"export {generation}.ron -o {generation}.nir", folder)
            assert status == 0, said
        given = {path.name: path.read_bytes() for path in folder.iterdir()}
    for arguments in COMMANDS:
        if len(sys.argv) > 2 and sys.argv[2] not in arguments:
            continue
        trial = Trial(arguments, given)
        before = faults
        for calls, kinds in CALLS.items():
            for kind in kinds:
                number = 1
                while trial.with_fault((calls, kind, number)):
                    number += 1
                    faults += 1
        print(f"{arguments}: {faults - before} faults", flush=True)
    print(f"{faults} faults, no file lost or broken")
    assert faults > 0, "strace injected nothing"


if __name__ == "__main__":
    NSIM = str(pathlib.Path(sys.argv[1]).resolve())
    main()
