//! Check for spikes: single samples far from both neighbours, for example due to a transmission error.

use super::part::Part;
use super::{CHANNELS, Tally, names, unit_name};
use crate::finding::{Finding, counted, general};
use crate::recording::{Recording, SIDE_BY_SIDE, each_step};

/// Maximum number of spikes in a channel. If more samples are far from their neighbours, the channel is not reported,
/// because such samples are then a property of the signal.
const MOST: usize = 64;
/// Samples of a channel are spikes only if their distances to both neighbours are at least this multiple of the
/// distance between any other two consecutive samples of the channel.
const STANDS_OUT: f64 = 10.0;
/// The neighbours of a spike agree with each other: they differ by at most this share of the height of the spike.
const AGREE: f64 = 0.1;
/// Number of the largest steps that are kept for each channel: two steps for each spike, to it and from it, and the
/// largest of all other steps.
const STEPS: usize = 2 * MOST + 1;

/// The largest steps of each channel. A step is the difference between consecutive samples.
#[derive(Default)]
pub(super) struct Spikes {
    channels: [Largest; 6],
}

/// The largest steps of one channel, each with the index of its second sample. Between two calls of
/// [`Largest::shorten`], there may be more than [`STEPS`] of them.
#[derive(Default)]
struct Largest {
    steps: Vec<(f64, usize)>,
    /// Steps up to this size are not stored, because they are not among the [`STEPS`] largest.
    floor: f64,
}

impl Largest {
    fn add(&mut self, step: f64, sample: usize) {
        self.steps.push((step, sample));
        if self.steps.len() == 4 * STEPS {
            self.shorten();
        }
    }

    /// Sorts the steps by their size, the largest first, and drops all but the [`STEPS`] largest.
    fn shorten(&mut self) {
        self.steps.sort_by(|(one, _), (other, _)| other.abs().total_cmp(&one.abs()));
        self.steps.truncate(STEPS);
        if self.steps.len() == STEPS {
            self.floor = self.steps.last().map_or(0.0, |(step, _)| step.abs());
        }
    }

    /// The samples with spikes in ascending order, the smallest step to or from a spike, and the largest of all other
    /// steps. `None` if there is no spike.
    fn spikes(&mut self) -> Option<(Vec<usize>, f64, f64)> {
        self.shorten();
        let size = |k: usize| self.steps[k].0.abs();
        let count = (1..self.steps.len()).find(|&k| size(k - 1) >= STANDS_OUT * size(k))?;
        let height = size(count - 1);
        let mut far = self.steps[..count].to_vec();
        far.sort_by_key(|(_, sample)| *sample);
        let (pairs, []) = far.as_chunks::<2>() else { return None };
        let is_spike = |[(up, first), (down, second)]: &[(f64, usize); 2]| {
            first + 1 == *second && (up + down).abs() <= AGREE * up.abs()
        };
        pairs.iter().all(is_spike).then(|| (pairs.iter().map(|pair| pair[0].1).collect(), height, size(count)))
    }
}

impl Spikes {
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let first = part.samples.start.max(1);
        for (rows, channels) in part.triads_and_before().into_iter().zip(self.channels.as_chunks_mut::<3>().0) {
            // Most blocks (`Part`) have no large step. This loop has no branches, so the compiler can vectorise it.
            let floors: [f64; SIDE_BY_SIDE] = std::array::from_fn(|k| channels[k % 3].floor);
            let mut is_large = [false; SIDE_BY_SIDE];
            each_step(rows, |k, before, after| is_large[k] |= (after - before).abs() > floors[k]);
            if is_large == [false; SIDE_BY_SIDE] {
                continue;
            }
            for (i, pair) in (first..).zip(rows.windows(2)) {
                for (axis, largest) in channels.iter_mut().enumerate() {
                    let step = pair[1][axis] - pair[0][axis];
                    if step.abs() > largest.floor && step.is_finite() {
                        largest.add(step, i);
                    }
                }
            }
        }
    }
}

/// Warns of spikes. The finding is no error, because a blow to the unit may also be visible in only one sample.
pub(super) fn check(recording: &Recording, spikes: &mut Spikes) -> Option<Finding> {
    let units = [unit_name(recording.accel_unit, "m/s^2"), unit_name(recording.gyro_unit, "rad/s")];
    let (mut samples, mut parts, mut columns) = (Vec::new(), Vec::new(), Vec::new());
    let mut highest = (0.0, "");
    for (channel, largest) in spikes.channels.iter_mut().enumerate() {
        let Some((own, height, beside)) = largest.spikes() else { continue };
        let unit = units[channel / 3];
        parts.push(format!(
            "{} of {} {} from both neighbours by {} {unit} or more, all other consecutive samples differ by at most {} {unit}",
            counted(own.len(), "sample"),
            CHANNELS[channel],
            if own.len() == 1 { "differs" } else { "differ" },
            general(height, 3),
            general(beside, 3)
        ));
        highest = if height > highest.0 { (height, unit) } else { highest };
        columns.push(CHANNELS[channel]);
        samples.extend(own);
    }
    samples.sort_unstable();
    samples.dedup();
    let mut all = Tally::default();
    samples.iter().for_each(|sample| all.add(*sample));
    (all.samples > 0).then(|| Finding {
        columns: names(columns),
        place: all.place(recording),
        count: all.samples,
        value: highest.0,
        unit: highest.1,
        message: format!("{}; the first {}", parts.join("; "), all.first_place(recording)),
        way_out: "unless something struck the unit, these samples are errors of the transmission or of the reader: \
                  leave out their rows (gaps are detected and handled)"
            .into(),
        ..Finding::warning("samples_spiked", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::finding::Severity;

    fn found(columns: &Columns) -> Option<Finding> {
        let recording = columns.recording();
        check(&recording, &mut Survey::of(&recording).spikes)
    }

    #[test]
    fn single_samples_far_from_their_neighbours_are_named() {
        for (force_step, rate_step) in [(1e-4, 1e-5), (0.06, 0.009), (1.0, 0.2)] {
            let mut columns = Columns::tumbling().quantised(force_step, rate_step);
            assert!(found(&columns).is_none(), "{force_step}");
            // 256 is the first sample of a block (`Part`), and 3000 is in the middle of a rest.
            for (i, height) in [(256, 10.0), (1234, -12.0), (3000, 10.0)] {
                columns.rate[i][2] += height;
            }
            let finding = found(&columns).unwrap();
            assert_eq!((finding.code, finding.severity), ("samples_spiked", Severity::Warning));
            assert_eq!((finding.count, &finding.columns[..]), (3, &names(["gyro_z"])[..]));
            assert_eq!(finding.place.unwrap().first_sample, 256);
            assert!(finding.value > 9.0 && finding.unit == "rad/s", "{finding}");
        }
    }

    #[test]
    fn jumps_blows_that_ring_and_vibration_are_no_spikes() {
        let mut jump = Columns::tumbling();
        jump.rate[1500..].iter_mut().for_each(|row| row[0] += 10.0);
        let mut blow = Columns::tumbling();
        for (k, height) in [30.0, -14.0, 6.0, -3.0].into_iter().enumerate() {
            blow.force[700 + k][1] += height;
        }
        let mut vibration = Columns::tumbling();
        vibration.rate.iter_mut().step_by(7).for_each(|row| row[1] += 10.0);
        for columns in [jump, blow, vibration] {
            assert!(found(&columns).is_none());
        }
    }
}
