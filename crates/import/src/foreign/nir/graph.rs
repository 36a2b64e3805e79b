//! The graph of a file: inlines nested graphs, names populations and finds their shapes and paths.
//!
//! Input: groups of the file. Output: nodes and edges without nesting, and the paths between
//! populations.

use std::collections::{BTreeMap, BTreeSet};

use super::node_types::{Flat, Node, is_population};
use super::state::{DEEPEST, MOST_NODES, MOST_PATHS, MOST_UNITS, Reader, product, reals, wrong};
use crate::foreign::imported::population_name;
use crate::hdf5::{Group, Item, Numbers};
use nsim_ir::base::diagnostic::Result;

/// Adds a graph's nodes under a prefix. Edges to a nested graph end at its inputs, edges from it
/// leave its outputs.
pub(super) fn unfold<'a>(graph: &'a Group, prefix: &str, depth: usize, flat: &mut Flat<'a>) -> Result<()> {
    if depth > DEEPEST {
        return Err(wrong(format!("graphs are nested deeper than {DEEPEST}")));
    }
    let nodes = graph.group("nodes").ok_or_else(|| wrong("group 'nodes' of a graph is missing"))?;
    let mut graphs: BTreeMap<&str, (Vec<String>, Vec<String>)> = BTreeMap::new();
    let mut names: BTreeSet<&str> = BTreeSet::new();
    for (name, item) in &nodes.items {
        let Item::Group(node) = item else { return Err(wrong(format!("node '{name}' is not a group"))) };
        let kind = node.text("type").ok_or_else(|| wrong(format!("node '{name}': field 'type' is missing")))?;
        names.insert(name);
        let full = format!("{prefix}{name}");
        if full.len() > 512 || flat.nodes.len() >= MOST_NODES {
            return Err(wrong(format!("more than {MOST_NODES} nodes, or a name of more than 512 letters")));
        }
        if kind == "NIRGraph" {
            graphs.insert(name, (nodes_of_kind(node, &full, "Input"), nodes_of_kind(node, &full, "Output")));
            unfold(node, &format!("{full}/"), depth + 1, flat)?;
        } else {
            let kind = if depth > 0 && matches!(kind, "Input" | "Output") { "Pass" } else { kind };
            flat.nodes.insert(full, Node { kind: kind.to_string(), integrator: String::new(), group: node });
        }
    }
    let edges: &[String] = match graph.get("edges") {
        Some(Item::Texts(shape, texts)) if shape.len() == 2 && shape[1] == 2 => texts,
        Some(Item::Texts(_, texts)) if texts.is_empty() => &[],
        Some(Item::Numbers(numbers)) if numbers.is_empty() => &[],
        _ => return Err(wrong("'edges' of a graph is not a list of pairs of names")),
    };
    for pair in edges.chunks_exact(2) {
        for end in pair {
            if !names.contains(end.as_str()) {
                return Err(wrong(format!("an edge names '{end}', which is not a node")));
            }
        }
        for (end, kind, does) in [(&pair[1], "Input", "enters"), (&pair[0], "Output", "leaves")] {
            if nodes.group(end).and_then(|node| node.text("type")) == Some(kind) {
                let edge = format!("the edge from '{prefix}{}' to '{prefix}{}'", pair[0], pair[1]);
                return Err(wrong(format!("{edge} {does} a node of type {kind}"))
                    .help("remove the edge, or connect the nodes that it should join"));
            }
        }
        let from = graphs.get(pair[0].as_str()).map(|ends| ends.1.clone());
        let to = graphs.get(pair[1].as_str()).map(|ends| ends.0.clone());
        let from = from.unwrap_or_else(|| vec![format!("{prefix}{}", pair[0])]);
        let to = to.unwrap_or_else(|| vec![format!("{prefix}{}", pair[1])]);
        if from.is_empty() || to.is_empty() {
            let (graph, end) = if to.is_empty() { (&pair[1], "Input") } else { (&pair[0], "Output") };
            return Err(wrong(format!("an edge ends at graph '{prefix}{graph}', which has no node of type {end}")));
        }
        for (a, b) in from.iter().flat_map(|a| to.iter().map(move |b| (a, b))) {
            if !flat.edges.insert((a.clone(), b.clone())) {
                flat.doubled.insert((a.clone(), b.clone()));
            }
            if flat.edges.len() > MOST_NODES {
                return Err(wrong(format!("more than {MOST_NODES} edges")));
            }
        }
    }
    Ok(())
}

/// The nodes of a kind in a nested graph.
fn nodes_of_kind(graph: &Group, name: &str, kind: &str) -> Vec<String> {
    let members = graph.group("nodes").into_iter().flat_map(|nodes| &nodes.items);
    let of_kind = members.filter(|(_, item)| matches!(item, Item::Group(group) if group.text("type") == Some(kind)));
    of_kind.map(|(member, _)| format!("{name}/{member}")).collect()
}

impl Reader<'_> {
    pub(super) fn name_populations(&mut self, populations: &[String]) -> Result<()> {
        let mut taken = BTreeSet::new();
        for name in populations {
            let plain = population_name(name);
            let mut unique = if plain.is_empty() { "node".to_string() } else { plain.clone() };
            let mut count = 1;
            while !taken.insert(unique.clone()) {
                count += 1;
                unique = format!("{plain}_{count}");
            }
            self.names.insert(name.clone(), unique);
        }
        if !populations.iter().any(|name| self.flat.nodes[name].kind != "Input") {
            return Err(wrong("it has no neurons"));
        }
        Ok(())
    }

    /// An array's axes as `[n]` or `[channels, height, width]`.
    pub(super) fn volume(shape: &[usize]) -> Vec<usize> {
        let mut shape = shape.to_vec();
        while shape.len() > 3 && shape[0] == 1 {
            shape.remove(0);
        }
        match shape.as_slice() {
            [] => vec![1],
            [_] | [_, _, _] => shape,
            // Channels and width; the height is 1.
            [channels, length] => vec![*channels, 1, *length],
            _ => vec![product(&shape).unwrap_or(usize::MAX)],
        }
    }

    /// Finds the shapes of populations: stated for inputs, else from parameters, else the shape
    /// that arrives.
    pub(super) fn find_shapes(&mut self, populations: &[String]) -> Result<()> {
        for name in populations {
            let node = &self.flat.nodes[name];
            let shape = if node.kind == "Input" {
                let axes = reals(node.group, name, "shape")?;
                let whole = axes.iter().all(|x| x.fract() == 0.0 && (1.0..=MOST_UNITS as f64).contains(x));
                if !whole {
                    return Err(wrong(format!("input '{name}' has the shape {axes:?}")));
                }
                Some(axes.iter().map(|&x| x as usize).collect::<Vec<_>>())
            } else {
                let fields = ["v_threshold", "tau_mem", "tau", "r", "v_leak", "tau_syn", "threshold"];
                let shapes = fields.iter().filter_map(|key| node.group.numbers(key)).map(Numbers::shape);
                shapes
                    .max_by_key(|shape| shape.iter().product::<usize>())
                    .filter(|s| product(s) > Some(1))
                    .map(<[_]>::to_vec)
            };
            if let Some(shape) = shape {
                let shape = Self::volume(&shape);
                if product(&shape).is_none() {
                    return Err(wrong(format!("'{name}' has more than {MOST_UNITS} units")));
                }
                self.shapes.insert(name.clone(), shape);
            }
        }
        // Parameters of one number fit any shape, so the shape that arrives is used.
        let mut changed = true;
        while std::mem::take(&mut changed) {
            let missing: Vec<&String> = populations.iter().filter(|name| !self.shapes.contains_key(*name)).collect();
            for name in missing {
                let known = self.paths(name)?.into_iter().find(|path| self.shapes.contains_key(&path[0]));
                if let Some(path) = known {
                    let shape = self.linear_map(&self.shapes[&path[0]], &path[1..])?.shape;
                    self.shapes.insert(name.clone(), shape);
                    changed = true;
                }
            }
        }
        for name in populations {
            self.shapes.entry(name.clone()).or_insert_with(|| vec![1]);
        }
        Ok(())
    }

    /// Every path to a node: the source population, then the nodes in between.
    pub(super) fn paths(&self, to: &str) -> Result<Vec<Vec<String>>> {
        let mut paths = Vec::new();
        let mut open: Vec<Vec<String>> = vec![vec![to.to_string()]];
        while let Some(path) = open.pop() {
            let last = &path[path.len() - 1];
            for (from, _) in self.flat.edges.iter().filter(|(_, end)| end == last) {
                let mut longer = path.clone();
                if path.contains(from) && !is_population(&self.flat.nodes[from].kind) {
                    return Err(wrong(format!("node '{from}' is in a loop without a neuron")));
                }
                longer.push(from.clone());
                if is_population(&self.flat.nodes[from].kind) {
                    // From the source, without the end.
                    let mut whole = longer[1..].to_vec();
                    whole.reverse();
                    paths.push(whole);
                } else {
                    open.push(longer);
                }
                if paths.len() + open.len() > MOST_PATHS {
                    return Err(wrong(format!("'{to}' receives input over more than {MOST_PATHS} paths")));
                }
            }
        }
        paths.sort();
        Ok(paths)
    }

    /// Populations in the order in which spikes reach them, inputs first.
    pub(super) fn order(&self, populations: &[String]) -> Vec<String> {
        let mut reached: Vec<String> =
            populations.iter().filter(|name| self.flat.nodes[*name].kind == "Input").cloned().collect();
        let mut seen: BTreeSet<String> = reached.iter().cloned().collect();
        let mut at = 0;
        while let Some(name) = reached.get(at).cloned() {
            let leaving = self.flat.edges.range((name.clone(), String::new())..).take_while(|(from, _)| *from == name);
            reached.extend(leaving.map(|(_, to)| to.clone()).filter(|to| seen.insert(to.clone())));
            at += 1;
        }
        reached.retain(|name| is_population(&self.flat.nodes[name].kind));
        reached.extend(populations.iter().filter(|name| !seen.contains(*name)).cloned());
        reached
    }
}
