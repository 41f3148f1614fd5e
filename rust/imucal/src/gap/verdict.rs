//! Derives the verdict (the conclusion of a search) from the fits and tests of the search.
//!
//! ```text
//! data_fault        faults of the data explain the residuals, may explain them, or affect too many samples
//! stochastic        a bias or a scale varies as a random walk
//! unknown           no effect of the catalogue describes the residuals, or control recordings contradict the effects
//! named             effects were accepted
//! ambiguous         effects were accepted, but other effects explain the residuals equally well
//! nothing_missing   noise explains the residuals
//! ```

use imucal_core::effects::{Effect, Sensor};

use super::acceptance::needs_heading;
use super::clock::clock_and_noise_faults;
use super::fits::{Control, Fit};
use super::mount::{StandRest, mount_slips};
use super::remainder::{Remainder, RemainderKind};
use super::{Block, GenericFinding, Score, Search};
use crate::finding::{Finding, Severity};
use crate::joint::is_unobservable_hand_held;
use crate::recording::Recording;
use crate::verdict::{ResidualGroup, SIGNIFICANCE};

/// Minimum log Bayes factor, nats, for an effect to be reported as significant but not confirmed. Such an effect does
/// not improve the prediction of unseen data. 8 nats are odds of 3000 to 1.
const CERTAIN_NATS: f64 = 8.0;
/// Share of chi2 that the effects must remove from at least one kind of residuals of unseen data (data that no fit
/// used). If they remove a smaller share, unseen data contradict the effects. The limit applies if the fit with the
/// effects is poor (see [`Fit::is_poor`]), or if residuals of unseen data exceed noise.
const LEAST_REMOVED: f64 = 0.1;
/// Threshold of three tests, as a share of chi2 of unseen data (data that no fit used). First, if residuals at rest
/// scatter more than noise, the effects are confirmed only if they remove at least this share of chi2 from one kind of
/// residuals. Second, if the effects remove at least this share, the residuals that remain do not limit the use of the
/// calibration. Third, if the final fit is poor, a change of the biases between sessions explains the residuals only if
/// a model with this change has a chi2 that is smaller by more than this share.
const MOST_REMOVED: f64 = 0.5;
/// Threshold of the decrease of chi2 of unseen data, in standard deviations of this decrease. A decrease above this
/// threshold confirms the effects, even if it is a smaller share of chi2 than [`LEAST_REMOVED`]. This criterion is not
/// used if the fit is poor, or if residuals at rest scatter more than noise.
const SIGNIFICANT: f64 = 4.0;
/// Codes of findings (faults of the data) that prevent conclusions about effects.
const FAULTS: [&str; 8] = [
    "noise_grows_in_motion",
    "gyro_saturation",
    "accel_saturation",
    "samples_missing",
    "samples_duplicated",
    "clock_irregular",
    "rest_not_still",
    "mount_slip",
];
/// Code of a fault, and a limit of the share of affected samples, %. If the share is below the limit and noise explains
/// all residuals, the fault does not cause the verdict `data_fault`.
const FEW_PERCENT: [(&str, f64); 2] = [("samples_missing", 0.2), ("samples_duplicated", 0.2)];

/// The conclusion of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Noise explains the residuals of the recordings.
    NothingMissing,
    /// Effects were accepted.
    Named,
    /// Effects were accepted, but other effects explain the residuals equally well (within three nats of log evidence).
    Ambiguous,
    /// A bias or a scale varies as a random walk.
    Stochastic,
    /// Residuals exceed noise but no effect of the catalogue describes them, or control recordings contradict the
    /// effects.
    Unknown,
    /// Faults of the data prevent conclusions about effects.
    DataFault,
}

impl Verdict {
    /// Name of the verdict in JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::NothingMissing => "nothing_missing",
            Self::Named => "named",
            Self::Ambiguous => "ambiguous",
            Self::Stochastic => "stochastic",
            Self::Unknown => "unknown",
            Self::DataFault => "data_fault",
        }
    }

    /// Whether effects were accepted.
    pub fn has_effects(self) -> bool {
        matches!(self, Self::Named | Self::Ambiguous)
    }
}

/// An accepted effect and the other effects that explain the residuals equally well.
#[derive(Clone, Debug, PartialEq)]
pub struct Rivals {
    /// Name of the accepted effect.
    pub name: String,
    /// Names of effects that were not accepted although they explain the residuals equally well. Their log evidence is
    /// less than three nats below the log evidence of the accepted effect.
    pub rivals: Vec<String>,
}

/// Effects that unseen data contradict, and chi2 per degree of freedom of the unseen data.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// Names of the contradicted effects.
    pub effects: Vec<String>,
    /// chi2 per degree of freedom without the effects.
    pub before: f64,
    /// chi2 per degree of freedom with the effects.
    pub after: f64,
}

/// The verdict, and the results from which the verdict was derived.
pub(super) struct Judgement {
    pub(super) verdict: Verdict,
    /// Faults of the data that prevent conclusions, or that explain residuals of moves that the accepted effects leave
    /// unexplained.
    pub(super) faults: Vec<Finding>,
    pub(super) rivals: Vec<Rivals>,
    /// Effects with a significant log Bayes factor that do not improve the prediction of unseen data.
    pub(super) not_confirmed: Vec<Score>,
    /// Contradiction between unseen data and accepted effects, which were therefore removed; `None` if no effects were
    /// removed.
    pub(super) contradiction: Option<Contradiction>,
    /// Residuals that the accepted effects leave unexplained.
    pub(super) remainder: Remainder,
}

/// The data from which a verdict is derived: a search, the accepted effects, and the fits without and with these
/// effects.
pub(super) struct Basis<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    pub(super) search: &'a Search,
    pub(super) path: &'a [String],
    pub(super) before: &'a Fit,
    /// The fit without effects that uses the same kinds of residuals as `after`.
    pub(super) reference: &'a Fit,
    pub(super) after: &'a Fit,
}

impl Basis<'_> {
    pub(super) fn judge(&self) -> Judgement {
        let Self { recordings, search, path, before, .. } = self;
        let outcome = &before.outcome;
        let rests: Vec<StandRest> = outcome.rests.iter().map(StandRest::from).collect();
        let slips = mount_slips(&outcome.calibration.accelerometer, &rests, recordings);
        let (faults, are_disturbing) = self.faults(&slips);
        let is_certain = |score: &&Score| score.log_bayes_factor > CERTAIN_NATS && path.is_empty();
        let not_confirmed: Vec<Score> = search.path.iter().filter(is_certain).cloned().collect();
        let rivals = self.rivals();
        let contradiction = if path.is_empty() { None } else { self.contradiction() };
        let are_accepted = !path.is_empty() && contradiction.is_none();
        let mut remainder = self.remainder(are_accepted, &not_confirmed);
        let beside = if are_accepted { self.faults_beside_effects(&remainder) } else { Vec::new() };
        if let Some(fault) = beside.first() {
            remainder = Remainder::unknown(ResidualGroup::MoveDirections.name(), fault.code, remainder.p_value);
        }
        let disagrees = remainder.kind != RemainderKind::Nothing || contradiction.is_some();
        let verdict = match &search.generic {
            // Faulty samples may cause the residuals that no effect explains.
            generic if !slips.is_empty() || (generic.is_some() && are_disturbing) => Verdict::DataFault,
            _ if are_accepted && rivals.iter().any(|own| !own.rivals.is_empty()) => Verdict::Ambiguous,
            _ if are_accepted => Verdict::Named,
            None if path.is_empty() && !faults.is_empty() && (disagrees || !faults.iter().all(are_few)) => {
                Verdict::DataFault
            }
            _ if remainder.kind == RemainderKind::Stochastic => Verdict::Stochastic,
            _ if disagrees => Verdict::Unknown,
            _ => Verdict::NothingMissing,
        };
        let is_fault = verdict == Verdict::DataFault;
        let faults = if is_fault { slips.into_iter().chain(faults).collect() } else { beside };
        Judgement { verdict, faults, rivals, not_confirmed, contradiction, remainder }
    }

    /// Describes the residuals that the final model leaves unexplained. The final model contains the accepted effects
    /// if `are_accepted` is true. Otherwise it is the model without effects.
    fn remainder(&self, are_accepted: bool, not_confirmed: &[Score]) -> Remainder {
        let Self { search, path, before, reference, after, .. } = self;
        let last = if are_accepted { after } else { before };
        let chance = last.unseen_chance(!are_accepted);
        if let Some(generic) = &search.generic {
            return Remainder::of_generic(generic);
        }
        if let Some(scattering) = &search.scattering_rests {
            return Remainder::of_scattering(scattering);
        }
        let explains = |control: &&Control| {
            let [own, all] = [control.judged(), &control.evaluation].map(|of| of.figures.chi2_per_dof);
            own < (1.0 - MOST_REMOVED) * all || !last.is_poor()
        };
        let moved = last.control.as_ref().filter(explains).and_then(|control| control.step.as_ref());
        if let Some(step) = moved {
            return Remainder::of_sessions(step);
        }
        if !not_confirmed.is_empty() {
            let block = if not_confirmed[0].name.starts_with("accel") { "accel" } else { "gyro" };
            return Remainder::unknown(block, "not_confirmed", chance);
        }
        if last.is_poor() {
            return Remainder::unknown("recordings", "contradiction", chance);
        }
        let has_heading = !are_accepted || before.control.is_none() || !path.iter().any(|name| needs_heading(name));
        let unexplained = last.unexplained(!are_accepted).into_iter().filter(|_| has_heading);
        if let Some(worst) = unexplained.max_by(|a, b| a.ratio().total_cmp(&b.ratio())) {
            // A real unit has several small deviations from the model, so some unexplained residuals are normal. They
            // do not limit the use of the calibration if the accepted effects remove at least half of chi2 from one
            // kind of unseen residuals.
            let matters = !are_accepted || after.removed(reference).share < MOST_REMOVED;
            return Remainder { matters, ..Remainder::unknown(worst.group.name(), "above_noise", chance) };
        }
        Remainder::nothing(chance)
    }

    /// Faults of the clock, and excess noise inside moves, that explain the residuals of moves. `remainder` describes
    /// the residuals that the accepted effects leave unexplained.
    fn faults_beside_effects(&self, remainder: &Remainder) -> Vec<Finding> {
        let Self { recordings, search, after, .. } = self;
        let may_be_fault = match (&search.generic, remainder.pattern) {
            (Some(generic), _) => self.resembles_fault(generic),
            (None, None) => remainder.p_value < SIGNIFICANCE,
            (None, Some(pattern)) => {
                pattern == "above_noise" && remainder.block == Some(ResidualGroup::MoveDirections.name())
            }
        };
        if may_be_fault { clock_and_noise_faults(&after.outcome, recordings, true) } else { Vec::new() }
    }

    /// Whether wrong sampling instants, or a larger noise inside moves, may cause the variation `generic`, which no
    /// effect describes. The residuals that these faults cause resemble a variation of the gyroscope's scale. If a hand
    /// moved the unit, its motion is not smooth enough to distinguish these faults from such a variation.
    fn resembles_fault(&self, generic: &GenericFinding) -> bool {
        generic.block == Block::GyroscopeScale && !self.search.is_hand_moved
    }

    /// Faults of the data, and whether any of these faults disturbs the noise estimates and the residuals of moves.
    fn faults(&self, slips: &[Finding]) -> (Vec<Finding>, bool) {
        let Self { recordings, search, path, before, .. } = self;
        // If the user excludes the saturated samples, the finding is only a warning. It is not a fault here, because
        // no rest or move that the fit uses contains these samples.
        let is_excluded = |finding: &Finding| finding.is_saturation() && finding.severity == Severity::Warning;
        let is_fault = |finding: &&Finding| FAULTS.contains(&finding.code) && !is_excluded(finding);
        let mut faults: Vec<Finding> = before.outcome.findings.iter().filter(is_fault).cloned().collect();
        // All faults except an irregular clock and missing samples disturb the noise estimates and the residuals of
        // moves.
        let mut are_disturbing =
            faults.iter().any(|fault| !["clock_irregular", "samples_missing"].contains(&fault.code));
        let is_possible = slips.is_empty() && path.is_empty() && !are_disturbing;
        if is_possible && search.generic.as_ref().is_none_or(|generic| self.resembles_fault(generic)) {
            let found = clock_and_noise_faults(&before.outcome, recordings, search.generic.is_some());
            are_disturbing = !found.is_empty();
            faults.extend(found);
        }
        if faults.iter().any(|fault| fault.code == "clock_irregular") {
            // If the clock is irregular, a long sample interval does not prove that samples are missing.
            faults.retain(|fault| fault.code != "samples_missing");
        }
        (faults, are_disturbing)
    }

    fn rivals(&self) -> Vec<Rivals> {
        let rivals_of = |name: &String| {
            let score = self.search.path.iter().find(|score| score.name == *name);
            let rivals = score.map_or(&[][..], |score| &score.rivals);
            let rivals = rivals.iter().filter(|rival| !self.path.contains(rival)).cloned().collect();
            Rivals { name: name.clone(), rivals }
        };
        self.path.iter().map(rivals_of).collect()
    }

    /// The contradiction between unseen data and the effects, if there is one. Unseen data contradict the effects if
    /// residuals of the fit with effects exceed noise and the effects remove too small a share of chi2.
    fn contradiction(&self) -> Option<Contradiction> {
        let Self { search, path, before, reference, after, .. } = self;
        let removed = after.removed(reference);
        // Effects of the stand, and effects that act only inside moves, hardly change the residuals at rests and the
        // residuals of gravity directions after moves. These residuals therefore cannot contradict such effects.
        let is_of_stand = |name: &String| Effect::<f64>::find(name).is_some_and(|own| own.sensor == Sensor::Encoder);
        let is_of_rests =
            !path.iter().any(|name| is_unobservable_hand_held(name) || is_of_stand(name) || needs_heading(name));
        let is_confirmed = if after.is_poor() {
            removed.share >= LEAST_REMOVED
        } else if search.scattering_rests.is_some() && is_of_rests {
            removed.share >= MOST_REMOVED
        } else if !after.unexplained(false).is_empty() && is_of_rests {
            removed.share >= LEAST_REMOVED || removed.significance > SIGNIFICANT
        } else {
            true
        };
        let [before, after] = [reference, after].map(|fit| fit.unseen_chi2(before));
        (!is_confirmed).then(|| Contradiction { effects: path.to_vec(), before, after })
    }
}

impl Fit {
    /// Whether the figures of merit of this fit, on the calibration recordings or on the control recordings, make the
    /// verdict on the fit `poor`.
    fn is_poor(&self) -> bool {
        let control = self.control.as_ref().map(|control| &control.judged().figures);
        [Some(&self.outcome.figures), control].into_iter().flatten().any(|figures| figures.is_poor())
    }
}

/// Whether the share of samples that the fault affects is below the limit in [`FEW_PERCENT`]. Faults below this limit
/// do not disturb the fit.
fn are_few(fault: &Finding) -> bool {
    let limit = FEW_PERCENT.iter().find(|(code, _)| *code == fault.code).map_or(0.0, |(_, limit)| *limit);
    fault.severity == Severity::Warning && fault.value < limit
}
