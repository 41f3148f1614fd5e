//! What a plan is good for.

use faer::Mat;

use super::predict::{covariance, log_determinant};

/// The norm that stands for the largest.
const SHARPNESS: f64 = 8.0;

/// What an optimal program is to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Goal {
    /// The most information on all parameters together (D-optimal) in this time, s.
    MostIn {
        /// The time that the program may take, s.
        duration_s: f64,
    },
    /// These standard deviations in the shortest time; infinite where there is no wish.
    ShortestTo {
        /// One for each parameter, in the order of [`Sensors`](super::Sensors).
        sigma: Vec<f64>,
    },
}

impl Goal {
    /// The less, the better: a number to compare programs by. `None` where there is no information.
    pub(super) fn cost(&self, information: &Mat<f64>, before: &[f64], duration_s: f64) -> Option<f64> {
        match self {
            Self::MostIn { .. } => Some(-log_determinant(information, before)? / before.len() as f64),
            Self::ShortestTo { .. } => {
                // Nearly the largest, and smooth: what makes another one smaller pays, too.
                let shares = self.shares(information, before)?;
                let worst = shares.iter().map(|share| share.powf(SHARPNESS)).sum::<f64>().powf(1.0 / SHARPNESS);
                // A variance falls as one over the time: beyond what is wished for time counts more, before it less.
                let weight = if worst > 1.0 { 2.0 } else { 0.5 };
                Some(duration_s.ln() + weight * worst.ln())
            }
        }
    }

    /// The largest variance in units of the one that is wished for; above 1 the goal is missed.
    pub(super) fn worst(&self, information: &Mat<f64>, before: &[f64]) -> Option<f64> {
        Some(self.shares(information, before)?.into_iter().fold(0.0, f64::max))
    }

    /// Each variance in units of the one that is wished for; none without wishes.
    fn shares(&self, information: &Mat<f64>, before: &[f64]) -> Option<Vec<f64>> {
        let Self::ShortestTo { sigma } = self else { return Some(Vec::new()) };
        let covariance = covariance(information, before)?;
        Some(sigma.iter().enumerate().map(|(p, sigma)| covariance[(p, p)] / (sigma * sigma)).collect())
    }
}
