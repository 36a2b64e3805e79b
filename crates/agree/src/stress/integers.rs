//! Cases in integers: three interpreters of one small network at the ends of its fields.

use std::collections::HashMap;
use std::sync::Arc;

use super::exact::{Compartment, Parameters, scaled};
use super::outcome::Outcome;
use nsim_compile::{Options, compile};
use nsim_golden::Golden;
use nsim_ir::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, OutOfRange, Refractory, SignMode, ThresholdMantissa, VmaxExponent,
    VminExponent, WeightBits, WeightExponent,
};
use nsim_ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::graph::{PerCompartment, Shape};
use nsim_ir::hardware::Target;
use nsim_ir::neurons::Port;
use nsim_ir::program::Program;
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Neuron, Parts, Population, Projection, Quantised, Units};
use nsim_ir::resource::Resource;
use nsim_ir::spikes::{Engine, Message};
use nsim_machine::{Image, Machine, Settings};

/// All-to-all synapses onto the population of a case.
struct Link {
    /// Whether they come from the population itself instead of the channels.
    recurrent: bool,
    /// `[source][target]`
    weights: Vec<Vec<i16>>,
    exponent: i32,
    delay: u32,
}

/// A network of channels and one population, in plain numbers.
struct Plan {
    channels: u32,
    neurons: Vec<Parameters>,
    links: Vec<Link>,
}

/// Counts of a run, which show whether a case reached its edge.
#[derive(Default)]
struct RunCounts {
    /// Non-zero sums, by step and compartment.
    arrivals: u64,
    spikes: u64,
    q_wrapped: u64,
    u_wrapped: u64,
    v_clipped: u64,
}

/// A compartment that decays, spikes at 320 and clips at the whole field.
const PLAIN: Parameters =
    Parameters { du: 1024, dv: 128, vth: 5, bias_mant: 0, bias_exp: 0, refractory: 1, vmin: 23, vmax: 7 };

/// Error of building a case: a value, a network or a mapping that its type refuses.
type Unbuildable = Box<dyn std::error::Error>;

/// Failure of a case that cannot be built.
fn fault(error: impl std::fmt::Display) -> (u64, String) {
    (0, format!("the case cannot be built: {error}"))
}

impl Plan {
    fn network(&self) -> Result<Quantised, Unbuildable> {
        let neurons = self.neurons.iter().map(|p| {
            Ok::<_, OutOfRange>(Neuron {
                du: Decay::new(p.du as i64)?,
                dv: Decay::new(p.dv as i64)?,
                vth: ThresholdMantissa::new(p.vth as i64)?,
                bias_mant: BiasMantissa::new(p.bias_mant as i64)?,
                bias_exp: BiasExponent::new(p.bias_exp.into())?,
                refractory: Refractory::new(p.refractory as i64)?,
                vmin: VminExponent::new(p.vmin.into())?,
                vmax: VmaxExponent::new(p.vmax.into())?,
                ..Neuron::PLAIN
            })
        });
        let neurons = PerCompartment::Each(neurons.collect::<Result<_, _>>()?);
        let count = self.neurons.len() as u32;
        let population = |name: &str, count, units| Population {
            name: name.to_string(),
            shape: Shape::Line(count),
            units,
            message: Message::Spike,
        };
        let units = Units::Compartments { first: CompartmentId(0), neurons, start_step: 0 };
        let projections = self.links.iter().map(|link| {
            Ok::<_, OutOfRange>(Projection {
                name: "link".to_string(),
                source: PopulationId(u32::from(link.recurrent)),
                target: PopulationId(1),
                format: SynapseFormat {
                    exponent: WeightExponent::new(link.exponent.into())?,
                    sign: SignMode::Mixed,
                    bits: WeightBits::new(8)?,
                    port: Port::First,
                    apart: None,
                    rule: None,
                },
                delay: Delay::new(link.delay.into())?,
                connectivity: Connectivity::Dense { targets: count, weights: link.weights.concat().into() },
                plastic: None,
            })
        });
        Ok(Quantised::new(Parts {
            name: "stress".to_string(),
            populations: vec![
                population("in", self.channels, Units::Input(ChannelId(0))),
                population("out", count, units),
            ]
            .into(),
            projections: projections.collect::<Result<Vec<_>, _>>()?.into(),
            output: PopulationId(1),
            ..Parts::default()
        })?)
    }

    fn program(&self, target: &Target) -> Result<(Quantised, Arc<Program>), Unbuildable> {
        let network = self.network()?;
        let mut limits = target.limits().clone();
        (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles]) = (1024, 1024);
        // The greatest fan-in needs more words than one of the largest cores has.
        limits[Resource::SynapseWords] = limits[Resource::SynapseWords].max(1 << 16);
        let compiled = compile(network.clone(), &target.clone().with_limits(limits), &Options::default())?;
        Ok((network, compiled.program))
    }

    /// Outcome of a case that reaches its edge when `met` returns true.
    fn outcome(
        &self,
        target: &Target,
        steps: u32,
        drive: impl Fn(u32) -> Vec<u32>,
        met: impl Fn(&RunCounts) -> bool,
    ) -> Outcome {
        let counts = self.run(target, steps, drive)?;
        let RunCounts { spikes, q_wrapped, u_wrapped, v_clipped, .. } = counts;
        let detail = format!(
            "{spikes} spikes; {q_wrapped} accumulators and {u_wrapped} currents wrapped, {v_clipped} voltages \
             clipped, as counted by all"
        );
        match met(&counts) {
            true => Ok((steps.into(), detail)),
            false => Err((steps.into(), format!("the edge was not met: {detail}"))),
        }
    }

    /// Runs the three engines over this number of steps and compares each with the exact model.
    fn run(&self, target: &Target, steps: u32, drive: impl Fn(u32) -> Vec<u32>) -> Result<RunCounts, (u64, String)> {
        let (network, program) = self.program(target).map_err(fault)?;
        let image = Image::new(&program, 1).map_err(fault)?;
        let machine = |skip| Machine::new(&image, Settings { skip, per_step: false });
        let (mut golden, mut with, mut without) = (Golden::new(&network), machine(true), machine(false));
        let mut engines: [(&str, &mut dyn Engine); 3] =
            [("golden", &mut golden), ("fast", &mut with), ("fast without skipping", &mut without)];
        engines.iter_mut().for_each(|(_, engine)| engine.begin(steps));
        let mut exact = vec![Compartment::default(); self.neurons.len()];
        let mut coming: HashMap<(u32, usize), i128> = HashMap::new();
        let mut counts = RunCounts::default();
        for now in 0..steps {
            let channels = drive(now);
            for link in self.links.iter().filter(|link| !link.recurrent) {
                channels.iter().for_each(|&c| send(&mut coming, link, c as usize, now + link.delay));
            }
            let mut spikes = Vec::new();
            for (index, (compartment, p)) in exact.iter_mut().zip(&self.neurons).enumerate() {
                let arrived = coming.remove(&(now, index)).unwrap_or(0);
                counts.arrivals += u64::from(arrived != 0);
                let step = compartment.step(now.into(), arrived, p);
                counts.q_wrapped += u64::from(step.q_wrapped);
                counts.u_wrapped += u64::from(step.u_wrapped);
                counts.v_clipped += u64::from(step.v_clipped);
                if step.spiked {
                    spikes.push(CompartmentId(index as u32));
                }
            }
            counts.spikes += spikes.len() as u64;
            for link in self.links.iter().filter(|link| link.recurrent) {
                spikes.iter().for_each(|s| send(&mut coming, link, s.0 as usize, now + 1 + link.delay));
            }
            let ids: Vec<ChannelId> = channels.into_iter().map(ChannelId).collect();
            for (name, engine) in &mut engines {
                engine.step(ids.as_slice().into());
                let wrong = |what: String| (u64::from(now) + 1, format!("{name}, step {now}: {what}"));
                let spiked = engine.ascending_spikes();
                if spiked != spikes {
                    return Err(wrong(format!("spikes {spiked:?}, exactly {spikes:?}")));
                }
                for (index, compartment) in exact.iter().enumerate() {
                    let id = CompartmentId(index as u32);
                    let (u, v) = (i128::from(engine.u(id)), i128::from(engine.v(id)));
                    if (u, v) != (compartment.u, compartment.v) {
                        let (eu, ev) = (compartment.u, compartment.v);
                        return Err(wrong(format!("compartment {index}: u {u}, v {v}; exactly u {eu}, v {ev}")));
                    }
                }
            }
        }
        for (name, engine) in &engines {
            let overflow = engine.overflow();
            let counted = (overflow.q_wrapped, overflow.u_wrapped, overflow.v_clipped);
            let exactly = (counts.q_wrapped, counts.u_wrapped, counts.v_clipped);
            if counted != exactly {
                let message = format!("{name}: counted q, u, v overflows {counted:?}, exactly {exactly:?}");
                return Err((steps.into(), message));
            }
        }
        Ok(counts)
    }
}

/// Adds the weights of a source's spike to the sums of a step.
fn send(coming: &mut HashMap<(u32, usize), i128>, link: &Link, source: usize, step: u32) {
    for (target, &weight) in link.weights[source].iter().enumerate() {
        *coming.entry((step, target)).or_default() += scaled(weight.into(), link.exponent);
    }
}

/// Synapses of the channels without delay.
fn link_from_channels(weights: Vec<Vec<i16>>, exponent: i32) -> Link {
    Link { recurrent: false, weights, exponent, delay: 0 }
}

/// Every channel with the same weight to every compartment.
fn uniform(channels: u32, targets: usize, weight: i16, exponent: i32) -> Link {
    link_from_channels(vec![vec![weight; targets]; channels as usize], exponent)
}

/// The ends of decays and their neighbours.
const ENDS: [i128; 4] = [0, 1, 4095, 4096];

fn every_decay() -> Vec<Parameters> {
    ENDS.iter().flat_map(|&du| ENDS.iter().map(move |&dv| Parameters { du, dv, ..PLAIN })).collect()
}

/// Each channel spikes in a step with this chance.
fn noise(channels: u32, seed: u64, chance: f64) -> impl Fn(u32) -> Vec<u32> {
    move |step| (0..channels).filter(|&c| rng::unit(seed, c.into(), step.into()) < chance).collect()
}

pub(super) fn fan_in(target: &Target, weight: i16) -> Outcome {
    const AXONS: u32 = 4096;
    // 4,096 weights of -256 sum to a multiple of the accumulator's period; fewer axons do not.
    let drive = |step: u32| match step % 3 {
        0 => (0..AXONS).collect(),
        1 => (0..1 + step * 37 % AXONS).collect(),
        _ => Vec::new(),
    };
    let plan = Plan {
        channels: AXONS,
        neurons: vec![PLAIN, Parameters { du: 4096, dv: 0, vth: 131_071, ..PLAIN }],
        links: vec![uniform(AXONS, 2, weight, 0)],
    };
    plan.outcome(target, 96, drive, |counts| counts.q_wrapped > 32)
}

fn exponent(target: &Target, exponent: i32, met: fn(&RunCounts) -> bool) -> Outcome {
    // Every weight of the format, hence every pattern of lost low bits.
    let weights = (-128..128).map(|half: i16| vec![2 * half, -2 * half.max(-127)]).collect();
    let plan = Plan {
        channels: 256,
        neurons: vec![PLAIN, Parameters { du: 1, dv: 4095, vth: 0, ..PLAIN }],
        links: vec![link_from_channels(weights, exponent)],
    };
    plan.outcome(target, 600, noise(256, 3, 0.2), met)
}

pub(super) fn exponent_least(target: &Target) -> Outcome {
    // Only the weight -256 stays non-zero: the others lose all of their bits.
    exponent(target, -8, |counts| counts.q_wrapped == 0 && counts.arrivals > 50)
}

pub(super) fn exponent_greatest(target: &Target) -> Outcome {
    exponent(target, 7, |counts| counts.q_wrapped > 0 && counts.spikes > 0)
}

pub(super) fn decays(target: &Target) -> Outcome {
    let plan = Plan {
        channels: 8,
        neurons: every_decay(),
        links: vec![link_from_channels((0..8i16).map(|c| vec![(2 * (31 * c % 101 - 50)) & !1; 16]).collect(), 3)],
    };
    plan.outcome(target, 2000, noise(8, 5, 0.3), |counts| counts.spikes > 0)
}

pub(super) fn thresholds(target: &Target) -> Outcome {
    let of = |vth| Parameters { du: 4096, dv: 0, vth, ..PLAIN };
    let plan = Plan {
        channels: 2,
        neurons: vec![of(1), of(131_071), of(0), of(131_070)],
        links: vec![
            link_from_channels(vec![vec![2; 4], vec![-2; 4]], -1),
            Link { delay: 1, ..link_from_channels(vec![vec![254; 4], vec![0; 4]], 5) },
        ],
    };
    plan.outcome(target, 3000, |step| if step % 5 == 4 { vec![0, 1] } else { vec![0] }, |counts| counts.spikes > 0)
}

pub(super) fn biases(target: &Target) -> Outcome {
    let ends = [(-4096, 0), (-4096, 7), (4095, 0), (4095, 7), (1, 0), (-1, 7)];
    let neuron =
        |&(bias_mant, bias_exp)| [0, 128].map(|dv| Parameters { bias_mant, bias_exp, dv, vth: 131_071, ..PLAIN });
    let plan =
        Plan { channels: 1, neurons: ends.iter().flat_map(neuron).collect(), links: vec![uniform(1, 12, -256, 3)] };
    let met = |counts: &RunCounts| counts.v_clipped > 0 && counts.spikes > 0;
    plan.outcome(target, 2000, |step| if step.is_multiple_of(7) { vec![0] } else { Vec::new() }, met)
}

pub(super) fn refractory(target: &Target) -> Outcome {
    let neurons = [0, 1, 2, 62, 63].map(|refractory| Parameters { refractory, ..PLAIN }).to_vec();
    let plan = Plan { channels: 1, neurons, links: vec![uniform(1, 5, 254, 0)] };
    // A compartment that spikes whenever it may spikes 1000, 1000, 500, 17 and 16 times.
    plan.outcome(target, 1000, |_| vec![0], |counts| counts.spikes == 1000 + 1000 + 500 + 17 + 16)
}

pub(super) fn overflow(target: &Target, weight: i16) -> Outcome {
    let of = |du, dv| Parameters { du, dv, vth: 131_071, ..PLAIN };
    let plan = Plan {
        channels: 1,
        neurons: vec![of(0, 4096), of(1, 4096), of(0, 0), of(1, 128)],
        links: vec![uniform(1, 4, weight, 6)],
    };
    plan.outcome(target, 500, |_| vec![0], |counts| counts.u_wrapped > 20)
}

pub(super) fn clips(target: &Target) -> Outcome {
    let of = |vmin, vmax| Parameters { dv: 0, vth: 131_071, vmin, vmax, ..PLAIN };
    let mut neurons: Vec<Parameters> = (0..=7).map(|vmax| of(23, vmax)).collect();
    neurons.extend((0..=23).map(|vmin| of(vmin, 7)));
    let count = neurons.len();
    let weights = vec![vec![254; count], vec![-256; count]];
    let plan = Plan { channels: 2, neurons, links: vec![link_from_channels(weights, 6)] };
    plan.outcome(target, 400, |step| vec![step / 50 % 2], |counts| counts.v_clipped > 1000)
}

pub(super) fn alternating(target: &Target) -> Outcome {
    let count = 16;
    let weights = (0..128).map(|_| vec![254; count]).chain((0..128).map(|_| vec![-256; count])).collect();
    let plan = Plan { channels: 256, neurons: every_decay(), links: vec![link_from_channels(weights, 0)] };
    plan.outcome(target, 2000, |step| (step % 2 * 128..step % 2 * 128 + 128).collect(), |counts| counts.spikes > 0)
}

pub(super) fn delays(target: &Target) -> Outcome {
    let all = |delay, weight: i16, recurrent| Link { recurrent, weights: vec![vec![weight; 2]; 2], exponent: 0, delay };
    let plan = Plan {
        channels: 2,
        neurons: vec![PLAIN, Parameters { refractory: 63, ..PLAIN }],
        links: vec![all(62, 40, false), all(61, -20, false), all(62, 254, true), all(0, -2, true)],
    };
    // The last spikes' deliveries fall after the end.
    plan.outcome(
        target,
        1000,
        |step| if step % 61 < 3 || step > 930 { vec![0, 1] } else { Vec::new() },
        |counts| counts.spikes > 100,
    )
}

pub(super) fn ten_million(target: &Target) -> Outcome {
    const STEPS: u32 = 10_000_000;
    const DRIVE: u64 = 7;
    let p = Parameters { du: 301, dv: 17, vth: 900, bias_mant: -23, bias_exp: 2, refractory: 3, ..PLAIN };
    let plan = Plan { channels: 1, neurons: vec![p], links: vec![uniform(1, 1, 254, 0)] };
    // State and input phase decide all that follows: once both return, the trace is periodic.
    let (mut exact, mut trace, mut met) = (Compartment::default(), Vec::new(), HashMap::new());
    let (before, period) = loop {
        let now = trace.len() as u64;
        let arrived = if now.is_multiple_of(DRIVE) { scaled(254, 0) } else { 0 };
        let step = exact.step(now, arrived, &p);
        trace.push((exact.u as i32, exact.v as i32, step.spiked));
        if let Some(earlier) = met.insert((exact.fingerprint(now, &p), now % DRIVE), now) {
            break (earlier as usize, (now - earlier) as usize);
        }
        if now > 1_000_000 {
            return Err((now, "no period within 1,000,000 steps".to_string()));
        }
    };
    let (network, program) = plan.program(target).map_err(fault)?;
    let image = Image::new(&program, 1).map_err(fault)?;
    let mut machine = Machine::new(&image, Settings { skip: true, per_step: false });
    let mut golden = Golden::new(&network);
    machine.begin(STEPS);
    golden.begin(STEPS);
    let mut spikes = 0u64;
    let channel = [ChannelId(0)];
    for now in 0..STEPS {
        let channels = if u64::from(now).is_multiple_of(DRIVE) { channel.as_slice() } else { &[] };
        let mut check = |name: &str, engine: &mut dyn Engine| {
            engine.step(channels.into());
            let id = CompartmentId(0);
            let is = (engine.u(id), engine.v(id), !engine.spikes().is_empty());
            spikes += u64::from(is.2);
            let now = now as usize;
            let should = trace[if now <= before { now } else { before + 1 + (now - before - 1) % period }];
            match is == should {
                true => Ok(()),
                false => Err((now as u64, format!("{name}, step {now}: {is:?}, by the period {should:?}"))),
            }
        };
        check("fast", &mut machine)?;
        // The interpreter is slow, so it runs only 100,000 steps, more than a period.
        if now < 100_000 {
            check("golden", &mut golden)?;
        }
    }
    let periodic = format!("exactly periodic: {period} steps from step {before} on, no drift; {spikes} spikes");
    match spikes > 1000 && period < 50_000 {
        true => Ok((STEPS.into(), periodic)),
        false => Err((STEPS.into(), format!("the compartment does too little: {spikes} spikes, period {period}"))),
    }
}
