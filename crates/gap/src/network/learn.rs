//! Fits small networks to what windows lack: least squares by Levenberg and Marquardt (Marquardt, J. SIAM 11(2), 1963) with a Gaussian
//! prior on every weight (MacKay, "A practical Bayesian framework for backpropagation networks", Neural Computation 4(3), 1992).
//! Inputs, axes and width are chosen on blocks of time that a fit has not seen.

use crate::policy::{FORMULA_NATS, FORMULA_SHARE, FORMULA_SHORTER, NETWORK_SIGMAS};
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::network::{Layer, MAX_WEIGHTS, Mlp, Scaling};
use propwash_rollout::random::{Key, purpose};
use rayon::prelude::*;

/// One window: what the model lacks in it, and what a network may read at evenly spaced times.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub log: usize,
    /// Force along body axes, N, then torque, N·m.
    pub lack: [f64; 6],
    /// Values of the inputs, shape (time, input).
    pub at: Vec<Vec<f64>>,
}

/// A network that describes the samples.
#[derive(Clone, Debug)]
pub(super) struct Learnt {
    /// Columns of [`Sample::at`] that enter.
    pub columns: Vec<usize>,
    /// Components of [`Sample::lack`] that it describes.
    pub acts_on: Vec<usize>,
    pub mlp: Mlp,
    /// Share of the square of what is lacking along those components that it describes on blocks that its fit has not seen.
    pub share: f64,
    /// Standard deviation of what is left on such blocks, by output, N or N·m.
    noise: Vec<f64>,
}

/// Blocks of the cross-validation.
const BLOCKS: usize = 8;
/// Fewest windows for a network.
const FEWEST: usize = 60;
/// Hidden units of the networks by which inputs and axes are chosen.
const FIRST: &[usize] = &[8];
/// Hidden layers that are tried, simplest first.
const WIDTHS: [&[usize]; 5] = [&[3], &[6], &[12], &[20], &[10, 10]];
/// Starts of the last fit.
const STARTS: u64 = 4;
/// Rounds of one fit.
const ROUNDS: usize = 40;
/// Prior standard deviation of the weights and biases of hidden layers, for inputs of unit variance: turns within a third of a
/// standard deviation of an input are allowed, finer ones are dear.
const HIDDEN_PRIOR: f64 = 3.0;
/// Prior standard deviation of the weights of outputs over the root mean square of what is lacking.
const OUTPUT_PRIOR: f64 = 1.0;
/// Share of the span of an input over which a network fades beyond it.
const MARGIN: f64 = 0.1;

/// The network that describes the samples best on unseen blocks, beside an offset of each log; why there is none otherwise. `sets` are
/// the sets of inputs that are tried, simplest first.
pub(super) fn learn(samples: &[Sample], sets: &[Vec<usize>], torques: bool) -> Result<Learnt, String> {
    if samples.len() < FEWEST {
        return Err(format!("{} windows of flight are too few, {FEWEST} are needed", samples.len()));
    }
    let groups: &[&[usize]] = if torques { &[&[0, 1, 2], &[3, 4, 5]] } else { &[&[0, 1, 2]] };
    let (mut acts_on, mut columns) = (Vec::new(), Vec::new());
    for group in groups {
        let tried: Vec<Option<Checked>> =
            sets.par_iter().map(|set| Task::new(samples, set, group)?.checked(FIRST)).collect();
        let mut best: Option<(f64, Vec<usize>, usize)> = None;
        for (s, checked) in tried.iter().enumerate() {
            let Some(checked) = checked else { continue };
            let axes: Vec<usize> = (0..group.len()).filter(|k| checked.shows(*k)).collect();
            let nats: f64 = axes.iter().map(|k| checked.nats(*k)).sum();
            let dearer = if best.is_some() { FORMULA_SHORTER } else { 0.0 };
            if !axes.is_empty() && best.as_ref().is_none_or(|(least, ..)| nats > least + dearer) {
                best = Some((nats, axes.into_iter().map(|k| group[k]).collect(), s));
            }
        }
        if let Some((_, axes, set)) = best {
            acts_on.extend(axes);
            columns.extend(&sets[set]);
        }
    }
    columns.sort_unstable();
    columns.dedup();
    if acts_on.is_empty() {
        return Err("along no axis does what is left go with the state of flight in all parts of it, by more than chance".into());
    }
    let task = Task::new(samples, &columns, &acts_on).ok_or("the samples do not vary")?;
    let mut best: Option<(f64, &[usize], Checked)> = None;
    let fits = |widths: &&&[usize]| task.n_weights(widths) <= MAX_WEIGHTS.min(task.rows() / 2);
    let widths: Vec<&[usize]> = WIDTHS.iter().filter(fits).copied().collect();
    let tried: Vec<Option<Checked>> = widths.par_iter().map(|w| task.checked(w)).collect();
    for (width, checked) in widths.iter().zip(tried) {
        let Some(checked) = checked else { continue };
        let nats = checked.all_nats();
        let dearer = if best.is_some() { FORMULA_SHORTER } else { 0.0 };
        if best.as_ref().is_none_or(|(least, ..)| nats > least + dearer) {
            best = Some((nats, width, checked));
        }
    }
    let (nats, width, checked) = best.ok_or("no network stays finite")?;
    let share = checked.all_share();
    if nats < FORMULA_NATS || share < FORMULA_SHARE {
        let percent = 100.0 * share.max(0.0);
        return Err(format!(
            "the best one describes {percent:.0} % of what is left on unseen blocks of time"
        ));
    }
    let all: Vec<usize> = (0..samples.len()).collect();
    let starts = (0..STARTS).into_par_iter();
    let fitted: Vec<(f64, Mlp)> =
        starts.filter_map(|start| task.fit(width, &all, &checked.noise(), start, None)).collect();
    let best = fitted.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).ok_or("no network stays finite")?;
    let noise = checked.noise().iter().zip(&task.size).map(|(n, size)| n * size).collect();
    Ok(Learnt { mlp: task.in_units(&best.1), columns, acts_on, share, noise })
}

impl Learnt {
    /// Whether a network of this shape describes other samples too, along one axis at least.
    pub fn shows(&self, samples: &[Sample]) -> bool {
        let widths: Vec<usize> = self.mlp.hidden().iter().map(|l| l.bias.len()).collect();
        let checked = Task::new(samples, &self.columns, &self.acts_on).and_then(|task| task.checked(&widths));
        checked.is_some_and(|c| (0..self.acts_on.len()).any(|k| c.shows(k)))
    }

    /// Fitted again to other samples of the same flights, from where it is.
    pub fn again(&self, samples: &[Sample]) -> Option<Self> {
        let task = Task::new(samples, &self.columns, &self.acts_on)?;
        let all: Vec<usize> = (0..samples.len()).collect();
        let start = task.scaled(&self.mlp);
        let noise: Vec<f64> = self.noise.iter().zip(&task.size).map(|(n, size)| n / size).collect();
        let (_, mlp) = task.fit(&[], &all, &noise, 0, Some(start))?;
        Some(Self { mlp: task.in_units(&mlp), ..self.clone() })
    }

    /// Its mean over a window's times, by component; zero for those on which it does not act.
    pub fn mean(&self, sample: &Sample) -> [f64; 6] {
        let mut out = [0.0; 6];
        for now in &sample.at {
            let given = self.mlp.eval(|i| now[self.columns[i]]);
            for (k, v) in self.acts_on.iter().zip(given) {
                out[*k] += v / sample.at.len().max(1) as f64;
            }
        }
        out
    }
}

/// Samples with unit scales.
struct Task {
    /// How inputs enter.
    scalings: Vec<Scaling>,
    /// Inputs as they are, shape (window, time, input).
    x: Vec<Vec<Vec<f64>>>,
    /// What is lacking over its root mean square, shape (window, output).
    y: Vec<Vec<f64>>,
    /// Root mean square of what is lacking, by output.
    size: Vec<f64>,
    log: Vec<usize>,
}

/// How a network did on blocks that its fit had not seen.
struct Checked {
    /// Squares that are left with it, and without it, over the size; shape (output, block).
    with: Vec<Vec<f64>>,
    without: Vec<Vec<f64>>,
    /// Number of windows.
    n: usize,
}

impl Checked {
    fn share(&self, k: usize) -> f64 {
        1.0 - self.with[k].iter().sum::<f64>() / self.without[k].iter().sum::<f64>().max(1e-300)
    }

    fn nats(&self, k: usize) -> f64 {
        -0.5 * self.n as f64 * (1.0 - self.share(k)).max(1e-12).ln()
    }

    /// Whether component `k` is described by more than chance: a share of it, in nearly every block.
    fn shows(&self, k: usize) -> bool {
        let gains: Vec<f64> = self.with[k].iter().zip(&self.without[k]).map(|(w, o)| o - w).collect();
        let n = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / n;
        let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        self.share(k) > FORMULA_SHARE
            && self.nats(k) > FORMULA_NATS
            && mean > NETWORK_SIGMAS * (variance / n).sqrt()
    }

    fn all_nats(&self) -> f64 {
        (0..self.with.len()).map(|k| self.nats(k)).sum()
    }

    fn all_share(&self) -> f64 {
        let sum = |of: &[Vec<f64>]| of.iter().flatten().sum::<f64>();
        1.0 - sum(&self.with) / sum(&self.without).max(1e-300)
    }

    /// Standard deviation of what is left, over the size, by output.
    fn noise(&self) -> Vec<f64> {
        let of = |left: &Vec<f64>| (left.iter().sum::<f64>() / self.n as f64).sqrt().max(1e-3);
        self.with.iter().map(of).collect()
    }
}

impl Task {
    fn new(samples: &[Sample], columns: &[usize], acts_on: &[usize]) -> Option<Self> {
        let mut scalings = Vec::new();
        for c in columns {
            let all = || samples.iter().flat_map(|s| s.at.iter().map(|now| now[*c]));
            let n = all().count().max(1) as f64;
            let mean = all().sum::<f64>() / n;
            let scale = (all().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
            let (low, high) =
                all().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            // What does not vary says nothing.
            if !(scale > 1e-9 && (high - low).is_finite()) {
                return None;
            }
            scalings.push(Scaling { offset: mean, scale, low, high, margin: MARGIN * (high - low) });
        }
        let log: Vec<usize> = samples.iter().map(|s| s.log).collect();
        let lack: Vec<Vec<f64>> =
            samples.iter().map(|s| acts_on.iter().map(|k| s.lack[*k]).collect()).collect();
        let everyone: Vec<usize> = (0..samples.len()).collect();
        let free = without_offsets(&lack, &log, &everyone);
        let size: Vec<f64> = (0..acts_on.len())
            .map(|k| (free.iter().map(|y| y[k] * y[k]).sum::<f64>() / free.len().max(1) as f64).sqrt())
            .collect();
        // What is exactly nothing is described by anything.
        if !size.iter().all(|s| *s > 1e-12 && s.is_finite()) {
            return None;
        }
        let y = lack.iter().map(|y| y.iter().zip(&size).map(|(y, s)| y / s).collect()).collect();
        let of = |s: &Sample| s.at.iter().map(|now| columns.iter().map(|c| now[*c]).collect()).collect();
        Some(Self { scalings, x: samples.iter().map(of).collect(), y, size, log })
    }

    fn rows(&self) -> usize {
        self.y.len() * self.size.len()
    }

    fn n_weights(&self, widths: &[usize]) -> usize {
        let mut from = self.scalings.len();
        let mut n = 0;
        for to in widths.iter().copied().chain([self.size.len()]) {
            n += (from + 1) * to;
            from = to;
        }
        n
    }

    /// A network with weights drawn at random, those of the outputs small.
    fn drawn(&self, widths: &[usize], start: u64) -> Option<Mlp> {
        let key = Key { seed: start, world: 0, drone: 0, step: 0, purpose: purpose("gap.network") };
        let mut stream = key.stream();
        let mut from = self.scalings.len();
        let mut layer = |to: usize, size: f64| {
            let per = size / (from as f64).sqrt();
            let weight = (0..to).map(|_| (0..from).map(|_| per * stream.normal()).collect()).collect();
            let bias = (0..to).map(|_| size * stream.normal()).collect();
            from = to;
            Layer { weight, bias }
        };
        let hidden = widths.iter().map(|to| layer(*to, 1.0)).collect();
        let mut output = layer(self.size.len(), 0.1);
        output.bias.iter_mut().for_each(|b| *b = 0.0);
        Mlp::new(self.scalings.clone(), hidden, output).ok()
    }

    /// The network with outputs in N and N·m, and the mean of what is lacking in its biases.
    fn in_units(&self, mlp: &Mlp) -> Mlp {
        let n = self.y.len().max(1) as f64;
        let mut mean = vec![0.0; self.size.len()];
        for (y, f) in self.y.iter().zip(self.means(mlp)) {
            for k in 0..mean.len() {
                mean[k] += (y[k] - f[k]) / n;
            }
        }
        let mut output = mlp.output().clone();
        for k in 0..mean.len() {
            output.weight[k].iter_mut().for_each(|w| *w *= self.size[k]);
            output.bias[k] = self.size[k] * (output.bias[k] + mean[k]);
        }
        Mlp::new(mlp.inputs().to_vec(), mlp.hidden().to_vec(), output).unwrap_or_else(|_| mlp.clone())
    }

    /// The same backwards: outputs over the size.
    fn scaled(&self, mlp: &Mlp) -> Mlp {
        let mut output = mlp.output().clone();
        for k in 0..self.size.len() {
            output.weight[k].iter_mut().for_each(|w| *w /= self.size[k]);
            output.bias[k] /= self.size[k];
        }
        Mlp::new(mlp.inputs().to_vec(), mlp.hidden().to_vec(), output).unwrap_or_else(|_| mlp.clone())
    }

    /// Means over the times of every window, shape (window, output).
    fn means(&self, mlp: &Mlp) -> Vec<Vec<f64>> {
        let of = |at: &Vec<Vec<f64>>| {
            let mut out = vec![0.0; self.size.len()];
            for now in at {
                let given = mlp.eval(|i| now[i]);
                out.iter_mut().zip(given).for_each(|(sum, v)| *sum += v / at.len() as f64);
            }
            out
        };
        self.x.iter().map(of).collect()
    }

    /// Standard deviation of what a network leaves of the windows `on`, by output.
    fn left(&self, mlp: &Mlp, on: &[usize]) -> Vec<f64> {
        let f = self.means(mlp);
        let left: Vec<Vec<f64>> = self.y.iter().zip(&f).map(|(y, f)| difference(y, f)).collect();
        let free = without_offsets(&left, &self.log, on);
        (0..self.size.len())
            .map(|k| {
                (free.iter().map(|r| r[k] * r[k]).sum::<f64>() / free.len().max(1) as f64).sqrt().max(1e-3)
            })
            .collect()
    }

    /// Squares that networks of this shape leave on blocks of time that their fit has not seen.
    fn checked(&self, widths: &[usize]) -> Option<Checked> {
        let (n, outputs) = (self.y.len(), self.size.len());
        let block = |w: usize| w * BLOCKS / n;
        let (mut with, mut without) = (vec![vec![0.0; BLOCKS]; outputs], vec![vec![0.0; BLOCKS]; outputs]);
        let folds: Vec<Option<(Vec<f64>, Vec<f64>)>> = (0..BLOCKS)
            .into_par_iter()
            .map(|b| {
                let seen: Vec<usize> = (0..n).filter(|w| block(*w) != b).collect();
                // Half of what is lacking counts as noise at first, then what the fit leaves.
                let (_, mlp) = self.fit(widths, &seen, &vec![0.5; outputs], 0, None)?;
                let noise: Vec<f64> = self.left(&mlp, &seen).iter().map(|s| s.max(0.05)).collect();
                let (_, mlp) = self.fit(widths, &seen, &noise, 0, Some(mlp))?;
                let f = self.means(&mlp);
                let left: Vec<Vec<f64>> = self.y.iter().zip(&f).map(|(y, f)| difference(y, f)).collect();
                let squares = |of: &[Vec<f64>]| {
                    let offsets = offsets(of, &self.log, &seen);
                    let mut out = vec![0.0; outputs];
                    for w in (0..n).filter(|w| block(*w) == b) {
                        for k in 0..outputs {
                            out[k] += (of[w][k] - offsets[self.log[w]][k]).powi(2);
                        }
                    }
                    out
                };
                Some((squares(&left), squares(&self.y)))
            })
            .collect();
        for (b, fold) in folds.into_iter().enumerate() {
            let (left, all) = fold?;
            for k in 0..outputs {
                (with[k][b], without[k][b]) = (left[k], all[k]);
            }
        }
        Some(Checked { with, without, n })
    }

    /// Prior precision of every weight, in the order of [`Mlp::weights`].
    fn precision(&self, mlp: &Mlp) -> DVector<f64> {
        let hidden: usize = mlp.hidden().iter().map(Layer::n_weights).sum();
        DVector::from_fn(mlp.n_weights(), |i, _| {
            (if i < hidden { HIDDEN_PRIOR } else { OUTPUT_PRIOR }).powi(-2)
        })
    }

    /// The weights of most posterior on the windows `on`, beside an offset of each log; `noise` is the standard deviation of each
    /// output over its size. Returns half of minus the log posterior.
    fn fit(
        &self,
        widths: &[usize],
        on: &[usize],
        noise: &[f64],
        start: u64,
        from: Option<Mlp>,
    ) -> Option<(f64, Mlp)> {
        let mut now = match from {
            Some(mlp) => mlp,
            None => self.drawn(widths, start)?,
        };
        let prior = self.precision(&now);
        let cost = |mlp: &Mlp| {
            let f = self.means(mlp);
            let left: Vec<Vec<f64>> = self.y.iter().zip(&f).map(|(y, f)| difference(y, f)).collect();
            let free = without_offsets(&left, &self.log, on);
            let squares: f64 =
                free.iter().flat_map(|r| r.iter().zip(noise)).map(|(r, s)| (r / s).powi(2)).sum();
            let weights = DVector::from_vec(mlp.weights());
            squares + weights.component_mul(&weights).dot(&prior)
        };
        let mut best = cost(&now);
        let mut damping = 1e-2;
        for _ in 0..ROUNDS {
            let (h, g) = self.normal(&now, on, noise, &prior);
            let mut fell = 0.0;
            while damping < 1e8 {
                let mut damped = h.clone();
                for i in 0..damped.nrows() {
                    damped[(i, i)] *= 1.0 + damping;
                }
                let Some(factor) = Cholesky::new(damped) else {
                    damping *= 10.0;
                    continue;
                };
                let moved = DVector::from_vec(now.weights()) + factor.solve(&g);
                let next = now.with_weights(moved.as_slice());
                let value = cost(&next);
                if value < best {
                    fell = best - value;
                    (now, best) = (next, value);
                    damping = (0.3 * damping).max(1e-6);
                    break;
                }
                damping *= 4.0;
            }
            if fell < 1e-3 + 1e-5 * best {
                break;
            }
        }
        (best.is_finite()).then_some((0.5 * best, now))
    }

    /// Normal equations of one step: JᵀJ with the prior, and the descent direction.
    fn normal(
        &self,
        mlp: &Mlp,
        on: &[usize],
        noise: &[f64],
        prior: &DVector<f64>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (p, outputs) = (mlp.n_weights(), self.size.len());
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(on.len());
        for w in on {
            // Slopes of every output by every weight, then the residuals.
            let mut row = vec![0.0; outputs * (p + 1)];
            let share = 1.0 / self.x[*w].len() as f64;
            for now in &self.x[*w] {
                let (out, slopes) = mlp.by_weights(now);
                for k in 0..outputs {
                    for (sum, v) in row[k * (p + 1)..].iter_mut().zip(&slopes[k]) {
                        *sum += share * v;
                    }
                    row[k * (p + 1) + p] -= share * out[k];
                }
            }
            for k in 0..outputs {
                row[k * (p + 1) + p] += self.y[*w][k];
            }
            rows.push(row);
        }
        let logs: Vec<usize> = on.iter().map(|w| self.log[*w]).collect();
        let own: Vec<usize> = (0..rows.len()).collect();
        let free = without_offsets(&rows, &logs, &own);
        let mut all = Vec::with_capacity(free.len() * outputs * (p + 1));
        for row in &free {
            for k in 0..outputs {
                all.extend(row[k * (p + 1)..(k + 1) * (p + 1)].iter().map(|v| v / noise[k]));
            }
        }
        // One column for each row of the Jacobian.
        let jacobian = DMatrix::from_vec(p + 1, free.len() * outputs, all);
        let gram = &jacobian * jacobian.transpose();
        let mut h = gram.view((0, 0), (p, p)).into_owned();
        let weights = DVector::from_vec(mlp.weights());
        let g = gram.view((0, p), (p, 1)).column(0) - weights.component_mul(prior);
        for i in 0..p {
            h[(i, i)] += prior[i];
        }
        (h, g)
    }
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Mean of each log over the windows `on`, shape (log, column); zero for a log without one.
fn offsets(rows: &[Vec<f64>], log: &[usize], on: &[usize]) -> Vec<Vec<f64>> {
    let width = rows.first().map_or(0, Vec::len);
    let logs = log.iter().max().map_or(0, |l| l + 1);
    let (mut sums, mut n) = (vec![vec![0.0; width]; logs], vec![0usize; logs]);
    for w in on {
        n[log[*w]] += 1;
        sums[log[*w]].iter_mut().zip(&rows[*w]).for_each(|(sum, v)| *sum += v);
    }
    for (sum, n) in sums.iter_mut().zip(n) {
        sum.iter_mut().for_each(|v| *v /= n.max(1) as f64);
    }
    sums
}

/// The windows `on` without the mean of each log: a constant in a log is an offset of its own.
fn without_offsets(rows: &[Vec<f64>], log: &[usize], on: &[usize]) -> Vec<Vec<f64>> {
    let means = offsets(rows, log, on);
    on.iter().map(|w| difference(&rows[*w], &means[log[*w]])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows of a flight with `lack` of (velocity along x, y, body rate about z), and noise.
    fn flight(n: usize, lack: impl Fn([f64; 3]) -> [f64; 6], noise: f64) -> Vec<Sample> {
        let key = Key { seed: 5, world: 0, drone: 0, step: 0, purpose: purpose("test.network") };
        let mut stream = key.stream();
        let now = |t: f64| {
            [1.6 * (0.71 * t).sin() + 0.5 * (2.3 * t).sin(), 1.4 * (1.13 * t + 1.0).sin(), (0.93 * t).cos()]
        };
        (0..n)
            .map(|i| {
                let times = [0.04, 0.12, 0.2].map(|dt| 0.25 * i as f64 + dt);
                let mut sum = [0.0; 6];
                for t in times {
                    let part = lack(now(t));
                    (0..6).for_each(|k| sum[k] += part[k] / 3.0);
                }
                let lack = sum.map(|v| v + noise * stream.normal());
                Sample { log: i * 2 / n, lack, at: times.map(|t| now(t).to_vec()).to_vec() }
            })
            .collect()
    }

    fn sets() -> Vec<Vec<usize>> {
        vec![vec![0, 1], vec![2], vec![0, 1, 2]]
    }

    #[test]
    fn bumps_that_no_formula_has_are_learnt_and_nothing_else() {
        let bumps = |x: [f64; 3]| [0.2 * (3.0 * x[0]).sin() * (1.0 + x[1]).cos(), 0.0, 0.0, 0.0, 0.0, 0.0];
        let samples = flight(240, bumps, 0.02);
        let learnt = learn(&samples, &sets(), true).unwrap();
        assert_eq!((learnt.acts_on.as_slice(), learnt.columns.as_slice()), (&[0usize][..], &[0usize, 1][..]));
        assert!(learnt.share > 0.8, "{}", learnt.share);
        // Another flight of the same range, without noise.
        let (mut left, mut all) = (0.0, 0.0);
        for sample in flight(400, bumps, 0.0).iter().skip(250) {
            left += (sample.lack[0] - learnt.mean(sample)[0]).powi(2);
            all += sample.lack[0].powi(2);
        }
        assert!(left < 0.04 * all, "{left} {all}");
        // The same samples give the same bits.
        assert_eq!(learn(&samples, &sets(), true).unwrap().mlp, learnt.mlp);
    }

    #[test]
    fn where_nothing_is_regular_there_is_no_network() {
        let samples = flight(240, |_| [0.0; 6], 0.1);
        let said = learn(&samples, &sets(), true).unwrap_err();
        assert!(said.contains("along no axis"), "{said}");
        // A constant in each log is no network either.
        let mut constant = samples.clone();
        constant.iter_mut().for_each(|s| s.lack[2] += if s.log == 0 { 1.0 } else { -0.5 });
        assert!(learn(&constant, &sets(), true).is_err());
        let said = learn(&samples[..20], &sets(), true).unwrap_err();
        assert!(said.contains("too few"), "{said}");
    }
}
