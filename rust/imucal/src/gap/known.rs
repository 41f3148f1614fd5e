//! Sums of products of columns and residuals, group by group: of a model's columns, and with others beside them.

use std::borrow::Cow;
use std::ops::Range;

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef};

use super::evidence::Gram;
use crate::stats::dot;
use crate::workers::{in_order, processors};

/// A model's columns and residuals in groups of rows, with their sums.
pub(crate) struct Known<'a> {
    groups: Vec<(Rows, Part<'a>, Vec<f64>)>,
    gram: &'a Gram,
}

/// Columns that come beside known ones, in the same groups of rows.
pub(crate) struct Others<'a> {
    /// Of each group its part of them, and the sums of their own products.
    parts: Vec<(Part<'a>, Mat<f64>)>,
    width: usize,
}

/// The rows of a group, as runs without gaps.
struct Rows {
    group: usize,
    runs: Vec<Range<usize>>,
}

/// The columns of a group: these rows of a matrix.
struct Part<'a> {
    columns: Cow<'a, Mat<f64>>,
    rows: Range<usize>,
}

impl Gram {
    /// The sums of columns, of which the last one is the residual.
    pub(crate) fn of(columns: &Mat<f64>, group_of_row: &[usize]) -> Self {
        let groups = Rows::of_groups(group_of_row);
        Self {
            sums: groups.iter().map(|rows| square(rows.part(columns).view(), processors())).collect(),
            rows: groups.iter().map(|rows| rows.count() as f64).collect(),
            groups: groups.iter().map(|rows| rows.group).collect(),
            residual: columns.ncols() - 1,
        }
    }

    /// Those of the same columns with another residual.
    pub(crate) fn with_residual(&self, columns: &Mat<f64>, residual: &[f64], group_of_row: &[usize]) -> Self {
        let mut all = self.clone();
        for (rows, sum) in Rows::of_groups(group_of_row).iter().zip(&mut all.sums) {
            rows.part(columns).put_residual(&rows.values(residual), self.residual, sum);
        }
        all
    }
}

impl<'a> Known<'a> {
    /// `gram` are the sums of these columns and residuals.
    pub(crate) fn new(columns: &'a Mat<f64>, residual: &[f64], group_of_row: &[usize], gram: &'a Gram) -> Self {
        let of_group = |rows: Rows| {
            let (part, residual) = (rows.part(columns), rows.values(residual));
            (rows, part, residual)
        };
        Self { groups: Rows::of_groups(group_of_row).into_iter().map(of_group).collect(), gram }
    }

    /// Other columns of the same rows.
    pub(crate) fn others<'b>(&self, columns: &'b Mat<f64>) -> Others<'b> {
        let width = columns.ncols();
        let of_group = |(rows, ..): &(Rows, Part<'_>, Vec<f64>)| {
            let part = rows.part(columns);
            // One thread for each hypothesis.
            let own = square(part.view(), 1);
            (part, own)
        };
        Others { parts: self.groups.iter().map(of_group).collect(), width }
    }

    /// The sums with other columns, which come before the residual.
    pub(crate) fn with(&self, others: &Others<'_>) -> Gram {
        let (known, width) = (self.gram.residual, others.width);
        let last = known + width;
        let joined = |(group, (part, own)): (usize, &(Part<'_>, Mat<f64>))| {
            let ((_, columns, residual), sum) = (&self.groups[group], &self.gram.sums[group]);
            let cross = columns.view().transpose() * part.view();
            let mut all = Mat::zeros(last + 1, last + 1);
            for i in 0..=known {
                let to = all.col_as_slice_mut(if i < known { i } else { last });
                to[..known].copy_from_slice(&sum.col_as_slice(i)[..known]);
                to[last] = sum[(known, i)];
            }
            for j in 0..width {
                let to = all.col_as_slice_mut(known + j);
                to[..known].copy_from_slice(cross.col_as_slice(j));
                to[known..last].copy_from_slice(own.col_as_slice(j));
                to[last] = dot(part.column(j), residual);
            }
            all.as_mut().submatrix_mut(known, 0, width, known).copy_from(cross.transpose());
            (known..last).for_each(|j| all[(j, last)] = all[(last, j)]);
            all
        };
        Gram {
            sums: others.parts.iter().enumerate().map(joined).collect(),
            rows: self.gram.rows.clone(),
            groups: self.gram.groups.clone(),
            residual: last,
        }
    }
}

impl Rows {
    /// Of all groups that have any.
    fn of_groups(group_of_row: &[usize]) -> Vec<Self> {
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

    fn values(&self, column: &[f64]) -> Vec<f64> {
        self.runs.iter().flat_map(|run| &column[run.clone()]).copied().collect()
    }

    /// These rows of a matrix; they are copied only where there are gaps.
    fn part<'m>(&self, columns: &'m Mat<f64>) -> Part<'m> {
        if let [run] = self.runs.as_slice() {
            return Part { columns: Cow::Borrowed(columns), rows: run.clone() };
        }
        let mut part = Mat::zeros(self.count(), columns.ncols());
        for j in 0..columns.ncols() {
            let from = columns.col_as_slice(j);
            let values = self.runs.iter().flat_map(|run| &from[run.clone()]);
            part.col_as_slice_mut(j).iter_mut().zip(values).for_each(|(to, value)| *to = *value);
        }
        Part { rows: 0..part.nrows(), columns: Cow::Owned(part) }
    }
}

impl Part<'_> {
    fn view(&self) -> MatRef<'_, f64> {
        self.columns.subrows(self.rows.start, self.rows.len())
    }

    fn column(&self, j: usize) -> &[f64] {
        &self.columns.col_as_slice(j)[self.rows.clone()]
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

/// `A^T A`: one half of it is made, the other is the same.
fn square(a: MatRef<'_, f64>, threads: usize) -> Mat<f64> {
    let of_part = |part: usize| {
        let first = part * TOGETHER;
        lower_square(a.subrows(first, TOGETHER.min(a.nrows() - first)))
    };
    let mut sum = Mat::zeros(a.ncols(), a.ncols());
    in_order(threads, a.nrows().div_ceil(TOGETHER), of_part).into_iter().for_each(|part| sum += part);
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
