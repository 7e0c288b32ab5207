//! What a page needs to show a model with effects at other values than the fitted ones, without the model: residuals at the
//! instants, and their change by each effect.
//!
//! A residual r (force or torque that the model lacks) is taken as linear in how far every effect is turned on:
//! r = r₀ + Σ s·D, where s is 0 at the vehicle file's value and 1 at the estimate, and D is the difference of two exact
//! evaluations, at the estimate and at the file's value. One effect alone is exact at both; in between, beyond, and for
//! several together the straight line is checked against exact evaluations ([`LiveEffect::trust`], [`Live::together_off`]).

mod flight;
pub(crate) mod proposals;

use crate::GapError;
use crate::diagnose::Diagnosed;
use crate::ladder::Flights;
use crate::model::Model;
use crate::replay::drone_for;
use crate::track::Track;
pub use flight::Axes;
pub(crate) use flight::{Evaluated, Flight};
pub(crate) use proposals::{Move, Proposal};
use propwash_physics::drone::Drone;
use propwash_vehicle::Vehicle;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// Most samples of all flights together; more are thinned evenly.
const MOST_SAMPLES: usize = 2000;
/// Most numbers of all changes together, which bounds the size of a page.
const MOST_NUMBERS: usize = 80_000;
/// Most points of all paths together.
const MOST_POINTS: usize = 1600;
/// Relative error of a forecast figure up to which it is trusted.
const TRUSTED: f64 = 0.05;
/// Change of a residual relative to its noise below which an effect counts as without influence on it.
const NO_CHANGE: f64 = 0.02;

/// Residuals of a vehicle on flights, and their change by effects.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Live {
    /// The flights.
    pub flights: Vec<LiveFlight>,
    /// Effects that can be turned on: those found first, then what is fitted with them, look-alikes, other candidates.
    pub effects: Vec<LiveEffect>,
    /// Hubs of the rotors, m, body, shape (rotor, 3).
    pub rotors_m: Vec<[f64; 3]>,
    /// Radius of a propeller, m.
    pub rotor_radius_m: f64,
    /// Sums from which root mean squares on the judged flight follow at full resolution: force.
    pub force: Form,
    /// The same of torque.
    pub torque: Form,
    /// `held-out flight` or `flight used for the fit`: where these sums are taken.
    pub judged_on: String,
    /// Largest relative error of the forecast force or torque figure with all findings at their estimates; null where one
    /// or none was found.
    pub together_off: Option<f64>,
    /// Root mean square of force (N) and torque (N·m) with all findings at their estimates, by the model itself.
    pub together_exact: Option<[f64; 2]>,
    /// All changes at full resolution, by handle and flight: what one more effect is added beside.
    #[serde(skip)]
    pub(crate) columns: Vec<Arc<Vec<Evaluated>>>,
}

/// Sums of a quadratic form: Σ|r₀ + Σ s·D|² = c + 2 g·s + sᵀ H s over n samples.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Form {
    /// Number of samples.
    pub n: usize,
    /// Σ|r₀|².
    pub c: f64,
    /// Σ r₀·D, by handle.
    pub g: Vec<f64>,
    /// Σ D·D, by handle and handle.
    pub h: Vec<Vec<f64>>,
}

impl Form {
    /// The root mean square at some shares; none without samples.
    pub fn at(&self, s: &[f64]) -> Option<f64> {
        let mut sum = self.c;
        for (k, a) in s.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            sum += 2.0 * a * self.g[k];
            sum += s.iter().zip(&self.h[k]).map(|(b, h)| a * b * h).sum::<f64>();
        }
        (self.n > 0).then(|| (sum.max(0.0) / self.n as f64).sqrt())
    }
}

/// A flight: means over 50 ms.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LiveFlight {
    /// Name of the log.
    pub log: String,
    /// Times from the start of the log, s, shape (sample).
    pub t_s: Vec<f64>,
    /// Whether the sample belongs to the flight on which the model is judged, shape (sample).
    pub judged: Vec<bool>,
    /// Force that the model lacks, N, body, shape (sample, 3).
    pub force_n: Vec<[f64; 3]>,
    /// Torque that the model lacks, N·m, body; NaN where unknown, empty where the drive carries no torques.
    pub torque_n_m: Vec<[f64; 3]>,
    /// Standard deviation of a force by sensor noise, N, body axes.
    pub force_sigma_n: [f64; 3],
    /// The same of a torque, N·m.
    pub torque_sigma_n_m: [f64; 3],
    /// Changes of force and torque, by handle.
    pub changes: Vec<Change>,
    /// Operating conditions: speed, height, ….
    pub causes: Vec<LiveCause>,
    /// The path.
    pub path: Path,
}

/// Change of the residuals by one handle, at full share; empty where there is none.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Change {
    /// N, body, shape (sample, 3).
    pub force_n: Vec<[f64; 3]>,
    /// N·m, body, shape (sample, 3).
    pub torque_n_m: Vec<[f64; 3]>,
}

/// An operating condition along a flight.
#[derive(Clone, Debug, Serialize)]
pub struct LiveCause {
    /// Name: `speed`.
    pub name: String,
    /// In words.
    pub title: String,
    /// SI unit.
    pub unit: String,
    /// Values, SI, shape (sample); NaN where unknown.
    pub values: Vec<f64>,
}

/// The measured flight, and where simulations that restart from it go.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Path {
    /// Measured poses.
    pub measured: Poses,
    /// Poses of the vehicle as filed.
    pub before: Poses,
    /// Poses of the vehicle with everything found; empty where nothing was found.
    pub after: Poses,
    /// Length of the simulations, s.
    pub restart_s: f64,
}

/// Poses along a path; NaN where unknown, and between two simulations.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Poses {
    /// Times from the start of the log, s, shape (sample); rising.
    pub t_s: Vec<f64>,
    /// Position, m, world, shape (sample, 3).
    pub pos: Vec<[f64; 3]>,
    /// Attitude, quaternion x, y, z, w, body to world, shape (sample, 4).
    pub quat: Vec<[f64; 4]>,
}

/// Why an effect is offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The diagnosis names it.
    Found,
    /// Parameters within tolerance that were fitted with the findings.
    Correction,
    /// Explains the flights about as well as a finding.
    LookAlike,
    /// Tried alone, with the most evidence of the rest.
    Candidate,
}

/// An effect with a switch.
#[derive(Clone, Debug, Serialize)]
pub struct LiveEffect {
    /// Candidate id, or ids joined by ` + `.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Why it is offered.
    pub role: Role,
    /// Evidence, nats, where known.
    pub nats: Option<f64>,
    /// The finding whose look-alike it is.
    pub of: Option<String>,
    /// What can be set.
    pub handles: Vec<Handle>,
    /// Shares (0: as filed, 1: estimate) between which forecast figures are within 5 % of the exact ones.
    pub trust: [f64; 2],
    /// Largest relative error of a forecast figure outside of that.
    pub off: f64,
}

/// A slider: one parameter, or several that move together.
#[derive(Clone, Debug, Serialize)]
pub struct Handle {
    /// Index of its change.
    pub change: usize,
    /// Name of the parameter; `share of the estimate` for several.
    pub name: String,
    /// SI unit; empty for a share.
    pub unit: String,
    /// Value in the vehicle file, where the effect is off, SI.
    pub filed: f64,
    /// Estimate, SI.
    pub value: f64,
    /// Its standard deviation, SI; null where unknown.
    pub sigma: Option<f64>,
    /// Ends of the slider, SI.
    pub range: [f64; 2],
    /// Number of parameters.
    pub parameters: usize,
    /// Names of several parameters that move together, with their estimates, SI; empty for one.
    pub together: Vec<(String, f64)>,
}

impl Handle {
    /// How far a parameter goes at full share, SI.
    pub(crate) fn full(&self, name: &str, filed: f64) -> f64 {
        self.together.iter().find(|(n, _)| n == name).map_or(0.0, |(_, value)| value - filed)
    }
}

impl Live {
    /// Residuals on the flights of a diagnosis, with the changes by what it found and what it tried. `after` is the vehicle
    /// with everything found.
    ///
    /// # Errors
    /// [`GapError`] where a vehicle lacks the dynamics that a log drives.
    pub fn of(
        diagnosed: &Diagnosed,
        flights: &Flights,
        before: &Vehicle,
        after: Option<&Vehicle>,
    ) -> Result<Self, GapError> {
        let seen = judged_flights(flights, before)?;
        let mut out = Self::over(&diagnosed.model, proposals::all(diagnosed), &seen, (before, after))?;
        out.judged_on = judged_on(flights).into();
        Ok(out)
    }

    /// The same of flights that are prepared already, with what is offered.
    pub(crate) fn over(
        model: &Model,
        proposals: Vec<Proposal>,
        flights: &[Flight],
        (before, after): (&Vehicle, Option<&Vehicle>),
    ) -> Result<Self, GapError> {
        let mut out = assembled(model, flights, proposals);
        out.rotors(&model.drone);
        for (flight, live) in flights.iter().zip(&mut out.flights) {
            live.path = flight.path(before, after, MOST_POINTS / flights.len())?;
        }
        Ok(out)
    }

    /// Residuals on flights without any effect to turn on.
    ///
    /// # Errors
    /// [`GapError`] where the vehicle lacks the dynamics that a log drives.
    pub fn without_effects(tracks: &[Track], vehicle: &Vehicle) -> Result<Self, GapError> {
        let all: Vec<_> = tracks.iter().map(|t| (t, None)).collect();
        let flights = prepared(&all, vehicle)?;
        let Some(first) = tracks.first() else { return Ok(Self::default()) };
        let model = Model::bare(&drone_for(first, vehicle)?);
        let mut out = Self::over(&model, Vec::new(), &flights, (vehicle, None))?;
        out.judged_on = if tracks.len() > 1 { "all flights" } else { "the whole flight" }.into();
        Ok(out)
    }
}

impl Live {
    fn rotors(&mut self, drone: &Drone<f64>) {
        let rotors = &drone.airframe.rotors[..drone.airframe.n_rotors];
        self.rotors_m = rotors.iter().map(|r| r.position_m).collect();
        self.rotor_radius_m = rotors.iter().map(|r| r.radius_m).fold(0.0, f64::max);
    }
}

/// Flights of a diagnosis, with the time from which on they are judged: held-out logs first.
fn placed(flights: &Flights) -> Vec<(&Track, Option<f64>)> {
    let held_out = flights.held_out.iter().map(|t| (t, Some(t.span_s[0])));
    held_out.chain(flights.whole.iter().zip(&flights.cut_s).map(|(t, cut)| (t, *cut))).collect()
}

/// The flights of a diagnosis ready for many evaluations, in the order of [`Live::flights`].
pub(crate) fn judged_flights(flights: &Flights, vehicle: &Vehicle) -> Result<Vec<Flight>, GapError> {
    prepared(&placed(flights), vehicle)
}

/// Where figures are taken, in words.
pub(crate) fn judged_on(flights: &Flights) -> &'static str {
    let unseen = placed(flights).iter().any(|(_, from)| from.is_some());
    if unseen { "held-out flight" } else { "flight used for the fit" }
}

fn prepared(all: &[(&Track, Option<f64>)], vehicle: &Vehicle) -> Result<Vec<Flight>, GapError> {
    let unseen = all.iter().any(|(_, from)| from.is_some());
    all.par_iter()
        .map(|(track, from)| {
            let judged_from_s = if unseen { from.unwrap_or(f64::INFINITY) } else { f64::NEG_INFINITY };
            Flight::new(Arc::new((*track).clone()), judged_from_s, vehicle)
        })
        .collect()
}

/// Root mean squares of force and torque on the judged flight.
fn figures(list: &[&Evaluated], flights: &[Flight]) -> [f64; 2] {
    let mut sums = [(0.0, 0); 2];
    for (values, flight) in list.iter().zip(flights) {
        for (k, list) in [&values.force_n, &values.torque_n_m].into_iter().enumerate() {
            for (v, _) in list.iter().zip(&flight.judged).filter(|(v, judged)| **judged && v[0].is_finite()) {
                sums[k].0 += v.iter().map(|x| x * x).sum::<f64>();
                sums[k].1 += 1;
            }
        }
    }
    sums.map(|(sum, n)| if n > 0 { (sum / n as f64).sqrt() } else { 0.0 })
}

/// Evaluates all moves on all flights, in parallel: shape (move, flight).
fn evaluate(model: &Model, flights: &[Flight], moves: &[Vec<Move>]) -> Vec<Vec<Evaluated>> {
    let jobs: Vec<(usize, usize)> =
        (0..moves.len()).flat_map(|m| (0..flights.len()).map(move |f| (m, f))).collect();
    let done: Vec<Evaluated> = jobs.par_iter().map(|(m, f)| flights[*f].with(model, &moves[*m])).collect();
    let mut out: Vec<Vec<Evaluated>> = Vec::new();
    let mut rest = done.into_iter();
    for _ in moves {
        out.push(rest.by_ref().take(flights.len()).collect());
    }
    out
}

/// The data of a page: every proposal evaluated at its estimate, and checked beyond it.
fn assembled(model: &Model, flights: &[Flight], proposals: Vec<Proposal>) -> Live {
    let moves: Vec<Vec<Move>> =
        proposals.iter().flat_map(|p| p.handles.iter().map(|h| h.moves.clone())).collect();
    let full = evaluate(model, flights, &moves);
    let filed: Vec<&Evaluated> = flights.iter().map(|f| &f.filed).collect();
    let changes: Vec<Vec<Evaluated>> = full
        .iter()
        .map(|list| list.iter().zip(&filed).map(|(at, filed)| at.minus(filed)).collect())
        .collect();
    let acts = |h: usize| changes[h].iter().zip(flights).any(|(c, f)| f.acts(c));
    let mut live = Live::default();
    let (mut kept, mut offered) = (Vec::new(), Vec::new());
    let samples: usize = flights.iter().map(|f| f.judged.len()).sum();
    let stride = samples.div_ceil(MOST_SAMPLES).max(1);
    let mut numbers = 0;
    let mut first = 0;
    for p in proposals {
        let own: Vec<usize> = (first..first + p.handles.len()).collect();
        first += p.handles.len();
        // Only channels that the handles change cost anything.
        let size: usize = own
            .iter()
            .flat_map(|h| changes[*h].iter().zip(flights))
            .map(|(c, f)| 3 * f.judged.len().div_ceil(stride) * f.channels(c))
            .sum();
        let wanted = p.role == Role::Found || own.iter().any(|h| acts(*h));
        if !wanted || (p.role != Role::Found && numbers + size > MOST_NUMBERS) {
            continue;
        }
        numbers += size;
        offered.push((p, kept.len()));
        kept.extend(own);
    }
    let chosen: Vec<&Vec<Evaluated>> = kept.iter().map(|h| &changes[*h]).collect();
    live.force = form(flights, &chosen, |e| &e.force_n);
    live.torque = form(flights, &chosen, |e| &e.torque_n_m);
    let checks = Checks { model, flights, filed: &filed, changes: &chosen };
    live.effects = checks.effects(&offered);
    (live.together_off, live.together_exact) = checks.together(&offered);
    live.flights = flights.iter().enumerate().map(|(i, f)| f.live(i, &chosen, stride)).collect();
    let mut all: Vec<Option<Vec<Evaluated>>> = changes.into_iter().map(Some).collect();
    live.columns = kept.into_iter().filter_map(|h| Some(Arc::new(all[h].take()?))).collect();
    live
}

impl Live {
    /// Adds an effect to those that can be turned on.
    pub(crate) fn offer(&mut self, model: &Model, flights: &[Flight], proposal: Proposal) {
        let moves: Vec<Vec<Move>> = proposal.handles.iter().map(|h| h.moves.clone()).collect();
        let filed: Vec<&Evaluated> = flights.iter().map(|f| &f.filed).collect();
        let first = self.columns.len();
        for list in evaluate(model, flights, &moves) {
            let change = list.iter().zip(&filed).map(|(at, filed)| at.minus(filed)).collect();
            self.columns.push(Arc::new(change));
        }
        let changes: Vec<&Vec<Evaluated>> = self.columns.iter().map(|c| &**c).collect();
        self.force = form(flights, &changes, |e| &e.force_n);
        self.torque = form(flights, &changes, |e| &e.torque_n_m);
        let checks = Checks { model, flights, filed: &filed, changes: &changes };
        let effects = checks.effects(&[(proposal, first)]);
        let samples: usize = flights.iter().map(|f| f.judged.len()).sum();
        let stride = samples.div_ceil(MOST_SAMPLES).max(1);
        for (i, flight) in flights.iter().enumerate() {
            self.flights[i].changes.extend(flight.changes(i, &changes[first..], stride));
        }
        self.effects.extend(effects);
    }
}

/// The sums of a quadratic form on the judged flight.
fn form(flights: &[Flight], changes: &[&Vec<Evaluated>], of: fn(&Evaluated) -> &Vec<[f64; 3]>) -> Form {
    let n = changes.len();
    let mut out = Form { n: 0, c: 0.0, g: vec![0.0; n], h: vec![vec![0.0; n]; n] };
    let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    for (f, flight) in flights.iter().enumerate() {
        let filed = of(&flight.filed);
        for (i, r) in filed.iter().enumerate().filter(|(i, r)| flight.judged[*i] && r[0].is_finite()) {
            out.n += 1;
            out.c += dot(r, r);
            let row: Vec<[f64; 3]> =
                changes.iter().map(|c| of(&c[f]).get(i).copied().unwrap_or_default()).collect();
            for (k, a) in row.iter().enumerate() {
                out.g[k] += dot(r, a);
                row.iter().enumerate().for_each(|(l, b)| out.h[k][l] += dot(a, b));
            }
        }
    }
    out
}

/// Checks forecasts against exact evaluations.
struct Checks<'a> {
    model: &'a Model,
    flights: &'a [Flight],
    filed: &'a [&'a Evaluated],
    changes: &'a [&'a Vec<Evaluated>],
}

impl Checks<'_> {
    /// The figures by the straight line with some changes at a share.
    fn forecast(&self, handles: &[usize], share: f64) -> [f64; 2] {
        let list: Vec<Evaluated> = self
            .filed
            .iter()
            .enumerate()
            .map(|(f, filed)| {
                handles.iter().fold((*filed).clone(), |sum, h| sum.plus(&self.changes[*h][f], share))
            })
            .collect();
        figures(&list.iter().collect::<Vec<_>>(), self.flights)
    }

    /// Relative error of forecast figures.
    fn off(&self, exact: &[Evaluated], forecast: [f64; 2]) -> f64 {
        let exact = figures(&exact.iter().collect::<Vec<_>>(), self.flights);
        let off = |k: usize| if exact[k] > 0.0 { (forecast[k] / exact[k] - 1.0).abs() } else { 0.0 };
        off(0).max(off(1))
    }

    /// The offered effects (with the index of their first handle), checked at half and at twice their estimates.
    fn effects(&self, offered: &[(Proposal, usize)]) -> Vec<LiveEffect> {
        const SHARES: [f64; 2] = [0.5, 2.0];
        let moves: Vec<Vec<Move>> =
            offered.iter().flat_map(|(p, _)| SHARES.map(|share| p.at(self.model, share))).collect();
        let exact = evaluate(self.model, self.flights, &moves);
        let check = |(e, (p, first)): (usize, &(Proposal, usize))| {
            let own: Vec<usize> = (*first..first + p.handles.len()).collect();
            let off = |i: usize| self.off(&exact[2 * e + i], self.forecast(&own, SHARES[i]));
            let (half, twice) = (off(0), off(1));
            let trust = match (half <= TRUSTED, twice <= TRUSTED) {
                (true, true) => [0.0, 2.0],
                (true, false) => [0.0, 1.0],
                (false, _) => [1.0, 1.0],
            };
            p.live(*first, trust, half.max(twice))
        };
        offered.iter().enumerate().map(check).collect()
    }

    /// Relative error of the forecast with all findings at their estimates, and the exact figures.
    fn together(&self, offered: &[(Proposal, usize)]) -> (Option<f64>, Option<[f64; 2]>) {
        let found: Vec<&(Proposal, usize)> = offered.iter().filter(|(p, _)| p.role == Role::Found).collect();
        if found.is_empty() {
            return (None, None);
        }
        let moves = found.iter().flat_map(|(p, _)| p.at(self.model, 1.0)).collect();
        let handles: Vec<usize> =
            found.iter().flat_map(|(p, first)| *first..first + p.handles.len()).collect();
        let exact = evaluate(self.model, self.flights, &[moves]).remove(0);
        let off = self.off(&exact, self.forecast(&handles, 1.0));
        let figures = figures(&exact.iter().collect::<Vec<_>>(), self.flights);
        ((found.len() > 1).then_some(off), Some(figures))
    }
}
