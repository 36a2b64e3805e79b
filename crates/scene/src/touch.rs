//! Fingertips with fast-adapting taxels: pressure under the skin -> events on changes of pressure.
//!
//! Input: the pressure on each taxel, tick by tick. Output: on and off events. A part of the
//! pressure creeps in the skin, so a deformation takes 300 ms to recover. A reference, the value at
//! the last event, slowly follows the result. Beyond a threshold in either direction a taxel sends
//! an event; it is then silent for its refractory time.
//!
//! From Taunyazov et al. 2020, section III: 39 taxels a finger, radially arranged, denser at the
//! centre; fast-adapting; recovery of about 300 ms; a fingertip of 37 x 21 mm. Assumed, since they
//! are not published: the rings' radii, the thresholds, noise and refractory time.

use super::draw::{Draws, Purpose};

/// Taxels of a finger.
pub const TAXELS: usize = 39;

/// Taxels on each ring, the centre first, and radii in mm: 39 in all, denser at the centre.
const RINGS: [(usize, f64); 5] = [(1, 0.0), (6, 1.6), (8, 3.3), (10, 5.3), (14, 8.0)];

/// Places of a finger's taxels in mm: x along the finger's width, y along its length; rings are
/// ellipses, as the fingertip is longer than wide.
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

/// Parameters of the taxels. Pressures in kPa, times in ms.
#[derive(Debug, Clone, PartialEq)]
pub struct Skin {
    /// Change of pressure that makes an event.
    pub threshold_kpa: f64,
    /// Relative standard deviation of the threshold from taxel to taxel.
    pub mismatch: f64,
    /// Standard deviation of the noise on the pressure of each tick.
    pub noise_kpa: f64,
    /// Part of the pressure that creeps.
    pub creep: f64,
    /// Time constant of the creep: 100 ms recover 95 % of a deformation in 300 ms.
    pub creep_ms: f64,
    /// Time constant with which the reference follows the pressure.
    pub adaptation_ms: f64,
    /// Shortest time between two events of a taxel.
    pub refractory_ms: u32,
    /// Sampling interval of the pressure.
    pub tick_ms: u32,
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
            tick_ms: 1,
        }
    }
}

/// Radius in mm and peak pressure in kPa of a contact under a normal force. By Hertz the radius
/// grows with the cube root of the force and the pressure over the contact is an ellipsoid;
/// `radius_m` is the radius under `nominal_n`.
pub fn hertz(grip_n: f64, radius_m: f64, nominal_n: f64) -> (f64, f64) {
    let radius = 1e3 * radius_m * libm::cbrt(grip_n / nominal_n);
    // N / mm^2 is MPa.
    (radius, if grip_n > 0.0 { 1.5 * grip_n / (std::f64::consts::PI * radius * radius) * 1e3 } else { 0.0 })
}

/// Stores the pressure on the taxels of two fingers under a `contact` of (radius mm, peak kPa). Its
/// centre lies `shift_mm` beyond `centres` along each finger. `sensed` returns a taxel's pressure,
/// given its number, its place from the centre, and the contact's pressure there.
pub(super) fn press(
    pressure: &mut [f64],
    places: &[(f64, f64)],
    contact: (f64, f64),
    centres: [(f64, f64); 2],
    shift_mm: f64,
    mut sensed: impl FnMut(usize, (f64, f64), f64) -> f64,
) {
    let (radius, peak) = contact;
    for (k, pressure) in pressure.iter_mut().enumerate() {
        let ((x, y), (cx, cy)) = (places[k % TAXELS], centres[k / TAXELS]);
        let (dx, dy) = (x - cx, y - cy - shift_mm);
        let within = 1.0 - (dx * dx + dy * dy) / (radius * radius);
        *pressure = if within > 0.0 { sensed(k, (dx, dy), peak * within.sqrt()) } else { 0.0 };
    }
}

/// Shift of the centre of pressure of a grip by a load, on skin of 1.5 mm, mm.
pub(super) fn shift_mm(grip_n: f64, load_n: f64) -> f64 {
    if grip_n > 0.0 { 1.5 * 0.5 * load_n / grip_n } else { 0.0 }
}

/// Direction of a change of pressure: channel 2 k of taxel k is its falls, 2 k + 1 its rises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Change {
    Fall = 0,
    Rise = 1,
}

#[derive(Debug, Clone)]
struct Taxel {
    threshold: f64,
    crept: f64,
    reference: f64,
    silent_until: u32,
}

/// State of the taxels.
#[derive(Debug, Clone)]
pub struct Taxels {
    skin: Skin,
    draws: Draws,
    taxels: Vec<Taxel>,
    step: u32,
}

impl Taxels {
    /// Taxels without a deformation. Thresholds are the same for every sample.
    pub fn new(skin: &Skin, draws: Draws, count: usize) -> Self {
        let taxels = (0..count).map(|k| Taxel {
            threshold: skin.threshold_kpa
                * (1.0 + skin.mismatch * Draws::DEVICE.normal(Purpose::TaxelGain, k as u32, 0)).max(0.2),
            crept: 0.0,
            reference: 0.0,
            silent_until: 0,
        });
        Taxels { skin: skin.clone(), draws, taxels: taxels.collect(), step: 0 }
    }

    /// Runs one tick with this pressure on each taxel; calls `event` for each taxel that responds.
    pub fn step(&mut self, pressure_kpa: &[f64], mut event: impl FnMut(u32, Change)) {
        let skin = &self.skin;
        let tick = f64::from(skin.tick_ms);
        let (creep, follow) = ((tick / skin.creep_ms).min(1.0), (tick / skin.adaptation_ms).min(1.0));
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
                taxel.silent_until = self.step + skin.refractory_ms.div_ceil(skin.tick_ms);
                event(k as u32, if change > 0.0 { Change::Rise } else { Change::Fall });
            }
        }
        self.step += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taxels_are_denser_at_the_centre() {
        let places = layout();
        assert_eq!(places.len(), TAXELS);
        let within = |radius: f64| places.iter().filter(|(x, y)| (x * x + y * y).sqrt() < radius).count() as f64;
        let density = |inner: f64, outer: f64| (within(outer) - within(inner)) / (outer * outer - inner * inner);
        assert!(density(0.0, 2.5) > density(2.5, 6.0) && density(2.5, 6.0) > density(6.0, 9.0));
        // No two in the same place, all on a fingertip of 21 x 37 mm.
        for (k, a) in places.iter().enumerate() {
            assert!(a.0.abs() < 10.5 && a.1.abs() < 18.5);
            assert!(places[..k].iter().all(|b| (a.0 - b.0).abs() + (a.1 - b.1).abs() > 0.5));
        }
    }

    #[test]
    fn the_pressure_of_a_contact_adds_up_to_its_force() {
        // The ellipsoid's mean over the disc is two thirds of its peak.
        for grip in [0.1, 1.0, 8.0] {
            let (radius, peak) = hertz(grip, 7e-3, 1.5);
            let force = 2.0 / 3.0 * peak * std::f64::consts::PI * radius * radius * 1e-3;
            assert!((force / grip - 1.0).abs() < 1e-12);
        }
        assert_eq!(hertz(0.0, 7e-3, 1.5), (0.0, 0.0));
    }

    /// (step, change) of each event of one taxel.
    fn events(skin: &Skin, pressure: impl Fn(u32) -> f64, steps: u32) -> Vec<(u32, Change)> {
        let mut taxels = Taxels::new(skin, Draws::new(1, 0), 1);
        let mut events = Vec::new();
        for step in 0..steps {
            taxels.step(&[pressure(step)], |_, change| events.push((step, change)));
        }
        events
    }

    #[test]
    fn a_taxel_answers_change_and_rests_between_events() {
        let skin = Skin { noise_kpa: 0.0, mismatch: 0.0, ..Skin::default() };
        assert!(events(&skin, |_| 0.0, 500).is_empty());
        let pressed = events(&skin, |t| if (100..600).contains(&t) { 20.0 } else { 0.0 }, 1500);
        assert_eq!(pressed[0], (100, Change::Rise));
        assert!(pressed.windows(2).all(|pair| pair[1].0 - pair[0].0 >= skin.refractory_ms), "{pressed:?}");
        assert!(pressed.iter().all(|&(t, change)| (change == Change::Rise) == (t < 600)), "{pressed:?}");
        // The skin has recovered 95 % within 300 ms; the rest is below the threshold.
        assert!(pressed.iter().all(|&(t, _)| (100..400).contains(&t) || (600..900).contains(&t)), "{pressed:?}");
        assert!(pressed.iter().any(|&(t, _)| t >= 600));
        // A slow ramp is followed: a change of 40 ms stays below the threshold.
        assert!(events(&skin, |t| f64::from(t) * 0.01, 1000).is_empty());
    }
}
