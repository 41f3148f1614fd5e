//! Check for negative counts that were read as unsigned numbers. A count n < 0 is then stored as 2^bits + n.
//!
//! With this fault, a channel that crosses zero jumps between the two ends of the number range, which resembles
//! saturation. A sensor whose counts are really unsigned reads near the middle of the range at rest. If the upper half
//! of its range were read as negative numbers, there would be jumps at the middle. Therefore the jumps are counted
//! twice, once with the counts read as unsigned numbers and once as signed numbers, and the two totals are compared.

use pulp::{Simd, WithSimd};

use super::survey::Survey;
use super::{ACCEL, GYRO, Tally, names};
use crate::finding::Finding;
use crate::numerics::instructions::Instructions;
use crate::recording::{RawUnit, Recording, SIDE_BY_SIDE, Samples, each_step};

/// Possible word lengths of converters and registers, bits.
const BITS: std::ops::RangeInclusive<u32> = 8..=32;
/// A jump is a change from one end of the number range to the other between consecutive samples. Each end is a region
/// whose width is this share of the range.
const END: f64 = 0.125;
/// A finding is reported only for at least this number of jumps. Fewer jumps may be single wrong samples.
const FEWEST_JUMPS: u64 = 3;
/// A finding is reported only if (jumps of the counts read as unsigned numbers) / (jumps of the same counts read as
/// signed numbers) is at least this value.
const LEFT: u64 = 10;
/// Number of samples that are processed together. This number of samples fits into the processor's cache.
const PART: usize = 256;

/// Runs only the check for the finding `counts_unsigned`. No other check is needed for data that are corrected but not
/// used for a calibration. All columns must have the same length.
pub fn check_counts(recording: &Recording) -> Vec<Finding> {
    let is_raw = [recording.accel_unit, recording.gyro_unit].contains(&RawUnit::Lsb);
    if is_raw && !recording.is_empty() { check(recording, &Survey::of(recording)) } else { Vec::new() }
}

/// Reports `counts_unsigned` for sensors whose negative counts were read as unsigned numbers.
pub(super) fn check(recording: &Recording, survey: &Survey) -> Vec<Finding> {
    let [accel, gyro] = &survey.extremes.ends;
    let accel = finding(recording, recording.accel_unit, (recording.specific_force, accel), ACCEL);
    let gyro = finding(recording, recording.gyro_unit, (recording.angular_rate, gyro), GYRO);
    accel.into_iter().chain(gyro).collect()
}

fn finding(
    recording: &Recording,
    unit: RawUnit,
    (rows, ends): (Samples<'_>, &[[f64; 2]; 3]),
    axes: [&str; 3],
) -> Option<Finding> {
    let low = ends.iter().map(|e| e[0]).fold(f64::INFINITY, f64::min);
    let high = ends.iter().map(|e| e[1]).fold(f64::NEG_INFINITY, f64::max);
    if unit != RawUnit::Lsb || low < 0.0 {
        return None;
    }
    let numbers = BITS.map(|bits| 2f64.powi(bits as i32)).find(|numbers| high < *numbers)?;
    let crosses = |axis: usize| ends[axis][0] < END * numbers && ends[axis][1] > (1.0 - END) * numbers;
    if !(0..3).any(crosses) {
        return None;
    }
    let jumps = Instructions::Best.run(Jumps { rows, numbers });
    let at_zero = |axis: &usize| jumps[*axis][0] >= FEWEST_JUMPS && LEFT * jumps[*axis][1] <= jumps[*axis][0];
    let jumping: Vec<usize> = (0..3).filter(|axis| crosses(*axis)).filter(at_zero).collect();
    if jumping.is_empty() {
        return None;
    }
    let mut all = Tally::default();
    for i in 1..rows.len() {
        let (before, after) = (rows.at(i - 1), rows.at(i));
        if jumping.iter().any(|&axis| is_jump(before[axis], after[axis], numbers)) {
            all.add(i);
        }
    }
    let columns = names(jumping.iter().map(|&axis| axes[axis]));
    let (half, last) = (numbers / 2.0, numbers - 1.0);
    Some(Finding {
        place: all.place(recording),
        count: all.samples,
        value: numbers,
        unit: "lsb",
        message: format!(
            "the counts were read as unsigned numbers: {} jump between the ends of the range 0 to {last} in {} samples, \
             first {}",
            columns.join(", "),
            all.samples,
            all.first_place(recording)
        ),
        way_out: format!(
            "subtract {numbers} from values above {} in all three columns, or read the registers as signed numbers",
            half - 1.0
        ),
        columns,
        ..Finding::error("counts_unsigned", recording.name)
    })
}

fn is_jump(before: f64, after: f64, numbers: f64) -> bool {
    before.min(after) < END * numbers && before.max(after) > (1.0 - END) * numbers
}

/// Counts the jumps of each channel of a triad, read as unsigned numbers and as signed numbers. The crate `pulp` runs
/// this count with the widest vector instructions of the processor.
struct Jumps<'a> {
    rows: Samples<'a>,
    numbers: f64,
}

impl WithSimd for Jumps<'_> {
    type Output = [[u64; 2]; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { rows, numbers } = self;
        let signed = |v: f64| if v < numbers / 2.0 { v } else { v - numbers };
        let (mut jumps, mut left) = ([0; SIDE_BY_SIDE], [0; SIDE_BY_SIDE]);
        let mut count = |k: usize, before: f64, after: f64| {
            jumps[k] += u64::from(is_jump(before, after, numbers));
            left[k] += u64::from((signed(after) - signed(before)).abs() > (1.0 - 2.0 * END) * numbers);
        };
        for start in (1..rows.len()).step_by(PART) {
            each_step(&rows.part(start - 1..(start + PART).min(rows.len())), &mut count);
        }
        let of_axis = |counts: &[u64; SIDE_BY_SIDE], axis: usize| counts.iter().skip(axis).step_by(3).sum();
        [0, 1, 2].map(|axis| [of_axis(&jumps, axis), of_axis(&left, axis)])
    }
}

#[cfg(test)]
mod tests {
    use super::super::check_columns;
    use super::super::example::Columns;
    use super::*;

    /// The synthetic recording [`Columns::tumbling`] with unsigned gyroscope counts. The count `zero` corresponds to
    /// zero rate, and the counts wrap around after `numbers` values.
    fn unsigned(zero: f64, numbers: f64) -> Columns {
        let mut columns = Columns::tumbling();
        let scale = numbers / 8.0;
        columns.rate.iter_mut().for_each(|row| *row = row.map(|v| ((v * scale).round() + zero).rem_euclid(numbers)));
        columns
    }

    fn found(columns: &Columns) -> Vec<Finding> {
        check_columns(&Recording { gyro_unit: RawUnit::Lsb, ..columns.recording() })
    }

    #[test]
    fn negative_counts_without_their_sign_are_no_saturation() {
        for (bits, way_out) in [(16, "subtract 65536 from values above 32767"), (12, "subtract 4096")] {
            let columns = unsigned(0.0, 2f64.powi(bits));
            let findings = found(&columns);
            assert_eq!(check_counts(&Recording { gyro_unit: RawUnit::Lsb, ..columns.recording() }).len(), 1);
            assert!(check_counts(&columns.recording()).is_empty());
            assert_eq!(findings.len(), 1, "{findings:?}");
            assert_eq!(findings[0].code, "counts_unsigned");
            assert_eq!(findings[0].columns, GYRO);
            assert!(findings[0].way_out.starts_with(way_out), "{}", findings[0].way_out);
        }
    }

    #[test]
    fn counts_with_zero_in_the_middle_are_sound_up_to_their_rails() {
        let columns = unsigned(32768.0, 65536.0);
        assert!(found(&columns).is_empty());
        // The unit is shaken from one rail to the other, so consecutive samples are at both ends of the range.
        let mut columns = columns;
        for i in (100..3900).step_by(40) {
            columns.rate[i][0] = 0.0;
            columns.rate[i + 1][0] = 65535.0;
        }
        let codes: Vec<&str> = found(&columns).iter().map(|finding| finding.code).collect();
        assert_eq!(codes, ["gyro_saturation"]);
    }
}
