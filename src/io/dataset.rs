//! Data-set manifests and the recordings that they name.
//!
//! Comes in: a `.ron` with a [`DataSet`]. Goes out: a [`Manifest`] whose labels, folds and files agree with each other,
//! and from it the spikes of one population, sample by sample or all at once.

use std::path::Path;

use rayon::prelude::*;

use super::model::beside;
use super::stimulus::{PopulationSpikes, one_sample};
use super::text::read_text;
use crate::base::diagnostic::{Diagnostic, SourceText, Span};
use crate::desc::dataset::DataSet;
use crate::desc::spanned::parse;

/// A manifest that agrees with itself.
#[derive(Debug, Clone)]
pub struct Manifest {
    set: DataSet,
    source: SourceText,
}

/// Reads a manifest; the recordings stay where they are.
///
/// # Errors
/// `dataset.syntax`; `dataset.samples`, `dataset.files`, `dataset.label`, `dataset.onset`, `dataset.fold`; `io.*`.
pub fn read_manifest(path: &Path) -> Result<Manifest, Diagnostic> {
    manifest(read_text(path)?)
}

/// A manifest from its text; recordings are looked for beside the path of `source`.
///
/// # Errors
/// As [`read_manifest`].
pub fn manifest(source: SourceText) -> Result<Manifest, Diagnostic> {
    let set: DataSet = parse(&source, "dataset.syntax")?;
    let whole = |code, message: String| Diagnostic::new(code, message).in_file(source.path());
    if set.samples.is_empty() {
        return Err(whole("dataset.samples", "the data set has no sample".into()));
    }
    if set.populations.is_empty() {
        return Err(whole("dataset.files", "the data set has no population".into()));
    }
    for (index, sample) in set.samples.iter().enumerate() {
        let at = |code, message: String| Diagnostic::new(code, message).at(&source, sample.span);
        if let Some(name) = set.populations.keys().find(|name| !sample.files.contains_key(*name)) {
            return Err(at("dataset.files", format!("sample {index} has no file for '{name}'")));
        }
        if let Some((name, file)) = sample.files.iter().find(|(name, _)| !set.populations.contains_key(*name)) {
            return Err(Diagnostic::new("dataset.files", format!("'{name}' is not listed among the populations"))
                .at(&source, file.span));
        }
        if let Some(label) =
            sample.label.filter(|&label| !set.classes.is_empty() && label as usize >= set.classes.len())
        {
            let message = format!("label {label} of sample {index} is outside the {} classes", set.classes.len());
            return Err(at("dataset.label", message));
        }
    }
    for (index, sample) in set.samples.iter().enumerate() {
        if let Some(onset) = sample.onset_ms.filter(|onset| !onset.is_finite() || *onset < 0.0) {
            let message = format!("onset {onset} ms of sample {index} is no time from the start of the sample");
            return Err(Diagnostic::new("dataset.onset", message).at(&source, sample.span));
        }
    }
    for (index, fold) in set.folds.iter().enumerate() {
        let mut seen = vec![false; set.samples.len()];
        for &sample in &fold.value {
            match seen.get_mut(sample as usize) {
                Some(seen) if !*seen => *seen = true,
                Some(_) => {
                    return Err(Diagnostic::new("dataset.fold", format!("fold {index} names sample {sample} twice"))
                        .at(&source, fold.span));
                }
                None => {
                    let message = format!("fold {index} names sample {sample} of {}", set.samples.len());
                    return Err(Diagnostic::new("dataset.fold", message).at(&source, fold.span));
                }
            }
        }
    }
    Ok(Manifest { set, source })
}

impl Manifest {
    /// What the manifest says.
    #[must_use]
    pub fn set(&self) -> &DataSet {
        &self.set
    }

    /// Its text, for messages.
    #[must_use]
    pub fn source(&self) -> &SourceText {
        &self.source
    }

    /// What `files` calls the recordings for a population of the model.
    ///
    /// # Errors
    /// `dataset.population` with the ones that it has.
    pub fn recording_of(&self, population: &str) -> Result<&str, Diagnostic> {
        self.set.populations.iter().find(|(_, for_population)| *for_population == population).map_or_else(
            || {
                let known: Vec<&str> = self.set.populations.values().map(String::as_str).collect();
                Err(Diagnostic::new(
                    "dataset.population",
                    format!("the data set has nothing for population '{population}'"),
                )
                .help(format!("it has recordings for: {}", known.join(", ")))
                .in_file(self.source.path()))
            },
            |(name, _)| Ok(name.as_str()),
        )
    }

    /// The spikes of one sample for a population of `units` channels.
    ///
    /// # Errors
    /// `dataset.population`, `dataset.samples` for a sample that does not exist, `dataset.steps`; problems with the file
    /// at the place that names it.
    pub fn read_sample(&self, population: &str, units: u64, sample: usize) -> Result<PopulationSpikes, Diagnostic> {
        let name = self.recording_of(population)?;
        let Some(entry) = self.set.samples.get(sample) else {
            let message = format!("there is no sample {sample}; the data set has {}", self.set.samples.len());
            return Err(Diagnostic::new("dataset.samples", message).in_file(self.source.path()));
        };
        let file = &entry.value.files[name];
        let mut spikes = one_sample(&beside(self.source.path(), &file.value), units)
            .map_err(|problem| self.point_at(file.span, &file.value, problem))?;
        spikes.label = entry.label;
        match self.set.steps {
            // Rows of a .csv cannot say that silence follows them; the manifest can.
            Some(steps) if spikes.units.is_none() && spikes.steps < steps => spikes.steps = steps,
            Some(steps) if spikes.steps != steps => {
                let message = format!("{} has {} timesteps, the data set {steps}", file.value, spikes.steps);
                return Err(Diagnostic::new("dataset.steps", message).at(&self.source, file.span));
            }
            _ => {}
        }
        Ok(spikes)
    }

    /// The spikes of every sample for a population of `units` channels.
    ///
    /// # Errors
    /// As [`Manifest::read_sample`].
    pub fn read(&self, population: &str, units: u64) -> Result<Vec<PopulationSpikes>, Diagnostic> {
        let read: Vec<_> = (0..self.set.samples.len())
            .into_par_iter()
            .map(|sample| self.read_sample(population, units, sample))
            .collect();
        // The first problem in order of the samples, whichever thread met one first.
        read.into_iter().collect()
    }

    /// The spikes of every sample, when the data set has one population only.
    ///
    /// # Errors
    /// As [`Manifest::read`]; `dataset.population` when there are several.
    pub fn read_only(&self, units: u64) -> Result<Vec<PopulationSpikes>, Diagnostic> {
        let mut populations = self.set.populations.values();
        match (populations.next(), populations.next()) {
            (Some(population), None) => self.read(population, units),
            _ => Err(Diagnostic::new("dataset.population", "the data set has recordings for several populations")
                .in_file(self.source.path())),
        }
    }

    fn point_at(&self, span: Span, name: &str, problem: Diagnostic) -> Diagnostic {
        let position = problem.position().map_or(String::new(), |at| format!(":{}:{}", at.line, at.column));
        let mut pointed =
            Diagnostic::new(problem.code, format!("{name}{position}: {}", problem.message)).at(&self.source, span);
        pointed.help = problem.help;
        pointed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::mapping::pretty;
    use crate::io::npy::write_u8;

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

    fn load(text: &str) -> Result<Manifest, Diagnostic> {
        manifest(SourceText::new("d.ron", text))
    }

    #[test]
    fn recordings_are_found_beside_the_manifest() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["t0.npy", "t1.npy"] {
            write_u8(std::fs::File::create(folder.path().join(name)).unwrap(), &[2, 3], [0, 0, 1, 0, 1, 0]).unwrap();
        }
        std::fs::write(folder.path().join("s0.csv"), "0,4\n").unwrap();
        let path = folder.path().join("d.ron");
        std::fs::write(&path, SET).unwrap();
        let manifest = read_manifest(&path).unwrap();
        let touch = manifest.read("skin", 2).unwrap();
        assert_eq!(touch.iter().map(|s| s.label).collect::<Vec<_>>(), [Some(1), None]);
        assert_eq!(touch[1].events, [(2, 0), (1, 1)]);
        let sight = manifest.read_sample("eye", 5, 0).unwrap();
        assert_eq!((sight.steps, sight.events.clone()), (3, vec![(0, 4)]));
        let error = manifest.read_sample("eye", 4, 0).unwrap_err();
        assert_eq!((error.code, error.position().unwrap().line), ("input.channel", 7));
        assert!(error.message.contains("s0.csv:1:1: channel 4"), "{error}");
        assert_eq!(manifest.read("hand", 2).unwrap_err().code, "dataset.population");
        assert_eq!(manifest.read_only(2).unwrap_err().code, "dataset.population");
        std::fs::write(&path, SET.replace("steps: 3", "steps: 4")).unwrap();
        assert_eq!(read_manifest(&path).unwrap().read("skin", 2).unwrap_err().code, "dataset.steps");
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

    #[test]
    fn what_is_written_is_read_back() {
        let first = load(SET).unwrap();
        let text = pretty(first.set(), 2).unwrap();
        let again = load(&text).unwrap();
        assert_eq!(pretty(again.set(), 2).unwrap(), text);
        assert_eq!(again.set().samples[0].files["sight"].value, "s0.csv");
    }
}
