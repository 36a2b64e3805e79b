//! `nsim scene`: makes synthetic recordings, writes them as a data set, and summarises them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_files::dataset::{DataSet, SampleEntry};
use nsim_files::{mapping, npy, write};
use nsim_import::spikes::{self, MANIFEST};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::folds::stratified_folds;
use nsim_ir::spanned::Spanned;
use nsim_ir::stimulus::SceneArg;
use nsim_report::charts::picture::FILE;
use nsim_report::charts::sample::{Content, Panel, Panels};
use nsim_report::scene::{ByMarkers, ClassSummary, Onsets, SceneReport};
use nsim_scene::markers::MarkerOnsets;
use nsim_scene::wire::WireCounts;
use nsim_scene::{RecordedScene, Recording, Senses, TOUCH, VISION, camera, touch};
use nsim_session::error::Error;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim scene slip                                       summary of 20 scenes: labels, densities, onsets
  nsim scene slip --samples 1000 --seed 7 -o scenes     recordings as .npy, and scenes/dataset.ron
  nsim scene 'slip?grip_n=1.5..2.5&pixel_noise_hz=1'    other parameters, which docs/scenes.md lists
  nsim scene container --samples 100 --format json
  nsim scene slip --samples 1000 --polarity -o planes   the same with vision as 2 x 63 x 50: falls, then rises
  nsim scene slip --plot slip.svg                       a picture of one sample
  nsim run --input scenes/dataset.ron";

/// Make synthetic visual-tactile recordings
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// slip or container, with parameters as NAME?key=value&..
    pub name: String,
    /// Samples to make
    #[arg(
        long, value_name = "N",
        value_parser = clap::value_parser!(u32).range(1..=i64::from(nsim_scene::MOST_SAMPLES))
    )]
    pub samples: Option<u32>,
    /// Seed of the random numbers
    #[arg(long)]
    pub seed: Option<u64>,
    /// Folder for the recordings and their dataset.ron
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Write vision with a plane of pixels for each polarity, 2 x 63 x 50 [default: one for both]
    #[arg(long, requires = "output")]
    pub polarity: bool,
    /// Draw the spikes of one sample: taxels and pixels over time, with the onset
    #[arg(long, value_name = FILE)]
    pub plot: Option<PathBuf>,
    /// The sample to draw [default: the first with an onset]
    #[arg(long, value_name = "N", requires = "plot")]
    pub plot_sample: Option<u32>,
}

/// Folds of the manifest's cross-validation, as in the paper.
const FOLDS: usize = 5;

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let mut argument = SceneArg::parse(args.name.strip_prefix("scene:").unwrap_or(&args.name))?;
    let options = [("samples", args.samples.map(u64::from)), ("seed", args.seed)];
    for (key, value) in options.into_iter().filter_map(|(key, value)| Some((key, value?))) {
        argument.parameters.retain(|(other, _)| other != key);
        argument.parameters.push((key.to_string(), value.to_string()));
    }
    let scene = RecordedScene::parse(&argument)?;
    write::check_all_free(args.output.as_ref().map(|folder| folder.join(MANIFEST)), context.force)?;
    let taken = output::check_files(None, &args.plot, context)?;
    if args.plot.is_some()
        && let Some(sample) = args.plot_sample.filter(|&sample| sample >= scene.samples)
    {
        return Err(Error::Usage(format!("--plot-sample {sample}: samples are 0 to {}", scene.samples - 1)));
    }
    let folder = args.output.as_ref().map(|path| write::Folder::begin(path, MANIFEST, context.force)).transpose()?;
    let make = |sample: u32| {
        let recording = scene.recording(sample, Senses::BOTH);
        let files = match &folder {
            Some(folder) => write_sample(folder, sample, &recording, args.polarity)?,
            None => [String::new(), String::new()],
        };
        let [touch, vision] = files.map(Spanned::from);
        let files = [(TOUCH.0.to_string(), touch), (VISION.0.to_string(), vision)].into();
        let spikes = [recording.touch.len(), recording.vision.len()];
        let Recording { label, onset_ms, marker_onsets, wire, .. } = recording;
        Ok((
            SampleFacts { label, onset_ms, marker_onsets, spikes, wire },
            SampleEntry { files, label: Some(label), onset_ms },
        ))
    };
    let written_samples: Vec<Result<(SampleFacts, SampleEntry), Diagnostic>> =
        progress::with_bar(context, scene.samples as usize, "scenes", |done| {
            (0..scene.samples).into_par_iter().map(make).inspect(|_| done()).collect()
        });
    let (facts, entries): (Vec<SampleFacts>, Vec<SampleEntry>) =
        written_samples.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
    if let Some(path) = &args.plot {
        let with_onset = || facts.iter().position(|fact| fact.onset_ms.is_some()).unwrap_or(0) as u32;
        let sample = args.plot_sample.unwrap_or_else(with_onset);
        output::write_picture(path, &raster(&scene, &argument, sample).svg(), context)?;
    }
    if let Some(folder) = &args.output {
        warn_of_other_recordings(folder, &entries);
    }
    let manifest = args.output.as_ref().map(|folder| folder.join(MANIFEST));
    if let Some(folder) = folder {
        folder.finish(&mapping::pretty(&data_set(&scene, &argument, entries), 2)?)?;
    }
    let report = report(&scene, &argument, &facts, manifest);
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(Answer::Yes)
}

/// A camera's spikes by polarity, each on the channel of its unit.
fn by_polarity(planes: Vec<(u32, u32)>) -> Vec<(String, Vec<(u32, u32)>)> {
    let (falls, rises): (Vec<_>, Vec<_>) = planes.into_iter().partition(|&(_, channel)| channel < VISION.1);
    let rises = rises.into_iter().map(|(step, channel)| (step, channel - VISION.1)).collect();
    vec![("pixel, brighter".to_string(), rises), ("pixel, darker".to_string(), falls)]
}

/// Picture of a sample.
fn raster(scene: &RecordedScene, argument: &SceneArg, sample: u32) -> Panels {
    let recording = scene.recording(sample, Senses::BOTH);
    let class = scene.classes.get(recording.label as usize).cloned().unwrap_or_default();
    let (rises, falls) = recording.touch.iter().copied().partition(|&(_, channel)| channel % 2 == 1);
    let touch = vec![("taxel, rise".to_string(), rises), ("taxel, fall".to_string(), falls)];
    Panels {
        y_label: String::new(),
        title: format!("{}, sample {sample}: {class}", argument.spelled()),
        steps: recording.steps,
        timestep_ms: scene.timestep_ms,
        onset_ms: recording.onset_ms,
        panels: vec![
            Panel { label: "touch channel".to_string(), share: 0.45, content: Content::Spikes(TOUCH.1, touch) },
            Panel {
                label: "pooled pixel".to_string(),
                share: 0.55,
                content: Content::Spikes(VISION.1, by_polarity(recording.vision_planes)),
            },
        ],
    }
}

/// Facts of a recording for the report.
struct SampleFacts {
    label: u32,
    onset_ms: Option<f64>,
    marker_onsets: Option<MarkerOnsets>,
    spikes: [usize; 2],
    wire: Option<WireCounts>,
}

/// Warns of recordings of an earlier scene next to the new ones: a run on the folder would use them
/// as samples.
fn warn_of_other_recordings(folder: &Path, entries: &[SampleEntry]) {
    let written: BTreeSet<PathBuf> =
        entries.iter().flat_map(|entry| entry.files.values()).map(|file| folder.join(&file.value)).collect();
    for population in [TOUCH.0, VISION.0].map(|name| folder.join(name)) {
        let Ok(listed) = spikes::list_folder(&population) else { continue };
        let others: Vec<PathBuf> =
            listed.into_iter().map(|(_, _, file)| file).filter(|file| !written.contains(file)).collect();
        if let Some(first) = others.first() {
            let (folder, count, first) = (population.display(), others.len(), first.display());
            let what = format!("this scene did not write {count} of the recordings; the first is {first}");
            tracing::warn!("{folder}: {what}; --input {folder} would read them too: remove them");
        }
    }
}

/// Writes a sample's arrays of bytes, `[78, 2, T]` and `[63, 50, T]` or, by polarity, `[2, 63, 50,
/// T]`, and returns their names.
fn write_sample(
    folder: &write::Folder,
    sample: u32,
    recording: &Recording,
    by_polarity: bool,
) -> Result<[String; 2], Diagnostic> {
    let units = [camera::POOLED_HEIGHT as u64, camera::POOLED_WIDTH as u64];
    let (planes, vision) = match by_polarity {
        true => (vec![2], &recording.vision_planes),
        false => (Vec::new(), &recording.vision),
    };
    let shapes = [vec![2 * touch::TAXELS as u64, 2], [planes, units.to_vec()].concat()];
    let mut names = [TOUCH.0, VISION.0].map(|name| format!("{name}/sample_{sample}_label_{}.npy", recording.label));
    for ((name, shape), events) in names.iter_mut().zip(shapes).zip([&recording.touch, vision]) {
        let steps = recording.steps as usize;
        let mut bytes = vec![0; shape.iter().product::<u64>() as usize * steps];
        for &(step, channel) in events {
            bytes[channel as usize * steps + step as usize] = 1;
        }
        let shape = [shape, vec![steps as u64]].concat();
        folder.member(name, |out| npy::write(out, &shape, bytes.iter().copied()))?;
    }
    Ok(names)
}

fn data_set(scene: &RecordedScene, argument: &SceneArg, entries: Vec<SampleEntry>) -> DataSet {
    let labels: Vec<u32> = entries.iter().filter_map(|entry| entry.label).collect();
    let folds = if labels.len() >= FOLDS { stratified_folds(&labels, FOLDS, scene.seed) } else { Vec::new() };
    DataSet {
        name: scene.name.to_string(),
        populations: [TOUCH.0, VISION.0].map(|name| (name.to_string(), name.to_string())).into(),
        steps: Some(scene.steps),
        options: BTreeMap::new(),
        recordings: BTreeMap::new(),
        splits: Vec::new(),
        classes: scene.classes.clone(),
        samples: entries.into_iter().map(Spanned::from).collect(),
        folds: folds
            .into_iter()
            .map(|fold| Spanned::from(fold.into_iter().map(|sample| sample as u32).collect::<Vec<_>>()))
            .collect(),
        seed: Some(scene.seed),
        provenance: Some(format!("nsim {} scene, {}", env!("CARGO_PKG_VERSION"), argument.spelled())),
    }
}

fn report(scene: &RecordedScene, argument: &SceneArg, facts: &[SampleFacts], manifest: Option<PathBuf>) -> SceneReport {
    let cells = |samples: usize, channels: u32| samples as f64 * f64::from(channels) * f64::from(scene.steps);
    let class = |(label, name): (usize, String)| {
        let of: Vec<&SampleFacts> = facts.iter().filter(|fact| fact.label as usize == label).collect();
        let spikes = |sense: usize| of.iter().map(|fact| fact.spikes[sense] as u64).sum::<u64>();
        let mut onsets: Vec<f64> = of.iter().filter_map(|fact| fact.onset_ms).collect();
        onsets.sort_by(f64::total_cmp);
        let marker_onsets: Vec<MarkerOnsets> = of.iter().filter_map(|fact| fact.marker_onsets).collect();
        ClassSummary {
            name,
            samples: of.len(),
            touch_spikes: spikes(0),
            vision_spikes: spikes(1),
            touch_density: spikes(0) as f64 / cells(of.len(), TOUCH.1),
            vision_density: spikes(1) as f64 / cells(of.len(), VISION.1),
            by_markers: ByMarkers::new(&marker_onsets),
            onset_ms: match onsets[..] {
                [] => None,
                [first, ..] => Some(Onsets { first, median: onsets[onsets.len() / 2], last: onsets[onsets.len() - 1] }),
            },
        }
    };
    SceneReport {
        scene: argument.spelled(),
        seed: scene.seed,
        samples: facts.len(),
        steps: scene.steps,
        timestep_ms: scene.timestep_ms,
        classes: scene.classes.iter().cloned().enumerate().map(class).collect(),
        wire: facts.iter().filter_map(|fact| fact.wire).reduce(|mut sum, wire| {
            sum += wire;
            sum
        }),
        manifest: manifest.map(|path| path.display().to_string()),
    }
}
