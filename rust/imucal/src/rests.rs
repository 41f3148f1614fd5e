//! Rests of a recording, their noise, the moves between them, and the tremor of a hand.

pub(crate) mod moves;
pub(crate) mod segment;
pub(crate) mod tremor;

pub use segment::{NoiseDensity, Rest, RestMean, Segments, Threshold, sample_interval_s};
