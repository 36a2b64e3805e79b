//! Conventions of the tools that write networks: what their files do not state.
//!
//! Input: a tool. Output: its row in [`TABLE`], which single options change ([`Reading`]).
//! `docs/import.md` has the same table. Facts are of snnTorch 1.0.0, Norse 1.1.0, sinabs 3.1.3,
//! spikingjelly 2.0.0, Rockpool 3.1.0, spyx 1.0.0 (their neurons, and their exporters to NIR),
//! lava-dl d825ac5, slayerPytorch 01beeeb and nengo 4.1.0.
//!
//! Notation: a step of dt takes the share a from a voltage and b from a current.

use nsim_ir::arithmetic::ThresholdTest;
use nsim_ir::base::names::named_variants;

named_variants! {
    /// A tool that writes networks.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Tool {
        /// snnTorch.
        SnnTorch = "snntorch",
        /// Norse.
        Norse = "norse",
        /// sinabs.
        Sinabs = "sinabs",
        /// spikingjelly.
        SpikingJelly = "spikingjelly",
        /// Rockpool.
        Rockpool = "rockpool",
        /// spyx.
        Spyx = "spyx",
        /// lava-dl.
        LavaDl = "lava-dl",
        /// slayerPytorch.
        Slayer = "slayer",
        /// nengo.
        Nengo = "nengo",
    }
}

named_variants! {
    /// Fraction of a state with time constant tau kept by a step of dt.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum DecayRule {
        /// 1 - dt / tau.
        Euler = "euler",
        /// exp(-dt / tau).
        Exponential = "exponential",
    }
}

named_variants! {
    /// Reset of a neuron's voltage by a spike.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum ResetMode {
        /// The voltage returns to zero, as on the chip.
        Zero = "zero",
        /// The threshold is subtracted.
        Subtract = "subtract",
        /// The threshold is subtracted in the step after the spike, once the voltage has decayed.
        SubtractLater = "subtract-later",
    }
}

/// What a weight of 1 counts: the meaning of `r` and `w_in`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GainRule {
    /// `b w_in` in the current and `a r` in the voltage: NIR's equations.
    Equations,
    /// `w_in` in the current, `a r` in the voltage.
    WholeCurrent,
    /// `w_in exp(-dt / tau_syn)` in the current. In the voltage of a neuron
    /// `r (dt / tau) exp(dt / tau)`, which is 1 for the r that Rockpool writes; in an integrator
    /// `r dt / tau`.
    Rockpool,
    /// 1 in neurons, whose r is the share that a step keeps; `a r` in integrators.
    One,
}

impl GainRule {
    /// The timestep that a time constant and its factor imply: `r` of a neuron's or an integrator's
    /// voltage, `w_in` of a current. None for a factor of 1, the value that states nothing.
    pub(super) fn implied_step(self, tau: f64, factor: f64, of_neuron: bool) -> Option<f64> {
        let stated = factor != 1.0 && factor.is_finite() && tau.is_finite();
        match self {
            GainRule::One if of_neuron => stated.then_some(tau * (1.0 - factor)),
            GainRule::Rockpool => stated.then(|| tau * steps_of_rockpool(factor)),
            _ => stated.then_some(tau / factor),
        }
    }

    /// What a weight counts in a voltage, from the share that a step takes, dt / tau and r.
    pub(super) fn in_voltage(self, share: f64, steps: f64, r: f64, of_neuron: bool) -> f64 {
        match self {
            GainRule::One if of_neuron => 1.0,
            GainRule::Rockpool if of_neuron => unless_infinite(steps * steps.exp(), r),
            GainRule::Rockpool => unless_infinite(steps, r),
            _ => unless_infinite(share, r),
        }
    }

    /// What a weight counts in a current, from the share that a step takes, dt / tau and w_in.
    pub(super) fn in_current(self, share: f64, steps: f64, w_in: f64) -> f64 {
        match self {
            GainRule::Equations => unless_infinite(share, w_in),
            GainRule::WholeCurrent => w_in,
            GainRule::Rockpool => w_in * (-steps).exp(),
            GainRule::One => 1.0,
        }
    }
}

/// The product of a share and a factor. An infinite time constant has an infinite factor in the
/// exporters that write `tau / dt` for it, so that a weight counts 1.
fn unless_infinite(share: f64, factor: f64) -> f64 {
    if share == 0.0 && factor.is_infinite() { 1.0 } else { share * factor }
}

/// The s with `exp(-s) / s = r`, by bisection.
fn steps_of_rockpool(r: f64) -> f64 {
    let (mut low, mut high) = (0.0, 700.0);
    for _ in 0..100 {
        let middle: f64 = (low + high) / 2.0;
        if (-middle).exp() / middle > r { low = middle } else { high = middle }
    }
    high
}

/// The unit of the time constants in a tool's NIR files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    Seconds,
    /// Steps: the tool knows no other time.
    Steps,
    /// Those of Norse, which writes `dt / tau_mem_inv` where `1 / tau_mem_inv` is the time
    /// constant.
    Norse,
}

/// The conventions of a tool.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// The tool that writes such files.
    pub tool: Tool,
    /// Its name in sentences.
    pub title: &'static str,
    /// Whether a neuron spikes at its threshold.
    pub threshold: ThresholdTest,
    /// The reset of its neurons by default.
    pub reset: ResetMode,
    /// The decay of a state.
    pub decay: DecayRule,
    /// What a weight counts.
    pub gain: GainRule,
    /// The unit of time constants.
    pub unit: TimeUnit,
    /// The timestep in ms of a file that implies none; none if it must be given.
    pub dt_ms: Option<f64>,
    /// The lower bound of v.
    pub lower_bound: &'static str,
    /// The potential from which a neuron begins.
    pub rest: &'static str,
    /// Steps that a spike takes from layer to layer.
    pub layer_delay: u32,
    /// What its neurons may do beyond this row, without a word in their files.
    pub beyond: Option<&'static str>,
}

/// snnTorch's row, with which others share most.
const SNNTORCH: Row = Row {
    tool: Tool::SnnTorch,
    title: "snnTorch",
    threshold: ThresholdTest::Strict,
    reset: ResetMode::SubtractLater,
    decay: DecayRule::Euler,
    gain: GainRule::Equations,
    unit: TimeUnit::Seconds,
    dt_ms: Some(0.1),
    lower_bound: "none",
    rest: "0",
    layer_delay: 0,
    beyond: Some("reset to zero (reset_mechanism), in all but Leaky a step longer"),
};

/// A row for each tool.
pub const TABLE: [Row; 9] = [
    SNNTORCH,
    Row {
        tool: Tool::Norse,
        title: "Norse",
        reset: ResetMode::Zero,
        gain: GainRule::WholeCurrent,
        unit: TimeUnit::Norse,
        dt_ms: Some(1.0),
        rest: "v_leak",
        beyond: Some("reset to another v_reset, or by subtraction (reset_method)"),
        ..SNNTORCH
    },
    Row {
        tool: Tool::Sinabs,
        title: "sinabs",
        threshold: ThresholdTest::Inclusive,
        reset: ResetMode::Subtract,
        decay: DecayRule::Exponential,
        unit: TimeUnit::Steps,
        dt_ms: Some(1.0),
        lower_bound: "min_v_mem: none, or -1 after from_model",
        beyond: Some(
            "send several spikes a step (MultiSpike, the default), have a lower bound of v (min_v_mem, -1 after \
             from_model), reset to zero (reset_fn), or take a whole weight in LIF (norm_input=False)",
        ),
        ..SNNTORCH
    },
    Row {
        tool: Tool::SpikingJelly,
        title: "spikingjelly",
        threshold: ThresholdTest::Inclusive,
        reset: ResetMode::Zero,
        rest: "v_reset",
        beyond: None,
        ..SNNTORCH
    },
    Row {
        tool: Tool::Rockpool,
        title: "Rockpool",
        threshold: ThresholdTest::Inclusive,
        reset: ResetMode::Subtract,
        decay: DecayRule::Exponential,
        gain: GainRule::Rockpool,
        dt_ms: Some(1.0),
        beyond: Some(
            "send several spikes a step (unless max_spikes_per_dt is 1), have a bias, or be recurrent (has_rec, w_rec)",
        ),
        ..SNNTORCH
    },
    Row {
        tool: Tool::Spyx,
        title: "spyx",
        gain: GainRule::One,
        unit: TimeUnit::Steps,
        dt_ms: Some(1.0),
        layer_delay: 1,
        beyond: None,
        ..SNNTORCH
    },
    Row { tool: Tool::LavaDl, title: "lava-dl", reset: ResetMode::Zero, layer_delay: 1, beyond: None, ..SNNTORCH },
    Row {
        tool: Tool::Slayer,
        title: "SLAYER",
        reset: ResetMode::Zero,
        dt_ms: None,
        layer_delay: 1,
        beyond: None,
        ..SNNTORCH
    },
    Row {
        tool: Tool::Nengo,
        title: "nengo",
        reset: ResetMode::Zero,
        decay: DecayRule::Exponential,
        dt_ms: Some(1.0),
        lower_bound: "min_voltage: 0",
        beyond: Some("have a refractory period (tau_ref) and a lower bound of v (min_voltage)"),
        ..SNNTORCH
    },
];

impl Tool {
    /// Its row.
    pub fn row(self) -> &'static Row {
        &TABLE[self as usize]
    }
}

impl Row {
    /// The reset of a NIR node of this type: CuBaLIF of spyx subtracts at the spike, its others
    /// later.
    pub(super) fn reset_of(&self, kind: &str) -> ResetMode {
        match (self.tool, kind) {
            (Tool::Spyx, "CubaLIF") => ResetMode::Subtract,
            _ => self.reset,
        }
    }

    /// Its cells in the table of `docs/import.md`.
    pub fn cells(&self) -> [String; 9] {
        let dt = self.dt_ms.map_or("`--dt`".to_string(), |dt| format!("{dt} ms"));
        let unit = match self.unit {
            TimeUnit::Seconds => "",
            TimeUnit::Steps => "; tau in steps",
            TimeUnit::Norse => "; tau of dt / tau_mem_inv",
        };
        [
            format!("{} (`{}`)", self.title, self.tool.name()),
            ["v > threshold", "v >= threshold"][usize::from(self.threshold == ThresholdTest::Inclusive)].to_string(),
            self.lower_bound.to_string(),
            match self.tool {
                Tool::Spyx => format!("{}; CuBaLIF: subtract", self.reset.name()),
                _ => self.reset.name().to_string(),
            },
            self.decay.name().to_string(),
            self.rest.to_string(),
            match self.gain {
                GainRule::Equations => "b w_in, a r",
                GainRule::WholeCurrent => "w_in, a r",
                GainRule::Rockpool => "w_in exp(-dt / tau_syn), r (dt / tau) exp(dt / tau)",
                GainRule::One => "1, 1",
            }
            .to_string(),
            self.layer_delay.to_string(),
            format!("{dt}{unit}"),
        ]
    }
}

/// Facts on which any model is read where its file does not state them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Reading {
    /// Length of a timestep in ms.
    pub dt_ms: Option<f64>,
    /// The tool whose conventions the file follows.
    pub tool: Option<Tool>,
    /// Reset of the voltage by a spike.
    pub reset: Option<ResetMode>,
}

impl Reading {
    /// The row of the tool.
    pub fn row(&self) -> Option<&'static Row> {
        self.tool.map(Tool::row)
    }
}
