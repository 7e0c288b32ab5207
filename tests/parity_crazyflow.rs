//! Our physics against Crazyflow 0.4.0 in float64: derivatives, controller stages, flights. Where we differ on purpose, a test
//! of its own shows both behaviours; `docs/crazyflow-differences.md` lists them.

mod common;

use common::crazyflow::{Arrays, Comparison, DYNAMICS, Reference, VEHICLES, drone_from_reference, reference};
use common::notes::tell;
use propwash::math::{quat, vec3};
use propwash::physics::controllers::{ControlMode, Due, Memory, Rates, mellinger};
use propwash::physics::drone::{Drone, Dynamics};
use propwash::physics::effects::Command;
use propwash::physics::integrate::Integrator;
use propwash::physics::rigid_body::{MAX_ROTORS, Rate, State};
use propwash::physics::rotor;
use propwash::physics::surroundings::Surroundings;
use propwash::rollout::{RotorStart, Sim, SimOptions};
use propwash::units::{rad_s_to_rpm, rpm_to_rad_s};
use propwash::vehicle::Vehicle;
use serde_json::Value;

/// Relative difference allowed between two float64 programs that compute the same formula in another order.
const SAME: f64 = 1e-9;
/// Distance allowed between two flights of 1,000 steps, m.
const SAME_PLACE_M: f64 = 1e-6;
/// Pitch up to which our fitted models are Crazyflow's, rad.
const MAX_PITCH: f64 = 85.0 * core::f64::consts::PI / 180.0;
/// Nothing ticks.
const NOTHING_DUE: Due = Due { state: false, attitude: false, force_torque: false };

/// The reference, or an early return: the reason was printed.
macro_rules! reference_or_skip {
    () => {
        match reference() {
            Some(reference) => {
                println!("compared with {}", reference.versions);
                reference
            }
            None => return,
        }
    };
}

/// The four rotor speeds of Crazyflow (rpm) as ours (rad/s).
fn rotors_from_rpm(rpm: [f64; 4]) -> [f64; MAX_ROTORS] {
    core::array::from_fn(|i| if i < 4 { rpm_to_rad_s(rpm[i]) } else { 0.0 })
}

/// Our rotor speeds (rad/s) as those of Crazyflow (rpm).
fn in_rpm(rotors: &[f64; MAX_ROTORS]) -> [f64; 4] {
    core::array::from_fn(|i| rad_s_to_rpm(rotors[i]))
}

/// Sets what Crazyflow calls `rotor_vel`: rotor speeds, or the collective thrust of the fitted models.
fn set_rotor_vel(drone: &Drone<f64>, state: &mut State<f64>, rotor_vel: [f64; 4]) {
    match drone.dynamics {
        Dynamics::Rotors => state.rotor_vel = rotors_from_rpm(rotor_vel),
        Dynamics::AttitudeResponse(_) => state.thrust = rotor_vel[0],
    }
}

/// A state at row `i` of the arrays called `PREFIX.quat` and so on.
fn state_at(drone: &Drone<f64>, data: &Arrays, prefix: &str, i: usize) -> State<f64> {
    let get = |quantity: &str| data.get(&format!("{prefix}.{quantity}"));
    let mut state = State {
        quat: get("quat").at(&[i]),
        vel: get("vel").at(&[i]),
        ang_vel: get("ang_vel").at(&[i]),
        ..State::rest()
    };
    set_rotor_vel(drone, &mut state, get("rotor_vel").at(&[i]));
    state
}

/// What Crazyflow's dynamics take as command.
fn command(drone: &Drone<f64>, cmd: [f64; 4]) -> Command<f64> {
    match drone.dynamics {
        Dynamics::Rotors => Command::Rotors(rotors_from_rpm(cmd)),
        Dynamics::AttitudeResponse(_) => Command::Attitude(cmd),
    }
}

#[test]
fn derivatives_of_every_model_agree() {
    let reference = reference_or_skip!();
    let data = reference.arrays("derivatives");
    let (mut models, mut samples, mut worst) = (0, 0, 0.0f64);
    for vehicle in VEHICLES {
        for dynamics in DYNAMICS.into_iter().filter(|d| reference.has(vehicle, d)) {
            models += 1;
            let drone = drone_from_reference(reference, vehicle, dynamics);
            let prefix = format!("{vehicle}.{dynamics}");
            let get = |quantity: &str| data.get(&format!("{prefix}.{quantity}"));
            let comparison = |quantity: &str| Comparison::new(format!("{prefix} {quantity}"));
            let mut acc = comparison("acceleration");
            let mut ang_acc = comparison("angular acceleration");
            let mut rotor_acc = comparison("rotor or thrust rate");
            for i in 0..get("pitch").shape[0] {
                // Beyond it the fitted models differ on purpose; see the test about 90 degrees.
                if dynamics != "first_principles" && get("pitch").number(&[i]).abs() > MAX_PITCH {
                    continue;
                }
                let surroundings = Surroundings {
                    disturbance_force_n: get("dist_f").at(&[i]),
                    disturbance_torque_n_m: get("dist_t").at(&[i]),
                    ..Surroundings::calm()
                };
                let state = state_at(&drone, &data, &prefix, i);
                let rate = drone.rate(&state, &command(&drone, get("cmd").at(&[i])), &surroundings);
                acc.add(&rate.acc, get("acc").row(&[i]));
                ang_acc.add(&rate.ang_acc, get("ang_acc").row(&[i]));
                let ours = match drone.dynamics {
                    Dynamics::Rotors => in_rpm(&rate.rotor_acc),
                    Dynamics::AttitudeResponse(_) => [rate.thrust_rate; 4],
                };
                rotor_acc.add(&ours, get("rotor_acc").row(&[i]));
            }
            for quantity in [acc, ang_acc, rotor_acc] {
                assert!(quantity.samples() >= 1000, "{} samples", quantity.samples());
                samples += quantity.samples();
                worst = worst.max(quantity.check(SAME));
            }
        }
    }
    assert_eq!(models, 19, "four models of four vehicles and three of hb_x500");
    tell(&format!(
        "derivatives vs {}, float64: {models} models of vehicles, {samples} states, worst {worst:.1e} relative",
        reference.versions
    ));
}

#[test]
fn rotor_speeds_survive_the_way_from_rpm_to_rad_s_and_back() {
    let reference = reference_or_skip!();
    let data = reference.arrays("derivatives");
    let mut there_and_back = Comparison::new("rotor speeds in rpm");
    for vehicle in VEHICLES.into_iter().filter(|v| reference.has(v, "first_principles")) {
        let speeds = data.get(&format!("{vehicle}.first_principles.rotor_vel"));
        let drone = drone_from_reference(reference, vehicle, "first_principles");
        let table = &reference.params[vehicle]["dynamics"]["first_principles"]["rpm2thrust"];
        let curve: Vec<f64> = (0..3).map(|k| table[k].as_f64().unwrap()).collect();
        let mut thrust = Comparison::new(format!("{vehicle} thrust at the same speed in either unit"));
        for i in 0..speeds.shape[0] {
            let rpm: [f64; 4] = speeds.at(&[i]);
            let rad_s = rotors_from_rpm(rpm);
            there_and_back.add(&in_rpm(&rad_s), &rpm);
            for (k, r) in rpm.iter().enumerate() {
                // One turn is 2 pi rad, one minute is 60 s.
                assert!((rad_s[k] - r * core::f64::consts::TAU / 60.0).abs() <= 1e-12 * r);
                let ours = rotor::curve(drone.airframe.rotors[k].thrust_curve, rad_s[k]);
                thrust.add(&[ours], &[curve[0] + curve[1] * r + curve[2] * r * r]);
            }
        }
        thrust.check(SAME);
    }
    there_and_back.check(1e-15);
}

/// One tick of one controller stage, on row `i` of its reference inputs.
fn tick(drone: &Drone<f64>, data: &Arrays, vehicle: &str, stage: &str, i: usize) -> Memory<f64> {
    let get = |quantity: &str| data.get(&format!("{vehicle}.{stage}.{quantity}"));
    let mut memory = Memory::zero();
    let mut state = State::rest();
    let mut command = [0.0; 16];
    let cmd = get("cmd").row(&[i]);
    let (mode, due) = match stage {
        "state" => {
            command.copy_from_slice(cmd);
            state.pos = get("pos").at(&[i]);
            state.quat = get("quat").at(&[i]);
            state.vel = get("vel").at(&[i]);
            memory.pos_err_integral = get("integral").at(&[i]);
            (ControlMode::State, Due { state: true, ..NOTHING_DUE })
        }
        "force_torque" => {
            command[..4].copy_from_slice(cmd);
            (ControlMode::ForceTorque, Due { force_torque: true, ..NOTHING_DUE })
        }
        _ => {
            command[..4].copy_from_slice(cmd);
            state.quat = get("quat").at(&[i]);
            state.ang_vel = get("ang_vel").at(&[i]);
            memory.attitude_ticked = [1.0];
            memory.prev_ang_vel = get("prev_ang_vel").at(&[i]);
            memory.ang_vel_cmd = get("prev_rates").at(&[i]);
            memory.staged_ang_vel = get("rates").at(&[i]);
            memory.attitude_err_integral = get("integral").at(&[i]);
            let mode = match stage {
                "attitude" => ControlMode::Attitude,
                "body_rate" => ControlMode::BodyRate,
                // Body rates reach the attitude stage from the state stage.
                _ => {
                    memory.staged_attitude.copy_from_slice(cmd);
                    ControlMode::State
                }
            };
            (mode, Due { attitude: true, ..NOTHING_DUE })
        }
    };
    let attitude_hz = if stage == "attitude_with_rates" { 250.0 } else { 500.0 };
    let periods =
        mellinger::Periods { state: 1.0 / 100.0, attitude: 1.0 / attitude_hz, body_rate: 1.0 / 500.0 };
    let gravity = drone.body.gravity_m_s2;
    mellinger::run(&drone.controller, gravity, mode, due, &periods, &state, &command, &mut memory);
    memory
}

/// What came out of a stage: command, integral.
fn outcome(stage: &str, memory: &Memory<f64>) -> ([f64; 4], [f64; 3]) {
    match stage {
        "state" => (memory.staged_attitude, memory.pos_err_integral),
        "force_torque" => (in_rpm(&memory.rotor_cmd), [0.0; 3]),
        _ => (memory.staged_force_torque, memory.attitude_err_integral),
    }
}

/// Collective thrust (N) that row `i` of a stage asks for: that which decides whether the torques are zero.
fn thrust_asked(data: &Arrays, vehicle: &str, stage: &str, i: usize) -> f64 {
    match stage {
        "state" => data.get(&format!("{vehicle}.state.out")).number(&[i, 3]),
        "force_torque" => data.get(&format!("{vehicle}.force_torque.cmd")).number(&[i, 0]),
        _ => data.get(&format!("{vehicle}.{stage}.cmd")).number(&[i, 3]),
    }
}

const STAGES_WITH_INTEGRALS: [&str; 4] = ["state", "attitude", "attitude_with_rates", "body_rate"];

/// Our commands of one stage against Crazyflow's, over the rows that `wanted` picks.
fn compare_commands(
    drone: &Drone<f64>,
    data: &Arrays,
    vehicle: &str,
    stage: &str,
    wanted: impl Fn(f64) -> bool,
    mut integrals: impl FnMut(usize, [f64; 3]),
) -> (usize, f64) {
    let out = data.get(&format!("{vehicle}.{stage}.out"));
    let names = match stage {
        "state" => ["attitude", "thrust"],
        "force_torque" => ["rotor speeds", "rotor speeds"],
        _ => ["torque", "force"],
    };
    let mut vector = Comparison::new(format!("{vehicle} {stage} stage: {}", names[0]));
    let mut scalar = Comparison::new(format!("{vehicle} {stage} stage: {}", names[1]));
    for i in 0..out.shape[0] {
        if !wanted(thrust_asked(data, vehicle, stage, i)) {
            continue;
        }
        let (ours, integral) = outcome(stage, &tick(drone, data, vehicle, stage, i));
        let theirs: [f64; 4] = out.at(&[i]);
        match stage {
            "state" => {
                vector.add_angles(&ours[..3], &theirs[..3]);
                scalar.add(&ours[3..], &theirs[3..]);
            }
            "force_torque" => vector.add(&ours, &theirs),
            _ => {
                vector.add(&ours[1..], &theirs[1..]);
                scalar.add(&ours[..1], &theirs[..1]);
            }
        }
        integrals(i, integral);
    }
    let mut worst = vector.check(SAME);
    if scalar.samples() > 0 {
        worst = worst.max(scalar.check(SAME));
    }
    (vector.samples(), worst)
}

#[test]
fn every_controller_stage_agrees_while_thrust_is_asked_for() {
    let reference = reference_or_skip!();
    let data = reference.arrays("stages");
    let (mut all, mut worst) = (0, 0.0f64);
    for vehicle in VEHICLES {
        let drone = drone_from_reference(reference, vehicle, "so_rpy");
        for stage in STAGES_WITH_INTEGRALS {
            let theirs = data.get(&format!("{vehicle}.{stage}.out_integral"));
            let mut integral = Comparison::new(format!("{vehicle} {stage} stage: integral"));
            let (samples, worst_command) = compare_commands(
                &drone,
                &data,
                vehicle,
                stage,
                |thrust| thrust > 0.0,
                |i, ours| integral.add(&ours, theirs.row(&[i])),
            );
            assert!(samples >= 1000, "{samples} samples");
            all += samples;
            worst = worst.max(worst_command).max(integral.check(SAME));
        }
        // The mixer has no integral; a force of exactly zero is another test's.
        let (samples, worst_mixer) =
            compare_commands(&drone, &data, vehicle, "force_torque", |thrust| thrust != 0.0, |_, _| ());
        assert!(samples >= 1000, "{samples} samples");
        all += samples;
        worst = worst.max(worst_mixer);
    }
    tell(&format!(
        "controller stages vs {}, float64: 5 stages of 5 vehicles, {all} inputs, worst {worst:.1e} relative",
        reference.versions
    ));
}

#[test]
fn without_thrust_all_integrals_are_cleared_where_crazyflow_keeps_them() {
    let reference = reference_or_skip!();
    let data = reference.arrays("stages");
    for vehicle in VEHICLES {
        let drone = drone_from_reference(reference, vehicle, "so_rpy");
        for stage in STAGES_WITH_INTEGRALS {
            let theirs = data.get(&format!("{vehicle}.{stage}.out_integral"));
            let mut kept = 0;
            // The commands are the same: torques vanish in both.
            let (samples, _) = compare_commands(
                &drone,
                &data,
                vehicle,
                stage,
                |thrust| thrust <= 0.0,
                |i, ours| {
                    assert_eq!(ours, [0.0; 3], "{vehicle} {stage} row {i}");
                    kept += usize::from(theirs.row(&[i]).iter().all(|x| x.abs() > 0.0));
                },
            );
            assert!(samples >= 50 && kept == samples, "Crazyflow kept {kept} of {samples} integrals");
        }
    }
}

#[test]
fn a_collective_thrust_of_zero_stops_the_motors_where_crazyflow_keeps_some_turning() {
    let reference = reference_or_skip!();
    let data = reference.arrays("stages");
    for vehicle in VEHICLES {
        let drone = drone_from_reference(reference, vehicle, "so_rpy");
        let out = data.get(&format!("{vehicle}.force_torque.out"));
        // Crazyflow inverts the thrust curve at zero thrust; a curve that dips below zero first is there at |c1| / c2.
        let curve = &reference.params[vehicle]["controller"]["core"]["rpm2thrust"];
        let (c1, c2) = (curve[1].as_f64().unwrap(), curve[2].as_f64().unwrap());
        let (mut samples, expected) = (0, (-c1 / c2).max(0.0));
        for i in 0..out.shape[0] {
            if thrust_asked(&data, vehicle, "force_torque", i) != 0.0 {
                continue;
            }
            samples += 1;
            assert_eq!(tick(&drone, &data, vehicle, "force_torque", i).rotor_cmd, [0.0; MAX_ROTORS]);
            for rpm in out.at::<4>(&[i]) {
                assert!((rpm - expected).abs() <= 1e-9 * expected, "{vehicle}: {rpm} rpm, not {expected}");
            }
        }
        println!("  {vehicle}: {samples} samples, Crazyflow commands {expected:.0} rpm, Propwash 0");
        assert!(samples >= 50);
    }
}

/// One simulation run of the reference.
struct Run<'a> {
    meta: &'a Value,
    data: &'a Arrays,
    drone: Drone<f64>,
    mode: ControlMode,
    rates: Rates,
    sim_hz: u32,
}

impl<'a> Run<'a> {
    fn new(reference: &Reference, list: &'a Value, data: &'a Arrays, name: &str) -> Self {
        let meta = list.as_array().unwrap().iter().find(|r| r["name"] == name);
        let meta = meta.unwrap_or_else(|| panic!("the reference has no run {name}"));
        let text = |key: &str| meta[key].as_str().unwrap();
        let hz = |key: &str| meta["rates"][key].as_u64().unwrap() as u32;
        Self {
            meta,
            data,
            drone: drone_from_reference(reference, text("vehicle"), text("dynamics")),
            mode: ControlMode::ALL.into_iter().find(|m| m.name() == text("control")).unwrap(),
            rates: Rates {
                state_hz: hz("state_freq"),
                attitude_hz: hz("attitude_freq"),
                body_rate_hz: hz("body_rate_freq"),
                force_torque_hz: hz("force_torque_freq"),
            },
            sim_hz: meta["freq"].as_u64().unwrap() as u32,
        }
    }

    fn name(&self) -> &str {
        self.meta["name"].as_str().unwrap()
    }

    fn integrator(&self) -> Integrator {
        match self.meta["integrator"].as_str().unwrap() {
            "euler" => Integrator::Euler,
            "symplectic_euler" => Integrator::SemiImplicitEuler,
            "rk4" => Integrator::Rk4,
            other => panic!("unknown integrator {other}"),
        }
    }

    fn get(&self, quantity: &str) -> &'a common::crazyflow::Array {
        self.data.get(&format!("{}.{quantity}", self.name()))
    }

    fn worlds(&self) -> usize {
        self.get("cmd").shape[1]
    }

    fn steps(&self) -> usize {
        self.get("cmd").shape[0]
    }

    fn stride(&self) -> usize {
        self.meta["stride"].as_u64().unwrap() as usize
    }

    /// Command of a step as ours: rotor speeds in rad/s.
    fn command(&self, step: usize, world: usize) -> [f64; 16] {
        let mut out = [0.0; 16];
        for (slot, x) in out.iter_mut().zip(self.get("cmd").row(&[step, world])) {
            *slot = if self.mode == ControlMode::RotorVel { rpm_to_rad_s(*x) } else { *x };
        }
        out
    }

    /// Flies one world in Crazyflow's order (controllers, limits, integration) and shows every state to
    /// `see(step, state, command)`.
    fn fly(
        &self,
        world: usize,
        advance: impl Fn(&State<f64>, f64, &dyn Fn(&State<f64>) -> Rate<f64>) -> State<f64>,
        mut see: impl FnMut(usize, &State<f64>, &Command<f64>),
    ) {
        let at = |quantity: &str| self.get(quantity);
        let mut state = State {
            pos: at("init_pos").at(&[world]),
            quat: at("init_quat").at(&[world]),
            vel: at("init_vel").at(&[world]),
            ang_vel: at("init_ang_vel").at(&[world]),
            ..State::rest()
        };
        set_rotor_vel(&self.drone, &mut state, at("init_rotor_vel").at(&[world]));
        let surroundings = Surroundings {
            disturbance_force_n: at("init_force").at(&[world]),
            disturbance_torque_n_m: at("init_torque").at(&[world]),
            ..Surroundings::calm()
        };
        let period = |hz: u32| 1.0 / f64::from(hz);
        let periods = mellinger::Periods {
            state: period(self.rates.state_hz),
            attitude: period(self.rates.attitude_hz),
            body_rate: period(self.rates.body_rate_hz),
        };
        let controller = &self.drone.controller;
        let gravity = self.drone.body.gravity_m_s2;
        // Crazyflow's first tick differs from rates of zero.
        let mut memory = Memory { attitude_ticked: [1.0], ..Memory::zero() };
        for step in 0..self.steps() {
            let due = self.rates.due(self.mode, step as u64, self.sim_hz);
            let wanted = self.command(step, world);
            mellinger::run(controller, gravity, self.mode, due, &periods, &state, &wanted, &mut memory);
            let command = match self.drone.dynamics {
                Dynamics::Rotors => {
                    let mut speeds = memory.rotor_cmd;
                    mellinger::limit_rotor_vel(controller, &mut speeds);
                    Command::Rotors(speeds)
                }
                Dynamics::AttitudeResponse(_) => {
                    let mut attitude = memory.attitude_cmd;
                    attitude[3] = mellinger::limit_thrust(controller, attitude[3]);
                    Command::Attitude(attitude)
                }
            };
            let rate = |s: &State<f64>| self.drone.rate(s, &command, &surroundings);
            state = advance(&state, period(self.sim_hz), &rate);
            see(step, &state, &command);
        }
    }

    /// The worst differences over all worlds and recorded states of the same run in Crazyflow.
    fn difference(
        &self,
        advance: impl Fn(&State<f64>, f64, &dyn Fn(&State<f64>) -> Rate<f64>) -> State<f64>,
    ) -> Difference {
        let mut worst = Difference::default();
        for world in 0..self.worlds() {
            self.fly(world, &advance, |step, state, _| {
                if (step + 1) % self.stride() != 0 {
                    return;
                }
                let at = [step / self.stride(), world];
                let apart =
                    |ours: [f64; 3], quantity: &str| vec3::norm(vec3::sub(ours, self.get(quantity).at(&at)));
                let turn = quat::mul(quat::conjugate(self.get("quat").at(&at)), state.quat);
                let rotor_vel: [f64; 4] = self.get("rotor_vel").at(&at);
                let (ours, scale) = match self.drone.dynamics {
                    Dynamics::Rotors => (in_rpm(&state.rotor_vel), 1e4),
                    Dynamics::AttitudeResponse(_) => ([state.thrust; 4], self.drone.hover_thrust()),
                };
                let rotor = (0..4).map(|i| (ours[i] - rotor_vel[i]).abs() / scale).fold(0.0, f64::max);
                worst.include(&Difference {
                    states: 1,
                    pos_m: apart(state.pos, "pos"),
                    vel_m_s: apart(state.vel, "vel"),
                    angle_rad: 2.0 * vec3::norm([turn[0], turn[1], turn[2]]).atan2(turn[3].abs()),
                    ang_vel_rad_s: apart(state.ang_vel, "ang_vel"),
                    rotor,
                });
            });
        }
        worst
    }
}

/// How far two flights are apart; `rotor` relative to 10,000 rpm or the hover thrust.
#[derive(Clone, Copy, Debug, Default)]
struct Difference {
    states: usize,
    pos_m: f64,
    vel_m_s: f64,
    angle_rad: f64,
    ang_vel_rad_s: f64,
    rotor: f64,
}

impl Difference {
    fn include(&mut self, other: &Self) {
        // Not a number counts as infinitely far.
        let worse = |a: f64, b: f64| if b.is_nan() { f64::INFINITY } else { a.max(b) };
        self.states += other.states;
        self.pos_m = worse(self.pos_m, other.pos_m);
        self.vel_m_s = worse(self.vel_m_s, other.vel_m_s);
        self.angle_rad = worse(self.angle_rad, other.angle_rad);
        self.ang_vel_rad_s = worse(self.ang_vel_rad_s, other.ang_vel_rad_s);
        self.rotor = worse(self.rotor, other.rotor);
    }

    fn print(&self, name: &str) {
        println!(
            "  {name:<40} {:>4} states: {:.1e} m, {:.1e} m/s, {:.1e} rad, {:.1e} rad/s, rotors {:.1e}",
            self.states, self.pos_m, self.vel_m_s, self.angle_rad, self.ang_vel_rad_s, self.rotor
        );
    }

    fn check(&self, name: &str) {
        self.print(name);
        assert!(self.states >= 400, "{name}: {} states", self.states);
        assert!(self.pos_m <= SAME_PLACE_M, "{name}: {self:?}");
        let others = [self.vel_m_s, self.angle_rad, self.ang_vel_rad_s, self.rotor];
        assert!(others.iter().all(|d| *d <= 1e-5), "{name}: {self:?}");
    }
}

/// Names of the runs of which `wanted` holds.
fn run_names(list: &Value, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let names = list.as_array().unwrap().iter().map(|r| r["name"].as_str().unwrap().to_owned());
    names.filter(|n| wanted(n)).collect()
}

#[test]
fn flights_of_a_thousand_steps_stay_together_in_every_mode_of_every_vehicle() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let names = run_names(&list, |n| VEHICLES.iter().any(|v| n.starts_with(v)));
    assert_eq!(names.len(), 4 * (5 + 3 * 2) + 3 * 2, "every mode that Crazyflow has");
    let (n, mut worst) = (names.len(), 0.0f64);
    for name in names {
        let run = Run::new(reference, &list, &data, &name);
        assert_eq!(run.steps(), 1000);
        let integrator = run.integrator();
        let difference = run.difference(|s, dt, rate| integrator.step(s, dt, rate));
        difference.check(&name);
        worst = worst.max(difference.pos_m);
    }
    tell(&format!(
        "closed-loop flights vs {}: {n} flights of 1,000 steps × 4 worlds, worst {worst:.1e} m",
        reference.versions
    ));
}

#[test]
fn the_batched_simulation_of_the_vehicle_files_flies_the_same() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let mut all = 0.0f64;
    for name in run_names(&list, |n| VEHICLES.iter().any(|v| n.starts_with(v))) {
        let run = Run::new(reference, &list, &data, &name);
        let (vehicle, dynamics) =
            (run.meta["vehicle"].as_str().unwrap(), run.meta["dynamics"].as_str().unwrap());
        let drone = Vehicle::builtin(vehicle).unwrap().drone(dynamics).unwrap();
        let options = SimOptions {
            n_worlds: run.worlds(),
            sim_hz: run.sim_hz,
            integrator: run.integrator(),
            control: run.mode,
            rotor_start: RotorStart::Off,
            ..SimOptions::default()
        };
        let mut sim = Sim::new(options, vec![(drone.clone(), run.rates)]).unwrap();
        for world in 0..run.worlds() {
            let mut state = State {
                pos: run.get("init_pos").at(&[world]),
                quat: quat::normalize(run.get("init_quat").at(&[world])),
                vel: run.get("init_vel").at(&[world]),
                ang_vel: run.get("init_ang_vel").at(&[world]),
                ..State::rest()
            };
            set_rotor_vel(&drone, &mut state, run.get("init_rotor_vel").at(&[world]));
            sim.set_initial(world, 0, state).unwrap();
        }
        sim.reset(None).unwrap();
        for world in 0..run.worlds() {
            let three = 3 * world..3 * world + 3;
            sim.data.disturbance_force[three.clone()]
                .copy_from_slice(&run.get("init_force").at::<3>(&[world]));
            sim.data.disturbance_torque[three].copy_from_slice(&run.get("init_torque").at::<3>(&[world]));
            // Crazyflow's first tick differs from rates of zero.
            let ticked = Memory { attitude_ticked: [1.0], ..Memory::zero() };
            sim.data.set_memory(world, 0, &ticked);
        }
        let mut worst = 0.0f64;
        for step in 0..run.steps() {
            let width = sim.command_width();
            let all: Vec<f64> =
                (0..run.worlds()).flat_map(|w| run.command(step, w)[..width].to_vec()).collect();
            sim.set_command(&all).unwrap();
            sim.step(1).unwrap();
            if (step + 1) % run.stride() == 0 {
                for world in 0..run.worlds() {
                    let theirs = run.get("pos").at(&[step / run.stride(), world]);
                    worst = worst.max(vec3::norm(vec3::sub(sim.data.state(world, 0).pos, theirs)));
                }
            }
        }
        println!("  {name:<40} {worst:.1e} m");
        // The vehicle file of hb_x500 has other rotor curves than Crazyflow's placeholders; its runs are of the fitted
        // models, which do not use them.
        assert!(worst <= SAME_PLACE_M, "{name}: {worst} m");
        all = all.max(worst);
    }
    tell(&format!(
        "vehicle files through the batched simulation vs {}: the same flights, worst {all:.1e} m",
        reference.versions
    ));
}

#[test]
fn the_first_attitude_tick_has_no_derivative_where_crazyflow_differs_from_zero() {
    let reference = reference_or_skip!();
    let drone = drone_from_reference(reference, "cf2x_L250", "first_principles");
    let state = State { ang_vel: [0.2, -0.1, 0.0], ..State::rest() };
    let torque = |ticked: f64, derivative: bool| {
        let mut controller = drone.controller;
        if !derivative {
            controller.attitude.kd_omega = [0.0; 3];
        }
        let mut memory = Memory { attitude_ticked: [ticked], ..Memory::zero() };
        let periods = mellinger::Periods { state: 0.01, attitude: 0.002, body_rate: 0.002 };
        let due = Due { attitude: true, ..NOTHING_DUE };
        let command =
            [0.0, 0.0, 0.0, drone.hover_thrust(), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        mellinger::run(
            &controller,
            drone.body.gravity_m_s2,
            ControlMode::Attitude,
            due,
            &periods,
            &state,
            &command,
            &mut memory,
        );
        memory.staged_force_torque
    };
    assert_eq!(torque(0.0, true), torque(0.0, false), "no last tick, no derivative");
    assert_ne!(torque(1.0, true), torque(1.0, false), "a last tick with rates of zero, as Crazyflow starts");
}

#[test]
fn flights_stay_together_with_other_integrators_and_with_stages_at_other_rates() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let names = run_names(&list, |n| n.starts_with("symplectic.") || n.starts_with("staggered."));
    assert_eq!(names.len(), 4);
    for name in names {
        let run = Run::new(reference, &list, &data, &name);
        let integrator = run.integrator();
        run.difference(|s, dt, rate| integrator.step(s, dt, rate)).check(&name);
    }
}

/// Runge–Kutta as Crazyflow has it: body rates averaged as if they were vectors, then one turn by the average.
fn crazyflow_rk4(state: &State<f64>, dt: f64, rate: &dyn Fn(&State<f64>) -> Rate<f64>) -> State<f64> {
    let advance = |k: &Rate<f64>, dt: f64| Integrator::Euler.step(state, dt, |_| *k);
    let k1 = rate(state);
    let k2 = rate(&advance(&k1, 0.5 * dt));
    let k3 = rate(&advance(&k2, 0.5 * dt));
    let k4 = rate(&advance(&k3, dt));
    let mean = |a: f64, b: f64, c: f64, d: f64| (a + 2.0 * b + 2.0 * c + d) / 6.0;
    let of3 = |get: fn(&Rate<f64>) -> [f64; 3]| {
        let (a, b, c, d) = (get(&k1), get(&k2), get(&k3), get(&k4));
        core::array::from_fn(|i| mean(a[i], b[i], c[i], d[i]))
    };
    let average = Rate {
        vel: of3(|k| k.vel),
        ang_vel: of3(|k| k.ang_vel),
        acc: of3(|k| k.acc),
        ang_acc: of3(|k| k.ang_acc),
        rotor_acc: core::array::from_fn(|i| {
            mean(k1.rotor_acc[i], k2.rotor_acc[i], k3.rotor_acc[i], k4.rotor_acc[i])
        }),
        thrust_rate: mean(k1.thrust_rate, k2.thrust_rate, k3.thrust_rate, k4.thrust_rate),
    };
    advance(&average, dt)
}

#[test]
fn rk4_flights_differ_only_by_how_body_rates_are_averaged() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    for name in ["rk4.first_principles", "rk4.so_rpy_rotor_drag"] {
        let run = Run::new(reference, &list, &data, name);
        // With Crazyflow's averaging, written down here, the flight is Crazyflow's …
        run.difference(crazyflow_rk4).check(&format!("{name}, averaged as there"));
        // … with ours it is near, and measurably another.
        let ours = run.difference(|s, dt, rate| Integrator::Rk4.step(s, dt, rate));
        ours.print(&format!("{name}, ours"));
        assert!(ours.angle_rad > 1e-9 && ours.angle_rad < 1e-3, "{ours:?}");
    }
}

#[test]
fn our_rk4_turns_with_fourth_order_where_averaged_body_rates_give_second() {
    let reference = reference_or_skip!();
    // A tumbling vehicle that spins up: all motion is smooth, the axis of rotation moves.
    let drone = drone_from_reference(reference, "cf21B_500", "first_principles");
    let hover = drone.hover_rotor_vel();
    let mut speeds = hover;
    for (speed, factor) in speeds.iter_mut().zip([1.10, 1.14, 1.12, 1.13]) {
        *speed *= factor;
    }
    let command = Command::Rotors(speeds);
    let calm = Surroundings::calm();
    let rate = |s: &State<f64>| drone.rate(s, &command, &calm);
    let start = State { vel: [1.0, -2.0, 0.5], ang_vel: [9.0, -6.0, 5.0], rotor_vel: hover, ..State::rest() };
    let fly = |step: &dyn Fn(&State<f64>, f64) -> State<f64>, steps: u32| {
        (0..steps).fold(start, |s, _| step(&s, 0.25 / f64::from(steps)))
    };
    let ours = |s: &State<f64>, dt: f64| Integrator::Rk4.step(s, dt, rate);
    let theirs = |s: &State<f64>, dt: f64| crazyflow_rk4(s, dt, &rate);
    let exact = fly(&ours, 8000);
    let errors = |step: &dyn Fn(&State<f64>, f64) -> State<f64>| {
        [25, 50, 100, 200].map(|steps| {
            let s = fly(step, steps);
            let turn = quat::mul(quat::conjugate(exact.quat), s.quat);
            let angle = 2.0 * vec3::norm([turn[0], turn[1], turn[2]]);
            (angle, vec3::norm(vec3::sub(s.pos, exact.pos)))
        })
    };
    let orders =
        |e: &[(f64, f64); 4]| [0, 1, 2].map(|i| ((e[i].0 / e[i + 1].0).log2(), (e[i].1 / e[i + 1].1).log2()));
    let (our_errors, their_errors) = (errors(&ours), errors(&theirs));
    let (our_orders, their_orders) = (orders(&our_errors), orders(&their_errors));
    for (name, e, o) in
        [("ours", &our_errors, &our_orders), ("averaged body rates", &their_errors, &their_orders)]
    {
        println!(
            "  {name}: {:.1e} rad and {:.1e} m at 100 Hz, orders (attitude, place) {o:.2?}",
            e[0].0, e[0].1
        );
    }
    for (angle, pos) in our_orders {
        assert!(angle > 3.7 && pos > 3.7, "{our_orders:?}");
    }
    for (angle, pos) in their_orders {
        assert!((1.7..2.3).contains(&angle) && (1.7..2.3).contains(&pos), "{their_orders:?}");
    }
}

#[test]
fn near_ninety_degrees_of_pitch_our_acceleration_is_bounded_where_crazyflows_grows_without_end() {
    let reference = reference_or_skip!();
    let data = reference.arrays("near_vertical");
    for vehicle in VEHICLES {
        for dynamics in ["so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"] {
            let drone = drone_from_reference(reference, vehicle, dynamics);
            let prefix = format!("{vehicle}.{dynamics}");
            let get = |quantity: &str| data.get(&format!("{prefix}.{quantity}"));
            let gap = |i: usize| get("gap_deg").number(&[i]);
            let n = get("gap_deg").shape[0];
            let calm = Surroundings::calm();
            let ours = |state: &State<f64>, i: usize| {
                vec3::norm(drone.rate(state, &command(&drone, get("cmd").at(&[i])), &calm).ang_acc)
            };
            let theirs = |i: usize| vec3::norm(get("ang_acc").at(&[i]));
            let within = |low: f64, high: f64, size: &dyn Fn(usize) -> f64| {
                (0..n).filter(|i| (low..high).contains(&gap(*i))).map(size).fold(0.0, f64::max)
            };
            let our_size = |i: usize| ours(&state_at(&drone, &data, &prefix, i), i);

            // Ten times nearer to 90 degrees, ten times the acceleration.
            let decades = [1e-4, 1e-3, 1e-2, 1e-1].map(|low| within(0.999 * low, 10.0 * low, &theirs));
            for pair in decades.windows(2) {
                assert!(pair[0] > 5.0 * pair[1], "{prefix}: {decades:?}");
            }
            let edge = within(4.0, 5.1, &theirs);
            let most = within(0.0, 5.1, &our_size);
            println!(
                "  {prefix}: at 85 degrees {edge:.1e} rad/s², then at most {most:.1e}; Crazyflow {:.1e}",
                decades[0]
            );
            assert!(most < 4.0 * edge, "{prefix}: {most} against {edge} at 85 degrees");
            // No growth at all over the last three decades.
            let (near, nearest) = (within(0.1, 1.0, &our_size), within(0.0, 1e-3, &our_size));
            assert!(nearest < 1.5 * near, "{prefix}: {nearest} after {near}");
            // At exactly 90 degrees too.
            for pitch in [core::f64::consts::FRAC_PI_2, -core::f64::consts::FRAC_PI_2] {
                let mut state = state_at(&drone, &data, &prefix, 0);
                state.quat = quat::exp([0.0, pitch, 0.0]);
                assert!(ours(&state, 0) < 4.0 * edge, "{prefix} at {pitch} rad");
            }
        }
    }
}

#[test]
fn a_stage_of_400_hz_ticks_400_times_a_second_at_500_hz_where_crazyflow_ticks_250_times() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let run = Run::new(reference, &list, &data, "ticks");
    assert_eq!((run.sim_hz, run.rates.attitude_hz), (500, 400));
    let ticked = run.get("attitude_ticked");
    for second in [0..500, 500..1000] {
        let theirs: f64 = second.clone().map(|step| ticked.number(&[step])).sum();
        let ours = second.filter(|s| run.rates.due(run.mode, *s as u64, run.sim_hz).attitude).count();
        println!("  Crazyflow {theirs} times, Propwash {ours} times");
        assert_eq!((theirs, ours), (250.0, 400));
    }
}

#[test]
fn motors_commanded_off_stay_off_where_crazyflow_spins_them_up() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let run = Run::new(reference, &list, &data, "motors_off");
    let least = rotor::speed_for_thrust(run.drone.controller.thrust_curve, run.drone.controller.thrust_min_n);
    for world in 0..run.worlds() {
        run.fly(
            world,
            |s, dt, rate| Integrator::Euler.step(s, dt, rate),
            |_, s, _| assert_eq!(s.rotor_vel, [0.0; MAX_ROTORS]),
        );
        let last = run.get("rotor_vel").shape[0] - 1;
        for rpm in run.get("rotor_vel").at::<4>(&[last, world]) {
            assert!(rpm > 0.5 * rad_s_to_rpm(least) && rpm < rad_s_to_rpm(least), "{rpm} rpm");
        }
    }
}

#[test]
fn a_thrust_command_of_zero_gives_no_thrust_where_crazyflow_raises_it_to_the_least() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let run = Run::new(reference, &list, &data, "no_thrust");
    let least = 4.0 * run.drone.controller.thrust_min_n;
    for world in 0..run.worlds() {
        run.fly(
            world,
            |s, dt, rate| Integrator::Euler.step(s, dt, rate),
            |_, s, _| assert_eq!(s.thrust, 0.0),
        );
        let last = run.get("rotor_vel").shape[0] - 1;
        let thrust = run.get("rotor_vel").number(&[last, world, 0]);
        assert!((thrust - least).abs() < 1e-3 * least, "{thrust} N, not {least} N");
    }
}

#[test]
fn the_fitted_model_holds_a_command_between_ticks_where_crazyflow_takes_each_at_once() {
    let reference = reference_or_skip!();
    let (list, data) = (reference.json("runs"), reference.arrays("runs"));
    let run = Run::new(reference, &list, &data, "held");
    assert_eq!((run.sim_hz, run.rates.attitude_hz), (500, 50));
    let theirs = run.get("attitude_cmd");
    run.fly(
        0,
        |s, dt, rate| Integrator::Euler.step(s, dt, rate),
        |step, _, ours| {
            let asked = run.command(step, 0);
            assert_eq!(theirs.row(&[step, 0]), &asked[..4], "Crazyflow answers every command");
            let last_tick = run.command(step - step % 10, 0);
            assert_eq!(*ours, Command::Attitude([last_tick[0], last_tick[1], last_tick[2], last_tick[3]]));
        },
    );
}
