//! What a NIR file does not state, as warnings.
//!
//! Input: the model that was read. Output: a warning for each convention that was assumed and that
//! changes spikes in some tool (`foreign::conventions`), and for each edge without effect. `--from`
//! and single options state the conventions.

use std::collections::{BTreeMap, BTreeSet};

use super::neuron::{Discrete, Reset};
use super::node_types::is_population;
use super::projections::weights;
use super::state::{Reader, all};
use nsim_files::network::Parameter;
use nsim_ir::base::warning::{Warning, WarningCode};

/// The most steps of a grid from 0 to the greatest weight or threshold, at which equality is
/// likely.
const MOST_GRID_STEPS: f64 = 16_384.0;
/// Most names in a warning.
const LISTED: usize = 4;

fn listed(names: &[&str]) -> String {
    let shown: Vec<String> = names.iter().take(LISTED).map(|name| format!("'{name}'")).collect();
    let more = names.len().saturating_sub(LISTED);
    let and_more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{and_more}", shown.join(", "))
}

/// The greatest number of which all are multiples, up to rounding; none where it is too small to be
/// meant.
fn common_grid(numbers: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let most = numbers.clone().fold(0.0, |most: f64, number| most.max(number.abs()));
    let mut grid = 0.0;
    for number in numbers {
        let (mut greater, mut rest) = (f64::max(grid, number.abs()), f64::min(grid, number.abs()));
        while rest > 1e-6 * most {
            (greater, rest) = (rest, (greater - rest * (greater / rest).round()).abs());
        }
        grid = greater;
        if grid > 0.0 && most / grid > MOST_GRID_STEPS {
            return None;
        }
    }
    (grid > 0.0).then_some(grid)
}

impl Reader<'_> {
    /// Adds warnings of conventions that neither the file nor an option states.
    pub(super) fn warn_of_assumptions(&mut self, discrete: &BTreeMap<String, Option<Discrete>>) {
        if self.options.known {
            return;
        }
        let neurons: Vec<(&str, &Discrete)> = discrete
            .iter()
            .filter_map(|(node, neuron)| Some((self.names[node].as_str(), neuron.as_ref()?)))
            .filter(|(_, neuron)| neuron.threshold.is_some())
            .collect();
        let mut warnings = Vec::new();
        let reading = self.options.reading;
        let resetting = neurons.iter().any(|(_, neuron)| neuron.reset != Reset::Never);
        if let Some(row) = reading.row() {
            warnings.extend(row.beyond.filter(|_| resetting).map(|beyond| {
                let message = format!(
                    "neurons of {} may {beyond}, which the file does not state (--reset changes the reset)",
                    row.title
                );
                Warning::of_network(WarningCode::ToolBeyond, message)
            }));
        }
        if reading.tool.is_none() && reading.reset.is_none() && resetting {
            warnings.push(Warning::of_network(
                WarningCode::ResetAssumed,
                "the file does not state the reset (a v_reset of 0 is its format's default), so v returns to zero, as \
                 on the chip. Networks of snnTorch, sinabs, Rockpool and spyx subtract the threshold: give --from TOOL, \
                 --reset subtract-later (snnTorch) or --reset subtract. --reset zero confirms zero",
            ));
        }
        if reading.tool.is_none() && self.options.threshold.is_none() {
            warnings.extend(self.on_a_grid(&neurons));
        }
        if reading.tool.is_none() {
            warnings.extend(self.unbounded(&neurons));
            warnings.extend(scaled(&neurons));
        }
        self.warnings.extend(warnings);
    }

    /// The weights of the projections to a population.
    fn weights_to(&self, name: &str) -> Vec<f64> {
        self.model.projections.iter().filter(|one| one.to == name).flat_map(|one| weights(&one.kind)).collect()
    }

    /// Neurons whose v can equal the threshold, as weights and thresholds are multiples of one
    /// number.
    fn on_a_grid(&self, neurons: &[(&str, &Discrete)]) -> Option<Warning> {
        let mut first_grid = None;
        let mut names = Vec::new();
        for &(name, neuron) in neurons {
            let weights = self.weights_to(name);
            let thresholds = neuron.threshold.iter().flat_map(Parameter::values);
            let numbers = weights.iter().copied().chain(thresholds.copied());
            let Some(grid) = common_grid(numbers).filter(|_| weights.iter().any(|&weight| weight != 0.0)) else {
                continue;
            };
            names.push(name);
            first_grid.get_or_insert(grid);
        }
        first_grid.map(|grid| {
            let message = format!(
                "weights and thresholds of {} are multiples of {}, so v can equal the threshold, where a neuron does not \
                 spike here (v > threshold). Neurons of sinabs, spikingjelly and Rockpool spike there (v >= threshold): \
                 give --from TOOL, or --threshold inclusive. --threshold strict confirms it",
                listed(&names),
                (grid * 1e9).round() / 1e9
            );
            Warning::of_network(WarningCode::ThresholdAssumed, message)
        })
    }

    /// Neurons whose v may fall without a bound, as they have negative weights.
    fn unbounded(&self, neurons: &[(&str, &Discrete)]) -> Option<Warning> {
        let mut names = Vec::new();
        for &(name, neuron) in neurons.iter().filter(|(_, neuron)| neuron.reset != Reset::Never) {
            let has_negative_bias = !all(&neuron.bias, |bias| bias >= 0.0);
            if has_negative_bias || self.weights_to(name).iter().any(|&weight| weight < 0.0) {
                names.push(name);
            }
        }
        (!names.is_empty()).then(|| {
            let message = format!(
                "the file does not state a lower bound of v, so none is assumed in {}. Networks that sinabs converts \
                 (from_model) have min_v_mem -1, those of nengo min_voltage 0: convert them without. --from TOOL confirms \
                 it",
                listed(&names)
            );
            Warning::of_network(WarningCode::LowerBoundAssumed, message)
        })
    }

    /// Adds warnings of edges that the file has twice, and of those that no path uses.
    pub(super) fn warn_of_unused_edges(&mut self) {
        let mut warnings: Vec<Warning> = Vec::new();
        for (from, to) in &self.flat.doubled {
            let message = format!("the file has the edge from '{from}' to '{to}' more than once: it counts once");
            warnings.push(Warning::of_network(WarningCode::EdgeDoubled, message));
        }
        let reached = self.closure(|(from, to)| (from, to), is_population);
        let leading = self.closure(|(from, to)| (to, from), |kind| is_population(kind) || kind == "Output");
        for (from, to) in self.flat.edges.iter().filter(|(from, to)| !reached.contains(from) || !leading.contains(to)) {
            let why = if reached.contains(from) { "no path leads on to neurons" } else { "no spikes reach it" };
            let message = format!("the edge from '{from}' to '{to}' has no effect, as {why}: it is dropped");
            warnings.push(Warning::of_network(WarningCode::EdgeDropped, message));
        }
        self.warnings.extend(warnings);
    }

    /// The nodes of the kinds `start`, and those that edges lead to from there.
    fn closure<'e>(
        &'e self,
        directed: impl Fn(&'e (String, String)) -> (&'e String, &'e String),
        start: impl Fn(&str) -> bool,
    ) -> BTreeSet<&'e String> {
        let mut next: BTreeMap<&String, Vec<&String>> = BTreeMap::new();
        for edge in &self.flat.edges {
            let (from, to) = directed(edge);
            next.entry(from).or_default().push(to);
        }
        let started = self.flat.nodes.iter().filter(|(_, node)| start(&node.kind)).map(|(name, _)| name);
        let mut open: Vec<&String> = started.collect();
        let mut reached: BTreeSet<&String> = open.iter().copied().collect();
        while let Some(name) = open.pop() {
            for &to in next.get(name).map_or(&[][..], Vec::as_slice) {
                if reached.insert(to) {
                    open.push(to);
                }
            }
        }
        reached
    }
}

/// Neurons in which a weight does not count 1.
fn scaled(neurons: &[(&str, &Discrete)]) -> Option<Warning> {
    let other: Vec<&(&str, &Discrete)> =
        neurons.iter().filter(|(_, neuron)| !all(&neuron.gain, |gain| gain == 1.0)).collect();
    let (_, first) = other.first()?;
    let names: Vec<&str> = other.iter().map(|(name, _)| *name).collect();
    let message = format!(
        "a weight counts {} in {}, by the equations of NIR (dt / tau times r, and w_in). Norse, Rockpool and spyx give them other \
         meanings: --from TOOL reads them",
        format!("{:.6}", first.gain.get(0)).trim_end_matches('0').trim_end_matches('.'),
        listed(&names)
    );
    Some(Warning::of_network(WarningCode::Gain, message))
}
