//! What differs between two vehicles, number by number in SI.

use super::provenance::unit_of;
use super::{DYNAMICS, Vehicle};
use crate::effects::named_parameters;
use propwash_physics::params::Parameters;
use propwash_trace::units::{RAD_S_PER_RPM, curve_rpm_to_rad_s};
use serde::Serialize;
use std::collections::BTreeMap;

/// A number that is not the same in both vehicles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterDiff {
    /// Name, as randomisation rules spell it (`body.mass_kg`, `rotors.0.thrust_curve.2`); for an effect that of its
    /// parameter (`factor.2`).
    pub name: String,
    /// SI unit; none for a ratio.
    pub unit: Option<&'static str>,
    /// Value in the first vehicle, where it has one.
    pub old: Option<f64>,
    /// Value in the second vehicle, where it has one.
    pub new: Option<f64>,
    /// (new − old) / |old| in per cent, where both are there and the old one is not 0.
    pub change_percent: Option<f64>,
    /// Standard deviation of the old value, where the file states it.
    pub old_sigma: Option<f64>,
    /// Standard deviation of the new value, where the file states it.
    pub new_sigma: Option<f64>,
}

/// An effect that is not the same in both vehicles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EffectDiff {
    /// Kind of the effect.
    pub kind: String,
    /// `added`, `removed` or `changed`.
    pub change: &'static str,
    /// Dynamics for which this holds.
    pub dynamics: Vec<&'static str>,
    /// All parameters of an effect that was added or removed; those that changed otherwise.
    pub parameters: Vec<ParameterDiff>,
}

/// What differs between two vehicles. Sources, notes, dates and layout do not count.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct VehicleDiff {
    /// Numbers of body, rotors, controller, rates and attitude responses.
    pub parameters: Vec<ParameterDiff>,
    /// Effects.
    pub effects: Vec<EffectDiff>,
    /// Anything else, in words: shell, controller, order of effects.
    pub other: Vec<String>,
}

impl VehicleDiff {
    /// Whether the vehicles fly and look the same.
    pub fn is_same(&self) -> bool {
        *self == Self::default()
    }
}

/// What differs from vehicle `a` to vehicle `b`.
pub fn diff(a: &Vehicle, b: &Vehicle) -> VehicleDiff {
    let mut out = VehicleDiff {
        parameters: differing(&parameters(a), &parameters(b), &sigmas(a), &sigmas(b), false),
        ..VehicleDiff::default()
    };
    if a.shell != b.shell {
        out.other.push(format!("shell: {} → {}", a.shell, b.shell));
    }
    let (law_a, law_b) = (law(a), law(b));
    if law_a != law_b {
        out.other.push(format!("controller: {law_a} → {law_b}"));
    }
    for dynamics in DYNAMICS.into_iter().filter(|d| a.dynamics(d).is_ok() || b.dynamics(d).is_ok()) {
        let (old, new) = (effects(a, dynamics), effects(b, dynamics));
        let kinds = |list: &[Listed]| list.iter().map(|e| e.kind).collect::<Vec<_>>();
        let (old_kinds, new_kinds) = (kinds(&old), kinds(&new));
        let kept = |from: &[&'static str], other: &[&'static str]| -> Vec<&'static str> {
            from.iter().copied().filter(|k| other.contains(k)).collect()
        };
        let (before, after) = (kept(&old_kinds, &new_kinds), kept(&new_kinds, &old_kinds));
        if before != after {
            let order = format!("order of effects in {dynamics}: {}", before.join(", "));
            out.other.push(format!("{order} → {}", after.join(", ")));
        }
        let all = old_kinds.iter().chain(new_kinds.iter().filter(|k| !old_kinds.contains(k)));
        for kind in all {
            let of = |list: &'_ [Listed]| list.iter().position(|e| e.kind == *kind);
            let (was, is) = (of(&old).map(|i| &old[i]), of(&new).map(|i| &new[i]));
            let none = Listed::default();
            let (from, to) = (was.unwrap_or(&none), is.unwrap_or(&none));
            let change = match (was, is) {
                (None, _) => "added",
                (_, None) => "removed",
                _ => "changed",
            };
            let changed = change == "changed";
            let parameters = differing(&from.values, &to.values, &from.sigmas, &to.sigmas, !changed);
            if changed && parameters.is_empty() {
                continue;
            }
            let same =
                |e: &&mut EffectDiff| e.kind == *kind && e.change == change && e.parameters == parameters;
            match out.effects.iter_mut().find(same) {
                Some(known) => known.dynamics.push(dynamics),
                None => out.effects.push(EffectDiff {
                    kind: kind.to_string(),
                    change,
                    dynamics: vec![dynamics],
                    parameters,
                }),
            }
        }
    }
    out
}

fn law(v: &Vehicle) -> &'static str {
    if v.file.controller.mellinger.is_some() { "mellinger" } else { "direct" }
}

/// Names with their values.
type Values = Vec<(String, f64)>;
/// Standard deviations by name.
type Sigmas = BTreeMap<String, f64>;

/// An effect of one dynamics.
#[derive(Default)]
struct Listed {
    kind: &'static str,
    values: Values,
    sigmas: Sigmas,
}

fn effects(v: &Vehicle, dynamics: &str) -> Vec<Listed> {
    let listed = v.contents.effects.iter().zip(&v.file.effect);
    listed
        .filter(|(e, _)| e.belongs_to(dynamics))
        .map(|(e, entry)| {
            let mut sigmas = Sigmas::new();
            for (name, value) in &entry.sigma {
                numbers(name, value, &mut |name, s| {
                    sigmas.insert(name, s);
                });
            }
            Listed { kind: e.effect.kind(), values: named_parameters(&e.effect), sigmas }
        })
        .collect()
}

/// The numbers that differ, or all of them.
fn differing(a: &Values, b: &Values, sigmas_a: &Sigmas, sigmas_b: &Sigmas, all: bool) -> Vec<ParameterDiff> {
    let (old, new): (BTreeMap<&str, f64>, BTreeMap<&str, f64>) = (
        a.iter().map(|(k, v)| (k.as_str(), *v)).collect(),
        b.iter().map(|(k, v)| (k.as_str(), *v)).collect(),
    );
    let only_b = b.iter().filter(|(k, _)| !old.contains_key(k.as_str()));
    let mut out = Vec::new();
    for (name, _) in a.iter().chain(only_b) {
        let (was, is) = (old.get(name.as_str()).copied(), new.get(name.as_str()).copied());
        if was == is && !all {
            continue;
        }
        let percent = |was: f64, is: f64| (was != 0.0).then(|| 100.0 * (is - was) / was.abs());
        out.push(ParameterDiff {
            name: name.clone(),
            unit: si_unit(name),
            old: was,
            new: is,
            change_percent: was.zip(is).and_then(|(was, is)| percent(was, is)),
            old_sigma: sigmas_a.get(name).copied(),
            new_sigma: sigmas_b.get(name).copied(),
        });
    }
    out
}

/// Everything that is not an effect and does not follow from something else.
fn parameters(v: &Vehicle) -> Values {
    let mut out = Values::new();
    v.contents.base.clone().visit(&mut |name, value| {
        // Of a vehicle without a control law the controller follows from the rest, but for its limits.
        let follows = name.starts_with("controller.")
            && (name.starts_with("controller.mixer.")
                || name.starts_with("controller.thrust_curve.")
                || (v.file.controller.direct.is_some() && !name.starts_with("controller.thrust_m")));
        if !follows {
            out.push((name.to_string(), *value));
        }
    });
    if let Some(m) = &v.file.controller.mellinger {
        out.push(("controller.thrust_to_torque_m".into(), m.thrust_to_torque_m));
    }
    for (name, response) in &v.contents.responses {
        let prefix = format!("attitude_response.{name}");
        response.clone().visit(&prefix, &mut |name, value| out.push((name.to_string(), *value)));
    }
    if let Some(t) = &v.file.throttle {
        for (name, value) in [
            ("offset_v", t.offset_v),
            ("back_emf_v_s_per_rad", t.back_emf_v_s_per_rad),
            ("load_v_s2_per_rad2", t.load_v_s2_per_rad2),
            ("nominal_v", t.nominal_v),
        ] {
            out.push((format!("throttle.{name}"), value));
        }
    }
    for (name, hz) in [
        ("state_hz", v.rates.state_hz),
        ("attitude_hz", v.rates.attitude_hz),
        ("body_rate_hz", v.rates.body_rate_hz),
        ("force_torque_hz", v.rates.force_torque_hz),
    ] {
        out.push((format!("rates.{name}"), f64::from(hz)));
    }
    out
}

/// `f(name.index, number)` for all numbers of a value.
fn numbers(name: &str, value: &toml::Value, f: &mut dyn FnMut(String, f64)) {
    match value {
        toml::Value::Float(x) => f(name.into(), *x),
        toml::Value::Integer(x) => f(name.into(), *x as f64),
        toml::Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, item)| numbers(&format!("{name}.{i}"), item, f));
        }
        toml::Value::Table(table) => {
            table.iter().for_each(|(key, item)| numbers(&format!("{name}.{key}"), item, f));
        }
        _ => {}
    }
}

/// Standard deviations in SI by the names of [`parameters`], to first order where a value is converted.
fn sigmas(v: &Vehicle) -> Sigmas {
    let mut out = Sigmas::new();
    let file = &v.file;
    let mut plain = |prefix: &str, sigma: &super::schema::Sigma| {
        for (name, value) in sigma {
            numbers(name, value, &mut |name, s| {
                out.insert(format!("{prefix}.{}", si_name(&name)), s);
            });
        }
    };
    plain("body", &file.body.sigma);
    if let Some(t) = &file.throttle {
        plain("throttle", &t.sigma);
    }
    let responses = &file.attitude_response;
    for (name, table) in
        DYNAMICS[1..].iter().zip([&responses.so_rpy, &responses.so_rpy_rotor, &responses.so_rpy_rotor_drag])
    {
        if let Some(table) = table {
            plain(&format!("attitude_response.{name}"), &table.sigma);
        }
    }
    if let Some(m) = &file.controller.mellinger {
        plain("controller", &m.sigma);
        plain("controller.state", &m.state.sigma);
        plain("controller.attitude", &m.attitude.sigma);
        plain("controller.body_rate", &m.body_rate.sigma);
    }
    if let Some(d) = &file.controller.direct {
        plain("controller", &d.sigma);
    }
    for (i, own) in file.rotor.iter().enumerate() {
        let rotor = &v.contents.base.airframe.rotors[i];
        let default = file.rotor_default.as_ref();
        // A rotor's own value stands before the default, and its sigma with it.
        let from_default = default.into_iter().flat_map(|d| &d.sigma).filter(|(key, _)| {
            let stated = toml::Value::try_from(own).ok();
            let family = family(key);
            !stated
                .as_ref()
                .and_then(toml::Value::as_table)
                .is_some_and(|t| t.keys().any(|k| self::family(k) == family))
        });
        for (key, value) in from_default.chain(&own.sigma) {
            numbers("", value, &mut |index, s| {
                let at: usize = index.trim_start_matches('.').parse().unwrap_or(0);
                let mut put = |name: String, s: f64| {
                    out.insert(format!("rotors.{i}.{name}"), s.abs());
                };
                let unit = |k: usize| core::array::from_fn(|j| if j == k { s } else { 0.0 });
                let field = family(key);
                match key.as_str() {
                    "thrust_curve_n_per_rpm" | "torque_curve_n_m_per_rpm" if at < 3 => {
                        put(format!("{field}.{at}"), curve_rpm_to_rad_s(unit(at))[at]);
                    }
                    "torque_per_thrust_m" => {
                        for (k, c) in rotor.thrust_curve.iter().enumerate() {
                            put(format!("{field}.{k}"), c * s);
                        }
                    }
                    "time_constant_up_s" => {
                        put(format!("{field}.0"), s * rotor.spin_up[0] * rotor.spin_up[0])
                    }
                    "time_constant_down_s" => {
                        put(format!("{field}.0"), s * rotor.spin_down[0] * rotor.spin_down[0]);
                    }
                    "spin_up_per_s_and_per_rpm_s" | "spin_down_per_s_and_per_rpm_s" => {
                        put(format!("{field}.{at}"), if at == 1 { s / RAD_S_PER_RPM } else { s });
                    }
                    _ => put(format!("{field}{index}"), s),
                }
            });
        }
    }
    out
}

/// Field of the physics to which a key of a rotor belongs.
fn family(key: &str) -> &str {
    match key {
        "torque_per_thrust_m" => "torque_curve",
        "time_constant_up_s" => "spin_up",
        "time_constant_down_s" => "spin_down",
        _ => ["thrust_curve", "torque_curve", "spin_up", "spin_down"]
            .into_iter()
            .find(|field| key.starts_with(field))
            .unwrap_or(key),
    }
}

/// Name in the physics of a key of the controller's tables; other keys have the same name in both.
fn si_name(key: &str) -> String {
    let (name, index) = key.split_once('.').map_or((key, None), |(name, index)| (name, Some(index)));
    let own = match name {
        "mass_thrust_pwm_per_n" => "mass_thrust",
        "kp_n_per_m" => "kp",
        "kd_n_s_per_m" => "kd",
        "ki_n_per_m_s" | "ki_pwm_per_s" => "ki",
        "integral_max_m_s" | "integral_max_s" => "integral_max",
        "kr_pwm" => "kr",
        "kw_pwm_s" => "kw",
        "kd_omega_pwm_s2" => "kd_omega",
        other => other,
    };
    index.map_or(own.to_string(), |index| format!("{own}.{index}"))
}

/// SI unit of a parameter by its name in the physics.
fn si_unit(name: &str) -> Option<&'static str> {
    let parts: Vec<&str> = name.split('.').collect();
    let index = parts.last().and_then(|p| p.parse::<usize>().ok());
    let fields: Vec<&str> = parts.iter().copied().filter(|p| p.parse::<usize>().is_err()).collect();
    let field = fields.last().copied().unwrap_or("");
    let by_power = |units: [&'static str; 3]| units.get(index.unwrap_or(0)).copied();
    let state = fields.contains(&"state");
    match field {
        "thrust_curve" => by_power(["N", "N·s/rad", "N·s²/rad²"]),
        "torque_curve" => by_power(["N·m", "N·m·s/rad", "N·m·s²/rad²"]),
        "spin_up" | "spin_down" => by_power(["1/s", "1/rad", ""]),
        "mass_thrust" => Some("PWM/N"),
        "kp" => Some("N/m"),
        "kd" => Some("N·s/m"),
        "ki" if state => Some("N/(m·s)"),
        "ki" => Some("PWM/s"),
        "integral_max" if state => Some("m·s"),
        "integral_max" => Some("s"),
        "kr" => Some("PWM"),
        "kw" => Some("PWM·s"),
        "kd_omega" => Some("PWM·s²"),
        other => unit_of(other),
    }
}
