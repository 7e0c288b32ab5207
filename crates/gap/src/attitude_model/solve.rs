//! Least squares over windows: parameters that all windows share, and nuisance parameters of each window.
//!
//! Levenberg–Marquardt on the shared parameters after the nuisance parameters are eliminated by the Schur complement. The
//! noise of every channel and the spread of the nuisance parameters that act as random disturbances are estimated from the
//! log, alternating with the parameters (expectation–maximisation).

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Most channels.
pub(super) const CHANNELS: usize = 9;

/// Callback for one row: channel, residual, its derivatives by the `G` shared and the `L` nuisance parameters.
pub(super) type Push<'a, const G: usize, const L: usize> = dyn FnMut(usize, f64, &[f64; G], &[f64; L]) + 'a;

/// A problem with `G` shared parameters and, per window, `L` nuisance parameters.
pub(super) trait Windows<const G: usize, const L: usize>: Sync {
    /// Emits all rows of one window.
    fn rows(&self, window: usize, shared: &[f64; G], own: &[f64; L], push: &mut Push<G, L>);
}

/// Unweighted sums of one channel in one window.
#[derive(Clone)]
struct Part<const G: usize, const L: usize> {
    gg: SMatrix<f64, G, G>,
    gl: SMatrix<f64, G, L>,
    ll: SMatrix<f64, L, L>,
    g: SVector<f64, G>,
    l: SVector<f64, L>,
    square: f64,
    count: usize,
}

impl<const G: usize, const L: usize> Part<G, L> {
    fn zero() -> Self {
        Self {
            gg: SMatrix::zeros(),
            gl: SMatrix::zeros(),
            ll: SMatrix::zeros(),
            g: SVector::zeros(),
            l: SVector::zeros(),
            square: 0.0,
            count: 0,
        }
    }

    fn add(&mut self, other: &Self, weight: f64) {
        self.gg += other.gg * weight;
        self.gl += other.gl * weight;
        self.ll += other.ll * weight;
        self.g += other.g * weight;
        self.l += other.l * weight;
        self.square += other.square * weight;
        self.count += other.count;
    }
}

/// The sums of one window by channel; channels without samples are `None`.
type Sums<const G: usize, const L: usize> = Vec<Option<Box<Part<G, L>>>>;

/// The state of a fit.
#[derive(Clone)]
pub(super) struct Fit<const G: usize, const L: usize> {
    /// Shared parameters.
    pub shared: [f64; G],
    /// Which of them are fitted.
    pub free: [bool; G],
    /// Nuisance parameters of each window.
    pub own: Vec<[f64; L]>,
    /// Prior standard deviation of the nuisance parameters about zero; infinite for a flat prior.
    pub own_sigma: [f64; L],
    /// Noise of each channel.
    pub sigma: [f64; CHANNELS],
    /// Lower bound on the noise of a channel.
    pub sigma_floor: [f64; CHANNELS],
    /// Windows used in the fit.
    pub used: Vec<bool>,
    /// Covariance of the shared parameters, zero where not fitted.
    pub covariance: SMatrix<f64, G, G>,
    /// Root mean square of the residuals per channel, zero where there are none.
    pub rms: [f64; CHANNELS],
    /// Samples per channel.
    pub counts: [usize; CHANNELS],
    /// Mean square residual of each window in units of the noise (reduced chi-square).
    pub window_misfit: Vec<f64>,
    /// Whether the last round converged.
    pub converged: bool,
    /// Whether the coarse fit, to a third of the windows, is done.
    coarse_done: bool,
}

impl<const G: usize, const L: usize> Fit<G, L> {
    /// A fit starting at `shared` and `own`.
    pub fn new(shared: [f64; G], free: [bool; G], own: Vec<[f64; L]>, own_sigma: [f64; L]) -> Self {
        let n = own.len();
        Self {
            shared,
            free,
            own,
            own_sigma,
            sigma: [1e-3; CHANNELS],
            sigma_floor: [1e-6; CHANNELS],
            used: vec![true; n],
            covariance: SMatrix::zeros(),
            rms: [0.0; CHANNELS],
            counts: [0; CHANNELS],
            window_misfit: vec![0.0; n],
            converged: false,
            coarse_done: false,
        }
    }

    fn sums(&self, problem: &impl Windows<G, L>, shared: &[f64; G], own: &[[f64; L]]) -> Vec<Sums<G, L>> {
        (0..own.len())
            .into_par_iter()
            .map(|w| {
                let mut sums: Sums<G, L> = vec![None; CHANNELS];
                if !self.used[w] {
                    return sums;
                }
                problem.rows(
                    w,
                    shared,
                    &own[w],
                    &mut |channel: usize, r: f64, jg: &[f64; G], jl: &[f64; L]| {
                        let s = sums[channel].get_or_insert_with(|| Box::new(Part::zero()));
                        let (jg, jl) = (SVector::<f64, G>::from(*jg), SVector::<f64, L>::from(*jl));
                        s.gg.ger(1.0, &jg, &jg, 1.0);
                        s.gl.ger(1.0, &jg, &jl, 1.0);
                        s.ll.ger(1.0, &jl, &jl, 1.0);
                        s.g.axpy(r, &jg, 1.0);
                        s.l.axpy(r, &jl, 1.0);
                        s.square += r * r;
                        s.count += 1;
                    },
                );
                sums
            })
            .collect()
    }

    /// The sums of every window under the current weights, priors of the nuisance parameters included.
    fn weighted(&self, sums: &[Sums<G, L>], own: &[[f64; L]]) -> Vec<Part<G, L>> {
        sums.iter()
            .zip(own)
            .enumerate()
            .map(|(w, (sums, own))| {
                let mut out = Part::zero();
                if !self.used[w] {
                    return out;
                }
                for (part, sigma) in sums.iter().zip(&self.sigma) {
                    if let Some(part) = part {
                        out.add(part, sigma.powi(-2));
                    }
                }
                for k in 0..L {
                    let precision = self.own_sigma[k].powi(-2);
                    out.ll[(k, k)] += precision;
                    out.l[k] += precision * own[k];
                    out.square += precision * own[k].powi(2);
                }
                out
            })
            .collect()
    }

    /// Minimises in at most `rounds` iterations; noise and spreads are updated after each. `limit` shortens a step (from,
    /// step) to a share of it.
    pub fn run(
        &mut self,
        problem: &impl Windows<G, L>,
        rounds: usize,
        limit: impl Fn(&[f64; G], &SVector<f64, G>) -> f64,
    ) {
        // A third of the windows gets close at a third of the cost; the full fit then starts with its weights.
        let all = self.used.clone();
        if all.iter().filter(|u| **u).count() >= 24 && !self.coarse_done {
            self.used.iter_mut().enumerate().for_each(|(w, used)| *used &= w % 3 == 0);
            self.iterate(problem, rounds, &limit, true);
            self.used = all;
        }
        let fresh = !self.coarse_done && self.used.iter().filter(|u| **u).count() < 24;
        self.coarse_done = true;
        let sums = self.iterate(problem, rounds, &limit, fresh);
        self.finish(&sums);
    }

    fn iterate(
        &mut self,
        problem: &impl Windows<G, L>,
        rounds: usize,
        limit: &impl Fn(&[f64; G], &SVector<f64, G>) -> f64,
        fresh: bool,
    ) -> Vec<Sums<G, L>> {
        let mut sums = self.sums(problem, &self.shared, &self.own);
        let mut damping = 1e-9;
        let mut steps = 0;
        self.converged = false;
        if fresh {
            self.reweight(&sums, false);
        }
        while steps < rounds {
            let parts = self.weighted(&sums, &self.own);
            let Some((step, own_steps, sigmas)) = self.step(&parts, damping) else {
                damping = (damping * 100.0).max(1e-6);
                steps += 1;
                continue;
            };
            let share = limit(&self.shared, &step);
            let shared: [f64; G] = std::array::from_fn(|k| self.shared[k] + share * step[k]);
            let own: Vec<[f64; L]> = self
                .own
                .iter()
                .zip(&own_steps)
                .map(|(own, step)| std::array::from_fn(|k| own[k] + share * step[k]))
                .collect();
            let tried = self.sums(problem, &shared, &own);
            let before: f64 = parts.iter().map(|p| p.square).sum();
            let after: f64 = self.weighted(&tried, &own).iter().map(|p| p.square).sum();
            steps += 1;
            let small = share == 1.0
                && steps >= 2
                && (0..G)
                    .filter(|k| self.free[*k])
                    .all(|k| step[k].abs() <= (5e-4 * self.shared[k].abs()).max(0.1 * sigmas[k]));
            if after <= before {
                (self.shared, self.own, sums) = (shared, own, tried);
                damping = (damping * 0.1).max(1e-12);
                self.reweight(&sums, true);
                self.converged = small;
            } else {
                damping = (damping * 30.0).max(1e-4);
                // Only rounding error is left to gain.
                self.converged = small || after - before <= 1e-9 * before;
            }
            if self.converged {
                break;
            }
        }
        sums
    }

    /// The reduced system: its matrix, its gradient, and per window the inverse of the eliminated block.
    #[allow(clippy::type_complexity)]
    fn eliminated(
        &self,
        parts: &[Part<G, L>],
    ) -> Option<(SMatrix<f64, G, G>, SVector<f64, G>, Vec<SMatrix<f64, L, L>>)> {
        let mut matrix = SMatrix::<f64, G, G>::zeros();
        let mut gradient = SVector::<f64, G>::zeros();
        let mut inverses = Vec::with_capacity(parts.len());
        for (w, s) in parts.iter().enumerate() {
            if !self.used[w] {
                inverses.push(SMatrix::zeros());
                continue;
            }
            let inverse = invert(&s.ll)?;
            let back = s.gl * inverse;
            matrix += s.gg - back * s.gl.transpose();
            gradient += s.g - back * s.l;
            inverses.push(inverse);
        }
        for k in (0..G).filter(|k| !self.free[*k]) {
            matrix.row_mut(k).fill(0.0);
            matrix.column_mut(k).fill(0.0);
            matrix[(k, k)] = 1.0;
            gradient[k] = 0.0;
        }
        Some((matrix, gradient, inverses))
    }

    /// A step of the shared and of the nuisance parameters, and the standard deviations of the shared ones.
    #[allow(clippy::type_complexity)]
    fn step(
        &self,
        parts: &[Part<G, L>],
        damping: f64,
    ) -> Option<(SVector<f64, G>, Vec<SVector<f64, L>>, SVector<f64, G>)> {
        let (mut matrix, gradient, inverses) = self.eliminated(parts)?;
        for k in 0..G {
            matrix[(k, k)] *= 1.0 + damping;
        }
        let covariance = invert(&matrix)?;
        let step = -(covariance * gradient);
        let own = parts
            .iter()
            .zip(&inverses)
            .map(|(s, inverse)| -(inverse * (s.l + s.gl.transpose() * step)))
            .collect();
        Some((step, own, covariance.diagonal().map(|v| v.max(0.0).sqrt())))
    }

    /// Updates the noise of the channels from the residuals, and with `spreads` the spreads of the nuisance parameters.
    fn reweight(&mut self, sums: &[Sums<G, L>], spreads: bool) {
        let mut square = [0.0; CHANNELS];
        self.counts = [0; CHANNELS];
        for (c, part) in sums.iter().flat_map(|s| s.iter().enumerate()) {
            if let Some(part) = part {
                square[c] += part.square;
                self.counts[c] += part.count;
            }
        }
        let n: usize = self.counts.iter().sum();
        let windows = self.used.iter().filter(|u| **u).count();
        let unknowns = self.free.iter().filter(|f| **f).count() + windows * L;
        let correction = (n as f64 / n.saturating_sub(unknowns).max(1) as f64).min(2.0);
        for c in (0..CHANNELS).filter(|c| self.counts[*c] > 0) {
            self.rms[c] = (square[c] / self.counts[c] as f64).sqrt();
            self.sigma[c] = (correction * square[c] / self.counts[c] as f64).sqrt().max(self.sigma_floor[c]);
        }
        if !spreads {
            return;
        }
        for _ in 0..4 {
            let parts = self.weighted(sums, &self.own);
            let mut spread = [0.0; L];
            for (w, s) in parts.iter().enumerate().filter(|(w, _)| self.used[*w]) {
                let Some(inverse) = invert(&s.ll) else { return };
                let better = SVector::<f64, L>::from(self.own[w]) - inverse * s.l;
                for k in 0..L {
                    spread[k] += better[k].powi(2) + inverse[(k, k)];
                }
            }
            for (sigma, spread) in self.own_sigma.iter_mut().zip(spread).filter(|(s, _)| s.is_finite()) {
                // A spread that shrinks to zero would freeze the parameter; the floor is far below any effect.
                *sigma = (spread / windows.max(1) as f64).sqrt().max(1e-7);
            }
        }
    }

    /// Covariance: the larger of the one from the weights and the sandwich estimate from the scatter of the windows (White,
    /// "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48(4), 1980; by windows).
    fn finish(&mut self, sums: &[Sums<G, L>]) {
        for (w, s) in sums.iter().enumerate() {
            let parts = || s.iter().zip(&self.sigma).filter_map(|(p, sigma)| p.as_ref().map(|p| (p, sigma)));
            let n: usize = parts().map(|(p, _)| p.count).sum();
            let square: f64 = parts().map(|(p, sigma)| p.square / sigma.powi(2)).sum();
            self.window_misfit[w] = square / n.max(1) as f64;
        }
        let sums = self.weighted(sums, &self.own);
        self.covariance = SMatrix::from_diagonal_element(f64::INFINITY);
        let Some((matrix, _, inverses)) = self.eliminated(&sums) else { return };
        let Some(model) = invert(&matrix) else { return };
        let mut scatter = SMatrix::<f64, G, G>::zeros();
        for (w, s) in sums.iter().enumerate().filter(|(w, _)| self.used[*w]) {
            let mut score = s.g - s.gl * inverses[w] * s.l;
            for k in (0..G).filter(|k| !self.free[*k]) {
                score[k] = 0.0;
            }
            scatter += score * score.transpose();
        }
        let windows = self.used.iter().filter(|u| **u).count() as f64;
        let fitted = self.free.iter().filter(|f| **f).count() as f64;
        scatter *= windows / (windows - fitted).max(1.0);
        let robust = model * scatter * model;
        let mut out = model;
        let scale: [f64; G] = std::array::from_fn(|k| (robust[(k, k)] / model[(k, k)]).max(1.0).sqrt());
        for i in 0..G {
            for j in 0..G {
                out[(i, j)] *= scale[i] * scale[j];
            }
        }
        for k in (0..G).filter(|k| !self.free[*k]) {
            out.row_mut(k).fill(0.0);
            out.column_mut(k).fill(0.0);
        }
        self.covariance = out;
    }

    /// Standard deviation of a shared parameter; zero where it is held.
    pub fn sigma_of(&self, k: usize) -> f64 {
        self.covariance[(k, k)].max(0.0).sqrt()
    }

    /// Correlation of two shared parameters, 0 where one is held.
    pub fn correlation(&self, i: usize, j: usize) -> f64 {
        let scale = self.sigma_of(i) * self.sigma_of(j);
        if scale > 0.0 && scale.is_finite() { self.covariance[(i, j)] / scale } else { 0.0 }
    }
}

/// Inverse of a symmetric positive definite matrix, scaled to a unit diagonal first; `None` if it is not positive definite.
fn invert<const N: usize>(m: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let mut scale = SVector::<f64, N>::zeros();
    for k in 0..N {
        let d = m[(k, k)];
        if !d.is_finite() || d < 0.0 {
            return None;
        }
        scale[k] = if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 };
    }
    let mut unit = *m;
    for i in 0..N {
        for j in 0..N {
            unit[(i, j)] *= scale[i] * scale[j];
        }
        // Ridge relative to a unit diagonal, below what double precision of the sums resolves.
        unit[(i, i)] += 1e-13;
    }
    let cholesky = nalgebra::linalg::Cholesky::new(unit)?;
    let mut inverse = cholesky.inverse();
    for i in 0..N {
        for j in 0..N {
            inverse[(i, j)] *= scale[i] * scale[j];
        }
    }
    Some(inverse)
}
