//! Runs of equal samples in one channel: three or more, for two are nothing unusual.

use super::part::Part;
use super::plateau::PLATEAU;
use crate::recording::Recording;

/// The runs of each channel, accelerometer first.
pub(super) struct Runs {
    /// Channels of which the last sample has the value of the one before, one bit each.
    equal: u8,
    /// Channels that are in a run, and since when.
    going_on: u8,
    start: [usize; 6],
    longest: [(usize, usize); 6],
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

    /// First and last sample of the longest run of a channel, the first of several.
    pub(super) fn longest(&self, channel: usize) -> (usize, usize) {
        self.longest[channel]
    }

    /// Lowest and highest value that each axis of a triad holds for long enough to make a plateau.
    pub(super) fn held(&self, triad: usize) -> [[f64; 2]; 3] {
        [0, 1, 2].map(|axis| self.held[3 * triad + axis])
    }
}

/// The channels whose bits are set.
fn channels(mut bits: u8) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (bits != 0).then(|| {
            let channel = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            channel
        })
    })
}
