//! Plateaus: equal samples in a row in one channel while the unit moves. A rounded peak, a rest without noise and the
//! chance repeats of a coarse converter are none.

use super::values::range;
use crate::recording::Samples;

/// Equal samples in a row that make a plateau.
pub(super) const PLATEAU: usize = 3;
/// A plateau must drop on both sides by this many steps of the converter: a rounded peak drops by one or two.
const EDGE_STEPS: f64 = 3.0;
/// Meanwhile another axis of the triad changes by this many of its steps: a rest without noise does not.
const SIBLING_STEPS: f64 = 2.0;
/// Where the rate is high and the step coarse even a rail has flat edges. Then the drop counts at the plateau's own
/// length from it (a rounded peak that is flat to one step drops by nine), while another axis moves by this share of
/// its range.
const FAR_STEPS: f64 = 12.0;
const SIBLING_SHARE: f64 = 0.05;

/// At the apex of a peak noise holds a channel for three samples now and then; a clean recording in so many may be refused.
const BY_CHANCE: f64 = 1e-5;
/// Where noise is less than a step, neighbours at an apex are equal more often than not.
const MOST_EQUAL: f64 = 0.5;

/// Plateaus of one kind: how many, samples in all of them, and in the longest.
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

    /// Far more samples, or far longer.
    pub(super) fn stand_out_from(&self, usual: &Self) -> bool {
        self.samples > 2 * usual.samples || (self.longest > 0 && self.longest >= 2 * usual.longest)
    }

    /// Whether noise may have made them, of which this share of neighbours is equal.
    pub(super) fn is_chance(&self, equal: f64) -> bool {
        equal.powi((self.samples - self.count) as i32) > BY_CHANCE
    }
}

/// Share of the neighbours of one axis that are equal, at values that are no end of it.
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

/// Plateaus at the lowest and the highest value, and at any other.
#[derive(Default)]
pub(super) struct Plateaus {
    pub(super) at_end: [Kind; 2],
    pub(super) elsewhere: Kind,
}

/// All plateaus of one axis. `ends` are the extremes and `steps` the converter's steps of the triad.
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
        // How far the channel is from the plateau, in steps, so many samples before and after it.
        let drop_at = |distance: usize| {
            let row = |k: Option<usize>| k.filter(|&k| k < rows.len()).map(|k| rows.at(k));
            let drop = |row: Option<[f64; 3]>| row.map(|row| (row[axis] - value).abs() / steps[axis]);
            [drop(row(run.start.checked_sub(distance))), drop(row(Some(run.end - 1 + distance)))]
        };
        // By how much another axis changes meanwhile, and by what share of its whole range.
        let change = |k: usize| range(rows.slice(run.clone()), k);
        let sibling = |is_enough: &dyn Fn(usize) -> bool| (1..3).map(|k| (axis + k) % 3).any(is_enough);
        let share = |k: usize| change(k) / (ends[k][1] - ends[k][0]);
        // The recording's end and a missing value are no evidence against a steep edge.
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

/// Whether the extreme value is taken at least twice as often as the values one step inside; the tail of a noise is
/// not.
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
        // Noise of four steps leaves one pair in fourteen equal, numbers with all their digits none.
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
        // Coarse: 7 samples at the top share one value.
        assert_eq!(samples_at_end(|t| (peak(t) / 10.0).round()), 0);
    }
}
