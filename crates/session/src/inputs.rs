//! `--input` arguments -> the samples of a run.
//!
//! Each input population needs a source. A source without population name serves the only input
//! population, a manifest all of them. Sources of several populations are matched by sample, with
//! equal numbers, steps and labels. A clock may serve one population while recordings serve others.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::samples::Progress;
use nsim_files::budget::MOST_STEPS_TOGETHER;
use nsim_files::warnings::show;
use nsim_import::kind::FileKind;
use nsim_import::spikes::{
    EventOptions, InputSpec, Manifest, PopulationSpikes, labels, read_manifest, read_spikes, warning_of_changes,
};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::ChannelId;
use nsim_ir::base::names::did_you_mean;
use nsim_ir::base::warning::Warning;
use nsim_ir::quantised::{Population, Quantised};
use nsim_ir::spikes::{Message, Sample, Spikes, Stimulus};
use nsim_ir::stimulus::{InputArg, InputSource, SceneArg};
use nsim_scene as scene;
use nsim_scene::clock::{self, Clock};

/// Reads or generates the samples of a run; without arguments, by the model's own scene. Each
/// sample ends with the drain steps of the model.
///
/// # Errors
/// [`Error`] when a source cannot be read or does not fit the network.
pub fn stimulus(
    network: &Quantised,
    arguments: &[String],
    default: Option<&str>,
    seed: Option<u64>,
) -> Result<Stimulus, Error> {
    stimulus_with_progress(network, arguments, default, seed, &|| ())
}

/// As [`stimulus`], with the model's own scene and a seed; calls `progress` before each sample of a
/// scene. Errors are those of [`stimulus`].
pub fn stimulus_with_progress(
    network: &Quantised,
    arguments: &[String],
    default: Option<&str>,
    seed: Option<u64>,
    progress: Progress<'_>,
) -> Result<Stimulus, Error> {
    let mut stimulus = read_samples(network, arguments, default, seed, progress)?;
    stimulus.samples = with_drain(network, stimulus.samples)?;
    show("", &stimulus.warnings);
    Ok(stimulus)
}

/// Refuses to estimate the energy of a model without a scene, where no spikes are given. `help`
/// explains how to give spikes.
///
/// # Errors
/// `energy.input`.
pub fn require_scene(model: &str, scene: Option<&str>, help: &str) -> Result<(), Diagnostic> {
    scene.map(|_| ()).ok_or_else(|| {
        let message = format!("energy depends on activity, but model {model} has no scene");
        Diagnostic::new("energy.input", message).help(help)
    })
}

/// Maximum number of repetitions of the samples of a run.
pub const MOST_REPEATS: u32 = 1_000_000;
/// Maximum number of samples of a run, each of which has its own results.
const MOST_RUNS: u64 = 1 << 22;

/// Returns the indices of the samples that run, in order: the range, `repeat` times.
///
/// # Errors
/// `input.too-many`, before memory for them is allocated.
pub fn repeated_indices(range: Range<usize>, repeat: u32) -> Result<Vec<usize>, Diagnostic> {
    let runs = range.len() as u64 * u64::from(repeat);
    if runs > MOST_RUNS {
        let message =
            format!("{} samples, repeated {repeat} times, are {runs} runs, more than {MOST_RUNS}", range.len());
        return Err(Diagnostic::new("input.too-many", message).help("repeat fewer times, or choose fewer samples"));
    }
    Ok((0..repeat).flat_map(|_| range.clone()).collect())
}

/// Returns the samples, each followed by the drain steps of the network.
///
/// # Errors
/// `input.too-long`.
pub fn with_drain(network: &Quantised, samples: Vec<Sample>) -> Result<Vec<Sample>, Diagnostic> {
    let drain = network.parts().drain;
    let steps = samples.iter().map(|sample| u64::from(sample.steps()) + u64::from(drain)).sum::<u64>();
    if steps > MOST_STEPS_TOGETHER {
        let message = format!("the samples have {steps} timesteps together, more than {MOST_STEPS_TOGETHER}");
        return Err(Diagnostic::new("input.too-long", message).help("run some of them at a time"));
    }
    Ok(match drain {
        0 => samples,
        _ => samples.into_iter().map(|sample| sample.followed_by(drain)).collect(),
    })
}

/// Returns the samples of the arguments, or of the model's own scene.
fn read_samples(
    network: &Quantised,
    arguments: &[String],
    default: Option<&str>,
    seed: Option<u64>,
    progress: Progress<'_>,
) -> Result<Stimulus, Error> {
    let arguments = match arguments {
        [] => vec![default.unwrap_or("scene:noise").to_string()],
        given => given.to_vec(),
    };
    let parsed = arguments.iter().map(|text| parse_argument(network, text)).collect::<Result<Vec<_>, _>>()?;
    if let [InputArg { population: None, source: InputSource::Scene(scene) }] = parsed.as_slice() {
        return Ok(scene_stimulus(network, scene, seed, progress)?);
    }
    let inputs: Vec<&Population> = network.inputs().map(|(_, population)| population).collect();
    let mut sources = Sources {
        timestep_ms: network.parts().timestep_ms,
        spikes: inputs.iter().map(|_| None).collect(),
        inputs: &inputs,
        clocks: Vec::new(),
        warnings: Vec::new(),
    };
    for argument in &parsed {
        sources.add(argument)?;
    }
    sources.run_clocks()?;
    let Sources { spikes, warnings, .. } = sources;
    let mut filled = Vec::new();
    for (source, Population { name, .. }) in spikes.into_iter().zip(&inputs) {
        filled.push(source.ok_or_else(|| {
            Error::Usage(format!("input population '{name}' has no source: add --input {name}=FILE"))
        })?);
    }
    Ok(Stimulus { samples: join_samples(&inputs, filled)?, origin: arguments, seed: None, warnings })
}

struct Sources<'a> {
    timestep_ms: f64,
    inputs: &'a [&'a Population],
    /// The samples of each input population, once it has a source.
    spikes: Vec<Option<Vec<PopulationSpikes>>>,
    /// Clocks and the indices of their populations.
    clocks: Vec<(usize, Clock)>,
    warnings: Vec<Warning>,
}

impl Sources<'_> {
    fn add(&mut self, argument: &InputArg) -> Result<(), Error> {
        let population = argument.population.as_deref();
        match (&argument.source, population) {
            (InputSource::Path(path), _) => self.add_file(population, path, &[]),
            (InputSource::Events(path, pairs), _) => self.add_file(population, path, pairs),
            (InputSource::Scene(scene), Some(name)) if scene.name == clock::NAME => {
                self.clocks.push((self.index_of(name)?, Clock::parse(scene)?));
                Ok(())
            }
            (InputSource::Scene(_), _) => {
                let message = "a scene drives all input populations, so it allows no other input except a clock for \
                               one population: POPULATION=scene:clock?span=STEPS";
                Err(Error::Usage(message.to_string()))
            }
        }
    }

    fn index_of(&self, name: &str) -> Result<usize, Error> {
        self.inputs.iter().position(|p| p.name == name).ok_or_else(|| unknown_population(name, self.inputs))
    }

    /// Reads a file for a population, or for all that it serves.
    fn add_file(&mut self, population: Option<&str>, path: &Path, pairs: &[(String, String)]) -> Result<(), Error> {
        let (pairs, labels) = without_labels(path, pairs)?;
        let is_manifest = FileKind::detect(path)? == FileKind::Ron;
        let wanted: Vec<usize> = match population {
            Some(name) => vec![self.index_of(name)?],
            None if is_manifest => (0..self.inputs.len()).collect(),
            None if self.inputs.len() == 1 => vec![0],
            None => {
                let path = path.display();
                let named: Vec<String> = self.inputs.iter().map(|p| format!("{}={path}", p.name)).collect();
                let named = named.join(", ");
                return Err(Error::Usage(format!("--input {path}: the population is missing. Write one of {named}")));
            }
        };
        let (manifest, options) = match is_manifest {
            true => (Some(DatasetPart::new(read_manifest(path)?, &pairs)?), EventOptions::default()),
            false => (None, EventOptions::parse(&pairs)?),
        };
        for index in wanted {
            let population = self.inputs[index];
            let expected = InputSpec {
                units: population.shape.len().into(),
                volume: population.shape.volume(),
                dt_ms: self.timestep_ms,
                values: matches!(population.message, Message::Value(_)),
            };
            let mut spikes = match &manifest {
                Some(part) => part.read(&population.name, &expected)?,
                None => read_spikes(path, &population.name, &expected, &options)?,
            };
            self.warnings.extend(warning_of_changes(&population.name, &spikes));
            if let Some(file) = &labels {
                labels::apply(file, &labels::read(file)?, &mut spikes)?;
            }
            self.set(index, spikes)?;
        }
        Ok(())
    }

    fn set(&mut self, index: usize, spikes: Vec<PopulationSpikes>) -> Result<(), Error> {
        match self.spikes[index].replace(spikes) {
            None => Ok(()),
            Some(_) => Err(Error::Usage(format!("population '{}' has two inputs", self.inputs[index].name))),
        }
    }

    /// Gives each clock the samples of the recordings.
    fn run_clocks(&mut self) -> Result<(), Error> {
        for (index, clock) in std::mem::take(&mut self.clocks) {
            let Some(recorded) = self.spikes.iter().flatten().next() else {
                return Err(Error::Usage(
                    "a clock needs recordings of other populations, which give the length of a sample".to_string(),
                ));
            };
            let spikes = recorded.iter().map(|sample| clock_spikes(sample, clock, self.inputs[index])).collect();
            self.set(index, spikes)?;
        }
        Ok(())
    }
}

/// Returns the spikes of a clock over the steps of a sample.
fn clock_spikes(sample: &PopulationSpikes, clock: Clock, population: &Population) -> PopulationSpikes {
    let units = population.shape.len();
    PopulationSpikes {
        units: Some(units.into()),
        steps: sample.steps,
        events: clock.spikes(sample.steps, units),
        name: format!("the clock of '{}'", population.name),
        ..PopulationSpikes::default()
    }
}

/// Options of a source: key and value.
type Pairs = Vec<(String, String)>;

fn without_labels(path: &Path, pairs: &[(String, String)]) -> Result<(Pairs, Option<PathBuf>), Error> {
    let (labels, others): (Pairs, Pairs) = pairs.iter().cloned().partition(|(key, _)| key == "labels");
    if labels.len() > 1 {
        return Err(Error::Usage(format!("--input {}: labels are given twice", path.display())));
    }
    Ok((others, labels.into_iter().next().map(|(_, file)| file.into())))
}

/// A data set, or the training or test samples of one of its folds.
struct DatasetPart {
    manifest: Manifest,
    /// Whether the test samples are wanted, and the fold, from 0; `None` for all samples.
    fold: Option<(bool, usize)>,
}

impl DatasetPart {
    /// Parses the options after the `?`: none, `train=K` or `test=K` for fold K, from 1.
    fn new(manifest: Manifest, pairs: &[(String, String)]) -> Result<DatasetPart, Error> {
        let wrong = |message: String| Diagnostic::new("input.option", message).in_file(manifest.source().path());
        let (key, value) = match pairs {
            [] => return Ok(DatasetPart { manifest, fold: None }),
            [(key, value)] if key == "train" || key == "test" => (key, value),
            _ => {
                let message = "a data set takes train=K or test=K, the samples that fold K trains or tests on";
                return Err(wrong(message.to_string()).into());
            }
        };
        let folds = manifest.folds();
        let Some(fold) = value.parse().ok().filter(|fold| (1..=folds).contains(fold)) else {
            return Err(wrong(format!("{key}={value}: the data set has {folds} folds, counted from 1")).into());
        };
        Ok(DatasetPart { manifest, fold: Some((key == "test", fold - 1)) })
    }

    fn read(&self, population: &str, expected: &InputSpec) -> Result<Vec<PopulationSpikes>, Diagnostic> {
        let all = self.manifest.read(population, expected)?;
        let Some((test, fold)) = self.fold else { return Ok(all) };
        let split = self.manifest.splits(all.len())?.swap_remove(fold);
        let samples = if test { split.test } else { split.train };
        let mut all: Vec<_> = all.into_iter().map(Some).collect();
        Ok(samples.into_iter().filter_map(|sample| all.get_mut(sample as usize)?.take()).collect())
    }
}

/// Parses one `--input`. The text before `=` is a population, unless none has this name and the
/// whole text names a file.
fn parse_argument(network: &Quantised, text: &str) -> Result<InputArg, Diagnostic> {
    let argument = InputArg::parse(text)?;
    match &argument.population {
        Some(name) if network.population_named(name).is_none() && Path::new(text).exists() => {
            Ok(InputArg { population: None, source: InputSource::Path(text.into()) })
        }
        _ => Ok(argument),
    }
}

fn scene_stimulus(
    network: &Quantised,
    scene: &SceneArg,
    seed: Option<u64>,
    progress: Progress<'_>,
) -> Result<Stimulus, Diagnostic> {
    let mut scene = scene.clone();
    if let Some(seed) = seed {
        scene.parameters.retain(|(key, _)| key != "seed");
        scene.parameters.push(("seed".to_string(), seed.to_string()));
    }
    let mut stimulus = scene::stimulus_with_progress(network, &scene, progress)?;
    stimulus.origin = vec![scene.spelled()];
    Ok(stimulus)
}

fn unknown_population(name: &str, inputs: &[&Population]) -> Error {
    let names: Vec<&str> = inputs.iter().map(|p| p.name.as_str()).collect();
    let help = format!("{}input populations are: {}", did_you_mean(name, names.iter().copied()), names.join(", "));
    Diagnostic::new("input.population", format!("--input names '{name}', which is not an input population"))
        .help(help)
        .into()
}

/// Returns the input of `network` in a sample of `other`, matched by the names of input
/// populations. `None` where `other` lacks an input population of equal name and size.
pub fn translate_sample(network: &Quantised, other: &Quantised, sample: &Sample) -> Option<Sample> {
    let mut moved = Vec::new();
    for (_, population) in network.inputs() {
        let (_, same) = other.inputs().find(|(_, same)| same.name == population.name)?;
        let units = population.shape.len();
        if same.shape.len() != units {
            return None;
        }
        moved.push((same.first_channel()?.0, population.first_channel()?.0, units));
    }
    let mut events = Vec::new();
    for step in 0..sample.steps() {
        let Spikes { ids, values } = sample.input(step);
        for (place, channel) in ids.iter().enumerate() {
            events.extend(moved.iter().find_map(|&(from, to, units)| {
                let unit = channel.0.checked_sub(from).filter(|&unit| unit < units)?;
                Some((step, ChannelId(to + unit), values.get(place).copied().unwrap_or(1)))
            }));
        }
    }
    Sample::with_values(sample.steps(), &events, sample.label()).ok()
}

/// Joins the samples of all input populations, in their order.
///
/// # Errors
/// `input.samples` and `input.disagree` where the populations do not match, `input.spikes` for a
/// spike outside its sample.
pub fn join_samples(inputs: &[&Population], sources: Vec<Vec<PopulationSpikes>>) -> Result<Vec<Sample>, Error> {
    let Some(count) = sources.first().map(Vec::len) else {
        return Ok(Vec::new());
    };
    for (source, population) in sources.iter().zip(inputs) {
        if source.len() != count {
            let message =
                format!("'{}' has {} samples, '{}' has {count}", population.name, source.len(), inputs[0].name);
            return Err(Diagnostic::new("input.samples", message)
                .help("give sources with equal numbers of samples")
                .into());
        }
    }
    let mut sources: Vec<_> = sources.into_iter().map(Vec::into_iter).collect();
    let mut samples = Vec::with_capacity(count);
    for index in 0..count {
        let parts: Vec<PopulationSpikes> = sources.iter_mut().filter_map(Iterator::next).collect();
        let (steps, label) = (parts[0].steps, parts.iter().find_map(|part| part.label));
        let (mut events, mut values) = (Vec::new(), Vec::new());
        for (part, population) in parts.into_iter().zip(inputs) {
            let disagree = |what: &str, other: &str| {
                let whose = format!("'{}' ({})", population.name, part.name);
                let message = format!("sample {index}: {what} of {whose} differ from {other}");
                Error::from(Diagnostic::new("input.disagree", message))
            };
            if part.steps != steps {
                return Err(disagree(&format!("{} steps", part.steps), &format!("{steps} of '{}'", inputs[0].name)));
            }
            if part.label.is_some() && part.label != label {
                return Err(disagree("labels", "the labels of the other populations"));
            }
            let first = population.first_channel().map_or(0, |channel| channel.0);
            events.extend(part.events.iter().map(|&(step, channel)| (step, ChannelId(first + channel))));
            if !part.values.is_empty() {
                values.resize(events.len() - part.values.len(), 1);
                values.extend(part.values);
            }
        }
        let sample = if values.is_empty() {
            Sample::new(steps, &events, label)
        } else {
            values.resize(events.len(), 1);
            let valued: Vec<_> = events.iter().zip(values).map(|(&(step, channel), v)| (step, channel, v)).collect();
            Sample::with_values(steps, &valued, label)
        };
        samples.push(sample.map_err(|e| Diagnostic::new("input.spikes", e.to_string()))?);
    }
    Ok(samples)
}
