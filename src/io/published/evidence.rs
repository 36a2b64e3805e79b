//! The evidence for constants, checked.
//!
//! Input: the shipped file. Output: an [`EvidenceFile`] whose constants exist, in their units, each with at least one finding.
//! Errors: `evidence.syntax`, `evidence.constant`, `evidence.finding`.

use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::desc::published::evidence::{EvidenceFile, HOST_CONSTANTS};
use crate::desc::spanned::parse;
use crate::desc::target::constants::Constants;
use crate::io::shipped;

/// The evidence that ships.
///
/// # Errors
/// As [`evidence`].
pub fn shipped() -> Result<EvidenceFile> {
    evidence(&shipped::EVIDENCE[0].source())
}

/// Evidence from its text.
///
/// # Errors
/// A diagnostic where the file is malformed, names no constant that exists, gives another unit than the constant's, or a
/// finding that is negative or without a source.
pub fn evidence(source: &SourceText) -> Result<EvidenceFile> {
    let file: EvidenceFile = parse(source, "evidence.syntax")?;
    for entry in &file.constants {
        let name = entry.constant.value.as_str();
        let of_host = HOST_CONSTANTS.iter().find(|(own, _)| *own == name).map(|&(_, unit)| unit);
        let unit = of_host.or_else(|| Constants::unit_of(name));
        if unit != Some(entry.unit) {
            let message = match unit {
                None => format!("there is no constant {name}"),
                Some(unit) => format!("{name} is in {:?}, not {unit:?}", entry.unit),
            };
            return Err(Diagnostic::new("evidence.constant", message).at(source, entry.constant.span));
        }
        if entry.findings.is_empty() {
            return Err(Diagnostic::new("evidence.finding", format!("{name} has no finding"))
                .help("leave the constant out: the base preset's value is then taken")
                .at(source, entry.constant.span));
        }
        for finding in &entry.findings {
            if !(0.0..=1e9).contains(&finding.value.value) || finding.source.trim().is_empty() {
                let message = format!("{name}: a finding is a number from 0 to 1e9 with a source");
                return Err(Diagnostic::new("evidence.finding", message).at(source, finding.value.span));
            }
        }
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_evidence_names_has_to_exist() {
        let text = shipped::EVIDENCE[0].text;
        let wrong = |from: &str, to: &str| {
            let problem = evidence(&SourceText::new("e.ron", text.replacen(from, to, 1))).unwrap_err();
            assert!(problem.position().is_some(), "{problem}");
            problem.message
        };
        assert!(wrong("\"x86_busy_power\"", "\"x86_power\"").contains("no constant x86_power"));
        assert!(wrong("\"x86_busy_power\", unit: mW", "\"x86_busy_power\", unit: ns").contains("is in ns, not mW"));
        assert!(wrong("value: 23.195", "value: -1.0").contains("from 0"));
    }
}
