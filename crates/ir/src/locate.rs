//! Finds a value in RON text by its path, to report its place or to replace it.
//!
//! Input: a text, a path such as `populations.hidden.vth_mant`, a value. Output: the byte range of
//! the path's value, or the text with the value replaced. A part of a path is a field of a struct,
//! the `name` of a list item, or the item's index, `7` or `[7]`. The latter never matches a name.
//! An absent field is added, and the reader of the text decides whether the field is valid.
//! Comments and all other text stay unchanged.

use std::ops::Range;

use crate::base::diagnostic::Span;

/// A text, and the byte from which it is read.
struct Cursor<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Cursor<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// Skips blanks, comments and attributes.
    fn skip_blanks(&mut self) {
        loop {
            let rest = self.rest();
            let trimmed = rest.trim_start();
            self.at += rest.len() - trimmed.len();
            let length = if trimmed.starts_with("//") {
                trimmed.find('\n').unwrap_or(trimmed.len())
            } else if trimmed.starts_with("/*") {
                comment(trimmed)
            } else if trimmed.starts_with("#!") || trimmed.starts_with("#[") {
                trimmed.find(']').map_or(trimmed.len(), |end| end + 1)
            } else {
                return;
            };
            self.at += length;
        }
    }

    /// Reads an identifier; empty where there is none.
    fn identifier(&mut self) -> &'a str {
        let rest = self.rest();
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }

    /// Skips a character if it is next; returns whether it was.
    fn take(&mut self, what: char) -> bool {
        let stands = self.rest().starts_with(what);
        self.at += if stands { what.len_utf8() } else { 0 };
        stands
    }

    /// Skips the next token; returns its first character.
    fn token(&mut self) -> Option<char> {
        self.skip_blanks();
        let rest = self.rest();
        let first = rest.chars().next()?;
        let part = |byte: &u8| byte.is_ascii_alphanumeric() || b"_.+-".contains(byte);
        self.at += match first {
            '"' => string(rest),
            'r' if rest[1..].trim_start_matches('#').starts_with('"') => raw_string(rest),
            '\'' => character(rest),
            _ => rest.bytes().take_while(part).count().max(first.len_utf8()),
        };
        Some(first)
    }

    /// Skips a value, to the comma or bracket that ends it; returns the value's byte range.
    fn value(&mut self) -> Range<usize> {
        self.skip_blanks();
        let start = self.at;
        let (mut depth, mut end) = (0u32, start);
        loop {
            self.skip_blanks();
            let before = self.at;
            match self.token() {
                Some(',' | ')' | ']' | '}') | None if depth == 0 => {
                    self.at = before;
                    return start..end;
                }
                Some('(' | '[' | '{') => depth += 1,
                Some(')' | ']' | '}') => depth -= 1,
                Some(_) => {}
                None => return start..end,
            }
            end = self.at;
        }
    }
}

/// Byte of the first opening bracket within `deepest` others.
pub(crate) fn too_deep(text: &str, deepest: u32) -> Option<usize> {
    let (mut cursor, mut depth) = (Cursor { text, at: 0 }, 0u32);
    loop {
        match cursor.token()? {
            '(' | '[' | '{' if depth == deepest => return Some(cursor.at - 1),
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
}

fn comment(text: &str) -> usize {
    let (mut depth, mut at) = (0u32, 0);
    while at < text.len() {
        if text[at..].starts_with("/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if text[at..].starts_with("*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                return at;
            }
        } else {
            at += text[at..].chars().next().map_or(1, char::len_utf8);
        }
    }
    text.len()
}

fn string(text: &str) -> usize {
    let mut escaped = false;
    let end = text[1..].find(|c| {
        let ends = c == '"' && !escaped;
        escaped = c == '\\' && !escaped;
        ends
    });
    end.map_or(text.len(), |end| end + 2)
}

fn raw_string(text: &str) -> usize {
    let hashes = text[1..].len() - text[1..].trim_start_matches('#').len();
    let begin = 2 + hashes;
    let end = format!("\"{}", &"#".repeat(hashes));
    text[begin..].find(&end).map_or(text.len(), |found| begin + found + end.len())
}

fn character(text: &str) -> usize {
    let escaped = text[1..].starts_with('\\');
    let from = if escaped { 3 } else { 2 };
    text.get(from..).and_then(|rest| rest.find('\'')).map_or(text.len(), |end| from + end + 1)
}

/// Returns the text with another value at a path.
///
/// # Errors
/// A sentence that names the part of the path that does not exist.
pub fn replaced(text: &str, path: &str, value: &str) -> Result<String, String> {
    let parts: Vec<&str> = path.split('.').collect();
    let mut cursor = Cursor { text, at: 0 };
    let mut place = cursor.value();
    for (number, part) in parts.iter().enumerate() {
        let within = if number == 0 { "the file".to_string() } else { parts[..number].join(".") };
        match part_of(text, place, part) {
            Part::At(found) => place = found,
            Part::NotYet(end) if number + 1 == parts.len() => {
                let before = text[..end].trim_end();
                let comma = if before.ends_with(['(', ',']) { "" } else { "," };
                return Ok(format!("{before}{comma} {part}: {value}{}", &text[end..]));
            }
            Part::NotYet(_) | Part::Nothing => {
                let names: Vec<String> =
                    items(text, &within).into_iter().filter_map(|item| name_of(text, item)).collect();
                let names = if names.is_empty() { String::new() } else { format!("; it has {}", names.join(", ")) };
                return Err(format!("{within} has no {part}{names}"));
            }
        }
    }
    Ok(format!("{}{value}{}", &text[..place.start], &text[place.end..]))
}

/// The name of a list item, by which paths refer to it.
fn name_of(text: &str, item: Span) -> Option<String> {
    let Span { start, end } = locate(text, item, "name")?;
    Some(text[start..end].trim_matches('"').to_string())
}

/// Byte range of the value at a path within `value`; `None` where the path does not exist.
pub fn locate(text: &str, value: Span, path: &str) -> Option<Span> {
    let mut cursor = Cursor { text: text.get(..value.end)?, at: value.start };
    cursor.skip_blanks();
    let mut place = cursor.at..value.end;
    for part in path.split('.') {
        match part_of(text, place, part) {
            Part::At(found) => place = found,
            Part::NotYet(_) | Part::Nothing => return None,
        }
    }
    Some(Span { start: place.start, end: place.end })
}

/// Byte ranges of the items of the list at a path; empty where there is no list.
pub fn items(text: &str, path: &str) -> Vec<Span> {
    let whole = Span { start: 0, end: text.len() };
    let Some(list) = locate(text, whole, path) else { return Vec::new() };
    let mut cursor = Cursor { text: &text[..list.end], at: list.start };
    let mut items = Vec::new();
    if cursor.take('[') {
        loop {
            let item = cursor.value();
            if item.is_empty() {
                break;
            }
            items.push(Span { start: item.start, end: item.end });
            cursor.take(',');
        }
    }
    items
}

/// Text of the value at a path; `None` where the path does not exist.
pub fn value<'t>(text: &'t str, path: &str) -> Option<&'t str> {
    locate(text, Span { start: 0, end: text.len() }, path).map(|place| &text[place.start..place.end])
}

/// The name before the first bracket of a text, after comments and attributes.
pub fn root_name(text: &str) -> &str {
    let mut cursor = Cursor { text, at: 0 };
    cursor.skip_blanks();
    cursor.identifier()
}

/// Whether a text is exactly one value: no comma or bracket ends it early, and no bracket is
/// missing.
pub fn is_one_value(text: &str) -> bool {
    // An unclosed value takes the added bracket as a part of it, so its length differs.
    let followed = format!("({text})");
    let mut cursor = Cursor { text: &followed, at: 1 };
    cursor.value() == (1..1 + text.len()) && cursor.rest() == ")"
}

/// Result of the search for one part of a path.
enum Part {
    /// The byte range of its value.
    At(Range<usize>),
    /// The struct lacks the field, and its closing bracket is at this byte.
    NotYet(usize),
    /// The value has no such part, and none can be added.
    Nothing,
}

fn part_of(text: &str, place: Range<usize>, part: &str) -> Part {
    let mut cursor = Cursor { text, at: place.start };
    cursor.identifier();
    cursor.skip_blanks();
    if cursor.take('(') {
        loop {
            cursor.skip_blanks();
            if cursor.at >= place.end || cursor.rest().starts_with(')') {
                return Part::NotYet(cursor.at.min(place.end));
            }
            let before = cursor.at;
            let name = cursor.identifier();
            cursor.skip_blanks();
            let is_field = cursor.take(':') && !cursor.rest().starts_with(':');
            if !is_field {
                cursor.at = before;
            }
            let value = cursor.value();
            if is_field && name == part {
                return Part::At(value);
            }
            cursor.skip_blanks();
            cursor.take(',');
            if cursor.at == before {
                return Part::Nothing;
            }
        }
    }
    if !cursor.take('[') {
        return Part::Nothing;
    }
    let number = part.strip_prefix('[').and_then(|part| part.strip_suffix(']')).unwrap_or(part);
    for index in 0.. {
        cursor.skip_blanks();
        if cursor.at >= place.end || cursor.rest().starts_with(']') {
            break;
        }
        let before = cursor.at;
        let item = cursor.value();
        let is_named = number == part
            && match part_of(text, item.clone(), "name") {
                Part::At(name) => text[name] == format!("{part:?}"),
                Part::NotYet(_) | Part::Nothing => false,
            };
        if is_named || number.parse() == Ok(index) {
            return Part::At(item);
        }
        cursor.skip_blanks();
        cursor.take(',');
        if cursor.at == before {
            break;
        }
    }
    Part::Nothing
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: &str = r##"// vth_mant: 1
#![enable(implicit_some)]
Network(name: "a, (b", /* name: "x" /* ] */ */ timestep_ms: 1.0,
    populations: [
        Input(name: "in", shape: [2, 3]), // a comment, with ) brackets
        Loihi(name: "hidden", shape: [25], du: 1024, vth_mant: 80,),
    ],
    projections: [Dense(from: ["in"], to: "hidden", weights: [[2, -4], [6, 8]], weight_exp: -1)],
    provenance: r#"it's "made" (by hand"#, output: "hidden",
)
"##;

    #[test]
    fn a_value_is_replaced_where_its_path_leads() {
        let changed = |path, value| replaced(MODEL, path, value).unwrap();
        assert_eq!(changed("populations.hidden.vth_mant", "60"), MODEL.replace("vth_mant: 80", "vth_mant: 60"));
        assert_eq!(changed("populations.1.du", "[1, 2]"), MODEL.replace("du: 1024", "du: [1, 2]"));
        assert_eq!(changed("timestep_ms", "2"), MODEL.replace("timestep_ms: 1.0", "timestep_ms: 2"));
        assert_eq!(changed("projections.0.weight_exp", "0"), MODEL.replace("weight_exp: -1", "weight_exp: 0"));
        assert_eq!(changed("projections.0.weights.1.0", "5"), MODEL.replace("[6, 8]", "[5, 8]"));
        assert_eq!(changed("output", "\"in\""), MODEL.replace("output: \"hidden\"", "output: \"in\""));
    }

    #[test]
    fn a_field_that_is_not_said_is_added() {
        let changed = |path, value| replaced(MODEL, path, value).unwrap();
        assert_eq!(changed("populations.hidden.dv", "7"), MODEL.replace("vth_mant: 80,)", "vth_mant: 80, dv: 7)"));
        assert_eq!(changed("projections.0.delay", "3"), MODEL.replace("weight_exp: -1)", "weight_exp: -1, delay: 3)"));
        assert!(changed("scene", "\"s\"").contains("output: \"hidden\", scene: \"s\")"));
        assert_eq!(replaced("A()", "b", "1").unwrap(), "A( b: 1)");
    }

    #[test]
    fn what_is_not_there_is_named() {
        let error = |path| replaced(MODEL, path, "1").unwrap_err();
        assert_eq!(error("populations.out.du"), "populations has no out; it has in, hidden");
        assert_eq!(error("populations.7.du"), "populations has no 7; it has in, hidden");
        assert_eq!(error("nothing.du"), "the file has no nothing");
        assert_eq!(error("timestep_ms.du"), "timestep_ms has no du");
        assert_eq!(replaced("", "a", "1").unwrap_err(), "the file has no a");
        for end in 0..MODEL.len() {
            if MODEL.is_char_boundary(end) {
                drop(replaced(&MODEL[..end], "populations.hidden.du", "1"));
            }
        }
    }
}
