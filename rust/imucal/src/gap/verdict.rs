//! The verdict of a search.
//!
//! ```text
//! data_fault        faults of the data explain the residuals, may explain them, or affect too many samples
//! stochastic        a bias varies as a random walk
//! unknown           no effect of the catalogue describes the residuals, or control recordings contradict the effects
//! named             effects were accepted
//! ambiguous         effects were accepted, but other effects explain the residuals equally well
//! nothing_missing   noise explains the residuals
//! ```

use super::clock::clock_and_noise_faults;
use super::fits::Fit;
use super::kernel::Kernel;
use super::mount::{StandRest, mount_slips};
use super::{Score, Search};
use crate::finding::{Finding, Severity};
use crate::recording::Recording;

/// Log Bayes factor, nats, above which an effect is significant although it does not predict unseen data; 8 nats are
/// odds of 3000 to 1.
const CERTAIN_NATS: f64 = 8.0;
/// Minimum relative decrease of chi2 of the control recordings that accepted effects must achieve. It applies only if
/// the calibration with effects is still a poor fit to these recordings.
const LEAST_REMOVED: f64 = 0.1;
/// Codes of data faults that prevent conclusions about effects.
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
/// Code and maximum share of affected samples, %, below which the fault alone is not the verdict. It applies if no
/// residual exceeds noise significantly.
const FEW_PERCENT: [(&str, f64); 2] = [("samples_missing", 0.2), ("samples_duplicated", 0.2)];

/// The conclusion of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Noise explains the recordings.
    NothingMissing,
    /// Effects were accepted.
    Named,
    /// Effects were accepted, but other effects explain the residuals equally well.
    Ambiguous,
    /// A bias varies as a random walk.
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
    /// Names of effects that were not accepted and whose log evidence is within three nats of that of the accepted
    /// effect.
    pub rivals: Vec<String>,
}

/// Effects that control recordings contradict, with chi2 per degree of freedom of these recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// Names of the contradicted effects.
    pub effects: Vec<String>,
    /// chi2 per degree of freedom without the effects.
    pub before: f64,
    /// chi2 per degree of freedom with the effects.
    pub after: f64,
}

/// The verdict and its basis.
pub(super) struct Judgement {
    pub(super) verdict: Verdict,
    /// Faults of the data; empty unless the verdict is `DataFault`.
    pub(super) faults: Vec<Finding>,
    pub(super) rivals: Vec<Rivals>,
    /// Effects with a significant log Bayes factor that do not improve the prediction of unseen data.
    pub(super) not_confirmed: Vec<Score>,
    /// Evidence of the control recordings that led to the removal of accepted effects.
    pub(super) contradiction: Option<Contradiction>,
}

/// The basis of a verdict: a search, the effects that were accepted, and the fits without and with them.
pub(super) struct Basis<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    pub(super) search: &'a Search,
    pub(super) path: &'a [String],
    pub(super) before: &'a Fit,
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
        let disagrees = search.scattering_rests.is_some() || !not_confirmed.is_empty() || before.is_poor();
        let rivals = self.rivals();
        let mut contradiction = None;
        let verdict = match &search.generic {
            // Faulty samples may cause the residuals that no effect explains.
            generic if !slips.is_empty() || (generic.is_some() && are_disturbing) => Verdict::DataFault,
            Some(generic) if generic.kernel == Kernel::RandomWalk => Verdict::Stochastic,
            Some(_) => Verdict::Unknown,
            None if !path.is_empty() && search.scattering_rests.is_none() => {
                contradiction = self.contradiction();
                match contradiction {
                    Some(_) => Verdict::Unknown,
                    None if rivals.iter().any(|own| !own.rivals.is_empty()) => Verdict::Ambiguous,
                    None => Verdict::Named,
                }
            }
            None if path.is_empty() && !faults.is_empty() && (disagrees || !faults.iter().all(are_few)) => {
                Verdict::DataFault
            }
            None if disagrees => Verdict::Unknown,
            None => Verdict::NothingMissing,
        };
        let is_fault = verdict == Verdict::DataFault;
        let faults = if is_fault { slips.into_iter().chain(faults).collect() } else { Vec::new() };
        Judgement { verdict, faults, rivals, not_confirmed, contradiction }
    }

    /// Faults of the data, and whether they disturb the noise estimates and the residuals of moves.
    fn faults(&self, slips: &[Finding]) -> (Vec<Finding>, bool) {
        let Self { recordings, search, path, before, .. } = self;
        let is_fault = |finding: &&Finding| FAULTS.contains(&finding.code);
        let mut faults: Vec<Finding> = before.outcome.findings.iter().filter(is_fault).cloned().collect();
        // Saturated and repeated samples disturb the noise estimates and the residuals of moves.
        let are_disturbing = faults.iter().any(|fault| !["clock_irregular", "samples_missing"].contains(&fault.code));
        if slips.is_empty() && path.is_empty() && search.generic.is_none() && !are_disturbing {
            faults.extend(clock_and_noise_faults(&before.outcome, recordings));
        }
        if faults.iter().any(|fault| fault.code == "clock_irregular") {
            // With an irregular clock, long sample intervals do not prove that samples were lost.
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

    /// Whether the control recordings contradict the effects: the calibration with effects is a poor fit to them, and
    /// chi2 decreases by less than [`LEAST_REMOVED`] relative to the fit without effects.
    fn contradiction(&self) -> Option<Contradiction> {
        let control = self.after.control.as_ref()?;
        if !control.evaluation.figures.is_poor() {
            return None;
        }
        let [before, after] = [self.before, self.after].map(|fit| fit.unseen_chi2(self.before));
        (after > (1.0 - LEAST_REMOVED) * before).then(|| Contradiction { effects: self.path.to_vec(), before, after })
    }
}

impl Fit {
    /// Whether the calibration is a poor fit to the calibration recordings or to the control recordings.
    fn is_poor(&self) -> bool {
        let control = self.control.as_ref().map(|control| &control.evaluation.figures);
        [Some(&self.outcome.figures), control].into_iter().flatten().any(|figures| figures.is_poor())
    }
}

/// Whether the share of affected samples is too small to disturb a fit.
fn are_few(fault: &Finding) -> bool {
    let limit = FEW_PERCENT.iter().find(|(code, _)| *code == fault.code).map_or(0.0, |(_, limit)| *limit);
    fault.severity == Severity::Warning && fault.value < limit
}
