//! Shapes of forces and torques that no listed effect has, to test findings against: if one of them fits clearly better, the finding is
//! only the nearest name for something else.
//!
//! A shape is fitted and scored like an effect, but no search may choose it and no verdict names it as an effect.

use super::GapError;
use super::fit::Prepared;
use super::model::Model;
use super::policy::IN_PLACE_NATS;
use super::search::Evidence;
use propwash_physics::effects::candidate::{Bounds, Freedom, Scale};
use propwash_physics::effects::expression::{Formula, Params};
use propwash_physics::effects::{AnyEffect, Area, Candidate, nature};
use propwash_trace::math::vec3;
use propwash_vehicle::expression::{intern, parse};

/// One of the shapes.
struct Shape {
    name: &'static str,
    words: &'static str,
    on: On,
    unit: &'static str,
    /// Plausible size of the coefficient: per kilogram and, of a torque, per metre of a rotor's radius.
    size: f64,
}

/// What a shape gives.
enum On {
    /// A force against the motion along each axis of the body, without its coefficient: `{v}` is the velocity along that axis,
    /// `{speed}` the airspeed and `{s}` the usual speed of the flights.
    Force(&'static str),
    /// Torques about axes of the body with their coefficients.
    Torque([&'static str; 3]),
}

const fn force(
    name: &'static str,
    words: &'static str,
    text: &'static str,
    unit: &'static str,
    size: f64,
) -> Shape {
    Shape { name, words, on: On::Force(text), unit, size }
}

/// All shapes: at the usual speed of a flight each goes otherwise with the speed than the drags of the list, which go with it or with
/// its square, and than the blades, whose torque goes with the speed of the rotors, too.
const SHAPES: &[Shape] = &[
    force(
        "speed cubed",
        "a force that grows with the cube of the speed",
        "({speed})^2 * {v}",
        "N·s³/m³",
        0.015,
    ),
    force(
        "speed beyond a threshold",
        "a force that begins at a threshold of the speed",
        "max(0, {speed} - {s}) / {speed} * {v}",
        "N·s/m",
        0.3,
    ),
    force(
        "speed beyond a low threshold",
        "a force that begins at a threshold of the speed",
        "max(0, {speed} - 0.5 * {s}) / {speed} * {v}",
        "N·s/m",
        0.3,
    ),
    force(
        "root of the speed",
        "a force that grows slower than the speed",
        "{v} / sqrt({speed})",
        "N·√(s/m)",
        0.3,
    ),
    force(
        "speed ahead only",
        "a force that acts in one direction of motion only",
        "max(0, {v})",
        "N·s/m",
        0.3,
    ),
    Shape {
        name: "force above",
        words: "a torque that goes with the speed across, as of a force above or below the centre of mass,",
        on: On::Torque(["cx * vy_body", "-cy * vx_body", "0"]),
        unit: "N·s",
        size: 0.1,
    },
];

/// Airspeed; the added square keeps it from nothing at rest.
const AIRSPEED: &str = "sqrt(vx_body^2 + vy_body^2 + vz_body^2 + 1e-4)";
/// Velocities along the axes of the body.
const VELOCITIES: [&str; 3] = ["vx_body", "vy_body", "vz_body"];
/// Names of the coefficients.
const COEFFICIENTS: [&str; 3] = ["cx", "cy", "cz"];

impl Model {
    /// Adds the shapes as candidates that no search may choose; `usual_m_s` is the usual speed of the flights.
    ///
    /// # Errors
    /// [`GapError`] where an expression of a shape is invalid.
    pub fn with_shapes(mut self, usual_m_s: f64) -> Result<Self, GapError> {
        let scale = Scale::of(&self.drone);
        let usual = format!("{usual_m_s:e}");
        for Shape { name, words, on, unit, size } in SHAPES {
            let (slab, free): (_, fn(String, _, _, _) -> Freedom) = match on {
                On::Force(_) => (size * scale.mass_kg, Freedom::up),
                On::Torque(_) => (size * scale.mass_kg * scale.radius_m, Freedom::any),
            };
            let names = &COEFFICIENTS[..if matches!(on, On::Force(_)) { 3 } else { 2 }];
            let freedoms: Vec<Freedom> = names.iter().map(|c| free((*c).into(), unit, 0.0, slab)).collect();
            let texts: [String; 3] = core::array::from_fn(|k| match on {
                On::Force(text) => {
                    let own = text.replace("{v}", VELOCITIES[k]).replace("{speed}", AIRSPEED);
                    format!("-{} * ({})", COEFFICIENTS[k], own.replace("{s}", &usual))
                }
                On::Torque(texts) => texts[k].into(),
            });
            let mut programs = Vec::new();
            for text in texts {
                programs.push(parse(&text, names).map_err(|_| GapError::Numbers {
                    what: "a shape",
                    reason: format!("{text:?} is no expression"),
                })?);
            }
            let programs = programs.try_into().ok();
            let (force_body_n, torque_body_n_m) = match on {
                On::Force(_) => (programs, None),
                On::Torque(_) => (None, programs),
            };
            let formula = Formula {
                name: (*name).into(),
                force_body_n,
                torque_body_n_m,
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

/// The shape that fits best in place of candidate `of` of `set`, in words, and how many nats better it fits; `None` where none fits as
/// well. A torque is only replaced by a torque: what one in place of a force explains is missing beside it.
pub(crate) fn instead(model: &Model, evidence: &Evidence, set: &[usize], of: usize) -> Option<(String, f64)> {
    let own = evidence.of(set);
    let torque = nature(model.candidates[of].kind).torques_only;
    SHAPES
        .iter()
        .zip(&model.shapes)
        .filter(|(shape, _)| matches!(shape.on, On::Torque(_)) == torque)
        .map(|(shape, c)| {
            let mut with: Vec<usize> = set.iter().copied().filter(|c| *c != of).chain([*c]).collect();
            with.sort_unstable();
            (shape.words.to_string(), evidence.of(&with) - own)
        })
        .filter(|(_, nats)| *nats > IN_PLACE_NATS)
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The usual speed of flights, m/s: the root of the mean square of what was measured; at least some cm/s, so that a scale is none of the
/// sensors' noise.
pub(crate) fn usual_speed_m_s(logs: &[Prepared]) -> f64 {
    let speeds = logs.iter().flat_map(|l| l.around.measured.iter().flatten()).map(|m| vec3::norm(m.vel));
    let (n, squares) = speeds.fold((0usize, 0.0), |(n, sum), v| (n + 1, sum + v * v));
    (squares / n.max(1) as f64).sqrt().max(0.05)
}
