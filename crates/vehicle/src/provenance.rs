//! Where each number of a vehicle comes from, how certain it is, and in which unit it stands.

use super::expression::intern_text;
use super::file::join;
use super::schema::VehicleFile;
use serde::Serialize;

/// Keys that describe values rather than being some.
pub(super) const META: &[&str] =
    &["source", "note", "sigma", "kind", "models", "source_log_sha256", "date", "description", "shell"];

/// One value of a vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Provenance {
    /// Key from the top of the file, such as `rotor.0.position_m` or `effect.0.drag_n_s_per_m`.
    pub key: String,
    /// The value in the unit of its key: a number, or nested arrays of numbers.
    pub value: toml::Value,
    /// Unit, as the end of the key names it, or as the file does for a parameter of an expression.
    pub unit: Option<&'static str>,
    /// Where the value comes from: what its table or the nearest table above says; for fitted effects the log.
    pub source: Option<String>,
    /// What is to be known about it.
    pub note: Option<String>,
    /// Standard deviation in the unit of the value: of the value's shape, or a table by index where only some are known.
    pub sigma: Option<toml::Value>,
}

/// Ends of keys and the units that they stand for; a longer end goes before a shorter one that it ends in.
const UNITS: &[(&str, &str)] = &[
    ("thrust_curve_n_per_rpm", "N, N/rpm, N/rpm²"),
    ("thrust_curve_n_per_rad_s", "N, N·s/rad, N·s²/rad²"),
    ("torque_curve_n_m_per_rpm", "N·m, N·m/rpm, N·m/rpm²"),
    ("torque_curve_n_m_per_rad_s", "N·m, N·m·s/rad, N·m·s²/rad²"),
    ("_per_s_and_per_rpm_s", "1/s, 1/(rpm·s)"),
    ("_per_s_and_per_rad", "1/s, 1/rad"),
    ("_pwm_per_n", "PWM/N"),
    ("_pwm_per_s", "PWM/s"),
    ("_pwm_s2", "PWM·s²"),
    ("_pwm_s", "PWM·s"),
    ("_pwm_max", "PWM"),
    ("_pwm", "PWM"),
    ("pwm_min", "PWM"),
    ("pwm_max", "PWM"),
    ("_n_s2_per_m2", "N·s²/m²"),
    ("_n_s2_per_rad_m", "N·s²/(rad·m)"),
    ("_n_s2_per_rad", "N·s²/rad"),
    ("_v_s2_per_rad2", "V·s²/rad²"),
    ("_v_s_per_rad", "V·s/rad"),
    ("_n_s_per_m", "N·s/m"),
    ("_n_per_m_s", "N/(m·s)"),
    ("_n_per_m", "N/m"),
    ("_n_m", "N·m"),
    ("_n", "N"),
    ("_kg_m2", "kg·m²"),
    ("_kg", "kg"),
    ("_m_s2", "m/s²"),
    // Integrals of positions, before the velocities that are written alike.
    ("integral_max_m_s", "m·s"),
    ("_m_s", "m/s"),
    ("_v_per_a_s", "V/(A·s)"),
    ("_per_s2", "1/s²"),
    ("_per_s", "1/s"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_ohm", "Ω"),
    ("_hz", "Hz"),
    ("_m2", "m²"),
    ("_m", "m"),
    ("_v", "V"),
    ("_s", "s"),
];

/// The unit that the end of a key names; none where the value is a ratio.
pub fn unit_of(key: &str) -> Option<&'static str> {
    let last = key.rsplit('.').next().unwrap_or(key);
    UNITS.iter().find(|(end, _)| last.ends_with(end)).map(|(_, unit)| *unit)
}

/// Whether a value is text (names, expressions) rather than numbers.
fn is_text(value: &toml::Value) -> bool {
    match value {
        toml::Value::String(_) => true,
        toml::Value::Array(items) => items.iter().any(is_text),
        _ => false,
    }
}

/// All values of a file, tables in the order of their names.
pub(super) fn provenance(file: &VehicleFile) -> Vec<Provenance> {
    let mut out = Vec::new();
    // A checked file always converts.
    if let Ok(toml::Value::Table(table)) = toml::Value::try_from(file) {
        walk("", &table, (None, None), &mut out);
    }
    out
}

fn walk(
    prefix: &str,
    table: &toml::Table,
    above: (Option<String>, Option<String>),
    out: &mut Vec<Provenance>,
) {
    let text = |name: &str| table.get(name).and_then(|v| v.as_str()).map(str::to_string);
    let hashes: Vec<&str> = match table.get("source_log_sha256") {
        Some(toml::Value::Array(items)) => items.iter().filter_map(|v| v.as_str()).collect(),
        Some(one) => one.as_str().into_iter().collect(),
        None => Vec::new(),
    };
    let fitted = (!hashes.is_empty()).then(|| {
        let logs = if hashes.len() == 1 { "log" } else { "logs" };
        let on = text("date").map_or(String::new(), |date| format!(" on {date}"));
        format!("fitted to the {logs} of sha256 {}{on}", hashes.join(", "))
    });
    let source = match (text("source"), fitted) {
        (Some(source), Some(fitted)) => Some(format!("{source}; {fitted}")),
        (source, fitted) => source.or(fitted).or(above.0),
    };
    let note = text("note").or(above.1);
    let sigma = table.get("sigma").and_then(|v| v.as_table());
    // A parameter of an expression names its unit itself.
    let unit = text("unit").filter(|_| table.contains_key("value"));
    for (name, value) in table {
        if META.contains(&name.as_str()) || is_text(value) {
            continue;
        }
        let key = join(prefix, name);
        match value {
            toml::Value::Table(inner) => walk(&key, inner, (source.clone(), note.clone()), out),
            toml::Value::Array(items) if items.iter().any(|v| v.is_table()) => {
                for (i, item) in items.iter().enumerate() {
                    if let toml::Value::Table(inner) = item {
                        walk(&join(&key, &i.to_string()), inner, (source.clone(), note.clone()), out);
                    }
                }
            }
            value => out.push(Provenance {
                unit: unit.as_deref().map(intern_text).filter(|u| *u != "1").or_else(|| unit_of(&key)),
                value: value.clone(),
                source: source.clone(),
                note: note.clone(),
                sigma: sigma.and_then(|s| s.get(name)).cloned(),
                key,
            }),
        }
    }
}
