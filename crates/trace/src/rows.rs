//! Numbers of rows in memory brought into lanes, one row to each lane, and back: the transposition that every call of a simulation
//! begins and ends with.
//!
//! With AVX-512 and AVX2 whole registers are shuffled, a third of the instructions of copying number by number; other processors copy.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

use fearless_simd::Level;

use super::lanes::{Cell, F32x16, F64x8};

/// Fills lanes with columns of the first rows of an array, one row to each lane, number by number.
pub(super) fn gather<C: Cell>(cells: &mut [C], rows: &[C::Number], width: usize, col: usize) {
    // Whole rows of the commonest widths need no check for each number.
    match (width, cells.len()) {
        (1, 1) => gather_rows::<C, 1>(cells, rows),
        (3, 3) => gather_rows::<C, 3>(cells, rows),
        (4, 4) => gather_rows::<C, 4>(cells, rows),
        _ => {
            let rows = &rows[col..][..(C::LANES - 1) * width + cells.len()];
            for (i, cell) in cells.iter_mut().enumerate() {
                cell.fill(0, |lane| rows[lane * width + i]);
            }
        }
    }
}

#[inline(always)]
fn gather_rows<C: Cell, const W: usize>(cells: &mut [C], rows: &[C::Number]) {
    let rows = &rows.as_chunks::<W>().0[..C::LANES];
    let Some(cells) = cells.first_chunk_mut::<W>() else { return };
    for (lane, row) in rows.iter().enumerate() {
        for (cell, v) in cells.iter_mut().zip(row) {
            cell.set(lane, *v);
        }
    }
}

/// Writes lanes to columns of the first rows of an array, one row from each lane, number by number.
pub(super) fn scatter<C: Cell>(cells: &[C], rows: &mut [C::Number], width: usize, col: usize) {
    match (width, cells.len()) {
        (1, 1) => scatter_rows::<C, 1>(cells, rows),
        (3, 3) => scatter_rows::<C, 3>(cells, rows),
        (4, 4) => scatter_rows::<C, 4>(cells, rows),
        _ => {
            let rows = &mut rows[col..][..(C::LANES - 1) * width + cells.len()];
            for (i, cell) in cells.iter().enumerate() {
                cell.drain(0, |lane, v| rows[lane * width + i] = v);
            }
        }
    }
}

#[inline(always)]
fn scatter_rows<C: Cell, const W: usize>(cells: &[C], rows: &mut [C::Number]) {
    let rows = &mut rows.as_chunks_mut::<W>().0[..C::LANES];
    let Some(cells) = cells.first_chunk::<W>() else { return };
    for (lane, row) in rows.iter_mut().enumerate() {
        *row = core::array::from_fn(|j| cells[j].get(lane));
    }
}

/// [`gather`] and [`scatter`] with the instructions of a level.
macro_rules! at_level {
    ($gather:ident, $scatter:ident, $cell:ty, $number:ty) => {
        #[inline(always)]
        pub(super) fn $gather(level: Level, cells: &mut [$cell], rows: &[$number], width: usize, col: usize) {
            #[cfg(target_arch = "x86_64")]
            match (level.as_avx512(), level.as_avx2()) {
                (Some(simd), _) => return avx512::$gather(simd, cells, rows, width, col),
                (None, Some(simd)) => return avx2::$gather(simd, cells, rows, width, col),
                (None, None) => {}
            }
            let _ = level;
            gather(cells, rows, width, col);
        }

        #[inline(always)]
        pub(super) fn $scatter(
            level: Level,
            cells: &[$cell],
            rows: &mut [$number],
            width: usize,
            col: usize,
        ) {
            #[cfg(target_arch = "x86_64")]
            match (level.as_avx512(), level.as_avx2()) {
                (Some(simd), _) => return avx512::$scatter(simd, cells, rows, width, col),
                (None, Some(simd)) => return avx2::$scatter(simd, cells, rows, width, col),
                (None, None) => {}
            }
            let _ = level;
            scatter(cells, rows, width, col);
        }
    };
}
at_level!(gather_f32, scatter_f32, F32x16, f32);
at_level!(gather_f64, scatter_f64, F64x8, f64);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Number, level};

    /// Columns of rows of any width go to lanes and back, and nothing beside them changes.
    fn go_and_come_back<N: Number>(level: Level) {
        let lanes = N::Cell::LANES;
        for width in 1..=12 {
            for (col, n) in (0..width).flat_map(|col| (1..=width - col).map(move |n| (col, n))) {
                let rows: Vec<N> = (0..lanes * width).map(|i| N::of(i as f64)).collect();
                let mut cells = vec![N::Cell::splat(N::of(-1.0)); n];
                N::Cell::gather(level, &mut cells, &rows, width, col);
                let mut back = vec![N::of(-2.0); lanes * width];
                N::Cell::scatter(level, &cells, &mut back, width, col);
                for (i, (lane, k)) in
                    (0..lanes).flat_map(|lane| (0..width).map(move |k| (lane, k))).enumerate()
                {
                    let mine = (col..col + n).contains(&k);
                    assert_eq!(back[i].wide(), if mine { i as f64 } else { -2.0 }, "{width} {col} {n}");
                    if mine {
                        assert_eq!(cells[k - col].get(lane).wide(), i as f64, "{width} {col} {n}");
                    }
                }
            }
        }
    }

    #[test]
    fn numbers_go_to_lanes_and_come_back() {
        let mut levels = vec![level(), Level::baseline()];
        #[cfg(target_arch = "x86_64")]
        levels.extend(level().as_avx2().map(Level::Avx2));
        for level in levels {
            go_and_come_back::<f32>(level);
            go_and_come_back::<f64>(level);
        }
    }
}
