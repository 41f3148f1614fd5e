//! Several numbers side by side in one register: `pulp` chooses the instructions at run time, the operators are spelt here.

use std::ops::{Add, Div, Mul, Sub};

use nalgebra::{Quaternion, UnitQuaternion};
use pulp::bytemuck::cast;
use pulp::{Arch, Simd, WithSimd};

use crate::numerics::aligned::WIDEST;

/// The most lanes that any instruction set has.
pub(super) const MOST_LANES: usize = WIDEST;

/// The instructions that a kernel is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Instructions {
    /// The widest vectors that this processor has.
    Best,
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 256-bit vectors with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// One number at a time, on any processor.
    Scalar,
}

impl Instructions {
    /// All sets that this processor has, and [`Best`](Self::Best).
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self::Best];
        #[cfg(target_arch = "x86_64")]
        {
            all.extend(pulp::x86::V4::try_new().map(|_| Self::Avx512));
            all.extend(pulp::x86::V3::try_new().map(|_| Self::Avx2));
        }
        all.push(Self::Scalar);
        all
    }

    /// Does `work` with these instructions, or with the best ones if the processor lacks them.
    pub(super) fn run<W: WithSimd>(self, work: W) -> W::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                if let Some(simd) = pulp::x86::V4::try_new() {
                    return Simd::vectorize(simd, work);
                }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    return Simd::vectorize(simd, work);
                }
            }
            Self::Scalar => return work.with_simd(pulp::Scalar),
            Self::Best => {}
        }
        Arch::new().dispatch(work)
    }
}

/// One number in each lane.
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

    /// `value(l)` in lane l. An array of this length in a register is what the compiler makes shuffles of; a longer one in memory,
    /// written in parts and read as a whole, would wait for its own stores.
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

    /// The number in each lane; zero for lanes that are not there.
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
    pub(super) fn times_plus(self, b: Self, c: Self) -> Self {
        Self { value: self.simd.mul_add_e_f64s(self.value, b.value, c.value), ..self }
    }

    /// `c - self * b`.
    #[inline(always)]
    pub(super) fn times_from(self, b: Self, c: Self) -> Self {
        Self { value: self.simd.negate_mul_add_e_f64s(self.value, b.value, c.value), ..self }
    }

    /// The lanes added up.
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

/// Three numbers in each lane.
pub(super) type Three<S> = [Lanes<S>; 3];

/// Three numbers by their place. An array's `map` is not always inlined, and then its vectors go through memory.
#[inline(always)]
pub(super) fn three<S: Simd>(part: impl Fn(usize) -> Lanes<S>) -> Three<S> {
    [part(0), part(1), part(2)]
}

/// The square of the length.
#[inline(always)]
pub(super) fn square<S: Simd>(v: &Three<S>) -> Lanes<S> {
    v[0].times_plus(v[0], v[1].times_plus(v[1], v[2] * v[2]))
}

/// `a x b`.
#[inline(always)]
pub(super) fn cross<S: Simd>(a: &Three<S>, b: &Three<S>) -> Three<S> {
    let part = |i: usize, k: usize| a[k].times_from(b[i], a[i] * b[k]);
    [part(1, 2), part(2, 0), part(0, 1)]
}

/// Where a lane's own stretch of so many begins; lanes that are not there read the first one.
#[inline(always)]
pub(super) fn begin_of<S: Simd>(lane: usize, count: usize) -> usize {
    if lane < S::F64_LANES { lane * count } else { 0 }
}

/// A quaternion in each lane.
pub(super) struct Quaternions([[f64; MOST_LANES]; 4]);

impl Quaternions {
    #[inline(always)]
    pub(super) fn new<S: Simd>([w, x, y, z]: &[Lanes<S>; 4]) -> Self {
        Self([w.to_array(), x.to_array(), y.to_array(), z.to_array()])
    }

    /// That of a lane, its length made one.
    #[inline(always)]
    pub(super) fn unit(&self, lane: usize) -> UnitQuaternion<f64> {
        let [w, x, y, z] = &self.0;
        UnitQuaternion::new_normalize(Quaternion::new(w[lane], x[lane], y[lane], z[lane]))
    }
}

/// Asks for the memory of as many samples as there are here, `ahead` samples after them, before it is needed.
///
/// The lanes read eight places at once, more than the processor follows by itself: without this a rotation takes a fifth longer.
#[inline(always)]
pub(super) fn fetch_soon(samples: &[[f64; 3]], ahead: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        const LINE: usize = 64;
        let start = samples.as_ptr().wrapping_add(ahead).cast::<i8>();
        for line in 0..size_of_val(samples) / LINE {
            // SAFETY: a prefetch is a hint; it reads nothing that the program sees and does not fault, wherever it points.
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
