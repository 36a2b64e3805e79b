//! A network on the cores of a target: the compiler's result.
//!
//! A [`Mapping`] exists only once its limits have been verified and its synapses compared with the
//! network's, all of them or those of a sample ([`Checked`]). One with a program is a [`Compiled`]
//! and can run; one of a network that is mapped by its kernels has boxes instead, from which
//! everything but single synapses can be counted.

use std::sync::Arc;

use nsim_ir::firing_rates::Rates;
use nsim_ir::partition::Partition;
use nsim_ir::placement::Placement;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_partition::error::CompileError;
use nsim_partition::form::Form;
use nsim_partition::options::Options;
use nsim_partition::strategy::boxes::Boxes;

/// How the synapses of each core are given.
#[derive(Debug, Clone)]
pub enum Synapses {
    /// The tables of every core.
    Written(Arc<Program>),
    /// The box of each core.
    Symbolic(Box<Boxes>),
}

/// How the checker compared a mapping with its network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Checked {
    /// `whole`: every synapse of every core. `pattern`: every synapse of one core of each class,
    /// and that the others of the class are shifts of it. `sampled`: every synapse of some cores.
    pub how: &'static str,
    /// The share of the cores whose synapses are known to be the network's.
    pub share: f64,
}

/// A network on the cores of a target.
#[derive(Debug, Clone)]
pub struct Mapping<P = Synapses> {
    /// The network, one copy.
    pub one: Quantised,
    /// The network, all copies.
    pub quantised: Quantised,
    /// Compartments on cores.
    pub partition: Partition,
    /// Cores on the board.
    pub placement: Placement,
    /// How the synapses of each core are given.
    pub program: P,
    /// How it was compared with its network.
    pub checked: Checked,
    /// Seconds of each stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// The target's name.
    pub target: String,
    /// How it was compiled.
    pub options: Options,
    /// Name of the placement: `sequential`, `annealed`, or `saved` when it came from a file.
    pub placed: &'static str,
    /// Rates of all sources that it was made for.
    pub rates: Rates,
}

/// A mapping with its program.
pub type Compiled = Mapping<Arc<Program>>;

impl Mapping {
    /// How far its synapses are expanded.
    #[must_use]
    pub fn form(&self) -> Form {
        match self.program {
            Synapses::Written(_) => Form::Written,
            Synapses::Symbolic(_) => Form::Symbolic,
        }
    }

    /// The mapping with its program.
    ///
    /// # Errors
    /// [`CompileError::Fault`] when it is symbolic.
    pub fn into_compiled(self) -> Result<Compiled, CompileError> {
        let Mapping { one, quantised, partition, placement, program, checked, seconds, target, options, placed, rates } =
            self;
        let Synapses::Written(program) = program else {
            return Err(CompileError::fault("a symbolic mapping has no program"));
        };
        Ok(Mapping { one, quantised, partition, placement, program, checked, seconds, target, options, placed, rates })
    }
}
