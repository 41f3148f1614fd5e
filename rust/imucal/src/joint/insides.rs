//! What is inside the moves, whitened one move at a time.

use std::sync::Arc;

use super::inside::{InsideNoise, Rows, count};
use super::lanes::Lanes;
use super::linear::Linear;

/// What is seen inside the moves of a linearisation, to be whitened when it is asked for.
pub(crate) struct Insides {
    linear: Arc<Linear>,
    noise: Vec<InsideNoise>,
    gravity_mps2: f64,
    no_rows: Lanes,
}

impl Insides {
    /// `None` if there is no move.
    pub(super) fn new(linear: Arc<Linear>, noise: Vec<InsideNoise>, gravity_mps2: f64) -> Option<Self> {
        let no_rows = Lanes::inside(&linear.moves.first()?.pass);
        Some(Self { linear, noise, gravity_mps2, no_rows })
    }

    /// How many moves there are.
    pub(crate) fn moves(&self) -> usize {
        self.linear.moves.len()
    }

    /// How many rows they have together.
    pub(crate) fn rows(&self) -> usize {
        self.linear.moves.iter().map(|at_move| count(&at_move.pass, false)).sum()
    }

    /// Where the columns stand in each row, and the residual.
    pub(crate) fn no_rows(&self) -> &Lanes {
        &self.no_rows
    }

    /// Puts the rows of a move in the place of those of another one.
    pub(crate) fn look(&self, k: usize, lanes: &mut Lanes) {
        let at_move = &self.linear.moves[k];
        lanes.resize(count(&at_move.pass, false));
        Rows::side_by_side(lanes).write_move(at_move, &self.noise[k], self.gravity_mps2);
        if self.linear.change.iter().any(|change| *change != 0.0) {
            lanes.change(&self.linear.change);
        }
    }
}
