//! Data-set manifests and the recordings that they name.
//!
//! Input: a `.ron` with a [`DataSet`]. Output: a [`Manifest`] with consistent labels, folds and
//! files. It reads the spikes of a population, for one sample or all, and lists the training and
//! test samples of each fold. Lists of samples in text files have the form of clear-nus/VT_SNN's
//! `train_80_20_k.txt` and `test_80_20_k.txt`: rows of a sample's number, from 0, and its label.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rayon::prelude::*;

use super::csv::lines;
use super::options::EventOptions;
use super::population::{InputSpec, PopulationSpikes};
use super::recordings::{Request, read, read_sample};
use nsim_files::dataset::DataSet;
use nsim_files::text::read_text;
use nsim_files::text::sibling_path;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::spanned::{Spanned, parse};
use nsim_ir::stimulus::pairs;

/// A consistent manifest.
#[derive(Debug, Clone)]
pub struct Manifest {
    set: DataSet,
    source: SourceText,
    /// Options by the names of the recordings.
    options: BTreeMap<String, EventOptions>,
}

/// Training and test samples of a fold of a cross-validation.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Split {
    /// Samples to train on.
    pub train: Vec<u32>,
    /// Samples to test on, disjoint from `train`.
    pub test: Vec<u32>,
}

/// Samples of each fold, and labels by sample from the lists.
type FoldsAndLabels = (Vec<Split>, BTreeMap<u32, u32>);

/// Reads a manifest, but not its recordings.
///
/// # Errors
/// `dataset.syntax`; `dataset.samples`, `dataset.files`, `dataset.label`, `dataset.onset`,
/// `dataset.fold`, `input.option`; `io.*`.
pub fn read_manifest(path: &Path) -> Result<Manifest> {
    from_source(read_text(path)?)
}

/// A manifest from its text; its recordings are in the folder of `source`.
/// Errors are those of [`read_manifest`].
pub fn from_source(source: SourceText) -> Result<Manifest> {
    let set: DataSet = parse(&source, "dataset.syntax")?;
    let whole = |code, message: String| Diagnostic::new(code, message).in_file(source.path());
    let at = |code, message: String, span| Diagnostic::new(code, message).at(&source, span);
    if set.populations.is_empty() {
        return Err(whole("dataset.files", "the data set has no population".into()));
    }
    match (set.samples.first(), set.recordings.values().next()) {
        (None, None) => return Err(whole("dataset.samples", "the data set has no sample".into())),
        (Some(sample), Some(_)) => {
            let message = "a data set has either recordings of all samples or a file for each sample, not both";
            return Err(at("dataset.samples", message.into(), sample.span));
        }
        (None, Some(_)) => {
            if let Some(name) = set.populations.keys().find(|name| !set.recordings.contains_key(*name)) {
                return Err(whole("dataset.files", format!("there is no recording for '{name}'")));
            }
        }
        (Some(_), None) => {}
    }
    if let (Some(fold), Some(_)) = (set.folds.first(), set.splits.first()) {
        let message = "the samples of folds are listed either here or in the text files of splits, not in both";
        return Err(at("dataset.fold", message.into(), fold.span));
    }
    let unlisted = |name: &str, value: &Spanned<String>| {
        at("dataset.files", format!("'{name}' is not listed among the populations"), value.span)
    };
    let mut others = set.recordings.iter().chain(&set.options).filter(|(name, _)| !set.populations.contains_key(*name));
    if let Some((name, value)) = others.next() {
        return Err(unlisted(name, value));
    }
    let mut options = BTreeMap::new();
    for (name, text) in &set.options {
        let parsed = pairs(text).and_then(|pairs| EventOptions::parse(&pairs));
        options.insert(name.clone(), parsed.map_err(|problem| problem.at(&source, text.span))?);
    }
    for (index, sample) in set.samples.iter().enumerate() {
        if let Some(name) = set.populations.keys().find(|name| !sample.files.contains_key(*name)) {
            return Err(at("dataset.files", format!("sample {index} has no file for '{name}'"), sample.span));
        }
        if let Some((name, file)) = sample.files.iter().find(|(name, _)| !set.populations.contains_key(*name)) {
            return Err(unlisted(name, file));
        }
        if let Some(label) =
            sample.label.filter(|&label| !set.classes.is_empty() && label as usize >= set.classes.len())
        {
            let message = format!("label {label} of sample {index} is outside the {} classes", set.classes.len());
            return Err(at("dataset.label", message, sample.span));
        }
    }
    for (index, sample) in set.samples.iter().enumerate() {
        if let Some(onset) = sample.onset_ms.filter(|onset| !onset.is_finite() || *onset < 0.0) {
            let message = format!("onset {onset} ms of sample {index} is not a time from the start of the sample");
            return Err(at("dataset.onset", message, sample.span));
        }
    }
    for (index, fold) in set.folds.iter().enumerate() {
        let mut seen = vec![false; set.samples.len()];
        for &sample in &fold.value {
            let message = match seen.get_mut(sample as usize) {
                Some(seen) if !*seen => {
                    *seen = true;
                    continue;
                }
                Some(_) => format!("fold {index} names sample {sample} twice"),
                // The number of samples is unknown before the recordings are read.
                None if set.samples.is_empty() => continue,
                None => format!("fold {index} names sample {sample} of {}", set.samples.len()),
            };
            return Err(at("dataset.fold", message, fold.span));
        }
    }
    Ok(Manifest { set, source, options })
}

impl Manifest {
    /// The content of the manifest.
    pub fn set(&self) -> &DataSet {
        &self.set
    }

    /// Its text, for messages.
    pub fn source(&self) -> &SourceText {
        &self.source
    }

    /// The name in `files` of the recordings for a population of the model.
    ///
    /// # Errors
    /// `dataset.population` with the populations of the data set.
    pub fn recording_name(&self, population: &str) -> Result<&str> {
        let mut populations = self.set.populations.iter();
        let Some((name, _)) = populations.find(|(_, for_population)| *for_population == population) else {
            let known: Vec<&str> = self.set.populations.values().map(String::as_str).collect();
            let message = format!("the data set has no recordings for population '{population}'");
            return Err(Diagnostic::new("dataset.population", message)
                .help(format!("it has recordings for: {}", known.join(", ")))
                .in_file(self.source.path()));
        };
        Ok(name)
    }

    /// The samples of each fold, and the labels in the lists.
    fn folds_and_labels(&self, samples: usize) -> Result<FoldsAndLabels> {
        let mut labels = BTreeMap::new();
        if self.set.splits.is_empty() {
            let all = 0..samples as u32;
            let splits = self.set.folds.iter().map(|fold| {
                let tested: BTreeSet<u32> = fold.value.iter().copied().collect();
                let train = all.clone().filter(|sample| !tested.contains(sample)).collect();
                Split { train, test: fold.value.clone() }
            });
            return Ok((splits.collect(), labels));
        }
        let mut splits = Vec::new();
        for entry in &self.set.splits {
            let mut read = |name: &str, other: &BTreeSet<u32>| {
                let text = read_text(&sibling_path(self.source.path(), name))
                    .map_err(|p| self.point_at(entry.span, name, p))?;
                parse_sample_list(&text, other, &mut labels)
            };
            let train = read(&entry.train, &BTreeSet::new())?;
            let test = read(&entry.test, &train.iter().copied().collect())?;
            splits.push(Split { train, test });
        }
        Ok((splits, labels))
    }

    /// Number of folds.
    pub fn folds(&self) -> usize {
        self.set.folds.len().max(self.set.splits.len())
    }

    /// The training and test samples of each fold, of `samples` samples.
    ///
    /// # Errors
    /// `dataset.split` for a row of a list, `dataset.label` where two lists disagree; `io.*`.
    pub fn splits(&self, samples: usize) -> Result<Vec<Split>> {
        Ok(self.folds_and_labels(samples)?.0)
    }

    /// The result of `read` on a file for a population.
    fn read_recording<T>(
        &self,
        name: &str,
        file: &Spanned<String>,
        population: &str,
        expected: &InputSpec,
        read: impl Fn(&Path, Request<'_>) -> Result<T>,
    ) -> Result<T> {
        let path = sibling_path(self.source.path(), &file.value);
        let options = &self.options.get(name).cloned().unwrap_or_default();
        read(&path, Request { population, expected, options })
            .map_err(|problem| self.point_at(file.span, &file.value, problem))
    }

    /// The spikes of one sample for a population, when samples have separate files.
    ///
    /// # Errors
    /// `dataset.population`, `dataset.samples` for a sample that does not exist, `dataset.steps`;
    /// problems with the file at the place that names it.
    pub fn read_sample(&self, population: &str, expected: &InputSpec, sample: usize) -> Result<PopulationSpikes> {
        let name = self.recording_name(population)?;
        let Some(entry) = self.set.samples.get(sample) else {
            let message = format!("there is no sample {sample}; the data set has {}", self.set.samples.len());
            return Err(Diagnostic::new("dataset.samples", message).in_file(self.source.path()));
        };
        let file = &entry.value.files[name];
        let mut spikes = self.read_recording(name, file, population, expected, read_sample)?;
        spikes.label = entry.label.or(spikes.label);
        self.check_steps(&mut spikes, file)?;
        Ok(spikes)
    }

    /// Checks the number of timesteps of a sample, or sets it for a `.csv`.
    fn check_steps(&self, spikes: &mut PopulationSpikes, file: &Spanned<String>) -> Result<()> {
        match self.set.steps {
            // The rows of a .csv do not contain silence at the end; the manifest has the length.
            Some(steps) if spikes.units.is_none() && spikes.steps < steps => spikes.steps = steps,
            Some(steps) if spikes.steps != steps => {
                let message = format!("{} has {} timesteps, the data set {steps}", file.value, spikes.steps);
                return Err(Diagnostic::new("dataset.steps", message).at(&self.source, file.span));
            }
            _ => {}
        }
        Ok(())
    }

    /// The spikes of every sample for a population.
    ///
    /// # Errors
    /// As [`Manifest::read_sample`] and [`Manifest::splits`]; `dataset.samples` for a list with
    /// absent samples.
    pub fn read(&self, population: &str, expected: &InputSpec) -> Result<Vec<PopulationSpikes>> {
        let mut all = if self.set.recordings.is_empty() {
            let read: Vec<_> = (0..self.set.samples.len())
                .into_par_iter()
                .map(|sample| self.read_sample(population, expected, sample))
                .collect();
            // Independent of threads, the first problem in the order of samples is reported.
            read.into_iter().collect::<Result<Vec<_>, _>>()?
        } else {
            let name = self.recording_name(population)?;
            let file = &self.set.recordings[name];
            let mut all = self.read_recording(name, file, population, expected, read)?;
            for spikes in &mut all {
                self.check_steps(spikes, file)?;
            }
            all
        };
        let (splits, labels) = self.folds_and_labels(all.len())?;
        let most = splits.iter().flat_map(|split| split.train.iter().chain(&split.test)).max();
        if let Some(sample) = most.filter(|&&sample| sample as usize >= all.len()) {
            let message = format!("a fold names sample {sample}; there are {}", all.len());
            return Err(Diagnostic::new("dataset.samples", message).in_file(self.source.path()));
        }
        for (sample, label) in labels {
            let known = &mut all[sample as usize].label;
            if known.is_some_and(|known| known != label) {
                let message = format!("sample {sample} has label {label} in a list of a split and another elsewhere");
                return Err(Diagnostic::new("dataset.label", message).in_file(self.source.path()));
            }
            *known = Some(label);
        }
        let classes = self.set.classes.len();
        let beyond = all.iter().position(|spikes| spikes.label.is_some_and(|label| label as usize >= classes));
        if let Some(sample) = beyond.filter(|_| classes > 0) {
            let message = format!("the label of sample {sample} is outside the {classes} classes");
            return Err(Diagnostic::new("dataset.label", message).in_file(self.source.path()));
        }
        Ok(all)
    }

    /// The spikes of every sample, when the data set has only one population.
    ///
    /// # Errors
    /// As [`Manifest::read`]; `dataset.population` when there are several.
    pub fn read_only(&self, expected: &InputSpec) -> Result<Vec<PopulationSpikes>> {
        let mut populations = self.set.populations.values();
        match (populations.next(), populations.next()) {
            (Some(population), None) => self.read(population, expected),
            _ => Err(Diagnostic::new("dataset.population", "the data set has recordings for several populations")
                .in_file(self.source.path())),
        }
    }

    fn point_at(&self, span: Span, name: &str, mut problem: Diagnostic) -> Diagnostic {
        let position = problem.position().map_or(String::new(), |at| format!(":{}:{}", at.line, at.column));
        problem.message = format!("{name}{position}: {}", problem.message);
        problem.at(&self.source, span)
    }
}

/// A whole number, which NumPy writes in tables as 1.000e+00.
fn whole_number(text: &str) -> Option<u32> {
    let value: f64 = text.parse().ok()?;
    (value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value)).then_some(value as u32)
}

fn problem_of_row(code: &'static str, message: String) -> Diagnostic {
    Diagnostic::new(code, message).help("a row has a sample number, from 0, and a label")
}

/// The samples of a list of rows `sample label`, which must not contain samples of `other`.
fn parse_sample_list(source: &SourceText, other: &BTreeSet<u32>, labels: &mut BTreeMap<u32, u32>) -> Result<Vec<u32>> {
    let (mut samples, mut seen) = (Vec::new(), BTreeSet::new());
    for (start, line) in lines(source.text()) {
        let row = line.split('#').next().unwrap_or_default();
        let span = Span { start: start + row.len() - row.trim_start().len(), end: start + row.trim_end().len() };
        if row.trim().is_empty() {
            continue;
        }
        let [Some(sample), Some(label)] = *row.split_whitespace().map(whole_number).collect::<Vec<_>>() else {
            let message = format!("'{}' is not a sample number and a label", row.trim());
            return Err(problem_of_row("dataset.split", message).at(source, span));
        };
        if !seen.insert(sample) {
            return Err(problem_of_row("dataset.split", format!("sample {sample} is listed twice")).at(source, span));
        }
        if other.contains(&sample) {
            return Err(problem_of_row("dataset.split", format!("sample {sample} is also trained on")).at(source, span));
        }
        if let Some(before) = labels.insert(sample, label).filter(|before| *before != label) {
            return Err(problem_of_row(
                "dataset.label",
                format!("sample {sample} has label {label} here and {before} before"),
            )
            .at(source, span));
        }
        samples.push(sample);
    }
    if samples.is_empty() {
        return Err(Diagnostic::new("dataset.split", "the list names no sample").in_file(source.path()));
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_files::npy;

    const SET: &str = r#"DataSet(
    name: "two",
    populations: {"touch": "skin", "sight": "eye"},
    steps: 3,
    classes: ["a", "b"],
    samples: [
        (files: {"touch": "t0.npy", "sight": "s0.csv"}, label: 1),
        (files: {"touch": "t1.npy", "sight": "s0.csv"}),
    ],
    folds: [[0], [1]],
    seed: 5,
)"#;

    fn expected(units: u64) -> InputSpec {
        InputSpec { units, volume: None, dt_ms: 1.0, values: false }
    }

    fn load(text: &str) -> Result<Manifest> {
        from_source(SourceText::new("d.ron", text))
    }

    #[test]
    fn recordings_are_found_beside_the_manifest() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["t0.npy", "t1.npy"] {
            npy::write(std::fs::File::create(folder.path().join(name)).unwrap(), &[2, 3], [0, 0, 1, 0, 1, 0]).unwrap();
        }
        std::fs::write(folder.path().join("s0.csv"), "0,4\n").unwrap();
        let path = folder.path().join("d.ron");
        std::fs::write(&path, SET).unwrap();
        let manifest = read_manifest(&path).unwrap();
        let touch = manifest.read("skin", &expected(2)).unwrap();
        assert_eq!(touch.iter().map(|s| s.label).collect::<Vec<_>>(), [Some(1), None]);
        assert_eq!(touch[1].events, [(2, 0), (1, 1)]);
        let sight = manifest.read_sample("eye", &expected(5), 0).unwrap();
        assert_eq!((sight.steps, sight.events.clone()), (3, vec![(0, 4)]));
        let error = manifest.read_sample("eye", &expected(4), 0).unwrap_err();
        assert_eq!((error.code, error.position().unwrap().line), ("input.channel", 7));
        assert!(error.message.contains("s0.csv:1:1: channel 4"), "{error}");
        assert_eq!(manifest.read("hand", &expected(2)).unwrap_err().code, "dataset.population");
        assert_eq!(manifest.read_only(&expected(2)).unwrap_err().code, "dataset.population");
        std::fs::write(&path, SET.replace("steps: 3", "steps: 4")).unwrap();
        assert_eq!(read_manifest(&path).unwrap().read("skin", &expected(2)).unwrap_err().code, "dataset.steps");
    }

    #[test]
    fn a_manifest_agrees_with_itself() {
        let cases = [
            ("label: 1", "label: 2", "dataset.label", 7),
            ("\"touch\": \"t1.npy\", ", "", "dataset.files", 8),
            ("\"touch\": \"t1.npy\"", "\"touch\": \"t1.npy\", \"sound\": \"x\"", "dataset.files", 8),
            ("[1]]", "[2]]", "dataset.fold", 10),
            ("[1]]", "[1, 1]]", "dataset.fold", 10),
            ("label: 1", "label: 1, onset_ms: -1", "dataset.onset", 7),
            ("label: 1", "label: -1", "dataset.syntax", 7),
            ("seed", "sead", "dataset.syntax", 11),
        ];
        for (from, to, code, line) in cases {
            assert!(SET.contains(from));
            let error = load(&SET.replace(from, to)).unwrap_err();
            assert_eq!((error.code, error.position().unwrap().line), (code, line), "{error}");
        }
        let none = "DataSet(name: \"x\", populations: {\"a\": \"a\"}, samples: [])";
        assert_eq!(load(none).unwrap_err().code, "dataset.samples");
    }

    /// The form of VT_SNN's pipeline: one array for each sense, and lists of samples.
    #[test]
    fn arrays_of_all_samples_are_read_with_lists_of_samples() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let array = |name: &str, shape: &[u64], numbers: &[u8]| {
            npy::write(std::fs::File::create(at(name)).unwrap(), shape, numbers.iter().copied()).unwrap();
        };
        // Four samples of 3 taxels x 2 polarities x 1 step, and of 2 polarities x 1 x 3 pixels x 1
        // step.
        let bits = |row: u32| (0..6).map(move |bit| (row >> bit & 1) as u8);
        array("tact.npy", &[4, 3, 2, 1], &[1, 2, 4, 63].into_iter().flat_map(bits).collect::<Vec<_>>());
        array("vis.npy", &[4, 2, 1, 3, 1], &[1, 9, 16, 0].into_iter().flat_map(bits).collect::<Vec<_>>());
        let list = |name: &str, rows: &str| std::fs::write(at(name), rows).unwrap();
        list("train_80_20_1.txt", "0 1\n2 0\n");
        list("test_80_20_1.txt", "3.000e+00 1.0\n");
        list("train_80_20_2.txt", "2 0\n3 1 # the last\n");
        list("test_80_20_2.txt", "0 1\n\n");
        let set = r#"DataSet(
    name: "both",
    populations: {"touch": "skin", "sight": "eye"},
    options: {"sight": "polarity=merge"},
    recordings: {"touch": "tact.npy", "sight": "vis.npy"},
    classes: ["a", "b"],
    splits: [
        (train: "train_80_20_1.txt", test: "test_80_20_1.txt"),
        (train: "train_80_20_2.txt", test: "test_80_20_2.txt"),
    ],
)"#;
        let manifest = |text: &str| {
            std::fs::write(at("d.ron"), text).unwrap();
            read_manifest(&at("d.ron"))
        };
        let good = manifest(set).unwrap();
        let skin = good.read("skin", &expected(6)).unwrap();
        assert_eq!(skin.iter().map(|s| s.label).collect::<Vec<_>>(), [Some(1), None, Some(0), Some(1)]);
        assert_eq!((&skin[2].events[..], skin[3].events.len()), (&[(0, 2)][..], 6));
        let eye = good.read("eye", &expected(3)).unwrap();
        assert_eq!((&eye[1].events[..], &eye[2].events[..]), (&[(0, 0)][..], &[(0, 1)][..]));
        let split = |train: &[u32], test: &[u32]| Split { train: train.to_vec(), test: test.to_vec() };
        assert_eq!(good.splits(4).unwrap(), [split(&[0, 2], &[3]), split(&[2, 3], &[0])]);

        let wrong = |rows: &str| {
            list("test_80_20_2.txt", rows);
            let error = good.read("skin", &expected(6)).unwrap_err();
            (error.code, error.position().map(|at| (at.line, at.column)))
        };
        assert_eq!(wrong("0 1\n 1 x\n"), ("dataset.split", Some((2, 2))));
        assert_eq!(wrong("0 1\n0 1\n"), ("dataset.split", Some((2, 1))));
        assert_eq!(wrong("0 1 2\n"), ("dataset.split", Some((1, 1))));
        assert_eq!(wrong("3 1\n"), ("dataset.split", Some((1, 1))));
        assert_eq!(wrong("1 1\n0 0\n"), ("dataset.label", Some((2, 1))));
        assert_eq!(wrong("-1 1\n"), ("dataset.split", Some((1, 1))));
        assert_eq!(wrong(""), ("dataset.split", None));
        assert_eq!(wrong("9 1\n"), ("dataset.samples", None));
        assert_eq!(wrong("1 2\n"), ("dataset.label", None));
        std::fs::remove_file(at("test_80_20_2.txt")).unwrap();
        let error = good.read("skin", &expected(6)).unwrap_err();
        assert_eq!((error.code, error.position().unwrap().line), ("io.missing", 9));

        let cases = [
            ("\"touch\": \"tact.npy\", ", "", "dataset.files"),
            ("\"sight\": \"polarity=merge\"", "\"sigh\": \"\"", "dataset.files"),
            ("polarity=merge", "polarity=both&x=1", "input.option"),
            ("polarity=merge", "polarity", "input.scene-syntax"),
            ("splits", "folds: [[0]], splits", "dataset.fold"),
            ("splits", "samples: [(files: {})], splits", "dataset.samples"),
        ];
        for (from, to, code) in cases {
            assert_eq!(manifest(&set.replace(from, to)).unwrap_err().code, code, "{to}");
        }
        let lists = set.find("    splits").unwrap();
        let folds = manifest(&format!("{}    folds: [[1, 3]])", &set[..lists])).unwrap();
        assert_eq!(folds.splits(4).unwrap(), [split(&[0, 2], &[1, 3])]);
        let beyond = manifest(&format!("{}    folds: [[4]])", &set[..lists])).unwrap();
        assert_eq!(beyond.read("skin", &expected(6)).unwrap_err().code, "dataset.samples");
    }
}
