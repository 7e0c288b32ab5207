//! Describes the remainder that no listed effect explains by few physical variables: sparse regression of the windows'
//! disturbances.
//!
//! Forward selection from a library of variables; each term is cross-validated on held-out blocks of time (after Brunton,
//! Proctor & Kutz, "Discovering governing equations from data by sparse identification of nonlinear dynamical systems",
//! PNAS 113(15), 2016, with cross-validation instead of a fixed threshold).

use super::policy::FAINT_NATS;
use super::verdict::FreeTerm;

/// One window: its disturbance and the state of flight.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    /// Disturbance: acceleration along body axes, m/s², then angular acceleration, rad/s².
    pub push: [f64; 6],
    /// Variance of each due to sensor noise alone.
    pub variance: [f64; 6],
    /// State of flight at evenly spaced times of the window.
    pub doing: Vec<Doing>,
}

/// State of flight at one time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Doing {
    /// Velocity along body axes, m/s.
    pub vel: [f64; 3],
    /// Body rates, rad/s.
    pub ang_vel: [f64; 3],
    /// Roll and pitch, rad.
    pub tilt: [f64; 2],
    /// Height, m.
    pub height_m: f64,
    /// Mean rotor speed over its mean in the log; 1 where unknown.
    pub rotor: f64,
    /// Time over the length of the log, 0 to 1.
    pub time: f64,
}

/// Blocks of the cross-validation.
const BLOCKS: usize = 8;
/// Least share of the variance that a term must explain on held-out blocks.
const LEAST_SHARE: f64 = 0.1;
/// Most terms per component.
const MOST: usize = 2;

const ON: [&str; 6] = [
    "force along body x",
    "force along body y",
    "force along body z",
    "torque about body x",
    "torque about body y",
    "torque about body z",
];

/// The library: names and means over a window.
fn variables(s: &Sample) -> Vec<(String, f64)> {
    let mut out: Vec<(String, f64)> = Vec::new();
    for d in &s.doing {
        let now = variables_at(d);
        if out.is_empty() {
            out = now;
        } else {
            out.iter_mut().zip(now).for_each(|(sum, (_, v))| sum.1 += v);
        }
    }
    let n = s.doing.len().max(1) as f64;
    out.iter_mut().for_each(|(_, sum)| *sum /= n);
    out
}

fn variables_at(s: &Doing) -> Vec<(String, f64)> {
    let mut out = Vec::new();
    let axes = ["x", "y", "z"];
    let speed = (s.vel[0].powi(2) + s.vel[1].powi(2) + s.vel[2].powi(2)).sqrt();
    for k in 0..3 {
        out.push((format!("v_{}", axes[k]), s.vel[k]));
        out.push((format!("|v| v_{}", axes[k]), speed * s.vel[k]));
        out.push((format!("|v|² v_{}", axes[k]), speed * speed * s.vel[k]));
        out.push((format!("tanh(v_{} / 3 m/s)", axes[k]), (s.vel[k] / 3.0).tanh()));
        out.push((format!("ω_{}", axes[k]), s.ang_vel[k]));
        for j in k..3 {
            out.push((format!("v_{} v_{}", axes[k], axes[j]), s.vel[k] * s.vel[j]));
        }
        for j in 0..3 {
            out.push((format!("v_{} ω_{}", axes[k], axes[j]), s.vel[k] * s.ang_vel[j]));
        }
    }
    out.push(("|v|".into(), speed));
    out.push(("|v|²".into(), speed * speed));
    for (name, angle) in [("roll", s.tilt[0]), ("pitch", s.tilt[1])] {
        out.push((format!("sin({name})"), angle.sin()));
        out.push((format!("sin(2 {name})"), (2.0 * angle).sin()));
        out.push((format!("sin²({name})"), angle.sin().powi(2)));
    }
    out.push(("rotor speed".into(), s.rotor - 1.0));
    out.push(("rotor speed²".into(), s.rotor * s.rotor - 1.0));
    out.push(("1 / height".into(), 1.0 / s.height_m.max(0.05)));
    out.push(("time".into(), s.time - 0.5));
    out
}

/// Terms that describe the remainder, best first; empty where none of it is regular.
pub(crate) fn describe(samples: &[Sample]) -> Vec<FreeTerm> {
    let mut out = Vec::new();
    if samples.len() < 5 * BLOCKS {
        return out;
    }
    let library: Vec<Vec<(String, f64)>> = samples.iter().map(variables).collect();
    for component in 0..6 {
        let y: Vec<f64> = samples.iter().map(|s| s.push[component]).collect();
        let noise = samples.iter().map(|s| s.variance[component]).sum::<f64>() / samples.len() as f64;
        let spread = y.iter().map(|v| v * v).sum::<f64>() / y.len() as f64;
        // Nothing can be described where the sensors' uncertainty is as large as the scatter.
        if spread < 1.5 * noise {
            continue;
        }
        let mut chosen: Vec<usize> = Vec::new();
        let mut share = 0.0;
        for _ in 0..MOST {
            let mut best: Option<(f64, usize)> = None;
            for v in (0..library[0].len()).filter(|v| !chosen.contains(v)) {
                let with: Vec<usize> = chosen.iter().copied().chain([v]).collect();
                let explained = unseen_share(&library, &with, &y);
                if best.is_none_or(|(b, _)| explained > b) {
                    best = Some((explained, v));
                }
            }
            let Some((explained, v)) = best else { break };
            if explained - share < LEAST_SHARE {
                break;
            }
            chosen.push(v);
            let (coefficients, sigmas) = fit(&library, &chosen, &y, |_| true);
            let last = chosen.len() - 1;
            out.push(FreeTerm {
                on: ON[component].into(),
                variable: library[0][v].0.clone(),
                coefficient: coefficients[last],
                sigma: sigmas[last],
                explained_share: explained - share,
            });
            share = explained;
        }
    }
    out.sort_by(|a, b| b.explained_share.total_cmp(&a.explained_share));
    out
}

/// The term on which all windows together agree best, with its size (m/s² or rad/s²): of one variable along one of the
/// `components` or several, each of at least the size `least`, with [`FAINT_NATS`] of evidence. `samples` hold estimates that no
/// expectation draws to zero.
pub(crate) fn in_all_windows(
    samples: &[Sample],
    components: core::ops::Range<usize>,
    least: f64,
) -> Option<(FreeTerm, f64)> {
    if samples.len() < 5 * BLOCKS {
        return None;
    }
    let library: Vec<Vec<(String, f64)>> = samples.iter().map(variables).collect();
    let n = samples.len() as f64;
    // Of each component the variable that describes it best: variable, nats, size, term.
    let of = |component: usize| {
        let y: Vec<f64> = samples.iter().map(|s| s.push[component]).collect();
        let shares = (0..library[0].len()).map(|v| (unseen_share(&library, &[v], &y), v));
        let (share, v) = shares.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (coefficients, sigmas) = fit(&library, &[v], &y, |_| true);
        let spread = (library.iter().map(|l| l[v].1 * l[v].1).sum::<f64>() / n).sqrt();
        let term = FreeTerm {
            on: ON[component].into(),
            variable: library[0][v].0.clone(),
            coefficient: coefficients[0],
            sigma: sigmas[0],
            explained_share: share,
        };
        let nats = -0.5 * n * (1.0 - share).max(1e-12).ln();
        let size = coefficients[0].abs() * spread;
        (nats > 0.0 && size >= least).then_some((v, nats, size, term))
    };
    let found: Vec<_> = components.filter_map(of).collect();
    let together = |v: usize| found.iter().filter(|f| f.0 == v).map(|f| f.1).sum::<f64>();
    let best =
        found.iter().max_by(|a, b| together(a.0).total_cmp(&together(b.0)).then(a.1.total_cmp(&b.1)))?;
    (together(best.0) > FAINT_NATS).then(|| (best.3.clone(), best.2))
}

/// Tests the shape of an effect. `samples` hold what the effect explains plus its residual `left`; it acts along the axes
/// `acts`. An effect of the wrong shape leaves the difference of two shapes: per axis, `left` is described by the term most
/// like the effect plus one other. Returns that other term where it is clearest, and the evidence of the two for `left`,
/// nats. With `drag_too`, linear drag within its tolerance is included.
pub(crate) fn instead(
    samples: &[Sample],
    left: &[[f64; 6]],
    acts: [bool; 3],
    drag_too: bool,
) -> Option<(String, f64)> {
    if samples.len() < 5 * BLOCKS {
        return None;
    }
    let library: Vec<Vec<(String, f64)>> = samples.iter().map(variables).collect();
    let n = samples.len() as f64;
    let (mut most, mut name) = (0.0, None);
    for component in (0..3).filter(|k| acts[*k]) {
        let there: Vec<f64> = samples.iter().map(|s| s.push[component]).collect();
        let rest: Vec<f64> = left.iter().map(|l| l[component]).collect();
        let own: Vec<f64> = there.iter().zip(&rest).map(|(y, l)| y - l).collect();
        let square = |y: &[f64]| y.iter().map(|v| v * v).sum::<f64>();
        if square(&rest) >= EXPLAINED * square(&there) {
            continue;
        }
        let drag =
            library[0].iter().position(|(n, _)| drag_too && Some(n.as_str()) == DRAG.get(component).copied());
        let best = |with: &[usize], y: &[f64]| {
            (0..library[0].len())
                .filter(|v| !with.contains(v))
                .map(|v| (unseen_share(&library, &[with, &[v]].concat(), y), v))
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let mut with: Vec<usize> = drag.into_iter().collect();
        with.push(best(&with, &own)?.1);
        let (share, term) = best(&with, &rest)?;
        let nats = -0.5 * n * (1.0 - share).max(1e-12).ln();
        let size_m_s2 = (share.max(0.0) * square(&rest) / n).sqrt();
        if nats > most && size_m_s2 > LEAST_SHAPE_M_S2 {
            (most, name) = (nats, Some(format!("{} ~ {}", ON[component], library[0][term].0)));
        }
    }
    Some((name?, most))
}

/// Least size of a term that counts as a shape: any constant force leaves less.
const LEAST_SHAPE_M_S2: f64 = 0.01;
/// Largest share of the variance that an effect may leave for its shape to be tested.
const EXPLAINED: f64 = 0.5;
/// The variable of linear drag, by component.
const DRAG: [&str; 3] = ["v_x", "v_y", "v_z"];

/// Share of `y`² that the variables explain on held-out blocks of time.
fn unseen_share(library: &[Vec<(String, f64)>], chosen: &[usize], y: &[f64]) -> f64 {
    let n = y.len();
    let block = |i: usize| i * BLOCKS / n;
    let (mut left, mut all) = (0.0, 0.0);
    for b in 0..BLOCKS {
        let (c, _) = fit(library, chosen, y, |i| block(i) != b);
        for i in (0..n).filter(|i| block(*i) == b) {
            let predicted: f64 = chosen.iter().zip(&c).map(|(v, c)| c * library[i][*v].1).sum();
            left += (y[i] - predicted).powi(2);
            all += y[i] * y[i];
        }
    }
    1.0 - left / all.max(1e-300)
}

/// Least squares without a constant: coefficients and standard deviations.
fn fit(
    library: &[Vec<(String, f64)>],
    chosen: &[usize],
    y: &[f64],
    take: impl Fn(usize) -> bool,
) -> (Vec<f64>, Vec<f64>) {
    let m = chosen.len();
    let (mut a, mut b) = (nalgebra::DMatrix::<f64>::zeros(m, m), nalgebra::DVector::<f64>::zeros(m));
    let mut n = 0usize;
    for i in (0..y.len()).filter(|i| take(*i)) {
        n += 1;
        for p in 0..m {
            let x = library[i][chosen[p]].1;
            b[p] += x * y[i];
            for q in 0..m {
                a[(p, q)] += x * library[i][chosen[q]].1;
            }
        }
    }
    let ridge = 1e-9 * a.trace() + 1e-300;
    for p in 0..m {
        a[(p, p)] += ridge;
    }
    let Some(inverse) = a.clone().try_inverse() else { return (vec![0.0; m], vec![f64::INFINITY; m]) };
    let c = &inverse * &b;
    let left: f64 = (0..y.len())
        .filter(|i| take(*i))
        .map(|i| {
            let predicted: f64 = (0..m).map(|p| c[p] * library[i][chosen[p]].1).sum();
            (y[i] - predicted).powi(2)
        })
        .sum();
    let variance = left / n.saturating_sub(m).max(1) as f64;
    ((0..m).map(|p| c[p]).collect(), (0..m).map(|p| (variance * inverse[(p, p)]).max(0.0).sqrt()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(push: impl Fn(&Doing, usize) -> [f64; 6]) -> Vec<Sample> {
        (0..200)
            .map(|i| {
                let t = i as f64 * 0.25;
                let doing = Doing {
                    vel: [3.0 * (0.7 * t).sin(), 2.0 * (1.1 * t).cos(), (0.4 * t).sin()],
                    ang_vel: [(1.3 * t).sin(), (1.7 * t).cos(), (0.9 * t).sin()],
                    tilt: [0.3 * (0.8 * t).sin(), 0.2 * (1.2 * t).cos()],
                    height_m: 1.5 + 0.5 * (0.3 * t).sin(),
                    rotor: 1.0 + 0.2 * (2.1 * t).sin(),
                    time: i as f64 / 200.0,
                };
                Sample { push: push(&doing, i), variance: [1e-4; 6], doing: vec![doing] }
            })
            .collect()
    }

    /// A pseudo-random number in [−1, 1).
    fn jumble(i: usize) -> f64 {
        ((i * 7919 + 104_729) % 1009) as f64 / 504.5 - 1.0
    }

    #[test]
    fn a_planted_term_is_named_with_its_coefficient() {
        let found = describe(&samples(|s, i| {
            let speed2: f64 = s.vel.iter().map(|v| v * v).sum();
            [-0.05 * speed2 * s.vel[0] + 0.02 * jumble(i), 0.0, 0.0, 0.0, 0.0, 0.4 * s.vel[0] * s.ang_vel[2]]
        }));
        assert_eq!(found.len(), 2, "{found:?}");
        let drag = found.iter().find(|t| t.on == ON[0]).unwrap();
        assert!(drag.variable == "|v|² v_x" && (drag.coefficient + 0.05).abs() < 0.002, "{drag:?}");
        let turn = found.iter().find(|t| t.on == ON[5]).unwrap();
        assert!(turn.variable == "v_x ω_z" && (turn.coefficient - 0.4).abs() < 1e-6, "{turn:?}");
    }

    #[test]
    fn a_term_below_the_noise_of_each_window_shows_in_all_together() {
        // A ninth of the scatter, about two axes: 0.04 rad/s² under noise of 0.09.
        let swing = |of: f64| {
            samples(|s, i| {
                let push = of * s.vel[0] * s.ang_vel[2];
                let noise = |k: usize| 0.16 * jumble(i * 6 + k * 31);
                [0.0, 0.0, 0.0, push + noise(1), push + noise(2), noise(3)]
            })
        };
        let (term, size) = in_all_windows(&swing(0.027), 3..6, 0.03).unwrap();
        assert!(term.on.starts_with("torque about body") && term.variable == "v_x ω_z", "{term:?}");
        assert!((size - 0.04).abs() < 0.01 && (term.coefficient - 0.027).abs() < 0.007, "{size} {term:?}");
        // Nothing where it is not, and nothing of a size that does not matter.
        assert!(in_all_windows(&swing(0.0), 3..6, 0.0).is_none());
        assert!(in_all_windows(&swing(0.027), 3..6, 0.08).is_none());
        assert!(in_all_windows(&swing(0.027), 0..3, 0.01).is_none());
    }

    #[test]
    fn what_has_no_pattern_gets_no_term() {
        let found = describe(&samples(|_, i| core::array::from_fn(|k| jumble(i * 6 + k * 31))));
        assert!(found.is_empty(), "{found:?}");
    }

    #[test]
    fn a_cube_is_told_from_a_square() {
        let cube = samples(|s, i| {
            let speed2: f64 = s.vel.iter().map(|v| v * v).sum();
            [-0.05 * speed2 * s.vel[0] + 0.005 * jumble(i), 0.0, 0.0, 0.0, 0.0, 0.0]
        });
        // Residual of the best quadratic term.
        let square = |s: &Sample| {
            let v = s.doing[0].vel;
            v[0] * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
        };
        let (a, b) =
            cube.iter().fold((0.0, 0.0), |(a, b), s| (a + square(s) * s.push[0], b + square(s) * square(s)));
        let left: Vec<[f64; 6]> =
            cube.iter().map(|s| [s.push[0] - a / b * square(s), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        let (term, nats) = instead(&cube, &left, [true; 3], true).unwrap();
        assert!(term == "force along body x ~ |v|² v_x" && nats > 50.0, "{term} {nats}");
        // An effect of the right shape is not replaced.
        let noise: Vec<[f64; 6]> =
            (0..cube.len()).map(|i| [0.005 * jumble(i), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        assert!(instead(&cube, &noise, [true; 3], true).is_none_or(|(_, nats)| nats < 1.0));
    }
}
