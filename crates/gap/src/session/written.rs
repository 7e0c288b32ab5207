//! Values into the text of a vehicle file, without a fit: what a session saves, and what `propwash add --set` writes.

use super::own::{Axis, Own, with_all};
use crate::GapError;
use crate::complete::{Completion, Entry, note};
use crate::error::Result;
use crate::fit::Prepared;
use crate::fitted::{Filed, source};
use crate::ladder::Flights;
use crate::model::Model;
use crate::replay::drone_for;
use crate::verdict::{Calibration, ParameterFit};
use propwash_physics::effects::Area;
use propwash_vehicle::Vehicle;
use std::fmt;
use std::str::FromStr;

/// A parameter with its value, as `propwash add --set` takes it: `rotor_drag:drag_n_s2_per_rad_m=6.5e-5+-2.7e-6`.
#[derive(Clone, Debug, PartialEq)]
pub struct Put {
    /// Candidate id.
    pub id: String,
    /// Name of the parameter within its effect.
    pub parameter: String,
    /// Value, SI.
    pub value: f64,
    /// Standard deviation, SI; none for a value that was set and not fitted.
    pub sigma: Option<f64>,
    /// Whether it is a small correction within tolerance, and no effect that was missing.
    pub correction: bool,
}

impl fmt::Display for Put {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}:{}={:e}", self.id, self.parameter, self.value)?;
        match self.sigma {
            Some(sigma) => write!(f, "+-{sigma:e}"),
            None => Ok(()),
        }
    }
}

impl FromStr for Put {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("expected EFFECT:PARAMETER=VALUE or EFFECT:PARAMETER=VALUE+-SIGMA (SI), got {text:?}");
        let (name, number) = text.split_once('=').ok_or_else(wrong)?;
        let (id, parameter) = name.split_once(':').ok_or_else(wrong)?;
        let (value, sigma) = match number.split_once("+-") {
            Some((value, sigma)) => (value, Some(sigma)),
            None => (number, None),
        };
        let number = |t: &str| t.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong);
        let sigma = sigma.map(number).transpose()?;
        if id.is_empty() || parameter.is_empty() || sigma.is_some_and(|s| s <= 0.0) {
            return Err(wrong());
        }
        Ok(Self {
            id: id.into(),
            parameter: parameter.into(),
            value: number(value)?,
            sigma,
            correction: false,
        })
    }
}

/// An own expression, as `propwash add --expression` takes it: `own_1:force_body_x:0.35:-k * vx_body`, with the plausible size of
/// its coefficient.
pub(super) fn expression_words(own: &Own) -> String {
    format!("{}:{}:{:e}:{}", own.name, own.axis.name(), own.slab(), own.text)
}

/// Reads [`expression_words`].
pub(super) fn expression_of(text: &str) -> Result<Own, GapError> {
    let parts: Vec<&str> = text.splitn(4, ':').collect();
    let [name, axis, slab, formula] = parts[..] else {
        return Err(GapError::Unknown {
            name: text.into(),
            what: "own expression",
            known: "NAME:AXIS:SIZE:TEXT, as own_1:force_body_x:0.35:-k * vx_body".into(),
        });
    };
    let size = slab.parse::<f64>().ok().filter(|s| s.is_finite() && *s > 0.0);
    let size = size.ok_or_else(|| GapError::Unknown {
        name: slab.into(),
        what: "plausible size of a coefficient",
        known: "numbers above 0".into(),
    })?;
    Own::new(name, Axis::named(axis)?, formula, size)
}

/// A vehicle file's text with values of effects written into it, with the provenance of `flights`: `by` names the command.
/// `expressions` are own ones, as `propwash add --expression` takes them. Gives the text, the vehicle, and remarks.
///
/// # Errors
/// For unknown names, and for what a vehicle file cannot hold.
pub fn completed_by(
    filed: &Filed,
    flights: &Flights,
    by: &str,
    puts: &[Put],
    expressions: &[String],
) -> Result<(String, Vehicle, Vec<String>)> {
    let own: Vec<Own> = expressions.iter().map(|e| expression_of(e)).collect::<Result<_, _>>()?;
    let text = with_all(filed.label, &filed.text, &own)?;
    let vehicle = Vehicle::from_toml(&filed.vehicle.name, &text)?;
    let Some(first) = flights.fit.first() else { return Err(super::no_flight().into()) };
    let drone = drone_for(first, &vehicle)?;
    let logs: Vec<Prepared> = flights.fit.iter().map(|t| Prepared::new(t, &drone)).collect();
    let model = super::model_of(&logs, &drone, &vehicle)?;
    let (entries, corrections) = sorted(&model, puts)?;
    let mut completion = Completion::new(&vehicle, text, filed.label, first.dynamics, source(flights, by));
    for entry in &entries {
        completion.add(entry)?;
    }
    completion.calibrate(&corrections)?;
    let after = completion.vehicle(filed.vehicle)?;
    Ok((completion.text, after, completion.remarks))
}

/// The candidate that a value belongs to, and its parameter; none where the value is one of those that the candidate presets.
fn place_of(model: &Model, put: &Put) -> Result<(usize, Option<usize>), GapError> {
    let found = model.named().find(|c| model.candidates[*c].id == put.id);
    let Some(c) = found else {
        let known: Vec<&str> = model.named().map(|c| model.candidates[c].id.as_str()).collect();
        return Err(GapError::Unknown {
            name: put.id.clone(),
            what: "effect that these flights can show",
            known: known.join(", "),
        });
    };
    let parameter = model.of(c).find(|k| model.parameters[*k].name == put.parameter);
    let preset = model.candidates[c].preset.iter().any(|(name, _)| *name == put.parameter);
    if parameter.is_none() && !preset {
        let known: Vec<&str> = model.of(c).map(|k| model.parameters[k].name.as_str()).collect();
        return Err(GapError::Unknown {
            name: put.parameter.clone(),
            what: "parameter of this effect",
            known: known.join(", "),
        });
    }
    Ok((c, parameter))
}

/// Values as entries of a file: effects in the order in which they come, and small corrections.
fn sorted(model: &Model, puts: &[Put]) -> Result<(Vec<Entry>, Vec<Calibration>), GapError> {
    let (mut entries, mut corrections): (Vec<Entry>, Vec<Calibration>) = Default::default();
    for put in puts {
        let (c, parameter) = place_of(model, put)?;
        let candidate = &model.candidates[c];
        let fit = |k: usize| {
            let p = &model.parameters[k];
            ParameterFit {
                name: p.name.clone(),
                unit: p.unit.into(),
                filed: p.filed,
                value: put.value,
                sigma: put.sigma.unwrap_or(f64::NAN),
            }
        };
        if put.correction {
            match parameter {
                Some(k) => corrections.push(Calibration {
                    id: candidate.id.clone(),
                    kind: candidate.kind.into(),
                    area: candidate.area,
                    parameter: fit(k),
                    set: Vec::new(),
                    tolerance: model.parameters[k].spike,
                    helps: true,
                    partner: false,
                }),
                None => corrections
                    .iter_mut()
                    .filter(|c| c.id == put.id)
                    .for_each(|c| c.set.push((put.parameter.clone(), put.value))),
            }
            continue;
        }
        let sensor = candidate.area == Area::Measurement;
        let entry = match entries.iter_mut().position(|e| e.id == put.id) {
            Some(i) => &mut entries[i],
            None => {
                entries.push(Entry {
                    id: candidate.id.clone(),
                    kind: candidate.kind.into(),
                    parameters: Vec::new(),
                    set: Vec::new(),
                    sensor,
                    note: note(sensor, candidate.kind),
                });
                let last = entries.len() - 1;
                &mut entries[last]
            }
        };
        match parameter {
            Some(k) => {
                if put.sigma.is_none() {
                    let hand = format!("{} set by hand", put.parameter);
                    entry.note = Some(entry.note.take().map_or(hand.clone(), |n| format!("{n}; {hand}")));
                }
                entry.parameters.push(fit(k));
            }
            None => entry.set.push((put.parameter.clone(), put.value)),
        }
    }
    Ok((entries, corrections))
}
