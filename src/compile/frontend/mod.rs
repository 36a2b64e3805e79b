//! From a model file to a network in range-checked integers.

pub mod analytic;
pub mod carry;
pub mod copies;
pub mod exponents;
pub mod lower;
pub mod prune;
pub mod quantise;
pub mod relays;

use crate::base::diagnostic::Diagnostic;
use crate::desc::network::Network;
use crate::ir::graph::Graph;
use crate::ir::quantised::Quantised;

/// A network in integers, spike response neurons by way of [`analytic`].
///
/// # Errors
/// As [`quantise::quantise`].
pub fn integers(graph: &Graph) -> Result<Quantised, Diagnostic> {
    match graph.has_srm() {
        true => quantise::quantise(&analytic::convert(graph)),
        false => quantise::quantise(graph),
    }
}

/// Checks all that a model says, as a command that runs it does.
///
/// # Errors
/// As [`lower::lower`] and, without spike response neurons, [`quantise::quantise`].
pub fn check(network: &Network) -> Result<(), Diagnostic> {
    let graph = lower::lower(network)?;
    if !graph.has_srm() {
        quantise::quantise(&graph)?;
    }
    Ok(())
}

/// A network in real numbers, as the file means it, and in integers.
///
/// # Errors
/// As [`lower::lower`] and [`integers`].
pub fn real_and_integers(network: &Network) -> Result<(Graph, Quantised), Diagnostic> {
    let graph = lower::lower(network)?;
    let integers = integers(&graph)?;
    Ok((graph, integers))
}
