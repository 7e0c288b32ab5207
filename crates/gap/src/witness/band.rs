//! Zero-phase low-pass filtering of many columns at once.

/// Second-order low-pass whose forward and backward passes together have half power at `cut_hz`, for samples `step_s`
/// apart. Butterworth, "On the theory of filter amplifiers", Wireless Engineer 7, 1930; bilinear transform with prewarping.
#[derive(Clone, Copy, Debug)]
struct Biquad {
    b: [f64; 3],
    a: [f64; 2],
}

impl Biquad {
    fn new(cut_hz: f64, step_s: f64) -> Self {
        // The cut-off is limited to 0.49 of the sampling rate. Two passes halve the power where one leaves 1/√2 of it:
        // (f/f₀)⁴ = √2 − 1 there.
        let k =
            (core::f64::consts::PI * (cut_hz * step_s).min(0.49)).tan() / (2.0f64.sqrt() - 1.0).powf(0.25);
        let norm = 1.0 / (1.0 + 2.0f64.sqrt() * k + k * k);
        let b0 = k * k * norm;
        Self {
            b: [b0, 2.0 * b0, b0],
            a: [2.0 * (k * k - 1.0) * norm, (1.0 - 2.0f64.sqrt() * k + k * k) * norm],
        }
    }

    /// One pass over rows of `width` numbers in the given order, initialised to the steady state of the first row.
    fn pass(&self, rows: &mut [f64], width: usize, order: impl Iterator<Item = usize>) {
        let [b0, b1, b2] = self.b;
        let [a1, a2] = self.a;
        let (mut z1, mut z2) = (vec![0.0; width], vec![0.0; width]);
        let mut first = true;
        for i in order {
            let row = &mut rows[i * width..(i + 1) * width];
            if first {
                for k in 0..width {
                    z2[k] = (b2 - a2) * row[k];
                    z1[k] = (b1 - a1) * row[k] + z2[k];
                }
                first = false;
            }
            for k in 0..width {
                let x = row[k];
                let y = b0 * x + z1[k];
                z1[k] = b1 * x - a1 * y + z2[k];
                z2[k] = b2 * x - a2 * y;
                row[k] = y;
            }
        }
    }
}

/// Filters rows of `width` numbers, `step_s` apart, forward and backward: zero phase, half power at `cut_hz`.
pub(super) fn low_pass(rows: &mut [f64], width: usize, cut_hz: f64, step_s: f64) {
    if width == 0 {
        return;
    }
    let n = rows.len() / width;
    let filter = Biquad::new(cut_hz, step_s);
    filter.pass(rows, width, 0..n);
    filter.pass(rows, width, (0..n).rev());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swings_pass_without_phase_with_half_power_at_the_cut_off() {
        let (step_s, n) = (0.01, 2000);
        for cut_hz in [3.0, 5.0, 8.0] {
            for (hz, power) in [(0.1 * cut_hz, 1.0), (cut_hz, 0.5), (4.0 * cut_hz, 0.0)] {
                let of = |i: usize| (core::f64::consts::TAU * hz * i as f64 * step_s).sin();
                // A second column, to check that columns do not mix.
                let mut rows: Vec<f64> = (0..n).flat_map(|i| [of(i), 3.0]).collect();
                low_pass(&mut rows, 2, cut_hz, step_s);
                let middle = n / 4..3 * n / 4;
                let (mut same, mut square) = (0.0, 0.0);
                for i in middle {
                    same += rows[2 * i] * of(i);
                    square += of(i) * of(i);
                    assert!((rows[2 * i + 1] - 3.0).abs() < 1e-9);
                }
                let gain = same / square;
                assert!((gain * gain - power).abs() < 0.01, "{hz} Hz of {cut_hz} Hz: {gain}");
                // In phase: nothing is left beside the scaled signal.
                let rest = (n / 4..3 * n / 4).map(|i| (rows[2 * i] - gain * of(i)).powi(2)).sum::<f64>();
                assert!(rest < 1e-4 * square, "{rest} of {square}");
            }
        }
    }
}
