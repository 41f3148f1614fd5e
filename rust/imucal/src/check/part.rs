//! A block of consecutive samples. It is short enough to stay in the processor's cache while all checks process it.

use std::borrow::Cow;
use std::ops::Range;

use crate::recording::{Recording, Samples};

/// Number of samples in a block. At 56 bytes per sample (time and six channels), a block has 14 kB and fits into the L1
/// cache.
pub(super) const PART: usize = 256;

/// A block of consecutive samples of a recording, with properties of these samples that several checks use.
pub(super) struct Part<'a> {
    pub(super) recording: &'a Recording<'a>,
    pub(super) samples: Range<usize>,
    /// Whether the time and all channels of the recorded sensors are finite in all samples.
    pub(super) is_finite: bool,
    /// The bits of the channels of all recorded sensors. [`Part::equal`] returns these bits for a sample that equals
    /// the previous sample in all channels.
    pub(super) all_equal: u8,
    equal: [u8; PART],
    /// Samples of the accelerometer and of the gyroscope. If the recording has a sample before the block, that sample
    /// is the first one here.
    triads: [Cow<'a, [[f64; 3]]>; 2],
}

impl<'a> Part<'a> {
    #[inline(always)]
    pub(super) fn new(recording: &'a Recording<'a>, samples: Range<usize>) -> Self {
        let first = samples.start.max(1);
        let sensors = [recording.specific_force, recording.angular_rate];
        let triads = sensors.map(|rows| rows.part(first - 1..samples.end));
        let [no_force, no_rate] = sensors.map(Samples::is_absent);
        let [force, rate] = triads.each_ref().map(|rows| rows.as_flattened());
        let is_finite = all_finite(&recording.time_s[samples.clone()])
            && (no_force || all_finite(force))
            && (no_rate || all_finite(rate));
        let all_equal = if no_force { 0 } else { 0b00_0111 } | if no_rate { 0 } else { 0b11_1000 };
        let (force, rate) = (same(force), same(rate));
        let mut equal = [0; PART];
        let bits = force.as_chunks::<3>().0.iter().zip(rate.as_chunks::<3>().0);
        for (equal, ([fx, fy, fz], [wx, wy, wz])) in equal[first - samples.start..].iter_mut().zip(bits) {
            *equal = fx | fy << 1 | fz << 2 | wx << 3 | wy << 4 | wz << 5;
        }
        Self { recording, samples, is_finite, all_equal, equal, triads }
    }

    /// Returns the index of each sample of the block, with one bit per channel. The bit of a channel is set if the
    /// channel has the same value as in the previous sample. The first sample of a recording is omitted.
    pub(super) fn equal(&self) -> impl Iterator<Item = (usize, u8)> + '_ {
        let first = self.samples.start.max(1);
        (first..self.samples.end).zip(self.equal[first - self.samples.start..].iter().copied())
    }

    /// Samples of the accelerometer and of the gyroscope in this block, without the sample before it.
    pub(super) fn triads(&self) -> [&[[f64; 3]]; 2] {
        let own = usize::from(self.samples.start > 0);
        self.triads.each_ref().map(|rows| &rows[own..])
    }

    /// Samples of the accelerometer and of the gyroscope in this block, preceded by the last sample before the block if
    /// there is one.
    pub(super) fn triads_and_before(&self) -> [&[[f64; 3]]; 2] {
        self.triads.each_ref().map(|rows| &rows[..])
    }
}

/// Compares each number, from the second row (three axes) on, with the number of the same axis in the previous row. The
/// result is 1 if they are equal, otherwise 0. Unused elements at the end are 0.
#[inline(always)]
fn same(numbers: &[f64]) -> [u8; 3 * PART] {
    let mut same = [0; 3 * PART];
    let pairs = numbers.iter().zip(&numbers[3..]);
    same.iter_mut().zip(pairs).for_each(|(same, (before, after))| *same = u8::from(before == after));
    same
}

/// Whether all values are finite. The loop has no branches, so the compiler can vectorise it.
#[inline(always)]
pub(super) fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |all, value| all & value.is_finite())
}
