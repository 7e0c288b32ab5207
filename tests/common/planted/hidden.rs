//! How the true vehicle, its air and its sensors differ from the vehicle file: tolerances of manufacture, and effects that
//! are hidden on purpose.
//!
//! Equations: docs/effects/*.md; sizes: of a quadrotor of 0.75 kg, scaled with mass and hover speed for others.

use super::linear::{V, mul, norm, sub, unit};
use super::strange::{RUGGED, STRANGE, Strange};
use super::world::{MAX_ROTORS, Speeds};
use propwash::random::{Key, Stream, purpose};
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Effects that a diagnosis is to know, by the id of the candidate.
pub const HIDDEN: &[&str] = &[
    "linear_drag",
    "quadratic_drag",
    "rotor_drag",
    "blade_flapping",
    "inflow",
    "translational_lift",
    "ground_effect",
    "ceiling_effect",
    "downwash",
    "constant_wind",
    "gust",
    "turbulence",
    "rotor_tilt",
    "payload",
    "wrong_mass",
    "slung_payload",
    "com_offset",
    "wrong_inertia.x",
    "wrong_inertia.y",
    "wrong_inertia.z",
    "wrong_inertia.products",
    "rotor_inertia",
    "thrust_scale",
    "thrust_curve",
    "weak_rotor.1",
    "weak_rotor.2",
    "weak_rotor.3",
    "weak_rotor.4",
    "torque_scale",
    "motor_lag",
    "command_delay",
    "battery_sag",
    "actuator_saturation",
    "mount",
    "world_tilt",
    "sensor_offset",
    "gyro_bias",
    "gyro_scale",
    "accel_bias",
    "clock_offset.pose",
    "clock_offset.gyro",
    "clock_offset.accel",
];

/// The same of vehicles with more than four rotors.
pub const MORE_ROTORS: &[&str] = &["weak_rotor.5", "weak_rotor.6", "weak_rotor.7", "weak_rotor.8"];

/// Effects of [`HIDDEN`] and [`MORE_ROTORS`] that a vehicle of `n` rotors can have.
pub fn of_rotors(n: usize) -> Vec<&'static str> {
    HIDDEN.iter().chain(&MORE_ROTORS[..n.clamp(4, MAX_ROTORS) - 4]).copied().collect()
}

/// Effects that no list of candidates has, for the verdict "unexplained".
pub const UNLISTED: &[&str] =
    &["cubic_drag", "roll_dependent_thrust", "sudden_push", "swing_torque", "speed_thrust_loss"];

/// How late a clock must be for its lateness to be a fact and no tolerance, s: more than a sample of a fast sensor.
pub const CLOCK_S: f64 = 0.002;

/// Standard deviations of usual tolerances from which on a part is off by more than a tolerance: a builder who takes care has
/// one such part in 400.
pub const FAR: f64 = 3.0;

/// Height of the ceiling of the hall in which [`super::Excitation::NearCeiling`] is flown, m, world.
pub const CEILING_Z_M: f64 = 3.0;

const DEG: f64 = PI / 180.0;

/// The id among [`HIDDEN`], [`UNLISTED`], [`STRANGE`] and [`RUGGED`] that is called `name`.
///
/// # Errors
/// A sentence with all ids where there is none.
pub fn id(name: &str) -> Result<&'static str, String> {
    let all = HIDDEN.iter().chain(MORE_ROTORS).chain(UNLISTED).chain(STRANGE).chain(RUGGED);
    all.into_iter().find(|known| **known == name).copied().ok_or_else(|| {
        format!(
            "expected the id of an effect, found `{name}`: take one of {}, {}, {}, {}, or none",
            HIDDEN.join(", "),
            UNLISTED.join(", "),
            STRANGE.join(", "),
            RUGGED.join(", ")
        )
    })
}

/// What the sizes of hidden effects are scaled by.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Mass over 0.75 kg.
    pub mass: f64,
    /// Rotor speed at hover, rad/s.
    pub hover_rad_s: f64,
    /// Thrust of one rotor at hover, N.
    pub hover_n: f64,
    /// Mean distance of the hubs from the middle over 0.113 m.
    pub arm: f64,
    /// Inertia about x over 2.5e-3 kg·m².
    pub inertia: f64,
    /// Length of the flight, s.
    pub seconds: f64,
}

/// How tolerances scatter about the vehicle file. The priors of a diagnosis are normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scatter {
    /// Normal, sorted out beyond three standard deviations.
    Normal,
    /// Uniform with the same standard deviation.
    Uniform,
    /// Student's t with four degrees of freedom and the same standard deviation, sorted out beyond four of them.
    StudentT,
}

impl Scatter {
    /// One draw of standard deviation 1.
    fn draw(self, s: &mut Stream) -> f64 {
        match self {
            // Beyond three standard deviations a part would have been sent back.
            Self::Normal => s.normal().clamp(-3.0, 3.0),
            Self::Uniform => 3f64.sqrt() * s.uniform(-1.0, 1.0),
            Self::StudentT => {
                let n = s.normal();
                let chi2: f64 = (0..4).map(|_| s.normal().powi(2)).sum();
                // t = n / √(χ²/4) has variance 2.
                (n / (0.25 * chi2).sqrt() / 2f64.sqrt()).clamp(-4.0, 4.0)
            }
        }
    }
}

/// How carefully a vehicle was built and its sensors fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Build {
    /// Width of the tolerances: 1 as usual, 0 for a vehicle exactly as filed.
    pub width: f64,
    /// How they scatter.
    pub scatter: Scatter,
    /// Whether the body of the position system and the inertial unit are fixed each by itself, so that one of them alone may be
    /// askew, and gyroscope and accelerometer have one clock. Candidates of a diagnosis turn all sensors together, and have a
    /// clock for each.
    pub apart: bool,
}

impl Build {
    /// Normal tolerances `width` times as wide as usual, one mount for all sensors, one clock for each.
    pub fn usual(width: f64) -> Self {
        Self { width, scatter: Scatter::Normal, apart: false }
    }

    /// A world that does not know the priors: tolerances up to twice as wide, from any distribution, and mounts and clocks
    /// otherwise than candidates have them in every second vehicle.
    pub fn fair(seed: u64) -> Self {
        let mut s = stream(seed, 2, "fair world");
        let width = s.uniform(0.5, 2.0);
        let scatter = [Scatter::Normal, Scatter::Uniform, Scatter::StudentT][s.below(3) as usize];
        Self { width, scatter, apart: s.below(2) == 0 }
    }
}

/// Everything in which truth and vehicle file differ. Factors are 1 and the rest 0 where they agree.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Deviations {
    /// True mass over the filed one, without payload.
    pub mass_factor: f64,
    /// True inertia over the filed one, x, y, z.
    pub inertia_factor: V,
    /// Entries xy, xz, yz of the inertia beyond the filed ones, over the geometric mean of the two moments.
    pub inertia_products: V,
    /// True rotor inertia over the filed one.
    pub rotor_inertia_factor: f64,
    /// From the filed to the true centre of mass, m, body.
    pub com_offset_m: V,
    /// Mass of a rigid payload, kg.
    pub payload_kg: f64,
    /// Its place from the centre of mass, m, body.
    pub payload_position_m: V,
    /// Mass on a cable, kg.
    pub slung_kg: f64,
    /// Length of the cable, m.
    pub cable_m: f64,
    /// Place at which the cable hangs, from the centre of mass, m, body.
    pub hook_m: V,
    /// Thrust over the filed one, all rotors.
    pub thrust_factor: f64,
    /// Share s of the hover thrust that is linear in the rotor speed: T = (1 − s) k Ω² + s k Ω_hover Ω.
    pub thrust_curve_share: f64,
    /// Thrust over the filed one, of each rotor.
    pub rotor_factor: Speeds,
    /// Torque over the filed one.
    pub torque_factor: f64,
    /// Time to spin up and down over the filed one.
    pub lag_factor: [f64; 2],
    /// Delay of the commands, s.
    pub delay_s: f64,
    /// Share of thrust that is lost at the end of the flight; it grows linearly with time.
    pub sag_share: f64,
    /// Greatest rotor speed, rad/s; infinite where there is none below the command's own.
    pub max_rotor_rad_s: f64,
    /// Lean of all thrust axes: rotation vector about body x and y, rad.
    pub lean_rad: [f64; 2],
    /// Lean of each thrust axis about its own arm, times its spin, rad.
    pub twist_rad: f64,
    /// Lean of each single thrust axis about body x and y, rad.
    pub rotor_lean_rad: [[f64; 2]; MAX_ROTORS],
    /// Linear drag over the filed one, x, y, z.
    pub linear_drag_factor: V,
    /// Linear drag beyond that, N·s/m, body x, y, z.
    pub linear_drag_n_s_per_m: V,
    /// Quadratic drag, N·s²/m², body x, y, z.
    pub quadratic_drag_n_s2_per_m2: V,
    /// Rotor drag, N·s²/(rad·m).
    pub rotor_drag_n_s2_per_rad_m: f64,
    /// Blade flapping, N·s²/rad.
    pub flapping_n_s2_per_rad: f64,
    /// Loss of thrust by inflow, N·s²/(rad·m).
    pub inflow_n_s2_per_rad_m: f64,
    /// Translational lift, N·s²/m².
    pub lift_n_s2_per_m2: f64,
    /// Strength of the ground effect.
    pub ground_strength: f64,
    /// Strength of the effect of the ceiling at [`CEILING_Z_M`].
    pub ceiling_strength: f64,
    /// Area that a neighbour's jet meets, m².
    pub downwash_area_m2: f64,
    /// Growth of that jet's radius per depth.
    pub downwash_spread: f64,
    /// Constant wind, m/s, world.
    pub wind_m_s: V,
    /// Amplitude of the gust, m/s, world.
    pub gust_m_s: V,
    /// Its frequency, Hz.
    pub gust_hz: f64,
    /// Its phase at time 0, rad.
    pub gust_phase_rad: f64,
    /// Standard deviation of hidden turbulence, m/s; the air of every flight has its own beside it.
    pub turbulence_m_s: f64,
    /// Rotation vector from the body to the frame of attitudes, rad, body.
    pub mount_rad: V,
    /// The same of gyroscope and accelerometer; equal to it where all sensors are fixed together.
    pub imu_mount_rad: V,
    /// Rotation vector of the position system's world about the true x and y, rad.
    pub tilt_rad: [f64; 2],
    /// Place of the position marker from the centre of mass, m, body.
    pub marker_m: V,
    /// Bias of the gyroscope, rad/s.
    pub gyro_bias_rad_s: V,
    /// Scale error of the gyroscope, x, y, z (0: none).
    pub gyro_scale: V,
    /// Bias of the accelerometer, m/s².
    pub accel_bias_m_s2: V,
    /// How late the times of poses, gyroscope and accelerometer are written, s.
    pub clock_s: V,
    /// Drag with the cube of the speed, N·s³/m³.
    pub cubic_drag_n_s3_per_m3: f64,
    /// a of thrust × (1 + a sin 2·roll).
    pub roll_thrust: f64,
    /// Force of the push, N, body.
    pub push_n: V,
    /// When the push begins and ends, s.
    pub push_s: [f64; 2],
    /// Torque about body x and y per v_x ω_z, N·m·s²/(m·rad).
    pub swing_n_m: [f64; 2],
    /// Share k of thrust × (1 − k tanh(|v|/3 m/s)).
    pub speed_loss: f64,
    /// What is in no list.
    pub strange: Option<Strange>,
}

impl Deviations {
    /// The vehicle as filed, in still air, with perfect sensors.
    pub fn none() -> Self {
        Self {
            mass_factor: 1.0,
            inertia_factor: [1.0; 3],
            inertia_products: [0.0; 3],
            rotor_inertia_factor: 1.0,
            com_offset_m: [0.0; 3],
            payload_kg: 0.0,
            payload_position_m: [0.0; 3],
            slung_kg: 0.0,
            cable_m: 0.5,
            hook_m: [0.0; 3],
            thrust_factor: 1.0,
            thrust_curve_share: 0.0,
            rotor_factor: [1.0; MAX_ROTORS],
            torque_factor: 1.0,
            lag_factor: [1.0; 2],
            delay_s: 0.0,
            sag_share: 0.0,
            max_rotor_rad_s: f64::INFINITY,
            lean_rad: [0.0; 2],
            twist_rad: 0.0,
            rotor_lean_rad: [[0.0; 2]; MAX_ROTORS],
            linear_drag_factor: [1.0; 3],
            linear_drag_n_s_per_m: [0.0; 3],
            quadratic_drag_n_s2_per_m2: [0.0; 3],
            rotor_drag_n_s2_per_rad_m: 0.0,
            flapping_n_s2_per_rad: 0.0,
            inflow_n_s2_per_rad_m: 0.0,
            lift_n_s2_per_m2: 0.0,
            ground_strength: 0.0,
            ceiling_strength: 0.0,
            downwash_area_m2: 0.0,
            downwash_spread: 0.1,
            wind_m_s: [0.0; 3],
            gust_m_s: [0.0; 3],
            gust_hz: 0.5,
            gust_phase_rad: 0.0,
            turbulence_m_s: 0.0,
            mount_rad: [0.0; 3],
            imu_mount_rad: [0.0; 3],
            tilt_rad: [0.0; 2],
            marker_m: [0.0; 3],
            gyro_bias_rad_s: [0.0; 3],
            gyro_scale: [0.0; 3],
            accel_bias_m_s2: [0.0; 3],
            clock_s: [0.0; 3],
            cubic_drag_n_s3_per_m3: 0.0,
            roll_thrust: 0.0,
            push_n: [0.0; 3],
            push_s: [0.0; 2],
            swing_n_m: [0.0; 2],
            speed_loss: 0.0,
            strange: None,
        }
    }

    /// Tolerances of a carefully built and measured vehicle. The standard deviations of usual width are those of careful
    /// weighing and bench tests: mass 0.5 %, thrust 1.2 %, inertia 3 %, torque 3 %, each rotor 0.7 %, …
    pub fn tolerances(seed: u64, build: Build, scale: &Scale) -> Self {
        let draw = |name: &str| -> Box<dyn FnMut(f64) -> f64> {
            let mut stream = stream(seed, 0, name);
            Box::new(move |sigma| sigma * build.width * build.scatter.draw(&mut stream))
        };
        let three = |name: &str, sigma: f64| {
            let mut d = draw(name);
            [d(sigma), d(sigma), d(sigma)]
        };
        let one = |name: &str, sigma: f64| draw(name)(sigma);
        let factors = |v: V| [1.0 + v[0], 1.0 + v[1], 1.0 + v[2]];
        // Small vehicles are balanced as well in proportion to their size.
        let small = scale.arm.min(1.0);
        let com = three("com", 1.0);
        let wind = three("wind", 0.02);
        let mut rotor = draw("rotor");
        let mut lean = draw("rotor lean");
        let tilt = three("tilt", 0.05 * DEG);
        let mut lag = draw("lag");
        let mount_rad = three("mount", 0.17 * DEG);
        let mut clock_s = three("clock", 0.3e-3);
        if build.apart {
            clock_s[2] = clock_s[1];
        }
        Self {
            mass_factor: 1.0 + one("mass", 0.005),
            inertia_factor: factors(three("inertia", 0.03)),
            inertia_products: three("inertia products", 0.01),
            rotor_inertia_factor: 1.0 + one("rotor inertia", 0.05),
            com_offset_m: [0.2e-3 * small * com[0], 0.2e-3 * small * com[1], 0.8e-3 * small * com[2]],
            thrust_factor: 1.0 + one("thrust", 0.012),
            rotor_factor: std::array::from_fn(|_| 1.0 + rotor(0.007)),
            torque_factor: 1.0 + one("torque", 0.03),
            lag_factor: std::array::from_fn(|_| 1.0 + lag(0.05)),
            delay_s: one("delay", 0.001).abs(),
            rotor_lean_rad: std::array::from_fn(|_| [lean(0.05 * DEG), lean(0.05 * DEG)]),
            linear_drag_factor: factors(three("drag", 0.1)),
            wind_m_s: [wind[0], wind[1], 0.3 * wind[2]],
            mount_rad,
            imu_mount_rad: if build.apart { three("mount of the imu", 0.17 * DEG) } else { mount_rad },
            tilt_rad: [tilt[0], tilt[1]],
            marker_m: three("marker", 0.5e-3),
            gyro_bias_rad_s: three("gyro bias", 0.002),
            gyro_scale: three("gyro scale", 0.002),
            accel_bias_m_s2: three("accel bias", 0.03),
            clock_s,
            ..Self::none()
        }
    }

    /// Adds the hidden effect `id`, drawn from `seed`; `size` 1 is the size as drawn, 0 is nothing. Sensors that are fixed
    /// `apart` have one mount askew or the other, and one clock for gyroscope and accelerometer.
    pub fn plant(&mut self, id: &'static str, seed: u64, size: f64, scale: &Scale, apart: bool) {
        let mut draw = Draw { s: stream(seed, 1, id), size, scale };
        let known = self.plant_in_air(id, &mut draw)
            || self.plant_in_mass(id, &mut draw)
            || self.plant_in_drive(id, &mut draw)
            || self.plant_in_sensors(id, &mut draw, apart)
            || self.plant_unlisted(id, &mut draw);
        assert!(known, "{id} is checked by `id`");
    }

    /// Forces of the air, walls and neighbours, and wind. Gives whether `id` is one of them, as those below do.
    fn plant_in_air(&mut self, id: &str, d: &mut Draw) -> bool {
        let (m, size) = (d.scale.mass, d.size);
        let per_speed = m * 1072.0 / d.scale.hover_rad_s;
        match id {
            "linear_drag" => {
                let k = size * m * d.s.uniform(0.14, 0.3);
                self.linear_drag_n_s_per_m = std::array::from_fn(|_| k * d.s.uniform(0.75, 1.25));
            }
            "quadratic_drag" => {
                let k = size * m * d.s.uniform(0.02, 0.04);
                self.quadratic_drag_n_s2_per_m2 = std::array::from_fn(|_| k * d.s.uniform(0.8, 1.2));
            }
            "rotor_drag" => self.rotor_drag_n_s2_per_rad_m = size * per_speed * d.s.uniform(3e-5, 7e-5),
            "blade_flapping" => {
                self.flapping_n_s2_per_rad =
                    size * d.scale.inertia * per_speed / m * d.s.uniform(3e-7, 7.5e-7);
            }
            "inflow" => self.inflow_n_s2_per_rad_m = size * per_speed * d.s.uniform(0.7e-4, 2e-4),
            "translational_lift" => self.lift_n_s2_per_m2 = size * m * d.s.uniform(0.004, 0.01),
            "ground_effect" => self.ground_strength = size * d.s.uniform(1.5, 3.5),
            "ceiling_effect" => self.ceiling_strength = size * d.s.uniform(1.5, 3.5),
            "downwash" => {
                self.downwash_area_m2 = size * d.scale.arm * d.scale.arm * d.s.uniform(0.005, 0.012);
                self.downwash_spread = d.s.uniform(0.07, 0.14);
            }
            "constant_wind" => plus(&mut self.wind_m_s, mul(d.level(), size * d.s.uniform(0.8, 2.5))),
            "gust" => {
                self.gust_m_s = mul(d.level(), size * d.s.uniform(0.8, 2.0));
                self.gust_hz = d.s.uniform(0.2, 1.5);
                self.gust_phase_rad = d.s.uniform(0.0, TAU);
            }
            "turbulence" => self.turbulence_m_s = size * d.s.uniform(0.5, 1.5),
            _ => return false,
        }
        true
    }

    /// Masses, where they are, and inertias of the body.
    fn plant_in_mass(&mut self, id: &str, d: &mut Draw) -> bool {
        let (m, size) = (d.scale.mass, d.size);
        match id {
            "payload" => {
                self.payload_kg = size * m * d.s.uniform(0.05, 0.15);
                let aside = mul(d.level(), d.s.uniform(0.0, 0.015));
                self.payload_position_m = mul([aside[0], aside[1], -d.s.uniform(0.02, 0.06)], d.scale.arm);
            }
            "wrong_mass" => self.mass_factor *= towards(size, 1.0 + d.sign() * d.s.uniform(0.08, 0.15)),
            "slung_payload" => {
                self.slung_kg = size * 0.75 * m * d.s.uniform(0.05, 0.1);
                self.cable_m = d.s.uniform(0.3, 0.8);
                self.hook_m = [0.0, 0.0, -0.02];
            }
            "com_offset" => {
                let vertical = d.sign() * d.s.uniform(5e-3, 15e-3) * (d.s.below(2) as f64);
                let aside = mul(d.level(), d.s.uniform(3e-3, 8e-3));
                plus(&mut self.com_offset_m, mul([aside[0], aside[1], vertical], size * d.scale.arm));
            }
            "wrong_inertia.x" | "wrong_inertia.y" | "wrong_inertia.z" => {
                self.inertia_factor[axis_of(id)] *= towards(size, 1.0 + d.sign() * d.s.uniform(0.15, 0.3));
            }
            "wrong_inertia.products" => {
                let which = d.s.below(3) as usize;
                self.inertia_products[which] += size * d.sign() * d.s.uniform(0.07, 0.15);
            }
            _ => return false,
        }
        true
    }

    /// Rotors, motors, and what drives them.
    fn plant_in_drive(&mut self, id: &str, d: &mut Draw) -> bool {
        let size = d.size;
        match id {
            "rotor_tilt" => {
                let lean = mul(d.level(), size * d.s.uniform(1.0, 3.0) * DEG);
                self.lean_rad = [lean[0], lean[1]];
                let twist = d.sign() * size * d.s.uniform(0.5, 1.5) * DEG;
                self.twist_rad = if d.s.below(3) == 0 { twist } else { 0.0 };
            }
            "rotor_inertia" => self.rotor_inertia_factor *= towards(size, d.s.uniform(2.0, 4.0)),
            "thrust_scale" => self.thrust_factor *= towards(size, 1.0 + d.sign() * d.s.uniform(0.06, 0.12)),
            "thrust_curve" => self.thrust_curve_share = size * d.sign() * d.s.uniform(0.2, 0.45),
            _ if id.starts_with("weak_rotor") => {
                self.rotor_factor[rotor_of(id)] *= towards(size, 1.0 - d.s.uniform(0.08, 0.2));
            }
            "torque_scale" => self.torque_factor *= towards(size, 1.0 + d.sign() * d.s.uniform(0.2, 0.4)),
            "motor_lag" => {
                let slow = d.s.below(2) == 0;
                let mut one = || if slow { d.s.uniform(1.4, 2.0) } else { d.s.uniform(0.5, 0.7) };
                let factors = [one(), one()];
                for i in 0..2 {
                    self.lag_factor[i] *= towards(size, factors[i]);
                }
            }
            "command_delay" => self.delay_s += size * d.s.uniform(0.008, 0.025),
            "battery_sag" => self.sag_share = size * d.s.uniform(0.1, 0.25),
            "actuator_saturation" => {
                let drawn = d.s.uniform(1.28, 1.38);
                // Shrinking moves the limit up to where nothing reaches it.
                self.max_rotor_rad_s = d.scale.hover_rad_s * (drawn + (1.0 - size) * 0.5);
            }
            _ => return false,
        }
        true
    }

    /// How sensors are fixed, what they read wrongly, and their clocks.
    fn plant_in_sensors(&mut self, id: &str, d: &mut Draw, apart: bool) -> bool {
        let size = d.size;
        match id {
            "mount" => {
                let askew = mul(d.anywhere(), size * d.s.uniform(1.5, 4.0) * DEG);
                let which = d.s.below(2);
                if !apart || which == 0 {
                    plus(&mut self.mount_rad, askew);
                }
                if !apart || which == 1 {
                    plus(&mut self.imu_mount_rad, askew);
                }
            }
            "world_tilt" => {
                let tilt = mul(d.level(), size * d.s.uniform(0.7, 2.0) * DEG);
                self.tilt_rad[0] += tilt[0];
                self.tilt_rad[1] += tilt[1];
            }
            "sensor_offset" => plus(&mut self.marker_m, mul(d.anywhere(), size * d.s.uniform(0.01, 0.03))),
            "gyro_bias" => {
                plus(&mut self.gyro_bias_rad_s, mul(d.anywhere(), size * d.s.uniform(0.03, 0.1)));
            }
            "gyro_scale" => {
                let each = std::array::from_fn(|_| size * d.sign() * d.s.uniform(0.03, 0.08));
                plus(&mut self.gyro_scale, each);
            }
            "accel_bias" => {
                plus(&mut self.accel_bias_m_s2, mul(d.anywhere(), size * d.s.uniform(0.3, 0.8)));
            }
            "clock_offset.pose" | "clock_offset.gyro" | "clock_offset.accel" => {
                let late = size * d.sign() * d.s.uniform(0.01, 0.025);
                let own = channel_of(id);
                for (i, clock) in self.clock_s.iter_mut().enumerate() {
                    if i == own || (apart && i > 0 && own > 0) {
                        *clock += late;
                    }
                }
            }
            _ => return false,
        }
        true
    }

    /// Those of [`UNLISTED`].
    fn plant_unlisted(&mut self, id: &str, d: &mut Draw) -> bool {
        let (m, size) = (d.scale.mass, d.size);
        match id {
            "cubic_drag" => self.cubic_drag_n_s3_per_m3 = size * m * d.s.uniform(0.008, 0.014),
            "roll_dependent_thrust" => self.roll_thrust = size * d.sign() * d.s.uniform(0.12, 0.25),
            "sudden_push" => {
                self.push_n = mul(d.anywhere(), size * m * d.s.uniform(0.7, 1.4));
                let from = d.scale.seconds * d.s.uniform(0.3, 0.5);
                self.push_s = [from, from + d.s.uniform(4.0, 8.0).min(0.4 * d.scale.seconds)];
            }
            "swing_torque" => {
                let k = size * d.scale.inertia * d.s.uniform(6e-4, 1.2e-3);
                let way = d.level();
                self.swing_n_m = [k * way[0], k * way[1]];
            }
            "speed_thrust_loss" => self.speed_loss = size * d.s.uniform(0.08, 0.16),
            _ => {
                let Some(id) = STRANGE.iter().chain(RUGGED).find(|known| **known == id) else { return false };
                self.strange = Some(Strange::draw(id, &mut d.s, size, d.scale));
            }
        }
        true
    }

    /// The true values of the parameters of the effect `id`, tolerances included, by name with unit. For effects that
    /// [`propwash::physics::effects`] has, names are those of its parameters.
    pub fn parameters(&self, id: &str, filed: &Filed) -> BTreeMap<String, f64> {
        // One of them knows the effect, the others give nothing.
        let groups = [
            self.air_parameters(id, filed),
            self.mass_parameters(id),
            self.drive_parameters(id, filed),
            self.sensor_parameters(id),
            self.unlisted_parameters(id),
        ];
        groups.into_iter().flatten().collect()
    }

    fn air_parameters(&self, id: &str, filed: &Filed) -> Values {
        match id {
            "linear_drag" => {
                let total = |i: usize| {
                    filed.linear_drag_n_s_per_m[i] * self.linear_drag_factor[i]
                        + self.linear_drag_n_s_per_m[i]
                };
                (0..3).map(|i| (format!("drag_n_s_per_m.{i}.{i}"), total(i))).collect()
            }
            "quadratic_drag" => list("drag_n_s2_per_m2", &self.quadratic_drag_n_s2_per_m2),
            "rotor_drag" => named([("drag_n_s2_per_rad_m", self.rotor_drag_n_s2_per_rad_m)]),
            "blade_flapping" => named([
                ("moment_n_s2_per_rad", self.flapping_n_s2_per_rad),
                ("lateral_extra_n_s2_per_rad", 0.0),
            ]),
            "inflow" => named([("loss_n_s2_per_rad_m", self.inflow_n_s2_per_rad_m)]),
            "translational_lift" => named([("lift_n_s2_per_m2", self.lift_n_s2_per_m2)]),
            "ground_effect" => named([("strength", self.ground_strength)]),
            "ceiling_effect" => named([("strength", self.ceiling_strength), ("ceiling_z_m", CEILING_Z_M)]),
            "downwash" => named([("drag_area_m2", self.downwash_area_m2), ("spread", self.downwash_spread)]),
            "constant_wind" => list("velocity_m_s", &self.wind_m_s),
            "gust" => {
                let rest = named([("frequency_hz", self.gust_hz), ("phase_rad", self.gust_phase_rad)]);
                [list("amplitude_m_s", &self.gust_m_s), rest].concat()
            }
            "turbulence" => named([("sigma_m_s", self.turbulence_m_s)]),
            _ => Values::new(),
        }
    }

    fn mass_parameters(&self, id: &str) -> Values {
        match id {
            "payload" => {
                let place = list("position_m", &self.payload_position_m);
                [named([("mass_kg", self.payload_kg)]), place].concat()
            }
            "wrong_mass" => named([("factor", self.mass_factor)]),
            "slung_payload" => {
                // From the true centre of mass.
                let hook = list("hook_m", &sub(self.hook_m, self.com_offset_m));
                [named([("mass_kg", self.slung_kg), ("cable_m", self.cable_m)]), hook].concat()
            }
            "com_offset" => list("offset_m", &self.com_offset_m),
            "wrong_inertia.x" | "wrong_inertia.y" | "wrong_inertia.z" => {
                named([("factor", self.inertia_factor[axis_of(id)])])
            }
            "wrong_inertia.products" => list("product", &self.inertia_products),
            _ => Values::new(),
        }
    }

    fn drive_parameters(&self, id: &str, filed: &Filed) -> Values {
        match id {
            "rotor_tilt" => {
                let n = filed.arms.len();
                let mean = |k: usize| self.rotor_lean_rad[..n].iter().map(|r| r[k]).sum::<f64>() / n as f64;
                let along = |i: usize| {
                    let (own, arm) = (self.rotor_lean_rad[i], filed.arms[i]);
                    (own[0] * arm[0] + own[1] * arm[1]) / n as f64
                };
                named([
                    ("lean_x_rad", self.lean_rad[0] + mean(0)),
                    ("lean_y_rad", self.lean_rad[1] + mean(1)),
                    ("twist_rad", self.twist_rad - (0..n).map(along).sum::<f64>()),
                ])
            }
            "rotor_inertia" => named([("factor", self.rotor_inertia_factor)]),
            "thrust_scale" => named([("factor", self.thrust_factor)]),
            "thrust_curve" => {
                let k = filed.thrust_n_s2_per_rad2;
                named([
                    ("hover_share_linear", self.thrust_curve_share),
                    ("linear_n_s_per_rad", self.thrust_curve_share * k * filed.hover_rad_s),
                    ("quadratic_n_s2_per_rad2", -self.thrust_curve_share * k),
                ])
            }
            _ if id.starts_with("weak_rotor") => named([("factor", self.rotor_factor[rotor_of(id)])]),
            "torque_scale" => named([("factor", self.torque_factor)]),
            "motor_lag" => {
                named([("spin_up_factor", self.lag_factor[0]), ("spin_down_factor", self.lag_factor[1])])
            }
            "command_delay" => named([("delay_s", self.delay_s)]),
            "battery_sag" => named([
                ("thrust_loss_share", self.sag_share),
                ("thrust_loss_per_s", self.sag_share / filed.seconds),
                // Speeds fall as the voltage does.
                ("compensated", 0.0),
            ]),
            "actuator_saturation" => named([("max_rotor_vel_rad_s", self.max_rotor_rad_s)]),
            _ => Values::new(),
        }
    }

    fn sensor_parameters(&self, id: &str) -> Values {
        match id {
            "mount" | "mount.pose" => list("rotation_rad", &self.mount_rad),
            "mount.imu" => list("rotation_rad", &self.imu_mount_rad),
            "world_tilt" => list("rotation_rad", &self.tilt_rad),
            "sensor_offset" => list("position_m", &self.marker_m),
            "gyro_bias" => list("bias_rad_s", &self.gyro_bias_rad_s),
            "gyro_scale" => list("factor", &self.gyro_scale.map(|e| 1.0 + e)),
            "accel_bias" => list("bias_m_s2", &self.accel_bias_m_s2),
            "clock_offset.pose" | "clock_offset.gyro" | "clock_offset.accel" => {
                named([("late_s", self.clock_s[channel_of(id)])])
            }
            _ => Values::new(),
        }
    }

    fn unlisted_parameters(&self, id: &str) -> Values {
        match id {
            "cubic_drag" => named([("drag_n_s3_per_m3", self.cubic_drag_n_s3_per_m3)]),
            "roll_dependent_thrust" => named([("share", self.roll_thrust)]),
            "sudden_push" => {
                let times = named([("from_s", self.push_s[0]), ("until_s", self.push_s[1])]);
                [list("force_n", &self.push_n), times].concat()
            }
            "swing_torque" => list("torque_n_m_s2_per_m_rad", &self.swing_n_m),
            "speed_thrust_loss" => named([("share", self.speed_loss)]),
            _ => match self.strange.filter(|strange| strange.id == id) {
                Some(strange) => named([("strength", strange.strength), ("scale", strange.scale)]),
                None => Values::new(),
            },
        }
    }

    /// How far off a parameter of the effect `id` is: over the least size at which [`Self::plant`] plants it ([`CLOCK_S`] for
    /// a clock), and in standard deviations of usual tolerances.
    fn off(&self, id: &str, scale: &Scale) -> [f64; 2] {
        let small = scale.arm.min(1.0);
        let each = |values: &[f64], least: f64, usual: f64| {
            let most = values.iter().map(|v| v.abs()).fold(0.0, f64::max);
            [most / least, most / usual]
        };
        let all = |v: V, least: f64, usual: f64| [norm(v) / least, each(&v, 1.0, usual)[1]];
        match id {
            "wrong_mass" => each(&[self.mass_factor - 1.0], 0.08, 0.005),
            "thrust_scale" => each(&[self.thrust_factor - 1.0], 0.06, 0.012),
            "torque_scale" => each(&[self.torque_factor - 1.0], 0.2, 0.03),
            "rotor_inertia" => each(&[self.rotor_inertia_factor - 1.0], 1.0, 0.05),
            "motor_lag" => each(&self.lag_factor.map(|f| f - 1.0), 0.3, 0.05),
            "command_delay" => each(&[self.delay_s], 0.008, 0.001),
            "com_offset" => {
                let usual = [0.2e-3 * small, 0.2e-3 * small, 0.8e-3 * small];
                let far = self.com_offset_m.iter().zip(usual).map(|(v, u)| (v / u).abs()).fold(0.0, f64::max);
                [norm(self.com_offset_m) / (3e-3 * scale.arm), far]
            }
            "constant_wind" => all(self.wind_m_s, 0.8, 0.02),
            // As a factor on the filed drag it is never planted, only off.
            "linear_drag" => [0.0, each(&self.linear_drag_factor.map(|f| f - 1.0), 1.0, 0.1)[1]],
            "mount" => {
                let most = norm(self.mount_rad).max(norm(self.imu_mount_rad)) / DEG;
                let each_axis = [self.mount_rad, self.imu_mount_rad].concat();
                [most / 1.5, each(&each_axis, 1.0, 0.17 * DEG)[1]]
            }
            "world_tilt" => [
                self.tilt_rad[0].hypot(self.tilt_rad[1]) / (0.7 * DEG),
                each(&self.tilt_rad, 1.0, 0.05 * DEG)[1],
            ],
            "sensor_offset" => all(self.marker_m, 0.01, 0.5e-3),
            "gyro_bias" => all(self.gyro_bias_rad_s, 0.03, 0.002),
            "gyro_scale" => each(&self.gyro_scale, 0.03, 0.002),
            "accel_bias" => all(self.accel_bias_m_s2, 0.3, 0.03),
            "wrong_inertia.products" => each(&self.inertia_products, 0.07, 0.01),
            _ if id.starts_with("wrong_inertia") => {
                each(&[self.inertia_factor[axis_of(id)] - 1.0], 0.15, 0.03)
            }
            _ if id.starts_with("weak_rotor") => each(&[self.rotor_factor[rotor_of(id)] - 1.0], 0.08, 0.007),
            _ if id.starts_with("clock_offset") => each(&[self.clock_s[channel_of(id)]], CLOCK_S, 0.3e-3),
            _ => [0.0; 2],
        }
    }

    /// Effects of the list that are there although nobody planted them: tolerances and clocks so far off that a diagnosis
    /// that names them says what is so. A parameter counts from the least size at which [`Self::plant`] plants its effect on, a
    /// clock from [`CLOCK_S`] on.
    pub fn also(&self, planted: &[&str], scale: &Scale, rotors: usize) -> Vec<&'static str> {
        let there = |id: &&'static str| !planted.contains(id) && self.off(id, scale)[0] >= 1.0;
        of_rotors(rotors).into_iter().filter(there).collect()
    }

    /// Effects of which a parameter is further off than [`FAR`] standard deviations of the usual tolerances, planted or not:
    /// a diagnosis that names one with its true value is not wrong.
    pub fn beyond(&self, scale: &Scale, rotors: usize) -> Vec<&'static str> {
        of_rotors(rotors).into_iter().filter(|id| self.off(id, scale)[1] > FAR + 1e-9).collect()
    }

    /// Whether a slung payload hangs below the vehicle.
    pub fn has_cable(&self) -> bool {
        self.slung_kg > 0.0
    }

    /// Whether the wind does anything but stand still.
    pub fn gusts(&self) -> bool {
        norm(self.gust_m_s) > 0.0
    }
}

/// What the size of one hidden effect is drawn from.
struct Draw<'a> {
    s: Stream,
    /// 1 is the size as drawn, 0 nothing.
    size: f64,
    scale: &'a Scale,
}

impl Draw<'_> {
    fn sign(&mut self) -> f64 {
        if self.s.below(2) == 0 { 1.0 } else { -1.0 }
    }

    /// A horizontal direction.
    fn level(&mut self) -> V {
        let angle = self.s.uniform(0.0, TAU);
        [angle.cos(), angle.sin(), 0.0]
    }

    /// Any direction.
    fn anywhere(&mut self) -> V {
        unit([self.s.normal(), self.s.normal(), self.s.normal()])
    }
}

/// Factors are scaled so that a shrunk effect comes closer to 1.
fn towards(size: f64, factor: f64) -> f64 {
    1.0 + size * (factor - 1.0)
}

fn plus(a: &mut V, b: V) {
    (0..3).for_each(|i| a[i] += b[i]);
}

/// Parameters by name with unit.
type Values = Vec<(String, f64)>;

fn named<const N: usize>(values: [(&str, f64); N]) -> Values {
    values.into_iter().map(|(name, v)| (name.to_string(), v)).collect()
}

/// Components of one parameter, numbered.
fn list(name: &str, values: &[f64]) -> Values {
    values.iter().enumerate().map(|(i, v)| (format!("{name}.{i}"), *v)).collect()
}

/// What the vehicle file says where a true parameter is a share of it.
#[derive(Clone, Debug)]
pub struct Filed {
    /// Diagonal of the linear drag.
    pub linear_drag_n_s_per_m: V,
    /// Quadratic coefficient of the first rotor's thrust curve.
    pub thrust_n_s2_per_rad2: f64,
    /// Rotor speed at hover.
    pub hover_rad_s: f64,
    /// Length of the flight.
    pub seconds: f64,
    /// Directions from the middle to the hubs, x and y.
    pub arms: Vec<[f64; 2]>,
}

/// Random numbers for one thing: `seed` and `flight` as in [`super::Plan`].
pub fn stream(seed: u64, flight: u64, name: &str) -> Stream {
    Key { seed, world: flight, drone: 0, step: 0, purpose: purpose(name) }.stream()
}

fn rotor_of(id: &str) -> usize {
    usize::from(id.as_bytes()[id.len() - 1] - b'1')
}

fn axis_of(id: &str) -> usize {
    usize::from(id.as_bytes()[id.len() - 1] - b'x')
}

fn channel_of(id: &str) -> usize {
    match id {
        "clock_offset.pose" => 0,
        "clock_offset.gyro" => 1,
        _ => 2,
    }
}
