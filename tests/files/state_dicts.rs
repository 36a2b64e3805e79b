//! State dicts of SLAYER and lava-dl are read as their tools mean them, all others are refused.
//!
//! The pickles are written by hand, as torch's `serialization.py` does; the expected weights are
//! computed here, without any code of nsim.

use std::path::{Path, PathBuf};

use crate::torch::{Entry, checkpoint, nested};
use nsim::files::lower::lower;
use nsim::files::network::{Parameter, ProjectionKind};
use nsim::import::foreign;
use nsim::import::foreign::{Imported, Options};
use nsim::ir::base::diagnostic::Diagnostic;

const LOIHI: &str = "type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024, tauRho: 1, scaleRho: 1";

fn read(bytes: Vec<u8>, options: &Options) -> Result<Imported, Diagnostic> {
    let imported = foreign::from_bytes(Path::new("net.ckpt"), bytes, options)?;
    lower(&imported.model.build(Path::new("net.ckpt"))?)?;
    Ok(imported)
}

fn import(entries: &[Entry], options: &Options) -> Result<Imported, Diagnostic> {
    read(checkpoint(entries), options)
}

/// The message of a refusal, and its help.
fn said(refused: Result<Imported, Diagnostic>) -> String {
    let error = refused.unwrap_err();
    format!("{}: {} {}", error.code, error.message, error.help.unwrap_or_default())
}

/// Options with a neuron of this YAML text.
fn neuron(folder: &tempfile::TempDir, text: &str) -> Options {
    let path: PathBuf = folder.path().join(format!("{}.yml", folder.path().read_dir().unwrap().count()));
    std::fs::write(&path, format!("neuron: {{{text}}}\n")).unwrap();
    Options { neuron: Some(path), ..Options::default() }
}

/// The weights of a dense layer, with the axes of SLAYER and lava-dl.
fn dense(name: &'static str, [targets, sources]: [usize; 2], weights: &[f32]) -> Entry {
    (name, vec![targets, sources, 1, 1, 1], weights.to_vec())
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
fn weights_in_two_parts_are_multiplied_out() {
    let folder = tempfile::tempdir().unwrap();
    let options = neuron(&folder, LOIHI);
    // Rows of length 5 and 13 become rows of length 50 and 130.
    let (directions, right) = (&[3.0f32, -4.0, 5.0, 12.0][..], [30.0, -40.0, 50.0, 120.0]);
    for names in [
        ["fc1.weight_g", "fc1.weight_v"],
        ["fc1.parametrizations.weight.original0", "fc1.parametrizations.weight.original1"],
    ] {
        let directions = dense(names[1], [2, 2], directions);
        let entries = [(names[0], vec![2, 1, 1, 1, 1], vec![50.0, 130.0]), directions.clone()];
        let imported = import(&entries, &options).unwrap();
        assert_eq!(dense_weights(&imported, 0), right);
        assert_eq!(imported.model.output, "fc1");
        // One norm for the whole matrix.
        let whole = [(names[0], vec![], vec![27.856_777]), directions.clone()];
        assert_eq!(dense_weights(&import(&whole, &options).unwrap(), 0), [6.0, -8.0, 10.0, 24.0]);
        assert!(
            said(import(&entries[1..], &options))
                .contains(&format!("'{}' of shape [2, 2, 1, 1, 1] is of no", names[1]))
        );
        let ragged = [(names[0], vec![3, 1, 1, 1, 1], vec![1.0; 3]), directions];
        assert!(said(import(&ragged, &options)).contains("do not belong together"));
    }
    // torch.nn.utils.prune.
    let values = dense("fc1.weight_orig", [2, 2], &[30.0, -40.0, 50.0, 120.0]);
    let mask = dense("fc1.weight_mask", [2, 2], &[1.0, 0.0, 0.0, 1.0]);
    let pruned = import(&[values.clone(), mask.clone()], &options).unwrap();
    assert_eq!(dense_weights(&pruned, 0), [30.0, 0.0, 0.0, 120.0]);
    assert!(
        said(import(std::slice::from_ref(&values), &options)).contains("'fc1.weight_orig' of shape [2, 2, 1, 1, 1]")
    );
    let twice = [values, mask, dense("fc1.weight", [2, 2], &[2.0; 4])];
    assert!(said(import(&twice, &options)).contains("given twice"));
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
    let loihi = neuron(&folder, LOIHI);
    let layer = dense("fc1.weight", [2, 2], &[20.0, -30.0, 8.0, 4.0]);
    let with = |entry: Entry| import(&[layer.clone(), entry], &loihi);
    for name in ["slayer.srmKernel", "fc1.bias", "fc1.delay"] {
        let imported = with((name, vec![2], vec![0.0; 2])).unwrap();
        assert!(imported.notes[0].contains(&format!("not used: {name}")), "{:?}", imported.notes);
    }
    for (entry, says) in [
        (("fc1.delay", vec![2], vec![0.0, 3.0]), "learned delays"),
        (("fc1.bias", vec![2], vec![0.0, 1.0]), "'fc1.bias' of shape [2] is of no layer"),
        (("bn.weight", vec![2], vec![1.0, 1.0]), "'bn.weight' of shape [2] is of no layer"),
    ] {
        let said = said(with(entry));
        assert!(said.contains(says), "{said}");
    }
    // Some small weights may round to zero next to large ones; all of them may not.
    let sparse = dense("fc1.weight", [1, 4], &[0.1, -0.2, 0.3, 90.0]);
    assert!((import(&[sparse], &loihi).unwrap().layers[0].zeroed - 0.75).abs() < 1e-12);
    let lost = [dense("fc1.weight", [1, 4], &[0.1, -0.2, 0.9, 1.1])];
    assert!(said(import(&lost, &loihi)).contains("have the type CUBA in --neuron"));
    let cuba = neuron(&folder, "type: CUBA, threshold: 1.25, current_decay: 0.25, voltage_decay: 0.03125");
    import(&lost, &cuba).unwrap();
    assert!(said(import(&[layer], &neuron(&folder, "type: Leaky, beta: 0.5"))).contains("'Leaky' is not supported"));
}

#[test]
fn a_note_says_in_what_order_layers_were_taken_and_inputs_have_the_names_of_their_layers() {
    let folder = tempfile::tempdir().unwrap();
    let loihi = neuron(&folder, LOIHI);
    let layer = |name, targets, sources| dense(name, [targets, sources], &vec![20.0; targets * sources]);
    let imported = import(&[layer("b.weight", 2, 3), layer("a.weight", 4, 2)], &loihi).unwrap();
    let assumed = imported.warnings[0].to_string();
    assert!(assumed.contains(": b -> a; a state dict lacks") && imported.notes.contains(&assumed), "{assumed}");
    let names = |imported: &Imported| imported.model.populations.iter().map(|one| one.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&imported), ["input", "b", "a"]);
    let three = [layer("tact_fc.weight", 3, 5), layer("vis_fc.weight", 2, 4), layer("combi.weight", 1, 5)];
    let joined = import(&three, &loihi).unwrap();
    assert_eq!(names(&joined), ["tact_fc_input", "vis_fc_input", "tact_fc", "vis_fc", "combi"]);
    assert_eq!(joined.model.projections[2].from, ["tact_fc", "vis_fc"]);
    assert!(said(import(&three[1..], &loihi)).contains("do not follow each other"));
}

#[test]
fn the_state_dict_of_a_trainers_checkpoint_is_read_and_the_rest_named() {
    let folder = tempfile::tempdir().unwrap();
    let loihi = neuron(&folder, LOIHI);
    let layers = &[dense("model.fc1.weight", [2, 3], &[20.0; 6]), dense("model.fc2.weight", [1, 2], &[30.0; 2])][..];
    let score = &[("ModelCheckpoint{'monitor': 'val.acc'}.best_model_score", vec![], vec![0.5])][..];
    let adam = &[("state.0.exp_avg", vec![2, 3], vec![0.5; 6])][..];
    let plain = import(layers, &loihi).unwrap().model.populations;
    for (parts, unused) in [
        (&[("state_dict", layers), ("callbacks", score), ("ema", layers)][..], "callbacks.ModelCheckpoint"),
        (&[("optimizer_state_dict", adam), ("model_state_dict", layers)], "optimizer_state_dict.state.0"),
        (&[("net", layers), ("optimizer", adam)], "optimizer.state.0.exp_avg"),
    ] {
        let imported = read(nested(parts), &loihi).unwrap();
        assert_eq!(imported.model.populations, plain);
        assert!(imported.notes[0].starts_with(&format!("not used: {unused}")), "{:?}", imported.notes);
    }
    let several = said(read(nested(&[("actor", layers), ("critic", layers)]), &loihi));
    assert!(
        several.contains(r#"torch.save(torch.load("net.ckpt", map_location="cpu")["actor"], "weights.pt")"#),
        "{several}"
    );
}

#[test]
fn state_dicts_of_other_tools_are_refused_with_the_python_that_reads_their_networks() {
    let folder = tempfile::tempdir().unwrap();
    let number = |name: &'static str| -> Entry { (name, vec![], vec![0.5]) };
    let linear = |name: &'static str| -> Entry { (name, vec![2, 2], vec![20.0; 4]) };
    let lines = |key: &str| {
        format!(
            ":\n    import nsim, torch\n    net.load_state_dict(torch.load(\"net.ckpt\", map_location=\"cpu\"){key})\n    \
             nsim.from_torch(net, sample).save(\"net.ron\")"
        )
    };
    for (entries, named) in [
        // snnTorch, whatever its neurons; spikingjelly's PLIF; Norse; layers without neurons.
        (vec![linear("1.weight"), ("1.bias", vec![2], vec![1.0; 2]), number("lif.beta")], "'lif.beta' of shape []"),
        (vec![linear("0.weight"), number("1.w")], "'1.w' of shape []"),
        (vec![linear("l.input_weights"), linear("l.recurrent_weights")], "'l.input_weights' of shape [2, 2]"),
        (vec![linear("0.weight"), linear("2.weight")], "'0.weight' of shape [2, 2]"),
        (vec![("conv.weight", vec![2, 1, 3, 3], vec![1.0; 18])], "'conv.weight' of shape [2, 1, 3, 3]"),
    ] {
        for options in [Options::default(), neuron(&folder, LOIHI), neuron(&folder, "type: Leaky, beta: 0.5")] {
            for (bytes, key) in [(checkpoint(&entries), ""), (nested(&[("state_dict", &entries)]), "[\"state_dict\"]")]
            {
                let said = said(read(bytes, &options));
                assert!(said.starts_with(&format!("import.state-dict: tensor {named} is of no layer")), "{said}");
                assert!(said.ends_with(&lines(key)) && !said.contains("del "), "{said}");
            }
        }
    }
    // Blocks of lava-dl that are not read.
    let block = dense("blocks.0.synapse.weight", [2, 2], &[0.5; 4]);
    for (name, says) in [
        ("blocks.0.neuron.delta.threshold", "sigma-delta"),
        ("blocks.0.delay.delay", "learned delays"),
        ("blocks.0.neuron.sin_decay", "other than a dense layer of CUBA"),
    ] {
        let said = said(import(&[block.clone(), (name, vec![1], vec![1.0])], &Options::default()));
        assert!(said.contains(name) && said.contains(says) && said.contains("net.export_hdf5(\"net.net\")"), "{said}");
    }
}
