//! Describes the residuals that the final model leaves unexplained. The final model contains the accepted effects. If
//! no effect was accepted, it is the model without effects.

use super::kernel::Kernel;
use super::session::SessionStep;
use super::{GenericFinding, Scattering};

/// Description of the residuals that the final model leaves unexplained.
#[derive(Clone, Debug, PartialEq)]
pub struct Remainder {
    /// Whether noise explains the residuals and, if noise does not explain them, whether the cause is a systematic
    /// deviation or a random walk.
    pub kind: RemainderKind,
    /// The part of the model or of the data that deviates; `None` if noise explains the residuals. It is a name from
    /// [`super::Block::name`], the name of a kind of residuals (`norms` or `moves`), `encoder`, `recordings`, `accel`,
    /// `gyro` or `biases`. `encoder` means the stand, and `recordings` means that the final fit is poor. `accel` or
    /// `gyro` is the sensor of an effect that unseen data do not confirm. `biases` means that the biases of both
    /// sensors changed between sessions.
    pub block: Option<&'static str>,
    /// How `block` deviates from the model. It is a name from [`Kernel::name`], or `white`, `contradiction`,
    /// `between_sessions`, `above_noise` or `not_confirmed`, or the code of a fault of the data (`clock_irregular` or
    /// `noise_grows_in_motion`). `None` if noise explains the residuals.
    pub pattern: Option<&'static str>,
    /// p-value under the hypothesis that noise is the only error. It belongs to the test that found `pattern`, with
    /// these exceptions:
    ///
    /// * If `pattern` is a fault of the data, the p-value belongs to the residuals that the fault explains.
    /// * If `pattern` is `None`, `above_noise` or `not_confirmed`, the p-value belongs to the residuals of unseen data.
    /// * If `block` is `recordings`, the p-value also belongs to the residuals of unseen data.
    pub p_value: f64,
    /// Whether the unexplained residuals limit the use of the calibration; `false` if noise explains the residuals. For
    /// the pattern `above_noise`, it is also `false` if the accepted effects remove at least half of chi2 from one kind
    /// of residuals of unseen data.
    pub matters: bool,
}

/// Kind of the residuals that remain unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemainderKind {
    /// Noise explains the residuals.
    Nothing,
    /// A systematic deviation that no effect describes.
    Unknown,
    /// A bias or a scale that varies as a random walk.
    Stochastic,
}

impl RemainderKind {
    /// Name in JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Unknown => "unknown",
            Self::Stochastic => "stochastic",
        }
    }
}

impl Remainder {
    /// The result if noise explains the residuals. `p_value` is the p-value of the residuals of unseen data under the
    /// hypothesis that noise is the only error.
    pub(super) fn nothing(p_value: f64) -> Self {
        Self { kind: RemainderKind::Nothing, block: None, pattern: None, p_value, matters: false }
    }

    pub(super) fn unknown(block: &'static str, pattern: &'static str, p_value: f64) -> Self {
        let kind = RemainderKind::Unknown;
        Self { kind, block: Some(block), pattern: Some(pattern), p_value, matters: true }
    }

    pub(super) fn of_generic(found: &GenericFinding) -> Self {
        let kind = match found.kernel {
            Kernel::RandomWalk => RemainderKind::Stochastic,
            _ => RemainderKind::Unknown,
        };
        Self { kind, ..Self::unknown(found.block.name(), found.kernel.name(), found.p_value) }
    }

    pub(super) fn of_scattering(&(name, _, p_value): &Scattering) -> Self {
        let block = match name {
            _ if name.starts_with("accel") => "accel_bias",
            _ if name.starts_with("gyro") => "gyro_bias",
            _ => "encoder",
        };
        Self::unknown(block, if name == "stand_and_sensors" { "contradiction" } else { "white" }, p_value)
    }

    pub(super) fn of_sessions(step: &SessionStep) -> Self {
        let block = match (step.accelerometer_mps2, step.gyroscope_radps) {
            (Some(_), Some(_)) => "biases",
            (Some(_), None) => "accel_bias",
            _ => "gyro_bias",
        };
        Self::unknown(block, "between_sessions", step.p_value)
    }
}
