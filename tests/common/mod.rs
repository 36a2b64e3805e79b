//! Helpers of several integration tests: engines, networks built by hand, recorded data.

// Each test file is a crate of its own and uses a part of this. Test helpers may unwrap.
#![allow(dead_code, clippy::unwrap_used)]

pub mod command;
pub mod compare;
pub mod drive;
pub mod fuzzed;
pub mod random;

pub use nsim_testing::Builder;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use nsim::compile::{Effort, Options, compile};
use nsim::golden::Golden;
use nsim::import::spikes::read_source;
use nsim::ir::base::fixed::{BiasExponent, BiasMantissa, Decay, Refractory, SignMode, ThresholdMantissa};
use nsim::ir::base::id::ChannelId;
use nsim::ir::base::rng;
use nsim::ir::quantised::connectivity::SynapseFormat;
use nsim::ir::quantised::{Neuron, Quantised};
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::session::Session;

/// Options for programs that are run alone: no places are searched for.
pub fn unsearched() -> Options {
    Options { place: false, effort: Effort::Work(0), ..Options::default() }
}

/// Every engine that must give equal results, ready to begin: the interpreter, and the machine on
/// as few cores as possible. Only the number of compartments limits a core.
pub fn engines(network: &Quantised) -> Vec<(&'static str, Box<dyn Engine>)> {
    let machine = machines(network);
    let [fast, unskipped] = [true, false].map(|skip| Box::new(machine(skip)));
    vec![("golden", Box::new(Golden::new(network))), ("fast", fast), ("fast without skipping", unskipped)]
}

/// These engines, each in a session.
pub fn sessions(network: &Quantised) -> Vec<(&'static str, Box<Session<dyn Engine>>)> {
    let machine = machines(network);
    let [fast, unskipped] = [true, false].map(|skip| Box::new(Session::new(machine(skip), 1)));
    let golden = Box::new(Session::new(Golden::new(network), 1));
    vec![("golden", golden), ("fast", fast), ("fast without skipping", unskipped)]
}

/// Machines with skipping or without.
fn machines(network: &Quantised) -> impl Fn(bool) -> Machine {
    let compiled = compile(network.clone(), &compare::roomy("oheo-gulch"), &unsearched()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    move |skip| Machine::new(&image, Settings { skip, per_step: false })
}

/// A folder of recorded data, in `$NSIM_DATA` or `../shared/data` next to the repository. Without
/// it, `None` with a message, or a failure if `NSIM_REQUIRE_DATA` is 1.
pub fn data(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("NSIM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let path = root.join(folder);
    if path.is_dir() {
        return Some(path);
    }
    let required = std::env::var_os("NSIM_REQUIRE_DATA").is_some_and(|value| value == "1");
    assert!(!required, "no data at {}, and NSIM_REQUIRE_DATA is set", path.display());
    say(&format!("skipped: no data at {}", path.display()));
    None
}

/// Recordings in the containers of these parts (`train`, `test`) below a folder, in order.
pub fn recordings(folder: &Path, parts: &[&str]) -> Vec<Sample> {
    let spikes = parts.iter().flat_map(|part| read_source(&folder.join(part), 78).unwrap());
    spikes
        .map(|sample| {
            let events: Vec<_> = sample.events.iter().map(|&(step, channel)| (step, ChannelId(channel))).collect();
            Sample::new(sample.steps, &events, sample.label).unwrap()
        })
        .collect()
}

/// Random spikes: each channel has its own probability in every step.
pub fn noise((channels, steps): (u32, u32), seed: u64, rate: impl Fn(u32) -> f64, label: Option<u32>) -> Sample {
    let all = (0..steps).flat_map(|t| (0..channels).map(move |c| (t, ChannelId(c))));
    let events: Vec<_> = all.filter(|&(t, c)| rng::unit(seed, c.0.into(), t.into()) < rate(c.0)).collect();
    Sample::new(steps, &events, label).unwrap()
}

/// Prints a message that is visible even if the test passes: the harness hides the output of
/// `println!`.
pub fn say(text: &str) {
    use std::io::Write;
    writeln!(std::io::stderr().lock(), "{text}").unwrap();
}

/// The integers of a NumPy file.
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<i64>,
}

impl Array {
    /// Reads a C-ordered file of one of the integer types that the recorded data uses.
    pub fn read(path: &Path) -> Array {
        let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Array::from_reader(BufReader::new(file), &path.display().to_string())
    }

    fn from_reader(reader: impl Read, name: &str) -> Array {
        let npy = npyz::NpyFile::new(reader).unwrap();
        assert_eq!(npy.order(), npyz::Order::C, "{name}");
        let shape = npy.shape().iter().map(|&n| n as usize).collect();
        fn widen<T: Into<i64>>(values: Vec<T>) -> Vec<i64> {
            values.into_iter().map(Into::into).collect()
        }
        let values = match npy.dtype().descr().trim_matches(['\'', '"']) {
            "|u1" => widen(npy.into_vec::<u8>().unwrap()),
            "|i1" => widen(npy.into_vec::<i8>().unwrap()),
            "<i2" => widen(npy.into_vec::<i16>().unwrap()),
            "<i4" => widen(npy.into_vec::<i32>().unwrap()),
            other => panic!("{name}: type {other}"),
        };
        Array { shape, values }
    }

    /// The value at an index.
    pub fn at<const N: usize>(&self, index: [usize; N]) -> i64 {
        assert_eq!(self.shape.len(), N);
        let mut flat = 0;
        for (i, n) in index.into_iter().zip(&self.shape) {
            assert!(i < *n);
            flat = flat * n + i;
        }
        self.values[flat]
    }
}

/// The arrays of a NumPy archive.
pub struct Archive {
    path: PathBuf,
    arrays: BTreeMap<String, Vec<u8>>,
}

impl Archive {
    pub fn read(path: &Path) -> Archive {
        let mut zip = zip::ZipArchive::new(File::open(path).unwrap()).unwrap();
        let mut arrays = BTreeMap::new();
        let names: Vec<String> = zip.file_names().map(|name| name.unwrap().to_string()).collect();
        for name in names {
            let mut bytes = Vec::new();
            zip.by_name(&name).unwrap().read_to_end(&mut bytes).unwrap();
            arrays.insert(name.strip_suffix(".npy").unwrap().to_string(), bytes);
        }
        Archive { path: path.to_path_buf(), arrays }
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// An array of integers.
    pub fn array(&self, name: &str) -> Array {
        let what = format!("{name} of {}", self.path.display());
        Array::from_reader(self.arrays.get(name).unwrap_or_else(|| panic!("no {what}")).as_slice(), &what)
    }

    /// The numbers of an array of integers or of reals.
    pub fn reals(&self, name: &str) -> Vec<f64> {
        let npy = npyz::NpyFile::new(self.arrays[name].as_slice()).unwrap();
        match npy.dtype().descr().contains("f8") {
            true => npy.into_vec::<f64>().unwrap(),
            false => self.array(name).values.iter().map(|&value| value as f64).collect(),
        }
    }
}

/// A compartment with no bias and the widest clips.
pub fn neuron(du: i64, dv: i64, vth_mant: i64, refractory: i64) -> Neuron {
    Neuron {
        du: Decay::new(du).unwrap(),
        dv: Decay::new(dv).unwrap(),
        vth: ThresholdMantissa::new(vth_mant).unwrap(),
        refractory: Refractory::new(refractory).unwrap(),
        ..Neuron::PLAIN
    }
}

/// This compartment with a bias.
pub fn biased(neuron: Neuron, mantissa: i64, exponent: i64) -> Neuron {
    Neuron { bias_mant: BiasMantissa::new(mantissa).unwrap(), bias_exp: BiasExponent::new(exponent).unwrap(), ..neuron }
}

/// A format of eight bits with this sign mode and exponent.
pub fn format(sign: SignMode, exponent: i64) -> SynapseFormat {
    nsim_testing::format(exponent, sign, 8)
}
