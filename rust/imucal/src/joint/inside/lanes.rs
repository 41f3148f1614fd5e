//! White residuals inside the moves and their derivatives, row by row.

use std::ops::Range;

use super::super::pass::Pass;
use crate::aligned::{Aligned, WIDEST};

/// Rows of numbers side by side: the derivatives by what acts on the rate, by what acts on the force, and the residual.
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
    /// No row yet, with as many columns beside the residual as this move has.
    pub(crate) fn new(pass: &Pass) -> Self {
        let (of_residual, columns) = (pass.changes.lanes(), pass.turn.len());
        let mut places = vec![None; columns + 1];
        pass.changes.parameters().for_each(|(lane, column)| places[column] = Some(lane));
        places[columns] = Some(of_residual);
        // There is room for a register behind each place.
        let width = of_residual + 1 + WIDEST;
        Self { places, of_residual, width: width.next_multiple_of(WIDEST), numbers: Aligned::default() }
    }

    /// Of columns that have these places, and the residual the last; each number is that of a row and a column.
    #[cfg(test)]
    pub(crate) fn of(places: &[Option<usize>], rows: usize, number: impl Fn(usize, usize) -> f64) -> Self {
        let of_residual = places.last().copied().flatten().unwrap();
        let width = (of_residual + 1 + WIDEST).next_multiple_of(WIDEST);
        let mut numbers = Aligned::zeros(rows * width);
        for (i, row) in numbers.chunks_exact_mut(width).enumerate() {
            let seen = places.iter().enumerate().filter_map(|(column, place)| Some((column, (*place)?)));
            seen.for_each(|(column, place)| row[place] = number(i, column));
        }
        Self { places: places.to_vec(), of_residual, width, numbers }
    }

    /// Length of a row, that of some registers.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// How many rows there are.
    pub(crate) fn rows(&self) -> usize {
        self.numbers.len() / self.width
    }

    /// Some of the rows, one after the other.
    pub(crate) fn numbers(&self, rows: Range<usize>) -> &[f64] {
        &self.numbers[rows.start * self.width..rows.end * self.width]
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

    /// All rows, to be filled.
    pub(super) fn numbers_mut(&mut self) -> &mut [f64] {
        &mut self.numbers
    }
}
