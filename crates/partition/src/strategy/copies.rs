//! Equal copies of a network on cores, from the smallest number of copies that repeats.
//!
//! Input: one copy, their number, a target. Output: [`CopyGroups`]: copies that share cores within
//! a group, and with no other group. The use of a group's cores depends on the group, and on its
//! position if it crosses from one chip to the next. Each such case is counted once.
//!
//! Filling cores in the order of the file looks only at the core being filled and at the next
//! segment. So where two cores begin at the same place of a copy, the cores after the second repeat
//! the cores after the first. If that place is the beginning, the cores up to there are a group,
//! and the remaining copies are another. Otherwise only the number of cores is known.

use std::collections::HashMap;

use crate::resources::exact::{Usages, usage};
use crate::strategy::members::Members;
use crate::strategy::order::{Filler, file_order};
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::hardware::Target;
use nsim_ir::partition::seats;
use nsim_ir::quantised::Quantised;
use nsim_quantise::copies::copies;

/// Copies of the first attempt to find a repetition, and factor to the next attempt.
const FIRST: u32 = 8;
const MORE: u32 = 4;

/// Copies that share cores with each other and with no others.
#[derive(Debug, Clone)]
struct Group {
    network: Quantised,
    members: Members,
    /// Number of times that it is repeated.
    times: u32,
}

/// All copies, as consecutive groups.
#[derive(Debug, Clone)]
pub struct CopyGroups(Vec<Group>);

/// The result of filling cores with copies.
#[derive(Debug, Clone)]
pub struct Filled {
    /// Number of cores.
    pub cores: usize,
    /// Their groups; `None` where cores repeat but not copy by copy.
    pub groups: Option<CopyGroups>,
}

/// The first two cores that begin at the same place of a copy.
fn repeated(starts: &[u32], of_copy: u32) -> Option<(usize, usize)> {
    let mut known: HashMap<u32, usize> = HashMap::new();
    starts.iter().enumerate().find_map(|(core, start)| Some((known.insert(start % of_copy, core)?, core)))
}

impl CopyGroups {
    /// Repeats one copy's cores for each of `copies` copies.
    pub fn repeated(one: &Quantised, members: Members, copies: u32) -> Self {
        CopyGroups(vec![Group { network: one.clone(), members, times: copies }])
    }

    /// Fills cores with copies in the order of the file, regardless of the fan-out; `None` when a
    /// compartment fits no core.
    pub fn filled(one: &Quantised, all: u32, target: &Target, keep_whole: bool) -> Option<Filled> {
        let fill = |many: u32| {
            let network = copies(one, many).ok()?;
            let members = Filler::new(&network, target).fill_members(&file_order(&network), keep_whole).ok()?;
            let mut ids = members.iter().flatten().enumerate();
            ids.all(|(at, id)| at == id.index()).then_some((network, members))
        };
        let mut many = FIRST.min(all);
        loop {
            let (network, members) = fill(many)?;
            let starts: Vec<u32> = members.iter().filter_map(|held| held.first()).map(|id| id.0).collect();
            let Some((first, second)) = repeated(&starts, one.compartments()) else {
                if many == all {
                    let (cores, groups) = (members.len(), CopyGroups(vec![Group { network, members, times: 1 }]));
                    return Some(Filled { cores, groups: Some(groups) });
                }
                many = many.saturating_mul(MORE).min(all);
                continue;
            };
            // From `second` on, the cores from `first` to `second` are repeated.
            let (begin, cycle) = (u64::from(starts[first]), u64::from(starts[second] - starts[first]));
            let behind = u64::from(one.compartments()) * u64::from(all) - begin;
            let last = starts[first..second].iter().filter(|&&start| u64::from(start) - begin < behind % cycle).count();
            let cores = first + (behind / cycle) as usize * (second - first) + last;
            // The first core begins with the first compartment.
            if first > 0 {
                return Some(Filled { cores, groups: None });
            }
            let together = starts[second] / one.compartments();
            let members = members.iter().take(second).cloned().collect();
            let mut groups = vec![Group { network: copies(one, together).ok()?, members, times: all / together }];
            if !all.is_multiple_of(together) {
                let (network, members) = fill(all % together)?;
                groups.push(Group { network, members, times: 1 });
            }
            return Some(Filled { cores, groups: Some(CopyGroups(groups)) });
        }
    }

    /// Number of cores.
    pub fn cores(&self) -> usize {
        self.0.iter().map(|group| group.members.len() * group.times as usize).sum()
    }

    /// The compartments of each core.
    pub fn members(&self) -> Members {
        let (mut all, mut first) = (Vec::with_capacity(self.cores()), 0);
        for Group { network, members, times } in &self.0 {
            for _ in 0..*times {
                let shifted = |held: &Vec<CompartmentId>| held.iter().map(|id| CompartmentId(first + id.0)).collect();
                all.extend(members.iter().map(shifted));
                first += network.compartments();
            }
        }
        all.into()
    }

    /// Resource use of each core when cores are placed chip by chip; `None` when a group is no
    /// partition of its copies.
    pub fn usage(&self, target: &Target) -> Option<Usages> {
        let of_chip = target.chip().cores;
        let (mut all, mut first) = (Vec::with_capacity(self.cores()), 0);
        for Group { network, members, times } in &self.0 {
            let seats = seats(network.compartments(), members).ok()?;
            let size = members.len() as u32;
            let mut known: HashMap<u32, Usages> = HashMap::new();
            for _ in 0..*times {
                let on_chip = first % of_chip;
                let crosses = on_chip + size > of_chip;
                let on_chip = if crosses { on_chip } else { 0 };
                let used = known.entry(on_chip).or_insert_with(|| {
                    let chips = (on_chip..on_chip + size).map(|core| core / of_chip).collect();
                    usage(network, members, &seats, &chips, target.limits())
                });
                all.extend(used.iter().copied());
                first += size;
            }
        }
        Some(all.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::strategy::members::row_of_chips;
    use nsim_ir::base::rng;
    use nsim_ir::resource::Resource;
    use nsim_testing::{limits, random_network, slip, target};

    /// Limits at which several copies share a core, and copies are split over cores.
    fn tight(seed: u64) -> Target {
        let compartments = 20 + rng::below(60, seed, 1, 1) as u32;
        target(2, 2, limits().with(Resource::Compartments, compartments))
    }

    #[test]
    fn groups_of_copies_are_what_filling_all_copies_gives() {
        let mut several = 0;
        for seed in 0..16 {
            let (one, target) = (random_network(seed), tight(seed));
            for (many, keep_whole) in [(2, true), (7, false), (61, true), (61, false)] {
                let all = copies(&one, many).unwrap();
                let filler = Filler::new(&all, &target);
                let Ok(plain) = filler.fill_members(&file_order(&all), keep_whole) else { continue };
                let filled = CopyGroups::filled(&one, many, &target, keep_whole).unwrap();
                assert_eq!(filled.cores, plain.len(), "seed {seed}, {many} copies");
                let Some(groups) = filled.groups else { continue };
                assert_eq!(groups.members(), plain, "seed {seed}, {many} copies");
                let seats = seats(all.compartments(), &plain).unwrap();
                let used = usage(&all, &plain, &seats, &row_of_chips(plain.len(), &target), target.limits());
                assert_eq!(groups.usage(&target).unwrap(), used, "seed {seed}, {many} copies");
                several += u32::from(groups.0.iter().any(|group| group.times > 1));
            }
        }
        assert!(several > 5, "groups that repeat: {several}");
    }

    #[test]
    fn a_thousand_copies_are_counted_once() {
        let (one, target) = (slip(3150), target(4, 4, limits()));
        // A core that holds a copy has room for the first population of the next, so cores begin at
        // the second.
        let filled = CopyGroups::filled(&one, 1024, &target, false).unwrap();
        assert!(filled.cores >= 1024 && filled.groups.is_none());
        let alone = Filler::new(&one, &target).fill_members(&file_order(&one), true).unwrap();
        let groups = CopyGroups::repeated(&one, alone, 1024);
        let used = groups.usage(&target).unwrap();
        assert_eq!((groups.cores(), used.len()), (1024, 1024));
        assert!(used.iter().all(|one| *one == used.as_slice()[0]));
    }
}
