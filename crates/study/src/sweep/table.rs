//! The table of a sweep: a row for each variant, and its file format.
//!
//! Input: rows by number of variant, as they were run, read from a journal or from the tables of
//! shards. Output: CSV, sorted by variant, with the same bytes for any order of input. Columns:
//! `variant`, the varied values, [`FIGURES`]; where a front is requested, whether a row is on it.
//! The table of a shard has one more, a checksum of each row. The name of this column has a digest
//! of the rows' source files.
//!
//! Errors: `sweep.shard` for a table of another sweep, a truncated or changed one, a variant that
//! is missing or repeated.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::sweep::row::Cells;
use crate::sweep::variants::{FIGURES, FRONT, Sweep};
use nsim_files::table::csv_text;
use nsim_files::text::sha256;
use nsim_files::write::Batch;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// Rows by number of variant.
#[derive(Debug)]
pub struct Table<'s> {
    sweep: &'s Sweep,
    /// The cells of each variant that has been run.
    pub rows: BTreeMap<u64, Cells>,
    /// The variants on the front, where one is asked for.
    pub front: Option<BTreeSet<u64>>,
}

/// Prefix of the checksum column's name; a digest of the rows' sources follows.
const CHECKSUM: &str = "checksum of ";

/// The name of the column of checksums, for rows that were made from files of this digest.
pub fn checksum_column(work: &str) -> String {
    format!("{CHECKSUM}{}", work.get(..16).unwrap_or(work))
}

fn checksum(column: &str, record: &[String]) -> String {
    sha256(format!("{column}\n{}", record.join("\n")).as_bytes())[..16].to_string()
}

/// The first figure of a row that [`crate::sweep::row::Runner::row`] would not write.
fn first_wrong(cells: &Cells) -> Option<&'static str> {
    let failed = !cells[0].is_empty();
    let is_number =
        |cell: &String| cell.parse().is_ok_and(|number: f64| number.is_finite() && number.to_string() == *cell);
    let is_right = |(name, cell): (&str, &String)| match name {
        "error" => cell.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || ".-".contains(c)),
        "fits" if failed => ["", "false"].contains(&cell.as_str()),
        "fits" => cell == "true",
        "reason" => failed != cell.is_empty() && !cell.contains(char::is_control),
        "tightest" => !cell.contains(char::is_control) && (failed || !cell.is_empty()),
        "used_percent" if failed && cell.is_empty() => true,
        "used_percent" => is_number(cell),
        _ if failed => cell.is_empty(),
        "digest" => cell.len() == 64 && cell.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f')),
        // Samples without labels have no accuracy, those without steps no costs.
        "accuracy" | "accuracy_low" | "accuracy_high" | "static_mw" | "dynamic_mw" | "total_mw" | "latency_us"
        | "energy_uj" | "edp_pjs" | "neuron_dynamic_uj" | "job_mw" => cell.is_empty() || is_number(cell),
        _ => cell.parse().is_ok_and(|number: u64| number.to_string() == *cell),
    };
    FIGURES.into_iter().zip(cells).find(|&one| !is_right(one)).map(|(name, _)| name)
}

fn wrong(message: impl Into<String>) -> Diagnostic {
    let help = "give each part of this sweep once, as nsim wrote it; nsim sweep SWEEP.ron --shard I/N -o FILE.csv \
                makes one again";
    Diagnostic::new("sweep.shard", message).help(help)
}

/// A row for a journal: one record of CSV.
pub fn line(variant: u64, cells: &Cells) -> String {
    let record = std::iter::once(variant.to_string()).chain(cells.iter().cloned()).collect();
    csv_text(record, std::iter::empty()).trim_end().to_string()
}

/// A row from a journal.
pub fn from_line(line: &str) -> Option<(u64, Cells)> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
    let record = reader.records().next()?.ok()?;
    let cells: Vec<String> = record.iter().skip(1).map(str::to_string).collect();
    Some((record.get(0)?.parse().ok()?, cells.try_into().ok()?))
}

impl<'s> Table<'s> {
    /// A table without rows.
    pub fn new(sweep: &'s Sweep) -> Self {
        Table { sweep, rows: BTreeMap::new(), front: None }
    }

    /// The sweep of the table.
    pub fn sweep(&self) -> &'s Sweep {
        self.sweep
    }

    /// Names of the columns.
    pub fn columns(&self) -> Vec<&'s str> {
        std::iter::once("variant").chain(self.sweep.columns()).chain(FIGURES).collect()
    }

    /// The cells of each row, in order.
    pub fn records(&self) -> impl Iterator<Item = Vec<String>> {
        self.rows.iter().map(|(&variant, cells)| {
            let values = self.sweep.values(variant).into_iter().map(str::to_string);
            std::iter::once(variant.to_string()).chain(values).chain(cells.iter().cloned()).collect()
        })
    }

    /// Number and values of each row, in order, and whether it is on the front.
    pub fn places(&self) -> impl Iterator<Item = (u64, String, bool)> {
        self.rows.keys().map(|&variant| {
            let on_front = self.front.as_ref().is_some_and(|front| front.contains(&variant));
            (variant, self.sweep.values(variant).join(", "), on_front)
        })
    }

    /// The table as CSV, with a column of checksums if one is named.
    pub fn csv(&self, checksums: Option<&str>) -> String {
        let front = self.front.as_ref().map(|_| FRONT);
        let header = self.columns().into_iter().chain(front).chain(checksums).map(str::to_string).collect();
        let rows = self.records().zip(self.places()).map(|(mut record, (.., on_front))| {
            record.extend(front.map(|_| on_front.to_string()));
            record.extend(checksums.map(|column| checksum(column, &record)));
            record
        });
        csv_text(header, rows)
    }

    /// Adds the rows of a shard's table; returns whether they have checksums. `expected` is the
    /// [`checksum_column`] of this sweep and its files, without which only a whole table is added.
    ///
    /// # Errors
    /// `sweep.shard` for a table of another sweep or of other files, truncated, changed, repeated.
    pub fn add_csv(&mut self, text: &str, expected: Option<&str>) -> Result<bool> {
        if !text.ends_with('\n') {
            return Err(wrong("the part is truncated: its last line has no end"));
        }
        let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text.as_bytes());
        let mut records = reader.records();
        let mut next = || records.next().transpose().map_err(|error| wrong(format!("not a table: {error}")));
        let columns: Vec<String> = self.columns().into_iter().map(str::to_string).collect();
        let head: Vec<String> = next()?.iter().flatten().map(str::to_string).collect();
        let column = head.last().filter(|name| head.len() > columns.len() && name.starts_with(CHECKSUM)).cloned();
        // A whole table has a front column, which is computed again.
        let drawn = head.get(columns.len()).is_some_and(|name| name == FRONT);
        let others = usize::from(column.is_some()) + usize::from(drawn);
        if head.len() != columns.len() + others || !head.starts_with(&columns) {
            return Err(wrong("its columns differ from the columns of this sweep"));
        }
        if column.is_some() && column.as_deref() != expected {
            return Err(wrong(
                "its rows are of another sweep: of other files, other options or --set, or by another version of nsim",
            ));
        }
        let before = self.rows.len();
        while let Some(record) = next()? {
            let mut record: Vec<String> = record.iter().map(str::to_string).collect();
            let name = record.first().cloned().unwrap_or_default();
            let sum = column.as_ref().and_then(|_| record.pop());
            if drawn {
                record.pop();
            }
            let variant = name.parse().unwrap_or(u64::MAX);
            if variant >= self.sweep.len() || record.len() != columns.len() {
                return Err(wrong(format!("{name} is not a variant of this sweep")));
            }
            if column.as_deref().is_some_and(|column| sum != Some(checksum(column, &record))) {
                return Err(wrong(format!("the row of variant {name} was changed: its checksum does not match")));
            }
            let values = self.sweep.values(variant);
            if values.iter().ne(record.iter().skip(1).take(values.len())) {
                return Err(wrong(format!("variant {variant} has other values in this sweep")));
            }
            let mut cells = Cells::default();
            cells.iter_mut().zip(record.drain(1 + values.len()..)).for_each(|(cell, given)| *cell = given);
            if let Some(figure) = first_wrong(&cells) {
                return Err(wrong(format!("variant {variant}: nsim cannot have written its cell in column {figure}")));
            }
            if self.rows.insert(variant, cells).is_some() {
                return Err(wrong(format!("variant {variant} is given twice")));
            }
        }
        if column.is_none() && expected.is_some() && (before > 0 || self.rows.len() as u64 != self.sweep.len()) {
            return Err(wrong("its rows have no checksums, so it is not known whether they are of this sweep"));
        }
        Ok(column.is_some())
    }

    /// Checks that every variant has a row.
    ///
    /// # Errors
    /// `sweep.shard` with the first that is missing.
    pub fn check_whole(&self) -> Result<()> {
        let missing = (0..self.sweep.len()).find(|variant| !self.rows.contains_key(variant));
        let Some(variant) = missing else { return Ok(()) };
        let left = self.sweep.len() - self.rows.len() as u64;
        Err(wrong(format!("variant {variant} has no row; variants without a row: {left}")))
    }

    /// Adds the table, as by [`Self::csv`], to a batch of files.
    ///
    /// # Errors
    /// `write.*`.
    pub fn write(&self, path: &Path, checksums: Option<&str>, batch: &mut Batch) -> Result<()> {
        batch.add(path, |out| out.write_all(self.csv(checksums).as_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::diagnostic::SourceText;

    #[test]
    fn shards_make_the_table_that_they_are_of() {
        let text = r#"Sweep(grid: [(paths: ["model"], values: ["a,b", "c"]), (paths: ["target"], values: ["x"])])"#;
        let sweep = Sweep::parse(&SourceText::new("s", text)).unwrap();
        let row = |spikes: &str| {
            Cells::from(FIGURES.map(|name| match name {
                "error" => String::new(),
                "fits" => "true".to_string(),
                "digest" => "0a".repeat(32),
                "edp_pjs" => "0.158".to_string(),
                "reason" => String::new(),
                _ => spikes.to_string(),
            }))
        };
        let mut whole = Table::new(&sweep);
        whole.rows.extend([(1, row("12")), (0, row("34"))]);
        let csv = whole.csv(None);
        let mut shards = [Table::new(&sweep), Table::new(&sweep)];
        shards[0].rows.insert(1, row("12"));
        shards[1].rows.insert(0, row("34"));
        let (column, other) = (checksum_column(&"ab".repeat(32)), checksum_column("other"));
        for checksums in [None, Some(column.as_str())] {
            let mut merged = Table::new(&sweep);
            assert_eq!(merged.add_csv(&shards[0].csv(checksums), checksums).unwrap(), checksums.is_some());
            assert!(merged.check_whole().unwrap_err().message.contains("variant 0"));
            merged.add_csv(&shards[1].csv(checksums), checksums).unwrap();
            merged.check_whole().unwrap();
            assert_eq!(merged.csv(None), csv);
            assert!(merged.add_csv(&whole.csv(checksums), checksums).unwrap_err().message.contains("twice"));
            // Cut anywhere, a part is refused or lacks a variant.
            let part = whole.csv(checksums);
            for end in 0..part.len() {
                let mut cut = Table::new(&sweep);
                assert!(
                    cut.add_csv(&part[..end], checksums).and_then(|_| cut.check_whole()).is_err(),
                    "{}",
                    &part[..end]
                );
            }
        }
        let mut merged = Table::new(&sweep);
        let foreign = shards[0].csv(Some(&other));
        assert!(merged.add_csv(&foreign, Some(&column)).unwrap_err().message.contains("other files"));
        assert!(merged.add_csv(&shards[0].csv(None), Some(&column)).unwrap_err().message.contains("no checksums"));
        // Only a whole table, which is drawn again, needs none.
        assert!(!Table::new(&sweep).add_csv(&csv, Some(&column)).unwrap());
        let summed = whole.csv(Some(&column));
        for (from, to) in [("34", "35"), ("0.158", "0.159"), ("0a0a", "0a0b"), ("true", "tru"), ("ab", "ac")] {
            let changed = summed.replacen(from, to, 1);
            assert_eq!(
                Table::new(&sweep).add_csv(&changed, Some(&column)).unwrap_err().code,
                "sweep.shard",
                "{changed}"
            );
        }
        for (from, to) in [("variant,model", "variant,modell"), ("1,c", "1,d"), ("1,c", "7,c"), ("0,", "x,")]
            .into_iter()
            .chain([("0.158", "0."), ("0.158", "NaN"), ("0.158", "inf"), ("true", ""), ("34", "-34"), ("0a0a", "0A0a")])
        {
            let changed = csv.replacen(from, to, 1);
            assert_eq!(Table::new(&sweep).add_csv(&changed, None).unwrap_err().code, "sweep.shard", "{changed}");
        }
        assert_eq!(from_line(&line(7, &row("5"))), Some((7, row("5"))));
        assert_eq!(from_line("7,a"), None);
    }
}
