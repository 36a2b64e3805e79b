//! Conversion of boxes to a file, and back.
//!
//! A file holds, layer by layer, the size of a box and the core of each box. Loading checks that
//! these belong to this network and target; everything else is counted again. No number in the file
//! decides an allocation before the file is found to hold as many entries.

use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{CoreId, IdVec, PopulationId};
use nsim_ir::hardware::Target;
use nsim_ir::mapping::{MappedLayer, MappingFile, OnChip};
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::Quantised;
use nsim_partition::resources::closed_form::Layer;
use nsim_partition::resources::packing::MOST_SLOTS;
use nsim_partition::strategy::boxes::Lattices;
use nsim_partition::strategy::lattice::{self, Lattice};
use nsim_partition::strategy::members::Members;

/// Layers of a mapping, as a file has them.
pub fn layers_of(network: &Quantised, lattices: &Lattices, placement: &Placement) -> Vec<MappedLayer> {
    let (mesh, mut sites) = (placement.mesh(), placement.sites().iter());
    let mut layers = Vec::new();
    for (id, population) in network.populations().enumerate() {
        let Some(lattice) = &lattices[id] else { continue };
        let mut places: Vec<OnChip> = Vec::new();
        for site in sites.by_ref().take(lattice.boxes() as usize) {
            let core = (site.y * mesh.width + site.x) * mesh.cores_per_tile + site.core;
            match places.last_mut() {
                Some(on) if on.chip == site.chip => on.cores.push(core),
                _ => places.push(OnChip { chip: site.chip, cores: vec![core] }),
            }
        }
        layers.push(MappedLayer { population: population.name.clone(), size: lattice.size, places });
    }
    layers
}

/// Site of a core, given by its number on a chip.
///
/// # Errors
/// `mapping.site` when there is none.
fn site(mesh: &Mesh, chip: u32, core: u32) -> Result<Site> {
    let inside = chip < mesh.chips_x * mesh.chips_y && core < mesh.cores_per_chip;
    let site = inside.then(|| mesh.site(chip * mesh.cores_per_chip + core)).flatten();
    let none =
        || Diagnostic::new("mapping.site", format!("core {core} of chip {chip} of the mapping is not on the target"));
    site.ok_or_else(none)
}

/// Lattices of a network's layers, all copies, and the placement of their boxes, from a file.
///
/// # Errors
/// A diagnostic that names the population whose boxes are missing, not of its layer, or too many or
/// too few for their places; or the place that is not on the target or taken.
pub fn outline(
    file: &MappingFile,
    network: &Quantised,
    layers: &IdVec<PopulationId, Layer>,
    target: &Target,
) -> Result<(Lattices, Placement)> {
    let wrong = |code, message: String| Err(Diagnostic::new(code, message));
    if !file.cores.is_empty() {
        let message = "the mapping lists compartments by core, but this network needs boxes of layers".to_string();
        return wrong("mapping.layers", message);
    }
    if file.pruned.is_some() {
        let message = "a mapping of boxes applies to the whole network, not to a pruned one".to_string();
        return wrong("mapping.pruned", message);
    }
    let mut found: IdVec<PopulationId, Option<(Lattice, &MappedLayer)>> = vec![None; layers.len()].into();
    for mapped in &file.layers {
        let MappedLayer { population: name, size, .. } = mapped;
        let id = network.population_named(name);
        let Some(id) = id.filter(|&id| network.populations()[id].first_compartment().is_some()) else {
            let message = format!("the mapping has boxes of {name}, which is not a population of compartments");
            return wrong("mapping.population", message);
        };
        if found[id].is_some() {
            return wrong("mapping.twice", format!("layer {name} is mapped twice"));
        }
        let (shape, (channels, rows, columns)) = (layers[id].shape, *size);
        let Some(lattice) = Lattice::new(shape, *size) else {
            let message = format!("boxes of {channels} x {rows} x {columns} do not fit {name} of shape {shape:?}");
            return wrong("mapping.box", message);
        };
        let held = u64::from(channels) * u64::from(rows) * u64::from(columns);
        if held > u64::from(MOST_SLOTS) {
            let message = format!("a box of {name} has {held} compartments, more than {MOST_SLOTS}");
            return wrong("mapping.slots", message);
        }
        let (boxes, places) = (u64::from(lattice.boxes()), mapped.places().count() as u64);
        if boxes != places {
            let message = format!("layer {name} has {boxes} boxes, but the mapping has places for {places}");
            return wrong("mapping.places", message);
        }
        found[id] = Some((lattice, mapped));
    }
    let mesh = Mesh::for_target(target);
    let mut sites: IdVec<CoreId, Site> = IdVec::new();
    for (id, population) in network.populations().enumerate() {
        match found[id] {
            Some((_, mapped)) => {
                for (chip, core) in mapped.places() {
                    sites.push(site(&mesh, chip, core)?);
                }
            }
            None if population.first_compartment().is_some() => {
                return wrong("mapping.missing", format!("layer {} is not in the mapping", population.name));
            }
            None => {}
        }
    }
    let placement = Placement::new(mesh, sites).map_err(|error| Diagnostic::new("mapping.site", error.to_string()))?;
    Ok((found.iter().map(|found| found.map(|(lattice, _)| lattice)).collect(), placement))
}

/// Members and placement from a file of boxes, for a network small enough to be written synapse by
/// synapse.
///
/// # Errors
/// As [`outline`]; `mapping.layers` when the network does not consist of layers.
pub fn membership(file: &MappingFile, network: &Quantised, target: &Target) -> Result<(Members, Placement)> {
    let not_layers = || {
        let message = "the mapping has boxes of layers, but the network has projections that are neither windows nor \
                       all to all";
        Diagnostic::new("mapping.layers", message)
    };
    let layers = lattice::layers(network).filter(|_| network.pruned().is_none()).ok_or_else(not_layers)?;
    let (lattices, placement) = outline(file, network, &layers, target)?;
    let mut members = Members::new();
    for (id, population) in network.populations().enumerate() {
        let (Some(first), Some(lattice)) = (population.first_compartment(), lattices[id]) else { continue };
        lattice.members(&layers[id], first).for_each(|held| _ = members.push(held));
    }
    Ok((members, placement))
}
