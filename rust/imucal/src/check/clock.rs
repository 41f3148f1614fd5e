//! Checks of the time column: length, order, gaps, regularity and unit.

use super::part::Part;
use super::{Tally, bursts, gaps, names, stamps};
use crate::finding::{Finding, Place, general};
use crate::numerics::stats::{quantile_of, steps_s};
use crate::recording::Recording;

/// Minimum number of samples in a recording. With fewer samples, a recording cannot contain rests, moves and a
/// measurable noise level.
const MIN_SAMPLES: usize = 200;
/// Minimum duration of a recording, s. Two rests and a move need this time.
const MIN_DURATION_S: f64 = 5.0;
/// Plausible sampling rates of inertial sensors, Hz. Outside this range, the unit of time is wrong, or the rate is too
/// low to integrate moves.
const RATES_HZ: [f64; 2] = [5.0, 50_000.0];
/// Relative tolerance of [`RATES_HZ`]. Rounded time stamps give inexact time steps, so a tolerance is needed.
const ROUNDING: f64 = 1e-6;
/// Limits of the relative spread of the time steps: (standard deviation) / (median). The standard deviation is computed
/// from the 10 % and 90 % quantiles. Above the first limit, the finding `clock_irregular` is a warning. Above the
/// second limit, it is an error.
const SPREAD: [f64; 2] = [0.2, 0.5];
/// A clock counts as regular if |time step / median - 1| is at most this value for all time steps. For a regular clock,
/// the checks of spread and gaps are skipped, because they cannot find a fault and take more time.
const REGULAR: f64 = 0.2;
/// If more than this share of the samples repeats the time stamp of the previous sample, the finding
/// `samples_duplicated` is an error, otherwise a warning.
const MAX_EQUAL_SHARE: f64 = 0.01;

/// Statistics of the time steps of a recording. A time step is the difference between two consecutive time stamps.
/// Steps that are not finite are ignored.
pub(super) struct Steps {
    /// Number of positive time steps.
    positive: usize,
    /// Shortest positive time step, s.
    shortest_s: f64,
    /// Longest positive time step, s.
    longest_s: f64,
    backward: Tally,
    worst_backward_s: f64,
    /// Counter of the samples that have the same time stamp as the previous sample, but other values.
    equal: Tally,
    /// Counter of the samples that equal the previous sample in the time stamp and in all values.
    copied: Tally,
}

pub(super) fn check(recording: &Recording, steps: &Steps) -> Vec<Finding> {
    let mut findings = Vec::new();
    findings.extend(too_short(recording));
    findings.extend(steps.not_increasing(recording));
    if let Some(bursts) = steps.backward.first.is_none().then(|| steps.bursts(recording)).flatten() {
        // If all samples of a packet have nearly the same time stamp, the stamps do not show whether samples were
        // repeated or lost, and their median step is not the sampling interval. The checks for these faults are
        // skipped.
        findings.push(bursts);
        return findings;
    }
    findings.extend(steps.copies(recording));
    findings.extend(steps.equal_stamps(recording));
    if steps.positive < 2 {
        return findings;
    }
    let forward_s = |k: usize, to: &mut [f64]| {
        steps_s(&recording.time_s[k..], to);
        to.iter_mut().for_each(|step_s| *step_s = if *step_s > 0.0 && step_s.is_finite() { *step_s } else { f64::NAN });
    };
    let of_steps = |q: f64| quantile_of(recording.len() - 1, forward_s, q);
    let median_s = of_steps(0.5);
    let regular_s = (1.0 - REGULAR) * median_s..=(1.0 + REGULAR) * median_s;
    if regular_s.contains(&steps.shortest_s) && regular_s.contains(&steps.longest_s) {
        findings.extend(rate(recording, median_s));
        return findings;
    }
    let (low_s, high_s) = (of_steps(0.1), of_steps(0.9));
    findings.extend(rate(recording, median_s));

    // 80 % of a normal distribution are within +-1.2816 standard deviations. The median absolute deviation is not used,
    // because it is zero if most steps are equal, for example if all samples of a packet have equal time stamps.
    let spread = (high_s - low_s) / (2.0 * 1.2816) / median_s;
    // Gaps are searched for only if the relative spread of the time steps is at most the second limit of [`SPREAD`].
    // With a larger spread, the clock is so irregular that long time steps are no evidence of lost samples.
    let gaps = if spread <= SPREAD[1] {
        // A clock with coarse resolution has alternating steps, for example of 2 ms and 3 ms, which are not gaps. A gap
        // must therefore be longer than the 90 % quantile of the steps plus half a median step.
        let longest_usual_s = (1.5 * median_s).max(high_s + 0.5 * median_s);
        gaps::find(recording, median_s, longest_usual_s * (1.0 + 1e-6))
    } else {
        gaps::Gaps::default()
    };
    if spread > SPREAD[0] {
        findings.push(irregular(recording, spread, [low_s, median_s, high_s]));
    } else {
        findings.extend(gaps.late(recording));
    }
    findings.extend(gaps.missing(recording));
    findings
}

impl Default for Steps {
    fn default() -> Self {
        Self {
            positive: 0,
            shortest_s: f64::INFINITY,
            longest_s: 0.0,
            backward: Tally::default(),
            worst_backward_s: 0.0,
            equal: Tally::default(),
            copied: Tally::default(),
        }
    }
}

impl Steps {
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let first = part.samples.start.max(1);
        let time_s = &part.recording.time_s[first - 1..part.samples.end];
        // Fast path for the usual case, in which all time steps are positive.
        let [shortest_s, longest_s] = shortest_and_longest_s(time_s);
        if shortest_s > 0.0 && longest_s.is_finite() {
            self.positive += time_s.len() - 1;
            self.shortest_s = self.shortest_s.min(shortest_s);
            self.longest_s = self.longest_s.max(longest_s);
            return;
        }
        for ((i, equal), pair) in part.equal().zip(time_s.windows(2)) {
            let step_s = pair[1] - pair[0];
            if step_s > 0.0 && step_s.is_finite() {
                self.positive += 1;
                self.shortest_s = if step_s < self.shortest_s { step_s } else { self.shortest_s };
                self.longest_s = if step_s > self.longest_s { step_s } else { self.longest_s };
            } else if step_s == 0.0 && equal == part.all_equal {
                self.copied.add(i);
            } else if step_s == 0.0 {
                self.equal.add(i);
            } else if step_s < 0.0 && step_s.is_finite() {
                self.backward.add(i);
                self.worst_backward_s = self.worst_backward_s.min(step_s);
            }
        }
    }

    /// Index of the first sample whose time stamp is earlier than that of the previous sample.
    #[cfg(test)]
    pub(super) fn first_backward(&self) -> Option<usize> {
        self.backward.first.map(|(first, _)| first)
    }

    fn not_increasing(&self, recording: &Recording) -> Option<Finding> {
        let (first, _) = self.backward.first?;
        let often = if self.backward.samples == 1 { "once".into() } else { format!("{} times", self.backward.samples) };
        Some(Finding {
            columns: names(["time_s"]),
            place: Some(Place::new(recording, first - 1, first)),
            count: self.backward.samples,
            value: self.worst_backward_s,
            unit: "s",
            message: format!(
                "time goes back {often}, by at most {:.4} s; the first time from {:.4} s to {:.4} s (sample {first})",
                -self.worst_backward_s,
                recording.time_s[first - 1],
                recording.time_s[first]
            ),
            way_out:
                "cut the recording there, sort its rows if they were shuffled, unwrap the counter if it overflowed, or \
                 remove lines that lost characters"
                    .into(),
            ..Finding::error("time_not_increasing", recording.name)
        })
    }

    /// Reports time stamps of packets instead of samples. The search for packets is skipped if the longest time step is
    /// at most twice the shortest and no two different samples have equal stamps.
    fn bursts(&self, recording: &Recording) -> Option<Finding> {
        (self.equal.samples > 0 || self.longest_s > 2.0 * self.shortest_s).then(|| bursts::check(recording)).flatten()
    }

    /// Reports rows that equal the previous row in the time stamp and in all values, because they were written twice.
    fn copies(&self, recording: &Recording) -> Option<Finding> {
        Some(Finding {
            message: format!(
                "{} rows ({:.2} %) have the time stamp and all values of the row before, the first {}",
                self.copied.samples,
                share(&self.copied, recording),
                self.copied.first_place(recording)
            ),
            way_out: "drop the rows that were written twice".into(),
            ..duplicated(&self.copied, recording)?
        })
    }

    /// Reports samples that have the time stamp of the previous sample, but other values.
    fn equal_stamps(&self, recording: &Recording) -> Option<Finding> {
        let finding = duplicated(&self.equal, recording)?;
        Some(Finding {
            message: format!(
                "{} samples ({:.2} %) have the time stamp of the sample before but other values, the first {}",
                self.equal.samples,
                share(&self.equal, recording),
                self.equal.first_place(recording)
            ),
            way_out: format!("write time stamps of finer resolution; or, {}", stamps::even(recording)),
            ..finding
        })
    }
}

/// Share of the samples of the recording that `tally` has counted as faulty, %.
fn share(tally: &Tally, recording: &Recording) -> f64 {
    100.0 * tally.samples as f64 / recording.len() as f64
}

/// Creates the finding for samples with the time stamp of the previous sample. The caller fills in the message and the
/// recommendation.
fn duplicated(tally: &Tally, recording: &Recording) -> Option<Finding> {
    let (first, _) = tally.first?;
    let share = share(tally, recording);
    let kind = if share > 100.0 * MAX_EQUAL_SHARE { Finding::error } else { Finding::warning };
    Some(Finding {
        columns: names(["time_s"]),
        place: Some(Place::new(recording, first - 1, first)),
        count: tally.samples,
        value: share,
        unit: "%",
        ..kind("samples_duplicated", recording.name)
    })
}

/// Shortest and longest time step, s; NaN if any time step is NaN. Eight steps are compared at once, so that the
/// compiler can use vector instructions.
#[inline(always)]
fn shortest_and_longest_s(time_s: &[f64]) -> [f64; 2] {
    const LANES: usize = 8;
    let (mut shortest_s, mut longest_s, mut sum) = ([f64::INFINITY; LANES], [0.0; LANES], [0.0; LANES]);
    let mut take = |lane: usize, step_s: f64| {
        shortest_s[lane] = if step_s < shortest_s[lane] { step_s } else { shortest_s[lane] };
        longest_s[lane] = if step_s > longest_s[lane] { step_s } else { longest_s[lane] };
        sum[lane] += step_s;
    };
    let (before, after) = (&time_s[..time_s.len() - 1], &time_s[1..]);
    let (fulls, others) = before.as_chunks::<LANES>();
    let (next_fulls, next_others) = after.as_chunks::<LANES>();
    for (before, after) in fulls.iter().zip(next_fulls) {
        (0..LANES).for_each(|lane| take(lane, after[lane] - before[lane]));
    }
    for (before, after) in others.iter().zip(next_others) {
        take(0, after - before);
    }
    if sum.iter().any(|sum| sum.is_nan()) {
        return [f64::NAN; 2];
    }
    [shortest_s.into_iter().fold(f64::INFINITY, f64::min), longest_s.into_iter().fold(0.0, f64::max)]
}

fn too_short(recording: &Recording) -> Option<Finding> {
    let time_s = recording.time_s;
    let duration_s = match (time_s.first(), time_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => return None,
    };
    // If the duration is NaN, zero or negative, other findings report this fault, and the recording is too short only
    // if it has too few samples.
    if recording.len() >= MIN_SAMPLES && (duration_s >= MIN_DURATION_S || duration_s.is_nan() || duration_s <= 0.0) {
        return None;
    }
    Some(Finding {
        place: Some(Place::new(recording, 0, recording.len() - 1)),
        count: recording.len(),
        value: duration_s,
        unit: "s",
        message: format!(
            "{} samples in {duration_s:.2} s; a recording needs at least {MIN_SAMPLES} samples and {MIN_DURATION_S:.0} s",
            recording.len()
        ),
        way_out: "record at least nine rests of a second or more in different poses, with moves between them".into(),
        ..Finding::error("too_short", recording.name)
    })
}

fn rate(recording: &Recording, median_s: f64) -> Option<Finding> {
    let plausible =
        |step_s: f64| (RATES_HZ[0] * (1.0 - ROUNDING)..=RATES_HZ[1] * (1.0 + ROUNDING)).contains(&(1.0 / step_s));
    if plausible(median_s) {
        return None;
    }
    let guess = [("time_ms", 1e-3), ("time_us", 1e-6), ("time_ns", 1e-9)]
        .into_iter()
        .find(|(_, unit_s)| plausible(median_s * unit_s));
    let way_out = match guess {
        Some((name, _)) => format!(
            "if the column is in another unit, give the unit in its name: {name}; if it is in seconds, record at {:.0} Hz or more",
            RATES_HZ[0]
        ),
        None if plausible(median_s * 1e3) => {
            "the step is 1000 times too short: if the column is in seconds, name it time_s".into()
        }
        None => "name the time column after its unit: time_s, time_ms, time_us or time_ns".into(),
    };
    Some(Finding {
        columns: names(["time_s"]),
        count: recording.len(),
        value: 1.0 / median_s,
        unit: "Hz",
        message: format!(
            "the median time step is {} s, a rate of {} Hz; rates from {:.0} Hz to {:.0} Hz are plausible",
            general(median_s, 4),
            general(1.0 / median_s, 4),
            RATES_HZ[0],
            RATES_HZ[1]
        ),
        way_out,
        ..Finding::error("clock_rate", recording.name)
    })
}

fn irregular(recording: &Recording, spread: f64, [low_s, median_s, high_s]: [f64; 3]) -> Finding {
    let kind = if spread > SPREAD[1] { Finding::error } else { Finding::warning };
    Finding {
        columns: names(["time_s"]),
        count: recording.len(),
        value: 100.0 * spread,
        unit: "%",
        message: format!(
            "the time steps spread by {:.0} % (standard deviation over the median of {:.3} ms): 10 % are below {:.3} ms, 10 % above {:.3} ms",
            100.0 * spread,
            1e3 * median_s,
            1e3 * low_s,
            1e3 * high_s
        ),
        way_out: stamps::from_sensor(recording),
        ..kind("clock_irregular", recording.name)
    }
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::finding::Severity;

    fn found(recording: &Recording) -> Vec<Finding> {
        check(recording, &Survey::of(recording).steps)
    }

    fn codes(time_s: &[f64]) -> Vec<(&'static str, Severity)> {
        let rows = vec![[0.0; 3]; time_s.len()];
        let recording = Recording::try_new("t", time_s, &rows, &rows).unwrap();
        found(&recording).iter().map(|f| (f.code, f.severity)).collect()
    }

    #[test]
    fn jitter_of_a_good_clock_is_not_flagged() {
        // Time steps of 9.0 to 10.4 ms, as from a real unit at 100 Hz.
        let mut now = 100.0;
        let time: Vec<f64> = (0..2000)
            .map(|i| {
                now += 0.0097 + 0.0007 * (i as f64 * 1.7).sin();
                now
            })
            .collect();
        assert!(codes(&time).is_empty(), "{:?}", codes(&time));
    }

    #[test]
    fn whole_milliseconds_at_400_hz_are_no_gaps() {
        let time: Vec<f64> = (0..4000).map(|i| (2.5 * i as f64).floor() * 1e-3).collect();
        assert!(codes(&time).is_empty(), "{:?}", codes(&time));
    }

    #[test]
    fn time_that_goes_back_is_an_error_with_its_place() {
        let mut columns = Columns::tumbling();
        columns.time_s[1000] = 9.0;
        columns.time_s[1001] = 9.0;
        let findings = found(&columns.recording());
        let back = findings.iter().find(|f| f.code == "time_not_increasing").unwrap();
        assert_eq!(back.severity, Severity::Error);
        assert_eq!(back.place.unwrap().last_sample, 1000);
        assert!((back.value + 0.99).abs() < 1e-9);
        let equal = findings.iter().find(|f| f.code == "samples_duplicated").unwrap();
        assert_eq!((equal.count, equal.severity), (1, Severity::Warning));
    }

    #[test]
    fn copies_and_two_samples_to_one_stamp_have_different_ways_out() {
        let mut columns = Columns::tumbling();
        columns.time_s = (0..4000).map(|i| (i / 2) as f64 * 0.01).collect();
        let [stamps] = <[Finding; 1]>::try_from(found(&columns.recording())).unwrap();
        assert_eq!((stamps.code, stamps.severity), ("samples_duplicated", Severity::Error));
        assert!(stamps.way_out.contains("rate_hz=200"), "{}", stamps.way_out);
        for i in (1..4000).step_by(2) {
            (columns.force[i], columns.rate[i]) = (columns.force[i - 1], columns.rate[i - 1]);
        }
        let [copies] = <[Finding; 1]>::try_from(found(&columns.recording())).unwrap();
        assert_eq!((copies.code, copies.count), ("samples_duplicated", 2000));
        assert!(copies.way_out.contains("drop the rows") && !copies.way_out.contains("rate_hz"), "{}", copies.way_out);
    }

    #[test]
    fn the_rate_in_the_recommendation_is_the_mean_rate() {
        // In each period, seven steps are 11.25 ms, one is 0.5 ms and one is 10.75 ms. The median step is 11.25 ms, and
        // the mean is 10 ms.
        let within_s = |k: usize| if k < 8 { 0.01125 * k as f64 } else { 0.07925 };
        let time: Vec<f64> = (0..3000).map(|i| (i / 9) as f64 * 0.09 + within_s(i % 9)).collect();
        let rows = vec![[0.0; 3]; time.len()];
        let findings = found(&Recording::try_new("t", &time, &rows, &rows).unwrap());
        let irregular = findings.iter().find(|f| f.code == "clock_irregular").unwrap();
        let rate_hz = irregular.way_out.split("rate_hz=").nth(1).unwrap();
        assert!((rate_hz.parse::<f64>().unwrap() - 100.0).abs() < 0.01, "{rate_hz}");
    }

    #[test]
    fn stamps_on_arrival_are_irregular() {
        let bursts: Vec<f64> = (0..2000).map(|i| (i / 4) as f64 * 0.04 + (i % 4) as f64 * 1e-4).collect();
        assert_eq!(codes(&bursts), [("clock_irregular", Severity::Error)]);
        let jitter: Vec<f64> = (0..2000).map(|i| 0.01 * (i as f64 + 0.3 * (i as f64 * 2.3).sin())).collect();
        assert_eq!(codes(&jitter), [("clock_irregular", Severity::Warning)]);
    }

    #[test]
    fn milliseconds_called_seconds_are_named() {
        let time: Vec<f64> = (0..2000).map(|i| 10.0 * i as f64).collect();
        let rows = vec![[0.0; 3]; time.len()];
        let findings = found(&Recording::try_new("t", &time, &rows, &rows).unwrap());
        assert_eq!(findings[0].code, "clock_rate");
        assert!(findings[0].way_out.contains("time_ms"));
        let slow: Vec<f64> = (0..2000).map(|i| 0.04 * i as f64).collect();
        assert!(codes(&slow).is_empty());
    }

    #[test]
    fn five_seconds_are_enough() {
        let time = |n: usize| -> Vec<f64> { (0..n).map(|i| i as f64 * 0.01).collect() };
        assert_eq!(codes(&time(400)), [("too_short", Severity::Error)]);
        assert!(codes(&time(502)).is_empty());
    }
}
