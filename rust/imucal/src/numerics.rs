//! Numerical methods that know nothing of sensors: least squares, statistics, robust weights, derivatives, SIMD rows, threads.

pub(crate) mod aligned;
pub(crate) mod derivative;
pub(crate) mod lsq;
pub(crate) mod robust;
pub mod stats;
pub(crate) mod symmetric;
pub(crate) mod workers;
