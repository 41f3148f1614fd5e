//! Computes the Gram matrices (products of Jacobian columns) of a model with additional columns, for example those of a
//! generic hypothesis (a variation of a bias or scale). There is one Gram matrix for each group (kind) of residuals.

use faer::Mat;

use super::evidence::Gram;
use super::products::{Part, Rows, cross, square};
use crate::numerics::stats::dot;

/// Jacobian columns and residuals of a design (a linearised model), divided into groups of residual rows, and the Gram
/// matrix of each group.
pub(crate) struct Known<'a> {
    /// For each group: the indices of its rows, the columns at these rows, and the residuals at these rows.
    groups: Vec<(Rows, Part<'a>, Vec<f64>)>,
    gram: &'a Gram,
}

/// Additional Jacobian columns of a design, for example those of a generic hypothesis, and their Gram matrices.
pub(crate) struct Others<'a> {
    /// For each group: the rows of the additional columns, and the Gram matrix of these columns.
    parts: Vec<(Part<'a>, Mat<f64>)>,
    width: usize,
}

impl<'a> Known<'a> {
    /// Divides the columns and the residual of a design into groups. `gram` contains the Gram matrices of the columns.
    pub(crate) fn new(columns: &'a Mat<f64>, residual: &[f64], group_of_row: &[usize], gram: &'a Gram) -> Self {
        let of_group = |rows: Rows| {
            let (part, residual) = (rows.part(columns), rows.values(residual));
            (rows, part, residual)
        };
        Self { groups: Rows::of_groups(group_of_row).into_iter().map(of_group).collect(), gram }
    }

    /// Divides additional columns into groups of rows, and computes the Gram matrix of each group.
    pub(crate) fn others<'b>(&self, columns: &'b Mat<f64>) -> Others<'b> {
        let width = columns.ncols();
        let of_group = |(rows, ..): &(Rows, Part<'_>, Vec<f64>)| {
            let part = rows.part(columns);
            // One thread is used here, because several hypotheses are evaluated in parallel.
            let own = square(part.view(), 1);
            (part, own)
        };
        Others { parts: self.groups.iter().map(of_group).collect(), width }
    }

    /// Gram matrices of the design with the additional columns. The additional columns are inserted before the
    /// residual, so that the residual stays the last column.
    pub(crate) fn with(&self, others: &Others<'_>) -> Gram {
        let (known, width) = (self.gram.residual, others.width);
        let last = known + width;
        let joined = |(group, (part, own)): (usize, &(Part<'_>, Mat<f64>))| {
            let ((_, columns, residual), sum) = (&self.groups[group], &self.gram.sums[group]);
            let cross = cross(columns.view(), part.view());
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
