//! Discretisation of neurons in continuous time.
//!
//! Input: time constants, resistances, thresholds of a node. Output: the timestep of the file, and
//! decays, gain, threshold and bias in that step.

use std::cell::RefCell;
use std::cmp::Ordering;

use super::node_types::resets;
use super::state::{Reader, product, unsupported, wrong};
use crate::foreign::hdf5::Group;
use crate::foreign::imported::{DecayRule, shortest_decimal, wrong_option};
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::warning::Warning;

/// A discretised neuron.
pub(super) struct Discrete {
    pub(super) du: Parameter,
    pub(super) dv: Parameter,
    /// Time constants in ms of the current and of the voltage, where 4096ths do not represent the
    /// decays exactly.
    pub(super) taus: [Option<Parameter>; 2],
    /// A weight of 1 in units of the threshold.
    pub(super) gain: Parameter,
    /// None for neurons that never spike.
    pub(super) threshold: Option<Parameter>,
    /// Number that is added to v in each step.
    pub(super) bias: Parameter,
}

impl Discrete {
    /// A neuron whose v is the sum of its inputs in each step.
    pub(super) fn memoryless(threshold: Option<Parameter>) -> Discrete {
        Discrete {
            du: Parameter::Same(4096.0),
            dv: Parameter::Same(4096.0),
            taus: [None, None],
            gain: Parameter::Same(1.0),
            threshold,
            bias: Parameter::Same(0.0),
        }
    }
}

/// Distance in 4096ths below which a decay is rounded, since time constants have single precision.
const EXACT: f64 = 1e-3;

/// The numbers of a field, which have to be finite.
pub(super) fn reals(node: &Group, name: &str, key: &str) -> Result<Vec<f64>> {
    let numbers = node.numbers(key).ok_or_else(|| wrong(format!("node '{name}' has no array '{key}'")))?;
    let single = numbers.dtype().ends_with("f4");
    let reals: Vec<f64> = numbers.reals().map(|x| if single { shortest_decimal(x) } else { x }).collect();
    match reals.iter().find(|x| !x.is_finite()) {
        Some(x) => Err(wrong(format!("node '{name}': '{key}' has a number that is {x}"))),
        None if reals.is_empty() => Err(wrong(format!("node '{name}': '{key}' is empty"))),
        None => Ok(reals),
    }
}

/// The parameter in a field, or its default.
pub(super) fn optional(node: &Group, name: &str, key: &str, default: f64) -> Result<Parameter> {
    match node.get(key) {
        Some(_) => Ok(Parameter::from_values(reals(node, name, key)?)),
        None => Ok(Parameter::Same(default)),
    }
}

pub(super) fn parameter(node: &Group, name: &str, key: &str) -> Result<Parameter> {
    Ok(Parameter::from_values(reals(node, name, key)?))
}

/// Applies `f` to pairs of entries; a single number is paired with all.
pub(super) fn zip(a: &Parameter, b: &Parameter, f: impl Fn(f64, f64) -> f64) -> Parameter {
    match (a, b) {
        (Parameter::Same(a), b) => b.map(|b| f(*a, b)),
        (a, Parameter::Same(b)) => a.map(|a| f(a, *b)),
        (a, b) => Parameter::from_values(a.values().iter().zip(b.values()).map(|(&a, &b)| f(a, b)).collect()),
    }
}

pub(super) fn all(value: &Parameter, f: impl Fn(f64) -> bool) -> bool {
    value.values().iter().all(|&x| f(x))
}

impl Reader<'_> {
    /// The timestep in seconds: given by option, or implied by all nodes.
    pub(super) fn timestep(&mut self) -> Result<f64> {
        if let Some(dt) = self.options.dt_ms {
            self.notes.push(format!("timestep {dt} ms, from --dt"));
            return Ok(dt / 1e3);
        }
        let (mut found, mut timed): (Vec<(String, f64)>, bool) = (Vec::new(), false);
        let mut implied_by = "tau / r";
        for (name, node) in &self.flat.nodes {
            let ratio = |tau: &str, by: &str| -> Result<Vec<f64>> {
                let (tau, by) = (parameter(node.group, name, tau)?, optional(node.group, name, by, 1.0)?);
                Ok(zip(&tau, &by, |a, b| a / b).values().to_vec())
            };
            match node.kind.as_str() {
                "CubaLIF" | "CubaLI" => {
                    timed = true;
                    implied_by = "tau_mem / r, and tau_syn / w_in agrees";
                    for (tau, by) in [("tau_mem", "r"), ("tau_syn", "w_in")] {
                        found.extend(ratio(tau, by)?.into_iter().map(|x| (name.clone(), x)));
                    }
                }
                "LIF" | "LI" => {
                    timed = true;
                    // A resistance of 1 implies nothing.
                    if !all(&optional(node.group, name, "r", 1.0)?, |r| r == 1.0) {
                        found.extend(ratio("tau", "r")?.into_iter().map(|x| (name.clone(), x)));
                    }
                }
                "Delay" => timed = true,
                _ => {}
            }
        }
        if !timed {
            self.notes.push("timestep 1 ms: nothing in the file depends on it".to_string());
            return Ok(1e-3);
        }
        let ask = |message: String| {
            wrong_option(message).help(
                "give the timestep with --dt MS, for example --dt 0.1. No timestep suits the time constants that Norse \
                 writes: read its modules with nsim.from_torch",
            )
        };
        let Some((_, first)) = found.first().cloned() else {
            return Err(ask("the file has no timestep, and its nodes do not imply one".to_string()));
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
        // Many exporters compute in single precision, so a timestep of few digits is rounded to
        // them.
        let digits: f64 = format!("{first:.4e}").parse().unwrap_or(first);
        let dt = if (digits / first - 1.0).abs() < 1e-5 { digits } else { first };
        self.notes.push(format!("timestep {:.6} ms: {implied_by}", dt * 1e3));
        Ok(dt)
    }

    /// The discretised neuron of a node; `None` for an input.
    pub(super) fn discretise(&mut self, name: &str) -> Result<Option<Discrete>> {
        let node = &self.flat.nodes[name];
        let (group, dt) = (node.group, self.dt);
        let units = product(&self.shapes[name]).unwrap_or(0);
        let get = |key: &str, default: Option<f64>| -> Result<Parameter> {
            let value = match default {
                Some(default) => optional(group, name, key, default)?,
                None => parameter(group, name, key)?,
            };
            match &value {
                Parameter::Each(values) if values.len() != units => {
                    Err(wrong(format!("node '{name}': '{key}' has {} numbers for {units} units", values.len())))
                }
                _ => Ok(value),
            }
        };
        let long = RefCell::new(Vec::new());
        let fraction = |key: &str| -> Result<Parameter> {
            let tau = get(key, None)?;
            if !all(&tau, |tau| tau > 0.0) {
                return Err(wrong(format!("node '{name}': '{key}' is not above 0")));
            }
            if self.options.decay == Some(DecayRule::Exponential) {
                if let Some(&tau) = tau.values().iter().find(|&&tau| dt > tau) {
                    long.borrow_mut().push(format!(
                        "node '{name}': a timestep of {} ms is longer than its '{key}' of {} ms, so one step keeps \
                         {:.2} % of the state; nsim.from_torch reads networks of Norse and snnTorch",
                        dt * 1e3,
                        format!("{:.4e}", tau * 1e3).parse().unwrap_or(tau * 1e3),
                        100.0 * (-dt / tau).exp()
                    ));
                }
                return Ok(tau.map(|tau| -(-dt / tau).exp_m1()));
            }
            if !all(&tau, |tau| dt <= tau * (1.0 + 1e-6)) {
                let message = format!("node '{name}': a timestep of {} ms is longer than its '{key}'", dt * 1e3);
                return Err(wrong_option(message).help(
                    "give a shorter timestep with --dt MS; time constants in the file are in seconds. For tools whose \
                     states decay by exp(-dt / tau), give --decay exponential",
                ));
            }
            Ok(tau.map(|tau| (dt / tau).min(1.0)))
        };
        // Solves 1 - fraction = exp(-dt / tau) for tau.
        let tau = |fraction: &Parameter| {
            let exact = |fraction: f64| (4096.0 * fraction - (4096.0 * fraction).round()).abs() < EXACT;
            let none = all(fraction, exact) || !all(fraction, |fraction| fraction < 1.0);
            (!none).then(|| fraction.map(|fraction| -dt * 1e3 / (-fraction).ln_1p()))
        };
        // In 4096ths; whole numbers where `taus` is not needed.
        let decay = |fraction: &Parameter| match tau(fraction) {
            None => fraction.map(|fraction| (4096.0 * fraction).round_ties_even()),
            Some(_) => fraction.map(|fraction| 4096.0 * fraction),
        };
        // Exporters write `dt / tau * (tau / dt)` for no scaling, which is 1 up to rounding.
        let snapped = |gain: Parameter| gain.map(|gain| if (gain - 1.0).abs() < 1e-5 { 1.0 } else { gain });
        let spiking = resets(&node.kind);
        if spiking && !all(&get("v_reset", Some(0.0))?, |v| v == 0.0) {
            return Err(unsupported(
                format!("node '{name}' resets to a value other than 0"),
                "a compartment of Loihi returns to zero",
            ));
        }
        let threshold = match node.kind.as_str() {
            "Threshold" => Some(get("threshold", None)?),
            _ if spiking => Some(get("v_threshold", None)?),
            _ => None,
        };
        // Thresholds of 0 are mantissas of 0; next to others, weights would have no scale.
        if threshold.as_ref().is_some_and(|threshold| !all(threshold, |x| x > 0.0) && !all(threshold, |x| x == 0.0)) {
            return Err(unsupported(
                format!("node '{name}' has a threshold below 0, or both a threshold of 0 and others"),
                "a threshold mantissa cannot be negative, and weights are scaled by the threshold",
            ));
        }
        let times = |fraction: &Parameter, key: &str, default: f64| -> Result<Parameter> {
            Ok(zip(fraction, &get(key, Some(default))?, |a, b| a * b))
        };
        let neuron = match node.kind.as_str() {
            kind @ ("CubaLIF" | "CubaLI" | "LIF" | "LI") => {
                let has_current = kind.starts_with("Cuba");
                let synapse = if has_current { Some(fraction("tau_syn")?) } else { None };
                let membrane = fraction(if has_current { "tau_mem" } else { "tau" })?;
                let current = match &synapse {
                    Some(synapse) => snapped(times(synapse, "w_in", 1.0)?),
                    None => Parameter::Same(1.0),
                };
                let voltage = snapped(times(&membrane, "r", 1.0)?);
                Discrete {
                    du: synapse.as_ref().map_or(Parameter::Same(4096.0), decay),
                    dv: decay(&membrane),
                    taus: [synapse.as_ref().and_then(tau), tau(&membrane)],
                    gain: zip(&current, &voltage, |a, b| a * b),
                    bias: times(&membrane, "v_leak", 0.0)?,
                    threshold,
                }
            }
            "IF" | "I" => {
                // Without a timestep, exporters mean sums: a spike adds its weight.
                let said = self.options.dt_ms.is_some();
                let r = get("r", Some(1.0))?;
                let gain = if said && !all(&r, |r| r == 1.0) { r.map(|r| r * dt) } else { r };
                Discrete { dv: Parameter::Same(0.0), gain: snapped(gain), ..Discrete::memoryless(threshold) }
            }
            "Threshold" => Discrete::memoryless(threshold),
            _ => return Ok(None),
        };
        let shown = |value: &Parameter| match value {
            Parameter::Same(x) => format!("{}", (x * 1e6).round() / 1e6),
            _ => "each its own".to_string(),
        };
        self.notes.push(format!(
            "'{name}' ({}): du {}, dv {}, a weight counts {}",
            self.flat.nodes[name].kind,
            shown(&neuron.du),
            shown(&neuron.dv),
            shown(&neuron.gain)
        ));
        // One warning represents all nodes.
        if self.warnings.is_empty() {
            self.warnings
                .extend(long.into_inner().into_iter().next().map(|long| Warning::of_network("long-timestep", long)));
        }
        Ok(Some(neuron))
    }
}
