//! Sequences of commands in one call, and gradients of what was flown: the compiled side of `propwash.Tape`.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::{Element, PyArrayDyn};
use propwash::arena::Arena;
use propwash::rollout::tape::{Partials, Tape};
use propwash::scalar::lanes::Number;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;

use crate::arrays;
use crate::errors::OrRaise;
use crate::field::PyField;
use crate::sim::{Flight, PySim, either};

/// A recorded flight of either number.
enum Kept {
    F32(Box<Tape<f32>>),
    F64(Box<Tape<f64>>),
}

/// The compiled side of `propwash.Tape`.
#[pyclass(frozen, name = "Tape", module = "propwash._native")]
pub struct PyTape {
    kept: Mutex<Kept>,
    pool: Arc<ThreadPool>,
    /// Number of worlds, of commands, of drones, and of numbers of a command.
    #[pyo3(get)]
    shape: [usize; 4],
    /// Numbers of a state.
    #[pyo3(get)]
    state_width: usize,
    /// Numbers that effects remember in a world, and that controllers remember of a drone.
    memory: [usize; 2],
    /// `f32` or `f64`.
    #[pyo3(get)]
    precision: &'static str,
}

/// The same expression for a tape of either number.
macro_rules! each {
    ($kept:expr, $tape:ident => $body:expr) => {
        match $kept {
            Kept::F32($tape) => $body,
            Kept::F64($tape) => $body,
        }
    };
}

/// Commands of shape (n_worlds, n_times, n_drones, command_width), in the number of a simulation.
pub fn sequence<N: Number + Element>(
    arena: &Arena<N>,
    commands: &Bound<'_, PyAny>,
) -> PyResult<(usize, Vec<N>)> {
    let data = &arena.sim().data;
    let (worlds, drones, width) = (data.n_worlds, data.n_drones, data.command_width);
    let times = commands.getattr("shape").ok().and_then(|shape| shape.get_item(1).ok()?.extract().ok());
    let Some(times) = times.filter(|times| *times > 0usize) else {
        return Err(PyValueError::new_err(format!(
            "commands: expected an array of shape (n_worlds, n_times, n_drones, command_width) = ({worlds}, n_times, {drones}, \
             {width}) with at least one time"
        )));
    };
    let axes = "(n_worlds, n_times, n_drones, command_width)";
    Ok((times, arrays::numbers_as("commands", axes, commands, &[worlds, times, drones, width])?))
}

/// Runs `work` in the pool where it pays.
pub fn within<T: Send>(pool: &ThreadPool, work: impl FnOnce() -> T + Send) -> T {
    if pool.current_num_threads() == 1 { propwash::rollout::pool::alone(work) } else { pool.install(work) }
}

/// Drone-steps of a rollout after which Ctrl-C is heard: a tenth of a second in lanes.
const STEPS_OF_A_PART: usize = 10_000_000;

/// Arrays of (world, time, …), in parts along the times.
#[derive(Clone, Copy)]
struct Parts {
    worlds: usize,
    times: usize,
}

impl Parts {
    /// A part of an array.
    fn take<N: Number>(self, all: &[N], part: Range<usize>) -> Vec<N> {
        let each = all.len() / (self.worlds * self.times);
        let of = |w: usize| &all[(w * self.times + part.start) * each..(w * self.times + part.end) * each];
        (0..self.worlds).flat_map(|w| of(w).iter().copied()).collect()
    }

    /// Puts a part where it belongs; the array is made with the first one.
    fn put<N: Number>(self, all: &mut Vec<N>, own: &[N], part: Range<usize>) {
        let each = own.len() / (self.worlds * part.len());
        all.resize(self.worlds * self.times * each, N::zero());
        for (w, own) in own.chunks_exact(part.len() * each).enumerate() {
            let from = (w * self.times + part.start) * each;
            all[from..from + own.len()].copy_from_slice(own);
        }
    }
}

#[pymethods]
impl PySim {
    /// Flies a sequence of commands: the states after each, (n_worlds, n_times, n_drones, state_width), and whether worlds were quarantined
    /// that were not before.
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        commands: &Bound<'py, PyAny>,
        substeps: usize,
    ) -> PyResult<(Bound<'py, PyAny>, bool)> {
        self.plain()?;
        let mut core = self.core()?;
        let before = core.quarantined();
        let states = either!(&mut core.flight, arena => {
            let (times, commands) = sequence(arena, commands)?;
            let rows = self.n_worlds * self.n_drones;
            // In parts after which Ctrl-C is heard; flights are the same in any parts.
            let most = (STEPS_OF_A_PART / (rows * substeps).max(1)).max(1);
            let states = if times <= most {
                py.detach(|| within(&self.pool, || arena.rollout(&commands, substeps))).or_raise()?
            } else {
                let mut states = Vec::new();
                for from in (0..times).step_by(most) {
                    let part = from..times.min(from + most);
                    let own = Parts { worlds: self.n_worlds, times }.take(&commands, part.clone());
                    let flown = py.detach(|| within(&self.pool, || arena.rollout(&own, substeps))).or_raise()?;
                    Parts { worlds: self.n_worlds, times }.put(&mut states, &flown, part);
                    py.check_signals()?;
                }
                states
            };
            let width = states.len() / (rows * times);
            arrays::owned(py, states, &[self.n_worlds, times, self.n_drones, width])?.into_any()
        });
        core.known_quarantine();
        let more = core.quarantined() > before;
        Ok((states, more))
    }

    /// The same with how near each drone came to what a field holds, (n_worlds, n_drones), and the first command after which it was nearer than the radius; the
    /// states only where they are kept, else none.
    #[allow(clippy::type_complexity)]
    fn rollout_near<'py>(
        &self,
        py: Python<'py>,
        commands: &Bound<'py, PyAny>,
        substeps: usize,
        field: &PyField,
        how: (f64, bool),
    ) -> PyResult<(Option<Bound<'py, PyAny>>, Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<u32>>, bool)>
    {
        let (radius, keep) = how;
        self.plain()?;
        let mut core = self.core()?;
        let before = core.quarantined();
        let shape = [self.n_worlds, self.n_drones];
        let (states, near) = either!(&mut core.flight, arena => {
            let (times, commands) = sequence(arena, commands)?;
            let near = (&field.field, radius);
            let flown = py.detach(|| within(&self.pool, || arena.rollout_near(&commands, substeps, near, keep)));
            let (states, near) = flown.or_raise()?;
            let width = states.len() / (self.n_worlds * times * self.n_drones);
            let states = match keep {
                true => Some(arrays::owned(py, states, &[shape[0], times, shape[1], width])?.into_any()),
                false => None,
            };
            (states, near)
        });
        core.known_quarantine();
        let more = core.quarantined() > before;
        let distance = arrays::owned(py, near.distance_m, &shape)?;
        Ok((states, distance, arrays::owned(py, near.first, &shape)?, more))
    }

    /// The same, and remembers the flight.
    fn record(
        &self,
        py: Python<'_>,
        commands: &Bound<'_, PyAny>,
        substeps: usize,
    ) -> PyResult<(PyTape, bool)> {
        self.plain()?;
        let mut core = self.core()?;
        let before = core.quarantined();
        let kept = match &mut core.flight {
            Flight::F32(arena) => {
                let (_, commands) = sequence(arena, commands)?;
                let flown = py.detach(|| within(&self.pool, || arena.record(&commands, substeps)));
                Kept::F32(Box::new(flown.or_raise()?))
            }
            Flight::F64(arena) => {
                let (_, commands) = sequence(arena, commands)?;
                let flown = py.detach(|| within(&self.pool, || arena.record(&commands, substeps)));
                Kept::F64(Box::new(flown.or_raise()?))
            }
        };
        core.known_quarantine();
        let more = core.quarantined() > before;
        let (shape, state_width, memory) = each!(&kept, tape => {
            let start = tape.start();
            let rows = start.n_worlds * start.n_drones;
            let memory = [start.effect_memory.len() / start.n_worlds, start.controller_memory.len() / rows];
            (tape.shape(), tape.state_width(), memory)
        });
        let precision = if matches!(kept, Kept::F32(_)) { "f32" } else { "f64" };
        let tape = PyTape {
            kept: Mutex::new(kept),
            pool: Arc::clone(&self.pool),
            shape,
            state_width,
            memory,
            precision,
        };
        Ok((tape, more))
    }
}

#[pymethods]
impl PyTape {
    /// States after each command, (n_worlds, n_times, n_drones, state_width): they are handed over, and can be asked for once.
    fn take_states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        each!(&mut *kept, tape => Ok(arrays::owned(py, tape.take_states(), &self.states_shape())?.into_any()))
    }

    /// Worlds that stood still.
    fn faults(&self) -> Vec<u64> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        each!(&*kept, tape => tape.faults().iter().map(|fault| fault.world).collect())
    }

    /// What a loss gains by everything before, from what it gains by the states.
    fn pull_back<'py>(
        &self,
        py: Python<'py>,
        seeds: &Bound<'py, PyAny>,
        parameters: Vec<String>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let axes = "(n_worlds, n_times, n_drones, state_width)";
        let names: Vec<&str> = parameters.iter().map(String::as_str).collect();
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        each!(&mut *kept, tape => {
            let seeds = arrays::numbers_as("seeds", axes, seeds, &self.states_shape())?;
            let gains = py.detach(|| within(&self.pool, || tape.pull_back(&seeds, &names))).or_raise()?;
            self.dictionary(py, gains)
        })
    }

    /// How far the states move when everything before moves in this direction.
    fn push_forward<'py>(
        &self,
        py: Python<'py>,
        direction: &Bound<'py, PyDict>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let named: Bound<'py, PyDict> = match direction.get_item("parameters")? {
            Some(given) => given.cast_into()?,
            None => PyDict::new(py),
        };
        let names: Vec<String> = named.keys().extract()?;
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        each!(&*kept, tape => {
            let mut partials = tape.zero(&names);
            for (name, shape, list) in self.parts(&mut partials) {
                if let Some(value) = direction.get_item(name)? {
                    fill(name, &value, &shape, list)?;
                }
            }
            for (name, list) in &mut partials.parameters {
                if let Some(value) = named.get_item(&*name)? {
                    fill(name, &value, &[self.shape[0], self.shape[2]], list)?;
                }
            }
            let moved = py.detach(|| within(&self.pool, || tape.push_forward(&partials))).or_raise()?;
            Ok(arrays::owned(py, moved, &self.states_shape())?.into_any())
        })
    }

    /// Slopes of the last state by the state at the start and by the first command.
    fn linearize<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let [worlds, _, drones, command] = self.shape;
        let n = self.state_width;
        each!(&mut *kept, tape => {
            let (a, b) = py.detach(|| within(&self.pool, || tape.linearize())).or_raise()?;
            let a = arrays::owned(py, a, &[worlds, drones, n, n])?.into_any();
            let b = arrays::owned(py, b, &[worlds, drones, n, command])?.into_any();
            Ok((a, b))
        })
    }
}

impl PyTape {
    fn states_shape(&self) -> [usize; 4] {
        let [worlds, times, drones, _] = self.shape;
        [worlds, times, drones, self.state_width]
    }

    /// The parts of a set of partials, with name and shape.
    fn parts<'a, N>(&self, p: &'a mut Partials<N>) -> [(&'static str, Vec<usize>, &'a mut Vec<N>); 7] {
        let [worlds, times, drones, command] = self.shape;
        let [effects, memory] = self.memory;
        [
            ("state", vec![worlds, drones, self.state_width], &mut p.state),
            ("commands", vec![worlds, times, drones, command], &mut p.commands),
            ("disturbance_force", vec![worlds, drones, 3], &mut p.disturbance_force),
            ("disturbance_torque", vec![worlds, drones, 3], &mut p.disturbance_torque),
            ("wind", vec![worlds, drones, 3], &mut p.wind),
            ("controller_memory", vec![worlds, drones, memory], &mut p.controller_memory),
            ("effect_memory", vec![worlds, effects], &mut p.effect_memory),
        ]
    }

    fn dictionary<'py, N: Element + Number>(
        &self,
        py: Python<'py>,
        mut gains: Partials<N>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        for (name, shape, list) in self.parts(&mut gains) {
            out.set_item(name, arrays::owned(py, std::mem::take(list), &shape)?)?;
        }
        let named = PyDict::new(py);
        for (name, list) in gains.parameters {
            named.set_item(name, arrays::owned(py, list, &[self.shape[0], self.shape[2]])?)?;
        }
        out.set_item("parameters", named)?;
        Ok(out)
    }
}

/// Numbers of an array of this shape into a list.
fn fill<N: Number + Element>(
    name: &str,
    value: &Bound<'_, PyAny>,
    shape: &[usize],
    list: &mut Vec<N>,
) -> PyResult<()> {
    *list = arrays::numbers_as(&format!("direction of {name}"), &arrays::tuple(shape), value, shape)?;
    Ok(())
}
