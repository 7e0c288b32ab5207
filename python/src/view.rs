//! Pages that show scenes, data sets, flight logs and simulations in three dimensions.

use std::path::PathBuf;

use propwash::scalar::lanes::Number;
use propwash::view::{self, Made, Moment, Options, Snapshot};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::errors::OrRaise;
use crate::sim::{Flight, PySim, either};

/// The page of a file or folder, and its notes.
#[pyfunction]
pub fn view_page(
    py: Python<'_>,
    what: PathBuf,
    worlds: Vec<usize>,
    scene: Option<PathBuf>,
    vehicle: Option<String>,
) -> PyResult<(String, Vec<String>)> {
    let options = Options { worlds, scene, vehicle };
    let made = py.detach(|| view::page(&what, &options)).or_raise()?;
    Ok((made.html, made.notes))
}

#[pymethods]
impl PySim {
    /// The page of worlds as they are now, and its notes. All must be in the scene of the first.
    fn view_page(&self, worlds: Vec<usize>) -> PyResult<(String, Vec<String>)> {
        let core = self.core()?;
        if let Some(wrong) = worlds.iter().find(|w| **w >= self.n_worlds) {
            return Err(PyIndexError::new_err(format!("world {wrong}: expected 0 to {}", self.n_worlds - 1)));
        }
        let made = either!(&core.flight, arena => of_arena(arena, self, &worlds)).or_raise()?;
        Ok((made.html, made.notes))
    }
}

fn of_arena<N: Number>(
    arena: &propwash::arena::Arena<N>,
    sim: &PySim,
    worlds: &[usize],
) -> propwash::Result<Made> {
    let look = arena.look();
    let first = worlds.first().copied().unwrap_or(0);
    let moment = |w: &usize| {
        let drone = |d| {
            let pose = look.pose(*w, d);
            (pose.pos_m, pose.quat_xyzw)
        };
        let obstacles = if arena.has_scene() {
            look.obstacle_pos_m(*w).iter().copied().zip(look.obstacle_quat(*w).iter().copied()).collect()
        } else {
            Vec::new()
        };
        Moment { world: *w, drones: (0..sim.n_drones).map(drone).collect(), obstacles }
    };
    let steps = look.data().steps.get(first).copied().unwrap_or(0);
    let snapshot = Snapshot {
        scene: arena.scene(first),
        vehicles: sim.setup.vehicles().iter().collect(),
        time_s: steps as f64 / f64::from(sim.setup.config().options.sim_hz),
        worlds: worlds.iter().filter(|w| look.layout(**w) == look.layout(first)).map(moment).collect(),
    };
    view::of_simulation(&snapshot)
}
