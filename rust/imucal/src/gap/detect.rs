//! Computes the detection limits of effects. The detection limit of an effect is the smallest rms size of its
//! parameters at which it is detected with 90 % probability, if all directions in the space of its parameters are
//! equally likely.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};
use statrs::function::gamma::ln_gamma;

/// Nominal probability that the chi2 tests of all candidates together give a false alarm. The actual probability is
/// about three times larger, because the tested rests are also the rests from which the noise is estimated. A false
/// alarm therefore occurs in about 1 % of the recordings of units without effects.
pub(crate) const FALSE_ALARM: f64 = 0.003;
/// Probability of detection that defines the detection limit.
const POWER: f64 = 0.9;

/// Step of the tables of detection probabilities. The argument of a table is the square root of the non-centrality of
/// chi2.
const STEP: f64 = 1.0 / 16.0;
/// Largest square root of the non-centrality in a table. The threshold of the test grows with the number of
/// parameters, and no effect has enough parameters to need a larger value.
const MOST: f64 = 32.0;
/// A table ends at this probability of detection. Effects with a larger non-centrality count as certainly detected.
const CERTAIN: f64 = 1.0 - 1e-6;
/// Number of directions in the space of an effect's parameters over which the probability of detection is averaged.
/// With this number, the detection limit is accurate to 1 %.
const DIRECTIONS: usize = 512;
/// The search for the detection limit first multiplies the rms size of the parameters by this factor until the effect
/// is detected with at least the probability [`POWER`].
const GROWTH: f64 = 1.25;
/// The root search ends if the relative change of the rms size in a step is below this value.
const LAST_STEP: f64 = 1e-4;

/// Detection limits of a family of chi2 tests. The tables are computed when first needed.
pub(crate) struct Detection {
    tests: usize,
    /// For each number of degrees of freedom: the probabilities of detection at the square roots 0, [`STEP`],
    /// 2 [`STEP`], ... of the non-centrality.
    powers: BTreeMap<usize, Vec<f64>>,
}

/// For each number of parameters: the result of [`squared_directions`]. It is stored, because all searches can use it.
static SQUARED_DIRECTIONS: Mutex<BTreeMap<usize, Vec<f64>>> = Mutex::new(BTreeMap::new());

impl Detection {
    /// Prepares the detection limits of a family of `tests` chi2 tests. The false-alarm probability of each test is
    /// [`FALSE_ALARM`] / `tests` (Bonferroni).
    pub(crate) fn new(tests: usize) -> Self {
        Self { tests, powers: BTreeMap::new() }
    }

    /// Smallest rms size of the parameters of an effect at which a chi2 test with `dof` degrees of freedom detects the
    /// effect with 90 % probability. `information` has one value for each parameter: the eigenvalues of the matrix
    /// whose quadratic form in the parameters is the non-centrality of chi2. All directions of the parameters are
    /// equally likely. Infinite if the effect is not observable.
    pub(crate) fn limit(&mut self, information: &[f64], dof: usize) -> f64 {
        let powers = self.powers.entry(dof).or_insert_with(|| powers(dof, self.tests));
        let count = information.len();
        // The table is used even if the lock is poisoned, because a thread that panics leaves each entry complete or
        // absent.
        let mut known = SQUARED_DIRECTIONS.lock().unwrap_or_else(PoisonError::into_inner);
        let directions = known.entry(count).or_insert_with(|| squared_directions(count));
        let mut information: Vec<f64> = information.iter().map(|value| value.max(0.0)).collect();
        information.sort_by(f64::total_cmp);
        let total: f64 = information.iter().sum();
        let single = powers.iter().position(|power| *power >= POWER).map(|step| step as f64 * STEP);
        let Some(single) = single.filter(|_| total > 0.0 && total.is_finite()) else { return f64::INFINITY };
        // At an rms size of one, a vector of parameters has the squared length `count`.
        let of = |squares: &[f64]| information.iter().zip(squares).map(|(a, b)| a * b).sum::<f64>();
        let roots: Vec<f64> = directions.chunks(count).map(|each| (count as f64 * of(each)).sqrt()).collect();
        let power = |size: f64| roots.iter().map(|root| at(powers, size * root)).sum::<f64>() / roots.len() as f64;
        // `single` is the smallest square root of the non-centrality in the table at which the probability reaches
        // [`POWER`]. With equal eigenvalues, the limit is about `single / total.sqrt()`, so the search starts there.
        let mut low = [0.0, -POWER];
        let mut high = [single / total.sqrt(), 0.0];
        high[1] = power(high[0]) - POWER;
        while high[1] < 0.0 {
            low = high;
            high[0] *= GROWTH;
            high[1] = power(high[0]) - POWER;
        }
        // The Illinois method (a modified regula falsi): the secant through both ends of the interval. After each step,
        // the excess probability at the end that is kept is halved.
        let mut at = high[0];
        loop {
            let next = high[0] - high[1] * (high[0] - low[0]) / (high[1] - low[1]);
            if (next - at).abs() <= LAST_STEP * next {
                return next;
            }
            at = next;
            let excess = power(at) - POWER;
            if excess < 0.0 {
                low = [at, excess];
                high[1] /= 2.0;
            } else {
                high = [at, excess];
                low[1] /= 2.0;
            }
        }
    }
}

/// Probabilities of detection at the square roots 0, [`STEP`], 2 [`STEP`], ... of the non-centrality.
fn powers(dof: usize, tests: usize) -> Vec<f64> {
    let Ok(central) = ChiSquared::new(dof as f64) else { return Vec::new() };
    let mut tails = Tails::new(dof, central.inverse_cdf(1.0 - FALSE_ALARM / tests.max(1) as f64));
    let mut powers = Vec::new();
    while powers.last().is_none_or(|power| *power < CERTAIN) && powers.len() as f64 * STEP < MOST {
        powers.push(exceeds(&mut tails, (powers.len() as f64 * STEP).powi(2)));
    }
    powers
}

/// Probability of detection if `root` is the square root of the non-centrality, by linear interpolation in a table of
/// [`powers`].
fn at(powers: &[f64], root: f64) -> f64 {
    let place = root / STEP;
    match powers.get(place as usize..=place as usize + 1) {
        Some(near) => near[0] + place.fract() * (near[1] - near[0]),
        None => 1.0,
    }
}

/// Squared components of [`DIRECTIONS`] unit vectors, evenly spread over the directions of `count` dimensions. They are
/// normalised normal deviates, from a sequence of low discrepancy (M. Roberts, "The unreasonable effectiveness of
/// quasirandom sequences", 2018).
fn squared_directions(count: usize) -> Vec<f64> {
    /// Number of fixed-point iterations that compute `base`, the solution of base^(count + 1) = 1 + base. It is large
    /// enough for convergence to the rounding error.
    const ITERATIONS: usize = 64;
    let normal = Normal::standard();
    let base = (0..ITERATIONS).fold(2.0_f64, |base, _| (1.0 + base).powf(1.0 / (count + 1) as f64));
    let mut squares = Vec::with_capacity(DIRECTIONS * count);
    for place in 1..=DIRECTIONS {
        let deviate = |k: i32| normal.inverse_cdf((0.5 + place as f64 * base.powi(-k)).fract());
        let own: Vec<f64> = (1..=count as i32).map(|k| deviate(k).powi(2)).collect();
        let length: f64 = own.iter().sum();
        squares.extend(own.iter().map(|square| square / length));
    }
    squares
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

/// Probability that a non-central chi2 variable exceeds the limit of `tails`. The non-central distribution is a
/// Poisson-weighted mixture of central chi2 distributions. Weights below the rounding error are omitted.
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
    use crate::numerics::stats::p_value;

    #[test]
    fn tails_and_power_are_those_of_tables() {
        assert!((p_value(9.487_729, 4) - 0.05).abs() < 1e-7);
        // With one degree of freedom and one two-sided test at 0.3 %, the square root of the non-centrality at the
        // detection limit is z_0.9985 + z_0.9 (z: quantiles of the standard normal distribution).
        let limit = Detection::new(1).limit(&[1.0], 1);
        assert!((limit - (2.967_738 + 1.281_552)).abs() < 1e-3, "{limit}");
        let mut tails = Tails::new(3, 20.0);
        for k in 0..40 {
            assert!((tails.at(k) - p_value(20.0, 3 + 2 * k)).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn a_limit_is_an_average_over_the_directions() {
        let mut detection = Detection::new(30);
        // With equal information about all parameters the direction does not matter, and the limit is that of one
        // parameter with the sum of the information.
        let equal = detection.limit(&[1.0; 3], 3);
        let single = detection.limit(&[3.0], 3);
        assert!((equal - single).abs() < 1e-4 * single, "{equal} {single}");
        assert!((detection.limit(&[4.0; 3], 3) - equal / 2.0).abs() < 1e-4 * equal);
        // With the same sum of information, but mostly about one parameter, the limit is larger than `equal`.
        // Reference: scipy.stats.ncx2 and 4e6 random directions.
        let unequal = detection.limit(&[2.8, 0.1, 0.1], 3);
        assert!((unequal / equal - 2.13526).abs() < 0.01 * 2.13526, "{}", unequal / equal);
        assert_eq!(detection.limit(&[0.0; 3], 3), f64::INFINITY);
    }
}
