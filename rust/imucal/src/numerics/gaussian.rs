//! Evaluates Gaussian kernels `exp(-x^2 / 2)` with vector instructions.

use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;

/// Replaces each square `x^2` by `exp(-x^2 / 2)` with a relative error of at most 4e-16. A result below 1e-300 is not
/// accurate, but it remains below 1e-300.
pub(crate) fn gaussian_kernels(squares: &mut [f64]) {
    Instructions::Best.run(Kernels(squares));
}

/// The computation of [`gaussian_kernels`] for the given squares, with the widest vector instructions of the processor.
struct Kernels<'a>(&'a mut [f64]);

impl WithSimd for Kernels<'_> {
    type Output = ();

    /// Loops over all squares without branches, so that the compiler can vectorise the loop for the widest registers.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.iter_mut().for_each(|square| *square = exp(-0.5 * *square));
    }
}

/// `exp(x)` for `x <= 0`, computed as `2^n exp(r)`. n is the integer nearest to x / ln 2, and the remainder
/// `r = x - n ln 2` is at most half of ln 2 in absolute value.
#[inline(always)]
fn exp(x: f64) -> f64 {
    /// Smaller values of x are replaced by this limit. For x below about -708, a normal number of double precision
    /// cannot represent 2^n.
    const LEAST: f64 = -700.0;
    /// 1.5 * 2^52. If a number is added to this constant, the lowest bits of the sum contain the number rounded to the
    /// nearest integer.
    const ROUNDS: f64 = 6_755_399_441_055_744.0;
    /// ln 2 as the sum of two numbers, which makes r more accurate. The first number has so few digits that its product
    /// with n is exact.
    const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
    /// Coefficients of the Taylor series of exp, from 1 / 13! to 1 / 2!.
    const TAYLOR: [f64; 12] = [
        1.0 / 6_227_020_800.0,
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
    ];
    let x = if x < LEAST { LEAST } else { x };
    let rounded = x * std::f64::consts::LOG2_E + ROUNDS;
    let n = rounded - ROUNDS;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let sum = TAYLOR.iter().fold(0.0, |sum, coefficient| sum * r + coefficient);
    let exp_r = 1.0 + (r + r * r * sum);
    // The lowest bits of `rounded` are the integer n. Adding n to the exponent bits of a number multiplies the number
    // by 2^n.
    f64::from_bits(exp_r.to_bits().wrapping_add(rounded.to_bits() << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_are_exponentials_to_rounding() {
        let squares: Vec<f64> = (0..20_000).map(|k| 0.07 * f64::from(k)).collect();
        let mut kernels = squares.clone();
        gaussian_kernels(&mut kernels);
        for (square, kernel) in squares.iter().zip(kernels) {
            let expected = (-0.5 * square).exp();
            assert!((kernel - expected).abs() <= 4e-16 * expected, "{square}: {kernel} {expected}");
        }
        let mut edges = [0.0, 1e9, f64::INFINITY];
        gaussian_kernels(&mut edges);
        assert!(edges[0] == 1.0 && edges[1] < 1e-300 && edges[2] < 1e-300, "{edges:?}");
    }

    #[test]
    fn a_kernel_of_no_number_is_none() {
        let mut kernels = [f64::NAN];
        gaussian_kernels(&mut kernels);
        assert!(kernels[0].is_nan());
    }
}
