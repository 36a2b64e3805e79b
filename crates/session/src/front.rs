//! Converts a model file to a network in integers, the first stage of every run.

use std::time::Instant;

use nsim_compile::{CompileError, Front};
use nsim_files::lower::lower;
use nsim_files::network::Network;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::graph::Graph;
use nsim_ir::quantised::Quantised;
use nsim_quantise::{integers, quantise};

/// Whether a network has spike response neurons, which are real numbers.
pub fn has_srm(network: &Network) -> bool {
    network.file().populations.iter().any(|population| population.srm.is_some())
}

/// Returns a network in integers, with the seconds of each stage.
///
/// # Errors
/// [`CompileError::Input`].
pub fn front(network: &Network) -> Result<Front, CompileError> {
    let start = Instant::now();
    let graph = lower(network)?;
    let lowered = start.elapsed().as_secs_f64();
    let one = integers(&graph)?;
    let seconds = vec![("lower", lowered), ("quantise", start.elapsed().as_secs_f64() - lowered)];
    for (stage, seconds) in &seconds {
        tracing::debug!(stage, seconds, "compiled");
    }
    Ok(Front::measured(one, seconds))
}

/// Checks a whole model, as a command that runs it does.
///
/// # Errors
/// As [`lower`] and, without spike response neurons, [`quantise::quantise`].
pub fn check(network: &Network) -> Result<(), Diagnostic> {
    let graph = lower(network)?;
    if !graph.has_srm() {
        quantise::quantise(&graph)?;
    }
    Ok(())
}

/// Returns a network in real numbers, as the file states it, and in integers.
/// Errors are those of [`lower`] and [`integers`].
pub fn real_and_integers(network: &Network) -> Result<(Graph, Quantised), Diagnostic> {
    let graph = lower(network)?;
    let integers = integers(&graph)?;
    Ok((graph, integers))
}
