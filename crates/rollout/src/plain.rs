//! A drone of a simulation as plain functions of its state and its command. They change nothing.

use super::blocks::{Block, Phase, Plan};
use super::tape::state_width;
use super::traced::relevant;
use super::{RolloutError, Sim, pool};
use propwash_physics::controllers::Due;
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::State;
use propwash_trace::lanes::Number;
use propwash_trace::math::quat;

/// What stays as it is while the state and the command of one drone are given.
struct Asked<'a> {
    plan: Plan,
    drones: Vec<&'a Drone<f64>>,
    block: Block,
    drone: usize,
    n_rotors: usize,
}

impl Asked<'_> {
    /// The world with this drone in a state of [`state_width`] numbers, under a command.
    fn at(&self, x: &[f64], u: &[f64]) -> Block {
        let mut block = self.block.clone();
        let slot = &mut block.slots[self.drone];
        let three = |from: usize| core::array::from_fn(|i| x[from + i]);
        slot.state = State {
            pos: three(0),
            quat: core::array::from_fn(|i| x[3 + i]),
            vel: three(7),
            ang_vel: three(10),
            rotor_vel: core::array::from_fn(|i| if i < self.n_rotors { x[13 + i] } else { 0.0 }),
            thrust: x[13 + self.n_rotors],
        };
        slot.command[..u.len()].copy_from_slice(u);
        block
    }

    /// Time derivative of the state; every stage of the on-board controllers ticks.
    fn rate(&self, x: &[f64], u: &[f64], out: &mut [f64]) {
        let mut block = self.at(x, u);
        let due = relevant(self.plan.mode, Due { state: true, attitude: true, force_torque: true });
        block.control_one(&self.plan, &self.drones, self.drone, due);
        let rate = block.rate(&self.plan, &self.drones, self.drone);
        let state = &block.slots[self.drone].state;
        let [wx, wy, wz] = state.ang_vel.map(|v| 0.5 * v);
        out[0..3].copy_from_slice(&rate.vel);
        out[3..7].copy_from_slice(&quat::mul(state.quat, [wx, wy, wz, 0.0]));
        out[7..10].copy_from_slice(&rate.acc);
        out[10..13].copy_from_slice(&rate.ang_acc);
        out[13..13 + self.n_rotors].copy_from_slice(&rate.rotor_acc[..self.n_rotors]);
        out[13 + self.n_rotors] = rate.thrust_rate;
    }

    /// The state after some steps; numbers that are none where it turned non-finite.
    fn steps(&self, x: &[f64], u: &[f64], n_steps: usize, out: &mut [f64]) {
        let mut block = self.at(x, u);
        if block.advance(&self.plan, &self.drones, n_steps, Phase::Both).is_some() {
            return out.fill(f64::NAN);
        }
        let State { pos, quat, vel, ang_vel, rotor_vel, thrust } = &block.slots[self.drone].state;
        let parts = [&pos[..], quat, vel, ang_vel, &rotor_vel[..self.n_rotors], &[*thrust]];
        let mut col = 0;
        for part in parts {
            out[col..col + part.len()].copy_from_slice(part);
            col += part.len();
        }
    }
}

impl<N: Number> Sim<N> {
    /// Time derivatives of states of a drone under commands, in f64: `x` holds rows of [`state_width`] numbers in the order of [`crate::SimData::copy_state`], `u` as
    /// many rows of [`Sim::command_width`]. SI.
    ///
    /// The derivative is that of this instant: every stage of the on-board controllers ticks once, from what they remember now; parameters, wind, disturbances,
    /// other drones, time and random numbers are those of the world now. What acts between steps (delays of commands, a battery that empties) is no part of it.
    ///
    /// # Errors
    /// [`RolloutError::Option`] for a world or a drone that there is not and for steps with stages written as code, [`RolloutError::Length`] for rows that do not match,
    /// [`RolloutError::NotFinite`].
    ///
    /// ```
    /// use propwash_physics::controllers::ControlMode;
    /// use propwash_rollout::{Sim, SimOptions};
    /// use propwash_vehicle::Vehicle;
    ///
    /// let vehicle = Vehicle::builtin("cf2x_L250")?;
    /// let drone = vehicle.drone("first_principles")?;
    /// let hover = drone.hover_rotor_vel()[..4].to_vec();
    /// let options = SimOptions { control: ControlMode::RotorVel, ..SimOptions::default() };
    /// let sim = Sim::<f64>::storing(options, vec![(drone, vehicle.rates)])?;
    /// let x = [vec![0.0; 6], vec![1.0], vec![0.0; 6], hover.clone(), vec![0.0]].concat();
    /// let rate = sim.rate_at((0, 0), &x, &hover)?;
    /// assert!(rate[9].abs() < 1e-9, "it hovers");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn rate_at(&self, at: (usize, usize), x: &[f64], u: &[f64]) -> Result<Vec<f64>, RolloutError> {
        let asked = self.asked(at, x, u)?;
        Ok(self.rows(x, u, 1, |x, u, out| asked.rate(x, u, out)))
    }

    /// States after `n_steps` steps from states of a drone under commands, as [`Sim::rate_at`] takes them: what this world would fly from there now, with its controllers' ticks and memories.
    /// Other drones of the world fly on under their own commands. A row whose numbers stop being numbers is NaN.
    ///
    /// # Errors
    /// Those of [`Sim::rate_at`].
    pub fn steps_from(
        &self,
        at: (usize, usize),
        x: &[f64],
        u: &[f64],
        n_steps: usize,
    ) -> Result<Vec<f64>, RolloutError> {
        let asked = self.asked(at, x, u)?;
        Ok(self.rows(x, u, n_steps, |x, u, out| asked.steps(x, u, n_steps, out)))
    }

    /// A function of every row, by several threads where it pays.
    fn rows(
        &self,
        x: &[f64],
        u: &[f64],
        n_steps: usize,
        f: impl Fn(&[f64], &[f64], &mut [f64]) + Sync + Send,
    ) -> Vec<f64> {
        let (wide, narrow) = (state_width(self.data.n_rotors), self.data.command_width);
        let mut out = vec![0.0; x.len()];
        let rows = x.chunks_exact(wide).zip(u.chunks_exact(narrow)).zip(out.chunks_exact_mut(wide));
        let mut rows: Vec<_> = rows.map(|((x, u), out)| (x, u, out)).collect();
        let work = rows.len() * n_steps;
        pool::for_each(&mut rows, work, |(x, u, out)| f(x, u, out));
        out
    }

    fn asked(&self, (world, drone): (usize, usize), x: &[f64], u: &[f64]) -> Result<Asked<'_>, RolloutError> {
        let data = &self.data;
        for (name, got, many) in [("world", world, data.n_worlds), ("drone", drone, data.n_drones)] {
            if got >= many {
                let expected = format!("less than {many}");
                return Err(RolloutError::Option { name, expected, got: got.to_string() });
            }
        }
        if !self.pipeline.is_plain() {
            return Err(RolloutError::Option {
                name: "pipeline",
                expected: "steps that are functions of state and command, without stages written as code: take them out, or write them as effects".into(),
                got: self.pipeline.user_names().join(", "),
            });
        }
        let (wide, narrow) = (state_width(data.n_rotors), data.command_width);
        let rows = x.len() / wide;
        for (name, got, width) in [("x", x.len(), wide), ("u", u.len(), narrow)] {
            if got != rows * width {
                let shape = format!("{rows} rows × {width}");
                return Err(RolloutError::Length { name, expected: rows * width, shape, got });
            }
        }
        for (name, numbers, width) in [("x", x, wide), ("u", u, narrow)] {
            if let Some(i) = numbers.iter().position(|v| !v.is_finite()) {
                let (row, entry, got) = (i / width, i % width, numbers[i]);
                let expected = "finite numbers".into();
                let got = format!("{got} in row {row}, number {entry}");
                return Err(RolloutError::Option { name, expected, got });
            }
        }
        let equations = self.equations();
        Ok(Asked {
            plan: equations.plan(),
            drones: equations.drones(world),
            block: equations.load(world),
            drone,
            n_rotors: data.n_rotors,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Engine, SimOptions};
    use propwash_physics::controllers::ControlMode;
    use propwash_vehicle::Vehicle;

    fn sim(control: ControlMode, dynamics: &str) -> Sim<f64> {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let options = SimOptions { n_worlds: 2, control, engine: Engine::Reference, ..SimOptions::default() };
        let mut sim = Sim::storing(options, vec![(vehicle.drone(dynamics).unwrap(), vehicle.rates)]).unwrap();
        let hover = sim.drone(0, 0).hover_command();
        let command = match control {
            ControlMode::RotorVel => sim.drone(0, 0).hover_rotor_vel()[..4].to_vec(),
            _ => vec![0.1, -0.05, 0.2, 1.02 * hover],
        };
        sim.set_command(&command.repeat(2)).unwrap();
        // Controllers remember something then.
        sim.step(7).unwrap();
        sim
    }

    fn state(sim: &Sim<f64>, row: usize) -> Vec<f64> {
        let mut x = vec![0.0; state_width(sim.data.n_rotors)];
        sim.data.copy_state(row, &mut x);
        x
    }

    #[test]
    fn steps_from_here_are_the_steps_of_the_simulation() {
        for (control, dynamics) in [
            (ControlMode::Attitude, "first_principles"),
            (ControlMode::RotorVel, "first_principles"),
            (ControlMode::Attitude, "so_rpy_rotor_drag"),
        ] {
            let mut sim = sim(control, dynamics);
            let (x, u) = (state(&sim, 1), sim.data.command.clone());
            let u = &u[u.len() / 2..];
            let rows = sim.steps_from((1, 0), &x.repeat(300), &u.repeat(300), 5).unwrap();
            sim.step(5).unwrap();
            let flown = state(&sim, 1);
            assert!(rows.chunks_exact(flown.len()).all(|row| row == flown), "{control:?} {dynamics}");
        }
    }

    #[test]
    fn rates_are_slopes_of_steps() {
        let sim = sim(ControlMode::RotorVel, "first_principles");
        let (mut x, u) = (state(&sim, 0), sim.data.command[..4].to_vec());
        (x[7], x[11], x[14]) = (1.3, 2.0, x[14] + 40.0);
        let (rate, next) = (sim.rate_at((0, 0), &x, &u).unwrap(), sim.steps_from((0, 0), &x, &u, 1).unwrap());
        for k in (0..x.len()).filter(|k| !(3..7).contains(k)) {
            // Euler's step is exactly this, but for the attitude, which is turned.
            let slope = (next[k] - x[k]) * 500.0;
            assert!((rate[k] - slope).abs() <= 1e-9 * slope.abs().max(1.0), "{k}: {} {slope}", rate[k]);
        }
        assert!(rate[12].abs() > 0.0 && rate[14] < -1.0);
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let sim = sim(ControlMode::RotorVel, "first_principles");
        let (x, u) = (state(&sim, 0), vec![1000.0; 4]);
        let said = |at, x: &[f64], u: &[f64]| sim.rate_at(at, x, u).unwrap_err().to_string();
        assert!(said((2, 0), &x, &u).contains("world: expected less than 2, got 2"));
        assert!(said((0, 1), &x, &u).contains("drone: expected less than 1, got 1"));
        assert!(said((0, 0), &x, &u[..3]).contains('u'));
        let mut odd = x.repeat(2);
        odd[20] = f64::NAN;
        assert!(said((0, 0), &odd, &u.repeat(2)).contains("NaN in row 1, number 2"));
        // A state in which a step leads beyond all numbers.
        let mut wild = x.clone();
        wild[7] = 1e300;
        assert!(sim.steps_from((0, 0), &wild, &u, 1).unwrap().iter().all(|v| v.is_nan()));
    }
}
