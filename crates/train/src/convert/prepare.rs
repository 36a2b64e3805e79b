//! A model file -> a network that is ready to be mapped: the start of every command and of the
//! Python module.
//!
//! Input: a network as its file says. Output: its integers. Spike response neurons become Loihi
//! compartments as by `nsim convert`, on samples of the model's own scene, or by analysis if it has
//! none. The result is deterministic, so a saved mapping fits the network again.

use crate::convert::calibration::{self, RunInput};
use crate::convert::search::search;
use nsim_compile::Front;
use nsim_files::network::Network;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::spikes::Sample;
use nsim_session::error::Error;
use nsim_session::front::{has_srm, real_and_integers};
use nsim_session::obtain::{Conversion, ConversionStage};

/// Number of calibration samples by default.
const CALIBRATION_SAMPLES: usize = 60;

/// The stages by which commands and the Python module convert a network.
const STAGES: &[ConversionStage] =
    &[ConversionStage { name: "search", applies: has_srm, convert: searched_integers }, ConversionStage::QUANTISE];

/// The conversion of a network, with at most this many taps of an input population.
pub fn conversion(most_taps: usize) -> Conversion {
    Conversion { stages: STAGES, most_taps }
}

/// A network of spike response neurons in integers, from a search on its own scene.
///
/// # Errors
/// [`Error`] when the network cannot be used.
fn searched_integers(network: &Network, most_taps: usize) -> Result<Front, Error> {
    let (graph, start) = real_and_integers(network)?;
    let name = &network.file().name;
    let run = RunInput { sources: &[], seed: None, scene: network.file().scene.as_deref() };
    let Some(stimulus) = calibration::stimulus(&start, &[], run, CALIBRATION_SAMPLES)? else {
        let message = format!(
            "{name}: its spike response neurons become Loihi compartments by analysis only (equal decays, matched \
             peaks), because it has no scene for calibration; `nsim convert` calibrates on samples and writes the \
             result"
        );
        return Ok(start.warned(Warning::of_network(WarningCode::Converted, message)).into());
    };
    let samples: Vec<&Sample> = stimulus.samples.iter().collect();
    let search_result = search(&graph, &samples, most_taps, |_| ())?;
    let message = format!(
        "{name}: its spike response neurons become Loihi compartments, converted on {} samples of its scene: classes \
         agree in {:.4}, coincidence {:.3}; `nsim convert -o` writes them",
        search_result.samples,
        search_result.end.classes.share_reproduced(),
        search_result.end.coincidence
    );
    let integers = search_result.conversion.integers(&graph)?.with_chosen_rounding();
    Ok(integers.warned(Warning::of_network(WarningCode::Converted, message)).into())
}
