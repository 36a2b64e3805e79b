//! Discretisation of neurons in continuous time.
//!
//! Input: time constants, resistances, thresholds of a node. Output: the timestep of the file, and
//! decays, gain, threshold and bias in that step.

use super::filter::Filter;
use super::node_types::{Node, resets};
use super::state::{Reader, all, optional, parameter, product, unsupported, wrong, zip};
use crate::foreign::conventions::{DecayRule, ResetMode};
use crate::foreign::imported::{Options, wrong_option};
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// Change of v by a spike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reset {
    /// By a rule.
    Mode(ResetMode),
    /// None: v is compared with the threshold and continues.
    Never,
}

pub(super) struct Discrete {
    pub(super) du: Parameter,
    pub(super) dv: Parameter,
    /// Time constants in ms of the current and of the voltage, where 4096ths do not represent the
    /// decays exactly.
    pub(super) taus: [Option<Parameter>; 2],
    /// What a weight of 1 adds to v, in the unit of v and of the threshold.
    pub(super) gain: Parameter,
    /// What a number that skips the current adds to v, such as a bias behind a filter; same unit.
    pub(super) voltage_gain: Parameter,
    /// None for neurons that never spike.
    pub(super) threshold: Option<Parameter>,
    /// Number that is added to v in each step.
    pub(super) bias: Parameter,
    pub(super) reset: Reset,
}

impl Discrete {
    /// A neuron whose v is the sum of its inputs in each step.
    pub(super) fn memoryless(threshold: Option<Parameter>) -> Discrete {
        Discrete {
            du: Parameter::Same(4096.0),
            dv: Parameter::Same(4096.0),
            taus: [None, None],
            gain: Parameter::Same(1.0),
            voltage_gain: Parameter::Same(1.0),
            threshold,
            bias: Parameter::Same(0.0),
            reset: Reset::Mode(ResetMode::Zero),
        }
    }

    /// The weight from a unit to itself that completes its reset, as a multiple of the threshold.
    pub(super) fn own_weight(&self, unit: usize) -> f64 {
        match self.reset {
            Reset::Mode(ResetMode::Zero | ResetMode::Subtract) => 0.0,
            Reset::Mode(ResetMode::SubtractLater) => -self.dv.get(unit) / 4096.0,
            Reset::Never => 1.0 - self.dv.get(unit) / 4096.0,
        }
    }
}

/// Distance in 4096ths below which a decay is rounded, since time constants have single precision.
const EXACT: f64 = 1e-3;

impl Reader<'_> {
    /// The discretised neuron of a node, with the filter on the paths before it; `None` for an
    /// input. Notes and warnings are added. The timestep, filters and shapes have been found before.
    ///
    /// # Errors
    /// `import.nir`, `import.option`, `import.unsupported`.
    pub(super) fn discretise(&mut self, name: &str) -> Result<Option<Discrete>> {
        let node = &self.flat.nodes[name];
        if node.kind == "Input" {
            return Ok(None);
        }
        let filter = self.filter_before(name)?;
        let units = product(&self.shapes[name]).unwrap_or(0);
        let mut reader = NodeReader {
            name,
            node,
            units,
            dt: self.dt,
            dt_in_file_units: self.dt_in_file_units,
            options: self.options,
            long: None,
            rest: None,
        };
        let neuron = reader.neuron(filter.as_ref())?;
        let NodeReader { long, rest, .. } = reader;
        let [du, dv, gain] = [&neuron.du, &neuron.dv, &neuron.gain].map(|value| match value {
            Parameter::Same(x) => format!("{}", (x * 1e6).round() / 1e6),
            _ => "each its own".to_string(),
        });
        self.notes.push(format!("'{name}' ({}): du {du}, dv {dv}, a weight counts {gain}", node.kind));
        if let Some(rest) = rest {
            let message = format!("v is counted from its rest potential {rest}, where it begins");
            self.warnings.push(Warning::of_population(WarningCode::RestPotential, &self.names[name], message));
        }
        // One warning represents all nodes.
        if let Some(long) =
            long.filter(|_| !self.warnings.iter().any(|warning| warning.code == WarningCode::LongTimestep))
        {
            self.warnings.push(Warning::of_network(WarningCode::LongTimestep, long));
        }
        Ok(Some(neuron))
    }
}

/// The share of a state that a step takes away.
struct Share {
    share: Parameter,
    dt_over_tau: Parameter,
}

impl Share {
    /// That of a state without decay.
    fn none() -> Share {
        Share { share: Parameter::Same(0.0), dt_over_tau: Parameter::Same(0.0) }
    }

    /// The time constant in ms with `1 - share = exp(-dt / tau)`; none where 4096ths represent it.
    fn tau(&self, dt: f64) -> Option<Parameter> {
        let in_4096ths = all(&self.share, |share| (4096.0 * share - (4096.0 * share).round()).abs() < EXACT);
        let none = in_4096ths || !all(&self.share, |share| share < 1.0);
        (!none).then(|| self.share.map(|share| -dt * 1e3 / (-share).ln_1p()))
    }

    /// In 4096ths; whole numbers where [`Share::tau`] is none.
    fn decay(&self, dt: f64) -> Parameter {
        match self.tau(dt) {
            None => self.share.map(|share| (4096.0 * share).round_ties_even()),
            Some(_) => self.share.map(|share| 4096.0 * share),
        }
    }
}

/// Exporters write `dt / tau * (tau / dt)` for no scaling, which is 1 up to rounding.
fn snapped(gain: &Parameter) -> Parameter {
    gain.map(|gain| if (gain - 1.0).abs() < 1e-5 { 1.0 } else { gain })
}

/// Combines three parameters unit by unit.
fn zip3(a: &Parameter, b: &Parameter, c: &Parameter, f: impl Fn(f64, f64, f64) -> f64) -> Parameter {
    let length = [a, b, c].map(|parameter| parameter.values().len()).into_iter().max().unwrap_or(1);
    match length {
        1 => Parameter::Same(f(a.get(0), b.get(0), c.get(0))),
        _ => Parameter::from_values((0..length).map(|i| f(a.get(i), b.get(i), c.get(i))).collect()),
    }
}

struct NodeReader<'r> {
    name: &'r str,
    node: &'r Node<'r>,
    units: usize,
    /// Seconds of a timestep.
    dt: f64,
    /// A timestep in the unit of the file's time constants.
    dt_in_file_units: f64,
    options: &'r Options,
    /// The warning that a step is longer than a time constant.
    long: Option<String>,
    /// The rest potential from which v is counted, of the first unit.
    rest: Option<f64>,
}

impl NodeReader<'_> {
    fn parameter(&self, key: &str, default: Option<f64>) -> Result<Parameter> {
        let value = match default {
            Some(default) => optional(self.node.group, self.name, key, default)?,
            None => parameter(self.node.group, self.name, key)?,
        };
        match &value {
            Parameter::Each(values) if values.len() != self.units => {
                let (name, count, units) = (self.name, values.len(), self.units);
                Err(wrong(format!("node '{name}': '{key}' has {count} numbers for {units} units")))
            }
            _ => Ok(value),
        }
    }

    /// The share that a step takes from the state with this time constant.
    fn share(&mut self, key: &str) -> Result<Share> {
        let tau = self.parameter(key, None)?;
        self.share_of(key, &tau)
    }

    fn share_of(&mut self, key: &str, tau: &Parameter) -> Result<Share> {
        let (name, dt) = (self.name, self.dt_in_file_units);
        if !all(tau, |tau| tau > 0.0) {
            return Err(wrong(format!("node '{name}': '{key}' is not above 0")));
        }
        let dt_over_tau = tau.map(|tau| dt / tau);
        if self.options.decay() == DecayRule::Exponential {
            if let Some(&tau) = tau.values().iter().find(|&&tau| dt > tau) {
                let short = format!("{:.4e}", tau / dt).parse().unwrap_or(tau / dt);
                self.long.get_or_insert(format!(
                    "node '{name}': its '{key}' is {short} timesteps, so one step keeps {:.2} % of the state; \
                     nsim.from_torch reads networks of Norse and snnTorch",
                    100.0 * (-dt / tau).exp()
                ));
            }
            return Ok(Share { share: dt_over_tau.map(|part| -(-part).exp_m1()), dt_over_tau });
        }
        if !all(&dt_over_tau, |part| part <= 1.0 + 1e-6) {
            let message = format!("node '{name}': a timestep of {} ms is longer than its '{key}'", self.dt * 1e3);
            return Err(wrong_option(message).help(
                "give a shorter timestep with --dt MS; time constants in the file are in seconds. For tools whose states \
                 decay by exp(-dt / tau), give --decay exponential",
            ));
        }
        Ok(Share { share: dt_over_tau.map(|part| part.min(1.0)), dt_over_tau })
    }

    /// What a weight counts in the voltage.
    fn in_voltage(&self, share: &Share, key: &str) -> Result<Parameter> {
        let (rule, of_neuron, r) = (self.options.gain(), resets(&self.node.kind), self.parameter(key, Some(1.0))?);
        self.checked(
            snapped(&zip3(&share.share, &share.dt_over_tau, &r, |a, s, r| rule.in_voltage(a, s, r, of_neuron))),
            key,
        )
    }

    /// What a weight counts in the current, from the factor of its input.
    fn in_current(&self, share: &Share, w_in: &Parameter, key: &str) -> Result<Parameter> {
        let rule = self.options.gain();
        self.checked(snapped(&zip3(&share.share, &share.dt_over_tau, w_in, |b, s, w| rule.in_current(b, s, w))), key)
    }

    /// A gain, which is finite and not that of a state that no input can change.
    fn checked(&self, gain: Parameter, key: &str) -> Result<Parameter> {
        if all(&gain, f64::is_finite) && (self.units == 0 || !all(&gain, |gain| gain == 0.0)) {
            return Ok(gain);
        }
        let name = self.name;
        Err(unsupported(
            format!("node '{name}': a weight counts {} with its time constant and '{key}'", gain.get(0)),
            "a state that never decays (infinite tau) needs an infinite factor, as exporters write tau / dt, or is an IF",
        ))
    }

    /// The neuron, after the filter before it.
    fn neuron(&mut self, filter: Option<&Filter>) -> Result<Discrete> {
        match self.node.kind.as_str() {
            "CubaLIF" | "CubaLI" if filter.is_some() => Err(self.second_filter()),
            "CubaLIF" | "CubaLI" => {
                let (synapse, membrane) = (self.share("tau_syn")?, self.share("tau_mem")?);
                let w_in = self.parameter("w_in", Some(1.0))?;
                let current = self.in_current(&synapse, &w_in, "w_in")?;
                self.leaky(Some((synapse, current)), &membrane)
            }
            "LIF" | "LI" => {
                let current = filter.map(|filter| self.current_of(filter)).transpose()?;
                let membrane = self.share("tau")?;
                self.leaky(current, &membrane)
            }
            "IF" | "I" => {
                let current = filter.map(|filter| self.current_of(filter)).transpose()?;
                self.integrator(current)
            }
            "Threshold" => self.threshold_of(filter),
            kind => Err(wrong(format!("node '{}' of type '{kind}' is not a neuron", self.name))),
        }
    }

    fn second_filter(&self) -> Diagnostic {
        let name = self.name;
        unsupported(
            format!("'{name}' ({}) has a current, and receives a potential", self.node.kind),
            "a potential (LI) is sent to LIF, IF or Threshold, whose current it becomes: send spikes instead",
        )
    }

    /// The current that a filter before the neuron is: decay, and what a weight counts.
    fn current_of(&mut self, filter: &Filter) -> Result<(Share, Parameter)> {
        if filter.current.is_some() {
            return Err(self.second_filter());
        }
        let share = match &filter.tau {
            Some(tau) => self.share_of("tau", tau)?,
            None => Share::none(),
        };
        let gain = match filter.tau {
            Some(_) => zip3(&share.share, &share.dt_over_tau, &filter.r, |a, s, r| {
                self.options.gain().in_voltage(a, s, r, false)
            }),
            None => self.per_step(filter.r.clone()),
        };
        Ok((share, self.checked(snapped(&gain), "r")?))
    }

    /// What a weight counts in a state without decay: NIR's r is per second, and a file without a
    /// timestep means sums.
    fn per_step(&self, r: Parameter) -> Parameter {
        if all(&r, |r| r == 1.0) { r } else { r.map(|r| r * self.dt_in_file_units) }
    }

    /// A neuron with these states, each with what its input counts in it; callers state its reset.
    fn filtering(
        &self,
        current: Option<(Share, Parameter)>,
        membrane: &Share,
        voltage: Parameter,
        threshold: Option<Parameter>,
    ) -> Discrete {
        let (du, tau_u, gain) = match current {
            None => (Parameter::Same(4096.0), None, voltage.clone()),
            Some((share, gain)) => (share.decay(self.dt), share.tau(self.dt), zip(&gain, &voltage, |a, b| a * b)),
        };
        Discrete {
            du,
            dv: membrane.decay(self.dt),
            taus: [tau_u, membrane.tau(self.dt)],
            gain,
            voltage_gain: voltage,
            reset: Reset::Never,
            ..Discrete::memoryless(threshold)
        }
    }

    fn leaky(&mut self, current: Option<(Share, Parameter)>, membrane: &Share) -> Result<Discrete> {
        let voltage = self.in_voltage(membrane, "r")?;
        let (rest, threshold, reset) = self.rest_and_threshold()?;
        let leak = zip(&self.parameter("v_leak", Some(0.0))?, &rest, |leak, rest| leak - rest);
        let bias = zip(&membrane.share, &leak, |a, b| a * b);
        Ok(Discrete { bias, reset, ..self.filtering(current, membrane, voltage, threshold) })
    }

    fn integrator(&mut self, current: Option<(Share, Parameter)>) -> Result<Discrete> {
        let (_, threshold, reset) = self.rest_and_threshold()?;
        let voltage = self.checked(snapped(&self.per_step(self.parameter("r", Some(1.0))?)), "r")?;
        Ok(Discrete { reset, ..self.filtering(current, &Share::none(), voltage, threshold) })
    }

    /// A threshold on arrivals, or on the potential of a filter, which a spike does not reset.
    fn threshold_of(&mut self, filter: Option<&Filter>) -> Result<Discrete> {
        let threshold = self.checked_threshold(self.parameter("threshold", None)?)?;
        let Some(filter) = filter else { return Ok(Discrete::memoryless(Some(threshold))) };
        let current = match &filter.current {
            None => None,
            Some((tau_syn, w_in)) => {
                let share = self.share_of("tau_syn", tau_syn)?;
                let gain = self.in_current(&share, w_in, "w_in")?;
                Some((share, gain))
            }
        };
        let without_current = Filter { current: None, ..filter.clone() };
        let (membrane, voltage) = self.current_of(&without_current)?;
        Ok(self.filtering(current, &membrane, voltage, Some(threshold)))
    }

    /// The potential from which v is counted, the threshold above it, and the reset. A neuron that
    /// rests and resets at one potential rests and resets at 0 when it is counted from there.
    fn rest_and_threshold(&mut self) -> Result<(Parameter, Option<Parameter>, Reset)> {
        let name = self.name;
        let zero = Parameter::Same(0.0);
        if !resets(&self.node.kind) {
            return Ok((zero, None, Reset::Mode(ResetMode::Zero)));
        }
        let mode = self.options.reset_of(&self.node.kind);
        let (v_reset, threshold) = (self.parameter("v_reset", Some(0.0))?, self.parameter("v_threshold", None)?);
        if all(&v_reset, |v| v == 0.0) {
            return Ok((zero, Some(self.checked_threshold(threshold)?), Reset::Mode(mode)));
        }
        let leaks = self.node.kind != "IF";
        let rest = if leaks { self.parameter("v_leak", Some(0.0))? } else { v_reset.clone() };
        if !all(&zip(&rest, &v_reset, |a, b| a - b), |difference| difference == 0.0) {
            return Err(unsupported(
                format!("node '{name}' resets to a value other than 0 and its v_leak"),
                "a compartment of Loihi returns to zero: train with v_reset = v_leak, or with 0 for both",
            ));
        }
        if mode != ResetMode::Zero {
            return Err(unsupported(
                format!("node '{name}' has v_reset {}, which {} contradicts", v_reset.get(0), mode.name()),
                "--reset zero: a neuron returns to its v_reset",
            ));
        }
        let threshold = zip(&threshold, &v_reset, |threshold, rest| threshold - rest);
        self.rest = Some(v_reset.get(0));
        Ok((v_reset, Some(self.checked_threshold(threshold)?), Reset::Mode(mode)))
    }

    /// Thresholds of 0 are mantissas of 0; next to others, weights would have no scale.
    fn checked_threshold(&self, threshold: Parameter) -> Result<Parameter> {
        if !all(&threshold, |x| x > 0.0) && !all(&threshold, |x| x == 0.0) {
            let name = self.name;
            return Err(unsupported(
                format!("node '{name}' has a threshold below 0, or both a threshold of 0 and others"),
                "a threshold mantissa cannot be negative, and weights are scaled by the threshold",
            ));
        }
        Ok(threshold)
    }
}
