//! What drones of one kind fly by: a program for each set of stages that tick, and which numbers of the arrays it needs.

use std::sync::Arc;

use fearless_simd::Level;

use super::super::blocks::Phase;
use super::super::traced::{Backwards, Shape, adjoint_schedule, bare, place, relevant};
use super::Options;
use super::arrays::{Arrays, Columns, columns};
use super::runner::Runner;
use crate::backend::{Backend, PreparedStep};
use propwash_compile::{Code, Compile, Request, Status, request};
use propwash_kernels as kernels;
use propwash_physics::controllers::{Due, Rates};
use propwash_physics::drone::Drone;
use propwash_trace::bytecode::{Interpret, Program};
use propwash_trace::kernel::{Compiled, Entries, Kernel, key};
use propwash_trace::lanes::Number;
use propwash_trace::schedule::{Input, Location, Output, Schedule, Source};
use propwash_trace::trace::Again;

/// Drone slots that fly by one program.
#[derive(Debug)]
pub(super) struct Kind<N> {
    pub(super) slots: Vec<usize>,
    /// Which stages tick at a step, by the step within a second, as places in `dues`.
    pub(super) ticks: Vec<u8>,
    pub(super) dues: Vec<Due>,
    pub(super) plans: Vec<Plan<N>>,
    /// Cells of the home of a drone.
    pub(super) n_home: usize,
    /// Fixed numbers of the drone that the tables were filled with, and which of them are others in some row.
    pub(super) typical: Vec<f64>,
    pub(super) varies: Vec<bool>,
    pub(super) neighbours: usize,
    /// Places that some plan reads or leaves as they are, the same with those that every plan writes, and places that some plan
    /// writes.
    pub(super) loads: Vec<Columns>,
    pub(super) all_loads: Vec<Columns>,
    pub(super) saves: Vec<Columns>,
    pub(super) reads_noise: bool,
    pub(super) effects: usize,
    /// Its steps backwards, once gradients were asked for.
    pub(super) back: Option<Back<N>>,
}

/// Neighbouring places: the first, how many, and the column in which the first is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) place: usize,
    pub(super) n: usize,
    pub(super) column: usize,
}

/// Runs of ascending places whose columns begin at `column`.
fn runs(places: &[u32], mut column: usize) -> Vec<Run> {
    let mut out: Vec<Run> = Vec::new();
    for p in places {
        match out.last_mut() {
            Some(run) if run.place + run.n == *p as usize => run.n += 1,
            _ => out.push(Run { place: *p as usize, n: 1, column }),
        }
        column += 1;
    }
    out
}

/// The programs of a kind backwards, in the order of its own.
#[derive(Debug)]
pub(super) struct Back<N> {
    pub(super) plans: Vec<Plan<N>>,
    /// Fixed numbers by which gains are wanted.
    pub(super) parameters: Vec<usize>,
    pub(super) layout: Backwards,
    pub(super) n_home: usize,
    /// Runs of places of what must be kept of every step, with the column of the first: what steps change, as it was before, and what they
    /// were told.
    pub(super) before: Vec<Run>,
    pub(super) after: Vec<Run>,
    /// Number of columns.
    pub(super) columns: usize,
    /// Places of what is the same during a call that some program reads.
    pub(super) given: Vec<u32>,
}

/// The program of a kind for one set of stages that tick.
#[derive(Debug)]
pub(super) struct Plan<N> {
    pub(super) phase: Phase,
    pub(super) due: Due,
    pub(super) schedule: Schedule,
    pub(super) kernel: Option<&'static Kernel>,
    /// What is compiled at run time where there is no kernel, and its code once it is there.
    pub(super) request: Option<Arc<Request>>,
    pub(super) code: Option<Code>,
    /// What runs the code where the simulation has a backend of the user's, instead of kernel and byte code.
    pub(super) prepared: Option<Box<dyn PreparedStep<N>>>,
    pub(super) program: Program,
    /// First cell of its scratch in the file of a pack.
    pub(super) scratch: usize,
    /// Places that the call, the steps and `leave` read, and places that it leaves other than it found them.
    pub(super) reads: Vec<u32>,
    pub(super) writes: Vec<u32>,
    /// (place, cell of the file) before the call: what is given. Often: what some plan writes.
    pub(super) enter: Parted<(u32, u32)>,
    /// Those of them that are commands.
    pub(super) commands: Vec<(u32, u32)>,
    /// (cell of the file, place) after the last step: results that stand elsewhere, and what stays as it came. Often: what a plan
    /// may read later in the call.
    pub(super) leave: Parted<(u32, u32)>,
    /// (constant, place) after the last step, in the same way.
    pub(super) constants: Parted<(N, u32)>,
    /// Whether a plan may read later in the call what is computed after the last step.
    pub(super) needs_epilogue: bool,
    /// Whether some of a drone's state is only in place after the last step. No model has that so far, since every step reads the whole
    /// state that it changes; a state that is shown and read by nothing would.
    pub(super) ends_state: bool,
    /// Places of numbers that are others in every step.
    pub(super) fresh: Vec<u32>,
    pub(super) table: Vec<N>,
    /// What computes the entries that differ between rows.
    pub(super) again: Again,
    /// Entries of the table that differ between rows, and their numbers: (row, entry).
    pub(super) varying: Vec<u32>,
    pub(super) rows: Vec<N>,
}

/// What runs plans: a backend of the user's, or else kernels, code that is compiled now and then, and byte code.
#[derive(Clone, Copy, Debug)]
pub(super) struct Means<'a, N> {
    pub(super) backend: Option<&'a dyn Backend<N>>,
    pub(super) compile: Compile,
    pub(super) level: Level,
}

/// What is done whenever other stages begin to tick within a call, and what once per call is enough for.
#[derive(Debug)]
pub(super) struct Parted<T> {
    pub(super) often: Vec<T>,
    pub(super) once: Vec<T>,
}

impl<T: Copy> Parted<T> {
    pub(super) fn new(often: Vec<T>) -> Self {
        Self { often, once: Vec::new() }
    }

    pub(super) fn part(&mut self, is_often: impl Fn(&T) -> bool) {
        self.often.append(&mut self.once);
        (self.often, self.once) = self.often.iter().partition(|t| is_often(t));
    }

    /// What is done often, and all else.
    pub(super) fn all_or_often(&self, all: bool) -> [&[T]; 2] {
        [&self.often, if all { &self.once } else { &[] }]
    }
}

/// Groups drone slots by what their programs are made of.
pub(super) fn kinds<N: Number>(options: &Options, nominal: &[Drone<f64>], rates: &[Rates]) -> Vec<Kind<N>> {
    let bare: Vec<Drone<f64>> = nominal.iter().map(bare).collect();
    let mut kinds: Vec<Kind<N>> = Vec::new();
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
            let due = relevant(options.mode, due);
            let at = dues.iter().position(|known| *known == due).unwrap_or(dues.len());
            if at == dues.len() {
                dues.push(due);
            }
            ticks.push(at as u8);
        }
        let reads = nominal[d].reads();
        let neighbours = if reads.neighbours { nominal.len() - 1 } else { 0 };
        let effects = nominal[d].memory_len(1.0 / f64::from(options.sim_hz));
        kinds.push(Kind {
            slots: vec![d],
            ticks,
            dues,
            plans: Vec::new(),
            n_home: place::EFFECTS as usize + effects + neighbours * place::NEIGHBOUR as usize,
            typical: Vec::new(),
            varies: Vec::new(),
            neighbours,
            loads: Vec::new(),
            all_loads: Vec::new(),
            saves: Vec::new(),
            reads_noise: reads.noise,
            effects,
            back: None,
        });
    }
    kinds
}

impl<N: Number> Plan<N> {
    /// The plan of a step, whose scratch begins at cell `scratch` of the file.
    pub(super) fn new(shape: &Shape, schedule: Schedule, scratch: usize, means: Means<N>) -> Self {
        let wanted = key(&schedule);
        let prepared = means.backend.map(|b| b.prepare(&schedule));
        let kernel = kernels::ALL.iter().find(|k| k.key == wanted && prepared.is_none());
        let flies = kernel.is_some_and(|k| <N::Cell as Compiled>::entries(k, means.level).is_some());
        let compiles = !flies && prepared.is_none() && means.compile != Compile::Off;
        let request = compiles.then(|| request::<N>(&schedule, means.level));
        if let Some(request) = request.as_ref().filter(|_| means.compile == Compile::Now) {
            // What fails flies as byte code; `Sim::storing` has told of it.
            let _ = request.wait();
        }
        // Byte code too where there is a kernel: not all types of cells and levels have its functions.
        let program = Program::new(&schedule, scratch);
        let (mut reads, mut writes, mut fresh) = (Vec::new(), Vec::new(), Vec::new());
        let inputs = schedule.given.iter().copied().chain(schedule.state.iter().filter_map(|s| s.input));
        for input in inputs {
            match input {
                Input::Given(p) | Input::Carried(p) => reads.push(p),
                Input::Fresh(p) => fresh.push(p),
                Input::Fixed(_) => {}
            }
        }
        writes.extend(schedule.state.iter().filter_map(|s| s.output).map(|o| o.place()));
        let (mut leave, mut constants) = (Vec::new(), Vec::new());
        let (table, state) = (schedule.call_at(), schedule.state_at());
        let cell = |at: Location| match at {
            Location::Home(p) => p,
            Location::Scratch(k) => scratch as u32 + k,
        };
        let given = schedule.given.iter().zip(schedule.given_at());
        let enter: Vec<(u32, u32)> =
            given.filter_map(|(input, at)| Some((input.place()?, cell(at)))).collect();
        let is_command = |(p, _): &&(u32, u32)| (place::COMMAND..place::FORCE).contains(p);
        let commands = enter.iter().filter(is_command).copied().collect();
        // What stays as it came is in place already.
        let moves = |(output, source): &&(Output, Source)| !matches!(source, Source::Input(input) if input.place() == Some(output.place()));
        let finished =
            schedule.epilogue.stores.iter().filter_map(|(_, slot)| schedule.state[*slot as usize].output);
        let mut moved = finished.chain(schedule.finals.iter().filter(moves).map(|(output, _)| *output));
        let ends_state = moved.any(|output| output.place() < place::MEMORY);
        for (output, source) in &schedule.finals {
            let to = output.place();
            writes.push(to);
            match source {
                Source::Call(k) => leave.push((cell(table[*k as usize]), to)),
                Source::State(k) => leave.push((cell(state[*k as usize]), to)),
                Source::Constant(v) => constants.push((N::of(*v), to)),
                Source::Input(Input::Given(p) | Input::Carried(p)) => {
                    reads.push(*p);
                    leave.push((*p, to));
                }
                Source::Input(_) => {}
            }
        }
        Self {
            phase: shape.phase,
            due: shape.due,
            schedule,
            kernel,
            code: request.as_ref().and_then(|r| r.code()),
            request,
            prepared,
            program,
            scratch,
            reads,
            writes,
            commands,
            enter: Parted::new(enter),
            leave: Parted::new(leave),
            constants: Parted::new(constants),
            needs_epilogue: true,
            ends_state,
            fresh,
            table: Vec::new(),
            again: Again::default(),
            varying: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Whether it flies steps in which these stages tick.
    pub(super) fn is_for(&self, phase: Phase, due: Due) -> bool {
        self.phase == phase && self.due == due
    }

    /// The kernel for cells of this type.
    pub(super) fn entries<C: Interpret<Number = N>>(&self, level: Level) -> Option<Entries<C>> {
        self.kernel.and_then(|k| C::entries(k, level))
    }

    /// What runs it on cells of this type.
    pub(super) fn runner<C: Interpret<Number = N>>(&self, level: Level) -> Runner<'_, C> {
        match (&self.prepared, self.entries::<C>(level)) {
            (Some(step), _) => Runner::Backend(step.as_ref()),
            (None, Some(entries)) => Runner::Kernel(entries),
            (None, None) => match self.code.filter(Code::is_for::<C>) {
                Some(code) => Runner::Compiled(code),
                None => Runner::ByteCode,
            },
        }
    }

    /// Whether straight-line code flies cells of this type.
    fn is_compiled<C: Interpret<Number = N>>(&self, level: Level) -> bool {
        self.entries::<C>(level).is_some() || self.code.is_some_and(|code| code.is_for::<C>())
    }

    /// Takes up code that was compiled since; whether byte code flies while there is code to come.
    pub(super) fn take_up(&mut self) -> bool {
        let Some(request) = self.request.as_ref().filter(|_| self.code.is_none()) else { return false };
        self.code = request.code();
        if let Status::Failed(why) = request.status() {
            propwash_compile::complain(&why);
        }
        !request.is_done()
    }

    /// The table of the first drone, and which of its entries differ between drones.
    pub(super) fn fill(&mut self, first: &[f64], varies: &[bool], n_rows: usize) {
        let once = &self.schedule.once;
        self.table = once.eval(first).into_iter().map(N::of).collect();
        let mut depends: Vec<bool> = Vec::with_capacity(once.nodes.len());
        for node in &once.nodes {
            let own = matches!(node, propwash_trace::trace::Node::Input(k) if varies[*k as usize]);
            let any = own || node.operands().any(|o| depends[o as usize]);
            depends.push(any);
        }
        let entries = once.outputs.iter().enumerate().filter(|(_, o)| depends[**o as usize]);
        self.varying = entries.map(|(i, _)| i as u32).collect();
        self.again = once.again(first, varies, &self.varying);
        self.rows = vec![N::zero(); n_rows * self.varying.len()];
    }

    /// The entries that differ, of all drones of a kind or of those whose parameters changed.
    pub(super) fn fill_rows(
        &mut self,
        slots: &[usize],
        n_drones: usize,
        n_worlds: usize,
        changed: Option<&[usize]>,
        numbers: impl Fn(usize, &mut Vec<f64>),
    ) {
        if self.varying.is_empty() {
            return;
        }
        let (width, mut own) = (self.varying.len(), Vec::new());
        let mut fill = |world: usize, i: usize| {
            numbers(world * n_drones + slots[i], &mut own);
            let values = self.again.eval(&own);
            let row = (world * slots.len() + i) * width;
            self.rows[row..row + width].iter_mut().zip(values).for_each(|(to, v)| *to = N::of(v));
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
    /// Marks numbers of the drones in `rows` that are not those that the tables were filled with; true where there are more than before.
    pub(super) fn note_differences(
        &mut self,
        rows: &[usize],
        numbers: impl Fn(usize, &mut Vec<f64>),
    ) -> bool {
        let (mut more, mut own) = (false, Vec::new());
        for row in rows {
            numbers(*row, &mut own);
            for ((varies, a), b) in self.varies.iter_mut().zip(&self.typical).zip(&own) {
                if !*varies && a.to_bits() != b.to_bits() {
                    (*varies, more) = (true, true);
                }
            }
        }
        more
    }

    /// What all plans together read and write.
    pub(super) fn collect(&mut self, arrays: &Arrays) {
        let n_plans = self.plans.len();
        let (reads, writers) = part(&mut self.plans, self.n_home);
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
        // A number too many that is loaded is what it is; one that is stored would be what it was.
        let columns = |list: Vec<u32>, gap| columns(arrays, list, self.effects, gap);
        (self.loads, self.all_loads, self.saves) =
            (columns(loads, 1), columns(all_loads, 1), columns(saves, 0));
    }

    /// Whether kernels, or code that was compiled since, fly this kind in cells of this type.
    pub(super) fn is_compiled<C: Interpret<Number = N>>(&self, level: Level) -> bool {
        self.plans.iter().all(|p| p.is_compiled::<C>(level))
    }

    /// All its plans, those backwards too.
    pub(super) fn all_plans(&self) -> impl Iterator<Item = &Plan<N>> {
        self.plans.iter().chain(self.back.iter().flat_map(|back| &back.plans))
    }

    /// The same, to be changed.
    pub(super) fn all_plans_mut(&mut self) -> impl Iterator<Item = &mut Plan<N>> {
        self.plans.iter_mut().chain(self.back.iter_mut().flat_map(|back| &mut back.plans))
    }

    /// What ticks in a step.
    pub(super) fn due(&self, step: u64) -> Due {
        self.dues[usize::from(self.ticks[(step % self.ticks.len() as u64) as usize])]
    }

    /// Place of the plan for a step.
    pub(super) fn plan(&self, phase: Phase, step: u64) -> usize {
        self.plans.iter().position(|p| p.is_for(phase, self.due(step))).unwrap_or(0)
    }

    /// Traces the steps backwards, with gains by these fixed numbers, unless they were already; whether it did. `numbers` are the fixed numbers of a row of
    /// (world, drone), `drone` one of this kind.
    pub(super) fn trace_back(
        &mut self,
        options: &Options,
        drone: &Drone<f64>,
        parameters: &[usize],
        (n_drones, n_worlds): (usize, usize),
        means: Means<N>,
        numbers: impl Fn(usize, &mut Vec<f64>),
    ) -> bool {
        if self.back.as_ref().is_some_and(|back| back.parameters == parameters) {
            return false;
        }
        let layout = Backwards::new(self.effects, self.neighbours);
        let n_home = layout.n_home(parameters.len());
        let mut plans: Vec<Plan<N>> = Vec::new();
        for due in &self.dues {
            let shape = Shape {
                mode: options.mode,
                integrator: options.integrator,
                phase: Phase::Both,
                due: *due,
                sim_hz: options.sim_hz,
                neighbours: self.neighbours,
            };
            let schedule = adjoint_schedule(drone, &shape, &|k| self.varies[k], parameters);
            let scratch = n_home + plans.iter().map(|p| p.program.len).sum::<usize>();
            let mut plan = Plan::new(&shape, schedule, scratch, Means { backend: None, ..means });
            plan.fill(&self.typical, &self.varies, self.slots.len() * n_worlds);
            plan.fill_rows(&self.slots, n_drones, n_worlds, None, &numbers);
            plans.push(plan);
        }
        part(&mut plans, n_home);
        let (mut before, mut after, mut given) = (Vec::new(), Vec::new(), Vec::new());
        for p in 0..layout.n_places {
            let told =
                (place::TIME..place::EFFECTS).contains(&p) || p >= place::EFFECTS + self.effects as u32;
            if plans.iter().any(|plan| plan.fresh.contains(&p)) {
                (if told { &mut after } else { &mut before }).push(p);
            }
            let enters = |plan: &Plan<N>| {
                plan.enter.all_or_often(true).into_iter().flatten().any(|(from, _)| *from == p)
            };
            if plans.iter().any(enters) {
                given.push(p);
            }
        }
        let (parameters, columns) = (parameters.to_vec(), before.len() + after.len());
        let (before, after) = (runs(&before, 0), runs(&after, before.len()));
        self.back = Some(Back { plans, parameters, layout, n_home, before, after, columns, given });
        true
    }
}

impl<N> Back<N> {
    /// Place of the plan for a step in which these tick.
    pub(super) fn plan(&self, due: Due) -> usize {
        self.plans.iter().position(|p| p.due == due).unwrap_or(0)
    }
}

/// Parts what plans that share a home of `n_home` numbers do often from what is enough once; which places some plan reads, and how many
/// write each.
fn part<N: Number>(plans: &mut [Plan<N>], n_home: usize) -> (Vec<bool>, Vec<usize>) {
    let n_plans = plans.len();
    let (mut reads, mut writers) = (vec![false; n_home], vec![0; n_home]);
    for plan in plans.iter() {
        plan.reads.iter().for_each(|p| reads[*p as usize] = true);
        plan.writes.iter().for_each(|p| writers[*p as usize] += 1);
    }
    // What one plan writes and another does not keeps what it was.
    let kept = |p: u32| reads[p as usize] || writers[p as usize] < n_plans;
    for plan in plans {
        plan.enter.part(|(p, _)| writers[*p as usize] > 0);
        plan.leave.part(|(_, p)| kept(*p));
        plan.constants.part(|(_, p)| kept(*p));
        let Schedule { state, epilogue, finals, .. } = &plan.schedule;
        let finished = |slot: u32| epilogue.stores.iter().any(|(_, to)| *to == slot);
        let own = epilogue.stores.iter().filter_map(|(_, slot)| state[*slot as usize].output);
        let moved = finals.iter().filter_map(|(output, source)| match source {
            Source::State(slot) if finished(*slot) => Some(*output),
            _ => None,
        });
        plan.needs_epilogue = own.chain(moved).any(|output| kept(output.place()));
    }
    (reads, writers)
}
