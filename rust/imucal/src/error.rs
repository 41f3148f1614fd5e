//! Errors of this crate. Every message states the fault, its location, the value that revealed it, and the recommended
//! action.

use std::sync::Arc;

use crate::finding::Finding;

/// Reason why a function of this crate returns no result.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// An argument has a value that cannot be used.
    #[error("{0}")]
    Input(String),
    /// The data have faults that would make a calibration wrong. All faults are listed.
    #[error("{}", list(.0))]
    Data(Vec<Finding>),
    /// The motion does not determine every parameter. The message names the parameters, and the poses or moves to add.
    #[error("{0}")]
    NotEnoughMotion(String),
    /// The estimation failed to converge, or its result is not usable.
    #[error("{0}")]
    Fit(String),
    /// The calculation was cancelled, see [`Cancellation`](crate::cancellation::Cancellation).
    #[error("cancelled before the calculation had ended")]
    Cancelled,
    /// A function that was passed by the caller has failed.
    #[error("{0}")]
    Caller(Arc<dyn std::error::Error + Send + Sync>),
}

fn list(findings: &[Finding]) -> String {
    let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
    lines.join("\n")
}
