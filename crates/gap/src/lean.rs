//! Lean: an attitude estimate tilted in proportion to the acceleration, as by an estimator that takes a manoeuvre for
//! gravity.
//!
//! An estimator that trusts its accelerometer turns the attitude towards the direction of the specific force, by an angle
//! proportional to the lateral acceleration and with a lag: a complementary filter (Mahony, Hamel and Pflimlin, "Nonlinear
//! complementary filters on the special orthogonal group", IEEE Trans. Automatic Control 53(5), 2008, section II) on a
//! vehicle that does not fly at constant speed. All tilts are then too small by some per cent, which looks like a gyroscope
//! scale error, and misaligned gravity looks like a force. Poses and accelerometer reveal it without a vehicle model: the
//! second derivative of the path and the specific force differ by 9.81 m/s² times the lean.

use super::policy::LEAN_SIGMAS;
use super::replay::STEP_S;
use super::sensor_regression::{Bend, Regression, bend_of, half_stretch, widths};
use super::track::{Measured, Track};
use propwash_flight::Channel;
use propwash_flight::resample;
use propwash_trace::math::{quat, vec3};

/// The lean of an attitude estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lean {
    /// Lean per lateral acceleration, rad per m/s².
    pub rad_per_m_s2: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Time constant of the estimator (63 % response), s.
    pub memory_s: f64,
}

impl Lean {
    /// The attitude at a time with the lean removed.
    fn without(&self, across: &Across, t_s: f64, q: [f64; 4]) -> [f64; 4] {
        quat::mul(quat::exp(vec3::scale(across.turn(t_s), -self.rad_per_m_s2)), q)
    }

    /// Description for a warning.
    pub fn words(&self) -> String {
        format!(
            "attitude: leans by {:.1} ± {:.1} mrad per m/s² of acceleration across, {:.2} s late, as an estimator's that takes \
             manoeuvres for gravity: taken out",
            1e3 * self.rad_per_m_s2,
            1e3 * self.sigma,
            self.memory_s
        )
    }
}

/// Time constants that are tried, s.
const MEMORIES_S: [f64; 7] = [0.0, 0.05, 0.1, 0.2, 0.35, 0.55, 0.8];
/// Times that the acceleration is recomputed with the corrected attitude.
const ROUNDS: usize = 2;
/// Prior tilt of the world, rad.
const LEVEL_RAD: f64 = 0.03;
/// The columns of [`bend_of`], and a tilted world.
const OTHERS: usize = 16 + 2;

/// Low-passed lateral acceleration as the estimator sees it, on a grid.
struct Across {
    from_s: f64,
    /// m/s², world, horizontal; one every [`STEP_S`].
    remembered: Vec<[f64; 3]>,
}

impl Across {
    fn new(from_s: f64, acc: &[[f64; 3]], memory_s: f64) -> Self {
        let keep = if memory_s > 0.0 { (-STEP_S / memory_s).exp() } else { 0.0 };
        let mut now = acc.first().copied().unwrap_or([0.0; 3]);
        let remembered = acc
            .iter()
            .map(|a| {
                now = core::array::from_fn(|k| keep * now[k] + (1.0 - keep) * a[k]);
                now
            })
            .collect();
        Self { from_s, remembered }
    }

    /// Direction (world) and size of the lean per rad/(m/s²) at a time: about a × z, towards the specific force.
    fn turn(&self, t_s: f64) -> [f64; 3] {
        let last = self.remembered.len() - 1;
        let place = ((t_s - self.from_s) / STEP_S).clamp(0.0, last as f64);
        let i = (place as usize).min(last.saturating_sub(1));
        let share = place - i as f64;
        let [a, b] = [i, (i + 1).min(last)].map(|i| self.remembered[i]);
        let a = vec3::add(a, vec3::scale(vec3::sub(b, a), share));
        vec3::cross(a, [0.0, 0.0, 1.0])
    }
}

/// Poses and accelerometer of one log.
struct Log {
    gravity_m_s2: [f64; 3],
    from_s: f64,
    /// Every [`STEP_S`] from there, where both are known.
    known: Vec<Option<Instant>>,
    stretches: Vec<Stretch>,
}

/// Specific force (body, m/s²) and attitude of an instant.
#[derive(Clone, Copy)]
struct Instant {
    felt: [f64; 3],
    quat: [f64; 4],
}

/// Rows of the regression other than the lean.
struct Stretch {
    middle_s: f64,
    quat: [f64; 4],
    bend: Bend,
}

impl Stretch {
    /// Apparent acceleration due to a small rotation of the attitude: minus the rotation times the vector.
    fn seen(&self, turn: [f64; 3]) -> [f64; 3] {
        vec3::cross(self.bend.whole, quat::rotate_inverse(self.quat, turn))
    }
}

impl Log {
    fn new(track: &Track, gravity_m_s2: [f64; 3]) -> Option<Self> {
        let from_s = track.attitude.t_s.first()?.max(*track.accel.t_s.first()?);
        let to_s = track.attitude.t_s.last()?.min(*track.accel.t_s.last()?);
        let at = resample::grid(from_s, to_s, STEP_S);
        let felt = track.felt(&at);
        let attitude = resample::slerp(&track.attitude, &at, f64::INFINITY);
        let instant = |(felt, quat): (&Option<[f64; 3]>, &Option<[f64; 4]>)| {
            felt.zip(*quat).map(|(felt, quat)| Instant { felt, quat })
        };
        let known = felt.iter().zip(&attitude).map(instant).collect::<Vec<_>>();
        let apart = half_stretch();
        let at = resample::grid(track.span_s[0], track.span_s[1], STEP_S);
        let (states, felt) = (track.measured_state(&at), track.felt(&at));
        let mut stretches = Vec::new();
        for from in (0..at.len().saturating_sub(2 * apart)).step_by(apart / 2) {
            let stretch = from..=from + 2 * apart;
            let span: Option<Vec<&Measured>> = states[stretch.clone()].iter().map(Option::as_ref).collect();
            let felt: Option<Vec<[f64; 3]>> = felt[stretch].iter().copied().collect();
            let (Some(span), Some(felt)) = (span, felt) else { continue };
            let bend = bend_of(&span, &felt, apart, gravity_m_s2);
            let mut stretch = Stretch { middle_s: at[from + apart], quat: span[apart].quat, bend };
            let level = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|axis| stretch.seen(axis));
            stretch.bend.columns.extend(level);
            stretches.push(stretch);
        }
        (known.len() > 1).then_some(Self { gravity_m_s2, from_s, known, stretches })
    }

    /// Lateral acceleration from the accelerometer and the attitude with its lean removed; gaps hold the last value.
    fn across(&self, lean: Option<(Lean, &Across)>) -> Vec<[f64; 3]> {
        let mut last = [0.0; 3];
        let at = |(i, known): (usize, &Option<Instant>)| {
            if let Some(Instant { felt, quat: mut q }) = *known {
                if let Some((lean, across)) = lean {
                    q = lean.without(across, self.from_s + i as f64 * STEP_S, q);
                }
                let a = vec3::add(quat::rotate(q, felt), self.gravity_m_s2);
                last = [a[0], a[1], 0.0];
            }
            last
        };
        self.known.iter().enumerate().map(at).collect()
    }

    /// Fits the lean for such an acceleration.
    fn lean(&self, acc: &[[f64; 3]]) -> Option<(Lean, Across)> {
        let memories = MEMORIES_S.map(|m| Across::new(self.from_s, acc, m));
        let mut regression = Regression::new(OTHERS + MEMORIES_S.len());
        for stretch in &self.stretches {
            let by_memory = memories.iter().map(|m| stretch.seen(m.turn(stretch.middle_s)));
            regression.add(stretch.bend.columns.iter().copied().chain(by_memory), stretch.bend.more);
        }
        let with = |k: usize| (0..OTHERS).chain([OTHERS + k]).collect::<Vec<usize>>();
        let widths: Vec<f64> = widths().into_iter().chain([LEVEL_RAD, LEVEL_RAD, f64::INFINITY]).collect();
        let fits = (0..MEMORIES_S.len()).filter_map(|k| Some((k, regression.fit(&with(k), &widths)?)));
        let (k, fit) = fits.min_by(|a, b| a.1.left.total_cmp(&b.1.left))?;
        let (value, sigma) = (fit.values[OTHERS], fit.sigma[OTHERS]);
        let lean = Lean { rad_per_m_s2: value, sigma, memory_s: MEMORIES_S[k] };
        // No estimator leans the other way: a negative lean means that the accelerometer feels less drag than the path
        // shows.
        let across = memories.into_iter().nth(k)?;
        (value > LEAN_SIGMAS * sigma).then_some((lean, across))
    }
}

/// Removes the lean from the attitudes of a log; `None` where there is none, or no data to tell.
pub(crate) fn taken_out(track: &mut Track, gravity_m_s2: [f64; 3]) -> Option<Lean> {
    let log = Log::new(track, gravity_m_s2)?;
    let (mut lean, mut across) = log.lean(&log.across(None))?;
    // Leaning attitudes underestimate the acceleration that causes them, hence the iteration.
    for _ in 0..ROUNDS {
        (lean, across) = log.lean(&log.across(Some((lean, &across))))?;
    }
    let attitude = &track.attitude;
    let level = |(t, q): (&f64, &[f64; 4])| lean.without(&across, *t, *q);
    let values = attitude.t_s.iter().zip(&attitude.values).map(level).collect();
    track.attitude = Channel { t_s: attitude.t_s.clone(), values };
    Some(lean)
}
