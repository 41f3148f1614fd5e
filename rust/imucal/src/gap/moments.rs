//! Computes the whitened Jacobian columns of generic hypotheses (unknown variations of a bias or scale), and selects
//! the times at rests and inside moves at which the hypotheses are evaluated.

use std::cmp::Ordering::Equal;
use std::sync::Arc;

use faer::Mat;
use imucal_core::effects::Sensor;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::design::axes_of;
use super::generic::{Block, Hypothesis, hypotheses};
use super::kernel::Kernel;
use super::shares::{Moment, Moments, Place};
use crate::error::Error;
use crate::joint::{Field, Joint, Linear, Model, MoveSegments, Prepared, Terms, move_segments};
use crate::numerics::stats::dot;
use crate::rests::moves::Move;

/// Interval between the times inside moves at which hypotheses are evaluated, in blocks of samples (about 40 ms each).
/// The constant applies if accelerometer samples inside moves are not used. Otherwise, hypotheses are evaluated in
/// every block. Five blocks (0.2 s) are a sufficiently short interval, because biases vary slowly.
const EVERY: usize = 5;
/// Minimum angular rate about an axis, rad/s, at which the sign of the rate determines the sense of rotation about the
/// axis. At lower rates, the sense of the last rotation is kept. The limit is above the noise of a consumer gyroscope,
/// so noise does not change the sense.
const LEAST_RATE_RADPS: f64 = 0.05;

/// Maximum number of epochs (rests and moves, see [`Epoch`]). The computing time grows with the third power of this
/// number. With 240 epochs, the shortest correlation length of a smooth time course (1/40 of the duration) still
/// contains six epochs.
const MOST_EPOCHS: usize = 240;

/// A rest or a move, during which the deviation of a sensor parameter is constant. If there are more than
/// [`MOST_EPOCHS`] rests and moves, an epoch consists of several consecutive rests and moves. In other modules, the
/// word epoch means a part of a long rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Epoch {
    pub(crate) recording: usize,
    /// Time since the first sample of the recording, s: the middle of the rest or move, or the mean of the middles if
    /// the epoch consists of several rests and moves.
    pub(crate) time_s: f64,
}

/// A linearisation of the residuals, and the quantities on which generic hypotheses depend (for example temperature and
/// attitude) at the rests and inside the moves.
pub(crate) struct Setting<'a> {
    prepared: &'a Prepared<'a>,
    problem: Joint<'a>,
    linear: Arc<Linear>,
    segments: Vec<MoveSegments>,
    moments: Moments,
}

impl<'a> Setting<'a> {
    /// Linearises the residuals of `model`. `terms` are the effects of the model. Small effects may be omitted, because
    /// they hardly change the Jacobian. Large effects must not be omitted, because they may change the body axes that
    /// define the directions of the tilt residuals, see [`has_axes`](Self::has_axes).
    pub(crate) fn new(prepared: &'a Prepared<'a>, terms: &'a Terms<'a>, model: &Model) -> Result<Self, Error> {
        let values = if terms.count == 0 { Vec::new() } else { model.values.clone() };
        let plain = Model { values, stand: Vec::new(), ..model.clone() };
        let linear = Arc::new(prepared.linearise(terms, &plain.parameters())?);
        let problem = Joint::of_noise(prepared, terms, Arc::clone(&linear))?;
        let segments = move_segments(prepared, &linear, if linear.sees_inside() { 1 } else { EVERY });
        let moments = moments(prepared, &linear, &segments);
        Ok(Self { prepared, problem, linear, segments, moments })
    }

    /// The hypotheses that are observable in the recordings and for which `asked` is true.
    pub(crate) fn hypotheses(&self, asked: impl Fn(Block, Kernel) -> bool) -> Vec<Hypothesis> {
        hypotheses(&self.moments, self.linear.sees_inside(), self.prepared.gravity_mps2, asked)
    }

    /// Whether the residual rows of this linearisation can be compared with the rows of a second linearisation. Tilt
    /// residuals are components along directions perpendicular to gravity, and each direction is constructed from a
    /// body axis. The rows can be compared if these body axes are equal. `axes` are the body axes of the second
    /// linearisation.
    pub(crate) fn has_axes(&self, axes: &[usize]) -> bool {
        axes_of(&self.linear) == axes
    }

    /// Whitened Jacobian columns of a hypothesis: derivatives of all residuals with respect to its coefficients.
    pub(crate) fn columns(&self, hypothesis: &Hypothesis) -> Mat<f64> {
        let (sensor, width) = (hypothesis.block.sensor(), hypothesis.width());
        let mut rests = vec![0.0; self.prepared.rests.len() * width];
        let at_rests = hypothesis.columns(&self.moments, Place::Rests);
        for (k, numbers) in self.moments.used.iter().zip(at_rests.chunks_exact(width)) {
            rests[k * width..][..width].copy_from_slice(numbers);
        }
        // If the specific force inside moves is not used, errors inside moves change the residuals only through the
        // angular rate. Columns inside moves are then needed only for gyroscope hypotheses.
        let on_the_way = sensor == Sensor::Gyroscope || self.linear.sees_inside();
        let of_move = |k| if on_the_way { hypothesis.columns(&self.moments, Place::Move(k)) } else { Vec::new() };
        let field = Field { sensor, width, rests, moves: (0..self.segments.len()).map(of_move).collect() };
        self.problem.by_field(&self.linear, &self.segments, &field)
    }

    /// Returns the rests and moves (epochs) in which the sensor parameter `block` may deviate, and the whitened
    /// Jacobian columns of these deviations. Each epoch has one column per axis. The columns of the x axis come first,
    /// then the columns of the y axis and of the z axis. Accelerometer parameters are observed only at rests, and the
    /// gyroscope scale only in moves.
    pub(crate) fn by_epoch(&self, block: Block) -> (Vec<Epoch>, Mat<f64>) {
        let Moments { used, rests, moves } = &self.moments;
        let has_rests = block != Block::GyroscopeScale;
        let has_moves = block.sensor() == Sensor::Gyroscope;
        let middle = |way: &Vec<Moment>| way.get(way.len() / 2).map(|at| (at.recording, at.time_s));
        // For each rest or move: its recording and time, whether it is a move, and its index among the rests or moves.
        let of_rests = rests.iter().map(|at| (at.recording, at.time_s)).enumerate().filter(|_| has_rests);
        let of_moves = moves.iter().enumerate().filter(|_| has_moves).filter_map(|(k, way)| Some((k, middle(way)?)));
        let mut single: Vec<(Epoch, bool, usize)> = of_rests
            .map(|own| (own, false))
            .chain(of_moves.map(|own| (own, true)))
            .map(|((k, (recording, time_s)), is_move)| (Epoch { recording, time_s }, is_move, k))
            .collect();
        single
            .sort_by(|(a, ..), (b, ..)| (a.recording, a.time_s).partial_cmp(&(b.recording, b.time_s)).unwrap_or(Equal));
        let together = single.len().div_ceil(MOST_EPOCHS).max(1);
        let of_recording = single.chunk_by(|(a, ..), (b, ..)| a.recording == b.recording);
        let parts: Vec<&[(Epoch, bool, usize)]> = of_recording.flat_map(|own| own.chunks(together)).collect();
        let (n, sensor) = (parts.len(), block.sensor());
        let width = 3 * n;
        let mut field = Field {
            sensor,
            width,
            rests: vec![0.0; self.prepared.rests.len() * width],
            moves: moves.iter().map(|way| vec![0.0; way.len() * width]).collect(),
        };
        let input = |at: &Moment| match block {
            Block::GyroscopeScale => at.rate,
            Block::AccelerometerScale => at.up * self.prepared.gravity_mps2,
            Block::GyroscopeBias | Block::AccelerometerBias => Vector3::repeat(1.0),
        };
        let members = parts.iter().enumerate().flat_map(|(place, part)| part.iter().map(move |own| (place, own)));
        for (place, (_, is_move, k)) in members {
            let (all, first, moments) = match is_move {
                true => (&mut field.moves[*k], 0, &moves[*k][..]),
                false => (&mut field.rests, used[*k], &rests[*k..=*k]),
            };
            for (row, at) in moments.iter().enumerate() {
                let input = input(at);
                (0..3).for_each(|axis| all[(first + row) * width + axis * n + place] = input[axis]);
            }
        }
        let columns = self.problem.by_field(&self.linear, &self.segments, &field);
        let mean = |part: &&[(Epoch, bool, usize)]| Epoch {
            recording: part[0].0.recording,
            time_s: part.iter().map(|(epoch, ..)| epoch.time_s).sum::<f64>() / part.len() as f64,
        };
        (parts.iter().map(mean).collect(), columns)
    }

    /// Deviations of the sensor parameter on each axis for given coefficients `weights` of the columns of a hypothesis.
    /// For a hypothesis about rests: the index of each rest that the fit uses, and the deviation at the rest. For a
    /// hypothesis about moves: the index of the rest before each move, and the deviation in the middle of the move.
    pub(crate) fn wrong(&self, hypothesis: &Hypothesis, weights: &[f64]) -> Vec<(usize, Vector3<f64>)> {
        let count = weights.len() / 3;
        let wrong = |shares: &[f64]| {
            let own = |axis: usize| axis * count..(axis + 1) * count;
            Vector3::from_fn(|axis, _| dot(&shares[own(axis)], &weights[own(axis)]))
        };
        let at = |place: Place| hypothesis.shares(&self.moments, place);
        if hypothesis.is_of_moves() {
            let middle = |(k, span): (usize, &Move)| {
                let (shares, moments) = (at(Place::Move(k)), self.moments.moves[k].len());
                Some((span.from, wrong(shares.chunks_exact(weights.len()).nth(moments / 2)?)))
            };
            self.prepared.moves.iter().enumerate().filter_map(middle).collect()
        } else {
            let shares = at(Place::Rests);
            self.moments.used.iter().copied().zip(shares.chunks_exact(weights.len()).map(wrong)).collect()
        }
    }
}

/// Computes the quantities on which kernels depend (for example temperature and attitude) at the rests that the fit
/// uses and inside the moves between these rests.
fn moments(prepared: &Prepared<'_>, linear: &Linear, segments: &[MoveSegments]) -> Moments {
    let mut attitude = UnitQuaternion::identity();
    let mut arrived: Vec<Option<(UnitQuaternion<f64>, Vector3<f64>)>> = vec![None; prepared.rests.len()];
    let mut moves = Vec::with_capacity(segments.len());
    for ((m, at_move), segment) in prepared.moves.iter().zip(linear.moves.iter()).zip(segments) {
        let quaternion = |m: &_| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*m));
        let whole = quaternion(&at_move.pass.rotation);
        let (start, mut signs) = arrived[m.from].unwrap_or((attitude, Vector3::zeros()));
        let recording = &prepared.recordings[m.recording];
        let rate_and_time = |k: usize| (segment.stretches[k].rate, segment.stretches[k].time_s);
        let mut moment = |k: usize| {
            let stretch = &segment.stretches[k];
            signs = signs
                .zip_map(&stretch.rate, |sign, rate| if rate.abs() > LEAST_RATE_RADPS { rate.signum() } else { sign });
            let here = quaternion(&stretch.attitude);
            let ((w0, t0), (w1, t1)) =
                (rate_and_time(k.saturating_sub(1)), rate_and_time((k + 1).min(segment.stretches.len() - 1)));
            Moment {
                recording: m.recording,
                time_s: stretch.time_s,
                up: here.inverse() * at_move.before.up,
                ahead: (start * here).inverse() * Vector3::x(),
                temperature_degc: recording.temperature_degc.map(|t| t[stretch.sample]).filter(|t| t.is_finite()),
                signs,
                rate: stretch.rate,
                acceleration: if t1 > t0 { (w1 - w0) / (t1 - t0) } else { Vector3::zeros() },
            }
        };
        moves.push((0..segment.stretches.len()).map(&mut moment).collect());
        attitude = start * whole;
        arrived[m.to] = Some((attitude, signs));
    }
    let at_rest = |k: usize, up: &Vector3<f64>| {
        let rest = &prepared.rests[k];
        let recording = &prepared.recordings[rest.recording];
        let (attitude, signs) = arrived[k].unwrap_or((UnitQuaternion::identity(), Vector3::zeros()));
        let range = rest.rest.first..rest.rest.end;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        Moment {
            recording: rest.recording,
            time_s: f64::midpoint(rest.rest.start_s, rest.rest.end_s) - recording.time_s[0],
            up: *up,
            ahead: attitude.inverse() * Vector3::x(),
            temperature_degc: recording.temperature_degc.map(|t| mean(&t[range])).filter(|t| t.is_finite()),
            signs,
            rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
        }
    };
    let (used, rests) = linear.directions().map(|(k, up)| (k, at_rest(k, up))).unzip();
    Moments { used, rests, moves }
}
