//! Samples in a row, in groups of as many.

use std::ops::Range;

/// How samples fall into groups.
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
    /// Of so many samples, `size` in a group; one begins at sample `begin`.
    pub(super) fn new(size: usize, begin: usize, samples: usize) -> Self {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_is_in_its_group_and_one_begins_where_it_is_wanted() {
        for (size, begin, samples) in [(1, 0, 5), (2, 2, 23), (4, 1, 40), (3, 2, 30)] {
            let groups = Groups::new(size, begin, samples);
            let all: Vec<usize> = (0..groups.count()).flat_map(|group| groups.samples(group)).collect();
            assert_eq!(all, (0..samples).collect::<Vec<usize>>());
            assert!((0..samples).all(|k| groups.samples(groups.of(k)).contains(&k)));
            assert_eq!(groups.samples(groups.of(begin)).start, begin);
        }
    }
}
