//! Rests of all recordings of one unit, and the epochs of long rests. An epoch is a part of a long rest with its own
//! mean.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::numerics::stats::median;
use crate::rests::rest::{Rest, RestMean};
use crate::rests::segment::Segments;

/// A rest, or an epoch of a long rest, and the recording that contains it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnitRest {
    /// Index of the recording that contains the rest.
    pub(crate) recording: usize,
    pub(crate) rest: Rest,
    /// Covariance matrix of the errors of the three components of the mean rate, squared raw units.
    pub(crate) rate_covariance: Matrix3<f64>,
    /// Best estimate of the gyroscope bias at this rest, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Parameters with which the means of a hand-held rest are computed; `None` for a rest without tremor.
    pub(crate) propagated: Option<PropagatedMean>,
    /// Index of the rest to which this interval belongs, among the rests of all recordings. All epochs (parts) of a
    /// long rest have the same index.
    pub(crate) whole: usize,
    /// Index of the epoch within its rest. It is 0 for a rest that is not divided into epochs.
    pub(crate) epoch: usize,
}

/// Parameters of the mean of a hand-held rest. Before averaging, each sample is rotated with the integrated gyroscope
/// rate to the attitude at an end of the rest (model.md (27)).
#[derive(Clone, Copy, Debug)]
pub(crate) struct PropagatedMean {
    /// Time constant of the exponential weights with which the samples are averaged, s.
    pub(crate) mean_s: f64,
    /// Mean of the gyroscope bias over all rests of the recording, raw units.
    pub(crate) bias: Vector3<f64>,
    /// Shrinkage s, for each axis, of the gyroscope bias at this rest towards the mean of all rests: bias = s x (mean
    /// rate of all rests) + (1 - s) x (mean rate of this rest).
    pub(crate) shrunk: Vector3<f64>,
}

/// Converts the rests of a table of mean readings (one row per rest) to rests of a unit. All rests are assigned to one
/// recording, and no rest is divided into epochs.
pub(crate) fn rests_of_means(rests: &[Rest]) -> Vec<UnitRest> {
    rests.iter().enumerate().map(|(whole, rest)| UnitRest::new(0, *rest, whole, 0)).collect()
}

/// The rests of all recordings, ordered by recording, and by time within each recording.
pub(crate) fn rests_of(segments: &[Segments]) -> Vec<UnitRest> {
    let of = |(recording, segments): (usize, &Segments)| {
        segments.rests.iter().map(move |rest| (recording, *rest)).collect::<Vec<_>>()
    };
    let all = segments.iter().enumerate().flat_map(of).enumerate();
    all.map(|(whole, (recording, rest))| UnitRest::new(recording, rest, whole, 0)).collect()
}

/// Replaces each long rest by its epochs, and returns all other rests unchanged. `segments` must be the value from
/// which [`rests_of`] computed `rests`. A rest whose means have been corrected for hand tremor is not replaced, because
/// the means of epochs do not contain this correction.
pub(crate) fn in_epochs(rests: &[UnitRest], segments: &[Segments]) -> Vec<UnitRest> {
    let epochs = segments.iter().flat_map(|segments| &segments.epochs);
    let of = |(rest, epochs): (&UnitRest, &Vec<Rest>)| -> Vec<UnitRest> {
        if epochs.is_empty() || rest.propagated.is_some() {
            return vec![*rest];
        }
        let unit_rest = |(epoch, own): (usize, &Rest)| UnitRest::new(rest.recording, *own, rest.whole, epoch);
        epochs.iter().enumerate().map(unit_rest).collect()
    };
    rests.iter().zip(epochs).flat_map(of).collect()
}

/// For each rest: the index range of its epochs in `rests`. The range of a rest that is not divided into epochs has one
/// element.
pub(crate) fn ranges_of_rests(rests: &[UnitRest]) -> Vec<Range<usize>> {
    let ends = rests.chunk_by(|a, b| a.whole == b.whole).scan(0, |end, epochs| {
        *end += epochs.len();
        Some(*end - epochs.len()..*end)
    });
    ends.collect()
}

/// Combines the epochs of one rest into the whole rest, with the means over all samples.
pub(crate) fn together(epochs: &[UnitRest]) -> UnitRest {
    let [first, .., last] = epochs else { return epochs[0] };
    let samples = |epoch: &UnitRest| (epoch.rest.end - epoch.rest.first) as f64;
    let all: f64 = epochs.iter().map(samples).sum();
    let mean = |of: fn(&Rest) -> &RestMean| {
        let sum = |value: &dyn Fn(&UnitRest) -> Vector3<f64>| epochs.iter().map(value).sum::<Vector3<f64>>();
        RestMean {
            mean: sum(&|epoch| of(&epoch.rest).mean * (samples(epoch) / all)),
            variance_of_mean: sum(&|epoch| of(&epoch.rest).variance_of_mean * (samples(epoch) / all).powi(2)),
            rounding: of(&first.rest).rounding,
        }
    };
    let rest = Rest {
        first: first.rest.first,
        start_s: first.rest.start_s,
        end: last.rest.end,
        end_s: last.rest.end_s,
        unsteadiness: median(&mut epochs.iter().map(|epoch| epoch.rest.unsteadiness).collect::<Vec<_>>()),
        specific_force: mean(|rest| &rest.specific_force),
        angular_rate: mean(|rest| &rest.angular_rate),
    };
    UnitRest::new(first.recording, rest, first.whole, 0)
}

impl UnitRest {
    fn new(recording: usize, rest: Rest, whole: usize, epoch: usize) -> Self {
        Self {
            recording,
            rest,
            rate_covariance: Matrix3::from_diagonal(&rest.angular_rate.variance_of_mean),
            bias: rest.angular_rate.mean,
            propagated: None,
            whole,
            epoch,
        }
    }

    /// Whether this is the second or a later epoch of a long rest. A later epoch has the same pose as the first epoch,
    /// so it adds no further gravity direction. The change of its readings since the first epoch shows drifts and
    /// effects of temperature.
    pub(crate) fn is_later_epoch(&self) -> bool {
        self.epoch > 0
    }

    /// Whether any sample of the rest is saturated. `saturated` contains the index ranges of saturated samples in each
    /// recording.
    pub(crate) fn is_saturated(&self, saturated: &[Vec<Range<usize>>]) -> bool {
        touches(&saturated[self.recording], &(self.rest.first..self.rest.end))
    }
}

/// Whether any sample of `range` is in one of the index ranges `saturated`.
pub(super) fn touches(saturated: &[Range<usize>], range: &Range<usize>) -> bool {
    saturated.iter().any(|s| s.start < range.end && s.end > range.start)
}
