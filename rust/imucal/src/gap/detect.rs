//! How small an effect would have been seen.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Family-wise probability of a false alarm by the distribution of chi2. The noise is estimated from the same rests, which makes
/// small probabilities about three times as frequent as they say: of clean runs one in a hundred is meant.
pub(crate) const FALSE_ALARM: f64 = 0.003;
const POWER: f64 = 0.9;

/// Where it is looked for first; no chi2 with as many degrees of freedom as an effect has parameters needs more than the last.
const FIRST: f64 = 16.0;
const MOST: f64 = 1024.0;
/// Halvings of the span that it lies in: to a part in ten million.
const HALVINGS: usize = 24;

/// The non-centrality with which chi2 exceeds its limit with 90 % probability; the limit is for one of `tests`.
pub(crate) fn visible_noncentrality(dof: usize, tests: usize) -> f64 {
    let Ok(central) = ChiSquared::new(dof as f64) else { return f64::INFINITY };
    let limit = central.inverse_cdf(1.0 - FALSE_ALARM / tests.max(1) as f64);
    let mut tails = Tails { dof, limit, known: Vec::new() };
    let mut is_enough = |noncentrality: f64| exceeds(&mut tails, noncentrality) >= POWER;
    let (mut low, mut high) = (0.0, FIRST);
    while high < MOST && !is_enough(high) {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..HALVINGS {
        let middle = (low + high) / 2.0;
        if is_enough(middle) { high = middle } else { low = middle }
    }
    high
}

/// Probabilities that chi2 with 0, 2, 4 ... degrees of freedom more exceeds a limit, as far as they have been asked for.
struct Tails {
    dof: usize,
    limit: f64,
    known: Vec<f64>,
}

impl Tails {
    fn at(&mut self, k: usize) -> f64 {
        while self.known.len() <= k {
            // They grow: behind one that is certain all are.
            let next = match self.known.last() {
                Some(last) if *last >= 1.0 => 1.0,
                _ => ChiSquared::new((self.dof + 2 * self.known.len()) as f64).map_or(0.0, |chi2| chi2.sf(self.limit)),
            };
            self.known.push(next);
        }
        self.known[k]
    }
}

/// A noncentral chi2 is a mixture of central ones with Poisson weights; those that are left out come to less than a rounding error.
fn exceeds(tails: &mut Tails, noncentrality: f64) -> f64 {
    let mean = noncentrality / 2.0;
    let (mut weight, mut sum, mut k) = ((-mean).exp(), 0.0, 0);
    while (k as f64) < mean || weight > f64::EPSILON {
        sum += weight * tails.at(k);
        k += 1;
        weight *= mean / k as f64;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::p_value;

    #[test]
    fn tails_and_power_are_those_of_tables() {
        assert!((p_value(9.487_729, 4) - 0.05).abs() < 1e-7);
        // One degree of freedom and one test at 0.3 %: (z_0.9985 + z_0.9)^2.
        let expected = (2.967_738 + 1.281_552_f64).powi(2);
        assert!((visible_noncentrality(1, 1) - expected).abs() < 1e-3, "{}", visible_noncentrality(1, 1));
    }
}
