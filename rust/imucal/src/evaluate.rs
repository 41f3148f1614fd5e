//! Evaluation of a calibration on control recordings.

mod accelerometer_alone;
mod contradictions;
mod coverage;
mod group_misfits;
mod uncertainty;
mod verdict;

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::check::check_columns;
use crate::correct::correct;
use crate::error::Error;
use crate::finding::{Finding, Severity};
use crate::joint::Misfit;
use crate::numerics::stats::rms;
use crate::preintegration::integrate_rotation;
use crate::recording::{RawUnit, Recording};
use crate::rests::moves::{Directions, Ends, Move, between, direction_error_rad, saturated_stretches};
use crate::rests::noise_density::NoiseDensity;
use crate::rests::rest::norm_error_mps2;
use crate::rests::segment::Segments;
use crate::rests::tremor::{self, Sensors};
use crate::rests::unit_rest::{UnitRest, rests_of};
use crate::verdict::{GroupMisfit, Reason, RecordingSet, Verdict};
pub use accelerometer_alone::evaluate_accelerometer;
use contradictions::contradictions;
use group_misfits::Judged;
pub use uncertainty::Uncertainty;
pub(crate) use verdict::unknown_direction;
use verdict::{impossible_rates, uncorrected_samples, worse};

/// Figures of merit of a calibration on recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Sum of the squares of all residuals, each divided by its standard deviation due to noise. This sum is divided by
    /// the number of residuals minus the number of parameters that were fitted to them. The result is near 1 if noise
    /// explains the residuals.
    pub chi2_per_dof: f64,
    /// RMS over the rests of the difference (norm of the corrected specific force) - (local gravity), m/s^2.
    pub gravity_norm_rms_mps2: f64,
    /// RMS over the moves of the angle between the propagated and the measured direction of gravity, deg; NaN without
    /// moves.
    pub gravity_direction_rms_deg: f64,
    /// Number of rests used.
    pub rests: usize,
    /// Number of moves used.
    pub moves: usize,
}

/// Evaluation of one rest.
#[derive(Clone, Debug)]
pub struct RestReport {
    /// Index of the recording.
    pub recording: usize,
    /// Index of the first sample.
    pub first: usize,
    /// Index of the last sample plus one.
    pub end: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Time of the last sample, s.
    pub end_s: f64,
    /// Number of epochs (parts) of the rest. Each epoch has its own mean. The number is 1 if one mean describes the
    /// whole rest.
    pub epochs: usize,
    /// Unsteadiness (model.md (11)): the larger of two ratios, which are near 1 for a unit on a table and larger for a
    /// unit in a hand. The first ratio is the variance of the samples within half a second divided by the noise
    /// variance. The second ratio compares the drift of the mean force with the drift due to noise.
    pub unsteadiness: f64,
    /// Mean accelerometer reading in raw units, or in m/s^2 if the evaluated samples are already corrected for effects.
    pub mean_specific_force: Vector3<f64>,
    /// Mean gyroscope reading in raw units, or in rad/s if the evaluated samples are already corrected for effects.
    pub mean_angular_rate: Vector3<f64>,
    /// Standard deviation of the rounding error of `mean_specific_force`, in the same unit.
    pub force_rounding: Vector3<f64>,
    /// Standard deviation of the rounding error of `mean_angular_rate`, in the same unit.
    pub rate_rounding: Vector3<f64>,
    /// Norm of the corrected specific force, minus local gravity, m/s^2.
    pub norm_error_mps2: f64,
    /// Standard deviation of `norm_error_mps2` due to noise, m/s^2.
    pub norm_sigma_mps2: f64,
    /// Goodness of fit of the rest's residuals relative to noise; `None` if no joint fit used the rest.
    pub misfit: Option<Misfit>,
    /// Reason why the rest is excluded; `None` if it is used.
    pub excluded: Option<&'static str>,
}

/// Evaluation of one move.
#[derive(Clone, Debug)]
pub struct MoveReport {
    /// Index of the recording.
    pub recording: usize,
    /// Index of the rest before the move.
    pub from_rest: usize,
    /// Index of the rest after the move.
    pub to_rest: usize,
    /// Index of the first sample, which is the last sample of the rest before the move.
    pub first: usize,
    /// Index of the last sample, which is the first sample of the rest after the move.
    pub last: usize,
    /// Duration, s.
    pub duration_s: f64,
    /// Angle between the propagated and the measured direction of gravity, deg; NaN if the move cannot be integrated.
    pub direction_error_deg: f64,
    /// Standard deviation that noise causes in each of the two components of the direction error, deg.
    pub direction_sigma_deg: f64,
    /// Unit vector of the measured vertical (up) in the body frame at the first sample.
    pub gravity_before: Vector3<f64>,
    /// Unit vector of the measured vertical (up) in the body frame at the last sample.
    pub gravity_after: Vector3<f64>,
    /// Goodness of fit of the move's residuals relative to noise; `None` if no joint fit used the move.
    pub misfit: Option<Misfit>,
    /// Reason why the move is excluded; `None` if it is used.
    pub excluded: Option<&'static str>,
}

/// Gravity vector at the rests of a recording, as measured by the accelerometer and as propagated from the first rest
/// by the gyroscope. Figures 2 to 4 of the paper cited in docs/model.md show both vectors, the measured and the
/// propagated one.
#[derive(Clone, Debug)]
pub struct CarriedGravity {
    /// Time of the middle of each rest, s.
    pub time_s: Vec<f64>,
    /// Mean corrected specific force at each rest, m/s^2.
    pub measured: Vec<Vector3<f64>>,
    /// Gravity propagated from the first rest with the uncalibrated gyroscope, m/s^2.
    pub uncalibrated: Vec<Vector3<f64>>,
    /// Gravity propagated from the first rest with the calibrated gyroscope, m/s^2.
    pub calibrated: Vec<Vector3<f64>>,
}

/// Evaluation of a calibration on recordings.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// The figures of merit.
    pub figures: Figures,
    /// The figures of merit with the nominal calibration ([`as_it_comes`]), which represents the uncalibrated sensors.
    pub before: Figures,
    /// All rests.
    pub rests: Vec<RestReport>,
    /// All moves: the intervals between consecutive rests.
    pub moves: Vec<MoveReport>,
    /// For each recording: gravity at its rests, measured and propagated from the first rest.
    pub carried: Vec<CarriedGravity>,
    /// Findings of the checks of the recordings.
    pub findings: Vec<Finding>,
    /// Goodness of fit of the norms of the specific force at the rests and of the gravity directions after the moves.
    /// It is relative to noise and to the uncertainty of the calibration.
    pub groups: Vec<GroupMisfit>,
    /// The verdict: `good`, `incomplete` or `poor`. The verdicts `incomplete` and `poor` have reasons.
    pub verdict: Verdict,
}

/// The nominal calibration of a unit. In comparisons, it represents the uncalibrated sensors. Readings in SI units are
/// used without correction. For readings in counts, all axes have the same scale, the cube root of the determinant of
/// the sensitivity in `calibration`. The bias of all axes is the mean bias in `calibration`.
pub fn as_it_comes(calibration: &Calibration<f64>, recordings: &[Recording<'_>]) -> Calibration<f64> {
    let nominal = |triad: &Triad<f64>, unit: fn(&Recording<'_>) -> RawUnit| {
        let is_si = recordings.first().is_none_or(|recording| unit(recording) == RawUnit::Si);
        let scale = triad.sensitivity().determinant().abs().cbrt();
        let nominal = Triad::try_new(Matrix3::from_diagonal_element(scale), Vector3::repeat(triad.bias().mean()));
        if is_si { Triad::identity() } else { nominal.unwrap_or_else(|_| Triad::identity()) }
    };
    Calibration::new(
        nominal(&calibration.accelerometer, |recording| recording.accel_unit),
        nominal(&calibration.gyroscope, |recording| recording.gyro_unit),
    )
}

/// Evaluates `calibration` on recordings that were not used to estimate it.
///
/// `uncertainty` is the uncertainty of the calibration. If it is `None`, the residuals are compared with noise only.
/// `gravity_mps2` is the local gravity, m/s^2, and `min_rest_s` the minimum duration of a rest, s.
///
/// # Errors
/// [`Error::Data`] for recordings with faults; [`Error::NotEnoughMotion`] if there is no rest.
pub fn evaluate(
    calibration: &Calibration<f64>,
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    if calibration.effects.is_empty() {
        return with_nominal((calibration, uncertainty), recordings, None, gravity_mps2, min_rest_s);
    }
    let columns: Vec<_> = recordings.iter().map(|recording| correct(recording, calibration)).collect();
    let corrected: Vec<Recording<'_>> = recordings
        .iter()
        .zip(&columns)
        .map(|(recording, (rate, force))| Recording {
            angular_rate: rate.into(),
            specific_force: force.into(),
            ..*recording
        })
        .collect();
    with_nominal((calibration, uncertainty), recordings, Some(&corrected), gravity_mps2, min_rest_s)
}

/// Evaluates `calibration` as [`evaluate`] does, but on recordings that the caller has already corrected (`corrected`,
/// in SI units). The function is intended for effects that are not in the catalogue.
///
/// # Errors
/// The errors of [`evaluate`]. [`Error::Input`] if `corrected` does not contain, for each recording, a corrected
/// recording of the same length.
pub fn evaluate_corrected(
    calibration: &Calibration<f64>,
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    corrected: &[Recording<'_>],
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    let lengths = |recordings: &[Recording<'_>]| recordings.iter().map(Recording::len).collect::<Vec<_>>();
    if lengths(recordings) != lengths(corrected) {
        return Err(Error::Input("each recording needs a corrected recording with the same number of samples".into()));
    }
    with_nominal((calibration, uncertainty), recordings, Some(corrected), gravity_mps2, min_rest_s)
}

/// Evaluates the calibration and, for comparison, the uncalibrated sensors with their nominal sensitivity.
fn with_nominal(
    (calibration, uncertainty): (&Calibration<f64>, Option<&Uncertainty>),
    recordings: &[Recording<'_>],
    corrected: Option<&[Recording<'_>]>,
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    let nominal = as_it_comes(calibration, recordings);
    let judge = |calibration, uncertainty, corrected| {
        let triads = (calibration, &nominal.gyroscope);
        judge(triads, uncertainty, recordings, corrected, gravity_mps2, min_rest_s)
    };
    let before = judge(&nominal, None, None)?;
    let mut evaluation = judge(calibration, uncertainty, corrected)?;
    let judged = corrected.map_or((recordings, triads_of(calibration)), |own| (own, Calibration::identity()));
    evaluation.findings.extend(contradictions(recordings, (judged.0, &judged.1), &evaluation, gravity_mps2));
    let mut reasons = evaluation.verdict.reasons().to_vec();
    reasons.extend(worse(&evaluation.groups, &before.groups));
    Ok(Evaluation { before: before.figures, verdict: Verdict::of(reasons), ..evaluation })
}

/// The calibration without its effects.
fn triads_of(calibration: &Calibration<f64>) -> Calibration<f64> {
    Calibration::new(calibration.accelerometer, calibration.gyroscope)
}

/// Evaluates one calibration. The checks and the rest detection use the recordings as measured. The figures of merit
/// are computed from the samples in `corrected`, if there are any, and otherwise from the measured samples. The verdict
/// does not contain reasons from the comparison with the uncalibrated unit.
fn judge(
    (calibration, uncalibrated): (&Calibration<f64>, &Triad<f64>),
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    corrected: Option<&[Recording<'_>]>,
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    let mut findings: Vec<Finding> = recordings.iter().flat_map(check_columns).collect();
    refuse_unusable(&mut findings)?;
    let mut segments: Vec<Segments> =
        recordings.iter().map(|recording| Segments::find(recording, min_rest_s)).collect::<Result<_, _>>()?;
    findings.extend(recordings.iter().zip(&segments).filter_map(|(recording, of)| of.noise_below_lsb(recording)));
    let saturated = saturated_stretches(recordings, &findings);
    let (judged, triads) = match corrected {
        None => (recordings, triads_of(calibration)),
        Some(corrected) => {
            for (segments, corrected) in segments.iter_mut().zip(corrected) {
                segments.correct(corrected, calibration);
            }
            (corrected, Calibration::identity())
        }
    };
    let mut rests = rests_of(&segments);
    let usable: Vec<bool> = rests.iter().map(|rest| !rest.is_saturated(&saturated)).collect();
    let (moves, unusable) = between(recordings, &rests, &usable, &saturated);
    let mut noise: Vec<NoiseDensity> = segments.iter().map(|segments| segments.noise_density).collect();
    let Calibration { accelerometer, gyroscope, .. } = &triads;
    let hands = tremor::hands(judged, &mut rests, &usable, &mut noise, Sensors { accelerometer, gyroscope });
    let directions =
        Directions { recordings: judged, rests: &rests, noise: &noise, hands: &hands, accelerometer, gyroscope };
    let (ends, _) = directions.ends_of(&moves);
    let rotations: Vec<Matrix3<f64>> =
        moves.iter().map(|m| integrate_rotation(&judged[m.recording], m.first, m.last, &triads.gyroscope)).collect();
    let rest_reports: Vec<RestReport> = rests
        .iter()
        .zip(&usable)
        .map(|(rest, usable)| rest_report(rest, &triads.accelerometer, gravity_mps2, (!usable).then_some("saturation")))
        .collect();
    let mut move_reports: Vec<MoveReport> =
        moves.iter().zip(&ends).zip(&rotations).map(|((m, e), c)| move_report(m, e, c, None)).collect();
    move_reports.extend(unusable.iter().map(|u| unusable_report(&u.span, u.reason)));
    move_reports.sort_by_key(|report| (report.recording, report.first));
    let residuals: Vec<f64> = ends
        .iter()
        .zip(&rotations)
        .flat_map(|(end, rotation)| {
            let z = end.residual(rotation) / end.sigma_rad;
            [z.x, z.y]
        })
        .collect();
    let figures = figures(&rest_reports, &move_reports, &residuals, 0);
    let uncorrected = || corrected.map_or_else(Vec::new, |corrected| uncorrected_samples(recordings, corrected));
    let used = Judged {
        recordings: judged,
        triads: [accelerometer, gyroscope],
        rests: rest_reports.iter().filter(|rest| rest.excluded.is_none()).collect(),
        moves: &moves,
        ends: &ends,
        rotations: &rotations,
    };
    let groups = used.groups(|| uncertainty.map_or_else(Vec::new, |own| own.changed(calibration, corrected.is_some())));
    findings.extend(used.outliers());
    let mut reasons = Vec::from_iter(figures.reason_beside(used.kept_chi2_per_dof(), &groups, uncorrected));
    // If there is no usable move, or if samples could not be corrected, the residuals do not test any axis. The reason
    // in the list already states the cause, so untested axes are not added.
    if !matches!(reasons[..], [Reason::NoUsableMove { .. } | Reason::NotCorrected { .. }]) {
        reasons.extend(Reason::axes_not_tested(used.untested_axes()));
    }
    reasons.extend(impossible_rates(judged, gyroscope));
    reasons.extend(unknown_direction(RecordingSet::Control, &move_reports));
    reasons.extend(Reason::above_noise(RecordingSet::Control, &groups, &findings));
    Ok(Evaluation {
        verdict: Verdict::of(reasons),
        groups,
        figures,
        before: figures,
        carried: (0..recordings.len())
            .map(|index| carried_gravity(index, [&recordings[index], &judged[index]], &rests, &triads, uncalibrated))
            .collect(),
        rests: rest_reports,
        moves: move_reports,
        findings,
    })
}

/// Computes the figures of merit over all used rests and moves. `move_residuals` contains the direction residuals of
/// the used moves, divided by their standard deviations. `parameters` is the number of parameters that were fitted to
/// these rests and moves.
pub(crate) fn figures(
    rests: &[RestReport],
    moves: &[MoveReport],
    move_residuals: &[f64],
    parameters: usize,
) -> Figures {
    let rests: Vec<&RestReport> = rests.iter().filter(|rest| rest.excluded.is_none()).collect();
    let moves: Vec<&MoveReport> = moves.iter().filter(|m| m.excluded.is_none()).collect();
    let norms = rests.iter().map(|rest| rest.norm_error_mps2 / rest.norm_sigma_mps2);
    let chi2: f64 = norms.chain(move_residuals.iter().copied()).map(|z| z * z).sum();
    let count = rests.len() + move_residuals.len();
    Figures {
        chi2_per_dof: chi2 / count.saturating_sub(parameters).max(1) as f64,
        gravity_norm_rms_mps2: rms(rests.iter().map(|rest| rest.norm_error_mps2)),
        // Without moves, there is no direction error. The rms is then NaN, because zero would mean a perfect result.
        gravity_direction_rms_deg: if moves.is_empty() {
            f64::NAN
        } else {
            rms(moves.iter().map(|m| m.direction_error_deg))
        },
        rests: rests.len(),
        moves: moves.len(),
    }
}

pub(crate) fn rest_report(
    rest: &UnitRest,
    accelerometer: &Triad<f64>,
    gravity_mps2: f64,
    excluded: Option<&'static str>,
) -> RestReport {
    let (norm_error_mps2, norm_sigma_mps2) = norm_error_mps2(&rest.rest, accelerometer, gravity_mps2);
    RestReport {
        recording: rest.recording,
        first: rest.rest.first,
        end: rest.rest.end,
        start_s: rest.rest.start_s,
        end_s: rest.rest.end_s,
        epochs: 1,
        unsteadiness: rest.rest.unsteadiness,
        mean_specific_force: rest.rest.specific_force.mean,
        mean_angular_rate: rest.rest.angular_rate.mean,
        force_rounding: rest.rest.specific_force.rounding_std(),
        rate_rounding: rest.rest.angular_rate.rounding_std(),
        norm_error_mps2,
        norm_sigma_mps2,
        misfit: None,
        excluded,
    }
}

pub(crate) fn move_report(
    m: &Move,
    ends: &Ends,
    rotation: &Matrix3<f64>,
    excluded: Option<&'static str>,
) -> MoveReport {
    MoveReport {
        direction_error_deg: direction_error_rad(ends, rotation).to_degrees(),
        direction_sigma_deg: ends.sigma_rad.to_degrees(),
        gravity_before: ends.before,
        gravity_after: ends.after,
        excluded,
        ..unusable_report(m, "")
    }
}

pub(crate) fn unusable_report(m: &Move, reason: &'static str) -> MoveReport {
    MoveReport {
        recording: m.recording,
        from_rest: m.from,
        to_rest: m.to,
        first: m.first,
        last: m.last,
        duration_s: m.duration_s,
        direction_error_deg: f64::NAN,
        direction_sigma_deg: f64::NAN,
        gravity_before: Vector3::repeat(f64::NAN),
        gravity_after: Vector3::repeat(f64::NAN),
        misfit: None,
        excluded: Some(reason),
    }
}

/// Propagates gravity from the first rest through the recording with the index `index`. Later rests do not correct the
/// propagated gravity, so its errors accumulate, as in an application that only integrates the rates.
fn carried_gravity(
    index: usize,
    [recorded, judged]: [&Recording<'_>; 2],
    rests: &[UnitRest],
    triads: &Calibration<f64>,
    uncalibrated: &Triad<f64>,
) -> CarriedGravity {
    let rests: Vec<_> = rests.iter().filter(|rest| rest.recording == index).map(|rest| rest.rest).collect();
    let measured: Vec<Vector3<f64>> =
        rests.iter().map(|rest| triads.accelerometer.correct(rest.specific_force.mean)).collect();
    let through = |recording: &Recording<'_>, gyroscope: &Triad<f64>| {
        let mut up = measured[0];
        let mut carried_up = vec![up];
        for pair in rests.windows(2) {
            let middle = |k: usize| (pair[k].first + pair[k].end) / 2;
            up = integrate_rotation(recording, middle(0), middle(1), gyroscope).tr_mul(&up);
            carried_up.push(up);
        }
        carried_up
    };
    CarriedGravity {
        time_s: rests.iter().map(|rest| (rest.start_s + rest.end_s) / 2.0).collect(),
        uncalibrated: through(recorded, uncalibrated),
        calibrated: through(judged, &triads.gyroscope),
        measured,
    }
}

/// Returns an error with the findings of severity `Error`, if there are any. Saturation in a control recording is
/// reported but is no error, because saturated rests and moves are excluded from the figures of merit.
fn refuse_unusable(findings: &mut Vec<Finding>) -> Result<(), Error> {
    let fatal = |finding: &Finding| finding.severity == Severity::Error && !finding.is_saturation();
    if findings.iter().any(fatal) {
        findings.retain(fatal);
        return Err(Error::Data(std::mem::take(findings)));
    }
    Ok(())
}
