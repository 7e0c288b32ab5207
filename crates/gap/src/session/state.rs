//! Everything that a page shows beside curves.

use super::present::Figures;
use super::{HistoryStep, Session, Use};
use crate::GapError;
use crate::live::{LiveEffect, Role};
use crate::report::quantity;
use crate::search::Evidence;
use crate::speak::alike;
use crate::verdict::{Finding, LookAlike};
use propwash_physics::effects::Group;
use serde::Serialize;

/// The state of a session.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    /// Name or path of the vehicle.
    pub vehicle: String,
    /// One sentence: the verdict of the search, or what is missing at the instants.
    pub headline: String,
    /// Whether a search was made with the flights as they are used now.
    pub searched: bool,
    /// Whether logs were put to another use since the last fit: it is to be made again.
    pub stale: bool,
    /// Whether the search leaves something unexplained.
    pub unexplained: bool,
    /// The flights, in the order in which they were opened.
    pub flights: Vec<FlightState>,
    /// What can be turned on, in the order of [`crate::live::Live::effects`].
    pub effects: Vec<EffectState>,
    /// Ids of all candidates, which can be turned on too, with their titles.
    pub candidates: Vec<(String, String)>,
    /// Where figures are taken.
    pub judged_on: String,
    /// Force and torque that the model lacks.
    pub figures: Figures,
    /// The steps.
    pub history: Vec<HistoryStep>,
    /// Whether there is a step to take back, and one to do again.
    pub can_undo: bool,
    /// See `can_undo`.
    pub can_redo: bool,
    /// Assumptions and omissions.
    pub warnings: Vec<String>,
}

/// A flight.
#[derive(Clone, Debug, Serialize)]
pub struct FlightState {
    /// Name of the log.
    pub name: String,
    /// SHA-256 of the log.
    pub sha256: String,
    /// What it is for.
    pub used: Use,
    /// Usable span, s.
    pub span_s: [f64; 2],
    /// What drives the model.
    pub drive: String,
    /// Time from which it is held out from the fit, s; null where all of it is used alike.
    pub held_out_from_s: Option<f64>,
    /// Its place in [`crate::live::Live::flights`].
    pub live: usize,
    /// What was left out or assumed.
    pub warnings: Vec<String>,
}

/// An effect.
#[derive(Clone, Debug, Serialize)]
pub struct EffectState {
    /// Candidate id, ids joined by ` + `, or name of a group of small corrections.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Why it is offered.
    pub role: Role,
    /// The finding whose look-alike it is.
    pub of: Option<String>,
    /// Whether it is on.
    pub on: bool,
    /// How far each of its handles is turned on: 0 as filed, 1 at the estimate of the columns.
    pub shares: Vec<f64>,
    /// Its parameters; empty for a group.
    pub parameters: Vec<ParameterState>,
    /// Evidence that is lost without it if it is on, or gained with it if it is off, nats; null before a fit, and for groups.
    pub evidence_nats: Option<f64>,
    /// Whether the search names it for certain.
    pub certain: bool,
    /// Why it is in doubt, where the search says so.
    pub doubt: Option<String>,
    /// What fits in its place, where it is on.
    pub look_alikes: Vec<LookAlike>,
    /// Opinion of the second estimator, where the search found it.
    pub second: Option<String>,
}

/// A parameter.
#[derive(Clone, Debug, Serialize)]
pub struct ParameterState {
    /// Name within its effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Value of the vehicle file, SI.
    pub filed: f64,
    /// Present value, SI: that of the file while the effect is off.
    pub value: f64,
    /// Estimate beside the effects that are on, SI; that of the columns while it is off.
    pub estimate: f64,
    /// Standard deviation of the estimate, SI; null where unknown.
    pub sigma: Option<f64>,
    /// 95 % interval, SI.
    pub interval: Option<[f64; 2]>,
    /// Whether the value was set by hand.
    pub by_hand: bool,
}

impl Session {
    /// Everything that a page shows beside curves.
    pub fn state(&self) -> State {
        let base = &self.now.base;
        let figures = self.history.figures().unwrap_or_else(|| self.forecast());
        let verdict = self.verdict();
        let history = self.history.list();
        let current = history.iter().position(|h| h.current).unwrap_or(0);
        let named = base.model.named().map(|c| &base.model.candidates[c]);
        let mut warnings: Vec<String> = self.now.parted.warnings.clone();
        warnings.extend(verdict.map(|v| v.warnings.clone()).unwrap_or_default());
        let effects = self.effect_states().unwrap_or_else(|fault| {
            warnings.push(format!("the effects cannot be shown: {fault}"));
            Vec::new()
        });
        warnings.dedup();
        State {
            vehicle: self.label.clone(),
            headline: verdict.map_or_else(|| lacking(&figures), |v| v.headline.clone()),
            searched: verdict.is_some(),
            stale: self.now.fitted.as_ref().is_some_and(|uses| *uses != self.now.uses),
            unexplained: verdict.is_some_and(|v| v.remainder.unexplained),
            flights: self.flight_states(),
            effects,
            candidates: named.map(|c| (c.id.clone(), c.title.clone())).collect(),
            judged_on: base.live.judged_on.clone(),
            figures,
            can_undo: current > 0,
            can_redo: current + 1 < history.len(),
            history,
            warnings,
        }
    }

    fn flight_states(&self) -> Vec<FlightState> {
        let parted = &self.now.parted;
        let (mut fit, mut check) = (0, 0);
        self.tracks
            .iter()
            .zip(&self.now.uses)
            .map(|(t, used)| {
                let (live, held_out_from_s) = match used {
                    Use::Check => {
                        check += 1;
                        (check - 1, None)
                    }
                    Use::Fit => {
                        fit += 1;
                        (parted.held_out.len() + fit - 1, parted.cut_s.get(fit - 1).copied().flatten())
                    }
                };
                FlightState {
                    name: t.name.clone(),
                    sha256: t.log.sha256.clone(),
                    used: *used,
                    span_s: t.span_s,
                    drive: t.drive.title().into(),
                    held_out_from_s,
                    live,
                    warnings: t.warnings.clone(),
                }
            })
            .collect()
    }

    fn effect_states(&self) -> Result<Vec<EffectState>, GapError> {
        let base = &self.now.base;
        let set = self.now.setting.set();
        let fit = base.fit.as_ref();
        let evidence = match fit {
            None => None,
            Some(f) => {
                let s = f.solution();
                let model = &f.diagnosed.model;
                let (h, g) = (&f.all.h, &f.all.g);
                Some(Evidence::new(model, h, g, &s.linear.at, s.dispersion, s.tolerance)?)
            }
        };
        let known = fit.map_or_else(Vec::new, |f| self.known(f, &set));
        let findings = self.verdict().map(|v| v.findings.as_slice()).unwrap_or_default();
        Ok(base
            .live
            .effects
            .iter()
            .map(|e| self.effect_state(e, evidence.as_ref(), &known, findings))
            .collect())
    }

    fn effect_state(
        &self,
        e: &LiveEffect,
        evidence: Option<&Evidence>,
        known: &[usize],
        findings: &[Finding],
    ) -> EffectState {
        let (base, setting) = (&self.now.base, &self.now.setting);
        let model = &base.model;
        let group = Group::ALL.into_iter().find(|g| g.name() == e.id);
        let own: Vec<usize> = match group {
            Some(_) => Vec::new(),
            None => {
                e.id.split(" + ")
                    .filter_map(|id| model.named().find(|c| model.candidates[*c].id == id))
                    .collect()
            }
        };
        let on = match group {
            Some(g) => setting.groups.contains(&g),
            None => !own.is_empty() && own.iter().all(|c| setting.on.contains(c)),
        };
        let fitted = base.fit.as_ref().map_or(0, |f| f.diagnosed.model.candidates.len());
        let told = evidence.filter(|_| !own.is_empty() && own.iter().all(|c| *c < fitted));
        let evidence_nats = told.map(|evidence| {
            let rest: Vec<usize> = known.iter().copied().filter(|c| !own.contains(c)).collect();
            let mut with = [rest.clone(), own.clone()].concat();
            with.sort_unstable();
            evidence.of(&with) - evidence.of(&rest)
        });
        let finding = findings.iter().find(|f| f.id == e.id);
        let searched = base.fit.as_ref().is_some_and(|f| known == f.solution().set);
        let look_alikes = match (finding, told, &own[..]) {
            (Some(f), _, _) if searched || !on => f.look_alikes.clone(),
            (_, Some(evidence), [c]) if on => alike(&base.model, evidence, known, *c),
            _ => Vec::new(),
        };
        let parameters =
            own.iter().flat_map(|c| model.of(*c)).map(|k| self.parameter_state(e, k, on)).collect();
        EffectState {
            id: e.id.clone(),
            title: e.title.clone(),
            role: e.role,
            of: e.of.clone(),
            on,
            shares: self.shares(e),
            parameters,
            evidence_nats: evidence_nats.filter(|n| n.is_finite()),
            certain: finding.is_some_and(|f| f.certain),
            doubt: finding.and_then(|f| f.unwritten().map(str::to_string)),
            look_alikes,
            second: finding.map(|f| f.second.text.clone()),
        }
    }

    fn parameter_state(&self, e: &LiveEffect, k: usize, on: bool) -> ParameterState {
        let setting = &self.now.setting;
        let p = &self.now.base.model.parameters[k];
        let by_hand = setting.by_hand.contains(&k);
        let handle = e.handles.iter().find(|h| h.parameters == 1 && h.name == p.name);
        let together = || e.handles.iter().flat_map(|h| &h.together).find(|(n, _)| *n == p.name);
        let offered = handle.map(|h| h.value).or_else(|| together().map(|(_, v)| *v)).unwrap_or(p.filed);
        let estimate = if on && !by_hand { setting.values[k] } else { offered };
        let sigma = match on && !by_hand {
            true => Some(setting.sigma[k]),
            false => handle.and_then(|h| h.sigma),
        };
        let sigma = sigma.filter(|s| s.is_finite() && *s > 0.0);
        ParameterState {
            name: p.name.clone(),
            unit: p.unit.into(),
            filed: p.filed,
            value: if on { setting.values[k] } else { p.filed },
            estimate,
            sigma,
            interval: sigma.map(|s| [estimate - 1.96 * s, estimate + 1.96 * s]),
            by_hand,
        }
    }
}

/// What is missing, before a search.
fn lacking(figures: &Figures) -> String {
    match figures.before {
        Some(lack) => {
            let torque = lack.torque_n_m.map(|t| format!(" and {}", quantity(t, "N·m", 3)));
            format!("the model lacks {}{}", quantity(lack.force_n, "N", 3), torque.unwrap_or_default())
        }
        None => "too little of the flight can be used".into(),
    }
}
