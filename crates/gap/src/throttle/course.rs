//! One flight as the fit of its motors sees it: throttles and voltages that were sent, and what is known of the rotors' speeds.

use super::Voltage;
use crate::replay::{Inputs, merged};
use crate::residual::{Replay, Residuals, Sample};
use crate::track::throttle::{has_voltage, voltage};
use crate::track::{Drive, Options, Track, without_spikes};
use crate::{GapError, usable};
use propwash_flight::clean::median;
use propwash_flight::{Channel, FlightLog};
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_physics::rotor::{self, curve};
use propwash_physics::throttle::Params;
use propwash_trace::math::{quat, vec3};
use propwash_vehicle::schema::ThrottleOf;
use propwash_vehicle::{DYNAMICS, Vehicle};

/// Numbers that a fit frees: offset, back-EMF, load, time constants up and down, delay; and behind a lift the drag along body z.
pub(super) const FREE: usize = 7;
/// Those of them that tell the speed of a rotor.
const OF_SPEED: usize = 6;
/// Longest time without a throttle that is bridged, s.
const LONGEST_HOLE_S: f64 = 0.1;
/// Time after the first throttle until the modelled motors have forgotten how they began, s.
const SETTLE_S: f64 = 0.5;
/// Length of stretches whose errors are independent of each other, s.
const STRETCH_S: f64 = 2.0;
/// Fewest samples of a channel.
const FEWEST: usize = 50;

/// What tells how fast the rotors turned.
#[derive(Clone, Debug)]
enum Known {
    /// Measured speeds of every rotor: times (s), rad/s.
    Speeds(Vec<(Vec<f64>, Vec<f64>)>),
    /// The force along body z that the flight needed, N, and how it follows from the speeds.
    /// Climbing and sinking meets drag, which is not to be taken for thrust: `climb_m_s` is the velocity along body z.
    Lift { at_s: Vec<f64>, force_n: Vec<f64>, climb_m_s: Vec<f64>, rotors: Vec<rotor::Params<f64>> },
}

/// One flight.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// File name.
    pub name: String,
    /// SHA-256 of its log.
    pub sha256: String,
    /// Times at which a throttle was sent, s, with those of all rotors.
    sent: Vec<(f64, [f64; MAX_ROTORS])>,
    /// Voltages at these times: of the battery, where it was logged, and their median in flight.
    battery_v: Option<Vec<f64>>,
    known: Known,
}

/// Motors with their lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motor {
    pub by: Params<f64>,
    /// Time constants of speeding up and of slowing down, s.
    pub lag_s: [f64; 2],
    /// Time from a logged throttle until the motor answers, s.
    pub delay_s: f64,
    /// Drag of the vehicle along body z, N·s/m.
    pub drag_n_s_per_m: f64,
}

/// One observation against the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// Number of its stretch within the flight.
    pub stretch: usize,
    /// What was measured: rad/s or N.
    pub measured: f64,
    /// Measured minus modelled.
    pub residual: f64,
    /// Slopes of the model by the free numbers, SI.
    pub slopes: [f64; FREE],
}

impl Course {
    /// A flight with throttles for all rotors of a vehicle, and speeds of all of them or what a pose tells of the lift.
    pub fn new(log: &FlightLog, vehicle: &Vehicle, by_lift: bool) -> Result<Self, GapError> {
        let name = log.path.file_name().map_or_else(|| "log".into(), |n| n.to_string_lossy().into_owned());
        let n = vehicle.file().rotor.len().min(MAX_ROTORS);
        let full = |list: &[Channel<1>]| list.len() == n && list.iter().all(|c| c.len() >= FEWEST);
        if !full(&log.cmd_u) {
            return Err(GapError::Log {
                log: name,
                expected: format!("throttles of {n} rotors (cmd_u1…)"),
                found: match log.cmd_u.len() {
                    0 => "none".into(),
                    m if m != n => format!("those of {m}"),
                    _ => format!("fewer than {FEWEST} samples of one"),
                },
                remedy: "map the motor outputs to cmd_u1… (docs/logs.md), or give the vehicle file of this vehicle".into(),
            });
        }
        let sent = merged(&log.cmd_u.iter().collect::<Vec<_>>());
        let at: Vec<f64> = sent.iter().map(|(t, _)| *t).collect();
        let battery_v = has_voltage(log).then(|| voltage(&log.vbat_v, ThrottleOf::Battery, 0.0, &at));
        let known = if full(&log.rotor_speed_rad_s) && !by_lift {
            speeds(log, vehicle)
        } else {
            lift(log, vehicle, &sent, battery_v.as_deref())?
        };
        let course = Self { name, sha256: log.sha256.clone(), sent, battery_v, known };
        if course.rows(&Motor::any(), Voltage::Throttle).len() < FEWEST {
            return Err(GapError::TooShort {
                log: course.name,
                expected: "some seconds of flight with throttles".into(),
                found: "less".into(),
                remedy: "give a longer flight".into(),
            });
        }
        Ok(course)
    }

    pub fn has_voltage(&self) -> bool {
        self.battery_v.is_some()
    }

    /// Median voltage of the battery, V.
    pub fn usual_v(&self) -> Option<f64> {
        median(self.battery_v.clone()?)
    }

    /// Median of throttle × voltage over all rotors.
    pub fn usual_drive(&self, of: Voltage) -> f64 {
        let all = self.sent.iter().enumerate().map(|(k, (_, u))| {
            let n = u.iter().filter(|u| **u > 0.0).count().max(1);
            self.volts(of, k) * u.iter().sum::<f64>() / n as f64
        });
        median(all.filter(|x| *x > 0.0).collect()).unwrap_or(1.0)
    }

    /// Median speed of the rotors, rad/s, where it was measured.
    pub fn usual_speed(&self) -> Option<f64> {
        let Known::Speeds(list) = &self.known else { return None };
        median(list.iter().flat_map(|(_, v)| v.iter().copied()).collect())
    }

    /// The first or the second half of its observations.
    pub fn half(&self, second: bool) -> Self {
        let cut = |at: &[f64]| {
            let middle = at.len() / 2;
            if second { middle..at.len() } else { 0..middle }
        };
        let known = match &self.known {
            Known::Speeds(list) => {
                Known::Speeds(list.iter().map(|(t, v)| (t[cut(t)].to_vec(), v[cut(t)].to_vec())).collect())
            }
            Known::Lift { at_s, force_n, climb_m_s, rotors } => Known::Lift {
                climb_m_s: climb_m_s[cut(at_s)].to_vec(),
                at_s: at_s[cut(at_s)].to_vec(),
                force_n: force_n[cut(at_s)].to_vec(),
                rotors: rotors.clone(),
            },
        };
        Self { known, ..self.clone() }
    }

    fn volts(&self, of: Voltage, k: usize) -> f64 {
        match (of, &self.battery_v) {
            (Voltage::Battery, Some(list)) => list[k],
            _ => 1.0,
        }
    }

    /// All observations against a model.
    pub fn rows(&self, motor: &Motor, of: Voltage) -> Vec<Row> {
        let row = |at: f64, measured: f64, model: [f64; OF_SPEED + 1], by_drag: f64| Row {
            stretch: (at / STRETCH_S).max(0.0) as usize,
            measured,
            residual: measured - model[0] - motor.drag_n_s_per_m * by_drag,
            slopes: core::array::from_fn(|k| model.get(k + 1).copied().unwrap_or(by_drag)),
        };
        match &self.known {
            Known::Speeds(list) => {
                let mut out = Vec::new();
                for (r, (at, speeds)) in list.iter().enumerate() {
                    let model = self.follow(motor, of, r, at);
                    for ((at, measured), model) in at.iter().zip(speeds).zip(model) {
                        out.extend(model.map(|m| row(*at, *measured, m, 0.0)));
                    }
                }
                out
            }
            Known::Lift { at_s, force_n, climb_m_s, rotors } => {
                let mut sums = vec![Some([0.0; OF_SPEED + 1]); at_s.len()];
                for (r, rotor) in rotors.iter().enumerate() {
                    for (sum, speed) in sums.iter_mut().zip(self.follow(motor, of, r, at_s)) {
                        *sum = sum.zip(speed).map(|(sum, speed)| plus_thrust(sum, speed, rotor));
                    }
                }
                let all = at_s.iter().zip(force_n).zip(climb_m_s).zip(sums);
                all.filter_map(|(((at, f), climb), m)| Some(row(*at, *f, m?, -climb))).collect()
            }
        }
    }

    /// Speed of a rotor at times, with its slopes; `None` where no throttle was sent for long, and until it has settled.
    ///
    /// A throttle holds until the next one arrives; in between the speed approaches where it settles, s + (Ω − s) e^(−t/τ).
    /// The motor starts in balance, so that a delay moves all of it in time: its slope is minus the acceleration.
    fn follow(&self, motor: &Motor, of: Voltage, r: usize, at_s: &[f64]) -> Vec<Option<[f64; OF_SPEED + 1]>> {
        let Motor { by, lag_s, delay_s, .. } = motor;
        // The settled speed by offset, back-EMF and load: implicit slopes of u V = c + a Ω + b Ω².
        let settled = |k: usize| -> [f64; 4] {
            let speed = by.speed(self.sent[k].1[r], self.volts(of, k));
            let per = if speed > 0.0 {
                -1.0 / (by.back_emf_v_s_per_rad + 2.0 * by.load_v_s2_per_rad2 * speed)
            } else {
                0.0
            };
            [speed, per, per * speed, per * speed * speed]
        };
        let mut next = 1;
        let mut target = settled(0);
        // Speed, and its slopes by offset, back-EMF, load and both time constants.
        let mut state = [target[0], target[1], target[2], target[3], 0.0, 0.0];
        let mut now = self.sent[0].0 + delay_s;
        // The speed never passes its target, so that one time constant holds from one throttle to the next.
        let way = |state: &[f64; 6], target: &[f64; 4]| usize::from(target[0] < state[0]);
        let pass = |state: &mut [f64; 6], target: &[f64; 4], dt: f64| {
            let way = way(state, target);
            let lag_s = lag_s[way];
            let decay = (-dt / lag_s).exp();
            state[4] *= decay;
            state[5] *= decay;
            state[4 + way] += (state[0] - target[0]) * decay * dt / (lag_s * lag_s);
            for k in 0..4 {
                state[k] = target[k] + (state[k] - target[k]) * decay;
            }
        };
        let begin = self.sent[0].0 + SETTLE_S;
        at_s.iter()
            .map(|at| {
                while next < self.sent.len() && self.sent[next].0 + delay_s <= *at {
                    let arrival = self.sent[next].0 + delay_s;
                    pass(&mut state, &target, (arrival - now).max(0.0));
                    (now, target) = (arrival, settled(next));
                    next += 1;
                }
                pass(&mut state, &target, (at - now).max(0.0));
                now = now.max(*at);
                let known = *at >= begin && at - (self.sent[next - 1].0 + delay_s) <= LONGEST_HOLE_S;
                known.then(|| {
                    let [speed, c, a, b, up, down] = state;
                    [speed, c, a, b, up, down, -(target[0] - speed) / lag_s[way(&state, &target)]]
                })
            })
            .collect()
    }
}

impl Motor {
    /// One with which a flight can be passed through.
    fn any() -> Self {
        let by = Params { offset_v: 0.0, back_emf_v_s_per_rad: 1e-3, load_v_s2_per_rad2: 0.0 };
        Self { by, lag_s: [0.05; 2], delay_s: 0.0, drag_n_s_per_m: 0.0 }
    }
}

/// Adds the thrust of a rotor along body z to a sum, with its slopes.
fn plus_thrust(
    mut sum: [f64; OF_SPEED + 1],
    speed: [f64; OF_SPEED + 1],
    rotor: &rotor::Params<f64>,
) -> [f64; OF_SPEED + 1] {
    let up = vec3::dot(rotor.axis, [0.0, 0.0, 1.0]);
    let per = up * (rotor.thrust_curve[1] + 2.0 * rotor.thrust_curve[2] * speed[0]);
    sum[0] += up * curve(rotor.thrust_curve, speed[0]);
    for k in 1..=OF_SPEED {
        sum[k] += per * speed[k];
    }
    sum
}

/// Measured speeds in flight.
fn speeds(log: &FlightLog, vehicle: &Vehicle) -> Known {
    let cut = usable::look(log, vehicle);
    let each = |c: &Channel<1>| {
        let flying = usable::flying(&cut, &without_spikes(c, "rotor", &mut Vec::new()));
        (flying.t_s.clone(), flying.component(0))
    };
    Known::Speeds(log.rotor_speed_rad_s.iter().map(each).collect())
}

/// The lift that the flight needed, by its pose and accelerometer: the vehicle's mass times what it feels along body z.
fn lift(
    log: &FlightLog,
    vehicle: &Vehicle,
    sent: &[(f64, [f64; MAX_ROTORS])],
    battery_v: Option<&[f64]>,
) -> Result<Known, GapError> {
    let drone = vehicle.drone(DYNAMICS[0]).map_err(|e| GapError::Log {
        log: vehicle.name.clone(),
        expected: "rotors in the vehicle file".into(),
        found: e.to_string(),
        remedy: "correct the vehicle file".into(),
    })?;
    // A track needs something that drives the model, and a thrust of about the weight: speeds in proportion to the throttle
    // serve; only the measured motion is read.
    let n = drone.airframe.n_rotors;
    let volts = |k: usize| battery_v.map_or(1.0, |v| v[k]);
    let mean =
        |(k, (_, u)): (usize, &(f64, [f64; MAX_ROTORS]))| volts(k) * u[..n].iter().sum::<f64>() / n as f64;
    let usual = median(sent.iter().enumerate().map(mean).filter(|x| *x > 0.0).collect()).unwrap_or(1.0);
    let hover = drone.hover_rotor_vel();
    let mut log = log.clone();
    log.cmd_rotor_rad_s = (0..n)
        .map(|r| {
            let speed =
                |(k, (_, u)): (usize, &(f64, [f64; MAX_ROTORS]))| [hover[r] * u[r] * volts(k) / usual];
            Channel::new(sent.iter().map(|(t, _)| *t).collect(), sent.iter().enumerate().map(speed).collect())
        })
        .collect();
    let options = Options { drive: Some(Drive::RotorCommands), ..Options::default() };
    let track = Track::new(log, vehicle, &options)?;
    let Inputs { drone, around, raw } = Inputs::new(&track, vehicle)?;
    let replay = Replay::new(&track, &around, &raw, &drone);
    let samples = Residuals::new(&replay).samples;
    let rotors = drone.parts().airframe.rotors[..n].to_vec();
    let climb = |s: &Sample| {
        let state = replay.around.measured.get(s.step).and_then(Option::as_ref);
        state.map_or(0.0, |m| quat::rotate_inverse(m.quat, m.vel)[2])
    };
    Ok(Known::Lift {
        at_s: samples.iter().map(|s| replay.time_s(s.step)).collect(),
        force_n: samples.iter().map(|s| s.measured_force_n[2]).collect(),
        climb_m_s: samples.iter().map(climb).collect(),
        rotors,
    })
}
