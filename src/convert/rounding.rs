//! Weights rounded for the least error of the potential instead of each weight's own.
//!
//! Input: a converted network, its weights rounded to the nearest. Output: the same with some weights a step away. Population by
//! population from the input on, so that each sees the spikes that the integers before it send. With C(t) what a compartment's
//! integers make of these spikes, current and voltage without resets, and P(t) the potential that the trained network has
//! without them, the sum over all steps of w(t) (C(t) - P(t))^2 is made smaller weight by weight: a weight goes a step up or
//! down when that takes enough away. w(t) is the less, the further P(t) is from where a spike is decided.
//! A step is taken only once for a weight, and only for clearly less error: what helps by a hair on some samples does not on
//! others.

use std::sync::Arc;

use rayon::prelude::*;

use crate::agree::trace::Trace;
use crate::ir::quantised::{Connectivity, Projection};
use crate::ir::spikes::Sample;

use super::copies::relevance;

/// The most steps of samples that errors are summed over, and the most numbers that are kept of sources.
const STEPS: usize = 9_000;
const KEPT: usize = 24_000_000;
/// Times that all weights are gone through.
const PASSES: usize = 2;
/// The share of what a step would leave by itself that it has to take away beyond nothing.
const MARGIN: f32 = 0.5;

/// A population whose weights are rounded.
pub struct Target<'a> {
    /// Its compartments.
    pub neurons: usize,
    /// Shares of current and voltage that a step keeps.
    pub keeps: (f64, f64),
    /// What the trained neurons have without spikes, of each sample `[neuron][step]`, in thresholds.
    pub potentials: &'a [Vec<f64>],
    /// Threshold in register units.
    pub threshold: f64,
}

/// What comes in: a projection, the first of its sources among channels or compartments, how many, and whether they are channels.
pub struct Incoming<'a> {
    /// The projection with its weights.
    pub projection: &'a Projection,
    /// The first source.
    pub first: u32,
    /// Sources.
    pub count: u32,
    /// Whether sources are input channels.
    pub input: bool,
}

/// Responses of the sources of a population to their own spikes: `[source][step of all samples]`, samples apart by zeros.
struct Responses {
    first: u32,
    input: bool,
    count: usize,
    rows: Vec<f32>,
}

/// A synapse of a compartment: its projection, its place among the weights, its source.
type Synapse = (usize, usize, u32);

fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (mut sums, n) = ([0.0f32; 16], a.len().min(b.len()));
    let (a, b) = (&a[..n], &b[..n]);
    for (x, y) in a.chunks_exact(16).zip(b.chunks_exact(16)) {
        sums.iter_mut().zip(x.iter().zip(y)).for_each(|(sum, (x, y))| *sum += x * y);
    }
    let rest = n - n % 16;
    sums.iter().sum::<f32>() + a[rest..].iter().zip(&b[rest..]).map(|(x, y)| x * y).sum::<f32>()
}

fn weights(connectivity: &Connectivity) -> Option<&Arc<[i16]>> {
    match connectivity {
        Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => Some(weights),
        _ => None,
    }
}

/// The weights of each projection anew; none where one's weights are shared by several compartments.
pub fn rounded(
    target: &Target<'_>,
    incoming: &[Incoming<'_>],
    samples: &[&Sample],
    converted: &[Trace],
) -> Option<Vec<Arc<[i16]>>> {
    let mut all: Vec<Vec<i16>> =
        incoming.iter().map(|i| Some(weights(&i.projection.connectivity)?.to_vec())).collect::<Option<_>>()?;
    let pad = incoming.iter().map(|i| i.projection.delay.get() as usize).max().unwrap_or(0);
    let steps = samples.iter().map(|sample| sample.steps() as usize + pad).max().unwrap_or(1);
    let sources: usize = incoming.iter().map(|i| i.count as usize).max().unwrap_or(1);
    let room = (STEPS / steps).min(KEPT / (sources * steps).max(1)).clamp(1, samples.len().max(1));
    let every = samples.len().div_ceil(room).max(1);
    let places: Vec<usize> = (0..samples.len()).step_by(every).collect();
    // Where each of these samples begins, after its zeros.
    let mut begins = Vec::new();
    let mut length = 0;
    for &place in &places {
        begins.push(length + pad);
        length += pad + samples[place].steps() as usize;
    }
    let mut responses: Vec<Responses> = Vec::new();
    for i in incoming {
        if !responses.iter().any(|r| (r.first, r.input) == (i.first, i.input)) {
            let rows = responded(i, target.keeps, (samples, converted), (&places, &begins, length));
            responses.push(Responses { first: i.first, input: i.input, count: i.count as usize, rows });
        }
    }
    let of = |i: &Incoming<'_>| responses.iter().position(|r| (r.first, r.input) == (i.first, i.input)).unwrap_or(0);
    let mine: Vec<usize> = incoming.iter().map(of).collect();
    let row = |projection: usize, source: u32| {
        let responses = &responses[mine[projection]];
        debug_assert!((source as usize) < responses.count);
        &responses.rows[source as usize * length..(source as usize + 1) * length]
    };
    let mut synapses: Vec<Vec<Synapse>> = vec![Vec::new(); target.neurons];
    for (index, i) in incoming.iter().enumerate() {
        let mut place = 0;
        for source in 0..i.count {
            let silent = row(index, source).iter().all(|&x| x == 0.0);
            i.projection.connectivity.for_each_from(source, |target, _| {
                if !silent {
                    synapses[target as usize].push((index, place, source));
                }
                place += 1;
            });
        }
    }
    let one = |neuron: usize| {
        let (mut error, mut relevant) = (vec![0.0f32; length], vec![0.0f32; length]);
        for (&place, &begin) in places.iter().zip(&begins) {
            let steps = samples[place].steps() as usize;
            let wanted = &target.potentials[place][neuron * steps..(neuron + 1) * steps];
            for (t, &wanted) in wanted.iter().enumerate() {
                relevant[begin + t] = relevance(wanted) as f32;
                error[begin + t] = -wanted as f32;
            }
        }
        let value = |projection: usize, weight: i16| {
            (f64::from(incoming[projection].projection.format.scaled(weight)) / target.threshold) as f32
        };
        let late = |projection: usize| incoming[projection].projection.delay.get() as usize;
        let mut now: Vec<i16> = synapses[neuron].iter().map(|&(p, place, _)| all[p][place]).collect();
        for (&(p, _, source), &weight) in synapses[neuron].iter().zip(&now) {
            let (by, d) = (value(p, weight), late(p));
            error[d..].iter_mut().zip(row(p, source)).for_each(|(sum, x)| *sum += by * x);
        }
        error.iter_mut().zip(&relevant).for_each(|(error, relevant)| *error *= relevant);
        let start = now.clone();
        let mut squares: Vec<f32> = Vec::with_capacity(now.len());
        for pass in 0..PASSES {
            for (k, &(p, _, source)) in synapses[neuron].iter().enumerate() {
                let (d, row, format) = (late(p), row(p, source), incoming[p].projection.format);
                if pass == 0 {
                    let own: f32 = relevant[d..].iter().zip(row).map(|(w, x)| w * x * x).sum();
                    squares.push(own);
                }
                let along = dot(&error[d..], row);
                // Against the error.
                let step = if along > 0.0 { -format.sign.step(format.bits) } else { format.sign.step(format.bits) };
                let next = now[k] + step;
                let (low, high) = format.sign.range(format.bits);
                let by = value(p, next) - value(p, now[k]);
                let takes = -(2.0 * by * along + by * by * squares[k]);
                let near = (next - start[k]).abs() <= step.abs();
                if near && (low..=high).contains(&next) && takes > MARGIN * by * by * squares[k] {
                    now[k] = next;
                    let moved = error[d..].iter_mut().zip(&relevant[d..]).zip(row);
                    moved.for_each(|((error, relevant), x)| *error += by * relevant * x);
                }
            }
        }
        now
    };
    let each: Vec<Vec<i16>> = (0..target.neurons).into_par_iter().map(one).collect();
    for (now, synapses) in each.iter().zip(&synapses) {
        now.iter().zip(synapses).for_each(|(&weight, &(p, place, _))| all[p][place] = weight);
    }
    Some(all.into_iter().map(Arc::from).collect())
}

/// The response of each source of a projection without delay.
fn responded(
    incoming: &Incoming<'_>,
    (keep_u, keep_v): (f64, f64),
    (samples, converted): (&[&Sample], &[Trace]),
    (places, begins, length): (&[usize], &[usize], usize),
) -> Vec<f32> {
    let mut rows = vec![0.0f32; incoming.count as usize * length];
    for (&place, &begin) in places.iter().zip(begins) {
        let steps = samples[place].steps();
        let mut mark = |source: u32, step: u32| {
            if step < steps {
                rows[source as usize * length + begin + step as usize] += 1.0;
            }
        };
        if incoming.input {
            for step in 0..steps {
                let own = samples[place].at(step).iter().filter_map(|channel| channel.0.checked_sub(incoming.first));
                own.filter(|&channel| channel < incoming.count).for_each(|channel| mark(channel, step));
            }
        } else {
            for source in 0..incoming.count {
                let train = &converted[place].trains[(incoming.first + source) as usize];
                train.iter().for_each(|&step| mark(source, step + 1));
            }
        }
    }
    let ends: Vec<usize> = places.iter().zip(begins).map(|(&p, &begin)| begin + samples[p].steps() as usize).collect();
    rows.par_chunks_mut(length.max(1)).for_each(|row| {
        if row.iter().any(|&x| x != 0.0) {
            for (&begin, &end) in begins.iter().zip(&ends) {
                let (mut u, mut v) = (0.0, 0.0);
                for x in &mut row[begin..end] {
                    u = keep_u * u + f64::from(*x);
                    v = keep_v * v + u;
                    *x = v as f32;
                }
            }
        }
    });
    rows
}
