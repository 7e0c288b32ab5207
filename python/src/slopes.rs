//! How depths of images change with the poses that they depend on.

use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use propwash::scene::Pose;
use propwash::sense::{DepthKind, PoseGain, SlopedImage};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;

/// Images of a frame, one after the other; `propwash.DepthFrame` says what each is.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Images<'py> {
    depth: PyReadonlyArrayDyn<'py, f32>,
    status: PyReadonlyArrayDyn<'py, u8>,
    geom_id: PyReadonlyArrayDyn<'py, i32>,
    normal: PyReadonlyArrayDyn<'py, f32>,
    pos: PyReadonlyArrayDyn<'py, f64>,
    quat: PyReadonlyArrayDyn<'py, f64>,
    k: PyReadonlyArrayDyn<'py, f64>,
    z_depth: bool,
}

/// Drones of the worlds of a frame.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Drones<'py> {
    /// (n_worlds, n_drones, 3) and (n_worlds, n_drones, 4).
    pos: PyReadonlyArrayDyn<'py, f64>,
    quat: PyReadonlyArrayDyn<'py, f64>,
    /// The drone that carries each camera, −1 for none.
    carrier: Vec<i64>,
    /// The drone of each geom, −1 for none, for every scene; and the scene of each world.
    of_geom: Vec<Vec<i64>>,
    layout: Vec<usize>,
}

/// Three numbers of row `i`.
fn three(numbers: &[f64], i: usize) -> [f64; 3] {
    core::array::from_fn(|k| numbers[3 * i + k])
}

fn pose(pos: &[f64], quat: &[f64], i: usize) -> Pose {
    Pose::new(three(pos, i), core::array::from_fn(|k| quat[4 * i + k]))
}

fn wrong(what: &str) -> PyErr {
    PyValueError::new_err(format!(
        "{what}: expected as many as the frame has images, all as they came out of depth_frame"
    ))
}

/// The numbers of an array in C order.
fn slice<'a, T: numpy::Element>(
    name: &str,
    array: &'a PyReadonlyArrayDyn<'_, T>,
    n: usize,
) -> PyResult<&'a [T]> {
    array.as_slice().ok().filter(|s| s.len() == n).ok_or_else(|| wrong(name))
}

impl Images<'_> {
    /// Pixels of an image, and images.
    fn sizes(&self) -> (usize, usize) {
        let shape = self.depth.shape();
        let pixels = shape[shape.len().saturating_sub(2)..].iter().product::<usize>().max(1);
        (pixels, self.depth.len() / pixels)
    }

    /// Calls `each` with every image and its number.
    fn for_each(&self, mut each: impl FnMut(usize, SlopedImage) -> PyResult<()>) -> PyResult<()> {
        let (pixels, n) = self.sizes();
        let all = pixels * n;
        let depth = slice("depth", &self.depth, all)?;
        let status = slice("status", &self.status, all)?;
        let geom = slice("geom_id", &self.geom_id, all)?;
        let normal = slice("normal", &self.normal, 3 * all)?.as_chunks::<3>().0;
        let (pos, quat) = (slice("pos", &self.pos, 3 * n)?, slice("quat", &self.quat, 4 * n)?);
        let k = slice("k", &self.k, self.k.len())?;
        let n_k = k.len() / 9;
        if n_k == 0 {
            return Err(wrong("k"));
        }
        let width = *self.depth.shape().last().unwrap_or(&1);
        for i in 0..n {
            let of = i * pixels..(i + 1) * pixels;
            let own = &k[9 * (i % n_k)..][..9];
            let image = SlopedImage {
                width,
                kind: if self.z_depth { DepthKind::ZDepth } else { DepthKind::Range },
                k: core::array::from_fn(|row| three(own, row)),
                pose: pose(pos, quat, i),
                depth_m: &depth[of.clone()],
                status: &status[of.clone()],
                geom_id: &geom[of.clone()],
                normal: &normal[of],
            };
            each(i, image)?;
        }
        Ok(())
    }
}

/// Slopes of each depth by position and by turning of its camera, (…, 3) each, and whether it has any.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub fn depth_slopes<'py>(
    py: Python<'py>,
    images: Images<'py>,
) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<bool>>)> {
    let n = images.depth.len();
    let (mut by_pos, mut by_turn) = (Vec::with_capacity(3 * n), Vec::with_capacity(3 * n));
    let mut known = Vec::with_capacity(n);
    images.for_each(|_, image| {
        for pixel in 0..image.depth_m.len() {
            let mut gain = PoseGain::default();
            let slope = image.slope(pixel);
            if let Some(slope) = &slope {
                gain.add(slope.by_pos, slope.point_m);
            }
            by_pos.extend(gain.by_pos);
            by_turn.extend(gain.by_rotation(image.pose.pos_m));
            known.push(slope.is_some());
        }
        Ok(())
    })?;
    let shape = images.depth.shape();
    let threes = [shape, &[3]].concat();
    Ok((
        arrays::owned(py, by_pos, &threes)?,
        arrays::owned(py, by_turn, &threes)?,
        arrays::owned(py, known, shape)?,
    ))
}

/// Whether each depth has slopes.
#[pyfunction]
pub fn depth_known<'py>(py: Python<'py>, images: Images<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
    let mut known = Vec::with_capacity(images.depth.len());
    images.for_each(|_, image| {
        known.extend((0..image.depth_m.len()).map(|pixel| image.slope(pixel).is_some()));
        Ok(())
    })?;
    arrays::owned(py, known, images.depth.shape())
}

/// What gains by poses come to: by position, by turning, by quaternion.
type Gains<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>);

/// Gains of things at their poses as arrays, shape and numbers of the last axis.
fn given<'py>(py: Python<'py>, gains: &[(PoseGain, Pose)], shape: &[usize]) -> PyResult<Gains<'py>> {
    let of = |width: usize| [shape, &[width]].concat();
    let by_pos = gains.iter().flat_map(|(gain, _)| gain.by_pos).collect();
    let by_turn = gains.iter().flat_map(|(gain, pose)| gain.by_rotation(pose.pos_m)).collect();
    let by_quat = gains.iter().flat_map(|(gain, pose)| gain.by_quat(pose)).collect();
    Ok((
        arrays::owned(py, by_pos, &of(3))?,
        arrays::owned(py, by_turn, &of(3))?,
        arrays::owned(py, by_quat, &of(4))?,
    ))
}

/// What a loss gains by the poses of cameras and of drones, where it gains `seeds` by the depths.
#[pyfunction]
pub fn depth_pull_back<'py>(
    py: Python<'py>,
    images: Images<'py>,
    seeds: PyReadonlyArrayDyn<'py, f64>,
    drones: Drones<'py>,
) -> PyResult<(Gains<'py>, Gains<'py>)> {
    let (pixels, n) = images.sizes();
    let seeds = slice("seeds", &seeds, pixels * n)?;
    let n_drones = drones.pos.shape().get(1).copied().unwrap_or(0);
    let n_worlds = drones.layout.len();
    let rows = n_worlds * n_drones;
    let (pos, quat) = (slice("pos", &drones.pos, 3 * rows)?, slice("quat", &drones.quat, 4 * rows)?);
    if drones.carrier.len() != n || n_worlds == 0 || !n.is_multiple_of(n_worlds) {
        return Err(wrong("carrier"));
    }
    let mut of_drones: Vec<(PoseGain, Pose)> =
        (0..rows).map(|row| (PoseGain::default(), pose(pos, quat, row))).collect();
    let mut of_cameras = Vec::with_capacity(n);
    images.for_each(|i, image| {
        let world = i / (n / n_worlds);
        let of_geom = drones.of_geom.get(drones.layout[world]).ok_or_else(|| wrong("layout"))?;
        let row =
            |drone: i64| usize::try_from(drone).ok().filter(|d| *d < n_drones).map(|d| world * n_drones + d);
        let carrier = row(drones.carrier[i]);
        let own = &seeds[i * pixels..(i + 1) * pixels];
        let gain = image
            .pull_back(own, |geom, by_point, point| {
                let seen = usize::try_from(geom).ok().and_then(|g| of_geom.get(g)).and_then(|d| row(*d));
                if let Some(row) = seen {
                    of_drones[row].0.add(by_point, point);
                }
            })
            .or_raise()?;
        if let Some(row) = carrier {
            of_drones[row].0.join(&gain);
        }
        of_cameras.push((gain, image.pose));
        Ok(())
    })?;
    let shape = images.depth.shape();
    let cameras = given(py, &of_cameras, &shape[..shape.len() - 2])?;
    Ok((cameras, given(py, &of_drones, &[n_worlds, n_drones])?))
}

/// What a loss gains by the poses of drones, where it gains `seeds` by their clearances. `away` is what each distance gains by its closest
/// point on the drone and loses by that on the other, which belongs to drone `other`, −1 for none; `places` are these, both points, and the poses of the drones.
#[pyfunction]
pub fn clearance_pull_back<'py>(
    py: Python<'py>,
    seeds: PyReadonlyArrayDyn<'py, f64>,
    places: [PyReadonlyArrayDyn<'py, f64>; 5],
    other: PyReadonlyArrayDyn<'py, i32>,
) -> PyResult<Gains<'py>> {
    let [away, on_drone, on_other, pos, quat] = &places;
    let n = seeds.len();
    let n_drones = seeds.shape().last().copied().unwrap_or(1);
    let (seeds, other) = (slice("seeds", &seeds, n)?, slice("other_drone", &other, n)?);
    let (away, on_drone) = (slice("away", away, 3 * n)?, slice("on_drone", on_drone, 3 * n)?);
    let (on_other, pos) = (slice("on_other", on_other, 3 * n)?, slice("pos", pos, 3 * n)?);
    let quat = slice("quat", quat, 4 * n)?;
    let mut gains: Vec<(PoseGain, Pose)> =
        (0..n).map(|row| (PoseGain::default(), pose(pos, quat, row))).collect();
    for (row, seed) in seeds.iter().enumerate().filter(|(_, seed)| **seed != 0.0) {
        let by_point = three(away, row).map(|v| seed * v);
        gains[row].0.add(by_point, three(on_drone, row));
        if let Ok(drone) = usize::try_from(other[row]) {
            let seen = row / n_drones * n_drones + drone;
            gains[seen].0.add(by_point.map(|v| -v), three(on_other, row));
        }
    }
    given(py, &gains, &[n / n_drones, n_drones])
}
