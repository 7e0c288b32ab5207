//! A battery whose voltage falls with the charge drawn and with the current, and motors that turn slower for it.
//!
//! Power is that of an ideal disc, T^1.5 / √(2ρA), divided by an efficiency (Leishman, "Principles of helicopter
//! aerodynamics", ch. 2); voltage is V = V_full − k q − R I. Rotor speed follows voltage, so commanded speeds shrink by
//! V / V_nominal and commanded thrust by its square; of a firmware that makes up for part of it, by what is left. Where the
//! voltage is measured along a log, that is taken.

use super::{Command, Effect, View};
use crate::airframe;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, FromLog, Nature, Needs};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the battery.
    pub struct Params {
        /// Voltage of the full battery at rest, V.
        full_v: S,
        /// Voltage at which a command gives its nominal speed, V.
        nominal_v: S,
        /// Internal resistance, Ω.
        resistance_ohm: S,
        /// Fall of the voltage at rest per charge drawn, V/(A·s).
        drop_v_per_a_s: S,
        /// Share of electrical power that reaches the air.
        efficiency: S,
        /// Share of a fall of the voltage that the firmware makes up for; below 0 where speeds fall more than the voltage.
        compensated: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self {
            full_v: 1.0,
            nominal_v: 1.0,
            resistance_ohm: 0.0,
            drop_v_per_a_s: 0.0,
            efficiency: 0.5,
            compensated: 0.0,
        }
    }
}

impl<S: Real> Params<S> {
    /// Power that the rotors put into the air, W.
    #[inline(always)]
    pub fn power(&self, view: &View<S>, command: &Command<S>) -> S {
        let zero = S::zero();
        let mut area = zero;
        let mut power = zero;
        let loads = airframe::loads(view.airframe, &view.state.rotor_vel);
        let density = view.surroundings.air_density_kg_m3;
        let pi = S::lit(core::f64::consts::PI);
        for i in 0..view.airframe.n_rotors {
            let disc = pi * view.airframe.rotors[i].radius_m.square();
            area = area + disc;
            let thrust = loads.thrust[i].max(zero);
            power = power + thrust * (thrust / (S::lit(2.0) * density * disc)).sqrt();
        }
        if let Command::Attitude(c) = command {
            let thrust = c[3].max(zero);
            power = thrust * (thrust / (S::lit(2.0) * density * area)).sqrt();
        }
        power
    }

    /// Voltage at rest once `charge` (A·s) was drawn, V. An empty battery gives nothing: motors stop and no current flows.
    #[inline(always)]
    fn rest_v(&self, charge: S) -> S {
        (self.full_v - self.drop_v_per_a_s * charge).max(S::zero())
    }

    /// Voltage at a power, V: V = V_rest − R P / (η V), solved for V; at the power limit the root is held at V_rest / 2.
    #[inline(always)]
    fn loaded_v(&self, rest: S, power: S) -> S {
        let product = self.resistance_ohm * power / self.efficiency;
        S::lit(0.5) * (rest + (rest * rest - S::lit(4.0) * product).max(S::zero()).sqrt())
    }

    /// Voltage under the present load once `charge` (A·s) was drawn, V; `command` as it reaches the battery.
    pub fn voltage(&self, view: &View<S>, command: &Command<S>, charge: S) -> S {
        self.loaded_v(self.rest_v(charge), self.power(view, command))
    }
}

impl<S: Real> Effect<S> for Params<S> {
    /// Each flight may begin with another battery.
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, is_battery: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const {
            &[
                ("full_v", Bounds::above(0.0)),
                ("nominal_v", Bounds::above(0.0)),
                ("resistance_ohm", Bounds::from(0.0)),
                ("drop_v_per_a_s", Bounds::from(0.0)),
                ("efficiency", Bounds::above_to(0.0, 1.0)),
                ("compensated", Bounds::within(-0.5, 1.0)),
            ]
        }
    }

    fn battery_v(&self, view: &View<S>, command: &Command<S>, memory: &[S]) -> Option<S> {
        Some(self.voltage(view, command, memory[0]))
    }

    /// Charge drawn so far, A·s.
    fn memory_len(&self, _: f64) -> usize {
        1
    }

    #[inline(always)]
    fn command(&self, view: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        let zero = S::zero();
        let power = self.power(view, command);
        let rest = self.rest_v(memory[0]);
        let empty = rest.le(zero);
        let voltage = self.loaded_v(rest, power);
        let current = power / (self.efficiency * S::select(empty, S::one(), voltage));
        memory[0] = memory[0] + S::select(empty, zero, current) * dt_s;
        let measured = view.surroundings.battery_v;
        let voltage = S::select(measured.gt(zero), measured, voltage);
        let left = S::one() - self.compensated;
        let ratio = S::one() + left * (voltage / self.nominal_v - S::one());
        match command {
            Command::Rotors(speeds) => {
                for i in 0..view.airframe.n_rotors {
                    speeds[i] = speeds[i] * ratio;
                }
            }
            Command::Attitude(c) => c[3] = c[3] * ratio * ratio,
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`]. Only with a measured voltage: without one, charge drawn goes
/// with time, and [`super::thrust_fade`] stands for it.
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "battery_sag",
            "motors that turn slower as the battery's voltage falls",
            Area::Drive,
            vec![Freedom::down("compensated", "1", 0.05, 1.0)],
            "fly a battery from full to nearly empty, with hard climbs",
        )
        .needing(Needs::Voltage)
        .preset("compensated", 1.0)
        .preset("nominal_v", 1.0)
        .preset("full_v", 1.0)
        .preset("resistance_ohm", 0.0)
        .preset("drop_v_per_a_s", 0.0)
        .given_by("full_v", FromLog::BatteryVoltage),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn hovering_draws_the_power_of_momentum_theory_and_lowers_the_speed_with_the_voltage() {
        let battery = Params {
            full_v: 12.0,
            nominal_v: 12.0,
            resistance_ohm: 0.0,
            drop_v_per_a_s: 0.01,
            efficiency: 0.5,
            compensated: 0.0,
        };
        let drone = quad(vec![AnyEffect::BatterySag(battery)]);
        let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
        let mut memory = vec![0.0; drone.memory_len(0.01)];
        let mut command = Command::Rotors([500.0; 8]);
        drone.transmit(&state, &mut Surroundings::calm(), (0.01, 0.01), &mut command, &mut memory);
        let Command::Rotors(first) = command else { panic!("rotor command expected") };
        assert_eq!(first[0], 500.0, "full battery, no resistance");
        let disc = core::f64::consts::PI * 0.06f64.powi(2);
        let thrust: f64 = 9.81 / 4.0;
        let power = 4.0 * thrust.powf(1.5) / (2.0 * 1.225 * disc).sqrt() / 0.5;
        assert!((memory[0] - power / 12.0 * 0.01).abs() < 1e-12);
        memory[0] = 120.0;
        let mut command = Command::Rotors([500.0; 8]);
        drone.transmit(&state, &mut Surroundings::calm(), (0.01, 0.01), &mut command, &mut memory);
        let Command::Rotors(later) = command else { panic!("rotor command expected") };
        assert!((later[0] - 500.0 * 10.8 / 12.0).abs() < 1e-9, "0.01 V per A·s over 120 A·s");
    }

    #[test]
    fn a_measured_voltage_goes_before_a_modelled_one_and_the_firmware_makes_up_for_its_share() {
        let battery = Params { full_v: 12.0, nominal_v: 12.0, compensated: 0.25, ..Params::default() };
        let drone = quad(vec![AnyEffect::BatterySag(battery)]);
        let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
        let speeds = |battery_v: f64| {
            let mut command = Command::Rotors([500.0; 8]);
            let mut around = Surroundings { battery_v, ..Surroundings::calm() };
            drone.transmit(&state, &mut around, (0.01, 0.01), &mut command, &mut [0.0]);
            let Command::Rotors(speeds) = command else { panic!("rotor command expected") };
            speeds[0]
        };
        assert_eq!(speeds(0.0), 500.0, "full battery, no resistance");
        assert!((speeds(10.8) - 500.0 * (1.0 - 0.75 * 0.1)).abs() < 1e-9);
    }

    #[test]
    fn an_empty_battery_stops_the_motors_and_stays_finite() {
        for resistance_ohm in [0.0, 0.1] {
            let battery = Params {
                full_v: 12.0,
                nominal_v: 12.0,
                resistance_ohm,
                drop_v_per_a_s: 0.01,
                efficiency: 0.5,
                compensated: 0.0,
            };
            let drone = quad(vec![AnyEffect::BatterySag(battery)]);
            let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
            let mut memory = vec![1300.0];
            let mut command = Command::Rotors([500.0; 8]);
            drone.transmit(&state, &mut Surroundings::calm(), (0.01, 0.01), &mut command, &mut memory);
            assert_eq!(
                (command, memory[0]),
                (Command::Rotors([0.0, 0.0, 0.0, 0.0, 500.0, 500.0, 500.0, 500.0]), 1300.0)
            );
        }
    }

    #[test]
    fn resistance_lowers_the_voltage_under_load() {
        let battery = Params {
            full_v: 12.0,
            nominal_v: 12.0,
            resistance_ohm: 0.1,
            drop_v_per_a_s: 0.0,
            efficiency: 0.5,
            compensated: 0.0,
        };
        let drone = quad(vec![AnyEffect::BatterySag(battery)]);
        let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
        let mut memory = vec![0.0; 1];
        let mut command = Command::Rotors([500.0; 8]);
        drone.transmit(&state, &mut Surroundings::calm(), (1.0, 1.0), &mut command, &mut memory);
        let Command::Rotors(speeds) = command else { panic!("rotor command expected") };
        // Memory now holds the current of one second: V = 12 − R I must be the voltage behind the speed.
        let behind = 12.0 * speeds[0] / 500.0;
        assert!((12.0 - 0.1 * memory[0] - behind).abs() < 1e-9 && speeds[0] < 500.0);
        // The voltage can be asked for without drawing charge; other effects come before the battery as in flight.
        let read = |drone: &crate::drone::Drone<f64>, command: Command<f64>| {
            let mut memory = vec![0.0; drone.memory_len(1.0)];
            let mut command = command;
            drone.battery_v(&state, &Surroundings::calm(), (1.0, 1.0), &mut command, &mut memory)
        };
        let v = read(&drone, Command::Rotors([500.0; 8])).unwrap();
        assert!((v - behind).abs() < 1e-9, "{v} {behind}");
        assert_eq!(read(&quad(vec![]), Command::Rotors([500.0; 8])), None);
    }
}
