//! nsim maps trained spiking networks onto simulated Loihi-style cores, runs them with the chip's
//! own integer arithmetic, and reports energy, latency and power.
//!
//! A [`files::network::Network`] becomes an [`ir::graph::Graph`], an [`ir::quantised::Quantised`],
//! an [`ir::partition::Partition`], an [`ir::placement::Placement`] and an
//! [`ir::program::Program`]. Counts of its run, [`ir::activity::Activity`], give energy and time.
//! `docs/architecture.md` has the picture, `docs/semantics.md` the equations.
//!
//! Map, run and price a network:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let network = nsim::load_model("vtsnn-slip")?;
//! let target = nsim::load_target("nahuku-32")?;
//! let compiled = nsim::compile(nsim::front(&network)?, &target, &nsim::Options::default())?;
//! assert_eq!(compiled.partition.cores(), 1);
//! let stimulus =
//!     nsim::stimulus(&compiled.one, &["scene:slip?samples=2".to_string()], None, None)?;
//! let priced = nsim::run_priced(&compiled, &target, &stimulus.samples)?;
//! assert_eq!(priced.outcomes.len(), 2);
//! let total = priced.estimate.row(nsim::cost::estimate::RowUnit::Total);
//! assert!(total.and_then(|row| row.energy_uj).is_some_and(|energy| energy > 0.0));
//! # Ok(())
//! # }
//! ```
//!
//! The feature `cli`, on by default, adds the command line and its dependencies.

#[cfg(feature = "cli")]
pub mod cli;

pub use nsim_agree as agree;
#[cfg(feature = "ann")]
pub use nsim_ann as ann;
pub use nsim_check as check;
pub use nsim_compile as compile;
pub use nsim_cost as cost;
pub use nsim_dynamics as dynamics;
pub use nsim_energy as energy;
pub use nsim_files as files;
pub use nsim_golden as golden;
pub use nsim_import as import;
pub use nsim_ir as ir;
pub use nsim_machine as machine;
pub use nsim_partition as partition;
pub use nsim_quantise as quantise;
pub use nsim_reference as reference;
pub use nsim_report as report;
pub use nsim_scene as scene;
pub use nsim_session as session;
pub use nsim_study as study;
pub use nsim_train as train;

pub use nsim_compile::{CompileError, Mapping, Options, compile};
pub use nsim_files::target::load_target;
pub use nsim_import::model::load_model;
pub use nsim_session::error::Error;
pub use nsim_session::front::front;
pub use nsim_session::inputs::stimulus;
pub use nsim_session::priced::{Priced, run_priced};

/// The library's example in README.md, which is compiled and run with the other examples.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
