//! State of reading a netx file: the model so far and the source of the next layer.

use std::cell::Cell;

use crate::foreign::imported::{LayerWeights, Options};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::Warning;
use nsim_ir::neurons::NeuronKind;

/// The most numbers to which parameters per channel are expanded, over all layers.
pub(super) const MOST_EXPANDED: u64 = 1 << 22;
/// The exponent of a bias (netx, `bias_exp`).
pub(super) const BIAS_EXP: f64 = 6.0;
/// Fractional bits of a message, and of the neuron's state (netx, `spike_exp` and `state_exp` of
/// its sigma-delta blocks).
pub(super) const SDNN_EXP: f64 = 6.0;
/// Bits of a message of sigma-delta neurons (netx, `num_message_bits`).
pub(super) const DEFAULT_BITS: i64 = 16;

pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.netx", message)
}

/// The population whose spikes reach the next layer.
#[derive(Debug, Clone)]
pub(super) struct LastPopulation {
    pub(super) name: String,
    pub(super) shape: Vec<u64>,
    /// Delay field of each of its units; empty without delays.
    pub(super) delays: Vec<u32>,
}

impl LastPopulation {
    pub(super) fn units(&self) -> u64 {
        units(&self.shape).unwrap_or(u64::MAX)
    }
}

pub(super) fn units(shape: &[u64]) -> Option<u64> {
    shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
}

/// The neurons of a population.
#[derive(Debug, Default)]
pub(super) struct Neurons {
    pub(super) kind: NeuronKind,
    pub(super) parameters: Vec<(&'static str, Parameter)>,
    pub(super) message_bits: Option<i64>,
}

impl From<Vec<(&'static str, Parameter)>> for Neurons {
    /// Compartments of Loihi 1.
    fn from(parameters: Vec<(&'static str, Parameter)>) -> Self {
        Neurons { parameters, ..Neurons::default() }
    }
}

pub(super) struct Reader<'a> {
    pub(super) options: &'a Options,
    pub(super) model: NetworkFile,
    pub(super) notes: Vec<String>,
    /// Changes of the file's numbers, and assumptions.
    pub(super) warnings: Vec<Warning>,
    pub(super) layers: Vec<LayerWeights>,
    pub(super) last: Option<LastPopulation>,
    pub(super) expanded: Cell<u64>,
    pub(super) slayer_time: bool,
    /// Number of populations of compartments so far, which is the start step of the next one.
    pub(super) depth: u32,
}

impl Reader<'_> {
    /// Adds a population and makes it the last.
    pub(super) fn push(&mut self, name: &str, shape: Vec<u64>, neurons: Option<Neurons>) {
        let start_step = match &neurons {
            Some(_) => {
                self.depth += 1;
                self.depth - 1
            }
            None => 0,
        };
        let mut population = PopulationDesc { start_step, ..PopulationDesc::input(name, shape.clone()) };
        if let Some(Neurons { kind, parameters, message_bits }) = neurons {
            (population.kind, population.loihi, population.message_bits) = (kind, Some(parameters), message_bits);
        }
        self.model.populations.push(population);
        self.last = Some(LastPopulation { name: name.to_string(), shape, delays: Vec::new() });
    }

    /// The previous layer; without one, adds an input of this shape.
    pub(super) fn source(&mut self, shape: impl FnOnce() -> Result<Vec<u64>>) -> Result<LastPopulation> {
        if self.last.is_none() {
            let shape = shape()?;
            self.push("input", shape, None);
        }
        self.last.clone().ok_or_else(|| wrong("no layer"))
    }
}
