//! A bound on u and v that proves of some compartments that they can never spike.
//!
//! Input: what can fire at all. Output: which compartments can. A synapse delivers at most one spike a step, whatever
//! its delay, so what arrives in a step lies between the sum L of a compartment's negative scaled weights and the sum H of
//! its positive ones, each times the payload of its source's spikes, counted over the sources that can fire. Equation numbers refer to `docs/semantics.md`.
//!
//! *Registers.* Decay (3) is monotone and odd. From u = 0 (at the start, after a reset, while held) and with arrivals of at
//! most H >= 0, u never exceeds any X >= 0 with `decay(X) + H <= X`: if u <= X, the next u is at most decay(X) + H <= X. The
//! least such X is `ceiling`. L bounds u from below in the same way, and what then enters v bounds v. v returns to 0 at
//! resets, so a negative input bounds v by itself. Upper and lower bound are both needed, because a value that leaves its
//! field on one side may come back on the other:
//!
//! - *Hardware*: no claim when L or H leaves the 22 bits of the accumulator (2), a bound on u the 24 bits of u (4), or that
//!   bound with the bias the 24 bits of (5). v is clipped to vmin and vmax (6); a vmax that does not pass the threshold
//!   proves silence whatever wraps before it.
//! - *Lava*: no claim when a bound on u reaches -2^23 or 2^23, where u wraps. v is clipped to the whole field.
//! - *Slayer*: no claim when the magnitude of a bound times its decay factor reaches 2^32, where the product loses bits,
//!   or a bound leaves 32 bits. There is no clip and no bias.
//!
//! A compartment is silent when the bound on v does not pass the threshold test (7). One that never spikes is never
//! refractory.
//!
//! *Fixpoint.* Which compartments can fire is the least set F such that F holds every compartment whose bound, with the
//! living channels and F as its sources, passes the threshold. The others are silent by induction over time: a first spike
//! outside F in step t would have arrivals of living channels and of spikes before t only, which were all from F. So a loop
//! that nothing starts is silent. F grows one source at a time and each synapse is looked at once; a larger F only raises H
//! and lowers L, so nothing needs to be taken back.

use crate::base::fixed::{DECAY_ONE, Decay, Q_BITS, THRESHOLD_SHIFT, UV_BITS};
use crate::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId};
use crate::desc::network::{Semantics, ThresholdTest};
use crate::ir::quantised::{Neuron, Quantised, Units};

/// The least and the greatest that can arrive in one step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Arrivals {
    /// The sum of all negative scaled weights.
    pub low: i64,
    /// The sum of all positive ones.
    pub high: i64,
}

impl Arrivals {
    /// With one more synapse.
    fn add(&mut self, added: i64) {
        *if added < 0 { &mut self.low } else { &mut self.high } += added;
    }
}

/// The least X >= 0 with `decay(X) + drive <= X`; `None` when there is none. `drive` has at most 32 bits.
///
/// For X >= 0 the condition is `drive <= ceil(X d / 4096)`, that is `X d > 4096 (drive - 1)`.
fn ceiling(drive: i64, decay: Decay) -> Option<i64> {
    match i64::from(decay.get()) {
        _ if drive <= 0 => Some(0),
        0 => None,
        d => Some((drive - 1) * DECAY_ONE / d + 1),
    }
}

/// Whether v, when it reaches at most this, may pass the threshold.
fn passes(v: i64, neuron: &Neuron, test: ThresholdTest) -> bool {
    let threshold = i64::from(neuron.vth.get()) << THRESHOLD_SHIFT;
    match test {
        ThresholdTest::Strict => v > threshold,
        ThresholdTest::Inclusive => v >= threshold,
    }
}

/// Whether a compartment may ever spike; false only with a proof.
#[must_use]
pub fn may_spike(neuron: &Neuron, semantics: Semantics, test: ThresholdTest, arrivals: Arrivals) -> bool {
    let greatest = match semantics {
        Semantics::Hardware => {
            let vmax = (1i64 << (9 + 2 * neuron.vmax.get())) - 1;
            let vmin = 1 - (1i64 << neuron.vmin.get());
            let bound = hardware(neuron, arrivals);
            Some(bound.map_or(vmax, |v| v.clamp(vmin, vmax)))
        }
        Semantics::Lava => lava(neuron, arrivals),
        Semantics::Slayer => slayer(neuron, arrivals),
    };
    greatest.is_none_or(|v| passes(v, neuron, test))
}

/// Bounds on u from below and above; `None` when there is none on a side, or arrivals leave 32 bits.
fn current(neuron: &Neuron, Arrivals { low, high }: Arrivals) -> Option<(i64, i64)> {
    let bits = 1i64 << 31;
    if low < -bits || high >= bits {
        return None;
    }
    Some((-ceiling(-low, neuron.du)?, ceiling(high, neuron.du)?))
}

/// A bound on v from what enters it in a step; `None` when there is none.
fn voltage(neuron: &Neuron, input: i64) -> Option<i64> {
    if input <= 0 { Some(input) } else { ceiling(input, neuron.dv) }
}

fn bias(neuron: &Neuron) -> i64 {
    i64::from(neuron.bias_mant.get()) << neuron.bias_exp.get()
}

/// A bound on v before it is clipped; `None` when only the clip bounds it.
fn hardware(neuron: &Neuron, arrivals: Arrivals) -> Option<i64> {
    let fits = |low: i64, high: i64, bits: u32| -(1i64 << bits) <= low && high < 1i64 << bits;
    if !fits(arrivals.low, arrivals.high, Q_BITS) {
        return None;
    }
    let (low, high) = current(neuron, arrivals).filter(|&(low, high)| fits(low, high, UV_BITS))?;
    let (low, high) = (low + bias(neuron), high + bias(neuron));
    if !fits(low, high, UV_BITS) {
        return None;
    }
    voltage(neuron, high)
}

fn lava(neuron: &Neuron, arrivals: Arrivals) -> Option<i64> {
    let most = (1i64 << UV_BITS) - 1;
    let (_, high) = current(neuron, arrivals).filter(|&(low, high)| -most <= low && high <= most)?;
    // |decay(v) + u + bias| < 2^25: the 32 bits that lava computes in are never left.
    Some(voltage(neuron, high + bias(neuron)).map_or(most, |v| v.clamp(-most, most)))
}

fn slayer(neuron: &Neuron, arrivals: Arrivals) -> Option<i64> {
    let exact = |low: i64, high: i64, d: Decay| {
        let magnitude = high.max(-low);
        magnitude < 1 << 31 && magnitude * (DECAY_ONE - i64::from(d.get())) < 1 << 32
    };
    let (low, high) = current(neuron, arrivals).filter(|&(low, high)| exact(low, high, neuron.du))?;
    let (lowest, highest) = (-ceiling(-low, neuron.dv)?, ceiling(high, neuron.dv)?);
    exact(lowest, highest, neuron.dv).then_some(highest)
}

/// Which compartments can fire, when these channels do not.
#[must_use]
pub fn may_fire(network: &Quantised, dead: &IdVec<ChannelId, bool>) -> IdVec<CompartmentId, bool> {
    let parts = network.parts();
    let count = network.compartments() as usize;
    let mut places: Vec<(PopulationId, u32)> = Vec::with_capacity(count);
    let mut neurons: Vec<Neuron> = Vec::with_capacity(count);
    for (id, population) in network.populations().enumerate() {
        let Units::Loihi { neurons: of_population, .. } = &population.units else { continue };
        for index in 0..population.shape.len() {
            places.push((id, index));
            neurons.push(of_population.get(index));
        }
    }
    let mut arrivals = vec![Arrivals::default(); count];
    let mut fires: IdVec<CompartmentId, bool> = vec![false; count].into();
    // What a new source reaches, so that the caller may look at it again.
    let connect = |population: PopulationId, index: u32, arrivals: &mut [Arrivals], reached: &mut Vec<usize>| {
        let factor = i64::from(parts.populations[population].spike_factor());
        for &id in network.outgoing(population) {
            let projection = &parts.projections[id];
            let Some(first) = parts.populations[projection.target].first_compartment() else { continue };
            projection.connectivity.for_each_from(index, |target, weight| {
                let added = i64::from(projection.format.scaled(weight)) * factor;
                if added != 0 {
                    arrivals[first.index() + target as usize].add(added);
                    reached.push(first.index() + target as usize);
                }
            });
        }
    };
    let mut reached = Vec::new();
    for (id, population) in network.inputs() {
        let Some(first) = population.first_channel() else { continue };
        for index in (0..population.shape.len()).filter(|index| !dead[ChannelId(first.0 + index)]) {
            connect(id, index, &mut arrivals, &mut reached);
            reached.clear();
        }
    }
    let mut new: Vec<usize> = Vec::new();
    let mut look = |at: usize, arrivals: &[Arrivals], new: &mut Vec<usize>| {
        let fires = &mut fires[CompartmentId::new(at)];
        if !*fires && may_spike(&neurons[at], parts.semantics, parts.threshold, arrivals[at]) {
            *fires = true;
            new.push(at);
        }
    };
    (0..count).for_each(|at| look(at, &arrivals, &mut new));
    while let Some(at) = new.pop() {
        let (population, index) = places[at];
        connect(population, index, &mut arrivals, &mut reached);
        for at in reached.drain(..) {
            look(at, &arrivals, &mut new);
        }
    }
    fires
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fixed::decay;

    #[test]
    fn a_ceiling_is_where_the_iteration_ends() {
        // The bound is not only safe but the least: iterating from 0 reaches it.
        for d in [1, 2, 3, 100, 128, 1024, 4095, 4096] {
            let d = Decay::new(d).unwrap();
            for drive in [-5, 0, 1, 2, 63, 64, 100, 4096, 12_345] {
                let mut x = 0;
                while decay(x, d) + drive > x {
                    x = decay(x, d) + drive;
                }
                assert_eq!(ceiling(drive, d), Some(x), "{drive} {d}");
            }
        }
        assert_eq!(ceiling(0, Decay::MIN), Some(0));
        assert_eq!(ceiling(1, Decay::MIN), None);
    }
}
