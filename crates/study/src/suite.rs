//! Networks on which mappings are compared, as code.
//!
//! Input: a name. Output: the network in integers, a short input, and the board. Sizes follow
//! published networks where there are any. Weights are random (`base::rng`), because placement does
//! not depend on them.
//!
//! - `vtsnn-slip`, `container-tactile`: 156 / 3,150 -> 50 / 10 -> 2 and 78 -> 32 -> 20, dense;
//!   `vtsnn-slip-x32`: 32 copies of the first, which share nothing.
//! - `pilotnet`: Bojarski et al. 2016: 3 @ 66 x 200, convolutions to 24 @ 31 x 98, 36 @ 14 x 47, 48
//!   @ 5 x 22 (5 x 5, stride 2), 64 @ 3 x 20, 64 @ 1 x 18 (3 x 3), then 100, 50, 10, 1.
//! - `dvs-gesture`: SANA-FE `snn/dvs.yaml`: 32 x 32, 16 @ 15 x 15, 32 @ 13 x 13, 64 @ 11 x 11, 11 @
//!   9 x 9, 11.
//! - `lenet`: LeCun et al. 1998: 28 x 28, 6 @ 28 x 28, pooled, 16 @ 10 x 10, pooled, 120, 84, 10.
//! - `cifar-conv`: 4 @ 32 x 32, convolutions to 64 @ 15 x 15 (3 x 3, stride 2), 72 @ 13 x 13 (3 x
//!   3), 256 @ 6 x 6 (3 x 3, stride 2), 256 @ 6 x 6 and 64 @ 6 x 6 (1 x 1), then 100: of the size
//!   of networks that nengo-loihi put on chips.
//! - `conv-33x100`: 3 @ 33 x 100, 3 x 3 convolutions with stride 2 to 24 @ 16 x 49, 36 @ 7 x 24 and
//!   64 @ 3 x 11, one more to 64 @ 1 x 9, then 200, 100, 50, 10, 1.
//! - `mlp-3x1024`: 784, three layers of 1,024, 10.
//! - `conv-10m`: the network of [`crate::networks`].
//! - `random-N`: N compartments, each with a driving channel and 64 random synapses
//!   ([`crate::networks::random`]).
//! - `small-world-N`: N compartments on a square sheet, numbered row by row, each joined to the 36
//!   nearest; one synapse in fifty goes to any other instead (Watts & Strogatz 1998, whose small
//!   worlds have between one in a hundred and one in ten, on a sheet instead of a ring).
//! - `fly-140k`: as many compartments as the connectome of a fly (FlyWire, Dorkenwald et al. 2024)
//!   and some 14 million weighted connections. Degrees have heavy tails: out-degrees are sampled
//!   from a Pareto distribution with exponent 1.6 from 40 to 10,000, in-degrees fall as 1 / sqrt(j)
//!   and are 4,000 at most, because a core has 4,096 input axons. Delays are 18 steps, 1.8 ms of
//!   0.1 ms as in the model of Shiu et al. 2024. Mapped with relays.
//! - `scale-free-N`: 32 synapses each to compartment j with a probability that falls as 1 /
//!   sqrt(j), as hubs of preferential attachment do (Barabasi & Albert 1999); no compartment takes
//!   more than 2,000, so that its input axons fit a core.

use crate::networks::builder::Builder;
use crate::networks::layers::Layers;
use crate::networks::{
    BenchNetwork, BuildError, Random, conv_10m, dvs_gesture, lava_pilotnet, random, vtsnn, with_spikes,
};
use nsim_ir::base::rng;
use nsim_ir::quantised::connectivity::Connectivity;

/// Steps of input: enough for spikes to reach every layer.
pub const STEPS: u32 = 16;
/// Reciprocal of the probability that a channel spikes in a step.
const RARE: u64 = 20;

/// A network to map.
#[derive(Debug, Clone)]
pub struct SuiteCase {
    /// Its name in results.
    pub name: &'static str,
    /// Copies of the network that are mapped together.
    pub copies: u32,
    /// Whether it is skipped unless all networks are requested.
    pub large: bool,
    /// Whether it is mapped with relays.
    pub relays: bool,
    make: fn(&'static str) -> Result<BenchNetwork, BuildError>,
}

impl SuiteCase {
    /// The network with its input.
    ///
    /// # Errors
    /// [`BuildError`] never in practice; the tests build all.
    pub fn build(&self) -> Result<BenchNetwork, BuildError> {
        (self.make)(self.name)
    }
}

/// All networks, small ones first.
pub fn cases() -> Vec<SuiteCase> {
    let case = |name, make| SuiteCase { name, copies: 1, large: false, relays: false, make };
    vec![
        case("vtsnn-slip", slip),
        case("container-tactile", container),
        SuiteCase { copies: 32, ..case("vtsnn-slip-x32", slip) },
        case("lenet", lenet),
        case("dvs-gesture", |name| bench(dvs_gesture(name)?, "nahuku-32")),
        case("cifar-conv", cifar),
        case("conv-33x100", |name| bench(lava_pilotnet(name)?, "nahuku-32")),
        case("mlp-3x1024", perceptron),
        case("random-1k", |name| recurrent(name, 1_000)),
        case("small-world-1k", |name| small_world(name, 32)),
        case("scale-free-1k", |name| scale_free(name, 1_000)),
        case("random-10k", |name| recurrent(name, 10_000)),
        case("small-world-10k", |name| small_world(name, 100)),
        case("scale-free-10k", |name| scale_free(name, 10_000)),
        case("pilotnet", pilotnet),
        case("random-100k", |name| recurrent(name, 100_000)),
        case("small-world-100k", |name| small_world(name, 316)),
        case("scale-free-100k", |name| scale_free(name, 100_000)),
        SuiteCase { large: true, ..case("random-1m", |name| recurrent(name, 1_000_000)) },
        SuiteCase { large: true, ..case("small-world-1m", |name| small_world(name, 1_000)) },
        SuiteCase { large: true, ..case("scale-free-1m", |name| scale_free(name, 1_000_000)) },
        SuiteCase { large: true, ..case("conv-10m", |name| bench(conv_10m(name)?, "pohoiki-springs")) },
        SuiteCase { large: true, relays: true, ..case("fly-140k", fly) },
    ]
}

fn bench(net: Builder, target: &'static str) -> Result<BenchNetwork, BuildError> {
    with_spikes(net, STEPS, 1, RARE, target)
}

fn slip(name: &'static str) -> Result<BenchNetwork, BuildError> {
    bench(vtsnn(name)?, "nahuku-32")
}

fn container(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let mut net = Builder::new(name);
    let touch = net.input("touch", 78);
    let hidden = net.loihi("hidden", 32, 80, 1)?;
    let out = net.loihi("out", 20, 80, 1)?;
    net.dense((touch, hidden), -16, 32, 1)?;
    net.dense((hidden, out), -32, 48, 2)?;
    bench(net, "nahuku-32")
}

fn lenet(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let mut layers = Layers::new(name, (1, 28, 28));
    layers.convolve(&[(6, 5, 1, 2)])?;
    layers.pool(2)?;
    layers.convolve(&[(16, 5, 1, 0)])?;
    layers.pool(2)?;
    layers.dense(&[120, 84, 10])?;
    bench(layers.net, "nahuku-32")
}

fn cifar(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let mut layers = Layers::new(name, (4, 32, 32));
    layers.convolve(&[(64, 3, 2, 0), (72, 3, 1, 0), (256, 3, 2, 0), (256, 1, 1, 0), (64, 1, 1, 0)])?;
    layers.dense(&[100])?;
    bench(layers.net, "nahuku-32")
}

fn pilotnet(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let mut layers = Layers::new(name, (3, 66, 200));
    layers.convolve(&[(24, 5, 2, 0), (36, 5, 2, 0), (48, 5, 2, 0), (64, 3, 1, 0), (64, 3, 1, 0)])?;
    layers.dense(&[100, 50, 10, 1])?;
    bench(layers.net, "pohoiki-springs")
}

fn perceptron(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let mut layers = Layers::new(name, (784, 1, 1));
    layers.dense(&[1024, 1024, 1024, 10])?;
    bench(layers.net, "nahuku-32")
}

fn recurrent(name: &'static str, compartments: u32) -> Result<BenchNetwork, BuildError> {
    let driven = compartments / 50;
    random(name, Random { compartments, background: 0, driven, period: STEPS }, &[0])
}

/// Compartments with a driving channel each and listed synapses.
fn listed(
    name: &'static str,
    compartments: u32,
    delay: i64,
    targets_of: impl Fn(u32, &mut Vec<u32>),
) -> Result<BenchNetwork, BuildError> {
    let (mut net, _, neurons) = Builder::driven(name, compartments)?;
    let (mut first, mut all, mut own) = (vec![0u64], Vec::new(), Vec::new());
    for source in 0..compartments {
        own.clear();
        targets_of(source, &mut own);
        own.sort_unstable();
        own.dedup();
        all.extend_from_slice(&own);
        first.push(all.len() as u64);
    }
    fn weight(index: u64) -> i16 {
        -16 + 2 * rng::below(17, 6, index, 0) as i16
    }
    let weights = (0..all.len() as u64).map(weight).collect();
    let synapses = Connectivity::Sparse { first: first.into(), targets: all.into(), weights };
    net.connect(neurons, neurons, 0, synapses)?;
    net.delay_last(delay)?;
    bench(net, if compartments > 50_000 { "pohoiki-springs" } else { "nahuku-32" })
}

/// Synapses of a compartment of scale-free networks; small worlds have 4 more.
const FAN_OUT: u32 = 32;

fn small_world(name: &'static str, side: u32) -> Result<BenchNetwork, BuildError> {
    let n = side * side;
    // The 36 places within a distance of sqrt(10), without the compartment itself.
    let near: Vec<(i64, i64)> = (-3..=3i64)
        .flat_map(|y| (-3..=3i64).map(move |x| (y, x)))
        .filter(|&(y, x)| (y, x) != (0, 0) && y * y + x * x <= 10)
        .take(FAN_OUT as usize + 4)
        .collect();
    listed(name, n, 0, |source, targets| {
        let (y, x) = (i64::from(source / side), i64::from(source % side));
        for (k, &(dy, dx)) in near.iter().enumerate() {
            let draw = |n: u32, what| rng::below(u64::from(n), 7, u64::from(source), 2 * k as u64 + what) as u32;
            if draw(50, 0) == 0 {
                targets.push(draw(n, 1));
            } else if (0..i64::from(side)).contains(&(y + dy)) && (0..i64::from(side)).contains(&(x + dx)) {
                targets.push(((y + dy) * i64::from(side) + x + dx) as u32);
            }
        }
    })
}

/// A network whose in-degrees fall as 1 / sqrt(rank), with at most `most_in` synapses into a
/// compartment; `target_of` maps a rank to its compartment.
fn hubs(
    name: &'static str,
    n: u32,
    most_in: u32,
    delay: i64,
    seed: u64,
    fan_out: impl Fn(u64) -> u64,
    target_of: fn(u64) -> u64,
) -> Result<BenchNetwork, BuildError> {
    let taken = std::cell::RefCell::new(vec![0u32; n as usize]);
    listed(name, n, delay, |source, targets| {
        let mut taken = taken.borrow_mut();
        for k in 0..fan_out(source.into()) {
            // The square of a uniform number of [0, 1) is below x with a probability of sqrt(x).
            let even = rng::unit(seed, u64::from(source), k);
            let rank = (even * even * f64::from(n)) as u64;
            let mut target = (target_of(rank) % u64::from(n)) as u32;
            while taken[target as usize] >= most_in {
                target = (target + 1) % n;
            }
            taken[target as usize] += 1;
            targets.push(target);
        }
    })
}

fn scale_free(name: &'static str, n: u32) -> Result<BenchNetwork, BuildError> {
    hubs(name, n, 2_000, 0, 8, |_| u64::from(FAN_OUT), |rank| rank)
}

fn fly(name: &'static str) -> Result<BenchNetwork, BuildError> {
    let pareto = |source| (40.0 * (1.0 - rng::unit(12, source, 0)).powf(-1.0 / 1.6)).min(10_000.0) as u64;
    // Which compartments have many inputs is independent of their number of outputs.
    hubs(name, 140_000, 4_000, 18, 13, pareto, |rank| rank * 99_991)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_golden::Golden;
    use nsim_ir::spikes::Engine;

    #[test]
    fn every_network_can_be_built_and_its_layers_fire() {
        for case in cases().into_iter().filter(|case| !case.large && !case.name.contains("100k")) {
            let bench = case.build().unwrap();
            let mut engine = Golden::new(&bench.network);
            engine.begin(STEPS);
            (0..STEPS).for_each(|t| engine.step(bench.period.input(t)));
            assert!(engine.totals().spikes > 0, "{}", case.name);
        }
    }

    #[test]
    fn sizes_are_the_published_ones() {
        let size = |name: &str| {
            let case = cases().into_iter().find(|case| case.name == name).unwrap();
            let network = case.build().unwrap().network;
            (network.channels(), network.compartments(), network.synapses())
        };
        assert_eq!(size("lenet").1, 6 * 784 + 6 * 196 + 16 * 100 + 16 * 25 + 120 + 84 + 10);
        let gesture = 15 * 15 * 16 + 13 * 13 * 32 + 11 * 11 * 64 + 9 * 9 * 11 + 11;
        assert_eq!((size("dvs-gesture").0, size("dvs-gesture").1), (1_024, gesture));
        assert_eq!(size("mlp-3x1024").2, 784 * 1024 + 2 * 1024 * 1024 + 10 * 1024);
        let (channels, compartments, synapses) = size("small-world-1k");
        assert_eq!((channels, compartments), (1_024, 1_024));
        assert!((25 * 1_024..37 * 1_024).contains(&synapses), "{synapses}");
    }
}
