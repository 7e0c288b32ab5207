//! Policies that cross forests by what a camera shows, trained by gradients: the compiled side of `propwash.learn.cross`.

use numpy::PyArrayDyn;
use propwash::env::crossing::{Crossed, NEARNESS, Sight};
use propwash::env::{EnvConfig, train_crossing};
use propwash::learn::Options;
use propwash::learn::goals::{Cross, cross};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPoolBuilder;

use crate::errors::{Error, OrRaise};
use crate::learn::{curve_of, parts_of};

/// A trained policy and how it came to be.
#[pyclass(frozen, name = "Crossed", module = "propwash._native")]
pub struct PyCrossed {
    crossed: Crossed,
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
    let of = |dict: &Bound<'_, PyDict>, key: &str| -> PyResult<f64> {
        dict.get_item(key)?.map_or(Ok(f64::NAN), |v| v.extract())
    };
    let whole = |key: &str| -> PyResult<usize> { options.get_item(key)?.map_or(Ok(0), |v| v.extract()) };
    let goal = Cross {
        speed_m_s: of(goal, "speed")?,
        keep_m: of(goal, "keep")?,
        ceiling_m: of(goal, "ceiling")?,
        arrive_m: of(goal, "arrive")?,
        touch_m: of(goal, "touch")?,
        episode_s: of(goal, "time")?,
    };
    let options = Options {
        worlds: whole("worlds")?,
        horizon: whole("horizon")?,
        commands: whole("commands")?,
        hidden: options.get_item("hidden")?.map_or(Ok(vec![64, 64]), |v| v.extract())?,
        rate: of(options, "rate")? as f32,
        longest: of(options, "longest")? as f32,
        ..Options::default()
    };
    let train = || train_crossing(config, &goal, Sight { block }, &options);
    let crossed = py.detach(|| match threads {
        None => Ok(train()),
        Some(n) => ThreadPoolBuilder::new().num_threads(n).build().map(|pool| pool.install(train)),
    });
    let crossed = crossed.map_err(|e| Error::new_err(format!("threads: {e}")))?;
    Ok(PyCrossed { crossed: crossed.or_raise()? })
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

    /// The network and what surrounds it, as that of `Learnt`; the last two scales are those of nearness.
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scales = [&cross::SCALES[..], &[cross::LEAST_M], &NEARNESS].concat();
        parts_of(py, &self.crossed.trained.policy, &scales)
    }
}
