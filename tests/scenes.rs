//! Scenes are functions of their parameters, seed and sample number: the same spikes at any number of threads, and the
//! same as ever.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use nsim::compile;
use nsim::desc::stimulus::SceneArg;
use nsim::drive::{Outcome, digest};
use nsim::io::model::load_model;
use nsim::ir::quantised::Quantised;
use nsim::scene;

/// The digest of all input spikes, (sample, step, channel), of a scene made by so many threads.
fn made(network: &Quantised, argument: &str, threads: usize) -> String {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let argument = SceneArg::parse(argument).unwrap();
    let stimulus = pool.install(|| scene::stimulus(network, &argument)).unwrap();
    let spikes = |sample: &nsim::ir::spikes::Sample| {
        let at = |step| sample.at(step).iter().map(move |channel| (step, channel.0));
        Outcome { spikes: (0..sample.steps()).flat_map(at).collect(), ..Outcome::default() }
    };
    digest(&stimulus.samples.iter().map(spikes).collect::<Vec<_>>())
}

#[test]
fn scenes_are_the_same_at_any_number_of_threads_and_as_recorded() {
    let network = compile::front(&load_model("vtsnn-slip").unwrap()).unwrap().into_quantised();
    // Recorded with version 0.1.0; a change of a scene's physics or draws changes them, and every accuracy in the
    // documents with them.
    let recorded = [
        ("slip?samples=5&seed=11", "2eb2dd759862e524fb2a9d7d694fab5e1759a16fbadcc86ead093689115e0e42"),
        ("container?samples=5&seed=11", "b1cf2bff7ef16d39395f54f5534a25490703b34a74d56d78bd32bd581fe35611"),
    ];
    for (argument, wanted) in recorded {
        for threads in [1, 2, 8] {
            assert_eq!(made(&network, argument, threads), wanted, "{argument} at {threads} threads");
        }
    }
    let other = made(&network, "slip?samples=5&seed=12", 2);
    assert!(other != recorded[0].1);
}
