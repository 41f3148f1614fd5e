//! SIMD vectors of numbers. The crate `pulp` selects the instruction set at run time; this file defines the arithmetic
//! operators.

use std::ops::{Add, Div, Mul, Sub};

use nalgebra::{Quaternion, UnitQuaternion};
use pulp::Simd;
use pulp::bytemuck::cast;

use crate::numerics::aligned::WIDEST;

/// Maximum number of lanes of any instruction set.
pub(super) const MOST_LANES: usize = WIDEST;

/// One number per lane.
#[derive(Clone, Copy)]
pub(super) struct Lanes<S: Simd> {
    simd: S,
    value: S::f64s,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub(super) fn splat(simd: S, value: f64) -> Self {
        Self { simd, value: simd.splat_f64s(value) }
    }

    /// Vector with `value(l)` in lane l. The values are collected in an array that has exactly the length of the
    /// register, so the compiler uses shuffle instructions. A longer array would be written to memory in parts and read
    /// as a whole, which causes a store-forwarding stall.
    #[inline(always)]
    pub(super) fn from_fn(simd: S, value: impl Fn(usize) -> f64) -> Self {
        let v = &value;
        let value = match S::F64_LANES {
            8 => cast([v(0), v(1), v(2), v(3), v(4), v(5), v(6), v(7)]),
            4 => cast([v(0), v(1), v(2), v(3)]),
            2 => cast([v(0), v(1)]),
            _ => cast([v(0)]),
        };
        Self { simd, value }
    }

    /// The numbers in all lanes. Entries beyond the length of the register are zero.
    #[inline(always)]
    pub(super) fn to_array(self) -> [f64; MOST_LANES] {
        let mut all = [0.0; MOST_LANES];
        for (to, from) in all.iter_mut().zip(pulp::bytemuck::cast_slice(&[self.value])) {
            *to = *from;
        }
        all
    }

    /// `self * b + c`.
    #[inline(always)]
    pub(super) fn mul_add(self, b: Self, c: Self) -> Self {
        Self { value: self.simd.mul_add_e_f64s(self.value, b.value, c.value), ..self }
    }

    /// `c - self * b`.
    #[inline(always)]
    pub(super) fn neg_mul_add(self, b: Self, c: Self) -> Self {
        Self { value: self.simd.negate_mul_add_e_f64s(self.value, b.value, c.value), ..self }
    }

    /// Sum over all lanes.
    #[inline(always)]
    pub(super) fn sum(self) -> f64 {
        self.simd.reduce_sum_f64s(self.value)
    }

    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        Self { value: self.simd.max_f64s(self.value, other.value), ..self }
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { value: self.simd.add_f64s(self.value, other.value), ..self }
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { value: self.simd.sub_f64s(self.value, other.value), ..self }
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { value: self.simd.mul_f64s(self.value, other.value), ..self }
    }
}

impl<S: Simd> Div for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self { value: self.simd.div_f64s(self.value, other.value), ..self }
    }
}

/// A 3-vector in each lane. Its x, y and z components are three registers.
pub(super) type Three<S> = [Lanes<S>; 3];

/// A 3-vector from its components. `map` on an array is not used here, because the compiler does not always inline it
/// and would then store the registers in memory.
#[inline(always)]
pub(super) fn three<S: Simd>(part: impl Fn(usize) -> Lanes<S>) -> Three<S> {
    [part(0), part(1), part(2)]
}

/// Squared norm of the vector.
#[inline(always)]
pub(super) fn square<S: Simd>(v: &Three<S>) -> Lanes<S> {
    v[0].mul_add(v[0], v[1].mul_add(v[1], v[2] * v[2]))
}

/// Cross product `a x b`.
#[inline(always)]
pub(super) fn cross<S: Simd>(a: &Three<S>, b: &Three<S>) -> Three<S> {
    let part = |i: usize, k: usize| a[k].neg_mul_add(b[i], a[i] * b[k]);
    [part(1, 2), part(2, 0), part(0, 1)]
}

/// Index of the first element that a lane processes if each lane processes `count` consecutive elements. For lane
/// numbers beyond the length of the register, the index is 0, the first element of lane 0.
#[inline(always)]
pub(super) fn lane_start<S: Simd>(lane: usize, count: usize) -> usize {
    if lane < S::F64_LANES { lane * count } else { 0 }
}

/// One quaternion in each lane. The quaternions are not normalised.
pub(super) struct Quaternions([[f64; MOST_LANES]; 4]);

impl Quaternions {
    #[inline(always)]
    pub(super) fn new<S: Simd>([w, x, y, z]: &[Lanes<S>; 4]) -> Self {
        Self([w.to_array(), x.to_array(), y.to_array(), z.to_array()])
    }

    /// The normalised quaternion of a lane.
    #[inline(always)]
    pub(super) fn unit(&self, lane: usize) -> UnitQuaternion<f64> {
        let [w, x, y, z] = &self.0;
        UnitQuaternion::new_normalize(Quaternion::new(w[lane], x[lane], y[lane], z[lane]))
    }
}

/// Prefetches `samples.len()` samples, beginning `ahead` samples after the start of `samples`.
///
/// Each lane reads its own range of the samples. With eight lanes, these are more memory streams than the hardware
/// prefetcher can follow. Without prefetching, the integration takes a fifth longer.
#[inline(always)]
pub(super) fn prefetch(samples: &[[f64; 3]], ahead: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        const LINE: usize = 64;
        let start = samples.as_ptr().wrapping_add(ahead).cast::<i8>();
        for line in 0..size_of_val(samples) / LINE {
            // SAFETY: a prefetch is a hint. It does not change the state of the program and does not fault, for any
            // address.
            #[expect(unsafe_code, reason = "a hint to the processor; the benchmark of the kernels shows what it buys")]
            unsafe {
                use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
                _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(LINE * line));
            }
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (samples, ahead);
}
