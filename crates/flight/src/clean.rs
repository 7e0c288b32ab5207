//! Outliers and robust figures.

use super::channel::Channel;

/// Median of the finite values, `None` without any.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.retain(|v| v.is_finite());
    quantile_of(&mut values, 0.5)
}

/// The value below which a share `p` (0 to 1) of the finite values lies, `None` without any.
pub fn quantile(values: &[f64], p: f64) -> Option<f64> {
    let mut kept: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    quantile_of(&mut kept, p)
}

fn quantile_of(values: &mut [f64], p: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let k = ((values.len() - 1) as f64 * p.clamp(0.0, 1.0)).round() as usize;
    Some(*values.select_nth_unstable_by(k, f64::total_cmp).1)
}

/// Standard deviation of a normal law with the same median absolute deviation (factor 1.4826), about zero.
pub fn robust_sigma(values: &[f64]) -> Option<f64> {
    median(values.iter().map(|v| v.abs()).collect()).map(|m| 1.4826 * m)
}

/// Marks samples that stand out from the median of their neighbours (`half` on either side) by more than `threshold`
/// robust standard deviations and more than `floor` (the channel's unit), in any component.
///
/// Hampel's identifier: Pearson, "Outliers in process modeling and identification", IEEE Trans. Control Systems
/// Technology 10(1), 2002. The scale is that of the whole channel, so a quiet stretch marks nothing by itself.
/// Towards the ends the neighbourhood shrinks, so the first and the last sample are never marked.
pub fn outliers<const N: usize>(channel: &Channel<N>, half: usize, threshold: f64, floor: f64) -> Vec<bool> {
    let n = channel.len();
    let mut marks = vec![false; n];
    for k in 0..N {
        let x = channel.component(k);
        let deviation: Vec<f64> = (0..n)
            .map(|i| {
                let half = half.min(i).min(n - 1 - i);
                let near = x[i - half..=i + half].to_vec();
                x[i] - median(near).unwrap_or(x[i])
            })
            .collect();
        // Where most deviations are zero (held samples), the spread is that of the others.
        let moving: Vec<f64> = deviation.iter().copied().filter(|d| *d != 0.0).collect();
        let limit = (threshold * robust_sigma(&moving).unwrap_or(0.0)).max(floor);
        for i in 0..n {
            marks[i] |= deviation[i].abs() > limit;
        }
    }
    marks
}

/// The channel without the marked samples.
pub fn without<const N: usize>(channel: &Channel<N>, marks: &[bool]) -> Channel<N> {
    let mut out = Channel::default();
    for (i, (t, v)) in channel.t_s.iter().zip(&channel.values).enumerate() {
        if !marks.get(i).copied().unwrap_or(false) {
            out.push(*t, *v);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_is_marked_and_a_fast_ramp_is_not() {
        let t: Vec<f64> = (0..400).map(|i| i as f64 * 0.01).collect();
        let mut x: Vec<[f64; 1]> =
            t.iter().map(|t| [1000.0 + 300.0 * (t * 6.0).sin() + (t * 7919.0).sin()]).collect();
        x[123][0] += 2500.0;
        x[124][0] += 2500.0;
        let marks = outliers(&Channel::new(t, x), 4, 10.0, 50.0);
        let found: Vec<usize> = (0..400).filter(|i| marks[*i]).collect();
        assert_eq!(found, [123, 124]);
    }

    #[test]
    fn quantiles_pass_over_what_is_no_number() {
        assert_eq!(median(vec![3.0, f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(quantile(&[4.0, 1.0, 3.0, 2.0, 0.0], 1.0), Some(4.0));
        assert_eq!(median(vec![]), None);
    }
}
