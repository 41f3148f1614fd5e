//! Numerical methods without sensor models: least squares, statistics, detection of outliers, differentiation of noisy
//! data, symmetric and dense matrices, eigenvalues, memory aligned for SIMD, and threads.

pub(crate) mod aligned;
pub(crate) mod blocked;
pub(crate) mod derivative;
pub(crate) mod fit_report;
pub(crate) mod gaussian;
pub(crate) mod instructions;
pub(crate) mod leading_eigen;
pub(crate) mod lsq;
pub(crate) mod robust;
pub(crate) mod second_order;
pub mod stats;
pub(crate) mod symmetric;
pub(crate) mod workers;
