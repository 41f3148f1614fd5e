//! Rests of all recordings of one unit.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::rests::rest::Rest;
use crate::rests::segment::Segments;

/// A rest and the recording that contains it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnitRest {
    /// Index of the recording.
    pub(crate) recording: usize,
    pub(crate) rest: Rest,
    /// Covariance of the mean rate, raw units squared.
    pub(crate) rate_covariance: Matrix3<f64>,
    /// Best estimate of the gyroscope bias at this rest, raw units.
    pub(crate) bias: Vector3<f64>,
    /// How the means of a hand-held rest were computed; `None` for a rest without tremor.
    pub(crate) propagated: Option<PropagatedMean>,
}

/// Parameters of the mean of a hand-held rest: its samples are rotated by the gyroscope to the ends of the rest
/// (model.md (27)).
#[derive(Clone, Copy, Debug)]
pub(crate) struct PropagatedMean {
    /// Time constant of the exponential weights, s.
    pub(crate) mean_s: f64,
    /// Mean gyroscope bias over all rests, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Share of the difference between the mean rate of this rest and that of all rests by which the bias of the rest
    /// is shrunk towards the mean, for each axis: 1 if it is the mean, 0 if it is the rest's own.
    pub(crate) shrunk: Vector3<f64>,
}

/// The rests of a table of means.
pub(crate) fn rests_of_means(rests: &[Rest]) -> Vec<UnitRest> {
    let of = |rest: &Rest| UnitRest {
        recording: 0,
        rest: *rest,
        rate_covariance: Matrix3::from_diagonal(&rest.angular_rate.variance_of_mean),
        bias: rest.angular_rate.mean,
        propagated: None,
    };
    rests.iter().map(of).collect()
}

/// All rests of all recordings, in order of recording and time.
pub(crate) fn rests_of(segments: &[Segments]) -> Vec<UnitRest> {
    let of = |(recording, segments): (usize, &Segments)| {
        let unit_rest = move |rest: &Rest| UnitRest {
            recording,
            rest: *rest,
            rate_covariance: Matrix3::from_diagonal(&rest.angular_rate.variance_of_mean),
            bias: rest.angular_rate.mean,
            propagated: None,
        };
        segments.rests.iter().map(unit_rest).collect::<Vec<_>>()
    };
    segments.iter().enumerate().flat_map(of).collect()
}

impl UnitRest {
    /// Whether any sample of the rest is saturated. `saturated` contains the saturated index ranges of each recording.
    pub(crate) fn is_saturated(&self, saturated: &[Vec<Range<usize>>]) -> bool {
        touches(&saturated[self.recording], &(self.rest.first..self.rest.end))
    }
}

/// Whether any sample of `range` lies in one of the index ranges `saturated`.
pub(super) fn touches(saturated: &[Range<usize>], range: &Range<usize>) -> bool {
    saturated.iter().any(|s| s.start < range.end && s.end > range.start)
}
