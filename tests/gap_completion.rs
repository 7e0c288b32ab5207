//! What goes into a vehicle file: presets travel with their effect, partners are never parted, what has no influence stays out.

use propwash::gap::accept::Source;
use propwash::gap::complete::{Completion, calibration, group};
use propwash::gap::verdict::{Calibration, ParameterFit};
use propwash::physics::effects::Area;
use propwash::vehicle::Vehicle;

const QUAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");

fn fitted(kind: &str, area: Area, name: &str, filed: f64, value: f64, sigma: f64) -> Calibration {
    Calibration {
        id: kind.into(),
        kind: kind.into(),
        area,
        parameter: ParameterFit { name: name.into(), unit: "1".into(), filed, value, sigma },
        set: Vec::new(),
        tolerance: sigma,
        helps: true,
        partner: false,
    }
}

fn completion() -> (Completion, Vehicle) {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let source = Source { log_sha256: vec!["0".repeat(64)], date: "2025-01-31".into(), text: "a fit".into() };
    let text = std::fs::read_to_string(QUAD).unwrap();
    (Completion::new(&vehicle, text, "quad", "first_principles", source), vehicle)
}

#[test]
fn presets_of_a_calibrated_effect_travel_with_it() {
    let mut curve = fitted("thrust_curve", Area::Drive, "shape", 0.0, 0.05, 0.005);
    curve.set = vec![("hover_rad_s".into(), 2012.0)];
    let (mut completion, vehicle) = completion();
    assert_eq!(completion.calibrate(&[curve]).unwrap(), 1);
    let written = completion.vehicle(&vehicle).unwrap();
    assert!(completion.text.contains("hover_rad_s = 2012"), "{}", completion.text);
    assert!(written.file().effect.iter().any(|e| e.kind == "thrust_curve"));
}

#[test]
fn an_effect_is_calibrated_whole_or_not_at_all() {
    let offset = |axis: usize, value: f64| {
        fitted("com_offset", Area::Mass, &format!("offset_m.{axis}"), 0.0, value, 1e-4)
    };
    // One axis is clear, its correlated partner a fifth of a standard deviation off: both go, or neither.
    let whole = calibration(&[offset(0, 6e-4), offset(1, 2e-5), offset(2, 0.0)]);
    assert_eq!(whole.len(), 1);
    assert_eq!(whole[0].parameters.len(), 3, "{whole:?}");
    assert!(calibration(&[offset(0, 5e-5), offset(1, 2e-5), offset(2, -8e-5)]).is_empty(), "within chance");
    // All-zero drag is no effect.
    let zero = |k| fitted("quadratic_drag", Area::Airframe, &format!("drag_n_s2_per_m2.{k}"), 0.0, 0.0, 1e-3);
    assert!(calibration(&[zero(0), zero(1), zero(2)]).is_empty());
}

#[test]
fn a_value_that_physics_excludes_takes_its_partners_along() {
    let drag = |k: usize, value: f64| {
        fitted("quadratic_drag", Area::Airframe, &format!("drag_n_s2_per_m2.{k}"), 0.0, value, 1e-3)
    };
    let (mut completion, _) = completion();
    let before = completion.text.clone();
    assert_eq!(completion.calibrate(&[drag(0, 8e-3), drag(1, -5e-4), drag(2, 7e-3)]).unwrap(), 0);
    assert_eq!(completion.text, before);
    assert!(completion.remarks[0].contains("stays as filed"), "{:?}", completion.remarks);
}

#[test]
fn parameters_are_told_by_groups() {
    let of = |kind, area| group(kind, area).name();
    assert_eq!(of("weak_rotor", Area::Drive), "rotors unequal");
    assert_eq!(of("wrong_inertia", Area::Mass), "inertia");
    assert_eq!(of("com_offset", Area::Mass), "mass and centre of mass");
    assert_eq!(of("thrust_curve", Area::Drive), "thrust and torque curves");
    assert_eq!(of("linear_drag", Area::Airframe), "air");
    assert_eq!(of("gyro_bias", Area::Measurement), "sensor offsets");
    assert_eq!(of("clock_offset", Area::Measurement), "clocks");
    assert_eq!(of("command_delay", Area::Drive), "clocks");
}
