//! Time saved by each kind of skipping alone, on whole samples: at run time (`--skip`), at map time
//! (`--prune`), at decision time (`--early-exit`).
//!
//! Scenes: recorded tactile samples (in `NSIM_DATA` or `../shared/data`) on the shipped tactile
//! network, slip scenes and silence on the shipped slip network. Each row runs all samples
//! repeatedly on one thread. Rows alternate, so that other load of the machine affects all equally.
//! Prints a table of times and counts.

// A bench that cannot continue has failed.
#![allow(clippy::unwrap_used)]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use nsim::compile::{Options, compile};
use nsim::ir::base::id::ChannelId;
use nsim::ir::program::Program;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::{Sample, Stimulus};
use nsim::ir::stimulus::SceneArg;
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::prune::{Plan, prune};
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::front::front;
use nsim::session::{SampleSettings, Session, digest};

/// Rounds in which every row is timed once.
const ROUNDS: usize = 25;

/// A network and its samples.
struct Scene {
    name: &'static str,
    network: Quantised,
    samples: Vec<Sample>,
}

fn model(name: &str) -> Quantised {
    front(&nsim::import::model::load_model(name).unwrap()).unwrap().into_quantised()
}

fn tactile() -> Option<Scene> {
    let root = std::env::var_os("NSIM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let folder = root.join("ev-containers/test");
    if !folder.is_dir() {
        println!("skipped: no data at {}", folder.display());
        return None;
    }
    let network = model("container-tactile");
    let sample = |spikes: nsim::import::spikes::PopulationSpikes| {
        let events: Vec<_> = spikes.events.iter().map(|&(step, channel)| (step, ChannelId(channel))).collect();
        Sample::new(spikes.steps, &events, spikes.label).unwrap()
    };
    let read = nsim::import::spikes::read_source(&folder, u64::from(network.channels())).unwrap();
    Some(Scene { name: "tactile", network, samples: read.into_iter().map(sample).collect() })
}

fn slip() -> Scene {
    let network = model("vtsnn-slip");
    let scene = SceneArg::parse("slip?samples=20&seed=3").unwrap();
    let samples = nsim::scene::stimulus(&network, &scene).unwrap().samples;
    Scene { name: "slip", network, samples }
}

fn silence() -> Scene {
    let sample = Sample::new(150, &[], None).unwrap();
    Scene { name: "silence", network: model("vtsnn-slip"), samples: vec![sample; 20] }
}

/// Settings of a run of a scene.
struct Row {
    kind: &'static str,
    setting: String,
    network: Quantised,
    program: Arc<Program>,
    skip: bool,
    rule: Option<Rule>,
}

fn rows(scene: &Scene) -> Vec<Row> {
    let target = nsim::files::target::load_target("nahuku-32").unwrap();
    let row = |kind, setting: &str, network: &Quantised, skip, rule| {
        let program = compile(network.clone(), &target, &Options::default()).unwrap().program;
        Row { kind, setting: setting.to_string(), network: network.clone(), program, skip, rule }
    };
    let whole = &scene.network;
    let stimulus =
        Stimulus { samples: scene.samples.clone(), origin: vec![scene.name.to_string()], ..Stimulus::default() };
    let fixed = prune(whole, &Plan::fixed()).unwrap();
    let shown = prune(whole, &Plan::for_stimulus(whole, &stimulus)).unwrap();
    let margin = Rule::Margin(8.try_into().unwrap());
    // Each row skips by its own kind alone.
    vec![
        row("none", "", whole, false, None),
        row("run time", "--skip on", whole, true, None),
        row("map time", "--prune static", &fixed, false, None),
        row("map time", "--prune INPUT", &shown, false, None),
        row("decision time", "--early-exit certain", whole, false, Some(Rule::Certain)),
        row("decision time", "--early-exit 8", whole, false, Some(margin)),
        row("all", "--skip on --prune INPUT --early-exit certain", &shown, true, Some(Rule::Certain)),
    ]
}

/// Results of a row: digest, timesteps run, compartments visited, synaptic events.
type Did = (String, u64, u64, u64);

fn measure(scene: &Scene) {
    let rows = rows(scene);
    let images: Vec<Arc<Image>> = rows.iter().map(|row| Image::new(&row.program, 1).unwrap()).collect();
    let mut sessions: Vec<Session> = (rows.iter().zip(&images))
        .map(|(row, image)| Session::new(Machine::new(image, Settings { skip: row.skip, per_step: false }), 1))
        .collect();
    let keeps: Vec<SampleSettings> = rows
        .iter()
        .map(|row| {
            let early_exit = row.rule.map(|rule| EarlyExit::new(rule, &row.network).expect("an output that decides"));
            SampleSettings { early_exit, ..SampleSettings::new(row.program.output()) }
        })
        .collect();
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); rows.len()];
    let mut did: Vec<Did> = Vec::new();
    for (session, keep) in sessions.iter_mut().zip(&keeps) {
        let (mut outcomes, mut visited) = (Vec::new(), 0);
        for sample in &scene.samples {
            let outcome = session.run(sample, keep, ());
            visited += outcome.totals.compartment_updates - session.engine().skipped_updates();
            outcomes.push(outcome);
        }
        let sum = |of: fn(&nsim::session::Outcome) -> u64| outcomes.iter().map(of).sum::<u64>();
        let steps = sum(|outcome| outcome.steps.into());
        did.push((digest(&outcomes), steps, visited, sum(|outcome| outcome.totals.synaptic_events)));
    }
    // Times of a few microseconds are measured over several repeats.
    let repeats = (20_000 / (did[0].1 as usize).max(1)).max(1);
    for _ in 0..ROUNDS {
        for ((session, keep), times) in sessions.iter_mut().zip(&keeps).zip(&mut times) {
            let begin = Instant::now();
            for sample in std::iter::repeat_n(&scene.samples, repeats).flatten() {
                black_box(session.run(sample, keep, ()));
            }
            times.push(begin.elapsed().as_secs_f64() * 1e6 / repeats as f64);
        }
    }
    let median = |times: &Vec<f64>| {
        let mut times = times.clone();
        times.sort_unstable_by(f64::total_cmp);
        times[times.len() / 2]
    };
    let whole = median(&times[0]);
    for ((row, times), (digest, steps, visited, events)) in rows.iter().zip(&times).zip(&did) {
        // Only an early exit may change the outputs of a sample.
        assert!(row.rule.is_some() || *digest == did[0].0, "{} {}: other outputs", scene.name, row.setting);
        let us = median(times);
        println!(
            "| {}, {} samples | {} | `{}` | {us:.1} | {:.2} | {steps} | {visited} | {events} |",
            scene.name,
            scene.samples.len(),
            row.kind,
            row.setting,
            whole / us,
        );
    }
}

fn main() {
    println!(
        "| scene | kind | setting | us, all samples | gain | timesteps | compartments visited | synaptic events |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for scene in tactile().into_iter().chain([slip(), silence()]) {
        measure(&scene);
    }
}
