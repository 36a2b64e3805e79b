//! Import of models that other tools wrote.
//!
//! Input: a file and [`Options`]. Output: an [`Imported`] model with notes on the conventions by
//! which it was read and on changes. The kind of a file is recognised by its content, never by its
//! name alone. Errors name known kinds that cannot be read (a Git-LFS pointer, SANA-FE's text
//! netlist, a pickled module, an HDF5 file without a network). Nothing in a file is executed.
//! `docs/import.md` has the conventions and limits of each format.

pub mod conventions;
mod encode;
pub mod imported;
mod netx;
pub(crate) mod neuron_config;
mod nir;
mod pickle;
mod slayer;
mod state_dict;
mod stored;
pub mod torch;
mod window;

use std::path::Path;

pub use self::conventions::{DecayRule, Reading, ResetMode, Tool};
use self::imported::{Format, name_list};
pub use self::imported::{Imported, LayerWeights, Options};
pub use self::netx::export as netx_export;
pub use self::nir::export as nir_export;
use crate::hdf5;
use crate::kind::FileKind;
use nsim_files::budget::MOST_ARRAY;
use nsim_files::changes;
use nsim_files::network::{Conventions, Network, NetworkFile};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// Whether a model argument is a file of another tool; false for a file that cannot be opened,
/// which the reader of models reports.
pub fn is_foreign(path: &Path) -> bool {
    let own = [FileKind::Folder, FileKind::Stream, FileKind::Ron];
    FileKind::detect(path).map_or_else(|problem| problem.code == "io.lfs-pointer", |kind| !own.contains(&kind))
}

/// Reads a foreign model.
///
/// # Errors
/// `import.*` for the content of the file, `hdf5.*` and `io.*` for the file itself.
pub fn read(path: &Path, options: &Options) -> Result<Imported> {
    from_bytes(path, hdf5::read_foreign_file(path)?, options)
}

/// Reads a foreign model from the bytes of its file; the path is for messages and names.
/// Errors are those of [`read`].
pub fn from_bytes(path: &Path, bytes: Vec<u8>, options: &Options) -> Result<Imported> {
    let imported = match FileKind::from_bytes(&bytes, path) {
        FileKind::Hdf5 => read_hdf5(path, bytes, options),
        FileKind::Torch => state_dict::read(bytes, path, &network_name(path), options),
        FileKind::Npy => slayer::read_set(path, options),
        kind => Err(unknown(path, &bytes, kind)),
    };
    imported.map_err(|problem| problem.or_in_file(path))
}

/// The bytes of an exported file. They are read back first, so that what the readers refuse is
/// never written, whatever their limits are. This makes an export of 2^25 weights 2.3 times as
/// long.
///
/// # Errors
/// `export.unsupported` for a file that would be refused or read as another model; `hdf5.write`.
pub fn exported(path: &Path, tree: hdf5::Group, model: &NetworkFile) -> Result<Vec<u8>> {
    let bytes = hdf5::write(&tree)?;
    // Its arrays are in memory again after the reading.
    drop(tree);
    if bytes.len() as u64 > MOST_ARRAY {
        return Err(refused(&format!("it would have {} bytes, more than {MOST_ARRAY}", bytes.len())));
    }
    let read = from_bytes(path, bytes.clone(), &Options::default()).map_err(|problem| refused(&problem.message))?;
    match read.model.ron("arrays")? == model.ron("arrays")? {
        true => Ok(bytes),
        false => Err(refused("it would be read as another model")),
    }
}

fn refused(why: &str) -> Diagnostic {
    Diagnostic::new("export.unsupported", format!("nsim would not read the exported file back: {why}"))
        .help("a model file of nsim (.ron) has no such limit")
}

/// Reads a graph of NIR nodes in memory. The neurons of the nodes `held` get a refractory period of
/// 2, so v stays 0 in the step after a spike.
///
/// # Errors
/// `import.*` for the content of the nodes.
pub fn from_nodes(
    name: &str,
    nodes: hdf5::Group,
    edges: Vec<(String, String)>,
    held: &[String],
    options: &Options,
) -> Result<Imported> {
    options.check(Format::Nir)?;
    let root = hdf5::Group::default().with("node", nir_export::nir_graph(nodes, edges));
    let options = Options { known: true, ..options.clone() };
    Ok(nir::read(&root, name, &options)?.with_refractory(held))
}

fn read_hdf5(path: &Path, bytes: Vec<u8>, options: &Options) -> Result<Imported> {
    let root = hdf5::tree(path, bytes)?;
    let name = network_name(path);
    let network = root.group("layer").or_else(|| root.group("node"));
    if let Some((name, what)) = network.and_then(hdf5::Group::first_unsupported) {
        return Err(Diagnostic::new("import.type", format!("'{name}' has type {what}, which is not supported"))
            .help("store it as integers, as floating-point numbers of 16, 32 or 64 bits, or as text"));
    }
    if root.group("layer").is_some() {
        options.check(Format::Netx)?;
        netx::read(&root, &name, options)
    } else if root.group("node").is_some() {
        options.check(Format::Nir)?;
        nir::read(&root, &name, options)
    } else {
        let members: Vec<&str> = root.items.keys().take(8).map(String::as_str).collect();
        let message = format!("this HDF5 file holds no network; its root contains {}", name_list(&members));
        Err(Diagnostic::new("import.not-a-network", message)
            .help("lava-dl's netx files have a group 'layer', NIR files a group 'node'"))
    }
}

/// The name of a network, from its file.
fn network_name(path: &Path) -> String {
    let stem = path.file_stem().map_or_else(|| "network".into(), |stem| stem.to_string_lossy().into_owned());
    // The folder's name says more than `network.net`.
    let folder = path.parent().and_then(Path::file_name).map(|folder| folder.to_string_lossy().into_owned());
    match folder {
        Some(folder) if stem == "network" && !folder.is_empty() => folder,
        _ => stem,
    }
}

/// The diagnostic for a file that is not imported, with its kind if recognised.
fn unknown(path: &Path, bytes: &[u8], kind: FileKind) -> Diagnostic {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let begin = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    let lines: Vec<&str> = begin.lines().map(str::trim).filter(|line| !line.is_empty()).take(20).collect();
    // SANA-FE's netlist: groups, neurons, edges and mappings, with a letter at the start of each
    // line.
    let netlist = |line: &&str| {
        matches!(line.split_once(' '), Some(("g" | "n" | "e" | "&" | "@" | "#", _))) || line.starts_with('#')
    };
    if extension.as_deref() == Some("net") && !lines.is_empty() && lines.iter().all(netlist) {
        return Diagnostic::new("import.sanafe", "this is a text netlist of SANA-FE, not a network of lava-dl").help(
            "its neurons are abstract and carry no weights of a Loihi core; export the trained network with \
                   lava-dl or NIR",
        );
    }
    if kind == FileKind::Ron {
        return Diagnostic::new("import.kind", "this is a file of nsim's own, which needs no import")
            .help(format!("give it as it is, such as a model: nsim run {}", path.display()));
    }
    if matches!(kind, FileKind::Events(_) | FileKind::SpikeList | FileKind::Npz) {
        return Diagnostic::new("import.kind", format!("this is {kind}, not a network"))
            .help("spikes are an input of a network: nsim run MODEL --input FILE");
    }
    let is_yaml = matches!(extension.as_deref(), Some("yml" | "yaml"));
    let described = match () {
        () if bytes.is_empty() => "the file is empty",
        () if is_yaml => "a YAML file describes neurons and holds no weights",
        () if bytes.starts_with(b"MATLAB 5.0") => "this is a MATLAB file",
        () if bytes.starts_with(b"\x1f\x8b") => "the file is compressed with gzip",
        () => "the file format is not supported",
    };
    let help = if is_yaml {
        "pass it with --neuron, together with the weights: nsim import weights.pt --neuron config.yml"
    } else {
        "supported formats: lava-dl netx (.net), NIR (.nir), state dicts of SLAYER and lava-dl (.pt), weights of VT_SNN \
         (.npy); a model of nsim begins with Network("
    };
    Diagnostic::new("import.kind", described).help(help)
}

/// A foreign model as a network, with the fields that `--set` changes.
///
/// # Errors
/// As [`read`], `set.path`, and `model.*` when it is not a valid model.
pub fn network(path: &Path, options: &Options) -> Result<Network> {
    let Imported { model, notes, warnings, .. } = read(path, options)?;
    Ok(model.build_changed(path, changes::model)?.read_by(Conventions { notes, warnings }))
}
