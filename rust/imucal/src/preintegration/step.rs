//! One step in every lane: its quaternion, the rotation before it, and what its first sample adds to the sums.
//!
//! In the units of this file a step turns by `3 p`, `p = s + q`, where `s` is a third of the rate's integral and `q` a third of the
//! coning; for even steps the samples are scaled so that `s = a0 + a1`, `q = a0 x a1`. With `y = |p|^2` the quaternion of a step is
//! `(1, tau(y) p)` but for its length, with a polynomial tau; the length of the product of all is followed by another.

use nalgebra::Vector3;
use pulp::Simd;

use super::lanes::{Lanes, Three, cross, square, three};
use super::sums::Sample;

/// How far the steps of a path turn.
pub(super) struct Reach {
    /// At most, rad.
    pub(super) turn_rad: f64,
    /// Terms of the polynomials that matter then: of the tangent, and of the square of the cosine.
    terms: [usize; 2],
}

/// From the least to the most. Of the tangent 1e-14 of itself is left out at most, and what is left out of the cosine is made good
/// once for each tile.
pub(super) const REACHES: [Reach; 3] = [
    Reach { turn_rad: 0.001, terms: [2, 3] },
    Reach { turn_rad: 0.03, terms: [4, 4] },
    Reach { turn_rad: 0.2, terms: [7, 6] },
];

/// Whether sums are taken at nodes and not at each sample: for even steps that keep to the first of [`REACHES`], and so are short.
pub(super) const fn at_nodes<const EVEN: bool, const SUMS: bool, const REACH: usize>() -> bool {
    EVEN && SUMS && REACH == 0
}

/// Coefficients of the polynomials in y, with `t^2 = 9 y`: `3 tan(t/2) / t` and `cos^2(t/2)`.
const TANGENT: [f64; 7] = by_powers(
    1.5,
    2.25,
    [1.0, 1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0, 1382.0 / 155_925.0, 21_844.0 / 6_081_075.0],
);
const COSINE_SQUARED: [f64; 6] = by_powers(1.0, -2.25, [1.0, 1.0, 1.0 / 3.0, 2.0 / 45.0, 1.0 / 315.0, 2.0 / 14_175.0]);

const fn by_powers<const N: usize>(mut factor: f64, ratio: f64, mut coefficients: [f64; N]) -> [f64; N] {
    let mut k = 0;
    while k < N {
        coefficients[k] *= factor;
        factor *= ratio;
        k += 1;
    }
    coefficients
}

/// What is made of a step in turn, but for its sample.
///
/// Each is made for all steps of a tile before the next one: a step depends on the one before in the product of quaternions alone,
/// and a processor that has that between the steps looks at no other meanwhile.
#[derive(Clone, Copy)]
#[repr(align(64))] // A register that crosses a line of the cache takes twice as long to store and to load.
pub(super) struct Term<S: Simd> {
    /// Vector part of its quaternion over the scalar one.
    vector: Three<S>,
    /// What the square of the scalar part is of that of the length.
    shrunk: Lanes<S>,
}

impl<S: Simd> Term<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self { vector: [zero; 3], shrunk: zero }
    }
}

/// Where all lanes are.
#[repr(align(64))]
pub(super) struct Running<S: Simd> {
    simd: S,
    /// The last three samples, the newest last.
    a: [Three<S>; 3],
    times: [Lanes<S>; 3],
    /// Length of the step before.
    pub(super) before: Lanes<S>,
    /// Scalar part first; of any length.
    pub(super) quaternion: [Lanes<S>; 4],
    /// Two over the square of its length.
    double: Lanes<S>,
    /// Both samples of each step since their sum was last asked for, added up.
    pairs: Three<S>,
    /// Largest y.
    largest: Lanes<S>,
}

impl<S: Simd> Running<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        Self {
            simd,
            a: [[zero; 3]; 3],
            times: [zero; 3],
            before: zero,
            quaternion: [one, zero, zero, zero],
            double: one + one,
            pairs: [zero; 3],
            largest: zero,
        }
    }

    #[inline(always)]
    pub(super) fn take(&mut self, a: Three<S>, time: Lanes<S>) {
        self.a = [self.a[1], self.a[2], a];
        self.times = [self.times[1], self.times[2], time];
    }

    /// Takes the next sample, which ends a step or, for a cubic, comes after its end; writes what is known of the step by itself.
    #[inline(always)]
    pub(super) fn take_step<const EVEN: bool, const CUBIC: bool, const SUMS: bool, const REACH: usize>(
        &mut self,
        next: Three<S>,
        next_time: Lanes<S>,
        term: &mut Term<S>,
        sample: &mut Sample<S>,
    ) {
        let simd = self.simd;
        let splat = |value: f64| Lanes::splat(simd, value);
        let (outside, a0, a1, after) =
            if CUBIC { (self.a[0], self.a[1], self.a[2], next) } else { (self.a[1], self.a[2], next, next) };
        let at_nodes = at_nodes::<EVEN, SUMS, REACH>();
        let each = SUMS && !at_nodes;
        let mut s = three(|c| a0[c] + a1[c]);
        if at_nodes {
            self.pairs = three(|c| self.pairs[c] + s[c]);
        }
        if CUBIC {
            let (inner, outer) = (splat(13.0 / 12.0), splat(1.0 / 12.0));
            s = three(|c| (outside[c] + after[c]).times_from(outer, s[c] * inner));
        }
        let mut q = cross(&a0, &a1);
        if each {
            sample.rate = a0;
        }
        if !EVEN {
            let h = if CUBIC { self.times[2] - self.times[1] } else { next_time - self.times[2] };
            let sixth = h * splat(1.0 / 6.0);
            let square = sixth * sixth;
            s = three(|c| s[c] * sixth);
            q = three(|c| q[c] * square);
            if each {
                sample.weight = self.before + h;
                sample.rate = three(|c| a0[c] * sample.weight);
            }
            self.before = h;
        }
        let p = three(|c| s[c] + q[c]);
        let y = square(&p);
        self.largest = self.largest.max(y);
        let tangent = polynomial(simd, &TANGENT[..REACHES[REACH].terms[0]], y);
        term.vector = three(|c| p[c] * tangent);
        if each {
            term.shrunk = polynomial(simd, &COSINE_SQUARED[..REACHES[REACH].terms[1]], y);
        }
        self.take(next, next_time);
    }

    /// The sample where the next step begins.
    #[inline(always)]
    pub(super) fn sample<const CUBIC: bool>(&self) -> Three<S> {
        self.a[if CUBIC { 1 } else { 2 }]
    }

    /// What it adds to the sums with a weight of its own.
    #[inline(always)]
    pub(super) fn here<const CUBIC: bool>(&self, weight: Lanes<S>) -> Sample<S> {
        let sample = self.sample::<CUBIC>();
        Sample { rate: three(|c| sample[c] * weight), weight, rotation: self.rotation() }
    }

    /// Columns of the rotation matrix.
    #[inline(always)]
    fn rotation(&self) -> [Three<S>; 3] {
        let one = Lanes::splat(self.simd, 1.0);
        let [w, x, y, z] = self.quaternion;
        let (x2, y2, z2) = (x * self.double, y * self.double, z * self.double);
        let (xx, yy, zz) = (x2 * x, y2 * y, z2 * z);
        let (xy, xz, yz) = (x2 * y, x2 * z, y2 * z);
        let (xw, yw, zw) = (x2 * w, y2 * w, z2 * w);
        [[one - (yy + zz), xy + zw, xz - yw], [xy - zw, one - (xx + zz), yz + xw], [xz + yw, yz - xw, one - (xx + yy)]]
    }

    /// The same where the length has not been followed.
    #[inline(always)]
    pub(super) fn rotation_at_node(&mut self) -> [Three<S>; 3] {
        self.double = Lanes::splat(self.simd, 2.0) / self.square_of_length();
        self.rotation()
    }

    /// The sum of the samples since it was last asked for, the ends by half.
    #[inline(always)]
    pub(super) fn sum_of_samples(&mut self) -> Three<S> {
        let (zero, half) = (Lanes::splat(self.simd, 0.0), Lanes::splat(self.simd, 0.5));
        let sum = three(|c| self.pairs[c] * half);
        self.pairs = [zero; 3];
        sum
    }

    #[inline(always)]
    fn square_of_length(&self) -> Lanes<S> {
        let [w, x, y, z] = self.quaternion;
        w.times_plus(w, square(&[x, y, z]))
    }

    /// Takes the turns of some steps, one after the other.
    #[inline(always)]
    pub(super) fn turn<const SUMS: bool>(&mut self, terms: &[Term<S>], samples: &mut [Sample<S>]) {
        if SUMS {
            // A step of Newton's takes away what rounding has added up.
            let one = Lanes::splat(self.simd, 1.0);
            let excess = self.square_of_length().times_from(self.double * Lanes::splat(self.simd, 0.5), one);
            self.double = self.double.times_plus(excess, self.double);
        }
        for (term, sample) in terms.iter().zip(samples) {
            if SUMS {
                sample.rotation = self.rotation();
                self.double = self.double * term.shrunk;
            }
            self.quaternion = turned(&self.quaternion, term.vector);
        }
    }

    /// Whether no step turned too far for the polynomials.
    #[inline(always)]
    pub(super) fn is_exact<const REACH: usize>(&self) -> bool {
        let limit = REACHES[REACH].turn_rad;
        let largest = self.largest.to_array().into_iter().fold(0.0, f64::max);
        9.0 * largest <= limit * limit
    }
}

#[inline(always)]
fn polynomial<S: Simd>(simd: S, coefficients: &[f64], y: Lanes<S>) -> Lanes<S> {
    let (highest, others) = coefficients.split_last().map_or((0.0, coefficients), |(last, others)| (*last, others));
    others.iter().rev().fold(Lanes::splat(simd, highest), |sum, c| sum.times_plus(y, Lanes::splat(simd, *c)))
}

/// Vector part over scalar part of the quaternion of a turn, rad.
#[inline(always)]
pub(super) fn half_turn<S: Simd>(simd: S, turn: Three<S>) -> Three<S> {
    let third = Lanes::splat(simd, 1.0 / 3.0);
    let p = three(|c| turn[c] * third);
    let tangent = polynomial(simd, &TANGENT, square(&p));
    three(|c| p[c] * tangent)
}

/// Whether a turn, rad, is as small as [`half_turn`] takes it.
pub(super) fn is_within_reach(turn: &Vector3<f64>) -> bool {
    let [.., most] = REACHES;
    turn.norm_squared() <= most.turn_rad * most.turn_rad
}

/// `q (1, v)`.
#[inline(always)]
pub(super) fn turned<S: Simd>([w, x, y, z]: &[Lanes<S>; 4], v: Three<S>) -> [Lanes<S>; 4] {
    [
        z.times_from(v[2], y.times_from(v[1], x.times_from(v[0], *w))),
        z.times_from(v[1], y.times_plus(v[2], w.times_plus(v[0], *x))),
        x.times_from(v[2], z.times_plus(v[0], w.times_plus(v[1], *y))),
        y.times_from(v[0], x.times_plus(v[1], w.times_plus(v[2], *z))),
    ]
}
