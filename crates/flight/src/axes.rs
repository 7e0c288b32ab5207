//! Axes of a file as ours.

use propwash_trace::math::vec3;

/// Our axes in terms of the file's: our component `i` is `sign[i]` times the file's component `axis[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axes {
    axis: [usize; 3],
    sign: [f64; 3],
}

impl Default for Axes {
    fn default() -> Self {
        Self { axis: [0, 1, 2], sign: [1.0; 3] }
    }
}

impl Axes {
    /// x stays, y and z turn over: NED to north-west-up, forward-right-down to forward-left-up.
    pub const TURNED: Self = Self { axis: [0, 1, 2], sign: [1.0, -1.0, -1.0] };
    /// A file whose y is up.
    pub const Y_UP: Self = Self { axis: [0, 2, 1], sign: [1.0, -1.0, 1.0] };

    /// Three names such as `x`, `-y`, `-z`; which of them is none, else. They need not be different: see [`Self::handedness`].
    pub fn parse<T: AsRef<str>>(names: &[T; 3]) -> Result<Self, String> {
        let mut out = Self::default();
        for (i, name) in names.iter().map(AsRef::as_ref).enumerate() {
            out.sign[i] = if name.starts_with('-') { -1.0 } else { 1.0 };
            let bare = name.trim_start_matches(['-', '+']);
            out.axis[i] = ["x", "y", "z"].iter().position(|n| *n == bare).ok_or_else(|| name.to_string())?;
        }
        Ok(out)
    }

    /// Their names.
    pub fn names(&self) -> [String; 3] {
        std::array::from_fn(|i| {
            format!("{}{}", if self.sign[i] < 0.0 { "-" } else { "" }, ["x", "y", "z"][self.axis[i]])
        })
    }

    pub fn apply(&self, v: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.sign[i] * v[self.axis[i]])
    }

    /// These axes of what `self` gives.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            axis: next.axis.map(|k| self.axis[k]),
            sign: std::array::from_fn(|i| next.sign[i] * self.sign[next.axis[i]]),
        }
    }

    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    fn matrix(&self) -> [[f64; 3]; 3] {
        let mut m = [[0.0; 3]; 3];
        for i in 0..3 {
            m[i][self.axis[i]] = self.sign[i];
        }
        m
    }

    /// +1 for a rotation, −1 for a mirror, 0 where one axis stands twice.
    pub fn handedness(&self) -> f64 {
        let m = self.matrix();
        vec3::dot(m[0], vec3::cross(m[1], m[2]))
    }

    /// The rotation as a quaternion xyzw (Shepperd, J. Guidance and Control 1(3), 1978: the largest of the four first).
    pub fn quaternion(&self) -> [f64; 4] {
        let m = self.matrix();
        let trace = m[0][0] + m[1][1] + m[2][2];
        let squares = [m[0][0], m[1][1], m[2][2], trace].map(|d| 1.0 + 2.0 * d - trace);
        let largest = (0..4).max_by(|a, b| squares[*a].total_cmp(&squares[*b])).unwrap_or(3);
        let r = squares[largest].sqrt();
        let f = 0.5 / r;
        let mut q = [0.0; 4];
        q[largest] = 0.5 * r;
        if largest == 3 {
            q[0] = (m[2][1] - m[1][2]) * f;
            q[1] = (m[0][2] - m[2][0]) * f;
            q[2] = (m[1][0] - m[0][1]) * f;
        } else {
            let (i, j, k) = (largest, (largest + 1) % 3, (largest + 2) % 3);
            q[j] = (m[i][j] + m[j][i]) * f;
            q[k] = (m[i][k] + m[k][i]) * f;
            q[3] = (m[k][j] - m[j][k]) * f;
        }
        q
    }
}
