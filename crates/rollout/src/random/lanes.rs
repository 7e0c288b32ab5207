//! Normal random numbers for sixteen worlds at once.
//!
//! The bits are those of Philox4x32-10, so a number depends on its key alone: not on threads, lanes or what was drawn before. Two numbers of 32 bits become two
//! normal numbers (Box & Muller, "A note on the generation of random normal deviates", 1958), by the polynomials of Cephes (`logf`, `sinf`, `cosf`; Moshier, 1989).
//! Products and sums are not fused, so that every processor draws the same bits. No number is farther from zero than 5.7.

use super::{Key, ROUND_KEYS, ROUND_PRODUCTS};
use fearless_simd::{Simd, dispatch};
use propwash_trace::lanes::{F32x16, level};

/// Lanes of a block.
const N: usize = 16;
/// Normal numbers of one block of Philox.
const AT_ONCE: usize = 4;

/// Standard normal numbers for sixteen worlds, one block for each number; the world of `key` counts for nothing, those of the lanes are `worlds`.
pub fn normals(key: Key, worlds: &[u32; N], out: &mut [F32x16]) {
    dispatch!(level(), simd => normals_at(simd, key, worlds, out));
}

/// Draws that last: each number becomes `lasting` times what it was and √(1 − `lasting`²) times a new standard normal number, so that it stays of size 1 while
/// what it does adds up (an autoregressive process of first order). Arguments as in [`normals`].
pub fn lasting_normals(key: Key, worlds: &[u32; N], lasting: f32, numbers: &mut [F32x16]) {
    dispatch!(level(), simd => lasting_at(simd, key, worlds, lasting, numbers));
}

#[inline(always)]
fn normals_at<S: Simd>(simd: S, key: Key, worlds: &[u32; N], out: &mut [F32x16]) {
    simd.vectorize(
        #[inline(always)]
        || {
            for (block, part) in out.chunks_mut(AT_ONCE).enumerate() {
                let four = four(key, worlds, block as u32);
                for (to, from) in part.iter_mut().zip(&four) {
                    to.0 = *from;
                }
            }
        },
    )
}

#[inline(always)]
fn lasting_at<S: Simd>(simd: S, key: Key, worlds: &[u32; N], lasting: f32, numbers: &mut [F32x16]) {
    let fresh = (1.0 - lasting * lasting).max(0.0).sqrt();
    simd.vectorize(
        #[inline(always)]
        || {
            for (block, part) in numbers.chunks_mut(AT_ONCE).enumerate() {
                let four = four(key, worlds, block as u32);
                for (to, from) in part.iter_mut().zip(&four) {
                    for lane in 0..N {
                        to.0[lane] = lasting * to.0[lane] + fresh * from[lane];
                    }
                }
            }
        },
    )
}

/// Four normal numbers of each world.
#[inline(always)]
fn four(key: Key, worlds: &[u32; N], block: u32) -> [[f32; N]; AT_ONCE] {
    let words = philox(key, worlds, block);
    let mut out = [[0.0; N]; AT_ONCE];
    for pair in 0..2 {
        let (a, b) = (words[2 * pair], words[2 * pair + 1]);
        for lane in 0..N {
            let radius = (-2.0 * logarithm(above_zero(a[lane]))).sqrt();
            let (sin, cos) = sin_cos_of_turns(b[lane]);
            out[2 * pair][lane] = radius * cos;
            out[2 * pair + 1][lane] = radius * sin;
        }
    }
    out
}

/// The words of [`super::Philox`] for the same counter, in lanes.
#[inline(always)]
fn philox(key: Key, worlds: &[u32; N], block: u32) -> [[u32; N]; 4] {
    let (mut k0, mut k1) = (key.seed as u32 ^ key.purpose, (key.seed >> 32) as u32);
    let mut c = [[key.step as u32; N], [(key.step >> 32) as u32; N], *worlds, [key.drone << 8 | block; N]];
    for _ in 0..10 {
        let mut next = [[0; N]; 4];
        for lane in 0..N {
            let first = u64::from(ROUND_PRODUCTS[0]) * u64::from(c[0][lane]);
            let second = u64::from(ROUND_PRODUCTS[1]) * u64::from(c[2][lane]);
            next[0][lane] = (second >> 32) as u32 ^ c[1][lane] ^ k0;
            next[1][lane] = second as u32;
            next[2][lane] = (first >> 32) as u32 ^ c[3][lane] ^ k1;
            next[3][lane] = first as u32;
        }
        c = next;
        (k0, k1) = (k0.wrapping_add(ROUND_KEYS[0]), k1.wrapping_add(ROUND_KEYS[1]));
    }
    c
}

/// A number above 0 and below 1 from the upper 23 bits of a word.
#[inline(always)]
fn above_zero(word: u32) -> f32 {
    ((word >> 9) as i32 as f32 + 0.5) * (1.0 / 8_388_608.0)
}

/// Natural logarithm of a normal number above 0.
#[inline(always)]
fn logarithm(x: f32) -> f32 {
    // m in √½ to √2, x = m 2ⁿ.
    let bits = x.to_bits();
    let exponent = (bits.wrapping_sub(0x3F35_04F3) as i32) >> 23;
    let f = f32::from_bits(bits.wrapping_sub((exponent << 23) as u32)) - 1.0;
    let mut p = 7.037_683_6e-2;
    for c in [
        -1.151_461e-1,
        1.167_699_9e-1,
        -1.242_014_1e-1,
        1.424_932_3e-1,
        -1.666_805_8e-1,
        2.000_071_5e-1,
        -2.499_999_4e-1,
        3.333_333e-1,
    ] {
        p = p * f + c;
    }
    let z = f * f;
    f - 0.5 * z + f * z * p + exponent as f32 * core::f32::consts::LN_2
}

/// Sine and cosine of `word` / 2³² turns.
#[inline(always)]
fn sin_cos_of_turns(word: u32) -> (f32, f32) {
    // The nearest quarter of a turn, and the angle from there, −π/4 to π/4.
    let quarter = word.wrapping_add(1 << 29) >> 30;
    let rest = word.wrapping_sub(quarter << 30) as i32 as f32 * (core::f32::consts::TAU / 4_294_967_296.0);
    let z = rest * rest;
    let sin = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * rest + rest;
    let cos = ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
    let (mut a, mut b) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    if quarter & 2 != 0 {
        a = -a;
    }
    if (quarter + 1) & 2 != 0 {
        b = -b;
    }
    (a, b)
}

#[cfg(test)]
mod tests {
    use super::super::{Philox, purpose};
    use super::*;
    use propwash_trace::lanes::Cell;

    const KEY: Key = Key { seed: 0x1234_5678_9ABC_DEF0, world: 0, drone: 3, step: 1 << 40 | 77, purpose: 9 };

    #[test]
    fn words_are_those_of_philox_one_by_one() {
        let worlds = core::array::from_fn(|lane| 1000 * lane as u32 + 5);
        let words = philox(KEY, &worlds, 2);
        for (lane, world) in worlds.iter().enumerate() {
            let counter = [77, 1 << 8, *world, 3 << 8 | 2];
            let expected = Philox::block_of([0x9ABC_DEF0 ^ 9, 0x1234_5678], counter);
            assert_eq!([0, 1, 2, 3].map(|k| words[k][lane]), expected);
        }
    }

    #[test]
    fn logarithm_sine_and_cosine_are_right_to_the_last_digits() {
        for i in 0..200_000u32 {
            let word = i.wrapping_mul(0x9E37_79B9);
            let x = above_zero(word);
            assert!(x > 0.0 && x < 1.0);
            let (got, wanted) = (f64::from(logarithm(x)), f64::from(x).ln());
            assert!((got - wanted).abs() <= 2e-7 * wanted.abs().max(0.1), "ln {x}: {got}, not {wanted}");
            let angle = f64::from(word) / 4_294_967_296.0 * core::f64::consts::TAU;
            let (sin, cos) = sin_cos_of_turns(word);
            let off = (f64::from(sin) - angle.sin()).abs().max((f64::from(cos) - angle.cos()).abs());
            assert!(off < 3e-7, "{angle}: {off}");
        }
        assert!(above_zero(0) > 0.0 && above_zero(u32::MAX) < 1.0);
    }

    #[test]
    fn numbers_are_normal_and_go_together_with_no_others() {
        let n = 200_000;
        let mut lists = vec![Vec::new(); 6];
        let mut cells = [F32x16::splat(0.0); 6];
        for block in 0..n / N {
            let worlds = core::array::from_fn(|lane| lane as u32);
            normals(Key { step: block as u64, ..KEY }, &worlds, &mut cells);
            for (list, cell) in lists.iter_mut().zip(&cells) {
                list.extend(cell.0.map(f64::from));
            }
        }
        let mean = |list: &[f64], f: &dyn Fn(f64) -> f64| list.iter().map(|v| f(*v)).sum::<f64>() / n as f64;
        for list in &lists {
            // Standard errors of the first four moments: √(1, 2, 15, 96) / √n.
            for (k, (wanted, error)) in
                [(0.0, 1.0), (1.0, 2f64.sqrt()), (0.0, 15f64.sqrt()), (3.0, 96f64.sqrt())]
                    .into_iter()
                    .enumerate()
            {
                let moment = mean(list, &|v| v.powi(k as i32 + 1));
                assert!(
                    (moment - wanted).abs() < 4.5 * error / (n as f64).sqrt(),
                    "moment {}: {moment}",
                    k + 1
                );
            }
            // Shares of the normal distribution beyond 1, 2, 3 and 4.
            for (beyond, share) in [(1.0, 0.158_655), (2.0, 0.022_750), (3.0, 1.349_9e-3), (4.0, 3.167e-5)] {
                let got = mean(list, &|v| f64::from(v > beyond));
                let error = (share / n as f64).sqrt();
                assert!((got - share).abs() < 4.5 * error, "beyond {beyond}: {got}, not {share}");
            }
        }
        for i in 0..lists.len() {
            for j in 0..i {
                let together = lists[i].iter().zip(&lists[j]).map(|(a, b)| a * b).sum::<f64>() / n as f64;
                assert!(together.abs() < 4.5 / (n as f64).sqrt(), "{i} {j}: {together}");
            }
            let next = lists[i].windows(2 * N).map(|w| w[0] * w[N]).sum::<f64>() / n as f64;
            assert!(next.abs() < 4.5 / (n as f64).sqrt(), "{i}: {next}");
        }
    }

    #[test]
    fn a_number_is_the_same_in_every_lane_and_lasts_as_it_should() {
        let key = Key { purpose: purpose("test"), ..KEY };
        let (mut some, mut turned) = ([F32x16::splat(0.0); 3], [F32x16::splat(0.0); 3]);
        let worlds: [u32; N] = core::array::from_fn(|lane| 40 + lane as u32);
        let mut backwards = worlds;
        backwards.reverse();
        normals(key, &worlds, &mut some);
        normals(key, &backwards, &mut turned);
        for (a, b) in some.iter().zip(&turned) {
            assert!((0..N).all(|lane| a.get(lane).to_bits() == b.get(N - 1 - lane).to_bits()));
        }
        let (mut square, mut product, mut before) = (0.0, 0.0, [F32x16::splat(0.0); 2]);
        lasting_normals(key, &worlds, 0.0, &mut before);
        let steps = 20_000;
        for step in 1..=steps {
            let mut now = before;
            lasting_normals(Key { step, ..key }, &worlds, 0.8, &mut now);
            for lane in 0..N {
                square += f64::from(now[1].0[lane]).powi(2);
                product += f64::from(now[1].0[lane] * before[1].0[lane]);
            }
            before = now;
        }
        let n = (steps as usize * N) as f64;
        assert!((square / n - 1.0).abs() < 0.03 && (product / n - 0.8).abs() < 0.03, "{square} {product}");
    }
}
