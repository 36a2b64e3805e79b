//! The current-based leaky integrate-and-fire compartment of Loihi 1, in three arithmetics.
//!
//! State: current u and voltage v of 24 bits, and the refractory counter. Each step, with q the sum
//! of the arrivals: `u = decay(u, du) + q`, `v = decay(v, dv) + u + bias`. Above the threshold it
//! spikes, and v is held at 0 until the refractory period is over. A spike carries the payload of
//! its population, or nothing. `docs/semantics.md` numbers the equations. The arithmetics narrow
//! values differently:
//!
//! - *Hardware*: q wraps at 22 bits, u and u + bias at 24, v is clipped to vmin and vmax.
//! - *Lava*: lava's fixed-point LIF process. A negative exponent shifts the sum q, which never
//!   wraps; u wraps once into (-2^23, 2^23]; v is clipped to the whole field; no refractory period.
//! - *Slayer*: SLAYER's Loihi kernel. The magnitude of a product keeps its low 32 bits, and sums
//!   have 32 bits. There is no bias and no clip, and step 0 is skipped. A refractory period of 0
//!   silences the compartment after its first spike.
//!
//! *Arrivals* are summed in units of 64, since every scaled weight is a multiple of 64 (equation
//! 1). The sum of a step thus fits 32 bits for any fan-in of a core. The accumulator's wrap to 22
//! bits truncates this sum to 16.
//!
//! *Bounds.* Decay (3) is monotone and odd. Let u start from 0 (at the start, after a reset, while
//! held), with arrivals of at most H >= 0. Then u never exceeds any X >= 0 with
//! `decay(X) + H <= X`: if u <= X, the next u is at most decay(X) + H <= X. The least such X is
//! `ceiling`. The sum L of the negative weights bounds u from below likewise, and the input of v
//! then bounds v. v returns to 0 at resets, so a negative input bounds v by itself. Both sides need
//! a bound, because a value that leaves its field on one side may return on the other:
//!
//! - *Hardware*: v is clipped to vmin and vmax (6), which bounds it regardless of earlier wraps.
//!   There is no tighter bound when L or H leaves the 22 bits of the accumulator (2). Nor is
//!   there one when a bound on u leaves the 24 bits of (4), or with the bias the 24 bits of (5).
//! - *Lava*: v is clipped to the whole field. There is no bound when a bound on u reaches -2^23 or
//!   2^23, where u wraps.
//! - *Slayer*: the product loses bits when the magnitude of a bound times its decay factor reaches
//!   2^32. Then there is no bound, nor when a bound leaves 32 bits.

use std::num::NonZeroU32;

use super::kind::{Arrivals, Effect, Fields, Kind, RealForm, Registers};
use crate::arithmetic::clip;
use crate::arithmetic::decay;
use crate::arithmetic::wrap;
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::fixed::{
    BiasExponent, BiasMantissa, DECAY_ONE, Decay, OutOfRange, Q_BITS, Refractory, ThresholdMantissa, UV_BITS,
    VmaxExponent, VminExponent, WEIGHT_SHIFT,
};
use nsim_ir::graph::NeuronParameters;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::Neuron;

pub(super) const KIND: Kind = Kind {
    semantics: &[Semantics::Hardware, Semantics::Lava, Semantics::Slayer],
    neuron,
    fields,
    greatest_voltage,
    shortest_interval,
    voltage_register,
    model,
};

fn neuron(values: &[i64]) -> Result<Neuron, OutOfRange> {
    let &[du, dv, vth, bias_mant, bias_exp, refractory, vmin, vmax] = values else {
        unreachable!("one value for each parameter of the kind")
    };
    Ok(Neuron {
        kind: NeuronKind::Loihi,
        du: Decay::new(du)?,
        dv: Decay::new(dv)?,
        vth: ThresholdMantissa::new(vth)?,
        bias_mant: BiasMantissa::new(bias_mant)?,
        bias_exp: BiasExponent::new(bias_exp)?,
        refractory: Refractory::new(refractory)?,
        vmin: VminExponent::new(vmin)?,
        vmax: VmaxExponent::new(vmax)?,
        ..Neuron::PLAIN
    })
}

fn fields(neuron: &Neuron, start_step: u32, semantics: Semantics, test: ThresholdTest) -> Fields {
    let chip = Fields::from_registers(neuron, start_step, test);
    match semantics {
        Semantics::Hardware => chip,
        Semantics::Lava => Fields { semantics, vectors: false, ..chip },
        // SLAYER's loop starts at step 1; arrivals of step 0 are lost.
        Semantics::Slayer => Fields {
            semantics,
            vectors: false,
            bias: 0,
            refractory: neuron.refractory.get(),
            start_step: start_step.max(1),
            ..chip
        },
    }
}

/// Equations (2) to (7): one update with `arrived` units of 64.
#[inline]
pub(super) fn update(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    match f.semantics {
        Semantics::Hardware => {
            let (new, effect, _) = hardware(r, i64::from(arrived) << WEIGHT_SHIFT, f, 0);
            (new, effect)
        }
        Semantics::Lava => lava(r, arrived, f),
        Semantics::Slayer => slayer(r, arrived, f),
    }
}

/// The update of a compartment with arrivals of `whole`, in units of 1, that pops `popped`, in the
/// chip's arithmetic; and its own push.
#[inline]
pub(super) fn hardware(r: Registers, whole: i64, f: &Fields, popped: i32) -> (Registers, Effect, i32) {
    let q = wrap(whole, Q_BITS);
    let sum = decay(i64::from(r.u), f.neuron.du) + q;
    let u = wrap(sum, UV_BITS);
    let with_bias = u + i64::from(popped) + i64::from(f.bias);
    let input = wrap(with_bias, UV_BITS);
    let free = decay(i64::from(r.v), f.neuron.dv) + input;
    let v = clip(free, i64::from(f.vmin), i64::from(f.vmax));
    let hold = r.hold.saturating_sub(1);
    let spiked = hold == 0 && v >= i64::from(f.fires_from);
    let effect = Effect {
        spiked,
        q_wrapped: q != whole,
        u_wrapped: u != sum || input != with_bias,
        v_clipped: hold == 0 && v != free,
    };
    let (w, hold) = (v as i32, if spiked { f.refractory } else { hold });
    (Registers { u: u as i32, v: if hold > 0 { 0 } else { w }, hold }, effect, w)
}

/// Source: lava-nc b6822fb, `proc/lif/models.py`.
fn lava(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    let limit = 1i64 << UV_BITS;
    // Toward minus infinity, as NumPy shifts.
    let activation = (i64::from(arrived >> f.neuron.shift) << WEIGHT_SHIFT) as i32;
    let sum = (decay(i64::from(r.u), f.neuron.du) + i64::from(activation)) as i32;
    let mut u = i64::from(sum);
    if u > limit {
        u -= 2 * limit;
    }
    if u <= -limit {
        u = i64::from(sum) + 2 * limit;
    }
    let free = decay(i64::from(r.v), f.neuron.dv) + u + i64::from(f.bias); // below 2^25, far within lava's 32 bits
    let v = clip(free, 1 - limit, limit - 1);
    let spiked = v >= i64::from(f.fires_from);
    let effect = Effect { spiked, q_wrapped: false, u_wrapped: u != i64::from(sum), v_clipped: v != free };
    (Registers { u: u as i32, v: if spiked { 0 } else { v as i32 }, hold: 0 }, effect)
}

/// Source: slayerPytorch 01beeeb, `src/cuda/spikeLoihiKernels.h`.
fn slayer(r: Registers, arrived: i32, f: &Fields) -> (Registers, Effect) {
    fn product(x: i32, d: u16) -> i32 {
        let decayed = (x.unsigned_abs().wrapping_mul(4096 - u32::from(d)) >> 12) as i32;
        if x < 0 { -decayed } else { decayed }
    }
    let u = product(r.u, f.neuron.du.get()).wrapping_add(arrived << WEIGHT_SHIFT);
    let v = product(r.v, f.neuron.dv.get()).wrapping_add(u);
    let hold = f.remaining(r.hold);
    let spiked = hold == 0 && v >= f.fires_from;
    let v = if hold > 0 || spiked { 0 } else { v };
    // A period of 0 is never counted down: the compartment is silent after its first spike.
    let hold = if spiked { f.refractory.max(1) } else { hold };
    (Registers { u, v, hold }, Effect { spiked, ..Effect::default() })
}

fn voltage_register(neuron: &Neuron, semantics: Semantics, r: &Registers, spiked: bool) -> i32 {
    match semantics {
        // The register doubles as the counter of the refractory period.
        Semantics::Hardware if r.hold > 0 => {
            let period = neuron.refractory.get().max(1);
            (i32::from(period) << 7) + i32::from(period - r.hold)
        }
        Semantics::Slayer if spiked => i32::from(neuron.dv.get()),
        _ => r.v,
    }
}

fn shortest_interval(neuron: &Neuron, semantics: Semantics) -> Option<NonZeroU32> {
    let period = NonZeroU32::new(neuron.refractory.get().into());
    match semantics {
        Semantics::Hardware => Some(period.unwrap_or(NonZeroU32::MIN)),
        Semantics::Lava => Some(NonZeroU32::MIN),
        Semantics::Slayer => period,
    }
}

/// The least X >= 0 with `decay(X) + drive <= X`; `None` when there is none. `drive` has at most 32
/// bits.
///
/// For X >= 0 the condition is `drive <= ceil(X d / 4096)`, that is `X d > 4096 (drive - 1)`.
fn ceiling(drive: i64, decay: Decay) -> Option<i64> {
    match i64::from(decay.get()) {
        _ if drive <= 0 => Some(0),
        0 => None,
        d => Some((drive - 1) * DECAY_ONE / d + 1),
    }
}

/// Bounds on u; `None` when there is none on a side, or arrivals leave 32 bits.
fn current(neuron: &Neuron, arrivals: Arrivals) -> Option<Arrivals> {
    if !arrivals.fit(31) {
        return None;
    }
    Some(Arrivals { low: -ceiling(-arrivals.low, neuron.du)?, high: ceiling(arrivals.high, neuron.du)? })
}

/// An upper bound on v from its input in a step; `None` when there is none.
fn voltage(neuron: &Neuron, input: i64) -> Option<i64> {
    if input <= 0 { Some(input) } else { ceiling(input, neuron.dv) }
}

fn greatest_voltage(neuron: &Neuron, semantics: Semantics, arrivals: Arrivals) -> Option<i64> {
    let chip = Fields::from_registers(neuron, 0, ThresholdTest::Strict);
    let bias = i64::from(chip.bias);
    match semantics {
        Semantics::Hardware => {
            let (vmin, vmax) = (i64::from(chip.vmin), i64::from(chip.vmax));
            let bound = Some(arrivals).filter(|arrivals| arrivals.fit(Q_BITS));
            let bound = bound.and_then(|arrivals| current(neuron, arrivals)).filter(|u| u.fit(UV_BITS));
            let bound = bound.map(|u| Arrivals { low: u.low + bias, high: u.high + bias }).filter(|u| u.fit(UV_BITS));
            Some(bound.and_then(|input| voltage(neuron, input.high)).map_or(vmax, |v| v.clamp(vmin, vmax)))
        }
        Semantics::Lava => {
            let most = (1i64 << UV_BITS) - 1;
            // A shift toward minus infinity is monotone, so that it keeps bounds.
            let shifted = |sum: i64| (sum >> WEIGHT_SHIFT >> neuron.shift) << WEIGHT_SHIFT;
            let arrivals = Arrivals { low: shifted(arrivals.low), high: shifted(arrivals.high) };
            let u = current(neuron, arrivals).filter(|u| -most <= u.low && u.high <= most)?;
            // |decay(v) + u + bias| < 2^25 fits the 32 bits of lava's arithmetic.
            Some(voltage(neuron, u.high + bias).map_or(most, |v| v.clamp(-most, most)))
        }
        Semantics::Slayer => {
            fn exact(x: &Arrivals, d: Decay) -> bool {
                let magnitude = x.high.max(-x.low);
                magnitude < 1 << 31 && magnitude * (DECAY_ONE - i64::from(d.get())) < 1 << 32
            }
            let u = current(neuron, arrivals).filter(|u| exact(u, neuron.du))?;
            let v = Arrivals { low: -ceiling(-u.low, neuron.dv)?, high: ceiling(u.high, neuron.dv)? };
            exact(&v, neuron.dv).then_some(v.high)
        }
    }
}

/// The form has no rounding or wrapping. A real threshold has no limits either, since there are no
/// register units to clip in.
fn model(p: &NeuronParameters, index: u32, timestep_ms: f64) -> RealForm {
    let keep = |field: &str, time: &str| match p.get(time) {
        Some(tau) => libm::exp(-1.0 / (tau.each.get(index) / timestep_ms)),
        None => 1.0 - p.value(field, index) / DECAY_ONE as f64,
    };
    RealForm { keep_u: keep("du", "tau_u_ms"), keep_v: keep("dv", "tau_v_ms"), ..threshold_and_reset(p, index) }
}

/// The form shared by all kinds with the chip's threshold and reset; neither current nor voltage is
/// kept.
pub(super) fn threshold_and_reset(p: &NeuronParameters, index: u32) -> RealForm {
    let power = |name: &str, factor: f64, more: f64| libm::exp2(more + factor * p.value(name, index));
    let real = p.real("vth").map(|threshold| threshold.each.get(index));
    RealForm {
        keep_u: 0.0,
        keep_v: 0.0,
        threshold: real.unwrap_or_else(|| p.value("vth_mant", index) * 64.0),
        bias: match p.real("bias") {
            Some(bias) => bias.each.get(index),
            None => p.value("bias_mant", index) * power("bias_exp", 1.0, 0.0),
        },
        refractory: p.value("refractory", index).max(1.0) as u32,
        subtracts: false,
        clip: match real {
            None => (1.0 - power("vmin_exp", 1.0, 0.0), power("vmax_exp", 2.0, 9.0) - 1.0),
            Some(_) => (f64::MIN, f64::MAX),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
