//! What stands between sensors and a log: the estimator that makes poses and velocities, the low-pass filter of the inertial
//! unit. Both are causal, and leave neighbouring samples smooth.

use super::hidden::stream;
use super::linear::{Q, V, add, cross, mat_t_vec, mat_vec, matrix, mul, quat_exp, quat_mul, sub};
use super::world::{State, attitude, part};
use propwash::random::Stream;
use serde::Serialize;

/// An on-board estimator and filters in figures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Filters {
    /// Standard deviation of the slow error of positions, m.
    pub position_m: f64,
    /// The same of attitudes per axis, rad.
    pub attitude_rad: f64,
    /// The same of velocities, beyond the change of the position's error, m/s.
    pub velocity_m_s: f64,
    /// Time over which these errors stay, s.
    pub memory_s: f64,
    /// Lean of the attitude per acceleration across, which the estimator takes for gravity, rad per m/s².
    pub lean_rad_per_m_s2: f64,
    /// Time that it takes to believe in it, s.
    pub lean_memory_s: f64,
    /// Where the filter of gyroscope and accelerometer has lost half of the power, Hz.
    pub cut_hz: f64,
}

/// Acceleration across of a manoeuvre, m/s²: a lean of 27°. The attitude is wrong by 1 to 3° in it.
const MANOEUVRE_M_S2: f64 = 5.0;

impl Filters {
    /// The figures of a flight.
    pub fn new(seed: u64, flight: u64) -> Self {
        let mut s = stream(seed, flight, "filters");
        Self {
            position_m: s.uniform(1e-3, 3e-3),
            attitude_rad: s.uniform(0.2, 0.5).to_radians(),
            velocity_m_s: s.uniform(5e-3, 20e-3),
            memory_s: 0.1 * 10f64.powf(s.unit()),
            lean_rad_per_m_s2: s.uniform(1.0, 3.0).to_radians() / MANOEUVRE_M_S2,
            lean_memory_s: s.uniform(0.1, 0.5),
            cut_hz: s.uniform(30.0, 80.0),
        }
    }

    /// By how much filtered readings are late, s.
    pub fn late_s(&self) -> f64 {
        2.0 * self.lag_s()
    }

    /// Time of each of the two lags.
    fn lag_s(&self) -> f64 {
        // |1/(1 + iωτ)²|² is one half at ωτ = √(√2 − 1).
        (2f64.sqrt() - 1.0).sqrt() / (std::f64::consts::TAU * self.cut_hz)
    }
}

/// A slow error of three numbers: a first-order random process behind a lag of half its memory.
#[derive(Clone, Debug)]
struct Slow {
    sigma: f64,
    memory_s: f64,
    rough: V,
    smooth: V,
}

impl Slow {
    fn new(sigma: f64, memory_s: f64, s: &mut Stream) -> Self {
        let rough: V = std::array::from_fn(|_| s.normal());
        Self { sigma, memory_s, rough, smooth: mul(rough, 2.0 / 3.0) }
    }

    fn step(&mut self, dt: f64, s: &mut Stream) {
        let a = (-dt / self.memory_s).exp();
        let b = (-2.0 * dt / self.memory_s).exp();
        for i in 0..3 {
            self.rough[i] = a * self.rough[i] + (1.0 - a * a).sqrt() * s.normal();
            self.smooth[i] = b * self.smooth[i] + (1.0 - b) * self.rough[i];
        }
    }

    /// The lag leaves two thirds of the variance.
    fn scale(&self) -> f64 {
        1.5f64.sqrt() * self.sigma
    }

    fn value(&self) -> V {
        mul(self.smooth, self.scale())
    }

    fn slope(&self) -> V {
        mul(sub(self.rough, self.smooth), 2.0 * self.scale() / self.memory_s)
    }
}

/// Poses and velocities as an on-board estimator gives them.
#[derive(Clone, Debug)]
pub struct Estimator {
    figures: Filters,
    position: Slow,
    attitude: Slow,
    velocity: Slow,
    /// Acceleration across in the memory of the estimator, m/s², world.
    across: V,
    last_s: Option<f64>,
    stream: Stream,
}

/// What an estimator gives.
pub struct Estimate {
    /// Place of the point that it follows, m, world.
    pub position_m: V,
    /// Attitude.
    pub attitude: Q,
    /// Velocity of that point, m/s, world.
    pub velocity_m_s: V,
}

impl Estimator {
    /// The estimator of a flight.
    pub fn new(figures: Filters, seed: u64, flight: u64) -> Self {
        let mut stream = stream(seed, flight, "estimator");
        let mut slow = |sigma: f64| Slow::new(sigma, figures.memory_s, &mut stream);
        let (position, attitude, velocity) =
            (slow(figures.position_m), slow(figures.attitude_rad), slow(figures.velocity_m_s));
        Self { figures, position, attitude, velocity, across: [0.0; 3], last_s: None, stream }
    }

    /// The estimate at time `t` of a vehicle that accelerates with `acc`; `point` is followed, from the centre of mass, body.
    pub fn at(&mut self, t: f64, x: &State, acc: V, point: V) -> Estimate {
        let dt = t - self.last_s.unwrap_or(t);
        self.last_s = Some(t);
        for error in [&mut self.position, &mut self.attitude, &mut self.velocity] {
            error.step(dt, &mut self.stream);
        }
        let keep = (-dt / self.figures.lean_memory_s).exp();
        self.across = add(mul(self.across, keep), mul([acc[0], acc[1], 0.0], 1.0 - keep));
        // Where the specific force is taken for gravity, the estimate turns it towards the vertical: about a × z.
        let lean = mul(cross(self.across, [0.0, 0.0, 1.0]), self.figures.lean_rad_per_m_s2);
        let q = attitude(x);
        let r = matrix(q);
        let swing = mat_vec(r, cross(part(x, 10), point));
        Estimate {
            position_m: add(add(part(x, 0), mat_vec(r, point)), self.position.value()),
            attitude: quat_mul(quat_mul(quat_exp(lean), q), quat_exp(self.attitude.value())),
            velocity_m_s: add(add(add(part(x, 7), swing), self.position.slope()), self.velocity.value()),
        }
    }
}

/// Two equal lags after each other.
#[derive(Clone, Debug)]
pub struct LowPass {
    lag_s: f64,
    state: Option<[V; 2]>,
}

impl LowPass {
    /// The filter with these figures, which begins at its first input.
    pub fn new(figures: &Filters) -> Self {
        Self { lag_s: figures.lag_s(), state: None }
    }

    /// Advances by `dt` under the input `u`; what comes out.
    pub fn step(&mut self, dt: f64, u: V) -> V {
        let [mut one, mut two] = self.state.unwrap_or([u, u]);
        let a = 1.0 - (-dt / self.lag_s).exp();
        one = add(one, mul(sub(u, one), a));
        two = add(two, mul(sub(one, two), a));
        self.state = Some([one, two]);
        two
    }

    /// What would come out after `dt` under the input `u`.
    pub fn peek(&self, dt: f64, u: V) -> V {
        self.clone().step(dt, u)
    }
}

/// The specific force of a vehicle that accelerates with `acc`, body, m/s².
pub fn specific_force(x: &State, acc: V, gravity: V) -> V {
    mat_t_vec(matrix(attitude(x)), sub(acc, gravity))
}
