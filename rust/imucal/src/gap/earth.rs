//! The rate of the Earth is known: what has its pattern and another size is something else.
//!
//! Its direction is free, for the heading is not known and every latitude is possible.

use imucal_core::EARTH_RATE_RADPS;
use nalgebra::{DMatrix, DVector};

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
    (size_radps - EARTH_RATE_RADPS).abs() <= SURE * sigma_radps && sigma_radps <= EARTH_RATE_RADPS / SURE
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
        let covariance = DMatrix::from_fn(own.len(), own.len(), |i, k| covariance[(i, k)]);
        let rate = DVector::from_column_slice(&member.values);
        let size = rate.norm();
        let sigma = (rate.dot(&(covariance * &rate)).sqrt()) / size;
        let (least, most) = (sigma / SLACK, sigma * SLACK);
        let is_off = (size - EARTH_RATE_RADPS).abs() > SURE * most;
        (is_off || least > EARTH_RATE_RADPS / SURE).then_some((size, sigma))
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
