//! Push from the air that other vehicles throw down.
//!
//! Each vehicle above leaves a jet of momentum-theory speed that spreads as it falls: at depth h below its rotors the
//! radius is R + s h and the velocity falls as R/(R + s h), so that the jet carries the same momentum at every depth.
//! Across the jet the velocity is Gaussian. The vehicle below feels the dynamic pressure of the jet over its drag area.
//! Source: momentum theory (Leishman, "Principles of helicopter aerodynamics", ch. 2) and the far-field jet
//! (Khan & Nahon, "Toward an accurate physics-based UAV thruster model", IEEE/ASME T. Mechatronics 18(4), 2013).

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Needs};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;

parameters! {
    /// Parameters of downwash on the vehicle that has this effect.
    pub struct Params {
        /// Area times drag coefficient that the jet meets from above, m².
        drag_area_m2: S,
        /// Growth of the jet's radius per depth.
        spread: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { drag_area_m2: 0.0, spread: 0.1 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("drag_area_m2", Bounds::from(0.0)), ("spread", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::NEIGHBOURS
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let density = view.surroundings.air_density_kg_m3;
        for other in view.surroundings.neighbours {
            let dx = view.state.pos[0] - other.pos[0];
            let dy = view.state.pos[1] - other.pos[1];
            let depth = other.pos[2] - view.state.pos[2];
            let below = depth.max(S::zero());
            let disc = other.disc_radius_m;
            let jet = disc + self.spread * below;
            // Far-wake speed of a hovering disc is twice the induced speed √(W / 2ρA).
            let area = S::lit(core::f64::consts::PI) * disc * disc;
            let far_speed = S::lit(2.0) * (other.weight_n / (S::lit(2.0) * density * area)).sqrt();
            let r2 = (dx * dx + dy * dy) / (jet * jet);
            let speed = far_speed * (disc / jet) * (-r2).exp();
            let force = S::lit(0.5) * density * self.drag_area_m2 * speed * speed;
            let above = S::zero().lt(depth);
            out.force[2] = out.force[2] - S::select(above, force, S::zero());
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // The discs of all rotors with a drag coefficient of 1.
    let slab = core::f64::consts::PI * drone.disc_radius_m().powi(2);
    vec![
        Candidate::new(
            "downwash",
            "push from the air that another vehicle above throws down",
            Area::Airframe,
            vec![
                Freedom::up("drag_area_m2", "m²", 0.002 * slab, slab),
                // Only where there is a jet does its width show.
                Freedom::any("spread", "1", 0.0, 0.03),
            ],
            "fly under the other vehicle at several distances, and away from it",
        )
        .needing(Needs::Neighbour),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::{Neighbour, Surroundings};

    #[test]
    fn only_the_vehicle_below_is_pushed_and_less_so_off_the_axis_and_far_down() {
        let drone = quad(vec![AnyEffect::Downwash(Params { drag_area_m2: 0.02, spread: 0.1 })]);
        let push = |dx: f64, dz: f64| {
            let other = Neighbour { pos: [dx, 0.0, dz], vel: [0.0; 3], weight_n: 9.81, disc_radius_m: 0.12 };
            let neighbours = [other];
            let near = Surroundings { neighbours: &neighbours, ..Surroundings::calm() };
            -(drone.rate(&State::rest(), &Command::Rotors([0.0; 8]), &near).acc[2] + 9.81)
        };
        // Just below: dynamic pressure of the far wake, which is (2 v_i)² ρ/2 = W / A · 2 … over the drag area.
        let area = core::f64::consts::PI * 0.12f64.powi(2);
        assert!((push(0.0, 1e-9) - 0.02 * 9.81 / area).abs() < 1e-6);
        assert!(push(0.0, -0.5) == 0.0 || push(0.0, -0.5).abs() < 1e-12);
        assert!(push(0.0, 0.5) > push(0.2, 0.5) && push(0.0, 0.5) > push(0.0, 1.5));
        // The momentum of the jet does not change with depth: radius² · speed² on the axis.
        let jet = |dz: f64| push(0.0, dz) * (0.12 + 0.1 * dz).powi(2);
        assert!((jet(0.2) / jet(2.0) - 1.0).abs() < 1e-9);
    }
}
