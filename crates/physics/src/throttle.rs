//! From the throttle of a speed controller and the battery's voltage to the speed at which a motor settles.
//!
//! A speed controller passes the share u of the battery's voltage on to its motor. At steady speed that voltage balances the
//! motor's back-EMF, in proportion to the speed, and the drop of its current, which goes with the torque of the propeller and
//! thus with the squared speed: u V = c + a Ω + b Ω². Source: Quan, "Introduction to multicopter design and control",
//! Springer 2017, ch. 4 (equivalent circuit of motor and speed controller; propeller torque in proportion to Ω²); the constant
//! c, below which nothing turns, is that of speed controllers with an idle range.

use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// The motors of a vehicle by throttle and voltage.
    pub struct Params {
        /// Voltage c at which a motor starts to turn, V.
        offset_v: S,
        /// Back-EMF a, V·s/rad.
        back_emf_v_s_per_rad: S,
        /// Voltage b for the propeller's torque, V·s²/rad².
        load_v_s2_per_rad2: S,
    }
}

impl<S: Real> Params<S> {
    /// Speed at which a motor settles, rad/s, by `throttle` (0 to 1) and the battery's voltage (V): the root of
    /// b Ω² + a Ω = u V − c, zero below c.
    #[inline(always)]
    pub fn speed(&self, throttle: S, battery_v: S) -> S {
        let zero = S::zero();
        let drive = throttle * battery_v - self.offset_v;
        let turning = drive.gt(zero);
        // Both forms of the root are the same number; this one has no difference of near numbers and holds for b = 0. A
        // motor at rest is given the root of 1 V, so that no derivative is infinite there.
        let drive = S::select(turning, drive, S::one());
        let a = self.back_emf_v_s_per_rad;
        let root = (a * a + S::lit(4.0) * self.load_v_s2_per_rad2 * drive).sqrt();
        S::select(turning, S::lit(2.0) * drive / (a + root), zero)
    }

    /// Throttle at which a motor settles at `speed` (rad/s) with the battery at a voltage (V); above 1 where the battery
    /// cannot give that speed.
    #[inline(always)]
    pub fn throttle(&self, speed: S, battery_v: S) -> S {
        let slope = self.back_emf_v_s_per_rad + self.load_v_s2_per_rad2 * speed;
        (self.offset_v + slope * speed) / battery_v
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_trace::dual::Dual;

    const MOTOR: Params<f64> =
        Params { offset_v: 0.3, back_emf_v_s_per_rad: 5.05e-4, load_v_s2_per_rad2: 1.79e-7 };

    #[test]
    fn speed_and_throttle_are_inverse_and_a_motor_below_its_idle_voltage_stands() {
        for battery_v in [3.2, 3.7, 4.2] {
            for throttle in [0.1, 0.35, 0.5, 1.0] {
                let speed = MOTOR.speed(throttle, battery_v);
                assert!(speed > 0.0 && (MOTOR.throttle(speed, battery_v) - throttle).abs() < 1e-12);
            }
        }
        assert_eq!(MOTOR.speed(0.05, 3.7), 0.0);
        assert_eq!(MOTOR.speed(-0.1, 3.7), 0.0);
        // Without a load the speed is the motor's velocity constant times the voltage, without back-EMF a root.
        let idle = Params { load_v_s2_per_rad2: 0.0, ..MOTOR };
        assert!((idle.speed(0.5, 3.7) - 1.55 / 5.05e-4).abs() < 1e-9);
        let loaded = Params { back_emf_v_s_per_rad: 0.0, ..MOTOR };
        assert!((loaded.speed(0.5, 3.7) - (1.55f64 / 1.79e-7).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn slopes_are_those_of_differences_and_finite_where_nothing_turns() {
        let dual = Params {
            offset_v: Dual::<f64, 4>::input(MOTOR.offset_v, 0),
            back_emf_v_s_per_rad: Dual::input(MOTOR.back_emf_v_s_per_rad, 1),
            load_v_s2_per_rad2: Dual::input(MOTOR.load_v_s2_per_rad2, 2),
        };
        let at = |throttle: f64| dual.speed(Dual::input(throttle, 3), Dual::lit(3.7));
        let slope = at(0.4);
        let differ = |change: &dyn Fn(&mut Params<f64>, &mut f64, f64), h: f64| {
            let speed = |h: f64| {
                let (mut p, mut u) = (MOTOR, 0.4);
                change(&mut p, &mut u, h);
                p.speed(u, 3.7)
            };
            (speed(h) - speed(-h)) / (2.0 * h)
        };
        let by = [
            differ(&|p, _, h| p.offset_v += h, 1e-5),
            differ(&|p, _, h| p.back_emf_v_s_per_rad += h, 1e-8),
            differ(&|p, _, h| p.load_v_s2_per_rad2 += h, 1e-11),
            differ(&|_, u, h| *u += h, 1e-5),
        ];
        for (exact, by) in slope.partials.iter().zip(by) {
            assert!((exact / by - 1.0).abs() < 1e-6, "{exact} {by}");
        }
        assert_eq!(at(0.01).partials, [0.0; 4]);
    }
}
