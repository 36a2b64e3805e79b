//! A table of timesteps as Parquet, written in groups of rows as they come.
//!
//! Input: columns and rows of integers, as for the other forms of the table. Output: a Parquet file
//! with `sample` and `timestep` as 32-bit integers, counts as 64-bit integers and the rest as
//! doubles. Memory holds one group of rows and, of each that is written, where it lies.

use std::io::{Error, Result, Write};
use std::sync::Arc;

use parquet::basic::{Repetition, Type as Physical};
use parquet::data_type::{DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::column::{Column, Unit};

/// Numbers of a group of rows, 8 bytes each.
const CELLS: usize = 1 << 20;

/// A file that is being written.
pub(super) struct ParquetTable<'w> {
    file: SerializedFileWriter<&'w mut (dyn Write + Send)>,
    units: Vec<Unit>,
    /// Sample and timestep of each row.
    places: [Vec<i32>; 2],
    /// Rows that are not written yet, one after the other.
    cells: Vec<u64>,
}

fn other(error: ParquetError) -> Error {
    Error::other(error)
}

impl<'w> ParquetTable<'w> {
    pub(super) fn new(out: &'w mut (dyn Write + Send), columns: &[Column]) -> Result<Self> {
        let field = |name: &str, kind: Physical| {
            let field = Type::primitive_type_builder(name, kind).with_repetition(Repetition::REQUIRED);
            field.build().map(Arc::new).map_err(other)
        };
        let mut fields = vec![field("sample", Physical::INT32)?, field("timestep", Physical::INT32)?];
        for Column { name, unit } in columns {
            fields.push(field(name, if *unit == Unit::Count { Physical::INT64 } else { Physical::DOUBLE })?);
        }
        let schema = Type::group_type_builder("steps").with_fields(fields).build().map_err(other)?;
        let properties = WriterProperties::builder().build();
        let file = SerializedFileWriter::new(out, schema.into(), properties.into()).map_err(other)?;
        let units = columns.iter().map(|column| column.unit).collect();
        Ok(ParquetTable { file, units, places: [Vec::new(), Vec::new()], cells: Vec::new() })
    }

    pub(super) fn row(&mut self, sample: u32, step: u32, cells: &[u64]) -> Result<()> {
        self.places[0].push(sample as i32);
        self.places[1].push(step as i32);
        self.cells.extend(cells);
        if self.cells.len() + 2 * self.places[0].len() >= CELLS { self.flush().map_err(other) } else { Ok(()) }
    }

    fn flush(&mut self) -> std::result::Result<(), ParquetError> {
        if self.places[0].is_empty() {
            return Ok(());
        }
        let mut group = self.file.next_row_group()?;
        let mut at = 0usize;
        while let Some(mut column) = group.next_column()? {
            match at.checked_sub(2) {
                None => column.typed::<Int32Type>().write_batch(&self.places[at], None, None)?,
                Some(index) => {
                    let unit = self.units[index];
                    let cells = self.cells.iter().skip(index).step_by(self.units.len());
                    if unit == Unit::Count {
                        let counts: Vec<i64> = cells.map(|&count| i64::try_from(count).unwrap_or(i64::MAX)).collect();
                        column.typed::<Int64Type>().write_batch(&counts, None, None)?
                    } else {
                        let numbers: Vec<f64> = cells.map(|&cell| cell as f64 / unit.divisor() as f64).collect();
                        column.typed::<DoubleType>().write_batch(&numbers, None, None)?
                    }
                }
            };
            column.close()?;
            at += 1;
        }
        group.close()?;
        self.places.iter_mut().for_each(Vec::clear);
        self.cells.clear();
        Ok(())
    }

    pub(super) fn finish(mut self) -> Result<()> {
        self.flush().map_err(other)?;
        self.file.close().map(|_| ()).map_err(other)
    }
}
