//! Neurons whose rule a model file states, compiled to instructions for registers of 64 lanes.
//!
//! Input: a checked tree ([`Microcode`]) and the parameters of at most 64 neurons. Output: an
//! [`Updater`]. `compile` makes the instructions, once for each kind. `specialise` removes the
//! instructions that these parameters make redundant. `run` executes the others.
//!
//! A register holds one value for each lane, in 32 bits where the interval of the value fits, in 64
//! otherwise. Values that depend on parameters alone are computed when the updater is made. If an
//! update without arrivals changes, sends and reports nothing, so does the next. The update itself
//! therefore reports whether a neuron was idle.

mod compile;
mod run;
mod specialise;

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use nsim_ir::neurons::{Emits, MicrocodeKind, NeuronKind, ParameterRow};

use self::compile::Code;
use self::run::{CHUNKS, Registers};
use super::block::{Block, Effects, Updater};
use super::neuron::CHUNK;

/// The update of neurons of one kind.
#[derive(Debug)]
struct Programmed {
    code: Code,
    lanes: usize,
    /// Whether messages carry a value that the rule computes.
    computes: bool,
    /// Registers that depend on parameters alone.
    fixed: Registers,
}

thread_local! {
    static REGISTERS: RefCell<Registers> = RefCell::default();
}

/// Returns the instructions of a kind, compiled once per process.
fn code(kind: MicrocodeKind) -> Arc<Code> {
    static COMPILED: LazyLock<Mutex<HashMap<MicrocodeKind, Arc<Code>>>> = LazyLock::new(Mutex::default);
    let mut compiled = COMPILED.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(compiled.entry(kind).or_insert_with(|| Arc::new(Code::new(kind.code()))))
}

/// Returns the update of at most 64 neurons with these parameters.
pub(super) fn updater(kind: MicrocodeKind, rows: &[ParameterRow]) -> Box<dyn Updater> {
    let code = code(kind);
    let mut fixed = Registers::default();
    fixed.make_room(&code.fixed);
    for (place, register) in fixed.narrow.iter_mut().take(code.parameters).enumerate() {
        for (value, row) in register.as_flattened_mut().iter_mut().zip(rows) {
            *value = row.0[place];
        }
    }
    run::fix(&code, &mut fixed);
    let code = code.specialised(&fixed.narrow, rows.len());
    let computes = NeuronKind::Microcode(kind).table().emits == Emits::Values;
    Box::new(Programmed { code, lanes: rows.len(), computes, fixed })
}

impl Updater for Programmed {
    fn update(&self, block: &mut Block<'_>) -> Effects {
        let Block { columns, arrived, sent, vectors, .. } = block;
        let &Programmed { ref code, lanes, ref fixed, .. } = self;
        REGISTERS.with_borrow_mut(|registers| {
            registers.make_room(&code.step);
            vectors.dispatch(run::Step { code, lanes, fixed, registers, columns, arrived: *arrived, sent })
        })
    }

    fn clear(&self, columns: &mut [[i32; CHUNK]]) {
        columns.fill([0; CHUNK]);
    }

    fn wakes(&self) -> bool {
        let chunks = self.lanes.div_ceil(CHUNK);
        let mut columns = vec![[0; CHUNK]; chunks * self.words()];
        let (silence, mut sent) = ([[0; CHUNK]; CHUNKS], [[0; CHUNK]; CHUNKS]);
        let (arrived, sent) = ([&silence[..chunks]; 2], &mut sent[..chunks]);
        let vectors = pulp::Arch::Scalar;
        self.update(&mut Block { columns: &mut columns, arrived, sent, step: 0, vectors }).active != 0
    }

    fn lanes(&self) -> usize {
        self.lanes
    }

    fn words(&self) -> usize {
        self.code.words
    }

    fn computes(&self) -> bool {
        self.computes
    }
}
