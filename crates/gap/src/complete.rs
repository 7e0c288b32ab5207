//! Writes a verdict's effects and calibration into a vehicle, step by step, so that a ladder shows exactly what the file
//! holds.

use super::accept::{self, AcceptError, FittedEffect, FittedParameter, Source};
use super::diagnose::Diagnosed;
use super::policy::NO_INFLUENCE_SIGMAS;
use super::verdict::{Calibration, Finding, ParameterFit};
use propwash_physics::effects::{Area, Group, nature};
use propwash_vehicle::{DYNAMICS, Vehicle};
use std::collections::BTreeSet;

/// An effect is undetermined if the data narrow none of its parameters below this share of its plausible size.
const UNDETERMINED: f64 = 0.7;

/// An effect to be written into a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Candidate id, or `calibration`.
    pub id: String,
    /// Effect kind.
    pub kind: String,
    /// Fitted parameters.
    pub parameters: Vec<ParameterFit>,
    /// Parameters that were set, not fitted, SI.
    pub set: Vec<(String, f64)>,
    /// Whether it describes sensors, which are common to all dynamics.
    pub sensor: bool,
    /// Note for the reader.
    pub note: Option<String>,
}

impl Entry {
    /// A finding.
    pub fn of(f: &Finding) -> Self {
        let sensor = f.area == Area::Measurement;
        Self {
            id: f.id.clone(),
            kind: f.kind.clone(),
            parameters: f.parameters.clone(),
            set: f.set.clone(),
            sensor,
            note: note(sensor, &f.kind),
        }
    }
}

/// Note on a finding that is not a property of the vehicle.
pub fn note(sensor: bool, kind: &str) -> Option<String> {
    if sensor {
        return Some("of the sensors that made the log".into());
    }
    nature(kind).of_the_flight.then(|| "of the flight that it was fitted to".into())
}

/// Tolerance parameters that the log moves, by effect. Parameters fitted together are never split: an effect is included
/// whole or, where all of it has practically no influence (`NO_INFLUENCE_SIGMAS`), not at all.
pub fn calibration(adjusted: &[Calibration]) -> Vec<Entry> {
    let mut out: Vec<Entry> = Vec::new();
    for c in adjusted {
        if nature(&c.kind).only_when_found {
            continue;
        }
        let p = &c.parameter;
        match out.iter_mut().find(|e| e.kind == c.kind && e.id == own_id(c)) {
            Some(entry) => {
                entry.parameters.push(p.clone());
                let new: Vec<_> = c.set.iter().filter(|s| !entry.set.contains(s)).cloned().collect();
                entry.set.extend(new);
            }
            None => out.push(Entry {
                id: own_id(c),
                kind: c.kind.clone(),
                parameters: vec![p.clone()],
                set: c.set.clone(),
                sensor: c.area == Area::Measurement,
                note: Some("within tolerance, adjusted".into()),
            }),
        }
    }
    out.retain(has_influence);
    for entry in &mut out {
        // A value that the fit moves itself does not count as set.
        let Entry { parameters, set, .. } = entry;
        set.retain(|(name, _)| parameters.iter().all(|p| p.name != *name));
    }
    out
}

/// Whether the parameters of an entry together differ from the file by more than chance.
fn has_influence(entry: &Entry) -> bool {
    let off: Vec<f64> = entry
        .parameters
        .iter()
        .filter(|p| p.value != p.filed && p.sigma > 0.0)
        .map(|p| (p.value - p.filed) / p.sigma)
        .collect();
    let square = off.iter().map(|z| z * z).sum::<f64>() / off.len().max(1) as f64;
    square.sqrt() > NO_INFLUENCE_SIGMAS
}

/// The group of calibration to which an effect belongs.
pub fn group(kind: &str, area: Area) -> Group {
    nature(kind).group.unwrap_or(Group::of(area))
}

/// User-defined expressions are distinguished by their id.
fn own_id(c: &Calibration) -> String {
    if c.kind == "expression" { c.id.clone() } else { "calibration".into() }
}

/// A vehicle file's text being completed.
#[derive(Clone, Debug)]
pub struct Completion {
    /// The text.
    pub text: String,
    /// Parameters left at their nominal value, and why.
    pub remarks: Vec<String>,
    label: String,
    dynamics: String,
    only_dynamics: bool,
    source: Source,
}

impl Completion {
    /// Starts from the file text of `vehicle`; `label` names it in messages.
    pub fn new(vehicle: &Vehicle, text: String, label: &str, dynamics: &str, source: Source) -> Self {
        let n = DYNAMICS.iter().filter(|d| vehicle.drone(d).is_ok()).count();
        Self {
            text,
            remarks: Vec::new(),
            label: label.into(),
            dynamics: dynamics.into(),
            only_dynamics: n == 1,
            source,
        }
    }

    /// Adds an effect. A physically impossible value stays nominal where the fit allows that (within one standard
    /// deviation), which is stated in the remarks.
    ///
    /// # Errors
    /// [`AcceptError`]; the text is then unchanged.
    pub fn add(&mut self, entry: &Entry) -> Result<(), AcceptError> {
        self.put(entry, true)
    }

    /// Adds an effect; without `bend`, all of its values are written or none.
    fn put(&mut self, entry: &Entry, bend: bool) -> Result<(), AcceptError> {
        let mut parameters = entry.parameters.clone();
        loop {
            let fitted = parameters.iter().map(|p| FittedParameter {
                name: p.name.clone(),
                value: p.value,
                // An estimate at a one-sided bound is not a measurement.
                sigma: if p.sigma > 0.0 { p.sigma } else { f64::NAN },
            });
            let set = entry.set.iter().map(|(name, value)| FittedParameter {
                name: name.clone(),
                value: *value,
                sigma: f64::NAN,
            });
            let effect = FittedEffect {
                kind: entry.kind.clone(),
                models: (!entry.sensor && !self.only_dynamics).then(|| vec![self.dynamics.clone()]),
                parameters: fitted.chain(set).collect(),
                note: entry.note.clone(),
            };
            let added = if entry.kind == "expression" {
                let (text, source) = (&self.text, &self.source);
                accept::set_expression(text, &self.label, &entry.id, &effect.parameters, source)
            } else {
                accept::add(&self.text, &self.label, &[effect], &self.source)
            };
            match added {
                Ok(text) => {
                    self.text = text;
                    return Ok(());
                }
                Err(AcceptError::OutOfRange { effect, parameter, expected, found }) => {
                    let near = |p: &&mut ParameterFit| {
                        bend && p.name == parameter
                            && p.value != p.filed
                            && (p.sigma <= 0.0 || (p.value - p.filed).abs() <= p.sigma)
                    };
                    let Some(p) = parameters.iter_mut().find(near) else {
                        return Err(AcceptError::OutOfRange { effect, parameter, expected, found });
                    };
                    let remark = format!(
                        "{}: {} stays at {} (fitted {}, expected {expected})",
                        entry.kind,
                        p.name,
                        p.filed,
                        short(&found)
                    );
                    // The effect is retried without each physically impossible number.
                    if !self.remarks.contains(&remark) {
                        self.remarks.push(remark);
                    }
                    p.value = p.filed;
                    p.sigma = f64::NAN;
                }
                Err(other) => return Err(other),
            }
        }
    }

    /// Adds the calibration and returns its number of parameters. An effect with a physically impossible value is left
    /// nominal as a whole, since its other values only hold together with that one.
    ///
    /// # Errors
    /// [`AcceptError`], except for values out of range.
    pub fn calibrate(&mut self, adjusted: &[Calibration]) -> Result<usize, AcceptError> {
        let mut n = 0;
        for entry in calibration(adjusted) {
            match self.put(&entry, false) {
                Ok(()) => n += entry.parameters.len(),
                Err(AcceptError::OutOfRange { parameter, expected, found, .. }) => {
                    self.remarks.push(format!(
                        "{}: stays as filed (the fit gives {parameter} = {}, expected {expected})",
                        entry.kind,
                        short(&found)
                    ));
                }
                Err(other) => return Err(other),
            }
        }
        Ok(n)
    }

    /// Writes the parameters of `adjusted` that were fitted together with the findings, where the findings alone raise an
    /// error. Returns the names of their groups; none if there are none.
    ///
    /// # Errors
    /// As [`Completion::calibrate`].
    pub fn partners(&mut self, adjusted: &[Calibration]) -> Result<Option<String>, AcceptError> {
        let list: Vec<Calibration> = adjusted.iter().filter(|c| c.partner).cloned().collect();
        if self.calibrate(&list)? == 0 {
            return Ok(None);
        }
        let groups: BTreeSet<Group> = list.iter().map(|c| group(&c.kind, c.area)).collect();
        let names: Vec<&str> = groups.into_iter().map(Group::name).collect();
        let names = names.join(", ");
        self.remarks.push(format!(
            "{names}: written with what was found, since they were fitted together and an error on unseen flight rises without"
        ));
        Ok(Some(names))
    }

    /// The vehicle described by the text, under the name of `like`.
    ///
    /// # Errors
    /// [`AcceptError::Vehicle`].
    pub fn vehicle(&self, like: &Vehicle) -> Result<Vehicle, AcceptError> {
        Ok(Vehicle::from_toml(&like.name, &self.text)?)
    }
}

/// A finding that the data do not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Undetermined {
    /// Candidate id.
    pub id: String,
    /// Its parameters with their standard deviations and plausible sizes, in words.
    pub found: String,
    /// Manoeuvre that would determine it.
    pub manoeuvre: String,
}

impl Diagnosed {
    /// Findings none of whose parameters the data narrow below 0.7 of its plausible size, or whose estimate is physically
    /// impossible.
    pub fn undetermined(&self) -> Vec<Undetermined> {
        let mut out = Vec::new();
        for c in &self.solution.set {
            let sigma = |k: usize| self.solution.posterior.sigma[k];
            let open = |k: usize| sigma(k) >= UNDETERMINED * self.model.parameters[k].slab;
            // An estimate at a one-sided bound has no width.
            let held = |k: usize| sigma(k) <= 0.0;
            if !self.model.of(*c).all(|k| open(k) || held(k)) {
                continue;
            }
            let found: Vec<String> = self
                .model
                .of(*c)
                .map(|k| {
                    let p = &self.model.parameters[k];
                    let unit = if p.unit == "1" { "" } else { p.unit };
                    if held(k) {
                        return format!(
                            "{} would have to be on the wrong side of {:e} {unit}",
                            p.name, p.filed
                        );
                    }
                    let sigma = sigma(k);
                    format!("{} ± {sigma:.3e} {unit} where {:.3e} is a plausible size", p.name, p.slab)
                })
                .collect();
            let candidate = &self.model.candidates[*c];
            out.push(Undetermined {
                id: candidate.id.clone(),
                found: found.join(", "),
                manoeuvre: candidate.manoeuvre.into(),
            });
        }
        out
    }
}

/// A number in a message, rounded for the reader.
fn short(number: &str) -> String {
    number.parse::<f64>().map_or_else(|_| number.to_string(), |v| format!("{v:.2e}"))
}
