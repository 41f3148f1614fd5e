//! Check for saturation, in which a channel is clipped at the end of its range while the unit still moves.

use std::ops::Range;

use super::plateau::{equal_neighbours, piles_up, plateaus};
use super::survey::Survey;
use super::values::converter_step;
use super::{ACCEL, GYRO, Tally, names, unit_name};
use crate::finding::{Finding, counted};
use crate::numerics::stats::quantile;
use crate::recording::{RawUnit, Recording, Samples};

/// A rail is the value at which an axis is clipped. The lowest or highest value of an axis can be a rail only if its
/// distance from the zero reading is at least this share of the largest such distance among the three axes. The axes of
/// a triad have the same range, so their rails differ only by the scales of the axes.
const SHARE_OF_REACH: f64 = 0.8;

/// Lowest rail (value at which an axis is clipped) of an accelerometer that may have no noise at rest, as a multiple of
/// the median norm of the specific force, which is 1 g. Below this value, a plateau may be a rest without noise.
const LOWEST_RAIL_G: f64 = 1.3;
/// If at most this share of the pairs of consecutive samples of an axis are equal, the noise of the axis is several
/// steps of the converter. A plateau of this axis cannot be a rest without noise, so the limit [`LOWEST_RAIL_G`] does
/// not apply to it. Pairs that begin at an extreme value are not counted.
const FEW_EQUAL: f64 = 0.1;
/// Two rails belong to one measurement range if the relative difference of their distances from the zero reading is
/// below this value.
const ONE_RANGE: f64 = 1e-4;

/// The lowest and the highest value of one axis. Each of them is `None` if the axis is not clipped at this value.
type Rails = [Option<f64>; 2];

/// Reports `accel_saturation` and `gyro_saturation` for sensors with at least one clipped axis.
pub(super) fn check(recording: &Recording, survey: &Survey) -> Vec<Finding> {
    let [accel, gyro] = rails(recording, survey);
    let accel = finding(
        recording,
        (recording.specific_force, &accel),
        unit_name(recording.accel_unit, "m/s^2"),
        ("accel_saturation", ACCEL),
    );
    let gyro = finding(
        recording,
        (recording.angular_rate, &gyro),
        unit_name(recording.gyro_unit, "rad/s"),
        ("gyro_saturation", GYRO),
    );
    accel.into_iter().chain(gyro).collect()
}

/// The samples at which any axis is saturated, as disjoint index ranges in ascending order.
///
/// Rests and moves with such samples must not be used. All other rests and moves can be used.
pub fn saturated_samples(recording: &Recording) -> Vec<Range<usize>> {
    if recording.check_lengths().is_err() {
        return Vec::new();
    }
    let [accel, gyro] = rails(recording, &Survey::of(recording));
    let mut stretches: Vec<Range<usize>> = Vec::new();
    for i in 0..recording.len() {
        if !at_rail(&recording.specific_force.at(i), &accel) && !at_rail(&recording.angular_rate.at(i), &gyro) {
            continue;
        }
        match stretches.last_mut() {
            Some(last) if last.end == i => last.end = i + 1,
            _ => stretches.push(i..i + 1),
        }
    }
    stretches
}

fn at_rail(row: &[f64; 3], rails: &[Rails; 3]) -> bool {
    row.iter().zip(rails).any(|(v, ends)| ends.contains(&Some(*v)))
}

fn rails(recording: &Recording, survey: &Survey) -> [[Rails; 3]; 2] {
    let triad = |triad: usize, rows, unit, lowest_over_median| {
        let (ends, held) = (&survey.extremes.ends[triad], survey.runs.held(triad));
        triad_rails(rows, unit, lowest_over_median, (ends, &held))
    };
    [
        triad(0, recording.specific_force, recording.accel_unit, LOWEST_RAIL_G),
        triad(1, recording.angular_rate, recording.gyro_unit, 0.0),
    ]
}

fn finding(
    recording: &Recording,
    (rows, rails): (Samples<'_>, &[Rails; 3]),
    unit: &'static str,
    (code, axes): (&'static str, [&str; 3]),
) -> Option<Finding> {
    rails.iter().flatten().flatten().next()?;
    let (mut columns, mut parts, mut value) = (Vec::new(), Vec::new(), 0.0f64);
    for axis in 0..3 {
        for rail in rails[axis].into_iter().flatten() {
            let mut held = Tally::default();
            for (i, row) in rows.iter().enumerate() {
                if row[axis] == rail {
                    held.add(i);
                }
            }
            if !columns.contains(&axes[axis]) {
                columns.push(axes[axis]);
            }
            parts.push(format!(
                "{} holds its extreme value {} {unit} for {} in {}, first {}",
                axes[axis],
                if unit == "lsb" { rail.to_string() } else { format!("{rail:.5}") },
                counted(held.samples, "sample"),
                counted(held.runs, "interval"),
                held.first_place(recording)
            ));
            value = value.max(rail.abs());
        }
    }
    let mut any = Tally::default();
    for (i, row) in rows.iter().enumerate() {
        if at_rail(&row, rails) {
            any.add(i);
        }
    }
    (any.samples > 0).then(|| Finding {
        columns: names(columns),
        place: any.place(recording),
        count: any.samples,
        value,
        unit,
        message: parts.join("; "),
        way_out:
            "use a larger range or move more slowly; to leave out these moves, calibrate with exclude_saturated=True"
                .into(),
        ..Finding::error(code, recording.name)
    })
}

/// Finds the rails (values at which an axis is clipped) that each axis of a sensor reaches.
///
/// There are two kinds of evidence for a rail:
///
/// * One sample at the lowest or the highest count of a 16-bit converter.
/// * Plateaus (sequences of equal samples) at the channel's extreme value. A plateau is evidence if the channel changes
///   by several steps just before and after it, while another axis moves. In addition, plateaus at other values of the
///   channel must be rare or short, and noise must be an unlikely cause of the plateaus. The rail must be at least
///   `lowest_over_median` times the median norm of the rows, unless the noise of the axis is several steps of the
///   converter.
///
/// A sample at the end of a shorter number range, such as 2048 or 16384 counts, is no evidence of a rail, because
/// common accelerometers read these counts at 1 g. For each axis, `ends` contains the lowest and the highest of all
/// values. `held` contains the lowest and the highest of the values that the axis repeats in at least three
/// consecutive samples.
fn triad_rails(
    rows: Samples<'_>,
    unit: RawUnit,
    lowest_over_median: f64,
    (ends, held): (&[[f64; 2]; 3], &[[f64; 2]; 3]),
) -> [Rails; 3] {
    let low = ends.iter().map(|e| e[0]).fold(f64::INFINITY, f64::min);
    let high = ends.iter().map(|e| e[1]).fold(f64::NEG_INFINITY, f64::max);
    let signed = low < 0.0;
    // The zero reading of unsigned counts is near the middle of their range.
    let zero = if signed || unit == RawUnit::Si { 0.0 } else { 0.5 * (low + high) };
    let is_16_bit_end = |v: f64| {
        unit == RawUnit::Lsb
            && if signed {
                v.abs() == 32768.0 || v.abs() == 32767.0
            } else {
                high > 32768.0 && (v == 0.0 || v == 65535.0)
            }
    };
    // Fast path for most recordings: if no axis repeats an extreme value in consecutive samples or reaches an end of
    // the 16-bit range, there is no rail, and no further passes over the samples are needed.
    let stays_at_end = ends.iter().zip(held).any(|(ends, held)| ends[0] == held[0] || ends[1] == held[1]);
    if !ends.iter().flatten().any(|&end| is_16_bit_end(end)) && !stays_at_end {
        return [[None; 2]; 3];
    }
    let reach = (low - zero).abs().max((high - zero).abs());
    let mut norms: Vec<f64> = rows
        .iter()
        .map(|row| row.iter().map(|v| (v - zero).powi(2)).sum::<f64>().sqrt())
        .filter(|norm| norm.is_finite())
        .collect();
    let lowest_rail = lowest_over_median * quantile(&mut norms, 0.5);
    let steps = [0, 1, 2].map(|axis| converter_step(rows, axis));
    let mut rails: [Rails; 3] = [0, 1, 2].map(|axis| {
        let [low, high] = ends[axis];
        // A constant channel is reported as stuck, not as saturated.
        if low >= high {
            return [None; 2];
        }
        let plateaus = plateaus(rows, axis, ends, &steps);
        let equal = equal_neighbours(rows, axis, &ends[axis]);
        [0, 1].map(|side| {
            let end = ends[axis][side];
            let distance = (end - zero).abs();
            let cut_off = distance >= SHARE_OF_REACH * reach
                && (distance >= lowest_rail || equal <= FEW_EQUAL)
                && plateaus.at_end[side].stand_out_from(&plateaus.elsewhere)
                && piles_up(rows, axis, end, steps[axis])
                && !plateaus.at_end[side].is_chance(equal);
            (is_16_bit_end(end) || cut_off).then_some(end)
        })
    });
    // If one rail of the triad is known, all other channels that reach this value are also clipped. The counts +32767
    // and -32768 are treated as one rail.
    if let Some(rail) = rails.iter().flatten().flatten().map(|v| (v - zero).abs()).reduce(f64::max) {
        for axis in 0..3 {
            for side in 0..2 {
                let end = ends[axis][side];
                if ((end - zero).abs() / rail - 1.0).abs() < ONE_RANGE {
                    rails[axis][side] = Some(end);
                }
            }
        }
    }
    rails
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;

    fn found(recording: &Recording) -> Vec<Finding> {
        check(recording, &Survey::of(recording))
    }

    fn clip(columns: &mut Columns, axis: usize, limit: f64) -> usize {
        let mut cut = 0;
        for row in &mut columns.rate {
            if row[axis].abs() > limit {
                row[axis] = limit.copysign(row[axis]);
                cut += 1;
            }
        }
        cut
    }

    #[test]
    fn clean_recordings_fine_and_coarse_are_never_flagged() {
        for (force_step, rate_step) in
            [(1e-4, 1e-5), (0.01, 0.001), (0.02, 0.003), (0.06, 0.009), (0.2, 0.03), (1.0, 0.2)]
        {
            let columns = Columns::tumbling().quantised(force_step, rate_step);
            let findings = found(&columns.recording());
            assert!(findings.is_empty(), "{force_step}: {findings:?}");
        }
    }

    #[test]
    fn rest_and_constant_turn_without_noise_are_not_flagged() {
        // A motor turns the unit at constant speed about x, and then the unit rests. The extreme values repeat, but no
        // value is clipped.
        let mut columns = Columns::tumbling();
        for i in 0..4000 {
            let moving = (i / 200) % 2 == 1;
            let angle = 0.02 * (i % 200) as f64 * f64::from(u8::from(moving));
            columns.force[i] = [0.0, 9.80665 * angle.sin(), 9.80665 * angle.cos()];
            columns.rate[i] = [if moving { 2.0 } else { 0.0 }, 0.0, 0.0];
        }
        assert!(found(&columns.recording()).is_empty());
    }

    #[test]
    fn a_clipped_si_channel_names_axis_and_samples() {
        for steps in [(1e-4, 1e-5), (0.01, 0.001), (0.06, 0.009)] {
            let mut columns = Columns::tumbling().quantised(steps.0, steps.1);
            let cut = clip(&mut columns, 0, 2.0) + clip(&mut columns, 2, 2.0);
            clip(&mut columns, 1, 2.0);
            let findings = found(&columns.recording());
            assert_eq!(findings.len(), 1, "{steps:?}");
            let found = &findings[0];
            assert_eq!(found.code, "gyro_saturation");
            assert!(found.columns.contains(&"gyro_x".into()) && found.columns.contains(&"gyro_z".into()));
            assert!(cut > 100 && found.count >= cut / 2);
            let total: usize = saturated_samples(&columns.recording()).iter().map(Range::len).sum();
            assert_eq!(total, found.count);
        }
    }

    #[test]
    fn a_motor_that_turns_to_and_fro_at_one_speed_is_not_clipped() {
        for step in [0.003, 0.02, 0.1] {
            let mut columns = Columns::tumbling().quantised(0.01, step);
            for (i, row) in columns.rate.iter_mut().enumerate() {
                let (lap, phase) = (i / 100, i % 100);
                if lap % 2 == 1 && (10..90).contains(&phase) {
                    let sign = if lap % 4 == 1 { 1.0 } else { -1.0 };
                    row[0] = (sign / step).round() * step;
                }
            }
            assert!(found(&columns.recording()).is_empty(), "{step}");
        }
    }

    #[test]
    fn one_hit_of_the_16_bit_end_is_enough_and_the_middle_of_unsigned_counts_is_none() {
        let mut columns = Columns::tumbling().quantised(0.001, 0.0001);
        for row in &mut columns.rate {
            *row = row.map(|v| (v * 8000.0).round());
        }
        let lsb = |columns: &Columns| -> Vec<Range<usize>> {
            saturated_samples(&Recording { gyro_unit: RawUnit::Lsb, ..columns.recording() })
        };
        assert!(lsb(&columns).is_empty());
        columns.rate[1234][1] = 32767.0;
        assert_eq!(lsb(&columns).as_slice(), std::slice::from_ref(&(1234..1235)));
        columns.rate[1234][1] = 0.0;
        // Unsigned counts at rest. The largest value of one axis is 32768, which is the middle of the range.
        for row in &mut columns.rate {
            *row = row.map(|v| 32768.0 - v.abs());
        }
        assert!(lsb(&columns).is_empty());
    }

    #[test]
    fn a_clipped_accelerometer_is_named() {
        let mut columns = Columns::tumbling();
        for (i, row) in columns.force.iter_mut().enumerate() {
            row[1] = (row[1] + if i % 400 > 380 { 20.0 } else { 0.0 }).min(19.6);
        }
        let findings = found(&columns.recording());
        assert_eq!(findings[0].code, "accel_saturation");
        assert_eq!(findings[0].columns, ["accel_y"]);
    }

    /// The measurement range ends below 1 g, so the axis has one constant value in whole rests.
    #[test]
    fn an_accelerometer_that_is_clipped_at_rest_is_named() {
        for step in [1e-4, 0.005] {
            let mut columns = Columns::tumbling().quantised(step, 1e-4);
            columns.force.iter_mut().for_each(|row| *row = row.map(|v| v.min(9.7)));
            let findings = found(&columns.recording());
            assert_eq!((findings.len(), findings[0].code), (1, "accel_saturation"));
            assert!(findings[0].columns.contains(&"accel_z".into()) && findings[0].value == 9.7, "{}", findings[0]);
        }
    }

    #[test]
    fn nan_does_not_disturb() {
        let mut columns = Columns::tumbling();
        columns.rate[10] = [f64::NAN; 3];
        columns.force[20] = [f64::NAN; 3];
        assert!(found(&columns.recording()).is_empty());
        columns.rate.iter_mut().for_each(|row| *row = [f64::NAN; 3]);
        assert!(found(&columns.recording()).is_empty());
    }
}
