//! Groups of cores that exchange messages only among themselves, by kinds of identical groups.
//!
//! Input: a program, and the cores of each group. Output: a program of the first group of each
//! kind, and the place of every group. Groups of a kind have the same compartments of their copies
//! in the same slots, and differ only in their places. So their counts are equal when all copies
//! receive the same sample. Invariants of [`CoreGroups`]: each core of the whole program is in one
//! group, and the groups of a kind have equal numbers of cores.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use crate::base::csr::Csr;
use crate::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::partition::Seat;
use crate::placement::Site;
use crate::program::{AxonTarget, Compartments, CoreImage, Graded, NotClosed, Parts, Program};
use crate::ranks::RankAssignment;

/// The parts of a program that belong to a group of one kind.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kind {
    /// Its cores.
    pub cores: Range<u32>,
    /// Its input channels.
    pub channels: Range<u32>,
    /// Its compartments.
    pub compartments: Range<u32>,
    /// Number of copies of the network.
    pub copies: u32,
}

/// A group, and its place on the board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Index of its kind.
    pub kind: usize,
    /// Its cores in the whole program, in the order of the kind's cores.
    pub cores: Vec<CoreId>,
    /// The physical cores of `cores`.
    pub sites: Vec<Site>,
}

/// Sizes of a network of which a program has copies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CopySizes {
    /// Number of compartments.
    pub compartments: u32,
    /// Number of input channels.
    pub channels: u32,
    /// Number of populations, inputs included.
    pub populations: u32,
}

/// A program of one group of each kind, and all groups.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CoreGroups {
    /// The program of the first group of each kind, in the order of `kinds`.
    pub program: Arc<Program>,
    /// The parts of the program that belong to each kind.
    pub kinds: Vec<Kind>,
    /// All groups, in the order of their first cores.
    pub groups: Vec<Group>,
}

/// Cores and copies of a group, ascending.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GroupMembers {
    /// The cores.
    pub cores: Vec<CoreId>,
    /// The copies whose compartments are all on these cores.
    pub copies: Vec<u32>,
}

/// For each group, the index of the first identical group.
fn first_identical(program: &Program, one: CopySizes, together: &[GroupMembers]) -> Vec<usize> {
    let mut known = HashMap::new();
    let key = |group: &GroupMembers| -> Vec<Vec<(usize, u32)>> {
        let member = |id: &CompartmentId| {
            let copy = group.copies.binary_search(&(id.0 / one.compartments)).unwrap_or(usize::MAX);
            (copy, id.0 % one.compartments)
        };
        group.cores.iter().map(|&core| program.cores()[core].ids.iter().map(member).collect()).collect()
    };
    together.iter().enumerate().map(|(number, group)| *known.entry(key(group)).or_insert(number)).collect()
}

impl CoreGroups {
    /// Groups of a program of copies, which share no channel; identical groups are of one kind.
    ///
    /// # Errors
    /// [`NotClosed`] when a group sends messages to another.
    pub fn new(program: &Program, one: CopySizes, together: &[GroupMembers]) -> Result<Self, NotClosed> {
        CoreGroups::from_first_identical(program, one, together, &first_identical(program, one, together))
    }

    /// Groups of a program of copies, each of its own kind.
    ///
    /// # Errors
    /// As [`CoreGroups::new`].
    pub fn each(program: &Program, one: CopySizes, together: &[GroupMembers]) -> Result<Self, NotClosed> {
        CoreGroups::from_first_identical(program, one, together, &(0..together.len()).collect::<Vec<_>>())
    }

    fn from_first_identical(
        program: &Program,
        one: CopySizes,
        together: &[GroupMembers],
        first_identical: &[usize],
    ) -> Result<Self, NotClosed> {
        let whole = program.parts();
        let firsts: Vec<usize> =
            (0..first_identical.len()).filter(|&number| first_identical[number] == number).collect();
        let selected_copies: Vec<u32> =
            firsts.iter().flat_map(|&first| together[first].copies.iter().copied()).collect();
        let mut new_core = vec![None; whole.cores.len()];
        let selected_cores = firsts.iter().flat_map(|&first| &together[first].cores);
        for (number, core) in selected_cores.clone().enumerate() {
            new_core[core.index()] = Some(CoreId::new(number));
        }
        let new_copy: HashMap<u32, u32> = selected_copies.iter().copied().zip(0..).collect();
        let closed = || NotClosed("a group of cores sends messages to another".to_string());
        let core = |core: CoreId| new_core[core.index()].ok_or_else(closed);
        let target = |to: &AxonTarget| Ok(AxonTarget { core: core(to.core)?, ..*to });
        let compartment = |id: CompartmentId| {
            let copy = new_copy.get(&(id.0 / one.compartments)).ok_or_else(closed)?;
            Ok::<_, NotClosed>(CompartmentId(copy * one.compartments + id.0 % one.compartments))
        };
        let (mut cores, mut classes) = (Vec::new(), IdVec::new());
        let mut new_class = HashMap::new();
        for &number in selected_cores.clone() {
            let mut image = whole.cores[number].clone();
            image.ids = Arc::new(image.ids.iter().map(|&id| compartment(id)).collect::<Result<_, _>>()?);
            let axons_out = image.axons_out.renumbered(core)?;
            let old = image.class;
            let class = *new_class.entry(old).or_insert_with(|| classes.push(whole.classes[old].clone()));
            cores.push(CoreImage { axons_out, class, ..image });
        }
        let (mut channels, mut seats, mut populations) = (Csr::default(), Vec::new(), Vec::new());
        for (number, &copy) in (0u32..).zip(&selected_copies) {
            for channel in copy * one.channels..(copy + 1) * one.channels {
                let list = whole.channels.get(channel as usize).iter();
                channels.push(list.map(target).collect::<Result<Vec<_>, NotClosed>>()?);
            }
            for id in copy * one.compartments..(copy + 1) * one.compartments {
                let seat = whole.seats[CompartmentId(id)];
                seats.push(Seat { core: core(seat.core)?, ..seat });
            }
            for id in copy * one.populations..(copy + 1) * one.populations {
                let moved = |of_copy: Compartments| {
                    let first = number * one.compartments + of_copy.first.0 % one.compartments;
                    Compartments { first: CompartmentId(first), ..of_copy }
                };
                populations.push(whole.populations[PopulationId(id)].map(moved));
            }
        }
        let graded = graded_of(whole, one, &selected_copies);
        let parts = Parts {
            classes,
            cores: cores.into(),
            channels,
            seats: Arc::new(seats.into()),
            populations: populations.into(),
            graded,
            assignment: whole.assignment.as_ref().map(|assignment| {
                let owners: Vec<u32> = selected_cores.clone().map(|&core| assignment.owners[core]).collect();
                RankAssignment { owners: IdVec::from(owners).into(), ..assignment.clone() }
            }),
            ..*whole
        };
        let mut kinds: Vec<Kind> = Vec::new();
        for &first in &firsts {
            let GroupMembers { cores, copies } = &together[first];
            let last = kinds.last();
            let begin = |get: fn(&Kind) -> &Range<u32>| last.map_or(0, |kind| get(kind).end);
            let next = |begin: u32, many: usize| begin..begin + many as u32;
            kinds.push(Kind {
                cores: next(begin(|kind| &kind.cores), cores.len()),
                channels: next(begin(|kind| &kind.channels), copies.len() * one.channels as usize),
                compartments: next(begin(|kind| &kind.compartments), copies.len() * one.compartments as usize),
                copies: copies.len() as u32,
            });
        }
        let group = |(group, &first): (&GroupMembers, &usize)| Group {
            kind: firsts.binary_search(&first).expect("each group is like one that comes first"),
            sites: group.cores.iter().map(|&core| whole.cores[core].site).collect(),
            cores: group.cores.clone(),
        };
        let groups = together.iter().zip(first_identical).map(group).collect();
        Ok(CoreGroups { program: Program::new(parts)?.into(), kinds, groups })
    }

    /// Number of copies of the network in the program.
    pub fn copies(&self) -> u32 {
        self.kinds.iter().map(|kind| kind.copies).sum()
    }
}

/// Payloads of the sources of these copies, renumbered.
fn graded_of(whole: &Parts, one: CopySizes, copies: &[u32]) -> Vec<Graded> {
    let mut graded = Vec::new();
    let mut of_range = |from: Range<u32>, to: u32| {
        let later = whole.graded.partition_point(|part| part.sources.end <= from.start);
        for part in whole.graded[later..].iter().take_while(|part| part.sources.start < from.end) {
            let (start, end) = (part.sources.start.max(from.start), part.sources.end.min(from.end));
            graded.push(Graded { sources: to + start - from.start..to + end - from.start, message: part.message });
        }
    };
    for (number, &copy) in (0u32..).zip(copies) {
        of_range(copy * one.channels..(copy + 1) * one.channels, number * one.channels);
    }
    let (before, kept) = (whole.channels.len() as u32, copies.len() as u32 * one.channels);
    for (number, &copy) in (0u32..).zip(copies) {
        let from = before + copy * one.compartments;
        of_range(from..from + one.compartments, kept + number * one.compartments);
    }
    graded
}
