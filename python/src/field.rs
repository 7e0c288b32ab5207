//! Distance fields of scenes: the compiled side of `propwash.DistanceField`.

use numpy::{PyArrayDyn, PyArrayMethods};
use propwash::geometry::{DistanceField, FieldGrid};
use propwash::scalar::lanes::{Cell, F32x16};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::sim::PySim;

/// Signed distances on a grid.
#[pyclass(frozen, name = "Field", module = "propwash._native")]
pub struct PyField {
    pub field: DistanceField,
}

#[pymethods]
impl PyField {
    /// From an array (nx, ny, nz) of f32, in C order.
    #[new]
    fn new(
        data: &Bound<'_, PyArrayDyn<f32>>,
        origin: [f64; 3],
        resolution: f64,
        planes: Vec<[f64; 4]>,
        zero_inside: Vec<u32>,
    ) -> PyResult<Self> {
        let data = data.try_readonly()?;
        let shape = data.as_array().shape().to_vec();
        let [x, y, z] = shape[..] else {
            return Err(PyValueError::new_err(format!(
                "data: expected an array (nx, ny, nz), got the shape {shape:?}"
            )));
        };
        let grid = FieldGrid { origin_m: origin, resolution_m: resolution, counts: [x, y, z] };
        let data = data.as_array().iter().copied().collect();
        let field = DistanceField::new(grid, data, planes, zero_inside);
        Ok(Self { field: field.map_err(|e| PyValueError::new_err(e.to_string()))? })
    }

    /// The distances, a copy. (nx, ny, nz)
    fn data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::owned(py, self.field.data().to_vec(), &self.field.grid().counts)
    }

    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.field.grid().origin_m
    }

    #[getter]
    fn resolution(&self) -> f64 {
        self.field.grid().resolution_m
    }

    #[getter]
    fn planes(&self) -> Vec<[f64; 4]> {
        self.field.planes().to_vec()
    }

    #[getter]
    fn zero_inside(&self) -> Vec<u32> {
        self.field.zero_inside().to_vec()
    }

    /// Distances at points (n, 3), and their slopes. `fast`: in f32.
    #[allow(clippy::type_complexity)]
    fn at<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
        n: usize,
        fast: bool,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)> {
        let mut numbers = Vec::new();
        arrays::numbers("points", "(n, 3)", points, &[n, 3], &mut numbers)?;
        if let Some(i) = numbers.iter().position(|v| !v.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "points: expected finite numbers, got {} at place {i}",
                numbers[i]
            )));
        }
        let (mut distance, mut slopes) = (Vec::with_capacity(n), Vec::with_capacity(3 * n));
        py.detach(|| {
            if !fast {
                for p in numbers.chunks_exact(3) {
                    let (d, g) = self.field.at([p[0], p[1], p[2]]);
                    distance.push(d);
                    slopes.extend(g);
                }
                return;
            }
            for part in numbers.chunks(3 * F32x16::LANES) {
                let m = part.len() / 3;
                let mut pos = [F32x16::splat(0.0); 3];
                (0..3).for_each(|k| pos[k].fill(0, |lane| part[3 * lane.min(m - 1) + k] as f32));
                let (d, g) = self.field.at_lanes(&pos);
                for lane in 0..m {
                    distance.push(f64::from(d.get(lane)));
                    slopes.extend([0, 1, 2].map(|k| f64::from(g[k].get(lane))));
                }
            }
        });
        Ok((arrays::owned(py, distance, &[n])?, arrays::owned(py, slopes, &[n, 3])?))
    }
}

#[pymethods]
impl PySim {
    /// The distance field of a scene.
    #[pyo3(signature = (resolution, bounds, scene, most_bytes))]
    fn distance_field(
        &self,
        py: Python<'_>,
        resolution: f64,
        bounds: Option<[[f64; 3]; 2]>,
        scene: usize,
        most_bytes: u64,
    ) -> PyResult<PyField> {
        let scene = self.scene_of(scene)?;
        let baked = py.detach(|| self.pool.install(|| scene.distance_field(resolution, bounds, most_bytes)));
        Ok(PyField { field: baked.or_raise()? })
    }
}
