//! Evaluation of an accelerometer without a gyroscope, on the rests of control recordings.

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;

use super::group_misfits::Judged;
use super::verdict::worse;
use super::{Evaluation, RestReport, Uncertainty, as_it_comes, figures, refuse_unusable, rest_report};
use crate::check::check_one_or_both;
use crate::error::Error;
use crate::finding::Finding;
use crate::recording::Recording;
use crate::rests::moves::saturated_stretches;
use crate::rests::segment::Segments;
use crate::rests::unit_rest::rests_of;
use crate::verdict::{Reason, RecordingSet, Verdict};

/// Evaluates an accelerometer on recordings that were not used for its calibration. Gyroscope columns are not used, so
/// the result has no moves and no propagated gravity.
///
/// `uncertainty` is the uncertainty of the calibration. If it is `None`, the residuals are compared with noise only.
/// `gravity_mps2` is the local gravity, m/s^2, and `min_rest_s` the minimum duration of a rest, s.
///
/// # Errors
/// [`Error::Data`] for recordings with faults; [`Error::NotEnoughMotion`] if there is no rest.
pub fn evaluate_accelerometer(
    accelerometer: &Triad<f64>,
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    let recordings: Vec<Recording<'_>> = recordings.iter().map(Recording::accelerometer_alone).collect();
    // A calibration needs two triads. The gyroscope triad is the identity; the evaluation below does not use it.
    let calibration = Calibration::new(*accelerometer, Triad::identity());
    let nominal = as_it_comes(&calibration, &recordings);
    let before = judge(&nominal, None, &recordings, gravity_mps2, min_rest_s)?;
    let evaluation = judge(&calibration, uncertainty, &recordings, gravity_mps2, min_rest_s)?;
    let mut reasons = evaluation.verdict.reasons().to_vec();
    reasons.extend(worse(&evaluation.groups, &before.groups));
    Ok(Evaluation { before: before.figures, verdict: Verdict::of(reasons), ..evaluation })
}

fn judge(
    calibration: &Calibration<f64>,
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    let mut findings: Vec<Finding> = recordings.iter().flat_map(check_one_or_both).collect();
    refuse_unusable(&mut findings)?;
    let segments: Vec<Segments> =
        recordings.iter().map(|recording| Segments::find(recording, min_rest_s)).collect::<Result<_, _>>()?;
    findings.extend(recordings.iter().zip(&segments).filter_map(|(recording, of)| of.noise_below_lsb(recording)));
    let saturated = saturated_stretches(recordings, &findings);
    let rests: Vec<RestReport> = rests_of(&segments)
        .iter()
        .map(|rest| {
            let excluded = rest.is_saturated(&saturated).then_some("saturation");
            rest_report(rest, &calibration.accelerometer, gravity_mps2, excluded)
        })
        .collect();
    let figures = figures(&rests, &[], &[], 0);
    let used = Judged {
        recordings,
        triads: [&calibration.accelerometer, &calibration.gyroscope],
        rests: rests.iter().filter(|rest| rest.excluded.is_none()).collect(),
        moves: &[],
        ends: &[],
        rotations: &[],
    };
    let groups = used.groups(|| uncertainty.map_or_else(Vec::new, |own| own.changed(calibration, false)));
    let mut reasons = Vec::from_iter(figures.reason_of_accelerometer(RecordingSet::Control));
    findings.extend(used.outliers());
    let [untested_axes, _] = used.untested_axes();
    reasons.extend(Reason::axes_not_tested([untested_axes, Vec::new()]));
    reasons.extend(Reason::above_noise(RecordingSet::Control, &groups, &[]));
    Ok(Evaluation {
        figures,
        before: figures,
        rests,
        moves: Vec::new(),
        carried: Vec::new(),
        findings,
        groups,
        verdict: Verdict::of(reasons),
    })
}
