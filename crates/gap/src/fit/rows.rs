//! The rows of a window: every measured minus modelled value, where it lies between the nodes, and how it moves with time.

use super::{CHANNELS, Job, NODE, OUTPUTS};
use crate::model::Enters;
use crate::replay::{Point, STEP_S, between_turned, by_pose, turn_to_next};
use crate::track::Drive;
use core::ops::Range;
use propwash_flight::Channel;
use propwash_flight::resample::rotation_vector;
use propwash_physics::measure::Reading;
use propwash_trace::math::quat;

/// One measured number, divided by its noise.
///
/// Its derivatives are those of output `output` between two nodes, `per` times (1 − `share`) of the one and `share` of the
/// next; a clock that shows it earlier adds `moving`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub node: usize,
    pub share: f64,
    pub output: usize,
    pub per: f64,
    /// Time derivative of the modelled value over the noise, 1/s.
    pub moving: f64,
    /// Measured minus modelled value over the noise.
    pub residual: f64,
}

/// Columns that shift the samples of each channel in time, with the factor on [`Row::moving`].
pub(crate) type Shifts = [Vec<(usize, f64)>; CHANNELS];

/// Rows of position, attitude, gyroscope and accelerometer, one after the other.
pub(super) struct Measurements {
    pub rows: Vec<Row>,
    /// Number of rows of each channel.
    pub rows_of: [usize; CHANNELS],
}

impl Job<'_> {
    /// One row per measured number in the window.
    pub(super) fn rows(&self, from: usize, points: &[Point], nodes: usize) -> Measurements {
        let (track, noise) = (self.p.track, self.noise);
        let begin = self.p.around.time_s(from);
        let turns = points.windows(2).map(|pair| turn_to_next(&pair[0], &pair[1])).collect();
        let felt = |p: &Point| self.plant.drone.read(&p.state, &p.rate).accel;
        let mut rows = Rows {
            job: self,
            points,
            turns,
            felt: if track.accel.is_empty() { Vec::new() } else { points.iter().map(felt).collect() },
            nodes,
            begin,
            end: begin + self.steps as f64 * STEP_S,
            out: Measurements { rows: Vec::new(), rows_of: [0; CHANNELS] },
        };
        rows.positions();
        if track.drive != Drive::Thrust {
            rows.attitudes();
        }
        for (channel, sigma, which, of) in
            [(&track.gyro, noise.gyro_rad_s, 6..9, 1), (&track.accel, noise.accel_m_s2, 9..12, 2)]
        {
            if track.drive == Drive::Thrust && of == 1 {
                continue;
            }
            rows.averaged(channel, sigma, which, of);
        }
        rows.out
    }

    /// The columns of clocks, from column `own` on: a delayed sample shows an earlier value.
    pub(super) fn shifts(&self, own: usize) -> Shifts {
        let by_pose = by_pose(self.p.track.drive);
        let clock = |(k, enters): (usize, Enters)| match enters {
            Enters::Clock(of) => Some((own + k, of)),
            _ => None,
        };
        let all = self.model.parameters.iter().map(|p| p.enters).enumerate();
        let clocks: Vec<(usize, [i8; 3])> = all.filter_map(clock).collect();
        // Outputs by the clock of their sensor: pose, pose, gyroscope, accelerometer.
        [0, 0, 1, 2].map(|channel: usize| {
            let factor = |late: &[i8; 3]| {
                let zero = if by_pose { late[0] } else { 0 };
                f64::from(zero - late[channel])
            };
            clocks.iter().map(|(c, late)| (*c, factor(late))).filter(|(_, f)| *f != 0.0).collect()
        })
    }
}

/// Rows of one window under construction.
struct Rows<'a> {
    job: &'a Job<'a>,
    points: &'a [Point],
    /// Rotation vector from each point to the next.
    turns: Vec<[f64; 3]>,
    /// What the accelerometer reads at each point; empty where there is none.
    felt: Vec<[f64; 3]>,
    nodes: usize,
    /// Start and end of the window, s.
    begin: f64,
    end: f64,
    out: Measurements,
}

impl Rows<'_> {
    fn positions(&mut self) {
        let (channel, delay) = (&self.job.p.track.position, self.job.delays[0]);
        for i in self.inside(&channel.t_s, delay) {
            let after = channel.t_s[i] - delay - self.begin;
            let point = self.point(after);
            let reading = self.reading(&point);
            let residual = core::array::from_fn(|k| channel.values[i][k] - reading.pos[k]);
            self.push(after, 0..3, (residual, point.state.vel), self.job.noise.position_m);
        }
    }

    fn attitudes(&mut self) {
        let (channel, delay) = (&self.job.p.track.attitude, self.job.delays[0]);
        for i in self.inside(&channel.t_s, delay) {
            let after = channel.t_s[i] - delay - self.begin;
            let point = self.point(after);
            let turn = quat::mul(quat::conjugate(self.reading(&point).quat), channel.values[i]);
            let residual = rotation_vector(turn);
            self.push(after, 3..6, (residual, point.state.ang_vel), self.job.noise.attitude_rad);
        }
    }

    /// Averages fast sensors over a step: between nodes the model is practically linear. The grouping of samples does not
    /// depend on the clock parameters, or noise would decide between clocks.
    fn averaged(&mut self, channel: &Channel<3>, sigma: f64, which: Range<usize>, of: usize) {
        let (begin, end) = (self.begin, self.end);
        let delay = self.job.delays[of];
        let t = &channel.t_s;
        let mut i = t.partition_point(|t| t - delay < begin - STEP_S);
        let last = t.partition_point(|t| t - delay < end + STEP_S);
        while i < last {
            let bin = (t[i] / STEP_S).floor();
            let next = i + t[i..last].iter().take_while(|t| (*t / STEP_S).floor() == bin).count();
            let n = (next - i) as f64;
            let after = t[i..next].iter().sum::<f64>() / n - delay - begin;
            if after >= 0.0 && after < end - begin {
                let mut sum = [0.0; 3];
                for j in i..next {
                    let reading = self.reading(&self.point(t[j] - delay - begin));
                    let read = if of == 1 { reading.gyro } else { reading.accel };
                    for k in 0..3 {
                        sum[k] += channel.values[j][k] - read[k];
                    }
                }
                let moving = if of == 1 {
                    self.point(after).rate.ang_acc
                } else {
                    let step = self.step(after);
                    core::array::from_fn(|k| (self.felt[step + 1][k] - self.felt[step][k]) / STEP_S)
                };
                self.push(after, which.clone(), (sum.map(|s| s / n), moving), sigma / n.sqrt());
            }
            i = next;
        }
    }

    /// Indices of the samples inside the window.
    fn inside(&self, t: &[f64], delay: f64) -> Range<usize> {
        let a = t.partition_point(|t| t - delay < self.begin);
        let b = t.partition_point(|t| t - delay < self.end);
        a..b
    }

    /// The step that holds a time after the window's start.
    fn step(&self, after: f64) -> usize {
        ((after / STEP_S) as usize).min(self.points.len() - 2)
    }

    fn point(&self, after: f64) -> Point {
        let step = self.step(after);
        let ends = (&self.points[step], &self.points[step + 1]);
        between_turned(ends, self.turns[step], after - step as f64 * STEP_S)
    }

    fn reading(&self, point: &Point) -> Reading<f64> {
        self.job.plant.drone.read(&point.state, &point.rate)
    }

    /// Adds the rows of one measurement: outputs `which` at a time after the window's start, with their residuals and
    /// their time derivatives.
    fn push(
        &mut self,
        after: f64,
        which: Range<usize>,
        (residual, moving): ([f64; 3], [f64; 3]),
        sigma: f64,
    ) {
        let node_s = STEP_S * NODE as f64;
        let place = (after / node_s).min(self.nodes as f64 - 1.0 - 1e-9).max(0.0);
        let per = 1.0 / sigma;
        for (r, output) in which.enumerate() {
            debug_assert!(output < OUTPUTS);
            self.out.rows.push(Row {
                node: place.floor() as usize,
                share: place.fract(),
                output,
                per,
                moving: moving[r] * per,
                residual: residual[r] * per,
            });
            self.out.rows_of[output / 3] += 1;
        }
    }
}
