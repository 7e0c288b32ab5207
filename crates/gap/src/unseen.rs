//! Share of the held-out error that candidates remove, by cross-validation over windows.

use super::GapError;
use super::disturbance::{Disturbance, Reduced};
use super::model::Model;
use super::per_log::Information;
use super::search::Evidence;
use super::solve::{Solution, chi2};

/// Windows that are held out together, and number of folds.
const TOGETHER: usize = 4;
const FOLDS: usize = 8;

/// The windows without the prediction of their disturbance from earlier ones: all are independent.
pub(super) fn each_for_itself(solution: &Solution) -> Vec<Reduced> {
    solution.linear.reduce(&Disturbance { kept: [0.0; 4], ..solution.disturbance })
}

/// Share of the excess error that the candidates `of` remove on held-out windows: the error with them, against the error
/// when their parameters go back to nominal and everything else stays. `apart` are the windows from [`each_for_itself`].
pub(super) fn removed_share(
    model: &Model,
    solution: &Solution,
    apart: &[Reduced],
    of: &[usize],
) -> Result<f64, GapError> {
    let fold = |i: usize| (i / TOGETHER) % FOLDS;
    let (mut with, mut without) = (0.0, 0.0);
    for f in 0..FOLDS.min(apart.len() / TOGETHER).max(2) {
        let all = Information::new(model, &solution.linear, apart, |i| fold(i) != f)?;
        let (at, phi) = (&solution.linear.at, solution.dispersion);
        let evidence = Evidence::new(model, &all.h, &all.g, at, phi, solution.tolerance)?;
        let posterior = evidence.posterior(&solution.set)?;
        let delta: Vec<f64> = posterior.mean.iter().zip(at).map(|(m, a)| m - a).collect();
        let kept = all.deltas(&delta);
        // Per-log deviations from the shared values are kept.
        let mut gone = kept.clone();
        for (k, p) in model.parameters.iter().enumerate().filter(|(_, p)| of.contains(&p.candidate)) {
            gone.iter_mut().for_each(|log| log[k] += p.filed - posterior.mean[k]);
        }
        for (deltas, total) in [(&kept, &mut with), (&gone, &mut without)] {
            let unseen = apart.iter().enumerate().filter(|(i, _)| fold(*i) == f);
            *total += unseen.map(|(_, r)| chi2(r, deltas)).sum::<f64>();
        }
    }
    let rows: usize = solution.linear.windows.iter().map(|w| w.n_rows).sum();
    let noise = rows.saturating_sub(12 * solution.linear.windows.len()) as f64;
    let excess = without - noise.min(with);
    Ok(if excess > 0.0 { (without - with) / excess } else { 0.0 })
}
