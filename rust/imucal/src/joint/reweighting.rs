//! Updates the weights of the residuals between repeated fits (model.md (19)).
//!
//! Each fit gives the excess of its residuals over noise, and this excess determines the weights of the next fit. Plain
//! repetition has two defects. First, the weights may alternate. An excess near the significance limit is significant
//! after a fit with weights from noise only. The next weights contain the excess. After the fit with these weights, the
//! excess is not significant, so the weights are from noise only again. Second, if residuals of two kinds determine the
//! same parameter, the excess converges slowly, by a constant factor per fit.

use super::problem::Joint;
use super::weights::{FACTORS, WIDENINGS, Widened, Widening};
use crate::error::Error;
use crate::numerics::lsq::Solution;

/// The weights are extrapolated only after this number of fits, because the weights from the first fits are
/// preliminary. Most runs converge within five fits.
const EXTRAPOLATE_AFTER: usize = 3;
/// Limit of the extrapolation of the logarithm of an excess, in multiples of the last change of this logarithm. If each
/// change is r times the previous change, all further changes add up to r / (1 - r) times the last change. This is 10
/// times the last change for r = 10/11.
const LARGEST_STEP: f64 = 10.0;

/// State of the iteration over the weights.
#[derive(Default)]
pub(super) struct Reweighting {
    /// For each set of weights used so far: the kinds of residuals whose standard deviations are larger than those from
    /// noise.
    widened: Vec<Widened>,
    /// Kinds of residuals whose standard deviations are increased even if their excess is not significant.
    kept: Option<Widened>,
    /// Logarithms of two excesses: the excess that the last weights contain, and the excess that was estimated from the
    /// fit with these weights.
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
            // The excess was significant in a fit with weights from noise only, for which the significance test is
            // valid. The standard deviations of these kinds of residuals are therefore always increased from now on,
            // without a test.
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
        // If a standard deviation is not increased, its factor is 1 (logarithm 0), or the variance to be added is zero
        // (logarithm minus infinity). Such values are not extrapolated.
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
