//! Each kind of pruning on a network made for it, and the numbers of a pruned network for users.

use crate::{CompileError, Options, compile, load};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{ChannelId, PopulationId};
use nsim_ir::pruned::Kind;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_quantise::prune::*;
use nsim_testing::{Builder, format, limits, sparse, target};

/// Counts in the order of `Kind::ALL`.
fn counts(network: &Quantised) -> [u64; 5] {
    Kind::ALL.map(|kind| network.pruned().unwrap().count(kind))
}

/// Four channels to four compartments, one each, and these to one output.
fn fan(weights: [i16; 4]) -> Builder {
    let mut builder = Builder::new();
    let (input, hidden, out) = (builder.input("in", 4), builder.loihi("hidden", 4), builder.loihi("out", 1));
    let weights = sparse((0..4).zip(weights).map(|synapse| vec![synapse]));
    builder.connect(input, hidden, format(0, SignMode::Mixed, 8), 0, weights);
    builder.dense(hidden, out, |_, _| 100);
    builder
}

fn scene(dead: &[u32]) -> Plan {
    let dead = dead.iter().map(|&channel| ChannelId(channel)).collect();
    Plan { scene: Some(Scene { stimulus: vec!["quiet.npy".to_string()], dead }), probed: Vec::new() }
}

#[test]
fn a_pruned_population_is_counted_as_the_model_counts_it() {
    let pruned = prune(&fan([100, 0, 100, 0]).build(), &Plan::fixed()).unwrap();
    let hidden = PopulationId(1);
    assert_eq!(pruned.kept_units(hidden), Some(&[0, 2][..]));
    assert_eq!((pruned.index_before_pruning(hidden, 1), pruned.index_after_pruning(hidden, 2)), (2, Some(1)));
    assert_eq!((pruned.index_after_pruning(hidden, 3), pruned.units_before_pruning(hidden)), (None, 4));
}

#[test]
fn dead_channels_lose_their_synapses_and_silence_what_they_alone_drove() {
    let whole = fan([100; 4]).build();
    let pruned = prune(&whole, &scene(&[1, 3])).unwrap();
    assert_eq!(counts(&pruned), [2, 0, 2, 0, 4]);
    let at = |step, channel| Sample::new(9, &[(step, ChannelId(channel))], None).unwrap();
    assert!(check_stimulus(&pruned, &[&at(0, 0), &at(8, 2)], 0).is_ok());
    let refused = check_stimulus(&pruned, &[&at(0, 0), &at(8, 3)], 5).unwrap_err();
    assert_eq!(refused.code, "input.pruned");
    for word in ["sample 6", "channel 3 of 'in'", "step 8", "quiet.npy"] {
        assert!(refused.message.contains(word), "{refused}");
    }
    assert!(check_stimulus(&whole, &[&at(8, 3)], 0).is_ok());
    assert!(prune(&whole, &scene(&[4])).is_err() && prune(&pruned, &Plan::fixed()).is_err());
}

#[test]
fn a_saved_mapping_prunes_the_same_and_counts_as_the_model_does() {
    let whole = fan([100, 0, 100, 100]).build();
    let board = target(1, 1, limits());
    let options = Options { copies: 2, ..Options::default() };
    let pruned = prune(&whole, &scene(&[2])).unwrap();
    let compiled = compile(pruned, &board, &options).unwrap();
    let file = compiled.mapping_file();
    let said = file.pruned.as_ref().unwrap();
    assert_eq!((said.dead.len(), said.dead[0].first, said.dead[0].count), (1, 2, 1));
    let runs: Vec<_> = file.cores.iter().flat_map(|on| &on.holds).filter(|run| run.population == "hidden").collect();
    assert_eq!(runs.iter().map(|run| (run.first, run.count)).collect::<Vec<_>>(), [(0, 1), (3, 1)]);
    let again = load(whole.clone(), &board, &options, &file).unwrap();
    assert_eq!(again.program, compiled.program);
    assert_eq!(again.one.pruned().unwrap().dead, [ChannelId(2)]);
    assert_eq!(again.mapping_file(), file);

    let refused = |change: &dyn Fn(&mut nsim_ir::mapping::MappingFile)| {
        let mut file = file.clone();
        change(&mut file);
        match load(whole.clone(), &board, &options, &file) {
            Err(CompileError::Input(diagnostic)) => diagnostic,
            other => panic!("{other:?}"),
        }
    };
    let dead = |file: &mut nsim_ir::mapping::MappingFile, first, count| {
        let run = &mut file.pruned.as_mut().unwrap().dead[0];
        (run.first, run.count) = (first, count);
    };
    assert_eq!(refused(&|file| dead(file, 2, u32::MAX)).code, "mapping.pruned");
    assert_eq!(refused(&|file| dead(file, 3, 1)).code, "mapping.pruned", "compartment 3 is mapped but would be pruned");
    assert_eq!(refused(&|file| file.pruned.as_mut().unwrap().dead[0].population = "out".into()).code, "mapping.pruned");
    assert_eq!(refused(&|file| file.pruned.as_mut().unwrap().probed.push("in".into())).code, "mapping.pruned");
    assert_eq!(refused(&|file| file.pruned.as_mut().unwrap().stimulus = None).code, "mapping.pruned");
    assert_eq!(refused(&|file| file.pruned = None).code, "mapping.missing");
    let whole_file = compile(whole.clone(), &board, &options).unwrap().mapping_file();
    let pruned = prune(&whole, &Plan::fixed()).unwrap();
    assert!(load(pruned, &board, &options, &whole_file).is_err());
}
