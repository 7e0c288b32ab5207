//! Gradients over many samples, on all threads: the same bits at any number of threads, since the parts are always the same and are added in order.

use propwash_rollout::pool;
use propwash_rollout::random::Stream;
use propwash_trace::dense::sum;
use propwash_trace::lanes::F32x16;

/// Most parts of a batch, each made by one thread; none is smaller than what goes through a network together.
const PARTS: usize = 8;
/// Samples (blocks of lanes) that go through a network together: what they keep and the gains by its weights fit into cache.
pub(crate) const TOGETHER: usize = 16;

/// Sums what `part` adds to `n` cells for its samples, over all samples and lanes.
pub(crate) fn summed(samples: &[usize], n: usize, part: impl Fn(&[usize], &mut [F32x16]) + Sync) -> Vec<f32> {
    let each = samples.len().div_ceil(PARTS).max(TOGETHER);
    let mut parts: Vec<(&[usize], Vec<f32>)> = samples.chunks(each).map(|own| (own, Vec::new())).collect();
    pool::for_each(&mut parts, samples.len() * TOGETHER, |(own, out)| {
        let mut cells = vec![F32x16([0.0; 16]); n];
        part(own, &mut cells);
        *out = cells.iter().map(sum).collect();
    });
    let mut total = vec![0.0; n];
    for (_, own) in &parts {
        total.iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
    }
    total
}

/// The size of steps along half a cosine, from `rate` to nothing: `done` goes from 0 to 1.
pub(crate) fn annealed(rate: f32, done: f32) -> f32 {
    rate * 0.5 * (1.0 + (done * std::f32::consts::PI).cos())
}

/// Shortens a gradient to a length.
pub(crate) fn shorten(gradient: &mut [f32], longest: f32) {
    let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
    if length > longest {
        gradient.iter_mut().for_each(|g| *g *= longest / length);
    }
}

/// Puts a list into a random order (Fisher & Yates, "Statistical tables", 1938).
pub(crate) fn shuffle(list: &mut [usize], random: &mut Stream) {
    for i in (1..list.len()).rev() {
        list.swap(i, random.below(i as u64 + 1) as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_trace::lanes::Cell;

    #[test]
    fn sums_have_the_same_bits_at_any_number_of_threads() {
        let samples: Vec<usize> = (0..500).collect();
        let part = |own: &[usize], cells: &mut [F32x16]| {
            for i in own {
                for (k, cell) in cells.iter_mut().enumerate() {
                    (0..16).for_each(|l| cell.set(l, cell.get(l) + ((i * 31 + k * 7 + l) as f32).sin()));
                }
            }
        };
        let at = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| summed(&samples, 5, part))
        };
        assert_eq!(at(1), at(3));
        let wanted: f64 =
            (0..500).flat_map(|i| (0..16).map(move |l| f64::from((i * 31 + l) as f32).sin())).sum();
        assert!((f64::from(at(2)[0]) - wanted).abs() < 1e-2, "{} {wanted}", at(2)[0]);
    }

    #[test]
    fn a_shuffled_list_holds_the_same() {
        let mut list: Vec<usize> = (0..100).collect();
        shuffle(&mut list, &mut crate::episodes::stream(1, 0, 0, "test"));
        assert_ne!(list, (0..100).collect::<Vec<_>>());
        list.sort_unstable();
        assert_eq!(list, (0..100).collect::<Vec<_>>());
    }
}
