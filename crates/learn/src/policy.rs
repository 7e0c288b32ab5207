//! A trained policy: its network, what its actions mean, how often it acts; and flights that say how good it is.

use crate::LearnError;
use crate::goal::{Actions, Goal, Outcome, Seen};
use crate::network::Network;
use propwash_rollout::random::{Key, purpose};
use propwash_rollout::tape::state_width;
use propwash_rollout::{Engine, Sim, SimOptions};
use propwash_vehicle::Vehicle;

/// A network that commands a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// From observation to action.
    pub network: Network,
    /// What actions mean.
    pub actions: Actions,
    /// Steps of the simulation under each command, and steps per second.
    pub substeps: usize,
    /// Steps per second.
    pub sim_hz: u32,
}

/// What flights of a policy showed.
#[derive(Clone, Debug, PartialEq)]
pub struct Flown {
    /// Root mean square of how far off they were, m, over all flights and their time; NaN where all were lost.
    pub off_rms_m: f64,
    /// Most of it, m.
    pub off_most_m: f64,
    /// Flights that ended as they should ([`Goal::reached`]).
    pub reached: usize,
    /// Flights that did not stay finite, came farther off than [`Goal::far_off_m`] or failed ([`Outcome::Lost`]).
    pub lost: usize,
    /// Positions of the first flight after each command, m.
    pub path_m: Vec<[f64; 3]>,
    /// The state in which each flight ended: position, attitude, velocity, angular velocity.
    pub ends: Vec<[f64; 13]>,
}

impl Policy {
    /// The command for what is seen.
    pub fn command<G: Goal>(&self, goal: &G, seen: &Seen<f64>) -> Vec<f64> {
        let mut observation = Vec::new();
        goal.observe(seen, &mut observation);
        let observation: Vec<f32> = observation.into_iter().map(|v| v as f32).collect();
        self.actions.command(&self.network.act(&observation)).collect()
    }

    /// Flies `flights` episodes of the goal with a vehicle from starts that no training has seen, and says how far off they were; time before
    /// `settle_s` is not counted.
    ///
    /// # Errors
    /// [`LearnError`] where the vehicle or the simulation refuses it.
    pub fn fly<G: Goal>(
        &self,
        goal: &G,
        (vehicle, dynamics): (&Vehicle, &str),
        (flights, settle_s, seed): (usize, f64, u64),
    ) -> Result<Flown, LearnError> {
        let options = SimOptions {
            n_worlds: flights,
            seed,
            sim_hz: self.sim_hz,
            control: self.actions.mode,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let mut sim = Sim::<f64>::storing(options, vec![(vehicle.drone(dynamics)?, vehicle.rates)])?;
        let step_s = self.substeps as f64 / f64::from(self.sim_hz);
        let width = state_width(sim.data.n_rotors);
        let mut flights: Vec<Flight> = Vec::new();
        for w in 0..sim.data.n_worlds {
            let world = w as u64;
            let key = Key { seed, world, drone: 0, step: 0, purpose: purpose("learn.evaluation") };
            let mut memory = vec![0.0; goal.memory()];
            let (state, time_s) = goal.start(&mut key.stream(), &mut memory);
            sim.set_initial(w, 0, state)?;
            flights.push(Flight { time_s, memory, outcome: Outcome::On, state: vec![0.0; width] });
        }
        sim.reset(None)?;
        let mut numbers = vec![0.0; width];
        let (mut square, mut n, mut most) = (0.0, 0usize, 0.0f64);
        let mut path_m = Vec::new();
        for t in 0..(goal.episode_s() / step_s).round() as usize {
            let mut commands = Vec::new();
            for (w, flight) in flights.iter_mut().enumerate() {
                if flight.outcome != Outcome::On {
                    commands.extend_from_slice(&self.actions.middle);
                    continue;
                }
                sim.data.copy_state(w, &mut flight.state);
                commands.extend(self.command(goal, &flight.seen(t as f64 * step_s)));
            }
            sim.set_command(&commands)?;
            sim.step(self.substeps)?;
            let after_s = (t + 1) as f64 * step_s;
            for (w, flight) in flights.iter_mut().enumerate().filter(|(_, f)| f.outcome == Outcome::On) {
                sim.data.copy_state(w, &mut numbers);
                let off = flight.go_on(goal, (&numbers, sim.data.quarantine[w].is_some()), (t, step_s));
                if after_s > settle_s && flight.outcome != Outcome::Lost {
                    (square, n, most) = (square + off * off, n + 1, most.max(off));
                }
                if w == 0 {
                    path_m.push([numbers[0], numbers[1], numbers[2]]);
                }
            }
        }
        let end_s = goal.episode_s();
        let (mut reached, mut lost) = (0, 0);
        for flight in &flights {
            match flight.outcome {
                Outcome::Lost => lost += 1,
                _ => reached += usize::from(goal.reached(&flight.seen(end_s))),
            }
        }
        let off_rms_m = (square / n as f64).sqrt();
        let ends = flights.iter().map(|flight| std::array::from_fn(|k| flight.state[k])).collect();
        Ok(Flown { off_rms_m, off_most_m: most, reached, lost, path_m, ends })
    }
}

/// A flight of an evaluation.
struct Flight {
    /// Time at which it began, s.
    time_s: f64,
    memory: Vec<f64>,
    outcome: Outcome,
    /// The last state.
    state: Vec<f64>,
}

impl Flight {
    fn seen(&self, after_s: f64) -> Seen<'_, f64> {
        Seen::of(&self.state, self.time_s + after_s, &self.memory)
    }

    /// Judges command `t` by the state after it, or says that it is lost where its numbers are void; returns how far off it is.
    fn go_on<G: Goal>(&mut self, goal: &G, (after, void): (&[f64], bool), (t, step_s): (usize, f64)) -> f64 {
        let time_s = |t: usize| self.time_s + t as f64 * step_s;
        let mut memory = self.memory.clone();
        let end = Seen::of(after, time_s(t + 1), &self.memory);
        let off = goal.off_m(&end);
        self.outcome = if void || !off.is_finite() || off > goal.far_off_m() {
            Outcome::Lost
        } else if memory.is_empty() {
            Outcome::On
        } else {
            goal.judge(&Seen::of(&self.state, time_s(t), &self.memory), &end, &mut memory)
        };
        self.memory = memory;
        self.state.copy_from_slice(after);
        off
    }
}
