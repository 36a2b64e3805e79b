//! The distinct synapse formats of a network.

use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::SynapseFormat;

/// The distinct synapse formats of a network, ascending.
#[derive(Debug, Clone)]
pub struct Formats {
    distinct: Vec<SynapseFormat>,
    of_projection: Vec<u16>,
}

impl Formats {
    /// The formats of a network.
    #[must_use]
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
    #[must_use]
    pub fn get(&self, index: u16) -> SynapseFormat {
        self.distinct[usize::from(index)]
    }

    /// The index of each projection's format.
    #[must_use]
    pub fn by_projection(&self) -> &[u16] {
        &self.of_projection
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.distinct.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.distinct.is_empty()
    }
}
