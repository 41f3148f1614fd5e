//! White-noise densities of a recording. Computes the variances that this noise causes along the body axes and in
//! integrated angles (model.md (8), (10)).

use nalgebra::{Matrix3, Vector3};

/// White-noise densities, raw units per sqrt(Hz) (model.md (10)). They are estimated from the steady rests (rests that
/// are not hand-held). If all rests are hand-held, the densities are computed from the noise variance that the rest
/// detection has estimated.
#[derive(Clone, Copy, Debug)]
pub struct NoiseDensity {
    /// Densities of the accelerometer axes x, y, z.
    pub specific_force: Vector3<f64>,
    /// Densities of the gyroscope axes x, y, z.
    pub angular_rate: Vector3<f64>,
}

/// Angle random walk of model.md (8), rad: the standard deviation of the angle error that white noise of the gyroscope
/// causes if the rate is integrated over `duration_s` (rms over the three axes). `density` is in raw units per
/// sqrt(Hz), and `inverse` is the inverse sensitivity.
pub(crate) fn random_walk_rad(density: &Vector3<f64>, inverse: &Matrix3<f64>, duration_s: f64) -> f64 {
    (variance_per_axis(inverse, density) * duration_s).sqrt()
}

/// Variance of the noise along each body axis, squared SI units. `raw` contains the standard deviation of the noise of
/// each sensor axis in raw units. If `raw` contains noise densities instead, the result is the squared noise density
/// along each body axis. `inverse` is the inverse sensitivity of the triad.
pub(crate) fn variance_by_axis(inverse: &Matrix3<f64>, raw: &Vector3<f64>) -> Vector3<f64> {
    (inverse * Matrix3::from_diagonal(raw)).map(|v| v * v).column_sum()
}

/// Mean over the three axes of the variances that [`variance_by_axis`] returns.
pub(crate) fn variance_per_axis(inverse: &Matrix3<f64>, raw: &Vector3<f64>) -> f64 {
    variance_by_axis(inverse, raw).mean()
}
