//! A preset of constants in integers.
//!
//! Input: decimal numbers in pJ, ns, us and mW. Output: integers in fJ, ps and nW. A number is
//! rounded to its integer unit, from its decimal digits and not from its binary value. A number
//! outside 0..=10^15 units is refused.

use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::units::{Femtojoules, Nanowatts, Picoseconds};
use nsim_ir::hardware::constants::{Constant, Constants, Status, StepForm, TurnRule, Unit, for_each_constant};

/// A ratio in thousandths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Thousandths(pub u64);

impl From<u64> for Thousandths {
    fn from(thousandths: u64) -> Self {
        Thousandths(thousandths)
    }
}

impl Thousandths {
    /// The ratio.
    pub fn ratio(self) -> f64 {
        self.0 as f64 / 1e3
    }
}

/// The type of a constant in its least unit.
macro_rules! integer {
    (pJ) => {
        Femtojoules
    };
    (ns) => {
        Picoseconds
    };
    (us) => {
        Picoseconds
    };
    (mW) => {
        Nanowatts
    };
    (messages) => {
        u64
    };
    (ratio) => {
        Thousandths
    };
}

macro_rules! cost_table {
    ($($(#[$doc:meta])* $field:ident: $unit:ident $(= $default:literal)?,)*) => {
        /// A preset of constants in integers. Fields are the fields of [`Constants`].
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub struct CostTable {
            name: String,
            /// How the time of a step follows from its parts.
            pub step: StepForm,
            /// Steps in which x86 cores take their turn.
            pub turn: TurnRule,
            /// Whether prices of updates that a model states count.
            pub stated: bool,
            /// Whether the time of a program is by its instructions, as the preset has none.
            pub by_instructions: bool,
            /// Barrier times by parts in use, ascending and not empty.
            barrier: Vec<(u64, Picoseconds)>,
            /// Whether these parts are cores, not tiles.
            by_cores: bool,
            $(#[doc = concat!("[`Constants::", stringify!($field), "`]")] pub $field: integer!($unit),)*
        }

        impl CostTable {
            /// Converts a preset.
            ///
            /// # Errors
            /// A diagnostic at the first constant that is negative or too large, and when there is
            /// no barrier time or the times are not in ascending order of tiles.
            pub fn new(constants: &Constants) -> Result<Self, Diagnostic> {
                let preset = constants.name.as_str();
                let timed = constants.barrier.iter().map(|entry| {
                    Ok((entry.parts().0, scaled(preset, "barrier", &entry.time)?.into()))
                });
                let barrier = timed.collect::<Result<Vec<_>, Diagnostic>>()?;
                if barrier.is_empty() || barrier.windows(2).any(|pair| pair[0].0 >= pair[1].0) {
                    return Err(Diagnostic::new(
                        "target.barrier",
                        format!("preset {preset}: barrier times must be given in ascending order of tiles, at least \
                                 one"),
                    ));
                }
                $(let $field = scaled(preset, stringify!($field), &constants.$field)?.into();)*
                let by_cores = constants.barrier.iter().any(|entry| entry.cores > 0);
                let by_instructions = constants.microcode_time.status == Status::NotGiven;
                let (name, Constants { step, turn, .. }) = (constants.name.clone(), constants);
                let (step, turn, stated) = (*step, *turn, true);
                Ok(CostTable { name, step, turn, stated, by_instructions, barrier, by_cores, $($field,)* })
            }
        }
    };
}

for_each_constant!(cost_table);

impl CostTable {
    /// Returns the preset by status (published, calibrated, assumed): other constants are 0, ratios
    /// stay.
    ///
    /// # Errors
    /// As [`CostTable::new`].
    pub fn by_status(constants: &Constants) -> Result<[CostTable; 3], Diagnostic> {
        let only = |status: Status| {
            let mut of_status = constants.clone();
            for (name, constant) in constants.list() {
                // The power of an x86 core at work is no better known than its share of a step.
                let known = match name {
                    "x86_active_power" => {
                        constant.status.max(constants.x86_injecting_share.status.min(Status::Assumed))
                    }
                    _ => constant.status,
                };
                let goes = known != status && constant.unit != Unit::ratio;
                if let Some(own) = of_status.get_mut(name).filter(|_| goes) {
                    own.value = 0.0.into();
                }
            }
            // What a model states has no source.
            Ok(CostTable { stated: status == Status::Assumed, ..CostTable::new(&of_status)? })
        };
        Ok([only(Status::Published)?, only(Status::Calibrated)?, only(Status::Assumed)?])
    }

    /// Returns the corners of a preset's bounds: least energies and powers with greatest times,
    /// then greatest energies and powers with least times. `None` where no constant has bounds.
    ///
    /// # Errors
    /// As [`CostTable::new`].
    pub fn corners(constants: &Constants) -> Result<Option<[CostTable; 2]>, Diagnostic> {
        if !constants.is_bounded() {
            return Ok(None);
        }
        Ok(Some([corner(constants, true)?, corner(constants, false)?]))
    }

    /// The preset's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Static power of an x86 core in mW: a neuron core's, divided by their ratio.
    pub fn x86_static_mw(&self) -> f64 {
        match self.x86_static_ratio {
            Thousandths(0) => 0.0,
            ratio => self.core_static_power.milliwatts() / ratio.ratio(),
        }
    }

    /// Equation (10): the time of a barrier over the tiles or cores in use of a chip, linear
    /// between the preset's entries (rounded down to a picosecond), constant before the first and
    /// after the last.
    pub fn barrier(&self, tiles: u64, cores: u64) -> Picoseconds {
        let tiles = if self.by_cores { cores } else { tiles };
        let after = self.barrier.partition_point(|&(at, _)| at < tiles);
        match (after.checked_sub(1).map(|i| self.barrier[i]), self.barrier.get(after).copied()) {
            (None, Some((_, time))) | (Some((_, time)), None) => time,
            (Some((t0, y0)), Some((t1, y1))) => {
                let (rise, run) = (i128::from(y1.0) - i128::from(y0.0), i128::from(t1 - t0));
                let time = i128::from(y0.0) + (rise * i128::from(tiles - t0)).div_euclid(run);
                // The time is between two values that fit.
                Picoseconds(time as u64)
            }
            (None, None) => Picoseconds::default(),
        }
    }
}

/// A preset at a corner of its bounds: with `slow`, times are greatest and all else is least.
fn corner(constants: &Constants, slow: bool) -> Result<CostTable, Diagnostic> {
    let mut at_corner = constants.clone();
    for (name, constant) in constants.list() {
        if let Some(own) = at_corner.get_mut(name) {
            own.value = at_end(constant, constant.bounds, slow).into();
        }
    }
    for entry in &mut at_corner.barrier {
        let bounds = entry.time.bounds.or(constants.barrier_bounds);
        entry.time.value = at_end(&entry.time, bounds, slow).into();
    }
    let mut table = CostTable::new(&at_corner)?;
    if constants.barrier_bounds.is_some() {
        table.barrier = stepped(&table.barrier, slow);
    }
    Ok(table)
}

/// The end of a constant's bounds at a corner; its value where it has none.
fn at_end(constant: &Constant, bounds: Option<(f64, f64)>, slow: bool) -> f64 {
    let is_time = matches!(constant.unit, Unit::ns | Unit::us);
    bounds.map_or(constant.value.value, |(low, high)| if slow == is_time { high } else { low })
}

/// Entries of a barrier as slow as the next entry (`up`) or as the last: no source has a time.
fn stepped(entries: &[(u64, Picoseconds)], up: bool) -> Vec<(u64, Picoseconds)> {
    let mut all = entries.first().copied().into_iter().collect::<Vec<_>>();
    for pair in entries.windows(2) {
        let [(first, of_first), (second, of_second)] = [pair[0], pair[1]];
        let edge = if up { (first + 1, of_second) } else { (second - 1, of_first) };
        if first < edge.0 && edge.0 < second {
            all.push(edge);
        }
        all.push((second, of_second));
    }
    all
}

/// A constant in the least unit of its kind, rounded to it: pJ in fJ, ns and us in ps, mW in nW.
pub(crate) fn scaled(preset: &str, field: &str, constant: &Constant) -> Result<u64, Diagnostic> {
    let (places, least) = match constant.unit {
        Unit::pJ => (3, "fJ"),
        Unit::ns => (3, "ps"),
        Unit::us => (6, "ps"),
        Unit::mW => (6, "nW"),
        Unit::messages => (0, "messages"),
        Unit::ratio => (3, "thousandths"),
    };
    let value = constant.value.value;
    decimal(value, places).ok_or_else(|| {
        Diagnostic::new(
            "target.constant-range",
            format!("preset {preset}: {field} {value} {:?} is not from 0 to 10^15 {least}", constant.unit),
        )
    })
}

/// `value * 10^places`, rounded to an integer; `None` outside 0..=10^15. The shortest decimal that
/// parses to `value` is the file's (up to 15 digits), so there is no binary rounding.
fn decimal(value: f64, places: usize) -> Option<u64> {
    if !(0.0..=1e15).contains(&value) {
        return None;
    }
    let text = format!("{value}");
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let (decimals, rest) = fraction.split_at(places.min(fraction.len()));
    let digits = format!("{}{decimals:0<places$}", whole.trim_start_matches('-'));
    let up = u64::from(rest.as_bytes().first().is_some_and(|&digit| digit >= b'5'));
    digits.parse().ok().map(|integer: u64| integer + up).filter(|&integer| integer <= 1_000_000_000_000_000)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn preset(name: &str) -> Constants {
        nsim_files::target::load_constants(name).unwrap()
    }

    pub(crate) fn table(name: &str) -> CostTable {
        CostTable::new(&preset(name)).unwrap()
    }

    #[test]
    fn decimals_convert_exactly_or_to_the_nearest() {
        assert_eq!(decimal(23.6, 3), Some(23_600));
        assert_eq!(decimal(0.113, 6), Some(113_000));
        assert_eq!(decimal(0.0, 3), Some(0));
        assert_eq!(decimal(-0.0, 3), Some(0));
        assert_eq!(decimal(135.04, 6), Some(135_040_000));
        assert_eq!(decimal(1e9, 6), Some(1_000_000_000_000_000));
        for (value, rounded) in [(0.0001, 0), (0.0005, 1), (23.6001, 23_600), (23.59951, 23_600), (1.0 / 3.0, 333)] {
            assert_eq!(decimal(value, 3), Some(rounded), "{value}");
        }
        for refused in [-1.0, f64::NAN, f64::INFINITY, 1e13] {
            assert_eq!(decimal(refused, 3), None, "{refused}");
        }
        // 0.001 to 99.999: each is exact in thousandths, though hardly any is a binary fraction.
        for thousandths in 1..100_000u64 {
            let text = format!("{}.{:03}", thousandths / 1000, thousandths % 1000);
            assert_eq!(decimal(text.parse().unwrap(), 3), Some(thousandths), "{text}");
        }
    }

    #[test]
    fn the_presets_hold_what_their_sources_print() {
        let op = |energy, time| (Femtojoules(energy), Picoseconds(time));
        let davies = table("davies2018");
        assert_eq!((davies.synapse_dense_energy, davies.synapse_dense_time), op(23_600, 3_500));
        assert_eq!(davies.compartment_energy + davies.compartment_active_energy, Femtojoules(81_000));
        assert_eq!(davies.compartment_time + davies.compartment_active_time, Picoseconds(8_400));
        assert_eq!(
            (
                (davies.local_hop_energy, davies.local_hop_time),
                (davies.hop_ew_energy, davies.hop_ew_time),
                (davies.hop_ns_energy, davies.hop_ns_time)
            ),
            (op(1_700, 2_100), op(3_000, 4_100), op(4_000, 6_500))
        );
        let sana = table("sanafe-calibrated");
        // SANA-FE src/pipeline.hpp adds the costs up: idle 51.2 pJ, updated 72.8 pJ / 9.7 ns,
        // spiking 142.1 pJ / 39.7 ns.
        assert_eq!((sana.compartment_energy, sana.compartment_time), op(51_200, 6_000));
        assert_eq!(sana.compartment_energy + sana.compartment_active_energy, Femtojoules(72_800));
        assert_eq!(sana.compartment_energy + sana.compartment_active_energy + sana.spike_energy, Femtojoules(142_100));
        assert_eq!(sana.compartment_time + sana.compartment_active_time + sana.spike_time, Picoseconds(39_700));
        assert_eq!(
            ((sana.axon_out_energy, sana.axon_out_time), (sana.axon_in_energy, sana.axon_in_time)),
            (op(111_000, 5_100), op(0, 16_000))
        );
    }

    #[test]
    fn barriers_are_interpolated_between_entries_and_constant_beyond() {
        let davies = table("davies2018");
        let at = |tiles| davies.barrier(tiles, 0).0;
        assert_eq!((at(0), at(1), at(32), at(1 << 40)), (113_000, 113_000, 465_000, 465_000));
        // 113 ns + 352 ns * 1/31 = 124.354... ns
        assert_eq!(at(2), 124_354);
        assert_eq!(table("sanafe-calibrated").barrier(3, 0), Picoseconds(1_200_000));
        for tiles in 0..30_000 {
            assert!(at(tiles) <= at(tiles + 1));
        }
    }

    #[test]
    fn a_barrier_by_cores_is_bounded_by_the_entries_around() {
        let modelled = preset("loihi2-modelled");
        let at = |constants: &Constants, cores: u64| {
            let [slow, fast] = CostTable::corners(constants).unwrap().unwrap();
            [CostTable::new(constants).unwrap(), fast, slow].map(|table| table.barrier(1, cores).0 / 1_000)
        };
        for (cores, times) in [
            (1, [1_160, 1_160, 1_170]),
            (2, [1_160, 1_160, 1_170]),
            (3, [1_366, 1_160, 1_810]),
            (5, [1_780, 1_750, 1_810]),
            (69, [1_780, 1_750, 1_810]),
            (70, [1_780, 1_750, 10_000]),
            (128, [1_780, 1_750, 10_000]),
        ] {
            assert_eq!(at(&modelled, cores), times, "{cores} cores");
        }
        // What only a group measured is then the nearest other barrier, within the widest bounds.
        assert_eq!(at(&modelled.without("NECOTIS"), 2), [1_780, 200, 10_000]);
        assert_eq!(at(&modelled.without("OzU-CAST"), 69), [1_160, 200, 10_000]);
        assert_eq!(modelled.without("OzU-CAST").microcode_time.value.value, 26.4);
        assert!(CostTable::corners(&preset("loihi1-evidence")).unwrap().is_none());
    }

    #[test]
    fn more_digits_than_a_femtojoule_are_rounded_and_what_is_below_zero_is_refused_by_name() {
        let mut constants = preset("davies2018");
        constants.hop_ew_energy.value = 3.0001.into();
        assert_eq!(CostTable::new(&constants).unwrap().hop_ew_energy, table("davies2018").hop_ew_energy);
        constants.hop_ew_energy.value = (-3.0).into();
        let problem = CostTable::new(&constants).unwrap_err();
        assert_eq!(problem.message, "preset davies2018: hop_ew_energy -3 pJ is not from 0 to 10^15 fJ");
    }

    #[test]
    fn the_page_on_energy_repeats_the_files() {
        let page = std::fs::read_to_string(format!("{}/../../docs/energy.md", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let (davies, sana) = (preset("davies2018"), preset("loihi1-evidence"));
        let cell = |constant: &Constant| format!("{} {}", constant.value.value, &format!("{:?}", constant.status)[..1]);
        for ((name, ours), (_, theirs)) in davies.list().into_iter().zip(sana.list()) {
            let end = format!("| {:?} | {} | {} |", ours.unit, cell(ours), cell(theirs));
            let start = format!("| `{name}` | ");
            assert!(page.lines().any(|line| line.starts_with(&start) && line.ends_with(&end)), "{start} ... {end}");
        }
        for constants in [&davies, &sana] {
            // Times as files write them: with a decimal point.
            let listed: Vec<String> =
                constants.barrier.iter().map(|e| format!("{}: {:?}", e.tiles, e.time.value.value)).collect();
            assert!(page.contains(&format!("{}: {}.", constants.name, listed.join(", "))), "{listed:?}");
        }
    }
}
