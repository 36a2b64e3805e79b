//! The rows of the energy table: power, latency, energy and energy-delay product.
//!
//! Input: counts and meter of a run, and its deployment ([`EstimateInput`]). Output: the rows with
//! their intervals, the breakdown of the dynamic energy, and its distribution over the timesteps.
//! Invariants: under the profiler's accounting x86 + neuron = total; static + dynamic = total; an
//! unknown figure is `None`, and a note says why. Equation numbers refer to `docs/energy.md`.

pub use crate::estimate_input::{ByStatus, EstimateInput};
pub use crate::job::Convention;
use crate::meter::{Distribution, Lane, StepSums};
use crate::model::{StepTime, energy};
pub use crate::power::{JobPower, job_power, step_price};
use crate::quantiles::{Quantiles, Spread};
pub use crate::row::{Bound, EnergyRow, FigureSource, RowUnit, Shares, StatusShare};
use nsim_ir::base::units::Femtojoules;
use nsim_ir::base::warning::{Warning, WarningCode};
use nsim_ir::hardware::constants::Status;

/// Result of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// By the profiler x86, neuron, total; by rails boot, idle, x86, total.
    pub rows: Vec<EnergyRow>,
    /// Powers of all copies together.
    pub job: JobPower,
    /// Dynamic energy of the neuron cores by part, pJ a timestep and copy; `None` without steps.
    pub breakdown_pj: Option<Vec<(&'static str, f64)>>,
    /// Energy of the timesteps, all power of the `total` row included, physical, uJ; its mean is
    /// the row's energy. `None` without timesteps, or if the meter had another preset or price.
    pub per_timestep_uj: Option<Spread>,
    /// Distribution of the dynamic energy of the neuron cores, uJ.
    pub per_timestep_dynamic_uj: Option<Spread>,
    /// Mean of each part of a step's time, us; `None` without timesteps.
    pub time_us: Option<[(&'static str, f64); 6]>,
    /// Share of a mean step for injection, turn and reset of x86 cores, 0..=1; `None` without.
    pub x86_share: Option<f64>,
    /// Unknown figures, and steps that real time does not wait for.
    pub warnings: Vec<Warning>,
}

impl Estimate {
    /// The row of a unit.
    pub fn row(&self, unit: RowUnit) -> Option<&EnergyRow> {
        self.rows.iter().find(|row| row.unit == unit)
    }
}

/// Time and energy of a whole run, physical.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spent {
    /// Time of all steps.
    pub time_us: f64,
    /// Energy of all steps: all power of the `total` row times the time.
    pub energy_uj: f64,
}

/// Returns time and energy of the `total` row in these steps of the meter, under the case's preset,
/// for every convention. For the whole run: the mean of a step (13) times the steps.
///
/// # Panics
/// When the meter has no such preset: a mistake of the caller.
pub fn spent(case: &EstimateInput<'_>, steps: &StepSums) -> Spent {
    let price = case.price(&case.meter.tables()[case.preset]);
    let time_us = case.time(steps) as f64 / 1e6;
    let dynamic_fj = steps.energy.0 as f64 * price.events + price.step_fj * steps.steps as f64;
    Spent { time_us, energy_uj: price.always_mw * time_us / 1e3 + dynamic_fj / 1e9 }
}

impl EstimateInput<'_> {
    /// Adds the shares of each column by the status of the constants.
    fn add_shares(&self, rows: &mut [EnergyRow], by_status: &ByStatus, lane: &Lane) {
        let latency_us = self.latency_us(&lane.whole);
        let parts = [0, 1, 2].map(|of| self.rows(&self.job(&by_status.tables[of], &lane.whole), latency_us));
        let statuses = [Status::Published, Status::Calibrated, Status::Assumed];
        let of_core = self.meter.core_time_shares();
        let of_time = |status: Status| {
            let sum = |parts: &[f64], own: &[Option<Status>]| -> f64 {
                parts.iter().zip(own).filter(|(_, own)| **own == Some(status)).map(|(part, _)| part).sum()
            };
            let parts = lane.whole.parts.map(|part| part as f64);
            let all =
                sum(&parts, &by_status.time) + sum(&of_core, &by_status.core.map(Some)) * parts[StepTime::SLOWEST_CORE];
            all / lane.whole.time.max(1) as f64
        };
        let [published, fitted, assumed] = statuses.map(of_time);
        let of_latency = (lane.whole.time > 0).then_some(StatusShare { published, fitted, assumed });
        for (i, row) in rows.iter_mut().enumerate() {
            let column = |figure: fn(&EnergyRow) -> Option<f64>| {
                let whole = figure(row).filter(|&whole| whole > 0.0)?;
                let share = |of: usize| Some(figure(&parts[of][i])? / whole);
                Some(StatusShare { published: share(0)?, fitted: share(1)?, assumed: share(2)? })
            };
            let (static_mw, dynamic_mw) = (column(|row| row.static_mw), column(|row| row.dynamic_mw));
            let latency_us = row.latency_us.and(of_latency);
            row.share = column(|row| row.total_mw);
            row.shares = Shares { static_mw, dynamic_mw, latency_us };
        }
    }
}

/// Returns power, latency and energy of a case.
///
/// # Panics
/// When the meter lacks the preset or the activity's steps: a mistake of the caller.
pub fn estimate(case: &EstimateInput<'_>) -> Estimate {
    assert_eq!(case.meter.steps(), case.activity.steps(), "the meter has seen the whole run");
    let (table, lane) = (&case.meter.tables()[case.preset], case.lane(case.preset));
    let job = case.job(table, &lane.whole);
    let mut rows = case.rows(&job, case.latency_us(&lane.whole));
    match case.corners {
        Some(corners) => case.corner_bounds(&mut rows, corners),
        None => case.bounds(&mut rows, lane),
    }
    if let Some(by_status) = case.by_status {
        case.add_shares(&mut rows, by_status, lane);
    }
    let price = case.price(table);
    let steps = case.activity.steps() as f64;
    let some_steps = case.activity.steps() > 0;

    let mut warnings = Vec::new();
    let mut unknown = |why: &str| warnings.push(Warning::of_network(WarningCode::CostUnknown, why));
    if !some_steps {
        unknown("no timestep was run: dynamic power, latency and energy are not known");
    } else if case.time(&lane.whole) == 0 {
        unknown("a timestep takes no time under these constants: dynamic power and energy are not known");
    }
    if case.convention == Convention::Published && case.steps_per_sample.is_none() {
        unknown(
            "samples differ in length: the published convention divides by the timesteps of a sample, so its energy is \
             not known",
        );
    }
    warnings.extend(case.late_steps(&lane.whole));

    let breakdown_pj = some_steps.then(|| {
        let per_step = 1e3 * steps * f64::from(case.copies_counted.max(1));
        let part = |(name, energy): (&'static str, Femtojoules)| (name, energy.0 as f64 / per_step);
        energy(case.activity, table).parts().into_iter().map(part).collect()
    });
    let is_requested = case.meter.settings().distribution == Some((case.preset, price));
    let distribution = is_requested.then(|| case.meter.distribution());
    let spread = |of: fn(&Distribution) -> &Quantiles| Some(of(distribution?).spread()?.map(|fj| fj / 1e9));
    let names = StepTime::default().parts().map(|(name, _)| name);
    let mean_us = |part: usize| (names[part], lane.whole.parts[part] as f64 / 1e6 / steps);
    Estimate {
        rows,
        job,
        breakdown_pj,
        per_timestep_uj: spread(|distribution| &distribution.whole),
        per_timestep_dynamic_uj: spread(|distribution| &distribution.dynamic),
        time_us: some_steps.then(|| [0, 1, 2, 3, 4, 5].map(mean_us)),
        x86_share: case.x86_share(&lane.whole),
        warnings,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::constants::CostTable;
    use crate::constants::tests::{preset, table};
    use crate::deployment::tests::paper;
    use crate::deployment::{Deployment, Host};
    use crate::job::{Accounting, Mode};
    use crate::meter::{StepMeter, StepPrice};
    use crate::model::tests::any_step;
    use nsim_ir::activity::{Activity, CoreCounts, StepActivity};
    use nsim_ir::hardware::constants::{ClassError, FigureClass};

    /// A run whose meter keeps the distribution under the first preset and this price, if any.
    pub(crate) fn run(
        steps: &[StepActivity],
        tables: Vec<CostTable>,
        price: Option<StepPrice>,
    ) -> (Activity, StepMeter) {
        let mut activity = Activity::new(steps.first().map_or(1, |step| step.cores.len()));
        let mut meter = crate::meter::tests::meter(tables, 1, price.map(|price| (0, price)));
        for step in steps {
            activity.add_steps(step, 1);
            meter.add(step, 1, false);
        }
        (activity, meter)
    }

    /// A run of one silent step.
    fn silent() -> (Activity, StepMeter) {
        run(&[StepActivity::new(1)], vec![table("sanafe-calibrated"), table("davies2018")], None)
    }

    fn case<'a>((activity, meter): &'a (Activity, StepMeter), deployment: &'a Deployment) -> EstimateInput<'a> {
        let case = EstimateInput::new(activity, meter, deployment);
        EstimateInput { hardware: "loihi", copies_counted: 1, steps_per_sample: Some(150), ..case }
    }

    /// A copy on one chip of the board of the paper.
    fn on_one_chip() -> Deployment {
        Deployment { copies: 1, cores_used: 1, chips_used: 1, x86_cores: 1, x86_chips: 1, x86_working: 1, ..paper() }
    }

    /// A figure of the paper: its value and half a unit of its last digit.
    fn printed(text: &str) -> (f64, f64) {
        let decimals = text.split_once('.').map_or(0, |(_, fraction)| fraction.len());
        (text.parse().unwrap(), 0.5 * 10f64.powi(-(decimals as i32)))
    }

    #[test]
    fn the_published_convention_reproduces_the_paper_s_columns_from_its_power_and_latency() {
        // VT-SNN, appendix, both tables: total power, latency, energy a timestep, EDP.
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
        // One of these rows, physically: 33.7 mW * 231 us.
        assert!((Convention::Physical.energy_uj(33.7, 231.0, None).unwrap() - 7.7847).abs() < 1e-9);
    }

    #[test]
    fn the_paper_s_job_draws_the_paper_s_power_by_constants_of_several_works() {
        let (run, paper) = (silent(), paper());
        let found = estimate(&case(&run, &paper));
        let [x86, neuron, _] = <[EnergyRow; 3]>::try_from(found.rows).unwrap();
        // Both tables: 0.19; 21.1 and 20.1; 11.7 and 11.9 mW.
        let within = |figure: Option<f64>, printed: f64| assert!((figure.unwrap() / printed - 1.0).abs() < 0.12);
        within(x86.static_mw, 0.19);
        within(x86.dynamic_mw, 21.1);
        within(neuron.static_mw, 11.7);
        // The ratio of both is the profiler's own.
        let of_core = neuron.static_mw.unwrap() * 32.0 / 594.0;
        assert!((of_core / x86.static_mw.unwrap() - 3.377).abs() < 1e-9);
        // All five x86 cores and all copies.
        let job = found.job;
        assert!((job.profiler().unwrap() - 5.0 * x86.total_mw.unwrap() - 32.0 * neuron.total_mw.unwrap()).abs() < 1e-9);
    }

    #[test]
    fn a_meter_on_the_board_shows_chips_and_x86_cores_and_no_neuron_core_at_rest() {
        let run = silent();
        let (one, packed) = (on_one_chip(), Deployment { cores_used: 100, ..on_one_chip() });
        let rails =
            |deployment| estimate(&EstimateInput { accounting: Accounting::Rails, ..case(&run, deployment) }).rows;
        assert_eq!(rails(&one), rails(&packed), "cores in use add nothing");
        let [boot, idle, x86, total] = <[EnergyRow; 4]>::try_from(rails(&one)).unwrap();
        assert!((boot.total_mw.unwrap() - 32.0 * 28.43).abs() < 1e-9);
        assert!((idle.total_mw.unwrap() - boot.total_mw.unwrap() - 49.25 - 18.0).abs() < 1e-9);
        assert!((total.total_mw.unwrap() - idle.total_mw.unwrap() - x86.total_mw.unwrap()).abs() < 1e-9);
        // A row of its own, with an interval of its own, within what works found: 3 to 26.3 mW.
        assert_eq!((x86.total_mw, x86.x86_cores), (Some(10.02), Some(1)));
        let errors = &preset("loihi1-evidence").errors;
        let found = estimate(&EstimateInput { accounting: Accounting::Rails, errors, ..case(&run, &one) }).rows;
        let ends = [found[2].low, found[2].high].map(|end| end.unwrap().total_mw.unwrap());
        assert!(ends[0] <= 3.0 && 26.3 <= ends[1], "{ends:?}");
    }

    #[test]
    fn an_x86_core_that_resets_works_for_as_long_as_that_and_its_turn_take() {
        let run = silent();
        let alone = Deployment { copies: 1, x86_cores: 0, x86_chips: 0, x86_working: 0, host: Host::None, ..paper() };
        let found = estimate(&case(&run, &alone));
        assert_eq!((found.rows[0].total_mw, found.job.x86_dynamic()), (Some(0.0), Some(0.0)));
        let reset = crate::transport::Words { count: 1_000, steps: 10 };
        let resets = Deployment { x86_cores: 1, x86_chips: 1, x86_working: 1, reset, ..alone };
        let offline = case(&run, &resets);
        let time = run.1.lanes()[0].whole.time as f64;
        // 6 mW for the turn and a tenth of 1,000 words.
        let active = 6.0 * (1_899_000.0 + 100.0 * 16_810.0) / time;
        let found = estimate(&offline);
        assert!((found.job.x86_active.unwrap() - active).abs() < 1e-12, "{:?}", found.job);
        let spent = spent(&offline, &run.1.lanes()[0].whole);
        assert!((spent.energy_uj - found.rows[2].energy_uj.unwrap()).abs() < 1e-12);
    }

    #[test]
    fn intervals_are_of_classes_and_add_up_by_their_shares() {
        let run = run(&[StepActivity::new(1)], vec![table("loihi1-evidence")], None);
        let error = |class, within_80| ClassError { class, works: 5, within_80, within_90: None };
        let errors =
            [error(FigureClass::Static, 2.0), error(FigureClass::X86Dynamic, 1.2), error(FigureClass::Time, 3.0)];
        let paper = paper();
        let found = estimate(&EstimateInput { errors: &errors, ..case(&run, &paper) });
        let [x86, neuron, total] = &found.rows[..] else { panic!() };
        // Of the neuron cores' events nothing is known, and there are none.
        assert!((neuron.high.unwrap().total_mw.unwrap() / neuron.total_mw.unwrap() - 2.0).abs() < 1e-9);
        let share = |row: &EnergyRow, part: Option<f64>| part.unwrap() / row.total_mw.unwrap();
        let log = (share(x86, x86.static_mw) * 2f64.ln()).hypot(share(x86, x86.dynamic_mw) * 1.2f64.ln());
        assert!((x86.high.unwrap().total_mw.unwrap() / x86.total_mw.unwrap() - log.exp()).abs() < 1e-9);
        let (low, high) = (total.low.unwrap(), total.high.unwrap());
        assert!((high.latency_us.unwrap() / total.latency_us.unwrap() - 3.0).abs() < 1e-9);
        let power = (high.total_mw.unwrap() / total.total_mw.unwrap()).ln();
        let edp = (high.edp_pjs.unwrap() / total.edp_pjs.unwrap()).ln();
        assert!((edp - power.hypot(2.0 * 3f64.ln())).abs() < 1e-9);
        assert!(low.energy_uj.unwrap() < total.energy_uj.unwrap());
        // A step paced by a millisecond takes a millisecond, and may take longer by its work.
        let slow = estimate(&EstimateInput { errors: &errors, mode: Mode::Realtime, ..case(&run, &paper) });
        assert_eq!(slow.rows[2].low.unwrap().latency_us, Some(1e3));
        let free_us = total.latency_us.unwrap();
        assert!((slow.rows[2].high.unwrap().latency_us.unwrap() - 1e3 - 2.0 * free_us).abs() < 1e-9);
        // A class that is not known leaves its sums without bounds.
        let found = estimate(&EstimateInput { errors: &errors[1..], ..case(&run, &paper) });
        assert_eq!((found.rows[2].low.unwrap().total_mw, found.rows[2].low.unwrap().energy_uj), (None, None));
    }

    #[test]
    fn hand_computed_rows() {
        // Two steps of one core: 100 compartments visited; in the second, 10 active ones fire a
        // message each within the tile, and 50 dense events.
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
            ..CoreCounts::default()
        };
        busy.hops.local = 10;
        let deployment = Deployment { copies: 2, cores_used: 4, tiles_used: 1, ..on_one_chip() };
        let mut constants = preset("davies2018");
        constants.core_static_power.value = 0.6.into();
        constants.x86_static_ratio.value = 2.0.into();
        constants.turn_time.value = 0.0.into();
        let table = CostTable::new(&constants).unwrap();
        let price = step_price(&table, &deployment, 1, Mode::Offline, Accounting::Profiler);
        let run = run(&[quiet, busy], vec![table], Some(price));
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
        near(x86.static_mw.unwrap(), 0.3);
        near(x86.dynamic_mw.unwrap(), 18.0 + 3.0);
        near(total.total_mw.unwrap(), 1.2 + 0.3 + 21.0 + (quiet_fj + busy_fj) / (first + second));
        near(total.energy_uj.unwrap(), total.total_mw.unwrap() * latency / 1e3);
        near(total.edp_pjs.unwrap(), total.energy_uj.unwrap() * latency);
        let spread = found.per_timestep_dynamic_uj.unwrap();
        near(spread.min, quiet_fj / 1e9);
        near(spread.max, busy_fj / 1e9);
        near(found.per_timestep_uj.unwrap().max, busy_fj / 1e9 + 22.5 * second / 1e9);
        let parts = found.breakdown_pj.unwrap();
        assert_eq!(parts[0], ("synapse", 590.0));
        assert_eq!(parts[2], ("compartment", 5345.0));
        assert_eq!(parts[6], ("hop", 8.5));

        // Paced by 1 ms, equal energy is spread over a longer time.
        let slow = estimate(&EstimateInput { mode: Mode::Realtime, ..offline });
        near(slow.rows[1].latency_us.unwrap(), 1000.0);
        near(slow.rows[1].dynamic_mw.unwrap(), (quiet_fj + busy_fj) / 2e9);
        near(slow.rows[0].dynamic_mw.unwrap(), 21.0);
        // The distribution was stored for another price.
        assert_eq!(slow.per_timestep_uj, None);
        // Counted for both copies together, one copy is half.
        let halved = estimate(&EstimateInput { copies_counted: 2, ..offline });
        near(halved.rows[1].dynamic_mw.unwrap(), neuron.dynamic_mw.unwrap() / 2.0);
    }

    #[test]
    fn what_was_not_run_is_unknown_and_says_so() {
        let run = run(&[], vec![table("davies2018")], None);
        let found = estimate(&case(&run, &paper()));
        assert_eq!((found.rows[2].dynamic_mw, found.rows[2].energy_uj, found.rows[2].latency_us), (None, None, None));
        assert!(found.rows[2].static_mw.is_some());
        assert_eq!((found.breakdown_pj, found.per_timestep_uj), (None, None));
        assert_eq!(found.warnings.len(), 1);
    }

    #[test]
    fn the_published_convention_needs_samples_of_one_length() {
        let (run, paper) = (silent(), paper());
        let uneven = EstimateInput { convention: Convention::Published, steps_per_sample: None, ..case(&run, &paper) };
        let found = estimate(&uneven);
        assert_eq!(found.rows[2].energy_uj, None);
        assert!(found.rows[2].total_mw.is_some());
        assert!(found.warnings[0].message.contains("published convention"));
    }

    proptest! {
        #[test]
        fn the_parts_of_every_table_add_up(
            steps in proptest::collection::vec(any_step(2), 1..8),
            realtime in any::<bool>(), published in any::<bool>(), copies_counted in 1..40u32,
            copies in prop_oneof![Just(1), 2..40u32],
            cores_used in 1..5_000u64, x86_cores in 1..6u64,
        ) {
            let constants = preset("sanafe-calibrated");
            let (x86_chips, x86_working) = (x86_cores, x86_cores);
            let deployment = Deployment { copies, cores_used, x86_cores, x86_chips, x86_working, ..paper() };
            let mode = if realtime { Mode::Realtime } else { Mode::Offline };
            let tables = vec![CostTable::new(&constants).unwrap(), table("davies2018")];
            let price = step_price(&tables[0], &deployment, copies_counted, mode, Accounting::Profiler);
            let run = run(&steps, tables, Some(price));
            let found = estimate(&EstimateInput {
                copies_counted,
                errors: &constants.errors,
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
                    (row.edp_pjs, row.low.unwrap().edp_pjs, row.high.unwrap().edp_pjs),
                ] {
                    prop_assert!(low <= figure && figure <= high);
                }
            }
            // The rows of one copy are the job.
            let job = found.job.profiler().unwrap();
            prop_assert!(copies > 1 || near(total.total_mw.unwrap(), job) && x86.x86_cores == Some(x86_cores));
            let several = f64::from(copies) * neuron.total_mw.unwrap() + x86_cores as f64 * x86.total_mw.unwrap();
            prop_assert!(copies == 1 || near(several, job) && x86.x86_cores == Some(1));
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
