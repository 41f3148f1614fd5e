//! Refuses control recordings that are not independent of the calibration recordings.

use std::ops::Range;

use crate::check::{at_rest, check_control};
use crate::error::Error;
use crate::evaluate::RestReport;
use crate::recording::Recording;

/// Returns, for each recording, the sample index ranges of its rests. `count` is the number of recordings.
pub fn rest_ranges(rests: &[RestReport], count: usize) -> Vec<Vec<Range<usize>>> {
    let of = |index| rests.iter().filter(|rest| rest.recording == index).map(|rest| rest.first..rest.end).collect();
    (0..count).map(of).collect()
}

/// Returns an error if a control recording is a part or an altered copy of a calibration recording. Such a control
/// recording contains the noise to which the calibration was fitted, so the residuals on it would be too small.
///
/// `rests` and `control_rests` are the index ranges of the rests of each recording ([`rest_ranges`]).
///
/// # Errors
/// [`Error::Data`] with the finding `control_not_independent`.
pub fn require_independent(
    (recordings, rests): (&[Recording<'_>], &[Vec<Range<usize>>]),
    (control, control_rests): (&[Recording<'_>], &[Vec<Range<usize>>]),
) -> Result<(), Error> {
    let findings = check_control(&at_rest(recordings, rests), &at_rest(control, control_rests));
    if findings.is_empty() { Ok(()) } else { Err(Error::Data(findings)) }
}
