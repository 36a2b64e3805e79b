//! Conversion of mappings to files, and back.
//!
//! A file gives the compartments on each core of each chip, as runs of populations ([`MappedCore`])
//! or as boxes of layers ([`mod@layers`]). Loading checks that it belongs to this network and
//! target, and takes membership and places from it. Everything else (resource use, tables,
//! messages, pruning) is computed again. Files number compartments as the model does, pruned or
//! not.

pub mod layers;
pub mod pruned;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use crate::mapping::Mapping;
use crate::mapping_file::pruned::pruned_file;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::mapping::{MappedCore, MappingFile, Run, check_unchanged};
use nsim_ir::partition::{Partition, Seat, seats};
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::Quantised;
use nsim_partition::error::CompileError;
use nsim_partition::options::Options;
use nsim_partition::resources::exact::usage;
use nsim_partition::resources::packing::MOST_SLOTS;
use nsim_partition::strategy::boxes::{Boxes, Lattices, Layers};
use nsim_partition::strategy::members::{Members, partition_of};

impl Mapping {
    /// The mapping as a file.
    pub fn mapping_file(&self) -> MappingFile {
        let Mapping { quantised, partition, placement, target, options, .. } = self;
        match &self.lattices {
            None => {
                MappingFile { cores: cores_of(quantised, partition, placement), ..empty(quantised, target, options) }
            }
            Some(lattices) => file_of_boxes(quantised, lattices, placement, target, options),
        }
    }
}

/// A file without cores and layers.
fn empty(network: &Quantised, target: &str, options: &Options) -> MappingFile {
    MappingFile {
        model: network.parts().name.clone(),
        target: target.to_string(),
        copies: options.copies,
        strategy: options.strategy.name().to_string(),
        seed: options.seed,
        pruned: network.pruned().map(|pruned| pruned_file(network, pruned)),
        cores: Vec::new(),
        layers: Vec::new(),
        checksum: None,
    }
}

/// The file of boxes and their places.
pub fn file_of_boxes(
    network: &Quantised,
    lattices: &Lattices,
    placement: &Placement,
    target: &str,
    options: &Options,
) -> MappingFile {
    MappingFile { layers: layers::layers_of(network, lattices, placement), ..empty(network, target, options) }
}

/// Cores of a mapping, as a file has them.
fn cores_of(network: &Quantised, partition: &Partition, placement: &Placement) -> Vec<MappedCore> {
    let population_of = populations_of(network);
    let mapped = |(core, held): (CoreId, &Arc<Vec<CompartmentId>>)| {
        let Site { chip, x, y, core } = placement.site(core);
        let mut holds: Vec<Run> = Vec::new();
        for &id in held.iter() {
            let (name, index) = population_of(id);
            Run::add(&mut holds, name, index);
        }
        MappedCore { chip, x, y, core, holds }
    };
    partition.members().enumerate().map(mapped).collect()
}

/// The partition and the placement from a file for all copies of a network, and the lattices of its
/// layers.
///
/// # Errors
/// [`CompileError::Input`] when the file is of another network or target, names an unknown entity,
/// or was changed; [`CompileError::DoesNotFit`] when a core exceeds a limit.
pub fn load(
    file: &MappingFile,
    all: &Quantised,
    target: &Target,
    in_boxes: bool,
) -> Result<(Partition, Placement, Option<Lattices>), CompileError> {
    let limits = target.limits();
    let loaded = if in_boxes {
        belongs(file, all, target)?;
        let layers = Layers::new(all)?;
        let (lattices, placement) = layers::outline(file, all, &layers.layers, target)?;
        let boxes = Boxes::of_lattices(&layers, &lattices, limits);
        let (partition, _) = boxes.into_partition(all, &chips_of(placement.sites()), limits)?;
        (partition, placement, Some(lattices))
    } else {
        let (members, placement) = membership(file, all, target)?;
        (partition_on(all, members, placement.sites(), target)?, placement, None)
    };
    check_unchanged(file)?;
    Ok(loaded)
}

/// The partition of these members on cores at these sites, counted exactly.
///
/// # Errors
/// [`CompileError::Fault`] when a compartment is not on exactly one core; [`CompileError::Input`]
/// when one is not next to its parent; [`CompileError::DoesNotFit`] when a core exceeds a limit.
pub fn partition_on(
    all: &Quantised,
    members: Members,
    sites: &IdVec<CoreId, Site>,
    target: &Target,
) -> Result<Partition, CompileError> {
    if members.iter().flatten().any(|id| id.0 >= all.compartments()) || members.len() != sites.len() {
        return Err(CompileError::fault("the mapping is of another network"));
    }
    let seats = seats(all.compartments(), &members).map_err(CompileError::fault)?;
    let follows = |before: Seat, after: Seat| (after.core, after.slot) == (before.core, before.slot + 1);
    if let Some((child, parent, _)) = all.children().find(|&(a, b, _)| !follows(seats[a], seats[b])) {
        let [(name, index), (above, place)] = [child, parent].map(populations_of(all));
        let message = format!("compartment {index} of {name} is not in the slot before its parent, {place} of {above}");
        return Err(Diagnostic::new("mapping.neuron", message).into());
    }
    let usage = usage(all, &members, &seats, &chips_of(sites), target.limits());
    partition_of(all, members, usage, target.limits())
}

fn chips_of(sites: &IdVec<CoreId, Site>) -> IdVec<CoreId, u32> {
    sites.iter().map(|site| site.chip).collect()
}

/// The first copy alone, on the cores that hold a part of it.
pub fn one_copy(file: &MappingFile) -> MappingFile {
    // Populations of further copies are called name@k, and no population of a model has such a
    // name.
    let is_first = |population: &str| !population.contains('@');
    let of_first = |core: &MappedCore| {
        let holds: Vec<Run> = core.holds.iter().filter(|run| is_first(&run.population)).cloned().collect();
        (!holds.is_empty()).then(|| MappedCore { holds, ..core.clone() })
    };
    let cores = file.cores.iter().filter_map(of_first).collect();
    let layers = file.layers.iter().filter(|layer| is_first(&layer.population)).cloned().collect();
    MappingFile { copies: 1, cores, layers, ..file.clone() }
}

/// Returns a function that finds a compartment's population, by name, and its index in the model
/// file, by bisection.
fn populations_of<'a>(network: &'a Quantised) -> impl Fn(CompartmentId) -> (&'a str, u32) {
    let firsts: Vec<(u32, PopulationId, &str)> = network
        .populations()
        .enumerate()
        .filter_map(|(id, population)| Some((population.first_compartment()?.0, id, population.name.as_str())))
        .collect();
    move |id| {
        let (first, population, name) = firsts[firsts.partition_point(|&(first, ..)| first <= id.0) - 1];
        (name, network.index_before_pruning(population, id.0 - first))
    }
}

/// Checks that a file is of this model and this target.
///
/// # Errors
/// `mapping.model`, `mapping.target`.
pub fn belongs(file: &MappingFile, network: &Quantised, target: &Target) -> Result<()> {
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

/// Adds its file and advice to an error about a saved mapping.
pub fn explained(error: CompileError, path: &Path, model: &str) -> CompileError {
    match error {
        CompileError::Input(diagnostic) if diagnostic.code.starts_with("mapping.") => {
            let help = format!(
                "use the mapping with its own model, target and copies, or make another: nsim map {model} -o FILE"
            );
            let has_help = diagnostic.help.is_some();
            let diagnostic = diagnostic.or_in_file(path);
            CompileError::Input(if has_help { diagnostic } else { diagnostic.help(help) })
        }
        other => other,
    }
}

/// Checks that a file is of `copies` copies.
///
/// # Errors
/// `mapping.copies`.
pub fn of_copies(file: &MappingFile, copies: u32) -> Result<()> {
    if file.copies == copies {
        return Ok(());
    }
    let message = format!("the mapping has {} copies, not {copies}", file.copies);
    Err(Diagnostic::new("mapping.copies", message).help(format!(
        "give --copies {}, or make a mapping of {copies}: nsim map --copies {copies} -o FILE",
        file.copies
    )))
}

/// Members and placement from a file; `network` is all copies of the file.
///
/// # Errors
/// A diagnostic that names the mismatch: the model, the target, a population, a run, a compartment,
/// a place.
pub fn membership(file: &MappingFile, network: &Quantised, target: &Target) -> Result<(Members, Placement)> {
    let wrong = |code, message: String| Err(Diagnostic::new(code, message));
    belongs(file, network, target)?;
    if !file.layers.is_empty() {
        return layers::membership(file, network, target);
    }
    let names: HashMap<&str, (PopulationId, u32, u32)> = network
        .populations()
        .enumerate()
        .filter_map(|(id, p)| Some((p.name.as_str(), (id, p.first_compartment()?.0, network.units_before_pruning(id)))))
        .collect();
    let mesh = Mesh::for_target(target);
    let mut seated = vec![false; network.compartments() as usize];
    let (mut members, mut sites) = (IdVec::new(), IdVec::new());
    for (number, core) in file.cores.iter().enumerate() {
        let site = Site { chip: core.chip, x: core.x, y: core.y, core: core.core };
        let place = format!("chip {} tile ({}, {}) core {}", site.chip, site.x, site.y, site.core);
        if mesh.number(site).is_none() {
            return wrong("mapping.site", format!("core {number} of the mapping: {place} is not on the target"));
        }
        let mut held = Vec::new();
        for Run { population, first, count } in &core.holds {
            let Some(&(id, base, size)) = names.get(population.as_str()) else {
                let message =
                    format!("core {number} of the mapping has {population}, which is not a population of the model");
                return wrong("mapping.population", message);
            };
            if first.checked_add(*count).is_none_or(|end| end > size) {
                let message = format!(
                    "core {number} of the mapping: {population} has {size} compartments, not {first} + {count}"
                );
                return wrong("mapping.run", message);
            }
            for shown in *first..first + count {
                let Some(index) = network.index_after_pruning(id, shown) else {
                    let message = format!("compartment {shown} of {population} is mapped, but it is pruned");
                    return wrong("mapping.pruned", message);
                };
                if std::mem::replace(&mut seated[(base + index) as usize], true) {
                    return wrong("mapping.twice", format!("compartment {shown} of {population} is mapped twice"));
                }
                held.push(CompartmentId(base + index));
            }
        }
        if held.len() > MOST_SLOTS as usize {
            let (many, most) = (held.len(), MOST_SLOTS);
            let message = format!("core {number} of the mapping has {many} compartments, more than {most}");
            return wrong("mapping.slots", message);
        }
        members.push(held);
        sites.push(site);
    }
    if let Some(missing) = seated.iter().position(|&seated| !seated) {
        let (name, index) = populations_of(network)(CompartmentId::new(missing));
        return wrong("mapping.missing", format!("compartment {index} of {name} is not in the mapping"));
    }
    if let Some(core) = members.iter().position(Vec::is_empty) {
        return wrong("mapping.empty", format!("core {core} of the mapping has no compartment"));
    }
    let placement = Placement::new(mesh, sites).map_err(|error| Diagnostic::new("mapping.site", error.to_string()))?;
    Ok((members, placement))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CopyPlacement, Options, compile, load};
    use nsim_testing::{limits, slip, target};

    fn saved() -> (Quantised, Target, MappingFile) {
        let (network, target) = (slip(3150), target(1, 1, limits()));
        let options = Options { copies: 3, ..Options::default() };
        let compiled = compile(network.clone(), &target, &options).unwrap();
        (network, target, compiled.mapping_file())
    }

    #[test]
    fn one_copy_of_several_is_a_mapping_of_its_own() {
        let target = target(1, 1, limits());
        // Twelve copies share a core, so the first core holds more than the first copy.
        let network = slip(100);
        let options = Options { copies: 20, placement: CopyPlacement::Packed, ..Options::default() };
        let file = compile(network.clone(), &target, &options).unwrap().mapping_file();
        assert!(file.cores[0].holds.iter().any(|run| run.population.ends_with("@1")));
        let one = one_copy(&file);
        assert_eq!((one.copies, one.cores.len()), (1, 1));
        let compiled = load(network, &target, &Options::default(), &one).unwrap();
        assert_eq!(compiled.partition.members().as_slice()[0].len(), 62);
        assert_eq!(one_copy(&one), one);
    }

    #[test]
    fn what_does_not_match_is_named() {
        let (network, target, good) = saved();
        let network = nsim_quantise::copies::copies(&network, 3).unwrap();
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
