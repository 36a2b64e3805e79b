//! Lists of numbers in a RON text, read in one pass.
//!
//! A model may hold megabytes of weights, and RON's parser scans a list once for each enclosing
//! value with a position. Long lists therefore bypass it: [`blank`] replaces their contents by
//! spaces, byte for byte, and RON parses that text; [`numbers`] and [`triples`] then read each list
//! from the original text. Both accept what RON accepts (comments, underscores, trailing commas,
//! signs, other bases) except a type suffix (`1.0f32`).

use std::borrow::Cow;
use std::ops::Range;

use crate::base::diagnostic::Span;

/// Brackets that may be open at a place of a text. A value with a position is scanned once for each
/// bracket around it.
const DEEPEST: u32 = 100;

/// The first bracket that is nested too deeply.
pub fn too_deep(text: &str) -> Option<usize> {
    let (mut cursor, mut depth) = (Cursor { text, at: 0 }, 0u32);
    loop {
        cursor.blanks();
        match cursor.peek()? {
            b'(' | b'[' | b'{' if depth == DEEPEST => return Some(cursor.at),
            b'(' | b'[' | b'{' => (depth, cursor.at) = (depth + 1, cursor.at + 1),
            b')' | b']' | b'}' => (depth, cursor.at) = (depth.saturating_sub(1), cursor.at + 1),
            _ if cursor.quoted() => {}
            _ if cursor.token().is_empty() => cursor.at += 1,
            _ => {}
        }
    }
}

/// What is wrong with a list, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListError {
    /// Where in the text.
    pub span: Span,
    /// What is wrong there.
    pub message: String,
}

fn wrong<T>(range: Range<usize>, message: impl Into<String>) -> Result<T, ListError> {
    Err(ListError { span: Span { start: range.start, end: range.end }, message: message.into() })
}

/// A position in a text, and a scanner for the tokens of RON.
struct Cursor<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Cursor<'a> {
    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// Skips a comment that begins here and returns whether there was one. An unclosed one extends
    /// to the end of the text.
    fn comment(&mut self) -> bool {
        let bytes = self.text.as_bytes();
        match bytes.get(self.at..self.at + 2) {
            Some(b"//") => {
                self.at = bytes[self.at..].iter().position(|&b| b == b'\n').map_or(bytes.len(), |n| self.at + n);
                true
            }
            Some(b"/*") => {
                let mut depth = 0u32;
                while self.at < bytes.len() {
                    match bytes.get(self.at..self.at + 2) {
                        Some(b"/*") => (depth, self.at) = (depth + 1, self.at + 2),
                        Some(b"*/") => (depth, self.at) = (depth - 1, self.at + 2),
                        _ => self.at += 1,
                    }
                    if depth == 0 {
                        break;
                    }
                }
                true
            }
            _ => false,
        }
    }

    /// Skips white space and comments.
    fn blanks(&mut self) {
        loop {
            match self.peek() {
                Some(b' ' | b'\n' | b'\t' | b'\r') => self.at += 1,
                Some(b'/') if self.comment() => {}
                // RON takes any white space of Unicode.
                Some(128..) => match self.rest().chars().next() {
                    Some(c) if c.is_whitespace() => self.at += c.len_utf8(),
                    _ => return,
                },
                _ => return,
            }
        }
    }

    /// Skips a string, a raw string or a character that begins here and returns whether there was
    /// one.
    fn quoted(&mut self) -> bool {
        let bytes = self.text.as_bytes();
        match bytes.get(self.at) {
            Some(b'"') => {
                self.at += 1;
                while let Some(&byte) = bytes.get(self.at) {
                    self.at += if byte == b'\\' { 2 } else { 1 };
                    if byte == b'"' {
                        break;
                    }
                }
                self.at = self.at.min(bytes.len());
                true
            }
            Some(b'r') => {
                let hashes = bytes[self.at + 1..].iter().take_while(|&&byte| byte == b'#').count();
                if bytes.get(self.at + 1 + hashes) != Some(&b'"') {
                    return false;
                }
                let inside = self.at + 2 + hashes;
                let end = format!("\"{}", "#".repeat(hashes));
                self.at = self.text[inside..].find(&end).map_or(bytes.len(), |n| inside + n + end.len());
                true
            }
            Some(b'\'') => {
                let mut chars = self.rest().char_indices().skip(1);
                let escaped = matches!(chars.next(), Some((_, '\\')));
                if escaped {
                    chars.next();
                }
                match chars.find(|&(n, c)| c == '\'' || n > 12) {
                    Some((n, '\'')) => self.at += n + 1,
                    _ => self.at += 1,
                }
                true
            }
            _ => false,
        }
    }

    /// A number or a word.
    fn token(&mut self) -> Range<usize> {
        let start = self.at;
        let part = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.' | b'_' | 128..);
        self.at += self.text.as_bytes()[start..].iter().take_while(|byte| part(byte)).count();
        start..self.at
    }

    /// Skips to the bracket that closes the one here and returns the range between them.
    fn inside(&mut self) -> Result<Range<usize>, ListError> {
        let start = self.at;
        let mut open: Vec<u8> = Vec::new();
        while let Some(byte) = self.peek() {
            match byte {
                b'[' | b'(' | b'{' => {
                    open.push(match byte {
                        b'[' => b']',
                        b'(' => b')',
                        _ => b'}',
                    });
                    self.at += 1;
                }
                b']' | b')' | b'}' => {
                    self.at += 1;
                    if let Some(expected) = open.pop().filter(|&expected| expected != byte) {
                        let message = format!("'{}' stands where '{}' is due", char::from(byte), char::from(expected));
                        return wrong(self.at - 1..self.at, message);
                    }
                    if open.is_empty() {
                        return Ok(start + 1..self.at - 1);
                    }
                }
                b'"' | b'\'' | b'r' if self.quoted() => {}
                b'/' if self.comment() => {}
                _ => self.at += 1,
            }
        }
        wrong(start..start + 1, "the file ends before this list does")
    }
}

/// The text with the contents of each list that is the value of one of these fields replaced by
/// spaces, except line breaks.
///
/// # Errors
/// For such a list whose brackets do not close.
pub fn blank<'a>(text: &'a str, fields: &[&str]) -> Result<Cow<'a, str>, ListError> {
    let mut cursor = Cursor { text, at: 0 };
    let mut inside: Vec<Range<usize>> = Vec::new();
    // The word before a colon, then the colon.
    let (mut word, mut named) = (0..0, false);
    loop {
        cursor.blanks();
        let Some(byte) = cursor.peek() else { break };
        if cursor.quoted() {
            (word, named) = (0..0, false);
        } else if byte == b'[' && named && fields.contains(&&text[word.clone()]) {
            inside.push(cursor.inside()?);
            (word, named) = (0..0, false);
        } else if byte == b':' {
            (named, cursor.at) = (true, cursor.at + 1);
        } else {
            let token = cursor.token();
            if token.is_empty() {
                cursor.at += 1;
            }
            (word, named) = (token, false);
        }
    }
    if inside.is_empty() {
        return Ok(Cow::Borrowed(text));
    }
    let mut bytes = text.as_bytes().to_vec();
    for range in inside {
        bytes[range].iter_mut().filter(|byte| **byte != b'\n').for_each(|byte| *byte = b' ');
    }
    // Whole characters were replaced by ASCII ones.
    String::from_utf8(bytes).map(Cow::Owned).or_else(|_| wrong(0..0, "the text is not UTF-8"))
}

/// A list of numbers, or of lists of them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NumberList {
    /// Its axes.
    pub shape: Vec<usize>,
    /// All numbers, in order.
    pub numbers: Vec<f64>,
    /// Where each entry of the outermost list stands.
    pub entries: Vec<Span>,
}

/// The number of a token.
fn number(token: &str) -> Option<f64> {
    let bytes = token.as_bytes();
    let (negative, digits) = match bytes.first()? {
        b'-' => (true, &bytes[1..]),
        b'+' => (false, &bytes[1..]),
        _ => (false, bytes),
    };
    // The fast path: short decimal integers.
    if (1..=15).contains(&digits.len()) && digits.iter().all(u8::is_ascii_digit) {
        let whole = digits.iter().fold(0i64, |sum, digit| 10 * sum + i64::from(digit - b'0'));
        return Some(if negative { -(whole as f64) } else { whole as f64 });
    }
    if let [b'0', base @ (b'x' | b'b' | b'o'), rest @ ..] = digits {
        let base = match base {
            b'x' => 16,
            b'b' => 2,
            _ => 8,
        };
        let rest = std::str::from_utf8(rest).ok()?.replace('_', "");
        let whole = u64::from_str_radix(&rest, base).ok().filter(|_| !rest.starts_with('+'))? as f64;
        return Some(if negative { -whole } else { whole });
    }
    if matches!(token.trim_start_matches(['+', '-']), "inf" | "NaN") {
        return token.parse().ok();
    }
    // Rust also reads "nan" and "infinity", which are not RON; it does not read underscores, which
    // are.
    let begins = digits.first().is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.');
    let plain = if token.contains('_') { Cow::Owned(token.replace('_', "")) } else { Cow::Borrowed(token) };
    begins.then(|| plain.parse().ok())?
}

impl Cursor<'_> {
    /// Reads the number that must stand here.
    fn number(&mut self, or: &str) -> Result<f64, ListError> {
        let token = self.token();
        let text = &self.text[token.clone()];
        match number(text) {
            Some(x) if x.is_finite() => Ok(x),
            Some(x) => wrong(token, format!("{x} is not a finite number")),
            None => {
                let next = self.rest().chars().next().map_or(0, char::len_utf8);
                let shown = if token.is_empty() { &self.text[self.at..self.at + next] } else { text };
                let shown: String = shown.chars().take(40).collect();
                wrong(token.start..self.at.max(token.start + next), format!("'{shown}' is not {or}"))
            }
        }
    }

    /// Skips the comma after an entry, or stops at the bracket that closes the list.
    fn comma(&mut self, close: u8) -> Result<(), ListError> {
        self.blanks();
        match self.peek() {
            Some(b',') => self.at += 1,
            Some(byte) if byte == close => {}
            found => {
                let next = self.rest().chars().next().map_or(0, char::len_utf8);
                let found = found.map_or("the end of the file", |_| &self.text[self.at..self.at + next]);
                let message = format!("'{found}' stands where a comma or '{}' is due", char::from(close));
                return wrong(self.at..self.at + next, message);
            }
        }
        Ok(())
    }
}

/// Reads nested lists and checks their depth and lengths.
struct Lists<'a> {
    cursor: Cursor<'a>,
    deepest: usize,
    list: NumberList,
}

impl Lists<'_> {
    /// Reads a list from after its opening bracket to after its closing one.
    fn list(&mut self, depth: usize) -> Result<(), ListError> {
        let start = self.cursor.at;
        if depth == self.deepest {
            return wrong(start - 1..start, format!("lists are nested deeper than {}", self.deepest));
        }
        // The first list at a depth fixes the length of all others there.
        let first = self.list.shape.len() == depth;
        if first && !self.list.numbers.is_empty() {
            return wrong(start - 1..start, "a list stands where the other rows have a number");
        }
        if first {
            self.list.shape.push(0);
        }
        let mut length = 0;
        loop {
            self.cursor.blanks();
            let entry = self.cursor.at;
            match self.cursor.peek() {
                Some(b']') => {
                    self.cursor.at += 1;
                    break;
                }
                Some(b'[') => {
                    self.cursor.at += 1;
                    self.list(depth + 1)?;
                }
                _ => {
                    let x = self.cursor.number("a number or a list of numbers")?;
                    if self.list.shape.len() != depth + 1 {
                        return wrong(entry..self.cursor.at, "a number stands where the other rows have a list");
                    }
                    self.list.numbers.push(x);
                }
            }
            length += 1;
            if depth == 0 {
                self.list.entries.push(Span { start: entry, end: self.cursor.at });
            }
            self.cursor.comma(b']')?;
        }
        if first {
            self.list.shape[depth] = length;
        } else if self.list.shape[depth] != length {
            let before = self.list.shape[depth];
            let message = format!("the rows have different lengths: {length} here, {before} before");
            return wrong(start - 1..self.cursor.at, message);
        }
        Ok(())
    }
}

/// Reads the list that stands at `span`; its lists are at most `deepest` deep.
///
/// # Errors
/// With the place of what is no finite number, of a row of another length, of what is missing.
pub fn numbers(text: &str, span: Span, deepest: usize) -> Result<NumberList, ListError> {
    let cursor = Cursor { text: &text[..span.end], at: span.start + 1 };
    let mut lists = Lists { cursor, deepest, list: NumberList::default() };
    lists.list(0)?;
    Ok(lists.list)
}

/// Source, target and weight of a synapse.
pub type Triple = (u64, u64, f64);

/// Reads the list of (whole number, whole number, number) that stands at `span`, each with its
/// place.
///
/// # Errors
/// As [`numbers`].
pub fn triples(text: &str, span: Span) -> Result<Vec<(Triple, Span)>, ListError> {
    let mut cursor = Cursor { text: &text[..span.end], at: span.start };
    let mut list = Vec::new();
    if cursor.peek() != Some(b'[') {
        return wrong(span.start..span.end, "expected a list of (source, target, weight)");
    }
    cursor.at += 1;
    loop {
        cursor.blanks();
        let start = cursor.at;
        match cursor.peek() {
            Some(b']') => return Ok(list),
            Some(b'(') => cursor.at += 1,
            _ => return wrong(start..start, "a synapse is (source, target, weight)"),
        }
        let mut fields = [0.0; 3];
        for (index, field) in fields.iter_mut().enumerate() {
            cursor.blanks();
            let at = cursor.at;
            if cursor.peek() == Some(b')') {
                return wrong(
                    start..at + 1,
                    format!("a synapse is (source, target, weight); here are {index} numbers"),
                );
            }
            *field = cursor.number("a number")?;
            // Indices beyond 2^53 would not be exact; no population is a millionth as large.
            if index < 2 && !((0.0..=9e15).contains(field) && field.fract() == 0.0) {
                return wrong(at..cursor.at, format!("{field} is not the number of a unit: those are whole, from 0"));
            }
            cursor.comma(b')')?;
        }
        cursor.blanks();
        if cursor.peek() != Some(b')') {
            return wrong(start..cursor.at, "a synapse is (source, target, weight); here are more numbers");
        }
        cursor.at += 1;
        let [source, target, weight] = fields;
        list.push(((source as u64, target as u64, weight), Span { start, end: cursor.at }));
        cursor.comma(b']')?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<NumberList, ListError> {
        numbers(text, Span { start: 0, end: text.len() }, 4)
    }

    #[test]
    fn numbers_are_those_that_ron_reads() {
        let words = [
            "0",
            "-0",
            "+7",
            "12",
            "-256",
            "1.",
            ".5",
            "-.5",
            "1e3",
            "-2.5E-3",
            "1_000",
            "0x1F",
            "-0b101",
            "0o17",
            "1_0.2_5",
            "123456789012345678",
            "4294967296",
            "0.1",
            "1e-320",
        ];
        for word in words {
            let ours = read(&format!("[{word}]")).unwrap().numbers[0];
            let ron::Value::Number(theirs) = ron::from_str(word).unwrap() else { panic!("{word}") };
            assert_eq!(ours, theirs.into_f64(), "{word}");
        }
        for word in [
            "", "-", "+-1", "1-", "0x", "0xg", "e5", "four", "nan", "infinity", "1.0f32", "\"2\"", "NaN", "-inf",
            "1e400", "é",
        ] {
            assert!(read(&format!("[1, {word}, 2]")).is_err(), "{word}");
        }
    }

    #[test]
    fn lists_have_a_shape_and_entries_have_places() {
        let text = "[[1, 2 /* two */, 3], // row\n [4,5,\t6,],]";
        let list = read(text).unwrap();
        assert_eq!((list.shape, list.numbers), (vec![2, 3], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let texts: Vec<&str> = list.entries.iter().map(|span| &text[span.start..span.end]).collect();
        assert_eq!(texts, ["[1, 2 /* two */, 3]", "[4,5,\t6,]"]);
        assert_eq!(read("[]").unwrap().shape, [0]);
        assert_eq!(read("[[], []]").unwrap().shape, [2, 0]);
        assert_eq!(read("[[[[7]]]]").unwrap().shape, [1, 1, 1, 1]);
    }

    #[test]
    fn what_is_wrong_with_a_list_is_said_where_it_is() {
        let cases = [
            ("[1, [2]]", "[", "other rows have a number"),
            ("[[1], 22]", "22", "other rows have a list"),
            ("[[1, 2], [3]]", "[3]", "1 here, 2 before"),
            ("[[[[[1]]]]]", "[", "deeper than 4"),
            ("[1, inf]", "inf", "not a finite number"),
            ("[1, \"2\"]", "\"", "'\"' is not a number"),
            ("[1 2]", "2", "where a comma or ']' is due"),
            ("[1,, 2]", ",", "',' is not a number"),
        ];
        for (text, at, says) in cases {
            let error = read(text).unwrap_err();
            assert!(error.message.contains(says), "{text}: {}", error.message);
            assert_eq!(&text[error.span.start..error.span.end], at, "{text}");
        }
    }

    #[test]
    fn triples_are_read_or_refused() {
        let read = |text: &str| triples(text, Span { start: 0, end: text.len() });
        let text = "[(0, 1, 2), (3,4,-2.5,), ]";
        let list = read(text).unwrap();
        assert_eq!(list[1].0, (3, 4, -2.5));
        assert_eq!(&text[list[1].1.start..list[1].1.end], "(3,4,-2.5,)");
        assert_eq!(read("[]").unwrap(), []);
        for bad in
            ["[1]", "[(0, 1)]", "[(0, 1, 2, 3)]", "[(-1, 1, 2)]", "[(0.5, 1, 2)]", "[(0, 1, NaN)]", "[(0, 1, 2)", "x"]
        {
            assert!(read(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn only_the_inside_of_the_lists_asked_for_is_blanked() {
        let text = "(w: [1,\n 2], a: \"w: [3]\", /* w: [4] */ b: r#\"w: [\"5]\"#, v: [6], w /**/ : [[7], \"]\"] )";
        let blanked = blank(text, &["w"]).unwrap();
        let expected = "(w: [  \n  ], a: \"w: [3]\", /* w: [4] */ b: r#\"w: [\"5]\"#, v: [6], w /**/ : [        ] )";
        assert_eq!(blanked, expected);
        assert_eq!(blanked.len(), text.len());
        assert!(matches!(blank("(v: [6])", &["w"]).unwrap(), Cow::Borrowed(_)));
        assert_eq!(blank("(w: [[1, 2)])", &["w"]).unwrap_err().span, Span { start: 10, end: 11 });
        assert_eq!(blank("(w: [1, 2", &["w"]).unwrap_err().span, Span { start: 4, end: 5 });
    }
}
