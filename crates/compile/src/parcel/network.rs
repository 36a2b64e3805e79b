//! A network in integers as words, with the synapses that end on some of its compartments; and
//! back.
//!
//! Input: a network, and of which compartments. Output: words; the network that they give, whose
//! populations are all there, and whose projections are whole or hold fewer synapses, all of those
//! to the compartments in question among them. Notes, which the first rank says, are left out.
//!
//! What is sent of a projection:
//!
//! | | |
//! |---|---|
//! | kernel, seed | all of it: a few numbers |
//! | list of synapses | those that end on the compartments |
//! | all to all | as such, or as the list of those that end on the compartments, whichever is shorter |
//!
//! Errors: words that are cut or changed are [`Damaged`], or a network that contradicts itself.

use std::sync::Arc;

use crate::parcel::words::{Damaged, Reader, Writer};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::arithmetic::{ReadOut, Semantics, ThresholdTest};
use nsim_ir::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, OutOfRange, Payload, Refractory, SignMode, ThresholdMantissa,
    VmaxExponent, VminExponent, WeightBits, WeightExponent,
};
use nsim_ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim_ir::graph::{PerCompartment, Shape, Window};
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Neuron, Parts, Population, Projection, Pruned, Quantised, Reset, Units};
use nsim_partition::error::CompileError;

const SIGNS: [SignMode; 3] = [SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory];
const SEMANTICS: [Semantics; 3] = [Semantics::Hardware, Semantics::Lava, Semantics::Slayer];
const TESTS: [ThresholdTest; 2] = [ThresholdTest::Strict, ThresholdTest::Inclusive];

/// Where a synapse of a list stands for two numbers and one of an all-to-all projection for a third
/// of them, the part of the targets from which on the latter is shorter.
const LISTED_COSTS: usize = 3;

impl From<OutOfRange> for Damaged {
    fn from(_: OutOfRange) -> Self {
        Damaged
    }
}

/// Which synapses are sent.
#[derive(Debug, Clone, Copy)]
pub enum Wanted<'a> {
    /// All.
    All,
    /// None, and no projections.
    None,
    /// Those to some compartments.
    To(&'a [bool]),
}

impl Wanted<'_> {
    /// Those of a population's compartments from this one on; `None` where all are wanted.
    fn of_targets(&self, first: CompartmentId, count: u32) -> Option<&[bool]> {
        match self {
            Wanted::To(wanted) => {
                let of_population = &wanted[first.0 as usize..(first.0 + count) as usize];
                of_population.contains(&false).then_some(of_population)
            }
            Wanted::All | Wanted::None => None,
        }
    }
}

/// Writes a network.
pub fn write(network: &Quantised, wanted: Wanted<'_>, words: &mut Writer) {
    let parts = network.parts();
    words.text(&parts.name);
    words.wide(parts.timestep_ms.to_bits());
    words.put(parts.output.0);
    words.put(ReadOut::ALL.iter().position(|one| *one == parts.decision).unwrap_or(ReadOut::ALL.len()) as u32);
    words.put(parts.drain);
    texts(&parts.classes, words);
    words.put(SEMANTICS.iter().position(|one| *one == parts.semantics).unwrap_or(SEMANTICS.len()) as u32);
    words.put(TESTS.iter().position(|one| *one == parts.threshold).unwrap_or(TESTS.len()) as u32);
    if let Some(reset) = words.is_some(parts.reset) {
        words.list(&[reset.interval, reset.offset]);
    }
    words.put(parts.gathers.into());
    words.wide(parts.populations.len() as u64);
    parts.populations.iter().for_each(|one| population(one, words));
    let projections = if matches!(wanted, Wanted::None) { &[][..] } else { parts.projections.as_slice() };
    words.wide(projections.len() as u64);
    projections.iter().for_each(|one| projection(network, one, wanted, words));
    if let Some(pruned) = words.is_some(network.pruned()) {
        record(pruned, words);
    }
}

fn texts(texts: &[String], words: &mut Writer) {
    words.wide(texts.len() as u64);
    texts.iter().for_each(|text| words.text(text));
}

fn population(population: &Population, words: &mut Writer) {
    words.text(&population.name);
    match population.shape {
        Shape::Line(length) => words.list(&[length]),
        Shape::Volume(channels, height, width) => words.list(&[channels, height, width]),
    }
    if let Some(payload) = words.is_some(population.payload) {
        words.signed(payload.get());
    }
    match &population.units {
        Units::Input(first) => words.list(&[first.0]),
        Units::Compartments { first, neurons, start_step } => {
            words.list(&[first.0, *start_step]);
            match neurons {
                PerCompartment::Same(one) => {
                    words.put(0);
                    neuron(one, words);
                }
                PerCompartment::Each(each) => {
                    words.put(1);
                    words.wide(each.len() as u64);
                    each.iter().for_each(|one| neuron(one, words));
                }
            }
        }
    }
}

fn neuron(neuron: &Neuron, words: &mut Writer) {
    let Neuron { kind, du, dv, vth, bias_mant, bias_exp, refractory, vmin, vmax, shift } = neuron;
    words.put(NeuronKind::ALL.iter().position(|one| one == kind).unwrap_or(NeuronKind::ALL.len()) as u32);
    words.put(u32::from(du.get()) | u32::from(dv.get()) << 16);
    words.put(vth.get());
    words.signed(bias_mant.get().into());
    let small = [bias_exp.get(), refractory.get(), vmin.get(), vmax.get()];
    words.put(u32::from_le_bytes(small));
    words.put(u32::from(*shift));
}

fn projection(network: &Quantised, projection: &Projection, wanted: Wanted<'_>, words: &mut Writer) {
    let Projection { name, source, target, format, delay, connectivity } = projection;
    words.text(name);
    words.list(&[source.0, target.0]);
    words.signed(format.exponent.get().into());
    words.put(SIGNS.iter().position(|one| *one == format.sign).unwrap_or(SIGNS.len()) as u32);
    words.put(format.bits.get().into());
    words.put(delay.get().into());
    let (sources, target) = (network.populations()[*source].shape.len(), &network.populations()[*target]);
    let first = target.first_compartment().unwrap_or(CompartmentId(0));
    let wanted = wanted.of_targets(first, target.shape.len());
    match (connectivity, wanted) {
        (Connectivity::Dense { targets, weights }, wanted) => {
            let listed = |wanted: &&[bool]| {
                // Which projections are all to all decides which sources are gathered.
                let some = wanted.iter().filter(|wanted| **wanted).count();
                !network.parts().gathers && some * LISTED_COSTS < wanted.len()
            };
            match wanted.filter(listed) {
                Some(wanted) => list(connectivity, sources, Some(wanted), words),
                None => {
                    words.list(&[0, *targets]);
                    words.halves(weights);
                }
            }
        }
        (Connectivity::Sparse { .. }, wanted) => list(connectivity, sources, wanted, words),
        (Connectivity::Conv2d { window, kernel }, _) => {
            words.put_window(2, window);
            words.halves(kernel);
        }
        (Connectivity::SumPool2d { window, weight }, _) => {
            words.put_window(3, window);
            words.signed((*weight).into());
        }
        (Connectivity::Random { targets, fan_out, low, high, step, seed, first_source }, _) => {
            let least = [*low, *high, *step].map(|number| i32::from(number).cast_unsigned());
            words.list(&[4, *targets, *fan_out, least[0], least[1], least[2], *first_source]);
            words.wide(*seed);
        }
    }
}

/// Writes synapses one by one: how many each source has, their targets and their weights.
fn list(connectivity: &Connectivity, sources: u32, wanted: Option<&[bool]>, words: &mut Writer) {
    words.list(&[1]);
    let (mut counts, mut targets, mut weights) = (Vec::with_capacity(sources as usize), Vec::new(), Vec::new());
    for source in 0..sources {
        let before = targets.len();
        connectivity.for_each_from(source, |target, weight| {
            if wanted.is_none_or(|wanted| wanted[target as usize]) {
                targets.push(target);
                weights.push(weight);
            }
        });
        counts.push((targets.len() - before) as u32);
    }
    words.list(&counts);
    words.list(&targets);
    words.halves(&weights);
}

impl Writer {
    fn put_window(&mut self, kind: u32, window: &Window) {
        let Window { source, target, kernel, stride, padding, dilation, groups } = *window;
        let sizes = [source.0, source.1, source.2, target.0, target.1, target.2];
        let pairs = [kernel, stride, padding, dilation].map(|(y, x)| [y, x]);
        self.list(&[&[kind][..], &sizes, &pairs.concat(), &[groups]].concat());
    }
}

fn record(pruned: &Pruned, words: &mut Writer) {
    write(&pruned.original, Wanted::None, words);
    words.wide(pruned.kept.len() as u64);
    for kept in &pruned.kept {
        if let Some(kept) = words.is_some(kept.as_ref()) {
            words.list(kept);
        }
    }
    words.list(&pruned.probed.iter().map(|id| id.0).collect::<Vec<_>>());
    if let Some(stimulus) = words.is_some(pruned.stimulus.as_ref()) {
        texts(stimulus, words);
    }
    words.list(&pruned.dead.iter().map(|id| id.0).collect::<Vec<_>>());
}

/// Reads a network.
///
/// # Errors
/// [`CompileError::Fault`].
pub fn read(words: &mut Reader<'_>) -> Result<Quantised, CompileError> {
    let (name, timestep_ms, output) = (words.text()?, f64::from_bits(words.wide()?), PopulationId(words.take()?));
    let decision = words.one_of(&ReadOut::ALL)?;
    let drain = words.take()?;
    let classes = read_texts(words)?;
    let (semantics, threshold) = (words.one_of(&SEMANTICS)?, words.one_of(&TESTS)?);
    let reset = match words.is_some()? {
        true => Some(read_reset(words)?),
        false => None,
    };
    let gathers = words.is_some()?;
    let populations = (0..words.length()?).map(|_| read_population(words)).collect::<Result<Vec<_>, _>>()?;
    let projections = (0..words.length()?).map(|_| read_projection(words)).collect::<Result<Vec<_>, _>>()?;
    let pruned = match words.is_some()? {
        true => Some(Arc::new(read_record(words)?)),
        false => None,
    };
    let parts = Parts {
        name,
        timestep_ms,
        populations: populations.into(),
        projections: projections.into(),
        output,
        decision,
        drain,
        classes,
        semantics,
        threshold,
        reset,
        notes: Vec::new(),
        gathers,
    };
    Quantised::new(parts).and_then(|network| network.with_record(pruned)).map_err(CompileError::fault)
}

fn read_texts(words: &mut Reader<'_>) -> Result<Vec<String>, Damaged> {
    (0..words.length()?).map(|_| words.text()).collect()
}

fn read_reset(words: &mut Reader<'_>) -> Result<Reset, Damaged> {
    match *words.list()? {
        [interval, offset] if interval > 0 => Ok(Reset { interval, offset }),
        _ => Err(Damaged),
    }
}

fn read_population(words: &mut Reader<'_>) -> Result<Population, Damaged> {
    let name = words.text()?;
    let shape = match *words.list()? {
        [length] => Shape::Line(length),
        [channels, height, width] => Shape::Volume(channels, height, width),
        _ => return Err(Damaged),
    };
    let payload = match words.is_some()? {
        true => Some(Payload::new(words.signed()?.into())?),
        false => None,
    };
    let units = match *words.list()? {
        [first] => Units::Input(ChannelId(first)),
        [first, start_step] => {
            let neurons = match words.is_some()? {
                false => PerCompartment::Same(read_neuron(words)?),
                true => {
                    let each = words.length()?;
                    if each != shape.len() as usize {
                        return Err(Damaged);
                    }
                    PerCompartment::Each((0..each).map(|_| read_neuron(words)).collect::<Result<_, _>>()?)
                }
            };
            Units::Compartments { first: CompartmentId(first), neurons, start_step }
        }
        _ => return Err(Damaged),
    };
    Ok(Population { name, shape, units, payload })
}

fn read_neuron(words: &mut Reader<'_>) -> Result<Neuron, Damaged> {
    let kind = words.one_of(&NeuronKind::ALL)?;
    let decays = words.take()?;
    let (vth, bias_mant) = (words.take()?, words.signed()?);
    let [bias_exp, refractory, vmin, vmax] = words.take()?.to_le_bytes().map(i64::from);
    Ok(Neuron {
        kind,
        du: Decay::new((decays & 0xffff).into())?,
        dv: Decay::new((decays >> 16).into())?,
        vth: ThresholdMantissa::new(vth.into())?,
        bias_mant: BiasMantissa::new(bias_mant.into())?,
        bias_exp: BiasExponent::new(bias_exp)?,
        refractory: Refractory::new(refractory)?,
        vmin: VminExponent::new(vmin)?,
        vmax: VmaxExponent::new(vmax)?,
        shift: words.take()? as u8,
    })
}

fn read_projection(words: &mut Reader<'_>) -> Result<Projection, Damaged> {
    let name = words.text()?;
    let [source, target] = *words.list()? else { return Err(Damaged) };
    let exponent = WeightExponent::new(words.signed()?.into())?;
    let (sign, bits) = (words.one_of(&SIGNS)?, WeightBits::new(words.take()?.into())?);
    let delay = Delay::new(words.take()?.into())?;
    Ok(Projection {
        name,
        source: PopulationId(source),
        target: PopulationId(target),
        format: SynapseFormat { exponent, sign, bits },
        delay,
        connectivity: read_connectivity(words)?,
    })
}

fn read_connectivity(words: &mut Reader<'_>) -> Result<Connectivity, Damaged> {
    let small = |number: u32| i16::try_from(number.cast_signed()).map_err(|_| Damaged);
    Ok(match *words.list()? {
        [0, targets] => Connectivity::Dense { targets, weights: words.halves()?.collect() },
        [1] => {
            let mut sum = 0;
            let ends = words.list()?.iter().map(|&count| {
                sum += u64::from(count);
                sum
            });
            let first = std::iter::once(0).chain(ends).collect();
            Connectivity::Sparse { first, targets: words.list()?.into(), weights: words.halves()?.collect() }
        }
        [2, ref window @ ..] => {
            Connectivity::Conv2d { window: read_window(window)?, kernel: words.halves()?.collect() }
        }
        [3, ref window @ ..] => Connectivity::SumPool2d { window: read_window(window)?, weight: small(words.take()?)? },
        [4, targets, fan_out, low, high, step, first_source] => {
            let (low, high, step) = (small(low)?, small(high)?, small(step)?);
            if step < 1 || low > high {
                return Err(Damaged);
            }
            Connectivity::Random { targets, fan_out, low, high, step, seed: words.wide()?, first_source }
        }
        _ => return Err(Damaged),
    })
}

fn read_window(words: &[u32]) -> Result<Window, Damaged> {
    let [c, h, w, to_c, to_h, to_w, ky, kx, sy, sx, py, px, dy, dx, groups] = *words else { return Err(Damaged) };
    Ok(Window {
        source: (c, h, w),
        target: (to_c, to_h, to_w),
        kernel: (ky, kx),
        stride: (sy, sx),
        padding: (py, px),
        dilation: (dy, dx),
        groups,
    })
}

fn read_record(words: &mut Reader<'_>) -> Result<Pruned, CompileError> {
    let original = read(words)?;
    let mut kept = Vec::new();
    for _ in 0..words.length()? {
        kept.push(if words.is_some()? { Some(words.list()?.to_vec()) } else { None });
    }
    let probed = words.list()?.iter().copied().map(PopulationId).collect();
    let stimulus = if words.is_some()? { Some(read_texts(words)?) } else { None };
    let dead = words.list()?.iter().copied().map(ChannelId).collect();
    Ok(Pruned { original, kept: kept.into(), probed, stimulus, dead, rows: Vec::new() })
}
