//! One step in every lane: its quaternion, the rotation after it, and what it adds to the sums.
//!
//! In the units of this file a step turns by `3 p`, `p = s + q`, where `s` is a third of the rate's integral and `q` a third of the
//! coning; for even steps the samples are scaled so that `s = a0 + a1`, `q = a0 x a1`. With `y = |p|^2` the quaternion of a step is
//! a polynomial in y, and so is the last term of
//!
//! ```text
//! A = R J_l(phi) = (R + R')/2 + k (R' - R) [phi]x,   k = -(1 - (t/2) cot(t/2)) / t^2,   t = |phi|,   R' = R exp(phi)
//! ```

use pulp::Simd;

use super::lanes::Lanes;

/// Largest angle of a step, rad: the polynomials are exact to rounding below it.
const LARGEST_TURN_RAD: f64 = 0.2;

/// Three numbers in each lane.
pub(super) type Three<S> = [Lanes<S>; 3];

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
pub(super) struct Term<S: Simd> {
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
pub(super) struct Totals<S: Simd> {
    /// Twice `A_c s_j - A_j q_c` for the entries, row by row, and twice `A q`, without a factor of 3.
    pub(super) entries: [[Lanes<S>; 6]; 3],
    pub(super) coning: Three<S>,
    /// Rows of twice G_b; for even steps in intervals.
    pub(super) bias: [Three<S>; 3],
}

impl<S: Simd> Term<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        let three = [zero; 3];
        Self {
            vector: three,
            scalar: zero,
            curved: three,
            twice: [three; 3],
            s: three,
            q: three,
            straight: three,
            slope: three,
            h: zero,
        }
    }
}

impl<S: Simd> Totals<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self { entries: [[zero; 6]; 3], coning: [zero; 3], bias: [[zero; 3]; 3] }
    }

    /// Adds the steps of a tile to the sums of one row, then to those of the next: there are more sums than registers.
    #[inline(always)]
    pub(super) fn add<const EVEN: bool>(&mut self, terms: &[Term<S>]) {
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
pub(super) struct Running<S: Simd> {
    half: Lanes<S>,
    simd: S,
    /// The last three samples, the newest last.
    a: [Three<S>; 3],
    times: [Lanes<S>; 3],
    /// Scalar part first.
    pub(super) quaternion: [Lanes<S>; 4],
    /// Rows of the rotation matrix.
    rows: [Three<S>; 3],
    /// Largest y.
    largest: Lanes<S>,
}

impl<S: Simd> Running<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        Self {
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
    pub(super) fn take(&mut self, a: Three<S>, time: Lanes<S>) {
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
    pub(super) fn take_step<const EVEN: bool, const CUBIC: bool, const SUMS: bool>(
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
    pub(super) fn turn<const SUMS: bool>(&mut self, terms: &mut [Term<S>]) {
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

    /// Whether no step turned too far for the polynomials.
    #[inline(always)]
    pub(super) fn is_exact(&self) -> bool {
        let largest = self.largest.to_array().into_iter().fold(0.0, f64::max);
        9.0 * largest <= LARGEST_TURN_RAD * LARGEST_TURN_RAD
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
