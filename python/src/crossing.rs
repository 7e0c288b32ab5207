//! Policies that cross forests by what a camera shows and that change places in swarms, trained by gradients: the compiled side of `propwash.learn.cross` and `swap`.

use numpy::PyArrayDyn;
use propwash::env::crossing::{Crossed, NEARNESS, Sight};
use propwash::env::{EnvConfig, EnvError, train_crossing, train_swapping};
use propwash::learn::Options;
use propwash::learn::goals::{Cross, Swap, cross, swap};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPoolBuilder;

use crate::errors::{Error, OrRaise};
use crate::learn::{curve_of, parts_of};

/// A trained policy and how it came to be.
#[pyclass(frozen, name = "Crossed", module = "propwash._native")]
pub struct PyCrossed {
    crossed: Crossed,
    /// What inputs are multiplied by.
    scales: Vec<f64>,
}

/// A number by name; NaN, which nothing takes, where there is none.
fn number(dict: &Bound<'_, PyDict>, key: &str) -> PyResult<f64> {
    dict.get_item(key)?.map_or(Ok(f64::NAN), |v| v.extract())
}

/// Options of a training.
fn options_of(options: &Bound<'_, PyDict>) -> PyResult<Options> {
    let whole = |key: &str| -> PyResult<usize> { options.get_item(key)?.map_or(Ok(0), |v| v.extract()) };
    Ok(Options {
        worlds: whole("worlds")?,
        horizon: whole("horizon")?,
        commands: whole("commands")?,
        hidden: options.get_item("hidden")?.map_or(Ok(vec![64, 64]), |v| v.extract())?,
        rate: number(options, "rate")? as f32,
        longest: number(options, "longest")? as f32,
        ..Options::default()
    })
}

/// Trains by so many threads, none for all.
fn trained(
    py: Python<'_>,
    threads: Option<usize>,
    train: impl FnOnce() -> Result<Crossed, EnvError> + Send,
) -> PyResult<Crossed> {
    let crossed = py.detach(|| match threads {
        None => Ok(train()),
        Some(n) => ThreadPoolBuilder::new().num_threads(n).build().map(|pool| pool.install(train)),
    });
    crossed.map_err(|e| Error::new_err(format!("threads: {e}")))?.or_raise()
}

/// Trains a policy in the scenes of an environment: its description as JSON; numbers of the goal, blocks of the image, options of the training; number of threads,
/// none for all.
#[pyfunction]
pub fn learn_cross(
    py: Python<'_>,
    config: &str,
    goal: &Bound<'_, PyDict>,
    block: [usize; 2],
    options: &Bound<'_, PyDict>,
    threads: Option<usize>,
) -> PyResult<PyCrossed> {
    let config = EnvConfig::from_text(config).or_raise()?;
    let goal = Cross {
        speed_m_s: number(goal, "speed")?,
        keep_m: number(goal, "keep")?,
        ceiling_m: number(goal, "ceiling")?,
        arrive_m: number(goal, "arrive")?,
        touch_m: number(goal, "touch")?,
        detour_m: number(goal, "detour")?,
        episode_s: number(goal, "time")?,
    };
    let options = options_of(options)?;
    let crossed = trained(py, threads, || train_crossing(config, &goal, Sight { block }, &options))?;
    let scales = [&cross::SCALES[..], &[cross::LEAST_M], &NEARNESS].concat();
    Ok(PyCrossed { crossed, scales })
}

/// Trains a policy that flies every drone of a swarm, as [`learn_cross`] does one.
#[pyfunction]
pub fn learn_swap(
    py: Python<'_>,
    config: &str,
    goal: &Bound<'_, PyDict>,
    options: &Bound<'_, PyDict>,
    threads: Option<usize>,
) -> PyResult<PyCrossed> {
    let config = EnvConfig::from_text(config).or_raise()?;
    let goal = Swap {
        speed_m_s: number(goal, "speed")?,
        keep_m: number(goal, "keep")?,
        foresee_s: number(goal, "foresee")?,
        height_m: [number(goal, "floor")?, number(goal, "ceiling")?],
        arrive_m: number(goal, "arrive")?,
        touch_m: number(goal, "touch")?,
        episode_s: number(goal, "time")?,
        ..Swap::default()
    };
    let options = options_of(options)?;
    let crossed = trained(py, threads, || train_swapping(config, &goal, &options))?;
    let scales = [&swap::SCALES[..], &swap::LEAST_M, &swap::NEARNESS].concat();
    Ok(PyCrossed { crossed, scales })
}

#[pymethods]
impl PyCrossed {
    /// Time to compile the scenes and to bake their fields, and time in all, s.
    #[getter]
    fn seconds(&self) -> [f64; 2] {
        self.crossed.seconds
    }

    /// Worlds that began anew since they touched something or went astray.
    #[getter]
    fn lost(&self) -> usize {
        self.crossed.trained.lost
    }

    /// Commands flown so far, and the mean cost of a command.
    #[allow(clippy::type_complexity)]
    fn curve<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<u64>>, Bound<'py, PyArrayDyn<f64>>)> {
        curve_of(py, &self.crossed.trained.curve)
    }

    /// The network and what surrounds it, as that of `Learnt`; the last scales are those of nearness.
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        parts_of(py, &self.crossed.trained.policy, &self.scales)
    }
}
