//! The Gram matrix of a window, from the derivatives at its nodes.
//!
//! A row's derivatives are interpolated between two nodes, so the rows of one output are W A: A holds the derivatives at
//! the nodes, and the weights W are the same for all columns. Their Gram matrix is Aᵀ (WᵀW) A with a tridiagonal WᵀW,
//! however many samples there are. A channel's rows are zero in most columns (no rate depends on a position, no attitude
//! on a mass), which are left out of the product. What a late clock adds is one number per row.

use super::rows::{Row, Shifts};
use super::{CHANNELS, OUTPUTS, Slopes};
use nalgebra::{DMatrix, DVector};

/// The rows of a window, kept to tell what the fit leaves of them.
#[derive(Clone, Debug)]
pub(crate) struct Kept {
    pub nodes: Vec<Slopes>,
    pub rows: Vec<Row>,
    pub shifts: Shifts,
    /// JᵀJ of the nuisance parameters by the rows of each channel alone.
    pub own: [DMatrix<f64>; CHANNELS],
}

impl Kept {
    /// What is left of every row with all parameters moved by `by`: nuisance parameters first.
    pub fn left(&self, by: &[f64]) -> Vec<f64> {
        let told = |node: &Slopes| -> [f64; OUTPUTS] {
            core::array::from_fn(|o| node.row(o).iter().zip(by).map(|(slope, by)| slope * by).sum())
        };
        let told: Vec<[f64; OUTPUTS]> = self.nodes.iter().map(told).collect();
        let late = self.shifts.each_ref().map(|s| s.iter().map(|(c, f)| f * by[*c]).sum::<f64>());
        let one = |r: &Row| {
            let (a, b) = (told[r.node][r.output], told[r.node + 1][r.output]);
            r.residual - r.per * (a + r.share * (b - a)) - r.moving * late[r.output / 3]
        };
        self.rows.iter().map(one).collect()
    }
}

/// Weights of the nodes in the rows of one output.
struct Weights {
    /// WᵀW: the diagonal, and what stands beside it.
    diagonal: Vec<f64>,
    beside: Vec<f64>,
    /// Wᵀ of [`Row::moving`] and of [`Row::residual`].
    moving: Vec<f64>,
    residual: Vec<f64>,
}

impl Weights {
    fn of<'a>(rows: impl Iterator<Item = &'a Row>, nodes: usize) -> Self {
        let zero = || vec![0.0; nodes];
        let mut out = Self { diagonal: zero(), beside: zero(), moving: zero(), residual: zero() };
        for r in rows {
            let [a, b] = [r.per * (1.0 - r.share), r.per * r.share];
            out.diagonal[r.node] += a * a;
            out.diagonal[r.node + 1] += b * b;
            out.beside[r.node] += a * b;
            out.moving[r.node] += a * r.moving;
            out.moving[r.node + 1] += b * r.moving;
            out.residual[r.node] += a * r.residual;
            out.residual[r.node + 1] += b * r.residual;
        }
        out
    }

    /// Row `i` of WᵀW: the weights of the node before, of this one and of the next.
    fn row(&self, i: usize) -> [f64; 3] {
        let before = if i > 0 { self.beside[i - 1] } else { 0.0 };
        [before, self.diagonal[i], self.beside[i]]
    }
}

/// JᵀJ of [nuisance parameters | parameters | residual] over the rows, and that of the first `own` columns by channel.
pub(super) fn gram(
    nodes: &[Slopes],
    rows: &[Row],
    shifts: &Shifts,
    own: usize,
) -> (DMatrix<f64>, [DMatrix<f64>; CHANNELS]) {
    let width = nodes.first().map_or(0, |n| n.width);
    let mut out = DMatrix::zeros(width + 1, width + 1);
    let mut of_own = core::array::from_fn(|_| DMatrix::zeros(own, own));
    let mut from = 0;
    for channel in 0..CHANNELS {
        let n = rows[from..].iter().take_while(|r| r.output / 3 == channel).count();
        if n > 0 {
            let part = &rows[from..from + n];
            add(nodes, part, channel, &shifts[channel], &mut out, &mut of_own[channel]);
        }
        from += n;
    }
    out.fill_upper_triangle_with_lower_triangle();
    (out, of_own)
}

/// Adds the rows of one channel to the lower triangle of `out`, and JᵀJ of the first columns by them alone to `of_own`.
fn add(
    nodes: &[Slopes],
    rows: &[Row],
    channel: usize,
    shift: &[(usize, f64)],
    out: &mut DMatrix<f64>,
    of_own: &mut DMatrix<f64>,
) {
    let width = nodes[0].width;
    let outputs = 3 * channel..3 * channel + 3;
    let weights: Vec<Weights> =
        outputs.clone().map(|o| Weights::of(rows.iter().filter(|r| r.output == o), nodes.len())).collect();
    let active = active(nodes, outputs.clone());
    let (m, k) = (active.len(), 3 * nodes.len());
    // A in the active columns, one node's output after the other, and WᵀW A transposed.
    let mut slopes = DMatrix::zeros(m, k);
    let mut weighed = DMatrix::zeros(k, m);
    let (mut by_moving, mut by_residual) = (DVector::zeros(m), DVector::zeros(m));
    for (part, (o, w)) in outputs.zip(&weights).enumerate() {
        let first = part * nodes.len();
        for (i, node) in nodes.iter().enumerate() {
            let row = node.row(o);
            let mut column = slopes.column_mut(first + i);
            active.iter().zip(column.iter_mut()).for_each(|(c, x)| *x = row[*c]);
            by_moving.axpy(w.moving[i], &column, 1.0);
            by_residual.axpy(w.residual[i], &column, 1.0);
        }
        for i in 0..nodes.len() {
            let [before, here, after] = w.row(i);
            let of = |i: usize| slopes.column(first + i);
            let (a, b, c) = (of(i.saturating_sub(1)), of(i), of((i + 1).min(nodes.len() - 1)));
            for (j, x) in weighed.row_mut(first + i).iter_mut().enumerate() {
                *x = before * a[j] + here * b[j] + after * c[j];
            }
        }
    }
    let product = &slopes * &weighed;
    let own = active.partition_point(|c| *c < of_own.nrows());
    for (j, b) in active.iter().enumerate() {
        let column = &product.as_slice()[j * m..(j + 1) * m];
        let sums = &mut out.as_mut_slice()[b * (width + 1)..(b + 1) * (width + 1)];
        active[j..].iter().zip(&column[j..]).for_each(|(a, x)| sums[*a] += x);
        if j < own {
            active[..own].iter().zip(column).for_each(|(a, x)| of_own[(*a, *b)] = *x);
        }
    }
    let sum = |f: &dyn Fn(&Row) -> f64| rows.iter().map(f).sum::<f64>();
    let moves = sum(&|r| r.moving * r.moving);
    let along = sum(&|r| r.moving * r.residual);
    // A sum x + xᵀ: twice x where both columns are the same.
    let mut both = |a: usize, b: usize, x: f64| out[(a.max(b), a.min(b))] += if a == b { 2.0 * x } else { x };
    for (i, c) in active.iter().enumerate() {
        both(*c, width, by_residual[i]);
        shift.iter().for_each(|(s, f)| both(*c, *s, f * by_moving[i]));
    }
    for (s, f) in shift {
        both(*s, width, f * along);
        // Each pair comes twice, once from either side.
        shift.iter().for_each(|(t, g)| both(*s, *t, 0.5 * f * g * moves));
    }
    out[(width, width)] += sum(&|r| r.residual * r.residual);
}

/// Columns in which some of the outputs have a derivative at some node.
fn active(nodes: &[Slopes], outputs: core::ops::Range<usize>) -> Vec<usize> {
    let mut largest = vec![0.0f64; nodes[0].width];
    for node in nodes {
        for o in outputs.clone() {
            // Not a number is no zero either.
            largest.iter_mut().zip(node.row(o)).for_each(|(l, x)| *l += x.abs());
        }
    }
    (0..largest.len()).filter(|c| largest[*c] != 0.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_rollout::random::{Key, purpose};

    const NODES: usize = 5;
    const OWN: usize = 4;
    const WIDTH: usize = 9;

    /// Nodes with columns that do not concern every channel, and rows of all channels at irregular places.
    fn window() -> (Vec<Slopes>, Vec<Row>, Shifts) {
        let key = Key { seed: 3, world: 0, drone: 0, step: 0, purpose: purpose("gram test") };
        let mut dice = key.stream();
        let mut nodes = vec![Slopes::zero(WIDTH); NODES];
        for node in &mut nodes {
            for o in 0..OUTPUTS {
                for c in 0..WIDTH {
                    if (o / 3 + c) % 3 != 0 {
                        node.row_mut(o)[c] = dice.normal();
                    }
                }
            }
        }
        let mut rows = Vec::new();
        for channel in 0..CHANNELS {
            // One channel is sparse: some of its nodes have no row.
            for i in 0..[7, 1, 40, 13][channel] {
                for output in 3 * channel..3 * channel + 3 {
                    rows.push(Row {
                        node: (3 * i + channel) % (NODES - 1),
                        share: (0.37 * i as f64).fract(),
                        output,
                        per: 2.0 + dice.normal().abs(),
                        moving: dice.normal(),
                        residual: dice.normal(),
                    });
                }
            }
        }
        (nodes, rows, [vec![(5, 1.0)], vec![], vec![(5, 1.0), (7, -1.0)], vec![(8, -1.0)]])
    }

    /// The rows written out: derivatives by all columns, then the residual.
    fn written_out(nodes: &[Slopes], rows: &[Row], shifts: &Shifts) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(rows.len(), WIDTH + 1);
        for (i, r) in rows.iter().enumerate() {
            let (a, b) = (nodes[r.node].row(r.output), nodes[r.node + 1].row(r.output));
            for c in 0..WIDTH {
                out[(i, c)] = r.per * (a[c] + r.share * (b[c] - a[c]));
            }
            shifts[r.output / 3].iter().for_each(|(c, f)| out[(i, *c)] += f * r.moving);
            out[(i, WIDTH)] = r.residual;
        }
        out
    }

    #[test]
    fn the_matrix_is_that_of_the_rows_written_out() {
        let (nodes, rows, shifts) = window();
        let all = written_out(&nodes, &rows, &shifts);
        let (sum, of_own) = gram(&nodes, &rows, &shifts, OWN);
        assert!((&sum - all.tr_mul(&all)).amax() < 1e-11 * sum.amax());
        assert_eq!(sum, sum.transpose());
        for (channel, own) in of_own.iter().enumerate() {
            let of = |i: &usize| rows[*i].output / 3 == channel;
            let part: Vec<usize> = (0..rows.len()).filter(of).collect();
            let part = all.select_rows(&part).columns(0, OWN).into_owned();
            assert!((own - part.tr_mul(&part)).amax() < 1e-11 * sum.amax(), "{channel}");
        }
    }

    #[test]
    fn what_is_left_of_kept_rows_is_that_of_the_rows_written_out() {
        let (nodes, rows, shifts) = window();
        let all = written_out(&nodes, &rows, &shifts);
        let by: Vec<f64> = (0..WIDTH).map(|c| 0.3 * c as f64 - 1.0).collect();
        let told = all.columns(0, WIDTH) * DVector::from_column_slice(&by);
        let kept = Kept { nodes, rows, shifts, own: core::array::from_fn(|_| DMatrix::zeros(0, 0)) };
        for (i, left) in kept.left(&by).into_iter().enumerate() {
            assert!((left - (all[(i, WIDTH)] - told[i])).abs() < 1e-12, "{i}");
        }
    }

    #[test]
    fn a_derivative_that_overflows_is_not_taken_for_zero() {
        let (mut nodes, rows, shifts) = window();
        nodes[1].row_mut(0)[1] = f64::NAN;
        assert!(!gram(&nodes, &rows, &shifts, OWN).0.iter().all(|x| x.is_finite()));
    }
}
