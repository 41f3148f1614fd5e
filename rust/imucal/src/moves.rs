//! Moves between rests: what a calibration fits the gyroscope to, and what a control record judges it by.

use std::ops::Range;

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::accelerometer::sigma_norm;
use crate::gyroscope::{Ends, Move};
use crate::recording::Recording;
use crate::segment::{NoiseDensity, Rest, Segments, sample_interval_s};
use crate::uncertainty::random_walk_rad;

/// A step in time of more than this many sample intervals inside a move loses too much of the rotation.
const LONGEST_STEP: f64 = 2.5;

/// One rest of one of the recordings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnitRest {
    pub(crate) recording: usize,
    pub(crate) rest: Rest,
}

/// A stretch between two rests that cannot be used, and why (a reason code).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unusable {
    pub(crate) span: Move,
    pub(crate) reason: &'static str,
}

/// All rests of all recordings, in order.
pub(crate) fn rests_of(segments: &[Segments]) -> Vec<UnitRest> {
    let of = |(recording, segments): (usize, &Segments)| {
        segments.rests.iter().map(move |rest| UnitRest { recording, rest: *rest }).collect::<Vec<_>>()
    };
    segments.iter().enumerate().flat_map(of).collect()
}

/// The moves between neighbouring usable rests, and those that a gap or saturated samples spoil.
pub(crate) fn between(
    recordings: &[Recording<'_>],
    rests: &[UnitRest],
    usable: &[bool],
    saturated: &[Vec<Range<usize>>],
) -> (Vec<Move>, Vec<Unusable>) {
    let kept: Vec<usize> = (0..rests.len()).filter(|&k| usable[k]).collect();
    let (mut moves, mut unusable) = (Vec::new(), Vec::new());
    for pair in kept.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let recording = rests[from].recording;
        if recording != rests[to].recording {
            continue;
        }
        let (first, last) = (rests[from].rest.end - 1, rests[to].rest.first);
        let time_s = &recordings[recording].time_s[first..=last];
        let span = Move { recording, from, to, first, last, duration_s: time_s[time_s.len() - 1] - time_s[0] };
        let interval_s = sample_interval_s(time_s);
        if saturated[recording].iter().any(|range| range.start <= last && range.end > first) {
            unusable.push(Unusable { span, reason: "saturation" });
        } else if time_s.windows(2).any(|t| t[1] - t[0] > LONGEST_STEP * interval_s) {
            unusable.push(Unusable { span, reason: "samples_missing" });
        } else {
            moves.push(span);
        }
    }
    (moves, unusable)
}

/// Directions of gravity at the ends of each move, and what noise explains of its residual.
///
/// Returns the ends and, of their variance, the standard deviation that the gyroscope's white noise makes, rad.
pub(crate) fn ends_of(
    moves: &[Move],
    rests: &[UnitRest],
    accelerometer: &Triad<f64>,
    gyroscope_inverse: &Matrix3<f64>,
    noise: &[NoiseDensity],
) -> (Vec<Ends>, Vec<f64>) {
    let direction = |k: usize| {
        let mean = &rests[k].rest.specific_force;
        let force = accelerometer.correct(mean.mean);
        let noise = accelerometer.inverse() * Matrix3::from_diagonal(&mean.variance_of_mean.map(f64::sqrt));
        (force.normalize(), noise.norm_squared() / 3.0 / force.norm_squared())
    };
    moves
        .iter()
        .map(|m| {
            let ((before, variance_before), (after, variance_after)) = (direction(m.from), direction(m.to));
            let walk = random_walk_rad(&noise[m.recording].angular_rate, gyroscope_inverse, m.duration_s);
            // A noise-free simulation: equal weights, of a size that leaves numbers in range.
            let sigma_rad = (walk * walk + variance_before + variance_after).sqrt().max(1e-9);
            (Ends { before, after, sigma_rad }, walk)
        })
        .unzip()
}

/// Error of the gravity direction after a move: the angle between carried and measured, rad.
pub(crate) fn direction_error_rad(ends: &Ends, rotation: &Matrix3<f64>) -> f64 {
    let carried: Vector3<f64> = rotation.tr_mul(&ends.before);
    // The arc tangent keeps its digits for small angles, unlike the arc cosine.
    carried.cross(&ends.after).norm().atan2(carried.dot(&ends.after))
}

/// Error of |f| at a rest and the standard deviation that noise explains, m/s^2.
pub(crate) fn norm_error_mps2(rest: &Rest, accelerometer: &Triad<f64>, gravity_mps2: f64) -> (f64, f64) {
    let error = accelerometer.correct(rest.specific_force.mean).norm() - gravity_mps2;
    (error, sigma_norm(rest, accelerometer))
}
