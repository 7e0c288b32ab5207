//! Wind that swings as a sine, the same everywhere: w = A sin(2π f t + φ).
//!
//! One line of a gust spectrum. Coloured noise (Dryden: MIL-F-8785C, 1980, § 3.7) is not here: it needs random numbers,
//! and equations have none.

use super::{Effect, View};
use crate::math::vec3;
use crate::physics::params::parameters;
use crate::scalar::Real;

parameters! {
    /// Parameters of the gust.
    pub struct Params {
        /// Amplitude A of the velocity of the air, m/s, world.
        amplitude_m_s: [S; 3],
        /// Frequency f, Hz.
        frequency_hz: S,
        /// Phase φ at the reset, rad.
        phase_rad: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { amplitude_m_s: [0.0; 3], frequency_hz: 1.0, phase_rad: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    #[inline(always)]
    fn air(&self, view: &View<S>) -> [S; 3] {
        let turns = self.frequency_hz * view.surroundings.time_s;
        let (sin, _) = (S::lit(core::f64::consts::TAU) * turns + self.phase_rad).sin_cos();
        vec3::scale(self.amplitude_m_s, sin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::effects::{AnyEffect, Command, linear_drag};
    use crate::physics::rigid_body::State;
    use crate::physics::sample::quad;
    use crate::physics::surroundings::Surroundings;

    #[test]
    fn the_air_swings_with_time_and_pushes_through_the_drag() {
        let drag = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]];
        let effect = Params {
            amplitude_m_s: [4.0, -2.0, 0.0],
            frequency_hz: 2.0,
            phase_rad: core::f64::consts::FRAC_PI_6,
        };
        let drone = quad(vec![
            AnyEffect::Gust(effect),
            AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m: drag }),
        ]);
        // sin 30°, a quarter of a period later sin 120°, half a period after the start sin 210°.
        for (time_s, sine) in [(0.0, 0.5), (0.125, 0.75f64.sqrt()), (0.25, -0.5)] {
            let around = Surroundings { time_s, wind_m_s: [1.0, 0.0, 0.0], ..Surroundings::calm() };
            let acc = drone.rate(&State::rest(), &Command::Rotors([0.0; 8]), &around).acc;
            assert!((acc[0] - 0.5 * (1.0 + 4.0 * sine)).abs() < 1e-12, "{acc:?} at {time_s}");
            assert!((acc[1] + 0.5 * 2.0 * sine).abs() < 1e-12, "{acc:?} at {time_s}");
        }
    }
}
