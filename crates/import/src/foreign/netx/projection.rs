//! Weights and delays of a layer as projections.
//!
//! Input: weights of any range, delays of synapses, channels or units. Output: a projection in a
//! synapse format; where delays differ, a list of synapses for each delay.

use super::layer::Layer;
use super::reader::{LastPopulation, Reader};
use crate::foreign::encode;
use crate::foreign::imported::{LONGEST_DELAY, LayerWeights};
use crate::foreign::window::{MOST_LISTED, by_delay, synapse_list};
use nsim_files::network::{ProjectionDesc, ProjectionKind};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::warning::WarningCode;
use nsim_ir::neurons::NeuronKind;

impl Reader<'_> {
    /// Adds the projection from `source`, with its weights in a format that represents them.
    pub(super) fn project(
        &mut self,
        layer: &Layer<'_>,
        source: &LastPopulation,
        to: &str,
        key: &str,
        kind: impl FnOnce(Vec<f64>) -> ProjectionKind,
    ) -> Result<()> {
        if self.model.population(&source.name).is_some_and(|population| population.kind == NeuronKind::GradedLif) {
            return Err(layer.unsupported(
                format!("the spikes of '{}' carry voltages, which lava-dl weights in 4096ths", source.name),
                "graded spikes are imported in the last layer; export the others with graded_spike=False",
            ));
        }
        // netx reads weights as integers, toward zero.
        let delays = layer.reals(key)?;
        let whole: Vec<f64> = delays.iter().map(|x| x.trunc() + 0.0).collect();
        let cut = delays.iter().zip(&whole).filter(|(a, b)| a != b).count();
        if cut > 0 {
            let message = format!("{cut} numbers of '{key}' are not whole and lose their fraction");
            self.warn(layer, WarningCode::FractionLost, message);
        }
        let exponent =
            ["neuron/wgtExp", "neuron/weight_exp"].iter().find_map(|key| layer.group.number(key)).unwrap_or(0.0);
        if exponent.fract() != 0.0 || !(-8.0..=7.0).contains(&exponent) {
            return Err(layer.wrong(format!("a weight exponent of {exponent}, outside -8 to 7")));
        }
        let encoded = encode::encode(whole, exponent as i64);
        if encoded.changed > 0 {
            let message = format!(
                "{} of {} numbers of '{key}' do not fit into one synapse format with the others; they are rounded to \
                 even steps and clipped",
                encoded.changed,
                delays.len()
            );
            self.warn(layer, WarningCode::WeightsRounded, message);
        }
        let made = encoded.in_units(exponent as i64);
        let line = LayerWeights::new(to, layer.numbers(key)?.shape(), 1.0, &delays, &made);
        if line.is_lost() {
            return Err(layer.wrong(format!("the weights are too small for integers: {line}")).help(
                "netx weights are integers, as lava-dl's export_hdf5 writes them; quantise the network before \
                       it is exported",
            ));
        }
        self.layers.push(line);
        let exponent = encoded.exponent();
        let kind = kind(encoded.weights);
        self.connect(layer, source, to, kind, exponent, encoded.sign.stated())
    }

    /// Adds a projection, or one for each delay of its sources or synapses.
    pub(super) fn connect(
        &mut self,
        layer: &Layer<'_>,
        source: &LastPopulation,
        to: &str,
        kind: ProjectionKind,
        weight_exp: Option<i64>,
        sign: Option<SignMode>,
    ) -> Result<()> {
        let first = source.delays.first().copied().unwrap_or(0);
        let mut projection =
            ProjectionDesc { delay: first, weight_exp, sign, ..ProjectionDesc::new(&source.name, to, kind) };
        let synaptic = self.synaptic_delays(layer, source)?;
        if synaptic.is_none() && source.delays.iter().all(|&delay| delay == first) {
            self.model.projections.push(projection);
            return Ok(());
        }
        let target = self.model.population(to).map_or(&[][..], |population| &population.shape);
        let kind = std::mem::replace(&mut projection.kind, ProjectionKind::Sparse(Vec::new()));
        let synapses = synapse_list(kind, &source.shape, target).ok_or_else(|| {
            layer.unsupported(
                format!("its delays differ, so more than {MOST_LISTED} synapses would be listed individually"),
                "give all units of the layer before it one delay",
            )
        })?;
        let delay_of = |from: u64, target: u64| {
            let axonal = source.delays.get(from as usize).copied().unwrap_or(0);
            let own = synaptic.as_ref().map_or(0, |delays| delays[(target * source.units() + from) as usize]);
            axonal + own
        };
        let longest = synapses.iter().map(|synapse| delay_of(synapse.0, synapse.1)).max().unwrap_or(0);
        if f64::from(longest) > LONGEST_DELAY {
            let message = format!("delays of its synapses and of '{}' add up to {longest} steps", source.name);
            return Err(layer.unsupported(message, "the delay field holds 0 to 62"));
        }
        self.model.projections.extend(by_delay(&projection, synapses, delay_of));
        Ok(())
    }

    /// The file's delays, rounded down and clipped to 62.
    pub(super) fn delay_numbers(&self, layer: &Layer<'_>) -> Result<Option<Vec<u32>>> {
        if layer.group.get("delay").is_none() {
            return Ok(None);
        }
        let floors: Vec<f64> = layer.reals("delay")?.iter().map(|x| x.floor()).collect();
        match floors.iter().find(|delay| **delay < 0.0) {
            Some(delay) => {
                Err(layer.unsupported(format!("a delay of {delay} steps"), "spikes cannot arrive before they are sent"))
            }
            None => Ok(Some(floors.iter().map(|&delay| delay.min(LONGEST_DELAY) as u32).collect())),
        }
    }

    /// Warns of delays that [`Self::delay_numbers`] changes.
    fn note_delays(&mut self, layer: &Layer<'_>) -> Result<()> {
        let given = layer.reals("delay")?;
        let longest = given.iter().copied().fold(0.0, f64::max);
        let clipped = given.iter().filter(|delay| delay.floor() > LONGEST_DELAY).count();
        if clipped > 0 {
            let message = format!(
                "{clipped} of {} delays are beyond {LONGEST_DELAY} steps, the greatest (up to {longest}), and are \
                 clipped to it, as in netx",
                given.len()
            );
            self.warn(layer, WarningCode::DelayClipped, message);
        }
        let cut = given.iter().filter(|delay| delay.fract() != 0.0).count();
        if cut > 0 {
            self.warn(layer, WarningCode::FractionLost, format!("{cut} delays are not whole and lose their fraction"));
        }
        Ok(())
    }

    /// Delays of the layer's own synapses, `[target][source]`; delays of its inputs are expanded.
    pub(super) fn synaptic_delays(&self, layer: &Layer<'_>, source: &LastPopulation) -> Result<Option<Vec<u32>>> {
        let Some(delays) = self.delay_numbers(layer)? else { return Ok(None) };
        let (targets, sources) = (self.last.as_ref().map_or(0, LastPopulation::units), source.units());
        let count = delays.len() as u64;
        if layer.kind == "average" || count <= 1 || self.is_axonal(count) {
            return Ok(None);
        }
        if targets.checked_mul(sources) == Some(count) {
            return Ok(Some(delays));
        }
        if count == sources && targets.checked_mul(sources).is_some_and(|all| all <= MOST_LISTED as u64) {
            return Ok(Some((0..targets).flat_map(|_| delays.iter().copied()).collect()));
        }
        Err(layer.wrong(format!("{count} delays for {sources} sources and {targets} targets")))
    }

    /// Whether `count` delays are of the layer's own spikes: one per channel or per unit.
    pub(super) fn is_axonal(&self, count: u64) -> bool {
        self.last.as_ref().is_some_and(|last| count == last.shape[0] || count == last.units())
    }

    /// Stores the delays of the layer's spikes for the next layer.
    pub(super) fn delays(&mut self, layer: &Layer<'_>) -> Result<()> {
        let (Some(delays), Some(mut last)) = (self.delay_numbers(layer)?, self.last.clone()) else { return Ok(()) };
        self.note_delays(layer)?;
        let count = delays.len() as u64;
        if count == 1 || self.is_axonal(count) {
            let delays = delays.iter().map(|&delay| f64::from(delay)).collect();
            let expanded = self.expand(layer, "delay", delays, &last.shape)?;
            last.delays = expanded.values().iter().map(|&delay| delay as u32).collect();
            self.last = Some(last);
        }
        Ok(())
    }
}
