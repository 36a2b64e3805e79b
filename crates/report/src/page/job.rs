//! Contents of the page of a run (`nsim report`).
//!
//! Input: a priced run, and the network of its file. Output: [`Sections`] for `report::page`, with
//! every step of the first sample. A network in real numbers is compared with its trained form.

use serde_json::{Value, json};

use crate::agree::AgreeReport;
use crate::charts::sample::{Traced, traced};
use crate::charts::weights::weights;
use crate::page::{Sections, fit, network, sample};
use nsim_agree::compare::compare_models;
use nsim_cost::Transport;
use nsim_energy::evaluate::Evaluation;
use nsim_energy::workload::Workload;
use nsim_files::network::Network;
use nsim_files::write::checksum;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::Graph;
use nsim_ir::learning::{Learning, Variable};
use nsim_ir::quantised::Quantised;
use nsim_ir::source_counts::SourceCounts;
use nsim_ir::spikes::Sample;
use nsim_session::Quantity;
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_session::obtain::map_with_defaults;
use nsim_session::samples::Progress;
use nsim_session::weights::WeightHistory;
use nsim_train::convert::staged::is_real;

/// Greatest number of samples on which the trained and the deployed network are compared.
const COMPARED: usize = 40;
/// Most compartments of a population, except the output, whose potentials or messages are drawn.
const WATCHED_OF_EACH: usize = 3;
/// Greatest number of compartments whose potentials or messages are drawn.
const WATCHED: usize = 12;
/// A network with more synapses is not compared with its trained form.
const MOST_COMPARED: u64 = 4_000_000;

/// The sections of a page, but for the comparison with the network as it was trained.
///
/// # Errors
/// The errors of a second run of the first sample, step by step.
pub fn sections(workload: &Workload<'_>, evaluated: &Evaluation, transport: Transport) -> Result<Sections, Error> {
    let Evaluation { energy, run, deployment } = evaluated;
    let (compiled, target, network) = (workload.compiled, workload.target, &workload.compiled.one);
    let samples = workload.samples();
    let rates = Rates::from_counts(&run.counts, network, run.activity.steps());
    let mut sections = Sections {
        results: vec![checksum::printed(energy.json())],
        network: network::json(network),
        fit: fit::json(compiled, target, &compiled.links_at(&rates)),
        confusion: sample::confusion(network, &samples, &run.outcomes),
        ..Sections::default()
    };
    if let (Some(first), Some(outcome)) = (samples.first(), run.outcomes.first()) {
        // Values that the outputs send are the result of a network that decides no class.
        let quantity = if network.decides() { Quantity::Potential } else { Quantity::Message };
        let (ids, watched) = watched(network, quantity, &run.counts);
        let tables = run.meter.tables()[..1].to_vec();
        let settings = workload.metered(tables, deployment, transport);
        let timeline = workload.timeline(settings, first, (&ids, quantity))?;
        sections.sample = sample::json(network, &timeline, (quantity, &watched), first, outcome);
        sections.learning = learning(workload, first)?;
    }
    Ok(sections)
}

/// What each rule learns in a sample, with its picture; null without rules.
fn learning(workload: &Workload<'_>, sample: &Sample) -> Result<Value, Error> {
    let (compiled, draws) = (workload.compiled, &workload.learning.draws);
    let mut rules = Vec::new();
    for (id, Learning { name, rule }) in compiled.one.parts().rules.enumerate() {
        let history = WeightHistory::new(&compiled.program, &compiled.one, draws, id, sample)?;
        let changes = Variable::ALL.into_iter().filter(|&variable| rule.changes(variable));
        let text = |variable: Variable| format!("{}: {}", variable.name(), rule.change(variable));
        let changed = history.first.iter().zip(&history.last).filter(|(first, last)| first != last).count();
        rules.push(json!({
            "name": name, "changes": changes.map(text).collect::<Vec<_>>(), "epoch": rule.epoch(),
            "semantics": rule.semantics().name(), "synapses": history.first.len(), "changed": changed,
            "picture": weights(&format!("weights of {name}"), &history),
        }));
    }
    Ok(if rules.is_empty() { Value::Null } else { json!(rules) })
}

/// The trained network and its integers, from its file, if it has real numbers, neurons that run in
/// them, and is small enough to be compared.
///
/// # Errors
/// As [`real_and_integers`].
pub fn trained(workload: &Workload<'_>, file: &Network) -> Result<Option<(Graph, Quantised)>, Error> {
    let both = real_and_integers(file)?;
    let few = workload.compiled.one.synapses() <= MOST_COMPARED;
    Ok(Some(both).filter(|(graph, _)| is_real(graph) && graph.has_real_form().is_ok() && few))
}

/// Number of samples on which the trained and the deployed network are compared.
pub fn compared(workload: &Workload<'_>) -> usize {
    workload.samples().len().min(COMPARED)
}

/// Agreement of the integer network with the trained one, for [`Sections`]. Calls `progress` after
/// each sample. Relays and pruning are omitted: neither changes a decision, and the trained network
/// has no such populations.
///
/// # Errors
/// As [`map_with_defaults`] and [`compare_models`].
pub fn agreement(
    workload: &Workload<'_>,
    (trained, network): &(Graph, Quantised),
    progress: Progress<'_>,
) -> Result<Value, Error> {
    let samples = workload.samples();
    let some = &samples[..compared(workload)];
    let one = map_with_defaults(network.clone(), workload.target)?;
    let agreement = compare_models((trained, network, None), (network, &one.program), some, None, progress)?;
    let shown = (workload.origin.as_slice(), workload.seed, some.len());
    let report =
        AgreeReport::for_two_networks([(&network.parts().name, ""), ("the trained network", "")], shown, &agreement);
    Ok(report.json())
}

/// Compartments that are drawn: the most active ones of the output, then of each population.
fn watched(network: &Quantised, quantity: Quantity, counts: &SourceCounts) -> (Vec<CompartmentId>, Vec<Traced>) {
    let output = network.parts().output;
    let others = network.populations().ids().filter(|&id| id != output);
    let of_output = WATCHED_OF_EACH.max(network.parts().classes.len().min(6));
    let wanted = std::iter::once((output, None, of_output)).chain(others.map(|id| (id, None, WATCHED_OF_EACH)));
    traced(network, wanted, quantity, |id| counts.compartments[id], WATCHED)
}
