//! The estimate in two stages: an ellipsoid fit of the accelerometer at rest, then the gyroscope from the moves between rests.

pub(crate) mod accelerometer;
pub(crate) mod ellipsoid;
pub(crate) mod gyroscope;
pub(crate) mod observability;
pub(crate) mod uncertainty;
