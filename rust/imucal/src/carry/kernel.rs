//! A path in lanes: each lane takes its own stretch of consecutive steps, and all of them are put together at the end.
//!
//! Only entries on and above the diagonal are summed: turning the sensor turns the rotation with it, so for any small xi
//! `sum_cj [xi]x_cj G_j e_c = (I - R) xi`, and that gives those below.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use pulp::{Simd, WithSimd};

use super::lanes::{Lanes, MOST_LANES, fetch_soon};
use super::step::{Running, Term, Three, Totals};

/// Steps whose samples a lane reads in one go.
const TILE: usize = 8;
/// How many samples ahead memory is asked for.
const AHEAD: usize = 64;

/// A stretch of a path for all lanes together.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a> {
    /// One sample more than there are steps, and one on either side if the rate is a cubic.
    pub(super) raw: &'a [[f64; 3]],
    /// Time of each sample, s; `None` for even steps.
    pub(super) stamps_s: Option<&'a [f64]>,
    /// From readings to rates, rad/s; for even steps to a sixth of the turn in one interval. The last column is added.
    pub(super) map: &'a [[f64; 4]; 3],
}

/// What a stretch comes to.
pub(super) struct Turned {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) sums: Upper,
    /// Steps that were taken; the others are fewer than the lanes.
    pub(super) steps: usize,
}

/// The sums G_j e_c for c <= j, and G_b.
#[derive(Clone, Copy)]
pub(super) struct Upper {
    pub(super) entries: [Vector3<f64>; 6],
    pub(super) bias: Matrix3<f64>,
}

/// (c, j) of the entries.
pub(super) const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// The work on a stretch: `CUBIC` is the rate through four samples instead of two, `SUMS` says whether the sums are wanted.
pub(super) struct Work<'a, const CUBIC: bool, const SUMS: bool>(pub(super) Stretch<'a>);

impl<const CUBIC: bool, const SUMS: bool> WithSimd for Work<'_, CUBIC, SUMS> {
    /// `None` if a step turns too far for the polynomials.
    type Output = Option<Turned>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Turned> {
        let margin = usize::from(CUBIC);
        let steps = (self.0.raw.len() - 1 - 2 * margin) / S::F64_LANES;
        match self.0.stamps_s {
            None => self.0.run::<S, true, CUBIC, SUMS>(simd, steps),
            Some(_) => self.0.run::<S, false, CUBIC, SUMS>(simd, steps),
        }
    }
}

impl Stretch<'_> {
    #[inline(always)]
    fn run<S: Simd, const EVEN: bool, const CUBIC: bool, const SUMS: bool>(
        &self,
        simd: S,
        steps: usize,
    ) -> Option<Turned> {
        let margin = usize::from(CUBIC);
        // Lanes that are not there read the first stretch.
        let first = |lane: usize| if lane < S::F64_LANES { lane * steps } else { 0 };
        let samples = steps + 1 + 2 * margin;
        let raw: [&[[f64; 3]]; MOST_LANES] = std::array::from_fn(|l| &self.raw[first(l)..first(l) + samples]);
        let stamps: [&[f64]; MOST_LANES] =
            std::array::from_fn(|l| self.stamps_s.map_or(&[][..], |stamps| &stamps[first(l)..first(l) + samples]));
        let map = self.map.map(|row| row.map(|entry| Lanes::splat(simd, entry)));

        // The samples before the first step's last one.
        let known = samples - steps;
        let zero = Lanes::splat(simd, 0.0);
        let mut run: Running<S> = Running::new(simd);
        for k in 0..known {
            let time = if EVEN { zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take(correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| raw[l][k][c]))), time);
        }
        let tiles: [&[[[f64; 3]; TILE]]; MOST_LANES] = raw.map(|raw| raw[known..].as_chunks().0);
        let time_tiles: [&[[f64; TILE]]; MOST_LANES] =
            stamps.map(|stamps| if EVEN { &[][..] } else { stamps[known..].as_chunks().0 });
        let mut terms = [Term::nothing(simd); TILE];
        let mut totals = Totals::nothing(simd);
        for t in 0..steps / TILE {
            let tile: [&[[f64; 3]; TILE]; MOST_LANES] = tiles.map(|tiles| &tiles[t]);
            tile.iter().take(S::F64_LANES).for_each(|tile| fetch_soon(tile.as_slice(), AHEAD));
            if EVEN {
                for k in 0..TILE {
                    let a = correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    run.take_step::<EVEN, CUBIC, SUMS>(a, zero, &mut terms[k]);
                }
            } else {
                let times: [&[f64; TILE]; MOST_LANES] = time_tiles.map(|tiles| &tiles[t]);
                for k in 0..TILE {
                    let a = correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    let time = Lanes::from_fn(simd, |l| times[l][k]);
                    run.take_step::<EVEN, CUBIC, SUMS>(a, time, &mut terms[k]);
                }
            }
            run.turn::<SUMS>(&mut terms);
            if SUMS {
                totals.add::<EVEN>(&terms);
            }
        }
        let rest = steps % TILE;
        for (place, k) in (samples - rest..samples).enumerate() {
            let a = correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| raw[l][k][c])));
            let time = if EVEN { zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take_step::<EVEN, CUBIC, SUMS>(a, time, &mut terms[place]);
        }
        run.turn::<SUMS>(&mut terms[..rest]);
        if SUMS {
            totals.add::<EVEN>(&terms[..rest]);
        }
        run.is_exact().then(|| together(&run, &totals, steps))
    }
}

#[inline(always)]
fn correct<S: Simd>(map: &[[Lanes<S>; 4]; 3], raw: Three<S>) -> Three<S> {
    let row = |m: &[Lanes<S>; 4]| m[0].times_plus(raw[0], m[1].times_plus(raw[1], m[2].times_plus(raw[2], m[3])));
    [row(&map[0]), row(&map[1]), row(&map[2])]
}

/// What the lanes come to, one after the other.
#[inline(always)]
fn together<S: Simd>(run: &Running<S>, totals: &Totals<S>, steps: usize) -> Turned {
    let quaternions = run.quaternion.map(Lanes::to_array);
    let entries = totals.entries.map(|entry| entry.map(Lanes::to_array));
    let coning = totals.coning.map(Lanes::to_array);
    let bias = totals.bias.map(|row| row.map(Lanes::to_array));
    let mut all = Turned {
        rotation: UnitQuaternion::identity(),
        sums: Upper { entries: [Vector3::zeros(); 6], bias: Matrix3::zeros() },
        steps: steps * S::F64_LANES,
    };
    for lane in 0..S::F64_LANES {
        let before = all.rotation.to_rotation_matrix();
        let before = before.matrix();
        for (k, (c, j)) in UPPER.into_iter().enumerate() {
            let diagonal = if c == j { 1.0 } else { 0.0 };
            let sum = Vector3::from_fn(|r, _| entries[r][k][lane] + diagonal * coning[r][lane]);
            all.sums.entries[k] += before * sum * 1.5;
        }
        all.sums.bias += before * Matrix3::from_fn(|r, c| bias[r][c][lane]) * 0.5;
        let [w, x, y, z] = quaternions.map(|part| part[lane]);
        all.rotation *= UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    }
    all
}
