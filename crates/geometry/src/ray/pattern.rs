//! Directions of rays from one point, in the order in which they are cast.

use crate::error::GeometryError;

/// Sixteen unit directions in the frame of the sensor: a square of 4 × 4 pixels, or sixteen in a row.
pub(crate) type Packet<R> = [[R; 16]; 3];

/// Directions in f64, for planes: over a floor that reaches to the horizon they decide how many digits the distance has.
#[derive(Clone, Debug)]
pub(crate) enum Exact {
    /// Those of each packet.
    List(Vec<Packet<f64>>),
    /// Those of a pinhole, from a few numbers for each row and column.
    Image(Pinhole),
}

/// A pinhole camera that looks along −z. Its pixel at x, y of the plane one metre ahead has the direction (x, y, −1).
#[derive(Clone, Debug)]
pub(crate) struct Pinhole {
    /// Pixels in a row, and rows.
    pub width: usize,
    pub height: usize,
    /// fx, fy, cx, cy in pixels.
    k: [f64; 4],
    /// x of four columns, twice: of the upper and of the lower of two rows of a packet.
    columns: Vec<[f64; 8]>,
    /// y of the upper two rows of a packet and of the lower two, each four times.
    rows: Vec<[[f64; 8]; 2]>,
}

impl Pinhole {
    fn new(width: usize, height: usize, k: [f64; 4]) -> Self {
        let mut own = Self { width, height, k, columns: Vec::new(), rows: Vec::new() };
        // Packets beyond the edge of the image repeat it.
        for col in (0..width.next_multiple_of(8)).step_by(4) {
            own.columns.push([0, 1, 2, 3, 0, 1, 2, 3].map(|j| own.at((col + j).min(width - 1), 0)[0]));
        }
        for row in (0..height.next_multiple_of(8)).step_by(4) {
            let y = [0, 1, 2, 3].map(|j| own.at(0, (row + j).min(height - 1))[1]);
            own.rows.push([0, 2].map(|j| [y[j], y[j], y[j], y[j], y[j + 1], y[j + 1], y[j + 1], y[j + 1]]));
        }
        own
    }

    /// The pixel's x and y.
    fn at(&self, col: usize, row: usize) -> [f64; 2] {
        let [fx, fy, cx, cy] = self.k;
        [(col as f64 + 0.5 - cx) / fx, -(row as f64 + 0.5 - cy) / fy]
    }

    fn direction(&self, col: usize, row: usize) -> [f64; 3] {
        let [x, y] = self.at(col, row);
        let n = (x * x + y * y + 1.0).sqrt();
        [x / n, y / n, -1.0 / n]
    }

    /// x and y of the sixteen pixels of a packet of a tile, in two halves.
    #[inline(always)]
    pub fn packet(&self, tile: usize, part: usize) -> (&[f64; 8], &[[f64; 8]; 2]) {
        let across = self.width.div_ceil(8);
        (&self.columns[2 * (tile % across) + part % 2], &self.rows[2 * (tile / across) + part / 2])
    }
}

/// Four packets and a pyramid that holds their rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    /// Inward unit normals of the pyramid's sides; zero vectors where there is no such pyramid.
    pub sides: [[f32; 3]; 4],
    /// Its edges; none where there is no pyramid.
    pub edges: Option<[[f32; 3]; 4]>,
}

/// Rays of a sensor that leave from one point: a camera of any lens, a LiDAR with its rings, single beams.
///
/// Directions are given in the frame of the sensor, once; [`Rays`](super::Rays) casts them from any pose.
/// Neighbours in the list should be neighbours in space: sixteen in a row are cast together, and sixty-four share one
/// look at what they may meet. Takes 38 bytes for each ray; that of a camera 14 for each pixel.
#[derive(Clone, Debug)]
pub struct RayPattern {
    pub(crate) n: usize,
    pub(crate) packets: Vec<Packet<f32>>,
    pub(crate) exact: Exact,
    pub(crate) tiles: Vec<Tile>,
    /// Sides of the pyramid of all rays.
    pub(crate) sides: [[f32; 3]; 4],
}

impl Default for RayPattern {
    /// No rays.
    fn default() -> Self {
        let open = [[0.0; 3]; 4];
        Self { n: 0, packets: Vec::new(), exact: Exact::List(Vec::new()), tiles: Vec::new(), sides: open }
    }
}

impl RayPattern {
    /// Any directions (n × 3), of any length but zero, in the frame of the sensor.
    ///
    /// # Errors
    /// [`GeometryError::Parameter`] for a direction of length zero or that is not finite, naming it.
    pub fn new(directions: &[[f64; 3]]) -> Result<Self, GeometryError> {
        let mut unit = Vec::with_capacity(directions.len());
        for (k, d) in directions.iter().enumerate() {
            let n = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            if !(n > 1e-12 && n < 1e12) {
                return Err(GeometryError::Parameter {
                    what: format!("ray {k} needs a finite direction that is not zero, got {d:?}"),
                });
            }
            unit.push(d.map(|x| x / n));
        }
        let count = unit.len().div_ceil(64);
        let (mut packets, mut exact) = (Vec::with_capacity(4 * count), Vec::with_capacity(4 * count));
        let mut tiles = Vec::with_capacity(count);
        for rays in unit.chunks(64) {
            tiles.push(about(rays));
            for part in 0..4 {
                let wide = packet(|k| rays[(16 * part + k).min(rays.len() - 1)]);
                packets.push(rounded(&wide));
                exact.push(wide);
            }
        }
        let sides = about(&unit).sides;
        Ok(Self { n: unit.len(), packets, exact: Exact::List(exact), tiles, sides })
    }

    /// Pixels of a pinhole camera that looks along −z, with intrinsics fx, fy, cx, cy in pixels; both sides at least 1.
    pub fn image(width: usize, height: usize, k: [f64; 4]) -> Self {
        let [fx, fy, cx, cy] = k;
        let pinhole = Pinhole::new(width, height, k);
        let count = width.div_ceil(8) * height.div_ceil(8);
        let mut packets = Vec::with_capacity(4 * count);
        let mut tiles = Vec::with_capacity(count);
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
                    packets.push(rounded(&packet(|k| {
                        pinhole.direction((c0 + k % 4).min(width - 1), (r0 + k / 4).min(height - 1))
                    })));
                }
            }
        }
        let sides = pyramid(0, 0, width, height).sides;
        Self { n: width * height, packets, exact: Exact::Image(pinhole), tiles, sides }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Unit direction of a ray in the frame of the sensor.
    pub fn direction(&self, ray: usize) -> [f64; 3] {
        match &self.exact {
            Exact::Image(pinhole) => pinhole.direction(ray % pinhole.width, ray / pinhole.width),
            Exact::List(packets) => packets[ray / 16].map(|axis| axis[ray % 16]),
        }
    }

    /// No rays.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }
}

fn packet(ray: impl Fn(usize) -> [f64; 3]) -> Packet<f64> {
    let mut out = [[0.0; 16]; 3];
    for k in 0..16 {
        let d = ray(k);
        for i in 0..3 {
            out[i][k] = d[i];
        }
    }
    out
}

fn rounded(packet: &Packet<f64>) -> Packet<f32> {
    packet.map(|axis| axis.map(|x| x as f32))
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
