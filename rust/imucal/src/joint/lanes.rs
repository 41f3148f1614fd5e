//! Stores whitened residuals and their derivatives as a matrix, row by row. A row contains one residual and its
//! derivatives. A column contains the derivatives of all residuals with respect to one parameter.

use std::ops::Range;

use faer::Mat;

use super::pass::Pass;
use crate::numerics::aligned::{Aligned, WIDEST};

/// Matrix of derivatives, one column per parameter, stored row by row. The residual is the last column. Columns without
/// nonzero values are not stored.
#[derive(Clone)]
pub(crate) struct Lanes {
    /// For each column (parameter): its position within a row; `None` for a column that is zero. The last entry is the
    /// position of the residual.
    places: Vec<Option<usize>>,
    of_residual: usize,
    /// Number of stored values per row, including padding.
    width: usize,
    numbers: Aligned,
}

impl Lanes {
    /// Matrix of zeros with `rows` rows and `columns` columns, plus the column of the residual.
    pub(super) fn zeros(columns: usize, rows: usize) -> Self {
        let mut lanes = Self::at((0..columns).map(Some).collect(), columns);
        lanes.resize(rows);
        lanes
    }

    /// Matrix without rows, for the residuals inside a move. The columns of parameters that affect the rate are stored
    /// first, then the columns of parameters that affect the force.
    pub(super) fn inside(pass: &Pass) -> Self {
        let mut places = vec![None; pass.turn.len()];
        pass.changes.parameters().for_each(|(lane, column)| places[column] = Some(lane));
        Self::at(places, pass.changes.lanes())
    }

    /// Matrix without rows. The derivatives with respect to parameter k are stored at position `places[k]` of a row,
    /// and the residual at position `of_residual`.
    fn at(mut places: Vec<Option<usize>>, of_residual: usize) -> Self {
        places.push(Some(of_residual));
        // The padding after the last column lets SIMD code read a full register from any position.
        let width = (of_residual + 1 + WIDEST).next_multiple_of(WIDEST);
        Self { places, of_residual, width, numbers: Aligned::default() }
    }

    /// Matrix for tests. `places` gives the position of each column within a row. The last entry of `places` is the
    /// position of the residual. `number(row, column)` returns the value of an entry.
    #[cfg(test)]
    pub(crate) fn of(places: &[Option<usize>], rows: usize, number: impl Fn(usize, usize) -> f64) -> Self {
        let (of_residual, places) = places.split_last().unwrap();
        let mut lanes = Self::at(places.to_vec(), of_residual.unwrap());
        lanes.resize(rows);
        for i in 0..rows {
            for column in 0..=places.len() {
                if let Some(place) = lanes.places[column] {
                    lanes.row_mut(i)[place] = number(i, column);
                }
            }
        }
        lanes
    }

    /// Number of stored values per row. It is a multiple of the SIMD register width.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.numbers.len() / self.width
    }

    /// All rows, one after the other.
    pub(crate) fn numbers(&self) -> &[f64] {
        &self.numbers
    }

    /// The stored values of one row.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> &[f64] {
        &self.numbers[row * self.width..][..self.width]
    }

    /// Mutable access to the stored values of consecutive rows.
    pub(super) fn rows_mut(&mut self, rows: Range<usize>) -> &mut [f64] {
        &mut self.numbers[rows.start * self.width..rows.end * self.width]
    }

    /// Mutable access to the stored values of one row.
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        self.rows_mut(row..row + 1)
    }

    /// Position of the column of one parameter within each row; `None` if the column is zero and therefore not stored.
    pub(crate) fn place(&self, column: usize) -> Option<usize> {
        self.places[column]
    }

    /// Values of one column (derivatives with respect to one parameter, or the residuals), from the first row to the
    /// last.
    pub(crate) fn column(&self, column: usize) -> impl Iterator<Item = f64> {
        let place = self.places[column];
        self.numbers.chunks_exact(self.width).map(move |row| place.map_or(0.0, |place| row[place]))
    }

    /// Copies the columns `order[0]`, `order[1]`, ... to the columns 0, 1, ... of a matrix, from row `first` on.
    pub(crate) fn copy_columns(&self, order: impl Iterator<Item = usize>, to: &mut Mat<f64>, first: usize) {
        for (j, column) in order.enumerate() {
            to.col_as_slice_mut(j)[first..].iter_mut().zip(self.column(column)).for_each(|(to, value)| *to = value);
        }
    }

    /// Adds `J change` to the residuals, where J is the matrix of the derivatives and `change` a change of the
    /// parameters.
    pub(crate) fn change(&mut self, change: &[f64]) {
        let by: Vec<(usize, f64)> = self.places.iter().zip(change).filter_map(|(p, by)| Some(((*p)?, *by))).collect();
        for row in self.numbers.chunks_exact_mut(self.width) {
            row[self.of_residual] += by.iter().map(|(place, by)| row[*place] * by).sum::<f64>();
        }
    }

    /// Sets the number of rows. The caller must overwrite all values.
    pub(crate) fn resize(&mut self, rows: usize) {
        self.numbers.resize(rows * self.width);
    }
}
