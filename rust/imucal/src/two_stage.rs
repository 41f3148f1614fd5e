//! The two-stage fit (model.md (3) to (5), (7) to (9)). The first stage estimates the accelerometer from the rests
//! (intervals without motion). The second stage estimates the gyroscope from the moves (the rotations between
//! consecutive rests).

pub(crate) mod accelerometer;
pub(crate) mod ellipsoid;
pub(crate) mod gyroscope;
pub(crate) mod observability;
pub(crate) mod uncertainty;
