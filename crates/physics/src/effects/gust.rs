//! Wind that swings as a sine, the same everywhere: w = A sin(2π f t) + B cos(2π f t).
//!
//! One line of a gust spectrum; for the whole spectrum see [`super::turbulence`].

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, FromLog, Nature, along};
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the gust.
    pub struct Params {
        /// Velocity A of the air a quarter of a period after the reset, m/s, world.
        sine_m_s: [S; 3],
        /// Velocity B of the air at the reset, m/s, world.
        cosine_m_s: [S; 3],
        /// Frequency f, Hz.
        frequency_hz: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { sine_m_s: [0.0; 3], cosine_m_s: [0.0; 3], frequency_hz: 1.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { of_the_flight: true, only_when_found: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("frequency_hz", Bounds::from(0.0))] }
    }

    #[inline(always)]
    fn air(&self, view: &View<S>) -> [S; 3] {
        let turns = self.frequency_hz * view.surroundings.time_s;
        let (sin, cos) = (S::lit(core::f64::consts::TAU) * turns).sin_cos();
        vec3::add(vec3::scale(self.sine_m_s, sin), vec3::scale(self.cosine_m_s, cos))
    }
}

/// What a search for missing physics may free; see [`Candidate`]. The preset frequency is a beginning: who tries this
/// seeds it from the spectrum of what is missing.
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let mut freedoms = along("sine_m_s", 0..3, "m/s", (0.0, 1.0));
    freedoms.extend(along("cosine_m_s", 0..3, "m/s", (0.0, 1.0)));
    freedoms.push(Freedom::any("frequency_hz", "Hz", 0.0, 0.05));
    vec![
        Candidate::new(
            "gust",
            "wind that swings to and fro",
            Area::Airframe,
            freedoms,
            "hover for many seconds, then fly level legs, in the same wind",
        )
        .preset("frequency_hz", 0.5)
        .given_by("frequency_hz", FromLog::LoudestFrequency),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command, linear_drag};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn the_air_swings_with_time_and_pushes_through_the_drag() {
        let drag = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]];
        let effect = Params { sine_m_s: [4.0, -2.0, 0.0], cosine_m_s: [1.0, 0.0, 3.0], frequency_hz: 2.0 };
        let drone = quad(vec![
            AnyEffect::Gust(effect),
            AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m: drag }),
        ]);
        // At the start, a quarter, an eighth and half of a period later.
        let half = 0.5f64.sqrt();
        for (time_s, sine, cosine) in
            [(0.0, 0.0, 1.0), (0.125, 1.0, 0.0), (0.0625, half, half), (0.25, 0.0, -1.0)]
        {
            let around = Surroundings { time_s, wind_m_s: [1.0, 0.0, 0.0], ..Surroundings::calm() };
            let acc = drone.rate(&State::rest(), &Command::Rotors([0.0; 8]), &around).acc;
            let air = [1.0 + 4.0 * sine + cosine, -2.0 * sine, 3.0 * cosine];
            for (got, air) in [acc[0], acc[1], acc[2] + 9.81].iter().zip(air) {
                assert!((got - 0.5 * air).abs() < 1e-12, "{acc:?} at {time_s}");
            }
        }
    }
}
