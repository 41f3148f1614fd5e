//! Goals of a plan, and the cost of a program with respect to its goal.

use faer::Mat;

use super::predict::{covariance, log_determinant};

/// Order p of the p-norm that combines the ratios variance / target variance of all parameters into one number. The
/// p-norm approximates the largest ratio, but unlike the largest ratio it is smooth.
const NORM_ORDER: f64 = 8.0;

/// Goal of an optimal program.
#[derive(Clone, Debug, PartialEq)]
pub enum Goal {
    /// The most information about all parameters (D-optimality) in a given time.
    MostIn {
        /// Maximum duration of the program, s.
        duration_s: f64,
    },
    /// The shortest program that reaches the target standard deviations.
    ShortestTo {
        /// Target standard deviation of each parameter, in the order of [`Sensors`](super::Sensors) and in SI units. It
        /// is infinite for a parameter without a target.
        sigma: Vec<f64>,
    },
}

impl Goal {
    /// Computes the cost of a program from its information matrix, the prior precisions `prior` and its duration. A
    /// program with a lower cost is better. `None` if the information matrix is singular.
    pub(super) fn cost(&self, information: &Mat<f64>, prior: &[f64], duration_s: f64) -> Option<f64> {
        match self {
            Self::MostIn { .. } => Some(-log_determinant(information, prior)? / prior.len() as f64),
            Self::ShortestTo { .. } => {
                // The p-norm approximates the largest ratio variance / target variance. Unlike the largest ratio, the
                // p-norm also decreases if one of the smaller ratios decreases.
                let shares = self.shares(information, prior)?;
                let worst = shares.iter().map(|share| share.powf(NORM_ORDER)).sum::<f64>().powf(1.0 / NORM_ORDER);
                // A variance, and therefore `worst`, is proportional to 1 / duration, so the cost is (1 - weight)
                // ln(duration) plus a constant. If `worst` > 1, the weight is 2, and a longer program has a lower cost
                // until it reaches the targets. If `worst` < 1, the weight is 1/2, and a shorter program has a lower
                // cost.
                let weight = if worst > 1.0 { 2.0 } else { 0.5 };
                Some(duration_s.ln() + weight * worst.ln())
            }
        }
    }

    /// Largest ratio variance / target variance of all parameters; 0 for a goal without targets. If the largest ratio
    /// is above 1, the goal is not reached.
    pub(super) fn worst(&self, information: &Mat<f64>, prior: &[f64]) -> Option<f64> {
        Some(self.shares(information, prior)?.into_iter().fold(0.0, f64::max))
    }

    /// The ratio variance / sigma^2 of each parameter. sigma is the target standard deviation. The list is empty for a
    /// goal without targets.
    fn shares(&self, information: &Mat<f64>, prior: &[f64]) -> Option<Vec<f64>> {
        let Self::ShortestTo { sigma } = self else { return Some(Vec::new()) };
        let covariance = covariance(information, prior)?;
        Some(sigma.iter().enumerate().map(|(p, sigma)| covariance[(p, p)] / (sigma * sigma)).collect())
    }
}
