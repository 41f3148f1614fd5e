//! Neighbouring samples of a move, of which the columns of effects are asked for once, at their mean state.

use std::ops::Range;

use imucal_core::effects::State;
use imucal_core::so3;
use nalgebra::{UnitQuaternion, Vector3};

use super::corrected::Corrected;
use super::model::mean_surroundings;
use super::pass::Route;
use crate::carry::{Between, turn_on};

/// So many groups in a block.
const IN_BLOCK: usize = 4;

/// How the samples that are corrected fall into groups.
#[derive(Clone, Copy)]
pub(super) struct Groups {
    /// Samples of each.
    size: usize,
    /// So many of the first one are not there.
    lacking: usize,
    /// All samples.
    samples: usize,
}

impl Groups {
    /// Of so many samples; blocks begin with one of them, and a group begins there, too.
    pub(super) fn new(of_block: usize, begin: usize, samples: usize) -> Self {
        let size = (of_block / IN_BLOCK).max(1);
        Self { size, lacking: (size - begin % size) % size, samples }
    }

    /// That of sample `k`.
    #[inline(always)]
    pub(super) fn of(self, k: usize) -> usize {
        (k + self.lacking) / self.size
    }

    pub(super) fn count(self) -> usize {
        self.of(self.samples - 1) + 1
    }

    /// Its samples.
    pub(super) fn samples(self, group: usize) -> Range<usize> {
        let end = (group + 1) * self.size - self.lacking;
        (group * self.size).saturating_sub(self.lacking)..end.min(self.samples)
    }
}

impl Route<'_> {
    /// The mean state of each group but for its attitude; `slopes` are empty where nobody asks for them.
    pub(super) fn means(&self, groups: Groups, all: &Corrected, slopes: &[Vector3<f64>]) -> Vec<State<f64>> {
        let first = self.reach().start;
        let mean = |group: usize| {
            let samples = groups.samples(group);
            let mean =
                |values: &[Vector3<f64>]| values[samples.clone()].iter().sum::<Vector3<f64>>() / samples.len() as f64;
            let mut surroundings = mean_surroundings(self.recording, first + samples.start..first + samples.end);
            surroundings.angular_acceleration = (!slopes.is_empty()).then(|| mean(slopes));
            State { angular_rate: mean(&all.rate), specific_force: mean(&all.force), surroundings }
        };
        (0..groups.count()).map(mean).collect()
    }

    /// `v_start = rotation v_here` in the middle of each group, the means being samples of a rate of their own. That of a group before the
    /// move is the one of its start.
    pub(super) fn rotations(&self, groups: Groups, means: &[State<f64>]) -> Vec<UnitQuaternion<f64>> {
        let time_s: Vec<f64> = means.iter().map(|mean| mean.surroundings.time_s.unwrap_or_default()).collect();
        let start = groups.of(self.span.first - self.reach().start);
        let since_start_s = time_s[start] - (self.recording.time_s[self.span.first] - self.recording.time_s[0]);
        let mut here = so3::exp(&(means[start].angular_rate * since_start_s));
        let mut rotations = vec![here; start + 1];
        for g in start..means.len() - 1 {
            let rate = |g: usize| means[g].angular_rate;
            let (between, [before, from, to, after]) = Between::of(&time_s, g);
            let mut mean = rate(g) * from + rate(g + 1) * to;
            if between != Between::Straight {
                mean += rate(g - 1) * before + rate(g + 2) * after;
            }
            turn_on(&mut here, &mean, [&rate(g), &rate(g + 1)], time_s[g + 1] - time_s[g]);
            rotations.push(here);
        }
        rotations
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_is_in_its_group_and_blocks_begin_with_one() {
        for (of_block, begin, samples) in [(1, 0, 5), (8, 2, 23), (16, 1, 40), (13, 2, 30)] {
            let groups = Groups::new(of_block, begin, samples);
            let all: Vec<usize> = (0..groups.count()).flat_map(|group| groups.samples(group)).collect();
            assert_eq!(all, (0..samples).collect::<Vec<usize>>());
            assert!((0..samples).all(|k| groups.samples(groups.of(k)).contains(&k)));
            assert_eq!(groups.samples(groups.of(begin)).start, begin);
        }
    }
}
