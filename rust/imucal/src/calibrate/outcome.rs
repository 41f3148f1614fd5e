//! The result of a calibration.

use faer::Mat;
use imucal_core::calibration::Calibration;
use imucal_core::effects::{Effect, EffectValues};
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::held_estimates::{HeldEstimate, held_estimates, prior_cost};
use super::jointly::Selection;
use super::unit_data::UnitData;
use super::{CrossValidation, Options};
use crate::calibrate::two_stages::Gyroscope;
use crate::error::Error;
use crate::evaluate::{Figures, MoveReport, RestReport, figures, move_report, unusable_report};
use crate::finding::Finding;
use crate::frame::{self, Frame, Sensitivities};
use crate::held::PriorCost;
use crate::joint::{JointFit, Misfit, Misfits, Model, ResidualScales, TermEstimate};
use crate::numerics::fit_report::FitReport;
use crate::numerics::stats::median;
use crate::parameters::{parameter_names, parameter_values};
use crate::rests::moves::{Move, Unusable};
use crate::rests::noise_density::{NoiseDensity, variance_by_axis};
use crate::rests::segment::Threshold;
use crate::two_stage::accelerometer::AccelerometerFit;
use crate::verdict::{GroupMisfit, ResidualGroup};

/// A calibration with its covariance, its residuals and the statistics of the fit.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The calibration: the sensitivities and biases of both triads in the body frame `frame`, and the effects of the
    /// catalogue. A triad is the three axes of the accelerometer or of the gyroscope.
    pub calibration: Calibration<f64>,
    /// Body frame of the triads.
    pub frame: Frame,
    /// Estimates of the requested effects: first the effects of the catalogue, then the user-defined effects, each in
    /// the order of the options.
    pub effects: Vec<TermEstimate>,
    /// Names of the parameters: first the 21 parameters of the triads, then the parameters of the effects.
    pub names: Vec<String>,
    /// Values of the parameters, in the order of `names`. They are in raw units for the triads, and in SI units for the
    /// effects.
    pub values: Vec<f64>,
    /// Covariance matrix of the parameters, as a list of its rows. Gravity and the rate of the clock are assumed to be
    /// known exactly. [`covariance_with_references`](Self::covariance_with_references) includes the uncertainty of
    /// gravity and of the clock rate.
    pub covariance: Vec<Vec<f64>>,
    /// One report for each detected rest: its mean readings, its residual, and the reason if it is excluded.
    pub rests: Vec<RestReport>,
    /// One report for each interval between consecutive rests: the error of the propagated gravity direction, and the
    /// reason if the interval is excluded.
    pub moves: Vec<MoveReport>,
    /// For each recording, the threshold of rest detection. The unit is at rest if (variance of the readings) /
    /// (variance of the noise) is below this threshold.
    pub thresholds: Vec<Threshold>,
    /// White-noise densities of the unit, SI units per sqrt(Hz). Each is the median over the recordings.
    pub noise_density: NoiseDensity,
    /// Report of the accelerometer fit: chi2, and why the iterations ended.
    pub accelerometer_fit: FitReport,
    /// Report of the gyroscope fit: chi2, and why the iterations ended.
    pub gyroscope_fit: FitReport,
    /// Report of the joint fit; `None` if no joint fit was requested. With a joint fit, the accelerometer and
    /// gyroscope fits only provide its start values.
    pub joint_fit: Option<FitReport>,
    /// Goodness of fit (chi2) of the joint fit; `None` without a joint fit. In this chi2, each residual is weighted
    /// with sensor noise only (model.md (26)).
    pub misfit: Option<Misfit>,
    /// Goodness of fit of each kind of residuals, relative to noise. The kinds of the two-stage fit are the norms of
    /// the specific force at the rests and the gravity directions after the moves.
    pub groups: Vec<GroupMisfit>,
    /// For each kind of residual, the factor by which the joint fit multiplies the standard deviations of these
    /// residuals (model.md (19)); `None` without a joint fit.
    pub joint_scales: Option<ResidualScales>,
    /// Bias instability, rad/s, that the weights of the joint fit assume for each gyroscope axis. It is given by the
    /// options, or estimated from the scatter of the mean rates at the rests. `None` if the weights assume constant
    /// biases.
    pub bias_instability_radps: Option<[f64; 3]>,
    /// For each recording, the standard deviation of the hand tremor about each axis, rad; `None` for a unit on a rigid
    /// support. Only the joint fit estimates tremor.
    pub tremor_rad: Vec<Option<f64>>,
    /// Parameters with a prior (held parameters), with their estimates; empty if there are none.
    pub held: Vec<HeldEstimate>,
    /// Share of each parameter's variance that is due to the priors of the held parameters, in the order of `names`;
    /// empty if no parameter is held.
    pub prior_shares: Vec<f64>,
    /// Errors that the uncertainty of the priors causes in a measured gravity direction and in a measured rotation;
    /// `None` if no parameter is held.
    pub prior_cost: Option<PriorCost>,
    /// Residual statistics of the calibration on its own recordings: chi2, and the rms errors of the norm and of the
    /// direction of gravity.
    pub figures: Figures,
    /// Result of the cross-validation; `None` if no folds were requested.
    pub held_out: Option<CrossValidation>,
    /// Warnings about the recordings and the result.
    pub findings: Vec<Finding>,
}

impl Outcome {
    /// Creates the result of the two-stage fit, in the requested body frame.
    pub(super) fn new(
        mut data: UnitData<'_>,
        accelerometer: &AccelerometerFit,
        gyroscope: &Gyroscope,
        unusable: &[Unusable],
        options: &Options<'_>,
    ) -> Result<Self, Error> {
        let rests = data.rest_reports(&accelerometer.triad, &accelerometer.used, &[], options.gravity_mps2);
        let mut moves = gyroscope.move_reports(unusable);
        let figures = figures(&rests, &moves, &gyroscope.used_residuals(), 18);
        let covariance = data.covariance(accelerometer, gyroscope);
        let symmetric = Sensitivities {
            accelerometer: *accelerometer.triad.sensitivity(),
            gyroscope: *gyroscope.fit.triad.sensitivity(),
        };
        let (sensitivities, [covariance]) = in_frame(options.frame, symmetric, [covariance], &mut moves)?;
        let calibration = Calibration::new(
            triad(sensitivities.accelerometer, *accelerometer.triad.bias())?,
            triad(sensitivities.gyroscope, data.bias.bias)?,
        );
        data.findings.extend(gyroscope.findings.iter().cloned());
        Ok(Self {
            frame: options.frame,
            effects: Vec::new(),
            names: parameter_names(options.frame).into(),
            values: parameter_values(&calibration, options.frame).into(),
            covariance: rows(&covariance),
            rests,
            moves,
            noise_density: noise_density(data.noise(), [&calibration.accelerometer, &calibration.gyroscope]),
            thresholds: data.segments.into_iter().map(|segments| segments.threshold).collect(),
            accelerometer_fit: accelerometer.report,
            gyroscope_fit: gyroscope.fit.report,
            joint_fit: None,
            misfit: None,
            groups: groups_of_two_stages(accelerometer.report, gyroscope.fit.report, &figures),
            joint_scales: None,
            bias_instability_radps: None,
            tremor_rad: vec![None; data.recordings.len()],
            held: Vec::new(),
            prior_shares: Vec::new(),
            prior_cost: None,
            figures,
            held_out: None,
            findings: data.findings,
            calibration,
        })
    }

    /// Creates the result of the joint fit. `started_from` contains the reports of the accelerometer and gyroscope fits
    /// whose results were the start values.
    pub(super) fn joint(
        mut data: UnitData<'_>,
        started_from: [FitReport; 2],
        findings: &[Finding],
        joint: &JointFit,
        misfits: &Misfits,
        selection: &Selection,
        options: &Options<'_>,
    ) -> Result<Self, Error> {
        let Model { accelerometer: force, gyroscope: rate, .. } = &joint.model;
        let mut rests = data.rest_reports(force, &selection.used, &joint.norms, options.gravity_mps2);
        for (report, misfit) in rests.iter_mut().zip(&misfits.rests) {
            report.misfit = *misfit;
        }
        // The interval between two epochs (parts) of one rest is not a move, because the unit does not rotate in it.
        let is_move = |m: &Move| !m.is_within_rest(&data.rests);
        let judged = || {
            let all = selection.moves.iter().zip(&joint.moves).zip(&misfits.moves);
            all.filter(|((m, _), _)| is_move(m))
        };
        let mut moves: Vec<MoveReport> = judged()
            .map(|((m, (ends, r)), misfit)| MoveReport {
                misfit: *misfit,
                ..move_report(&m.between_rests(&data.rests), ends, r, None)
            })
            .collect();
        let left_out = selection.left_out.iter().filter(|u| is_move(&u.span));
        moves.extend(left_out.map(|u| unusable_report(&u.span.between_rests(&data.rests), u.reason)));
        moves.sort_by_key(|report| (report.recording, report.first));
        let residuals: Vec<f64> = judged()
            .flat_map(|((_, (ends, rotation)), _)| <[f64; 2]>::from(ends.residual(rotation) / ends.sigma_rad))
            .collect();
        let symmetric = Sensitivities { accelerometer: *force.sensitivity(), gyroscope: *rate.sensitivity() };
        let all = 21 + joint.terms.iter().map(|term| term.parameter_names.len()).sum::<usize>();
        let (held, mut of_priors) =
            held_estimates((&joint.model.parameters(), &joint.covariance), &data.held(options)?, &misfits.held);
        if let Some(own) = &joint.second_order {
            of_priors += own;
        }
        // Number of parameters that the priors determine instead of the residuals. The degrees of freedom are the
        // number of residuals minus the number of parameters that the residuals determine.
        let by_priors = held.iter().map(|held| (held.sigma / held.prior.sigma).powi(2)).sum::<f64>().round() as usize;
        let is_any_held = held.iter().any(|held| !held.prior.is_combination());
        let prior_cost = is_any_held.then(|| prior_cost(&of_priors, force, rate));
        let of_unit = |matrix: &Mat<f64>| matrix.submatrix(0, 0, all, all).to_owned();
        let covariances = [of_unit(&joint.covariance), of_unit(&of_priors)];
        let (sensitivities, [covariance, of_priors]) = in_frame(options.frame, symmetric, covariances, &mut moves)?;
        // The parameters of an accelerometer that was calibrated earlier have priors, too. They are listed as held
        // parameters only if the recordings contradict these priors.
        let held: Vec<HeldEstimate> =
            held.into_iter().filter(|held| !held.prior.is_combination() || held.is_contradicted()).collect();
        let share =
            |p: usize| if covariance[(p, p)] > 0.0 { (of_priors[(p, p)] / covariance[(p, p)]).min(1.0) } else { 0.0 };
        let prior_shares = if held.is_empty() { Vec::new() } else { (0..all).map(share).collect() };
        let mut calibration = Calibration::new(
            triad(sensitivities.accelerometer, *force.bias())?,
            triad(sensitivities.gyroscope, *rate.bias())?,
        );
        let mut names = Vec::from(parameter_names(options.frame));
        let mut values = Vec::from(parameter_values(&calibration, options.frame));
        for estimate in &joint.terms {
            names.extend(estimate.parameter_names.iter().cloned());
            values.extend(estimate.values.iter().chain(&estimate.shape));
            if let Some(effect) = Effect::find(&estimate.name).filter(|_| estimate.in_catalogue) {
                let member = EffectValues::try_new(effect, &estimate.values, estimate.shape);
                let taken = member.and_then(|member| calibration.effects.push(member));
                taken.map_err(|error| Error::Fit(error.to_string()))?;
            }
        }
        data.findings.extend(findings.iter().cloned());
        Ok(Self {
            frame: options.frame,
            effects: joint.terms.clone(),
            names,
            values,
            covariance: rows(&covariance),
            figures: figures(&rests, &moves, &residuals, (all - 3).saturating_sub(by_priors)),
            rests,
            moves,
            noise_density: noise_density(data.noise(), [&calibration.accelerometer, &calibration.gyroscope]),
            bias_instability_radps: joint.wander.map(|unit| unit.gyroscope.bias_instability),
            tremor_rad: data.tremor_rad(),
            thresholds: data.segments.into_iter().map(|segments| segments.threshold).collect(),
            accelerometer_fit: started_from[0],
            gyroscope_fit: started_from[1],
            joint_fit: Some(joint.report),
            misfit: misfits.all,
            groups: misfits.groups.clone(),
            joint_scales: Some(joint.scales),
            held,
            prior_shares,
            prior_cost,
            held_out: None,
            findings: data.findings,
            calibration,
        })
    }
}

/// Returns the goodness of fit of both kinds of residuals of the two-stage fit. Each residual is weighted with sensor
/// noise only.
fn groups_of_two_stages(accelerometer: FitReport, gyroscope: FitReport, figures: &Figures) -> Vec<GroupMisfit> {
    let direction_rad = figures.gravity_direction_rms_deg.to_radians();
    let groups = [
        (ResidualGroup::RestNorms, accelerometer, figures.gravity_norm_rms_mps2),
        (ResidualGroup::MoveDirections, gyroscope, direction_rad),
    ];
    let judged = groups.into_iter().filter(|(_, report, _)| report.degrees_of_freedom > 0);
    let of = |(group, report, rms): (ResidualGroup, FitReport, f64)| GroupMisfit {
        group,
        rms,
        chi2: report.chi2,
        degrees_of_freedom: report.degrees_of_freedom as f64,
    };
    judged.map(of).collect()
}

/// Converts sensitivities, covariances and gravity directions of the moves from the symmetric to the requested body
/// frame. Effects are defined only in the symmetric frame and are not converted.
pub(super) fn in_frame<const N: usize>(
    frame: Frame,
    symmetric: Sensitivities,
    covariances: [Mat<f64>; N],
    moves: &mut [MoveReport],
) -> Result<(Sensitivities, [Mat<f64>; N]), Error> {
    if frame == Frame::Symmetric {
        return Ok((symmetric, covariances));
    }
    let converted = frame::convert(&symmetric, frame)?;
    let jacobian = frame::parameter_jacobian(&symmetric, &converted, frame)?;
    let turn = frame::rotation(&symmetric.accelerometer, &converted.accelerometer)?;
    for report in moves {
        report.gravity_before = turn * report.gravity_before;
        report.gravity_after = turn * report.gravity_after;
    }
    Ok((converted, covariances.map(|covariance| &jacobian * covariance * jacobian.transpose())))
}

/// The rows of a matrix.
pub(super) fn rows(matrix: &Mat<f64>) -> Vec<Vec<f64>> {
    (0..matrix.nrows()).map(|i| (0..matrix.ncols()).map(|j| matrix[(i, j)]).collect()).collect()
}

/// Computes the median over the recordings of the noise density of each axis, in SI units. `noise` is in raw units, and
/// the triads convert it to SI units.
pub(super) fn noise_density(noise: &[NoiseDensity], [accelerometer, gyroscope]: [&Triad<f64>; 2]) -> NoiseDensity {
    let median_of = |pick: fn(&NoiseDensity) -> Vector3<f64>| {
        Vector3::from_fn(|axis, _| {
            let mut values: Vec<f64> = noise.iter().map(|noise| pick(noise)[axis]).collect();
            median(&mut values)
        })
    };
    let si = |raw: Vector3<f64>, triad: &Triad<f64>| variance_by_axis(triad.inverse(), &raw).map(f64::sqrt);
    NoiseDensity {
        specific_force: si(median_of(|noise| noise.specific_force), accelerometer),
        angular_rate: si(median_of(|noise| noise.angular_rate), gyroscope),
    }
}

fn triad(sensitivity: Matrix3<f64>, bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    Triad::try_new(sensitivity, bias).map_err(|error| Error::Fit(error.to_string()))
}
