//! Recordings for one input population, from any kind of source.
//!
//! Comes in: a path and how many channels the population has. Goes out: the spikes of each sample as plain
//! (step, channel) pairs with the label that the source gives. Which population a source is for, and whether all have as
//! many samples, is for those who put a stimulus together. Folders and `.npy` are read here, `.csv` in
//! [`super::event_csv`], recordings of events in [`super::events`], manifests in [`super::dataset`].

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use super::events::{self, EventFormat, EventOptions, Expected, Polarity, nir_data};
use super::foreign::hdf5;
use super::text::{MOST_ARRAY, is_standard_stream, read_bytes};
use super::{dataset, event_csv, npy};
use crate::base::diagnostic::Diagnostic;

/// The most timesteps of a sample: engines hold a number for each.
pub const MOST_STEPS: u32 = 1 << 24;
/// The most spikes of a sample: each takes eight bytes.
pub const MOST_EVENTS: usize = 1 << 27;

/// The spikes of one sample on the channels of one population.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PopulationSpikes {
    /// How many channels the source has, if it says so.
    pub units: Option<u64>,
    /// Timesteps.
    pub steps: u32,
    /// The class that the sample shows, when known.
    pub label: Option<u32>,
    /// (step, channel) of each spike, in the order of the source.
    pub events: Vec<(u32, u32)>,
    /// The file, for messages.
    pub name: String,
}

/// Reads a source for a population of `units` channels.
///
/// # Errors
/// `input.kind` for an unknown kind of file; `input.*`, `npy.*`, `io.*` for what is wrong with a known one.
pub fn read_source(path: &Path, units: u64) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    read_spikes(path, "", &Expected { units, volume: None, dt_ms: 1.0 }, &EventOptions::default())
}

/// Reads a source for a population, with the options that stand after its `?`. Options other than `polarity` are for
/// recordings of events; an array takes `polarity` along the one axis of length 2 before time.
///
/// # Errors
/// As [`read_source`]; `input.option` for an option that the source does not take.
pub fn read_spikes(
    path: &Path,
    population: &str,
    expected: &Expected,
    options: &EventOptions,
) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    if path.is_dir() {
        return read_folder(path, population, expected, options);
    }
    if holds_events(path) {
        return read_events(path, population, expected, options);
    }
    let units = expected.units;
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    if extension.as_deref() == Some("npy") {
        return of_array(&npy::open(path)?, units, polarity_of(path, options)?);
    }
    if *options != EventOptions::default() {
        return Err(no_options(path));
    }
    match extension.as_deref() {
        Some("csv") => event_csv::read(path, units),
        Some("ron") => dataset::read_manifest(path)?.read_only(expected),
        // What comes through a pipe has no name to go by, but arrays say what they are.
        None if is_standard_stream(path) => {
            let bytes = read_bytes(path, MOST_ARRAY)?;
            match bytes.starts_with(npy::MAGIC) {
                true => of_array(&npy::Array::from_bytes(path, bytes)?, units, Polarity::Both),
                false => event_csv::of_bytes(path, bytes, units),
            }
        }
        _ if !path.exists() => Err(Diagnostic::new("io.missing", "there is no such file").in_file(path)),
        other => Err(Diagnostic::new(
            "input.kind",
            match other {
                Some(other) => format!("files of the kind .{other} are not read as spikes"),
                None => "a file without an extension is not read as spikes".to_string(),
            },
        )
        .help(
            "read are: .npy ([channels.., T] or [samples, channels.., T]), .csv (timestep,channel), recordings (.bin, .bs1, \
             .bs2, .dat, .raw, .aedat4, .tact, NIR data), a .ron data-set manifest, and a folder of \
             sample_<i>_label_<c>.npy or of recordings",
        )
        .in_file(path)),
    }
}

fn is_nir(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| ["nir", "h5", "hdf5"].iter().any(|known| extension.eq_ignore_ascii_case(known)))
}

/// Whether a file holds events, which options can turn into spikes in more than one way.
#[must_use]
pub fn holds_events(path: &Path) -> bool {
    EventFormat::of(path).is_some() || is_nir(path)
}

/// Reads a recording of events for a population, and says on stderr what was left out.
///
/// # Errors
/// `input.kind` for a file of another kind, `input.*`, `hdf5.*`, `io.*`.
pub fn read_events(
    path: &Path,
    population: &str,
    expected: &Expected,
    options: &EventOptions,
) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    if let Some(format) = EventFormat::of(path) {
        let (spikes, counts) = events::read(path, format, expected, options)?;
        events::report(path, &counts);
        return Ok(vec![spikes]);
    }
    if !is_nir(path) {
        return Err(no_options(path));
    }
    let bytes = read_bytes(path, MOST_ARRAY)?;
    let tree = hdf5::tree(path, bytes)?;
    if !nir_data::is_data(&tree) {
        return Err(Diagnostic::new("input.kind", "this is no file of NIR data")
            .in_file(path)
            .help("nir.write_data makes one; a NIR graph is a model, not a recording"));
    }
    let in_file = |problem: Diagnostic| if problem.place.is_some() { problem } else { problem.in_file(path) };
    nir_data::read(&tree, path, population, expected, options).map_err(in_file)
}

fn product(axes: &[usize]) -> Option<u64> {
    axes.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis as u64))
}

fn no_options(path: &Path) -> Diagnostic {
    Diagnostic::new(
        "input.kind",
        "options after '?' are for recordings of events, for arrays (polarity) and for scenes",
    )
    .help("recordings are .bin, .bs1, .bs2, .dat, .raw, .aedat4, .tact and NIR data (.nir)")
    .in_file(path)
}

/// The only option that an array takes.
fn polarity_of(path: &Path, options: &EventOptions) -> Result<Polarity, Diagnostic> {
    let polarity = options.polarity;
    if *options == (EventOptions { polarity, ..EventOptions::default() }) {
        return Ok(polarity);
    }
    Err(Diagnostic::new("input.option", "an array has timesteps already: polarity is the only option that it takes")
        .in_file(path))
}

/// The axes that a polarity leaves, and how an index along the channel axes becomes one along what is left.
#[derive(Clone, Copy)]
struct Merging {
    polarity: Polarity,
    /// Channels behind the axis of polarities.
    inner: usize,
}

impl Merging {
    /// The channel, or none for a polarity that is left out. Index 1 of the axis is a rise.
    fn channel(self, flat: usize) -> Option<usize> {
        let on = (flat / self.inner) % 2 == 1;
        let kept = match self.polarity {
            Polarity::Both => return Some(flat),
            Polarity::Merge => true,
            Polarity::On => on,
            Polarity::Off => !on,
        };
        kept.then(|| flat / (2 * self.inner) * self.inner + flat % self.inner)
    }

    /// For channel axes that hold `units` channels once the polarity is done with; none when they do not.
    ///
    /// # Errors
    /// What is wrong, when there are several axes that could be the polarity's.
    fn of(polarity: Polarity, axes: &[usize], units: u64) -> Result<Option<Merging>, String> {
        let channels = product(axes);
        if polarity == Polarity::Both {
            return Ok((channels == Some(units)).then_some(Merging { polarity, inner: 1 }));
        }
        if channels != units.checked_mul(2) {
            return Ok(None);
        }
        let mut pairs = (0..axes.len()).filter(|&axis| axes[axis] == 2);
        match (pairs.next(), pairs.next()) {
            (Some(axis), None) => Ok(Some(Merging { polarity, inner: axes[axis + 1..].iter().product() })),
            (None, _) => Ok(None),
            _ => Err(format!("several of the axes {axes:?} before time have length 2: which is the polarity?")),
        }
    }
}

/// An array `[channels.., T]` or `[samples, channels.., T]`; a number other than zero is a spike.
fn of_array(array: &npy::Array, units: u64, polarity: Polarity) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    let (path, shape) = (array.path(), array.shape());
    let wrong = |message: String| Diagnostic::new("input.shape", message).in_file(path);
    let Some((&steps, leading)) = shape.split_last() else {
        return Err(wrong("a single number is not a recording; [channels.., T] is".to_string()));
    };
    let one = Merging::of(polarity, leading, units).map_err(wrong)?;
    let each = match leading.split_first() {
        Some((_, channels)) if one.is_none() => Merging::of(polarity, channels, units).map_err(wrong)?,
        _ => None,
    };
    let (samples, merging) = match (one, each) {
        (Some(merging), _) => (1, merging),
        (None, Some(merging)) => (leading[0], merging),
        (None, None) => {
            let one = product(leading).unwrap_or(u64::MAX);
            let mut message = format!(
                "shape {shape:?} does not fit a population of {units} channels: read as one sample it has {one}"
            );
            if let Some(each) = leading.split_first().and_then(|(_, channels)| product(channels)) {
                message.push_str(&format!(", read as {} samples {each} in each", leading[0]));
            }
            let help = match polarity {
                Polarity::Both => "the last axis is time; the axes before it, in C order, are the channel",
                _ => "one polarity is left of two: before time there is one axis of length 2, and twice the channels",
            };
            return Err(wrong(message).help(help));
        }
    };
    if samples == 0 || steps == 0 {
        return Err(wrong(format!("shape {shape:?} holds no timestep")));
    }
    let steps = match u32::try_from(steps) {
        Ok(steps) if steps <= MOST_STEPS => steps,
        _ => {
            return Err(Diagnostic::new("input.too-long", format!("{steps} timesteps are more than {MOST_STEPS}"))
                .help("the last axis is time")
                .in_file(path));
        }
    };
    u32::try_from(units).map_err(|_| wrong(format!("{units} channels cannot be numbered")))?;
    let rows = units as usize * if polarity == Polarity::Both { 1 } else { 2 };
    let name = path.display().to_string();
    let mut recordings: Vec<PopulationSpikes> = (0..samples)
        .map(|_| PopulationSpikes { units: Some(units), steps, label: None, events: Vec::new(), name: name.clone() })
        .collect();
    array.each_non_zero(|index| {
        let (row, step) = (index / steps as usize, index % steps as usize);
        let (sample, Some(channel)) = (row / rows, merging.channel(row % rows)) else {
            return Ok(());
        };
        let events = &mut recordings[sample].events;
        if events.len() == MOST_EVENTS {
            return Err(too_many(path));
        }
        events.push((step as u32, channel as u32));
        Ok(())
    })?;
    if polarity == Polarity::Merge {
        for recording in &mut recordings {
            recording.events.sort_unstable();
            recording.events.dedup();
        }
    }
    Ok(recordings)
}

pub(super) fn too_many(path: &Path) -> Diagnostic {
    Diagnostic::new("input.too-many", format!("a sample has more than {MOST_EVENTS} spikes")).in_file(path)
}

/// Sample and label of `sample_<i>_label_<c>.npy`, or of a recording of events that is named so.
pub(super) fn sample_name(name: &str) -> Option<(u64, u32)> {
    let (stem, extension) = name.rsplit_once('.')?;
    let known = extension == "npy" || EventFormat::of(Path::new(name)).is_some();
    let (index, label) = stem.strip_prefix("sample_").filter(|_| known)?.split_once("_label_")?;
    let plain = |digits: &str| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    (plain(index) && plain(label)).then(|| Some((index.parse().ok()?, label.parse().ok()?)))?
}

/// A name as people sort them: numbers in it by their value.
fn by_numbers(name: &str) -> Vec<(Option<u128>, String)> {
    let mut parts: Vec<(Option<u128>, String)> = Vec::new();
    for run in name.chars().collect::<Vec<_>>().chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit()) {
        let text: String = run.iter().collect();
        parts.push((text.parse().ok(), text));
    }
    parts
}

/// Sample number, label and path of each recording of a folder, in order of their numbers. Recordings of events under
/// other names are samples too when no name has a number and a label: they come in order of their names (numbers in them
/// by value), without labels.
///
/// # Errors
/// `input.folder` when there is none, or two have the same number; `io.*`.
pub fn list_folder(folder: &Path) -> Result<Vec<(u64, Option<u32>, std::path::PathBuf)>, Diagnostic> {
    let unreadable =
        |error: std::io::Error| Diagnostic::new("io.read", format!("cannot be read: {error}")).in_file(folder);
    let mut found = BTreeMap::new();
    let mut others = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        match sample_name(&name) {
            Some((index, label)) => {
                if found.insert(index, (Some(label), entry.path())).is_some() {
                    return Err(Diagnostic::new("input.folder", format!("two files are sample {index}"))
                        .help("each sample has one file, sample_<i>_label_<c>.npy")
                        .in_file(folder));
                }
            }
            None => others.push((name, entry.path())),
        }
    }
    if found.is_empty() {
        let mut events: Vec<_> =
            others.iter().filter(|(_, path)| EventFormat::of(path).is_some() && path.is_file()).collect();
        events.sort_by_cached_key(|(name, _)| by_numbers(name));
        found = events.iter().zip(0..).map(|((_, path), index)| (index, (None, path.clone()))).collect();
    }
    if found.is_empty() {
        others.sort();
        let mut missing =
            Diagnostic::new("input.folder", "the folder holds no sample_<i>_label_<c>.npy and no recording of events")
                .in_file(folder);
        let inner: Vec<&str> =
            others.iter().filter(|(_, path)| path.is_dir()).map(|(name, _)| name.as_str()).take(8).collect();
        missing.help = if others.iter().any(|(name, _)| name == "dataset.ron") {
            Some(format!("it holds a manifest: give {}", folder.join("dataset.ron").display()))
        } else if inner.is_empty() {
            Some(format!("it holds {} other files", others.len()))
        } else {
            Some(format!("it holds the folders {}; give one of them", inner.join(", ")))
        };
        return Err(missing);
    }
    Ok(found.into_iter().map(|(index, (label, path))| (index, label, path)).collect())
}

/// Reads a folder of `sample_<i>_label_<c>.npy` or of recordings of events; other files are left alone.
fn read_folder(
    folder: &Path,
    population: &str,
    expected: &Expected,
    options: &EventOptions,
) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    let read: Vec<_> = list_folder(folder)?
        .into_par_iter()
        .map(|(_, label, path)| {
            let mut recording = one_sample(&path, population, expected, options)?;
            recording.label = label;
            Ok(recording)
        })
        .collect();
    // The first problem in order of the samples, whichever thread met one first.
    read.into_iter().collect()
}

/// Reads a source that holds exactly one sample.
pub(super) fn one_sample(
    path: &Path,
    population: &str,
    expected: &Expected,
    options: &EventOptions,
) -> Result<PopulationSpikes, Diagnostic> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    if !(matches!(extension.as_deref(), Some("npy" | "csv")) || holds_events(path)) {
        return Err(Diagnostic::new(
            "input.kind",
            "a sample of a data set is a .npy or a .csv file, or a recording of events",
        )
        .in_file(path));
    }
    let mut recordings = read_spikes(path, population, expected, options)?;
    match (recordings.pop(), recordings.len()) {
        (Some(recording), 0) => Ok(recording),
        (_, rest) => {
            Err(Diagnostic::new("input.shape", format!("one sample is expected; the file holds {}", rest + 1))
                .in_file(path))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(folder: &Path, name: &str, shape: &[u64], numbers: &[u8]) -> std::path::PathBuf {
        let path = folder.join(name);
        npy::write_u8(std::fs::File::create(&path).unwrap(), shape, numbers.iter().copied()).unwrap();
        path
    }

    #[test]
    fn both_layouts_of_an_array_are_read() {
        let folder = tempfile::tempdir().unwrap();
        // Two samples, 1 x 2 channels, three steps.
        let path = array(folder.path(), "a.npy", &[2, 1, 2, 3], &[0, 1, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0]);
        let samples = read_source(&path, 2).unwrap();
        assert_eq!(samples.iter().map(|s| s.events.clone()).collect::<Vec<_>>(), [vec![(1, 0), (2, 1)], vec![(0, 0)]]);
        assert!(samples.iter().all(|s| (s.steps, s.units, s.label) == (3, Some(2), None)));
        let sample = read_source(&path, 4).unwrap();
        assert_eq!((sample.len(), &sample[0].events[..]), (1, &[(1, 0), (2, 1), (0, 2)][..]));
        let error = read_source(&path, 3).unwrap_err();
        assert_eq!(error.code, "input.shape");
        assert!(error.message.contains("as one sample it has 4, read as 2 samples 2 in each"), "{error}");
        let line = array(folder.path(), "b.npy", &[3], &[0, 1, 0]);
        assert_eq!(read_source(&line, 1).unwrap()[0].events, [(1, 0)]);
        for (shape, units) in [(&[2, 0][..], 2), (&[], 1)] {
            let path = array(folder.path(), "c.npy", shape, &vec![0; shape.iter().product::<u64>() as usize]);
            assert!(read_source(&path, units).unwrap_err().code.ends_with(".shape"));
        }
        let long = array(folder.path(), "d.npy", &[1, (1 << 24) + 1], &vec![0; (1 << 24) + 1]);
        assert_eq!(read_source(&long, 1).unwrap_err().code, "input.too-long");
    }

    #[test]
    fn a_folder_is_read_in_order_of_its_numbers() {
        let folder = tempfile::tempdir().unwrap();
        for (i, label) in [(10, 3), (2, 1), (0, 0)] {
            array(folder.path(), &format!("sample_{i}_label_{label}.npy"), &[1, 1], &[1]);
        }
        std::fs::write(folder.path().join("README.md"), "x").unwrap();
        std::fs::write(folder.path().join("sample_x_label_1.npy"), "x").unwrap();
        let labels: Vec<_> = read_source(folder.path(), 1).unwrap().iter().map(|s| s.label).collect();
        assert_eq!(labels, [Some(0), Some(1), Some(3)]);
        array(folder.path(), "sample_02_label_5.npy", &[1, 1], &[1]);
        assert_eq!(read_source(folder.path(), 1).unwrap_err().code, "input.folder");
        let outer = tempfile::tempdir().unwrap();
        std::fs::create_dir(outer.path().join("train")).unwrap();
        let error = read_source(outer.path(), 1).unwrap_err();
        assert!(error.code == "input.folder" && error.help.unwrap().contains("train"), "{}", error.message);
    }

    fn read_as(path: &Path, units: u64, options: &str) -> Result<Vec<PopulationSpikes>, Diagnostic> {
        let options = EventOptions::parse(&crate::desc::stimulus::pairs(options)?)?;
        read_spikes(path, "", &Expected { units, volume: None, dt_ms: 1.0 }, &options)
    }

    /// [N, taxels, 2, T] and [N, 2, height, width, T], as VT_SNN leaves them behind, against loops over all axes.
    #[test]
    fn the_polarities_of_an_array_merge_wherever_their_axis_is() {
        let folder = tempfile::tempdir().unwrap();
        let (n, outer, inner, steps) = (3u32, 5u32, 4u32, 6u32);
        // Either of the two, by the sizes before and behind the polarity.
        for (shape, before, behind) in
            [(vec![n, outer, 2, steps], outer, 1), (vec![n, 2, outer, inner, steps], 1, outer * inner)]
        {
            let size = shape.iter().product::<u32>();
            let numbers: Vec<u8> =
                (0..size).map(|i| u8::from(crate::base::rng::unit(3, 0, u64::from(i)) < 0.3)).collect();
            let shape: Vec<u64> = shape.into_iter().map(u64::from).collect();
            let path = array(folder.path(), &format!("{behind}.npy"), &shape, &numbers);
            for (options, wanted) in
                [("polarity=merge", [true, true]), ("polarity=on", [false, true]), ("polarity=off", [true, false])]
            {
                let read = read_as(&path, u64::from(before * behind), options).unwrap();
                assert_eq!(read.len(), n as usize);
                for (sample, read) in (0..n).zip(read) {
                    let mut events = Vec::new();
                    for (a, b, t) in
                        (0..before).flat_map(|a| (0..behind).flat_map(move |b| (0..steps).map(move |t| (a, b, t))))
                    {
                        let spike = |p: u32| {
                            numbers[((((sample * before + a) * 2 + p) * behind + b) * steps + t) as usize] != 0
                        };
                        if (0..2).any(|p| wanted[p as usize] && spike(p)) {
                            events.push((t, a * behind + b));
                        }
                    }
                    let mut got = read.events;
                    got.sort_unstable();
                    events.sort_unstable();
                    assert_eq!(got, events, "{options}");
                }
            }
            assert_eq!(read_as(&path, u64::from(2 * before * behind), "").unwrap().len(), n as usize);
            assert_eq!(read_as(&path, 7, "polarity=merge").unwrap_err().code, "input.shape");
            assert_eq!(read_as(&path, 20, "polarity=merge&least=2").unwrap_err().code, "input.option");
        }
        let twice = array(folder.path(), "t.npy", &[2, 2, 3, 1], &[0; 12]);
        assert!(read_as(&twice, 6, "polarity=merge").unwrap_err().message.contains("which is the polarity"));
    }

    #[test]
    fn a_folder_of_recordings_is_read_by_label_or_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("named");
        std::fs::create_dir(&named).unwrap();
        for (name, rows) in [("cup_10_2.tact", "1 1 0.0005\n"), ("cup_2_10.tact", "0 18 0.0010\n1 80 0.0031\n")] {
            std::fs::write(named.join(name), rows).unwrap();
        }
        let read = read_as(&named, 156, "steps=4").unwrap();
        // cup_2 comes before cup_10; cell 18 is taxel 16, cell 80 taxel 77.
        assert_eq!(read.iter().map(|s| s.label).collect::<Vec<_>>(), [None, None]);
        assert_eq!((&read[0].events[..], &read[1].events[..]), (&[(1, 32), (3, 155)][..], &[(0, 1)][..]));
        let merged = read_as(&named, 78, "steps=2&bin_ms=2&polarity=merge").unwrap();
        assert_eq!((merged[0].steps, &merged[0].events[..]), (2, &[(0, 16), (1, 77)][..]));
        std::fs::write(named.join("sample_3_label_1.tact"), "1 1 0.001\n").unwrap();
        let read = read_as(&named, 156, "steps=4").unwrap();
        assert_eq!((read.len(), read[0].label), (1, Some(1)));
        std::fs::write(named.join("sample_4_label_1.tact"), "1 1 0.001\n2 1 0.001\n").unwrap();
        let error = read_as(&named, 156, "steps=4").unwrap_err();
        assert!(error.message.contains("row 2") && error.file().unwrap().ends_with("sample_4_label_1.tact"), "{error}");
    }

    #[test]
    fn other_kinds_of_files_are_answered_with_the_known_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.avi");
        assert_eq!(read_source(&path, 1).unwrap_err().code, "io.missing");
        std::fs::write(&path, "x").unwrap();
        let error = read_source(&path, 1).unwrap_err();
        assert!(error.code == "input.kind" && error.help.unwrap().contains(".csv"));
    }
}
