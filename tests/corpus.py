"""Compares two builds of nsim over a corpus of networks: cores, words, spikes, energy and latency of each.

    python3 tests/corpus.py [OLD] NEW [--csv]

OLD and NEW are programs; without OLD, NEW is compared with the figures in `tests/corpus.csv`, which NSIM_BLESS=1 writes; --csv prints all
of NEW. Networks are made from seeds, in structures of papers (into the folder NSIM_CORPUS, else a temporary one), read from a folder of
data (NSIM_DATA, else `../shared/data`), or files of this Python's packages. Each runs as one copy on its own target, else nahuku-32.
`words` store synapses, `total` is all words of a core of Loihi 2, `uj` and `us` are of a timestep of the neuron cores (`--host none`). A
refused network has the code of its error. Exits with 1 where spikes differ, or a network that ran before is refused.
"""

import csv
import importlib.metadata
import math
import os
import pathlib
import random
import re
import sys
import tempfile

import equal

DATA = pathlib.Path(os.environ.get("NSIM_DATA") or pathlib.Path(__file__).resolve().parents[2] / "shared/data")
FILES = ["nir/*.nir", "netx/*/*.net", "loihi2/*/*.net", "cases/*/net.*", "conventions/*/net.*", "conventions/*/model.ron", "oxford-slayer/*.pt",
         "faults/small.ron", "faults4/*.net", "faults4/words*.ron", "faults4/izhikevich.ron", "faults4/stateless*.ron"]
FIGURES = ["cores", "words_max", "words_sum", "total_max", "total_sum", "spikes", "uj", "us"]
NOISE = "scene:noise?samples=1&steps=40&seed=1&rate="
COLUMNS = ["network", *FIGURES, "digest", "error"]

# Kind of neurons, inputs, layers. c channels, k kernel, s stride, p padding, g groups: a convolution; m side: a sum over a square; d: dense;
# v: dense and recurrent; r: two layers and a shortcut; l: lists of synapses for each delay up to @, together as many as dense.
STACKS = {
    "n-mnist": "Loihi 2x34x34 c8k5 m2 c16k3 m2 d10", "gesture": "Loihi 2x32x32 c16k5s2 c32k3s2 c32k3p1 d11",
    "lenet": "Loihi 1x28x28 c6k5 m2 c16k5 m2 d120 d84 d10", "all-conv": "Loihi 3x32x32 c24k3s2 c48k3s2 c10k7",
    "vgg": "Loihi 2x16x16 c8k3p1 c8k3p1 m2 c16k3p1 c16k3p1 m2 d10", "large-kernel": "Loihi 4x16x16 c32k9 d10", "mlp": "Loihi 784 d128 d64 d10",
    "depthwise": "Loihi 32x16x16 c32k5g32 c32k5g32 d10", "mobilenet": "Loihi 3x32x32 c16k3s2p1 c16k3p1g16 c32k1 c32k3s2p1g32 c64k1 d10",
    "resnet": "Loihi 2x12x12 c8k3p1 r r c16k3s2p1 r d10", "resnet-wide": "Loihi 3x6x6 c16k3p1 r r d10", "residual-dense": "Loihi 128 d256 r r r d10",
    "autoencoder": "Loihi 784 d64 d16 d64 d784", "wide": "Loihi 100 d4000 d10", "deep": "Loihi 64" + " d64" * 12, "shd": "Loihi 700 v256 d20",
    "recurrent-large": "Loihi 256 v1024 d10", "delays-30": "Loihi 140 l128@30 l128@30 d20", "delays-62": "Loihi 64 l256@62 d10",
    "delays-8": "Loihi 128 l512@8 l256@8 d35", "loihi2-mlp": "Loihi2 784 d128 d64 d10", "loihi2-conv": "Loihi2 2x34x34 c16k5s2 c32k3s2 d10",
    "loihi2-recurrent": "Loihi2 256 v768 d10", "pilotnet": "SigmaDelta 3x33x60 c12k3s2 c18k3s2 c24k3s2 d50 d10", "resonators": "Rf 64 d256 d10",
    "sigma-delta": "SigmaDelta 256 d512 d128 d10", "sigma-delta-residual": "SigmaDelta 4x10x10 c8k3p1 r d10", "resonators-iz": "RfIz 128 d512 d10",
    "adaptive": "Alif 140 v256 d10", "ternary": "TernaryLif 128 d256 d10", "graded": "GradedLif 128 d300 d10",
    "graded-relu": "GradedReluVec 64 d256 d64 d8",
}
# Kinds of neurons: parameters, and the exponent of weights between layers. All but the first are on Loihi 2.
KINDS = {
    "Loihi": ("du: 2048, dv: 256, vth_mant: {vth}", 0), "Loihi2": ("du: 2048, dv: 256, vth_mant: {vth}", 0), "GradedReluVec": ("threshold: 1", -7),
    "Rf": ("sin_decay: 2103, cos_decay: 3273, threshold: {vth}", 0), "RfIz": ("sin_decay: 2103, cos_decay: 3273, threshold: {vth}", 0),
    "SigmaDelta": ("vth_mant: 1, relu: 1, message_bits: 16", -8), "TernaryLif": ("du: 2048, dv: 256, vth_hi_mant: {vth}, vth_lo_mant: -{vth}", 0),
    "Alif": ("du: 2048, dv: 256, dtheta: 205, dr: 819, threshold: 9000, threshold_step: 50", 0), "GradedLif": ("du: 99, dv: 256, vth_mant: 900", -8),
}
# Sizes n, and the weight between two of n neurons: 0 for none, True for a random one. `draw` is uniform in 0 to 1.
GRAPHS = {
    "winner": ([10, 64, 256], lambda n, a, b, draw: 60 if a == b else -40),
    "ring-attractor": ([72, 300], lambda n, a, b, draw: 2 * round(20 * math.cos(2 * math.pi * (a - b) / n)) - 8),
    "watts-strogatz": ([100, 300, 900], lambda n, a, b, draw: draw() < (0.9 if 0 < (b - a) % n <= 12 else 1.2 / n)),
    "scale-free": ([200, 900], lambda n, a, b, draw: draw() < 4 / ((a + 1) * (b + 1)) ** 0.5),
    "liquid": ([135, 405], lambda n, a, b, draw: draw() < 0.3 * math.exp(-math.dist(grid(a, 3), grid(b, 3)) ** 2 / 4)),
    "maze": ([144, 900], lambda n, a, b, draw: 60 * (math.dist(grid(a, math.isqrt(n)), grid(b, math.isqrt(n))) == 1 and draw() < 0.8)),
}
# Potjans and Diesmann 2014: neurons of the populations of a cortical column, and the connected of ten thousand pairs, [to][from].
COLUMN = [20683, 5834, 21915, 5479, 4850, 1065, 14395, 2948]
PAIRS = [[1009, 1689, 437, 818, 323, 0, 76, 0], [1346, 1371, 316, 515, 755, 0, 42, 0], [77, 59, 497, 1350, 67, 3, 453, 0],
         [691, 29, 794, 1597, 33, 0, 1057, 0], [1004, 622, 505, 57, 831, 3726, 204, 0], [548, 269, 257, 22, 600, 3158, 86, 0],
         [156, 66, 211, 166, 572, 197, 396, 2252], [364, 10, 34, 5, 277, 80, 658, 1443]]
# Sizes of populations, of which the odd ones inhibit; connected of ten thousand pairs; greatest delay.
MIXTURES = {
    **{f"brunel-{n}": ([n * 4 // 5, n // 5], [[share] * 2] * 2, 0) for n, share in ((100, 1000), (400, 1000), (1000, 1000), (2500, 200), (3000, 50))},
    **{f"polychronous-{n}": ([n * 4 // 5, n // 5], [[600] * 2] * 2, 30) for n in (200, 600)},
    **{f"cortex-{part}": ([size * part // 1000 for size in COLUMN], PAIRS, 1) for part in (5, 10, 30)},
    **{f"patchwork-{n}": ([8] * n, [[5000 * ((31 * a + 17 * b) % 29 == 0) for a in range(n)] for b in range(n)], 0) for n in (50, 150)},
}


def grid(place, side):
    return place % side, place // side % side, place // side**2


class Network:
    """A model file in the making. Its name is its seed; the last population is its output."""

    def __init__(self, name, shape, kind="Loihi"):
        # Python promises equal numbers in all versions of random() alone.
        self.name, self.draw, self.kind = name, random.Random(name).random, kind
        self.shapes, self.populations, self.projections = {"in": shape}, [f'Input(name: "in", shape: {shape})'], []

    def weight(self):
        return 2 * int(self.draw() * 37) - 36

    def neurons(self, name, shape, sources):
        """Neurons with a threshold for this number of sources each."""
        self.shapes[name] = shape
        parameters = KINDS[self.kind][0].format(vth=int(10 * sources**0.5))
        self.populations.append(f'{self.kind.removesuffix("2")}(name: "{name}", shape: {shape}, {parameters})')

    def wire(self, kind, source, to, fields, delay=0):
        exponent = KINDS[self.kind][1] * (source != "in")
        self.projections.append(f'{kind}(from: ["{source}"], to: "{to}", weight_exp: {exponent}, delay: {delay}, {fields})')

    def random(self, source, to, fan_out, low, high, delay=0):
        fan_out = min(max(round(fan_out), 1), math.prod(self.shapes[to]))
        self.wire("Random", source, to, f"fan_out: {fan_out}, low: {low}, high: {high}, seed: {len(self.projections)}", delay)

    def layer(self, source, to, words):
        """Adds a layer of STACKS."""
        number = {key: int(digits or 0) for key, digits in re.findall("([a-z@])([0-9]*)", words)}
        shape, kind, sources = self.shapes[source], words[0], math.prod(self.shapes[source])
        if kind == "c":
            channels, kernel, stride, padding, groups = (number.get(key, usual) for key, usual in zip("ckspg", (1, 1, 1, 0, 1)))
            inner = shape[0] // groups
            self.neurons(to, [channels] + [(side + 2 * padding - kernel) // stride + 1 for side in shape[1:]], inner * kernel**2)
            weights = [[[[self.weight() for _ in range(kernel)] for _ in range(kernel)] for _ in range(inner)] for _ in range(channels)]
            self.wire("Conv2d", source, to, f"weights: {weights}, stride: {stride, stride}, padding: {padding, padding}, groups: {groups}")
        elif kind == "m":
            self.neurons(to, [shape[0], *(side // number["m"] for side in shape[1:])], number["m"] ** 2)
            self.wire("SumPool2d", source, to, f"kernel: {number['m'], number['m']}, weight: 20")
        elif kind == "r":
            same = f"c{shape[0]}k3p1" if len(shape) > 1 else f"d{sources}"
            self.layer(source, to + "a", same)
            self.layer(to + "a", to, same)
            self.wire("Sparse", source, to, f"synapses: {[(unit, unit, 40) for unit in range(sources)]}", delay=1)
        else:
            self.neurons(to, [number[kind]], sources)
            for delay in range(number.get("@", -1) + 1):
                drawn = [divmod(pair, number["l"]) for pair in range(sources * number["l"]) if self.draw() * (number["@"] + 1) < 1]
                self.wire("Sparse", source, to, f"synapses: {[(*pair, self.weight()) for pair in drawn]}", delay)
            for before in [source] * (kind != "l") + [to] * (kind == "v"):
                self.wire("Dense", before, to, f"weights: Uniform(low: -36, high: 36, step: 2, seed: {len(self.projections)})")

    def written(self, folder):
        """The name of the network, the arguments for it and its input."""
        path, target = folder / f"{self.name}.ron", 'target: "oheo-gulch", ' if self.kind != "Loihi" else ""
        path.write_text(f'Network(name: "{self.name}", timestep_ms: 1.0, {target}output: "{list(self.shapes)[-1]}",\npopulations: [\n'
                        + ",\n".join(self.populations) + "],\nprojections: [\n" + ",\n".join(self.projections) + "])\n")
        return f"made/{self.name}", [str(path)], NOISE + "0.08"


def made(folder):
    """Networks made here."""
    for name, words in STACKS.items():
        kind, inputs, *layers = words.split()
        net = Network(name, [int(side) for side in inputs.split("x")], kind)
        for place, layer in enumerate(layers):
            net.layer(list(net.shapes)[-1], f"{layer[0]}{place}", layer)
        yield net.written(folder)
    for name, n, between in ((name, n, between) for name, (sizes, between) in GRAPHS.items() for n in sizes):
        net = Network(f"{name}-{n}", [64])
        net.neurons("units", [n], 20)
        net.random("in", "units", 8, 0, 90)
        weights = ((a, b, between(n, a, b, net.draw)) for a in range(n) for b in range(n))
        net.wire("Sparse", "units", "units", f"synapses: {[(a, b, net.weight() if w is True else w) for a, b, w in weights if w]}")
        yield net.written(folder)
    for name, (sizes, pairs, delays) in MIXTURES.items():
        net = Network(name, [64])
        for place, size in enumerate(sizes):
            net.neurons(f"p{place}", [size], 40)
            net.random("in", f"p{place}", size / 10, 0, 60)
        for source, to in ((source, to) for to in range(len(sizes)) for source in range(len(sizes)) if pairs[to][source]):
            used, low, high = ([0], -120, -40) if source % 2 else (range(delays + 1), 0, 40)
            for delay in used:
                net.random(f"p{source}", f"p{to}", sizes[to] * pairs[to][source] / 10000 / len(used), low, high, delay)
        yield net.written(folder)


def read(_):
    """Networks of the folder of data, with their own inputs where these are spikes."""
    for path in sorted({path for pattern in FILES for path in DATA.glob(pattern)}):
        words = [str(path), *["--dt", "0.1", "--reset", "zero"] * (path.suffix == ".nir")]
        recorded = [str(one) for one in path.parent.glob("input.npy") if "netx" not in path.parts]
        yield f"data/{path.relative_to(DATA).with_suffix('')}", words, (recorded or [NOISE + "0.3"])[0]
    if not DATA.is_dir():
        print(f"skipped: no data at {DATA}", file=sys.stderr)


def packaged(_):
    """Networks that packages of this Python contain."""
    files = {package.name: package.files for package in importlib.metadata.distributions()}
    for tool in ("nir", "snntorch", "norse", "sinabs", "spikingjelly", "rockpool", "spyx", "lava-dl"):
        networks = [file for file in files.get(tool) or [] if file.suffix in (".nir", ".net")]
        if not networks:
            print(f"skipped: no networks of {tool}", file=sys.stderr)
        for file in networks:
            yield f"pypi/{tool}/{file.parent.name}-{file.stem}", [str(file.locate()), *["--from", tool] * (file.suffix == ".nir")], NOISE + "0.3"


def figures(program, model, source, folder):
    """The figures of a network as text, as far as its commands answer."""
    row, given = dict.fromkeys(COLUMNS[1:], ""), ["--input", source, "--mapping", str(folder / "mapping")]
    for command, words in (("map", ["-o", given[3], "--force"]), ("run", given), ("energy", [*given, "--host", "none", "--baseline"])):
        status, answer = equal.printed(program, [command, *model, *words, "--threads", "1"], seconds=300)
        reason = (answer.get("reasons") or [answer])[0] if answer else {"code": f"{command}: {status}"}
        if "code" in reason:
            return {**row, "error": reason["code"]}
        if command == "map":
            row["cores"] = str(answer["cores_used"])
            for figure, counted in (("words", "synapse_words"), ("total", "total_words")):
                words = [core.get("pools", core)[counted] for core in answer["cores"] if counted in core.get("pools", core)]
                row |= {f"{figure}_max": str(max(words)), f"{figure}_sum": str(sum(words))} if words else {}
        elif command == "run":
            row |= {"spikes": str(answer["activity"]["spikes"]), "digest": answer["digest"][:12]}
        else:
            row |= {"uj": f"{answer['rows'][-1]['energy_uj']:.6g}", "us": f"{answer['rows'][-1]['latency_us']:.6g}"}
    return row


def compared(pairs):
    """Lines about the figures that differ and about all; whether spikes differ or are missing."""
    lines, differ, wrong, ratios = [], set(), False, {figure: [] for figure in FIGURES}
    for before, now in pairs:
        for figure in COLUMNS[1:]:
            old, new, ratio = before[figure], now[figure], ""
            if figure in FIGURES and float(old or 0) and float(new or 0):
                ratios[figure].append(float(new) / float(old))
                ratio = f"{ratios[figure][-1]:.4f}"
            if old != new:
                differ.add(now["network"])
                wrong |= figure in ("spikes", "digest") and old != ""
                lines.append(f"{now['network'][:37]:37} {figure:9} {old[:12] or '-':>12} {new[:12] or '-':>12} {ratio[:6]}".rstrip())
    lines.append("".join(f"{figure:>10}" for figure in ratios))
    lines.append("".join(f"{math.prod(each) ** (1 / max(len(each), 1)):10.5f}" for each in ratios.values()))
    refused, seconds = sum(now["error"] != "" for _, now in pairs), sum(os.times()[:4])
    return [*lines, f"geometric means; {len(pairs)} networks, {len(pairs) - len(differ)} equal, {refused} refused, {seconds:.0f} s"], wrong


def main():
    *old, new = [word for word in sys.argv[1:] if word != "--csv"]
    path, bless = pathlib.Path(__file__).with_suffix(".csv"), os.environ.get("NSIM_BLESS") == "1"
    stored = {row["network"]: row for row in csv.DictReader(path.read_text().splitlines() if path.exists() else [])}
    rows, pairs = {}, []
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(os.environ.get("NSIM_CORPUS") or scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name, *arguments in (network for source in (made, read, packaged) for network in source(folder)):
            before = figures(old[0], *arguments, folder) if old else stored.get(name)
            rows[name] = {"network": name, **figures(new, *arguments, folder)}
            pairs += [(before, rows[name])] if before else []
    lines, wrong = compared(pairs)
    # Networks of absent sources keep their figures.
    absent = [row for name, row in stored.items() if bless and name.rpartition("/")[0] not in {own.rpartition("/")[0] for own in rows}]
    table = [",".join(row) for row in (COLUMNS, *(row.values() for row in [*rows.values(), *absent]))]
    if bless:
        path.write_text("\n".join([*table, ""]))
    print(*table if "--csv" in sys.argv else lines, sep="\n")
    return wrong and not bless


if __name__ == "__main__":
    sys.exit(main())
