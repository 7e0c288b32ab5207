//! Normal random numbers for many drones at once.
//!
//! The bits are those of Philox4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011): four words for a counter of four and
//! a key of two, in ten rounds. So a number depends on its key alone: not on threads, lanes or what was drawn before. Two numbers of 32 bits become two
//! normal numbers (Box & Muller, "A note on the generation of random normal deviates", 1958), by the polynomials of Cephes (`logf`, `sinf`, `cosf`; Moshier, 1989).
//! Products and sums are not fused, so that every processor draws the same bits. No number is farther from zero than 5.77.

use super::Key;
use fearless_simd::{Level, Simd, dispatch};
use propwash_trace::lanes::{F32x16, level, vectorize};

/// What Philox4x32 multiplies two words by in each round, and adds to its two keys after it.
const ROUND_PRODUCTS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const ROUND_KEYS: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// Lanes of a block.
const N: usize = 16;
/// Normal numbers of one block of Philox.
pub(crate) const AT_ONCE: usize = 4;

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
    vectorize(
        simd,
        #[inline(always)]
        || {
            for (block, part) in out.chunks_mut(AT_ONCE).enumerate() {
                let (keys, counter) = named(key, worlds, block as u32);
                let four = four(keys, counter);
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
    vectorize(
        simd,
        #[inline(always)]
        || {
            for (block, part) in numbers.chunks_mut(AT_ONCE).enumerate() {
                let (keys, counter) = named(key, worlds, block as u32);
                let four = four(keys, counter);
                for (to, from) in part.iter_mut().zip(&four) {
                    for lane in 0..N {
                        to.0[lane] = lasting * to.0[lane] + fresh * from[lane];
                    }
                }
            }
        },
    )
}

/// What names the draws of a step, for the drones of some lanes: parts of [`Key`], an array for each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Names {
    key: [Vec<u32>; 2],
    world: Vec<u32>,
    drone: Vec<u32>,
    step: Vec<u64>,
    /// Set in the number of every step.
    episode: Vec<u64>,
}

impl Names {
    pub(crate) fn clear(&mut self) {
        let Self { key: [k0, k1], world, drone, step, episode } = self;
        [k0, k1, world, drone].into_iter().for_each(Vec::clear);
        [step, episode].into_iter().for_each(Vec::clear);
    }

    /// Adds a lane; worlds are told apart up to 2³², drones up to 2²⁴. The number of a step is `key.step` and the steps since then, with `episode` set in it.
    pub(crate) fn push(&mut self, key: Key, episode: u64) {
        let ([k0, k1], world, drone) = parts(key);
        self.key[0].push(k0);
        self.key[1].push(k1);
        self.world.push(world);
        self.drone.push(drone);
        self.step.push(key.step);
        self.episode.push(episode);
    }

    /// Standard normal numbers `AT_ONCE * block` and those after it of the first `n` lanes, `done` steps later; `out` has at least as many lanes as names
    /// were added, `n` of which are drawn and perhaps some more.
    pub(crate) fn draw(
        &self,
        level: Level,
        n: usize,
        (done, block): (u64, u32),
        out: &mut [Vec<f32>; AT_ONCE],
    ) {
        let mut lane = 0;
        while lane < n {
            // Few drones need no sixteen lanes, but what one lane costs is not much less than four.
            let width = match self.step.len().min(n.next_multiple_of(4)) - lane {
                16.. => 16,
                4.. => 4,
                _ => 1,
            };
            dispatch!(level, simd => match width {
                16 => self.draw_at::<_, 16>(simd, lane, (done, block), out),
                4 => self.draw_at::<_, 4>(simd, lane, (done, block), out),
                _ => self.draw_at::<_, 1>(simd, lane, (done, block), out),
            });
            lane += width;
        }
    }

    #[inline(always)]
    fn draw_at<S: Simd, const M: usize>(
        &self,
        simd: S,
        lane: usize,
        (done, block): (u64, u32),
        out: &mut [Vec<f32>; AT_ONCE],
    ) {
        vectorize(
            simd,
            #[inline(always)]
            || {
                // No `array::from_fn`: it is not compiled into this function.
                let of = |all: &[u32]| {
                    let mut own = [0; M];
                    own.copy_from_slice(&all[lane..lane + M]);
                    own
                };
                let mut counter = [[0; M], [0; M], of(&self.world), of(&self.drone)];
                for i in 0..M {
                    let step = self.episode[lane + i] ^ (self.step[lane + i] + done);
                    (counter[0][i], counter[1][i]) = (step as u32, (step >> 32) as u32);
                    counter[3][i] |= block;
                }
                let four = four([of(&self.key[0]), of(&self.key[1])], counter);
                for (to, from) in out.iter_mut().zip(&four) {
                    to[lane..lane + M].copy_from_slice(from);
                }
            },
        )
    }
}

/// The same numbers of one drone: block number `block` of `key`, whose step is the number of the step with the episode set in it.
pub(crate) fn step_normals(key: Key, block: u32) -> [f32; AT_ONCE] {
    let ([k0, k1], world, drone) = parts(key);
    let counter = [[key.step as u32], [(key.step >> 32) as u32], [world], [drone | block]];
    four([[k0], [k1]], counter).map(|[v]| v)
}

/// Key of Philox, and the words of its counter that name world and drone; the number of the block is added to the last.
fn parts(key: Key) -> ([u32; 2], u32, u32) {
    let keys = [key.seed as u32 ^ key.purpose, (key.seed >> 32) as u32 ^ (key.world >> 32) as u32];
    (keys, key.world as u32, key.drone << 8)
}

/// Four normal numbers of each lane, by the keys and counters of Philox.
#[inline(always)]
fn four<const M: usize>(keys: [[u32; M]; 2], counter: [[u32; M]; 4]) -> [[f32; M]; AT_ONCE] {
    let words = philox(keys, counter);
    let mut out = [[0.0; M]; AT_ONCE];
    for pair in 0..2 {
        let (a, b) = (words[2 * pair], words[2 * pair + 1]);
        for lane in 0..M {
            let radius = (-2.0 * logarithm(above_zero(a[lane]))).sqrt();
            let (sin, cos) = sin_cos_of_turns(b[lane]);
            out[2 * pair][lane] = radius * cos;
            out[2 * pair + 1][lane] = radius * sin;
        }
    }
    out
}

/// Keys and counters of sixteen worlds.
#[inline(always)]
fn named(key: Key, worlds: &[u32; N], block: u32) -> ([[u32; N]; 2], [[u32; N]; 4]) {
    let keys = [[key.seed as u32 ^ key.purpose; N], [(key.seed >> 32) as u32; N]];
    (keys, [[key.step as u32; N], [(key.step >> 32) as u32; N], *worlds, [key.drone << 8 | block; N]])
}

/// Ten rounds of Philox4x32 in every lane.
#[inline(always)]
fn philox<const M: usize>(keys: [[u32; M]; 2], counter: [[u32; M]; 4]) -> [[u32; M]; 4] {
    // Four words of eight lanes are all that the registers of AVX2 hold.
    const HALF: usize = 8;
    if M <= HALF {
        return rounds(keys, counter);
    }
    let mut out = [[0; M]; 4];
    for from in (0..M).step_by(HALF) {
        let (mut own_keys, mut own_counter) = ([[0; HALF]; 2], [[0; HALF]; 4]);
        for lane in 0..HALF {
            for word in 0..2 {
                own_keys[word][lane] = keys[word][from + lane];
            }
            for word in 0..4 {
                own_counter[word][lane] = counter[word][from + lane];
            }
        }
        let words = rounds(own_keys, own_counter);
        for word in 0..4 {
            for lane in 0..HALF {
                out[word][from + lane] = words[word][lane];
            }
        }
    }
    out
}

/// The same for as many lanes as fit.
#[inline(always)]
fn rounds<const M: usize>(keys: [[u32; M]; 2], counter: [[u32; M]; 4]) -> [[u32; M]; 4] {
    // Words stand in the lower halves of 64 bits, where processors multiply them. What is left in the upper halves is never read: it saves bringing the halves
    // of products together in every round.
    const LOW: u64 = 0xFFFF_FFFF;
    // Loops, since `array::map` is not compiled into this function.
    let ([mut k0, mut k1], mut c) = ([[0u64; M]; 2], [[0u64; M]; 4]);
    for lane in 0..M {
        (k0[lane], k1[lane]) = (u64::from(keys[0][lane]), u64::from(keys[1][lane]));
        for word in 0..4 {
            c[word][lane] = u64::from(counter[word][lane]);
        }
    }
    for _ in 0..10 {
        let mut next = [[0; M]; 4];
        for lane in 0..M {
            let first = u64::from(ROUND_PRODUCTS[0]) * (c[0][lane] & LOW);
            let second = u64::from(ROUND_PRODUCTS[1]) * (c[2][lane] & LOW);
            next[0][lane] = (second >> 32) ^ c[1][lane] ^ k0[lane];
            next[1][lane] = second;
            next[2][lane] = (first >> 32) ^ c[3][lane] ^ k1[lane];
            next[3][lane] = first;
        }
        c = next;
        for lane in 0..M {
            k0[lane] = k0[lane].wrapping_add(u64::from(ROUND_KEYS[0]));
            k1[lane] = k1[lane].wrapping_add(u64::from(ROUND_KEYS[1]));
        }
    }
    let mut out = [[0; M]; 4];
    for word in 0..4 {
        for lane in 0..M {
            out[word][lane] = c[word][lane] as u32;
        }
    }
    out
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
    use super::super::purpose;
    use super::*;
    use propwash_trace::lanes::Cell;

    const KEY: Key = Key { seed: 0x1234_5678_9ABC_DEF0, world: 0, drone: 3, step: 1 << 40 | 77, purpose: 9 };

    /// The known answers that come with Random123, the authors' own library (`kat_vectors`, philox4x32 10), in lanes.
    #[test]
    fn philox_gives_the_known_answers() {
        let ones = u32::MAX;
        let known = [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([ones; 4], [ones; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        let lanes = |of: &dyn Fn(usize) -> u32| -> [u32; 3] { core::array::from_fn(of) };
        let keys = [0, 1].map(|k| lanes(&|lane| known[lane].1[k]));
        let counter = [0, 1, 2, 3].map(|k| lanes(&|lane| known[lane].0[k]));
        let words = philox(keys, counter);
        for (lane, (.., answer)) in known.iter().enumerate() {
            assert_eq!([0, 1, 2, 3].map(|k| words[k][lane]), *answer);
        }
    }

    #[test]
    fn names_in_lanes_draw_what_each_draws_alone_and_worlds_alike_what_they_draw_together() {
        let key = |lane: u64| Key {
            seed: KEY.seed ^ (lane % 3),
            world: (7 * lane) << (lane % 2 * 30),
            step: (1 << 32) - 8 + 5 * (lane % 3),
            drone: lane as u32,
            ..KEY
        };
        let episode = |lane: u64| (lane / 4).rotate_left(40);
        let mut levels = vec![level()];
        #[cfg(target_arch = "x86_64")]
        levels.extend(level().as_sse2().map(Level::Sse2));
        for level in levels {
            for (lanes, n) in [(1, 1), (8, 5), (16, 16), (64, 3), (64, 41), (64, 64)] {
                let mut names = Names::default();
                (0..lanes).for_each(|lane| names.push(key(lane), episode(lane)));
                let mut out = core::array::from_fn(|_| vec![0.0; lanes as usize]);
                names.draw(level, n, (11, 1), &mut out);
                for lane in 0..n {
                    let key = key(lane as u64);
                    let alone = Key { step: (key.step + 11) ^ episode(lane as u64), ..key };
                    assert_eq!(
                        step_normals(alone, 1),
                        [0, 1, 2, 3].map(|k| out[k][lane]),
                        "{lanes} {n} {lane}"
                    );
                }
            }
        }
        let (worlds, mut cells) = (core::array::from_fn(|lane| lane as u32), [F32x16::splat(0.0); 8]);
        normals(KEY, &worlds, &mut cells);
        let alone = step_normals(Key { world: 9, ..KEY }, 1);
        assert_eq!(alone, [4, 5, 6, 7].map(|k: usize| cells[k].get(9)));
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
