//! Detection of plateaus: equal consecutive samples in one channel while the unit moves. A rounded peak, a rest without
//! noise, and samples that are equal only because of coarse quantisation do not count as plateaus.

use super::values::range;
use crate::recording::Samples;

/// Minimum number of equal consecutive samples in a plateau.
pub(super) const PLATEAU: usize = 3;
/// Directly before and after a plateau, the channel must change by at least this number of steps of the converter. A
/// rounded peak changes by one or two steps.
const EDGE_STEPS: f64 = 3.0;
/// During the plateau, another axis of the triad must change by at least this number of its converter steps. This
/// condition excludes rests without noise.
const SIBLING_STEPS: f64 = 2.0;
/// Minimum change of the channel, in steps of the converter, from the plateau to each of two samples: the sample one
/// plateau length before its start, and the sample one plateau length after its end. This limit detects a clipped
/// channel that changes slowly next to the plateau, which [`EDGE_STEPS`] misses at high sampling rates and with coarse
/// steps. A rounded peak stays below the limit: if the top n samples of a parabola are within one step, the samples
/// that are n samples farther out are three times as far from the peak, so they are only 3^2 = 9 steps below it.
const FAR_STEPS: f64 = 12.0;
/// For a plateau that [`FAR_STEPS`] detects, another axis must change during the plateau by more than this share of
/// that axis's range in the whole recording.
const SIBLING_SHARE: f64 = 0.05;

/// Plateaus at an extreme value are reported only if noise would cause them with at most this probability. With this
/// limit, one in 1e5 recordings without saturation is falsely reported as saturated.
const BY_CHANCE: f64 = 1e-5;
/// Upper limit of the assumed probability that noise makes two consecutive samples equal. If the noise is smaller than
/// one step of the converter, most consecutive samples are equal. Without this limit, even a long plateau would then be
/// a plausible effect of noise, and no plateau would be reported.
const MOST_EQUAL: f64 = 0.5;

/// Size of a set of plateaus: the number of plateaus, the number of samples in all of them, and the number of samples
/// in the longest one.
#[derive(Clone, Copy, Default)]
pub(super) struct Kind {
    count: usize,
    samples: usize,
    longest: usize,
}

impl Kind {
    fn add(&mut self, len: usize) {
        self.count += 1;
        self.samples += len;
        self.longest = self.longest.max(len);
    }

    /// Whether these plateaus have more than twice as many samples as the plateaus `usual`, or whether the longest of
    /// them is at least twice as long as the longest of `usual`.
    pub(super) fn stand_out_from(&self, usual: &Self) -> bool {
        self.samples > 2 * usual.samples || (self.longest > 0 && self.longest >= 2 * usual.longest)
    }

    /// Whether noise is a plausible cause of these plateaus. `equal` is the probability that noise makes two
    /// consecutive samples equal.
    pub(super) fn is_chance(&self, equal: f64) -> bool {
        equal.powi((self.samples - self.count) as i32) > BY_CHANCE
    }
}

/// Computes the share of equal pairs among the pairs of consecutive samples of one axis, at most [`MOST_EQUAL`]. Pairs
/// that begin at an extreme value of the axis are not counted.
pub(super) fn equal_neighbours(rows: Samples<'_>, axis: usize, ends: &[f64; 2]) -> f64 {
    let (mut equal, mut pairs) = (1.0, 1.0);
    rows.neighbours(axis, |before, after| {
        if !ends.contains(&before) {
            pairs += 1.0;
            equal += f64::from(u8::from(before == after));
        }
    });
    f64::min(equal / pairs, MOST_EQUAL)
}

/// Plateaus of one axis in three groups: at its lowest value, at its highest value, and at all other values.
#[derive(Default)]
pub(super) struct Plateaus {
    pub(super) at_end: [Kind; 2],
    pub(super) elsewhere: Kind,
}

/// Finds all plateaus of the axis `axis`. For each axis of the triad, `ends` contains the lowest and the highest value,
/// and `steps` contains the converter step.
pub(super) fn plateaus(rows: Samples<'_>, axis: usize, ends: &[[f64; 2]; 3], steps: &[f64; 3]) -> Plateaus {
    let mut found = Plateaus::default();
    let mut start = 0;
    for i in 1..=rows.len() {
        let value = rows.at(start)[axis];
        if i < rows.len() && rows.at(i)[axis] == value {
            continue;
        }
        let run = start..i;
        start = i;
        if run.len() < PLATEAU || !value.is_finite() {
            continue;
        }
        // Change of the channel from the plateau to the sample `distance` samples before its start, and to the sample
        // `distance` samples after its end, in converter steps.
        let drop_at = |distance: usize| {
            let row = |k: Option<usize>| k.filter(|&k| k < rows.len()).map(|k| rows.at(k));
            let drop = |row: Option<[f64; 3]>| row.map(|row| (row[axis] - value).abs() / steps[axis]);
            [drop(row(run.start.checked_sub(distance))), drop(row(Some(run.end - 1 + distance)))]
        };
        // `change` is the range of the values of another axis during the plateau. `share` is `change` divided by the
        // range of that axis in the whole recording.
        let change = |k: usize| range(rows.slice(run.clone()), k);
        let sibling = |is_enough: &dyn Fn(usize) -> bool| (1..3).map(|k| (axis + k) % 3).any(is_enough);
        let share = |k: usize| change(k) / (ends[k][1] - ends[k][0]);
        // An edge of the plateau is steep if the channel jumps there, if the adjacent sample is NaN, or if the
        // recording ends there.
        let steep = drop_at(1).iter().all(|drop| drop.is_none_or(|d| d.is_nan() || d >= EDGE_STEPS))
            && sibling(&|k| change(k) >= SIBLING_STEPS * steps[k] && share(k) > 1e-6);
        let far = || {
            drop_at(run.len()).iter().all(|drop| drop.is_some_and(|d| d >= FAR_STEPS))
                && sibling(&|k| share(k) > SIBLING_SHARE)
        };
        if steep || far() {
            match ends[axis].iter().position(|end| *end == value) {
                Some(side) => found.at_end[side].add(run.len()),
                None => found.elsewhere.add(run.len()),
            }
        }
    }
    found
}

/// Whether the extreme value `end` occurs at least twice as often as all other values within 1.5 converter steps of it
/// together. Otherwise, the extreme value is only the tail of a noise distribution.
pub(super) fn piles_up(rows: Samples<'_>, axis: usize, end: f64, step: f64) -> bool {
    let (mut at_end, mut inside) = (0, 0);
    for value in rows.axis(axis) {
        if value == end {
            at_end += 1;
        } else if (value - end).abs() < 1.5 * step {
            inside += 1;
        }
    }
    at_end >= 2 * inside
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples_at_end(x: impl Fn(f64) -> f64) -> usize {
        let rows: Vec<[f64; 3]> = (0..200)
            .map(|i| {
                let t = f64::from(i) * 0.01;
                [x(t), (700.0 * (5.0 * t).cos()).round(), 0.0]
            })
            .collect();
        let ends = [0, 1, 2].map(|k| super::super::values::extremes((&rows).into(), k));
        plateaus((&rows).into(), 0, &ends, &[1.0, 1.0, f64::INFINITY]).at_end[1].samples
    }

    #[test]
    fn few_equal_samples_are_chance_where_neighbours_often_are_equal() {
        let plateaus = |lengths: &[usize]| {
            let mut kind = Kind::default();
            lengths.iter().for_each(|len| kind.add(*len));
            kind
        };
        // With noise of four converter steps (standard deviation), one in fourteen pairs of consecutive samples is
        // equal. With values that are not quantised, no pair is equal.
        for (lengths, equal, is_chance) in [
            (&[3][..], 0.07, true),
            (&[3, 3], 0.07, true),
            (&[6], 0.07, false),
            (&[3, 3, 3], 0.04, false),
            (&[3], 1e-4, false),
        ] {
            assert_eq!(plateaus(lengths).is_chance(equal), is_chance, "{lengths:?} {equal}");
        }
        let rows: Vec<[f64; 3]> = (0..3100).map(|i| [0.0, f64::from(i), 1.0]).collect();
        assert!(equal_neighbours((&rows).into(), 1, &[0.0, 3099.0]) < 1e-3);
        assert!((equal_neighbours((&rows).into(), 2, &[0.0, 2.0]) - MOST_EQUAL).abs() < 1e-12);
    }

    #[test]
    fn a_cut_peak_is_a_plateau_and_a_rounded_one_is_not() {
        let peak = |t: f64| 1000.0 * (std::f64::consts::PI * (t - 1.0)).cos();
        assert_eq!(samples_at_end(|t| peak(t).round().min(900.0)), 29);
        assert_eq!(samples_at_end(|t| peak(t).round()), 0);
        // With coarse quantisation, the 7 samples at the top of the peak have equal values.
        assert_eq!(samples_at_end(|t| (peak(t) / 10.0).round()), 0);
    }
}
