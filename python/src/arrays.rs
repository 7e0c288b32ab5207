//! Arrays between NumPy and Rust: views of what Rust stores, and numbers from whatever the caller has.

use numpy::ndarray::{ArrayViewMutD, IxDyn};
use numpy::{
    Element, IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use propwash::scalar::lanes::Number;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyString;

/// A view of `data` in C order. It keeps `owner` alive.
///
/// # Safety
/// `owner` owns `data`, never moves or resizes it while it lives, and no Rust reference to its numbers is in use while Python
/// code runs that may touch the view.
pub unsafe fn view<'py, T: Element>(
    data: &mut [T],
    shape: &[usize],
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let array = ArrayViewMutD::from_shape(IxDyn(shape), data)
        .map_err(|e| PyValueError::new_err(format!("an array of shape {shape:?} was expected: {e}")))?;
    // SAFETY: by the contract of this function.
    Ok(unsafe { PyArrayDyn::borrow_from_array(&array, owner) })
}

/// A new array that owns `data`.
pub fn owned<'py, T: Element>(
    py: Python<'py>,
    data: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    data.into_pyarray(py).reshape(IxDyn(shape))
}

/// The shape as Python writes it.
pub fn tuple(shape: &[usize]) -> String {
    match shape {
        [n] => format!("({n},)"),
        _ => format!("({})", shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    }
}

fn wrong_shape(name: &str, axes: &str, expected: &[usize], got: &[usize]) -> PyErr {
    PyValueError::new_err(format!("{name}: expected shape {} = {axes}, got {}", tuple(expected), tuple(got)))
}

fn extend<T: Element + Copy>(array: &PyReadonlyArrayDyn<'_, T>, out: &mut Vec<f64>, wide: impl Fn(T) -> f64) {
    match array.as_slice() {
        // A slice of an array in Fortran's order has another order.
        Ok(numbers) if array.is_c_contiguous() => out.extend(numbers.iter().map(|v| wide(*v))),
        _ => out.extend(array.as_array().iter().map(|v| wide(*v))),
    }
}

/// The numbers of an array or of anything that NumPy makes one of (lists, tensors on the processor), whose shape must be
/// `shape`; `axes` names its axes. `out` is cleared first.
///
/// # Errors
/// TypeError for what holds no real numbers, ValueError for another shape.
pub fn numbers(
    name: &str,
    axes: &str,
    value: &Bound<'_, PyAny>,
    shape: &[usize],
    out: &mut Vec<f64>,
) -> PyResult<()> {
    out.clear();
    let check = |got: &[usize]| if got == shape { Ok(()) } else { Err(wrong_shape(name, axes, shape, got)) };
    if let Ok(array) = value.cast::<PyArrayDyn<f64>>() {
        check(array.shape())?;
        extend(&array.try_readonly()?, out, |v| v);
        return Ok(());
    }
    if let Ok(array) = value.cast::<PyArrayDyn<f32>>() {
        check(array.shape())?;
        extend(&array.try_readonly()?, out, f64::from);
        return Ok(());
    }
    let array = as_array(name, value)?;
    check(array.shape())?;
    let py = value.py();
    let wide = array.call_method1(pyo3::intern!(py, "astype"), (pyo3::intern!(py, "float64"),))?;
    extend(&wide.cast::<PyArrayDyn<f64>>()?.try_readonly()?, out, |v| v);
    Ok(())
}

/// [`numbers`] as numbers of one type: those of an array of that type are copied as they are.
///
/// # Errors
/// As there.
pub fn numbers_as<N: Number + Element>(
    name: &str,
    axes: &str,
    value: &Bound<'_, PyAny>,
    shape: &[usize],
) -> PyResult<Vec<N>> {
    if let Ok(array) = value.cast::<PyArrayDyn<N>>()
        && array.shape() == shape
    {
        let array = array.try_readonly()?;
        // A slice of an array in Fortran's order has another order.
        if array.is_c_contiguous()
            && let Ok(own) = array.as_slice()
        {
            return Ok(own.to_vec());
        }
    }
    let mut wide = Vec::new();
    numbers(name, axes, value, shape, &mut wide)?;
    Ok(wide.into_iter().map(N::of).collect())
}

/// Whatever NumPy makes of `value`, if it holds integers or floating-point numbers.
fn as_array<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyUntypedArray>> {
    static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = value.py();
    let fault =
        |got: String| PyTypeError::new_err(format!("{name}: expected an array of real numbers, got {got}"));
    let class = || {
        let class = value.get_type();
        class.name().map_or_else(|_| "an object".into(), |n| n.to_string_lossy().into_owned())
    };
    let made = AS_ARRAY.import(py, "numpy", "asarray")?.call1((value,));
    let array = made.map_err(|e| {
        let why = e.value(py).str().map_or_else(|_| String::new(), |s| s.to_string_lossy().into_owned());
        fault(format!("{}, of which NumPy makes none: {why}", class()))
    })?;
    let array = array.cast_into::<PyUntypedArray>().map_err(|_| fault(class()))?;
    let dtype = array.dtype();
    let kind = dtype.getattr(pyo3::intern!(py, "kind"))?;
    let kind = kind.cast::<PyString>()?.to_string_lossy().into_owned();
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(fault(format!("{} of dtype {dtype}", class())));
    }
    Ok(array)
}

/// A mask of worlds. `None` stays `None`.
///
/// # Errors
/// TypeError unless it holds booleans, ValueError for another shape.
pub fn mask(name: &str, value: Option<&Bound<'_, PyAny>>, n_worlds: usize) -> PyResult<Option<Vec<bool>>> {
    static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let Some(value) = value else { return Ok(None) };
    let array = AS_ARRAY.import(value.py(), "numpy", "asarray")?.call1((value,))?;
    let array = array.cast_into::<PyUntypedArray>()?;
    let Ok(flags) = array.cast::<PyArrayDyn<bool>>() else {
        return Err(PyTypeError::new_err(format!(
            "{name}: expected booleans of shape ({n_worlds},), one for each world, got dtype {}",
            array.dtype()
        )));
    };
    if flags.shape() != [n_worlds] {
        return Err(wrong_shape(name, "(n_worlds,)", &[n_worlds], flags.shape()));
    }
    Ok(Some(flags.try_readonly()?.as_array().iter().copied().collect()))
}
