//! Numerical methods without sensor models: least squares, statistics, detection of outliers, differentiation of noisy
//! data, symmetric matrices, memory aligned for SIMD, and threads.

pub(crate) mod aligned;
pub(crate) mod derivative;
pub(crate) mod fit_report;
pub(crate) mod gaussian;
pub(crate) mod instructions;
pub(crate) mod lsq;
pub(crate) mod robust;
pub(crate) mod second_order;
pub mod stats;
pub(crate) mod symmetric;
pub(crate) mod workers;
