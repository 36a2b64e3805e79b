//! RON with positions: [`parse`] reads a text into structs whose values carry their byte ranges.
//!
//! RON returns raw values as slices of the text, so the offset of a slice is the position of its
//! value. During parsing the address of the text is in a thread-local, since serde cannot pass
//! context to nested values. An error inside a raw slice reports its own position, not the slice's
//! end.

use std::cell::Cell;
use std::marker::PhantomData;

use ron::extensions::Extensions;
use ron::value::RawValue;
use serde::de::{Deserialize, DeserializeOwned, DeserializeSeed, Deserializer};
use serde::ser::{Serialize, Serializer};

use crate::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use crate::base::names::did_you_mean;
use crate::locate::too_deep;

thread_local! {
    /// Address and length of the text that this thread is parsing.
    static TEXT: Cell<Option<(usize, usize)>> = const { Cell::new(None) };
    /// Byte range of the innermost error so far.
    static INNERMOST: Cell<Option<Span>> = const { Cell::new(None) };
}

/// A value and its place in the text.
#[derive(Debug, Clone, Default)]
pub struct Spanned<T> {
    /// The value.
    pub value: T,
    /// Its byte range in the text; empty when it was not read from one.
    pub span: Span,
}

impl<T> From<T> for Spanned<T> {
    fn from(value: T) -> Self {
        Spanned { value, span: Span::default() }
    }
}

impl<T> std::ops::Deref for Spanned<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.value
    }
}

/// Options by which texts are read, so writers need them too.
pub fn options() -> ron::Options {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME | Extensions::UNWRAP_VARIANT_NEWTYPES)
}

/// Text and byte range of a raw value.
fn place_of(raw: &RawValue) -> (&str, Span) {
    let text = raw.get_ron();
    let trimmed = text.trim_start();
    let lead = text.len() - trimmed.len();
    let trimmed = trimmed.trim_end();
    let start = match TEXT.get() {
        Some((address, length)) => {
            (trimmed.as_ptr() as usize).checked_sub(address).filter(|&offset| offset <= length).unwrap_or(0)
        }
        None => lead,
    };
    (trimmed, Span { start, end: start + trimmed.len() })
}

/// The byte offset of a RON position (line and column from 1, columns in characters).
fn offset_of(text: &str, position: ron::error::Position) -> usize {
    let mut start = 0;
    for (number, line) in text.split_inclusive('\n').enumerate() {
        if number + 1 == position.line {
            let within = line.char_indices().nth(position.col.saturating_sub(1)).map_or(line.len(), |(i, _)| i);
            return start + within;
        }
        start += line.len();
    }
    text.len()
}

/// Parses the text of the value at `span`.
pub fn parse_at<T: DeserializeOwned, E: serde::de::Error>(text: &str, span: Span) -> Result<T, E> {
    read_at(text, span, PhantomData).or_else(|Malformed { span, message }| refuse(span, message))
}

/// Reads the text of the value at `span` by a seed.
///
/// # Errors
/// The problem and its place, the innermost that is known.
pub fn read_at<'t, S: DeserializeSeed<'t>>(text: &'t str, span: Span, seed: S) -> Result<S::Value, Malformed> {
    options().from_str_seed(text, seed).map_err(|error| {
        let Malformed { span: Span { start, end }, message } = malformed(text, &error);
        let here = Span { start: span.start + start, end: span.start + end };
        Malformed { span: INNERMOST.get().unwrap_or(here), message }
    })
}

/// Message and byte range of an error of RON.
fn malformed(text: &str, error: &ron::error::SpannedError) -> Malformed {
    use ron::Error::{ExpectedArray, ExpectedComma, ExpectedInteger, IntegerOutOfBounds, TrailingCharacters};
    let end = offset_of(text, error.span.end);
    let (before, after) = text.split_at(end);
    fn part(c: char) -> bool {
        c.is_ascii_alphanumeric() || "+-._\"".contains(c)
    }
    let start = before.trim_end_matches(part).len();
    // A string ends at its next quote.
    let quote = text[start..].strip_prefix('"').and_then(|rest| rest.find('"')).map(|quote| start + quote + 2);
    let token = Span { start, end: quote.unwrap_or(end + after.len() - after.trim_start_matches(part).len()) };
    let found = &text[token.start..token.end];
    let message = match (&error.code, found.len()) {
        (ExpectedArray, 1..=40) => format!("expected a list but found {found}: write [{found}]"),
        (ExpectedInteger | IntegerOutOfBounds, 1..=40) if found.parse::<f64>().is_ok() => {
            let least = if found.starts_with('-') { " from 0" } else { "" };
            format!("expected a whole number{least} but found {found}")
        }
        // Characters after the digits make it another kind of number.
        (ExpectedComma | TrailingCharacters, 1..=40) if token.start < end && found.parse::<f64>().is_ok() => {
            format!("expected a whole number but found {found}")
        }
        _ => {
            let start = offset_of(text, error.span.start).min(end);
            return Malformed { span: Span { start, end }, message: plain(&error.code) };
        }
    };
    Malformed { span: token, message }
}

/// Fails at `span` while parsing.
pub fn refuse<T, E: serde::de::Error>(span: Span, message: impl std::fmt::Display) -> Result<T, E> {
    if INNERMOST.get().is_none() {
        INNERMOST.set(Some(span));
    }
    Err(E::custom(message))
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Spanned<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        Ok(Spanned { value: parse_at(text, span)?, span })
    }
}

impl<T: Serialize> Serialize for Spanned<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.value.serialize(serializer)
    }
}

/// Text and byte range of a value.
pub fn raw<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(&'de str, Span), D::Error> {
    Ok(place_of(<&RawValue>::deserialize(deserializer)?))
}

/// Parses a whole RON text.
///
/// # Errors
/// A [`Diagnostic`] with this code, at the position of the malformed value.
pub fn parse<T: DeserializeOwned>(source: &SourceText, code: &'static str) -> Result<T> {
    let text = source.text();
    attempt(text).map_err(|malformed| {
        let others = other_missing_fields::<T>(text, &malformed);
        let place = |&(at, _): &(usize, String)| source.position(at).line;
        let others: Vec<String> = others.iter().map(|one| format!("{} (line {})", one.1, place(one))).collect();
        let also = if others.is_empty() { String::new() } else { format!("; also missing: {}", others.join(", ")) };
        let problem = Diagnostic::new(code, malformed.message.clone() + &also).at(source, malformed.span);
        match is_of_fields(&malformed.message) {
            true => {
                problem.help("nsim show NAME prints a shipped file with its fields; docs/formats.md has all of them")
            }
            false => problem,
        }
    })
}

/// Reason why a text cannot be read, and its place.
#[derive(Debug)]
pub struct Malformed {
    /// Byte range in the text.
    pub span: Span,
    /// Message for the user.
    pub message: String,
}

/// The deepest nesting of brackets. RON scans a value once for each bracket around it.
const DEEPEST: u32 = 100;

/// Parses only the value at a place of a RON text.
///
/// # Errors
/// As [`parse`].
pub fn parse_part<T: DeserializeOwned>(source: &SourceText, part: Span, code: &'static str) -> Result<T> {
    let found = attempt_part(source.text(), part);
    found.map_err(|malformed| Diagnostic::new(code, malformed.message).at(source, malformed.span))
}

fn attempt<T: DeserializeOwned>(text: &str) -> Result<T, Malformed> {
    attempt_part(text, Span { start: 0, end: text.len() })
}

fn attempt_part<T: DeserializeOwned>(text: &str, part: Span) -> Result<T, Malformed> {
    if let Some(at) = too_deep(text, DEEPEST) {
        let message = plain(&ron::Error::ExceededRecursionLimit);
        return Err(Malformed { span: Span { start: at, end: at + 1 }, message });
    }
    let before = TEXT.replace(Some((text.as_ptr() as usize, text.len())));
    INNERMOST.set(None);
    let read = &text[part.start..part.end];
    let result = options().from_str::<T>(read);
    TEXT.set(before);
    result.map_err(|error| {
        let Malformed { span: Span { start, end }, message } = malformed(read, &error);
        let here = Span { start: part.start + start, end: part.start + end };
        Malformed { span: INNERMOST.take().unwrap_or(here), message }
    })
}

/// Candidate values of a missing field, of every kind; one usually lets parsing go on.
const FILLERS: [&str; 8] = ["0", "\"x\"", "[]", "[0]", "(1, 1)", "()", "true", "x"];
/// The longest text, in bytes, that is read again to find more missing fields.
const MOST_BYTES: usize = 1 << 20;
/// The most missing fields that are named after the first.
const MOST_MISSING: usize = 40;

/// Field and owner in the message about a missing field.
fn missing_field(message: &str) -> Option<(&str, &str)> {
    let (field, rest) = message.strip_prefix("field `")?.split_once("` of `")?;
    Some((field, rest.strip_suffix("` is missing")?))
}

/// Whether a message is about a missing or an unknown field.
fn is_of_fields(message: &str) -> bool {
    message.starts_with("field `") || message.contains("has no field `")
}

/// Further missing fields, with their places. RON stops at the first missing field. So that field
/// is filled in and the text is read again, until there is another error.
fn other_missing_fields<T: DeserializeOwned>(
    text: &str,
    Malformed { span, message }: &Malformed,
) -> Vec<(usize, String)> {
    let (mut text, mut found) = (text.to_string(), Vec::new());
    let (mut at, mut missing) = (span.start, missing_field(message).map(|(field, _)| field.to_string()));
    // Byte ranges of the inserted values, and their lengths.
    let mut filled: Vec<(Span, usize)> = Vec::new();
    while let Some(field) = missing.take().filter(|_| text.len() <= MOST_BYTES && found.len() < MOST_MISSING) {
        if text.get(..at).is_none() {
            break;
        }
        let comma = if text[..at].trim_end().ends_with([',', '(']) { "" } else { "," };
        let mut fillers: Vec<String> = FILLERS.iter().map(ToString::to_string).collect();
        let mut next = 0;
        while let Some(filler) = fillers.get(next) {
            next += 1;
            let inserted = format!("{comma} {field}: {filler},");
            let now = format!("{}{inserted}{}", &text[..at], &text[at..]);
            let Err(Malformed { span, message }) = attempt::<T>(&now) else {
                return found;
            };
            let end = at + inserted.len();
            let another = missing_field(&message);
            let inside = (at..end).contains(&span.start);
            if inside && another.is_none() {
                // The message about an unknown name has the known ones.
                let known = message.split_once(ONE_OF).and_then(|(_, names)| names.split('`').nth(1));
                if let Some(name) = known.filter(|name| fillers.len() == FILLERS.len() && !name.is_empty()) {
                    fillers.push(name.to_string());
                }
                continue;
            }
            for (one, _) in filled.iter_mut().filter(|(one, _)| one.end > at) {
                one.start += if one.start >= at { inserted.len() } else { 0 };
                one.end += inserted.len();
            }
            filled.push((Span { start: at, end }, inserted.len()));
            if let Some((field, owner)) = another {
                // The file does not lack a field of an inserted value.
                if !filled.iter().any(|(one, _)| (one.start..one.end).contains(&span.start)) {
                    let before = filled.iter().filter(|(one, _)| one.start < span.start);
                    let before: usize = before.map(|(_, length)| length).sum();
                    found.push((span.start - before, format!("`{field}` in `{owner}`")));
                }
                missing = Some(field.to_string());
                at = span.start;
            }
            text = now;
            break;
        }
    }
    found
}

/// What precedes known names in the message about an unknown one.
const ONE_OF: &str = "write one of ";

/// RON's message in one line, in the words of files.
fn plain(error: &ron::Error) -> String {
    fn owner(outer: &Option<String>) -> String {
        outer.as_ref().map_or(String::new(), |outer| format!(" of `{outer}`"))
    }
    fn meant(found: &str, known: &[&'static str]) -> String {
        let meant = did_you_mean(found, known.iter().copied());
        format!("{meant}{ONE_OF}`{}`", known.join("`, `"))
    }
    let known = match error {
        ron::Error::ExceededRecursionLimit => "brackets are nested too deeply".to_string(),
        ron::Error::ExpectedComma => "expected a comma or a closing bracket".to_string(),
        ron::Error::ExpectedArray => "expected a list, which begins with [".to_string(),
        ron::Error::ExpectedBoolean => "expected true or false".to_string(),
        ron::Error::ExpectedFloat => "expected a number".to_string(),
        ron::Error::ExpectedInteger => "expected a whole number".to_string(),
        ron::Error::ExpectedString => "expected a text in quotes".to_string(),
        ron::Error::MissingStructField { field, outer } => format!("field `{field}`{} is missing", owner(outer)),
        ron::Error::DuplicateStructField { field, outer } => format!("field `{field}`{} is given twice", owner(outer)),
        ron::Error::NoSuchStructField { expected, found, outer } => {
            let owner = outer.as_ref().map_or("this entry".to_string(), |outer| format!("`{outer}`"));
            format!("{owner} has no field `{found}`: {}", meant(found, expected))
        }
        ron::Error::NoSuchEnumVariant { expected, found, .. } => {
            format!("`{found}` is unknown: {}", meant(found, expected))
        }
        _ => String::new(),
    };
    if !known.is_empty() {
        return known;
    }
    let mut message = error.to_string().replace('\n', " ");
    if message.len() > 300 {
        let cut = (0..=300).rev().find(|&i| message.is_char_boundary(i)).unwrap_or(0);
        message.truncate(cut);
        message.push_str(" ...");
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        name: Spanned<String>,
        inner: Spanned<Vec<Spanned<u8>>>,
    }

    #[test]
    fn a_single_value_in_the_place_of_a_list_is_told_how_a_list_is_written() {
        for (value, written) in [
            ("16", "write [16]"),
            ("\"a:b c\"", "write [\"a:b c\"]"),
            ("(1, 2)", "expected a list, which begins with ["),
        ] {
            let text = SourceText::new("f.ron", format!("Outer(name: \"n\", inner: {value})"));
            let error = parse::<Outer>(&text, "x.syntax").unwrap_err();
            assert!(error.message.contains(written), "{value}: {}", error.message);
        }
    }

    #[test]
    fn values_know_where_they_stand() {
        let source = SourceText::new("t.ron", "(name: \"x\",\n inner: [1, 22,\n  3])");
        let outer: Outer = parse(&source, "t").unwrap();
        assert_eq!(outer.name.value, "x");
        let third = &outer.inner.value[2];
        assert_eq!(
            (third.value, source.position(third.span.start).line, source.position(third.span.start).column),
            (3, 3, 3)
        );
        assert_eq!(&source.text()[outer.inner.span.start..outer.inner.span.end], "[1, 22,\n  3]");
    }

    #[derive(serde::Deserialize)]
    enum Kind {
        Thin,
    }

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        _size: Spanned<u64>,
        _kind: Kind,
        _pair: (u32, u32),
    }

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Whole {
        _inner: Inner,
        _more: Vec<Inner>,
        _name: Spanned<String>,
        _other: Inner,
        _last: bool,
    }

    #[test]
    fn all_missing_fields_are_named_at_once() {
        let text = "Whole(_inner: (_size: 3),\n _more: [(_kind: Thin,), ()],\n)";
        let error = parse::<Whole>(&SourceText::new("t.ron", text), "t").err().unwrap();
        let said = error.to_string();
        let first = "field `_kind` of `Inner` is missing; also missing: `_pair` in `Inner` (line 1), ";
        assert!(said.contains(first), "{said}");
        let second = "`_size` in `Inner` (line 2), `_pair` in `Inner` (line 2), `_size` in `Inner` (line 2), ";
        assert!(said.contains(second), "{said}");
        // Fields inside a missing value are not listed.
        let rest = "`_kind` in `Inner` (line 2), `_pair` in `Inner` (line 2), `_name` in `Whole` (line 3), `_other` in \
            `Whole` (line 3), `_last` in `Whole` (line 3)";
        assert!(said.contains(rest), "{said}");
        assert_eq!(error.position().unwrap().line, 1);
        let text = "Whole(_inner: (_size: 3), _wrong: 4)";
        let said = parse::<Whole>(&SourceText::new("t.ron", text), "t").err().unwrap().to_string();
        assert!(said.contains("`_kind`") && !said.contains("_wrong"), "{said}");
    }

    #[test]
    fn an_error_deep_inside_is_reported_where_it_is() {
        let source = SourceText::new("t.ron", "(name: \"x\",\n inner: [1, 22,\n  300])");
        let error = parse::<Outer>(&source, "t").unwrap_err();
        assert_eq!(error.position().unwrap().line, 3, "{error}");
        let source = SourceText::new("t.ron", "(name: \"x\",\n iner: [1])");
        let error = parse::<Outer>(&source, "t").unwrap_err();
        assert_eq!(error.position().unwrap().line, 2, "{error}");
    }
}
