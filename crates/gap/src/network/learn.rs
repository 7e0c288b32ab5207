//! Fits small networks to what windows say of further pushes: most likely weights by Levenberg and Marquardt (Marquardt, J. SIAM 11(2),
//! 1963) with a Gaussian prior on every weight (MacKay, "A practical Bayesian framework for backpropagation networks", Neural Computation
//! 4(3), 1992). Inputs, axes and width are chosen on blocks of time that a fit has not seen.

use crate::policy::{FORMULA_NATS, FORMULA_SHORTER, NETWORK_SIGMAS};
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::network::{Layer, MAX_WEIGHTS, Mlp, Scaling};
use propwash_rollout::random::{Key, purpose};
use rayon::prelude::*;

/// One window: what it says of further pushes, and what a network may read in its intervals.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub log: usize,
    /// Information about the pushes: forces along body axes, N, and torques, N·m; order (interval, component).
    pub information: DMatrix<f64>,
    /// The same times the likeliest pushes.
    pub score: DVector<f64>,
    /// Values of the inputs, shape (interval, input).
    pub at: Vec<Vec<f64>>,
    /// Mean of what is lacking, as if it were known from this window alone.
    pub lack: [f64; 6],
}

/// A network that describes the samples.
#[derive(Clone, Debug)]
pub(super) struct Learnt {
    /// Columns of [`Sample::at`] that enter.
    pub columns: Vec<usize>,
    /// Components of the pushes that it describes.
    pub acts_on: Vec<usize>,
    pub mlp: Mlp,
    /// Share of the square of what is lacking along those components, on average over a window, that it describes on blocks that its fit
    /// has not seen.
    pub share: f64,
}

/// Blocks of the cross-validation.
const BLOCKS: usize = 6;
/// Windows of a stretch that is left out as a whole: weather lasts about a second.
const STRETCH: usize = 8;
/// Fewest windows for a network.
const FEWEST: usize = 60;
/// Hidden units of the networks by which inputs and axes are chosen.
const FIRST: &[usize] = &[8];
/// Hidden layers that are tried, simplest first.
const WIDTHS: [&[usize]; 5] = [&[3], &[8], &[12], &[20], &[10, 10]];
/// Starts of the fits that are checked.
const CHECK_STARTS: u64 = 2;
/// Starts of the last fit.
const STARTS: u64 = 4;
/// Most rounds of a fit that is checked, and nats by which each must bring more.
const CHECKED: (usize, f64) = (30, 0.1);
/// The same of the last fit.
const LAST: (usize, f64) = (100, 0.01);
/// Standard deviations of an input within which units begin to turn.
const RANGE: f64 = 2.0;
/// Prior standard deviation of the weights and biases of hidden layers, for inputs of unit variance: turns within a third of a
/// standard deviation of an input are allowed, finer ones are dear.
const HIDDEN_PRIOR: f64 = 3.0;
/// Prior standard deviation of the weights of outputs over the root mean square of what is lacking.
const OUTPUT_PRIOR: f64 = 1.0;
/// Prior standard deviation of a log's own offset over the same.
const OFFSET_PRIOR: f64 = 10.0;
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
            let axes: Vec<usize> = (0..group.len()).filter(|k| shows(&checked.by_axis[*k])).collect();
            let nats: f64 = axes.iter().map(|k| checked.by_axis[*k].iter().sum::<f64>()).sum();
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
    let mut best: Option<(&[usize], Checked)> = None;
    let fits = |widths: &&&[usize]| task.n_weights(widths) <= MAX_WEIGHTS.min(task.rows() / 2);
    let widths: Vec<&[usize]> = WIDTHS.iter().filter(fits).copied().collect();
    let tried: Vec<Option<Checked>> = widths.par_iter().map(|w| task.checked(w)).collect();
    for (width, checked) in widths.iter().zip(tried) {
        let Some(checked) = checked else { continue };
        let more = best.as_ref().is_none_or(|(_, least)| checked.nats() > least.nats() + FORMULA_SHORTER);
        if more && shows(&checked.all) {
            best = Some((width, checked));
        }
    }
    let (width, checked) =
        best.ok_or("of no size does one describe all parts of the flight, by more than chance")?;
    let all: Vec<usize> = (0..samples.len()).collect();
    let starts = (0..STARTS).into_par_iter();
    let fitted: Vec<Fit> = starts.filter_map(|start| task.fit(width, &all, (start, None), LAST)).collect();
    let best =
        fitted.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).ok_or("no network stays finite")?;
    Ok(Learnt { mlp: task.in_units(&best), columns, acts_on, share: checked.share })
}

/// Whether gains of nats on unseen blocks are more than chance: enough, and in most blocks.
fn shows(gains: &[f64]) -> bool {
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / n;
    let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    n * mean > FORMULA_NATS && mean > NETWORK_SIGMAS * (variance / n).sqrt()
}

impl Learnt {
    /// Fitted again to other samples of the same flights, from where it is.
    pub fn again(&self, samples: &[Sample]) -> Option<Self> {
        let task = Task::new(samples, &self.columns, &self.acts_on)?;
        let all: Vec<usize> = (0..samples.len()).collect();
        let fit = task.fit(&[], &all, (0, Some(task.scaled(&self.mlp))), LAST)?;
        Some(Self { mlp: task.in_units(&fit), ..self.clone() })
    }

    /// Its pushes in a window, in the order of [`Sample::score`].
    pub fn pushes(&self, sample: &Sample) -> DVector<f64> {
        let mut out = DVector::zeros(6 * sample.at.len());
        for (i, now) in sample.at.iter().enumerate() {
            let given = self.mlp.eval(|k| now[self.columns[k]]);
            for (k, v) in self.acts_on.iter().zip(given) {
                out[6 * i + k] = v;
            }
        }
        out
    }

    /// Their mean over the window, by component.
    pub fn mean(&self, sample: &Sample) -> [f64; 6] {
        let all = self.pushes(sample);
        let n = sample.at.len().max(1);
        core::array::from_fn(|k| (0..n).map(|i| all[6 * i + k]).sum::<f64>() / n as f64)
    }
}

/// Samples with unit scales.
struct Task {
    /// How inputs enter.
    scalings: Vec<Scaling>,
    windows: Vec<Whitened>,
    /// Root mean square of what is lacking, by output.
    size: Vec<f64>,
    logs: usize,
}

/// A window: half of |target − factor · pushes|² is minus its log likelihood, with the pushes over the size, order (interval, output).
struct Whitened {
    log: usize,
    factor: DMatrix<f64>,
    target: DVector<f64>,
    /// Inputs as they are, shape (interval, input).
    x: Vec<Vec<f64>>,
    /// Mean of what is lacking over its size, by output.
    lack: Vec<f64>,
}

/// How networks did on blocks that their fits had not seen, beside an offset of each log.
struct Checked {
    /// Nats by block, with all outputs.
    all: Vec<f64>,
    /// The same with one output alone, by output.
    by_axis: Vec<Vec<f64>>,
    share: f64,
}

impl Checked {
    fn nats(&self) -> f64 {
        self.all.iter().sum()
    }
}

/// A network with an offset of each log.
#[derive(Clone)]
struct Fit {
    /// Half of minus the log posterior, up to a constant.
    cost: f64,
    mlp: Mlp,
    /// Shape (log, output).
    offsets: Vec<f64>,
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
        let logs = samples.iter().map(|s| s.log + 1).max()?;
        let rms = |k: usize| {
            let square = |log: usize| {
                let own: Vec<f64> = samples.iter().filter(|s| s.log == log).map(|s| s.lack[k]).collect();
                let mean = own.iter().sum::<f64>() / own.len().max(1) as f64;
                own.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
            };
            ((0..logs).map(square).sum::<f64>() / samples.len() as f64).sqrt()
        };
        let size: Vec<f64> = acts_on.iter().map(|k| rms(*k)).collect();
        // What is exactly nothing is described by anything.
        if !size.iter().all(|s| *s > 1e-12 && s.is_finite()) {
            return None;
        }
        let of = |s: &Sample| {
            let (n, outputs) = (s.at.len(), acts_on.len());
            let place = |i: usize| (6 * (i / outputs) + acts_on[i % outputs], size[i % outputs]);
            let mut information = DMatrix::from_fn(n * outputs, n * outputs, |r, c| {
                let ((a, x), (b, y)) = (place(r), place(c));
                s.information[(a, b)] * x * y
            });
            // What a window says nothing of has no information, and no definite matrix.
            let least = 1e-9 * information.diagonal().max().max(1e-12);
            (0..n * outputs).for_each(|i| information[(i, i)] += least);
            let score = DVector::from_fn(n * outputs, |i, _| s.score[place(i).0] * place(i).1);
            let lower = Cholesky::new(information)?.unpack();
            let target = lower.solve_lower_triangular(&score)?;
            let x = s.at.iter().map(|now| columns.iter().map(|c| now[*c]).collect()).collect();
            let lack = acts_on.iter().zip(&size).map(|(k, size)| s.lack[*k] / size).collect();
            Some(Whitened { log: s.log, factor: lower.transpose(), target, x, lack })
        };
        let windows: Vec<Whitened> = samples.iter().map(of).collect::<Option<_>>()?;
        Some(Self { scalings, windows, size, logs })
    }

    fn rows(&self) -> usize {
        self.windows.len() * self.size.len()
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
        let mut layer = |to: usize, size: f64, spread: f64| {
            let weight = (0..to).map(|_| {
                let way: Vec<f64> = (0..from).map(|_| stream.normal()).collect();
                let norm = way.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
                way.into_iter().map(|v| size * v / norm).collect()
            });
            let weight = weight.collect();
            let bias = (0..to).map(|_| stream.uniform(-spread, spread)).collect();
            from = to;
            Layer { weight, bias }
        };
        // Units that turn evenly over the inputs (Nguyen & Widrow, Proc. IJCNN 1990): RANGE standard deviations around their mean.
        let mut inputs = self.scalings.len();
        let hidden = widths.iter().map(|to| {
            let size = 0.7 * (*to as f64).powf(1.0 / inputs as f64);
            inputs = *to;
            layer(*to, size / RANGE, size)
        });
        let hidden = hidden.collect();
        let output = layer(self.size.len(), 0.1, 0.0);
        Mlp::new(self.scalings.clone(), hidden, output).ok()
    }

    /// The network with outputs in N and N·m, and the mean of the logs' offsets in its biases.
    fn in_units(&self, fit: &Fit) -> Mlp {
        let (outputs, n) = (self.size.len(), self.windows.len().max(1) as f64);
        let mut mean = vec![0.0; outputs];
        for w in &self.windows {
            (0..outputs).for_each(|k| mean[k] += fit.offsets[w.log * outputs + k] / n);
        }
        let mut output = fit.mlp.output().clone();
        for k in 0..outputs {
            output.weight[k].iter_mut().for_each(|w| *w *= self.size[k]);
            output.bias[k] = self.size[k] * (output.bias[k] + mean[k]);
        }
        let mlp = &fit.mlp;
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

    /// Pushes of a network in a window, with its offset.
    fn pushes(&self, mlp: Option<&Mlp>, offsets: &[f64], w: &Whitened) -> DVector<f64> {
        let outputs = self.size.len();
        let mut out = DVector::zeros(w.x.len() * outputs);
        for (i, now) in w.x.iter().enumerate() {
            let given = mlp.map(|mlp| mlp.eval(|k| now[k]));
            for k in 0..outputs {
                out[i * outputs + k] = offsets[w.log * outputs + k] + given.map_or(0.0, |g| g[k]);
            }
        }
        out
    }

    /// The likeliest offsets of the windows `on` without a network.
    fn offsets(&self, on: &[usize]) -> Option<Vec<f64>> {
        let outputs = self.size.len();
        let all = self.logs * outputs;
        let mut h = DMatrix::from_diagonal_element(all, all, OFFSET_PRIOR.powi(-2));
        let mut g = DVector::zeros(all);
        for w in on.iter().map(|w| &self.windows[*w]) {
            let columns = self.of_offsets(w);
            let at = w.log * outputs;
            let mut part = h.view_mut((at, at), (outputs, outputs));
            part += columns.tr_mul(&columns);
            let mut part = g.rows_mut(at, outputs);
            part += columns.tr_mul(&w.target);
        }
        Some(Cholesky::new(h)?.solve(&g).as_slice().to_vec())
    }

    /// Columns of a window's own offset, whitened.
    fn of_offsets(&self, w: &Whitened) -> DMatrix<f64> {
        let outputs = self.size.len();
        let mut out = DMatrix::zeros(w.target.len(), outputs);
        for i in 0..w.target.len() {
            let mut column = out.column_mut(i % outputs);
            column += w.factor.column(i);
        }
        out
    }

    /// What networks of this shape bring on blocks of time that their fit has not seen.
    fn checked(&self, widths: &[usize]) -> Option<Checked> {
        let (n, outputs) = (self.windows.len(), self.size.len());
        // Stretches of a flight in turn: each of its manoeuvres is seen in part.
        let block = |w: usize| w / STRETCH % BLOCKS;
        struct Block {
            all: f64,
            by_axis: Vec<f64>,
            /// Squares of what is lacking on average with the network, and without.
            squares: [f64; 2],
        }
        let one = |b: usize| {
            let seen: Vec<usize> = (0..n).filter(|w| block(*w) != b).collect();
            let tried = (0..CHECK_STARTS).filter_map(|start| self.fit(widths, &seen, (start, None), CHECKED));
            let fit = tried.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
            let without = self.offsets(&seen)?;
            let mut out = Block { all: 0.0, by_axis: vec![0.0; outputs], squares: [0.0; 2] };
            for w in (0..n).filter(|w| block(*w) == b).map(|w| &self.windows[w]) {
                let base = self.pushes(None, &without, w);
                let more = self.pushes(Some(&fit.mlp), &fit.offsets, w) - &base;
                let left = &w.target - &w.factor * &base;
                let gain = |more: &DVector<f64>| {
                    let of = &w.factor * more;
                    of.dot(&left) - 0.5 * of.norm_squared()
                };
                out.all += gain(&more);
                for k in 0..outputs {
                    let own =
                        DVector::from_fn(more.len(), |i, _| if i % outputs == k { more[i] } else { 0.0 });
                    out.by_axis[k] += gain(&own);
                    let mean = |of: &DVector<f64>| {
                        of.iter().skip(k).step_by(outputs).sum::<f64>() / w.x.len() as f64
                    };
                    let lack = w.lack[k] - mean(&base);
                    out.squares[0] += (lack - mean(&more)).powi(2);
                    out.squares[1] += lack.powi(2);
                }
            }
            Some(out)
        };
        let blocks: Vec<Block> = (0..BLOCKS).into_par_iter().map(one).collect::<Option<_>>()?;
        let sum = |i: usize| blocks.iter().map(|b| b.squares[i]).sum::<f64>();
        Some(Checked {
            all: blocks.iter().map(|b| b.all).collect(),
            by_axis: (0..outputs).map(|k| blocks.iter().map(|b| b.by_axis[k]).collect()).collect(),
            share: 1.0 - sum(0) / sum(1).max(1e-300),
        })
    }

    /// Prior precision of every weight, in the order of [`Mlp::weights`], and of the offsets.
    fn precision(&self, mlp: &Mlp) -> DVector<f64> {
        let hidden: usize = mlp.hidden().iter().map(Layer::n_weights).sum();
        let n = mlp.n_weights();
        let of = |i: usize| match i {
            i if i < hidden => HIDDEN_PRIOR,
            i if i < n => OUTPUT_PRIOR,
            _ => OFFSET_PRIOR,
        };
        DVector::from_fn(n + self.logs * self.size.len(), |i, _| of(i).powi(-2))
    }

    /// The weights of most posterior on the windows `on`, beside an offset of each log.
    fn fit(
        &self,
        widths: &[usize],
        on: &[usize],
        (start, from): (u64, Option<Mlp>),
        (rounds, least): (usize, f64),
    ) -> Option<Fit> {
        let mlp = match from {
            Some(mlp) => mlp,
            None => self.drawn(widths, start)?,
        };
        let prior = self.precision(&mlp);
        let n = mlp.n_weights();
        let values = |fit: &Fit| {
            DVector::from_iterator(
                prior.len(),
                fit.mlp.weights().into_iter().chain(fit.offsets.iter().copied()),
            )
        };
        let cost = |fit: &Fit| {
            let one = |w: &usize| {
                let w = &self.windows[*w];
                (&w.target - &w.factor * self.pushes(Some(&fit.mlp), &fit.offsets, w)).norm_squared()
            };
            let all = values(fit);
            0.5 * (on.iter().map(one).sum::<f64>() + all.component_mul(&all).dot(&prior))
        };
        let mut now = Fit { cost: 0.0, offsets: self.offsets(on)?, mlp };
        now.cost = cost(&now);
        let mut damping = 1e-2;
        for _ in 0..rounds {
            let (h, g) = self.normal(&now, on, (&prior, &values(&now)));
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
                let moved = values(&now) + factor.solve(&g);
                let mlp = now.mlp.with_weights(&moved.as_slice()[..n]);
                let mut next = Fit { cost: 0.0, mlp, offsets: moved.as_slice()[n..].to_vec() };
                next.cost = cost(&next);
                if next.cost < now.cost {
                    fell = now.cost - next.cost;
                    now = next;
                    damping = (0.3 * damping).max(1e-6);
                    break;
                }
                damping *= 4.0;
            }
            // So little decides nothing.
            if fell < least {
                break;
            }
        }
        now.cost.is_finite().then_some(now)
    }

    /// Normal equations of one step: JᵀJ with the prior, and the descent direction.
    fn normal(
        &self,
        now: &Fit,
        on: &[usize],
        (prior, values): (&DVector<f64>, &DVector<f64>),
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (p, outputs) = (now.mlp.n_weights(), self.size.len());
        let (mut h, mut g) = (DMatrix::from_diagonal(prior), -values.component_mul(prior));
        for w in on.iter().map(|w| &self.windows[*w]) {
            let mut slopes = DMatrix::zeros(w.target.len(), p);
            for (i, x) in w.x.iter().enumerate() {
                let (_, by) = now.mlp.by_weights(x);
                for (k, row) in by.iter().enumerate().take(outputs) {
                    row.iter().enumerate().for_each(|(c, v)| slopes[(i * outputs + k, c)] = *v);
                }
            }
            let slopes = &w.factor * slopes;
            let own = self.of_offsets(w);
            let left = &w.target - &w.factor * self.pushes(Some(&now.mlp), &now.offsets, w);
            let at = p + w.log * outputs;
            h.view_mut((0, 0), (p, p)).gemm(1.0, &slopes.transpose(), &slopes, 1.0);
            let across = slopes.tr_mul(&own);
            let mut part = h.view_mut((0, at), (p, outputs));
            part += &across;
            let mut part = h.view_mut((at, 0), (outputs, p));
            part += across.transpose();
            let mut part = h.view_mut((at, at), (outputs, outputs));
            part += own.tr_mul(&own);
            let mut part = g.rows_mut(0, p);
            part += slopes.tr_mul(&left);
            let mut part = g.rows_mut(at, outputs);
            part += own.tr_mul(&left);
        }
        (h, g)
    }
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
                let pushes: Vec<f64> =
                    times.iter().flat_map(|t| lack(now(*t)).map(|v| v + noise * stream.normal())).collect();
                let mean = |k: usize| (pushes[k] + pushes[6 + k] + pushes[12 + k]) / 3.0;
                let precision = noise.max(1e-3).powi(-2);
                Sample {
                    log: i * 2 / n,
                    information: DMatrix::from_diagonal_element(18, 18, precision),
                    lack: core::array::from_fn(mean),
                    score: DVector::from_vec(pushes) * precision,
                    at: times.map(|t| now(t).to_vec()).to_vec(),
                }
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
        for s in &mut constant {
            let more = if s.log == 0 { 1.0 } else { -0.5 };
            s.lack[2] += more;
            let pushes = DVector::from_fn(18, |i, _| if i % 6 == 2 { more } else { 0.0 });
            s.score += &s.information * pushes;
        }
        assert!(learn(&constant, &sets(), true).is_err());
        let said = learn(&samples[..20], &sets(), true).unwrap_err();
        assert!(said.contains("too few"), "{said}");
    }
}
