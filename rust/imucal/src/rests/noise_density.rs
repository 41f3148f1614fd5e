//! White noise of a recording, and the variances that it makes.

use nalgebra::{Matrix3, Vector3};

/// White-noise densities from the steady rests, or from the noise floor where a hand holds the unit throughout, in raw units per sqrt(Hz).
#[derive(Clone, Copy, Debug)]
pub struct NoiseDensity {
    /// Accelerometer x, y, z.
    pub specific_force: Vector3<f64>,
    /// Gyroscope x, y, z.
    pub angular_rate: Vector3<f64>,
}

/// Standard deviation of each direction component of a move that the gyroscope's white noise makes, rad.
pub(crate) fn random_walk_rad(density: &Vector3<f64>, inverse: &Matrix3<f64>, duration_s: f64) -> f64 {
    (variance_per_axis(inverse, density) * duration_s).sqrt()
}

/// Variance along each body axis, in SI units, of noise with these standard deviations or densities in raw units.
pub(crate) fn variance_by_axis(inverse: &Matrix3<f64>, raw: &Vector3<f64>) -> Vector3<f64> {
    (inverse * Matrix3::from_diagonal(raw)).map(|v| v * v).column_sum()
}

/// The mean of it over the axes.
pub(crate) fn variance_per_axis(inverse: &Matrix3<f64>, raw: &Vector3<f64>) -> f64 {
    variance_by_axis(inverse, raw).mean()
}
