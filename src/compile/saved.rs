//! Mappings as files, and back.
//!
//! Out goes which compartments sit on which core of which chip, as runs of populations. In comes such a file and a network:
//! the membership and the places are taken from it after checking that they are of this network and target; everything
//! else (what cores use, tables, messages) is computed again. Limits are checked by the partition that is made of it.

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::compile::packing::MOST_SLOTS;
use crate::desc::mapping::{MappedCore, MappingFile, Run};
use crate::desc::target::Target;
use crate::ir::partition::Partition;
use crate::ir::placement::{Mesh, Placement, Site};
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
                let first = id.0 - first;
                match holds.last_mut() {
                    Some(run) if run.population == name && run.first + run.count == first => run.count += 1,
                    _ => holds.push(Run { population: name.to_string(), first, count: 1 }),
                }
            }
            MappedCore { chip, x, y, core, holds }
        })
        .collect();
    let Origin { target, copies, strategy, seed } = origin;
    MappingFile { model: network.parts().name.clone(), target, copies, strategy, seed, cores }
}

/// Finds a compartment's population, its name and first compartment, by bisection.
fn populations_of<'a>(network: &'a Quantised) -> impl Fn(CompartmentId) -> (&'a str, u32) {
    let firsts: Vec<(u32, &str)> = network
        .populations()
        .iter()
        .filter_map(|population| Some((population.first_compartment()?.0, population.name.as_str())))
        .collect();
    move |id| {
        let (first, name) = firsts[firsts.partition_point(|&(first, _)| first <= id.0) - 1];
        (name, first)
    }
}

/// Compartments of each core in slot order, and where each core is.
pub type Membership = (IdVec<CoreId, Vec<CompartmentId>>, IdVec<CoreId, Site>);

/// The membership and the places that a file gives; `network` is all copies that the file is for.
///
/// # Errors
/// A diagnostic that names what does not match: the model, the target, a population, a run, a compartment, a place.
pub fn membership(file: &MappingFile, network: &Quantised, target: &Target) -> Result<Membership, Diagnostic> {
    let wrong = |code, message: String| Err(Diagnostic::new(code, message));
    if file.model != network.parts().name {
        let (made, model) = (&file.model, &network.parts().name);
        return wrong("mapping.model", format!("the mapping was made for model {made}, not {model}"));
    }
    if file.target != target.name() {
        let (made, target) = (&file.target, target.name());
        return wrong("mapping.target", format!("the mapping was made for target {made}, not {target}"));
    }
    let names: std::collections::HashMap<&str, (u32, u32)> = network
        .populations()
        .iter()
        .filter_map(|p| Some((p.name.as_str(), (p.first_compartment()?.0, p.shape.len()))))
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
            let Some(&(base, size)) = names.get(population.as_str()) else {
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
            for index in *first..first + count {
                if std::mem::replace(&mut seated[(base + index) as usize], true) {
                    return wrong("mapping.twice", format!("compartment {index} of {population} is mapped twice"));
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
        let (name, first) = populations_of(network)(CompartmentId::new(missing));
        let index = missing as u32 - first;
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
    fn what_does_not_match_is_named() {
        let (network, target, good) = saved();
        let network = crate::compile::copies::copies(&network, 3).unwrap();
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
