//! Overlays of measurement and simulation over a segment of a flight, in roll-outs restarted from the measurement.

use super::GapError;
use super::replay::{Context, STEP, STEP_S, drone_for};
use super::report::Overlay;
use super::residual::Replay;
use super::track::{Drive, Track};
use propwash_trace::math::euler;
use propwash_vehicle::Vehicle;

/// Length of a roll-out, s.
pub const ROLL_S: f64 = 0.5;
/// Length of the segment, s.
pub const STRETCH_S: f64 = 10.0;
/// Steps between plotted samples.
const EVERY: usize = 4;
/// Channels: name, SI unit.
const CHANNELS: [(&str, &str); 12] = [
    ("position x", "m"),
    ("position y", "m"),
    ("position z", "m"),
    ("velocity x", "m/s"),
    ("velocity y", "m/s"),
    ("velocity z", "m/s"),
    ("roll", "rad"),
    ("pitch", "rad"),
    ("yaw", "rad"),
    ("body rate x", "rad/s"),
    ("body rate y", "rad/s"),
    ("body rate z", "rad/s"),
];

/// Times, measured values, simulated values.
type Rows = (Vec<f64>, Vec<[f64; 12]>, Vec<[f64; 12]>);

/// Position, velocity, roll pitch yaw and body rates of the first [`STRETCH_S`] after `from_s`: as measured, and as the
/// sensors of each vehicle would read in roll-outs of [`ROLL_S`]. NaN separates the roll-outs.
///
/// # Errors
/// [`GapError::Log`] where a vehicle lacks the dynamics that the log drives.
pub fn overlays(
    track: &Track,
    from_s: f64,
    as_filed: &Vehicle,
    with_effects: Option<&Vehicle>,
) -> Result<Vec<Overlay>, GapError> {
    let shown = |state: &([f64; 3], [f64; 3], [f64; 4], [f64; 3])| -> [f64; 12] {
        let (pos, vel, quat, rate) = state;
        let rpy = euler::from_quat(*quat);
        core::array::from_fn(|c| [pos, vel, &rpy, rate][c / 3][c % 3])
    };
    let span = track.span_s;
    let begin = from_s.max(span[0]).min((span[1] - STRETCH_S).max(span[0]));
    let per = (ROLL_S / STEP_S).round() as usize;
    let simulate = |vehicle: &Vehicle| -> Result<Rows, GapError> {
        let drone = drone_for(track, vehicle)?;
        let Context { around, raw } = Context::of(track, &drone);
        let replay = Replay::new(track, &around, &raw, &drone);
        let plant = replay.plant();
        let first = ((begin - around.from_s) / STEP_S).round().max(0.0) as usize;
        let last = (first + (STRETCH_S / STEP_S).round() as usize).min(replay.n_steps().saturating_sub(1));
        let (mut times, mut measured, mut simulated) = (Vec::new(), Vec::new(), Vec::new());
        let mut points = Vec::new();
        let mut at = first;
        while at + per <= last {
            let start = replay.start(at, per);
            if let Some(start) = start {
                plant.roll(&replay.ticks[at * STEP..], at * STEP, per, start, &[], &mut points);
            }
            for i in (0..per).step_by(EVERY) {
                times.push(replay.time_s(at + i));
                measured.push(
                    around.measured[at + i]
                        .map_or([f64::NAN; 12], |m| shown(&(m.pos, m.vel, m.quat, m.ang_vel))),
                );
                simulated.push(match start {
                    Some(_) => {
                        let r = plant.reading(&points, i, 0.0);
                        shown(&(r.pos, r.vel, r.quat, r.gyro))
                    }
                    None => [f64::NAN; 12],
                });
            }
            // The next roll-out restarts from the measurement.
            at += per;
            times.push(replay.time_s(at) - 1e-3);
            measured.push(*measured.last().unwrap_or(&[f64::NAN; 12]));
            simulated.push([f64::NAN; 12]);
        }
        Ok((times, measured, simulated))
    };
    let (t_s, measured, before) = simulate(as_filed)?;
    let after = with_effects.map(simulate).transpose()?.map_or_else(Vec::new, |(_, _, rows)| rows);
    let column = |rows: &[[f64; 12]], c: usize| -> Vec<f64> {
        let mut column: Vec<f64> = rows.iter().map(|r| r[c]).collect();
        if c == 8 {
            unwrap(&mut column);
        }
        column
    };
    // Attitude and body rate are no results where they are inputs.
    let results = if track.drive == Drive::Thrust { 6 } else { CHANNELS.len() };
    Ok(CHANNELS[..results]
        .iter()
        .enumerate()
        .map(|(c, (channel, unit))| Overlay {
            log: track.name.clone(),
            channel: (*channel).into(),
            unit: (*unit).into(),
            t_s: t_s.clone(),
            measured: column(&measured, c),
            as_filed: column(&before, c),
            with_effects: column(&after, c),
        })
        .collect())
}

/// Unwraps an angle.
fn unwrap(angle_rad: &mut [f64]) {
    let mut last = f64::NAN;
    for a in angle_rad {
        if last.is_finite() && a.is_finite() {
            *a -= core::f64::consts::TAU * ((*a - last) / core::f64::consts::TAU).round();
        }
        if a.is_finite() {
            last = *a;
        }
    }
}
