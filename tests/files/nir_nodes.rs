//! Nodes of NIR and layers of netx: their semantics, their export, and the check that no field is
//! ignored.

use std::path::Path;

use crate::real::{STEPS, input, spikes, total};
use crate::tree::{int, ints, nir, node, reals, typed};
use nsim::files::lower::lower;
use nsim::files::network::{NetworkFile, Parameter, ProjectionDesc, ProjectionKind};
use nsim::import::foreign;
use nsim::import::foreign::{DecayRule, Imported, Options, Reading, ResetMode, Tool, netx_export, nir_export};
use nsim::import::hdf5;
use nsim::import::hdf5::{Group, Item, Numbers};
use nsim::ir::arithmetic::ThresholdTest;
use nsim::ir::base::diagnostic::{Diagnostic, SourceText};
use nsim::ir::base::rng;
use nsim::ir::neurons::NeuronKind;

/// Numbers from -0.5 to 1.5 in steps of 1/64.
pub fn noise(count: usize, seed: u64) -> Vec<f64> {
    (0..count as u64).map(|i| (rng::below(129, seed, i, 0) as f64 - 32.0) / 64.0).collect()
}

fn weights(shape: &[usize], seed: u64) -> Numbers {
    Numbers::f64(shape, &noise(shape.iter().product(), seed))
}

/// A file whose nodes form a chain.
pub fn file(nodes: &[(&str, Group)]) -> Group {
    file_with(nodes, &[], &[])
}

/// A file whose nodes form a chain, with more nodes and edges.
pub fn file_with(nodes: &[(&str, Group)], others: &[(&str, Group)], more: &[(&str, &str)]) -> Group {
    let row = nodes.windows(2).map(|pair| (pair[0].0, pair[1].0));
    nir(nodes.iter().chain(others).cloned(), row.chain(more.iter().copied()))
}

pub fn read(root: &Group, options: &Options) -> Result<Imported, Diagnostic> {
    let imported = foreign::from_bytes(Path::new("net.nir"), hdf5::write(root).unwrap(), options)?;
    lower(&imported.model.build(Path::new("net.nir"))?)?;
    Ok(imported)
}

/// Options with a timestep of 1 ms.
fn step() -> Options {
    given("", 1.0, None)
}

/// Options of a tool's name (none if empty), a timestep in ms (none if 0) and a reset.
pub fn given(tool: &str, dt_ms: f64, reset: Option<ResetMode>) -> Options {
    let tool = Tool::ALL.into_iter().find(|one| one.name() == tool);
    let reading = Reading { dt_ms: (dt_ms > 0.0).then_some(dt_ms), tool, reset };
    Options { reading, ..Options::default() }
}

fn import(root: &Group) -> NetworkFile {
    read(root, &step()).unwrap().model
}

/// Leaky neurons that lose an eighth in a step, with unscaled weights.
pub fn lif(axes: &[usize]) -> Group {
    node("LIF", axes, &[("tau", 0.008), ("r", 8.0), ("v_leak", 0.0), ("v_threshold", 1.0)])
}

/// Leaky neurons with a current that loses a quarter in a step.
pub fn cuba(axes: &[usize]) -> Group {
    let fields =
        [("tau_syn", 0.004), ("w_in", 4.0), ("tau_mem", 0.008), ("r", 8.0), ("v_leak", 0.0), ("v_threshold", 1.0)];
    node("CubaLIF", axes, &fields)
}

pub fn source(axes: &[i64]) -> Group {
    typed("Input").with("shape", ints(axes))
}

pub fn output() -> Group {
    typed("Output")
}

fn linear(targets: usize, sources: usize, seed: u64) -> Group {
    typed("Linear").with("weight", weights(&[targets, sources], seed))
}

/// Spikes of `lif` neurons with these currents.
fn leaky(currents: &[Vec<f64>]) -> Vec<Vec<bool>> {
    let mut v = vec![0.0; currents[0].len()];
    let step = |current: &Vec<f64>| {
        v.iter_mut()
            .zip(current)
            .map(|(v, current)| {
                *v = 0.875 * *v + current;
                let spike = *v > 1.0;
                *v = if spike { 0.0 } else { *v };
                spike
            })
            .collect()
    };
    currents.iter().map(step).collect()
}

#[test]
fn same_padding_of_even_kernels_puts_the_greater_half_behind() {
    let (height, width, kh, kw) = (3, 5, 2, 4);
    let kernel = noise(kh * kw, 1);
    let conv = typed("Conv2d")
        .with("weight", Numbers::f64(&[1, 1, kh, kw], &kernel))
        .with("padding", "same")
        .with("stride", int(1))
        .with("input_shape", ints(&[3, 5]));
    let root = file(&[("i", source(&[1, 3, 5])), ("c", conv), ("n", lif(&[1, 3, 5])), ("o", output())]);
    let model = import(&root);
    let currents: Vec<Vec<f64>> = (0..STEPS)
        .map(|step| {
            let at = |y: usize, x: usize| -> f64 {
                let mut sum = 0.0;
                for (ky, kx) in (0..kh).flat_map(|ky| (0..kw).map(move |kx| (ky, kx))) {
                    // torch pads one of three columns before and two after, and the row after.
                    let (Some(sy), Some(sx)) = ((y + ky).checked_sub(0), (x + kx).checked_sub(1)) else { continue };
                    if sy < height && sx < width && input(step, sy * width + sx) {
                        sum += kernel[ky * kw + kx];
                    }
                }
                sum
            };
            (0..height * width).map(|i| at(i / width, i % width)).collect()
        })
        .collect();
    let right = leaky(&currents);
    assert!(total(&right) > 50);
    assert_eq!(spikes(&model, "n", height * width), right);
    // NIR has one padding an axis, so the kernel is padded with zeros, to an equal result.
    assert_eq!(spikes(&bare(&model), "n", height * width), right);
}

/// The part of an export that another tool preserves: its nodes.
fn bare(model: &NetworkFile) -> NetworkFile {
    let (tree, notes) = nir_export::export(model).unwrap();
    assert!(notes.iter().all(|note| !note.contains("nir.read")), "{notes:?}");
    let graph = tree.group("node").unwrap();
    for node in graph.group("nodes").unwrap().items.values() {
        // Python's reader assumes square kernels without groups.
        let Item::Group(node) = node else { panic!() };
        if node.text("type") == Some("Conv2d") {
            let axes = node.numbers("weight").unwrap().shape();
            assert!(axes[2] == axes[3] && node.number("groups") == Some(1.0), "{axes:?}");
        }
    }
    let mut graph = graph.clone();
    graph.items.remove("metadata");
    import(&Group::default().with("node", graph))
}

#[test]
fn delays_of_sources_and_of_targets_become_those_of_synapses() {
    let (first, second) = (noise(5 * 4, 11), noise(3 * 5, 12));
    let (before, behind) = ([0usize, 1, 2, 5, 2], [0usize, 3, 1]);
    let delay = |steps: &[usize]| {
        typed("Delay").with("delay", reals(&steps.iter().map(|&steps| steps as f64 / 1e3).collect::<Vec<_>>()))
    };
    let graph = |before: Group, behind: Group| {
        let matrix =
            |w: &[f64], targets: usize| typed("Linear").with("weight", Numbers::f64(&[targets, w.len() / targets], w));
        let nodes = [
            ("i", source(&[4])),
            ("w1", matrix(&first, 5)),
            ("a", lif(&[5])),
            ("d1", before),
            ("w2", matrix(&second, 3)),
            ("d2", behind),
            ("b", lif(&[3])),
            ("o", output()),
        ];
        file(&nodes)
    };
    let model = import(&graph(delay(&before), delay(&behind)));
    let hear = |weights: &[f64], target: usize, sources: usize, spike: &dyn Fn(usize) -> bool| -> f64 {
        (0..sources).filter(|&s| spike(s)).map(|s| weights[target * sources + s]).sum()
    };
    let currents =
        (0..STEPS).map(|t| (0..5).map(|i| hear(&first, i, 4, &|s| input(t, s))).collect()).collect::<Vec<Vec<f64>>>();
    let a = leaky(&currents);
    let currents = (0..STEPS)
        .map(|t| {
            let spike = |i: usize, s: usize| t.checked_sub(1 + before[s] + behind[i]).is_some_and(|t| a[t][s]);
            (0..3).map(|i| hear(&second, i, 5, &|s| spike(i, s))).collect()
        })
        .collect::<Vec<Vec<f64>>>();
    let b = leaky(&currents);
    assert!(total(&a) > 20 && total(&b) > 10);
    assert_eq!((spikes(&model, "a", 4), spikes(&model, "b", 4)), (a, b.clone()));
    assert_eq!(spikes(&bare(&model), "b", 4), b);
    let long = read(&graph(delay(&[40; 5]), delay(&[30; 3])), &step()).unwrap_err();
    assert!(long.code == "import.unsupported" && long.message.contains("70"), "{long}");
}

#[test]
fn a_kernel_whose_sources_have_delays_of_their_own_is_listed() {
    let delay = typed("Delay").with("delay", Numbers::f64(&[1, 2, 2], &[0.0, 0.001, 0.002, 0.003]));
    let kernel = [0.5, 0.75, -0.25, 1.0];
    let conv = typed("Conv2d").with("weight", Numbers::f64(&[1, 1, 2, 2], &kernel)).with("stride", int(1));
    let nodes = [("i", source(&[1, 2, 2])), ("d", delay), ("c", conv), ("n", lif(&[1, 1, 1])), ("o", output())];
    let model = import(&file(&nodes));
    let current = |t: usize| (0..4).filter(|&s| t.checked_sub(s).is_some_and(|t| input(t, s))).map(|s| kernel[s]).sum();
    let right = leaky(&(0..STEPS).map(|t| vec![current(t)]).collect::<Vec<_>>());
    assert!(total(&right) > 5);
    assert_eq!(spikes(&model, "n", 4), right);
}

#[test]
fn a_reset_is_assumed_with_a_warning_unless_an_option_states_it() {
    let with_reset = |root: &Group, reset: Option<ResetMode>| read(root, &given("", 1.0, reset));
    let says = |root: &Group, reset: Option<ResetMode>| {
        with_reset(root, reset).map(|read| read.warnings.iter().any(|said| said.code.name() == "reset-assumed"))
    };
    let with = |neuron: Group| file(&[("i", source(&[2])), ("w", linear(3, 2, 5)), ("n", neuron), ("o", output())]);
    // The library nir writes v_reset 0 for exporters that do not state it.
    let (unsaid, zero) = (with(lif(&[3])), with(lif(&[3]).with("v_reset", reals(&[0.0; 3]))));
    for root in [&unsaid, &zero] {
        assert!(says(root, None).unwrap());
        for reset in ResetMode::ALL {
            let taken = with_reset(root, Some(reset)).unwrap();
            assert_eq!(taken.reset, Some(reset));
            assert!(taken.warnings.iter().all(|warning| warning.code.name() != "reset-assumed"));
        }
    }
    assert!(says(&unsaid, None).unwrap() && !says(&unsaid, Some(ResetMode::SubtractLater)).unwrap());
    // The command prints the assumed reset on stderr, and uses it.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.nir");
    std::fs::write(&path, hdf5::write(&unsaid).unwrap()).unwrap();
    for (words, taken, warns) in [(&[][..], "zero", true), (&["--reset", "subtract-later"], "subtract-later", false)] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_nsim"));
        let import =
            command.arg("import").arg(&path).args(["--dt", "1", "--format", "json"]).args(words).output().unwrap();
        let json: serde_json::Value = serde_json::from_slice(&import.stdout).unwrap();
        let stderr = String::from_utf8_lossy(&import.stderr);
        assert!(import.status.success() && stderr.contains("the file does not state the reset") == warns, "{stderr}");
        assert_eq!(json["reset"], taken);
    }
    let other = with(lif(&[3]).with("v_reset", reals(&[0.5; 3])));
    assert_eq!(says(&other, None).unwrap_err().code, "import.unsupported");
    // An export has a model; options that contradict it are refused, options that repeat it are
    // not.
    let (tree, _) = nir_export::export(&import(&unsaid)).unwrap();
    assert_eq!(says(&tree, Some(ResetMode::Subtract)).unwrap_err().code, "import.option");
    assert_eq!(read(&tree, &given("", 2.0, None)).unwrap_err().code, "import.option");
    assert!(!says(&tree, Some(ResetMode::Zero)).unwrap());
}

#[test]
fn a_timestep_beyond_a_time_constant_that_decays_exponentially_is_told() {
    let root = file(&[("i", source(&[2])), ("w", linear(4, 2, 5)), ("n", cuba(&[4])), ("o", output())]);
    let assumed = |dt_ms: f64| {
        let options = Options { decay: Some(DecayRule::Exponential), ..given("", dt_ms, None) };
        let warnings = read(&root, &options).unwrap().warnings;
        warnings.iter().find(|warning| warning.code.name() == "long-timestep").map(ToString::to_string)
    };
    assert_eq!(assumed(1.0), None);
    let warned = assumed(6.0).unwrap();
    assert!(
        ["its 'tau_syn' is 0.66667 timesteps", "nsim.from_torch"].iter().all(|word| warned.contains(word)),
        "{warned}"
    );
    assert!(!warned.contains("tau_mem"), "{warned}");
}

#[test]
fn subtraction_a_step_later_is_snntorchs_rule_with_and_without_a_current() {
    let w = noise(4 * 3, 21);
    for (neuron, alpha) in [(lif(&[4]), 0.0), (cuba(&[4]), 0.75)] {
        let weights = typed("Linear").with("weight", Numbers::f64(&[4, 3], &w));
        let root = file(&[("i", source(&[3])), ("w", weights), ("n", neuron), ("o", output())]);
        let options = given("", 1.0, Some(ResetMode::SubtractLater));
        let model = read(&root, &options).unwrap().model;
        let (mut syn, mut mem) = ([0.0; 4], [0.0; 4]);
        let right: Vec<Vec<bool>> = (0..STEPS)
            .map(|t| {
                (0..4)
                    .map(|i| {
                        let current: f64 = (0..3).filter(|&s| input(t, s)).map(|s| w[i * 3 + s]).sum();
                        syn[i] = alpha * syn[i] + current;
                        mem[i] = 0.875 * mem[i] + syn[i] - f64::from(u8::from(mem[i] > 1.0));
                        mem[i] > 1.0
                    })
                    .collect()
            })
            .collect();
        assert!(total(&right) > 20);
        assert_eq!(spikes(&model, "n", 3), right, "alpha {alpha}");
        let at_once = read(&root, &given("", 1.0, Some(ResetMode::Subtract))).unwrap().model;
        assert_ne!(spikes(&at_once, "n", 3), right);
    }
}

#[test]
fn every_kind_of_node_keeps_its_spikes_over_an_export_that_another_tool_rewrote() {
    let pool = |kind: &str| {
        typed(kind).with("kernel_size", ints(&[2, 2])).with("stride", ints(&[2, 2])).with("padding", ints(&[0, 0]))
    };
    let affine = |targets: usize, sources: usize, seed: u64| {
        typed("Affine").with("weight", weights(&[targets, sources], seed)).with(
            "bias",
            Numbers::f64(&[targets], &noise(targets, seed + 1).iter().map(|b| b / 4.0).collect::<Vec<_>>()),
        )
    };
    let conv = |axes: [usize; 4], groups: i64| {
        typed("Conv2d")
            .with("weight", weights(&axes, 31))
            .with("bias", Numbers::f64(&[axes[0]], &noise(axes[0], 32).iter().map(|b| b / 8.0).collect::<Vec<_>>()))
            .with("stride", ints(&[1, 1]))
            .with("padding", ints(&[1, 0]))
            .with("dilation", ints(&[1, 1]))
            .with("groups", int(groups))
    };
    let line = typed("Conv1d")
        .with("weight", weights(&[3, 2, 3], 33))
        .with("bias", reals(&[0.25, 0.0, 0.125]))
        .with("stride", int(1))
        .with("padding", int(1))
        .with("dilation", int(1))
        .with("groups", int(1));
    let integrate = node("IF", &[3], &[("r", 1.0), ("v_threshold", 2.0)]);
    let threshold = node("Threshold", &[3], &[("threshold", 0.5)]);
    let back = [("n", "r"), ("r", "n")];
    type Chain = (&'static str, Vec<i64>, Vec<Group>, bool);
    let chains: Vec<Chain> = vec![
        ("Linear LIF", vec![4], vec![linear(3, 4, 1), lif(&[3])], false),
        ("Affine LIF", vec![4], vec![affine(3, 4, 2), lif(&[3])], false),
        ("Affine CubaLIF", vec![4], vec![affine(3, 4, 3), cuba(&[3])], false),
        ("recurrent", vec![4], vec![affine(3, 4, 4), cuba(&[3])], true),
        (
            "Scale",
            vec![4],
            vec![linear(3, 4, 5), typed("Scale").with("scale", reals(&[1.0, 0.5, 1.5])), lif(&[3])],
            false,
        ),
        ("IF", vec![4], vec![affine(3, 4, 6), integrate], false),
        ("Threshold", vec![4], vec![affine(3, 4, 7), threshold], false),
        ("Conv2d", vec![2, 3, 4], vec![conv([3, 2, 3, 3], 1), lif(&[3, 3, 2])], false),
        ("Conv2d, a current with a bias", vec![2, 3, 4], vec![conv([3, 2, 3, 3], 1), cuba(&[3, 3, 2])], false),
        ("Conv2d in groups, not square", vec![2, 3, 4], vec![conv([4, 1, 3, 1], 2), lif(&[4, 3, 4])], false),
        ("Conv1d", vec![2, 5], vec![line, lif(&[3, 5])], false),
        ("SumPool2d", vec![1, 4, 4], vec![pool("SumPool2d"), lif(&[1, 2, 2])], false),
        ("AvgPool2d", vec![1, 4, 4], vec![pool("AvgPool2d"), lif(&[1, 2, 2])], false),
        ("Flatten", vec![1, 2, 2], vec![typed("Flatten"), linear(3, 4, 8), lif(&[3])], false),
    ];
    for (name, axes, nodes, recurrent) in chains {
        let last = nodes.len() - 1;
        let names: Vec<String> = (0..=last).map(|k| if k == last { "n".into() } else { format!("l{k}") }).collect();
        let mut all = vec![("i", source(&axes))];
        all.extend(names.iter().map(String::as_str).zip(nodes));
        all.push(("o", output()));
        let root = match recurrent {
            true => file_with(&all, &[("r", affine(3, 3, 9))], &back),
            false => file(&all),
        };
        let model = import(&root);
        let channels = axes.iter().product::<i64>() as usize;
        let right = spikes(&model, "n", channels);
        assert!(total(&right) > 10, "{name}: {}", total(&right));
        assert_eq!(spikes(&bare(&model), "n", channels), right, "{name}");
        // A file rewritten with its metadata is restored.
        let (tree, _) = nir_export::export(&model).unwrap();
        assert_eq!(read(&tree, &Options::default()).unwrap().model, model, "{name}");
    }
    // Integrators stay integrators, not neurons that never spike.
    for kind in ["LI", "CubaLI", "I"] {
        let node = match kind {
            "LI" => node(kind, &[3], &[("tau", 0.016), ("r", 16.0), ("v_leak", 0.0)]),
            "I" => node(kind, &[3], &[("r", 1.0)]),
            _ => {
                let fields = [("tau_syn", 0.004), ("w_in", 4.0), ("tau_mem", 0.016), ("r", 16.0), ("v_leak", 0.0)];
                node(kind, &[3], &fields)
            }
        };
        let model = import(&file(&[("i", source(&[4])), ("w", affine(3, 4, 41)), ("n", node), ("o", output())]));
        let (tree, _) = nir_export::export(&model).unwrap();
        assert_eq!(tree.group("node/nodes/n").unwrap().text("type"), Some("CubaLI"), "{kind}");
        let again = bare(&model);
        assert_eq!(again.population("n"), model.population("n"), "{kind}");
    }
}

#[test]
fn a_pool_of_slayer_has_silent_rows_behind_where_the_file_says_so() {
    let layer = |shape: [i64; 3]| {
        let neuron = |vth: i64| {
            typed("CUBA")
                .with("iDecay", int(4096))
                .with("vDecay", int(4096))
                .with("vThMant", int(vth))
                .with("refDelay", int(1))
        };
        let input = typed("input").with("shape", ints(&[1, 6, 7]));
        let pool = typed("pool")
            .with("shape", ints(&shape))
            .with("neuron", neuron(100))
            .with("weight", Numbers::i64(&[1, 1, 2, 2, 1], &[70; 4]))
            .with("kernelSize", ints(&[2, 2]))
            .with("stride", ints(&[2, 2]))
            .with("padding", ints(&[0, 0]));
        let layers = Group::default().with("0", input).with("1", pool);
        read(&Group::default().with("layer", layers), &Options::default())
    };
    let after = |imported: Imported| match imported.model.projections[0].kind {
        ProjectionKind::SumPool2d { padding_after, .. } => padding_after,
        _ => panic!(),
    };
    assert_eq!(after(layer([1, 3, 4]).unwrap()), (0, 1));
    assert_eq!(after(layer([1, 3, 3]).unwrap()), (0, 0));
    let beyond = layer([1, 3, 5]).unwrap_err();
    assert!(beyond.code == "model.window" && beyond.help.unwrap().contains("padding_after"));
}

/// A netx file of dense layers, each with two units and one of these neurons.
fn dense_layers(neurons: &[Group]) -> Group {
    let layers = neurons.iter().enumerate().fold(Group::default(), |layers, (number, neuron)| {
        let matrix = || Numbers::i64(&[2, 2], &[2, 4, -6, 8]);
        let layer = typed("dense").with("shape", ints(&[2])).with("neuron", neuron.clone());
        let layer = match neuron.text("type").unwrap().contains("RF_") {
            true => layer.with("weight", Group::default().with("real", matrix()).with("imag", matrix())),
            false => layer.with("weight", matrix()),
        };
        layers.with(&number.to_string(), layer)
    });
    Group::default().with("layer", layers)
}

/// A neuron of netx with these integers.
fn of_netx(kind: &str, fields: &[(&str, i64)]) -> Group {
    fields.iter().fold(typed(kind), |neuron, (key, value)| neuron.with(key, int(*value)))
}

#[test]
fn adaptive_and_graded_neurons_of_netx_keep_what_netx_drops() {
    const ADAPTS: [(&str, i64); 4] = [("thDecay", 205), ("refDecay", 819), ("vThMant", 32), ("vThStep", 16)];
    let leaky = |refractory| {
        let own = [("iDecay", 1024), ("vDecay", 410), ("refDelay", refractory), ("gradedSpike", 0)];
        of_netx("ALIF", &[&own[..], &ADAPTS].concat())
    };
    let rotates = |kind| of_netx(kind, &[&[("sinDecay", 2287), ("cosDecay", 3148)][..], &ADAPTS].concat());
    let graded = |graded| of_netx("CUBA", &[("iDecay", 7), ("vDecay", 9), ("vThMant", 80), ("gradedSpike", graded)]);
    let layers = [leaky(1), rotates("ADRF_PHASE"), rotates("ADRF_IZHIKEVICH"), graded(1)];
    let model = read(&dense_layers(&layers), &Options::default()).unwrap().model;
    let adapts = [("dtheta", 205.0), ("dr", 819.0), ("threshold", 2048.0), ("threshold_step", 1024.0)];
    let turns = [("sin_decay", 2287.0), ("cos_decay", 3148.0), ("state_exp", 6.0)];
    let expected = [
        (NeuronKind::Alif, [&[("du", 1024.0), ("dv", 410.0)][..], &adapts].concat()),
        (NeuronKind::Adrf, [&turns[..], &adapts].concat()),
        (NeuronKind::AdrfIz, [&turns[..], &adapts].concat()),
        (NeuronKind::GradedLif, vec![("du", 7.0), ("dv", 9.0), ("vth_mant", 80.0)]),
    ];
    for (number, (kind, parameters)) in expected.iter().enumerate() {
        let population = model.population(&format!("layer{number}")).unwrap();
        assert_eq!(population.kind, *kind);
        for (name, value) in parameters {
            assert_eq!(population.parameter(name), Some(&Parameter::Same(*value)), "{kind:?} {name}");
        }
    }
    let refused = |layers: &[Group], says: &str| {
        let error = read(&dense_layers(layers), &Options::default()).unwrap_err();
        assert!(error.code == "import.unsupported" && error.message.contains(says), "{error}");
    };
    refused(&[leaky(2)], "refractory period");
    refused(&[leaky(1).with("gradedSpike", int(1))], "its spikes are graded");
    refused(&[rotates("ADRF_PHASE").with("gradedSpike", int(1))], "its spikes are graded");
    refused(&[graded(1), graded(0)], "carry voltages");
    refused(&[of_netx("LIFR", &[])], "neuron type 'LIFR' is not supported");

    let changes = [of_netx("SDNN", &[("vThMant", 6)])];
    let given = Options { spike_exp: Some(3), state_exp: Some(0), ..Options::default() };
    let model = read(&dense_layers(&changes), &given).unwrap().model;
    let exponents = ["spike_exp", "state_exp"].map(|name| model.population("layer0").unwrap().parameter(name).cloned());
    assert_eq!(exponents, [3.0, 0.0].map(|value| Some(Parameter::Same(value))));
    let error = read(&dense_layers(&[graded(0)]), &given).unwrap_err();
    assert!(error.code == "import.option" && error.message.contains("--spike-exp"), "{error}");
}

/// A model imported from netx is exported to it: with nsim's text, and by its layers alone.
fn goes_back_to_netx(model: &NetworkFile, options: &Options) {
    let (tree, notes) = netx_export::export(model).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    // The text of a model has the parameters of a population in the order of their table.
    let in_order = |mut model: NetworkFile| {
        model
            .populations
            .iter_mut()
            .filter_map(|one| one.loihi.as_mut())
            .for_each(|given| given.sort_by_key(|one| one.0));
        model
    };
    assert_eq!(in_order(read(&tree, &Options::default()).unwrap().model), in_order(model.clone()));
    let mut bare = tree;
    bare.items.remove("nsim").unwrap();
    let mut again = read(&bare, options).unwrap().model;
    again.provenance.clone_from(&model.provenance);
    again.name.clone_from(&model.name);
    assert_eq!(again, *model);
}

#[test]
fn models_go_to_netx_and_back_or_are_refused_by_name() {
    let sdnn = |threshold| of_netx("SDNN", &[("vThMant", threshold)]);
    let turns = [("sinDecay", 2287), ("cosDecay", 3148), ("vThMant", 32)];
    let cuba = [("iDecay", 7), ("vDecay", 9), ("vThMant", 80), ("refDelay", 3)];
    let adapts = [("thDecay", 205), ("refDecay", 819), ("vThMant", 32), ("vThStep", 16)];
    let alif = of_netx("ALIF", &[&[("iDecay", 5), ("vDecay", 6)][..], &adapts].concat());
    let adrf = of_netx("ADRF_PHASE", &[&turns[..2], &adapts].concat());
    let graded = of_netx("CUBA", &[("iDecay", 7), ("vDecay", 9), ("vThMant", 80), ("gradedSpike", 1)]);
    let options = Options::default();
    for layers in [
        vec![sdnn(6), sdnn(7), sdnn(0).with("sigma_output", int(1))],
        vec![of_netx("RF_PHASE", &turns), of_netx("RF_IZHIKEVICH", &turns), of_netx("CUBA", &cuba), alif, adrf, graded],
    ] {
        goes_back_to_netx(&read(&dense_layers(&layers), &options).unwrap().model, &options);
    }
    if let Some(folder) = crate::common::data("loihi2/pilotnet_sdnn") {
        let model = foreign::read(&folder.join("network.net"), &options).unwrap().model;
        goes_back_to_netx(&model, &options);
    }
    let given = Options { spike_exp: Some(3), ..Options::default() };
    let model = read(&dense_layers(&[sdnn(6)]), &given).unwrap().model;
    let (tree, notes) = netx_export::export(&model).unwrap();
    assert!(notes[0].contains("spike_exp"), "{notes:?}");
    assert_eq!(read(&tree, &Options::default()).unwrap().model, model);
    let refused = |change: &dyn Fn(&mut NetworkFile), says: &str| {
        let mut model = model.clone();
        change(&mut model);
        let error = netx_export::export(&model).unwrap_err();
        assert!(error.code == "export.unsupported" && error.message.contains(says), "{error}");
    };
    refused(&|model| model.populations[1].kind = NeuronKind::InvSqrt, "InvSqrt neurons");
    refused(&|model| model.projections[0].weight_exp = Some(-2), "not whole");
    refused(&|model| model.projections[0].delay = 1, "after a delay");
    refused(&|model| model.projections.push(ProjectionDesc::new("layer0", "input", noisy())), "does not connect");
    refused(&|model| model.projections[0].kind = noisy(), "Random");
}

#[test]
fn what_netx_ignores_or_clips_is_read_with_a_warning() {
    let loihi = |fields: &[(&str, i64)]| {
        of_netx("LOIHI", &[&[("iDecay", 1024), ("vDecay", 128), ("vThMant", 80)][..], fields].concat())
    };
    let silent = read(&dense_layers(&[loihi(&[("vThMant", 262_143)])]), &Options::default()).unwrap();
    let greatest = Some(&Parameter::Same(131_071.0));
    assert_eq!(silent.model.population("layer0").unwrap().parameter("vth_mant"), greatest);
    assert_eq!(silent.warnings[0].code.name(), "threshold-clipped");
    let file = |change: &dyn Fn(Group) -> Group| {
        let matrix = || Numbers::i64(&[2, 2], &[2, 4, -6, 8]);
        let dense = || typed("dense").with("shape", ints(&[2])).with("weight", matrix()).with("neuron", loihi(&[]));
        let layers = Group::default().with("0", change(dense())).with("1", dense());
        Group::default().with("layer", layers)
    };
    // A change of the first layer, another that makes an equal model, and its warning.
    type Change = Box<dyn Fn(Group) -> Group>;
    let with = |key: &'static str, item: Item| -> Change { Box::new(move |layer| layer.with(key, item.clone())) };
    let neuron = |fields: &'static [(&str, i64)]| with("neuron", loihi(fields).into());
    let recurrent = |kind: &'static str, key: &'static str| -> Change {
        Box::new(move |layer| layer.with("type", kind).with(key, Numbers::i64(&[2, 2], &[2, 0, 4, 6])))
    };
    let delays = |list: &[f64]| with("delay", reals(list).into());
    let plain = || neuron(&[]);
    for (change, equal, code) in [
        (recurrent("recurrent", "recWeight"), recurrent("dense_rec", "weight_rec"), ""),
        (recurrent("recurrent", "weight_rec"), recurrent("dense_rec", "recWeight"), ""),
        (neuron(&[("theta", 5120)]), plain(), ""),
        (neuron(&[("theta", 1600)]), plain(), "theta-ignored"),
        (with("inFeatures", int(9).into()), plain(), "size-ignored"),
        (delays(&[62.0, 3.0]), delays(&[62.0, 3.0]), ""),
        (delays(&[63.0, 3.0]), delays(&[62.0, 3.0]), "delay-clipped"),
        (delays(&[1e9, 700.0]), delays(&[62.0]), "delay-clipped"),
        (delays(&[2.5, 3.0]), delays(&[2.0, 3.0]), "fraction-lost"),
        (delays(&[70.0, 1.0, 2.0, 3.0]), delays(&[62.0, 1.0, 2.0, 3.0]), "delay-clipped"),
    ] {
        let [read, equal] = [change, equal].map(|change| read(&file(&change), &Options::default()).unwrap());
        let unsaid = |mut model: NetworkFile| {
            model.provenance = None;
            model
        };
        assert_eq!(unsaid(read.model), unsaid(equal.model), "{code}");
        let codes: Vec<&str> = read.warnings.iter().map(|warning| warning.code.name()).collect();
        assert_eq!(codes.join(" "), code, "{:?}", read.warnings);
        assert!(equal.warnings.is_empty());
    }
    let twice = |layer: Group| recurrent("recurrent", "recWeight")(recurrent("recurrent", "weight_rec")(layer));
    for (change, says) in [
        (&twice as &dyn Fn(Group) -> Group, "both recurrent weights"),
        (&recurrent("dense", "recWeight"), "field 'recWeight'"),
        (&|layer| layer.with("type", "recurrent"), "no array 'weight_rec'"),
        (&|layer| layer.with("type", "recurrent").with("recWeight", ints(&[2, 4])), "connect the 2 units"),
        (&with("delay", reals(&[-1.0]).into()), "a delay of -1 steps"),
    ] {
        let error = read(&file(change), &Options::default()).unwrap_err();
        assert!(error.code.starts_with("import.") && error.message.contains(says), "{error}");
    }
}

/// A model of an input and `count` layers in a chain, or with projections between all of them.
fn layered(count: usize, all: bool) -> NetworkFile {
    let layers = (0..count).map(|i| format!("Loihi(name: \"n{i}\", shape: [1], du: 7, dv: 9, vth_mant: 80)"));
    let names: Vec<String> = (0..count).map(|i| format!("\"n{i}\"")).collect();
    let dense = |from: &[String], to: &str| {
        format!("Dense(from: [{}], to: {to}, weights: [[{}]])", from.join(", "), vec!["2"; from.len()].join(", "))
    };
    let mut projections = vec![dense(&["\"in\"".to_string()], &names[0])];
    match all {
        true => projections.extend(names.iter().map(|to| dense(&names, to))),
        false => projections.extend(names.windows(2).map(|pair| dense(&pair[..1], &pair[1]))),
    }
    let text = format!(
        "Network(name: \"deep\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [1]), {}], projections: \
         [{}], output: \"n{}\")",
        layers.collect::<Vec<_>>().join(", "),
        projections.join(", "),
        count - 1
    );
    let model = NetworkFile::parse(&SourceText::new("deep.ron", text)).unwrap();
    model.build(Path::new("deep.ron")).unwrap().resolved().unwrap()
}

#[test]
fn an_export_that_nsim_would_not_read_back_is_refused() {
    let exported = |name: &str, model: &NetworkFile| {
        let (tree, _) = if name == "m.nir" { nir_export::export(model)? } else { netx_export::export(model)? };
        foreign::exported(Path::new(name), tree, model)
    };
    for name in ["m.nir", "m.net"] {
        // Each layer has about 15 groups and arrays, of which a file may have 65,536.
        assert!(exported(name, &layered(500, false)).is_ok(), "{name}");
        let error = exported(name, &layered(5000, false)).unwrap_err();
        assert!(error.code == "export.unsupported" && error.message.contains("65536 items"), "{name}: {error}");
    }
    // Names of edges are texts of one array.
    let error = exported("m.nir", &layered(130, true)).unwrap_err();
    assert!(error.code == "export.unsupported" && error.message.contains("65536 texts"), "{error}");
    let mut model = layered(2, false);
    let (tree, _) = nir_export::export(&model).unwrap();
    model.name = "other".to_string();
    let error = foreign::exported(Path::new("m.nir"), tree, &model).unwrap_err();
    assert!(error.message.contains("another model"), "{error}");
}

fn noisy() -> ProjectionKind {
    ProjectionKind::Random { fan_out: 1, low: 2, high: 4, seed: 1 }
}

#[test]
fn a_bias_reaches_a_current_from_the_first_step_on_and_layers_wait_for_it() {
    let (w, b) = (noise(3 * 4, 51), [0.25, 0.5, -0.125]);
    let affine = typed("Affine").with("weight", Numbers::f64(&[3, 4], &w)).with("bias", reals(&b));
    let second = typed("Linear").with("weight", weights(&[2, 3], 52));
    let more = typed("Linear").with("weight", weights(&[2, 4], 53));
    // The second layer receives the input, too.
    let nodes =
        [("i", source(&[4])), ("w", affine), ("n", cuba(&[3])), ("x", second), ("m", lif(&[2])), ("o", output())];
    let model = import(&file_with(&nodes, &[("s", more)], &[("i", "s"), ("s", "m")]));
    let (mut current, mut v) = ([0.0; 3], [0.0; 3]);
    let right: Vec<Vec<bool>> = (0..STEPS)
        .map(|t| {
            (0..3)
                .map(|i| {
                    let arrives: f64 = (0..4).filter(|&s| input(t, s)).map(|s| w[i * 4 + s]).sum();
                    current[i] = 0.75 * current[i] + arrives + b[i];
                    v[i] = 0.875 * v[i] + current[i];
                    let spike = v[i] > 1.0;
                    v[i] = if spike { 0.0 } else { v[i] };
                    spike
                })
                .collect()
        })
        .collect();
    assert!(total(&right) > 20);
    assert_eq!((model.population("n").unwrap().start_step, model.drain), (1, 2));
    assert_eq!(spikes(&model, "n", 4)[1..], right[..STEPS - 1]);
    // The import adds the delays, so a file that another tool rewrites does not have them twice.
    assert_eq!(bare(&model).projections.iter().map(|p| p.delay).max(), model.projections.iter().map(|p| p.delay).max());
    assert_eq!(spikes(&bare(&model), "m", 4), spikes(&model, "m", 4));
}

#[test]
fn a_bias_that_two_ways_pass_counts_once() {
    let (w, b) = (weights(&[2, 3], 55), [0.25, 0.5]);
    let affine = || typed("Affine").with("weight", w.clone()).with("bias", reals(&b));
    for neurons in [lif, cuba] {
        let nodes = [
            ("i", source(&[3])),
            ("w", linear(3, 3, 54)),
            ("n", neurons(&[3])),
            ("x", affine()),
            ("m", neurons(&[2])),
            ("o", output()),
        ];
        // The input reaches the weights of the second layer as well: by one shared node, by one
        // without a bias, by another with it.
        let shared = import(&file_with(&nodes, &[], &[("i", "x")]));
        let second = |node: Group| import(&file_with(&nodes, &[("y", node)], &[("i", "y"), ("y", "m")]));
        let right = spikes(&second(typed("Linear").with("weight", w.clone())), "m", 3);
        assert!(total(&right) > 10);
        assert_eq!(spikes(&shared, "m", 3), right);
        assert_ne!(spikes(&second(affine()), "m", 3), right);
    }
}

#[test]
fn a_graphs_input_gives_units_the_axes_of_its_shape() {
    let conv = || typed("Conv2d").with("weight", weights(&[3, 2, 2, 2], 56)).with("bias", reals(&[0.25, 0.0, 0.125]));
    let ending = |arrives: &[i64]| {
        let passed = typed("Pass").with("shape", ints(&[2, 4, 4]));
        file(&[("i", source(arrives)), ("p", passed), ("c", conv()), ("n", lif(&[3, 3, 3])), ("o", output())])
    };
    let nodes = [("i", source(&[2, 4, 4])), ("c", conv()), ("n", lif(&[3, 3, 3])), ("o", output())];
    let right = spikes(&import(&file(&nodes)), "n", 32);
    assert!(total(&right) > 50);
    for arrives in [&[32][..], &[4, 4, 2], &[2, 4, 4], &[8, 4]] {
        assert_eq!(spikes(&import(&ending(arrives)), "n", 32), right, "{arrives:?}");
    }
}

#[test]
fn a_sum_of_layers_at_the_output_is_shown_whole() {
    let nodes = [("i", source(&[3])), ("w", linear(2, 3, 57)), ("n", lif(&[2])), ("o", output())];
    let others = [("x", linear(2, 3, 58)), ("m", lif(&[2]))];
    let model = import(&file_with(&nodes, &others, &[("i", "x"), ("x", "m"), ("m", "o")]));
    let from: Vec<&str> = model
        .projections
        .iter()
        .filter(|p| p.to == model.output)
        .flat_map(|p| p.from.iter().map(String::as_str))
        .collect();
    assert_eq!(from, ["m", "n"]);
}

#[test]
fn delays_that_are_no_whole_steps_are_rounded_with_a_note() {
    let notes = |delays: &[f64]| {
        let delay = typed("Delay").with("delay", reals(delays));
        let nodes = [("i", source(&[2])), ("w", linear(2, 2, 5)), ("d", delay), ("n", lif(&[2])), ("o", output())];
        let imported = read(&file(&nodes), &step()).unwrap();
        imported.notes.iter().filter(|note| note.contains("not whole numbers of steps")).cloned().collect::<Vec<_>>()
    };
    assert!(notes(&[0.003, 0.0]).is_empty());
    let [note] = &notes(&[0.003, 0.0024])[..] else { panic!() };
    assert!(note.contains("1 of its 2 delays") && note.contains("from 2.400 to 2"), "{note}");
}

#[test]
fn options_are_used_or_refused() {
    let nodes = [("i", source(&[4])), ("w", linear(3, 4, 61)), ("n", lif(&[3])), ("o", output())];
    let root = file(&nodes);
    for (options, name) in [
        (Options { neuron: Some("n.yml".into()), ..step() }, "--neuron"),
        (Options { image: Some("i.npy".into()), ..step() }, "--image"),
        (Options { first_step: Some(1), ..step() }, "--first-step"),
        (Options { reset_interval: Some(9), ..step() }, "--reset-interval"),
        (Options { input_shape: Some(vec![1, 2, 2]), ..step() }, "--input-shape"),
        (Options { spike_exp: Some(6), ..step() }, "--spike-exp"),
        (Options { state_exp: Some(6), ..step() }, "--state-exp"),
    ] {
        let error = read(&root, &options).unwrap_err();
        assert!(error.code == "import.option" && error.message.contains(name), "{error}");
    }
    let inclusive = read(&root, &Options { threshold: Some(ThresholdTest::Inclusive), ..step() }).unwrap().model;
    assert_eq!(inclusive.threshold, ThresholdTest::Inclusive);
    // A time constant below a step is valid where states decay exponentially.
    let exponential = Options { decay: Some(DecayRule::Exponential), ..given("", 16.0, None) };
    assert!(read(&root, &Options { decay: Some(DecayRule::Euler), ..exponential.clone() }).is_err());
    let model = read(&root, &exponential).unwrap().model;
    let Some(Parameter::Same(tau)) = model.population("n").unwrap().parameter("tau_v_ms").cloned() else { panic!() };
    assert!((tau - 8.0).abs() < 1e-9, "{tau}");
}

#[test]
fn a_threshold_of_zero_is_a_mantissa_of_zero() {
    let root = |thresholds: &[f64]| {
        let neuron = lif(&[3]).with("v_threshold", reals(thresholds));
        let weights = typed("Linear").with("weight", Numbers::f64(&[3, 2], &[2.0, -4.0, 6.0, 8.0, -10.0, 12.0]));
        file(&[("i", source(&[2])), ("w", weights), ("n", neuron), ("o", output())])
    };
    let model = import(&root(&[0.0; 3]));
    assert_eq!(model.population("n").unwrap().parameter("vth_mant"), Some(&Parameter::Same(0.0)));
    assert!(total(&spikes(&model, "n", 2)) > 20);
    let again = bare(&model);
    assert_eq!(spikes(&again, "n", 2), spikes(&model, "n", 2));
    assert_eq!(again.projections[0].weight_scale.unwrap_or(1.0), 1.0, "mantissas stay as they are");
    let mixed = read(&root(&[0.0, 1.0, 1.0]), &step()).unwrap_err();
    assert!(mixed.message.contains("both a threshold of 0 and others"), "{mixed}");
}
