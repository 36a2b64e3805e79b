//! The nodes between two populations as one linear map.
//!
//! Input: the nodes on a connection. Output: its shape, linear part, bias and delays.

use std::collections::BTreeMap;
use std::fmt::Display;

use super::export::by_channel;
use super::filter::cannot_send;
use super::linear::{Connection, Linear, Window, all_equal, at, scaled, spread, sum_of_delays};
use super::node_types::{FILTER, Node};
use super::state::{MOST_UNITS, Reader, axes, product, reals, unsupported, wrong};
use crate::foreign::imported::LONGEST_DELAY;
use crate::foreign::window::{MOST_LISTED, Sliding, Synapses};
use crate::hdf5::Group;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// Help to join layers without neurons between them.
const JOIN_HELP: &str = "put a neuron between them, or join them into one layer. A convolution of stride s followed by \
                      a pool without padding is read as one convolution with kernels of size k + (p - 1) s";

impl Reader<'_> {
    /// The linear map of `nodes` after a population of the shape `source`.
    pub(super) fn linear_map(&self, source: &[usize], nodes: &[String]) -> Result<Connection> {
        let (linear, bias) = (Linear::Diagonal(vec![1.0]), None);
        let mut connection = Connection {
            shape: source.to_vec(),
            linear,
            bias,
            filter: None,
            source_delay: Vec::new(),
            delay: Vec::new(),
        };
        for name in nodes {
            connection = self.apply_node(connection, name)?;
        }
        Ok(connection)
    }

    pub(super) fn apply_node(&self, mut connection: Connection, name: &str) -> Result<Connection> {
        let node = &self.flat.nodes[name];
        let group = node.group;
        let units =
            product(&connection.shape).ok_or_else(|| wrong(format!("'{name}' receives from too many units")))?;
        match node.kind.as_str() {
            "Pass" | "Output" => {
                self.check_shape(name, units)?;
                // Windows slide over these axes.
                if let Some(shape) = group.numbers("shape") {
                    let volume = Self::volume(&shape.reals().map(|axis| axis as usize).collect::<Vec<_>>());
                    if volume.len() == 3 {
                        connection.shape = volume;
                    }
                }
            }
            FILTER => self.apply_filter(&mut connection, name, units)?,
            // Populations are flattened in C order; files have no batch axis.
            "Flatten" => {
                let start = group.number("start_dim").unwrap_or(1.0);
                let end = group.number("end_dim").unwrap_or(-1.0);
                let axes = connection.shape.len() as f64;
                if !(start == 0.0 || start == 1.0) || !(end == -1.0 || end >= axes - 1.0) {
                    return Err(unsupported(
                        format!("node '{name}' flattens only the axes {start} to {end} of {:?}", connection.shape),
                        "flatten all axes: start_dim 0 (or 1, after a batch axis), end_dim -1",
                    ));
                }
                connection.shape = vec![units];
            }
            "Scale" => {
                let scale = reals(group, name, "scale")?;
                let scale = spread(scale, &connection.shape).ok_or_else(|| {
                    wrong(format!("node '{name}': its scale does not fit the shape {:?}", connection.shape))
                })?;
                connection.bias =
                    connection.bias.map(|bias| bias.iter().enumerate().map(|(i, b)| b * at(&scale, i)).collect());
                connection.linear =
                    scaled(connection.linear, &scale, &connection.shape).ok_or_else(|| self.too_many(name))?;
            }
            "Linear" | "Affine" => connection = self.after_matrix(connection, name, units)?,
            "Conv1d" | "Conv2d" | "SumPool2d" | "AvgPool2d" => connection = self.after_window(connection, name)?,
            "Delay" => connection.delay = self.later(&connection, name)?,
            other => return Err(wrong(format!("node '{name}' of type '{other}' cannot be between two other nodes"))),
        }
        Ok(connection)
    }

    /// A connection of `units` units, followed by the weights of a node.
    fn after_matrix(&self, mut connection: Connection, name: &str, units: usize) -> Result<Connection> {
        let group = self.flat.nodes[name].group;
        let numbers = group.numbers("weight").ok_or_else(|| wrong(format!("node '{name}' has no weight")))?;
        let weights = reals(group, name, "weight")?;
        let &[targets, sources] = numbers.shape() else {
            return Err(wrong(format!("node '{name}': its weight is {:?}", numbers.shape())));
        };
        if sources != units {
            return Err(wrong(format!(
                "node '{name}': its weight is {:?}, but its input has {units} units",
                numbers.shape()
            )));
        }
        self.check_filter(&connection, name)?;
        self.delays_to_sources(&mut connection, name)?;
        connection.linear = self.compose_dense(connection.linear, weights, targets, sources, name)?;
        connection.shape = vec![targets];
        connection.bias = self.bias(group, name, &connection.shape)?;
        Ok(connection)
    }

    /// A connection followed by a convolution or a pool.
    fn after_window(&self, mut connection: Connection, name: &str) -> Result<Connection> {
        let node = &self.flat.nodes[name];
        let window = WindowNode { name, node, line: node.kind == "Conv1d" }.over(&connection.shape)?;
        // A pool without padding gives all units of a channel one bias.
        let pools = node.kind.ends_with("Pool2d") && window.sliding.padding == (0, 0);
        let (size, mean) = (window.sliding.size, node.kind == "AvgPool2d");
        let counted = if mean { 1.0 } else { (size.0 * size.1) as f64 };
        let shared = pools.then(|| by_channel(connection.bias.as_deref()?, &axes(&connection.shape))).flatten();
        if shared.is_some() {
            connection.bias = None;
        }
        self.check_filter(&connection, name)?;
        self.delays_to_sources(&mut connection, name)?;
        let target = window.sliding.target.to_vec();
        connection.linear = self.compose_window(connection.linear, window, &connection.shape, name)?;
        let plane = target[1] * target[2];
        connection.shape = target;
        connection.bias = match shared {
            Some(biases) => {
                Some(biases.into_iter().flat_map(|bias| std::iter::repeat_n(bias * counted, plane)).collect())
            }
            None => self.bias(node.group, name, &connection.shape)?,
        };
        Ok(connection)
    }

    /// The delays of a connection with those of a node.
    fn later(&self, connection: &Connection, name: &str) -> Result<Vec<u32>> {
        let delays = reals(self.flat.nodes[name].group, name, "delay")?;
        let delays = spread(delays, &connection.shape)
            .ok_or_else(|| wrong(format!("node '{name}': its delays do not fit the shape {:?}", connection.shape)))?;
        let steps = delays.iter().map(|delay| (delay / self.dt).round_ties_even()).collect::<Vec<_>>();
        if let Some(long) = steps.iter().find(|steps| !(0.0..=LONGEST_DELAY).contains(*steps)) {
            return Err(unsupported(
                format!("node '{name}' delays by {long} steps of {} ms", self.dt * 1e3),
                "the delay field holds 0 to 62 steps",
            ));
        }
        let steps: Vec<u32> = steps.iter().map(|&steps| steps as u32).collect();
        Ok(sum_of_delays(&connection.delay, &steps))
    }

    /// Passes arrivals through an integrator that sends its potential.
    fn apply_filter(&self, connection: &mut Connection, name: &str, units: usize) -> Result<()> {
        let kind = &self.flat.nodes[name].integrator;
        if let Some(first) = &connection.filter {
            return Err(cannot_send(&first.name, kind, &format!("through '{name}', which filters it again")));
        }
        if connection.bias.as_ref().is_some_and(|bias| bias.iter().any(|&b| b != 0.0)) {
            return Err(cannot_send(name, kind, "to which a bias is added"));
        }
        connection.filter = Some(self.filter(name, units)?);
        Ok(())
    }

    /// Refuses weights after a filter that differs between the units that they sum.
    fn check_filter(&self, connection: &Connection, name: &str) -> Result<()> {
        match &connection.filter {
            Some(filter) if !filter.is_uniform() => {
                let kind = &self.flat.nodes[&filter.name].integrator;
                let why = format!("and '{name}' sums units with other time constants or factors");
                Err(cannot_send(&filter.name, kind, &why))
            }
            _ => Ok(()),
        }
    }

    /// Adds warnings about delays that are not a whole number of steps.
    pub(super) fn note_rounded_delays(&mut self) -> Result<()> {
        for (name, node) in self.flat.nodes.iter().filter(|(_, node)| node.kind == "Delay") {
            let steps: Vec<f64> = reals(node.group, name, "delay")?.iter().map(|delay| delay / self.dt).collect();
            fn off(steps: f64) -> f64 {
                (steps - steps.round_ties_even()).abs()
            }
            let Some(most) = steps.iter().copied().max_by(|a, b| off(*a).total_cmp(&off(*b))) else { continue };
            if off(most) > 1e-3 {
                let message = format!(
                    "node '{name}': {} of its {} delays are not whole numbers of steps and are rounded; the largest \
                     change is from {most:.3} to {} (--dt sets the timestep)",
                    steps.iter().filter(|steps| off(**steps) > 1e-3).count(),
                    steps.len(),
                    most.round_ties_even()
                );
                self.warnings.push(Warning::of_network(WarningCode::DelaysRounded, message));
            }
        }
        Ok(())
    }

    /// Converts the delays so far to delays of the sources, before weights that mix units.
    fn delays_to_sources(&self, connection: &mut Connection, name: &str) -> Result<()> {
        if connection.bias.as_ref().is_some_and(|bias| bias.iter().any(|&b| b != 0.0)) {
            let pool = self.flat.nodes[name].kind.ends_with("Pool2d");
            return Err(unsupported(
                format!("a bias is added before node '{name}', without a neuron in between"),
                if pool {
                    JOIN_HELP
                } else {
                    "multiply the bias by the weights of the node and add the product to its own bias"
                },
            ));
        }
        let delay = std::mem::take(&mut connection.delay);
        let equal = all_equal(&delay);
        if !equal && !matches!(connection.linear, Linear::Diagonal(_)) {
            return Err(unsupported(
                format!("each unit has its own delay between node '{name}' and the weights before it"),
                "put a neuron between the two, or give all these units one delay",
            ));
        }
        let delay = if equal { delay.first().map_or_else(Vec::new, |&delay| vec![delay]) } else { delay };
        connection.source_delay = sum_of_delays(&connection.source_delay, &delay);
        Ok(())
    }

    /// The bias that a node adds, unless it is zero.
    pub(super) fn bias(&self, group: &Group, name: &str, shape: &[usize]) -> Result<Option<Vec<f64>>> {
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

    /// Refuses a shape of the file that disagrees with the number of units that arrive.
    pub(super) fn check_shape(&self, name: &str, units: usize) -> Result<()> {
        let Some(shape) = self.flat.nodes[name].group.numbers("shape") else { return Ok(()) };
        let shape: Vec<f64> = shape.reals().collect();
        if shape.is_empty() || shape.iter().product::<f64>() == units as f64 {
            return Ok(());
        }
        Err(wrong(format!("node '{name}' has shape {shape:?}, but its input has {units} units")))
    }

    pub(super) fn too_many(&self, name: &str) -> Diagnostic {
        unsupported(
            format!(
                "node '{name}' follows another without a neuron in between, and their product has too many synapses"
            ),
            JOIN_HELP,
        )
    }

    pub(super) fn compose_dense(
        &self,
        before: Linear,
        weights: Vec<f64>,
        targets: usize,
        sources: usize,
        name: &str,
    ) -> Result<Linear> {
        match before {
            Linear::Diagonal(scale) if scale.iter().all(|&s| s == 1.0) => Ok(Linear::Dense(weights, sources)),
            Linear::Diagonal(scale) => {
                let scaled = weights.iter().enumerate().map(|(i, w)| w * at(&scale, i % sources)).collect();
                Ok(Linear::Dense(scaled, sources))
            }
            before => {
                let list = self.synapse_list(before, sources, name)?;
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

    pub(super) fn compose_window(&self, before: Linear, window: Window, shape: &[usize], name: &str) -> Result<Linear> {
        if let Linear::Window(first) = &before
            && let Some(joined) = first.then(&window)
        {
            return Ok(Linear::Window(joined));
        }
        match before {
            Linear::Diagonal(scale) if scale.len() == 1 => {
                let kernel = match window.kernel {
                    Ok(kernel) => Ok(kernel.iter().map(|w| w * scale[0]).collect()),
                    Err(weight) => Err(weight * scale[0]),
                };
                Ok(Linear::Window(Window { kernel, ..window }))
            }
            before => {
                let first = self.synapse_list(before, product(shape).unwrap_or(0), name)?;
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

    /// A linear part as a list of synapses; `units` is the size of a diagonal.
    pub(super) fn synapse_list(&self, linear: Linear, units: usize, name: &str) -> Result<Synapses> {
        match linear {
            Linear::List(list) => Ok(list),
            Linear::Window(window) => window.list().ok_or_else(|| self.too_many(name)),
            Linear::Dense(weights, sources) if weights.len() <= MOST_LISTED => {
                Ok(weights.iter().enumerate().map(|(i, &w)| ((i % sources) as u64, (i / sources) as u64, w)).collect())
            }
            Linear::Diagonal(scale) => Ok((0..units as u64).map(|i| (i, i, at(&scale, i as usize))).collect()),
            Linear::Dense(..) => Err(self.too_many(name)),
        }
    }
}

/// Reads the fields of a convolution or a pool.
struct WindowNode<'a> {
    name: &'a str,
    node: &'a Node<'a>,
    /// Whether it slides along one axis: Conv1d.
    line: bool,
}

/// The kernel of a window, and the channels that it makes.
struct Kernel {
    size: (usize, usize),
    out: usize,
    groups: usize,
    weights: Result<Vec<f64>, f64>,
}

impl WindowNode<'_> {
    fn wrong(&self, what: impl Display) -> Diagnostic {
        wrong(format!("node '{}': {what}", self.name))
    }

    fn over(&self, shape: &[usize]) -> Result<Window> {
        let &[channels, height, width] = shape else {
            return Err(self.wrong(format!("its input of shape {shape:?} has no height and width")));
        };
        if let Some(plane) = self.node.group.numbers("input_shape") {
            let plane: Vec<f64> = plane.reals().collect();
            let arrives = [height as f64, width as f64];
            if !(plane == arrives || (self.line && plane == arrives[1..])) {
                return Err(self.wrong(format!("its input_shape is {plane:?}, but its input is {height} x {width}")));
            }
        }
        let is_conv = matches!(self.node.kind.as_str(), "Conv1d" | "Conv2d");
        let Kernel { size, out, groups, weights: kernel } =
            if is_conv { self.convolution(channels) } else { self.pool(channels) }?;
        let stride = self.pair("stride", 1, 1.0)?;
        let dilation = if is_conv { self.pair("dilation", 1, 1.0)? } else { (1, 1) };
        let [padding, after] = self.padding(size, stride, dilation)?;
        let to_h = outputs(height + padding.0 + after.0, size.0, stride.0, dilation.0);
        let to_w = outputs(width + padding.1 + after.1, size.1, stride.1, dilation.1);
        let (Some(to_h), Some(to_w)) = (to_h, to_w) else {
            return Err(self.wrong(format!("its window is larger than its input of {height} x {width}")));
        };
        if product(&[out, to_h, to_w]).is_none() {
            return Err(self.wrong(format!("it makes more than {MOST_UNITS} units")));
        }
        let (source, target) = ([channels, height, width], [out, to_h, to_w]);
        Ok(Window { sliding: Sliding { source, target, size, stride, padding, dilation, groups }, kernel })
    }

    fn convolution(&self, channels: usize) -> Result<Kernel> {
        let numbers = self.node.group.numbers("weight").ok_or_else(|| self.wrong("it has no weight"))?;
        let (out, per_group, size) = match *numbers.shape() {
            [out, per_group, kw] if self.line => (out, per_group, (1, kw)),
            [out, per_group, kh, kw] if !self.line => (out, per_group, (kh, kw)),
            _ => return Err(self.wrong(format!("its weight is {:?}", numbers.shape()))),
        };
        let groups = self.pair("groups", 1, 1.0)?.1;
        if per_group.checked_mul(groups) != Some(channels) || out % groups != 0 || out == 0 || size.0 * size.1 == 0 {
            return Err(self.wrong(format!(
                "its weight is {:?} in {groups} groups, but its input has {channels} channels",
                numbers.shape()
            )));
        }
        Ok(Kernel { size, out, groups, weights: Ok(reals(self.node.group, self.name, "weight")?) })
    }

    fn pool(&self, channels: usize) -> Result<Kernel> {
        let size = self.pair("kernel_size", 1, 1.0)?;
        let weight = if self.node.kind == "AvgPool2d" { 1.0 / (size.0 * size.1) as f64 } else { 1.0 };
        Ok(Kernel { size, out: channels, groups: channels, weights: Err(weight) })
    }

    /// Silent places before and after each axis.
    fn padding(
        &self,
        size: (usize, usize),
        stride: (usize, usize),
        dilation: (usize, usize),
    ) -> Result<[(usize, usize); 2]> {
        match self.node.group.text("padding") {
            Some("valid") => Ok([(0, 0); 2]),
            Some("same") => {
                if stride != (1, 1) {
                    return Err(unsupported(
                        format!("node '{}': padding 'same' with a stride", self.name),
                        "give the padding as numbers",
                    ));
                }
                // As in torch: for an even window, the greater half is at the end.
                let reach = (dilation.0 * (size.0 - 1), dilation.1 * (size.1 - 1));
                let before = (reach.0 / 2, reach.1 / 2);
                Ok([before, (reach.0 - before.0, reach.1 - before.1)])
            }
            Some(other) => Err(self.wrong(format!("padding '{}'", other.chars().take(40).collect::<String>()))),
            None => {
                let (y, x) = self.pair("padding", 0, 0.0)?;
                Ok([if self.line { (0, x) } else { (y, x) }; 2])
            }
        }
    }

    /// A field of one number for each axis, or of one for both, from `least`.
    fn pair(&self, key: &str, default: usize, least: f64) -> Result<(usize, usize)> {
        if self.node.group.get(key).is_none() {
            return Ok((default, default));
        }
        let numbers = reals(self.node.group, self.name, key)?;
        let is_whole = numbers.iter().all(|x| x.fract() == 0.0 && (least..=65_535.0).contains(x));
        match numbers.as_slice() {
            [one] if is_whole && self.line => Ok((default.min(1), *one as usize)),
            [one] if is_whole => Ok((*one as usize, *one as usize)),
            [y, x] if is_whole && !self.line => Ok((*y as usize, *x as usize)),
            _ => Err(self.wrong(format!("'{key}' is {numbers:?}"))),
        }
    }
}

/// The number of places of a window along an axis; `None` where it is larger than the axis.
fn outputs(axis: usize, size: usize, stride: usize, dilation: usize) -> Option<usize> {
    axis.checked_sub(dilation * (size - 1) + 1).map(|slack| slack / stride + 1)
}
