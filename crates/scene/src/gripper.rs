//! A gripper that holds a box between two soft fingers and lifts it: forces on the contact and the
//! box's rotation.
//!
//! Input: a [`Grasp`]. Output: a [`Motion`], the state at the end of each millisecond from the
//! closing of the fingers on. The model: the fingers' skin is a spring for vertical load and for
//! twist about the axis through the fingertips; the contact is a soft finger whose friction bears a
//! torque up to a limit that a vertical load lowers (Howe and Cutkosky, "Practical force-motion
//! models for sliding manipulation", IJRR 1996: an ellipse of force and torque). While the lift
//! takes the weight from the table, the torque of gravity on a centre of mass next to the grasp
//! grows with it; beyond the limit the box slides about the axis.
//!
//! Not modelled: translation slip, waves in the skin, tilt out of the plane, contact of a corner
//! with the table.

/// Acceleration of gravity in m/s^2.
pub const GRAVITY: f64 = 9.81;
/// Width and height of the box, m.
pub const SIZE_M: (f64, f64) = (0.096, 0.0576);
/// Ratio of kinetic to static friction.
pub const KINETIC_RATIO: f64 = 0.85;
/// Radius of each contact, m.
pub const CONTACT_M: f64 = 7e-3;
/// Stiffness of both skins against vertical load, N/m.
pub const SHEAR_N_PER_M: f64 = 12_000.0;
/// Stiffness of both skins against twist, N m/rad: of a uniformly sheared disc, k a^2 / 2.
pub const TWIST_NM_PER_RAD: f64 = SHEAR_N_PER_M * CONTACT_M * CONTACT_M / 2.0;
/// Duration of closing, s.
const CLOSING_S: f64 = 0.08;
/// Final speed of the lift, m/s.
const LIFT_M_PER_S: f64 = 0.133;
/// Integration steps per millisecond.
const SUBSTEPS: u32 = 4;

/// Parameters of one grasp and lift, in SI units.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Mass of the box, kg.
    pub mass_kg: f64,
    /// Horizontal distance of the centre of mass from the grasp axis, m; positive to the right.
    pub offset_m: f64,
    /// Normal force of each finger, N.
    pub grip_n: f64,
    /// Coefficient of static friction between skin and box.
    pub static_friction: f64,
    /// Time at which the fingers touch the box and begin to close, s. Recording starts at 0.
    pub touch_s: f64,
    /// Start of the lift, s.
    pub lift_s: f64,
    /// Acceleration of the lift, m/s^2.
    pub lift_m_per_s2: f64,
}

/// The largest torque that friction of both contacts bears under a vertical load, N m. A contact of
/// Hertz's pressure turns at 3 pi / 16 mu N a; load enters by the ellipse.
pub fn torque_limit(friction: f64, grip_n: f64, load_n: f64) -> f64 {
    let force = 2.0 * friction * grip_n;
    if load_n >= force {
        return 0.0;
    }
    let part = load_n / force;
    force * CONTACT_M * (3.0 * std::f64::consts::PI / 16.0) * (1.0 - part * part).sqrt()
}

impl Grasp {
    /// Moment of inertia about the grasp axis, kg m^2: a plate with its centre of mass moved.
    pub fn inertia(&self) -> f64 {
        let (width, height) = SIZE_M;
        self.mass_kg * ((width * width + height * height) / 12.0 + self.offset_m * self.offset_m)
    }

    /// Height that the lift has reached, m.
    fn lift_at(&self, t: f64) -> f64 {
        let since = (t - self.lift_s).max(0.0);
        let speeding = LIFT_M_PER_S / self.lift_m_per_s2;
        let until = since.min(speeding);
        0.5 * self.lift_m_per_s2 * until * until + LIFT_M_PER_S * (since - until)
    }

    /// Normal force of each finger, N: a smooth rise.
    fn grip_at(&self, t: f64) -> f64 {
        let part = ((t - self.touch_s) / CLOSING_S).clamp(0.0, 1.0);
        self.grip_n * part * part * (3.0 - 2.0 * part)
    }
}

/// The box and the contact at the end of a millisecond.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspState {
    /// Normal force of each finger, N.
    pub grip_n: f64,
    /// Weight that the fingers bear, N.
    pub load_n: f64,
    /// Height of the gripper above its position at closing, m.
    pub lift_m: f64,
    /// Sag of the box below the fingers by the skins' elasticity, m.
    pub sag_m: f64,
    /// Rotation of the box about the grasp axis, rad; positive with the right side down.
    pub angle_rad: f64,
    /// Its rate, rad/s.
    pub rate_rad_per_s: f64,
    /// Whether the contact slides.
    pub sliding: bool,
    /// Torque of friction on the box, N m.
    pub friction_nm: f64,
}

/// States of a grasp over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Number of states before the recording begins, one a millisecond.
    pub before_ms: u32,
    /// One state a millisecond.
    pub states: Vec<GraspState>,
    /// Time at which the contact first slides, ms from the start of the recording.
    pub onset_ms: Option<f64>,
}

impl Motion {
    /// The states within the recording.
    pub fn recorded_states(&self) -> &[GraspState] {
        &self.states[self.before_ms as usize..]
    }
}

/// Simulates a grasp from `before_ms` before the recording to its end.
///
/// Semi-implicit Euler steps of 0.25 ms: twist resonates below 20 Hz, hundreds of steps a period.
pub fn simulate_grasp(grasp: &Grasp, before_ms: u32, recorded_ms: u32) -> Motion {
    let dt = 1e-3 / f64::from(SUBSTEPS);
    let weight = grasp.mass_kg * GRAVITY;
    let (inertia, stiffness) = (grasp.inertia(), TWIST_NM_PER_RAD);
    // Ecoflex damps its own resonance well: 0.5 of the critical damping.
    let damping = (stiffness * inertia).sqrt();
    let (mut angle, mut rate, mut anchor, mut sliding) = (0.0, 0.0, 0.0, false);
    let mut onset_ms = None;
    let mut states = Vec::with_capacity((before_ms + recorded_ms) as usize);
    for ms in 0..before_ms + recorded_ms {
        let mut state = None;
        for sub in 0..SUBSTEPS {
            let t = (f64::from(ms) - f64::from(before_ms)) * 1e-3 + f64::from(sub + 1) * dt;
            let (lift, grip) = (grasp.lift_at(t), grasp.grip_at(t));
            let load = (SHEAR_N_PER_M * lift).min(weight);
            let gravity = load * grasp.offset_m * libm::cos(angle);
            let elastic = stiffness * (angle - anchor);
            let holds = torque_limit(grasp.static_friction, grip, load);
            let slides = torque_limit(grasp.static_friction * KINETIC_RATIO, grip, load);
            let before = rate;
            let friction = if sliding {
                // Friction opposes the motion; the skin keeps the twist of this torque.
                let against = if rate < 0.0 { -slides } else { slides };
                anchor = angle - against / stiffness;
                against
            } else {
                elastic
            };
            rate += (gravity - friction - damping * rate * f64::from(u8::from(!sliding))) / inertia * dt;
            if sliding && before * rate <= 0.0 {
                // The box stopped, so static friction holds it again.
                sliding = false;
            } else if !sliding && elastic.abs() > holds && elastic * rate > 0.0 {
                sliding = true;
                if onset_ms.is_none() {
                    onset_ms = Some(t * 1e3);
                }
            }
            angle += rate * dt;
            state = Some(GraspState {
                grip_n: grip,
                load_n: load,
                lift_m: lift,
                sag_m: load / SHEAR_N_PER_M,
                angle_rad: angle,
                rate_rad_per_s: rate,
                sliding,
                friction_nm: friction,
            });
        }
        states.extend(state);
    }
    Motion { before_ms, states, onset_ms }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grasp(ratio: f64) -> Grasp {
        let mut grasp = Grasp {
            mass_kg: 0.12,
            offset_m: 0.0,
            grip_n: 1.5,
            static_friction: 0.8,
            touch_s: -0.2,
            lift_s: 0.005,
            lift_m_per_s2: 2.0,
        };
        let weight = grasp.mass_kg * GRAVITY;
        grasp.offset_m = ratio * torque_limit(0.8, 1.5, weight) / weight;
        grasp
    }

    #[test]
    fn below_the_limit_of_friction_nothing_slides() {
        // A sudden torque twists a spring twice as far as a slow one. So half the limit holds at
        // any speed of the lift.
        for ratio in [0.0, 0.1, 0.3, 0.49] {
            let grasp = grasp(ratio);
            let motion = simulate_grasp(&grasp, 250, 600);
            assert_eq!(motion.onset_ms, None, "{ratio}");
            // It stops where the twist of the skin bears the torque of gravity.
            let last = motion.states.last().unwrap();
            let bears = TWIST_NM_PER_RAD * last.angle_rad;
            let gravity = last.load_n * grasp.offset_m * last.angle_rad.cos();
            assert!((bears - gravity).abs() <= 1e-3 * gravity + 1e-12, "{ratio}: {bears} {gravity}");
        }
    }

    #[test]
    fn beyond_the_limit_it_slides_faster_the_larger_the_torque_and_never_back() {
        let mut last = (f64::INFINITY, 0.0);
        for ratio in [1.1, 1.3, 1.6, 2.0, 3.0] {
            let motion = simulate_grasp(&grasp(ratio), 250, 150);
            let onset = motion.onset_ms.unwrap();
            let states = motion.recorded_states();
            assert!(onset > 5.0 && onset < last.0, "{ratio}: {onset} after {}", last.0);
            assert!(states[149].angle_rad > last.1);
            let sliding = &states[onset.ceil() as usize..];
            assert!(sliding.windows(2).all(|pair| pair[1].angle_rad > pair[0].angle_rad));
            // Nothing turns before the lift.
            assert!(states[..4].iter().all(|state| state.angle_rad == 0.0 && state.load_n == 0.0));
            last = (onset, states[149].angle_rad);
        }
    }

    #[test]
    fn a_mirrored_grasp_mirrors_its_motion() {
        let (right, mut left) = (grasp(1.5), grasp(1.5));
        left.offset_m = -left.offset_m;
        let (right, left) = (simulate_grasp(&right, 250, 150), simulate_grasp(&left, 250, 150));
        assert_eq!(right.onset_ms, left.onset_ms);
        assert!(right.states.iter().zip(&left.states).all(|(r, l)| r.angle_rad == -l.angle_rad));
    }

    #[test]
    fn energy_is_only_lost() {
        for ratio in [0.4, 1.5, 2.5] {
            let grasp = grasp(ratio);
            let motion = simulate_grasp(&grasp, 250, 150);
            // Once the whole weight hangs, gravity's potential is a function of the angle alone.
            let weight = grasp.mass_kg * GRAVITY;
            let hanging = motion.recorded_states().iter().filter(|state| state.load_n == weight);
            let energy = hanging.map(|state| {
                let twist = state.friction_nm / TWIST_NM_PER_RAD;
                0.5 * grasp.inertia() * state.rate_rad_per_s * state.rate_rad_per_s
                    + 0.5 * TWIST_NM_PER_RAD * twist * twist
                    - weight * grasp.offset_m * state.angle_rad.sin()
            });
            let energy: Vec<f64> = energy.collect();
            assert!(energy.len() > 100, "{ratio}: {}", energy.len());
            // The integration's own error: the twist is 0.25 ms older than the angle.
            let slack = 2e-2 * energy.iter().fold(0.0f64, |most, e| most.max(e.abs()));
            assert!(energy.windows(2).all(|pair| pair[1] <= pair[0] + slack), "{ratio}");
            assert!(energy[energy.len() - 1] < energy[0]);
        }
    }

    #[test]
    fn a_load_takes_from_the_torque_that_friction_bears() {
        let at = |load| torque_limit(0.8, 1.5, load);
        // 3 pi / 16 mu N a of each finger.
        assert!((at(0.0) - 2.0 * 0.8 * 1.5 * 7e-3 * 0.589_048_622_548_086_2).abs() < 1e-15);
        assert!((at(0.6 * 2.4) / at(0.0) - 0.8).abs() < 1e-12);
        assert_eq!(at(2.5), 0.0);
    }
}
