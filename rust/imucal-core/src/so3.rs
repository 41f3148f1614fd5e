//! Rotations. All conventions about rotations are defined here.
//!
//! 1. `r_wb` maps the components of a vector in the body frame to its components in the world frame. In a product, the
//!    adjacent letters of the subscripts are equal: `v_w = r_wb * v_b`, `r_wb = r_ws * r_sb`. As an operator on
//!    vectors, a rotation is active: it rotates the vector and not the frame.
//! 2. A quaternion follows Hamilton's convention (`i j = k`) and is written `[w, x, y, z]` in every array. nalgebra
//!    *stores* x, y, z, w; only [`to_wxyz`] and [`from_wxyz`] convert between the two orders. `q` and `-q` are the same
//!    rotation.
//! 3. `exp` maps a rotation vector (axis times angle, rad) to a rotation. `log` maps a rotation to its rotation vector,
//!    whose length is at most pi.
//! 4. An attitude error `delta` is defined in the body frame, `R exp(delta)`. The Jacobian of `exp` is therefore the
//!    right Jacobian:
//!
//! ```text
//! exp(phi + d) = exp(phi) exp(J_r(phi) d) + O(d^2)
//! J_r(phi) = I - ((1 - cos t) / t^2) [phi]x + ((t - sin t) / t^3) [phi]x^2,   t = |phi|
//! ```
//!
//! `[phi]x` is the matrix of the cross product with phi ([`hat`]). All functions are accurate to about a rounding
//! error, in f32 and in f64, also for the angle zero, for tiny angles and for angles near pi.

use crate::vector::{dot, scaled};
use nalgebra::{Matrix3, Quaternion, RealField, UnitQuaternion, Vector3, convert};

/// Rotation for the rotation vector `phi`, rad: a rotation by the angle `|phi|` about the axis `phi`.
///
/// For angles up to half a radian, the function uses polynomials instead of trigonometric functions. The angle between
/// two samples is practically always smaller than half a radian.
#[inline]
pub fn exp<F: RealField + Copy>(phi: &Vector3<F>) -> UnitQuaternion<F> {
    let (cosine, sinc) = cos_and_sinc(dot(phi, phi) * convert(0.25));
    let imaginary = scaled(phi, sinc * convert(0.5));
    UnitQuaternion::new_unchecked(Quaternion::new(cosine, imaginary.x, imaginary.y, imaginary.z))
}

/// The product `a b` of two rotations, normalised to length one.
///
/// Rounding changes the length of a product of quaternions. Without normalisation, the length would deviate noticeably
/// from one after millions of products.
#[inline]
pub(crate) fn product<F: RealField + Copy>(a: &UnitQuaternion<F>, b: &UnitQuaternion<F>) -> UnitQuaternion<F> {
    let w = a.w * b.w - a.i * b.i - a.j * b.j - a.k * b.k;
    let i = a.w * b.i + a.i * b.w + a.j * b.k - a.k * b.j;
    let j = a.w * b.j - a.i * b.k + a.j * b.w + a.k * b.i;
    let k = a.w * b.k + a.i * b.j - a.j * b.i + a.k * b.w;
    // One step of Newton's method for 1 / length. One step is sufficient, because the length is close to one.
    let square = (i * i + k * k) + (j * j + w * w);
    let correction: F = convert::<f64, F>(0.5) * (convert::<f64, F>(3.0) - square);
    UnitQuaternion::new_unchecked(Quaternion::new(w * correction, i * correction, j * correction, k * correction))
}

/// Rotation vector of a rotation, rad, of length at most pi.
///
/// If the angle is exactly pi, two rotation vectors of opposite sign represent the rotation. The function returns one
/// of them.
#[inline]
pub fn log<F: RealField + Copy>(rotation: &UnitQuaternion<F>) -> Vector3<F> {
    // atan2(length of the imaginary part, real part) is accurate at all angles. acos(real part) would lose digits at
    // small angles.
    let sign = if rotation.w < F::zero() { -F::one() } else { F::one() };
    let (real, imaginary) = (rotation.w * sign, rotation.imag() * sign);
    let length = imaginary.norm();
    let two: F = convert(2.0);
    let angle_per_length = if length > F::zero() { two * length.atan2(real) / length } else { two / real };
    imaginary * angle_per_length
}

/// Cross product matrix: `hat(a) * b = a x b`.
#[inline]
pub fn hat<F: RealField + Copy>(a: &Vector3<F>) -> Matrix3<F> {
    let o = F::zero();
    Matrix3::new(o, -a.z, a.y, a.z, o, -a.x, -a.y, a.x, o)
}

/// Right Jacobian of [`exp`], 3x3: `exp(phi + d) = exp(phi) exp(right_jacobian(phi) d)` to first order in `d`, rad.
pub fn right_jacobian<F: RealField + Copy>(phi: &Vector3<F>) -> Matrix3<F> {
    let t2 = phi.norm_squared();
    let (_, sinc) = cos_and_sinc(t2 * convert(0.25));
    // With t = |phi|: (1 - cos t)/t^2 = (sin(t/2)/(t/2))^2 / 2. The right-hand side avoids the subtraction of nearly
    // equal numbers.
    let first = sinc * sinc * convert(0.5);
    let second = if t2 < F::one() {
        polynomial(t2, T_MINUS_SIN)
    } else {
        let t = t2.sqrt();
        (t - t.sin()) / (t2 * t)
    };
    let cross = hat(phi);
    Matrix3::identity() - cross * first + cross * cross * second
}

/// Quaternion of a rotation as the array `[w, x, y, z]`.
#[inline]
pub fn to_wxyz<F: RealField + Copy>(rotation: &UnitQuaternion<F>) -> [F; 4] {
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

/// Rotation for the quaternion `[w, x, y, z]`, normalised to length one; `None` if its length is zero or not finite.
pub fn from_wxyz<F: RealField + Copy>([w, x, y, z]: [F; 4]) -> Option<UnitQuaternion<F>> {
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    (length > F::zero() && length.is_finite()).then(|| UnitQuaternion::new_unchecked(quaternion / length))
}

/// `(cos h, sin(h) / h)` as a function of `h^2`.
#[inline]
fn cos_and_sinc<F: RealField + Copy>(h2: F) -> (F, F) {
    if h2 < convert(0.0625) {
        (polynomial(h2, COS), polynomial(h2, SINC))
    } else {
        let h = h2.sqrt();
        let (sine, cosine) = h.sin_cos();
        (cosine, sine / h)
    }
}

/// Taylor coefficients in h^2 of cos h, highest power first. The first omitted term is below 2^-52 for h^2 < 1/16.
const COS: [f64; 6] = [-1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0, 1.0];

/// Taylor coefficients in h^2 of sin(h)/h, highest power first. The first omitted term is below 2^-52 for h^2 < 1/16.
const SINC: [f64; 6] = [-1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0];

/// Taylor coefficients in t^2 of (t - sin t)/t^3, where t is a rotation angle in rad; highest power first. The first
/// omitted term is below 2^-52 times the sum of the series for t^2 < 1.
const T_MINUS_SIN: [f64; 8] = [
    -1.0 / 355_687_428_096_000.0,
    1.0 / 1_307_674_368_000.0,
    -1.0 / 6_227_020_800.0,
    1.0 / 39_916_800.0,
    -1.0 / 362_880.0,
    1.0 / 5_040.0,
    -1.0 / 120.0,
    1.0 / 6.0,
];

/// Value of a polynomial by Horner's rule. The coefficients are ordered from the highest power to the constant.
#[inline]
fn polynomial<F: RealField + Copy, const N: usize>(x: F, coefficients: [f64; N]) -> F {
    let mut sum = F::zero();
    for &c in &coefficients {
        sum = sum * x + convert(c);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;

    /// Test angles, rad, of all orders of magnitude. They include values near pi, and values just below and above 0.5
    /// and 1, where the functions switch from polynomials to trigonometric functions.
    const ANGLES: [f64; 16] = [
        0.0,
        1e-200,
        1e-160,
        1e-12,
        1e-8,
        1e-4,
        0.01,
        0.499_999,
        0.500_001,
        0.999_999,
        1.000_001,
        2.0,
        3.0,
        PI - 1e-4,
        PI - 1e-9,
        PI - 1e-15,
    ];

    fn axes() -> [Vector3<f64>; 4] {
        [
            Vector3::x(),
            Vector3::new(0.0, -1.0, 0.0),
            Vector3::new(1.0, 2.0, -2.0) / 3.0,
            Vector3::new(-2.0, 3.0, 6.0) / 7.0,
        ]
    }

    #[test]
    fn exp_is_the_half_angle_formula() {
        for axis in axes() {
            for angle in ANGLES {
                let q = exp(&(axis * angle));
                let (sine, cosine) = (angle / 2.0).sin_cos();
                assert!((q.w - cosine).abs() < 4e-16, "angle {angle}");
                assert!((q.imag() - axis * sine).norm() <= 6e-16 * sine + 1e-210, "angle {angle}");
            }
        }
    }

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let r = exp(&Vector3::new(0.0, 0.0, PI / 2.0));
        assert!((r * Vector3::x() - Vector3::y()).norm() < 1e-15);
    }

    #[test]
    fn log_undoes_exp() {
        for axis in axes() {
            for angle in ANGLES {
                let phi = axis * angle;
                let back = log(&exp(&phi));
                assert!((back - phi).norm() <= 1e-15 * angle, "angle {angle}: off by {}", (back - phi).norm());
            }
        }
    }

    #[test]
    fn log_undoes_exp_in_f32() {
        for angle in ANGLES.iter().map(|&a| a as f32).filter(|&a| a == 0.0 || a > 1e-15) {
            let phi = Vector3::new(1.0f32, 2.0, -2.0) / 3.0 * angle;
            let back = log(&exp(&phi));
            // Rounding to f32 makes the largest angles exceed pi. `log` then returns the rotation vector of opposite
            // direction for the same rotation.
            let off = (back - phi).norm().min((back + phi).norm());
            assert!(off <= 6e-7 * angle, "angle {angle}: off by {off}");
        }
    }

    #[test]
    fn log_takes_either_sign_of_the_quaternion() {
        let q = exp(&Vector3::new(0.3, -0.2, 0.9));
        assert!((log(&UnitQuaternion::new_unchecked(-q.into_inner())) - log(&q)).norm() < 1e-15);
    }

    #[test]
    fn right_jacobian_meets_a_central_difference() {
        let h = 1e-5;
        for axis in axes() {
            for angle in ANGLES {
                let phi = axis * angle;
                let jacobian = right_jacobian(&phi);
                for column in 0..3 {
                    let step = Vector3::ith(column, h);
                    let forward = log(&(exp(&phi).inverse() * exp(&(phi + step))));
                    let backward = log(&(exp(&phi).inverse() * exp(&(phi - step))));
                    let difference = (forward - backward) / (2.0 * h);
                    assert!((jacobian.column(column) - difference).norm() < 1e-10, "angle {angle}");
                }
            }
        }
    }

    #[test]
    fn right_jacobian_is_good_to_rounding() {
        // The identities J_r(phi) phi = phi and J_r(phi)^T = exp(phi) J_r(phi) test every term of the Jacobian.
        for axis in axes() {
            for angle in ANGLES {
                let phi = axis * angle;
                let jacobian = right_jacobian(&phi);
                assert!((jacobian * phi - phi).norm() <= 1e-15 * angle);
                let rotation = exp(&phi).to_rotation_matrix();
                assert!((jacobian.transpose() - rotation.matrix() * jacobian).norm() < 2e-15, "angle {angle}");
            }
        }
    }

    #[test]
    fn hat_is_the_cross_product() {
        let (a, b) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 4.0, -1.0));
        assert_eq!(hat(&a) * b, a.cross(&b));
    }

    #[test]
    fn arrays_are_wxyz() {
        let q = exp(&Vector3::new(0.0, 0.0, PI / 2.0));
        let [w, x, y, z] = to_wxyz(&q);
        let half = 0.5_f64.sqrt();
        assert!((w - half).abs() < 1e-15 && x == 0.0 && y == 0.0 && (z - half).abs() < 1e-15);
        assert_eq!(from_wxyz([2.0 * w, x, y, 2.0 * z]).map(|back| back.angle_to(&q) < 1e-15), Some(true));
        assert_eq!(from_wxyz([0.0, 0.0, 0.0, 0.0]), None);
        assert_eq!(from_wxyz([f64::NAN, 0.0, 0.0, 1.0]), None);
    }
}
