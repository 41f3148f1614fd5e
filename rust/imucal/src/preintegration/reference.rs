//! Reference implementation for tests. It computes the rotation over a move, and the sums from which the derivatives of
//! the rotation are computed, in double-double arithmetic.

use imucal_core::sensor::Triad;
use nalgebra::Matrix3;

use super::rate_segment;
use super::sums::{BY_ENDS, BY_HALVES, SECOND, STEPS_OF_A_NODE};

/// Inputs of an integration. `time_s` is either the constant time step, s, or the time of every sample, s.
pub(super) struct Samples<'a> {
    pub(super) raw: &'a [[f64; 3]],
    pub(super) time_s: Result<f64, &'a [f64]>,
    pub(super) triad: Triad<f64>,
    pub(super) is_cubic: bool,
}

/// A double-double number: the sum of two f64 numbers, with 31 digits.
#[derive(Clone, Copy)]
pub(super) struct Double(f64, f64);

impl Double {
    fn of(value: f64) -> Self {
        Self(value, 0.0)
    }
    fn sum(a: f64, b: f64) -> Self {
        let s = a + b;
        let t = s - a;
        Self(s, (a - (s - t)) + (b - t))
    }
    pub(super) fn value(self) -> f64 {
        self.0 + self.1
    }
}

impl std::ops::Add for Double {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (high, low) = (Self::sum(self.0, other.0), Self::sum(self.1, other.1));
        let first = Self::sum(high.0, high.1 + low.0);
        Self::sum(first.0, first.1 + low.1)
    }
}

impl std::ops::Neg for Double {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}

impl std::ops::Sub for Double {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl std::ops::Mul for Double {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = self.0 * other.0;
        let error = self.0.mul_add(other.0, -product);
        Self::sum(product, error + (self.0 * other.1 + self.1 * other.0))
    }
}

pub(super) type Vector = [Double; 3];
pub(super) type Square = [Vector; 3];

fn product(a: &Square, b: &Square) -> Square {
    let entry = |r: usize, c: usize| (0..3).fold(Double::of(0.0), |sum, k| sum + a[r][k] * b[k][c]);
    std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)))
}

fn plus(a: &Square, b: &Square) -> Square {
    std::array::from_fn(|r| std::array::from_fn(|c| a[r][c] + b[r][c]))
}

fn hat_of(v: &Vector) -> Square {
    let zero = Double::of(0.0);
    [[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]]
}

fn scaled(a: &Square, factor: Double) -> Square {
    a.map(|row| row.map(|entry| entry * factor))
}

/// The matrix exponential.
fn exponential(m: &Square) -> Square {
    let mut term: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(if r == c { 1.0 } else { 0.0 })));
    let mut sum = term;
    for k in 1..30 {
        term = product(&term, m);
        // One iteration of Newton's method gives 1/n to 31 digits.
        let n = Double::of(f64::from(k));
        let guess = Double::of(1.0 / n.0);
        term = scaled(&term, guess * (Double::of(2.0) - n * guess));
        sum = plus(&sum, &term);
    }
    sum
}

/// Computes the rotation, G_x, G_y, G_z and G_b in double-double arithmetic, by the equations at the start of
/// `preintegration.rs`. The first `at_nodes` steps are summed in nodes (groups) of 16 steps, all others sample by
/// sample.
pub(super) fn reference(path: &Samples<'_>, at_nodes: usize) -> [Square; 5] {
    let Samples { raw, time_s, triad, is_cubic } = path;
    let third = Double::of(1.0 / 3.0) + Double::of(-1.0 / 3.0 * 3.0 + 1.0) * Double::of(1.0 / 3.0);
    let third = third * (Double::of(2.0) - Double::of(3.0) * third);
    let twelfth = third * Double::of(0.25);
    let rate = |k: usize| -> Vector {
        std::array::from_fn(|r| {
            (0..3).fold(Double::of(0.0), |sum, c| {
                sum + Double::of(triad.inverse()[(r, c)]) * (Double::of(raw[k][c]) - Double::of(triad.bias()[c]))
            })
        })
    };
    let zero: Square = [[Double::of(0.0); 3]; 3];
    let mut rotation = exponential(&zero);
    let mut sums = [zero; 4];
    let margin = usize::from(*is_cubic);
    for k in margin..raw.len() - 1 - margin {
        let h = match time_s {
            Ok(interval_s) => Double::of(*interval_s),
            Err(time_s) => Double::of(time_s[k + 1]) - Double::of(time_s[k]),
        };
        let (w0, w1) = (rate(k), rate(k + 1));
        let cubic = is_cubic.then(|| (rate(k - 1), rate(k + 2)));
        let s: Vector = std::array::from_fn(|c| {
            let inner = w0[c] + w1[c];
            match cubic {
                None => inner * h * Double::of(0.5),
                Some((before, after)) => {
                    (inner * Double::of(13.0) - (before[c] + after[c])) * h * twelfth * Double::of(0.5)
                }
            }
        });
        let square = h * h * twelfth;
        let cross: Vector = std::array::from_fn(|c| {
            let (i, j) = ((c + 1) % 3, (c + 2) % 3);
            (w0[i] * w1[j] - w0[j] * w1[i]) * square
        });
        let phi = hat_of(&std::array::from_fn(|c| s[c] + cross[c]));
        let (before, step) = (rotation, k - margin);
        rotation = product(&rotation, &exponential(&phi));
        if step >= at_nodes {
            for (rotation, rate) in [(&before, &w0), (&rotation, &w1)] {
                add(&mut sums, &scaled(rotation, h * Double::of(0.5)), rate, Double::of(1.0));
            }
            continue;
        }
        // The derivative R' = R [w]x, multiplied by h^2 / 6, where h is the time step. The vectorised integration
        // multiplies all rates by h / 6, and each of the factors R' and D (see `sums.rs`) contains one rate. The sums
        // of the vectorised integration are finally multiplied by 6. Together, this gives (h / 6)^2 x 6 = h^2 / 6.
        let derivative = |rotation: &Square, rate: &Vector| {
            scaled(&product(rotation, &hat_of(rate)), h * h * third * Double::of(0.5))
        };
        let n = STEPS_OF_A_NODE;
        for (is_end, sign, rotation, rate) in
            [(step == 0, -1.0, &before, &w0), (step + 1 == at_nodes, 1.0, &rotation, &w1)]
        {
            if is_end {
                let factor = Double::of(sign * 6.0 * SECOND * (n * n) as f64);
                add(&mut sums, &scaled(&derivative(rotation, rate), factor), rate, Double::of(1.0));
            }
        }
        if step % n + 1 == n / 2 {
            let (begin, middle, end) = (k + 1 - n / 2, k + 1, k + 1 + n / 2);
            let of_half = |from: usize, to: usize| -> Vector {
                std::array::from_fn(|c| {
                    (from..to).fold(Double::of(0.0), |sum, k| sum + (rate(k)[c] + rate(k + 1)[c]) * Double::of(0.5))
                })
            };
            let (left, right) = (of_half(begin, middle), of_half(middle, end));
            let (w_begin, w_end) = (rate(begin), rate(end));
            let whole: Vector = std::array::from_fn(|c| left[c] + right[c]);
            let late: Vector = std::array::from_fn(|c| {
                (right[c] - left[c]) * Double::of(BY_HALVES) + (w_end[c] - w_begin[c]) * Double::of(BY_ENDS)
            });
            let by_time = scaled(&rotation, h);
            add(&mut sums, &by_time, &whole, Double::of(n as f64));
            add(&mut sums, &derivative(&rotation, &rate(middle)), &late, Double::of(0.0));
        }
    }
    let [x, y, z, bias] = sums;
    let [x, y, z] = with_the_turn([x, y, z], &rotation, &rate_segment::Frame::of(triad, 1.0).axes);
    [rotation, x, y, z, bias]
}

/// Adds R times each component of the rate, and R times a weight, to the sums.
fn add(sums: &mut [Square; 4], rotation: &Square, rate: &Vector, weight: Double) {
    for j in 0..3 {
        sums[j] = plus(&sums[j], &scaled(rotation, rate[j]));
    }
    sums[3] = plus(&sums[3], &scaled(rotation, weight));
}

/// Computes the sums that the vectorised integration does not accumulate. In the sum for a rate component, these are
/// the columns whose index is above the index of the rate component. They are computed from the rotation and the
/// accumulated sums, in the frame with the axes `axes`.
fn with_the_turn(sums: [Square; 3], rotation: &Square, axes: &Matrix3<f64>) -> [Square; 3] {
    let out: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(axes[(r, c)])));
    let back: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(axes[(c, r)])));
    let seen_along = |sums: &[Square; 3], shares: [Double; 3]| {
        plus(&plus(&scaled(&sums[0], shares[0]), &scaled(&sums[1], shares[1])), &scaled(&sums[2], shares[2]))
    };
    let within = |m: &Square| product(&product(&back, m), &out);
    let mut inside: [Square; 3] =
        std::array::from_fn(|i| within(&seen_along(&sums, std::array::from_fn(|j| out[j][i]))));
    let turned = within(rotation);
    let unit = |r: usize, c: usize| Double::of(f64::from(u8::from(r == c)));
    for r in 0..3 {
        // Changes of the entries of R in row r and the columns x, y and z. They are the integrals of R' = R [w]x.
        let of_x = turned[r][0] - unit(r, 0);
        let of_y = turned[r][1] - unit(r, 1);
        let of_z = turned[r][2] - unit(r, 2);
        inside[0][r][1] = inside[1][r][0] - of_z;
        inside[0][r][2] = inside[2][r][0] + of_y;
        inside[1][r][2] = inside[2][r][1] - of_x;
    }
    let outside = |m: &Square| product(&product(&out, m), &back);
    std::array::from_fn(|j| outside(&seen_along(&inside, out[j])))
}
