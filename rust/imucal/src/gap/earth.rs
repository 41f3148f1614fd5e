//! The rate of the Earth is known: what has its pattern and another size is something else.
//!
//! Its direction is free, for the heading is not known and every latitude is possible.

use faer::Mat;
use imucal_core::EARTH_RATE_RADPS;

use super::evidence::Column;
use super::stage::Stage;

/// The effect that this is about.
pub(super) const NAME: &str = "earth_rate";
/// By so many standard deviations a known number is met, and is determined.
const SURE: f64 = 3.0;
/// By which the last fit may say another standard deviation than a search, whose biases do not wander.
const SLACK: f64 = 2.0;

/// Whether a rate is that of the Earth, and is determined.
pub fn is_earth_rate(size_radps: f64, sigma_radps: f64) -> bool {
    may_be(size_radps, sigma_radps, 1.0)
}

/// The same where the standard deviation may be larger or smaller by a factor.
fn may_be(size_radps: f64, sigma_radps: f64, slack: f64) -> bool {
    let is_near = (size_radps - EARTH_RATE_RADPS).abs() <= SURE * slack * sigma_radps;
    is_near && sigma_radps <= slack * EARTH_RATE_RADPS / SURE
}

impl Stage {
    /// The size of `earth_rate` in this model and its standard deviation, rad/s, if that is not the Earth's or not determined, whatever
    /// the last fit will say.
    pub(super) fn not_the_earth(&self) -> Option<(f64, f64)> {
        let member = self.members.iter().find(|member| member.name == NAME)?;
        let own: Vec<usize> = self.place(NAME)?.collect();
        let mut columns = self.design.model.clone();
        // The prior is that of a search, and the data are to say it.
        own.iter().for_each(|&k| columns[k] = Column { precision: 0.0, ..columns[k] });
        let covariance = self.design.gram.covariance(&columns, &self.evidence.scales, &own)?;
        let rate = Mat::from_fn(own.len(), 1, |k, _| member.values[k]);
        let size = rate.norm_l2();
        let sigma = (rate.transpose() * covariance * &rate)[(0, 0)].sqrt() / size;
        // What is not a number is left to the last fit.
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
