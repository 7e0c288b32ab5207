//! Values that the vehicle file states with a standard deviation, such as a weighed mass: the prior of the parameters that scale
//! them. What was measured is held to its measurement, and never named as what is missing.
//!
//! A sigma that a fit wrote says how well *those* flights determined an effect, not how well it is known on the next one: it is
//! no prior.

use super::model::{Model, Parameter};
use super::policy::AGAINST_STATED_SIGMAS;
use propwash_physics::effects::Filed;
use propwash_vehicle::{Provenance, Vehicle};
use std::collections::BTreeMap;

/// What the file states of a parameter of the model.
struct Prior {
    /// Standard deviation of the parameter, SI.
    sigma: f64,
    /// In the file's words: `body.mass_kg = 0.0328 ± 0.0001`.
    words: String,
}

/// A candidate that is held to what the file states.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Held {
    /// Index of the candidate.
    pub candidate: usize,
    /// What the file states.
    pub words: String,
}

impl Model {
    /// Holds the parameters that scale values with a stated standard deviation to these: it is their prior, and candidates of
    /// which all parameters are held are not searched.
    pub fn held_to(mut self, vehicle: &Vehicle) -> Self {
        let provenance = vehicle.provenance();
        let stated = Stated {
            values: provenance.iter().map(|p| (p.key.as_str(), p)).collect(),
            vehicle,
            hover_rad_s: self.drone.hover_rotor_vel()[0],
        };
        for c in 0..self.candidates.len() {
            let (kind, own) = (self.candidates[c].kind, self.of(c).collect::<Vec<_>>());
            let priors: Vec<_> = own.iter().map(|k| stated.prior(kind, &self.parameters[*k])).collect();
            for (k, prior) in own.iter().zip(&priors) {
                let Some(prior) = prior else { continue };
                let p = &mut self.parameters[*k];
                p.back *= p.slab / prior.sigma;
                (p.spike, p.slab) = (prior.sigma, prior.sigma);
            }
            let words: Option<Vec<&str>> = priors.iter().map(|p| Some(p.as_ref()?.words.as_str())).collect();
            if let Some(words) = words.filter(|w| !w.is_empty()) {
                self.may[c] = false;
                self.held.push(Held { candidate: c, words: words.join(", ") });
            }
        }
        self
    }

    /// What is held to the file, in words, and where the flights pull at it.
    pub fn say_held(&self, mean: &[f64]) -> Vec<String> {
        self.held
            .iter()
            .map(|held| {
                let off = self.of(held.candidate).map(|k| {
                    let p = &self.parameters[k];
                    (mean[k] - p.filed) / p.spike
                });
                let off = off.max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
                let id = &self.candidates[held.candidate].id;
                if off.abs() > AGAINST_STATED_SIGMAS {
                    format!(
                        "the file states {}, but these flights put it {:.1} of its sigmas {} ({id}): measure it again, or \
                         leave out its sigma so that it is searched",
                        held.words,
                        off.abs(),
                        if off > 0.0 { "higher" } else { "lower" },
                    )
                } else {
                    format!("the file states {}: held to that, {id} was not searched", held.words)
                }
            })
            .collect()
    }
}

/// The values of a vehicle file.
struct Stated<'a> {
    values: BTreeMap<&'a str, &'a Provenance>,
    vehicle: &'a Vehicle,
    hover_rad_s: f64,
}

impl Stated<'_> {
    /// The prior of a parameter of a kind of effects, where the file states what it scales or, for an effect of the file, itself.
    fn prior(&self, kind: &str, parameter: &Parameter) -> Option<Prior> {
        let Some(filed) = parameter.scales else { return self.of_effect(kind, &parameter.name) };
        match filed {
            Filed::Mass => self.share("body.mass_kg", &[]),
            Filed::Inertia(axis) => self.share("body.inertia_kg_m2", &[axis, axis]),
            Filed::Thrust => self.curve(&["thrust_curve_n_per_rad_s", "thrust_curve_n_per_rpm"]),
            Filed::Torque => self
                .curve(&["torque_curve_n_m_per_rad_s", "torque_curve_n_m_per_rpm"])
                .or_else(|| self.share("rotor_default.torque_per_thrust_m", &[])),
            Filed::RotorInertia => self.share("rotor_default.inertia_kg_m2", &[]),
            Filed::SpinUp => self.share("rotor_default.time_constant_up_s", &[]),
            Filed::SpinDown => self.share("rotor_default.time_constant_down_s", &[]),
        }
    }

    /// Relative standard deviation of a number, by its indices in an array.
    fn share(&self, key: &str, at: &[usize]) -> Option<Prior> {
        let (value, sigma) = self.number(key, at)?;
        (value != 0.0).then(|| Prior { sigma: (sigma / value).abs(), words: said(key, at, value, sigma) })
    }

    /// Relative standard deviation at hover of a curve c0 + c1 n + c2 n² of all rotors, by the first key that states one.
    fn curve(&self, keys: &[&str]) -> Option<Prior> {
        keys.iter().find_map(|name| {
            let key = format!("rotor_default.{name}");
            let n = if name.ends_with("rpm") {
                self.hover_rad_s * 30.0 / std::f64::consts::PI
            } else {
                self.hover_rad_s
            };
            let (mut value, mut variance) = (0.0, 0.0);
            for (i, power) in [1.0, n, n * n].into_iter().enumerate() {
                let stated = self.number(&key, &[i]);
                value += power * stated.map_or_else(|| self.value(&key, &[i]), |s| Some(s.0))?;
                variance += (power * stated.map_or(0.0, |s| s.1)).powi(2);
            }
            let sigma = variance.sqrt() / value.abs();
            let words = format!("{key} within {:.2} % at hover", 100.0 * sigma);
            (sigma > 0.0 && sigma.is_finite()).then_some(Prior { sigma, words })
        })
    }

    /// Standard deviation of an effect's own parameter, unless a fit wrote it.
    fn of_effect(&self, kind: &str, parameter: &str) -> Option<Prior> {
        let index = self
            .vehicle
            .file()
            .effect
            .iter()
            .position(|e| e.kind == kind && e.source_log_sha256.is_none())?;
        let mut parts = parameter.split('.');
        let key = format!("effect.{index}.{}", parts.next()?);
        let at: Vec<usize> = parts.map(|p| p.parse().ok()).collect::<Option<_>>()?;
        let (value, sigma) = self.number(&key, &at)?;
        Some(Prior { sigma, words: said(&key, &at, value, sigma) })
    }

    fn value(&self, key: &str, at: &[usize]) -> Option<f64> {
        within(&self.values.get(key)?.value, at)
    }

    /// A value and its standard deviation, where both are stated and the second is not zero.
    fn number(&self, key: &str, at: &[usize]) -> Option<(f64, f64)> {
        let sigma = within(self.values.get(key)?.sigma.as_ref()?, at)?;
        let value = self.value(key, at)?;
        (sigma > 0.0 && sigma.is_finite() && value.is_finite()).then_some((value, sigma))
    }
}

fn said(key: &str, at: &[usize], value: f64, sigma: f64) -> String {
    let place: String = at.iter().map(|i| format!(".{i}")).collect();
    format!("{key}{place} = {value} ± {sigma}")
}

/// A number of nested arrays, or of a table by index.
fn within(value: &toml::Value, at: &[usize]) -> Option<f64> {
    match (value, at) {
        (toml::Value::Float(v), []) => Some(*v),
        (toml::Value::Integer(v), []) => Some(*v as f64),
        (toml::Value::Array(items), [first, rest @ ..]) => within(items.get(*first)?, rest),
        (toml::Value::Table(table), [first, rest @ ..]) => within(table.get(&first.to_string())?, rest),
        _ => None,
    }
}
