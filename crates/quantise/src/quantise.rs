//! [`Graph`] -> [`Quantised`]: every number becomes an integer that fits its hardware field, or is
//! refused by name.
//!
//! A population is in one of two domains. With `vth_mant` its threshold, bias and incoming weights
//! are the hardware's own integers (a projection may still give real weights with a
//! `weight_scale`). With a real `vth` all incoming weights are real, and one scale S, in register
//! units a real unit, turns them into integers. A weight of a format with exponent e has mantissa
//! `w S / 2^(6 + e)`, the threshold mantissa is `vth S / 64`, the bias `b S`. S and the exponents
//! come from [`super::exponents`], unless a `weight_scale` pins S or a projection gives its
//! exponent.
//!
//! Time constants become `4096 (1 - exp(-dt / tau))`, the exact decay of an exponential over one
//! timestep. Weights are rounded to their format's least step by `weight_rounding`
//! (`docs/semantics.md`, weights); every change is left as a note. Better integers are not searched
//! for.

use std::fmt::Display;
use std::sync::Arc;

use petgraph::graph::NodeIndex;

use crate::apart::{self, Populations, Projections, TooMany};
use crate::carry;
use crate::exponents::{Detail, assigned};
use nsim_dynamics as neuron;
use nsim_ir::arithmetic::{Semantics, WeightRounding};
use nsim_ir::base::diagnostic::{Diagnostic, Result, Span, collect_all};
use nsim_ir::base::fixed::{
    BiasExponent, BiasMantissa, DECAY_ONE, Field, SignMode, THRESHOLD_SHIFT, ThresholdMantissa, WEIGHT_SHIFT,
    WeightBits, WeightExponent,
};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId, ProjectionId, RuleId};
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::graph::{self, Graph, NeuronParameters, PerCompartment, PopulationKind, ProjectionKind, Values};
use nsim_ir::learning::{LearningSemantics, Plastic};
use nsim_ir::neurons::{Conversion, ParameterField};
use nsim_ir::quantised::connectivity::{Connectivity, SeparateSum, SynapseFormat};
use nsim_ir::quantised::{Neuron, Neurons, Note, Parts, Population, Projection, Quantised, Reset, Rounded, Units};

/// Turns real parameters into integers.
///
/// # Errors
/// A diagnostic at the first number that fits no field, with its place in the model file.
pub fn quantise(graph: &Graph) -> Result<Quantised> {
    quantise_with(graph, Detail::default())
}

/// Turns real parameters into integers, with exponents of this granularity.
///
/// # Errors
/// As [`quantise`].
pub fn quantise_with(graph: &Graph, detail: Detail) -> Result<Quantised> {
    let graph = &assigned(graph, detail);
    let mut stage = Stage { graph, notes: Vec::new(), warnings: graph.facts().warnings.clone() };
    let scales: Vec<Option<f64>> =
        graph.populations().map(|(node, population)| stage.scale(node, population)).collect::<Result<_, _>>()?;
    let (mut channels, mut compartments) = (0, 0);
    let mut populations: Populations = IdVec::new();
    let mut problems = Vec::new();
    for ((_, population), scale) in graph.populations().zip(&scales) {
        let units = match &population.kind {
            PopulationKind::Input => {
                let first = ChannelId(channels);
                channels += population.shape.len();
                Units::Input(first)
            }
            PopulationKind::Neurons(parameters) => {
                let first = CompartmentId(compartments);
                compartments += population.shape.len();
                let neurons = match stage.neurons(population, parameters, *scale) {
                    Ok(neurons) => neurons,
                    Err(problem) => {
                        problems.push(Err(problem));
                        continue;
                    }
                };
                Units::Compartments { first, neurons, start_step: parameters.start_step }
            }
            PopulationKind::Srm(_) => return Err(stage.real_neurons(population)),
        };
        let (name, message) = (population.name.clone(), population.message);
        populations.push(Population { name, shape: population.shape, units, message });
    }
    let projections = graph
        .projections()
        .map(|(_, source, target, projection)| stage.projection(source, target, projection, scales[target.index()]));
    let mut projections: Projections = collect_all(problems.into_iter().chain(projections))?.into_iter().collect();
    stage.narrow_sums(&mut populations, &mut projections)?;
    if detail >= Detail::Carried {
        carry::carry(graph, &populations, &scales, &mut projections);
    }
    let facts = graph.facts();
    let parts = Parts {
        name: facts.name.clone(),
        timestep_ms: facts.timestep_ms,
        populations,
        projections,
        children: Vec::new(),
        rules: facts.rules.iter().map(|rule| rule.learning.clone()).collect(),
        output: population_id(graph.output()),
        decision: facts.decision,
        drain: facts.drain,
        classes: facts.classes.clone(),
        semantics: facts.semantics,
        threshold: facts.threshold,
        reset: facts.reset.map(|reset| Reset { interval: reset.interval as u32, offset: reset.offset as u32 }),
        notes: stage.notes,
        warnings: stage.warnings,
        gathers: false,
    };
    // An error from here on is an internal error of this stage, reported instead of trusted.
    Quantised::new(parts).map_err(|e| Diagnostic::new("model.inconsistent", e.to_string()).in_file(facts.source.path()))
}

/// Register units a real unit of each population, in the order of the file; none where the model
/// gives integers.
///
/// # Errors
/// As [`quantise`], for thresholds and scales.
pub fn scales(graph: &Graph, detail: Detail) -> Result<Vec<Option<f64>>> {
    let graph = &assigned(graph, detail);
    let stage = Stage { graph, notes: Vec::new(), warnings: Vec::new() };
    graph.populations().map(|(node, population)| stage.scale(node, population)).collect()
}

/// Nodes are added in the order of the file, so populations have the numbers of their nodes.
fn population_id(node: NodeIndex) -> PopulationId {
    PopulationId(node.index() as u32)
}

struct Stage<'a> {
    graph: &'a Graph,
    notes: Vec<Note>,
    warnings: Vec<Warning>,
}

/// `x` as a multiple of `step`, by the named rounding.
fn to_step(x: f64, step: i16, rounding: WeightRounding) -> f64 {
    let steps = x / f64::from(step);
    let whole = match rounding {
        WeightRounding::Even => steps.round_ties_even(),
        WeightRounding::Truncate => steps.trunc(),
        WeightRounding::Floor => steps.floor(),
    };
    whole * f64::from(step)
}

impl Stage<'_> {
    fn error(&self, code: &'static str, message: impl Into<String>, span: Span) -> Diagnostic {
        let diagnostic = Diagnostic::new(code, message);
        // A default value has no place in the file.
        if span == Span::default() { diagnostic } else { diagnostic.at(&self.graph.facts().source, span) }
    }

    fn note(&mut self, entity: &str, message: impl Into<String>) {
        self.notes.push(Note { entity: entity.to_string(), message: message.into(), rounded: None });
    }

    fn real_neurons(&self, population: &graph::Population) -> Diagnostic {
        let what = format!("population '{}' has spike response neurons, which have no integer form", population.name);
        self.error("model.srm-unconverted", what, population.span).help("run it with --engine reference")
    }

    fn format(&self, projection: &graph::Projection) -> Result<SynapseFormat> {
        let wrong = |e: &dyn Display, span: Span| {
            self.error("model.synapse-format", format!("projection {}: {e}", projection.name), span)
        };
        let (exponent, bits) = (&projection.weight_exp, &projection.weight_bits);
        let exponent = WeightExponent::new(exponent.value).map_err(|e| wrong(&e, exponent.span))?;
        let width = WeightBits::new(bits.value).map_err(|e| wrong(&e, bits.span))?;
        if width.get() == 7 || (projection.sign == SignMode::Mixed && width.get() == 1) {
            let message =
                format!("projection {}: {width} {:?} weight bits cannot be stored", projection.name, projection.sign);
            return Err(self
                .error("model.synapse-format", message, bits.span)
                .help("give 1 to 6 or 8 bits; a sign takes one of them (nengo-loihi: real widths 0 to 6 and 8)"));
        }
        let (sign, port) = (projection.sign, projection.port);
        Ok(SynapseFormat { exponent, sign, bits: width, port, apart: None, rule: projection.rule })
    }

    /// lava shifts the sum of a projection's weights by a negative exponent, equation (1) each
    /// weight. Where a weight would lose bits under lava's semantics, or into a kind of Loihi 2,
    /// arrivals are summed in finer units and shifted once (rules 11 and 39). Where one shift does
    /// not suffice, and where a convolution may wrap, kinds of Loihi 2 have separate sums (rules 39
    /// and 40).
    fn narrow_sums(&mut self, populations: &mut Populations, projections: &mut Projections) -> Result<()> {
        let lava = self.graph.facts().semantics == Semantics::Lava;
        let mut by_target: IdVec<PopulationId, Vec<ProjectionId>> = populations.iter().map(|_| Vec::new()).collect();
        projections.enumerate().for_each(|(id, projection)| by_target[projection.target].push(id));
        for (target, into) in by_target.enumerate() {
            let population = &populations[target];
            let Units::Compartments { neurons, .. } = &population.units else { continue };
            let (name, whole) = (population.name.clone(), neurons.any(|neuron| !neuron.kind.table().registers));
            let refused = |message: String, help: &str| {
                let span = self.graph.populations().nth(target.index()).map_or(Span::default(), |(_, p)| p.span);
                Err(self.error("model.semantics", format!("population '{name}': {message}"), span).help(help))
            };
            if whole {
                match apart::assign(self.graph, populations, projections, into) {
                    Ok(None) => {}
                    Ok(Some(0)) => continue,
                    Ok(Some(shifted)) => {
                        let what = format!("input of {shifted} of its projections is shifted separately, as in lava");
                        self.note(&name, what);
                        continue;
                    }
                    Err(TooMany(sums)) => {
                        let most = SeparateSum::MOST;
                        let what =
                            format!("its input makes {sums} sums that lava wraps separately, the limit is {most}");
                        return refused(what, "use fewer delays, or weights that are multiples of 2^-weight_exp");
                    }
                }
            }
            let lossy = into.iter().map(|&id| &projections[id]).filter(|projection| apart::loses_bits(projection));
            let exponents = lossy.map(|projection| projection.format.exponent.get());
            let Some(exponent) = exponents.min().filter(|_| lava || whole) else { continue };
            if !apart::one_shift_does(projections, into) {
                let message = format!(
                    "lava shifts sums, so at most one projection into it may have a negative weight_exp that drops \
                     bits of weights; the others may exceed it by at most {}",
                    WeightExponent::MAX
                );
                let help = "raise the weight_exp of all projections into it by n and multiply vth_mant and \
                            bias_mant by 2^n, or use semantics Hardware";
                return refused(message, help);
            }
            if let Units::Compartments { neurons, .. } = &mut populations[target].units {
                *neurons = neurons
                    .try_map(|_, neuron| Ok::<_, Diagnostic>(Neuron { shift: exponent.unsigned_abs(), ..neuron }))?;
            }
            self.note(&name, format!("input is shifted by {} bits in total, as in lava", -exponent));
            for &id in into {
                let format = &mut projections[id].format;
                let raised = i64::from(format.exponent.get() - exponent);
                format.exponent = WeightExponent::new(raised)
                    .map_err(|e| self.error("model.synapse-format", e.to_string(), Span::default()))?;
            }
        }
        Ok(())
    }

    /// Register units a real unit of a population; `None` without a real threshold.
    fn scale(&self, node: NodeIndex, population: &graph::Population) -> Result<Option<f64>> {
        let PopulationKind::Neurons(parameters) = &population.kind else { return Ok(None) };
        let Some(threshold) = parameters.real("vth") else { return Ok(None) };
        let greatest = threshold.each.values().iter().copied().reduce(f64::max).unwrap_or(f64::MIN);
        if greatest <= 0.0 {
            let message = format!("population '{}': a real threshold of {greatest} is not above 0", population.name);
            return Err(self.error("model.threshold", message, threshold.span));
        }
        fn register(mantissa: f64, exponent: f64) -> f64 {
            mantissa * (exponent + f64::from(WEIGHT_SHIFT)).exp2()
        }
        let mut pinned: Option<f64> = None;
        let mut largest = f64::from(ThresholdMantissa::MAX.get()) * 64.0 / greatest;
        let mut driven = false;
        for (_, projection) in self.graph.incoming(node) {
            let format = self.format(projection)?;
            let exponent = f64::from(format.exponent.get());
            if let Some(scale) = &projection.weight_scale {
                let in_registers = register(scale.value, exponent);
                if pinned.is_some_and(|other| other != in_registers) {
                    let name = &population.name;
                    let message = format!("population '{name}': its projections' weight_scale imply different scales");
                    return Err(self.error("model.weight-scale", message, scale.span).help(
                        "give projections equal weight_scale times 2^weight_exp, because their inputs share one \
                         threshold",
                    ));
                }
                pinned = Some(in_registers);
            }
            let (low, high) = format.sign.range(format.bits);
            projection.kind.each_weight(|weight| {
                let limit = if weight < 0.0 { f64::from(low) } else { f64::from(high) };
                // A weight of the wrong sign for its mode is refused where it is quantised.
                if weight != 0.0 && limit != 0.0 {
                    driven = true;
                    largest = largest.min(register(limit / weight, exponent));
                }
            });
        }
        // Without weights nothing limits the scale; a threshold of 1,024 mantissa units leaves room
        // for a bias.
        let free = if driven { largest } else { largest.min(1024.0 * 64.0 / greatest) };
        Ok(Some(pinned.unwrap_or(free)))
    }

    /// Integers of a field, one for all compartments or one each.
    fn field(
        &self,
        population: &str,
        what: &str,
        values: &Values,
        field: Field,
        to_integer: impl Fn(f64) -> f64,
    ) -> Result<PerCompartment<i64>> {
        values.each.try_map(|index, value| {
            let of = index.map_or(String::new(), |i| format!(" of compartment {i}"));
            let integer = to_integer(value);
            if integer.fract() != 0.0 || integer.abs() > 9e15 {
                let message = format!(
                    "population '{population}': {what}{of} {value} is not an integer that the hardware can store"
                );
                return Err(self.error("model.not-integer", message, values.span));
            }
            field.check(integer as i64).map_err(|e| {
                let message = format!("population '{population}': {what}{of}: {e}");
                self.error("model.range", message, values.span)
            })
        })
    }

    /// Integers of one parameter, from integers, real numbers or its default.
    fn parameter(
        &self,
        name: &str,
        p: &NeuronParameters,
        parameter: &ParameterField,
        scale: Option<f64>,
    ) -> Result<PerCompartment<i64>> {
        let what = parameter.name;
        if let Some(values) = p.get(what) {
            return self.field(name, what, values, parameter.field, |x| x);
        }
        let scaled = |unit: f64| move |x: f64| (x * scale.unwrap_or(1.0) / unit).round_ties_even();
        match parameter.real.and_then(|(real, conversion)| Some((real, conversion, p.get(real)?))) {
            None => Ok(PerCompartment::Same(parameter.default.unwrap_or(0))),
            Some((_, Conversion::TimeConstant, values)) => {
                let positive = values.each.try_map(|_, tau| if tau > 0.0 { Ok(()) } else { Err(tau) });
                if let Err(tau) = positive {
                    let message = format!("population '{name}': a time constant of {tau} ms is not above 0");
                    return Err(self
                        .error("model.time-constant", message, values.span)
                        .help("give an effective decay of 4096 for no memory"));
                }
                let dt = self.graph.facts().timestep_ms;
                let decay = |tau: f64| (DECAY_ONE as f64 * -(-dt / tau).exp_m1()).round_ties_even();
                self.field(name, what, values, parameter.field, decay)
            }
            Some((real, Conversion::Threshold, values)) => {
                self.field(name, real, values, parameter.field, scaled(f64::from(1 << THRESHOLD_SHIFT)))
            }
            Some((_, Conversion::BiasMantissa, values)) => {
                self.real_bias(name, values, scaled(1.0))?.try_map(|_, (mantissa, _)| Ok(mantissa))
            }
            Some((_, Conversion::BiasExponent, values)) => {
                // The conversion of the mantissa reports the error.
                let bias = self.real_bias(name, values, scaled(1.0)).unwrap_or(PerCompartment::Same((0, 0)));
                bias.try_map(|_, (_, exponent)| Ok(exponent))
            }
        }
    }

    fn neurons(&mut self, population: &graph::Population, p: &NeuronParameters, scale: Option<f64>) -> Result<Neurons> {
        let (name, semantics) = (&population.name, self.graph.facts().semantics);
        if !neuron::semantics(p.kind).contains(&semantics) {
            let message = format!("population '{name}': semantics {semantics:?} does not support {}", p.kind.name());
            return Err(self.error("model.semantics", message, population.span));
        }
        let integers = p.kind.parameters().iter().map(|parameter| self.parameter(name, p, parameter, scale));
        let integers = collect_all(integers)?;
        let neuron = |index: u32| {
            let values: Vec<i64> = integers.iter().map(|values| values.get(index)).collect();
            neuron::neuron(p.kind, &values)
                .map_err(|e| self.error("model.range", format!("population '{name}': {e}"), population.span))
        };
        let same = integers.iter().all(|values| matches!(values, PerCompartment::Same(_)));
        let neurons = match same {
            true => PerCompartment::Same(neuron(0)?),
            false => PerCompartment::Each((0..population.shape.len()).map(neuron).collect::<Result<_, _>>()?),
        };
        for (parameter, why) in neuron::ignored_parameters(&neurons, semantics) {
            let message = format!(
                "{parameter} is ignored under semantics {semantics:?}: {why}. Remove it, or take the chip's arithmetic: \
                 --set semantics=Hardware"
            );
            self.warnings.push(Warning::of_population(WarningCode::ParameterIgnored, name, message));
        }
        if let Some(scale) = scale {
            self.note(name, format!("1 real unit is {scale:.6} register units"));
        }
        Ok(neurons)
    }

    /// Mantissa and exponent nearest to a real bias: the least exponent that its magnitude fits.
    fn real_bias(&self, name: &str, values: &Values, scale: impl Fn(f64) -> f64) -> Result<PerCompartment<(i64, i64)>> {
        values.each.try_map(|index, value| {
            let register = scale(value);
            let fitting = (0..=i64::from(BiasExponent::MAX.get())).find_map(|exponent| {
                let mantissa = (register / (exponent as f64).exp2()).round_ties_even();
                Some((BiasMantissa::FIELD.check(mantissa as i64).ok()?, exponent))
            });
            fitting.ok_or_else(|| {
                let of = index.map_or(String::new(), |i| format!(" of compartment {i}"));
                let message = format!(
                    "population '{name}': bias{of} {value} is {register} register units, the limit is 4095 * 2^7"
                );
                let most = value / register * f64::from(4095 << 7);
                self.error("model.range", message, values.span).help(format!(
                    "limit it to {most:.4} either side of 0, the largest bias at the scale of these weights; with a \
                     bias beyond its threshold, a neuron spikes in every step or never"
                ))
            })
        })
    }

    fn projection(
        &mut self,
        source: NodeIndex,
        target: NodeIndex,
        projection: &graph::Projection,
        scale: Option<f64>,
    ) -> Result<Projection> {
        let format = self.format(projection)?;
        if let PopulationKind::Neurons(p) = &self.graph.population(target).kind {
            let (name, table) = (&projection.name, p.kind.table());
            if format.port.index() >= usize::from(table.ports) {
                let message = format!("projection {name}: {} neurons have one sum of arrivals", p.kind.name());
                return Err(self.error("model.port", message, projection.span).help("remove port: Second"));
            }
        }
        if let Some(scale) = &projection.weight_scale
            && !(scale.value.is_finite() && scale.value > 0.0)
        {
            let message = format!("projection {}: weight_scale {} is not above 0", projection.name, scale.value);
            return Err(self.error("model.weight-scale", message, scale.span));
        }
        // Mantissa units a unit of the given weights; none when these are mantissas already.
        let factor = match (scale, &projection.weight_scale) {
            (Some(scale), _) => Some(scale / (f64::from(format.exponent.get()) + f64::from(WEIGHT_SHIFT)).exp2()),
            (None, Some(scale)) => Some(scale.value),
            (None, None) => None,
        };
        let to = self.rounding(format);
        let mut rounding =
            Rounding { stage: self, projection, format, factor, to, changed: 0, most: 0.0, greatest: 0.0, seen: 0 };
        let sources = rounding.stage.graph.population(source).shape.len();
        let targets = rounding.stage.graph.population(target).shape.len();
        let connectivity = rounding.connectivity(sources, targets)?;
        let Rounding { changed, most, greatest, seen, .. } = rounding;
        if changed > 0 {
            let step = format.sign.step(format.bits);
            let message =
                format!("rounding to multiples of {step} changed {changed} of {seen} weights, by at most {most:.3}");
            let rounded =
                Some(Rounded { real: factor.is_some(), changed, weights: seen, worst_share: most / greatest });
            if factor.is_none() {
                let target = &self.graph.population(target).name;
                let remedy = exact_format(projection, format);
                let text = format!("projection {}: {message} (not in the reference engine): {remedy}", projection.name);
                self.warnings.push(Warning::of_population(WarningCode::WeightsRounded, target, text));
            }
            self.notes.push(Note { entity: projection.name.clone(), message, rounded });
        }
        Ok(Projection {
            name: projection.name.clone(),
            source: population_id(source),
            target: population_id(target),
            format,
            delay: projection.delay,
            connectivity,
            plastic: projection.rule.map(|rule| Arc::new(self.plastic(projection, rule, sources, targets))),
        })
    }

    /// The rounding of weights. lava cuts the first weights of a rule to their format.
    fn rounding(&self, format: SynapseFormat) -> WeightRounding {
        let facts = self.graph.facts();
        let semantics = format.rule.map(|rule| facts.rules[rule].learning.rule.semantics());
        match (semantics, format.sign) {
            (Some(LearningSemantics::Lava), SignMode::Inhibitory) => WeightRounding::Truncate,
            (Some(LearningSemantics::Lava), _) => WeightRounding::Floor,
            _ => facts.weight_rounding,
        }
    }

    /// The state of a projection's synapses besides weights, source by source.
    fn plastic(&self, projection: &graph::Projection, rule: RuleId, sources: u32, targets: u32) -> Plastic {
        let declared = &self.graph.facts().rules[rule];
        let first = projection.first_source;
        let rows: Arc<[u32]> = match &projection.kind {
            ProjectionKind::Sparse { synapses } => sorted(synapses).iter().map(|synapse| synapse.3).collect(),
            ProjectionKind::Random { fan_out, .. } => (first * fan_out..(first + sources) * fan_out).collect(),
            _ => {
                let row = |source: u32| (0..targets).map(move |target| target * declared.sources + first + source);
                (0..sources).flat_map(row).collect()
            }
        };
        let values = |of: &PerCompartment<i16>| -> Arc<[i16]> {
            match of {
                PerCompartment::Same(0) => Arc::new([]),
                _ => rows.iter().map(|&row| of.get(row)).collect(),
            }
        };
        let (tags, delays) = (values(&declared.tags), values(&declared.delays));
        let signals = declared.signals.map(|signal| signal.map(population_id));
        Plastic { rule, first_source: first, rows, tags, delays, signals, reward: declared.reward.map(population_id) }
    }
}

/// Listed synapses source by source, by target; those of one pair as they are listed.
fn sorted(synapses: &[(u32, u32, f64, u32)]) -> Vec<(u32, u32, f64, u32)> {
    let mut sorted = synapses.to_vec();
    sorted.sort_by_key(|&(source, target, ..)| (source, target));
    sorted
}

/// Converts weights to mantissas, and counts their changes by rounding.
struct Rounding<'a, 'b> {
    stage: &'a mut Stage<'b>,
    projection: &'a graph::Projection,
    format: SynapseFormat,
    factor: Option<f64>,
    to: WeightRounding,
    changed: u64,
    most: f64,
    /// Greatest magnitude of a weight, in mantissas.
    greatest: f64,
    seen: u64,
}

impl Rounding<'_, '_> {
    fn mantissa(&mut self, weight: f64, which: impl Display, place: impl Fn() -> Span) -> Result<i16> {
        let name = &self.projection.name;
        let exact = weight * self.factor.unwrap_or(1.0);
        if !exact.is_finite() {
            let message = format!("projection {name}: weight {which} is not a finite number");
            return Err(self.stage.error("model.not-finite", message, place()));
        }
        if self.factor.is_none() && exact.fract() != 0.0 {
            let message = format!("projection {name}: weight {which} {weight} is not an integer");
            return Err(self
                .stage
                .error("model.weight-not-integer", message, place())
                .help("give weight_scale, which real weights need with an integer vth_mant, or give a real vth"));
        }
        let step = self.format.sign.step(self.format.bits);
        let rounded = to_step(exact, step, self.to);
        let (low, high) = self.format.sign.range(self.format.bits);
        if !(f64::from(low)..=f64::from(high)).contains(&rounded) {
            let (bits, sign) = (self.format.bits, self.format.sign);
            let remark = if rounded == weight { String::new() } else { format!(", rounded {rounded},") };
            let message = format!(
                "projection {name}: weight {which} {weight}{remark} is outside {low}..={high} of {bits} {sign:?} bits"
            );
            return Err(self
                .stage
                .error("model.weight-range", message, place())
                .help("raise weight_exp and halve the weights, choose another sign mode, or scale weights and threshold together"));
        }
        self.seen += 1;
        self.greatest = self.greatest.max(exact.abs());
        let change = (rounded - exact).abs();
        if change > 0.0 {
            self.changed += 1;
            self.most = self.most.max(change);
        }
        Ok(rounded as i16)
    }

    fn connectivity(&mut self, sources: u32, targets: u32) -> Result<Connectivity> {
        let (projection, name) = (self.projection, &self.projection.name);
        let facts = self.stage.graph.facts();
        let place = |entry: usize| move || projection.place_of(&facts.source, entry as u32);
        match &projection.kind {
            ProjectionKind::Dense { weights } => {
                let mut by_source = vec![0i16; sources as usize * targets as usize];
                let columns = weights.shape().get(1).copied().unwrap_or(1);
                for target in 0..targets as usize {
                    for source in 0..sources as usize {
                        let column = projection.first_source as usize + source;
                        let weight = weights.real(target * columns + column);
                        by_source[source * targets as usize + target] =
                            self.mantissa(weight, format_args!("[{target}, {column}]"), place(target))?;
                    }
                }
                Ok(Connectivity::Dense { targets, weights: by_source.into() })
            }
            ProjectionKind::Sparse { synapses } => {
                // In the order of the list, so that the first wrong weight is reported.
                let mut mantissas = Vec::with_capacity(synapses.len());
                for &(source, target, weight, entry) in synapses {
                    let place = place(entry as usize);
                    let mantissa = self.mantissa(weight, format_args!("[{source}, {target}]"), place)?;
                    mantissas.push((source, target, f64::from(mantissa), entry));
                }
                let sorted = sorted(&mantissas);
                let begin = |source: u32| sorted.partition_point(|synapse| synapse.0 < source) as u64;
                Ok(Connectivity::Sparse {
                    first: (0..=sources).map(begin).collect(),
                    targets: sorted.iter().map(|s| s.1).collect(),
                    weights: sorted.iter().map(|s| s.2 as i16).collect(),
                })
            }
            ProjectionKind::Conv2d { window, weights } => {
                let per_channel = weights.len() / window.target.0 as usize;
                let kernel = (0..weights.len())
                    .map(|i| {
                        let channel = i / per_channel;
                        let within = i % per_channel;
                        self.mantissa(weights.real(i), format_args!("[{channel}, {within}]"), place(channel))
                    })
                    .collect::<Result<Arc<[i16]>, _>>()?;
                Ok(Connectivity::Conv2d { window: *window, kernel })
            }
            ProjectionKind::SumPool2d { window, weight } => {
                let weight = self.mantissa(weight.value, "of the pool", || weight.span)?;
                Ok(Connectivity::SumPool2d { window: *window, weight })
            }
            ProjectionKind::Random { fan_out, low, high, seed } => {
                let step = self.format.sign.step(self.format.bits);
                let mut bound = |bound: &nsim_ir::spanned::Spanned<i64>, what: &str| {
                    if bound.value % i64::from(step) != 0 {
                        let message = format!("projection {name}: {what} {} is not a multiple of {step}", bound.value);
                        return Err(self.stage.error("model.random", message, bound.span));
                    }
                    self.mantissa(bound.value as f64, what, || bound.span)
                };
                let (least, greatest) = (bound(low, "low")?, bound(high, "high")?);
                if self.factor.is_some() || least > greatest {
                    let message = match self.factor {
                        Some(_) => {
                            format!("projection {name}: random weights need an integer threshold and no weight_scale")
                        }
                        None => format!("projection {name}: low {least} is above high {greatest}"),
                    };
                    return Err(self.stage.error("model.random", message, low.span));
                }
                let (fan_out, seed, first_source) = (*fan_out, *seed, projection.first_source);
                Ok(Connectivity::Random { targets, fan_out, low: least, high: greatest, step, seed, first_source })
            }
        }
    }
}

/// The change of a projection's format that holds all its integer weights.
fn exact_format(projection: &graph::Projection, format: SynapseFormat) -> String {
    let SynapseFormat { exponent, sign, bits, .. } = format;
    let widest = WeightBits::MAX;
    // Sign, bits, factor of the weights, and the words for it. A doubled weight needs one exponent
    // less, which loses no bits from -6 on.
    let doubles = if exponent.get() > -6 { 2.0 } else { 1.0 };
    let changes = [
        (SignMode::Excitatory, bits, 1.0, "sign: Excitatory holds them, as none is negative"),
        (SignMode::Inhibitory, bits, 1.0, "sign: Inhibitory holds them, as none is positive"),
        (sign, widest, 1.0, "weight_bits: 8 holds them"),
        (SignMode::Excitatory, widest, 1.0, "sign: Excitatory with weight_bits: 8 holds them, as none is negative"),
        (SignMode::Inhibitory, widest, 1.0, "sign: Inhibitory with weight_bits: 8 holds them, as none is positive"),
        (sign, bits, doubles, "double them and lower weight_exp by 1, which preserves odd weights"),
    ];
    for (sign, bits, factor, words) in changes {
        let (step, (low, high), mut exact) = (f64::from(sign.step(bits)), sign.range(bits), true);
        projection.kind.each_weight(|weight| {
            let scaled = weight * factor;
            exact &= scaled % step == 0.0 && (f64::from(low)..=f64::from(high)).contains(&scaled);
        });
        if exact {
            return words.to_string();
        }
    }
    format!("give multiples of {}", sign.step(bits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_dynamics::synapses::Enumerate;
    use nsim_testing::graph;

    #[test]
    fn windows_and_random_synapses_lower() {
        let text = "Network(name: \"t\", timestep_ms: 1.0, populations: [
            Input(name: \"in\", shape: [2, 5, 5]), Loihi(name: \"pool\", shape: [2, 3, 2], du: 4096, dv: 4096, \
                          vth_mant: 1),
            Loihi(name: \"conv\", shape: [1, 2, 2], du: 4096, dv: 4096, vth_mant: 1),
            Loihi(name: \"o\", shape: [3], du: 4096, dv: 4096, vth_mant: 1)],
            projections: [SumPool2d(from: [\"in\"], to: \"pool\", kernel: (2, 2), padding: (1, 0), weight: 2),
             Conv2d(from: [\"pool\"], to: \"conv\", weights: [[[[2, 4]], [[6, 8]]]], padding: (0, 1), stride: (2, 2)),
             Random(from: [\"conv\"], to: \"o\", fan_out: 4, low: -6, high: 6, seed: 3, delay: 2)], output: \"o\")";
        let q = quantise(&graph(text)).unwrap();
        let pool = &q.projections().as_slice()[0].connectivity;
        let mut reached = Vec::new();
        pool.for_each_from(25 + 4 * 5 + 3, |target, weight| reached.push((target, weight)));
        assert_eq!(reached, [(6 + 2 * 2 + 1, 2)], "row 4 + 1 of padding is in window row 2, column 3 in column 1");
        let conv = &q.projections().as_slice()[1].connectivity;
        let mut reached = Vec::new();
        conv.for_each_from(6 + 4, |target, weight| reached.push((target, weight)));
        assert_eq!(reached, [(2, 8)], "channel 1, row 2, column 0 of the pool meets column 1 of the kernel");
        assert_eq!(q.projections().as_slice()[2].connectivity.count_from(3), 4);
    }
}
