//! Reads a file or a folder of recordings; manifests stand above, in [`super::source`].

use std::path::Path;

use rayon::prelude::*;

use super::detect::{EventFormat, SpikeFormat, unknown};
use super::events::nir_data;
use super::events::read::{read_file, report};
use super::folder::list_folder;
use super::options::{EventOptions, Polarity};
use super::population::{Expected, PopulationSpikes};
use super::{array, csv, npz};
use crate::base::diagnostic::{Diagnostic, Result};
use crate::io::budget::MOST_ARRAY;
use crate::io::foreign::hdf5;
use crate::io::npy;
use crate::io::text::read_bytes;

/// What the recordings of a source are read for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Request<'a> {
    /// The name of the population.
    pub(super) population: &'a str,
    pub(super) expected: &'a Expected,
    /// What stands after the `?` of the source.
    pub(super) options: &'a EventOptions,
}

/// Reads a file or a folder for a population.
///
/// # Errors
/// `input.kind` for another kind of file; `input.option` for an option that an array does not take; `input.*`, `npy.*`,
/// `hdf5.*`, `io.*`.
pub(super) fn read(path: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let Request { expected, options, .. } = request;
    let (format, units) = (SpikeFormat::detect(path), expected.units);
    match format {
        Some(SpikeFormat::Folder) => return read_folder(path, request),
        Some(SpikeFormat::Events(format)) => return read_recording(path, format, request),
        Some(SpikeFormat::NirData) => return read_nir_data(path, request),
        Some(SpikeFormat::Archive) => {
            return npz::read(path, request.population, units, array_polarity(path, options)?);
        }
        Some(SpikeFormat::Csv) if csv::holds_events(path)? => {
            return read_recording(path, EventFormat::Text, request);
        }
        Some(SpikeFormat::Array) => {
            return array::from_array(&npy::open(path)?, units, array_polarity(path, options)?);
        }
        _ => takes_no_options(path, options)?,
    }
    match format {
        Some(SpikeFormat::Csv) => csv::read(path, units),
        Some(SpikeFormat::Pipe) => {
            let bytes = read_bytes(path, MOST_ARRAY)?;
            match SpikeFormat::from_bytes(&bytes) {
                SpikeFormat::Array => array::from_array(&npy::Array::from_bytes(path, bytes)?, units, Polarity::Both),
                _ => csv::from_bytes(path, bytes, units),
            }
        }
        Some(SpikeFormat::Manifest) => {
            Err(Diagnostic::new("input.kind", "a data set cannot be a recording of another data set").in_file(path))
        }
        _ => Err(unknown(path)),
    }
}

/// Refuses options for a source that takes none.
pub(super) fn takes_no_options(path: &Path, options: &EventOptions) -> Result<()> {
    if *options == EventOptions::default() {
        return Ok(());
    }
    Err(Diagnostic::new(
        "input.kind",
        "options after '?' are for recordings of events, for arrays (polarity) and for scenes",
    )
    .help("recordings are .bin, .bs1, .bs2, .dat, .raw, .aedat4, .tact and NIR data (.nir)")
    .in_file(path))
}

/// The only option that an array takes.
fn array_polarity(path: &Path, options: &EventOptions) -> Result<Polarity> {
    let polarity = options.polarity;
    if *options == (EventOptions { polarity, ..EventOptions::default() }) {
        return Ok(polarity);
    }
    Err(Diagnostic::new("input.option", "an array has timesteps already: polarity is the only option that it takes")
        .in_file(path))
}

/// Reads a recording of events and logs what was left out.
fn read_recording(path: &Path, format: EventFormat, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let (spikes, counts) = read_file(path, format, request.expected, request.options)?;
    report(path, &counts);
    Ok(vec![spikes])
}

fn read_nir_data(path: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let tree = hdf5::tree(path, read_bytes(path, MOST_ARRAY)?)?;
    if !nir_data::is_data(&tree) {
        return Err(Diagnostic::new("input.kind", "this is no file of NIR data")
            .in_file(path)
            .help("nir.write_data makes one; a NIR graph is a model, not a recording"));
    }
    let Request { population, expected, options } = request;
    nir_data::read(&tree, path, population, expected, options).map_err(|problem| problem.or_in_file(path))
}

/// Reads a folder of `sample_<i>_label_<c>.npy` or of recordings of events; other files are left alone.
fn read_folder(folder: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let read: Vec<_> = list_folder(folder)?
        .into_par_iter()
        .map(|(_, label, path)| {
            let mut recording = read_sample(&path, request)?;
            recording.label = label;
            Ok(recording)
        })
        .collect();
    // The first problem in order of the samples, whichever thread met one first.
    read.into_iter().collect()
}

/// Reads a source that holds exactly one sample.
pub(super) fn read_sample(path: &Path, request: Request<'_>) -> Result<PopulationSpikes> {
    use SpikeFormat::{Archive, Array, Csv, Events, NirData};
    if !matches!(SpikeFormat::from_name(path), Some(Array | Archive | Csv | Events(_) | NirData)) {
        return Err(Diagnostic::new(
            "input.kind",
            "a sample of a data set is a .npy or a .csv file, or a recording of events",
        )
        .in_file(path));
    }
    let mut recordings = read(path, request)?;
    match (recordings.pop(), recordings.len()) {
        (Some(recording), 0) => Ok(recording),
        (_, rest) => {
            Err(Diagnostic::new("input.shape", format!("one sample is expected; the file holds {}", rest + 1))
                .in_file(path))
        }
    }
}
