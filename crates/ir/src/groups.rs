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
use crate::base::id::{ClassId, CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::partition::Seat;
use crate::placement::Site;
use crate::program::{
    AxonTarget, Compartments, CoreClass, CoreImage, Graded, NotClosed, Parts, PlasticProjection, Program,
    ProgramLearning,
};
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
    let index = |(number, group): (usize, &GroupMembers)| {
        let member = |id: &CompartmentId| {
            let copy = group.copies.binary_search(&(id.0 / one.compartments)).unwrap_or(usize::MAX);
            (copy, id.0 % one.compartments)
        };
        let ids_of = |&core: &CoreId| program.cores()[core].ids.iter().map(member).collect();
        *known.entry(group.cores.iter().map(ids_of).collect::<Vec<Vec<_>>>()).or_insert(number)
    };
    together.iter().enumerate().map(index).collect()
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
        let selected: Vec<&GroupMembers> = firsts.iter().map(|&first| &together[first]).collect();
        let group = |(group, &first): (&GroupMembers, &usize)| Group {
            kind: firsts.binary_search(&first).expect("each group is like one that comes first"),
            sites: group.cores.iter().map(|&core| whole.cores[core].site).collect(),
            cores: group.cores.clone(),
        };
        Ok(CoreGroups {
            program: Program::new(Selection::new(whole, one, &selected).parts()?)?.into(),
            kinds: consecutive_kinds(one, &selected),
            groups: together.iter().zip(first_identical).map(group).collect(),
        })
    }

    /// Number of copies of the network in the program.
    pub fn copies(&self) -> u32 {
        self.kinds.iter().map(|kind| kind.copies).sum()
    }
}

/// Kinds of groups whose parts are numbered consecutively.
fn consecutive_kinds(one: CopySizes, groups: &[&GroupMembers]) -> Vec<Kind> {
    let mut kinds: Vec<Kind> = Vec::new();
    for GroupMembers { cores, copies } in groups {
        let copies = copies.len() as u32;
        let ends = kinds.last().map_or([0; 3], |last| [last.cores.end, last.channels.end, last.compartments.end]);
        kinds.push(Kind {
            cores: ends[0]..ends[0] + cores.len() as u32,
            channels: ends[1]..ends[1] + copies * one.channels,
            compartments: ends[2]..ends[2] + copies * one.compartments,
            copies,
        });
    }
    kinds
}

/// Groups of a program, as a program of their own.
struct Selection<'p> {
    whole: &'p Parts,
    one: CopySizes,
    cores: Vec<CoreId>,
    copies: Vec<u32>,
    new_core: Vec<Option<CoreId>>,
    new_copy: HashMap<u32, u32>,
}

impl<'p> Selection<'p> {
    fn new(whole: &'p Parts, one: CopySizes, groups: &[&GroupMembers]) -> Self {
        let cores: Vec<CoreId> = groups.iter().flat_map(|group| group.cores.iter().copied()).collect();
        let copies: Vec<u32> = groups.iter().flat_map(|group| group.copies.iter().copied()).collect();
        let mut new_core = vec![None; whole.cores.len()];
        for (number, core) in cores.iter().enumerate() {
            new_core[core.index()] = Some(CoreId::new(number));
        }
        let new_copy = copies.iter().copied().zip(0..).collect();
        Selection { whole, one, cores, copies, new_core, new_copy }
    }

    fn core(&self, core: CoreId) -> Result<CoreId, NotClosed> {
        self.new_core[core.index()].ok_or_else(not_closed)
    }

    fn compartment(&self, id: CompartmentId) -> Result<CompartmentId, NotClosed> {
        let copy = self.new_copy.get(&(id.0 / self.one.compartments)).ok_or_else(not_closed)?;
        Ok(CompartmentId(copy * self.one.compartments + id.0 % self.one.compartments))
    }

    fn parts(&self) -> Result<Parts, NotClosed> {
        let mut classes = IdVec::new();
        let cores = self.cores(&mut classes)?;
        let Selection { whole, one, .. } = *self;
        let (mut channels, mut seats, mut populations) = (Csr::default(), Vec::new(), Vec::new());
        for (number, &copy) in (0u32..).zip(&self.copies) {
            for channel in copy * one.channels..(copy + 1) * one.channels {
                let list = whole.channels.get(channel as usize).iter();
                let target = |to: &AxonTarget| Ok(AxonTarget { core: self.core(to.core)?, ..*to });
                channels.push(list.map(target).collect::<Result<Vec<_>, NotClosed>>()?);
            }
            for id in copy * one.compartments..(copy + 1) * one.compartments {
                let seat = whole.seats[CompartmentId(id)];
                seats.push(Seat { core: self.core(seat.core)?, ..seat });
            }
            for id in copy * one.populations..(copy + 1) * one.populations {
                populations.push(whole.populations[PopulationId(id)].map(|of_copy| {
                    let first = number * one.compartments + of_copy.first.0 % one.compartments;
                    Compartments { first: CompartmentId(first), ..of_copy }
                }));
            }
        }
        Ok(Parts {
            classes,
            cores,
            channels,
            seats: Arc::new(seats.into()),
            populations: populations.into(),
            graded: graded_of(whole, one, &self.copies),
            learning: self.learning(),
            assignment: whole.assignment.as_ref().map(|assignment| {
                let owners: Vec<u32> = self.cores.iter().map(|&core| assignment.owners[core]).collect();
                RankAssignment { owners: IdVec::from(owners).into(), ..assignment.clone() }
            }),
            ..*whole
        })
    }

    /// The plastic projections of its copies.
    fn learning(&self) -> ProgramLearning {
        let Selection { whole, one, .. } = *self;
        let (channels, kept) = (whole.channels.len() as u32, one.channels * self.copies.len() as u32);
        let of_channel = |channel: u32, number: u32| number * one.channels + channel % one.channels;
        let of_compartment = |id: u32, number: u32| number * one.compartments + id % one.compartments;
        let mut projections = Vec::new();
        for projection in &whole.learning.projections {
            let Some(&number) = self.new_copy.get(&(projection.targets.start / one.compartments)) else { continue };
            fn shifted(range: &Range<u32>, first: u32) -> Range<u32> {
                first..first + (range.end - range.start)
            }
            let of_source = |source: u32| match source.checked_sub(channels) {
                None => of_channel(source, number),
                Some(compartment) => kept + of_compartment(compartment, number),
            };
            projections.push(PlasticProjection {
                sources: shifted(&projection.sources, of_source(projection.sources.start)),
                targets: shifted(&projection.targets, of_compartment(projection.targets.start, number)),
                signals: projection
                    .signals
                    .clone()
                    .map(|signal| signal.map(|signal| shifted(&signal, of_channel(signal.start, number)))),
                reward: projection.reward.as_ref().map(|reward| shifted(reward, of_source(reward.start))),
                ..projection.clone()
            });
        }
        ProgramLearning { rules: whole.learning.rules.clone(), projections }
    }

    /// Its cores; adds their classes.
    fn cores(&self, classes: &mut IdVec<ClassId, CoreClass>) -> Result<IdVec<CoreId, CoreImage>, NotClosed> {
        let (mut cores, mut new_class) = (Vec::new(), HashMap::new());
        for &number in &self.cores {
            let mut image = self.whole.cores[number].clone();
            image.ids = Arc::new(image.ids.iter().map(|&id| self.compartment(id)).collect::<Result<_, _>>()?);
            let axons_out = image.axons_out.renumbered(|core| self.core(core))?;
            let old = image.class;
            let class = *new_class.entry(old).or_insert_with(|| classes.push(self.whole.classes[old].clone()));
            cores.push(CoreImage { axons_out, class, ..image });
        }
        Ok(cores.into())
    }
}

fn not_closed() -> NotClosed {
    NotClosed("a group of cores sends messages to another".to_string())
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
    let (before, new_channels) = (whole.channels.len() as u32, copies.len() as u32 * one.channels);
    for (number, &copy) in (0u32..).zip(copies) {
        let from = before + copy * one.compartments;
        of_range(from..from + one.compartments, new_channels + number * one.compartments);
    }
    graded
}
