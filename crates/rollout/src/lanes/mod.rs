//! Many drones at once in the lanes of the processor.
//!
//! Drones of one kind (same parts, same rates) share a program: a generated kernel where there is one for their step, else code that is compiled at run
//! time ([`propwash_compile`]), or byte code until it is there. Worlds are taken a few at a time; the drones of a kind in them fill lanes, all steps of a call run while they sit in
//! cache, and only then their numbers go back to the public arrays. A lane depends on no other, so results do not depend on how
//! worlds are grouped.

mod arrays;
mod pack;
mod plan;
mod runner;
mod sequence;

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use fearless_simd::Level;

use arrays::{Arrays, View};
use pack::{Pool, Steps};
use plan::{Kind, Means, Plan, kinds};
use sequence::{Job, Sequence};

use super::SimData;
use super::backend::Backend;
use super::blocks::Phase;
use super::pilot::{Commander, Pilot};
use super::quarantine::Quarantine;
use super::traced::{Shape, fixed, fixed_into, scheduled};
use super::watch::Watcher;
use propwash_compile::{Compile, Request};
use propwash_physics::controllers::{ControlMode, Rates};
use propwash_physics::drone::Drone;
use propwash_physics::integrate::Integrator;
use propwash_trace::lanes::{Cell, Number, level};

/// Drone-steps below which waking other threads costs more than it saves (about 10 µs against 5 ns a step).
pub(super) const SERIAL_LIMIT: usize = 10_000;

/// What it costs to bring the numbers of a drone into lanes and back, once per call, in steps (about 35 ns against 6 ns a step).
const STEPS_OF_A_CALL: usize = 6;

/// Time that byte code flies before its steps are worth compiling: about as long as the compiler takes for one.
const WORTH_COMPILING: Duration = Duration::from_millis(400);

/// Steps of which several blocks of lanes can keep all that they changed, about 35 numbers each, within the cache.
const FEW_STEPS: usize = 20;

/// Blocks of lanes that are loaded, flown and stored together.
const BLOCKS_AT_ONCE: usize = 4;

/// Work of a call, in drone-steps.
pub(super) fn work(n_drones: usize, n_steps: usize) -> usize {
    let each = if n_steps == 0 { 0 } else { n_steps.saturating_add(STEPS_OF_A_CALL) };
    n_drones.saturating_mul(each)
}

/// What is the same for all drones during one call.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    pub mode: ControlMode,
    pub integrator: Integrator,
    pub sim_hz: u32,
    pub seed: u64,
    pub first_world: u64,
    pub phase: Phase,
    pub n_steps: usize,
}

/// What a call does with all worlds.
pub(super) enum Ask<'a, N> {
    /// Steps under the commands that are set.
    Steps,
    /// Steps under a sequence of commands.
    Record(Commands<'a, N>, Looks<'a, N>),
    /// The same backwards: what a loss gains by everything that the flight began with and was told, from what it gains by the state
    /// after each command (world, time, drone, number of a state), with gains by these fixed numbers of each drone slot. Steps must
    /// stay finite; the arrays are left as they are.
    Sweep(Commands<'a, N>, &'a [N], &'a [Vec<usize>]),
    /// Steps whose commands a pilot gives, and the same backwards, with gains by no fixed numbers (one empty list for each drone slot).
    Pilot(Commands<'a, N>, &'a dyn Pilot<N>, &'a [Vec<usize>]),
    /// Steps whose commands are given as they go, forwards alone.
    Commander(Commands<'a, N>, &'a dyn Commander<N>),
}

/// What is done with the states after each command.
#[derive(Clone, Copy)]
pub(super) struct Looks<'a, N> {
    /// Sees them.
    pub watcher: Option<&'a dyn Watcher<N>>,
    /// All are kept; else each takes the place of the one before.
    pub keep: bool,
}

/// Further arrays that a call writes, with the numbers of a world in each.
pub(super) type Extra<'a, N> = Vec<(&'a mut [N], usize)>;

/// Commands, one after the other, each in force for some steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Commands<'a, N> {
    /// (world, time, drone, number of a command)
    pub numbers: &'a [N],
    pub times: usize,
    pub substeps: usize,
}

/// Programs, tables and working memory of a simulation.
#[derive(Debug)]
pub(super) struct Lanes<N: Number> {
    kinds: Vec<Kind<N>>,
    /// The user's, instead of kernels and byte code.
    backend: Option<Arc<dyn Backend<N>>>,
    arrays: Arrays,
    /// Rows whose parameters changed since their tables were filled; `None` for all.
    changed: Option<Vec<usize>>,
    /// Counts fillings of tables.
    stamp: u64,
    /// Where the memory of a slot's effects begins within that of its world; kept, so that no call allocates.
    effects_from: Vec<usize>,
    /// One per thread, so that none waits.
    scratch: Vec<Mutex<Scratch<N>>>,
    /// The instructions that are used.
    pub(super) level: Level,
    /// When steps without a kernel are compiled, and how long byte code flew them so far.
    compile: Compile,
    interpreted: Duration,
}

impl<N: Number> Lanes<N> {
    /// Lanes that compile steps then.
    pub fn new(compile: Compile) -> Self {
        Self {
            kinds: Vec::new(),
            backend: None,
            arrays: Arrays::default(),
            changed: None,
            stamp: 0,
            effects_from: Vec::new(),
            scratch: Vec::new(),
            level: level(),
            compile,
            interpreted: Duration::ZERO,
        }
    }
}

/// Working memory of one thread.
#[derive(Debug)]
struct Scratch<N: Number> {
    one: Pool<N::Cell>,
    two: Pool<N::Two>,
    four: Pool<N::Four>,
    /// Position and velocity of every drone at the start of a step, where effects read neighbours.
    around: Vec<N>,
    done: Vec<bool>,
}

impl<N: Number> Default for Scratch<N> {
    fn default() -> Self {
        Self {
            one: Pool::default(),
            two: Pool::default(),
            four: Pool::default(),
            around: Vec::new(),
            done: Vec::new(),
        }
    }
}

/// What all threads read.
struct Shared<'a, N: Number> {
    options: Options,
    kinds: &'a [Kind<N>],
    scratch: &'a [Mutex<Scratch<N>>],
    level: Level,
    stamp: u64,
    /// Whole arrays that are only read: see [`Arrays`].
    read: [&'a [N]; 6],
    episodes: &'a [u64],
    /// Seeds of worlds that have their own. (world)
    seeds: &'a [u64],
    nominal: &'a [Drone<f64>],
    own: Option<&'a [Drone<f64>]>,
    /// Where the memory of a slot's effects begins within that of its world.
    effects_from: &'a [usize],
    worlds_at_once: usize,
    parallel: bool,
    job: Job<'a, N>,
}

impl<N: Number> Lanes<N> {
    /// Another way to run the code of steps: a backend of the user's, or with `None` kernels and byte code.
    pub fn set_backend(&mut self, backend: Option<Arc<dyn Backend<N>>>) {
        self.backend = backend;
        self.forget_tables();
    }

    /// Parameters of all drones may have changed.
    pub fn forget_tables(&mut self) {
        self.changed = None;
    }

    /// Parameters of one drone may have changed, by its row (world, drone).
    pub fn forget_row(&mut self, row: usize) {
        if let Some(rows) = &mut self.changed {
            rows.push(row);
        }
    }

    /// Advances every world that is not quarantined, or does what else is asked for. `extra` are further arrays that it writes, with the
    /// numbers of a world in each: the states of [`Ask::Record`], or the gains of [`Ask::Sweep`] in the order of [`sequence::gain`].
    pub fn run(
        &mut self,
        options: &Options,
        seeds: &[u64],
        (nominal, own): (&[Drone<f64>], Option<&[Drone<f64>]>),
        rates: &[Rates],
        (data, ask, extra): (&mut SimData<N>, &Ask<N>, Extra<N>),
    ) {
        if options.n_steps == 0 {
            return;
        }
        if self.arrays.columns.is_empty() {
            self.arrays = Arrays::of(data);
        }
        self.prepare(options, (nominal, own), rates, data.n_worlds);
        if let Ask::Sweep(_, _, parameters) | Ask::Pilot(_, _, parameters) = ask {
            self.prepare_back(options, (nominal, own), rates, data.n_worlds, parameters);
        }
        let begun = self.take_up().then(Instant::now);
        let threads = crate::pool::threads();
        while self.scratch.len() < threads + 1 {
            self.scratch.push(Mutex::default());
        }
        let n_effects = self.place_effects(nominal, 1.0 / f64::from(options.sim_hz));
        let (worlds_at_once, parallel) = self.worlds_at_once(ask, data.n_worlds, options.n_steps, threads);
        let sizes = (data.command_width, &data.memory_columns[..]);
        let job = job(ask, sizes, self.kinds.iter().any(|k| k.neighbours > 0));
        let shared = Shared {
            options: *options,
            kinds: &self.kinds,
            scratch: &self.scratch,
            level: self.level,
            stamp: self.stamp,
            read: [
                &data.command,
                &data.disturbance_force,
                &data.disturbance_torque,
                &data.wind,
                &data.ground_z,
                &data.ceiling_z,
            ],
            episodes: &data.episodes,
            seeds,
            nominal,
            own,
            effects_from: &self.effects_from,
            worlds_at_once,
            parallel,
            job,
        };
        let view = View {
            first: 0,
            n_worlds: data.n_worlds,
            n_drones: nominal.len(),
            n_effects,
            out: [
                &mut data.pos,
                &mut data.quat,
                &mut data.vel,
                &mut data.ang_vel,
                &mut data.rotor_vel,
                &mut data.thrust,
                &mut data.controller_memory,
                &mut data.rotor_command,
                &mut data.attitude_command,
                &mut data.effect_memory,
            ],
            written: self.arrays.written,
            steps: &mut data.steps,
            quarantine: &mut data.quarantine,
            extra,
        };
        shared.spread(view);
        if let Some(begun) = begun {
            self.note_interpreted(begun.elapsed());
        }
    }

    /// Takes up what was compiled since the last call; whether byte code still flies something that can be compiled.
    fn take_up(&mut self) -> bool {
        let mut waits = false;
        for plan in self.kinds.iter_mut().flat_map(Kind::all_plans_mut) {
            waits |= plan.take_up();
        }
        waits
    }

    /// Byte code flew for so long: has its steps compiled as soon as that is worth it.
    fn note_interpreted(&mut self, took: Duration) {
        self.interpreted += took;
        if self.interpreted > WORTH_COMPILING {
            self.requests().iter().for_each(Request::begin);
        }
    }

    /// What is compiled, or may be.
    pub fn requests(&self) -> Vec<Arc<Request>> {
        self.kinds.iter().flat_map(Kind::all_plans).filter_map(|plan| plan.request.clone()).collect()
    }

    /// Traces the steps that a call with these options flies, without flying them.
    pub fn trace(
        &mut self,
        options: &Options,
        drones: (&[Drone<f64>], Option<&[Drone<f64>]>),
        rates: &[Rates],
        data: &SimData<N>,
    ) {
        if self.arrays.columns.is_empty() {
            self.arrays = Arrays::of(data);
        }
        self.prepare(options, drones, rates, data.n_worlds);
    }

    /// How many worlds one leaf of the recursion takes, and whether threads share the work.
    fn worlds_at_once(&self, ask: &Ask<N>, n_worlds: usize, n_steps: usize, threads: usize) -> (usize, bool) {
        let most = self.kinds.iter().map(|k| k.slots.len()).max().unwrap_or(1);
        let n_drones: usize = self.kinds.iter().map(|k| k.slots.len()).sum();
        let compiled = self.kinds.iter().all(|k| k.is_compiled::<N::Cell>(self.level));
        let narrow = compiled || matches!(ask, Ask::Pilot(..) | Ask::Commander(..));
        let lanes = if narrow { N::Cell::LANES } else { N::Four::LANES };
        let parallel = threads > 1 && work(n_worlds * n_drones, n_steps) >= SERIAL_LIMIT;
        let near = self.kinds.iter().any(|k| k.neighbours > 0);
        // Several blocks share what a leaf of the recursion costs, as long as every thread has enough of them.
        let blocks = (n_worlds * most).div_ceil(lanes) / if parallel { 4 * threads } else { 1 };
        // What is kept of many steps that are undone fills the cache that several blocks would share.
        let undone = matches!(ask, Ask::Sweep(..) | Ask::Pilot(..));
        let alone = near || undone && n_steps > FEW_STEPS;
        let at_once = if alone { 1 } else { blocks.clamp(1, BLOCKS_AT_ONCE) };
        ((lanes * at_once).div_ceil(most).max(1), parallel)
    }

    /// Places the memory of the effects of every slot within that of a world; returns its length.
    fn place_effects(&mut self, nominal: &[Drone<f64>], dt: f64) -> usize {
        self.effects_from.clear();
        let mut n_effects = 0;
        for drone in nominal {
            self.effects_from.push(n_effects);
            n_effects += drone.memory_len(dt);
        }
        n_effects
    }

    /// Finds kinds, programs and tables that are missing or out of date.
    fn prepare(
        &mut self,
        options: &Options,
        (nominal, own): (&[Drone<f64>], Option<&[Drone<f64>]>),
        rates: &[Rates],
        n_worlds: usize,
    ) {
        let all = self.changed.is_none();
        let changed = self.changed.get_or_insert_default();
        let planned =
            |k: &Kind<N>| k.plans.iter().filter(|p| p.phase == options.phase).count() == k.dues.len();
        if !all && changed.is_empty() && self.kinds.iter().all(planned) {
            return;
        }
        if all {
            self.kinds = kinds(options, nominal, rates);
        }
        let drone = |row: usize| match own {
            Some(own) => &own[row],
            None => &nominal[row % nominal.len()],
        };
        let n_rows = n_worlds * nominal.len();
        let means = Means { backend: self.backend.as_deref(), compile: self.compile, level: self.level };
        for kind in &mut self.kinds {
            let rate = &rates[kind.slots[0]];
            if all {
                kind.typical = fixed(drone(kind.slots[0]), rate, options.sim_hz);
                kind.varies = vec![false; kind.typical.len()];
            }
            let numbers = |row: usize, out: &mut Vec<f64>| fixed_into(drone(row), rate, options.sim_hz, out);
            let mine = |row: &usize| kind.slots.contains(&(row % nominal.len()));
            let rows: Vec<usize> = match own {
                Some(_) if all => (0..n_rows).filter(mine).collect(),
                Some(_) => changed.iter().copied().filter(mine).collect(),
                None if all => kind.slots.clone(),
                None => Vec::new(),
            };
            if kind.note_differences(&rows, numbers) {
                kind.plans.clear();
                kind.back = None;
            }
            let dues = kind.dues.clone();
            for due in dues {
                let known = |p: &Plan<N>| p.phase == options.phase && p.due == due;
                if !kind.plans.iter().any(known) {
                    let shape = Shape {
                        mode: options.mode,
                        integrator: options.integrator,
                        phase: options.phase,
                        due,
                        sim_hz: options.sim_hz,
                        neighbours: kind.neighbours,
                    };
                    let schedule = scheduled(&nominal[kind.slots[0]], &shape, &|k| kind.varies[k]);
                    let scratch = kind.n_home + kind.plans.iter().map(|p| p.program.len).sum::<usize>();
                    kind.plans.push(Plan::new(&shape, schedule, scratch, means));
                    let plan = kind.plans.last_mut();
                    if let Some(plan) = plan {
                        plan.fill(&kind.typical, &kind.varies, kind.slots.len() * n_worlds);
                        plan.fill_rows(&kind.slots, nominal.len(), n_worlds, None, numbers);
                    }
                    self.stamp += 1;
                }
            }
            if !changed.is_empty() {
                self.stamp += 1;
                let backwards = kind.back.iter_mut().flat_map(|back| &mut back.plans);
                for plan in kind.plans.iter_mut().chain(backwards) {
                    plan.fill_rows(&kind.slots, nominal.len(), n_worlds, Some(changed), numbers);
                }
            }
            kind.collect(&self.arrays);
        }
        changed.clear();
    }
}

/// What each part of the worlds is to do; `sizes` are those of [`Sequence::new`], `near`: whether drones feel each other.
fn job<'a, N: Number>(ask: &Ask<'a, N>, sizes: (usize, &[usize]), near: bool) -> Job<'a, N> {
    match *ask {
        Ask::Steps => Job::Steps,
        Ask::Record(ref commands, looks) => Job::Record(Sequence::new(commands, sizes, (near, false)), looks),
        Ask::Pilot(ref commands, pilot, _) => Job::Pilot(Sequence::new(commands, sizes, (near, true)), pilot),
        Ask::Commander(ref commands, commander) => {
            Job::Commander(Sequence::new(commands, sizes, (near, true)), commander)
        }
        Ask::Sweep(ref commands, seeds, _) => {
            Job::Sweep(Sequence::new(commands, sizes, (near, false)), seeds)
        }
    }
}

impl<N: Number> Lanes<N> {
    /// Traces the steps backwards where they were not yet, with gains by these fixed numbers of each drone slot.
    fn prepare_back(
        &mut self,
        options: &Options,
        (nominal, own): (&[Drone<f64>], Option<&[Drone<f64>]>),
        rates: &[Rates],
        n_worlds: usize,
        parameters: &[Vec<usize>],
    ) {
        let means = Means { backend: None, compile: self.compile, level: self.level };
        for kind in &mut self.kinds {
            let slot = kind.slots[0];
            let numbers = |row: usize, out: &mut Vec<f64>| {
                let drone = own.map_or(&nominal[row % nominal.len()], |own| &own[row]);
                fixed_into(drone, &rates[slot], options.sim_hz, out);
            };
            let sizes = (nominal.len(), n_worlds);
            if kind.trace_back(options, &nominal[slot], &parameters[slot], sizes, means, numbers) {
                self.stamp += 1;
            }
        }
    }
}

impl<N: Number> Shared<'_, N> {
    /// Halves the worlds until few enough are left to be taken at once.
    fn spread(&self, view: View<N>) {
        if view.n_worlds <= self.worlds_at_once {
            let thread = rayon::current_thread_index().unwrap_or(self.scratch.len() - 1);
            let slot = &self.scratch[thread.min(self.scratch.len() - 1)];
            // A panic in another thread leaves nothing behind that this one would read.
            let mut scratch = slot.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            return match &self.job {
                Job::Steps => self.advance(view, &mut scratch),
                Job::Record(sequence, looks) => self.record(view, &mut scratch, (sequence, *looks)),
                Job::Pilot(sequence, pilot) => self.piloted(view, &mut scratch, sequence, *pilot),
                Job::Commander(sequence, commander) => {
                    self.commanded(view, &mut scratch, sequence, *commander);
                }
                Job::Sweep(sequence, seeds) => self.sweep(view, &mut scratch, sequence, seeds),
            };
        }
        let parts = view.n_worlds.div_ceil(self.worlds_at_once);
        let (low, high) = view.split(parts / 2 * self.worlds_at_once);
        if self.parallel {
            rayon::join(|| self.spread(low), || self.spread(high));
        } else {
            self.spread(low);
            self.spread(high);
        }
    }

    /// All steps of a few worlds.
    fn advance(&self, mut view: View<N>, scratch: &mut Scratch<N>) {
        self.load(&view, scratch, false);
        self.steps(&view, scratch, Steps::whole(0, self.options.n_steps));
        if self.options.phase == Phase::Controllers || scratch.finite(self.level) {
            return self.put_back(&mut view, scratch, self.options.n_steps);
        }
        self.load(&view, scratch, true);
        self.one_by_one(&mut view, scratch, self.options.n_steps);
    }

    /// Writes back all drones that were loaded, after `n` steps.
    fn put_back(&self, view: &mut View<N>, scratch: &mut Scratch<N>, n: usize) {
        scratch.one.store(self, view, &[]);
        scratch.two.store(self, view, &[]);
        scratch.four.store(self, view, &[]);
        if self.options.phase != Phase::Controllers {
            for w in 0..view.n_worlds {
                if view.quarantine[w].is_none() {
                    view.steps[w] += n as u64;
                }
            }
        }
    }

    /// Fills lanes with the drones of all worlds that are not quarantined: with all their numbers, or with those that matter before
    /// the first step.
    fn load(&self, view: &View<N>, scratch: &mut Scratch<N>, all: bool) {
        let Scratch { one, two, four, .. } = scratch;
        (one.used, two.used, four.used) = (0, 0, 0);
        for (index, kind) in self.kinds.iter().enumerate() {
            let mut next = (0, 0);
            let asked = matches!(self.job, Job::Pilot(..) | Job::Commander(..));
            let compiled = kind.is_compiled::<N::Cell>(self.level) || asked;
            let mut left = view.quarantine.iter().filter(|q| q.is_none()).count() * kind.slots.len();
            while left > 0 {
                let taken = if !compiled && left > N::Two::LANES {
                    four.fill(self, view, index, &mut next, all)
                } else if !compiled && left > N::Cell::LANES {
                    two.fill(self, view, index, &mut next, all)
                } else {
                    one.fill(self, view, index, &mut next, all)
                };
                left -= taken.min(left);
            }
        }
    }

    /// Takes steps.
    fn steps(&self, view: &View<N>, scratch: &mut Scratch<N>, steps: Steps) {
        let Steps { from, n, begin, end, told } = steps;
        let near = self.kinds.iter().any(|k| k.neighbours > 0);
        let at_once = if near { 1 } else { n };
        let mut done = 0;
        while done < n {
            if near {
                scratch.look_around(view.n_worlds * view.n_drones);
            }
            let now = Steps {
                from: from + done,
                n: at_once,
                begin: begin && done == 0,
                end: end && done + at_once == n,
                told: told && done == 0,
            };
            let Scratch { one, two, four, around, .. } = scratch;
            one.run(self, view, around, now);
            two.run(self, view, around, now);
            four.run(self, view, around, now);
            done += at_once;
        }
    }

    /// The same steps again, one at a time, to find the worlds that turn non-finite and the state before; all numbers are loaded.
    fn one_by_one(&self, view: &mut View<N>, scratch: &mut Scratch<N>, n: usize) {
        scratch.done.clear();
        scratch.done.resize(view.n_worlds, false);
        for s in 0..n {
            scratch.one.keep();
            scratch.two.keep();
            scratch.four.keep();
            self.steps(view, scratch, Steps::whole(s, 1));
            // The first drone of every world that has a number that is none.
            for w in 0..view.n_worlds {
                if scratch.done[w] || view.quarantine[w].is_some() {
                    continue;
                }
                let fault = (0..view.n_drones).find_map(|d| {
                    let row = (w * view.n_drones + d) as u32;
                    let Scratch { one, two, four, .. } = &*scratch;
                    one.fault(row).or_else(|| two.fault(row)).or_else(|| four.fault(row)).map(|q| (d, q))
                });
                let Some((drone, quantity)) = fault else { continue };
                for d in 0..view.n_drones {
                    let row = (w * view.n_drones + d) as u32;
                    scratch.one.store_row(self, view, row);
                    scratch.two.store_row(self, view, row);
                    scratch.four.store_row(self, view, row);
                }
                view.steps[w] += s as u64;
                view.quarantine[w] = Some(Box::new(Quarantine {
                    world: self.options.first_world + (view.first + w) as u64,
                    drone,
                    step: view.steps[w],
                    quantity: quantity.into(),
                    stage: None,
                }));
                scratch.done[w] = true;
            }
        }
        let Scratch { one, two, four, done, .. } = scratch;
        one.store(self, view, done);
        two.store(self, view, done);
        four.store(self, view, done);
        for w in 0..view.n_worlds {
            if view.quarantine[w].is_none() {
                view.steps[w] += n as u64;
            }
        }
    }
}

impl<N: Number> Scratch<N> {
    /// Whether all states are finite.
    fn finite(&self, level: Level) -> bool {
        self.one.finite(level) && self.two.finite(level) && self.four.finite(level)
    }

    /// Positions and velocities of all drones, by row.
    fn look_around(&mut self, rows: usize) {
        self.around.clear();
        self.around.resize(6 * rows, N::zero());
        self.one.show(&mut self.around);
        self.two.show(&mut self.around);
        self.four.show(&mut self.around);
    }
}
