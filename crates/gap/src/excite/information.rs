//! Fisher information of a flight about the parameters, by the fit's own linearisation, and the resulting intervals.
//! With Gaussian priors and a quadratic log likelihood, the inverse of information plus prior precision is the covariance
//! of the estimates (Cramér–Rao; Goodwin & Payne, "Dynamic system identification", 1977, ch. 6).

use super::Air;
use crate::GapError;
use crate::disturbance::Disturbance;
use crate::fit::{Cut, Prepared, Starts, linearise};
use crate::model::Model;
use crate::policy::GIVEN_ATTITUDE_RAD;
use crate::track::{Drive, Noise, Track};
use nalgebra::{Cholesky, DMatrix};

/// Length of windows, s: the longest that the fit uses.
const HORIZON_S: f64 = 0.25;

/// Information of each track about the model's parameters at their nominal values, in units of slabs.
pub(super) fn of_tracks(tracks: &[&Track], model: &Model, air: &Air) -> Vec<DMatrix<f64>> {
    let drone = model.plain_at(&model.filed(), &[]);
    let logs: Vec<Prepared> = tracks.iter().map(|t| Prepared::new(t, &drone)).collect();
    of_logs(&logs, model, air)
}

/// The same for prepared flights.
pub(super) fn of_logs(logs: &[Prepared], model: &Model, air: &Air) -> Vec<DMatrix<f64>> {
    let n = model.parameters.len();
    let noise: Vec<Noise> = logs.iter().map(|l| l.track.noise).collect();
    let linear =
        linearise(logs, model, &model.filed().into(), &[], Cut::all(HORIZON_S), &Starts::new(), &noise);
    let sizes = [air.force_m_s2, air.force_m_s2, air.torque_rad_s2, air.torque_rad_s2];
    let mut disturbance = Disturbance { common: sizes, quick: sizes, ..Disturbance::unknown() };
    if logs.iter().any(|l| l.track.drive == Drive::Thrust) {
        disturbance.attitude_rad = GIVEN_ATTITUDE_RAD;
    }
    let mut out = vec![DMatrix::zeros(n, n); logs.len()];
    for reduced in linear.reduce(&disturbance) {
        out[reduced.log] += reduced.h;
    }
    for h in &mut out {
        for i in 0..n {
            for j in 0..n {
                h[(i, j)] *= model.parameters[i].slab * model.parameters[j].slab;
            }
        }
    }
    out
}

/// Predicted uncertainty of one wanted parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Width {
    /// Standard deviation with all other candidates within their tolerance, in slabs.
    pub closed: f64,
    /// The same with the worst single look-alike free up to its plausible size, in slabs.
    pub opened: f64,
    /// That look-alike, a candidate.
    pub look_alike: Option<usize>,
}

/// Converts information into widths of the wanted parameters.
pub(super) struct Judge<'a> {
    model: &'a Model,
    wanted: Vec<usize>,
    /// The wanted candidates' parameters.
    pub parameters: Vec<usize>,
    /// Prior precision in slabs, with the wanted candidates free.
    precision: Vec<f64>,
}

impl<'a> Judge<'a> {
    pub fn new(model: &'a Model, wanted: &[usize]) -> Self {
        let parameters = wanted.iter().flat_map(|c| model.of(*c)).collect();
        let precision = model
            .parameters
            .iter()
            .map(|p| if wanted.contains(&p.candidate) { 1.0 } else { (p.slab / p.spike).powi(2) })
            .collect();
        Self { model, wanted: wanted.to_vec(), parameters, precision }
    }

    /// The model.
    pub fn model(&self) -> &'a Model {
        self.model
    }

    /// Widths of [`Judge::parameters`] after flights of this information (in slabs).
    pub fn widths(&self, a: &DMatrix<f64>) -> Result<Vec<Width>, GapError> {
        let mut precision = a.clone();
        for (k, p) in self.precision.iter().enumerate() {
            precision[(k, k)] += p;
        }
        let factor = Cholesky::new(precision).ok_or_else(|| GapError::Numbers {
            what: "the predicted intervals",
            reason: "the information of the planned flight is no positive definite matrix".into(),
        })?;
        let cov = factor.inverse();
        let mut out: Vec<Width> = self
            .parameters
            .iter()
            .map(|k| {
                let closed = cov[(*k, *k)].max(0.0).sqrt();
                Width { closed, opened: closed, look_alike: None }
            })
            .collect();
        for c in (0..self.model.candidates.len()).filter(|c| !self.wanted.contains(c)) {
            let free: Vec<usize> = self.model.of(c).collect();
            // Freeing changes the prior precision by 1 − p; K' = K − Kₒ (Δ⁻¹ + Kₒₒ)⁻¹ Kₒᵀ, with a negative definite matrix
            // in brackets.
            let m = free.len();
            let core = DMatrix::from_fn(m, m, |i, j| {
                let change = if i == j { 1.0 / (1.0 - self.precision[free[i]]) } else { 0.0 };
                -(cov[(free[i], free[j])] + change)
            });
            let Some(core) = Cholesky::new(core) else { continue };
            for (width, k) in out.iter_mut().zip(&self.parameters) {
                let row = DMatrix::from_fn(m, 1, |i, _| cov[(*k, free[i])]);
                let more = (row.transpose() * core.solve(&row))[(0, 0)];
                let opened = (cov[(*k, *k)] + more).max(0.0).sqrt();
                if opened > width.opened {
                    width.opened = opened;
                    if opened > 1.05 * width.closed {
                        width.look_alike = Some(c);
                    }
                }
            }
        }
        Ok(out)
    }
}

/// Information about the wanted parameters `w` with the look-alikes `l` marginalised under the given prior precision (1:
/// free up to their plausible size), in slabs.
pub(super) fn apart(a: &DMatrix<f64>, w: &[usize], l: &[usize], precision: &[f64]) -> Option<DMatrix<f64>> {
    let part = |rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |i, j| a[(rows[i], columns[j])])
    };
    let mut own = part(l, l);
    for (i, p) in precision.iter().enumerate() {
        own[(i, i)] += p;
    }
    let across = part(l, w);
    Some(part(w, w) - across.transpose() * Cholesky::new(own)?.solve(&across))
}
