//! Options of reading recordings as spikes, given after the `?` of a source.

use std::path::Path;

use nsim_files::budget::MOST_STEPS;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::names::named_variants;

/// Treatment of the polarities.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Polarity {
    /// Separate channels: falling, then rising.
    #[default]
    Both,
    /// One channel for both.
    Merge,
    /// Only rising events.
    On,
    /// Only falling events.
    Off,
}

named_variants!(Polarity { Both = "both", Merge = "merge", On = "on", Off = "off" });

/// The time of step 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The first event of the file.
    First,
    /// This many microseconds on the recording's clock.
    At(i64),
}

/// The unit of times in text and arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
}

named_variants!(TimeUnit { Seconds = "s", Milliseconds = "ms", Microseconds = "us", Nanoseconds = "ns" });

impl TimeUnit {
    /// The unit with a name: `s`, `ms`, `us` or `ns`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| unit.name() == name)
    }

    /// A time of this unit in whole microseconds, rounded down, with a tolerance for rounding
    /// errors.
    pub fn microseconds(self, time: f64) -> i64 {
        let us = time
            * match self {
                TimeUnit::Seconds => 1e6,
                TimeUnit::Milliseconds => 1e3,
                TimeUnit::Microseconds => 1.0,
                TimeUnit::Nanoseconds => 1e-3,
            };
        (us + 1e-4 + us.abs() * f64::EPSILON).floor() as i64
    }
}

/// Options of reading recordings as spikes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EventOptions {
    /// Columns and rows of the sensor.
    pub size: Option<(u32, u32)>,
    /// Left, top, width and height of the used part.
    pub crop: Option<(u32, u32, u32, u32)>,
    /// Columns and rows that are pooled into one.
    pub pool: Option<(u32, u32)>,
    /// Length of a timestep in microseconds.
    pub bin_us: Option<f64>,
    /// Whether times are rounded to the nearest step, ties to even, as in SLAYER, or else down.
    pub nearest: bool,
    /// Timesteps of the sample.
    pub steps: Option<u32>,
    /// The time of step 0.
    pub start: Option<Origin>,
    /// Treatment of the polarities.
    pub polarity: Polarity,
    /// The least number of events of a bin that is a spike, or the least number in an array.
    pub least: Option<f64>,
    /// The unit of times in a file that does not state it.
    pub unit: Option<TimeUnit>,
    /// The stream to read, in files with several.
    pub stream: Option<u32>,
}

/// Every option, for messages.
const OPTIONS: &str = "options are size=W,H crop=X,Y,W,H pool=N bin_ms=T round=down|even steps=N start=first \
                       start_ms=T polarity=both|merge|on|off least=N unit=s|ms|us|ns stream=N, joined by &";

/// Options for arrays.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ArrayOptions {
    /// Treatment of the polarities.
    pub polarity: Polarity,
    /// The least number that is a spike.
    pub least: Option<f64>,
    /// Whether the numbers are the values of messages.
    pub values: bool,
}

/// The rule for the number of a spike, for messages.
pub const SPIKE_RULE: &str = "spikes are whole numbers";

impl ArrayOptions {
    /// A number as the value of a message.
    ///
    /// # Errors
    /// `input.value` for a number that is not an integer of 32 bits, or for merged polarities.
    pub(super) fn value(self, number: f64, path: &Path) -> Result<i32> {
        let value = number as i32;
        if f64::from(value) != number || self.polarity == Polarity::Merge {
            let message = format!("the array holds {number}: a message carries a 32-bit integer of one channel");
            return Err(Diagnostic::new("input.value", message).in_file(path).help("scale or round the array first"));
        }
        Ok(value)
    }

    /// The numbers of an array, before the first.
    pub(super) fn entries(self, path: &Path) -> Entries<'_> {
        Entries { options: self, path, values: SpikeValues::default() }
    }
}

/// The numbers of an array that are read as spikes.
pub(super) struct Entries<'a> {
    options: ArrayOptions,
    path: &'a Path,
    values: SpikeValues,
}

impl Entries<'_> {
    /// Whether a number is a spike.
    ///
    /// # Errors
    /// `input.value` for a fraction, without a least number.
    pub(super) fn is_spike(&mut self, index: usize, number: f64) -> Result<bool> {
        match self.options.least {
            Some(least) => Ok(number >= least),
            None if number.fract() == 0.0 => {
                self.values.add(index, number);
                Ok(number != 0.0)
            }
            None => Err(Diagnostic::new("input.value", format!("the array holds {number}, but {SPIKE_RULE}"))
                .help(format!(
                    "encode real numbers as spikes, or let values from 0.5 be spikes: {}?least=0.5",
                    self.path.display()
                ))
                .in_file(self.path)),
        }
    }

    /// Refuses numbers that spikes without a value would lose.
    ///
    /// # Errors
    /// `input.value`.
    pub(super) fn finish(self) -> Result<()> {
        let Some((_, message)) = self.values.loss().filter(|_| !self.options.values) else { return Ok(()) };
        let path = self.path.display();
        Err(Diagnostic::new("input.value", format!("the array holds counts or signed numbers: {message}"))
            .help(format!(
                "{path}?least=1 makes each number from 1 on one spike, least=2 from 2 on; on a chip with graded spikes, \
                 such as --target oheo-gulch, an input with message_bits in the model (message_bits: 8) sends the numbers"
            ))
            .in_file(self.path))
    }
}

/// Values of an array's entries other than zero. One value above zero is a spike without loss;
/// several are counts.
#[derive(Debug, Clone, Copy, Default)]
pub struct SpikeValues {
    spikes: u64,
    value: Option<f64>,
    /// Whether there are several values.
    varied: bool,
    above_one: u64,
    negative: u64,
    /// Index and value of the first entry above one, and of the first negative one.
    first_above: Option<(usize, f64)>,
    first_negative: Option<(usize, f64)>,
}

impl SpikeValues {
    /// Adds the entry at an index, unless it is zero.
    pub fn add(&mut self, index: usize, number: f64) {
        if number == 0.0 {
            return;
        }
        self.spikes += 1;
        self.varied |= number != *self.value.get_or_insert(number);
        if number > 1.0 {
            self.above_one += 1;
            self.first_above.get_or_insert((index, number));
        } else if number < 0.0 {
            self.negative += 1;
            self.first_negative.get_or_insert((index, number));
        }
    }

    /// The first entry that a binary spike cannot represent, and a message about all of them.
    pub fn loss(&self) -> Option<((usize, f64), String)> {
        let SpikeValues { spikes, above_one, negative, .. } = *self;
        match (self.first_negative, self.first_above.filter(|_| self.varied)) {
            (Some(entry), _) => {
                let message = format!("{negative} of {spikes} entries other than 0 are negative");
                Some((entry, message + ", and a binary spike has no sign"))
            }
            (None, Some(entry)) => {
                let message = format!("{above_one} of {spikes} entries other than 0 are greater than 1");
                Some((entry, message + ", and a binary spike has no count"))
            }
            (None, None) => None,
        }
    }
}

impl EventOptions {
    /// The options of an array; `None` if others are given.
    pub fn array_options(&self) -> Option<ArrayOptions> {
        let &EventOptions { polarity, least, .. } = self;
        let array = ArrayOptions { polarity, least, values: false };
        (*self == EventOptions { polarity, least, ..EventOptions::default() }).then_some(array)
    }

    /// Parses the `key=value` pairs of an argument.
    ///
    /// # Errors
    /// `input.option` with the keys that exist.
    pub fn parse(pairs: &[(String, String)]) -> Result<Self> {
        let mut options = EventOptions::default();
        for (key, value) in pairs {
            let bad = |what: &str| Diagnostic::new("input.option", format!("{key}={value}: {what}")).help(OPTIONS);
            let numbers = |count: std::ops::RangeInclusive<usize>, least: u32| -> Result<Vec<u32>> {
                let list: Option<Vec<u32>> = value.split(',').map(|part| part.trim().parse().ok()).collect();
                list.filter(|list| count.contains(&list.len()) && list.iter().all(|&x| (least..=1 << 16).contains(&x)))
                    .ok_or_else(|| bad(&format!("{count:?} whole numbers from {least} to 65536 are expected")))
            };
            let milliseconds = || -> Result<f64> {
                let number = value.parse().ok().filter(|x: &f64| x.is_finite() && x.abs() <= 1e15);
                number.ok_or_else(|| bad("not a number of milliseconds"))
            };
            match key.as_str() {
                "size" => options.size = numbers(2..=2, 1)?.get(..2).map(|p| (p[0], p[1])),
                "crop" => options.crop = numbers(4..=4, 0)?.get(..4).map(|p| (p[0], p[1], p[2], p[3])),
                "pool" => {
                    let pool = numbers(1..=2, 1)?;
                    options.pool = Some((pool[0], *pool.last().unwrap_or(&pool[0])));
                }
                "bin_ms" => {
                    let ms = milliseconds()?;
                    options.bin_us = Some(ms * 1e3).filter(|us| *us > 0.0);
                    options.bin_us.ok_or_else(|| bad("a bin is longer than 0"))?;
                }
                "round" if value == "even" => options.nearest = true,
                "round" if value == "down" => options.nearest = false,
                "steps" => {
                    let steps = value.parse().ok().filter(|steps| (1..=MOST_STEPS).contains(steps));
                    options.steps = Some(steps.ok_or_else(|| bad("not a number of timesteps from 1 to 2^24"))?);
                }
                "start" if value == "first" => options.start = Some(Origin::First),
                "start_ms" => options.start = Some(Origin::At((milliseconds()? * 1e3) as i64)),
                "polarity" => {
                    let polarity = Polarity::ALL.into_iter().find(|polarity| polarity.name() == value);
                    options.polarity = polarity.ok_or_else(|| bad("expected both, merge, on or off"))?;
                }
                "unit" => {
                    let unit = TimeUnit::from_name(value);
                    options.unit = Some(unit.ok_or_else(|| bad("expected s, ms, us or ns"))?);
                }
                "stream" => options.stream = Some(numbers(1..=1, 0)?[0]),
                "least" => {
                    let least = value.parse().ok().filter(|least: &f64| *least > 0.0 && least.is_finite());
                    options.least = Some(least.ok_or_else(|| bad("not a number above 0"))?);
                }
                _ => return Err(bad("there is no such option")),
            }
        }
        Ok(options)
    }
}
