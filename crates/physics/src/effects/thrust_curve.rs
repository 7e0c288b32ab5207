//! A thrust curve of another shape through the same hover: T = T_filed(Ω) + k T_h (x − x²) with x = Ω / Ω_h and
//! T_h = T_filed(Ω_h).
//!
//! A collective thrust that was measured by the filed curves bends alike: x = √(T / T_h).
//!
//! Positive k: less steep than filed, more thrust below the speed Ω_h and less above. Source: linear and quadratic term of
//! measured thrust curves, e.g. Förster, "System identification of the Crazyflie 2.0 nano quadrocopter", ETH Zürich 2015.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Answer, Area, Bounds, Candidate, Freedom, Scale};
use crate::params::parameters;
use crate::rotor;
use propwash_trace::Real;

parameters! {
    /// Parameters of the curve.
    pub struct Params {
        /// Share k of the hover thrust by which the term in Ω grows and that in Ω² shrinks.
        shape: S,
        /// Rotor speed Ω_h at which thrust stays as filed, rad/s.
        hover_rad_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { shape: 0.0, hover_rad_s: 1000.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("shape", Bounds::within(-1.0, 0.9)), ("hover_rad_s", Bounds::above(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        let mut hover_n = S::zero();
        for i in 0..parts.airframe.n_rotors {
            let curve = &mut parts.airframe.rotors[i].thrust_curve;
            let at_hover = rotor::curve(*curve, self.hover_rad_s);
            hover_n = hover_n + at_hover;
            let slope = self.shape * at_hover / self.hover_rad_s;
            curve[1] = curve[1] + slope;
            curve[2] = curve[2] - slope / self.hover_rad_s;
        }
        // By the filed curves, whatever else scales them.
        parts.thrust_bend = [self.shape, hover_n / parts.thrust_factor];
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "thrust_curve",
            "thrust that rises more or less steeply with rotor speed than filed",
            Area::Drive,
            vec![Freedom::any("shape", "1", 0.02, 0.25)],
            "climb and sink hard, from little to full thrust",
        )
        .preset("hover_rad_s", Scale::of(drone).hover_rad_s)
        .answering(Answer::Thrust),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe;
    use crate::drone::Measured;
    use crate::effects::{AnyEffect, Command, thrust_scale};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn thrust_stays_at_hover_and_bends_around_it() {
        let hover_rad_s = quad(vec![]).hover_rotor_vel()[0];
        let drone = quad(vec![AnyEffect::ThrustCurve(Params { shape: 0.2, hover_rad_s })]);
        // At x times the hover speed: x² + 0.2 (x − x²) of the weight.
        for (x, share) in [(1.0, 1.0), (0.5, 0.3), (1.5, 2.1)] {
            let mut state = State::rest();
            state.rotor_vel[..4].fill(x * hover_rad_s);
            let rate = drone.rate(&state, &Command::Rotors(state.rotor_vel), &Surroundings::calm());
            assert!((rate.acc[2] + 9.81 - share * 9.81).abs() < 1e-9, "{:?} at {x}", rate.acc);
        }
        assert!((drone.hover_rotor_vel()[0] - hover_rad_s).abs() < 1e-9);
    }

    #[test]
    fn a_collective_thrust_bends_as_the_rotors_do() {
        let hover_rad_s = quad(vec![]).hover_rotor_vel()[0];
        let scale = AnyEffect::ThrustScale(thrust_scale::Params { factor: 0.9 });
        let curve = AnyEffect::ThrustCurve(Params { shape: 0.2, hover_rad_s });
        for effects in [[curve, scale], [scale, curve]] {
            let drone = quad(effects.to_vec());
            for x in [0.5, 1.0, 1.5] {
                let mut state = State::rest();
                state.rotor_vel[..4].fill(x * hover_rad_s);
                let calm = Surroundings::calm();
                let by_rotors = drone.rate(&state, &Command::Rotors(state.rotor_vel), &calm).acc[2] + 9.81;
                let filed: f64 = airframe::loads(&drone.airframe, &state.rotor_vel).thrust.iter().sum();
                let rate = drone.rate_measured(&State::rest(), &Measured::Thrust(filed), &calm);
                let by_thrust = rate.acc[2] + 9.81;
                assert!((by_rotors - by_thrust).abs() < 1e-9 * by_rotors, "{by_rotors} {by_thrust} at {x}");
            }
        }
    }
}
