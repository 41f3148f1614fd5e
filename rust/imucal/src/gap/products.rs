//! Computes Gram matrices (products of Jacobian columns), one for each group (kind) of residuals.

mod asked;
mod lanes;

use std::borrow::Cow;
use std::ops::Range;
use std::sync::OnceLock;

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef};

use super::evidence::Gram;
use crate::joint::{INSIDE, Insides, Lanes};
use crate::numerics::stats::dot;
use crate::numerics::workers::{in_order, processors};
use asked::Asked;

/// The indices of the rows of one group of residuals, as ranges of consecutive indices.
pub(super) struct Rows {
    group: usize,
    runs: Vec<Range<usize>>,
}

/// The Jacobian rows of one group of residuals: the range `rows` of the rows of the matrix `columns`.
pub(super) struct Part<'a> {
    columns: Cow<'a, Mat<f64>>,
    rows: Range<usize>,
}

impl Gram {
    /// Computes the Gram matrix of `columns` for each group of rows. The last column of `columns` is the residual.
    pub(crate) fn of(columns: &Mat<f64>, group_of_row: &[usize]) -> Self {
        let groups = Rows::of_groups(group_of_row);
        let sums = groups.iter().map(|rows| square(rows.part(columns).view(), processors())).collect();
        Self::of_groups(sums, &groups, columns.ncols() - 1)
    }

    /// Gram matrices with only the products that scoring needs: model column x any column, column x column within a
    /// block (the columns of one candidate effect at one trial time constant), and residual x any column. All other
    /// entries are NaN. In the Gram matrices, the model's columns come first, and the residual comes last. Each row of
    /// `rows` contains the value of column k at the position `order[k]`. The second result contains the residuals of
    /// the samples inside moves.
    pub(crate) fn beside(
        (rows, group_of_row): (&Lanes, &[usize]),
        insides: Option<&Insides>,
        order: &[usize],
        (model, blocks): (usize, &[Range<usize>]),
    ) -> (Self, Vec<f64>) {
        let residual = order.len() - 1;
        let (asked, groups) = (Asked::new(model, residual, blocks), Rows::of_groups(group_of_row));
        let mut all = Self::of_groups(lanes::of_groups(rows, &groups, order, &asked), &groups, residual);
        let Some(insides) = insides else { return (all, Vec::new()) };
        let (sum, residual) = lanes::of_insides(insides, order, &asked);
        all.sums.push(sum);
        all.rows.push(residual.len() as f64);
        all.groups.push(INSIDE);
        (all, residual)
    }

    fn of_groups(sums: Vec<Mat<f64>>, groups: &[Rows], residual: usize) -> Self {
        let rows = groups.iter().map(|rows| rows.count() as f64).collect();
        Self { sums, rows, groups: groups.iter().map(|rows| rows.group).collect(), residual }
    }

    /// Gram matrices A^T A, one for each group of rows in `self`. A contains the rows of the group in `columns` and
    /// `residual`. The products column x column are computed in the first call, stored in `products`, and reused in
    /// later calls. The products column x residual and residual x residual are computed in each call.
    pub(crate) fn with_residual(
        &self,
        products: &OnceLock<Vec<Mat<f64>>>,
        columns: &Mat<f64>,
        residual: &[f64],
        group_of_row: &[usize],
    ) -> Self {
        let groups = Rows::of_groups(group_of_row);
        let of_columns = |rows: &Rows| {
            let mut sum = square(rows.part(columns).view(), processors());
            sum.resize_with(columns.ncols() + 1, columns.ncols() + 1, |_, _| 0.0);
            sum
        };
        let mut sums = products.get_or_init(|| groups.iter().map(of_columns).collect()).clone();
        for (rows, sum) in groups.iter().zip(&mut sums) {
            rows.part(columns).put_residual(&rows.values(residual), self.residual, sum);
        }
        Self { sums, rows: self.rows.clone(), groups: self.groups.clone(), residual: self.residual }
    }
}

impl Rows {
    /// Row ranges of every group that has at least one row.
    pub(super) fn of_groups(group_of_row: &[usize]) -> Vec<Self> {
        let count = group_of_row.iter().max().map_or(0, |last| last + 1);
        let mut all: Vec<Self> = (0..count).map(|group| Self { group, runs: Vec::new() }).collect();
        for (row, &group) in group_of_row.iter().enumerate() {
            match all[group].runs.last_mut() {
                Some(run) if run.end == row => run.end += 1,
                _ => all[group].runs.push(row..row + 1),
            }
        }
        all.retain(|rows| !rows.runs.is_empty());
        all
    }

    fn count(&self) -> usize {
        self.runs.iter().map(Range::len).sum()
    }

    pub(super) fn values(&self, column: &[f64]) -> Vec<f64> {
        self.runs.iter().flat_map(|run| &column[run.clone()]).copied().collect()
    }

    /// The rows of this group in a matrix. The rows are copied only if the group has several ranges of rows.
    pub(super) fn part<'m>(&self, columns: &'m Mat<f64>) -> Part<'m> {
        if let [run] = self.runs.as_slice() {
            return Part { columns: Cow::Borrowed(columns), rows: run.clone() };
        }
        let rows: Vec<usize> = self.runs.iter().flat_map(Range::clone).collect();
        let mut part = Mat::zeros(rows.len(), columns.ncols());
        for j in 0..columns.ncols() {
            let from = columns.col_as_slice(j);
            part.col_as_slice_mut(j).iter_mut().zip(&rows).for_each(|(to, row)| *to = from[*row]);
        }
        Part { rows: 0..part.nrows(), columns: Cow::Owned(part) }
    }
}

impl Part<'_> {
    pub(super) fn view(&self) -> MatRef<'_, f64> {
        self.columns.subrows(self.rows.start, self.rows.len())
    }

    pub(super) fn column(&self, j: usize) -> &[f64] {
        &self.columns.col_as_slice(j)[self.rows.clone()]
    }

    /// Writes the products column x residual and residual x residual to row `place` and column `place` of a Gram
    /// matrix.
    fn put_residual(&self, residual: &[f64], place: usize, sum: &mut Mat<f64>) {
        for j in 0..self.columns.ncols() {
            let product = dot(self.column(j), residual);
            (sum[(j, place)], sum[(place, j)]) = (product, product);
        }
        sum[(place, place)] = dot(residual, residual);
    }
}

/// Number of rows in each partial sum of a Gram matrix. The number is fixed, so that rounding errors do not depend on
/// the number of threads.
const TOGETHER: usize = 2048;

/// Applies a function to consecutive parts of the rows. Returns the results in the order of the parts.
fn in_parts<R: Send>(threads: usize, rows: usize, work: impl Fn(Range<usize>) -> R + Sync) -> Vec<R> {
    let of_part = |part: usize| work(part * TOGETHER..rows.min((part + 1) * TOGETHER));
    in_order(threads, rows.div_ceil(TOGETHER), of_part)
}

/// Computes `A^T A`. The lower triangle is computed and then copied to the upper triangle.
pub(super) fn square(a: MatRef<'_, f64>, threads: usize) -> Mat<f64> {
    let mut sum = Mat::zeros(a.ncols(), a.ncols());
    let of_part = |rows: Range<usize>| lower_square(a.subrows(rows.start, rows.len()));
    in_parts(threads, a.nrows(), of_part).into_iter().for_each(|part| sum += part);
    for j in 1..a.ncols() {
        for i in 0..j {
            sum[(i, j)] = sum[(j, i)];
        }
    }
    sum
}

/// Computes `A^T B` on one thread.
pub(super) fn cross(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut sum = Mat::zeros(a.ncols(), b.ncols());
    let of_part =
        |rows: Range<usize>| a.subrows(rows.start, rows.len()).transpose() * b.subrows(rows.start, rows.len());
    in_parts(1, a.nrows(), of_part).into_iter().for_each(|part| sum += part);
    sum
}

fn lower_square(a: MatRef<'_, f64>) -> Mat<f64> {
    use BlockStructure::{Rectangular, TriangularLower};
    let mut sum = Mat::zeros(a.ncols(), a.ncols());
    let (to, alone) = (sum.as_mut(), faer::Par::Seq);
    triangular::matmul(to, TriangularLower, Accum::Replace, a.transpose(), Rectangular, a, Rectangular, 1.0, alone);
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_judging_takes_is_part_of_all_products() {
        let (rows, model, blocks) = (4500, 3, [3..4, 4..9, 9..12]);
        let columns = Mat::from_fn(rows, 13, |i, j| ((1 + i) as f64 * (0.3 + 0.17 * j as f64)).sin());
        let groups: Vec<usize> = (0..rows).map(|row| if row < 100 { row % 2 } else { 2 }).collect();
        let places: Vec<Option<usize>> = (0..13).map(Some).collect();
        let (lanes, order) = (Lanes::of(&places, rows, |i, j| columns[(i, j)]), Vec::from_iter(0..13));
        let all = Gram::of(&columns, &groups);
        let some = Gram::beside((&lanes, &groups), None, &order, (model, &blocks)).0;
        assert_eq!((&all.groups, &all.rows, all.residual), (&some.groups, &some.rows, some.residual));
        let block = |j: usize| blocks.iter().position(|block| block.contains(&j));
        for (all, some) in all.sums.iter().zip(&some.sums) {
            for (i, j) in (0..13).flat_map(|i| (0..13).map(move |j| (i, j))) {
                let is_there = i.min(j) < model || i.max(j) == 12 || block(i) == block(j);
                let difference = (all[(i, j)] - some[(i, j)]).abs();
                assert!(if is_there { difference < 1e-10 } else { difference.is_nan() }, "{i} {j}: {difference}");
            }
        }
    }
}
