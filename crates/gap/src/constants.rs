//! Constant force or torque throughout a flight, in words: what it is, and what could cause it.

use super::causes::Cause;
use super::compare::{Axes, OneStep};
use super::headline::number;
use super::policy::{CONSTANT_CAUSE, CONSTANT_SHARE, CONSTANT_TIMES_NOISE};
use propwash_physics::effects::Parts;
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_trace::math::vec3;

/// Vehicle properties that convert a residual into the fault that would cause it.
pub(crate) struct Build {
    weight_n: f64,
    mass_kg: f64,
    /// Mean distance of the rotors from the planes through the centre of mass, along x and y, m.
    arms_m: [f64; 2],
}

impl Build {
    pub fn of(parts: &Parts<f64>) -> Self {
        let mass_kg = parts.body.mass_kg;
        let n = parts.airframe.n_rotors.clamp(1, MAX_ROTORS);
        let arm = |axis: usize| {
            parts.airframe.rotors[..n].iter().map(|r| r.position_m[axis].abs()).sum::<f64>() / n as f64
        };
        Self { weight_n: mass_kg * vec3::norm(parts.body.gravity_m_s2), mass_kg, arms_m: [arm(0), arm(1)] }
    }
}

/// The constant forces and torques of a comparison, largest over its noise first. A mean that comes from a varying cause
/// does not count: the drag of a vehicle that always flies forward has one.
pub(crate) fn sentences(one_step: &OneStep, build: &Build, causes: &[Cause]) -> Vec<String> {
    let mut out: Vec<(f64, String)> = Vec::new();
    if let Some(torque) = &one_step.torque {
        let free = |k: usize, mean: f64| {
            !comes_of(causes, ["torque_body_x", "torque_body_y", "torque_body_z"][k], mean)
        };
        constants(torque, ("torque about", "N·m"), &mut out, &free, &|k, mean| torque_cause(build, k, mean));
    }
    let free =
        |k: usize, mean: f64| !comes_of(causes, ["force_body_x", "force_body_y", "force_body_z"][k], mean);
    constants(&one_step.force, ("force along", "N"), &mut out, &free, &|k, mean| force_cause(build, k, mean));
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    out.into_iter().map(|(_, text)| text).collect()
}

/// Whether a mean residual vanishes where a cause that explains most of its variance is zero.
fn comes_of(causes: &[Cause], response: &str, mean: f64) -> bool {
    causes.iter().filter(|c| c.name != "time").any(|c| {
        let n: usize = c.counts.iter().sum();
        let middle =
            c.values.iter().zip(&c.counts).map(|(v, n)| v * *n as f64).sum::<f64>() / n.max(1) as f64;
        let of = c.responses.iter().find(|r| r.name == response);
        of.is_some_and(|r| {
            r.share >= CONSTANT_CAUSE && (mean - r.slope * middle).abs() < (1.0 - CONSTANT_CAUSE) * mean.abs()
        })
    })
}

fn constants(
    axes: &Axes,
    (what, unit): (&str, &str),
    out: &mut Vec<(f64, String)>,
    free: &dyn Fn(usize, f64) -> bool,
    cause: &dyn Fn(usize, f64) -> String,
) {
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        let (mean, sigma) = (axes.mean[k], axes.sigma[k]);
        let mostly = mean * mean >= CONSTANT_SHARE * axes.rms[k] * axes.rms[k];
        if sigma > 0.0 && mean.abs() >= CONSTANT_TIMES_NOISE * sigma && mostly && free(k, mean) {
            let times = mean.abs() / sigma;
            let text = format!(
                "a {what} body {axis} of {} is missing throughout ({times:.1} times noise): {}",
                number(mean, unit),
                cause(k, mean)
            );
            out.push((times, text));
        }
    }
}

/// Unequal rotors, or a centre of mass to the side; about z, unequal rotor drag torques.
fn torque_cause(build: &Build, axis: usize, torque_n_m: f64) -> String {
    let offset = || number(torque_n_m.abs() / build.weight_n, "m");
    // If one side is stronger by a share e of its thrust, the torque is e/2 · weight · arm.
    let share = |arm: f64| 200.0 * torque_n_m.abs() / (build.weight_n * arm);
    let sides = match (axis, torque_n_m > 0.0) {
        (0, true) => "the rotors on the left are stronger than those on the right",
        (0, false) => "the rotors on the right are stronger than those on the left",
        (1, true) => "the rotors behind are stronger than those ahead",
        (1, false) => "the rotors ahead are stronger than those behind",
        _ => return "rotors lean, or resist turning more one way round than the other".into(),
    };
    let arm = build.arms_m[1 - axis];
    if arm > 0.0 {
        format!("{sides} by about {:.1} %, or the centre of mass is {} off", share(arm), offset())
    } else {
        format!("the centre of mass is {} off", offset())
    }
}

/// Along z thrust or mass; across, wind or a tilted attitude.
fn force_cause(build: &Build, axis: usize, force_n: f64) -> String {
    let share = force_n.abs() / build.weight_n;
    if axis < 2 {
        return format!(
            "a steady wind, or attitude and thrust are askew by {:.2}°",
            share.atan().to_degrees()
        );
    }
    let (thrust, mass) = if force_n > 0.0 { ("stronger", "lighter") } else { ("weaker", "heavier") };
    format!(
        "thrust is {:.1} % {thrust} than filed, or the vehicle {} {mass}",
        100.0 * share,
        number(share * build.mass_kg, "kg")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::Series;

    fn axes(mean: [f64; 3], rest: f64, sigma: f64) -> Axes {
        let rms = mean.map(|m| m.hypot(rest));
        Axes { rms, mean, sigma: [sigma; 3], in_sigmas: rms.map(|r| r / sigma), explained: [None; 3] }
    }

    #[test]
    fn a_constant_torque_is_told_by_what_makes_it() {
        let build = Build { weight_n: 7.36, mass_kg: 0.75, arms_m: [0.1, 0.1] };
        let step = |torque, force| OneStep {
            n: 1000,
            force_from: "accelerometer",
            torque_from: "gyroscope",
            certainty: String::new(),
            force,
            torque: Some(torque),
            series: Series::default(),
        };
        let quiet = axes([0.0; 3], 0.03, 0.03);
        let words = sentences(&step(axes([5.1e-3, 0.0, 0.0], 1e-3, 3.4e-4), quiet.clone()), &build, &[]);
        assert_eq!(
            words,
            [
                "a torque about body x of 5.10 mN·m is missing throughout (15.0 times noise): the rotors on the left are \
              stronger than those on the right by about 1.4 %, or the centre of mass is 693 µm off"
            ]
        );
        // A constant within the noise, or small against what varies, is not reported.
        assert!(
            sentences(&step(axes([6e-4, 0.0, 0.0], 1e-5, 3.4e-4), quiet.clone()), &build, &[]).is_empty()
        );
        assert!(
            sentences(&step(axes([5.1e-3, 0.0, 0.0], 2e-2, 3.4e-4), quiet.clone()), &build, &[]).is_empty()
        );
        let heavy =
            sentences(&step(axes([0.0; 3], 1e-4, 3.4e-4), axes([0.0, 0.0, -0.2], 0.02, 0.03)), &build, &[]);
        assert_eq!(heavy.len(), 1);
        // A drag of −0.1 N·s/m at 2 m/s forward speed is not a constant, though it is there throughout.
        let drag = crate::Response {
            name: "force_body_x".into(),
            title: String::new(),
            unit: "N".into(),
            means: vec![-0.15, -0.25],
            standard_errors: vec![1e-3; 2],
            share: 0.98,
            significance: 9.0,
            correlation: -0.99,
            slope: -0.1,
            slope_sigma: 1e-3,
        };
        let speed = Cause {
            name: "velocity_forward".into(),
            title: String::new(),
            unit: "m/s".into(),
            edges: vec![1.0, 2.0, 3.0],
            values: vec![1.5, 2.5],
            counts: vec![20, 20],
            responses: vec![drag],
        };
        let pushed = step(axes([0.0; 3], 1e-4, 3.4e-4), axes([-0.2, 0.0, 0.0], 0.05, 0.03));
        assert_eq!(sentences(&pushed, &build, &[]).len(), 1);
        assert!(sentences(&pushed, &build, &[speed]).is_empty());
        assert!(heavy[0].contains("2.7 % weaker") && heavy[0].contains("20.4 g heavier"), "{heavy:?}");
    }
}
