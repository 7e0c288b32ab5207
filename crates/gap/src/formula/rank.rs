//! Ranks formulas by how well they describe the disturbances of the windows on blocks of time that their fit has not seen.

use super::grammar::{Acts, Shape, shapes};
use crate::policy::{FORMULA_SAME, FORMULA_SHARE, FORMULA_SHORTER};
use propwash_physics::effects::expression::{Program, SEEN};
use propwash_trace::math::quat;
use propwash_vehicle::expression::parse;
use rayon::prelude::*;

/// One window: what the model lacks in it, and the flight at evenly spaced times.
#[derive(Clone, Debug)]
pub(super) struct Lack {
    pub log: usize,
    /// Force along body axes, N, then torque, N·m.
    pub wrench: [f64; 6],
    /// Attitude in its middle.
    pub quat: [f64; 4],
    /// Values of the variables of expressions at each time.
    pub at: Vec<[f64; SEEN]>,
}

impl Lack {
    /// The part that a formula could be: three numbers along its axes.
    fn part(&self, acts: Acts) -> [f64; 3] {
        let [fx, fy, fz, tx, ty, tz] = self.wrench;
        match acts {
            Acts::ForceBody | Acts::Thrust => [fx, fy, fz],
            Acts::ForceWorld => quat::rotate(self.quat, [fx, fy, fz]),
            Acts::Torque => [tx, ty, tz],
        }
    }
}

/// A formula with values.
#[derive(Clone, Debug)]
pub(super) struct Ranked {
    pub shape: Shape,
    pub coefficient: f64,
    /// Of the second axis, where each has its own.
    pub second: Option<f64>,
    pub scale: Option<f64>,
    /// Evidence of the regression minus its cost, nats.
    pub nats: f64,
    /// Constant that it leaves to others, N or N·m: root of the sum of squares over axes and logs.
    constant: f64,
    /// Its values on all axes and windows.
    column: Vec<f64>,
}

/// Blocks of the cross-validation.
const BLOCKS: usize = 8;
/// Fewest windows for a judgement.
const FEWEST: usize = 5 * BLOCKS;
/// Start values of a scale, as shares of the root mean square of what it divides.
const SCALES: [f64; 5] = [0.07, 0.2, 0.5, 1.1, 2.5];
/// Price of a quantity, a function or a scale, nats: the logarithm of the number of choices.
const PRICE: f64 = 5.0;

/// The best formulas for what is lacking, unlike each other; best first, at most `most`: along axes of the body, or of the world. These
/// are ranked apart. In a flight that hardly turns they are the same but for what the means of windows make of them, and only
/// roll-outs tell them apart.
pub(super) fn rank(lacks: &[Lack], most: usize, world: bool) -> Vec<Ranked> {
    if lacks.len() < FEWEST {
        return Vec::new();
    }
    let mut all = shapes();
    all.retain(|shape| (shape.acts == Acts::ForceWorld) == world);
    let mut ranked: Vec<Ranked> = all.par_iter().filter_map(|shape| fitted(shape, lacks)).collect();
    ranked.sort_by(|a, b| b.nats.total_cmp(&a.nats));
    let mut out: Vec<Ranked> = Vec::new();
    for r in ranked {
        // But for a constant two may say the same, and the one that needs less of it beside it is the likelier: the lift of a ground that
        // fades with the height, where −tanh(height) needs as much lift again at every height.
        match out.iter().position(|o| alike(o, &r)) {
            Some(i) if 2.0 * r.constant < out[i].constant && out[i].nats - r.nats < FORMULA_SHORTER => {
                out[i] = r
            }
            None if out.len() < most => out.push(r),
            _ => {}
        }
    }
    out
}

/// Formulas along one axis in the plane of the rotors as formulas along any direction in it, where something is lacking along the other
/// axis as well: a direction is one thing more to say, not another formula.
pub(super) fn in_the_plane(ranked: &[Ranked], lacks: &[Lack]) -> Vec<Ranked> {
    let mut out: Vec<Ranked> = Vec::new();
    for r in ranked {
        let other: &'static [usize] = match r.shape.axes {
            [0] => &[1],
            [1] => &[0],
            _ => continue,
        };
        let known = |o: &Ranked| o.shape.acts == r.shape.acts && o.shape.words == r.shape.words;
        if r.scale.is_some() || r.shape.acts == Acts::ForceWorld || out.iter().any(known) {
            continue;
        }
        let Some(more) = fitted(&Shape { axes: other, ..r.shape.clone() }, lacks) else { continue };
        let (x, y) = if other == [1] { (r, &more) } else { (&more, r) };
        let texts = [&x.shape.texts[..], &y.shape.texts].concat();
        let turned = y.column.iter().map(|v| v * y.coefficient / x.coefficient);
        out.push(Ranked {
            shape: Shape { axes: &[0, 1], texts, cost: r.shape.cost + 1.0, ..r.shape.clone() },
            coefficient: x.coefficient,
            second: Some(y.coefficient),
            scale: None,
            nats: x.nats + y.nats,
            constant: x.constant.hypot(y.constant),
            column: x.column.iter().copied().chain(turned).collect(),
        });
    }
    out
}

/// What is lacking beside a formula.
pub(super) fn beside(lacks: &[Lack], found: &Ranked) -> Vec<Lack> {
    let mut out = lacks.to_vec();
    let first = if found.shape.acts == Acts::Torque { 3 } else { 0 };
    for (w, lack) in out.iter_mut().enumerate() {
        let said = found.along_body(lacks, w);
        (0..3).for_each(|k| lack.wrench[first + k] -= found.coefficient * said[k]);
    }
    out
}

/// Whether two formulas push alike.
fn alike(a: &Ranked, b: &Ranked) -> bool {
    if a.shape.acts != b.shape.acts || a.shape.axes != b.shape.axes {
        return false;
    }
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(p, q)| p * q).sum::<f64>();
    let (aa, bb) = (dot(&a.column, &a.column), dot(&b.column, &b.column));
    dot(&a.column, &b.column).powi(2) > FORMULA_SAME * aa * bb
}

impl Ranked {
    /// Names of the coefficients of its axes.
    pub fn names(&self) -> [&'static str; 3] {
        if self.second.is_some() { ["c", "d", "d"] } else { ["c"; 3] }
    }

    /// A force along the axes of the rotors as a change of their thrust, of which `usual_n` is usual.
    pub fn as_thrust(&self, usual_n: f64) -> Option<Self> {
        let (shape, by_thrust) = self.shape.as_thrust()?;
        let coefficient = if by_thrust { self.coefficient } else { self.coefficient / usual_n };
        Some(Self { shape, coefficient, ..self.clone() })
    }

    /// What it says of a window without its coefficient; of a force, along axes of the body.
    fn along_body(&self, lacks: &[Lack], window: usize) -> [f64; 3] {
        let mut said = [0.0; 3];
        for (i, axis) in self.shape.axes.iter().enumerate() {
            said[*axis] = self.column[i * lacks.len() + window];
        }
        match self.shape.acts {
            Acts::ForceWorld => quat::rotate_inverse(lacks[window].quat, said),
            Acts::ForceBody | Acts::Thrust | Acts::Torque => said,
        }
    }
}

/// A shape fitted, with the best scale; `None` where it describes too little.
fn fitted(shape: &Shape, lacks: &[Lack]) -> Option<Ranked> {
    let programs: Vec<Program> = shape.texts.iter().map(|t| parse(t, &["s"]).ok()).collect::<Option<_>>()?;
    let (target, lacking) = target(shape, lacks);
    let at = |scale: Option<f64>| {
        let (column, means) = column(&programs, lacks, scale.unwrap_or(1.0))?;
        let (share, coefficient) = unseen_share(&column, &target, lacks)?;
        Some((share, coefficient, scale, column, means))
    };
    let best = match &shape.scaled {
        None => at(None)?,
        Some(of) => {
            let size = size_of(of, lacks)?;
            let mut best =
                SCALES.iter().filter_map(|s| at(Some(s * size))).max_by(|a, b| a.0.total_cmp(&b.0))?;
            // Most formulas describe nothing with any scale.
            if best.0 < 0.5 * FORMULA_SHARE {
                return None;
            }
            // Between the start values, by halving the step.
            let mut step = 1.6;
            while shape.tells_scale && step > 1.02 {
                let here = best.2.unwrap_or(size);
                let near = [here * step, here / step].into_iter().filter_map(|s| at(Some(s)));
                match near.max_by(|a, b| a.0.total_cmp(&b.0)) {
                    Some(better) if better.0 > best.0 => best = better,
                    _ => step = f64::sqrt(step),
                }
            }
            // Beyond the start values it is a straight line, a step, or nothing: others say that with less.
            let within = |s: f64| s > SCALES[0] * size && s < SCALES[SCALES.len() - 1] * size;
            if shape.tells_scale && !best.2.is_some_and(within) {
                return None;
            }
            best
        }
    };
    let (share, coefficient, scale, column, means) = best;
    let n = target.len() as f64;
    let left = lacking.iter().zip(&means).map(|(all, said)| (all - coefficient * said).powi(2));
    let constant = left.sum::<f64>().sqrt();
    let nats = -0.5 * n * (1.0 - share).max(1e-12).ln() - PRICE * shape.cost;
    (share > FORMULA_SHARE && nats > 0.0).then(|| Ranked {
        shape: shape.clone(),
        coefficient,
        second: None,
        scale,
        nats,
        constant,
        column,
    })
}

/// What is lacking along the axes of a shape, (axis, window), without the mean of each log, and the means, (axis, log).
fn target(shape: &Shape, lacks: &[Lack]) -> (Vec<f64>, Vec<f64>) {
    let parts: Vec<[f64; 3]> = lacks.iter().map(|l| l.part(shape.acts)).collect();
    let mut out: Vec<f64> = shape.axes.iter().flat_map(|k| parts.iter().map(move |p| p[*k])).collect();
    let means = without_means(&mut out, lacks);
    (out, means)
}

/// Values of a formula, (axis, window), without the mean of each log, and the means, (axis, log); `None` where one is not finite.
fn column(programs: &[Program], lacks: &[Lack], scale: f64) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut out = Vec::with_capacity(programs.len() * lacks.len());
    for program in programs {
        for lack in lacks {
            let sum: f64 = lack
                .at
                .iter()
                .map(|now| program.eval(|i| now.get(usize::from(i)).copied().unwrap_or(scale)))
                .sum();
            out.push(sum / lack.at.len().max(1) as f64);
        }
    }
    if !out.iter().all(|v| v.is_finite()) {
        return None;
    }
    let means = without_means(&mut out, lacks);
    Some((out, means))
}

/// Takes off the mean of each log, (axis, log), which it returns: a constant in a log is an offset of its own, and no formula.
fn without_means(list: &mut [f64], lacks: &[Lack]) -> Vec<f64> {
    let logs = lacks.iter().map(|l| l.log + 1).max().unwrap_or(0);
    let mut means = Vec::new();
    for axis in list.chunks_mut(lacks.len()) {
        for log in 0..logs {
            let of = || lacks.iter().enumerate().filter(move |(_, l)| l.log == log).map(|(i, _)| i);
            let (mut sum, mut n) = (0.0, 0);
            of().for_each(|i| (sum, n) = (sum + axis[i], n + 1));
            let mean = sum / f64::from(n.max(1));
            of().for_each(|i| axis[i] -= mean);
            means.push(mean);
        }
    }
    means
}

/// Root mean square of what a scale divides.
fn size_of(texts: &[String], lacks: &[Lack]) -> Option<f64> {
    let mut square = 0.0;
    for text in texts {
        let program = parse(text, &[]).ok()?;
        for now in lacks.iter().flat_map(|l| &l.at) {
            square += program.eval(|i| now.get(usize::from(i)).copied().unwrap_or(0.0)).powi(2);
        }
    }
    let n = texts.len() * lacks.iter().map(|l| l.at.len()).sum::<usize>();
    Some((square / n.max(1) as f64).sqrt()).filter(|s| s.is_finite() && *s > 1e-9)
}

/// Share of the target's square that one coefficient explains on blocks of time that its fit has not seen, and the coefficient
/// of all blocks.
fn unseen_share(column: &[f64], target: &[f64], lacks: &[Lack]) -> Option<(f64, f64)> {
    let n = lacks.len();
    let mut sums = [[0.0; 3]; BLOCKS];
    for (i, (x, y)) in column.iter().zip(target).enumerate() {
        let block = &mut sums[(i % n) * BLOCKS / n];
        block[0] += x * x;
        block[1] += x * y;
        block[2] += y * y;
    }
    let all = sums.iter().fold([0.0; 3], |a, b| core::array::from_fn(|k| a[k] + b[k]));
    // What is exactly nothing is described by anything.
    if all[2] <= 1e-24 * target.len() as f64 {
        return None;
    }
    let mut left = 0.0;
    for block in &sums {
        let xx = all[0] - block[0];
        if xx <= 0.0 {
            return None;
        }
        let c = (all[1] - block[1]) / xx;
        left += block[2] - 2.0 * c * block[1] + c * c * block[0];
    }
    let share = 1.0 - left / all[2];
    share.is_finite().then_some((share, all[1] / all[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variable(name: &str) -> usize {
        propwash_physics::effects::expression::VARIABLES.iter().position(|v| v.name == name).unwrap()
    }

    /// A pseudo-random number in [−1, 1).
    fn jumble(i: usize) -> f64 {
        let mut z = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn flight(wrench: impl Fn(&[f64; SEEN], usize) -> [f64; 6]) -> Vec<Lack> {
        let names = ["vx_body", "vy_body", "vz_body", "wx", "wy", "wz", "roll", "pitch", "z"];
        let rates = [0.71, 1.13, 0.43, 1.31, 1.77, 0.93, 0.83, 1.21, 0.33];
        (0..240)
            .map(|i| {
                let mut now = [0.0; SEEN];
                for (name, rate) in names.iter().zip(rates) {
                    now[variable(name)] = 1.5 * (rate * 0.25 * i as f64 + rate).sin();
                }
                now[variable("t")] = 0.25 * i as f64;
                now[variable("rotor_sum")] = 4000.0 + 300.0 * (0.6 * i as f64).sin();
                now[variable("thrust_n")] = 0.3 + 0.05 * (0.6 * i as f64).sin();
                Lack { log: 0, wrench: wrench(&now, i), quat: [0.0, 0.0, 0.0, 1.0], at: vec![now] }
            })
            .collect()
    }

    #[test]
    fn dry_friction_is_found_with_its_scale() {
        let v = ["vx_body", "vy_body"].map(variable);
        let found = rank(
            &flight(|now, i| {
                let push = |k: usize| -0.02 * (now[v[k]] / 0.6).tanh() + 0.002 * jumble(7 * i + k);
                [push(0), push(1), 0.001 * jumble(i), 0.0, 0.0, 0.0]
            }),
            6,
            false,
        );
        let first = &found[0];
        assert_eq!((first.shape.axes, first.shape.words.as_str()), (&[0usize, 1][..], "tanh(v / {s})"));
        assert!((first.coefficient + 0.02).abs() < 5e-4, "{}", first.coefficient);
        assert!((first.scale.unwrap() - 0.6).abs() < 0.06, "{:?}", first.scale);
    }

    #[test]
    fn a_direction_in_the_plane_is_one_formula_with_two_coefficients() {
        let [v, w] = ["vx_body", "wz"].map(variable);
        let lacks = flight(|now, i| {
            let push = |of: f64, k: usize| of * now[v] * now[w] + 2e-4 * jumble(7 * i + k);
            [0.0, 0.0, 0.0, push(3e-4, 0), push(-8e-4, 1), 2e-4 * jumble(i)]
        });
        let found = rank(&lacks, 6, false);
        let plane = in_the_plane(&found, &lacks);
        let both = plane.iter().find(|r| r.shape.words == "v_x ω_z").unwrap();
        assert_eq!(
            (both.shape.acts, both.shape.axes, both.names()),
            (Acts::Torque, &[0, 1][..], ["c", "d", "d"])
        );
        let second = both.second.unwrap();
        assert!((both.coefficient - 3e-4).abs() < 2e-5 && (second + 8e-4).abs() < 2e-5, "{both:?}");
        // What it says of a window is what both axes lack.
        let said = both.along_body(&lacks, 3).map(|s| both.coefficient * s);
        assert!((0..2).all(|k| (said[k] - lacks[3].wrench[3 + k]).abs() < 4e-4), "{said:?}");
        // About one axis alone there is no direction.
        let one = flight(|now, i| [0.0, 0.0, 0.0, 3e-4 * now[v] * now[w] + 1e-4 * jumble(i), 0.0, 0.0]);
        assert!(in_the_plane(&rank(&one, 6, false), &one).is_empty());
    }

    #[test]
    fn a_force_along_axes_of_the_world_is_found_as_such_and_taken_off() {
        let v = ["vx", "vy", "vz"].map(variable);
        // A vehicle that yaws sees it along both of its axes in turn.
        let mut lacks = flight(|_, i| core::array::from_fn(|k| 0.002 * jumble(7 * i + k)));
        for (i, lack) in lacks.iter_mut().enumerate() {
            lack.quat = quat::exp([0.1 * (0.9 * i as f64).sin(), 0.0, 0.31 * i as f64]);
            let vel =
                [(0.21, 1.4), (0.37, 1.2), (0.53, 0.9)].map(|(rate, most)| most * (rate * i as f64).sin());
            (0..3).for_each(|k| lack.at[0][v[k]] = vel[k]);
            let friction = vel.map(|v| 0.02 * (v / 0.3).tanh());
            let along = quat::rotate_inverse(lack.quat, [friction[0], friction[1], 0.0]);
            (0..3).for_each(|k| lack.wrench[k] -= along[k]);
        }
        let first = rank(&lacks, 6, true).remove(0);
        assert_eq!(
            (first.shape.acts, first.shape.axes, first.shape.words.as_str()),
            (Acts::ForceWorld, &[0usize, 1][..], "tanh(v / {s})")
        );
        assert!((first.coefficient + 0.02).abs() < 5e-4, "{}", first.coefficient);
        assert!((first.scale.unwrap() - 0.3).abs() < 0.05, "{:?}", first.scale);
        let left = rank(&beside(&lacks, &first), 6, true);
        assert!(left.is_empty(), "{:?}", left.iter().map(|f| &f.shape.words).collect::<Vec<_>>());
    }

    #[test]
    fn where_nothing_is_regular_no_formula_is_found() {
        let lacks = flight(|_, i| core::array::from_fn(|k| jumble(13 * i + 101 * k)));
        let found = [rank(&lacks, 6, false), rank(&lacks, 6, true)].concat();
        assert!(found.is_empty(), "{:?}", found.iter().map(|f| &f.shape.words).collect::<Vec<_>>());
    }

    #[test]
    fn of_formulas_that_differ_by_a_constant_the_one_without_it_is_found() {
        let z = variable("z");
        // Heights of 2 to 5 m: there −tanh(z / 3 m) falls as exp(−z / 1.9 m) does, but for a constant.
        let mut lacks = flight(|_, i| core::array::from_fn(|k| 0.002 * jumble(5 * i + k)));
        for (i, lack) in lacks.iter_mut().enumerate() {
            let height = 3.5 + lack.at[0][z];
            lack.at[0][z] = height;
            lack.wrench[2] += 2.0 * (-height / 1.9).exp() + 0.002 * jumble(3 * i);
        }
        let first = rank(&lacks, 6, false).remove(0);
        assert_eq!(first.shape.words, "exp(−|z| / {s})");
        assert!((first.coefficient - 2.0).abs() < 0.3, "{} {:?}", first.coefficient, first.scale);
    }

    #[test]
    fn beside_the_first_a_second_is_found() {
        let (v, w, x) = (variable("vz_body"), variable("wz"), variable("vx_body"));
        let lacks = flight(|now, i| {
            let noise = |k: usize| 0.002 * jumble(3 * i + k);
            [
                0.01 * now[x] * now[w] + noise(0),
                noise(1),
                -0.03 * now[v] * now[v].abs() + noise(2),
                0.0,
                0.0,
                0.0,
            ]
        });
        let first = rank(&lacks, 1, false).remove(0);
        let second = rank(&beside(&lacks, &first), 1, false).remove(0);
        let mut axes = [first.shape.axes[0], second.shape.axes[0]];
        axes.sort_unstable();
        assert_eq!(axes, [0, 2], "{} {}", first.shape.words, second.shape.words);
    }
}
