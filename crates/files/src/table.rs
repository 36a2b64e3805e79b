//! What every report is made of: tables, CSV, counted things, paragraphs.

use std::io::IsTerminal;

use comfy_table::{Cell, CellAlignment, ContentArrangement, Table};
use serde::Serialize;
use serde_json::Value;

/// The width of text for people.
pub const WIDTH: usize = 80;

/// An empty table without lines, as wide as what it holds.
pub fn table(header: impl IntoIterator<Item = impl Into<Cell>>) -> Table {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(header.into_iter().map(Into::into).collect::<Vec<Cell>>());
    table
}

/// A table whose cells are broken where its lines would be longer than [`WIDTH`]; whole in a pipe,
/// whose readers look for words.
pub fn narrowed(table: &mut Table) -> &mut Table {
    let widest = table.lines().map(|line| line.trim_end().chars().count()).max().unwrap_or(0);
    if widest > WIDTH && std::io::stdout().is_terminal() {
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(WIDTH as u16);
    }
    table
}

/// One column of a table: its heading, and its cell in a row.
pub type Column<R> = (&'static str, fn(&R) -> String);

/// A table with a line per row, aligned to the right from the column `numbers` on.
pub fn table_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>], numbers: usize) -> Table {
    let mut table = table(columns.iter().map(|(heading, _)| *heading));
    rows.into_iter().for_each(|row| _ = table.add_row(columns.iter().map(|(_, cell)| cell(row))));
    right_from(&mut table, numbers);
    table
}

/// Aligns the columns from the given one on to the right.
pub fn right_from(table: &mut Table, first: usize) {
    table.column_iter_mut().skip(first).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
}

/// The cells of text columns as CSV.
pub fn csv_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>]) -> String {
    let cells = |row: &'r R| columns.iter().map(|(_, cell)| cell(row)).collect();
    csv_text(columns.iter().map(|(heading, _)| (*heading).to_string()).collect(), rows.into_iter().map(cells))
}

/// The fields of serialisable rows as CSV under a header of their names. `HEADING=a.b` in it is the
/// field `b` of the object `a` under another heading; what is null or missing is an empty cell.
pub fn csv(rows: impl IntoIterator<Item = impl Serialize>, header: &str) -> String {
    let columns: Vec<(&str, &str)> =
        header.split(',').map(|column| column.split_once('=').unwrap_or((column, column))).collect();
    let cells = |row| {
        let row = serde_json::to_value(row).unwrap_or_default();
        columns.iter().map(|(_, path)| cell(path.split('.').fold(&row, |value, key| &value[key]))).collect()
    };
    csv_text(columns.iter().map(|(heading, _)| (*heading).to_string()).collect(), rows.into_iter().map(cells))
}

/// A value as a cell of CSV: text bare, numbers as short as they can be read back.
#[must_use]
pub fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => number.as_f64().map_or(String::new(), |number| number.to_string()),
        other => other.to_string(),
    }
}

/// CSV of a header and rows.
pub fn csv_text(header: Vec<String>, rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut out = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
    // Memory takes every record.
    std::iter::once(header).chain(rows).for_each(|record| _ = out.write_record(record));
    String::from_utf8_lossy(&out.into_inner().unwrap_or_default()).into_owned()
}

/// The same in Markdown.
pub fn markdown_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>]) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let mut out = line(columns.iter().map(|(heading, _)| (*heading).to_string()).collect());
    out += &line(vec!["---".to_string(); columns.len()]);
    out.extend(rows.into_iter().map(|row| line(columns.iter().map(|(_, cell)| cell(row)).collect())));
    out
}

/// The records of CSV whose cells are numbers with at most four digits; the first is the header.
fn records(csv: &str) -> Vec<Vec<String>> {
    let short = |cell: &str| match cell.parse::<f64>() {
        Ok(x) if x.is_finite() && cell.len() > 6 => format!("{}", four_digits(x)),
        _ => cell.to_string(),
    };
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(csv.as_bytes());
    reader.records().flatten().map(|record| record.iter().map(short).collect()).collect()
}

/// A number with four significant digits.
fn four_digits(x: f64) -> f64 {
    format!("{x:.3e}").parse().unwrap_or(x)
}

/// CSV as a Markdown table.
#[must_use]
pub fn markdown(csv: &str) -> String {
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let records = records(csv);
    let mut out = String::new();
    for (number, record) in records.iter().enumerate() {
        out += &line(record);
        if number == 0 {
            out += &line(&vec!["---".to_string(); record.len()]);
        }
    }
    out
}

/// CSV as a LaTeX tabular with the rules of the package booktabs.
#[must_use]
pub fn latex(csv: &str) -> String {
    let escaped = |cell: &String| {
        let mut out = String::new();
        for c in cell.chars() {
            match c {
                '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
                '\\' => out += "\\textbackslash{}",
                '~' => out += "\\textasciitilde{}",
                '^' => out += "\\textasciicircum{}",
                '\n' => out.push(' '),
                '\u{b5}' => out += "\\textmu{}",
                _ => out.push(c),
            }
        }
        out
    };
    let records = records(csv);
    let Some(header) = records.first() else { return String::new() };
    // Columns of numbers to the right.
    let is_number = |column: usize| {
        let mut cells = records[1..].iter().filter_map(|record| record.get(column)).filter(|cell| !cell.is_empty());
        cells.all(|cell| cell.parse::<f64>().is_ok())
    };
    let columns: String = (0..header.len()).map(|column| if is_number(column) { 'r' } else { 'l' }).collect();
    let mut out = format!("% needs \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n");
    for (number, record) in records.iter().enumerate() {
        out += &format!("{} \\\\\n", record.iter().map(escaped).collect::<Vec<_>>().join(" & "));
        if number == 0 {
            out += "\\midrule\n";
        }
    }
    out + "\\bottomrule\n\\end{tabular}\n"
}

/// A cell of a value that may be missing.
pub fn or_empty(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// A number with six decimals, as many as a measure is good for; a zero without a sign.
#[must_use]
pub fn rounded(x: f64) -> f64 {
    format!("{x:.6}").parse().unwrap_or(x) + 0.0
}

/// A number with this many significant digits, and no fewer of a whole number.
#[must_use]
pub fn digits(x: f64, significant: i32) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    let rounded: f64 = format!("{x:.*e}", (significant - 1) as usize).parse().unwrap_or(x);
    let decimals = (significant - 1 - rounded.abs().log10().floor() as i32).clamp(0, 12) as usize;
    // Whole numbers keep their digits.
    format!("{:.decimals$}", if decimals == 0 { x } else { rounded })
}

/// A number with three significant digits.
#[must_use]
pub fn three(x: f64) -> String {
    digits(x, 3)
}

/// Four digits after the point.
pub fn four(x: f64) -> String {
    format!("{x:.4}")
}

/// A number of things, in words.
pub fn count(number: impl Into<u64>, thing: &str) -> String {
    match (number.into(), thing.strip_suffix('y')) {
        (1, _) => format!("1 {thing}"),
        (number, Some(stem)) => format!("{number} {stem}ies"),
        (number, None) => format!("{number} {thing}s"),
    }
}

/// A paragraph in lines of [`WIDTH`]; those after the first are indented.
pub fn wrapped(text: &str) -> String {
    filled(text.split_whitespace(), 0, 2) + "\n"
}

/// Lines of at most [`WIDTH`] columns; those after the first are indented by `indent` of them.
pub fn wrapped_at(text: &str, indent: usize) -> String {
    let lines: Vec<String> = text.split('\n').map(|line| filled(line.split(' '), indent, indent)).collect();
    lines.join(&format!("\n{:indent$}", ""))
}

/// Words in lines, the first of which begins at the column `first` and the others at `indent`.
fn filled<'t>(words: impl Iterator<Item = &'t str>, first: usize, indent: usize) -> String {
    let (mut out, mut column, mut begin) = (String::new(), first, first);
    for word in words {
        let length = word.chars().count();
        if column > begin && column + 1 + length > WIDTH {
            out += &format!("\n{:indent$}", "");
            (column, begin) = (indent, indent);
        } else if column > begin {
            out.push(' ');
            column += 1;
        }
        out += word;
        column += length;
    }
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
    fn csv_becomes_a_table_for_papers() {
        let csv = "name,power_mw\na|b & c,1.23456\n\"100 %\",2\n";
        assert_eq!(markdown(csv), "| name | power_mw |\n| --- | --- |\n| a\\|b & c | 1.235 |\n| 100 % | 2 |\n");
        let latex = latex(csv);
        assert!(latex.contains("\\begin{tabular}{lr}") && latex.contains("name & power\\_mw \\\\"), "{latex}");
        assert!(latex.contains("a|b \\& c & 1.235 \\\\") && latex.contains("100 \\% & 2"), "{latex}");
    }

    #[test]
    fn fields_of_rows_become_cells() {
        let rows = [serde_json::json!({ "name": "a,b", "low": { "mw": 2.0 }, "n": 3, "on": true }), Value::Null];
        assert_eq!(csv(rows, "name,mw_low=low.mw,n,on,no"), "name,mw_low,n,on,no\n\"a,b\",2,3,true,\n,,,,\n");
    }

    #[test]
    fn a_paragraph_keeps_its_words_and_its_width() {
        let text = "one two three ".repeat(40);
        let lines = wrapped(&text);
        assert!(lines.lines().count() > 5 && lines.lines().all(|line| line.len() <= WIDTH), "{lines}");
        assert!(lines.split_whitespace().eq(text.split_whitespace()));
        assert_eq!(wrapped("short"), "short\n");
        assert_eq!((count(1u32, "chip"), count(2u64, "chip")), ("1 chip".to_string(), "2 chips".to_string()));
        assert_eq!(count(0u32, "copy"), "0 copies");
        assert_eq!([0.0, 0.000_123_4, 0.1999, 12.345, 1234.5].map(three), ["0", "0.000123", "0.200", "12.3", "1234"]);
    }

    #[test]
    fn a_section_is_replaced_between_its_marks() {
        let document = "a\n<!-- x -->\nold\n<!-- end x -->\nb\n";
        assert_eq!(replaced(document, "x", "new\n").unwrap(), "a\n<!-- x -->\nnew\n<!-- end x -->\nb\n");
        assert_eq!(replaced(document, "y", "new"), None);
    }
}
