//! Entry points of the fuzz targets of `tests/hostile/lines.rs` and of the tests of their corpora.
//!
//! Input: bytes. Output: nothing. A parser may refuse them, but may not panic or exceed its memory
//! bound. A model that is read is converted to text and back, like in an import.

use std::path::Path;

use crate::foreign::{DecayRule, Options, Reading, from_bytes, neuron_config, torch};
use crate::hdf5 as hdf5_file;
use crate::spikes::events::{nir_data, read};
use crate::spikes::{EventFormat, EventOptions, InputSpec};
use nsim_ir::arithmetic::ThresholdTest;
use nsim_ir::base::diagnostic::SourceText;

/// Imports a model, writes it as text and reads that.
fn import(path: &str, data: &[u8]) {
    let options = [
        Options::default(),
        // Options of NIR, then of netx.
        Options {
            reading: Reading { dt_ms: Some(1.0), ..Reading::default() },
            decay: Some(DecayRule::Exponential),
            ..Options::default()
        },
        Options {
            reading: Reading { dt_ms: Some(1.0), ..Reading::default() },
            threshold: Some(ThresholdTest::Inclusive),
            reset_interval: Some(16),
            input_shape: Some(vec![1, 8, 8]),
            ..Options::default()
        },
    ];
    for options in options {
        if let Ok(imported) = from_bytes(Path::new(path), data.to_vec(), &options) {
            let _ = imported.model.build(Path::new(path));
        }
    }
}

/// HDF5: netx, NIR, NIR data and other trees.
pub fn hdf5(data: &[u8]) {
    import("fuzz.net", data);
    if let Ok(tree) = hdf5_file::tree(Path::new("fuzz.nir"), data.to_vec()) {
        let expected = InputSpec { units: 3, volume: None, dt_ms: 1.0, values: false };
        let _ = nir_data::read(&tree, Path::new("fuzz.nir"), "in", &expected, &EventOptions::default());
    }
}

/// PyTorch checkpoints.
pub fn checkpoint(data: &[u8]) {
    if let Ok(mut checkpoint) = torch::open(data.to_vec()) {
        let names: Vec<String> = checkpoint.entries().map(|(name, _)| name.to_string()).take(64).collect();
        for name in names {
            let _ = checkpoint.tensor(&name);
        }
    }
    import("fuzz.pt", data);
}

/// Network configs of SLAYER.
pub fn yaml(data: &[u8]) {
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = neuron_config::config(&SourceText::new("fuzz.yml", text));
    }
}

/// Arrays and event lists.
pub fn arrays(data: &[u8]) {
    if let Ok(array) = nsim_files::npy::Array::from_bytes(Path::new("fuzz.npy"), data.to_vec()) {
        let _ = array.tensor();
    }
    if let Ok(file) = nsim_files::safetensors::TensorFile::from_bytes(Path::new("fuzz.safetensors"), data.to_vec()) {
        for entry in file.entries().unwrap_or_default().into_iter().take(64) {
            let _ = file.tensor(&entry.key);
        }
    }
    let _ = crate::spikes::csv::from_bytes(Path::new("fuzz.csv"), data.to_vec(), 64);
    let _ = crate::spikes::npz::from_bytes(Path::new("fuzz.npz"), data.to_vec(), "in", 64, Default::default());
}

/// Event recordings; the first byte chooses the format.
pub fn events(data: &[u8]) {
    let Some((&first, mut rest)) = data.split_first() else { return };
    let format = EventFormat::ALL[usize::from(first) % EventFormat::ALL.len()];
    let expected = InputSpec { units: 128, volume: Some((2, 8, 8)), dt_ms: 1.0, values: false };
    let options = EventOptions {
        crop: Some((0, 0, 16, 16)),
        pool: Some((2, 2)),
        steps: (first & 0x40 == 0).then_some(64),
        ..EventOptions::default()
    };
    let _ = read::read_input(&mut rest, "fuzz", format, &expected, &options);
}
