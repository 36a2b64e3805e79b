//! Models that other tools wrote, as drafts of nsim's own.
//!
//! Comes in: a file and [`Options`]. Goes out: an [`Imported`] model, which is a [`Draft`] and the notes that say by which
//! conventions it was read and what was changed. The kind of a file is told by its content, never by its name alone; what
//! is known but cannot be read is named (a Git-LFS pointer, SANA-FE's text netlist, a pickled module, an HDF5 file that is
//! no network). Nothing in a file is executed. `docs/import.md` has the conventions and limits of each format.

pub mod drill;
pub mod encode;
pub mod hdf5;
pub mod netx;
pub mod nir;
pub mod nir_export;
pub mod pickle;
pub mod slayer;
pub mod torch;
pub mod window;

use std::path::{Path, PathBuf};

use super::draft::Draft;
use super::npy;
use super::text::{MOST_ARRAY, read_bytes};
use crate::base::diagnostic::Diagnostic;
use crate::base::fixed::{Delay, ThresholdMantissa};
use crate::desc::network::{Network, ThresholdTest};

/// The greatest threshold mantissa: what a compartment gets that should not spike.
const NEVER: f64 = ThresholdMantissa::MAX.get() as f64;
/// The greatest delay field.
const LONGEST_DELAY: f64 = Delay::MAX.get() as f64;

/// What a file does not say, and its user may.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Milliseconds that a timestep stands for.
    pub dt_ms: Option<f64>,
    /// A file with the neuron's parameters (SLAYER's YAML).
    pub neuron: Option<PathBuf>,
    /// What a neuron does to its voltage when it spikes (NIR).
    pub reset: Option<ResetMode>,
    /// When a compartment spikes, if not strictly above its threshold.
    pub threshold: Option<ThresholdTest>,
    /// An image to drive the input layer's bias.
    pub image: Option<PathBuf>,
    /// The step at which layer 0 starts, layer k starting k steps later.
    pub first_step: Option<u32>,
    /// Timesteps between two resets of every layer.
    pub reset_interval: Option<u32>,
    /// The first reset, counted from a layer's start.
    pub reset_offset: u32,
    /// Channels, height, width of the input of a network that begins with a convolution.
    pub input_shape: Option<Vec<u64>>,
}

/// What a neuron does to its voltage when it spikes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetMode {
    /// It returns to zero, as on the chip.
    Zero,
    /// The threshold is subtracted.
    Subtract,
}

/// A model that was read from a foreign file.
#[derive(Debug, Clone)]
pub struct Imported {
    /// What the file is, in words.
    pub kind: &'static str,
    /// The model.
    pub draft: Draft,
    /// By which conventions it was read, and what was changed.
    pub notes: Vec<String>,
}

/// The kinds of foreign files, by their content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// HDF5: lava-dl's netx, or NIR.
    Hdf5,
    /// A checkpoint of PyTorch, in either container.
    Torch,
    /// A NumPy array: one of a set of weights.
    Npy,
    /// None of those that are known.
    Unknown,
}

/// The kind of a file that begins with these bytes.
#[must_use]
pub fn kind_of(bytes: &[u8]) -> Kind {
    match bytes {
        _ if bytes.starts_with(hdf5::MAGIC) => Kind::Hdf5,
        _ if bytes.starts_with(torch::ZIP) || bytes.starts_with(torch::LEGACY) => Kind::Torch,
        // A pickle of another protocol, or of something else: its reader says which.
        [0x80, 2..=5, ..] => Kind::Torch,
        _ if bytes.starts_with(npy::MAGIC) => Kind::Npy,
        _ => Kind::Unknown,
    }
}

/// Whether a model argument is a file of another tool, judged by how it begins.
///
/// # Errors
/// `io.*` when it cannot be read.
#[must_use]
pub fn is_foreign(path: &Path) -> bool {
    use std::io::Read;
    let mut begin = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(64).read_to_end(&mut begin));
    let known = ["net", "nir", "pt", "pth", "npy", "yaml", "yml"];
    let named = path.extension().is_some_and(|e| known.contains(&e.to_string_lossy().to_ascii_lowercase().as_str()));
    read.is_ok() && (named || kind_of(&begin) != Kind::Unknown)
}

/// Reads a foreign model.
///
/// # Errors
/// `import.*` for what the file holds, `hdf5.*` and `io.*` for the file itself.
pub fn read(path: &Path, options: &Options) -> Result<Imported, Diagnostic> {
    of_bytes(path, read_bytes(path, MOST_ARRAY)?, options)
}

/// Reads a foreign model from the bytes of its file; the path is for messages and names.
///
/// # Errors
/// As [`read`].
pub fn of_bytes(path: &Path, bytes: Vec<u8>, options: &Options) -> Result<Imported, Diagnostic> {
    let imported = match kind_of(&bytes) {
        Kind::Hdf5 => of_hdf5(path, bytes, options),
        Kind::Torch => slayer::read_checkpoint(bytes, &name_of(path), options),
        Kind::Npy => slayer::read_set(path, options),
        Kind::Unknown => Err(unknown(path, &bytes)),
    };
    imported.map_err(|problem| if problem.place.is_some() { problem } else { problem.in_file(path) })
}

fn of_hdf5(path: &Path, bytes: Vec<u8>, options: &Options) -> Result<Imported, Diagnostic> {
    let root = hdf5::tree(path, bytes)?;
    let name = name_of(path);
    if root.group("layer").is_some() {
        netx::read(&root, &name, options)
    } else if root.group("node").is_some() {
        nir::read(&root, &name, options)
    } else {
        let members: Vec<&str> = root.items.keys().take(8).map(String::as_str).collect();
        let message = format!("this HDF5 file holds no network: at its root are {}", listed(&members));
        Err(Diagnostic::new("import.not-a-network", message)
            .help("lava-dl's netx files have a group 'layer', NIR files a group 'node'"))
    }
}

/// Names for messages.
fn listed(names: &[&str]) -> String {
    if names.is_empty() { "no members".to_string() } else { names.join(", ") }
}

/// The name of a network, from its file.
fn name_of(path: &Path) -> String {
    let stem = path.file_stem().map_or_else(|| "network".into(), |stem| stem.to_string_lossy().into_owned());
    // network.net says nothing; its folder does.
    let folder = path.parent().and_then(Path::file_name).map(|folder| folder.to_string_lossy().into_owned());
    match folder {
        Some(folder) if stem == "network" && !folder.is_empty() => folder,
        _ => stem,
    }
}

/// What a file is that is not imported, as far as that can be told.
fn unknown(path: &Path, bytes: &[u8]) -> Diagnostic {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let begin = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    let lines: Vec<&str> = begin.lines().map(str::trim).filter(|line| !line.is_empty()).take(20).collect();
    // SANA-FE's netlist: groups, neurons, edges and mappings, a letter at the beginning of each line.
    let netlist = |line: &&str| {
        matches!(line.split_once(' '), Some(("g" | "n" | "e" | "&" | "@" | "#", _))) || line.starts_with('#')
    };
    if extension.as_deref() == Some("net") && !lines.is_empty() && lines.iter().all(netlist) {
        return Diagnostic::new("import.sanafe", "this is a text netlist of SANA-FE, not a network of lava-dl")
            .help("its neurons are abstract and carry no weights of a Loihi core; export the trained network with lava-dl or NIR");
    }
    let described = match extension.as_deref() {
        _ if bytes.is_empty() => "the file is empty",
        Some("yml" | "yaml") => "a YAML file describes neurons and holds no weights",
        _ if bytes.starts_with(b"MATLAB 5.0") => "this is a MATLAB file",
        _ if bytes.starts_with(b"\x1f\x8b") => "the file is compressed with gzip",
        _ => "the file is of no kind that is imported",
    };
    let help = match extension.as_deref() {
        Some("yml" | "yaml") => "give it with --neuron beside the weights: nsim import weights.pt --neuron config.yml",
        _ => "imported are lava-dl netx (.net), NIR (.nir), PyTorch state dicts (.pt) and SLAYER's weights as .npy",
    };
    Diagnostic::new("import.kind", described).help(help)
}

/// A foreign model as a network.
///
/// # Errors
/// As [`read`], and `model.*` when the draft is not a model.
pub fn network(path: &Path, options: &Options) -> Result<Network, Diagnostic> {
    read(path, options)?.draft.network(path)
}
