//! Constants from what is known of them: one value and one interval from several sources.
//!
//! Input: findings of each constant, the work that must not be used, and the jobs that are asked about. Output: tables of constants: at their values, and for
//! each group of constants that are wrong together at the low and at the high end.
//!
//! The value is the median of the findings; of two in the middle their mean, or the lower where findings may hold more than the
//! constant. The interval holds them all, and each with its own uncertainty: 25 % to either side
//! of a published finding, a factor of 1.5 of a fitted one, a factor of 2 of an assumed one. A constant of which nothing is left
//! takes the base preset's value as an assumption.

use crate::base::diagnostic::Result;
use crate::base::units::{Nanowatts, Picoseconds};
use crate::cost::constants::CostTable;
use crate::desc::published::evidence::{
    ConstantEvidence, EvidenceFile, Finding, Jobs, RESET_WORD_TIME, X86_BOOT_POWER,
};
use crate::desc::published::workload::Accounting;
use crate::desc::target::constants::{Constant, Constants, Status, Unit};

/// How a preset of the median of findings is named, behind the name of the evidence.
const PRESET: &str = "evidence";

/// The group of the barrier's times, which presets give and evidence does not.
const BARRIER: &str = "barrier";

/// A constant with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// The median of its findings.
    pub value: f64,
    /// The least that holds all.
    pub low: f64,
    /// The greatest.
    pub high: f64,
}

/// How far a finding may be wrong, as a factor.
fn uncertainty(status: Status) -> f64 {
    match status {
        Status::Published => 1.25,
        Status::Calibrated => 1.5,
        Status::Assumed => 2.0,
    }
}

impl Known {
    /// From findings; `None` when there is none.
    #[must_use]
    pub fn from_findings<'f>(findings: impl IntoIterator<Item = &'f Finding>, upper_bounds: bool) -> Option<Known> {
        let mut found: Vec<(f64, f64)> =
            findings.into_iter().map(|finding| (finding.value.value, uncertainty(finding.status))).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let middle = found.len() / 2;
        let value = match found.len() % 2 {
            _ if found.is_empty() => return None,
            1 => found[middle].0,
            _ if upper_bounds => found[middle - 1].0,
            _ => (found[middle - 1].0 + found[middle].0) / 2.0,
        };
        let low = found.iter().map(|(value, factor)| value / factor).fold(f64::INFINITY, f64::min);
        let high = found.iter().map(|(value, factor)| value * factor).fold(0.0, f64::max);
        Some(Known { value, low, high })
    }
}

/// Constants as a prediction needs them.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstantSet {
    /// Those that counts multiply.
    pub table: CostTable,
    /// [`RESET_WORD_TIME`].
    pub reset_word_time: Picoseconds,
    /// [`X86_BOOT_POWER`].
    pub x86_boot_power: Nanowatts,
}

/// Constants at their values and at the ends of their intervals.
#[derive(Debug, Clone)]
pub struct ConstantSets {
    /// All at their values.
    pub value: ConstantSet,
    /// A group at its low end and at its high end, all others at their values.
    pub groups: Vec<(String, [ConstantSet; 2])>,
}

/// A constant of the evidence: its name, its group, what is known of it.
type KnownConstant<'f> = (&'f str, &'f str, Known);

/// Which findings count.
#[derive(Debug, Clone, Copy, Default)]
struct Asked<'w> {
    /// None that this work has a part in.
    without: Option<&'w str>,
    /// Those under this accounting, where there are any.
    accounting: Option<Accounting>,
    /// Those of these jobs and those of all jobs, where there are any.
    jobs: Option<Jobs>,
}

/// Findings that count.
fn counted<'f>(entry: &'f ConstantEvidence, asked: Asked<'_>) -> Vec<&'f Finding> {
    let others = |finding: &&Finding| asked.without.is_none_or(|work| !finding.is_of(work));
    let mut found: Vec<&Finding> = entry.findings.iter().filter(others).collect();
    let under = |finding: &Finding| asked.accounting.is_none_or(|accounting| finding.accounting == accounting);
    let of_jobs = |finding: &Finding| asked.jobs.is_none_or(|jobs| finding.jobs.is_none_or(|own| own == jobs));
    for counts in [&under as &dyn Fn(&Finding) -> bool, &of_jobs] {
        if found.iter().any(|finding| counts(finding)) {
            found.retain(|finding| counts(finding));
        }
    }
    found
}

/// What is known of each constant by the findings that count.
fn known<'f>(file: &'f EvidenceFile, base: &Constants, asked: Asked<'_>) -> Vec<KnownConstant<'f>> {
    let one = |entry: &'f ConstantEvidence| {
        let known = Known::from_findings(counted(entry, asked), entry.upper_bounds).unwrap_or_else(|| {
            let (value, factor) = (value_in(base, &entry.constant.value), uncertainty(Status::Assumed));
            Known { value, low: value / factor, high: value * factor }
        });
        (entry.constant.value.as_str(), entry.group.as_str(), known)
    };
    file.constants.iter().map(one).collect()
}

/// The groups, each once, in the order of the file; the barrier's last.
fn groups<'f>(known: &[KnownConstant<'f>]) -> Vec<&'f str> {
    let mut seen = std::collections::HashSet::new();
    known.iter().map(|&(_, group, _)| group).chain([BARRIER]).filter(|group| seen.insert(*group)).collect()
}

/// Sets a constant, with as many digits as its least unit holds; false when presets do not have it.
fn set(constants: &mut Constants, name: &str, value: f64) -> bool {
    let digits = if Constants::unit_of(name) == Some(Unit::mW) { 1e6 } else { 1e3 };
    let Some(constant) = constants.get_mut(name) else { return false };
    constant.value = ((value * digits).round() / digits).into();
    true
}

/// Multiplies the times of the barrier.
fn scale_barrier(constants: &mut Constants, factor: f64) {
    for entry in &mut constants.barrier {
        entry.time.value = ((entry.time.value.value * factor * 1e6).round() / 1e6).into();
    }
}

/// A preset with one group after the other at the low and at the high end of its intervals, all else as it is. An interval holds
/// the preset's own value.
#[must_use]
pub fn ends(file: &EvidenceFile, preset: &Constants) -> Vec<Constants> {
    let known = known(file, preset, Asked::default());
    let factor = uncertainty(Status::Calibrated);
    let moved = |group: &str, high: bool| {
        let mut constants = preset.clone();
        for (name, _, known) in known.iter().filter(|(_, own, _)| *own == group) {
            let own = value_in(preset, name);
            set(&mut constants, name, if high { own.max(known.high) } else { own.min(known.low) });
        }
        if group == BARRIER {
            scale_barrier(&mut constants, if high { factor } else { 1.0 / factor });
        }
        constants
    };
    groups(&known).into_iter().flat_map(|group| [moved(group, false), moved(group, true)]).collect()
}

/// What the findings under an accounting come to, as a preset: each constant at their median, or at that of all where none is
/// under this accounting; what no source speaks of as in the base.
#[must_use]
pub fn preset(file: &EvidenceFile, base: &Constants, accounting: Accounting) -> Constants {
    let mut constants = base.clone();
    constants.name = match accounting {
        Accounting::Profiler => format!("{}-{PRESET}", file.name),
        Accounting::Board => format!("{}-{PRESET}-board", file.name),
    };
    constants.notes = format!(
        "The median of what sources say of each constant (mapping/constants/evidence.ron); barrier times and what no source speaks \
         of are {}'s.",
        base.name
    );
    constants.residuals.clear();
    // What a core draws, not what a profiler leaves to it on a board that is almost all off.
    let asked = Asked { without: None, accounting: Some(accounting), jobs: Some(Jobs::SeveralChips) };
    for (name, _, known) in known(file, base, asked) {
        if !set(&mut constants, name, known.value) {
            continue;
        }
        let entry = file.constants.iter().find(|entry| entry.constant.value == name);
        if let (Some(constant), Some(entry)) = (constants.get_mut(name), entry) {
            let counted = counted(entry, asked);
            constant.status = counted.iter().map(|finding| finding.status).max().unwrap_or(Status::Assumed);
            let works = counted.iter().map(|finding| format!("{} {}", finding.work, finding.value.value));
            let median = if entry.upper_bounds { "lower median" } else { "median" };
            constant.source = format!("{median} of {}", works.collect::<Vec<_>>().join(", "));
        }
    }
    constants
}

/// The interval of a figure from its value and from what it becomes with each group at its ends: groups are independent, so that
/// their effects on the logarithm of the figure are added up in squares.
#[must_use]
pub fn interval(value: f64, pairs: impl IntoIterator<Item = [f64; 2]>) -> (f64, f64) {
    let (mut below, mut above) = (0.0, 0.0);
    for [a, b] in pairs {
        below += (value / a.min(b).min(value)).ln().powi(2);
        above += (a.max(b).max(value) / value).ln().powi(2);
    }
    if value > 0.0 { (value / f64::sqrt(below).exp(), value * f64::sqrt(above).exp()) } else { (value, value) }
}

impl ConstantSets {
    /// The sets by all findings but those of a work, for such jobs.
    ///
    /// # Errors
    /// As [`CostTable::new`].
    pub fn new(file: &EvidenceFile, base: &Constants, without: Option<&str>, jobs: Jobs) -> Result<Self> {
        let known = known(file, base, Asked { without, accounting: None, jobs: Some(jobs) });
        let at = |group: &str, end: fn(&Known) -> f64, barrier: f64| {
            let mut constants = base.clone();
            constants.name.clone_from(&file.name);
            let [mut reset_ns, mut boot_mw] = [0.0; 2];
            for (name, own, known) in &known {
                let value = if *own == group { end(known) } else { known.value };
                match *name {
                    RESET_WORD_TIME => reset_ns = value,
                    X86_BOOT_POWER => boot_mw = value,
                    name => {
                        set(&mut constants, name, value);
                    }
                }
            }
            if group == BARRIER {
                scale_barrier(&mut constants, barrier);
            }
            CostTable::new(&constants).map(|table| ConstantSet {
                table,
                reset_word_time: Picoseconds((reset_ns * 1e3).round() as u64),
                x86_boot_power: Nanowatts((boot_mw * 1e6).round() as u64),
            })
        };
        let factor = uncertainty(Status::Calibrated);
        let ends = |name: &str| {
            let low = at(name, |known| known.low, 1.0 / factor)?;
            Ok((name.to_string(), [low, at(name, |known| known.high, factor)?]))
        };
        Ok(ConstantSets {
            value: at("", |known| known.value, 1.0)?,
            groups: groups(&known).into_iter().map(ends).collect::<Result<Vec<_>>>()?,
        })
    }

    /// Every set: values first, then low and high of each group.
    pub fn all(&self) -> impl Iterator<Item = &ConstantSet> {
        std::iter::once(&self.value).chain(self.groups.iter().flat_map(|(_, ends)| ends))
    }
}

fn value_in(base: &Constants, name: &str) -> f64 {
    let found = base.list().into_iter().find(|(own, _)| *own == name);
    found.map_or(0.0, |(_, constant): (_, &Constant)| constant.value.value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::{Femtojoules, Nanowatts};
    use crate::cost::constants::tests::preset;

    fn finding(work: &str, value: f64, status: Status) -> Finding {
        let accounting = Accounting::Profiler;
        let (shared_with, jobs) = (Vec::new(), None);
        Finding {
            work: work.to_string(),
            shared_with,
            jobs,
            value: value.into(),
            accounting,
            status,
            source: "s".to_string(),
        }
    }

    #[test]
    fn the_value_is_the_median_and_the_interval_holds_every_finding() {
        let all = [
            finding("a", 4.0, Status::Published),
            finding("b", 10.0, Status::Calibrated),
            finding("c", 5.0, Status::Published),
        ];
        assert_eq!(Known::from_findings(&all, false), Some(Known { value: 5.0, low: 3.2, high: 15.0 }));
        assert_eq!(Known::from_findings(&all[..2], false), Some(Known { value: 7.0, low: 3.2, high: 15.0 }));
        assert_eq!(Known::from_findings(&all[..2], true).unwrap().value, 4.0);
        assert_eq!(Known::from_findings(&[], false), None);
    }

    #[test]
    fn the_shipped_preset_is_what_the_evidence_comes_to() {
        let file = crate::io::published::evidence::shipped().unwrap();
        let made = super::preset(&file, &preset(&file.base.value), Accounting::Profiler);
        let shipped = preset("loihi1-evidence");
        let text = |constants| crate::io::target::constants_text(constants, "");
        assert_eq!(
            text(&made),
            text(&shipped),
            "run: nsim bench published --preset mapping/constants/loihi1-evidence.ron"
        );
    }

    #[test]
    fn effects_add_up_in_squares_on_the_logarithm() {
        let (low, high) = interval(10.0, [[5.0, 20.0], [5.0, 10.0], [10.0, 10.0]]);
        assert!((low - 10.0 / 2f64.powf(2f64.sqrt())).abs() < 1e-9 && (high - 20.0).abs() < 1e-9);
        assert_eq!(interval(0.0, [[0.0, 1.0]]), (0.0, 0.0));
    }

    #[test]
    fn the_ends_of_a_preset_hold_its_own_values() {
        let file = crate::io::published::evidence::shipped().unwrap();
        let preset = preset("vtsnn-calibrated");
        let ends = ends(&file, &preset);
        assert_eq!(ends.len() % 2, 0);
        for pair in ends.chunks(2) {
            let mut moved = 0;
            for (((_, own), (_, low)), (_, high)) in preset.list().iter().zip(pair[0].list()).zip(pair[1].list()) {
                assert!(low.value.value <= own.value.value && own.value.value <= high.value.value);
                moved += usize::from(low.value.value < high.value.value);
            }
            let barrier = |end: &Constants| end.barrier[0].time.value.value;
            // Values handed over for an inference are in no preset.
            let kept = pair[0].list().iter().zip(pair[1].list()).all(|((_, a), (_, b))| a.value.value == b.value.value);
            assert_eq!(moved > 0, !kept);
            assert!(barrier(&pair[0]) <= barrier(&pair[1]));
        }
    }

    #[test]
    fn a_work_that_is_left_out_moves_the_constants_that_it_speaks_of_and_no_other() {
        let file = crate::io::published::evidence::shipped().unwrap();
        let base = preset(&file.base.value);
        let all = ConstantSets::new(&file, &base, None, Jobs::SeveralChips).unwrap();
        let without = ConstantSets::new(&file, &base, Some("VT-SNN"), Jobs::SeveralChips).unwrap();
        assert_eq!(all.value.table.synapse_dense_energy, Femtojoules(29_550));
        assert_eq!(all.value.table.injection_time, Picoseconds(414_000));
        assert_eq!(without.value.table.injection_time, Picoseconds(2_140_000));
        assert_eq!(without.value.table.synapse_dense_energy, all.value.table.synapse_dense_energy);
        // Findings of one board's author go together, and those of other jobs do not count.
        let without = ConstantSets::new(&file, &base, Some("Quartz MNIST"), Jobs::SeveralChips).unwrap();
        assert_eq!(
            (all.value.reset_word_time, without.value.reset_word_time),
            (Picoseconds(19_600), Picoseconds(18_225))
        );
        let one = ConstantSets::new(&file, &base, None, Jobs::OneChip).unwrap();
        assert_eq!(all.value.table.core_static_power, Nanowatts(592_500));
        assert_eq!(one.value.table.core_static_power, Nanowatts(63_550));
        let (name, [low, high]) = &all.groups[0];
        assert_eq!(name, "event energy");
        assert!(low.table.synapse_dense_energy < all.value.table.synapse_dense_energy);
        assert!(high.table.synapse_dense_energy > all.value.table.synapse_dense_energy);
        assert_eq!(high.table.x86_busy_power, all.value.table.x86_busy_power);
    }
}
