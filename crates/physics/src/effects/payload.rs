//! A point mass fixed to the vehicle: more mass, the centre of mass moved towards it, more inertia.
//!
//! Source: theorem of parallel axes, e.g. Goldstein, Poole & Safko, "Classical mechanics", § 5.3: with the reduced mass
//! μ = m m_p / (m + m_p), J' = J + μ (|r|² 1 − r rᵀ) about the common centre of mass at m_p r / (m + m_p).

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Scale, along};
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the payload.
    pub struct Params {
        /// Mass of the payload, kg.
        mass_kg: S,
        /// Its place r from the centre of mass of the vehicle without it, m, body.
        position_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { mass_kg: 0.0, position_m: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("mass_kg", Bounds::from(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        let r = self.position_m;
        let total = parts.body.mass_kg + self.mass_kg;
        let share = self.mass_kg / total;
        let reduced = parts.body.mass_kg * share;
        let r2 = vec3::dot(r, r);
        for i in 0..3 {
            let row = &mut parts.body.inertia_kg_m2[i];
            row[i] = row[i] + reduced * r2;
            for j in 0..3 {
                row[j] = row[j] - reduced * r[i] * r[j];
            }
        }
        parts.body.mass_kg = total;
        parts.body.refresh();
        parts.shift_com(vec3::scale(r, share));
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // A place below the middle, so that the derivative by mass knows the lever; without mass the place has no influence.
    let scale = Scale::of(drone);
    let reach = 0.03 * scale.size.max(0.67);
    let mut freedoms = vec![Freedom::up("mass_kg", "kg", 0.0, 0.15 * scale.mass_kg)];
    freedoms.extend(along("position_m", 0..3, "m", (0.0, reach)));
    vec![
        Candidate::new(
            "payload",
            "mass fixed to the vehicle",
            Area::Mass,
            freedoms,
            "climb and sink hard, roll, pitch and yaw quickly, and drop for a moment with little thrust",
        )
        .preset("position_m.2", -reach),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    /// Payload of 0.25 kg on the sample vehicle of 1 kg, 0.2 m ahead: the centre of mass moves 0.04 m ahead.
    const AHEAD: Params<f64> = Params { mass_kg: 0.25, position_m: [0.2, 0.0, 0.0] };

    #[test]
    fn mass_inertia_and_lever_arms_are_those_of_the_two_bodies_together() {
        let parts = quad(vec![AnyEffect::Payload(AHEAD)]).parts();
        assert!((parts.body.mass_kg - 1.25).abs() < 1e-15);
        // Both masses at their distances from the common centre: 1 kg at 0.04 m, 0.25 kg at 0.16 m.
        let steiner = 1.0 * 0.04f64.powi(2) + 0.25 * 0.16f64.powi(2);
        for (axis, own) in [(0, 0.01), (1, 0.01 + steiner), (2, 0.018 + steiner)] {
            assert!((parts.body.inertia_kg_m2[axis][axis] - own).abs() < 1e-15);
            assert!((parts.body.inertia_inverse[axis][axis] * own - 1.0).abs() < 1e-12);
        }
        assert!((parts.airframe.rotors[0].position_m[0] - 0.06).abs() < 1e-15);
        assert!((parts.airframe.rotors[1].position_m[0] + 0.14).abs() < 1e-15);
        // Off the axes, products of inertia appear: −μ x z.
        let aslant = Params { mass_kg: 0.25, position_m: [0.2, 0.0, -0.1] };
        let inertia = quad(vec![AnyEffect::Payload(aslant)]).parts().body.inertia_kg_m2;
        assert!((inertia[0][2] - 0.2 * 0.2 * 0.1).abs() < 1e-15 && inertia[0][2] == inertia[2][0]);
    }

    #[test]
    fn a_payload_ahead_pulls_the_nose_down_and_the_hover_speed_up() {
        let drone = quad(vec![AnyEffect::Payload(AHEAD)]);
        let speeds = drone.hover_rotor_vel();
        assert!((speeds[0] - (1.25f64 * 9.81 / 4.0 / 1e-5).sqrt()).abs() < 1e-9);
        let state = State { rotor_vel: speeds, ..State::rest() };
        let rate = drone.rate(&state, &Command::Rotors(speeds), &Surroundings::calm());
        assert!(vec3::norm(rate.acc) < 1e-12);
        // Thrust 1.25 g acts 0.04 m behind the centre of mass.
        let expected = 1.25 * 9.81 * 0.04 / (0.01 + 0.0016 + 0.25 * 0.0256);
        assert!((rate.ang_acc[1] - expected).abs() < 1e-9, "{:?}", rate.ang_acc);
        assert_eq!(drone.body.mass_kg, 1.0, "the vehicle itself stays as filed");
    }
}
