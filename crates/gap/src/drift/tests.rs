//! Drifts in made-up information of logs, where the truth is known to the digit.

use super::changes::{Part, Space};
use super::sight::{FollowedEffect, FollowedParameter, Sight, eliminated, loosened};
use super::*;
use nalgebra::{DMatrix, DVector};
use propwash_physics::effects::Area;
use propwash_rollout::random::{Key, purpose};

/// Two parameters of which a log knows the sum to `sigma` and the difference to ten times as much: thrust and mass, say.
fn sight(values: [f64; 2], sigma: f64) -> Sight {
    let effect = |id: &str| FollowedEffect {
        id: id.into(),
        kind: id.into(),
        title: id.into(),
        area: Area::Drive,
        set: Vec::new(),
        there_or_not: false,
    };
    let parameter = |effect, sign| FollowedParameter {
        effect,
        name: "factor".into(),
        unit: "1".into(),
        filed: 1.0,
        tolerance: 0.01,
        drift: 0.04,
        sign,
        absent: 1.0,
        of: None,
    };
    // Rows (1, 1)/σ and (1, −1)/(10 σ).
    let (along, across) = (sigma.powi(-2), 0.01 * sigma.powi(-2));
    let p = [[along + across, along - across], [along - across, along + across]];
    let off = values.map(|v| v - 1.0);
    Sight {
        dynamics: "first_principles".into(),
        wider: 1.0,
        effects: vec![effect("thrust"), effect("mass")],
        parameters: vec![parameter(0, 0), parameter(1, 0)],
        precision: vec![p[0][0], p[1][0], p[1][1]],
        score: (0..2).map(|i| p[i][0] * off[0] + p[i][1] * off[1]).collect(),
    }
}

/// Sights of logs in which the first parameter is as given, with noise of `sigma`, and all drifts that are proposed on the way.
fn followed(thrust: &[f64], sigma: f64, seed: u64) -> (Vec<(usize, Part)>, Vec<AcceptedParameter>) {
    let mut dice = Key { seed, world: 0, drone: 0, step: 0, purpose: purpose("drift test") }.stream();
    let sights: Vec<Sight> = thrust.iter().map(|t| sight([t + sigma * dice.normal(), 1.0], sigma)).collect();
    let mut parts: Vec<Part> = Vec::new();
    let mut said = Vec::new();
    for k in 1..=sights.len() {
        let space = Space::new(&sights[..k].iter().collect::<Vec<_>>());
        while let Some(proposed) = space.proposed(&parts, &[]).unwrap() {
            parts.push(proposed.part);
            said.push((k - 1, proposed.part));
        }
    }
    let space = Space::new(&sights.iter().collect::<Vec<_>>());
    let accepted = space.parameters(&space.accepted(&parts).unwrap(), &parts);
    (said, accepted)
}

#[test]
fn a_slow_drift_is_found_though_no_log_by_itself_shows_it() {
    // One sigma a log.
    let thrust: Vec<f64> = (0..10).map(|k| 1.0 - 0.005 * f64::from(k)).collect();
    for seed in 0..5 {
        let (said, accepted) = followed(&thrust, 0.005, seed);
        let (log, part) = said[0];
        assert!((3..=8).contains(&log) && part.effect == 0, "{seed}: {said:?}");
        let a = &accepted[0];
        // It is said in portions: what has come since the last may be missing yet.
        assert!(a.changed && (0.945..0.975).contains(&a.value) && a.sigma < 0.012, "{seed}: {a:?}");
        assert!(!accepted[1].changed);
    }
}

#[test]
fn a_step_is_dated_and_its_return_is_found() {
    let thrust = [1.0, 1.0, 1.0, 0.94, 0.94, 0.94, 1.0, 1.0];
    let (said, accepted) = followed(&thrust, 0.005, 1);
    let dates: Vec<(usize, usize)> = said.iter().map(|(log, part)| (*log, part.from)).collect();
    assert_eq!(dates, [(3, 3), (6, 6)]);
    assert!((accepted[0].value - 1.0).abs() < 3.0 * accepted[0].sigma, "{:?}", accepted[0]);
}

#[test]
fn scatter_within_what_logs_know_is_no_drift() {
    for seed in 0..20 {
        let (said, _) = followed(&[1.0; 10], 0.005, seed);
        assert!(said.is_empty(), "{seed}: {said:?}");
    }
}

#[test]
fn the_posterior_after_each_log_is_the_prior_of_the_next() {
    let logs = [sight([0.99, 1.0], 0.005), sight([0.98, 1.01], 0.004)];
    let both = Space::new(&[&logs[0], &logs[1]]);
    let all = both.parameters(&both.accepted(&[]).unwrap(), &[]);
    // By the update of a Kalman filter without motion: P⁺ = (P⁻¹ + A)⁻¹ log by log.
    let (mut p, mut x) = (DMatrix::identity(2, 2) * 1e-4, DVector::zeros(2));
    for log in &logs {
        let t = &log.precision;
        let a = DMatrix::from_row_slice(2, 2, &[t[0], t[1], t[1], t[2]]);
        let score = DVector::from_column_slice(&log.score) - &a * &x;
        p = (p.try_inverse().unwrap() + &a).try_inverse().unwrap();
        x += &p * score;
    }
    for k in 0..2 {
        assert!((all[k].value - 1.0 - x[k]).abs() < 1e-12, "{k}: {} {}", all[k].value, x[k]);
        assert!((all[k].sigma - p[(k, k)].sqrt()).abs() < 1e-12);
    }
}

#[test]
fn a_sight_knows_as_much_as_the_fit_without_what_belongs_to_the_flight() {
    let a = DMatrix::from_row_slice(3, 3, &[9.0, 2.0, 1.0, 2.0, 5.0, 1.5, 1.0, 1.5, 4.0]);
    let b = DVector::from_column_slice(&[1.0, -2.0, 0.5]);
    let (left, score) = eliminated((&a, &b), &[0, 2], &[1], |_| 0.5).unwrap();
    // The same by the whole posterior: its covariance of the two, inverted.
    let mut whole = a.clone();
    whole[(1, 1)] += 2.0;
    let covariance = whole.clone().try_inverse().unwrap();
    let mean = &covariance * &b;
    let pick = |i: usize, j: usize| covariance[([0, 2][i], [0, 2][j])];
    let inverse = DMatrix::from_fn(2, 2, pick).try_inverse().unwrap();
    assert!((&left - inverse).norm() < 1e-12);
    let solved = left.clone().try_inverse().unwrap() * &score;
    assert!((solved[0] - mean[0]).abs() < 1e-12 && (solved[1] - mean[2]).abs() < 1e-12);
    // A deviation of each log widens what it knows and moves nothing.
    let (mut loose, mut pulled) = (left.clone(), score.clone());
    loosened(&mut loose, &mut pulled, &[0.3, 0.2]).unwrap();
    let wider = loose.clone().try_inverse().unwrap() - left.try_inverse().unwrap();
    assert!((wider[(0, 0)] - 0.09).abs() < 1e-12 && (wider[(1, 1)] - 0.04).abs() < 1e-12);
    assert!(wider[(0, 1)].abs() < 1e-12);
    assert!((loose.try_inverse().unwrap() * pulled - solved).norm() < 1e-12);
}

#[test]
fn times_are_told_to_the_minute() {
    assert_eq!(time_utc(1_795_701_729), "2026-11-26 14:02");
}
