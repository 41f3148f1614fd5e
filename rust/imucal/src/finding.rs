//! Findings: the faults that the checks report about a recording.

use std::fmt;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// The fault is reported, and the calibration continues.
    Warning,
    /// The calibration is refused, because it would be wrong.
    Error,
}

/// A fault of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Reason code for scripts, in lower case; it does not change between versions of imucal.
    pub code: &'static str,
    /// Whether the calibration continues or is refused because of the fault.
    pub severity: Severity,
    /// Name of the recording.
    pub recording: String,
    /// Affected columns, such as `gyro_x`; empty if the whole recording is affected.
    pub columns: Vec<String>,
    /// First and last affected sample with their times, if the fault has a location.
    pub place: Option<Place>,
    /// Number of affected samples. Some findings count other items instead, for example axes, rests or units.
    pub count: usize,
    /// The measured value that revealed the fault, in the unit `unit`. An example is a temperature above its limit.
    pub value: f64,
    /// Unit of `value`.
    pub unit: &'static str,
    /// Description of the fault with its location and its value.
    pub message: String,
    /// Recommended action.
    pub way_out: String,
}

/// An interval of samples. It includes both ends.
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

/// Formats a count with its noun in the singular or plural, such as "1 sample" or "3 samples".
pub(crate) fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Formats a number with `digits` significant digits like `%g` of C, without trailing zeros. The text has an exponent
/// if the magnitude of the number is below 1e-4, or if its integer part has more than `digits` digits.
pub(crate) fn general(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let scientific = format!("{value:.*e}", digits - 1);
    let Some((mantissa, exponent)) = scientific.split_once('e') else { return scientific };
    let trimmed = |number: &str| match number.contains('.') {
        true => number.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => number.to_owned(),
    };
    match exponent.parse::<i32>() {
        Ok(power) if power >= -4 && power < digits as i32 => {
            trimmed(&format!("{value:.*}", (digits as i32 - 1 - power).max(0) as usize))
        }
        Ok(power) => format!("{}e{}{:02}", trimmed(mantissa), if power < 0 { '-' } else { '+' }, power.abs()),
        Err(_) => scientific,
    }
}

impl Finding {
    /// Whether the finding reports saturation, that is, samples at an end of the range of the A/D converter.
    pub fn is_saturation(&self) -> bool {
        self.code.ends_with("_saturation")
    }

    /// Whether the finding reports wrong time stamps, or missing or repeated samples.
    pub(crate) fn is_about_time_stamps(&self) -> bool {
        ["clock_irregular", "samples_missing", "samples_duplicated"].contains(&self.code)
    }

    /// A finding for which the calibration is refused. It has only a code, a severity and the name of the recording;
    /// the caller sets all other fields.
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

    /// A finding that is only reported, so that the calibration continues. The caller sets the other fields as for
    /// [`Finding::error`].
    pub(crate) fn warning(code: &'static str, recording: &str) -> Self {
        Self { severity: Severity::Warning, ..Self::error(code, recording) }
    }
}

#[cfg(test)]
mod tests {
    use super::general;

    #[test]
    fn numbers_are_written_as_c_writes_them() {
        let cases = [
            (0.000_123_4, 2, "0.00012"),
            (0.000_012_34, 2, "1.2e-05"),
            (99.96, 3, "100"),
            (1234.5, 2, "1.2e+03"),
            (-2.5, 3, "-2.5"),
            (0.0, 3, "0"),
            (1e100, 3, "1e+100"),
        ];
        for (value, digits, text) in cases {
            assert_eq!(general(value, digits), text);
        }
    }
}
