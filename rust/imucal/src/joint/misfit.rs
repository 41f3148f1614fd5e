//! How well noise alone explains a fit, and each rest and move of it (model.md (26)).
//!
//! ```text
//! chi2 = r^T P r  with  N - n degrees of freedom,     p = P(chi2 of as many degrees is larger)
//! ```
//!
//! with P of (25) for all N residuals. The share of a rest (its norm and its mean rates) or of a move is d of (25): the misfit as
//! a fit without it would see it, so that it follows chi2 whatever its leverage. Nothing is widened here.

use std::sync::Arc;

use super::linear::{Linear, Source};
use super::outliers::LeaveOut;
use super::prepared::Prepared;
use super::problem::Joint;
use super::terms::Terms;
use crate::error::Error;
use crate::numerics::stats::p_value;

/// A misfit in units of what noise explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Sum of the squared residuals.
    pub chi2: f64,
    /// What chi2 is on average if noise is all there is.
    pub degrees_of_freedom: usize,
    /// Probability that noise alone makes chi2 larger.
    pub p_value: f64,
}

impl Misfit {
    /// `None` without any degree of freedom.
    fn new(chi2: f64, degrees_of_freedom: usize) -> Option<Self> {
        let p_value = p_value(chi2, degrees_of_freedom);
        (degrees_of_freedom > 0).then_some(Self { chi2, degrees_of_freedom, p_value })
    }
}

/// The misfit of a fit, of each rest and of each move; `None` for those that it does not use or follows whatever they say.
pub(crate) struct Misfits {
    pub(crate) all: Option<Misfit>,
    pub(crate) rests: Vec<Option<Misfit>>,
    pub(crate) moves: Vec<Option<Misfit>>,
}

impl Misfits {
    /// `linear` is what the fit has ended at.
    pub(crate) fn of(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Arc<Linear>) -> Result<Self, Error> {
        let problem = Joint::of_noise(prepared, terms, Arc::clone(linear))?;
        let without = LeaveOut::new(&problem, linear);
        let (mut of_rests, mut of_moves) =
            (vec![Vec::new(); prepared.rests.len()], vec![Vec::new(); linear.moves.len()]);
        for (row, line) in linear.lines.iter().enumerate() {
            match line.source {
                Source::Norm(k) => of_rests[k].push(row),
                Source::Move(k) => of_moves[k].push(row),
            }
        }
        for (place, (k, _)) in linear.rates.iter().enumerate() {
            let first = linear.lines.len() + 3 * place;
            of_rests[*k].extend(first..first + 3);
        }
        let judged = |groups: Vec<Vec<usize>>| -> Vec<Option<Misfit>> {
            let judge = |rows: Vec<usize>| {
                let (chi2, degrees_of_freedom) = without.misfit(&rows);
                Misfit::new(chi2, degrees_of_freedom)
            };
            groups.into_iter().map(judge).collect()
        };
        let (chi2, degrees_of_freedom) = without.whole();
        Ok(Self { all: Misfit::new(chi2, degrees_of_freedom), rests: judged(of_rests), moves: judged(of_moves) })
    }
}
