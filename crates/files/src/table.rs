//! Building blocks of reports: tables, CSV, counts in words, paragraphs.

use std::sync::LazyLock;

use serde::Serialize;
use serde_json::Value;
use terminal_size::terminal_size;

/// Width of paragraphs and the least width of a table, in characters.
pub const WIDTH: usize = 80;

/// The greatest width of a table: `COLUMNS`, else the terminal's width, and at least [`WIDTH`].
static TABLE_WIDTH: LazyLock<usize> = LazyLock::new(|| {
    let stated = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
    stated.or_else(|| Some(terminal_size()?.0.0.into())).unwrap_or(WIDTH).max(WIDTH)
});

/// Spaces between two columns.
const GAP: usize = 2;

/// A table as text, in lines that fit the terminal.
///
/// Text is broken between words; numbers are not broken and aligned to the right. Columns that do
/// not fit follow in further tables, each of which begins with the first column.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    fitted(header, rows, *TABLE_WIDTH)
}

fn fitted(header: &[&str], rows: &[Vec<String>], width: usize) -> String {
    if header.is_empty() {
        return String::new();
    }
    let columns: Vec<ColumnWidths> = (0..header.len()).map(|at| ColumnWidths::new(header[at], rows, at)).collect();
    let (mut tables, mut used) = (vec![vec![0]], columns.first().map_or(0, |column| column.least));
    for (at, ColumnWidths { least, .. }) in columns.iter().enumerate().skip(1) {
        if used + GAP + least > width && tables[tables.len() - 1].len() > 1 {
            tables.push(vec![0]);
            used = columns[0].least;
        }
        used += GAP + least;
        tables.last_mut().expect("a table").push(at);
    }
    let whole: Vec<String> = header.iter().map(ToString::to_string).collect();
    let texts = tables.iter().map(|shown| {
        let layout = Layout::new(&columns, shown, width);
        layout.row(&whole, true) + &rows.iter().map(|cells| layout.row(cells, false)).collect::<String>()
    });
    texts.collect::<Vec<_>>().join("\n")
}

/// Some columns as a table, with the width of each of all columns.
struct Layout<'a> {
    columns: &'a [ColumnWidths],
    shown: &'a [usize],
    widths: Vec<usize>,
}

impl<'a> Layout<'a> {
    fn new(columns: &'a [ColumnWidths], shown: &'a [usize], width: usize) -> Self {
        let least = shown.iter().map(|&at| columns[at].least + GAP).sum::<usize>() - GAP;
        let mut room = width.saturating_sub(least);
        let mut by_need = shown.to_vec();
        // In columns of numbers only the heading can be broken, so they are widened last.
        by_need.sort_by_key(|&at| (columns[at].numbers, columns[at].most - columns[at].least));
        let mut widths: Vec<usize> = columns.iter().map(|column| column.least).collect();
        for at in by_need {
            let more = room.min(columns[at].most - columns[at].least);
            (widths[at], room) = (widths[at] + more, room - more);
        }
        Layout { columns, shown, widths }
    }

    /// The lines of a row; headings are aligned at the bottom.
    fn row(&self, cells: &[String], is_heading: bool) -> String {
        let mut broken = Vec::new();
        for &at in self.shown {
            broken.push(match length(&cells[at]) <= self.widths[at] {
                true => vec![cells[at].clone()],
                false => filled(cells[at].split_whitespace(), 0, 0, self.widths[at]),
            });
        }
        let height = broken.iter().map(Vec::len).max().unwrap_or(0);
        let mut out = String::new();
        for line in 0..height {
            let mut texts = Vec::new();
            for (lines, &at) in broken.iter().zip(self.shown) {
                let above = if is_heading { height - lines.len() } else { 0 };
                let text = line.checked_sub(above).and_then(|line| lines.get(line)).map_or("", String::as_str);
                let width = self.widths[at];
                texts.push(if self.columns[at].numbers { format!("{text:>width$}") } else { format!("{text:width$}") });
            }
            out += texts.join(&" ".repeat(GAP)).trim_end();
            out.push('\n');
        }
        out
    }
}

/// A column before its width is known.
struct ColumnWidths {
    /// Whether its cells are numbers.
    numbers: bool,
    /// Width of the longest part that cannot be broken.
    least: usize,
    /// Width without a break.
    most: usize,
}

impl ColumnWidths {
    fn new(heading: &str, rows: &[Vec<String>], at: usize) -> Self {
        let cells: Vec<&str> = rows.iter().map(|row| row[at].as_str()).filter(|cell| !cell.is_empty()).collect();
        let numbers = 2 * cells.iter().filter(|cell| is_number(cell)).count() > cells.len();
        let longest = cells.iter().map(|cell| length(cell)).max().unwrap_or(0);
        let longest_word = cells.iter().map(|cell| length_of_word(cell)).max().unwrap_or(0);
        let least = if numbers { longest } else { longest_word };
        ColumnWidths { numbers, least: least.max(length_of_word(heading)), most: longest.max(length(heading)) }
    }
}

fn is_number(cell: &str) -> bool {
    cell.trim_start_matches(['-', '+', '~', '.']).starts_with(|c: char| c.is_ascii_digit())
        && cell.split_whitespace().count() < 3
}

fn length(text: &str) -> usize {
    text.chars().count()
}

fn length_of_word(text: &str) -> usize {
    text.split_whitespace().map(length).max().unwrap_or(0)
}

/// One column of a table: its heading, and its cell in a row.
pub type Column<R> = (&'static str, fn(&R) -> String);

/// A table as text, with a line or more per row.
pub fn table_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>]) -> String {
    let header: Vec<&str> = columns.iter().map(|(heading, _)| *heading).collect();
    let rows: Vec<Vec<String>> =
        rows.into_iter().map(|row| columns.iter().map(|(_, cell)| cell(row)).collect()).collect();
    table(&header, &rows)
}

/// Rows as CSV, with the cells of `columns`.
pub fn csv_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>]) -> String {
    let rows = rows.into_iter().map(|row| columns.iter().map(|(_, cell)| cell(row)).collect());
    csv_text(columns.iter().map(|(heading, _)| (*heading).to_string()).collect(), rows)
}

/// The fields of serialisable rows as CSV under a header of their names. `HEADING=a.b` in the
/// header selects the field `b` of the object `a`. A null becomes an empty cell.
///
/// # Panics
/// When a row lacks a field of the header.
pub fn csv(rows: impl IntoIterator<Item = impl Serialize>, header: &str) -> String {
    let columns: Vec<(&str, &str)> =
        header.split(',').map(|column| column.split_once('=').unwrap_or((column, column))).collect();
    let rows = rows.into_iter().map(|row| {
        let row = serde_json::to_value(row).unwrap_or_default();
        columns.iter().map(|(_, path)| cell(path.split('.').fold(&row, field))).collect()
    });
    csv_text(columns.iter().map(|(heading, _)| (*heading).to_string()).collect(), rows)
}

fn field<'v>(value: &'v Value, key: &str) -> &'v Value {
    match value {
        Value::Null => value,
        _ => value.get(key).unwrap_or_else(|| panic!("the row has no field '{key}': {value}")),
    }
}

/// A value as a cell of CSV: text without quotes, numbers in the shortest exact form.
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
    // Writing to memory never fails.
    std::iter::once(header).chain(rows).for_each(|record| _ = out.write_record(record));
    String::from_utf8_lossy(&out.into_inner().unwrap_or_default()).into_owned()
}

/// A table in Markdown.
pub fn markdown_of<'r, R: 'r>(rows: impl IntoIterator<Item = &'r R>, columns: &[Column<R>]) -> String {
    let mut out = markdown_line(columns.iter().map(|(heading, _)| (*heading).to_string()));
    out += &markdown_line(columns.iter().map(|_| "---".to_string()));
    out.extend(rows.into_iter().map(|row| markdown_line(columns.iter().map(|(_, cell)| cell(row)))));
    out
}

fn markdown_line(cells: impl Iterator<Item = String>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}

/// The cells of CSV; the first record is the header.
fn cells(csv: &str) -> impl Iterator<Item = Vec<String>> {
    let reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(csv.as_bytes());
    reader.into_records().flatten().map(|record| record.iter().map(str::to_string).collect())
}

/// CSV with some of its columns.
pub fn with_columns(csv: &str, is_shown: impl Fn(&str) -> bool) -> String {
    let mut records = cells(csv);
    let header = records.next().unwrap_or_default();
    let shown: Vec<bool> = header.iter().map(|heading| is_shown(heading)).collect();
    let some = |record: Vec<String>| record.into_iter().zip(&shown).filter(|(_, shown)| **shown).map(|(cell, _)| cell);
    csv_text(some(header).collect(), records.map(|record| some(record).collect()))
}

/// CSV as a table of text, without empty columns; whole numbers exact, others with four digits.
pub fn text_of_csv(csv: &str) -> String {
    let records = records(csv);
    let Some((header, rows)) = records.split_first() else { return String::new() };
    let mut places: Vec<usize> = (0..header.len()).collect();
    places.retain(|&column| rows.iter().any(|row| row.get(column).is_some_and(|cell| !cell.is_empty())));
    let heads: Vec<&str> = places.iter().map(|&at| header[at].as_str()).collect();
    let rows = rows.iter().map(|row| places.iter().map(|&at| row.get(at).cloned().unwrap_or_default()).collect());
    table(&heads, &rows.collect::<Vec<_>>())
}

/// The records of CSV, whole numbers exact and other numbers with at most four digits.
fn records(csv: &str) -> Vec<Vec<String>> {
    cells(csv).map(|record| record.into_iter().map(shortened).collect()).collect()
}

/// A cell with at most four significant digits.
fn shortened(cell: String) -> String {
    match cell.parse::<f64>() {
        Ok(x) if x.is_finite() && cell.len() > 6 && cell.contains(['.', 'e', 'E']) => {
            format!("{x:.3e}").parse().unwrap_or(x).to_string()
        }
        _ => cell,
    }
}

/// CSV as a Markdown table.
pub fn markdown(csv: &str) -> String {
    let mut out = String::new();
    for (number, record) in records(csv).iter().enumerate() {
        out += &markdown_line(record.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")));
        if number == 0 {
            out += &markdown_line(record.iter().map(|_| "---".to_string()));
        }
    }
    out
}

/// CSV as a LaTeX tabular with the rules of the package booktabs.
pub fn latex(csv: &str) -> String {
    let records = records(csv);
    let Some(header) = records.first() else { return String::new() };
    // Columns of numbers are aligned to the right.
    let columns = (0..header.len()).map(|column| {
        let mut cells = records[1..].iter().filter_map(|record| record.get(column)).filter(|cell| !cell.is_empty());
        if cells.all(|cell| cell.parse::<f64>().is_ok()) { 'r' } else { 'l' }
    });
    let columns: String = columns.collect();
    let mut out = format!("% needs \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n");
    for (number, record) in records.iter().enumerate() {
        out += &format!("{} \\\\\n", record.iter().map(|cell| latex_text(cell)).collect::<Vec<_>>().join(" & "));
        if number == 0 {
            out += "\\midrule\n";
        }
    }
    out + "\\bottomrule\n\\end{tabular}\n"
}

fn latex_text(cell: &str) -> String {
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
}

/// A cell of a value that may be missing.
pub fn or_empty(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// A number rounded to six decimals, the precision of a measure; a zero loses its sign.
pub fn rounded(x: f64) -> f64 {
    format!("{x:.6}").parse().unwrap_or(x) + 0.0
}

/// A result with `rounded` applied to each number that is not an integer.
pub fn with_rounded(value: Value, rounded: fn(f64) -> f64) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => number.as_f64().map(rounded).into(),
        Value::Array(values) => values.into_iter().map(|value| with_rounded(value, rounded)).collect(),
        Value::Object(fields) => fields.into_iter().map(|(key, value)| (key, with_rounded(value, rounded))).collect(),
        other => other,
    }
}

/// A number with `significant` digits; all digits before the point are kept.
pub fn digits(x: f64, significant: i32) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    let rounded: f64 = format!("{x:.*e}", (significant - 1) as usize).parse().unwrap_or(x);
    let decimals = (significant - 1 - rounded.abs().log10().floor() as i32).clamp(0, 12) as usize;
    // Without decimals, no digit is replaced by 0.
    format!("{:.decimals$}", if decimals == 0 { x } else { rounded })
}

/// A number with three significant digits.
pub fn three(x: f64) -> String {
    digits(x, 3)
}

/// A share as a percentage of two significant digits. One that rounding puts below 0 is 0.
pub fn percent(share: f64) -> String {
    format!("{} %", digits(if share.abs() < 1e-12 { 0.0 } else { 100.0 * share }, 2))
}

/// A number with four digits after the point.
pub fn four(x: f64) -> String {
    format!("{x:.4}")
}

/// A count with its noun, in the plural unless 1.
pub fn count(number: impl Into<u64>, thing: &str) -> String {
    match (number.into(), thing.strip_suffix('y')) {
        (1, _) => format!("1 {thing}"),
        (number, Some(stem)) => format!("{number} {stem}ies"),
        (number, None) => format!("{number} {thing}s"),
    }
}

/// A paragraph in lines of at most [`WIDTH`] columns; all but the first are indented by 2.
pub fn wrapped(text: &str) -> String {
    filled(text.split_whitespace(), 0, 2, WIDTH).join("\n") + "\n"
}

/// Text in lines of at most [`WIDTH`] columns; all but the first are indented by `indent`.
pub fn wrapped_at(text: &str, indent: usize) -> String {
    let lines = text.split('\n').flat_map(|line| filled(line.split(' '), indent, indent, WIDTH));
    lines.map(|line| line.trim_start().to_string()).collect::<Vec<_>>().join(&format!("\n{:indent$}", ""))
}

/// Words in lines of at most `width` columns. The first line begins at column `first`, the others
/// are indented by `indent`.
fn filled<'t>(words: impl Iterator<Item = &'t str>, first: usize, indent: usize, width: usize) -> Vec<String> {
    let (mut lines, mut column, mut begin) = (vec![String::new()], first, first);
    for word in words {
        let length = word.chars().count();
        if column > begin && column + 1 + length > width {
            lines.push(" ".repeat(indent));
            (column, begin) = (indent, indent);
        }
        let line = lines.last_mut().expect("a line");
        if column > begin {
            line.push(' ');
            column += 1;
        }
        line.push_str(word);
        column += length;
    }
    lines
}

/// An indented command in lines of at most [`WIDTH`] columns, which a shell joins.
pub fn shell_lines(command: &str) -> String {
    // A space and a backslash follow all lines but the last.
    format!("  {}", filled(command.split(' '), 2, 6, WIDTH - 2).join(" \\\n"))
}

/// A document with the text between `<!-- NAME -->` and `<!-- end NAME -->` replaced.
pub fn replace_section(document: &str, name: &str, section: &str) -> Option<String> {
    let (open, close) = (format!("<!-- {name} -->\n"), format!("<!-- end {name} -->"));
    let from = document.find(&open)? + open.len();
    let to = from + document[from..].find(&close)?;
    Some(format!("{}{section}{}", &document[..from], &document[to..]))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_share_has_two_digits_and_no_sign_of_rounding() {
        assert_eq!([0.0, -1e-17, 0.96543, 1.0, 0.00412].map(percent), ["0 %", "0 %", "97 %", "100 %", "0.41 %"]);
    }

    #[test]
    fn csv_becomes_a_table_for_papers() {
        let csv = "name,power_mw,digest,events\na|b & c,1.23456,ab,1751840\n\"100 %\",2,,3\n";
        assert!(markdown(csv).contains("| 1751840 |"), "counts are exact");
        let csv = &with_columns(csv, |name| !["digest", "events"].contains(&name));
        assert_eq!(markdown(csv), "| name | power_mw |\n| --- | --- |\n| a\\|b & c | 1.235 |\n| 100 % | 2 |\n");
        let latex = latex(csv);
        assert!(latex.contains("\\begin{tabular}{lr}") && latex.contains("name & power\\_mw \\\\"), "{latex}");
        assert!(latex.contains("a|b \\& c & 1.235 \\\\") && latex.contains("100 \\% & 2"), "{latex}");
    }

    #[test]
    fn a_table_fits_its_columns_and_breaks_no_word() {
        let rows = [["a-long-name", "12.5", "words of a text"], ["b", "7", "more"]];
        let rows = rows.map(|row| row.map(str::to_string).to_vec());
        let header = ["name", "uJ a step", "what it says"];
        let words = |text: &str| text.split_whitespace().map(str::to_string).collect::<BTreeSet<_>>();
        let whole = "name         uJ a step  what it says\na-long-name       12.5  words of a text\n\
                     b                    7  more\n";
        assert_eq!(fitted(&header, &rows, 80), whole);
        for width in [20, 25, 28, 33] {
            let text = fitted(&header, &rows, width);
            assert!(text.lines().all(|line| line.chars().count() <= width), "{text}");
            assert_eq!(words(&text), words(whole), "{text}");
        }
        assert_eq!(fitted(&[], &rows, 80), "");
    }

    #[test]
    fn fields_of_rows_become_cells() {
        let row = serde_json::json!({ "name": "a,b", "low": { "mw": 2.0 }, "n": 3, "on": true, "no": null });
        let rows = [row, Value::Null];
        assert_eq!(csv(&rows, "name,mw_low=low.mw,n,on,no"), "name,mw_low,n,on,no\n\"a,b\",2,3,true,\n,,,,\n");
        assert_eq!(csv(&rows, "high=no.mw"), "high\n\"\"\n\"\"\n");
        for misspelt in ["nam", "low.mv"] {
            assert!(std::panic::catch_unwind(|| csv(&rows, misspelt)).is_err(), "{misspelt}");
        }
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
        assert_eq!(replace_section(document, "x", "new\n").unwrap(), "a\n<!-- x -->\nnew\n<!-- end x -->\nb\n");
        assert_eq!(replace_section(document, "y", "new"), None);
    }
}
