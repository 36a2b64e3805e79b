//! State dicts of PyTorch: each family of names gives the network of its tool's equations.
//!
//! The pickles are written by hand, as torch's `serialization.py` does; the expected sums are
//! computed here, without any code of nsim.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::common;
use crate::real::{STEPS, input, spikes, total};
use crate::torch::{Entry, checkpoint};
use nsim::files::lower::lower;
use nsim::files::network::{Parameter, ProjectionKind};
use nsim::import::foreign;
use nsim::import::foreign::{Imported, Options, Reading, ResetMode};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::base::rng;

/// Numbers from -0.5 to 1.5 in steps of 1/64, so that sums of them are exact.
fn noise(count: usize, seed: u64) -> Vec<f32> {
    (0..count as u64).map(|i| (rng::below(129, seed, i, 0) as f32 - 32.0) / 64.0).collect()
}

fn import(entries: &[Entry], options: &Options) -> Result<Imported, Diagnostic> {
    let imported = foreign::from_bytes(Path::new("net.pt"), checkpoint(entries), options)?;
    lower(&imported.model.build(Path::new("net.pt"))?)?;
    Ok(imported)
}

/// Options with a neuron of this YAML text.
fn neuron(folder: &tempfile::TempDir, text: &str) -> Options {
    let path: PathBuf = folder.path().join(format!("{}.yml", folder.path().read_dir().unwrap().count()));
    std::fs::write(&path, format!("neuron: {{{text}}}\n")).unwrap();
    Options { neuron: Some(path), ..Options::default() }
}

/// Sums of `[target][source]` weights over the spikes.
fn times(weights: &[f32], spikes: &[bool]) -> Vec<f64> {
    weights
        .chunks(spikes.len())
        .map(|row| row.iter().zip(spikes).filter(|(_, spike)| **spike).map(|(w, _)| f64::from(*w)).sum())
        .collect()
}

/// snnTorch's rules for one layer. An `alpha` of 0 means no current; `own` weights reach the layer
/// a step later.
struct Snn {
    units: usize,
    alpha: f64,
    beta: f64,
    threshold: f64,
    subtracts: bool,
    own: Vec<f32>,
}

impl Snn {
    fn run(&self, currents: &[Vec<f64>]) -> Vec<Vec<bool>> {
        let (mut syn, mut mem, mut spikes) = (vec![0.0; self.units], vec![0.0; self.units], vec![false; self.units]);
        let step = |current: &Vec<f64>| {
            let back = if self.own.is_empty() { vec![0.0; self.units] } else { times(&self.own, &spikes) };
            (0..self.units).for_each(|i| {
                let reset = f64::from(u8::from(mem[i] > self.threshold));
                syn[i] = self.alpha * syn[i] + current[i] + back[i];
                mem[i] = match self.subtracts {
                    true => self.beta * mem[i] + syn[i] - reset * self.threshold,
                    // snnTorch 1.0.0: `_base_zero` of Leaky, and `_base_zero` of the other neurons.
                    false if self.alpha == 0.0 && self.own.is_empty() => self.beta * mem[i] * (1.0 - reset) + syn[i],
                    false => (self.beta * mem[i] + syn[i]) * (1.0 - reset),
                };
                spikes[i] = mem[i] > self.threshold;
            });
            spikes.clone()
        };
        currents.iter().map(step).collect()
    }
}

/// The currents of a layer with weights and biases, from spikes.
fn currents(weights: &[f32], bias: &[f32], spikes: &[Vec<bool>]) -> Vec<Vec<f64>> {
    let row = |spikes: &Vec<bool>| {
        let sums = times(weights, spikes).into_iter().enumerate();
        sums.map(|(i, sum)| sum + bias.get(i).map_or(0.0, |&b| f64::from(b))).collect()
    };
    spikes.iter().map(row).collect()
}

fn given(channels: usize) -> Vec<Vec<bool>> {
    (0..STEPS).map(|step| (0..channels).map(|c| input(step, c)).collect()).collect()
}

/// A layer of snnTorch in the form of a state dict.
fn leaky(name: [&'static str; 4], beta: f32, threshold: f32, reset: f32) -> Vec<Entry> {
    name.into_iter().zip([threshold, 1.0, reset, beta]).map(|(name, number)| (name, vec![], vec![number])).collect()
}

const LIF1: [&str; 4] = ["lif1.threshold", "lif1.graded_spikes_factor", "lif1.reset_mechanism_val", "lif1.beta"];
const LIF2: [&str; 4] = ["lif2.threshold", "lif2.graded_spikes_factor", "lif2.reset_mechanism_val", "lif2.beta"];

#[test]
fn snntorch_gives_what_its_rules_give_with_both_resets_and_biases() {
    let (first, second, bias) = (noise(6 * 5, 1), noise(3 * 6, 2), noise(6, 3));
    for subtracts in [true, false] {
        let reset = if subtracts { 0.0 } else { 1.0 };
        let mut entries: Vec<Entry> =
            vec![("fc1.weight", vec![6, 5], first.clone()), ("fc1.bias", vec![6], bias.clone())];
        entries.extend(leaky(LIF1, 0.875, 1.0, reset));
        entries.push(("fc2.weight", vec![3, 6], second.clone()));
        entries.extend(leaky(LIF2, 0.5, 0.75, reset));
        let imported = import(&entries, &Options::default()).unwrap();
        assert_eq!(imported.kind, "PyTorch state dict of snnTorch");
        assert_eq!(imported.layers.len(), 2);
        let layer = |units, beta, threshold| Snn { units, alpha: 0.0, beta, threshold, subtracts, own: vec![] };
        let hidden = layer(6, 0.875, 1.0).run(&currents(&first, &bias, &given(5)));
        assert!(total(&hidden) > 20, "{}", total(&hidden));
        assert_eq!(spikes(&imported.model, "lif1", 5), hidden, "subtracts: {subtracts}");
        // The next layer receives it a step later.
        let later: Vec<Vec<bool>> = std::iter::once(vec![false; 6]).chain(hidden).take(STEPS).collect();
        let out = layer(3, 0.5, 0.75).run(&currents(&second, &[], &later));
        assert!(total(&out) > 10);
        assert_eq!(spikes(&imported.model, "lif2", 5), out, "subtracts: {subtracts}");
        // The file states its reset, so a contradicting option is refused.
        let other = if subtracts { ResetMode::Zero } else { ResetMode::SubtractLater };
        let error = import(
            &entries,
            &Options { reading: Reading { reset: Some(other), ..Reading::default() }, ..Options::default() },
        )
        .unwrap_err();
        assert_eq!(error.code, "import.option", "{error}");
    }
}

#[test]
fn snntorch_with_a_current_and_with_recurrent_weights_gives_what_its_rules_give() {
    let (weights, own) = (noise(4 * 5, 11), noise(16, 12));
    let named = ["net.1.threshold", "net.1.graded_spikes_factor", "net.1.reset_mechanism_val", "net.1.beta"];
    for (alpha, recurrent, subtracts) in
        [(0.5, true, true), (0.5, true, false), (0.5, false, false), (0.0, true, false), (0.0, true, true)]
    {
        let mut entries: Vec<Entry> = vec![("net.0.weight", vec![4, 5], weights.clone())];
        entries.extend(leaky(named, 0.75, 1.5, f32::from(u8::from(!subtracts))));
        if alpha > 0.0 {
            entries.push(("net.1.alpha", vec![1], vec![alpha]));
        }
        let own = if recurrent { own.clone() } else { Vec::new() };
        if recurrent {
            entries.push(("net.1.recurrent.weight", vec![4, 4], own.clone()));
        }
        let imported = import(&entries, &Options::default()).unwrap();
        let layer = Snn { units: 4, alpha: alpha.into(), beta: 0.75, threshold: 1.5, subtracts, own };
        let right = layer.run(&currents(&weights, &[], &given(5)));
        assert!(total(&right) > 20);
        assert_eq!(spikes(&imported.model, "net_1", 5), right, "alpha {alpha}, {recurrent}, {subtracts}");
    }
}

#[test]
fn a_description_stands_for_neurons_that_the_file_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let weights = noise(4 * 5, 21);
    let entries: Vec<Entry> = vec![("0.weight", vec![4, 5], weights.clone())];
    // No neuron, and a neuron of integers, are refused with a remedy, which is tried here.
    assert_eq!(import(&entries, &Options::default()).unwrap_err().code, "import.option");
    let integers = neuron(&folder, "type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024");
    let error = import(&entries, &integers).unwrap_err();
    assert!(error.code == "import.slayer" && error.message.contains("too small"), "{error}");
    assert!(error.help.unwrap().contains("{type: Leaky, beta: 0.9, threshold: 1}"));
    import(&entries, &neuron(&folder, "type: Leaky, beta: 0.9, threshold: 1")).unwrap();
    let imported = import(&entries, &neuron(&folder, "type: Leaky, beta: 0.75, reset_mechanism: zero")).unwrap();
    let layer = Snn { units: 4, alpha: 0.0, beta: 0.75, threshold: 1.0, subtracts: false, own: vec![] };
    assert_eq!(spikes(&imported.model, "0", 5).len(), STEPS);
    assert_eq!(spikes(&imported.model, "0", 5), layer.run(&currents(&weights, &[], &given(5))));
}

#[test]
fn norse_gives_what_its_steps_give_recurrent_weights_included() {
    let folder = tempfile::tempdir().unwrap();
    let (weights, own) = (noise(5 * 5, 31), noise(25, 32));
    let entries: Vec<Entry> =
        vec![("l.input_weights", vec![5, 5], weights.clone()), ("l.recurrent_weights", vec![5, 5], own.clone())];
    // Fractions of 1/4 and 1/8 in a step of 1 ms.
    let options = neuron(&folder, "type: LIF, tau_syn_inv: 250, tau_mem_inv: 125, v_th: 0.25, v_leak: 0.125");
    let imported = import(&entries, &options).unwrap();
    let (mut v, mut current, mut z) = (vec![0.0f64; 5], vec![0.0f64; 5], vec![false; 5]);
    let mut right = Vec::new();
    // Norse 1.1.0, `lif_step`.
    for step in 0..STEPS {
        let (arrives, back) = (times(&weights, &(0..5).map(|c| input(step, c)).collect::<Vec<_>>()), times(&own, &z));
        (0..5).for_each(|i| {
            let jump = current[i] + arrives[i] + back[i];
            let decayed = v[i] + 0.125 * ((0.125 - v[i]) + jump);
            z[i] = decayed > 0.25;
            v[i] = if z[i] { 0.0 } else { decayed };
            current[i] = 0.75 * jump;
        });
        right.push(z.clone());
    }
    assert!(total(&right) > 20, "{}", total(&right));
    assert_eq!(spikes(&imported.model, "l", 5), right);
    assert!(imported.notes.iter().any(|note| note.contains("v_leak")), "{:?}", imported.notes);
    // A neuron whose rest and reset are equal equals one with both at 0.
    let shifted =
        neuron(&folder, "type: LIF, tau_syn_inv: 250, tau_mem_inv: 125, v_th: -50, v_leak: -65, v_reset: -65");
    let plain = neuron(&folder, "type: LIF, tau_syn_inv: 250, tau_mem_inv: 125, v_th: 15");
    let [shifted, plain] = [shifted, plain].map(|options| import(&entries, &options).unwrap().model.populations);
    assert_eq!(shifted, plain);
}

/// `NSIM_PEERS` names a Python with the tools listed in `tests/check_peers.py`; without one this is
/// skipped.
#[test]
fn the_tools_themselves_give_the_same_spikes_and_classes() {
    let Some(python) = std::env::var_os("NSIM_PEERS") else {
        common::say("skipped: NSIM_PEERS names no Python with snntorch, norse and sinabs");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check_peers.py");
    let command = [script, env!("CARGO_BIN_EXE_nsim")];
    let output = std::process::Command::new(python).args(command).arg(folder.path()).output().unwrap();
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn lava_dl_counts_in_64ths_with_the_decays_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let weights = [0.5f32, -0.25, 0.046_875, 9.0, -9.0, 0.007_812_5];
    let decays: [Entry; 2] = [
        ("blocks.0.neuron.current_decay", vec![1], vec![1024.0]),
        ("blocks.0.neuron.voltage_decay", vec![1], vec![127.6]),
    ];
    let dense: Entry = ("blocks.0.synapse.weight", vec![2, 3, 1, 1, 1], weights.to_vec());
    let mut entries = vec![dense.clone(), decays[0].clone(), decays[1].clone()];
    let options = neuron(&folder, "type: CUBA, threshold: 1.25, tau_grad: 0.03");
    let imported = import(&entries, &options).unwrap();
    assert_eq!(imported.kind, "PyTorch state dict of lava-dl");
    let layer = &imported.model.populations[1];
    let parameter = |name: &str| layer.parameter(name).unwrap().clone();
    assert_eq!(layer.name, "blocks_0");
    assert_eq!([parameter("du"), parameter("dv"), parameter("vth_mant")], [1024.0, 128.0, 80.0].map(Parameter::Same));
    // 64 w to even steps, ties to even, clipped as in training: 3 -> 4, 0.5 -> 0.
    let right = vec![32.0, -16.0, 4.0, 254.0, -256.0, 0.0];
    assert_eq!(dense_weights(&imported, 0), right);
    let line = &imported.layers[0];
    assert_eq!((line.scale, line.shape.clone()), (64.0, vec![2, 3]));
    assert!((line.zeroed - 1.0 / 6.0).abs() < 1e-12 && (line.greatest_error - (9.0 - 254.0 / 64.0)).abs() < 1e-12);
    // A SLAYER config gives the threshold, the file the decays; if the file has none, the config
    // must.
    let slayer = neuron(&folder, "type: LOIHI, vThMant: 80, vDecay: 5, iDecay: 6, refDelay: 1");
    let with_slayer = import(&entries, &slayer).unwrap();
    assert_eq!(with_slayer.model.populations, imported.model.populations);
    assert!(with_slayer.notes.iter().any(|note| note.contains("not from --neuron")), "{:?}", with_slayer.notes);
    entries.truncate(1);
    let error = import(&entries, &options).unwrap_err();
    assert!(error.code == "import.option" && error.help.unwrap().contains("current_decay"));
    let shares = neuron(&folder, "type: CUBA, threshold: 1.25, current_decay: 0.25, voltage_decay: 0.03125");
    assert_eq!(import(&entries, &shares).unwrap().model.populations, imported.model.populations);
    // Recurrent weights reach their own layer.
    let own: Entry = ("blocks.0.recurrent_synapse.weight", vec![2, 2, 1, 1, 1], vec![0.5, 1.0, -1.0, 0.25]);
    let recurrent = import(&[dense, decays[0].clone(), decays[1].clone(), own], &options).unwrap();
    let back = &recurrent.model.projections[1];
    assert_eq!((back.from.clone(), back.to.as_str(), back.delay), (vec!["blocks_0".to_string()], "blocks_0", 0));
    assert_eq!(dense_weights(&recurrent, 1), [32.0, 64.0, -64.0, 16.0]);
}

/// The weights of a dense projection in units of the mantissa.
fn dense_weights(imported: &Imported, index: usize) -> Vec<f64> {
    let projection = &imported.model.projections[index];
    let ProjectionKind::Dense(weights) = &projection.kind else { panic!("{projection:?}") };
    weights.tensor().reals().map(|w| w * (projection.weight_exp.unwrap_or(0) as f64).exp2()).collect()
}

#[test]
fn weight_norm_is_multiplied_out_in_both_namings() {
    let folder = tempfile::tempdir().unwrap();
    let options = neuron(&folder, "type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024");
    // Rows of length 5 and 13 become rows of length 50 and 130.
    let (directions, right) = (vec![3.0f32, -4.0, 5.0, 12.0], [30.0, -40.0, 50.0, 120.0]);
    for names in [
        ["fc1.weight_g", "fc1.weight_v"],
        ["fc1.parametrizations.weight.original0", "fc1.parametrizations.weight.original1"],
    ] {
        let entries: Vec<Entry> = vec![
            (names[0], vec![2, 1, 1, 1, 1], vec![50.0, 130.0]),
            (names[1], vec![2, 2, 1, 1, 1], directions.clone()),
        ];
        let imported = import(&entries, &options).unwrap();
        assert_eq!(dense_weights(&imported, 0), right);
        assert_eq!(imported.model.output, "fc1");
        // One norm for the whole matrix, and norms of columns.
        let whole: Vec<Entry> = vec![(names[0], vec![], vec![27.856_777]), (names[1], vec![2, 2], directions.clone())];
        assert_eq!(dense_weights(&import(&whole, &options).unwrap(), 0), [6.0, -8.0, 10.0, 24.0]);
        let missing = import(&entries[1..], &options).unwrap_err();
        assert_eq!(missing.code, "import.state-dict", "{missing}");
        let ragged: Vec<Entry> = vec![(names[0], vec![3, 1], vec![1.0; 3]), (names[1], vec![2, 2], directions.clone())];
        assert_eq!(import(&ragged, &options).unwrap_err().code, "import.state-dict");
    }
}

#[test]
fn a_kernel_over_all_of_its_input_is_a_dense_layer() {
    let folder = tempfile::tempdir().unwrap();
    let options = neuron(&folder, "type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024");
    let kernel: Vec<f32> = (0..6 * 24).map(|i| 2.0 * ((i * 7 % 41) as f32 - 20.0)).collect();
    let image: Entry = ("fc1.weight", vec![6, 2, 3, 4, 1], kernel.clone());
    let next: Entry = ("fc2.weight", vec![3, 6, 1, 1, 1], vec![8.0; 18]);
    let imported = import(&[image.clone(), next.clone()], &options).unwrap();
    let as_it_is: Vec<f64> = kernel.iter().map(|&w| f64::from(w)).collect();
    assert_eq!(dense_weights(&imported, 0), as_it_is);
    let shape = |tensor: &ProjectionKind| match tensor {
        ProjectionKind::Dense(weights) => weights.tensor().shape().to_vec(),
        other => panic!("{other:?}"),
    };
    assert_eq!(shape(&imported.model.projections[0].kind), [6, 24]);
    // A single layer may be either: the shape of the input decides, and the message names it.
    let error = import(std::slice::from_ref(&image), &options).unwrap_err();
    assert!(error.code == "import.option" && error.help.unwrap().contains("--input-shape 2,3,4"));
    let shaped = Options { input_shape: Some(vec![2, 3, 4]), ..options.clone() };
    let alone = import(std::slice::from_ref(&image), &shaped).unwrap();
    assert_eq!(alone.model.populations[0].shape, [2, 3, 4]);
    assert_eq!(dense_weights(&alone, 0), as_it_is);
    // A larger input makes it a convolution.
    let larger = Options { input_shape: Some(vec![2, 8, 8]), ..options.clone() };
    assert_eq!(import(&[image.clone(), next], &larger).unwrap_err().code, "import.unsupported");
    let kernels: Entry = ("fc2.weight", vec![3, 6, 2, 2, 1], vec![8.0; 72]);
    assert_eq!(import(&[image, kernels], &options).unwrap_err().code, "import.unsupported");
}

#[test]
fn what_the_network_may_depend_on_is_used_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let loihi = neuron(&folder, "type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024, tauRho: 1, scaleRho: 1");
    let dense: Entry = ("fc1.weight", vec![2, 2], vec![20.0, -30.0, 8.0, 4.0]);
    let trained: Entry = ("slayer.srmKernel", vec![2], vec![1.0, 2.0]);
    let imported = import(&[dense.clone(), trained], &loihi).unwrap();
    assert!(imported.notes.iter().any(|note| note.contains("slayer.srmKernel")), "{:?}", imported.notes);
    import(&[dense.clone(), ("fc1.bias", vec![2], vec![0.0; 2])], &loihi).unwrap();
    import(&[dense.clone(), ("fc1.delay", vec![2], vec![0.0; 2])], &loihi).unwrap();
    for (entry, says) in [
        (("fc1.bias", vec![2], vec![0.0, 1.0]), "fc1.bias"),
        (("fc1.delay", vec![2], vec![0.0, 3.0]), "delays"),
        (("bn.running_mean", vec![2], vec![0.0, 1.0]), "batch normalisation"),
        (("fc1.threshold_step", vec![1], vec![1.0]), "fc1.threshold_step"),
        (("lif.threshold", vec![], vec![1.0]), "lif.threshold"),
        (("bn.weight", vec![2], vec![1.0, 1.0]), "normalisation"),
    ] {
        let error = import(&[dense.clone(), entry.clone()], &loihi).unwrap_err();
        let said = format!("{} {}", error.message, error.help.unwrap_or_default());
        assert!(said.contains(says), "{}: {said}", entry.0);
    }
    // Some small weights may round to zero next to large ones; all of them may not.
    let sparse: Entry = ("fc1.weight", vec![1, 4], vec![0.1, -0.2, 0.3, 90.0]);
    assert!((import(&[sparse], &loihi).unwrap().layers[0].zeroed - 0.75).abs() < 1e-12);
    let lost: Entry = ("fc1.weight", vec![1, 4], vec![0.1, -0.2, 0.9, 1.1]);
    assert_eq!(import(&[lost], &loihi).unwrap_err().code, "import.slayer");
    // snnTorch: graded spikes and no reset are unsupported, and the file's neurons are not
    // described twice.
    let layer = |change: usize, value: f32| {
        let mut entries: Vec<Entry> = vec![("fc1.weight", vec![1, 1], vec![1.0])];
        entries.extend(leaky(LIF1, 0.5, 1.0, 0.0));
        entries[change].2 = vec![value];
        entries
    };
    import(&layer(1, 1.0), &Options::default()).unwrap();
    for (change, value) in [(2, 2.0), (3, 2.0)] {
        assert_eq!(import(&layer(change, value), &Options::default()).unwrap_err().code, "import.state-dict");
    }
    assert_eq!(import(&layer(1, 1.0), &loihi).unwrap_err().code, "import.option");
    // Every imported parameter changes the model.
    let plain = import(&layer(1, 1.0), &Options::default()).unwrap().model;
    for (change, value) in [(0, 0.5), (1, 0.5), (3, 1.0), (4, 0.25)] {
        assert_ne!(import(&layer(change, value), &Options::default()).unwrap().model, plain, "{change}");
    }
    let names: BTreeMap<&str, usize> = layer(1, 1.0).iter().enumerate().map(|(i, entry)| (entry.0, i)).collect();
    assert_eq!(names.len(), 5);
}

#[test]
fn a_note_says_in_what_order_layers_were_taken() {
    let named = ["b.threshold", "b.graded_spikes_factor", "b.reset_mechanism_val", "b.beta"];
    let mut entries: Vec<Entry> =
        vec![("fc1.weight", vec![2, 3], vec![1.0; 6]), ("fc2.weight", vec![2, 2], vec![1.0; 4])];
    entries.extend(leaky(LIF1, 0.5, 1.0, 1.0));
    entries.extend(leaky(named, 0.75, 1.0, 1.0));
    entries.push(("b.alpha", vec![], vec![0.5]));
    let imported = import(&entries, &Options::default()).unwrap();
    let assumed = imported.warnings[0].to_string();
    assert!(assumed.contains(": fc1 -> lif1 (Leaky) -> fc2 -> b (Synaptic);"), "{assumed}");
    assert!(["forward()", "inhibition", "reset_delay", "nsim.from_torch"].iter().all(|word| assumed.contains(word)));
    assert!(imported.notes.contains(&assumed));
    // A loaded network keeps the assumption.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.pt");
    std::fs::write(&path, checkpoint(&entries)).unwrap();
    let network = nsim::load_model(path.to_str().unwrap()).unwrap();
    assert_eq!(network.conventions().warnings[0].to_string(), assumed);
    assert_eq!(network.conventions().notes, imported.notes);
    // A command prints it once.
    let map = std::process::Command::new(env!("CARGO_BIN_EXE_nsim")).arg("map").arg(&path).output().unwrap();
    let stderr = String::from_utf8_lossy(&map.stderr);
    assert!(map.status.success() && stderr.matches(&assumed).count() == 1, "{stderr}");
    // The neurons are integers, or described by the user.
    for text in ["type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024", "type: Leaky, beta: 0.75"] {
        let dense = |name| (name, vec![2, 2], vec![20.0; 4]);
        let imported = import(&[dense("a.weight"), dense("b.weight")], &neuron(&folder, text)).unwrap();
        let assumed = imported.warnings[0].to_string();
        assert!(assumed.contains(": a -> b;") && imported.notes.contains(&assumed), "{assumed}");
    }
    let lif = "type: LIF, tau_syn_inv: 200, tau_mem_inv: 100, v_leak: 0, v_th: 1, v_reset: 0";
    let cells = import(&[("a.weight", vec![2, 2], vec![2.0; 4])], &neuron(&folder, lif)).unwrap();
    assert!(cells.warnings[0].message.contains("all are read as LIFCell"));
}

#[test]
fn neurons_that_a_state_dict_cannot_tell_or_that_are_not_read_are_refused() {
    let refused = |more: &[Entry], words: &[&str]| {
        let mut entries: Vec<Entry> = vec![("fc1.weight", vec![2, 2], vec![1.0; 4])];
        entries.extend(leaky(LIF1, 0.75, 1.0, 1.0));
        entries.extend_from_slice(more);
        let error = import(&entries, &Options::default()).unwrap_err();
        let said = format!("{} {}", error.message, error.help.unwrap_or_default());
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert!(said.contains("nsim.from_torch(net, sample)") && !said.contains("del state"), "{said}");
    };
    // Alpha requires alpha above beta, and has Synaptic's names; a recurrent layer is none.
    refused(&[("lif1.alpha", vec![], vec![0.875])], &["Synaptic", "Alpha"]);
    refused(&[("lif1.alpha", vec![2], vec![0.875, 0.8125])], &["Synaptic", "Alpha"]);
    let mut entries: Vec<Entry> = vec![("fc1.weight", vec![2, 2], vec![1.0; 4])];
    entries.extend(leaky(LIF1, 0.75, 1.0, 1.0));
    entries.push(("lif1.alpha", vec![2], vec![0.875, 0.75]));
    import(&entries, &Options::default()).unwrap();
    entries.pop();
    entries.extend([("lif1.alpha", vec![], vec![0.875]), ("lif1.recurrent.weight", vec![2, 2], vec![0.5; 4])]);
    import(&entries, &Options::default()).unwrap();
    // Every tensor of Lapicque, also alone.
    for name in ["lif1.time_step", "lif1.R", "lif1.C"] {
        refused(&[(name, vec![], vec![1.0])], &[name, "Lapicque"]);
    }
    refused(&[("lif1.tau", vec![], vec![1.0])], &["lif1.tau", "StateLeaky"]);
    refused(&[("lif1.other", vec![], vec![1.0])], &["lif1.other", "another kind"]);
    // Two layers with the neurons of a single one.
    refused(&[("fc2.weight", vec![2, 2], vec![1.0; 4])], &["fc1, fc2", "share neurons"]);
}
