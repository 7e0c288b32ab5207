//! Which rotor of a vehicle each motor of a flight stack is.
//!
//! PX4 and ArduPilot number the motors of a quadcopter in X alike: front right, rear left, front left, rear right, the first two turning
//! counter-clockwise seen from above (PX4 airframe reference, "Quadrotor x"; `AP_MotorsMatrix.cpp`, `MOTOR_FRAME_TYPE_X`). Betaflight has
//! rear right, front right, rear left, front left on its outputs, and its SITL puts them into the packet in the order of the other two
//! (`src/platform/SIMULATOR/sitl.c`, `pwmCompleteMotorUpdate`). Hexacopters in X: right, left, front left, rear right, front right, rear
//! left, the second, fourth and fifth counter-clockwise (the same two references).

use crate::{ProtocolError, Stack};

/// A rotor, as far as the order of motors goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotor {
    /// Position in the body, m (forward, left, up).
    pub position_m: [f64; 3],
    /// Whether it turns counter-clockwise, seen from above.
    pub counter_clockwise: bool,
}

/// One motor of an order: azimuth from the nose to the right, degrees, and whether it turns counter-clockwise.
type Place = (&'static str, f64, bool);

const QUAD_X: [Place; 4] = [
    ("front right", 45.0, true),
    ("rear left", -135.0, true),
    ("front left", -45.0, false),
    ("rear right", 135.0, false),
];

const HEXA_X: [Place; 6] = [
    ("right", 90.0, false),
    ("left", -90.0, true),
    ("front left", -30.0, false),
    ("rear right", 150.0, true),
    ("front right", 30.0, true),
    ("rear left", -150.0, false),
];

/// How far a rotor may stand from its place, degrees: frames are stretched and squashed.
const MOST_OFF_DEG: f64 = 22.0;

/// For each motor of the stack the rotor of the vehicle that it drives, by where rotors stand and how they turn.
///
/// # Errors
/// [`ProtocolError::Motors`] for a vehicle whose rotors are in no order that the stack knows, saying which one is in the way.
pub fn order(stack: Stack, rotors: &[Rotor]) -> Result<Vec<usize>, ProtocolError> {
    let places: &[Place] = match rotors.len() {
        4 => &QUAD_X,
        6 if stack != Stack::Betaflight => &HEXA_X,
        n => {
            let known = match stack {
                Stack::Betaflight => "the packets of Betaflight's SITL hold the 4 motors of a quadcopter",
                _ => "quadcopters in X (4 rotors) and hexacopters in X (6) have an order of their own",
            };
            return Err(ProtocolError::Motors { what: format!("the vehicle has {n} rotors; {known}") });
        }
    };
    let azimuth = |r: &Rotor| (-r.position_m[1]).atan2(r.position_m[0]).to_degrees();
    let off = |a: f64, b: f64| ((a - b + 540.0).rem_euclid(360.0) - 180.0).abs();
    let mut out = Vec::with_capacity(places.len());
    for (motor, (name, at, counter_clockwise)) in places.iter().enumerate() {
        let near = |i: &usize| {
            let r = &rotors[*i];
            r.position_m[0].hypot(r.position_m[1]) > 0.0 && off(azimuth(r), *at) <= MOST_OFF_DEG
        };
        let found: Vec<usize> = (0..rotors.len()).filter(near).collect();
        let [rotor] = found[..] else {
            let stand = rotors.iter().map(|r| format!("{:.0}°", azimuth(r))).collect::<Vec<_>>().join(", ");
            let n = if found.is_empty() { "no rotor stands" } else { "several rotors stand" };
            let what = format!(
                "motor {} of {} is {name}, {at:.0}° from the nose to the right, and {n} there; those of the vehicle stand at {stand}",
                motor + 1,
                stack.title()
            );
            return Err(ProtocolError::Motors { what });
        };
        if rotors[rotor].counter_clockwise != *counter_clockwise {
            let way = |ccw| if ccw { "counter-clockwise" } else { "clockwise" };
            let what = format!(
                "motor {} of {} ({name}) turns {}, and rotor {rotor} of the vehicle, which stands there, turns {}",
                motor + 1,
                stack.title(),
                way(*counter_clockwise),
                way(!counter_clockwise)
            );
            return Err(ProtocolError::Motors { what });
        }
        out.push(rotor);
    }
    Ok(out)
}

/// Checks an order that a user gives: for each motor of the stack, from the first one, the rotor that it drives. Every rotor must have
/// one motor.
///
/// # Errors
/// [`ProtocolError::Motors`].
pub fn check(stack: Stack, order: &[usize], n_rotors: usize) -> Result<(), ProtocolError> {
    let most = most(stack);
    let mut sorted = order.to_vec();
    sorted.sort_unstable();
    if n_rotors > most {
        let what = format!(
            "{} commands at most {most} motors, and the vehicle has {n_rotors} rotors",
            stack.title()
        );
        return Err(ProtocolError::Motors { what });
    }
    if sorted.into_iter().eq(0..n_rotors) {
        return Ok(());
    }
    let got = order.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let what = format!("expected each of the rotors 0 to {} once, got {got}", n_rotors.saturating_sub(1));
    Err(ProtocolError::Motors { what })
}

/// Most motors that a stack commands.
pub fn most(stack: Stack) -> usize {
    match stack {
        Stack::Px4 => crate::px4::N_CONTROLS,
        Stack::ArduPilot => 32,
        Stack::Betaflight => crate::betaflight::N_MOTORS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(places: &[(f64, bool)]) -> Vec<Rotor> {
        let rotor = |(deg, counter_clockwise): &(f64, bool)| {
            let a = deg.to_radians();
            Rotor { position_m: [a.cos(), -a.sin(), 0.0], counter_clockwise: *counter_clockwise }
        };
        places.iter().map(rotor).collect()
    }

    #[test]
    fn rotors_are_found_where_they_stand() {
        // The order of Crazyflies and of the X500 here: front right, rear right, rear left, front left.
        let quad = ring(&[(45.0, true), (135.0, false), (-135.0, true), (-45.0, false)]);
        for stack in Stack::ALL {
            assert_eq!(order(stack, &quad), Ok(vec![0, 2, 3, 1]));
        }
        let stretched = ring(&[(30.0, true), (150.0, false), (-150.0, true), (-30.0, false)]);
        assert_eq!(order(Stack::Px4, &stretched), Ok(vec![0, 2, 3, 1]));
        let hexa = ring(&[
            (30.0, true),
            (90.0, false),
            (150.0, true),
            (-150.0, false),
            (-90.0, true),
            (-30.0, false),
        ]);
        assert_eq!(order(Stack::ArduPilot, &hexa), Ok(vec![1, 4, 5, 2, 0, 3]));
    }

    #[test]
    fn what_does_not_fit_is_said() {
        let words = |rotors: &[Rotor]| order(Stack::Px4, rotors).unwrap_err().to_string();
        let plus = ring(&[(0.0, true), (90.0, false), (180.0, true), (-90.0, false)]);
        assert!(words(&plus).contains("front right") && words(&plus).contains("0°, 90°"), "{}", words(&plus));
        let reversed = ring(&[(45.0, false), (135.0, true), (-135.0, false), (-45.0, true)]);
        assert!(words(&reversed).contains("rotor 0") && words(&reversed).contains("turns clockwise"));
        assert!(words(&plus[..3]).contains("3 rotors"));
        let hexa = vec![plus[0]; 6];
        assert!(order(Stack::Betaflight, &hexa).unwrap_err().to_string().contains("4 motors"));
        assert!(order(Stack::Px4, &[Rotor { position_m: [0.0; 3], counter_clockwise: true }; 4]).is_err());
    }

    #[test]
    fn an_order_of_ones_own_names_every_rotor_once() {
        assert_eq!(check(Stack::Px4, &[2, 0, 1, 3], 4), Ok(()));
        for bad in [&[0, 1, 2][..], &[0, 1, 2, 2], &[1, 2, 3, 4], &[0, 1, 2, 3, 4]] {
            assert!(check(Stack::Px4, bad, 4).unwrap_err().to_string().contains("0 to 3 once"));
        }
        assert!(
            check(Stack::Betaflight, &[0, 1, 2, 3, 4, 5], 6).unwrap_err().to_string().contains("at most 4")
        );
    }
}
