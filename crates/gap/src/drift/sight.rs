//! What one log says of a vehicle: the information of its fit about the vehicle's parameters, and what belongs to the flight alone.

use crate::GapError;
use crate::diagnose::Diagnosed;
use crate::disturbance::Reduced;
use crate::model::{Model, Parameter};
use crate::policy::{DIFFERS_KNOWN, DIFFERS_SIGMAS, DRIFT_REPEATS};
use crate::search::Evidence;
use crate::solve::{PART, Solution, difference, score};
use crate::verdict::{Diagnosis, Finding, ParameterFit};
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::{Area, Filed, Sign, nature};
use serde::{Deserialize, Serialize};

/// An effect whose parameters are followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowedEffect {
    /// Candidate id.
    pub id: String,
    /// Effect kind.
    pub kind: String,
    /// In plain words.
    pub title: String,
    /// Where it acts.
    pub area: Area,
    /// Other parameters of the effect that were set before the fit, SI.
    pub set: Vec<(String, f64)>,
    /// Whether it is there or not: no vehicle has a little of it within its tolerances.
    pub there_or_not: bool,
}

/// A parameter of a vehicle that is followed from log to log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowedParameter {
    /// Index of its effect.
    pub effect: usize,
    /// Name within the effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Value of the vehicle file, or the effect's default.
    pub filed: f64,
    /// Standard deviation of the file's value: its sigma where it states one, else the tolerance of a carefully built vehicle.
    pub tolerance: f64,
    /// Prior standard deviation of a drift: the geometric mean of tolerance and plausible size, as between logs of one diagnosis.
    pub drift: f64,
    /// Sign that it can have, from the value at which the effect is absent: −1, 0 for both, 1.
    pub sign: i8,
    /// The value at which the effect is absent.
    pub absent: f64,
    /// For a factor of a mass or a moment of inertia: the file's value, and its unit.
    pub of: Option<(f64, String)>,
}

/// What one log says of a vehicle's parameters p: its log likelihood −½ (p − filed)ᵀ P (p − filed) + sᵀ(p − filed), with everything that is
/// not followed eliminated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sight {
    /// Dynamics of the vehicle that were fitted.
    pub dynamics: String,
    /// Factor by which the vehicle's tolerances are wider than usual, by this log.
    pub wider: f64,
    /// The effects.
    pub effects: Vec<FollowedEffect>,
    /// Their parameters, n of them.
    pub parameters: Vec<FollowedParameter>,
    /// Lower triangle of P, row by row, n (n + 1)/2 numbers, 1/unit².
    pub precision: Vec<f64>,
    /// s, n numbers, 1/unit.
    pub score: Vec<f64>,
}

/// An effect that a log by itself names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeenFinding {
    /// Candidate id.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Parameters with values and standard deviations.
    pub parameters: Vec<ParameterFit>,
    /// Whether nothing else explains the log about as well.
    pub certain: bool,
    /// Evidence that is lost without it, nats.
    pub evidence_nats: f64,
    /// Whether it belongs to the flight, as wind does, and not to the vehicle.
    pub of_the_flight: bool,
}

/// A parameter that belongs to a flight and not to the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OfTheFlight {
    /// Candidate id.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Name within the effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Estimate.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Whether an effect of a kind belongs to the flight or its instruments.
pub(crate) fn of_flight(kind: &str, area: Area) -> bool {
    let nature = nature(kind);
    area == Area::Measurement || nature.differs_between_logs || nature.of_the_flight
}

/// What a verdict names.
pub(super) fn findings(verdict: &Diagnosis) -> Vec<SeenFinding> {
    let one = |f: &Finding| SeenFinding {
        id: f.id.clone(),
        title: f.title.clone(),
        parameters: f.parameters.clone(),
        certain: f.certain,
        evidence_nats: f.evidence_nats,
        of_the_flight: of_flight(&f.kind, f.area),
    };
    verdict.findings.iter().map(one).collect()
}

/// What differs from the file in this flight alone, by more than three standard deviations.
pub(super) fn of_the_flight(diagnosed: &Diagnosed) -> Vec<OfTheFlight> {
    let (model, solution) = (&diagnosed.model, &diagnosed.solution);
    let mut out = Vec::new();
    for (k, p) in model.parameters.iter().enumerate() {
        let candidate = &model.candidates[p.candidate];
        if model.is_shape(p.candidate) || !of_flight(candidate.kind, candidate.area) {
            continue;
        }
        let (value, fitted) = (solution.posterior.mean[k], solution.posterior.sigma[k]);
        let sigma = fitted.hypot(DIFFERS_KNOWN * p.spike);
        if (value - p.filed).abs() > DIFFERS_SIGMAS * sigma {
            out.push(OfTheFlight {
                id: candidate.id.clone(),
                title: candidate.title.clone(),
                name: p.name.clone(),
                unit: p.unit.into(),
                value,
                sigma,
            });
        }
    }
    out
}

impl Sight {
    /// What a diagnosis of one log says.
    ///
    /// # Errors
    /// [`GapError::Numbers`] where its information is not finite.
    pub(super) fn of(diagnosed: &Diagnosed) -> Result<Self, GapError> {
        let (model, solution) = (&diagnosed.model, &diagnosed.solution);
        let evidence = solution.evidence(model)?;
        let raw = evidence.posterior(&solution.set)?.sigma;
        let own =
            Self::new(model, solution, evidence, |k| solution.posterior.sigma[k].powi(2) - raw[k].powi(2))?;
        Ok(Self { dynamics: diagnosed.verdict.dynamics.clone(), ..own })
    }

    /// What one log of a solution says, number `index`.
    ///
    /// # Errors
    /// [`GapError::Numbers`] where its information is not finite.
    pub(crate) fn of_log(model: &Model, solution: &Solution, index: usize) -> Result<Self, GapError> {
        let (evidence, at) = alone(model, solution, index)?;
        let windows: Vec<&Reduced> = solution.reduced.iter().filter(|r| r.log == index).collect();
        let posterior = evidence.posterior(&solution.set)?;
        // Its parts disagree about its own estimates, not about those of all logs.
        let mut deltas = vec![Vec::new(); index + 1];
        deltas[index] = difference(&posterior, &at);
        let sum =
            |part: &[&Reduced]| part.iter().fold(DVector::zeros(at.len()), |sum, r| sum + score(r, &deltas));
        let scores: Vec<DVector<f64>> = windows.chunks(PART).map(sum).collect();
        let scatter = if scores.len() >= 2 { evidence.by_scatter(&solution.set, &scores) } else { None };
        let raw = posterior.sigma;
        Self::new(model, solution, evidence, |k| {
            scatter.as_ref().map_or(0.0, |s| s[k].powi(2) - raw[k].powi(2))
        })
    }

    /// From information about all parameters, and the variance by which parts of the log disagree beyond it.
    fn new(
        model: &Model,
        solution: &Solution,
        evidence: Evidence,
        disagree: impl Fn(usize) -> f64,
    ) -> Result<Self, GapError> {
        let n = model.parameters.len();
        let followed = |k: &usize| {
            let c = model.parameters[*k].candidate;
            !model.is_shape(c) && !of_flight(model.candidates[c].kind, model.candidates[c].area)
        };
        let (own, rest): (Vec<usize>, Vec<usize>) = (0..n).partition(followed);
        let slab = |k: usize| model.parameters[k].slab;
        // Clocks, sensors, wind and battery, with the width that the diagnosis gives them.
        let prior = |k: usize| match solution.set.contains(&model.parameters[k].candidate) {
            true => 1.0,
            false => (solution.tolerance * model.parameters[k].spike / slab(k)).powi(2).min(0.5),
        };
        let (mut a, mut b) = eliminated((&evidence.a, &evidence.b), &own, &rest, prior)?;
        drop(evidence);
        // In one log the vehicle may seem off by what its parts disagree by, and by how well such flights repeat.
        let repeats = |k: usize| {
            let p = &model.parameters[k];
            let scatter = disagree(k).max(0.0).sqrt();
            scatter.hypot(DRIFT_REPEATS * widths(model, p).0) / p.slab
        };
        loosened(&mut a, &mut b, &own.iter().map(|k| repeats(*k)).collect::<Vec<_>>())?;
        let precision = |i: usize, j: usize| a[(i, j)] / (slab(own[i]) * slab(own[j]));
        Ok(Self::about(model, solution.tolerance, &own, precision, |i| b[i] / slab(own[i])))
    }

    /// Information about the parameters `own` of a model, their precision and score by their places in that list, per unit.
    pub(crate) fn about(
        model: &Model,
        wider: f64,
        own: &[usize],
        precision: impl Fn(usize, usize) -> f64,
        score: impl Fn(usize) -> f64,
    ) -> Self {
        let mut effects: Vec<usize> = own.iter().map(|k| model.parameters[*k].candidate).collect();
        effects.dedup();
        let place = |k: usize| effects.iter().position(|c| *c == model.parameters[k].candidate);
        let lower = (0..own.len()).flat_map(|i| (0..=i).map(move |j| (i, j)));
        Self {
            dynamics: String::new(),
            wider,
            effects: effects.iter().map(|c| effect(model, *c)).collect(),
            parameters: own.iter().map(|k| parameter(model, *k, place(*k).unwrap_or(0))).collect(),
            precision: lower.map(|(i, j)| precision(i, j)).collect(),
            score: (0..own.len()).map(score).collect(),
        }
    }
}

pub(crate) fn effect(model: &Model, c: usize) -> FollowedEffect {
    let candidate = &model.candidates[c];
    FollowedEffect {
        id: candidate.id.clone(),
        kind: candidate.kind.into(),
        title: candidate.title.clone(),
        area: candidate.area,
        set: model.preset_values(c),
        there_or_not: candidate.freedoms.iter().all(|f| f.spike <= 0.0)
            && model.of(c).all(|k| !model.listed[model.parameters[k].effect]),
    }
}

/// Tolerance of a carefully built vehicle and prior width of a drift, in the unit of the parameter; a sigma that the file states changes
/// neither: what was weighed may be reloaded.
fn widths(model: &Model, p: &Parameter) -> (f64, f64) {
    let candidate = &model.candidates[p.candidate];
    let freedom = candidate.freedoms.iter().find(|f| f.name == p.name);
    let (spike, slab) = freedom.map_or((p.spike, p.slab), |f| (f.spike, f.slab));
    let alone = spike <= 0.0 || nature(candidate.kind).only_when_found;
    (spike, if alone { slab } else { (spike * slab).sqrt() })
}

pub(crate) fn parameter(model: &Model, k: usize, effect: usize) -> FollowedParameter {
    let p = &model.parameters[k];
    let body = &model.drone.body;
    let of = match p.scales {
        Some(Filed::Mass) => Some((body.mass_kg, "kg".to_string())),
        Some(Filed::Inertia(axis)) => Some((body.inertia_kg_m2[axis][axis], "kg·m²".to_string())),
        _ => None,
    };
    FollowedParameter {
        effect,
        name: p.name.clone(),
        unit: p.unit.into(),
        filed: p.filed,
        tolerance: p.spike,
        drift: widths(model, p).1,
        sign: match p.sign {
            Sign::Any => 0,
            Sign::Up => 1,
            Sign::Down => -1,
        },
        absent: p.filed - p.back * p.slab * if p.sign == Sign::Down { -1.0 } else { 1.0 },
        of,
    }
}

/// What one log of a solution says by itself, number `index`, and the parameters at which it is linearised.
///
/// # Errors
/// [`GapError::Numbers`] where its information is not finite.
pub(crate) fn alone<'m>(
    model: &'m Model,
    solution: &Solution,
    index: usize,
) -> Result<(Evidence<'m>, Vec<f64>), GapError> {
    let n = model.parameters.len();
    let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for r in solution.reduced.iter().filter(|r| r.log == index) {
        h += &r.h;
        g += &r.g;
    }
    let at = solution.linear.values_of(index);
    let evidence = Evidence::new(model, &h, &g, &at, solution.dispersion, solution.tolerance)?;
    Ok((evidence, at))
}

/// What is left of the information `a`, `b` about `own` once `rest`, with these prior variances, is eliminated (Schur complement).
pub(super) fn eliminated(
    (a, b): (&DMatrix<f64>, &DVector<f64>),
    own: &[usize],
    rest: &[usize],
    prior: impl Fn(usize) -> f64,
) -> Result<(DMatrix<f64>, DVector<f64>), GapError> {
    let mut inner = DMatrix::from_fn(rest.len(), rest.len(), |i, j| a[(rest[i], rest[j])]);
    for (i, k) in rest.iter().enumerate() {
        inner[(i, i)] += 1.0 / prior(*k);
    }
    let across = DMatrix::from_fn(rest.len(), own.len(), |i, j| a[(rest[i], own[j])]);
    let factor = Cholesky::new(inner).ok_or_else(not_definite)?;
    let solved = factor.solve(&across);
    let of_rest = DVector::from_fn(rest.len(), |i, _| b[rest[i]]);
    let left = DMatrix::from_fn(own.len(), own.len(), |i, j| a[(own[i], own[j])]) - across.tr_mul(&solved);
    let score = DVector::from_fn(own.len(), |i, _| b[own[i]]) - solved.tr_mul(&of_rest);
    Ok((left, score))
}

/// The information about a value from which that of one log deviates by these standard deviations.
pub(super) fn loosened(a: &mut DMatrix<f64>, b: &mut DVector<f64>, sigmas: &[f64]) -> Result<(), GapError> {
    let mut inner = a.clone();
    for (i, sigma) in sigmas.iter().enumerate() {
        inner[(i, i)] += sigma.max(LEAST_DEVIATION).powi(-2);
    }
    let factor = Cholesky::new(inner).ok_or_else(not_definite)?;
    let (solved, score) = (factor.solve(&*a), factor.solve(&*b));
    let (new_a, new_b) = (&*a - a.tr_mul(&solved), &*b - &*a * score);
    // Rounding must not leave it without symmetry.
    *a = (&new_a + new_a.transpose()) * 0.5;
    *b = new_b;
    Ok(())
}

/// Least deviation of a log, in plausible sizes: one that is not zero keeps the sum above definite.
const LEAST_DEVIATION: f64 = 1e-5;

fn not_definite() -> GapError {
    GapError::Numbers {
        what: "what a log says of the vehicle",
        reason: "its information is no positive definite matrix (numbers that are not finite?)".into(),
    }
}
