//! The two-stage fit (model.md (3) to (5), (7) to (9)). The accelerometer is estimated from the rests, and then the
//! gyroscope from the moves.

pub(crate) mod accelerometer;
pub(crate) mod ellipsoid;
pub(crate) mod gyroscope;
pub(crate) mod observability;
pub(crate) mod uncertainty;
