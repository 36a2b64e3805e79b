//! A network on the cores of a target: the compiler's result.
//!
//! A [`Mapping`] exists only once its limits have been verified and its synapses compared with the
//! network's.

use std::borrow::Cow;
use std::sync::Arc;

use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::partition::Partition;
use nsim_ir::placement::Placement;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_partition::large::counted_in_boxes;
use nsim_partition::options::Options;
use nsim_partition::strategy::boxes::Lattices;

/// A network on the cores of a target.
#[derive(Debug, Clone)]
pub struct Mapping {
    /// The network, one copy.
    pub one: Quantised,
    /// The network, all copies.
    pub quantised: Quantised,
    /// Assignment of compartments to cores.
    pub partition: Partition,
    /// Positions of cores on the board.
    pub placement: Placement,
    /// Lattices of the layers, of a network that is cut into boxes.
    pub lattices: Option<Lattices>,
    /// Tables and messages.
    pub program: Arc<Program>,
    /// Number of cores proven to be shifts of the first of their class. All synapses of that core,
    /// and of all other cores, were compared with the network's.
    pub shifts: u32,
    /// Seconds of each stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// The target's name.
    pub target: String,
    /// Options of the compilation.
    pub options: Options,
    /// Name of the placement: `sequential`, `annealed`, or `saved` when it came from a file.
    pub placed: &'static str,
    /// Rates of all sources for which it was made.
    pub rates: Rates,
}

impl Mapping {
    /// The target with the limits by which its cores are counted.
    pub(crate) fn counted_on<'t>(&self, target: &'t Target) -> Cow<'t, Target> {
        counted_in_boxes(self.lattices.is_some(), &self.one, target)
    }
}
