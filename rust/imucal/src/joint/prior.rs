//! Effects of which the recordings show some directions and not all.
//!
//! ```text
//! r_p = theta_p / (s typical_p),     s^2 = sum_p (theta_p / typical_p)^2 / sum_p (1 - C_pp / (s typical_p)^2)
//! ```
//!
//! Three of nine g^2-sensitivities are a bias on a stand: fx^2 + fy^2 + fz^2 does not change. What the recordings do not show is
//! taken for as large as what they show: s is what makes the data likeliest (MacKay, Neural Computation 4, 1992, 415-447,
//! (4.9)). Where data fix a direction, a prior as wide as the parameters are large does not count.

use faer::Mat;

/// A normal prior of the parameters of one effect, around zero.
#[derive(Clone)]
pub(crate) struct Prior {
    /// Place of its first parameter among all.
    pub(crate) first: usize,
    /// Typical size of each parameter.
    pub(crate) typical: Vec<f64>,
    /// Standard deviation in units of these.
    pub(crate) width: f64,
}

impl Prior {
    /// As wide as what was found with the width that is there.
    pub(super) fn widen(&mut self, parameters: &[f64], covariance: &Mat<f64>) {
        let (mut square, mut seen) = (0.0, 0.0);
        for (k, typical) in self.typical.iter().enumerate() {
            let p = self.first + k;
            square += (parameters[p] / typical).powi(2);
            seen += 1.0 - covariance[(p, p)] / (self.width * typical).powi(2);
        }
        // Never narrower than an ordinary sensor is.
        self.width = if seen > 1e-3 { (square / seen).sqrt().max(1.0) } else { self.width };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prior_is_as_wide_as_the_directions_that_are_seen() {
        let mut prior = Prior { first: 0, typical: vec![0.1; 3], width: 100.0 };
        // The third one has its prior and nothing else.
        let found = Mat::from_fn(3, 3, |i, j| {
            if i != j {
                0.0
            } else if i < 2 {
                1e-6
            } else {
                100.0
            }
        });
        prior.widen(&[3.0, -4.0, 0.0], &found);
        assert!((prior.width - (0.5 * 2500.0_f64).sqrt()).abs() < 1e-6, "{}", prior.width);
    }
}
