//! Writes an identified model into a vehicle file.

use super::{AXES, AttitudeModelError, Identification};
use propwash_physics::effects::command_delay::MAX_DELAY_S;
use propwash_vehicle::schema::{AttitudeResponses, EffectEntry, LogHashes, Response, Sigma, VehicleFile};
use propwash_vehicle::{DYNAMICS, Vehicle};

/// The table of one of the attitude models.
pub(super) fn response_mut<'a>(
    responses: &'a mut AttitudeResponses,
    dynamics: &str,
) -> &'a mut Option<Response> {
    if dynamics == DYNAMICS[1] {
        &mut responses.so_rpy
    } else if dynamics == DYNAMICS[2] {
        &mut responses.so_rpy_rotor
    } else {
        &mut responses.so_rpy_rotor_drag
    }
}

impl Identification {
    /// The vehicle with these values in `[attitude_response.…]`, with linear drag where the model has it, and with the
    /// command delay where it exceeds its uncertainty; each with sigma, source, hash of the log and `date`. Other dynamics
    /// are unchanged.
    ///
    /// # Errors
    /// [`AttitudeModelError::Vehicle`] when the values are not valid in a vehicle file.
    pub fn apply(&self, vehicle: &Vehicle, date: &str) -> Result<Vehicle, AttitudeModelError> {
        let mut file = vehicle.file().clone();
        let log = std::path::Path::new(&self.log);
        let name = log.file_name().map_or_else(|| self.log.clone(), |n| n.to_string_lossy().into_owned());
        let source = format!("propwash identify --model attitude, {name}");
        let values = |name: &str| -> [f64; 3] {
            std::array::from_fn(|k| self.get(&format!("{name}.{}", AXES[k])).map_or(0.0, |p| p.value))
        };
        let value = |name: &str| self.get(name).map(|p| p.value);
        let mut sigma = Sigma::new();
        for name in ["angle_gain_per_s2", "rate_gain_per_s", "command_gain_per_s2"] {
            // A held axis has no known standard deviation; then the whole sigma array is left out.
            let all: Vec<Option<f64>> =
                AXES.iter().map(|a| self.get(&format!("{name}.{a}")).and_then(|p| p.sigma)).collect();
            if let Some(all) = all.into_iter().collect::<Option<Vec<f64>>>() {
                sigma.insert(name.into(), all.into());
            }
        }
        for name in ["thrust_offset_n", "thrust_scale", "thrust_rate_per_s"] {
            if let Some(s) = self.get(name).and_then(|p| p.sigma) {
                sigma.insert(name.into(), s.into());
            }
        }
        let held: Vec<String> = self
            .parameters
            .iter()
            .filter_map(|p| p.held.as_ref().map(|from| format!("{} is held at {from}", p.name)))
            .collect();
        let mut note =
            format!("Holds for a mass of {} kg: only thrust and drag by mass are identified.", self.mass_kg);
        if !held.is_empty() {
            note += &format!(" Not identified: {}.", held.join(", "));
        }
        *response_mut(&mut file.attitude_response, self.dynamics) = Some(Response {
            thrust_offset_n: value("thrust_offset_n").unwrap_or(0.0),
            thrust_scale: value("thrust_scale").unwrap_or(1.0),
            thrust_rate_per_s: value("thrust_rate_per_s"),
            angle_gain_per_s2: values("angle_gain_per_s2"),
            rate_gain_per_s: values("rate_gain_per_s"),
            command_gain_per_s2: values("command_gain_per_s2"),
            source: Some(format!("{source} (sha256 {}), {date}", self.log_sha256)),
            note: Some(note),
            sigma,
        });
        let entry = |kind: &str, param: &str, value: toml::Value, sigma: toml::Value| EffectEntry {
            kind: kind.into(),
            models: Some(vec![self.dynamics.into()]),
            source: Some(source.clone()),
            source_log_sha256: Some(LogHashes::One(self.log_sha256.clone())),
            date: Some(date.into()),
            note: None,
            params: [(param.to_string(), value)].into(),
            sigma: [(param.to_string(), sigma)].into(),
        };
        if self.get("drag_n_s_per_m.x").is_some() {
            take_from(&mut file, "linear_drag", self.dynamics);
            let diagonal = |f: &dyn Fn(usize) -> f64| -> toml::Value {
                let row =
                    |i: usize| -> Vec<f64> { (0..3).map(|j| if i == j { f(i) } else { 0.0 }).collect() };
                (0..3).map(row).collect::<Vec<_>>().into()
            };
            let of = |k: usize| self.get(&format!("drag_n_s_per_m.{}", ["x", "y", "z"][k]));
            file.effect.push(entry(
                "linear_drag",
                "drag_n_s_per_m",
                diagonal(&|k| of(k).map_or(0.0, |p| p.value)),
                diagonal(&|k| of(k).and_then(|p| p.sigma).unwrap_or(0.0)),
            ));
        }
        // Removed even if the new delay is insignificant: the response was identified together with the new one.
        take_from(&mut file, "command_delay", self.dynamics);
        if let Some(delay) = self.get("command_delay_s") {
            let sigma = delay.sigma.unwrap_or(0.0);
            if delay.value > 2.0 * sigma && delay.value > 2e-4 && delay.value <= MAX_DELAY_S {
                file.effect.push(entry("command_delay", "delay_s", delay.value.into(), sigma.into()));
            }
        }
        Ok(Vehicle::from_file(&vehicle.name, file)?)
    }

    /// As [`Identification::apply`], for a file in any folder: a shell's path counts from the vehicle file, and is written in full.
    ///
    /// # Errors
    /// As [`Identification::apply`].
    pub fn vehicle_for_any_folder(
        &self,
        vehicle: &Vehicle,
        date: &str,
    ) -> Result<Vehicle, AttitudeModelError> {
        let better = self.apply(vehicle, date)?;
        let Some(path) = vehicle.shell_path().and_then(|shell| std::fs::canonicalize(shell).ok()) else {
            return Ok(better);
        };
        let mut file = better.file().clone();
        file.shell = path.display().to_string();
        Ok(Vehicle::from_file(&vehicle.name, file)?)
    }
}

/// Removes an effect from the dynamics that are about to get a new one; others keep it.
fn take_from(file: &mut VehicleFile, kind: &str, dynamics: &str) {
    for entry in file.effect.iter_mut().filter(|e| e.kind == kind) {
        let all = || DYNAMICS.iter().map(|d| (*d).to_string()).collect();
        let mut models: Vec<String> = entry.models.clone().unwrap_or_else(all);
        models.retain(|m| m != dynamics);
        entry.models = Some(models);
    }
    file.effect.retain(|e| e.kind != kind || e.models.as_ref().is_none_or(|m| !m.is_empty()));
}
