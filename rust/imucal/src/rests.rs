//! Detects the rests in a recording and the moves between them. Estimates the white noise of the sensors and the tremor
//! of the hand that holds the unit.

mod colour;
#[cfg(test)]
mod example;
pub(crate) mod moves;
mod noise_check;
pub(crate) mod noise_density;
pub(crate) mod rest;
mod rounded;
pub(crate) mod segment;
mod sway;
pub(crate) mod tremor;
pub(crate) mod unit_rest;

pub use noise_density::NoiseDensity;
pub use rest::{Rest, RestMean};
pub use segment::{MIN_REST_S, Segments, Threshold};
