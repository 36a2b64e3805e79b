//! Stored forms of synapses: the distinct formats of a network, and the number of synapses that a
//! core stores where kernels are shared ([`Resource::StoredSynapses`]).
//!
//! The rule, for a core that holds some compartments of a population:
//!
//! - of a convolution or a pool, the weights of each channel of targets that has a compartment on
//!   the core, once, regardless of the number of its positions there;
//! - of every other projection, the synapses into each compartment;
//! - nothing for a weight of 0.
//!
//! The number is never less than the checker's count from the tables of the core.
//!
//! [`Resource::StoredSynapses`]: nsim_ir::resource::Resource::StoredSynapses

use std::collections::HashSet;

use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId};
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Population, Projection, Quantised};

/// The distinct synapse formats of a network, ascending.
#[derive(Debug, Clone)]
pub struct Formats {
    distinct: Vec<SynapseFormat>,
    of_projection: Vec<u16>,
}

impl Formats {
    /// The formats of a network.
    pub fn for_network(network: &Quantised) -> Self {
        let mut distinct: Vec<SynapseFormat> = network.projections().iter().map(|p| p.format).collect();
        distinct.sort_unstable();
        distinct.dedup();
        let find = |format: &SynapseFormat| distinct.partition_point(|f| f < format) as u16;
        let of_projection = network.projections().iter().map(|p| find(&p.format)).collect();
        Formats { distinct, of_projection }
    }

    /// A format by its index.
    #[inline]
    pub fn get(&self, index: u16) -> SynapseFormat {
        self.distinct[usize::from(index)]
    }

    /// The index of each projection's format.
    pub fn by_projection(&self) -> &[u16] {
        &self.of_projection
    }

    /// Number of distinct formats.
    pub fn len(&self) -> usize {
        self.distinct.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.distinct.is_empty()
    }
}

/// Stored weights of a population.
#[derive(Debug, Default)]
struct Weights {
    /// Positions of a channel, at least 1.
    positions: u32,
    /// Weights of all kernels of a channel.
    by_channel: Vec<u64>,
    /// Weights of the other synapses into each compartment.
    by_compartment: Vec<u64>,
}

/// Channels of which a core stores the kernels already.
pub type Kernels = HashSet<(PopulationId, u32)>;

/// Stored weights of a network's compartments.
#[derive(Debug)]
pub struct StoredSynapses(IdVec<PopulationId, Weights>);

/// Weights of the kernels of each channel of a projection's targets; empty without a kernel.
pub fn by_channel(projection: &Projection) -> Vec<u64> {
    let stored = |weights: &[i16]| weights.iter().filter(|&&weight| weight != 0).count() as u64;
    match &projection.connectivity {
        Connectivity::Conv2d { window, kernel } => {
            kernel.chunks(kernel.len() / window.target.0.max(1) as usize).map(stored).collect()
        }
        Connectivity::SumPool2d { window, weight } => {
            let each = u64::from(window.kernel.0) * u64::from(window.kernel.1) * stored(&[*weight]);
            vec![each; window.target.0 as usize]
        }
        Connectivity::Dense { .. } | Connectivity::Sparse { .. } | Connectivity::Random { .. } => Vec::new(),
    }
}

impl StoredSynapses {
    /// Counts the stored weights of a network.
    pub fn for_network(network: &Quantised) -> Self {
        let weights = |(id, population): (PopulationId, &Population)| {
            let size = population.shape.len() as usize;
            let positions = population.shape.positions().max(1);
            let mut weights =
                Weights { positions, by_channel: vec![0; size / positions as usize], by_compartment: vec![0; size] };
            for (_, projection) in network.incoming(id) {
                let kernels = by_channel(projection);
                weights.by_channel.iter_mut().zip(&kernels).for_each(|(sum, kernel)| *sum += kernel);
                if kernels.is_empty() {
                    for source in 0..network.populations()[projection.source].shape.len() {
                        projection.connectivity.for_each_from(source, |target, weight| {
                            weights.by_compartment[target as usize] += u64::from(weight != 0);
                        });
                    }
                }
            }
            weights
        };
        StoredSynapses(network.populations().enumerate().map(weights).collect())
    }

    /// Number of weights that a core stores in addition once it holds this compartment too.
    pub fn added(&self, population: PopulationId, index: u32, kernels: &mut Kernels) -> u64 {
        let weights = &self.0[population];
        let channel = index / weights.positions;
        let kernel = if kernels.insert((population, channel)) { weights.by_channel[channel as usize] } else { 0 };
        weights.by_compartment[index as usize] + kernel
    }

    /// Number of weights that a core of these compartments stores.
    pub fn of_core(&self, network: &Quantised, members: &[CompartmentId]) -> u64 {
        let mut kernels = Kernels::new();
        let added = |&id: &CompartmentId| {
            let (population, index) = network.population_of(id);
            self.added(population, index, &mut kernels)
        };
        members.iter().map(added).sum()
    }
}
