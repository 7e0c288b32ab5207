//! The true vehicle: its equations of motion in plain f64, integrated with Runge–Kutta of order four.
//!
//! Written from docs/effects/*.md and docs/model.md, not from `propwash::physics`; a test compares the two.

use super::hidden::{CEILING_Z_M, Deviations, Filed, Scale};
use super::linear::{
    M, Q, V, add, cross, dot, inverse, mat_t_vec, mat_vec, matrix, mul, norm, quat_exp, quat_mul, quat_unit,
    sub, unit,
};
use propwash::random::Stream;
use propwash::vehicle::Vehicle;
use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

/// Density of the air, kg/m³.
const AIR_KG_M3: f64 = 1.225;

/// Drag of the mass on the cable, N·s/m: small, so that it swings less in the end.
const CABLE_MASS_DRAG_N_S_PER_M: f64 = 0.003;

/// Most rotors of a vehicle.
pub const MAX_ROTORS: usize = 8;
/// A number for each rotor; 0 where there is none.
pub type Speeds = [f64; MAX_ROTORS];
/// Where the rotors stand in a state.
pub const ROTORS: usize = 13;
/// Where the place of the mass on the cable stands in a state.
pub const LOAD: usize = ROTORS + MAX_ROTORS;
/// Where its velocity stands.
pub const LOAD_SPEED: usize = LOAD + 3;
/// Numbers of a state.
pub const SIZE: usize = LOAD_SPEED + 3;

/// Position 0..3, quaternion xyzw 3..7, velocity 7..10, body rate 10..13, rotors from [`ROTORS`], mass on the cable:
/// position from [`LOAD`], velocity from [`LOAD_SPEED`].
pub type State = [f64; SIZE];

/// Three numbers of a state from `at` on.
pub fn part(x: &State, at: usize) -> V {
    [x[at], x[at + 1], x[at + 2]]
}

/// The attitude of a state.
pub fn attitude(x: &State) -> Q {
    quat_unit([x[3], x[4], x[5], x[6]])
}

/// The rotors of a state, rad/s.
pub fn rotors(x: &State) -> Speeds {
    std::array::from_fn(|i| x[ROTORS + i])
}

/// One true rotor.
#[derive(Clone, Copy, Debug)]
pub struct TrueRotor {
    /// Hub from the true centre of mass, m.
    pub at_m: V,
    /// Direction of thrust.
    pub axis: V,
    /// +1: clockwise seen from above.
    pub spin: f64,
    /// Thrust c0 + c1 Ω + c2 Ω².
    pub thrust: V,
    /// Torque t0 + t1 Ω + t2 Ω².
    pub torque: V,
    /// Ω̇ = up.0 (u − Ω) + up.1 (u² − Ω²).
    pub up: [f64; 2],
    /// The same, slowing down.
    pub down: [f64; 2],
    /// Inertia about the axis, kg·m².
    pub inertia: f64,
    /// Propeller radius, m.
    pub radius: f64,
}

/// What the vehicle file says, in SI, as far as it is flown here.
#[derive(Clone, Debug)]
pub struct Nominal {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Inertia, kg·m².
    pub inertia: M,
    /// Gravity, m/s², world.
    pub gravity: V,
    /// The rotors.
    pub rotors: Vec<TrueRotor>,
    /// Linear drag, N·s/m.
    pub linear_drag: M,
    /// Least and greatest commanded rotor speed, rad/s.
    pub limits: [f64; 2],
}

/// c0 + c1 x + c2 x².
pub fn curve(c: V, x: f64) -> f64 {
    c[0] + x * (c[1] + x * c[2])
}

/// The speed at which a curve gives `value`; 0 where it gives more already at rest.
pub fn speed_for(c: V, value: f64) -> f64 {
    if curve(c, 0.0) >= value {
        return 0.0;
    }
    let (a, b, c) = (c[2], c[1], c[0] - value);
    (-b + (b * b - 4.0 * a * c).max(0.0).sqrt()) / (2.0 * a)
}

impl Nominal {
    /// Reads the numbers of a vehicle with four to eight rotors and no filed effect but linear drag.
    ///
    /// # Errors
    /// A sentence where the vehicle has other rotors or effects.
    pub fn read(vehicle: &Vehicle) -> Result<Self, String> {
        let drone = vehicle.drone("first_principles").map_err(|e| e.to_string())?;
        let frame = &drone.airframe;
        if !(4..=MAX_ROTORS).contains(&frame.n_rotors) {
            return Err(format!(
                "expected a vehicle with 4 to {MAX_ROTORS} rotors, found {} in {}: choose another vehicle file",
                frame.n_rotors, vehicle.name
            ));
        }
        let one = |i: usize| {
            let r = &frame.rotors[i];
            TrueRotor {
                at_m: r.position_m,
                axis: r.axis,
                spin: r.spin,
                thrust: r.thrust_curve,
                torque: r.torque_curve,
                up: r.spin_up,
                down: r.spin_down,
                inertia: r.inertia_kg_m2,
                radius: r.radius_m,
            }
        };
        let rotors: Vec<TrueRotor> = (0..frame.n_rotors).map(one).collect();
        let mut linear_drag = [[0.0; 3]; 3];
        for entry in &vehicle.file().effect {
            if entry.models.as_ref().is_some_and(|m| !m.iter().any(|name| name == "first_principles")) {
                continue;
            }
            let value = entry.params.get("drag_n_s_per_m").and_then(|v| v.as_array());
            let (true, Some(rows)) = (entry.kind == "linear_drag", value) else {
                return Err(format!(
                    "expected no effect but linear_drag in the vehicle file, found {} in {}: remove the entry, the generator \
                     plants its own effects",
                    entry.kind, vehicle.name
                ));
            };
            for (i, row) in rows.iter().enumerate() {
                for (j, v) in row.as_array().into_iter().flatten().enumerate() {
                    let whole = v.as_integer().map(|k| k as f64);
                    linear_drag[i][j] = v.as_float().or(whole).unwrap_or(f64::NAN);
                }
            }
        }
        let file = &vehicle.file().controller;
        let (least, most) = match (&file.mellinger, &file.direct) {
            (Some(m), _) => (m.thrust_min_n, m.thrust_max_n),
            (None, Some(d)) => (d.thrust_min_n, d.thrust_max_n),
            (None, None) => return Err(format!("expected a [controller] table in {}", vehicle.name)),
        };
        let first = rotors[0];
        Ok(Self {
            mass_kg: drone.body.mass_kg,
            inertia: drone.body.inertia_kg_m2,
            gravity: drone.body.gravity_m_s2,
            linear_drag,
            limits: [least, most].map(|n| speed_for(first.thrust, n)),
            rotors,
        })
    }

    /// Time that a motor takes for a small change of speed at hover, mean of up and down, s.
    pub fn lag_s(&self) -> f64 {
        let hover = self.hover_rad_s();
        let of = |[c_v, c_d]: [f64; 2]| 1.0 / (c_v + 2.0 * c_d * hover);
        0.5 * (of(self.rotors[0].up) + of(self.rotors[0].down))
    }

    /// Thrust of one rotor at hover, N.
    pub fn hover_n(&self) -> f64 {
        self.mass_kg * norm(self.gravity) / self.rotors.len() as f64
    }

    /// Rotor speed at hover, rad/s.
    pub fn hover_rad_s(&self) -> f64 {
        speed_for(self.rotors[0].thrust, self.hover_n())
    }

    /// What hidden effects are scaled by.
    pub fn scale(&self, seconds: f64) -> Scale {
        let arm =
            self.rotors.iter().map(|r| r.at_m[0].hypot(r.at_m[1])).sum::<f64>() / self.rotors.len() as f64;
        Scale {
            mass: self.mass_kg / 0.75,
            hover_rad_s: self.hover_rad_s(),
            hover_n: self.hover_n(),
            arm: arm / 0.113,
            inertia: self.inertia[0][0] / 2.5e-3,
            seconds,
        }
    }

    /// What true parameters are a share of.
    pub fn filed(&self, seconds: f64) -> Filed {
        Filed {
            linear_drag_n_s_per_m: [self.linear_drag[0][0], self.linear_drag[1][1], self.linear_drag[2][2]],
            thrust_n_s2_per_rad2: self.rotors[0].thrust[2],
            hover_rad_s: self.hover_rad_s(),
            seconds,
            arms: self
                .rotors
                .iter()
                .map(|r| {
                    let [x, y, _] = unit([r.at_m[0], r.at_m[1], 0.0]);
                    [x, y]
                })
                .collect(),
        }
    }
}

/// What changes from step to step and is no state: the air, and where a neighbour is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Air {
    /// Turbulent part of the wind, m/s, world.
    pub wind_m_s: V,
    /// Torque of uneven turbulence, N·m, body.
    pub torque_n_m: V,
    /// Another vehicle, m, world.
    pub neighbour_m: Option<V>,
}

/// The true vehicle and its surroundings.
#[derive(Clone, Debug)]
pub struct World {
    /// Mass with a rigid payload, kg.
    pub mass_kg: f64,
    /// Inertia about the true centre of mass, kg·m².
    pub inertia: M,
    inertia_inverse: M,
    /// Gravity, m/s².
    pub gravity: V,
    /// The rotors.
    pub rotors: Vec<TrueRotor>,
    /// Linear drag with all that is hidden, N·s/m.
    pub linear_drag: M,
    /// From the filed to the true centre of mass (offset and payload), m.
    pub com_m: V,
    /// Hook of the cable from the true centre of mass, m.
    pub hook_m: V,
    /// Weight of the neighbour (N) and radius of the disc with the area of its rotors (m).
    pub neighbour: (f64, f64),
    /// All that differs from the file.
    pub dev: Deviations,
    seconds: f64,
}

impl World {
    /// The vehicle with these deviations, on a flight of `seconds`.
    pub fn new(nominal: &Nominal, dev: &Deviations, seconds: f64) -> Self {
        let mut mass = nominal.mass_kg * dev.mass_factor;
        let mut inertia = nominal.inertia;
        for i in 0..3 {
            for j in 0..3 {
                inertia[i][j] *= (dev.inertia_factor[i] * dev.inertia_factor[j]).sqrt();
            }
        }
        for (i, j, product) in [(0, 1, 0), (0, 2, 1), (1, 2, 2)] {
            let more = dev.inertia_products[product] * (inertia[i][i] * inertia[j][j]).sqrt();
            inertia[i][j] += more;
            inertia[j][i] += more;
        }
        let mut com = dev.com_offset_m;
        if dev.payload_kg > 0.0 {
            // The payload's place counts from the centre of mass of the vehicle without it.
            let (p, r) = (dev.payload_kg, dev.payload_position_m);
            let both = mass + p;
            let reduced = mass * p / both;
            for i in 0..3 {
                for j in 0..3 {
                    let diagonal = if i == j { dot(r, r) } else { 0.0 };
                    inertia[i][j] += reduced * (diagonal - r[i] * r[j]);
                }
            }
            com = add(com, mul(r, p / both));
            mass = both;
        }
        let hover = nominal.hover_rad_s();
        let mut rotors = nominal.rotors.clone();
        for (i, r) in rotors.iter_mut().enumerate() {
            r.at_m = sub(r.at_m, com);
            let gain = dev.thrust_factor * dev.rotor_factor[i];
            let s = dev.thrust_curve_share;
            let k = r.thrust[2];
            r.thrust = [r.thrust[0], r.thrust[1] + s * k * hover, (1.0 - s) * k].map(|c| c * gain);
            r.torque = r.torque.map(|c| c * dev.torque_factor);
            r.up = r.up.map(|c| c / dev.lag_factor[0]);
            r.down = r.down.map(|c| c / dev.lag_factor[1]);
            r.inertia *= dev.rotor_inertia_factor;
            let arm = unit([nominal.rotors[i].at_m[0], nominal.rotors[i].at_m[1], 0.0]);
            let own = dev.rotor_lean_rad[i];
            let lean = [dev.lean_rad[0] + own[0], dev.lean_rad[1] + own[1], 0.0];
            let turn = add(lean, mul(arm, -dev.twist_rad));
            r.axis = mat_vec(matrix(quat_exp(turn)), r.axis);
        }
        let mut linear_drag = nominal.linear_drag;
        for i in 0..3 {
            linear_drag[i][i] = linear_drag[i][i] * dev.linear_drag_factor[i] + dev.linear_drag_n_s_per_m[i];
        }
        let disc = nominal.rotors.iter().map(|r| r.radius * r.radius).sum::<f64>().sqrt();
        Self {
            mass_kg: mass,
            inertia,
            inertia_inverse: inverse(inertia),
            gravity: nominal.gravity,
            rotors,
            linear_drag,
            com_m: com,
            hook_m: sub(dev.hook_m, com),
            neighbour: (nominal.mass_kg * norm(nominal.gravity), disc),
            dev: dev.clone(),
            seconds,
        }
    }

    /// The vehicle as filed.
    pub fn nominal(nominal: &Nominal) -> Self {
        Self::new(nominal, &Deviations::none(), 1.0)
    }

    /// Share of the battery's first voltage at time `t`, which is also that of the rotor speed for a command.
    pub fn voltage_share(&self, t: f64) -> f64 {
        (1.0 - self.dev.sag_share * (t / self.seconds).clamp(0.0, 1.0)).sqrt()
    }

    /// Rotor speed that a command leads to at time `t`, rad/s.
    pub fn target(&self, command: f64, t: f64) -> f64 {
        (command * self.voltage_share(t)).min(self.dev.max_rotor_rad_s)
    }

    /// The derivative of a state under commanded rotor speeds.
    pub fn rate(&self, t: f64, x: &State, commands: &Speeds, air: &Air) -> State {
        let d = &self.dev;
        let (p, v, w) = (part(x, 0), part(x, 7), part(x, 10));
        let q = attitude(x);
        let r = matrix(q);
        let u = mat_t_vec(r, sub(v, self.wind(t, air)));
        let speed = norm(u);

        let mut force = [0.0; 3];
        let mut torque = air.torque_n_m;
        let mut out = [0.0; SIZE];
        let gain = self.unlisted_gain(r, speed);
        for (i, rotor) in self.rotors.iter().enumerate() {
            let omega = x[ROTORS + i];
            let target = self.target(commands[i], t);
            let [c_v, c_d] = if target > omega { rotor.up } else { rotor.down };
            let omega_dot = c_v * (target - omega) + c_d * (target * target - omega * omega);
            out[ROTORS + i] = omega_dot;

            let hub = add(u, cross(w, rotor.at_m));
            let axial = dot(hub, rotor.axis);
            let side = sub(hub, mul(rotor.axis, axial));
            let mut thrust = curve(rotor.thrust, omega) * gain;
            if d.ground_strength != 0.0 || d.ceiling_strength != 0.0 {
                let z = p[2] + mat_vec(r, rotor.at_m)[2];
                thrust *= near_wall(d.ground_strength, self.rotors[0].radius, z)
                    * near_wall(d.ceiling_strength, self.rotors[0].radius, CEILING_Z_M - z);
            }
            thrust += d.lift_n_s2_per_m2 * dot(side, side) - d.inflow_n_s2_per_rad_m * omega * axial;
            let at_hub = sub(mul(rotor.axis, thrust), mul(side, d.rotor_drag_n_s2_per_rad_m * omega));
            force = add(force, at_hub);
            torque = add(torque, cross(rotor.at_m, at_hub));
            torque = add(torque, mul(rotor.axis, rotor.spin * curve(rotor.torque, omega)));
            torque = add(torque, mul(cross(hub, rotor.axis), d.flapping_n_s2_per_rad * omega));
            // The rotor carries the angular momentum h = −s J Ω a; the body feels −ω × h − ḣ.
            let h = mul(rotor.axis, -rotor.spin * rotor.inertia * omega);
            let h_dot = mul(rotor.axis, -rotor.spin * rotor.inertia * omega_dot);
            torque = sub(sub(torque, cross(w, h)), h_dot);
        }
        force = sub(force, mat_vec(self.linear_drag, u));
        for i in 0..3 {
            force[i] -= d.quadratic_drag_n_s2_per_m2[i] * speed * u[i];
            force[i] -= d.cubic_drag_n_s3_per_m3 * speed * speed * u[i];
        }
        if t >= d.push_s[0] && t < d.push_s[1] {
            force = add(force, d.push_n);
        }
        if let Some(strange) = &d.strange {
            let all = (0..self.rotors.len()).map(|i| curve(self.rotors[i].thrust, x[ROTORS + i])).sum();
            let roll = r[2][1].atan2(r[2][2]);
            let (push, turn) = strange.wrench(u, w, all, roll, p[2]);
            let push = add(push, mat_t_vec(r, strange.pull(p, v)));
            (force, torque) = (add(force, push), add(torque, turn));
        }
        torque[0] += d.swing_n_m[0] * u[0] * w[2];
        torque[1] += d.swing_n_m[1] * u[0] * w[2];

        let mut world_force = mat_vec(r, force);
        if let Some(above) = air.neighbour_m {
            world_force[2] -= self.downwash(p, above);
        }
        if d.has_cable() {
            let pull = self.cable(x, r, world_force, torque);
            world_force = add(world_force, pull.0);
            torque = add(torque, cross(self.hook_m, mat_t_vec(r, pull.0)));
            out[LOAD..LOAD_SPEED].copy_from_slice(&x[LOAD_SPEED..SIZE]);
            out[LOAD_SPEED..SIZE].copy_from_slice(&pull.1);
        }
        let acc = add(mul(world_force, 1.0 / self.mass_kg), self.gravity);
        let ang_acc = self.turn(w, torque);
        let q_dot = quat_mul(q, [0.5 * w[0], 0.5 * w[1], 0.5 * w[2], 0.0]);
        out[0..3].copy_from_slice(&v);
        out[3..7].copy_from_slice(&q_dot);
        out[7..10].copy_from_slice(&acc);
        out[10..13].copy_from_slice(&ang_acc);
        out
    }

    /// Velocity of the air at time `t`, m/s, world.
    fn wind(&self, t: f64, air: &Air) -> V {
        let d = &self.dev;
        let wind = add(d.wind_m_s, air.wind_m_s);
        if !d.gusts() {
            return wind;
        }
        add(wind, mul(d.gust_m_s, (TAU * d.gust_hz * t + d.gust_phase_rad).sin()))
    }

    /// Factor of all thrusts by effects that no list of candidates has.
    fn unlisted_gain(&self, r: M, speed: f64) -> f64 {
        let mut gain = 1.0;
        if self.dev.roll_thrust != 0.0 {
            let roll = r[2][1].atan2(r[2][2]);
            gain *= 1.0 + self.dev.roll_thrust * (2.0 * roll).sin();
        }
        if self.dev.speed_loss != 0.0 {
            gain *= 1.0 - self.dev.speed_loss * (speed / 3.0).tanh();
        }
        gain
    }

    /// J⁻¹ (τ − ω × J ω).
    fn turn(&self, w: V, torque: V) -> V {
        mat_vec(self.inertia_inverse, sub(torque, cross(w, mat_vec(self.inertia, w))))
    }

    /// Force that presses down under a neighbour at `above`, N.
    fn downwash(&self, p: V, above: V) -> f64 {
        let depth = above[2] - p[2];
        if self.dev.downwash_area_m2 == 0.0 || depth <= 0.0 {
            return 0.0;
        }
        let (weight, disc) = self.neighbour;
        let jet = disc + self.dev.downwash_spread * depth;
        let start = 2.0 * (weight / (2.0 * AIR_KG_M3 * PI * disc * disc)).sqrt();
        let aside = (p[0] - above[0]).hypot(p[1] - above[1]) / jet;
        let speed = start * disc / jet * (-aside * aside).exp();
        0.5 * AIR_KG_M3 * self.dev.downwash_area_m2 * speed * speed
    }

    /// Force of a rigid, massless cable on the vehicle (N, world) and acceleration of the mass at its end (m/s²), for
    /// the other forces (world) and torques (body) on the vehicle.
    ///
    /// The tension follows from the length that stays: with d from hook to mass, d·d̈ + ḋ·ḋ = 0, which is linear in it.
    fn cable(&self, x: &State, r: M, force: V, torque: V) -> (V, V) {
        let w = part(x, 10);
        let mass = self.dev.slung_kg;
        let lever = mat_vec(r, self.hook_m);
        let spin = mat_vec(r, cross(w, self.hook_m));
        let d = sub(part(x, LOAD), add(part(x, 0), lever));
        let d_dot = sub(part(x, LOAD_SPEED), add(part(x, 7), spin));
        let n = unit(d);
        let drag = mul(part(x, LOAD_SPEED), -CABLE_MASS_DRAG_N_S_PER_M);
        // Accelerations of hook and mass without tension, then per newton of tension.
        let ang = self.turn(w, torque);
        let bend = add(cross(ang, self.hook_m), cross(w, cross(w, self.hook_m)));
        let hook = add(add(mul(force, 1.0 / self.mass_kg), self.gravity), mat_vec(r, bend));
        let free = add(mul(drag, 1.0 / mass), self.gravity);
        let turned = mat_vec(self.inertia_inverse, cross(self.hook_m, mat_t_vec(r, n)));
        let hook_per_n = add(mul(n, 1.0 / self.mass_kg), mat_vec(r, cross(turned, self.hook_m)));
        let per_n = sub(mul(n, -1.0 / mass), hook_per_n);
        let needed = -dot(d_dot, d_dot) / norm(d) - dot(n, sub(free, hook));
        let tension = needed / dot(n, per_n);
        (mul(n, tension), add(free, mul(n, -tension / mass)))
    }

    /// One step of Runge–Kutta 4 with constant commands.
    pub fn rk4(&self, t: f64, h: f64, x: &State, commands: &Speeds, air: &Air) -> State {
        let along = |k: &State, h: f64| -> State { std::array::from_fn(|i| x[i] + h * k[i]) };
        let a = self.rate(t, x, commands, air);
        let b = self.rate(t + 0.5 * h, &along(&a, 0.5 * h), commands, air);
        let c = self.rate(t + 0.5 * h, &along(&b, 0.5 * h), commands, air);
        let d = self.rate(t + h, &along(&c, h), commands, air);
        let mut y: State = std::array::from_fn(|i| x[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
        let q = attitude(&y);
        y[3..7].copy_from_slice(&q);
        if self.dev.has_cable() {
            self.hold_cable(&mut y);
        }
        y
    }

    /// Takes back what the length of the cable drifted in a step, and the speed along it.
    fn hold_cable(&self, x: &mut State) {
        let r = matrix(attitude(x));
        let hook = add(part(x, 0), mat_vec(r, self.hook_m));
        let hook_speed = add(part(x, 7), mat_vec(r, cross(part(x, 10), self.hook_m)));
        let n = unit(sub(part(x, LOAD), hook));
        let at = add(hook, mul(n, self.dev.cable_m));
        let relative = sub(part(x, LOAD_SPEED), hook_speed);
        let speed = sub(part(x, LOAD_SPEED), mul(n, dot(relative, n)));
        x[LOAD..LOAD_SPEED].copy_from_slice(&at);
        x[LOAD_SPEED..SIZE].copy_from_slice(&speed);
    }

    /// From `t` to `until` under the commands of a delay line, in one step per stretch of constant command.
    pub fn advance(&self, t: f64, until: f64, x: &State, line: &DelayLine, air: &Air) -> State {
        let (mut now, mut y) = (t, *x);
        let mut k = line.index_at(t);
        loop {
            let next = line.switch_after(k).filter(|s| *s < until);
            let end = next.unwrap_or(until);
            if end > now {
                y = self.rk4(now, end - now, &y, &line.commands[k].1, air);
                now = end;
            }
            if next.is_none() {
                return y;
            }
            k += 1;
        }
    }

    /// Hover at `p` with yaw `yaw`, rotors and cable at rest.
    pub fn at_hover(&self, p: V, yaw: f64) -> State {
        let mut x = [0.0; SIZE];
        x[0..3].copy_from_slice(&p);
        x[3..7].copy_from_slice(&quat_exp([0.0, 0.0, yaw]));
        let weight = (self.mass_kg + self.dev.slung_kg) * norm(self.gravity);
        for (i, rotor) in self.rotors.iter().enumerate() {
            x[ROTORS + i] = speed_for(rotor.thrust, weight / self.rotors.len() as f64);
        }
        let hook = add(p, mat_vec(matrix(attitude(&x)), self.hook_m));
        x[LOAD..LOAD_SPEED].copy_from_slice(&[hook[0], hook[1], hook[2] - self.dev.cable_m]);
        x
    }
}

/// Gain of thrust of a rotor at the distance `d` (m) from ground or ceiling (Cheeseman and Bennett with a free factor).
pub fn near_wall(strength: f64, radius: f64, d: f64) -> f64 {
    let x = radius / (4.0 * d.max(0.5 * radius));
    1.0 / (1.0 - strength * x * x).max(0.25)
}

/// Commands on their way to the motors: (time from which the motors see it, rotor speeds), oldest first.
#[derive(Clone, Debug)]
pub struct DelayLine {
    commands: VecDeque<(f64, Speeds)>,
}

impl DelayLine {
    /// In force since ever.
    pub fn new(commands: Speeds) -> Self {
        Self { commands: VecDeque::from([(f64::NEG_INFINITY, commands)]) }
    }

    /// A command that arrives at time `at`, later than those before; forgets what is no longer seen at `now`.
    pub fn push(&mut self, at: f64, commands: Speeds, now: f64) {
        self.commands.push_back((at, commands));
        while self.commands.len() > 1 && self.commands[1].0 <= now {
            self.commands.pop_front();
        }
    }

    /// What the motors see at time `t`.
    pub fn at(&self, t: f64) -> Speeds {
        self.commands[self.index_at(t)].1
    }

    fn index_at(&self, t: f64) -> usize {
        self.commands.iter().rposition(|(at, _)| *at <= t).unwrap_or(0)
    }

    fn switch_after(&self, k: usize) -> Option<f64> {
        self.commands.get(k + 1).map(|(at, _)| *at)
    }
}

/// Turbulence with the Dryden spectra: along x the first-order one, along y and z the second-order ones, advanced exactly
/// from step to step. Source: MIL-F-8785C, § 3.7.
#[derive(Clone, Debug)]
pub struct Dryden {
    sigma: f64,
    /// Time in which air of the length of the spectra passes, s.
    tau_s: f64,
    along: f64,
    across: [[f64; 2]; 2],
    torque: V,
    stream: Stream,
}

/// Scale of length over airspeed of the turbulence, s: eddies of 1.5 m that pass with 2 m/s.
const EDDY_S: f64 = 0.75;
/// Torque by uneven turbulence per standard deviation of the wind, for 0.75 kg, N·m per m/s, and its time, s.
const UNEVEN: (f64, f64) = (4e-4, 0.1);

impl Dryden {
    /// Turbulence with the standard deviation `sigma` of each axis, m/s, in its steady state.
    pub fn new(sigma: f64, stream: Stream) -> Self {
        let mut new =
            Self { sigma, tau_s: EDDY_S, along: 0.0, across: [[0.0; 2]; 2], torque: [0.0; 3], stream };
        // Long after the start nothing is left of it.
        new.step(1e3 * EDDY_S);
        new
    }

    /// Advances by `dt` s.
    pub fn step(&mut self, dt: f64) {
        let h = dt / self.tau_s;
        let a = (-h).exp();
        self.along = a * self.along + (1.0 - a * a).sqrt() * self.stream.normal();
        // Two equal lags after each other, driven by white noise: ẋ₁ = −x₁ + n, ẋ₂ = x₁ − x₂ in units of τ.
        let b = a * a;
        let q11 = 0.5 * (1.0 - b);
        let q12 = 0.25 * (1.0 - b * (1.0 + 2.0 * h));
        let q22 = 0.25 * (1.0 - b * (1.0 + 2.0 * h + 2.0 * h * h));
        let l11 = q11.sqrt();
        let l21 = q12 / l11;
        let l22 = (q22 - l21 * l21).max(0.0).sqrt();
        for x in &mut self.across {
            let (n1, n2) = (self.stream.normal(), self.stream.normal());
            *x = [
                a * x[0] + l11 * n1,
                a * (x[1] + if h < 100.0 { h * x[0] } else { 0.0 }) + l21 * n1 + l22 * n2,
            ];
        }
        let c = (-dt / UNEVEN.1).exp();
        for x in &mut self.torque {
            *x = c * *x + (1.0 - c * c).sqrt() * self.stream.normal();
        }
    }

    /// The wind, m/s, world. The transfer function across is σ (1 + √3 τ s)/(1 + τ s)².
    pub fn wind_m_s(&self) -> V {
        let r = 3f64.sqrt();
        let side = |x: [f64; 2]| self.sigma * (r * x[0] + (1.0 - r) * x[1]);
        [self.sigma * self.along, side(self.across[0]), side(self.across[1])]
    }

    /// The torque, N·m, for a vehicle of `scale` times 2.5e-3 kg·m².
    pub fn torque_n_m(&self, scale: f64) -> V {
        mul(self.torque, self.sigma * UNEVEN.0 * scale)
    }
}
