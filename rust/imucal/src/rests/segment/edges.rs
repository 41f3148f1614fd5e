//! Refines the start and the end of a rest (model.md (11)).

use std::ops::Range;

use nalgebra::{Vector3, Vector6};

use super::WINDOW_BLOCKS;
use super::blocks::Block;
use super::steadiness::unsteadiness;

/// Removes one guard block at each end of a rest, because this block may contain motion. At an end of the recording, no
/// guard block is removed.
pub(super) fn trim(blocks: &Range<usize>, windows: usize) -> Range<usize> {
    let start = if blocks.start == 0 { 0 } else { blocks.start + 1 };
    let end = if blocks.end == windows + WINDOW_BLOCKS - 1 { blocks.end } else { blocks.end - 1 };
    start..end.max(start)
}

/// Removes blocks at both ends of a rest while the statistic (variance / noise variance) of the first or last window
/// (half a second) is above 3 x max(1, median of the statistic over the rest). The reason is that a hand settles slowly
/// after a move. The limit is proportional to this median, so it adapts to the tremor of the rest.
pub(super) fn calm(mut blocks: Range<usize>, statistic: &[f64]) -> Range<usize> {
    if blocks.len() <= WINDOW_BLOCKS {
        return blocks;
    }
    let limit = 3.0 * unsteadiness(&blocks, statistic).max(1.0);
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.start] > limit {
        blocks.start += 1;
    }
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.end - WINDOW_BLOCKS] > limit {
        blocks.end -= 1;
    }
    blocks
}

/// Mean and variance of the angular rate over the inner part of a rest, without its ends.
struct Inner {
    /// Mean angular rate over the inner part, raw units.
    mean: Vector3<f64>,
    /// Variance of the mean rate of one block, squared raw units.
    variance: Vector3<f64>,
    /// Number of blocks in the inner part.
    count: f64,
}

impl Inner {
    /// Mean and variance of the rate, computed from the `blocks` of the inner part of a rest. `coarse` contains the
    /// quantisation step of each channel whose noise is below its step, and zero for all other channels. If the noise
    /// is below the step, a slight change of the rate can change the mean of a block by a whole step. The variance is
    /// therefore at least step^2 / 12.
    fn of(blocks: &[Block], coarse: &Vector6<f64>) -> Self {
        let rates: Vec<Vector3<f64>> = blocks.iter().map(rate).collect();
        let count = rates.len() as f64;
        let mean = rates.iter().sum::<Vector3<f64>>() / count;
        let scatter = rates.iter().map(|rate| square(rate - mean)).sum::<Vector3<f64>>() / (count - 1.0);
        // In simulated data without noise, the lower bound of 1e-18 prevents floating-point rounding errors from being
        // detected as rotation.
        let rounding = coarse.fixed_rows::<3>(0).map(|step| (step * step / 12.0).max(1e-18));
        Self { mean, variance: scatter.sup(&rounding), count }
    }

    /// chi2 of the rotation over `n` blocks under the null hypothesis of no rotation. It has three degrees of freedom.
    /// `sum` is the sum of (rate - mean rate) over these blocks.
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

/// Removes the parts at the ends of a rest in which the unit still rotates, but so slowly that the variance within a
/// window does not increase.
///
/// Up to half a second at each end is compared with the inner part of the rest. The blocks at an end are assigned to
/// the move if their rotation is significant: under the null hypothesis of no rotation, a rotation of at least this
/// size has a probability below 1e-5.
pub(super) fn settle(mut range: Range<usize>, blocks: &[Block], coarse: &Vector6<f64>) -> Range<usize> {
    const EDGE: usize = WINDOW_BLOCKS;
    // Value that chi2 with three degrees of freedom exceeds with a probability of 1e-5.
    const LIMIT: f64 = 25.9;
    if range.len() < 3 * EDGE {
        return range;
    }
    let inner = Inner::of(&blocks[range.start + EDGE..range.end - EDGE], coarse);
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
        // One guard block is also removed.
        if worst.1 > 0 { worst.1 + 1 } else { 0 }
    };
    let rest = &blocks[range.clone()];
    let (at_start, at_end) = (turning(&mut rest.iter()), turning(&mut rest.iter().rev()));
    range.start += at_start;
    range.end -= at_end;
    range
}

/// Removes the end of the previous move and the start of the next move from the ends of a rest. These parts of the
/// moves are so slow that the noise of the rest masks them in the window statistic. Blocks outside `within` are not
/// used.
///
/// The rotation angle is summed outwards over the blocks, starting 0.2 s inside the rest, until the angle reaches ten
/// times its noise. If a slow move began farther inside the rest than the start of the sum, the sum is started again
/// from twice as far inside. The distance is doubled up to a third of the rest and at most [`FARTHEST`] blocks. Nothing
/// is removed in three cases: the angle does not reach ten times its noise, the angle does not increase when it reaches
/// this limit (for example, after a jolt), or the move began farther inside than the innermost start of the sum.
pub(super) fn onset(
    range: Range<usize>,
    within: &Range<usize>,
    blocks: &[Block],
    coarse: &Vector6<f64>,
) -> Range<usize> {
    if range.len() < 2 * WINDOW_BLOCKS {
        return range;
    }
    // Number of blocks to be removed from one end of the rest. `outwards(i, o)` returns the rates of i blocks inside
    // and o blocks outside the rest, in order from the inside to the outside.
    let moving = |outwards: &dyn Fn(usize, usize) -> Vec<Vector3<f64>>| {
        let mut inside = FIRST;
        loop {
            let inner = Inner::of(&blocks[range.start + inside..range.end - inside], coarse);
            let Some(seen) = seen_move(&outwards(inside, 5 * inside), &inner) else { return 0 };
            if seen.at >= CUBIC * seen.angle_over_rate {
                let assigned = if inside == FIRST { CUBIC } else { QUARTIC };
                return inside.saturating_sub((seen.at - assigned * seen.angle_over_rate) as usize);
            }
            inside *= 2;
            // At least 20 blocks must remain between the starts of the sums at both ends. 20 blocks last 1 s, the
            // default minimum duration of a rest.
            if inside > FARTHEST || range.len() < (3 * inside).max(2 * inside + 2 * WINDOW_BLOCKS) {
                return 0;
            }
        }
    };
    let at_start = moving(&|inside, outside| {
        blocks[within.start..range.start + inside].iter().rev().take(inside + outside).map(rate).collect()
    });
    let at_end = moving(&|inside, outside| {
        blocks[range.end - inside..within.end].iter().take(inside + outside).map(rate).collect()
    });
    range.start + at_start..range.end - at_end
}

/// Distance from an end of the rest to the block at which the sum of the angle is first started, in blocks (0.2 s).
const FIRST: usize = 4;
/// Largest distance from an end of the rest at which the sum of the angle is started, in blocks (1.6 s). A gyroscope
/// bias that settles for a minute after power-on looks like a rotation that ends smoothly. The limit ensures that at
/// most 1.6 s of the rest are removed because of such a bias.
const FARTHEST: usize = 32;
/// When a move is detected ([`SeenMove`]), the time of length `CUBIC` x (rotation angle / rate) before the detection is
/// assigned to the move.
///
/// The angular acceleration of a move starts at zero, and its derivative (jerk) is bounded. At the time t after its
/// start, a move therefore has the angle c t^3 and the rate 3 c t^2 with a constant c, so t = 3 angle / rate. The last
/// five sixths of t are assigned to the move. At the detection, the angle is ten times its noise, so in the first sixth
/// of t the angle is below 10 / 6^3 = 0.05 of this noise.
const CUBIC: f64 = 3.0 * 5.0 / 6.0;
/// Value that replaces [`CUBIC`] for a slow move. In a slow move, not only the angular acceleration but also the jerk
/// may start at zero. The angle is then proportional to t^4, so that t = 4 angle / rate. All of t is assigned to the
/// move, because this makes the rest only slightly shorter.
const QUARTIC: f64 = 4.0;

/// Detection of a move: the instant at which the rotation angle reaches ten times the noise of the angle.
struct SeenMove {
    /// Number of blocks from the start of the sum to this instant.
    at: f64,
    /// Rotation angle divided by the rate at this instant. This quotient is a time, in blocks.
    angle_over_rate: f64,
}

/// Accumulates the angle over blocks with the mean rates `rates`, until the angle reaches ten times its noise. `None`
/// if the angle does not reach this limit, or if it does not increase at this instant.
fn seen_move(rates: &[Vector3<f64>], inner: &Inner) -> Option<SeenMove> {
    const CHI2_AT_END: f64 = 100.0;
    let mut angle = Vector3::zeros();
    for (k, pair) in rates.windows(2).enumerate() {
        angle += pair[0] - inner.mean;
        if inner.chi2(angle, k + 1) > CHI2_AT_END {
            let rate_at_end = angle.dot(&(pair[0] + pair[1] - 2.0 * inner.mean)) / 2.0;
            let seen = SeenMove { at: (k + 1) as f64, angle_over_rate: angle.norm_squared() / rate_at_end };
            return (rate_at_end > 0.0).then_some(seen);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const STILL: usize = 40;
    const NOISE: f64 = 0.01;

    /// Simulates 40 blocks at rest with zero-mean noise, and then 40 blocks of a move. `rate` is the angular rate as a
    /// function of the time since the end of the rest, in blocks.
    fn blocks(rate: impl Fn(f64) -> f64) -> Vec<Block> {
        blocks_of(2 * STILL, |time| rate(time - STILL as f64))
    }

    /// Simulates `count` blocks with zero-mean noise. `rate` is the angular rate as a function of the time since the
    /// first block, in blocks.
    fn blocks_of(count: usize, rate: impl Fn(f64) -> f64) -> Vec<Block> {
        let block = |k: usize| {
            let mut block = Block::new();
            for sample in 0..100 {
                let time = k as f64 + (f64::from(sample) + 0.5) / 100.0;
                let noise = if k.is_multiple_of(2) { NOISE } else { -NOISE };
                let turning = Vector3::new(1.0, -2.0, 2.0) / 3.0 * rate(time);
                block.push(turning.add_scalar(noise), Vector3::new(0.0, 0.0, 9.8));
            }
            block
        };
        (0..count).map(block).collect()
    }

    fn found_end(found_before: usize, blocks: &[Block]) -> usize {
        onset(0..found_before, &(0..blocks.len()), blocks, &Vector6::zeros()).end
    }

    #[test]
    fn a_move_that_begins_softly_is_given_back_its_beginning() {
        // The rate is c t^2 with c = `strength`. It reaches the noise of a block after 0.45 to 4.5 blocks.
        for strength in [0.05, 0.005, 0.0005] {
            for begin in [-2.2, -1.7, -0.9, 0.0, 0.3] {
                let blocks = blocks(|time| strength * (time - begin).max(0.0).powi(2));
                let end = found_end(STILL, &blocks) as f64 - STILL as f64;
                // Let T be the time in which the angle of the move grows to 10 times the noise of the angle. The rest
                // may wrongly contain the first T / 6 of the move. The angle is proportional to the cube of the time,
                // so at T / 6 it is 10 / 6^3 = 0.05 of the noise of the angle. Over about 20 blocks, this noise is
                // sqrt(20) times the noise of one block, so the angle is 0.22 times the noise of one block.
                let kept = (end - begin).max(0.0);
                let turn = strength * kept.powi(3) / 3.0;
                assert!(turn < 0.25 * NOISE, "{strength} {begin}: {end}");
                assert!(end > begin - 3.0, "{strength} {begin}: {end}");
            }
        }
    }

    /// Simulates a slow move, of which the rest contains the first 0.25 to 0.4 s before its end is refined.
    #[test]
    fn a_slow_move_is_given_back_its_beginning_however_smooth_it_is() {
        for (power, strengths) in [(2, [1e-3, 3e-4]), (3, [1e-4, 3e-5])] {
            for strength in strengths {
                for begin in [-7.5, -6.1, -5.0] {
                    let blocks = blocks(|time| strength * (time - begin).max(0.0).powi(power));
                    let end = found_end(STILL, &blocks) as f64 - STILL as f64;
                    // Over 20 blocks of a move, the noise of the angle is sqrt(20) = 4.5 times the noise of one block.
                    // The angle that remains in the rest must be less than 1 / 4.5 of this noise.
                    let turn = strength * (end - begin).max(0.0).powi(power + 1) / f64::from(power + 1);
                    assert!(turn < NOISE && end >= -8.0, "{power} {strength} {begin}: {end}");
                }
            }
        }
    }

    /// Simulates a bias that settles after power-on, with a time constant of 20 s, in a rest of 100 s.
    #[test]
    fn a_bias_that_settles_hardly_shortens_a_rest() {
        let at_power_on: Vec<Block> = blocks_of(2000, |time| 12.0 * NOISE * (-time / 400.0).exp());
        let kept = onset(0..2000, &(0..2000), &at_power_on, &Vector6::zeros());
        assert!(kept.start <= FARTHEST && kept.end == 2000, "{kept:?}");
    }

    #[test]
    fn both_ends_are_alike() {
        let forwards = blocks(|time| 0.005 * (time + 1.3).max(0.0).powi(2));
        let backwards: Vec<Block> = forwards.iter().rev().copied().collect();
        let all = 0..forwards.len();
        let (at_end, at_start) = (
            onset(0..STILL, &all, &forwards, &Vector6::zeros()),
            onset(STILL..2 * STILL, &all, &backwards, &Vector6::zeros()),
        );
        assert!(at_end.end < STILL);
        assert_eq!((at_end.start, at_start.end), (0, 2 * STILL));
        assert_eq!(2 * STILL - at_start.start, at_end.end);
    }

    #[test]
    fn a_jolt_and_the_end_of_the_recording_drop_nothing() {
        let jolt = blocks(|time| if (0.0..1.0).contains(&time) { (40.0 * time).sin() } else { 0.0 });
        assert_eq!(found_end(STILL, &jolt), STILL);
        let turning = blocks(|time| 0.005 * time.max(0.0).powi(2));
        assert_eq!(onset(0..STILL, &(0..STILL), &turning, &Vector6::zeros()), 0..STILL);
    }
}
