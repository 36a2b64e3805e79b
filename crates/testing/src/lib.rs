//! Networks and targets for tests, by hand and at random. Nothing here is part of nsim itself.

// A failure to build a network fails the test.
#![allow(clippy::unwrap_used)]

pub mod kinds;

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use nsim_files::lower::lower;
use nsim_files::network::{Network, NetworkFile};
use nsim_files::target::load_target;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::diagnostic::SourceText;
use nsim_ir::base::fixed::{Decay, Delay, Refractory, SignMode, ThresholdMantissa, WeightBits, WeightExponent};
use nsim_ir::base::id::{ChannelId, ClassId, CompartmentId, PopulationId, ProjectionId, RuleId};
use nsim_ir::base::rng;
use nsim_ir::graph::{Graph, PerCompartment, Shape, Window};
use nsim_ir::hardware::{Chip, Target, TargetFile};
use nsim_ir::learning::{self, Change, Learning, LearningSemantics, Plastic, Rule, RuleText, TRACES, TraceSettings};
use nsim_ir::neurons::Port;
use nsim_ir::program::{self, Program};
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Neuron, Neurons, Parts, Population, Projection, Quantised, Reset, Units};
use nsim_ir::resource::{Limits, Resource};
use nsim_ir::spikes::Message;

/// A model from its text.
pub fn model(text: impl AsRef<str>) -> Network {
    let source = SourceText::new("m.ron", text.as_ref());
    Network::new(NetworkFile::parse(&source).unwrap(), source, BTreeMap::new()).unwrap()
}

/// The graph of a model's text.
pub fn graph(text: impl AsRef<str>) -> Graph {
    lower(&model(text)).unwrap()
}

/// Number of a test's cases to run: all where `NSIM_LONG` is 1, as in `.ci/nightly`, else two
/// thirds.
pub fn cases(all: u64) -> u64 {
    few_or_all((2 * all).div_ceil(3), all)
}

/// The second number where `NSIM_LONG` is 1, else the first.
pub fn few_or_all(few: u64, all: u64) -> u64 {
    if std::env::var_os("NSIM_LONG").is_some_and(|long| long == "1") { all } else { few }
}

/// Limits of a core of the shipped Loihi chip, with 16 synapse formats.
pub fn limits() -> Limits {
    static LIMITS: LazyLock<Limits> = LazyLock::new(|| {
        let shipped = load_target("loihi1-chip").unwrap();
        shipped.limits().clone().with(Resource::SynapseFormats, 16)
    });
    LIMITS.clone()
}

/// A board of Loihi chips with these limits.
pub fn target(chips_x: u32, chips_y: u32, limits: Limits) -> Target {
    let shipped = load_target("loihi1-chip").unwrap();
    let chip = Chip { limits, ..shipped.chip().clone() };
    let file = TargetFile {
        name: "test-board".to_string(),
        notes: String::new(),
        chip: chip.name.clone().into(),
        chips_x: chips_x.into(),
        chips_y: chips_y.into(),
        constants: Vec::new(),
        unit_power: None,
    };
    Target::new(&file, &SourceText::new("test.ron", ""), chip, shipped.constants().to_vec()).unwrap()
}

/// The format of 8-bit mixed weights.
pub fn plain_format() -> SynapseFormat {
    format(0, SignMode::Mixed, 8)
}

/// A synapse format without plasticity.
pub fn format(exponent: i64, sign: SignMode, bits: i64) -> SynapseFormat {
    let (exponent, bits) = (WeightExponent::new(exponent).unwrap(), WeightBits::new(bits).unwrap());
    SynapseFormat { exponent, sign, bits, port: Port::First, apart: None, rule: None }
}

/// Makes a projection plastic, by this rule; returns its id. Rows are in the order of sources.
pub fn make_plastic(parts: &mut Parts, projection: ProjectionId, rule: Rule) -> RuleId {
    let name = format!("{projection}");
    let rule = parts.rules.push(Learning { name, rule });
    let sources = parts.populations[parts.projections[projection].source].shape.len();
    let own = &mut parts.projections[projection];
    let rows = (0..own.connectivity.count(sources.into()) as u32).collect();
    own.format.rule = Some(rule);
    let (tags, delays) = (Default::default(), Default::default());
    own.plastic =
        Some(Arc::new(Plastic { rule, first_source: 0, rows, tags, delays, signals: [None; 3], reward: None }));
    rule
}

/// The network with random rules on most projections that may have one.
pub fn with_rules(mut network: Quantised, seed: u64) -> Quantised {
    for id in network.projections().ids() {
        let draw = |k, end| rng::below(end, seed, id.0.into(), k);
        let pick = |k, texts: [&str; 3]| {
            let text = texts[draw(k, 3) as usize];
            if text.is_empty() { Change::default() } else { learning::parse(text).unwrap() }
        };
        let changes = [
            pick(0, ["2^-2*x1*y0 - 2^-2*y1*x0", "u0*t*x2*w", ""]),
            pick(1, ["x0*y1", "", ""]),
            pick(2, ["y0*x2 - u0*d", "", ""]),
        ];
        let semantics = if draw(3, 2) == 0 { LearningSemantics::Lava } else { LearningSemantics::Silicon };
        let mut traces = <[TraceSettings; TRACES]>::default();
        traces[0].impulse.whole = draw(4, 2) as u8;
        let rule = Rule::new(RuleText { changes, epoch: 1, semantics, traces, ..RuleText::default() }).unwrap();
        let mut parts = network.parts().clone();
        if draw(5, 4) > 0 {
            make_plastic(&mut parts, id, rule);
        }
        network = Quantised::new(parts).unwrap_or(network);
    }
    network
}

/// Connectivity from a list of (target, weight) for each source.
pub fn sparse(lists: impl IntoIterator<Item = Vec<(u32, i16)>>) -> Connectivity {
    let (mut first, mut targets, mut weights) = (vec![0], Vec::new(), Vec::new());
    for list in lists {
        targets.extend(list.iter().map(|synapse| synapse.0));
        weights.extend(list.iter().map(|synapse| synapse.1));
        first.push(targets.len() as u64);
    }
    Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() }
}

/// Parameters of the silicon network's compartments.
pub fn neurons() -> Neurons {
    PerCompartment::Same(Neuron {
        du: Decay::new(1024).unwrap(),
        dv: Decay::new(128).unwrap(),
        vth: ThresholdMantissa::new(80).unwrap(),
        ..Neuron::PLAIN
    })
}

/// Builds a network population by population.
pub struct Builder {
    /// Parts of the network so far.
    pub parts: Parts,
    channels: u32,
    compartments: u32,
}

impl Default for Builder {
    fn default() -> Self {
        Builder::new()
    }
}

impl Builder {
    /// An empty builder.
    pub fn new() -> Self {
        let parts = Parts { name: "test".to_string(), ..Parts::default() };
        Builder { parts, channels: 0, compartments: 0 }
    }

    /// A builder with other semantics.
    pub fn with(semantics: Semantics) -> Self {
        let mut builder = Builder::new();
        builder.parts.semantics = semantics;
        builder
    }

    fn add(&mut self, name: &str, shape: Shape, units: Units) -> PopulationId {
        self.parts.populations.push(Population { name: name.to_string(), shape, units, message: Message::Spike })
    }

    /// Adds an input population of this shape.
    pub fn input_shape(&mut self, name: &str, shape: Shape) -> PopulationId {
        let units = Units::Input(ChannelId(self.channels));
        self.channels += shape.len();
        self.add(name, shape, units)
    }

    /// Adds an input population with this number of channels.
    pub fn input(&mut self, name: &str, channels: u32) -> PopulationId {
        self.input_shape(name, Shape::Line(channels))
    }

    /// Adds compartments that are held before `start_step`; the last population is the output.
    fn compartments(&mut self, name: &str, shape: Shape, neurons: Neurons, start_step: u32) -> PopulationId {
        let units = Units::Compartments { first: CompartmentId(self.compartments), neurons, start_step };
        self.compartments += shape.len();
        self.parts.output = self.add(name, shape, units);
        self.parts.output
    }

    /// Adds compartments with these parameters.
    pub fn loihi_with(&mut self, name: &str, shape: Shape, neurons: Neurons) -> PopulationId {
        self.compartments(name, shape, neurons, 0)
    }

    /// Adds compartments with parameters of their own, held before `start_step`.
    pub fn each(&mut self, name: &str, shape: Shape, neurons: &[Neuron], start_step: u32) -> PopulationId {
        assert_eq!(shape.len() as usize, neurons.len());
        self.compartments(name, shape, PerCompartment::Each(neurons.to_vec()), start_step)
    }

    /// Adds this number of compartments with the parameters of [`neurons`].
    pub fn loihi(&mut self, name: &str, compartments: u32) -> PopulationId {
        self.loihi_with(name, Shape::Line(compartments), neurons())
    }

    /// Adds a projection.
    pub fn connect(
        &mut self,
        source: PopulationId,
        target: PopulationId,
        format: SynapseFormat,
        delay: i64,
        connectivity: Connectivity,
    ) {
        let name = |id| &self.parts.populations[id].name;
        let name = format!("{} -> {}", name(source), name(target));
        let delay = Delay::new(delay).unwrap();
        self.parts.projections.push(Projection { name, source, target, format, delay, connectivity, plastic: None });
    }

    /// Adds a dense projection of plain weights `f(source, target)`.
    pub fn dense(&mut self, source: PopulationId, target: PopulationId, f: impl Fn(u32, u32) -> i16) {
        let size = |id: PopulationId| self.parts.populations[id].shape.len();
        let (sources, targets) = (size(source), size(target));
        let weights: Arc<[i16]> =
            (0..sources).flat_map(|s| (0..targets).map(move |t| (s, t))).map(|(s, t)| f(s, t)).collect();
        self.connect(source, target, plain_format(), 0, Connectivity::Dense { targets, weights });
    }

    /// Adds a dense projection of plain weights `[target][source]`, the order of model files.
    pub fn matrix(&mut self, source: PopulationId, target: PopulationId, delay: i64, weights: &[i64]) {
        let size = |id: PopulationId| self.parts.populations[id].shape.len() as usize;
        let (sources, targets) = (size(source), size(target));
        assert_eq!(weights.len(), sources * targets);
        let by_source = (0..sources).flat_map(|s| (0..targets).map(move |t| weights[t * sources + s] as i16)).collect();
        let connectivity = Connectivity::Dense { targets: targets as u32, weights: by_source };
        self.connect(source, target, plain_format(), delay, connectivity);
    }

    /// Resets every population periodically.
    pub fn reset(&mut self, interval: u32, offset: u32) {
        self.parts.reset = Some(Reset { interval, offset });
    }

    /// Adds a random projection of plain weights.
    pub fn random(&mut self, source: PopulationId, target: PopulationId, fan_out: u32, seed: u64) {
        let targets = self.parts.populations[target].shape.len();
        let random = Connectivity::Random { targets, fan_out, low: -64, high: 64, step: 2, seed, first_source: 0 };
        self.connect(source, target, plain_format(), 0, random);
    }

    /// The network.
    pub fn build(self) -> Quantised {
        Quantised::new(self.parts).unwrap()
    }
}

/// The shape of the VT-SNN slip network: 156 -> 50 and `vision` -> 10, both -> 2, all dense.
pub fn slip(vision: u32) -> Quantised {
    let mut builder = Builder::new();
    let (tactile, seen) = (builder.input("tactile", 156), builder.input("vision", vision));
    let (touch, sight, out) = (builder.loihi("touch", 50), builder.loihi("sight", 10), builder.loihi("out", 2));
    for (source, target) in [(tactile, touch), (seen, sight), (touch, out), (sight, out)] {
        builder.dense(source, target, |s, t| ((s * 7 + t * 3) % 100) as i16 * 2 - 100);
    }
    builder.build()
}

/// A stream of random numbers, from a seed or from the bytes of a fuzzer.
pub struct Draw {
    source: Source,
    drawn: u64,
}

enum Source {
    Seed(u64),
    Bytes(Vec<u8>),
}

impl Draw {
    /// The stream of a seed at its beginning.
    pub fn new(seed: u64) -> Self {
        Draw { source: Source::Seed(seed), drawn: 0 }
    }

    /// The stream of these bytes, then the least number of each range.
    pub fn of_bytes(bytes: &[u8]) -> Self {
        Draw { source: Source::Bytes(bytes.to_vec()), drawn: 0 }
    }

    /// A number in `low..=high`.
    pub fn from(&mut self, low: i64, high: i64) -> i64 {
        let size = (high - low + 1) as u64;
        let number = match &self.source {
            Source::Seed(seed) => rng::below(size, *seed, 0, self.drawn + 1),
            Source::Bytes(bytes) => {
                // As few bytes as hold the range, so that a fuzzer changes one number at a time.
                let width = (64 - (size - 1).leading_zeros()).div_ceil(8) as usize;
                let taken = bytes.iter().skip(self.drawn as usize).take(width);
                self.drawn += width.saturating_sub(1) as u64;
                taken.fold(0, |number, &byte| number << 8 | u64::from(byte)) % size
            }
        };
        self.drawn += 1;
        low + number as i64
    }

    /// True with this probability.
    pub fn chance(&mut self, percent: i64) -> bool {
        self.from(0, 99) < percent
    }

    /// One of these items; each is equally likely.
    pub fn one_of<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.from(0, items.len() as i64 - 1) as usize]
    }

    /// A weight of a format.
    pub fn weight(&mut self, format: SynapseFormat) -> i16 {
        let (low, high) = format.sign.range(format.bits);
        let step = format.sign.step(format.bits);
        self.from((low / step).into(), (high / step).into()) as i16 * step
    }
}

/// The parts of a program with a class for each core.
pub fn without_classes(program: &Program) -> program::Parts {
    let mut parts = program.parts().clone();
    parts.classes = parts.cores.ids().map(|core| program.class_of(core).clone()).collect();
    (0..).map(ClassId).zip(parts.cores.as_mut_slice()).for_each(|(class, image)| image.class = class);
    parts
}

/// A network of a few populations with every kind of projection, delays, formats and parameters.
pub fn random_network(seed: u64) -> Quantised {
    let mut draw = Draw::new(seed);
    let mut builder = Builder::new();
    let shape = |draw: &mut Draw| match draw.chance(50) {
        true => Shape::Line(draw.from(1, 40) as u32),
        false => Shape::Volume(2, draw.from(2, 4) as u32, draw.from(2, 4) as u32),
    };
    let mut all: Vec<(PopulationId, Shape)> = Vec::new();
    let inputs = draw.from(1, 2);
    for k in 0..inputs {
        let shape = shape(&mut draw);
        all.push((builder.input_shape(&format!("in{k}"), shape), shape));
    }
    for k in 0..draw.from(1, 4) {
        let shape = shape(&mut draw);
        let mut neuron = || Neuron {
            du: Decay::new(draw.one_of(&[0, 1024, 4096])).unwrap(),
            vth: ThresholdMantissa::new(draw.one_of(&[80, 100])).unwrap(),
            refractory: Refractory::new(draw.one_of(&[1, 2])).unwrap(),
            ..neurons().get(0)
        };
        let neurons = match shape.len() {
            n if n.is_multiple_of(2) => PerCompartment::Same(neuron()),
            n => PerCompartment::Each((0..n).map(|_| neuron()).collect()),
        };
        all.push((builder.loihi_with(&format!("pop{k}"), shape, neurons), shape));
    }
    for _ in 0..draw.from(2, 7) {
        let (source, from) = draw.one_of(&all);
        let (target, to) = draw.one_of(&all[inputs as usize..]);
        let sign = draw.one_of(&[SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory]);
        let format = format(draw.from(-2, 1), sign, draw.one_of(&[8, 8, 6, 4]));
        let delay = draw.one_of(&[0, 0, 0, 1, 3]);
        let connectivity = random_connectivity(&mut draw, format, from, to);
        builder.connect(source, target, format, delay, connectivity);
    }
    builder.build()
}

fn random_connectivity(draw: &mut Draw, format: SynapseFormat, from: Shape, to: Shape) -> Connectivity {
    let (sources, targets) = (from.len(), to.len());
    if let (Some(source), Some(target)) = (from.volume(), to.volume())
        && draw.chance(50)
    {
        let window = Window {
            source,
            target,
            kernel: (2, 2),
            stride: (draw.from(1, 2) as u32, 1),
            padding: (draw.from(0, 1) as u32, 1),
            dilation: (1, draw.from(1, 2) as u32),
            groups: draw.from(1, 2) as u32,
        };
        if draw.chance(50) {
            return Connectivity::SumPool2d { window: Window { groups: 1, ..window }, weight: draw.weight(format) };
        }
        let size = target.0 * source.0 / window.groups * 4;
        return Connectivity::Conv2d { window, kernel: (0..size).map(|_| draw.weight(format)).collect() };
    }
    match draw.from(0, 2) {
        0 => Connectivity::Dense { targets, weights: (0..sources * targets).map(|_| draw.weight(format)).collect() },
        1 => {
            let mut synapse = |target| (draw.from(0, 2) == 0).then(|| (target, draw.weight(format)));
            sparse((0..sources).map(|_| (0..targets).filter_map(&mut synapse).collect()))
        }
        _ => {
            let (low, high) = format.sign.range(format.bits);
            let (fan_out, seed) = (draw.from(0, 7) as u32, draw.from(0, 999) as u64);
            let step = format.sign.step(format.bits);
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source: 3 }
        }
    }
}
