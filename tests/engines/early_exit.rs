//! Ending a decided sample early. `certain` gives the class of the whole sample; every rule gives
//! its first steps; all engines agree. The report of the command line is tested too.

use std::num::NonZeroU32;
use std::path::Path;

use crate::common;
use crate::common::command::{self, said};
use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::import::model::load_model;
use nsim::ir::activity::Activity;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::Engine;
use nsim::machine::{Image, Machine, Settings};
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::front::front;
use nsim::session::observers::StepRange;
use nsim::session::{Outcome, SampleSettings, Session};
use rayon::prelude::*;
use serde_json::Value;

fn keep(network: &Quantised, rule: Option<Rule>) -> SampleSettings {
    let early_exit = rule.map(|rule| EarlyExit::new(rule, network).unwrap());
    SampleSettings { early_exit, ..SampleSettings::new(network.output()) }
}

fn margin(margin: u32) -> Rule {
    Rule::Margin(NonZeroU32::new(margin).unwrap())
}

/// The outcome without the number that skipping may change.
fn skipping_aside(outcome: &Outcome) -> Outcome {
    Outcome { skipped_steps: 0, ..outcome.clone() }
}

fn assert_begins(early: &Outcome, whole: &Outcome, what: &str) {
    let until = |outcome: &Outcome| -> Vec<(u32, u32)> {
        outcome.spikes.iter().copied().filter(|spike| spike.0 < early.steps).collect()
    };
    assert_eq!(early.spikes, until(whole), "{what}");
    assert_eq!(early.steps + early.steps_saved, whole.steps, "{what}");
    match early.decided_at {
        Some(step) => assert_eq!((early.steps, early.steps_saved > 0), (step + 1, true), "{what}"),
        None => assert_eq!(early, &skipping_aside(whole), "{what}"),
    }
}

#[test]
fn random_networks_decide_alike_on_every_engine_and_certain_keeps_the_class() {
    let decided: Vec<[u32; 2]> = (0..1000u64)
        .into_par_iter()
        .map(|seed| {
            let network = common::random::network(seed);
            let sample = common::random::sample(&network, seed);
            let mut engines = common::sessions(&network);
            let run = |session: &mut Session<dyn Engine>, rule| session.run(&sample, &keep(&network, rule), ());
            let whole = run(engines[0].1.as_mut(), None);
            [Rule::Certain, margin(1 + seed as u32 % 5)].map(|rule| {
                let what = format!("network {seed}, {rule}");
                let golden = run(engines[0].1.as_mut(), Some(rule));
                assert_begins(&golden, &whole, &what);
                if rule == Rule::Certain {
                    assert_eq!(golden.class(), whole.class(), "{what}");
                }
                for (name, engine) in &mut engines {
                    assert_eq!(skipping_aside(&run(engine.as_mut(), Some(rule))), golden, "{what}, {name}");
                }
                // A decision that is only recorded changes nothing else.
                let watched = SampleSettings {
                    early_exit: Some(EarlyExit::recording_only(rule, &network)),
                    ..keep(&network, None)
                };
                let Outcome { decided_at, decided_class, steps_saved, .. } = golden;
                let noted = Outcome { decided_at, decided_class, steps_saved, ..skipping_aside(&whole) };
                assert_eq!(noted.class_when_decided(), golden.class(), "{what}");
                for (name, engine) in &mut engines {
                    let outcome = engine.run(&sample, &watched, ());
                    assert_eq!(skipping_aside(&outcome), noted, "{what}, {name}, watched");
                }
                u32::from(golden.decided_at.is_some())
            })
        })
        .collect();
    let [certain, margin] = decided.iter().fold([0, 0], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    println!("of 1000 samples {certain} were certain and {margin} had their margin before their end");
    assert!(certain > 200 && margin > 200, "{certain} certain, {margin} by a margin: this tests too little");
}

#[test]
fn recordings_keep_their_class_and_do_what_their_first_steps_do() {
    let Some(data) = common::data("ev-containers") else { return };
    let samples = common::recordings(&data, &["train", "test"]);
    let network = load_model("container-tactile").unwrap();
    let compiled =
        compile(front(&network).unwrap(), &load_target("loihi1-chip").unwrap(), &Options::default()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    let network = &compiled.quantised;
    for rule in [Rule::Certain, margin(1), margin(5), margin(20)] {
        let outcomes: Vec<[Outcome; 2]> = samples
            .par_iter()
            .map(|sample| {
                let mut golden = Session::new(Golden::new(network), 1);
                let early = golden.run(sample, &keep(network, Some(rule)), ());
                let settings = Settings { per_step: true, ..Settings::default() };
                let mut session = Session::new(Machine::new(&image, settings), 1);
                // The whole sample, with the counts of the steps of the shortened one.
                let mut counted = Activity::new(compiled.program.cores().len());
                let mut left = early.steps;
                let whole = session.run(sample, &keep(network, None), |machine: &Machine, passed: StepRange| {
                    counted.add_steps(machine.last_step(), u64::from(passed.steps.min(left)));
                    left -= passed.steps.min(left);
                });
                assert_begins(&early, &whole, &rule.to_string());
                session.engine_mut().take_activity();
                let fast = session.run(sample, &keep(network, Some(rule)), ());
                assert_eq!(skipping_aside(&fast), early);
                assert_eq!(
                    session.engine_mut().take_activity(),
                    counted,
                    "the first steps of the whole sample, core by core"
                );
                [early, whole]
            })
            .collect();
        let same = outcomes.iter().filter(|[early, whole]| early.class() == whole.class()).count();
        let decided = outcomes.iter().filter(|[early, _]| early.decided_at.is_some()).count();
        let saved: u32 = outcomes.iter().map(|[early, _]| early.steps_saved).sum();
        println!("{rule}: {decided} of {} decided early, {saved} steps saved, {same} classes kept", samples.len());
        assert!(decided > 0);
        if rule == Rule::Certain {
            assert_eq!(same, samples.len());
        }
        // A machine that runs more samples keeps nothing of one that ended early.
        let mut session = Session::new(Machine::new(&image, Settings::default()), 1);
        for (sample, [early, _]) in samples.iter().zip(&outcomes).take(20) {
            let again = session.run(sample, &keep(network, Some(rule)), ());
            assert_eq!(&skipping_aside(&again), early);
        }
    }
}

fn nsim(arguments: &[&str]) -> (i32, String, String) {
    said(Path::new("."), arguments)
}

fn object(arguments: &[&str]) -> Value {
    command::object(Path::new("."), arguments, 0)
}

fn numbers(list: &Value) -> Vec<Option<u64>> {
    list.as_array().unwrap().iter().map(Value::as_u64).collect()
}

#[test]
fn what_makes_no_sense_is_wrong_usage() {
    for wrong in ["0", "-1", "1.5", "never", ""] {
        let (code, _, stderr) = nsim(&["run", &format!("--early-exit={wrong}")]);
        assert_eq!(code, 2, "{stderr}");
        assert!(stderr.contains("certain"), "{stderr}");
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().display().to_string();
    let (code, _, stderr) = nsim(&["run", "--early-exit", "3", "--probe", "out.spikes", "-o", &out]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--probe") && stderr.contains("--early-exit"), "{stderr}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_run_says_when_samples_were_decided() {
    let run = |more: &[&str]| object(&[&["run", "container-tactile", "--samples", "0..6"], more].concat());
    let whole = run(&[]);
    assert_eq!(whole["early_exit"], Value::Null);
    assert_eq!(numbers(&whole["decided_at"]), [None; 6]);
    for rule in ["certain", "3"] {
        let early = run(&["--early-exit", rule]);
        let decided = numbers(&early["decided_at"]);
        assert!(decided.iter().flatten().count() > 0, "{rule}: {decided:?}");
        let steps: u64 = decided.iter().map(|step| step.map_or(325, |step| step + 1)).sum();
        assert_eq!(early["timesteps"], steps);
        assert_eq!(early["early_exit"]["steps_saved"], 6 * 325 - steps);
        assert_eq!(early["early_exit"]["rule"], rule);
        assert_eq!(early["activity"]["compartment_updates"], steps * 52);
        assert!(early["activity"]["spikes"].as_u64() < whole["activity"]["spikes"].as_u64());
        if rule == "certain" {
            assert_eq!(early["predicted"], whole["predicted"]);
        }
        let text = nsim(&["run", "container-tactile", "--samples", "0..6", "--early-exit", rule]).1;
        assert!(text.contains(&format!("early exit {rule}: ")), "{text}");
    }
}

#[test]
fn the_energy_saved_is_that_of_the_steps_left_off() {
    let energy = |more: &[&str]| {
        object(&[&["energy", "container-tactile", "--samples", "0..6", "--copies", "2", "--baseline"], more].concat())
    };
    let whole = energy(&[]);
    assert_eq!(whole["early_exit"], Value::Null);
    let total = |object: &Value, key: &str| object["rows"][2][key].as_f64().unwrap();
    let mut saved_before = 0.0;
    for rule in ["certain", "3"] {
        let run = object(&["run", "container-tactile", "--samples", "0..6", "--early-exit", rule]);
        let early = energy(&["--early-exit", rule]);
        // The table remains one of whole samples.
        assert_eq!((&early["rows"], &early["timesteps"]), (&whole["rows"], &whole["timesteps"]));
        let saved = &early["early_exit"];
        assert_eq!(saved["rule"], rule);
        assert_eq!(saved["steps_saved"], run["early_exit"]["steps_saved"]);
        assert_eq!(saved["decided"], run["early_exit"]["decided"]);
        let (uj, us) = (saved["energy_saved_uj"].as_f64().unwrap(), saved["time_saved_us"].as_f64().unwrap());
        let all_uj = total(&whole, "energy_uj") * 6.0 * 325.0;
        assert!(uj > saved_before && uj < all_uj, "{rule}: {uj} of {all_uj}");
        saved_before = uj;
        assert!((saved["energy_saved_share"].as_f64().unwrap() - uj / all_uj).abs() < 1e-9);
        // The least saving is all power but the neuron cores' dynamic one, over the saved time.
        let always_mw = total(&whole, "total_mw") - whole["rows"][1]["dynamic_mw"].as_f64().unwrap();
        assert!(uj > always_mw * us / 1e3 && uj < 1.5 * always_mw * us / 1e3 + all_uj * 0.5, "{uj} uJ in {us} us");
    }
    // In real time each step lasts 20 ms, for any activity.
    let paced = &energy(&["--early-exit", "3", "--mode", "realtime"])["early_exit"];
    let (us, steps) = (paced["time_saved_us"].as_f64().unwrap(), paced["steps_saved"].as_f64().unwrap());
    assert!((us - 20_000.0 * steps).abs() < 1e-3 * us, "{us} us for {steps} steps");
    let text = nsim(&["energy", "container-tactile", "--samples", "0..2", "--early-exit", "1"]).1;
    assert!(text.contains("early exit 1: ") && text.lines().count() <= 24, "{text}");
    let text = nsim(&["energy", "container-tactile", "--samples", "0..2", "--early-exit", "1", "--full"]).1;
    assert!(text.contains("Early exit 1: "), "{text}");
}
