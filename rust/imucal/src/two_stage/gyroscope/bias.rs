//! Estimates the gyroscope bias as the random-effects mean of the mean rates at the rests (model.md (7)).

use nalgebra::Vector3;

use crate::numerics::stats::{MEDIAN_SIZE, median, random_effects_mean};
use crate::rests::rest::Rest;

/// Maximum difference between a rest's mean rate and the median of the mean rates at all rests, in standard deviations
/// of this difference. An interval with a larger difference is assumed to contain a slow rotation, so it is not used as
/// a rest.
const LIMIT: f64 = 6.0;

/// The gyroscope bias and the weights of the rests, for each axis separately.
#[derive(Clone, Debug)]
pub(crate) struct GyroscopeBias {
    /// Bias, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Weight of each rest for each axis. For each axis, the sum of the weights over the rests is one. An excluded rest
    /// has the weight zero.
    pub(crate) weights: Vec<Vector3<f64>>,
    /// Variance of the bias from rest to rest, squared raw units; tau^2 of model.md (7). It is estimated from the
    /// scatter of the mean rates in excess of their noise.
    pub(crate) between: Vector3<f64>,
}

impl GyroscopeBias {
    /// Result for a recording without a gyroscope. The bias is NaN, and all rests have equal weights, so no rest is
    /// excluded.
    pub(crate) fn absent(rests: usize) -> Self {
        let none = Vector3::repeat(f64::NAN);
        Self { bias: none, weights: vec![Vector3::repeat(1.0 / rests as f64); rests], between: none }
    }
}

/// Estimates the bias as a weighted mean of the mean rates at the rests. The weights are computed from the noise of
/// each mean rate and the scatter of the mean rates from rest to rest. At least one rest is required.
///
/// A long rest is divided into epochs, each with its own mean. For each rest, `wander` is the variance of the mean rate
/// from epoch to epoch, squared raw units; zero for a rest without epochs. `wander` is added to the variance from
/// noise, because the bias may change from rest to rest by as much as within a rest.
pub(crate) fn bias_from_rests(rests: &[&Rest], wander: &[Vector3<f64>]) -> GyroscopeBias {
    let mut result = GyroscopeBias {
        bias: Vector3::zeros(),
        weights: vec![Vector3::zeros(); rests.len()],
        between: Vector3::zeros(),
    };
    for axis in 0..3 {
        let means: Vec<f64> = rests.iter().map(|rest| rest.angular_rate.mean[axis]).collect();
        // The variance has a lower bound of 1e-30 squared raw units. Without this bound, the variance would be zero and
        // the weights infinite in simulated data without noise.
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

/// Indices of the rests that are not excluded (model.md (7)).
///
/// The mean rate of a rest is compared with the median of the mean rates at all rests. The difference has three causes:
/// the noise of the rest, the scatter from rest to rest, and the error of the median. If only the noise of the rest
/// were considered, the rest with the least noise would be excluded first, for example a rest on a table before a
/// hand-held run.
fn kept(means: &[f64], variances: &[f64]) -> Vec<usize> {
    let centre = median(&mut means.to_vec());
    let squares: Vec<f64> = means.iter().map(|mean| (mean - centre).powi(2)).collect();
    // Robust estimate of the variance from rest to rest, in addition to noise. With this value, half of the mean rates
    // deviate from their median by less than `MEDIAN_SIZE` standard deviations, as is expected for normal variables.
    let excess = |(square, variance): (&f64, &f64)| square / MEDIAN_SIZE.powi(2) - variance;
    let between = median(&mut squares.iter().zip(variances).map(excess).collect::<Vec<f64>>()).max(0.0);
    let typical = median(&mut variances.to_vec()) + between;
    // The variance of the median of n normal variables is pi / 2 times that of their mean.
    let of_centre = std::f64::consts::FRAC_PI_2 * typical / means.len() as f64;
    let limit = |k: usize| LIMIT.powi(2) * (variances[k] + between + of_centre);
    (0..means.len()).filter(|&k| squares[k] <= limit(k)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean rate about x at each of ten rests of an MPU-6050, and the standard deviation of its noise, both in counts.
    /// The first rest lasts 37 s on a table, and the others are hand-held.
    const HELD: [(f64, f64); 10] = [
        (-427.4, 0.1),
        (-379.6, 10.0),
        (-385.5, 3.4),
        (-412.2, 1.6),
        (-446.1, 6.4),
        (-423.8, 10.6),
        (-428.6, 3.3),
        (-416.2, 1.3),
        (-429.3, 1.3),
        (-422.4, 0.8),
    ];

    fn kept_of(rests: &[(f64, f64)]) -> Vec<usize> {
        let (means, variances): (Vec<f64>, Vec<f64>) = rests.iter().map(|(mean, std)| (*mean, std * std)).unzip();
        kept(&means, &variances)
    }

    #[test]
    fn a_rest_on_a_table_agrees_with_hand_held_rests() {
        for std in [1.0, 0.1, 0.01, 1e-6] {
            let rests: Vec<_> = [(-427.4, std)].into_iter().chain(HELD[1..].iter().copied()).collect();
            assert_eq!(kept_of(&rests), Vec::from_iter(0..10), "{std}");
        }
        // The noise of the first twelve rests explains the scatter of their mean rates. The last rest has little noise,
        // but the median with which its mean rate is compared is less accurate. Therefore, the last rest must not be
        // excluded.
        let noisy: Vec<_> = (0..12).map(|k| (f64::from(k) - 2.5, 5.0)).chain([(0.0, 0.01)]).collect();
        assert_eq!(kept_of(&noisy), Vec::from_iter(0..13));
    }

    #[test]
    fn a_slow_rotation_is_not_a_rest() {
        let rotating = |rests: &[(f64, f64)], rate: f64| {
            let mut rests = rests.to_vec();
            rests[3].0 += rate;
            kept_of(&rests)
        };
        let others = [0, 1, 2, 4, 5, 6, 7, 8, 9];
        assert_eq!(rotating(&HELD, 300.0), others);
        let on_a_table: Vec<_> = (0..10).map(|k| (f64::from(k * 7 % 10) * 0.05, 0.2)).collect();
        assert_eq!(rotating(&on_a_table, 0.2), Vec::from_iter(0..10));
        assert_eq!(rotating(&on_a_table, 2.0), others);
    }
}
