//! Vectorised preintegration. Each lane of a SIMD register processes a separate range of consecutive steps. The results
//! of the lanes are combined at the end.

use nalgebra::{Matrix3, UnitQuaternion};
use pulp::{Simd, WithSimd};

use super::lanes::{Lanes, MOST_LANES, Quaternions, Three, lane_start, prefetch, three};
use super::step::{LaneState, StepTerm, at_nodes};
use super::sums::{Node, STEPS_OF_A_NODE, Sample, Totals, end_of_nodes};

/// Number of steps in a tile. A lane reads all samples of a tile together. A tile is half a node. A node is a group of
/// 16 steps (see `sums.rs`).
const TILE: usize = STEPS_OF_A_NODE / 2;
/// A sample is prefetched from memory this number of samples before it is used.
const AHEAD: usize = 64;

/// Block of consecutive samples. Each lane of a SIMD register processes an equal part of the block.
#[derive(Clone, Copy)]
pub(super) struct Block<'a> {
    /// Raw samples. A block of n steps has n + 1 samples. With cubic interpolation, it has n + 3 samples: one
    /// additional sample before and one after.
    pub(super) raw: &'a [[f64; 3]],
    /// Time of each sample, s; `None` for equal steps.
    pub(super) stamps_s: Option<&'a [f64]>,
    pub(super) map: &'a Map,
}

/// Linear map from raw readings to rates in rad/s, in a frame in which its matrix is upper triangular. The triangular
/// form saves a third of the multiplications. If all time steps have the same length dt, the map contains the factor
/// dt / 6, which all terms of the integration have in common.
#[derive(Clone, Copy)]
pub(super) struct Map {
    pub(super) upper: Matrix3<f64>,
    pub(super) offset: [f64; 3],
}

/// Result of the integration over several steps, in the frame of [`Map`].
pub(super) struct Increment {
    pub(super) rotation: UnitQuaternion<f64>,
    /// Four sums over the samples. R is the rotation from the frame at a sample to the frame at the first sample. The
    /// first sum contains R times the weight of the sample in the integration. Each of the other three sums contains R
    /// times this weight times one component of the rate. In the sum for rate component j, only the columns c <= j are
    /// valid.
    pub(super) sums: [Matrix3<f64>; 4],
    /// Number of processed steps. All lanes process the same number of steps, or the same number of nodes (16 steps).
    /// Some steps at the end of a block may therefore remain unprocessed. Their number is below the number of lanes.
    /// With nodes, it is below 16 times the number of lanes.
    pub(super) steps: usize,
}

impl Increment {
    pub(super) fn nothing() -> Self {
        Self { rotation: UnitQuaternion::identity(), sums: [Matrix3::zeros(); 4], steps: 0 }
    }

    /// Appends the result of the steps that follow.
    pub(super) fn then(&mut self, next: &Self) {
        let before = *self.rotation.to_rotation_matrix().matrix();
        self.sums.iter_mut().zip(&next.sums).for_each(|(sum, added)| *sum += before * added);
        self.rotation *= next.rotation;
        self.steps += next.steps;
    }
}

/// The vectorised integration of a block. If `CUBIC` is true, the rate is interpolated by a cubic, otherwise linearly.
/// If `SUMS` is true, the sums for the derivatives of the rotation are also computed. `RANGE` is an index into
/// [`ANGLE_RANGES`](super::step::ANGLE_RANGES), the ranges of step angles.
pub(super) struct Kernel<'a, const CUBIC: bool, const SUMS: bool, const RANGE: usize>(pub(super) Block<'a>);

impl<const CUBIC: bool, const SUMS: bool, const RANGE: usize> WithSimd for Kernel<'_, CUBIC, SUMS, RANGE> {
    /// `None` if the angle of a step exceeds the range with the index `RANGE`. If the sums are computed over nodes (16
    /// steps), also `None` if the block has fewer steps than one node per lane.
    type Output = Option<Increment>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Increment> {
        let margin = usize::from(CUBIC);
        let steps = (self.0.raw.len() - 1 - 2 * margin) / S::F64_LANES;
        match self.0.stamps_s {
            None if at_nodes::<true, SUMS, RANGE>() => {
                let steps = steps - steps % STEPS_OF_A_NODE;
                if steps > 0 { self.0.run::<S, true, CUBIC, SUMS, RANGE>(simd, steps) } else { None }
            }
            None => self.0.run::<S, true, CUBIC, SUMS, RANGE>(simd, steps),
            Some(_) => self.0.run::<S, false, CUBIC, SUMS, RANGE>(simd, steps),
        }
    }
}

impl Block<'_> {
    #[inline(always)]
    fn run<S: Simd, const EVEN: bool, const CUBIC: bool, const SUMS: bool, const RANGE: usize>(
        &self,
        simd: S,
        steps: usize,
    ) -> Option<Increment> {
        let margin = usize::from(CUBIC);
        let first = |lane: usize| lane_start::<S>(lane, steps);
        let samples = steps + 1 + 2 * margin;
        let raw: [&[[f64; 3]]; MOST_LANES] = std::array::from_fn(|l| &self.raw[first(l)..first(l) + samples]);
        let stamps: [&[f64]; MOST_LANES] =
            std::array::from_fn(|l| self.stamps_s.map_or(&[][..], |stamps| &stamps[first(l)..first(l) + samples]));
        let map = LaneMap::new(simd, self.map);

        // Number of samples that are read before the first step is integrated: with linear interpolation the sample at
        // its start, with cubic interpolation also the sample before its start and the sample at its end.
        let known = samples - steps;
        let (zero, half) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 0.5));
        let mut run: LaneState<S> = LaneState::new(simd);
        for k in 0..known {
            let time = if EVEN { zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take(map.rate(three(|c| Lanes::from_fn(simd, |l| raw[l][k][c]))), time);
        }
        let tiles: [&[[[f64; 3]; TILE]]; MOST_LANES] = raw.map(|raw| raw[known..].as_chunks().0);
        let time_tiles: [&[[f64; TILE]]; MOST_LANES] =
            stamps.map(|stamps| if EVEN { &[][..] } else { stamps[known..].as_chunks().0 });
        let mut terms = [StepTerm::nothing(simd); TILE];
        let mut summed = [Sample::nothing(simd); TILE];
        let mut totals = Totals::nothing(simd);
        let at_nodes = at_nodes::<EVEN, SUMS, RANGE>();
        let mut node = Node::new(simd, run.sample::<CUBIC>());
        if at_nodes {
            totals.add::<false>(&[end_of_nodes(simd, -1.0, run.sample::<CUBIC>(), &run.rotation_at_node())]);
        } else if SUMS && EVEN {
            // In the trapezoidal rule, the first sample has half weight. Below, it is added with full weight, so half
            // of it is subtracted here.
            totals.add::<false>(&[run.here::<CUBIC>(zero - half)]);
        }
        for t in 0..steps / TILE {
            let tile: [&[[f64; 3]; TILE]; MOST_LANES] = tiles.map(|tiles| &tiles[t]);
            tile.iter().take(S::F64_LANES).for_each(|tile| prefetch(tile.as_slice(), AHEAD));
            if EVEN {
                for k in 0..TILE {
                    let a = map.rate(three(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    run.take_step::<EVEN, CUBIC, SUMS, RANGE>(a, zero, &mut terms[k], &mut summed[k]);
                }
            } else {
                let times: [&[f64; TILE]; MOST_LANES] = time_tiles.map(|tiles| &tiles[t]);
                for k in 0..TILE {
                    let a = map.rate(three(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    let time = Lanes::from_fn(simd, |l| times[l][k]);
                    run.take_step::<EVEN, CUBIC, SUMS, RANGE>(a, time, &mut terms[k], &mut summed[k]);
                }
            }
            if at_nodes {
                run.turn::<false>(&terms, &mut summed);
                if t % 2 == 0 {
                    node.reach_middle(run.sample::<CUBIC>(), run.sum_of_samples(), run.rotation_at_node());
                } else {
                    node.reach_end(run.sample::<CUBIC>(), run.sum_of_samples());
                    totals.add_node(simd, &node);
                }
                continue;
            }
            run.turn::<SUMS>(&terms, &mut summed);
            if SUMS {
                totals.add::<EVEN>(&summed);
            }
        }
        let rest = steps % TILE;
        for (place, k) in (samples - rest..samples).enumerate() {
            let a = map.rate(three(|c| Lanes::from_fn(simd, |l| raw[l][k][c])));
            let time = if EVEN { zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take_step::<EVEN, CUBIC, SUMS, RANGE>(a, time, &mut terms[place], &mut summed[place]);
        }
        run.turn::<SUMS>(&terms[..rest], &mut summed[..rest]);
        if at_nodes {
            totals.add::<false>(&[end_of_nodes(simd, 1.0, run.sample::<CUBIC>(), &run.rotation_at_node())]);
        } else if SUMS {
            totals.add::<EVEN>(&summed[..rest]);
            totals.add::<false>(&[run.here::<CUBIC>(if EVEN { half } else { run.before })]);
        }
        run.is_exact::<RANGE>().then(|| combine_lanes::<S, SUMS>(simd, &run, &totals, steps))
    }
}

/// The map from raw readings to rates, with the same values in every lane.
struct LaneMap<S: Simd> {
    upper: [[Lanes<S>; 3]; 3],
    offset: Three<S>,
}

impl<S: Simd> LaneMap<S> {
    #[inline(always)]
    fn new(simd: S, map: &Map) -> Self {
        let splat = |value: f64| Lanes::splat(simd, value);
        let row = |r: usize| three(|c| splat(map.upper[(r, c)]));
        Self { upper: [row(0), row(1), row(2)], offset: three(|c| splat(map.offset[c])) }
    }

    #[inline(always)]
    fn rate(&self, [x, y, z]: Three<S>) -> Three<S> {
        let ([a, b, c], offset) = (&self.upper, &self.offset);
        [
            a[0].mul_add(x, a[1].mul_add(y, a[2].mul_add(z, offset[0]))),
            b[1].mul_add(y, b[2].mul_add(z, offset[1])),
            c[2].mul_add(z, offset[2]),
        ]
    }
}

/// Combines the results of the lanes to the result of the whole block. The lanes cover consecutive time intervals.
#[inline(always)]
fn combine_lanes<S: Simd, const SUMS: bool>(
    simd: S,
    run: &LaneState<S>,
    totals: &Totals<S>,
    steps: usize,
) -> Increment {
    let turned = Quaternions::new(&run.quaternion);
    let mut rotation = UnitQuaternion::identity();
    let mut before = [Matrix3::identity(); MOST_LANES];
    for lane in 0..S::F64_LANES {
        before[lane] = *rotation.to_rotation_matrix().matrix();
        rotation *= turned.unit(lane);
    }
    let mut sums = [Matrix3::zeros(); 4];
    if SUMS {
        let row = |r: usize| three(|c| Lanes::from_fn(simd, |lane| before[lane][(r, c)]));
        let rows = [row(0), row(1), row(2)];
        for (sum, columns) in sums.iter_mut().zip(totals.columns()) {
            for (r, [a, b, c]) in rows.iter().enumerate() {
                for (column, [x, y, z]) in columns.iter().enumerate() {
                    sum[(r, column)] = a.mul_add(*x, b.mul_add(*y, *c * *z)).sum();
                }
            }
        }
    }
    Increment { rotation, sums, steps: steps * S::F64_LANES }
}
