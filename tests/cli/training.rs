//! Training: threads and interruptions change nothing, and the deployed network is the trained one.

#![allow(clippy::unwrap_used)]

use crate::common::command::{object, said as ran};
use std::path::Path;

use nsim_testing::cases;
use serde_json::Value;

const CONFIG: &str = r#"Training(
    name: "small",
    timestep_ms: 1.0,
    inputs: [(name: "touch", shape: [12]), (name: "sight", shape: [1, 2, 3])],
    layers: [
        (name: "a", from: ["touch"], size: 8),
        (name: "b", from: ["sight"], size: 4),
        (name: "out", from: ["a", "b"], size: 3),
    ],
    neuron: Loihi(tau_u_ms: Same(5), tau_v_ms: Spread(4, 12, 3), weight_scale: 16, theta: 10, refractory: 2, credit: UpToReset),
    loss: SpikeCount(right: 12, wrong: 2),
    optimiser: Adam(rate: 0.03),
    weight_decay: 0.01,
    l1: 0.0001,
    dropout: 0.1,
    last_rate: 0.1,
    averaging: 0.9,
    augment: (shift: 2, drop_spike: 0.05, drop_channel: 0.05, jitter: 1, stretch: 0.1, noise: 0.001),
    batch: 4,
    epochs: 12,
    seed: 3,
    train: ["FOLDER/set.ron"],
    test: ["FOLDER/set.ron"],
)"#;

/// Three classes in 24 samples: each fires its own third of the channels more often. Returns the
/// text of config.ron, which trains on these.
fn samples(folder: &Path) -> String {
    let mut entries = String::new();
    for sample in 0..24u64 {
        let label = sample % 3;
        for (name, channels) in [("touch", 12u64), ("sight", 6)] {
            let mut rows = String::new();
            for step in 0..40u64 {
                for channel in 0..channels {
                    let often = if channel * 3 / channels == label { 0.4 } else { 0.1 };
                    if nsim::ir::base::rng::unit(sample, channel + 100 * channels, step) < often {
                        rows += &format!("{step},{channel}\n");
                    }
                }
            }
            std::fs::write(folder.join(format!("{name}{sample}.csv")), rows).unwrap();
        }
        entries +=
            &format!("(files: {{\"t\": \"touch{sample}.csv\", \"s\": \"sight{sample}.csv\"}}, label: {label}),\n");
    }
    let set = format!(
        "DataSet(name: \"set\", populations: {{\"t\": \"touch\", \"s\": \"sight\"}}, steps: 40, samples: [{entries}])"
    );
    std::fs::write(folder.join("set.ron"), set).unwrap();
    let config = CONFIG.replace("FOLDER", folder.to_str().unwrap());
    std::fs::write(folder.join("config.ron"), &config).unwrap();
    config
}

fn nsim(folder: &Path, arguments: &[&str]) -> Value {
    object(folder, arguments, 0)
}

fn weights(folder: &Path, model: &str) -> Vec<u8> {
    std::fs::read(folder.join(model).with_extension("safetensors")).unwrap()
}

#[test]
fn threads_and_interruptions_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    samples(folder);
    let one = nsim(folder, &["train", "config.ron", "-o", "one.ron", "--threads", "1", "--log", "one.csv"]);
    assert_eq!(one["schema"], "nsim.train/1");
    assert_eq!((one["epochs"].as_u64(), one["model"].as_str()), (Some(12), Some("one.ron")));
    nsim(folder, &["train", "config.ron", "-o", "three.ron", "--threads", "3"]);
    assert_eq!(weights(folder, "one.ron"), weights(folder, "three.ron"));
    assert_eq!(std::fs::read_to_string(folder.join("one.csv")).unwrap().lines().count(), 13);

    // The state after ten epochs is stored; a run resumed from it ends as the others.
    nsim(folder, &["train", "config.ron", "-o", "whole.ron", "--checkpoint", "state"]);
    assert_eq!(weights(folder, "one.ron"), weights(folder, "whole.ron"));
    let again = nsim(folder, &["train", "config.ron", "-o", "again.ron", "--checkpoint", "state"]);
    assert_eq!(again["epochs"], 12);
    assert_eq!(weights(folder, "one.ron"), weights(folder, "again.ron"));
    let (status, _, error) = ran(folder, "train config.ron --seed 4 --checkpoint state");
    assert!(status == 3 && error.contains("different settings"), "{error}");
}

/// A checkpoint without the entries that a version without checksums did not write.
fn without_checksum(file: &[u8]) -> Vec<u8> {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let mut header: Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    let facts = &mut header["__metadata__"]["nsim_training"];
    let mut own: Value = serde_json::from_str(facts.as_str().unwrap()).unwrap();
    ["checksum", "numbers"].iter().for_each(|field| assert!(own.as_object_mut().unwrap().remove(*field).is_some()));
    *facts = own.to_string().into();
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &file[8 + length..]].concat()
}

#[test]
fn a_damaged_checkpoint_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    samples(folder);
    let line = ["train", "config.ron", "--set", "averaging=0"];
    nsim(folder, &[&line[..], &["-o", "whole.ron", "--checkpoint", "state"]].concat());
    let good = std::fs::read(folder.join("state")).unwrap();
    let resumed = |file: &[u8]| {
        std::fs::write(folder.join("damaged"), file).unwrap();
        let again = ["-o", "again.ron", "--force", "--checkpoint", "damaged"];
        let (status, _, error) = ran(folder, &[&line[..], &again].concat());
        assert!(status == 0 || error.contains("error[train.checkpoint]") && error.contains("help"), "{error}");
        status == 0
    };
    assert!(resumed(&good));
    let old = without_checksum(&good);
    assert!(resumed(&old));
    let numbers = old.len() / 2;
    for (file, name) in [(&good, "new"), (&old, "old")] {
        for at in (0..file.len()).step_by(file.len() / 20) {
            let mut damaged = file.clone();
            damaged[at] ^= 1 << (at % 8);
            // A finished training without checksum is read for its weights alone.
            let same = || weights(folder, "again.ron") == weights(folder, "whole.ron");
            assert!(!resumed(&damaged) || name == "old" && same(), "{name}: byte {at}");
            assert!(!resumed(&file[..at]), "{name}: cut at {at}");
        }
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for at in (numbers..file.len() - 4).rev().step_by(4).filter(|at| at % 512 == file.len() % 512) {
                let mut damaged = file.clone();
                damaged[at..at + 4].copy_from_slice(&wrong.to_le_bytes());
                assert!(!resumed(&damaged), "{name}: {wrong} at {at}");
            }
        }
    }
}

/// Trains by this text: the network learns, and m.ron decides equally, spike by spike.
fn decides_as_trained(folder: &Path, config: &str, epochs: &str) {
    std::fs::write(folder.join("trained.ron"), config).unwrap();
    let trained = nsim(folder, &["train", "trained.ron", "--epochs", epochs, "-o", "m.ron", "--force"]);
    for engine in ["fast", "golden"] {
        let run = nsim(folder, &["run", "m.ron", "--input", "set.ron", "--engine", engine]);
        let [ran, wanted] = [&run["accuracy"], &trained["test_accuracy"]].map(|one| one.as_f64().unwrap());
        // Six digits are printed.
        assert!((ran - wanted).abs() < 1e-6, "{config}, {engine}: {ran}, {wanted}");
        assert_eq!(run["digest"], trained["digest"], "{config}, {engine}");
    }
    assert!(trained["test_accuracy"].as_f64().unwrap() > 0.8, "{config}: {trained}");
}

#[test]
fn the_deployed_network_decides_as_the_trained_one() {
    let folder = tempfile::tempdir().unwrap();
    let config = samples(folder.path());
    decides_as_trained(folder.path(), &config, "40");
}

const OUTPUT: &str =
    r#"size: 3, neuron: Loihi(tau_u_ms: Same(2), tau_v_ms: Spread(4, 12, 3), weight_scale: 16, theta: inf)"#;

#[test]
fn outputs_are_read_out_by_their_potential_as_they_were_trained() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let config = samples(folder).replace("size: 3", OUTPUT);
    for (decision, temperature) in [("GreatestV", 5), ("SumOfV", 50), ("LastV", 5)] {
        let loss = format!("Potential(decision: {decision}, temperature: {temperature})");
        decides_as_trained(folder, &config.replace("SpikeCount(right: 12, wrong: 2)", &loss), "30");
        let model = std::fs::read_to_string(folder.join("m.ron")).unwrap();
        assert!(model.contains(&format!("decision: {decision}")), "{model}");
    }
}

#[test]
fn neurons_of_loihi_2_decide_as_they_were_trained() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let config = samples(folder);
    let neuron = "Loihi(tau_u_ms: Same(5), tau_v_ms: Spread(4, 12, 3), weight_scale: 16, theta: 10, refractory: 2, \
                  credit: UpToReset)";
    assert!(config.contains(neuron));
    let count = "SpikeCount(right: 12, wrong: 2)";
    let potential = |temperature: u32| format!("Potential(decision: LastV, temperature: {temperature})");
    let resonator = "Rf(period_ms: Spread(6, 40, 4), tau_ms: Same(8), weight_scale: 16, theta: 1)";
    let integrators = "size: 3, neuron: Loihi(tau_u_ms: Same(5), tau_v_ms: Same(50), weight_scale: 16, theta: inf)";
    for (hidden, output, loss) in [
        (resonator, integrators, potential(10)),
        ("SigmaDelta(weight_scale: 16, theta: 0.5)", "size: 3, neuron: Sigma(weight_scale: 16)", potential(900)),
    ] {
        let text = config.replace(neuron, hidden).replace("size: 3", output).replace(count, &loss);
        let text = text.replace("size: 8", "size: 8, initial: 5.0").replace("size: 4", "size: 4, initial: 5.0");
        decides_as_trained(folder, &text, "60");
    }
    let changes = config.replace(neuron, "SigmaDelta(weight_scale: 16, theta: 0.5)");
    assert!(refused(folder, &changes).contains("layer 'out' sends changes"));
}

/// The message of `nsim train` that refuses a training file.
fn refused(folder: &Path, config: &str) -> String {
    std::fs::write(folder.join("refused.ron"), config).unwrap();
    let (status, _, error) = ran(folder, "train refused.ron --epochs 1");
    assert_eq!(status, 3, "{error}");
    error
}

#[test]
fn potentials_decide_where_the_output_never_spikes_and_nowhere_else() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let spiking = samples(folder);
    let count = "SpikeCount(right: 12, wrong: 2)";
    let by = |text: &str, loss: &str| text.replace(count, loss);
    let silent = spiking.replace("size: 3", OUTPUT);
    let trains = |text: &str| {
        std::fs::write(folder.join("mended.ron"), text).unwrap();
        nsim(folder, &["train", "mended.ron", "--epochs", "1"]);
    };

    // The output spikes, so its layer gets the printed threshold.
    let potential = "Potential(decision: LastV, temperature: 1)";
    let said = refused(folder, &by(&spiking, potential));
    assert!(said.contains("layer 'out' spikes") && said.contains("theta: inf"), "{said}");
    trains(&by(&silent, potential));

    // The output never spikes, but the loss counts spikes: the printed loss or threshold helps.
    let said = refused(folder, &silent);
    assert!(said.contains("layer 'out' decides by its potential"), "{said}");
    assert!(said.contains(potential) && said.contains("theta: 10"), "{said}");
    trains(&silent.replace("theta: inf", "theta: 10"));

    // A hidden layer needs its spikes.
    let said = refused(folder, &by(&spiking, potential).replace("size: 8", &OUTPUT.replace("size: 3", "size: 8")));
    assert!(said.contains("layer 'a' decides by its potential"), "{said}");

    // Spikes are no potential: the printed loss or a printed decision helps.
    let said = refused(folder, &by(&silent, "Potential(decision: Spikes, temperature: 1)"));
    assert!(said.contains("not by Spikes") && said.contains("CrossEntropy(scale: 0.5)"), "{said}");
    trains(&by(&spiking, "CrossEntropy(scale: 0.5)"));
    for decision in ["GreatestV", "SumOfV"] {
        assert!(said.contains(decision), "{said}");
        trains(&by(&silent, &format!("Potential(decision: {decision}, temperature: 1)")));
    }
    let said = refused(folder, &by(&silent, "Potential(decision: LastV, temperature: 0)"));
    assert!(said.contains("temperature 0 is outside"), "{said}");
}

#[test]
fn cells_of_the_paper_are_trained_anew_and_taken_up_where_they_were_left() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let small = ["--cell", "slip-tactile", "--scenes", "12", "--folds", "2", "--epochs", "2"];
    let command = [&["bench", "paper", "--train", "runs"][..], &small].concat();
    let first = nsim(folder, &[&command[..], &["-o", "rows.json"]].concat());
    // A result, a model and its weights for each fold, loss and kind of neurons.
    assert_eq!(std::fs::read_dir(folder.join("runs")).unwrap().count(), 3 * 2 * 2 * 2);
    assert_eq!(nsim(folder, &command), first);
    assert_eq!(nsim(folder, &["bench", "paper", "--cell", "slip-tactile", "--results", "rows.json"]), first);

    let rows = first["rows"].as_array().unwrap();
    let cell = |table: &str, loss: &str, quantity: &str| {
        let is = |row: &&Value| {
            let keys =
                [("table", table), ("task", "slip"), ("modality", "tactile"), ("loss", loss), ("quantity", quantity)];
            keys.iter().all(|(key, value)| row[*key] == *value)
        };
        rows.iter().find(is).unwrap_or_else(|| panic!("{table} {loss} {quantity}"))
    };
    let note = cell("accuracy", "count", "accuracy")["note"].as_str().unwrap();
    assert!(note.contains("2 of 2 folds, 2 epochs"), "{note}");
    assert_eq!(cell("srm", "weighted", "accuracy")["published"], 0.91);
    // The results of a training with equal folds.
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/models/train/paper/slip-tactile.ron");
    let scenes = "scene:slip?samples=12&seed=1&shear=0.32&edge_px=2";
    let trained = nsim(folder, &["train", config, "--train", scenes, "--epochs", "2", "--folds", "2"]);
    let folds = trained["folds"].as_array().unwrap();
    let kept = cell("accuracy", "count", "accuracy")["folds"].as_array().unwrap();
    let close = |a: &Value, b: &Value| (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-6;
    assert!(kept.iter().zip(folds).all(|(a, b)| close(a, b)) && kept.len() == 2, "{kept:?} {folds:?}");
}

#[test]
fn the_shipped_network_of_each_cell_comes_to_what_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let cells = ["slip-tactile", "slip-both", "container-tactile", "container-both", "slip-vision", "container-vision"];
    let cells = &cells[..cases(6) as usize];
    let paper = nsim(folder.path(), &[&["bench", "paper", "--full", "--cell"], cells].concat());
    let rows = paper["rows"].as_array().unwrap();
    let found: Vec<&Value> =
        rows.iter().filter(|row| row["table"] == "accuracy" && !row["shipped"].is_null()).collect();
    assert_eq!(found.len(), 2 * cells.len());
    for cell in found {
        assert_eq!(cell["shipped"], cell["folds"][0], "{} {} {}", cell["task"], cell["modality"], cell["loss"]);
        assert_eq!(cell["folds"].as_array().unwrap().len(), 5);
    }
}

#[test]
fn tables_of_the_paper_are_of_the_cells_and_neurons_that_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let paper = |arguments: &[&str]| nsim(folder.path(), &[&["bench", "paper"][..], arguments].concat());
    let all = paper(&[]);
    let some = paper(&["--stored", "--cell", "slip-both", "--neurons", "loihi"]);
    let wanted = all["rows"].as_array().unwrap().iter().filter(|row| {
        row["task"] == "slip" && row["modality"] == "both" && !["srm", "ann"].contains(&row["table"].as_str().unwrap())
    });
    assert_eq!(some["rows"].as_array().unwrap(), &wanted.cloned().collect::<Vec<_>>());
    let said = |arguments: &str| ran(folder.path(), &format!("bench paper {arguments}"));
    for refused in ["--stored -o t.md", "--stored --folds 3", "--stored --train runs"] {
        assert_eq!(said(refused).0, 2, "{refused}");
    }
    let grid = said("--format latex --cell slip-both").1;
    assert!(grid.contains("CNN-3D & 1.000* (0.77)") && !grid.contains("container"), "{grid}");
    // A training file is shipped under its own name.
    let shown = nsim(folder.path(), &["show", "paper-slip-both"]);
    assert_eq!(shown["name"], "models/train/paper/slip-both");
    assert_eq!(ran(folder.path(), "train paper-slip-tactile --epochs 0 --train scene:slip?samples=4").0, 0);
}
