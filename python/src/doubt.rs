//! Commands that no vehicle can follow: most often numbers in another unit. They are flown as they are; the first of them is told of.

use std::f64::consts::PI;

use propwash::physics::controllers::{ControlMode, mellinger};
use propwash::physics::drone::Drone;
use propwash::physics::rigid_body::MAX_ROTORS;

/// More than gyroscopes of drones measure, rad/s (2,000 °/s).
const MOST_RATE_RAD_S: f64 = 35.0;
/// Headings may go on counting: two turns either way.
const MOST_YAW_RAD: f64 = 4.0 * PI;
/// What rounding of the caller's numbers may add to a limit.
const ROUNDING: f64 = 1.0 + 1e-6;

/// Greatest sensible size of each number of one drone's command; infinite where there is none, and empty where no number has one.
pub fn limits(mode: ControlMode, drone: &Drone<f64>, n_rotors: usize) -> Vec<f64> {
    let p = &drone.controller;
    let thrust = mellinger::limit_thrust(p, f64::MAX) * ROUNDING;
    match mode {
        ControlMode::State => Vec::new(),
        ControlMode::Attitude => vec![PI, PI, MOST_YAW_RAD, thrust],
        ControlMode::BodyRate => vec![MOST_RATE_RAD_S, MOST_RATE_RAD_S, MOST_RATE_RAD_S, thrust],
        ControlMode::ForceTorque => vec![thrust, f64::INFINITY, f64::INFINITY, f64::INFINITY],
        ControlMode::RotorVel => {
            let mut high = [f64::MAX; MAX_ROTORS];
            mellinger::limit_rotor_vel(p, &mut high);
            let own = drone.airframe.n_rotors;
            (0..n_rotors).map(|i| if i < own { high[i] * ROUNDING } else { f64::INFINITY }).collect()
        }
    }
}

/// Whether any number is beyond the limits of its drone, (n_drones * width); no limits, none is. It is asked of every command: numbers are
/// compared without branches, four at a time where they come in fours.
pub fn any_beyond(commands: &[f64], limits: &[f64]) -> bool {
    let beyond = |v: &f64, most: &f64| v.abs() > *most;
    if let Ok(most) = <&[f64; 4]>::try_from(limits) {
        let rows = commands.as_chunks::<4>().0;
        return rows.iter().fold(false, |any, row| {
            any | beyond(&row[0], &most[0])
                | beyond(&row[1], &most[1])
                | beyond(&row[2], &most[2])
                | beyond(&row[3], &most[3])
        });
    }
    let row_beyond = |row: &[f64]| row.iter().zip(limits).fold(false, |any, (v, most)| any | beyond(v, most));
    !limits.is_empty() && commands.chunks_exact(limits.len()).fold(false, |any, row| any | row_beyond(row))
}

/// Limits that hold all of these numbers.
pub fn widen(limits: &mut [f64], commands: &[f64]) {
    for row in commands.chunks_exact(limits.len().max(1)) {
        limits.iter_mut().zip(row).for_each(|(most, v)| *most = most.max(v.abs()));
    }
}

/// What is to be said of the first number beyond the limits of its drone: world, drone, entry, number and limit.
pub fn first_beyond(
    commands: &[f64],
    n_drones: usize,
    width: usize,
    limits: impl Fn(usize, usize) -> Vec<f64>,
) -> Option<(usize, usize, usize, f64, f64)> {
    commands.chunks_exact(width.max(1)).enumerate().find_map(|(row, numbers)| {
        let (world, drone) = (row / n_drones, row % n_drones);
        let limits = limits(world, drone);
        let entry = numbers.iter().zip(&limits).position(|(v, most)| v.abs() > *most)?;
        Some((world, drone, entry, numbers[entry], limits[entry]))
    })
}

/// In words.
pub fn words(
    mode: ControlMode,
    (world, drone, entry, got, most): (usize, usize, usize, f64, f64),
    of: &Drone<f64>,
    vehicle: &str,
) -> String {
    let (what, unit, limit, likely) = match (mode, entry) {
        (ControlMode::Attitude, 0..=2) => {
            let most = if entry < 2 { "half a turn (π)" } else { "two turns" };
            (
                ["roll", "pitch", "yaw"][entry],
                "rad",
                format!("{most} is the most"),
                "degrees? Angles are in rad",
            )
        }
        (ControlMode::BodyRate, 0..=2) => {
            let limit = format!("gyroscopes measure {} rad/s at most", short(most));
            let hint = "degrees per second? Rates are in rad/s";
            (["rate about x", "rate about y", "rate about z"][entry], "rad/s", limit, hint)
        }
        (ControlMode::RotorVel, _) => {
            let limit = format!("the greatest of {vehicle} is {} rad/s", short(most / ROUNDING));
            ("rotor speed", "rad/s", limit, "rpm? Speeds are in rad/s (1 rpm = 0.10472 rad/s)")
        }
        _ => {
            let (n, most) = (of.airframe.n_rotors, short(most / ROUNDING));
            let limit = format!("the {n} rotors of {vehicle} give {most} N together");
            ("thrust", "N", limit, "grams, PWM or a fraction? Thrust is in N, of all rotors together")
        }
    };
    format!(
        "{}_control: {what} (entry {entry}) of {} {unit} for world {world}, drone {drone}, where {limit}: {likely}. Commands are \
         flown as they are; this is said once for each Sim",
        mode.name(),
        short(got)
    )
}

/// A number in few digits.
fn short(v: f64) -> String {
    let text = match v.abs() {
        size if size >= 1e6 => return format!("{v:.3e}"),
        size if size < 1.0 => format!("{v:.4}"),
        _ => format!("{v:.2}"),
    };
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// The first drone whose state command has an attitude of no length: world, drone, quaternion.
pub fn without_attitude(commands: &[f64], n_drones: usize) -> Option<(usize, usize, [f64; 4])> {
    let rows = commands.as_chunks::<16>().0;
    // Most attitudes have a real part, and nothing else of them is read then.
    let small = |v: f64| v.abs() < 1e-6;
    let row = rows.iter().position(|c| small(c[12]) && small(c[9]) && small(c[10]) && small(c[11]))?;
    let c = rows[row];
    Some((row / n_drones, row % n_drones, [c[9], c[10], c[11], c[12]]))
}
