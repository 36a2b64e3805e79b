//! A network and its samples as the words that a GPU reads, and the words of spikes that it gives
//! back.
//!
//! Input: a network in integers or in real numbers; samples. Output: lists of 32-bit words in the
//! layouts of `common.wgsl`, `step.wgsl` and `real.wgsl`. Errors: an arithmetic other than the
//! chip's, more synapses than are ever listed, a sample longer than its batch.

use std::cmp::Reverse;
use std::fmt::Debug;
use std::marker::PhantomData;

use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::fields;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::id::CompartmentId;
use nsim_ir::graph::Graph;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::{Quantised, Reset, Units};
use nsim_ir::spikes::Sample;
use nsim_reference::{Model, NeuronForm, Options};

/// Synapses above which no list is made: 768 MiB of them.
const MOST_SYNAPSES: u64 = 1 << 26;
/// Samples of a word of spikes.
const WORD: usize = 32;

/// What a batch is computed in.
pub trait Arithmetic: Debug {
    /// One step of all compartments, in WGSL.
    const SHADER: &'static str;
    /// Words of a compartment.
    const COMPARTMENT_WORDS: usize;
    /// Words that a compartment of a sample keeps from step to step.
    const STATE_WORDS: u64;
    /// Its name in a row.
    const NAME: &'static str;
}

/// The chip's integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integers {}

impl Arithmetic for Integers {
    const SHADER: &'static str =
        concat!(include_str!("common.wgsl"), include_str!("decay.wgsl"), include_str!("step.wgsl"));
    const COMPARTMENT_WORDS: usize = 12;
    const STATE_WORDS: u64 = 3;
    const NAME: &'static str = "integers";
}

/// Real numbers in single precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Single {}

impl Arithmetic for Single {
    const SHADER: &'static str = concat!(include_str!("common.wgsl"), include_str!("real.wgsl"));
    const COMPARTMENT_WORDS: usize = 13;
    const STATE_WORDS: u64 = 6;
    const NAME: &'static str = "f32";
}

/// A network in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatchForm<A> {
    /// So many words each as the arithmetic says.
    pub(super) compartments: Vec<u32>,
    /// Three words each, by target.
    pub(super) synapses: Vec<u32>,
    /// Input channels.
    pub(super) channels: u32,
    pub(super) reset: Option<Reset>,
    arithmetic: PhantomData<A>,
}

/// That so many synapses are listed.
fn listed(name: &str, synapses: u64) -> Result<(), String> {
    if synapses > MOST_SYNAPSES {
        return Err(format!(
            "network '{name}' has {synapses} synapses, more than the {MOST_SYNAPSES} that are listed for a GPU"
        ));
    }
    Ok(())
}

impl BatchForm<Integers> {
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
        listed(&parts.name, network.synapses())?;
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
                    let adds = scaled(projection.format, weight).wrapping_mul(source.spike_factor());
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
                    i32::try_from(f.neuron.vth.get()).unwrap_or(i32::MAX) << nsim_ir::base::fixed::THRESHOLD_SHIFT;
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
        Ok(BatchForm { compartments, synapses, channels, reset: parts.reset, arithmetic: PhantomData })
    }
}

impl BatchForm<Single> {
    /// The words of a network in real numbers, spike response kernels without end.
    ///
    /// A compartment's synapses are listed in the order in which the reference adds what arrives:
    /// earlier steps first, channels before compartments, each ascending.
    ///
    /// # Errors
    /// Why there are none: it has too many synapses, or resets that SLAYER counts from a step that
    /// it skips.
    pub fn real(graph: &Graph) -> Result<Self, String> {
        let facts = graph.facts();
        if facts.semantics == Semantics::Slayer && facts.reset.is_some() {
            return Err(format!(
                "network '{}' has resets under semantics Slayer: batches on a GPU count them from step 1",
                facts.name
            ));
        }
        let model = Model::<f32>::new(graph, Options::default());
        let inclusive = u32::from(model.threshold_test() == ThresholdTest::Inclusive);
        let mut incoming: Vec<Vec<[u32; 3]>> = Vec::new();
        model.for_each_neuron(|_, _| incoming.push(Vec::new()));
        let mut synapses = 0;
        model.for_each_synapse(|synapse| {
            synapses += 1;
            if synapses <= MOST_SYNAPSES {
                incoming[synapse.target.0 as usize].push([synapse.source, synapse.way, synapse.weight.to_bits()]);
            }
        });
        listed(&graph.facts().name, synapses)?;
        incoming.iter_mut().for_each(|own| own.sort_by_key(|&[source, way, _]| (Reverse(way), source)));
        let mut compartments = Vec::new();
        let (mut index, mut past) = (0, 0);
        let single = |x: f64| (x as f32).clamp(f32::MIN, f32::MAX).to_bits();
        model.for_each_neuron(|neuron, start_step| {
            let before = past;
            past += incoming[index].len() as u32;
            index += 1;
            let place = [u32::from(matches!(neuron, NeuronForm::Srm(_))), start_step, before, past];
            compartments.extend(place);
            compartments.extend(match neuron {
                NeuronForm::Srm(srm) => {
                    let (response, refractory) = (srm.response(), srm.refractory());
                    let [keep, keep_refractory] = [response.decay(), refractory.decay()].map(single);
                    let [gain, gain_refractory] = [response.gain(), refractory.gain()].map(single);
                    [single(srm.theta), 1, keep, keep_refractory, gain, gain_refractory, 0, 0, 0]
                }
                NeuronForm::Cuba(form) => [
                    single(form.threshold),
                    inclusive,
                    single(form.keep_u),
                    single(form.keep_v),
                    single(form.bias),
                    single(form.clip.0),
                    single(form.clip.1),
                    form.refractory.max(1),
                    u32::from(form.subtracts),
                ],
            });
        });
        Ok(BatchForm {
            compartments,
            synapses: incoming.into_iter().flatten().flatten().collect(),
            channels: model.channels(),
            reset: model.reset(),
            arithmetic: PhantomData,
        })
    }
}

impl<A: Arithmetic> BatchForm<A> {
    /// Compartments of a copy.
    #[must_use]
    pub fn compartments(&self) -> u32 {
        (self.compartments.len() / A::COMPARTMENT_WORDS) as u32
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

/// The spikes of a batch, and what its compartments kept after the last step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trains<A> {
    pub(super) spikes: Vec<u32>,
    pub(super) states: Vec<u32>,
    pub(super) sources: usize,
    pub(super) channels: usize,
    pub(super) samples: usize,
    pub(super) arithmetic: PhantomData<A>,
}

impl<A: Arithmetic> Trains<A> {
    /// The compartments of a sample that spiked in a step, ascending. Steps after a sample's end
    /// mean nothing.
    #[must_use]
    pub fn spikes(&self, sample: usize, step: u32) -> Vec<CompartmentId> {
        let words = self.samples.div_ceil(WORD);
        let spiked = |compartment: &usize| {
            let at = (step as usize * self.sources + self.channels + compartment) * words + sample / WORD;
            self.spikes[at] >> (sample % WORD) & 1 == 1
        };
        (0..self.sources - self.channels).filter(spiked).map(|compartment| CompartmentId(compartment as u32)).collect()
    }

    fn state(&self, word: usize, sample: usize, compartment: CompartmentId) -> u32 {
        let all = (self.sources - self.channels) * self.samples;
        self.states[word * all + compartment.0 as usize * self.samples + sample]
    }
}

impl Trains<Integers> {
    /// Current and voltage of a sample's compartment after the last step of the batch.
    #[must_use]
    pub fn registers(&self, sample: usize, compartment: CompartmentId) -> (i32, i32) {
        let word = |word| self.state(word, sample, compartment) as i32;
        (word(0), word(1))
    }
}

impl Trains<Single> {
    /// The membrane potential of a sample's compartment after the last step of the batch.
    #[must_use]
    pub fn potential(&self, sample: usize, compartment: CompartmentId) -> f32 {
        f32::from_bits(self.state(0, sample, compartment))
    }
}
