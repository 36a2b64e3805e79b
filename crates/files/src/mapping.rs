//! Saved mappings, and RON with line breaks.
//!
//! Input: a path or text, or a [`MappingFile`] to save. Output: the [`MappingFile`], or its text.

use std::path::Path;

use ron::ser::PrettyConfig;
use serde::Serialize;

use super::text::{read_text, sha256};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::mapping::MappingFile;
use nsim_ir::spanned::{options, parse};

/// Loads a saved mapping.
///
/// # Errors
/// As [`mapping`]; `io.*`.
pub fn load_mapping(path: &Path) -> Result<MappingFile> {
    mapping(&read_text(path)?).map_err(|problem| match problem.help {
        None => problem.help("nsim map writes mappings: nsim map MODEL -o FILE"),
        Some(_) => problem,
    })
}

/// Parses a mapping. A checksum that does not match its content stays in it, for
/// [`check_unchanged`](nsim_ir::mapping::check_unchanged).
///
/// # Errors
/// `mapping.syntax`; `mapping.copies` for 0 copies.
pub fn mapping(source: &SourceText) -> Result<MappingFile> {
    let mut mapping: MappingFile = parse(source, "mapping.syntax")?;
    if mapping.copies == 0 {
        let message = "the mapping has 0 copies, expected at least 1";
        let help = "make it again: nsim map MODEL -o FILE";
        return Err(Diagnostic::new("mapping.copies", message).help(help).in_file(source.path()));
    }
    let written = mapping.checksum.take();
    let own = checksum(&mapping)?;
    mapping.checksum = written.filter(|sum| *sum != own);
    Ok(mapping)
}

/// The checksum of a mapping that has none.
fn checksum(mapping: &MappingFile) -> Result<String> {
    Ok(sha256(pretty(mapping, 0)?.as_bytes()))
}

/// A mapping as RON with its checksum; a line has one core, or one chip of a layer.
///
/// # Errors
/// `write.ron`, which does not happen for mappings.
pub fn mapping_text(mapping: &MappingFile) -> Result<String> {
    let sealed = MappingFile { checksum: Some(checksum(mapping)?), ..mapping.clone() };
    pretty(&sealed, if mapping.layers.is_empty() { 2 } else { 4 })
}

/// A value as RON; values nested deeper than `lines` brackets share one line.
///
/// # Errors
/// `write.ron` when the value's type cannot be written.
pub fn pretty(value: &impl Serialize, lines: usize) -> Result<String> {
    let config = PrettyConfig::new().depth_limit(lines).struct_names(true).new_line("\n").indentor("    ");
    let mut text = options()
        .to_string_pretty(value, config)
        .map_err(|error| Diagnostic::new("write.ron", format!("cannot be written as RON: {error}")))?;
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::mapping::{MappedCore, Run};

    #[test]
    fn what_is_saved_is_loaded_and_a_core_takes_a_line() {
        let core = |core| MappedCore {
            chip: 0,
            x: 1,
            y: 0,
            core,
            holds: vec![
                Run { population: "a".into(), first: 0, count: 5 },
                Run { population: "b".into(), first: 3, count: 1 },
            ],
        };
        let mapping = MappingFile {
            model: "m".into(),
            target: "tiny".into(),
            copies: 1,
            strategy: "greedy".into(),
            seed: u64::MAX,
            pruned: None,
            cores: vec![core(0), core(1)],
            layers: Vec::new(),
            checksum: None,
        };
        let text = mapping_text(&mapping).unwrap();
        assert_eq!(text.lines().count(), 12, "{text}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ron");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(load_mapping(&path).unwrap(), mapping);
        std::fs::write(&path, text.replace("copies", "copy")).unwrap();
        assert_eq!(load_mapping(&path).unwrap_err().position().unwrap().line, 4);
        std::fs::write(&path, text.replacen("x: 1", "x: 2", 1)).unwrap();
        let changed = load_mapping(&path).unwrap();
        assert_eq!(nsim_ir::mapping::check_unchanged(&changed).unwrap_err().code, "mapping.checksum");
    }
}
