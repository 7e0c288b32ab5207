//! Evidence of steps: the linearised windows of one log, with columns of their own for what an effect's parameters changed by.
//!
//! Weather that wanders looks like a step now and then, and a step makes the weather seem to wander. Both are compared at their best: the
//! sizes and the persistence of the disturbances are estimated again for every hypothesis, and its evidence counts with them.

use crate::disturbance::{Core, Disturbance, Reduced};
use crate::drift::changes::Part;
use crate::drift::sight::parameter;
use crate::fit::{Cut, EVER_S, Linear, Prepared, Starts, Window, linearise};
use crate::model::Model;
use crate::per_log::Values;
use crate::search::THRESHOLD;
use crate::solve::Solution;
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::Sign;

/// Passes of expectation maximisation for the disturbances.
const PASSES: usize = 6;
/// Least prior variance of a parameter, plausible sizes squared.
const LEAST_PRIOR: f64 = 1e-6;

/// The windows of one log, linearised at what was found.
pub(super) struct Windows<'a> {
    pub linear: Linear,
    /// The windows with quick disturbances as large as in the solution eliminated.
    cores: Vec<Option<Core>>,
    model: &'a Model,
    solution: &'a Solution,
    /// Candidates that differ from the file all the time.
    pub set: Vec<usize>,
}

/// Where windows are linearised.
pub(super) struct Place {
    /// Candidates that differ from the file all the time.
    pub set: Vec<usize>,
    /// Those that act in the model besides the file's: the same, and what changes.
    pub active: Vec<usize>,
    /// Parameter values from a time on, s, in the order of time; where there is none, those of the solution.
    pub pieces: Vec<(f64, Vec<f64>)>,
}

/// What the windows say with some steps.
pub(super) struct Fit {
    pub disturbance: Disturbance,
    /// Log evidence, up to a constant of the log.
    pub evidence: f64,
    /// Of [parameters, from the file's values | steps], and its covariance; in units of the parameters.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Parameter and step of each column behind the parameters.
    columns: Vec<(usize, Part)>,
}

impl Fit {
    /// A parameter with its steps that `take` accepts, over the file's value: estimate and standard deviation.
    pub fn value(&self, k: usize, take: impl Fn(&Part) -> bool) -> (f64, f64) {
        let n = self.mean.len() - self.columns.len();
        let steps = self.columns.iter().enumerate().filter(|(_, (of, step))| *of == k && take(step));
        let chosen: Vec<usize> = core::iter::once(k).chain(steps.map(|(c, _)| n + c)).collect();
        let mean: f64 = chosen.iter().map(|c| self.mean[*c]).sum();
        let variance: f64 =
            chosen.iter().flat_map(|a| chosen.iter().map(|b| self.covariance[(*a, *b)])).sum();
        (mean, variance.max(0.0).sqrt())
    }
}

/// A window with its residual about the values that are `beyond` less than those at which it was linearised.
fn about(window: &Window, beyond: &[f64]) -> Window {
    let n = beyond.len();
    let last = window.gram.nrows() - 1;
    let first = last - n;
    // The residual there is r + J (at − about): a sum of columns.
    let mut sum = DVector::zeros(last + 1);
    beyond.iter().enumerate().for_each(|(k, d)| sum[first + k] = *d);
    sum[last] = 1.0;
    let column = &window.gram * &sum;
    let mut gram = window.gram.clone();
    gram.column_mut(last).copy_from(&column);
    gram.row_mut(last).copy_from(&column.transpose());
    gram[(last, last)] = sum.dot(&column);
    Window { gram, kept: None, ..window.clone() }
}

impl<'a> Windows<'a> {
    /// The windows of a log that has number `index` in the solution, about the solution's values wherever they are linearised.
    pub fn of(
        log: &Prepared,
        model: &'a Model,
        solution: &'a Solution,
        index: usize,
        place: &Place,
    ) -> Option<Self> {
        let pieces = &place.pieces[..];
        let noise = solution.linear.noise.get(index..=index)?;
        let at = solution.values_of(index);
        let linear = |shared: Vec<f64>, begin_s: [f64; 2]| {
            let values = Values { shared, apart: Vec::new() };
            let cut = Cut { begin_s, ..Cut::all(solution.linear.horizon_s) };
            linearise(std::slice::from_ref(log), model, &values, &place.active, cut, &Starts::new(), noise)
        };
        let mut out: Option<Linear> = pieces.is_empty().then(|| linear(at.clone(), EVER_S));
        for (i, (from_s, values)) in pieces.iter().enumerate() {
            let until_s = pieces.get(i + 1).map_or(f64::INFINITY, |next| next.0);
            let piece = linear(values.clone(), [*from_s, until_s]);
            let beyond: Vec<f64> = piece.at.iter().zip(&at).map(|(a, b)| a - b).collect();
            let windows: Vec<Window> = piece.windows.iter().map(|w| about(w, &beyond)).collect();
            match &mut out {
                Some(out) => out.windows.extend(windows),
                None => out = Some(Linear { windows, ..piece }),
            }
        }
        let out = Linear { at, ..out? };
        let cores = out.cores(&solution.disturbance);
        (!out.windows.is_empty()).then(|| Self {
            linear: out,
            cores,
            model,
            solution,
            set: place.set.clone(),
        })
    }

    /// Parameter values of the candidates `active` with the steps that begin at window `from` and before; what differs all the time is at
    /// the file's values where it is not `kept`.
    pub fn values(&self, fit: &Fit, from: usize, active: &[usize], kept: bool) -> Vec<f64> {
        let acts = self.model.effects_of(active);
        let value = |k: usize| {
            let p = &self.model.parameters[k];
            if !acts[p.effect] {
                return p.filed;
            }
            let base = if kept || !self.set.contains(&p.candidate) { 0.0 } else { fit.value(k, |_| false).0 };
            let value = p.filed + fit.value(k, |s| s.from <= from).0 - base;
            self.model.least(k).map_or(value, |least| value.max(least))
        };
        (0..self.model.parameters.len()).map(value).collect()
    }

    /// Disturbances that do not persist, as large as what is new in each window: the least that the logs' scatter allows.
    pub fn fresh(disturbance: &Disturbance) -> Disturbance {
        let new = |s: usize| disturbance.common[s] * (1.0 - disturbance.kept[s].powi(2)).sqrt();
        Disturbance { common: core::array::from_fn(new), kept: [0.0; 4], ..*disturbance }
    }

    /// Prior standard deviation of a parameter about the file's value.
    fn width(&self, k: usize) -> f64 {
        let p = &self.model.parameters[k];
        match self.set.contains(&p.candidate) {
            true => p.slab,
            false => (self.solution.tolerance * p.spike).max(LEAST_PRIOR.sqrt() * p.slab),
        }
    }

    /// Fits with these steps. `Part::effect` is the number of a candidate.
    pub fn fit(&self, steps: &[Part]) -> Option<Fit> {
        let columns = self.columns(steps);
        let known = self.solution.disturbance;
        // From weather that persists, and from one that does not: the estimates settle slowly and may stay near their start. The sizes of
        // quick disturbances are the same.
        let first = self.with(&self.cores, &columns);
        [known, Self::fresh(&known)]
            .into_iter()
            .filter_map(|start| self.settled(&columns, start, &first))
            .max_by(|a, b| a.evidence.total_cmp(&b.evidence))
    }

    /// Fits with these steps and with disturbances of these sizes.
    pub fn once(&self, steps: &[Part], disturbance: Disturbance) -> Option<Fit> {
        let columns = self.columns(steps);
        self.at(&self.with(&self.linear.cores(&disturbance), &columns), &columns, disturbance)
    }

    /// What the windows say, each by itself, with disturbances that are new in each.
    pub fn alone(&self) -> Vec<Reduced> {
        self.linear.reduce_cores(&self.cores, &Self::fresh(&self.solution.disturbance))
    }

    fn columns(&self, steps: &[Part]) -> Vec<(usize, Part)> {
        steps.iter().flat_map(|part| self.model.of(part.effect).map(|k| (k, *part))).collect()
    }

    /// Passes of expectation maximisation; `first` are the cores of the windows at `start`, with the columns of the steps.
    fn settled(&self, columns: &[(usize, Part)], start: Disturbance, first: &[Option<Core>]) -> Option<Fit> {
        let mut now = start;
        let mut best: Option<Fit> = None;
        for pass in 0..PASSES {
            let fit = match pass {
                0 => self.at(first, columns, now)?,
                _ => self.at(&self.with(&self.linear.cores(&now), columns), columns, now)?,
            };
            let deltas = self.deltas(&fit);
            if best.as_ref().is_none_or(|b| fit.evidence > b.evidence) {
                best = Some(fit);
            }
            let next = self.linear.disturbance_of(&now, |i| &deltas[i]);
            if next.near(&now) {
                break;
            }
            now = next;
        }
        best
    }

    /// Estimates from the linearisation point, in every window.
    fn deltas(&self, fit: &Fit) -> Vec<Vec<f64>> {
        let n = self.model.parameters.len();
        let whole: Vec<f64> =
            (0..n).map(|k| fit.mean[k] + self.model.parameters[k].filed - self.linear.at[k]).collect();
        let one = |window: usize| {
            let mut out = whole.clone();
            for (c, (k, part)) in fit.columns.iter().enumerate() {
                out[*k] += part.share(window) * fit.mean[n + c];
            }
            out
        };
        (0..self.linear.windows.len()).map(one).collect()
    }

    /// The cores of the windows with columns for steps.
    fn with(&self, cores: &[Option<Core>], columns: &[(usize, Part)]) -> Vec<Option<Core>> {
        let n = self.model.parameters.len();
        let one = |(i, core): (usize, &Option<Core>)| {
            let steps = columns.iter().map(|(k, part)| (*k, part.share(i)));
            let all: Vec<(usize, f64)> = (0..n).map(|k| (k, 1.0)).chain(steps).collect();
            core.as_ref().map(|core| core.with_columns(&all))
        };
        cores.iter().enumerate().map(one).collect()
    }

    /// Estimates and evidence with disturbances of these sizes.
    fn at(&self, cores: &[Option<Core>], columns: &[(usize, Part)], disturbance: Disturbance) -> Option<Fit> {
        let reduced = self.linear.reduce_cores(cores, &disturbance);
        if reduced.len() != cores.len() {
            return None;
        }
        let n = self.model.parameters.len();
        let all = n + columns.len();
        let (mut h, mut g) = (DMatrix::zeros(all, all), DVector::zeros(all));
        let (mut c, mut occam) = (0.0, 0.0);
        for r in &reduced {
            h += &r.h;
            g += &r.g;
            c += r.c;
            occam += r.occam;
        }
        let width = |i: usize| match i.checked_sub(n) {
            None => self.width(i),
            Some(step) => parameter(self.model, columns[step].0, 0).drift,
        };
        let widths: Vec<f64> = (0..all).map(width).collect();
        // About the file's values, per prior standard deviation.
        let off = DVector::from_fn(all, |i, _| match i < n {
            true => self.model.parameters[i].filed - self.linear.at[i],
            false => 0.0,
        });
        let moved = &h * &off;
        let chi2 = c - 2.0 * g.dot(&off) + off.dot(&moved);
        let phi = self.solution.dispersion;
        let b = DVector::from_fn(all, |i, _| (g[i] - moved[i]) * widths[i] / phi);
        let mut a = DMatrix::from_fn(all, all, |i, j| h[(i, j)] * widths[i] * widths[j] / phi);
        for i in 0..all {
            a[(i, i)] += 1.0;
        }
        let factor = Cholesky::new(a)?;
        let mean = factor.solve(&b);
        let narrower: f64 = factor.l_dirty().diagonal().map(f64::ln).sum();
        let price = THRESHOLD * self.set.len() as f64;
        let evidence = -0.5 * chi2 / phi + 0.5 * b.dot(&mean) - narrower - occam - price;
        let inverse = factor.inverse();
        evidence.is_finite().then(|| Fit {
            disturbance,
            evidence,
            mean: DVector::from_fn(all, |i, _| mean[i] * widths[i]),
            covariance: DMatrix::from_fn(all, all, |i, j| inverse[(i, j)] * widths[i] * widths[j]),
            columns: columns.to_vec(),
        })
    }

    /// Whether an effect has a sign that it can have, before and after its last step: a drag that pushes is none.
    pub fn allowed(&self, fit: &Fit, candidate: usize) -> bool {
        self.model.of(candidate).all(|k| {
            let p = parameter(self.model, k, 0);
            let possible = |take: &dyn Fn(&Part) -> bool| {
                let (off, sigma) = fit.value(k, take);
                f64::from(p.sign) * (p.filed + off - p.absent) >= -2.0 * sigma
            };
            self.model.parameters[k].sign == Sign::Any
                || (possible(&|_| true) && possible(&|step| step.from == 0))
        })
    }
}
