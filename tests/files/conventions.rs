//! Conventions that files do not state: a row a tool, the timestep, potentials that are sent,
//! edges.

use crate::nir_nodes::{cuba, file, file_with, given, lif, noise, output, read, source};
use crate::real::{spikes, total};
use crate::tree::{node, reals, typed};
use nsim::files::network::NetworkFile;
use nsim::import::foreign::conventions::TABLE;
use nsim::import::foreign::{ResetMode, Tool};
use nsim::import::hdf5::{Group, Numbers};
use nsim::ir::arithmetic::ThresholdTest;
use nsim::ir::neurons::NeuronKind;

fn matrix(targets: usize, sources: usize, seed: u64) -> Group {
    typed("Linear").with("weight", Numbers::f64(&[targets, sources], &noise(targets * sources, seed)))
}

/// Three neurons after weights from four channels.
fn net(neuron: Group) -> Group {
    file(&[("i", source(&[4])), ("w", matrix(3, 4, 71)), ("n", neuron), ("o", output())])
}

/// Parameters of the population `n`, and the timestep in ms.
fn leaks(root: &Group, tool: &str) -> (f64, f64, Vec<f64>) {
    let model = read(root, &given(tool, 0.0, None)).unwrap().model;
    let decay = |key: &str, tau: &str| {
        let population = model.population("n").unwrap();
        let of = |key: &str| population.parameter(key).map(|value| value.get(0));
        of(key).unwrap_or_else(|| 4096.0 * (1.0 - (-model.timestep_ms / of(tau).unwrap()).exp()))
    };
    let nsim::files::network::ProjectionKind::Dense(weights) = &model.projections[0].kind else { panic!() };
    let first = weights.tensor().reals().take(2).collect();
    (decay("du", "tau_u_ms").round(), decay("dv", "tau_v_ms").round(), first)
}

#[test]
fn the_page_has_the_table_of_conventions() {
    let page = include_str!("../../docs/import.md");
    for row in TABLE {
        let line = format!("| {} |", row.cells().join(" | "));
        assert!(page.contains(&line), "docs/import.md lacks {line}");
    }
    for (tool, row) in Tool::ALL.into_iter().zip(TABLE) {
        assert_eq!(row.tool, tool);
    }
}

#[test]
fn a_tool_sets_timestep_decay_gain_reset_and_threshold() {
    // Each file is what the tool's exporter writes for a neuron of threshold 1 that keeps 3/4 of v.
    let lif = |tau: f64, r: f64| node("LIF", &[3], &[("tau", tau), ("r", r), ("v_leak", 0.0), ("v_threshold", 1.0)]);
    let (minus_ln, w) = (-(0.75f64).ln(), noise(2, 71));
    for (tool, tau, r, gain, reset, threshold) in [
        ("snntorch", 4e-4, 4.0, 1.0, ResetMode::SubtractLater, ThresholdTest::Strict),
        ("norse", 4e-6, 1.0, 0.25, ResetMode::Zero, ThresholdTest::Strict),
        ("sinabs", 1.0 / minus_ln, 1.0, 0.25, ResetMode::Subtract, ThresholdTest::Inclusive),
        ("spikingjelly", 4e-4, 1.0, 0.25, ResetMode::Zero, ThresholdTest::Inclusive),
        ("rockpool", 1e-3 / minus_ln, 0.75 / minus_ln, 1.0, ResetMode::Subtract, ThresholdTest::Inclusive),
        ("spyx", 4.0, 0.75, 1.0, ResetMode::SubtractLater, ThresholdTest::Strict),
        ("lava-dl", 4e-4, 4.0, 1.0, ResetMode::Zero, ThresholdTest::Strict),
    ] {
        let root = net(lif(tau, r));
        let imported = read(&root, &given(tool, 0.0, None)).unwrap();
        assert_eq!((imported.reset, imported.model.threshold), (Some(reset), threshold), "{tool}");
        let (du, dv, weights) = leaks(&root, tool);
        assert_eq!((du, dv), (4096.0, 1024.0), "{tool}");
        let close = weights.iter().zip(&w).all(|(made, given)| (made - gain * given).abs() < 1e-9);
        assert!(close, "{tool}: {weights:?}");
        let assumed = ["reset-assumed", "threshold-assumed", "lower-bound-assumed", "gain"];
        assert!(
            imported.warnings.iter().all(|warning| !assumed.contains(&warning.code.name())),
            "{:?}",
            imported.warnings
        );
        // A single option wins.
        assert_eq!(read(&root, &given(tool, 0.0, Some(ResetMode::Zero))).unwrap().reset, Some(ResetMode::Zero));
    }
}

#[test]
fn a_timestep_takes_two_ratios_that_do_not_depend_on_each_other() {
    let integrate = |r: f64| node("IF", &[3], &[("r", r), ("v_threshold", 1.0)]);
    let two = |second: Group| {
        let nodes = [("i", source(&[4])), ("w", matrix(3, 4, 72)), ("n", lif(&[3])), ("x", matrix(3, 3, 73))];
        file(&[&nodes[..], &[("m", second), ("o", output())]].concat())
    };
    let slower = node("LIF", &[3], &[("tau", 0.016), ("r", 16.0), ("v_leak", 0.0), ("v_threshold", 1.0)]);
    let ask = |root: &Group| read(root, &given("", 0.0, None)).map(|read| read.model.timestep_ms).map_err(|e| e.code);
    assert_eq!(ask(&net(lif(&[3]))), Err("import.option"));
    assert_eq!(ask(&net(integrate(1e3))), Err("import.option"));
    assert_eq!(ask(&two(lif(&[3]))), Err("import.option"));
    assert_eq!(ask(&two(integrate(2e3))), Err("import.option"));
    for root in [net(cuba(&[3])), two(slower), two(integrate(1e3))] {
        assert_eq!(ask(&root), Ok(1.0));
    }
    assert_eq!(ask(&net(integrate(1.0))), Ok(1.0));
    let question = read(&net(lif(&[3])), &given("", 0.0, None)).unwrap_err();
    assert!(["--from TOOL", "--dt MS", "subtract"].iter().all(|word| question.help.as_ref().unwrap().contains(word)));
}

fn li(units: usize, tau: f64) -> Group {
    node("LI", &[units], &[("tau", tau), ("r", tau * 1e3), ("v_leak", 0.0)])
}

fn step(root: &Group) -> NetworkFile {
    read(root, &given("", 1.0, None)).unwrap().model
}

#[test]
fn a_potential_that_is_sent_becomes_a_current() {
    let nodes = |second: Group| {
        [("i", source(&[4])), ("a", matrix(5, 4, 74)), ("s", second), ("b", matrix(3, 5, 75)), ("n", lif(&[3]))]
    };
    let root = file(&[&nodes(li(5, 0.004))[..], &[("o", output())]].concat());
    let without = |last: Group| {
        let chain = [("i", source(&[4])), ("a", matrix(5, 4, 74)), ("b", matrix(3, 5, 75)), ("n", last)];
        spikes(&step(&file(&[&chain[..], &[("o", output())]].concat())), "n", 4)
    };
    let right = without(cuba(&[3]));
    assert!(total(&right) > 20);
    assert_eq!(spikes(&step(&root), "n", 4), right);
    // A threshold on the potential is a neuron without a reset.
    let threshold = node("Threshold", &[3], &[("threshold", 1.5)]);
    let chain = [("i", source(&[4])), ("w", matrix(3, 4, 71)), ("s", li(3, 0.008)), ("n", threshold), ("o", output())];
    let model = step(&file(&chain));
    let weights = noise(12, 71);
    let mut v = [0.0; 3];
    let right: Vec<Vec<bool>> = (0..crate::real::STEPS)
        .map(|t| {
            let current =
                |i: usize| -> f64 { (0..4).filter(|&s| crate::real::input(t, s)).map(|s| weights[i * 4 + s]).sum() };
            (0..3).for_each(|i| v[i] = 0.875 * v[i] + current(i));
            v.iter().map(|v| *v > 1.5).collect()
        })
        .collect();
    assert!(total(&right) > 20);
    assert_eq!(spikes(&model, "n", 4), right);
    assert_eq!(model.population("n").unwrap().kind, NeuronKind::SoftReset);
    // Refused: other time constants in a sum, a second filter, a potential that is also the output,
    // other inputs.
    let varied = li(5, 0.004).with("tau", reals(&[0.004, 0.004, 0.004, 0.004, 0.008]));
    let of_current = [&nodes(li(5, 0.004))[..4], &[("n", cuba(&[3])), ("o", output())]].concat();
    let whole = |second: Group| [&nodes(second)[..], &[("o", output())]].concat();
    let read_too = file_with(&whole(li(5, 0.004)), &[], &[("s", "o")]);
    let mixed = file_with(&whole(li(5, 0.004)), &[("d", matrix(3, 4, 76))], &[("i", "d"), ("d", "n")]);
    for root in [file(&whole(varied)), file(&of_current), read_too, mixed] {
        let error = read(&root, &given("", 1.0, None)).unwrap_err();
        assert_eq!(error.code, "import.unsupported");
        assert!(error.message.contains("potential") && error.message.contains('s'), "{error}");
    }
}

#[test]
fn a_rest_potential_is_counted_from_and_an_infinite_time_constant_never_decays() {
    let with = |fields: &[(&str, f64)]| node("LIF", &[3], fields);
    let rests = with(&[("tau", 0.008), ("r", 8.0), ("v_leak", -65.0), ("v_reset", -65.0), ("v_threshold", -64.0)]);
    let right = spikes(&step(&net(lif(&[3]))), "n", 4);
    assert!(total(&right) > 10);
    assert_eq!(spikes(&step(&net(rests.clone())), "n", 4), right);
    let other = rests.with("v_leak", reals(&[0.0; 3]));
    assert!(read(&net(other), &given("", 1.0, None)).unwrap_err().message.contains("resets to a value"));
    let (inf, threshold) = (f64::INFINITY, ("v_threshold", 2.0));
    let never = with(&[("tau", inf), ("r", inf), ("v_leak", 0.0), threshold]);
    let sums = node("IF", &[3], &[("r", 1.0), threshold]);
    assert_eq!(spikes(&step(&net(never)), "n", 4), spikes(&step(&net(sums)), "n", 4));
    let deaf = read(&net(with(&[("tau", inf), ("r", 1.0), ("v_leak", 0.0), threshold])), &given("", 1.0, None));
    assert!(deaf.unwrap_err().help.unwrap().contains("never decays"));
}

#[test]
fn what_is_assumed_is_a_warning_and_an_edge_is_never_dropped_in_silence() {
    let codes = |root: &Group| -> Vec<&str> {
        read(root, &given("", 1.0, None)).unwrap().warnings.iter().map(|warning| warning.code.name()).collect()
    };
    // Weights are multiples of 1/64, and some are negative.
    assert_eq!(codes(&net(lif(&[3]))), ["reset-assumed", "threshold-assumed", "lower-bound-assumed"]);
    let odd = node("LIF", &[3], &[("tau", 0.0081), ("r", 9.0), ("v_leak", 0.0), ("v_threshold", 1.0)]);
    assert_eq!(codes(&net(odd))[2..], ["lower-bound-assumed", "gain"]);
    let weights = typed("Linear").with("weight", Numbers::f64(&[3, 1], &[0.3f64.sqrt(), 0.5f64.sqrt(), 0.7f64.sqrt()]));
    let free = file(&[("i", source(&[1])), ("w", weights), ("n", lif(&[3])), ("o", output())]);
    assert_eq!(codes(&free), ["reset-assumed"]);
    let nodes = [("i", source(&[4])), ("w", matrix(3, 4, 71)), ("n", lif(&[3])), ("o", output())];
    let dangling = file_with(&nodes, &[("d", matrix(2, 3, 77)), ("e", matrix(3, 2, 78))], &[("n", "d"), ("e", "n")]);
    assert_eq!(codes(&dangling)[3..], ["edge-dropped", "edge-dropped"]);
    assert_eq!(codes(&file_with(&nodes, &[], &[("w", "n")]))[3..], ["edge-doubled"]);
    for (edge, does) in [(("n", "i"), "enters"), (("o", "n"), "leaves")] {
        let error = read(&file_with(&nodes, &[], &[edge]), &given("", 1.0, None)).unwrap_err();
        assert!(error.message.contains(does), "{error}");
    }
}
