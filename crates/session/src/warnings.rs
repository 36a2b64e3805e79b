//! Warnings after a run, each with the one change that helps most.
//!
//! Input: a network, the counts of its populations, its samples. Output: warnings in the order of
//! the populations. For a silent population, the samples with most spikes run again. They measure
//! the share of the threshold that it reached, which gives the change to make.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use crate::populations::{CountsByPopulation, PopulationCounts};
use crate::samples::{RunSettings, fast};
use crate::{Outcome, SampleSettings};

use nsim_dynamics as neuron;
use nsim_files::table::count;
use nsim_golden::Golden;
use nsim_ir::arithmetic::{ReadOut, ThresholdTest};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::fixed::{ThresholdMantissa, VmaxExponent};
use nsim_ir::base::id::{CompartmentId, PopulationId};
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::neurons::{NeuronKind, Storage};
use nsim_ir::program::Program;
use nsim_ir::quantised::{Neuron, Note, Quantised, Units};
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::{Image, Machine, Settings};

/// The engine that ran.
#[derive(Debug, Clone, Copy)]
pub enum RunEngine<'a> {
    /// The machine.
    Program(&'a Arc<Program>),
    /// The golden interpreter.
    Integers,
    /// The reference engine, in real numbers.
    Reals,
}

/// A finished run.
#[derive(Debug, Clone, Copy)]
pub struct FinishedRun<'a> {
    /// The network; of several copies, one.
    pub network: &'a Quantised,
    /// The engine.
    pub engine: RunEngine<'a>,
    /// Its counts by population.
    pub sums: &'a CountsByPopulation,
    /// The input samples.
    pub samples: &'a [&'a Sample],
    /// Warnings of their reader.
    pub of_input: &'a [Warning],
    /// Outcome of each sample.
    pub outcomes: &'a [Outcome],
}

/// Maximum number of synapses, and of potentials to read, for which samples run again.
const MOST_REREAD: u64 = 4_000_000;
/// Rounding error of real weights, as a share of the greatest weight, above which a warning
/// follows: half a step of 5 bits and a sign.
const COARSE: f64 = 1.0 / 64.0;
/// Maximum number of samples that run again.
const MOST_RERUN_SAMPLES: usize = 20;
/// Maximum number of names in a warning.
const LISTED: usize = 5;

/// The compartment of a silent population that came nearest to its threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
struct NearestCompartment {
    index: u32,
    potential: i32,
    /// The least potential at which it would have fired.
    fires_from: i32,
    neuron: Neuron,
}

impl NearestCompartment {
    fn share(&self) -> f64 {
        f64::from(self.potential) / f64::from(self.fires_from.max(1))
    }
}

/// Returns the warnings of the network and of its input, then those of the run in the order of the
/// populations.
pub fn warnings(run: FinishedRun<'_>) -> Vec<Warning> {
    let network = run.network;
    let mut warnings = [&network.parts().warnings, run.of_input].concat();
    let compartments = network.populations().enumerate().filter(|(_, p)| p.first_compartment().is_some());
    let rows: Vec<(PopulationId, &PopulationCounts)> =
        compartments.map(|(id, _)| id).zip(&run.sums.populations).collect();
    let silent = rows.iter().filter(|(_, row)| row.compartments > 0 && row.spikes == 0);
    let silent: Vec<PopulationId> = silent.map(|(id, _)| *id).collect();
    let inputs = run.sums.inputs.iter().map(|row| (&row.name, row.spikes));
    let counted_spikes = run.sums.populations.iter().map(|row| (&row.name, row.spikes)).chain(inputs);
    let spiking: HashSet<&str> =
        counted_spikes.filter(|&(_, spikes)| spikes > 0).map(|(name, _)| name.as_str()).collect();
    let (nearest, first) = (nearest(run, &silent), first_overflow(run));
    let rounded = rounded_notes(network);
    for &(id, row) in &rows {
        let is_output = id == network.parts().output;
        let by_potential = is_output && network.parts().decision != ReadOut::Spikes;
        let mut add = |code, message| warnings.push(Warning::of_population(code, &row.name, message));
        if by_potential {
            // An output that decides by its potentials may be silent.
            if let Some(message) = undecided_reason(run, &spiking, id) {
                add(WarningCode::SilentOutput, message);
            }
        } else if let Ok(place) = silent.binary_search(&id) {
            let change = firing_advice(run, &spiking, id, nearest.get(place).copied().flatten());
            let what = if is_output { "the output never spikes, so no sample is decided" } else { "never spikes" };
            add(
                if is_output { WarningCode::SilentOutput } else { WarningCode::SilentPopulation },
                format!("{what}: {change}"),
            );
        } else if is_output && let Some(message) = silent_classes(run) {
            add(WarningCode::SilentOutput, message);
        }
        // Clipping a negative voltage, or a voltage that a spike resets to zero, is harmless.
        if row.cut > 0 {
            let own = first.as_ref().filter(|(population, _)| *population == id && row.cut == row.clipped);
            let place = own.map_or("", |(_, place)| place);
            add(
                WarningCode::Clipped,
                format!("{} clipped{place}: {}", count(row.cut, "voltage"), clipping_advice(network, id)),
            );
        }
        if row.wrapped > 0 {
            let place = first.as_ref().filter(|(population, _)| *population == id).map_or("", |(_, place)| place);
            let message = match network.populations()[id].message.bits() {
                0 => format!("{} wrapped{place}: {HALVE}", count(row.wrapped, "current or accumulator value")),
                bits => format!(
                    "{} wrapped, or were messages of more than {bits} bits, which are not truncated{place}: clip the \
                     messages in the kind, or increase message_bits",
                    count(row.wrapped, "value")
                ),
            };
            add(WarningCode::Wrapped, message);
        }
        if !matches!(run.engine, RunEngine::Reals)
            && let Some(message) = rounding_message(network, &rounded, id)
        {
            add(WarningCode::WeightsRounded, message);
        }
    }
    warnings
}

/// Runs samples on a mapped network and returns its warnings, for callers without counts.
/// Errors are those of [`fast`].
pub fn run_warnings(network: &Quantised, program: &Arc<Program>, samples: &[&Sample]) -> Result<Vec<Warning>> {
    let sample_settings = SampleSettings::new(program.output());
    let run = fast(program, samples, RunSettings::new(&sample_settings), || ())?;
    let sums = CountsByPopulation::new(network, &run.counts);
    Ok(warnings(FinishedRun {
        network,
        engine: RunEngine::Program(program),
        sums: &sums,
        samples,
        of_input: &[],
        outcomes: &run.outcomes,
    }))
}

/// Returns why the potentials that should decide the output stay 0; `None` otherwise.
fn undecided_reason(run: FinishedRun<'_>, spiking: &HashSet<&str>, id: PopulationId) -> Option<String> {
    let decided = run.outcomes.iter().any(|outcome| outcome.class().is_some());
    if decided || run.outcomes.is_empty() {
        return None;
    }
    let why = no_input_reason(run, spiking, id);
    let why = why.as_deref().unwrap_or("all weights into it round to zero; raise them");
    Some(format!("the potentials of the output never leave 0, so no sample is decided: {why}"))
}

/// Returns why nothing reaches a population; `None` where input reaches it. `spiking` has the names
/// of populations and inputs with spikes.
fn no_input_reason(run: FinishedRun<'_>, spiking: &HashSet<&str>, id: PopulationId) -> Option<String> {
    let network = run.network;
    let populations = network.populations();
    let sources: BTreeSet<PopulationId> = network.incoming(id).map(|(_, p)| p.source).collect();
    let fired = sources.iter().any(|source| spiking.contains(populations[*source].name.as_str()));
    // Driven by a bias or a child compartment.
    let driven = populations[id].any_neuron(|neuron| neuron.bias_mant.get() != 0 || neuron.stack.pops.is_some());
    if sources.is_empty() && !driven {
        return Some("it has no incoming projection; add one, or a bias".to_string());
    }
    if !sources.is_empty() && !fired && !driven {
        let names: Vec<String> = sources.iter().take(LISTED).map(|&s| format!("'{}'", populations[s].name)).collect();
        let are = if names.len() == 1 { "is" } else { "are" };
        return Some(format!("it receives no spikes because {} {are} silent; fix that first", names.join(" and ")));
    }
    None
}

/// Returns the change that makes a silent population fire.
fn firing_advice(
    run: FinishedRun<'_>,
    spiking: &HashSet<&str>,
    id: PopulationId,
    nearest: Option<NearestCompartment>,
) -> String {
    let network = run.network;
    if let Some(why) = no_input_reason(run, spiking, id) {
        return why;
    }
    let population = &network.populations()[id];
    let kind = population.neuron_kind().unwrap_or(NeuronKind::Loihi);
    let table = kind.table();
    if !table.registers {
        let threshold = table.parameters.iter().find(|parameter| parameter.storage == Storage::Threshold);
        return match threshold {
            Some(threshold) => format!("lower its {}, or scale up its input weights", threshold.name),
            None if matches!(kind, NeuronKind::Microcode(_)) => {
                format!(
                    "the spike condition of {} neurons was never true: record their state words with --probe",
                    kind.name()
                )
            }
            None => "its inputs sum to zero".to_string(),
        };
    }
    if !population.any_neuron(|neuron| neuron.vth != ThresholdMantissa::MAX) {
        let advice = match id == network.parts().output {
            true => {
                "as in a layer that decides by its potential: write `decision: GreatestV` (or SumOfV, LastV) into the \
                 model, or try it with --set decision=GreatestV"
            }
            false => "so it cannot spike: remove the population, or read its potential (--probe)",
        };
        return format!("its thresholds have the maximum value, {advice}");
    }
    match (nearest, run.engine) {
        (Some(nearest), _) if nearest.potential <= 0 => {
            "its input never raises v above zero; give it positive weights, a weight_exp that does not round them to \
             zero, or a bias"
                .to_string()
        }
        (Some(nearest), _) => threshold_advice(network.parts().threshold, &nearest),
        (None, RunEngine::Reals) => "lower its threshold, or scale up its input weights".to_string(),
        (None, _) => "lower its threshold (vth_mant), or raise the weight_exp of its inputs".to_string(),
    }
}

/// Returns the change at which the nearest compartment would have fired.
fn threshold_advice(test: ThresholdTest, nearest: &NearestCompartment) -> String {
    let vth = nearest.neuron.vth.get();
    let below = if test == ThresholdTest::Strict { nearest.potential - 1 } else { nearest.potential };
    let percent = 100.0 * nearest.share();
    let percent = if percent < 1.0 { format!("{percent:.2}") } else { format!("{percent:.0}") };
    let seen = format!("compartment {} came closest, to {percent} % of its threshold", nearest.index);
    match below / 64 {
        0 => {
            let steps = (1.0 / nearest.share()).log2().ceil();
            format!("{seen}; raise the weight_exp of its inputs by {steps}")
        }
        lower => {
            let by = (f64::from(vth) / f64::from(lower)).ceil();
            format!("{seen}; lower vth_mant from {vth} to {lower}, or divide vth by {by}")
        }
    }
}

/// Returns the nearest compartment of each of these populations, in the samples with most spikes.
/// Empty where the search would take too long.
fn nearest(run: FinishedRun<'_>, silent: &[PopulationId]) -> Vec<Option<NearestCompartment>> {
    let network = run.network;
    let compartments = silent.iter().map(|&id| u64::from(network.populations()[id].shape.len())).sum::<u64>();
    let mut samples = run.samples.to_vec();
    samples.sort_by_key(|sample| std::cmp::Reverse(sample.spikes()));
    let mut reads = 0;
    let affordable = samples.iter().take_while(|sample| {
        reads += compartments * u64::from(sample.steps());
        reads <= MOST_REREAD
    });
    let some = affordable.count().min(MOST_RERUN_SAMPLES);
    if silent.is_empty() || some == 0 || network.synapses() > MOST_REREAD {
        return Vec::new();
    }
    let samples = &samples[..some];
    match run.engine {
        RunEngine::Program(program) => match Image::new(program, 1) {
            Ok(image) => nearest_of_runs(&mut Machine::new(&image, Settings::default()), run, silent, samples),
            Err(_) => Vec::new(),
        },
        RunEngine::Integers => nearest_of_runs(&mut Golden::new(network), run, silent, samples),
        RunEngine::Reals => Vec::new(),
    }
}

/// Runs samples and reads the potentials of silent populations.
fn nearest_of_runs(
    engine: &mut dyn Engine,
    run: FinishedRun<'_>,
    silent: &[PopulationId],
    samples: &[&Sample],
) -> Vec<Option<NearestCompartment>> {
    let parts = run.network.parts();
    let mut best: Vec<Option<NearestCompartment>> = vec![None; silent.len()];
    let steps = samples.iter().flat_map(|sample| (0..sample.steps()).map(move |step| (sample, step)));
    for (sample, step) in steps {
        if step == 0 {
            engine.begin(sample.steps());
        }
        engine.step(sample.input(step));
        for (id, best) in silent.iter().zip(&mut best) {
            let population = &parts.populations[*id];
            let Units::Compartments { first, neurons, start_step } = &population.units else { continue };
            for index in 0..population.shape.len() {
                let potential = engine.v(CompartmentId(first.0 + index));
                if best.is_some_and(|best| potential <= best.potential && best.neuron == neurons.get(index)) {
                    continue;
                }
                let neuron = neurons.get(index);
                let fires_from = neuron::fields(&neuron, *start_step, parts.semantics, parts.threshold).fires_from;
                let index = run.network.index_before_pruning(*id, index);
                let nearest = NearestCompartment { index, potential, fires_from, neuron };
                if best.is_none_or(|best| nearest.share() > best.share()) {
                    *best = Some(nearest);
                }
            }
        }
    }
    best
}

/// Returns the population of the first overflow, and a text with its place.
fn first_overflow(run: FinishedRun<'_>) -> Option<(PopulationId, String)> {
    let firsts = run.outcomes.iter().enumerate();
    let (sample, (step, compartment)) = firsts.filter_map(|(i, outcome)| Some((i, outcome.overflow.first?))).next()?;
    let (population, index) = run.network.population_of(compartment);
    let index = run.network.index_before_pruning(population, index);
    Some((population, format!(", first at compartment {index}, sample {sample}, step {step}")))
}

/// Returns a message on outputs that never spike although the run has samples of their class.
fn silent_classes(run: FinishedRun<'_>) -> Option<String> {
    let mut silent: BTreeSet<u32> = run.samples.iter().filter_map(|sample| sample.label()).collect();
    silent.retain(|&class| {
        !run.outcomes.iter().any(|outcome| outcome.counts.get(class as usize).is_none_or(|&spikes| spikes > 0))
    });
    let classes = &run.network.parts().classes;
    let names = silent.iter().take(LISTED);
    let names = names.map(|class| classes.get(*class as usize).cloned().unwrap_or_else(|| class.to_string()));
    let mut names: Vec<String> = names.collect();
    if silent.len() > LISTED {
        names.push(format!("{} more", silent.len() - LISTED));
    }
    let (whose, spike, its) = match silent.len() {
        1 => ("the output of class", "spikes", "its threshold"),
        _ => ("the outputs of classes", "spike", "their thresholds"),
    };
    (!silent.is_empty()).then(|| {
        format!("{whose} {} never {spike}, although the input has samples of it: lower {its}", names.join(", "))
    })
}

/// Advice that avoids wrapping and clipping, and leaves all spikes unchanged.
const HALVE: &str = "lower the weight_exp of its inputs by 1, and halve vth_mant and bias_mant: the same spikes \
                     at half the values";

/// Returns the advice that raises the upper bound of voltages.
pub fn clipping_advice(network: &Quantised, id: PopulationId) -> String {
    let narrow = network.populations()[id].any_neuron(|neuron| neuron.vmax < VmaxExponent::MAX);
    if narrow { "raise vmax_exp".to_string() } else { HALVE.to_string() }
}

/// Notes on projections whose weights were all rounded coarsely, by name, with their places.
type RoundedNotes<'n> = HashMap<&'n str, Vec<(usize, &'n Note)>>;

/// Returns the notes on projections whose weights were all rounded.
fn rounded_notes(network: &Quantised) -> RoundedNotes<'_> {
    // Real weights are hardly ever multiples of a step, so the size of the steps counts. The network
    // has warnings of changed integers.
    let mut notes = RoundedNotes::new();
    for (place, note) in network.parts().notes.iter().enumerate() {
        let Some(rounded) = note.rounded else { continue };
        if rounded.changed == rounded.weights && rounded.real && rounded.worst_share > COARSE {
            notes.entry(&note.entity).or_default().push((place, note));
        }
    }
    notes
}

/// Returns a message on the projections into a population whose weights were all rounded.
fn rounding_message(network: &Quantised, rounded: &RoundedNotes<'_>, id: PopulationId) -> Option<String> {
    let names: BTreeSet<&str> = network.incoming(id).map(|(_, projection)| projection.name.as_str()).collect();
    let by_place: BTreeMap<usize, &Note> =
        names.iter().filter_map(|name| rounded.get(name)).flatten().copied().collect();
    let notes: Vec<&Note> = by_place.into_values().collect();
    let all = notes.iter().filter_map(|note| note.rounded);
    let worst = notes.iter().copied().zip(all.clone()).max_by(|a, b| a.1.worst_share.total_cmp(&b.1.worst_share))?;
    if worst.1.worst_share > 0.999 {
        let entity = &worst.0.entity;
        return Some(format!(
            "the weights of {entity} became 0, because they are too small for the threshold: lower vth to slightly \
             above the largest potential"
        ));
    }
    let change = "`nsim agree` shows the loss; a separate projection for the largest weights makes the steps finer";
    let weights = count(all.map(|rounded| rounded.weights).sum::<u64>(), "weight");
    let (entity, percent) = (&worst.0.entity, 100.0 * worst.1.worst_share);
    Some(format!("all {weights} were rounded, in {entity} by up to {percent:.2} % of the greatest: {change}"))
}
