//! nsim maps trained spiking networks onto simulated Loihi-style cores, runs them with the chip's own integer
//! arithmetic, and reports energy, latency and power.
//!
//! The way through is one line: files become a [`desc::network::Network`], then an [`ir::graph::Graph`], an
//! [`ir::quantised::Quantised`] network, an [`ir::partition::Partition`], an [`ir::placement::Placement`], an
//! [`ir::program::Program`]; the machine runs it and counts an [`ir::activity::Activity`], from which energy and time
//! are computed. `docs/architecture.md` has the picture; `docs/semantics.md` the numbered equations.

pub mod agree;
pub mod base;
pub mod bench;
pub mod cli;
pub mod compile;
pub mod convert;
pub mod cost;
pub mod desc;
pub mod drive;
pub mod error;
pub mod golden;
pub mod io;
pub mod ir;
pub mod machine;
pub mod reference;
pub mod report;
pub mod scene;
pub mod stress;
pub mod train;
