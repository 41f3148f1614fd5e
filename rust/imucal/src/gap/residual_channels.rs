//! Computes the residuals of a calibration for each kind of residual and each body axis, and the standard deviation of
//! each residual from sensor noise.
//!
//! ```text
//! rest_norm        |f| - g at a rest
//! rest_rate        mean angular rate at a rest, expected to be zero
//! move_direction   u_after x R^T u_before after a move: sine of the angle between measured and predicted direction
//! move_force       f(t) - g R(t)^T u_before inside the moves, means over 40 ms
//! ```
//!
//! All residuals are computed from corrected signals, in SI units and in the body frame. `f` is the specific force, `g`
//! is local gravity, and `u` is the unit vector up. `R` is the rotation, computed from integrated angular rates, from
//! the body frame at the end of the move to the body frame at its start. `R(t)` is the rotation from the body frame at
//! time t to the body frame at the start.

use std::collections::HashMap;

use imucal_core::calibration::Calibration;
use nalgebra::Vector3;

use super::move_blocks::{MoveBlocks, RelativeTemperature};
use super::residual_kinds::{CorrectedFit, Regressor, ResidualKind};
use crate::evaluate::{MoveReport, RestReport};
use crate::recording::Samples;
use crate::rests::noise_density::variance_by_axis;

/// Lower bounds of the noise densities of accelerometer and gyroscope, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz). Without these
/// bounds, residuals divided by their noise would be infinite in simulations without noise.
const LEAST_DENSITY: [f64; 2] = [1e-5, 1e-6];

/// Lower bound of 1 - u_i^2, where u is the direction up and i a body axis. The variance of a direction residual on
/// axis i is proportional to 1 - u_i^2. If axis i is vertical, the variance without this bound would be zero, because a
/// rotation about gravity does not change the direction of gravity.
const LEAST_VISIBLE_SHARE: f64 = 1e-4;

/// Residuals of one kind on one body axis.
pub(super) struct Channel {
    pub(super) kind: ResidualKind,
    /// Body axis 0, 1 or 2; `None` for the norm of the specific force.
    pub(super) axis: Option<usize>,
    /// Residuals, in the unit of the kind.
    pub(super) values: Vec<f64>,
    /// Standard deviation of each residual from sensor noise, in the unit of the kind.
    pub(super) sigma: Vec<f64>,
    /// Number of rests or moves that contribute residuals. Force residuals inside moves are counted by move, although
    /// each block of 40 ms contributes one residual. The residuals of one move are not independent, because the same
    /// attitude error affects all of them.
    pub(super) items: usize,
    /// Quantities on which the residuals may depend (regressors). For each regressor: one row for each residual, with
    /// the components of the quantity.
    pub(super) regressors: Vec<(Regressor, Vec<Vec<f64>>)>,
}

/// One rest or move, with the chi2 of its residuals.
pub(super) struct Item {
    pub(super) recording: usize,
    /// Index of the rest or move in the calibration's list of rests or of moves.
    pub(super) index: usize,
    pub(super) chi2: f64,
    /// Degrees of freedom of chi2.
    pub(super) dof: usize,
    /// For a rest: `|f| - g`, m/s^2. For a move: angle between predicted and measured gravity direction after the move,
    /// deg.
    pub(super) error: f64,
    /// Whether the fit excluded the rest or move as an outlier.
    pub(super) left_out: bool,
}

/// All residuals of a calibration on the recordings from which it was estimated, including rests and moves that the fit
/// excluded as outliers.
pub(super) struct Residuals {
    pub(super) channels: Vec<Channel>,
    pub(super) rests: Vec<Item>,
    pub(super) moves: Vec<Item>,
    /// Rotation vector of each move, rad. The key is the index of the move in the calibration's list of moves. The
    /// vector describes the rotation from the body frame at the end of the move to the body frame at its start.
    pub(super) rotation_vectors: HashMap<usize, Vector3<f64>>,
}

/// Noise of the sensors for each axis, and hand tremor.
struct Noise {
    /// White noise density, m/s^2/sqrt(Hz).
    accelerometer: Vector3<f64>,
    /// White noise density, rad/s/sqrt(Hz).
    gyroscope: Vector3<f64>,
    /// Bias instability of the gyroscope, rad/s.
    bias_instability: Vector3<f64>,
    /// Standard deviation of the attitude due to hand tremor, rad.
    tremor: f64,
}

impl Residuals {
    /// Computes the residuals of `fit` on its own recordings. `bias_instability` is the bias instability of the
    /// gyroscope, rad/s. `inside_moves` is true if the moves rotate the unit without translation. The specific force
    /// inside moves is compared with gravity only in this case.
    pub(super) fn new(fit: &CorrectedFit<'_>, bias_instability: Option<[f64; 3]>, inside_moves: bool) -> Self {
        let outcome = fit.outcome;
        let (accelerometer, gyroscope) = noise_densities(outcome);
        let noise = Noise {
            accelerometer,
            gyroscope,
            bias_instability: bias_instability.map_or_else(Vector3::zeros, Vector3::from),
            tremor: outcome.tremor_rad.iter().flatten().copied().fold(0.0, f64::max),
        };
        let temperatures: Vec<_> = fit.corrected.iter().map(RelativeTemperature::of).collect();
        let blocks: Vec<(usize, &MoveReport, MoveBlocks)> = outcome
            .moves
            .iter()
            .enumerate()
            .filter(|(_, span)| is_examined(span.excluded))
            .map(|(k, span)| {
                let temperature = temperatures[span.recording].as_ref();
                (k, span, MoveBlocks::new(&fit.corrected[span.recording], span, temperature))
            })
            .collect();
        let rotation_vectors = blocks.iter().map(|(k, _, blocks)| (*k, blocks.rotation_vector())).collect();
        let mut found = Self { channels: Vec::new(), rests: Vec::new(), moves: Vec::new(), rotation_vectors };
        found.add_rests(fit, &noise, &temperatures);
        found.add_moves(fit, &noise, &blocks);
        if inside_moves {
            found.add_inside(fit, &noise, &blocks);
        }
        found.channels.retain(|channel| !channel.values.is_empty());
        found
    }

    fn add_rests(&mut self, fit: &CorrectedFit<'_>, noise: &Noise, temperatures: &[Option<RelativeTemperature<'_>>]) {
        let outcome = fit.outcome;
        let rotation_before: HashMap<usize, Vector3<f64>> =
            self.rotation_vectors.iter().map(|(k, vector)| (outcome.moves[*k].to_rest, *vector)).collect();
        let rests: Vec<(usize, &RestReport)> =
            outcome.rests.iter().enumerate().filter(|(_, rest)| is_examined(rest.excluded)).collect();
        let with_temperature = rests.iter().all(|(_, rest)| temperatures[rest.recording].is_some());
        let mut channels = [None, Some(0), Some(1), Some(2)].map(|axis| {
            let kind = if axis.is_none() { ResidualKind::RestNorm } else { ResidualKind::RestRate };
            Channel::empty(kind, axis, rests.len())
        });
        for (k, rest) in rests {
            let samples = rest.first..rest.end;
            let corrected = &fit.corrected[rest.recording];
            let (force, rate) =
                (corrected.specific_force.slice(samples.clone()), corrected.angular_rate.slice(samples.clone()));
            let (force, rate) = (mean(force), mean(rate));
            let (norm, up, duration_s) = (force.norm(), force.normalize(), rest.end_s - rest.start_s);
            let squared = |v: &Vector3<f64>| v.component_mul(v);
            let Calibration { accelerometer, gyroscope, .. } = &outcome.calibration;
            let by_mean = accelerometer.inverse().tr_mul(&up);
            let rounding = squared(&by_mean).dot(&squared(&rest.force_rounding));
            let sigma_norm = (squared(&up).dot(&squared(&noise.accelerometer)) / duration_s + rounding).sqrt();
            // Hand tremor causes independent random attitude errors at the two ends of a rest. Their difference,
            // divided by the duration of the rest, is an error of the mean rate.
            let by_tremor = 2.0 * (noise.tremor / duration_s).powi(2);
            let rounding = variance_by_axis(gyroscope.inverse(), &rest.rate_rounding);
            let sigma_rate = (squared(&noise.gyroscope) / duration_s + squared(&noise.bias_instability) + rounding)
                .map(|variance| (variance + by_tremor).sqrt());
            let values = [norm - fit.gravity_mps2, rate.x, rate.y, rate.z];
            let sigma = [sigma_norm, sigma_rate.x, sigma_rate.y, sigma_rate.z];
            let sign = rotation_before.get(&k).map_or_else(Vector3::zeros, |v| v.map(sign));
            let mut regressors = vec![
                (Regressor::Gravity, up.as_slice().to_vec()),
                (Regressor::GravitySquared, products(&up).to_vec()),
                (Regressor::SignOfTheLastTurn, sign.as_slice().to_vec()),
            ];
            if let Some(temperature) = temperatures[rest.recording].as_ref().filter(|_| with_temperature) {
                regressors.push((Regressor::Temperature, vec![temperature.mean_over(samples)]));
            }
            regressors.push((Regressor::Time, vec![rest.start_s - corrected.time_s[0]]));
            for (channel, (value, sigma)) in channels.iter_mut().zip(values.into_iter().zip(sigma)) {
                channel.push(value, sigma, regressors.clone());
            }
            self.rests.push(Item {
                recording: rest.recording,
                index: k,
                chi2: values.iter().zip(sigma).map(|(value, sigma)| (value / sigma).powi(2)).sum(),
                dof: 4,
                error: values[0],
                left_out: rest.excluded.is_some(),
            });
        }
        self.channels.extend(channels);
    }

    fn add_moves(&mut self, fit: &CorrectedFit<'_>, noise: &Noise, moves: &[(usize, &MoveReport, MoveBlocks)]) {
        let with_temperature = moves.iter().all(|(_, _, blocks)| blocks.has_temperature());
        let mut channels = axes().map(|axis| Channel::empty(ResidualKind::MoveDirection, axis, moves.len()));
        for (k, span, blocks) in moves {
            let [before, after] = fit.gravity_at_ends(span);
            let predicted = blocks.rotation.inverse() * before;
            let error = after.cross(&predicted);
            let sigma = direction_sigma(span, noise, fit.gravity_mps2);
            let mut changes = blocks.attitude_changes();
            changes.retain(|(regressor, _)| with_temperature || *regressor != Regressor::Temperature);
            for (axis, channel) in channels.iter_mut().enumerate() {
                let visible = (1.0 - after[axis] * after[axis]).max(LEAST_VISIBLE_SHARE).sqrt();
                let row = changes.iter().map(|(regressor, rows)| (*regressor, rows[axis].clone())).collect();
                channel.push(error[axis], sigma * visible, row);
            }
            self.moves.push(Item {
                recording: span.recording,
                index: *k,
                chi2: error.norm_squared() / (sigma * sigma),
                dof: 2,
                error: error.norm().atan2(after.dot(&predicted)).to_degrees(),
                left_out: span.excluded.is_some(),
            });
        }
        self.channels.extend(channels);
    }

    fn add_inside(&mut self, fit: &CorrectedFit<'_>, noise: &Noise, moves: &[(usize, &MoveReport, MoveBlocks)]) {
        let gravity = fit.gravity_mps2;
        let mut channels = axes().map(|axis| Channel::empty(ResidualKind::MoveForce, axis, moves.len()));
        for (_, span, blocks) in moves {
            let [before, _] = fit.gravity_at_ends(span);
            for block in &blocks.blocks {
                let up = block.mean_of_constant(&before);
                let error = block.specific_force - gravity * up;
                let regressors = vec![
                    (Regressor::AngularAcceleration, block.angular_acceleration.as_slice().to_vec()),
                    (Regressor::GravitySquared, products(&up).to_vec()),
                    (Regressor::RateSquared, products(&block.angular_rate).to_vec()),
                ];
                for (axis, channel) in channels.iter_mut().enumerate() {
                    // The attitude error due to gyroscope noise grows with time and tilts the predicted gravity
                    // direction.
                    let tilt = (gravity * noise.gyroscope[axis]).powi(2) * block.since_start_s;
                    let across = 1.0 - up[axis] * up[axis];
                    let variance = noise.accelerometer[axis].powi(2) / block.length_s + across * tilt;
                    channel.push(error[axis], variance.sqrt(), regressors.clone());
                }
            }
        }
        self.channels.extend(channels);
    }
}

impl Channel {
    fn empty(kind: ResidualKind, axis: Option<usize>, items: usize) -> Self {
        Self { kind, axis, values: Vec::new(), sigma: Vec::new(), items, regressors: Vec::new() }
    }

    fn push(&mut self, value: f64, sigma: f64, regressors: Vec<(Regressor, Vec<f64>)>) {
        self.values.push(value);
        self.sigma.push(sigma);
        if self.regressors.is_empty() {
            self.regressors = regressors.iter().map(|(regressor, _)| (*regressor, Vec::new())).collect();
        }
        for ((_, rows), (_, row)) in self.regressors.iter_mut().zip(regressors) {
            rows.push(row);
        }
    }

    /// Root mean square of the residuals divided by their standard deviations.
    pub(super) fn times_noise(&self) -> f64 {
        crate::numerics::stats::rms(self.values.iter().zip(&self.sigma).map(|(value, sigma)| value / sigma))
    }
}

impl CorrectedFit<'_> {
    /// Direction up in the body frame before and after a move, as estimated by the fit. If the fit excluded the move,
    /// these are the directions that the accelerometer measured at the rests before and after the move.
    fn gravity_at_ends(&self, span: &MoveReport) -> [Vector3<f64>; 2] {
        [(span.gravity_before, span.from_rest), (span.gravity_after, span.to_rest)].map(|(known, rest)| {
            if known.iter().all(|value| value.is_finite()) {
                return known;
            }
            let rest = &self.outcome.rests[rest];
            mean(self.corrected[rest.recording].specific_force.slice(rest.first..rest.end)).normalize()
        })
    }
}

/// White noise densities of accelerometer and gyroscope for each axis, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz).
pub(super) fn noise_densities(outcome: &crate::calibrate::Outcome) -> (Vector3<f64>, Vector3<f64>) {
    let noise = &outcome.noise_density;
    let [accelerometer, gyroscope] = LEAST_DENSITY;
    (
        noise.specific_force.map(|density| density.max(accelerometer)),
        noise.angular_rate.map(|density| density.max(gyroscope)),
    )
}

/// Standard deviation, due to sensor noise, of each component of the direction residual after a move, rad.
fn direction_sigma(span: &MoveReport, noise: &Noise, gravity_mps2: f64) -> f64 {
    let sigma = span.direction_sigma_deg.to_radians();
    if sigma > 0.0 {
        return sigma;
    }
    // The fit excluded the move and therefore computed no standard deviation. It is computed here from the angle random
    // walk over the move, and from accelerometer noise averaged over one second at each end.
    let ends = 2.0 * noise.accelerometer.norm_squared() / 3.0 / (gravity_mps2 * gravity_mps2);
    (noise.gyroscope.norm_squared() / 3.0 * span.duration_s + ends).sqrt()
}

/// Whether the residuals of a rest or move are examined. They are examined if the fit used the rest or move, or
/// excluded it as an outlier.
fn is_examined(excluded: Option<&str>) -> bool {
    excluded.is_none_or(|reason| reason.starts_with("contradicts"))
}

fn axes() -> [Option<usize>; 3] {
    [Some(0), Some(1), Some(2)]
}

fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

/// Squares and pairwise products of the three components of a vector.
fn products(v: &Vector3<f64>) -> [f64; 6] {
    [v.x * v.x, v.y * v.y, v.z * v.z, v.x * v.y, v.x * v.z, v.y * v.z]
}

fn mean(rows: Samples<'_>) -> Vector3<f64> {
    rows.iter().map(Vector3::from).sum::<Vector3<f64>>() / rows.len() as f64
}
