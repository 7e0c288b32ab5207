//! Effects: what acts on a vehicle beyond rigid body, rotors and gravity. One file each; this is the one list of them.
//!
//! A vehicle lists the effects that it has; an effect that is not listed does nothing. During one evaluation of the
//! forces every effect first says what the air does ([`Effect::air`]), then how each rotor's thrust changes
//! ([`Effect::thrust_gain`]), then what else pushes and turns the body ([`Effect::wrench`]). Once per simulation step,
//! before integration, it may change the command on its way to the motors ([`Effect::command`]).

use super::airframe;
use super::params::Parameters;
use super::rigid_body::{self, MAX_ROTORS, State, Wrench};
use super::surroundings::Surroundings;
use crate::scalar::Real;

pub mod battery_sag;
pub mod command_delay;
pub mod constant_wind;
pub mod disturbance;
pub mod downwash;
pub mod ground_effect;
pub mod linear_drag;

/// What an effect may read.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, S> {
    /// Mass properties.
    pub body: &'a rigid_body::Params<S>,
    /// Rotors.
    pub airframe: &'a airframe::Params<S>,
    /// State of the vehicle.
    pub state: &'a State<S>,
    /// The world around it; `wind_m_s` already holds what the effects' `air` added.
    pub surroundings: &'a Surroundings<'a, S>,
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
    /// Numbers of memory that [`Effect::command`] keeps between steps of `dt_s` seconds.
    fn memory_len(&self, dt_s: f64) -> usize {
        let _ = dt_s;
        0
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
    /// Changes the command, once per step of `dt_s` seconds. `memory` has [`Effect::memory_len`] numbers, zero after a
    /// reset.
    fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        let _ = (view, dt_s, command, memory);
    }
}

macro_rules! effects {
    ($($(#[$meta:meta])* $module:ident => $variant:ident,)*) => {
        /// Any effect, with its parameters.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum AnyEffect<S> {
            $($(#[$meta])* $variant($module::Params<S>),)*
        }

        /// Names of all effects, as vehicle files spell them.
        pub const KINDS: &[&str] = &[$(stringify!($module)),*];

        impl AnyEffect<f64> {
            /// The effect called `kind` with its default parameters, which leave it without influence.
            pub fn by_kind(kind: &str) -> Option<Self> {
                match kind {
                    $(stringify!($module) => Some(Self::$variant($module::Params::default())),)*
                    _ => None,
                }
            }
        }

        impl<S: Real> AnyEffect<S> {
            /// Name of the effect, as vehicle files spell it.
            pub fn kind(&self) -> &'static str {
                match self { $(Self::$variant(_) => stringify!($module),)* }
            }
        }

        impl<S: Real> Effect<S> for AnyEffect<S> {
            fn memory_len(&self, dt_s: f64) -> usize {
                match self { $(Self::$variant(p) => p.memory_len(dt_s),)* }
            }
            #[inline(always)]
            fn air(&self, view: &View<S>) -> [S; 3] {
                match self { $(Self::$variant(p) => p.air(view),)* }
            }
            #[inline(always)]
            fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
                match self { $(Self::$variant(p) => p.thrust_gain(view, hub_m),)* }
            }
            #[inline(always)]
            fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
                match self { $(Self::$variant(p) => p.wrench(view, out),)* }
            }
            #[inline(always)]
            fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
                match self { $(Self::$variant(p) => p.command(view, dt_s, command, memory),)* }
            }
        }

        impl<S: Real> Parameters<S> for AnyEffect<S> {
            type Over<T: Real> = AnyEffect<T>;
            fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> AnyEffect<T> {
                match self { $(Self::$variant(p) => AnyEffect::$variant(p.map(f)),)* }
            }
            fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
                match self { $(Self::$variant(p) => p.visit(prefix, f),)* }
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sample::quad;
    use crate::physics::surroundings::Surroundings;

    #[test]
    fn every_effect_does_nothing_at_its_defaults() {
        let plain = quad(vec![]);
        let mut state = State { rotor_vel: plain.hover_rotor_vel(), vel: [1.0, 2.0, 3.0], ..State::rest() };
        state.ang_vel = [0.3, 0.2, 0.1];
        let near = Surroundings { ground_distance_m: 0.1, ..Surroundings::calm() };
        for kind in KINDS {
            let drone = quad(vec![AnyEffect::by_kind(kind).unwrap()]);
            assert_eq!(drone.effects[0].kind(), *kind);
            let mut command = Command::Rotors([400.0; MAX_ROTORS]);
            let mut memory = vec![0.0; drone.memory_len(0.002)];
            for _ in 0..3 {
                command = Command::Rotors([400.0; MAX_ROTORS]);
                drone.transmit(&state, &near, (0.002, 0.002), &mut command, &mut memory);
            }
            assert_eq!(command, Command::Rotors([400.0; MAX_ROTORS]), "{kind}");
            assert_eq!(drone.rate(&state, &command, &near), plain.rate(&state, &command, &near), "{kind}");
        }
        assert_eq!(AnyEffect::by_kind("propwash"), None);
    }
}
