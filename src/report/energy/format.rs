//! Tables and figures as the reports of energy print them.

use comfy_table::{CellAlignment, Table};

use crate::report::text;

/// An empty table: the first column, units and sources to the left, figures to the right.
pub(super) fn plain(header: &[&str]) -> Table {
    let mut table = text::table(header);
    for (i, column) in table.column_iter_mut().enumerate() {
        let left = i == 0 || matches!(header[i], "Unit" | "Source");
        column.set_cell_alignment(if left { CellAlignment::Left } else { CellAlignment::Right });
    }
    table
}

/// What stands for a figure that is not known.
pub(super) fn unknown() -> String {
    "unknown".to_string()
}

/// An integer count of `10^-digits` as a decimal.
pub(super) fn fixed(units: i128, digits: usize) -> String {
    let scale = 10i128.pow(digits as u32);
    let sign = if units < 0 { "-" } else { "" };
    format!("{sign}{}.{:0digits$}", units.abs() / scale, units.abs() % scale)
}

/// A figure with two significant digits.
pub(super) fn two_digits(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    let rounded: f64 = format!("{x:.1e}").parse().unwrap_or(x);
    let decimals = (1 - rounded.abs().log10().floor() as i32).clamp(0, 12) as usize;
    format!("{rounded:.decimals$}")
}

/// A figure with at least five significant digits and no more than six decimals, without trailing zeros.
pub(super) fn short(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    let magnitude = x.abs().log10().floor() as i32;
    if magnitude < -6 {
        return format!("{x:.4e}");
    }
    let decimals = (5 - magnitude).clamp(0, 10) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}
