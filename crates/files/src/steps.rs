//! A table with a row for each timestep of each sample, written row by row.
//!
//! Input: columns, then rows of integers in the order of the run. Output: CSV with a header, or a
//! NumPy array of records whose fields are the columns. Memory does not grow with the rows. Times
//! and energies are counted in ps and fJ and written in us and pJ, in CSV with all digits, so that
//! sums over rows are exact.
//!
//! Errors: errors of the writer; an array with fewer or more rows than its header states.

use std::fmt::Write as _;
use std::io::{Error, Result, Write};
use std::path::Path;

use crate::npy;

/// The unit of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// A number without a unit.
    Count,
    /// Picoseconds, written as microseconds.
    Microseconds,
    /// Femtojoules, written as picojoules.
    Picojoules,
}

impl Unit {
    /// Number of stored units in a written unit.
    pub fn divisor(self) -> u64 {
        match self {
            Unit::Count => 1,
            Unit::Microseconds => 1_000_000,
            Unit::Picojoules => 1_000,
        }
    }
}

/// A column after `sample` and `timestep`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: Unit,
}

/// The file format of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepFormat {
    /// Comma-separated values.
    Csv,
    /// A NumPy array of records.
    Npy,
}

impl StepFormat {
    /// The format of a file name's extension; `None` when it is neither `csv` nor `npy`.
    pub fn from_name(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_string_lossy().to_ascii_lowercase();
        match extension.as_str() {
            "csv" => Some(StepFormat::Csv),
            "npy" => Some(StepFormat::Npy),
            _ => None,
        }
    }
}

/// Writer of a table.
pub struct StepWriter<'w> {
    out: &'w mut (dyn Write + Send),
    format: StepFormat,
    units: Vec<Unit>,
    /// Rows that the header states, for arrays.
    promised: Option<u64>,
    rows: u64,
    sample: u32,
    step: u32,
    /// The first error, after which nothing is written.
    failed: Option<Error>,
    line: Vec<u8>,
}

impl<'w> StepWriter<'w> {
    /// Begins a table of `rows` rows; CSV may have an unknown number of them.
    ///
    /// # Errors
    /// Errors of the writer; an array with an unknown number of rows.
    pub fn new(
        out: &'w mut (dyn Write + Send),
        format: StepFormat,
        columns: &[Column],
        rows: Option<u64>,
    ) -> Result<StepWriter<'w>> {
        let units: Vec<Unit> = columns.iter().map(|column| column.unit).collect();
        let promised = rows.filter(|_| format == StepFormat::Npy);
        match (format, rows) {
            (StepFormat::Csv, _) => {
                let mut header = csv::Writer::from_writer(&mut *out);
                let names = columns.iter().map(|column| column.name.as_str());
                header.write_record(["sample", "timestep"].into_iter().chain(names)).map_err(Error::other)?;
                header.flush()?;
            }
            (StepFormat::Npy, Some(rows)) => out.write_all(&npy::header(&record(columns), &[rows])?)?,
            (StepFormat::Npy, None) => return Err(Error::other("an array needs its number of rows")),
        }
        Ok(StepWriter { out, format, units, promised, rows: 0, sample: 0, step: 0, failed: None, line: Vec::new() })
    }

    /// Writes the row of the sample's next timestep.
    pub fn row(&mut self, cells: &[u64]) {
        if self.failed.is_some() {
            return;
        }
        self.line.clear();
        match self.format {
            StepFormat::Csv => self.csv_line(cells),
            StepFormat::Npy => {
                self.line.extend(self.sample.to_le_bytes());
                self.line.extend(self.step.to_le_bytes());
                for (unit, &cell) in self.units.iter().zip(cells) {
                    match unit {
                        Unit::Count => self.line.extend(cell.to_le_bytes()),
                        unit => self.line.extend((cell as f64 / unit.divisor() as f64).to_le_bytes()),
                    }
                }
            }
        }
        self.failed = self.out.write_all(&self.line).err();
        self.rows += 1;
        self.step += 1;
    }

    fn csv_line(&mut self, cells: &[u64]) {
        let mut line = format!("{},{}", self.sample, self.step);
        for (unit, &cell) in self.units.iter().zip(cells) {
            let (whole, part) = (cell / unit.divisor(), cell % unit.divisor());
            // Writing to a String never fails.
            let _ = match unit {
                Unit::Count => write!(line, ",{cell}"),
                Unit::Microseconds => write!(line, ",{whole}.{part:06}"),
                Unit::Picojoules => write!(line, ",{whole}.{part:03}"),
            };
        }
        line.push('\n');
        self.line.extend_from_slice(line.as_bytes());
    }

    /// Ends a sample.
    pub fn end_sample(&mut self) {
        self.sample += 1;
        self.step = 0;
    }

    /// Whether no error has occurred.
    pub fn is_sound(&self) -> bool {
        self.failed.is_none()
    }

    /// Ends the table.
    ///
    /// # Errors
    /// The first error of the writer; fewer or more rows than the header states.
    pub fn finish(self) -> Result<()> {
        match (self.failed, self.promised) {
            (Some(error), _) => Err(error),
            (None, Some(rows)) if rows != self.rows => {
                Err(Error::other(format!("the table has {} rows, but its header states {rows}", self.rows)))
            }
            _ => Ok(()),
        }
    }
}

/// The type of the records of an array.
fn record(columns: &[Column]) -> String {
    let mut fields = "[('sample', '<u4'), ('timestep', '<u4')".to_string();
    for Column { name, unit } in columns {
        let name = name.replace('\\', "\\\\").replace('\'', "\\'");
        let kind = if *unit == Unit::Count { "<u8" } else { "<f8" };
        let _ = write!(fields, ", ('{name}', '{kind}')");
    }
    fields + "]"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> Vec<Column> {
        let named =
            [("spikes.a,b", Unit::Count), ("time_us.barrier", Unit::Microseconds), ("energy_pj.hop", Unit::Picojoules)];
        named.map(|(name, unit)| Column { name: name.to_string(), unit }).into()
    }

    fn written(format: StepFormat, rows: Option<u64>) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut table = StepWriter::new(&mut out, format, &columns(), rows)?;
        table.row(&[3, 1_000_001, 5]);
        table.row(&[0, 0, 12_340]);
        table.end_sample();
        table.row(&[7, 999_999, 1_000]);
        table.finish().map(|()| out)
    }

    #[test]
    fn csv_keeps_all_digits() {
        let text = String::from_utf8(written(StepFormat::Csv, None).unwrap()).unwrap();
        let header = "sample,timestep,\"spikes.a,b\",time_us.barrier,energy_pj.hop\n";
        assert_eq!(text, format!("{header}0,0,3,1.000001,0.005\n0,1,0,0.000000,12.340\n1,0,7,0.999999,1.000\n"));
    }

    #[test]
    fn an_array_holds_records_and_its_promise() {
        let bytes = written(StepFormat::Npy, Some(3)).unwrap();
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(((10 + length) % 64, bytes.len() - 10 - length), (0, 3 * 32));
        let header = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
        assert!(
            header.contains("('spikes.a,b', '<u8'), ('time_us.barrier', '<f8')") && header.contains("(3,)"),
            "{header}"
        );
        assert_eq!(bytes[10 + length + 64..][..8], [1, 0, 0, 0, 0, 0, 0, 0], "sample 1, step 0");
        assert!(written(StepFormat::Npy, Some(4)).is_err() && written(StepFormat::Npy, None).is_err());
    }

    #[test]
    fn a_name_says_the_form() {
        let form = |name: &str| StepFormat::from_name(Path::new(name));
        assert_eq!((form("a.csv"), form("b/a.NPY")), (Some(StepFormat::Csv), Some(StepFormat::Npy)));
        assert_eq!((form("a.txt"), form("csv"), form("a.parquet")), (None, None, None));
    }
}
