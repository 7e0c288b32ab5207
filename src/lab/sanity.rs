//! Two questions that show a wrong unit or frame at once: does the accelerometer feel gravity upwards, and does the thrust carry the vehicle?

use serde::Serialize;

use crate::flight::{Channel, FlightLog, STANDARD_GRAVITY_M_S2, resample};
use crate::math::{quat, vec3};
use crate::physics::rotor;
use crate::vehicle::Vehicle;

/// A hole in the attitude that is bridged, s.
const MAX_GAP_S: f64 = 0.1;
/// Largest tilt of the mean specific force from the vertical that is well, degrees; flights are not quite symmetric.
const MOST_TILT_DEG: f64 = 8.0;
/// How much a ratio may be off 1.
const MOST_OFF: f64 = 0.15;

/// One answer.
#[derive(Clone, Debug, Serialize)]
pub struct Sane {
    /// What was asked.
    pub title: &'static str,
    /// The answer in words, with its number.
    pub words: String,
    /// Whether it is as it should be; null where it cannot be told.
    pub fine: Option<bool>,
}

/// The answers for a log, and for a vehicle where one is chosen.
pub fn look(log: &FlightLog, vehicle: Option<&Vehicle>) -> Vec<Sane> {
    vec![gravity(log), thrust(log, vehicle)]
}

fn unknown(title: &'static str, words: &str) -> Sane {
    Sane { title, words: words.into(), fine: None }
}

/// The mean specific force, turned into the world, is gravity upwards.
fn gravity(log: &FlightLog) -> Sane {
    const TITLE: &str = "gravity";
    let felt = &log.specific_force_m_s2;
    if felt.is_empty() || log.attitude.is_empty() {
        return unknown(TITLE, "not known: it takes an accelerometer and attitudes");
    }
    let attitudes = resample::slerp(&log.attitude, &felt.t_s, MAX_GAP_S);
    let turned = attitudes.iter().zip(&felt.values).filter_map(|(q, a)| Some(quat::rotate((*q)?, *a)));
    let (sum, n) = turned.fold(([0.0; 3], 0), |(sum, n), a| (vec3::add(sum, a), n + 1));
    if n == 0 {
        return unknown(TITLE, "not known: accelerometer and attitudes have no time in common");
    }
    let mean = vec3::scale(sum, 1.0 / f64::from(n));
    let size = vec3::norm(mean);
    let tilt = (mean[2] / size).clamp(-1.0, 1.0).acos().to_degrees();
    let ratio = size / STANDARD_GRAVITY_M_S2;
    let fine = tilt < MOST_TILT_DEG && (ratio - 1.0).abs() < MOST_OFF;
    let way = if tilt < MOST_TILT_DEG { "up".into() } else { format!("{tilt:.0}° from up") };
    Sane { title: TITLE, words: format!("{size:.2} m/s², {way}"), fine: Some(fine) }
}

/// The mean thrust carries the weight.
fn thrust(log: &FlightLog, vehicle: Option<&Vehicle>) -> Sane {
    const TITLE: &str = "thrust / weight";
    let Some(vehicle) = vehicle else { return unknown(TITLE, "not known before a vehicle is chosen") };
    let Ok(drone) = vehicle.drone("first_principles") else {
        return unknown(TITLE, "not known: the vehicle file has no rotors");
    };
    let (weight, rotors) = (drone.hover_thrust(), &drone.airframe.rotors[..drone.airframe.n_rotors]);
    let mean = |c: &Channel<1>| c.values.iter().map(|v| v[0]).sum::<f64>() / c.len() as f64;
    let direct = [&log.thrust_n, &log.cmd_thrust_n].into_iter().find(|c| !c.is_empty()).map(mean);
    let turning = |list: &[Channel<1>]| -> Option<f64> {
        if list.len() != rotors.len() || list.iter().any(Channel::is_empty) {
            return None;
        }
        let of = |(c, r): (&Channel<1>, &rotor::Params<f64>)| {
            c.values.iter().map(|v| rotor::curve(r.thrust_curve, v[0])).sum::<f64>() / c.len() as f64
        };
        Some(list.iter().zip(rotors).map(of).sum())
    };
    let lists = [&log.rotor_speed_rad_s, &log.cmd_rotor_rad_s];
    let given = lists.iter().map(|l| l.len()).find(|n| *n > 0 && *n != rotors.len());
    let Some(thrust) = lists.into_iter().find_map(|l| turning(l)).or(direct) else {
        let words = given
            .map_or("not known: the log has neither rotor speeds nor a thrust".to_string(), |n| {
                format!("not known: the log has {n} rotors, the vehicle {}", rotors.len())
            });
        return Sane { title: TITLE, words, fine: given.map(|_| false) };
    };
    let ratio = thrust / weight;
    Sane { title: TITLE, words: format!("{ratio:.2}"), fine: Some((ratio - 1.0).abs() < MOST_OFF) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Format;

    fn hovering(vehicle: &Vehicle) -> FlightLog {
        let mut log = FlightLog::empty("hover.csv".as_ref(), String::new(), Format::Csv);
        let speeds = vehicle.drone("first_principles").unwrap().hover_rotor_vel();
        log.cmd_rotor_rad_s = vec![Channel::default(); 4];
        // Leaning by 0.3 rad about x: the accelerometer feels gravity partly along y.
        let q = quat::exp([0.3, 0.0, 0.0]);
        for k in 0..100 {
            let t = 0.01 * f64::from(k);
            log.attitude.push(t, q);
            log.specific_force_m_s2.push(t, quat::rotate_inverse(q, [0.0, 0.0, STANDARD_GRAVITY_M_S2]));
            for (c, speed) in log.cmd_rotor_rad_s.iter_mut().zip(speeds) {
                c.push(t, [speed]);
            }
        }
        log
    }

    #[test]
    fn a_hover_is_sane_and_wrong_units_and_frames_are_not() {
        let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
        let fine =
            |log: &FlightLog| look(log, Some(&vehicle)).into_iter().map(|s| s.fine).collect::<Vec<_>>();
        let right = hovering(&vehicle);
        assert_eq!(fine(&right), [Some(true), Some(true)], "{:?}", look(&right, Some(&vehicle)));
        let mut in_g = right.clone();
        in_g.specific_force_m_s2 =
            in_g.specific_force_m_s2.map(|v| vec3::scale(v, 1.0 / STANDARD_GRAVITY_M_S2));
        let mut upside_down = right.clone();
        upside_down.specific_force_m_s2 = upside_down.specific_force_m_s2.map(|v| vec3::scale(v, -1.0));
        let mut in_rpm = right.clone();
        in_rpm.cmd_rotor_rad_s.iter_mut().for_each(|c| *c = c.map(|v| [v[0] * 9.549]));
        assert_eq!(fine(&in_g), [Some(false), Some(true)]);
        assert_eq!(fine(&upside_down), [Some(false), Some(true)]);
        assert_eq!(fine(&in_rpm), [Some(true), Some(false)]);
        assert_eq!(look(&right, None)[1].fine, None);
    }
}
