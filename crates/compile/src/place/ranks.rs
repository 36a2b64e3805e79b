//! Assignment of cores to the processes that run a program together.
//!
//! Input: a network, its partition and placement, and the number of ranks. Output: the rank of each
//! core. Whole chips are assigned where their loads are even, cores otherwise. Chips are first cut
//! into runs along the board, row by row and back, because placement has put cores that exchange
//! messages near each other. Then each goes to the rank with which its cores exchange most, as long
//! as loads stay even. The measure is *cut traffic*: sources, counted once for each unit that they
//! reach.
//!
//! Every rank computes this assignment alone: nothing here depends on threads or on the clock.

use std::sync::atomic::{AtomicU32, Ordering};

use nsim_ir::base::id::{CoreId, Id, IdVec};
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Placement, Site};
use nsim_ir::quantised::Quantised;
use nsim_partition::resources::fan_out::by_source;

/// Load of a compartment, in synapses: with one update a step and 1 % firing, an update costs as
/// much as a few events.
const COMPARTMENT: u64 = 16;
/// Largest load of a rank, in hundredths of the mean, where whole chips are assigned.
const UNEVEN_CHIPS: u64 = 110;
/// Largest load of a rank, in hundredths of the mean, while units move.
const UNEVEN: u64 = 105;
/// Most units among which traffic is counted: the square of their number is stored.
const MOST_UNITS: usize = 1_024;
/// Most rounds of moves; each reduces the cut traffic.
const ROUNDS: usize = 16;

/// The rank of each core.
pub fn assign(network: &Quantised, partition: &Partition, placement: &Placement, ranks: u32) -> IdVec<CoreId, u32> {
    let load = |core: CoreId| partition.usage()[core].synapses + COMPARTMENT * partition.members()[core].len() as u64;
    let loads: Vec<u64> = partition.members().ids().map(load).collect();
    let mut order: Vec<CoreId> = partition.members().ids().collect();
    let chips_x = placement.mesh().chips_x.max(1);
    order.sort_by_key(|&core| along(placement.site(core), chips_x));
    let by_chip: Vec<Vec<CoreId>> =
        order.chunk_by(|&a, &b| placement.site(a).chip == placement.site(b).chip).map(<[CoreId]>::to_vec).collect();
    let mut units = Units::new(by_chip, &loads, ranks);
    if !units.is_even(UNEVEN_CHIPS) {
        let size = order.len().div_ceil(MOST_UNITS).max(1);
        units = Units::new(order.chunks(size).map(<[CoreId]>::to_vec).collect(), &loads, ranks);
    }
    let mut unit_of: IdVec<CoreId, u32> = vec![0; loads.len()].into();
    for (number, cores) in (0u32..).zip(&units.cores) {
        cores.iter().for_each(|&core| unit_of[core] = number);
    }
    if units.cores.len() <= MOST_UNITS && ranks > 1 {
        units.refine(&traffic(network, partition, &unit_of, units.cores.len()));
    }
    unit_of.iter().map(|&unit| units.ranks_of[unit as usize]).collect()
}

/// Position of a site along the board, row by row and back.
fn along(site: Site, chips_x: u32) -> (u32, i64, u32, i64, u32) {
    let back = |row: u32, column: u32| if row.is_multiple_of(2) { i64::from(column) } else { -i64::from(column) };
    let (row, column) = (site.chip / chips_x, site.chip % chips_x);
    (row, back(row, column), site.y, back(site.y, site.x), site.core)
}

/// The units that are assigned: chips, or cores.
struct Units {
    cores: Vec<Vec<CoreId>>,
    loads: Vec<u64>,
    /// The rank of each unit; `ranks` is their number.
    ranks_of: Vec<u32>,
    ranks: u32,
}

impl Units {
    /// Assigns units in runs of about equal load.
    fn new(cores: Vec<Vec<CoreId>>, of_core: &[u64], ranks: u32) -> Self {
        let loads: Vec<u64> = cores.iter().map(|cores| cores.iter().map(|core| of_core[core.index()]).sum()).collect();
        let all: u64 = loads.iter().sum::<u64>().max(1);
        let mut before = 0;
        // The rank whose run contains the middle of the unit.
        let rank = |load: &u64| {
            let middle = before + load / 2;
            before += load;
            (u128::from(middle) * u128::from(ranks) / u128::from(all)).min(u128::from(ranks) - 1) as u32
        };
        let ranks_of = loads.iter().map(rank).collect();
        Units { cores, loads, ranks_of, ranks }
    }

    fn of_ranks(&self) -> Vec<u64> {
        let mut sums = vec![0; self.ranks as usize];
        self.loads.iter().zip(&self.ranks_of).for_each(|(load, &rank)| sums[rank as usize] += load);
        sums
    }

    /// Load of a rank at `percent` hundredths of the mean.
    fn percent_of_mean(&self, percent: u64) -> u64 {
        let all: u64 = self.loads.iter().sum();
        (u128::from(all) * u128::from(percent) / 100).div_ceil(u128::from(self.ranks.max(1))) as u64
    }

    fn is_even(&self, percent: u64) -> bool {
        self.of_ranks().into_iter().max().unwrap_or(0) <= self.percent_of_mean(percent)
    }

    /// Moves units to ranks with which they exchange more.
    fn refine(&mut self, traffic: &[u32]) {
        let (units, ranks) = (self.cores.len(), self.ranks as usize);
        let (mut sums, most) = (self.of_ranks(), self.percent_of_mean(UNEVEN));
        for _ in 0..ROUNDS {
            let mut moved = false;
            for unit in 0..units {
                let mut with = vec![0u64; ranks];
                for other in (0..units).filter(|&other| other != unit) {
                    let both = u64::from(traffic[unit * units + other]) + u64::from(traffic[other * units + unit]);
                    with[self.ranks_of[other] as usize] += both;
                }
                let (here, load) = (self.ranks_of[unit] as usize, self.loads[unit]);
                let fits = |&to: &usize| to != here && sums[to] + load <= most;
                // Of ranks with equal traffic the lowest.
                let best = (0..ranks).filter(fits).max_by_key(|&to| (with[to], std::cmp::Reverse(to)));
                if let Some(to) = best.filter(|&to| with[to] > with[here]) {
                    self.ranks_of[unit] = to as u32;
                    (sums[here], sums[to]) = (sums[here] - load, sums[to] + load);
                    moved = true;
                }
            }
            if !moved {
                break;
            }
        }
    }
}

/// Number of compartments of one unit that reach another, for each pair of units.
fn traffic(network: &Quantised, partition: &Partition, unit_of: &IdVec<CoreId, u32>, units: usize) -> Vec<u32> {
    let sums: Vec<AtomicU32> = (0..units * units).map(|_| AtomicU32::new(0)).collect();
    let core_of = partition.seats().iter().map(|seat| seat.core).collect();
    let _: Vec<()> = by_source(network, &core_of, partition.cores(), true, |_, own, reached| {
        let Some(own) = own else { return };
        let mut reached: Vec<u32> = reached.iter().map(|&core| unit_of[core]).collect();
        reached.sort_unstable();
        reached.dedup();
        let first = unit_of[own] as usize * units;
        reached.iter().for_each(|&unit| _ = sums[first + unit as usize].fetch_add(1, Ordering::Relaxed));
    });
    sums.into_iter().map(AtomicU32::into_inner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEFAULT_RATE, Front};
    use crate::{Options, Partitioned};
    use nsim_ir::firing_rates::Rates;
    use nsim_ir::resource::Resource;
    use nsim_testing::{limits, random_network, target};

    fn partitioned(seed: u64) -> (Partitioned, Placement) {
        let board = target(4, 2, limits().with(Resource::Compartments, 6));
        let front = Front::from(random_network(seed));
        let rates = Rates::assumed(DEFAULT_RATE);
        let partitioned = front.partition(&board, &Options::default(), &rates).unwrap();
        let (placement, _) = partitioned.placement(&board, &Options::default()).unwrap();
        (partitioned, placement)
    }

    #[test]
    fn every_core_has_a_rank_and_loads_are_about_even() {
        let mut tried = 0;
        for seed in 0..20 {
            let (Partitioned { all, partition, .. }, placement) = &partitioned(seed);
            for ranks in 1..5 {
                let owners = assign(all, partition, placement, ranks);
                assert_eq!(owners.len(), partition.cores());
                assert!(owners.iter().all(|&owner| owner < ranks));
                let load = |core: CoreId| {
                    partition.usage()[core].synapses + COMPARTMENT * partition.members()[core].len() as u64
                };
                let mut sums = vec![0; ranks as usize];
                owners.enumerate().for_each(|(core, &owner)| sums[owner as usize] += load(core));
                let largest = partition.members().ids().map(load).max().unwrap();
                let mean = sums.iter().sum::<u64>() / u64::from(ranks);
                assert!(*sums.iter().max().unwrap() <= mean * 11 / 10 + largest + 1, "{sums:?} {largest}");
                tried += usize::from(partition.cores() > 4);
            }
        }
        assert!(tried > 20);
    }

    #[test]
    fn units_go_where_most_of_their_traffic_is() {
        let cores: Vec<Vec<CoreId>> = (0..4).map(|core| vec![CoreId(core)]).collect();
        let mut units = Units::new(cores, &[1, 1, 1, 1], 2);
        units.loads = vec![0; 4];
        assert_eq!(units.ranks_of, [0, 0, 1, 1]);
        // 0 with 2, 1 with 3.
        let mut traffic = vec![0; 16];
        (traffic[2], traffic[4 + 3]) = (5, 7);
        units.refine(&traffic);
        assert_eq!((units.ranks_of[0], units.ranks_of[1]), (units.ranks_of[2], units.ranks_of[3]));
    }
}
