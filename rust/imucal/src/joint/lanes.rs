//! White residuals and their derivatives, row by row.

use std::ops::Range;

use faer::Mat;

use super::pass::Pass;
use crate::numerics::aligned::{Aligned, WIDEST};

/// Rows of numbers side by side: derivatives, and the residual behind them.
#[derive(Clone)]
pub(crate) struct Lanes {
    /// The place of each column, the last of which is the residual's; `None` where it is zero.
    places: Vec<Option<usize>>,
    of_residual: usize,
    /// Length of a row.
    width: usize,
    numbers: Aligned,
}

impl Lanes {
    /// Rows of zeros, so many, with so many columns beside the residual.
    pub(super) fn zeros(columns: usize, rows: usize) -> Self {
        let mut lanes = Self::at((0..columns).map(Some).collect(), columns);
        lanes.resize(rows);
        lanes
    }

    /// No row yet, with the columns that are seen inside a move: what acts on the rate, and then what acts on the force.
    pub(super) fn inside(pass: &Pass) -> Self {
        let mut places = vec![None; pass.turn.len()];
        pass.changes.parameters().for_each(|(lane, column)| places[column] = Some(lane));
        Self::at(places, pass.changes.lanes())
    }

    /// No row yet; the columns have these places, and the residual its own behind them.
    fn at(mut places: Vec<Option<usize>>, of_residual: usize) -> Self {
        places.push(Some(of_residual));
        // There is room for a register behind each place.
        let width = (of_residual + 1 + WIDEST).next_multiple_of(WIDEST);
        Self { places, of_residual, width, numbers: Aligned::default() }
    }

    /// Of columns that have these places, and the residual the last; each number is that of a row and a column.
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

    /// Length of a row, that of some registers.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// How many rows there are.
    pub(crate) fn rows(&self) -> usize {
        self.numbers.len() / self.width
    }

    /// All rows, one after the other.
    pub(crate) fn numbers(&self) -> &[f64] {
        &self.numbers
    }

    /// One of the rows.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> &[f64] {
        &self.numbers[row * self.width..][..self.width]
    }

    /// Some of the rows, one after the other, to be set.
    pub(super) fn rows_mut(&mut self, rows: Range<usize>) -> &mut [f64] {
        &mut self.numbers[rows.start * self.width..rows.end * self.width]
    }

    /// One of the rows, to be set.
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        self.rows_mut(row..row + 1)
    }

    /// Where a column stands in each row; `None` if it is zero.
    pub(crate) fn place(&self, column: usize) -> Option<usize> {
        self.places[column]
    }

    /// A column, row by row.
    pub(crate) fn column(&self, column: usize) -> impl Iterator<Item = f64> {
        let place = self.places[column];
        self.numbers.chunks_exact(self.width).map(move |row| place.map_or(0.0, |place| row[place]))
    }

    /// Puts some of the columns, in this order, into a matrix from a row on.
    pub(crate) fn copy_columns(&self, order: impl Iterator<Item = usize>, to: &mut Mat<f64>, first: usize) {
        for (j, column) in order.enumerate() {
            to.col_as_slice_mut(j)[first..].iter_mut().zip(self.column(column)).for_each(|(to, value)| *to = value);
        }
    }

    /// Adds so many times each column to the residual.
    pub(crate) fn change(&mut self, change: &[f64]) {
        let by: Vec<(usize, f64)> = self.places.iter().zip(change).filter_map(|(p, by)| Some(((*p)?, *by))).collect();
        for row in self.numbers.chunks_exact_mut(self.width) {
            row[self.of_residual] += by.iter().map(|(place, by)| row[*place] * by).sum::<f64>();
        }
    }

    /// As many rows, whose numbers are still to be put there.
    pub(crate) fn resize(&mut self, rows: usize) {
        self.numbers.resize(rows * self.width);
    }
}
