//! What several integration tests share: the engines that they run over, networks built by hand,
//! recorded data.

// Each test file is a crate of its own and uses a part of this; a helper of tests may unwrap as
// they do.
#![allow(dead_code, clippy::unwrap_used)]

pub mod drive;
pub mod random;

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::import::spikes::read_source;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, Refractory, SignMode, ThresholdMantissa, WeightBits, WeightExponent,
};
use nsim::ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim::ir::graph::{PerCompartment, Shape};
use nsim::ir::neurons::Port;
use nsim::ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim::ir::quantised::{Neuron, Parts, Population, Projection, Quantised, Reset, Units};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};

/// Every engine that must give the same answers, ready to begin: the interpreter, and the machine
/// on as few cores as possible, with every core limit but the number of compartments out of the
/// way.
pub fn engines(network: &Quantised) -> Vec<(&'static str, Box<dyn Engine>)> {
    let chip = load_target("oheo-gulch").unwrap();
    let mut limits = chip.limits().clone();
    (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles], limits[Resource::SynapseFormats]) =
        (1024, 1024, 64);
    (limits[Resource::Accumulators], limits[Resource::AxonsIn]) = (1 << 16, 1 << 16);
    let compiled = compile(network.clone(), &chip.with_limits(limits), &Options::default()).unwrap();
    let image = Image::new(&compiled.program, 1).unwrap();
    let machine = |skip| Box::new(Machine::new(&image, Settings { skip, per_step: false }));
    vec![("golden", Box::new(Golden::new(network))), ("fast", machine(true)), ("fast without skipping", machine(false))]
}

/// Where recorded data lies: `$NSIM_DATA`, or `../shared/data` beside the repository.
pub fn data_root() -> PathBuf {
    std::env::var_os("NSIM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from)
}

/// A folder of recorded data; without it a message and nothing, or a failure where
/// `NSIM_REQUIRE_DATA` is 1.
pub fn data(folder: &str) -> Option<PathBuf> {
    let path = data_root().join(folder);
    if path.is_dir() {
        return Some(path);
    }
    let required = std::env::var_os("NSIM_REQUIRE_DATA").is_some_and(|value| value == "1");
    assert!(!required, "no data at {}, and NSIM_REQUIRE_DATA is set", path.display());
    say(&format!("skipped: no data at {}", path.display()));
    None
}

/// The recordings of containers in these parts (`train`, `test`), in order, under their folder.
pub fn recordings(folder: &Path, parts: &[&str]) -> Vec<Sample> {
    let spikes = parts.iter().flat_map(|part| read_source(&folder.join(part), 78).unwrap());
    spikes
        .map(|sample| {
            let events: Vec<_> = sample.events.iter().map(|&(step, channel)| (step, ChannelId(channel))).collect();
            Sample::new(sample.steps, &events, sample.label).unwrap()
        })
        .collect()
}

/// Says something that is seen even when the test passes: the harness keeps what `println!` prints
/// to itself.
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
        let npy = npyz::NpyFile::new(BufReader::new(file)).unwrap();
        assert_eq!(npy.order(), npyz::Order::C, "{}", path.display());
        let shape = npy.shape().iter().map(|&n| n as usize).collect();
        fn widen<T: Into<i64>>(values: Vec<T>) -> Vec<i64> {
            values.into_iter().map(Into::into).collect()
        }
        let values = match npy.dtype().descr().trim_matches(['\'', '"']) {
            "|u1" => widen(npy.into_vec::<u8>().unwrap()),
            "|i1" => widen(npy.into_vec::<i8>().unwrap()),
            "<i2" => widen(npy.into_vec::<i16>().unwrap()),
            "<i4" => widen(npy.into_vec::<i32>().unwrap()),
            other => panic!("{}: type {other}", path.display()),
        };
        Array { shape, values }
    }

    /// The value at an index of as many numbers as the array has dimensions.
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

/// The same with a bias.
pub fn biased(neuron: Neuron, mantissa: i64, exponent: i64) -> Neuron {
    Neuron { bias_mant: BiasMantissa::new(mantissa).unwrap(), bias_exp: BiasExponent::new(exponent).unwrap(), ..neuron }
}

/// Eight bits of this sign mode with this exponent.
pub fn format(sign: SignMode, exponent: i64) -> SynapseFormat {
    let (exponent, bits) = (WeightExponent::new(exponent).unwrap(), WeightBits::new(8).unwrap());
    SynapseFormat { exponent, sign, bits, port: Port::First }
}

/// A network in the making; the population added last is the output.
pub struct Net {
    pub parts: Parts,
    channels: u32,
    compartments: u32,
}

impl Net {
    /// An empty network with the semantics of the chip.
    pub fn new() -> Net {
        let parts = Parts { name: "by hand".to_string(), ..Parts::default() };
        Net { parts, channels: 0, compartments: 0 }
    }

    /// The same with other semantics.
    pub fn with(semantics: Semantics) -> Net {
        let mut net = Net::new();
        net.parts.semantics = semantics;
        net
    }

    /// Adds input channels.
    pub fn input(&mut self, shape: Shape) -> PopulationId {
        let units = Units::Input(ChannelId(self.channels));
        self.channels += shape.len();
        self.add(shape, units)
    }

    /// Adds compartments with their parameters.
    pub fn loihi(&mut self, shape: Shape, neurons: &[Neuron], start_step: u32) -> PopulationId {
        assert_eq!(shape.len() as usize, neurons.len());
        let neurons = PerCompartment::Each(neurons.to_vec());
        let first = CompartmentId(self.compartments);
        self.compartments += shape.len();
        self.parts.output = PopulationId(self.parts.populations.len() as u32);
        self.add(shape, Units::Compartments { first, neurons, start_step })
    }

    fn add(&mut self, shape: Shape, units: Units) -> PopulationId {
        let name = format!("p{}", self.parts.populations.len());
        self.parts.populations.push(Population { name, shape, units, message: nsim::ir::spikes::Message::Spike })
    }

    /// Connects two populations.
    pub fn project(
        &mut self,
        source: PopulationId,
        target: PopulationId,
        format: SynapseFormat,
        delay: i64,
        connectivity: Connectivity,
    ) {
        let name = format!("{source} -> {target}");
        let delay = Delay::new(delay).unwrap();
        self.parts.projections.push(Projection { name, source, target, format, delay, connectivity });
    }

    /// Connects all to all with mixed 8-bit weights `[target][source]`, as model files have them.
    pub fn dense(&mut self, source: PopulationId, target: PopulationId, delay: i64, weights: &[i64]) {
        let (sources, targets) =
            (self.parts.populations[source].shape.len() as usize, self.parts.populations[target].shape.len() as usize);
        assert_eq!(weights.len(), sources * targets);
        let by_source = (0..sources).flat_map(|s| (0..targets).map(move |t| weights[t * sources + s] as i16)).collect();
        let connectivity = Connectivity::Dense { targets: targets as u32, weights: by_source };
        self.project(source, target, format(SignMode::Mixed, 0), delay, connectivity);
    }

    /// Resets every population periodically.
    pub fn reset(&mut self, interval: u32, offset: u32) {
        self.parts.reset = Some(Reset { interval, offset });
    }

    /// The network.
    pub fn build(self) -> Quantised {
        Quantised::new(self.parts).unwrap()
    }
}
