//! Random small networks over the whole model language: every kind of projection, sign, exponent,
//! delay, field and semantics.

use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::fixed::{
    Decay, MessageBits, Payload, Refractory, SignMode, ThresholdMantissa, VmaxExponent, VminExponent, WeightBits,
    WeightExponent,
};
use nsim::ir::base::id::{ChannelId, IdVec, PopulationId};
use nsim::ir::graph::{PerCompartment, Shape, Window};
use nsim::ir::mapping::{MappedCore, MappingFile, Run};
use nsim::ir::neurons::{Emits, NeuronKind, ParameterField, Port, Role, Storage};
use nsim::ir::placement::Mesh;
use nsim::ir::quantised::connectivity::{Connectivity, SeparateSum, SynapseFormat};
use nsim::ir::quantised::{Child, Neuron, Quantised, Units};
use nsim::ir::spikes::{Message, Sample};
pub use nsim_testing::Draw;
use nsim_testing::sparse;

use super::{Builder, biased, neuron};

fn decay(draw: &mut Draw) -> i64 {
    match draw.from(0, 5) {
        0 => draw.one_of(&[0, 1, 2, 4095, 4096]),
        _ => draw.from(0, 4096),
    }
}

fn random_neuron(draw: &mut Draw, semantics: Semantics) -> Neuron {
    let (du, dv) = (decay(draw), decay(draw));
    let vth = match draw.from(0, 9) {
        0 => draw.from(0, 2),
        1 => draw.from(0, 131_071),
        _ => draw.from(10, 400),
    };
    let refractory = match draw.from(0, 3) {
        0 => draw.one_of(&[0, 2, 5, 63]),
        _ => 1,
    };
    // An integrate-and-fire compartment has the chip's arithmetic only.
    let mut neuron = match semantics == Semantics::Hardware && draw.chance(20) {
        true => Neuron { kind: NeuronKind::If, ..neuron(4096, 0, vth, refractory) },
        false => neuron(du, dv, vth, refractory),
    };
    if draw.chance(25) {
        neuron = biased(neuron, draw.from(-4096, 4095), draw.from(0, 7));
    }
    if draw.chance(15) {
        neuron.vmin = VminExponent::new(draw.from(0, 23)).unwrap();
        neuron.vmax = VmaxExponent::new(draw.from(0, 7)).unwrap();
    }
    neuron
}

fn random_shape(draw: &mut Draw) -> Shape {
    match draw.from(0, 2) {
        0 => Shape::Volume(draw.from(1, 3) as u32, draw.from(1, 6) as u32, draw.from(1, 6) as u32),
        _ => Shape::Line(draw.from(1, 40) as u32),
    }
}

fn random_format(draw: &mut Draw) -> SynapseFormat {
    let sign = draw.one_of(&[SignMode::Mixed, SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory]);
    let exponent = if draw.chance(60) { 0 } else { draw.from(-8, 7) };
    let bits = if draw.chance(70) { 8 } else { draw.one_of(&[2, 3, 4, 5, 6]) };
    SynapseFormat { bits: WeightBits::new(bits).unwrap(), ..super::format(sign, exponent) }
}

/// Windows that map the source to the target, if any is found.
fn window(draw: &mut Draw, source: Shape, target: Shape, pool: bool) -> Option<Window> {
    let (source, target) = (source.volume()?, target.volume()?);
    let mut fitting = Vec::new();
    let size =
        |s: u32, k: u32, stride: u32, p: u32, d: u32| (s + 2 * p).checked_sub(d * (k - 1) + 1).map(|r| r / stride + 1);
    for kernel in 1..=3 {
        for stride in 1..=3 {
            for padding in 0..=2 {
                for dilation in 1..=if pool { 1 } else { 2 } {
                    let side = |s| size(s, kernel, stride, padding, dilation);
                    if side(source.1) == Some(target.1) && side(source.2) == Some(target.2) {
                        fitting.push((kernel, stride, padding, dilation));
                    }
                }
            }
        }
    }
    if fitting.is_empty() || (pool && source.0 != target.0) {
        return None;
    }
    let (k, s, p, d) = draw.one_of(&fitting);
    let groups = match pool {
        true => source.0,
        false => {
            let dividing: Vec<u32> = (1..=3).filter(|g| source.0 % g == 0 && target.0 % g == 0).collect();
            draw.one_of(&dividing)
        }
    };
    Some(Window { source, target, kernel: (k, k), stride: (s, s), padding: (p, p), dilation: (d, d), groups })
}

fn connectivity(draw: &mut Draw, format: SynapseFormat, source: Shape, target: Shape) -> Connectivity {
    let (sources, targets) = (source.len(), target.len());
    if let Some(window) = window(draw, source, target, false).filter(|_| draw.chance(60)) {
        let size = window.target.0 * window.source.0 / window.groups * window.kernel.0 * window.kernel.1;
        return Connectivity::Conv2d { window, kernel: (0..size).map(|_| draw.weight(format)).collect() };
    }
    if let Some(window) = window(draw, source, target, true).filter(|_| draw.chance(80)) {
        return Connectivity::SumPool2d { window, weight: draw.weight(format) };
    }
    match draw.from(0, 2) {
        0 => Connectivity::Dense { targets, weights: (0..sources * targets).map(|_| draw.weight(format)).collect() },
        1 => {
            let list = |_| {
                let mut reached: Vec<u32> =
                    (0..draw.from(0, 6)).map(|_| draw.from(0, i64::from(targets) - 1) as u32).collect();
                reached.sort_unstable();
                reached.into_iter().map(|target| (target, draw.weight(format))).collect()
            };
            sparse((0..sources).map(list))
        }
        _ => {
            let (a, b) = (draw.weight(format), draw.weight(format));
            Connectivity::Random {
                targets,
                fan_out: draw.from(0, 8) as u32,
                low: a.min(b),
                high: a.max(b),
                step: format.sign.step(format.bits),
                seed: draw.from(0, 1 << 40) as u64,
                first_source: draw.from(0, 50) as u32,
            }
        }
    }
}

/// A network that depends on the seed only.
pub fn network(seed: u64) -> Quantised {
    drawn(&mut Draw::new(seed), 1)
}

/// A network with neurons of one to three compartments, each with input spikes.
pub fn joined(seed: u64) -> Quantised {
    drawn(&mut Draw::new(seed ^ 0x0c41d), 3)
}

/// A network whose neurons have `most` compartments at most.
pub fn drawn(draw: &mut Draw, most: usize) -> Quantised {
    let semantics = match most {
        1 => draw.one_of(&[Semantics::Hardware, Semantics::Hardware, Semantics::Lava, Semantics::Slayer]),
        _ => Semantics::Hardware,
    };
    let mut net = Builder::with(semantics);
    if most == 1 && draw.chance(20) {
        net.parts.threshold = ThresholdTest::Inclusive;
    }
    if draw.chance(20) {
        net.reset(draw.from(1, 20) as u32, draw.from(0, 5) as u32);
    }
    let mut shapes = Vec::new();
    let mut ids: Vec<PopulationId> = Vec::new();
    for _ in 0..draw.from(1, 2) {
        let shape = random_shape(draw);
        ids.push(net.input_shape(&format!("p{}", ids.len()), shape));
        shapes.push(shape);
    }
    let inputs = ids.len();
    for _ in 0..draw.from(1, 4) {
        let shape = random_shape(draw);
        let same = draw.chance(60).then(|| random_neuron(draw, semantics));
        let neurons: Vec<Neuron> =
            (0..shape.len()).map(|_| same.unwrap_or_else(|| random_neuron(draw, semantics))).collect();
        let start = if draw.chance(20) { draw.from(0, 12) as u32 } else { 0 };
        ids.push(net.each(&format!("p{}", ids.len()), shape, &neurons, start));
        shapes.push(shape);
        let parents = if most == 1 { 0 } else { draw.from(0, most as i64 - 1) };
        for _ in 0..parents {
            let child = ids[ids.len() - 1];
            let neurons: Vec<Neuron> = (0..shape.len()).map(|_| random_neuron(draw, semantics)).collect();
            let parent = net.each(&format!("p{}", ids.len()), shape, &neurons, start);
            net.parts.children.push(Child { population: child, parent, role: Role::Add });
            ids.push(parent);
            shapes.push(shape);
        }
    }
    for &Child { population, parent, .. } in &net.parts.children {
        for (id, most) in [(population, 1), (parent, 63)] {
            let Units::Compartments { neurons, .. } = &mut net.parts.populations[id].units else { continue };
            let allowed = |_, neuron: Neuron| {
                let refractory = Refractory::new(i64::from(neuron.refractory).min(most)).unwrap();
                Ok::<_, ()>(Neuron { kind: NeuronKind::Loihi, refractory, ..neuron })
            };
            *neurons = neurons.try_map(allowed).unwrap();
        }
    }
    // Every population of compartments has input; some twice, some from themselves or later ones.
    for target in inputs..ids.len() {
        for count in 0..draw.from(1, 3) {
            let source = match count {
                0 => draw.from(0, target as i64 - 1),
                _ => draw.from(0, ids.len() as i64 - 1),
            } as usize;
            let format = random_format(draw);
            let delay = match draw.from(0, 3) {
                0 => draw.one_of(&[1, 7, 8, 62]),
                _ => 0,
            };
            let connectivity = connectivity(draw, format, shapes[source], shapes[target]);
            net.connect(ids[source], ids[target], format, delay, connectivity);
        }
    }
    net.build()
}

/// A neuron of a kind with random parameters: small ones, which sums equal by chance, larger ones
/// with thresholds that are reached, or any within their ranges. Intervals are short enough to
/// pass.
fn of_kind(draw: &mut Draw, kind: NeuronKind) -> Neuron {
    let (threshold, other) = draw.one_of(&[(4, 4), (500, 1 << 16), (500, 1 << 16), (i64::MAX, i64::MAX)]);
    let value = |parameter: &ParameterField| {
        if parameter.field == Decay::FIELD {
            return decay(draw);
        }
        let most = match parameter.name {
            "reset_interval" => 30,
            _ if parameter.storage == Storage::Threshold => threshold,
            _ => other,
        };
        let low = parameter.field.low.max(-most);
        draw.from(low, parameter.field.high.min(most).max(low))
    };
    let values: Vec<i64> = kind.parameters().iter().map(value).collect();
    nsim::dynamics::neuron(kind, &values).unwrap()
}

/// A random network with populations of any kind, any messages of inputs, and any port of
/// projections to resonators.
pub fn mixed(seed: u64) -> Quantised {
    with_kinds(&network(seed), &mut Draw::new(seed ^ 0x10_412))
}

/// A network with other kinds, messages and ports.
pub fn with_kinds(network: &Quantised, draw: &mut Draw) -> Quantised {
    let mut parts = network.parts().clone();
    parts.semantics = Semantics::Hardware;
    let ids: Vec<PopulationId> = parts.populations.ids().collect();
    let mut kinds: IdVec<PopulationId, NeuronKind> = ids.iter().map(|_| NeuronKind::Loihi).collect();
    for id in ids {
        let population = &mut parts.populations[id];
        let units = population.shape.len();
        let payload = Message::Payload(Payload::new(draw.from(-300, 300)).unwrap());
        population.message = draw.one_of(&[Message::Spike, payload]);
        match &mut population.units {
            Units::Input(_) if draw.chance(50) => {
                let bits = MessageBits::new(draw.from(2, 24)).unwrap();
                population.message = Message::Value(bits);
            }
            Units::Compartments { neurons, .. } if draw.chance(20) => {
                let soft = |_, neuron| {
                    Ok::<_, ()>(Neuron { kind: NeuronKind::SoftReset, refractory: Refractory::ONE, ..neuron })
                };
                *neurons = neurons.try_map(soft).unwrap();
                kinds[id] = NeuronKind::SoftReset;
            }
            Units::Compartments { neurons, .. } if draw.chance(70) => {
                let kind = draw.one_of(&NeuronKind::ALL[3..]);
                kinds[id] = kind;
                let same = of_kind(draw, kind);
                *neurons = match draw.chance(50) {
                    true => PerCompartment::Same(same),
                    false => PerCompartment::Each((0..units).map(|_| of_kind(draw, kind)).collect()),
                };
                if kind.table().emits == Emits::Values {
                    // Without a width every message counts as 1.
                    let bits = MessageBits::new(draw.from(4, 32)).unwrap();
                    population.message = if draw.chance(85) { Message::Value(bits) } else { Message::Spike };
                }
            }
            _ => {}
        }
    }
    for projection in parts.projections.iter_mut() {
        let table = kinds[projection.target].table();
        if !table.registers && draw.chance(35) {
            projection.format.apart = Some(SeparateSum { number: draw.from(0, 3) as u8, wraps: draw.chance(50) });
            if draw.chance(50) {
                projection.format.exponent = WeightExponent::new(draw.from(-8, -1)).unwrap();
            }
        } else if !table.registers && projection.format.exponent < WeightExponent::ZERO {
            // Sums are in finer units, and shifted once.
            let lost = projection.format.exponent.get().unsigned_abs();
            projection.format.exponent = WeightExponent::ZERO;
            if let Units::Compartments { neurons, .. } = &mut parts.populations[projection.target].units {
                let shifted = |_, neuron| Ok::<_, ()>(Neuron { shift: lost, ..neuron });
                *neurons = neurons.try_map(shifted).unwrap();
            }
        }
        if table.ports == 2 && draw.chance(50) {
            projection.format.port = Port::Second;
        }
    }
    Quantised::new(parts).unwrap()
}

/// A sample for a network: bursts and silences.
pub fn sample(network: &Quantised, seed: u64) -> Sample {
    drawn_sample(network, &mut Draw::new(seed ^ 0x5eed))
}

/// As [`sample`], from these numbers.
pub fn drawn_sample(network: &Quantised, draw: &mut Draw) -> Sample {
    let steps = draw.from(1, 90) as u32;
    let mut events = Vec::new();
    let mut percent = 20;
    for step in 0..steps {
        if draw.chance(15) {
            percent = draw.one_of(&[0, 0, 2, 20, 60, 100]);
        }
        events
            .extend((0..network.channels()).filter(|_| draw.chance(percent)).map(|channel| (step, ChannelId(channel))));
    }
    Sample::new(steps, &events, None).unwrap()
}

/// A random sample with numbers, for a network of [`mixed`], and `silent` steps after it.
pub fn valued(network: &Quantised, seed: u64, silent: u32) -> Sample {
    with_values(&sample(network, seed), &mut Draw::new(seed ^ 0x77), silent)
}

/// A sample with numbers, and `silent` steps after it.
pub fn with_values(bare: &Sample, draw: &mut Draw, silent: u32) -> Sample {
    let events = (0..bare.steps()).flat_map(|t| bare.at(t).iter().map(move |&channel| (t, channel)));
    // Sums of small numbers equal small thresholds by chance.
    let most = draw.one_of(&[2, 3_000]);
    let events: Vec<_> = events.map(|(t, channel)| (t, channel, draw.from(-most, most) as i32)).collect();
    Sample::with_values(bare.steps() + silent, &events, None).unwrap()
}

/// A mapping that assigns the compartments to random cores in random order.
pub fn mapping(network: &Quantised, mesh: &Mesh, seed: u64) -> MappingFile {
    let draw = &mut Draw::new(seed ^ 0x3a99);
    let mut all: Vec<Run> = network
        .populations()
        .iter()
        .filter(|population| population.first_compartment().is_some())
        .flat_map(|p| (0..p.shape.len()).map(|first| Run { population: p.name.clone(), first, count: 1 }))
        .collect();
    for i in (1..all.len()).rev() {
        all.swap(i, draw.from(0, i as i64) as usize);
    }
    let cores = draw.from(1, 9.min(all.len() as i64)) as usize;
    let mut free: Vec<u32> = (0..mesh.cores()).collect();
    let cores = (0..cores)
        .map(|core| {
            let site = mesh.site(free.swap_remove(draw.from(0, free.len() as i64 - 1) as usize)).unwrap();
            let holds = all.iter().skip(core).step_by(cores).cloned().collect();
            MappedCore { chip: site.chip, x: site.x, y: site.y, core: site.core, holds }
        })
        .collect();
    MappingFile {
        model: network.parts().name.clone(),
        target: "loihi1-chip".to_string(),
        copies: 1,
        strategy: "random".to_string(),
        seed,
        pruned: None,
        cores,
        layers: Vec::new(),
        checksum: None,
    }
}

/// A chain of convolutions and poolings over a few channels, determined by the seed: strides, four
/// paddings, dilations and groups of all kinds, delays, recurrent layers, feedback from the next
/// layer.
pub fn convolutional(seed: u64) -> Quantised {
    drawn_convolutions(&mut Draw::new(seed ^ 0xc0_4401))
}

/// As [`convolutional`], from these numbers.
pub fn drawn_convolutions(draw: &mut Draw) -> Quantised {
    let semantics = draw.one_of(&[Semantics::Hardware, Semantics::Hardware, Semantics::Lava, Semantics::Slayer]);
    let mut net = Builder::with(semantics);
    if draw.chance(20) {
        net.reset(draw.from(1, 20) as u32, draw.from(0, 5) as u32);
    }
    let mut shape = (draw.from(1, 3) as u32, draw.from(5, 11) as u32, draw.from(5, 11) as u32);
    let volume = |(c, h, w): (u32, u32, u32)| Shape::Volume(c, h, w);
    let mut layers: Vec<(PopulationId, (u32, u32, u32))> = vec![(net.input_shape("in", volume(shape)), shape)];
    for _ in 0..draw.from(1, 3) {
        let (from, source) = layers[layers.len() - 1];
        let pool = layers.len() > 1 && draw.chance(20);
        let kernel = if pool { (2, 2) } else { (draw.from(1, 4) as u32, draw.from(1, 4) as u32) };
        let stride = if pool { (2, 2) } else { draw.one_of(&[(1, 1), (1, 1), (2, 2), (1, 2)]) };
        let padding = if pool { (0, 0) } else { (draw.from(0, 2) as u32, draw.from(0, 2) as u32) };
        let dilation = if pool { (1, 1) } else { draw.one_of(&[(1, 1), (1, 1), (1, 2), (2, 2)]) };
        let after = (draw.from(0, 2) as u32, draw.from(0, 2) as u32);
        let side = |s: u32, k: u32, stride: u32, p: u32, d: u32| {
            (s + p).checked_sub(d * (k - 1) + 1).map(|rest| rest / stride + 1)
        };
        let height = side(source.1, kernel.0, stride.0, padding.0 + after.0, dilation.0);
        let width = side(source.2, kernel.1, stride.1, padding.1 + after.1, dilation.1);
        let (Some(height), Some(width)) = (height, width) else { continue };
        let groups = if pool || draw.chance(20) { source.0 } else { 1 };
        let channels = if pool { source.0 } else { groups * draw.from(1, if groups > 1 { 2 } else { 7 }) as u32 };
        shape = (channels, height, width);
        let neuron = ready_neuron(draw, semantics);
        let to = net.each(
            &format!("layer{}", layers.len()),
            volume(shape),
            &vec![neuron; (channels * height * width) as usize],
            0,
        );
        let window = Window { source, target: shape, kernel, stride, padding, dilation, groups };
        let format = random_format(draw);
        let connectivity = match pool {
            true => Connectivity::SumPool2d { window, weight: draw.weight(format) },
            false => convolution(draw, window, format),
        };
        net.connect(from, to, format, draw.one_of(&[0, 0, 1, 17, 62]), connectivity);
        layers.push((to, shape));
    }
    let (last, shape) = layers[layers.len() - 1];
    if layers.len() == 1 {
        let neuron = ready_neuron(draw, semantics);
        let to =
            net.each(&format!("layer{}", layers.len()), volume(shape), &vec![neuron; volume(shape).len() as usize], 0);
        let window = recurrent(shape, 1);
        let format = random_format(draw);
        let connectivity = convolution(draw, window, format);
        net.connect(last, to, format, 0, connectivity);
        layers.push((to, shape));
    }
    if draw.chance(40) {
        let (to, shape) = layers[draw.from(1, layers.len() as i64 - 1) as usize];
        let window = recurrent(shape, draw.from(1, 3) as u32);
        let format = random_format(draw);
        let connectivity = convolution(draw, window, format);
        net.connect(to, to, format, draw.from(0, 9), connectivity);
    }
    net.build()
}

/// A neuron that mostly fires after a few spikes.
fn ready_neuron(draw: &mut Draw, semantics: Semantics) -> Neuron {
    let neuron = random_neuron(draw, semantics);
    let vth = draw.from(1, 60);
    if draw.chance(85) { Neuron { vth: ThresholdMantissa::new(vth).unwrap(), ..neuron } } else { neuron }
}

/// A window that preserves the shape, with this side or the next odd one.
fn recurrent(shape: (u32, u32, u32), side: u32) -> Window {
    let side = side | 1;
    let (kernel, padding) = ((side, side), (side / 2, side / 2));
    Window { source: shape, target: shape, kernel, stride: (1, 1), padding, dilation: (1, 1), groups: 1 }
}

fn convolution(draw: &mut Draw, window: Window, format: SynapseFormat) -> Connectivity {
    let size = window.target.0 * window.source.0 / window.groups * window.kernel.0 * window.kernel.1;
    Connectivity::Conv2d { window, kernel: (0..size).map(|_| draw.weight(format)).collect() }
}
