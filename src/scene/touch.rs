//! Fingertips with fast-adapting taxels: pressure under the skin -> events on changes of pressure.
//!
//! Comes in: the pressure on each taxel, one millisecond after the other. Goes out: on and off events. A taxel's
//! pressure runs through the skin (a part of it creeps, so that a deformation takes 300 ms to recover), is held against
//! the value at its last event, which slowly follows; beyond a threshold either way it sends an event and is silent for
//! its refractory time.
//!
//! From Taunyazov et al. 2020, section III: 39 taxels a finger, radially arranged, denser at the centre; fast-adapting;
//! recovery of about 300 ms; a fingertip of 37 x 21 mm. Assumed, for nobody has published them: the rings' radii, the
//! thresholds, noise and refractory time.

use super::draw::{Draws, Purpose};

/// Taxels of a finger.
pub const TAXELS: usize = 39;

/// Taxels on each ring, the centre first, and the rings' radii in mm: 39 in all, denser at the centre.
const RINGS: [(usize, f64); 5] = [(1, 0.0), (6, 1.6), (8, 3.3), (10, 5.3), (14, 8.0)];

/// Places of a finger's taxels in mm: x along the finger's width, y along its length; rings are ellipses, as the fingertip
/// is longer than wide.
#[must_use]
pub fn layout() -> Vec<(f64, f64)> {
    let mut places = Vec::with_capacity(TAXELS);
    for (ring, &(count, radius)) in RINGS.iter().enumerate() {
        for k in 0..count {
            let turn = std::f64::consts::TAU * (k as f64 + 0.5 * (ring % 2) as f64) / count as f64;
            places.push((0.9 * radius * libm::cos(turn), 1.1 * radius * libm::sin(turn)));
        }
    }
    places
}

/// How taxels sense. Pressures in kPa, times in ms.
#[derive(Debug, Clone, PartialEq)]
pub struct Skin {
    /// Change of pressure that makes an event.
    pub threshold_kpa: f64,
    /// Relative standard deviation of the threshold from taxel to taxel.
    pub mismatch: f64,
    /// Standard deviation of the noise on each millisecond's pressure.
    pub noise_kpa: f64,
    /// Part of the pressure that creeps.
    pub creep: f64,
    /// Time constant of the creep: 100 ms recover 95 % of a deformation in 300 ms.
    pub creep_ms: f64,
    /// Time constant with which the reference follows the pressure.
    pub adaptation_ms: f64,
    /// Shortest time between two events of a taxel.
    pub refractory_ms: u32,
}

impl Default for Skin {
    fn default() -> Self {
        Skin {
            threshold_kpa: 0.5,
            mismatch: 0.15,
            noise_kpa: 0.09,
            creep: 0.3,
            creep_ms: 100.0,
            adaptation_ms: 40.0,
            refractory_ms: 4,
        }
    }
}

/// Whether the pressure rose or fell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// On: channel 2 k + 1 of taxel k.
    Rise,
    /// Off: channel 2 k of taxel k.
    Fall,
}

impl Change {
    /// The polarity's index, as the recordings write it.
    #[must_use]
    pub fn index(self) -> u32 {
        match self {
            Change::Fall => 0,
            Change::Rise => 1,
        }
    }
}

#[derive(Debug, Clone)]
struct Taxel {
    threshold: f64,
    crept: f64,
    reference: f64,
    silent_until: u32,
}

/// Taxels at work.
#[derive(Debug, Clone)]
pub struct Taxels {
    skin: Skin,
    draws: Draws,
    taxels: Vec<Taxel>,
    step: u32,
}

impl Taxels {
    /// So many taxels at rest. Thresholds belong to the fingers, not to the sample: they are drawn from the seed alone.
    #[must_use]
    pub fn new(skin: &Skin, draws: Draws, fingers: Draws, count: usize) -> Self {
        let taxel = |k| Taxel {
            threshold: skin.threshold_kpa
                * (1.0 + skin.mismatch * fingers.normal(Purpose::TaxelGain, k as u32, 0)).max(0.2),
            crept: 0.0,
            reference: 0.0,
            silent_until: 0,
        };
        Taxels { skin: skin.clone(), draws, taxels: (0..count).map(taxel).collect(), step: 0 }
    }

    /// A millisecond with this pressure on each taxel; calls `event` for each that responds.
    pub fn step(&mut self, pressure_kpa: &[f64], mut event: impl FnMut(u32, Change)) {
        let skin = &self.skin;
        let (creep, follow) = (1.0 / skin.creep_ms, 1.0 / skin.adaptation_ms);
        for (k, (taxel, &pressure)) in self.taxels.iter_mut().zip(pressure_kpa).enumerate() {
            taxel.crept += (pressure - taxel.crept) * creep;
            let noise = skin.noise_kpa * self.draws.normal(Purpose::Taxel, k as u32, self.step);
            let sensed = (1.0 - skin.creep) * pressure + skin.creep * taxel.crept + noise;
            taxel.reference += (sensed - taxel.reference) * follow;
            if self.step < taxel.silent_until {
                continue;
            }
            let change = sensed - taxel.reference;
            if change.abs() >= taxel.threshold {
                taxel.reference = sensed;
                taxel.silent_until = self.step + skin.refractory_ms;
                event(k as u32, if change > 0.0 { Change::Rise } else { Change::Fall });
            }
        }
        self.step += 1;
    }
}
