//! Rests of all recordings of one unit.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::rests::rest::Rest;
use crate::rests::segment::Segments;

/// One rest of one of the recordings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnitRest {
    pub(crate) recording: usize,
    pub(crate) rest: Rest,
    /// Covariance of the mean rate, raw units squared.
    pub(crate) rate_covariance: Matrix3<f64>,
    /// What the gyroscope reads there without turning, as far as is known, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Where a hand trembles.
    pub(crate) propagated: Option<PropagatedMean>,
}

/// How the samples of a rest were carried along the gyroscope to its ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PropagatedMean {
    /// The mean time, s.
    pub(crate) mean_s: f64,
    /// The bias that all rests have in common, raw units.
    pub(crate) bias: Vector3<f64>,
}

/// All rests of all recordings, in order.
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
    /// Whether any sample of the rest is saturated, given the stretches of each recording.
    pub(crate) fn is_saturated(&self, saturated: &[Vec<Range<usize>>]) -> bool {
        touches(&saturated[self.recording], &(self.rest.first..self.rest.end))
    }
}

/// Whether any of the samples `range` of a recording is saturated.
pub(super) fn touches(saturated: &[Range<usize>], range: &Range<usize>) -> bool {
    saturated.iter().any(|s| s.start < range.end && s.end > range.start)
}
