//! One pass over the samples for all checks of the columns.
//!
//! Every check keeps what it wants to know in a small accumulator, which is fed one part of the recording after the
//! other. A part is short enough to stay in the processor's cache while all of them look at it.

use std::borrow::Cow;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::clock::Steps;
use super::repeats::Repeats;
use super::runs::Runs;
use super::units::Lengths;
use super::values::{Extremes, NotFinite};
use crate::recording::Recording;

/// Samples of a part: 14 kB.
const PART: usize = 256;

/// Some samples in a row, and what all checks ask of them first.
pub(super) struct Part<'a> {
    pub(super) recording: &'a Recording<'a>,
    pub(super) samples: Range<usize>,
    /// Whether time and both triads are finite throughout.
    pub(super) is_finite: bool,
    equal: [u8; PART],
    /// The accelerometer's rows and the gyroscope's.
    triads: [Cow<'a, [[f64; 3]]>; 2],
}

/// What the checks know of a recording after one pass.
pub(super) struct Survey {
    pub(super) not_finite: NotFinite,
    pub(super) steps: Steps,
    pub(super) repeats: Repeats,
    pub(super) runs: Runs,
    pub(super) extremes: Extremes,
    pub(super) lengths: Lengths,
}

/// Bits of [`Part::equal`] of a row that repeats the one before.
pub(super) const ALL_EQUAL: u8 = 0b11_1111;

impl Survey {
    /// The columns must be of one length.
    pub(super) fn of(recording: &Recording<'_>) -> Self {
        Arch::new().dispatch(Surveying(recording))
    }
}

/// The pass, made with the widest vectors that the processor has.
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
        };
        for start in (0..recording.len()).step_by(PART) {
            let part = Part::new(recording, start..(start + PART).min(recording.len()));
            survey.not_finite.feed(&part);
            survey.steps.feed(&part);
            survey.repeats.feed(&part);
            survey.runs.feed(&part);
            survey.extremes.feed(&part);
            survey.lengths.feed(&part);
        }
        survey.runs.finish(recording);
        survey
    }
}

impl<'a> Part<'a> {
    #[inline(always)]
    fn new(recording: &'a Recording<'a>, samples: Range<usize>) -> Self {
        let first = samples.start.max(1);
        let triads = [recording.specific_force, recording.angular_rate].map(|rows| rows.part(first - 1..samples.end));
        let [force, rate] = triads.each_ref().map(|rows| rows.as_flattened());
        let is_finite = all_finite(&recording.time_s[samples.clone()]) && all_finite(force) && all_finite(rate);
        let (force, rate) = (same(force), same(rate));
        let mut equal = [0; PART];
        let bits = force.as_chunks::<3>().0.iter().zip(rate.as_chunks::<3>().0);
        for (equal, ([fx, fy, fz], [wx, wy, wz])) in equal[first - samples.start..].iter_mut().zip(bits) {
            *equal = fx | fy << 1 | fz << 2 | wx << 3 | wy << 4 | wz << 5;
        }
        Self { recording, samples, is_finite, equal, triads }
    }

    /// Each sample but the first of all, with a bit for every channel that has the value of the sample before.
    pub(super) fn equal(&self) -> impl Iterator<Item = (usize, u8)> + '_ {
        let first = self.samples.start.max(1);
        (first..self.samples.end).zip(self.equal[first - self.samples.start..].iter().copied())
    }

    /// The accelerometer's rows and the gyroscope's.
    pub(super) fn triads(&self) -> [&[[f64; 3]]; 2] {
        let own = usize::from(self.samples.start > 0);
        self.triads.each_ref().map(|rows| &rows[own..])
    }
}

/// One for each number of some rows that is that of the row before, zero for others and beyond their end.
#[inline(always)]
fn same(numbers: &[f64]) -> [u8; 3 * PART] {
    let mut same = [0; 3 * PART];
    let pairs = numbers.iter().zip(&numbers[3..]);
    same.iter_mut().zip(pairs).for_each(|(same, (before, after))| *same = u8::from(before == after));
    same
}

/// Without a branch for each, which lets the compiler look at several at once.
#[inline(always)]
pub(super) fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |all, value| all & value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;

    #[test]
    fn parts_meet_without_a_seam() {
        // A stretch of equal samples, a gap in the numbers and a backward step, each across the end of a part.
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
