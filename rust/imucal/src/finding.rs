//! What is wrong with a recording: the faults that checks find.

use std::fmt;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Worth knowing; the calibration goes on.
    Warning,
    /// A calibration would be wrong: it is refused.
    Error,
}

/// One thing that is wrong with a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Reason code: stable, lower case, for scripts.
    pub code: &'static str,
    /// Whether a calibration is refused.
    pub severity: Severity,
    /// Name of the recording.
    pub recording: String,
    /// The columns concerned, such as `gyro_x`; empty if the whole recording is.
    pub columns: Vec<String>,
    /// First and last sample concerned and their times, where there is such a place.
    pub place: Option<Place>,
    /// How many samples are concerned.
    pub count: usize,
    /// The number that decided, in `unit`.
    pub value: f64,
    /// Unit of `value`.
    pub unit: &'static str,
    /// What is wrong, where, with the number.
    pub message: String,
    /// What to do about it.
    pub way_out: String,
}

/// A stretch of samples, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index of the first sample.
    pub first_sample: usize,
    /// Index of the last sample.
    pub last_sample: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Time of the last sample, s.
    pub end_s: f64,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} [{}]: {}", self.recording, self.message, self.code, self.way_out)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.first_sample == self.last_sample {
            write!(f, "at {:.2} s", self.start_s)
        } else {
            write!(f, "from {:.2} s to {:.2} s", self.start_s, self.end_s)
        }
    }
}

impl Finding {
    /// Whether samples at the end of the converter's range were found.
    pub fn is_saturation(&self) -> bool {
        self.code.ends_with("_saturation")
    }

    /// A finding that refuses the calibration, with everything but code and recording's name to be filled in.
    pub(crate) fn error(code: &'static str, recording: &str) -> Self {
        Self {
            code,
            severity: Severity::Error,
            recording: recording.into(),
            columns: Vec::new(),
            place: None,
            count: 0,
            value: 0.0,
            unit: "",
            message: String::new(),
            way_out: String::new(),
        }
    }

    /// A finding that is only worth knowing, to be filled in likewise.
    pub(crate) fn warning(code: &'static str, recording: &str) -> Self {
        Self { severity: Severity::Warning, ..Self::error(code, recording) }
    }
}
