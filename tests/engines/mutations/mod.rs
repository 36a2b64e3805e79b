//! Random programs with one random change: any change of a program's meaning is rejected, by the
//! judge that should reject it.
//!
//! Three judges look at a program, each after the previous one accepted it: `Program::new` (its
//! tables are closed), `verify` (it keeps the target's limits and formats) and the equivalence
//! checker (its meaning equals its network's). Each kind of mutation states the verdict of the
//! first two, with the broken rule. The verdict of the third is computed: a slow decoder in this
//! file finds the meaning of the original and of the mutated program. The checker has to accept
//! exactly the mutations of equal meaning, and name the first difference of the others.

mod kinds;

use std::collections::BTreeMap;
use std::sync::Arc;

use self::kinds::{Expected, KINDS};
use crate::common::compare::small_cores;
use crate::common::random::{self, Draw};
use crate::common::unsearched;
use nsim::check::equivalence::{Difference, check_copies};
use nsim::check::memory;
use nsim::check::verify::{Violation, verify};
use nsim::compile::{DEFAULT_RATE, Front, Mapping, Options, compile, map};
use nsim::ir::base::fixed::Delay;
use nsim::ir::base::id::{ChannelId, ClassId, CompartmentId, CoreId, Id, IdVec};
use nsim::ir::firing_rates::Rates;
use nsim::ir::hardware::{Chip, Target};
use nsim::ir::partition::CoreUsage;
use nsim::ir::program::{Compartment, CoreImage, Graded, Messages, Parts, Program};
use nsim::ir::quantised::connectivity::SynapseFormat;
use nsim::ir::resource::{Packing, Resource};
use rayon::prelude::*;

/// Random networks. Each is mapped by five methods, some in three copies, and each program is
/// mutated once by every kind.
const NETWORKS: u64 = 60;

/// A synapse as its source's spike reaches it: target, format, weight, delay.
type Reached = (CompartmentId, SynapseFormat, i16, Delay);

/// Meaning of a program, decoded simply, without regard to speed.
#[derive(PartialEq)]
struct Meaning {
    compartments: Vec<Compartment>,
    /// Input channels in order, then compartments: name, and every synapse in ascending order.
    sources: Vec<(String, Vec<Reached>)>,
}

impl Meaning {
    fn decoded(parts: &Parts) -> Meaning {
        let image = |id: usize| {
            let seat = parts.seats[CompartmentId::new(id)];
            (&parts.cores[seat.core], usize::from(seat.slot))
        };
        let reached = |messages: Messages<'_>| {
            let mut reached = Vec::new();
            for message in messages {
                let (image, class) = (&parts.cores[message.core], parts.class_of(message.core));
                for synapse in class.inputs.get(usize::from(message.axon)).synapses() {
                    let format = class.formats[usize::from(synapse.format)].synapse;
                    reached.push((image.ids[usize::from(synapse.slot)], format, synapse.weight, synapse.delay));
                }
            }
            reached.sort_unstable();
            reached
        };
        let channels = (0..parts.channels.len()).map(|i| {
            (format!("input channel {}", ChannelId::new(i)), reached(Messages::Channel(parts.channels.get(i).iter())))
        });
        let compartments = (0..parts.seats.len()).map(|i| {
            let (image, slot) = image(i);
            (format!("compartment {}", CompartmentId::new(i)), reached(image.axons_out.get(slot)))
        });
        Meaning {
            compartments: (0..parts.seats.len())
                .map(|i| parts.classes[image(i).0.class].compartments[image(i).1])
                .collect(),
            sources: channels.chain(compartments).collect(),
        }
    }
}

/// The admissible verdicts of the equivalence checker on a closed program. If several sources reach
/// something else, it may name any of them.
fn verdicts(good: &Parts, meant: &Meaning, mutated: &Parts) -> Vec<Result<(), Difference>> {
    let frame = [
        (good.channels.len() == mutated.channels.len(), "number of input channels"),
        (good.seats.len() == mutated.seats.len(), "number of compartments"),
        (good.populations == mutated.populations, "list of populations"),
        (good.graded == mutated.graded, "payload of a population"),
        (good.output == mutated.output, "output population"),
        (good.semantics == mutated.semantics, "semantics"),
        (good.threshold == mutated.threshold, "threshold test"),
        (good.reset == mutated.reset, "reset"),
    ];
    if let Some((_, what)) = frame.into_iter().find(|(same, _)| !same) {
        return vec![Err(Difference::Frame(what))];
    }
    let decoded = Meaning::decoded(mutated);
    if let Some(at) = (0..good.seats.len()).find(|&at| meant.compartments[at] != decoded.compartments[at]) {
        return vec![Err(Difference::Parameters(CompartmentId::new(at)))];
    }
    let differ = meant.sources.iter().zip(&decoded.sources).filter(|(meant, decoded)| meant != decoded);
    let differ = differ.map(|((source_name, meant), (_, decoded))| {
        let (decoded, meant) = (decoded.len(), meant.len());
        Err(Difference::Synapses { source_name: source_name.clone(), decoded, meant })
    });
    let differ: Vec<_> = differ.collect();
    if differ.is_empty() { vec![Ok(())] } else { differ }
}

/// The shipped chip with room for all untested limits, so that a mutation breaks its intended rule.
fn roomy(compartments: u32, packing: Packing) -> Target {
    let chip = small_cores("oheo-gulch", compartments);
    let mut limits = chip.limits().clone();
    (limits[Resource::AxonsOut], limits.packing) = (1 << 16, packing);
    (limits[Resource::SynapseWords], limits[Resource::SynapseWordsPerAxon]) = (1 << 20, 1 << 16);
    chip.with_limits(limits)
}

/// Whether two programs are equal, regardless of the sharing of classes.
fn is_same(a: &Parts, b: &Parts) -> bool {
    let rest = |parts: &Parts| Parts { classes: IdVec::new(), cores: IdVec::new(), ..parts.clone() };
    let of_core = |parts: &Parts, image: &CoreImage| {
        (parts.classes.get(image.class).cloned(), CoreImage { class: ClassId(0), ..image.clone() })
    };
    let cores = |parts: &Parts| parts.cores.iter().map(|image| of_core(parts, image)).collect::<Vec<_>>();
    cores(a) == cores(b) && rest(a) == rest(b)
}

/// Verdicts on a kind of mutation over all programs.
#[derive(Default, Clone)]
struct Tally {
    applied: u64,
    /// Number of rejections by each judge, and of programs that none rejected.
    rejected_by: BTreeMap<&'static str, u64>,
    wrong: Vec<String>,
}

/// Mutates a program once by every kind.
fn mutate(compiled: Mapping, target: &Target, seed: u64, tallies: &mut [Tally]) {
    let Mapping { program, quantised: network, partition, options: Options { copies, .. }, .. } = compiled;
    let check = |program: &Program| check_copies(&network, program, copies).map(drop);
    assert_eq!((verify(&program, target), check(&program)), (Ok(()), Ok(())), "seed {seed}");
    // A limit one below the program's need is too small.
    let counted = memory::used(&program, &network, target).unwrap();
    for resource in Resource::ALL {
        let most = |usage: &IdVec<CoreId, CoreUsage>| usage.iter().map(|used| used[resource]).max().unwrap();
        let need = most(&counted);
        // For stored synapses the checker counts the least that the tables need.
        assert!(need == most(partition.usage()) || resource == Resource::StoredSynapses, "seed {seed}: {resource:?}");
        let Some(less) = need.checked_sub(1) else { continue };
        let tight = target.clone().with_limits(target.limits().clone().with(resource, less as u32));
        let found = memory::used(&program, &network, &tight);
        assert!(matches!(&found, Err(Violation::Excess { capacity, .. }) if *capacity == resource), "{found:?}");
    }
    // A chip without a kind, and one with messages a bit too narrow, do not suffice either.
    let kind = program.classes()[ClassId(0)].compartments[0].neuron.kind;
    let mut chip = target.chip().clone();
    chip.neuron_kinds.retain(|&family| family != kind.family());
    let found = verify(&program, &target.clone().with_chip(chip));
    assert!(matches!(&found, Err(Violation::Kind { kind: of, .. }) if *of == kind.name()), "seed {seed}: {found:?}");
    let periods = program.classes().iter().flat_map(|class| class.compartments.iter());
    if let Some(longest) = periods.map(|compartment| compartment.neuron.refractory.get()).max().filter(|&r| r > 0) {
        let chip = Chip { refractory: longest - 1, ..target.chip().clone() };
        let found = verify(&program, &target.clone().with_chip(chip));
        assert!(
            matches!(found, Err(Violation::Refractory { period, .. }) if period == longest),
            "seed {seed}: {found:?}"
        );
    }
    let sends = |graded: &&Graded| graded.sources.clone().any(|source| program.messages(source).len() > 0);
    if let Some(widest) = program.parts().graded.iter().filter(sends).map(|graded| graded.message.bits()).max() {
        let narrow = Chip { message_bits: widest - 1, ..target.chip().clone() };
        let found = verify(&program, &target.clone().with_chip(narrow));
        assert!(matches!(found, Err(Violation::Message { bits, .. }) if bits == widest), "seed {seed}: {found:?}");
    }
    let good = Arc::unwrap_or_clone(program).into_parts();
    let meant = Meaning::decoded(&good);
    for (number, ((name, kind), tally)) in KINDS.iter().zip(tallies).enumerate() {
        let mut draw = Draw::new(seed << 8 | number as u64);
        let mut parts = good.clone();
        let Some(expected) = kind(&mut parts, &mut draw) else { continue };
        if is_same(&parts, &good) {
            continue;
        }
        tally.applied += 1;
        let mut wrong = |what: String| tally.wrong.push(format!("{name}, seed {seed}: {what}"));
        let judge = match Program::new(parts) {
            Err(reason) => {
                // Moving a synapse or a neuron may separate a resonator from its second sum.
                let by_sum = reason.0.contains("a sum that its compartment does not have");
                if !by_sum && !matches!(expected, Expected::NotClosed | Expected::Anything) {
                    wrong(format!("rejected as not closed: {reason}"));
                }
                "Program::new"
            }
            Ok(mutated) => {
                let (verified, checked) = (verify(&mutated, target), check(&mutated));
                let verdicts = verdicts(&good, &meant, mutated.parts());
                if !verdicts.contains(&checked) {
                    wrong(format!("the checker says {checked:?}, which should be {:?}", verdicts[0]));
                }
                match (&expected, &verified) {
                    (Expected::NotClosed, _) => wrong("is closed".to_string()),
                    (Expected::Breaks(rule), Err(violation)) if rule(violation) => {}
                    (Expected::Breaks(_), verdict) => wrong(format!("the verifier says {verdict:?}")),
                    (Expected::Verified, Err(violation)) => wrong(format!("the verifier says {violation:?}")),
                    (Expected::Verified, Ok(())) | (Expected::Closed | Expected::Anything, _) => {}
                }
                match (verified, checked) {
                    (Err(_), _) => "verify",
                    (Ok(()), Err(_)) => "equivalence",
                    (Ok(()), Ok(())) => "nobody",
                }
            }
        };
        *tally.rejected_by.entry(judge).or_default() += 1;
    }
}

#[test]
fn what_changes_the_meaning_of_a_program_is_rejected_by_whom_it_should_be() {
    let targets = [roomy(1024, Packing::Nengo), roomy(5, Packing::Nengo), roomy(9, Packing::Nxtf)];
    let (copies_on, boxes_of) = (roomy(40, Packing::Nxtf), roomy(12, Packing::Nengo));
    let tallies = (0..NETWORKS)
        .into_par_iter()
        .map(|seed| {
            let network = if seed % 2 == 0 { random::network(seed) } else { random::mixed(seed) };
            // A mutation chooses the places of cores, so none are searched for. All copies share
            // the tables of one, until a mutation gives a core its own tables.
            let copies = if network.compartments() < 100 { 3 } else { 1 };
            let options = Options { copies, ..unsearched() };
            let mut tallies = vec![Tally::default(); KINDS.len()];
            for target in &targets {
                mutate(compile(network.clone(), target, &options).unwrap(), target, seed, &mut tallies);
            }
            // Cores in classes: copies, and boxes of kernels.
            let copies = Options { copies: 2, ..options };
            mutate(compile(network, &copies_on, &copies).unwrap(), &copies_on, seed, &mut tallies);
            let boxes = Front::from(random::convolutional(seed)).cut();
            if let Ok(boxes) = map(boxes, &boxes_of, &options, &Rates::assumed(DEFAULT_RATE)) {
                mutate(boxes, &boxes_of, seed, &mut tallies);
            }
            tallies
        })
        .reduce(
            || vec![Tally::default(); KINDS.len()],
            |mut all, some| {
                for (all, some) in all.iter_mut().zip(some) {
                    all.applied += some.applied;
                    some.rejected_by.into_iter().for_each(|(judge, n)| *all.rejected_by.entry(judge).or_default() += n);
                    all.wrong.extend(some.wrong);
                }
                all
            },
        );
    let mut wrong: Vec<String> = Vec::new();
    for ((name, _), tally) in KINDS.iter().zip(&tallies) {
        println!("{name}: {} times, rejected by {:?}", tally.applied, tally.rejected_by);
        // A kind that is never applied would prove nothing.
        if tally.applied < 5 {
            wrong.push(format!("{name}: applied {} times only", tally.applied));
        }
        // The first few failures of a kind suffice.
        wrong.extend(tally.wrong.iter().take(3).cloned());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
