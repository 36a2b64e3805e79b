//! From a sweep file to its variants, by number.
//!
//! Input: a [`SweepFile`]. Output: a [`Sweep`], with the number of variants, the varied columns,
//! and the [`Job`] of each variant. Variants are numbered from 0: by entry of the list, then by
//! combination of the grid, with the last axis changing fastest. Errors: `sweep.axis`,
//! `sweep.path`, `sweep.value`, `sweep.size`.

use std::collections::BTreeSet;
use std::ops::Range;

use crate::sweep::file::{AxisDesc, SweepFile, ValueText};
use nsim_compile::{CopyPlacement, Objective, Options, Strategy};
use nsim_cost::Host;
use nsim_cost::estimate::Convention;
use nsim_cost::job::{Accounting, Mode};
use nsim_files::changes::Change;
use nsim_import::foreign::Reading;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::base::names::did_you_mean;
use nsim_ir::spanned::parse;
use nsim_train::convert::taps::DEFAULT_TAPS;

/// The columns after the varied values.
pub const FIGURES: [&str; 25] = [
    "error",
    "fits",
    "cores",
    "chips",
    "samples",
    "timesteps",
    "accuracy",
    "digest",
    "spikes",
    "synaptic_events",
    "static_mw",
    "dynamic_mw",
    "total_mw",
    "latency_us",
    "energy_uj",
    "edp_pjs",
    "neuron_dynamic_uj",
    "tightest",
    "used_percent",
    "reason",
    "accuracy_low",
    "accuracy_high",
    "messages",
    "hops",
    "job_mw",
];

/// The last column, where a front is requested.
pub const FRONT: &str = "front";

/// Greatest number of variants of a sweep.
const MOST_VARIANTS: u64 = 10_000_000;
/// Greatest number of values of an axis with `step`.
const MOST_STEPS: u64 = 1_000_000;
/// Options that a path can name, after `options.`.
const OPTIONS: [&str; 12] = [
    "copies",
    "strategy",
    "objective",
    "seed",
    "deployment",
    "relays",
    "prune",
    "host",
    "constants",
    "mode",
    "convention",
    "accounting",
];
/// Fields of the input that a path can name, after `input.`.
const INPUTS: [&str; 2] = ["samples", "seed"];

/// Training of a variant's network before its run.
#[derive(Debug, Clone, PartialEq)]
pub struct Training {
    /// A training file or the name of a shipped one.
    pub config: String,
    /// Changed fields of it with values, as `nsim train --set` takes them.
    pub fields: Vec<(String, String)>,
}

/// Settings of one variant.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Job {
    /// A model file or the name of a shipped model; empty where the variant trains its own.
    pub model: String,
    /// Training in place of a model.
    pub training: Option<Training>,
    /// Facts that the file of another tool does not state.
    pub reading: Reading,
    /// A target file or the name of a shipped target; else the model's own, or the usual one.
    pub target: Option<String>,
    /// Sources of spikes; the model's scene when empty.
    pub input: Vec<String>,
    /// Range of samples; all when `None`.
    pub samples: Option<Range<usize>>,
    /// Seed of a scene.
    pub seed: Option<u64>,
    /// Options of the mapping.
    pub options: Options,
    /// Whether relays are added.
    pub relays: bool,
    /// Arguments of `--prune`.
    pub prune: Vec<String>,
    /// Greatest number of taps of projections to a spike response population.
    pub most_taps: usize,
    /// A preset of constants; the target's first when `None`.
    pub constants: Option<String>,
    /// Host of its input spikes; an x86 core of each chip that has one when `None`.
    pub host: Option<Host>,
    /// Mode: as fast as possible, or paced by the model's timestep.
    pub mode: Mode,
    /// Convention of the energy.
    pub convention: Convention,
    /// Power that counts: neuron and x86 cores, or the rails of the board.
    pub accounting: Accounting,
    /// Changes of the model.
    pub model_changes: Vec<Change>,
    /// Changes of the target and its constants.
    pub target_changes: Vec<Change>,
}

fn named<T: Copy>(all: &[T], name_of: fn(T) -> &'static str, value: &str) -> Result<T, String> {
    let names: Vec<&str> = all.iter().map(|&one| name_of(one)).collect();
    all.iter().copied().find(|&one| name_of(one) == value).ok_or_else(|| format!("not one of {}", names.join(", ")))
}

fn number<T: std::str::FromStr>(value: &str) -> Result<T, String> {
    value.parse().map_err(|_| "not a number of this kind".to_string())
}

/// Range `A..B` of samples; either end may be missing. `None` for other text or an empty range.
pub fn sample_range(text: &str) -> Option<Range<usize>> {
    let (from, to) = text.split_once("..")?;
    let from = if from.is_empty() { 0 } else { from.parse().ok()? };
    let to = if to.is_empty() { usize::MAX } else { to.parse().ok()? };
    (from < to).then_some(from..to)
}

impl Job {
    fn new(file: &SweepFile) -> Self {
        Job {
            model: match (&file.model, &file.train) {
                (Some(model), _) => model.clone(),
                (None, Some(_)) => String::new(),
                (None, None) => "vtsnn-slip".to_string(),
            },
            training: file.train.clone().map(|config| Training { config, fields: Vec::new() }),
            target: file.target.clone(),
            input: file.input.clone(),
            seed: file.seed,
            most_taps: DEFAULT_TAPS,
            options: Options { copies: file.copies, ..Options::default() },
            ..Job::default()
        }
    }

    /// Sets the value of a path.
    ///
    /// # Errors
    /// `sweep.path`, `sweep.value`.
    fn assign(&mut self, path: &str, value: &str) -> Result<()> {
        let (first, rest) = path.split_once('.').filter(|(_, rest)| !rest.is_empty()).unwrap_or((path, ""));
        let wrong = |problem: String| Diagnostic::new("sweep.value", format!("{path}: {value} is {problem}"));
        if self.assign_own((first, rest), value).map_err(wrong)? {
            return Ok(());
        }
        match (first, rest) {
            ("train", field) if !field.is_empty() => {
                let Some(training) = &mut self.training else {
                    return Err(Diagnostic::new("sweep.path", format!("{path}: this sweep trains nothing"))
                        .help("name a training file with train: \"vtsnn-slip\" in the sweep, instead of a model"));
                };
                training.fields.push((field.to_string(), value.to_string()));
            }
            ("options" | "input", other) => {
                let known: &[&str] = if first == "options" { &OPTIONS } else { &INPUTS };
                let meant = did_you_mean(other, known.iter().copied());
                return Err(Diagnostic::new("sweep.path", format!("there is no path {path}"))
                    .help(format!("{meant}{first}. is followed by one of {}", known.join(", "))));
            }
            _ => {
                let change = Change::new(path, value);
                change.check()?;
                if self.training.is_some() && !change.changes_target() {
                    return Err(Diagnostic::new("sweep.path", format!("{path}: the model of this sweep is trained"))
                        .help("train.FIELD changes the training, such as train.layers.out.size"));
                }
                let changes = if change.changes_target() { &mut self.target_changes } else { &mut self.model_changes };
                changes.push(change);
            }
        }
        Ok(())
    }

    /// Sets a field of the job, if the path is one. The error completes "VALUE is ..".
    fn assign_own(&mut self, path: (&str, &str), value: &str) -> Result<bool, String> {
        match path {
            ("model", "") => self.model = value.to_string(),
            ("target", "") => self.target = Some(value.to_string()),
            ("input", "") => self.input = vec![value.to_string()],
            ("input", "samples") => {
                self.samples = Some(sample_range(value).ok_or("not a range of samples such as 0..20")?);
            }
            ("input", "seed") => self.seed = Some(number(value)?),
            ("options", "copies") => match number(value)? {
                0 => return Err("less than 1".to_string()),
                copies => self.options.copies = copies,
            },
            ("options", "seed") => self.options.seed = number(value)?,
            ("options", "strategy") => self.options.strategy = named(&Strategy::ALL, Strategy::name, value)?,
            ("options", "objective") => self.options.objective = named(&Objective::ALL, Objective::name, value)?,
            ("options", "deployment") => {
                self.options.placement = named(&CopyPlacement::ALL, CopyPlacement::name, value)?;
            }
            ("options", "relays") => self.relays = value.parse::<bool>().map_err(|_| "neither true nor false")?,
            ("options", "prune") => self.prune = vec![value.to_string()],
            ("options", "host") => self.host = Some(named(&Host::ALL, Host::name, value)?),
            ("options", "constants") => self.constants = Some(value.to_string()),
            ("options", "mode") => self.mode = named(&Mode::ALL, Mode::name, value)?,
            ("options", "convention") => self.convention = named(&Convention::ALL, Convention::name, value)?,
            ("options", "accounting") => self.accounting = named(&Accounting::ALL, Accounting::name, value)?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// Paths that take the same value, and their values.
#[derive(Debug, Clone)]
struct Axis {
    name: String,
    paths: Vec<String>,
    values: Vec<String>,
}

/// A checked sweep.
#[derive(Debug, Clone)]
pub struct Sweep {
    base: Job,
    /// Columns of the list.
    listed: Vec<String>,
    /// For each entry of the list the value of each of its columns.
    list: Vec<Vec<Option<String>>>,
    axes: Vec<Axis>,
    text: String,
}

impl Sweep {
    /// A sweep from its text.
    ///
    /// # Errors
    /// `sweep.*`.
    pub fn parse(source: &SourceText) -> Result<Self> {
        let file: SweepFile = parse(source, "sweep.syntax")?;
        let in_file = |problem: Diagnostic| problem.or_in_file(source.path());
        let mut base = Job::new(&file);
        if file.copies == 0 {
            return Err(in_file(Diagnostic::new("sweep.value", "copies: a mapping has at least one copy")));
        }
        if file.model.is_some() && file.train.is_some() {
            let problem = Diagnostic::new("sweep.value", "model and train: a variant runs a model or trains one");
            return Err(in_file(problem.help("remove one of them")));
        }
        if let Some(samples) = &file.samples {
            base.assign("input.samples", samples).map_err(in_file)?;
        }
        for (path, ValueText(value)) in &file.set.0 {
            base.assign(path, value).map_err(in_file)?;
        }
        let mut axes = Vec::new();
        for axis in &file.grid {
            axes.push(self::axis(&axis.value).map_err(|problem| problem.at(source, axis.span))?);
        }
        let mut listed: Vec<String> = Vec::new();
        for (path, _) in file.list.iter().flat_map(|entry| &entry.0) {
            if !listed.contains(path) {
                listed.push(path.clone());
            }
        }
        let value_of = |entry: &[(String, ValueText)], path: &String| {
            entry.iter().rev().find(|(name, _)| name == path).map(|(_, ValueText(value))| value.clone())
        };
        let mut list: Vec<Vec<Option<String>>> =
            file.list.iter().map(|entry| listed.iter().map(|path| value_of(&entry.0, path)).collect()).collect();
        if list.is_empty() {
            list.push(Vec::new());
        }
        let paths = axes.iter().flat_map(|axis: &Axis| &axis.paths);
        if let Some(twice) = repeated(paths.clone().chain(&listed).map(|path| Change::new(path, "").path().to_string()))
        {
            let message = format!("{twice} is varied twice, so one of its values would have no effect");
            return Err(in_file(Diagnostic::new("sweep.axis", message).help("give it in one axis, or in the list")));
        }
        let set: Vec<&String> = file.set.0.iter().map(|(path, _)| path).collect();
        if let Some(twice) = repeated(set.iter().copied()).or(paths.clone().find(|path| set.contains(path))) {
            let message = format!("{twice} is set twice, so one of its values would have no effect");
            return Err(in_file(Diagnostic::new("sweep.path", message).help("remove one of them")));
        }
        for (entry, of) in file.list.iter().enumerate() {
            if let Some(twice) = repeated(of.0.iter().map(|(path, _)| path)) {
                let message = format!("entry {entry} of the list has {twice} twice");
                return Err(in_file(Diagnostic::new("sweep.path", message).help("remove one of them")));
            }
        }
        let sweep = Sweep { base, listed, list, axes, text: source.text().to_string() };
        let mut names = sweep.columns();
        names.extend(["variant", FRONT].into_iter().chain(FIGURES));
        names.sort_unstable();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            let problem = Diagnostic::new("sweep.axis", format!("two columns have the name {}", twice[0]));
            return Err(in_file(problem.help("give one of the axes a different name")));
        }
        let sizes = sweep.axes.iter().map(|axis| axis.values.len() as u64);
        let count = sizes.fold(sweep.list.len() as u64, u64::saturating_mul);
        if count > MOST_VARIANTS {
            return Err(in_file(Diagnostic::new("sweep.size", format!("more than {MOST_VARIANTS} variants"))));
        }
        // Assigns every value of every column once, so that errors appear before the runs.
        let mut scratch = sweep.base.clone();
        for axis in &sweep.axes {
            for (path, value) in axis.values.iter().flat_map(|value| axis.paths.iter().map(move |path| (path, value))) {
                scratch.assign(path, value).map_err(in_file)?;
            }
            scratch = sweep.base.clone();
        }
        for (path, value) in sweep.list.iter().flat_map(|entry| sweep.listed.iter().zip(entry)) {
            value.iter().try_for_each(|value| scratch.assign(path, value)).map_err(in_file)?;
        }
        Ok(sweep)
    }

    /// The sweep with defaults: facts that the files of other tools do not state; relays, pruning
    /// and taps as `nsim map` takes them, for variants without their own.
    pub fn with(mut self, reading: Reading, relays: bool, prune: &[String], most_taps: usize) -> Self {
        self.base.reading = reading;
        self.base.relays |= relays;
        if !prune.is_empty() {
            self.base.prune = prune.to_vec();
        }
        self.base.most_taps = most_taps;
        self
    }

    /// Number of variants.
    pub fn len(&self) -> u64 {
        self.list.len() as u64 * self.axes.iter().map(|axis| axis.values.len() as u64).product::<u64>()
    }

    /// Whether there is no variant.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Names of the varied columns.
    pub fn columns(&self) -> Vec<&str> {
        self.listed.iter().map(String::as_str).chain(self.axes.iter().map(|axis| axis.name.as_str())).collect()
    }

    /// Whether a column changes only limits and sizes of the chip.
    pub fn is_of_chip(&self, column: &str) -> bool {
        let of_chip = |path: &String| path.starts_with("target.");
        let axis = self.axes.iter().find(|axis| axis.name == column);
        axis.map_or(of_chip(&column.to_string()), |axis| axis.paths.iter().all(of_chip))
    }

    /// The list's entry of a variant, and the number of its value on each axis.
    fn place(&self, variant: u64) -> (usize, Vec<usize>) {
        let mut rest = variant;
        let mut on_axes = vec![0; self.axes.len()];
        for (place, axis) in on_axes.iter_mut().zip(&self.axes).rev() {
            let size = axis.values.len() as u64;
            *place = (rest % size) as usize;
            rest /= size;
        }
        (rest as usize, on_axes)
    }

    /// The values of a variant, by column.
    pub fn values(&self, variant: u64) -> Vec<&str> {
        let (entry, on_axes) = self.place(variant);
        let listed = self.list[entry].iter().map(|value| value.as_deref().unwrap_or_default());
        listed.chain(self.axes.iter().zip(on_axes).map(|(axis, place)| axis.values[place].as_str())).collect()
    }

    /// Settings of a variant.
    ///
    /// # Errors
    /// `sweep.value`, which [`Self::parse`] reports before.
    pub fn job(&self, variant: u64) -> Result<Job> {
        let (entry, on_axes) = self.place(variant);
        let mut job = self.base.clone();
        for (path, value) in self.listed.iter().zip(&self.list[entry]) {
            value.iter().try_for_each(|value| job.assign(path, value))?;
        }
        for (axis, place) in self.axes.iter().zip(on_axes) {
            axis.paths.iter().try_for_each(|path| job.assign(path, &axis.values[place]))?;
        }
        Ok(job)
    }

    /// Models, targets, inputs, spikes for pruning, and constants that variants name.
    pub fn names(&self) -> Vec<String> {
        let Job { model, training, target, input, prune, constants, .. } = &self.base;
        let training = training.as_ref().map(|training| &training.config);
        let named = std::iter::once(model).chain(target).chain(training).chain(input).chain(prune).chain(constants);
        let mut names: Vec<String> = named.cloned().collect();
        let is_name =
            |path: &String| ["model", "target", "input", "options.prune", "options.constants"].contains(&path.as_str());
        let listed = self.list.iter().flat_map(|entry| self.listed.iter().zip(entry));
        names.extend(listed.filter(|(path, _)| is_name(path)).filter_map(|(_, value)| value.clone()));
        let axes = self.axes.iter().filter(|axis| axis.paths.iter().any(is_name));
        names.extend(axes.flat_map(|axis| axis.values.iter().cloned()));
        names.sort_unstable();
        names.dedup();
        names
    }

    /// Whether variants may differ in model or number of copies, hence in run time.
    pub fn has_sizes(&self) -> bool {
        let paths = self.axes.iter().flat_map(|axis| &axis.paths).chain(&self.listed);
        paths.into_iter().any(|path| ["model", "options.copies"].contains(&path.as_str()))
    }

    /// Source text of the sweep.
    pub fn text(&self) -> &str {
        &self.text
    }
}

/// The first repeated item.
fn repeated<T: Ord + Clone>(all: impl Iterator<Item = T>) -> Option<T> {
    let mut seen = BTreeSet::new();
    all.into_iter().find(|one| !seen.insert(one.clone()))
}

fn axis(desc: &AxisDesc) -> Result<Axis> {
    let wrong = |message: &str| Err(Diagnostic::new("sweep.axis", message));
    let name = match (&desc.name, desc.paths.as_slice()) {
        (_, []) => return wrong("an axis has at least one path"),
        (Some(name), _) => name.clone(),
        (None, [path]) => path.clone(),
        (None, _) => return wrong("an axis of several paths has a name"),
    };
    let values = match (desc.values.as_slice(), desc.from, desc.to, desc.step) {
        ([], Some(from), Some(to), Some(step)) => stepped(from, to, step)?,
        ([], None, None, None) => return wrong("an axis has values, or from, to and step"),
        (values, None, None, None) => values.iter().map(|ValueText(value)| value.clone()).collect(),
        _ => return wrong("an axis has either values or all of from, to and step"),
    };
    Ok(Axis { name, paths: desc.paths.clone(), values })
}

/// Values from one to another; whole numbers are written without a point.
fn stepped(from: f64, to: f64, step: f64) -> Result<Vec<String>> {
    let count = ((to - from) / step * (1.0 + 1e-12) + 1e-9).floor();
    if !(count >= 0.0 && count < MOST_STEPS as f64 && step != 0.0) {
        return Err(Diagnostic::new("sweep.axis", format!("steps of {step} do not lead from {from} to {to}")));
    }
    let value = |index: u64| from + index as f64 * step;
    let whole = [from, step].iter().all(|number| number.fract() == 0.0);
    let text = |value: f64| if whole { format!("{value:.0}") } else { format!("{value:?}") };
    Ok((0..=count as u64).map(|index| text(value(index))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(text: &str) -> Result<Sweep> {
        Sweep::parse(&SourceText::new("s.ron", text))
    }

    #[test]
    fn variants_are_counted_like_digits() {
        let sweep = sweep(
            r#"Sweep(list: [{"model": "a"}, {"model": "b", "input.seed": 5}], grid: [
                (name: "threshold", paths: ["populations.x.vth_mant", "populations.y.vth_mant"], values: [10, 2.5]),
                (paths: ["constants.injection_time"], from: 1, to: 3, step: 1),
                (paths: ["options.copies"], values: [2])])"#,
        )
        .unwrap();
        assert_eq!(sweep.len(), 12);
        let columns = ["model", "input.seed", "threshold", "constants.injection_time", "options.copies"];
        assert_eq!(sweep.columns(), columns);
        assert_eq!(sweep.values(0), ["a", "", "10", "1", "2"]);
        assert_eq!(sweep.values(1), ["a", "", "10", "2", "2"]);
        assert_eq!(sweep.values(11), ["b", "5", "2.5", "3", "2"]);
        let job = sweep.job(11).unwrap();
        let of_model = ["populations.x.vth_mant", "populations.y.vth_mant"].map(|path| Change::new(path, "2.5"));
        assert_eq!((job.model.as_str(), job.seed, job.options.copies), ("b", Some(5), 2));
        assert_eq!(
            (job.model_changes, job.target_changes),
            (of_model.to_vec(), vec![Change::new("constants.injection_time", "3")])
        );
    }

    #[test]
    fn steps_end_where_they_are_said_to() {
        assert_eq!(stepped(0.1, 0.3, 0.1).unwrap().len(), 3);
        assert_eq!(stepped(300.0, 500.0, 100.0).unwrap(), ["300", "400", "500"]);
        assert_eq!(stepped(5.0, 1.0, -2.0).unwrap(), ["5", "3", "1"]);
        assert!(
            stepped(1.0, 2.0, 0.0).is_err() && stepped(1.0, 2.0, -1.0).is_err() && stepped(0.0, f64::NAN, 1.0).is_err()
        );
    }

    #[test]
    fn what_makes_no_sense_is_refused_before_the_work() {
        for (text, code) in [
            ("Sweep(grid: [(paths: [], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(paths: [\"a\", \"b\"], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(paths: [\"a\"])])", "sweep.axis"),
            ("Sweep(grid: [(paths: [\"a\"], values: [1], from: 2)])", "sweep.axis"),
            ("Sweep(grid: [(paths: [\"a\"], values: [1]), (paths: [\"a\"], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(name: \"x\", paths: [\"a\"], values: [1]), (paths: [\"a\"], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(name: \"x\", paths: [\"a\", \"a\"], values: [1])])", "sweep.axis"),
            ("Sweep(list: [{\"a\": 1}], grid: [(name: \"x\", paths: [\" a\"], values: [1])])", "sweep.axis"),
            (
                "Sweep(grid: [(name: \"x\", paths: [\"constants.a\"], values: [1]),
                    (paths: [\"constants.a.value\"], values: [1])])",
                "sweep.axis",
            ),
            ("Sweep(set: {\"a\": 1}, grid: [(paths: [\"a\"], values: [1])])", "sweep.path"),
            ("Sweep(list: [{\"a\": 1, \"a\": 2}])", "sweep.path"),
            ("Sweep(grid: [(name: \"energy_uj\", paths: [\"a\"], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(name: \"variant\", paths: [\"a\"], values: [1])])", "sweep.axis"),
            ("Sweep(grid: [(paths: [\"constants\"], values: [1])])", "set.path"),
            ("Sweep(grid: [(paths: [\"target.\"], values: [1])])", "set.path"),
            ("Sweep(set: {\"a..b\": 1})", "set.path"),
            ("Sweep(set: {\"a\": \"(\"})", "set.value"),
            ("Sweep(grid: [(paths: [\"options.copys\"], values: [1])])", "sweep.path"),
            ("Sweep(grid: [(paths: [\"options.copies\"], values: [0])])", "sweep.value"),
            ("Sweep(list: [{\"options.strategy\": \"best\"}])", "sweep.value"),
            ("Sweep(list: [{\"options.host\": \"x86\"}])", "sweep.value"),
            ("Sweep(list: [{\"options.deployment\": \"paper\"}])", "sweep.value"),
            ("Sweep(samples: \"5..5\")", "sweep.value"),
            ("Sweep(copies: 0)", "sweep.value"),
            ("Sweep(grids: [])", "sweep.syntax"),
        ] {
            assert_eq!(sweep(text).unwrap_err().code, code, "{text}");
        }
    }
}
