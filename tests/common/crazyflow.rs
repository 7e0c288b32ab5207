//! The reference data of Crazyflow 0.4.0, made by `tests/reference/crazyflow_reference.py` and kept in the target folder.

#![allow(dead_code, reason = "every test program uses its own part of this")]

use std::collections::HashMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::{env, process};

use ndarray::{ArrayD, OwnedRepr};
use ndarray_npy::NpzReader;
use propwash::physics::controllers::{mellinger, mixer};
use propwash::physics::drone::{Drone, Dynamics};
use propwash::physics::effects::{AnyEffect, linear_drag};
use propwash::physics::rigid_body::MAX_ROTORS;
use propwash::physics::{airframe, attitude_response, rigid_body, rotor};
use propwash::units::{RAD_S_PER_RPM, curve_rpm_to_rad_s};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// Version of Crazyflow that everything here was compared with.
pub const VERSION: &str = "0.4.0";

/// Vehicles of Crazyflow.
pub const VEHICLES: [&str; 5] = ["cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500", "hb_x500"];

/// Dynamics of Crazyflow.
pub const DYNAMICS: [&str; 4] = ["first_principles", "so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"];

const SCRIPT: &str = "tests/reference/crazyflow_reference.py";

/// Folder of the reference data, with its parameters.
pub struct Reference {
    dir: PathBuf,
    /// Contents of `params.json`.
    pub params: Value,
    /// One line: what was compared with.
    pub versions: String,
}

/// The reference data, made on first use; `None`, after saying so, where no Python with Crazyflow was named.
///
/// `PROPWASH_PYTHON` names that Python. With `PROPWASH_REQUIRE_PEERS=1` its absence is a failure.
pub fn reference() -> Option<&'static Reference> {
    static REFERENCE: OnceLock<Option<Reference>> = OnceLock::new();
    let found = REFERENCE.get_or_init(|| {
        let dir = find_or_make()?;
        let versions: Value = read_json(&dir.join("versions.json"));
        assert_eq!(versions["crazyflow"], VERSION, "another Crazyflow made {}", dir.display());
        let names = ["crazyflow", "jax", "numpy", "scipy", "python"];
        let list: Vec<String> =
            names.iter().map(|n| format!("{n} {}", versions[*n].as_str().unwrap_or("?"))).collect();
        Some(Reference { params: read_json(&dir.join("params.json")), versions: list.join(", "), dir })
    });
    if found.is_none() {
        println!(
            "skipped: no Python with Crazyflow {VERSION} (PROPWASH_PYTHON is not set): run `cargo xtask test`"
        );
    }
    found.as_ref()
}

fn find_or_make() -> Option<PathBuf> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join(SCRIPT);
    let text = fs::read(&script).unwrap_or_else(|e| panic!("{}: {e}", script.display()));
    let hash: String = Sha256::digest(&text).iter().take(6).map(|b| format!("{b:02x}")).collect();
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().expect("the target folder");
    let dir = target.join("reference").join(format!("crazyflow-{VERSION}-{hash}"));
    if dir.is_dir() {
        return Some(dir);
    }
    let Some(python) = env::var_os("PROPWASH_PYTHON") else {
        let required = env::var("PROPWASH_REQUIRE_PEERS").is_ok_and(|v| v == "1");
        assert!(!required, "PROPWASH_REQUIRE_PEERS=1 but PROPWASH_PYTHON is not set: run `cargo xtask test`");
        return None;
    };
    let part = dir.with_extension(format!("part{}", process::id()));
    let _ = fs::remove_dir_all(&part);
    println!("making {} (about two minutes, once)", dir.display());
    let folder = dir.parent().expect("target/reference").to_path_buf();
    fs::create_dir_all(&folder).unwrap_or_else(|e| panic!("cannot make {}: {e}", folder.display()));
    let run = Command::new(&python)
        .arg(&script)
        .arg(&part)
        // MuJoCo leaves its log in the current folder.
        .current_dir(&folder)
        .output()
        .unwrap_or_else(|e| panic!("cannot run PROPWASH_PYTHON={}: {e}", python.display()));
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{} failed: {}\n{said}", script.display(), run.status);
    // Another test program may have been first; its folder is as good.
    if fs::rename(&part, &dir).is_err() {
        assert!(dir.is_dir(), "cannot rename {} to {}", part.display(), dir.display());
        let _ = fs::remove_dir_all(&part);
    }
    Some(dir)
}

fn read_json(path: &Path) -> Value {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

impl Reference {
    /// All arrays of `NAME.npz`.
    pub fn arrays(&self, name: &str) -> Arrays {
        let path = self.dir.join(format!("{name}.npz"));
        let file = File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut npz = NpzReader::new(file).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let names = npz.names().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut arrays = HashMap::new();
        for name in names {
            let array: ArrayD<f64> = npz
                .by_name::<OwnedRepr<f64>, _>(&name)
                .unwrap_or_else(|e| panic!("{} {name}: {e}", path.display()));
            let shape = array.shape().to_vec();
            arrays.insert(name, Array { shape, data: array.iter().copied().collect() });
        }
        Arrays { arrays }
    }

    /// Contents of `NAME.json`.
    pub fn json(&self, name: &str) -> Value {
        read_json(&self.dir.join(format!("{name}.json")))
    }

    /// Whether Crazyflow has parameters of these dynamics for this vehicle.
    pub fn has(&self, vehicle: &str, dynamics: &str) -> bool {
        self.params[vehicle]["dynamics"][dynamics].is_object()
    }
}

/// Arrays by name.
pub struct Arrays {
    arrays: HashMap<String, Array>,
}

impl Arrays {
    /// The array called `name`.
    pub fn get(&self, name: &str) -> &Array {
        self.arrays.get(name).unwrap_or_else(|| panic!("the reference has no array {name}"))
    }
}

/// An array in row-major order.
pub struct Array {
    /// Its shape.
    pub shape: Vec<usize>,
    data: Vec<f64>,
}

impl Array {
    /// The `N` numbers at the leading indices `at`.
    pub fn at<const N: usize>(&self, at: &[usize]) -> [f64; N] {
        let row = self.row(at);
        assert_eq!(row.len(), N, "shape {:?} at {at:?}", self.shape);
        core::array::from_fn(|i| row[i])
    }

    /// The number at the indices `at`.
    pub fn number(&self, at: &[usize]) -> f64 {
        self.at::<1>(at)[0]
    }

    /// All numbers at the leading indices `at`.
    pub fn row(&self, at: &[usize]) -> &[f64] {
        let mut start = 0;
        for (i, k) in at.iter().enumerate() {
            assert!(*k < self.shape[i], "index {at:?} in shape {:?}", self.shape);
            start = start * self.shape[i] + k;
        }
        let len: usize = self.shape[at.len()..].iter().product();
        &self.data[start * len..(start + 1) * len]
    }
}

fn number(v: &Value) -> f64 {
    match v {
        Value::Array(items) if items.len() == 1 => number(&items[0]),
        _ => v.as_f64().unwrap_or_else(|| panic!("expected a number, found {v}")),
    }
}

fn numbers<const N: usize>(v: &Value) -> [f64; N] {
    core::array::from_fn(|i| number(&v[i]))
}

fn rows<const N: usize, const M: usize>(v: &Value) -> [[f64; N]; M] {
    core::array::from_fn(|i| numbers(&v[i]))
}

/// A rotor that is not there.
fn no_rotor() -> rotor::Params<f64> {
    rotor::Params {
        position_m: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        spin: 0.0,
        thrust_curve: [0.0; 3],
        torque_curve: [0.0; 3],
        spin_up: [0.0; 2],
        spin_down: [0.0; 2],
        inertia_kg_m2: 0.0,
        radius_m: 0.0,
    }
}

/// Crazyflow's vehicle as ours, from the parameters that Crazyflow itself loads.
///
/// Where Crazyflow has no first-principles parameters (`hb_x500`) the rotors are those that its controller believes in, and
/// they never spin up. The propeller radius is not known to Crazyflow and is zero here.
pub fn drone_from_reference(reference: &Reference, vehicle: &str, dynamics: &str) -> Drone<f64> {
    let table = &reference.params[vehicle];
    let own = &table["dynamics"][dynamics];
    assert!(own.is_object(), "Crazyflow has no {dynamics} parameters for {vehicle}");
    let controller = controller(&table["controller"]);

    let full = &table["dynamics"]["first_principles"];
    let source = if full.is_object() { full } else { &table["controller"]["core"] };
    let mixing: [[f64; 4]; 3] = rows(&source["mixing_matrix"]);
    let arm = number(&source["L"]);
    let mut rotors = [no_rotor(); MAX_ROTORS];
    for i in 0..4 {
        rotors[i] = rotor::Params {
            // A rotor at (x, y) lifts with the torque (y, -x).
            position_m: [-arm * mixing[1][i], arm * mixing[0][i], 0.0],
            axis: [0.0, 0.0, 1.0],
            spin: mixing[2][i],
            thrust_curve: curve_rpm_to_rad_s(numbers(&source["rpm2thrust"])),
            torque_curve: curve_rpm_to_rad_s(numbers(&source["rpm2torque"])),
            ..no_rotor()
        };
        if full.is_object() {
            let c: [f64; 4] = numbers(&full["rotor_dyn_coef"]);
            rotors[i].spin_up = [c[0], c[1] / RAD_S_PER_RPM];
            rotors[i].spin_down = [c[2], c[3] / RAD_S_PER_RPM];
            rotors[i].inertia_kg_m2 = number(&full["prop_inertia"]);
        }
    }

    let response = || {
        let lagging = own.get("thrust_dyn_coef");
        attitude_response::Params {
            thrust_offset_n: number(&own["acc_coef"]),
            thrust_scale: number(&own["cmd_f_coef"]),
            thrust_rate_per_s: lagging.map_or(0.0, number),
            angle_gain_per_s2: numbers(&own["rpy_coef"]),
            rate_gain_per_s: numbers(&own["rpy_rates_coef"]),
            command_gain_per_s2: numbers(&own["cmd_rpy_coef"]),
            thrust_dynamics: lagging.is_some(),
        }
    };
    let effects = match own.get("drag_matrix") {
        // Crazyflow's matrix multiplies the velocity; ours brakes where it is positive.
        Some(matrix) => vec![AnyEffect::LinearDrag(linear_drag::Params {
            drag_n_s_per_m: rows(matrix).map(|row: [f64; 3]| row.map(|d| -d)),
        })],
        None => vec![],
    };
    Drone {
        body: rigid_body::Params::new(number(&own["mass"]), rows(&own["J"]), numbers(&own["gravity_vec"])),
        airframe: airframe::Params { rotors, n_rotors: 4 },
        dynamics: if dynamics == "first_principles" {
            Dynamics::Rotors
        } else {
            Dynamics::AttitudeResponse(response())
        },
        controller,
        effects,
    }
}

fn controller(table: &Value) -> mellinger::Params<f64> {
    let core = &table["core"];
    let mixing: [[f64; 4]; 3] = rows(&core["mixing_matrix"]);
    let arm = number(&core["L"]);
    let yaw = number(&core["thrust2torque"]);
    let mut mixer = mixer::Params {
        signs: [[0.0; 3]; MAX_ROTORS],
        rotor_from_wrench: [[0.0; 4]; MAX_ROTORS],
        wrench_from_rotor: [[0.0; 4]; MAX_ROTORS],
        beside: [[0.0; 4]; 4],
        n_rotors: 4,
    };
    for i in 0..4 {
        let signs = [mixing[0][i], mixing[1][i], mixing[2][i]];
        mixer.signs[i] = signs;
        mixer.wrench_from_rotor[i] = [1.0, arm * signs[0], arm * signs[1], yaw * signs[2]];
        mixer.rotor_from_wrench[i] =
            [0.25, signs[0] / (4.0 * arm), signs[1] / (4.0 * arm), signs[2] / (4.0 * yaw)];
    }
    mixer.refresh();
    let attitude_gains = |section: &Value| mellinger::AttitudeGains {
        kr: numbers(&section["kR"]),
        kw: numbers(&section["kw"]),
        ki: numbers(&section["ki_m"]),
        kd_omega: numbers(&section["kd_omega"]),
        integral_max: numbers(&section["int_err_max"]),
    };
    let state = &table["state2attitude"];
    mellinger::Params {
        mass_kg: number(&core["mass"]),
        mass_thrust: number(&core["mass_thrust"]),
        pwm_min: number(&core["pwm_min"]),
        pwm_max: number(&core["pwm_max"]),
        thrust_min_n: number(&core["thrust_min"]),
        thrust_max_n: number(&core["thrust_max"]),
        torque_pwm_max: numbers(&core["torque_pwm_max"]),
        thrust_curve: curve_rpm_to_rad_s(numbers(&core["rpm2thrust"])),
        state: mellinger::StateGains {
            kp: numbers(&state["kp"]),
            kd: numbers(&state["kd"]),
            ki: numbers(&state["ki"]),
            integral_max: numbers(&state["int_err_max"]),
        },
        attitude: attitude_gains(&table["attitude2force_torque"]),
        body_rate: attitude_gains(&table["body_rate2force_torque"]),
        mixer,
    }
}

/// The greatest relative difference between our numbers and the reference's.
///
/// A difference is taken relative to the reference number or to the median magnitude of the quantity over all samples,
/// whichever is larger: where large terms cancel, rounding scales with the terms and not with their sum.
pub struct Comparison {
    quantity: String,
    pairs: Vec<(f64, f64)>,
    samples: usize,
}

impl Comparison {
    /// No samples yet.
    pub fn new(quantity: impl Into<String>) -> Self {
        Self { quantity: quantity.into(), pairs: vec![], samples: 0 }
    }

    /// Adds one sample.
    pub fn add(&mut self, ours: &[f64], theirs: &[f64]) {
        assert_eq!(ours.len(), theirs.len(), "{}", self.quantity);
        self.pairs.extend(ours.iter().copied().zip(theirs.iter().copied()));
        self.samples += 1;
    }

    /// Adds one sample of angles (rad), which are equal when they differ by whole turns.
    pub fn add_angles(&mut self, ours: &[f64], theirs: &[f64]) {
        let turn = 2.0 * core::f64::consts::PI;
        let near: Vec<f64> =
            ours.iter().zip(theirs).map(|(o, t)| o - turn * ((o - t) / turn).round()).collect();
        self.add(&near, theirs);
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The greatest relative difference; infinite where ours is not finite.
    pub fn worst(&self) -> f64 {
        let mut sizes: Vec<f64> = self.pairs.iter().map(|p| p.1.abs()).filter(|s| *s > 0.0).collect();
        sizes.sort_by(f64::total_cmp);
        let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(1.0);
        self.pairs.iter().fold(0.0, |worst: f64, (ours, theirs)| {
            let error = (ours - theirs).abs() / theirs.abs().max(typical);
            if error.is_finite() { worst.max(error) } else { f64::INFINITY }
        })
    }

    /// Prints what was compared, and fails where the worst difference is above `bound`. Returns the worst difference.
    pub fn check(&self, bound: f64) -> f64 {
        let worst = self.worst();
        println!(
            "  {:<52} {:>5} samples, worst relative difference {worst:.1e}",
            self.quantity, self.samples
        );
        assert!(worst <= bound, "{}: worst relative difference {worst:e}, allowed {bound:e}", self.quantity);
        worst
    }
}
