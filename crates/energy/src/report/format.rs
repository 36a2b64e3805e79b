//! Tables and figures as the reports of energy print them.

use nsim_files::table::{digits, three};

/// What stands for a figure that is not known.
pub(super) fn unknown() -> String {
    "unknown".to_string()
}

/// Three digits; of less than a thousandth as a power of ten.
pub(super) fn readable(x: f64) -> String {
    if x > 0.0 && x < 1e-3 { format!("{x:.2e}") } else { three(x) }
}

/// An end of an interval: two significant digits, `2.8k` for thousands.
pub(super) fn brief(x: f64) -> String {
    match x {
        1e6.. => format!("{}M", digits(x / 1e6, 2)),
        1e3.. => format!("{}k", digits(x / 1e3, 2)),
        100.0.. => format!("{x:.0}"),
        0.0..1e-3 if x > 0.0 => format!("{x:.1e}"),
        _ => digits(x, 2),
    }
}
