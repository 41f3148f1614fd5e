//! Calibration of an accelerometer without a gyroscope. The nine parameters are estimated from the means of the rests.
//!
//! The residuals of the fit are the norms of the specific force at the rests minus local gravity (model.md (5)). The
//! covariance of the parameters is computed as in model.md (9). Without a gyroscope, moves are not used, and neither
//! hand tremor nor effects (further terms of the sensor model) are estimated.

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::held_estimates::{HeldEstimate, held_estimates, prior_cost};
use super::offer::{Reduced, with_offer};
use super::outcome::{in_frame, noise_density, rows};
use super::unit_data::{UnitData, refuse_errors};
use super::verdict::{MAX_CONTRADICTING_SHARE, are_many, held_by_default};
use super::{Options, References};
use crate::check::check_accelerometer_gains;
use crate::error::Error;
use crate::evaluate::{Figures, RestReport, figures};
use crate::finding::Finding;
use crate::frame::{Frame, Sensitivities};
use crate::held::{HeldParameter, PriorCost};
use crate::numerics::fit_report::FitReport;
use crate::numerics::lsq::Termination;
use crate::parameters::{ACCEL, parameter_names};
use crate::recording::Recording;
use crate::rests::rest::Rest;
use crate::rests::segment::Threshold;
use crate::two_stage::accelerometer::{AccelerometerFit, parameters_of};
use crate::two_stage::ellipsoid::Start;
use crate::two_stage::uncertainty::accelerometer_covariance;
use crate::verdict::{GroupMisfit, Reason, RecordingSet, ResidualGroup, Verdict};

/// A calibration of an accelerometer without a gyroscope, with its covariance, residuals and figures of merit.
#[derive(Clone, Debug)]
pub struct AccelerometerOutcome {
    /// Sensitivity and bias of the accelerometer, in the body frame `frame`.
    pub triad: Triad<f64>,
    /// Body frame of the triad.
    pub frame: Frame,
    /// Names of the nine parameters.
    pub names: Vec<String>,
    /// Values of the nine parameters, in the order of `names`, raw units.
    pub values: Vec<f64>,
    /// Covariance matrix of the parameters, as a list of its rows. Gravity is assumed to be known exactly.
    /// [`covariance_with_references`](Self::covariance_with_references) includes the uncertainty of gravity.
    pub covariance: Vec<Vec<f64>>,
    /// One report for each detected rest: its mean reading, its residual, and the reason if it is excluded.
    pub rests: Vec<RestReport>,
    /// For each recording, the threshold of rest detection. The unit is at rest if (variance of the readings) /
    /// (variance of the noise) is below this threshold.
    pub thresholds: Vec<Threshold>,
    /// White-noise densities of the axes x, y, z, m/s^2/sqrt(Hz). Each is the median over the recordings.
    pub noise_density: Vector3<f64>,
    /// Report of the fit: chi2, and why the iterations ended.
    pub fit: FitReport,
    /// Standard deviation of the norm of the mean specific force at a rest, m/s^2, estimated from the residuals of the
    /// fit. `None` if the noise is known.
    pub noise_from_residuals_mps2: Option<f64>,
    /// Parameters with a prior (held parameters), with their estimates; empty if there are none.
    pub held: Vec<HeldEstimate>,
    /// Share of each parameter's variance that is due to the priors of the held parameters, in the order of `names`;
    /// empty if no parameter is held.
    pub prior_shares: Vec<f64>,
    /// Error that the uncertainty of the priors causes in a measured gravity direction; `None` if no parameter is held.
    /// Its field `rotation_deg` is NaN, because an accelerometer does not measure rotations.
    pub prior_cost: Option<PriorCost>,
    /// Goodness of fit of the norms of the specific force at the rests, relative to noise; empty if the fit has no
    /// degrees of freedom.
    pub groups: Vec<GroupMisfit>,
    /// Residual statistics of the calibration on its own recordings: chi2 and the rms error of the norm of gravity. The
    /// statistics of moves are NaN or zero, because moves are not used.
    pub figures: Figures,
    /// Warnings about the recordings.
    pub findings: Vec<Finding>,
}

/// Calibrates an accelerometer from one or more of its recordings. Gyroscope columns are not used.
///
/// # Errors
/// * [`Error::Input`] for invalid options, and for options that need a gyroscope.
/// * [`Error::Data`] lists faults that would make the result wrong.
/// * [`Error::NotEnoughMotion`] names the parameters that are not determined and the poses to add.
/// * [`Error::Fit`] if the fit has no usable result.
pub fn calibrate_accelerometer(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
) -> Result<AccelerometerOutcome, Error> {
    refuse_options(options)?;
    match of_recordings(recordings, options) {
        Err(Error::NotEnoughMotion(words)) => {
            let fit = |options: &Options<'_>| of_recordings(recordings, options).ok()?.as_reduced();
            Err(Error::NotEnoughMotion(with_offer(options, &words, fit).unwrap_or(words)))
        }
        other => other,
    }
}

/// Calibrates like [`calibrate_accelerometer`], but error messages do not offer a model with fewer parameters.
fn of_recordings(recordings: &[Recording<'_>], options: &Options<'_>) -> Result<AccelerometerOutcome, Error> {
    let recordings: Vec<Recording<'_>> = recordings.iter().map(Recording::accelerometer_alone).collect();
    let data = UnitData::of_accelerometer(&recordings, options)?;
    let fit = data.fit_rests(options)?;
    let rests: Vec<&Rest> = data.rests.iter().map(|rest| &rest.rest).collect();
    let reports = data.rest_reports(&fit.triad, &fit.used, &[], options.gravity_mps2);
    let held = of_accelerometer(data.held(options)?);
    let mut outcome = AccelerometerOutcome::of_fit(&fit, &rests, reports, &held, options)?;
    outcome.noise_density = noise_density(data.noise(), [&outcome.triad, &Triad::identity()]).specific_force;
    outcome.thresholds = data.segments.into_iter().map(|segments| segments.threshold).collect();
    outcome.findings = data.findings;
    let gains = check_accelerometer_gains(&recordings[0], &outcome.triad);
    refuse_errors(gains.as_slice())?;
    outcome.findings.extend(gains);
    Ok(outcome)
}

/// Returns an error for an option that needs a gyroscope.
pub(super) fn refuse_options(options: &Options<'_>) -> Result<(), Error> {
    let needs = [
        ("effects", !options.effects.is_empty() || !options.user_fields.is_empty()),
        ("a cross-validation (folds)", options.folds.is_some()),
        ("bias instability and random walk (unit)", options.wander.is_some()),
        ("gyro_nominal", options.gyro_nominal.is_some()),
        ("a held parameter of the gyroscope", options.priors.hold.iter().any(|hold| hold.name.starts_with("gyro"))),
        ("a calibration of the accelerometer", options.priors.accelerometer.is_some()),
    ];
    match needs.iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((option, _)) => Err(Error::Input(format!(
            "{option} needs a gyroscope [sensor_missing]: an accelerometer alone is fitted to its rests with bias, scale \
             and misalignment only; leave it out, or record both sensors"
        ))),
    }
}

/// Returns the held parameters (parameters with a prior) that belong to the accelerometer.
pub(super) fn of_accelerometer(held: Vec<HeldParameter>) -> Vec<HeldParameter> {
    held.into_iter().filter(|held| ACCEL.contains(&held.parameter())).collect()
}

impl AccelerometerOutcome {
    /// Creates the result from the accelerometer fit `fit` to `rests`. `reports` are the reports of these rests, and
    /// `held` are the parameters with a prior. The fields `thresholds` and `findings` stay empty, and `noise_density`
    /// is NaN. The caller sets them.
    pub(super) fn of_fit(
        fit: &AccelerometerFit,
        rests: &[&Rest],
        reports: Vec<RestReport>,
        held: &[HeldParameter],
        options: &Options<'_>,
    ) -> Result<Self, Error> {
        let figures = figures(&reports, &[], &[], ACCEL.len().saturating_sub(held.len()));
        let symmetric = accelerometer_covariance(rests, fit);
        let start = Start { sensitivity: *fit.triad.sensitivity(), bias: *fit.triad.bias() };
        let (held, mut of_priors) = held_estimates((&parameters_of(&start), &symmetric), held, &[]);
        of_priors += &fit.second_order;
        let by_priors = Mat::from_fn(21, 21, |i, j| if i < 9 && j < 9 { of_priors[(i, j)] } else { 0.0 });
        // An accelerometer does not measure rotations, so the error of a rotation is NaN.
        let cost = || PriorCost { rotation_deg: f64::NAN, ..prior_cost(&by_priors, &fit.triad, &Triad::identity()) };
        let prior_cost = (!held.is_empty()).then(cost);
        let (triad, [covariance, of_priors]) = of_frame(fit, [symmetric, of_priors], options.frame)?;
        let share = |p: usize| (of_priors[(p, p)] / covariance[(p, p)]).min(1.0);
        let free = options.frame.free_entries();
        let entries = free.map(|entry| triad.sensitivity()[entry]);
        Ok(Self {
            frame: options.frame,
            names: parameter_names(options.frame)[ACCEL].into(),
            values: triad.bias().iter().copied().chain(entries).collect(),
            covariance: rows(&covariance),
            prior_shares: if held.is_empty() { Vec::new() } else { (0..9).map(share).collect() },
            prior_cost,
            held,
            groups: group(fit.report, &figures).into_iter().collect(),
            rests: reports,
            thresholds: Vec::new(),
            noise_density: Vector3::repeat(f64::NAN),
            fit: fit.report,
            noise_from_residuals_mps2: None,
            figures,
            findings: Vec::new(),
            triad,
        })
    }

    /// Returns the data that an error message states if it offers the model of this result as a model with fewer
    /// parameters: the held parameters, and the errors that their priors cause. `None` if the verdict is `poor`.
    pub(super) fn as_reduced(&self) -> Option<Reduced> {
        let is_usable = !matches!(self.verdict(), Verdict::Poor(_));
        is_usable.then(|| Reduced { held: self.held.clone(), cost: self.prior_cost, condition: None })
    }

    /// The covariance matrix of the parameters, as a list of its rows. It includes the uncertainty of local gravity
    /// (model.md (38)).
    pub fn covariance_with_references(&self, references: &References, gravity_mps2: f64) -> Vec<Vec<f64>> {
        let variance = (references.gravity_sigma_mps2 / gravity_mps2).powi(2);
        let mut covariance = self.covariance.clone();
        for (i, row) in covariance.iter_mut().enumerate().skip(3) {
            for (j, entry) in row.iter_mut().enumerate().skip(3) {
                *entry += self.values[i] * self.values[j] * variance;
            }
        }
        covariance
    }

    /// The verdict `good`, or the verdict `incomplete` or `poor` with its reasons. Control recordings have a separate
    /// verdict, see [`evaluate_accelerometer`](crate::evaluate::evaluate_accelerometer).
    pub fn verdict(&self) -> Verdict {
        let set = RecordingSet::Calibration;
        let mut reasons = Vec::new();
        if self.fit.termination != Termination::Converged {
            reasons.push(Reason::NotConverged { fit: "the accelerometer fit", report: self.fit });
        }
        reasons.extend(self.figures.reason_of_accelerometer(set));
        let contradicts = |rest: &&RestReport| rest.excluded.is_some_and(|reason| reason.starts_with("contradicts"));
        let (count, all) = (self.rests.iter().filter(contradicts).count(), self.rests.len());
        if are_many(count, all, MAX_CONTRADICTING_SHARE) {
            reasons.push(Reason::ContradictingRests { count, all });
        }
        if self.fit.degrees_of_freedom == 0 || self.noise_from_residuals_mps2.is_some() {
            let (rests, noise_mps2) = (self.figures.rests, self.noise_from_residuals_mps2);
            let parameters = ACCEL.len().saturating_sub(self.held.len());
            reasons.push(Reason::NotTested { rests, parameters, noise_mps2 });
        }
        reasons.extend(held_by_default(&self.held, self.prior_cost));
        reasons.extend(Reason::above_noise(set, &self.groups, &[]));
        Verdict::of(reasons)
    }
}

/// Converts the fitted triad, and covariance matrices of its nine parameters, from the symmetric to the requested body
/// frame.
fn of_frame(
    fit: &AccelerometerFit,
    covariances: [Mat<f64>; 2],
    frame: Frame,
) -> Result<(Triad<f64>, [Mat<f64>; 2]), Error> {
    let symmetric = Sensitivities { accelerometer: *fit.triad.sensitivity(), gyroscope: Matrix3::identity() };
    // The conversion expects the covariance of all 21 parameters, so zeros are added for the gyroscope. They do not
    // change the result for the accelerometer.
    let all = covariances.map(|own| Mat::from_fn(21, 21, |i, j| if i < 9 && j < 9 { own[(i, j)] } else { 0.0 }));
    let (converted, all) = in_frame(frame, symmetric, all, &mut [])?;
    let triad = Triad::try_new(converted.accelerometer, *fit.triad.bias());
    Ok((triad.map_err(|error| Error::Fit(error.to_string()))?, all.map(|all| all.submatrix(0, 0, 9, 9).to_owned())))
}

fn group(report: FitReport, figures: &Figures) -> Option<GroupMisfit> {
    (report.degrees_of_freedom > 0).then_some(GroupMisfit {
        group: ResidualGroup::RestNorms,
        rms: figures.gravity_norm_rms_mps2,
        chi2: report.chi2,
        degrees_of_freedom: report.degrees_of_freedom as f64,
    })
}
