//! The layer of each node of a network: the number of nodes that its input has passed.
//!
//! Input: the sources of each node, with nodes numbered in the order in which spikes reach them.
//! Output: depths, and the edges that close a loop, which depths ignore. A depth is 0 for inputs
//! and for nodes with inputs only as sources, else one more than the deepest source.

use std::collections::BTreeSet;

use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};

/// Depths, and the edges `(from, to)` that close a loop.
pub fn depths(sources: &[Vec<usize>], is_input: impl Fn(usize) -> bool) -> (Vec<u32>, BTreeSet<(usize, usize)>) {
    let edges = sources.iter().enumerate().flat_map(|(to, from)| from.iter().map(move |&from| (from, to)));
    let mut graph = DiGraph::<(), ()>::new();
    sources.iter().for_each(|_| _ = graph.add_node(()));
    edges.for_each(|(from, to)| _ = graph.add_edge(NodeIndex::new(from), NodeIndex::new(to), ()));
    // `tarjan_scc` returns each component after the components that it leads to.
    let components = tarjan_scc(&graph);
    let mut component = vec![0; sources.len()];
    for (index, members) in components.iter().enumerate() {
        members.iter().for_each(|node| component[node.index()] = index);
    }
    let (mut depths, mut loops) = (vec![0; sources.len()], BTreeSet::new());
    for members in components.iter().rev() {
        let mut members: Vec<usize> = members.iter().map(|node| node.index()).collect();
        members.sort_unstable();
        for to in members {
            let forward = |from: &&usize| component[**from] != component[to] || **from < to;
            let depth_after = |from: &usize| if is_input(*from) { 0 } else { depths[*from] + 1 };
            depths[to] = sources[to].iter().filter(forward).map(depth_after).max().unwrap_or(0);
            loops.extend(sources[to].iter().filter(|from| !forward(from)).map(|&from| (from, to)));
        }
    }
    (depths, loops)
}
