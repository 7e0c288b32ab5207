//! From the text of a vehicle file to checked physics parameters in SI.

use super::effects::ListedEffect;
use super::error::VehicleError;
use super::mixer;
use super::provenance;
use super::schema::{AttitudeStage, Direct, Mellinger, Response, Rotor, VehicleFile};
use super::{DYNAMICS, SO_RPY};
use nalgebra::Matrix3;
use propwash_physics::controllers::mellinger::{self, AttitudeGains, StateGains};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::rigid_body::{self, MAX_ROTORS};
use propwash_physics::{airframe, attitude_response, rotor};
use propwash_trace::units::{RAD_S_PER_RPM, curve_rpm_to_rad_s};

/// How far an axis may be from unit length and still be scaled to it.
const UNIT_TOLERANCE: f64 = 1e-6;
/// Relative difference of mirrored inertia entries that still counts as symmetric.
const SYMMETRY_TOLERANCE: f64 = 1e-9;

/// Least principal moment of inertia over the largest entry of the matrix.
const LEAST_MOMENT: f64 = 1e-12;

/// Everything that a vehicle file says, checked and in SI.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Contents {
    /// The vehicle with [`Dynamics::Rotors`] and without effects.
    pub base: Drone<f64>,
    /// Fitted responses by name.
    pub responses: Vec<(&'static str, attitude_response::Params<f64>)>,
    /// Effects in order.
    pub effects: Vec<ListedEffect>,
    /// Whether thrust and all three torques can be made.
    pub full_rank: bool,
    /// What is doubtful but allowed.
    pub warnings: Vec<String>,
}

/// Reads the text of a vehicle file; `file` names it in messages.
pub(super) fn parse(file: &str, text: &str) -> Result<VehicleFile, VehicleError> {
    let parsed: VehicleFile = toml::from_str(text).map_err(|e| text_error(file, text, &e))?;
    // Fixed-length arrays stop reading at their length, so a longer one is found by comparing with the plain document.
    if let (Ok(raw), Ok(typed)) = (toml::from_str::<toml::Value>(text), toml::Value::try_from(&parsed)) {
        compare_lengths(file, "", &raw, &typed)?;
    }
    Ok(parsed)
}

/// The error of the TOML reader with its line and a remedy.
fn text_error(file: &str, text: &str, error: &toml::de::Error) -> VehicleError {
    let start = error.span().map_or(0, |s| s.start).min(text.len());
    let before = text.get(..start).unwrap_or("");
    let line = before.matches('\n').count();
    let message = error.message();
    let remedy = if message.starts_with("unknown field") {
        "correct or remove the key (units are part of names); docs/vehicles.md explains every key"
    } else if message.starts_with("missing field") {
        "add the key to this table (or the table to the file); docs/vehicles.md shows a complete file"
    } else if message.starts_with("invalid length") {
        "write as many numbers as the key takes"
    } else if message.starts_with("invalid type") || message.starts_with("invalid value") {
        "write the value in the type that the key takes (numbers without quotes, arrays in brackets)"
    } else {
        "correct the TOML syntax (https://toml.io)"
    };
    VehicleError::Text {
        file: file.into(),
        line: line + 1,
        message: message.to_string(),
        excerpt: text.lines().nth(line).unwrap_or("").trim().to_string(),
        remedy: remedy.into(),
    }
}

/// Largest size of an entry.
fn largest(m: [[f64; 3]; 3]) -> f64 {
    m.iter().flatten().fold(0.0, |a, b| a.max(b.abs()))
}

/// Principal moments of an inertia in kg·m², least first.
fn principal_moments(m: [[f64; 3]; 3]) -> Vec<f64> {
    let matrix = Matrix3::from_fn(|i, j| m[i][j]);
    let mut moments: Vec<f64> = matrix.symmetric_eigenvalues().iter().copied().collect();
    moments.sort_by(f64::total_cmp);
    moments
}

fn compare_lengths(
    file: &str,
    key: &str,
    raw: &toml::Value,
    typed: &toml::Value,
) -> Result<(), VehicleError> {
    match (raw, typed) {
        (toml::Value::Table(raw), toml::Value::Table(typed)) => {
            for (name, value) in raw {
                if let Some(other) = typed.get(name) {
                    compare_lengths(file, &join(key, name), value, other)?;
                }
            }
        }
        (toml::Value::Array(raw), toml::Value::Array(typed)) => {
            if raw.len() != typed.len() {
                return Err(VehicleError::value(
                    file,
                    key,
                    format!("{} numbers", typed.len()),
                    raw.len(),
                    "remove the numbers that are too many",
                ));
            }
            for (i, (value, other)) in raw.iter().zip(typed).enumerate() {
                compare_lengths(file, &join(key, &i.to_string()), value, other)?;
            }
        }
        _ => {}
    }
    Ok(())
}

/// `prefix.name`, or the one of them that is not empty.
pub(super) fn join(prefix: &str, name: &str) -> String {
    if prefix.is_empty() || name.is_empty() { format!("{prefix}{name}") } else { format!("{prefix}.{name}") }
}

/// The file as TOML text that reads back equal; small numbers in scientific notation.
pub(super) fn to_text(file: &str, contents: &VehicleFile) -> Result<String, VehicleError> {
    let plain = toml::to_string(contents).map_err(|e| {
        VehicleError::value(
            file,
            "(whole file)",
            "values that TOML can hold",
            e,
            "correct the value named here",
        )
    })?;
    let mut pretty = String::with_capacity(plain.len());
    for line in plain.lines() {
        match line.split_once(" = ") {
            Some((key, value)) if !value.contains(['"', '\'']) => {
                pretty.push_str(&format!("{key} = {}", scientific(value)));
            }
            _ => pretty.push_str(line),
        }
        pretty.push('\n');
    }
    // A text over several lines may look like numbers; then the plain form stands.
    let same = toml::from_str::<VehicleFile>(&pretty).is_ok_and(|back| back == *contents);
    Ok(if same { pretty } else { plain })
}

/// `value` with every decimal number below 1e-3 or from 1e6 on in scientific notation.
fn scientific(value: &str) -> String {
    let mut out = String::new();
    let mut rest = value;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit() || c == '-') {
        let end = rest[start..]
            .find(|c: char| !(c.is_ascii_digit() || c == '-' || c == '.'))
            .map_or(rest.len(), |n| start + n);
        let token = &rest[start..end];
        out.push_str(&rest[..start]);
        match token.parse::<f64>() {
            Ok(v) if token.contains('.') && v != 0.0 && !(1e-3..1e6).contains(&v.abs()) => {
                out.push_str(&format!("{v:e}"));
            }
            _ => out.push_str(token),
        }
        rest = &rest[end..];
    }
    out.push_str(rest);
    out
}

/// Checks a file and converts it.
pub(super) fn contents(file: &str, v: &VehicleFile) -> Result<Contents, VehicleError> {
    let check = Check { file, n_rotors: Some(v.rotor.len()) };
    let mut warnings = Vec::new();
    let whole = toml::Value::try_from(v).map_err(|e| {
        VehicleError::value(
            file,
            "(whole file)",
            "values that TOML can hold",
            e,
            "correct the value named here",
        )
    })?;
    check.finite("", &whole)?;
    check.sigmas("", &whole)?;
    if v.shell.trim().is_empty() {
        return Err(check.wrong(
            "shell",
            "the name of a shell",
            "an empty text",
            "write e.g. shell = \"cf2x\"",
        ));
    }

    let body = check.body(v, &mut warnings)?;
    let airframe = check.airframe(v)?;
    let rotors = &airframe.rotors[..airframe.n_rotors];
    let (controller, full_rank) = check.controller(v, &body, rotors, &mut warnings)?;
    for (key, hz) in [
        ("rates.state_hz", v.rates.state_hz),
        ("rates.attitude_hz", v.rates.attitude_hz),
        ("rates.body_rate_hz", v.rates.body_rate_hz),
        ("rates.force_torque_hz", v.rates.force_torque_hz),
    ] {
        check.positive(key, f64::from(hz), "a rate above 0 Hz")?;
    }
    let mut responses = Vec::new();
    let fitted = &v.attitude_response;
    for (name, table) in
        DYNAMICS[1..].iter().zip([&fitted.so_rpy, &fitted.so_rpy_rotor, &fitted.so_rpy_rotor_drag])
    {
        if let Some(table) = table {
            responses.push((*name, check.response(name, table)?));
        }
    }
    check.throttle(v)?;
    let effects = check.effects(&v.effect)?;
    let base = Drone { body, airframe, dynamics: Dynamics::Rotors, controller, effects: Vec::new() };
    check.built_inertia(&base, &effects)?;
    check.hover(&base, &mut warnings);
    Ok(Contents { base, responses, effects, full_rank, warnings })
}

/// A key of a rotor and the value that it gives, in SI.
type Form<'a, const N: usize> = (&'a str, &'a dyn Fn(&Rotor) -> Option<[f64; N]>);

/// Checks of one file.
pub(super) struct Check<'a> {
    file: &'a str,
    /// Number of rotors of the vehicle, where it is known.
    n_rotors: Option<usize>,
}

impl<'a> Check<'a> {
    /// Checks of the file that messages call `file`.
    pub(super) fn of(file: &'a str) -> Self {
        Self { file, n_rotors: None }
    }
}

impl Check<'_> {
    /// Number of rotors of the vehicle, where it is known.
    pub(super) fn rotors(&self) -> Option<usize> {
        self.n_rotors
    }

    /// An error in this file.
    pub(super) fn wrong(
        &self,
        key: impl Into<String>,
        expected: &str,
        found: impl ToString,
        remedy: &str,
    ) -> VehicleError {
        VehicleError::value(self.file, key, expected, found, remedy)
    }

    fn positive(&self, key: impl Into<String>, value: f64, expected: &str) -> Result<f64, VehicleError> {
        if value > 0.0 {
            return Ok(value);
        }
        Err(self.wrong(key, expected, value, "write a positive number in the unit that the key names"))
    }

    fn not_negative(&self, key: impl Into<String>, value: f64) -> Result<f64, VehicleError> {
        if value >= 0.0 {
            return Ok(value);
        }
        Err(self.wrong(key, "a number that is not negative", value, "write 0 or a positive number"))
    }

    fn all_not_negative(&self, key: &str, values: &[f64]) -> Result<(), VehicleError> {
        for (i, value) in values.iter().enumerate() {
            self.not_negative(format!("{key}.{i}"), *value)?;
        }
        Ok(())
    }

    /// The motors turn at some throttle, and faster at more.
    fn throttle(&self, v: &VehicleFile) -> Result<(), VehicleError> {
        let Some(t) = &v.throttle else { return Ok(()) };
        self.not_negative("throttle.offset_v", t.offset_v)?;
        self.not_negative("throttle.back_emf_v_s_per_rad", t.back_emf_v_s_per_rad)?;
        self.not_negative("throttle.load_v_s2_per_rad2", t.load_v_s2_per_rad2)?;
        self.positive("throttle.nominal_v", t.nominal_v, "a voltage above 0 V")?;
        if t.back_emf_v_s_per_rad + t.load_v_s2_per_rad2 == 0.0 {
            return Err(self.wrong(
                "throttle.back_emf_v_s_per_rad",
                "above 0 V·s/rad, or load_v_s2_per_rad2 above 0",
                "0 for both",
                "write what the motors need, or take the table out",
            ));
        }
        Ok(())
    }

    /// Every number in the file is finite.
    fn finite(&self, key: &str, value: &toml::Value) -> Result<(), VehicleError> {
        match value {
            toml::Value::Float(x) if !x.is_finite() => {
                Err(self.wrong(key, "a finite number", x, "write a number that is neither nan nor inf"))
            }
            toml::Value::Array(items) => {
                items.iter().enumerate().try_for_each(|(i, v)| self.finite(&join(key, &i.to_string()), v))
            }
            toml::Value::Table(table) => table.iter().try_for_each(|(k, v)| self.finite(&join(key, k), v)),
            _ => Ok(()),
        }
    }

    /// Every sigma belongs to a value of its table, has its shape, and is not negative.
    fn sigmas(&self, key: &str, value: &toml::Value) -> Result<(), VehicleError> {
        match value {
            toml::Value::Array(items) => {
                items.iter().enumerate().try_for_each(|(i, v)| self.sigmas(&join(key, &i.to_string()), v))
            }
            toml::Value::Table(table) => {
                for (name, inner) in table {
                    if name == "sigma" {
                        continue;
                    }
                    self.sigmas(&join(key, name), inner)?;
                }
                let Some(toml::Value::Table(sigma)) = table.get("sigma") else { return Ok(()) };
                for (name, s) in sigma {
                    let place = join(&join(key, "sigma"), name);
                    let of = table.get(name).filter(|_| !provenance::META.contains(&name.as_str()));
                    let Some(of) = of else {
                        let known: Vec<&str> = table
                            .iter()
                            .filter(|(k, v)| !provenance::META.contains(&k.as_str()) && !v.is_table())
                            .map(|(k, _)| k.as_str())
                            .collect();
                        let expected = format!("a key of the same table ({})", known.join(", "));
                        return Err(self.wrong(
                            place,
                            &expected,
                            name,
                            "give a sigma to a value that this table states",
                        ));
                    };
                    let (mut want, mut have) = (Vec::new(), Vec::new());
                    self.numbers(&join(key, name), "", of, &mut want)?;
                    let by_index = s.is_table();
                    self.sigma_numbers(&place, "", s, &mut have)?;
                    let known = |index: &str| want.iter().any(|(k, _)| k == index);
                    if let Some((index, _)) = have.iter().find(|(index, _)| by_index && !known(index)) {
                        let expected =
                            format!("an index into {name}, {}", shape(want.iter().map(|(k, _)| k.as_str())));
                        return Err(self.wrong(
                            join(&place, index),
                            &expected,
                            index,
                            "count from 0, one index for each pair of brackets around the number",
                        ));
                    }
                    if !by_index && want.iter().map(|(k, _)| k).ne(have.iter().map(|(k, _)| k)) {
                        let expected =
                            format!("the shape of {name}, {}", shape(want.iter().map(|(k, _)| k.as_str())));
                        let found = shape(have.iter().map(|(k, _)| k.as_str()));
                        return Err(self.wrong(
                            place,
                            &expected,
                            found,
                            "write one sigma per number, or those that are known by index",
                        ));
                    }
                    for (index, s) in have {
                        self.not_negative(join(&place, &index), s)?;
                    }
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// All numbers of a value with their indices (`""` for a single number, `1.2` in nested arrays).
    pub(super) fn numbers(
        &self,
        key: &str,
        index: &str,
        value: &toml::Value,
        out: &mut Vec<(String, f64)>,
    ) -> Result<(), VehicleError> {
        match value {
            toml::Value::Float(x) => out.push((index.to_string(), *x)),
            toml::Value::Integer(x) => out.push((index.to_string(), *x as f64)),
            toml::Value::Array(items) => {
                for (i, item) in items.iter().enumerate() {
                    self.numbers(key, &join(index, &i.to_string()), item, out)?;
                }
            }
            other => {
                let place = join(key, index);
                return Err(self.wrong(
                    place,
                    "a number or an array of numbers",
                    format!("a {}", other.type_str()),
                    "write numbers without quotes",
                ));
            }
        }
        Ok(())
    }

    /// [`Check::numbers`] of a sigma, which may be a table by index.
    fn sigma_numbers(
        &self,
        key: &str,
        index: &str,
        value: &toml::Value,
        out: &mut Vec<(String, f64)>,
    ) -> Result<(), VehicleError> {
        match value {
            toml::Value::Table(table) if table.is_empty() => Err(self.wrong(
                join(key, index),
                "a number for at least one index",
                "an empty table",
                "write e.g. 2 = 0.01, or remove the table",
            )),
            toml::Value::Table(table) => table
                .iter()
                .try_for_each(|(name, inner)| self.sigma_numbers(key, &join(index, name), inner, out)),
            other => self.numbers(key, index, other, out),
        }
    }

    /// Effects change the inertia of the body; within its own range each number can still give a matrix that no body has, since
    /// the file's products of inertia come on top.
    fn built_inertia(&self, base: &Drone<f64>, effects: &[ListedEffect]) -> Result<(), VehicleError> {
        for model in DYNAMICS {
            let mut drone = base.clone();
            for (i, listed) in effects.iter().enumerate() {
                if listed.models.as_ref().is_some_and(|m| m.iter().all(|name| name != model)) {
                    continue;
                }
                drone.effects.push(listed.effect);
                let m = drone.parts().body.inertia_kg_m2;
                let moments = principal_moments(m);
                if moments[0] <= largest(m) * LEAST_MOMENT {
                    return Err(self.wrong(
                        format!("effect.{i}"),
                        "an inertia that stays positive definite",
                        format!(
                            "principal moments {moments:?} kg·m² with {} for {model}",
                            listed.effect.label()
                        ),
                        "make the effect's change of the inertia smaller, or correct `body.inertia_kg_m2`",
                    ));
                }
            }
        }
        Ok(())
    }

    fn body(
        &self,
        v: &VehicleFile,
        warnings: &mut Vec<String>,
    ) -> Result<rigid_body::Params<f64>, VehicleError> {
        let body = &v.body;
        self.positive("body.mass_kg", body.mass_kg, "a mass above 0 kg")?;
        let m = body.inertia_kg_m2;
        let size = largest(m);
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            if (m[i][j] - m[j][i]).abs() > SYMMETRY_TOLERANCE * size {
                return Err(self.wrong(
                    format!("body.inertia_kg_m2.{i}.{j}"),
                    &format!("a symmetric matrix, here {}", m[j][i]),
                    m[i][j],
                    "write the same number on both sides of the diagonal",
                ));
            }
        }
        let moments = principal_moments(m);
        if moments[0] <= size * LEAST_MOMENT {
            return Err(self.wrong(
                "body.inertia_kg_m2",
                "a positive definite matrix",
                format!("principal moments {moments:?} kg·m²"),
                "write the inertia about the centre of mass, with positive principal moments",
            ));
        }
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9) {
            warnings.push(format!(
                "{}: `body.inertia_kg_m2`: principal moments {moments:?} kg·m² break the triangle inequality, so no real \
                 body has them; check the inertia",
                self.file
            ));
        }
        Ok(rigid_body::Params::new(body.mass_kg, m, body.gravity_m_s2))
    }

    fn airframe(&self, v: &VehicleFile) -> Result<airframe::Params<f64>, VehicleError> {
        let n = v.rotor.len();
        if !(1..=MAX_ROTORS).contains(&n) {
            return Err(self.wrong(
                "rotor",
                &format!("1 to {MAX_ROTORS} rotors"),
                n,
                "list the rotors as [[rotor]] tables",
            ));
        }
        let none = Rotor::default();
        let default = v.rotor_default.as_ref().unwrap_or(&none);
        for (key, stated) in [("position_m", default.position_m.is_some()), ("spin", default.spin.is_some())]
        {
            if stated {
                return Err(self.wrong(
                    format!("rotor_default.{key}"),
                    "nothing, every rotor has its own",
                    "a value",
                    "move it to the [[rotor]] tables",
                ));
            }
        }
        let mut rotors = Vec::with_capacity(MAX_ROTORS);
        for (i, own) in v.rotor.iter().enumerate() {
            rotors.push(self.rotor(i, own, default)?);
        }
        let first = rotors[0];
        rotors.resize(MAX_ROTORS, first);
        let rotors = core::array::from_fn(|i| rotors[i]);
        Ok(airframe::Params { rotors, n_rotors: n })
    }

    fn rotor(&self, index: usize, own: &Rotor, default: &Rotor) -> Result<rotor::Params<f64>, VehicleError> {
        let key = |name: &str| format!("rotor.{index}.{name}");
        let missing = |name: &str, expected: &str| {
            self.wrong(
                key(name),
                expected,
                "nothing",
                "add it to this [[rotor]] or, where rotors share it, to [rotor_default]",
            )
        };
        let position_m =
            own.position_m.ok_or_else(|| missing("position_m", "the place of the hub, [x, y, z] in m"))?;
        let spin = own.spin.ok_or_else(|| missing("spin", "1 (clockwise from above) or -1"))?;
        if spin.abs() != 1.0 {
            return Err(self.wrong(key("spin"), "1 (clockwise from above) or -1", spin, "write 1 or -1"));
        }
        let axis = self.unit_axis(&key("axis"), own.axis.or(default.axis).unwrap_or([0.0, 0.0, 1.0]))?;

        let thrust_curve = self.one_of(
            index,
            own,
            default,
            &[
                ("thrust_curve_n_per_rpm", &|r| r.thrust_curve_n_per_rpm.map(curve_rpm_to_rad_s)),
                ("thrust_curve_n_per_rad_s", &|r| r.thrust_curve_n_per_rad_s),
            ],
        )?;
        if thrust_curve[2] <= 0.0 {
            return Err(self.wrong(
                key("thrust_curve (c2)"),
                "a quadratic coefficient above 0",
                thrust_curve[2],
                "write [c0, c1, c2] in powers of the speed, the last one positive",
            ));
        }
        let torque_curve = self.one_of(
            index,
            own,
            default,
            &[
                ("torque_curve_n_m_per_rpm", &|r| r.torque_curve_n_m_per_rpm.map(curve_rpm_to_rad_s)),
                ("torque_curve_n_m_per_rad_s", &|r| r.torque_curve_n_m_per_rad_s),
                ("torque_per_thrust_m", &|r| r.torque_per_thrust_m.map(|k| thrust_curve.map(|c| k * c))),
            ],
        )?;
        let [spin_up, spin_down] = self.lags(index, own, default)?;
        let inertia = own.inertia_kg_m2.or(default.inertia_kg_m2);
        let inertia_kg_m2 = inertia.ok_or_else(|| {
            missing("inertia_kg_m2", "the inertia of propeller and bell, kg·m² (0 drops its torques)")
        })?;
        self.not_negative(key("inertia_kg_m2"), inertia_kg_m2)?;
        let radius = own.radius_m.or(default.radius_m);
        let radius_m = radius.ok_or_else(|| missing("radius_m", "the propeller radius in m"))?;
        self.positive(key("radius_m"), radius_m, "a radius above 0 m")?;
        Ok(rotor::Params {
            position_m,
            axis,
            spin,
            thrust_curve,
            torque_curve,
            spin_up,
            spin_down,
            inertia_kg_m2,
            radius_m,
        })
    }

    /// An axis of length 1.
    fn unit_axis(&self, key: &str, axis: [f64; 3]) -> Result<[f64; 3], VehicleError> {
        let length = (axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]).sqrt();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(self.wrong(
                key,
                "a unit vector",
                format!("{axis:?} of length {length}"),
                "divide the numbers by the length",
            ));
        }
        Ok(axis.map(|a| a / length))
    }

    /// How a rotor speeds up and slows down: [c_v 1/s, c_d 1/rad] each.
    fn lags(&self, index: usize, own: &Rotor, default: &Rotor) -> Result<[[f64; 2]; 2], VehicleError> {
        let rpm = |c: [f64; 2]| [c[0], c[1] / RAD_S_PER_RPM];
        // A time constant that is not positive is caught below: it gives no positive coefficient.
        let lag = |tau: f64| [if tau > 0.0 { 1.0 / tau } else { -1.0 }, 0.0];
        let spin_up = self.one_of(
            index,
            own,
            default,
            &[
                ("spin_up_per_s_and_per_rpm_s", &|r| r.spin_up_per_s_and_per_rpm_s.map(rpm)),
                ("spin_up_per_s_and_per_rad", &|r| r.spin_up_per_s_and_per_rad),
                ("time_constant_up_s", &|r| r.time_constant_up_s.map(lag)),
            ],
        )?;
        let spin_down = self.one_of(
            index,
            own,
            default,
            &[
                ("spin_down_per_s_and_per_rpm_s", &|r| r.spin_down_per_s_and_per_rpm_s.map(rpm)),
                ("spin_down_per_s_and_per_rad", &|r| r.spin_down_per_s_and_per_rad),
                ("time_constant_down_s", &|r| r.time_constant_down_s.map(lag)),
            ],
        )?;
        for (name, c) in
            [("spin_up (or time_constant_up_s)", spin_up), ("spin_down (or time_constant_down_s)", spin_down)]
        {
            if c[0] < 0.0 || c[1] < 0.0 || (c[0] == 0.0 && c[1] == 0.0) {
                return Err(self.wrong(
                    format!("rotor.{index}.{name}"),
                    "coefficients that are not negative and not both 0, or a positive time constant",
                    format!("c_v = {} 1/s, c_d = {} 1/rad", c[0], c[1]),
                    "write [c_v, c_d] with at least one positive number",
                ));
            }
        }
        Ok([spin_up, spin_down])
    }

    /// The value that a rotor, or else the default, gives in exactly one of several forms.
    fn one_of<const N: usize>(
        &self,
        index: usize,
        own: &Rotor,
        default: &Rotor,
        forms: &[Form<N>],
    ) -> Result<[f64; N], VehicleError> {
        let names = forms.iter().map(|f| f.0).collect::<Vec<_>>().join(" or ");
        for (table, rotor) in [(format!("rotor.{index}"), own), ("rotor_default".to_string(), default)] {
            let given: Vec<_> =
                forms.iter().filter_map(|(name, get)| get(rotor).map(|v| (*name, v))).collect();
            match given.as_slice() {
                [] => {}
                [(_, value)] => return Ok(*value),
                [(a, _), (b, _), ..] => {
                    return Err(self.wrong(
                        format!("{table}.{b}"),
                        &format!("only one of {names}"),
                        format!("{a} and {b}"),
                        "keep the form in which the value was published",
                    ));
                }
            }
        }
        Err(self.wrong(
            format!("rotor.{index}.{}", forms[0].0),
            &names,
            "nothing",
            "add it to this [[rotor]] or, where rotors share it, to [rotor_default]",
        ))
    }

    fn controller(
        &self,
        v: &VehicleFile,
        body: &rigid_body::Params<f64>,
        rotors: &[rotor::Params<f64>],
        warnings: &mut Vec<String>,
    ) -> Result<(mellinger::Params<f64>, bool), VehicleError> {
        match (&v.controller.mellinger, &v.controller.direct) {
            (Some(m), None) => Ok((self.mellinger(m, rotors)?, true)),
            (None, Some(d)) => self.direct(d, body, rotors, warnings),
            (both, _) => Err(self.wrong(
                "controller",
                "one of [controller.mellinger] and [controller.direct]",
                if both.is_some() { "both" } else { "none" },
                "keep the control law, or the limits of a vehicle that is commanded by rotor speeds",
            )),
        }
    }

    fn thrust_limits(&self, table: &str, min: f64, max: f64) -> Result<(), VehicleError> {
        self.not_negative(format!("{table}.thrust_min_n"), min)?;
        if min < max {
            return Ok(());
        }
        Err(self.wrong(
            format!("{table}.thrust_min_n"),
            &format!("less than thrust_max_n, {max}"),
            min,
            "write the thrust of one rotor at its least and greatest speed",
        ))
    }

    fn mellinger(
        &self,
        m: &Mellinger,
        rotors: &[rotor::Params<f64>],
    ) -> Result<mellinger::Params<f64>, VehicleError> {
        let table = "controller.mellinger";
        let key = |name: &str| format!("{table}.{name}");
        self.positive(key("mass_kg"), m.mass_kg, "a mass above 0 kg")?;
        self.positive(key("mass_thrust_pwm_per_n"), m.mass_thrust_pwm_per_n, "a factor above 0")?;
        self.not_negative(key("pwm_min"), m.pwm_min)?;
        if m.pwm_min >= m.pwm_max {
            let expected = format!("less than pwm_max, {}", m.pwm_max);
            return Err(self.wrong(
                key("pwm_min"),
                &expected,
                m.pwm_min,
                "write the least and the greatest PWM of a turning motor",
            ));
        }
        self.thrust_limits(table, m.thrust_min_n, m.thrust_max_n)?;
        self.all_not_negative(&key("torque_pwm_max"), &m.torque_pwm_max)?;
        self.positive(key("thrust_to_torque_m"), m.thrust_to_torque_m, "a length above 0 m")?;
        let s = &m.state;
        for (name, values) in [
            ("state.kp_n_per_m", s.kp_n_per_m),
            ("state.kd_n_s_per_m", s.kd_n_s_per_m),
            ("state.ki_n_per_m_s", s.ki_n_per_m_s),
            ("state.integral_max_m_s", s.integral_max_m_s),
        ] {
            self.all_not_negative(&key(name), &values)?;
        }
        let (mixer, rank) = mixer::mixer(rotors, &vec![m.thrust_to_torque_m; rotors.len()]);
        if rank < 4 {
            return Err(self.wrong(
                "rotor",
                "places and spins that can make thrust and torque about x, y and z",
                format!("{} rotors of rank {rank} of 4", rotors.len()),
                "correct position_m and spin, or replace [controller.mellinger] by [controller.direct] and command rotor speeds",
            ));
        }
        Ok(mellinger::Params {
            mass_kg: m.mass_kg,
            mass_thrust: m.mass_thrust_pwm_per_n,
            pwm_min: m.pwm_min,
            pwm_max: m.pwm_max,
            thrust_min_n: m.thrust_min_n,
            thrust_max_n: m.thrust_max_n,
            torque_pwm_max: m.torque_pwm_max,
            thrust_curve: rotors[0].thrust_curve,
            state: StateGains {
                kp: s.kp_n_per_m,
                kd: s.kd_n_s_per_m,
                ki: s.ki_n_per_m_s,
                integral_max: s.integral_max_m_s,
            },
            attitude: self.stage(&key("attitude"), &m.attitude)?,
            body_rate: self.stage(&key("body_rate"), &m.body_rate)?,
            mixer,
        })
    }

    fn stage(&self, key: &str, s: &AttitudeStage) -> Result<AttitudeGains<f64>, VehicleError> {
        for (name, values) in [
            ("kr_pwm", s.kr_pwm),
            ("kw_pwm_s", s.kw_pwm_s),
            ("ki_pwm_per_s", s.ki_pwm_per_s),
            ("kd_omega_pwm_s2", s.kd_omega_pwm_s2),
            ("integral_max_s", s.integral_max_s),
        ] {
            self.all_not_negative(&format!("{key}.{name}"), &values)?;
        }
        Ok(AttitudeGains {
            kr: s.kr_pwm,
            kw: s.kw_pwm_s,
            ki: s.ki_pwm_per_s,
            kd_omega: s.kd_omega_pwm_s2,
            integral_max: s.integral_max_s,
        })
    }

    /// Limits and mixing without a control law: all gains zero, torque per thrust as the curves have it at hover.
    fn direct(
        &self,
        d: &Direct,
        body: &rigid_body::Params<f64>,
        rotors: &[rotor::Params<f64>],
        warnings: &mut Vec<String>,
    ) -> Result<(mellinger::Params<f64>, bool), VehicleError> {
        self.thrust_limits("controller.direct", d.thrust_min_n, d.thrust_max_n)?;
        let middle = 0.5 * (d.thrust_min_n + d.thrust_max_n);
        let ratios: Vec<f64> = rotors
            .iter()
            .map(|r| rotor::curve(r.torque_curve, rotor::speed_for_thrust(r.thrust_curve, middle)) / middle)
            .collect();
        let (mixer, rank) = mixer::mixer(rotors, &ratios);
        if rank < 4 {
            warnings.push(format!(
                "{}: `rotor`: these {} rotors cannot make thrust and torque about x, y and z apart (rank {rank} of 4); only \
                 commands of rotor speeds are meaningful",
                self.file,
                rotors.len()
            ));
        }
        let zero = AttitudeGains {
            kr: [0.0; 3],
            kw: [0.0; 3],
            ki: [0.0; 3],
            kd_omega: [0.0; 3],
            integral_max: [0.0; 3],
        };
        let params = mellinger::Params {
            mass_kg: body.mass_kg,
            mass_thrust: 1.0 / (d.thrust_max_n * rotors.len() as f64),
            pwm_min: d.thrust_min_n / d.thrust_max_n,
            pwm_max: 1.0,
            thrust_min_n: d.thrust_min_n,
            thrust_max_n: d.thrust_max_n,
            torque_pwm_max: [0.0; 3],
            thrust_curve: rotors[0].thrust_curve,
            state: StateGains { kp: [0.0; 3], kd: [0.0; 3], ki: [0.0; 3], integral_max: [0.0; 3] },
            attitude: zero,
            body_rate: zero,
            mixer,
        };
        Ok((params, rank == 4))
    }

    fn response(&self, name: &str, r: &Response) -> Result<attitude_response::Params<f64>, VehicleError> {
        let key = |field: &str| format!("attitude_response.{name}.{field}");
        self.positive(key("thrust_scale"), r.thrust_scale, "a factor above 0")?;
        let thrust_dynamics = name != SO_RPY;
        let thrust_rate_per_s = match (thrust_dynamics, r.thrust_rate_per_s) {
            (true, Some(rate)) => self.positive(key("thrust_rate_per_s"), rate, "a rate above 0 1/s")?,
            (true, None) => {
                return Err(self.wrong(
                    key("thrust_rate_per_s"),
                    "the rate at which thrust follows its command, 1/s",
                    "nothing",
                    "add it, or name the table so_rpy if thrust answers at once",
                ));
            }
            (false, None) => 0.0,
            (false, Some(rate)) => {
                return Err(self.wrong(
                    key("thrust_rate_per_s"),
                    "nothing, in so_rpy thrust answers at once",
                    rate,
                    "remove it, or name the table so_rpy_rotor",
                ));
            }
        };
        Ok(attitude_response::Params {
            thrust_offset_n: r.thrust_offset_n,
            thrust_scale: r.thrust_scale,
            thrust_rate_per_s,
            angle_gain_per_s2: r.angle_gain_per_s2,
            rate_gain_per_s: r.rate_gain_per_s,
            command_gain_per_s2: r.command_gain_per_s2,
            thrust_dynamics,
        })
    }

    /// Warnings about vehicles that cannot stay in the air.
    fn hover(&self, drone: &Drone<f64>, warnings: &mut Vec<String>) {
        let n = drone.airframe.n_rotors as f64;
        let (weight, c) = (drone.hover_thrust(), &drone.controller);
        if n * c.thrust_max_n < weight {
            warnings.push(format!(
                "{}: all rotors together lift at most {:.4} N, the vehicle weighs {weight:.4} N: it cannot hover; check \
                 thrust_max_n and mass_kg",
                self.file,
                n * c.thrust_max_n
            ));
        }
        if n * c.thrust_min_n > weight {
            warnings.push(format!(
                "{}: all rotors together lift at least {:.4} N, the vehicle weighs {weight:.4} N: it cannot sink; check \
                 thrust_min_n and mass_kg",
                self.file,
                n * c.thrust_min_n
            ));
        }
        for i in 0..drone.airframe.n_rotors {
            let curve = drone.airframe.rotors[i].thrust_curve;
            let slowest = rotor::speed_for_thrust(curve, c.thrust_min_n);
            let reached = rotor::curve(curve, slowest);
            if slowest < 0.0 || (reached - c.thrust_min_n).abs() > 1e-9 * c.thrust_max_n {
                warnings.push(format!(
                    "{}: `rotor.{i}`: its thrust curve does not reach down to thrust_min_n = {} N at any forward speed",
                    self.file, c.thrust_min_n
                ));
            }
        }
    }
}

/// In words: how many numbers there are, nested how.
pub(super) fn shape<'a>(indices: impl Iterator<Item = &'a str>) -> String {
    let indices: Vec<&str> = indices.collect();
    match indices.last() {
        None => "no numbers".into(),
        Some(&"") => "one number".into(),
        Some(last) => {
            let sizes: Vec<String> = last
                .split('.')
                .map(|i| i.parse::<usize>().map_or_else(|_| i.into(), |i| (i + 1).to_string()))
                .collect();
            format!("{} numbers ({})", indices.len(), sizes.join(" × "))
        }
    }
}
