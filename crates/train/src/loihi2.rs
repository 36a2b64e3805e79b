//! Neurons of Loihi 2 in training.
//!
//! Input: the arriving integers of each step. Output: messages, and the state for the surrogate.
//! The forward pass is the machine's own update. The backward pass follows lava-dl d825ac5: a
//! change passes errors on as if its threshold were 0 (`slayer/axon/delta.py`), and a spike of a
//! resonator has the surrogate of `slayer/spike/complex.py`.

use super::surrogate::Surrogate;
use super::trace::Trace;
use nsim_dynamics::kinds::{Block, CHUNK, MOST_LANES, updater};
use nsim_ir::neurons::{NeuronKind, ParameterRow};

/// Neurons of one kind: `Rf`, `SigmaDelta` with a rectification, or `Sigma`.
#[derive(Debug, Clone, PartialEq)]
pub struct Loihi2 {
    /// Their kind.
    pub kind: NeuronKind,
    /// Parameters of each neuron, in the order of the kind's table.
    pub rows: Vec<ParameterRow>,
    /// Cosine and sine of the rotation by a step, which also decays; by neuron, of `Rf` alone.
    pub turns: Vec<[f32; 2]>,
    /// Threshold in the units of the trained weights; infinite where the state is read out.
    pub theta: f32,
    /// Arriving integer of a trained weight of 1.
    pub weight_unit: f32,
    /// State at a potential of 1 in the units of the trained weights.
    pub unit: f32,
}

impl Loihi2 {
    pub(super) fn forward(&self, drive: &[f32], trace: &mut Trace) {
        let n = self.rows.len();
        let block = |rows: &[ParameterRow]| {
            let updater = updater(self.kind, rows)?;
            let mut columns = vec![[0; CHUNK]; rows.len().div_ceil(CHUNK) * updater.words()];
            updater.clear(&mut columns);
            Some((updater, columns))
        };
        let mut blocks: Vec<_> = self.rows.chunks(MOST_LANES).filter_map(block).collect();
        let vectors = pulp::Arch::new();
        let second = [[0; CHUNK]; MOST_LANES / CHUNK];
        trace.imaginary.resize(if self.turns.is_empty() { 0 } else { drive.len() }, 0.0);
        let read_out = if self.theta.is_infinite() { 1.0 } else { 1.0 / self.unit };
        for (t, z) in drive.chunks_exact(n).enumerate() {
            for (block, (updater, columns)) in blocks.iter_mut().enumerate() {
                let chunks = updater.lanes().div_ceil(CHUNK);
                let lanes = &z[block * MOST_LANES..][..updater.lanes()];
                let (mut first, mut sent) = (second, second);
                lanes.iter().enumerate().for_each(|(lane, &z)| first[lane / CHUNK][lane % CHUNK] = z as i32);
                let (arrived, sent) = ([&first[..chunks], &second[..chunks]], &mut sent[..chunks]);
                let effects = updater.update(&mut Block { columns, arrived, sent, step: t as u32, vectors });
                for lane in 0..updater.lanes() {
                    let neuron = block * MOST_LANES + lane;
                    let word = |column: usize| columns[lane / CHUNK * updater.words() + column][lane % CHUNK] as f32;
                    trace.potential[t * n + neuron] = word(0) * read_out;
                    if let Some(imaginary) = trace.imaginary.get_mut(t * n + neuron) {
                        *imaginary = word(1) * read_out;
                    }
                    if effects.emitted >> lane & 1 == 1 {
                        let value = if updater.computes() { sent[lane / CHUNK][lane % CHUNK] as f32 } else { 1.0 };
                        trace.spikes.push(neuron as u32, value);
                    }
                }
            }
            trace.spikes.end_step();
        }
    }

    pub(super) fn forward_smooth(&self, drive: &[f32], surrogate: &Surrogate, trace: &mut Trace) {
        let n = self.rows.len();
        trace.imaginary.resize(if self.turns.is_empty() { 0 } else { drive.len() }, 0.0);
        let (mut re, mut im) = (vec![0.0f32; n], vec![0.0f32; n]);
        for (t, z) in drive.chunks_exact(n).enumerate() {
            for j in 0..n {
                let (x, was) = (z[j] / self.weight_unit, re[j]);
                let sent = match self.turns.get(j) {
                    Some([cos, sin]) => {
                        (re[j], im[j]) = (cos * was - sin * im[j] + x, sin * was + cos * im[j]);
                        trace.imaginary[t * n + j] = im[j];
                        surrogate.smooth(re[j]) * surrogate.pulse(im[j])
                    }
                    None => {
                        re[j] += x;
                        (re[j].max(0.0) - was.max(0.0)) * self.unit
                    }
                };
                trace.potential[t * n + j] = if self.theta.is_infinite() { re[j] * self.unit } else { re[j] };
                trace.spikes.push(j as u32, sent);
            }
            trace.spikes.end_step();
        }
    }

    /// As `Cells::backward`.
    pub(super) fn backward(&self, trace: &Trace, surrogate: &Surrogate, error: &mut [f32]) {
        let n = self.rows.len();
        if let NeuronKind::SigmaDelta = self.kind {
            // The state enters its step's change, and with the opposite sign the next change.
            for at in 0..error.len() {
                let next = error.get(at + n).copied().unwrap_or(0.0);
                let open = f32::from(u8::from(trace.potential[at] > 0.0));
                error[at] = open * self.unit * (error[at] - next);
            }
        }
        if self.turns.is_empty() {
            self.correlate(error, &[]);
            return;
        }
        let mut imaginary = vec![0.0; error.len()];
        for (at, (e, i)) in error.iter_mut().zip(&mut imaginary).enumerate() {
            let (re, im) = (trace.potential[at], trace.imaginary[at]);
            *i = *e * surrogate.smooth(re) * surrogate.pulse_slope(im);
            *e *= surrogate.slope(re) * surrogate.pulse(im);
        }
        self.correlate(error, &imaginary);
    }

    /// Converts errors at the real (and imaginary) part of the state to errors at the drive.
    pub(super) fn correlate(&self, error: &mut [f32], imaginary: &[f32]) {
        let n = self.rows.len();
        let (mut re, mut im) = (vec![0.0f32; n], vec![0.0f32; n]);
        for t in (0..error.len() / n.max(1)).rev() {
            for j in 0..n {
                let [cos, sin] = self.turns.get(j).copied().unwrap_or([1.0, 0.0]);
                let (was_re, was_im) = (re[j], im[j]);
                re[j] = error[t * n + j] + cos * was_re + sin * was_im;
                im[j] = imaginary.get(t * n + j).copied().unwrap_or(0.0) + cos * was_im - sin * was_re;
                error[t * n + j] = re[j];
            }
        }
    }
}
