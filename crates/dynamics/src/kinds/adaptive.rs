//! Leaky integrate-and-fire neurons with adaptive thresholds: each spike raises the threshold and a
//! refractory state, and both decay.
//!
//! Equation (32) of `docs/loihi2.md`. Source: lava-nc b6822fb, `proc/atrlif/models.py`;
//! lava-dl d825ac5, `slayer/neuron/dynamics/adaptive_threshold.py`.

use nsim_ir::base::fixed::WEIGHT_SHIFT;
use nsim_ir::neurons::ParameterRow;

use super::lif::{bias, current, voltage};
use super::neuron::{Arrived, Emission, Neuron, OverflowFlags, columns, decay, mask};

/// A leaky integrate-and-fire neuron. With `LAVA` it has lava's integers (current and voltage of 24
/// bits), else lava-dl's (words of 32 bits).
#[derive(Debug)]
pub(super) struct AdaptiveLif<const LAVA: bool>;

columns!(
    /// Current, voltage, threshold and refractory state.
    State { u = 0, v = 1, theta = 2, r = 3 }
);
columns!(
    /// Parameters in the units of the state; `keep_*` are kept fractions in 4096ths.
    Parameters { keep_u = 0, keep_v = 1, keep_theta = 2, keep_r = 3, threshold = 4, step = 5, bias = 6 }
);

/// Parameters of an adaptive threshold.
#[derive(Debug, Clone, Copy)]
pub(super) struct Adaptation {
    /// Fraction of the threshold above its rest kept by one step, in 4096ths.
    pub keep_theta: i32,
    /// Fraction of the refractory state kept by one step, in 4096ths.
    pub keep_r: i32,
    /// The resting threshold.
    pub threshold: i32,
    /// Increment of the threshold by a spike.
    pub step: i32,
}

impl Adaptation {
    /// Returns the next threshold and refractory state, and whether the neuron spikes: `allowed`
    /// holds and `tested` reaches the sum of both after decay.
    #[inline(always)]
    pub fn adapt(
        &self,
        [theta, r]: [i32; 2],
        tested: i32,
        allowed: bool,
        overflows: &mut OverflowFlags,
    ) -> ([i32; 2], bool) {
        let above = overflows.subtract(theta, self.threshold);
        let theta = overflows.word(decay(above, self.keep_theta) + i64::from(self.threshold));
        let r = decay(r, self.keep_r) as i32;
        let spikes = allowed & (i64::from(tested) - i64::from(r) >= i64::from(theta));
        let raised = theta & mask(spikes);
        let raised = overflows.add(raised, raised);
        ([overflows.add(theta, self.step & mask(spikes)), overflows.add(r, raised)], spikes)
    }
}

impl<const LAVA: bool> Neuron for AdaptiveLif<LAVA> {
    type State = State;
    type Parameters = Parameters;
    const VALUES: bool = false;

    fn prepare(&ParameterRow([du, dv, dtheta, dr, threshold, step, mantissa, exponent]): &ParameterRow) -> Parameters {
        let [keep_u, keep_v, keep_theta, keep_r] = [du, dv, dtheta, dr].map(|decay| 4096 - decay);
        Parameters { keep_u, keep_v, keep_theta, keep_r, threshold, step, bias: bias(mantissa, exponent) }
    }

    #[inline(always)]
    fn first(p: &Parameters) -> State {
        State { theta: p.threshold, ..State::default() }
    }

    #[inline(always)]
    fn update(p: &Parameters, s: &mut State, [arrived, _]: Arrived, overflows: &mut OverflowFlags) -> Emission {
        let &Parameters { keep_u, keep_v, keep_theta, keep_r, threshold, step, bias } = p;
        let (u, v) = if LAVA {
            let u = current(s.u, keep_u, arrived, overflows);
            (u, voltage(s.v, keep_v, u, bias, overflows))
        } else {
            let u = overflows.word(decay(s.u, keep_u) + (i64::from(arrived) << WEIGHT_SHIFT));
            (u, overflows.word(decay(s.v, keep_v) + i64::from(u)))
        };
        let adaptation = Adaptation { keep_theta, keep_r, threshold, step };
        let ([theta, r], spikes) = adaptation.adapt([s.theta, s.r], v, true, overflows);
        *s = State { u, v, theta, r };
        Emission::spike(spikes)
    }
}
