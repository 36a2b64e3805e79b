//! The rows of the energy table: power, latency, energy and energy-delay product of one copy.
//!
//! Input: the activity of a run ([`Activity`], [`StepMeter`]) and its deployment. Output: the rows, the breakdown of the
//! dynamic energy, and its distribution over the timesteps. Invariants: x86 + neuron = total, static + dynamic = total; an
//! unknown figure is `None`, and a note says why. Equations are those of `docs/energy.md`.

use serde::Serialize;

use crate::base::names::named_variants;
use crate::base::units::{Femtojoules, Picoseconds};
use crate::cost::constants::CostTable;
use crate::cost::deployment::Deployment;
use crate::cost::evidence::interval;
use crate::cost::meter::{Distribution, Lane, StepMeter, StepPrice, StepSums};
use crate::cost::model::{StepTime, energy};
use crate::cost::quantiles::{Quantiles, Spread};
use crate::desc::published::baseline::Mode;
pub use crate::desc::published::scenario::Convention;
use crate::ir::activity::Activity;

impl Convention {
    /// Energy of a timestep in uJ. `published` needs the timesteps of a sample.
    #[must_use]
    pub fn energy_uj(self, total_mw: f64, latency_us: f64, steps_per_sample: Option<u32>) -> Option<f64> {
        match self {
            Convention::Physical => Some(total_mw * latency_us / 1e3),
            Convention::Published => {
                steps_per_sample.filter(|&steps| steps > 0).map(|steps| total_mw / f64::from(steps))
            }
        }
    }
}

/// Where a row comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FigureSource {
    /// From the counts of a simulated run.
    Simulated,
    /// Measured on this machine.
    Measured,
    /// Printed by its source.
    Published,
    /// From constants alone.
    Modelled,
    /// Given by the user.
    Stated,
    /// Chosen.
    Assumed,
}

named_variants!(FigureSource {
    Simulated = "simulated",
    Measured = "measured",
    Published = "published",
    Modelled = "modelled",
    Stated = "stated",
    Assumed = "assumed",
});

/// One end of the intervals of a row's figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bound {
    /// Total power.
    pub total_mw: Option<f64>,
    /// Time of a timestep.
    pub latency_us: Option<f64>,
    /// Energy of a timestep.
    pub energy_uj: Option<f64>,
}

/// What share of a row's power comes from constants of each status.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StatusShare {
    /// Printed by their sources.
    pub published: f64,
    /// Fitted to measurements.
    pub fitted: f64,
    /// Assumed.
    pub assumed: f64,
}

/// A row of the table, for one copy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergyRow {
    /// `loihi`, or a baseline's hardware.
    pub hardware: String,
    /// `x86`, `neuron` or `total`.
    pub unit: &'static str,
    /// What the energy and the energy-delay product mean.
    pub convention: Convention,
    /// Power drawn without activity.
    pub static_mw: Option<f64>,
    /// Power on top.
    pub dynamic_mw: Option<f64>,
    /// Their sum.
    pub total_mw: Option<f64>,
    /// Time of a timestep, the mean over the run.
    pub latency_us: Option<f64>,
    /// Energy of a timestep.
    pub energy_uj: Option<f64>,
    /// That times the latency, in pJ s.
    pub edp_pjs: Option<f64>,
    /// The low end of the 90 % interval of each figure, from the intervals of the constants.
    pub low: Option<Bound>,
    /// The high end.
    pub high: Option<Bound>,
    /// Of its total power, by the status of the constants.
    pub share: Option<StatusShare>,
    /// Where it comes from.
    pub source: FigureSource,
    /// Where its power comes from, which may be another place than its time.
    pub power_source: FigureSource,
}

impl EnergyRow {
    /// A figure by the name that tables of measurements use.
    #[must_use]
    pub fn figure(&self, name: &str) -> Option<f64> {
        match name {
            "static_mw" => self.static_mw,
            "dynamic_mw" => self.dynamic_mw,
            "total_mw" => self.total_mw,
            "latency_us" => self.latency_us,
            "energy_uj" => self.energy_uj,
            "edp_pjs" => self.edp_pjs,
            _ => None,
        }
    }
}

/// What is to be estimated.
#[derive(Debug, Clone, Copy)]
pub struct Case<'a> {
    /// Counts of the whole run.
    pub activity: &'a Activity,
    /// Its steps, under every preset.
    pub meter: &'a StepMeter,
    /// The preset of the figures, an index into the meter's tables.
    pub preset: usize,
    /// So many tables behind it, in pairs, are the preset with a group of constants at the low and at the high end.
    pub ends: usize,
    /// The preset with the constants of one status, all others 0: published, fitted, assumed.
    pub by_status: Option<&'a [CostTable; 3]>,
    /// Copies whose activity was counted: 1 when one copy stands for all, else the copies of the mapping.
    pub copies_counted: u32,
    /// Where the copies are.
    pub deployment: &'a Deployment,
    /// As fast as possible, or held to the timestep.
    pub mode: Mode,
    /// Length of a timestep of the model.
    pub timestep: Picoseconds,
    /// What energy means.
    pub convention: Convention,
    /// Timesteps of a sample; `None` when samples differ.
    pub steps_per_sample: Option<u32>,
}

impl<'a> Case<'a> {
    /// All copies of a deployment as fast as possible, energy physical, under the first preset.
    #[must_use]
    pub fn new(activity: &'a Activity, meter: &'a StepMeter, deployment: &'a Deployment, timestep_ms: f64) -> Self {
        Case {
            activity,
            meter,
            preset: 0,
            ends: 0,
            by_status: None,
            copies_counted: deployment.copies,
            deployment,
            mode: Mode::Offline,
            timestep: Picoseconds::from_milliseconds(timestep_ms),
            convention: Convention::Physical,
            steps_per_sample: None,
        }
    }
}

/// What came out.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// `x86`, `neuron`, `total`.
    pub rows: Vec<EnergyRow>,
    /// Dynamic energy of the neuron cores by part, in pJ a timestep and copy; `None` without timesteps.
    pub breakdown_pj: Option<Vec<(&'static str, f64)>>,
    /// Energy of the timesteps of a copy, all power included, physical: its mean is the energy of the `total` row. `None`
    /// without timesteps, and when the meter did not keep it for this preset and price.
    pub per_timestep_uj: Option<Spread>,
    /// Of that, the dynamic energy of the neuron cores.
    pub per_timestep_dynamic_uj: Option<Spread>,
    /// Mean of each part of a step's time: injection, read-out, slowest core, transport, barrier; `None` without timesteps.
    pub time_us: Option<[(&'static str, f64); 5]>,
    /// Why something is not known.
    pub notes: Vec<String>,
}

/// Powers of one copy under one preset, in mW.
#[derive(Debug, Clone, Copy)]
struct Powers {
    x86_static: f64,
    x86_dynamic: f64,
    neuron_static: f64,
    /// `None` without timesteps.
    neuron_dynamic: Option<f64>,
    latency_us: Option<f64>,
}

impl Case<'_> {
    fn copies(&self) -> f64 {
        f64::from(self.deployment.copies.max(1))
    }

    /// Time of steps in ps, exact.
    fn time(&self, steps: &StepSums) -> u128 {
        match self.mode {
            Mode::Offline => steps.time,
            Mode::Realtime => steps.paced_time,
        }
    }

    /// What one copy spends in a step beside its events, under one preset.
    #[must_use]
    pub fn price(&self, table: &CostTable) -> StepPrice {
        step_price(table, self.deployment, self.copies_counted, self.mode)
    }

    /// Dynamic energy of one copy in fJ, in so many steps with these events.
    fn dynamic_fj(&self, events: Femtojoules, steps: f64, table: &CostTable) -> f64 {
        let price = self.price(table);
        events.0 as f64 / price.copies_counted + price.core_step_fj * steps
    }

    fn powers(&self, table: &CostTable, lane: &Lane) -> Powers {
        let share = |cores: u64, power: f64| cores as f64 * power / self.copies();
        let events = energy(self.activity, table, 0).total();
        let time = self.time(&lane.whole);
        let known = time > 0;
        Powers {
            x86_static: share(self.deployment.x86_cores(), table.x86_static_power.milliwatts()),
            x86_dynamic: share(self.deployment.x86_cores(), table.x86_busy_power.milliwatts()),
            neuron_static: share(self.deployment.cores_powered, table.core_static_power.milliwatts()),
            // 1 fJ in 1 ps is 1 mW.
            neuron_dynamic: known.then(|| self.dynamic_fj(events, self.activity.steps() as f64, table) / time as f64),
            latency_us: known.then(|| time as f64 / 1e6 / lane.whole.steps as f64),
        }
    }

    fn rows(&self, powers: Powers) -> [EnergyRow; 3] {
        let row = |unit, static_mw: f64, dynamic_mw: Option<f64>, source| {
            let total_mw = dynamic_mw.map(|dynamic_mw| static_mw + dynamic_mw);
            let energy_uj = total_mw
                .zip(powers.latency_us)
                .and_then(|(total, latency)| self.convention.energy_uj(total, latency, self.steps_per_sample));
            EnergyRow {
                hardware: "loihi".to_string(),
                unit,
                convention: self.convention,
                static_mw: Some(static_mw),
                dynamic_mw,
                total_mw,
                latency_us: powers.latency_us,
                energy_uj,
                // 1 uJ for 1 us is 1 pJ s.
                edp_pjs: energy_uj.zip(powers.latency_us).map(|(energy, latency)| energy * latency),
                low: None,
                high: None,
                share: None,
                source,
                power_source: source,
            }
        };
        let Powers { x86_static, x86_dynamic, neuron_static, neuron_dynamic, .. } = powers;
        [
            row("x86", x86_static, Some(x86_dynamic), FigureSource::Modelled),
            row("neuron", neuron_static, neuron_dynamic, FigureSource::Simulated),
            row(
                "total",
                x86_static + neuron_static,
                neuron_dynamic.map(|neuron| x86_dynamic + neuron),
                FigureSource::Simulated,
            ),
        ]
    }
}

/// Time and energy of one copy for a whole run, physical.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spent {
    /// Time of all steps.
    pub time_us: f64,
    /// Energy of all steps: all power times the time.
    pub energy_uj: f64,
}

/// What one copy spends in these steps of the meter, summed under the case's preset, whatever the convention: for the
/// whole run, the mean of a step (13) times the steps.
///
/// # Panics
/// When the meter has no such preset: a mistake of the caller.
#[must_use]
pub fn spent(case: &Case<'_>, steps: &StepSums) -> Spent {
    let table = &case.meter.tables()[case.preset];
    let time_us = case.time(steps) as f64 / 1e6;
    let dynamic_uj = case.dynamic_fj(steps.energy, steps.steps as f64, table) / 1e9;
    Spent { time_us, energy_uj: case.price(table).always_mw * time_us / 1e3 + dynamic_uj }
}

/// What one copy spends on the mean in the first, second, ... step of a sample, physical; empty unless the meter kept
/// these sums for the case's preset.
///
/// # Panics
/// When the meter has no such preset: a mistake of the caller.
#[must_use]
pub fn spent_by_step_uj(case: &Case<'_>) -> Vec<f64> {
    let kept = case.meter.settings().by_step == Some(case.preset);
    let steps = if kept { case.meter.by_step() } else { &[] };
    steps.iter().map(|sums| spent(case, sums).energy_uj / sums.steps.max(1) as f64).collect()
}

/// What one copy of a deployment spends in a step beside its events, under one preset.
#[must_use]
pub fn step_price(table: &CostTable, deployment: &Deployment, copies_counted: u32, mode: Mode) -> StepPrice {
    let share = |cores: u64, each: f64| cores as f64 * each / f64::from(deployment.copies.max(1));
    let x86 =
        [table.x86_static_power, table.x86_busy_power].map(|power| share(deployment.x86_cores(), power.milliwatts()));
    StepPrice {
        copies_counted: f64::from(copies_counted.max(1)),
        // Equation (8).
        core_step_fj: share(deployment.cores_powered, table.core_step_energy.0 as f64),
        always_mw: x86[0] + x86[1] + share(deployment.cores_powered, table.core_static_power.milliwatts()),
        paced: mode == Mode::Realtime,
    }
}

/// Power, latency and energy of one copy.
///
/// # Panics
/// When the meter has no such preset or has not seen the steps of the activity: a mistake of the caller.
#[must_use]
pub fn estimate(case: &Case<'_>) -> Estimate {
    assert_eq!(case.meter.steps(), case.activity.steps(), "the meter has seen the whole run");
    let settings = case.meter.settings();
    assert_eq!(settings.timestep, case.timestep, "the meter knows the timestep");
    let presets: Vec<(&CostTable, &Lane)> = case.meter.tables().iter().zip(case.meter.lanes()).collect();
    let all: Vec<[EnergyRow; 3]> = presets.iter().map(|(table, lane)| case.rows(case.powers(table, lane))).collect();
    let mut rows = all[case.preset].clone();
    let ends = &all[case.preset + 1..][..case.ends];
    for (i, row) in rows.iter_mut().enumerate() {
        let over = |figure: fn(&EnergyRow) -> Option<f64>| {
            let pairs = ends.chunks_exact(2).filter_map(|pair| Some([figure(&pair[0][i])?, figure(&pair[1][i])?]));
            Some(interval(figure(&all[case.preset][i])?, pairs))
        };
        let figures = [over(|row| row.total_mw), over(|row| row.latency_us), over(|row| row.energy_uj)];
        let bound = |end: fn((f64, f64)) -> f64| {
            let [total_mw, latency_us, energy_uj] = figures.map(|figure| figure.map(end));
            Some(Bound { total_mw, latency_us, energy_uj })
        };
        (row.low, row.high) = (bound(|(low, _)| low), bound(|(_, high)| high));
    }
    let (table, lane) = presets[case.preset];
    if let Some(tables) = case.by_status {
        let parts = [0, 1, 2].map(|status| case.rows(case.powers(&tables[status], lane)));
        for (i, row) in rows.iter_mut().enumerate() {
            let share = |status: usize| {
                let total = row.total_mw.filter(|&total| total > 0.0)?;
                Some(parts[status][i].total_mw? / total)
            };
            row.share = (|| Some(StatusShare { published: share(0)?, fitted: share(1)?, assumed: share(2)? }))();
        }
    }
    let price = case.price(table);
    let steps = case.activity.steps() as f64;
    let some_steps = case.activity.steps() > 0;

    let mut notes = Vec::new();
    if !some_steps {
        notes.push("no timestep was run: dynamic power, latency and energy are not known".to_string());
    } else if case.time(&lane.whole) == 0 {
        notes
            .push("a timestep takes no time under these constants: dynamic power and energy are not known".to_string());
    }
    if case.convention == Convention::Published && case.steps_per_sample.is_none() {
        notes.push(
            "samples differ in length: the published convention divides by the timesteps of a sample, so its energy is \
             not known"
                .to_string(),
        );
    }

    let breakdown_pj = some_steps.then(|| {
        let events = energy(case.activity, table, 0);
        let per_step = 1e3 * steps * price.copies_counted;
        let part = |(name, energy): (&'static str, Femtojoules)| match name {
            "core_step" => (name, price.core_step_fj / 1e3),
            _ => (name, energy.0 as f64 / per_step),
        };
        events.parts().into_iter().map(part).collect()
    });
    let asked = settings.distribution == Some((case.preset, price));
    let distribution = asked.then(|| case.meter.distribution());
    let spread = |of: fn(&Distribution) -> &Quantiles| Some(of(distribution?).spread()?.map(|fj| fj / 1e9));
    let names = StepTime::default().parts().map(|(name, _)| name);
    let mean_us = |part: usize| (names[part], lane.whole.parts[part] as f64 / 1e6 / steps);
    Estimate {
        rows: rows.into(),
        breakdown_pj,
        per_timestep_uj: spread(|distribution| &distribution.whole),
        per_timestep_dynamic_uj: spread(|distribution| &distribution.dynamic),
        time_us: some_steps.then(|| [0, 1, 2, 3, 4].map(mean_us)),
        notes,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::cost::constants::tests::{preset, table};
    use crate::cost::deployment::tests::paper;
    use crate::cost::model::tests::any_step;
    use crate::ir::activity::{CoreCounts, StepActivity};

    pub(crate) const MS: Picoseconds = Picoseconds(1_000_000_000);

    pub(crate) fn run(steps: &[StepActivity], tables: Vec<CostTable>, tiles: u64) -> (Activity, StepMeter) {
        let mut activity = Activity::new(steps.first().map_or(1, |step| step.cores.len()));
        let mut meter = crate::cost::meter::tests::meter(tables, tiles, None);
        add(steps, &mut activity, &mut meter);
        (activity, meter)
    }

    fn add(steps: &[StepActivity], activity: &mut Activity, meter: &mut StepMeter) {
        for step in steps {
            activity.add_steps(step, 1);
            meter.add(step, 1, false);
        }
    }

    /// A run whose meter keeps the distribution under the first preset and the price of this deployment.
    fn run_priced(
        steps: &[StepActivity],
        tables: Vec<CostTable>,
        tiles: u64,
        deployment: &Deployment,
        copies: u32,
        mode: Mode,
    ) -> (Activity, StepMeter) {
        let mut activity = Activity::new(steps.first().map_or(1, |step| step.cores.len()));
        let price = step_price(&tables[0], deployment, copies, mode);
        let mut meter = crate::cost::meter::tests::meter(tables, tiles, Some((0, price)));
        add(steps, &mut activity, &mut meter);
        (activity, meter)
    }

    pub(crate) fn both() -> Vec<CostTable> {
        vec![table("sanafe-calibrated"), table("davies2018")]
    }

    fn case<'a>(run: &'a (Activity, StepMeter), deployment: &'a Deployment) -> Case<'a> {
        Case {
            activity: &run.0,
            meter: &run.1,
            preset: 0,
            ends: 0,
            by_status: None,
            copies_counted: 1,
            deployment,
            mode: Mode::Offline,
            timestep: MS,
            convention: Convention::Physical,
            steps_per_sample: Some(150),
        }
    }

    /// A figure of the paper: its value and half a unit of its last digit.
    fn printed(text: &str) -> (f64, f64) {
        let decimals = text.split_once('.').map_or(0, |(_, fraction)| fraction.len());
        (text.parse().unwrap(), 0.5 * 10f64.powi(-(decimals as i32)))
    }

    #[test]
    fn the_published_convention_reproduces_the_paper_s_columns_from_its_power_and_latency() {
        // VT-SNN, appendix, both tables: total power, latency, energy per timestep, energy-delay product.
        let rows = [
            ("21.3", None, "0.14", None),
            ("12.4", None, "0.08", None),
            ("33.7", Some("231"), "0.22", Some("51.8")),
            ("59890", Some("21"), "399", Some("8431")),
            ("20.3", None, "0.14", None),
            ("12.1", None, "0.08", None),
            ("32.3", Some("1039.9"), "0.22", Some("224")),
            ("61930", Some("1045.6"), "412.9", Some("431708")),
        ];
        for (power, latency, energy, edp) in rows {
            let ((power, dp), (energy, de)) = (printed(power), printed(energy));
            let of = |power| Convention::Published.energy_uj(power, 0.0, Some(150)).unwrap();
            let (low, high) = (of(power - dp), of(power + dp));
            assert!(low <= energy + de && energy - de <= high, "{power}: {low}..{high} against {energy}");
            if let Some(((latency, dl), (edp, dd))) = latency.map(printed).zip(edp.map(printed)) {
                let (low, high) = (low * (latency - dl), high * (latency + dl));
                assert!(low <= edp + dd && edp - dd <= high, "{power}: {low}..{high} against {edp}");
            }
        }
        assert!((Convention::Published.energy_uj(33.7, 231.0, Some(150)).unwrap() - 0.2247).abs() < 5e-5);
        assert!((Convention::Published.energy_uj(33.7, 231.0, Some(150)).unwrap() * 231.0 - 51.9).abs() < 5e-2);
        // The same rows physically: 33.7 mW * 231 us.
        assert!((Convention::Physical.energy_uj(33.7, 231.0, None).unwrap() - 7.7847).abs() < 1e-9);
    }

    #[test]
    fn the_paper_s_deployment_draws_the_paper_s_static_and_x86_power() {
        let run = run(&[StepActivity::new(1)], both(), 156);
        let paper = paper();
        let [x86, neuron, _] = estimate(&case(&run, &paper)).rows.try_into().unwrap();
        let within = |figure: Option<f64>, text: &str| {
            let (value, half) = printed(text);
            assert!((figure.unwrap() - value).abs() <= half + 1e-9, "{figure:?} against {text}");
        };
        // Calibrated on these three cells of the offline table.
        within(x86.static_mw, "0.19");
        within(x86.dynamic_mw, "21.1");
        within(neuron.static_mw, "11.7");
        // Predicted for the real-time table: 0.19, 20.1 and 11.9 mW.
        within(x86.static_mw, "0.19");
        for (figure, published) in [(x86.dynamic_mw, 20.1), (neuron.static_mw, 11.9)] {
            assert!((figure.unwrap() / published - 1.0).abs() < 0.06);
        }
    }

    #[test]
    fn hand_computed_rows() {
        // Two steps of one core: 100 compartments visited; in the second, 10 active ones fire a message each within the
        // tile, and 50 dense events.
        let mut quiet = StepActivity::new(1);
        quiet.cores.as_mut_slice()[0].visited = 100;
        let mut busy = StepActivity::new(1);
        busy.cores.as_mut_slice()[0] = CoreCounts {
            messages_in: 10,
            events_dense: 50,
            events_sparse: 0,
            visited: 100,
            active: 10,
            spikes: 10,
            messages_out: 10,
        };
        busy.hops.local = 10;
        let deployment = Deployment {
            name: "packed".to_string(),
            copies: 2,
            cores_used: 1,
            cores_powered: 4,
            tiles_used: 1,
            chips_used: 1,
            host: Some(crate::cost::Host::even(1, 1)),
        };
        let run = run_priced(&[quiet, busy], vec![table("davies2018")], 1, &deployment, 1, Mode::Offline);
        let offline = case(&run, &deployment);
        let found = estimate(&offline);
        // ps: 100 * 5300 + 113000; and 50 * 3500 + 100 * 5300 + 10 * 3100 + 2100 + 113000.
        let (first, second) = (643_000.0, 851_100.0);
        let latency = (first + second) / 2.0 / 1e6;
        // fJ: 100 * 52000; and 50 * 23600 + 100 * 52000 + 10 * 29000 + 10 * 1700.
        let (quiet_fj, busy_fj) = (5_200_000.0, 6_687_000.0);
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * b.abs(), "{a} against {b}");
        let [x86, neuron, total] = <[EnergyRow; 3]>::try_from(found.rows).unwrap();
        near(neuron.latency_us.unwrap(), latency);
        near(neuron.static_mw.unwrap(), 4.0 * 0.6 / 2.0);
        near(neuron.dynamic_mw.unwrap(), (quiet_fj + busy_fj) / (first + second));
        near(x86.static_mw.unwrap(), 0.6);
        near(x86.dynamic_mw.unwrap(), 67.5);
        near(total.total_mw.unwrap(), 1.2 + 0.6 + 67.5 + (quiet_fj + busy_fj) / (first + second));
        near(total.energy_uj.unwrap(), total.total_mw.unwrap() * latency / 1e3);
        near(total.edp_pjs.unwrap(), total.energy_uj.unwrap() * latency);
        let spread = found.per_timestep_dynamic_uj.unwrap();
        near(spread.min, quiet_fj / 1e9);
        near(spread.max, busy_fj / 1e9);
        near(found.per_timestep_uj.unwrap().max, busy_fj / 1e9 + 69.3 * second / 1e9);
        let parts = found.breakdown_pj.unwrap();
        assert_eq!(parts[0], ("synapse", 590.0));
        assert_eq!(parts[2], ("compartment", 5345.0));
        assert_eq!(parts[6], ("hop", 8.5));

        // Held to 1 ms, the same energy is spread over a longer time.
        let slow = estimate(&Case { mode: Mode::Realtime, ..offline });
        near(slow.rows[1].latency_us.unwrap(), 1000.0);
        near(slow.rows[1].dynamic_mw.unwrap(), (quiet_fj + busy_fj) / 2e9);
        near(slow.rows[0].dynamic_mw.unwrap(), 67.5);
        // The distribution was kept for another price.
        assert_eq!(slow.per_timestep_uj, None);
        // The first step of the sample and the second.
        let by_step = spent_by_step_uj(&offline);
        near(by_step[0], quiet_fj / 1e9 + 69.3 * first / 1e9);
        near(by_step[1], busy_fj / 1e9 + 69.3 * second / 1e9);
        // Counted for both copies at once, one copy is half.
        let halved = estimate(&Case { copies_counted: 2, ..offline });
        near(halved.rows[1].dynamic_mw.unwrap(), neuron.dynamic_mw.unwrap() / 2.0);
    }

    #[test]
    fn what_was_not_run_is_unknown_and_says_so() {
        let run = run(&[], both(), 1);
        let found = estimate(&case(&run, &paper()));
        assert_eq!((found.rows[2].dynamic_mw, found.rows[2].energy_uj, found.rows[2].latency_us), (None, None, None));
        assert!(found.rows[2].static_mw.is_some());
        assert_eq!((found.breakdown_pj, found.per_timestep_uj), (None, None));
        assert_eq!(found.notes.len(), 1);
    }

    #[test]
    fn the_published_convention_needs_samples_of_one_length() {
        let run = run(&[StepActivity::new(1)], both(), 1);
        let paper = paper();
        let uneven = Case { convention: Convention::Published, steps_per_sample: None, ..case(&run, &paper) };
        let found = estimate(&uneven);
        assert_eq!(found.rows[2].energy_uj, None);
        assert!(found.rows[2].total_mw.is_some());
        assert!(found.notes[0].contains("published convention"));
    }

    proptest! {
        #[test]
        fn the_parts_of_every_table_add_up(
            steps in proptest::collection::vec(any_step(2), 1..8),
            realtime in any::<bool>(), published in any::<bool>(), copies_counted in 1..40u32, copies in 1..40u32,
            powered in 1..5_000u64, core_step in 0..1_000u32,
        ) {
            let mut constants = preset("sanafe-calibrated");
            constants.core_step_energy.value = f64::from(core_step).into();
            let deployment = Deployment { copies, cores_powered: powered, ..paper() };
            let mode = if realtime { Mode::Realtime } else { Mode::Offline };
            let tables = vec![CostTable::new(&constants).unwrap(), table("davies2018")];
            let run = run_priced(&steps, tables, 5, &deployment, copies_counted, mode);
            let found = estimate(&Case {
                copies_counted,
                mode,
                convention: if published { Convention::Published } else { Convention::Physical },
                ..case(&run, &deployment)
            });
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
            let [x86, neuron, total] = <[EnergyRow; 3]>::try_from(found.rows).unwrap();
            for figure in [|r: &EnergyRow| r.static_mw, |r: &EnergyRow| r.dynamic_mw, |r: &EnergyRow| r.total_mw, |r: &EnergyRow| r.energy_uj] {
                prop_assert!(near(figure(&x86).unwrap() + figure(&neuron).unwrap(), figure(&total).unwrap()));
            }
            for row in [&x86, &neuron, &total] {
                prop_assert!(near(row.static_mw.unwrap() + row.dynamic_mw.unwrap(), row.total_mw.unwrap()));
                for (figure, low, high) in [
                    (row.total_mw, row.low.unwrap().total_mw, row.high.unwrap().total_mw),
                    (row.latency_us, row.low.unwrap().latency_us, row.high.unwrap().latency_us),
                    (row.energy_uj, row.low.unwrap().energy_uj, row.high.unwrap().energy_uj),
                ] {
                    prop_assert!(low <= figure && figure <= high);
                }
            }
            // Dynamic power times time is the breakdown, and the spread's mean lies within it.
            let dynamic_pj = neuron.dynamic_mw.unwrap() * neuron.latency_us.unwrap() * 1e3;
            let parts: f64 = found.breakdown_pj.unwrap().iter().map(|(_, pj)| pj).sum();
            prop_assert!(near(parts, dynamic_pj) || parts < 1e-9);
            if !published {
                let spread = found.per_timestep_uj.unwrap();
                let mean = total.energy_uj.unwrap();
                prop_assert!(spread.min <= mean * (1.0 + 1e-9) && mean <= spread.max * (1.0 + 1e-9));
            }
        }
    }
}
