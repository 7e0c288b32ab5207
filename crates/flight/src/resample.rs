//! Values and derivatives of channels at any time.

use super::channel::Channel;
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

/// Times from `from_s` to `to_s` (both s, the last included where it falls on the grid), `period_s` apart.
pub fn grid(from_s: f64, to_s: f64, period_s: f64) -> Vec<f64> {
    if !(period_s > 0.0) || !(to_s >= from_s) {
        return Vec::new();
    }
    let n = ((to_s - from_s) / period_s + 1e-9).floor() as usize;
    (0..=n).map(|i| from_s + i as f64 * period_s).collect()
}

/// Steps longer than this many usual ones are gaps.
const GAP_PERIODS: f64 = 4.5;

/// Mean distance of samples, s, gaps apart; `None` with fewer than two. Where samples are missing here and there (held values
/// that were left out) it is longer than the median: local fits need that many samples.
pub fn spacing_s(t_s: &[f64]) -> Option<f64> {
    let steps: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
    let limit = GAP_PERIODS * super::clean::median(steps.clone())?;
    let ordinary: Vec<f64> = steps.into_iter().filter(|d| *d <= limit).collect();
    Some(ordinary.iter().sum::<f64>() / ordinary.len() as f64)
}

/// A place among rising times, from which the next one is looked for: one search after the other mostly goes a few steps on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cursor(usize);

impl Cursor {
    /// Steps after which halving is quicker.
    const STEPS: usize = 12;

    /// The number of times for which `before` holds: all up to some time, and none behind it.
    pub fn seek(&mut self, t: &[f64], before: impl Fn(f64) -> bool) -> usize {
        let mut i = self.0.min(t.len());
        for _ in 0..Self::STEPS {
            if i < t.len() && before(t[i]) {
                i += 1;
            } else if i > 0 && !before(t[i - 1]) {
                i -= 1;
            } else {
                self.0 = i;
                return i;
            }
        }
        self.0 = t.partition_point(|x| before(*x));
        self.0
    }
}

/// Index `i` with `t[i] <= at <= t[i + 1]` and the fraction of the way, `None` outside. `t` rises.
fn place(t: &[f64], at: f64, cursor: &mut Cursor) -> Option<(usize, f64)> {
    if t.len() < 2 || !(at >= t[0]) || !(at <= t[t.len() - 1]) {
        return None;
    }
    let i = cursor.seek(t, |x| x <= at).clamp(1, t.len() - 1) - 1;
    Some((i, (at - t[i]) / (t[i + 1] - t[i])))
}

/// Values on the straight line between neighbouring samples, at the times `at_s` (s). `None` outside the channel and
/// inside gaps longer than `max_gap_s`.
pub fn linear<const N: usize>(channel: &Channel<N>, at_s: &[f64], max_gap_s: f64) -> Vec<Option<[f64; N]>> {
    let t = &channel.t_s;
    let mut cursor = Cursor::default();
    at_s.iter()
        .map(|at| {
            let (i, f) = place(t, *at, &mut cursor)?;
            let (a, b) = (&channel.values[i], &channel.values[i + 1]);
            (t[i + 1] - t[i] <= max_gap_s || f == 0.0)
                .then(|| std::array::from_fn(|k| a[k] + f * (b[k] - a[k])))
        })
        .collect()
}

/// Values on the cubic through neighbouring samples with the slopes of their chords (Catmull and Rom, 1974), at the times
/// `at_s` (s). `None` outside the channel and inside gaps longer than `max_gap_s`. Unlike a straight line it does not
/// smooth more in the middle between samples than at them.
pub fn cubic<const N: usize>(channel: &Channel<N>, at_s: &[f64], max_gap_s: f64) -> Vec<Option<[f64; N]>> {
    let (t, v) = (&channel.t_s, &channel.values);
    let slope = |i: usize, k: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(t.len() - 1));
        (v[b][k] - v[a][k]) / (t[b] - t[a])
    };
    let mut cursor = Cursor::default();
    at_s.iter()
        .map(|at| {
            let (i, f) = place(t, *at, &mut cursor)?;
            let h = t[i + 1] - t[i];
            (h <= max_gap_s || f == 0.0).then(|| {
                std::array::from_fn(|k| {
                    let (g, rise) = (1.0 - f, v[i + 1][k] - v[i][k]);
                    let bend = g * (slope(i, k) * h - rise) - f * (slope(i + 1, k) * h - rise);
                    v[i][k] + f * rise + f * g * bend
                })
            })
        })
        .collect()
}

/// Attitudes on the shortest arc between neighbouring samples, xyzw, of unit length, at the times `at_s` (s). `None`
/// outside the channel and inside gaps longer than `max_gap_s`.
pub fn slerp(channel: &Channel<4>, at_s: &[f64], max_gap_s: f64) -> Vec<Option<[f64; 4]>> {
    let t = &channel.t_s;
    let mut cursor = Cursor::default();
    at_s.iter()
        .map(|at| {
            let (i, f) = place(t, *at, &mut cursor)?;
            if t[i + 1] - t[i] > max_gap_s && f != 0.0 {
                return None;
            }
            let (a, b) = (quat::normalize(channel.values[i]), quat::normalize(channel.values[i + 1]));
            let turn = rotation_vector(quat::mul(quat::conjugate(a), b));
            Some(quat::mul(a, quat::exp(vec3::scale(turn, f))))
        })
        .collect()
}

/// The rotation vector (axis times angle, rad, at most π long) of a unit quaternion xyzw.
pub fn rotation_vector(q: [f64; 4]) -> [f64; 3] {
    let q = if q[3] < 0.0 { q.map(|x| -x) } else { q };
    let sine = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]).sqrt();
    let factor = if sine < 0.05 {
        // The series of the arc sine: neighbouring samples are close, and its first five terms are exact to 2e-15 here.
        let s = sine * sine;
        2.0 * (1.0 + s * (1.0 / 6.0 + s * (3.0 / 40.0 + s * (5.0 / 112.0 + s * (35.0 / 1152.0)))))
    } else {
        2.0 * sine.atan2(q[3]) / sine
    };
    [q[0] * factor, q[1] * factor, q[2] * factor]
}

/// Value and slope of a channel where a parabola is fitted to the samples around a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local<const N: usize> {
    /// Smoothed value, unit of the channel.
    pub value: [f64; N],
    /// Derivative, unit of the channel per s.
    pub slope: [f64; N],
    /// Second derivative, unit of the channel per s².
    pub curvature: [f64; N],
    /// Standard deviation of the value for white noise of standard deviation 1 in the samples.
    pub value_gain: f64,
    /// Standard deviation of the slope (1/s) for white noise of standard deviation 1 in the samples.
    pub slope_gain: f64,
    /// Standard deviation of the second derivative (1/s²) for white noise of standard deviation 1 in the samples.
    pub curvature_gain: f64,
}

/// Fits a parabola by least squares to the samples within `half_s` of each time of `at_s` (s) and gives value, slope
/// and noise gain. `None` where fewer than four samples lie there or where they do not surround the time (edges, gaps).
///
/// Savitzky and Golay, "Smoothing and differentiation of data by simplified least squares procedures", Analytical
/// Chemistry 36(8), 1964; solved at each time, so that sample times may be uneven.
pub fn local_parabola<const N: usize>(
    channel: &Channel<N>,
    at_s: &[f64],
    half_s: f64,
) -> Vec<Option<Local<N>>> {
    in_parts(at_s, |part| {
        let mut cursors = [Cursor::default(); 2];
        part.iter().map(|at| fit(channel, *at, half_s, &mut cursors)).collect()
    })
}

/// Times that one thread takes at once.
const PART: usize = 1024;

/// What `of` gives at all times, computed in parallel, part by part.
fn in_parts<T: Send>(at_s: &[f64], of: impl Fn(&[f64]) -> Vec<T> + Send + Sync) -> Vec<T> {
    if at_s.len() <= PART {
        return of(at_s);
    }
    at_s.par_chunks(PART).flat_map_iter(of).collect()
}

/// The fit at one time; `cursors` are where its samples begin and end.
fn fit<const N: usize>(
    channel: &Channel<N>,
    at: f64,
    half_s: f64,
    cursors: &mut [Cursor; 2],
) -> Option<Local<N>> {
    let t = &channel.t_s;
    let slack = 1e-6 * half_s;
    let from = cursors[0].seek(t, |x| x < at - half_s - slack);
    let to = cursors[1].seek(t, |x| x <= at + half_s + slack);
    if to < from + 4 || t[from] > at - 0.5 * half_s || t[to - 1] < at + 0.5 * half_s {
        return None;
    }
    // Moments of the scaled times u = (t − at)/half.
    let mut m = [0.0; 5];
    let mut sums = [[0.0; N]; 3];
    for (t, v) in t[from..to].iter().zip(&channel.values[from..to]) {
        let u = (t - at) / half_s;
        let square = u * u;
        m[1] += u;
        m[2] += square;
        m[3] += square * u;
        m[4] += square * square;
        for k in 0..N {
            sums[0][k] += v[k];
            sums[1][k] += u * v[k];
            sums[2][k] += square * v[k];
        }
    }
    m[0] = (to - from) as f64;
    let y: [[f64; 3]; N] = std::array::from_fn(|k| [sums[0][k], sums[1][k], sums[2][k]]);
    let normal = [[m[0], m[1], m[2]], [m[1], m[2], m[3]], [m[2], m[3], m[4]]];
    let inverse = vec3::inverse(normal);
    if !inverse.iter().flatten().all(|x| x.is_finite()) {
        return None;
    }
    Some(Local {
        value: std::array::from_fn(|k| vec3::dot(inverse[0], y[k])),
        slope: std::array::from_fn(|k| vec3::dot(inverse[1], y[k]) / half_s),
        value_gain: inverse[0][0].max(0.0).sqrt(),
        slope_gain: inverse[1][1].max(0.0).sqrt() / half_s,
        curvature: std::array::from_fn(|k| 2.0 * vec3::dot(inverse[2], y[k]) / (half_s * half_s)),
        curvature_gain: 2.0 * inverse[2][2].max(0.0).sqrt() / (half_s * half_s),
    })
}

/// Body rates (rad/s, body) from attitudes: the rotation between samples is fitted with a parabola within `half_s` of
/// each time of `at_s` (s), in the tangent space at the middle.
pub fn body_rates(channel: &Channel<4>, at_s: &[f64], half_s: f64) -> Vec<Option<[f64; 3]>> {
    let unit: Vec<[f64; 4]> = channel.values.iter().map(|q| quat::normalize(*q)).collect();
    in_parts(at_s, |part| rates_at((&channel.t_s, &unit), part, half_s))
}

/// The same at some of the times, from times of samples and unit quaternions.
fn rates_at((t, unit): (&[f64], &[[f64; 4]]), at_s: &[f64], half_s: f64) -> Vec<Option<[f64; 3]>> {
    let mut cursors = [Cursor::default(); 3];
    let mut near = Channel::<3>::default();
    at_s.iter()
        .map(|at| {
            let from = cursors[0].seek(t, |x| x < at - half_s * (1.0 + 1e-6));
            let to = cursors[1].seek(t, |x| x <= at + half_s * (1.0 + 1e-6));
            if to < from + 3 {
                return None;
            }
            let middle = cursors[2].seek(t, |x| x < *at).min(to - 1).max(from);
            let base = quat::conjugate(unit[middle]);
            near.t_s.clear();
            near.values.clear();
            for i in from..to {
                near.push(t[i], rotation_vector(quat::mul(base, unit[i])));
            }
            let local = fit(&near, *at, half_s, &mut [Cursor::default(); 2])?;
            // d/dt of a rotation vector is the body rate up to half its cross product with the vector itself.
            let bend = vec3::scale(vec3::cross(local.value, local.slope), -0.5);
            Some(vec3::add(local.slope, bend))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cursor_finds_what_halving_finds_wherever_it_was() {
        let t: Vec<f64> = (0..200).map(|i| f64::from(i) + 0.3 * f64::from(i % 3)).collect();
        let mut cursor = Cursor::default();
        for at in [-1.0, 0.0, 3.2, 3.9, 90.0, 91.0, 88.5, 5.0, 198.0, 500.0, 12.0] {
            assert_eq!(cursor.seek(&t, |x| x <= at), t.partition_point(|x| *x <= at), "{at}");
        }
        assert_eq!(cursor.seek(&[], |x| x <= 1.0), 0);
    }

    #[test]
    fn small_and_large_turns_come_back() {
        for angle in [0.0, 1e-12, 1e-6, 0.01, 0.0999, 0.1001, 1.0, 3.1] {
            let turn = [0.6 * angle, 0.0, -0.8 * angle];
            let back = rotation_vector(quat::exp(turn));
            assert!(
                (0..3).all(|k| (back[k] - turn[k]).abs() <= 4e-15 * angle.max(1e-3)),
                "{angle}: {back:?}"
            );
        }
    }

    #[test]
    fn a_parabola_is_reproduced_with_its_slope_at_uneven_times() {
        let t: Vec<f64> = (0..60).map(|i| i as f64 * 0.01 + 0.003 * (i as f64 * 1.7).sin()).collect();
        let channel = Channel::new(t.clone(), t.iter().map(|t| [1.0 + 2.0 * t - 3.0 * t * t]).collect());
        let at = grid(0.1, 0.5, 0.007);
        for (t, local) in at.iter().zip(local_parabola(&channel, &at, 0.05)) {
            let local = local.unwrap();
            assert!((local.value[0] - (1.0 + 2.0 * t - 3.0 * t * t)).abs() < 1e-11);
            assert!((local.slope[0] - (2.0 - 6.0 * t)).abs() < 1e-9);
            assert!((local.curvature[0] + 6.0).abs() < 1e-7);
        }
        assert!(local_parabola(&channel, &[-0.2, 0.0, 0.9], 0.05).iter().all(Option::is_none));
    }

    #[test]
    fn the_noise_gain_is_that_of_the_textbook() {
        // Five even samples: variance of the slope is 1/(10 h²), of the smoothed value 17/35.
        let channel = Channel::new((0..5).map(|i| i as f64 * 0.1).collect(), vec![[0.0]; 5]);
        let local = local_parabola(&channel, &[0.2], 0.2)[0].unwrap();
        assert!((local.slope_gain - (0.1f64).sqrt() / 0.1).abs() < 1e-12);
        assert!((local.value_gain - (17.0f64 / 35.0).sqrt()).abs() < 1e-12);
        // … and of the second derivative 4/(14 h⁴).
        assert!((local.curvature_gain - (2.0f64 / 7.0).sqrt() / 0.01).abs() < 1e-9);
    }

    #[test]
    fn a_cubic_passes_through_a_parabola_of_even_samples() {
        let t: Vec<f64> = (0..9).map(|i| i as f64 * 0.1).collect();
        let channel = Channel::new(t.clone(), t.iter().map(|t| [2.0 + t - 4.0 * t * t]).collect());
        for (t, v) in [0.23f64, 0.4, 0.55].iter().zip(cubic(&channel, &[0.23, 0.4, 0.55], 1.0)) {
            assert!((v.unwrap()[0] - (2.0 + t - 4.0 * t * t)).abs() < 1e-12);
        }
    }

    #[test]
    fn attitudes_between_samples_lie_on_the_arc_whatever_the_sign() {
        let end = quat::exp([0.0, 0.0, 1.0]).map(|x| -x);
        let channel = Channel::new(vec![0.0, 1.0], vec![[0.0, 0.0, 0.0, 1.0], end]);
        let q = slerp(&channel, &[0.25], 2.0)[0].unwrap();
        assert!((rotation_vector(q)[2] - 0.25).abs() < 1e-12);
        assert_eq!(slerp(&channel, &[0.25], 0.5)[0], None);
    }

    #[test]
    fn rates_of_a_turn_about_a_moving_axis_are_found() {
        // q = exp(a(t)) ⊗ exp(b(t)): ω = exp(b)⁻¹ ȧ exp(b) + ḃ.
        let t: Vec<f64> = (0..400).map(|i| i as f64 * 0.005).collect();
        let a = |t: f64| [0.5 * (3.0 * t).sin(), 0.0, 0.0];
        let b = |t: f64| [0.0, 0.0, 1.3 * t];
        let q = |t: f64| quat::mul(quat::exp(a(t)), quat::exp(b(t)));
        let channel = Channel::new(t.clone(), t.iter().map(|t| q(*t)).collect());
        for at in [0.4, 0.777, 1.5] {
            let w = body_rates(&channel, &[at], 0.02)[0].unwrap();
            let expected = vec3::add(
                quat::rotate_inverse(quat::exp(b(at)), [1.5 * (3.0 * at).cos(), 0.0, 0.0]),
                [0.0, 0.0, 1.3],
            );
            for k in 0..3 {
                assert!((w[k] - expected[k]).abs() < 3e-3, "{w:?} {expected:?}");
            }
        }
    }
}
