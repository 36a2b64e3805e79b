//! A network and its samples as the words that a GPU reads, and the words of spikes that it gives back.
//!
//! Input: a network in integers; samples. Output: lists of 32-bit words in the layouts of `step.wgsl`. Errors: an
//! arithmetic other than the chip's, more synapses than are ever listed, a sample longer than its batch.

use crate::base::id::CompartmentId;
use crate::desc::network::Semantics;
use crate::desc::neurons::NeuronKind;
use crate::ir::quantised::{Quantised, Reset, Units};
use crate::ir::spikes::Sample;
use crate::neuron::fields;

/// Synapses above which no list is made: 768 MiB of them.
const MOST_SYNAPSES: u64 = 1 << 26;
/// Words of a compartment.
const COMPARTMENT_WORDS: usize = 12;
/// Samples of a word of spikes.
const WORD: usize = 32;

/// A network in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatchForm {
    /// Twelve words each.
    pub(super) compartments: Vec<u32>,
    /// Three words each, by target.
    pub(super) synapses: Vec<u32>,
    /// Input channels.
    pub(super) channels: u32,
    pub(super) reset: Option<Reset>,
}

impl BatchForm {
    /// The words of a network.
    ///
    /// # Errors
    /// Why there are none: its arithmetic is not the chip's, or it has too many synapses.
    pub fn new(network: &Quantised) -> Result<Self, String> {
        let parts = network.parts();
        if parts.semantics != Semantics::Hardware {
            return Err(format!(
                "network '{}' is in the arithmetic {:?}: batches on a GPU are in the chip's alone",
                parts.name, parts.semantics
            ));
        }
        if network.synapses() > MOST_SYNAPSES {
            return Err(format!(
                "network '{}' has {} synapses, more than the {MOST_SYNAPSES} that are listed for a GPU",
                parts.name,
                network.synapses()
            ));
        }
        let channels = network.channels();
        let mut incoming: Vec<Vec<[u32; 3]>> = vec![Vec::new(); network.compartments() as usize];
        for projection in network.projections() {
            let source = &network.populations()[projection.source];
            // A compartment's spike is on its way for a step at least.
            let (first_source, later) = match source.units {
                Units::Input(first) => (first.0, 0),
                Units::Compartments { first, .. } => (channels + first.0, 1),
            };
            let Some(first_target) = network.populations()[projection.target].first_compartment() else { continue };
            let way = u32::from(projection.delay.get()) + later;
            for from in 0..source.shape.len() {
                projection.connectivity.for_each_from(from, |to, weight| {
                    let adds = projection.format.scaled(weight).wrapping_mul(source.spike_factor());
                    incoming[(first_target.0 + to) as usize].push([first_source + from, way, adds as u32]);
                });
            }
        }
        let (mut compartments, mut synapses) = (Vec::new(), Vec::new());
        let mut past = 0;
        for population in network.populations() {
            let Units::Compartments { neurons, start_step, first } = &population.units else { continue };
            for index in 0..population.shape.len() {
                let f = fields(&neurons.get(index), *start_step, parts.semantics, parts.threshold);
                let before = past;
                let own = &incoming[(first.0 + index) as usize];
                past += own.len() as u32;
                synapses.extend(own.iter().flatten());
                // The threshold's 64 vth, whichever test compares with it.
                let taken =
                    i32::try_from(f.neuron.vth.get()).unwrap_or(i32::MAX) << crate::base::fixed::THRESHOLD_SHIFT;
                let keep = |decay: u16| 4096 - i32::from(decay);
                let numbers = [
                    keep(f.neuron.du.get()),
                    keep(f.neuron.dv.get()),
                    f.bias,
                    f.fires_from,
                    f.vmin,
                    f.vmax,
                    f.refractory.into(),
                    i32::from(f.neuron.kind == NeuronKind::SoftReset),
                    taken,
                ];
                compartments.extend(numbers.map(|number| number as u32));
                compartments.extend([*start_step, before, past]);
            }
        }
        Ok(BatchForm { compartments, synapses, channels, reset: parts.reset })
    }

    /// Compartments of a copy.
    #[must_use]
    pub fn compartments(&self) -> u32 {
        (self.compartments.len() / COMPARTMENT_WORDS) as u32
    }

    /// Channels and compartments.
    #[must_use]
    pub(super) fn sources(&self) -> u32 {
        self.channels + self.compartments()
    }

    /// The input spikes of samples beside each other; those of compartments are 0.
    ///
    /// # Errors
    /// A sample that is longer than the window.
    pub(super) fn input(&self, samples: &[&Sample], steps: u32, words: usize) -> Result<Vec<u32>, String> {
        let sources = self.sources() as usize;
        let mut spikes = vec![0; steps as usize * sources * words];
        for (index, sample) in samples.iter().enumerate() {
            if sample.steps() > steps {
                return Err(format!("sample {index} has {} steps, more than the {steps} of its batch", sample.steps()));
            }
            for step in 0..sample.steps() {
                for channel in sample.at(step) {
                    let at = (step as usize * sources + channel.0 as usize) * words + index / WORD;
                    spikes[at] |= 1 << (index % WORD);
                }
            }
        }
        Ok(spikes)
    }
}

/// Words that so many samples need.
pub(super) fn words(samples: u32) -> usize {
    (samples as usize).div_ceil(WORD)
}

/// The spikes of a batch, and its registers after the last step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trains {
    pub(super) spikes: Vec<u32>,
    pub(super) registers: Vec<u32>,
    pub(super) sources: usize,
    pub(super) channels: usize,
    pub(super) samples: usize,
}

impl Trains {
    /// The compartments of a sample that spiked in a step, ascending. Steps after a sample's end mean nothing.
    #[must_use]
    pub fn spikes(&self, sample: usize, step: u32) -> Vec<CompartmentId> {
        let words = self.samples.div_ceil(WORD);
        let spiked = |compartment: &usize| {
            let at = (step as usize * self.sources + self.channels + compartment) * words + sample / WORD;
            self.spikes[at] >> (sample % WORD) & 1 == 1
        };
        (0..self.sources - self.channels).filter(spiked).map(|compartment| CompartmentId(compartment as u32)).collect()
    }

    /// Current and voltage of a sample's compartment after the last step of the batch.
    #[must_use]
    pub fn registers(&self, sample: usize, compartment: CompartmentId) -> (i32, i32) {
        let all = (self.sources - self.channels) * self.samples;
        let at = compartment.0 as usize * self.samples + sample;
        (self.registers[at] as i32, self.registers[all + at] as i32)
    }
}
