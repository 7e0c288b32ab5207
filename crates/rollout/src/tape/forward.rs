//! Forward-mode derivatives of a recorded flight: how the states move when everything before moves in one direction.

use super::{Partials, Slope, Tape, seeded};
use crate::RolloutError;
use crate::blocks::{Plan, Slot};
use crate::equations::Equations;
use propwash_physics::controllers::{Memory, mellinger};
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Neighbour;
use propwash_trace::Real;
use propwash_trace::lanes::Number;
use rayon::prelude::*;

/// A number with how far it moves.
fn moving(value: f64, by: f64) -> Slope {
    Slope { value, partials: [by] }
}

impl<N: Number> Tape<N> {
    /// How far the states after each command move, (world, time, drone, [`Tape::state_width`]), when everything before moves in this
    /// direction: the product of the flight's Jacobian with it. The equations are flown over dual numbers in f64, whatever the simulation
    /// stores and however it flies, one world at a time: the reference for [`Tape::pull_back`], and much slower.
    ///
    /// # Errors
    /// [`RolloutError::Length`] for arrays of other lengths than those of [`Tape::zero`], [`RolloutError::NoParameter`] for a name that no drone
    /// has, [`RolloutError::Gradient`] for worlds that stood still.
    pub fn push_forward(&self, direction: &Partials<N>) -> Result<Vec<N>, RolloutError> {
        self.check_direction(direction)?;
        let [worlds, times, drones, _] = self.shape();
        let mut out = vec![N::zero(); self.n_seeds()];
        let effect_at = self.effect_at();
        let equations = Equations {
            options: &self.options,
            nominal: &self.nominal,
            effect_at: &effect_at,
            own: self.own.as_deref(),
            rates: &self.rates,
            data: &self.start,
        };
        let plan = equations.plan();
        let per_world = times * drones * self.state_width();
        debug_assert_eq!(out.len(), worlds * per_world);
        out.par_chunks_mut(per_world).enumerate().for_each(|(w, out)| {
            self.push_world(w, direction, (&equations, &plan), out);
        });
        Ok(out)
    }

    /// Where the memory of the effects of each drone begins in that of a world, and where the last one ends.
    fn effect_at(&self) -> Vec<usize> {
        let dt = 1.0 / f64::from(self.options.sim_hz);
        let mut at = vec![0];
        for drone in &self.nominal {
            at.push(at[at.len() - 1] + drone.memory_len(dt));
        }
        at
    }

    fn check_direction(&self, direction: &Partials<N>) -> Result<(), RolloutError> {
        let names: Vec<&str> = direction.parameters.iter().map(|(name, _)| &name[..]).collect();
        self.check_names(&names)?;
        let zero = self.zero(&names);
        let lists = |p: &Partials<N>| {
            let mut out = vec![
                ("direction of the state", p.state.len()),
                ("direction of the commands", p.commands.len()),
                ("direction of the disturbance force", p.disturbance_force.len()),
                ("direction of the disturbance torque", p.disturbance_torque.len()),
                ("direction of the wind", p.wind.len()),
                ("direction of the controllers' memory", p.controller_memory.len()),
                ("direction of the effects' memory", p.effect_memory.len()),
            ];
            out.extend(p.parameters.iter().map(|(_, list)| ("direction of a parameter", list.len())));
            out
        };
        for ((name, expected), (_, got)) in lists(&zero).into_iter().zip(lists(direction)) {
            if expected != got {
                let shape = "as the array that it is a direction of".into();
                return Err(RolloutError::Length { name, expected, shape, got });
            }
        }
        match self.faults.first() {
            None => Ok(()),
            Some(fault) => Err(RolloutError::Gradient {
                what: format!("a flight that stood still: world {}, in step {}", fault.world, fault.step),
                remedy: "keep it from flying away (gentler commands, a shorter flight)".into(),
            }),
        }
    }

    /// Drones of a world with the parameters moving.
    fn moving_drones(
        &self,
        w: usize,
        direction: &Partials<N>,
        equations: &Equations<N>,
    ) -> Vec<Drone<Slope>> {
        let drones = self.nominal.len();
        let of = |d: usize| {
            let drone = equations.drone(w, d);
            let mut sum: Vec<f64> = Vec::new();
            for (name, by) in &direction.parameters {
                let by = by[w * drones + d].wide();
                if by == 0.0 {
                    continue;
                }
                let mut k = 0;
                seeded(drone, name).numbers(&mut |v| {
                    if sum.len() == k {
                        sum.push(0.0);
                    }
                    sum[k] += by * v.partials[0];
                    k += 1;
                });
            }
            let mut k = 0;
            drone.map(&mut |v| {
                k += 1;
                moving(v, sum.get(k - 1).copied().unwrap_or(0.0))
            })
        };
        (0..drones).map(of).collect()
    }

    /// The slots of a world, moving.
    fn moving_slots(&self, w: usize, direction: &Partials<N>, slots: &[Slot<f64>]) -> Vec<Slot<Slope>> {
        let (width, data) = (self.state_width(), &self.start);
        let rotors = data.n_rotors;
        let effect_at = self.effect_at();
        let moved = |(d, slot): (usize, &Slot<f64>)| {
            let row = data.row(w, d);
            let mut out = slot.map(&mut Slope::lit);
            let State { pos, quat, vel, ang_vel, rotor_vel, thrust } = &mut out.state;
            let motion = pos.iter_mut().chain(quat).chain(vel).chain(ang_vel).chain(&mut rotor_vel[..rotors]);
            let by = &direction.state[row * width..(row + 1) * width];
            for (v, by) in motion.chain([thrust]).zip(by) {
                v.partials[0] = by.wide();
            }
            let triples = [
                (&mut out.disturbance_force, &direction.disturbance_force),
                (&mut out.disturbance_torque, &direction.disturbance_torque),
                (&mut out.wind, &direction.wind),
            ];
            for (numbers, by) in triples {
                for (v, by) in numbers.iter_mut().zip(&by[3 * row..]) {
                    v.partials[0] = by.wide();
                }
            }
            let columns = &data.memory_columns;
            let mut memory = Vec::new();
            out.memory.store(|_, v| memory.push(v));
            for (within, by) in columns.iter().zip(&direction.controller_memory[row * columns.len()..]) {
                memory[*within].partials[0] = by.wide();
            }
            out.memory = Memory::load(|i| memory[i]);
            let first = w * effect_at[self.nominal.len()] + effect_at[d];
            for (v, by) in out.effect_memory.iter_mut().zip(&direction.effect_memory[first..]) {
                v.partials[0] = by.wide();
            }
            out
        };
        slots.iter().enumerate().map(moved).collect()
    }

    fn push_world(
        &self,
        w: usize,
        direction: &Partials<N>,
        (equations, plan): (&Equations<N>, &Plan),
        out: &mut [N],
    ) {
        let [_, times, n, command] = self.shape();
        let width = self.state_width();
        let block = equations.load(w);
        let drones = self.moving_drones(w, direction, equations);
        let mut slots = self.moving_slots(w, direction, &block.slots);
        let dt = 1.0 / f64::from(plan.sim_hz);
        let mut step = block.step;
        for t in 0..times {
            for (d, slot) in slots.iter_mut().enumerate() {
                let from = ((w * times + t) * n + d) * command;
                for i in 0..command {
                    slot.command[i] =
                        moving(self.commands[from + i].wide(), direction.commands[from + i].wide());
                }
            }
            for _ in 0..self.substeps {
                let around = |slots: &[Slot<Slope>], d: usize| {
                    let near = neighbours(slots, &drones, d, plan.reads_neighbours);
                    let normals = if plan.reads_noise[d] { block.source.normals(d, step) } else { [0.0; 6] };
                    (Slope::lit(step as f64 * dt), normals.map(Slope::lit), near)
                };
                for d in 0..n {
                    let due = plan.rates[d].due(plan.mode, step, plan.sim_hz);
                    let (time_s, normals, near) = around(&slots, d);
                    let by = (plan.mode, due, &lifted(&plan.periods[d]));
                    slots[d].control(&drones[d], by, (Slope::lit(dt), dt), (time_s, normals, &near[..]));
                }
                let moved: Vec<State<Slope>> = (0..n)
                    .map(|d| {
                        let (time_s, normals, near) = around(&slots, d);
                        let around = (time_s, normals, &near[..]);
                        slots[d].moved(&drones[d], plan.integrator, (Slope::lit(dt), dt), around)
                    })
                    .collect();
                for (slot, state) in slots.iter_mut().zip(moved) {
                    slot.state = state;
                }
                step += 1;
            }
            for (d, slot) in slots.iter().enumerate() {
                let s = &slot.state;
                let rotors = &s.rotor_vel[..self.start.n_rotors];
                let parts = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel, rotors, &[s.thrust]].concat();
                for (to, v) in out[(t * n + d) * width..].iter_mut().zip(parts) {
                    *to = N::of(v.partials[0]);
                }
            }
        }
    }
}

fn lifted(p: &mellinger::Periods<f64>) -> mellinger::Periods<Slope> {
    mellinger::Periods {
        state: Slope::lit(p.state),
        attitude: Slope::lit(p.attitude),
        body_rate: Slope::lit(p.body_rate),
    }
}

/// The other drones of slot `d`, where some effect reads them.
fn neighbours(
    slots: &[Slot<Slope>],
    drones: &[Drone<Slope>],
    d: usize,
    reads: bool,
) -> Vec<Neighbour<Slope>> {
    let others = slots.iter().enumerate().filter(|(other, _)| reads && *other != d);
    others
        .map(|(other, slot)| Neighbour {
            pos: slot.state.pos,
            vel: slot.state.vel,
            weight_n: drones[other].hover_thrust(),
            disc_radius_m: drones[other].disc_radius_m(),
        })
        .collect()
}
