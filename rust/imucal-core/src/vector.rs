//! Arithmetic of 3-vectors and 3x3 matrices, component by component.
//!
//! The operators of nalgebra compare the sizes of vectors at run time unless the optimiser removes the comparisons. At
//! `opt-level = "z"`, the comparisons and their panics remain, and a product of a matrix and a vector takes several
//! times as many instructions. The functions of this module cannot panic at any optimisation level, and they round
//! exactly as the operators of nalgebra do.

use nalgebra::{Matrix3, RealField, Vector3};

#[inline(always)]
pub(crate) fn add<F: RealField + Copy>(a: &Vector3<F>, b: &Vector3<F>) -> Vector3<F> {
    Vector3::new(a.x + b.x, a.y + b.y, a.z + b.z)
}

#[inline(always)]
pub(crate) fn sub<F: RealField + Copy>(a: &Vector3<F>, b: &Vector3<F>) -> Vector3<F> {
    Vector3::new(a.x - b.x, a.y - b.y, a.z - b.z)
}

#[inline(always)]
pub(crate) fn neg<F: RealField + Copy>(a: &Vector3<F>) -> Vector3<F> {
    Vector3::new(-a.x, -a.y, -a.z)
}

#[inline(always)]
pub(crate) fn scaled<F: RealField + Copy>(a: &Vector3<F>, factor: F) -> Vector3<F> {
    Vector3::new(a.x * factor, a.y * factor, a.z * factor)
}

/// Component-wise product.
#[inline(always)]
pub(crate) fn each<F: RealField + Copy>(a: &Vector3<F>, b: &Vector3<F>) -> Vector3<F> {
    Vector3::new(a.x * b.x, a.y * b.y, a.z * b.z)
}

#[inline(always)]
pub(crate) fn dot<F: RealField + Copy>(a: &Vector3<F>, b: &Vector3<F>) -> F {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[inline(always)]
pub(crate) fn cross<F: RealField + Copy>(a: &Vector3<F>, b: &Vector3<F>) -> Vector3<F> {
    Vector3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

/// Product of a matrix and a vector.
#[inline]
pub(crate) fn product<F: RealField + Copy>(m: &Matrix3<F>, v: &Vector3<F>) -> Vector3<F> {
    Vector3::new(
        m.m11 * v.x + m.m12 * v.y + m.m13 * v.z,
        m.m21 * v.x + m.m22 * v.y + m.m23 * v.z,
        m.m31 * v.x + m.m32 * v.y + m.m33 * v.z,
    )
}

#[inline(always)]
pub(crate) fn magnitude<F: RealField + Copy>(x: F) -> F {
    if x < F::zero() { -x } else { x }
}

/// Largest absolute value of the components that are not NaN. The result is NaN if all components are NaN.
#[inline]
pub(crate) fn largest<F: RealField + Copy>(v: &Vector3<F>) -> F {
    larger(larger(magnitude(v.x), magnitude(v.y)), magnitude(v.z))
}

#[inline(always)]
#[allow(clippy::eq_op)] // NaN is the value that differs from itself.
fn larger<F: RealField + Copy>(a: F, b: F) -> F {
    if b > a || a != a { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arithmetic_is_that_of_nalgebra_to_the_last_bit() {
        let vectors = [
            Vector3::new(0.1_f32, -0.7, 1.3),
            Vector3::new(-9.81, 3e-3, 12.7),
            Vector3::new(1e30, -1e-30, 0.0),
            Vector3::new(-0.0, 33.3, -1.0 / 3.0),
        ];
        for a in vectors {
            let m = Matrix3::new(a.x, a.z, 0.3, a.y, -1.1, a.x, 7.0, 1e-3, a.z);
            for b in vectors {
                assert_eq!(add(&a, &b), a + b);
                assert_eq!(sub(&a, &b), a - b);
                assert_eq!(scaled(&a, b.x), a * b.x);
                assert_eq!(each(&a, &b), a.component_mul(&b));
                assert_eq!(dot(&a, &b), a.dot(&b));
                assert_eq!(cross(&a, &b), a.cross(&b));
                assert_eq!(product(&m, &b), m * b);
            }
            assert_eq!((neg(&a), largest(&a)), (-a, a.amax()));
        }
    }

    #[test]
    fn the_largest_component_ignores_nan() {
        for v in [[f64::NAN, -2.0, 1.0], [-2.0, f64::NAN, 1.0], [1.0, -2.0, f64::NAN]] {
            assert_eq!(largest(&Vector3::from(v)), 2.0);
        }
        assert!(largest(&Vector3::repeat(f64::NAN)).is_nan());
    }
}
