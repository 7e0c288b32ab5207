//! Policies trained in the lanes in which they fly: the compiled side of `propwash.learn`.

use std::time::Instant;

use numpy::PyArrayDyn;
use propwash::env::{TaskTexts, WrittenTask};
use propwash::learn::goals::written::{Remembered, Starts, Texts};
use propwash::learn::goals::{
    Gate, Gates, Land, Reach, Recover, Track, Written, gates, land, reach, recover, track,
};
use propwash::learn::{Actions, Critic, Curve, Flown, LearnError, Options, Policy, Trained, ppo, train};
use propwash::physics::controllers::ControlMode;
use propwash::vehicle::Vehicle;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::errors::{IntoPython, OrRaise};
use crate::vehicle::PyVehicle;

/// What there is to be learnt.
enum AnyGoal {
    Track(Track),
    Recover(Recover),
    Reach(Reach),
    Land(Land),
    Gates(Gates),
    Written(Box<Written>),
}

/// The same expression for every goal.
macro_rules! each {
    ($goal:expr, $of:ident => $body:expr) => {
        match $goal {
            AnyGoal::Track($of) => $body,
            AnyGoal::Recover($of) => $body,
            AnyGoal::Reach($of) => $body,
            AnyGoal::Land($of) => $body,
            AnyGoal::Gates($of) => $body,
            AnyGoal::Written(boxed) => {
                let $of = &**boxed;
                $body
            }
        }
    };
}

impl IntoPython for LearnError {
    fn into_python(self) -> PyErr {
        match self {
            LearnError::Rollout(e) => e.into_python(),
            LearnError::Vehicle(e) => e.into_python(),
            other => PyValueError::new_err(other.to_string()),
        }
    }
}

/// A trained policy and how it came to be.
#[pyclass(frozen, name = "Learnt", module = "propwash._native")]
pub struct PyLearnt {
    goal: AnyGoal,
    trained: Trained,
    vehicle: Vehicle,
    dynamics: String,
    seconds: f64,
}

/// Numbers of a goal or of a training, by name.
struct Numbers<'a, 'py>(&'a Bound<'py, PyDict>);

impl Numbers<'_, '_> {
    fn get<T: for<'a> FromPyObject<'a, 'a, Error = PyErr>>(&self, key: &str, usual: T) -> PyResult<T> {
        self.0.get_item(key)?.map_or(Ok(usual), |value| value.extract())
    }

    /// A number that must be finite and above zero, or not below it.
    fn size(&self, key: &str, usual: f64, zero: bool) -> PyResult<f64> {
        let value = self.get(key, usual)?;
        if value.is_finite() && (value > 0.0 || zero && value == 0.0) {
            return Ok(value);
        }
        let expected = if zero { "a finite number of at least 0" } else { "a finite number above 0" };
        Err(PyValueError::new_err(format!("{key}: expected {expected}, got {value}")))
    }

    fn above(&self, key: &str, usual: f64) -> PyResult<f64> {
        self.size(key, usual, false)
    }

    /// What episodes of a goal of expressions remember.
    fn memory(&self) -> PyResult<Vec<Remembered>> {
        let listed: Vec<(String, [f64; 2], String)> = self.get("memory", Vec::new())?;
        Ok(listed.into_iter().map(|(name, between, next)| Remembered { name, between, next }).collect())
    }

    /// Where they begin.
    fn starts(&self) -> PyResult<Starts> {
        let usual = Starts::default();
        Ok(Starts {
            pos_m: self.get("pos", usual.pos_m)?,
            vel_m_s: self.get("vel", usual.vel_m_s)?,
            ang_vel_rad_s: self.get("ang_vel", usual.ang_vel_rad_s)?,
            turn_rad: self.get("turn", usual.turn_rad)?,
            time_s: self.get("begin", usual.time_s)?,
        })
    }
}

/// A goal by name, with its numbers.
fn goal_of(name: &str, numbers: &Bound<'_, PyDict>) -> PyResult<AnyGoal> {
    let given = Numbers(numbers);
    match name {
        "track" => {
            let usual = Track::default();
            Ok(AnyGoal::Track(Track { period_s: given.above("period", usual.period_s)?, ..usual }))
        }
        "recover" => {
            let usual = Recover::default();
            Ok(AnyGoal::Recover(Recover {
                speed_m_s: given.above("speed", usual.speed_m_s)?,
                spin_rad_s: given.above("spin", usual.spin_rad_s)?,
                lean_rad: given.above("lean", usual.lean_rad)?,
                time_s: given.above("time", usual.time_s)?,
            }))
        }
        "reach" => {
            let usual = Reach::default();
            Ok(AnyGoal::Reach(Reach {
                far_m: given.above("far", usual.far_m)?,
                speed_m_s: given.above("speed", usual.speed_m_s)?,
                time_s: given.above("time", usual.time_s)?,
            }))
        }
        "land" => {
            let usual = Land::default();
            let height_m: f64 = given.get("height", usual.height_m)?;
            if !height_m.is_finite() {
                return Err(PyValueError::new_err(format!(
                    "height: expected a finite number, got {height_m}"
                )));
            }
            Ok(AnyGoal::Land(Land {
                height_m,
                beside_m: given.above("beside", usual.beside_m)?,
                above_m: given.above("above", usual.above_m)?,
                time_s: given.above("time", usual.time_s)?,
            }))
        }
        "gates" => gates_of(&given),
        "written" => written_of(&given),
        _ => {
            let expected = "`track`, `recover`, `reach`, `land` or `gates`";
            Err(PyValueError::new_err(format!("goal: expected {expected}, got {name:?}")))
        }
    }
}

/// A goal of expressions.
fn written_of(given: &Numbers<'_, '_>) -> PyResult<AnyGoal> {
    let texts = Texts {
        lets: given.get("lets", Vec::new())?,
        observe: given.get("observe", Vec::new())?,
        cost: given.get("cost", String::new())?,
        off_m: given.get("off", String::new())?,
        reached: given.get("reached", String::new())?,
        done: given.get("done", String::new())?,
        lost: given.get("lost", String::new())?,
        memory: given.memory()?,
    };
    let sizes = (given.get("time", 4.0)?, given.get("far", 10.0)?, given.get("lost_cost", 100.0)?);
    Written::new(&texts, given.starts()?, sizes).or_raise().map(|goal| AnyGoal::Written(Box::new(goal)))
}

/// A goal of expressions as the task of an environment.
pub fn written_task(numbers: &Bound<'_, PyDict>) -> PyResult<WrittenTask> {
    let given = Numbers(numbers);
    let texts = TaskTexts {
        name: given.get("name", String::new())?,
        lets: given.get("lets", Vec::new())?,
        observe: given.get("observe", Vec::new())?,
        reward: given.get("reward", String::new())?,
        left: given.get("lost", String::new())?,
        done: given.get("done", String::new())?,
        crash_ends: given.get("crash_ends", true)?,
        memory: given.memory()?,
        goal: given.get("goal", None)?,
    };
    WrittenTask::new(texts, given.starts()?).or_raise()
}

/// A race: its gates as (centre, normal, radius), those of the default where none are given.
fn gates_of(given: &Numbers<'_, '_>) -> PyResult<AnyGoal> {
    let usual = Gates::default();
    let listed: Vec<([f64; 3], [f64; 3], f64)> = given.get("gates", Vec::new())?;
    let body_m = given.above("body", usual.body_m)?;
    let mut gates = if listed.is_empty() { usual.gates.clone() } else { Vec::new() };
    for (k, (centre_m, normal, radius_m)) in listed.into_iter().enumerate() {
        let wrong = |what: &str, expected: &str, got: String| {
            Err(PyValueError::new_err(format!("gates[{k}].{what}: expected {expected}, got {got}")))
        };
        let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        if centre_m.iter().any(|v| !v.is_finite()) {
            return wrong("centre", "finite numbers", format!("{centre_m:?}"));
        }
        if !(length - 1.0).abs().lt(&1e-6) {
            return wrong("normal", "a vector of length 1", format!("{normal:?}, of length {length}"));
        }
        if !(radius_m.is_finite() && radius_m > body_m) {
            return wrong(
                "radius",
                &format!("more than the drone's {body_m} m (`body`)"),
                format!("{radius_m}"),
            );
        }
        gates.push(Gate { centre_m, normal, radius_m });
    }
    Ok(AnyGoal::Gates(Gates {
        gates,
        rim_m: given.size("rim", usual.rim_m, true)?,
        body_m,
        moved_m: given.size("moved", usual.moved_m, true)?,
        turned_rad: given.size("turned", usual.turned_rad, true)?,
        speed_m_s: given.above("speed", usual.speed_m_s)?,
        laps: given.get("laps", usual.laps)?,
        time_s: given.above("time", usual.time_s)?,
    }))
}

fn actions_of(vehicle: &Vehicle, dynamics: &str, action: &str) -> PyResult<Actions> {
    let drone = vehicle.drone(dynamics).or_raise()?;
    match action {
        "attitude" => Ok(Actions::attitude(&drone)),
        "rotor_vel" => Ok(Actions::rotors(&drone)),
        _ => {
            let expected = "`attitude` or `rotor_vel`";
            Err(PyValueError::new_err(format!("action: expected {expected}, got {action:?}")))
        }
    }
}

/// Commands flown so far, and the mean cost of a command.
#[allow(clippy::type_complexity)]
pub fn curve_of<'py>(
    py: Python<'py>,
    curve: &Curve,
) -> PyResult<(Bound<'py, PyArrayDyn<u64>>, Bound<'py, PyArrayDyn<f64>>)> {
    let commands: Vec<u64> = curve.commands.iter().map(|n| *n as u64).collect();
    let n = commands.len();
    Ok((arrays::owned(py, commands, &[n])?, arrays::owned(py, curve.cost.clone(), &[n])?))
}

/// A network and what surrounds it, for `propwash.Policy`.
pub fn parts_of<'py>(py: Python<'py>, policy: &Policy, scales: &[f64]) -> PyResult<Bound<'py, PyDict>> {
    let widths = policy.network.widths();
    let mut rest = policy.network.weights();
    let mut layers = Vec::new();
    for pair in widths.windows(2) {
        let (weight, behind) = rest.split_at(pair[0] * pair[1]);
        let (bias, others) = behind.split_at(pair[1]);
        rest = others;
        let weight = arrays::owned(py, weight.to_vec(), &[pair[1], pair[0]])?;
        layers.push((weight, arrays::owned(py, bias.to_vec(), &[pair[1]])?));
    }
    let out = PyDict::new(py);
    out.set_item("layers", layers)?;
    out.set_item("middle", policy.actions.middle.clone())?;
    out.set_item("reach", policy.actions.reach.clone())?;
    let kind = if policy.actions.mode == ControlMode::RotorVel { "rotor_vel" } else { "attitude" };
    out.set_item("kind", kind)?;
    out.set_item("scales", scales)?;
    out.set_item("step_hz", policy.sim_hz as usize / policy.substeps)?;
    Ok(out)
}

/// What a training makes of a goal and a vehicle, with the time that it takes.
fn learnt(
    py: Python<'_>,
    goal: AnyGoal,
    (vehicle, dynamics, action): (&PyVehicle, &str, &str),
    train: impl Fn(&AnyGoal, (&Vehicle, &str), &Actions) -> Result<Trained, LearnError> + Sync,
) -> PyResult<PyLearnt> {
    let vehicle = vehicle.vehicle.clone();
    let actions = actions_of(&vehicle, dynamics, action)?;
    let began = Instant::now();
    let trained = py.detach(|| train(&goal, (&vehicle, dynamics), &actions)).or_raise()?;
    let (seconds, dynamics) = (began.elapsed().as_secs_f64(), dynamics.to_string());
    Ok(PyLearnt { goal, trained, vehicle, dynamics, seconds })
}

/// Trains a policy by backpropagation through time.
#[pyfunction]
#[pyo3(signature = (goal, numbers, vehicle, dynamics, action, options))]
pub fn learn_bptt(
    py: Python<'_>,
    goal: &str,
    numbers: &Bound<'_, PyDict>,
    vehicle: &PyVehicle,
    dynamics: &str,
    action: &str,
    options: &Bound<'_, PyDict>,
) -> PyResult<PyLearnt> {
    let (goal, given, usual) = (goal_of(goal, numbers)?, Numbers(options), Options::default());
    let critic = match options.get_item("critic")? {
        Some(value) if !value.is_none() => {
            let (table, usual) = (value.cast_into::<PyDict>()?, Critic::default());
            let given = Numbers(&table);
            Some(Critic {
                discount: given.get("discount", usual.discount)?,
                lambda: given.get("lam", usual.lambda)?,
                follow: given.get("follow", usual.follow)?,
                rate: given.get("rate", usual.rate)?,
                epochs: given.get("epochs", usual.epochs)?,
                parts: given.get("parts", usual.parts)?,
            })
        }
        _ => None,
    };
    let options = Options {
        worlds: given.get("worlds", usual.worlds)?,
        horizon: given.get("horizon", usual.horizon)?,
        substeps: given.get("substeps", usual.substeps)?,
        sim_hz: given.get("freq", usual.sim_hz)?,
        commands: given.get("commands", usual.commands)?,
        hidden: given.get("hidden", usual.hidden)?,
        rate: given.get("rate", usual.rate)?,
        longest: given.get("longest", usual.longest)?,
        critic,
        seed: given.get("seed", 0)?,
    };
    learnt(
        py,
        goal,
        (vehicle, dynamics, action),
        |goal, of, actions| each!(goal, goal => train(goal, of, actions, &options)),
    )
}

/// Trains a policy by proximal policy optimisation.
#[pyfunction]
#[pyo3(signature = (goal, numbers, vehicle, dynamics, action, options))]
pub fn learn_ppo(
    py: Python<'_>,
    goal: &str,
    numbers: &Bound<'_, PyDict>,
    vehicle: &PyVehicle,
    dynamics: &str,
    action: &str,
    options: &Bound<'_, PyDict>,
) -> PyResult<PyLearnt> {
    let (goal, given, usual) = (goal_of(goal, numbers)?, Numbers(options), ppo::Options::default());
    let options = ppo::Options {
        worlds: given.get("worlds", usual.worlds)?,
        horizon: given.get("horizon", usual.horizon)?,
        substeps: given.get("substeps", usual.substeps)?,
        sim_hz: given.get("freq", usual.sim_hz)?,
        commands: given.get("commands", usual.commands)?,
        hidden: given.get("hidden", usual.hidden)?,
        rate: given.get("rate", usual.rate)?,
        longest: given.get("longest", usual.longest)?,
        discount: given.get("discount", usual.discount)?,
        lambda: given.get("lam", usual.lambda)?,
        clip: given.get("clip", usual.clip)?,
        epochs: given.get("epochs", usual.epochs)?,
        parts: given.get("parts", usual.parts)?,
        noise: given.get("noise", usual.noise)?,
        entropy: given.get("entropy", usual.entropy)?,
        seed: given.get("seed", 0)?,
    };
    learnt(
        py,
        goal,
        (vehicle, dynamics, action),
        |goal, of, actions| each!(goal, goal => ppo::train(goal, of, actions, &options)),
    )
}

#[pymethods]
impl PyLearnt {
    /// Seconds that it took.
    #[getter]
    fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Worlds that began anew since they went astray.
    #[getter]
    fn lost(&self) -> usize {
        self.trained.lost
    }

    /// Commands flown so far, and the mean cost of a command.
    #[allow(clippy::type_complexity)]
    fn curve<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<u64>>, Bound<'py, PyArrayDyn<f64>>)> {
        curve_of(py, &self.trained.curve)
    }

    /// The network and what surrounds it: weights and biases of each layer, commands of action zero, what is added for one, the kind of action, scales of
    /// the inputs, actions a second.
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scales = match self.goal {
            AnyGoal::Track(_) => track::SCALES,
            AnyGoal::Recover(_) => recover::SCALES,
            AnyGoal::Reach(_) => reach::SCALES,
            AnyGoal::Land(_) => land::SCALES,
            AnyGoal::Gates(_) => gates::SCALES,
            AnyGoal::Written(_) => [1.0; 3],
        };
        parts_of(py, &self.trained.policy, &scales)
    }

    /// Flies it, from starts that the training has not seen: error (rms, most, m), flights that ended as they should, that were lost, the path of the
    /// first, and the last state of each.
    #[allow(clippy::type_complexity)]
    fn fly<'py>(
        &self,
        py: Python<'py>,
        vehicle: Option<&PyVehicle>,
        flights: usize,
        settle_s: f64,
        seed: u64,
    ) -> PyResult<(f64, f64, usize, usize, Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)> {
        if flights == 0 {
            return Err(PyValueError::new_err("flights: expected at least 1, got 0"));
        }
        let vehicle = vehicle.map_or(&self.vehicle, |v| &v.vehicle);
        let of = (vehicle, &self.dynamics[..]);
        let how = (flights, settle_s, seed);
        let flown = py.detach(|| each!(&self.goal, goal => self.trained.policy.fly(goal, of, how)));
        let Flown { off_rms_m, off_most_m, reached, lost, path_m, ends } = flown.or_raise()?;
        let n = path_m.len();
        let path = arrays::owned(py, path_m.into_iter().flatten().collect(), &[n, 3])?;
        let ends = arrays::owned(py, ends.into_iter().flatten().collect(), &[flights, 13])?;
        Ok((off_rms_m, off_most_m, reached, lost, path, ends))
    }
}
