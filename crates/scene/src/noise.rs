//! Independent spikes: each channel of a population spikes in each step with the same probability.
//!
//! For networks without recordings. A channel's spike is a function of (seed, sample and channel,
//! step), so samples can be made in any order.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::parameter::{parameter, unknown};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::ChannelId;
use nsim_ir::base::rng;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_ir::stimulus::SceneArg;

/// The scene's parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    samples: u32,
    steps: u32,
    seed: u64,
    rate: f64,
    rates: BTreeMap<String, f64>,
}

impl Noise {
    /// Reads `samples` (default 20, at most 100,000), `steps` (150, at most 100,000), `seed` (1),
    /// `rate` (0.01 spikes a channel and step) and `POPULATION=rate` for single populations.
    ///
    /// # Errors
    /// A diagnostic for an unknown key or a value out of range.
    pub fn parse(network: &Quantised, scene: &SceneArg) -> Result<Self> {
        let mut noise = Noise { samples: 20, steps: 150, seed: 1, rate: 0.01, rates: BTreeMap::new() };
        for (key, value) in &scene.parameters {
            match key.as_str() {
                "samples" => noise.samples = parameter(key, value, 1..=100_000)?,
                "steps" => noise.steps = parameter(key, value, 1..=100_000)?,
                "seed" => noise.seed = parameter(key, value, 0..=u64::MAX)?,
                "rate" => noise.rate = parameter(key, value, 0.0..=1.0)?,
                name if network.inputs().any(|(_, population)| population.name == name) => {
                    noise.rates.insert(name.to_string(), parameter(key, value, 0.0..=1.0)?);
                }
                _ => {
                    let keys = ["samples", "steps", "seed", "rate"].into_iter();
                    let keys: Vec<&str> = keys.chain(network.inputs().map(|(_, p)| p.name.as_str())).collect();
                    return Err(unknown("noise", key, &keys));
                }
            }
        }
        Ok(noise)
    }
}

/// Makes the samples; calls `progress` before each.
///
/// # Errors
/// A diagnostic when a sample would have too many spikes to count.
pub fn stimulus(network: &Quantised, noise: &Noise, progress: &(dyn Fn() + Sync)) -> Result<Stimulus> {
    let samples = (0..noise.samples)
        .into_par_iter()
        .map(|index| {
            progress();
            let mut events = Vec::new();
            for (_, population) in network.inputs() {
                let rate = noise.rates.get(&population.name).copied().unwrap_or(noise.rate);
                let first = population.first_channel().map_or(0, |channel| channel.0);
                for channel in first..first + population.shape.len() {
                    let entity = (u64::from(index) << 32) | u64::from(channel);
                    let spiking = (0..noise.steps).filter(|&t| rng::unit(noise.seed, entity, u64::from(t)) < rate);
                    events.extend(spiking.map(|t| (t, ChannelId(channel))));
                }
            }
            Sample::new(noise.steps, &events, None)
        })
        .collect::<Result<_, _>>()
        .map_err(|e| Diagnostic::new("scene.too-large", e.to_string()))?;
    Ok(Stimulus { samples, origin: vec!["scene:noise".to_string()], seed: Some(noise.seed), ..Stimulus::default() })
}
