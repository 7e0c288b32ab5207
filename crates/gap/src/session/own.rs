//! Own expressions: a force, a torque or a thrust factor that the user types, with a coefficient that can be fitted.

use super::present::Setting;
use super::{Base, Session};
use crate::GapError;
use crate::accept::AcceptError;
use crate::error::Result;
use crate::formula::units::unit_of_coefficient;
use crate::live::Flight as Seen;
use crate::live::proposals::Move;
use crate::model::Model;
use propwash_physics::effects::{AnyEffect, kinds};
use propwash_vehicle::Vehicle;
use propwash_vehicle::expression::parse;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What an own expression acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Force along body x, N.
    ForceBodyX,
    /// Force along body y, N.
    ForceBodyY,
    /// Force along body z, N.
    ForceBodyZ,
    /// Force along world x, N.
    ForceWorldX,
    /// Force along world y, N.
    ForceWorldY,
    /// Force along world z, N.
    ForceWorldZ,
    /// Torque about body x, N·m.
    TorqueX,
    /// Torque about body y, N·m.
    TorqueY,
    /// Torque about body z, N·m.
    TorqueZ,
}

impl Axis {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::ForceBodyX,
        Self::ForceBodyY,
        Self::ForceBodyZ,
        Self::ForceWorldX,
        Self::ForceWorldY,
        Self::ForceWorldZ,
        Self::TorqueX,
        Self::TorqueY,
        Self::TorqueZ,
    ];

    /// Its name, as commands and pages spell it.
    pub fn name(self) -> &'static str {
        const NAMES: [&str; 9] = [
            "force_body_x",
            "force_body_y",
            "force_body_z",
            "force_world_x",
            "force_world_y",
            "force_world_z",
            "torque_x",
            "torque_y",
            "torque_z",
        ];
        NAMES[self as usize]
    }

    /// The axis of a name.
    ///
    /// # Errors
    /// [`GapError::Unknown`].
    pub fn named(name: &str) -> Result<Self, GapError> {
        Self::ALL.into_iter().find(|a| a.name() == name).ok_or_else(|| GapError::Unknown {
            name: name.into(),
            what: "axis",
            known: Self::ALL.map(Self::name).join(", "),
        })
    }

    /// Unit of what the expression says.
    pub fn unit(self) -> &'static str {
        if (self as usize) < 6 { "N" } else { "N·m" }
    }

    fn key(self) -> &'static str {
        ["force_body_n", "force_world_n", "torque_body_n_m"][self as usize / 3]
    }
}

/// An own expression.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Own {
    /// Its name in verdicts and files.
    pub name: String,
    pub axis: Axis,
    /// As typed.
    pub text: String,
    /// Unit of its coefficient `k`.
    unit: String,
    /// Plausible size of `k`.
    slab: f64,
}

/// The coefficient's name.
const COEFFICIENT: &str = "k";

impl Own {
    /// An expression, checked: `k` in it is its coefficient; without one, all of it is multiplied by one. `slab` is the
    /// coefficient's plausible size.
    ///
    /// # Errors
    /// [`GapError::Expression`] with the column of what is wrong.
    pub fn new(name: &str, axis: Axis, text: &str, slab: f64) -> Result<Self, GapError> {
        let usual = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        if !usual || !name.starts_with(|c: char| c.is_ascii_alphabetic()) || kinds().contains(&name) {
            return Err(GapError::Unknown {
                name: name.into(),
                what: "name of an own expression",
                known: "letters, digits and underscores, beginning with a letter, and no effect's name"
                    .into(),
            });
        }
        let wrong = |column: usize, expected: String, found: String| GapError::Expression {
            text: text.into(),
            column,
            expected,
            found,
        };
        let program = parse(text, &[COEFFICIENT]).map_err(|e| wrong(e.column, e.expected, e.found))?;
        let unit = unit_of_coefficient(&program, axis.unit())
            .map_err(|fault| wrong(fault.column(text), fault.expected, fault.found))?;
        Ok(Self { name: name.into(), axis, text: text.into(), unit, slab })
    }

    /// Plausible size of the coefficient.
    pub fn slab(&self) -> f64 {
        self.slab
    }

    /// What it is, in words.
    pub fn title(&self) -> String {
        format!("{} = {}", self.axis.name(), self.text)
    }

    /// Whether the user wrote the coefficient.
    fn has_coefficient(&self) -> bool {
        let name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        self.text.split(|c| !name(c)).any(|word| word == COEFFICIENT)
    }

    /// Its table of a vehicle file.
    pub fn table(&self) -> String {
        let text = match self.has_coefficient() {
            true => self.text.clone(),
            false => format!("{COEFFICIENT} * ({})", self.text),
        };
        let mut three = ["\"0\"".to_string(), "\"0\"".into(), "\"0\"".into()];
        three[self.axis as usize % 3] = format!("\"{text}\"");
        format!(
            "\n[[effect]]\nkind = \"expression\"\nname = \"{}\"\n{} = [{}]\n\n[effect.parameter.{COEFFICIENT}]\nvalue = 0.0\n\
             unit = \"{}\"\nslab = {:?}\n",
            self.name,
            self.axis.key(),
            three.join(", "),
            self.unit,
            self.slab
        )
    }
}

/// A vehicle file's text with own expressions, at no effect.
///
/// # Errors
/// Where that is no vehicle file.
pub(crate) fn with_all(label: &str, text: &str, list: &[Own]) -> Result<String, AcceptError> {
    let mut out = text.to_string();
    for own in list {
        if !out.ends_with('\n') {
            out.push('\n');
        }
        out.push_str(&own.table());
    }
    if !list.is_empty() {
        Vehicle::from_toml(label, &out)?;
    }
    Ok(out)
}

/// Rounded to two digits: a plausible size is known no better.
fn rounded(v: f64) -> f64 {
    format!("{v:.1e}").parse().unwrap_or(v)
}

impl Session {
    /// Checks an own expression as it is typed, without adding it: gives the unit of its coefficient.
    ///
    /// # Errors
    /// [`GapError::Expression`] with the column of what is wrong.
    pub fn check_expression(axis: Axis, text: &str) -> Result<String, GapError> {
        Own::new("own", axis, text, 1.0).map(|own| own.unit)
    }

    /// Adds an own expression as a candidate: it gets a column and a slider, and can be turned on, fitted and saved. Gives its
    /// name, by which [`Session::toggle`] knows it.
    ///
    /// # Errors
    /// [`GapError::Expression`] with the column of what is wrong; [`GapError::Numbers`] where it changes nothing in these
    /// flights, or is not finite.
    pub fn expression(&mut self, axis: Axis, text: &str) -> Result<String> {
        let base = self.now.base.clone();
        let names: Vec<&str> = base.model.candidates.iter().map(|c| c.id.as_str()).collect();
        let name = (1..).map(|n| format!("own_{n}")).find(|n| !names.contains(&n.as_str()));
        let name = name.unwrap_or_default();
        let own = Own::new(&name, axis, text, 1.0)?;
        let size = plausible(&base.model, &self.now.seen, &own)?;
        let own = Own { slab: size, ..own };
        let model = with_candidate(&base.model, &own)?;
        let mut setting = self.now.setting.clone();
        let mut list = base.own.clone();
        list.push(own);
        let next = Base { model, own: list, ..(*base).clone() };
        let filed = next.model.filed();
        setting.values.extend_from_slice(&filed[setting.values.len()..]);
        setting.sigma.resize(filed.len(), f64::NAN);
        let back = self.now.clone();
        self.now.base = Arc::new(next);
        self.now.setting = setting;
        if let Err(error) = self.offered(&name) {
            self.now = back;
            return Err(error.into());
        }
        let (base, setting): (_, Setting) = (self.now.base.clone(), self.now.setting.clone());
        self.take(format!("{name}: {} {text}", axis.name()), base, setting);
        Ok(name)
    }
}

/// The model with one more candidate.
fn with_candidate(model: &Model, own: &Own) -> Result<Model, GapError> {
    let fault = |reason: String| GapError::Numbers { what: "the expression", reason };
    // Read as a vehicle file reads it, so that every rule of vehicle files holds.
    let base = Vehicle::builtin_file("cf2x_L250").map_err(|e| fault(e.to_string()))?;
    let text = format!("{base}\n{}", own.table());
    let vehicle = Vehicle::from_toml("own", &text).map_err(|e| fault(e.to_string()))?;
    let drone = vehicle.drone("first_principles").map_err(|e| fault(e.to_string()))?;
    let of_own = |e: &&AnyEffect<f64>| e.label() == format!("expression.{}", own.name);
    let effect = drone.effects.iter().find(of_own).ok_or_else(|| fault("it was not read".into()))?;
    let candidates = propwash_physics::effects::expression::candidates(&drone);
    let candidate = candidates.into_iter().find(|c| c.id == own.name);
    let mut candidate = candidate.ok_or_else(|| fault("it has no coefficient".into()))?;
    candidate.title = own.title();
    let mut out = model.clone();
    out.drone.effects.push(*effect);
    out.listed.push(false);
    out.admit(candidate)?;
    Ok(out)
}

/// Plausible size of the coefficient: that at which the expression is as large as what the model lacks along its axis.
fn plausible(model: &Model, flights: &[Seen], own: &Own) -> Result<f64, GapError> {
    let model = with_candidate(model, own)?;
    let fault = |reason: &str| GapError::Numbers { what: "the expression", reason: reason.into() };
    let candidate = model.candidates.len() - 1;
    let k = model.of(candidate).next().ok_or_else(|| fault("it has no coefficient"))?;
    let (mut change, mut lack) = (0.0, 0.0);
    for f in flights {
        let at = f.with(&model, &[Move { parameter: k, value: 1.0 }]);
        let torque = own.axis.unit() == "N·m";
        let parts =
            |e: &crate::live::Evaluated| if torque { e.torque_n_m.clone() } else { e.force_n.clone() };
        for (a, b) in parts(&at).iter().zip(parts(&f.filed)).filter(|(_, b)| b[0].is_finite()) {
            let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
            change += square(std::array::from_fn(|i| a[i] - b[i]));
            lack += square(b);
        }
    }
    if !f64::is_finite(change) {
        return Err(fault(
            "it is not finite in these flights (a division by zero, the root of a negative number)",
        ));
    }
    if change <= 1e-24 * lack {
        return Err(fault("it changes nothing in these flights: use a variable that varies in them"));
    }
    Ok(rounded((lack / change).sqrt()))
}
