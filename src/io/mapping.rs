//! Saved mappings, and RON for people to read.
//!
//! Input: a path, or a [`MappingFile`] to be saved. Output: the other one.

use std::path::Path;

use ron::ser::PrettyConfig;
use serde::Serialize;

use super::text::read_text;
use crate::base::diagnostic::{Diagnostic, Result};
use crate::desc::mapping::MappingFile;
use crate::desc::spanned::parse;

/// Loads a saved mapping.
///
/// # Errors
/// `mapping.syntax`, `io.*`.
pub fn load_mapping(path: &Path) -> Result<MappingFile> {
    parse(&read_text(path)?, "mapping.syntax")
}

/// A mapping as RON, one core a line, or one chip of a layer.
///
/// # Errors
/// `write.ron`, which does not happen for mappings.
pub fn mapping_text(mapping: &MappingFile) -> Result<String> {
    pretty(mapping, if mapping.layers.is_empty() { 2 } else { 4 })
}

/// A value as RON in which everything deeper than `lines` brackets stands on one line.
///
/// # Errors
/// `write.ron` when the value's type cannot be written.
pub fn pretty(value: &impl Serialize, lines: usize) -> Result<String> {
    let config = PrettyConfig::new().depth_limit(lines).struct_names(true).new_line("\n").indentor("    ");
    let options = ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
    let mut text = options
        .to_string_pretty(value, config)
        .map_err(|error| Diagnostic::new("write.ron", format!("cannot be written as RON: {error}")))?;
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desc::mapping::{MappedCore, Run};

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
        };
        let text = mapping_text(&mapping).unwrap();
        assert_eq!(text.lines().count(), 11, "{text}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ron");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(load_mapping(&path).unwrap(), mapping);
        std::fs::write(&path, text.replace("copies", "copy")).unwrap();
        assert_eq!(load_mapping(&path).unwrap_err().position().unwrap().line, 4);
    }
}
