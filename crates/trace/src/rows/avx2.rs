//! Rows of numbers brought into lanes and back with AVX2: the registers are half as wide as a block of lanes, so that each half of a block is shuffled
//! by itself.

use core::arch::x86_64::{
    __m256, __m256d, _mm256_castpd_ps, _mm256_castpd128_pd256, _mm256_castpd256_pd128, _mm256_castps_pd,
    _mm256_castps128_ps256, _mm256_castps256_ps128, _mm256_extractf128_pd, _mm256_extractf128_ps,
    _mm256_insertf128_pd, _mm256_insertf128_ps, _mm256_permute2f128_pd, _mm256_shuffle_pd, _mm256_shuffle_ps,
    _mm256_unpackhi_pd, _mm256_unpackhi_ps, _mm256_unpacklo_pd, _mm256_unpacklo_ps,
};

use fearless_simd::prelude::*;
use fearless_simd::{f32x4, f32x8, f64x2, f64x4, kernel};

use super::super::lanes::{F32x16, F64x8};

// No closure and no iterator adaptor stands within a kernel: what is not inlined there is compiled without the features.

/// Places of [`_mm256_shuffle_ps`]: two numbers from the first register, then two from the second.
const fn pick(a: i32, b: i32, c: i32, d: i32) -> i32 {
    a | b << 2 | c << 4 | d << 6
}

kernel!(
    /// Transposes the two blocks of 4 × 4 numbers that stand side by side in four registers.
    #[inline]
    fn turn_f32(_simd: Avx2, r: [__m256; 4]) -> [__m256; 4] {
        let a = _mm256_castps_pd(_mm256_unpacklo_ps(r[0], r[1]));
        let b = _mm256_castps_pd(_mm256_unpacklo_ps(r[2], r[3]));
        let c = _mm256_castps_pd(_mm256_unpackhi_ps(r[0], r[1]));
        let d = _mm256_castps_pd(_mm256_unpackhi_ps(r[2], r[3]));
        [
            _mm256_castpd_ps(_mm256_unpacklo_pd(a, b)),
            _mm256_castpd_ps(_mm256_unpackhi_pd(a, b)),
            _mm256_castpd_ps(_mm256_unpacklo_pd(c, d)),
            _mm256_castpd_ps(_mm256_unpackhi_pd(c, d)),
        ]
    }
);
kernel!(
    /// Transposes a block of 4 × 4 numbers.
    #[inline]
    fn turn_f64(_simd: Avx2, r: [__m256d; 4]) -> [__m256d; 4] {
        let (a, b) = (_mm256_unpacklo_pd(r[0], r[1]), _mm256_unpacklo_pd(r[2], r[3]));
        let (c, d) = (_mm256_unpackhi_pd(r[0], r[1]), _mm256_unpackhi_pd(r[2], r[3]));
        [
            _mm256_permute2f128_pd::<0x20>(a, b),
            _mm256_permute2f128_pd::<0x20>(c, d),
            _mm256_permute2f128_pd::<0x31>(a, b),
            _mm256_permute2f128_pd::<0x31>(c, d),
        ]
    }
);
kernel!(
    /// Numbers 0, 1 and 2 of eight rows of three. The registers hold the rows four numbers at a time: in their low halves those of
    /// rows 0 to 3, in their high halves those of rows 4 to 7.
    #[inline]
    fn apart_f32(_simd: Avx2, r: [__m256; 3]) -> [__m256; 3] {
        let ends = _mm256_shuffle_ps::<{ pick(2, 3, 1, 2) }>(r[1], r[2]);
        let starts = _mm256_shuffle_ps::<{ pick(1, 2, 0, 1) }>(r[0], r[1]);
        [
            _mm256_shuffle_ps::<{ pick(0, 3, 0, 2) }>(r[0], ends),
            _mm256_shuffle_ps::<{ pick(0, 2, 1, 3) }>(starts, ends),
            _mm256_shuffle_ps::<{ pick(1, 3, 0, 3) }>(starts, r[2]),
        ]
    }
);
kernel!(
    /// The way back from [`apart_f32`].
    #[inline]
    fn together_f32(_simd: Avx2, c: [__m256; 3]) -> [__m256; 3] {
        let even = _mm256_shuffle_ps::<{ pick(0, 2, 0, 2) }>(c[0], c[1]);
        let odd = _mm256_shuffle_ps::<{ pick(1, 3, 1, 3) }>(c[1], c[2]);
        let across = _mm256_shuffle_ps::<{ pick(0, 2, 1, 3) }>(c[2], c[0]);
        [
            _mm256_shuffle_ps::<{ pick(0, 2, 0, 2) }>(even, across),
            _mm256_shuffle_ps::<{ pick(0, 2, 1, 3) }>(odd, even),
            _mm256_shuffle_ps::<{ pick(1, 3, 1, 3) }>(across, odd),
        ]
    }
);
kernel!(
    /// Numbers 0, 1 and 2 of four rows of three. The registers hold the rows two numbers at a time: in their low halves those of
    /// rows 0 and 1, in their high halves those of rows 2 and 3.
    #[inline]
    fn apart_f64(_simd: Avx2, r: [__m256d; 3]) -> [__m256d; 3] {
        [
            _mm256_shuffle_pd::<0b1010>(r[0], r[1]),
            _mm256_shuffle_pd::<0b0101>(r[0], r[2]),
            _mm256_shuffle_pd::<0b1010>(r[1], r[2]),
        ]
    }
);
kernel!(
    /// The way back from [`apart_f64`].
    #[inline]
    fn together_f64(_simd: Avx2, c: [__m256d; 3]) -> [__m256d; 3] {
        [
            _mm256_shuffle_pd::<0b0000>(c[0], c[1]),
            _mm256_shuffle_pd::<0b1010>(c[2], c[0]),
            _mm256_shuffle_pd::<0b1111>(c[1], c[2]),
        ]
    }
);

/// Two places of half a register each as one register.
macro_rules! read_halves_f32 {
    ($simd:ident, $rows:ident, $low:expr, $high:expr) => {{
        let low = f32x4::from_slice($simd, &$rows[$low..][..4]).into();
        let high = f32x4::from_slice($simd, &$rows[$high..][..4]).into();
        _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(low), high)
    }};
}
macro_rules! write_halves_f32 {
    ($simd:ident, $v:expr, $rows:ident, $low:expr, $high:expr) => {
        let (low, high) = (_mm256_castps256_ps128($v), _mm256_extractf128_ps::<1>($v));
        f32x4::simd_from($simd, low).store_slice(&mut $rows[$low..][..4]);
        f32x4::simd_from($simd, high).store_slice(&mut $rows[$high..][..4]);
    };
}
macro_rules! read_halves_f64 {
    ($simd:ident, $rows:ident, $low:expr, $high:expr) => {{
        let low = f64x2::from_slice($simd, &$rows[$low..][..2]).into();
        let high = f64x2::from_slice($simd, &$rows[$high..][..2]).into();
        _mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(low), high)
    }};
}
macro_rules! write_halves_f64 {
    ($simd:ident, $v:expr, $rows:ident, $low:expr, $high:expr) => {
        let (low, high) = (_mm256_castpd256_pd128($v), _mm256_extractf128_pd::<1>($v));
        f64x2::simd_from($simd, low).store_slice(&mut $rows[$low..][..2]);
        f64x2::simd_from($simd, high).store_slice(&mut $rows[$high..][..2]);
    };
}
/// Four numbers of row `$i` of half a block, with those of the row that shares its register, where two do.
macro_rules! read_f32 {
    ($simd:ident, $rows:ident, $width:expr, $from:expr, $i:expr) => {
        read_halves_f32!($simd, $rows, $i * $width + $from, ($i + 4) * $width + $from)
    };
}
macro_rules! write_f32 {
    ($simd:ident, $v:expr, $rows:ident, $width:expr, $from:expr, $i:expr) => {
        write_halves_f32!($simd, $v, $rows, $i * $width + $from, ($i + 4) * $width + $from)
    };
}
macro_rules! read_f64 {
    ($simd:ident, $rows:ident, $width:expr, $from:expr, $i:expr) => {
        f64x4::from_slice($simd, &$rows[$i * $width + $from..][..4]).into()
    };
}
macro_rules! write_f64 {
    ($simd:ident, $v:expr, $rows:ident, $width:expr, $from:expr, $i:expr) => {
        f64x4::simd_from($simd, $v).store_slice(&mut $rows[$i * $width + $from..][..4])
    };
}

/// `gather` and `scatter` for one type of number, of which a register holds `$n`.
macro_rules! both_ways {
    ($gather:ident, $scatter:ident, $gather_four:ident, $scatter_four:ident, $cell:ty, $number:ty, $vector:ident, $n:literal, $turn:ident, $read:ident, $write:ident,
     $apart:ident, $together:ident, $read_halves:ident, $write_halves:ident) => {
        kernel!(
            /// Four columns of all rows to four cells.
            #[inline]
            fn $gather_four(simd: Avx2, cells: &mut [$cell; 4], rows: &[$number], width: usize) {
                for half in 0..2 {
                    let from = half * $n * width;
                    let r = [
                        $read!(simd, rows, width, from, 0),
                        $read!(simd, rows, width, from, 1),
                        $read!(simd, rows, width, from, 2),
                        $read!(simd, rows, width, from, 3),
                    ];
                    let turned = $turn(simd, r);
                    for j in 0..4 {
                        $vector::simd_from(simd, turned[j]).store_slice(&mut cells[j].0[half * $n..][..$n]);
                    }
                }
            }
        );
        kernel!(
            /// Four cells to four columns of all rows.
            #[inline]
            fn $scatter_four(simd: Avx2, cells: &[$cell; 4], rows: &mut [$number], width: usize) {
                for half in 0..2 {
                    let from = half * $n * width;
                    let c = [
                        $vector::from_slice(simd, &cells[0].0[half * $n..][..$n]).into(),
                        $vector::from_slice(simd, &cells[1].0[half * $n..][..$n]).into(),
                        $vector::from_slice(simd, &cells[2].0[half * $n..][..$n]).into(),
                        $vector::from_slice(simd, &cells[3].0[half * $n..][..$n]).into(),
                    ];
                    let turned = $turn(simd, c);
                    for i in 0..4 {
                        $write!(simd, turned[i], rows, width, from, i);
                    }
                }
            }
        );
        kernel!(
            /// [`super::gather`]
            pub(super) fn $gather(
                simd: Avx2,
                cells: &mut [$cell],
                rows: &[$number],
                width: usize,
                col: usize,
            ) {
                let n = cells.len();
                let rows = &rows[col..][..(2 * $n - 1) * width + n];
                if let (3, Some(rows), Some(cells)) =
                    (width, rows.first_chunk::<{ 6 * $n }>(), cells.first_chunk_mut::<3>())
                {
                    for half in 0..2 {
                        let (from, step) = (3 * $n * half, $n / 2);
                        let r = [
                            $read_halves!(simd, rows, from, from + 3 * step),
                            $read_halves!(simd, rows, from + step, from + 4 * step),
                            $read_halves!(simd, rows, from + 2 * step, from + 5 * step),
                        ];
                        let columns = $apart(simd, r);
                        for j in 0..3 {
                            $vector::simd_from(simd, columns[j])
                                .store_slice(&mut cells[j].0[half * $n..][..$n]);
                        }
                    }
                } else if n == 1 && width == 1 {
                    cells[0].0.copy_from_slice(&rows[..2 * $n]);
                } else if let (4, Some(rows), Some(cells)) =
                    (width, rows.first_chunk::<{ 8 * $n }>(), cells.first_chunk_mut::<4>())
                {
                    // Places that are known need no checks.
                    $gather_four(simd, cells, rows, 4);
                } else if n >= 4 {
                    let mut first = 0;
                    while let Some(cells) = cells[first..].first_chunk_mut::<4>() {
                        $gather_four(simd, cells, &rows[first..], width);
                        if first + 4 == n {
                            break;
                        }
                        // The last block may overlap the one before.
                        first = if first + 8 <= n { first + 4 } else { n - 4 };
                    }
                } else {
                    super::gather(cells, rows, width, 0);
                }
            }
        );
        kernel!(
            /// [`super::scatter`]
            pub(super) fn $scatter(
                simd: Avx2,
                cells: &[$cell],
                rows: &mut [$number],
                width: usize,
                col: usize,
            ) {
                let n = cells.len();
                let rows = &mut rows[col..][..(2 * $n - 1) * width + n];
                if let (3, Some(rows), Some(cells)) =
                    (width, rows.first_chunk_mut::<{ 6 * $n }>(), cells.first_chunk::<3>())
                {
                    for half in 0..2 {
                        let (from, step) = (3 * $n * half, $n / 2);
                        let c = [
                            $vector::from_slice(simd, &cells[0].0[half * $n..][..$n]).into(),
                            $vector::from_slice(simd, &cells[1].0[half * $n..][..$n]).into(),
                            $vector::from_slice(simd, &cells[2].0[half * $n..][..$n]).into(),
                        ];
                        let r = $together(simd, c);
                        $write_halves!(simd, r[0], rows, from, from + 3 * step);
                        $write_halves!(simd, r[1], rows, from + step, from + 4 * step);
                        $write_halves!(simd, r[2], rows, from + 2 * step, from + 5 * step);
                    }
                } else if n == 1 && width == 1 {
                    rows[..2 * $n].copy_from_slice(&cells[0].0);
                } else if let (4, Some(rows), Some(cells)) =
                    (width, rows.first_chunk_mut::<{ 8 * $n }>(), cells.first_chunk::<4>())
                {
                    $scatter_four(simd, cells, rows, 4);
                } else if n >= 4 {
                    let mut first = 0;
                    while let Some(cells) = cells[first..].first_chunk::<4>() {
                        $scatter_four(simd, cells, &mut rows[first..], width);
                        if first + 4 == n {
                            break;
                        }
                        first = if first + 8 <= n { first + 4 } else { n - 4 };
                    }
                } else {
                    super::scatter(cells, rows, width, 0);
                }
            }
        );
    };
}
both_ways! {
    gather_f32, scatter_f32, gather_four_f32, scatter_four_f32, F32x16, f32, f32x8, 8, turn_f32, read_f32, write_f32,
    apart_f32, together_f32, read_halves_f32, write_halves_f32
}
both_ways! {
    gather_f64, scatter_f64, gather_four_f64, scatter_four_f64, F64x8, f64, f64x4, 4, turn_f64, read_f64, write_f64,
    apart_f64, together_f64, read_halves_f64, write_halves_f64
}
