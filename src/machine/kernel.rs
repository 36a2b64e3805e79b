//! Sixteen compartments at a time, in the chip's semantics: the vector form of `neuron::update`.
//!
//! Comes in: registers and sums of a block whose compartments share their fields, padded to whole chunks of sixteen.
//! Goes out: the new registers, who spiked, who was not at rest, and which lanes left their field. Written as plain loops
//! over arrays of sixteen that the compiler turns into vector instructions; `pulp` picks the widest set that the processor
//! has, and all of them compute the same integers. A test holds every result against `neuron::update`.
//!
//! All arithmetic fits 32 bits: |u|, |v| <= 2^23 and q is below 2^21, so sums stay below 2^25. The 36-bit product of a
//! decay is split at bit 12: with x = 4096 h + l, (x k) >> 12 = h k + ((l k) >> 12) exactly.

use crate::machine::neuron::Fields;

/// Compartments of a chunk.
pub const LANES: usize = 16;

/// Fields that a whole block shares.
#[derive(Debug, Clone, Copy)]
pub struct Shared {
    keep_u: u32,
    keep_v: u32,
    bias: i32,
    fires_from: i32,
    vmin: i32,
    vmax: i32,
    refractory: i32,
}

impl From<&Fields> for Shared {
    fn from(f: &Fields) -> Self {
        Shared {
            keep_u: 4096 - u32::from(f.neuron.du.get()),
            keep_v: 4096 - u32::from(f.neuron.dv.get()),
            bias: f.bias,
            fires_from: f.fires_from,
            vmin: f.vmin,
            vmax: f.vmax,
            refractory: i32::from(f.refractory),
        }
    }
}

/// What a block's update did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effects {
    /// A bit for each lane that spiked.
    pub spiked: u64,
    /// Lanes that were not at rest.
    pub active: u32,
    /// Whether any lane is not at rest afterwards.
    pub busy: bool,
    /// Whether any lane left a field; `flags` says which.
    pub overflowed: bool,
}

/// Flag of a lane whose accumulator wrapped.
pub const Q_WRAPPED: i32 = 1;
/// Flag of a lane whose current, or current and bias, wrapped.
pub const U_WRAPPED: i32 = 2;
/// Flag of a lane whose voltage was clipped.
pub const V_CLIPPED: i32 = 4;

/// Registers of a block.
#[derive(Debug)]
pub struct Block<'a> {
    /// Currents.
    pub u: &'a mut [i32],
    /// Voltages.
    pub v: &'a mut [i32],
    /// Steps until v is free again.
    pub hold: &'a mut [i32],
    /// Sums of arrivals in units of 64; taken, and left at 0.
    pub sums: &'a mut [i32],
}

/// Equation (3) in 32 bits.
#[inline(always)]
fn kept(x: i32, keep: u32) -> i32 {
    let magnitude = x.unsigned_abs();
    let kept = ((magnitude >> 12) * keep + (((magnitude & 4095) * keep) >> 12)) as i32;
    if x < 0 { -kept } else { kept }
}

/// Two's complement of 23 bits and a sign.
#[inline(always)]
fn wrap24(x: i32) -> i32 {
    (x << 8) >> 8
}

/// Equations (2) to (7) for a block of at most 64 lanes, a multiple of sixteen.
#[inline(always)]
pub fn hardware(block: &mut Block<'_>, shared: &Shared, flags: &mut [i32; 64]) -> Effects {
    let Shared { keep_u, keep_v, bias, fires_from, vmin, vmax, refractory } = *shared;
    let mut effects = Effects::default();
    let (mut busy, mut overflowed) = (0i32, 0i32);
    let (u, _) = block.u.as_chunks_mut::<LANES>();
    let (v, _) = block.v.as_chunks_mut::<LANES>();
    let (hold, _) = block.hold.as_chunks_mut::<LANES>();
    let (sums, _) = block.sums.as_chunks_mut::<LANES>();
    let (flags, _) = flags.as_chunks_mut::<LANES>();
    let chunks = u.iter_mut().zip(v).zip(hold).zip(sums).zip(flags).enumerate();
    for (chunk, ((((u, v), hold), sums), flags)) in chunks {
        let (mut spiked, mut active) = (0i32, 0i32);
        for lane in 0..LANES {
            let (sum, old_u, old_v) = (sums[lane], u[lane], v[lane]);
            sums[lane] = 0;
            // The truncation to 16 bits of a sum in units of 64 is the wrap to 22.
            let q = (sum << 16) >> 10;
            let current = kept(old_u, keep_u) + q;
            let new_u = wrap24(current);
            let with_bias = new_u + bias;
            let input = wrap24(with_bias);
            let free = kept(old_v, keep_v) + input;
            let clipped = free.max(vmin).min(vmax);
            let held = (hold[lane] - 1).max(0);
            let is_free = held == 0;
            let fires = is_free & (clipped >= fires_from);
            let new_v = if is_free & !fires { clipped } else { 0 };
            let new_hold = if fires { refractory } else { held };
            let flag = if (q >> 6) == sum { 0 } else { Q_WRAPPED }
                | if (new_u == current) & (input == with_bias) { 0 } else { U_WRAPPED }
                | if !is_free | (clipped == free) { 0 } else { V_CLIPPED };
            (u[lane], v[lane], hold[lane], flags[lane]) = (new_u, new_v, new_hold, flag);
            spiked |= if fires { 1 << lane } else { 0 };
            active += if (old_u | old_v | sum | bias | held) == 0 { 0 } else { 1 };
            busy |= new_u | new_v | new_hold;
            overflowed |= flag;
        }
        effects.spiked |= (spiked as u64) << (chunk * LANES);
        effects.active += active as u32;
    }
    effects.busy = busy != 0;
    effects.overflowed = overflowed != 0;
    effects
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fixed::{
        BiasExponent, BiasMantissa, Decay, Refractory, ThresholdMantissa, VmaxExponent, VminExponent,
    };
    use crate::base::rng;
    use crate::desc::network::{Semantics, ThresholdTest};
    use crate::ir::quantised::Neuron;
    use crate::machine::neuron::{Registers, update};

    /// A number whose magnitude has a random number of bits, so that edges come up as often as middles.
    fn draw(seed: u64, index: u64, bits: u64) -> i64 {
        let width = rng::below(bits + 1, seed, index, 0);
        let magnitude = (rng::bits(seed, index, 1) & ((1 << width) - 1)) as i64;
        let edge = [magnitude, 1 << width, (1 << width) - 1][rng::below(3, seed, index, 2) as usize];
        if rng::bits(seed, index, 3) & 1 == 0 { edge } else { -edge }
    }

    fn fields(seed: u64) -> Fields {
        let of = |index, low: i64, high: i64| low + rng::below((high - low + 1) as u64, seed, index, 9) as i64;
        let decay = |index| [of(index, 0, 4096), 0, 1, 4095, 4096][of(index + 1, 0, 4) as usize];
        let neuron = Neuron {
            du: Decay::new(decay(0)).unwrap(),
            dv: Decay::new(decay(2)).unwrap(),
            vth: ThresholdMantissa::new([of(4, 0, 131_071), of(5, 0, 300)][of(6, 0, 1) as usize]).unwrap(),
            bias_mant: BiasMantissa::new([0, of(7, -4096, 4095)][of(8, 0, 1) as usize]).unwrap(),
            bias_exp: BiasExponent::new(of(9, 0, 7)).unwrap(),
            refractory: Refractory::new([1, of(10, 0, 63)][of(11, 0, 1) as usize]).unwrap(),
            vmin: VminExponent::new([23, of(12, 0, 23)][of(13, 0, 1) as usize]).unwrap(),
            vmax: VmaxExponent::new([7, of(14, 0, 7)][of(15, 0, 1) as usize]).unwrap(),
        };
        let test = [ThresholdTest::Strict, ThresholdTest::Inclusive][of(16, 0, 1) as usize];
        Fields::new(neuron, 0, Semantics::Hardware, test)
    }

    /// The kernel as the machine runs it, with the processor's widest vectors.
    struct Run<'a>(Block<'a>, &'a Shared, &'a mut [i32; 64]);

    impl pulp::NullaryFnOnce for Run<'_> {
        type Output = Effects;
        #[inline(always)]
        fn call(self) -> Effects {
            let mut block = self.0;
            hardware(&mut block, self.1, self.2)
        }
    }

    /// A million lane-updates over random fields and registers, edges included.
    #[test]
    fn sixteen_lanes_are_sixteen_compartments() {
        let arch = pulp::Arch::new();
        let (mut spikes, mut overflows) = (0u32, 0u32);
        for seed in 0..20_000u64 {
            let f = fields(seed);
            let at = |lane: usize, what: u64, bits| draw(seed, 1000 + lane as u64 * 8 + what, bits);
            let registers: [Registers; 48] = std::array::from_fn(|lane| Registers {
                u: at(lane, 0, 23).clamp(-(1 << 23), (1 << 23) - 1) as i32,
                v: at(lane, 1, 23).clamp(f.vmin.into(), f.vmax.into()) as i32,
                hold: (at(lane, 2, 7).unsigned_abs() as u8).min(f.refractory),
            });
            let arrived: [i32; 48] = std::array::from_fn(|lane| at(lane, 3, 30) as i32);
            let mut u = registers.map(|r| r.u);
            let mut v = registers.map(|r| r.v);
            let mut hold = registers.map(|r| i32::from(r.hold));
            let (mut sums, mut flags, shared) = (arrived, [0; 64], Shared::from(&f));
            let block = Block { u: &mut u, v: &mut v, hold: &mut hold, sums: &mut sums };
            let effects = arch.dispatch(Run(block, &shared, &mut flags));
            let mut expected = Effects::default();
            for lane in 0..48 {
                let (new, effect) = update(registers[lane], arrived[lane], &f, Semantics::Hardware);
                assert_eq!((u[lane], v[lane], hold[lane]), (new.u, new.v, new.hold.into()), "seed {seed} lane {lane}");
                let flag = i32::from(effect.q_wrapped) * Q_WRAPPED
                    + i32::from(effect.u_wrapped) * U_WRAPPED
                    + i32::from(effect.v_clipped) * V_CLIPPED;
                assert_eq!(flags[lane], flag, "seed {seed} lane {lane}");
                let r = registers[lane];
                let rest = r.u == 0 && r.v == 0 && !f.holds(&r) && arrived[lane] == 0 && f.bias == 0;
                expected.spiked |= u64::from(effect.spiked) << lane;
                expected.active += u32::from(!rest);
                expected.busy |= new != Registers::default();
                expected.overflowed |= flag != 0;
            }
            assert_eq!((effects, sums), (expected, [0; 48]), "seed {seed}");
            spikes += effects.spiked.count_ones();
            overflows += u32::from(effects.overflowed);
        }
        assert!(spikes > 100_000 && overflows > 1_000, "{spikes} spikes, {overflows} blocks with overflow: too tame");
    }
}
