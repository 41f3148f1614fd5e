//! Where a rest begins and ends.

use std::ops::Range;

use nalgebra::Vector3;

use super::WINDOW_BLOCKS;
use super::blocks::Block;
use super::steadiness::unsteadiness;

/// Without the guard block at each end that the motion may have touched; a recording's own ends need none.
pub(super) fn trim(blocks: &Range<usize>, windows: usize) -> Range<usize> {
    let start = if blocks.start == 0 { 0 } else { blocks.start + 1 };
    let end = if blocks.end == windows + WINDOW_BLOCKS - 1 { blocks.end } else { blocks.end - 1 };
    start..end.max(start)
}

/// Without the ends that are louder than the rest itself: a hand comes to rest slowly, and its tremor says how calm
/// this rest is.
pub(super) fn calm(mut blocks: Range<usize>, statistic: &[f64]) -> Range<usize> {
    if blocks.len() <= WINDOW_BLOCKS {
        return blocks;
    }
    let loud = 3.0 * unsteadiness(&blocks, statistic).max(1.0);
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.start] > loud {
        blocks.start += 1;
    }
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.end - WINDOW_BLOCKS] > loud {
        blocks.end -= 1;
    }
    blocks
}

/// The rate of a rest, away from its ends.
struct Inner {
    mean: Vector3<f64>,
    /// Of the mean of a block.
    variance: Vector3<f64>,
    count: f64,
}

impl Inner {
    fn of(blocks: &[Block]) -> Self {
        let rates: Vec<Vector3<f64>> = blocks.iter().map(rate).collect();
        let count = rates.len() as f64;
        let mean = rates.iter().sum::<Vector3<f64>>() / count;
        let scatter = rates.iter().map(|rate| square(rate - mean)).sum::<Vector3<f64>>() / (count - 1.0);
        // A noise-free simulation: rounding is no turn.
        Self { mean, variance: scatter.map(|v| v.max(1e-18)), count }
    }

    /// chi2, with three degrees of freedom, of the sum of `n` rates less the mean each.
    fn chi2(&self, sum: Vector3<f64>, n: usize) -> f64 {
        let n = n as f64;
        square(sum).component_div(&(self.variance * (n * (1.0 + n / self.count)))).sum()
    }
}

fn rate(block: &Block) -> Vector3<f64> {
    block.mean().fixed_rows::<3>(0).into()
}

fn square(v: Vector3<f64>) -> Vector3<f64> {
    v.component_mul(&v)
}

/// Without the ends in which the gyroscope already turns too slowly for its scatter to show it.
///
/// Up to half a second at each end is compared with the inner part: a turn that the noise of the inner part explains
/// less than once in 10^5 ends belongs to the move.
pub(super) fn settle(mut range: Range<usize>, blocks: &[Block]) -> Range<usize> {
    const EDGE: usize = WINDOW_BLOCKS;
    const LIMIT: f64 = 25.9; // chi2 with 3 degrees of freedom, 1e-5
    if range.len() < 3 * EDGE {
        return range;
    }
    let inner = Inner::of(&blocks[range.start + EDGE..range.end - EDGE]);
    let turning = |edge: &mut dyn Iterator<Item = &Block>| {
        let mut sum = Vector3::zeros();
        let mut worst = (LIMIT, 0);
        for (k, block) in edge.take(EDGE).enumerate() {
            sum += rate(block) - inner.mean;
            let chi2 = inner.chi2(sum, k + 1);
            if chi2 > worst.0 {
                worst = (chi2, k + 1);
            }
        }
        // One guard block more, as everywhere.
        if worst.1 > 0 { worst.1 + 1 } else { 0 }
    };
    let rest = &blocks[range.clone()];
    let (at_start, at_end) = (turning(&mut rest.iter()), turning(&mut rest.iter().rev()));
    range.start += at_start;
    range.end -= at_end;
    range
}

/// Without the beginning and the end of moves that drown in noise; nothing outside `within` is looked at.
///
/// The jerk of a move is bounded, so it begins with a turn of c t^3 at a rate of 3 c t^2: three times the turn over the
/// rate is the time since it began. Both are taken where the turn, counted from a fifth of a second inside the rest, has
/// become ten times its noise. Five sixths of that time go to the move: in the first sixth it turned by a twentieth of the
/// noise. Where no turn follows, as at a jolt, or one that began before it was counted, nothing is dropped.
pub(super) fn onset(range: Range<usize>, within: &Range<usize>, blocks: &[Block]) -> Range<usize> {
    const EDGE: usize = 4;
    const REACH: usize = 2 * WINDOW_BLOCKS;
    const PLAIN: f64 = 100.0;
    const BACK: f64 = 3.0 * 5.0 / 6.0;
    if range.len() < 2 * WINDOW_BLOCKS {
        return range;
    }
    let inner = Inner::of(&blocks[range.start + EDGE..range.end - EDGE]);
    // Outwards from inside the rest: how many blocks of its edge stay.
    let still = |outwards: &mut dyn Iterator<Item = &Block>| {
        let rates: Vec<_> = outwards.take(EDGE + REACH).map(|block| rate(block) - inner.mean).collect();
        let mut turn = Vector3::zeros();
        for (k, pair) in rates.windows(2).enumerate() {
            turn += pair[0];
            if inner.chi2(turn, k + 1) > PLAIN {
                let rate_at_end = turn.dot(&(pair[0] + pair[1])) / 2.0;
                let before = (k + 1) as f64 - BACK * turn.norm_squared() / rate_at_end;
                return if rate_at_end > 0.0 && before >= 0.0 { EDGE.min(before as usize) } else { EDGE };
            }
        }
        EDGE
    };
    let at_start = still(&mut blocks[within.start..range.start + EDGE].iter().rev());
    let at_end = still(&mut blocks[range.end - EDGE..within.end].iter());
    range.start + EDGE - at_start..range.end - EDGE + at_end
}

#[cfg(test)]
mod tests {
    use super::*;

    const STILL: usize = 40;
    const NOISE: f64 = 0.01;

    /// A rest of 40 blocks whose noise has no mean, then `rate` of the time since in blocks, as means of a block.
    fn blocks(rate: impl Fn(f64) -> f64) -> Vec<Block> {
        let block = |k: usize| {
            let mut block = Block::new();
            for sample in 0..100 {
                let time = (k as f64 - STILL as f64) + (f64::from(sample) + 0.5) / 100.0;
                let noise = if k.is_multiple_of(2) { NOISE } else { -NOISE };
                let turning = Vector3::new(1.0, -2.0, 2.0) / 3.0 * rate(time);
                block.push(turning.add_scalar(noise), Vector3::new(0.0, 0.0, 9.8));
            }
            block
        };
        (0..2 * STILL).map(block).collect()
    }

    fn found_end(found_before: usize, blocks: &[Block]) -> usize {
        onset(0..found_before, &(0..blocks.len()), blocks).end
    }

    #[test]
    fn a_move_that_begins_softly_is_given_back_its_beginning() {
        // A rate of c t^2 reaches the noise of a block after 0.4 to 4 blocks.
        for strength in [0.05, 0.005, 0.0005] {
            for begin in [-2.2, -1.7, -0.9, 0.0, 0.3] {
                let blocks = blocks(|time| strength * (time - begin).max(0.0).powi(2));
                let end = found_end(STILL, &blocks) as f64 - STILL as f64;
                // A sixth of the time until the turn is plain may stay in the rest: a twentieth of the noise of some 20 blocks.
                let kept = (end - begin).max(0.0);
                let turn = strength * kept.powi(3) / 3.0;
                assert!(turn < 0.25 * NOISE, "{strength} {begin}: {end}");
                assert!(end > begin - 3.0, "{strength} {begin}: {end}");
            }
        }
    }

    #[test]
    fn both_ends_are_alike() {
        let forwards = blocks(|time| 0.005 * (time + 1.3).max(0.0).powi(2));
        let backwards: Vec<Block> = forwards.iter().rev().copied().collect();
        let all = 0..forwards.len();
        let (at_end, at_start) = (onset(0..STILL, &all, &forwards), onset(STILL..2 * STILL, &all, &backwards));
        assert!(at_end.end < STILL);
        assert_eq!((at_end.start, at_start.end), (0, 2 * STILL));
        assert_eq!(2 * STILL - at_start.start, at_end.end);
    }

    #[test]
    fn a_jolt_and_the_end_of_the_recording_drop_nothing() {
        let jolt = blocks(|time| if (0.0..1.0).contains(&time) { (40.0 * time).sin() } else { 0.0 });
        assert_eq!(found_end(STILL, &jolt), STILL);
        let turning = blocks(|time| 0.005 * time.max(0.0).powi(2));
        assert_eq!(onset(0..STILL, &(0..STILL), &turning), 0..STILL);
    }
}
