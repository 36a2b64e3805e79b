//! The energy table: its lines as text and as comma-separated values for papers.
//!
//! The layout is that of the VT-SNN paper: three digits for nsim's figures, all printed ones else.

use std::fmt::Write;

use super::result::{EnergyReport, JobPart};
use nsim_cost::estimate::{Bound, Convention, EnergyRow, FigureSource, RowUnit};
use nsim_cost::job::Accounting;
use nsim_files::table::{count, csv, csv_text, digits, three};

/// Widths of the columns of the table: name, powers, latency, energy, energy-delay product.
const WIDTHS: [usize; 7] = [16, 7, 8, 8, 11, 10, 9];

/// Name of a row in the table.
pub(super) fn row_name(row: &EnergyRow, chip: &str) -> String {
    if row.hardware != chip {
        return match (row.source, row.hardware.split_once(", ")) {
            (FigureSource::Simulated, Some((_, job))) => job.replace("in the VT-SNN paper", "in the paper"),
            (FigureSource::Published, Some((work, "printed"))) => work.replace("the VT-SNN paper", "the paper"),
            _ => row.hardware.clone(),
        };
    }
    match row.unit {
        // Of the x86 cores of a copy the row counts all.
        RowUnit::X86 if row.x86_cores.is_some_and(|cores| cores > 1) => {
            count(row.x86_cores.unwrap_or_default(), "x86 core")
        }
        RowUnit::X86 => "x86 core".to_string(),
        RowUnit::Neuron => "neuron cores".to_string(),
        RowUnit::Boot => "board, boot".to_string(),
        RowUnit::Idle => "board, idle".to_string(),
        // Intel's chips as the field writes them; other names as their files do.
        RowUnit::Total => chip.strip_prefix("loihi").map_or(chip.to_string(), |rest| format!("Loihi{rest}")),
    }
}

/// Whether a publication printed the row for the chip.
pub(super) fn is_printed(row: &EnergyRow) -> bool {
    row.source == FigureSource::Published && row.hardware.ends_with(", printed")
}

/// Three digits, with a power of ten below a thousandth.
pub(super) fn readable(x: f64) -> String {
    if x > 0.0 && x < 1e-3 { format!("{x:.2e}") } else { three(x) }
}

/// An end of an interval: two significant digits, `2.8k` for thousands.
fn brief(x: f64) -> String {
    match x {
        1e6.. => format!("{}M", digits(x / 1e6, 2)),
        1e3.. => format!("{}k", digits(x / 1e3, 2)),
        100.0.. => format!("{x:.0}"),
        0.0..1e-3 if x > 0.0 => format!("{x:.1e}"),
        _ => digits(x, 2),
    }
}

/// A line of the table.
fn line(widths: &[usize; 7], name: &str, cells: &[String; 6], source: &str) -> String {
    let mut out = format!("{name:<width$}", width = widths[0]);
    // A name that is too long takes room from the first column.
    let mut over = out.chars().count().saturating_sub(widths[0]);
    for (at, (cell, width)) in cells.iter().zip(&widths[1..]).enumerate() {
        if at == 5 && cell.chars().count() >= *width {
            out.push(' ');
        }
        let width = width.saturating_sub(over).max(cell.chars().count().min(*width));
        over = 0;
        let _ = write!(out, "{cell:>width$}");
    }
    let text = format!("{out}  {source}");
    format!("{}\n", text.trim_end())
}

impl EnergyReport {
    /// The rows as comma-separated values with a header; unknown figures are empty.
    pub fn csv(&self) -> String {
        let columns = "hardware,unit,convention,static_mw,dynamic_mw,total_mw,latency_us,energy_uj,edp_pjs,\
                       total_mw_low=low.total_mw,latency_us_low=low.latency_us,energy_uj_low=low.energy_uj,\
                       edp_pjs_low=low.edp_pjs,total_mw_high=high.total_mw,latency_us_high=high.latency_us,\
                       energy_uj_high=high.energy_uj,edp_pjs_high=high.edp_pjs,source,power_source,energy_source";
        csv(self.rows(), columns)
    }

    /// Units of the energy and of the energy-delay product, with their factors from uJ and pJ s.
    /// The total energy decides its unit; the convention fixes the unit of the product.
    fn units(&self) -> [(&'static str, f64); 2] {
        if self.convention() == Convention::Published {
            return [("(mW/steps)", 1.0), ("(pJ s)", 1.0)];
        }
        let small = self.total().and_then(|row| row.energy_uj).is_some_and(|uj| uj > 0.0 && uj < 0.1);
        [if small { ("(nJ/step)", 1e3) } else { ("(uJ/step)", 1.0) }, ("(nJ s)", 1e-3)]
    }

    /// The cells of a row: static, dynamic and total power, latency, energy, energy-delay product.
    fn cells(&self, row: &EnergyRow) -> [String; 6] {
        let printed = row.source == FigureSource::Published;
        let computed = row.energy_source == FigureSource::Computed;
        let assumed = row.power_source != row.source && row.power_source == FigureSource::Assumed;
        fn cell(figure: Option<f64>, exact: bool) -> String {
            match figure {
                None => String::new(),
                Some(figure) if exact => format!("{figure}"),
                Some(figure) => readable(figure),
            }
        }
        let mark = if assumed { "?" } else { "" };
        let power = |figure: Option<f64>| cell(figure, printed) + mark;
        let [(_, of_energy), (_, of_edp)] = self.units();
        let product = |figure: Option<f64>| {
            let text = match figure {
                Some(figure) if computed && figure >= 1e3 => format!("{figure:.0}"),
                figure => cell(figure, printed && !computed),
            };
            let mark = if computed { "*" } else { mark };
            if text.is_empty() { text } else { text + mark }
        };
        let is_part = matches!(row.unit, RowUnit::X86 | RowUnit::Neuron);
        [
            power(row.static_mw),
            power(row.dynamic_mw),
            power(row.total_mw),
            if is_part { String::new() } else { cell(row.latency_us, printed) },
            if is_part { String::new() } else { product(row.energy_uj.map(|uj| uj * of_energy)) },
            if is_part { String::new() } else { product(row.edp_pjs.map(|pjs| pjs * of_edp)) },
        ]
    }

    /// The interval of a row, where it has one.
    fn interval(&self, row: &EnergyRow) -> Option<[String; 6]> {
        let (low, high) = (row.low?, row.high?);
        let range = |figure: fn(&Bound) -> Option<f64>, unit: f64| match (figure(&low), figure(&high)) {
            (Some(low), Some(high)) => format!("{}-{}", brief(low * unit), brief(high * unit)),
            _ => String::new(),
        };
        let [(_, of_energy), (_, of_edp)] = self.units();
        let [total, latency] = [range(|b| b.total_mw, 1.0), range(|b| b.latency_us, 1.0)];
        let [energy, edp] = [range(|b| b.energy_uj, of_energy), range(|b| b.edp_pjs, of_edp)];
        Some([String::new(), String::new(), total, latency, energy, edp])
    }

    /// Name, cells and source of each line of the table, intervals after their rows.
    fn lines(&self, every_interval: bool) -> Vec<(String, [String; 6], String)> {
        let mut lines = Vec::new();
        for row in self.rows() {
            let own = row.hardware == self.hardware();
            if row.x86_cores == Some(0) {
                continue;
            }
            // The only figure of rails that no published total bounds.
            let at_work = own && row.unit == RowUnit::X86 && self.accounting == Accounting::Rails;
            let is_part = row.unit.is_part();
            let source = match row.busy {
                Some(_) => "busy CPUs".to_string(),
                None if own && is_part => String::new(),
                None => row.source.name().to_string(),
            };
            lines.push((row_name(row, self.hardware()), self.cells(row), source));
            if is_printed(row) {
                for JobPart { here, printed } in &self.parts {
                    let name = format!("  {}", row_name(here, &here.hardware));
                    lines.push((name, self.cells(printed), String::new()));
                }
            }
            let of_interval = if self.level.is_some() { "  80 % interval" } else { "  model's bounds" };
            if (row.source == FigureSource::Simulated && (every_interval || !is_part) || at_work)
                && let Some(mut interval) = self.interval(row)
            {
                // Time and energy belong to the whole, not to a part.
                interval[3..].iter_mut().filter(|_| is_part).for_each(String::clear);
                lines.push((of_interval.to_string(), interval, String::new()));
            }
            if let Some(alone) = self.inputs_on_chip.as_ref().filter(|_| own && row.unit == RowUnit::Total) {
                lines.push(("inputs on chip".to_string(), self.cells(alone), alone.source.name().to_string()));
                let interval = self.interval(alone);
                lines.extend(interval.map(|interval| (of_interval.to_string(), interval, String::new())));
            }
        }
        lines
    }

    /// Headings of the six columns.
    fn headings(&self) -> [String; 6] {
        let [(energy, _), (edp, _)] = self.units();
        ["static", "dynamic", "total", "(us/step)", energy, edp].map(str::to_string)
    }

    /// The lines of the table.
    pub(super) fn grid(&self, every_interval: bool) -> String {
        let mut out = String::new();
        let groups = ["", "power", "(mW)", "latency", "energy", "EDP"].map(str::to_string);
        let lines = self.lines(every_interval);
        let mut widths = WIDTHS;
        let needs = |column: usize| {
            let longest = lines.iter().map(|(_, cells, _)| cells[column].chars().count()).max();
            longest.unwrap_or_default().max(self.headings()[column].len()) + 1
        };
        // The last column of an interval may extend into the column of the source.
        (0..5).for_each(|column| widths[column + 1] = WIDTHS[column + 1].max(needs(column)));
        // Width beyond a terminal's is taken from columns with room.
        let mut over = widths.iter().sum::<usize>().saturating_sub(WIDTHS.iter().sum());
        for column in (0..5).rev() {
            let room = widths[column + 1].saturating_sub(needs(column)).min(over);
            widths[column + 1] -= room;
            over -= room;
        }
        // A name that is then too long takes width from the first column.
        widths[0] -= over.min(2);
        out += &line(&widths, "", &groups, "");
        out += &line(&widths, "", &self.headings(), "");
        for (name, cells, source) in lines {
            out += &line(&widths, &name, &cells, &source);
        }
        out
    }

    /// The table as comma-separated values for a paper: its lines with all cells.
    pub fn paper_csv(&self) -> String {
        let physical = self.convention() == Convention::Physical;
        let energy = if physical { "Energy (\u{b5}J)" } else { "Energy (mW / steps)" };
        let edp = if physical { "EDP (nJ s)" } else { "EDP (pJ s)" };
        let header =
            ["Hardware", "Static (mW)", "Dynamic (mW)", "Total (mW)", "Latency (\u{b5}s)", energy, edp, "Source"];
        // A mark needs its footnote in the same row.
        fn marked(cells: &[String; 6], source: String) -> String {
            match cells.iter().any(|cell| cell.ends_with('*')) {
                true => format!("{source}; * from its power x time"),
                false => source,
            }
        }
        // Without indentation, a line names the row to which it belongs.
        let mut above = String::new();
        let row = |(name, cells, source): (String, [String; 6], String)| {
            let name = match name.strip_prefix("  ") {
                Some(part) => format!("{above}: {part}"),
                None => name,
            };
            if !name.contains(": ") {
                above.clone_from(&name);
            }
            std::iter::once(name).chain(cells.clone()).chain([marked(&cells, source)]).collect()
        };
        csv_text(header.map(String::from).to_vec(), self.lines(false).into_iter().map(row))
    }
}
