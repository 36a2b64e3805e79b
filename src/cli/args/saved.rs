//! Saved JSON results of commands.

use std::path::Path;

use serde_json::Value;

use nsim_files as io;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_session::error::Error;

/// Whether a file name has the extension of a saved result.
pub fn is_result(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// A saved result of one of these schemas, and its text.
///
/// # Errors
/// `report.result` for other text, another schema or checksum; when the file cannot be read.
pub fn read(path: &Path, schemas: &[&str], help: &str) -> Result<(Value, SourceText), Error> {
    let text = io::text::read_text(path)?;
    let wrong = |message: String| Diagnostic::new("report.result", message).in_file(path).help(help);
    let result: Value = serde_json::from_str(text.text()).map_err(|error| wrong(format!("is not JSON: {error}")))?;
    let schema = result["schema"].as_str().unwrap_or_default();
    if !schemas.contains(&schema) {
        return Err(wrong(format!("holds '{schema}', not {}", schemas.join(" or "))).into());
    }
    match checksum::holds(&result) {
        Some(true) => {}
        Some(false) => {
            let message = "was changed or damaged after it was printed: its checksum does not match".to_string();
            return Err(wrong(message).into());
        }
        None => tracing::warn!("{} has no checksum, so a damaged number in it is not detected", path.display()),
    }
    Ok((result, text))
}
