//! Whether options of a training make sense.

use crate::LearnError;

fn wrong(name: &'static str, expected: impl Into<String>, got: impl ToString) -> LearnError {
    LearnError::Option { name, expected: expected.into(), got: got.to_string() }
}

pub(crate) fn at_least_one(numbers: &[(&'static str, usize)]) -> Result<(), LearnError> {
    match numbers.iter().find(|(_, v)| *v == 0) {
        Some((name, _)) => Err(wrong(name, "at least 1", 0)),
        None => Ok(()),
    }
}

pub(crate) fn above_zero(numbers: &[(&'static str, f32)]) -> Result<(), LearnError> {
    match numbers.iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
        Some((name, v)) => Err(wrong(name, "a finite number above 0", v)),
        None => Ok(()),
    }
}

/// From 0 to below 1.
pub(crate) fn below_one(name: &'static str, v: f64) -> Result<(), LearnError> {
    if (0.0..1.0).contains(&v) { Ok(()) } else { Err(wrong(name, "a number from 0 to below 1", v)) }
}

pub(crate) fn up_to_one(numbers: &[(&'static str, f64)]) -> Result<(), LearnError> {
    match numbers.iter().find(|(_, v)| !(0.0..=1.0).contains(v)) {
        Some((name, v)) => Err(wrong(name, "a number from 0 to 1", v)),
        None => Ok(()),
    }
}

pub(crate) fn divides(substeps: usize, sim_hz: u32) -> Result<(), LearnError> {
    if (sim_hz as usize).is_multiple_of(substeps) {
        return Ok(());
    }
    let expected =
        format!("a divisor of {sim_hz} steps a second, so that commands are a whole number a second");
    Err(wrong("substeps", expected, substeps))
}
