//! From a model file to a network in range-checked integers.

pub mod analytic;
mod apart;
pub mod carry;
pub mod copies;
pub mod exponents;
pub mod prune;
pub mod quantise;
pub mod relays;

use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::graph::Graph;
use nsim_ir::quantised::Quantised;

/// Returns a network in integers; [`analytic`] converts its spike response neurons.
///
/// # Errors
/// As [`quantise::quantise`].
pub fn integers(graph: &Graph) -> Result<Quantised, Diagnostic> {
    match graph.has_srm() {
        true => quantise::quantise(&analytic::with_fits(graph, &analytic::starts(graph))),
        false => quantise::quantise(graph),
    }
}
