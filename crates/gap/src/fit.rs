//! Linearises a log: the derivatives of every window's measurements by every free parameter.
//!
//! The log is cut into windows. Each window has nuisance parameters: its initial state (12) and, for every 50 ms, a
//! disturbance (3 accelerations, 3 angular accelerations), which is the sum of a part constant over the window and a part
//! of its own. The Jacobian of the rate by state and parameters is exact (duals); the variational equation carries it along
//! the window. A window's rows are reduced to one Gram matrix; its nuisance parameters are then eliminated (Schur
//! complement), and the windows are summed. Sources: output error with initial states as unknowns, Jategaonkar, "Flight
//! vehicle system identification", AIAA 2015, ch. 4; variance of the disturbances by expectation maximisation, Dempster,
//! Laird & Rubin, JRSS B 39(1), 1977.

mod gram;
mod rows;

use super::drive_slopes::{DriveInputs, drive_inputs};
use super::model::{Enters, Model};
use super::per_log::{Values, of_log};
use super::policy::NOISE_WINDOWS;
use super::replay::{Around, Context, PUSH_STEPS, Plant, Point, Raw, STEP, STEP_S, delays};
use super::residual::believed;
use super::slow_errors::slow_errors;
use super::track::{Drive, Measured, Noise, Track};
use gram::Kept;
use nalgebra::DMatrix;
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::{Rate, State};
use propwash_physics::surroundings::Neighbour;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::quat;
use rayon::prelude::*;
use rows::Measurements;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Directions per pass of duals.
pub(super) const N: usize = 12;
const _: () = assert!(propwash_physics::effects::custom::differentiates(N));
pub(super) type Wide = Dual<f64, N>;

/// Nuisance parameters of a window's initial state; six disturbances for every [`PUSH_STEPS`] follow.
pub(crate) const START_STATE: usize = 12;
/// Steps between nodes of the variational equation.
pub(super) const NODE: usize = 2;
/// Sensors: position, attitude, gyroscope, accelerometer.
pub(crate) const CHANNELS: usize = 4;
/// Sensor outputs: position, attitude, rates, specific force.
const OUTPUTS: usize = 12;

/// What stays constant while a log is fitted.
pub(crate) struct Prepared<'a> {
    pub track: &'a Track,
    pub around: Arc<Around>,
    pub raw: Arc<Raw>,
    /// Lower bound on the noise of its channels; for poses, the white-noise equivalent of their slow errors.
    pub noise: Noise,
}

impl<'a> Prepared<'a> {
    pub fn new(track: &'a Track, drone: &Drone<f64>) -> Self {
        let Context { around, raw } = Context::of(track, drone);
        Self::of(track, around, raw, drone)
    }

    /// The same with context and inputs that are known already.
    pub fn of(track: &'a Track, around: Arc<Around>, raw: Arc<Raw>, drone: &Drone<f64>) -> Self {
        let slow = slow_errors(track, &around, drone.body.gravity_m_s2);
        let mut least = track.noise.channels();
        for (c, slow) in slow.into_iter().enumerate() {
            let slow = slow.filter(|_| !track.noise.stated[c]).unwrap_or(0.0);
            least[c] = least[c].hypot(slow);
        }
        let noise = track.noise.with_channels(least);
        Self { track, around, raw, noise }
    }
}

/// Whether a log gives a thrust and no torques: the attitude error then enters every force, so that rules about the
/// residual of a fully driven model (shapes, small shares, wider tolerances) do not apply.
pub(crate) fn forces_only(logs: &[Prepared]) -> bool {
    logs.iter().any(|l| l.track.drive == Drive::Thrust)
}

/// Unknowns of a window's initial state; position and velocity only where the attitude is an input.
fn unknowns(drive: Drive) -> usize {
    if drive == Drive::Thrust { START_STATE / 2 } else { START_STATE }
}

/// Least rows of a window per unknown of its initial state.
const ROWS_PER_UNKNOWN: usize = 2;

/// Shortest windows that determine their own initial state, s: slow sensors need longer ones.
pub(crate) fn shortest_window_s(logs: &[Prepared]) -> f64 {
    let one = |p: &Prepared| {
        let track = p.track;
        let [from, to] = track.span_s;
        let per_s = |t: &[f64]| {
            let n = t.partition_point(|t| *t <= to) - t.partition_point(|t| *t < from);
            n as f64 / (to - from).max(STEP_S)
        };
        // Samples of fast sensors are averaged over a step.
        let fast = |t: &[f64]| per_s(t).min(1.0 / STEP_S);
        let turning = if track.drive == Drive::Thrust {
            0.0
        } else {
            per_s(&track.attitude.t_s) + fast(&track.gyro.t_s)
        };
        let samples_per_s = per_s(&track.position.t_s) + turning + fast(&track.accel.t_s);
        // A window may start just after a sample.
        (ROWS_PER_UNKNOWN * unknowns(track.drive)) as f64 / 3.0 / samples_per_s.max(1e-3)
            + 1.0 / samples_per_s.max(1e-3)
    };
    logs.iter().map(one).fold(0.0, f64::max)
}

/// One linearised window.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    /// Index of the log.
    pub log: usize,
    /// First tick.
    pub from: usize,
    /// Measured state at its start.
    pub start: Measured,
    /// JᵀJ of [nuisance parameters | parameters | residual], each row divided by its noise.
    pub gram: DMatrix<f64>,
    /// The rows themselves; kept for about [`NOISE_WINDOWS`] windows of a log.
    pub kept: Option<Arc<Kept>>,
    /// Number of rows of position, attitude, gyroscope and accelerometer.
    pub rows_of: [usize; CHANNELS],
    /// Number of rows.
    pub n_rows: usize,
    /// Number of its disturbances, each of six numbers.
    pub pushes: usize,
}

/// Number of nuisance parameters of a window with so many disturbances.
pub(crate) fn own_len(pushes: usize) -> usize {
    START_STATE + 6 * pushes
}

/// Initial states of the windows as the last fit estimates them, by log and tick. Near a wall the force changes within the
/// noise of a measured position: then a window has to be linearised at its estimated, not at its measured state.
pub(crate) type Starts = HashMap<(usize, usize), Measured>;

/// All windows linearised at one point.
pub(crate) struct Linear {
    pub windows: Vec<Window>,
    /// Parameter values at the linearisation point, shared by the logs.
    pub at: Vec<f64>,
    /// Deviation of each log's values from those, shape (log, parameter); empty where there is none.
    pub apart: Vec<Vec<f64>>,
    /// Length of the windows, s.
    pub horizon_s: f64,
    /// Noise by which the rows of each log were divided.
    pub noise: Vec<Noise>,
}

/// Parameters that share a pass of duals.
pub(super) struct Pass {
    pub parameters: Vec<usize>,
    pub drone: Drone<Wide>,
    /// Whether all of them enter only the sensor outputs: the rates then have zero derivative.
    pub reading: bool,
}

/// Passes over all parameters that enter the dynamics, the drive or the readings.
pub(super) fn passes(model: &Model, values: &[f64], chosen: &[usize]) -> Vec<Pass> {
    let constant = model.effects_of(chosen);
    let mut free: Vec<usize> = (0..values.len())
        .filter(|k| !matches!(model.parameters[*k].enters, Enters::Clock([0, ..])))
        .collect();
    // Grouped by effect, so that a pass has few effects.
    free.sort_by_key(|k| model.parameters[*k].effect);
    let (readings, dynamics): (Vec<usize>, Vec<usize>) =
        free.into_iter().partition(|k| model.parameters[*k].enters == Enters::Reading);
    let mut out = Vec::new();
    for (list, reading) in [(dynamics, false), (readings, true)] {
        for group in list.chunks(N) {
            let mut keep = constant.clone();
            group.iter().for_each(|k| keep[model.parameters[*k].effect] = true);
            let drone = model.drone_at(values, &keep, |k, v| match group.iter().position(|g| *g == k) {
                Some(slot) => Wide::input(v, slot),
                None => Wide::lit(v),
            });
            out.push(Pass { parameters: group.to_vec(), drone, reading });
        }
    }
    out
}

/// Derivatives at one node.
struct Node {
    /// Of acceleration and angular acceleration by the state, (6, 12).
    a: [[f64; 12]; 6],
    /// Of the same by the parameters, (6, parameter).
    g: Vec<[f64; 6]>,
    /// Of the outputs by the state, (output, 12).
    cx: [[f64; 12]; OUTPUTS],
    /// Of the outputs by the parameters, (parameter, output).
    cp: Vec<[f64; OUTPUTS]>,
}

/// All times, s.
pub(crate) const EVER_S: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// Which windows of the logs are used.
#[derive(Clone, Copy)]
pub(crate) struct Cut<'a> {
    /// Their length, s.
    pub length_s: f64,
    /// Most windows (approximately), evenly spread.
    pub most: usize,
    /// Those that begin in this interval, s.
    pub begin_s: [f64; 2],
    /// Once set, the windows that are left are skipped.
    pub cancel: Option<&'a AtomicBool>,
}

impl Cut<'_> {
    /// All windows of a length.
    pub fn all(length_s: f64) -> Self {
        Self { length_s, most: usize::MAX, begin_s: EVER_S, cancel: None }
    }
}

/// Linearises the windows of `cut` at parameter values `values`, with the effects of the file and of the candidates
/// `chosen` active.
pub(crate) fn linearise(
    logs: &[Prepared],
    model: &Model,
    values: &Values,
    chosen: &[usize],
    cut: Cut,
    known: &Starts,
    noise: &[Noise],
) -> Linear {
    let steps = ((cut.length_s / STEP_S / NODE as f64).round() as usize).max(2) * NODE;
    let mut windows = Vec::new();
    let ticks: usize = logs.iter().map(|l| l.around.n_ticks).sum();
    let every = (ticks / (steps * STEP)).div_ceil(cut.most.max(1)).max(1);
    for (index, p) in logs.iter().enumerate() {
        let values = &values.of(index);
        let plain = model.plain_at(values, chosen);
        let starts: Vec<usize> = (0..)
            .map(|w| w * every * steps * STEP)
            .take_while(|from| from + steps * STEP < p.around.n_ticks)
            .collect();
        let inputs = drive_inputs(p, model, values, chosen, &ticks_of(&starts, steps, p.around.n_ticks));
        // An input attitude is the one for which the model's sensors read the measured one.
        let believed = (p.track.drive == Drive::Thrust)
            .then(|| Around { measured: believed(p.track, &p.around, &plain), ..(*p.around).clone() });
        let around = believed.as_ref().unwrap_or(&*p.around);
        let passes = passes(model, values, chosen);
        let base = model.drone_at(values, &model.effects_of(chosen), |_, v| Wide::lit(v));
        let job = Job {
            p,
            model,
            inputs: &inputs,
            around,
            plant: Plant::new(&plain, p.track, around),
            base: Plant::new(&base, p.track, around),
            passes: passes.iter().map(|pass| (pass, Plant::new(&pass.drone, p.track, around))).collect(),
            delays: delays(p.track, &plain),
            steps,
            index,
            known,
            noise: &noise[index],
        };
        let kept = starts.len().div_ceil(NOISE_WINDOWS).max(1);
        let [begin, end] = cut.begin_s;
        let asked = |from: usize| (begin..end).contains(&p.around.time_s(from));
        let all = starts.into_par_iter().enumerate().filter(|(_, from)| asked(*from));
        let cancelled = || cut.cancel.is_some_and(|c| c.load(Ordering::Relaxed));
        let window = |(i, from)| if cancelled() { None } else { job.window(from, i % kept == 0) };
        windows.par_extend(all.filter_map(window));
    }
    windows.sort_by_key(|w| (w.log, w.from));
    let Values { shared: at, apart } = values.clone();
    Linear { windows, at, apart, horizon_s: steps as f64 * STEP_S, noise: noise.to_vec() }
}

/// Ticks of windows of so many steps that begin at `starts`, with those around their first and last node, over which derivatives are averaged.
fn ticks_of(starts: &[usize], steps: usize, n_ticks: usize) -> Vec<Range<usize>> {
    let beside = STEP * NODE;
    let mut out: Vec<Range<usize>> = Vec::new();
    for from in starts {
        let (from, to) = (from.saturating_sub(beside), (from + steps * STEP + beside + 1).min(n_ticks));
        match out.last_mut() {
            Some(last) if from <= last.end => last.end = to,
            _ => out.push(from..to),
        }
    }
    out
}

struct Job<'a> {
    p: &'a Prepared<'a>,
    around: &'a Around,
    model: &'a Model,
    inputs: &'a DriveInputs,
    plant: Plant<'a, f64>,
    base: Plant<'a, Wide>,
    passes: Vec<(&'a Pass, Plant<'a, Wide>)>,
    delays: [f64; 3],
    steps: usize,
    index: usize,
    known: &'a Starts,
    noise: &'a Noise,
}

impl Linear {
    /// The values at which a log was linearised.
    pub fn values_of(&self, log: usize) -> Vec<f64> {
        of_log(&self.at, &self.apart, log)
    }
}

impl Job<'_> {
    /// Linearises the window that starts at a tick; with `keep`, keeps its rows too.
    fn window(&self, from: usize, keep: bool) -> Option<Window> {
        let p = self.p;
        let ends = from + self.steps * STEP;
        if !p.raw.valid[from..=ends].iter().all(|v| *v) {
            return None;
        }
        let measured = *self.around.measured(from)?;
        let start = match self.known.get(&(self.index, from)) {
            Some(known) => *known,
            None => self.on_time(measured, self.p.around.time_s(from)),
        };
        if p.track.drive == Drive::Thrust
            && !(from..=ends).step_by(STEP).all(|tick| self.around.measured(tick).is_some())
        {
            return None;
        }
        let mut points = Vec::new();
        self.plant.roll(&self.inputs.ticks[from..], from, self.steps, &start, &[], &mut points);
        if !points.iter().all(|q| q.state.pos.iter().chain(&q.state.vel).all(|x| x.is_finite())) {
            return None;
        }
        let pushes = self.steps.div_ceil(PUSH_STEPS);
        let own = own_len(pushes);
        let Measurements { rows, rows_of } = self.rows(from, &points, self.steps / NODE + 1);
        let n_rows = rows.len();
        // A window with few rows does not determine its own nuisance parameters.
        if n_rows < ROWS_PER_UNKNOWN * unknowns(p.track.drive) {
            return None;
        }
        let nodes = self.sensitivities(from, &points, own, own + self.model.parameters.len());
        let shifts = self.shifts(own);
        let (gram, of_own) = gram::gram(&nodes, &rows, &shifts, own);
        // The derivatives may overflow where the model itself stays finite.
        if !gram.iter().all(|x| x.is_finite()) {
            return None;
        }
        let kept = keep.then(|| Arc::new(Kept { nodes, rows, shifts, own: of_own }));
        Some(Window { log: self.index, from, start, gram, kept, rows_of, n_rows, pushes })
    }

    /// A measured state with the gyroscope's rate at its time, where the two clocks differ.
    fn on_time(&self, mut state: Measured, at_s: f64) -> Measured {
        let late = self.delays[1];
        let gyro = &self.p.track.gyro;
        if late == 0.0 || gyro.is_empty() || self.p.track.drive == Drive::Thrust {
            return state;
        }
        let mean = |at: f64| -> Option<[f64; 3]> {
            let a = gyro.t_s.partition_point(|t| *t < at - STEP_S);
            let b = gyro.t_s.partition_point(|t| *t < at + STEP_S);
            let n = (b - a) as f64;
            (b > a).then(|| core::array::from_fn(|k| gyro.values[a..b].iter().map(|v| v[k]).sum::<f64>() / n))
        };
        if let (Some(then), Some(now)) = (mean(at_s + late), mean(at_s)) {
            for k in 0..3 {
                state.ang_vel[k] += then[k] - now[k];
            }
        }
        state
    }

    /// Derivatives of all outputs by all columns at every node.
    fn sensitivities(&self, from: usize, points: &[Point], own: usize, width: usize) -> Vec<Slopes> {
        let n_parameters = self.model.parameters.len();
        let given = self.p.track.drive == Drive::Thrust;
        let mut neighbours = Vec::new();
        // Rows of the state: position, velocity, rotation vector (body), body rate.
        let mut s = Slopes::zero(width);
        for k in 0..12 {
            s.row_mut(k)[k] = 1.0;
        }
        // An input attitude may be off by a constant rotation over the window; no rate follows from it.
        if given {
            for k in 9..12 {
                s.row_mut(k)[k] = 0.0;
            }
        }
        let mut out = Vec::with_capacity(points.len() / NODE + 1);
        let mut before: Option<(Node, [f64; 3])> = None;
        let dt = STEP_S * NODE as f64;
        let (mut rate0, mut rate1, mut ahead) = (Slopes::zero(width), Slopes::zero(width), s.clone());
        for i in (0..points.len()).step_by(NODE) {
            let node = self.node(from + i * STEP, &points[i], n_parameters, &mut neighbours);
            let turn = points[i].state.ang_vel;
            if let Some((last, last_turn)) = &before {
                // Heun's scheme on the variational equation.
                let push = START_STATE + 6 * ((i - NODE) / PUSH_STEPS);
                slope_rates(last, last_turn, &s, (push, own), given, &mut rate0);
                for (ahead, (s, rate)) in ahead.values.iter_mut().zip(s.values.iter().zip(&rate0.values)) {
                    *ahead = s + dt * rate;
                }
                slope_rates(&node, &turn, &ahead, (push, own), given, &mut rate1);
                for (s, (a, b)) in s.values.iter_mut().zip(rate0.values.iter().zip(&rate1.values)) {
                    *s += 0.5 * dt * (a + b);
                }
            }
            if given {
                // With the measured attitude as input, a rotation of the sensor rotates the vehicle the other way.
                for k in 0..3 {
                    for (c, slope) in s.row_mut(6 + k).iter_mut().enumerate().skip(own) {
                        *slope = match self.model.parameters[c - own].enters {
                            Enters::Reading => -node.cp[c - own][3 + k],
                            Enters::Clock([pose, ..]) => f64::from(pose) * turn[k],
                            _ => 0.0,
                        };
                    }
                }
            }
            let mut readings = Slopes::zero(width);
            for o in 0..OUTPUTS {
                let row = readings.row_mut(o);
                for (slope, cp) in row[own..].iter_mut().zip(&node.cp) {
                    *slope = cp[o];
                }
                s.add_times(&node.cx[o], row);
            }
            // The accelerometer feels a disturbance immediately.
            let q = points[i].state.quat;
            for k in 0..3 {
                let mut unit = [0.0; 3];
                unit[k] = 1.0;
                let body = quat::rotate_inverse(q, unit);
                let push = (i / PUSH_STEPS).min((own - START_STATE) / 6 - 1);
                for o in 0..3 {
                    readings.row_mut(9 + o)[START_STATE + 6 * push + k] += body[o];
                }
            }
            out.push(readings);
            before = Some((node, turn));
        }
        out
    }

    fn node(&self, tick: usize, point: &Point, n: usize, neighbours: &mut Vec<Neighbour<Wide>>) -> Node {
        let input = &self.inputs.ticks[tick];
        let lit = |v: [f64; 3]| v.map(Wide::lit);
        let plain = State::<Wide> {
            pos: lit(point.state.pos),
            quat: point.state.quat.map(Wide::lit),
            vel: lit(point.state.vel),
            ang_vel: lit(point.state.ang_vel),
            ..State::rest()
        };
        let constant = input.map(Wide::lit);
        // Derivatives by the state.
        let mut state = plain;
        for k in 0..3 {
            state.pos[k].partials[k] = 1.0;
            state.vel[k].partials[3 + k] = 1.0;
            state.ang_vel[k].partials[9 + k] = 1.0;
            // Multiplied from the right: the rotation vector is in body axes.
            let mut half = [0.0; 4];
            half[k] = 0.5;
            let turned = quat::mul(point.state.quat, half);
            for j in 0..4 {
                state.quat[j].partials[6 + k] = turned[j];
            }
        }
        let rate = self.base.rate(tick, &constant, &mut state, neighbours);
        let reading = self.base.drone.read(&state, &rate);
        let mut node = Node {
            a: [[0.0; 12]; 6],
            g: vec![[0.0; 6]; n],
            cx: [[0.0; 12]; OUTPUTS],
            cp: vec![[0.0; OUTPUTS]; n],
        };
        for k in 0..12 {
            for r in 0..3 {
                node.a[r][k] = rate.acc[r].partials[k];
                node.a[3 + r][k] = rate.ang_acc[r].partials[k];
            }
            let slopes = output_slopes(&reading, k);
            for o in 0..OUTPUTS {
                node.cx[o][k] = slopes[o];
            }
        }
        // Derivatives by the parameters.
        // Sensor parameters do not change the motion: their passes reuse the rate without derivatives.
        let still = |v: [Wide; 3]| v.map(|d| Wide::lit(d.value));
        let unmoved = Rate {
            vel: still(rate.vel),
            ang_vel: still(rate.ang_vel),
            acc: still(rate.acc),
            ang_acc: still(rate.ang_acc),
            ..Rate::zero()
        };
        for (pass, plant) in &self.passes {
            let parameters = &pass.parameters;
            let mut state = plain;
            if pass.reading {
                state.rotor_vel = constant.rotor_vel;
                state.thrust = constant.thrust;
                let reading = plant.drone.read(&state, &unmoved);
                for (slot, k) in parameters.iter().enumerate() {
                    node.cp[*k] = output_slopes(&reading, slot);
                }
                continue;
            }
            let driven = self.inputs.by(parameters, &constant, tick / (STEP * NODE));
            let rate = plant.rate(tick, &driven, &mut state, neighbours);
            let reading = plant.drone.read(&state, &rate);
            for (slot, k) in parameters.iter().enumerate() {
                for r in 0..3 {
                    node.g[*k][r] = rate.acc[r].partials[slot];
                    node.g[*k][3 + r] = rate.ang_acc[r].partials[slot];
                }
                node.cp[*k] = output_slopes(&reading, slot);
            }
        }
        node
    }
}

/// Derivatives of twelve numbers by all columns, stored row by row, so that loops over columns vectorise.
#[derive(Clone, Debug)]
pub(crate) struct Slopes {
    width: usize,
    values: Vec<f64>,
}

impl Slopes {
    fn zero(width: usize) -> Self {
        Self { width, values: vec![0.0; 12 * width] }
    }

    fn row(&self, k: usize) -> &[f64] {
        &self.values[k * self.width..(k + 1) * self.width]
    }

    fn row_mut(&mut self, k: usize) -> &mut [f64] {
        &mut self.values[k * self.width..(k + 1) * self.width]
    }

    /// Adds the rows, each times its factor, to `sum`. Most factors are zero: positions affect no rate.
    fn add_times(&self, factors: &[f64; 12], sum: &mut [f64]) {
        for (k, factor) in factors.iter().enumerate().filter(|(_, f)| **f != 0.0) {
            for (sum, x) in sum.iter_mut().zip(self.row(k)) {
                *sum += factor * x;
            }
        }
    }
}

/// Time derivative of the state's derivatives `s`. `push` is the first column of the active disturbance, `own` that of the
/// parameters. A `given` attitude drives no rate.
fn slope_rates(
    node: &Node,
    turn: &[f64; 3],
    s: &Slopes,
    (push, own): (usize, usize),
    given: bool,
    out: &mut Slopes,
) {
    for r in 0..6 {
        // Rows: acceleration (3..6 of the state), angular acceleration (9..12).
        let row = out.row_mut(if r < 3 { 3 + r } else { 6 + r });
        row.fill(0.0);
        s.add_times(&node.a[r], row);
        row[push + r] += 1.0;
        for (slope, g) in row[own..].iter_mut().zip(&node.g) {
            *slope += g[r];
        }
    }
    for k in 0..3 {
        out.row_mut(k).copy_from_slice(s.row(3 + k));
        // θ̇ = δω − ω × θ.
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        let theta = s.row(6 + a).iter().zip(s.row(6 + b));
        for (slope, (rate, (first, second))) in
            out.row_mut(6 + k).iter_mut().zip(s.row(9 + k).iter().zip(theta))
        {
            *slope = rate - (turn[a] * second - turn[b] * first);
        }
    }
    if given {
        (6..12).for_each(|k| out.row_mut(k).fill(0.0));
    }
}

/// Derivatives of an output by dual direction `k`: position, rotation vector (body), rates, specific force.
fn output_slopes(reading: &propwash_physics::measure::Reading<Wide>, k: usize) -> [f64; OUTPUTS] {
    let mut out = [0.0; OUTPUTS];
    let slope = reading.quat.map(|q| q.partials[k]);
    // Most parameters turn no sensor.
    let turn = if slope == [0.0; 4] {
        slope
    } else {
        quat::mul(quat::conjugate(reading.quat.map(|q| q.value)), slope)
    };
    for r in 0..3 {
        out[r] = reading.pos[r].partials[k];
        out[3 + r] = 2.0 * turn[r];
        out[6 + r] = reading.gyro[r].partials[k];
        out[9 + r] = reading.accel[r].partials[k];
    }
    out
}
