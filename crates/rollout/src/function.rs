//! The equations of one drone as a function of named numbers, to be printed in other languages ([`propwash_trace::export::text`]).
//!
//! ```
//! use propwash_rollout::function::{Asked, What, function};
//! use propwash_vehicle::Vehicle;
//!
//! let vehicle = Vehicle::builtin("cf21B_500").unwrap();
//! let rate = function(&vehicle, &Asked { what: What::Rate, ..Asked::default() })?;
//! let mut inputs = rate.defaults();
//! assert_eq!(rate.input_names(), ["x", "u"]);
//! inputs[0][9] = 1.5; // vz
//! assert_eq!(rate.evaluate(&inputs).unwrap()[0][2], 1.5);
//! # Ok::<(), propwash_rollout::RolloutError>(())
//! ```

use super::RolloutError;
use super::blocks::{Slot, periods};
use super::sim::close_names;
use propwash_physics::controllers::{COMMAND_WIDTH, ControlMode, Due, Memory, mellinger};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::Command;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::surroundings::{NO_CEILING_M, NO_GROUND_M, Remembered};
use propwash_trace::Real;
use propwash_trace::adjoint::pull_back;
use propwash_trace::export::text::{Group, Printed, written_out};
use propwash_trace::math::quat;
use propwash_trace::trace::{Sym, trace_finite};
use propwash_vehicle::Vehicle;

/// Which equations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum What {
    /// Time derivative of the state under what drives the vehicle: rotor speeds that are commanded, or attitude and thrust for the fitted models.
    #[default]
    Rate,
    /// The state after a step of the simulation in which all stages of the controllers tick, and what controllers and effects remember then.
    Step,
    /// What the on-board controllers command, and what they remember then.
    Controller,
    /// What a loss gains by the inputs of a step, from what it gains by its outputs: the transposed Jacobian times a vector.
    Gradient,
}

impl What {
    /// All, with their names.
    pub const ALL: [(&'static str, Self); 4] = [
        ("rate", Self::Rate),
        ("step", Self::Step),
        ("controller", Self::Controller),
        ("gradient", Self::Gradient),
    ];

    /// That of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(own, _)| *own == name).map(|(_, what)| *what)
    }
}

/// Which function of a vehicle is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// Which equations.
    pub what: What,
    /// The model: `first_principles` or one of the fitted ones.
    pub dynamics: String,
    /// What commands mean; a rate has none but those of rotors or of attitude.
    pub control: ControlMode,
    /// How a step integrates.
    pub integrator: Integrator,
    /// Steps per second.
    pub sim_hz: u32,
    /// Parameters that are inputs, by name, or `all`; all others stand in the code as the numbers that they are.
    pub parameters: Vec<String>,
    /// Whether forces, wind, heights, time and random numbers are inputs; else there are none (no wind, no ground, time 0).
    pub surroundings: bool,
}

impl Default for Asked {
    /// The rate of the rigid body with its rotors.
    fn default() -> Self {
        Self {
            what: What::Rate,
            dynamics: "first_principles".into(),
            control: ControlMode::Attitude,
            integrator: Integrator::Euler,
            sim_hz: 500,
            parameters: Vec::new(),
            surroundings: false,
        }
    }
}

/// The numbers of an input, while they are gathered.
struct Inputs {
    groups: Vec<Group>,
}

impl Inputs {
    fn add(&mut self, name: &str, about: &str, entries: Vec<(String, f64)>) {
        if !entries.is_empty() {
            let (entries, defaults) = entries.into_iter().unzip();
            self.groups.push(Group { name: name.into(), about: about.into(), entries, defaults });
        }
    }

    /// The numbers of an input among those of all; empty where there is none.
    fn of<'a>(&self, name: &str, all: &'a [Sym]) -> &'a [Sym] {
        let mut from = 0;
        for group in &self.groups {
            if group.name == name {
                return &all[from..from + group.entries.len()];
            }
            from += group.entries.len();
        }
        &[]
    }
}

/// What a function is made of.
struct Maker<'a> {
    asked: &'a Asked,
    drone: Drone<f64>,
    rates: propwash_physics::controllers::Rates,
    /// Controllers' and effects' memory: indices of the numbers that are used, and how many.
    memory: Vec<usize>,
    effects: usize,
    inputs: Inputs,
}

/// A number of a vector, by name.
fn entries(names: &[&str]) -> Vec<(String, f64)> {
    names.iter().map(|n| ((*n).to_string(), 0.0)).collect()
}

/// Numbers of what surrounds a drone, with those of still air far from everything.
fn surroundings() -> Vec<(String, f64)> {
    let mut out = entries(&[
        "force_x_n",
        "force_y_n",
        "force_z_n",
        "torque_x_n_m",
        "torque_y_n_m",
        "torque_z_n_m",
        "wind_x_m_s",
        "wind_y_m_s",
        "wind_z_m_s",
        "ground_z_m",
        "ceiling_z_m",
        "time_s",
        "normal_0",
        "normal_1",
        "normal_2",
        "normal_3",
        "normal_4",
        "normal_5",
    ]);
    (out[9].1, out[10].1) = (-NO_GROUND_M, NO_CEILING_M);
    out
}

impl Maker<'_> {
    fn rotors(&self) -> usize {
        self.drone.airframe.n_rotors
    }

    fn is_rotors(&self) -> bool {
        matches!(self.drone.dynamics, Dynamics::Rotors)
    }

    /// Numbers of the state, with those of a drone that hovers.
    fn state(&self) -> Vec<(String, f64)> {
        let names = [
            "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s",
            "wy_rad_s", "wz_rad_s",
        ];
        let mut out = entries(&names);
        out[6].1 = 1.0;
        if self.is_rotors() {
            let hover = self.drone.hover_rotor_vel();
            out.extend((0..self.rotors()).map(|i| (format!("rotor_{}_rad_s", i + 1), hover[i])));
        } else {
            out.push(("thrust_n".into(), self.drone.hover_command()));
        }
        out
    }

    /// Numbers of the command, with those of hover.
    fn command(&self, control: ControlMode) -> Vec<(String, f64)> {
        let thrust = self.drone.hover_command();
        let with = |names: &[&str], at: usize| {
            let mut out = entries(names);
            out[at].1 = thrust;
            out
        };
        match control {
            ControlMode::RotorVel => {
                let hover = self.drone.hover_rotor_vel();
                (0..self.rotors()).map(|i| (format!("rotor_{}_rad_s", i + 1), hover[i])).collect()
            }
            ControlMode::Attitude => with(&["roll_rad", "pitch_rad", "yaw_rad", "thrust_n"], 3),
            ControlMode::BodyRate => with(&["wx_rad_s", "wy_rad_s", "wz_rad_s", "thrust_n"], 3),
            ControlMode::ForceTorque => {
                let mut out = entries(&["thrust_n", "torque_x_n_m", "torque_y_n_m", "torque_z_n_m"]);
                out[0].1 = self.drone.hover_thrust();
                out
            }
            ControlMode::State => {
                let mut out = entries(&[
                    "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s", "ax_m_s2", "ay_m_s2", "az_m_s2", "qx",
                    "qy", "qz", "qw", "wx_rad_s", "wy_rad_s", "wz_rad_s",
                ]);
                out[12].1 = 1.0;
                out
            }
        }
    }

    /// The vehicle over symbols: numbers where they are fixed, the inputs `p` where they are free.
    fn vehicle(&self, all: &[Sym]) -> Drone<Sym> {
        let mut drone = self.drone.map(&mut Sym::lit);
        let group = self.inputs.groups.iter().find(|g| g.name == "p");
        if let Some(group) = group {
            let free = self.inputs.of("p", all);
            drone.visit(&mut |name, value| {
                if let Some(k) = group.entries.iter().position(|own| own == name) {
                    *value = free[k];
                }
            });
            drone.refresh();
        }
        drone
    }

    /// The numbers of what surrounds the drone.
    fn around(&self, all: &[Sym]) -> Vec<Sym> {
        match self.inputs.of("w", all) {
            [] => surroundings().iter().map(|(_, v)| Sym::lit(*v)).collect(),
            given => given.to_vec(),
        }
    }

    /// The slot of a drone whose numbers are the inputs.
    fn slot(&self, all: &[Sym]) -> Slot<Sym> {
        let x = self.inputs.of("x", all);
        let (u, m, w) = (self.inputs.of("u", all), self.inputs.of("m", all), self.around(all));
        let zero = Sym::zero();
        let mut state = State {
            pos: core::array::from_fn(|i| x[i]),
            quat: core::array::from_fn(|i| x[3 + i]),
            vel: core::array::from_fn(|i| x[7 + i]),
            ang_vel: core::array::from_fn(|i| x[10 + i]),
            rotor_vel: [zero; MAX_ROTORS],
            thrust: zero,
        };
        if self.is_rotors() {
            state.rotor_vel[..self.rotors()].copy_from_slice(&x[13..]);
        } else {
            state.thrust = x[13];
        }
        let mut command = [zero; COMMAND_WIDTH];
        command[..u.len()].copy_from_slice(u);
        let memory = |i: usize| self.memory.iter().position(|own| *own == i).map_or(zero, |k| m[k]);
        let at = |from: usize| -> [Sym; 3] { core::array::from_fn(|i| w[from + i]) };
        Slot {
            state,
            command,
            memory: Memory::load(memory),
            rotor_command: [zero; MAX_ROTORS],
            attitude_command: [zero; 4],
            disturbance_force: at(0),
            disturbance_torque: at(3),
            wind: at(6),
            ground_z: w[9],
            ceiling_z: w[10],
            effect_memory: m[m.len() - self.effects..].to_vec(),
        }
    }

    /// Numbers of a state in the order of the input `x`.
    fn numbers(&self, s: &State<Sym>) -> Vec<Sym> {
        let mut out = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel].concat();
        match self.is_rotors() {
            true => out.extend(&s.rotor_vel[..self.rotors()]),
            false => out.push(s.thrust),
        }
        out
    }

    /// What controllers and effects remember, in the order of the input `m`.
    fn remembered(&self, slot: &Slot<Sym>) -> Vec<Sym> {
        let mut all = Vec::new();
        slot.memory.store(|_, v| all.push(v));
        self.memory.iter().map(|i| all[*i]).chain(slot.effect_memory.iter().copied()).collect()
    }

    /// The controllers, all of which tick.
    fn control(&self, slot: &mut Slot<Sym>, drone: &Drone<Sym>, all: &[Sym]) {
        let due = Due { state: true, attitude: true, force_torque: true };
        let p = periods(&self.rates);
        let periods = mellinger::Periods {
            state: Sym::lit(p.state),
            attitude: Sym::lit(p.attitude),
            body_rate: Sym::lit(p.body_rate),
        };
        let due = super::traced::relevant(self.asked.control, due);
        let dt = 1.0 / f64::from(self.asked.sim_hz);
        let (time_s, normals) = self.course(all);
        slot.control(drone, (self.asked.control, due, &periods), (Sym::lit(dt), dt), (time_s, normals, &[]));
    }

    fn rate(&self, all: &[Sym]) -> Vec<Sym> {
        let (drone, mut slot) = (self.vehicle(all), self.slot(all));
        let command = match self.is_rotors() {
            true => {
                Command::Rotors(core::array::from_fn(|i| slot.command.get(i).copied().unwrap_or(Sym::zero())))
            }
            false => Command::Attitude(core::array::from_fn(|i| slot.command[i])),
        };
        let effects = std::mem::take(&mut slot.effect_memory);
        let (time_s, normals) = self.course(all);
        let mut surroundings = slot.surroundings(&slot.command, (time_s, normals, &[]));
        let dt = 1.0 / f64::from(self.asked.sim_hz);
        surroundings.memory = Remembered { numbers: &effects, step_s: dt };
        drone.recall(&effects, dt, &mut surroundings);
        let rate = drone.rate(&slot.state, &command, &surroundings);
        let [x, y, z] = rate.ang_vel;
        let half = Sym::lit(0.5);
        let turn = quat::mul(slot.state.quat, [x * half, y * half, z * half, Sym::zero()]);
        let mut out = [&rate.vel[..], &turn, &rate.acc, &rate.ang_acc].concat();
        match self.is_rotors() {
            true => out.extend(&rate.rotor_acc[..self.rotors()]),
            false => out.push(rate.thrust_rate),
        }
        out
    }

    /// Time and normal random numbers.
    fn course(&self, all: &[Sym]) -> (Sym, [Sym; 6]) {
        let w = self.around(all);
        (w[11], core::array::from_fn(|i| w[12 + i]))
    }

    fn step(&self, all: &[Sym]) -> (Vec<Sym>, Vec<Sym>) {
        let (drone, mut slot) = (self.vehicle(all), self.slot(all));
        self.control(&mut slot, &drone, all);
        let (time_s, normals) = self.course(all);
        let dt = 1.0 / f64::from(self.asked.sim_hz);
        slot.state = slot.moved(&drone, self.asked.integrator, (Sym::lit(dt), dt), (time_s, normals, &[]));
        (self.numbers(&slot.state), self.remembered(&slot))
    }

    fn controller(&self, all: &[Sym]) -> (Vec<Sym>, Vec<Sym>) {
        let (drone, mut slot) = (self.vehicle(all), self.slot(all));
        self.control(&mut slot, &drone, all);
        let told = match self.is_rotors() {
            true => slot.rotor_command[..self.rotors()].to_vec(),
            false => slot.attitude_command.to_vec(),
        };
        (told, self.remembered(&slot))
    }
}

/// A function of a vehicle. Inputs, each a vector: `x` the state, `u` the command, `m` what controllers and effects remember (where there is
/// any), `w` what surrounds the drone (where it is asked for), `p` free parameters (where some are asked for); a gradient has `dx` and `dm` too. All are f64.
///
/// # Errors
/// [`RolloutError::Option`] for a model or a control mode that the vehicle lacks, [`RolloutError::NoParameter`].
pub fn function(vehicle: &Vehicle, asked: &Asked) -> Result<Printed, RolloutError> {
    let option = |name, expected: String, got: String| RolloutError::Option { name, expected, got };
    let models = vehicle.available_dynamics();
    if !models.contains(&asked.dynamics.as_str()) {
        return Err(option("dynamics", models.join(", "), asked.dynamics.clone()));
    }
    let fails =
        |e: propwash_vehicle::VehicleError| option("dynamics", "one that can be flown".into(), e.to_string());
    let drone = vehicle.drone(&asked.dynamics).map_err(fails)?;
    let modes = vehicle.modes(&asked.dynamics).map_err(fails)?;
    if asked.what != What::Rate && !modes.contains(&asked.control) {
        let names: Vec<&str> = modes.iter().map(|m| m.name()).collect();
        return Err(option("control", names.join(", "), asked.control.name().into()));
    }
    if asked.sim_hz == 0 {
        return Err(option("sim_hz", "at least 1".into(), "0".into()));
    }
    let rate = asked.what == What::Rate;
    let effects = drone.memory_len(1.0 / f64::from(asked.sim_hz));
    let memory = if rate { Vec::new() } else { Memory::<f64>::used(asked.control, drone.airframe.n_rotors) };
    let inputs = Inputs { groups: Vec::new() };
    let mut maker = Maker { asked, drone, rates: vehicle.rates, memory, effects, inputs };
    maker.gather()?;
    Ok(maker.printed(&vehicle.name))
}

impl Maker<'_> {
    /// Names the inputs.
    fn gather(&mut self) -> Result<(), RolloutError> {
        let rate = self.asked.what == What::Rate;
        let (state, is_rotors) = (self.state(), self.is_rotors());
        self.inputs.add("x", "state: position (m, world), attitude x y z w (body to world), velocity (m/s, world), angular velocity (rad/s, body), rotors or thrust", state);
        let control = match rate {
            true if is_rotors => ControlMode::RotorVel,
            true => ControlMode::Attitude,
            false => self.asked.control,
        };
        let command = self.command(control);
        self.inputs.add("u", &format!("command: {}", control.name()), command);
        let mut remembered: Vec<(String, f64)> =
            self.memory.iter().map(|i| (format!("controller_{i}"), 0.0)).collect();
        remembered.extend((0..self.effects).map(|i| (format!("effect_{i}"), 0.0)));
        self.inputs.add("m", "what controllers and effects remember", remembered);
        if self.asked.surroundings {
            let about = "surroundings: force (N, world), torque (N m, world), wind (m/s, world), heights of ground and ceiling (m), time (s), normal random numbers";
            self.inputs.add("w", about, surroundings());
        }
        let wanted = &self.asked.parameters;
        let all = wanted.iter().any(|name| name == "all");
        let mut free = Vec::new();
        self.drone.clone().visit(&mut |name, value| {
            if all || wanted.iter().any(|own| own == name) {
                free.push((name.to_string(), *value));
            }
        });
        let missing = wanted.iter().find(|own| *own != "all" && !free.iter().any(|(name, _)| name == *own));
        if let Some(name) = missing {
            let close = close_names(&mut self.drone.clone(), name);
            return Err(RolloutError::NoParameter { drone: 0, name: name.clone(), close });
        }
        self.inputs.add("p", "parameters", free);
        Ok(())
    }

    /// The function with its outputs.
    fn printed(mut self, vehicle: &str) -> Printed {
        let out = |name: &str, about: &str, entries: Vec<String>| Group {
            name: name.into(),
            about: about.into(),
            defaults: vec![0.0; entries.len()],
            entries,
        };
        let names = |list: Vec<(String, f64)>| list.into_iter().map(|(name, _)| name).collect::<Vec<_>>();
        let memory =
            self.inputs.groups.iter().find(|g| g.name == "m").map(|g| g.entries.clone()).unwrap_or_default();
        let n: usize = self.inputs.groups.iter().map(|g| g.entries.len()).sum();
        let state = names(self.state());
        let mut outputs = match self.asked.what {
            What::Rate => vec![out("x_rate", "time derivative of x", state)],
            What::Step | What::Gradient => vec![out("x_next", "state after the step", state)],
            What::Controller => {
                let mode = if self.is_rotors() { ControlMode::RotorVel } else { ControlMode::Attitude };
                vec![out("told", "what the controllers command", names(self.command(mode)))]
            }
        };
        if self.asked.what != What::Rate && !memory.is_empty() {
            outputs.push(out("m_next", "what they remember then", memory));
        }
        let mut graph = trace_finite(n, |all| match self.asked.what {
            What::Rate => self.rate(all),
            What::Step | What::Gradient => {
                let (x, m) = self.step(all);
                [x, m].concat()
            }
            What::Controller => {
                let (told, m) = self.controller(all);
                [told, m].concat()
            }
        });
        if self.asked.what == What::Gradient {
            // Seeds become inputs, and the inputs' gains outputs.
            let step = graph;
            let (given, seeds) = (n, step.outputs.len());
            graph = trace_finite(given + seeds, |all| pull_back::<Sym>(&step, &all[..given], &all[given..]));
            let gains = self.inputs.groups.iter().map(|g| {
                out(
                    &format!("{}_gain", g.name),
                    &format!("what the loss gains by {}", g.name),
                    g.entries.clone(),
                )
            });
            let gains = gains.collect();
            for group in outputs {
                let seed = format!("{}_seed", group.name);
                let about = format!("what the loss gains by {}", group.name);
                self.inputs.add(&seed, &about, group.entries.into_iter().map(|name| (name, 0.0)).collect());
            }
            outputs = gains;
        }
        let Asked { what, dynamics, control, integrator, sim_hz, .. } = self.asked;
        let what = What::ALL.iter().find(|(_, own)| own == what).map_or("", |(name, _)| name);
        let how = match what {
            "rate" => String::new(),
            _ => format!(" under commands `{}`", control.name()),
        };
        let pace = match what {
            "step" | "gradient" => format!(", {} at {sim_hz} Hz", integrator.name()),
            _ => String::new(),
        };
        // A name of every language, and nothing that would end a comment.
        let vehicle: String =
            vehicle.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        let about = format!("{what} of {vehicle}, {dynamics}{how}{pace}");
        let before = if vehicle.starts_with(|c: char| c.is_ascii_digit()) { "vehicle_" } else { "" };
        Printed {
            name: format!("{before}{vehicle}_{what}"),
            about,
            inputs: self.inputs.groups,
            outputs,
            graph: written_out(&graph),
        }
    }
}
