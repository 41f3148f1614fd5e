//! Sums of products of columns, group by group of their rows.

mod asked;
mod lanes;

use std::borrow::Cow;
use std::ops::{AddAssign, Range};
use std::sync::OnceLock;

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef};
use pulp::{Arch, Simd, WithSimd};

use super::evidence::Gram;
use crate::joint::{INSIDE, Insides};
use crate::stats::dot;
use crate::workers::{in_order, processors};
use asked::Asked;

/// The rows of a group, as runs without gaps.
pub(super) struct Rows {
    group: usize,
    runs: Vec<Range<usize>>,
}

/// The columns of a group: these rows of a matrix.
pub(super) struct Part<'a> {
    columns: Cow<'a, Mat<f64>>,
    rows: Range<usize>,
}

impl Gram {
    /// The sums of columns, of which the last one is the residual.
    pub(crate) fn of(columns: &Mat<f64>, group_of_row: &[usize]) -> Self {
        Self::from(columns, group_of_row, |part| square(part.view(), processors()))
    }

    /// Those of a model of the first columns with one at a time of the blocks of others, which is all that judging these takes. What
    /// nobody may ask for is no number. Of what is inside the moves `order` are the same columns there; its residual comes along.
    pub(crate) fn beside(
        (columns, group_of_row): (&Mat<f64>, &[usize]),
        inside: Option<(&Insides, &[usize])>,
        model: usize,
        blocks: &[Range<usize>],
    ) -> (Self, Vec<f64>) {
        let asked = Asked::new(model, columns.ncols() - 1, blocks);
        let mut all = Self::from(columns, group_of_row, |part| part.products(&asked));
        let Some((insides, order)) = inside else { return (all, Vec::new()) };
        let (sum, residual) = lanes::products(insides, order, &asked);
        all.sums.push(sum);
        all.rows.push(residual.len() as f64);
        all.groups.push(INSIDE);
        (all, residual)
    }

    fn from(columns: &Mat<f64>, group_of_row: &[usize], sum: impl Fn(&Part<'_>) -> Mat<f64>) -> Self {
        let groups = Rows::of_groups(group_of_row);
        Self {
            sums: groups.iter().map(|rows| sum(&rows.part(columns))).collect(),
            rows: groups.iter().map(|rows| rows.count() as f64).collect(),
            groups: groups.iter().map(|rows| rows.group).collect(),
            residual: columns.ncols() - 1,
        }
    }

    /// Those of the same groups with the products of all columns, which are asked for the first time, and a residual.
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
    /// Of all groups that have any.
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

    /// These rows of a matrix; they are copied only where there are gaps.
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

    /// Those of its columns, of which the last one is the residual.
    fn products(&self, asked: &Asked<'_>) -> Mat<f64> {
        let (view, pairs) = (self.view(), &asked.pairs);
        let of_part = |rows: Range<usize>| {
            let mut of_model = Mat::zeros(asked.last + 1, asked.model);
            let part = view.subrows(rows.start, rows.len());
            let model = part.subcols(0, asked.model);
            matmul(&mut of_model, Accum::Replace, part.transpose(), model, 1.0, faer::Par::Seq);
            (of_model, Arch::new().dispatch(Dots { part: self, rows, pairs }))
        };
        let mut sum = asked.nothing_yet();
        for (of_model, dots) in in_parts(processors(), self.rows.len(), of_part) {
            sum.as_mut().subcols_mut(0, asked.model).add_assign(&of_model);
            let places = pairs.iter().flat_map(|(i, others)| others.iter().map(|j| (*i, *j)));
            places.zip(dots).for_each(|(place, dot)| sum[place] += dot);
        }
        asked.mirror(&mut sum);
        sum
    }

    /// Puts the products with a residual, which has this place, into the sums.
    fn put_residual(&self, residual: &[f64], place: usize, sum: &mut Mat<f64>) {
        for j in 0..self.columns.ncols() {
            let product = dot(self.column(j), residual);
            (sum[(j, place)], sum[(place, j)]) = (product, product);
        }
        sum[(place, place)] = dot(residual, residual);
    }
}

/// Rows whose products are summed at once: so many whatever the number of threads, for the sum is not to depend on that.
const TOGETHER: usize = 2048;

/// What is made of so many rows, part by part in their order.
fn in_parts<R: Send>(threads: usize, rows: usize, work: impl Fn(Range<usize>) -> R + Sync) -> Vec<R> {
    let of_part = |part: usize| work(part * TOGETHER..rows.min((part + 1) * TOGETHER));
    in_order(threads, rows.div_ceil(TOGETHER), of_part)
}

/// `A^T A`: one half of it is made, the other is the same.
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

fn lower_square(a: MatRef<'_, f64>) -> Mat<f64> {
    use BlockStructure::{Rectangular, TriangularLower};
    let mut sum = Mat::zeros(a.ncols(), a.ncols());
    let (to, alone) = (sum.as_mut(), faer::Par::Seq);
    triangular::matmul(to, TriangularLower, Accum::Replace, a.transpose(), Rectangular, a, Rectangular, 1.0, alone);
    sum
}

/// Columns that are multiplied by one at a time: what is loaded of that serves all.
const AT_ONCE: usize = 4;

/// Products of columns with others in some rows.
struct Dots<'a> {
    part: &'a Part<'a>,
    rows: Range<usize>,
    pairs: &'a [(usize, Vec<usize>)],
}

impl WithSimd for Dots<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let Self { part, rows, pairs } = self;
        let mut dots = Vec::new();
        for (own, others) in pairs {
            let (own, own_rest) = S::as_simd_f64s(&part.column(*own)[rows.clone()]);
            for others in others.chunks(AT_ONCE) {
                let mut sums = [simd.splat_f64s(0.0); AT_ONCE];
                // What is too many is summed for nothing.
                let mut columns = [S::as_simd_f64s(&part.column(others[0])[rows.clone()]); AT_ONCE];
                for (column, other) in columns.iter_mut().zip(others) {
                    *column = S::as_simd_f64s(&part.column(*other)[rows.clone()]);
                }
                let [(a, _), (b, _), (c, _), (d, _)] = columns;
                for ((((own, a), b), c), d) in own.iter().zip(a).zip(b).zip(c).zip(d) {
                    sums[0] = simd.mul_add_e_f64s(*own, *a, sums[0]);
                    sums[1] = simd.mul_add_e_f64s(*own, *b, sums[1]);
                    sums[2] = simd.mul_add_e_f64s(*own, *c, sums[2]);
                    sums[3] = simd.mul_add_e_f64s(*own, *d, sums[3]);
                }
                for (sum, (_, rest)) in sums.into_iter().zip(columns).take(others.len()) {
                    dots.push(simd.reduce_sum_f64s(sum) + dot(own_rest, rest));
                }
            }
        }
        dots
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_judging_takes_is_part_of_all_products() {
        let (rows, model, blocks) = (4500, 3, [3..4, 4..9, 9..12]);
        let columns = Mat::from_fn(rows, 13, |i, j| ((1 + i) as f64 * (0.3 + 0.17 * j as f64)).sin());
        let groups: Vec<usize> = (0..rows).map(|row| if row < 100 { row % 2 } else { 2 }).collect();
        let (all, some) = (Gram::of(&columns, &groups), Gram::beside((&columns, &groups), None, model, &blocks).0);
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
