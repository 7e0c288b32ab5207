//! Where a model goes that starts again from the measurement every so many seconds, over a whole flight.

use super::GapError;
use super::replay::{Context, STEP, STEP_S, drone_for};
use super::residual::Replay;
use super::track::Track;
use propwash_vehicle::Vehicle;

/// Poses of a model over a flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ghost {
    /// s from the start of the log; rising.
    pub t_s: Vec<f64>,
    /// m, world; NaN between two starts, and where the measurement does not say where to start.
    pub pos_m: Vec<[f64; 3]>,
    /// x y z w, body to world; NaN likewise.
    pub quat_xyzw: Vec<[f64; 4]>,
    /// When it starts, s.
    pub starts_s: Vec<f64>,
}

impl Ghost {
    fn push(&mut self, t_s: f64, pose: Option<([f64; 3], [f64; 4])>) {
        let (pos, quat) = pose.unwrap_or(([f64::NAN; 3], [f64::NAN; 4]));
        self.t_s.push(t_s);
        self.pos_m.push(pos);
        self.quat_xyzw.push(quat);
    }
}

/// Flies a vehicle's model from the measured state anew every `every_s` seconds, with the inputs of the flight, and gives a pose every
/// `sample_s` seconds and at each end, as the sensors that the vehicle models would read it. Both are rounded to whole steps of 5 ms, at
/// least one; nothing flies where the log is shorter than `every_s`.
///
/// # Errors
/// [`GapError::Log`] where the vehicle lacks the dynamics that the log drives.
pub fn ghost(track: &Track, vehicle: &Vehicle, every_s: f64, sample_s: f64) -> Result<Ghost, GapError> {
    let drone = drone_for(track, vehicle)?;
    let Context { around, raw } = Context::of(track, &drone);
    let replay = Replay::new(track, &around, &raw, &drone);
    let plant = replay.plant();
    let steps = |s: f64| (s / STEP_S).round().max(1.0) as usize;
    let (per, sample) = (steps(every_s), steps(sample_s));
    let (mut out, mut points) = (Ghost::default(), Vec::new());
    let mut at = 0usize;
    while at.saturating_add(per) < replay.n_steps() {
        match replay.start(at, per) {
            Some(start) => {
                out.starts_s.push(replay.time_s(at));
                plant.roll(&replay.ticks[at * STEP..], at * STEP, per, start, &[], &mut points);
                for i in (0..per).step_by(sample).chain([per]) {
                    // Just before the next start, so that times rise.
                    let early = if i == per { 1e-4 } else { 0.0 };
                    let reading = plant.reading(&points, i, 0.0);
                    out.push(replay.time_s(at + i) - early, Some((reading.pos, reading.quat)));
                }
                out.push(replay.time_s(at + per) - 5e-5, None);
                at += per;
            }
            // Where it cannot start, the next moment is tried.
            None => {
                out.push(replay.time_s(at), None);
                at += sample;
            }
        }
    }
    Ok(out)
}
