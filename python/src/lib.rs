//! The compiled module `propwash._native`, a thin layer between Python and the library: arguments in, views and arrays out.
//! What users call stands in `python/propwash`.

mod arrays;
mod camera;
mod commands;
mod crossing;
mod doubt;
mod env;
mod errors;
mod field;
mod function;
mod gap;
mod lab;
mod learn;
mod plain;
mod program;
mod recorder;
mod sampling;
mod sense;
mod sim;
mod sitl;
mod slopes;
mod stages;
mod state;
mod tape;
mod task;
mod threads;
mod vehicle;
mod view;

use pyo3::prelude::*;

use errors::OrRaise;

/// Loads a library of MuJoCo plugins, for all scenes built afterwards.
#[pyfunction]
fn load_plugin_library(path: std::path::PathBuf) -> PyResult<()> {
    propwash::scene::load_plugin_library(&path).or_raise()
}

/// Names of the scenes that come with the package.
#[pyfunction]
fn scenes() -> Vec<&'static str> {
    propwash::scene::SCENES.to_vec()
}

/// Version of the MuJoCo library in use.
#[pyfunction]
fn mujoco_version() -> String {
    propwash::scene::mujoco_version()
}

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("Error", m.py().get_type::<errors::Error>())?;
    m.add_class::<vehicle::PyVehicle>()?;
    m.add_class::<stages::RestOnGround>()?;
    m.add_class::<sim::PySim>()?;
    m.add_class::<state::PyState>()?;
    m.add_class::<tape::PyTape>()?;
    m.add_class::<field::PyField>()?;
    m.add_class::<plain::PyCost>()?;
    m.add_class::<camera::PyCameras>()?;
    m.add_class::<recorder::PyRecorder>()?;
    m.add_class::<sitl::PySitl>()?;
    m.add_class::<env::PyEnv>()?;
    m.add_class::<task::TaskDraws>()?;
    m.add_function(wrap_pyfunction!(task::built_in_tasks, m)?)?;
    m.add_function(wrap_pyfunction!(env::depth_devices, m)?)?;
    m.add_function(wrap_pyfunction!(env::env_config, m)?)?;
    m.add_function(wrap_pyfunction!(env::rules_json, m)?)?;
    m.add_function(wrap_pyfunction!(slopes::depth_slopes, m)?)?;
    m.add_function(wrap_pyfunction!(slopes::depth_known, m)?)?;
    m.add_function(wrap_pyfunction!(slopes::depth_pull_back, m)?)?;
    m.add_function(wrap_pyfunction!(slopes::clearance_pull_back, m)?)?;
    m.add_function(wrap_pyfunction!(sim::read_config, m)?)?;
    m.add_class::<function::PyFunction>()?;
    m.add_function(wrap_pyfunction!(vehicle::vehicles, m)?)?;
    m.add_function(wrap_pyfunction!(vehicle::vehicle_of, m)?)?;
    m.add_function(wrap_pyfunction!(vehicle::network_files, m)?)?;
    m.add_class::<lab::PyLab>()?;
    m.add_class::<learn::PyLearnt>()?;
    m.add_class::<sampling::PyPlanner>()?;
    m.add_function(wrap_pyfunction!(learn::learn_bptt, m)?)?;
    m.add_function(wrap_pyfunction!(learn::learn_ppo, m)?)?;
    m.add_class::<crossing::PyCrossed>()?;
    m.add_function(wrap_pyfunction!(crossing::learn_cross, m)?)?;
    m.add_function(wrap_pyfunction!(crossing::learn_swap, m)?)?;
    m.add_function(wrap_pyfunction!(gap::gap_compare, m)?)?;
    m.add_function(wrap_pyfunction!(gap::gap_diagnose, m)?)?;
    m.add_function(wrap_pyfunction!(gap::gap_watch, m)?)?;
    m.add_function(wrap_pyfunction!(commands::read_flight, m)?)?;
    m.add_function(wrap_pyfunction!(commands::fly, m)?)?;
    m.add_function(wrap_pyfunction!(commands::lint, m)?)?;
    m.add_function(wrap_pyfunction!(commands::scene_new, m)?)?;
    m.add_function(wrap_pyfunction!(commands::log_check, m)?)?;
    m.add_function(wrap_pyfunction!(commands::identify, m)?)?;
    m.add_function(wrap_pyfunction!(commands::vehicle_new, m)?)?;
    m.add_function(wrap_pyfunction!(commands::vehicle_throttle, m)?)?;
    m.add_function(wrap_pyfunction!(commands::excite, m)?)?;
    m.add_function(wrap_pyfunction!(commands::manoeuvres, m)?)?;
    m.add_function(wrap_pyfunction!(commands::tell_apart, m)?)?;
    m.add_function(wrap_pyfunction!(commands::waypoints, m)?)?;
    m.add_function(wrap_pyfunction!(program::run_program, m)?)?;
    m.add_function(wrap_pyfunction!(view::view_page, m)?)?;
    m.add_function(wrap_pyfunction!(load_plugin_library, m)?)?;
    m.add_function(wrap_pyfunction!(mujoco_version, m)?)?;
    m.add_function(wrap_pyfunction!(scenes, m)?)?;
    Ok(())
}
