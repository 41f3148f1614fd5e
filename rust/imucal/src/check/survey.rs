//! Single pass over the samples that collects the data for all checks that run before the rests are detected.
//!
//! Each check has a small accumulator. The recording is divided into short blocks. All accumulators process one block
//! before the next block, so that the block stays in the processor's cache.

use pulp::{Simd, WithSimd};

use super::clock::Steps;
use super::identical::Identical;
use super::part::{PART, Part};
use super::repeats::Repeats;
use super::runs::Runs;
use super::spikes::Spikes;
use super::units::Lengths;
use super::values::{Extremes, NotFinite};
use super::zeros::Zeros;
use crate::cancellation::checkpoint;
use crate::numerics::instructions::Instructions;
use crate::recording::Recording;

/// Data that the pass over a recording has collected, one field for each kind of check. The checks derive their
/// findings from these data.
pub(super) struct Survey {
    pub(super) not_finite: NotFinite,
    pub(super) steps: Steps,
    pub(super) repeats: Repeats,
    pub(super) runs: Runs,
    pub(super) extremes: Extremes,
    pub(super) lengths: Lengths,
    pub(super) zeros: Zeros,
    pub(super) identical: Identical,
    pub(super) spikes: Spikes,
}

impl Survey {
    /// Processes all samples in one pass. All columns must have the same length.
    pub(super) fn of(recording: &Recording<'_>) -> Self {
        Instructions::Best.run(Surveying(recording))
    }
}

/// The pass over all samples of a recording. The crate `pulp` runs it with the widest vector instructions of the
/// processor.
struct Surveying<'a>(&'a Recording<'a>);

impl WithSimd for Surveying<'_> {
    type Output = Survey;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Survey {
        let Self(recording) = self;
        let mut survey = Survey {
            not_finite: NotFinite::default(),
            steps: Steps::default(),
            repeats: Repeats::default(),
            runs: Runs::default(),
            extremes: Extremes::default(),
            lengths: Lengths::default(),
            zeros: Zeros::default(),
            identical: Identical::default(),
            spikes: Spikes::default(),
        };
        for start in (0..recording.len()).step_by(PART) {
            checkpoint();
            let part = Part::new(recording, start..(start + PART).min(recording.len()));
            survey.not_finite.feed(&part);
            survey.steps.feed(&part);
            survey.repeats.feed(&part);
            survey.runs.feed(&part);
            survey.extremes.feed(&part);
            survey.lengths.feed(&part);
            survey.zeros.feed(&part);
            survey.identical.feed(&part);
            survey.spikes.feed(&part);
        }
        survey.runs.finish(recording);
        survey
    }
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;

    #[test]
    fn parts_meet_without_a_seam() {
        // Equal samples, non-finite values and a backward time step, each placed across the boundary of two blocks.
        let mut columns = Columns::tumbling();
        let seam = 3 * PART;
        for i in seam - 5..seam + 5 {
            columns.force[i][1] = columns.force[seam - 5][1];
        }
        columns.rate[7 * PART - 1][2] = f64::NAN;
        columns.rate[7 * PART][2] = f64::INFINITY;
        columns.time_s[5 * PART] = columns.time_s[5 * PART - 2];
        let survey = Survey::of(&columns.recording());
        assert_eq!(survey.runs.longest(1), (seam - 5, seam + 4));
        assert_eq!(survey.not_finite.samples(), (2, Some((7 * PART - 1, 7 * PART))));
        assert_eq!(survey.steps.first_backward(), Some(5 * PART));
    }

    #[test]
    fn the_extremes_are_those_of_the_finite_values() {
        let mut columns = Columns::tumbling();
        columns.force[0][0] = -99.0;
        columns.force[3999][2] = 99.0;
        columns.rate[1000] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        let survey = Survey::of(&columns.recording());
        let [force, rate] = survey.extremes.ends;
        assert_eq!((force[0][0], force[2][1]), (-99.0, 99.0));
        for (ends, rows) in [(force, &columns.force), (rate, &columns.rate)] {
            assert_eq!(ends, [0, 1, 2].map(|axis| super::super::values::extremes(rows.into(), axis)));
        }
    }
}
