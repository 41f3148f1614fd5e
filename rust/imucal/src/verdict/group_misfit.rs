//! Compares the size of the residuals of one kind, for example of the force norms at the rests, with their expected
//! size from noise.
//!
//! ```text
//! ratio = sqrt(chi2 / dof),   p = P(X > chi2),   X: chi-square variable with dof degrees of freedom
//! ```
//!
//! chi2 is the sum of the squared residuals, each divided by the standard deviation of its noise. dof is the number of
//! degrees of freedom, and p is the p-value. With few residuals, noise alone can cause a ratio above two. With many
//! residuals, even a negligible model error gives a small p-value. Residuals are therefore reported as larger than
//! their noise only if the ratio is above two and the p-value is below 1e-5.

use std::fmt;

use imucal_core::STANDARD_GRAVITY_MPS2;

use crate::finding::general;
use crate::numerics::stats::p_value_of;

/// Limit of the ratio of the residuals to their expected size from noise, dimensionless. Above this limit, errors other
/// than noise dominate the residuals, because noise explains less than a quarter of their variance. An inaccurate noise
/// estimate cannot cause such a ratio, because sensor noise is estimated far more accurately than to a factor of two.
const EXCESS_RATIO: f64 = 2.0;
/// Residuals exceed their noise significantly if their p-value is below this limit. A calibration with control
/// recordings contains seven tests: five kinds of residuals on the calibration recordings, and two kinds on the control
/// recordings. For any number of residuals, noise alone gives a p-value below this limit in fewer than one of 10 000
/// calibrations.
pub(crate) const SIGNIFICANCE: f64 = 1e-5;

/// Kind of residuals. The residuals of a kind are compared with noise in one test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResidualGroup {
    /// Norms of the corrected specific force at the rests, minus local gravity.
    RestNorms,
    /// Gravity direction propagated through each move by integrating the gyroscope rates, minus the direction measured
    /// after the move.
    MoveDirections,
    /// Mean angular rates at the rests, minus the bias.
    RestRates,
    /// Specific force within the moves, minus gravity at the predicted attitude.
    MoveForces,
    /// Gravity directions at the rests and attitudes within the moves, minus the directions and attitudes that are
    /// computed from the encoder angles of the stand.
    StandAttitudes,
}

impl ResidualGroup {
    /// Name of the kind in JSON documents. The factor by which the fit increases the standard deviations of residuals
    /// of this kind has the same name. For the mean rates, there is no such factor.
    pub fn name(self) -> &'static str {
        match self {
            Self::RestNorms => "norms",
            Self::MoveDirections => "moves",
            Self::RestRates => "rates",
            Self::MoveForces => "inside",
            Self::StandAttitudes => "stand",
        }
    }

    /// Unit in which the residuals are displayed, as in datasheets.
    pub fn unit(self) -> &'static str {
        match self {
            Self::RestNorms | Self::MoveForces => "mg",
            Self::RestRates => "deg/h",
            Self::MoveDirections | Self::StandAttitudes => "deg",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::RestNorms => "norm of gravity at the rests",
            Self::MoveDirections => "gravity direction after the moves",
            Self::RestRates => "mean rates at the rests",
            Self::MoveForces => "specific force within the moves",
            Self::StandAttitudes => "attitude relative to the stand",
        }
    }

    /// Converts a residual from SI units to the unit that [`Self::unit`] returns.
    pub fn in_unit(self, si: f64) -> f64 {
        match self {
            Self::RestNorms | Self::MoveForces => si / STANDARD_GRAVITY_MPS2 * 1e3,
            Self::RestRates => si.to_degrees() * 3600.0,
            Self::MoveDirections | Self::StandAttitudes => si.to_degrees(),
        }
    }
}

/// Goodness of fit of the residuals of one kind, relative to noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupMisfit {
    /// Kind of the residuals.
    pub group: ResidualGroup,
    /// RMS of the residuals in SI units: m/s^2, rad, or rad/s.
    pub rms: f64,
    /// Sum of the squared residuals. Each residual is divided by the standard deviation of its noise. If noise alone
    /// does not explain the residuals of control recordings, the part of this sum that the uncertainty of the
    /// calibration explains is subtracted.
    pub chi2: f64,
    /// Number of residuals minus the number of parameters that they determine. This number may have a fractional part,
    /// because a parameter that several kinds of residuals determine together counts as a fraction in each of these
    /// kinds. For control recordings, it is the number of residuals, because no parameter is fitted to them.
    pub degrees_of_freedom: f64,
}

impl GroupMisfit {
    /// Ratio of the residuals to their expected size from noise. The ratio is about 1 if noise explains the residuals.
    pub fn ratio(&self) -> f64 {
        (self.chi2 / self.degrees_of_freedom).sqrt()
    }

    /// Expected RMS of the residuals from noise, SI units.
    pub fn noise(&self) -> f64 {
        self.rms / self.ratio()
    }

    /// Probability of a larger chi2 than `self.chi2` if noise is the only error.
    pub fn p_value(&self) -> f64 {
        p_value_of(self.chi2, self.degrees_of_freedom)
    }

    /// Returns the text of a residual: its value and unit, as displayed. The argument `si` is the residual in SI units.
    pub(super) fn size(&self, si: f64) -> String {
        let size = self.group.in_unit(si);
        let words = if size < 100.0 { general(size, 3) } else { format!("{size:.0}") };
        format!("{words} {}", self.group.unit())
    }

    /// Whether the residuals exceed their noise by more than a factor of two, and the excess is significant.
    pub fn exceeds_noise(&self) -> bool {
        self.ratio() > EXCESS_RATIO && self.is_significant()
    }

    /// Whether the p-value is so small that noise does not explain the residuals.
    pub fn is_significant(&self) -> bool {
        self.p_value() < SIGNIFICANCE
    }
}

impl fmt::Display for GroupMisfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [rms, noise] = [self.rms, self.noise()].map(|size| self.size(size));
        write!(f, "{} {rms} rms (noise {noise})", self.group.words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn misfit(chi2: f64, degrees_of_freedom: f64) -> GroupMisfit {
        GroupMisfit { group: ResidualGroup::MoveDirections, rms: 0.01, chi2, degrees_of_freedom }
    }

    #[test]
    fn an_excess_is_large_and_significant() {
        assert!(misfit(90.0, 20.0).exceeds_noise());
        // If noise is the only error, the ratio of four residuals is 2.2 or more in one of two thousand runs.
        assert!(!misfit(20.0, 4.0).exceeds_noise());
        // In a long recording, an excess of only 10 % over noise is significant.
        let long = misfit(12_100.0, 10_000.0);
        assert!(long.is_significant() && !long.exceeds_noise());
    }

    #[test]
    fn an_excess_is_displayed_beside_its_noise() {
        let words = misfit(180.0, 20.0).to_string();
        assert_eq!(words, "gravity direction after the moves 0.573 deg rms (noise 0.191 deg)");
    }
}
