//! The slip scene: a gripper lifts a box whose centre of mass may lie next to the grasp, and it
//! rotates or does not.
//!
//! Input: parameters with a seed. Output: for each sample the spikes of two fingers and of an event
//! camera over 150 ms around the lift, its class (1 when the grasp slides, 0 when it holds) and the
//! onset of sliding. Task and window follow Taunyazov et al. 2020, section VI: 150 steps of 1 ms.
//! The objects look and weigh the same; the grip is strong enough to lift and too weak for an
//! off-centre mass.
//!
//! The camera looks along the grasp axis and moves with the gripper. Motion in the picture: the
//! table's edge while lifting, the box as it sags in the soft fingers, and the box as it
//! rotates. `docs/scenes.md` lists every parameter with its source.

use std::f64::consts::TAU;

use super::camera::{Camera, HEIGHT, Pixels, View, WIDTH};
use super::draw::{Draws, Purpose};
use super::gripper::{
    CONTACT_M, GRAVITY, Grasp, GraspState, KINETIC_RATIO, Motion, SHEAR_N_PER_M, SIZE_M, TWIST_NM_PER_RAD,
    simulate_grasp, torque_limit,
};
use super::markers::MarkerOnsets;
use super::parameter::{parameter, parameters, spread, unknown};
use super::recording::{CameraSpikes, Recording, Senses};
use super::touch::{Skin, TAXELS, Taxels, hertz, layout, press, shift_mm};
use super::wire::Wire;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::stimulus::SceneArg;

/// Milliseconds, which are timesteps, of a sample.
pub const STEPS: u32 = 150;
/// Names of the classes, by label.
pub const CLASSES: [&str; 2] = ["stable", "slip"];
/// Milliseconds simulated before the recording, in which the fingers close.
const BEFORE_MS: u32 = 250;
/// A pixel's size at the box, mm.
const PIXEL_MM: f64 = 0.6;
/// Bricks of the box, across and down.
const BRICKS: (usize, usize) = (2, 2);

parameters! {
    "slip",
    /// The scene's parameters. Each sample takes uniform random values from the ranges.
    pub struct Slip { skin: Skin::default(), pixels: Pixels::default() }
    /// Mass of the box, kg; both classes weigh the same.
    mass_kg: (f64, f64) = (0.11, 0.13), spread(0.001..=10.0);
    /// Normal force of each finger, N.
    grip_n: (f64, f64) = (1.2, 1.8), spread(0.01..=100.0);
    /// Coefficient of static friction.
    friction: (f64, f64) = (0.7, 0.9), spread(0.01..=5.0);
    /// Torque of gravity over the torque that friction bears, for grasps that hold.
    stable_ratio: (f64, f64) = (0.0, 0.35), spread(0.0..=10.0);
    /// Torque of gravity over the torque that friction bears, for grasps that slide.
    slip_ratio: (f64, f64) = (1.25, 1.75), spread(0.0..=10.0);
    /// Start of the lift, ms.
    lift_ms: (f64, f64) = (2.0, 8.0), spread(0.0..=1000.0);
    /// Acceleration of the lift, m/s^2.
    lift_m_per_s2: (f64, f64) = (1.5, 3.0), spread(0.01..=100.0);
    /// Relative amplitude of the arm's vibration in the grip force while it lifts.
    vibration: (f64, f64) = (0.02, 0.09), spread(0.0..=1.0);
    /// Relative standard deviation of the pressure that full sliding causes.
    chatter: (f64, f64) = (0.01, 0.035), spread(0.0..=1.0);
    /// Relative relief of the surface in the pressure.
    relief: (f64, f64) = (0.05, 0.2), spread(0.0..=1.0);
    /// Fraction of the skin's shear stress that a taxel senses; at 0 it senses pressure only.
    shear: f64 = 0.0, parameter(0.0..=1.0);
    /// Width of an edge in the picture by the blur of the lens, pixels.
    edge_px: f64 = 1.0, parameter(1.0..=20.0);
    /// Amplitude of the flicker of the lamps at 100 Hz in the natural logarithm of brightness.
    flicker: f64 = 0.0, parameter(0.0..=1.0);
}

impl Slip {
    /// Recording of a sample by the given senses.
    pub fn recording(&self, sample: u32, senses: Senses) -> Recording {
        let (grasp, motion) = self.course(sample);
        let draws = Draws::new(self.seed, sample);
        let vibration = Vibration::draw(self, draws);
        let sensed = if senses.touch { touch(self, &grasp, &motion, vibration, draws) } else { Vec::new() };
        let (touch, wire) = Wire::transmit_over(self.wire, sensed, STEPS, draws);
        let seen = senses.vision.then(|| vision(self, &grasp, &motion, vibration, draws));
        let CameraSpikes { units, mut planes } = seen.unwrap_or_default();
        planes.sort_unstable();
        Recording {
            steps: STEPS,
            label: u32::from(motion.onset_ms.is_some()),
            onset_ms: motion.onset_ms,
            marker_onsets: Some(MarkerOnsets::new(&motion, draws)),
            touch,
            vision: units,
            vision_planes: planes,
            wire,
        }
    }

    /// Grasp of a sample and motion of the box.
    pub fn course(&self, sample: u32) -> (Grasp, Motion) {
        let grasp = grasp(self, sample);
        let motion = simulate_grasp(&grasp, BEFORE_MS, STEPS);
        (grasp, motion)
    }
}

/// The intended class of a sample: of each two consecutive samples one holds and one slides, in
/// random order. With parameters far from the defaults the recorded outcome may differ.
pub fn label(seed: u64, sample: u32) -> u32 {
    (Draws::new(seed, sample / 2).bits(Purpose::Label, 0, 0) as u32 & 1) ^ (sample & 1)
}

fn grasp(slip: &Slip, sample: u32) -> Grasp {
    let draws = Draws::new(slip.seed, sample);
    let slides = label(slip.seed, sample) == 1;
    let mut grasp = Grasp {
        mass_kg: draws.grasp(0, slip.mass_kg),
        offset_m: 0.0,
        grip_n: draws.grasp(1, slip.grip_n),
        static_friction: draws.grasp(2, slip.friction),
        touch_s: -1e-3 * draws.grasp(3, (130.0, 230.0)),
        lift_s: 1e-3 * draws.grasp(4, slip.lift_ms),
        lift_m_per_s2: draws.grasp(5, slip.lift_m_per_s2),
    };
    let ratio = draws.grasp(6, if slides { slip.slip_ratio } else { slip.stable_ratio });
    let side = if draws.grasp(7, (-1.0, 1.0)) < 0.0 { -1.0 } else { 1.0 };
    let weight = grasp.mass_kg * GRAVITY;
    grasp.offset_m = side * ratio * torque_limit(grasp.static_friction, grasp.grip_n, weight) / weight;
    grasp
}

/// The arm's vibration while it moves: two tones.
#[derive(Debug, Clone, Copy)]
struct Vibration {
    amplitude: f64,
    tones: [(f64, f64); 2],
}

impl Vibration {
    fn draw(slip: &Slip, draws: Draws) -> Vibration {
        let tones = [0, 1].map(|k| {
            let hz = draws.between(Purpose::Arm, 2 * k + 1, (20.0, 70.0));
            (1e-3 * TAU * hz, draws.between(Purpose::Arm, 2 * k + 2, (0.0, TAU)))
        });
        Vibration { amplitude: draws.between(Purpose::Arm, 0, slip.vibration), tones }
    }

    /// Relative vibration of the grip, `ms` after the start of the lift; it builds up in 10 ms.
    fn at(&self, ms: f64) -> f64 {
        if ms <= 0.0 {
            return 0.0;
        }
        let built = (ms / 10.0).min(1.0);
        self.amplitude * built * self.tones.iter().map(|&(rate, phase)| 0.5 * libm::sin(rate * ms + phase)).sum::<f64>()
    }
}

/// The surface that presses on a finger: three waves of a few millimetres.
struct Relief {
    depth: f64,
    waves: [(f64, f64, f64); 3],
}

impl Relief {
    fn draw(slip: &Slip, draws: Draws, finger: u32) -> Relief {
        let waves = [0, 1, 2].map(|k| {
            let [length, turn, phase] = [0, 1, 2].map(|i| draws.unit(Purpose::Relief, finger * 16 + 4 * k + i, 0));
            // Wavelengths of 3 to 8 mm in any direction.
            let (rate, turn) = (TAU / (3.0 + 5.0 * length), TAU * turn);
            (rate * libm::cos(turn), rate * libm::sin(turn), TAU * phase)
        });
        let depth = draws.between(Purpose::Relief, finger * 16 + 15, slip.relief);
        Relief { depth, waves }
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        self.depth / 3.0 * self.waves.iter().map(|&(kx, ky, phase)| libm::cos(kx * x + ky * y + phase)).sum::<f64>()
    }
}

fn touch(slip: &Slip, grasp: &Grasp, motion: &Motion, vibration: Vibration, draws: Draws) -> Vec<(u32, u32)> {
    let places = layout();
    let mut taxels = Taxels::new(&slip.skin, draws, 2 * TAXELS);
    let reliefs = [Relief::draw(slip, draws, 0), Relief::draw(slip, draws, 1)];
    let centres = [(8, 9), (10, 11)].map(|(x, y)| (draws.grasp(x, (-1.0, 1.0)), draws.grasp(y, (-1.0, 1.0))));
    let chatter = draws.grasp(12, slip.chatter);
    let nominal = 1.5;
    let mut pressure = vec![0.0; 2 * TAXELS];
    let mut surface = vec![0.0; 2 * TAXELS];
    let mut posed: Option<(f64, f64)> = None;
    let mut events = Vec::new();
    for (ms, state) in motion.states.iter().enumerate() {
        let t = ms as f64 - f64::from(motion.before_ms);
        if posed.is_none_or(|(angle, sag)| (state.angle_rad - angle).abs() > 1e-4 || (state.sag_m - sag).abs() > 1e-6) {
            posed = Some((state.angle_rad, state.sag_m));
            for (k, height) in surface.iter_mut().enumerate() {
                let (finger, (x, y)) = (k / TAXELS, places[k % TAXELS]);
                // The second finger sees the box from the other side.
                let angle = if finger == 0 { state.angle_rad } else { -state.angle_rad };
                let (sin, cos) = (libm::sin(angle), libm::cos(angle));
                *height = reliefs[finger].at(cos * x + sin * y, -sin * x + cos * y + 1e3 * state.sag_m);
            }
        }
        let grip = state.grip_n * (1.0 + vibration.at(t - 1e3 * grasp.lift_s));
        let traction = Traction::new(grasp, state);
        let (contact, shift_mm) = (hertz(grip, CONTACT_M, nominal), shift_mm(grip, state.load_n));
        press(&mut pressure, &places, contact, centres, shift_mm, |k, (dx, dy), pressed| {
            let mut part = 1.0 + surface[k];
            if state.sliding {
                // Stick and slip of the skin, the stronger the faster it slides, up to 20 mm/s.
                let speed = state.rate_rad_per_s.abs() * (dx * dx + dy * dy).sqrt();
                part += chatter * (speed / 20.0).min(1.0) * draws.normal(Purpose::Sliding, k as u32, ms as u32);
            }
            let (finger, (x, y), pressed) = (k / TAXELS, places[k % TAXELS], pressed * part);
            pressed + slip.shear * traction.at(x, y, finger, pressed)
        });
        taxels.step(&pressure, |taxel, change| {
            if let Some(step) = (ms as u32).checked_sub(motion.before_ms) {
                events.push((step, 2 * taxel + change as u32));
            }
        });
    }
    events
}

/// Shear stress in the skin of a finger by load and twist.
///
/// It is proportional to the displacement of the surface: down by the load, around by the twist.
/// Friction under the local pressure limits it. Beyond the limit the surface slips, first at the
/// rim of the contact.
struct Traction {
    /// Movement of the surface by the load, mm, and by the twist, rad.
    sag_mm: f64,
    twist_rad: f64,
    /// Shear stress by movement, kPa/mm.
    kpa_per_mm: f64,
    friction: f64,
}

impl Traction {
    fn new(grasp: &Grasp, state: &GraspState) -> Traction {
        let area_mm2 = std::f64::consts::PI * (1e3 * CONTACT_M) * (1e3 * CONTACT_M);
        let kinetic = if state.sliding { KINETIC_RATIO } else { 1.0 };
        Traction {
            sag_mm: 1e3 * state.sag_m,
            twist_rad: state.friction_nm / TWIST_NM_PER_RAD,
            // Both fingers share the stiffness; N/mm^3 is 1,000 kPa/mm.
            kpa_per_mm: 0.5 * SHEAR_N_PER_M * 1e-3 / area_mm2 * 1e3,
            friction: grasp.static_friction * kinetic,
        }
    }

    /// The stress at a place of a finger, mm, under a pressure; kPa.
    fn at(&self, x: f64, y: f64, finger: usize, pressed_kpa: f64) -> f64 {
        // The second finger sees the box from the other side.
        let twist = if finger == 0 { self.twist_rad } else { -self.twist_rad };
        let (across, down) = (-twist * y, twist * x + self.sag_mm);
        let stress = self.kpa_per_mm * (across * across + down * down).sqrt();
        stress.min(self.friction * pressed_kpa.max(0.0))
    }
}

/// Positions in the picture: the box, and the table in the background.
#[derive(Debug, Clone, Copy)]
struct Pose {
    sin: f32,
    cos: f32,
    /// The grasp in the picture, which the box turns about, px.
    x: f32,
    y: f32,
    /// Row of the table's edge.
    table: f32,
}

/// Brightness of the background, as a natural logarithm.
const WALL: f32 = 0.0;
const TABLE: f32 = -0.5;

/// Geometry of the box in the picture.
struct BoxGeometry {
    /// The box's left, top, and a brick's width and height, in px from the grasp.
    left: f32,
    top: f32,
    brick: (f32, f32),
    /// Width of an edge, px.
    edge: f32,
}

impl Pose {
    /// The pixel of a place on the box.
    fn place(&self, u: f32, v: f32) -> (f32, f32) {
        (self.x + self.cos * u - self.sin * v, self.y + self.sin * u + self.cos * v)
    }
}

/// The brightness of a brick. Every sample has the same box, whose bricks alternate between lighter
/// and darker.
#[inline(always)]
fn look(behind: f32, row: i32, column: i32) -> f32 {
    let outside = (row == 0) | (column == 0) | (row > BRICKS.1 as i32) | (column > BRICKS.0 as i32);
    let brick = if (row + column) & 1 == 0 { 0.4 } else { 0.65 };
    if outside { behind } else { brick }
}

impl BoxGeometry {
    /// The brightness at the middle of a pixel. Without branches, so that pixels are vectors.
    #[inline(always)]
    fn at(&self, pose: &Pose, x: u32, y: u32) -> f32 {
        let (px, py) = (x as i32 as f32 + 0.5, y as i32 as f32 + 0.5);
        let (dx, dy) = (px - pose.x, py - pose.y);
        let u = (pose.cos * dx + pose.sin * dy - self.left) / self.brick.0;
        let v = (pose.cos * dy - pose.sin * dx - self.top) / self.brick.1;
        let behind = WALL + (TABLE - WALL) * ((py - pose.table) / self.edge + 0.5).clamp(0.0, 1.0);
        let (column, across) = cell(u, self.brick.0 / self.edge, BRICKS.0);
        let (row, down) = cell(v, self.brick.1 / self.edge, BRICKS.1);
        let left = look(behind, row, column);
        let upper = left + (look(behind, row, column + 1) - left) * across;
        let left = look(behind, row + 1, column);
        let lower = left + (look(behind, row + 1, column + 1) - left) * across;
        upper + (lower - upper) * down
    }

    fn draw(draws: Draws, edge_px: f64) -> (BoxGeometry, f32, f32) {
        let (width, height) = (SIZE_M.0 * 1e3 / PIXEL_MM, SIZE_M.1 * 1e3 / PIXEL_MM);
        let jitter = [0, 1].map(|k| draws.between(Purpose::Look, k, (-4.0, 4.0)));
        let look = BoxGeometry {
            left: (-0.5 * width + jitter[0]) as f32,
            top: (-0.5 * height + jitter[1]) as f32,
            brick: ((width / BRICKS.0 as f64) as f32, (height / BRICKS.1 as f64) as f32),
            edge: edge_px as f32,
        };
        (look, 100.0, 110.0)
    }

    /// Greatest distance from an edge at which a pixel may see it, px.
    fn reach(&self) -> f32 {
        1.2 + 0.5 * (self.edge - 1.0)
    }

    /// Stores the pixels near edges of this pose in `near`.
    fn near_edges(&self, pose: &Pose, table_moves: bool, near: &mut Vec<u32>) {
        near.clear();
        let reach = self.reach();
        let (width, height) = (self.brick.0 * BRICKS.0 as f32, self.brick.1 * BRICKS.1 as f32);
        for k in 0..=BRICKS.0 {
            let u = self.left + self.brick.0 * k as f32;
            line(pose.place(u, self.top), pose.place(u, self.top + height), reach, near);
        }
        for k in 0..=BRICKS.1 {
            let v = self.top + self.brick.1 * k as f32;
            line(pose.place(self.left, v), pose.place(self.left + width, v), reach, near);
        }
        if table_moves {
            line((0.0, pose.table), (WIDTH as f32, pose.table), reach, near);
        }
    }
}

/// Cell before a position in bricks, and the fraction of the next cell that the pixel sees.
#[inline(always)]
fn cell(place: f32, pixels: f32, bricks: usize) -> (i32, f32) {
    let nearest = (place.clamp(0.0, bricks as f32) + 0.5) as i32;
    (nearest, ((place - nearest as f32) * pixels + 0.5).clamp(0.0, 1.0))
}

/// Appends the pixels within `reach` of the points at which a line crosses a row or a column.
fn line(from: (f32, f32), to: (f32, f32), reach: f32, near: &mut Vec<u32>) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let steep = dy.abs() > dx.abs();
    let (a, b, slope) = if steep { (from.1, to.1, dx / dy) } else { (from.0, to.0, dy / dx) };
    let start = if steep { from.0 - slope * from.1 } else { from.1 - slope * from.0 };
    let (most_along, most_across) = if steep { (HEIGHT, WIDTH) } else { (WIDTH, HEIGHT) };
    let first = (a.min(b) - 1.0).max(0.0) as usize;
    let last = ((a.max(b) + 1.0).max(0.0) as usize).min(most_along - 1);
    for along in first..=last {
        let across = start + slope * (along as f32 + 0.5);
        if across < -reach - 0.3 || across >= most_across as f32 + reach + 0.3 {
            continue;
        }
        for other in (across - reach).max(0.0) as usize..((across + reach + 1.0) as usize).min(most_across) {
            let (x, y) = if steep { (other, along) } else { (along, other) };
            near.push((y * WIDTH + x) as u32);
        }
    }
}

/// The box at a pose, under the lamps.
#[derive(Clone, Copy)]
struct SlipView<'a> {
    look: &'a BoxGeometry,
    pose: Pose,
    flicker: f32,
}

impl View for SlipView<'_> {
    #[inline(always)]
    fn at(&self, x: u32, y: u32) -> f32 {
        self.look.at(&self.pose, x, y) + self.flicker
    }
}

fn vision(slip: &Slip, grasp: &Grasp, motion: &Motion, vibration: Vibration, draws: Draws) -> CameraSpikes {
    let (look, x, y) = BoxGeometry::draw(draws, slip.edge_px);
    let tilt = draws.between(Purpose::Look, 2, (-0.02, 0.02));
    let bottom = y + look.top + look.brick.1 * BRICKS.1 as f32;
    let pose = |state: &GraspState, t: f64| {
        let angle = tilt + state.angle_rad;
        // The arm shakes by 0.1 mm where the grip force shakes by a tenth.
        let shake = vibration.at(t - 1e3 * grasp.lift_s) * 1.0 / PIXEL_MM;
        Pose {
            sin: libm::sin(angle) as f32,
            cos: libm::cos(angle) as f32,
            x,
            y: y + (1e3 * state.sag_m / PIXEL_MM) as f32,
            table: bottom + (1e3 * state.lift_m / PIXEL_MM + shake) as f32,
        }
    };
    let states = motion.recorded_states();
    let rest = pose(&states[0], -1.0);
    let mut camera = Camera::new(&slip.pixels, draws);
    let lamps = draws.between(Purpose::Look, 3, (0.0, TAU));
    let (mut near, mut shown) = (Vec::new(), rest);
    let mut seen = CameraSpikes::default();
    for (step, state) in states.iter().enumerate() {
        let now = pose(state, step as f64);
        let turned = (now.sin - shown.sin).abs() * 93.0 + (now.y - shown.y).abs();
        let moved = (now.table - shown.table).abs();
        near.clear();
        if turned > 0.1 || moved > 0.1 {
            // The box hides parts of the table's edge, so both are updated together.
            if turned > 0.1 {
                look.near_edges(&now, moved > 0.0, &mut near);
            } else {
                line((0.0, now.table), (WIDTH as f32, now.table), look.reach(), &mut near);
            }
            shown = now;
        }
        let flicker = match slip.flicker {
            0.0 => 0.0,
            // All pixels see the lamps.
            depth => {
                near.clear();
                near.extend(0..(WIDTH * HEIGHT) as u32);
                (depth * libm::sin(lamps + 0.1 * TAU * step as f64)) as f32
            }
        };
        camera.step(
            &near,
            SlipView { look: &look, pose: rest, flicker: 0.0 },
            SlipView { look: &look, pose: shown, flicker },
            |unit, polarities| seen.add(step as u32, unit, polarities),
        );
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Slip> {
        Slip::parse(&SceneArg::parse(text).unwrap())
    }

    #[test]
    fn classes_are_balanced_and_come_about_as_they_are_meant() {
        for seed in [1, 2, 77] {
            let slip = Slip { seed, ..Slip::default() };
            let mut slides = 0;
            for sample in 0..500 {
                let (grasp, motion) = slip.course(sample);
                assert_eq!(motion.onset_ms.is_some(), label(seed, sample) == 1, "{seed} {sample} {grasp:?}");
                slides += label(seed, sample);
                if let Some(onset) = motion.onset_ms {
                    assert!((25.0..75.0).contains(&onset), "{onset}");
                    // Visible well before 100 ms: the box's corner is 56 mm away, so a degree moves
                    // it by more than a pixel.
                    assert!(motion.recorded_states()[100].angle_rad.abs() > 0.02);
                } else {
                    assert!(motion.states.iter().all(|state| state.angle_rad.abs() < 0.03));
                }
            }
            assert_eq!(slides, 250);
        }
    }

    #[test]
    fn densities_lie_where_the_sensors_have_them() {
        for seed in [1, 2, 3] {
            let slip = Slip { seed, ..Slip::default() };
            let (mut touch, mut vision) = (0, 0);
            for sample in 0..40 {
                let recording = slip.recording(sample, Senses::BOTH);
                assert!(recording.touch.iter().all(|&(step, channel)| step < STEPS && channel < 156));
                assert!(recording.vision.windows(2).all(|pair| pair[0] < pair[1]));
                assert!(recording.vision.iter().all(|&(step, channel)| step < STEPS && channel < 3150));
                let planes = &recording.vision_planes;
                assert!(planes.windows(2).all(|pair| pair[0] < pair[1]) && planes.len() > recording.vision.len());
                touch += recording.touch.len();
                vision += recording.vision.len();
            }
            let density = |spikes: usize, channels: u32| spikes as f64 / f64::from(40 * STEPS * channels);
            let (touch, vision) = (density(touch, 156), density(vision, 3150));
            assert!((0.005..0.05).contains(&touch), "touch {touch}");
            assert!((0.002..0.03).contains(&vision), "vision {vision}");
        }
    }

    #[test]
    fn without_noise_motion_or_change_nothing_spikes() {
        let still = parse("slip?touch_noise_kpa=0&pixel_noise_hz=0&lift_ms=1000&vibration=0&samples=4&adaptation_ms=1");
        for sample in 0..4 {
            let recording = still.as_ref().unwrap().recording(sample, Senses::BOTH);
            assert_eq!((recording.touch.len(), recording.vision.len()), (0, 0));
            assert_eq!((recording.label, recording.onset_ms), (0, None));
        }
    }

    #[test]
    fn skin_that_senses_shear_answers_the_lift_first_and_a_blurred_edge_is_seen_later() {
        // Mean step of the tenth event.
        let tenth = |text: &str, touch: bool| {
            let slip = parse(text).unwrap();
            let of = |sample| {
                let recording = slip.recording(sample, Senses::BOTH);
                let events = if touch { recording.touch } else { recording.vision };
                f64::from(events.get(9).map_or(STEPS, |event| event.0))
            };
            (0..20).map(of).sum::<f64>() / 20.0
        };
        let quiet = "slip?touch_noise_kpa=0&pixel_noise_hz=0&vibration=0&lift_ms=5&adaptation_ms=5";
        let (pressure, shear) = (tenth(quiet, true), tenth(&format!("{quiet}&shear=0.32"), true));
        let (sharp, blurred) = (tenth(quiet, false), tenth(&format!("{quiet}&edge_px=3"), false));
        assert!(shear < pressure && sharp < blurred, "{shear} {pressure}, {sharp} {blurred}");
        assert!(shear < blurred, "{shear} {blurred}");
    }

    #[test]
    fn lamps_that_flicker_beyond_the_contrast_are_seen_everywhere() {
        let still = "slip?touch_noise_kpa=0&pixel_noise_hz=0&lift_ms=1000&vibration=0&samples=1";
        let spikes = |flicker: &str| {
            parse(&format!("{still}&flicker={flicker}")).unwrap().recording(0, Senses::BOTH).vision.len()
        };
        assert_eq!(spikes("0.05"), 0);
        assert!(spikes("0.5") > 3150 * 15);
    }

    #[test]
    fn skin_bears_no_more_shear_than_friction() {
        let (grasp, motion) = Slip::default().course(1);
        let state = motion.states.last().unwrap();
        let traction = Traction::new(&grasp, state);
        for (x, y) in layout() {
            assert!(traction.at(x, y, 0, 3.0) <= grasp.static_friction * 3.0);
        }
        assert_eq!(traction.at(3.0, 0.0, 1, 0.0), 0.0);
    }

    #[test]
    fn parameters_are_checked() {
        let slip = parse("slip?samples=3&seed=9&mass_kg=0.2&grip_n=1.5..2").unwrap();
        assert_eq!((slip.samples, slip.seed, slip.mass_kg, slip.grip_n), (3, 9, (0.2, 0.2), (1.5, 2.0)));
        for bad in ["samples=0", "weight=1", "mass_kg=2..1", "mass_kg=-1", "mass_kg=x..1", "contrast=nan"] {
            assert_eq!(parse(&format!("slip?{bad}")).unwrap_err().code, "scene.parameter", "{bad}");
        }
        for key in Slip::KEYS {
            assert!(parse(&format!("slip?{key}=1")).is_ok(), "{key}");
        }
    }
}
