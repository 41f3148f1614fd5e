//! A path in lanes: each lane takes its own stretch of consecutive steps, and all of them are put together at the end.

use nalgebra::{Matrix3, UnitQuaternion};
use pulp::{Simd, WithSimd};

use super::lanes::{Lanes, MOST_LANES, Quaternions, Three, begin_of, fetch_soon, three};
use super::step::{Running, Term, at_nodes};
use super::sums::{Node, STEPS_OF_A_NODE, Sample, Totals, end_of_nodes};

/// Steps whose samples a lane reads in one go: half a node.
const TILE: usize = STEPS_OF_A_NODE / 2;
/// How many samples ahead memory is asked for.
const AHEAD: usize = 64;

/// A stretch of a path for all lanes together.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a> {
    /// One sample more than there are steps, and one on either side if the rate is a cubic.
    pub(super) raw: &'a [[f64; 3]],
    /// Time of each sample, s; `None` for even steps.
    pub(super) stamps_s: Option<&'a [f64]>,
    pub(super) map: &'a Map,
}

/// From readings to rates in a frame of the kernel's own, rad/s; for even steps to a sixth of the turn in one interval. The frame is
/// such that the matrix is upper triangular: a third of the products less.
#[derive(Clone, Copy)]
pub(super) struct Map {
    pub(super) upper: Matrix3<f64>,
    pub(super) offset: [f64; 3],
}

/// What steps come to, in the kernel's frame.
pub(super) struct Turned {
    pub(super) rotation: UnitQuaternion<f64>,
    /// Sums of R with the weights of the samples, and of R times each part of the rate: there column c with part j for `j >= c`.
    pub(super) sums: [Matrix3<f64>; 4],
    /// Steps that were taken; of a stretch the others are fewer than the lanes, or than a node in each.
    pub(super) steps: usize,
}

impl Turned {
    pub(super) fn nothing() -> Self {
        Self { rotation: UnitQuaternion::identity(), sums: [Matrix3::zeros(); 4], steps: 0 }
    }

    /// Takes the steps that come next.
    pub(super) fn then(&mut self, next: &Self) {
        let before = *self.rotation.to_rotation_matrix().matrix();
        self.sums.iter_mut().zip(&next.sums).for_each(|(sum, added)| *sum += before * added);
        self.rotation *= next.rotation;
        self.steps += next.steps;
    }
}

/// The work on a stretch: `CUBIC` is the rate through four samples instead of two, `SUMS` says whether the sums are wanted, `REACH`
/// how far a step may turn.
pub(super) struct Work<'a, const CUBIC: bool, const SUMS: bool, const REACH: usize>(pub(super) Stretch<'a>);

impl<const CUBIC: bool, const SUMS: bool, const REACH: usize> WithSimd for Work<'_, CUBIC, SUMS, REACH> {
    /// `None` if a step turns too far for the polynomials, or if there are fewer steps than a node in each lane.
    type Output = Option<Turned>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Turned> {
        let margin = usize::from(CUBIC);
        let steps = (self.0.raw.len() - 1 - 2 * margin) / S::F64_LANES;
        match self.0.stamps_s {
            None if at_nodes::<true, SUMS, REACH>() => {
                let steps = steps - steps % STEPS_OF_A_NODE;
                if steps > 0 { self.0.run::<S, true, CUBIC, SUMS, REACH>(simd, steps) } else { None }
            }
            None => self.0.run::<S, true, CUBIC, SUMS, REACH>(simd, steps),
            Some(_) => self.0.run::<S, false, CUBIC, SUMS, REACH>(simd, steps),
        }
    }
}

impl Stretch<'_> {
    #[inline(always)]
    fn run<S: Simd, const EVEN: bool, const CUBIC: bool, const SUMS: bool, const REACH: usize>(
        &self,
        simd: S,
        steps: usize,
    ) -> Option<Turned> {
        let margin = usize::from(CUBIC);
        let first = |lane: usize| begin_of::<S>(lane, steps);
        let samples = steps + 1 + 2 * margin;
        let raw: [&[[f64; 3]]; MOST_LANES] = std::array::from_fn(|l| &self.raw[first(l)..first(l) + samples]);
        let stamps: [&[f64]; MOST_LANES] =
            std::array::from_fn(|l| self.stamps_s.map_or(&[][..], |stamps| &stamps[first(l)..first(l) + samples]));
        let map = LaneMap::new(simd, self.map);

        // The samples before the first step's last one.
        let known = samples - steps;
        let (zero, half) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 0.5));
        let mut run: Running<S> = Running::new(simd);
        for k in 0..known {
            let time = if EVEN { zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take(map.rate(three(|c| Lanes::from_fn(simd, |l| raw[l][k][c]))), time);
        }
        let tiles: [&[[[f64; 3]; TILE]]; MOST_LANES] = raw.map(|raw| raw[known..].as_chunks().0);
        let time_tiles: [&[[f64; TILE]]; MOST_LANES] =
            stamps.map(|stamps| if EVEN { &[][..] } else { stamps[known..].as_chunks().0 });
        let mut terms = [Term::nothing(simd); TILE];
        let mut summed = [Sample::nothing(simd); TILE];
        let mut totals = Totals::nothing(simd);
        let at_nodes = at_nodes::<EVEN, SUMS, REACH>();
        let mut node = Node::new(simd, run.sample::<CUBIC>());
        if at_nodes {
            totals.add::<false>(&[end_of_nodes(simd, -1.0, run.sample::<CUBIC>(), &run.rotation_at_node())]);
        } else if SUMS && EVEN {
            // An end counts for half; the first one will be counted as a whole.
            totals.add::<false>(&[run.here::<CUBIC>(zero - half)]);
        }
        for t in 0..steps / TILE {
            let tile: [&[[f64; 3]; TILE]; MOST_LANES] = tiles.map(|tiles| &tiles[t]);
            tile.iter().take(S::F64_LANES).for_each(|tile| fetch_soon(tile.as_slice(), AHEAD));
            if EVEN {
                for k in 0..TILE {
                    let a = map.rate(three(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    run.take_step::<EVEN, CUBIC, SUMS, REACH>(a, zero, &mut terms[k], &mut summed[k]);
                }
            } else {
                let times: [&[f64; TILE]; MOST_LANES] = time_tiles.map(|tiles| &tiles[t]);
                for k in 0..TILE {
                    let a = map.rate(three(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    let time = Lanes::from_fn(simd, |l| times[l][k]);
                    run.take_step::<EVEN, CUBIC, SUMS, REACH>(a, time, &mut terms[k], &mut summed[k]);
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
            run.take_step::<EVEN, CUBIC, SUMS, REACH>(a, time, &mut terms[place], &mut summed[place]);
        }
        run.turn::<SUMS>(&terms[..rest], &mut summed[..rest]);
        if at_nodes {
            totals.add::<false>(&[end_of_nodes(simd, 1.0, run.sample::<CUBIC>(), &run.rotation_at_node())]);
        } else if SUMS {
            totals.add::<EVEN>(&summed[..rest]);
            totals.add::<false>(&[run.here::<CUBIC>(if EVEN { half } else { run.before })]);
        }
        run.is_exact::<REACH>().then(|| together::<S, SUMS>(simd, &run, &totals, steps))
    }
}

/// The map in every lane.
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
            a[0].times_plus(x, a[1].times_plus(y, a[2].times_plus(z, offset[0]))),
            b[1].times_plus(y, b[2].times_plus(z, offset[1])),
            c[2].times_plus(z, offset[2]),
        ]
    }
}

/// What the lanes come to, one after the other.
#[inline(always)]
fn together<S: Simd, const SUMS: bool>(simd: S, run: &Running<S>, totals: &Totals<S>, steps: usize) -> Turned {
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
                    sum[(r, column)] = a.times_plus(*x, b.times_plus(*y, *c * *z)).sum();
                }
            }
        }
    }
    Turned { rotation, sums, steps: steps * S::F64_LANES }
}
