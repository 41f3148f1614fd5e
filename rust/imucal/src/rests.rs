//! Rests of a recording, their noise, the moves between them, and the tremor of a hand.

pub(crate) mod moves;
pub(crate) mod noise_density;
pub(crate) mod rest;
pub(crate) mod segment;
pub(crate) mod tremor;
pub(crate) mod unit_rest;

pub use noise_density::NoiseDensity;
pub use rest::{Rest, RestMean};
pub use segment::{MIN_REST_S, Segments, Threshold};
