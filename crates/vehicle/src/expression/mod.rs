//! `[[effect]]` entries of kind `expression`: a user's own effect, from text to a program; `docs/effects/expression.md`.

mod cost;
mod given;
mod parser;
mod sheet;
#[cfg(test)]
mod tests;

pub use cost::{Cost, Read};
pub use parser::{ExpressionError, parse, parse_names};
pub use sheet::Sheet;

use super::error::VehicleError;
use super::file::{Check, join};
use super::provenance::META;
use super::schema::EffectEntry;
use parser::{FUNCTIONS, is_name};
use propwash_physics::effects::candidate::{Bounds, Freedom, Sign};
use propwash_physics::effects::expression::{Declared, Formula, MAX_PARAMETERS, VARIABLES};
use propwash_physics::effects::kinds;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Kind of these entries.
pub(super) const KIND: &str = "expression";

/// The formula with this content, kept once for as long as the program runs: the same content gives the same reference.
/// A program that reads ever new formulas therefore grows by each of them.
pub fn intern(formula: Formula) -> &'static Formula {
    static KNOWN: Mutex<Vec<&'static Formula>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(same) = known.iter().find(|f| ***f == formula) {
        return same;
    }
    let kept: &'static Formula = Box::leak(Box::new(formula));
    known.push(kept);
    kept
}

/// The text, kept once for as long as the program runs.
pub(super) fn intern_text(text: &str) -> &'static str {
    static KNOWN: Mutex<Vec<&'static str>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(same) = known.iter().find(|t| **t == text) {
        return same;
    }
    let kept: &'static str = Box::leak(text.to_string().into_boxed_str());
    known.push(kept);
    kept
}

/// Writes the value of a parameter into an entry of kind `expression`, with its standard deviation where known. Says whether
/// the entry has the parameter.
pub fn set_parameter(entry: &mut EffectEntry, name: &str, value: f64, sigma: Option<f64>) -> bool {
    let tables = entry.params.get_mut("parameter").and_then(toml::Value::as_table_mut);
    let Some(table) = tables.and_then(|t| t.get_mut(name)).and_then(toml::Value::as_table_mut) else {
        return false;
    };
    table.insert("value".into(), toml::Value::Float(value));
    table.remove("sigma");
    if let Some(sigma) = sigma {
        let of = toml::Table::from_iter([("value".to_string(), toml::Value::Float(sigma))]);
        table.insert("sigma".into(), toml::Value::Table(of));
    }
    true
}

/// A name that can stand between dots and in expressions.
pub(super) fn is_identifier(name: &str) -> bool {
    name.chars().all(is_name) && name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
}

impl Check<'_> {
    fn expression_name(&self, key: &str, entry: &EffectEntry) -> Result<String, VehicleError> {
        let place = format!("{key}.name");
        let remedy = "write e.g. name = \"tether\": it is the effect's name in verdicts and parameters";
        let Some(name) = entry.params.get("name") else {
            return Err(self.wrong(place, "a name of the effect", "nothing", remedy));
        };
        let Some(name) = name.as_str().filter(|n| is_identifier(n)) else {
            let expected = "a name of letters, digits and underscores that begins with a letter";
            return Err(self.wrong(place, expected, name, remedy));
        };
        if kinds().contains(&name) {
            return Err(self.wrong(
                place,
                "a name that no built-in effect has",
                name,
                "choose another, so that verdicts can tell them apart",
            ));
        }
        Ok(name.to_string())
    }

    /// The declared parameters of an entry and their values.
    fn declared(
        &self,
        key: &str,
        entry: &EffectEntry,
    ) -> Result<(Vec<Declared>, [f64; MAX_PARAMETERS]), VehicleError> {
        let mut value = [0.0; MAX_PARAMETERS];
        let Some(tables) = entry.params.get("parameter") else { return Ok((Vec::new(), value)) };
        let Some(tables) = tables.as_table() else {
            return Err(self.wrong(
                format!("{key}.parameter"),
                "tables [effect.parameter.NAME]",
                format!("a {}", tables.type_str()),
                "write one table per parameter, with value and unit",
            ));
        };
        if tables.len() > MAX_PARAMETERS {
            return Err(self.wrong(
                format!("{key}.parameter"),
                &format!("at most {MAX_PARAMETERS} parameters"),
                tables.len(),
                "write constants as numbers, or part the effect in two",
            ));
        }
        let mut out = Vec::new();
        for (slot, (name, table)) in value.iter_mut().zip(tables) {
            let place = format!("{key}.parameter.{name}");
            let taken = VARIABLES.iter().any(|v| v.name == name)
                || FUNCTIONS.iter().any(|(f, ..)| f == name)
                || META.contains(&name.as_str());
            if taken || !is_identifier(name) {
                let expected =
                    "a name of letters, digits and underscores that no variable, function or key has";
                return Err(self.wrong(place, expected, name, "rename the parameter"));
            }
            let Some(table) = table.as_table() else {
                let found = format!("a {}", table.type_str());
                return Err(self.wrong(
                    place,
                    "a table with value and unit",
                    found,
                    "write { value = …, unit = \"…\" }",
                ));
            };
            let (declared, own) = self.declaration(&place, name, table)?;
            *slot = own;
            out.push(declared);
        }
        Ok((out, value))
    }

    fn declaration(
        &self,
        place: &str,
        name: &str,
        table: &toml::Table,
    ) -> Result<(Declared, f64), VehicleError> {
        const KEYS: [&str; 10] =
            ["value", "unit", "spike", "slab", "sign", "min", "max", "source", "note", "sigma"];
        if let Some(unknown) = table.keys().find(|k| !KEYS.contains(&k.as_str())) {
            return Err(self.wrong(
                join(place, unknown),
                &format!("one of {}", KEYS.join(", ")),
                "an unknown key",
                "correct or remove the key",
            ));
        }
        let numbers = self.declared_numbers(place, table)?;
        let Some(value) = numbers.get("value").copied() else {
            return Err(self.wrong(
                join(place, "value"),
                "the value of the parameter",
                "nothing",
                "write value = 0.0 for an effect that a fit shall find",
            ));
        };
        let Some(unit) = table.get("unit").and_then(toml::Value::as_str).filter(|u| !u.trim().is_empty())
        else {
            return Err(self.wrong(
                join(place, "unit"),
                "the unit of the parameter",
                "nothing",
                "write e.g. unit = \"N·s/m\", or unit = \"1\" for a ratio",
            ));
        };
        let [spike, slab] = self.widths(place, &numbers)?;
        let sign = self.sign(place, table)?;
        let bounds = self.bounds(place, &numbers)?;
        if !bounds.holds(value) {
            return Err(self.wrong(
                join(place, "value"),
                &bounds.words(),
                value,
                "write a value in this range",
            ));
        }
        // What must stay above zero is a scale, by which a formula divides.
        let divides = bounds.least > 0.0;
        let freedom = Freedom { sign, divides, ..Freedom::any(name, intern_text(unit), spike, slab) };
        Ok((Declared { freedom, bounds }, value))
    }

    /// The numbers of a declaration by key; texts are checked to be such.
    fn declared_numbers(
        &self,
        place: &str,
        table: &toml::Table,
    ) -> Result<BTreeMap<&'static str, f64>, VehicleError> {
        let mut numbers: BTreeMap<&'static str, f64> = BTreeMap::new();
        for key in ["value", "spike", "slab", "min", "max"] {
            let number = match table.get(key) {
                None => continue,
                Some(toml::Value::Float(v)) => *v,
                Some(toml::Value::Integer(v)) => *v as f64,
                Some(other) => {
                    let found = format!("a {}", other.type_str());
                    return Err(self.wrong(join(place, key), "a number", found, "write it without quotes"));
                }
            };
            numbers.insert(key, number);
        }
        for key in ["unit", "sign", "source", "note"] {
            if let Some(other) = table.get(key).filter(|v| !v.is_str()) {
                let found = format!("a {}", other.type_str());
                return Err(self.wrong(join(place, key), "a text", found, "write it in quotes"));
            }
        }
        Ok(numbers)
    }

    /// Widths of the prior without and with the effect.
    fn widths(&self, place: &str, numbers: &BTreeMap<&str, f64>) -> Result<[f64; 2], VehicleError> {
        let number = |key: &str, otherwise: f64| numbers.get(key).copied().unwrap_or(otherwise);
        let (spike, slab) = (number("spike", 0.0), number("slab", 0.0));
        for (key, width) in [("spike", spike), ("slab", slab)] {
            if width < 0.0 {
                return Err(self.wrong(
                    join(place, key),
                    "a width that is not negative",
                    width,
                    "write 0 or a positive number",
                ));
            }
        }
        if numbers.contains_key("spike") && slab <= spike {
            return Err(self.wrong(
                join(place, "slab"),
                &format!("more than the spike, {spike}"),
                slab,
                "write the parameter's plausible size where the effect is there, or remove the spike",
            ));
        }
        Ok([spike, slab])
    }

    /// Which way the value may go.
    fn sign(&self, place: &str, table: &toml::Table) -> Result<Sign, VehicleError> {
        match table.get("sign").and_then(toml::Value::as_str) {
            None | Some("any") => Ok(Sign::Any),
            Some("up") => Ok(Sign::Up),
            Some("down") => Ok(Sign::Down),
            Some(other) => Err(self.wrong(
                join(place, "sign"),
                "any, up or down",
                other,
                "say which way the value may go",
            )),
        }
    }

    /// Between which values it may lie.
    fn bounds(&self, place: &str, numbers: &BTreeMap<&str, f64>) -> Result<Bounds, VehicleError> {
        let number = |key: &str, otherwise: f64| numbers.get(key).copied().unwrap_or(otherwise);
        let bounds = Bounds::within(number("min", f64::NEG_INFINITY), number("max", f64::INFINITY));
        if bounds.least > bounds.most {
            return Err(self.wrong(
                join(place, "min"),
                &format!("at most max, {}", bounds.most),
                bounds.least,
                "write the smaller one as min",
            ));
        }
        Ok(bounds)
    }
}
