//! A user's own effect, written as expressions in the vehicle file: forces, a torque, a factor on the thrust, commands, with numbers that it
//! remembers. One that commands in place of the on-board controller is a controller of one's own.
//!
//! The text is read by `vehicle::expression`; here stand the variables that it may use and what its values do.

use super::{Command, Effect, Nature, View};
use crate::airframe;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Needs};
use crate::params::Parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::{Neighbour, Reads};
use propwash_trace::Real;
use propwash_trace::math::{euler, vec3};
pub use propwash_trace::program::{MAX_DEPTH, Op, Program, ProgramError};

/// Distance that stands for "no other vehicle", m.
const NO_NEIGHBOUR_M: f64 = 1e6;

/// Most parameters of one expression effect.
pub const MAX_PARAMETERS: usize = 8;

/// Most numbers that one expression effect remembers.
pub const MAX_MEMORY: usize = 32;

/// Most values that one expression effect names.
pub const MAX_LETS: usize = 256;

/// What an expression may read beside constants; an operation holds its [index](Input::index).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// Place in [`VARIABLES`].
    Variable(usize),
    /// Place among the effect's parameters.
    Parameter(usize),
    /// Place among the numbers that it remembers.
    Memory(usize),
    /// Place among the values that it names.
    Let(usize),
}

impl Input {
    /// The number by which programs read it.
    pub fn index(self) -> u16 {
        let at = match self {
            Self::Variable(i) => i,
            Self::Parameter(i) => VARIABLES.len() + i,
            Self::Memory(i) => VARIABLES.len() + MAX_PARAMETERS + i,
            Self::Let(i) => VARIABLES.len() + MAX_PARAMETERS + MAX_MEMORY + i,
        };
        at as u16
    }

    /// What this number reads.
    pub fn of(index: u16) -> Self {
        let i = usize::from(index);
        let Some(i) = i.checked_sub(VARIABLES.len()) else { return Self::Variable(i) };
        let Some(i) = i.checked_sub(MAX_PARAMETERS) else { return Self::Parameter(i) };
        i.checked_sub(MAX_MEMORY).map_or(Self::Memory(i), Self::Let)
    }
}

/// Where a variable has a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    /// In every expression.
    Always,
    /// In what is computed once a step: memory and commands.
    OnceAStep,
}

/// What an effect sees while it computes: once a step with a command, or within the forces without.
struct Sight<'a, S> {
    view: &'a View<'a, S>,
    /// What goes to the motors, in a step.
    command: Option<&'a Command<S>>,
    dt_s: S,
    memory: &'a [S],
}

impl<S: Real> Sight<'_, S> {
    fn told(&self, i: usize) -> S {
        self.view.surroundings.command.get(i).copied().unwrap_or(S::zero())
    }

    fn rotor_command(&self, i: usize) -> S {
        match self.command {
            Some(Command::Rotors(speeds)) => speeds[i],
            _ => S::zero(),
        }
    }

    fn attitude_command(&self, i: usize) -> S {
        match self.command {
            Some(Command::Attitude(numbers)) => numbers[i],
            _ => S::zero(),
        }
    }
}

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
    ($sight:ident, $view:ident; $($name:ident $unit:literal $meaning:literal => $value:expr;)*) => {
        /// All variables; see [`Input`] for what else programs read.
        pub const VARIABLES: &[Variable] = &[
            $(Variable { name: stringify!($name), unit: $unit, meaning: $meaning },)*
        ];

        /// How many of them are what a flight shows, the first ones: all but random numbers and commands.
        pub const SEEN: usize = Index::gravity as usize + 1;

        /// Order of the variables.
        #[allow(non_camel_case_types)]
        enum Index { $($name,)* }

        /// Value of variable number `index`.
        #[inline]
        fn read<S: Real>(index: usize, $sight: &Sight<S>) -> S {
            $(const $name: usize = Index::$name as usize;)*
            let $view = $sight.view;
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

    variables! { sight, view;
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
        dt "s" "length of a step" => sight.dt_s;
        normal1 "1" "standard normal random number, another in every step" => view.surroundings.normals[3];
        normal2 "1" "a second one" => view.surroundings.normals[4];
        normal3 "1" "a third one" => view.surroundings.normals[5];
        command1 "1" "number 1 of what the vehicle is commanded, in the units of the control mode" => sight.told(0);
        command2 "1" "number 2 of what the vehicle is commanded, in the units of the control mode" => sight.told(1);
        command3 "1" "number 3 of what the vehicle is commanded, in the units of the control mode" => sight.told(2);
        command4 "1" "number 4 of what the vehicle is commanded, in the units of the control mode" => sight.told(3);
        command5 "1" "number 5 of what the vehicle is commanded, in the units of the control mode" => sight.told(4);
        command6 "1" "number 6 of what the vehicle is commanded, in the units of the control mode" => sight.told(5);
        command7 "1" "number 7 of what the vehicle is commanded, in the units of the control mode" => sight.told(6);
        command8 "1" "number 8 of what the vehicle is commanded, in the units of the control mode" => sight.told(7);
        command9 "1" "number 9 of what the vehicle is commanded, in the units of the control mode" => sight.told(8);
        command10 "1" "number 10 of what the vehicle is commanded, in the units of the control mode" => sight.told(9);
        command11 "1" "number 11 of what the vehicle is commanded, in the units of the control mode" => sight.told(10);
        command12 "1" "number 12 of what the vehicle is commanded, in the units of the control mode" => sight.told(11);
        command13 "1" "number 13 of what the vehicle is commanded, in the units of the control mode" => sight.told(12);
        command14 "1" "number 14 of what the vehicle is commanded, in the units of the control mode" => sight.told(13);
        command15 "1" "number 15 of what the vehicle is commanded, in the units of the control mode" => sight.told(14);
        command16 "1" "number 16 of what the vehicle is commanded, in the units of the control mode" => sight.told(15);
        rotor_command1 "rad/s" "commanded speed of rotor 1, on its way to the motors" => sight.rotor_command(0);
        rotor_command2 "rad/s" "commanded speed of rotor 2, on its way to the motors" => sight.rotor_command(1);
        rotor_command3 "rad/s" "commanded speed of rotor 3, on its way to the motors" => sight.rotor_command(2);
        rotor_command4 "rad/s" "commanded speed of rotor 4, on its way to the motors" => sight.rotor_command(3);
        rotor_command5 "rad/s" "commanded speed of rotor 5, on its way to the motors" => sight.rotor_command(4);
        rotor_command6 "rad/s" "commanded speed of rotor 6, on its way to the motors" => sight.rotor_command(5);
        rotor_command7 "rad/s" "commanded speed of rotor 7, on its way to the motors" => sight.rotor_command(6);
        rotor_command8 "rad/s" "commanded speed of rotor 8, on its way to the motors" => sight.rotor_command(7);
        roll_command "rad" "commanded roll, on its way to the attitude response" => sight.attitude_command(0);
        pitch_command "rad" "commanded pitch, on its way to the attitude response" => sight.attitude_command(1);
        yaw_command "rad" "commanded yaw, on its way to the attitude response" => sight.attitude_command(2);
        thrust_command "N" "commanded collective thrust, on its way to the attitude response" => sight.attitude_command(3);
    }

    /// [`read`], for the effect.
    #[inline]
    pub(super) fn value<S: Real>(index: usize, sight: &Sight<S>) -> S {
        read(index, sight)
    }
}
pub use list::{SEEN, VARIABLES};

/// Value of variable number `index` of [`VARIABLES`] within forces and torques.
pub(super) fn variable<S: Real>(index: usize, view: &View<S>) -> S {
    list::value(index, &Sight { view, command: None, dt_s: S::zero(), memory: &[] })
}

/// Where the variable called `name` has a value.
pub fn known(name: &str) -> Known {
    let on_its_way = name.ends_with("_command") || name.starts_with("rotor_command");
    if name == "dt" || on_its_way { Known::OnceAStep } else { Known::Always }
}

fn sum_of_speeds<S: Real>(view: &View<S>) -> S {
    let speeds = view.rotor_vel();
    let mut sum = S::zero();
    for i in 0..view.airframe.n_rotors {
        sum = sum + speeds[i];
    }
    sum
}

fn nearest<S: Real>(view: &View<S>) -> S {
    nearest_m(view.surroundings.neighbours, view.state.pos)
}

/// Distance from `pos` (m, world) to the nearest other vehicle, m; 10⁶ where there is none.
pub fn nearest_m<S: Real>(neighbours: &[Neighbour<S>], pos: [S; 3]) -> S {
    neighbours.iter().fold(S::lit(NO_NEIGHBOUR_M), |least, other| {
        let apart = vec3::sub(other.pos, pos);
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

/// A number that an effect remembers from step to step.
#[derive(Clone, Debug, PartialEq)]
pub struct Memory {
    /// Its name in expressions.
    pub name: String,
    /// What it is after a reset: a constant.
    pub start: Program,
    /// What it is after a step, computed from what was remembered before it.
    pub next: Program,
}

impl Memory {
    fn begun<S: Real>(&self) -> S {
        self.start.eval(|_| S::zero())
    }
}

/// What an expression effect says, apart from the values of its parameters.
///
/// An effect is copied with its vehicle, so it holds a formula by a reference that lives as long as the program:
/// `vehicle::expression::intern` keeps every formula once, however often its text is read, and never frees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Formula {
    /// Name of the effect, given by the user.
    pub name: String,
    /// Values with names, each of which may read those before it; at most [`MAX_LETS`].
    pub lets: Vec<(String, Program)>,
    /// What is remembered, at most [`MAX_MEMORY`] numbers.
    pub memory: Vec<Memory>,
    /// Force, N, body.
    pub force_body_n: Option<[Program; 3]>,
    /// Force, N, world.
    pub force_world_n: Option<[Program; 3]>,
    /// Torque, N·m, body.
    pub torque_body_n_m: Option<[Program; 3]>,
    /// Factor on the thrust of every rotor.
    pub thrust_factor: Option<Program>,
    /// Rotor speeds that go on to the motors, rad/s, one for each rotor; none where they stay as they are.
    pub rotor_command: Vec<Program>,
    /// Roll, pitch, yaw (rad) and thrust (N) that go on to the attitude response.
    pub attitude_command: Option<[Program; 4]>,
    /// Whether its commands take the place of the on-board controller, which does not run then.
    pub controls: bool,
    /// Parameters, at most [`MAX_PARAMETERS`].
    pub parameters: Vec<Declared>,
}

/// A formula that says nothing.
static NOTHING: Formula = Formula {
    name: String::new(),
    lets: Vec::new(),
    memory: Vec::new(),
    force_body_n: None,
    force_world_n: None,
    torque_body_n_m: None,
    thrust_factor: None,
    rotor_command: Vec::new(),
    attitude_command: None,
    controls: false,
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
    fn numbers<F: FnMut(S)>(&self, f: &mut F) {
        self.value.numbers(f);
    }
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
        self.value.numbers_mut(f);
    }
}

/// What an effect sees, with the values that it names.
struct Scope<'a, S> {
    of: &'a Params<S>,
    sight: Sight<'a, S>,
    /// Empty, and then nothing is allocated, where the formula names no values.
    lets: Vec<S>,
}

impl<S: Real> Scope<'_, S> {
    fn eval(&self, program: &Program) -> S {
        program.eval(|input| match Input::of(input) {
            Input::Variable(i) => list::value(i, &self.sight),
            Input::Parameter(i) => self.of.value[i],
            // As at the start where what is remembered is not known.
            Input::Memory(i) => match self.sight.memory.get(i) {
                Some(now) => *now,
                None => self.of.formula.memory.get(i).map_or(S::zero(), Memory::begun),
            },
            Input::Let(i) => self.lets.get(i).copied().unwrap_or(S::zero()),
        })
    }

    fn each<const K: usize>(&self, programs: &[Program; K]) -> [S; K] {
        core::array::from_fn(|i| self.eval(&programs[i]))
    }
}

impl<S: Real> Params<S> {
    fn scope<'a>(&'a self, sight: Sight<'a, S>) -> Scope<'a, S> {
        let lets = Vec::with_capacity(self.formula.lets.len());
        let mut scope = Scope { of: self, sight, lets };
        for (_, program) in &self.formula.lets {
            let value = scope.eval(program);
            scope.lets.push(value);
        }
        scope
    }

    /// Within forces.
    fn within<'a>(&'a self, view: &'a View<'a, S>) -> Scope<'a, S> {
        self.scope(Sight { view, command: None, dt_s: S::zero(), memory: view.memory })
    }
}

/// What a variable takes from the surroundings.
pub(super) fn reads_of(variable: &str) -> Reads {
    match variable {
        "ground_m" => Reads::GROUND,
        "ceiling_m" => Reads::CEILING,
        "others_m" => Reads::NEIGHBOURS,
        "wind_x" | "wind_y" | "wind_z" | "vx_body" | "vy_body" | "vz_body" => Reads::WIND,
        "normal1" | "normal2" | "normal3" => Reads::NOISE,
        _ => Reads::NOTHING,
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { moved_by_memory: self.formula.pushes_by_memory(), ..Nature::default() }
    }

    /// What the variables read that the formula uses.
    fn reads(&self) -> Reads {
        let read = |op: &Op| match op {
            Op::Input(index) => match Input::of(*index) {
                Input::Variable(i) => reads_of(VARIABLES[i].name),
                _ => Reads::NOTHING,
            },
            _ => Reads::NOTHING,
        };
        // One pass: a single simulated world asks in every step.
        self.formula.programs().flat_map(Program::ops).fold(Reads::NOTHING, |reads, op| reads.or(read(op)))
    }

    fn memory_len(&self, _: f64) -> usize {
        self.formula.memory.len()
    }

    fn controls(&self) -> bool {
        self.formula.controls
    }

    fn start(&self, _: &Command<S>, memory: &mut [S]) {
        for (to, own) in memory.iter_mut().zip(&self.formula.memory) {
            *to = own.begun();
        }
    }

    fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        let formula = self.formula;
        if formula.memory.is_empty() && formula.rotor_command.is_empty() && formula.attitude_command.is_none()
        {
            return;
        }
        let (before, mut next) = (*command, [S::zero(); MAX_MEMORY]);
        let scope = self.scope(Sight { view, command: Some(&before), dt_s, memory: &*memory });
        match command {
            Command::Rotors(speeds) => {
                speeds
                    .iter_mut()
                    .zip(&formula.rotor_command)
                    .for_each(|(to, program)| *to = scope.eval(program));
            }
            Command::Attitude(numbers) => {
                if let Some(programs) = &formula.attitude_command {
                    *numbers = scope.each(programs);
                }
            }
        }
        // All from what was remembered before: none sees what another becomes.
        for (to, own) in next.iter_mut().zip(&formula.memory) {
            *to = scope.eval(&own.next);
        }
        memory.iter_mut().zip(next).for_each(|(to, v)| *to = v);
    }

    fn thrust_gain(&self, view: &View<S>, _: [S; 3]) -> S {
        self.formula.thrust_factor.as_ref().map_or(S::one(), |program| self.within(view).eval(program))
    }

    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let formula = self.formula;
        let pushes = formula.force_body_n.is_some() || formula.force_world_n.is_some();
        if !pushes && formula.torque_body_n_m.is_none() {
            return;
        }
        let scope = self.within(view);
        if let Some(programs) = &formula.force_body_n {
            out.add_body_force(scope.each(programs));
        }
        if let Some(programs) = &formula.force_world_n {
            out.force = vec3::add(out.force, scope.each(programs));
        }
        if let Some(programs) = &formula.torque_body_n_m {
            out.torque = vec3::add(out.torque, scope.each(programs));
        }
    }
}

impl Formula {
    /// Programs of forces, torques and the factor on the thrust.
    fn pushing(&self) -> impl Iterator<Item = &Program> {
        let vectors = [&self.force_body_n, &self.force_world_n, &self.torque_body_n_m];
        vectors.into_iter().flatten().flatten().chain(&self.thrust_factor)
    }

    /// All programs.
    fn programs(&self) -> impl Iterator<Item = &Program> {
        let lets = self.lets.iter().map(|(_, program)| program);
        let once = self.memory.iter().map(|m| &m.next).chain(&self.rotor_command);
        self.pushing().chain(lets).chain(once).chain(self.attitude_command.iter().flatten())
    }

    /// Everything that programs read, also by way of the values that they read.
    fn all_read<'a>(&'a self, programs: impl Iterator<Item = &'a Program>) -> Vec<Input> {
        let mut found: Vec<Input> = Vec::new();
        let add = |found: &mut Vec<Input>, program: &Program| {
            for op in program.ops() {
                if let Op::Input(i) = op {
                    let input = Input::of(*i);
                    if !found.contains(&input) {
                        found.push(input);
                    }
                }
            }
        };
        programs.for_each(|program| add(&mut found, program));
        let mut at = 0;
        while let Some(input) = found.get(at).copied() {
            if let Input::Let(k) = input
                && let Some((_, program)) = self.lets.get(k)
            {
                add(&mut found, program);
            }
            at += 1;
        }
        found
    }

    /// What forces, torques and the factor on the thrust read.
    pub fn read_by_forces(&self) -> Vec<Input> {
        self.all_read(self.pushing())
    }

    /// Whether forces go with what is remembered or commanded.
    fn pushes_by_memory(&self) -> bool {
        let unseen = |input: &Input| match input {
            Input::Memory(_) => true,
            Input::Variable(i) => VARIABLES[*i].name.starts_with("command"),
            _ => false,
        };
        self.read_by_forces().iter().any(unseen)
    }

    /// Whether any program reads the variable called `name`.
    pub fn reads(&self, name: &str) -> bool {
        VARIABLES.iter().position(|v| v.name == name).is_some_and(|i| self.reads_input(Input::Variable(i)))
    }

    /// Whether any program reads it.
    pub fn reads_input(&self, input: Input) -> bool {
        let wanted = |op: &Op| matches!(op, Op::Input(i) if *i == input.index());
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
