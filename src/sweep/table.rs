//! The table of a sweep: a row for each variant, and how it lies on the disk.
//!
//! Input: rows by number of variant, as they were run, read from a journal or from the tables of shards. Output: CSV,
//! sorted by variant, the same bytes whatever the order in which rows came. Columns: `variant`, what varies, [`FIGURES`].
//!
//! Errors: `sweep.shard` for a table of other work, a variant that is missing or there twice.

use std::collections::BTreeMap;
use std::path::Path;

use crate::base::diagnostic::{Diagnostic, Result};
use crate::io::write::Batch;
use crate::sweep::row::{Cells, FIGURES};
use crate::sweep::variants::Sweep;

/// Rows by number of variant.
#[derive(Debug)]
pub struct Table<'s> {
    sweep: &'s Sweep,
    /// The cells of each variant that has been run.
    pub rows: BTreeMap<u64, Cells>,
}

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("sweep.shard", message)
}

/// A row as a journal keeps it.
#[must_use]
pub fn line(variant: u64, cells: &Cells) -> String {
    format!("{variant},{}", cells.join(","))
}

/// A row from a journal.
#[must_use]
pub fn from_line(line: &str) -> Option<(u64, Cells)> {
    let (variant, cells) = line.split_once(',')?;
    let cells: Vec<String> = cells.split(',').map(str::to_string).collect();
    Some((variant.parse().ok()?, cells.try_into().ok()?))
}

impl<'s> Table<'s> {
    /// A table without rows.
    #[must_use]
    pub fn new(sweep: &'s Sweep) -> Self {
        Table { sweep, rows: BTreeMap::new() }
    }

    /// Names of the columns.
    #[must_use]
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

    /// The table as CSV.
    ///
    /// # Errors
    /// When memory cannot be written, which does not happen.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record(self.columns())?;
        self.records().try_for_each(|record| out.write_record(record))?;
        let bytes = out.into_inner().map_err(csv::IntoInnerError::into_error)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Adds the rows of a shard's table.
    ///
    /// # Errors
    /// `sweep.shard` when it is of another sweep, or has a variant that is here already.
    pub fn add_csv(&mut self, text: &str) -> Result<()> {
        let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text.as_bytes());
        let mut records = reader.records();
        let mut next = || records.next().transpose().map_err(|error| wrong(format!("no table: {error}")));
        let columns = self.columns();
        if next()?.is_none_or(|head| head.iter().ne(columns.iter().copied())) {
            return Err(wrong("its columns are not those of this sweep"));
        }
        while let Some(record) = next()? {
            let variant: u64 = record.get(0).and_then(|cell| cell.parse().ok()).unwrap_or(u64::MAX);
            if variant >= self.sweep.len() || record.len() != columns.len() {
                return Err(wrong(format!("{} is no variant of this sweep", record.get(0).unwrap_or_default())));
            }
            let values = self.sweep.values(variant);
            if values.iter().copied().ne(record.iter().skip(1).take(values.len())) {
                return Err(wrong(format!("variant {variant} has other values in this sweep")));
            }
            let mut cells = Cells::default();
            let given = record.iter().skip(1 + values.len());
            cells.iter_mut().zip(given).for_each(|(cell, given)| *cell = given.to_string());
            if self.rows.insert(variant, cells).is_some() {
                return Err(wrong(format!("variant {variant} is there twice")));
            }
        }
        Ok(())
    }

    /// Whether every variant has a row.
    ///
    /// # Errors
    /// `sweep.shard` with the first that is missing.
    pub fn check_whole(&self) -> Result<()> {
        let missing = (0..self.sweep.len()).find(|variant| !self.rows.contains_key(variant));
        match missing {
            Some(variant) => {
                let left = self.sweep.len() - self.rows.len() as u64;
                Err(wrong(format!("variant {variant} has no row, and {left} in all have none")))
            }
            None => Ok(()),
        }
    }

    /// Adds the table to the files that are to be written.
    ///
    /// # Errors
    /// `write.*`.
    pub fn write(&self, path: &Path, batch: &mut Batch) -> Result<()> {
        let text = self.csv().map_err(|error| Diagnostic::new("write.failed", error.to_string()).in_file(path))?;
        batch.add(path, |out| out.write_all(text.as_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::diagnostic::SourceText;

    #[test]
    fn shards_make_the_table_that_they_are_of() {
        let text = r#"Sweep(grid: [(paths: ["model"], values: ["a,b", "c"]), (paths: ["target"], values: ["x"])])"#;
        let sweep = Sweep::parse(&SourceText::new("s", text)).unwrap();
        let row = |text: &str| Cells::from(FIGURES.map(|name| format!("{name}{text}")));
        let mut whole = Table::new(&sweep);
        whole.rows.extend([(1, row("B")), (0, row("A"))]);
        let csv = whole.csv().unwrap();
        let mut shards = [Table::new(&sweep), Table::new(&sweep)];
        shards[0].rows.insert(1, row("B"));
        shards[1].rows.insert(0, row("A"));
        let mut merged = Table::new(&sweep);
        merged.add_csv(&shards[0].csv().unwrap()).unwrap();
        assert!(merged.check_whole().unwrap_err().message.contains("variant 0"));
        merged.add_csv(&shards[1].csv().unwrap()).unwrap();
        merged.check_whole().unwrap();
        assert_eq!(merged.csv().unwrap(), csv);
        assert!(merged.add_csv(&csv).unwrap_err().message.contains("twice"));
        for (from, to) in [("variant,model", "variant,modell"), ("1,c", "1,d"), ("1,c", "7,c"), ("0,", "x,")] {
            let changed = csv.replacen(from, to, 1);
            assert_eq!(Table::new(&sweep).add_csv(&changed).unwrap_err().code, "sweep.shard", "{changed}");
        }
        assert_eq!(from_line(&line(7, &row("C"))), Some((7, row("C"))));
        assert_eq!(from_line("7,a"), None);
    }
}
