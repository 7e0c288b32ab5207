//! Closed-loop simulation of a whole flight: the model with its own controller along the logged references.

use super::ClosedLoop;
use crate::replay::STEP_S;
use crate::residual::Replay;
use crate::track::Measured;
use propwash_flight::resample::Local;
use propwash_flight::{Channel, FlightLog, resample};
use propwash_physics::controllers::ControlMode;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::State;
use propwash_rollout::trajectory::Reference;
use propwash_rollout::{RolloutError, Sim, SimOptions};
use propwash_trace::math::{quat, vec3};
use propwash_vehicle::Vehicle;

/// Rates of the simulation and of the references, Hz, and the interval between references, s.
const SIM_HZ: u32 = 500;
const REFERENCE_HZ: u32 = 100;
const REFERENCE_S: f64 = 0.01;

/// A whole flight along the logged references, or why there is none.
pub(super) fn closed_loop(replay: &Replay, vehicle: &Vehicle) -> Result<ClosedLoop, String> {
    let (track, log) = (replay.track, &replay.track.log);
    if log.ref_position_m.len() < 10 {
        return Err("the log has no references (ref_x ref_y ref_z)".into());
    }
    let modes = vehicle.modes(track.dynamics).map_err(|e| e.to_string())?;
    if !modes.contains(&ControlMode::State) {
        return Err("the vehicle file has no position controller that flies along references".into());
    }
    let course = Course::new(replay)?;
    let flown = fly(replay, vehicle, &course).map_err(|e| e.to_string())?;
    if flown.iter().any(|s| !s.pos.iter().chain(&s.vel).all(|x| x.is_finite())) {
        return Err("the model's flight does not stay finite".into());
    }
    Ok(course.compared(&flown, course.notes(replay)))
}

/// The flight to simulate: references and measured states at the times of the references.
struct Course {
    /// Start: instant of the log, its time (s), the measured state.
    first: usize,
    begin_s: f64,
    start: Measured,
    /// Times, s.
    at_s: Vec<f64>,
    positions: Vec<Option<[f64; 3]>>,
    /// Local fits through the positions, for references that were not logged.
    local: Vec<Option<Local<3>>>,
    velocities: Option<Vec<Option<[f64; 3]>>>,
    accelerations: Option<Vec<Option<[f64; 3]>>>,
    measured: Vec<Option<Measured>>,
}

impl Course {
    /// The part of a log where references and poses overlap.
    fn new(replay: &Replay) -> Result<Self, String> {
        let (track, log) = (replay.track, &replay.track.log);
        let refs = &log.ref_position_m;
        let from = track.span_s[0].max(refs.t_s[0]);
        let to = track.span_s[1].min(refs.t_s[refs.len() - 1]);
        let n_steps = replay.n_steps();
        let first = (0..n_steps).find(|i| replay.time_s(*i) >= from && replay.around.measured[*i].is_some());
        let Some((first, start)) = first.and_then(|i| Some((i, replay.around.measured[i]?))) else {
            return Err("references and poses do not overlap".into());
        };
        let begin_s = replay.time_s(first);
        let n = ((to - begin_s) * f64::from(REFERENCE_HZ)).floor();
        if !(n >= f64::from(REFERENCE_HZ)) {
            return Err("references and poses overlap for less than 1 s".into());
        }
        let at_s: Vec<f64> = (0..=n as usize).map(|i| begin_s + i as f64 * REFERENCE_S).collect();
        let half = 0.05f64.max(3.2 * refs.period_s().unwrap_or(0.01));
        let given = |c: &Channel<3>| (c.len() > 1).then(|| resample::linear(c, &at_s, 1.0));
        Ok(Self {
            first,
            begin_s,
            start,
            positions: resample::linear(refs, &at_s, 1.0),
            local: resample::local_parabola(refs, &at_s, half),
            velocities: given(&log.ref_velocity_m_s),
            accelerations: given(&log.ref_acceleration_m_s2),
            measured: track.measured_state(&at_s),
            at_s,
        })
    }

    /// What is assumed.
    fn notes(&self, replay: &Replay) -> Vec<String> {
        let mut notes = Vec::new();
        if self.velocities.is_none() {
            notes.push("reference velocities are the derivative of reference positions".into());
        }
        if self.accelerations.is_none() {
            notes.push("reference accelerations are the second derivative of reference positions".into());
        }
        if replay.track.log.ref_yaw_rad.is_empty() {
            notes.push("no reference yaw: the measured one is used".into());
        }
        if !replay.around.neighbours.is_empty() {
            notes.push("the other vehicles are not in the model's flight".into());
        }
        notes
    }

    /// Yaw reference from time `i` on, rad; `None` where it does not change.
    fn yaw_rad(&self, log: &FlightLog, i: usize) -> Option<f64> {
        let column = log.ref_yaw_rad.t_s.partition_point(|x| *x <= self.at_s[i]);
        if column > 0 {
            return Some(log.ref_yaw_rad.values[column - 1][0]);
        }
        self.measured[i].filter(|_| log.ref_yaw_rad.is_empty()).map(|m| heading(m.quat))
    }

    /// The reference at time `i`.
    fn reference(&self, i: usize, pos_m: [f64; 3], yaw_rad: f64) -> Reference {
        let pick = |list: &Option<Vec<Option<[f64; 3]>>>| list.as_ref().and_then(|l| l[i]);
        let slope = self.local[i].map_or([0.0; 3], |l| l.slope);
        let bend = self.local[i].map_or([0.0; 3], |l| l.curvature);
        Reference {
            pos_m,
            vel_m_s: pick(&self.velocities).unwrap_or(slope),
            acc_m_s2: pick(&self.accelerations).unwrap_or(bend),
            yaw_rad,
        }
    }

    /// Compares the simulated flight with the measured one and the references.
    fn compared(&self, flown: &[State<f64>], notes: Vec<String>) -> ClosedLoop {
        let (mut sums, mut counts) = ([0.0; 4], [0.0f64; 3]);
        let square = |a: [f64; 3], b: [f64; 3]| {
            let d = vec3::sub(a, b);
            vec3::dot(d, d)
        };
        for (i, state) in flown.iter().enumerate() {
            if let Some(m) = &self.measured[i] {
                sums[0] += square(state.pos, m.pos);
                sums[1] += square(state.vel, m.vel);
                counts[0] += 1.0;
                if let Some(p) = self.positions[i] {
                    sums[2] += square(m.pos, p);
                    counts[1] += 1.0;
                }
            }
            if let Some(p) = self.positions[i] {
                sums[3] += square(state.pos, p);
                counts[2] += 1.0;
            }
        }
        let root = |sum: f64, n: f64| (sum / n.max(1.0)).sqrt();
        ClosedLoop {
            duration_s: self.at_s[self.at_s.len() - 1] - self.begin_s,
            position_m: root(sums[0], counts[0]),
            velocity_m_s: root(sums[1], counts[0]),
            tracking_measured_m: root(sums[2], counts[1]),
            tracking_model_m: root(sums[3], counts[2]),
            notes,
        }
    }
}

/// States of the model under its controller, at the times of the course.
fn fly(replay: &Replay, vehicle: &Vehicle, course: &Course) -> Result<Vec<State<f64>>, RolloutError> {
    let options = SimOptions {
        sim_hz: SIM_HZ,
        integrator: Integrator::Rk4,
        control: ControlMode::State,
        ..SimOptions::default()
    };
    let mut sim = Sim::new(options, vec![(replay.drone.clone(), vehicle.rates)])?;
    let start = &course.start;
    let state = State {
        pos: start.pos,
        quat: quat::normalize(start.quat),
        vel: start.vel,
        ang_vel: start.ang_vel,
        ..State::rest()
    };
    sim.set_initial(0, 0, state)?;
    sim.reset(None)?;
    if let Some(ground) = replay.track.ground_z_m {
        sim.data.ground_z.fill(ground);
    }
    let mut out = Vec::with_capacity(course.at_s.len());
    let (mut yaw, mut last) = (heading(start.quat), None);
    for (i, t) in course.at_s.iter().enumerate() {
        out.push(sim.data.state(0, 0));
        if let Some(pos_m) = course.positions[i] {
            yaw = course.yaw_rad(&replay.track.log, i).unwrap_or(yaw);
            last = Some(course.reference(i, pos_m, yaw));
        }
        if let Some(reference) = last {
            sim.set_command(&reference.command())?;
        }
        let place = course.first + ((t - course.begin_s) / STEP_S).round() as usize;
        if let Some(wind) = replay.around.wind.get(place) {
            sim.data.wind.copy_from_slice(wind);
        }
        sim.step((SIM_HZ / REFERENCE_HZ) as usize)?;
    }
    Ok(out)
}

/// Yaw of an attitude, rad.
fn heading(q: [f64; 4]) -> f64 {
    let forward = quat::rotate(q, [1.0, 0.0, 0.0]);
    forward[1].atan2(forward[0])
}
