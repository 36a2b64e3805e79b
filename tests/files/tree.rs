//! Trees of files in the form of other tools.

use nsim::import::hdf5::{Group, Item, Numbers};

/// A node or a layer of a type.
pub fn typed(kind: &str) -> Group {
    Group::default().with("type", kind)
}

/// A scalar.
pub fn int(x: i64) -> Numbers {
    Numbers::i64(&[], &[x])
}

pub fn ints(x: &[i64]) -> Numbers {
    Numbers::i64(&[x.len()], x)
}

pub fn reals(x: &[f64]) -> Numbers {
    Numbers::f64(&[x.len()], x)
}

/// A node with one real value of each field for all of its units.
pub fn node(kind: &str, axes: &[usize], fields: &[(&str, f64)]) -> Group {
    let all = |value: f64| Numbers::f64(axes, &vec![value; axes.iter().product()]);
    fields.iter().fold(typed(kind), |node, (key, value)| node.with(key, all(*value)))
}

/// A NIR file of these nodes and edges.
pub fn nir<'n>(
    nodes: impl IntoIterator<Item = (&'n str, Group)>,
    edges: impl IntoIterator<Item = (&'n str, &'n str)>,
) -> Group {
    let nodes = nodes.into_iter().fold(Group::default(), |nodes, (name, node)| nodes.with(name, node));
    let ends: Vec<String> = edges.into_iter().flat_map(|(from, to)| [from.to_string(), to.to_string()]).collect();
    let edges = Item::Texts(vec![ends.len() / 2, 2], ends);
    Group::default().with("version", "1.0.8").with("node", typed("NIRGraph").with("nodes", nodes).with("edges", edges))
}
