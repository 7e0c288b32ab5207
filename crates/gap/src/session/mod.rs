//! A session with flights of one vehicle: see what its model lacks, search for it, turn effects on and off, set their values,
//! fit them, take steps back, and save the better vehicle.
//!
//! Everything but a search and a fit answers at once: sets of effects are estimated on the last linearisation of the flights
//! (one Cholesky), and figures are forecast by columns ([`crate::live`]) until [`Session::exact`] has them from the model.
//! Nothing is accepted by itself: a search turns nothing on.

mod history;
mod own;
mod present;
mod saved;
mod state;
#[cfg(test)]
mod tests;
mod written;

use crate::diagnose::{Diagnosed, Moments, Settings, diagnose};
use crate::error::Result;
use crate::excite::{FlightPlan, Request, Sensors, plan};
use crate::fit::{Prepared, forces_only};
use crate::fitted::{self, Calibrate, Filed};
use crate::ladder::Flights;
use crate::live::{self, Live, Role};
use crate::model::Model;
use crate::per_log::Information;
use crate::replay::drone_for;
use crate::solve::{self, Solution};
use crate::track::Track;
use crate::verdict::Diagnosis;
use crate::watch::Watch;
use crate::{GapError, wiring};
use propwash_physics::effects::Group;
use propwash_vehicle::Vehicle;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

pub use history::HistoryStep;
pub use own::Axis;
pub use present::{Exact, ExactFlight, Figures};
pub use saved::{Line, LineChange, Saved};
pub use state::{EffectState, FlightState, ParameterState, State};
pub use written::{Put, completed_by};

/// Share of each log that is kept from the fit where no log is for checking, as on the command line.
pub const HOLD_OUT: f64 = 0.2;

/// What a log is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Use {
    /// Effects are fitted to it.
    Fit,
    /// It checks what was fitted to the others.
    Check,
}

/// A log of a session.
#[derive(Clone, Debug)]
pub struct Flight {
    /// The log.
    pub track: Track,
    /// What it is for.
    pub used: Use,
}

/// What one name of an effect turns on.
enum Target {
    Candidates(Vec<usize>),
    Group(Group),
}

/// What the flights say, and what is offered: shared by steps of the history.
#[derive(Clone)]
struct Base {
    /// The vehicle with everything that can be turned on.
    model: Model,
    /// The last fit, with the verdict of the last search.
    fit: Option<Arc<Fitted>>,
    live: Arc<Live>,
    /// Tables of own expressions, as the vehicle file gets them.
    own: Vec<own::Own>,
}

/// A fit whose windows are summed up.
struct Fitted {
    diagnosed: Diagnosed,
    all: Information,
    /// Whether a search led to it: then its verdict names what is missing.
    searched: bool,
}

impl Fitted {
    fn new(mut diagnosed: Diagnosed, searched: bool) -> Result<Self, GapError> {
        diagnosed.solution.compact();
        let all = diagnosed.solution.information(&diagnosed.model)?;
        Ok(Self { diagnosed, all, searched })
    }

    fn solution(&self) -> &Solution {
        &self.diagnosed.solution
    }
}

/// A session; see the module.
pub struct Session {
    label: String,
    filed: Vehicle,
    text: String,
    tracks: Vec<Track>,
    now: history::Place,
    history: history::History,
    /// The last exact evaluation, where it is of the present values.
    exact: Option<Exact>,
}

impl Session {
    /// Opens flights with a vehicle: `text` is that of its file, `label` its name or path as commands would name it.
    ///
    /// # Errors
    /// [`GapError`] where no flight is for the fit, the logs cannot be of one vehicle or not of this one.
    pub fn open(label: &str, vehicle: &Vehicle, text: &str, flights: Vec<Flight>) -> Result<Self, GapError> {
        let uses: Vec<Use> = flights.iter().map(|f| f.used).collect();
        let tracks: Vec<Track> = flights.into_iter().map(|f| f.track).collect();
        if tracks.is_empty() {
            return Err(no_flight());
        }
        crate::compare::one_vehicle(&tracks)?;
        let parted = Arc::new(parted(&tracks, &uses)?);
        let drone = drone_for(&tracks[0], vehicle)?;
        let (seen, logs) =
            rayon::join(|| live::judged_flights(&parted, vehicle), || prepared(&parted, &drone));
        let (seen, logs) = (Arc::new(seen?), logs);
        wiring::check(&logs, &drone)?;
        let model = model_of(&logs, &drone, vehicle)?;
        drop(logs);
        let mut shown = Live::over(&model, Vec::new(), &seen, (vehicle, None))?;
        shown.judged_on = live::judged_on(&parted).into();
        let values = model.filed();
        let base = Arc::new(Base { model, fit: None, live: Arc::new(shown), own: Vec::new() });
        let setting = present::Setting::filed(values);
        let now = history::Place { uses, fitted: None, parted, seen, base, setting };
        let mut out = Self {
            label: label.into(),
            filed: vehicle.clone(),
            text: text.into(),
            tracks,
            history: history::History::default(),
            now,
            exact: None,
        };
        let before = out.forecast();
        out.history = history::History::begin(out.now.clone(), before);
        Ok(out)
    }

    /// Residuals, their columns and paths, for pages; the effects are those of [`State::effects`], in the same order.
    pub fn live(&self) -> &Live {
        &self.now.base.live
    }

    /// The verdict of the last search.
    pub fn verdict(&self) -> Option<&Diagnosis> {
        let fit = self.now.base.fit.as_ref()?;
        fit.searched.then_some(&fit.diagnosed.verdict)
    }

    /// Searches for what is missing. Nothing is turned on by it, and own expressions are searched with the rest.
    ///
    /// # Errors
    /// [`GapError::Cancelled`] at the watcher's wish, and those of [`diagnose`]; the session is then as it was.
    pub fn find(&mut self, watch: &Watch) -> Result<()> {
        let text = own::with_all(&self.label, &self.text, &self.now.base.own)?;
        let vehicle = Vehicle::from_toml(&self.filed.name, &text)?;
        // A search starts anew from several points: seen from outside it only goes on.
        let done = AtomicUsize::new(0);
        let told = |now: usize, of: usize| {
            if now < of {
                let total = of + LATER;
                watch.done(done.fetch_add(1, Ordering::Relaxed).min(total - 1), total);
            }
        };
        let inner = Watch { progress: Some(&told), ..*watch };
        let settings = Settings {
            no_advice: true,
            no_ladder: true,
            // In a session the user types formulas.
            no_formulas: true,
            // What is shown is one vehicle over all of the flight.
            moments: Moments::Tell,
            watch: inner,
            ..Settings::default()
        };
        let filed = Filed { label: &self.label, vehicle: &vehicle, text };
        let parted = self.now.parted.clone();
        let found = fitted::fit(filed, &parted, &settings, BY, Calibrate::No)?;
        watch.check()?;
        let (diagnosed, after) = (found.diagnosed, found.after);
        let proposals = live::proposals::all(&diagnosed);
        let mut shown =
            Live::over(&diagnosed.model, proposals, &self.now.seen, (&self.filed, after.as_ref()))?;
        shown.judged_on = live::judged_on(&parted).into();
        watch.check()?;
        let mut model = diagnosed.model.clone();
        let own = self.now.base.own.clone();
        for o in &own {
            model.candidates.iter_mut().filter(|c| c.id == o.name).for_each(|c| c.title = o.title());
        }
        let fit = Arc::new(Fitted::new(diagnosed, true)?);
        let base = Base { model, fit: Some(fit), live: Arc::new(shown), own };
        let setting = present::Setting::filed(base.model.filed());
        self.now.fitted = Some(self.now.uses.clone());
        self.take("find what is missing".into(), Arc::new(base), setting);
        for name in self.now.base.own.iter().map(|o| o.name.clone()).collect::<Vec<_>>() {
            self.offered(&name)?;
        }
        watch.done(1, 1);
        Ok(())
    }

    /// Fits the effects that are on, with everything within tolerance, from the last linearisation; values that were set by hand
    /// are fitted too.
    ///
    /// # Errors
    /// [`GapError::Cancelled`] at the watcher's wish, and those of a fit; the session is then as it was.
    pub fn fit(&mut self, watch: &Watch) -> Result<()> {
        let base = self.now.base.clone();
        let set = self.now.setting.set();
        let mut model = base.model.clone();
        let drone = drone_for(&self.tracks[0], &self.filed)?;
        let mut logs = prepared(&self.now.parted, &drone);
        if logs.iter().any(|l| l.around.cable.is_some()) {
            let (values, chosen) = (&self.now.setting.values, &self.now.setting.on);
            crate::cable::reattach(&mut logs, &model.plain_at(values, chosen));
        }
        let fresh = || -> Result<Diagnosed> {
            let ids = set.iter().map(|c| base.model.candidates[*c].id.clone()).collect();
            let text = own::with_all(&self.label, &self.text, &base.own)?;
            let vehicle = Vehicle::from_toml(&self.filed.name, &text)?;
            let settings =
                Settings { given: Some(ids), no_advice: true, watch: *watch, ..Settings::default() };
            Ok(diagnose(&self.now.parted.fit, &vehicle, &settings)?)
        };
        let again = |fit: &Fitted, model: &mut Model| -> Result<Option<Solution>, GapError> {
            // Logs of another fit had other noise, clocks and weather.
            if forces_only(&logs) || self.now.fitted.as_ref() != Some(&self.now.uses) {
                let solution = solve::solve(&logs, model, Some(&set), watch)?;
                return Ok(Some(solve::with_scatter(model, solution)?));
            }
            let posterior = fit.solution().of_set(&fit.diagnosed.model, &fit.all, &self.known(fit, &set))?;
            let found = solve::refitted(&logs, model, fit.solution(), (&set, &posterior), watch)?;
            found.map(|s| solve::with_scatter(model, s)).transpose()
        };
        let fitted = match &base.fit {
            None => {
                let diagnosed = fresh()?;
                model = diagnosed.model.clone();
                Fitted::new(diagnosed, false)?
            }
            Some(fit) => {
                let solution = again(fit, &mut model)?.ok_or_else(solve::no_window)?;
                let verdict = fit.diagnosed.verdict.clone();
                Fitted::new(
                    Diagnosed { verdict, solution, model: model.clone(), proposed: Vec::new() },
                    fit.searched,
                )?
            }
        };
        let next = Arc::new(Base { model, fit: Some(Arc::new(fitted)), ..(*base).clone() });
        let mut setting = self.now.setting.clone();
        setting.by_hand.clear();
        let setting = estimated(&next, setting)?;
        self.now.fitted = Some(self.now.uses.clone());
        self.take("fit what is on".into(), next, setting);
        Ok(())
    }

    /// Turns an effect on or off, by the name of an offered effect or of any candidate. Everything is then at its estimate
    /// beside the effects that are on, but for values set by hand.
    ///
    /// # Errors
    /// [`GapError::Unknown`] for an unknown name.
    pub fn toggle(&mut self, effect: &str, on: bool) -> Result<()> {
        let target = self.offered(effect)?;
        let mut setting = self.now.setting.clone();
        match target {
            Target::Candidates(list) => {
                for c in list {
                    setting.on.retain(|x| *x != c);
                    if on {
                        setting.on.push(c);
                    } else {
                        let own: Vec<usize> = self.now.base.model.of(c).collect();
                        setting.by_hand.retain(|k| !own.contains(k));
                    }
                }
            }
            Target::Group(group) => {
                setting.groups.retain(|g| *g != group);
                if on {
                    setting.groups.push(group);
                }
            }
        }
        let base = self.now.base.clone();
        let setting = estimated(&base, setting)?;
        let word = if on { "on" } else { "off" };
        self.take(format!("{effect} {word}"), base, setting);
        Ok(())
    }

    /// Sets a parameter of an effect by hand, SI, which turns the effect on. For a group of small corrections the parameter is
    /// not needed, and the value is the share of the way to their estimates.
    ///
    /// # Errors
    /// [`GapError::Unknown`] for unknown names, [`GapError::Log`] for a value that is not finite.
    pub fn set(&mut self, effect: &str, parameter: &str, value: f64) -> Result<()> {
        if !value.is_finite() {
            return Err(GapError::Log {
                log: format!("{effect}.{parameter}"),
                expected: "a finite value".into(),
                found: value.to_string(),
                remedy: "give a number in SI units".into(),
            }
            .into());
        }
        let target = self.offered(effect)?;
        let base = self.now.base.clone();
        let mut setting = self.now.setting.clone();
        match target {
            Target::Group(group) => {
                setting.groups.retain(|g| *g != group);
                setting.groups.push(group);
                setting.shares.retain(|(g, _)| *g != group);
                setting.shares.push((group, value));
            }
            Target::Candidates(list) => {
                let found = list
                    .iter()
                    .flat_map(|c| base.model.of(*c).map(move |k| (*c, k)))
                    .find(|(_, k)| base.model.parameters[*k].name == parameter);
                let Some((c, k)) = found else {
                    let names = list.iter().flat_map(|c| base.model.of(*c));
                    let known: Vec<&str> = names.map(|k| base.model.parameters[k].name.as_str()).collect();
                    return Err(GapError::Unknown {
                        name: parameter.into(),
                        what: "parameter of this effect",
                        known: known.join(", "),
                    }
                    .into());
                };
                // The model divides by it: nearer to zero another vehicle flies, or none.
                if let Some(least) = base.model.least(k).filter(|least| value < *least) {
                    return Err(GapError::Log {
                        log: format!("{effect}.{parameter}"),
                        expected: format!("at least {least}"),
                        found: value.to_string(),
                        remedy: "give a larger value".into(),
                    }
                    .into());
                }
                for c in list.iter().filter(|x| !setting.on.contains(x)).copied().collect::<Vec<_>>() {
                    setting.on.push(c);
                }
                let fresh = !self.now.setting.on.contains(&c);
                if fresh {
                    setting = estimated(&base, setting)?;
                }
                setting.by_hand.retain(|x| *x != k);
                setting.by_hand.push(k);
                setting.values[k] = value;
                setting.sigma[k] = f64::NAN;
            }
        }
        self.take(format!("{effect} by hand"), base, setting);
        Ok(())
    }

    /// Says what a log is for. Nothing is fitted again by itself: what was found stays until [`Session::fit`] or
    /// [`Session::find`]; [`State::stale`] says so.
    ///
    /// # Errors
    /// [`GapError`] where no log would be left for the fit, or there is no such log.
    pub fn set_use(&mut self, flight: usize, used: Use) -> Result<()> {
        let mut uses = self.now.uses.clone();
        let count = uses.len();
        let place = uses.get_mut(flight).ok_or_else(|| GapError::Unknown {
            name: flight.to_string(),
            what: "flight of this session",
            known: format!("0 to {}", count.saturating_sub(1)),
        })?;
        if *place == used {
            return Ok(());
        }
        *place = used;
        let parted = Arc::new(parted(&self.tracks, &uses)?);
        let seen = Arc::new(live::judged_flights(&parted, &self.filed)?);
        let base = &self.now.base;
        // What is offered stays, on flights that are judged otherwise now.
        let mut shown = Live::over(&base.model, Vec::new(), &seen, (&self.filed, None))?;
        shown.judged_on = live::judged_on(&parted).into();
        let next = Base { live: Arc::new(shown), ..(**base).clone() };
        let name = self.tracks[flight].name.clone();
        let setting = self.now.setting.clone();
        let before: Vec<_> = base.live.effects.clone();
        let words = format!("{name} {}", if used == Use::Fit { "for the fit" } else { "for checking" });
        self.now.uses = uses;
        (self.now.parted, self.now.seen) = (parted, seen);
        self.now.base = Arc::new(next);
        for effect in before.iter().filter(|e| e.role != Role::Correction) {
            self.offered(&effect.id)?;
        }
        let base = self.now.base.clone();
        self.take(words, base, setting);
        Ok(())
    }

    /// A flight in the given room that would tell the effects that are on, and the look-alikes of findings, from each other:
    /// waypoints with the predicted path. `request` says room and sensors; what is wanted is filled in.
    ///
    /// # Errors
    /// Those of [`plan`], among them that nothing is on.
    pub fn next_flight(&self, request: &Request) -> Result<FlightPlan> {
        let base = &self.now.base;
        let mut want: Vec<String> =
            self.now.setting.on.iter().map(|c| base.model.candidates[*c].id.clone()).collect();
        let findings = self.verdict().map(|v| v.findings.as_slice()).unwrap_or_default();
        for f in
            findings.iter().filter(|f| want.is_empty() || want.contains(&f.id)).cloned().collect::<Vec<_>>()
        {
            let named = |id: &String| base.model.named().any(|c| base.model.candidates[c].id == *id);
            let alike = f.look_alikes.iter().flat_map(|l| l.ids.iter()).filter(|id| named(id)).cloned();
            for id in std::iter::once(f.id.clone()).chain(alike) {
                if !want.contains(&id) {
                    want.push(id);
                }
            }
        }
        let first = &self.tracks[0];
        let (sensors, drive) = (Sensors::of(first), first.drive);
        Ok(plan(&self.filed, &Request { want, sensors, drive, ..request.clone() })?)
    }
}

/// Linearisations of a search beyond those from the file, about.
const LATER: usize = 6;

/// The command in whose name files are written.
const BY: &str = "propwash add";

fn no_flight() -> GapError {
    GapError::Log {
        log: "the session".into(),
        expected: "at least one flight for the fit".into(),
        found: "none".into(),
        remedy: "open a log, or use one for the fit".into(),
    }
}

/// The flights by what they are for.
fn parted(tracks: &[Track], uses: &[Use]) -> Result<Flights, GapError> {
    let of = |wanted: Use| -> Vec<Track> {
        tracks.iter().zip(uses).filter(|(_, u)| **u == wanted).map(|(t, _)| t.clone()).collect()
    };
    let fit = of(Use::Fit);
    if fit.is_empty() {
        return Err(no_flight());
    }
    Ok(Flights::new(fit, of(Use::Check), HOLD_OUT))
}

fn prepared<'a>(parted: &'a Flights, drone: &propwash_physics::drone::Drone<f64>) -> Vec<Prepared<'a>> {
    use rayon::prelude::*;
    parted.fit.par_iter().map(|t| Prepared::new(t, drone)).collect()
}

fn model_of(
    logs: &[Prepared],
    drone: &propwash_physics::drone::Drone<f64>,
    vehicle: &Vehicle,
) -> Result<Model, GapError> {
    let tracks: Vec<&Track> = logs.iter().map(|l| l.track).collect();
    let arounds: Vec<_> = logs.iter().map(|l| &*l.around).collect();
    Ok(Model::new(drone, &tracks, &arounds)?.held_to(vehicle))
}

/// A setting with everything at its estimate beside the effects that are on, but for what was set by hand.
fn estimated(base: &Base, mut setting: present::Setting) -> Result<present::Setting, GapError> {
    setting.values.resize(base.model.parameters.len(), 0.0);
    setting.sigma.resize(base.model.parameters.len(), f64::NAN);
    let Some(fit) = &base.fit else {
        return Ok(present::without_fit(base, setting));
    };
    let known = fit.diagnosed.model.candidates.len();
    let set: Vec<usize> = setting.set().into_iter().filter(|c| *c < known).collect();
    let posterior = if set == fit.solution().set {
        fit.solution().posterior.clone()
    } else {
        fit.solution().of_set(&fit.diagnosed.model, &fit.all, &set)?
    };
    for (k, mean) in posterior.mean.iter().enumerate().filter(|(k, _)| !setting.by_hand.contains(k)) {
        setting.values[k] = *mean;
        setting.sigma[k] = posterior.sigma[k];
    }
    Ok(present::without_fit_of(base, known, setting))
}
