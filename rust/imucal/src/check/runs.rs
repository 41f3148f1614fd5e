//! Detection of runs in one channel. A run is a sequence of three or more equal consecutive samples. Two equal samples
//! are frequent and are not a run.

use super::part::Part;
use super::plateau::PLATEAU;
use crate::recording::Recording;

/// The runs (sequences of equal samples) of each channel, and the state of the search for them. The accelerometer
/// channels are first.
pub(super) struct Runs {
    /// One bit per channel. It is set if the channel has the same value in the last processed sample and in the sample
    /// before it.
    equal: u8,
    /// One bit per channel. It is set while the channel is in a run of equal samples.
    going_on: u8,
    /// First sample of the current run of each channel.
    start: [usize; 6],
    /// First and last sample of the longest run of each channel.
    longest: [(usize, usize); 6],
    /// Lowest and highest of the values that each channel repeats in at least three ([`PLATEAU`]) consecutive samples.
    held: [[f64; 2]; 6],
}

impl Default for Runs {
    fn default() -> Self {
        Self {
            equal: 0,
            going_on: 0,
            start: [0; 6],
            longest: [(0, 0); 6],
            held: [[f64::INFINITY, f64::NEG_INFINITY]; 6],
        }
    }
}

impl Runs {
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        for (i, equal) in part.equal() {
            let in_run = equal & self.equal;
            self.equal = equal;
            if in_run == self.going_on {
                continue;
            }
            channels(in_run & !self.going_on).for_each(|channel| self.start[channel] = i - 2);
            channels(self.going_on & !in_run).for_each(|channel| self.end(part.recording, channel, i));
            self.going_on = in_run;
        }
    }

    pub(super) fn finish(&mut self, recording: &Recording<'_>) {
        channels(self.going_on).for_each(|channel| self.end(recording, channel, recording.len()));
    }

    fn end(&mut self, recording: &Recording<'_>, channel: usize, end: usize) {
        let start = self.start[channel];
        let (first, last) = self.longest[channel];
        if end - 1 - start > last - first {
            self.longest[channel] = (start, end - 1);
        }
        if end - start >= PLATEAU {
            let rows = if channel < 3 { recording.specific_force } else { recording.angular_rate };
            let (value, [low, high]) = (rows.at(start)[channel % 3], self.held[channel]);
            self.held[channel] = [low.min(value), high.max(value)];
        }
    }

    /// First and last sample of the longest run of a channel. If several runs are equally long, the first of them is
    /// returned.
    pub(super) fn longest(&self, channel: usize) -> (usize, usize) {
        self.longest[channel]
    }

    /// Lowest and highest of the values that each axis of a triad repeats in at least three ([`PLATEAU`]) consecutive
    /// samples; [inf, -inf] if there are no such values.
    pub(super) fn held(&self, triad: usize) -> [[f64; 2]; 3] {
        [0, 1, 2].map(|axis| self.held[3 * triad + axis])
    }
}

/// Indices of the channels whose bits are set.
fn channels(mut bits: u8) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (bits != 0).then(|| {
            let channel = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            channel
        })
    })
}
