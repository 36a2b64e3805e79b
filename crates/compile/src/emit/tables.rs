//! Tables of cores: formats, lists of synapses, input axons.
//!
//! Input: a network, its partition and the classes of its cores. Output: the [`CoreClass`] of each,
//! and the source of each input axon of its first core. A core that only windows reach is written
//! from their kernels; all others from the synapses of the sources that reach them.

use crate::emit::classes::CoreClasses;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ClassId, CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::partition::Partition;
use nsim_ir::program::{Compartment, CoreClass, CoreFormat, InputAxon, InputTable, PopulationAxon, Synapse};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::resource::Limits;
use nsim_partition::resources::axon_sharing::{EqualPlace, Places};
use nsim_partition::resources::exact::{StoredLists, group_of, longest_delays};
use nsim_partition::resources::formats::Formats;
use nsim_partition::resources::packing::{Compression, Group, Widths, stored};
use nsim_partition::resources::sorted_synapses::{self, Key, by_core};
use rayon::prelude::*;

/// Common input of the tables of every core.
pub(super) struct Tables<'a> {
    network: &'a Quantised,
    partition: &'a Partition,
    limits: &'a Limits,
    formats: Formats,
    places: Places,
}

/// Tables of a core, and the source of each of its input axons.
type Table = (CoreClass, Vec<u32>);

impl<'a> Tables<'a> {
    pub(super) fn new(network: &'a Quantised, partition: &'a Partition, limits: &'a Limits) -> Self {
        let (formats, places) = (Formats::for_network(network), Places::for_network(network, limits));
        Tables { network, partition, limits, formats, places }
    }

    /// Tables of the first core of each class; parameters alone for cores that are not held.
    pub(super) fn of_classes(
        &self,
        found: &CoreClasses<'_>,
        holds: impl Fn(CoreId) -> bool + Sync,
    ) -> Result<Vec<Table>, String> {
        let (network, members) = (self.network, |core: CoreId| &self.partition.members()[core]);
        let firsts = &found.classes.firsts;
        let written = |&core: &CoreId| match holds(core) {
            true => found.keys(core, members(core), &self.formats).map(|(keys, delay)| self.class(core, &keys, delay)),
            false => Some(Ok((CoreClass::without_tables(parameters(network, members(core))), Vec::new()))),
        };
        let mut written: Vec<Option<Result<Table, String>>> = firsts.as_slice().par_iter().map(written).collect();
        let left: Vec<ClassId> = firsts.ids().filter(|class| written[class.index()].is_none()).collect();
        if !left.is_empty() {
            let mut is_left: IdVec<CoreId, bool> = vec![false; self.partition.cores()].into();
            let mut reached: IdVec<PopulationId, bool> = vec![false; network.populations().len()].into();
            for &class in &left {
                is_left[firsts[class]] = true;
                members(firsts[class]).iter().for_each(|&id| reached[network.population_of(id).0] = true);
            }
            let counts = |id| network.targets_of(id).any(|(_, projection, _)| reached[projection.target]);
            let (seats, cores) = (self.partition.seats(), self.partition.cores());
            let longest = longest_delays(network, seats, cores, counts);
            let wanted = |core: CoreId| is_left[core];
            let mut others = by_core(network, &self.formats, seats, cores, counts, wanted, |core, keys| {
                is_left[core].then(|| self.class(core, keys, longest[core]))
            });
            left.iter().for_each(|&class| written[class.index()] = others[firsts[class].index()].take());
        }
        written.into_iter().flatten().collect()
    }

    /// Tables of a core with these synapses.
    fn class(&self, core: CoreId, keys: &[Key], longest: Delay) -> Result<Table, String> {
        let held = &self.partition.members()[core];
        let widths = Widths::for_core(held.len() as u32, longest, self.limits.packing);
        let lists = StoredLists::new(keys, &self.formats, widths, self.limits, &self.places);
        let (formats, inputs, sources) = write_lists(keys, &self.formats, widths, &lists, self.limits)
            .ok_or_else(|| format!("{core} has too many input axons or synapse formats"))?;
        Ok((CoreClass { compartments: parameters(self.network, held), formats, inputs }, sources))
    }
}

/// Parameters of compartments in slot order.
fn parameters(network: &Quantised, held: &[CompartmentId]) -> Vec<Compartment> {
    let mut known = None;
    held.iter()
        .filter_map(|&id| {
            // Consecutive compartments mostly belong to one population.
            let inside = |population: &PopulationId| {
                let population = &network.populations()[*population];
                population
                    .first_compartment()
                    .is_some_and(|first| id.0.checked_sub(first.0).is_some_and(|index| index < population.shape.len()))
            };
            let population = known.filter(inside).unwrap_or_else(|| network.population_of(id).0);
            known = Some(population);
            let Units::Compartments { first, neurons, start_step } = &network.populations()[population].units else {
                return None;
            };
            Some(Compartment { neuron: neurons.get(id.0 - first.0), start_step: *start_step })
        })
        .collect()
}

/// The formats of a core, its input axons with their lists, and the source of each input axon.
type Written = (Vec<CoreFormat>, InputTable, Vec<u32>);

/// Writes the lists of a core's image.
struct Writer<'a> {
    formats: &'a Formats,
    widths: Widths,
    limits: &'a Limits,
    runs: bool,
    known: Vec<CoreFormat>,
    /// The last group's make-up and the number of its format.
    last: Option<((u16, Group), u8)>,
    lists: Csr<Synapse>,
}

impl Writer<'_> {
    /// Number of the format of a group of this make-up; a new one where the core has none.
    fn number(&mut self, format: u16, group: Group) -> Option<u8> {
        if let Some((_, number)) = self.last.filter(|(last, _)| *last == (format, group)) {
            return Some(number);
        }
        let [_, (compression, _)] = stored(group, self.widths, self.limits);
        let stored = CoreFormat {
            synapse: self.formats.get(format),
            delay_bits: if group.delayed { self.widths.delay } else { 0 },
            index_bits: (!group.dense).then_some(self.widths.index),
            skip_bits: match compression {
                Compression::RunLength(bits) if self.runs => Some(bits),
                _ => None,
            },
        };
        let number = self.known.iter().position(|&known| known == stored).unwrap_or_else(|| {
            self.known.push(stored);
            self.known.len() - 1
        });
        let number = u8::try_from(number).ok()?;
        self.last = Some(((format, group), number));
        Some(number)
    }

    /// Writes a list, with slots relative to a base.
    fn list(&mut self, list: &[Key], base: u16) -> Option<()> {
        for keys in sorted_synapses::groups(list) {
            let (format, group) = group_of(keys, self.formats);
            let number = self.number(format, group)?;
            for key in keys {
                let delay = Delay::new(key.delay().into()).ok()?;
                let synapse = Synapse { slot: key.slot() - base, weight: key.weight(), format: number, delay };
                self.lists.extend_last([synapse]);
            }
        }
        self.lists.end();
        Some(())
    }
}

/// Tables of a core's synapses; `None` when it has more input axons or formats than can be
/// numbered.
fn write_lists(
    keys: &[Key],
    formats: &Formats,
    widths: Widths,
    stored: &StoredLists,
    limits: &Limits,
) -> Option<Written> {
    let (runs, lists) = (stored.stores_runs(limits), Csr::with_capacity(0, keys.len()));
    let mut writer = Writer { formats, widths, limits, runs, known: Vec::new(), last: None, lists };
    let shared: Vec<_> = stored.shared(limits).filter(|&(_, places)| places > 0).collect();
    let sources: Vec<u32> = sorted_synapses::lists(keys).map(|list| list[0].source()).collect();
    u16::try_from(sources.len().saturating_sub(1)).ok()?;
    if shared.is_empty() {
        sorted_synapses::lists(keys).try_for_each(|list| writer.list(list, 0))?;
        writer.lists.shrink_to_fit();
        return Some((writer.known, InputTable::discrete(writer.lists), sources));
    }
    let all: Vec<&[Key]> = sorted_synapses::lists(keys).collect();
    let (mut populations, mut members) = (Vec::new(), vec![None; all.len()]);
    for (equal_places, places) in shared {
        let (first, table) = (&equal_places[0], writer.lists.len() as u32);
        let atoms = first.atoms();
        let mut of_atoms = first.lists.iter().peekable();
        for atom in 0..atoms {
            match of_atoms.next_if(|(of, _)| *of == atom) {
                Some((_, number)) => writer.list(all[*number as usize], first.base)?,
                None => writer.lists.end(),
            }
        }
        for EqualPlace { base, lists, .. } in &equal_places[..places as usize] {
            let axon = u16::try_from(populations.len()).ok()?;
            populations.push(PopulationAxon { table, atoms, base: *base });
            lists.iter().for_each(|&(atom, number)| members[number as usize] = Some(InputAxon::Member { axon, atom }));
        }
    }
    let mut axons = Vec::with_capacity(all.len());
    for (list, member) in all.into_iter().zip(members) {
        axons.push(member.unwrap_or(InputAxon::Discrete { list: writer.lists.len() as u32 }));
        if member.is_none() {
            writer.list(list, 0)?;
        }
    }
    writer.lists.shrink_to_fit();
    Some((writer.known, InputTable::with_populations(writer.lists, populations, axons), sources))
}
