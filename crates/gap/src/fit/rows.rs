//! The rows of a window: every measured minus modelled value and its derivatives, divided by the noise.

use super::{CHANNELS, Job, NODE, OUTPUTS, Slopes};
use crate::model::Enters;
use crate::replay::{Point, STEP_S, between, by_pose};
use crate::track::Drive;
use core::ops::Range;
use propwash_flight::Channel;
use propwash_flight::resample::rotation_vector;
use propwash_physics::measure::Reading;
use propwash_trace::math::quat;

impl Job<'_> {
    /// Rows [nuisance parameters | parameters | residual] over the noise, one per measurement in the window, row after row.
    pub(super) fn rows(
        &self,
        from: usize,
        points: &[Point],
        outputs: &[Slopes],
        own: usize,
        width: usize,
    ) -> (Vec<f64>, [usize; CHANNELS]) {
        let (track, noise) = (self.p.track, self.noise);
        let clocks: Vec<(usize, usize)> = (own..width)
            .filter_map(|c| match self.model.parameters[c - own].enters {
                Enters::Clock(of) => Some((c, of)),
                _ => None,
            })
            .collect();
        let begin = self.p.around.time_s(from);
        let mut rows = Rows {
            job: self,
            points,
            outputs,
            clocks,
            begin,
            end: begin + self.steps as f64 * STEP_S,
            by_pose: by_pose(track.drive),
            out: Vec::new(),
            rows_of: [0; CHANNELS],
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
        (rows.out, rows.rows_of)
    }

    /// Time derivatives of the outputs, per s.
    fn moving(&self, points: &[Point], step: usize, after_s: f64) -> [f64; OUTPUTS] {
        let here = between(points, step, after_s);
        let (a, b) = (
            self.plant.drone.read(&points[step].state, &points[step].rate),
            self.plant.drone.read(&points[step + 1].state, &points[step + 1].rate),
        );
        let mut out = [0.0; OUTPUTS];
        for k in 0..3 {
            out[k] = here.state.vel[k];
            out[3 + k] = here.state.ang_vel[k];
            out[6 + k] = here.rate.ang_acc[k];
            out[9 + k] = (b.accel[k] - a.accel[k]) / STEP_S;
        }
        out
    }
}

/// Rows of one window under construction.
struct Rows<'a> {
    job: &'a Job<'a>,
    points: &'a [Point],
    outputs: &'a [Slopes],
    /// Columns of parameters that shift samples in time, with their channel.
    clocks: Vec<(usize, usize)>,
    /// Start and end of the window, s.
    begin: f64,
    end: f64,
    by_pose: bool,
    out: Vec<f64>,
    rows_of: [usize; CHANNELS],
}

impl Rows<'_> {
    fn positions(&mut self) {
        let (channel, delay) = (&self.job.p.track.position, self.job.delays[0]);
        for i in self.inside(&channel.t_s, delay) {
            let after = channel.t_s[i] - delay - self.begin;
            let reading = self.reading_at(after);
            let residual = core::array::from_fn(|k| channel.values[i][k] - reading.pos[k]);
            self.push(after, 0..3, residual, self.job.noise.position_m, 0);
        }
    }

    fn attitudes(&mut self) {
        let (channel, delay) = (&self.job.p.track.attitude, self.job.delays[0]);
        for i in self.inside(&channel.t_s, delay) {
            let after = channel.t_s[i] - delay - self.begin;
            let reading = self.reading_at(after);
            let turn = quat::mul(quat::conjugate(reading.quat), channel.values[i]);
            self.push(after, 3..6, rotation_vector(turn), self.job.noise.attitude_rad, 0);
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
                    let reading = self.reading_at(t[j] - delay - begin);
                    let read = if of == 1 { reading.gyro } else { reading.accel };
                    for k in 0..3 {
                        sum[k] += channel.values[j][k] - read[k];
                    }
                }
                self.push(after, which.clone(), sum.map(|s| s / n), sigma / n.sqrt(), of);
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

    fn reading_at(&self, after: f64) -> Reading<f64> {
        let step = ((after / STEP_S) as usize).min(self.points.len() - 2);
        self.job.plant.reading(self.points, step, after - step as f64 * STEP_S)
    }

    /// Adds the rows of one measurement: derivatives of the outputs `which` at a time after the window's start, and the
    /// residual.
    fn push(&mut self, after: f64, which: Range<usize>, residual: [f64; 3], sigma: f64, channel: usize) {
        let (points, outputs, out) = (self.points, self.outputs, &mut self.out);
        let node_s = STEP_S * NODE as f64;
        let place = (after / node_s).min(outputs.len() as f64 - 1.0 - 1e-9).max(0.0);
        let (i, f) = (place.floor() as usize, place.fract());
        let (a, b) = (&outputs[i], &outputs[i + 1]);
        let step = ((after / STEP_S) as usize).min(points.len() - 2);
        let moving = self.job.moving(points, step, after - step as f64 * STEP_S);
        let per = 1.0 / sigma;
        for (r, o) in which.enumerate() {
            let first = out.len();
            out.extend(a.row(o).iter().zip(b.row(o)).map(|(a, b)| (a + f * (b - a)) * per));
            // A delayed sample shows an earlier value.
            for (c, of) in &self.clocks {
                let here = if self.by_pose && *of == 0 {
                    -f64::from(channel != 0)
                } else {
                    f64::from(*of == channel)
                };
                out[first + c] -= here * moving[o] * per;
            }
            self.rows_of[o / 3] += 1;
            out.push(residual[r] * per);
        }
    }
}
