//! The timestep of a file, which NIR does not state.
//!
//! Input: time constants and the factors of their inputs. Output: the timestep. Exporters that
//! write `r = tau / dt` imply it; but one such ratio agrees with itself, and tools give r other
//! meanings. So it takes two that do not depend on each other: `tau_mem / r` and `tau_syn / w_in`,
//! `tau / r` of two time constants, or `tau / r` and `1 / r` of IF. With a tool's conventions one
//! is enough.
//!
//! Errors: `import.option` where the timestep has to be given.

use super::node_types::{Node, resets};
use super::state::{Reader, optional, parameter};
use crate::foreign::conventions::{GainRule, TimeUnit};
use crate::foreign::imported::wrong_option;
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// In place of a time constant: IF has none, its factor is per second.
const PER_SECOND: &str = "1";

/// A time constant and the factor of its input, of a node.
struct Ratio<'a> {
    node: &'a str,
    of_neuron: bool,
    tau: &'static str,
    factor: &'static str,
    /// Pairs of both, one for each unit or one for all; a tau of 1 for IF.
    pairs: Vec<(f64, f64)>,
}

/// A timestep that a ratio implies.
struct ImpliedStep {
    seconds: f64,
    node: String,
    tau: &'static str,
    factor: &'static str,
    /// Number of statements that agree on it and do not depend on each other.
    independent: usize,
}

/// The timesteps that the ratios of a file imply.
#[derive(Default)]
struct ImpliedSteps {
    steps: Vec<ImpliedStep>,
    /// Field and time constant of each independent statement.
    independent: Vec<(&'static str, f64)>,
    /// Whether anything depends on the timestep.
    timed: bool,
}

impl ImpliedStep {
    /// The timestep in ms. Many exporters compute in single precision, so one of few digits is
    /// rounded to them.
    fn ms(&self) -> f64 {
        let digits: f64 = format!("{:.4e}", self.seconds).parse().unwrap_or(self.seconds);
        let rounded = if (digits / self.seconds - 1.0).abs() < 1e-5 { digits } else { self.seconds };
        rounded * 1e3
    }

    /// Why it is the timestep.
    fn why(&self, by_tool: bool) -> Result<String> {
        let ratio = format!("{} / {}", self.tau, self.factor);
        if by_tool || self.independent > 1 {
            return Ok(format!("{ratio}, on which the nodes agree"));
        }
        Err(ask_for_step(format!(
            "the file has no timestep: {ratio} is {:.6} ms, but one ratio alone does not prove it, since tools give '{}' \
             different meanings",
            self.ms(),
            self.factor
        )))
    }
}

impl ImpliedSteps {
    fn add(&mut self, ratio: &Ratio<'_>, rule: GainRule) {
        for &(tau, factor) in &ratio.pairs {
            let Some(seconds) = rule.implied_step(tau, factor, ratio.of_neuron) else { continue };
            let (node, independent) = (ratio.node.to_string(), 0);
            // One for each node, unless they differ.
            let known = self.steps.last().is_some_and(|last| last.node == node && last.seconds == seconds);
            if !known {
                self.steps.push(ImpliedStep { seconds, node, tau: ratio.tau, factor: ratio.factor, independent });
            }
            let field = if ratio.tau == "tau_mem" { "tau" } else { ratio.tau };
            let mut known = self.independent.iter();
            if self.independent.len() < 2
                && !known.any(|&(other, value)| other == field && (value / tau - 1.0).abs() < 1e-6)
            {
                self.independent.push((field, tau));
            }
        }
    }

    /// The timestep on which all ratios agree; none without ratios, and where one is given and they
    /// differ.
    fn agreed(&self, given: bool) -> Result<Option<ImpliedStep>> {
        let Some(first) = self.steps.first() else { return Ok(None) };
        let seconds = first.seconds;
        // A ratio that is no number agrees with none.
        let agrees = |step: &&ImpliedStep| (step.seconds / seconds - 1.0).abs() < 1e-3;
        let other = self.steps.iter().find(|step| !agrees(step));
        match other {
            Some(_) if given => Ok(None),
            Some(other) => Err(ask_for_step(format!(
                "the nodes do not imply one timestep: {:.6} ms by '{}', {:.6} ms by '{}'",
                seconds * 1e3,
                first.node,
                other.seconds * 1e3,
                other.node
            ))),
            None if !(seconds > 0.0 && seconds <= 1e3) => {
                Err(ask_for_step(format!("the nodes imply a timestep of {seconds} s")))
            }
            None => {
                let (node, independent) = (first.node.clone(), self.independent.len());
                Ok(Some(ImpliedStep { seconds, node, independent, ..*first }))
            }
        }
    }
}

/// The diagnostic for a timestep that has to be given.
fn ask_for_step(message: String) -> Diagnostic {
    wrong_option(message).help(
        "give --from TOOL: timestep, reset (to zero, or to subtract the threshold), threshold test and decay are then \
         those of the tool that wrote the file. Or give the timestep alone: --dt MS, for example --dt 0.1",
    )
}

impl<'a> Reader<'a> {
    /// Finds the timestep in seconds, and in the unit of the file's time constants.
    pub(super) fn find_timestep(&mut self) -> Result<()> {
        let row = self.options.reading.row();
        let implied = self.implied_steps()?;
        let (given, unit) = (self.options.reading.dt_ms, row.map_or(TimeUnit::Seconds, |row| row.unit));
        let by_option = given.map(|dt| (dt, "from --dt".to_string()));
        let by_tool = row.and_then(|row| Some((row.dt_ms?, format!("as {} has it", row.title))));
        let by_file = if unit == TimeUnit::Norse { None } else { implied.agreed(given.is_some())? };
        let (dt_ms, why) = match (by_option, unit, &by_file) {
            (Some(option), ..) => option,
            (None, TimeUnit::Seconds, Some(step)) => (step.ms(), step.why(row.is_some())?),
            _ if !implied.timed => (1.0, "nothing in the file depends on it".to_string()),
            _ => by_tool
                .ok_or_else(|| ask_for_step("the file has no timestep, and its nodes do not imply one".to_string()))?,
        };
        self.notes.push(format!("timestep {} ms: {why}", (dt_ms * 1e6).round() / 1e6));
        self.dt = dt_ms / 1e3;
        self.dt_in_file_units = match unit {
            TimeUnit::Seconds => self.dt,
            TimeUnit::Steps => by_file.map_or(1.0, |step| step.seconds),
            TimeUnit::Norse => self.dt * self.dt,
        };
        Ok(())
    }

    /// The timesteps that the nodes imply.
    fn implied_steps(&self) -> Result<ImpliedSteps> {
        let rule = self.options.gain();
        let mut implied = ImpliedSteps::default();
        for (name, node) in &self.flat.nodes {
            implied.timed |= node.kind == "Delay";
            for ratio in ratios(name, node)? {
                implied.timed |= ratio.tau != PER_SECOND;
                implied.add(&ratio, rule);
            }
        }
        Ok(implied)
    }
}

/// The ratios of a node that may imply the timestep.
fn ratios<'a>(name: &'a str, node: &Node<'_>) -> Result<Vec<Ratio<'a>>> {
    match node.kind.as_str() {
        "CubaLIF" | "CubaLI" => Ok(vec![ratio(name, node, "tau_mem", "r")?, ratio(name, node, "tau_syn", "w_in")?]),
        "LIF" | "LI" => Ok(vec![ratio(name, node, "tau", "r")?]),
        "IF" | "I" => Ok(vec![ratio(name, node, PER_SECOND, "r")?]),
        _ => Ok(Vec::new()),
    }
}

fn ratio<'a>(name: &'a str, node: &Node<'_>, tau: &'static str, factor: &'static str) -> Result<Ratio<'a>> {
    let taus = if tau == PER_SECOND { Parameter::Same(1.0) } else { parameter(node.group, name, tau)? };
    let factors = optional(node.group, name, factor, 1.0)?;
    let pairs = match (&taus, &factors) {
        (Parameter::Same(tau), factors) => factors.values().iter().map(|&factor| (*tau, factor)).collect(),
        (taus, Parameter::Same(factor)) => taus.values().iter().map(|&tau| (tau, *factor)).collect(),
        (taus, factors) => taus.values().iter().copied().zip(factors.values().iter().copied()).collect(),
    };
    Ok(Ratio { node: name, of_neuron: resets(&node.kind), tau, factor, pairs })
}
