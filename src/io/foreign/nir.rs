//! Networks in the neuromorphic intermediate representation (`.nir`, HDF5).
//!
//! Comes in: the tree of a file. Goes out: a draft with one population for each node that keeps a state. What stands
//! between two populations (`Linear`, `Affine`, `Scale`, `Conv1d`, `Conv2d`, `SumPool2d`, `AvgPool2d`, `Flatten`,
//! `Delay`) becomes one projection; graphs within graphs are unfolded; edges may form cycles.
//!
//! The equations are of continuous time (NIR 7232ada, `docs/source/primitives.md`); they are discretised as their
//! exporters do, by Euler's rule with the new current: `I <- (1 - dt / tau_syn) I + (dt / tau_syn) w_in x`,
//! `v <- (1 - dt / tau_mem) v + (dt / tau_mem) (R I + v_leak)`. So the effective decays are `4096 dt / tau`, rounded to even, and
//! a weight counts `(dt / tau_syn) w_in (dt / tau_mem) R` in the units of the threshold. The timestep is not in a file:
//! it is `tau_mem / R` where that agrees with `tau_syn / w_in` in every node, or it has to be said. A bias goes to v where
//! the current has no memory; where it has one, a compartment that spikes in every step brings it, from step 1 on. A
//! model that nsim exported is recognised and restored as it was ([`super::nir_export`]).
//!
//! Left out on purpose: reset by subtraction and resets to other values than zero, for which a core has no circuit.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use super::hdf5::{Group, Item, Numbers};
use super::{Imported, Options, ResetMode, nir_export};
use crate::base::diagnostic::Diagnostic;
use crate::io::draft::{Draft, DraftKind, DraftPopulation, DraftProjection, Value, tensor};

/// Synapses that are made one by one, all projections together.
const MOST_LISTED: usize = 1 << 20;
/// Graphs within graphs.
const DEEPEST: usize = 8;
/// Nodes and edges of a file.
const MOST_NODES: usize = 1 << 14;
/// Ways from one population to another.
const MOST_WAYS: usize = 1 << 12;
/// The greatest units of a population.
const MOST_UNITS: usize = 1 << 22;
/// The greatest threshold mantissa: what never spikes.
const NEVER: f64 = 131_071.0;
/// The longest delay field.
const LONGEST_DELAY: f64 = 62.0;

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.nir", message)
}

fn unsupported(message: impl Into<String>, help: &str) -> Diagnostic {
    Diagnostic::new("import.unsupported", message).help(help)
}

/// A node with its place in the unfolded graph.
struct Node<'a> {
    kind: String,
    group: &'a Group,
}

/// The graph without graphs in it.
#[derive(Default)]
struct Flat<'a> {
    nodes: BTreeMap<String, Node<'a>>,
    edges: BTreeSet<(String, String)>,
}

/// Reads the tree of a file.
///
/// # Errors
/// `import.nir` for what is malformed, `import.unsupported` for what a core cannot do, `import.option` for what the file
/// does not say.
pub fn read(root: &Group, name: &str, options: &Options) -> Result<Imported, Diagnostic> {
    let graph = root.group("node").ok_or_else(|| wrong("there is no group 'node'"))?;
    let mut notes = Vec::new();
    match nir_export::restore(root) {
        Some(Ok(draft)) => {
            notes.push("written by nsim and unchanged since: restored as it was".to_string());
            return Ok(Imported { kind: "NIR", draft, notes });
        }
        Some(Err(why)) => notes.push(format!("written by nsim, but {why}: read as any other file")),
        None => {}
    }
    if graph.text("type") != Some("NIRGraph") {
        return Err(wrong("its root is no NIRGraph"));
    }
    let mut flat = Flat::default();
    unfold(graph, "", 0, &mut flat)?;
    let mut reader = Reader {
        flat,
        options,
        draft: Draft::new(name, 1.0),
        notes,
        names: BTreeMap::new(),
        shapes: BTreeMap::new(),
        dt: 0.0,
        listed: 0,
    };
    reader.network()?;
    let Reader { mut draft, notes, .. } = reader;
    draft.provenance = Some(format!("imported from a NIR file; {}", notes.join("; ")));
    Ok(Imported { kind: "NIR", draft, notes })
}

/// Adds a graph's nodes under a prefix; edges that end at a graph end at its inputs, those that leave it leave its outputs.
fn unfold<'a>(graph: &'a Group, prefix: &str, depth: usize, flat: &mut Flat<'a>) -> Result<(), Diagnostic> {
    if depth > DEEPEST {
        return Err(wrong(format!("graphs are nested deeper than {DEEPEST}")));
    }
    let nodes = graph.group("nodes").ok_or_else(|| wrong("a graph has no group 'nodes'"))?;
    let mut graphs: BTreeMap<&str, (Vec<String>, Vec<String>)> = BTreeMap::new();
    let mut names: BTreeSet<&str> = BTreeSet::new();
    for (name, item) in &nodes.items {
        let Item::Group(node) = item else { return Err(wrong(format!("node '{name}' is no group"))) };
        let kind = node.text("type").ok_or_else(|| wrong(format!("node '{name}' does not say its type")))?;
        names.insert(name);
        let full = format!("{prefix}{name}");
        if full.len() > 512 || flat.nodes.len() >= MOST_NODES {
            return Err(wrong(format!("more than {MOST_NODES} nodes, or a name of more than 512 letters")));
        }
        if kind == "NIRGraph" {
            let inner = node.group("nodes");
            let of_kind = |wanted: &str| -> Vec<String> {
                let is = |item: &Item| matches!(item, Item::Group(group) if group.text("type") == Some(wanted));
                let members = inner.into_iter().flat_map(|nodes| nodes.items.iter());
                members.filter(|(_, item)| is(item)).map(|(inner, _)| format!("{full}/{inner}")).collect()
            };
            graphs.insert(name, (of_kind("Input"), of_kind("Output")));
            unfold(node, &format!("{full}/"), depth + 1, flat)?;
        } else {
            let kind = if depth > 0 && matches!(kind, "Input" | "Output") { "Pass" } else { kind };
            flat.nodes.insert(full, Node { kind: kind.to_string(), group: node });
        }
    }
    let edges: &[String] = match graph.get("edges") {
        Some(Item::Texts(shape, texts)) if shape.len() == 2 && shape[1] == 2 => texts,
        Some(Item::Texts(_, texts)) if texts.is_empty() => &[],
        Some(Item::Numbers(numbers)) if numbers.is_empty() => &[],
        _ => return Err(wrong("a graph's 'edges' are no pairs of names")),
    };
    for pair in edges.chunks_exact(2) {
        for end in pair {
            if !names.contains(end.as_str()) {
                return Err(wrong(format!("an edge names '{end}', which is no node")));
            }
        }
        let single = |end: &String| vec![format!("{prefix}{end}")];
        let from = graphs.get(pair[0].as_str()).map_or_else(|| single(&pair[0]), |ends| ends.1.clone());
        let to = graphs.get(pair[1].as_str()).map_or_else(|| single(&pair[1]), |ends| ends.0.clone());
        for (a, b) in from.iter().flat_map(|a| to.iter().map(move |b| (a, b))) {
            flat.edges.insert((a.clone(), b.clone()));
            if flat.edges.len() > MOST_NODES {
                return Err(wrong(format!("more than {MOST_NODES} edges")));
            }
        }
    }
    Ok(())
}

/// What a neuron is once it is discretised.
struct Discrete {
    du: Value,
    dv: Value,
    /// What a weight of 1 counts in the units of the threshold.
    gain: Value,
    /// None for what never spikes.
    threshold: Option<Value>,
    /// Added to v in each step.
    bias: Value,
}

/// What one population does to another over the nodes between them.
#[derive(Clone)]
struct Way {
    /// The shape that arrives.
    shape: Vec<usize>,
    linear: Linear,
    /// Added to what arrives in each step, one for each unit.
    bias: Option<Vec<f64>>,
    /// Delay in steps of each unit that arrives.
    delay: Option<Vec<u32>>,
}

/// The linear part of a way.
#[derive(Clone)]
enum Linear {
    /// Each unit, scaled by itself or by one number.
    Diagonal(Vec<f64>),
    /// `[target][source]`.
    Dense(Vec<f64>, usize),
    /// A window from one volume to another.
    Window(Window),
    /// (source, target, weight).
    List(Vec<(u64, u64, f64)>),
}

/// A convolution, or a sum over windows when it has no kernel.
#[derive(Clone)]
struct Window {
    source: [usize; 3],
    target: [usize; 3],
    size: (usize, usize),
    stride: (usize, usize),
    padding: (usize, usize),
    dilation: (usize, usize),
    groups: usize,
    /// `[out][in / groups][kh][kw]`, or one weight for a pool.
    kernel: Result<Vec<f64>, f64>,
}

impl Window {
    fn weight(&self, out: usize, within: usize, ky: usize, kx: usize) -> f64 {
        match &self.kernel {
            Ok(kernel) => {
                kernel[((out * (self.source[0] / self.groups) + within) * self.size.0 + ky) * self.size.1 + kx]
            }
            Err(weight) => *weight,
        }
    }

    /// Synapses one by one.
    fn list(&self) -> Option<Vec<(u64, u64, f64)>> {
        let (per_in, per_out) = (self.source[0] / self.groups, self.target[0] / self.groups);
        let many = [per_in, self.target[0], self.target[1], self.target[2], self.size.0, self.size.1];
        let many = many.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis))?;
        if many > MOST_LISTED {
            return None;
        }
        let mut list = Vec::new();
        for (o, y, x) in each3(self.target) {
            for (within, ky, kx) in each3([per_in, self.size.0, self.size.1]) {
                let sy = (y * self.stride.0 + ky * self.dilation.0).checked_sub(self.padding.0);
                let sx = (x * self.stride.1 + kx * self.dilation.1).checked_sub(self.padding.1);
                if let (Some(sy), Some(sx)) = (sy.filter(|&s| s < self.source[1]), sx.filter(|&s| s < self.source[2])) {
                    let channel = o / per_out * per_in + within;
                    let from = (channel * self.source[1] + sy) * self.source[2] + sx;
                    let to = (o * self.target[1] + y) * self.target[2] + x;
                    list.push((from as u64, to as u64, self.weight(o, within, ky, kx)));
                }
            }
        }
        Some(list)
    }

    /// This window and, behind it, another, as one: a pool without overlap or remainder before a convolution.
    fn then(&self, next: &Window) -> Option<Window> {
        let pool = *self.kernel.as_ref().err()?;
        let exact = self.size == self.stride && self.padding == (0, 0) && self.dilation == (1, 1);
        let whole = self.source[1] == self.target[1] * self.size.0 && self.source[2] == self.target[2] * self.size.1;
        if !exact || !whole || self.target != next.source {
            return None;
        }
        let (ph, pw) = self.size;
        let size = ((next.size.0 - 1) * next.dilation.0 * ph + ph, (next.size.1 - 1) * next.dilation.1 * pw + pw);
        let per_in = next.source[0] / next.groups;
        let count = [next.target[0], per_in, size.0, size.1].iter().try_fold(1usize, |n, &axis| n.checked_mul(axis))?;
        if count > MOST_LISTED {
            return None;
        }
        let mut kernel = vec![0.0; count];
        for (o, within) in (0..next.target[0]).flat_map(|o| (0..per_in).map(move |w| (o, w))) {
            for (ky, kx) in (0..next.size.0).flat_map(|ky| (0..next.size.1).map(move |kx| (ky, kx))) {
                let weight = next.weight(o, within, ky, kx) * pool;
                for (j, i) in (0..ph).flat_map(|j| (0..pw).map(move |i| (j, i))) {
                    let (y, x) = (ky * next.dilation.0 * ph + j, kx * next.dilation.1 * pw + i);
                    kernel[((o * per_in + within) * size.0 + y) * size.1 + x] = weight;
                }
            }
        }
        Some(Window {
            source: self.source,
            target: next.target,
            size,
            stride: (next.stride.0 * ph, next.stride.1 * pw),
            padding: (next.padding.0 * ph, next.padding.1 * pw),
            dilation: (1, 1),
            groups: next.groups,
            kernel: Ok(kernel),
        })
    }
}

fn each3([a, b, c]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..a).flat_map(move |a| (0..b).flat_map(move |b| (0..c).map(move |c| (a, b, c))))
}

fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis)).filter(|&units| units <= MOST_UNITS)
}

struct Reader<'a> {
    flat: Flat<'a>,
    options: &'a Options,
    draft: Draft,
    notes: Vec<String>,
    /// Populations' names by node.
    names: BTreeMap<String, String>,
    /// Populations' shapes by node.
    shapes: BTreeMap<String, Vec<usize>>,
    /// Seconds of a timestep.
    dt: f64,
    listed: usize,
}

/// Whether a node keeps a state, or is an input.
fn is_population(kind: &str) -> bool {
    matches!(kind, "Input" | "CubaLIF" | "LIF" | "IF" | "CubaLI" | "LI" | "I" | "Threshold")
}

/// Finite numbers of a field.
fn reals(node: &Group, name: &str, key: &str) -> Result<Vec<f64>, Diagnostic> {
    let numbers = node.numbers(key).ok_or_else(|| wrong(format!("node '{name}' has no array '{key}'")))?;
    let reals: Vec<f64> = numbers.reals().collect();
    match reals.iter().find(|x| !x.is_finite()) {
        Some(x) => Err(wrong(format!("node '{name}': '{key}' has a number that is {x}"))),
        None if reals.is_empty() => Err(wrong(format!("node '{name}': '{key}' is empty"))),
        None => Ok(reals),
    }
}

/// A field that may be absent.
fn optional(node: &Group, name: &str, key: &str, default: f64) -> Result<Value, Diagnostic> {
    match node.get(key) {
        Some(_) => Ok(Value::of(reals(node, name, key)?)),
        None => Ok(Value::Same(default)),
    }
}

fn parameter(node: &Group, name: &str, key: &str) -> Result<Value, Diagnostic> {
    Ok(Value::of(reals(node, name, key)?))
}

/// Entry by entry, where one number counts for all.
fn zip(a: &Value, b: &Value, f: impl Fn(f64, f64) -> f64) -> Value {
    match (a, b) {
        (Value::Same(a), b) => b.map(|b| f(*a, b)),
        (a, Value::Same(b)) => a.map(|a| f(a, *b)),
        (Value::Each(a), Value::Each(b)) => Value::of(a.iter().zip(b).map(|(&a, &b)| f(a, b)).collect()),
    }
}

fn all(value: &Value, f: impl Fn(f64) -> bool) -> bool {
    match value {
        Value::Same(x) => f(*x),
        Value::Each(values) => values.iter().all(|&x| f(x)),
    }
}

impl Reader<'_> {
    fn network(&mut self) -> Result<(), Diagnostic> {
        self.check_kinds()?;
        self.dt = self.timestep()?;
        let populations: Vec<String> = self
            .flat
            .nodes
            .iter()
            .filter(|(_, node)| is_population(&node.kind))
            .map(|(name, _)| name.clone())
            .collect();
        self.name_populations(&populations)?;
        self.find_shapes(&populations)?;
        // Inputs first, then the others in the order in which spikes reach them.
        let order = self.order(&populations);
        let mut discrete = BTreeMap::new();
        for name in &order {
            let neuron = self.discretise(name)?;
            discrete.insert(name.clone(), neuron);
        }
        let mut resets = false;
        for name in &order {
            let shape: Vec<u64> = self.shapes[name].iter().map(|&axis| axis as u64).collect();
            let loihi = discrete[name].as_ref().map(|neuron| {
                resets |= neuron.threshold.is_some();
                let mut parameters = vec![("du", neuron.du.clone()), ("dv", neuron.dv.clone())];
                match &neuron.threshold {
                    Some(threshold) => parameters.push(("vth", threshold.clone())),
                    None => parameters.push(("vth_mant", Value::Same(NEVER))),
                }
                parameters
            });
            let name = self.names[name].clone();
            self.draft.populations.push(DraftPopulation { name, shape, loihi, srm: None, start_step: 0 });
        }
        for name in &order {
            if let Some(neuron) = discrete.remove(name).flatten() {
                self.incoming(name, &neuron)?;
            }
        }
        self.output(&order)?;
        if resets && self.options.reset.is_none() {
            self.notes.push(
                "the file does not say how neurons reset; as on the chip v returns to zero (--reset zero says so; \
                 a network trained with reset by subtraction will differ)"
                    .to_string(),
            );
        }
        self.draft.timestep_ms = self.dt * 1e3;
        Ok(())
    }

    fn check_kinds(&self) -> Result<(), Diagnostic> {
        const LINEAR: [&str; 11] = [
            "Linear",
            "Affine",
            "Scale",
            "Conv1d",
            "Conv2d",
            "SumPool2d",
            "AvgPool2d",
            "Flatten",
            "Delay",
            "Pass",
            "Output",
        ];
        for (name, node) in &self.flat.nodes {
            if !is_population(&node.kind) && !LINEAR.contains(&node.kind.as_str()) {
                return Err(unsupported(
                    format!("node '{name}' is of the type '{}'", node.kind),
                    "imported are Input, Output, Linear, Affine, Scale, CubaLIF, LIF, IF, CubaLI, LI, I, Threshold, Conv1d, \
                     Conv2d, SumPool2d, AvgPool2d, Flatten, Delay and graphs of them",
                ));
            }
        }
        if self.options.reset == Some(ResetMode::Subtract) {
            return Err(unsupported(
                "neurons that subtract their threshold when they spike",
                "a compartment of Loihi returns to zero; train with a hard reset, or import with --reset zero and compare",
            ));
        }
        Ok(())
    }

    /// The timestep in seconds: said, or the one that all nodes agree on.
    fn timestep(&mut self) -> Result<f64, Diagnostic> {
        if let Some(dt) = self.options.dt_ms {
            self.notes.push(format!("timestep {dt} ms, as --dt says"));
            return Ok(dt / 1e3);
        }
        let (mut found, mut timed): (Vec<(String, f64)>, bool) = (Vec::new(), false);
        for (name, node) in &self.flat.nodes {
            let ratio = |tau: &str, by: &str| -> Result<Vec<f64>, Diagnostic> {
                let ratio =
                    zip(&parameter(node.group, name, tau)?, &optional(node.group, name, by, 1.0)?, |a, b| a / b);
                Ok(match ratio {
                    Value::Same(x) => vec![x],
                    Value::Each(values) => values,
                })
            };
            match node.kind.as_str() {
                "CubaLIF" | "CubaLI" => {
                    timed = true;
                    for (tau, by) in [("tau_mem", "r"), ("tau_syn", "w_in")] {
                        found.extend(ratio(tau, by)?.into_iter().map(|x| (name.clone(), x)));
                    }
                }
                "LIF" | "LI" => {
                    timed = true;
                    // A resistance of 1 is how nothing is said.
                    if !all(&optional(node.group, name, "r", 1.0)?, |r| r == 1.0) {
                        found.extend(ratio("tau", "r")?.into_iter().map(|x| (name.clone(), x)));
                    }
                }
                "Delay" => timed = true,
                _ => {}
            }
        }
        if !timed {
            self.notes.push("nothing in the file depends on the timestep: 1 ms".to_string());
            return Ok(1e-3);
        }
        let ask = |message: String| {
            Diagnostic::new("import.option", message).help("say how long a timestep is: --dt MS, for example --dt 0.1")
        };
        let Some((_, first)) = found.first().cloned() else {
            return Err(ask("the timestep is not in the file, and its nodes do not imply one".to_string()));
        };
        if let Some((name, other)) =
            found.iter().find(|(_, dt)| (dt / first - 1.0).abs().partial_cmp(&1e-3) != Some(Ordering::Less))
        {
            return Err(ask(format!(
                "the nodes do not imply one timestep: {:.6} ms by '{}', {:.6} ms by '{name}'",
                first * 1e3,
                found[0].0,
                other * 1e3
            )));
        }
        if !(first > 0.0 && first <= 1e3) {
            return Err(ask(format!("the nodes imply a timestep of {first} s")));
        }
        // Many exporters computed in single precision: a timestep has few digits.
        let digits: f64 = format!("{first:.4e}").parse().unwrap_or(first);
        let dt = if (digits / first - 1.0).abs() < 1e-5 { digits } else { first };
        self.notes.push(format!("timestep {:.6} ms: tau_mem / r, and tau_syn / w_in agrees", dt * 1e3));
        Ok(dt)
    }

    fn name_populations(&mut self, populations: &[String]) -> Result<(), Diagnostic> {
        let mut taken = BTreeSet::new();
        for name in populations {
            let plain: String =
                name.chars().map(|c| if c.is_alphanumeric() || c == '_' || c == '-' { c } else { '_' }).collect();
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

    /// `[n]` or `[channels, height, width]` of an array's axes.
    fn volume(shape: &[usize]) -> Vec<usize> {
        let mut shape = shape.to_vec();
        while shape.len() > 3 && shape[0] == 1 {
            shape.remove(0);
        }
        match shape.as_slice() {
            [] => vec![1],
            [_] | [_, _, _] => shape,
            // Channels of a line.
            [channels, length] => vec![*channels, 1, *length],
            _ => vec![product(&shape).unwrap_or(usize::MAX)],
        }
    }

    /// Shapes of populations: what inputs say, what parameters have, what arrives.
    fn find_shapes(&mut self, populations: &[String]) -> Result<(), Diagnostic> {
        for name in populations {
            let node = &self.flat.nodes[name];
            let shape = if node.kind == "Input" {
                let given = reals(node.group, name, "shape")?;
                let whole = given.iter().all(|x| x.fract() == 0.0 && (1.0..=MOST_UNITS as f64).contains(x));
                if !whole {
                    return Err(wrong(format!("input '{name}' has the shape {given:?}")));
                }
                Some(given.iter().map(|&x| x as usize).collect::<Vec<_>>())
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
        // Parameters of one number fit any shape: the one that arrives.
        for _ in 0..populations.len() {
            let missing: Vec<String> =
                populations.iter().filter(|name| !self.shapes.contains_key(*name)).cloned().collect();
            let mut changed = false;
            for name in &missing {
                for way in self.paths(name)? {
                    if let Some(shape) = self.shapes.get(&way[0]).cloned() {
                        let shape = self.walk(&shape, &way[1..])?.shape;
                        self.shapes.insert(name.clone(), shape);
                        changed = true;
                        break;
                    }
                }
            }
            if missing.is_empty() || !changed {
                break;
            }
        }
        for name in populations {
            self.shapes.entry(name.clone()).or_insert_with(|| vec![1]);
        }
        Ok(())
    }

    /// Every way that ends at a node: the population that it leaves, then the nodes on it.
    fn paths(&self, to: &str) -> Result<Vec<Vec<String>>, Diagnostic> {
        let mut ways = Vec::new();
        let mut open: Vec<Vec<String>> = vec![vec![to.to_string()]];
        while let Some(way) = open.pop() {
            let last = &way[way.len() - 1];
            for (from, _) in self.flat.edges.iter().filter(|(_, end)| end == last) {
                let mut longer = way.clone();
                if way.contains(from) && !is_population(&self.flat.nodes[from].kind) {
                    return Err(wrong(format!("node '{from}' feeds itself without a neuron in between")));
                }
                longer.push(from.clone());
                if is_population(&self.flat.nodes[from].kind) {
                    // Without the end, from the source on.
                    let mut whole = longer[1..].to_vec();
                    whole.reverse();
                    ways.push(whole);
                } else {
                    open.push(longer);
                }
                if ways.len() + open.len() > MOST_WAYS {
                    return Err(wrong(format!("more than {MOST_WAYS} ways lead to '{to}'")));
                }
            }
        }
        ways.sort();
        Ok(ways)
    }

    /// Populations in the order in which spikes reach them, inputs first.
    fn order(&self, populations: &[String]) -> Vec<String> {
        let mut order: Vec<String> =
            populations.iter().filter(|name| self.flat.nodes[*name].kind == "Input").cloned().collect();
        let mut seen: BTreeSet<String> = order.iter().cloned().collect();
        let mut next: Vec<String> = order.clone();
        let mut passed: BTreeSet<String> = seen.clone();
        while !next.is_empty() {
            let mut after = Vec::new();
            for name in &next {
                for (_, to) in
                    self.flat.edges.range((name.clone(), String::new())..).take_while(|(from, _)| from == name)
                {
                    if passed.insert(to.clone()) {
                        after.push(to.clone());
                        if is_population(&self.flat.nodes[to].kind) && seen.insert(to.clone()) {
                            order.push(to.clone());
                        }
                    }
                }
            }
            next = after;
        }
        order.extend(populations.iter().filter(|name| !seen.contains(*name)).cloned());
        order
    }

    /// A node's neuron in steps; nothing for an input.
    fn discretise(&mut self, name: &str) -> Result<Option<Discrete>, Diagnostic> {
        let node = &self.flat.nodes[name];
        let (group, dt) = (node.group, self.dt);
        let units = product(&self.shapes[name]).unwrap_or(0);
        let get = |key: &str, default: Option<f64>| -> Result<Value, Diagnostic> {
            let value = match default {
                Some(default) => optional(group, name, key, default)?,
                None => parameter(group, name, key)?,
            };
            match &value {
                Value::Each(values) if values.len() != units => {
                    Err(wrong(format!("node '{name}': '{key}' has {} numbers for {units} units", values.len())))
                }
                _ => Ok(value),
            }
        };
        let fraction = |key: &str| -> Result<Value, Diagnostic> {
            let tau = get(key, None)?;
            if !all(&tau, |tau| tau > 0.0) {
                return Err(wrong(format!("node '{name}': '{key}' is not above 0")));
            }
            if !all(&tau, |tau| dt <= tau * (1.0 + 1e-6)) {
                return Err(Diagnostic::new(
                    "import.option",
                    format!("node '{name}': a timestep of {} ms is longer than its '{key}'", dt * 1e3),
                )
                .help("give a shorter one with --dt MS; time constants of a file are in seconds"));
            }
            Ok(tau.map(|tau| (dt / tau).min(1.0)))
        };
        let decay = |fraction: &Value| fraction.map(|fraction| (4096.0 * fraction).round_ties_even());
        // `dt / tau * (tau / dt)`, which exporters write for "no scaling", is 1 but for rounding.
        let snapped = |gain: Value| gain.map(|gain| if (gain - 1.0).abs() < 1e-5 { 1.0 } else { gain });
        let forget = Value::Same(4096.0);
        let none = Value::Same(0.0);
        let spiking = matches!(node.kind.as_str(), "CubaLIF" | "LIF" | "IF");
        if spiking && !all(&get("v_reset", Some(0.0))?, |v| v == 0.0) {
            return Err(unsupported(
                format!("node '{name}' resets to another value than 0"),
                "a compartment of Loihi returns to zero",
            ));
        }
        let threshold = match node.kind.as_str() {
            "Threshold" => Some(get("threshold", None)?),
            _ if spiking => Some(get("v_threshold", None)?),
            _ => None,
        };
        if threshold.as_ref().is_some_and(|threshold| !all(threshold, |x| x > 0.0)) {
            return Err(unsupported(
                format!("node '{name}' has a threshold of 0 or below"),
                "a threshold mantissa is not negative, and weights are scaled by it",
            ));
        }
        let neuron = match node.kind.as_str() {
            "CubaLIF" | "CubaLI" => {
                let (synapse, membrane) = (fraction("tau_syn")?, fraction("tau_mem")?);
                let current = snapped(zip(&synapse, &get("w_in", Some(1.0))?, |a, b| a * b));
                let voltage = snapped(zip(&membrane, &get("r", Some(1.0))?, |a, b| a * b));
                Discrete {
                    du: decay(&synapse),
                    dv: decay(&membrane),
                    gain: zip(&current, &voltage, |a, b| a * b),
                    bias: zip(&membrane, &get("v_leak", Some(0.0))?, |a, b| a * b),
                    threshold,
                }
            }
            "LIF" | "LI" => {
                let membrane = fraction("tau")?;
                Discrete {
                    du: forget,
                    dv: decay(&membrane),
                    gain: snapped(zip(&membrane, &get("r", Some(1.0))?, |a, b| a * b)),
                    bias: zip(&membrane, &get("v_leak", Some(0.0))?, |a, b| a * b),
                    threshold,
                }
            }
            "IF" | "I" => {
                // Where nothing else has a timestep, exporters mean sums: a spike counts its weight.
                let said = self.options.dt_ms.is_some();
                let r = get("r", Some(1.0))?;
                let gain = if said && !all(&r, |r| r == 1.0) { r.map(|r| r * dt) } else { r };
                Discrete { du: forget, dv: none.clone(), gain: snapped(gain), bias: none, threshold }
            }
            "Threshold" => Discrete { du: forget.clone(), dv: forget, gain: Value::Same(1.0), bias: none, threshold },
            _ => return Ok(None),
        };
        let shown = |value: &Value| match value {
            Value::Same(x) => format!("{x}"),
            Value::Each(_) => "each its own".to_string(),
        };
        self.notes.push(format!(
            "'{name}' ({}): du {}, dv {}, a weight counts {}",
            self.flat.nodes[name].kind,
            shown(&neuron.du),
            shown(&neuron.dv),
            shown(&neuron.gain)
        ));
        Ok(Some(neuron))
    }

    /// What arrives at the end of nodes that are passed from a population of this shape.
    fn walk(&self, source: &[usize], nodes: &[String]) -> Result<Way, Diagnostic> {
        let mut way = Way { shape: source.to_vec(), linear: Linear::Diagonal(vec![1.0]), bias: None, delay: None };
        for name in nodes {
            way = self.pass(way, name)?;
        }
        Ok(way)
    }

    fn pass(&self, mut way: Way, name: &str) -> Result<Way, Diagnostic> {
        let node = &self.flat.nodes[name];
        let group = node.group;
        let units = product(&way.shape).ok_or_else(|| wrong(format!("'{name}' hears too many units")))?;
        match node.kind.as_str() {
            "Pass" | "Output" => {}
            // Every population is flattened in C order; the batch axis is not in a file.
            "Flatten" => way.shape = vec![units],
            "Scale" => {
                let scale = reals(group, name, "scale")?;
                let scale = spread(scale, &way.shape)
                    .ok_or_else(|| wrong(format!("node '{name}': its scale does not fit the shape {:?}", way.shape)))?;
                way.bias = way.bias.map(|bias| bias.iter().enumerate().map(|(i, b)| b * at(&scale, i)).collect());
                way.linear = scaled(way.linear, &scale, &way.shape).ok_or_else(|| self.too_many(name))?;
            }
            "Linear" | "Affine" => {
                let numbers = group.numbers("weight").ok_or_else(|| wrong(format!("node '{name}' has no weight")))?;
                let weights = reals(group, name, "weight")?;
                let &[targets, sources] = numbers.shape() else {
                    return Err(wrong(format!("node '{name}': its weight is {:?}", numbers.shape())));
                };
                if sources != units {
                    return Err(wrong(format!(
                        "node '{name}': its weight is {:?} and {units} units arrive",
                        numbers.shape()
                    )));
                }
                self.no_bias_yet(&way, name)?;
                way.linear = self.then_dense(way.linear, weights, targets, sources, name)?;
                way.shape = vec![targets];
                way.bias = self.bias(group, name, &way.shape)?;
            }
            "Conv1d" | "Conv2d" | "SumPool2d" | "AvgPool2d" => {
                let window = self.window(&way.shape, name)?;
                self.no_bias_yet(&way, name)?;
                let target = window.target.to_vec();
                way.linear = self.then_window(way.linear, window, &way.shape, name)?;
                way.shape = target;
                way.bias = self.bias(group, name, &way.shape)?;
            }
            "Delay" => {
                let delays = reals(group, name, "delay")?;
                let delays = spread(delays, &way.shape)
                    .ok_or_else(|| wrong(format!("node '{name}': its delays do not fit the shape {:?}", way.shape)))?;
                let steps = delays.iter().map(|delay| (delay / self.dt).round_ties_even()).collect::<Vec<_>>();
                if let Some(long) = steps.iter().find(|steps| !(0.0..=LONGEST_DELAY).contains(*steps)) {
                    return Err(unsupported(
                        format!("node '{name}' delays by {long} steps of {} ms", self.dt * 1e3),
                        "the delay field holds 0 to 62 steps",
                    ));
                }
                if way.delay.is_some() {
                    return Err(unsupported(format!("node '{name}' is the second delay of a way"), "join them"));
                }
                way.delay = Some((0..units).map(|unit| at(&steps, unit) as u32).collect());
            }
            other => return Err(wrong(format!("node '{name}' of the type '{other}' is in the middle of a way"))),
        }
        Ok(way)
    }

    fn no_bias_yet(&self, way: &Way, name: &str) -> Result<(), Diagnostic> {
        let silent = way.bias.as_ref().is_none_or(|bias| bias.iter().all(|&b| b == 0.0));
        if silent && way.delay.as_ref().is_none_or(|delays| delays.windows(2).all(|pair| pair[0] == pair[1])) {
            return Ok(());
        }
        Err(unsupported(
            format!("before node '{name}' a bias or delays of their own were added, without a neuron in between"),
            "join the layers into one",
        ))
    }

    /// The bias that a node adds, unless it is zero.
    fn bias(&self, group: &Group, name: &str, shape: &[usize]) -> Result<Option<Vec<f64>>, Diagnostic> {
        if group.get("bias").is_none() {
            return Ok(None);
        }
        let bias = reals(group, name, "bias")?;
        if bias.iter().all(|&b| b == 0.0) {
            return Ok(None);
        }
        let bias =
            spread(bias, shape).ok_or_else(|| wrong(format!("node '{name}': its bias does not fit {shape:?}")))?;
        let units = product(shape).unwrap_or(0);
        Ok(Some((0..units).map(|unit| at(&bias, unit)).collect()))
    }

    fn window(&self, shape: &[usize], name: &str) -> Result<Window, Diagnostic> {
        let node = &self.flat.nodes[name];
        let bad = |what: String| wrong(format!("node '{name}': {what}"));
        let &[channels, height, width] = shape else {
            return Err(bad(format!("the shape {shape:?} that arrives has no height and width")));
        };
        let line = node.kind == "Conv1d";
        let pair = |key: &str, default: usize, least: f64| -> Result<(usize, usize), Diagnostic> {
            if node.group.get(key).is_none() {
                return Ok((default, default));
            }
            let numbers = reals(node.group, name, key)?;
            if numbers.iter().any(|x| x.fract() != 0.0 || !(least..=65_535.0).contains(x)) {
                return Err(bad(format!("'{key}' is {numbers:?}")));
            }
            match numbers.as_slice() {
                [one] if line => Ok((default.min(1), *one as usize)),
                [one] => Ok((*one as usize, *one as usize)),
                [y, x] if !line => Ok((*y as usize, *x as usize)),
                _ => Err(bad(format!("'{key}' is {numbers:?}"))),
            }
        };
        let conv = matches!(node.kind.as_str(), "Conv1d" | "Conv2d");
        let (size, out, groups, kernel) = if conv {
            let numbers = node.group.numbers("weight").ok_or_else(|| bad("it has no weight".to_string()))?;
            let (out, per_group, size) = match *numbers.shape() {
                [out, per_group, kw] if line => (out, per_group, (1, kw)),
                [out, per_group, kh, kw] if !line => (out, per_group, (kh, kw)),
                _ => return Err(bad(format!("its weight is {:?}", numbers.shape()))),
            };
            let groups = pair("groups", 1, 1.0)?.1;
            if per_group.checked_mul(groups) != Some(channels) || out % groups != 0 || out == 0 || size.0 * size.1 == 0
            {
                return Err(bad(format!(
                    "its weight is {:?} in {groups} groups, {channels} channels arrive",
                    numbers.shape()
                )));
            }
            (size, out, groups, Ok(reals(node.group, name, "weight")?))
        } else {
            let size = pair("kernel_size", 1, 1.0)?;
            let weight = if node.kind == "AvgPool2d" { 1.0 / (size.0 * size.1) as f64 } else { 1.0 };
            (size, channels, channels, Err(weight))
        };
        let stride = pair("stride", 1, 1.0)?;
        let dilation = if conv { pair("dilation", 1, 1.0)? } else { (1, 1) };
        let padding = match node.group.text("padding") {
            Some("valid") => (0, 0),
            Some("same") => {
                let reach = (dilation.0 * (size.0 - 1), dilation.1 * (size.1 - 1));
                if reach.0 % 2 != 0 || reach.1 % 2 != 0 || stride != (1, 1) {
                    return Err(unsupported(
                        format!("node '{name}': padding 'same' of an even kernel, or with a stride"),
                        "give the padding as numbers",
                    ));
                }
                (reach.0 / 2, reach.1 / 2)
            }
            Some(other) => return Err(bad(format!("padding '{}'", other.chars().take(40).collect::<String>()))),
            None => {
                let (y, x) = pair("padding", 0, 0.0)?;
                if line { (0, x) } else { (y, x) }
            }
        };
        let side = |n: usize, size: usize, stride: usize, padding: usize, dilation: usize| {
            (n + 2 * padding).checked_sub(dilation * (size - 1) + 1).map(|room| room / stride + 1)
        };
        let target = (
            side(height, size.0, stride.0, padding.0, dilation.0),
            side(width, size.1, stride.1, padding.1, dilation.1),
        );
        let (Some(to_h), Some(to_w)) = target else {
            return Err(bad(format!("its window is larger than the {height} x {width} that arrive")));
        };
        if product(&[out, to_h, to_w]).is_none() {
            return Err(bad(format!("it makes more than {MOST_UNITS} units")));
        }
        let (source, target) = ([channels, height, width], [out, to_h, to_w]);
        Ok(Window { source, target, size, stride, padding, dilation, groups, kernel })
    }

    fn too_many(&self, name: &str) -> Diagnostic {
        unsupported(
            format!(
                "node '{name}' follows another without a neuron in between, and their product has too many synapses"
            ),
            "put a neuron between them, or join them into one layer",
        )
    }

    fn then_dense(
        &self,
        before: Linear,
        weights: Vec<f64>,
        targets: usize,
        sources: usize,
        name: &str,
    ) -> Result<Linear, Diagnostic> {
        match before {
            Linear::Diagonal(scale) if scale.iter().all(|&s| s == 1.0) => Ok(Linear::Dense(weights, sources)),
            Linear::Diagonal(scale) => {
                let scaled = weights.iter().enumerate().map(|(i, w)| w * at(&scale, i % sources)).collect();
                Ok(Linear::Dense(scaled, sources))
            }
            before => {
                let list = self.listed(before, name)?;
                let inputs = list.iter().map(|s| s.0 + 1).max().unwrap_or(1) as usize;
                let whole = targets.checked_mul(inputs).filter(|&n| n <= MOST_LISTED);
                let work = targets.checked_mul(list.len()).filter(|&n| n <= 64 * MOST_LISTED);
                let (Some(whole), Some(_)) = (whole, work) else { return Err(self.too_many(name)) };
                let mut dense = vec![0.0; whole];
                for &(from, via, weight) in &list {
                    for target in 0..targets {
                        dense[target * inputs + from as usize] += weight * weights[target * sources + via as usize];
                    }
                }
                Ok(Linear::Dense(dense, inputs))
            }
        }
    }

    fn then_window(&self, before: Linear, window: Window, shape: &[usize], name: &str) -> Result<Linear, Diagnostic> {
        match before {
            Linear::Diagonal(scale) if scale.len() == 1 => {
                let kernel = match window.kernel {
                    Ok(kernel) => Ok(kernel.iter().map(|w| w * scale[0]).collect()),
                    Err(weight) => Err(weight * scale[0]),
                };
                Ok(Linear::Window(Window { kernel, ..window }))
            }
            Linear::Window(first) if first.then(&window).is_some() => {
                first.then(&window).map(Linear::Window).ok_or_else(|| self.too_many(name))
            }
            before => {
                let units = product(shape).unwrap_or(0);
                let first = match before {
                    Linear::Diagonal(scale) => (0..units as u64).map(|i| (i, i, at(&scale, i as usize))).collect(),
                    before => self.listed(before, name)?,
                };
                let second = window.list().ok_or_else(|| self.too_many(name))?;
                let mut by_source: BTreeMap<u64, Vec<(u64, f64)>> = BTreeMap::new();
                for (via, to, weight) in second {
                    by_source.entry(via).or_default().push((to, weight));
                }
                let mut sums: BTreeMap<(u64, u64), f64> = BTreeMap::new();
                for (from, via, weight) in first {
                    for &(to, next) in by_source.get(&via).map_or(&[][..], Vec::as_slice) {
                        *sums.entry((to, from)).or_default() += weight * next;
                    }
                    if sums.len() > MOST_LISTED / 4 {
                        return Err(self.too_many(name));
                    }
                }
                Ok(Linear::List(sums.into_iter().map(|((to, from), weight)| (from, to, weight)).collect()))
            }
        }
    }

    /// A linear part synapse by synapse; a diagonal has no size of its own.
    fn listed(&self, linear: Linear, name: &str) -> Result<Vec<(u64, u64, f64)>, Diagnostic> {
        match linear {
            Linear::List(list) => Ok(list),
            Linear::Window(window) => window.list().ok_or_else(|| self.too_many(name)),
            Linear::Dense(weights, sources) if weights.len() <= MOST_LISTED => {
                Ok(weights.iter().enumerate().map(|(i, &w)| ((i % sources) as u64, (i / sources) as u64, w)).collect())
            }
            Linear::Diagonal(scale) => Ok(scale.iter().enumerate().map(|(i, &s)| (i as u64, i as u64, s)).collect()),
            Linear::Dense(..) => Err(self.too_many(name)),
        }
    }

    /// Everything that a population hears: projections, and its bias.
    fn incoming(&mut self, name: &str, neuron: &Discrete) -> Result<(), Diagnostic> {
        let shape = self.shapes[name].clone();
        let units = product(&shape).unwrap_or(0);
        let mut bias: Vec<f64> = (0..units).map(|unit| neuron.bias.get(unit)).collect();
        let mut current = vec![0.0; 0];
        let memory = !all(&neuron.du, |du| du == 4096.0);
        let mut projections = Vec::new();
        for way in self.paths(name)? {
            let arrived = self.walk(&self.shapes[&way[0]].clone(), &way[1..])?;
            if product(&arrived.shape) != Some(units) {
                return Err(wrong(format!(
                    "{:?} arrives at '{name}', which has {shape:?}: its shape differs from that of its parameters",
                    arrived.shape
                )));
            }
            if let Some(added) = &arrived.bias {
                if memory {
                    current.resize(units, 0.0);
                    current.iter_mut().zip(added).for_each(|(sum, b)| *sum += b);
                } else {
                    bias.iter_mut().zip(added).enumerate().for_each(|(i, (sum, b))| *sum += b * neuron.gain.get(i));
                }
            }
            projections.extend(self.projections(&way[0], name, arrived, &neuron.gain)?);
        }
        if current.iter().any(|&b| b != 0.0) {
            let weights: Vec<f64> = current.iter().enumerate().map(|(i, b)| b * neuron.gain.get(i)).collect();
            let source = self.always();
            let kind = DraftKind::Dense(tensor(vec![units, 1], weights));
            projections.push(DraftProjection::new(&source, &self.names[name], kind));
            self.notes.push(format!(
                "'{name}': its current keeps a bias, which '{source}', a compartment that spikes in every step, brings from step 1 on"
            ));
        }
        let to = self.names[name].clone();
        let mut parameters = Vec::new();
        if neuron.threshold.is_none() {
            // What never spikes is in integers: the largest weight takes the whole mantissa.
            let most = projections.iter().map(|p| greatest(&p.kind)).fold(0.0, f64::max);
            let scale = if most > 0.0 { 254.0 / most } else { 1.0 };
            for projection in &mut projections {
                projection.weight_scale = Some(scale);
            }
            if bias.iter().any(|&b| b != 0.0) {
                let register: Vec<f64> = bias.iter().map(|b| b * scale * 64.0).collect();
                let exponent =
                    (0..=7).find(|&e| register.iter().all(|b| (b / f64::from(1 << e)).abs() <= 4095.0)).ok_or_else(
                        || unsupported(format!("the bias of '{name}' is beyond its weights"), "scale it down"),
                    )?;
                let mantissas = register.iter().map(|b| (b / f64::from(1 << exponent)).round_ties_even()).collect();
                parameters.push(("bias_mant", Value::of(mantissas)));
                parameters.push(("bias_exp", Value::Same(f64::from(exponent))));
            }
            self.notes.push(format!("'{name}' never spikes: its v counts {} for a unit", scale * 64.0));
        } else if bias.iter().any(|&b| b != 0.0) {
            parameters.push(("bias", Value::of(bias)));
        }
        let population = self.draft.populations.iter_mut().find(|population| population.name == to);
        if let Some(loihi) = population.and_then(|population| population.loihi.as_mut()) {
            loihi.extend(parameters);
        }
        self.draft.projections.extend(projections);
        Ok(())
    }

    /// The compartment that spikes in every step.
    fn always(&mut self) -> String {
        let mut name = "always".to_string();
        while self.names.values().any(|taken| *taken == name) {
            name.push('_');
        }
        if self.draft.population(&name).is_none() {
            let parameters = [("du", 4096.0), ("dv", 4096.0), ("vth_mant", 0.0), ("bias_mant", 1.0), ("bias_exp", 0.0)];
            self.draft.populations.push(DraftPopulation {
                name: name.clone(),
                shape: vec![1],
                loihi: Some(parameters.into_iter().map(|(key, value)| (key, Value::Same(value))).collect()),
                srm: None,
                start_step: 0,
            });
        }
        name
    }

    /// A way as projections: one, or one for each delay.
    fn projections(
        &mut self,
        from: &str,
        to: &str,
        way: Way,
        gain: &Value,
    ) -> Result<Vec<DraftProjection>, Diagnostic> {
        let target = self.shapes[to].clone();
        let source_units = product(&self.shapes[from]).unwrap_or(0);
        let units = product(&target).unwrap_or(0);
        let gains = match gain {
            Value::Same(gain) => vec![*gain],
            Value::Each(gains) => gains.clone(),
        };
        let linear = scaled(way.linear, &gains, &way.shape).ok_or_else(|| self.too_many(to))?;
        let (from_name, to_name) = (self.names[from].clone(), self.names[to].clone());
        let source_volume = self.shapes[from].len() == 3;
        let kind = match linear {
            Linear::Dense(mut weights, sources) => {
                // A product may not reach the last sources.
                if sources < source_units {
                    let mut wide = vec![0.0; units * source_units];
                    for (row, old) in wide.chunks_exact_mut(source_units).zip(weights.chunks_exact(sources)) {
                        row[..sources].copy_from_slice(old);
                    }
                    weights = wide;
                }
                DraftKind::Dense(tensor(vec![units, source_units], weights))
            }
            Linear::Window(window) if target == window.target && source_volume => {
                let pair = |(y, x): (usize, usize)| (y as u64, x as u64);
                let per_group = window.source[0] / window.groups;
                match window.kernel {
                    Ok(kernel) => DraftKind::Conv2d {
                        weights: tensor(vec![window.target[0], per_group, window.size.0, window.size.1], kernel),
                        stride: pair(window.stride),
                        padding: pair(window.padding),
                        dilation: pair(window.dilation),
                        groups: window.groups as u64,
                    },
                    Err(weight) => DraftKind::SumPool2d {
                        kernel: pair(window.size),
                        stride: pair(window.stride),
                        padding: pair(window.padding),
                        weight,
                    },
                }
            }
            Linear::Diagonal(scale) => {
                self.count(units)?;
                DraftKind::Sparse((0..units as u64).map(|i| (i, i, at(&scale, i as usize))).collect())
            }
            other => DraftKind::Sparse(self.listed(other, to)?),
        };
        if let DraftKind::Sparse(synapses) = &kind {
            self.count(synapses.len())?;
        }
        let delays = way.delay.unwrap_or_default();
        let first = delays.first().copied().unwrap_or(0);
        let mut projection = DraftProjection { delay: first, ..DraftProjection::new(&from_name, &to_name, kind) };
        if delays.iter().all(|&delay| delay == first) {
            return Ok(vec![projection]);
        }
        let synapses: Vec<(u64, u64, f64)> = match projection.kind {
            DraftKind::Sparse(synapses) => synapses,
            DraftKind::Dense(weights) => {
                self.count(weights.len())?;
                let sources = source_units as u64;
                (0..weights.len() as u64).map(|i| (i % sources, i / sources, weights.real(i as usize))).collect()
            }
            _ => {
                return Err(unsupported(
                    format!("'{to}' hears a convolution with delays that differ"),
                    "give it one delay",
                ));
            }
        };
        let mut by_delay: BTreeMap<u32, Vec<(u64, u64, f64)>> = BTreeMap::new();
        for synapse in synapses {
            by_delay.entry(delays[synapse.1 as usize]).or_default().push(synapse);
        }
        projection.kind = DraftKind::Sparse(Vec::new());
        Ok(by_delay
            .into_iter()
            .map(|(delay, synapses)| DraftProjection { delay, kind: DraftKind::Sparse(synapses), ..projection.clone() })
            .collect())
    }

    /// Counts synapses that are listed one by one.
    fn count(&mut self, synapses: usize) -> Result<(), Diagnostic> {
        self.listed += synapses;
        if self.listed > MOST_LISTED {
            return Err(unsupported(
                format!("more than {MOST_LISTED} synapses would be listed one by one"),
                "projections that are no matrix and no window are listed",
            ));
        }
        Ok(())
    }

    /// The population that decides: the one that leads to the output, or integrators that show what does.
    fn output(&mut self, order: &[String]) -> Result<(), Diagnostic> {
        let outputs: Vec<String> =
            self.flat.nodes.iter().filter(|(_, node)| node.kind == "Output").map(|(name, _)| name.clone()).collect();
        let mut leading: Vec<(Vec<String>, String)> = Vec::new();
        for output in &outputs {
            leading.extend(self.paths(output)?.into_iter().map(|way| (way, output.clone())));
        }
        let neurons = |name: &String| self.flat.nodes[name].kind != "Input";
        let Some((way, output)) = leading.iter().find(|(way, _)| neurons(&way[0])).or(leading.first()) else {
            let last = order.iter().rev().find(|name| neurons(name)).ok_or_else(|| wrong("it has no neurons"))?;
            self.draft.output = self.names[last].clone();
            self.notes.push(format!("no way leads to an output; '{}' is taken for it", self.draft.output));
            return Ok(());
        };
        if leading.len() > 1 {
            self.notes.push(format!("{} ways lead to outputs; '{}' is taken", leading.len(), way[0]));
        }
        let plain = way[1..].iter().all(|name| matches!(self.flat.nodes[name].kind.as_str(), "Pass" | "Flatten"));
        if plain && neurons(&way[0]) {
            self.draft.output = self.names[&way[0]].clone();
            return Ok(());
        }
        // Weights without a neuron behind them: v shows what they sum in each step.
        let arrived = self.walk(&self.shapes[&way[0]].clone(), &way[1..])?;
        let output = output.clone();
        let mut name = "output".to_string();
        while self.names.values().any(|taken| *taken == name) {
            name.push('_');
        }
        self.names.insert(output.clone(), name.clone());
        self.shapes.insert(output.clone(), arrived.shape.clone());
        let shape = arrived.shape.iter().map(|&axis| axis as u64).collect();
        let parameters =
            vec![("du", Value::Same(4096.0)), ("dv", Value::Same(4096.0)), ("vth_mant", Value::Same(NEVER))];
        self.draft.populations.push(DraftPopulation {
            name: name.clone(),
            shape,
            loihi: Some(parameters),
            srm: None,
            start_step: 0,
        });
        let neuron = Discrete {
            du: Value::Same(4096.0),
            dv: Value::Same(4096.0),
            gain: Value::Same(1.0),
            threshold: None,
            bias: Value::Same(0.0),
        };
        self.notes
            .push(format!("weights lead to '{output}' without a neuron: '{name}' shows their sum of each step as v"));
        self.incoming(&output, &neuron)?;
        self.draft.output = name;
        Ok(())
    }
}

/// One number for all, for each channel or for each unit, as one for all or one for each.
fn spread(numbers: Vec<f64>, shape: &[usize]) -> Option<Vec<f64>> {
    let units = product(shape)?;
    match numbers.len() {
        1 => Some(numbers),
        n if n == units => Some(numbers),
        n if n == shape[0] => {
            let each = units / n;
            Some((0..units).map(|unit| numbers[unit / each]).collect())
        }
        _ => None,
    }
}

/// A number of a list that may hold one for all.
fn at(numbers: &[f64], index: usize) -> f64 {
    if numbers.len() == 1 { numbers[0] } else { numbers[index] }
}

/// A linear part with each target scaled; nothing when that has too many synapses.
fn scaled(linear: Linear, scale: &[f64], shape: &[usize]) -> Option<Linear> {
    if scale.iter().all(|&s| s == 1.0) {
        return Some(linear);
    }
    Some(match linear {
        Linear::Diagonal(old) => {
            let length = old.len().max(scale.len());
            Linear::Diagonal((0..length).map(|i| at(&old, i) * at(scale, i)).collect())
        }
        Linear::Dense(weights, sources) => {
            Linear::Dense(weights.iter().enumerate().map(|(i, w)| w * at(scale, i / sources)).collect(), sources)
        }
        Linear::List(list) => {
            Linear::List(list.into_iter().map(|(from, to, w)| (from, to, w * at(scale, to as usize))).collect())
        }
        Linear::Window(window) => {
            let plane = shape.iter().skip(1).product::<usize>().max(1);
            let channel_wise = scale.len() == 1 || scale.chunks(plane).all(|c| c.iter().all(|s| *s == c[0]));
            if !channel_wise {
                // Scales that differ within a channel: no kernel holds them.
                return scaled(Linear::List(window.list()?), scale, shape);
            }
            let kernel = match window.kernel {
                Err(weight) if scale.len() == 1 => Err(weight * scale[0]),
                Err(weight) => {
                    let places = window.size.0 * window.size.1;
                    Ok((0..window.target[0] * places).map(|i| weight * scale[i / places * plane]).collect())
                }
                Ok(kernel) => {
                    let each = kernel.len() / window.target[0];
                    Ok(kernel.iter().enumerate().map(|(i, w)| w * at(scale, i / each * plane)).collect())
                }
            };
            Linear::Window(Window { kernel, ..window })
        }
    })
}

/// The greatest magnitude of a projection's weights.
fn greatest(kind: &DraftKind) -> f64 {
    match kind {
        DraftKind::Dense(weights) | DraftKind::Conv2d { weights, .. } => {
            (0..weights.len()).map(|i| weights.real(i).abs()).fold(0.0, f64::max)
        }
        DraftKind::Sparse(synapses) => synapses.iter().map(|s| s.2.abs()).fold(0.0, f64::max),
        DraftKind::SumPool2d { weight, .. } => weight.abs(),
    }
}
