//! A part of a recording, short enough to stay in the processor's cache while every check reads it.

use std::borrow::Cow;
use std::ops::Range;

use crate::recording::Recording;

/// Samples of a part: 14 kB.
pub(super) const PART: usize = 256;

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

/// Bits of [`Part::equal`] of a row that repeats the one before.
pub(super) const ALL_EQUAL: u8 = 0b11_1111;

impl<'a> Part<'a> {
    #[inline(always)]
    pub(super) fn new(recording: &'a Recording<'a>, samples: Range<usize>) -> Self {
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
