//! Simulated flights: a vehicle under its own controller, and the log that sensors of an assumed quality would record.

use super::library::Room;
use super::{Air, Sensors};
use crate::{Drive, GapError, Options, Track};
use propwash_flight::{Channel, FlightLog, Format};
use propwash_physics::controllers::{ControlMode, ticks};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::State;
use propwash_physics::rotor;
use propwash_rollout::random::{Key, Stream, purpose};
use propwash_rollout::trajectory::Spline;
use propwash_rollout::{Sim, SimOptions};
use propwash_trace::math::{quat, vec3};
use propwash_vehicle::Vehicle;
use std::path::Path;

/// Steps per second.
pub(super) const SIM_HZ: u32 = 500;
/// Steps over which each part of the disturbance is constant: 50 ms for the quick one, 250 ms for the slow one, as in the
/// fit.
const QUICK_STEPS: usize = 25;
const SLOW_STEPS: usize = 125;

/// A simulated flight and its quality.
pub(super) struct Flown {
    pub log: FlightLog,
    /// Largest distance from the reference, m.
    pub peak_error_m: f64,
    /// Share of the time in which a rotor's command was at its limit.
    pub saturated: f64,
    /// How far it left the room, m.
    pub outside_m: f64,
    pub peak_speed_m_s: f64,
    pub peak_tilt_rad: f64,
    /// Whether it flipped, hit the ground, or its state became non-finite.
    pub lost: bool,
}

/// Simulation settings.
pub(super) struct Setting<'a> {
    pub vehicle: &'a Vehicle,
    /// True parameters: the vehicle file's, or others.
    pub drone: &'a Drone<f64>,
    pub room: &'a Room,
    pub sensors: &'a Sensors,
    pub air: &'a Air,
    pub seed: u64,
    /// Whether the load on a cable is tracked, as the object `load`.
    pub tracks_load: bool,
}

/// Simulates all paths at once, one world each.
pub(super) fn fly(setting: &Setting, paths: &[Spline]) -> Result<Vec<Flown>, GapError> {
    let fault = |e: propwash_rollout::RolloutError| GapError::Numbers {
        what: "the simulated flight",
        reason: e.to_string(),
    };
    let n = paths.len();
    let options = SimOptions {
        n_worlds: n,
        sim_hz: SIM_HZ,
        integrator: Integrator::Rk4,
        control: ControlMode::State,
        seed: setting.seed,
        ..SimOptions::default()
    };
    let mut sim = Sim::new(options, vec![(setting.drone.clone(), setting.vehicle.rates)]).map_err(fault)?;
    for (w, path) in paths.iter().enumerate() {
        let start = path.at(0.0);
        let state = State {
            pos: start.pos_m,
            quat: quat::exp([0.0, 0.0, start.yaw_rad]),
            vel: start.vel_m_s,
            ..State::rest()
        };
        sim.set_initial(w, 0, state).map_err(fault)?;
    }
    sim.reset(None).map_err(fault)?;
    if setting.room.ground {
        sim.data.ground_z.fill(0.0);
    }
    if let Some(ceiling) = setting.room.ceiling_z_m {
        sim.data.ceiling_z.fill(ceiling);
    }
    let mut recorders: Vec<Recorder> = (0..n).map(|w| Recorder::new(setting, w)).collect();
    let lengths: Vec<usize> = paths.iter().map(|p| (p.end_s() * f64::from(SIM_HZ)) as usize).collect();
    let longest = lengths.iter().copied().max().unwrap_or(0);
    let mut command = vec![0.0; n * sim.command_width()];
    let width = sim.command_width();
    for step in 0..=longest {
        let t = step as f64 / f64::from(SIM_HZ);
        for (w, path) in paths.iter().enumerate() {
            let reference = path.at(t).command();
            command[w * width..(w + 1) * width].copy_from_slice(&reference[..width]);
        }
        sim.set_command(&command).map_err(fault)?;
        sim.run_controllers().map_err(fault)?;
        for (w, recorder) in recorders.iter_mut().enumerate() {
            if step <= lengths[w] && !recorder.lost {
                recorder.step(setting, &mut sim, &paths[w], w, step);
            }
        }
        sim.run_integration().map_err(fault)?;
    }
    Ok(recorders.into_iter().map(Recorder::finish).collect())
}

/// Records one world.
struct Recorder {
    log: FlightLog,
    noise: Stream,
    push: Stream,
    quick: [[f64; 3]; 2],
    slow: [[f64; 3]; 2],
    limits: Option<[f64; 2]>,
    peak_error_m: f64,
    at_limit: usize,
    steps: usize,
    outside_m: f64,
    peak_speed_m_s: f64,
    peak_tilt_rad: f64,
    lost: bool,
}

fn normals(s: &mut Stream, sigma: f64) -> [f64; 3] {
    core::array::from_fn(|_| sigma * s.normal())
}

impl Recorder {
    fn new(setting: &Setting, world: usize) -> Self {
        let stream = |name| {
            Key { seed: setting.seed, world: world as u64, drone: 0, step: 0, purpose: purpose(name) }
                .stream()
        };
        let rotors = setting.drone.airframe.n_rotors;
        let mut log = FlightLog::empty(Path::new("planned flight"), String::new(), Format::Csv);
        if matches!(setting.drone.dynamics, Dynamics::Rotors) {
            log.cmd_rotor_rad_s = vec![Channel::default(); rotors];
            log.rotor_speed_rad_s = vec![Channel::default(); rotors];
        }
        let p = &setting.drone.controller;
        let speed = |thrust_n| rotor::speed_for_thrust(p.thrust_curve, thrust_n);
        let limits = [speed(p.thrust_min_n), speed(p.thrust_max_n)];
        Self {
            log,
            noise: stream("excite sensors"),
            push: stream("excite air"),
            quick: [[0.0; 3]; 2],
            slow: [[0.0; 3]; 2],
            limits: limits.iter().all(|v| v.is_finite()).then_some(limits),
            peak_error_m: 0.0,
            at_limit: 0,
            steps: 0,
            outside_m: 0.0,
            peak_speed_m_s: 0.0,
            peak_tilt_rad: 0.0,
            lost: false,
        }
    }

    fn step(&mut self, setting: &Setting, sim: &mut Sim, path: &Spline, w: usize, step: usize) {
        let air = setting.air;
        if step.is_multiple_of(QUICK_STEPS) {
            self.quick =
                [normals(&mut self.push, air.force_m_s2), normals(&mut self.push, air.torque_rad_s2)];
        }
        if step.is_multiple_of(SLOW_STEPS) {
            self.slow = [normals(&mut self.push, air.force_m_s2), normals(&mut self.push, air.torque_rad_s2)];
        }
        let t = step as f64 / f64::from(SIM_HZ);
        let state = sim.data.state(w, 0);
        let mut rate = sim.rate(w, 0);
        let push = [vec3::add(self.quick[0], self.slow[0]), vec3::add(self.quick[1], self.slow[1])];
        rate.acc = vec3::add(rate.acc, push[0]);
        rate.ang_acc = vec3::add(rate.ang_acc, push[1]);

        let reference = path.at(t);
        let tilt =
            vec3::dot(quat::rotate(state.quat, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]).clamp(-1.0, 1.0).acos();
        let whole = state.pos.iter().chain(&state.vel).chain(&state.quat).all(|v| v.is_finite());
        let on_ground = setting.room.ground && state.pos[2] < 0.01;
        if !whole || tilt > 1.4 || on_ground || sim.data.quarantine[w].is_some() {
            self.lost = true;
            return;
        }
        self.peak_error_m = self.peak_error_m.max(vec3::norm(vec3::sub(state.pos, reference.pos_m)));
        self.outside_m = self.outside_m.max(setting.room.outside_m(state.pos));
        self.peak_speed_m_s = self.peak_speed_m_s.max(vec3::norm(state.vel));
        self.peak_tilt_rad = self.peak_tilt_rad.max(tilt);
        self.record(setting, sim, w, step, t, &state, &rate);

        // The process noise acts until the next step.
        let dt = 1.0 / f64::from(SIM_HZ);
        let row = sim.data.row(w, 0);
        for k in 0..3 {
            sim.data.vel[3 * row + k] += push[0][k] * dt;
            sim.data.ang_vel[3 * row + k] += push[1][k] * dt;
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn record(
        &mut self,
        setting: &Setting,
        sim: &Sim,
        w: usize,
        step: usize,
        t: f64,
        state: &State<f64>,
        rate: &propwash_physics::rigid_body::Rate<f64>,
    ) {
        let sensors = setting.sensors;
        let reading = setting.drone.read(state, rate);
        let clock = setting.drone.clock();
        let n = setting.drone.airframe.n_rotors;
        let row = sim.data.row(w, 0);
        let due = |hz: u32| hz > 0 && ticks(step as u64, hz.min(SIM_HZ), SIM_HZ);
        if due(sensors.pose_hz) {
            let at = t + clock.pose_s;
            let off = normals(&mut self.noise, sensors.position_m);
            let turn = quat::exp(normals(&mut self.noise, sensors.attitude_rad));
            self.log.position_m.push(at, vec3::add(reading.pos, off));
            self.log.attitude.push(at, quat::normalize(quat::mul(reading.quat, turn)));
        }
        if due(sensors.gyro_hz) {
            let off = normals(&mut self.noise, sensors.gyro_rad_s);
            self.log.angular_velocity_rad_s.push(t + clock.gyro_s, vec3::add(reading.gyro, off));
        }
        if due(sensors.accel_hz) {
            let off = normals(&mut self.noise, sensors.accel_m_s2);
            self.log.specific_force_m_s2.push(t + clock.accel_s, vec3::add(reading.accel, off));
        }
        // The load is where it was when the step before began.
        if setting.tracks_load
            && due(sensors.pose_hz)
            && let Some(load) = sim.load_m(w, 0)
        {
            let at = t - 1.0 / f64::from(SIM_HZ) + clock.pose_s;
            let off = normals(&mut self.noise, sensors.position_m);
            self.log.objects_m.entry("load".into()).or_default().push(at, vec3::add(load, off));
        }
        let commands = &sim.data.rotor_command[row * sim.data.n_rotors..][..n];
        for (i, channel) in self.log.cmd_rotor_rad_s.iter_mut().enumerate() {
            channel.push(t, [commands[i]]);
        }
        for (i, channel) in self.log.rotor_speed_rad_s.iter_mut().enumerate() {
            channel.push(t + clock.inputs_s, [state.rotor_vel[i]]);
        }
        let sent = &sim.data.attitude_command[row * 4..row * 4 + 4];
        self.log.cmd_attitude_rad.push(t, [sent[0], sent[1], sent[2]]);
        self.log.cmd_thrust_n.push(t, [sent[3]]);
        self.log.thrust_n.push(t + clock.inputs_s, [sim.thrust_n(w, 0)]);
        self.log.duration_s = t;
        self.log.n_rows += 1;
        self.steps += 1;
        if let Some([low, high]) = self.limits
            && matches!(setting.drone.dynamics, Dynamics::Rotors)
            && commands.iter().any(|c| *c <= low * 1.001 || *c >= high * 0.999)
        {
            self.at_limit += 1;
        }
    }

    fn finish(self) -> Flown {
        Flown {
            log: self.log,
            peak_error_m: self.peak_error_m,
            saturated: self.at_limit as f64 / self.steps.max(1) as f64,
            outside_m: self.outside_m,
            peak_speed_m_s: self.peak_speed_m_s,
            peak_tilt_rad: self.peak_tilt_rad,
            lost: self.lost,
        }
    }
}

/// A flight as the fit reads it, with the assumed sensor noise.
pub(super) fn track(
    flown: &Flown,
    vehicle: &Vehicle,
    room: &Room,
    sensors: &Sensors,
    drive: Drive,
) -> Result<Track, GapError> {
    let options = Options { drive: Some(drive), ceiling_z_m: room.ceiling_z_m, ..Options::default() };
    let mut track = Track::new(flown.log.clone(), vehicle, &options)?;
    if !room.ground {
        track.ground_z_m = None;
    }
    track.noise.position_m = sensors.position_m;
    track.noise.attitude_rad = sensors.attitude_rad;
    track.noise.gyro_rad_s = sensors.gyro_rad_s;
    track.noise.accel_m_s2 = sensors.accel_m_s2;
    Ok(track)
}
