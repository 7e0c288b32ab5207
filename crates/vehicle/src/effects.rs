//! `[[effect]]` entries: any effect of [`propwash_physics::effects`] by the names of its parameters, so that a new effect
//! needs no change here.

use super::DYNAMICS;
use super::error::VehicleError;
use super::expression;
use super::file::{Check, join, shape};
use super::network;
use super::schema::EffectEntry;
use propwash_physics::effects::{AnyEffect, Bounds, Effect, kinds};
use propwash_physics::params::Parameters;
use std::collections::BTreeMap;

/// One effect and the dynamics that have it (`None`: all).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ListedEffect {
    pub models: Option<Vec<String>>,
    pub effect: AnyEffect<f64>,
}

impl ListedEffect {
    /// Whether the dynamics called `name` have the effect.
    pub(super) fn belongs_to(&self, name: &str) -> bool {
        self.models.as_ref().is_none_or(|models| models.iter().any(|m| m == name))
    }
}

impl Check<'_> {
    /// All effects of the file.
    pub(super) fn effects(&self, entries: &[EffectEntry]) -> Result<Vec<ListedEffect>, VehicleError> {
        let mut out = Vec::new();
        let mut seen: BTreeMap<(String, &str), usize> = BTreeMap::new();
        for (i, entry) in entries.iter().enumerate() {
            let key = format!("effect.{i}");
            if let Some(models) = &entry.models {
                let known = DYNAMICS.join(", ");
                if models.is_empty() {
                    return Err(self.wrong(
                        format!("{key}.models"),
                        &format!("at least one of {known}"),
                        "an empty list",
                        "name the dynamics that have the effect, or remove the key for all",
                    ));
                }
                for (k, model) in models.iter().enumerate() {
                    if !DYNAMICS.contains(&model.as_str()) {
                        let place = format!("{key}.models.{k}");
                        return Err(self.wrong(place, &format!("one of {known}"), model, "correct the name"));
                    }
                }
            }
            let effect = self.effect(&key, entry)?;
            for model in DYNAMICS {
                let has = entry.models.as_ref().is_none_or(|m| m.iter().any(|name| name == model));
                if has && seen.insert((effect.label(), model), i).is_some() {
                    return Err(self.wrong(
                        format!("{key}.kind"),
                        &format!("each effect once for {model}"),
                        format!("{} a second time", effect.label()),
                        "merge the two entries, or part them with `models`",
                    ));
                }
            }
            out.push(ListedEffect { models: entry.models.clone(), effect });
        }
        Ok(out)
    }

    fn effect(&self, key: &str, entry: &EffectEntry) -> Result<AnyEffect<f64>, VehicleError> {
        let Some(mut effect) = AnyEffect::by_kind(&entry.kind) else {
            let expected = format!("one of {}", kinds().join(", "));
            return Err(self.wrong(
                format!("{key}.kind"),
                &expected,
                &entry.kind,
                "correct the name of the effect",
            ));
        };
        if entry.kind == expression::KIND {
            return self.formula(key, entry);
        }
        if entry.kind == network::KIND {
            return self.network(key, entry);
        }
        let mut names: Vec<String> = Vec::new();
        effect.visit("", &mut |name, _| names.push(name.trim_start_matches('.').to_string()));
        let mut values: BTreeMap<String, f64> = BTreeMap::new();
        for (param, value) in &entry.params {
            let own: Vec<&str> = names.iter().filter_map(|n| index_of(n, param)).collect();
            if own.is_empty() {
                let mut known: Vec<&str> = names.iter().map(|n| n.split('.').next().unwrap_or(n)).collect();
                known.dedup();
                let expected = format!(
                    "a parameter of {} ({}) or one of kind, models, source, source_log_sha256, date, note, sigma",
                    entry.kind,
                    known.join(", ")
                );
                return Err(self.wrong(
                    format!("{key}.{param}"),
                    &expected,
                    "an unknown key",
                    "correct or remove the key",
                ));
            }
            let mut numbers = Vec::new();
            self.numbers(&format!("{key}.{param}"), "", value, &mut numbers)?;
            if !own.iter().copied().eq(numbers.iter().map(|(i, _)| i.as_str())) {
                return Err(self.wrong(
                    format!("{key}.{param}"),
                    &shape(own.iter().copied()),
                    shape(numbers.iter().map(|(i, _)| i.as_str())),
                    "write as many numbers as the parameter has",
                ));
            }
            values.extend(numbers.into_iter().map(|(index, v)| (join(param, &index), v)));
        }
        effect.visit("", &mut |name, slot| {
            if let Some(v) = values.get(name.trim_start_matches('.')) {
                *slot = *v;
            }
        });
        self.effect_range(key, &mut effect)?;
        Ok(effect)
    }

    /// Refuses parameters outside the bounds of [`out_of_range`].
    fn effect_range(&self, key: &str, effect: &mut AnyEffect<f64>) -> Result<(), VehicleError> {
        match out_of_range(effect) {
            None => Ok(()),
            Some(fault) => Err(self.wrong(
                format!("{key}.{}", fault.parameter),
                &fault.expected,
                fault.found,
                "write a value in this range",
            )),
        }
    }
}

/// A parameter of an effect outside the bounds within which its formula holds.
#[derive(Clone, Debug, PartialEq)]
pub struct OutOfRange {
    /// The parameter.
    pub parameter: String,
    /// What it may be, in words.
    pub expected: String,
    /// What it is.
    pub found: f64,
}

impl OutOfRange {
    fn new(parameter: &str, bounds: &Bounds, found: f64) -> Self {
        Self { parameter: parameter.into(), expected: bounds.words(), found }
    }
}

/// The first parameter of an effect outside the bounds within which its formula holds.
pub fn out_of_range(effect: &mut AnyEffect<f64>) -> Option<OutOfRange> {
    let ranges = effect.ranges();
    let mut found = None;
    if let AnyEffect::Expression(p) = effect {
        let faults = p.formula.parameters.iter().zip(p.value).filter(|(d, v)| !d.bounds.holds(*v));
        found = faults.map(|(d, v)| OutOfRange::new(&d.freedom.name, &d.bounds, v)).next();
    }
    effect.visit("", &mut |name, value| {
        let name = name.trim_start_matches('.');
        for (param, bounds) in ranges {
            if index_of(name, param).is_some() && !bounds.holds(*value) {
                found.get_or_insert(OutOfRange::new(name, bounds, *value));
            }
        }
    });
    found
}

/// The indices of the visited `name` within parameter `param`, if it belongs to it.
fn index_of<'a>(name: &'a str, param: &str) -> Option<&'a str> {
    let rest = name.strip_prefix(param)?;
    if rest.is_empty() { Some("") } else { rest.strip_prefix('.') }
}

/// Names of the parameters of an effect as [`Parameters::visit`] gives them without prefix (`factor.2`), with their values.
pub fn named_parameters(effect: &AnyEffect<f64>) -> Vec<(String, f64)> {
    let mut out = Vec::new();
    let mut effect = *effect;
    effect.visit("", &mut |name, value| out.push((name.trim_start_matches('.').to_string(), *value)));
    out
}
