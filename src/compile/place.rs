//! Logical cores onto physical ones.
//!
//! In come a partition and a target; out goes a [`Placement`]: core k of the partition sits on core k of the board, counted
//! chip by chip, row of tiles by row, tile by tile. The partition counted off-chip output axons for this order.

use crate::base::id::{CoreId, IdVec};
use crate::compile::reason::Reason;
use crate::desc::target::Target;
use crate::ir::partition::Partition;
use crate::ir::placement::{Mesh, Placement, Site};

/// The name of this placement in results.
pub const NAME: &str = "sequential";

/// A place for every core, in order.
///
/// # Errors
/// A [`Reason`] when the partition has more cores than the target.
pub fn place(partition: &Partition, target: &Target) -> Result<Placement, Reason> {
    let mesh = Mesh::of(target);
    let too_many = || Reason::of_cores(target, 1, partition.cores() as u64);
    let sites: Option<IdVec<CoreId, Site>> = (0..partition.cores() as u32).map(|core| mesh.site(core)).collect();
    Placement::new(mesh, sites.ok_or_else(too_many)?).map_err(|_| too_many())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::testing::{limits, target};
    use crate::ir::partition::CoreUsage;

    #[test]
    fn cores_are_placed_in_order_and_more_than_there_are_is_a_reason() {
        let of = |cores: usize| {
            let members = (0..cores).map(|_| Vec::new()).collect();
            Partition::new(0, members, vec![CoreUsage::default(); cores].into(), &limits()).unwrap()
        };
        let target = target(2, 1, limits());
        let placement = place(&of(256), &target).unwrap();
        assert_eq!(placement.site(CoreId(131)), Site { chip: 1, x: 0, y: 0, core: 3 });
        let reason = place(&of(257), &target).unwrap_err();
        assert_eq!((reason.need, reason.limit), (257, 256));
        assert!(reason.help.contains("nahuku-32"), "{}", reason.help);
    }
}
