//! nsim maps trained spiking networks onto simulated Loihi-style cores, runs them with the chip's own integer
//! arithmetic, and reports energy, latency and power.
//!
//! The way through is one line: files become a [`desc::network::Network`], then an [`ir::graph::Graph`], an
//! [`ir::quantised::Quantised`] network, an [`ir::partition::Partition`], an [`ir::placement::Placement`], an
//! [`ir::program::Program`]; the machine runs it and counts an [`ir::activity::Activity`], from which energy and time
//! are computed. `docs/architecture.md` has the picture; `docs/semantics.md` the numbered equations.
//!
//! Map, run and price a network:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let network = nsim::load_model("vtsnn-slip")?;
//! let target = nsim::load_target("nahuku-32")?;
//! let compiled = nsim::compile(nsim::front(&network)?, &target, &nsim::Options::default())?;
//! assert_eq!(compiled.partition.cores(), 1);
//! let stimulus = nsim::stimulus(&compiled.one, &["scene:slip?samples=2".to_string()], None, None)?;
//! let priced = nsim::run_priced(&compiled, &target, &stimulus.samples)?;
//! assert_eq!(priced.outcomes.len(), 2);
//! let total = priced.estimate.rows.iter().find(|row| row.unit == "total");
//! assert!(total.and_then(|row| row.energy_uj).is_some_and(|energy| energy > 0.0));
//! # Ok(())
//! # }
//! ```
//!
//! The feature `cli`, on by default, adds the command line and its dependencies.

pub mod agree;
pub mod base;
pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod compile;
pub mod convert;
pub mod cost;
pub mod desc;
pub mod drive;
pub mod energy;
pub mod error;
pub mod golden;
pub mod io;
pub mod ir;
pub mod machine;
pub mod neuron;
pub mod reference;
pub mod report;
pub mod scene;
pub mod stress;
pub mod sweep;
pub mod train;

pub use compile::{CompileError, Compiled, Options, compile, front};
pub use drive::inputs::stimulus;
pub use drive::priced::{Priced, run_priced};
pub use error::Error;
pub use io::model::load_model;
pub use io::target::load_target;
