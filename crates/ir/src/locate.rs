//! Finds a value in RON text by its path, to report its place or to replace it.
//!
//! Input: a text, a path such as `populations.hidden.vth_mant`, a value. Output: the byte range of
//! the path's value, or the text with the value replaced. A part of a path is a field of a struct,
//! the `name` of a list item, or the item's index, `7` or `[7]`. The latter never matches a name.
//! An absent field is added, and the reader of the text decides whether the field is valid.
//! Comments and all other text stay unchanged.

use std::collections::{BTreeMap, HashMap, HashSet};
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
    all_replaced(text, &[(path, value)]).map_err(|(_, problem)| problem)
}

/// Returns the text with another value at each path, in time proportional to text and changes. The
/// last value of a path counts.
///
/// # Errors
/// The number of a change, and a sentence: the part of its path that does not exist, or that
/// another path is of the same field.
pub fn all_replaced(text: &str, changes: &[(&str, &str)]) -> Result<String, (usize, String)> {
    let paths: HashSet<&str> = changes.iter().map(|(path, _)| *path).collect();
    let mut index = Index { text, whole: Cursor { text, at: 0 }.value(), values: HashMap::new() };
    // By place; fields that are added to one struct keep their order.
    let mut edits: BTreeMap<(usize, usize), Vec<Edit<'_>>> = BTreeMap::new();
    for (number, &(path, value)) in changes.iter().enumerate() {
        if path.match_indices('.').any(|(at, _)| paths.contains(&path[..at])) {
            return Err((number, SAME_FIELD.to_string()));
        }
        let (place, added) = index.place(path).map_err(|problem| (number, problem))?;
        let at_place = edits.entry((place.start, place.end)).or_default();
        match at_place.iter_mut().find(|edit| edit.added == added) {
            Some(edit) if edit.path != path => return Err((number, SAME_FIELD.to_string())),
            Some(edit) => edit.value = value,
            None => at_place.push(Edit { number, path, added, value }),
        }
    }
    let (mut changed, mut end) = (String::with_capacity(text.len()), 0);
    for ((from, to), at_place) in edits {
        if from < end {
            return Err((at_place[0].number, SAME_FIELD.to_string()));
        }
        changed += &text[end..from];
        for Edit { added, value, .. } in at_place {
            match added {
                Some(field) if changed.ends_with(['(', ',']) => changed += &format!(" {field}: {value}"),
                Some(field) => changed += &format!(", {field}: {value}"),
                None => changed += value,
            }
        }
        end = to;
    }
    Ok(changed + &text[end..])
}

const SAME_FIELD: &str = "another --set changes the same field";

/// A value for a place in a text.
struct Edit<'c> {
    /// The number of its change.
    number: usize,
    path: &'c str,
    /// The name of a field that the struct lacks.
    added: Option<&'c str>,
    value: &'c str,
}

/// The parts of the values on the paths that were searched, each value read once.
struct Index<'t> {
    text: &'t str,
    whole: Range<usize>,
    /// By first byte.
    values: HashMap<usize, ReadValue<'t>>,
}

/// The parts of a value.
#[derive(Default)]
struct ReadValue<'t> {
    /// Byte ranges by name of the field; in a list by text of the item's name, with its quotes.
    by_name: HashMap<&'t str, Range<usize>>,
    /// Byte ranges of a list's items.
    items: Vec<Range<usize>>,
    /// The byte of a struct's closing bracket.
    closing: Option<usize>,
}

impl<'t> Index<'t> {
    /// Byte range of the value at a path; where a struct lacks the last field, the range before its
    /// closing bracket, and the name.
    fn place<'p>(&mut self, path: &'p str) -> Result<(Range<usize>, Option<&'p str>), String> {
        let (mut place, mut before) = (self.whole.clone(), 0);
        for part in path.split('.') {
            let text = self.text;
            let value = self.values.entry(place.start).or_insert_with(|| ReadValue::new(text, place.clone()));
            let is_last = before + part.len() == path.len();
            match (value.part(part), value.closing) {
                (Some(found), _) => place = found,
                (None, Some(end)) if is_last => return Ok((text[..end].trim_end().len()..end, Some(part))),
                (None, _) => {
                    let names = value.items.iter().filter_map(|item| name_of(text, item.clone()));
                    let names: Vec<&str> = names.map(|name| name.trim_matches('"')).collect();
                    let names = if names.is_empty() { String::new() } else { format!("; it has {}", names.join(", ")) };
                    let within = if before == 0 { "the file" } else { &path[..before - 1] };
                    return Err(format!("{within} has no {part}{names}"));
                }
            }
            before += part.len() + 1;
        }
        Ok((place, None))
    }
}

impl<'t> ReadValue<'t> {
    fn new(text: &'t str, place: Range<usize>) -> Self {
        let mut value = ReadValue::default();
        let Some(mut parts) = Parts::new(text, place) else { return value };
        while let Some((field, range)) = parts.next() {
            let name = if parts.is_struct { field } else { name_of(text, range.clone()) };
            if let Some(name) = name {
                value.by_name.entry(name).or_insert_with(|| range.clone());
            }
            value.items.extend((!parts.is_struct).then_some(range));
        }
        value.closing = parts.closing.filter(|_| parts.is_struct);
        value
    }

    /// As [`part_of`].
    fn part(&self, part: &str) -> Option<Range<usize>> {
        if self.items.is_empty() {
            return self.by_name.get(part).cloned();
        }
        let number = index_text(part);
        let named = self.by_name.get(format!("{number:?}").as_str()).filter(|_| number == part);
        let at = number.parse().ok().and_then(|index: usize| self.items.get(index));
        named.into_iter().chain(at).min_by_key(|range| range.start).cloned()
    }
}

/// The name of a list item, by which paths refer to it, with its quotes.
fn name_of(text: &str, item: Range<usize>) -> Option<&str> {
    let is_struct = Parts::new(text, item.clone())?.is_struct;
    part_of(text, item, "name").filter(|_| is_struct).map(|name| &text[name])
}

/// Byte range of the value at a path within `value`; `None` where the path does not exist.
pub fn locate(text: &str, value: Span, path: &str) -> Option<Span> {
    let mut cursor = Cursor { text: text.get(..value.end)?, at: value.start };
    cursor.skip_blanks();
    let mut place = cursor.at..value.end;
    for part in path.split('.') {
        place = part_of(text, place, part)?;
    }
    Some(Span { start: place.start, end: place.end })
}

/// Byte ranges of the items of the list at a path; empty where there is no list.
pub fn items(text: &str, path: &str) -> Vec<Span> {
    let whole = Span { start: 0, end: text.len() };
    let Some(list) = locate(text, whole, path) else { return Vec::new() };
    let parts = Parts::new(&text[..list.end], list.start..list.end).filter(|parts| !parts.is_struct);
    parts.into_iter().flatten().map(|(_, item)| Span { start: item.start, end: item.end }).collect()
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

/// The fields of a struct or the items of a list, in order: name of the field, byte range.
struct Parts<'t> {
    cursor: Cursor<'t>,
    end: usize,
    is_struct: bool,
    /// The byte of the closing bracket, once it is reached.
    closing: Option<usize>,
}

impl<'t> Parts<'t> {
    /// The parts of the value at `place`; `None` for any other value.
    fn new(text: &'t str, place: Range<usize>) -> Option<Self> {
        let mut cursor = Cursor { text, at: place.start };
        cursor.identifier();
        cursor.skip_blanks();
        let is_struct = cursor.take('(');
        (is_struct || cursor.take('[')).then_some(Parts { cursor, end: place.end, is_struct, closing: None })
    }
}

impl<'t> Iterator for Parts<'t> {
    type Item = (Option<&'t str>, Range<usize>);

    fn next(&mut self) -> Option<Self::Item> {
        let Parts { cursor, end, is_struct, closing } = self;
        cursor.skip_blanks();
        if cursor.at >= *end || cursor.rest().starts_with(if *is_struct { ')' } else { ']' }) {
            *closing = Some(cursor.at.min(*end));
            return None;
        }
        let before = cursor.at;
        let name = cursor.identifier();
        cursor.skip_blanks();
        let is_field = *is_struct && cursor.take(':') && !cursor.rest().starts_with(':');
        if !is_field {
            cursor.at = before;
        }
        let value = cursor.value();
        cursor.skip_blanks();
        cursor.take(',');
        (cursor.at > before).then_some((is_field.then_some(name), value))
    }
}

/// The index that a part of a path states, without its brackets.
fn index_text(part: &str) -> &str {
    part.strip_prefix('[').and_then(|part| part.strip_suffix(']')).unwrap_or(part)
}

/// Byte range of a part of the value at `place`.
fn part_of(text: &str, place: Range<usize>, part: &str) -> Option<Range<usize>> {
    let parts = Parts::new(text, place)?;
    let (is_struct, number) = (parts.is_struct, index_text(part));
    let index: Option<usize> = number.parse().ok();
    let name = format!("{part:?}");
    let is_part = |(at, (field, value)): &(usize, (Option<&str>, Range<usize>))| match is_struct {
        true => *field == Some(part),
        false => (number == part && name_of(text, value.clone()) == Some(&name)) || index == Some(*at),
    };
    parts.enumerate().find(is_part).map(|(_, (_, value))| value)
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
    fn all_changes_are_made_in_one_pass() {
        let populations: Vec<String> = (0..20_000).map(|i| format!("L(name: \"p{i}\", du: 1)")).collect();
        let text = format!("N(a: 1, populations: [{}])", populations.join(", "));
        let paths: Vec<String> = (0..20_000).map(|i| format!("populations.p{i}.bits")).collect();
        let mut changes: Vec<(&str, &str)> = paths.iter().map(|path| (path.as_str(), "4")).collect();
        changes.extend([("populations.0.du", "2"), ("a", "2"), ("populations.[0].delay", "7"), ("a", "3")]);
        // Hours, if the text were read again for each change.
        let changed = all_replaced(&text, &changes).unwrap();
        assert!(
            changed.starts_with("N(a: 3, populations: [L(name: \"p0\", du: 2, bits: 4, delay: 7), L("),
            "{changed:.80}"
        );
        assert_eq!(changed.matches(", bits: 4").count(), 20_000);
        for two in [["populations.1.du", "populations.p1.du"], ["populations.p1.q", "populations.1.q"]] {
            assert_eq!(all_replaced(&text, &two.map(|path| (path, "5"))), Err((1, SAME_FIELD.to_string())));
        }
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
