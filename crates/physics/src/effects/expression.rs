//! A user's own effect, written as expressions in the vehicle file: forces, a torque, a factor on the thrust.
//!
//! The text is read by `vehicle::expression`; here stand the variables that it may use and what its values do.

use super::{Effect, View};
use crate::airframe;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Needs};
use crate::params::Parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::{euler, vec3};
pub use propwash_trace::program::{MAX_DEPTH, Op, Program, ProgramError};

/// Distance that stands for "no other vehicle", m.
const NO_NEIGHBOUR_M: f64 = 1e6;

/// Most parameters of one expression effect.
pub const MAX_PARAMETERS: usize = 8;

/// A quantity that expressions may read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variable {
    /// Its name in expressions.
    pub name: &'static str,
    /// SI unit, `1` where it has none.
    pub unit: &'static str,
    /// What it is.
    pub meaning: &'static str,
}

macro_rules! variables {
    ($view:ident; $($name:ident $unit:literal $meaning:literal => $value:expr;)*) => {
        /// All variables; an input of a program is an index into this list, or, from its length on, a parameter.
        pub const VARIABLES: &[Variable] = &[
            $(Variable { name: stringify!($name), unit: $unit, meaning: $meaning },)*
        ];

        /// Order of the variables.
        #[allow(non_camel_case_types)]
        enum Index { $($name,)* }

        /// Value of variable number `index`.
        #[inline]
        fn read<S: Real>(index: u16, $view: &View<S>) -> S {
            $(const $name: u16 = Index::$name as u16;)*
            match index {
                $($name => $value,)*
                _ => S::zero(),
            }
        }
    };
}

mod list {
    #![allow(non_upper_case_globals)]
    use super::*;

    variables! { view;
        pi "1" "the number π" => S::lit(core::f64::consts::PI);
        t "s" "time since the reset, or since the start of the log" => view.surroundings.time_s;
        x "m" "position, world" => view.state.pos[0];
        y "m" "position, world" => view.state.pos[1];
        z "m" "position, world, up" => view.state.pos[2];
        vx "m/s" "velocity over ground, world" => view.state.vel[0];
        vy "m/s" "velocity over ground, world" => view.state.vel[1];
        vz "m/s" "velocity over ground, world, up" => view.state.vel[2];
        vx_body "m/s" "velocity through the air, ahead" => view.air_velocity()[0];
        vy_body "m/s" "velocity through the air, to the left" => view.air_velocity()[1];
        vz_body "m/s" "velocity through the air, to the top" => view.air_velocity()[2];
        wx "rad/s" "angular velocity about the body's x" => view.state.ang_vel[0];
        wy "rad/s" "angular velocity about the body's y" => view.state.ang_vel[1];
        wz "rad/s" "angular velocity about the body's z" => view.state.ang_vel[2];
        qx "1" "attitude quaternion, body to world" => view.state.quat[0];
        qy "1" "attitude quaternion, body to world" => view.state.quat[1];
        qz "1" "attitude quaternion, body to world" => view.state.quat[2];
        qw "1" "attitude quaternion, body to world" => view.state.quat[3];
        roll "rad" "attitude, Euler angles xyz" => euler::from_quat(view.state.quat)[0];
        pitch "rad" "attitude, Euler angles xyz" => euler::from_quat(view.state.quat)[1];
        yaw "rad" "attitude, Euler angles xyz" => euler::from_quat(view.state.quat)[2];
        rotor1 "rad/s" "speed of the first rotor" => view.rotor_vel()[0];
        rotor2 "rad/s" "speed of the second rotor" => view.rotor_vel()[1];
        rotor3 "rad/s" "speed of the third rotor" => view.rotor_vel()[2];
        rotor4 "rad/s" "speed of the fourth rotor" => view.rotor_vel()[3];
        rotor5 "rad/s" "speed of the fifth rotor; 0 where there is none" => view.rotor_vel()[4];
        rotor6 "rad/s" "speed of the sixth rotor; 0 where there is none" => view.rotor_vel()[5];
        rotor7 "rad/s" "speed of the seventh rotor; 0 where there is none" => view.rotor_vel()[6];
        rotor8 "rad/s" "speed of the eighth rotor; 0 where there is none" => view.rotor_vel()[7];
        rotor_sum "rad/s" "sum of the rotors' speeds" => sum_of_speeds(view);
        thrust_n "N" "thrust of all rotors by their curves, before what the air does" => thrust(view);
        ground_m "m" "height above what lies below; 1000000 where there is no ground" => view.surroundings.ground_distance_m;
        ceiling_m "m" "distance up to what lies above; 1000000 where there is no ceiling" => view.surroundings.ceiling_distance_m;
        others_m "m" "distance to the nearest other vehicle; 1000000 where there is none" => nearest(view);
        wind_x "m/s" "velocity of the air, world" => view.surroundings.wind_m_s[0];
        wind_y "m/s" "velocity of the air, world" => view.surroundings.wind_m_s[1];
        wind_z "m/s" "velocity of the air, world" => view.surroundings.wind_m_s[2];
        air_density "kg/m³" "density of the air" => view.surroundings.air_density_kg_m3;
        mass_kg "kg" "mass of the vehicle" => view.body.mass_kg;
        gravity "m/s²" "magnitude of gravity" => vec3::norm(view.body.gravity_m_s2);
    }

    /// [`read`], for the effect.
    #[inline]
    pub(super) fn value<S: Real>(index: u16, view: &View<S>) -> S {
        read(index, view)
    }
}
pub use list::VARIABLES;

/// Value of variable number `index` of [`VARIABLES`].
pub(super) fn variable<S: Real>(index: usize, view: &View<S>) -> S {
    list::value(index as u16, view)
}

fn sum_of_speeds<S: Real>(view: &View<S>) -> S {
    let speeds = view.rotor_vel();
    let mut sum = S::zero();
    for i in 0..view.airframe.n_rotors {
        sum = sum + speeds[i];
    }
    sum
}

/// Distance to the nearest other vehicle, m.
fn nearest<S: Real>(view: &View<S>) -> S {
    let far = S::lit(NO_NEIGHBOUR_M);
    view.surroundings.neighbours.iter().fold(far, |least, other| {
        let apart = vec3::sub(other.pos, view.state.pos);
        // The added square keeps the slope finite where two places are one.
        least.min((vec3::dot(apart, apart) + S::lit(1e-8)).sqrt())
    })
}

fn thrust<S: Real>(view: &View<S>) -> S {
    let Some(thrust) = view.collective_n else {
        let loads = airframe::loads(view.airframe, &view.state.rotor_vel);
        let mut sum = S::zero();
        for i in 0..view.airframe.n_rotors {
            sum = sum + loads.thrust[i];
        }
        return sum;
    };
    thrust
}

/// A parameter of an expression effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Declared {
    /// Its name, unit, widths and sign; a slab of 0 says that no search may free it.
    pub freedom: Freedom,
    /// Where it may lie.
    pub bounds: Bounds,
}

/// What an expression effect says, apart from the values of its parameters.
///
/// An effect is copied with its vehicle, so it holds a formula by a reference that lives as long as the program:
/// `vehicle::expression::intern` keeps every formula once, however often its text is read, and never frees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    /// Name of the effect, given by the user.
    pub name: String,
    /// Force, N, body.
    pub force_body_n: Option<[Program; 3]>,
    /// Force, N, world.
    pub force_world_n: Option<[Program; 3]>,
    /// Torque, N·m, body.
    pub torque_body_n_m: Option<[Program; 3]>,
    /// Factor on the thrust of every rotor.
    pub thrust_factor: Option<Program>,
    /// Parameters, at most [`MAX_PARAMETERS`].
    pub parameters: Vec<Declared>,
}

/// A formula that says nothing.
static NOTHING: Formula = Formula {
    name: String::new(),
    force_body_n: None,
    force_world_n: None,
    torque_body_n_m: None,
    thrust_factor: None,
    parameters: Vec::new(),
};

/// An expression effect: a formula and the values of its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params<S> {
    /// Values of the formula's parameters, in its order, in SI; entries past the last one are 0.
    pub value: [S; MAX_PARAMETERS],
    /// The formula.
    pub formula: &'static Formula,
}

impl Default for Params<f64> {
    /// No formula and no influence.
    fn default() -> Self {
        Self { value: [0.0; MAX_PARAMETERS], formula: &NOTHING }
    }
}

impl<S: Real> Parameters<S> for Params<S> {
    type Over<T: Real> = Params<T>;
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Params<T> {
        Params { value: self.value.map(f), formula: self.formula }
    }
    /// Parameters under the names that the user gave them.
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        for (declared, value) in self.formula.parameters.iter().zip(&mut self.value) {
            f(&format!("{prefix}.{}", declared.freedom.name), value);
        }
    }
}

impl<S: Real> Params<S> {
    #[inline]
    fn eval(&self, program: &Program, view: &View<S>) -> S {
        let own = VARIABLES.len();
        program.eval(|input| match usize::from(input).checked_sub(own) {
            Some(parameter) => self.value[parameter % MAX_PARAMETERS],
            None => list::value(input, view),
        })
    }

    #[inline]
    fn vector(&self, programs: &[Program; 3], view: &View<S>) -> [S; 3] {
        core::array::from_fn(|i| self.eval(&programs[i], view))
    }
}

/// What a variable takes from the surroundings.
pub(super) fn reads_of(variable: &str) -> Reads {
    match variable {
        "ground_m" => Reads::GROUND,
        "ceiling_m" => Reads::CEILING,
        "others_m" => Reads::NEIGHBOURS,
        "wind_x" | "wind_y" | "wind_z" | "vx_body" | "vy_body" | "vz_body" => Reads::WIND,
        _ => Reads::NOTHING,
    }
}

impl<S: Real> Effect<S> for Params<S> {
    /// What the variables read that the formula uses.
    fn reads(&self) -> Reads {
        let used = VARIABLES.iter().enumerate().filter(|(i, _)| self.formula.reads_input(*i));
        used.fold(Reads::NOTHING, |reads, (_, variable)| reads.or(reads_of(variable.name)))
    }

    fn thrust_gain(&self, view: &View<S>, _: [S; 3]) -> S {
        self.formula.thrust_factor.as_ref().map_or(S::one(), |program| self.eval(program, view))
    }

    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        if let Some(programs) = &self.formula.force_body_n {
            out.add_body_force(self.vector(programs, view));
        }
        if let Some(programs) = &self.formula.force_world_n {
            out.force = vec3::add(out.force, self.vector(programs, view));
        }
        if let Some(programs) = &self.formula.torque_body_n_m {
            out.torque = vec3::add(out.torque, self.vector(programs, view));
        }
    }
}

impl Formula {
    /// All programs.
    fn programs(&self) -> impl Iterator<Item = &Program> {
        let vectors = [&self.force_body_n, &self.force_world_n, &self.torque_body_n_m];
        vectors.into_iter().flatten().flatten().chain(&self.thrust_factor)
    }

    /// Whether any program reads the variable called `name`.
    pub fn reads(&self, name: &str) -> bool {
        VARIABLES.iter().position(|v| v.name == name).is_some_and(|i| self.reads_input(i))
    }

    /// Whether any program reads input number `index`: a variable, or from the length of [`VARIABLES`] on a parameter.
    pub fn reads_input(&self, index: usize) -> bool {
        let wanted = |op: &Op| matches!(op, Op::Input(i) if usize::from(*i) == index);
        self.programs().flat_map(Program::ops).any(wanted)
    }
}

/// What a search for missing physics may free: the parameters with a slab of every expression that the vehicle lists. The
/// candidate carries the expression's name as its id; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    let mut out = Vec::new();
    for effect in &drone.effects {
        let super::AnyEffect::Expression(Params { formula, .. }) = effect else { continue };
        let declared = formula.parameters.iter().map(|p| &p.freedom);
        let freedoms: Vec<Freedom> = declared.filter(|f| f.slab != 0.0).cloned().collect();
        if freedoms.is_empty() {
            continue;
        }
        let pushes = formula.force_body_n.is_some() || formula.force_world_n.is_some();
        let needs = match Effect::<f64>::reads(effect) {
            reads if reads.ground => Needs::Ground,
            reads if reads.ceiling => Needs::Ceiling,
            reads if reads.neighbours => Needs::Neighbour,
            _ => Needs::Nothing,
        };
        let candidate = Candidate::new(
            "expression",
            &format!("the expression {} of the vehicle file", formula.name),
            if pushes || formula.thrust_factor.is_none() { Area::Airframe } else { Area::Drive },
            freedoms,
            "fly so that the variables of the expression vary widely, and not all together",
        );
        out.push(candidate.called(&formula.name).needing(needs));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::{Neighbour, Surroundings};

    #[test]
    fn the_nearest_of_the_others_counts() {
        let drone = quad(vec![]);
        let state = State { pos: [1.0, 0.0, 0.5], ..State::rest() };
        let read = |neighbours: &[Neighbour<f64>]| {
            let surroundings = Surroundings { neighbours, ..Surroundings::calm() };
            let view = View {
                body: &drone.body,
                airframe: &drone.airframe,
                state: &state,
                surroundings: &surroundings,
                collective_n: None,
                memory: &[],
            };
            nearest(&view)
        };
        let at = |pos: [f64; 3]| Neighbour { pos, vel: [0.0; 3], weight_n: 1.0, disc_radius_m: 0.1 };
        assert_eq!(read(&[]), 1e6);
        assert!((read(&[at([4.0, 4.0, 0.5]), at([1.0, 0.0, 2.0])]) - 1.5).abs() < 1e-8);
        assert_eq!(reads_of("others_m"), Reads::NEIGHBOURS);
    }
}
