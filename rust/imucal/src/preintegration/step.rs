//! Computes one integration step in every SIMD lane: the quaternion of the step, the rotation before the step, and the
//! contribution of the step's first sample to the sums.
//!
//! The quantities in this file are scaled so that the formulas are short. The rotation vector of a step is `3 p` with
//! `p = s + q`. `s` is a third of the integral of the rate over the step, and `q` is a third of the coning correction.
//! For equal steps and linear interpolation, the samples a0 and a1 at the ends of a step are scaled so that `s = a0 +
//! a1` and `q = a0 x a1`.
//!
//! The quaternion of a step is proportional to `(1, tau(y) p)` with `y = |p|^2`. The polynomial tau(y) approximates `3
//! tan(t/2) / t`, where t is the rotation angle of the step. The quaternion `(1, tau(y) p)` is not normalised: its
//! squared norm is `1 / cos^2(t/2)`. Another polynomial in y approximates `cos^2(t/2)`, with which the squared norm of
//! a product of such quaternions is updated from step to step.

use nalgebra::Vector3;
use pulp::Simd;

use super::lanes::{Lanes, Three, cross, square, three};
use super::sums::Sample;

/// A range of rotation angles per step, and the polynomials that are accurate in this range.
pub(super) struct AngleRange {
    /// Maximum rotation angle of a step, rad.
    pub(super) turn_rad: f64,
    /// Numbers of terms that the polynomials for the tangent and for the squared cosine need in this range.
    terms: [usize; 2],
}

/// Ranges from small to large angles. The relative truncation error of the polynomial for the tangent is at most 1e-14.
/// The polynomial for the squared cosine only updates the factor 2 / |q|^2, where q is the product of the step
/// quaternions. Its truncation error does not accumulate, because this factor is corrected with the computed norm of q
/// once per tile (8 steps).
pub(super) const ANGLE_RANGES: [AngleRange; 3] = [
    AngleRange { turn_rad: 0.001, terms: [2, 3] },
    AngleRange { turn_rad: 0.03, terms: [4, 4] },
    AngleRange { turn_rad: 0.2, terms: [7, 6] },
];

/// Whether the sums for the derivatives of the rotation are computed over nodes of 16 steps instead of sample by
/// sample. Nodes are used if all time steps are equal and all step angles are in the first of the [`ANGLE_RANGES`].
pub(super) const fn at_nodes<const EVEN: bool, const SUMS: bool, const RANGE: usize>() -> bool {
    EVEN && SUMS && RANGE == 0
}

/// Coefficients in y of the polynomial for `3 tan(t/2) / t`, where t is the rotation angle of a step and `t^2 = 9 y`.
const TANGENT: [f64; 7] = by_powers(
    1.5,
    2.25,
    [1.0, 1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0, 1382.0 / 155_925.0, 21_844.0 / 6_081_075.0],
);
/// Coefficients in y of the polynomial for `cos^2(t/2)`, where t is the rotation angle of a step and `t^2 = 9 y`.
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

/// Quantities of a step that do not depend on the previous step.
///
/// They are computed for all steps of a tile (8 steps) before the quaternions are multiplied. Only the product of
/// quaternions depends on the previous step. If the products were computed between these quantities, the processor
/// would have to wait for the result of each product.
#[derive(Clone, Copy)]
#[repr(align(64))] // A SIMD vector that crosses a cache line takes twice as long to load and to store.
pub(super) struct StepTerm<S: Simd> {
    /// Vector part of the step's quaternion divided by its scalar part.
    vector: Three<S>,
    /// Square of the cosine of half the rotation angle. For the quaternion (1, vector), which is not normalised, it
    /// equals 1 / |(1, vector)|^2.
    cosine_squared: Lanes<S>,
}

impl<S: Simd> StepTerm<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self { vector: [zero; 3], cosine_squared: zero }
    }
}

/// State of the integration in all lanes.
#[repr(align(64))]
pub(super) struct LaneState<S: Simd> {
    simd: S,
    /// The last three rates, oldest first. For equal steps, they are scaled like a0 and a1 at the start of this file.
    a: [Three<S>; 3],
    /// Times of these rates, s; zero for equal steps.
    times: [Lanes<S>; 3],
    /// Length of the previous step, s.
    pub(super) before: Lanes<S>,
    /// Product of the step quaternions, scalar part first, not normalised.
    pub(super) quaternion: [Lanes<S>; 4],
    /// Two divided by the squared norm of the quaternion.
    double: Lanes<S>,
    /// Sum of the samples at both ends of each step, over all steps since the last call of `sum_of_samples`.
    pairs: Three<S>,
    /// Largest `y = |p|^2` of all steps. The rotation angle of a step is 3 |p|.
    largest: Lanes<S>,
}

impl<S: Simd> LaneState<S> {
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

    /// Adds the next sample. With linear interpolation, this sample is at the end of a step. With cubic interpolation,
    /// it is the sample after the end of a step. The quantities that do not depend on the rotation before the step are
    /// written to `term` and `sample`.
    #[inline(always)]
    pub(super) fn take_step<const EVEN: bool, const CUBIC: bool, const SUMS: bool, const RANGE: usize>(
        &mut self,
        next: Three<S>,
        next_time: Lanes<S>,
        term: &mut StepTerm<S>,
        sample: &mut Sample<S>,
    ) {
        let simd = self.simd;
        let splat = |value: f64| Lanes::splat(simd, value);
        let (outside, a0, a1, after) =
            if CUBIC { (self.a[0], self.a[1], self.a[2], next) } else { (self.a[1], self.a[2], next, next) };
        let at_nodes = at_nodes::<EVEN, SUMS, RANGE>();
        let each = SUMS && !at_nodes;
        let mut s = three(|c| a0[c] + a1[c]);
        if at_nodes {
            self.pairs = three(|c| self.pairs[c] + s[c]);
        }
        if CUBIC {
            let (inner, outer) = (splat(13.0 / 12.0), splat(1.0 / 12.0));
            s = three(|c| (outside[c] + after[c]).neg_mul_add(outer, s[c] * inner));
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
        let tangent = polynomial(simd, &TANGENT[..ANGLE_RANGES[RANGE].terms[0]], y);
        term.vector = three(|c| p[c] * tangent);
        if each {
            term.cosine_squared = polynomial(simd, &COSINE_SQUARED[..ANGLE_RANGES[RANGE].terms[1]], y);
        }
        self.take(next, next_time);
    }

    /// The sample at the start of the next step.
    #[inline(always)]
    pub(super) fn sample<const CUBIC: bool>(&self) -> Three<S> {
        self.a[if CUBIC { 1 } else { 2 }]
    }

    /// Returns the sample at the start of the next step, with the weight `weight`, as a contribution to the sums.
    #[inline(always)]
    pub(super) fn here<const CUBIC: bool>(&self, weight: Lanes<S>) -> Sample<S> {
        let sample = self.sample::<CUBIC>();
        Sample { rate: three(|c| sample[c] * weight), weight, rotation: self.rotation() }
    }

    /// Columns of the rotation matrix that is the product of all steps so far.
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

    /// Columns of the rotation matrix at the start, the middle or the end of a node (16 steps). The norm of the
    /// quaternion is computed first, because it is not updated from step to step if nodes are used.
    #[inline(always)]
    pub(super) fn rotation_at_node(&mut self) -> [Three<S>; 3] {
        self.double = Lanes::splat(self.simd, 2.0) / self.square_of_length();
        self.rotation()
    }

    /// Returns the sum of the samples since the last call of this function. The first and the last of these samples
    /// have half weight.
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
        w.mul_add(w, square(&[x, y, z]))
    }

    /// Multiplies the rotation by the rotations of several consecutive steps, whose quaternions are `terms`. If `SUMS`
    /// is true, the rotation before each step is written to `samples`.
    #[inline(always)]
    pub(super) fn turn<const SUMS: bool>(&mut self, terms: &[StepTerm<S>], samples: &mut [Sample<S>]) {
        if SUMS {
            // `double` is 2 / |quaternion|^2. One iteration of Newton's method removes the errors that `double` has
            // accumulated: rounding errors and the truncation errors of the cosine polynomial.
            let one = Lanes::splat(self.simd, 1.0);
            let excess = self.square_of_length().neg_mul_add(self.double * Lanes::splat(self.simd, 0.5), one);
            self.double = self.double.mul_add(excess, self.double);
        }
        for (term, sample) in terms.iter().zip(samples) {
            if SUMS {
                sample.rotation = self.rotation();
                self.double = self.double * term.cosine_squared;
            }
            self.quaternion = times_quaternion(&self.quaternion, term.vector);
        }
    }

    /// Whether the rotation angles of all steps so far are inside the range `RANGE`, in which the polynomials are
    /// accurate.
    #[inline(always)]
    pub(super) fn is_exact<const RANGE: usize>(&self) -> bool {
        let limit = ANGLE_RANGES[RANGE].turn_rad;
        let largest = self.largest.to_array().into_iter().fold(0.0, f64::max);
        9.0 * largest <= limit * limit
    }
}

#[inline(always)]
fn polynomial<S: Simd>(simd: S, coefficients: &[f64], y: Lanes<S>) -> Lanes<S> {
    let (highest, others) = coefficients.split_last().map_or((0.0, coefficients), |(last, others)| (*last, others));
    others.iter().rev().fold(Lanes::splat(simd, highest), |sum, c| sum.mul_add(y, Lanes::splat(simd, *c)))
}

/// Computes the quaternion of a rotation vector, rad, and returns its vector part divided by its scalar part.
#[inline(always)]
pub(super) fn half_turn<S: Simd>(simd: S, turn: Three<S>) -> Three<S> {
    let third = Lanes::splat(simd, 1.0 / 3.0);
    let p = three(|c| turn[c] * third);
    let tangent = polynomial(simd, &TANGENT, square(&p));
    three(|c| p[c] * tangent)
}

/// Whether a rotation vector, rad, is inside the range of [`half_turn`].
pub(super) fn is_within_range(turn: &Vector3<f64>) -> bool {
    let [.., most] = ANGLE_RANGES;
    turn.norm_squared() <= most.turn_rad * most.turn_rad
}

/// Quaternion product `q (1, v)`.
#[inline(always)]
pub(super) fn times_quaternion<S: Simd>([w, x, y, z]: &[Lanes<S>; 4], v: Three<S>) -> [Lanes<S>; 4] {
    [
        z.neg_mul_add(v[2], y.neg_mul_add(v[1], x.neg_mul_add(v[0], *w))),
        z.neg_mul_add(v[1], y.mul_add(v[2], w.mul_add(v[0], *x))),
        x.neg_mul_add(v[2], z.mul_add(v[0], w.mul_add(v[1], *y))),
        y.neg_mul_add(v[0], x.mul_add(v[1], w.mul_add(v[2], *z))),
    ]
}
