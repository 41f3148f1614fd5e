//! The bias as the mean over all rests (model.md (7)).

use nalgebra::Vector3;

use crate::numerics::stats::{MEDIAN_SIZE, median, random_effects_mean};
use crate::rests::rest::Rest;

/// A rest whose mean rate is further than this from the median, in robust standard deviations, is none.
const LIMIT: f64 = 6.0;

/// The bias and what it is made of, one axis each.
#[derive(Clone, Debug)]
pub(crate) struct GyroscopeBias {
    /// The bias, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Weight of each rest per axis; they sum to one. Zero for a rest that was left out.
    pub(crate) weights: Vec<Vector3<f64>>,
    /// Variance from one rest to the next beyond each rest's own noise, raw units squared.
    pub(crate) between: Vector3<f64>,
}

/// The bias, each rest weighted by its own noise and the scatter between rests. At least one rest is needed.
pub(crate) fn bias_from_rests(rests: &[&Rest]) -> GyroscopeBias {
    let mut result = GyroscopeBias {
        bias: Vector3::zeros(),
        weights: vec![Vector3::zeros(); rests.len()],
        between: Vector3::zeros(),
    };
    for axis in 0..3 {
        let means: Vec<f64> = rests.iter().map(|rest| rest.angular_rate.mean[axis]).collect();
        // A noise-free simulation has no scatter at all.
        let variances: Vec<f64> = rests.iter().map(|r| r.angular_rate.variance_of_mean[axis].max(1e-30)).collect();
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

/// Indices of the rests that are near the median, in units of their own noise and of the scatter of all.
fn kept(means: &[f64], variances: &[f64]) -> Vec<usize> {
    let centre = median(&mut means.to_vec());
    let scores: Vec<f64> = means.iter().zip(variances).map(|(m, v)| (m - centre).abs() / v.sqrt()).collect();
    // The median of |z| of a normal distribution.
    let scale = (median(&mut scores.clone()) / MEDIAN_SIZE).max(1.0);
    (0..means.len()).filter(|&k| scores[k] <= LIMIT * scale).collect()
}
