//! Recorded random numbers of learning, in an archive of NumPy arrays.
//!
//! Input: an `.npz` with arrays named as [`Use`]. Output: the numbers of each. Other arrays are
//! ignored. Errors: `input.npz`; `run.draws` for numbers out of range; errors of arrays.

use std::io::{Cursor, Write};
use std::path::Path;

use zip::write::{SimpleFileOptions, ZipWriter};

use crate::spikes::npz::Archive;
use nsim_files::budget::MOST_ARRAY;
use nsim_files::npy;
use nsim_files::text::read_bytes;
use nsim_files::write::Batch;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::learning::draws::{Recorded, Use};

/// Reads the numbers of a file.
///
/// # Errors
/// As the module says.
pub fn read_draws(path: &Path) -> Result<Recorded> {
    let mut archive = Archive::open(path, read_bytes(path, MOST_ARRAY)?)?;
    let mut recorded = Recorded::new();
    for of in Use::ALL {
        if !archive.names().any(|name| name == of.name()) {
            continue;
        }
        let numbers: Vec<f64> = archive.array(of.name())?.tensor()?.reals().collect();
        if let Some(message) = of.unfit(&numbers) {
            return Err(Diagnostic::new("run.draws", message).in_file(path).help("record the numbers again"));
        }
        recorded.insert(of, numbers);
    }
    Ok(recorded)
}

/// Writes the numbers of a rule with these numbers of sources and targets.
///
/// # Errors
/// `write.*`.
pub fn write_draws(path: &Path, recorded: &Recorded, (sources, targets): (u32, u32), batch: &mut Batch) -> Result<()> {
    let wrong = |error: &dyn std::fmt::Display| {
        Diagnostic::new("write.failed", format!("cannot be written: {error}")).in_file(path)
    };
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (of, numbers) in recorded {
        let of_each: Vec<u64> = match of {
            Use::Trace => vec![sources.into()],
            Use::Weight => vec![sources.into(), targets.into()],
            _ => Vec::new(),
        };
        let count = numbers.len() as u64 / of_each.iter().product::<u64>().max(1);
        let (shape, mut bytes) = ([vec![count], of_each].concat(), Vec::new());
        let written = match of.is_whole() {
            true => npy::write(&mut bytes, &shape, numbers.iter().map(|&number| number as u8)),
            false => npy::write(&mut bytes, &shape, numbers.iter().copied()),
        };
        written.map_err(|error| wrong(&error))?;
        zip.start_file(format!("{}.npy", of.name()), SimpleFileOptions::default()).map_err(|error| wrong(&error))?;
        zip.write_all(&bytes).map_err(|error| wrong(&error))?;
    }
    let bytes = zip.finish().map_err(|error| wrong(&error))?.into_inner();
    batch.add(path, |out| out.write_all(&bytes))
}
