//! The size of the Earth's rate is known, so an effect with its pattern and another size is something else.
//!
//! Its direction is free, because the heading is unknown and every latitude is possible.

use faer::Mat;
use imucal_core::EARTH_RATE_RADPS;

use super::evidence::Column;
use super::stage::Stage;

/// Name of the effect in the catalogue.
pub(super) const NAME: &str = "earth_rate";
/// Standard deviations within which an estimate agrees with the known size, and by which it must differ from zero.
const SURE: f64 = 3.0;
/// Factor by which the standard deviation of the last fit may differ from that of a search, which has constant biases.
const SLACK: f64 = 2.0;

/// Whether an estimated rate agrees with that of the Earth and differs significantly from zero.
pub(super) fn is_earth_rate(size_radps: f64, sigma_radps: f64) -> bool {
    may_be(size_radps, sigma_radps, 1.0)
}

/// The same if the standard deviation may be larger or smaller by a factor.
fn may_be(size_radps: f64, sigma_radps: f64, slack: f64) -> bool {
    let is_near = (size_radps - EARTH_RATE_RADPS).abs() <= SURE * slack * sigma_radps;
    is_near && sigma_radps <= slack * EARTH_RATE_RADPS / SURE
}

impl Stage {
    /// Size of `earth_rate` in this model and its standard deviation, rad/s, if it cannot be the Earth's rate whatever
    /// the standard deviation of the last fit will be.
    pub(super) fn not_the_earth(&self) -> Option<(f64, f64)> {
        let member = self.members.iter().find(|member| member.name == NAME)?;
        let own: Vec<usize> = self.place(NAME)?.collect();
        let mut columns = self.design.model.clone();
        // Without the prior of the search: the data alone must determine the rate.
        own.iter().for_each(|&k| columns[k] = Column { precision: 0.0, ..columns[k] });
        let covariance = self.design.gram.covariance(&columns, &self.evidence.scales, &own)?;
        let rate = Mat::from_fn(own.len(), 1, |k, _| member.values[k]);
        let size = rate.norm_l2();
        let sigma = (rate.transpose() * covariance * &rate)[(0, 0)].sqrt() / size;
        // If the standard deviation is not a number, the last fit decides.
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
