//! Estimates by which factor a low-pass filter in the accelerometer reduces the noise density that is computed from
//! differences of consecutive samples (model.md (27)).
//!
//! Rotations of the unit, and thus the rotational tremor of the hand, do not change the magnitude of the specific
//! force. The noise density of this magnitude is computed from differences of consecutive means, each over a block of
//! samples. White noise has the same density for all block durations and all orders of the difference. A low-pass
//! filter lowers the density for short blocks.

use imucal_core::sensor::Triad;

use crate::numerics::fit_report::significance_limit;
use crate::recording::Recording;
use crate::rests::rest::Rest;

/// Order of the differences of consecutive samples from which the noise of the sensors is estimated.
const FOURTH: usize = 4;
/// Order of the differences of block means with which a filter is detected and the noise at low frequencies is
/// estimated. Slow motion of the hand hardly changes differences of this high order.
const EIGHTH: usize = 8;
/// Maximum duration of the shorter blocks in the detection of a filter, s. A filter is detected if, for any such
/// duration, the density increases significantly from blocks of this duration to blocks that are twice as long. For
/// longer blocks, translational tremor of 3 to 12 Hz changes the differences. Below 100 samples/s, no filter is
/// detected, because even a block of one sample is longer than `DETECT_S`.
const DETECT_S: f64 = 0.01;
/// Duration of the blocks from whose means the noise density at low frequencies is estimated, s. The low-pass filters
/// of common sensors (bandwidths of 10 Hz and above) lower the squared density of these means by less than a third.
/// Sway below 3 Hz hardly changes the eighth differences of these means.
const SLOW_S: f64 = 0.1;

/// Ratio of two estimates of the noise variance of the magnitude of the force: the estimate from eighth differences of
/// means over [`SLOW_S`], divided by the estimate from fourth differences of consecutive samples. Each sample occurs in
/// `every` consecutive rows, and `interval_s` is the interval between distinct samples. The result is `None` if no
/// filter is detected or if the ratio does not significantly exceed one, because the noise may then be white.
pub(super) fn colour_factor(
    recording: &Recording<'_>,
    rests: &[&Rest],
    accelerometer: &Triad<f64>,
    every: usize,
    interval_s: f64,
) -> Option<f64> {
    let magnitude = |row: &[f64; 3]| accelerometer.correct((*row).into()).norm();
    let forces = |rest: &&Rest| {
        recording.specific_force.part(rest.first..rest.end).iter().step_by(every).map(magnitude).collect::<Vec<f64>>()
    };
    let forces: Vec<Vec<f64>> = rests.iter().map(forces).collect();
    let eighth = |block: usize| Density::of(&forces, block, EIGHTH);
    let filtered = |block: usize| eighth(2 * block).exceeds(&eighth(block));
    let samples = forces.iter().map(Vec::len).max().unwrap_or(0);
    let longest = ((DETECT_S / interval_s * (1.0 + 1e-6)) as usize).min(samples);
    if !std::iter::successors(Some(1), |block| Some(2 * block)).take_while(|block| *block <= longest).any(filtered) {
        return None;
    }
    let slow = eighth(((SLOW_S / interval_s).round() as usize).max(1));
    let fast = Density::of(&forces, 1, FOURTH);
    slow.exceeds(&fast).then(|| slow.variance / fast.variance)
}

/// Noise variance that is estimated from differences of consecutive block means.
struct Density {
    /// (Variance of the block means) x (samples per block), (m/s^2)^2. For white noise, this product is the variance of
    /// one sample.
    variance: f64,
    /// Equivalent degrees of freedom of `variance` for white noise.
    degrees_of_freedom: f64,
}

impl Density {
    /// Estimates the variance from differences of order `order` of the means over blocks of `block` samples.
    fn of(rests: &[Vec<f64>], block: usize, order: usize) -> Self {
        let (mut sum, mut count) = (0.0, 0.0);
        for rest in rests {
            let mut values: Vec<f64> =
                rest.chunks_exact(block).map(|part| part.iter().sum::<f64>() / block as f64).collect();
            for _ in 0..order {
                values = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
            }
            sum += values.iter().map(|value| value * value).sum::<f64>();
            count += values.len() as f64;
        }
        // The squared coefficients of a difference of order n have the sum C(2 n, n), a binomial coefficient.
        // Consecutive differences are correlated, and their squared correlations over all lags have the sum
        // C(4 n, 2 n) / C(2 n, n)^2. The number of differences divided by this sum is the number of degrees of freedom.
        let squares = central_binomial(order);
        let correlation = central_binomial(2 * order) / (squares * squares);
        Self { variance: sum / (squares * count) * block as f64, degrees_of_freedom: count / correlation }
    }

    /// Whether this variance is significantly larger than the variance of `other`.
    fn exceeds(&self, other: &Self) -> bool {
        // The relative error of each variance has the variance 2 / (degrees of freedom). These variances add up in the
        // ratio, so `both` is the number of degrees of freedom of the ratio.
        let both = 1.0 / (1.0 / self.degrees_of_freedom + 1.0 / other.degrees_of_freedom);
        self.variance > other.variance * significance_limit(both)
    }
}

/// The binomial coefficient C(2 n, n).
fn central_binomial(n: usize) -> f64 {
    (1..=n).map(|k| (n + k) as f64 / k as f64).product()
}

#[cfg(test)]
mod tests {
    use crate::rests::example::{hand, simulated};
    use crate::rests::tremor::Hand;
    use crate::simulate::motion::Motion;
    use crate::simulate::tumble::{HandMoves, Tumble};
    use crate::simulate::{Program, RandomMoves, Stand, Unit};

    /// Two first-order low-pass filters of about 16 Hz at 100 samples/s, in series.
    fn filter(rows: &mut [[f64; 3]]) {
        for _ in 0..2 {
            let mut state = rows[0];
            for row in &mut *rows {
                state = std::array::from_fn(|axis| state[axis] + (row[axis] - state[axis]) * 0.63);
                *row = state;
            }
        }
    }

    /// The model of the hand, estimated from a simulated recording at 100 Hz. Both sensors are filtered if `filtered`.
    fn found(motion: &Motion, filtered: bool, seed: u64) -> Option<Hand> {
        let unit = Unit::paper();
        let mut run = simulated(motion, &unit, 100.0, seed);
        if filtered {
            filter(&mut run.specific_force);
            filter(&mut run.angular_rate);
        }
        hand(&run.recording("run"), &unit)
    }

    #[test]
    fn the_noise_of_a_filtered_accelerometer_is_that_before_the_filter() {
        let moves = HandMoves { poses: 15, tremor_rad: 0.2_f64.to_radians(), ..HandMoves::default() };
        let motion = Motion::Tumble(Tumble::random(&moves, 2).unwrap());
        for filtered in [false, true] {
            let hand = found(&motion, filtered, 3).unwrap();
            for noise in &hand.noise.specific_force {
                let ratio = noise / Unit::paper().accelerometer.noise_density;
                // With the filter, the density is estimated from means over 0.1 s. The filter lowers this density, too,
                // but only slightly, and the estimate has a larger random error.
                let range = if filtered { 0.8..1.15 } else { 0.95..1.05 };
                assert!(range.contains(&ratio), "{filtered} {ratio}");
            }
        }
    }

    #[test]
    fn a_filtered_unit_on_a_stand_is_no_hand() {
        for seed in 1..=5 {
            let program = Program::random(&RandomMoves { moves: 10, ..RandomMoves::default() }, seed).unwrap();
            assert!(found(&Motion::Stand { program, stand: Stand::perfect() }, true, seed).is_none());
        }
    }
}
