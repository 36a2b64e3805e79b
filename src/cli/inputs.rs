//! `--input` arguments -> the samples of a run.
//!
//! Each input population needs a source; a bare source serves the only input population, or all that it names. Sources of
//! several populations are matched sample by sample: they must agree in number, steps and labels.

use std::path::Path;

use crate::base::diagnostic::Diagnostic;
use crate::base::id::ChannelId;
use crate::desc::stimulus::{InputArg, InputSource, SceneArg};
use crate::error::Error;
use crate::io::dataset;
use crate::io::events::{EventOptions, Expected};
use crate::io::stimulus::{PopulationSpikes, holds_events, read_events, read_source};
use crate::ir::quantised::{Population, Quantised};
use crate::ir::spikes::{Sample, Stimulus};
use crate::scene;

/// Reads or makes the samples of a run; without arguments, those of the model's own scene.
///
/// # Errors
/// [`Error`] when a source cannot be read or does not fit the network.
pub fn stimulus(
    network: &Quantised,
    arguments: &[String],
    default: Option<&str>,
    seed: Option<u64>,
) -> Result<Stimulus, Error> {
    let from_model = default.map(str::to_string);
    let arguments: Vec<String> = match (arguments, from_model) {
        ([], Some(scene)) => vec![scene],
        ([], None) => vec!["scene:noise".to_string()],
        (given, _) => given.to_vec(),
    };
    let parsed = arguments.iter().map(|text| argument(network, text)).collect::<Result<Vec<_>, _>>()?;
    if let [InputArg { population: None, source: InputSource::Scene(scene) }] = parsed.as_slice() {
        return Ok(scene_stimulus(network, scene, seed)?);
    }
    let inputs: Vec<&Population> = network.inputs().map(|(_, population)| population).collect();
    let mut sources: Vec<Option<Vec<PopulationSpikes>>> = inputs.iter().map(|_| None).collect();
    for argument in &parsed {
        let (path, options) = match &argument.source {
            InputSource::Path(path) => (path, None),
            InputSource::Events(path, pairs) => (path, Some(EventOptions::parse(pairs)?)),
            InputSource::Scene(_) => {
                return Err(Error::Usage("a scene drives all input populations and stands alone".to_string()));
            }
        };
        let wanted: Vec<usize> = match &argument.population {
            Some(name) => vec![inputs.iter().position(|p| &p.name == name).ok_or_else(|| unknown(name, &inputs))?],
            None if path.extension().is_some_and(|e| e == "ron") => (0..inputs.len()).collect(),
            None if inputs.len() == 1 => vec![0],
            None => {
                let names: Vec<&str> = inputs.iter().map(|p| p.name.as_str()).collect();
                return Err(Error::Usage(format!(
                    "--input {}: which population is it for? Write one of {}",
                    path.display(),
                    names.iter().map(|name| format!("{name}={}", path.display())).collect::<Vec<_>>().join(", ")
                )));
            }
        };
        let manifest = match path.extension().is_some_and(|e| e == "ron") {
            true => Some(dataset::read_manifest(path)?),
            false => None,
        };
        for index in wanted {
            let population = inputs[index];
            let units = u64::from(population.shape.len());
            let spikes = match &manifest {
                Some(manifest) => manifest.read(&population.name, units)?,
                None if options.is_some() || holds_events(path) => {
                    let dt_ms = network.parts().timestep_ms;
                    let expected = Expected { units, volume: population.shape.volume(), dt_ms };
                    read_events(path, &population.name, &expected, &options.clone().unwrap_or_default())?
                }
                None => read_source(path, units)?,
            };
            if sources[index].replace(spikes).is_some() {
                return Err(Error::Usage(format!("population '{}' has two inputs", population.name)));
            }
        }
    }
    let mut filled = Vec::new();
    for (source, population) in sources.into_iter().zip(&inputs) {
        filled.push(source.ok_or_else(|| {
            Error::Usage(format!(
                "input population '{}' has no source: add --input {}=FILE",
                population.name, population.name
            ))
        })?);
    }
    Ok(Stimulus { samples: join(&inputs, filled)?, origin: arguments, seed: None })
}

/// One `--input`. What stands before `=` is a population, unless there is none of this name and a file of the whole name.
fn argument(network: &Quantised, text: &str) -> Result<InputArg, Diagnostic> {
    let argument = InputArg::parse(text)?;
    match &argument.population {
        Some(name) if network.population_named(name).is_none() && Path::new(text).exists() => {
            Ok(InputArg { population: None, source: InputSource::Path(text.into()) })
        }
        _ => Ok(argument),
    }
}

fn scene_stimulus(network: &Quantised, scene: &SceneArg, seed: Option<u64>) -> Result<Stimulus, Diagnostic> {
    let mut scene = scene.clone();
    if let Some(seed) = seed {
        scene.parameters.retain(|(key, _)| key != "seed");
        scene.parameters.push(("seed".to_string(), seed.to_string()));
    }
    let mut stimulus = scene::stimulus(network, &scene)?;
    stimulus.origin = vec![scene.spelled()];
    Ok(stimulus)
}

fn unknown(name: &str, inputs: &[&Population]) -> Error {
    let names: Vec<&str> = inputs.iter().map(|p| p.name.as_str()).collect();
    let help = format!("input populations are: {}", names.join(", "));
    Diagnostic::new("input.population", format!("--input names '{name}', which is no input population"))
        .help(help)
        .into()
}

/// One sample of all populations from one of each.
fn join(inputs: &[&Population], sources: Vec<Vec<PopulationSpikes>>) -> Result<Vec<Sample>, Error> {
    let Some(count) = sources.first().map(Vec::len) else {
        return Ok(Vec::new());
    };
    for (source, population) in sources.iter().zip(inputs) {
        if source.len() != count {
            let message =
                format!("'{}' has {} samples, '{}' has {count}", population.name, source.len(), inputs[0].name);
            return Err(Diagnostic::new("input.samples", message).help("sources are matched sample by sample").into());
        }
    }
    let mut sources: Vec<_> = sources.into_iter().map(Vec::into_iter).collect();
    let mut samples = Vec::with_capacity(count);
    for index in 0..count {
        let parts: Vec<PopulationSpikes> = sources.iter_mut().filter_map(Iterator::next).collect();
        let (steps, label) = (parts[0].steps, parts.iter().find_map(|part| part.label));
        let mut events = Vec::new();
        for (part, population) in parts.into_iter().zip(inputs) {
            let disagree = |what: &str, other: &str| {
                Error::from(Diagnostic::new(
                    "input.disagree",
                    format!("sample {index}: {} of '{}' ({}) differ from {other}", what, population.name, part.name),
                ))
            };
            if part.steps != steps {
                return Err(disagree(&format!("{} steps", part.steps), &format!("{steps} of '{}'", inputs[0].name)));
            }
            if part.label.is_some() && part.label != label {
                return Err(disagree("labels", "those of the other populations"));
            }
            let first = population.first_channel().map_or(0, |channel| channel.0);
            events.extend(part.events.iter().map(|&(step, channel)| (step, ChannelId(first + channel))));
        }
        samples.push(Sample::new(steps, &events, label).map_err(|e| Diagnostic::new("input.spikes", e.to_string()))?);
    }
    Ok(samples)
}
