//! Tests whether an estimated constant rate is the rate of the Earth. The magnitude of the Earth's rate is known. An
//! estimate with a significantly different magnitude therefore has another cause.
//!
//! The direction of the Earth's rate is not tested, because heading and latitude are unknown.

use faer::Mat;
use imucal_core::EARTH_RATE_RADPS;

use super::evidence::Column;
use super::stage::Stage;

/// Name, in the catalogue, of the effect that describes the Earth's rate.
pub(super) const NAME: &str = "earth_rate";
/// Threshold of two tests, in standard deviations sigma of the estimated rate w. The estimate agrees with the Earth's
/// rate W if |w - W| <= SURE x sigma. The Earth's rate is detectable if W >= SURE x sigma.
const SURE: f64 = 3.0;
/// The standard deviations of the rate in the search and in the final fit may differ by up to this factor. They differ
/// because the search assumes constant biases, whereas the final fit estimates slowly varying biases.
const SLACK: f64 = 2.0;

/// Whether an estimated rate agrees with the Earth's rate, and is so accurate that the Earth's rate is detectable.
pub(super) fn is_earth_rate(size_radps: f64, sigma_radps: f64) -> bool {
    may_be(size_radps, sigma_radps, 1.0)
}

/// The test of [`is_earth_rate`] with a tolerance: the true standard deviation may be larger or smaller than
/// `sigma_radps` by up to the factor `slack`.
fn may_be(size_radps: f64, sigma_radps: f64, slack: f64) -> bool {
    let is_near = (size_radps - EARTH_RATE_RADPS).abs() <= SURE * slack * sigma_radps;
    is_near && sigma_radps <= slack * EARTH_RATE_RADPS / SURE
}

impl Stage {
    /// Magnitude and standard deviation, rad/s, of the rate that the effect `earth_rate` describes in this model, if
    /// this rate is not the Earth's rate. `None` if the model does not have the effect, or if its rate agrees with the
    /// Earth's rate. The test allows for a standard deviation that is wrong by up to the factor [`SLACK`].
    pub(super) fn not_the_earth(&self) -> Option<(f64, f64)> {
        let member = self.members.iter().find(|member| member.name == NAME)?;
        let own: Vec<usize> = self.place(NAME)?.collect();
        let mut columns = self.design.model.clone();
        // The covariance is computed without the prior, which would make the standard deviation of the rate too small.
        own.iter().for_each(|&k| columns[k] = Column { precision: 0.0, ..columns[k] });
        let covariance = self.design.gram.covariance(&columns, &self.evidence.scales, &own)?;
        let rate = Mat::from_fn(own.len(), 1, |k, _| member.values[k]);
        let size = rate.norm_l2();
        let sigma = (rate.transpose() * covariance * &rate)[(0, 0)].sqrt() / size;
        // If the standard deviation is NaN, the test is not possible. The function then returns `None`, and the rate is
        // tested after the final fit.
        (!sigma.is_nan() && !may_be(size, sigma, SLACK)).then_some((size, sigma))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_earth_is_met_by_its_rate_and_by_what_is_sure_of_it() {
        assert!(is_earth_rate(7.4e-5, 1e-6));
        assert!(!is_earth_rate(7.8e-5, 1e-6));
        assert!(!is_earth_rate(7.3e-5, 3e-5));
    }
}
