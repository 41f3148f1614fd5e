//! Finds the longest interval of a recording in which almost no samples are lost or repeated.
//!
//! ```text
//! e_k = t_k - t_0 - k T,    E_k = minimum of e_m over the samples m >= k of the next second
//! ```
//!
//! t_k is the time stamp of sample k. T is the sampling interval: the mean of all time steps that are between 0.5 and
//! 1.5 times the median time step. e_k is the delay of time stamp k, and E_k is the lower envelope of the delays. A
//! late time stamp increases one e_k, but it does not increase E. Lost samples increase E permanently, by T for each
//! lost sample. Lost samples are therefore detected in E, so that late samples are not mistaken for lost samples.

use std::collections::VecDeque;
use std::ops::Range;

use crate::numerics::stats::quantile;
use crate::recording::Recording;

/// Maximum share of lost or repeated samples in the selected interval. A larger share would change the power spectrum
/// at high frequencies.
const IRREGULAR_SHARE: f64 = 1e-4;
/// If the lower envelope E of the delays of the time stamps increases by more than this number of time steps from one
/// sample to the next, samples are lost between these two samples. One lost sample increases E by one time step.
const LOST: f64 = 0.6;
/// Length of the time window, s. The lower envelope E is the minimum of the delays of the time stamps in this window.
/// If time stamps are late for at most this time, E does not increase, and no sample is mistaken for a lost sample.
const WINDOW_S: f64 = 1.0;
/// Minimum number of samples in the time window whose minimum delay is the lower envelope E.
const FEWEST_IN_WINDOW: usize = 16;

/// A part of a recording in which almost no samples are lost or repeated.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stretch {
    pub(super) samples: Range<usize>,
    /// Number of lost samples in the whole recording.
    pub(super) lost: usize,
    /// Number of repeated rows in the whole recording.
    pub(super) repeated: usize,
    /// Number of positions in the whole recording at which samples are lost or repeated.
    pub(super) places: usize,
}

/// Finds the longest interval in which almost no samples are lost or repeated. `has_repeats` is true if equal
/// consecutive rows are repeated samples, and false if such rows are a coincidence. Equal consecutive rows with the
/// same time stamp always count as repeated samples.
pub(super) fn longest(recording: &Recording<'_>, has_repeats: bool) -> Stretch {
    let faults = faults(recording, has_repeats);
    let (lost, repeated) = faults.iter().fold((0, 0), |(lost, repeated), fault| match fault.is_lost {
        true => (lost + fault.count, repeated),
        false => (lost, repeated + fault.count),
    });
    // The faults divide the recording into groups of samples. The longest sequence of consecutive groups is selected in
    // which the share of lost or repeated samples is at most `IRREGULAR_SHARE`.
    let ends: Vec<usize> = faults.iter().map(|fault| fault.sample).chain([recording.len()]).collect();
    let mut best = 0..0;
    let (mut first, mut inside) = (0, 0);
    for (last, &end) in ends.iter().enumerate() {
        // The faults inside the sequence have the indices `first` to `last - 1`.
        let start_of = |group: usize| if group == 0 { 0 } else { ends[group - 1] };
        if last > first {
            inside += faults[last - 1].count;
        }
        while first < last && inside as f64 > IRREGULAR_SHARE * (end - start_of(first)) as f64 {
            inside -= faults[first].count;
            first += 1;
        }
        if end - start_of(first) > best.len() {
            best = start_of(first)..end;
        }
    }
    Stretch { samples: best, lost, repeated, places: faults.len() }
}

/// A fault in a recording: either `count` samples are lost before the sample with the index `sample`, or this sample
/// repeats the previous one.
struct Fault {
    sample: usize,
    count: usize,
    is_lost: bool,
}

fn faults(recording: &Recording<'_>, has_repeats: bool) -> Vec<Fault> {
    let time_s = recording.time_s;
    let samples = time_s.len();
    let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    if steps.is_empty() {
        return Vec::new();
    }
    let median_s = quantile(&mut steps, 0.5);
    let regular = steps.iter().filter(|step| (0.5..=1.5).contains(&(*step / median_s)));
    let (sum, count) = regular.fold((0.0, 0), |(sum, count), step| (sum + step, count + 1));
    let interval_s = if count > 0 { sum / f64::from(count) } else { median_s };
    let equal = |k: usize| {
        let sensors = [recording.specific_force, recording.angular_rate];
        sensors.iter().all(|rows| rows.is_absent() || rows.at(k) == rows.at(k - 1))
    };
    let is_repeated = |k: usize| (has_repeats || time_s[k] == time_s[k - 1]) && equal(k);

    let mut faults = Vec::new();
    let mut envelope = Envelope::new((WINDOW_S / interval_s) as usize, samples);
    let mut place = 0.0;
    for k in 0..samples {
        if k > 0 {
            if is_repeated(k) {
                faults.push(Fault { sample: k, count: 1, is_lost: false });
            }
            // A row that was written twice is not a new sample, so it does not increase the sample number `place`.
            place += if time_s[k] == time_s[k - 1] && equal(k) { 0.0 } else { 1.0 };
        }
        envelope.push(k, time_s[k] - time_s[0] - place * interval_s);
    }
    for (sample, rise_s) in envelope.rises() {
        let lost = rise_s / interval_s;
        if lost > LOST {
            faults.push(Fault { sample, count: lost.round() as usize, is_lost: true });
        }
    }
    faults.sort_by_key(|fault| fault.sample);
    faults
}

/// Sliding-window minimum of a sequence. The window of an element consists of this element and the next `window` - 1
/// elements.
struct Envelope {
    window: usize,
    /// Elements that may still become the minimum of a window, as pairs (index, value). From front to back of the
    /// queue, the indices and the values increase.
    queue: VecDeque<(usize, f64)>,
    minima: Vec<f64>,
}

impl Envelope {
    fn new(window: usize, samples: usize) -> Self {
        Self { window: window.max(FEWEST_IN_WINDOW), queue: VecDeque::new(), minima: Vec::with_capacity(samples) }
    }

    fn push(&mut self, index: usize, value: f64) {
        while self.queue.back().is_some_and(|(_, last)| *last >= value) {
            self.queue.pop_back();
        }
        self.queue.push_back((index, value));
        if index + 1 >= self.window {
            self.pop(index + 1 - self.window);
        }
    }

    fn pop(&mut self, start: usize) {
        if let Some((_, least)) = self.queue.front() {
            self.minima.push(*least);
        }
        if self.queue.front().is_some_and(|(index, _)| *index <= start) {
            self.queue.pop_front();
        }
    }

    /// Returns, for each element except the first, its index and the increase of the minimum since the previous
    /// element.
    fn rises(mut self) -> impl Iterator<Item = (usize, f64)> {
        while let Some(&(index, _)) = self.queue.back() {
            let start = self.minima.len();
            if start > index {
                break;
            }
            self.pop(start);
        }
        let minima = self.minima;
        (1..minima.len()).map(move |k| (k, minima[k] - minima[k - 1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(time_s: &[f64]) -> Stretch {
        let rows: Vec<[f64; 3]> = (0..time_s.len()).map(|k| [(k as f64 * 0.7).sin(); 3]).collect();
        longest(&Recording::try_new("t", time_s, &rows, &rows).unwrap(), false)
    }

    fn clock(samples: usize) -> Vec<f64> {
        (0..samples).map(|k| 0.01 * k as f64).collect()
    }

    fn without(time_s: &[f64], lost: impl Fn(usize) -> bool) -> Vec<f64> {
        (0..time_s.len()).filter(|k| !lost(*k)).map(|k| time_s[k]).collect()
    }

    #[test]
    fn a_recording_without_faults_is_one_stretch() {
        assert_eq!(of(&clock(3000)), Stretch { samples: 0..3000, lost: 0, repeated: 0, places: 0 });
    }

    #[test]
    fn late_time_stamps_are_not_missing() {
        let mut time_s = clock(3000);
        (100..2900).step_by(97).for_each(|k| time_s[k] += 0.008);
        // The computer pauses for 0.3 s, and then 30 samples arrive together.
        (1500..1530).for_each(|k| time_s[k] = 15.3 + 1e-4 * (k - 1500) as f64);
        assert_eq!(of(&time_s).samples, 0..3000);
    }

    #[test]
    fn the_stretch_between_gaps_is_the_longest() {
        let time_s = without(&clock(6000), |k| (1000..1030).contains(&k) || k == 4500);
        let found = of(&time_s);
        assert_eq!((found.lost, found.places), (31, 2));
        assert_eq!(found.samples, 1000..4470);
    }

    #[test]
    fn a_lost_sample_in_ten_thousand_is_no_gap() {
        let time_s = without(&clock(60_000), |k| k % 15_000 == 7000);
        assert_eq!(of(&time_s).samples, 0..59_996);
    }

    #[test]
    fn rows_written_twice_end_a_stretch() {
        let mut time_s = clock(3000);
        time_s.insert(2000, time_s[1999]);
        let mut rows: Vec<[f64; 3]> = (0..3000).map(|k| [(k as f64 * 0.7).sin(); 3]).collect();
        rows.insert(2000, rows[1999]);
        let found = longest(&Recording::try_new("t", &time_s, &rows, &rows).unwrap(), false);
        assert_eq!((found.samples, found.lost, found.repeated), (0..2000, 0, 1));
    }

    #[test]
    fn coarse_stamps_and_a_fast_clock_are_no_gaps() {
        let coarse: Vec<f64> = (0..8000).map(|k| (2.5 * k as f64).floor() * 1e-3).collect();
        assert_eq!(of(&coarse).places, 0);
        let jitter: Vec<f64> = (0..8000).map(|k| 0.01 * (k as f64 * 1.0003 + 0.2 * (k as f64 * 1.7).sin())).collect();
        assert_eq!(of(&jitter).places, 0);
    }
}
