"""Compares two builds of nsim on every shipped model: digests, counts, energies and mappings.

    python3 tests/equal.py OLD NEW [MODEL ..]

OLD and NEW are programs. Each runs the same commands; their JSON has to be equal, number for number, but for
what a clock measured. Keys that only one of them has are listed at the end and are no difference.
Exits with 1 where something differs.
"""

import json
import pathlib
import re
import subprocess
import sys

# What a clock, a name of a file or of a build decides.
MEASURED = re.compile(r"(wall|seconds|elapsed|us_per|_s$|_per_s|speed|host|version|commit|built|threads|memory|rss|mib|checksum)")

MAP = ["", "--copies 2", "--copies 32", "--strategy sequential", "--strategy greedy", "--objective energy", "--objective latency",
       "--deployment packed", "--target loihi1-chip", "--prune static", "--relays"]
RUN = ["", "--threads 2", "--skip off", "--engine golden --samples 0..2", "--early-exit certain", "--early-exit 5", "--prune static"]
ENERGY = ["--baseline", "--baseline --mode realtime", "--baseline --convention published", "--baseline --transport analytic",
          "--baseline --copies 32", "--baseline --accounting rails", "--baseline --deployment packed"]
AGREE = ["--samples 0..4 --attribution off"]


def printed(program, words, seconds=1800):
    """The exit code of a command, or `timeout`, and its JSON, `None` where it prints none."""
    try:
        done = subprocess.run([program, *words, "--format", "json"], capture_output=True, text=True, timeout=seconds)
        return done.returncode, json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        return "timeout", None
    except ValueError:
        return done.returncode, None


def compared(old, new, path=""):
    """Yields what differs as (kind, path, old, new)."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            place = f"{path}.{key}"
            if MEASURED.search(key):
                continue
            if key not in old or key not in new:
                yield "key", re.sub(r"\[\d+\]", "[]", place), key in old, key in new
            else:
                yield from compared(old[key], new[key], place)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for place, (a, b) in enumerate(zip(old, new)):
            yield from compared(a, b, f"{path}[{place}]")
    elif old != new:
        yield "value", path, old, new


def main():
    old, new, *models = sys.argv[1:]
    models = models or sorted(path.stem for path in (pathlib.Path(__file__).parent.parent / "models").glob("*.ron"))
    commands = [f"{command} {model} {flags}".strip() for model in models
                for command, all_flags in (("map", MAP), ("run", RUN), ("energy", ENERGY), ("agree", AGREE)) for flags in all_flags]
    keys, different, refused = set(), 0, 0
    for line in commands:
        (code, before), (code_now, now) = printed(old, line.split()), printed(new, line.split())
        if before is None and now is None and code == code_now:
            refused += 1
            continue
        found = list(compared(before, now)) + ([("value", "exit", code, code_now)] if code != code_now else [])
        keys |= {(place, had, has) for kind, place, had, has in found if kind == "key"}
        values = [one for one in found if one[0] == "value"]
        different += bool(values)
        for _, place, a, b in values[:3]:
            print(f"{line}: {place or 'all'} was {str(a)[:60]}, is {str(b)[:60]} ({len(values)} values differ)")
    for place, had, _ in sorted(keys):
        print(f"only {'before' if had else 'now'}: {place}")
    print(f"{len(commands)} commands, {refused} refused by both, {different} differ")
    return different > 0


if __name__ == "__main__":
    sys.exit(main())
