//! The result of `nsim bench paper`: grids like the paper's, tables of every figure, JSON and CSV.
//!
//! Input: the rows of the tables. Output: grids of networks by senses; JSON and CSV with a row for
//! each figure. A cell of a grid has the value measured here and, in brackets, the paper's.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use nsim_files::table::{csv_text, or_empty, table, three, wrapped};
use nsim_study::published::cells::{LOSSES, chance, leads};
use nsim_study::published::paper::{PaperRow, TABLES};

/// Ends of an interval.
fn interval(row: &PaperRow) -> String {
    or_empty(row.low.zip(row.high).map(|(low, high)| format!("{low:.3}..{high:.3}")))
}

/// A mean with its deviation, where there is one.
fn mean(mean: Option<f64>, deviation: Option<f64>) -> String {
    fn digits(x: f64) -> String {
        if x.abs() < 10.0 { format!("{x:.3}") } else { format!("{x:.1}") }
    }
    let deviation = deviation.map_or(String::new(), |deviation| format!("\u{b1}{}", digits(deviation)));
    mean.map_or(String::new(), |mean| digits(mean) + &deviation)
}

/// Keys of a figure in CSV.
const KEYS: &str =
    "table,task,modality,loss,quantity,published,published_deviation,measured,deviation,low,high,shipped,note";

/// `nsim.bench/1`.
pub fn json(rows: &[PaperRow]) -> Value {
    json!({ "schema": "nsim.bench/1", "name": "paper", "rows": rows })
}

/// CSV with a row for each figure.
pub fn csv(rows: &[PaperRow]) -> String {
    nsim_files::table::csv(rows, KEYS)
}

/// A table like one of the paper's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grid {
    /// Title of the grid.
    pub title: String,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Grid {
    /// A grid without empty columns and rows, if any is left. Rows begin with a name.
    fn new(title: &str, columns: &[&str], rows: &[Vec<String>]) -> Option<Grid> {
        let used = |place: &usize| *place == 0 || rows.iter().any(|row| !row[*place].is_empty());
        let places: Vec<usize> = (0..=columns.len()).filter(used).collect();
        let header = places.iter().map(|&place| if place == 0 { "" } else { columns[place - 1] }.to_string()).collect();
        let full = rows.iter().filter(|row| row[1..].iter().any(|cell| !cell.is_empty()));
        let rows: Vec<Vec<String>> = full.map(|row| places.iter().map(|&place| row[place].clone()).collect()).collect();
        (!rows.is_empty()).then(|| Grid { title: title.to_string(), header, rows })
    }

    /// The grid as text.
    pub fn text(&self) -> String {
        let header: Vec<&str> = self.header.iter().map(String::as_str).collect();
        format!("{}\n\n{}\n", self.title, table(&header, &self.rows))
    }

    /// The grid as CSV.
    pub fn csv(&self) -> String {
        csv_text(self.header.clone(), self.rows.iter().cloned())
    }
}

/// Networks of the tables of accuracy: name in a grid, table, loss, beginning of the row's note.
const NETWORKS: [(&str, &str, Option<&str>, &str); 6] = [
    ("SNN (L), chip", "accuracy", Some("count"), ""),
    ("SNN (L_w), chip", "accuracy", Some("weighted"), ""),
    ("SNN (L), SRM", "srm", Some("count"), ""),
    ("SNN (L_w), SRM", "srm", Some("weighted"), ""),
    ("MLP-GRU", "ann", None, "MLP-GRU"),
    ("CNN-3D", "ann", None, "CNN-3D"),
];
/// Tasks, with their names in a grid.
const TASKS: [(&str, &str); 2] = [("slip", "Slip detection"), ("container", "Containers and weights")];
/// Senses, with their names in a grid.
const SENSES: [(&str, &str); 3] = [("tactile", "touch"), ("vision", "vision"), ("both", "both")];

/// Cell of a figure: the value measured here and, in brackets, the printed one.
fn here_and_printed(here: Option<String>, printed: Option<String>) -> String {
    match (here, printed) {
        (here, None) => here.unwrap_or_default(),
        (here, Some(printed)) => format!("{} ({printed})", here.unwrap_or_else(|| "-".to_string())),
    }
}

/// The row of a figure; `note` begins its note.
fn find<'r>(
    rows: &'r [PaperRow],
    table: &str,
    [task, senses, quantity]: [&str; 3],
    loss: Option<&str>,
    note: &str,
) -> Option<&'r PaperRow> {
    rows.iter().find(|row| {
        [&*row.table, &row.task, &row.modality, &row.quantity] == [table, task, senses, quantity]
            && row.loss.as_deref() == loss
            && row.note.starts_with(note)
    })
}

/// The grids that have rows: accuracies of each task, hardware, accuracy by time.
pub fn grids(rows: &[PaperRow]) -> Vec<Grid> {
    let powers = hardware(
        rows,
        "One x86 core and one of 32 copies: modelled here (in the paper)",
        &[("x86 core", "x86_"), ("neuron cores", "neuron_"), ("Loihi", ""), ("RTX 2080 Ti", "gpu_")],
        &[
            ("static (mW)", "static_mw"),
            ("dynamic (mW)", "dynamic_mw"),
            ("total (mW)", "total_mw"),
            ("step (us)", "latency_us"),
        ],
    );
    let energies = hardware(
        rows,
        "Energy as in the paper (power / 150), and times latency: here (in the paper)",
        &[("Loihi", ""), ("RTX 2080 Ti", "gpu_")],
        &[("energy (mW/150)", "mw_per_step"), ("EDP (pJ s)", "edp_pjs")],
    );
    let whole = TASKS.map(|(task, title)| accuracies(rows, task, title));
    let by_time = TASKS.map(|(task, title)| accuracies_by_time(rows, task, title));
    whole.into_iter().chain([powers, energies]).chain(by_time).flatten().collect()
}

fn accuracies(rows: &[PaperRow], task: &str, title: &str) -> Option<Grid> {
    let mut lines = Vec::new();
    for (name, table, loss, note) in NETWORKS {
        let (mut line, mut epochs) = (vec![name.to_string()], Vec::new());
        for (senses, _) in SENSES {
            let row = find(rows, table, [task, senses, "accuracy"], loss, note);
            line.push(row.map_or(String::new(), |row| {
                let folds = if row.deviation.is_some() { "" } else { "*" };
                let measured_share = row.measured.map(|share| format!("{share:.3}{folds}"));
                here_and_printed(measured_share, row.published.map(|share| format!("{share:.2}")))
            }));
            epochs.extend(row.and_then(|row| row.note.split_once(" epochs")?.0.split(' ').next_back()));
        }
        line.push(epochs.join(", "));
        lines.push(line);
    }
    let names: Vec<&str> = SENSES.iter().map(|(_, name)| *name).chain(["epochs"]).collect();
    Grid::new(&format!("{title}: accuracy here (in the paper)"), &names, &lines)
}

/// Figures of hardware; `units` and `columns` are names in the grid with parts of the quantity.
fn hardware(rows: &[PaperRow], title: &str, units: &[(&str, &str)], columns: &[(&str, &str)]) -> Option<Grid> {
    let mut lines = Vec::new();
    for (table, mode) in [("offline", "offline"), ("realtime", "real time")] {
        for (name, before) in units {
            let mut line = vec![format!("{name}, {mode}")];
            for (_, quantity) in columns {
                let row = find(rows, table, ["slip", "both", &format!("{before}{quantity}")], None, "");
                line.push(row.map_or(String::new(), |row| {
                    here_and_printed(row.measured.map(three), row.published.map(|figure| figure.to_string()))
                }));
            }
            lines.push(line);
        }
    }
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    Grid::new(title, &names, &lines)
}

fn accuracies_by_time(rows: &[PaperRow], task: &str, title: &str) -> Option<Grid> {
    let above_chance = rows
        .iter()
        .filter(|row| row.table == "early" && row.task == task && row.low.is_none_or(|low| low > chance(task)));
    let times: BTreeSet<u32> = above_chance
        .filter_map(|row| row.quantity.strip_prefix("accuracy_by_")?.strip_suffix("_ms")?.parse().ok())
        .collect();
    let mut lines = Vec::new();
    for (table, neurons) in [("early", "chip"), ("srm", "SRM")] {
        for ((senses, name), loss) in SENSES.into_iter().flat_map(|senses| LOSSES.map(|loss| (senses, loss))) {
            let share = |quantity: &str| find(rows, table, [task, senses, quantity], Some(loss), "")?.measured;
            let by_time = times.iter().map(|time| share(&format!("accuracy_by_{time}_ms")));
            let by_time = by_time.map(|share| share.map_or(String::new(), |share| format!("{share:.2}")));
            let when = ["decided_ms", "certain_ms"].map(|quantity| share(quantity).map_or(String::new(), three));
            let name = format!("{name} ({}), {neurons}", if loss == "count" { "L" } else { "L_w" });
            lines.push(std::iter::once(name).chain(by_time).chain(when).collect());
        }
    }
    let times: Vec<String> = times.iter().map(u32::to_string).collect();
    let names: Vec<&str> = times.iter().map(String::as_str).chain(["for good", "certain"]).collect();
    Grid::new(&format!("{title}: accuracy here by time (ms), and when it stays"), &names, &lines)
}

/// The grids of a document; `before` begins the line of a title, `of` makes a table of CSV.
pub fn document(rows: &[PaperRow], before: &str, of: fn(&str) -> String) -> String {
    grids(rows).iter().map(|grid| format!("{before}{}\n\n{}\n", grid.title, of(&grid.csv()))).collect()
}

/// The grids as text, with notes on omitted figures.
pub fn summary(rows: &[PaperRow]) -> String {
    let mut out: String = grids(rows).iter().map(Grid::text).collect();
    out += &wrapped(
        "L: spike-count loss; L_w: weighted loss. chip: Loihi neurons on simulated cores; SRM: spike-response neurons, \
         as in the paper. Scenes are synthetic here unless noted in --full, and accuracies are means over folds; *: of \
         one fold. epochs: of each sense. The paper has 500; networks with fewer are undertrained (MLP-GRU on \
         containers: chance, 0.05).",
    );
    out += &wrapped(
        "Times at which no network is above chance are omitted; a sample without output spikes is wrong. for good: \
         mean time after which a sample that ends right is never wrong, known in hindsight. certain: median time after \
         which no spikes can change the class (nsim run --early-exit certain), shipped networks. The paper: both \
         senses right by 100 ms, accurate within 80, above either sense; here both are below the better one from 60 to \
         100 ms, and on containers until 4,000 ms.",
    );
    let modelled = rows.iter().find(|row| row.table == "offline" && row.measured.is_some());
    modelled.iter().for_each(|row| out += &wrapped(&format!("Loihi's figures are {}.", row.note)));
    out + &wrapped(
        "Not shown: the appendix's table of containers on a second version of the data. Deviations, intervals and \
         notes: --full.",
    )
}

/// The tables that have rows, as text.
pub fn tables(rows: &[PaperRow]) -> String {
    let of = |name: &str| rows.iter().filter(|row| row.table == name).collect::<Vec<_>>();
    let all = TABLES.iter().map(|(name, title)| (title, of(name))).filter(|(_, rows)| !rows.is_empty());
    all.map(|(title, rows)| format!("{title}\n\n{}\n", table_with_notes(&rows))).collect()
}

/// A table, and its notes by their numbers.
fn table_with_notes(rows: &[&PaperRow]) -> String {
    let (mut notes, mut lines): (Vec<&str>, Vec<Vec<String>>) = Default::default();
    for row in rows {
        let known = notes.iter().position(|note| *note == row.note);
        let note = known.unwrap_or_else(|| {
            notes.push(&row.note);
            notes.len() - 1
        });
        let cell = format!("{} {} {}", row.task, row.modality, row.loss.as_deref().unwrap_or_default());
        let figures = [mean(row.published, row.published_deviation), mean(row.measured, row.deviation), interval(row)];
        let note = if row.note.is_empty() { String::new() } else { (note + 1).to_string() };
        lines.push([cell, row.quantity.clone()].into_iter().chain(figures).chain([note]).collect());
    }
    let is_modelled = rows.iter().all(|row| ["offline", "realtime"].contains(&&*row.table));
    let own_heading = if is_modelled { "modelled" } else { "measured" };
    let mut heads = vec!["cell", "quantity", "published", own_heading, "95 % interval", "note"];
    if lines.iter().all(|line| line[4].is_empty()) {
        heads.remove(4);
        lines.iter_mut().for_each(|line| drop(line.remove(4)));
    }
    let mut out = table(&heads, &lines);
    for (number, note) in (1..).zip(notes).filter(|(_, note)| !note.is_empty()) {
        out += &wrapped(&format!("{number}: {note}"));
    }
    out
}

/// Every figure, as text.
pub fn text(rows: &[PaperRow]) -> String {
    let accuracies = || rows.iter().filter(|row| row.table == "accuracy");
    let have = accuracies().filter(|row| row.measured.is_some()).count();
    let mut out = tables(rows);
    out += &wrapped(&format!("{have} cells of the table of accuracies are measured, on simulated scenes unless noted"));
    let run: Vec<&PaperRow> = accuracies().filter(|row| row.shipped.is_some()).collect();
    if !run.is_empty() {
        let same = run.iter().filter(|row| row.folds.first().copied() == row.shipped).count();
        out += &wrapped(&format!(
            "{} shipped networks, each the first fold of a cell, ran on simulated cores: {same} gave the stored result",
            run.len()
        ));
    }
    let mut leads = leads(rows);
    if !leads.is_empty() {
        leads.push(
            "A sense leads where its whole interval is above chance and above the other sense's interval.".to_string(),
        );
    }
    leads.into_iter().fold(out, |out, lead| out + &wrapped(&lead))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_study::published::paper::rows;

    #[test]
    fn every_form_has_every_table() {
        let rows = rows(Vec::new()).unwrap();
        assert_eq!(csv(&rows).lines().count(), rows.len() + 1);
        let text = text(&rows);
        assert!(TABLES.iter().all(|(_, title)| text.contains(title)), "{text}");
        assert!(text.contains("modelled") && text.contains("measured"), "{text}");
    }

    #[test]
    fn a_grid_has_every_printed_figure_of_its_table() {
        let rows = rows(Vec::new()).unwrap();
        let grids = grids(&rows);
        assert_eq!(grids.len(), 6);
        for (table, task, grid) in [("accuracy", "slip", 0), ("accuracy", "container", 1)] {
            assert_eq!((grids[grid].rows.len(), grids[grid].header.len()), (6, 5));
            for (at, (senses, _)) in SENSES.iter().enumerate() {
                let of = |row: &&PaperRow| row.table == table && row.task == task && row.modality == *senses;
                let row = rows.iter().filter(of).find(|row| row.loss.as_deref() == Some("weighted")).unwrap();
                let cell = format!("{:.3} ({:.2})", row.measured.unwrap(), row.published.unwrap());
                assert_eq!(grids[grid].rows[1][at + 1], cell);
            }
        }
        let gpu = rows.iter().find(|row| row.table == "offline" && row.quantity == "gpu_static_mw").unwrap();
        // Rows of a chip and of its two parts, of the other hardware, each in two modes.
        assert_eq!((grids[2].rows.len(), grids[3].rows.len()), (8, 4));
        assert_eq!((&*grids[2].rows[1][2], &*grids[3].rows[0][1]), ("1.03 (0.64)", "0.223 (0.22)"));
        assert_eq!(grids[0].rows[0][4], "500, 100, 20");
        assert_eq!(grids[2].rows[3][1], format!("- ({})", gpu.published.unwrap()));
        // Accuracy by time: of the chip's neurons, and of the neurons of the paper's curves.
        let early = |name: &str, by_80_ms: &str| {
            let at = grids[4].header.iter().position(|time| time == "80").unwrap();
            assert!(grids[4].rows.iter().any(|row| row[0] == name && row[at] == by_80_ms), "{name}");
        };
        early("both (L), chip", "0.92");
        early("both (L), SRM", "0.75");
        assert!(summary(&rows).lines().count() <= 88, "{}", summary(&rows));
        // With one sense a grid has one column of figures.
        let tactile: Vec<PaperRow> = rows.into_iter().filter(|row| row.modality == "tactile").collect();
        let grids = super::grids(&tactile);
        assert_eq!((grids.len(), grids[0].header.len()), (4, 3));
    }
}
