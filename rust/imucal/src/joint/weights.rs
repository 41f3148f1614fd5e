//! Computes the weights of the residuals of the joint fit (model.md (19)).
//!
//! White noise is estimated from the rests of the recording. If residuals scatter significantly more than noise
//! explains, the excess is estimated from the residuals. For the mean rates, the excess is a covariance that is added
//! to the covariance of their noise. It describes either errors that are independent from rest to rest or a varying
//! bias. For all other residuals, the excess is a factor on their standard deviations. There is one factor for each
//! kind of residuals: force norms at rests, gravity directions after moves, force inside moves, and residuals relative
//! to the stand.

mod whiten;
mod widening;

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::encoders::Encoders;
use super::inside::InsideNoise;
use super::linear::{Linear, Source};
use super::model::Model;
use super::prepared::Prepared;
use super::terms::Terms;
use crate::joint::BiasWander;
use crate::joint::wander::MOST_ROWS;
use crate::numerics::lsq::Solution;
use crate::numerics::stats::median;
use crate::rests::moves::FINEST_RAD;
use crate::rests::noise_density::{random_walk_rad, variance_per_axis};
use crate::rests::rest::FINEST_MPS2;
use crate::two_stage::observability::REST_ERROR_MPS2;
use whiten::{Shares, Whitening};
use widening::rate_covariance;
pub(super) use widening::{FACTORS, WIDENINGS, Widened};
pub(crate) use widening::{Scales, Widening};

/// Lower limit of the standard deviation of a mean rate, rad/s. Without it, weights would be infinite in noise-free
/// simulations.
const FINEST_RADPS: f64 = 1e-6;

/// Weights of all residuals.
#[derive(Clone)]
pub(crate) struct Weights {
    pub(crate) whitening: Whitening,
    /// Whitening matrix of the mean rate of each rest, per raw unit. It is the inverse of the lower Cholesky factor of
    /// the covariance of this mean rate.
    pub(crate) rates: Vec<Matrix3<f64>>,
    /// Noise variances of the residuals inside each move.
    pub(crate) inside: Vec<InsideNoise>,
    /// Standard deviation of the difference between the gravity direction at a rest and the direction computed from the
    /// encoders, rad.
    pub(crate) stand_sigma_rad: f64,
    /// Noise variance of one encoder reading, rad^2.
    pub(crate) reading: f64,
    /// Standard deviation of each component of a move's direction residual from noise only, rad.
    pub(crate) move_sigma_rad: Vec<f64>,
    pub(crate) widening: Widening,
}

impl Weights {
    /// Weights from noise only; no standard deviation is increased.
    pub(crate) fn of_noise(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Linear) -> Self {
        Self::with(prepared, terms, linear, &Widening::NONE)
    }

    /// Weights before the first fit. The variances of the mean rates include the excess scatter of the mean rates,
    /// computed from the residuals `linear`. All other standard deviations are from noise only.
    pub(crate) fn of(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Linear) -> Self {
        Self::with(prepared, terms, linear, &Widening::of(prepared, linear, None, None))
    }

    /// Estimates by how much the residuals exceed their noise after the fit `found`, which used these weights. `linear`
    /// contains the residuals at the end of this fit. For the kinds of residuals in `kept`, the standard deviations are
    /// increased even if the excess is not significant.
    pub(super) fn excess(
        &self,
        prepared: &Prepared<'_>,
        linear: &Linear,
        found: &Solution,
        kept: Option<&Widened>,
    ) -> Widening {
        Widening::of(prepared, linear, Some((found, &self.widening.scales)), kept)
    }

    /// Weights for the residuals `linear`, with a given excess of the residuals over noise.
    pub(super) fn with(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Linear, widening: &Widening) -> Self {
        let model = &linear.model;
        let scales = &widening.scales;
        let own: Vec<f64> =
            linear.lines.iter().map(|line| own_variance(prepared, model, line.source, scales)).collect();
        let poses = 3 * prepared.rests.len();
        let shares: Vec<Shares> = linear
            .lines
            .iter()
            .map(|line| {
                let scale = match (line.source, line.is_of_later_epoch) {
                    (Source::Norm(_), true) => scales.epochs,
                    (Source::Norm(_), false) => scales.norms,
                    (Source::Move(_), _) => 1.0,
                };
                // The first epoch (part) of a long rest determines |f| at its attitude, as any other rest does. The
                // later epochs have the same attitude, and thus the same model error of |f|. The model error is
                // therefore added as a common error of the later epochs, which then determine only changes of |f|.
                let pose = match line.source {
                    Source::Norm(k) if line.is_of_later_epoch => {
                        Some((poses + prepared.rests[k].whole, REST_ERROR_MPS2 * scales.epochs))
                    }
                    _ => None,
                };
                let of_means = line.by_means.iter().flat_map(|(rest, by)| share(prepared, *rest, by, scale));
                of_means.chain(pose).collect()
            })
            .collect();
        let mut rates = vec![Matrix3::zeros(); prepared.rests.len()];
        for (k, lines) in &linear.rates {
            let is_later = lines[0].is_of_later_epoch;
            let between = if is_later { widening.epoch_rates } else { widening.between_rests };
            let between_rests = Matrix3::from_diagonal(&Vector3::from(between));
            let factor = (rate_covariance(prepared, model, *k) + between_rests).cholesky().map(|factor| factor.l());
            rates[*k] = factor.and_then(|l| l.solve_lower_triangular(&Matrix3::identity())).unwrap_or_default();
        }
        Self {
            whitening: Whitening::new(&own, &shares, poses + prepared.rests.last().map_or(0, |rest| rest.whole + 1)),
            rates,
            inside: if linear.sees_inside() || terms.kinds.encoders {
                inside_noise(prepared, model, scales)
            } else {
                Vec::new()
            },
            stand_sigma_rad: stand_sigma_rad(prepared, scales),
            reading: reading_variance(prepared, scales),
            move_sigma_rad: (0..prepared.moves.len()).map(|k| move_sigma_rad(prepared, model, k)).collect(),
            widening: *widening,
        }
    }

    /// Bias instability of the gyroscope, estimated from the mean rates, raw units. Zero if it is not significant, or
    /// if it is known from the unit's profile.
    pub(crate) fn bias_instability(&self) -> [f64; 3] {
        self.widening.bias_instability
    }

    /// Variance with which the mean rates vary from epoch to epoch (part to part) of a long rest in excess of noise,
    /// for each axis, squared raw units.
    pub(crate) fn epoch_rates(&self) -> [f64; 3] {
        self.widening.epoch_rates
    }

    /// Ratio of scatter to noise that the weights assume, for each kind of residuals in the order of `Scales`. The last
    /// value is for the mean rates: the largest ratio over all rests and axes.
    pub(crate) fn times_noise(&self, prepared: &Prepared<'_>) -> [f64; 7] {
        let Scales { norms, moves, inside, stand_rests, stand_moves, epochs } = self.widening.scales;
        let mut rates = 1.0f64;
        for (rest, whitening) in prepared.rests.iter().zip(&self.rates) {
            let seen = whitening * rest.rate_covariance * whitening.transpose();
            for axis in (0..3).filter(|&axis| seen[(axis, axis)] > 0.0) {
                let wandering = self.widening.bias_instability[axis].powi(2) / rest.rate_covariance[(axis, axis)];
                rates = rates.max((seen[(axis, axis)].recip() + wandering).sqrt());
            }
        }
        [norms, moves, inside, stand_rests, stand_moves, epochs, rates]
    }
}

/// Standard deviation of each component of a move's direction residual from noise only, rad.
fn move_sigma_rad(prepared: &Prepared<'_>, model: &Model, k: usize) -> f64 {
    let shared: f64 = prepared.ends[k].iter().map(|end| end.shared_variance).sum();
    (own_variance(prepared, model, Source::Move(k), &Scales::NONE) + shared).sqrt()
}

/// Computes how a residual depends on the three errors of a rest's mean force, one per axis. `by` is the derivative of
/// the residual with respect to the mean force, and `scale` is a factor on the standard deviations of the errors. Each
/// entry of the result contains the index of an error, and the standard deviation of this error times the derivative of
/// the residual with respect to it.
fn share(prepared: &Prepared<'_>, rest: usize, by: &Vector3<f64>, scale: f64) -> [(usize, f64); 3] {
    let variance = prepared.rests[rest].rest.specific_force.variance_of_mean;
    [0, 1, 2].map(|axis| (3 * rest + axis, by[axis] * variance[axis].sqrt() * scale))
}

/// Computes the variance of the independent part of a residual's error: the part that no other residual contains.
fn own_variance(prepared: &Prepared<'_>, model: &Model, source: Source, scales: &Scales) -> f64 {
    match source {
        Source::Norm(k) => {
            let is_later = prepared.rests[k].is_later_epoch();
            (FINEST_MPS2 * if is_later { scales.epochs } else { scales.norms }).powi(2)
        }
        Source::Move(k) => {
            let m = &prepared.moves[k];
            let density = &prepared.noise[m.recording].angular_rate;
            let walk = random_walk_rad(density, model.gyroscope.inverse(), m.duration_s);
            let ends: f64 = prepared.ends[k].iter().map(|end| end.own_variance).sum();
            let own = walk * walk + ends + FINEST_RAD * FINEST_RAD;
            if m.is_within_rest(prepared.rests) {
                // The move from one epoch (part of a long rest) to the next has an error from the mean forces of both
                // epochs. These forces scatter by `scales.epochs` times their noise. This noise is already included as
                // a common error (see `share`), so only the additional variance is added here.
                let means: f64 = prepared.ends[k].iter().map(|end| end.shared_variance).sum();
                return own + means * (scales.epochs * scales.epochs - 1.0);
            }
            own * scales.moves * scales.moves
        }
    }
}

/// Noise variances of the residuals inside each move, in SI units.
fn inside_noise(prepared: &Prepared<'_>, model: &Model, scales: &Scales) -> Vec<InsideNoise> {
    prepared
        .moves
        .iter()
        .zip(prepared.ends)
        .map(|(m, [before, after])| {
            let noise = &prepared.noise[m.recording];
            let finest = FINEST_RAD * FINEST_RAD;
            InsideNoise {
                start: before.own_variance + before.shared_variance + finest,
                end: after.own_variance + after.shared_variance + finest,
                walk: variance_per_axis(model.gyroscope.inverse(), &noise.angular_rate) + finest / m.duration_s,
                force: (variance_per_axis(model.accelerometer.inverse(), &noise.specific_force)
                    + FINEST_MPS2 * FINEST_MPS2)
                    * scales.inside
                    * scales.inside,
            }
        })
        .collect()
}

/// Standard deviation of the difference between the gravity direction at a rest and the direction computed from the
/// encoders, rad. It is computed from the noise of the accelerometer (median over all ends of moves) and of the
/// encoders.
fn stand_sigma_rad(prepared: &Prepared<'_>, scales: &Scales) -> f64 {
    let mut shared: Vec<f64> =
        prepared.ends.iter().flatten().map(|end| end.shared_variance + end.own_variance).collect();
    let reading = prepared.encoders.as_ref().map_or(0.0, Encoders::mean_variance);
    (median(&mut shared) + reading + FINEST_RAD * FINEST_RAD).sqrt() * scales.stand_rests
}

/// Variance of one encoder reading in motion, rad^2; zero without encoders.
fn reading_variance(prepared: &Prepared<'_>, scales: &Scales) -> f64 {
    let variance = |encoders: &Encoders| encoders.reading_variance() + FINEST_RAD * FINEST_RAD;
    prepared.encoders.as_ref().map_or(0.0, variance) * scales.stand_moves * scales.stand_moves
}

/// Computes the covariance of the mean gyroscope biases at the rests that the fit uses, for a bias instability of 1.
/// The second and later epochs (parts) of long rests are omitted. `None` if there are too many residuals to factorise
/// their covariance.
pub(crate) fn flicker_of_rests(prepared: &Prepared<'_>) -> Option<Mat<f64>> {
    let is_later = |k: usize| prepared.rests[k].is_later_epoch();
    let places: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k] && !is_later(k)).collect();
    if rows(places.len(), prepared.moves.len()) > MOST_ROWS {
        return None;
    }
    let unit = BiasWander { bias_instability: [1.0; 3], random_walk: [0.0; 3] };
    let mut covariance = Mat::zeros(places.len(), places.len());
    for (index, recording) in prepared.recordings.iter().enumerate() {
        let (rests, spans) = prepared.rests_of(index);
        let (rests, spans): (Vec<usize>, Vec<[f64; 2]>) =
            rests.into_iter().zip(spans).filter(|(k, _)| !is_later(*k)).unzip();
        let at: Vec<usize> = rests.iter().map(|k| places.partition_point(|place| place < k)).collect();
        let own = unit.of_rests(0, &spans, recording.span_s());
        for (i, j) in (0..at.len()).flat_map(|i| (0..at.len()).map(move |j| (i, j))) {
            covariance[(at[i], at[j])] = own[(i, j)];
        }
    }
    Some(covariance)
}

/// Number of residuals: one norm and three mean rates per rest, and two direction components per move.
fn rows(rests: usize, moves: usize) -> usize {
    4 * rests + 2 * moves
}
