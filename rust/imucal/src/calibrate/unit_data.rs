//! The checked recordings of one unit, with their rests, sensor noise and hand tremor. All fits use them as input.

use std::ops::Range;

use imucal_core::sensor::Triad;
use nalgebra::Vector3;

use super::{Options, check_options};
use crate::check::{self, at_rest};
use crate::error::Error;
use crate::evaluate::{RestReport, rest_report};
use crate::finding::{Finding, Severity};
use crate::held::HeldParameter;
use crate::joint::is_unobservable_hand_held;
use crate::recording::{RawUnit, Recording};
use crate::rests::moves::{Directions, Unusable, saturated_stretches};
use crate::rests::noise_density::NoiseDensity;
use crate::rests::rest::Rest;
use crate::rests::segment::Segments;
use crate::rests::tremor::{self, Hand, Sensors};
use crate::rests::unit_rest::{UnitRest, in_epochs, ranges_of_rests, rests_of, together};
use crate::two_stage::gyroscope::{self, GyroscopeBias};

/// Minimum number of moves for the gyroscope fit. Each move gives two residuals, and the sensitivity matrix has nine
/// entries, so at least five moves are needed.
pub(super) const MIN_MOVES: usize = 5;
/// Reason code of an excluded move that contradicts the other moves.
pub(super) const CONTRADICTS_MOVES: &str = "contradicts_other_moves";
/// Reason code of an excluded rest whose mean angular rate is far from those of the other rests.
pub(super) const NOT_STILL: &str = "rest_not_still";

/// The checked recordings of one unit and the quantities derived from them.
#[derive(Clone)]
pub(super) struct UnitData<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    /// For each recording, the result of the rest detection: the rests and the noise.
    pub(super) segments: Vec<Segments>,
    /// All rests of all recordings. Long rests may be replaced by their epochs, which are parts with their own means.
    pub(super) rests: Vec<UnitRest>,
    /// For each rest, the reason code of its exclusion; `None` if the rest is not excluded.
    pub(super) excluded: Vec<Option<&'static str>>,
    /// Gyroscope bias, estimated from the mean angular rates at the rests, and the weight of each rest in this
    /// estimate.
    pub(super) bias: GyroscopeBias,
    /// White-noise densities of each recording, raw units per sqrt(Hz).
    noise: Vec<NoiseDensity>,
    /// Model of the tremor of the hand in each recording; `None` if the unit is not hand-held.
    hands: Vec<Option<Hand>>,
    /// Index ranges of saturated samples of each recording.
    pub(super) saturated: Vec<Vec<Range<usize>>>,
    /// Warnings from the checks of the recordings.
    pub(super) findings: Vec<Finding>,
}

impl<'a> UnitData<'a> {
    /// Checks the recordings and detects their rests.
    ///
    /// # Errors
    /// * [`Error::Input`] for invalid options.
    /// * [`Error::Data`] for faults of the recordings.
    /// * [`Error::NotEnoughMotion`] if there are no usable rests.
    pub(super) fn try_new(recordings: &'a [Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        Self::checked(recordings, options, check::check_columns)
    }

    /// Like [`Self::try_new`], for recordings without a gyroscope.
    pub(super) fn of_accelerometer(recordings: &'a [Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        Self::checked(recordings, options, check::check_one_or_both)
    }

    fn checked(
        recordings: &'a [Recording<'a>],
        options: &Options<'_>,
        check_columns: impl Fn(&Recording<'_>) -> Vec<Finding>,
    ) -> Result<Self, Error> {
        check_options(recordings, options)?;
        let mut findings: Vec<Finding> = recordings.iter().flat_map(check_columns).collect();
        findings.extend(check::check_shared(recordings));
        if options.exclude_saturated {
            for finding in findings.iter_mut().filter(|finding| finding.is_saturation()) {
                finding.severity = Severity::Warning;
            }
        }
        refuse_errors(&findings)?;
        let segments: Vec<Segments> = recordings
            .iter()
            .map(|recording| Segments::find(recording, options.min_rest_s))
            .collect::<Result<_, _>>()?;
        let ranges: Vec<Vec<Range<usize>>> = segments.iter().map(Segments::ranges).collect();
        for ((recording, ranges), segments) in recordings.iter().zip(&ranges).zip(&segments) {
            findings.extend(check::check_rests(recording, ranges, options.gravity_mps2));
            findings.extend(segments.check_noise(recording));
            findings.extend(segments.noise_below_lsb(recording));
        }
        findings.extend(check::check_independent(&at_rest(recordings, &ranges)));
        refuse_errors(&findings)?;
        let rests = rests_of(&segments);
        let saturated = saturated_stretches(recordings, &findings);
        let has_gyroscope = recordings.iter().any(|recording| !recording.angular_rate.is_absent());
        let bias = if has_gyroscope {
            let wander: Vec<_> =
                segments.iter().flat_map(|segments| &segments.epochs).map(|own| rate_wander(own)).collect();
            gyroscope::bias_from_rests(&rests.iter().map(|rest| &rest.rest).collect::<Vec<_>>(), &wander)
        } else {
            GyroscopeBias::absent(rests.len())
        };
        let is_long = segments.iter().flat_map(|segments| &segments.epochs).map(|epochs| !epochs.is_empty());
        let excluded: Vec<_> = rests
            .iter()
            .zip(&bias.weights)
            .zip(is_long)
            .map(|((rest, weight), is_long)| {
                if rest.is_saturated(&saturated) {
                    Some("saturation")
                } else if weight.min() == 0.0 && !(is_long && has_other_bias(&recordings[0], &rest.rest, &bias.bias)) {
                    // The mean rate is far from the mean rates of the other rests. The interval is therefore a slow,
                    // uniform rotation instead of a rest.
                    Some(NOT_STILL)
                } else {
                    None
                }
            })
            .collect();
        refuse_no_rest(&excluded)?;
        let noise = segments.iter().map(|segments| segments.noise_density).collect();
        let hands = vec![None; recordings.len()];
        Ok(Self { recordings, segments, rests, excluded, bias, noise, hands, saturated, findings })
    }

    /// Returns these data with the recordings replaced by `recordings`, which must contain the same samples.
    pub(super) fn of<'b>(self, recordings: &'b [Recording<'b>]) -> UnitData<'b> {
        let Self { segments, rests, excluded, bias, noise, hands, saturated, findings, .. } = self;
        UnitData { recordings, segments, rests, excluded, bias, noise, hands, saturated, findings }
    }

    /// Estimates the tremor of a hand-held unit. Subtracts the effect of the tremor from the means at the rests and
    /// from the noise densities. The estimate needs calibrations of both sensors. Only the rests in `used` contribute
    /// to the model of the tremor.
    pub(super) fn free_of_tremor(&mut self, accelerometer: &Triad<f64>, gyroscope: &Triad<f64>, used: &[bool]) {
        let sensors = Sensors { accelerometer, gyroscope };
        self.hands = tremor::hands(self.recordings, &mut self.rests, used, &mut self.noise, sensors);
    }

    /// Replaces long rests by their epochs (parts with their own means), for the joint fit. Returns whether there are
    /// any long rests.
    pub(super) fn cut_into_epochs(&mut self) -> bool {
        let epochs = in_epochs(&self.rests, &self.segments);
        let are_cut = epochs.len() > self.rests.len();
        self.excluded = epochs.iter().map(|epoch| self.excluded[epoch.whole]).collect();
        self.rests = epochs;
        are_cut
    }

    /// For each rest, whether it has no known fault.
    pub(super) fn sound(&self) -> Vec<bool> {
        self.excluded.iter().map(Option::is_none).collect()
    }

    /// Whether the raw values of the sensor that `unit` selects are in SI units.
    pub(super) fn raw_is_si(&self, unit: impl Fn(&Recording<'_>) -> RawUnit) -> bool {
        self.recordings.first().is_some_and(|recording| unit(recording) == RawUnit::Si)
    }

    /// The held parameters: the parameters to which the priors in `options` apply.
    ///
    /// # Errors
    /// [`Error::Input`] for unknown names and invalid priors.
    pub(super) fn held(&self, options: &Options<'_>) -> Result<Vec<HeldParameter>, Error> {
        let nominal = |si: bool, given: Option<f64>| if si { Some(1.0) } else { given };
        options.priors.held([
            nominal(self.raw_is_si(|recording| recording.accel_unit), options.accel_nominal),
            nominal(self.raw_is_si(|recording| recording.gyro_unit), options.gyro_nominal),
        ])
    }

    /// Returns a hint that is appended to messages about missing rests: some intervals at rest are too short to be
    /// used. The hint gives the times of the longest such interval. `None` if there is no such interval.
    pub(super) fn short_rests(&self, options: &Options<'_>) -> Option<String> {
        self.recordings.iter().zip(&self.segments).find_map(|(recording, segments)| {
            let range = segments.too_short.iter().max_by_key(|range| range.len())?;
            let (start_s, end_s) = (recording.time_s[range.start], recording.time_s[range.end - 1]);
            Some(format!(
                "{} intervals at rest are too short, the longest ({start_s:.2} s to {end_s:.2} s) has {} samples: \
                 hold each pose for {} s, or pass min_rest_s={:.2}",
                segments.too_short.len(),
                range.len(),
                options.min_rest_s,
                0.9 * (end_s - start_s)
            ))
        })
    }

    /// Standard deviation of the hand tremor in each recording, rad; `None` if the unit is not hand-held.
    pub(super) fn tremor_rad(&self) -> Vec<Option<f64>> {
        self.hands.iter().map(|hand| hand.as_ref().map(Hand::tremor_rad)).collect()
    }

    /// Whether the unit is hand-held in any recording.
    pub(super) fn is_held(&self) -> bool {
        self.hands.iter().any(Option::is_some)
    }

    /// Returns an error if the unit is hand-held and a requested effect is observable only from the specific force
    /// measured during moves. This force contains the unknown acceleration of the hand.
    pub(super) fn require_turns_in_place(&self, options: &Options<'_>) -> Result<(), Error> {
        let blind = options.effects.iter().find(|choice| is_unobservable_hand_held(choice.effect.name));
        match blind.filter(|_| self.is_held()) {
            None => Ok(()),
            Some(choice) => Err(Error::NotEnoughMotion(format!(
                "the unit is hand-held, so its acceleration inside moves is unknown and {} is not observable: use a \
                 stand, or leave the effect out",
                choice.effect.name
            ))),
        }
    }

    /// White-noise densities of each recording, raw units per sqrt(Hz).
    pub(super) fn noise(&self) -> &[NoiseDensity] {
        &self.noise
    }

    /// Collects the data from which the gravity directions at the ends of moves are computed: recordings, rests, noise
    /// densities and models of the hand tremor, with the given estimates of both sensors.
    pub(super) fn directions<'b>(&'b self, accelerometer: &'b Triad<f64>, gyroscope: &'b Triad<f64>) -> Directions<'b> {
        let Self { recordings, rests, noise, hands, .. } = self;
        Directions { recordings, rests, noise, hands, accelerometer, gyroscope }
    }
}

impl UnitData<'_> {
    /// Reports of all rests. `used` states for each rest, or for each epoch (part) of a long rest, whether the fit uses
    /// it. `norms` is empty, or contains two results of a joint fit for each rest or epoch: the error of the norm of
    /// the specific force, and the standard deviation of this error.
    pub(super) fn rest_reports(
        &self,
        accelerometer: &Triad<f64>,
        used: &[bool],
        norms: &[Option<(f64, f64)>],
        gravity_mps2: f64,
    ) -> Vec<RestReport> {
        let report = |own: Range<usize>| {
            let contradicts = (!used[own.clone()].contains(&true)).then_some("contradicts_other_rests");
            let excluded = self.excluded[own.start].or(contradicts);
            let mut report = rest_report(&together(&self.rests[own.clone()]), accelerometer, gravity_mps2, excluded);
            report.epochs = own.len();
            let known: Vec<(f64, f64)> = norms.get(own).unwrap_or_default().iter().flatten().copied().collect();
            if !known.is_empty() {
                let count = known.len() as f64;
                report.norm_error_mps2 = known.iter().map(|(error, _)| error).sum::<f64>() / count;
                report.norm_sigma_mps2 = known.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>().sqrt() / count;
            }
            report
        };
        ranges_of_rests(&self.rests).into_iter().map(report).collect()
    }
}

/// Whether the mean rate of a long rest differs from the mean rates of the other rests because of a different bias. The
/// other possible cause is a slow rotation. Such a rotation can only be about the vertical, because a rotation about a
/// horizontal axis would have changed the gravity direction. A rate difference in any other direction is therefore a
/// bias. The result is false for readings in counts, because an unknown offset of the accelerometer may hide the
/// direction of the vertical.
fn has_other_bias(recording: &Recording<'_>, rest: &Rest, bias: &Vector3<f64>) -> bool {
    /// A rate difference is regarded as a bias if its angle to the vertical is above 18 deg. The cosine of the angle is
    /// then below this limit. The margin is needed because the axes of the two sensors may differ by some degrees.
    const VERTICAL: f64 = 0.95;
    let difference = rest.angular_rate.mean - bias;
    let along = difference.dot(&rest.specific_force.mean.normalize()).abs();
    recording.accel_unit == RawUnit::Si && along < VERTICAL * difference.norm()
}

/// Computes how much the mean rate varies from epoch to epoch (part to part) within one long rest: the variance,
/// squared raw units. It is zero for a rest without epochs.
fn rate_wander(epochs: &[Rest]) -> Vector3<f64> {
    let count = epochs.len().max(1) as f64;
    let mean = epochs.iter().map(|epoch| epoch.angular_rate.mean).sum::<Vector3<f64>>() / count;
    epochs.iter().map(|epoch| (epoch.angular_rate.mean - mean).map(|rate| rate * rate)).sum::<Vector3<f64>>() / count
}

/// Returns a text for an error message about too few usable moves. The text states how many moves are needed, and the
/// number of unusable moves for each reason.
pub(super) fn too_few_moves(usable: usize, unusable: &[Unusable]) -> String {
    let needed = format!("at least {MIN_MOVES} between different poses are needed, better 12");
    let Some(first) = unusable.first() else {
        return format!("{needed}; move the unit about all three axes, resting in between");
    };
    let count = |reason: &str| unusable.iter().filter(|u| u.reason == reason).count();
    let reasons: Vec<String> = [("samples_missing", "gaps in time"), ("saturation", "saturated samples")]
        .into_iter()
        .filter(|(reason, _)| count(reason) > 0)
        .map(|(reason, words)| format!("{} for {words} [{reason}]", count(reason)))
        .collect();
    format!(
        "{usable} of {} moves are usable and {needed}; left out: {} (the first between rests {} and {}): record again \
         without them",
        usable + unusable.len(),
        reasons.join(", "),
        first.span.from,
        first.span.to
    )
}

/// Returns an error if all rests are excluded.
fn refuse_no_rest(excluded: &[Option<&'static str>]) -> Result<(), Error> {
    if excluded.iter().any(Option::is_none) {
        return Ok(());
    }
    let saturated = excluded.iter().filter(|reason| **reason == Some("saturation")).count();
    let moving = excluded.len() - saturated;
    let left_out = [(saturated, "for saturated samples [saturation]"), (moving, "as slow rotations [rest_not_still]")]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, words)| format!("{count} {words}"))
        .collect::<Vec<_>>();
    let way_out = if saturated > 0 {
        "a unit at rest is far from the ends of its range: check how the columns were read, or use a larger range"
    } else {
        "hold the unit still in each pose for 2 s or longer"
    };
    Err(Error::NotEnoughMotion(format!(
        "0 of {} rests are usable; left out: {}: {way_out}",
        excluded.len(),
        left_out.join(", ")
    )))
}

/// Returns the findings of severity `Error`, if any, as an error.
pub(super) fn refuse_errors(findings: &[Finding]) -> Result<(), Error> {
    let errors: Vec<Finding> = findings.iter().filter(|f| f.severity == Severity::Error).cloned().collect();
    if errors.is_empty() { Ok(()) } else { Err(Error::Data(errors)) }
}
