//! A program that several processes run together: the first maps, each makes its own part.
//!
//! Input: a network, or one on its places, on rank 0. Output: on each rank the part that it holds,
//! verified and checked ([`nsim_compile::parcel`]). Invariant: the synapses of all parts together
//! are as many as the network's. Errors: those of the compiler on rank 0; on the others
//! [`CompileError::DoesNotFit`] without reasons where rank 0 has some, or a fault. A rank that
//! waits for rank 0 is ended with it.

use nsim_compile as compile;
use nsim_compile::parcel;
use nsim_compile::parcel::{Opened, Parcel};
use nsim_compile::{CompileError, Compiled, DEFAULT_RATE, Front, Options, Placed};
use nsim_ir::dealt::Dealt;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_machine::ranks::transport::Ranks;

/// The program of a network on its places, or rank 0's part of it; the other ranks are told theirs,
/// with a note.
///
/// # Errors
/// [`CompileError::Fault`] when a check fails, here or of all parts together.
pub fn hand_out(
    placed: Placed,
    target: &Target,
    options: &Options,
    (ranks, note): (&Ranks, Option<&str>),
) -> Result<Compiled, CompileError> {
    let synapses = placed.partitioned.all.synapses();
    let dealt = placed.dealt(options.share).ok_or_else(|| CompileError::fault("there are no other ranks"))?;
    let parcel = Parcel { placed: &placed, copies: options.copies, dealt: &dealt, note };
    for rank in 1..ranks.ranks() {
        let sent = parcel.of_rank(rank)?;
        ranks.transport().give(rank, sent);
    }
    let compiled = placed.emit_dealt(target, options, Some(dealt))?.check(target)?;
    let written: u64 = ranks.transport().gather(vec![own_synapses(&compiled, 0)]).concat().iter().sum();
    match written == synapses {
        true => Ok(compiled),
        false => Err(CompileError::fault(format!("all ranks have {written} synapses and the network {synapses}"))),
    }
}

/// Tells the other ranks that the network does not fit.
///
/// # Errors
/// None that is known.
pub fn refuse(ranks: &Ranks) -> Result<(), CompileError> {
    let refusal = parcel::refusal()?;
    (1..ranks.ranks()).for_each(|rank| ranks.transport().give(rank, refusal.clone()));
    Ok(())
}

/// The part of another rank than the first, and the note that came with it.
///
/// # Errors
/// [`CompileError::DoesNotFit`], without reasons, where rank 0 has said so; [`CompileError::Fault`]
/// when a check fails.
pub fn receive(target: &Target, options: &Options, ranks: &Ranks) -> Result<Opened, CompileError> {
    let parcel = ranks.transport().given();
    let opened = parcel::open(parcel, target, options)?;
    ranks.transport().gather(vec![own_synapses(&opened.compiled, ranks.rank())]);
    Ok(opened)
}

/// A program for a network at the default rate: [`compile::compile`], or the part of this rank.
///
/// # Errors
/// As [`hand_out`] and [`receive`]; on rank 0 and in one process those of the compiler.
pub fn compile_on(
    ranks: Option<&Ranks>,
    network: impl Into<Front>,
    target: &Target,
    options: &Options,
) -> Result<Compiled, CompileError> {
    let Some(ranks) = ranks else { return compile::compile(network, target, options) };
    if ranks.rank() > 0 {
        return Ok(receive(target, options, ranks)?.compiled);
    }
    let front = network.into();
    front.form(options.copies).require_program(front.quantised(), options.copies)?;
    match compile::place(front, target, options, &Rates::assumed(DEFAULT_RATE)) {
        Ok(placed) => hand_out(placed, target, options, (ranks, None)),
        Err(error) => {
            refuse(ranks)?;
            Err(error)
        }
    }
}

/// Synapses of the cores that a rank runs.
fn own_synapses(compiled: &Compiled, rank: u32) -> u64 {
    let dealt: Option<&Dealt> = compiled.program.parts().dealt.as_ref();
    compiled.program.synapses_of(|core| dealt.is_none_or(|dealt| dealt.owners[core] == rank))
}
