//! Drones in the lanes of one cell type: filled from the arrays, advanced, written back.

use super::super::blocks::{Source as RandomSource, place_of};
use super::super::quarantine::{MAX_POSITION_M, TOO_FAR};
use super::super::random::{AT_ONCE, Names};
use super::super::sim::origin;
use super::super::traced::place;
use super::Shared;
use super::arrays::{Columns, EFFECT_MEMORY, View};
use super::plan::{Kind, Plan, Run};
use super::runner::Runner;
use super::sequence::Undo;
use fearless_simd::Level;
use propwash_compile::Code;
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_trace::Real;
use propwash_trace::bytecode::Interpret;
use propwash_trace::lanes::{Number, all_finite, copy_cells};

/// Which steps of a call a segment is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Place of the plan that flies it.
    pub(super) plan: usize,
    /// Steps since the start of the call, and number of steps.
    pub(super) from: usize,
    pub(super) n: usize,
    /// Whether the plan has not run yet with these drones, and whether nothing comes after.
    pub(super) first: bool,
    pub(super) last: bool,
    /// Whether another command was set since it ran.
    pub(super) told: bool,
}

/// Steps of a call that are taken in one go.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps {
    /// Steps since the start of the call, and number of steps.
    pub(super) from: usize,
    pub(super) n: usize,
    /// Whether nothing was flown before them since the drones were loaded, and whether nothing is flown after them.
    pub(super) begin: bool,
    pub(super) end: bool,
    /// Whether another command was set since the steps before.
    pub(super) told: bool,
}

impl Steps {
    /// Steps before and after which drones are complete.
    pub(super) fn whole(from: usize, n: usize) -> Self {
        Self { from, n, begin: true, end: true, told: false }
    }

    /// Those under command `t` of so many.
    pub(super) fn under(t: usize, times: usize, n: usize) -> Self {
        Self { from: t * n, n, begin: t == 0, end: t + 1 == times, told: true }
    }
}

#[derive(Debug)]
pub(super) struct Pool<C> {
    pub(super) packs: Vec<Pack<C>>,
    pub(super) used: usize,
    /// Each of them backwards, where that was asked for.
    pub(super) undo: Vec<Undo<C>>,
}

impl<C> Default for Pool<C> {
    fn default() -> Self {
        Self { packs: Vec::new(), used: 0, undo: Vec::new() }
    }
}

/// Drones in the lanes of one cell type.
#[derive(Debug)]
pub(super) struct Pack<C> {
    pub(super) kind: usize,
    /// Row of every lane within the view; lanes without a drone of their own repeat the last.
    pub(super) rows: Vec<u32>,
    pub(super) n: usize,
    /// Their numbers by place, the home, and behind it what every plan keeps for itself.
    pub(super) file: Vec<C>,
    /// Kind and filling of tables that the file is made for.
    pub(super) made_for: (usize, u64),
    pub(super) n_home: usize,
    /// The home before the step, where steps are taken one by one.
    pub(super) before: Vec<C>,
    /// The home before and after a step in which different stages tick in different lanes.
    pub(super) mixed: Vec<C>,
    pub(super) merged: Vec<C>,
    /// Names of the random numbers of every lane, where an effect reads some, and what was drawn last.
    pub(super) names: Names,
    pub(super) drawn: [Vec<f32>; AT_ONCE],
}

impl<C: Interpret> Pool<C> {
    /// Fills a pack with the next drones of a kind; `next` is (world, place among the kind's slots). Returns how many.
    pub(super) fn fill(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        kind: usize,
        next: &mut (usize, usize),
        all: bool,
    ) -> usize {
        let of = &shared.kinds[kind];
        if self.packs.len() == self.used {
            self.packs.push(Pack::empty());
        }
        let pack = &mut self.packs[self.used];
        self.used += 1;
        pack.kind = kind;
        pack.rows.clear();
        // Most often every world has one such drone and flies.
        let ahead = next.0..view.n_worlds.min(next.0 + C::LANES);
        if view.n_drones == 1 && view.quarantine[ahead.clone()].iter().all(Option::is_none) {
            next.0 = ahead.end;
            pack.rows.extend(ahead.map(|world| world as u32));
        }
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
        pack.make((kind, shared.stamp), of.n_home, &of.plans);
        pack.load(shared, view, all);
        pack.n
    }

    pub(super) fn run(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        steps: Steps,
    ) {
        for pack in &mut self.packs[..self.used] {
            pack.run(shared, view, around, steps);
        }
    }

    pub(super) fn keep(&mut self) {
        for pack in &mut self.packs[..self.used] {
            pack.before.clear();
            pack.before.extend_from_slice(&pack.file[..pack.n_home]);
        }
    }

    pub(super) fn finite(&self, level: Level) -> bool {
        self.packs[..self.used].iter().all(|pack| pack.finite(level))
    }

    pub(super) fn show(&self, around: &mut [C::Number]) {
        for pack in &self.packs[..self.used] {
            for lane in 0..pack.n {
                let row = pack.rows[lane] as usize;
                for i in 0..3 {
                    around[6 * row + i] = pack.file[place::STATE as usize + i].get(lane);
                    around[6 * row + 3 + i] = pack.file[place::VEL as usize + i].get(lane);
                }
            }
        }
    }

    /// What is not finite of one drone.
    pub(super) fn fault(&self, row: u32) -> Option<&'static str> {
        let packs = &self.packs[..self.used];
        let (pack, lane) = packs.iter().find_map(|p| Some((p, p.rows.iter().position(|r| *r == row)?)))?;
        let bad = |from: u32, n: usize| (0..n).any(|i| !pack.file[from as usize + i].get(lane).finite());
        [
            ("position", bad(place::STATE, 3)),
            (
                TOO_FAR,
                (0..3).any(|i| pack.file[place::STATE as usize + i].get(lane).wide().abs() > MAX_POSITION_M),
            ),
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
    pub(super) fn store_row(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>, row: u32) {
        for pack in &self.packs[..self.used] {
            if let Some(lane) = pack.rows.iter().position(|r| *r == row) {
                pack.store_lane(shared, view, &pack.before, lane);
                return;
            }
        }
    }

    /// Writes all drones back but those of worlds that are done.
    pub(super) fn store(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>, done: &[bool]) {
        for pack in &self.packs[..self.used] {
            if done.iter().any(|d| *d) {
                for lane in 0..pack.n {
                    if !done[pack.rows[lane] as usize / view.n_drones] {
                        pack.store_lane(shared, view, &pack.file, lane);
                    }
                }
            } else {
                pack.store(shared, view);
            }
        }
    }
}

impl<C: Interpret> Pack<C> {
    pub(super) fn empty() -> Self {
        Self {
            kind: 0,
            rows: Vec::new(),
            n: 0,
            file: Vec::new(),
            made_for: (usize::MAX, 0),
            n_home: 0,
            before: Vec::new(),
            mixed: Vec::new(),
            merged: Vec::new(),
            names: Names::default(),
            drawn: Default::default(),
        }
    }

    /// Takes over which drones are in the lanes of another.
    pub(super) fn become_like(&mut self, other: &Self) {
        (self.kind, self.n) = (other.kind, other.n);
        self.rows.clone_from(&other.rows);
    }

    /// Makes the file ready for the plans of a kind.
    pub(super) fn make(&mut self, made_for: (usize, u64), n_home: usize, plans: &[Plan<C::Number>]) {
        if self.made_for == made_for {
            return;
        }
        (self.made_for, self.n_home) = (made_for, n_home);
        self.file.clear();
        let scratch = plans.iter().map(|p| p.program.len).sum::<usize>();
        self.file.resize(n_home + scratch, C::splat(C::Number::zero()));
        for plan in plans {
            for (cell, v) in self.file[plan.scratch..].iter_mut().zip(&plan.table) {
                *cell = C::splat(*v);
            }
            for (cell, v) in self.file[plan.program.constants_at..].iter_mut().zip(&plan.program.constants) {
                *cell = C::splat(C::Number::constant(*v));
            }
        }
    }

    /// Where the numbers of a row begin in the array of some columns.
    fn begin(
        shared: &Shared<C::Number>,
        c: &Columns,
        row: usize,
        (n_drones, n_effects): (usize, usize),
    ) -> usize {
        if c.array == EFFECT_MEMORY {
            return row / n_drones * n_effects + shared.effects_from[row % n_drones] + c.col;
        }
        row * c.width + c.col
    }

    /// Whether lanes hold consecutive rows, all of them.
    pub(super) fn in_line(&self) -> bool {
        self.n == C::LANES && self.rows[C::LANES - 1] == self.rows[0] + (C::LANES - 1) as u32
    }

    pub(super) fn load(&mut self, shared: &Shared<C::Number>, view: &View<C::Number>, all: bool) {
        let kind = &shared.kinds[self.kind];
        let (in_line, sizes) = (self.in_line(), (view.n_drones, view.n_effects));
        for c in if all { &kind.all_loads } else { &kind.loads } {
            let cells = &mut self.file[c.place..c.place + c.n];
            let (array, first) = match c.array {
                0..=EFFECT_MEMORY => (&*view.out[c.array], 0),
                _ => (shared.read[c.array - 10], view.first * view.n_drones),
            };
            if in_line && c.array != EFFECT_MEMORY {
                let rows = &array[(first + self.rows[0] as usize) * c.width..];
                C::gather(shared.level, cells, rows, c.width, c.col);
                continue;
            }
            for (lane, row) in self.rows.iter().enumerate() {
                let from = Self::begin(shared, c, first + *row as usize, sizes);
                for (cell, v) in cells.iter_mut().zip(&array[from..from + c.n]) {
                    cell.set(lane, *v);
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
                self.file[first + 6].set(lane, C::Number::of(drone.hover_thrust()));
                self.file[first + 7].set(lane, C::Number::of(drone.disc_radius_m()));
            }
        }
    }

    pub(super) fn store(&self, shared: &Shared<C::Number>, view: &mut View<C::Number>) {
        let kind = &shared.kinds[self.kind];
        let (in_line, sizes) = (self.in_line(), (view.n_drones, view.n_effects));
        for c in kind.saves.iter().filter(|c| c.array <= EFFECT_MEMORY) {
            let cells = &self.file[c.place..c.place + c.n];
            let array = &mut *view.out[c.array];
            if in_line && c.array != EFFECT_MEMORY {
                let rows = &mut array[self.rows[0] as usize * c.width..];
                C::scatter(shared.level, cells, rows, c.width, c.col);
                continue;
            }
            for (lane, row) in self.rows[..self.n].iter().enumerate() {
                let from = Self::begin(shared, c, *row as usize, sizes);
                for (cell, v) in cells.iter().zip(&mut array[from..from + c.n]) {
                    *v = cell.get(lane);
                }
            }
        }
    }

    pub(super) fn store_lane(
        &self,
        shared: &Shared<C::Number>,
        view: &mut View<C::Number>,
        home: &[C],
        lane: usize,
    ) {
        let kind = &shared.kinds[self.kind];
        let row = self.rows[lane] as usize;
        for c in kind.saves.iter().filter(|c| c.array <= EFFECT_MEMORY) {
            let from = Self::begin(shared, c, row, (view.n_drones, view.n_effects));
            let numbers = &mut view.out[c.array][from..from + c.n];
            for (cell, v) in home[c.place..c.place + c.n].iter().zip(numbers) {
                *v = cell.get(lane);
            }
        }
    }

    pub(super) fn finite(&self, level: Level) -> bool {
        let limit = C::Number::of(MAX_POSITION_M);
        all_finite(level, &self.file[place::STATE as usize..place::MEMORY as usize], 3, limit)
    }

    /// Steps since the last reset of the world of a lane, after `done` steps of this call.
    pub(super) fn step_of(&self, view: &View<C::Number>, lane: usize, done: usize) -> u64 {
        view.steps[self.rows[lane] as usize / view.n_drones] + done as u64
    }

    /// Takes steps. What later steps and the states do not need is only computed at the end.
    pub(super) fn run(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        Steps { from, n, begin, end, told }: Steps,
    ) {
        let kind = &shared.kinds[self.kind];
        if kind.dues.len() == 1 {
            if begin {
                self.name(shared, view);
            }
            let plan = kind.plan(shared.options.phase, 0);
            let last = end || kind.plans[plan].ends_state;
            let span = Span { plan, from, n, first: begin, last, told };
            return self.segment(shared, view, (kind, &kind.plans), Some(around), span);
        }
        self.run_kept(shared, view, around, (from, n), None);
    }

    /// The same; where `kept` is given, steps are taken one by one, and what it names is kept of each.
    pub(super) fn run_kept(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        around: &[C::Number],
        (from, n): (usize, usize),
        mut kept: Option<&mut Kept<C>>,
    ) {
        let kind = &shared.kinds[self.kind];
        let phase = shared.options.phase;
        self.name(shared, view);
        let (first, alike) = self.alike(view, kind);
        // Plans that have run, by bit; more than there are bits count as not.
        let mut ran = 0u64;
        let mut done = 0;
        while done < n {
            if let Some(kept) = &mut kept {
                kept.take(kept.before, &self.file);
            }
            let mut length = 1;
            if alike {
                let plan = kind.plan(phase, first + (from + done) as u64);
                let more = |length| kind.plan(phase, first + (from + done + length) as u64) == plan;
                while kept.is_none() && done + length < n && more(length) {
                    length += 1;
                }
                let bit = 1u64.checked_shl(plan as u32).unwrap_or(0);
                let (first, last) = (ran & bit == 0, done + length == n);
                let span = Span { plan, from: from + done, n: length, first, last, told: false };
                ran |= bit;
                self.segment(shared, view, (kind, &kind.plans), Some(around), span);
            } else {
                self.mixed_step(shared, view, (kind, &kind.plans), Some(around), from + done);
            }
            if let Some(kept) = &mut kept {
                kept.take(kept.after, &self.file);
            }
            done += length;
        }
    }

    /// Steps since the last reset at the start of the call, and whether the same stages tick in all lanes.
    pub(super) fn alike(&self, view: &View<C::Number>, kind: &Kind<C::Number>) -> (u64, bool) {
        let first = self.step_of(view, 0, 0);
        let alike = kind.dues.len() == 1 || (1..self.n).all(|lane| self.step_of(view, lane, 0) == first);
        (first, alike)
    }

    /// One step of worlds in which different stages tick: every set of stages on all lanes, and each lane takes its own.
    pub(super) fn mixed_step(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (kind, plans): (&Kind<C::Number>, &[Plan<C::Number>]),
        around: Option<&[C::Number]>,
        from: usize,
    ) {
        let (mut before, mut merged) = (std::mem::take(&mut self.mixed), std::mem::take(&mut self.merged));
        for copy in [&mut before, &mut merged] {
            copy.clear();
            copy.extend_from_slice(&self.file[..self.n_home]);
        }
        for plan in 0..plans.len() {
            let due =
                |lane: usize| kind.due(view.steps[self.rows[lane] as usize / view.n_drones] + from as u64);
            let mine = |lane: usize| plans[plan].is_for(shared.options.phase, due(lane));
            let lanes: u64 = (0..C::LANES).filter(|lane| mine(*lane)).map(|lane| 1 << lane).sum();
            if lanes == 0 {
                continue;
            }
            self.file[..self.n_home].copy_from_slice(&before);
            let span = Span { plan, from, n: 1, first: true, last: true, told: false };
            self.segment(shared, view, (kind, plans), around, span);
            for (to, new) in merged.iter_mut().zip(&self.file) {
                for lane in (0..C::LANES).filter(|lane| lanes >> lane & 1 == 1) {
                    to.set(lane, new.get(lane));
                }
            }
        }
        self.file[..self.n_home].copy_from_slice(&merged);
        (self.mixed, self.merged) = (before, merged);
    }

    /// Names the random numbers of all lanes, as the call begins, where an effect reads some.
    fn name(&mut self, shared: &Shared<C::Number>, view: &View<C::Number>) {
        if !shared.kinds[self.kind].reads_noise {
            return;
        }
        let o = &shared.options;
        self.names.clear();
        for row in &self.rows {
            let (w, d) = (*row as usize / view.n_drones, *row as usize % view.n_drones);
            let number = o.first_world + (view.first + w) as u64;
            let origin = origin(o.seed, shared.seeds, number, view.first + w);
            let source = RandomSource { origin, episodes: shared.episodes[view.first + w] };
            let (key, episode) = source.named(d, view.steps[w]);
            self.names.push(key, episode);
        }
        for numbers in &mut self.drawn {
            // Lanes without a drone of their own get zeros, not what others drew.
            numbers.clear();
            numbers.resize(self.rows.len(), 0.0);
        }
    }

    /// Puts what differs in every step into place, `done` steps after the start of the call: time (given where it is the same in all lanes), normal random
    /// numbers, where the other drones are.
    fn refresh(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (kind, plan): (&Kind<C::Number>, &Plan<C::Number>),
        around: &[C::Number],
        done: usize,
        time: Option<C::Number>,
    ) {
        let Self { rows, n, file, names, drawn, .. } = self;
        let mut block = None;
        for p in &plan.fresh {
            let cell = &mut file[*p as usize];
            match *p {
                place::TIME => match time {
                    Some(time) => *cell = C::splat(time),
                    None => cell.fill(0, |lane| {
                        let step = view.steps[rows[lane] as usize / view.n_drones] + done as u64;
                        C::Number::of(step as f64 / f64::from(shared.options.sim_hz))
                    }),
                },
                p if p < place::EFFECTS && !kind.reads_noise => *cell = C::splat(C::Number::zero()),
                p if p < place::EFFECTS => {
                    let (needed, k) = place_of((p - place::NORMALS) as usize);
                    if block != Some(needed) {
                        // Lanes without a drone of their own need no draws, which cost most.
                        names.draw(shared.level, *n, (done as u64, needed), drawn);
                        block = Some(needed);
                    }
                    cell.fill(0, |lane| C::Number::of(f64::from(drawn[k][lane])));
                }
                p => {
                    let q = (p - place::EFFECTS) as usize - kind.effects;
                    let (j, i) = (q / place::NEIGHBOUR as usize, q % place::NEIGHBOUR as usize);
                    cell.fill(0, |lane| {
                        let (w, d) =
                            (rows[lane] as usize / view.n_drones, rows[lane] as usize % view.n_drones);
                        let other = if j < d { j } else { j + 1 };
                        around[6 * (w * view.n_drones + other) + i]
                    });
                }
            }
        }
    }

    /// Steps in which the same stages tick. Numbers that differ in every step are put into place before each, unless they are there already (`around`, where
    /// all drones are, is `None`).
    pub(super) fn segment(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (kind, plans): (&Kind<C::Number>, &[Plan<C::Number>]),
        around: Option<&[C::Number]>,
        span: Span,
    ) {
        let Span { from, n, .. } = span;
        let plan = &plans[span.plan];
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
                self.file[plan.scratch + *entry as usize].set(lane, plan.rows[at]);
            }
        }
        let (runner, level) = (plan.runner::<C>(shared.level), shared.level);
        if span.first || span.told || !plan.enter.often.is_empty() {
            for pairs in plan.enter.all_or_often(span.first) {
                copy_cells(level, &mut self.file, pairs);
            }
            if span.told && !span.first {
                copy_cells(level, &mut self.file, &plan.commands);
            }
            runner.call(level, plan, &mut self.file);
        }
        let once = plan.fresh.is_empty();
        // Most often all worlds are in the same step: then their time is one number.
        let together = plan.fresh.contains(&place::TIME).then(|| self.step_of(view, 0, 0));
        let together = together.filter(|first| (1..self.n).all(|lane| self.step_of(view, lane, 0) == *first));
        let time = |first: u64, s: usize| {
            C::Number::of((first + (from + s) as u64) as f64 / f64::from(shared.options.sim_hz))
        };
        let timed = together.is_some() && matches!(plan.fresh[..], [place::TIME]);
        let done = match (&runner, together) {
            (Runner::Compiled(code), Some(first)) if timed => {
                timed_steps(code, &mut self.file, plan.scratch, n, |s| time(first, s));
                n
            }
            _ => 0,
        };
        for s in done..if once { 1 } else { n } {
            if let Some(around) = around {
                let time = together.map(|first| time(first, s));
                self.refresh(shared, view, (kind, plan), around, from + s, time);
            }
            runner.step(level, plan, &mut self.file, if once { n } else { 1 });
        }
        if span.last || plan.needs_epilogue {
            runner.epilogue(level, plan, &mut self.file);
        }
        for pairs in plan.leave.all_or_often(span.last) {
            copy_cells(level, &mut self.file, pairs);
        }
        for (v, to) in plan.constants.all_or_often(span.last).into_iter().flatten() {
            self.file[*to as usize] = C::splat(*v);
        }
    }
}

/// Takes steps at these times of all lanes, without leaving the loop of the code.
fn timed_steps<C: Interpret>(
    code: &Code,
    file: &mut [C],
    scratch: usize,
    n: usize,
    time: impl Fn(usize) -> C::Number,
) {
    let mut times = [C::Number::zero(); 64];
    for from in (0..n).step_by(times.len()) {
        let times = &mut times[..(n - from).min(64)];
        for (s, t) in times.iter_mut().enumerate() {
            *t = time(from + s);
        }
        let (home, scratch) = file.split_at_mut(scratch);
        code.steps(home, scratch, times);
        // What comes after the last step reads it in the home.
        home[place::TIME as usize] = C::splat(times[times.len() - 1]);
    }
}

/// What is kept of every step.
#[derive(Debug)]
pub(super) struct Kept<'a, C> {
    /// Places of what is kept as it was before the step, and of what the step was told.
    pub(super) before: &'a [Run],
    pub(super) after: &'a [Run],
    /// (step, before and after)
    pub(super) cells: &'a mut Vec<C>,
}

impl<C: Copy> Kept<'_, C> {
    fn take(&mut self, runs: &[Run], file: &[C]) {
        for run in runs {
            self.cells.extend_from_slice(&file[run.place..run.place + run.n]);
        }
    }
}
