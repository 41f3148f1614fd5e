//! Estimate of the gyroscope bias as the random-effects mean over all rests (model.md (7)).

use nalgebra::Vector3;

use crate::numerics::stats::{MEDIAN_SIZE, median, random_effects_mean};
use crate::rests::rest::Rest;

/// Maximum deviation of the mean rate of a rest from the median of all rests, in robust standard deviations. With a
/// larger deviation, the interval contains a slow rotation and is not a rest.
const LIMIT: f64 = 6.0;

/// The gyroscope bias and the weights of the rests, for each axis separately.
#[derive(Clone, Debug)]
pub(crate) struct GyroscopeBias {
    /// Bias, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Weight of each rest for each axis. The weights of an axis have the sum one, and an excluded rest has the weight
    /// zero.
    pub(crate) weights: Vec<Vector3<f64>>,
    /// Variance of the bias between rests, squared raw units; tau^2 of model.md (7). It is estimated from the scatter
    /// of the mean rates in excess of their noise.
    pub(crate) between: Vector3<f64>,
}

impl GyroscopeBias {
    /// Result for a recording without a gyroscope: the bias is NaN, and no rest is excluded.
    pub(crate) fn absent(rests: usize) -> Self {
        let none = Vector3::repeat(f64::NAN);
        Self { bias: none, weights: vec![Vector3::repeat(1.0 / rests as f64); rests], between: none }
    }
}

/// Estimates the bias. The weights are computed from the noise of each rest and the scatter between rests. At least one
/// rest is required. For each rest, `wander` is the variance of the mean rates between its epochs, squared raw units;
/// zero for a rest without epochs. An epoch is a part of a long rest with its own mean. `wander` is added to the
/// variance from noise, because the bias may differ between rests by as much as it changes within a rest.
pub(crate) fn bias_from_rests(rests: &[&Rest], wander: &[Vector3<f64>]) -> GyroscopeBias {
    let mut result = GyroscopeBias {
        bias: Vector3::zeros(),
        weights: vec![Vector3::zeros(); rests.len()],
        between: Vector3::zeros(),
    };
    for axis in 0..3 {
        let means: Vec<f64> = rests.iter().map(|rest| rest.angular_rate.mean[axis]).collect();
        // Lower bound of the variance. In simulated data without noise, the variance would be zero.
        let variance = |(rest, wander): (&&Rest, &Vector3<f64>)| {
            (rest.angular_rate.whole_variance()[axis] + wander[axis]).max(1e-30)
        };
        let variances: Vec<f64> = rests.iter().zip(wander).map(variance).collect();
        let kept = kept(&means, &variances);
        let pick = |values: &[f64]| kept.iter().map(|&k| values[k]).collect::<Vec<f64>>();
        let mean = random_effects_mean(&pick(&means), &pick(&variances));
        result.bias[axis] = mean.mean;
        result.between[axis] = mean.between;
        for (&k, weight) in kept.iter().zip(mean.weights) {
            result.weights[k][axis] = weight;
        }
    }
    result
}

/// Indices of the rests that are not excluded: score <= [`LIMIT`] x scale. The score of a rest is |mean - median| /
/// standard deviation of its mean. The scale is the robust scatter of the scores of all rests.
fn kept(means: &[f64], variances: &[f64]) -> Vec<usize> {
    let centre = median(&mut means.to_vec());
    let scores: Vec<f64> = means.iter().zip(variances).map(|(m, v)| (m - centre).abs() / v.sqrt()).collect();
    // Median of the scores / median of |z| for a standard normal variable z, and at least 1.
    let scale = (median(&mut scores.clone()) / MEDIAN_SIZE).max(1.0);
    (0..means.len()).filter(|&k| scores[k] <= LIMIT * scale).collect()
}
