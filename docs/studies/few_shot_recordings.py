"""Few-shot learning of real tactile recordings: accuracy on a class that the features never saw, by number of examples.

Usage: python3 docs/studies/few_shot_recordings.py FOLDER [CLASS ..]

FOLDER has `train` and `test` of ev-containers (clear-nus/TactileSGNet): 240 and 60 recordings of 20 classes. For each
class, by default all 20, a hidden layer is trained on the 19 others. Then
each of their training samples is taught to a prototype, and 1, 2, 5, 10 and 12 samples of the class, in the order of
their files. Prototypes learn on the chip; the host chooses the prototype, and scales it by the hidden layer's spikes.
"""

import pathlib
import re
import sys
import tempfile
import warnings

import numpy as np
import nsim

EXAMPLES = [0, 1, 2, 5, 10, 12]
# Training samples of a class, each with a prototype.
EACH = 12
STEPS = 325
TRAINING = """Training(
    name: "features", timestep_ms: 20.0, inputs: [(name: "tactile", shape: [78])],
    layers: [(name: "hidden", from: ["tactile"], size: 64), (name: "out", from: ["hidden"], size: 20)],
    neuron: Loihi(tau_u_ms: Same(200.0), tau_v_ms: Same(200.0), weight_scale: 32.0, theta: 10.0),
    loss: SpikeCount(right: 75, wrong: 5), optimiser: Adam(rate: 0.02), last_rate: 0.1, weight_decay: 5.0, averaging: 0.99,
    augment: (shift: 3, drop_channel: 0.03, drop_spike: 0.1), batch: 8, epochs: 100, seed: 1,
)"""
MODEL = """Network(
    name: "few-shot", timestep_ms: 20.0,
    populations: [
        Input(name: "tactile", shape: [78]), Input(name: "teach", shape: [1, 20, 12]), Signal(name: "scale", shape: [1]),
        Loihi(name: "hidden", shape: [64], du: 390, dv: 390, vth_mant: 1300),
        Loihi(name: "prototypes", shape: [1, 20, 12], du: 4096, dv: 0, vth_mant: 95000),
    ],
    projections: [
        Dense(from: ["tactile"], to: "hidden", weights: Safetensors("features.safetensors", "tactile->hidden"), weight_scale: 2.0),
        SumPool2d(from: ["teach"], to: "prototypes", kernel: (1, 1), weight: 200, weight_exp: 7),
        Dense(
            name: "clp", from: ["hidden"], to: "prototypes", sign: Excitatory, weights: Uniform(low: 0, high: 0, step: 1, seed: 1),
            learning: Rule(dw: "2^-4*y0*x1*y2", x1: (impulse: 1, tau: 1000000), y2: Signal("scale")),
        ),
    ],
    output: "prototypes", decision: LastV, drain: 1,
)"""


def recordings(folder):
    """Spikes `[samples, channels, steps]` and classes, in the order of the files' numbers."""
    numbered = [(re.search(r"sample_(\d+)_label_(\d+)", path.name), path) for path in folder.glob("*.npy")]
    numbered.sort(key=lambda pair: int(pair[0][1]))
    spikes = np.stack([np.load(path).reshape(78, STEPS) > 0 for _, path in numbered])
    return spikes, np.array([int(name[2]) for name, _ in numbered])


def inputs(spikes, prototypes=None, scales=None):
    """Samples with six more steps, in which prototypes are taught."""
    samples = len(spikes)
    teach = np.zeros((samples, 20 * EACH, STEPS + 6), np.uint8)
    scale = np.zeros((samples, 1, STEPS + 6), np.int32)
    if prototypes is not None:
        teach[np.arange(samples), prototypes, STEPS + 1 : STEPS + 5] = 1
        scale[:] = np.reshape(scales, (-1, 1, 1))
    return {"tactile": np.pad(spikes, ((0, 0), (0, 0), (0, 6))), "teach": teach, "scale": scale}


def taught(model, spikes, prototypes, path):
    """Teaches samples to prototypes; writes the learned model."""
    mapping = nsim.load(model).map()
    counts = mapping.run(inputs(spikes), probe=["hidden.spikes"]).probe("hidden.spikes").sum(2)
    scales = np.rint(15_360 / np.linalg.norm(np.minimum(counts, 127), axis=1)).astype(int)
    mapping.run(inputs(spikes, prototypes, np.minimum(scales, 127))).learned(path, force=True)


def right(model, spikes, classes):
    """Whether the prototype of the greatest potential is of the sample's class."""
    predicted = nsim.load(model).map().run(inputs(spikes)).predicted
    return np.array([number is not None and number // EACH == label for number, label in zip(predicted, classes)])


def experiment(new, train, test, folder):
    """Right samples by number of examples, `[samples of the class, samples of others]`, and of the trained network."""
    (spikes, classes), (tested, labels) = train, test
    old, is_new = classes != new, labels == new
    training = nsim.train(TRAINING, train=(spikes[old], classes[old]))
    training.save(folder / "features.ron", force=True)
    model = folder / "empty.ron"
    model.write_text(MODEL)
    rank = np.array([(classes[:i] == classes[i]).sum() for i in range(len(classes))])
    prototypes = classes * EACH + rank
    steps = [(0, old)] + [(k, ~old & (rank >= before) & (rank < k)) for before, k in zip(EXAMPLES, EXAMPLES[1:])]
    found = []
    for k, chosen in steps:
        taught(model, spikes[chosen], prototypes[chosen], folder / f"taught-{k}.ron")
        model = folder / f"taught-{k}.ron"
        hits = right(model, tested, labels)
        found.append((hits[is_new].sum(), hits[~is_new].sum()))
    network = training.network.map().run(tested[~is_new], labels=labels[~is_new])
    return np.array(found), network.accuracy * (~is_new).sum()


def main(folder, chosen):
    warnings.simplefilter("ignore", nsim.Warning)
    train, test = recordings(folder / "train"), recordings(folder / "test")
    total, network, tests = 0, 0.0, np.zeros(2)
    with tempfile.TemporaryDirectory() as scratch:
        for new in chosen:
            found, known = experiment(new, train, test, pathlib.Path(scratch))
            total, network = total + found, network + known
            tests += [(test[1] == new).sum(), (test[1] != new).sum()]
            print(f"class {new}: new {found[:, 0].tolist()}, others {found[:, 1].tolist()}", flush=True)
    for k, (new, others) in zip(EXAMPLES, total):
        print(f"{k:2} examples: new {new / tests[0]:.3f} of {tests[0]:.0f}, others {others / tests[1]:.3f} of {tests[1]:.0f}")
    print(f"trained networks, 19 classes: {network / tests[1]:.3f}")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), [int(number) for number in sys.argv[2:]] or list(range(20)))
