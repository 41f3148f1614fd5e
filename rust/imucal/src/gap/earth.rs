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

impl Stage {
    /// The size of `earth_rate` in this model and its standard deviation, rad/s, if that is not the Earth's or not determined.
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
        let is_met = (size - EARTH_RATE_RADPS).abs() <= SURE * sigma && sigma <= EARTH_RATE_RADPS / SURE;
        (!is_met).then_some((size, sigma))
    }
}
