//! Steps under a sequence of commands in one go, and the same steps backwards.
//!
//! Lanes fly all commands while they sit in cache. Backwards nothing but the start is kept of the whole flight: each thread flies
//! a few worlds again, keeps what the steps of a group changed, and undoes them, group by group from the last. Groups are √(number of steps)
//! long, so that what a thread keeps grows with the root of the flight's length (Griewank & Walther, Evaluating Derivatives, 2008, ch. 12).

mod piloted;

use super::arrays::View;
use super::pack::{Kept, Pack, Pool, Span, Steps};
use super::plan::{Back, Kind};
use super::{Commands, Looks, Scratch, Shared};
use crate::pilot::{Commander, Pilot};
use crate::traced::place;
use crate::watch::Watched;
use fearless_simd::Level;
use propwash_trace::Real;
use propwash_trace::bytecode::Interpret;
use propwash_trace::lanes::Number;
use std::ops::Range;

/// Flights of up to this many steps are one group: what is kept of them fits into cache.
const ONE_GROUP: usize = 64;
/// The same where a pilot commands: what it does for a command costs more than what is fetched from farther away.
const ONE_GROUP_PILOTED: usize = 512;

/// Part of the steps under one command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    /// Which command.
    t: usize,
    /// First step under it, and number of steps.
    from: usize,
    n: usize,
}

/// Commands, one after the other, each in force for some steps.
#[derive(Debug)]
pub(super) struct Sequence<'a, N> {
    /// (world, time, drone, number of a command)
    commands: &'a [N],
    times: usize,
    width: usize,
    substeps: usize,
    /// Columns of the controllers' memory, and runs of them that are neighbours in the memory: (column, place in the memory, number).
    memory_columns: usize,
    memory_runs: Vec<(usize, usize, usize)>,
    pieces: Vec<Piece>,
    /// Ranges of pieces.
    groups: Vec<Range<usize>>,
}

/// What a call does with each part of its worlds.
pub(super) enum Job<'a, N> {
    /// Steps under the command that is set.
    Steps,
    /// Steps under a sequence of commands; the states after each go to the first of [`View::extra`].
    Record(Sequence<'a, N>, Looks<'a, N>),
    /// The same backwards, for what a loss gains by the state after each command (world, time, drone, number of a state).
    Sweep(Sequence<'a, N>, &'a [N]),
    /// A flight whose commands a pilot gives, and the same backwards.
    Pilot(Sequence<'a, N>, &'a dyn Pilot<N>),
    /// The same without the way back.
    Commander(Sequence<'a, N>, &'a dyn Commander<N>),
}

/// Arrays of gains among [`View::extra`], in this order.
pub(super) mod gain {
    /// By the state at the start. (world, drone, number of a state)
    pub const STATE: usize = 0;
    /// By the commands. (world, time, drone, number of a command)
    pub const COMMANDS: usize = 1;
    /// By disturbing force and torque and by the wind. (world, drone, 3)
    pub const FORCE: usize = 2;
    pub const TORQUE: usize = 3;
    pub const WIND: usize = 4;
    /// By what controllers remember at the start. (world, drone, columns)
    pub const MEMORY: usize = 5;
    /// By what effects remember at the start. (world, numbers of all effects)
    pub const EFFECTS: usize = 6;
    /// By parameters. (world, drone, parameter)
    pub const PARAMETERS: usize = 7;
}

/// An array of shape (world, time, drone, width), at one time.
#[derive(Clone, Copy)]
struct Laid {
    times: usize,
    t: usize,
    drones: usize,
    width: usize,
}

impl Laid {
    /// Where the numbers of row (world, drone) begin.
    fn at(self, row: usize) -> usize {
        let (w, d) = (row / self.drones, row % self.drones);
        ((w * self.times + self.t) * self.drones + d) * self.width
    }

    /// Numbers from one row to the next where that is always the same.
    fn stride(self) -> Option<usize> {
        match (self.times, self.drones) {
            (1, _) => Some(self.width),
            (times, 1) => Some(times * self.width),
            _ => None,
        }
    }
}

impl<'a, N: Number> Sequence<'a, N> {
    pub(super) fn new(
        &Commands { numbers: commands, times, substeps }: &Commands<'a, N>,
        (width, memory_columns): (usize, &[usize]),
        (near, piloted): (bool, bool),
    ) -> Self {
        let all = times * substeps;
        let least = if piloted { ONE_GROUP_PILOTED } else { ONE_GROUP };
        let group = if all <= least { all } else { all.isqrt().max(least) };
        // Where drones feel each other their gains meet after every step.
        let most = if near { 1 } else { group.max(1) };
        let mut pieces = Vec::new();
        for t in 0..times {
            let parts = (0..substeps).step_by(most);
            pieces.extend(parts.map(|from| Piece { t, from, n: most.min(substeps - from) }));
        }
        let (mut groups, mut first, mut steps) = (Vec::new(), 0, 0);
        for (i, piece) in pieces.iter().enumerate() {
            if steps > 0 && steps + piece.n > group {
                groups.push(first..i);
                (first, steps) = (i, 0);
            }
            steps += piece.n;
        }
        if first < pieces.len() {
            groups.push(first..pieces.len());
        }
        let mut memory_runs: Vec<(usize, usize, usize)> = Vec::new();
        for (col, within) in memory_columns.iter().enumerate() {
            match memory_runs.last_mut() {
                Some((_, first, n)) if *first + *n == *within => *n += 1,
                _ => memory_runs.push((col, *within, 1)),
            }
        }
        let memory_columns = memory_columns.len();
        Self { commands, times, width, substeps, memory_columns, memory_runs, pieces, groups }
    }

    fn command_at(&self, t: usize, drones: usize) -> Laid {
        Laid { times: self.times, t, drones, width: self.width }
    }

    /// Steps since the start of the call when a piece begins.
    fn step_of(&self, piece: Piece) -> usize {
        piece.t * self.substeps + piece.from
    }
}

/// Drones of one pack backwards.
#[derive(Debug)]
pub(super) struct Undo<C> {
    pack: Pack<C>,
    /// What was kept of the steps of a group: (step, column)
    kept: Vec<C>,
    /// Homes at the start of each group.
    marks: Vec<C>,
    /// What a pilot commanded. (time, number of a command)
    commands: Vec<C>,
}

impl<C: Interpret> Pack<C> {
    /// Copies numbers of an array into the cells from `place` on.
    fn take(&mut self, level: Level, place: usize, array: &[C::Number], first_row: usize, laid: Laid) {
        let in_line = self.in_line();
        let cells = &mut self.file[place..place + laid.width];
        if let (Some(stride), true) = (laid.stride(), in_line) {
            let from = laid.at(first_row + self.rows[0] as usize);
            return C::gather(level, cells, &array[from..], stride, 0);
        }
        for (lane, row) in self.rows.iter().enumerate() {
            let from = laid.at(first_row + *row as usize);
            for (cell, v) in cells.iter_mut().zip(&array[from..from + laid.width]) {
                cell.set(lane, *v);
            }
        }
    }

    /// Copies the cells from `place` on into columns of an array.
    fn give(
        &self,
        level: Level,
        (place, n): (usize, usize),
        array: &mut [C::Number],
        laid: Laid,
        col: usize,
    ) {
        let cells = &self.file[place..place + n];
        if let (Some(stride), true) = (laid.stride(), self.in_line()) {
            let from = laid.at(self.rows[0] as usize);
            return C::scatter(level, cells, &mut array[from..], stride, col);
        }
        for (lane, row) in self.rows[..self.n].iter().enumerate() {
            let from = laid.at(*row as usize) + col;
            for (cell, v) in cells.iter().zip(&mut array[from..from + n]) {
                *v = cell.get(lane);
            }
        }
    }

    /// Adds numbers of an array to the cells of these places, one column each.
    fn add(&mut self, places: &[u32], array: &[C::Number], first_row: usize, laid: Laid) {
        for lane in 0..self.n {
            let from = laid.at(first_row + self.rows[lane] as usize);
            for (p, v) in places.iter().zip(&array[from..from + laid.width]) {
                let cell = &mut self.file[*p as usize];
                cell.set(lane, cell.get(lane) + *v);
            }
        }
    }

    /// The state, to an array of shape (world, time, drone, number of a state).
    fn give_state(&self, level: Level, array: &mut [C::Number], laid: Laid) {
        let motion = laid.width - 1;
        self.give(level, (place::STATE as usize, motion), array, laid, 0);
        self.give(level, (place::THRUST as usize, 1), array, laid, motion);
    }

    fn clear(&mut self, places: Range<usize>) {
        self.file[places].fill(C::splat(C::Number::zero()));
    }
}

/// Places of a state in the order of its columns: position, attitude, velocity, angular velocity, rotor speeds, thrust.
fn state_places(width: usize) -> Vec<u32> {
    (place::STATE..place::STATE + width as u32 - 1).chain([place::THRUST]).collect()
}

impl<C: Interpret> Pool<C> {
    fn command(&mut self, shared: &Shared<C::Number>, first_row: usize, commands: &[C::Number], laid: Laid) {
        for pack in &mut self.packs[..self.used] {
            pack.take(shared.level, place::COMMAND as usize, commands, first_row, laid);
        }
    }

    fn give_states(&self, level: Level, array: &mut [C::Number], laid: Laid) {
        self.packs[..self.used].iter().for_each(|pack| pack.give_state(level, array, laid));
    }

    /// Makes the packs backwards ready, all gains zero.
    fn begin_undo(&mut self, shared: &Shared<C::Number>) {
        for i in 0..self.used {
            let pack = &self.packs[i];
            let Some(back) = &shared.kinds[pack.kind].back else { continue };
            if self.undo.len() == i {
                self.undo.push(Undo {
                    pack: Pack::empty(),
                    kept: Vec::new(),
                    marks: Vec::new(),
                    commands: Vec::new(),
                });
            }
            let undo = &mut self.undo[i];
            undo.pack.become_like(pack);
            undo.pack.make((pack.kind, shared.stamp), back.n_home, &back.plans);
            undo.pack.clear(back.layout.n_places as usize..back.n_home);
            for p in &back.given {
                undo.pack.file[*p as usize] = pack.file[*p as usize];
            }
            undo.marks.clear();
        }
    }

    /// Keeps the homes, or puts back those that were kept as number `group`, where there are several `groups`; nothing is kept of steps any
    /// more.
    fn mark(&mut self, groups: usize, back_to: Option<usize>) {
        for (pack, undo) in self.packs[..self.used].iter_mut().zip(&mut self.undo) {
            let n = pack.n_home;
            match back_to {
                // The only group is flown from where it begins.
                _ if groups == 1 => {}
                None => undo.marks.extend_from_slice(&pack.file[..n]),
                Some(group) => pack.file[..n].copy_from_slice(&undo.marks[group * n..(group + 1) * n]),
            }
            undo.kept.clear();
        }
    }

    /// Steps forwards, of which is kept what they changed.
    fn run_kept(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        steps: (usize, usize),
    ) {
        for (pack, undo) in self.packs[..self.used].iter_mut().zip(&mut self.undo) {
            let Some(back) = &shared.kinds[pack.kind].back else { continue };
            let mut kept = Kept { before: &back.before, after: &back.after, cells: &mut undo.kept };
            pack.run_kept(shared, view, around, steps, Some(&mut kept));
        }
    }

    /// The packs backwards, each with its kind.
    fn undone<'a>(
        &'a mut self,
        shared: &'a Shared<C::Number>,
    ) -> impl Iterator<Item = (&'a mut Undo<C>, &'a Kind<C::Number>, &'a Back<C::Number>)> {
        self.undo.iter_mut().take(self.used).filter_map(|undo| {
            let kind = &shared.kinds[undo.pack.kind];
            Some((undo, kind, kind.back.as_ref()?))
        })
    }

    /// Undoes a piece whose steps begin `kept_from` steps after the start of its group.
    fn undo(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (seq, piece): (&Sequence<C::Number>, Piece),
        kept_from: usize,
    ) {
        let laid = seq.command_at(piece.t, view.n_drones);
        let first_row = view.first * view.n_drones;
        for (undo, kind, back) in self.undone(shared) {
            let command = place::COMMAND as usize;
            if matches!(shared.job, Job::Pilot(..)) {
                let given = &undo.commands[piece.t * seq.width..(piece.t + 1) * seq.width];
                undo.pack.file[command..command + seq.width].copy_from_slice(given);
            } else {
                undo.pack.take(shared.level, command, seq.commands, first_row, laid);
            }
            let kept = &undo.kept[kept_from * back.columns..];
            let from = seq.step_of(piece);
            undo.pack.run_back(shared, view, (kind, back), kept, (from, piece.n));
        }
    }

    /// Adds what the loss gains by the states after a command.
    fn seed(&mut self, shared: &Shared<C::Number>, view: &View<C::Number>, seeds: &[C::Number], laid: Laid) {
        for (undo, _, back) in self.undone(shared) {
            let places: Vec<u32> = state_places(laid.width).into_iter().map(|p| back.layout.by(p)).collect();
            undo.pack.add(&places, seeds, view.first * view.n_drones, laid);
        }
    }

    /// Writes what the loss gains by a command, and begins the sum for the one before.
    fn give_command(&mut self, shared: &Shared<C::Number>, array: &mut [C::Number], laid: Laid) {
        for (undo, _, back) in self.undone(shared) {
            let first = back.layout.by(place::COMMAND) as usize;
            undo.pack.give(shared.level, (first, laid.width), array, laid, 0);
            undo.pack.clear(first..first + laid.width);
        }
    }

    /// Calls `to(row of the view, numbers)` with what the loss gains by each other drone that a drone feels: its position and velocity;
    /// and begins these sums anew.
    fn felt(
        &mut self,
        shared: &Shared<C::Number>,
        n_drones: usize,
        to: &mut impl FnMut(usize, [C::Number; 6]),
    ) {
        for (undo, kind, back) in self.undone(shared) {
            for j in 0..kind.neighbours {
                let place = place::EFFECTS + kind.effects as u32 + j as u32 * place::NEIGHBOUR;
                let first = back.layout.by(place) as usize;
                for lane in 0..undo.pack.n {
                    let row = undo.pack.rows[lane] as usize;
                    let d = row % n_drones;
                    let other = if j < d { j } else { j + 1 };
                    to(row - d + other, core::array::from_fn(|i| undo.pack.file[first + i].get(lane)));
                }
                undo.pack.clear(first..first + 6);
            }
        }
    }

    /// Adds to the gains by the positions and velocities of drones. (row of the view, number)
    fn feel(&mut self, shared: &Shared<C::Number>, felt: &[C::Number]) {
        let places: Vec<u32> =
            (0..3).map(|i| place::STATE + i).chain((0..3).map(|i| place::VEL + i)).collect();
        for (undo, _, back) in self.undone(shared) {
            let places: Vec<u32> = places.iter().map(|p| back.layout.by(*p)).collect();
            undo.pack.add(&places, felt, 0, Laid { times: 1, t: 0, drones: 1, width: 6 });
        }
    }

    /// Writes what the loss gains by everything that the flight began with.
    fn give_start(
        &mut self,
        shared: &Shared<C::Number>,
        view: &mut View<C::Number>,
        seq: &Sequence<C::Number>,
    ) {
        let (drones, level, n_effects) = (view.n_drones, shared.level, view.n_effects);
        let laid = |width| Laid { times: 1, t: 0, drones, width };
        let widths: Vec<usize> = view.extra.iter().map(|(_, per_world)| per_world / drones).collect();
        for (undo, _, back) in self.undone(shared) {
            let pack = &undo.pack;
            let by = |p: u32| back.layout.by(p) as usize;
            let state = laid(widths[gain::STATE]);
            let motion = state.width - 1;
            let to = &mut *view.extra[gain::STATE].0;
            pack.give(level, (by(place::STATE), motion), to, state, 0);
            pack.give(level, (by(place::THRUST), 1), to, state, motion);
            for (array, p) in
                [(gain::FORCE, place::FORCE), (gain::TORQUE, place::TORQUE), (gain::WIND, place::WIND)]
            {
                pack.give(level, (by(p), 3), view.extra[array].0, laid(3), 0);
            }
            for &(col, within, n) in &seq.memory_runs {
                let from = (by(place::MEMORY) + within, n);
                pack.give(level, from, view.extra[gain::MEMORY].0, laid(seq.memory_columns), col);
            }
            for j in 0..back.parameters.len() {
                let from = (back.layout.by_parameter(j) as usize, 1);
                let to = &mut *view.extra[gain::PARAMETERS].0;
                pack.give(level, from, to, laid(widths[gain::PARAMETERS]), j);
            }
            for lane in 0..pack.n {
                let row = pack.rows[lane] as usize;
                let (w, d) = (row / drones, row % drones);
                let first = w * n_effects + shared.effects_from[d];
                for i in 0..shared.kinds[pack.kind].effects {
                    view.extra[gain::EFFECTS].0[first + i] = pack.file[by(place::EFFECTS) + i].get(lane);
                }
            }
        }
    }
}

impl<C: Interpret> Pack<C> {
    /// Undoes steps, the last first.
    fn run_back(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (kind, back): (&Kind<C::Number>, &Back<C::Number>),
        kept: &[C],
        (from, n): (usize, usize),
    ) {
        let (first, alike) = self.alike(view, kind);
        let mut ran = 0u64;
        for s in (from..from + n).rev() {
            let kept = &kept[(s - from) * back.columns..];
            for run in back.before.iter().chain(&back.after) {
                self.file[run.place..run.place + run.n]
                    .copy_from_slice(&kept[run.column..run.column + run.n]);
            }
            if alike {
                let plan = back.plan(kind.due(first + s as u64));
                let bit = 1u64.checked_shl(plan as u32).unwrap_or(0);
                let span = Span { plan, from: s, n: 1, first: ran & bit == 0, last: s == from, told: false };
                ran |= bit;
                // All that is another in every step is in place: it was kept.
                self.segment(shared, view, (kind, &back.plans), None, span);
            } else {
                self.mixed_step(shared, view, (kind, &back.plans), None, s);
            }
        }
    }
}

impl<N: Number> Scratch<N> {
    fn command(&mut self, shared: &Shared<N>, view: &View<N>, seq: &Sequence<N>, t: usize) {
        let (laid, first_row) = (seq.command_at(t, view.n_drones), view.first * view.n_drones);
        self.one.command(shared, first_row, seq.commands, laid);
        self.two.command(shared, first_row, seq.commands, laid);
        self.four.command(shared, first_row, seq.commands, laid);
    }

    fn mark(&mut self, groups: usize, back_to: Option<usize>) {
        self.one.mark(groups, back_to);
        self.two.mark(groups, back_to);
        self.four.mark(groups, back_to);
    }

    /// Hands what drones gain by what they felt of others on to these.
    fn share(&mut self, shared: &Shared<N>, view: &View<N>) {
        let mut felt = vec![N::zero(); 6 * view.n_worlds * view.n_drones];
        let mut to = |row: usize, numbers: [N; 6]| {
            for (sum, v) in felt[6 * row..6 * row + 6].iter_mut().zip(numbers) {
                *sum = *sum + v;
            }
        };
        self.one.felt(shared, view.n_drones, &mut to);
        self.two.felt(shared, view.n_drones, &mut to);
        self.four.felt(shared, view.n_drones, &mut to);
        self.one.feel(shared, &felt);
        self.two.feel(shared, &felt);
        self.four.feel(shared, &felt);
    }
}

/// Calls a method of the three pools of a thread.
macro_rules! pools {
    ($scratch:expr, $method:ident($($argument:expr),*)) => {{
        $scratch.one.$method($($argument),*);
        $scratch.two.$method($($argument),*);
        $scratch.four.$method($($argument),*);
    }};
}

impl<N: Number> Shared<'_, N> {
    /// States after command `t`, from the packs; those of worlds that stand still, from the arrays. Then they are looked at.
    fn give_states(
        &self,
        view: &mut View<N>,
        scratch: &Scratch<N>,
        (seq, looks): (&Sequence<N>, Looks<N>),
        t: usize,
    ) {
        let (drones, worlds) = (view.n_drones, view.n_worlds);
        let (array, per_world) = &mut view.extra[0];
        let (times, at) = if looks.keep { (seq.times, t) } else { (1, 0) };
        let laid = Laid { times, t: at, drones, width: *per_world / (times * drones) };
        pools!(scratch, give_states(self.level, array, laid));
        let rotors = laid.width - 14;
        for w in (0..worlds).filter(|w| view.quarantine[*w].is_some()) {
            for row in w * drones..(w + 1) * drones {
                let to = &mut array[laid.at(row)..][..laid.width];
                let mut col = 0;
                for (source, width) in view.out.iter().zip([3, 4, 3, 3, rotors, 1]) {
                    to[col..col + width].copy_from_slice(&source[row * width..(row + 1) * width]);
                    col += width;
                }
            }
        }
        if let Some(watcher) = looks.watcher {
            let sizes = (*per_world, drones * laid.width);
            watcher.look(Watched::new((view.first, worlds, t), &array[laid.at(0)..], sizes));
        }
    }

    /// All steps of a few worlds under a sequence of commands.
    pub(super) fn record(
        &self,
        mut view: View<N>,
        scratch: &mut Scratch<N>,
        (seq, looks): (&Sequence<N>, Looks<N>),
    ) {
        self.load(&view, scratch, true);
        for t in 0..seq.times {
            scratch.command(self, &view, seq, t);
            self.steps(&view, scratch, Steps::under(t, seq.times, seq.substeps));
            if !scratch.finite(self.level) {
                return self.record_one_by_one(view, scratch, (seq, looks));
            }
            self.give_states(&mut view, scratch, (seq, looks), t);
        }
        self.put_back(&mut view, scratch, seq.times * seq.substeps);
    }

    /// The same command by command, where a world turns non-finite.
    fn record_one_by_one(
        &self,
        mut view: View<N>,
        scratch: &mut Scratch<N>,
        (seq, looks): (&Sequence<N>, Looks<N>),
    ) {
        for t in 0..seq.times {
            self.load(&view, scratch, true);
            scratch.command(self, &view, seq, t);
            self.steps(&view, scratch, Steps::whole(0, seq.substeps));
            if scratch.finite(self.level) {
                self.put_back(&mut view, scratch, seq.substeps);
            } else {
                self.load(&view, scratch, true);
                scratch.command(self, &view, seq, t);
                self.one_by_one(&mut view, scratch, seq.substeps);
            }
            // Worlds that stand still since this command are read from the arrays, as are all others by now.
            self.load(&view, scratch, true);
            self.give_states(&mut view, scratch, (seq, looks), t);
        }
    }

    /// One piece forwards; `kept` where it is to be undone.
    fn forwards(
        &self,
        view: &View<N>,
        scratch: &mut Scratch<N>,
        (seq, piece): (&Sequence<N>, Piece),
        kept: bool,
    ) {
        if piece.from == 0 && !matches!(self.job, Job::Pilot(..)) {
            scratch.command(self, view, seq, piece.t);
        }
        let steps = (seq.step_of(piece), piece.n);
        if !kept {
            return self.steps(view, scratch, Steps::whole(steps.0, steps.1));
        }
        if self.kinds.iter().any(|k| k.neighbours > 0) {
            scratch.look_around(view.n_worlds * view.n_drones);
        }
        let Scratch { one, two, four, around, .. } = scratch;
        one.run_kept(self, view, around, steps);
        two.run_kept(self, view, around, steps);
        four.run_kept(self, view, around, steps);
    }

    /// What a loss gains by everything that a flight began with and was told.
    pub(super) fn sweep(&self, mut view: View<N>, scratch: &mut Scratch<N>, seq: &Sequence<N>, seeds: &[N]) {
        self.load(&view, scratch, true);
        pools!(scratch, begin_undo(self));
        let near = self.kinds.iter().any(|k| k.neighbours > 0);
        let drones = view.n_drones;
        let width = view.extra[gain::STATE].1 / drones;
        for (number, group) in seq.groups.iter().enumerate() {
            scratch.mark(seq.groups.len(), None);
            if number + 1 < seq.groups.len() {
                for piece in &seq.pieces[group.clone()] {
                    self.forwards(&view, scratch, (seq, *piece), false);
                }
            }
        }
        for (number, group) in seq.groups.iter().enumerate().rev() {
            scratch.mark(seq.groups.len(), Some(number));
            let mut steps = 0;
            for piece in &seq.pieces[group.clone()] {
                self.forwards(&view, scratch, (seq, *piece), true);
                steps += piece.n;
            }
            for piece in seq.pieces[group.clone()].iter().rev() {
                let laid = |width| Laid { times: seq.times, t: piece.t, drones, width };
                if piece.from + piece.n == seq.substeps {
                    pools!(scratch, seed(self, &view, seeds, laid(width)));
                }
                steps -= piece.n;
                pools!(scratch, undo(self, &view, (seq, *piece), steps));
                if near {
                    scratch.share(self, &view);
                }
                if piece.from == 0 {
                    let to = &mut *view.extra[gain::COMMANDS].0;
                    pools!(scratch, give_command(self, to, laid(seq.width)));
                }
            }
        }
        pools!(scratch, give_start(self, &mut view, seq));
    }
}
