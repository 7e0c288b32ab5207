//! Commands that reach the motors late.
//!
//! Commands are held constant over a step, so a delay of (k + f) steps lets the motors see the command of k + 1 steps ago
//! for the share f of a step and that of k steps ago for the rest; the mean of the two is exact over the step and has a
//! derivative with respect to the delay.

use super::{Command, Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Group, Nature, Needs, Relative};
use crate::params::parameters;
use propwash_trace::Real;

/// Numbers of one remembered command: eight rotors, or four of attitude and thrust.
const WIDTH: usize = crate::rigid_body::MAX_ROTORS;

/// Longest delay, s.
pub const MAX_DELAY_S: f64 = 0.5;

parameters! {
    /// Parameters of the delay.
    pub struct Params {
        /// Delay, s, from 0 to [`MAX_DELAY_S`].
        delay_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { delay_s: 0.0 }
    }
}

/// Number of past commands that the longest delay needs at steps of `dt_s`.
fn history(dt_s: f64) -> usize {
    (MAX_DELAY_S / dt_s).ceil() as usize + 2
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { relative: Some(Relative::Time), group: Some(Group::Clocks), ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("delay_s", Bounds::within(0.0, MAX_DELAY_S))] }
    }

    fn delay_s(&self) -> Option<S> {
        Some(self.delay_s)
    }

    /// Past commands, newest first. Before the first command stands what was in force at the start.
    fn memory_len(&self, dt_s: f64) -> usize {
        history(dt_s) * WIDTH
    }

    fn start(&self, command: &Command<S>, memory: &mut [S]) {
        let numbers: &[S] = match command {
            Command::Rotors(c) => c,
            Command::Attitude(c) => c,
        };
        for row in memory.chunks_exact_mut(WIDTH) {
            row[..numbers.len()].copy_from_slice(numbers);
        }
    }

    fn command(&self, _: &View<S>, dt_s: S, command: &mut Command<S>, memory: &mut [S]) {
        let rows = memory.len() / WIDTH;
        memory.copy_within(0..(rows - 1) * WIDTH, WIDTH);
        let numbers: &mut [S] = match command {
            Command::Rotors(c) => c,
            Command::Attitude(c) => c,
        };
        memory[..numbers.len()].copy_from_slice(numbers);
        // Weight of the command of `row` steps ago: a hat function around the delay, in steps.
        let steps = self.delay_s.clamp(S::zero(), S::lit(MAX_DELAY_S)) / dt_s;
        for i in 0..numbers.len() {
            let mut sum = S::zero();
            for row in 0..rows {
                let weight = (S::one() - (steps - S::lit(row as f64)).abs()).max(S::zero());
                sum = sum + weight * memory[row * WIDTH + i];
            }
            numbers[i] = sum;
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "command_delay",
            "commands that arrive late",
            Area::Drive,
            vec![Freedom::up("delay_s", "s", 0.001, 0.015)],
            "make sharp steps of roll, pitch and thrust",
        )
        .needing(Needs::Commands),
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
    fn a_step_arrives_after_the_delay_and_shares_the_step_in_which_it_falls() {
        let dt = 0.002;
        let drone = quad(vec![AnyEffect::CommandDelay(Params { delay_s: 0.005 })]);
        let mut memory = vec![0.0; drone.memory_len(dt)];
        let seen: Vec<f64> = (0..6)
            .map(|_| {
                let mut command = Command::Rotors([100.0; 8]);
                drone.transmit(
                    &State::rest(),
                    &mut Surroundings::calm(),
                    (dt, dt),
                    &mut command,
                    &mut memory,
                );
                let Command::Rotors(c) = command else { panic!("rotor command expected") };
                c[0]
            })
            .collect();
        // 5 ms are two and a half steps: nothing, nothing, half a step of it, all of it.
        for (a, b) in seen.iter().zip([0.0, 0.0, 50.0, 100.0, 100.0, 100.0]) {
            assert!((a - b).abs() < 1e-9, "{seen:?}");
        }
    }

    #[test]
    fn the_longest_delay_fits_its_memory() {
        let dt = 0.01;
        let drone = quad(vec![AnyEffect::CommandDelay(Params { delay_s: MAX_DELAY_S })]);
        let mut memory = vec![0.0; drone.memory_len(dt)];
        let mut last = 0.0;
        for step in 0..60 {
            let mut command = Command::Attitude([0.0, 0.0, 0.0, f64::from(step)]);
            drone.transmit(&State::rest(), &mut Surroundings::calm(), (dt, dt), &mut command, &mut memory);
            let Command::Attitude(c) = command else { panic!("attitude command expected") };
            last = c[3];
        }
        assert!((last - 9.0).abs() < 1e-9, "{last}");
    }
}
