//! Reasons for the verdict `incomplete` or `poor`. Each reason has a code for scripts and a sentence for users.

use std::fmt;

use imucal_core::STANDARD_GRAVITY_MPS2;

use super::group_misfit::{GroupMisfit, ResidualGroup};
use super::{POOR_CHI2_PER_DOF, RecordingSet};
use crate::check::{ACCEL, GYRO};
use crate::finding::{Finding, general};
use crate::held::PriorCost;
use crate::numerics::fit_report::FitReport;

/// Irregular time stamps are regarded as the cause of large residuals only if they affect at least this number of
/// samples per residual. A move has two residuals, so the limit is one affected sample in ten moves.
const FEW_OF_RESIDUALS: f64 = 0.05;

/// Reason for a verdict other than `good`. Messages contain it as a sentence with numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// A fit on which the result is based has not converged.
    NotConverged {
        /// Name of the fit in messages.
        fit: &'static str,
        /// Report of the fit, with the reason for its end.
        report: FitReport,
    },
    /// No move can be used, so there is no verdict on the gyroscope.
    NoUsableMove {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Number of usable rests.
        rests: usize,
    },
    /// There are too few usable rests for a verdict on an accelerometer without a gyroscope.
    TooFewRests {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Number of usable rests.
        rests: usize,
    },
    /// The residuals cannot be compared with noise, so the result is not tested. The verdict is `incomplete`.
    NotTested {
        /// Number of rests that the fit uses.
        rests: usize,
        /// Number of fitted parameters that have no prior.
        parameters: usize,
        /// Standard deviation of the norm of the specific force at a rest, m/s^2, that was estimated from the
        /// residuals; `None` if the rests determine the parameters exactly.
        noise_mps2: Option<f64>,
    },
    /// chi2 is not a finite number, because some samples could not be corrected.
    NotCorrected {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// The samples without a correction, one entry for each recording; empty if these samples are not known.
        samples: Vec<UncorrectedSamples>,
    },
    /// Residuals are far larger than sensor noise explains.
    LargeResiduals {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Square root of chi2 per degree of freedom.
        times_noise: f64,
    },
    /// The noise of the gravity direction after a move is so large that the residuals do not test the gyroscope.
    UnknownDirection {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Standard deviation of the error that noise causes in the gravity direction after a move, deg: the median
        /// over the moves.
        sigma_deg: f64,
        /// Maximum standard deviation for a verdict on a gyroscope, deg.
        limit_deg: f64,
    },
    /// Corrected rates are larger than the range of any MEMS gyroscope.
    ImpossibleRates {
        /// Name of the recording.
        recording: String,
        /// Corrected rate that one sample in a thousand exceeds, deg/s.
        rate_degps: f64,
        /// Range of the fastest MEMS gyroscopes, deg/s.
        limit_degps: f64,
    },
    /// Residuals exceed their noise significantly, and are larger than the residuals of the uncalibrated unit.
    WorseThanUncalibrated {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Goodness of fit of the residuals with the calibration.
        after: GroupMisfit,
        /// Goodness of fit of the residuals of the uncalibrated unit.
        before: GroupMisfit,
    },
    /// Many rests are outliers: their residuals contradict the other rests.
    ContradictingRests {
        /// Number of rests that contradict the other rests.
        count: usize,
        /// Number of all rests.
        all: usize,
    },
    /// Many moves are outliers: their residuals contradict the other moves.
    ContradictingMoves {
        /// Number of moves that contradict the other moves.
        count: usize,
        /// Number of all moves.
        all: usize,
    },
    /// Many rests are excluded because their mean angular rate is far from the median of the mean rates at all rests.
    MovingRests {
        /// Number of rests that are excluded for this reason.
        count: usize,
        /// Number of all rests.
        all: usize,
    },
    /// The recordings contradict the prior of a parameter. The prior pulls this parameter away from the value that the
    /// recordings determine, so the other parameters are also wrong.
    PriorContradicted {
        /// Name of the parameter.
        parameter: String,
        /// Mean and standard deviation of the prior, in the unit of the parameter.
        prior: [f64; 2],
        /// Difference between the mean of the prior and the value that the recordings determine, in standard deviations
        /// of this difference.
        sigmas: f64,
    },
    /// The recordings contradict the given calibration of the accelerometer, which is a prior of its nine parameters.
    CalibrationContradicted {
        /// Name of the parameter that differs most, relative to its standard deviation in the calibration.
        parameter: String,
        /// Largest difference between the calibration and the values that the recordings determine, over nine
        /// uncorrelated linear combinations of the parameters, in standard deviations of this difference.
        sigmas: f64,
    },
    /// The recordings do not determine some parameters, so these parameters have the default prior. The verdict is
    /// `incomplete`.
    ParametersHeld {
        /// Names of the parameters that the recordings do not determine, or names of groups of such parameters.
        parameters: String,
        /// Errors of the gravity direction and of a rotation by 90 deg that the uncertainty of the priors causes.
        cost: PriorCost,
    },
    /// The residuals are far larger than sensor noise explains, but the uncertainty of the calibration explains them.
    /// The verdict is `incomplete`.
    CalibrationUncertain {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Square root of chi2 per degree of freedom.
        times_noise: f64,
    },
    /// The control recordings do not test some sensor axes. The verdict is `incomplete`.
    AxesNotTested {
        /// Names of the axes, such as `gyro_x`.
        axes: Vec<&'static str>,
    },
    /// Some kinds of residuals exceed their noise. The unit or its motion therefore has an error that the model does
    /// not contain, or the unit has changed since its calibration. The verdict is `incomplete`.
    ResidualsAboveNoise {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// The kinds of residuals that exceed their noise; there is at least one.
        groups: Vec<GroupMisfit>,
    },
    /// Residuals of moves exceed their noise, but residuals of rests do not. In addition, the time stamps of a
    /// recording are irregular. The clock is the probable cause, because wrong time stamps change the integral of the
    /// angular rate over a move. The verdict is `incomplete`.
    IrregularClock {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// The kinds of residuals that exceed their noise; there is at least one.
        groups: Vec<GroupMisfit>,
        /// The finding about the time stamps.
        clock: Finding,
    },
}

/// Samples of a recording that were measured but could not be corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct UncorrectedSamples {
    /// Name of the recording.
    pub recording: String,
    /// Number of samples without a correction.
    pub count: usize,
    /// Number of samples of the recording.
    pub all: usize,
    /// Index of the first sample without a correction.
    pub first: usize,
    /// Time of this sample, s.
    pub time_s: f64,
    /// Whether the temperature of this sample is missing (not a number). If false, the effects at this sample are too
    /// large for the correction to remove them.
    pub is_temperature_missing: bool,
}

impl Reason {
    /// Reason code for scripts, in lower case. It does not change between versions.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotConverged { .. } => "not_converged",
            Self::NoUsableMove { .. } => "no_usable_move",
            Self::TooFewRests { .. } => "too_few_rests",
            Self::NotTested { .. } => "residuals_not_tested",
            Self::NotCorrected { .. } => "not_corrected",
            Self::LargeResiduals { .. } => "large_residuals",
            Self::UnknownDirection { .. } => "unknown_direction",
            Self::ImpossibleRates { .. } => "impossible_rates",
            Self::WorseThanUncalibrated { .. } => "worse_than_uncalibrated",
            Self::ContradictingRests { .. } => "contradicting_rests",
            Self::ContradictingMoves { .. } => "contradicting_moves",
            Self::MovingRests { .. } => "moving_rests",
            Self::PriorContradicted { .. } | Self::CalibrationContradicted { .. } => "prior_contradicted",
            Self::ParametersHeld { .. } => "parameters_held",
            Self::CalibrationUncertain { .. } => "calibration_uncertain",
            Self::AxesNotTested { .. } => "axes_not_tested",
            Self::ResidualsAboveNoise { .. } => "residuals_above_noise",
            Self::IrregularClock { .. } => "irregular_clock",
        }
    }

    /// Whether this reason gives the verdict `poor`. All other reasons give the verdict `incomplete`.
    pub fn is_poor(&self) -> bool {
        !matches!(
            self,
            Self::ResidualsAboveNoise { .. }
                | Self::ParametersHeld { .. }
                | Self::NotTested { .. }
                | Self::CalibrationUncertain { .. }
                | Self::AxesNotTested { .. }
                | Self::IrregularClock { .. }
        )
    }

    /// Returns the reason [`Self::AxesNotTested`] with the names of the axes that the control recordings do not test;
    /// `None` if there are no such axes. `untested` contains the indices of these axes of the accelerometer and
    /// of the gyroscope.
    pub(crate) fn axes_not_tested(untested: [Vec<usize>; 2]) -> Option<Self> {
        let [accelerometer, gyroscope] = untested;
        let of = |names: [&'static str; 3], axes: Vec<usize>| axes.into_iter().map(move |axis| names[axis]);
        let axes: Vec<&'static str> = of(ACCEL, accelerometer).chain(of(GYRO, gyroscope)).collect();
        (!axes.is_empty()).then_some(Self::AxesNotTested { axes })
    }

    /// Returns a reason if the residuals of any kind in `groups` exceed their noise, otherwise `None`. The reason is
    /// [`Self::IrregularClock`] if two conditions hold, otherwise [`Self::ResidualsAboveNoise`]. First, only residuals
    /// of moves exceed their noise. Second, a finding about time stamps, or about missing or repeated samples, concerns
    /// enough samples to be the cause ([`FEW_OF_RESIDUALS`]).
    pub(crate) fn above_noise(set: RecordingSet, groups: &[GroupMisfit], findings: &[Finding]) -> Option<Self> {
        let groups: Vec<GroupMisfit> = groups.iter().filter(|group| group.exceeds_noise()).copied().collect();
        let is_of_move = |misfit: &GroupMisfit| {
            matches!(
                misfit.group,
                ResidualGroup::MoveDirections | ResidualGroup::MoveForces | ResidualGroup::StandAttitudes
            )
        };
        // A finding that concerns only a few samples also concerns only a few moves. Errors in a few moves cannot cause
        // a large rms over all moves.
        let residuals = groups.iter().map(|misfit| misfit.degrees_of_freedom).fold(0.0, f64::max);
        let is_of_few = |finding: &&Finding| (finding.count as f64) < FEW_OF_RESIDUALS * residuals;
        let clock = findings
            .iter()
            .find(|finding| finding.is_about_time_stamps() && !is_of_few(finding))
            .filter(|_| groups.iter().all(is_of_move));
        match clock.cloned() {
            _ if groups.is_empty() => None,
            Some(clock) => Some(Self::IrregularClock { set, groups, clock }),
            None => Some(Self::ResidualsAboveNoise { set, groups }),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let of_calibration = RecordingSet::Calibration.name();
        match self {
            Self::NotConverged { fit, report } => f.write_str(&report.reason(fit).unwrap_or_default()),
            Self::NoUsableMove { set, rests } => write!(
                f,
                "{}: {rests} usable rests and no usable move: the gyroscope is not judged, record rests in different poses \
                 with moves between them",
                set.name()
            ),
            Self::TooFewRests { set, rests } => write!(
                f,
                "{}: {rests} usable rests: the accelerometer is not judged, record rests in different poses",
                set.name()
            ),
            Self::NotTested { rests, parameters, noise_mps2: None } => write!(
                f,
                "{of_calibration}: {rests} rests determine {parameters} parameters exactly, so no residual tests the \
                 result: add rests in other poses, or judge it on a control recording"
            ),
            Self::NotTested { rests, noise_mps2: Some(noise), .. } => write!(
                f,
                "{of_calibration}: the noise of the means is not known and was estimated from the residuals of the \
                 {rests} rests, {} mg rms, so they do not test the result: give the standard deviation of the means \
                 (noise_mps2=..., --noise)",
                general(noise / STANDARD_GRAVITY_MPS2 * 1e3, 3)
            ),
            Self::NotCorrected { set, samples } => {
                write!(f, "{}: chi2 per degree of freedom is not a finite number, so nothing is judged: ", set.name())?;
                if samples.is_empty() {
                    return f.write_str("some of its samples have no correction");
                }
                f.write_str(&samples.iter().map(UncorrectedSamples::to_string).collect::<Vec<_>>().join("; "))
            }
            Self::LargeResiduals { set, times_noise } => {
                write!(
                    f,
                    "{}: residuals are {} times what noise explains (more than {}): the linear model does not describe this \
                     unit or this motion",
                    set.name(),
                    general(*times_noise, 3),
                    general(POOR_CHI2_PER_DOF.sqrt(), 3)
                )?;
                match set {
                    RecordingSet::Calibration => Ok(()),
                    RecordingSet::Control => {
                        f.write_str(", or the calibration is another unit's, or the recording is in wrong units")
                    }
                }
            }
            Self::UnknownDirection { set, sigma_deg, limit_deg } => write!(
                f,
                "{}: noise alone gives the gravity direction after a move a standard deviation of {} deg (more than {}): the \
                 gyroscope is not judged; the calibration or the recording is in wrong units, or the moves are too slow for \
                 this sensor",
                set.name(),
                general(*sigma_deg, 3),
                general(*limit_deg, 3)
            ),
            Self::ImpossibleRates { recording, rate_degps, limit_degps } => write!(
                f,
                "{}: corrected rates of {recording} reach {rate_degps:.0} deg/s, more than the {limit_degps:.0} deg/s of the \
                 fastest sensors: the calibration or the recording is in wrong units",
                RecordingSet::Control.name()
            ),
            Self::WorseThanUncalibrated { set, after, before } => {
                let uncalibrated = before.size(before.rms);
                write!(
                    f,
                    "{}: {after}, but {uncalibrated} without a calibration: this calibration makes the unit worse; it \
                     belongs to another unit, or the unit has changed since it was calibrated",
                    set.name()
                )
            }
            Self::ContradictingRests { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} rests contradict the others: the linear model does not describe this unit \
                 or this motion"
            ),
            Self::ContradictingMoves { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} moves contradict the others: the linear model does not describe this unit \
                 or this motion"
            ),
            Self::MovingRests { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} rests are left out because their mean rates are far from those of the \
                 others: the unit was not still, its bias has jumped, as it may when power is lost, or these rests are of \
                 another unit"
            ),
            Self::PriorContradicted { parameter, prior: [value, sigma], sigmas } => write!(
                f,
                "{of_calibration}: the recordings contradict the prior of {parameter}, {value} +- {sigma}, by {} standard \
                 deviations: give the prior a larger standard deviation or another mean, or remove the prior",
                general(sigmas.abs(), 3)
            ),
            Self::CalibrationContradicted { parameter, sigmas } => write!(
                f,
                "{of_calibration}: the recordings contradict the accelerometer of the given calibration by {} standard \
                 deviations, most of all its {parameter}: the calibration is of another unit, or the unit has changed \
                 since then; give the calibration of this unit, or calibrate without it",
                general(*sigmas, 3)
            ),
            Self::ParametersHeld { parameters, cost: PriorCost { gravity_direction_deg, rotation_deg } } => {
                write!(
                    f,
                    "{of_calibration}: the recordings do not determine {parameters}, which have the default prior: this \
                     leaves an error (1 sigma) of {} deg in the direction of gravity",
                    general(*gravity_direction_deg, 2)
                )?;
                // For an accelerometer without a gyroscope, the error of a rotation is NaN and is omitted.
                if *rotation_deg > 0.0 {
                    write!(f, " and of {} deg in a rotation by 90 deg", general(*rotation_deg, 2))?;
                }
                Ok(())
            }
            Self::CalibrationUncertain { set, times_noise } => write!(
                f,
                "{}: residuals are {} times what noise explains, as expected from the uncertainty of the calibration: \
                 calibrate with rests in more poses and moves about more axes",
                set.name(),
                general(*times_noise, 3)
            ),
            Self::AxesNotTested { axes } => write!(
                f,
                "{}: it would not show errors of 5 % of {}: record rests in more poses, also upside down, with rotations \
                 about every axis between them",
                RecordingSet::Control.name(),
                axes.join(", ")
            ),
            Self::IrregularClock { set, groups, clock } => {
                write!(f, "{}: residuals exceed their noise: {}: ", set.name(), list(groups))?;
                write!(
                    f,
                    "only those of the moves, as if time stamps were wrong; {}: {} [{}]: {}",
                    clock.recording, clock.message, clock.code, clock.way_out
                )
            }
            Self::ResidualsAboveNoise { set, groups } => {
                write!(f, "{}: residuals exceed their noise: {}: ", set.name(), list(groups))?;
                f.write_str(match set {
                    RecordingSet::Calibration => {
                        "the unit or its motion has an error that the model does not contain; `imucal gap FILE --control \
                         CONTROL` searches for it"
                    }
                    RecordingSet::Control => {
                        "the unit has changed since its calibration, or has an error that the model does not contain; \
                         `imucal gap FILE --control CONTROL` searches for it"
                    }
                })
            }
        }
    }
}

fn list(groups: &[GroupMisfit]) -> String {
    groups.iter().map(GroupMisfit::to_string).collect::<Vec<_>>().join(", ")
}

impl fmt::Display for UncorrectedSamples {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { recording, count, all, first, time_s, is_temperature_missing } = self;
        let cause = if *is_temperature_missing {
            "temp_degc is not a number there: repair it, or leave the effects of temperature out"
        } else {
            "the effects at these samples are too large to be removed: estimate the effects again, or leave them out"
        };
        write!(
            f,
            "no correction for {count} of {all} samples of {recording}, the first is sample {first} at {time_s:.2} s: {cause}"
        )
    }
}
