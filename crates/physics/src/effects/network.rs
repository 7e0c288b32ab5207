//! A force or a torque by a small neural network, whose numbers stand in a file beside the vehicle file.
//!
//! The file is read by `vehicle::network`; here stand what a network may read and what its outputs do.

use super::expression::{self, SEEN, VARIABLES, Variable};
use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::Candidate;
use crate::params::Parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};
pub use propwash_trace::mlp::{Layer, MAX_HIDDEN, MAX_WEIGHTS, MAX_WIDTH, Mlp, MlpError, Scaling};

/// What a network may read beside the variables of expressions.
pub const OWN: &[Variable] = &[
    Variable { name: "speed", unit: "m/s", meaning: "speed through the air" },
    Variable { name: "rotor_mean", unit: "rad/s", meaning: "mean of the rotors' speeds" },
    Variable {
        name: "up_x",
        unit: "1",
        meaning: "world's up along the body's x: minus the sine of a nose up",
    },
    Variable { name: "up_y", unit: "1", meaning: "world's up along the body's y" },
    Variable { name: "up_z", unit: "1", meaning: "world's up along the body's z: the cosine of the tilt" },
];

/// Everything that a network may read, in the order in which [`Network::inputs`] counts.
pub fn inputs() -> impl Iterator<Item = Variable> {
    VARIABLES[..SEEN].iter().chain(OWN).copied()
}

/// What the outputs of a network may act on: forces at the centre of mass along body axes, N, and torques about them, N·m.
pub const ACTS_ON: [&str; 6] = [
    "force_body_x_n",
    "force_body_y_n",
    "force_body_z_n",
    "torque_body_x_n_m",
    "torque_body_y_n_m",
    "torque_body_z_n_m",
];

/// A network with what it reads and what it acts on.
///
/// An effect is copied with its vehicle, so it holds its network by a reference that lives as long as the program:
/// `vehicle::network::intern` keeps every network once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Network {
    /// Name of the effect, given by its vehicle file.
    pub name: String,
    /// What enters, shape (input): indices into [`inputs`].
    pub inputs: Vec<usize>,
    /// What each output acts on, shape (output): indices into [`ACTS_ON`].
    pub acts_on: Vec<usize>,
    /// Its numbers.
    pub mlp: Mlp,
}

/// A network that does nothing.
static NOTHING: std::sync::LazyLock<Network> = std::sync::LazyLock::new(Network::default);

/// A network effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params<S> {
    /// Factor on all outputs; 1 as the network was fitted.
    pub gain: S,
    /// The network.
    pub network: &'static Network,
}

impl Default for Params<f64> {
    /// No network and no influence.
    fn default() -> Self {
        Self { gain: 1.0, network: &NOTHING }
    }
}

impl<S: Real> Parameters<S> for Params<S> {
    type Over<T: Real> = Params<T>;
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Params<T> {
        Params { gain: f(self.gain), network: self.network }
    }
    /// The gain; nothing where there is no network.
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        if !self.network.acts_on.is_empty() {
            f(&format!("{prefix}.gain"), &mut self.gain);
        }
    }
    fn numbers<F: FnMut(S)>(&self, f: &mut F) {
        f(self.gain);
    }
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
        f(&mut self.gain);
    }
}

/// Value of input number `index` of [`inputs`].
pub fn value<S: Real>(index: usize, view: &View<S>) -> S {
    let Some(own) = index.checked_sub(SEEN) else { return expression::variable(index, view) };
    let up = |axis: usize| quat::rotate_inverse(view.state.quat, [S::zero(), S::zero(), S::one()])[axis];
    match own {
        0 => {
            let v = view.air_velocity();
            // The added square keeps the slope at rest finite.
            (vec3::dot(v, v) + S::lit(1e-4)).sqrt()
        }
        1 => {
            let mut sum = S::zero();
            for speed in view.rotor_vel().into_iter().take(view.airframe.n_rotors) {
                sum = sum + speed;
            }
            sum / S::lit(view.airframe.n_rotors.max(1) as f64)
        }
        2..=4 => up(own - 2),
        _ => S::zero(),
    }
}

/// What an input takes from the surroundings.
fn reads_of(index: usize) -> Reads {
    match VARIABLES[..SEEN].get(index) {
        Some(variable) => expression::reads_of(variable.name),
        None if index == SEEN => Reads::WIND,
        None => Reads::NOTHING,
    }
}

impl<S: Real> Effect<S> for Params<S> {
    /// What the network's inputs read.
    fn reads(&self) -> Reads {
        self.network.inputs.iter().fold(Reads::NOTHING, |reads, input| reads.or(reads_of(*input)))
    }

    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let given = self.network.mlp.eval(|i| value(self.network.inputs[i], view));
        let mut wrench = [S::zero(); 6];
        for (at, output) in self.network.acts_on.iter().zip(given) {
            wrench[at % 6] = wrench[at % 6] + self.gain * output;
        }
        let [fx, fy, fz, tx, ty, tz] = wrench;
        out.add_body_force([fx, fy, fz]);
        out.torque = vec3::add(out.torque, [tx, ty, tz]);
    }
}

/// A network is found by a fit of its own and has nothing that a search could free.
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    Vec::new()
}
