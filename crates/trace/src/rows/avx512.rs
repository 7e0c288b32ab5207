//! Rows of numbers brought into lanes and back with AVX-512.

use core::arch::x86_64::{
    __m512, __m512d, _mm512_castpd_ps, _mm512_castpd256_pd512, _mm512_castpd512_pd256, _mm512_castps_pd,
    _mm512_castps128_ps512, _mm512_castps512_ps128, _mm512_extractf32x4_ps, _mm512_extractf64x4_pd,
    _mm512_insertf32x4, _mm512_insertf64x4, _mm512_permutex2var_pd, _mm512_permutex2var_ps,
    _mm512_unpackhi_pd, _mm512_unpackhi_ps, _mm512_unpacklo_pd, _mm512_unpacklo_ps,
};

use fearless_simd::prelude::*;
use fearless_simd::{f32x4, f32x16, f64x4, f64x8, i32x16, i64x8, kernel};

use super::super::lanes::{F32x16, F64x8};

/// Which of three registers of `N` numbers, taken as rows of three, hold number `j` of row i: first from the first two, then
/// from these and the third.
const fn apart<const N: usize>(j: usize) -> [[usize; N]; 2] {
    let mut steps = [[0; N]; 2];
    let mut i = 0;
    while i < N {
        let from = 3 * i + j;
        (steps[0][i], steps[1][i]) = if from < 2 * N { (from, i) } else { (0, from - N) };
        i += 1;
    }
    steps
}

/// The way back: register `m` of three that hold rows of three, first from numbers 0 and 1, then from these and number 2.
const fn together<const N: usize>(m: usize) -> [[usize; N]; 2] {
    let mut steps = [[0; N]; 2];
    let mut i = 0;
    while i < N {
        let (row, j) = ((m * N + i) / 3, (m * N + i) % 3);
        (steps[0][i], steps[1][i]) = if j < 2 { (j * N + row, i) } else { (0, N + row) };
        i += 1;
    }
    steps
}

const fn narrow(steps: [[usize; 16]; 2]) -> [[i32; 16]; 2] {
    let mut out = [[0; 16]; 2];
    let mut i = 0;
    while i < 32 {
        out[i / 16][i % 16] = steps[i / 16][i % 16] as i32;
        i += 1;
    }
    out
}

const fn wide(steps: [[usize; 8]; 2]) -> [[i64; 8]; 2] {
    let mut out = [[0; 8]; 2];
    let mut i = 0;
    while i < 16 {
        out[i / 8][i % 8] = steps[i / 8][i % 8] as i64;
        i += 1;
    }
    out
}

const APART_F32: [[[i32; 16]; 2]; 3] = [narrow(apart(0)), narrow(apart(1)), narrow(apart(2))];
const TOGETHER_F32: [[[i32; 16]; 2]; 3] = [narrow(together(0)), narrow(together(1)), narrow(together(2))];
const APART_F64: [[[i64; 8]; 2]; 3] = [wide(apart(0)), wide(apart(1)), wide(apart(2))];
const TOGETHER_F64: [[[i64; 8]; 2]; 3] = [wide(together(0)), wide(together(1)), wide(together(2))];

// No closure and no iterator adaptor stands within a kernel: what is not inlined there is compiled without the features.

kernel!(
    #[inline]
    fn mix_f32(simd: Avx512, a: __m512, b: __m512, c: __m512, steps: &[[i32; 16]; 2]) -> __m512 {
        let first = i32x16::simd_from(simd, steps[0]).into();
        let second = i32x16::simd_from(simd, steps[1]).into();
        _mm512_permutex2var_ps(_mm512_permutex2var_ps(a, first, b), second, c)
    }
);
kernel!(
    #[inline]
    fn mix_f64(simd: Avx512, a: __m512d, b: __m512d, c: __m512d, steps: &[[i64; 8]; 2]) -> __m512d {
        let first = i64x8::simd_from(simd, steps[0]).into();
        let second = i64x8::simd_from(simd, steps[1]).into();
        _mm512_permutex2var_pd(_mm512_permutex2var_pd(a, first, b), second, c)
    }
);
kernel!(
    /// Transposes the four blocks of 4 × 4 numbers that stand side by side in four registers.
    #[inline]
    fn turn_f32(_simd: Avx512, r: [__m512; 4]) -> [__m512; 4] {
        let a = _mm512_castps_pd(_mm512_unpacklo_ps(r[0], r[1]));
        let b = _mm512_castps_pd(_mm512_unpacklo_ps(r[2], r[3]));
        let c = _mm512_castps_pd(_mm512_unpackhi_ps(r[0], r[1]));
        let d = _mm512_castps_pd(_mm512_unpackhi_ps(r[2], r[3]));
        [
            _mm512_castpd_ps(_mm512_unpacklo_pd(a, b)),
            _mm512_castpd_ps(_mm512_unpackhi_pd(a, b)),
            _mm512_castpd_ps(_mm512_unpacklo_pd(c, d)),
            _mm512_castpd_ps(_mm512_unpackhi_pd(c, d)),
        ]
    }
);
kernel!(
    /// Of four registers, each of which holds two rows of four numbers (0 and 4, 1 and 5, 2 and 6, 3 and 7): the four columns.
    #[inline]
    fn columns_f64(simd: Avx512, r: [__m512d; 4]) -> [__m512d; 4] {
        let even = i64x8::simd_from(simd, EVEN).into();
        let odd = i64x8::simd_from(simd, ODD).into();
        let (a, b) = (_mm512_unpacklo_pd(r[0], r[1]), _mm512_unpacklo_pd(r[2], r[3]));
        let (c, d) = (_mm512_unpackhi_pd(r[0], r[1]), _mm512_unpackhi_pd(r[2], r[3]));
        [
            _mm512_permutex2var_pd(a, even, b),
            _mm512_permutex2var_pd(c, even, d),
            _mm512_permutex2var_pd(a, odd, b),
            _mm512_permutex2var_pd(c, odd, d),
        ]
    }
);
kernel!(
    /// The way back from [`columns_f64`].
    #[inline]
    fn rows_f64(simd: Avx512, c: [__m512d; 4]) -> [__m512d; 4] {
        let even = i64x8::simd_from(simd, EVEN).into();
        let odd = i64x8::simd_from(simd, ODD).into();
        let (a, b) = (_mm512_permutex2var_pd(c[0], even, c[2]), _mm512_permutex2var_pd(c[1], even, c[3]));
        let (e, f) = (_mm512_permutex2var_pd(c[0], odd, c[2]), _mm512_permutex2var_pd(c[1], odd, c[3]));
        [
            _mm512_unpacklo_pd(a, b),
            _mm512_unpackhi_pd(a, b),
            _mm512_unpacklo_pd(e, f),
            _mm512_unpackhi_pd(e, f),
        ]
    }
);
const EVEN: [i64; 8] = [0, 1, 8, 9, 4, 5, 12, 13];
const ODD: [i64; 8] = [2, 3, 10, 11, 6, 7, 14, 15];

/// One register of rows i, i + 4, … by four numbers each.
macro_rules! read_f32 {
    ($simd:ident, $rows:ident, $width:expr, $first:expr, $i:ident) => {{
        let a = f32x4::from_slice($simd, &$rows[$i * $width + $first..][..4]).into();
        let b = f32x4::from_slice($simd, &$rows[($i + 4) * $width + $first..][..4]).into();
        let c = f32x4::from_slice($simd, &$rows[($i + 8) * $width + $first..][..4]).into();
        let d = f32x4::from_slice($simd, &$rows[($i + 12) * $width + $first..][..4]).into();
        let v = _mm512_insertf32x4::<1>(_mm512_castps128_ps512(a), b);
        _mm512_insertf32x4::<3>(_mm512_insertf32x4::<2>(v, c), d)
    }};
}
macro_rules! write_f32 {
    ($simd:ident, $v:expr, $rows:ident, $width:expr, $first:expr, $i:ident) => {
        let v = $v;
        let (a, b) = (_mm512_castps512_ps128(v), _mm512_extractf32x4_ps::<1>(v));
        let (c, d) = (_mm512_extractf32x4_ps::<2>(v), _mm512_extractf32x4_ps::<3>(v));
        f32x4::simd_from($simd, a).store_slice(&mut $rows[$i * $width + $first..][..4]);
        f32x4::simd_from($simd, b).store_slice(&mut $rows[($i + 4) * $width + $first..][..4]);
        f32x4::simd_from($simd, c).store_slice(&mut $rows[($i + 8) * $width + $first..][..4]);
        f32x4::simd_from($simd, d).store_slice(&mut $rows[($i + 12) * $width + $first..][..4]);
    };
}
macro_rules! read_f64 {
    ($simd:ident, $rows:ident, $width:expr, $first:expr, $i:ident) => {{
        let a = f64x4::from_slice($simd, &$rows[$i * $width + $first..][..4]).into();
        let b = f64x4::from_slice($simd, &$rows[($i + 4) * $width + $first..][..4]).into();
        _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(a), b)
    }};
}
macro_rules! write_f64 {
    ($simd:ident, $v:expr, $rows:ident, $width:expr, $first:expr, $i:ident) => {
        let v = $v;
        let (a, b) = (_mm512_castpd512_pd256(v), _mm512_extractf64x4_pd::<1>(v));
        f64x4::simd_from($simd, a).store_slice(&mut $rows[$i * $width + $first..][..4]);
        f64x4::simd_from($simd, b).store_slice(&mut $rows[($i + 4) * $width + $first..][..4]);
    };
}
/// Four columns of all rows to four cells.
macro_rules! gather_block {
    ($simd:ident, $cells:ident, $first:expr, $rows:ident, $width:expr, $vector:ident, $turn:ident, $read:ident) => {
        let mut r = [$vector::splat($simd, 0.0).into(); 4];
        for i in 0..4 {
            r[i] = $read!($simd, $rows, $width, $first, i);
        }
        let turned = $turn($simd, r);
        for j in 0..4 {
            $vector::simd_from($simd, turned[j]).store_slice(&mut $cells[$first + j].0);
        }
    };
}
/// Four cells to four columns of all rows.
macro_rules! scatter_block {
    ($simd:ident, $cells:ident, $first:expr, $rows:ident, $width:expr, $vector:ident, $turn:ident, $write:ident) => {
        let mut c = [$vector::splat($simd, 0.0).into(); 4];
        for j in 0..4 {
            c[j] = $vector::from_slice($simd, &$cells[$first + j].0).into();
        }
        let turned = $turn($simd, c);
        for i in 0..4 {
            $write!($simd, turned[i], $rows, $width, $first, i);
        }
    };
}

/// [`super::gather`] and [`super::scatter`] for one type of number.
macro_rules! both_ways {
    ($gather:ident, $scatter:ident, $cell:ty, $number:ty, $vector:ident, $lanes:literal, $mix:ident,
     $apart:ident, $together:ident, $columns:ident, $read:ident, $rows_of:ident, $write:ident) => {
        kernel!(
            pub(super) fn $gather(
                simd: Avx512,
                cells: &mut [$cell],
                rows: &[$number],
                width: usize,
                col: usize,
            ) {
                let n = cells.len();
                let rows = &rows[col..][..($lanes - 1) * width + n];
                if n == 3 && width == 3 {
                    let a = $vector::from_slice(simd, &rows[..$lanes]).into();
                    let b = $vector::from_slice(simd, &rows[$lanes..2 * $lanes]).into();
                    let c = $vector::from_slice(simd, &rows[2 * $lanes..3 * $lanes]).into();
                    for j in 0..3 {
                        let v = $mix(simd, a, b, c, &$apart[j]);
                        $vector::simd_from(simd, v).store_slice(&mut cells[j].0);
                    }
                } else if n == 1 && width == 1 {
                    cells[0].0.copy_from_slice(&rows[..$lanes]);
                } else if let (4, Some(rows), Some(cells)) =
                    (width, rows.first_chunk::<{ 4 * $lanes }>(), cells.first_chunk_mut::<4>())
                {
                    // Places that are known need no checks.
                    gather_block!(simd, cells, 0, rows, 4, $vector, $columns, $read);
                } else if n >= 4 {
                    let mut first = 0;
                    loop {
                        gather_block!(simd, cells, first, rows, width, $vector, $columns, $read);
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
            pub(super) fn $scatter(
                simd: Avx512,
                cells: &[$cell],
                rows: &mut [$number],
                width: usize,
                col: usize,
            ) {
                let n = cells.len();
                let rows = &mut rows[col..][..($lanes - 1) * width + n];
                if n == 3 && width == 3 {
                    let a = $vector::from_slice(simd, &cells[0].0).into();
                    let b = $vector::from_slice(simd, &cells[1].0).into();
                    let c = $vector::from_slice(simd, &cells[2].0).into();
                    for m in 0..3 {
                        let v = $mix(simd, a, b, c, &$together[m]);
                        $vector::simd_from(simd, v).store_slice(&mut rows[$lanes * m..][..$lanes]);
                    }
                } else if n == 1 && width == 1 {
                    rows[..$lanes].copy_from_slice(&cells[0].0);
                } else if let (4, Some(rows), Some(cells)) =
                    (width, rows.first_chunk_mut::<{ 4 * $lanes }>(), cells.first_chunk::<4>())
                {
                    scatter_block!(simd, cells, 0, rows, 4, $vector, $rows_of, $write);
                } else if n >= 4 {
                    let mut first = 0;
                    loop {
                        scatter_block!(simd, cells, first, rows, width, $vector, $rows_of, $write);
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
    gather_f32, scatter_f32, F32x16, f32, f32x16, 16, mix_f32,
    APART_F32, TOGETHER_F32, turn_f32, read_f32, turn_f32, write_f32
}
both_ways! {
    gather_f64, scatter_f64, F64x8, f64, f64x8, 8, mix_f64,
    APART_F64, TOGETHER_F64, columns_f64, read_f64, rows_f64, write_f64
}
