//! Which effects a page offers to turn on, and at which values.

use super::{Handle, LiveEffect, Role};
use crate::complete::group;
use crate::diagnose::Diagnosed;
use crate::model::Model;
use crate::search::Evidence;
use crate::verdict::ParameterFit;
use propwash_physics::effects::{Group, Sign};

/// Most candidates beyond findings and look-alikes.
const MOST_CANDIDATES: usize = 12;
/// Most parameters of an effect that get a slider each.
const MOST_SLIDERS: usize = 3;

/// A parameter of the model from its filed value to another one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Move {
    /// Index of the parameter.
    pub parameter: usize,
    /// Its new value, SI.
    pub value: f64,
}

/// What moves with one slider.
#[derive(Clone, Debug)]
pub(crate) struct Pull {
    /// At the estimate.
    pub moves: Vec<Move>,
    together: Vec<(String, f64)>,
    name: String,
    unit: String,
    filed: f64,
    value: f64,
    sigma: Option<f64>,
    /// Whether it may go to the other side of the filed value.
    both_sides: bool,
}

/// An effect to be offered.
#[derive(Clone, Debug)]
pub(crate) struct Proposal {
    pub id: String,
    pub title: String,
    pub role: Role,
    pub nats: Option<f64>,
    pub of: Option<String>,
    pub handles: Vec<Pull>,
}

impl Proposal {
    /// Its parameters at a share of the way from the file to the estimate.
    pub fn at(&self, model: &Model, share: f64) -> Vec<Move> {
        let all = self.handles.iter().flat_map(|h| &h.moves);
        all.map(|m| {
            let filed = model.parameters[m.parameter].filed;
            let value = filed + share * (m.value - filed);
            let value = model.least(m.parameter).map_or(value, |least| value.max(least));
            Move { parameter: m.parameter, value }
        })
        .collect()
    }

    /// For the page; `first` is the index of its first change.
    pub fn live(&self, first: usize, trust: [f64; 2], off: f64) -> LiveEffect {
        let handles = self.handles.iter().enumerate().map(|(k, h)| h.live(first + k)).collect();
        LiveEffect {
            id: self.id.clone(),
            title: self.title.clone(),
            role: self.role,
            nats: self.nats,
            of: self.of.clone(),
            handles,
            trust,
            off,
        }
    }
}

impl Pull {
    /// Several parameters that go from the file to their estimates together.
    fn share(model: &Model, moves: Vec<Move>) -> Self {
        let together = moves.iter().map(|m| (model.parameters[m.parameter].name.clone(), m.value)).collect();
        Self {
            moves,
            together,
            name: "share of the estimate".into(),
            unit: String::new(),
            filed: 0.0,
            value: 1.0,
            sigma: None,
            both_sides: false,
        }
    }

    fn live(&self, change: usize) -> Handle {
        let step = self.value - self.filed;
        let back = if self.both_sides { -1.0 } else { 0.0 };
        let ends = [self.filed + back * step, self.filed + 2.0 * step];
        Handle {
            change,
            name: self.name.clone(),
            unit: self.unit.clone(),
            filed: self.filed,
            value: self.value,
            sigma: self.sigma.filter(|s| s.is_finite() && *s > 0.0),
            range: [ends[0].min(ends[1]), ends[0].max(ends[1])],
            parameters: self.moves.len(),
            together: self.together.clone(),
        }
    }
}

/// Sliders for parameters: one each for a few, one in all for many. Parameters that stay at their filed values have none.
fn pulls(model: &Model, fits: &[(usize, ParameterFit)]) -> Vec<Pull> {
    let moved: Vec<&(usize, ParameterFit)> =
        fits.iter().filter(|(_, p)| p.value.is_finite() && p.value != p.filed).collect();
    if moved.len() <= MOST_SLIDERS {
        return moved
            .iter()
            .map(|(k, p)| Pull {
                moves: vec![Move { parameter: *k, value: p.value }],
                together: Vec::new(),
                name: p.name.clone(),
                unit: p.unit.clone(),
                filed: p.filed,
                value: p.value,
                sigma: Some(p.sigma),
                both_sides: model.parameters[*k].sign == Sign::Any,
            })
            .collect();
    }
    vec![Pull::share(model, moved.iter().map(|(k, p)| Move { parameter: *k, value: p.value }).collect())]
}

/// Estimates of some candidates' parameters with exactly `set` free.
fn estimates(
    model: &Model,
    evidence: &Evidence,
    set: &[usize],
    of: &[usize],
) -> Option<Vec<(usize, ParameterFit)>> {
    let posterior = evidence.posterior(set).ok()?;
    let fit = |k: usize| {
        let p = &model.parameters[k];
        let fit = ParameterFit {
            name: p.name.clone(),
            unit: p.unit.into(),
            filed: p.filed,
            value: posterior.mean[k],
            sigma: posterior.sigma[k],
        };
        (k, fit)
    };
    Some(of.iter().flat_map(|c| model.of(*c)).map(fit).collect())
}

fn index(model: &Model, id: &str) -> Option<usize> {
    model.named().find(|c| model.candidates[*c].id == id)
}

/// All proposals: findings, corrections, look-alikes, then the other candidates by their evidence alone.
pub(crate) fn all(diagnosed: &Diagnosed) -> Vec<Proposal> {
    let (model, verdict) = (&diagnosed.model, &diagnosed.verdict);
    let mut out = found(diagnosed);
    out.extend(corrections(diagnosed));
    let Ok(evidence) = diagnosed.solution.evidence(model) else { return out };
    let mut known: Vec<String> = out.iter().map(|p| p.id.clone()).collect();
    for f in &verdict.findings {
        for l in &f.look_alikes {
            let id = l.ids.join(" + ");
            let indices: Option<Vec<usize>> = l.ids.iter().map(|id| index(model, id)).collect();
            let Some(indices) = indices.filter(|_| !known.contains(&id)) else { continue };
            let mut set: Vec<usize> = diagnosed.solution.set.clone();
            set.retain(|c| model.candidates[*c].id != f.id);
            set.extend(&indices);
            let Some(fits) = estimates(model, &evidence, &set, &indices) else { continue };
            known.push(id.clone());
            out.push(Proposal {
                id,
                title: l.title.clone(),
                role: Role::LookAlike,
                nats: Some(f.evidence_nats - l.worse_by_nats),
                of: Some(f.id.clone()),
                handles: pulls(model, &fits),
            });
        }
    }
    let mut singles = verdict.singles.clone();
    singles.sort_by(|a, b| b.1.total_cmp(&a.1));
    singles.retain(|(id, nats)| !known.contains(id) && *nats > 0.0);
    for (id, nats) in singles.into_iter().take(MOST_CANDIDATES) {
        let Some(c) = index(model, &id) else { continue };
        let Some(fits) = estimates(model, &evidence, &[c], &[c]) else { continue };
        out.push(Proposal {
            title: model.candidates[c].title.clone(),
            id,
            role: Role::Candidate,
            nats: Some(nats),
            of: None,
            handles: pulls(model, &fits),
        });
    }
    out.retain(|p| !p.handles.is_empty() && p.handles.iter().all(|h| !h.moves.is_empty()));
    out
}

/// One candidate at some values, offered by itself.
pub(crate) fn single(
    model: &Model,
    candidate: usize,
    nats: Option<f64>,
    value: impl Fn(usize) -> (f64, f64),
) -> Proposal {
    let fit = |k: usize| {
        let p = &model.parameters[k];
        let (value, sigma) = value(k);
        (k, ParameterFit { name: p.name.clone(), unit: p.unit.into(), filed: p.filed, value, sigma })
    };
    let fits: Vec<(usize, ParameterFit)> = model.of(candidate).map(fit).collect();
    let of = &model.candidates[candidate];
    Proposal {
        id: of.id.clone(),
        title: of.title.clone(),
        role: Role::Candidate,
        nats,
        of: None,
        handles: pulls(model, &fits),
    }
}

fn found(diagnosed: &Diagnosed) -> Vec<Proposal> {
    let model = &diagnosed.model;
    let findings = diagnosed.verdict.findings.iter();
    findings
        .filter_map(|f| {
            let candidate = index(model, &f.id)?;
            let parameter = |p: &ParameterFit| {
                let k = model.of(candidate).find(|k| model.parameters[*k].name == p.name)?;
                Some((k, p.clone()))
            };
            let fits: Vec<_> = f.parameters.iter().filter_map(parameter).collect();
            Some(Proposal {
                id: f.id.clone(),
                title: f.title.clone(),
                role: Role::Found,
                nats: Some(f.evidence_nats),
                of: None,
                handles: pulls(model, &fits),
            })
        })
        .collect()
}

/// Parameters within tolerance, one slider for each group.
fn corrections(diagnosed: &Diagnosed) -> Vec<Proposal> {
    let model = &diagnosed.model;
    let mut out = Vec::new();
    for one in Group::ALL {
        let own = diagnosed.verdict.adjusted.iter().filter(|c| group(&c.kind, c.area) == one);
        let moves: Vec<Move> = own
            .filter(|c| c.parameter.value.is_finite() && c.parameter.value != c.parameter.filed)
            .filter_map(|c| {
                let candidate = index(model, &c.id)?;
                let parameter =
                    model.of(candidate).find(|k| model.parameters[*k].name == c.parameter.name)?;
                Some(Move { parameter, value: c.parameter.value })
            })
            .collect();
        if moves.is_empty() {
            continue;
        }
        let n = moves.len();
        out.push(Proposal {
            id: one.name().into(),
            title: format!("{n} {} within tolerance", if n == 1 { "parameter" } else { "parameters" }),
            role: Role::Correction,
            nats: None,
            of: None,
            handles: vec![Pull::share(model, moves)],
        });
    }
    out
}
