//! What a caller changes in the description of a flight: flags of `propwash fly`, arguments of Python's `propwash.fly`.

use serde_json::{Map, Value, json};

use super::recorder::{FlightConfig, refuse};
use crate::arena::{ArenaError, read_value};
use crate::error::Result;

/// Most worlds of a data set.
pub const MAX_WORLDS: usize = 10_000_000;
/// Most drones in a world of a data set.
pub const MAX_DRONES: usize = 1024;

/// Fields of a camera that say the same in another way: where it sits, and how wide it sees.
const INSTEAD: [[&str; 2]; 3] = [["name", "mount"], ["fovy_deg", "pinhole_px"], ["pinhole_px", "fovy_deg"]];

impl FlightConfig {
    /// This description with other fields, by their names in files. Beside them there are `dynamics` and `shell`, those of all drones.
    ///
    /// What only went with a field that is changed goes with it, unless it is given too: the layouts of a scene, the number of drones that
    /// were listed, the hash of a scene with other drones, the place of a camera with another name, its field of view with intrinsics.
    /// `camera` changes the fields that it holds, and `sensors` come beside those that there are.
    ///
    /// ```
    /// use propwash::dataset::recorder::FlightConfig;
    ///
    /// let text = "scene = { files = [\"room\"] }\n[camera]\nwidth = 8\nfovy_deg = 60.0";
    /// let changes = serde_json::json!({ "n_worlds": 3, "camera": { "pinhole_px": [9.0, 9.0, 4.0, 3.0] } });
    /// let config = FlightConfig::from_text(text)?.changed(changes.as_object().unwrap().clone())?;
    /// let camera = config.sim.camera.unwrap();
    /// assert_eq!((config.sim.options.n_worlds, camera.width, camera.fovy_deg), (3, Some(8), None));
    /// # Ok::<(), propwash::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`ArenaError`], naming the field that is not known, or that cannot have its value.
    pub fn changed(&self, mut changes: Map<String, Value>) -> Result<Self> {
        let mut all = table("all of it", self)?;
        let goes_with = [
            (&["scene"][..], "layouts", Value::Null),
            (&["scene"], "layout", Value::Null),
            (&["drones"], "n_drones", Value::Null),
            (&["scene", "drones", "n_drones", "shell"], "scene_sha256", json!([])),
        ];
        for (fields, other, nothing) in goes_with {
            if fields.iter().any(|field| changes.contains_key(*field)) {
                changes.entry(other).or_insert(nothing);
            }
        }
        let of_all: Map<String, Value> =
            ["dynamics", "shell"].iter().filter_map(|field| changes.remove_entry(*field)).collect();
        let listed = changes.get_mut("drones").or(all.get_mut("drones")).and_then(Value::as_array_mut);
        for drone in listed.into_iter().flatten().filter_map(Value::as_object_mut) {
            drone.extend(of_all.clone());
        }
        if let (Some(Value::Object(camera)), Some(Value::Object(fields))) =
            (all.get("camera"), changes.get_mut("camera"))
        {
            let mut camera = camera.clone();
            change_camera(&mut camera, std::mem::take(fields));
            *fields = camera;
        }
        if let (Some(Value::Array(there)), Some(Value::Array(more))) =
            (all.get("sensors"), changes.get_mut("sensors"))
        {
            more.splice(0..0, there.iter().cloned());
        }
        all.extend(changes);
        let made: Self = read_value(Value::Object(all))?;
        let counts = [
            ("n_worlds", made.sim.options.n_worlds, MAX_WORLDS),
            ("n_drones", made.sim.n_drones(), MAX_DRONES),
        ];
        match counts.into_iter().find(|(_, n, most)| !(1..=*most).contains(n)) {
            Some((name, n, most)) => refuse(name, format!("1 to {most}"), n),
            None => Ok(made),
        }
    }
}

/// Other fields of a camera, each in the place of the one that says the same in another way.
pub fn change_camera(camera: &mut Map<String, Value>, fields: Map<String, Value>) {
    for [given, other] in INSTEAD {
        if fields.get(given).is_some_and(|value| !value.is_null()) && !fields.contains_key(other) {
            camera.insert(other.into(), Value::Null);
        }
    }
    camera.extend(fields);
}

/// A description as a table.
pub fn table(place: &str, of: &impl serde::Serialize) -> Result<Map<String, Value>, ArenaError> {
    let refused = |reason: String| ArenaError::Config { place: place.into(), reason };
    match serde_json::to_value(of).map_err(|e| refused(e.to_string()))? {
        Value::Object(fields) => Ok(fields),
        other => Err(refused(format!("expected a table, got {other}"))),
    }
}
