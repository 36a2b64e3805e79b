//! Tables and figures as the reports of energy print them.

use nsim_files::table::digits;

/// What stands for a figure that is not known.
pub(super) fn unknown() -> String {
    "unknown".to_string()
}

/// An end of an interval: two significant digits, `2.8k` for thousands.
pub(super) fn brief(x: f64) -> String {
    match x {
        1e6.. => format!("{}M", digits(x / 1e6, 2)),
        1e3.. => format!("{}k", digits(x / 1e3, 2)),
        100.0.. => format!("{x:.0}"),
        _ => digits(x, 2),
    }
}

/// A figure of five significant digits or more, at most six decimals, no trailing zeros.
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
