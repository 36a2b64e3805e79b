//! Samples on which a conversion searches.

use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Stimulus;
use nsim_ir::stimulus::SceneArg;
use nsim_session::error::Result;
use nsim_session::inputs;

/// The distance between the seeds of calibration and of the run.
const CALIBRATION_SEED: u64 = 1_000_003;

/// Input of a run, as far as it determines the samples.
#[derive(Debug, Clone, Copy)]
pub struct RunInput<'a> {
    /// Its sources.
    pub sources: &'a [String],
    /// Its seed.
    pub seed: Option<u64>,
    /// The model's own scene.
    pub scene: Option<&'a str>,
}

/// Samples for a search: of the named sources, or else `wanted` ones of the run's scene with
/// another seed. `None` if the run presents no scene, so that only its own samples are left.
///
/// # Errors
/// A source that cannot be used.
pub fn stimulus(network: &Quantised, named: &[String], run: RunInput<'_>, wanted: usize) -> Result<Option<Stimulus>> {
    if !named.is_empty() {
        return inputs::stimulus(network, named, None, None).map(Some);
    }
    let source = match run.sources {
        [] => run.scene,
        [source] => Some(source.as_str()),
        _ => None,
    };
    let Some(scene) = source.and_then(|source| source.strip_prefix("scene:")) else { return Ok(None) };
    let mut scene = SceneArg::parse(scene)?;
    let seed = |(key, value): &(String, String)| (key == "seed").then(|| value.parse::<u64>().ok()).flatten();
    let seed = run.seed.or_else(|| scene.parameters.iter().find_map(seed)).unwrap_or(1);
    scene.parameters.retain(|(key, _)| key != "seed" && key != "samples");
    scene.parameters.push(("samples".to_string(), wanted.to_string()));
    let seed = seed.wrapping_add(CALIBRATION_SEED);
    inputs::stimulus(network, &[scene.spelled()], None, Some(seed)).map(Some)
}
