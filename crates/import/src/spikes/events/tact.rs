//! VT_SNN's recordings of the NeuTouch fingertips, `.tact`.
//!
//! Rows of text: polarity, cell from 1 to 80 and seconds; an older variant has whole seconds and
//! nanoseconds (VT_SNN 9215087, `preprocess.py`; facts only). Cells 17 and 49 are not taxels: 78
//! remain, 39 of each finger. A channel is `2 taxel + polarity`, VT_SNN's order of its arrays `[78,
//! 2, T]`.

use std::io::BufRead;

use super::event::{Event, Sink, rows, wrong};
use nsim_ir::base::diagnostic::Result;

/// Number of taxels; an event's x is a taxel.
pub const TAXELS: u32 = 78;
const MOST_ROW: usize = 256;

/// Reads a file.
pub fn tact(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    rows(input, MOST_ROW, sink, |text, sink| {
        if text.starts_with('#') {
            return Ok(());
        }
        let bad = |what: String| wrong(what).help("a row is: polarity (0 or 1), cell (1 to 80), seconds");
        let fields: Vec<f64> = text.split_whitespace().map_while(|field| field.parse().ok()).collect();
        let seconds = match (fields.len() == text.split_whitespace().count(), fields.as_slice()) {
            (true, &[_, _, seconds]) => seconds,
            (true, &[_, _, seconds, nanoseconds]) => seconds + nanoseconds * 1e-9,
            _ => {
                let shown: String = text.chars().take(40).collect();
                return Err(bad(format!("'{shown}' is not three or four numbers")));
            }
        };
        let (polarity, cell) = (fields[0], fields[1]);
        if !(polarity == 0.0 || polarity == 1.0) || !(1.0..=80.0).contains(&cell) || cell.fract() != 0.0 {
            return Err(bad(format!("polarity {polarity}, cell {cell}")));
        }
        if !(seconds.is_finite() && seconds.abs() < 1e12) {
            return Err(bad(format!("a time of {seconds} s")));
        }
        let x = match cell as u32 {
            17 | 49 => return Ok(()),
            cell => cell - 1 - u32::from(cell > 17) - u32::from(cell > 49),
        };
        sink.event(Event { t_us: (seconds * 1e6).round() as i64, x, y: 0, on: polarity == 1.0 })
    })
}
