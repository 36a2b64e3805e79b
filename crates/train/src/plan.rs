//! A training file -> a plan whose values are checked to be in range.

use super::cells::{Cells, Loihi, Srm};
use super::fit::Plan;
use super::loihi2::Loihi2;
use super::loss::{Form, Loss};
use super::network::{Layer, Mantissas, Source, Topology};
use super::optimiser::{Optimiser, Rule};
use super::surrogate::Surrogate;
use nsim_dynamics as neuron;
use nsim_files::training::{LossDesc, NeuronDesc, OptimiserDesc, TimesDesc, TrainingFile};
use nsim_ir::arithmetic::{ReadOut, Semantics, ThresholdTest};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::base::fixed::{Decay, OutOfRange, Refractory, ThresholdMantissa, WeightExponent};
use nsim_ir::neurons::{NeuronKind, ParameterRow, Storage};
use nsim_ir::quantised::Neuron;
use nsim_quantise::analytic::{early_peak, keep};
use nsim_reference::kernel::{Alpha, Kernel};
use nsim_reference::srm::Parameters;

/// Longest time constant in steps.
const LONGEST: f64 = 1e6;
/// Most neurons of a layer, channels of an input and levels of a spread.
const LARGEST: u32 = 65_536;

struct Problems<'a>(&'a SourceText);

impl Problems<'_> {
    fn at(&self, code: &'static str, span: Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::new(code, message).at(self.0, span)
    }

    /// Returns a number if it lies within a closed range.
    fn number(&self, span: Span, what: &str, value: f64, low: f64, high: f64) -> Result<f64> {
        if (low..=high).contains(&value) {
            return Ok(value);
        }
        Err(self.at("train.range", span, format!("{what} {value} is outside {low}..={high}")))
    }

    fn field<T>(&self, span: Span, of: Result<T, OutOfRange>) -> Result<T> {
        of.map_err(|error| self.at("train.range", span, error.to_string()))
    }
}

/// Checks a training file and makes its plan.
///
/// # Errors
/// `train.range` for a number, `train.layer` for an unknown source of a layer, with their place.
pub fn plan(file: &TrainingFile, source: &SourceText) -> Result<Plan> {
    let problems = Problems(source);
    let whole = Span::default();
    let timestep = problems.number(file.timestep_ms.span, "timestep_ms", *file.timestep_ms, 1e-3, 1e6)?;
    let mut inputs = Vec::new();
    for input in &file.inputs {
        let size = input.shape.iter().try_fold(1u64, |size, &n| size.checked_mul(n)).unwrap_or(u64::MAX);
        problems.number(input.span, "number of channels", size as f64, 1.0, f64::from(LARGEST))?;
        inputs.push(size as usize);
    }
    let tau_rho = problems.number(whole, "surrogate width", file.surrogate.0, 1e-3, 1e3)?;
    let scale_rho = problems.number(whole, "surrogate height", file.surrogate.1, 1e-6, 1e6)?;
    let mut layers: Vec<Layer> = Vec::new();
    for desc in &file.layers {
        let size = problems.number(desc.span, "size", f64::from(desc.size), 1.0, f64::from(LARGEST))? as usize;
        let mut sources = Vec::new();
        let mut fan_in = 0;
        for name in &desc.from {
            if let Some(input) = file.inputs.iter().position(|input| &input.name == name) {
                sources.push(Source::Input(input));
                fan_in += inputs[input];
            } else if let Some(layer) = layers.iter().position(|layer| &layer.name == name) {
                sources.push(Source::Layer(layer));
                fan_in += layers[layer].cells.count();
            } else {
                let message =
                    format!("layer '{}' reads '{name}', which is neither an input nor an earlier layer", desc.name);
                return Err(problems.at("train.layer", desc.span, message));
            }
        }
        if fan_in == 0 {
            return Err(problems.at("train.layer", desc.span, format!("layer '{}' has no input", desc.name)));
        }
        let (neuron, span) = match &desc.neuron {
            Some(neuron) => (neuron, desc.span),
            None => (&file.neuron.value, file.neuron.span),
        };
        let (cells, mantissas) = cells(&problems, span, neuron, size, timestep)?;
        if let Some(m) = &mantissas
            && 256.0 * fan_in as f64 * f64::from(m.exponent.get()).exp2() >= f64::from(1 << 24)
        {
            let message =
                format!("layer '{}': {fan_in} inputs at this weight exponent could sum beyond 2^24", desc.name);
            return Err(problems.at("train.range", span, message));
        }
        let surrogate = Surrogate::new(cells.theta(), tau_rho as f32, scale_rho as f32);
        layers.push(Layer { name: desc.name.clone(), sources, fan_in, cells, mantissas, surrogate });
    }
    if layers.is_empty() || inputs.is_empty() {
        return Err(problems.at("train.layer", whole, "a network has an input and a layer at least"));
    }
    let (rule, rate) = match file.optimiser.value {
        OptimiserDesc::Adam { rate } => (Rule::Adam, rate),
        OptimiserDesc::RmsProp { rate } => (Rule::RmsProp, rate),
    };
    problems.number(file.optimiser.span, "rate", rate, 0.0, 1e3)?;
    let rates = file.layers.iter().map(|layer| (rate * layer.rate) as f32).collect();
    let weight_decay = problems.number(whole, "weight_decay", file.weight_decay, 0.0, 1e3)? as f32;
    let l1 = problems.number(whole, "l1", file.l1, 0.0, 1e3)? as f32;
    let loss = loss(&problems, file, &layers)?;
    Ok(Plan {
        topology: Topology { inputs, layers },
        loss,
        optimiser: Optimiser { rule, weight_decay, l1, decoupled: file.decoupled },
        rates,
        last_rate: problems.number(whole, "last_rate", file.last_rate, 0.0, 1.0)? as f32,
        batch: problems.number(whole, "batch", f64::from(file.batch), 1.0, 65_536.0)? as usize,
        epochs: file.epochs,
        augment: file.augment,
        dropout: problems.number(whole, "dropout", file.dropout, 0.0, 0.99)? as f32,
        averaging: problems.number(whole, "averaging", file.averaging, 0.0, 1.0 - 1e-6)? as f32,
        initial: file.layers.iter().map(|layer| layer.initial as f32).collect(),
        seed: file.seed,
    })
}

/// The loss. Potentials decide exactly where the last layer never spikes.
fn loss(problems: &Problems, file: &TrainingFile, layers: &[Layer]) -> Result<Loss> {
    let span = file.loss.span;
    let last = layers.len() - 1;
    let by_potential = matches!(file.loss.value, LossDesc::Potential { .. });
    for (index, layer) in layers.iter().enumerate() {
        let refused =
            |message: String, help: &str| Err(problems.at("train.layer", file.layers[index].span, message).help(help));
        let never_spikes = layer.cells.theta().is_infinite();
        if never_spikes && (index < last || !by_potential) {
            let message = format!(
                "layer '{}' decides by its potential (theta inf, or Sigma), but its spikes are needed",
                layer.name
            );
            let help = "give it a threshold such as theta: 10; only the last layer may decide by its potential, with \
                        the loss Potential(decision: LastV, temperature: 1)";
            return refused(message, help);
        }
        if index == last && matches!(&layer.cells, Cells::Loihi2(loihi2) if loihi2.kind == NeuronKind::SigmaDelta) {
            let message = format!("layer '{}' sends changes, whose number cannot decide", layer.name);
            let help = "give this layer the neuron Sigma(weight_scale: 64), with the loss Potential(decision: LastV, \
                        temperature: 64)";
            return refused(message, help);
        }
        if by_potential && index == last && !never_spikes {
            let message = format!("layer '{}' spikes, which resets the potential that should decide", layer.name);
            let help =
                "give this layer a separate neuron: neuron: Loihi(.., theta: inf), which never spikes, or Sigma(..)";
            return refused(message, help);
        }
    }
    let output = &layers[last].cells;
    let (form, right, wrong) = match file.loss.value {
        LossDesc::SpikeCount { right, wrong } => (Form::SpikeCount, right, wrong),
        LossDesc::Weighted { right, wrong, beta, gamma } => {
            (Form::Weighted { beta: beta as f32, gamma: gamma as f32 }, right, wrong)
        }
        LossDesc::NumSpikes { right, wrong } => (Form::NumSpikes { kernel: output.kernel(1000) }, right, wrong),
        LossDesc::CrossEntropy { scale } => (Form::CrossEntropy { scale: scale as f32 }, 0.0, 0.0),
        LossDesc::Potential { decision: ReadOut::Spikes, .. } => {
            let message = "the loss Potential needs a decision by potential, not by Spikes";
            return Err(problems
                .at("train.loss", span, message)
                .help("decision is GreatestV, SumOfV or LastV; the loss of spikes is CrossEntropy(scale: 0.5)"));
        }
        LossDesc::Potential { decision, temperature } => {
            let temperature = problems.number(span, "temperature", temperature, 1e-6, 1e9)? as f32;
            (Form::Potential { decision, unit: output.unit(), temperature }, 0.0, 0.0)
        }
    };
    Ok(Loss { form, right: right as f32, wrong: wrong as f32 })
}

/// The time constant of each neuron in steps.
fn times(problems: &Problems, span: Span, what: &str, desc: TimesDesc, n: usize, step: f64) -> Result<Vec<f64>> {
    let check = |value: f64| problems.number(span, what, value / step, 1e-3, LONGEST);
    match desc {
        TimesDesc::Same(value) => Ok(vec![check(value)?; n]),
        TimesDesc::Spread(from, to, levels) => {
            let (from, to) = (check(from)?, check(to)?);
            let levels = problems.number(span, "levels", f64::from(levels), 2.0, f64::from(LARGEST))? as usize;
            let level = |k: usize| from * libm::pow(to / from, k as f64 / (levels - 1) as f64);
            Ok((0..n).map(|i| level(i % levels)).collect())
        }
    }
}

/// The decay of an exponential with this time constant in steps.
fn decay_of(tau: f64) -> Result<Decay, OutOfRange> {
    Decay::new((4096.0 * (1.0 - libm::exp(-1.0 / tau))).round() as i64)
}

fn cells(
    problems: &Problems,
    span: Span,
    desc: &NeuronDesc,
    n: usize,
    step: f64,
) -> Result<(Cells, Option<Mantissas>)> {
    match *desc {
        NeuronDesc::Srm { tau_sr_ms, tau_ref_ms, scale_ref, theta, truncated } => {
            let tau = times(problems, span, "tau_sr_ms in steps", tau_sr_ms, n, step)?;
            let tau_ref = problems.number(span, "tau_ref_ms in steps", tau_ref_ms / step, 1e-3, LONGEST)?;
            let theta = problems.number(span, "theta", theta, 1e-6, 1e6)?;
            let scale_ref = problems.number(span, "scale_ref", scale_ref, 0.0, 1e6)?;
            let of = |tau_sr| Parameters { tau_sr, tau_ref, scale_ref, theta };
            let responses: Vec<Alpha> = tau.iter().map(|&tau| of(tau).response()).collect();
            let kernel = if truncated { Kernel::Truncated } else { Kernel::Exact };
            Ok((Cells::Srm(Srm::new(theta, &responses, of(1.0).refractory(), kernel)), None))
        }
        NeuronDesc::Loihi { tau_u_ms, tau_v_ms, weight_scale, weight_exp, refractory, theta, credit } => {
            let u = times(problems, span, "tau_u_ms in steps", tau_u_ms, n, step)?;
            let v = times(problems, span, "tau_v_ms in steps", tau_v_ms, n, step)?;
            let scale = problems.number(span, "weight_scale", weight_scale, 1e-6, 1e6)?;
            let never_spikes = theta == f64::INFINITY;
            let theta = if never_spikes { theta } else { problems.number(span, "theta", theta, 1e-6, 1e6)? };
            let exponent = problems.field(span, WeightExponent::new(weight_exp))?;
            let refractory = problems.field(span, Refractory::new(refractory))?;
            let mantissas = Mantissas { scale: scale as f32, exponent };
            let mut fields = Vec::with_capacity(n);
            for (u, v) in u.into_iter().zip(v) {
                let (du, dv) = (problems.field(span, decay_of(u))?, problems.field(span, decay_of(v))?);
                let threshold = theta * f64::from(mantissas.unit()) * early_peak(keep(du), keep(dv)).0;
                let vth = match never_spikes {
                    true => ThresholdMantissa::MAX,
                    false => problems.field(span, ThresholdMantissa::new(threshold.round() as i64))?,
                };
                let neuron = Neuron { du, dv, vth, refractory, ..Neuron::PLAIN };
                fields.push(neuron::fields(&neuron, 0, Semantics::Hardware, ThresholdTest::Strict));
            }
            Ok((Cells::Loihi(Loihi::new(fields, theta as f32, mantissas.unit(), credit)), Some(mantissas)))
        }
        NeuronDesc::Rf { period_ms, tau_ms, weight_scale, theta } => {
            let period = times(problems, span, "period_ms in steps", period_ms, n, step)?;
            let tau = times(problems, span, "tau_ms in steps", tau_ms, n, step)?;
            let turn = |(period, tau): (f64, f64)| {
                let angle = std::f64::consts::TAU / period;
                let part = |part: f64| (4096.0 * libm::exp(-1.0 / tau) * part).trunc() as i32;
                [part(libm::cos(angle)), part(libm::sin(angle))]
            };
            let turns: Vec<[i32; 2]> = period.into_iter().zip(tau).map(turn).collect();
            let row =
                |&[cos, sin]: &[i32; 2], threshold| ParameterRow([sin, cos, threshold, RF_STATE_EXP, 12, 0, 0, 0]);
            let share = |x| x as f32 / 4096.0;
            loihi2(problems, span, NeuronKind::Rf, (weight_scale, theta, RF_STATE_EXP), |threshold| {
                (
                    turns.iter().map(|turn| row(turn, threshold)).collect(),
                    turns.iter().map(|turn| turn.map(share)).collect(),
                )
            })
        }
        NeuronDesc::SigmaDelta { weight_scale, theta } => {
            let parts = (weight_scale, theta, 0);
            // Only vth_mant and relu are set.
            let row = |threshold| ParameterRow([threshold, 0, 0, 0, 1, 0, 0, 0]);
            loihi2(problems, span, NeuronKind::SigmaDelta, parts, |threshold| (vec![row(threshold); n], Vec::new()))
        }
        NeuronDesc::Sigma { weight_scale } => {
            let parts = (weight_scale, f64::INFINITY, 0);
            loihi2(problems, span, NeuronKind::Sigma, parts, |_| (vec![ParameterRow::EMPTY; n], Vec::new()))
        }
    }
}

/// State bits of a resonator below an arriving 1, as netx sets them.
const RF_STATE_EXP: i32 = 6;

/// Neurons of a kind of Loihi 2, from weight scale, threshold in trained weights and state bits
/// below an arriving 1. `build` makes rows and rotations from the threshold in units of the state.
fn loihi2(
    problems: &Problems,
    span: Span,
    kind: NeuronKind,
    (scale, theta, state_exp): (f64, f64, i32),
    build: impl FnOnce(i32) -> (Vec<ParameterRow>, Vec<[f32; 2]>),
) -> Result<(Cells, Option<Mantissas>)> {
    let scale = problems.number(span, "weight_scale", scale, 1e-6, 1e6)?;
    let mantissas = Mantissas { scale: scale as f32, exponent: WeightExponent::ZERO };
    let unit = f64::from(mantissas.unit()) * f64::from(1 << state_exp);
    let mut threshold = 0;
    if let Some(parameter) = kind.parameters().iter().find(|parameter| parameter.storage == Storage::Threshold) {
        let theta = problems.number(span, "theta", theta, 1e-6, 1e6)?;
        threshold = problems.field(span, parameter.field.check((theta * unit).round() as i64))? as i32;
    }
    let (rows, turns) = build(threshold);
    let (theta, weight_unit, unit) = (theta as f32, mantissas.unit(), unit as f32);
    Ok((Cells::Loihi2(Loihi2 { kind, rows, turns, theta, weight_unit, unit }), Some(mantissas)))
}

/// The plan of a training file's text.
#[cfg(test)]
pub(super) fn planned(text: &str) -> Plan {
    let source = SourceText::new("x", text);
    plan(&TrainingFile::parse(&source).unwrap(), &source).unwrap()
}
