//! A stretch of a gyroscope's samples and its integral.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::between::{Between, shares_of_cubic, until_other};
use super::kernel::{Map, Stretch, Turned, Work};
use super::lanes::MOST_LANES;
use super::step::REACHES;
use super::{Carried, Instructions, Sums, turn, turn_on};
use crate::recording::{Recording, Samples};

/// When the samples of a path were taken.
#[derive(Clone, Copy, Debug)]
pub enum Pace<'a> {
    /// One interval for all, s.
    Even(f64),
    /// Time of each sample, s.
    Stamps(&'a [f64]),
}

impl<'a> Pace<'a> {
    /// Even where the stamps are what rounding makes of even ones: the integral then hears nothing of their last digits.
    pub fn of(stamps_s: &'a [f64]) -> Self {
        let (Some(first), Some(last)) = (stamps_s.first(), stamps_s.last()) else { return Self::Stamps(stamps_s) };
        let interval_s = Self::Stamps(stamps_s).mean_interval_s();
        let rounding = 2.0 * f64::EPSILON * first.abs().max(last.abs());
        let is_off = |(k, time): (usize, &f64)| (time - (first + k as f64 * interval_s)).abs() > rounding;
        let is_even = interval_s > 0.0 && !stamps_s.iter().enumerate().any(is_off);
        if is_even { Self::Even(interval_s) } else { Self::Stamps(stamps_s) }
    }

    /// Of fewer than two samples zero.
    fn mean_interval_s(self) -> f64 {
        match self {
            Self::Even(interval_s) => interval_s,
            Self::Stamps(all @ [first, .., last]) => (last - first) / (all.len() - 1) as f64,
            Self::Stamps(_) => 0.0,
        }
    }
}

/// Samples of a gyroscope in raw units, from the first to the last that a rotation is wanted between.
#[derive(Clone, Copy, Debug)]
pub struct Path<'a> {
    raw: Samples<'a>,
    pace: Pace<'a>,
    between: Between,
    instructions: Instructions,
}

#[cfg(test)]
thread_local! {
    /// Steps that have been integrated, to count how often a fit passes over the samples.
    pub(crate) static STEPS_TAKEN: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// Steps that each lane takes before the lanes are put together: many, as nothing has asked for the memory where a lane begins. The
/// places they read must not be a power of two apart, or they would all fall into the same few lines of the cache.
const STEPS_OF_A_LANE: usize = 4000;
/// The polynomials for turns so far are tried first that this rate, 340 deg/s, keeps to; for less it would often be in vain.
const FAST_RAD_PER_S: f64 = 5.9;
/// Fewer steps than these are taken one by one.
const FEW: usize = 16;

impl<'a> Path<'a> {
    /// The rate goes straight from sample to sample; one time stamp for each, if there are any.
    pub fn straight(raw: impl Into<Samples<'a>>, pace: Pace<'a>) -> Self {
        Self::of_samples(raw.into(), pace, Between::Straight)
    }

    /// The rate between two samples is the cubic through four; the first and the last sample serve nothing else.
    pub fn cubic(raw: impl Into<Samples<'a>>, pace: Pace<'a>) -> Self {
        Self::of_samples(raw.into(), pace, Between::Cubic)
    }

    pub(crate) fn of_samples(raw: Samples<'a>, pace: Pace<'a>, between: Between) -> Self {
        Self { raw, pace, between, instructions: Instructions::Best }
    }

    /// Number of samples.
    pub(crate) fn samples(&self) -> usize {
        self.raw.len()
    }

    /// The same with other instructions than the best ones.
    #[must_use]
    pub fn with(self, instructions: Instructions) -> Self {
        Self { instructions, ..self }
    }

    /// Straight through samples `first..=last` of a recording.
    pub(crate) fn of(recording: &Recording<'a>, first: usize, last: usize) -> Self {
        Self::straight(recording.angular_rate.slice(first..last + 1), Pace::of(&recording.time_s[first..=last]))
    }

    /// From sample `first` to sample `last`, steps in a row that are alike together: cubics wherever they can be.
    pub(crate) fn smooth(
        time_s: &'a [f64],
        rates: Samples<'a>,
        first: usize,
        last: usize,
    ) -> impl Iterator<Item = Self> {
        let mut next = first;
        std::iter::from_fn(move || {
            let start = next;
            let (between, _) = (start < last).then(|| Between::of(time_s, start))?;
            next = until_other(time_s, start + 1, last, between);
            let around = if between == Between::Straight { start..next + 1 } else { start - 1..next + 2 };
            Some(Self::of_samples(rates.slice(around.clone()), Pace::of(&time_s[around]), between))
        })
    }

    /// The rotation, `v_start = rotation * v_end`, for a gyroscope with these parameters.
    pub fn rotation(&self, gyroscope: &Triad<f64>) -> Matrix3<f64> {
        let (rotation, _) = match self.between {
            Between::Straight => self.walk::<false, false>(gyroscope),
            Between::Cubic | Between::UnevenCubic => self.walk::<true, false>(gyroscope),
        };
        *rotation.to_rotation_matrix().matrix()
    }

    /// The rotation and the sums that its derivatives are made of.
    pub fn carry(&self, gyroscope: &Triad<f64>) -> Carried {
        let (rotation, sums) = self.sums(gyroscope);
        Carried { rotation, sensitivity_sums: sums.sensitivity, bias_sum: sums.bias }
    }

    /// The rotation and the sums.
    pub(crate) fn sums(&self, gyroscope: &Triad<f64>) -> (Matrix3<f64>, Sums) {
        let (rotation, sums) = match self.between {
            Between::Straight => self.walk::<false, true>(gyroscope),
            Between::Cubic | Between::UnevenCubic => self.walk::<true, true>(gyroscope),
        };
        (*rotation.to_rotation_matrix().matrix(), sums)
    }

    fn walk<const CUBIC: bool, const SUMS: bool>(&self, gyroscope: &Triad<f64>) -> (UnitQuaternion<f64>, Sums) {
        let around = 2 * usize::from(CUBIC);
        let steps = self.raw.len().saturating_sub(1 + around);
        #[cfg(test)]
        STEPS_TAKEN.set(STEPS_TAKEN.get() + steps);
        let (scale, stamps_s) = match self.pace {
            Pace::Even(interval_s) => (interval_s / 6.0, None),
            Pace::Stamps(stamps_s) => (1.0, Some(stamps_s)),
        };
        let frame = Frame::of(gyroscope, scale);

        let mut all = Turned::nothing();
        let fast_rad = FAST_RAD_PER_S * self.pace.mean_interval_s();
        let mut reach = REACHES.iter().position(|reach| reach.turn_rad >= fast_rad).unwrap_or(REACHES.len() - 1);
        while all.steps < steps {
            let at = all.steps;
            let count = (steps - at).min(MOST_LANES * STEPS_OF_A_LANE);
            let range = at..at + count + 1 + around;
            let raw = self.raw.part(range.clone());
            let stretch = Stretch { raw: &raw, stamps_s: stamps_s.map(|s| &s[range]), map: &frame.map };
            let in_lanes = count >= FEW && self.between != Between::UnevenCubic;
            let turned = if in_lanes { self.lanes::<CUBIC, SUMS>(stretch, &mut reach) } else { None };
            // One step may be all that turned too far.
            let alone = at..at + count.min(STEPS_OF_A_LANE);
            all.then(&turned.unwrap_or_else(|| self.one_by_one::<CUBIC>(gyroscope, &frame, alone)));
        }
        let sums = if SUMS { self.all_sums(&all, &frame.axes) } else { Sums::zero() };
        (frame.rotation * all.rotation * frame.rotation.inverse(), sums)
    }

    /// A stretch in lanes, with the polynomials for the least reach that its steps keep to; the next stretch begins with that.
    fn lanes<const CUBIC: bool, const SUMS: bool>(&self, stretch: Stretch<'_>, reach: &mut usize) -> Option<Turned> {
        loop {
            let turned = match *reach {
                0 => self.instructions.run(Work::<CUBIC, SUMS, 0>(stretch)),
                1 => self.instructions.run(Work::<CUBIC, SUMS, 1>(stretch)),
                _ => self.instructions.run(Work::<CUBIC, SUMS, 2>(stretch)),
            };
            if turned.is_some() || *reach + 1 >= REACHES.len() {
                return turned;
            }
            *reach += 1;
        }
    }

    /// Steps of any angle, and the few that the lanes leave. In the frame of the gyroscope, where no rate is rounded once more.
    fn one_by_one<const CUBIC: bool>(
        &self,
        gyroscope: &Triad<f64>,
        frame: &Frame,
        steps: std::ops::Range<usize>,
    ) -> Turned {
        let margin = usize::from(CUBIC);
        let mut rotation = UnitQuaternion::identity();
        let mut sums = Sums::zero();
        let rate = |k: usize| gyroscope.correct(Vector3::from(self.raw.at(k)));
        let weighted = |rotation: &UnitQuaternion<f64>, h: f64| rotation.to_rotation_matrix().matrix() * (h / 2.0);
        for k in steps.start + margin..steps.end + margin {
            let h = match self.pace {
                Pace::Even(interval_s) => interval_s,
                Pace::Stamps(stamps_s) => stamps_s[k + 1] - stamps_s[k],
            };
            let (w0, w1) = (rate(k), rate(k + 1));
            let inner = w0 + w1;
            let mean = match (self.between, self.pace) {
                (Between::Straight, _) => inner / 2.0,
                (Between::UnevenCubic, Pace::Stamps(stamps_s)) => {
                    let shares = shares_of_cubic(std::array::from_fn(|n| stamps_s[k - 1 + n]));
                    (0..4).map(|n| rate(k - 1 + n) * shares[n]).sum()
                }
                _ => (inner * 13.0 - (rate(k - 1) + rate(k + 2))) / 24.0,
            };
            let before = weighted(&rotation, h);
            turn_on(&mut rotation, &turn(&mean, [&w0, &w1], h));
            sums.add_sample(&before, &w0);
            sums.add_sample(&weighted(&rotation, h), &w1);
        }
        let (by_time, by_turn) = self.units_of_sums();
        let Frame { axes, rotation: outward, .. } = frame;
        let [x, y, z] = along(&axes.transpose(), &sums.sensitivity).map(|sum| sum / by_turn);
        let bias = axes.tr_mul(&sums.bias) * axes / by_time;
        Turned { rotation: outward.inverse() * rotation * outward, sums: [bias, x, y, z], steps: steps.len() }
    }

    /// A unit of the kernel's sums of R, s, and of those of R times a part of the rate, rad.
    fn units_of_sums(&self) -> (f64, f64) {
        match self.pace {
            Pace::Even(interval_s) => (interval_s, 6.0),
            Pace::Stamps(_) => (0.5, 0.5),
        }
    }

    /// The sums in the frame of the gyroscope.
    fn all_sums(&self, all: &Turned, axes: &Matrix3<f64>) -> Sums {
        let (by_time, by_turn) = self.units_of_sums();
        let [bias, mut by_rate @ ..] = all.sums;
        // The rest of them: R' = R [w]x, so what two columns of R differ by, each times the other's part of the rate, is a turn.
        let turned = (all.rotation.to_rotation_matrix().matrix() - Matrix3::identity()) / by_turn;
        for (c, j, sign, across) in [(1, 0, -1.0, 2), (2, 0, 1.0, 1), (2, 1, -1.0, 0)] {
            let column = by_rate[c].column(j) + turned.column(across) * sign;
            by_rate[j].set_column(c, &column);
        }
        let bias = axes * bias * axes.transpose() * by_time;
        Sums { sensitivity: along(axes, &by_rate).map(|sum| sum * by_turn), bias }
    }
}

/// Sums of R times each part of the rate in another frame: `axes` are those of this one there.
fn along(axes: &Matrix3<f64>, by_rate: &[Matrix3<f64>; 3]) -> [Matrix3<f64>; 3] {
    let turned = by_rate.map(|sum| axes * sum * axes.transpose());
    [0, 1, 2].map(|j| (0..3).map(|i| turned[i] * axes[(j, i)]).sum())
}

/// The frame in which the matrix from readings to rates is upper triangular.
pub(super) struct Frame {
    /// Its axes in the sensor's frame, as columns.
    pub(super) axes: Matrix3<f64>,
    rotation: UnitQuaternion<f64>,
    map: Map,
}

impl Frame {
    /// `scale` is that of the rates.
    pub(super) fn of(gyroscope: &Triad<f64>, scale: f64) -> Self {
        let inverse = gyroscope.inverse() * scale;
        let (axes, upper) = inverse.qr().unpack();
        // A reflection would turn cross products around.
        let sign = axes.determinant().signum();
        let (axes, upper) = (axes * sign, upper * sign);
        let offset = -(upper * gyroscope.bias());
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Self { axes, rotation, map: Map { upper, offset: offset.into() } }
    }
}
