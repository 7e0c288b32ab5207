//! A trained policy: its network, what its actions mean, how often it acts; and flights that say how good it is.

use crate::LearnError;
use crate::goal::{Actions, Goal, Seen};
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
    /// Flights that did not stay finite or came farther off than [`Goal::far_off_m`].
    pub lost: usize,
    /// Positions of the first flight after each command, m.
    pub path_m: Vec<[f64; 3]>,
}

impl Policy {
    /// The command for a state: its numbers in order, and the time, s.
    pub fn command<G: Goal>(&self, goal: &G, state: &[f64], time_s: f64) -> Vec<f64> {
        let mut observation = Vec::new();
        goal.observe(&Seen::of(state, time_s), &mut observation);
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
        let mut begun = Vec::new();
        for w in 0..flights {
            let world = w as u64;
            let key = Key { seed, world, drone: 0, step: 0, purpose: purpose("learn.evaluation") };
            let (state, time_s) = goal.start(&mut key.stream());
            sim.set_initial(w, 0, state)?;
            begun.push(time_s);
        }
        sim.reset(None)?;
        let mut numbers = vec![0.0; width];
        let (mut square, mut n, mut most) = (0.0, 0usize, 0.0f64);
        let (mut lost, mut path_m) = (vec![false; flights], Vec::new());
        for t in 0..(goal.episode_s() / step_s).round() as usize {
            let mut commands = Vec::new();
            for (w, begun) in begun.iter().enumerate() {
                if lost[w] {
                    commands.extend_from_slice(&self.actions.middle);
                    continue;
                }
                sim.data.copy_state(w, &mut numbers);
                commands.extend(self.command(goal, &numbers, begun + t as f64 * step_s));
            }
            sim.set_command(&commands)?;
            sim.step(self.substeps)?;
            let after_s = (t + 1) as f64 * step_s;
            for w in 0..flights {
                if lost[w] {
                    continue;
                }
                sim.data.copy_state(w, &mut numbers);
                let off = goal.off_m(&Seen::of(&numbers, begun[w] + after_s));
                lost[w] = sim.data.quarantine[w].is_some() || !off.is_finite() || off > goal.far_off_m();
                if after_s > settle_s && !lost[w] {
                    (square, n, most) = (square + off * off, n + 1, most.max(off));
                }
                if w == 0 {
                    path_m.push([numbers[0], numbers[1], numbers[2]]);
                }
            }
        }
        let mut reached = 0;
        let end_s = goal.episode_s();
        for w in (0..flights).filter(|w| !lost[*w]) {
            sim.data.copy_state(w, &mut numbers);
            reached += usize::from(goal.reached(&Seen::of(&numbers, begun[w] + end_s)));
        }
        let off_rms_m = (square / n as f64).sqrt();
        Ok(Flown { off_rms_m, off_most_m: most, reached, lost: lost.iter().filter(|l| **l).count(), path_m })
    }
}
