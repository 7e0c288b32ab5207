//! Writes the motors of a vehicle into its file: `[throttle]`, and the rotors' time constants.

use super::edit::number;
use super::{AcceptError, document};
use propwash_vehicle::Vehicle;
use propwash_vehicle::schema::{ThrottleOf, ThrottleTable};
use toml_edit::{DocumentMut, InlineTable, Item, Table, Value};

/// Sets `[throttle]` and, with a `lag` (values and standard deviations up and down, s), the time constants of all rotors. The rest of the text
/// stays as it is.
///
/// # Errors
/// [`AcceptError`] where the text is no vehicle file, before or after the change.
pub fn set_motors(
    text: &str,
    label: &str,
    table: &ThrottleTable,
    lag: Option<[(f64, f64); 2]>,
) -> Result<String, AcceptError> {
    Vehicle::from_toml(label, text)?;
    let mut doc = document(text, label)?;
    set_throttle(&mut doc, table);
    if let Some(lag) = lag {
        set_lag(&mut doc, lag);
    }
    let out = doc.to_string();
    Vehicle::from_toml(label, &out)?;
    Ok(out)
}

/// `{ key = value, … }` of standard deviations.
fn sigmas<'a>(all: impl Iterator<Item = (&'a str, f64)>) -> Value {
    let mut out = InlineTable::new();
    for (key, sigma) in all {
        out.insert(key, number(sigma));
    }
    Value::InlineTable(out)
}

fn set_throttle(doc: &mut DocumentMut, t: &ThrottleTable) {
    let mut new = Table::new();
    for (key, value) in [
        ("offset_v", t.offset_v),
        ("back_emf_v_s_per_rad", t.back_emf_v_s_per_rad),
        ("load_v_s2_per_rad2", t.load_v_s2_per_rad2),
        ("nominal_v", t.nominal_v),
    ] {
        new.insert(key, Item::Value(number(value)));
    }
    let of = match t.voltage {
        ThrottleOf::Battery => "battery",
        ThrottleOf::Nominal => "nominal",
    };
    new.insert("voltage", toml_edit::value(of));
    for (key, text) in [("source", &t.source), ("note", &t.note)] {
        if let Some(text) = text {
            new.insert(key, toml_edit::value(text.as_str()));
        }
    }
    let known = t.sigma.iter().filter_map(|(key, v)| Some((key.as_str(), v.as_float()?)));
    new.insert("sigma", Item::Value(sigmas(known)));
    // An older table gives its place and the comments above it.
    match doc.get("throttle").and_then(Item::as_table) {
        Some(old) => {
            *new.decor_mut() = old.decor().clone();
            new.set_position(old.position());
        }
        None => new.decor_mut().set_prefix("\n"),
    }
    doc.insert("throttle", Item::Table(new));
}

/// All forms in which a file states how fast rotors follow.
const LAGS: [&str; 6] = [
    "spin_up_per_s_and_per_rpm_s",
    "spin_up_per_s_and_per_rad",
    "time_constant_up_s",
    "spin_down_per_s_and_per_rpm_s",
    "spin_down_per_s_and_per_rad",
    "time_constant_down_s",
];

fn forget_lag(table: &mut Table) {
    for key in LAGS {
        table.remove(key);
        match table.get_mut("sigma") {
            Some(Item::Value(Value::InlineTable(sigma))) => drop(sigma.remove(key)),
            Some(Item::Table(sigma)) => drop(sigma.remove(key)),
            _ => {}
        }
    }
}

fn set_lag(doc: &mut DocumentMut, lag: [(f64, f64); 2]) {
    let rounded = |v: f64| format!("{v:.4e}").parse().unwrap_or(v);
    if let Some(rotors) = doc.get_mut("rotor").and_then(Item::as_array_of_tables_mut) {
        rotors.iter_mut().for_each(forget_lag);
    }
    let default = doc.entry("rotor_default").or_insert_with(|| Item::Table(Table::new()));
    let Some(table) = default.as_table_mut() else { return };
    forget_lag(table);
    let both = ["time_constant_up_s", "time_constant_down_s"].into_iter().zip(lag);
    for (key, (lag_s, _)) in both.clone() {
        table.insert(key, Item::Value(number(rounded(lag_s))));
    }
    for (key, (_, sigma_s)) in both {
        let sigma = number(rounded(sigma_s));
        match table.get_mut("sigma") {
            Some(Item::Value(Value::InlineTable(list))) => drop(list.insert(key, sigma)),
            Some(Item::Table(list)) => drop(list.insert(key, Item::Value(sigma))),
            _ => {
                table.insert("sigma", Item::Value(sigmas([(key, rounded(sigma_s))].into_iter())));
            }
        }
    }
}
