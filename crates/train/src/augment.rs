//! Data augmentation: variations of training samples, random by (seed, sample, epoch).

use super::raster::Raster;
use nsim_files::training::AugmentDesc;
use nsim_ir::base::rng;

/// Streams of random numbers, one for each kind of variation.
const SHIFT: u64 = 0;
const STRETCH: u64 = 1;
const DROP_CHANNEL: u64 = 2;
const SPIKE: u64 = 3;
const JITTER: u64 = 4;
const NOISE: u64 = 5;

/// A variation of a sample; populations are moved in time together.
pub fn vary(by: &AugmentDesc, inputs: &[Raster], seed: u64, sample: u64, epoch: u64) -> Vec<Raster> {
    let key = rng::bits(seed, sample, epoch);
    fn symmetric(limit: u32, key: u64, entity: u64, step: u64) -> i64 {
        rng::below(2 * u64::from(limit) + 1, key, entity, step) as i64 - i64::from(limit)
    }
    let shift = symmetric(by.shift, key, SHIFT, 0);
    let factor = 1.0 + by.stretch * (2.0 * rng::unit(key, STRETCH, 0) - 1.0);
    let mut varied = Vec::with_capacity(inputs.len());
    for (population, raster) in inputs.iter().enumerate() {
        let key = rng::bits(key, population as u64, 0);
        let steps = raster.steps();
        let mut events = Vec::with_capacity(raster.count());
        let dropped: Vec<bool> =
            (0..raster.units() as u64).map(|unit| rng::unit(key, DROP_CHANNEL, unit) < by.drop_channel).collect();
        for (index, (step, unit)) in raster.events().enumerate() {
            let index = index as u64;
            if dropped[unit as usize] || by.drop_spike > 0.0 && rng::unit(key, SPIKE, index) < by.drop_spike {
                continue;
            }
            let jitter = if by.jitter == 0 { 0 } else { symmetric(by.jitter, key, JITTER, index) };
            let step = (f64::from(step) * factor).round() as i64 + shift + jitter;
            if let Ok(step) = u32::try_from(step) {
                events.push((step, unit));
            }
        }
        let places = raster.units() * steps;
        let extra = (by.noise * places as f64).round() as u64;
        for k in 0..extra {
            let place = rng::below(places as u64, key, NOISE, k) as usize;
            events.push(((place / raster.units()) as u32, (place % raster.units()) as u32));
        }
        varied.push(Raster::from_events(raster.units(), steps, events));
    }
    varied
}
