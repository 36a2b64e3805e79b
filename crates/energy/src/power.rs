//! Power of this machine while it computes: as stated, else from its energy counters, else assumed.
//!
//! Input: a powercap tree (`/sys/class/powercap`), whose package zones count microjoules and wrap
//! at `max_energy_range_uj`. Output: idle and dynamic power, mW. The counters cover whole packages,
//! other programs included. Since Linux 5.10 only root may read them; the reason for a failure is
//! stored. Without stated or counted power, a package is assumed, of which each thread takes its
//! share.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nsim_cost::estimate::FigureSource;

/// Path of the tree on Linux.
pub const POWERCAP: &str = "/sys/class/powercap";

/// A package's energy counter.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Zone {
    counter: PathBuf,
    /// Greatest value of the counter; the next is 0.
    range_uj: u64,
}

/// The energy counters of all packages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rapl {
    zones: Vec<Zone>,
}

fn number(path: &Path) -> Result<u64, String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    text.trim().parse().map_err(|_| format!("{}: '{}' is not a number", path.display(), text.trim()))
}

impl Rapl {
    /// Opens the packages of a powercap tree.
    ///
    /// # Errors
    /// The reason why no package can be read.
    pub fn open(tree: &Path) -> Result<Self, String> {
        let entries = std::fs::read_dir(tree).map_err(|error| format!("{}: {error}", tree.display()))?;
        let mut folders: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        folders.sort();
        let mut zones = Vec::new();
        for folder in folders {
            // Domains within a package and its other controllers would be counted twice.
            let name = std::fs::read_to_string(folder.join("name")).unwrap_or_default();
            let controller = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            if !name.starts_with("package-") || !controller.starts_with("intel-rapl:") {
                continue;
            }
            let (counter, range) = (folder.join("energy_uj"), folder.join("max_energy_range_uj"));
            number(&counter)?;
            zones.push(Zone { counter, range_uj: number(&range)?.max(1) });
        }
        if zones.is_empty() {
            return Err(format!("{} has no package with an energy counter", tree.display()));
        }
        Ok(Rapl { zones })
    }

    /// Reads the counters, in uJ.
    ///
    /// # Errors
    /// The reason why a counter cannot be read.
    pub fn read(&self) -> Result<Vec<u64>, String> {
        self.zones.iter().map(|zone| number(&zone.counter)).collect()
    }

    /// Returns the energy between two readings in uJ. A counter that decreased has wrapped, once: a
    /// package of 100 W takes three quarters of an hour for the common range of 262 kJ.
    pub fn between(&self, before: &[u64], after: &[u64]) -> u64 {
        let spent = |((zone, &before), &after): ((&Zone, &u64), &u64)| match after.checked_sub(before) {
            Some(spent) => spent,
            None => (zone.range_uj - before.min(zone.range_uj)).saturating_add(after),
        };
        self.zones.iter().zip(before).zip(after).map(spent).sum()
    }

    /// Runs `run`; returns its result and its mean power in mW, or the error of the counters.
    fn power_mw<T>(&self, run: impl FnOnce() -> T) -> (T, Result<f64, String>) {
        let (before, begin) = (self.read(), Instant::now());
        let out = run();
        let (after, took) = (self.read(), begin.elapsed().as_secs_f64().max(1e-9));
        (out, before.and_then(|before| Ok(self.between(&before, &after?) as f64 / took / 1e3)))
    }
}

/// Assumed power of a whole package, and the number of threads that share it when it is busy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PackagePower {
    /// Power at idle, mW.
    pub idle_mw: f64,
    /// Power with all threads busy, mW.
    pub busy_mw: f64,
    /// Number of its threads, one of which computes.
    pub threads: usize,
}

impl PackagePower {
    /// Returns the package of a desktop processor, with the threads of this machine.
    pub fn assumed() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        PackagePower { idle_mw: 10_000.0, busy_mw: 65_000.0, threads }
    }

    /// The share of one thread of a busy machine: idle and busy, in mW.
    pub fn share(self) -> (f64, f64) {
        let threads = self.threads.max(1) as f64;
        (self.idle_mw / threads, self.busy_mw / threads)
    }
}

/// Source of power figures.
#[derive(Debug, Clone, PartialEq)]
pub enum PowerMeter {
    /// From counters, with their power at idle.
    Counted {
        /// The counters.
        rapl: Rapl,
        /// Power at idle, mW.
        idle_mw: f64,
    },
    /// As stated by the user.
    Stated {
        /// Power at idle, mW.
        idle_mw: f64,
        /// Power while computing, mW.
        busy_mw: f64,
    },
    /// Neither stated nor counted: the share of one thread of a package.
    Assumed {
        /// The package.
        package: PackagePower,
        /// The reason why it is not counted.
        why: String,
    },
}

/// Power during a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    /// Power at idle, mW.
    pub static_mw: f64,
    /// Power above idle during the run, mW.
    pub dynamic_mw: f64,
    /// Measured, stated or assumed.
    pub source: FigureSource,
}

impl PowerMeter {
    /// Returns the stated power; else counters, read at idle first; else an assumed package.
    pub fn new(tree: &Path, stated: Option<(f64, f64)>, assumed: PackagePower, idle: Duration) -> Self {
        let counted = || -> Result<PowerMeter, String> {
            let rapl = Rapl::open(tree)?;
            let idle_mw = rapl.power_mw(|| std::thread::sleep(idle)).1?;
            Ok(PowerMeter::Counted { rapl, idle_mw })
        };
        match stated {
            Some((idle_mw, busy_mw)) => PowerMeter::Stated { idle_mw, busy_mw },
            None => counted().unwrap_or_else(|why| PowerMeter::Assumed { package: assumed, why }),
        }
    }

    /// Runs `run`; returns its result and its power.
    pub fn during<T>(&self, run: impl FnOnce() -> T) -> (T, Power) {
        let power = |idle_mw: f64, busy_mw: f64, source| Power {
            static_mw: idle_mw,
            dynamic_mw: (busy_mw - idle_mw).max(0.0),
            source,
        };
        match self {
            PowerMeter::Stated { idle_mw, busy_mw } => (run(), power(*idle_mw, *busy_mw, FigureSource::Stated)),
            PowerMeter::Assumed { package, .. } => {
                let (idle_mw, busy_mw) = package.share();
                (run(), power(idle_mw, busy_mw, FigureSource::Assumed))
            }
            PowerMeter::Counted { rapl, idle_mw } => {
                let (out, busy_mw) = rapl.power_mw(run);
                // The counters became unreadable: take their last value, the idle power.
                let said_last = |_| power(*idle_mw, *idle_mw, FigureSource::Assumed);
                (out, busy_mw.map_or_else(said_last, |busy_mw| power(*idle_mw, busy_mw, FigureSource::Measured)))
            }
        }
    }

    /// Source of the figures, as text.
    pub fn source(&self) -> String {
        match self {
            PowerMeter::Counted { .. } => {
                "power from the energy counters of its packages, idle measured first".to_string()
            }
            PowerMeter::Stated { idle_mw, busy_mw } => {
                format!("power {}, {} W idle and {} W busy", FigureSource::Stated.name(), idle_mw / 1e3, busy_mw / 1e3)
            }
            PowerMeter::Assumed { package: PackagePower { idle_mw, busy_mw, threads }, why } => format!(
                "power {}, 1 of {threads} threads that share a package of {} W idle and {} W busy, because {why}; no \
                 ratio is computed; --cpu-watts IDLE,BUSY sets the power",
                FigureSource::Assumed.name(),
                idle_mw / 1e3,
                busy_mw / 1e3
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(zones: &[(&str, &str, u64, u64)]) -> tempfile::TempDir {
        let tree = tempfile::tempdir().unwrap();
        for &(folder, name, energy, range) in zones {
            let folder = tree.path().join(folder);
            std::fs::create_dir(&folder).unwrap();
            std::fs::write(folder.join("name"), format!("{name}\n")).unwrap();
            std::fs::write(folder.join("energy_uj"), format!("{energy}\n")).unwrap();
            std::fs::write(folder.join("max_energy_range_uj"), format!("{range}\n")).unwrap();
        }
        tree
    }

    #[test]
    fn packages_are_summed_and_their_parts_are_not() {
        let tree = tree(&[
            ("intel-rapl:0", "package-0", 100, 1_000),
            ("intel-rapl:0:0", "core", 7, 1_000),
            ("intel-rapl:0:1", "dram", 9, 1_000),
            ("intel-rapl:1", "package-1", 300, 1_000),
            ("intel-rapl:2", "psys", 5_000, 1_000_000),
            ("intel-rapl-mmio:0", "package-0", 100, 1_000),
        ]);
        let rapl = Rapl::open(tree.path()).unwrap();
        assert_eq!(rapl.read().unwrap(), [100, 300]);
        assert_eq!(rapl.between(&[100, 300], &[150, 310]), 60);
    }

    #[test]
    fn a_counter_that_starts_again_goes_on() {
        let tree = tree(&[("intel-rapl:0", "package-0", 990, 1_000)]);
        let rapl = Rapl::open(tree.path()).unwrap();
        let before = rapl.read().unwrap();
        std::fs::write(tree.path().join("intel-rapl:0/energy_uj"), "25\n").unwrap();
        assert_eq!(rapl.between(&before, &rapl.read().unwrap()), 35);
        assert_eq!(rapl.between(&[1_000], &[0]), 0);
        assert_eq!(rapl.between(&[2_000], &[3]), 3);
    }

    #[test]
    fn what_cannot_be_read_says_why_and_power_is_assumed() {
        let none = Rapl::open(Path::new("/nonexistent/powercap")).unwrap_err();
        assert!(none.contains("/nonexistent/powercap"), "{none}");
        let empty = tree(&[("dtpm", "dtpm", 1, 1)]);
        assert!(Rapl::open(empty.path()).unwrap_err().contains("no package"));
        let broken = tree(&[("intel-rapl:0", "package-0", 1, 1)]);
        std::fs::write(broken.path().join("intel-rapl:0/energy_uj"), "much\n").unwrap();
        assert!(Rapl::open(broken.path()).unwrap_err().contains("'much' is not a number"));
        let package = PackagePower { idle_mw: 10_000.0, busy_mw: 65_000.0, threads: 4 };
        let meter = PowerMeter::new(broken.path(), None, package, Duration::ZERO);
        let (out, power) = meter.during(|| 3);
        assert_eq!((out, power.static_mw, power.dynamic_mw), (3, 2_500.0, 13_750.0));
        assert_eq!(power.source, FigureSource::Assumed);
        let said = "assumed, 1 of 4 threads that share a package of 10 W idle and 65 W busy, because";
        assert!(meter.source().contains(said), "{}", meter.source());
    }

    #[test]
    fn counted_power_is_energy_over_time_less_idle() {
        let tree = tree(&[("intel-rapl:0", "package-0", 999_000, 1_000_000)]);
        let package = PackagePower { idle_mw: 1.0, busy_mw: 2.0, threads: 1 };
        let meter = PowerMeter::new(tree.path(), None, package, Duration::from_millis(1));
        // Nothing counts while it is idle.
        assert!(matches!(&meter, PowerMeter::Counted { idle_mw, .. } if *idle_mw == 0.0));
        let counter = tree.path().join("intel-rapl:0/energy_uj");
        let ((), power) = meter.during(|| {
            std::thread::sleep(Duration::from_millis(20));
            std::fs::write(&counter, "1000\n").unwrap();
        });
        // 2 mJ over at least 20 ms, across the end of the range.
        assert_eq!((power.source, power.static_mw), (FigureSource::Measured, 0.0));
        assert!(power.dynamic_mw > 0.0 && power.dynamic_mw <= 100.0, "{power:?}");
        let stated = PowerMeter::new(tree.path(), Some((5.0, 8.0)), package, Duration::ZERO);
        let ((), power) = stated.during(|| ());
        assert_eq!((power.source, power.static_mw, power.dynamic_mw), (FigureSource::Stated, 5.0, 3.0));
    }
}
