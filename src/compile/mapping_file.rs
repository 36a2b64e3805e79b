//! Mappings as files, and back.
//!
//! Out goes which compartments sit on which core of which chip, as runs of populations. In comes such a file and a network:
//! the membership and the places are taken from it after checking that they are of this network and target; everything
//! else (what cores use, tables, messages, what is pruned) is computed again. Files count compartments as the model does,
//! pruned or not. Limits are checked by the partition that is made of it.

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{ChannelId, CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::compile::frontend::prune::{Plan, Scene};
use crate::compile::resources::packing::MOST_SLOTS;
use crate::compile::symbolic;
use crate::desc::mapping::{MappedCore, MappingFile, PrunedFile, Run};
use crate::desc::target::Target;
use crate::ir::partition::Partition;
use crate::ir::placement::{Mesh, Placement, Site};
use crate::ir::pruned::Pruned;
use crate::ir::quantised::Quantised;

/// What a mapping was made for and with.
#[derive(Debug, Clone)]
pub struct Origin {
    /// The target's name.
    pub target: String,
    /// Copies of the model.
    pub copies: u32,
    /// The strategy's name.
    pub strategy: String,
    /// The strategy's seed.
    pub seed: u64,
}

/// The file of a partition and placement.
#[must_use]
pub fn save(network: &Quantised, partition: &Partition, placement: &Placement, origin: Origin) -> MappingFile {
    let population_of = populations_of(network);
    let cores = partition
        .members()
        .enumerate()
        .map(|(core, held)| {
            let Site { chip, x, y, core } = placement.site(core);
            let mut holds: Vec<Run> = Vec::new();
            for &id in held {
                let (name, first) = population_of(id);
                match holds.last_mut() {
                    Some(run) if run.population == name && run.first + run.count == first => run.count += 1,
                    _ => holds.push(Run { population: name.to_string(), first, count: 1 }),
                }
            }
            MappedCore { chip, x, y, core, holds }
        })
        .collect();
    let Origin { target, copies, strategy, seed } = origin;
    let pruned = network.pruned().map(|pruned| pruned_file(pruned));
    let layers = Vec::new();
    MappingFile { model: network.parts().name.clone(), target, copies, strategy, seed, pruned, cores, layers }
}

/// The first copy alone, on the cores that hold a part of it.
#[must_use]
pub fn one_copy(file: &MappingFile) -> MappingFile {
    // Populations of further copies are called name@k, and no population of a model has such a name.
    let is_first = |population: &str| !population.contains('@');
    let of_first = |core: &MappedCore| {
        let holds: Vec<Run> = core.holds.iter().filter(|run| is_first(&run.population)).cloned().collect();
        (!holds.is_empty()).then(|| MappedCore { holds, ..core.clone() })
    };
    let cores = file.cores.iter().filter_map(of_first).collect();
    let layers = file.layers.iter().filter(|layer| is_first(&layer.population)).cloned().collect();
    MappingFile { copies: 1, cores, layers, ..file.clone() }
}

/// Finds the name of a compartment's population, and the index that the model file gives it, by bisection.
fn populations_of<'a>(network: &'a Quantised) -> impl Fn(CompartmentId) -> (&'a str, u32) {
    let firsts: Vec<(u32, PopulationId, &str)> = network
        .populations()
        .enumerate()
        .filter_map(|(id, population)| Some((population.first_compartment()?.0, id, population.name.as_str())))
        .collect();
    move |id| {
        let (first, population, name) = firsts[firsts.partition_point(|&(first, ..)| first <= id.0) - 1];
        (name, network.index_shown(population, id.0 - first))
    }
}

/// What a file must say so that the same is left out again.
fn pruned_file(pruned: &Pruned) -> PrunedFile {
    let populations = pruned.original.populations();
    let mut dead: Vec<Run> = Vec::new();
    for (id, population) in pruned.original.inputs() {
        let Some(first) = population.first_channel() else { continue };
        let within = pruned.dead.partition_point(|channel| *channel < first);
        let of_population = pruned.dead[within..].iter().map(|channel| channel.0 - first.0);
        for index in of_population.take_while(|&index| index < populations[id].shape.len()) {
            match dead.last_mut() {
                Some(run) if run.population == population.name && run.first + run.count == index => run.count += 1,
                _ => dead.push(Run { population: population.name.clone(), first: index, count: 1 }),
            }
        }
    }
    let probed = pruned.probed.iter().map(|&id| populations[id].name.clone()).collect();
    PrunedFile { stimulus: pruned.stimulus.clone(), dead, probed }
}

/// The pruning that a file says was done to a network.
///
/// # Errors
/// A diagnostic that names a population or a run of channels that the network does not have.
pub fn plan(file: &PrunedFile, network: &Quantised) -> Result<Plan, Diagnostic> {
    let wrong = |message: String| Err(Diagnostic::new("mapping.pruned", message));
    let mut dead = Vec::new();
    for Run { population, first, count } in &file.dead {
        let found = network.inputs().find(|(_, input)| input.name == *population);
        let Some((base, size)) = found.and_then(|(_, input)| Some((input.first_channel()?, input.shape.len()))) else {
            return wrong(format!(
                "the mapping was pruned of channels of {population}, which is no input of the model"
            ));
        };
        match first.checked_add(*count) {
            Some(end) if end <= size => dead.extend((*first..end).map(|index| ChannelId(base.0 + index))),
            _ => {
                return wrong(format!(
                    "the mapping was pruned of {first} + {count} channels of {population}, which has {size}"
                ));
            }
        }
    }
    dead.sort_unstable();
    dead.dedup();
    if file.stimulus.is_none() && !dead.is_empty() {
        return wrong("the mapping was pruned of channels, but does not say for which stimulus".to_string());
    }
    let mut plan = Plan::fixed();
    plan.scene = file.stimulus.clone().map(|stimulus| Scene { stimulus, dead });
    for name in &file.probed {
        match network.population_named(name).filter(|&id| network.populations()[id].first_compartment().is_some()) {
            Some(id) => plan.probed.push(id),
            None => return wrong(format!("the mapping keeps {name} whole, which is no population of compartments")),
        }
    }
    Ok(plan)
}

/// Compartments of each core in slot order, and where each core is.
pub type Membership = (IdVec<CoreId, Vec<CompartmentId>>, IdVec<CoreId, Site>);

/// Makes sure that a file is of this model and this target.
///
/// # Errors
/// `mapping.model`, `mapping.target`.
pub fn belongs(file: &MappingFile, network: &Quantised, target: &Target) -> Result<(), Diagnostic> {
    let (model, board) = (&network.parts().name, target.name());
    if file.model != *model {
        let message = format!("the mapping was made for model {}, not {model}", file.model);
        return Err(Diagnostic::new("mapping.model", message));
    }
    if file.target != board {
        let message = format!("the mapping was made for target {}, not {board}", file.target);
        return Err(Diagnostic::new("mapping.target", message));
    }
    Ok(())
}

/// Makes sure that a file is of so many copies.
///
/// # Errors
/// `mapping.copies`.
pub fn of_copies(file: &MappingFile, copies: u32) -> Result<(), Diagnostic> {
    if file.copies == copies {
        return Ok(());
    }
    let message = format!("the mapping is of {} copies, not {copies}", file.copies);
    Err(Diagnostic::new("mapping.copies", message).help(format!(
        "say --copies {}, or make a mapping of {copies}: nsim map --copies {copies} -o FILE",
        file.copies
    )))
}

/// The places of all cores of a file, in order.
///
/// # Errors
/// `mapping.site` for a core that the mesh does not have, and for one that is named twice.
pub fn placement(file: &MappingFile, mesh: Mesh) -> Result<Placement, Diagnostic> {
    let listed = file.cores.iter().map(|at| Ok(Site { chip: at.chip, x: at.x, y: at.y, core: at.core }));
    let boxes = file.places().map(|place| symbolic::file::site(&mesh, place));
    let sites = listed.chain(boxes).collect::<Result<_, Diagnostic>>()?;
    Placement::new(mesh, sites).map_err(|error| Diagnostic::new("mapping.site", error.to_string()))
}

/// The membership and the places that a file gives; `network` is all copies that the file is for.
///
/// # Errors
/// A diagnostic that names what does not match: the model, the target, a population, a run, a compartment, a place.
pub fn membership(file: &MappingFile, network: &Quantised, target: &Target) -> Result<Membership, Diagnostic> {
    let wrong = |code, message: String| Err(Diagnostic::new(code, message));
    belongs(file, network, target)?;
    if !file.layers.is_empty() {
        return symbolic::file::membership(file, network, target);
    }
    let names: std::collections::HashMap<&str, (PopulationId, u32, u32)> = network
        .populations()
        .enumerate()
        .filter_map(|(id, p)| Some((p.name.as_str(), (id, p.first_compartment()?.0, network.units_shown(id)))))
        .collect();
    let mesh = Mesh::of(target);
    let mut seated = vec![false; network.compartments() as usize];
    let (mut members, mut sites) = (IdVec::new(), IdVec::new());
    for (number, core) in file.cores.iter().enumerate() {
        let site = Site { chip: core.chip, x: core.x, y: core.y, core: core.core };
        let place = format!("chip {} tile ({}, {}) core {}", site.chip, site.x, site.y, site.core);
        if site.x >= mesh.width
            || site.y >= mesh.height
            || site.core >= mesh.cores_per_tile
            || mesh.number(site).is_none()
        {
            return wrong("mapping.site", format!("core {number} of the mapping: {place} is not on the target"));
        }
        let mut held = Vec::new();
        for Run { population, first, count } in &core.holds {
            let Some(&(id, base, size)) = names.get(population.as_str()) else {
                return wrong(
                    "mapping.population",
                    format!("core {number} of the mapping holds {population}, which is no population of the model"),
                );
            };
            if first.checked_add(*count).is_none_or(|end| end > size) {
                return wrong(
                    "mapping.run",
                    format!(
                        "core {number} of the mapping: {population} has {size} compartments, not {first} + {count}"
                    ),
                );
            }
            for shown in *first..first + count {
                let Some(index) = network.index_of_shown(id, shown) else {
                    return wrong(
                        "mapping.pruned",
                        format!(
                            "compartment {shown} of {population} is mapped, but there is nothing to map: it is pruned"
                        ),
                    );
                };
                if std::mem::replace(&mut seated[(base + index) as usize], true) {
                    return wrong("mapping.twice", format!("compartment {shown} of {population} is mapped twice"));
                }
                held.push(CompartmentId(base + index));
            }
        }
        if held.len() > MOST_SLOTS as usize {
            let (many, most) = (held.len(), MOST_SLOTS);
            return wrong(
                "mapping.slots",
                format!("core {number} of the mapping holds {many} compartments, more than {most}"),
            );
        }
        members.push(held);
        sites.push(site);
    }
    if let Some(missing) = seated.iter().position(|&seated| !seated) {
        let (name, index) = populations_of(network)(CompartmentId::new(missing));
        return wrong("mapping.missing", format!("compartment {index} of {name} is not in the mapping"));
    }
    match Placement::new(mesh, sites.clone()) {
        Ok(_) => Ok((members, sites)),
        Err(error) => wrong("mapping.site", error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::testing::{limits, slip, target};
    use crate::compile::{Options, compile_quantised, compile_with_mapping};

    fn saved() -> (Quantised, Target, MappingFile) {
        let (network, target) = (slip(3150), target(1, 1, limits()));
        let options = Options { copies: 3, ..Options::default() };
        let compiled = compile_quantised(network.clone(), &target, &options).unwrap();
        (network, target, compiled.mapping_file())
    }

    #[test]
    fn a_saved_mapping_compiles_to_the_same_program() {
        let (network, target, file) = saved();
        let text = ron::to_string(&file).unwrap();
        let read: MappingFile = ron::from_str(&text).unwrap();
        assert_eq!(read, file);
        let options = Options { copies: 3, ..Options::default() };
        let first = compile_quantised(network.clone(), &target, &options).unwrap();
        let again = compile_with_mapping(network, &target, &options, &read).unwrap();
        assert_eq!(first.program, again.program);
    }

    #[test]
    fn one_copy_of_several_is_a_mapping_of_its_own() {
        let target = target(1, 1, limits());
        // Twelve copies share a core, so the first core holds more than the first copy.
        let network = slip(100);
        let options = Options { copies: 20, ..Options::default() };
        let file = compile_quantised(network.clone(), &target, &options).unwrap().mapping_file();
        assert!(file.cores[0].holds.iter().any(|run| run.population.ends_with("@1")));
        let one = one_copy(&file);
        assert_eq!((one.copies, one.cores.len()), (1, 1));
        let compiled = compile_with_mapping(network, &target, &Options::default(), &one).unwrap();
        assert_eq!(compiled.partition.members().as_slice()[0].len(), 62);
        assert_eq!(one_copy(&one), one);
    }

    #[test]
    fn what_does_not_match_is_named() {
        let (network, target, good) = saved();
        let network = crate::compile::frontend::copies::copies(&network, 3).unwrap();
        let refused = |change: fn(&mut MappingFile), code: &str, word: &str| {
            let mut file = good.clone();
            change(&mut file);
            let error = membership(&file, &network, &target).unwrap_err();
            assert_eq!(error.code, code);
            assert!(error.message.contains(word), "{}", error.message);
        };
        assert!(membership(&good, &network, &target).is_ok());
        refused(|f| f.model = "other".into(), "mapping.model", "other");
        refused(|f| f.target = "tiny".into(), "mapping.target", "tiny");
        refused(|f| f.cores[0].holds[0].population = "ghost".into(), "mapping.population", "ghost");
        refused(|f| f.cores[0].holds[0].count = u32::MAX, "mapping.run", "touch");
        refused(|f| f.cores[1].holds[0].population = "touch".into(), "mapping.twice", "compartment 0 of touch");
        refused(|f| f.cores[2].holds.clear(), "mapping.missing", "touch@2");
        refused(|f| f.cores[1].chip = 1, "mapping.site", "chip 1");
        refused(|f| f.cores[1].core = u32::MAX, "mapping.site", "core");
        refused(|f| f.cores[1].core = 0, "mapping.site", "same physical core");
    }
}
