//! PES, from `docs/learning.md`: weights that learn from an error. Functions name their equations.

use super::{Delivery, Learner, Numbers};
use crate::plastic::{Columns, Plastic};
use nsim_ir::learning::draws::{Place, Use};
use nsim_ir::learning::{GREATEST_ERROR, GREATEST_TRACE, PES_TRACE_EPOCH, Trace};

/// sround(z, r).
fn rounded(z: f64, r: f64) -> i64 {
    let magnitude = z.abs().floor();
    let up = z.abs() - magnitude > r;
    z.signum() as i64 * (magnitude as i64 + i64::from(up))
}

impl Learner {
    /// Whether the rule is PES, which learns from the arrivals of a step in that step.
    pub(crate) fn is_pes(&self) -> bool {
        self.rule.is_pes()
    }

    fn place_of_step(&self, numbers: Numbers<'_>, of: Use, step: u32) -> Place {
        Place { rule: self.id, of, part: 0, step: numbers.base + u64::from(step) }
    }

    /// Number of sources of the rule.
    fn source_count(&self) -> u32 {
        self.sources.last_key_value().map_or(0, |(&last, _)| last + 1)
    }

    /// (L12): the traces of the sources after the arrivals of a step.
    pub(crate) fn trace_arrivals(&mut self, numbers: Numbers<'_>, step: u32, delivery: &Delivery) {
        if !self.rule.notes(step) {
            return;
        }
        let settings = self.rule.trace(Trace::X1);
        let count = self.source_count() as usize;
        let indices: Vec<u32> = self.sources.keys().copied().collect();
        for index in indices {
            let (source, mut end) = self.sources[&index].clone();
            if delivery.carries(source).is_some() {
                end.note = 1;
            }
            if (step + 1).is_multiple_of(PES_TRACE_EPOCH) {
                let x = end.traces[Trace::X1.index()];
                let added = if end.note > 0 { f64::from(settings.impulse) } else { 0.0 };
                let z = libm::exp(-f64::from(PES_TRACE_EPOCH) / settings.tau.get()) * x as f64 + added;
                let number = (step + 1) / PES_TRACE_EPOCH - 1;
                let r = numbers.draws.each(self.place_of_step(numbers, Use::Trace, step), number, index, count);
                end.traces[Trace::X1.index()] = rounded(z, r).min(GREATEST_TRACE.into());
                end.note = 0;
            }
            self.sources.insert(index, (source, end));
        }
    }

    /// (L13): changes the weights of a projection after a step. Returns the number of synapses.
    pub(crate) fn learn_error(
        &self,
        numbers: Numbers<'_>,
        step: u32,
        delivery: &Delivery,
        plastic: &mut Plastic,
    ) -> u64 {
        let Columns([mut weights, delays, tags]) = plastic.latest().clone();
        let channels = self.signals[Trace::Y1.index()].as_ref().expect("PES has an error");
        let targets = self.targets.len();
        let s = i64::from(plastic.format.sign.step(plastic.format.bits));
        let (least, greatest) = plastic.format.sign.range(plastic.format.bits);
        for (weight, &(source, target)) in weights.iter_mut().zip(&plastic.ends) {
            let x = self.sources[&source].1.traces[Trace::X1.index()];
            let error = delivery.channels[channels[target as usize].0 as usize].unwrap_or(0);
            let error = error.clamp(-i64::from(GREATEST_ERROR), GREATEST_ERROR.into());
            let e = if (target as usize) < targets / 2 { -error } else { error };
            let z = 128 * i64::from(*weight) + (x * e).div_euclid(4);
            let number = (step + 1) / self.rule.epoch() - 1;
            let place = self.place_of_step(numbers, Use::Weight, step);
            let entity = source * targets as u32 + target;
            let r = numbers.draws.each(place, number, entity, self.source_count() as usize * targets);
            let whole = rounded(z as f64 / (128 * s) as f64, r).clamp(-(256 / s - 1), 256 / s - 1);
            *weight = ((s * whole) as i16).clamp(least, greatest);
        }
        let count = weights.len() as u64;
        plastic.write(step + 1, Columns([weights, delays, tags]));
        count
    }
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn magnitudes_are_rounded_by_chance() {
        let cases = [(2.25, 0.2), (2.25, 0.25), (-2.25, 0.2), (-2.25, 0.3), (-0.5, 0.9), (7.0, 0.0)];
        assert_eq!(cases.map(|(z, r)| rounded(z, r)), [3, 2, -3, -2, 0, 7]);
    }
}
