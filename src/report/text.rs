//! What every report is made of: tables, CSV, counted things, paragraphs.

use comfy_table::{Cell, ContentArrangement, Table};

/// The width of text for people.
const WIDTH: usize = 100;

/// An empty table without lines, as wide as what it holds.
pub(super) fn table(header: impl IntoIterator<Item = impl Into<Cell>>) -> Table {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(header.into_iter().map(Into::into).collect::<Vec<Cell>>());
    table
}

/// What was written as CSV.
pub(super) fn csv_text(written: csv::Writer<Vec<u8>>) -> Result<String, csv::Error> {
    let bytes = written.into_inner().map_err(csv::IntoInnerError::into_error)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// A number of things, in words.
pub(super) fn count(number: impl Into<u64>, thing: &str) -> String {
    let number = number.into();
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

/// A paragraph in lines of [`WIDTH`]; those behind the first are set in.
pub(super) fn wrapped(text: &str) -> String {
    let mut out = String::new();
    let mut column = 0;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > 0 && column + 1 + length > WIDTH {
            out += "\n  ";
            column = 2;
        } else if column > 0 {
            out.push(' ');
            column += 1;
        }
        out += word;
        column += length;
    }
    out.push('\n');
    out
}

/// Puts a section between `<!-- NAME -->` and `<!-- end NAME -->` of a document.
#[must_use]
pub fn replaced(document: &str, name: &str, section: &str) -> Option<String> {
    let (open, close) = (format!("<!-- {name} -->\n"), format!("<!-- end {name} -->"));
    let from = document.find(&open)? + open.len();
    let to = from + document[from..].find(&close)?;
    Some(format!("{}{section}{}", &document[..from], &document[to..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paragraph_keeps_its_words_and_its_width() {
        let text = "one two three ".repeat(40);
        let lines = wrapped(&text);
        assert!(lines.lines().count() > 5 && lines.lines().all(|line| line.len() <= WIDTH), "{lines}");
        assert!(lines.split_whitespace().eq(text.split_whitespace()));
        assert_eq!(wrapped("short"), "short\n");
        assert_eq!((count(1u32, "chip"), count(2u64, "chip")), ("1 chip".to_string(), "2 chips".to_string()));
    }

    #[test]
    fn a_section_is_replaced_between_its_marks() {
        let document = "a\n<!-- x -->\nold\n<!-- end x -->\nb\n";
        assert_eq!(replaced(document, "x", "new\n").unwrap(), "a\n<!-- x -->\nnew\n<!-- end x -->\nb\n");
        assert_eq!(replaced(document, "y", "new"), None);
    }
}
