//! How a spike response network becomes integers.

use crate::cli::args::input::InputArgs;
use crate::cli::args::inputs;
use crate::compile::frontend::analytic::{self, Fit};
use crate::convert::search::{self, Found};
use crate::desc::stimulus::SceneArg;
use crate::error::Error;
use crate::ir::graph::Graph;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::Sample;

/// How a spike response network becomes integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Conversion {
    /// The analytic start, then a search on calibration samples.
    Search,
    /// The analytic start alone.
    Analytic,
}

/// The seeds of calibration and of the run lie so far apart.
const CALIBRATION_SEED: u64 = 1_000_003;

/// What stands for the spike response populations of a network, and the search that found it, if there was one. It is made
/// on so many samples: those of `calibrate`, or else of the input's scene with another seed, or else the first of the input.
///
/// # Errors
/// [`Error`] when a source cannot be used.
#[allow(clippy::too_many_arguments)]
pub fn fits(
    conversion: Conversion,
    calibrate: &[String],
    wanted: usize,
    input: &InputArgs,
    graph: &Graph,
    network: &Quantised,
    scene: Option<&str>,
    samples: &[&Sample],
) -> Result<(Vec<Option<Fit>>, Option<Found>), Error> {
    if !graph.has_srm() || conversion == Conversion::Analytic {
        return Ok((analytic::starts(graph), None));
    }
    let own = match (calibrate, input.input.as_slice()) {
        ([], inputs) => {
            let text = match inputs {
                [] => scene.map(str::to_string),
                [text] => Some(text.clone()),
                _ => None,
            };
            text.and_then(|text| text.strip_prefix("scene:").map(str::to_string))
        }
        _ => None,
    };
    let stimulus = match own {
        // Other samples of the same scene.
        Some(scene) => {
            let mut scene = SceneArg::parse(&scene)?;
            let seed = |(key, value): &(String, String)| (key == "seed").then(|| value.parse::<u64>().ok()).flatten();
            let given = input.seed.or_else(|| scene.parameters.iter().find_map(seed)).unwrap_or(1);
            scene.parameters.retain(|(key, _)| key != "seed" && key != "samples");
            scene.parameters.push(("samples".to_string(), wanted.to_string()));
            let seed = given.wrapping_add(CALIBRATION_SEED);
            Some(inputs::stimulus(network, &[scene.spelled()], None, Some(seed))?)
        }
        None if !calibrate.is_empty() => Some(inputs::stimulus(network, calibrate, None, None)?),
        None => None,
    };
    let calibration: Vec<&Sample> = match &stimulus {
        Some(stimulus) => stimulus.samples.iter().take(wanted).collect(),
        None => {
            tracing::warn!("calibrating on the first samples of the input itself; --calibrate gives others");
            samples.iter().take(wanted).copied().collect()
        }
    };
    let found = search::search(graph, &calibration, |population| tracing::info!("searching '{population}'"))?;
    Ok((found.fits.clone(), Some(found)))
}
