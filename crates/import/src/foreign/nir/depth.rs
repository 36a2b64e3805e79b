//! The layer of each population: the number of layers of neurons that its input has passed.
//!
//! Input: populations and the paths between them. Output: the depth of each, 0 where only inputs
//! reach it, else one more than the deepest population before it. Delays align paths of different
//! lengths.
//!
//! In the tools that train such networks, a spike passes all layers in one step, and a loop in one
//! more. Here a compartment's spike arrives a step later, so step t + k of a population of depth k
//! corresponds to step t of the tool. Its `start_step` is k, an input is delayed by k steps, and a
//! spike that skips layers by one step for each. A loop over n layers takes n steps.

use std::collections::BTreeMap;

use super::state::Reader;
use nsim_ir::base::depths::depths;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::warning::{Warning, WarningCode};

impl Reader<'_> {
    /// Finds the depth of each population, in the order in which spikes reach them.
    pub(super) fn find_depths(&mut self, order: &[String]) -> Result<()> {
        let place: BTreeMap<&str, usize> =
            order.iter().enumerate().map(|(place, name)| (name.as_str(), place)).collect();
        let mut sources: Vec<Vec<usize>> = vec![Vec::new(); order.len()];
        let is_input = |node: usize| self.flat.nodes[&order[node]].kind == "Input";
        for (to, name) in order.iter().enumerate().filter(|(to, _)| !is_input(*to)) {
            for path in self.paths(name)? {
                sources[to].push(place[path[0].as_str()]);
            }
        }
        let (depths, loops) = depths(&sources, is_input);
        self.loops.extend(loops.into_iter().map(|(from, to)| (order[from].clone(), order[to].clone())));
        self.depths = order.iter().cloned().zip(depths).collect();
        Ok(())
    }

    /// Steps by which spikes between two populations are delayed to align with longer paths.
    pub(super) fn alignment_delay(&mut self, from: &str, to: &str) -> u32 {
        let [from_depth, to_depth] = [from, to].map(|name| self.depths.get(name).copied().unwrap_or(0));
        if self.flat.nodes[from].kind == "Input" {
            return to_depth;
        }
        let looping = self.loops.contains(&(from.to_string(), to.to_string()));
        let arrives = from_depth + u32::from(!looping);
        if arrives > to_depth {
            let message = format!(
                "the loop from '{from}' to '{to}' takes additional steps ({}), as each layer takes a step on the chip",
                arrives - to_depth
            );
            self.warnings.push(Warning::of_network(WarningCode::LoopSlower, message));
        }
        to_depth.saturating_sub(arrives)
    }
}
