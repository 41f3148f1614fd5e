//! Steps of a path in lanes: each lane takes its own stretch of consecutive steps, and all of them are put together at the end.
//!
//! In the units of this file a step turns by `3 p`, `p = s + q`, where `s` is a third of the rate's integral and `q` a third of the
//! coning; for even steps the samples are scaled so that `s = a0 + a1`, `q = a0 x a1`. With `y = |p|^2` the quaternion of a step is
//! a polynomial in y, and so is the last term of
//!
//! ```text
//! A = R J_l(phi) = (R + R')/2 + k (R' - R) [phi]x,   k = -(1 - (t/2) cot(t/2)) / t^2,   t = |phi|,   R' = R exp(phi)
//! ```
//!
//! Only entries on and above the diagonal are summed: turning the sensor turns the rotation with it, so for any small xi
//! `sum_cj [xi]x_cj G_j e_c = (I - R) xi`, and that gives those below.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use pulp::{Simd, WithSimd};

use super::lanes::{Lanes, MOST_LANES, fetch_soon};

/// Largest angle of a step, rad: the polynomials are exact to rounding below it.
const LARGEST_TURN_RAD: f64 = 0.2;
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

/// Three numbers in each lane.
type Three<S> = [Lanes<S>; 3];

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
        let mut run: Running<S> = Running::new(simd);
        for k in 0..known {
            let time = if EVEN { run.zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take(correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| raw[l][k][c]))), time);
        }
        let tiles: [&[[[f64; 3]; TILE]]; MOST_LANES] = raw.map(|raw| raw[known..].as_chunks().0);
        let time_tiles: [&[[f64; TILE]]; MOST_LANES] =
            stamps.map(|stamps| if EVEN { &[][..] } else { stamps[known..].as_chunks().0 });
        let nothing = [run.zero; 3];
        let no_term = Term {
            vector: nothing,
            scalar: run.zero,
            curved: nothing,
            twice: [nothing; 3],
            s: nothing,
            q: nothing,
            straight: nothing,
            slope: nothing,
            h: run.zero,
        };
        let mut terms = [no_term; TILE];
        let mut totals = Totals { entries: [[run.zero; 6]; 3], coning: nothing, bias: [nothing; 3] };
        for t in 0..steps / TILE {
            let tile: [&[[f64; 3]; TILE]; MOST_LANES] = tiles.map(|tiles| &tiles[t]);
            tile.iter().take(S::F64_LANES).for_each(|tile| fetch_soon(tile.as_slice(), AHEAD));
            if EVEN {
                for k in 0..TILE {
                    let a = correct(&map, [0, 1, 2].map(|c| Lanes::from_fn(simd, |l| tile[l][k][c])));
                    run.take_step::<EVEN, CUBIC, SUMS>(a, run.zero, &mut terms[k]);
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
            let time = if EVEN { run.zero } else { Lanes::from_fn(simd, |l| stamps[l][k]) };
            run.take_step::<EVEN, CUBIC, SUMS>(a, time, &mut terms[place]);
        }
        run.turn::<SUMS>(&mut terms[..rest]);
        if SUMS {
            totals.add::<EVEN>(&terms[..rest]);
        }
        run.finish(&totals, steps)
    }
}

#[inline(always)]
fn correct<S: Simd>(map: &[[Lanes<S>; 4]; 3], raw: Three<S>) -> Three<S> {
    let row = |m: &[Lanes<S>; 4]| m[0].times_plus(raw[0], m[1].times_plus(raw[1], m[2].times_plus(raw[2], m[3])));
    [row(&map[0]), row(&map[1]), row(&map[2])]
}

/// Coefficients of the polynomials in y, with `t^2 = 9 y`: `3 tan(t/2) / t`, `cos(t/2)`, `3 sin(t/2) / t` and `6 k`. What is left out
/// is below a rounding error for the largest turn.
const TANGENT: [f64; 7] = by_powers(
    1.5,
    2.25,
    [1.0, 1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0, 1382.0 / 155_925.0, 21_844.0 / 6_081_075.0],
);
const COSINE: [f64; 5] = by_powers(1.0, -2.25, [1.0, 0.5, 1.0 / 24.0, 1.0 / 720.0, 1.0 / 40_320.0]);
const SINE: [f64; 5] = by_powers(1.5, -2.25, [1.0, 1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0, 1.0 / 362_880.0]);
const CURVE: [f64; 5] =
    by_powers(-6.0, 9.0, [1.0 / 12.0, 1.0 / 720.0, 1.0 / 30_240.0, 1.0 / 1_209_600.0, 1.0 / 47_900_160.0]);

const fn by_powers<const N: usize>(mut factor: f64, ratio: f64, mut coefficients: [f64; N]) -> [f64; N] {
    let mut k = 0;
    while k < N {
        coefficients[k] *= factor;
        factor *= ratio;
        k += 1;
    }
    coefficients
}

/// What is made of a step in turn: its quaternion, the rotation after it, and what the sums need, without the factor of 3.
///
/// Each is made for all steps of a tile before the next one: a step depends on the one before in the product of quaternions alone,
/// and a processor that has that between the steps looks at no other meanwhile.
#[derive(Clone, Copy)]
#[repr(align(64))] // A register that crosses a line of the cache takes twice as long to store and to load.
struct Term<S: Simd> {
    /// Parts of its quaternion; without sums the vector part alone, over the scalar one.
    vector: Three<S>,
    scalar: Lanes<S>,
    /// `6 k p`
    curved: Three<S>,
    /// Rows of twice A.
    twice: [Three<S>; 3],
    s: Three<S>,
    q: Three<S>,
    /// `s - q`
    straight: Three<S>,
    /// `h^2/12 (w0 - w1)`, in intervals for even steps.
    slope: Three<S>,
    h: Lanes<S>,
}

/// Sums of all lanes.
#[repr(align(64))]
struct Totals<S: Simd> {
    /// Twice `A_c s_j - A_j q_c` for the entries, row by row, and twice `A q`, without a factor of 3.
    entries: [[Lanes<S>; 6]; 3],
    coning: Three<S>,
    /// Rows of twice G_b; for even steps in intervals.
    bias: [Three<S>; 3],
}

impl<S: Simd> Totals<S> {
    /// Adds the steps of a tile to the sums of one row, then to those of the next: there are more sums than registers.
    #[inline(always)]
    fn add<const EVEN: bool>(&mut self, terms: &[Term<S>]) {
        for r in 0..3 {
            let mut entries = self.entries[r];
            let mut coning = self.coning[r];
            let mut bias = self.bias[r];
            for Term { twice, s, q, straight, slope, h, .. } in terms {
                let [x, y, z] = twice[r];
                entries = [
                    x.times_plus(straight[0], entries[0]),
                    y.times_from(q[0], x.times_plus(s[1], entries[1])),
                    z.times_from(q[0], x.times_plus(s[2], entries[2])),
                    y.times_plus(straight[1], entries[3]),
                    z.times_from(q[1], y.times_plus(s[2], entries[4])),
                    z.times_plus(straight[2], entries[5]),
                ];
                // What is added to a sum comes first: a sum is not to wait for more than one addition.
                coning = coning + x.times_plus(q[0], y.times_plus(q[1], z * q[2]));
                let flat = if EVEN { [x, y, z] } else { [x * *h, y * *h, z * *h] };
                bias = [
                    bias[0] + z.times_from(slope[1], y.times_plus(slope[2], flat[0])),
                    bias[1] + x.times_from(slope[2], z.times_plus(slope[0], flat[1])),
                    bias[2] + y.times_from(slope[0], x.times_plus(slope[1], flat[2])),
                ];
            }
            self.entries[r] = entries;
            self.coning[r] = coning;
            self.bias[r] = bias;
        }
    }
}

/// Where all lanes are.
#[repr(align(64))]
struct Running<S: Simd> {
    zero: Lanes<S>,
    half: Lanes<S>,
    simd: S,
    /// The last three samples, the newest last.
    a: [Three<S>; 3],
    times: [Lanes<S>; 3],
    /// Scalar part first.
    quaternion: [Lanes<S>; 4],
    /// Rows of the rotation matrix.
    rows: [Three<S>; 3],
    /// Largest y.
    largest: Lanes<S>,
}

impl<S: Simd> Running<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        Self {
            zero,
            half: Lanes::splat(simd, 0.5),
            simd,
            a: [[zero; 3]; 3],
            times: [zero; 3],
            quaternion: [one, zero, zero, zero],
            rows: [[one, zero, zero], [zero, one, zero], [zero, zero, one]],
            largest: zero,
        }
    }

    #[inline(always)]
    fn take(&mut self, a: Three<S>, time: Lanes<S>) {
        self.a = [self.a[1], self.a[2], a];
        self.times = [self.times[1], self.times[2], time];
    }

    #[inline(always)]
    fn polynomial<const N: usize>(&self, coefficients: &[f64; N], y: Lanes<S>) -> Lanes<S> {
        let splat = |c: f64| Lanes::splat(self.simd, c);
        coefficients[..N - 1].iter().rev().fold(splat(coefficients[N - 1]), |sum, c| sum.times_plus(y, splat(*c)))
    }

    /// Takes the next sample, which ends a step or, for a cubic, comes after its end; writes what is known of the step by itself.
    #[inline(always)]
    fn take_step<const EVEN: bool, const CUBIC: bool, const SUMS: bool>(
        &mut self,
        next: Three<S>,
        next_time: Lanes<S>,
        term: &mut Term<S>,
    ) {
        let simd = self.simd;
        let splat = |value: f64| Lanes::splat(simd, value);
        let (before, a0, a1, after) =
            if CUBIC { (self.a[0], self.a[1], self.a[2], next) } else { (self.a[1], self.a[2], next, next) };
        let h = match (EVEN, CUBIC) {
            (true, _) => splat(1.0),
            (false, true) => self.times[2] - self.times[1],
            (false, false) => next_time - self.times[2],
        };
        let sixth = h * splat(1.0 / 6.0);
        let mut s = [0, 1, 2].map(|c| a0[c] + a1[c]);
        if CUBIC {
            let (inner, outer) = (splat(13.0 / 12.0), splat(1.0 / 12.0));
            s = [0, 1, 2].map(|c| (before[c] + after[c]).times_from(outer, s[c] * inner));
        }
        let mut q = cross(&a0, &a1);
        if !EVEN {
            let square = sixth * sixth;
            s = s.map(|s| s * sixth);
            q = q.map(|q| q * square);
        }
        let p = [0, 1, 2].map(|c| s[c] + q[c]);
        let y = p[0].times_plus(p[0], p[1].times_plus(p[1], p[2] * p[2]));
        self.largest = self.largest.max(y);
        if SUMS {
            let (sine, curve) = (self.polynomial(&SINE, y), self.polynomial(&CURVE, y));
            term.vector = p.map(|p| p * sine);
            term.scalar = self.polynomial(&COSINE, y);
            term.curved = p.map(|p| p * curve);
            let factor = if EVEN { self.half } else { sixth * sixth * splat(3.0) };
            term.slope = [0, 1, 2].map(|c| (a0[c] - a1[c]) * factor);
            term.straight = [0, 1, 2].map(|c| s[c] - q[c]);
            (term.s, term.q) = (s, q);
            if !EVEN {
                term.h = h;
            }
        } else {
            // Of any length: what the cosine would take off is taken off at the end.
            let tangent = self.polynomial(&TANGENT, y);
            term.vector = p.map(|p| p * tangent);
        }
        self.take(next, next_time);
    }

    /// Takes the turns of some steps, one after the other.
    #[inline(always)]
    fn turn<const SUMS: bool>(&mut self, terms: &mut [Term<S>]) {
        for term in terms {
            if SUMS {
                let scaled = self.quaternion.map(|part| part * term.scalar);
                self.quaternion = turned(&self.quaternion, scaled, term.vector);
                self.turn_rows(term);
            } else {
                self.quaternion = turned(&self.quaternion, self.quaternion, term.vector);
            }
        }
    }

    /// Makes the rotation matrix of the quaternion, and twice A of the step, row by row: there are more rows than registers.
    #[inline(always)]
    fn turn_rows(&mut self, term: &mut Term<S>) {
        let one = Lanes::splat(self.simd, 1.0);
        for r in 0..3 {
            let after = row(&self.quaternion, r, one);
            let before = std::mem::replace(&mut self.rows[r], after);
            let change = [0, 1, 2].map(|c| after[c] - before[c]);
            let both = [0, 1, 2].map(|c| after[c] + before[c]);
            term.twice[r] = times_hat_plus(&change, &term.curved, &both);
        }
    }

    #[inline(always)]
    fn finish(self, totals: &Totals<S>, steps: usize) -> Option<Turned> {
        let largest = self.largest.to_array().into_iter().fold(0.0, f64::max);
        if 9.0 * largest > LARGEST_TURN_RAD * LARGEST_TURN_RAD {
            return None;
        }
        let quaternions = self.quaternion.map(Lanes::to_array);
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
        Some(all)
    }
}

/// `a x b`.
#[inline(always)]
fn cross<S: Simd>(a: &Three<S>, b: &Three<S>) -> Three<S> {
    let part = |i: usize, k: usize| a[k].times_from(b[i], a[i] * b[k]);
    [part(1, 2), part(2, 0), part(0, 1)]
}

/// `start + q (0, v)`.
#[inline(always)]
fn turned<S: Simd>(q: &[Lanes<S>; 4], start: [Lanes<S>; 4], v: Three<S>) -> [Lanes<S>; 4] {
    let [w, x, y, z] = *q;
    [
        z.times_from(v[2], y.times_from(v[1], x.times_from(v[0], start[0]))),
        z.times_from(v[1], y.times_plus(v[2], w.times_plus(v[0], start[1]))),
        x.times_from(v[2], z.times_plus(v[0], w.times_plus(v[1], start[2]))),
        y.times_from(v[0], x.times_plus(v[1], w.times_plus(v[2], start[3]))),
    ]
}

/// Row `r` of the rotation matrix of a unit quaternion.
#[inline(always)]
fn row<S: Simd>(q: &[Lanes<S>; 4], r: usize, one: Lanes<S>) -> Three<S> {
    let [w, x, y, z] = *q;
    let (x2, y2, z2) = (x + x, y + y, z + z);
    match r {
        0 => [z.times_from(z2, y.times_from(y2, one)), w.times_from(z2, x * y2), w.times_plus(y2, x * z2)],
        1 => [w.times_plus(z2, x * y2), z.times_from(z2, x.times_from(x2, one)), w.times_from(x2, y * z2)],
        _ => [w.times_from(y2, x * z2), w.times_plus(x2, y * z2), y.times_from(y2, x.times_from(x2, one))],
    }
}

/// `row [v]x + sum`.
#[inline(always)]
fn times_hat_plus<S: Simd>(row: &Three<S>, v: &Three<S>, sum: &Three<S>) -> Three<S> {
    let part = |y: usize, z: usize, x: usize| row[z].times_from(v[y], row[y].times_plus(v[z], sum[x]));
    [part(1, 2, 0), part(2, 0, 1), part(0, 1, 2)]
}
