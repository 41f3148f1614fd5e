//! Whitens residuals whose errors are correlated from rest to rest. These errors are due to biases that vary from rest
//! to rest, rounding errors, and pose errors. A pose error is an error of the mean rate that depends on the attitude
//! (for example due to g-sensitivity), so the epochs of a long rest have it in common. An epoch is a part of a long
//! rest with its own mean.

use std::collections::BTreeMap;

use faer::Mat;
use imucal_core::effects::Sensor;
use nalgebra::{Matrix2x3, Matrix3, Vector3};

use super::Joint;
use crate::error::Error;
use crate::joint::lanes::Lanes;
use crate::joint::linear::{Linear, Source};
use crate::joint::model::Model;
use crate::joint::move_ends::AtMove;
use crate::joint::wander::{MOST_ROWS, UnitWander};
use crate::numerics::blocked::{add_product, cholesky, product, solve_lower};
use crate::rests::moves::{Move, rows_across};
use crate::rests::rest::{RestMean, rounding_covariance};
use crate::rounding::Rounding;

/// The start and the end of a move are quiet as long as the rate of an axis differs from the mean rate at the adjacent
/// rest by less than this number of quantisation steps. The rounding error of the rate is then assumed to equal the
/// rounding error of this mean rate. In simulated moves with filter bandwidths from 5 to 40 Hz, the computed rotation
/// error agrees best with the true error at a limit of 0.8 steps.
const QUIET: f64 = 0.8;
/// Standard deviation of the common error of the mean rates at the second and later epochs (parts) of a long rest,
/// rad/s. The error is common because these epochs have one attitude. It is 0.1 deg/s, the effect of 1 g on a consumer
/// gyroscope (g-sensitivity). Because of this error, the later epochs determine only changes of the bias, and not the
/// bias itself.
const POSE_ERROR_RADPS: f64 = 1.7e-3;

/// Removes the correlation between the residuals of different rests and moves. The first whitening (`Weights`) accounts
/// for noise and excess scatter. This second whitening accounts for three errors that rests have in common. First, the
/// biases vary (model.md (28)). Second, the means have rounding errors (model.md (37)). Third, a pose error depends on
/// the attitude and is equal in all epochs of a long rest (model.md (41)). The whitening applies to force norms at
/// rests, gravity directions after moves, and mean rates at rests.
pub(crate) struct Wandering {
    /// Lower Cholesky factor of `I + D C D^T`. C is the covariance of the errors: the bias at each rest, the rounding
    /// errors of its mean rate and mean force, and the pose error of each long rest. D contains the derivatives of the
    /// whitened residuals with respect to these errors.
    factor: Mat<f64>,
}

impl Wandering {
    /// Computes the second whitening. `None` if the biases are constant, the means have no rounding errors, and no rest
    /// has more than one epoch. If there are too many residuals to factorise their covariance (`MOST_ROWS`), rounding
    /// errors and pose errors are neglected.
    ///
    /// # Errors
    /// [`Error::Input`] if the biases vary and there are too many residuals to factorise their covariance.
    pub(crate) fn new(joint: &Joint<'_>, linear: &Linear, unit: Option<&UnitWander>) -> Result<Option<Self>, Error> {
        let rows = linear.head_rows();
        let is_rounded = rows <= MOST_ROWS && joint.is_rounded();
        let shares_poses = rows <= MOST_ROWS && linear.rates.iter().any(|(_, lines)| lines[0].is_of_later_epoch);
        if unit.is_none() && !is_rounded && !shares_poses {
            return Ok(None);
        }
        if rows > MOST_ROWS {
            return Err(Error::Input(format!(
                "{} rests are too many to take the bias instability and the random walk into account: leave the unit's \
                 profile out, or calibrate with a part of the recordings",
                linear.rates.len()
            )));
        }
        let mut covariance = Mat::<f64>::identity(rows, rows);
        if let Some(unit) = unit {
            joint.add_varying_biases(linear, unit, &mut covariance);
        }
        if is_rounded {
            joint.add_rounding(linear, &mut covariance);
        }
        if shares_poses {
            joint.share_poses(linear, &mut covariance);
        }
        if !covariance.is_all_finite() {
            return Err(Error::Fit(
                "the covariance of the residuals is not finite: leave effects out, or check units".into(),
            ));
        }
        let factor = cholesky(covariance).ok_or_else(|| {
            Error::Fit(match unit {
                Some(_) => {
                    "the variation of the biases is so large that the covariance of the residuals cannot be factored: \
                     check bias_instability and random_walk"
                        .into()
                }
                None => "the covariance of the residuals cannot be factored: leave effects out, or check units".into(),
            })
        })?;
        Ok(Some(Self { factor }))
    }

    /// Whitens the rows of three kinds of residuals in a matrix: force norms at rests, gravity directions after moves,
    /// and mean rates at rests.
    pub(crate) fn apply(&self, matrix: &mut Mat<f64>) {
        solve_lower(self.factor.as_ref(), matrix.as_mut().subrows_mut(0, self.factor.nrows()));
    }

    /// Whitens the rows of force norms at rests, gravity directions after moves, and mean rates at rests, in a matrix
    /// that is stored row by row.
    pub(crate) fn apply_to_rows(&self, rows: &mut Lanes) {
        let (count, width) = (self.factor.nrows(), rows.width());
        let mut white = Mat::from_fn(count, width, |row, place| rows.row(row)[place]);
        solve_lower(self.factor.as_ref(), white.as_mut());
        for row in 0..count {
            rows.row_mut(row).iter_mut().enumerate().for_each(|(place, to)| *to = white[(row, place)]);
        }
    }

    /// Whitens sparse vectors that have one entry per residual. The vectors must be sorted by the index of their first
    /// nonzero entry. A vector is stored as the index of its first nonzero entry and the entries from there on.
    pub(crate) fn apply_to_columns(&self, columns: &[(usize, Vec<f64>)]) -> Vec<(usize, Vec<f64>)> {
        /// Number of vectors that are whitened together.
        const TOGETHER: usize = 256;
        let n = self.factor.nrows();
        let of_part = |part: &[(usize, Vec<f64>)]| -> Vec<(usize, Vec<f64>)> {
            let start = part[0].0;
            let mut white = Mat::zeros(n - start, part.len());
            for (place, (first, values)) in part.iter().enumerate() {
                white.col_as_slice_mut(place)[first - start..][..values.len()].copy_from_slice(values);
            }
            solve_lower(self.factor.submatrix(start, start, n - start, n - start), white.as_mut());
            let of_column = |(place, (first, _)): (usize, &(usize, Vec<f64>))| {
                (*first, white.col_as_slice(place)[first - start..].to_vec())
            };
            part.iter().enumerate().map(of_column).collect()
        };
        columns.chunks(TOGETHER).flat_map(of_part).collect()
    }
}

impl Joint<'_> {
    /// Adds the covariance due to biases that vary from rest to rest to `covariance`, the covariance of the whitened
    /// residuals. Only the lower triangle is used.
    fn add_varying_biases(&self, linear: &Linear, unit: &UnitWander, covariance: &mut Mat<f64>) {
        let [by_gyroscope, by_accelerometer] = self.by_biases_of_rests(linear);
        for (index, recording) in self.prepared.recordings.iter().enumerate() {
            let (rests, spans) = self.prepared.rests_of(index);
            for (sensor, wander, by_bias) in [
                (Sensor::Gyroscope, &unit.gyroscope, &by_gyroscope),
                (Sensor::Accelerometer, &unit.accelerometer, &by_accelerometer),
            ] {
                let raw = self.raw_scale(sensor, &linear.model.parameters());
                for axis in (0..3).filter(|&axis| wander.varies(axis)) {
                    let own = wander.of_rests(axis, &spans, recording.span_s());
                    let by = |row: usize, rest: usize| raw * by_bias[(row, 3 * rest + axis)];
                    add_errors_of_rests(covariance, linear, by, &rests, &own);
                }
            }
        }
    }

    /// Adds the covariance of the pose errors to `covariance`, in the rows of the whitened mean rates. A pose error is
    /// the common error of the second and later epochs (parts) of a long rest.
    fn share_poses(&self, linear: &Linear, covariance: &mut Mat<f64>) {
        let variance = (POSE_ERROR_RADPS * self.raw_scale(Sensor::Gyroscope, &linear.model.parameters())).powi(2);
        // The common error also contains the drift of the bias between the first epoch and the later epochs.
        let variance = Matrix3::from_diagonal(&Vector3::from(self.weights.epoch_rates().map(|drift| variance + drift)));
        let later: Vec<(usize, usize)> = linear
            .rates
            .iter()
            .enumerate()
            .filter(|(_, (_, l))| l[0].is_of_later_epoch)
            .map(|(p, (k, _))| (p, *k))
            .collect();
        let head = linear.lines.len();
        for own in later.chunk_by(|(_, a), (_, b)| self.prepared.rests[*a].whole == self.prepared.rests[*b].whole) {
            for ((to, k), (from, l)) in own.iter().flat_map(|a| own.iter().map(move |b| (*a, *b))) {
                let shared = self.weights.rates[k] * variance * self.weights.rates[l].transpose();
                for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
                    covariance[(head + 3 * to + row, head + 3 * from + column)] += shared[(row, column)];
                }
            }
        }
    }

    /// Whether rounding causes an error in the means of any rest that the fit uses.
    fn is_rounded(&self) -> bool {
        let is_coarse = |mean: &RestMean| mean.rounding.iter().any(Rounding::is_coarse);
        let rests = self.prepared.rests.iter().zip(self.prepared.used).filter(|(_, used)| **used);
        rests.into_iter().any(|(k, _)| is_coarse(&k.rest.angular_rate) || is_coarse(&k.rest.specific_force))
    }

    /// Adds the covariance due to rounding errors of the means at the rests to `covariance`, the covariance of the
    /// whitened residuals. Only the lower triangle is used.
    fn add_rounding(&self, linear: &Linear, covariance: &mut Mat<f64>) {
        let used: Vec<usize> = linear.rates.iter().map(|(rest, _)| *rest).collect();
        let rests = || used.iter().map(|k| &self.prepared.rests[*k].rest);
        let rates: Vec<&RestMean> = rests().map(|rest| &rest.angular_rate).collect();
        let forces: Vec<&RestMean> = rests().map(|rest| &rest.specific_force).collect();
        for (by, means) in self.by_rounding(linear).iter().zip([rates, forces]) {
            for axis in 0..3 {
                if let Some(own) = rounding_covariance(&means, axis) {
                    add_errors_of_rests(covariance, linear, |row, rest| by[(row, 3 * rest + axis)], &used, &own);
                }
            }
        }
    }

    /// Computes the derivatives of the whitened residuals with respect to rounding errors. The first matrix is for
    /// rounding errors of the mean rates, the second for rounding errors of the mean forces. Each rest has three
    /// columns.
    ///
    /// `Scales` contains a factor on the standard deviations of force norms, and a factor on those of gravity
    /// directions after moves. The rounding errors of the forces are multiplied by the larger of these two factors.
    /// Without a factor on a dominant rounding error, the two factors would hardly change the whitened residuals and
    /// would not converge. The rounding errors must be multiplied by the same factor in all residuals. If one axis is
    /// quantised much more coarsely than the other axes, the whitening estimates the rounding error of a rest from one
    /// residual and subtracts it from the other residuals. If the factors of these residuals differed, the whitening
    /// would subtract too much or too little. The other residuals would then exceed their noise, and the fit would
    /// increase their factor. The factors would differ even more, and the increased factor would grow without bound.
    /// The rounding errors of the rates have no factor, because the standard deviations of the mean rates, which
    /// contain the rounding errors of the rates, have no factor either.
    fn by_rounding(&self, linear: &Linear) -> [Mat<f64>; 2] {
        let rows = linear.head_rows();
        let (head, columns) = (linear.lines.len(), 3 * self.prepared.rests.len());
        let scales = &self.weights.widening.scales;
        let scale = scales.norms.max(scales.moves);
        let (mut by_rate, mut by_force) = (Mat::<f64>::zeros(head, columns), Mat::<f64>::zeros(head, columns));
        for (row, line) in linear.lines.iter().enumerate() {
            for ((rest, by), axis) in line.by_means.iter().flat_map(|by| [0, 1, 2].map(|axis| (by, axis))) {
                by_force[(row, 3 * rest + axis)] -= scale * by[axis];
            }
            // The two direction residuals of a move are consecutive rows. Both rows are written when the first row is
            // reached.
            if let Source::Move(k) = line.source
                && linear.lines.get(row + 1).is_some_and(|next| next.source == line.source)
            {
                let m = &self.prepared.moves[k];
                for (rest, by) in self.by_quiet_ends(m, &linear.moves[k], &linear.model) {
                    for (c, axis) in [0, 1].into_iter().flat_map(|c| [0, 1, 2].map(|axis| (c, axis))) {
                        by_rate[(row + c, 3 * rest + axis)] += by[(c, axis)];
                    }
                }
            }
        }
        let whitened = |mut lines: Mat<f64>| {
            self.weights.whitening.apply(&mut lines);
            let mut all = Mat::zeros(rows, columns);
            all.as_mut().subrows_mut(0, head).copy_from(&lines);
            all
        };
        let (mut by_rate, by_force) = (whitened(by_rate), whitened(by_force));
        for (place, (rest, _)) in linear.rates.iter().enumerate() {
            for (row, axis) in (0..3).flat_map(|row| (0..=row).map(move |axis| (row, axis))) {
                by_rate[(head + 3 * place + row, 3 * rest + axis)] = self.weights.rates[*rest][(row, axis)];
            }
        }
        [by_rate, by_force]
    }

    /// Computes the derivatives of a move's two direction residuals with respect to the rounding errors of the rates at
    /// the rests before and after the move. These errors change the rotation over the quiet ends of the move. In the
    /// middle of a move, the rate passes through many quantisation steps, so rounding errors average out.
    fn by_quiet_ends(&self, m: &Move, at_move: &AtMove, model: &Model) -> [(usize, Matrix2x3<f64>); 2] {
        let AtMove { pass, before, after } = at_move;
        let (across, inverse) = (rows_across(&after.up), model.gyroscope.inverse());
        let quiet = |at_end: bool| Matrix3::from_diagonal(&self.quiet_s(m, at_end));
        let start = across * pass.rotation.transpose() * before.up.cross_matrix() * inverse * quiet(false);
        let end = across * after.up.cross_matrix() * inverse * quiet(true);
        [(m.from, start), (m.to, end)]
    }

    /// Measures the duration of the quiet start of a move for each axis, s, or of its quiet end if `at_end` is true.
    /// During this time, the rate is within `QUIET` quantisation steps of its mean at the adjacent rest. The duration
    /// is zero for an axis without rounding errors.
    fn quiet_s(&self, m: &Move, at_end: bool) -> Vector3<f64> {
        let recording = &self.prepared.recordings[m.recording];
        let rest = &self.prepared.rests[if at_end { m.to } else { m.from }].rest.angular_rate;
        Vector3::from_fn(|axis, _| {
            let step = rest.rounding[axis].step;
            let is_quiet = |i: &usize| (recording.angular_rate.at(*i)[axis] - rest.mean[axis]).abs() < QUIET * step;
            let samples = m.first..=m.last;
            let count =
                if at_end { samples.rev().take_while(is_quiet).count() } else { samples.take_while(is_quiet).count() };
            // The sample at the boundary of the move represents only half a sampling interval.
            (count as f64 - 0.5).max(0.0) * m.interval_s
        })
    }
}

/// Adds `B K B^T` to the lower triangle of the covariance of force norms, gravity directions after moves and mean
/// rates. `own` is K, the covariance of an error with one value for each rest in `rests`. `by(row, rest)` is an entry
/// of B, the derivative of a whitened residual with respect to the error of a rest. A mean rate depends only on the
/// error of its own rest.
fn add_errors_of_rests(
    covariance: &mut Mat<f64>,
    linear: &Linear,
    by: impl Fn(usize, usize) -> f64,
    rests: &[usize],
    own: &Mat<f64>,
) {
    let head = linear.lines.len();
    let of_lines = Mat::from_fn(head, rests.len(), |row, place| by(row, rests[place]));
    let shared = product(of_lines.as_ref(), own.as_ref());
    add_product(covariance.submatrix_mut(0, 0, head, head), 1.0, shared.as_ref(), of_lines.as_ref());
    let place_of: BTreeMap<usize, usize> = rests.iter().enumerate().map(|(place, rest)| (*rest, place)).collect();
    // For each nonzero derivative of a mean rate: its row, the position of its rest in `rests`, and the derivative.
    let rates: Vec<(usize, usize, f64)> = linear
        .rates
        .iter()
        .enumerate()
        .filter_map(|(k, (rest, _))| Some((head + 3 * k, *rest, *place_of.get(rest)?)))
        .flat_map(|(first, rest, place)| [0, 1, 2].map(|axis| (first + axis, rest, place)))
        .map(|(row, rest, place)| (row, place, by(row, rest)))
        .filter(|(.., by)| *by != 0.0)
        .collect();
    for column in 0..head {
        let to = covariance.col_as_slice_mut(column);
        rates.iter().for_each(|(row, place, by)| to[*row] += by * shared[(column, *place)]);
    }
    for (k, (column, at, by)) in rates.iter().enumerate() {
        let (to, own) = (covariance.col_as_slice_mut(*column), own.col_as_slice(*at));
        rates[k..].iter().for_each(|(row, place, other)| to[*row] += by * other * own[*place]);
    }
}
