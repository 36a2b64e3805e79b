//! Diagnostics: messages about invalid input.
//!
//! Input: a problem, its place, and advice. Output: one value, which the command line prints as
//! JSON, or as text with the lines of the file around the place. Stages return diagnostics inside
//! their own error types.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A range of bytes in a text file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Span {
    /// First byte.
    pub start: usize,
    /// One past the last byte.
    pub end: usize,
}

/// A text file that was read, stored so that messages can point into it.
#[derive(Clone)]
pub struct SourceText {
    path: Arc<Path>,
    text: Arc<str>,
}

impl SourceText {
    /// A file's path (or the name of a shipped file) and its content.
    pub fn new(path: impl Into<PathBuf>, text: impl Into<Arc<str>>) -> Self {
        SourceText { path: path.into().into(), text: text.into() }
    }

    /// The path, as the user gave it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The whole text.
    pub fn text(&self) -> &Arc<str> {
        &self.text
    }

    /// Line and column, both from 1, of a byte; columns count characters.
    pub fn position(&self, offset: usize) -> Position {
        let mut offset = offset.min(self.text.len());
        while !self.text.is_char_boundary(offset) {
            offset -= 1;
        }
        let before = &self.text[..offset];
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        Position { line: before.matches('\n').count() + 1, column: before[line_start..].chars().count() + 1 }
    }
}

impl fmt::Debug for SourceText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SourceText({}, {} bytes)", self.path.display(), self.text.len())
    }
}

/// Line and column, both from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

/// The place of a problem.
#[derive(Debug, Clone)]
pub enum Place {
    /// A file as a whole (it cannot be opened, it is binary).
    File(PathBuf),
    /// A range of a text file.
    Text(SourceText, Span),
}

/// Result of reading an input: a value, or the problem of the input.
pub type Result<T, E = Diagnostic> = std::result::Result<T, E>;

/// One problem with an input.
#[derive(Debug, Clone)]
pub struct Diagnostic {
    /// A stable name for scripts: `stage.problem`, for example `model.weight-range`.
    pub code: &'static str,
    /// The problem, with the entity, the value and the limit.
    pub message: String,
    /// Advice for the user.
    pub help: Option<Box<str>>,
    /// Its place, when the problem is in a file.
    pub place: Option<Place>,
    /// Further problems of the same input.
    others: Option<Box<Others>>,
}

/// Problems that are independent of the one that carries them. Boxed, because results carry
/// diagnostics everywhere.
#[derive(Debug, Clone)]
struct Others(Vec<Diagnostic>);

/// Default advice by the beginning of a code, or by its end if the entry begins with a dot. The
/// first match counts.
const DEFAULT_ADVICE: [(&str, &str); 34] = [
    ("chip.syntax", "docs/formats.md has the fields of a chip: nsim show loihi1 prints a shipped one"),
    ("constants.syntax", "docs/formats.md has the fields of constants: nsim show davies2018 prints a shipped preset"),
    (".syntax", "nsim inspect FILE names the kind of a file: a model begins with Network(, a data set with DataSet("),
    ("io.missing", "check the path; a relative path begins in the current folder"),
    ("io.denied", "give yourself read permission: chmod u+r FILE"),
    ("io.folder", "name a file in it"),
    ("io.too-large", "give only a part of it"),
    ("io.utf8", "save the text as UTF-8"),
    ("io.", "copy the file to another disk and give the copy"),
    ("npy.value", "an array holds finite numbers, and integers of 32 bits: change them, then numpy.save"),
    ("npy.", "write the array again with numpy.save"),
    ("safetensors.", "write the tensors again with safetensors.torch.save_file, all of them finite"),
    ("hdf5.", "write the file again: h5dump FILE shows whether it is whole"),
    ("import.option", "remove the option"),
    ("import.", "nsim inspect FILE lists the contents of the file: change it with the tool that wrote it"),
    ("export.", "change the model, or keep it as .ron"),
    ("input.option", "remove the option"),
    ("input.events", "write the recording again with the tool that made it"),
    ("input.", "nsim inspect FILE describes an input: give one that suits the model"),
    (
        "run.too-large",
        "lower weight_exp, the weights or the payload there; if there are too many synapses, use more --threads",
    ),
    ("scene.", "nsim scene NAME lists the values of a scene: give another value"),
    ("dataset.", "correct the entry of the data set: nsim inspect FILE describes the set"),
    ("write.", "name another file, on a disk with room"),
    ("journal.", "wait until the other process has ended, or name another file"),
    ("mapping.", "make another mapping: nsim map MODEL -o FILE"),
    ("map.relays", "map it without --relays, or choose a target with more output axons"),
    ("map.strategy", "remove --strategy"),
    ("map.copies", "map fewer copies: --copies N"),
    ("map.", "change the model, or choose another target: --target NAME"),
    ("model.", "change the model at this place: nsim show NAME prints a shipped one"),
    ("target.", "change the target at this place: nsim show NAME prints a shipped one"),
    ("constants.", "change the preset at this place: nsim show NAME prints a shipped one"),
    ("sweep.", "change the file of the sweep: nsim help sweep has examples"),
    ("train.", "change the training file: nsim help train has examples"),
];

/// The most problems of an input that are reported together.
const MOST_TOGETHER: usize = 10;

/// Collects all values; or all problems, the first one with the others attached.
///
/// # Errors
/// The problems of these results, if there are any.
pub fn collect_all<T>(results: impl IntoIterator<Item = Result<T>>) -> Result<Vec<T>> {
    let (mut values, mut problems) = (Vec::new(), Vec::new());
    for result in results {
        match result {
            Ok(value) => values.push(value),
            Err(mut problem) => {
                let others = problem.others.take();
                problems.push(problem);
                problems.extend(others.into_iter().flat_map(|others| others.0));
            }
        }
        if problems.len() >= MOST_TOGETHER {
            break;
        }
    }
    let mut problems = problems.into_iter();
    match problems.next() {
        None => Ok(values),
        Some(first) => {
            let others: Vec<Diagnostic> = problems.take(MOST_TOGETHER - 1).collect();
            let others = (!others.is_empty()).then(|| Box::new(Others(others)));
            Err(Diagnostic { others, ..first })
        }
    }
}

impl Diagnostic {
    /// A problem with this code and message.
    pub fn new(code: &'static str, message: impl Into<String>) -> Self {
        Diagnostic { code, message: message.into(), help: None, place: None, others: None }
    }

    /// Further problems of the same input, independent of this one.
    pub fn others(&self) -> &[Diagnostic] {
        self.others.as_ref().map_or(&[], |others| &others.0)
    }

    /// Advice for the user: its own, or the default for its code.
    pub fn advice(&self) -> Option<&str> {
        let is_of = |code: &str| self.code.starts_with(code) || code.starts_with('.') && self.code.ends_with(code);
        let usual = || DEFAULT_ADVICE.iter().find(|(code, _)| is_of(code)).map(|(_, advice)| *advice);
        self.help.as_deref().or_else(usual)
    }

    /// Adds advice.
    #[must_use]
    pub fn help(mut self, help: impl Into<Box<str>>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Sets the place to a range of a text.
    #[must_use]
    pub fn at(mut self, source: &SourceText, span: Span) -> Self {
        self.place = Some(Place::Text(source.clone(), span));
        self
    }

    /// Sets the place to a file.
    #[must_use]
    pub fn in_file(mut self, path: impl Into<PathBuf>) -> Self {
        self.place = Some(Place::File(path.into()));
        self
    }

    /// Sets the place to a file, unless it has a place already.
    #[must_use]
    pub fn or_in_file(self, path: &Path) -> Self {
        if self.place.is_some() { self } else { self.in_file(path) }
    }

    /// The file of the problem, if any.
    pub fn file(&self) -> Option<&Path> {
        match self.place.as_ref()? {
            Place::File(path) => Some(path),
            Place::Text(source, _) => Some(source.path()),
        }
    }

    /// Line and column, if known.
    pub fn position(&self) -> Option<Position> {
        match self.place.as_ref()? {
            Place::File(_) => None,
            Place::Text(source, span) => Some(source.position(span.start)),
        }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(file) = self.file() {
            write!(f, "{}:", file.display())?;
            if let Some(Position { line, column }) = self.position() {
                write!(f, "{line}:{column}:")?;
            }
            write!(f, " ")?;
        }
        f.write_str(&self.message)
    }
}

impl std::error::Error for Diagnostic {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_line_and_column_in_characters() {
        let source = SourceText::new("m.ron", "a\nµb: 5\n");
        let offset = source.text().find('5').unwrap();
        let problem = Diagnostic::new("x.y", "5 is too much").at(&source, Span { start: offset, end: offset + 1 });
        assert_eq!(problem.to_string(), "m.ron:2:5: 5 is too much");
        assert_eq!(source.position(10_000), Position { line: 3, column: 1 });
    }
}
