//! Errors as text for people and as JSON for scripts.

use std::io::{IsTerminal, Write};
use std::process::ExitCode;

use serde_json::json;

use crate::cli::context::Format;
use crate::cli::process::advice::with_owners;
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_files::write;
use nsim_ir::base::diagnostic::{Diagnostic, Place, SourceText, Span};
use nsim_ir::base::names::{is_unprintable, printable};
use nsim_session::error::Error;

/// Prints an error and returns its exit status.
pub fn report(error: &Error, format: Format) -> ExitCode {
    ranks::before_failing();
    match format {
        Format::Json => {
            // stdout carries the result; with JSON the error object is the result.
            let _ = progress::print(&format!("{:#}\n", object(error)));
        }
        _ => write_stderr(&text(error, colour())),
    }
    ExitCode::from(error.exit_status())
}

/// Writes to stderr; failed writes are ignored.
pub fn write_stderr(text: &str) {
    if !write::is_silent() {
        let _ = std::io::stderr().lock().write_all(text.as_bytes());
    }
}

/// Whether stderr is a terminal that moves its cursor and shows colours.
pub fn on_terminal() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|kind| kind != "dumb")
}

/// Whether stderr shows colours, and its user wants them (<https://no-color.org>).
pub fn colour() -> bool {
    on_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// JSON if the command line requests it, else text, even if the rest is invalid.
pub fn requested_format() -> Format {
    let words: Vec<_> = std::env::args_os().collect();
    let apart = words.windows(2).any(|pair| pair[0] == "--format" && pair[1] == "json");
    if apart || words.iter().any(|word| word == "--format=json") { Format::Json } else { Format::Text }
}

/// Prints the help, version or error of clap, an error as a JSON object if JSON is requested;
/// returns the exit status.
pub fn usage(error: &clap::Error, asked: Format) -> ExitCode {
    // Help and version are answers; anything else is wrong usage.
    if !error.use_stderr() {
        return match progress::print(&error.render().to_string()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(problem) => report(&problem.into(), Format::Text),
        };
    }
    ranks::before_failing();
    let said = error.render().to_string();
    match asked {
        Format::Json => {
            let (message, rest) = said.split_once("\n\n").unwrap_or((&said, ""));
            let message = message.strip_prefix("error: ").unwrap_or(message).trim();
            let object = json!({
                "schema": "nsim.error/1", "code": "usage", "message": message, "help": rest.trim(),
                "file": null, "line": null, "column": null,
            });
            let _ = progress::print(&format!("{object:#}\n"));
        }
        // Colours are escapes too, so a message with other escapes is printed without colours.
        _ if colour() && printable(&said) == said => write_stderr(&error.render().ansi().to_string()),
        _ => write_stderr(&printable(&said)),
    }
    ExitCode::from(2)
}

fn object(error: &Error) -> serde_json::Value {
    let diagnostic = error.diagnostic();
    let place = diagnostic.as_deref();
    let help = match error {
        Error::Usage(_) => Some("for more information, try '--help'".to_string()),
        _ => place.and_then(Diagnostic::advice).map(with_owners),
    };
    let position = place.and_then(Diagnostic::position);
    let others = place.map_or(&[][..], |d| d.others()).iter().map(|other| object(&other.clone().into()));
    json!({
        "schema": "nsim.error/1", "code": error.code(), "message": error.to_string(), "help": help,
        "file": place.and_then(|d| d.file()).map(|file| file.display().to_string()), "line": position.map(|p| p.line),
        "column": position.map(|p| p.column), "others": others.collect::<Vec<_>>(),
    })
}

fn text(error: &Error, colour: bool) -> String {
    if let Some(diagnostic) = error.diagnostic() {
        let all = std::iter::once(&*diagnostic).chain(diagnostic.others());
        return all.map(|one| diagnostic_text(one, colour)).collect::<Vec<_>>().join("\n");
    }
    match error {
        Error::Usage(message) => {
            format!("error: {}\n\nFor more information, try '--help'.\n", printable(&with_owners(message)))
        }
        _ => format!("error[fault]: {}\n", printable(&error.to_string())),
    }
}

/// Most characters of a line that are printed around the place.
const SHOWN: usize = 90;

/// The message, the line of the file with the place underlined, and the advice.
fn diagnostic_text(diagnostic: &Diagnostic, colour: bool) -> String {
    let paint = |code: &str, text: &str| if colour { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_string() };
    let mark = paint("1;31", &format!("error[{}]", diagnostic.code));
    let mut out = format!("{mark}: {}\n", printable(&diagnostic.to_string()));
    if let Some(Place::Text(source, span)) = &diagnostic.place
        && let Some((line, marks)) = excerpt(source, *span)
    {
        let number = source.position(span.start).line.to_string();
        let blank = " ".repeat(number.len());
        out += &format!("{blank} |\n{number} | {line}\n{blank} | {}\n", paint("1;31", &marks));
    }
    if let Some(help) = diagnostic.advice() {
        out += &format!("  {}: {}\n", paint("1", "help"), printable(&with_owners(help)));
    }
    out
}

/// The line of a place, or the part of a long line around it, and marks under the place.
fn excerpt(source: &SourceText, span: Span) -> Option<(String, String)> {
    let position = source.position(span.start);
    let text = source.text();
    let start = text.get(..span.start)?.rfind('\n').map_or(0, |at| at + 1);
    let before = position.column - 1;
    let skipped = if before > SHOWN * 2 / 3 { before - SHOWN / 3 } else { 0 };
    // Only a part of a long line is copied: it may be megabytes.
    let rest = text[start..].lines().next().unwrap_or_default();
    let mut shown: String = rest.chars().skip(skipped).take(SHOWN).collect();
    if shown.trim().is_empty() {
        return None;
    }
    // Characters that move the cursor would misplace the marks.
    shown = shown.chars().map(|c| if is_unprintable(c) { ' ' } else { c }).collect();
    let length = text.get(span.start..span.end.min(start + rest.len())).map_or(0, |marked| marked.chars().count());
    let (lead, dots) = if skipped > 0 { ("..", 2) } else { ("", 0) };
    let room = shown.chars().count() + skipped;
    let tail = if rest.chars().skip(skipped).nth(SHOWN).is_some() { ".." } else { "" };
    let marks = "^".repeat(length.clamp(1, (room + 1).saturating_sub(before).max(1)));
    Some((format!("{lead}{shown}{tail}"), " ".repeat(dots + before - skipped) + &marks))
}

#[cfg(test)]
mod tests {
    use crate::cli::diagnostics::*;

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
        let text = text(&error, false);
        assert_eq!(
            text,
            "error[model.range]: m.ron:2:7: decay 5000 is too much\n  |\n2 |   du: 5000,\n  |       ^^^^\n  help: \
             less\n"
        );
    }

    #[test]
    fn of_a_long_line_the_part_around_the_place_is_shown() {
        let text = format!("{}\tbad{}", "x ".repeat(5000), ", y".repeat(5000));
        let source = SourceText::new("m.ron", text);
        let (line, marks) = excerpt(&source, Span { start: 10_001, end: 10_004 }).unwrap();
        assert!(line.chars().count() <= SHOWN + 4, "{line}");
        let marked: String = line.chars().zip(marks.chars()).filter(|&(_, mark)| mark == '^').map(|(c, _)| c).collect();
        assert_eq!(marked, "bad");
        let many = SourceText::new("m.ron", "[\n1,\n2]");
        assert_eq!(excerpt(&many, Span { start: 0, end: 7 }).unwrap(), ("[".to_string(), "^".to_string()));
        assert_eq!(excerpt(&many, Span { start: 7, end: 7 }), Some(("2]".to_string(), "  ^".to_string())));
        assert_eq!(excerpt(&SourceText::new("m.ron", ""), Span { start: 0, end: 0 }), None);
    }
}
