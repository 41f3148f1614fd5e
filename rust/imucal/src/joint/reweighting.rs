//! Updates the weights of the residuals between repeated fits (model.md (19)).
//!
//! Each fit gives the excess of the scatter of its residuals over their noise, and this excess determines the weights
//! of the next fit. Plain repetition has two defects. First, the weights may alternate. After a fit with weights from
//! noise only, an excess near the significance limit may be significant, so the next weights include it. After the fit
//! with these weights, the excess is no longer significant, so the weights are from noise only again. Second, if
//! residuals of two kinds determine the same parameter, the excess converges slowly, by a constant factor per fit.

use super::problem::Joint;
use super::weights::{FACTORS, WIDENINGS, Widened, Widening};
use crate::error::Error;
use crate::numerics::lsq::Solution;

/// The weights are extrapolated only after this number of fits, because the weights from the first fits are
/// preliminary. Most runs converge within five fits.
const EXTRAPOLATE_AFTER: usize = 3;
/// Largest step of the extrapolation. The logarithm of each excess changes by at most this multiple of its last change.
/// If each change is r times the previous change, all further changes add up to r / (1 - r) times the last change,
/// which is 10 times for r = 10/11.
const LARGEST_STEP: f64 = 10.0;

/// State of the iteration over the weights.
#[derive(Default)]
pub(super) struct Reweighting {
    /// For each set of weights used so far: the kinds of residuals whose standard deviations are larger than those from
    /// noise.
    widened: Vec<Widened>,
    /// Kinds of residuals whose standard deviations are increased even if their excess is not significant.
    kept: Option<Widened>,
    /// Logarithms of two excesses: the excess with which the last weights were computed, and the excess that was
    /// estimated from the fit with these weights.
    last: Option<[[f64; WIDENINGS]; 2]>,
    fits: usize,
}

impl Reweighting {
    /// Sets new weights in the problem after a fit.
    pub(super) fn update(&mut self, problem: &mut Joint<'_>, found: &Solution) -> Result<(), Error> {
        self.fits += 1;
        let mut excess = problem.excess_of(found, self.kept.as_ref())?;
        let widened = excess.widened();
        if self.alternates(widened) {
            // The alternating kinds of residuals had a significant excess in a fit with weights from noise only, for
            // which the significance test is valid. Their standard deviations are therefore always increased from now
            // on, without a test.
            let all = self.widened.iter().copied().chain(self.kept).fold(widened, |all, one| one.union(all));
            self.kept = Some(all);
            self.widened.clear();
            excess = problem.excess_of(found, Some(&all))?;
        } else {
            self.widened.push(widened);
        }
        let next = self.extrapolated(&problem.weights.widening, &excess).unwrap_or(excess);
        problem.weigh_with(found, &next)
    }

    /// Whether the kinds with increased standard deviations alternate: `widened` differs from the kinds of the last fit
    /// and equals the kinds of an earlier fit.
    fn alternates(&self, widened: Widened) -> bool {
        self.widened.last().is_some_and(|last| *last != widened) && self.widened.contains(&widened)
    }

    /// Excess to which the iteration is expected to converge, extrapolated by a secant step along the last change
    /// (Anderson acceleration of depth one). `None` for the first fits. Also `None` if the last two fits increased
    /// the standard deviations of different kinds.
    fn extrapolated(&mut self, from: &Widening, to: &Widening) -> Option<Widening> {
        let now = [from.logarithms(), to.logarithms()];
        let before = self.last.replace(now)?;
        if self.fits <= EXTRAPOLATE_AFTER {
            return None;
        }
        // An excess is a factor on a standard deviation or an added variance. Without excess, the factor is 1
        // (logarithm 0), and the added variance is zero (logarithm minus infinity). Such values are not extrapolated.
        let is_none = |i: usize, value: f64| value == f64::NEG_INFINITY || (i < FACTORS && value == 0.0);
        let (mut along, mut square) = (0.0, 0.0);
        let mut next = now[1];
        for i in 0..WIDENINGS {
            let values = [before[0][i], before[1][i], now[0][i], now[1][i]];
            if values.into_iter().all(|value| is_none(i, value)) {
                continue;
            }
            if values.into_iter().any(|value| is_none(i, value)) {
                return None;
            }
            let change = (now[1][i] - now[0][i]) - (before[1][i] - before[0][i]);
            along += (now[1][i] - now[0][i]) * change;
            square += change * change;
        }
        if square == 0.0 {
            return None;
        }
        let step = (-along / square).clamp(-LARGEST_STEP, LARGEST_STEP);
        for i in (0..WIDENINGS).filter(|&i| !is_none(i, now[1][i])) {
            next[i] += step * (now[1][i] - before[1][i]);
        }
        Some(Widening::from_logarithms(&next))
    }
}
