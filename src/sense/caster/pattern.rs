//! Directions of rays from one point, in the order in which they are cast.

use super::super::SenseError;

/// Sixteen directions in the frame of the sensor, unit length: a square of 4 × 4 pixels, or sixteen in a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packet {
    pub d: [[f32; 16]; 3],
    /// The same in f64, for planes.
    pub wide: [[f64; 16]; 3],
}

/// Four packets and a pyramid that holds their rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tile {
    /// Inward unit normals of the pyramid's sides; zero vectors where there is no such pyramid.
    pub sides: [[f32; 3]; 4],
    /// Its edges; none where there is no pyramid.
    pub edges: Option<[[f32; 3]; 4]>,
}

/// Rays of a sensor that leave from one point: a camera of any lens, a LiDAR with its rings, single beams.
///
/// Directions are given in the frame of the sensor, once; [`cast_pattern`](super::cast_pattern) casts them from any pose.
/// Neighbours in the list should be neighbours in space: sixteen in a row are cast together, and sixty-four share one
/// look at what they may meet. Takes 36 bytes for each ray.
#[derive(Clone, Debug, Default)]
pub struct RayPattern {
    pub(super) n: usize,
    /// Pixels in a row of an image; none for a list.
    pub(super) width: Option<usize>,
    pub(super) packets: Vec<Packet>,
    pub(super) tiles: Vec<Tile>,
    /// Sides of the pyramid of all rays.
    pub(super) sides: [[f32; 3]; 4],
}

impl RayPattern {
    /// Any directions (n × 3), of any length but zero, in the frame of the sensor.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a direction of length zero or that is not finite, naming it.
    pub fn new(directions: &[[f64; 3]]) -> Result<Self, SenseError> {
        let mut unit = Vec::with_capacity(directions.len());
        for (k, d) in directions.iter().enumerate() {
            let n = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            if !(n > 1e-12 && n < 1e12) {
                return Err(SenseError::Parameter {
                    what: format!("ray {k} needs a finite direction that is not zero, got {d:?}"),
                });
            }
            unit.push(d.map(|x| x / n));
        }
        let mut packets = Vec::with_capacity(unit.len().div_ceil(64) * 4);
        let mut tiles = Vec::with_capacity(unit.len().div_ceil(64));
        for rays in unit.chunks(64) {
            tiles.push(about(rays));
            for part in 0..4 {
                packets.push(packet(|k| rays[(16 * part + k).min(rays.len() - 1)]));
            }
        }
        let sides = about(&unit).sides;
        Ok(Self { n: unit.len(), width: None, packets, tiles, sides })
    }

    /// Pixels of a pinhole camera that looks along −z, with unit directions `rays` (height × width) and intrinsics fx, fy,
    /// cx, cy in pixels.
    pub(in super::super) fn image(
        rays: &[[f64; 3]],
        width: usize,
        height: usize,
        [fx, fy, cx, cy]: [f64; 4],
    ) -> Self {
        let mut packets = Vec::new();
        let mut tiles = Vec::new();
        let pyramid = |col: usize, row: usize, cols: usize, rows: usize| {
            // Image points of the outer corners, a thousandth of a pixel outward.
            let x0 = (col as f64 - 1e-3 - cx) / fx;
            let x1 = ((col + cols) as f64 + 1e-3 - cx) / fx;
            let y1 = -(row as f64 - 1e-3 - cy) / fy;
            let y0 = -((row + rows) as f64 + 1e-3 - cy) / fy;
            let sides = [[1.0, 0.0, x0], [-1.0, 0.0, -x1], [0.0, 1.0, y0], [0.0, -1.0, -y1]];
            let edges = [[x0, y0, -1.0], [x1, y0, -1.0], [x0, y1, -1.0], [x1, y1, -1.0]];
            Tile {
                sides: sides.map(|v| super::unit(v).map(|x| x as f32)),
                edges: Some(edges.map(|v| super::unit(v).map(|x| x as f32))),
            }
        };
        for row in (0..height).step_by(8) {
            for col in (0..width).step_by(8) {
                tiles.push(pyramid(col, row, 8.min(width - col), 8.min(height - row)));
                for part in 0..4 {
                    let (r0, c0) = (row + 4 * (part / 2), col + 4 * (part % 2));
                    packets.push(packet(|k| {
                        rays[(r0 + k / 4).min(height - 1) * width + (c0 + k % 4).min(width - 1)]
                    }));
                }
            }
        }
        let sides = pyramid(0, 0, width, height).sides;
        Self { n: width * height, width: Some(width), packets, tiles, sides }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Unit direction of a ray in the frame of the sensor.
    pub fn direction(&self, ray: usize) -> [f64; 3] {
        let (packet, lane) = match self.width {
            Some(width) => {
                let (row, col) = (ray / width, ray % width);
                let tile = (row / 8) * width.div_ceil(8) + col / 8;
                (4 * tile + 2 * (row % 8 / 4) + col % 8 / 4, 4 * (row % 4) + col % 4)
            }
            None => (ray / 16, ray % 16),
        };
        let packet = &self.packets[packet];
        [packet.wide[0][lane], packet.wide[1][lane], packet.wide[2][lane]]
    }

    /// No rays.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }
}

fn packet(ray: impl Fn(usize) -> [f64; 3]) -> Packet {
    let mut out = Packet { d: [[0.0; 16]; 3], wide: [[0.0; 16]; 3] };
    for k in 0..16 {
        let d = ray(k);
        for i in 0..3 {
            out.d[i][k] = d[i] as f32;
            out.wide[i][k] = d[i];
        }
    }
    out
}

/// A square pyramid about rays, by way of a cone.
fn about(rays: &[[f64; 3]]) -> Tile {
    let open = Tile { sides: [[0.0; 3]; 4], edges: None };
    let mut sum = [0.0; 3];
    for d in rays {
        for k in 0..3 {
            sum[k] += d[k];
        }
    }
    let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
    if !(length > 1e-6) {
        return open;
    }
    let axis = sum.map(|x| x / length);
    let cosine = rays.iter().map(|d| d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]).fold(1.0, f64::min);
    let angle = cosine.clamp(-1.0, 1.0).acos() + 1e-6;
    if angle > 1.4 {
        return open;
    }
    let least = (0..3).fold(0, |a, k| if axis[k].abs() < axis[a].abs() { k } else { a });
    let mut e = [0.0; 3];
    e[least] = 1.0;
    let u = super::unit(super::lanes::cross(axis, e));
    let v = super::lanes::cross(axis, u);
    let (s, c) = angle.sin_cos();
    let side = |e: [f64; 3], f: f64| [0, 1, 2].map(|k| (s * axis[k] + f * c * e[k]) as f32);
    let w = angle.tan();
    let edge = |a: f64, b: f64| {
        super::unit([0, 1, 2].map(|k| axis[k] + w * (a * u[k] + b * v[k]))).map(|x| x as f32)
    };
    Tile {
        sides: [side(u, 1.0), side(u, -1.0), side(v, 1.0), side(v, -1.0)],
        edges: Some([edge(1.0, 1.0), edge(1.0, -1.0), edge(-1.0, 1.0), edge(-1.0, -1.0)]),
    }
}
