//! The update of sixteen compartments in parallel, in the chip's semantics: the vector form of
//! [`nsim_dynamics::update`].
//!
//! Input: registers, sums and biases of a block whose compartments share their other fields, padded
//! to whole chunks of sixteen. Output: the new registers, the lanes that spiked, the lanes that
//! were not idle, and the chunks with overflow. The compiler turns plain loops over arrays of
//! sixteen into vector instructions. `pulp` picks the widest set of the processor, and all sets
//! compute equal integers. For AVX-512 the instructions are explicit (`vectors`). A test compares
//! both with the scalar update.
//!
//! A voltage and its refractory counter share a register, so that a step streams through less
//! memory.
//!
//! All arithmetic fits 32 bits: |u|, |v| <= 2^23 and q is below 2^21, so sums stay below 2^25. The
//! 36-bit product of a decay is split at bit 12: with x = 4096 h + l,
//! `(x k) >> 12 = h k + ((l k) >> 12)` exactly.

use std::array::{from_mut, from_ref};

use nsim_dynamics::Fields;
use nsim_ir::base::fixed::{DECAY_ONE, UV_BITS, WEIGHT_SHIFT};

/// Number of compartments of a chunk.
pub const LANES: usize = 16;

/// Fields that a whole block shares: all but the bias.
#[derive(Debug, Clone, Copy)]
pub struct BlockParameters {
    pub(crate) keep_u: i32,
    pub(crate) keep_v: i32,
    pub(crate) fires_from: i32,
    pub(crate) vmin: i32,
    pub(crate) vmax: i32,
    pub(crate) refractory: i32,
    /// Fractions of u and v kept by one step: 4096ths, which a float represents exactly.
    pub(crate) fraction_u: f32,
    pub(crate) fraction_v: f32,
    /// `vmax - vmin`.
    pub(crate) span: i32,
}

impl From<&Fields> for BlockParameters {
    fn from(f: &Fields) -> Self {
        const ONE: i32 = DECAY_ONE as i32;
        let (keep_u, keep_v) = (ONE - i32::from(f.neuron.du.get()), ONE - i32::from(f.neuron.dv.get()));
        BlockParameters {
            keep_u,
            keep_v,
            fires_from: f.fires_from,
            vmin: f.vmin,
            vmax: f.vmax,
            refractory: i32::from(f.refractory),
            fraction_u: keep_u as f32 / ONE as f32,
            fraction_v: keep_v as f32 / ONE as f32,
            span: f.vmax - f.vmin,
        }
    }
}

/// Registers of a block.
#[derive(Debug)]
pub struct Block<'a, S> {
    /// Currents.
    pub u: &'a mut [i32],
    /// Voltages, as [`store`] writes them.
    pub v: &'a mut [i32],
    /// Sums of arrivals in units of 64; set to 0.
    pub sums: &'a mut [S],
    /// Biases; empty if all are 0 and v is not bounded from below, so that it is rarely clipped.
    pub biases: &'a [i32],
}

/// The voltage register while v is held is this plus the steps until v is free again. It is above
/// every voltage, |v| < 2^23.
pub(crate) const HOLD_BASE: i32 = 1 << 30;

/// A voltage and the steps until it is free again, in one register. As on the chip, the register
/// counts while v is held, since v is 0 then.
#[inline(always)]
pub fn store(v: i32, hold: u8) -> i32 {
    if hold == 0 { v } else { HOLD_BASE + i32::from(hold) }
}

/// The inverse of [`store`].
#[inline(always)]
pub fn load(stored: i32) -> (i32, u8) {
    if stored < HOLD_BASE { (stored, 0) } else { (0, (stored - HOLD_BASE) as u8) }
}

/// A sum of arrivals in units of 64.
pub trait Sum: Copy + Default + PartialEq + std::fmt::Debug + Send + Sync + 'static {
    /// Whether its values can exceed the 16 bits of the accumulator.
    const WIDE: bool;
    /// Adds a weight.
    fn plus(self, weight: i16) -> Self;
    /// The sum for the update of registers.
    fn value(self) -> i32;
    /// The sum for the update of words, shifted to the right by at most 31 bits, and whether it
    /// exceeds 32 bits.
    #[inline(always)]
    fn shifted(self, bits: u8) -> (i32, bool) {
        (self.value() >> bits, false)
    }
    /// The exact sum.
    #[inline(always)]
    fn whole(self) -> i64 {
        self.value().into()
    }
}

impl Sum for i32 {
    const WIDE: bool = true;
    #[inline(always)]
    fn plus(self, weight: i16) -> Self {
        self + i32::from(weight)
    }
    #[inline(always)]
    fn value(self) -> i32 {
        self
    }
}

/// For compartments whose synapses together fit 16 bits, so that it never wraps.
impl Sum for i16 {
    const WIDE: bool = false;
    #[inline(always)]
    fn plus(self, weight: i16) -> Self {
        self.wrapping_add(weight)
    }
    #[inline(always)]
    fn value(self) -> i32 {
        i32::from(self)
    }
}

/// Equation (3) in 32 bits. The masks change nothing, as |x| <= 2^23 and keep <= 4096. They show
/// the compiler that both factors fit 16 bits; this multiplication costs half.
#[inline(always)]
fn decayed(x: i32, keep: i32) -> i32 {
    let sign = x >> 31;
    let magnitude = (x ^ sign) - sign;
    let (high, low, keep) = ((magnitude >> 12) & 0xfff, magnitude & 0xfff, keep & 0x1fff);
    let magnitude = high * keep + ((low * keep) >> 12);
    (magnitude ^ sign) - sign
}

/// Returns non-zero where a value does not fit 23 bits and a sign.
#[inline(always)]
fn outside(x: i32) -> i32 {
    ((x + (1 << UV_BITS)) as u32 >> (UV_BITS + 1)) as i32
}

/// Some chunks of sixteen compartments, at most four.
#[derive(Debug)]
pub struct Chunks<'a, S, const N: usize> {
    /// Currents.
    pub u: &'a mut [[i32; LANES]; N],
    /// Voltages, as [`store`] writes them.
    pub v: &'a mut [[i32; LANES]; N],
    /// Sums of arrivals; set to 0.
    pub sums: &'a mut [[S; LANES]; N],
    /// Biases.
    pub biases: &'a [[i32; LANES]; N],
}

/// Effect of an update of some lanes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effect {
    /// A bit for each lane that spiked.
    pub spiked: u64,
    /// A bit for each lane that was not idle.
    pub moved: u64,
    /// A bit for each lane whose voltage was clipped from below, where this is not an overflow.
    pub clipped: u64,
    /// Whether any lane is not idle afterwards.
    pub busy: bool,
}

impl Effect {
    /// Adds the effect of the update of other lanes.
    #[inline(always)]
    pub(crate) fn merge(&mut self, other: Effect) {
        self.spiked |= other.spiked;
        self.moved |= other.moved;
        self.clipped |= other.clipped;
        self.busy |= other.busy;
    }

    /// This effect, `lanes` lanes later.
    #[inline(always)]
    pub(crate) fn after(self, lanes: usize) -> Effect {
        let Effect { spiked, moved, clipped, busy } = self;
        Effect { spiked: spiked << lanes, moved: moved << lanes, clipped: clipped << lanes, busy }
    }
}

/// Vector instructions for chunks.
pub trait Vectors: Copy {
    /// Equations (2) to (7). `None` if a value of any lane would leave its field; then nothing
    /// changes. `PLAIN` only where all biases are 0; then a voltage that is clipped leaves its
    /// field, otherwise only one that is clipped from above.
    fn update<S: Sum, const PLAIN: bool>(self, chunk: Chunks<'_, S, 1>, shared: &BlockParameters) -> Option<Effect>;

    /// Updates some chunks in one call; `None` also on processors with too few registers.
    #[inline(always)]
    fn update_n<S: Sum, const PLAIN: bool, const N: usize>(
        self,
        chunks: Chunks<'_, S, N>,
        shared: &BlockParameters,
    ) -> Option<Effect> {
        let _ = (chunks, shared);
        None
    }
}

/// The vectors that the compiler makes of loops.
#[derive(Debug, Clone, Copy)]
pub struct Portable;

impl Vectors for Portable {
    #[inline(always)]
    fn update<S: Sum, const PLAIN: bool>(self, chunk: Chunks<'_, S, 1>, shared: &BlockParameters) -> Option<Effect> {
        let BlockParameters { keep_u, keep_v, fires_from, vmin, vmax, refractory, .. } = *shared;
        let Chunks { u: [u], v: [v], sums: [sums], biases: [biases] } = chunk;
        let (mut new_u, mut new_v) = ([0; LANES], [0; LANES]);
        let [mut fired, mut moved, mut low] = [[false; LANES]; 3];
        let (mut busy, mut overflowed) = (0, 0);
        for lane in 0..LANES {
            let (sum, old_u, stored) = (sums[lane].value(), u[lane], v[lane]);
            let bias = if PLAIN { 0 } else { biases[lane] };
            let old_v = if stored < HOLD_BASE { stored } else { 0 };
            let is_free = stored < HOLD_BASE + 2;
            // The truncation to 16 bits of a sum in units of 64 is the wrap to 22.
            let q = if S::WIDE { (sum << 16) >> 10 } else { sum << WEIGHT_SHIFT };
            let next_u = decayed(old_u, keep_u) + q;
            let input = next_u + bias;
            let free = decayed(old_v, keep_v) + input;
            let clipped = free.max(vmin).min(vmax);
            let fires = is_free & (clipped >= fires_from);
            let unheld = if fires { HOLD_BASE + refractory } else { clipped };
            new_v[lane] = if is_free { unheld } else { stored - 1 };
            new_u[lane] = next_u;
            busy |= next_u | new_v[lane];
            fired[lane] = fires;
            moved[lane] = ((old_u | old_v | sum | bias) != 0) | !is_free;
            low[lane] = !PLAIN & is_free & (free < vmin);
            let wrapped = outside(next_u) | outside(input) | if S::WIDE { (q >> WEIGHT_SHIFT) ^ sum } else { 0 };
            let bound = if PLAIN { clipped } else { free.min(vmax) };
            overflowed |= wrapped | if is_free { bound ^ free } else { 0 };
        }
        if overflowed != 0 {
            return None;
        }
        (*u, *v, *sums) = (new_u, new_v, [S::default(); LANES]);
        let clipped = if PLAIN { 0 } else { bits(low).into() };
        Some(Effect { spiked: bits(fired).into(), moved: bits(moved).into(), clipped, busy: busy != 0 })
    }
}

/// Updates a block of at most 64 lanes, a multiple of sixteen.
///
/// Chunks in which a value leaves its field are not updated, but have a bit in the second result.
/// They are rare, and are updated lane by lane.
#[inline(always)]
pub fn hardware<S: Sum>(block: &mut Block<'_, S>, shared: &BlockParameters, vectors: impl Vectors) -> (Effect, u32) {
    match block.biases.is_empty() {
        true => chunks::<S, true>(block, shared, vectors),
        false => chunks::<S, false>(block, shared, vectors),
    }
}

#[inline(always)]
fn chunks<S: Sum, const PLAIN: bool>(
    block: &mut Block<'_, S>,
    shared: &BlockParameters,
    vectors: impl Vectors,
) -> (Effect, u32) {
    let (mut effects, mut overflowed) = (Effect::default(), 0);
    let (u, _) = block.u.as_chunks_mut::<LANES>();
    let (v, _) = block.v.as_chunks_mut::<LANES>();
    let (sums, _) = block.sums.as_chunks_mut::<LANES>();
    let biases = if PLAIN { [[0; LANES]; 4].as_slice() } else { block.biases.as_chunks::<LANES>().0 };
    let unrolled = match u.len() {
        4 => update_n::<S, PLAIN, 4>((u, v, sums, biases), shared, vectors),
        3 => update_n::<S, PLAIN, 3>((u, v, sums, biases), shared, vectors),
        2 => update_n::<S, PLAIN, 2>((u, v, sums, biases), shared, vectors),
        _ => None,
    };
    if let Some(effect) = unrolled {
        return (effect, 0);
    }
    for (index, (((u, v), sums), biases)) in u.iter_mut().zip(v).zip(sums).zip(biases).enumerate().take(4) {
        let one = Chunks { u: from_mut(u), v: from_mut(v), sums: from_mut(sums), biases: from_ref(biases) };
        match vectors.update::<S, PLAIN>(one, shared) {
            Some(effect) => effects.merge(effect.after(index * LANES)),
            None => overflowed |= 1 << index,
        }
    }
    (effects, overflowed)
}

/// Chunks of u, v, sums and biases.
type Columns<'a, S> = (&'a mut [[i32; LANES]], &'a mut [[i32; LANES]], &'a mut [[S; LANES]], &'a [[i32; LANES]]);

/// Updates N chunks in one call.
#[inline(always)]
fn update_n<S: Sum, const PLAIN: bool, const N: usize>(
    (u, v, sums, biases): Columns<'_, S>,
    shared: &BlockParameters,
    vectors: impl Vectors,
) -> Option<Effect> {
    let (u, v, sums) = (u.first_chunk_mut::<N>()?, v.first_chunk_mut::<N>()?, sums.first_chunk_mut::<N>()?);
    vectors.update_n::<S, PLAIN, N>(Chunks { u, v, sums, biases: biases.first_chunk::<N>()? }, shared)
}

/// Returns one bit a lane. The product collects the lowest bits of eight bytes in its highest byte,
/// as no two of its terms overlap.
#[inline(always)]
fn bits(lanes: [bool; LANES]) -> u16 {
    let bytes = bytes(lanes);
    let gather = |bytes: u64| bytes.wrapping_mul(0x0102_0408_1020_4080) >> 56;
    (gather(bytes as u64) | (gather((bytes >> 64) as u64) << 8)) as u16
}

/// Returns one byte a lane, 1 or 0.
#[inline(always)]
fn bytes(lanes: [bool; LANES]) -> u128 {
    // Not `lanes.map`, which the compiler does not always turn into one register.
    let mut bytes = [0; LANES];
    bytes.iter_mut().zip(lanes).for_each(|(byte, lane)| *byte = u8::from(lane));
    u128::from_le_bytes(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_dynamics as neuron;
    use nsim_dynamics::{Registers, update};
    use nsim_ir::arithmetic::{Semantics, ThresholdTest};
    use nsim_ir::base::fixed::{
        BiasExponent, BiasMantissa, Decay, Refractory, ThresholdMantissa, VmaxExponent, VminExponent,
    };
    use nsim_ir::base::rng;
    use nsim_ir::neurons::NeuronKind;
    use nsim_ir::quantised::Neuron;
    use std::io::Write;

    /// A number whose magnitude has a random number of bits, so that edges are as frequent as
    /// middles.
    fn draw(seed: u64, index: u64, bits: u64) -> i64 {
        let width = rng::below(bits + 1, seed, index, 0);
        let magnitude = (rng::bits(seed, index, 1) & ((1 << width) - 1)) as i64;
        let edge = [magnitude, 1 << width, (1 << width) - 1][rng::below(3, seed, index, 2) as usize];
        if rng::bits(seed, index, 3) & 1 == 0 { edge } else { -edge }
    }

    fn fields(seed: u64) -> Fields {
        let of = |index, low: i64, high: i64| low + rng::below((high - low + 1) as u64, seed, index, 9) as i64;
        let decay = |index| [of(index, 0, 4096), 0, 1, 4095, 4096][of(index + 1, 0, 4) as usize];
        let integrate_and_fire = of(17, 0, 3) == 0;
        let neuron = Neuron {
            kind: if integrate_and_fire { NeuronKind::If } else { NeuronKind::Loihi },
            du: if integrate_and_fire { Decay::MAX } else { Decay::new(decay(0)).unwrap() },
            dv: if integrate_and_fire { Decay::MIN } else { Decay::new(decay(2)).unwrap() },
            vth: ThresholdMantissa::new([of(4, 0, 131_071), of(5, 0, 300)][of(6, 0, 1) as usize]).unwrap(),
            bias_mant: BiasMantissa::new([0, of(7, -4096, 4095)][of(8, 0, 1) as usize]).unwrap(),
            bias_exp: BiasExponent::new(of(9, 0, 7)).unwrap(),
            refractory: Refractory::new([1, of(10, 0, 255)][of(11, 0, 1) as usize]).unwrap(),
            vmin: VminExponent::new([23, of(12, 0, 23)][of(13, 0, 1) as usize]).unwrap(),
            vmax: VmaxExponent::new([7, of(14, 0, 7)][of(15, 0, 1) as usize]).unwrap(),
            ..Neuron::PLAIN
        };
        let test = [ThresholdTest::Strict, ThresholdTest::Inclusive][of(16, 0, 1) as usize];
        neuron::fields(&neuron, 0, Semantics::Hardware, test)
    }

    /// The kernel as the machine runs it, with the processor's widest vectors.
    struct Run<'a, S, V>(Block<'a, S>, &'a BlockParameters, V);

    impl<S: Sum, V: Vectors> pulp::NullaryFnOnce for Run<'_, S, V> {
        type Output = (Effect, u32);
        #[inline(always)]
        fn call(self) -> (Effect, u32) {
            let mut block = self.0;
            hardware(&mut block, self.1, self.2)
        }
    }

    /// Runs the machine's vectors, and checks that the compiler's vectors give equal results.
    fn run<S: Sum>(arch: pulp::Arch, block: &mut Block<'_, S>, shared: &BlockParameters) -> (Effect, u32) {
        let (mut u, mut v, mut sums) = (block.u.to_vec(), block.v.to_vec(), block.sums.to_vec());
        let biases = block.biases;
        let plain = arch.dispatch(Run(Block { u: &mut u, v: &mut v, sums: &mut sums, biases }, shared, Portable));
        let same = Block { u: &mut *block.u, v: &mut *block.v, sums: &mut *block.sums, biases };
        let effects = match arch {
            #[cfg(target_arch = "x86_64")]
            pulp::Arch::V4(simd) => simd.vectorize(Run(same, shared, simd)),
            _ => arch.dispatch(Run(same, shared, Portable)),
        };
        assert_eq!(effects, plain);
        assert_eq!((&*block.u, &*block.v, &*block.sums), (&u[..], &v[..], &sums[..]));
        effects
    }

    /// Compares the scalar update of some compartments with the vectors; returns the numbers of
    /// spikes and of chunks with overflow.
    fn compare<S: Sum, const COUNT: usize>(
        arch: pulp::Arch,
        seed: u64,
        bits: u64,
        narrow: impl Fn(i64) -> S,
    ) -> (u32, u32) {
        let f = fields(seed);
        let at = |lane: usize, what: u64, bits| draw(seed, 1000 + lane as u64 * 8 + what, bits);
        let registers: [Registers; COUNT] = std::array::from_fn(|lane| {
            let hold = (at(lane, 2, 7).unsigned_abs().min(255) as u8).min(f.refractory);
            let v = at(lane, 1, [12, 18, 20, 23][seed as usize / 4 % 4]).clamp(f.vmin.into(), f.vmax.into()) as i32;
            // A held voltage is 0, so the counter can share its register.
            let v = if hold > 0 { 0 } else { v };
            Registers {
                u: at(lane, 0, [12, 18, 20, 23][seed as usize / 4 % 4]).clamp(-(1 << 23), (1 << 23) - 1) as i32,
                v,
                hold,
            }
        });
        let arrived: [S; COUNT] = std::array::from_fn(|lane| narrow(at(lane, 3, bits)));
        let mut u = registers.map(|r| r.u);
        let mut v = registers.map(|r| store(r.v, r.hold));
        let (before_u, before_v) = (u, v);
        let mut sums = arrived;
        // Each lane has a bias of its own, among them 0, or none has one. Biases allow clips.
        let biases: [i32; COUNT] = std::array::from_fn(|lane| [f.bias, 0, at(lane, 4, 19) as i32][lane % 3]);
        let of_lane = |lane: usize| Fields { bias: if f.bias == 0 { 0 } else { biases[lane] }, ..f };
        let block =
            &mut Block { u: &mut u, v: &mut v, sums: &mut sums, biases: if f.bias == 0 { &[] } else { &biases } };
        let effects = run(arch, block, &BlockParameters::from(&f));
        let (mut expected, mut overflowed) = (Effect::default(), 0u32);
        for chunk in 0..COUNT / LANES {
            let lanes = chunk * LANES..(chunk + 1) * LANES;
            let results: Vec<_> =
                lanes.clone().map(|lane| update(registers[lane], arrived[lane].value(), &of_lane(lane))).collect();
            // Without an upper bound only voltages below the lower one are clipped.
            let is_low = |lane: usize| {
                let unbounded = Fields { vmax: 1 << 28, ..of_lane(lane) };
                f.bias != 0 && update(registers[lane], arrived[lane].value(), &unbounded).1.v_clipped
            };
            let leaves = |(lane, (_, effect)): (usize, &(Registers, neuron::Effect))| {
                effect.q_wrapped | effect.u_wrapped | (effect.v_clipped && !is_low(lane))
            };
            if lanes.clone().zip(&results).any(leaves) {
                overflowed |= 1 << chunk;
                assert_eq!(
                    (&u[lanes.clone()], &v[lanes.clone()]),
                    (&before_u[lanes.clone()], &before_v[lanes.clone()])
                );
                assert_eq!(sums[lanes.clone()], arrived[lanes], "seed {seed} chunk {chunk}");
                continue;
            }
            for (lane, (new, effect)) in lanes.clone().zip(results) {
                assert_eq!((u[lane], load(v[lane])), (new.u, (new.v, new.hold)), "seed {seed} lane {lane}");
                let at_rest = of_lane(lane).at_rest(&registers[lane], arrived[lane].value() != 0);
                expected.spiked |= u64::from(effect.spiked) << lane;
                expected.moved |= u64::from(!at_rest) << lane;
                expected.clipped |= u64::from(effect.v_clipped) << lane;
                expected.busy |= new != Registers::default();
            }
            assert_eq!(sums[lanes], [S::default(); LANES], "seed {seed} chunk {chunk}");
        }
        assert_eq!(effects, (expected, overflowed), "seed {seed}");
        (expected.spiked.count_ones(), overflowed.count_ones())
    }

    /// Some 3.5 million lane updates over random fields and registers, edges included, with sums of
    /// both widths.
    #[test]
    fn sixteen_lanes_are_sixteen_compartments() {
        let (mut spikes, mut overflows) = (0, 0);
        let narrower = crate::lanes::width::halved();
        if !matches!(pulp::Arch::new(), pulp::Arch::V4(_)) {
            // The harness hides the output of `println!` of a test that passes.
            let mut seen = std::io::stderr();
            writeln!(seen, "skipped: no AVX-512 here: the kernel of the compiler's vectors is compared with itself")
                .unwrap();
        }
        for seed in 0..20_000u64 {
            let arch = if seed / 16 % 4 == 3 { narrower } else { pulp::Arch::new() };
            // Arrivals beyond 16 bits overflow in every chunk, so most seeds sample smaller ones.
            let wide = compare::<_, 48>(arch, seed, [6, 10, 14, 30][seed as usize % 4], |sum| sum as i32);
            let four = compare::<_, 64>(arch, seed, [6, 10, 14, 30][seed as usize % 4], |sum| sum as i32);
            let limit = i64::from(i16::MAX);
            let narrow =
                compare::<_, 64>(arch, seed, [6, 10, 14, 15][seed as usize % 4], |sum| sum.clamp(-limit, limit) as i16);
            spikes += wide.0 + four.0 + narrow.0;
            overflows += wide.1 + four.1 + narrow.1;
        }
        assert!(spikes > 60_000 && overflows > 10_000, "{spikes} spikes, {overflows} chunks with overflow: too tame");
    }
}
