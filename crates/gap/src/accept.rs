//! Writes fitted effects into vehicle files and removes them again. Only the effect changes; everything else (comments,
//! order, layout, units) stays as its author wrote it.

mod edit;
mod motors;

pub use motors::set_motors;

use edit::{
    built, by_index, forget_positions, keep_comments, last_position, number_at, set_number_at, sigma_at,
    split,
};
use propwash_flight::files;
use propwash_physics::effects::{AnyEffect, kinds};
use propwash_physics::params::Parameters;
use propwash_trace::names::of_list;
use propwash_vehicle::effects::{named_parameters, out_of_range};
use propwash_vehicle::{DYNAMICS, Vehicle, VehicleError, network};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value};

/// A parameter of a fitted effect.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedParameter {
    /// Name as [`named_parameters`] gives it: `delay_s`, `factor.2`, `drag_n_s_per_m.0.0`.
    pub name: String,
    /// Value in the unit that the name ends in.
    pub value: f64,
    /// Standard deviation, above 0, in the unit of the value; NaN for a value that was set and not fitted, which gets no
    /// sigma in the file.
    pub sigma: f64,
}

/// An effect with its fitted parameters; the others keep the value in the file, or their defaults.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedEffect {
    /// One of [`kinds`].
    pub kind: String,
    /// Dynamics for which it was fitted ([`DYNAMICS`]); `None` for all.
    pub models: Option<Vec<String>>,
    /// The fitted parameters.
    pub parameters: Vec<FittedParameter>,
    /// Note for the reader of the file.
    pub note: Option<String>,
}

/// Provenance of fitted values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// SHA-256 of each log, 64 hexadecimal digits.
    pub log_sha256: Vec<String>,
    /// Day of the fit, UTC, `2025-01-31`; see [`today_utc`].
    pub date: String,
    /// Text for `source` in the file.
    pub text: String,
}

/// Why a vehicle file could not be changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AcceptError {
    /// The text is not a valid vehicle file, before or after the change.
    #[error(transparent)]
    Vehicle(Box<VehicleError>),
    /// A fitted effect cannot be written into a vehicle file.
    #[error("effect `{effect}`, {what}: expected {expected}, found {found}: {remedy}")]
    Effect {
        /// Its kind.
        effect: String,
        /// The part that is wrong.
        what: String,
        /// What was expected.
        expected: String,
        /// What it is.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A fitted value outside the bounds in which the effect's formula holds.
    #[error(
        "effect `{effect}` was not added: its fit gives {parameter} = {found}, expected {expected}; such a value has no \
         meaning in its formula, so something else is missing in the model: leave this effect out, or fit it on a \
         flight that excites it more"
    )]
    OutOfRange {
        /// Its kind.
        effect: String,
        /// The parameter.
        parameter: String,
        /// Its bounds.
        expected: String,
        /// Its value.
        found: String,
    },
    /// The effect to remove is not there.
    #[error(
        "{file}: expected the effect `{kind}`, found {present}; correct the name{}",
        of_list(kind, present)
    )]
    NoEffect {
        /// File or name of the vehicle.
        file: String,
        /// The requested effect.
        kind: String,
        /// Effects that the file has.
        present: String,
    },
    /// The text could not be edited.
    #[error(
        "{file}: expected effects as [[effect]] tables, found {found}: rewrite them as [[effect]] tables"
    )]
    Layout {
        /// File or name of the vehicle.
        file: String,
        /// What was found there.
        found: String,
    },
    /// The output file exists already.
    #[error("{}: expected a path at which there is no file yet, found one: choose another --out, or add --force to \
             replace it", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output file could not be written.
    #[error("{}: cannot be written ({reason}): check the path and its permissions", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error message.
        reason: String,
    },
}

impl From<VehicleError> for AcceptError {
    fn from(error: VehicleError) -> Self {
        Self::Vehicle(Box::new(error))
    }
}

/// Adds effects to the text of a vehicle file; where the file already has an effect of the kind for these dynamics, its
/// parameters are updated. `file_label` names the file in messages.
///
/// An entry that covers more dynamics than the fit is split, so that the others keep their values. Arrays are written
/// whole: numbers that were not fitted keep their value or default, and `sigma` then holds the fitted ones by index. Where
/// an entry keeps values that were not fitted, its old source and logs stay named too.
///
/// # Errors
/// [`AcceptError`] for an invalid vehicle file, for unknown kinds, dynamics and parameters, and for numbers that are not
/// finite or outside the range of the effect.
pub fn add(
    text: &str,
    file_label: &str,
    effects: &[FittedEffect],
    source: &Source,
) -> Result<String, AcceptError> {
    Vehicle::from_toml(file_label, text)?;
    let mut doc = document(text, file_label)?;
    for effect in effects {
        let fit = Fit::checked(effect, source)?;
        let last = last_position(doc.as_table());
        let list = entries(&mut doc, file_label)?;
        fit.place(list, last)?;
    }
    if doc.get("effect").and_then(Item::as_array_of_tables).is_some_and(ArrayOfTables::is_empty) {
        doc.remove("effect");
    }
    let out = doc.to_string();
    Vehicle::from_toml(file_label, &out)?;
    Ok(out)
}

/// Writes fitted parameters of a user-defined effect (kind `expression`, by its name) into the text of a vehicle file; the
/// rest of the entry stays.
///
/// # Errors
/// [`AcceptError::NoEffect`] where the file has no expression of that name, [`AcceptError::Effect`] where the expression has
/// no such parameter, [`AcceptError::Vehicle`] for values outside its bounds.
pub fn set_expression(
    text: &str,
    file_label: &str,
    name: &str,
    parameters: &[FittedParameter],
    source: &Source,
) -> Result<String, AcceptError> {
    let vehicle = Vehicle::from_toml(file_label, text)?;
    let mut doc = document(text, file_label)?;
    let list = entries(&mut doc, file_label)?;
    let mine = |t: &&mut Table| {
        kind_of(t) == Some("expression") && t.get("name").and_then(Item::as_str) == Some(name)
    };
    let Some(entry) = list.iter_mut().find(mine) else {
        let present: Vec<&str> = vehicle.file().effect.iter().map(|e| e.kind.as_str()).collect();
        let present = if present.is_empty() { "no effects".to_string() } else { present.join(", ") };
        return Err(AcceptError::NoEffect {
            file: file_label.into(),
            kind: format!("expression {name}"),
            present,
        });
    };
    for p in parameters {
        let wrong = |expected: &str, found: String| AcceptError::Effect {
            effect: name.into(),
            what: p.name.clone(),
            expected: expected.into(),
            found,
            remedy: "repeat the fit with this file",
        };
        if !p.value.is_finite() || p.sigma <= 0.0 {
            return Err(wrong(
                "a finite value with a standard deviation above 0",
                format!("{} ± {}", p.value, p.sigma),
            ));
        }
        let own = entry
            .get_mut("parameter")
            .and_then(Item::as_table_like_mut)
            .and_then(|t| t.get_mut(&p.name))
            .and_then(Item::as_table_like_mut);
        let Some(own) = own else {
            return Err(wrong("a parameter of the expression", "an unknown name".into()));
        };
        own.insert("value", Item::Value(p.value.into()));
        // The old sigma does not belong to the new value.
        own.remove("sigma");
        if p.sigma.is_finite() {
            let of = InlineTable::from_iter([("value", Value::from(p.sigma))]);
            own.insert("sigma", Item::Value(Value::InlineTable(of)));
        }
        own.insert("source", Item::Value(source.text.as_str().into()));
    }
    match source.log_sha256.as_slice() {
        [] => {}
        [one] => set(entry, "source_log_sha256", one.as_str().into()),
        several => set(entry, "source_log_sha256", Value::Array(several.iter().collect())),
    }
    set(entry, "date", source.date.as_str().into());
    let out = doc.to_string();
    // Bounds are checked by reading the edited text, so that every rule of vehicle files holds.
    Vehicle::from_toml(file_label, &out)?;
    Ok(out)
}

/// Removes every entry of an effect from the text of a vehicle file, with the comments directly above it; comments
/// separated by an empty line stay.
///
/// # Errors
/// [`AcceptError::NoEffect`] when the file has no such effect; errors of reading otherwise.
pub fn remove(text: &str, file_label: &str, kind: &str) -> Result<String, AcceptError> {
    let vehicle = Vehicle::from_toml(file_label, text)?;
    let mut doc = document(text, file_label)?;
    let list = entries(&mut doc, file_label)?;
    let found: Vec<usize> =
        (0..list.len()).filter(|i| list.get(*i).is_some_and(|t| kind_of(t) == Some(kind))).collect();
    if found.is_empty() {
        let mut present: Vec<&str> = vehicle.file().effect.iter().map(|e| e.kind.as_str()).collect();
        present.dedup();
        let present = if present.is_empty() { "no effects".to_string() } else { present.join(", ") };
        return Err(AcceptError::NoEffect { file: file_label.into(), kind: kind.into(), present });
    }
    for i in found.into_iter().rev() {
        let Some(list) = doc.get_mut("effect").and_then(Item::as_array_of_tables_mut) else { break };
        let gone = list.remove(i);
        keep_comments(&mut doc, &gone);
    }
    if doc.get("effect").and_then(Item::as_array_of_tables).is_some_and(ArrayOfTables::is_empty) {
        doc.remove("effect");
    }
    let out = doc.to_string();
    Vehicle::from_toml(file_label, &out)?;
    Ok(out)
}

/// Refuses an existing path (that of the input is one) unless `force` is given; call it before long work.
///
/// # Errors
/// [`AcceptError::Exists`], and [`AcceptError::Write`] where no file can be written there.
pub fn may_write(path: &Path, force: bool) -> Result<(), AcceptError> {
    files::may_write(path, force).map_err(refused(path))
}

/// Writes a vehicle file atomically, and before it the networks that it names beside itself; existing files with other contents are
/// replaced only with `force`.
///
/// # Errors
/// [`AcceptError::Exists`] and [`AcceptError::Write`].
pub fn write(path: &Path, text: &str, force: bool) -> Result<(), AcceptError> {
    may_write(path, force)?;
    write_networks(path, text, force)?;
    files::write(path, force, |file| file.write_all(text.as_bytes())).map_err(refused(path))
}

/// Writes the networks that the text of a vehicle file at `path` names beside it; those that are there already stay.
///
/// # Errors
/// [`AcceptError::Exists`] for a file with other contents, without `force`, and [`AcceptError::Write`].
pub fn write_networks(path: &Path, text: &str, force: bool) -> Result<(), AcceptError> {
    for (name, content) in network::files_of(text) {
        let beside = path.with_file_name(name);
        if std::fs::read(&beside).is_ok_and(|there| there == content.as_bytes()) {
            continue;
        }
        files::write(&beside, force, |file| file.write_all(content.as_bytes())).map_err(refused(&beside))?;
    }
    Ok(())
}

fn refused(path: &Path) -> impl FnOnce(std::io::Error) -> AcceptError {
    |e| match e.kind() {
        ErrorKind::AlreadyExists => AcceptError::Exists { path: path.into() },
        _ => AcceptError::Write { path: path.into(), reason: e.to_string() },
    }
}

/// Today's date, UTC, as `2025-01-31`.
pub fn today_utc() -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    date_utc(now.map_or(0, |d| d.as_secs()))
}

/// The date of a time, s since 1970-01-01 UTC, in the Gregorian calendar.
pub fn date_utc(unix_s: u64) -> String {
    let leap = |y: u64| y.is_multiple_of(4) && (!y.is_multiple_of(100) || y.is_multiple_of(400));
    let (mut days, mut year) = (unix_s / 86_400, 1970);
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!("{year:04}-{month:02}-{:02}", days + 1)
}

fn document(text: &str, file: &str) -> Result<DocumentMut, AcceptError> {
    text.parse().map_err(|e: toml_edit::TomlError| AcceptError::Layout {
        file: file.into(),
        found: e.message().to_string(),
    })
}

/// The `[[effect]]` tables, created if there are none.
fn entries<'a>(doc: &'a mut DocumentMut, file: &str) -> Result<&'a mut ArrayOfTables, AcceptError> {
    let item = doc.entry("effect").or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
    if item.is_array() {
        let empty = item.as_array().is_some_and(Array::is_empty);
        let taken = std::mem::take(item);
        *item = match taken.into_array_of_tables() {
            Ok(tables) => Item::ArrayOfTables(tables),
            Err(_) if empty => Item::ArrayOfTables(ArrayOfTables::new()),
            Err(other) => other,
        };
    }
    let found = item.type_name().to_string();
    item.as_array_of_tables_mut().ok_or(AcceptError::Layout { file: file.into(), found })
}

fn kind_of(entry: &Table) -> Option<&str> {
    entry.get("kind").and_then(Item::as_str)
}

/// Dynamics that have an entry.
fn models_of(entry: &Table) -> BTreeSet<&'static str> {
    match entry.get("models").and_then(Item::as_array) {
        None => DYNAMICS.into(),
        Some(list) => DYNAMICS.into_iter().filter(|d| list.iter().any(|v| v.as_str() == Some(d))).collect(),
    }
}

fn set_models(entry: &mut Table, models: &BTreeSet<&'static str>) {
    if models.len() == DYNAMICS.len() {
        entry.remove("models");
        return;
    }
    let list: Array = DYNAMICS.into_iter().filter(|d| models.contains(d)).collect();
    set(entry, "models", Value::Array(list));
}

/// Sets a value of a table and keeps the comment beside the old one.
fn set(table: &mut Table, key: &str, mut value: Value) {
    match table.get_mut(key) {
        Some(Item::Value(old)) => {
            *value.decor_mut() = old.decor().clone();
            *old = value;
        }
        _ => {
            table.insert(key, Item::Value(value));
        }
    }
}

/// A fitted effect that passed its checks.
struct Fit<'a> {
    effect: &'a FittedEffect,
    source: &'a Source,
    default: AnyEffect<f64>,
    /// All parameters with their defaults, in order.
    names: Vec<(String, f64)>,
    models: BTreeSet<&'static str>,
}

impl<'a> Fit<'a> {
    fn checked(effect: &'a FittedEffect, source: &'a Source) -> Result<Self, AcceptError> {
        let wrong = |what: &str, expected: String, found: String, remedy: &'static str| {
            let (effect, what) = (effect.kind.clone(), what.to_string());
            Err(AcceptError::Effect { effect, what, expected, found, remedy })
        };
        let Some(default) = AnyEffect::by_kind(&effect.kind) else {
            return wrong(
                "kind",
                format!("one of {}", kinds().join(", ")),
                effect.kind.clone(),
                "correct the name",
            );
        };
        let names = named_parameters(&default);
        let models: BTreeSet<&'static str> = match &effect.models {
            None => DYNAMICS.into(),
            Some(list) => {
                if let Some(other) = list.iter().find(|m| !DYNAMICS.contains(&m.as_str())) {
                    let expected = format!("some of {}", DYNAMICS.join(", "));
                    return wrong("models", expected, other.clone(), "correct the name");
                }
                DYNAMICS.into_iter().filter(|d| list.iter().any(|m| m == d)).collect()
            }
        };
        if models.is_empty() {
            let expected = format!("at least one of {}", DYNAMICS.join(", "));
            return wrong("models", expected, "none".into(), "name the dynamics, or leave them out for all");
        }
        if effect.parameters.is_empty() {
            let expected = "at least one parameter".to_string();
            return wrong("parameters", expected, "none".into(), "fit the effect first");
        }
        for (i, p) in effect.parameters.iter().enumerate() {
            if !names.iter().any(|(name, _)| *name == p.name) {
                let known: Vec<&str> = names.iter().map(|(name, _)| name.as_str()).collect();
                let expected = format!("one of its parameters, {}", known.join(", "));
                return wrong(&p.name, expected, "an unknown name".into(), "correct the name");
            }
            if effect.parameters[..i].iter().any(|q| q.name == p.name) {
                return wrong(&p.name, "each parameter once".into(), "it twice".into(), "keep one of them");
            }
            if !p.value.is_finite() {
                return wrong(&p.name, "a finite value".into(), p.value.to_string(), "repeat the fit");
            }
            // NaN passes: it marks a value that was set and not fitted.
            if p.sigma <= 0.0 || p.sigma.is_infinite() {
                let expected = "a standard deviation above 0, or NaN for a value that was not fitted".into();
                return wrong(&p.name, expected, p.sigma.to_string(), "repeat the fit");
            }
        }
        if let Some(hash) =
            source.log_sha256.iter().find(|h| h.len() != 64 || !h.bytes().all(|b| b.is_ascii_hexdigit()))
        {
            let expected = "the SHA-256 of a log, 64 hexadecimal digits".into();
            return wrong("log hash", expected, format!("`{hash}`"), "take it from the log that was read");
        }
        if !is_date(&source.date) {
            let expected = "a date such as 2025-01-31".into();
            return wrong("date", expected, format!("`{}`", source.date), "write year-month-day");
        }
        Ok(Self { effect, source, default, names, models })
    }

    /// Inserts the effect into the list; `last` is the position of the file's last table.
    fn place(&self, list: &mut ArrayOfTables, last: Option<isize>) -> Result<(), AcceptError> {
        let mut rest = self.models.clone();
        let mut met = Vec::new();
        for i in 0..list.len() {
            let Some(entry) = list.get(i).filter(|e| kind_of(e) == Some(&self.effect.kind)) else { continue };
            let theirs = models_of(entry);
            let common: BTreeSet<_> = theirs.intersection(&self.models).copied().collect();
            if !common.is_empty() {
                rest = rest.difference(&common).copied().collect();
                met.push((i, theirs, common));
            }
        }
        let alone = met.len() == 1;
        for (i, theirs, common) in met.into_iter().rev() {
            let Some(entry) = list.get_mut(i) else { continue };
            if theirs == common {
                self.update(entry)?;
                if alone {
                    // The kind's only entry is extended to the other fitted dynamics.
                    let all: BTreeSet<_> = theirs.union(&rest).copied().collect();
                    if !rest.is_empty() {
                        set_models(entry, &all);
                        rest.clear();
                    }
                }
                continue;
            }
            let mut own = entry.clone();
            forget_positions(&mut own);
            own.decor_mut().set_prefix("\n");
            set_models(entry, &theirs.difference(&common).copied().collect());
            let mut models = common;
            if alone {
                models.append(&mut rest);
            }
            set_models(&mut own, &models);
            self.update(&mut own)?;
            list.insert(i + 1, own);
        }
        if !rest.is_empty() {
            let mut own = Table::new();
            own.insert("kind", Item::Value(self.effect.kind.as_str().into()));
            set_models(&mut own, &rest);
            self.update(&mut own)?;
            if list.is_empty() {
                own.set_position(last);
            }
            list.push(own);
        }
        Ok(())
    }

    /// Writes values, sigmas and source into an entry.
    fn update(&self, entry: &mut Table) -> Result<(), AcceptError> {
        let mut values: BTreeMap<&str, f64> = self.names.iter().map(|(n, v)| (n.as_str(), *v)).collect();
        // Non-default values that this fit does not determine: their source has to stay named.
        let mut stated = BTreeSet::new();
        for (name, default) in &self.names {
            let (base, path) = split(name);
            if let Some(v) = entry.get(base).and_then(Item::as_value).and_then(|v| number_at(v, &path)) {
                values.insert(name, v);
                if v != *default {
                    stated.insert(name.as_str());
                }
            }
        }
        for p in &self.effect.parameters {
            values.insert(&p.name, p.value);
            stated.remove(p.name.as_str());
        }
        // Bounds may depend on several parameters, so the complete effect is checked.
        let mut whole = self.default;
        whole.visit("", &mut |name, slot| *slot = values[name.trim_start_matches('.')]);
        if let Some(fault) = out_of_range(&mut whole) {
            return Err(AcceptError::OutOfRange {
                effect: self.effect.kind.clone(),
                parameter: fault.parameter,
                expected: fault.expected,
                found: fault.found.to_string(),
            });
        }

        // Names are ordered, so the elements of one array are adjacent.
        let mut bases: Vec<(&str, Vec<&FittedParameter>)> = Vec::new();
        for (name, _) in &self.names {
            let base = split(name).0;
            if bases.last().is_none_or(|(last, _)| *last != base) {
                bases.push((
                    base,
                    self.effect.parameters.iter().filter(|p| split(&p.name).0 == base).collect(),
                ));
            }
        }
        bases.retain(|(_, mine)| !mine.is_empty());
        for (base, mine) in &bases {
            match entry.get_mut(base) {
                Some(Item::Value(value)) => {
                    for p in mine {
                        set_number_at(value, &split(&p.name).1, p.value);
                    }
                }
                _ => {
                    let own = self.names.iter().filter(|(name, _)| split(name).0 == *base);
                    let all: Vec<(Vec<usize>, f64)> =
                        own.map(|(name, _)| (split(name).1, values[name.as_str()])).collect();
                    entry.insert(base, Item::Value(built(&all)));
                }
            }
        }
        for (base, mine) in &bases {
            self.sigma(entry, base, mine);
        }
        if entry.get("sigma").and_then(Item::as_table_like).is_some_and(|t| t.is_empty()) {
            entry.remove("sigma");
        }
        self.describe(entry, !stated.is_empty());
        Ok(())
    }

    /// Sigmas of one parameter: those of the fit, and existing ones of numbers that are not fitted.
    fn sigma(&self, entry: &mut Table, base: &str, fitted: &[&FittedParameter]) {
        let mut known: BTreeMap<Vec<usize>, f64> = BTreeMap::new();
        let old = entry.get("sigma").and_then(|s| s.get(base));
        for (name, _) in self.names.iter().filter(|(name, _)| split(name).0 == base) {
            let path = split(name).1;
            if let Some(s) = old.and_then(|item| sigma_at(item, &path)) {
                known.insert(path, s);
            }
        }
        for p in fitted {
            let path = split(&p.name).1;
            if p.sigma.is_nan() {
                known.remove(&path);
            } else {
                known.insert(path, p.sigma);
            }
        }
        if !entry.get("sigma").is_some_and(Item::is_table_like) {
            if known.is_empty() {
                return;
            }
            entry.insert("sigma", Item::Value(Value::InlineTable(InlineTable::new())));
        }
        let Some(sigma) = entry.get_mut("sigma").and_then(Item::as_table_like_mut) else { return };
        sigma.remove(base);
        let list: Vec<(Vec<usize>, f64)> = known.into_iter().collect();
        let width = self.names.iter().filter(|(name, _)| split(name).0 == base).count();
        if list.len() == width {
            sigma.insert(base, Item::Value(built(&list)));
        } else if !list.is_empty() {
            sigma.insert(base, Item::Value(Value::InlineTable(by_index(&list))));
        }
    }

    /// Writes source, logs, date and note; `partly` if some values are not from this fit.
    fn describe(&self, entry: &mut Table, partly: bool) {
        let text = |entry: &Table, key: &str| entry.get(key).and_then(Item::as_str).map(str::to_string);
        let fitted: Vec<&str> = self.effect.parameters.iter().map(|p| p.name.as_str()).collect();
        let source = match text(entry, "source").filter(|_| partly) {
            Some(old) => format!("{} ({}); the rest: {old}", self.source.text, fitted.join(", ")),
            None => self.source.text.clone(),
        };
        set(entry, "source", source.into());
        let mut hashes: Vec<String> = Vec::new();
        if partly {
            match entry.get("source_log_sha256") {
                Some(item) if item.is_array() => {
                    let list = item.as_array().into_iter().flatten();
                    hashes.extend(list.filter_map(|v| v.as_str().map(str::to_string)));
                }
                Some(item) => hashes.extend(item.as_str().map(str::to_string)),
                None => {}
            }
        }
        for hash in &self.source.log_sha256 {
            if !hashes.contains(hash) {
                hashes.push(hash.clone());
            }
        }
        match hashes.as_slice() {
            [] => {
                entry.remove("source_log_sha256");
            }
            [one] => set(entry, "source_log_sha256", one.as_str().into()),
            several => set(entry, "source_log_sha256", Value::Array(several.iter().collect())),
        }
        set(entry, "date", self.source.date.as_str().into());
        match (&self.effect.note, text(entry, "note").filter(|_| partly)) {
            (Some(new), Some(old)) if *new != old => set(entry, "note", format!("{new}; {old}").into()),
            (Some(new), _) => set(entry, "note", new.as_str().into()),
            (None, Some(_)) => {}
            (None, None) => {
                entry.remove("note");
            }
        }
    }
}

/// `2025-01-31`, possibly with a time behind a `T`.
fn is_date(text: &str) -> bool {
    let day = text.split('T').next().unwrap_or("");
    let parts: Vec<&str> = day.split('-').collect();
    let digits = |part: &str, n: usize| part.len() == n && part.bytes().all(|b| b.is_ascii_digit());
    let within = |part: &str, most: u32| part.parse().is_ok_and(|v: u32| (1..=most).contains(&v));
    match parts[..] {
        [y, m, d] => digits(y, 4) && digits(m, 2) && digits(d, 2) && within(m, 12) && within(d, 31),
        _ => false,
    }
}

#[cfg(test)]
mod tests;
