//! The layer of each population: the number of layers of neurons that its input has passed.
//!
//! Input: populations and what leads from which to which. Output: depths, 0 for what only inputs
//! reach, else one more than the deepest population before it; and the delay that keeps ways of
//! different lengths together.
//!
//! The tools that train such networks let a spike pass all layers in one step, and a loop in one
//! more. A compartment's spike arrives a step later, so a population of depth k does in step t + k
//! what the tool's does in step t: `start_step` is k, an input waits k steps, and a spike that
//! skips layers one step for each. A loop over several layers takes as many steps, which no delay
//! shortens.

use std::collections::BTreeMap;

use super::reader::Reader;
use nsim_ir::base::depths::depths;
use nsim_ir::base::diagnostic::Result;

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

    /// Steps by which spikes between two populations have to be delayed to meet those of longer
    /// ways.
    pub(super) fn waits(&mut self, from: &str, to: &str) -> u32 {
        let depth = |name: &str| self.depths.get(name).copied().unwrap_or(0);
        if self.flat.nodes[from].kind == "Input" {
            return depth(to);
        }
        let looping = self.loops.contains(&(from.to_string(), to.to_string()));
        let arrives = depth(from) + u32::from(!looping);
        if arrives > depth(to) {
            self.notes.push(format!(
                "the loop from '{from}' to '{to}' takes {} steps more than where all layers answer in one",
                arrives - depth(to)
            ));
        }
        depth(to).saturating_sub(arrives)
    }
}
