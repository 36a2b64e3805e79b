//! The energy report as text: the table with its remarks, breakdown, comparison and sources.

use std::fmt::Write;

use super::result::{EnergyReport, Job, JobPart, SampleCost};
use super::table::{is_printed, readable, row_name};
use crate::published::scenario::ScenarioFile;
use nsim_compile::explore::cost_estimate::Score;
use nsim_cost::deployment::Deployment;
use nsim_cost::estimate::{Convention, FigureSource, StatusShare};
use nsim_cost::job::{Accounting, Mode};
use nsim_files::shipped::{CONSTANTS, Shipped};
use nsim_files::table::{count, percent, table, three, wrapped};
use nsim_ir::hardware::constants::Status;

/// Maximum number of cores that the text lists.
const SLOWEST_SHOWN: usize = 6;

/// The text for a figure that is not known.
fn unknown() -> String {
    "unknown".to_string()
}

impl EnergyReport {
    fn head(&self) -> String {
        let Deployment { copies, cores_used, chips_used, x86_cores, .. } = &self.deployment;
        let (copies, chips) = (count(*copies, "copy"), count(*chips_used, "chip"));
        let cores = count(*cores_used, "neuron core");
        let x86 = if *x86_cores > 0 { count(*x86_cores, "x86 core") } else { "no x86 core".to_string() };
        let mode = self.mode.text();
        let (model, target) = (&self.model, &self.target);
        let mut out = wrapped(&format!("{model} on {target}: {copies} on {chips} ({cores}, {x86}), {mode}"));
        let shown = self.input.first().map_or("", String::as_str);
        // The number of samples and the seed do not describe the scene; its other fields do.
        let (scene, fields) = shown.split_once('?').unwrap_or((shown, ""));
        let says =
            |field: &&str| !field.is_empty() && !["samples=", "seed="].iter().any(|name| field.starts_with(name));
        let fields: Vec<&str> = fields.split('&').filter(says).collect();
        let shown = if fields.is_empty() { scene.to_string() } else { format!("{scene}?{}", fields.join("&")) };
        let shown = if self.input.len() > 1 { format!("{shown} and others") } else { shown };
        let samples = match self.accuracy {
            Some(share) => {
                let right = (share * self.labelled as f64).round();
                let undecided = match self.undecided {
                    0 => String::new(),
                    some => format!(", {some} undecided"),
                };
                format!("{right} of {} right{undecided}", count(self.labelled, "sample"))
            }
            None => count(self.samples, "sample"),
        };
        let power = match self.accounting {
            Accounting::Profiler if self.hardware().starts_with("loihi") => "as Intel's profiler counts it",
            accounting => accounting.power_text(),
        };
        out += &wrapped(&format!("{samples} ({shown}). Power {power}."));
        out
    }

    /// The table with its heading and remarks.
    fn table(&self, every_interval: bool) -> String {
        let mut out = format!("{}\n{}", self.head(), self.grid(every_interval));
        for remark in self.table_notes().iter().chain(&self.constant_notes) {
            out += &wrapped(remark);
        }
        out
    }

    /// Remarks below the table, at most seven.
    fn table_notes(&self) -> Vec<String> {
        let Deployment { cores_used, copies, board_chips, chips_used, .. } = &self.deployment;
        if self.accounting == Accounting::Unit {
            let chips = count(*board_chips, "chip");
            let said = format!("The unit's power is of all {chips} with their boards and host; cores add to it.");
            return std::iter::once(said).chain(self.dominant_text()).collect();
        }
        if self.accounting == Accounting::Rails {
            let unused = board_chips - chips_used.min(board_chips);
            let unused = (unused > 0).then(|| {
                let boot = self.estimate.job.boot * unused as f64 / *board_chips as f64;
                format!("{} mW of it belong to chips of the board that are not used ({unused}).", three(boot))
            });
            let packing = "Packing copies on fewer chips saves profiler milliwatts, not board watts.".to_string();
            return unused.into_iter().chain([packing]).chain(self.dominant_text()).collect();
        }
        let each = |total: u64, copies: u32| {
            let cores = total as f64 / f64::from(copies.max(1));
            if cores.fract() == 0.0 { format!("{cores}") } else { three(cores) }
        };
        let mut said = Vec::new();
        let job = self.job.as_ref().filter(|_| self.rows().any(is_printed));
        if *copies > 1 {
            let Job { total_mw, share_mw } = self.job();
            let [all, share] = [total_mw, share_mw].map(|power| power.map_or_else(unknown, three));
            let x86 = if self.deployment.x86_cores > 0 { "one x86 core and " } else { "" };
            said.push(format!("Rows are for {x86}one copy; all copies draw {all} mW, {share} each."));
        }
        if let Some(job) = job.filter(|_| self.deployment.name != "paper") {
            let (own, theirs) = (each(*cores_used, *copies), each(job.deployment.value.cores_used, job.copies.value));
            said.push(format!("Cores of a copy: {own}; in the paper {theirs}. Static power scales with them."));
        }
        said.extend(job.map(|job| self.assumptions_text(job)));
        let mut marks = Vec::new();
        let printed: Vec<String> = self.printed.iter().map(|[energy, edp]| format!("{energy} and {edp}")).collect();
        if !printed.is_empty() {
            marks.push(match self.convention() {
                Convention::Physical => format!("* power x time; printed: {} (power / 150).", printed.join(", ")),
                Convention::Published => {
                    "Energy is power / steps of a sample; the paper prints pJ s as nJ s.".to_string()
                }
            });
        }
        if self.rows().any(|row| row.power_source != row.source && row.power_source == FigureSource::Assumed) {
            marks.push("? assumed power".to_string());
        }
        if self.rows().any(|row| row.busy.is_some()) {
            marks.push("busy: measured while other programs kept this many processors busy".to_string());
        }
        said.extend(Some(marks.join(" ")).filter(|marks| !marks.is_empty()));
        said.extend(self.dominant_text());
        let last = match job {
            Some(_) => "nsim bench published omits the paper's own results, so its intervals are wider.",
            None => "Fewer cores save profiler milliwatts, not board watts (--accounting rails).",
        };
        said.extend((said.len() < 7).then(|| last.to_string()));
        said
    }

    /// Remark on ratios of units of the published job, and on what its source does not state.
    fn assumptions_text(&self, job: &ScenarioFile) -> String {
        fn part(part: &JobPart) -> String {
            let [fixed, dynamic, _] = part.ratios().map(|ratio| ratio.map_or_else(unknown, |x| format!("{x:.2}")));
            format!("{} {fixed}, {dynamic}", row_name(&part.here, &part.here.hardware))
        }
        let parts: Vec<String> = self.parts.iter().map(part).collect();
        let relays = if job.input_relays { "relays; " } else { "" };
        let streams = if self.deployment.streams > 1 { "one stream per copy" } else { "one stream" };
        format!(
            "Static, dynamic over printed: {}. Inferred: a row is an x86 core and a copy; {relays}{streams}; input \
             spikes.",
            parts.join("; ")
        )
    }

    /// Remark on the largest part of a step's time.
    fn dominant_text(&self) -> Option<String> {
        let times = self.estimate.time_us?;
        let all: f64 = times.iter().map(|(_, us)| us).sum();
        let (name, most) = times.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|_| all > 0.0)?;
        let what = match name {
            "injection" => &self.injection_text(most),
            "turn" => "the turn of the x86 core",
            "slowest core" => "the slowest core",
            "transport" => "messages on the mesh",
            "barrier" => "the barrier",
            _ => "resetting state",
        };
        let free = if self.mode == Mode::Realtime { "A step's work takes" } else { "A step takes" };
        let share = (100.0 * most / all).floor();
        let without = if self.inputs_on_chip.is_some() { " Inputs on chip: --host none." } else { "" };
        Some(format!("{free} {} us, {share} % of it for {what}.{without}", three(all)))
    }

    /// Text on injection: the input spikes of a step, and the constants' time of one.
    fn injection_text(&self, injection_us: f64) -> String {
        let of_one = self.constants.iter().find(|entry| entry.name == "injection_time").map(|entry| entry.value);
        match of_one {
            Some(us) if us > 0.0 => format!("{} input spikes of {} us", three(injection_us / us), three(us)),
            _ => "injecting input spikes".to_string(),
        }
    }

    /// The last line: time and energy of a sample.
    fn sample_text(&self) -> String {
        let Some(SampleCost { steps, time_us, energy_uj, cores_uj }) = self.sample() else { return String::new() };
        let steps = if steps.fract() == 0.0 { format!("{steps}") } else { format!("{} (mean)", three(steps)) };
        let cores = cores_uj.map_or(String::new(), |uj| format!("; of it the neuron cores alone: {} uJ", readable(uj)));
        let steps = if steps == "1" { "1 step".to_string() } else { format!("{steps} steps") };
        wrapped(&format!("A sample of {steps}: {} ms, {} uJ{cores}.", readable(time_us / 1e3), readable(energy_uj)))
    }

    /// The short report: the table in eighty columns, remarks, early exit, cost of a sample.
    pub fn headline(&self) -> String {
        let mut out = self.table(false);
        if let Some(saved) = self.early_exit {
            let shares = saved.energy_saved_share.zip(saved.idle_saved_share);
            let share = shares.map_or(String::new(), |(off, idle)| {
                let [off, idle] = [off, idle].map(percent);
                format!(", and {off} of energy if the chip is off after the decision, {idle} if it idles")
            });
            out += &wrapped(&format!(
                "early exit {}: {} of {} samples decided early; saves {} of {} timesteps{share}. {}",
                saved.rule,
                saved.decided,
                self.samples,
                saved.steps_saved,
                self.timesteps,
                self.comparison.decisions(self.accuracy)
            ));
        }
        out + &self.sample_text()
    }

    /// The whole report for readers, most important parts first.
    pub fn text(&self) -> String {
        let mut out = self.table(true) + &self.sample_text();
        out.push('\n');
        out.push_str(&self.breakdown());
        out.push_str(&self.shares());
        out.push_str(&self.comparison.text(self.accuracy));
        out.push_str(&self.detail.populations_text(self.timesteps));
        out.push_str(&self.detail.slowest_text(SLOWEST_SHOWN));
        if let Some(Score { energy_uj, step_us, .. }) = self.expected {
            out += &wrapped(&format!(
                "At these mean rates, nsim map --profile expects {} uJ for the whole job of {} mapped here, and {} us \
                 per timestep. It assumes that every compartment is active and spikes are spread evenly.",
                three(energy_uj),
                count(self.copies_counted, "copy"),
                three(step_us)
            ));
            out.push('\n');
        }
        if let Some(saved) = self.early_exit {
            out += &wrapped(&format!(
                "Early exit {}: {} of {} samples are decided before their end. Early exit would save {} of the {} \
                 timesteps, {} us and {} uJ{}. The figures above are for whole samples.",
                saved.rule,
                saved.decided,
                self.samples,
                saved.steps_saved,
                self.timesteps,
                three(saved.time_saved_us),
                three(saved.energy_saved_uj),
                saved.energy_saved_share.map_or(String::new(), |share| format!(
                    " ({}) if the chip is off after the decision",
                    percent(share)
                )),
            ));
            out.push('\n');
        }
        for (row, source) in &self.baselines {
            out += &wrapped(&format!("{}: {source}", row_name(row, self.hardware())));
        }
        if let Some(job) = self.job.as_ref().filter(|_| !self.parts.is_empty()) {
            out += &wrapped(&format!("The paper's job: {}. {}", job.source, job.notes));
        }
        out.push_str(&self.sources());
        out
    }

    /// Shares of the `total` row by the status of constants, column by column.
    fn shares(&self) -> String {
        let Some(row) = self.total() else { return String::new() };
        let mut rows = Vec::new();
        let columns = [("static power", row.shares.static_mw), ("dynamic power", row.shares.dynamic_mw)];
        for (name, share) in columns.into_iter().chain([("total power", row.share), ("latency", row.shares.latency_us)])
        {
            let Some(StatusShare { published, fitted, assumed }) = share else { continue };
            let cells = [published, fitted, assumed].map(|share| format!("{:.0} %", (100.0 * share).round() + 0.0));
            rows.push([name.to_string()].into_iter().chain(cells).collect());
        }
        if rows.is_empty() {
            return String::new();
        }
        let spikes = "The number of input spikes is not a constant: it is counted in the samples.";
        table(&["From constants", "published", "calibrated", "assumed"], &rows) + &wrapped(spikes) + "\n"
    }

    fn breakdown(&self) -> String {
        let mut out = String::new();
        let Some(parts) = &self.estimate.breakdown_pj else { return out };
        let total: f64 = parts.iter().map(|(_, pj)| pj).sum();
        let row = |(name, pj): &(_, f64)| {
            let share = if total > 0.0 { format!("{:.1} %", 100.0 * pj / total) } else { unknown() };
            vec![<&str>::to_string(name), three(*pj), share]
        };
        let is_shown = |(name, pj): &&(&str, f64)| *name != "learning" || *pj > 0.0;
        let mut rows: Vec<Vec<String>> = parts.iter().filter(is_shown).map(row).collect();
        rows.push(vec!["sum".to_string(), three(total), String::new()]);
        let _ = writeln!(out, "{}", table(&["Dynamic energy of the neuron cores", "pJ per timestep", "Share"], &rows));
        if let Some(times) = self.estimate.time_us {
            let listed: Vec<String> = times.iter().map(|(name, us)| format!("{name} {}", three(*us))).collect();
            let overlap = "The cores' part is what remains after injection, during which they work.";
            out += &wrapped(&format!("Work of a timestep, mean in us: {}. {overlap}", listed.join(", ")));
            if let Some(share) = self.estimate.x86_share {
                out += &wrapped(&format!("Time of x86 cores for input: {} of a step.", percent(share)));
            }
        }
        for (what, spread) in [
            ("Energy of a timestep, all power included (uJ, power x time)", self.estimate.per_timestep_uj),
            ("Dynamic energy of the neuron cores in a timestep (uJ)", self.estimate.per_timestep_dynamic_uj),
        ] {
            if let Some(s) = spread {
                let [min, p50, p99, max] = [s.min, s.p50, s.p99, s.max].map(three);
                out += &wrapped(&format!("{what}: least {min}, median {p50}, 99th percentile {p99}, greatest {max}."));
            }
        }
        out.push('\n');
        out
    }

    /// Numbers of published, calibrated and assumed constants, and the assumed ones by name.
    fn sources(&self) -> String {
        let of = |status| self.constants.iter().filter(move |entry| entry.status == status);
        let assumed: Vec<&str> = of(Status::Assumed).map(|entry| entry.name.as_str()).collect();
        let mut out = format!(
            "Constants {}: {} published, {} calibrated, {} assumed",
            self.preset,
            of(Status::Published).count(),
            of(Status::Calibrated).count(),
            assumed.len()
        );
        if !assumed.is_empty() {
            let _ = write!(out, " ({})", assumed.join(", "));
        }
        let absent = of(Status::NotGiven).count();
        if absent > 0 {
            let _ = write!(out, ", {absent} not given");
        }
        match Shipped::find(CONSTANTS, &self.preset) {
            Some(shipped) => {
                let _ = write!(out, ". nsim show {} prints each with its source and findings.", shipped.name);
            }
            None => out.push_str(". --format json lists each with its source."),
        }
        wrapped(&out)
    }
}
