//! What holds a geom, for the first look: a segment with a radius.

/// A segment with a radius that holds a geom: in its frame, or in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Round {
    pub centre: [f64; 3],
    /// From the centre to one end.
    pub half: [f64; 3],
    /// Infinite for an endless plane.
    pub radius: f64,
}

impl Round {
    /// A point at the origin.
    pub const POINT: Self = Self { centre: [0.0; 3], half: [0.0; 3], radius: 0.0 };

    /// Of a box.
    pub fn of_box(centre: [f64; 3], size: [f64; 3]) -> Self {
        let long = (0..3).fold(0, |a, k| if size[k] > size[a] { k } else { a });
        let across = size[(long + 1) % 3].hypot(size[(long + 2) % 3]);
        let mut half = [0.0; 3];
        if size[long] > across {
            half[long] = size[long];
            Self { centre, half, radius: across }
        } else {
            Self { centre, half, radius: across.hypot(size[long]) }
        }
    }

    /// Of an ellipsoid of these half axes.
    pub fn of_ellipsoid(s: [f64; 3]) -> Self {
        let long = (0..3).fold(0, |a, k| if s[k] > s[a] { k } else { a });
        let across = s[(long + 1) % 3].max(s[(long + 2) % 3]);
        let mut half = [0.0; 3];
        // Its support √(h² c² + r² s²) is never more than (h − r) c + r.
        half[long] = s[long] - across;
        Self { centre: [0.0; 3], half, radius: across }
    }

    /// Of points.
    pub fn of_points(points: &[[f32; 3]]) -> Self {
        let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in points {
            for k in 0..3 {
                lo[k] = lo[k].min(f64::from(p[k]));
                hi[k] = hi[k].max(f64::from(p[k]));
            }
        }
        if points.is_empty() {
            return Self::along_z(0.0, 0.0);
        }
        Self::of_box([0, 1, 2].map(|k| 0.5 * (lo[k] + hi[k])), [0, 1, 2].map(|k| 0.5 * (hi[k] - lo[k])))
    }

    /// Along z.
    pub fn along_z(half: f64, radius: f64) -> Self {
        Self { centre: [0.0; 3], half: [0.0, 0.0, half], radius }
    }

    /// In the world, grown by what f32 may round away.
    pub fn placed(&self, pos: [f64; 3], mat: &[f64; 9]) -> Self {
        let mut centre = pos;
        let mut half = [0.0; 3];
        for i in 0..3 {
            for j in 0..3 {
                centre[i] += mat[3 * i + j] * self.centre[j];
                half[i] += mat[3 * i + j] * self.half[j];
            }
        }
        let far = centre.iter().chain(&half).fold(0.0f64, |a, x| a.max(x.abs()));
        Self { centre, half, radius: self.radius * (1.0 + 1e-5) + 2e-6 * far + 1e-9 }
    }

    /// Radius of the ball about the centre that holds it.
    pub fn reach(&self) -> f64 {
        norm(self.half) + self.radius
    }

    /// Distance from a point, negative inside.
    pub fn distance(&self, from: [f64; 3]) -> f64 {
        let d = [0, 1, 2].map(|k| from[k] - self.centre[k]);
        let square: f64 = self.half.iter().map(|x| x * x).sum();
        let along: f64 = (0..3).map(|k| d[k] * self.half[k]).sum();
        let u = if square > 0.0 { (along / square).clamp(-1.0, 1.0) } else { 0.0 };
        norm([0, 1, 2].map(|k| d[k] - u * self.half[k])) - self.radius
    }
}

pub(crate) fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}
