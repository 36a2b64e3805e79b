//! Cells of the paper's accuracy tables: training file, loss, and results by fold.
//!
//! Input: trained networks on the samples that their training excluded ([`Trial`]), with the chip's
//! neurons or spike-response neurons. Output: rows of accuracy and of early decisions; the times at
//! which each sense leads. Omitted on purpose: training and simulating, which need a folder and a
//! target.

use crate::early::Trial;
use crate::published::paper::PaperRow;
use nsim_files::shipped::{Shipped, TRAININGS};
use nsim_files::table::rounded;
use nsim_files::training::{LossDesc, TrainingFile};
use nsim_ir::base::names::named_variants;
use nsim_ir::base::stats::{mean_sd, wilson};
use nsim_session::error::{Error, Result};

/// Prefix of the names of the tables' training files.
const PAPER: &str = "paper-";

/// The losses of the tables, by name.
pub const LOSSES: [&str; 2] = ["count", "weighted"];

/// Coefficients of `omega(t) = beta t^2 + gamma`, length 1. The paper asks for beta below 0 only.
const OMEGA: (f64, f64) = (-1.0, 1.0);

/// A task and the senses that a network has.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    /// `slip` or `container`.
    pub task: &'static str,
    /// `tactile`, `vision` or `both`.
    pub modality: &'static str,
    /// Training file of its networks.
    pub training: &'static Shipped,
}

/// The cells, grouped by task.
pub fn cells() -> impl Iterator<Item = Cell> {
    TRAININGS.iter().filter_map(|training| {
        let (task, modality) = training.name.strip_prefix(PAPER)?.split_once('-')?;
        Some(Cell { task, modality, training })
    })
}

impl Cell {
    /// `TASK-MODALITY`.
    pub fn name(&self) -> &'static str {
        self.training.name.strip_prefix(PAPER).unwrap_or(self.training.name)
    }

    /// The name under which the network of the first fold ships.
    pub fn model(&self, loss: &str) -> String {
        format!("{}-{loss}", self.training.name)
    }

    /// Both losses of a training file with the spike-count loss, in the order of [`LOSSES`].
    ///
    /// # Errors
    /// [`Error::Fault`] for another loss.
    pub fn losses(&self, file: &TrainingFile) -> Result<[String; 2]> {
        let LossDesc::SpikeCount { right, wrong } = *file.loss else {
            return Err(Error::Fault(format!("{}: the loss must be SpikeCount", self.training.path)));
        };
        let (beta, gamma) = OMEGA;
        let weighted = format!("Weighted(right: {right:?}, wrong: {wrong:?}, beta: {beta:?}, gamma: {gamma:?})");
        Ok([format!("SpikeCount(right: {right:?}, wrong: {wrong:?})"), weighted])
    }

    /// Times at which decisions are read, ms from the beginning of a sample.
    pub fn times_ms(&self) -> &'static [u32] {
        match self.task {
            "slip" => &[20, 30, 40, 50, 60, 80, 100, 150],
            _ => &[500, 1000, 1500, 2000, 2500, 3000, 4000, 5000, 6500],
        }
    }
}

/// The neurons of a cell's networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Neurons {
    /// The chip's neurons, as in the training files.
    Loihi,
    /// Spike-response neurons, as in the paper's tables.
    Srm,
}

named_variants!(Neurons { Loihi = "loihi", Srm = "srm" });

impl Neurons {
    /// Value of the field `neuron` of a training file; `None` keeps the file's. Time constants are
    /// the paper's 10 and 1 bins (clear-nus/VT_SNN, network parameters).
    pub fn field(self, file: &TrainingFile) -> Option<String> {
        let bin_ms = *file.timestep_ms;
        let srm = || {
            format!("Srm(tau_sr_ms: Same({:?}), tau_ref_ms: {bin_ms:?}, scale_ref: 2.0, theta: 10.0)", 10.0 * bin_ms)
        };
        (self == Neurons::Srm).then(srm)
    }
}

/// Whether a row is of one of these cells and neurons; an empty list allows any.
pub fn is_among(row: &PaperRow, cells: &[&str], neurons: &[Neurons]) -> bool {
    let of_row = match &*row.table {
        "srm" => Some(Neurons::Srm),
        "ann" => None,
        _ => Some(Neurons::Loihi),
    };
    (cells.is_empty()
        || cells.iter().any(|cell| cell.split_once('-') == Some((row.task.as_str(), row.modality.as_str()))))
        && (neurons.is_empty() || of_row.is_some_and(|kind| neurons.contains(&kind)))
}

/// Tested networks of a cell, one for each fold.
#[derive(Debug)]
pub struct TestedNetworks<'a> {
    /// Task and senses of the networks.
    pub cell: Cell,
    /// Its loss.
    pub loss: &'a str,
    /// Its neurons.
    pub neurons: Neurons,
    /// Folds into which the samples were divided.
    pub folds: u32,
    /// Epochs of each training.
    pub epochs: u32,
    /// Results of each network on the samples that its training excluded.
    pub trials: &'a [Trial],
}

impl TestedNetworks<'_> {
    /// A row with the figure of each fold, their mean and their standard deviation.
    fn row(&self, table: &str, quantity: &str, note: String, figures: Vec<f64>) -> PaperRow {
        let (mean, deviation) = mean_sd(&figures);
        PaperRow {
            loss: Some(self.loss.to_string()),
            measured: (!figures.is_empty()).then_some(mean),
            deviation: (figures.len() > 1).then_some(deviation),
            note,
            folds: figures,
            ..PaperRow::new(table, self.cell.task, self.cell.modality, quantity)
        }
    }

    /// A row of shares of samples, with the interval of the share of all samples together.
    fn share(&self, table: &str, quantity: &str, note: String, figures: Vec<f64>) -> PaperRow {
        let sizes: Vec<usize> = self.trials.iter().map(|trial| trial.decided_ms.len()).collect();
        let all: usize = sizes.iter().sum();
        let right: f64 = figures.iter().zip(&sizes).map(|(share, &size)| share * size as f64).sum();
        let (low, high) = wilson(right / all.max(1) as f64, all);
        PaperRow { low: Some(low), high: Some(high), ..self.row(table, quantity, note, figures) }
    }

    /// Rows of accuracy, of accuracy by time, and of the time since which decisions stay right.
    pub fn rows(&self) -> Vec<PaperRow> {
        let TestedNetworks { folds, epochs, trials, .. } = self;
        let tested = trials.len();
        let of_trials = |figure: &dyn Fn(&Trial) -> Option<f64>| trials.iter().filter_map(figure).collect::<Vec<f64>>();
        let (table, early, kind, place) = match self.neurons {
            Neurons::Loihi => ("accuracy", "early", "Loihi", " on simulated cores"),
            Neurons::Srm => ("srm", "srm", "spike-response", " in real numbers"),
        };
        let note = format!("synthetic scenes; {tested} of {folds} folds, {epochs} epochs, {kind} neurons");
        let mut rows = vec![self.share(table, "accuracy", note, of_trials(&|trial| trial.accuracy.last().copied()))];
        let note = format!("synthetic scenes; {tested} of {folds} folds{place}");
        for &time_ms in self.cell.times_ms() {
            let by = of_trials(&|trial| {
                let step = (f64::from(time_ms) / trial.timestep_ms).round() as usize;
                trial.accuracy.get(step.checked_sub(1)?).copied()
            });
            if by.len() == tested {
                rows.push(self.share(early, &format!("accuracy_by_{time_ms}_ms"), note.clone(), by));
            }
        }
        let decided = of_trials(&|trial| {
            let times: Vec<f64> = trial.decided_ms.iter().flatten().copied().collect();
            (!times.is_empty()).then(|| mean_sd(&times).0)
        });
        rows.push(self.row(early, "decided_ms", note, decided));
        for row in &mut rows {
            for figure in [&mut row.measured, &mut row.deviation, &mut row.low, &mut row.high].into_iter().flatten() {
                *figure = rounded(*figure);
            }
            row.folds.iter_mut().for_each(|figure| *figure = rounded(*figure));
        }
        rows
    }
}

/// The interval of an accuracy at a time.
struct AccuracyAtTime {
    time_ms: u32,
    low: f64,
    high: f64,
}

/// Accuracy of always naming the same class of a task, 0..=1.
pub fn chance(task: &str) -> f64 {
    if task == "slip" { 1.0 / 2.0 } else { 1.0 / 20.0 }
}

/// Times at which each sense leads: a sentence for each task, loss and neurons with both senses.
///
/// A sense leads where its whole interval is above the other's interval and above [`chance`].
pub fn leads(rows: &[PaperRow]) -> Vec<String> {
    let mut said = Vec::new();
    let cells = ["slip", "container"].iter().flat_map(|task| LOSSES.map(|loss| (*task, loss)));
    let kinds = [("early", "Loihi neurons"), ("srm", "spike-response neurons")];
    for ((task, loss), (table, neurons)) in cells.flat_map(|cell| kinds.map(|kind| (cell, kind))) {
        let by = |modality: &str| {
            let of_cell = rows.iter().filter(move |row| {
                row.task == task && row.loss.as_deref() == Some(loss) && row.modality == modality && row.table == table
            });
            fn at(row: &PaperRow) -> Option<AccuracyAtTime> {
                let time_ms = row.quantity.strip_prefix("accuracy_by_")?.strip_suffix("_ms")?.parse().ok()?;
                Some(AccuracyAtTime { time_ms, low: row.low?, high: row.high? })
            }
            of_cell.filter_map(at).collect::<Vec<_>>()
        };
        let (touch, vision) = (by("tactile"), by("vision"));
        let pairs: Vec<_> =
            touch.iter().filter_map(|a| Some((a, vision.iter().find(|b| a.time_ms == b.time_ms)?))).collect();
        if pairs.is_empty() {
            continue;
        }
        let leads = |one: &AccuracyAtTime, other: &AccuracyAtTime| one.low > other.high.max(chance(task));
        let times = |above: &dyn Fn(&AccuracyAtTime, &AccuracyAtTime) -> bool| {
            let times: Vec<String> =
                pairs.iter().filter(|(a, b)| above(a, b)).map(|(a, _)| a.time_ms.to_string()).collect();
            if times.is_empty() { "never".to_string() } else { format!("at {} ms", times.join(", ")) }
        };
        let (first, second) = (times(&leads), times(&|a, b| leads(b, a)));
        said.push(format!("{task}, {loss} loss, {neurons}: touch leads {first}, vision {second}"));
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::diagnostic::SourceText;
    use nsim_train::job::{Job, with_fields};

    fn trial(accuracy: Vec<f64>, samples: usize) -> Trial {
        Trial { timestep_ms: 1.0, accuracy, decided_ms: vec![Some(7.0); samples] }
    }

    #[test]
    fn every_cell_has_a_training_with_the_same_scenes_for_each_sense() {
        let all: Vec<Cell> = cells().collect();
        assert_eq!(all.len(), 6);
        for cell in all {
            let source = SourceText::new(cell.training.path, cell.training.text);
            let job = Job::new(source, None, None).unwrap();
            let both = cells().find(|other| other.task == cell.task && other.modality == "both").unwrap();
            let scenes = Job::new(SourceText::new("both", both.training.text), None, None).unwrap().file.train;
            assert_eq!(job.file.train, scenes, "{}", cell.name());
            let changed = |field, value: &str| {
                let source = SourceText::new("changed", cell.training.text);
                Job::new(with_fields(&source, &[(field, value)]).unwrap(), None, None).unwrap()
            };
            cell.losses(&job.file).unwrap().iter().for_each(|loss| drop(changed("loss", loss)));
            assert_eq!(Neurons::Loihi.field(&job.file), None);
            changed("neuron", &Neurons::Srm.field(&job.file).unwrap());
        }
    }

    #[test]
    fn rows_have_means_over_folds_and_intervals_over_all_samples() {
        let cell = cells().find(|cell| cell.name() == "slip-tactile").unwrap();
        let mut late = vec![0.5; 150];
        late[149] = 0.75;
        let trials = [trial(late, 4), trial(vec![1.0; 150], 4)];
        let neurons = Neurons::Loihi;
        let tested = TestedNetworks { cell, loss: "count", neurons, folds: 5, epochs: 9, trials: &trials };
        let rows = tested.rows();
        let of = |quantity: &str| rows.iter().find(|row| row.quantity == quantity).unwrap();
        let accuracy = of("accuracy");
        assert_eq!((accuracy.measured, accuracy.deviation), (Some(0.875), Some(0.125)));
        assert_eq!(accuracy.folds, [0.75, 1.0]);
        let (low, high) = wilson(0.875, 8);
        assert!((accuracy.low.unwrap() - low).abs() < 1e-6 && (accuracy.high.unwrap() - high).abs() < 1e-6);
        assert!(accuracy.note.contains("2 of 5 folds, 9 epochs"));
        assert_eq!(of("accuracy_by_20_ms").measured, Some(0.75));
        assert_eq!(of("decided_ms").measured, Some(7.0));
        assert_eq!(rows.len(), 1 + 8 + 1);
        let rows = TestedNetworks { neurons: Neurons::Srm, ..tested }.rows();
        assert!(rows.len() == 1 + 8 + 1 && rows.iter().all(|row| row.table == "srm"));
    }

    #[test]
    fn a_sense_leads_where_intervals_are_apart() {
        let row = |modality: &str, time: u32, low, high| PaperRow {
            loss: Some("count".to_string()),
            low: Some(low),
            high: Some(high),
            ..PaperRow::new("early", "slip", modality, &format!("accuracy_by_{time}_ms"))
        };
        let rows = [
            row("tactile", 10, 0.4, 0.5),
            row("vision", 10, 0.0, 0.1),
            row("tactile", 20, 0.6, 0.7),
            row("vision", 20, 0.4, 0.5),
            row("tactile", 30, 0.6, 0.7),
            row("vision", 30, 0.65, 0.8),
            row("tactile", 40, 0.6, 0.7),
            row("vision", 40, 0.8, 0.9),
        ];
        assert_eq!(leads(&rows), ["slip, count loss, Loihi neurons: touch leads at 20 ms, vision at 40 ms"]);
        assert_eq!(leads(&rows[..1]), Vec::<String>::new());
    }
}
