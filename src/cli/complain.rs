//! Errors as people and scripts read them.

use std::io::IsTerminal;
use std::process::ExitCode;

use miette::{GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource, miette};
use serde_json::json;

use crate::base::diagnostic::{Diagnostic, Place};
use crate::cli::{Format, common};
use crate::error::Error;

/// Prints an error and returns its exit status.
#[must_use]
pub fn report(error: &Error, format: Format) -> ExitCode {
    match format {
        Format::Json => {
            // stdout is the result's place; with JSON the error object is the result.
            let _ = common::print(&format!("{:#}\n", object(error)));
        }
        Format::Text | Format::Csv => eprint!("{}", text(error)),
    }
    ExitCode::from(error.exit_status())
}

fn object(error: &Error) -> serde_json::Value {
    let (code, help, place) = match error {
        Error::Input(d) => (d.code, d.help.clone(), Some(d)),
        Error::Usage(_) => ("usage", None, None),
        Error::Fault(_) => ("fault", None, None),
    };
    let position = place.and_then(|d| d.position());
    json!({
        "schema": "nsim.error/1",
        "code": code,
        "message": error.to_string(),
        "help": help,
        "file": place.and_then(|d| d.file()).map(|file| file.display().to_string()),
        "line": position.map(|p| p.line),
        "column": position.map(|p| p.column),
    })
}

fn text(error: &Error) -> String {
    match error {
        Error::Input(diagnostic) => drawn(diagnostic),
        Error::Usage(message) => format!("error: {message}\n\nFor more information, try '--help'.\n"),
        Error::Fault(_) => format!("error[fault]: {error}\n"),
    }
}

/// The message, the lines of the file around the place, and the advice.
fn drawn(diagnostic: &Diagnostic) -> String {
    let head = format!("error[{}]: {diagnostic}\n", diagnostic.code);
    let Some(Place::Text(source, span)) = &diagnostic.place else {
        return match &diagnostic.help {
            Some(help) => format!("{head}  help: {help}\n"),
            None => head,
        };
    };
    // A span over many lines would print them all; the first line says enough.
    let text = source.text();
    let end = text[span.start.min(text.len())..].find('\n').map_or(text.len(), |i| span.start + i);
    let length = span.end.min(end).saturating_sub(span.start);
    if text.lines().any(|line| line.len() > 2000) {
        return head + &diagnostic.help.as_ref().map_or(String::new(), |help| format!("  help: {help}\n"));
    }
    let label = || vec![LabeledSpan::at(span.start..span.start + length, "here")];
    let report = match &diagnostic.help {
        Some(help) => miette!(labels = label(), code = diagnostic.code, help = help.clone(), "{}", diagnostic.message),
        None => miette!(labels = label(), code = diagnostic.code, "{}", diagnostic.message),
    };
    let report = report.with_source_code(NamedSource::new(source.path().display().to_string(), text.to_string()));
    let plain = !std::io::stderr().is_terminal() || std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let theme = if plain { GraphicalTheme::unicode_nocolor() } else { GraphicalTheme::unicode() };
    let mut out = String::new();
    match GraphicalReportHandler::new_themed(theme).with_width(110).render_report(&mut out, report.as_ref()) {
        Ok(()) => out,
        Err(_) => head,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::diagnostic::{SourceText, Span};

    #[test]
    fn an_input_error_names_file_line_and_column() {
        let source = SourceText::new("m.ron", "a\n  du: 5000,\n");
        let error: Error = Diagnostic::new("model.range", "decay 5000 is too much")
            .at(&source, Span { start: 8, end: 12 })
            .help("less")
            .into();
        let object = object(&error);
        assert_eq!((object["line"].as_u64(), object["column"].as_u64()), (Some(2), Some(7)));
        assert_eq!(object["message"], "m.ron:2:7: decay 5000 is too much");
        let text = text(&error);
        assert!(text.contains("m.ron:2:7") && text.contains("help: less"), "{text}");
    }
}
