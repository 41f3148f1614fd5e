//! Faults between the sensor and the file: clock errors, lost samples, and repeated samples.
//!
//! ```text
//! stamp_i = i / rate
//! t_i     = stamp_i / (1 + clock_rate_error) + clock_jitter n_i      the true time of sample i
//! ```
//!
//! n_i are independent standard normal numbers. The time stamps stay nominal, so the time column does not show a clock
//! error. In each second of true time, the clock of the unit gains `clock_rate_error` seconds.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::stream::Stream;
use crate::error::Error;

/// Faults of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Share of lost samples. Samples are lost independently of each other, and the recording has no rows for lost
    /// samples. The first sample is never lost.
    pub missing_share: f64,
    /// Share of samples that have a new time stamp but the measured force and rate of the previous sample. Such samples
    /// occur if a sensor is read before its next sample is available.
    pub duplicated_share: f64,
    /// Relative rate error of the unit's clock; positive if the clock is fast.
    pub clock_rate_error: f64,
    /// Standard deviation of the random error (jitter) of the sampling instants, s.
    pub clock_jitter_s: f64,
}

impl Faults {
    /// A recording without faults.
    pub fn none() -> Self {
        Self::default()
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(message));
        for (name, share) in [("missing_share", self.missing_share), ("duplicated_share", self.duplicated_share)] {
            if !(0.0..1.0).contains(&share) {
                return input(format!("{name} is {share}: give a share from 0 to below 1"));
            }
        }
        // A clock that runs at less than half or more than double the true rate is not plausible.
        if !(-0.5..=1.0).contains(&self.clock_rate_error) {
            return input(format!("clock_rate_error is {}: give -0.5 to 1", self.clock_rate_error));
        }
        if !(self.clock_jitter_s.is_finite() && self.clock_jitter_s >= 0.0) {
            return input(format!("clock_jitter_s is {}: give zero or a positive value", self.clock_jitter_s));
        }
        Ok(())
    }

    /// Returns one flag per sample, which is true if the sample is lost; `None` if `missing_share` is zero.
    pub(super) fn missing(&self, samples: usize, seed: u64) -> Option<Vec<bool>> {
        let mut missing = chosen(self.missing_share, samples, Stream::Missing.generator(seed))?;
        missing[0] = false;
        Some(missing)
    }

    /// Returns one flag per sample, which is true if the sample repeats the previous sample; `None` if
    /// `duplicated_share` is zero.
    pub(super) fn duplicated(&self, samples: usize, seed: u64) -> Option<Vec<bool>> {
        let mut duplicated = chosen(self.duplicated_share, samples, Stream::Duplicated.generator(seed))?;
        duplicated[0] = false;
        Some(duplicated)
    }
}

/// Selects each sample with the probability `share`; `None` if the share is zero. `samples` must be at least 1, because
/// the callers change the first element of the result.
fn chosen(share: f64, samples: usize, mut generator: ChaCha8Rng) -> Option<Vec<bool>> {
    (share > 0.0).then(|| (0..samples).map(|_| generator.random_bool(share)).collect())
}

/// Removes the rows of the lost samples.
pub(super) fn lose<T>(rows: &mut Vec<T>, missing: &[bool]) {
    let mut missing = missing.iter();
    rows.retain(|_| missing.next() != Some(&true));
}

/// Overwrites each flagged row by the previous row, in ascending order. Consecutive flagged rows therefore get equal
/// values.
pub(super) fn duplicate<T: Copy>(rows: &mut [T], duplicated: &[bool]) {
    for i in 1..rows.len() {
        if duplicated[i] {
            rows[i] = rows[i - 1];
        }
    }
}

/// The clock of the unit, which converts time stamps to true time.
pub(super) struct Clock {
    rate_error: f64,
    jitter_s: f64,
    generator: ChaCha8Rng,
}

impl Clock {
    pub(super) fn new(faults: &Faults, seed: u64) -> Self {
        Self {
            rate_error: faults.clock_rate_error,
            jitter_s: faults.clock_jitter_s,
            generator: Stream::Jitter.generator(seed),
        }
    }

    /// Time stamp of the clock at a true time, s.
    pub(super) fn stamp_s(&self, true_time_s: f64) -> f64 {
        true_time_s * (1.0 + self.rate_error)
    }

    /// True time, s, of the next sample, including the jitter. `stamp_s` is the time stamp of this sample.
    pub(super) fn next(&mut self, stamp_s: f64) -> f64 {
        let true_time_s = stamp_s / (1.0 + self.rate_error);
        if self.jitter_s > 0.0 {
            true_time_s + self.jitter_s * self.generator.sample::<f64, _>(StandardNormal)
        } else {
            true_time_s
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_samples_as_their_share_says() {
        let faults = Faults { missing_share: 0.02, duplicated_share: 0.05, ..Faults::none() };
        let n = 100_000;
        for (chosen, share) in [(faults.missing(n, 3), 0.02), (faults.duplicated(n, 3), 0.05)] {
            let chosen = chosen.unwrap();
            let count = chosen.iter().filter(|chosen| **chosen).count() as f64;
            let std = (n as f64 * share * (1.0 - share)).sqrt();
            assert!((count - n as f64 * share).abs() < 4.0 * std, "{count} of {n}");
            assert!(!chosen[0]);
        }
        assert!(Faults::none().missing(n, 3).is_none() && Faults::none().duplicated(n, 3).is_none());
    }

    #[test]
    fn lost_rows_go_and_repeated_rows_repeat() {
        let mut rows = vec![0, 1, 2, 3, 4];
        duplicate(&mut rows, &[false, false, true, true, false]);
        assert_eq!(rows, [0, 1, 1, 1, 4]);
        lose(&mut rows, &[false, true, false, false, true]);
        assert_eq!(rows, [0, 1, 1]);
    }

    #[test]
    fn a_fast_clock_samples_early_and_jitter_has_its_size() {
        let faults = Faults { clock_rate_error: 0.01, clock_jitter_s: 1e-4, ..Faults::none() };
        let mut clock = Clock::new(&faults, 5);
        assert_eq!(clock.stamp_s(100.0), 101.0);
        let n = 50_000;
        let late: Vec<f64> = (0..n).map(|_| clock.next(101.0) - 100.0).collect();
        let mean = late.iter().sum::<f64>() / f64::from(n);
        let std = (late.iter().map(|x| x * x).sum::<f64>() / f64::from(n)).sqrt();
        assert!(mean.abs() < 4.0 * 1e-4 / f64::from(n).sqrt());
        assert!((std / 1e-4 - 1.0).abs() < 4.0 / f64::from(2 * n).sqrt());
    }

    #[test]
    fn what_no_record_has_is_refused() {
        for faults in [
            Faults { missing_share: 1.0, ..Faults::none() },
            Faults { duplicated_share: -0.1, ..Faults::none() },
            Faults { clock_rate_error: -1.0, ..Faults::none() },
            Faults { clock_jitter_s: f64::NAN, ..Faults::none() },
        ] {
            assert!(faults.check().is_err(), "{faults:?}");
        }
    }
}
