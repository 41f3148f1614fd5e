//! Computes the detection limits of effects. The detection limit of an effect is the smallest size at which it is
//! detected with 90 % probability.

use statrs::distribution::{ChiSquared, ContinuousCDF};
use statrs::function::gamma::ln_gamma;

/// Nominal probability that the chi2 tests of all candidates together give a false alarm. The actual probability is
/// about three times larger, because the tested rests are also the rests from which the noise is estimated. A false
/// alarm therefore occurs in about 1 % of the recordings of units without effects.
pub(crate) const FALSE_ALARM: f64 = 0.003;
/// Probability of detection that defines the detection limit.
const POWER: f64 = 0.9;

/// The search for the detection limit starts with this upper bound of the non-centrality of chi2 (dimensionless). The
/// bound is doubled until an effect of this non-centrality is detected with the probability [`POWER`].
const FIRST: f64 = 16.0;
/// Largest upper bound of the non-centrality, at which the doubling ends. The required non-centrality grows with the
/// number of parameters, and no effect has enough parameters to need a larger value.
const MOST: f64 = 1024.0;
/// The root search ends if the relative change of the non-centrality is below this value.
const LAST_STEP: f64 = 1e-9;

/// Non-centrality at which a chi2 test with `dof` degrees of freedom detects an effect with 90 % probability. The
/// false-alarm probability of the test is [`FALSE_ALARM`] divided by the number of `tests` (Bonferroni).
pub(crate) fn visible_noncentrality(dof: usize, tests: usize) -> f64 {
    let Ok(central) = ChiSquared::new(dof as f64) else { return f64::INFINITY };
    let limit = central.inverse_cdf(1.0 - FALSE_ALARM / tests.max(1) as f64);
    let mut tails = Tails::new(dof, limit);
    let (mut low, mut high) = (0.0, FIRST);
    while high < MOST && exceeds(&mut tails, high)[0] < POWER {
        (low, high) = (high, 2.0 * high);
    }
    // The root is found by Newton steps. If a step leaves the bracket, a bisection step replaces it.
    let mut at = high;
    loop {
        let [power, slope] = exceeds(&mut tails, at);
        if power >= POWER {
            high = at
        } else {
            low = at
        }
        let newton = at - (power - POWER) / slope;
        let next = if (low..=high).contains(&newton) { newton } else { f64::midpoint(low, high) };
        if (next - at).abs() <= LAST_STEP * at {
            return next;
        }
        at = next;
    }
}

/// Probabilities that a chi2 variable exceeds `limit`, for `dof`, `dof` + 2, `dof` + 4, ... degrees of freedom. Each
/// value is computed when first needed.
struct Tails {
    dof: usize,
    limit: f64,
    known: Vec<f64>,
    /// Next probability (for two more degrees of freedom) minus the last probability in `known`.
    step: f64,
}

impl Tails {
    fn new(dof: usize, limit: f64) -> Self {
        let (half, shape) = (limit / 2.0, dof as f64 / 2.0);
        let first = ChiSquared::new(dof as f64).map_or(0.0, |chi2| chi2.sf(limit));
        Self { dof, limit, known: vec![first], step: (shape * half.ln() - half - ln_gamma(shape + 1.0)).exp() }
    }

    /// Probability for `dof + 2 k` degrees of freedom: `Q(a, x)`, the regularised upper incomplete gamma function, with
    /// `a = dof / 2 + k` and `x = limit / 2`. It is computed by `Q(a + 1, x) = Q(a, x) + x^a e^-x / Gamma(a + 1)`
    /// (Abramowitz and Stegun 6.5.21).
    fn at(&mut self, k: usize) -> f64 {
        for known in self.known.len()..=k {
            self.known.push(self.known[known - 1] + self.step);
            self.step *= self.limit / (self.dof + 2 * known) as f64;
        }
        self.known[k]
    }
}

/// Probability that a non-central chi2 variable exceeds the limit of `tails`, and the derivative of this probability
/// with respect to the non-centrality. The non-central distribution is a Poisson-weighted mixture of central chi2
/// distributions. Weights below the rounding error are omitted.
fn exceeds(tails: &mut Tails, noncentrality: f64) -> [f64; 2] {
    let mean = noncentrality / 2.0;
    let (mut weight, mut sum, mut slope, mut k) = ((-mean).exp(), 0.0, 0.0, 0);
    while (k as f64) < mean || weight > f64::EPSILON {
        sum += weight * tails.at(k);
        slope += weight * (tails.at(k + 1) - tails.at(k)) / 2.0;
        k += 1;
        weight *= mean / k as f64;
    }
    [sum, slope]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::stats::p_value;

    #[test]
    fn tails_and_power_are_those_of_tables() {
        assert!((p_value(9.487_729, 4) - 0.05).abs() < 1e-7);
        // With one degree of freedom and one two-sided test at 0.3 %, the non-centrality is (z_0.9985 + z_0.9)^2.
        let expected = (2.967_738 + 1.281_552_f64).powi(2);
        assert!((visible_noncentrality(1, 1) - expected).abs() < 1e-3, "{}", visible_noncentrality(1, 1));
        let mut tails = Tails::new(3, 20.0);
        for k in 0..40 {
            assert!((tails.at(k) - p_value(20.0, 3 + 2 * k)).abs() < 1e-12, "{k}");
        }
    }
}
