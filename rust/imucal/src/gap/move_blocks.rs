//! Divides a move into blocks of 40 ms, and computes the mean attitude, rate and force of each block.
//!
//! Residuals inside moves are computed from means over 40 ms, because noise dominates single accelerometer samples. The
//! attitude and the rate change little within 40 ms.

use std::ops::Range;

use imucal_core::integrate::Integrator;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::residual_kinds::Regressor;
use crate::evaluate::MoveReport;
use crate::recording::{Recording, Samples};

/// Length of a block, s. It is short compared with the duration of a short move (one second), and equals two sample
/// intervals at a sampling rate of 50 Hz.
const BLOCK_S: f64 = 0.04;

/// Minimum range of the temperature over a recording, K. If the range is smaller, the dependence of residuals on
/// temperature is not tested.
pub(super) const LEAST_TEMPERATURE_CHANGE_K: f64 = 0.5;

/// One move of a corrected recording, divided into blocks.
pub(super) struct MoveBlocks {
    /// Rotation from the body frame at the end of the move to the body frame at its start.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Consecutive blocks from the first to the last sample of the move.
    pub(super) blocks: Vec<Block>,
}

/// Consecutive samples inside a move. The last sample of a block is also the first sample of the next block.
pub(super) struct Block {
    /// Mean over the block of the rotation from the body frame at each sample to the body frame at the start of the
    /// move.
    rotation: Matrix3<f64>,
    /// Time from the start of the recording to the first sample of the block, s. Absolute time stamps (for example
    /// seconds since 1970) cannot be used as a regressor, because their change during a recording is too small relative
    /// to their size.
    start_s: f64,
    /// Time from the start of the move to the last sample of the block, s.
    pub(super) since_start_s: f64,
    /// Time from the first to the last sample of the block, s.
    pub(super) length_s: f64,
    /// Mean angular rate over the block, rad/s, body frame.
    pub(super) angular_rate: Vector3<f64>,
    /// Mean specific force over the block, m/s^2, body frame.
    pub(super) specific_force: Vector3<f64>,
    /// Mean angular acceleration over the block, rad/s^2, body frame.
    pub(super) angular_acceleration: Vector3<f64>,
    /// Temperature at the first sample minus the mean temperature of the recording, K; `None` if the dependence on
    /// temperature is not tested.
    temperature_k: Option<f64>,
}

impl MoveBlocks {
    /// Divides a move of a corrected recording (SI units, body frame) into blocks.
    pub(super) fn new(
        corrected: &Recording<'_>,
        span: &MoveReport,
        temperature: Option<&RelativeTemperature<'_>>,
    ) -> Self {
        let (time_s, edges) = (corrected.time_s, edges(corrected.time_s, span));
        let mut rotation = UnitQuaternion::identity();
        let mut blocks = Vec::with_capacity(edges.len());
        for pair in edges.windows(2) {
            let (first, last) = (pair[0], pair[1]);
            let (over_block, mean_rotation) = rotation_over(corrected, first, last);
            let end = rotation * over_block;
            let length_s = time_s[last] - time_s[first];
            let rate_at = |sample: usize| Vector3::from(corrected.angular_rate.at(sample));
            blocks.push(Block {
                rotation: rotation.to_rotation_matrix().matrix() * mean_rotation,
                start_s: time_s[first] - time_s[0],
                since_start_s: time_s[last] - time_s[span.first],
                length_s,
                angular_rate: mean(time_s, corrected.angular_rate, first, last),
                specific_force: mean(time_s, corrected.specific_force, first, last),
                angular_acceleration: (rate_at(last) - rate_at(first)) / length_s,
                temperature_k: temperature.map(|temperature| temperature.at(first)),
            });
            rotation = end;
        }
        Self { rotation, blocks }
    }

    /// Rotation vector from the body frame at the end of the move to the body frame at its start, rad. The norm of the
    /// vector is at most pi.
    pub(super) fn rotation_vector(&self) -> Vector3<f64> {
        self.rotation.scaled_axis()
    }

    /// Whether the dependence of residuals on temperature is tested.
    pub(super) fn has_temperature(&self) -> bool {
        self.blocks.iter().all(|block| block.temperature_k.is_some())
    }

    /// For each regressor (a quantity on which residuals may depend): a matrix of attitude errors at the end of the
    /// move. Its rows belong to the body axes. Each column is the attitude error caused by a rate error on one axis
    /// during the move. For [`Regressor::Gravity`], this rate error equals one component of the specific force, so
    /// there are three columns for each axis. For all other regressors, the rate error equals the regressor or, if the
    /// regressor is a vector, its component on the same axis, so there is one column for each axis.
    pub(super) fn attitude_changes(&self) -> Vec<(Regressor, [Vec<f64>; 3])> {
        let to_end = self.rotation.inverse().to_rotation_matrix();
        let blocks = || self.blocks.iter().map(|block| (block, to_end.matrix() * block.rotation * block.length_s));
        let mut by_gravity: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; 9]);
        for (block, change) in blocks() {
            for (axis, row) in by_gravity.iter_mut().enumerate() {
                for k in 0..9 {
                    row[k] += change[(axis, k / 3)] * block.specific_force[k % 3];
                }
            }
        }
        // Attitude error caused by a rate error on each body axis. The rate error on an axis equals the component of
        // `factor` along this axis.
        let by_axis = |factor: &dyn Fn(&Block) -> Vector3<f64>| -> [Vec<f64>; 3] {
            let sum = blocks().fold(Matrix3::zeros(), |sum: Matrix3<f64>, (block, change)| {
                sum + change * Matrix3::from_diagonal(&factor(block))
            });
            std::array::from_fn(|axis| sum.row(axis).iter().copied().collect())
        };
        let mut changes = vec![
            (Regressor::Gravity, by_gravity),
            (Regressor::RateSquared, by_axis(&|block| block.angular_rate.component_mul(&block.angular_rate))),
            (Regressor::SignOfTheRate, by_axis(&|block| block.angular_rate.abs())),
        ];
        if self.has_temperature() {
            let temperature = |block: &Block| Vector3::repeat(block.temperature_k.unwrap_or_default());
            changes.push((Regressor::Temperature, by_axis(&temperature)));
        }
        changes.push((Regressor::Time, by_axis(&|block| Vector3::repeat(block.start_s))));
        changes
    }
}

impl Block {
    /// Mean over the block, in the body frame, of a direction that is constant in the world. `at_start` is this
    /// direction in the body frame at the start of the move. This mean uses the same samples and weights as the mean
    /// specific force of the block, so the errors of the trapezoidal rule cancel in the difference of the two means.
    pub(super) fn mean_of_constant(&self, at_start: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(at_start)
    }
}

/// The temperatures of a recording and the mean of these temperatures. The range of the temperatures is large enough to
/// test whether residuals depend on temperature.
pub(super) struct RelativeTemperature<'a> {
    temperature_degc: &'a [f64],
    mean_degc: f64,
}

impl<'a> RelativeTemperature<'a> {
    /// The temperatures of `recording` and their mean. `None` if the temperature is missing, contains values that are
    /// not finite, or has a range below [`LEAST_TEMPERATURE_CHANGE_K`].
    pub(super) fn of(recording: &Recording<'a>) -> Option<Self> {
        let temperature_degc = recording.temperature_degc?;
        let least = temperature_degc.iter().copied().fold(f64::INFINITY, f64::min);
        let most = temperature_degc.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean_degc = temperature_degc.iter().sum::<f64>() / temperature_degc.len() as f64;
        (mean_degc.is_finite() && most - least >= LEAST_TEMPERATURE_CHANGE_K)
            .then_some(Self { temperature_degc, mean_degc })
    }

    fn at(&self, sample: usize) -> f64 {
        self.temperature_degc[sample] - self.mean_degc
    }

    /// Mean temperature over samples, degC.
    pub(super) fn mean_over(&self, samples: Range<usize>) -> f64 {
        let count = samples.len() as f64;
        self.temperature_degc[samples].iter().sum::<f64>() / count
    }
}

/// Indices of the first and last samples of the blocks. If the remaining samples of the move do not fill another block,
/// they are added to the last block.
fn edges(time_s: &[f64], span: &MoveReport) -> Vec<usize> {
    let (first, last) = (span.first, span.last);
    let samples = BLOCK_S * (last - first) as f64 / (time_s[last] - time_s[first]);
    let step = (samples.round_ties_even() as usize).max(2);
    let mut edges: Vec<usize> = (first..).step_by(step).take_while(|edge| edge + step <= last).collect();
    if edges.is_empty() {
        edges.push(first);
    }
    edges.push(last);
    edges
}

/// Computes two rotations. The first rotation is from the body frame at sample `last` to the body frame at sample
/// `first`. The second rotation is the mean, by the trapezoidal rule, of the rotations from the body frame at each
/// sample to the body frame at sample `first`.
fn rotation_over(recording: &Recording<'_>, first: usize, last: usize) -> (UnitQuaternion<f64>, Matrix3<f64>) {
    let mut integrator = Integrator::new();
    let (mut area, mut before) = (Matrix3::zeros(), Matrix3::identity());
    for sample in first..=last {
        let step_s = if sample == first { 0.0 } else { recording.time_s[sample] - recording.time_s[sample - 1] };
        integrator.push(step_s, Vector3::from(recording.angular_rate.at(sample)));
        let here = *integrator.rotation().to_rotation_matrix().matrix();
        area += (before + here) * (0.5 * step_s);
        before = here;
    }
    (integrator.rotation(), area / (recording.time_s[last] - recording.time_s[first]))
}

/// Time average from sample `first` to sample `last`, by the trapezoidal rule.
fn mean(time_s: &[f64], values: Samples<'_>, first: usize, last: usize) -> Vector3<f64> {
    let area: Vector3<f64> = (first..last)
        .map(|k| (Vector3::from(values.at(k)) + Vector3::from(values.at(k + 1))) * (0.5 * (time_s[k + 1] - time_s[k])))
        .sum();
    area / (time_s[last] - time_s[first])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rests::moves::Move;

    /// Simulates a move in which the rotation axis and the rate vary, and divides it into blocks. `error` is added to
    /// the rate.
    fn blocks(error: impl Fn(f64, &Vector3<f64>) -> Vector3<f64>) -> MoveBlocks {
        let time_s: Vec<f64> = (0..401).map(|k| f64::from(k) * 5e-3).collect();
        let rate = |t: f64| Vector3::new(1.2 * t, 0.8 - t, 0.5 * (2.0 * t).sin());
        let rates: Vec<[f64; 3]> = time_s.iter().map(|&t| (rate(t) + error(t, &rate(t))).into()).collect();
        let force = vec![[1.0, -2.0, 9.0]; time_s.len()];
        let temperature: Vec<f64> = time_s.iter().map(|t| 20.0 + t).collect();
        let recording = Recording {
            temperature_degc: Some(&temperature),
            ..Recording::try_new("run", &time_s, &force, &rates).unwrap()
        };
        let span = Move { recording: 0, from: 0, to: 1, first: 0, last: 400, duration_s: 2.0, interval_s: 5e-3 };
        let report = crate::evaluate::unusable_report(&span, "");
        MoveBlocks::new(&recording, &report, RelativeTemperature::of(&recording).as_ref())
    }

    #[test]
    fn changes_of_the_attitude_are_those_of_finite_differences() {
        const STEP: f64 = 1e-5;
        let plain = blocks(|_, _| Vector3::zeros());
        assert_eq!(plain.blocks.len(), 50);
        for (regressor, rows) in plain.attitude_changes() {
            for column in 0..rows[0].len() {
                let (axis, k) = if rows[0].len() == 9 { (column / 3, column % 3) } else { (column, 0) };
                let changed = blocks(|t, rate| {
                    let size = match regressor {
                        Regressor::Gravity => [1.0, -2.0, 9.0][k],
                        Regressor::RateSquared => rate[axis] * rate[axis],
                        Regressor::SignOfTheRate => rate[axis].abs(),
                        Regressor::Temperature => t - 1.0,
                        _ => t,
                    };
                    Vector3::ith(axis, STEP * size)
                });
                let numeric = (plain.rotation.inverse() * changed.rotation).scaled_axis() / STEP;
                let expected = Vector3::new(rows[0][column], rows[1][column], rows[2][column]);
                // The tolerance allows for errors due to the assumption that rates, times and temperatures are constant
                // within a block.
                let tolerance = 0.04 * (1.0 + expected.norm());
                assert!((numeric - expected).norm() < tolerance, "{regressor:?} {column}: {numeric} {expected}");
            }
        }
    }

    #[test]
    fn a_constant_direction_is_averaged_over_a_block() {
        let plain = blocks(|_, _| Vector3::zeros());
        let last = plain.blocks.last().unwrap();
        let up = Vector3::new(0.6, 0.0, 0.8);
        let at_end = plain.rotation.inverse() * up;
        // The mean over the last block is the direction half a block (0.02 s) before the end. The angular rate there
        // is 2.7 rad/s, so the directions differ by 0.054 rad.
        assert!((last.mean_of_constant(&up) - at_end).norm() < 0.06);
        assert!((last.since_start_s - 2.0).abs() < 1e-12 && (last.length_s - BLOCK_S).abs() < 1e-12);
    }

    /// An accelerometer without errors measures gravity during a move with a varying rate. The means of its readings
    /// over blocks must equal g times the means of the propagated gravity direction. They differ only by the error of
    /// integrating sampled rates with the trapezoidal rule.
    #[test]
    fn the_mean_force_of_a_block_is_the_mean_of_propagated_gravity() {
        let time_s: Vec<f64> = (0..201).map(|k| f64::from(k) * 0.01).collect();
        // A rotation about y by 90 deg in 2 s, with the smooth rate profile of a motor.
        let turn = |t: f64| (std::f64::consts::PI * t / 2.0).cos();
        let angle = |t: f64| (1.0 - turn(t)) * std::f64::consts::FRAC_PI_4;
        let rate = |t: f64| (std::f64::consts::PI * t / 2.0).sin() * std::f64::consts::PI.powi(2) / 8.0;
        let rates: Vec<[f64; 3]> = time_s.iter().map(|&t| [0.0, rate(t), 0.0]).collect();
        let force: Vec<[f64; 3]> = time_s.iter().map(|&t| [-angle(t).sin(), 0.0, angle(t).cos()]).collect();
        let recording = Recording::try_new("run", &time_s, &force, &rates).unwrap();
        let span = Move { recording: 0, from: 0, to: 1, first: 0, last: 200, duration_s: 2.0, interval_s: 0.01 };
        let found = MoveBlocks::new(&recording, &crate::evaluate::unusable_report(&span, ""), None);
        let error = |block: &Block| (block.specific_force - block.mean_of_constant(&Vector3::z())).norm();
        let worst = found.blocks.iter().map(error).fold(0.0, f64::max);
        // Error of the trapezoidal rule. It is dt^2 / 12 times the change of the angular acceleration between the ends
        // of the move.
        let integration = 0.01f64.powi(2) / 12.0 * std::f64::consts::PI.powi(3) / 8.0;
        assert!(worst < 1.01 * integration, "{worst:e} of gravity, {integration:e} is the error of integration");
    }

    #[test]
    fn a_move_of_two_samples_is_one_block() {
        let (time_s, zero) = ([0.0, 0.1], [[0.0; 3]; 2]);
        let recording = Recording::try_new("run", &time_s, &[[0.0, 0.0, 9.8]; 2], &zero).unwrap();
        let span = Move { recording: 0, from: 0, to: 1, first: 0, last: 1, duration_s: 0.1, interval_s: 0.1 };
        let found = MoveBlocks::new(&recording, &crate::evaluate::unusable_report(&span, ""), None);
        assert_eq!((found.blocks.len(), found.rotation_vector()), (1, Vector3::zeros()));
        assert!((found.blocks[0].specific_force.z - 9.8).abs() < 1e-12);
    }
}
