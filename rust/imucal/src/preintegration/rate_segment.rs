//! Integrates consecutive gyroscope samples to the rotation over their time interval.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::interpolation::{Interpolation, cubic_weights, end_of_equal_steps};
use super::kernel::{Block, Increment, Kernel, Map};
use super::lanes::MOST_LANES;
use super::step::ANGLE_RANGES;
use super::{Instructions, Preintegrated, Sums, rotate_by, turn};
use crate::recording::{Recording, Samples};

/// Times of the samples.
#[derive(Clone, Copy, Debug)]
pub enum SampleTimes<'a> {
    /// Equal time steps of this length, s.
    Even(f64),
    /// Time of each sample, s.
    Stamps(&'a [f64]),
}

impl<'a> SampleTimes<'a> {
    /// `Even` if the time stamps deviate from equal steps only by rounding, otherwise `Stamps`. Equal steps are
    /// preferred, because the rounding of the stamps then does not affect the integral.
    pub fn of(stamps_s: &'a [f64]) -> Self {
        let (Some(first), Some(last)) = (stamps_s.first(), stamps_s.last()) else { return Self::Stamps(stamps_s) };
        let interval_s = Self::Stamps(stamps_s).mean_interval_s();
        let rounding = 2.0 * f64::EPSILON * first.abs().max(last.abs());
        let is_off = |(k, time): (usize, &f64)| (time - (first + k as f64 * interval_s)).abs() > rounding;
        let is_even = interval_s > 0.0 && !stamps_s.iter().enumerate().any(is_off);
        if is_even { Self::Even(interval_s) } else { Self::Stamps(stamps_s) }
    }

    /// Mean time step, s; zero for fewer than two samples.
    fn mean_interval_s(self) -> f64 {
        match self {
            Self::Even(interval_s) => interval_s,
            Self::Stamps(all @ [first, .., last]) => (last - first) / (all.len() - 1) as f64,
            Self::Stamps(_) => 0.0,
        }
    }
}

/// Consecutive raw samples of a gyroscope, from which the rotation over their time interval is computed.
#[derive(Clone, Copy, Debug)]
pub struct RateSegment<'a> {
    raw: Samples<'a>,
    sample_times: SampleTimes<'a>,
    interpolation: Interpolation,
    instructions: Instructions,
}

#[cfg(test)]
thread_local! {
    /// Number of steps integrated so far on this thread. Tests compute from this number how often a fit reads the
    /// samples.
    pub(crate) static STEPS_TAKEN: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// Number of steps that each SIMD lane processes in a block. The first samples of each lane are not prefetched. The
/// number of steps is large, so that these samples are only a small share of all samples. The number is not a power of
/// two, because the distance between lanes in memory would then be a multiple of a large power of two, and the lanes
/// would compete for the same cache sets.
const STEPS_OF_A_LANE: usize = 4000;
/// The integration first tries the smallest range of step angles ([`ANGLE_RANGES`]) that contains the angle of a step
/// at this angular rate, rad/s (340 deg/s). If it started with a smaller range, the step angles of a block would often
/// exceed this range, and the block would be integrated again with the next range.
const FAST_RAD_PER_S: f64 = 5.9;
/// Minimum number of steps for vectorised integration. Fewer steps are integrated one by one.
const FEW: usize = 16;

impl<'a> RateSegment<'a> {
    /// A segment with linear interpolation of the rate.
    pub fn linear(raw: impl Into<Samples<'a>>, sample_times: SampleTimes<'a>) -> Self {
        Self::of_samples(raw.into(), sample_times, Interpolation::Linear)
    }

    /// A segment with cubic interpolation of the rate through four samples. The first and the last sample are used only
    /// for interpolation.
    pub fn cubic(raw: impl Into<Samples<'a>>, sample_times: SampleTimes<'a>) -> Self {
        Self::of_samples(raw.into(), sample_times, Interpolation::Cubic)
    }

    pub(crate) fn of_samples(raw: Samples<'a>, sample_times: SampleTimes<'a>, interpolation: Interpolation) -> Self {
        Self { raw, sample_times, interpolation, instructions: Instructions::Best }
    }

    /// Number of samples.
    pub(crate) fn samples(&self) -> usize {
        self.raw.len()
    }

    /// Selects the instruction set for the integration; the default is [`Instructions::Best`].
    #[must_use]
    pub fn with(self, instructions: Instructions) -> Self {
        Self { instructions, ..self }
    }

    /// Samples `first..=last` of a recording, with linear interpolation.
    pub(crate) fn of(recording: &Recording<'a>, first: usize, last: usize) -> Self {
        Self::linear(recording.angular_rate.slice(first..last + 1), SampleTimes::of(&recording.time_s[first..=last]))
    }

    /// Divides samples `first..=last` into segments, each with one kind of interpolation ([`Interpolation::of`]): cubic
    /// if the time steps permit it, otherwise linear.
    pub(crate) fn smooth(
        time_s: &'a [f64],
        rates: Samples<'a>,
        first: usize,
        last: usize,
    ) -> impl Iterator<Item = Self> {
        let mut next = first;
        std::iter::from_fn(move || {
            let start = next;
            let (interpolation, _) = (start < last).then(|| Interpolation::of(time_s, start))?;
            next = end_of_equal_steps(time_s, start + 1, last, interpolation);
            let around = if interpolation == Interpolation::Linear { start..next + 1 } else { start - 1..next + 2 };
            Some(Self::of_samples(rates.slice(around.clone()), SampleTimes::of(&time_s[around]), interpolation))
        })
    }

    /// Integrates the rotation over the segment for a gyroscope with these parameters. The rotation maps vectors from
    /// the frame at the end to the frame at the start: `v_start = rotation * v_end`.
    pub fn rotation(&self, gyroscope: &Triad<f64>) -> Matrix3<f64> {
        let (rotation, _) = match self.interpolation {
            Interpolation::Linear => self.integrate::<false, false>(gyroscope),
            Interpolation::Cubic | Interpolation::UnevenCubic => self.integrate::<true, false>(gyroscope),
        };
        *rotation.to_rotation_matrix().matrix()
    }

    /// Integrates the rotation over the segment. Also returns the sums from which its derivatives with respect to the
    /// parameters are computed.
    pub fn preintegrate(&self, gyroscope: &Triad<f64>) -> Preintegrated {
        let (rotation, sums) = self.sums(gyroscope);
        Preintegrated { rotation, sensitivity_sums: sums.sensitivity, bias_sum: sums.bias }
    }

    /// Integrates the rotation over the segment. Also returns the sums from which the derivatives of the rotation with
    /// respect to the parameters are computed.
    pub(crate) fn sums(&self, gyroscope: &Triad<f64>) -> (Matrix3<f64>, Sums) {
        let (rotation, sums) = match self.interpolation {
            Interpolation::Linear => self.integrate::<false, true>(gyroscope),
            Interpolation::Cubic | Interpolation::UnevenCubic => self.integrate::<true, true>(gyroscope),
        };
        (*rotation.to_rotation_matrix().matrix(), sums)
    }

    fn integrate<const CUBIC: bool, const SUMS: bool>(&self, gyroscope: &Triad<f64>) -> (UnitQuaternion<f64>, Sums) {
        let around = 2 * usize::from(CUBIC);
        let steps = self.raw.len().saturating_sub(1 + around);
        #[cfg(test)]
        STEPS_TAKEN.set(STEPS_TAKEN.get() + steps);
        let (scale, stamps_s) = match self.sample_times {
            SampleTimes::Even(interval_s) => (interval_s / 6.0, None),
            SampleTimes::Stamps(stamps_s) => (1.0, Some(stamps_s)),
        };
        let frame = Frame::of(gyroscope, scale);

        let mut all = Increment::nothing();
        let fast_rad = FAST_RAD_PER_S * self.sample_times.mean_interval_s();
        let mut angle_range = ANGLE_RANGES
            .iter()
            .position(|angle_range| angle_range.turn_rad >= fast_rad)
            .unwrap_or(ANGLE_RANGES.len() - 1);
        while all.steps < steps {
            let at = all.steps;
            let count = (steps - at).min(MOST_LANES * STEPS_OF_A_LANE);
            let range = at..at + count + 1 + around;
            let raw = self.raw.part(range.clone());
            let block = Block { raw: &raw, stamps_s: stamps_s.map(|s| &s[range]), map: &frame.map };
            let in_lanes = count >= FEW && self.interpolation != Interpolation::UnevenCubic;
            let turned = if in_lanes { self.lanes::<CUBIC, SUMS>(block, &mut angle_range) } else { None };
            // If the angle of any step in the block exceeds all `ANGLE_RANGES`, the first `STEPS_OF_A_LANE` steps of
            // the block are integrated without SIMD. The vectorised integration is then tried again after these steps.
            let alone = at..at + count.min(STEPS_OF_A_LANE);
            all.then(&turned.unwrap_or_else(|| self.scalar_steps::<CUBIC>(gyroscope, &frame, alone)));
        }
        let sums = if SUMS { self.all_sums(&all, &frame.axes) } else { Sums::zero() };
        (frame.rotation * all.rotation * frame.rotation.inverse(), sums)
    }

    /// Integrates a block with SIMD. Tries the ranges of step angles in ascending order, from `angle_range` on, until a
    /// range contains all step angles of the block. A block with fewer steps than one node (16 steps) per lane is also
    /// integrated with a range after the first, because nodes are used only in the first range. The next block starts
    /// with the range that was used. `None` if no range contains all step angles.
    fn lanes<const CUBIC: bool, const SUMS: bool>(
        &self,
        block: Block<'_>,
        angle_range: &mut usize,
    ) -> Option<Increment> {
        loop {
            let turned = match *angle_range {
                0 => self.instructions.run(Kernel::<CUBIC, SUMS, 0>(block)),
                1 => self.instructions.run(Kernel::<CUBIC, SUMS, 1>(block)),
                _ => self.instructions.run(Kernel::<CUBIC, SUMS, 2>(block)),
            };
            if turned.is_some() || *angle_range + 1 >= ANGLE_RANGES.len() {
                return turned;
            }
            *angle_range += 1;
        }
    }

    /// Integrates steps without SIMD. The function is used for large step angles, for cubic interpolation at unequal
    /// times, and for the last steps, which do not fill all lanes. The steps are integrated in the frame of the
    /// gyroscope, and only their result is transformed to `frame`. This avoids rounding errors due to a transformation
    /// of every sample.
    fn scalar_steps<const CUBIC: bool>(
        &self,
        gyroscope: &Triad<f64>,
        frame: &Frame,
        steps: std::ops::Range<usize>,
    ) -> Increment {
        let margin = usize::from(CUBIC);
        let mut rotation = UnitQuaternion::identity();
        let mut sums = Sums::zero();
        let rate = |k: usize| gyroscope.correct(Vector3::from(self.raw.at(k)));
        let weighted = |rotation: &UnitQuaternion<f64>, h: f64| rotation.to_rotation_matrix().matrix() * (h / 2.0);
        for k in steps.start + margin..steps.end + margin {
            let h = match self.sample_times {
                SampleTimes::Even(interval_s) => interval_s,
                SampleTimes::Stamps(stamps_s) => stamps_s[k + 1] - stamps_s[k],
            };
            let (w0, w1) = (rate(k), rate(k + 1));
            let inner = w0 + w1;
            let mean = match (self.interpolation, self.sample_times) {
                (Interpolation::Linear, _) => inner / 2.0,
                (Interpolation::UnevenCubic, SampleTimes::Stamps(stamps_s)) => {
                    let shares = cubic_weights(std::array::from_fn(|n| stamps_s[k - 1 + n]));
                    (0..4).map(|n| rate(k - 1 + n) * shares[n]).sum()
                }
                _ => (inner * 13.0 - (rate(k - 1) + rate(k + 2))) / 24.0,
            };
            let before = weighted(&rotation, h);
            rotate_by(&mut rotation, &turn(&mean, [&w0, &w1], h));
            sums.add_sample(&before, &w0);
            sums.add_sample(&weighted(&rotation, h), &w1);
        }
        let (by_time, by_turn) = self.units_of_sums();
        let Frame { axes, rotation: outward, .. } = frame;
        let [x, y, z] = along(&axes.transpose(), &sums.sensitivity).map(|sum| sum / by_turn);
        let bias = axes.tr_mul(&sums.bias) * axes / by_time;
        Increment { rotation: outward.inverse() * rotation * outward, sums: [bias, x, y, z], steps: steps.len() }
    }

    /// Returns two factors that convert the sums of the vectorised integration to SI units. The first factor converts
    /// the sum of the rotations R to seconds. The second factor converts the sums of R times a component of the rate to
    /// radians.
    fn units_of_sums(&self) -> (f64, f64) {
        match self.sample_times {
            SampleTimes::Even(interval_s) => (interval_s, 6.0),
            SampleTimes::Stamps(_) => (0.5, 0.5),
        }
    }

    /// Computes the sums that the vectorised integration does not accumulate, and transforms all sums to the frame of
    /// the gyroscope in SI units.
    fn all_sums(&self, all: &Increment, axes: &Matrix3<f64>) -> Sums {
        let (by_time, by_turn) = self.units_of_sums();
        let [bias, mut by_rate @ ..] = all.sums;
        // The sums that the vectorised integration does not accumulate are computed from R' = R [w]x, where R is the
        // rotation with the columns R_x, R_y and R_z, R' its time derivative, and w the rate. For example, the
        // derivative of R_x is R_y w_z - R_z w_y. The change of R_x over the segment is therefore the sum of R_y w_z
        // minus the sum of R_z w_y.
        let turned = (all.rotation.to_rotation_matrix().matrix() - Matrix3::identity()) / by_turn;
        for (c, j, sign, across) in [(1, 0, -1.0, 2), (2, 0, 1.0, 1), (2, 1, -1.0, 0)] {
            let column = by_rate[c].column(j) + turned.column(across) * sign;
            by_rate[j].set_column(c, &column);
        }
        let bias = axes * bias * axes.transpose() * by_time;
        Sums { sensitivity: along(axes, &by_rate).map(|sum| sum * by_turn), bias }
    }
}

/// Transforms the sums of R times each component of the rate to another frame. `axes` are the axes of the frame of
/// `by_rate`, expressed in the other frame.
fn along(axes: &Matrix3<f64>, by_rate: &[Matrix3<f64>; 3]) -> [Matrix3<f64>; 3] {
    let turned = by_rate.map(|sum| axes * sum * axes.transpose());
    [0, 1, 2].map(|j| (0..3).map(|i| turned[i] * axes[(j, i)]).sum())
}

/// Frame of the vectorised integration. In this frame, the matrix that converts raw readings to rates is upper
/// triangular.
pub(super) struct Frame {
    /// The three axes of this frame, expressed in the frame of the gyroscope. Each axis is a column of the matrix.
    pub(super) axes: Matrix3<f64>,
    rotation: UnitQuaternion<f64>,
    map: Map,
}

impl Frame {
    /// The frame for a gyroscope. `scale` is the factor by which the vectorised integration multiplies rates in rad/s.
    /// If all time steps are equal, it is a sixth of the time step, s, otherwise 1.
    pub(super) fn of(gyroscope: &Triad<f64>, scale: f64) -> Self {
        let inverse = gyroscope.inverse() * scale;
        let (axes, upper) = inverse.qr().unpack();
        // A reflection would change the sign of cross products, so the frame must be right-handed.
        let sign = axes.determinant().signum();
        let (axes, upper) = (axes * sign, upper * sign);
        let offset = -(upper * gyroscope.bias());
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Self { axes, rotation, map: Map { upper, offset: offset.into() } }
    }
}
