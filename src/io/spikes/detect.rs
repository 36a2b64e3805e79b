//! Which format a source of spikes has. Every reader asks here, and only here.
//!
//! Files are recognised by the extension of their name; what comes through a pipe has none and is recognised by its first
//! bytes.

use std::path::Path;

use crate::base::diagnostic::Diagnostic;
use crate::io::text::{NPY_MAGIC, is_standard_stream};

/// The formats of event recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventFormat {
    /// N-MNIST `.bin` and SLAYER `.bs2`: x, y, polarity and 23 bits of microseconds.
    Bs2,
    /// SLAYER `.bs1`: 16 bits of channel, polarity and 23 bits of microseconds.
    Bs1,
    /// Prophesee `.dat`.
    Dat,
    /// Prophesee `.raw` with EVT2 or EVT3.
    Raw,
    /// AEDAT4.
    Aedat4,
    /// VT_SNN's `.tact`.
    Tact,
    /// `.csv` whose header names x and a time.
    Text,
}

impl EventFormat {
    /// Every format.
    pub const ALL: [EventFormat; 7] = [
        EventFormat::Bs2,
        EventFormat::Bs1,
        EventFormat::Dat,
        EventFormat::Raw,
        EventFormat::Aedat4,
        EventFormat::Tact,
        EventFormat::Text,
    ];
}

/// The formats of spike sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpikeFormat {
    /// A folder with a file for each sample.
    Folder,
    /// A data-set manifest, `.ron`.
    Manifest,
    /// A NumPy array, `.npy`.
    Array,
    /// An archive of NumPy arrays, `.npz`.
    Archive,
    /// A list of spikes or of events, `.csv`.
    Csv,
    /// A recording of events.
    Events(EventFormat),
    /// NIR's data files in HDF5.
    NirData,
    /// Standard input: an array or a list of spikes, see [`SpikeFormat::from_bytes`].
    Pipe,
}

impl SpikeFormat {
    /// The format of the file or folder at a path; none when it is not read as spikes.
    #[must_use]
    pub fn detect(path: &Path) -> Option<SpikeFormat> {
        if path.is_dir() { Some(SpikeFormat::Folder) } else { SpikeFormat::from_name(path) }
    }

    /// The format that a file name stands for.
    #[must_use]
    pub fn from_name(path: &Path) -> Option<SpikeFormat> {
        if is_standard_stream(path) {
            return Some(SpikeFormat::Pipe);
        }
        Some(match path.extension()?.to_string_lossy().to_ascii_lowercase().as_str() {
            "npy" => SpikeFormat::Array,
            "npz" => SpikeFormat::Archive,
            "csv" => SpikeFormat::Csv,
            "ron" => SpikeFormat::Manifest,
            "nir" | "h5" | "hdf5" => SpikeFormat::NirData,
            "bin" | "bs2" => SpikeFormat::Events(EventFormat::Bs2),
            "bs1" => SpikeFormat::Events(EventFormat::Bs1),
            "dat" => SpikeFormat::Events(EventFormat::Dat),
            "raw" => SpikeFormat::Events(EventFormat::Raw),
            "aedat4" => SpikeFormat::Events(EventFormat::Aedat4),
            "tact" => SpikeFormat::Events(EventFormat::Tact),
            _ => return None,
        })
    }

    /// The format of bytes without a name: an array says that it is one, anything else is a list of spikes.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> SpikeFormat {
        if bytes.starts_with(NPY_MAGIC) { SpikeFormat::Array } else { SpikeFormat::Csv }
    }
}

/// The problem of a path whose format is not known.
pub(super) fn unknown(path: &Path) -> Diagnostic {
    if !path.exists() {
        return Diagnostic::new("io.missing", "there is no such file").in_file(path);
    }
    let message = match path.extension() {
        Some(extension) => {
            format!("files of the kind .{} are not read as spikes", extension.to_string_lossy().to_ascii_lowercase())
        }
        None => "a file without an extension is not read as spikes".to_string(),
    };
    Diagnostic::new("input.kind", message)
        .help(
            "read are: .npy and .npz ([channels.., T] or [samples, channels.., T]), .csv (timestep,channel or t,x,y,p), recordings (.bin, .bs1, \
             .bs2, .dat, .raw, .aedat4, .tact, NIR data), a .ron data-set manifest, and a folder of \
             sample_<i>_label_<c>.npy or of recordings",
        )
        .in_file(path)
}
