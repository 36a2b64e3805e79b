//! Reads a file or a folder of recordings; [`super::source`] reads manifests.

use std::path::Path;

use rayon::prelude::*;

use super::events::nir_data;
use super::events::read::{RECORDING, read_file, read_input, report};
use super::folder::list_folder;
use super::options::{ArrayOptions, EventOptions};
use super::population::{InputSpec, PopulationSpikes};
use super::{array, csv, npz};
use crate::hdf5;
use crate::kind::{FileKind, RECORDINGS};
use nsim_files::budget::MOST_ARRAY;
use nsim_files::npy;
use nsim_files::text::read_bytes;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::{Warning, WarningCode};

/// The population and the options for which a source is read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Request<'a> {
    pub(super) population: &'a str,
    pub(super) expected: &'a InputSpec,
    /// The options after the `?` of the source.
    pub(super) options: &'a EventOptions,
}

/// The warning that recordings of a population were changed: the first of them, and the number of
/// the others, which are logged.
pub fn warning_of_changes(population: &str, recordings: &[PopulationSpikes]) -> Option<Warning> {
    let mut changed = recordings.iter().filter_map(|recording| recording.changes.as_ref());
    let mut message = changed.next()?.clone();
    let others = changed.inspect(|line| tracing::info!(target: RECORDING, "{line}")).count();
    if others > 0 {
        message += &format!(" (and {others} more recordings were changed)");
    }
    Some(Warning::of_population(WarningCode::EventsChanged, population, message))
}

/// Reads a file or a folder for a population.
pub(super) fn read(path: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let Request { expected, options, .. } = request;
    let units = expected.units;
    match FileKind::detect(path)? {
        FileKind::Folder => read_folder(path, request),
        FileKind::Events(format) => {
            let (spikes, counts) = read_file(path, format, expected, options)?;
            Ok(vec![PopulationSpikes { changes: report(path, &counts), ..spikes }])
        }
        FileKind::Hdf5 => read_nir_data(path, request),
        FileKind::Npz => {
            let options = array_options(path, request)?;
            npz::from_bytes(path, read_bytes(path, MOST_ARRAY)?, request.population, units, options)
        }
        FileKind::Npy => array::from_array(&npy::open(path)?, units, array_options(path, request)?),
        FileKind::SpikeList => {
            takes_no_options(path, options)?;
            csv::read(path, units)
        }
        FileKind::Stream => from_stream(path, read_bytes(path, MOST_ARRAY)?, request),
        FileKind::Ron => {
            Err(Diagnostic::new("input.kind", "a data set cannot be a recording of another data set").in_file(path))
        }
        kind => Err(unknown(kind).in_file(path)),
    }
}

/// Reads bytes from stdin or a pipe.
fn from_stream(path: &Path, bytes: Vec<u8>, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let Request { expected, options, .. } = request;
    match FileKind::from_bytes(&bytes, path) {
        FileKind::Npy => {
            let options = array_options(path, request)?;
            array::from_array(&npy::Array::from_bytes(path, bytes)?, expected.units, options)
        }
        FileKind::Events(format) => {
            let name = path.display().to_string();
            let (spikes, counts) = read_input(&mut bytes.as_slice(), &name, format, expected, options)
                .map_err(|problem| problem.or_in_file(path))?;
            Ok(vec![PopulationSpikes { changes: report(path, &counts), ..spikes }])
        }
        _ => {
            takes_no_options(path, options)?;
            csv::from_bytes(path, bytes, expected.units)
        }
    }
}

/// The diagnostic for a file without spikes.
fn unknown(kind: FileKind) -> Diagnostic {
    Diagnostic::new("input.kind", format!("this is {kind}, which is not supported as spikes")).help(format!(
        "supported: .npy and .npz ([channels.., T] or [samples, channels.., T]), .csv (timestep,channel), \
         {RECORDINGS}, a .ron data-set manifest, and a folder of sample_<i>_label_<c>.npy or of recordings"
    ))
}

/// Refuses options for a source that has none.
pub(super) fn takes_no_options(path: &Path, options: &EventOptions) -> Result<()> {
    if *options == EventOptions::default() {
        return Ok(());
    }
    let message = "options after '?' are for recordings of events, for arrays (polarity, least) and for scenes";
    Err(Diagnostic::new("input.kind", message).help(format!("options are for {RECORDINGS}")).in_file(path))
}

fn array_options(path: &Path, Request { options, expected, .. }: Request<'_>) -> Result<ArrayOptions> {
    let message = "an array already has timesteps: it supports the options polarity and least only";
    let array = options.array_options().map(|options| ArrayOptions { values: expected.values, ..options });
    array.ok_or_else(|| Diagnostic::new("input.option", message).in_file(path))
}

fn read_nir_data(path: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let tree = hdf5::tree(path, hdf5::read_foreign_file(path)?)?;
    if !nir_data::is_data(&tree) {
        return Err(Diagnostic::new("input.kind", "this is not a file of NIR data")
            .in_file(path)
            .help("nir.write_data writes one; a NIR graph is a model, not a recording"));
    }
    let Request { population, expected, options } = request;
    nir_data::read(&tree, path, population, expected, options).map_err(|problem| problem.or_in_file(path))
}

/// Reads a folder of `sample_<i>_label_<c>.npy` or of recordings of events; other files are
/// ignored.
fn read_folder(folder: &Path, request: Request<'_>) -> Result<Vec<PopulationSpikes>> {
    let read: Vec<_> = list_folder(folder)?
        .into_par_iter()
        .map(|(_, label, path)| {
            let mut recording = read_sample(&path, request)?;
            recording.label = label;
            Ok(recording)
        })
        .collect();
    // Independent of threads, the first problem in the order of samples is reported.
    read.into_iter().collect()
}

/// Reads a source that holds exactly one sample.
pub(super) fn read_sample(path: &Path, request: Request<'_>) -> Result<PopulationSpikes> {
    if matches!(FileKind::detect(path)?, FileKind::Folder | FileKind::Stream) {
        let message = "a sample of a data set is a .npy or a .csv file, or a recording of events";
        return Err(Diagnostic::new("input.kind", message).in_file(path));
    }
    let mut recordings = read(path, request)?;
    match (recordings.pop(), recordings.len()) {
        (Some(recording), 0) => Ok(recording),
        (_, rest) => {
            Err(Diagnostic::new("input.shape", format!("the file holds {} samples, expected one", rest + 1))
                .in_file(path))
        }
    }
}
