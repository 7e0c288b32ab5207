//! Force shapes that no listed effect has, to test findings against: if one of them fits clearly better, the finding is
//! only the nearest name for something else.
//!
//! A shape is fitted and scored like an effect, but no search may choose it and no verdict names it as an effect.

use super::GapError;
use super::model::Model;
use super::search::Evidence;
use propwash_physics::effects::candidate::{Bounds, Freedom, Scale};
use propwash_physics::effects::expression::{Formula, Params};
use propwash_physics::effects::{AnyEffect, Area, Candidate};
use propwash_vehicle::expression::{intern, parse};

/// Evidence by which a shape must beat the finding, nats.
const CLEARLY: f64 = 10.0;

/// Name, words, force along body x, y, z with the coefficient `c`, unit and plausible size of the coefficient per kilogram.
type Shape = (&'static str, &'static str, [&'static str; 3], &'static str, f64);

/// All shapes.
const SHAPES: &[Shape] = &[(
    "speed cubed",
    "a force that grows with the cube of the speed",
    [
        "-cx * (vx_body^2 + vy_body^2 + vz_body^2) * vx_body",
        "-cy * (vx_body^2 + vy_body^2 + vz_body^2) * vy_body",
        "-cz * (vx_body^2 + vy_body^2 + vz_body^2) * vz_body",
    ],
    "N·s³/m³",
    0.015,
)];
/// Names of the coefficients.
const COEFFICIENTS: [&str; 3] = ["cx", "cy", "cz"];

impl Model {
    /// Adds the shapes as candidates that no search may choose.
    ///
    /// # Errors
    /// [`GapError`] where an expression of a shape is invalid.
    pub fn with_shapes(mut self) -> Result<Self, GapError> {
        let scale = Scale::of(&self.drone);
        for (name, words, force, unit, size) in SHAPES {
            let slab = size * scale.mass_kg;
            let freedoms: Vec<Freedom> = COEFFICIENTS.map(|c| Freedom::up(c, unit, 0.0, slab)).into();
            let mut programs = Vec::new();
            for text in force {
                programs.push(parse(text, &COEFFICIENTS).map_err(|_| GapError::Numbers {
                    what: "a shape",
                    reason: format!("{text:?} is no expression"),
                })?);
            }
            let formula = Formula {
                name: (*name).into(),
                force_body_n: programs.try_into().ok(),
                parameters: freedoms
                    .iter()
                    .map(|f| propwash_physics::effects::expression::Declared {
                        freedom: f.clone(),
                        bounds: Bounds::from(f64::NEG_INFINITY),
                    })
                    .collect(),
                ..Formula::default()
            };
            let params = Params { formula: intern(formula), ..Params::default() };
            self.drone.effects.push(AnyEffect::Expression(params));
            self.listed.push(false);
            let shape = Candidate::new("expression", words, Area::Airframe, freedoms, "fly at many speeds");
            self.admit(shape.called(name))?;
            self.shapes.push(self.candidates.len() - 1);
        }
        for c in &self.shapes {
            self.may[*c] = false;
        }
        Ok(self)
    }

    /// Candidates that are not shapes.
    pub fn named(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.candidates.len()).filter(|c| !self.is_shape(*c))
    }

    /// Whether a candidate is a shape.
    pub fn is_shape(&self, candidate: usize) -> bool {
        self.shapes.contains(&candidate)
    }
}

/// The shape that fits clearly better than candidate `of` of `set`, in words, and by how many nats.
pub(crate) fn better(model: &Model, evidence: &Evidence, set: &[usize], of: usize) -> Option<(String, f64)> {
    let own = evidence.of(set);
    let rest = set.iter().copied().filter(|c| *c != of);
    model
        .shapes
        .iter()
        .map(|shape| {
            let mut with: Vec<usize> = rest.clone().chain([*shape]).collect();
            with.sort_unstable();
            (model.candidates[*shape].title.clone(), evidence.of(&with) - own)
        })
        .filter(|(_, nats)| *nats > CLEARLY)
        .max_by(|a, b| a.1.total_cmp(&b.1))
}
