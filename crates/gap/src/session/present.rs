//! The present values of a session, and the figures that follow from them: forecast by columns, or exact by the model.

use super::written::Put;
use super::{Base, Fitted, Session, Target};
use crate::GapError;
use crate::complete::{calibration, group};
use crate::error::Result;
use crate::live::proposals::{Move, single};
use crate::live::{Axes, Evaluated, Flight as Seen, Live, LiveEffect};
use crate::model::Model;
use crate::verdict::{Calibration, Lack, ParameterFit};
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::{Group, Sign};
use serde::Serialize;
use std::sync::Arc;

/// What is on, and at which values.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Setting {
    /// Candidates that are on, in the order in which they were turned on.
    pub on: Vec<usize>,
    /// Groups of small corrections that are on.
    pub groups: Vec<Group>,
    /// Shares of the way to their estimates, where they are not all of it.
    pub shares: Vec<(Group, f64)>,
    /// Value of every parameter of the model, SI; in force where its candidate or group is on.
    pub values: Vec<f64>,
    /// Its standard deviation, SI; NaN where there is none.
    pub sigma: Vec<f64>,
    /// Parameters that were set by hand.
    pub by_hand: Vec<usize>,
}

impl Setting {
    /// Nothing is on.
    pub fn filed(values: Vec<f64>) -> Self {
        let sigma = vec![f64::NAN; values.len()];
        Self { on: vec![], groups: vec![], shares: vec![], values, sigma, by_hand: vec![] }
    }

    /// The candidates that are on, in rising order.
    pub fn set(&self) -> Vec<usize> {
        let mut out = self.on.clone();
        out.sort_unstable();
        out
    }

    /// Share of a group's way to its estimates.
    pub fn share(&self, group: Group) -> f64 {
        self.shares.iter().find(|(g, _)| *g == group).map_or(1.0, |(_, s)| *s)
    }
}

/// Force and torque that the model lacks on the judged flight, means over 50 ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// The model as filed.
    pub before: Option<Lack>,
    /// With the present values.
    pub now: Option<Lack>,
    /// Whether `now` comes from the model itself; else it is forecast.
    pub exact: bool,
}

/// Residuals of the model at the present values, by the model itself.
#[derive(Clone, Debug, Serialize)]
pub struct Exact {
    /// Figures within the window, on the judged flight.
    pub figures: Figures,
    /// The flights, in the order of [`Live::flights`].
    pub flights: Vec<ExactFlight>,
}

/// A flight of [`Exact`].
#[derive(Clone, Debug, Serialize)]
pub struct ExactFlight {
    /// Name of the log.
    pub log: String,
    /// Times of the samples, s, shape (sample); all of the flight, whatever the window.
    pub t_s: Vec<f64>,
    /// Force that the model lacks, N, body, shape (sample, 3); NaN where unknown.
    pub force_n: Vec<[f64; 3]>,
    /// Torque that the model lacks, N·m, body, shape (sample, 3); empty where the drive carries no torques.
    pub torque_n_m: Vec<[f64; 3]>,
    /// Root mean squares by body axis over all instants in the window, as `propwash compare` has them of the whole flight.
    pub rms: Axes,
}

/// Figures of residuals on the judged flight within a window.
fn lack(list: &[&Evaluated], flights: &[Seen], window_s: [f64; 2]) -> Option<Lack> {
    let (mut force, mut torque) = ([0.0; 2], [0.0; 2]);
    let (mut n, mut turning) = (0, 0);
    for (values, f) in list.iter().zip(flights) {
        let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        for (i, t) in f.t_s.iter().enumerate() {
            if !f.judged[i] || *t < window_s[0] || *t > window_s[1] || !values.force_n[i][0].is_finite() {
                continue;
            }
            n += 1;
            force[0] += square(values.force_n[i]);
            force[1] += square(f.force_sigma_n);
            if let Some(v) = values.torque_n_m.get(i).filter(|v| v[0].is_finite()) {
                turning += 1;
                torque[0] += square(*v);
                torque[1] += square(f.torque_sigma_n_m);
            }
        }
    }
    let root = |sum: f64, n: usize| (sum / n as f64).sqrt();
    (n > 0).then(|| Lack {
        force_n: root(force[0], n),
        force_times_noise: (force[0] / force[1]).sqrt(),
        torque_n_m: (turning > 0).then(|| root(torque[0], turning)),
        torque_times_noise: (turning > 0).then(|| (torque[0] / torque[1]).sqrt()),
        n,
    })
}

/// All of a flight.
pub(super) const ALWAYS: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// Sets what no fit knows yet to a first guess: the values that explain most of what is missing at the instants.
pub(super) fn without_fit(base: &Base, setting: Setting) -> Setting {
    without_fit_of(base, 0, setting)
}

/// The same of candidates from `known` on.
pub(super) fn without_fit_of(base: &Base, known: usize, mut setting: Setting) -> Setting {
    let model = &base.model;
    for c in setting.on.clone().into_iter().filter(|c| *c >= known) {
        let offered = base.live.effects.iter().find(|e| e.id == model.candidates[c].id);
        for k in model.of(c).filter(|k| !setting.by_hand.contains(k)).collect::<Vec<_>>() {
            let p = &model.parameters[k];
            let handles = offered.iter().flat_map(|e| &e.handles);
            let estimate = handles.clone().find(|h| h.name == p.name).map(|h| h.value);
            setting.values[k] = estimate.unwrap_or(p.filed);
            setting.sigma[k] = f64::NAN;
        }
    }
    setting
}

/// Values of a candidate's parameters that explain most of what flights of the fit miss, beside their plausible sizes: least
/// squares of force and torque over the sensors' noise, linear in the parameters.
fn first_guess(model: &Model, flights: &[Seen], candidate: usize) -> Vec<f64> {
    let own: Vec<usize> = model.of(candidate).collect();
    let side = |k: usize| if model.parameters[k].sign == Sign::Down { -1.0 } else { 1.0 };
    let fitted = flights.iter().any(|f| f.judged.iter().any(|j| !j));
    let m = own.len();
    let (mut h, mut g) = (DMatrix::<f64>::identity(m, m), DVector::<f64>::zeros(m));
    for f in flights {
        let column = |k: &usize| {
            let p = &model.parameters[*k];
            let value = p.filed + side(*k) * p.slab;
            f.with(model, &[Move { parameter: *k, value }]).minus(&f.filed)
        };
        let columns: Vec<Evaluated> = own.iter().map(column).collect();
        for i in (0..f.t_s.len()).filter(|i| !(fitted && f.judged[*i])) {
            let parts =
                [(&f.filed.force_n, f.force_sigma_n, 0), (&f.filed.torque_n_m, f.torque_sigma_n_m, 1)];
            for (r, sigma, which) in parts {
                let Some(r) = r.get(i).filter(|r| r[0].is_finite()) else { continue };
                let of = |c: &Evaluated| if which == 0 { c.force_n[i] } else { c.torque_n_m[i] };
                for axis in (0..3).filter(|a| sigma[*a] > 0.0) {
                    let row: Vec<f64> = columns.iter().map(|c| of(c)[axis] / sigma[axis]).collect();
                    for (a, x) in row.iter().enumerate() {
                        g[a] -= x * r[axis] / sigma[axis];
                        row.iter().enumerate().for_each(|(b, y)| h[(a, b)] += x * y);
                    }
                }
            }
        }
    }
    let z = Cholesky::new(h).map_or_else(|| DVector::zeros(m), |f| f.solve(&g));
    let value = |(i, k): (usize, &usize)| {
        let p = &model.parameters[*k];
        // A one-sided parameter never goes to its other side.
        let z = if p.sign == Sign::Any { z[i] } else { z[i].max(0.0) };
        let value = p.filed + side(*k) * z * p.slab;
        model.least(*k).map_or(value, |least| value.max(least))
    };
    own.iter().enumerate().map(value).collect()
}

impl Session {
    /// What an effect's name turns on; a candidate that was not offered so far is offered from now on.
    pub(super) fn offered(&mut self, id: &str) -> Result<Target, GapError> {
        let base = self.now.base.clone();
        let model = &base.model;
        let known = base.live.effects.iter().any(|e| e.id == id);
        if let Some(group) = Group::ALL.into_iter().find(|g| g.name() == id)
            && (known || base.fit.is_some())
        {
            return Ok(Target::Group(group));
        }
        let list = id.split(" + ").map(|id| model.candidate(id)).collect::<Result<Vec<_>, _>>()?;
        if !known && let [candidate] = list[..] {
            let live = self.with_column(&base, candidate)?;
            self.now.base = Arc::new(Base { live: Arc::new(live), ..(*base).clone() });
        }
        Ok(Target::Candidates(list))
    }

    /// The columns with that of one more candidate, at its estimate beside nothing else, or at a first guess.
    fn with_column(&self, base: &Base, candidate: usize) -> Result<Live, GapError> {
        let model = &base.model;
        let fit = base.fit.as_ref().filter(|f| candidate < f.diagnosed.model.candidates.len());
        let values: Vec<(f64, f64)> = match fit {
            Some(fit) => {
                let found = fit.solution().of_set(&fit.diagnosed.model, &fit.all, &[candidate])?;
                model.of(candidate).map(|k| (found.mean[k], found.sigma[k])).collect()
            }
            None => {
                let guess = first_guess(model, &self.now.seen, candidate);
                guess.into_iter().map(|v| (v, f64::NAN)).collect()
            }
        };
        let first = model.of(candidate).next().unwrap_or(0);
        let slab = |k: usize| model.parameters[k].filed + model.parameters[k].slab;
        let at = |k: usize| {
            let (value, sigma) = values[k - first];
            // A slider needs a length also where the estimate is nothing.
            if value == model.parameters[k].filed { (slab(k), f64::NAN) } else { (value, sigma) }
        };
        let nats = fit.and_then(|f| {
            let evidence = f.solution().evidence(&f.diagnosed.model).ok()?;
            Some(evidence.of(&[candidate]))
        });
        let mut live = (*base.live).clone();
        live.offer(model, &self.now.seen, single(model, candidate, nats, at));
        Ok(live)
    }

    /// The candidates of a set that a fit knows.
    pub(super) fn known(&self, fit: &Fitted, set: &[usize]) -> Vec<usize> {
        let known = fit.diagnosed.model.candidates.len();
        set.iter().copied().filter(|c| *c < known).collect()
    }

    /// Parameters of groups of small corrections that are on, at their shares of the way to the estimates.
    pub(super) fn corrections(&self) -> Vec<Calibration> {
        let (model, setting) = (&self.now.base.model, &self.now.setting);
        let beside = |c: usize| !setting.on.contains(&c) && !model.is_shape(c);
        let mut out = Vec::new();
        for (k, p) in model.parameters.iter().enumerate().filter(|(_, p)| beside(p.candidate)) {
            let c = &model.candidates[p.candidate];
            let one = group(c.kind, c.area);
            if !setting.groups.contains(&one) {
                continue;
            }
            let value = p.filed + setting.share(one) * (setting.values[k] - p.filed);
            out.push(Calibration {
                id: c.id.clone(),
                kind: c.kind.into(),
                area: c.area,
                parameter: ParameterFit {
                    name: p.name.clone(),
                    unit: p.unit.into(),
                    filed: p.filed,
                    value,
                    sigma: setting.sigma[k],
                },
                set: model.preset_values(p.candidate),
                tolerance: p.spike,
                helps: true,
                partner: false,
            });
        }
        out
    }

    /// What the present values would write into the vehicle file.
    pub fn puts(&self) -> Vec<Put> {
        let (model, setting) = (&self.now.base.model, &self.now.setting);
        let mut out = Vec::new();
        for c in &setting.on {
            let id = &model.candidates[*c].id;
            for k in model.of(*c) {
                let sigma = Some(setting.sigma[k]).filter(|s| s.is_finite() && *s > 0.0);
                let (parameter, value) = (model.parameters[k].name.clone(), setting.values[k]);
                out.push(Put { id: id.clone(), parameter, value, sigma, correction: false });
            }
            for (parameter, value) in model.preset_values(*c) {
                out.push(Put { id: id.clone(), parameter, value, sigma: None, correction: false });
            }
        }
        let list = self.corrections();
        let written = calibration(&list);
        let kept = |c: &&Calibration| {
            written.iter().any(|e| e.kind == c.kind && e.parameters.contains(&c.parameter))
        };
        for c in list.iter().filter(kept) {
            let put = |parameter: &str, value: f64, sigma: f64| Put {
                id: c.id.clone(),
                parameter: parameter.into(),
                value,
                sigma: Some(sigma).filter(|s| s.is_finite() && *s > 0.0),
                correction: true,
            };
            out.push(put(&c.parameter.name, c.parameter.value, c.parameter.sigma));
            for (name, value) in &c.set {
                let put = put(name, *value, f64::NAN);
                if !out.contains(&put) {
                    out.push(put);
                }
            }
        }
        out
    }

    /// The parameters that are in force, with their values.
    fn moves(&self) -> Vec<Move> {
        let model = &self.now.base.model;
        let place = |put: &Put| {
            let c = model.named().find(|c| model.candidates[*c].id == put.id)?;
            let k = model.of(c).find(|k| model.parameters[*k].name == put.parameter)?;
            Some(Move { parameter: k, value: put.value })
        };
        self.puts().iter().filter_map(place).collect()
    }

    /// How far every handle of an effect is turned on, as shares of the estimate: 0 as filed.
    pub(super) fn shares(&self, effect: &LiveEffect) -> Vec<f64> {
        let (model, setting) = (&self.now.base.model, &self.now.setting);
        if let Some(group) = Group::ALL.into_iter().find(|g| g.name() == effect.id) {
            let share = if setting.groups.contains(&group) { setting.share(group) } else { 0.0 };
            return vec![share; effect.handles.len()];
        }
        let own: Vec<usize> = effect
            .id
            .split(" + ")
            .filter_map(|id| model.named().find(|c| model.candidates[*c].id == id))
            .collect();
        let on = !own.is_empty() && own.iter().all(|c| setting.on.contains(c));
        let of_parameter = |name: &str, filed: f64, value: f64| {
            let places = own.iter().flat_map(|c| model.of(*c));
            let k = places.into_iter().find(|k| model.parameters[*k].name == name)?;
            let step = value - filed;
            Some(if step == 0.0 { 0.0 } else { (setting.values[k] - filed) / step })
        };
        let share = |h: &crate::live::Handle| {
            if !on {
                return 0.0;
            }
            if h.parameters == 1 {
                return of_parameter(&h.name, h.filed, h.value).unwrap_or(0.0);
            }
            // Several parameters move together: the share that comes nearest, every parameter by its plausible size.
            let (mut along, mut length) = (0.0, 0.0);
            for k in own.iter().flat_map(|c| model.of(*c)) {
                let p = &model.parameters[k];
                let (now, full) = ((setting.values[k] - p.filed) / p.slab, h.full(&p.name, p.filed) / p.slab);
                along += now * full;
                length += full * full;
            }
            if length > 0.0 { along / length } else { 0.0 }
        };
        effect.handles.iter().map(share).collect()
    }

    /// Figures by the columns.
    pub(super) fn forecast(&self) -> Figures {
        let live = &self.now.base.live;
        let filed: Vec<&Evaluated> = self.now.seen.iter().map(|f| &f.filed).collect();
        let before = lack(&filed, &self.now.seen, ALWAYS);
        let mut s = vec![0.0; live.force.g.len()];
        for effect in &live.effects {
            for (handle, share) in effect.handles.iter().zip(self.shares(effect)) {
                s[handle.change] = share;
            }
        }
        let on = s.iter().any(|s| *s != 0.0);
        let now = before.map(|b| {
            let force_n = live.force.at(&s).unwrap_or(b.force_n);
            let torque_n_m = b.torque_n_m.map(|t| live.torque.at(&s).unwrap_or(t));
            let times =
                |now: f64, before: f64, times: f64| if before > 0.0 { times * now / before } else { times };
            Lack {
                force_n,
                force_times_noise: times(force_n, b.force_n, b.force_times_noise),
                torque_n_m,
                torque_times_noise: b
                    .torque_times_noise
                    .zip(torque_n_m)
                    .zip(b.torque_n_m)
                    .map(|((noise, now), before)| times(now, before, noise)),
                n: b.n,
            }
        });
        Figures { before, now: if on { now } else { before }, exact: !on }
    }

    /// Residuals at the present values by the model itself, with figures within a window of the logs' times, s.
    ///
    /// # Errors
    /// [`GapError::Log`] for a window without a sample of the judged flight.
    pub fn exact(&mut self, window_s: Option<[f64; 2]>) -> Result<Exact> {
        use rayon::prelude::*;
        let window = window_s.unwrap_or(ALWAYS);
        let (model, moves) = (&self.now.base.model, self.moves());
        let drone = model.moved(moves.iter().map(|m| (m.parameter, m.value)));
        let seen = &self.now.seen;
        let all: Vec<(Evaluated, Axes)> = seen.par_iter().map(|f| f.exact(&drone, window)).collect();
        let filed: Vec<&Evaluated> = seen.iter().map(|f| &f.filed).collect();
        let now: Vec<&Evaluated> = all.iter().map(|(e, _)| e).collect();
        let figures =
            Figures { before: lack(&filed, seen, window), now: lack(&now, seen, window), exact: true };
        if figures.before.is_none() {
            return Err(GapError::Log {
                log: "the window".into(),
                expected: format!("some of {}", self.now.base.live.judged_on),
                found: format!("none from {} to {} s", window[0], window[1]),
                remedy: "choose another window, or all of the flight".into(),
            }
            .into());
        }
        let flights = seen
            .iter()
            .zip(all)
            .map(|(f, (values, rms))| ExactFlight {
                log: f.track.name.clone(),
                t_s: f.t_s.clone(),
                force_n: values.force_n,
                torque_n_m: values.torque_n_m,
                rms,
            })
            .collect();
        let out = Exact { figures, flights };
        if window_s.is_none() {
            self.history.exact(figures);
            self.exact = Some(out.clone());
        }
        Ok(out)
    }
}
