//! Conversion of the record of pruning to a mapping file, and back.

use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::ChannelId;
use nsim_ir::mapping::{PrunedFile, Run};
use nsim_ir::quantised::{Pruned, Quantised};
use nsim_quantise::prune::{Plan, Scene};

/// The record of a pruned network for a file, by which the pruning can be repeated.
pub fn pruned_file(network: &Quantised, pruned: &Pruned) -> PrunedFile {
    let populations = network.populations();
    let mut dead: Vec<Run> = Vec::new();
    for (id, population) in network.inputs() {
        let Some(first) = population.first_channel() else { continue };
        let within = pruned.dead.partition_point(|channel| *channel < first);
        let of_population = pruned.dead[within..].iter().map(|channel| channel.0 - first.0);
        for index in of_population.take_while(|&index| index < populations[id].shape.len()) {
            Run::add(&mut dead, &population.name, index);
        }
    }
    let probed = pruned.probed.iter().map(|&id| populations[id].name.clone()).collect();
    PrunedFile { stimulus: pruned.stimulus.clone(), dead, probed }
}

/// The plan of the pruning that a file records.
///
/// # Errors
/// A diagnostic that names a population or a run of channels that the network does not have.
pub fn plan(file: &PrunedFile, network: &Quantised) -> Result<Plan, Diagnostic> {
    let wrong = |message: String| Err(Diagnostic::new("mapping.pruned", message));
    let mut dead = Vec::new();
    for Run { population, first, count } in &file.dead {
        let found = network.inputs().find(|(_, input)| input.name == *population);
        let Some((base, all)) = found.and_then(|(_, input)| Some((input.first_channel()?, input.shape.len()))) else {
            return wrong(format!("the mapping prunes channels of {population}, which is not an input of the model"));
        };
        match first.checked_add(*count) {
            Some(end) if end <= all => dead.extend((*first..end).map(|index| ChannelId(base.0 + index))),
            _ => {
                return wrong(format!(
                    "the mapping prunes channels {first} + {count} of {population}, which has {all}"
                ));
            }
        }
    }
    dead.sort_unstable();
    dead.dedup();
    if file.stimulus.is_none() && !dead.is_empty() {
        return wrong("the mapping prunes channels, but field stimulus is missing".to_string());
    }
    let mut plan = Plan::fixed();
    plan.scene = file.stimulus.clone().map(|stimulus| Scene { stimulus, dead });
    for name in &file.probed {
        match network.population_named(name).filter(|&id| network.populations()[id].first_compartment().is_some()) {
            Some(id) => plan.probed.push(id),
            None => {
                return wrong(format!("the mapping keeps {name} unpruned, which is not a population of compartments"));
            }
        }
    }
    Ok(plan)
}
