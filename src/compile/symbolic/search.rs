//! Several ways of cutting a network of layers into boxes, compared by what a step is expected to cost.
//!
//! As [`crate::compile::explore::search`], of which the rules are; but there is no sequential mapping to start from, so the first
//! candidate is the fewest boxes, unplaced, and only those parts of a core are tried whose boxes are not too many for the
//! target. A candidate is kept as its outline alone: the one that is taken is made again and checked as a saved one is.

use crate::compile::explore::search::{Candidate, DIVISORS, Found, MOST_BURSTS, Made, chosen, divided};
use crate::compile::explore::traffic::DEFAULT_RATE;
use crate::compile::symbolic::boxes::{Boxes, Layered};
use crate::compile::symbolic::cost::{PopulationRates, Whereabouts, everywhere, only};
use crate::compile::symbolic::file::Outline;
use crate::compile::symbolic::placed;
use crate::compile::{CompileError, Objective, Options};
use crate::desc::target::Target;
use crate::ir::firing_rates::Rates;
use crate::ir::quantised::Quantised;

/// Compartments that a second of effort allows to be cut into boxes anew, over all candidates.
const COMPARTMENTS_PER_SECOND: u64 = 20_000_000;

/// A candidate: where boxes are, the name of the placement, and times of bursts when they are asked for.
struct Sketch {
    outline: Outline,
    placed: &'static str,
    times: Vec<f64>,
}

/// Every candidate that fits and that the effort allows for, the fewest boxes first.
///
/// # Errors
/// [`CompileError`] of the first candidate.
pub fn candidates(network: &Layered, target: &Target, options: &Options) -> Result<Vec<Found>, CompileError> {
    Ok(all(network, target, options)?.into_iter().map(|made| made.found).collect())
}

/// The best of all candidates, and the name of its placement.
///
/// # Errors
/// As [`candidates`].
pub fn best(network: &Layered, target: &Target, options: &Options) -> Result<(Outline, &'static str), CompileError> {
    let sketch = chosen(all(network, target, options)?, options.objective, |sketch| Ok(sketch.times.clone()))?;
    Ok((sketch.outline, sketch.placed))
}

fn all(network: &Layered, target: &Target, options: &Options) -> Result<Vec<Made<Sketch>>, CompileError> {
    let compartments = u64::from(network.all.compartments()).max(1);
    let affordable = (u64::from(options.effort_s) * COMPARTMENTS_PER_SECOND / compartments).max(1) as usize;
    let may_fit = |&divisor: &u32| divisor == 1 || network.may_fit(divided(target, divisor, 0).limits(), target);
    let divisors: Vec<u32> = DIVISORS.into_iter().take(affordable).filter(may_fit).collect();
    // The effort is for all of them together.
    let options = &Options { effort_s: options.effort_s.div_ceil(divisors.len() as u32), ..*options };
    let bursts = match options.objective {
        Objective::Latency => bursts(&network.all),
        Objective::Cores | Objective::Energy => Vec::new(),
    };
    let rates = everywhere(&network.all, &Rates::assumed(DEFAULT_RATE));
    let mut made = Vec::new();
    // One after the other: each takes as much memory as a mapping, and works on all threads.
    for divisor in divisors {
        let boxes = match Boxes::fewest(network, &divided(target, divisor, 0), options) {
            Ok(boxes) => boxes,
            Err(error) if made.is_empty() => return Err(error),
            Err(_) => continue,
        };
        // The fewest boxes are looked at unplaced too.
        let places = if divisor == 1 && options.place { &[false, true][..] } else { &[options.place] };
        for &place in places {
            let options = &Options { place, ..*options };
            let (placement, name) = placed(&boxes, target, options, &rates)?;
            let found = Whereabouts { network: &network.all, boxes: &boxes, placement: &placement };
            let score =
                |rates: &PopulationRates| found.score(rates, target, options.copies).map_err(CompileError::Input);
            let candidate = Candidate { strategy: options.strategy, divisor, placed: place };
            let times = bursts.iter().map(|rates| Ok(score(rates)?.step_us)).collect::<Result<_, CompileError>>()?;
            let found = Found { candidate, score: score(&rates)? };
            let outline = Outline { lattices: boxes.lattices(), placement };
            made.push(Made { found, mapping: Sketch { outline, placed: name, times } });
        }
    }
    Ok(made)
}

/// Rates of steps in which all sources spike, and in which those of one population do, for as many as are affordable.
fn bursts(network: &Quantised) -> Vec<PopulationRates> {
    let once = Rates::assumed(1.0);
    let of_one = network.populations().ids().take(MOST_BURSTS).map(|id| only(network, id, &once));
    std::iter::once(everywhere(network, &once)).chain(of_one).collect()
}
