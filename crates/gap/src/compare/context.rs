//! Operating conditions along a log, and the residuals, averaged in blocks in which causes are sought.

use crate::causes::{BLOCK_S, Block, Label};
use crate::replay::{STEP, STEP_S};
use crate::residual::{self, Replay, Residuals};
use crate::track::{Drive, Measured};
use propwash_flight::resample;
use propwash_trace::math::{quat, vec3};

/// Operating conditions per instant, in the order of the labels; NaN where unknown.
pub(crate) struct Context {
    pub labels: Vec<Label>,
    pub values: Vec<Vec<f64>>,
}

pub(crate) fn context(replay: &Replay) -> Context {
    let track = replay.track;
    let n = replay.n_steps();
    let at: Vec<f64> = (0..n).map(|i| replay.time_s(i)).collect();
    let mut out = Context { labels: Vec::new(), values: Vec::new() };
    let mut add = |name: &str, title: &str, unit: &'static str, values: Vec<f64>| {
        out.labels.push((name.into(), title.into(), unit));
        out.values.push(values);
    };
    let of_state = |f: &dyn Fn(&Measured) -> f64| -> Vec<f64> {
        replay.around.measured.iter().map(|m| m.as_ref().map_or(f64::NAN, f)).collect()
    };
    add("speed", "speed", "m/s", of_state(&|m| vec3::norm(m.vel)));
    let along = |axis: usize| of_state(&move |m| quat::rotate_inverse(m.quat, m.vel)[axis]);
    add("velocity_forward", "forward velocity", "m/s", along(0));
    add("velocity_left", "velocity to the left", "m/s", along(1));
    add("velocity_up", "velocity along body z", "m/s", along(2));
    add("height", "height over the ground", "m", of_state(&|m| track.ground_distance_m(m.pos[2])));
    match track.drive {
        Drive::RotorSpeeds | Drive::RotorCommands => {
            let rotors = replay.drone.airframe.n_rotors.max(1);
            let mean =
                |i: usize| replay.ticks[i * STEP].rotor_vel[..rotors].iter().sum::<f64>() / rotors as f64;
            add("rotor_speed", "mean rotor speed", "rad/s", (0..n).map(mean).collect());
        }
        Drive::AttitudeCommands | Drive::Thrust => {
            add("thrust", "thrust", "N", (0..n).map(|i| replay.ticks[i * STEP].thrust).collect());
        }
    }
    add(
        "tilt",
        "tilt",
        "rad",
        of_state(&|m| quat::rotate(m.quat, [0.0, 0.0, 1.0])[2].clamp(-1.0, 1.0).acos()),
    );
    add("yaw_rate", "yaw rate", "rad/s", of_state(&|m| m.ang_vel[2]));
    if track.log.vbat_v.len() > 1 {
        let v = resample::linear(&track.log.vbat_v, &at, 5.0);
        let v = v.into_iter().map(|v| v.map_or(f64::NAN, |v| v[0])).collect();
        add("battery", "battery voltage", "V", v);
    }
    add("time", "time", "s", at.clone());
    for name in &track.neighbours {
        let Some(channel) = track.log.objects_m.get(name) else { continue };
        let places = resample::linear(channel, &at, 0.2);
        let distance = places
            .into_iter()
            .zip(&replay.around.measured)
            .map(|(p, m)| match (p, m) {
                (Some(p), Some(m)) => vec3::norm(vec3::sub(p, m.pos)),
                _ => f64::NAN,
            })
            .collect();
        add(&format!("distance.{name}"), &format!("distance to {name}"), "m", distance);
    }
    out
}

pub(super) fn responses() -> Vec<Label> {
    [
        ("force", "force", "N"),
        ("force_body_x", "force along body x", "N"),
        ("force_body_y", "force along body y", "N"),
        ("force_body_z", "force along body z", "N"),
        ("force_along_velocity", "force along the velocity", "N"),
        ("torque", "torque", "N·m"),
        ("torque_body_x", "torque about body x", "N·m"),
        ("torque_body_y", "torque about body y", "N·m"),
        ("torque_body_z", "torque about body z", "N·m"),
    ]
    .map(|(name, title, unit)| (name.into(), title.into(), unit))
    .to_vec()
}

/// Lowest speed at which the direction of flight is meaningful, m/s.
const MOVING_M_S: f64 = 0.1;

/// Means over blocks of [`BLOCK_S`].
pub(super) fn blocks(replay: &Replay, residuals: &Residuals, context: &Context) -> Vec<Block> {
    let per = (BLOCK_S / STEP_S).round() as usize;
    let mut out = Vec::new();
    let mut from = 0;
    let list = &residuals.samples;
    while from < list.len() {
        let number = list[from].step / per;
        let to = from + list[from..].partition_point(|s| s.step / per == number);
        let part = &list[from..to];
        from = to;
        if part.len() * 2 < per {
            continue;
        }
        let mean = |f: &dyn Fn(&residual::Sample) -> f64| part.iter().map(f).sum::<f64>() / part.len() as f64;
        let force: [f64; 3] = std::array::from_fn(|k| mean(&|s| s.force_n[k]));
        let torque: [f64; 3] = std::array::from_fn(|k| mean(&|s| s.torque_n_m.map_or(f64::NAN, |t| t[k])));
        let along = mean(&|s| match &replay.around.measured[s.step] {
            Some(m) if vec3::norm(m.vel) > MOVING_M_S => {
                let v = quat::rotate_inverse(m.quat, m.vel);
                vec3::dot(s.force_n, v) / vec3::norm(v)
            }
            _ => f64::NAN,
        });
        let mut responses = vec![vec3::norm(force)];
        responses.extend(force);
        responses.push(along);
        responses.push(vec3::norm(torque));
        responses.extend(torque);
        out.push(Block {
            number,
            causes: context.values.iter().map(|v| mean(&|s| v[s.step])).collect(),
            responses,
        });
    }
    out
}
