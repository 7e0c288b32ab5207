//! Height field: a grid of heights with a pyramid of least and greatest heights over blocks of 2ⁿ × 2ⁿ cells. The pyramid takes eight
//! bytes for a cell and a third more for all coarser levels, where a tree over triangles would take some sixty.

/// A height field with its pyramid.
#[derive(Debug)]
pub(crate) struct Hfield {
    pub n_row: usize,
    pub n_col: usize,
    /// Half size in x and y, top and depth of the base, m.
    pub size: [f64; 4],
    /// Places of the columns and rows, m.
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    /// Heights, m, (row, column).
    pub z: Vec<f64>,
    pub levels: Vec<Level>,
}

/// Least and greatest height of blocks of cells.
#[derive(Debug)]
pub(crate) struct Level {
    pub rows: usize,
    pub cols: usize,
    pub range: Vec<[f32; 2]>,
}

/// Blocks that wait in a walk down the pyramid: at most three for each level, and one; enough for 2²⁰ cells in a row.
pub(crate) const STACK: usize = 64;

impl Hfield {
    /// `size`: half sizes, height of 1, depth of the base. None for a grid without cells.
    pub fn new(n_row: usize, n_col: usize, size: [f64; 4], data: &[f32]) -> Option<Self> {
        if n_row < 2 || n_col < 2 || data.len() != n_row * n_col {
            return None;
        }
        let (dx, dy) = (2.0 * size[0] / (n_col - 1) as f64, 2.0 * size[1] / (n_row - 1) as f64);
        let x: Vec<f64> = (0..n_col).map(|c| dx * c as f64 - size[0]).collect();
        let y: Vec<f64> = (0..n_row).map(|r| dy * r as f64 - size[1]).collect();
        let z: Vec<f64> = data.iter().map(|h| f64::from(*h) * size[2]).collect();
        let mut range = Vec::with_capacity((n_row - 1) * (n_col - 1));
        for r in 0..n_row - 1 {
            for c in 0..n_col - 1 {
                let k = r * n_col + c;
                let four = [z[k], z[k + 1], z[k + n_col], z[k + n_col + 1]];
                let lo = four.iter().fold(f64::INFINITY, |a, h| a.min(*h)) as f32;
                let hi = four.iter().fold(f64::NEG_INFINITY, |a, h| a.max(*h)) as f32;
                range.push([lo.next_down(), hi.next_up()]);
            }
        }
        let mut levels = vec![Level { rows: n_row - 1, cols: n_col - 1, range }];
        loop {
            let below = &levels[levels.len() - 1];
            if below.rows == 1 && below.cols == 1 {
                break;
            }
            let (rows, cols) = (below.rows.div_ceil(2), below.cols.div_ceil(2));
            let mut range = vec![[f32::INFINITY, f32::NEG_INFINITY]; rows * cols];
            for r in 0..below.rows {
                for c in 0..below.cols {
                    let from = below.range[r * below.cols + c];
                    let to = &mut range[(r / 2) * cols + c / 2];
                    *to = [to[0].min(from[0]), to[1].max(from[1])];
                }
            }
            levels.push(Level { rows, cols, range });
        }
        Some(Self { n_row, n_col, size, x, y, z, levels })
    }
}
