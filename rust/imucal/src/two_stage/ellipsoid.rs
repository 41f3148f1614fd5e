//! Fits an ellipsoid to the mean readings of the accelerometer at the rests. The fit is algebraic and gives the start
//! values of the accelerometer parameters (model.md (3), (4)).
//!
//! Without noise, a mean reading a satisfies |T^-1 (a - b)| = g. The mean readings therefore lie on an ellipsoid, whose
//! equation is linear in the ten unknowns alpha:
//!
//! ```text
//! [ax^2, ay^2, az^2, 2 ax ay, 2 ax az, 2 ay az, ax, ay, az, 1] . alpha = 0
//! alpha = [W11, W22, W33, W12, W13, W23, -2 W b, b^T W b - g^2],   W = (T T^T)^-1
//! ```
//!
//! T is the sensitivity, b the bias, and g local gravity. ax, ay and az are the components of a. The vector -2 W b
//! gives three of the ten unknowns.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use crate::error::Error;
use crate::frame::square_root;
use crate::numerics::lsq;

/// Start value of the accelerometer. The sensitivity T is symmetric and positive definite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    /// Sensitivity T, raw units per m/s^2.
    pub(crate) sensitivity: Matrix3<f64>,
    /// Bias b, raw units.
    pub(crate) bias: Vector3<f64>,
}

/// The mean readings determine a sphere only if the smallest singular value of the design matrix of the sphere is at
/// least this fraction of the largest singular value. If all mean readings are in one plane, the smallest singular
/// value is zero without noise, and below this limit with typical noise. [`smallest_sphere`] omits all directions whose
/// singular value is below this limit.
const LEAST_SINGULAR: f64 = 1e-3;

/// Fits an ellipsoid to the mean readings `means` (one for each rest, in any raw unit), or a sphere if the mean
/// readings do not determine an ellipsoid.
///
/// Returns `None` if there are fewer than four means, or if all means are in one plane, because they then do not
/// determine a sphere.
///
/// # Errors
/// [`Error::Fit`] if the singular value decomposition fails.
pub(crate) fn fit(means: &[Vector3<f64>], gravity_mps2: f64) -> Result<Option<Start>, Error> {
    // The points are centred and scaled. All columns of the design matrix are then of order one in any raw unit, also
    // for counts with an offset.
    let Some((centre, size)) = extent(means).filter(|_| means.len() >= 4) else { return Ok(None) };
    let points: Vec<Vector3<f64>> = means.iter().map(|mean| (mean - centre) / size).collect();
    let unit = match ellipsoid(&points)? {
        Some(start) => Some(start),
        None => sphere(&points)?,
    };
    Ok(unit.map(|start| Start {
        sensitivity: start.sensitivity * (size / gravity_mps2),
        bias: centre + start.bias * size,
    }))
}

/// Fits a sphere to the mean readings `means`. The unknowns are those of [`sphere`], with the midpoint of the means as
/// the origin. If the poses do not determine a unique sphere, the least-squares solution with the smallest norm of the
/// unknowns is returned, so the centre of the sphere is near this midpoint. Returns `None` if all means are equal, or
/// if the fitted radius is zero.
pub(crate) fn smallest_sphere(means: &[Vector3<f64>], gravity_mps2: f64) -> Result<Option<Start>, Error> {
    let Some((centre, size)) = extent(means) else { return Ok(None) };
    let points: Vec<Vector3<f64>> = means.iter().map(|mean| (mean - centre) / size).collect();
    let design = Mat::from_fn(points.len(), 4, |k, j| if j < 3 { 2.0 * points[k][j] } else { 1.0 });
    let (values, vectors) = lsq::singular(&design)?;
    let mut solution = [0.0; 4];
    for k in (0..4).filter(|&k| values[k] > LEAST_SINGULAR * values[0]) {
        let along = |row: usize| (0..4).map(|j| design[(row, j)] * vectors[(j, k)]).sum::<f64>();
        let seen: f64 = points.iter().enumerate().map(|(row, point)| along(row) * point.norm_squared()).sum();
        for (j, entry) in solution.iter_mut().enumerate() {
            *entry += vectors[(j, k)] * seen / values[k].powi(2);
        }
    }
    let bias = Vector3::from_column_slice(&solution[..3]);
    let radius = (solution[3] + bias.norm_squared()).max(0.0).sqrt();
    let sensitivity = Matrix3::from_diagonal_element(radius * size / gravity_mps2);
    Ok((radius > 0.0).then(|| Start { sensitivity, bias: centre + bias * size }))
}

/// Midpoint of the axis-parallel box around the means, and half of its largest width; `None` if this width is zero.
fn extent(means: &[Vector3<f64>]) -> Option<(Vector3<f64>, f64)> {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for mean in means {
        low = low.inf(mean);
        high = high.sup(mean);
    }
    let size = (high - low).max() / 2.0;
    (size > 0.0).then(|| ((low + high) / 2.0, size))
}

/// Fits the ellipsoid |T^-1 (a - b)| = 1 to the points a. Returns `None` if there are fewer than nine points, if more
/// than one quadric passes through the points, or if the fitted quadric is not an ellipsoid.
fn ellipsoid(points: &[Vector3<f64>]) -> Result<Option<Start>, Error> {
    if points.len() < 9 {
        return Ok(None);
    }
    let design = Mat::from_fn(points.len(), 10, |k, j| {
        let a = points[k];
        match j {
            0..3 => a[j] * a[j],
            3 => 2.0 * a.x * a.y,
            4 => 2.0 * a.x * a.z,
            5 => 2.0 * a.y * a.z,
            6..9 => a[j - 6],
            _ => 1.0,
        }
    });
    let (values, vectors) = lsq::singular(&design)?;
    if values[8] < 1e-9 * values[0] {
        return Ok(None); // more than one quadric passes through the points
    }
    let alpha: Vec<f64> = (0..10).map(|i| vectors[(i, 9)]).collect();
    let sign = (alpha[0] + alpha[1] + alpha[2]).signum();
    let w =
        sign * Matrix3::new(alpha[0], alpha[3], alpha[4], alpha[3], alpha[1], alpha[5], alpha[4], alpha[5], alpha[2]);
    let Some(w_inverse) = w.try_inverse() else {
        return Ok(None);
    };
    let bias = w_inverse * Vector3::new(alpha[6], alpha[7], alpha[8]) * (-0.5 * sign);
    let scale = (bias.transpose() * w * bias).x - sign * alpha[9];
    Ok(square_root(&(w_inverse * scale)).map(|sensitivity| Start { sensitivity, bias }))
}

/// Fits a sphere to the points a by the equation |a|^2 = 2 a . b + (r^2 - |b|^2), where b is the centre and r the
/// radius of the sphere. The equation is linear in the unknowns b and r^2 - |b|^2. Returns `None` if the points are
/// nearly in one plane.
fn sphere(points: &[Vector3<f64>]) -> Result<Option<Start>, Error> {
    let design = Mat::from_fn(points.len(), 4, |k, j| if j < 3 { 2.0 * points[k][j] } else { 1.0 });
    let (values, _) = lsq::singular(&design)?;
    if values[3] < LEAST_SINGULAR * values[0] {
        return Ok(None);
    }
    let gain = lsq::gain(&design);
    let squares = Mat::from_fn(points.len(), 1, |k, _| points[k].norm_squared());
    let solution = gain * squares;
    let bias = Vector3::new(solution[(0, 0)], solution[(1, 0)], solution[(2, 0)]);
    let radius_squared = solution[(3, 0)] + bias.norm_squared();
    Ok((radius_squared > 0.0)
        .then(|| Start { sensitivity: Matrix3::from_diagonal_element(radius_squared.sqrt()), bias }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `n` directions distributed evenly over the sphere (golden-angle spiral).
    fn directions(n: usize) -> Vec<Vector3<f64>> {
        (0..n)
            .map(|k| {
                let z = 1.0 - (2 * k + 1) as f64 / n as f64;
                let (sin, cos) = (k as f64 * 2.399_963).sin_cos();
                Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
            })
            .collect()
    }

    #[test]
    fn recovers_a_unit_in_counts_with_an_offset() {
        let t = Matrix3::new(414.0, 3.0, -5.0, 3.0, 411.0, 2.0, -5.0, 2.0, 416.0);
        let b = Vector3::new(33_124.0, 33_275.0, 32_364.0);
        let means: Vec<_> = directions(24).iter().map(|u| t * u * 9.81 + b).collect();
        let start = fit(&means, 9.81).unwrap().unwrap();
        assert!((start.sensitivity - t).abs().max() < 1e-8, "{}", start.sensitivity);
        assert!((start.bias - b).abs().max() < 1e-7);
    }

    #[test]
    fn eight_points_give_a_sphere_and_a_plane_gives_nothing() {
        let means: Vec<_> = directions(8).iter().map(|u| u * 9.81 + Vector3::new(0.1, 0.0, -0.2)).collect();
        let start = fit(&means, 9.81).unwrap().unwrap();
        assert!((start.sensitivity - Matrix3::identity()).abs().max() < 1e-10);
        let circle: Vec<_> = (0..12).map(|k| Vector3::new((k as f64).cos(), (k as f64).sin(), 0.3)).collect();
        assert!(fit(&circle, 9.81).unwrap().is_none());
    }
}
