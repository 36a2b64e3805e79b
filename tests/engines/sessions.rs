//! Stepping equals running, and a copy of a session continues from its step.

use crate::common::compare::roomy;
use crate::common::random;
use crate::common::unsearched;
use crate::learning::random::random_plastic;
use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::import::model::load_model;
use nsim::ir::base::fixed::Payload;
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::learning::{Rule, Variable};
use nsim::ir::quantised::{Output, Quantised};
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::session::inputs::stimulus;
use nsim::session::obtain::{Conversion, ConversionStage, Request, obtain};
use nsim::session::priced::MeteredMapping;
use nsim::session::samples::{RunSettings, fast};
use nsim::session::{Outcome, Probe, Quantity, SampleSettings, Session, digest};

/// Spikes, u and v of the first copy after a step.
type Seen = (Vec<(u32, i32)>, Vec<(i32, i32)>);

fn seen(session: &Session, network: &Quantised) -> Seen {
    let n = network.compartments();
    let registers = (0..n).map(CompartmentId).map(|c| (session.engine().u(c), session.engine().potential(c) as i32));
    (session.spikes(CompartmentId(0), n), registers.collect())
}

/// Runs one step of a sample; of the steps that can be skipped, every second one is.
fn step(session: &mut Session, sample: &Sample, step: u32) {
    if sample.at(step).is_empty() && step % 2 == 1 && session.skip(1) {
        return;
    }
    // Channels in any order, one of them twice, are one spike each.
    let channels = sample.at(step).iter().rev().chain(sample.at(step).first());
    session.step(channels.map(|&channel| (channel, 1))).unwrap();
}

/// The network; if `graded`, every population may send graded spikes.
fn graded_if(graded: bool, network: &Quantised) -> Quantised {
    let mut parts = network.parts().clone();
    parts
        .populations
        .iter_mut()
        .filter(|_| graded)
        .for_each(|population| population.message = Message::Payload(Payload::new(3).unwrap()));
    Quantised::new(parts).unwrap()
}

#[test]
fn stepping_is_running_and_a_copy_goes_on_from_the_same_step() {
    let chip = roomy("oheo-gulch");
    let (mut spikes, mut graded) = (0, 0);
    for seed in 0..80u64 {
        let random = if seed < 60 { random::network(seed) } else { random::joined(seed) };
        let network = graded_if(seed.is_multiple_of(4), &random);
        let sample = random::sample(&network, seed);
        let copies = 1 + seed as u32 % 3;
        let Ok(mapped) = compile(network.clone(), &chip, &Options { copies, ..unsearched() }) else { continue };
        let image = Image::new(&mapped.program, 1 + seed as usize % 2).unwrap();
        // The simplest method: a run with probes.
        let probe = |quantity| Probe { first: CompartmentId(0), count: network.compartments(), quantity };
        let probes = [Quantity::Spikes, Quantity::U, Quantity::Potential].map(probe).into();
        let keep = SampleSettings { probes, ..SampleSettings::new(network.output()) };
        let mut session = Session::open(&image, &mapped.one, copies);
        let ran = Session::new(Machine::new(&image, Settings::default()), copies).run(&sample, &keep, ());
        let (n, steps) = (network.compartments() as usize, sample.steps() as usize);
        let mut middle = None;
        let mut all = Vec::new();
        for t in 0..sample.steps() {
            if t == sample.steps() / 2 {
                middle = Some(session.clone());
            }
            step(&mut session, &sample, t);
            let now = seen(&session, &network);
            for c in 0..n {
                let at = c * steps + t as usize;
                let spiked = now.0.iter().any(|&(spike, _)| spike as usize == c);
                let probed = (ran.probes[0][at] == 1, ran.probes[1][at], ran.probes[2][at]);
                assert_eq!((spiked, now.1[c].0, now.1[c].1), probed, "network {seed}, step {t}, compartment {c}");
            }
            spikes += now.0.len();
            graded += now.0.iter().filter(|(_, value)| *value != 1).count();
            all.push(now);
        }
        // Resumes from the middle twice: neither run changes the stored session.
        let middle = middle.unwrap();
        for _ in 0..2 {
            session = middle.clone();
            for t in sample.steps() / 2..sample.steps() {
                step(&mut session, &sample, t);
                assert!(seen(&session, &network) == all[t as usize], "network {seed}: step {t} after going back");
            }
        }
        session.reset().unwrap();
        for t in 0..sample.steps() {
            step(&mut session, &sample, t);
            assert!(seen(&session, &network) == all[t as usize], "network {seed}: step {t} after a reset");
        }
        assert_eq!(session.run(&sample, &keep, ()), ran, "network {seed}: a run after steps");
        step(&mut session, &sample, 0);
        assert!(seen(&session, &network) == all[0] && session.steps() == 1, "network {seed}: a step after a run");
    }
    assert!(spikes > 10_000 && graded > 100, "{spikes} spikes, {graded} of them graded");
}

#[test]
fn a_channel_that_is_not_there_changes_nothing() {
    let network = random::network(1);
    let mapped = compile(network.clone(), &load_target("nahuku-32").unwrap(), &Options::default()).unwrap();
    let mut session = Session::open(&Image::new(&mapped.program, 1).unwrap(), &mapped.one, 1);
    let refused = session.step([(ChannelId(network.channels()), 1)]).unwrap_err();
    assert_eq!((refused.code, session.steps()), ("session.channel", 0));
}

/// Quantisation alone.
const CONVERSION: Conversion = Conversion { stages: &[ConversionStage::QUANTISE], most_taps: 1 };

/// Output spikes of steps in a sample, in the order of the digest.
fn outputs(session: &mut Session, sample: &Sample, output: Output, steps: std::ops::Range<u32>) -> Vec<(u32, u32)> {
    let mut spikes = Vec::new();
    for t in steps {
        step(session, sample, t);
        spikes.extend(session.spikes(output.first, output.count).iter().map(|&(unit, _)| (t, unit)));
    }
    spikes
}

#[test]
fn stepping_is_running_for_every_shipped_model_and_a_snapshot_goes_on_as_before() {
    let source = ["scene:noise?samples=1&steps=100&seed=1&rate=0.05".to_string()];
    let mut fired = 0;
    for model in nsim::files::shipped::MODELS {
        let network = load_model(model.name).unwrap();
        let job = obtain(&Request::new(model.name, &network, CONVERSION)).unwrap();
        let (mapped, _) = job.mapped().unwrap();
        let sample = &stimulus(&mapped.one, &source, None, None).unwrap().samples[0];
        let output = mapped.program.output();
        let ran =
            fast(&mapped.program, &[sample], RunSettings::new(&SampleSettings::new(output)), || ()).unwrap().outcomes;

        let mut session = Session::open(&Image::new(&mapped.program, 1).unwrap(), &mapped.one, 1);
        let mut spikes = outputs(&mut session, sample, output, 0..50);
        let middle = session.clone();
        let rest = outputs(&mut session, sample, output, 50..sample.steps());
        let end = seen(&session, &mapped.one);
        session = middle;
        assert_eq!(outputs(&mut session, sample, output, 50..sample.steps()), rest, "{}: after going back", model.name);
        assert!(seen(&session, &mapped.one) == end, "{}: spikes, u and v after going back", model.name);
        spikes.extend(rest);
        fired += usize::from(!spikes.is_empty());
        let stepped = Outcome { spikes, ..Outcome::default() };
        assert_eq!(digest(&[stepped]), digest(&ran), "{}", model.name);
    }
    assert!(fired > 10, "{fired} models have output spikes");
}

/// Counts, times and energies of the steps of a session are those of a run of as many steps: with
/// rules, copies, delays that spikes do not survive, and skipped steps.
#[test]
fn the_steps_of_a_session_are_metered_as_a_run_of_them() {
    let board = roomy("oheo-gulch");
    let (mut compared, mut delayed, mut moving) = (0, 0, 0);
    for seed in 0..60u64 {
        let (network, seeded) = if seed % 3 == 0 { (random::network(seed), 0) } else { (random_plastic(seed).0, seed) };
        let options = Options { copies: 1 + seed as u32 % 3, ..unsearched() };
        let Ok(mapped) = compile(network.clone(), &board, &options) else { continue };
        let metered = MeteredMapping::new(&mapped);
        let settings = || metered.offline(&board).unwrap().0;
        let image = Image::new(metered.program(), 1).unwrap();
        let mut session = Session::open_metered(&image, &mapped.one, metered.copies_run(), Some(settings()));
        session.set_seed(seeded);
        let whole = random::sample(&network, seed);
        for steps in [whole.steps() / 2, whole.steps()] {
            // A reset drops what was counted.
            step(&mut session, &whole, 0);
            session.reset_all();
            let sample = whole.beginning(steps);
            (0..steps).for_each(|t| step(&mut session, &sample, t));
            let mut keep = SampleSettings::new(mapped.program.output());
            keep.learning.draws.seed = seeded;
            let run = metered.run(settings(), &[&sample], RunSettings::new(&keep)).unwrap();
            let found = metered.run_of_session(session.metered().unwrap());
            let what = format!("network {seed}, {steps} steps");
            assert_eq!(found.activity, run.activity, "{what}");
            assert_eq!(found.meter.lanes(), run.meter.lanes(), "{what}");
            assert_eq!(found.meter.slowest_steps(), run.meter.slowest_steps(), "{what}");
            assert_eq!(found.counts, run.counts, "{what}");
            assert_eq!(found.outcomes[0].class(), run.outcomes[0].class(), "{what}");
            compared += 1;
        }
        delayed += u32::from(image.longest_delay() > 1);
        let moves = |rule: &Rule| rule.semantics().delays_act() && rule.changes(Variable::Delay);
        moving += u32::from(network.parts().rules.iter().any(|learning| moves(&learning.rule)));
    }
    assert!(
        compared > 60 && delayed > 20 && moving > 5,
        "{compared} samples, {delayed} with delays, {moving} learn them"
    );
}
