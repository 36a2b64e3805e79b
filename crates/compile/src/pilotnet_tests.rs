//! PilotNet LIF on Loihi 2: nsim's resource counts of a core, compared with the cores that Intel's
//! compiler took.
//!
//! The notebook of lava-dl d825ac5 (`netx/pilotnet_snn`) prints compartments a core and cores for
//! each layer, 74 cores together. All convolutions are cut into stripes of the whole height and all
//! channels, whose width is a power of two. Weights are random: 10 % of the weights of kernels are
//! not 0, and 35 % in the dense layer (7,253 of 20,480 on its first core).

use crate::{Front, Options, map};
use nsim_ir::base::id::{CompartmentId, Id, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::{Shape, Window};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_partition::resources::axon_sharing::Places;
use nsim_partition::resources::closed_form::Layer;
use nsim_partition::resources::formats::Formats;
use nsim_testing::{Builder, neurons, plain_format};

/// Layers over space: shape, stride and padding of the incoming convolution, and compartments a
/// core and cores as printed.
type Printed = ((u32, u32, u32), (u32, u32), (u32, u32), (u32, u32));
const SPATIAL: [Printed; 6] = [
    ((3, 66, 200), (1, 1), (0, 0), (3_168, 13)),
    ((24, 32, 99), (2, 2), (0, 0), (3_072, 25)),
    ((36, 15, 49), (2, 2), (0, 0), (2_160, 13)),
    ((48, 7, 24), (2, 2), (0, 0), (2_688, 3)),
    ((64, 4, 22), (2, 1), (1, 0), (2_048, 3)),
    ((64, 2, 20), (1, 1), (0, 0), (2_048, 2)),
];
/// Dense layers; the first took 12 cores, the others one each.
const DENSE: [u32; 4] = [100, 50, 10, 1];
/// All cores as printed.
const PRINTED: u32 = 74;

fn pilotnet() -> Quantised {
    let mut net = Builder::new();
    let volume = |(c, h, w)| Shape::Volume(c, h, w);
    // `stored` thousandths of the weights are not 0.
    let weight = |stored: u64, at: u64| match rng::below(1_000, 5, stored, 2 * at) < stored {
        true => 2 * (1 + rng::below(60, 5, stored, 2 * at + 1) as i16),
        false => 0,
    };
    let mut source = (SPATIAL[0].0, net.input_shape("frame", volume(SPATIAL[0].0)));
    for (number, &(target, stride, padding, _)) in SPATIAL.iter().enumerate() {
        let layer = net.loihi_with(&format!("layer{number}"), volume(target), neurons());
        // The first layer receives one channel each; the others a convolution of 3 by 3.
        let (kernel, groups) = if number == 0 { ((1, 1), 3) } else { ((3, 3), 1) };
        let window = Window { source: source.0, target, kernel, stride, padding, dilation: (1, 1), groups };
        let weights = u64::from(target.0 * source.0.0 / groups * kernel.0 * kernel.1);
        let stored = if number == 0 { 1_000 } else { 100 };
        let kernel = (0..weights).map(|at| weight(stored, at)).collect();
        net.connect((source.1, layer), plain_format(), 0, Connectivity::Conv2d { window, kernel });
        source = (target, layer);
    }
    let mut source = source.1;
    for units in DENSE {
        let layer = net.loihi(&format!("dense{units}"), units);
        net.dense(source, layer, |s, t| weight(350, u64::from(s * units + t)));
        source = layer;
    }
    net.build()
}

/// Stripes of the greatest power of two that fits equal the stripes of Intel's compiler, layer by
/// layer. With nsim's own cores of the dense layers they total within 20 % of its 74 cores. The
/// sizes are 192 KiB, 24 bytes of state and eight accumulators of 24 bits as on Loihi 1. None was
/// fitted to these figures, but the rule of stripes was read off them. nsim cuts anywhere, so it
/// takes fewer cores.
#[test]
fn stripes_of_the_greatest_width_that_fits_are_those_of_intel_s_compiler() {
    let network = pilotnet();
    let board = nsim_files::target::load_target("oheo-gulch").unwrap();
    let (formats, limits) = (Formats::for_network(&network), board.limits());
    let places = Places::for_network(&network, limits);
    let front = Front::from(network.clone()).cut();
    let mapped = map(front, &board, &Options::default(), &Rates::assumed(0.01)).unwrap();
    let is_dense = |held: &Vec<CompartmentId>| network.population_of(held[0]).0.index() > SPATIAL.len();
    let own = mapped.partition.cores() as u32;
    let mut striped = mapped.partition.members().iter().filter(|held| is_dense(held)).count() as u32;
    for (number, &((c, h, w), .., (held, cores))) in SPATIAL.iter().enumerate() {
        let layer = Layer::for_population(&network, PopulationId(number as u32 + 1), &formats, &places).unwrap();
        let fits = |width: &u32| !layer.middle((c, h, *width), &formats, limits).exceeds(limits);
        let widths = (0..u32::BITS).map(|bit| 1 << bit).take_while(|&width| width <= w);
        let width = widths.filter(fits).last().unwrap();
        assert_eq!((width * c * h, w.div_ceil(width)), (held, cores), "layer {number}");
        striped += cores;
    }
    println!("{striped} cores in stripes, {own} in nsim's own cuts, {PRINTED} printed");
    assert!((f64::from(striped) / f64::from(PRINTED) - 1.0).abs() < 0.2 && own < striped, "{striped} and {own}");
    let pool = &limits.pools[0];
    assert!(mapped.partition.usage().iter().all(|used| pool.need(&used.of) <= pool.limit));
}
