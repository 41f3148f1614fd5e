//! The way of a move in stretches, for what is wrong with the rate or the force in a pattern of its own.

use nalgebra::{Matrix3, Vector3};

use super::{Pass, Route};
use crate::joint::model::Model;
use crate::parameters::GYRO_BIAS;

/// A short stretch of a move, as long as a block inside it.
pub(crate) struct Stretch {
    /// Since the first sample of the recording, s.
    pub(crate) time_s: f64,
    /// The sample in its middle.
    pub(crate) sample: usize,
    /// `v_start = attitude v_here`.
    pub(crate) attitude: Matrix3<f64>,
    pub(crate) rate: Vector3<f64>,
    /// What a constant error of the rate, of one about each axis, has turned until then.
    pub(crate) turn: Matrix3<f64>,
}

/// The stretches of a move, and what a constant error has turned at its end.
pub(crate) struct MoveSegments {
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) end: Matrix3<f64>,
}

impl Route<'_> {
    /// Where no effect acts, with one stretch in `every`; `pass` is that of the move.
    pub(crate) fn segments(&self, model: &Model, pass: &Pass, every: usize) -> MoveSegments {
        let (recording, span) = (self.recording, self.span);
        let size = self.stretches_of_block().iter().product();
        let all = self.stretches(model, None, size, false);
        let first = all.groups.of(span.first + 1 - self.reach().start);
        let count = (span.last - span.first) / size;
        let mut turned = Matrix3::zeros();
        let mut stretches = Vec::with_capacity(count.div_ceil(every));
        for (k, weight) in all.weights().iter().enumerate().take(first + count) {
            let until = turned - weight / 2.0;
            turned -= weight;
            if k.checked_sub(first).is_some_and(|block| block % every == (every / 2).min(count - 1)) {
                let sample = span.first + (k - first) * size + size / 2 + 1;
                stretches.push(Stretch {
                    time_s: recording.time_s[sample] - recording.time_s[0],
                    sample,
                    attitude: all.rotations[k],
                    rate: all.states[k].angular_rate,
                    turn: until,
                });
            }
        }
        let end = Matrix3::from_columns(&[0, 1, 2].map(|axis| pass.turn[GYRO_BIAS.start + axis]));
        MoveSegments { stretches, end: end * model.gyroscope.sensitivity() }
    }
}
