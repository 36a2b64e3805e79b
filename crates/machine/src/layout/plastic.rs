//! The plastic synapses of each shard, by source.
//!
//! Input: a [`Program`], the lane of each compartment, the first lane of each shard. Output: for
//! each shard the synapses whose format is plastic, with the weights before the first step. They
//! are ordered by source, then by the source's messages and their lists.
//!
//! They are in no dense block, row or list. All runs share these forms, and weights are scaled,
//! summed and compared when forms are made. Here a run stores mantissas, which could not be
//! recovered after scaling by a negative exponent.

use crate::lanes::sums::Sums;
use nsim_dynamics::arithmetic::scaled;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::WEIGHT_SHIFT;
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::program::{CoreClass, Program};
use nsim_ir::quantised::connectivity::SynapseFormat;

/// A synapse without its weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlasticSynapse {
    /// Lane of the sum that it adds to, within the shard.
    pub lane: u32,
    pub target: CompartmentId,
    /// Delay field.
    pub delay: u8,
    pub format: SynapseFormat,
}

impl PlasticSynapse {
    /// Contribution of a binary spike at this weight, in units of 64.
    pub fn units(&self, weight: i16) -> i16 {
        (scaled(self.format, weight) >> WEIGHT_SHIFT) as i16
    }
}

/// The plastic synapses of a shard.
#[derive(Debug, Default)]
pub(crate) struct PlasticSynapses {
    /// By source, channels first; no row where the shard has none.
    pub by_source: Csr<PlasticSynapse>,
    /// The weight of each before the first step.
    pub weights: Vec<i16>,
}

impl PlasticSynapses {
    /// The plastic synapses of each shard.
    pub fn by_shard(program: &Program, lanes: &[u32], bases: &[u32], sums: &Sums) -> Vec<Self> {
        let mut all: Vec<Self> = bases.iter().map(|_| Self::default()).collect();
        let is_plastic = |class: &CoreClass| class.formats.iter().any(|format| format.synapse.is_plastic());
        if !program.classes().iter().any(is_plastic) {
            return all;
        }
        for source in 0..program.channels() + program.compartments() {
            for message in program.messages(source) {
                let (class, ids) = (program.class_of(message.core), &program.cores()[message.core].ids);
                for synapse in class.inputs.get(usize::from(message.axon)).synapses() {
                    let format = class.formats[usize::from(synapse.format)].synapse;
                    if !format.is_plastic() {
                        continue;
                    }
                    let (target, delay) = (ids[usize::from(synapse.slot)], synapse.delay.get());
                    let lane = lanes[target.index()];
                    let shard = bases.partition_point(|&base| base <= lane) - 1;
                    let lane = lane - bases[shard] + sums.offset(target, format, delay);
                    all[shard].by_source.extend_last([PlasticSynapse { lane, target, delay, format }]);
                    all[shard].weights.push(synapse.weight);
                }
            }
            all.iter_mut().for_each(|of_shard| of_shard.by_source.end());
        }
        all
    }

    /// The synapses of a source, each with its index among the weights of the shard.
    pub fn synapses(&self, source: usize) -> impl Iterator<Item = (usize, &PlasticSynapse)> {
        let first = self.by_source.firsts().get(source).map_or(0, |&first| first as usize);
        let row = if source < self.by_source.len() { self.by_source.get(source) } else { &[] };
        (first..).zip(row)
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        size_of_val(self.by_source.items()) + 4 * self.by_source.len() + size_of_val(self.weights.as_slice())
    }
}
