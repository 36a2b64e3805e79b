//! Rules for the resource use of a core, common to all counters.
//!
//! Input: [`CoreTotals`], the counts of a core. Output: its [`CoreUsage`]. Three counters make the
//! totals; tests compare them on random networks:
//!
//! | counter | counts | for |
//! |---|---|---|
//! | [`exact`](super::exact) | the synapses of each core of a partition | usage of a partition |
//! | [`incremental`](super::incremental) | compartments, one by one | filling a core |
//! | [`closed_form`](super::closed_form) | products of receptive fields | boxes of a layer |
//!
//! The rules:
//!
//! - input axons: distinct sources with a synapse on the core, the members of a population axon as
//!   one ([`axon_sharing`]), a source with a plastic synapse as two;
//! - output axons: one for each compartment and destination core, in slots
//!   ([`Limits::axon_out_slots`]);
//! - words: as [`packing`] counts them. A core stores its lists with runs where that takes fewer
//!   words and its formats suffice, else without, so both are counted ([`LISTS`]). A table of
//!   population axons is stored once;
//! - formats: distinct (synapse format, delayed or not, compression), because widths are the same
//!   for all groups of a core;
//! - words of rules and trace configurations: [`Formats::of_rules`];
//! - compartment profiles: distinct (du, dv, refractory period); threshold profiles: distinct
//!   mantissas;
//! - accumulators: compartments times [`packing::delay_slots`] of the longest delay of a synapse
//!   into the core;
//! - stored synapses: as [`stored`](crate::resources::formats) counts them;
//! - neuron words, axon map words and groups; and, with [`Packing::Kernels`], input axons and
//!   synapse words: as [`formats`](crate::resources::formats) counts them.
//!
//! [`Packing::Kernels`]: nsim_ir::resource::Packing::Kernels
//!
//! `nsim_check::verify` counts again from finished tables and shares none of this, packing
//! included.

use std::collections::BTreeSet;

use crate::resources::axon_sharing::{self, MOST_NUMBERED, PlaceClass};
use crate::resources::formats::{CoreWords, Formats};
use crate::resources::packing::{self, Compression, Group, LISTS, Widths, delay_slots};
use nsim_ir::base::fixed::{Decay, Delay, Refractory, ThresholdMantissa};
use nsim_ir::neurons::{ParameterRow, Stack};
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::Neuron;
use nsim_ir::resource::{Limits, PerResource, Resource};

/// Fewest bits of runs over these distances between slots; `None` if one is 0 or too long.
pub fn skip_bits_for(mut distances: impl Iterator<Item = u16>) -> Option<u8> {
    let widest = distances.try_fold(0, |widest: u16, distance| Some(widest.max(distance.checked_sub(1)?)))?;
    packing::skip_bits(widest)
}

/// Number of groups of a core by format, by whether they are delayed, and by compression.
#[derive(Debug, Clone, Default)]
pub struct FormatCounts {
    groups: Vec<[u32; 12]>,
    distinct: u32,
}

impl FormatCounts {
    /// Returns the counts of a core without groups, in a network with this number of formats.
    pub fn new(formats: usize) -> Self {
        FormatCounts { groups: vec![[0; 12]; formats], distinct: 0 }
    }

    fn count(&mut self, format: u16, delayed: bool, compression: Compression) -> &mut u32 {
        let kind = match compression {
            Compression::Dense => 0,
            Compression::RunLength(bits) => usize::from(bits) - 1,
            Compression::Sparse => 5,
        };
        &mut self.groups[usize::from(format)][usize::from(delayed) * 6 + kind]
    }

    /// Adds one group.
    #[inline]
    pub fn add(&mut self, format: u16, delayed: bool, compression: Compression) {
        let count = self.count(format, delayed, compression);
        *count += 1;
        if *count == 1 {
            self.distinct += 1;
        }
    }

    /// Removes one group.
    #[inline]
    pub fn remove(&mut self, format: u16, delayed: bool, compression: Compression) {
        let count = self.count(format, delayed, compression);
        *count -= 1;
        if *count == 0 {
            self.distinct -= 1;
        }
    }

    /// Writes the number of formats in use, and the size of their rules.
    pub fn write(&self, known: &Formats, lists: &mut ListTotals) {
        lists.formats = self.distinct;
        lists.rules = known.of_rules(|format| self.groups[usize::from(format)].iter().any(|&count| count > 0));
    }

    /// Clears the counts for another core.
    pub fn clear(&mut self) {
        self.groups.fill([0; 12]);
        self.distinct = 0;
    }
}

/// Resource use of the lists of a core, stored without runs or with runs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ListTotals {
    /// Input axons.
    pub axons: u64,
    /// Words of all lists.
    pub words: u64,
    /// Words of the longest list.
    pub longest: u32,
    /// Formats in use.
    pub formats: u32,
    /// Words of microcode and presynaptic trace configurations of their rules.
    pub rules: (u32, u32),
}

impl ListTotals {
    /// Stores the tables of these classes instead of a list for each of their sources; returns the
    /// number of places of each class that share its table. No place shares on a core with more
    /// sources than a program can number; it then has too many input axons.
    pub fn share(&mut self, classes: &[PlaceClass], limits: &Limits) -> Vec<u32> {
        if self.axons > MOST_NUMBERED {
            return vec![0; classes.len()];
        }
        let sharing = axon_sharing::sharing(classes, limits);
        for (class, &places) in classes.iter().zip(&sharing).filter(|(_, places)| **places > 0) {
            self.words = self.words.saturating_add_signed(-class.saving(places));
            self.axons -= u64::from(places) * u64::from(class.lists - 1);
            self.longest = self.longest.max(class.list_words.1);
        }
        sharing
    }
}

/// Words of a list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Words {
    /// As the list of a discrete axon.
    pub discrete: u32,
    /// In the table of a population axon.
    pub in_table: u32,
}

/// Counts lists, without and with runs.
#[derive(Debug)]
pub struct ListCounter<'a> {
    widths: Widths,
    limits: &'a Limits,
    totals: [ListTotals; LISTS],
    known: &'a Formats,
    formats: [FormatCounts; LISTS],
}

impl<'a> ListCounter<'a> {
    /// Returns the counter of a core without lists.
    pub fn new(known: &'a Formats, widths: Widths, limits: &'a Limits) -> Self {
        let formats = std::array::from_fn(|_| FormatCounts::new(known.len()));
        ListCounter { widths, limits, totals: Default::default(), known, formats }
    }

    /// Counts the format of a group; returns the words of the group.
    pub fn group(&mut self, format: u16, group: Group) -> [Words; LISTS] {
        let forms = packing::stored(group, self.widths, self.limits);
        for (formats, (compression, _)) in self.formats.iter_mut().zip(forms) {
            formats.add(format, group.delayed, compression);
        }
        forms.map(|(compression, discrete)| Words {
            discrete,
            in_table: packing::words_as(group, compression, true, self.widths, self.limits),
        })
    }

    /// Counts this number of lists, with these words each.
    pub fn lists(&mut self, lists: u64, words: [Words; LISTS]) {
        for (totals, words) in self.totals.iter_mut().zip(words) {
            totals.axons += lists;
            totals.words += lists * u64::from(words.discrete);
            totals.longest = totals.longest.max(words.discrete);
        }
    }

    /// Counts that this number of counted lists learn: traces of their sources take a second entry.
    pub fn learning(&mut self, lists: u64) {
        self.totals.iter_mut().for_each(|totals| totals.axons += lists);
    }

    /// Totals without runs and with runs.
    pub fn totals(&self) -> [ListTotals; LISTS] {
        let mut totals = self.totals;
        self.formats.iter().zip(&mut totals).for_each(|(counts, lists)| counts.write(self.known, lists));
        totals
    }
}

/// Counts of a core.
#[derive(Debug, Clone, Copy)]
pub struct CoreTotals {
    /// Compartments.
    pub compartments: u32,
    /// Synapses.
    pub synapses: u64,
    /// The longest delay of a synapse.
    pub longest_delay: Delay,
    /// Lists without runs and with runs.
    pub lists: [ListTotals; LISTS],
    /// Distinct compartment profiles.
    pub compartment_profiles: u32,
    /// Distinct thresholds.
    pub threshold_profiles: u32,
    /// Stored synapses ([`stored`](crate::resources::formats)), where they are limited.
    pub stored: u64,
    /// Words, where the limits count them.
    pub words: CoreWords,
}

impl CoreTotals {
    /// Returns the counts of a core with this number of compartments and this longest delay; all
    /// others are 0.
    pub fn new(compartments: u32, longest_delay: Delay) -> Self {
        CoreTotals {
            compartments,
            synapses: 0,
            longest_delay,
            lists: Default::default(),
            compartment_profiles: 0,
            threshold_profiles: 0,
            stored: 0,
            words: CoreWords::default(),
        }
    }

    /// Whether the core stores runs: where that takes fewer words and its formats suffice.
    pub fn stores_runs(&self, limits: &Limits) -> bool {
        let [plain, with_runs] = &self.lists;
        with_runs.words < plain.words && with_runs.formats <= limits[Resource::SynapseFormats]
    }

    /// Resource use of the core; 0 for output axons.
    #[inline]
    pub fn usage(&self, limits: &Limits) -> CoreUsage {
        let lists = self.lists[usize::from(self.stores_runs(limits))];
        let used = |resource| match resource {
            Resource::Compartments => u64::from(self.compartments),
            // A program numbers the sources of a core even where few words hold their synapses.
            Resource::AxonsIn if limits.counts_kernels() && lists.axons <= MOST_NUMBERED => self.words.axons_in,
            Resource::SynapseWords if limits.counts_kernels() => self.words.synapses,
            Resource::AxonsIn => lists.axons,
            // These depend on the cores of targets.
            Resource::AxonsOut | Resource::AxonsOutPerCompartment => 0,
            Resource::SynapseWords => lists.words,
            Resource::SynapseWordsPerAxon => u64::from(lists.longest),
            Resource::SynapseFormats => u64::from(lists.formats),
            Resource::CompartmentProfiles => u64::from(self.compartment_profiles),
            Resource::ThresholdProfiles => u64::from(self.threshold_profiles),
            Resource::Accumulators => u64::from(self.compartments) * u64::from(delay_slots(self.longest_delay)),
            Resource::StoredSynapses => self.stored,
            Resource::NeuronWords => self.words.neurons,
            Resource::AxonMapWords => self.words.axon_map,
            Resource::Groups => self.words.groups,
            Resource::RuleWords => u64::from(lists.rules.0),
            Resource::TraceConfigurations => u64::from(lists.rules.1),
        };
        CoreUsage { synapses: self.synapses, of: PerResource::from_fn(used) }
    }
}

/// The distinct profiles of a core's compartments.
#[derive(Debug, Clone, Default)]
pub struct Profiles {
    compartments: BTreeSet<(Decay, Decay, Refractory, Stack, ParameterRow)>,
    thresholds: BTreeSet<(ThresholdMantissa, ParameterRow)>,
}

impl Profiles {
    /// Adds the profiles of a compartment.
    pub fn insert(&mut self, neuron: &Neuron) {
        self.compartments.insert(neuron.profile());
        self.thresholds.insert(neuron.threshold());
    }

    /// Numbers of distinct compartment profiles and threshold profiles.
    pub fn counts(&self) -> (u32, u32) {
        (self.compartments.len() as u32, self.thresholds.len() as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::limits;

    #[test]
    fn sharing_leaves_one_table_for_its_places() {
        let class = PlaceClass { places: 60, lists: 512, atoms: 512, words: 1024, list_words: (2, 2) };
        let mut lists = ListTotals { axons: 40_000, words: 100_000, longest: 1, ..ListTotals::default() };
        assert_eq!(lists.share(&[class], &limits()), [60]);
        assert_eq!((lists.axons, lists.words, lists.longest), (40_000 - 60 * 511, 100_000 - 59 * 1024, 2));
        // A table that takes more words than it saves is not shared.
        let before = ListTotals { axons: 10, words: 100, longest: 2, ..ListTotals::default() };
        let mut lists = before;
        lists.share(&[PlaceClass { places: 1, words: 1023, ..class }], &limits());
        assert_eq!(lists, before);
        // A program numbers 65,536 sources of a core.
        let share = |axons| ListTotals { axons, ..before }.share(&[class], &limits());
        assert_eq!((share(65_536), share(65_537)), (vec![60], vec![0]));
    }

    #[test]
    fn formats_in_use_are_those_with_groups() {
        let mut counts = FormatCounts::new(2);
        counts.add(0, false, Compression::Dense);
        counts.add(0, false, Compression::Dense);
        counts.add(1, true, Compression::RunLength(5));
        counts.add(1, true, Compression::Sparse);
        assert_eq!(counts.distinct, 3);
        counts.remove(0, false, Compression::Dense);
        counts.remove(1, true, Compression::Sparse);
        assert_eq!(counts.distinct, 2);
    }
}
