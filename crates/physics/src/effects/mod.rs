//! Effects: what acts on a vehicle beyond rigid body, rotors and gravity. One file each; this is the one list of them.
//!
//! A vehicle lists the effects that it has; an effect that is not listed does nothing. During one evaluation of the
//! forces every effect first says how the vehicle is built otherwise than its file says ([`Effect::build`]), then what
//! the air does ([`Effect::air`]), then how each rotor's thrust changes ([`Effect::thrust_gain`]), then what else pushes
//! and turns the body ([`Effect::wrench`]). Once per simulation step, before integration, it may change the command on
//! its way to the motors ([`Effect::command`]) and what surrounds the vehicle ([`Effect::surround`]). What sensors make of
//! the motion is an effect too ([`Effect::measure`], [`Effect::clock`]).
//!
//! Every file also says within which bounds its formula holds ([`Effect::ranges`]), what it reads of the world around
//! ([`Effect::reads`]), what a comparison with flights must know of it ([`Effect::nature`]), and how far its parameters may be off
//! on a carefully built vehicle and how far where the effect is really there (`candidates`): what [`Candidate`]s a search for
//! missing physics has. No other file of the library needs its name.

use super::drone::Drone;
use super::measure::{Clock, Reading};
use super::params::Parameters;
use super::rigid_body::{self, MAX_ROTORS, State, Wrench};
use super::surroundings::{Reads, Surroundings};
use super::{airframe, attitude_response, rotor};
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

pub mod accel_bias;
pub mod actuator_saturation;
pub mod battery_sag;
pub mod blade_flapping;
pub mod candidate;
pub mod ceiling_effect;
pub mod clock_offset;
pub mod com_offset;
pub mod command_delay;
pub mod constant_wind;
pub mod custom;
pub mod disturbance;
pub mod downwash;
pub mod expression;
pub mod ground_effect;
pub mod gust;
pub mod gyro_bias;
pub mod gyro_scale;
pub mod inflow;
pub mod linear_drag;
pub mod motor_lag;
pub mod mount;
pub mod network;
pub mod payload;
pub mod quadratic_drag;
pub mod rotor_drag;
pub mod rotor_inertia;
pub mod rotor_tilt;
pub mod sensor_offset;
pub mod slung_payload;
pub mod thrust_curve;
pub mod thrust_fade;
pub mod thrust_scale;
pub mod torque_scale;
pub mod translational_lift;
pub mod turbulence;
pub mod weak_rotor;
pub mod world_tilt;
pub mod wrong_inertia;
pub mod wrong_mass;

pub use candidate::{
    Answer, Area, Bounds, Candidate, Filed, Freedom, FromLog, Group, Nature, Needs, Relative, Scale, Sign,
};
pub use custom::{RegisterError, kinds, register};

/// What an effect may read.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, S> {
    /// Mass properties, as built by the effects.
    pub body: &'a rigid_body::Params<S>,
    /// Rotors, as built by the effects.
    pub airframe: &'a airframe::Params<S>,
    /// State of the vehicle.
    pub state: &'a State<S>,
    /// The world around it; `wind_m_s` already holds what the effects' `air` added.
    pub surroundings: &'a Surroundings<'a, S>,
    /// Collective thrust of the abstracted model, N; `None` for a vehicle whose state has rotor speeds.
    pub collective_n: Option<S>,
    /// What the effect that looks remembers, as [`Effect::command`] left it in this step: [`Effect::memory_len`] numbers. Empty
    /// where nothing is remembered: in `command` itself, whose memory is its argument, and in comparisons with logs; see
    /// [`View::remembered`].
    pub memory: &'a [S],
}

impl<S: Real> View<'_, S> {
    /// Number `i` of what the effect remembers; zero where there is none.
    #[inline(always)]
    pub fn remembered(&self, i: usize) -> S {
        self.memory.get(i).copied().unwrap_or(S::zero())
    }

    /// Rotor speeds, rad/s. In the abstracted model: those at which every rotor has an equal share of the thrust, which
    /// is held above 1 µN so that the slope stays finite.
    #[inline(always)]
    pub fn rotor_vel(&self) -> [S; MAX_ROTORS] {
        let Some(thrust) = self.collective_n else { return self.state.rotor_vel };
        let share = thrust.max(S::lit(1e-6)) / S::lit(self.airframe.n_rotors.max(1) as f64);
        let mut out = [S::zero(); MAX_ROTORS];
        for i in 0..self.airframe.n_rotors {
            out[i] = rotor::speed_for_thrust(self.airframe.rotors[i].thrust_curve, share);
        }
        out
    }

    /// Velocity of the centre of mass through the air, m/s, body.
    #[inline(always)]
    pub fn air_velocity(&self) -> [S; 3] {
        let relative = vec3::sub(self.state.vel, self.surroundings.wind_m_s);
        quat::rotate_inverse(self.state.quat, relative)
    }

    /// Velocity of the hub of rotor `i` through the air for that of the centre of mass, m/s, body: along the rotor's
    /// axis, and across it.
    #[inline(always)]
    pub fn hub_velocity(&self, i: usize, air_velocity: [S; 3]) -> (S, [S; 3]) {
        let r = &self.airframe.rotors[i];
        let hub = vec3::add(air_velocity, vec3::cross(self.state.ang_vel, r.position_m));
        let along = vec3::dot(hub, r.axis);
        (along, vec3::sub(hub, vec3::scale(r.axis, along)))
    }
}

/// The parts of a vehicle that effects may build otherwise than its file says. The on-board controller is none of them:
/// it goes on believing in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts<S> {
    /// Mass properties.
    pub body: rigid_body::Params<S>,
    /// Rotors.
    pub airframe: airframe::Params<S>,
    /// The abstracted attitude response, where the vehicle flies by it.
    pub response: Option<attitude_response::Params<S>>,
    /// Where the thrust of the abstracted model acts, m from the centre of mass, body; the origin as filed.
    pub thrust_point_m: [S; 3],
    /// True thrust over a collective thrust that was measured by the filed curves.
    pub thrust_factor: S,
    /// Of a collective thrust T that was measured by the filed curves: share k of √(T T_h) − T that is added, and the thrust
    /// T_h of all rotors at which that is nothing, N; see [`thrust_curve`].
    pub thrust_bend: [S; 2],
}

impl<S: Real> Parts<S> {
    /// True thrust (N) where the filed curves say `thrust_n`.
    #[inline(always)]
    pub fn true_thrust(&self, thrust_n: S) -> S {
        let [share, hover_n] = self.thrust_bend;
        // The root has no slope at zero.
        let root = (thrust_n * hover_n).max(S::lit(1e-12)).sqrt();
        self.thrust_factor * (thrust_n + share * (root - thrust_n))
    }

    /// Moves the centre of mass by `offset_m` (body): everything else is then seen from there.
    #[inline(always)]
    pub fn shift_com(&mut self, offset_m: [S; 3]) {
        for i in 0..self.airframe.n_rotors {
            let position = &mut self.airframe.rotors[i].position_m;
            *position = vec3::sub(*position, offset_m);
        }
        self.thrust_point_m = vec3::sub(self.thrust_point_m, offset_m);
    }
}

/// Adds the force of rotor `i` (N, body), which acts at its hub, to a wrench.
#[inline(always)]
fn add_hub_force<S: Real>(view: &View<S>, i: usize, force: [S; 3], out: &mut Wrench<S>) {
    out.add_body_force(force);
    out.torque = vec3::add(out.torque, vec3::cross(view.airframe.rotors[i].position_m, force));
}

/// What goes to the motors, or to the abstracted attitude response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command<S> {
    /// Commanded rotor speeds, rad/s.
    Rotors([S; MAX_ROTORS]),
    /// Roll, pitch, yaw (rad) and collective thrust (N).
    Attitude([S; 4]),
}

/// One physical effect. Every hook does nothing unless the effect says otherwise.
pub trait Effect<S: Real> {
    /// What a comparison of flights with a model must know of it.
    fn nature(&self) -> Nature {
        Nature::default()
    }
    /// Bounds within which the formula holds, by parameter; bounds of an array hold for each of its numbers. Parameters that
    /// are not named may be any finite number.
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        &[]
    }
    /// Whether [`Effect::build`] does anything.
    fn builds(&self) -> bool {
        false
    }
    /// Changes what the vehicle is built of.
    fn build(&self, parts: &mut Parts<S>) {
        let _ = parts;
    }
    /// Mass that the vehicle carries without its being fixed to it, kg.
    fn carried_kg(&self) -> S {
        S::zero()
    }
    /// Numbers of memory that [`Effect::command`] keeps between steps of `dt_s` seconds.
    fn memory_len(&self, dt_s: f64) -> usize {
        let _ = dt_s;
        0
    }
    /// What any hook of this effect reads of its [`Surroundings`]. What is not declared here nobody need fill in.
    fn reads(&self) -> Reads {
        Reads::NOTHING
    }
    /// Adds the wind of this effect, m/s, world.
    fn air(&self, view: &View<S>) -> [S; 3] {
        let _ = view;
        [S::zero(); 3]
    }
    /// Factor on the thrust of a rotor whose hub is at `hub_m` (body); the abstracted model asks once, for the origin.
    fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
        let _ = (view, hub_m);
        S::one()
    }
    /// Adds force and torque.
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let _ = (view, out);
    }
    /// Fills the memory, zero until then, at a reset that starts with `command` in force.
    fn start(&self, command: &Command<S>, memory: &mut [S]) {
        let _ = (command, memory);
    }
    /// Changes the command, once per step of `dt_s` seconds. `memory` has [`Effect::memory_len`] numbers, zero after a
    /// reset but for what [`Effect::start`] wrote.
    fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        let _ = (view, dt_s, command, memory);
    }
    /// Voltage of a battery under the load of this step, V, with `command` as it reaches it and `memory` as it is before
    /// [`Effect::command`].
    fn battery_v(&self, view: &View<S>, command: &Command<S>, memory: &[S]) -> Option<S> {
        let _ = (view, command, memory);
        None
    }
    /// Whether [`Effect::command`] takes the place of the on-board controller: it is called in its stead, with a command of zero, and not again
    /// on the way to the motors. Of several the first does.
    fn controls(&self) -> bool {
        false
    }
    /// How late commands arrive, s, where that is all that [`Effect::command`] does: who knows when commands were sent then needs no
    /// memory of them.
    fn delay_s(&self) -> Option<S> {
        None
    }
    /// Adds to the surroundings what the effect's memory holds (a load on a cable), once per step after
    /// [`Effect::command`].
    fn surround(&self, memory: &[S], surroundings: &mut Surroundings<S>) {
        let _ = (memory, surroundings);
    }
    /// Changes what sensors read.
    fn measure(&self, reading: &mut Reading<S>) {
        let _ = reading;
    }
    /// How late sensors' clocks are.
    fn clock(&self) -> Clock<S> {
        Clock::zero()
    }
}

macro_rules! effects {
    ($($(#[$meta:meta])* $module:ident => $variant:ident,)*) => {
        /// Any effect, with its parameters.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum AnyEffect<S> {
            $($(#[$meta])* $variant($module::Params<S>),)*
            /// Of another crate.
            Custom(custom::Params<S>),
        }

        /// Names of the effects of this library, as vehicle files spell them.
        pub const KINDS: &[&str] = &[$(stringify!($module)),*];

        impl AnyEffect<f64> {
            /// The effect called `kind` with its default parameters, which leave it without influence.
            pub fn by_kind(kind: &str) -> Option<Self> {
                match kind {
                    $(stringify!($module) => Some(Self::$variant($module::Params::default())),)*
                    _ => custom::find(kind).map(|found| Self::Custom(custom::Params::new(found))),
                }
            }
        }

        /// What may be missing in the model of `drone`, from all effects; see [`Candidate`].
        pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
            let mut out = Vec::new();
            $(out.extend($module::candidates(drone));)*
            out.extend(custom::candidates(drone));
            out
        }

        impl<S: Real> AnyEffect<S> {
            /// Name of the effect, as vehicle files spell it.
            pub fn kind(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => stringify!($module),)*
                    Self::Custom(p) => p.kind(),
                }
            }
        }

        impl<S: Real> Effect<S> for AnyEffect<S> {
            fn nature(&self) -> Nature {
                match self { $(Self::$variant(p) => Effect::<S>::nature(p),)* Self::Custom(p) => Effect::<S>::nature(p) }
            }
            fn ranges(&self) -> &'static [(&'static str, Bounds)] {
                match self { $(Self::$variant(p) => Effect::<S>::ranges(p),)* Self::Custom(p) => Effect::<S>::ranges(p) }
            }
            fn builds(&self) -> bool {
                match self { $(Self::$variant(p) => Effect::<S>::builds(p),)* Self::Custom(p) => Effect::<S>::builds(p) }
            }
            #[inline(always)]
            fn build(&self, parts: &mut Parts<S>) {
                match self { $(Self::$variant(p) => p.build(parts),)* Self::Custom(p) => p.build(parts) }
            }
            fn reads(&self) -> Reads {
                match self { $(Self::$variant(p) => Effect::<S>::reads(p),)* Self::Custom(p) => Effect::<S>::reads(p) }
            }
            fn carried_kg(&self) -> S {
                match self { $(Self::$variant(p) => p.carried_kg(),)* Self::Custom(p) => p.carried_kg() }
            }
            fn memory_len(&self, dt_s: f64) -> usize {
                match self { $(Self::$variant(p) => p.memory_len(dt_s),)* Self::Custom(p) => p.memory_len(dt_s) }
            }
            #[inline(always)]
            fn air(&self, view: &View<S>) -> [S; 3] {
                match self { $(Self::$variant(p) => p.air(view),)* Self::Custom(p) => p.air(view) }
            }
            #[inline(always)]
            fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
                match self { $(Self::$variant(p) => p.thrust_gain(view, hub_m),)* Self::Custom(p) => p.thrust_gain(view, hub_m) }
            }
            #[inline(always)]
            fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
                match self { $(Self::$variant(p) => p.wrench(view, out),)* Self::Custom(p) => p.wrench(view, out) }
            }
            #[inline(always)]
            fn start(&self, command: &Command<S>, memory: &mut [S]) {
                match self { $(Self::$variant(p) => p.start(command, memory),)* Self::Custom(p) => p.start(command, memory) }
            }
            #[inline(always)]
            fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
                match self { $(Self::$variant(p) => p.command(view, dt_s, command, memory),)* Self::Custom(p) => p.command(view, dt_s, command, memory) }
            }
            fn battery_v(&self, view: &View<S>, command: &Command<S>, memory: &[S]) -> Option<S> {
                match self {
                    $(Self::$variant(p) => p.battery_v(view, command, memory),)*
                    Self::Custom(p) => p.battery_v(view, command, memory),
                }
            }
            fn controls(&self) -> bool {
                match self { $(Self::$variant(p) => Effect::<S>::controls(p),)* Self::Custom(p) => Effect::<S>::controls(p) }
            }
            fn delay_s(&self) -> Option<S> {
                match self { $(Self::$variant(p) => Effect::<S>::delay_s(p),)* Self::Custom(p) => Effect::<S>::delay_s(p) }
            }
            #[inline(always)]
            fn surround(&self, memory: &[S], surroundings: &mut Surroundings<S>) {
                match self { $(Self::$variant(p) => p.surround(memory, surroundings),)* Self::Custom(p) => p.surround(memory, surroundings) }
            }
            #[inline(always)]
            fn measure(&self, reading: &mut Reading<S>) {
                match self { $(Self::$variant(p) => p.measure(reading),)* Self::Custom(p) => p.measure(reading) }
            }
            #[inline(always)]
            fn clock(&self) -> Clock<S> {
                match self { $(Self::$variant(p) => p.clock(),)* Self::Custom(p) => p.clock() }
            }
        }

        impl<S: Real> Parameters<S> for AnyEffect<S> {
            type Over<T: Real> = AnyEffect<T>;
            fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> AnyEffect<T> {
                match self { $(Self::$variant(p) => AnyEffect::$variant(p.map(f)),)* Self::Custom(p) => AnyEffect::Custom(p.map(f)) }
            }
            fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
                match self { $(Self::$variant(p) => p.visit(prefix, f),)* Self::Custom(p) => p.visit(prefix, f) }
            }
            fn numbers<F: FnMut(S)>(&self, f: &mut F) {
                match self { $(Self::$variant(p) => p.numbers(f),)* Self::Custom(p) => p.numbers(f) }
            }
            fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
                match self { $(Self::$variant(p) => p.numbers_mut(f),)* Self::Custom(p) => p.numbers_mut(f) }
            }
        }
    };
}

effects! {
    /// Force against the velocity relative to the air.
    linear_drag => LinearDrag,
    /// Wind that does not change.
    constant_wind => ConstantWind,
    /// Constant force and torque.
    disturbance => Disturbance,
    /// More thrust near the ground.
    ground_effect => GroundEffect,
    /// Push from the air that other vehicles throw down.
    downwash => Downwash,
    /// Voltage that falls with charge and current.
    battery_sag => BatterySag,
    /// Commands that arrive late.
    command_delay => CommandDelay,
    /// Force against the velocity relative to the air, growing with its square.
    quadratic_drag => QuadraticDrag,
    /// Drag of every rotor in its own plane, growing with its speed.
    rotor_drag => RotorDrag,
    /// Moment of blades that flap in a flow from the side.
    blade_flapping => BladeFlapping,
    /// Less thrust the faster a rotor climbs through the air.
    inflow => Inflow,
    /// More thrust in a flow from the side.
    translational_lift => TranslationalLift,
    /// Wind that swings as a sine.
    gust => Gust,
    /// Wind that changes at random.
    turbulence => Turbulence,
    /// Mass fixed to the vehicle.
    payload => Payload,
    /// Mass that hangs from the vehicle on a cable.
    slung_payload => SlungPayload,
    /// Centre of mass elsewhere than filed.
    com_offset => ComOffset,
    /// All rotors give more or less thrust than filed.
    thrust_scale => ThrustScale,
    /// Each rotor gives more or less thrust and torque than filed.
    weak_rotor => WeakRotor,
    /// All rotors meet more or less torque than filed.
    torque_scale => TorqueScale,
    /// Motors slower or faster than filed.
    motor_lag => MotorLag,
    /// Motors that cannot turn faster than a limit.
    actuator_saturation => ActuatorSaturation,
    /// Thrust that falls with time.
    thrust_fade => ThrustFade,
    /// A vehicle heavier or lighter than filed.
    wrong_mass => WrongMass,
    /// Inertia other than filed, axis by axis.
    wrong_inertia => WrongInertia,
    /// Rotors with more or less inertia than filed.
    rotor_inertia => RotorInertia,
    /// A thrust curve of another shape through the same hover.
    thrust_curve => ThrustCurve,
    /// Rotors whose axes lean.
    rotor_tilt => RotorTilt,
    /// More thrust under a ceiling.
    ceiling_effect => CeilingEffect,
    /// A tracked point beside the centre of mass.
    sensor_offset => SensorOffset,
    /// Sensors mounted askew.
    mount => Mount,
    /// A motion capture whose world is tilted.
    world_tilt => WorldTilt,
    /// A gyroscope that reads in another proportion.
    gyro_scale => GyroScale,
    /// A gyroscope that reads a rate at rest.
    gyro_bias => GyroBias,
    /// An accelerometer that reads a constant too much.
    accel_bias => AccelBias,
    /// Sensors whose samples are stamped late.
    clock_offset => ClockOffset,
    /// What a user wrote as expressions in the vehicle file.
    expression => Expression,
    /// What a small neural network says, whose file lies beside the vehicle file.
    network => Network,
}

/// The nature of the effect called `kind`; the ordinary one for names that are not known.
pub fn nature(kind: &str) -> Nature {
    AnyEffect::by_kind(kind).map(|e| e.nature()).unwrap_or_default()
}

impl<S: Real> AnyEffect<S> {
    /// Name of the effect within its vehicle, with which names of parameters begin after `effect.`: its kind, and for an
    /// expression `expression.NAME`, for a network `network.NAME`.
    pub fn label(&self) -> String {
        match self {
            Self::Expression(p) if !p.formula.name.is_empty() => format!("expression.{}", p.formula.name),
            Self::Network(p) if !p.network.name.is_empty() => format!("network.{}", p.network.name),
            other => other.kind().into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drone::{Drone, Dynamics};
    use crate::sample::quad;
    use crate::surroundings::{Neighbour, Surroundings};
    use propwash_trace::dual::Dual;

    #[test]
    fn every_effect_does_nothing_at_its_defaults() {
        let response = Dynamics::AttitudeResponse(attitude_response::Params {
            thrust_offset_n: 0.1,
            thrust_scale: 1.1,
            thrust_rate_per_s: 12.0,
            angle_gain_per_s2: [-400.0; 3],
            rate_gain_per_s: [-30.0; 3],
            command_gain_per_s2: [400.0; 3],
            thrust_dynamics: true,
        });
        let rotors = Command::Rotors([400.0; MAX_ROTORS]);
        let attitude = Command::Attitude([0.1, -0.2, 0.3, 9.0]);
        for (dynamics, sent) in [(Dynamics::Rotors, rotors), (response, attitude)] {
            let plain = Drone { dynamics, ..quad(vec![]) };
            let mut state =
                State { rotor_vel: plain.hover_rotor_vel(), vel: [1.0, 2.0, 3.0], ..State::rest() };
            state.quat = propwash_trace::math::euler::to_quat([0.2, -0.3, 0.4]);
            state.ang_vel = [0.3, 0.2, 0.1];
            state.thrust = 8.0;
            let near = Surroundings {
                ground_distance_m: 0.1,
                ceiling_distance_m: 0.15,
                time_s: 0.2,
                wind_m_s: [0.5, 0.0, 0.0],
                ..Surroundings::calm()
            };
            for kind in KINDS {
                let drone = Drone { dynamics, ..quad(vec![AnyEffect::by_kind(kind).unwrap()]) };
                assert_eq!(drone.effects[0].kind(), *kind);
                let mut command = sent;
                let mut memory = vec![0.0; drone.memory_len(0.002)];
                for _ in 0..3 {
                    command = sent;
                    drone.transmit(&state, &mut { near }, (0.002, 0.002), &mut command, &mut memory);
                }
                assert_eq!(command, sent, "{kind}");
                assert_eq!(
                    drone.rate(&state, &command, &near),
                    plain.rate(&state, &command, &near),
                    "{kind}"
                );
                assert_eq!(drone.hover_rotor_vel(), plain.hover_rotor_vel(), "{kind}");
                let rate = plain.rate(&state, &command, &near);
                assert_eq!(drone.read(&state, &rate), plain.read(&state, &rate), "{kind}");
                assert_eq!(drone.clock(), plain.clock(), "{kind}");
            }
        }
        assert_eq!(AnyEffect::by_kind("propwash"), None);
    }

    #[test]
    fn what_effects_build_reaches_the_other_effects_in_order() {
        // 0.5 kg at 0.3 m ahead: the centre of mass of 1.5 kg lies at 0.1 m; the second one counts from there.
        let first = payload::Params { mass_kg: 0.5, position_m: [0.3, 0.0, 0.0] };
        let then = com_offset::Params { offset_m: [0.0, 0.01, 0.0] };
        let parts = quad(vec![AnyEffect::Payload(first), AnyEffect::ComOffset(then)]).parts();
        let [x, y, _] = parts.airframe.rotors[0].position_m;
        assert!((x - 0.0).abs() < 1e-15 && (y + 0.11).abs() < 1e-15, "{x} {y}");
        assert!((parts.thrust_point_m[0] + 0.1).abs() < 1e-15);
        // The battery sees the thrust of the weak rotors.
        let battery = battery_sag::Params {
            full_v: 12.0,
            nominal_v: 12.0,
            resistance_ohm: 0.0,
            drop_v_per_a_s: 0.01,
            efficiency: 0.5,
            compensated: 0.0,
        };
        let charge = |factor: f64| {
            let scale = AnyEffect::ThrustScale(thrust_scale::Params { factor });
            let drone = quad(vec![AnyEffect::BatterySag(battery), scale]);
            let state = State { rotor_vel: quad(vec![]).hover_rotor_vel(), ..State::rest() };
            let mut memory = vec![0.0];
            let mut command = Command::Rotors([500.0; MAX_ROTORS]);
            drone.transmit(&state, &mut Surroundings::calm(), (0.01, 0.01), &mut command, &mut memory);
            memory[0]
        };
        assert!((charge(0.64) / charge(1.0) - 0.64f64.powf(1.5)).abs() < 1e-12);
    }

    #[test]
    fn every_effect_has_finite_derivatives_at_rest() {
        type D = Dual<f64, 3>;
        for kind in KINDS {
            let mut effect = AnyEffect::by_kind(kind).unwrap();
            effect.visit("", &mut |_, v| *v = if *v == 0.0 { 0.1 } else { *v * 1.1 });
            let drone = quad(vec![effect]).map(&mut D::lit);
            let mut state = State::<D>::rest();
            for i in 0..3 {
                state.vel[i] = D::input(0.0, i);
            }
            let rate = drone.rate(&state, &Command::Rotors([D::lit(0.0); MAX_ROTORS]), &Surroundings::calm());
            for a in rate.acc.iter().chain(&rate.ang_acc).chain(&rate.rotor_acc) {
                assert!(a.value.is_finite() && a.partials.iter().all(|p| p.is_finite()), "{kind}: {a:?}");
            }
        }
    }

    /// A moving state near the ground, in wind, and the rate of a vehicle whose one effect has its parameter number
    /// `which` at `value`.
    fn rate_at<S: Real>(kind: &str, which: usize, value: S) -> crate::rigid_body::Rate<S> {
        let mut effect = AnyEffect::by_kind(kind).unwrap();
        effect.visit("", &mut |_, v| *v = moved(*v));
        let drag =
            linear_drag::Params { drag_n_s_per_m: [[0.1, 0.02, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]] };
        let mut drone = quad(vec![effect, AnyEffect::LinearDrag(drag)]).map(&mut S::lit);
        let mut index = 0;
        drone.effects[0].visit("", &mut |_, v| {
            if index == which {
                *v = value;
            }
            index += 1;
        });
        let list = |a: [f64; 3]| a.map(S::lit);
        let mut state = State::<S>::rest();
        state.vel = list([1.0, -2.0, 1.5]);
        state.ang_vel = list([0.3, -0.2, 0.5]);
        state.quat = propwash_trace::math::euler::to_quat(list([0.2, -0.3, 0.4]));
        let speeds = [480.0, 500.0, 520.0, 470.0, 0.0, 0.0, 0.0, 0.0].map(S::lit);
        state.rotor_vel = speeds;
        let near = Surroundings {
            ground_distance_m: S::lit(0.2),
            ceiling_distance_m: S::lit(0.15),
            time_s: S::lit(0.13),
            wind_m_s: list([0.5, 0.2, -0.1]),
            ..Surroundings::calm()
        };
        drone.rate(&state, &Command::Rotors([S::lit(510.0); MAX_ROTORS]), &near)
    }

    /// A parameter away from its default.
    fn moved(default: f64) -> f64 {
        if default == 0.0 { 0.05 } else { 1.1 * default }
    }

    #[test]
    fn the_derivatives_of_the_rate_by_every_parameter_are_exact() {
        type D = Dual<f64, 1>;
        let mut counted = 0;
        for kind in KINDS {
            let mut values = Vec::new();
            AnyEffect::by_kind(kind).unwrap().visit("", &mut |_, v| values.push(moved(*v)));
            for (which, value) in values.into_iter().enumerate() {
                let step = 1e-5 * value;
                let (up, down) = (rate_at(kind, which, value + step), rate_at(kind, which, value - step));
                let exact = rate_at::<D>(kind, which, D::input(value, 0));
                let pick = |r: &crate::rigid_body::Rate<f64>| [&r.acc[..], &r.ang_acc, &r.rotor_acc].concat();
                let (up, down) = (pick(&up), pick(&down));
                let exact: Vec<D> = [&exact.acc[..], &exact.ang_acc, &exact.rotor_acc].concat();
                for i in 0..exact.len() {
                    let difference = (up[i] - down[i]) / (2.0 * step);
                    let slope = exact[i].partials[0];
                    let near = 1e-6 * slope.abs() + 1e-6 * exact[i].value.abs().max(1.0) / value.min(1.0);
                    assert!((slope - difference).abs() < near, "{kind} {which} {i}: {slope} {difference}");
                    counted += usize::from(slope != 0.0);
                }
            }
        }
        assert!(counted > 100, "{counted}");
    }

    /// Everything that a vehicle with this one effect does in a moment of a busy flight, in these surroundings.
    fn moment(effect: AnyEffect<f64>, mut around: Surroundings<f64>) -> Vec<f64> {
        let drone = quad(vec![effect]);
        let mut state = State { vel: [1.0, -2.0, 1.5], ang_vel: [0.3, -0.2, 0.5], ..State::rest() };
        state.quat = propwash_trace::math::euler::to_quat([0.2, -0.3, 0.4]);
        state.rotor_vel = [480.0, 500.0, 520.0, 470.0, 0.0, 0.0, 0.0, 0.0];
        let mut memory = vec![0.0; drone.memory_len(0.002)];
        let mut command = Command::Rotors([510.0; MAX_ROTORS]);
        // Memories that begin in the first step show in the second what moves them.
        for _ in 0..2 {
            drone.transmit(&state, &mut { around }, (0.002, 0.002), &mut command, &mut memory);
        }
        drone.transmit(&state, &mut around, (0.002, 0.002), &mut command, &mut memory);
        let rate = drone.rate(&state, &command, &around);
        [&rate.acc[..], &rate.ang_acc, &rate.rotor_acc, &memory].concat()
    }

    #[test]
    fn every_effect_reads_exactly_what_it_declares() {
        let above = Neighbour { pos: [0.0, 0.0, 0.5], vel: [0.0; 3], weight_n: 9.81, disc_radius_m: 0.12 };
        let near = Surroundings {
            ground_distance_m: 0.2,
            ceiling_distance_m: 0.15,
            normals: [0.1; 6],
            ..Surroundings::calm()
        };
        for kind in KINDS {
            let mut effect = AnyEffect::by_kind(kind).unwrap();
            effect.visit("", &mut |_, v| *v = moved(*v));
            let plain = moment(effect, near);
            let changes = |around: Surroundings<f64>| moment(effect, around) != plain;
            let found = Reads {
                ground: changes(Surroundings { ground_distance_m: 0.3, ..near }),
                ceiling: changes(Surroundings { ceiling_distance_m: 0.25, ..near }),
                neighbours: changes(Surroundings { neighbours: &[above], ..near }),
                wind: changes(Surroundings { wind_m_s: [0.5, 0.2, -0.1], ..near }),
                noise: changes(Surroundings { normals: [0.5, 0.2, -0.1, 0.3, 0.4, 0.5], ..near }),
            };
            assert_eq!(Effect::<f64>::reads(&effect), found, "{kind}");
        }
    }

    /// What a vehicle does and reads in one moment of a busy flight: rate, sensors, command at the motors, clocks.
    fn behaviour(effects: Vec<AnyEffect<f64>>) -> Vec<f64> {
        let drone = quad(effects);
        let mut state = State::rest();
        state.pos = [0.3, -0.2, 0.1];
        state.vel = [1.0, -2.0, 1.5];
        state.ang_vel = [0.3, -0.2, 0.5];
        state.quat = propwash_trace::math::euler::to_quat([0.2, -0.3, 0.4]);
        state.rotor_vel = [480.0, 500.0, 520.0, 470.0, 0.0, 0.0, 0.0, 0.0];
        let above = Neighbour { pos: [0.3, -0.2, 0.6], vel: [0.0; 3], weight_n: 9.81, disc_radius_m: 0.12 };
        let mut around = Surroundings {
            ground_distance_m: 0.2,
            ceiling_distance_m: 0.15,
            time_s: 0.13,
            wind_m_s: [0.5, 0.2, -0.1],
            battery_v: 0.9,
            neighbours: &[above],
            ..Surroundings::calm()
        };
        let mut memory = vec![0.0; drone.memory_len(0.002)];
        let mut command = Command::Rotors([400.0; MAX_ROTORS]);
        drone.start(&command, |effect| effect.memory_len(0.002), &mut memory);
        for faster in [400.0, 900.0] {
            command = Command::Rotors([faster, 300.0, faster, 300.0, 0.0, 0.0, 0.0, 0.0]);
            drone.transmit(&state, &mut around, (0.002, 0.002), &mut command, &mut memory);
        }
        let rate = drone.rate(&state, &command, &around);
        let (reading, clock) = (drone.read(&state, &rate), drone.clock());
        let Command::Rotors(speeds) = command else { panic!("rotor command expected") };
        [
            &rate.acc[..],
            &rate.ang_acc,
            &rate.rotor_acc,
            &speeds,
            &reading.pos,
            &reading.quat,
            &reading.vel,
            &reading.gyro,
            &reading.accel,
            &[clock.pose_s, clock.gyro_s, clock.accel_s, clock.inputs_s],
        ]
        .concat()
    }

    /// The effect of a candidate with its presets and with all freedoms but number `but` moved by their slabs.
    fn opened(candidate: &Candidate, but: Option<usize>) -> AnyEffect<f64> {
        let mut effect = AnyEffect::by_kind(candidate.kind).unwrap();
        let mut missing: Vec<&str> = candidate.freedoms.iter().map(|f| f.name.as_str()).collect();
        missing.extend(candidate.preset.iter().map(|(name, _)| name.as_str()));
        effect.visit("", &mut |name, value| {
            let name = name.trim_start_matches('.');
            missing.retain(|m| *m != name);
            // A limit far above every motor: moved from the largest speed of the flight instead.
            if candidate.kind == "actuator_saturation" {
                *value = 900.0;
            }
            if let Some((_, preset)) = candidate.preset.iter().find(|(n, _)| n == name) {
                *value = *preset;
            }
            for (i, freedom) in candidate.freedoms.iter().enumerate() {
                if freedom.name == name && Some(i) != but {
                    *value += if freedom.sign == Sign::Down { -freedom.slab } else { freedom.slab };
                }
            }
        });
        assert!(missing.is_empty(), "{} has no {missing:?}", candidate.kind);
        effect
    }

    #[test]
    fn every_candidate_names_parameters_that_change_what_the_vehicle_does_or_reads() {
        let drag =
            linear_drag::Params { drag_n_s_per_m: [[0.1, 0.02, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]] };
        let hubs = AnyEffect::RotorDrag(rotor_drag::Params { drag_n_s2_per_rad_m: 1e-4 });
        let all = candidates(&quad(vec![]));
        for candidate in &all {
            // Winds act through drag, and a centre of mass too high through forces across at the hubs.
            let flown = |but: Option<usize>| {
                behaviour(vec![opened(candidate, but), AnyEffect::LinearDrag(drag), hubs])
            };
            let open = flown(None);
            assert!(open.iter().all(|v| v.is_finite()), "{}", candidate.id);
            assert!(!candidate.freedoms.is_empty() && !candidate.title.is_empty(), "{}", candidate.id);
            assert!(candidate.id.split('.').next() == Some(candidate.kind), "{}", candidate.id);
            for (i, freedom) in candidate.freedoms.iter().enumerate() {
                let (id, name) = (&candidate.id, &freedom.name);
                assert!(freedom.slab > freedom.spike && freedom.spike >= 0.0, "{id} {name}");
                assert!(flown(Some(i)) != open, "{id}: {name} changes nothing");
            }
        }
        // What sensors do moves nothing: rate and command, the first 22 numbers, stay.
        let still = behaviour(vec![]);
        for candidate in all.iter().filter(|c| c.area == Area::Measurement) {
            let read = behaviour(vec![opened(candidate, None)]);
            assert!(read[..22] == still[..22] && read[22..] != still[22..], "{}", candidate.id);
        }
        let ids: std::collections::BTreeSet<&str> = all.iter().map(|c| c.id.as_str()).collect();
        assert_eq!(ids.len(), all.len(), "two candidates of one name");
        for kind in KINDS {
            let none = ["disturbance", "turbulence", "expression", "network"].contains(kind);
            assert_eq!(all.iter().any(|c| c.kind == *kind), !none, "{kind}");
        }
    }
}
