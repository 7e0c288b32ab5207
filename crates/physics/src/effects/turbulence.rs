//! Wind that changes at random: one Dryden filter per axis of the world.
//!
//! Each component is Gaussian with standard deviation σ and the spectrum of Dryden's longitudinal gust,
//! Φ(Ω) = σ² (2 L / π) / (1 + (L Ω)²) over the spatial frequency Ω, that is, its correlation over a distance r is
//! σ² e^(−r/L). The frozen field passes the vehicle at its speed through the mean wind, V, so that in time it is σ² e^(−V t/L).
//! Source: MIL-F-8785C, "Flying qualities of piloted airplanes", 1980, § 3.7.2.2 (Dryden form). Simpler than there: the
//! longitudinal filter serves all axes, the axes are those of the world, σ and L are given and do not follow from height, and
//! there are no angular gusts.
//!
//! A vehicle that stands still in still air would see a frozen field for ever. Eddies carry one another past a fixed point
//! at about their own r.m.s. speed (Tennekes, "Eulerian and Lagrangian time microscales in isotropic turbulence", J. Fluid Mech. 67,
//! 1975), so V² = |v − w|² + |σ|².
//!
//! The memory holds the filters' states with variance one, advanced exactly over a step: u ← a u + √(1 − a²) ξ with
//! a = e^(−V dt/L) and a standard normal ξ of the caller.

use super::{Command, Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Bounds, Candidate, Nature};
use crate::params::parameters;
use crate::surroundings::{Reads, Surroundings};
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the turbulence.
    pub struct Params {
        /// Standard deviation σ of the velocity of the air, m/s, world.
        sigma_m_s: [S; 3],
        /// Length L over which gusts are alike, m.
        length_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { sigma_m_s: [0.0; 3], length_m: [5.0; 3] }
    }
}

/// Squared speed below which gusts count as passing at this speed, m²/s²: far below any wind, so that slopes stay finite.
const MIN_SPEED2_M2_S2: f64 = 1e-12;

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { of_the_flight: true, only_when_found: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("sigma_m_s", Bounds::from(0.0)), ("length_m", Bounds::above(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads { wind: true, noise: true, ..Reads::NOTHING }
    }

    /// Three states, and whether they have begun.
    fn memory_len(&self, _: f64) -> usize {
        4
    }

    fn command(&self, view: &View<S>, dt_s: S, _: &mut Command<S>, memory: &mut [S]) {
        let (zero, one) = (S::zero(), S::one());
        let through = vec3::sub(view.state.vel, view.surroundings.wind_m_s);
        let own = vec3::dot(self.sigma_m_s, self.sigma_m_s);
        let speed = (vec3::dot(through, through) + own + S::lit(MIN_SPEED2_M2_S2)).sqrt();
        let begun = zero.lt(memory[3]);
        for i in 0..3 {
            // The first step draws from the stationary distribution.
            let keep = S::select(begun, (-speed * dt_s / self.length_m[i]).exp(), zero);
            let fresh = (one - keep * keep).sqrt();
            memory[i] = keep * memory[i] + fresh * view.surroundings.normals[i];
        }
        memory[3] = one;
    }

    fn surround(&self, memory: &[S], surroundings: &mut Surroundings<S>) {
        for i in 0..3 {
            surroundings.wind_m_s[i] = surroundings.wind_m_s[i] + self.sigma_m_s[i] * memory[i];
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`]. None: gusts at random are what remains after all else, known
/// by its spectrum and not by a fit of forces.
pub fn candidates(_drone: &Drone<f64>) -> Vec<Candidate> {
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, constant_wind};
    use crate::rigid_body::{MAX_ROTORS, State};
    use crate::sample::quad;

    const AIR: Params<f64> = Params { sigma_m_s: [3.0, 2.0, 1.0], length_m: [5.0, 10.0, 2.0] };

    /// Wind after each of several steps of `dt` with these normals, of a vehicle at rest in a mean wind.
    fn winds(mean: [f64; 3], dt: f64, normals: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let wind = AnyEffect::ConstantWind(constant_wind::Params { velocity_m_s: mean });
        let drone = quad(vec![AnyEffect::Turbulence(AIR), wind]);
        let mut memory = vec![0.0; drone.memory_len(dt)];
        let step = |normals: &[f64; 3]| {
            let [a, b, c] = *normals;
            let mut around = Surroundings { normals: [a, b, c, 0.0, 0.0, 0.0], ..Surroundings::calm() };
            let mut command = Command::Rotors([0.0; MAX_ROTORS]);
            drone.transmit(&State::rest(), &mut around, (dt, dt), &mut command, &mut memory);
            around.wind_m_s
        };
        normals.iter().map(step).collect()
    }

    #[test]
    fn gusts_begin_at_their_full_size_and_fade_with_the_distance_that_the_air_has_passed() {
        let kick = [[1.0, -1.0, 0.5], [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]];
        let found = winds([0.0, 6.0, 0.0], 0.1, &kick);
        let speed = (36.0f64 + 9.0 + 4.0 + 1.0).sqrt();
        for (step, wind) in found.iter().enumerate() {
            for i in 0..3 {
                let fade = (-speed * 0.1 * step as f64 / AIR.length_m[i]).exp();
                let expected = AIR.sigma_m_s[i] * kick[0][i] * fade;
                assert!((wind[i] - expected).abs() < 1e-9, "{wind:?} {expected} at {step}");
            }
        }
        // Steps of half the length fade alike: the filter is exact at any step.
        let fine = winds([0.0, 6.0, 0.0], 0.05, &[&kick[..1], &[[0.0; 3]; 8]].concat());
        for i in 0..3 {
            assert!((fine[8][i] - found[4][i]).abs() < 1e-9);
        }
    }

    #[test]
    fn what_fades_is_made_up_by_what_comes_new_so_that_the_variance_stays() {
        // Variance of u after a step from variance 1: a² + (1 − a²).
        let old = winds([4.0, 0.0, 0.0], 0.2, &[[1.0; 3], [0.0; 3]])[1];
        let new = winds([4.0, 0.0, 0.0], 0.2, &[[0.0; 3], [1.0; 3]])[1];
        for i in 0..3 {
            let variance = (old[i].powi(2) + new[i].powi(2)) / AIR.sigma_m_s[i].powi(2);
            assert!((variance - 1.0).abs() < 1e-12, "{variance}");
            assert!(old[i] > 0.1 && new[i] > 0.1);
        }
    }
}
