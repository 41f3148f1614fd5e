//! Recommendations for time stamps that are not the sampling instants, for example arrival times. The recommendation
//! states the mean sampling rate, which the user can give instead of the time stamps.
//!
//! The delay of sample i is (time stamp of sample i) - i x (mean time step). Most samples are stamped late, because the
//! samples of a packet wait for the last sample of the packet, and because a busy computer reads late. In a block of
//! several packets, the sample with the smallest delay was stamped almost without waiting. From block to block, this
//! smallest delay changes in proportion to the error of the mean time step. A pause of the recording shifts all later
//! delays by the duration of the pause. The mean rate is then wrong, and so is the scale of a gyroscope that is
//! calibrated with it.

use crate::finding::{Place, counted, general};
use crate::numerics::stats::{MEDIAN_SIZE, median};
use crate::recording::Recording;

/// The mean rate is stated only if pauses make up less than this share of the duration of the recording. If pauses
/// make up this share, they can cause an equal relative error of the mean rate, and thereby of the scale of a gyroscope
/// that is calibrated with the mean rate.
const MAX_PAUSES: f64 = 2e-4;
/// Minimum number of samples in a block. With more samples, jitter of the time stamps affects the smallest delay less.
const BLOCK_SAMPLES: f64 = 64.0;
/// Minimum number of packets in a block. With more packets, late packets affect the smallest delay less.
const BLOCK_PACKETS: f64 = 8.0;
/// Minimum number of blocks. With fewer blocks, the median shift of the smallest delay from block to block may be
/// caused by a pause.
const FEWEST_BLOCKS: usize = 8;
/// A shift of the delays between two blocks is a pause if it exceeds the median shift by this number of standard
/// deviations, which are estimated from the median absolute deviation.
const SIGNIFICANT: f64 = 5.0;
/// A shift of the delays is a pause only if it exceeds this number of mean time steps. Smaller shifts occur without a
/// pause if the sampling interval is not a multiple of the clock's resolution, because some packets then have one
/// sample less than the others.
const LEAST_STEPS: f64 = 1.5;

/// Returns a text that recommends recording the sampling instants, or replacing the time stamps by the mean rate.
pub(crate) fn from_sensor(recording: &Recording) -> String {
    format!("take the time stamp from the sensor's own clock, not on arrival; or, {}", even(recording))
}

/// Returns a text that recommends replacing the time stamps by a sampling rate, if the sensor samples at equal
/// intervals. The recommended rate is the mean rate if the time stamps determine it, otherwise the rate to which the
/// sensor is set.
pub(super) fn even(recording: &Recording) -> String {
    let blocks = Blocks::try_new(recording);
    let rate_hz = blocks.as_ref().and_then(|blocks| blocks.rate_hz(recording));
    let rate = rate_hz.map_or("rate_hz=RATE with the configured rate of the sensor".to_owned(), |rate_hz| {
        format!("rate_hz={}", general(rate_hz, 5))
    });
    let pauses = blocks.filter(|_| rate_hz.is_none()).and_then(|blocks| blocks.pauses(recording)).unwrap_or_default();
    format!(
        "if the sensor samples evenly and no sample is lost, leave out the time column of a single table \
         (columns='-,accel_x_mps2,...') and pass {rate}{pauses}"
    )
}

/// Blocks of consecutive samples. Each block has so many samples and packets that jitter hardly changes its smallest
/// delay.
struct Blocks {
    /// For each block, the index of the sample with the smallest delay.
    earliest: Vec<usize>,
    /// For each block: the shift of the smallest delay from this block to the next, minus the median shift, s. It is
    /// set to zero if it is not significant.
    shifts_s: Vec<f64>,
}

impl Blocks {
    /// Divides the recording into blocks; `None` if it is too short for [`FEWEST_BLOCKS`] blocks or its time stamps do
    /// not increase.
    fn try_new(recording: &Recording) -> Option<Self> {
        let [start_s, end_s] = recording.span_s();
        let step_s = (end_s - start_s) / (recording.len() - 1) as f64;
        let packet_s = usual_long_step_s(recording.time_s);
        let size = BLOCK_SAMPLES.max((BLOCK_PACKETS * packet_s / step_s).ceil());
        if !(step_s > 0.0 && size * FEWEST_BLOCKS as f64 <= recording.len() as f64) {
            return None;
        }
        let delay_s = |i: usize| recording.time_s[i] - i as f64 * step_s;
        let size = size as usize;
        let earliest: Vec<usize> = (0..recording.len() / size)
            .filter_map(|block| (block * size..(block + 1) * size).min_by(|&i, &j| delay_s(i).total_cmp(&delay_s(j))))
            .collect();
        let mut shifts_s: Vec<f64> = earliest.windows(2).map(|pair| delay_s(pair[1]) - delay_s(pair[0])).collect();
        let usual_s = median(&mut shifts_s.clone());
        shifts_s.iter_mut().for_each(|shift_s| *shift_s -= usual_s);
        let noise_s = median(&mut shifts_s.iter().map(|shift_s| shift_s.abs()).collect::<Vec<_>>()) / MEDIAN_SIZE;
        let limit_s = (SIGNIFICANT * noise_s).max(LEAST_STEPS * step_s);
        shifts_s.iter_mut().filter(|shift_s| shift_s.abs() <= limit_s).for_each(|shift_s| *shift_s = 0.0);
        Some(Self { earliest, shifts_s })
    }

    /// Computes the mean sampling rate, Hz, from the slope of a straight line (time stamp against sample index) that is
    /// fitted to the samples with the smallest delays. `None` if the recording has pauses that are so long that the
    /// rate is inaccurate.
    fn rate_hz(&self, recording: &Recording) -> Option<f64> {
        let [start_s, end_s] = recording.span_s();
        let centre = self.earliest.iter().sum::<usize>() as f64 / self.earliest.len() as f64;
        let (mut product, mut square, mut shift_s) = (0.0, 0.0, 0.0);
        for (&i, own_s) in self.earliest.iter().zip(std::iter::once(&0.0).chain(&self.shifts_s)) {
            // A computer that is busy for several blocks increases the delays and later decreases them again. These
            // shifts are no pause and cancel in the sum.
            shift_s += own_s;
            let from_centre = i as f64 - centre;
            product += from_centre * (recording.time_s[i] - start_s - shift_s);
            square += from_centre * from_centre;
        }
        let rate_hz = square / product;
        let is_known = rate_hz.is_finite() && rate_hz > 0.0 && shift_s.abs() < MAX_PAUSES * (end_s - start_s);
        is_known.then_some(rate_hz)
    }

    /// Returns a text that states the number of pauses and the longest pause. A pause within a block can shift the
    /// smallest delay of this block and of the next one, so shifts of consecutive blocks count as one pause.
    fn pauses(&self, recording: &Recording) -> Option<String> {
        let count =
            self.shifts_s.chunk_by(|a, b| (*a > 0.0) == (*b > 0.0)).filter(|shifts_s| shifts_s[0] > 0.0).count();
        let (block, shift_s) = self.shifts_s.iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        let step_s = |i: &usize| recording.time_s[*i] - recording.time_s[i - 1];
        let after =
            (self.earliest[block] + 1..=self.earliest[block + 1]).max_by(|i, j| step_s(i).total_cmp(&step_s(j)))?;
        (count > 0).then(|| {
            format!(
                ", because the time stamps do not give it: they have at least {}, the longest of about {} s {}; samples are \
                 missing there, so cut the recording at each pause in which the unit moved",
                counted(count, "pause"),
                general(*shift_s, 2),
                Place::new(recording, after - 1, after)
            )
        })
    }
}

/// Computes the typical time step between two packets, s: the median of the time steps, each weighted by its length.
/// The time steps that are longer than this median make up about half of the duration. If the samples do not arrive in
/// packets, the result is a typical sampling interval.
fn usual_long_step_s(time_s: &[f64]) -> f64 {
    let mut steps_s: Vec<f64> =
        time_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step_s| *step_s > 0.0).collect();
    steps_s.sort_unstable_by(f64::total_cmp);
    let half_s = steps_s.iter().sum::<f64>() / 2.0;
    let mut sum_s = 0.0;
    let reaches_half = |step_s: &f64| {
        sum_s += step_s;
        sum_s >= half_s
    };
    steps_s.iter().copied().find(reaches_half).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAUSES_AT: [usize; 3] = [2850, 6900, 10050];

    /// Simulates 13000 samples with the time stamps `stamp_s(i)`, and returns the recommendation of [`even`].
    fn advice(stamp_s: impl Fn(usize) -> f64) -> String {
        let time_s: Vec<f64> = (0..13_000).map(stamp_s).collect();
        let rows = vec![[0.0; 3]; time_s.len()];
        even(&Recording::try_new("t", &time_s, &rows, &rows).unwrap())
    }

    /// Five kinds of simulated time stamps of a sensor at 100 Hz: rounded to 0.1 s, packets of 16 samples, jitter of 5
    /// ms, every 90th sample stamped 12 ms late, and packets of 10 samples that arrive up to 60 ms late.
    fn kinds() -> [fn(usize) -> f64; 5] {
        fn jitter(i: usize) -> f64 {
            (i as f64 * 12.9898).sin() * 43758.5453 % 1.0
        }
        [
            |i| (i as f64 * 0.1).floor() * 0.1,
            |i| (i / 16) as f64 * 0.16 + (i % 16) as f64 * 1e-4,
            |i| i as f64 * 0.01 + 0.005 * jitter(i),
            |i| i as f64 * 0.01 + if i % 90 == 40 { 0.012 } else { 0.0 },
            |i| (i / 10) as f64 * 0.1 + 0.06 * jitter(i / 10).abs(),
        ]
    }

    #[test]
    fn the_mean_rate_is_stated_without_pauses() {
        for (kind, stamp_s) in kinds().into_iter().enumerate() {
            let advice = advice(stamp_s);
            let rate_hz: f64 = advice.split("rate_hz=").nth(1).unwrap().parse().unwrap();
            assert!((rate_hz / 100.0 - 1.0).abs() < MAX_PAUSES, "kind {kind}: {advice}");
        }
    }

    #[test]
    fn a_clock_whose_resolution_is_no_multiple_of_the_interval_does_not_pause() {
        for rate_hz in [98.0, 99.3, 99.9, 100.05, 101.7] {
            for resolution_s in [0.01, 0.02, 0.1, 0.5] {
                let advice = advice(|i| (i as f64 / rate_hz / resolution_s).floor() * resolution_s);
                let stated_hz: f64 = advice.split("rate_hz=").nth(1).unwrap().parse().unwrap();
                assert!((stated_hz / rate_hz - 1.0).abs() < MAX_PAUSES, "{rate_hz} Hz, {resolution_s} s: {advice}");
            }
        }
    }

    #[test]
    fn pauses_are_named_instead_of_a_wrong_mean_rate() {
        for pause_s in [0.16, 0.4, 2.5] {
            for (kind, stamp_s) in kinds().into_iter().enumerate() {
                let before = |i: usize| PAUSES_AT.iter().filter(|start| i / 160 * 160 >= **start).count() as f64;
                let advice = advice(|i| stamp_s(i) + pause_s * before(i));
                assert!(advice.contains("rate_hz=RATE"), "kind {kind}, {pause_s} s: {advice}");
                assert!(
                    advice.contains("at least 3 pauses, the longest of about"),
                    "kind {kind}, {pause_s} s: {advice}"
                );
            }
        }
    }

    #[test]
    fn a_computer_that_is_busy_for_two_seconds_is_no_pause() {
        let stamp_s = |i: usize| if (4000..4200).contains(&i) { 42.0 + i as f64 * 1e-6 } else { i as f64 * 0.01 };
        assert!(advice(stamp_s).ends_with("rate_hz=100"), "{}", advice(stamp_s));
    }

    #[test]
    fn few_samples_do_not_give_a_rate() {
        let rows = [[0.0; 3]; 300];
        let time_s: Vec<f64> = (0..300).map(|i| (i / 10) as f64 * 0.1).collect();
        let recording = Recording::try_new("t", &time_s, &rows, &rows).unwrap();
        assert!(even(&recording).ends_with("rate_hz=RATE with the configured rate of the sensor"));
    }
}
