//! The container scene: a gripper closes on one of four containers with one of five fill levels,
//! lifts and holds it.
//!
//! Input: parameters with a seed. Output: for each sample the spikes of two fingers and of an event
//! camera in 325 bins of 20 ms. Task, containers, largest fills and times follow Taunyazov et al.
//! 2020, section V. There the recording begins at 2.0 s, just before the gripper closes. The
//! fingers touch the container at about 4 s; it is lifted by 5 cm from 6 s to 8 s and held until
//! 8.5 s.
//!
//! Touch depends on stiffness (how fast the force grows), width (when the fingers make contact) and
//! weight (how far the load moves the pressure, and sloshing). Vision depends on the outline and
//! the label, the deformation of soft walls, how far the arm sinks, and the level in the clear
//! bottle. No single cue separates all 20 classes: variation of the grasp blurs each.
//! `docs/scenes.md` lists every parameter with its source.

use std::f64::consts::TAU;
use std::ops::Range;

use super::camera::{Camera, HEIGHT, Pixels, View, WIDTH};
use super::draw::{Draws, Purpose};
use super::gripper::GRAVITY;
use super::parameter::{parameter, parameters, spread, unknown};
use super::recording::{CameraSpikes, Recording, Senses};
use super::touch::{Skin, TAXELS, Taxels, hertz, layout, press, shift_mm};
use super::wire::Wire;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::stimulus::SceneArg;

/// Bins, which are timesteps, of a sample.
pub const STEPS: u32 = 325;
/// Milliseconds of a bin.
pub const BIN_MS: u32 = 20;
/// Sampling interval of the taxels and the camera, ms.
const TICK_MS: u32 = 5;
/// A pixel's size at the container, mm.
const PIXEL_MM: f64 = 0.9;
/// Fill levels of each container.
const LEVELS: u32 = 5;

/// Properties of one container.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Container {
    name: &'static str,
    /// Width between the fingers, mm.
    width_mm: f64,
    height_mm: f64,
    /// Stiffness of its walls under the fingers, N/m, when it is empty.
    stiffness_n_per_m: f64,
    /// Relative increase of the stiffness from empty to full.
    stiffened: f64,
    empty_kg: f64,
    /// Largest fill, kg (the paper's).
    fill_kg: f64,
    /// Fraction of the fill that sloshes.
    sloshes: f64,
    /// Contrast of the label against the wall; its top and bottom as fractions of the height.
    label: (f32, f64, f64),
    /// Contrast of the surface of the fill, seen through the wall.
    level: f32,
}

/// Widths and heights of common articles; stiffness in the paper's order, the carton softest.
const CONTAINERS: [Container; 4] = [
    Container {
        name: "coffee-can",
        width_mm: 66.0,
        height_mm: 115.0,
        stiffness_n_per_m: 18_000.0,
        stiffened: 0.2,
        empty_kg: 0.03,
        fill_kg: 0.25,
        sloshes: 0.0,
        label: (0.5, 0.2, 0.7),
        level: 0.0,
    },
    Container {
        name: "plastic-bottle",
        width_mm: 63.0,
        height_mm: 200.0,
        stiffness_n_per_m: 5_000.0,
        stiffened: 0.6,
        empty_kg: 0.025,
        fill_kg: 0.4,
        sloshes: 1.0,
        label: (0.6, 0.35, 0.6),
        level: 0.25,
    },
    Container {
        name: "soy-carton",
        width_mm: 60.0,
        height_mm: 100.0,
        stiffness_n_per_m: 2_000.0,
        stiffened: 1.0,
        empty_kg: 0.012,
        fill_kg: 0.3,
        sloshes: 1.0,
        label: (0.3, 0.1, 0.5),
        level: 0.0,
    },
    Container {
        name: "tuna-can",
        width_mm: 85.0,
        height_mm: 40.0,
        stiffness_n_per_m: 40_000.0,
        stiffened: 0.0,
        empty_kg: 0.04,
        fill_kg: 0.14,
        sloshes: 0.0,
        label: (0.4, 0.3, 0.8),
        level: 0.0,
    },
];

parameters! {
    "container",
    /// The scene's parameters. Each sample takes uniform random values from the ranges.
    pub struct Containers {
        skin: Skin { threshold_kpa: 0.3, noise_kpa: 0.05, adaptation_ms: 200.0, tick_ms: TICK_MS, ..Skin::default() },
        pixels: Pixels { noise_hz: 0.01, tick_ms: TICK_MS as u16, ..Pixels::default() }
    }
    /// Largest normal force of each finger, N.
    grip_n: (f64, f64) = (6.7, 7.3), spread(0.01..=100.0);
    /// Speed at which each finger closes, m/s.
    closing_m_per_s: (f64, f64) = (0.0185, 0.0195), spread(0.001..=1.0);
    /// Time at which the fingers begin to close, s.
    closing_s: (f64, f64) = (0.0, 0.06), spread(0.0..=10.0);
    /// Start of the lift, s.
    lift_s: (f64, f64) = (3.95, 4.1), spread(0.0..=10.0);
    /// Vertical distance of the grasp from the container's middle, mm; positive is below.
    grasp_mm: (f64, f64) = (-1.5, 1.5), spread(-50.0..=50.0);
    /// Deviation of a container's fill from its level, as a fraction of the largest fill.
    fill_error: (f64, f64) = (-0.03, 0.03), spread(-1.0..=1.0);
    /// Relative amplitude of the arm's vibration in the grip force while it lifts.
    vibration: (f64, f64) = (0.001, 0.004), spread(0.0..=1.0);
    /// Amplitude of the arm's shaking in the picture after contact and while it lifts, mm.
    shake_mm: (f64, f64) = (0.2, 0.4), spread(0.0..=20.0);
    /// Events that a channel needs in a bin to spike: the paper's S_min.
    s_min: u32 = 1, parameter(1..=1000);
}

/// Class of a sample. Each block of 20 consecutive samples has each class once, in random order.
pub fn label(seed: u64, sample: u32) -> u32 {
    let classes = CONTAINERS.len() as u32 * LEVELS;
    let draws = Draws::new(seed, sample / classes);
    let mut order: Vec<u32> = (0..classes).collect();
    order.sort_by_key(|&class| (draws.bits(Purpose::Label, class, 0), class));
    order[(sample % classes) as usize]
}

/// Names of the classes, by label.
pub fn classes() -> Vec<String> {
    let levels =
        |container: &Container| (0..LEVELS).map(|k| format!("{}-{}", container.name, 25 * k)).collect::<Vec<_>>();
    CONTAINERS.iter().flat_map(levels).collect()
}

/// Parameters of one sample's grasp.
#[derive(Debug, Clone)]
struct GraspPlan {
    container: Container,
    fill: f64,
    mass_kg: f64,
    /// Stiffness of skin and wall in series, N/m, and of the wall alone.
    stiffness: f64,
    wall: f64,
    grip_n: f64,
    closing_s: f64,
    closing_m_per_s: f64,
    contact_s: f64,
    lift_s: f64,
    vibration: f64,
    shake_mm: f64,
    tones: [(f64, f64); 2],
    slosh: (f64, f64, f64),
}

/// The grasp at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
struct GraspMoment {
    grip_n: f64,
    load_n: f64,
    /// Gap between the fingers, mm.
    gap_mm: f64,
    /// Dent in each wall, mm.
    dent_mm: f64,
    lift_mm: f64,
    sag_mm: f64,
    /// Waveform of the arm's shaking, -1..=1.
    tone: f64,
    /// Amplitude of the shaking, 0..=1.
    shaking: f64,
}

/// Stiffness of a finger's skin along the grip, N/m; `SHEAR_N_PER_M`: of both against a load.
const SKIN_N_PER_M: f64 = 6_000.0;
const SHEAR_N_PER_M: f64 = 2_200.0;
/// Stiffness of the arm against a load, N/m.
const ARM_N_PER_M: f64 = 2_500.0;
/// Opening of the gripper, mm (Robotiq 2F-140).
const OPENING_MM: f64 = 140.0;

impl GraspPlan {
    fn at(&self, t: f64) -> GraspMoment {
        let closed = 2e3 * self.closing_m_per_s * (t - self.closing_s).max(0.0);
        let press = self.closing_m_per_s * (t - self.contact_s).max(0.0);
        let grip_n = (self.stiffness * press).min(self.grip_n);
        let dent_mm = 1e3 * grip_n / self.wall;
        // Fifth-order polynomial without a jerk at its ends, 5 cm in 2 s.
        let s = ((t - self.lift_s) / 2.0).clamp(0.0, 1.0);
        let lift_mm = 50.0 * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
        let weight = self.mass_kg * GRAVITY;
        let borne = (SHEAR_N_PER_M * 1e-3 * lift_mm).min(weight);
        let since = t - self.lift_s;
        let (part, hz, phase) = self.slosh;
        let slosh = if since > 0.0 {
            part * libm::sin(TAU * hz * since + phase) * libm::exp(-since / 1.2) * (since / 0.2).min(1.0)
        } else {
            0.0
        };
        let load_n = borne * (1.0 + slosh);
        // Contact and lift start a shaking of the arm with a decay time constant of 0.5 s.
        let moving = if (0.0..2.0).contains(&since) { 0.5 } else { 0.0 };
        let shaking = (ring(t - self.contact_s) + ring(since)).max(moving).min(1.0);
        let tone = self.tones.iter().map(|&(hz, phase)| 0.5 * libm::sin(TAU * hz * t + phase)).sum();
        GraspMoment {
            grip_n,
            load_n,
            gap_mm: (OPENING_MM - closed).max(self.container.width_mm - 2.0 * dent_mm),
            dent_mm,
            lift_mm,
            sag_mm: 1e3 * load_n / SHEAR_N_PER_M,
            tone,
            shaking,
        }
    }
}

/// The shaking of the arm some seconds after a push.
fn ring(since: f64) -> f64 {
    if since < 0.0 { 0.0 } else { (since / 0.02).min(1.0) * libm::exp(-since / 0.5) }
}

impl Containers {
    /// Recording of a sample by the given senses.
    pub fn recording(&self, sample: u32, senses: Senses) -> Recording {
        let draws = Draws::new(self.seed, sample);
        let label = label(self.seed, sample);
        let course = self.course(draws, label);
        let ticks = STEPS * BIN_MS / TICK_MS;
        let moments: Vec<GraspMoment> = (0..ticks).map(|k| course.at(1e-3 * f64::from(k * TICK_MS))).collect();
        let sensed = if senses.touch { self.touch(&course, &moments, draws) } else { Vec::new() };
        let (touch, wire) = match self.wire {
            None => (sensed, None),
            Some(_) => {
                // An event is sent in a random millisecond of its tick.
                let sent = sensed.into_iter().map(|(tick, channel)| {
                    let ms = draws.bits(Purpose::Wire, channel + (1 << 19), tick) as u32 % TICK_MS;
                    (tick * TICK_MS + ms, channel)
                });
                let (decoded, wire) = Wire::transmit_over(self.wire, sent.collect(), ticks * TICK_MS, draws);
                (decoded.into_iter().map(|(ms, channel)| (ms / TICK_MS, channel)).collect(), wire)
            }
        };
        let seen = senses.vision.then(|| self.vision(&course, &moments, draws));
        let CameraSpikes { units, planes } = seen.unwrap_or_default();
        Recording {
            steps: STEPS,
            label,
            onset_ms: Some(1e3 * course.contact_s),
            marker_onsets: None,
            touch: binned(&touch, self.s_min),
            vision: binned(&units, self.s_min),
            vision_planes: binned(&planes, self.s_min),
            wire,
        }
    }

    fn course(&self, draws: Draws, label: u32) -> GraspPlan {
        let container = CONTAINERS[(label / LEVELS) as usize];
        let level = f64::from(label % LEVELS) / f64::from(LEVELS - 1);
        let fill = (level + draws.grasp(0, self.fill_error)).clamp(0.0, 1.05);
        let wall = container.stiffness_n_per_m * (1.0 + container.stiffened * fill) * draws.grasp(1, (0.9, 1.1));
        let (closing_s, closing_m_per_s) = (draws.grasp(2, self.closing_s), draws.grasp(3, self.closing_m_per_s));
        let contact_s = closing_s + 0.5e-3 * (OPENING_MM - container.width_mm) / closing_m_per_s;
        let tones = [0, 2]
            .map(|k| (draws.between(Purpose::Arm, k, (4.0, 14.0)), draws.between(Purpose::Arm, k + 1, (0.0, TAU))));
        GraspPlan {
            container,
            fill,
            mass_kg: container.empty_kg + fill * container.fill_kg,
            stiffness: 1.0 / (1.0 / SKIN_N_PER_M + 1.0 / wall),
            wall,
            grip_n: draws.grasp(4, self.grip_n),
            closing_s,
            closing_m_per_s,
            contact_s,
            lift_s: draws.grasp(5, self.lift_s),
            vibration: draws.grasp(6, self.vibration),
            shake_mm: draws.grasp(7, self.shake_mm),
            tones,
            // A half-full container sloshes most; liquid 6 cm wide swings at about 3.5 Hz.
            slosh: (
                0.3 * container.sloshes * 4.0 * fill.min(1.0) * (1.0 - fill.min(1.0)),
                draws.grasp(8, (3.0, 4.0)),
                draws.grasp(9, (0.0, TAU)),
            ),
        }
    }

    /// (tick, channel) of the taxels' events.
    fn touch(&self, course: &GraspPlan, moments: &[GraspMoment], draws: Draws) -> Vec<(u32, u32)> {
        let places = layout();
        let mut taxels = Taxels::new(&self.skin, draws, 2 * TAXELS);
        let centres = [(16, 17), (18, 19)].map(|(x, y)| (draws.grasp(x, (-0.5, 0.5)), draws.grasp(y, (-0.5, 0.5))));
        let mut pressure = vec![0.0; 2 * TAXELS];
        let mut events = Vec::new();
        for (tick, moment) in moments.iter().enumerate() {
            let grip = moment.grip_n * (1.0 + course.vibration * moment.shaking * moment.tone);
            let shift_mm = shift_mm(grip, moment.load_n);
            press(&mut pressure, &places, hertz(grip, 8e-3, 7.0), centres, shift_mm, |_, _, pressed| pressed);
            taxels.step(&pressure, |taxel, change| events.push((tick as u32, 2 * taxel + change as u32)));
        }
        events
    }

    /// The pooled camera's spikes, by tick.
    fn vision(&self, course: &GraspPlan, moments: &[GraspMoment], draws: Draws) -> CameraSpikes {
        let offset = draws.grasp(20, self.grasp_mm);
        let rest = Picture::new(course, &moments[0], offset);
        let mut camera = Camera::new(&self.pixels, draws);
        let (mut near, mut shown) = (Vec::new(), rest);
        let mut seen = CameraSpikes::default();
        for (tick, moment) in moments.iter().enumerate() {
            let now = Picture::new(course, moment, offset);
            near.clear();
            if now.differs(&shown) {
                now.near_edges(&shown, &mut near);
                shown = now;
            }
            camera.step(&near, rest, shown, |unit, polarities| seen.add(tick as u32, unit, polarities));
        }
        seen
    }
}

/// Spikes as (bin, channel), sorted: by the paper's rule, a channel with S_min events in a bin.
fn binned(events: &[(u32, u32)], s_min: u32) -> Vec<(u32, u32)> {
    let mut bins: Vec<(u32, u32)> = events.iter().map(|&(tick, channel)| (tick * TICK_MS / BIN_MS, channel)).collect();
    bins.sort_unstable();
    bins.chunk_by(|a, b| a == b).filter(|same| same.len() >= s_min as usize).map(|same| same[0]).collect()
}

/// The camera's view, from back to front: the table, the container with its label and fill, the
/// fingers. All edges are vertical or horizontal; positions are in px.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Picture {
    table: f32,
    /// Left, right, top, bottom of the container.
    body: [f32; 4],
    label: (f32, f32, f32),
    /// Contrast and row of the surface of the fill.
    level: (f32, f32),
    /// Inner edges of the fingers, and their top and bottom.
    fingers: [f32; 4],
}

/// Fraction of a pixel that lies past an edge, 0..=1.
#[inline]
fn fraction_past(place: f32, edge: f32) -> f32 {
    (place - edge + 0.5).clamp(0.0, 1.0)
}

fn px(mm: f64) -> f32 {
    (mm / PIXEL_MM) as f32
}

/// Pixels near a part of an axis.
fn span(from: f32, to: f32, most: usize) -> Range<usize> {
    (from - 2.0).max(0.0) as usize..((to + 2.0).max(0.0) as usize).min(most)
}

/// Pixels near the way of an edge.
fn between(a: f32, b: f32, most: usize) -> Range<usize> {
    span(a.min(b), a.max(b) + 0.2, most)
}

fn fill(near: &mut Vec<u32>, columns: &Range<usize>, rows: Range<usize>) {
    for y in rows {
        near.extend(columns.clone().map(|x| (y * WIDTH + x) as u32));
    }
}

impl View for Picture {
    #[inline(always)]
    fn at(&self, x: u32, y: u32) -> f32 {
        let (x, y) = (x as i32 as f32 + 0.5, y as i32 as f32 + 0.5);
        let [left, right, top, bottom] = self.body;
        let mut seen = -0.5 * fraction_past(y, self.table);
        let inside =
            (fraction_past(x, left) - fraction_past(x, right)) * (fraction_past(y, top) - fraction_past(y, bottom));
        if inside > 0.0 {
            let wall = 0.5 + self.label.0 * (fraction_past(y, self.label.1) - fraction_past(y, self.label.2))
                - self.level.0 * fraction_past(y, self.level.1);
            seen += (wall - seen) * inside;
        }
        let [inner_left, inner_right, upper, lower] = self.fingers;
        let finger = (1.0 - fraction_past(x, inner_left) + fraction_past(x, inner_right))
            * (fraction_past(y, upper) - fraction_past(y, lower));
        seen + (-0.9 - seen) * finger
    }
}

impl Picture {
    fn new(course: &GraspPlan, moment: &GraspMoment, offset_mm: f64) -> Picture {
        let (middle, grasp) = (100.0f32, 120.0f32);
        // The camera is mounted on the arm. So the table and a standing container shake in the
        // picture; a lifted container moves with the fingers.
        let arm = course.shake_mm * moment.shaking * moment.tone - 1e3 * moment.load_n / ARM_N_PER_M;
        let held = if moment.lift_mm > 0.3 { 0.2 } else { 1.0 };
        let swing = px(course.shake_mm * moment.shaking * moment.tone * held);
        let container = &course.container;
        let half = px(0.5 * container.width_mm) + 0.3 * px(moment.dent_mm);
        let top = grasp - px(0.5 * container.height_mm + offset_mm) + swing + px(moment.sag_mm);
        let height = px(container.height_mm);
        let [label_top, label_bottom, level] =
            [container.label.1, container.label.2, 1.0 - 0.9 * course.fill].map(|part| top + part as f32 * height);
        let shift = 0.5 * swing;
        let gap = 0.5 * px(moment.gap_mm);
        Picture {
            table: grasp + px(0.5 * container.height_mm - offset_mm + moment.lift_mm + arm),
            body: [middle - half + shift, middle + half + shift, top, top + height],
            label: (container.label.0, label_top, label_bottom),
            level: (container.level, level),
            fingers: [middle - gap, middle + gap, grasp - 15.0, grasp + 15.0],
        }
    }

    fn edges(&self) -> [f32; 12] {
        let [a, b, c, d] = self.body;
        let [e, f, g, h] = self.fingers;
        [self.table, a, b, c, d, self.label.1, self.label.2, self.level.1, e, f, g, h]
    }

    fn differs(&self, shown: &Picture) -> bool {
        self.edges().iter().zip(shown.edges()).any(|(now, then)| (now - then).abs() > 0.1)
    }

    /// Appends the pixels near edges that have moved since picture `then`.
    fn near_edges(&self, then: &Picture, near: &mut Vec<u32>) {
        let [left, right, top, bottom] = self.body;
        if self.table != then.table {
            fill(near, &(0..WIDTH), between(self.table, then.table, HEIGHT));
        }
        for (now, then) in [(left, then.body[0]), (right, then.body[1])] {
            if now != then {
                fill(near, &between(now, then, WIDTH), span(top, bottom, HEIGHT));
            }
        }
        let rows = [
            (top, then.body[2], 1.0),
            (bottom, then.body[3], 1.0),
            (self.label.1, then.label.1, 1.0),
            (self.label.2, then.label.2, 1.0),
            (self.level.1, then.level.1, self.level.0),
        ];
        for (now, then, contrast) in rows {
            if now != then && contrast != 0.0 {
                fill(near, &span(left, right, WIDTH), between(now, then, HEIGHT));
            }
        }
        for (now, then) in [(self.fingers[0], then.fingers[0]), (self.fingers[1], then.fingers[1])] {
            if now != then {
                fill(near, &between(now, then, WIDTH), span(self.fingers[2], self.fingers[3], HEIGHT));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_twenty_samples_show_each_class_once() {
        for block in 0..5 {
            let mut seen: Vec<u32> = (20 * block..20 * block + 20).map(|sample| label(3, sample)).collect();
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..20));
        }
        assert_eq!(classes().len(), 20);
        assert_eq!((&*classes()[0], &*classes()[19]), ("coffee-can-0", "tuna-can-100"));
    }

    #[test]
    fn a_bin_spikes_from_s_min_events_on() {
        let draws = Draws::new(5, 0);
        let events: Vec<(u32, u32)> = (0..4000)
            .map(|k| {
                ((draws.unit(Purpose::Look, k, 0) * 100.0) as u32, (draws.unit(Purpose::Look, k, 1) * 50.0) as u32)
            })
            .collect();
        for s_min in [1, 2, 3, 5] {
            let spikes = binned(&events, s_min);
            for bin in 0..25 {
                for channel in 0..50 {
                    let inside = |&&(tick, of): &&(u32, u32)| of == channel && (4 * bin..4 * bin + 4).contains(&tick);
                    let count = events.iter().filter(inside).count();
                    assert_eq!(spikes.contains(&(bin, channel)), count >= s_min as usize);
                }
            }
            assert!(spikes.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }

    #[test]
    fn stiffer_grips_faster_and_fuller_weighs_more() {
        let set = Containers::default();
        for sample in 0..20 {
            let draws = Draws::new(1, sample);
            let of = |label| set.course(draws, label);
            // Same draws, so only the class differs.
            for container in 0..4 {
                let masses: Vec<f64> = (0..5).map(|level| of(5 * container + level).mass_kg).collect();
                assert!(masses.windows(2).all(|pair| pair[0] < pair[1]));
            }
            let (can, bottle, carton, tuna) = (of(2), of(7), of(12), of(17));
            let courses = [carton, bottle, can, tuna];
            assert!(courses.windows(2).all(|pair| pair[0].stiffness < pair[1].stiffness));
            // The wider meets the fingers sooner.
            assert!(courses.windows(2).all(|pair| pair[0].contact_s > pair[1].contact_s));
            for course in courses {
                let end = course.at(6.5);
                assert!((end.lift_mm - 50.0).abs() < 1e-9 && end.grip_n == course.grip_n);
                // The friction of silicone (0.7 at least) holds the load.
                assert!(2.0 * 0.7 * end.grip_n > end.load_n);
                assert_eq!(course.at(course.contact_s - 1e-6).grip_n, 0.0);
                assert_eq!(course.at(course.lift_s - 1e-6).load_n, 0.0);
            }
        }
    }

    #[test]
    fn recordings_lie_within_their_bins_and_repeat() {
        let set = Containers { seed: 4, ..Containers::default() };
        for sample in 0..4 {
            let recording = set.recording(sample, Senses::BOTH);
            assert_eq!(recording, set.recording(sample, Senses::BOTH));
            let contact = (recording.onset_ms.unwrap() / f64::from(BIN_MS)) as u32;
            assert!(recording.touch.iter().all(|&(bin, channel)| bin < STEPS && channel < 156 && bin + 1 >= contact));
            assert!(recording.vision.iter().all(|&(bin, channel)| bin < STEPS && channel < 3150));
            assert!(recording.vision_planes.iter().all(|&(bin, channel)| bin < STEPS && channel < 6300));
            assert!(recording.touch.len() > 200 && recording.vision.len() > 2000);
        }
    }

    #[test]
    fn parameters_are_checked() {
        let parse = |text: &str| Containers::parse(&SceneArg::parse(text).unwrap());
        for key in Containers::KEYS {
            assert!(parse(&format!("container?{key}=1")).is_ok(), "{key}");
        }
        for bad in ["samples=0", "weight=1", "lift_s=2..1", "s_min=0"] {
            assert_eq!(parse(&format!("container?{bad}")).unwrap_err().code, "scene.parameter", "{bad}");
        }
    }
}
