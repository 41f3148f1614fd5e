//! What can go wrong. Every message says what, where, the number, and what to do about it.

use crate::finding::Finding;

/// Why there is no result.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// An argument that cannot be used.
    #[error("{0}")]
    Input(String),
    /// The data have faults that would make a calibration wrong; all of them are listed.
    #[error("{}", list(.0))]
    Data(Vec<Finding>),
    /// The motion does not determine every parameter; the message names the parameters and the poses to add.
    #[error("{0}")]
    NotEnoughMotion(String),
    /// The estimation did not come to an acceptable end.
    #[error("{0}")]
    Fit(String),
}

fn list(findings: &[Finding]) -> String {
    let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
    lines.join("\n")
}
