//! The order in which a core's compartments become lanes.
//!
//! Input: a program and one of its cores. Output: its slots in the order of lanes. Compartments of
//! a population over space are ordered by position, then by channel, for any order of their slots.
//! A row of a kernel then reaches consecutive lanes. Other compartments keep the order of slots.

use nsim_ir::base::id::{CompartmentId, CoreId};
use nsim_ir::program::{Compartments, Program};

/// The populations of a program, by their first compartment.
#[derive(Debug)]
pub(crate) struct LaneOrder<'p> {
    program: &'p Program,
    /// In ascending order.
    populations: Vec<Compartments>,
}

impl<'p> LaneOrder<'p> {
    /// The populations of a program, in order.
    pub fn new(program: &'p Program) -> Self {
        let mut populations: Vec<Compartments> = program.parts().populations.iter().flatten().copied().collect();
        populations.sort_unstable_by_key(|population| population.first);
        LaneOrder { program, populations }
    }

    /// Number of populations that begin at or before a compartment.
    pub fn population(&self, id: CompartmentId) -> usize {
        self.populations.partition_point(|population| population.first <= id)
    }

    /// The slots of a core in the order of lanes.
    pub fn slots(&self, core: CoreId) -> Vec<u16> {
        let ids = &self.program.cores()[core].ids;
        let mut slots: Vec<u16> = (0..ids.len()).map(|slot| slot as u16).collect();
        let population = |slot: &u16| self.population(ids[usize::from(*slot)]);
        for same in slots.chunk_by_mut(|a, b| population(a) == population(b)) {
            let Some(place) = population(&same[0]).checked_sub(1) else { continue };
            let Compartments { first, positions, count } = self.populations[place];
            if positions > 1 && positions < count {
                same.sort_by_key(|&slot| {
                    let index = ids[usize::from(slot)].0 - first.0;
                    (index % positions, index / positions)
                });
            }
        }
        slots
    }
}
