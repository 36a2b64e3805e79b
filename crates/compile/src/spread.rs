//! Copies of a network on separate chips.
//!
//! Input: a network, a function that maps one copy of it, and the number of copies. Output: all
//! copies on their cores, each like the first. A copy takes a *slot*: the whole chips that it
//! needs. Copy k goes to slot k modulo their number; where a copy needs one chip, further copies
//! fill the chip's next cores. There is no output where copies are to be packed, where the network
//! is cut into boxes, or where they do not fit so: then copies are packed as tightly as they fit.
//!
//! Invariant: no two copies share a core, so that the cost of one copy does not depend on the
//! others.

use crate::stages::{Front, Placed};
use nsim_ir::base::id::{CoreId, IdVec};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_partition::error::Result;
use nsim_partition::options::{CopyPlacement, Options};
use nsim_partition::strategy::copies::CopyGroups;
use nsim_partition::strategy::members::Members;

/// Returns all copies, where `one` maps a single copy; `None` where they are to be packed.
///
/// # Errors
/// Errors of `one`, and of copies on their cores.
pub fn spread(
    front: &Front,
    target: &Target,
    options: &Options,
    rates: &Rates,
    one: impl FnOnce(Front, &Options) -> Result<(Members, Placement, &'static str)>,
) -> Result<Option<Placed>> {
    let Options { copies, placement, .. } = *options;
    if copies < 2 || placement == CopyPlacement::Packed || front.in_boxes(copies) {
        return Ok(None);
    }
    // There are more copies than cores, so none can be separate: packing gives the reason.
    if copies > target.cores() {
        return Ok(None);
    }
    let (members, placement, name) = one(front.clone(), &Options { copies: 1, ..*options })?;
    let Some(sites) = sites_of_copies(&placement, Mesh::for_target(target), copies) else { return Ok(None) };
    let all = CopyGroups::repeated(front.quantised(), members, copies).members();
    front.clone().place_on(target, options, rates, (all, sites), name).map(Some)
}

/// Sites of the cores of each copy, copy by copy; `None` where there is no room.
fn sites_of_copies(one: &Placement, mesh: Mesh, copies: u32) -> Option<IdVec<CoreId, Site>> {
    let chips = one.sites().iter().map(|site| site.chip).max()? + 1;
    let slots = mesh.chips_x * mesh.chips_y / chips;
    let numbers: Vec<u32> = one.sites().iter().map(|&site| mesh.number(site)).collect::<Option<_>>()?;
    let slot = |copy: u32| (copy % slots.max(1)) * chips * mesh.cores_per_chip;
    let layers = copies.div_ceil(slots.max(1));
    if slots == 0 || (chips > 1 && layers > 1) {
        return None;
    }
    if layers == 1 {
        let of_copy = |copy: u32| numbers.iter().map(move |number| mesh.site(slot(copy) + number));
        return (0..copies).flat_map(of_copy).collect();
    }
    // Several copies on a chip: consecutive in the chip's own order, each as near to the corner as
    // it can be.
    let size = numbers.len() as u32;
    let mut sorted = numbers.clone();
    sorted.sort_unstable();
    let rank = |number: &u32| sorted.partition_point(|other| other < number) as u32;
    if layers * size > mesh.cores_per_chip {
        return None;
    }
    let of_copy = |copy: u32| {
        let first = slot(copy) + copy / slots * size;
        numbers.iter().map(|number| mesh.site(first + rank(number))).collect::<Vec<_>>()
    };
    (0..copies).flat_map(of_copy).collect()
}

#[cfg(test)]
mod tests {
    use crate::{Options, compile};
    use nsim_testing::{limits, random_network, target};

    #[test]
    fn each_copy_has_a_chip_while_there_are_any_and_then_chips_are_filled() {
        let network = random_network(3);
        let target = target(2, 2, limits());
        let one = compile(network.clone(), &target, &Options::default()).unwrap();
        for copies in [2, 4, 5, 9] {
            let spread = compile(network.clone(), &target, &Options { copies, ..Options::default() }).unwrap();
            assert_eq!(spread.placement.len(), one.placement.len() * copies as usize);
            assert_eq!(spread.placement.chips_used(), copies.min(4));
            let mut on_chip = [0; 4];
            spread.placement.sites().iter().for_each(|site| on_chip[site.chip as usize] += 1);
            let cores = one.placement.len() as u32;
            let expected = |chip: u32| cores * (copies / 4 + u32::from(chip < copies % 4));
            assert_eq!(on_chip, [0, 1, 2, 3].map(expected), "{copies} copies");
        }
    }
}
