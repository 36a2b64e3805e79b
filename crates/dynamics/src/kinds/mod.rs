//! Neuron kinds whose state is columns of 32-bit words. Each kind defines the update of one
//! compartment, which `Chunked` applies to the compartments of a block.
//!
//! Input: the sums of a step's arrivals (weights times messages, without Loihi 1's factor of 64),
//! and the state. Output: the next state, and the message of each compartment. Sums and words
//! beyond 32 bits wrap, as in lava's processes, and are reported.
//!
//! To add a kind: its table in [`nsim_ir::neurons`], a file here with its arm of [`updater`], and a
//! second version of its arithmetic in `nsim_golden`. `CONTRIBUTING.md` lists all steps.

mod adaptive;
mod block;
mod graded;
mod lif;
mod microcode;
mod neuron;
mod resonator;
mod sigma_delta;

pub use block::{Block, Effects, Flags, MOST_LANES, Updater, lanes_with};
pub use neuron::CHUNK;

use std::marker::PhantomData;

use neuron::{Columns, Emission, Neuron, OverflowFlags, choice};
use nsim_ir::neurons::{NeuronKind, ParameterRow};

/// The update of a block, compartment by compartment, in chunks that compilers vectorise.
#[derive(Debug)]
struct Chunked<N> {
    lanes: usize,
    /// Parameters, by chunk, then by column.
    parameters: Vec<[i32; CHUNK]>,
    kind: PhantomData<fn() -> N>,
}

/// An update, in the form that `pulp` runs with the processor's vectors.
struct Run<'r, 'b, N>(&'r Chunked<N>, &'r mut Block<'b>);

/// Maximum number of columns of a kind.
const MOST_COLUMNS: usize = 4;

impl<N: Neuron> pulp::NullaryFnOnce for Run<'_, '_, N> {
    type Output = Effects;

    #[inline(always)]
    fn call(self) -> Effects {
        let Run(Chunked { lanes, parameters, .. }, block) = self;
        let (words, of_parameters) = (N::State::COUNT, N::Parameters::COUNT);
        let mut flags = Flags::default();
        for (chunk, sent) in block.sent.iter_mut().enumerate() {
            let parameters = &parameters[chunk * of_parameters..(chunk + 1) * of_parameters];
            let columns = &mut block.columns[chunk * words..(chunk + 1) * words];
            let arrived = block.arrived.map(|sums| sums[chunk]);
            // On the stack, where nothing has an alias.
            let mut state = [[0; CHUNK]; MOST_COLUMNS];
            state[..words].copy_from_slice(columns);
            let (mut values, mut of_chunk) = (*sent, [0; CHUNK]);
            for lane in 0..CHUNK {
                let p = N::Parameters::load(parameters, lane);
                let (mut s, mut overflows) = (N::State::load(&state, lane), OverflowFlags::default());
                let arrived = [arrived[0][lane], arrived[1][lane]];
                let (before, reached) = (s, arrived[0] | arrived[1] != 0);
                let rests = N::RESTARTS && N::idle(&p, &s);
                N::restart(&p, &mut s, block.step);
                let Emission { sends, value } = N::update(&p, &mut s, arrived, &mut overflows);
                // Without arrivals the update itself shows whether the neuron was idle.
                let moved = if N::RESTARTS { !rests } else { (sends != 0) | overflows.any() | (s != before) };
                let (active, busy) = (reached | moved, !N::idle(&p, &s));
                s.store(&mut state, lane);
                if N::VALUES {
                    values[lane] = choice(sends, value, values[lane]);
                }
                of_chunk[lane] = (sends & 1) as u32
                    | u32::from(active) << 1
                    | u32::from(overflows.any_wrapped()) << 2
                    | u32::from(overflows.any_clipped()) << 3
                    | u32::from(busy) << 4;
            }
            columns.copy_from_slice(&state[..words]);
            *sent = values;
            for (byte, flags) in flags[chunk].iter_mut().zip(of_chunk) {
                *byte = flags as u8;
            }
        }
        Effects::new(*lanes, &flags)
    }
}

impl<N: Neuron> Updater for Chunked<N> {
    fn update(&self, block: &mut Block<'_>) -> Effects {
        let vectors = block.vectors;
        vectors.dispatch(Run(self, block))
    }

    fn clear(&self, columns: &mut [[i32; CHUNK]]) {
        columns.fill([0; CHUNK]);
        for lane in 0..self.lanes {
            let first = N::first(&self.parameters(lane));
            first.store(&mut columns[lane / CHUNK * N::State::COUNT..], lane % CHUNK);
        }
    }

    fn wakes(&self) -> bool {
        let idle = |lane: usize| {
            let p = self.parameters(lane);
            N::idle(&p, &N::first(&p))
        };
        !(0..self.lanes).all(idle)
    }

    fn lanes(&self) -> usize {
        self.lanes
    }

    fn words(&self) -> usize {
        N::State::COUNT
    }

    fn computes(&self) -> bool {
        N::VALUES
    }
}

impl<N: Neuron> Chunked<N> {
    fn parameters(&self, lane: usize) -> N::Parameters {
        N::Parameters::load(&self.parameters[lane / CHUNK * N::Parameters::COUNT..], lane % CHUNK)
    }
}

fn chunked<N: Neuron>(rows: &[ParameterRow]) -> Option<Box<dyn Updater>> {
    let (count, chunks) = (N::Parameters::COUNT, rows.len().div_ceil(CHUNK));
    let mut parameters = vec![[0; CHUNK]; count * chunks];
    for (lane, row) in rows.iter().enumerate() {
        N::prepare(row).store(&mut parameters[lane / CHUNK * count..], lane % CHUNK);
    }
    Some(Box::new(Chunked::<N> { lanes: rows.len(), parameters, kind: PhantomData }))
}

/// Returns the update of compartments with these parameters, at most [`MOST_LANES`]; `None` for a
/// kind with the registers of Loihi 1.
pub fn updater(kind: NeuronKind, rows: &[ParameterRow]) -> Option<Box<dyn Updater>> {
    match kind {
        NeuronKind::Loihi | NeuronKind::If | NeuronKind::SoftReset => None,
        NeuronKind::SigmaDelta => chunked::<sigma_delta::SigmaDelta>(rows),
        NeuronKind::Delta => chunked::<sigma_delta::Delta>(rows),
        NeuronKind::Sigma => chunked::<sigma_delta::Sigma>(rows),
        NeuronKind::Rf => chunked::<resonator::Resonator<false>>(rows),
        NeuronKind::RfIz => chunked::<resonator::Resonator<true>>(rows),
        NeuronKind::TernaryLif => chunked::<lif::TernaryLif>(rows),
        NeuronKind::LifReset => chunked::<lif::LifReset>(rows),
        NeuronKind::GradedLif => chunked::<lif::GradedLif>(rows),
        NeuronKind::AtrLif => chunked::<adaptive::AdaptiveLif<true>>(rows),
        NeuronKind::Alif => chunked::<adaptive::AdaptiveLif<false>>(rows),
        NeuronKind::Adrf => chunked::<resonator::Adaptive<false>>(rows),
        NeuronKind::AdrfIz => chunked::<resonator::Adaptive<true>>(rows),
        NeuronKind::RfZero => chunked::<resonator::RfZero>(rows),
        NeuronKind::GradedVec => chunked::<graded::GradedVec<false>>(rows),
        NeuronKind::GradedReluVec => chunked::<graded::GradedVec<true>>(rows),
        NeuronKind::ProdNeuron => chunked::<graded::ProdNeuron>(rows),
        NeuronKind::NormVecDelay => chunked::<graded::NormVecDelay>(rows),
        NeuronKind::NormSquare => chunked::<graded::NormSquare>(rows),
        NeuronKind::InvSqrt => chunked::<graded::InvSqrt>(rows),
        NeuronKind::Microcode(kind) => Some(microcode::updater(kind, rows)),
    }
}
