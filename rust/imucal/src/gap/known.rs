//! Sums of products of columns and residuals, group by group: of a model's columns, and with others beside them.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat};

use super::evidence::Gram;

/// Columns in groups of rows.
pub(crate) struct Known {
    groups: Vec<Group>,
}

struct Group {
    group: usize,
    rows: Vec<usize>,
    /// Their part of the columns, the residual last.
    columns: Mat<f64>,
    /// `[J r]^T [J r]`.
    sum: Mat<f64>,
}

/// Columns that come beside known ones, in the same groups of rows.
pub(crate) struct Others {
    /// Of each group its part of them, and the sums of their own products.
    parts: Vec<(Mat<f64>, Mat<f64>)>,
}

impl Known {
    pub(crate) fn new(columns: &Mat<f64>, residual: &[f64], group_of_row: &[usize]) -> Self {
        let count = group_of_row.iter().max().map_or(0, |last| last + 1);
        let of_group = |group: usize| {
            let rows: Vec<usize> = (0..group_of_row.len()).filter(|&row| group_of_row[row] == group).collect();
            let mut columns = part(columns, &rows, 1);
            let last = columns.ncols() - 1;
            columns.col_as_slice_mut(last).iter_mut().zip(&rows).for_each(|(to, &row)| *to = residual[row]);
            let sum = squared(&columns);
            (!rows.is_empty()).then_some(Group { group, rows, columns, sum })
        };
        Self { groups: (0..count).filter_map(of_group).collect() }
    }

    /// Other columns of the same rows.
    pub(crate) fn others(&self, columns: &Mat<f64>) -> Others {
        let of_group = |Group { rows, .. }: &Group| {
            let part = part(columns, rows, 0);
            let own = squared(&part);
            (part, own)
        };
        Others { parts: self.groups.iter().map(of_group).collect() }
    }

    /// The sums with other columns, which come before the residual.
    pub(crate) fn with(&self, others: &Others) -> Gram {
        let known = self.count();
        let width = others.parts.first().map_or(0, |(part, _)| part.ncols());
        let last = known + width;
        let joined = |(Group { columns, sum, .. }, (part, own)): (&Group, &(Mat<f64>, Mat<f64>))| {
            let cross = columns.transpose() * part;
            let mut all = Mat::zeros(last + 1, last + 1);
            for i in 0..=known {
                let to = all.col_as_slice_mut(if i < known { i } else { last });
                to[..known].copy_from_slice(&sum.col_as_slice(i)[..known]);
                to[known..last].iter_mut().enumerate().for_each(|(j, to)| *to = cross[(i, j)]);
                to[last] = sum[(known, i)];
            }
            for j in 0..width {
                let to = all.col_as_slice_mut(known + j);
                to[..known].copy_from_slice(&cross.col_as_slice(j)[..known]);
                to[known..last].copy_from_slice(own.col_as_slice(j));
                to[last] = cross[(known, j)];
            }
            all
        };
        let sums = self.groups.iter().zip(&others.parts).map(joined).collect();
        self.gram_of(sums, last)
    }

    /// The sums of these columns alone.
    pub(crate) fn gram(&self) -> Gram {
        self.gram_of(self.groups.iter().map(|known| known.sum.clone()).collect(), self.count())
    }

    /// How many columns there are beside the residual.
    fn count(&self) -> usize {
        self.groups.first().map_or(0, |known| known.sum.ncols().saturating_sub(1))
    }

    fn gram_of(&self, sums: Vec<Mat<f64>>, residual: usize) -> Gram {
        Gram {
            sums,
            rows: self.groups.iter().map(|known| known.rows.len() as f64).collect(),
            groups: self.groups.iter().map(|known| known.group).collect(),
            residual,
        }
    }
}

/// `A^T A`: one half of it is made, the other is the same.
fn squared(a: &Mat<f64>) -> Mat<f64> {
    use BlockStructure::{Rectangular, TriangularLower};
    let mut sum = Mat::zeros(a.ncols(), a.ncols());
    let parallelism = faer::get_global_parallelism();
    let transposed = a.transpose();
    triangular::matmul(
        &mut sum,
        TriangularLower,
        Accum::Replace,
        transposed,
        Rectangular,
        a,
        Rectangular,
        1.0,
        parallelism,
    );
    for j in 1..a.ncols() {
        for i in 0..j {
            sum[(i, j)] = sum[(j, i)];
        }
    }
    sum
}

/// Some rows of a matrix, with room for more columns.
fn part(columns: &Mat<f64>, rows: &[usize], more: usize) -> Mat<f64> {
    let mut part = Mat::zeros(rows.len(), columns.ncols() + more);
    for j in 0..columns.ncols() {
        let from = columns.col_as_slice(j);
        part.col_as_slice_mut(j).iter_mut().zip(rows).for_each(|(to, &row)| *to = from[row]);
    }
    part
}
