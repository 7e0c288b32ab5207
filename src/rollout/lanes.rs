//! Many drones at once in the lanes of the processor.
//!
//! Drones of one kind (same parts, same rates) share a program: a generated kernel where there is one for their step, else byte
//! code. Worlds are taken a few at a time; the drones of a kind in them fill lanes, all steps of a call run while they sit in
//! cache, and only then their numbers go back to the public arrays. A lane depends on no other, so results do not depend on how
//! worlds are grouped.

use std::sync::Mutex;

use fearless_simd::Level;

use super::SimData;
use super::blocks::{Phase, Source as RandomSource};
use super::quarantine::Quarantine;
use super::traced::{Shape, bare, fixed, place, stages, told};
use crate::kernels;
use crate::physics::controllers::{COMMAND_WIDTH, ControlMode, Due, Memory, Rates};
use crate::physics::drone::Drone;
use crate::physics::effects::{AnyEffect, Effect};
use crate::physics::integrate::Integrator;
use crate::physics::rigid_body::MAX_ROTORS;
use crate::scalar::Real;
use crate::scalar::bytecode::{Interpret, Layout, Program};
use crate::scalar::kernel::{Entries, Kernel, key};
use crate::scalar::lanes::{Cell, Number, level};
use crate::scalar::stages::{Input, Output, Source, Stages};

/// Drone-steps below which waking other threads costs more than it saves (about 10 µs against 5 ns a step).
const SERIAL_LIMIT: usize = 10_000;

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

/// Programs, tables and working memory of a simulation.
#[derive(Debug)]
pub(super) struct Lanes<N: Number> {
    kinds: Vec<Kind<N>>,
    /// Rows whose parameters changed since their tables were filled; `None` for all.
    changed: Option<Vec<usize>>,
    /// Counts fillings of tables.
    stamp: u64,
    /// One per thread, so that none waits.
    scratch: Vec<Mutex<Scratch<N>>>,
    /// The instructions that are used.
    pub(super) level: Level,
}

impl<N: Number> Default for Lanes<N> {
    fn default() -> Self {
        Self { kinds: Vec::new(), changed: None, stamp: 0, scratch: Vec::new(), level: level() }
    }
}

/// Drone slots that fly by one program.
#[derive(Debug)]
struct Kind<N> {
    slots: Vec<usize>,
    /// Which stages tick at a step, by the step within a second, as places in `dues`.
    ticks: Vec<u8>,
    dues: Vec<Due>,
    plans: Vec<Plan<N>>,
    /// Cells of the home of a drone.
    n_home: usize,
    /// Fixed numbers of the drone that the tables were filled with, and which of them are others in some row.
    typical: Vec<f64>,
    varies: Vec<bool>,
    neighbours: usize,
    /// Places that some plan reads or leaves as they are, the same with those that every plan writes, and places that some plan
    /// writes.
    loads: Vec<Column>,
    all_loads: Vec<Column>,
    saves: Vec<Column>,
    noises: bool,
    effects: usize,
}

/// A number of every drone in the public arrays.
#[derive(Clone, Copy, Debug)]
struct Column {
    place: u32,
    /// Of [`View::out`], or from the tenth on of [`Shared::read`].
    array: usize,
    width: usize,
    col: usize,
}

/// The program of a kind for one set of stages that tick.
#[derive(Debug)]
struct Plan<N> {
    phase: Phase,
    due: Due,
    stages: Stages,
    kernel: Option<&'static Kernel>,
    program: Program,
    layout: Layout,
    /// (place, cell of the file) before the first step: places that some plan writes, and those that stay the same in a call.
    enter: Parted<(u32, u32)>,
    /// (cell of the file, place) after the last: what a plan may read later in the call, and what only the public arrays want.
    leave: Parted<(u32, u32)>,
    /// (constant, place) after the last step of a call.
    constants: Vec<(N, u32)>,
    /// (place, place) after the last: what stays as it came.
    copies: Vec<(u32, u32)>,
    /// Whether a plan may read later in the call what is computed after the last step.
    finishes: bool,
    /// (place, cell) that are other numbers in every step.
    fresh: Vec<(u32, u32)>,
    table: Vec<N>,
    /// Entries of the table that differ between rows, and their numbers: (row, entry).
    varying: Vec<u32>,
    rows: Vec<N>,
}

/// What is done whenever other stages begin to tick within a call, and what once per call is enough for.
#[derive(Debug)]
struct Parted<T> {
    often: Vec<T>,
    once: Vec<T>,
}

impl<T: Copy> Parted<T> {
    fn new(often: Vec<T>) -> Self {
        Self { often, once: Vec::new() }
    }

    fn iter(&self) -> impl Iterator<Item = &T> {
        self.often.iter().chain(&self.once)
    }

    fn part(&mut self, is_often: impl Fn(&T) -> bool) {
        let all: Vec<T> = self.iter().copied().collect();
        (self.often, self.once) = all.into_iter().partition(is_often);
    }
}

/// Which steps of a call a segment is.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// Place of the plan that flies it.
    plan: usize,
    /// Steps since the start of the call, and number of steps.
    from: usize,
    n: usize,
    /// Whether the plan has not run yet with these drones, and whether nothing comes after.
    first: bool,
    last: bool,
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

#[derive(Debug)]
struct Pool<C> {
    packs: Vec<Pack<C>>,
    used: usize,
    /// By kind and plan.
    files: Vec<File<C>>,
}

impl<C> Default for Pool<C> {
    fn default() -> Self {
        Self { packs: Vec::new(), used: 0, files: Vec::new() }
    }
}

#[derive(Debug)]
struct File<C> {
    cells: Vec<C>,
    stamp: u64,
}

/// Drones in the lanes of one cell type.
#[derive(Debug)]
struct Pack<C> {
    kind: usize,
    /// Row of every lane within the view; lanes without a drone of their own repeat the last.
    rows: Vec<u32>,
    n: usize,
    /// Their numbers, by place.
    home: Vec<C>,
    /// The same before the step, where steps are taken one by one.
    before: Vec<C>,
    /// The same before and after a step in which different stages tick in different lanes.
    mixed: Vec<C>,
    merged: Vec<C>,
}

/// The arrays of some consecutive worlds.
struct View<'a, N> {
    /// Index of the first world.
    first: usize,
    n_worlds: usize,
    n_drones: usize,
    /// Numbers of effects per world.
    n_effects: usize,
    /// What steps change: see [`written`].
    out: [&'a mut [N]; 10],
    steps: &'a mut [u64],
    quarantine: &'a mut [Option<Quarantine>],
}

/// Widths of the arrays that steps change, with the place of their first number: position, attitude, velocity, angular velocity,
/// rotor speeds, thrust, memory of the controllers, rotor command, attitude command. The tenth is the memory of effects.
const WRITTEN: [(u32, usize); 9] = [
    (place::STATE, 3),
    (place::QUAT, 4),
    (place::VEL, 3),
    (place::ANG_VEL, 3),
    (place::ROTOR_VEL, MAX_ROTORS),
    (place::THRUST, 1),
    (place::MEMORY, Memory::<f64>::LEN),
    (place::ROTOR_COMMAND, MAX_ROTORS),
    (place::ATTITUDE_COMMAND, 4),
];

/// The same of those that are only read: command, disturbing force and torque, wind, ground, ceiling.
const READ: [(u32, usize); 6] = [
    (place::COMMAND, COMMAND_WIDTH),
    (place::FORCE, 3),
    (place::TORQUE, 3),
    (place::WIND, 3),
    (place::GROUND, 1),
    (place::CEILING, 1),
];

impl<'a, N> View<'a, N> {
    /// The first worlds and the rest.
    fn split(self, worlds: usize) -> (Self, Self) {
        let (mut low, mut high): ([&mut [N]; 10], [&mut [N]; 10]) = Default::default();
        for (i, array) in self.out.into_iter().enumerate() {
            let width = WRITTEN.get(i).map_or(self.n_effects, |(_, width)| width * self.n_drones);
            (low[i], high[i]) = array.split_at_mut(worlds * width);
        }
        let (steps, more_steps) = self.steps.split_at_mut(worlds);
        let (quarantine, more_quarantine) = self.quarantine.split_at_mut(worlds);
        let (n_drones, n_effects) = (self.n_drones, self.n_effects);
        (
            View { first: self.first, n_worlds: worlds, n_drones, n_effects, out: low, steps, quarantine },
            View {
                first: self.first + worlds,
                n_worlds: self.n_worlds - worlds,
                n_drones,
                n_effects,
                out: high,
                steps: more_steps,
                quarantine: more_quarantine,
            },
        )
    }
}

/// What all threads read.
struct Shared<'a, N: Number> {
    options: Options,
    kinds: &'a [Kind<N>],
    scratch: &'a [Mutex<Scratch<N>>],
    level: Level,
    stamp: u64,
    /// Whole arrays that are only read: see [`READ`].
    read: [&'a [N]; 6],
    episodes: &'a [u64],
    nominal: &'a [Drone<f64>],
    own: Option<&'a [Drone<f64>]>,
    /// Where the memory of a slot's effects begins within that of its world.
    effects_from: &'a [usize],
    worlds_at_once: usize,
    parallel: bool,
}

impl<N: Number> Lanes<N> {
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

    /// Advances every world that is not quarantined.
    pub fn run(
        &mut self,
        options: &Options,
        nominal: &[Drone<f64>],
        own: Option<&[Drone<f64>]>,
        rates: &[Rates],
        data: &mut SimData<N>,
    ) {
        if options.n_steps == 0 {
            return;
        }
        self.prepare(options, nominal, own, rates, data.n_worlds);
        let threads = rayon::current_num_threads();
        while self.scratch.len() < threads + 1 {
            self.scratch.push(Mutex::default());
        }
        let mut effects_from = [0usize; 64];
        let many;
        let dt = 1.0 / f64::from(options.sim_hz);
        let mut n_effects = 0;
        let from: &[usize] = if nominal.len() <= effects_from.len() {
            for (slot, drone) in effects_from.iter_mut().zip(nominal) {
                *slot = n_effects;
                n_effects += drone.memory_len(dt);
            }
            &effects_from[..nominal.len()]
        } else {
            many = nominal
                .iter()
                .map(|drone| {
                    n_effects += drone.memory_len(dt);
                    n_effects - drone.memory_len(dt)
                })
                .collect::<Vec<_>>();
            &many
        };
        let most = self.kinds.iter().map(|k| k.slots.len()).max().unwrap_or(1);
        let compiled = self.kinds.iter().all(|k| k.is_compiled::<N::Cell>(self.level));
        let lanes = if compiled { N::Two::LANES } else { N::Four::LANES };
        let worlds_at_once = lanes.div_ceil(most).max(1);
        let work = data.n_worlds * nominal.len() * options.n_steps;
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
            nominal,
            own,
            effects_from: from,
            worlds_at_once,
            parallel: threads > 1 && work >= SERIAL_LIMIT,
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
            steps: &mut data.steps,
            quarantine: &mut data.quarantine,
        };
        shared.spread(view);
    }

    /// Finds kinds, programs and tables that are missing or out of date.
    fn prepare(
        &mut self,
        options: &Options,
        nominal: &[Drone<f64>],
        own: Option<&[Drone<f64>]>,
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
        for kind in &mut self.kinds {
            let rate = &rates[kind.slots[0]];
            if all {
                kind.typical = fixed(drone(kind.slots[0]), rate, options.sim_hz);
                kind.varies = vec![false; kind.typical.len()];
            }
            // Which numbers of some drone of this kind are not those that the table was filled with.
            let mut more = false;
            let mut differ = |row: usize| {
                let numbers = fixed(drone(row), rate, options.sim_hz);
                for ((varies, a), b) in kind.varies.iter_mut().zip(&kind.typical).zip(&numbers) {
                    if !*varies && a.to_bits() != b.to_bits() {
                        (*varies, more) = (true, true);
                    }
                }
            };
            let mine = |row: &usize| kind.slots.contains(&(row % nominal.len()));
            match own {
                Some(_) if all => (0..n_rows).filter(mine).for_each(&mut differ),
                Some(_) => changed.iter().copied().filter(mine).for_each(&mut differ),
                None if all => kind.slots.iter().copied().for_each(&mut differ),
                None => {}
            }
            if more {
                kind.plans.clear();
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
                    let cut = stages(&nominal[kind.slots[0]], &shape, &|k| kind.varies[k]);
                    kind.plans.push(Plan::new(&shape, cut));
                    let plan = kind.plans.last_mut();
                    if let Some(plan) = plan {
                        plan.fill(&kind.typical, &kind.varies, kind.slots.len() * n_worlds);
                        plan.fill_rows(kind.slots.as_slice(), nominal.len(), n_worlds, None, |row| {
                            fixed(drone(row), rate, options.sim_hz)
                        });
                    }
                    self.stamp += 1;
                }
            }
            if !changed.is_empty() {
                self.stamp += 1;
                for plan in &mut kind.plans {
                    plan.fill_rows(kind.slots.as_slice(), nominal.len(), n_worlds, Some(changed), |row| {
                        fixed(drone(row), rate, options.sim_hz)
                    });
                }
            }
            kind.collect();
        }
        changed.clear();
    }
}

/// Groups drone slots by what their programs are made of.
fn kinds<N: Number>(options: &Options, nominal: &[Drone<f64>], rates: &[Rates]) -> Vec<Kind<N>> {
    let bare: Vec<Drone<f64>> = nominal.iter().map(bare).collect();
    let mut kinds: Vec<Kind<N>> = Vec::new();
    let wash = |e: &AnyEffect<f64>| matches!(e, AnyEffect::Downwash(_));
    for d in 0..nominal.len() {
        let same = |k: &&mut Kind<N>| bare[k.slots[0]] == bare[d] && rates[k.slots[0]] == rates[d];
        if let Some(kind) = kinds.iter_mut().find(same) {
            kind.slots.push(d);
            continue;
        }
        let mut dues: Vec<Due> = Vec::new();
        let mut ticks = Vec::new();
        // Ticks repeat every second. Which of them matter depends on the control mode.
        for step in 0..options.sim_hz {
            let due = rates[d].due(options.mode, step.into(), options.sim_hz);
            let due = told(options.mode, due);
            let at = dues.iter().position(|known| *known == due).unwrap_or(dues.len());
            if at == dues.len() {
                dues.push(due);
            }
            ticks.push(at as u8);
        }
        let reads = nominal[d].effects.iter().any(wash);
        kinds.push(Kind {
            slots: vec![d],
            ticks,
            dues,
            plans: Vec::new(),
            n_home: 0,
            typical: Vec::new(),
            varies: Vec::new(),
            neighbours: if reads { nominal.len() - 1 } else { 0 },
            loads: Vec::new(),
            all_loads: Vec::new(),
            saves: Vec::new(),
            noises: nominal[d].effects.iter().any(Effect::noises),
            effects: nominal[d].memory_len(1.0 / f64::from(options.sim_hz)),
        });
    }
    kinds
}

impl<N: Number> Plan<N> {
    fn new(shape: &Shape, stages: Stages) -> Self {
        let layout = Layout {
            given: stages.n_table as u32,
            call: (stages.n_table + stages.given.len()) as u32,
            state: (stages.n_table + stages.given.len() + stages.n_call) as u32,
            constants: (stages.n_table + stages.given.len() + stages.n_call + stages.state.len()) as u32,
        };
        let wanted = key(&stages);
        let kernel = kernels::ALL.iter().find(|k| k.key == wanted);
        // Byte code too where there is a kernel: not all types of cells and levels have its functions.
        let program = Program::new(&stages, layout);
        let (mut enter, mut leave, mut fresh) = (Vec::new(), Vec::new(), Vec::new());
        let given = stages.given.iter().zip(layout.given..);
        let state = stages.state.iter().map(|s| s.input).zip(layout.state..);
        for (input, cell) in given.map(|(i, cell)| (Some(*i), cell)).chain(state) {
            match input {
                Some(Input::Given(p) | Input::Carried(p)) => enter.push((p, cell)),
                Some(Input::Fresh(p)) => fresh.push((p, cell)),
                Some(Input::Fixed(_)) | None => {}
            }
        }
        let of = |output: &Output| output.place();
        for (slot, cell) in stages.state.iter().zip(layout.state..) {
            leave.extend(slot.output.map(|o| (cell, o.place())));
        }
        let (mut constants, mut copies) = (Vec::new(), Vec::new());
        for (output, source) in &stages.finals {
            match source {
                Source::Call(k) => leave.push((layout.call + k, of(output))),
                Source::State(k) => leave.push((layout.state + k, of(output))),
                Source::Constant(v) => constants.push((N::of(*v), of(output))),
                Source::Input(Input::Given(p) | Input::Carried(p)) => copies.push((*p, of(output))),
                Source::Input(_) => {}
            }
        }
        Self {
            phase: shape.phase,
            due: shape.due,
            stages,
            kernel,
            program,
            layout,
            enter: Parted::new(enter),
            leave: Parted::new(leave),
            constants,
            copies,
            finishes: true,
            fresh,
            table: Vec::new(),
            varying: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// The kernel for cells of this type. Blocks side by side share their table, so it must be the same for all drones then.
    fn entries<C: Interpret<Number = N>>(&self, level: Level) -> Option<Entries<C>> {
        let alike = C::LANES == N::Cell::LANES || self.varying.is_empty();
        self.kernel.filter(|_| alike).and_then(|k| C::entries(k, level))
    }

    /// The table of the first drone, and which of its entries differ between drones.
    fn fill(&mut self, first: &[f64], varies: &[bool], n_rows: usize) {
        let once = &self.stages.once;
        self.table = once.eval(first).into_iter().map(N::of).collect();
        let mut depends: Vec<bool> = Vec::with_capacity(once.nodes.len());
        for node in &once.nodes {
            let own = matches!(node, crate::scalar::trace::Node::Input(k) if varies[*k as usize]);
            let any = own || node.operands().any(|o| depends[o as usize]);
            depends.push(any);
        }
        let entries = once.outputs.iter().enumerate().filter(|(_, o)| depends[**o as usize]);
        self.varying = entries.map(|(i, _)| i as u32).collect();
        self.rows = vec![N::zero(); n_rows * self.varying.len()];
    }

    /// The entries that differ, of all drones of a kind or of those whose parameters changed.
    fn fill_rows(
        &mut self,
        slots: &[usize],
        n_drones: usize,
        n_worlds: usize,
        changed: Option<&[usize]>,
        fixed: impl Fn(usize) -> Vec<f64>,
    ) {
        if self.varying.is_empty() {
            return;
        }
        let width = self.varying.len();
        let mut fill = |world: usize, i: usize| {
            let values = self.stages.once.eval(&fixed(world * n_drones + slots[i]));
            let row = (world * slots.len() + i) * width;
            for (to, entry) in self.rows[row..row + width].iter_mut().zip(&self.varying) {
                *to = N::of(values[*entry as usize]);
            }
        };
        match changed {
            None => (0..n_worlds).for_each(|w| (0..slots.len()).for_each(|i| fill(w, i))),
            Some(rows) => {
                for row in rows {
                    if let Some(i) = slots.iter().position(|s| *s == row % n_drones) {
                        fill(row / n_drones, i);
                    }
                }
            }
        }
    }
}

impl<N: Number> Kind<N> {
    /// What all plans together read and write.
    fn collect(&mut self) {
        let neighbours = self.neighbours * place::NEIGHBOUR as usize;
        self.n_home = place::EFFECTS as usize + self.effects + neighbours;
        let n_plans = self.plans.len();
        let (mut reads, mut writers) = (vec![false; self.n_home], vec![0; self.n_home]);
        for plan in &self.plans {
            let enters = plan.enter.iter().map(|(p, _)| p).chain(plan.copies.iter().map(|(p, _)| p));
            enters.for_each(|p| reads[*p as usize] = true);
            let leaves = plan.leave.iter().map(|(_, p)| p).chain(plan.constants.iter().map(|(_, p)| p));
            leaves.chain(plan.copies.iter().map(|(_, p)| p)).for_each(|p| writers[*p as usize] += 1);
        }
        // What one plan writes and another does not keeps what it was.
        let kept = |p: u32| reads[p as usize] || writers[p as usize] < n_plans;
        for plan in &mut self.plans {
            plan.enter.part(|(p, _)| writers[*p as usize] > 0);
            plan.leave.part(|(_, p)| kept(*p));
            // A cell may go to several places.
            let finished = |cell: u32| {
                plan.stages.finish.stores.iter().any(|(_, slot)| plan.layout.state + slot == cell)
            };
            plan.finishes = plan.leave.often.iter().any(|(cell, _)| finished(*cell));
        }
        let places = 0..self.n_home as u32;
        let saves: Vec<u32> = places.clone().filter(|p| writers[*p as usize] > 0).collect();
        // The state is looked at even where it does not change.
        let looked_at = |p: u32| (place::STATE..place::MEMORY).contains(&p);
        let is_loaded = |p: &u32| {
            reads[*p as usize]
                || looked_at(*p)
                || (writers[*p as usize] > 0 && writers[*p as usize] < n_plans)
        };
        let loads: Vec<u32> = places.clone().filter(is_loaded).collect();
        let all_loads: Vec<u32> = places.filter(|p| is_loaded(p) || writers[*p as usize] > 0).collect();
        let columns = |mut list: Vec<u32>| {
            list.sort_unstable();
            list.dedup();
            list.into_iter().filter_map(|p| column(p, self.effects)).collect::<Vec<Column>>()
        };
        (self.loads, self.all_loads, self.saves) = (columns(loads), columns(all_loads), columns(saves));
    }

    /// Whether kernels fly this kind in cells of this type.
    fn is_compiled<C: Interpret<Number = N>>(&self, level: Level) -> bool {
        self.plans.iter().all(|p| p.entries::<C>(level).is_some())
    }

    /// Place of the plan for a step.
    fn plan(&self, phase: Phase, step: u64) -> usize {
        let due = self.dues[usize::from(self.ticks[(step % self.ticks.len() as u64) as usize])];
        self.plans.iter().position(|p| p.phase == phase && p.due == due).unwrap_or(0)
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
            return self.advance(view, &mut scratch);
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
        self.steps(&view, scratch, 0, self.options.n_steps);
        if self.options.phase == Phase::Controllers || scratch.finite() {
            scratch.one.store(self, &mut view, &[]);
            scratch.two.store(self, &mut view, &[]);
            scratch.four.store(self, &mut view, &[]);
            if self.options.phase != Phase::Controllers {
                for w in 0..view.n_worlds {
                    if view.quarantine[w].is_none() {
                        view.steps[w] += self.options.n_steps as u64;
                    }
                }
            }
            return;
        }
        self.one_by_one(view, scratch);
    }

    /// Fills lanes with the drones of all worlds that are not quarantined: with all their numbers, or with those that matter before
    /// the first step.
    fn load(&self, view: &View<N>, scratch: &mut Scratch<N>, all: bool) {
        let Scratch { one, two, four, .. } = scratch;
        (one.used, two.used, four.used) = (0, 0, 0);
        for (index, kind) in self.kinds.iter().enumerate() {
            let mut next = (0, 0);
            let compiled = kind.is_compiled::<N::Cell>(self.level);
            let pairs = !compiled || kind.is_compiled::<N::Two>(self.level);
            let mut left = view.quarantine.iter().filter(|q| q.is_none()).count() * kind.slots.len();
            while left > 0 {
                let taken = if !compiled && left > N::Two::LANES {
                    four.fill(self, view, index, &mut next, all)
                } else if pairs && left > N::Cell::LANES {
                    two.fill(self, view, index, &mut next, all)
                } else {
                    one.fill(self, view, index, &mut next, all)
                };
                left -= taken.min(left);
            }
        }
    }

    /// Takes `n` steps, the first of them `from` steps after the start of the call.
    fn steps(&self, view: &View<N>, scratch: &mut Scratch<N>, from: usize, n: usize) {
        let near = self.kinds.iter().any(|k| k.neighbours > 0);
        let at_once = if near { 1 } else { n };
        let mut done = 0;
        while done < n {
            if near {
                scratch.look_around(view.n_worlds * view.n_drones);
            }
            let Scratch { one, two, four, around, .. } = scratch;
            one.run(self, view, around, from + done, at_once);
            two.run(self, view, around, from + done, at_once);
            four.run(self, view, around, from + done, at_once);
            done += at_once;
        }
    }

    /// The same steps again, one at a time, to find the worlds that turn non-finite and the state before.
    fn one_by_one(&self, mut view: View<N>, scratch: &mut Scratch<N>) {
        self.load(&view, scratch, true);
        scratch.done.clear();
        scratch.done.resize(view.n_worlds, false);
        for s in 0..self.options.n_steps {
            scratch.one.keep();
            scratch.two.keep();
            scratch.four.keep();
            self.steps(&view, scratch, s, 1);
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
                    scratch.one.store_row(self, &mut view, row);
                    scratch.two.store_row(self, &mut view, row);
                    scratch.four.store_row(self, &mut view, row);
                }
                view.steps[w] += s as u64;
                view.quarantine[w] = Some(Quarantine {
                    world: self.options.first_world + (view.first + w) as u64,
                    drone,
                    step: view.steps[w],
                    quantity: quantity.into(),
                    stage: None,
                });
                scratch.done[w] = true;
            }
        }
        let Scratch { one, two, four, done, .. } = scratch;
        one.store(self, &mut view, done);
        two.store(self, &mut view, done);
        four.store(self, &mut view, done);
        for w in 0..view.n_worlds {
            if view.quarantine[w].is_none() {
                view.steps[w] += self.options.n_steps as u64;
            }
        }
    }
}

impl<N: Number> Scratch<N> {
    /// Whether all states are finite.
    fn finite(&self) -> bool {
        self.one.finite() && self.two.finite() && self.four.finite()
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

impl<C: Interpret> Pool<C> {
    /// Fills a pack with the next drones of a kind; `next` is (world, place among the kind's slots). Returns how many.
    fn fill(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        kind: usize,
        next: &mut (usize, usize),
        all: bool,
    ) -> usize {
        let of = &shared.kinds[kind];
        if self.packs.len() == self.used {
            self.packs.push(Pack {
                kind,
                rows: Vec::new(),
                n: 0,
                home: Vec::new(),
                before: Vec::new(),
                mixed: Vec::new(),
                merged: Vec::new(),
            });
        }
        let pack = &mut self.packs[self.used];
        self.used += 1;
        pack.kind = kind;
        pack.rows.clear();
        while pack.rows.len() < C::LANES && next.0 < view.n_worlds {
            if view.quarantine[next.0].is_some() {
                *next = (next.0 + 1, 0);
                continue;
            }
            pack.rows.push((next.0 * view.n_drones + of.slots[next.1]) as u32);
            next.1 += 1;
            if next.1 == of.slots.len() {
                *next = (next.0 + 1, 0);
            }
        }
        pack.n = pack.rows.len();
        let last = pack.rows.last().copied().unwrap_or(0);
        pack.rows.resize(C::LANES, last);
        if pack.home.len() < of.n_home {
            pack.home.resize(of.n_home, C::splat(C::Number::zero()));
        }
        pack.load(shared, view, all);
        pack.n
    }

    fn run(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        from: usize,
        n: usize,
    ) {
        for pack in &mut self.packs[..self.used] {
            pack.run(shared, view, around, &mut self.files, from, n);
        }
    }

    fn keep(&mut self) {
        for pack in &mut self.packs[..self.used] {
            pack.before.clear();
            pack.before.extend_from_slice(&pack.home);
        }
    }

    fn finite(&self) -> bool {
        self.packs[..self.used].iter().all(Pack::finite)
    }

    fn show(&self, around: &mut [C::Number]) {
        for pack in &self.packs[..self.used] {
            for lane in 0..pack.n {
                let row = pack.rows[lane] as usize;
                for i in 0..3 {
                    around[6 * row + i] = pack.home[place::STATE as usize + i].get(lane);
                    around[6 * row + 3 + i] = pack.home[place::VEL as usize + i].get(lane);
                }
            }
        }
    }

    /// What is not finite of one drone.
    fn fault(&self, row: u32) -> Option<&'static str> {
        let packs = &self.packs[..self.used];
        let (pack, lane) = packs.iter().find_map(|p| Some((p, p.rows.iter().position(|r| *r == row)?)))?;
        let bad = |from: u32, n: usize| (0..n).any(|i| !pack.home[from as usize + i].get(lane).finite());
        [
            ("position", bad(place::STATE, 3)),
            ("attitude", bad(place::QUAT, 4)),
            ("velocity", bad(place::VEL, 3)),
            ("angular velocity", bad(place::ANG_VEL, 3)),
            ("rotor speed", bad(place::ROTOR_VEL, MAX_ROTORS)),
            ("thrust", bad(place::THRUST, 1)),
        ]
        .into_iter()
        .find_map(|(name, is_bad)| is_bad.then_some(name))
    }

    /// Writes one drone back as it was before the step.
    fn store_row(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>, row: u32) {
        for pack in &self.packs[..self.used] {
            if let Some(lane) = pack.rows.iter().position(|r| *r == row) {
                pack.store_lane(shared, view, &pack.before, lane);
                return;
            }
        }
    }

    /// Writes all drones back but those of worlds that are done.
    fn store(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>, done: &[bool]) {
        for pack in &self.packs[..self.used] {
            if done.iter().any(|d| *d) {
                for lane in 0..pack.n {
                    if !done[pack.rows[lane] as usize / view.n_drones] {
                        pack.store_lane(shared, view, &pack.home, lane);
                    }
                }
            } else {
                pack.store(shared, view);
            }
        }
    }
}

/// Where a place stands in the public arrays; nowhere for time, random numbers and neighbours.
fn column(p: u32, n_effects: usize) -> Option<Column> {
    let at = |array, first: u32, width| Column { place: p, array, width, col: (p - first) as usize };
    if p >= place::EFFECTS {
        return (p < place::EFFECTS + n_effects as u32).then(|| at(9, place::EFFECTS, 0));
    }
    let within = |(_, (first, width)): &(usize, &(u32, usize))| p >= *first && p < first + *width as u32;
    let written = WRITTEN.iter().enumerate().find(within).map(|(i, (first, width))| at(i, *first, *width));
    written.or_else(|| {
        READ.iter().enumerate().find(within).map(|(i, (first, width))| at(10 + i, *first, *width))
    })
}

impl<C: Interpret> Pack<C> {
    /// Number of an effect's memory in its array.
    fn effect_at(shared: &Shared<C::Number>, view: &View<C::Number>, row: usize, col: usize) -> usize {
        row / view.n_drones * view.n_effects + shared.effects_from[row % view.n_drones] + col
    }

    /// Whether lanes hold consecutive rows, all of them.
    fn in_line(&self) -> bool {
        self.n == C::LANES && self.rows[C::LANES - 1] == self.rows[0] + (C::LANES - 1) as u32
    }

    fn load(&mut self, shared: &Shared<C::Number>, view: &View<C::Number>, all: bool) {
        let kind = &shared.kinds[self.kind];
        let in_line = self.in_line();
        for c in if all { &kind.all_loads } else { &kind.loads } {
            let cell = &mut self.home[c.place as usize];
            if c.array == 9 {
                for (lane, row) in self.rows.iter().enumerate() {
                    cell.set(lane, view.out[9][Self::effect_at(shared, view, *row as usize, c.col)]);
                }
                continue;
            }
            let (array, first) = match c.array {
                0..9 => (&*view.out[c.array], 0),
                _ => (shared.read[c.array - 10], view.first * view.n_drones),
            };
            if in_line {
                gather_line(cell, &array[(first + self.rows[0] as usize) * c.width..], c.width, c.col);
            } else {
                for (lane, row) in self.rows.iter().enumerate() {
                    cell.set(lane, array[(first + *row as usize) * c.width + c.col]);
                }
            }
        }
        // Weight and radius of the others do not change during a call.
        let others = kind.neighbours;
        for j in 0..others {
            let first = place::EFFECTS as usize + kind.effects + j * place::NEIGHBOUR as usize;
            for lane in 0..C::LANES {
                let row = self.rows[lane] as usize;
                let (w, d) = (row / view.n_drones, row % view.n_drones);
                let other = if j < d { j } else { j + 1 };
                let drone = match shared.own {
                    Some(own) => &own[(view.first + w) * view.n_drones + other],
                    None => &shared.nominal[other],
                };
                self.home[first + 6].set(lane, C::Number::of(drone.hover_thrust()));
                self.home[first + 7].set(lane, C::Number::of(drone.disc_radius_m()));
            }
        }
    }

    fn store(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>) {
        let kind = &shared.kinds[self.kind];
        let in_line = self.in_line();
        for c in &kind.saves {
            let cell = &self.home[c.place as usize];
            match c.array {
                9 => {
                    for (lane, row) in self.rows[..self.n].iter().enumerate() {
                        let at = Self::effect_at(shared, view, *row as usize, c.col);
                        view.out[9][at] = cell.get(lane);
                    }
                }
                0..9 if in_line => {
                    scatter_line(
                        cell,
                        &mut view.out[c.array][self.rows[0] as usize * c.width..],
                        c.width,
                        c.col,
                    );
                }
                0..9 => {
                    for (lane, row) in self.rows[..self.n].iter().enumerate() {
                        view.out[c.array][*row as usize * c.width + c.col] = cell.get(lane);
                    }
                }
                _ => {}
            }
        }
    }

    fn store_lane(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>, home: &[C], lane: usize) {
        let kind = &shared.kinds[self.kind];
        let row = self.rows[lane] as usize;
        for c in &kind.saves {
            let value = home[c.place as usize].get(lane);
            match c.array {
                9 => {
                    let at = Self::effect_at(shared, view, row, c.col);
                    view.out[9][at] = value;
                }
                0..9 => view.out[c.array][row * c.width + c.col] = value,
                _ => {}
            }
        }
    }

    fn finite(&self) -> bool {
        let mut sum = C::splat(C::Number::zero());
        for cell in &self.home[..place::MEMORY as usize] {
            sum.poison(cell);
        }
        (0..C::LANES).all(|lane| sum.get(lane) == C::Number::zero())
    }

    /// Steps since the last reset of the world of a lane, after `done` steps of this call.
    fn step_of(&self, view: &View<C::Number>, lane: usize, done: usize) -> u64 {
        view.steps[self.rows[lane] as usize / view.n_drones] + done as u64
    }

    /// Takes `n` steps, the first of them `from` steps after the start of the call.
    fn run(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        files: &mut Vec<File<C>>,
        from: usize,
        n: usize,
    ) {
        let kind = &shared.kinds[self.kind];
        let phase = shared.options.phase;
        if kind.dues.len() == 1 {
            let span = Span { plan: kind.plan(phase, 0), from, n, first: true, last: true };
            return self.segment(shared, view, around, files, span);
        }
        let first = self.step_of(view, 0, 0);
        let alike = (1..self.n).all(|lane| self.step_of(view, lane, 0) == first);
        // Plans that have run, by bit; more than there are bits count as not.
        let mut ran = 0u64;
        let mut done = 0;
        while done < n {
            let plan = kind.plan(phase, first + (from + done) as u64);
            if alike {
                let mut length = 1;
                while done + length < n && kind.plan(phase, first + (from + done + length) as u64) == plan {
                    length += 1;
                }
                let bit = 1u64.checked_shl(plan as u32).unwrap_or(0);
                let span = Span {
                    plan,
                    from: from + done,
                    n: length,
                    first: ran & bit == 0,
                    last: done + length == n,
                };
                ran |= bit;
                self.segment(shared, view, around, files, span);
                done += length;
                continue;
            }
            self.mixed_step(shared, view, around, files, from + done);
            done += 1;
        }
    }

    /// One step of worlds in which different stages tick: every set of stages on all lanes, and each lane takes its own.
    fn mixed_step(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        files: &mut Vec<File<C>>,
        from: usize,
    ) {
        let kind = &shared.kinds[self.kind];
        let phase = shared.options.phase;
        let (mut before, mut merged) = (std::mem::take(&mut self.mixed), std::mem::take(&mut self.merged));
        for copy in [&mut before, &mut merged] {
            copy.clear();
            copy.extend_from_slice(&self.home);
        }
        for plan in 0..kind.plans.len() {
            let mine = |lane: usize| {
                kind.plan(phase, view.steps[self.rows[lane] as usize / view.n_drones] + from as u64) == plan
            };
            let lanes: u64 = (0..C::LANES).filter(|lane| mine(*lane)).map(|lane| 1 << lane).sum();
            if lanes == 0 {
                continue;
            }
            self.home.copy_from_slice(&before);
            self.segment(shared, view, around, files, Span { plan, from, n: 1, first: true, last: true });
            for (to, new) in merged.iter_mut().zip(&self.home) {
                for lane in (0..C::LANES).filter(|lane| lanes >> lane & 1 == 1) {
                    to.set(lane, new.get(lane));
                }
            }
        }
        self.home.copy_from_slice(&merged);
        (self.mixed, self.merged) = (before, merged);
    }

    /// Steps in which the same stages tick.
    fn segment(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        files: &mut Vec<File<C>>,
        span: Span,
    ) {
        let Span { from, n, .. } = span;
        let kind = &shared.kinds[self.kind];
        let plan = &kind.plans[span.plan];
        let place_of_file: usize =
            shared.kinds[..self.kind].iter().map(|k| k.plans.len()).sum::<usize>() + span.plan;
        while files.len() <= place_of_file {
            files.push(File { cells: Vec::new(), stamp: 0 });
        }
        let file = &mut files[place_of_file];
        if file.stamp != shared.stamp {
            file.stamp = shared.stamp;
            file.cells.clear();
            file.cells.resize(plan.program.len, C::splat(C::Number::zero()));
            for (cell, v) in file.cells.iter_mut().zip(&plan.table) {
                *cell = C::splat(*v);
            }
            let constants = file.cells.iter_mut().skip(plan.layout.constants as usize);
            for (cell, v) in constants.zip(&plan.program.constants) {
                *cell = C::splat(C::Number::constant(*v));
            }
        }
        let cells = &mut file.cells;
        for (j, entry) in plan.varying.iter().enumerate().filter(|_| span.first) {
            for lane in 0..C::LANES {
                let row = self.rows[lane] as usize;
                let world = view.first + row / view.n_drones;
                let slot = row % view.n_drones;
                let i = if kind.slots.len() == view.n_drones {
                    slot
                } else {
                    kind.slots.binary_search(&slot).unwrap_or(0)
                };
                let at = (world * kind.slots.len() + i) * plan.varying.len() + j;
                cells[*entry as usize].set(lane, plan.rows[at]);
            }
        }
        for (p, cell) in plan.enter.often.iter().chain(if span.first { &plan.enter.once[..] } else { &[] }) {
            cells[*cell as usize] = self.home[*p as usize];
        }
        let entries = plan.entries::<C>(shared.level);
        match &entries {
            Some(kernel) => (kernel.call)(shared.level, cells),
            None => C::interpret(shared.level, &plan.program.call, cells, 1),
        }
        let once = plan.fresh.is_empty();
        for s in 0..if once { 1 } else { n } {
            for (p, cell) in &plan.fresh {
                self.fresh(shared, view, around, *p, from + s, &mut cells[*cell as usize]);
            }
            let times = if once { n } else { 1 };
            match &entries {
                Some(kernel) => (kernel.step)(shared.level, cells, times),
                None => C::interpret(shared.level, &plan.program.step, cells, times),
            }
        }
        if span.last || plan.finishes {
            match &entries {
                Some(kernel) => (kernel.finish)(shared.level, cells),
                None => C::interpret(shared.level, &plan.program.finish, cells, 1),
            }
        }
        for (cell, p) in plan.leave.often.iter().chain(if span.last { &plan.leave.once[..] } else { &[] }) {
            self.home[*p as usize] = cells[*cell as usize];
        }
        for (p, to) in &plan.copies {
            self.home[*to as usize] = self.home[*p as usize];
        }
        for (v, p) in &plan.constants {
            self.home[*p as usize] = C::splat(*v);
        }
    }

    /// A number that is another in every step: time, normal random numbers, where neighbours are.
    fn fresh(
        &self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        p: u32,
        done: usize,
        cell: &mut C,
    ) {
        let kind = &shared.kinds[self.kind];
        let o = &shared.options;
        for lane in 0..C::LANES {
            let row = self.rows[lane] as usize;
            let (w, d) = (row / view.n_drones, row % view.n_drones);
            let step = self.step_of(view, lane, done);
            let value = match p {
                place::TIME => C::Number::of(step as f64 / f64::from(o.sim_hz)),
                place::NORMALS..place::EFFECTS if kind.noises => {
                    let world = o.first_world + (view.first + w) as u64;
                    let source = RandomSource { world, episodes: shared.episodes[view.first + w] };
                    C::Number::of(source.normals(o.seed, d, step)[(p - place::NORMALS) as usize])
                }
                _ if p >= place::EFFECTS + kind.effects as u32 => {
                    let q = (p - place::EFFECTS) as usize - kind.effects;
                    let (j, i) = (q / place::NEIGHBOUR as usize, q % place::NEIGHBOUR as usize);
                    let other = if j < d { j } else { j + 1 };
                    around[6 * (w * view.n_drones + other) + i]
                }
                _ => C::Number::zero(),
            };
            cell.set(lane, value);
        }
    }
}

/// Widths of the public arrays, as constants: then lanes are filled without a check for each.
macro_rules! of_width {
    ($width:expr, $run:ident($($arg:expr),*)) => {
        match $width {
            1 => $run::<1, _>($($arg),*),
            3 => $run::<3, _>($($arg),*),
            4 => $run::<4, _>($($arg),*),
            MAX_ROTORS => $run::<MAX_ROTORS, _>($($arg),*),
            COMMAND_WIDTH => $run::<COMMAND_WIDTH, _>($($arg),*),
            _ => $run::<{ Memory::<f64>::LEN }, _>($($arg),*),
        }
    };
}

/// Column `col` of the first rows of an array, one to each lane.
fn gather_line<C: Cell>(cell: &mut C, array: &[C::Number], width: usize, col: usize) {
    fn run<const W: usize, C: Cell>(cell: &mut C, array: &[C::Number], col: usize) {
        let rows = &array.as_chunks::<W>().0[..C::LANES];
        if col < W {
            cell.fill(0, |lane| rows[lane][col]);
        }
    }
    of_width!(width, run(cell, array, col));
}

/// Every lane to column `col` of the first rows of an array.
fn scatter_line<C: Cell>(cell: &C, array: &mut [C::Number], width: usize, col: usize) {
    fn run<const W: usize, C: Cell>(cell: &C, array: &mut [C::Number], col: usize) {
        let rows = &mut array.as_chunks_mut::<W>().0[..C::LANES];
        if col < W {
            cell.drain(0, |lane, v| rows[lane][col] = v);
        }
    }
    of_width!(width, run(cell, array, col));
}
