//! Selects the vector instructions of the inner loops (kernels). The crate `pulp` selects the widest instructions of
//! the processor at run time.
//!
//! The environment variable `IMUCAL_VECTOR_BITS` selects the width of the vectors instead, so that a test can compare
//! the results of different processors. `512` selects the width of AVX-512, `256` that of AVX2, and `64` no vectors.
//! The variable is read once. On a processor without AVX-512, `512` needs the Cargo feature `emulate-avx512`, which
//! makes the library larger by half.

use std::sync::OnceLock;

use pulp::{Arch, Simd, WithSimd};

/// Instruction set with which a kernel (inner loop) runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Instructions {
    /// The widest vector instructions of this processor, unless the environment variable `IMUCAL_VECTOR_BITS` selects
    /// another width.
    Best,
    /// Vector instructions of 512 bits (AVX-512).
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// Vector instructions of 256 bits with fused multiply-add (AVX2).
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// One number per instruction, on any processor.
    Scalar,
}

impl Instructions {
    /// [`Best`](Self::Best), and all instruction sets that this processor has.
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

    /// Runs `work` with these instructions. If the processor does not have them, the best available instructions are
    /// used. With the Cargo feature `emulate-avx512`, the instructions of AVX-512 are emulated instead.
    #[inline(always)]
    pub(crate) fn run<W: WithSimd>(self, work: W) -> W::Output {
        match if self == Self::Best { selected() } else { self } {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => match pulp::x86::V4::try_new() {
                Some(simd) => Simd::vectorize(simd, work),
                None => without_avx512(work),
            },
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => match pulp::x86::V3::try_new() {
                Some(simd) => Simd::vectorize(simd, work),
                None => Arch::new().dispatch(work),
            },
            Self::Scalar => work.with_simd(pulp::Scalar),
            Self::Best => Arch::new().dispatch(work),
        }
    }
}

/// The instructions that the environment variable `IMUCAL_VECTOR_BITS` selects.
fn selected() -> Instructions {
    static SELECTED: OnceLock<Instructions> = OnceLock::new();
    *SELECTED.get_or_init(|| match std::env::var("IMUCAL_VECTOR_BITS").as_deref() {
        #[cfg(target_arch = "x86_64")]
        Ok("512") => Instructions::Avx512,
        #[cfg(target_arch = "x86_64")]
        Ok("256") => Instructions::Avx2,
        Ok("64") => Instructions::Scalar,
        _ => Instructions::Best,
    })
}

/// Runs `work` with the best instructions of a processor that lacks AVX-512.
#[cfg(all(target_arch = "x86_64", not(feature = "emulate-avx512")))]
#[inline(always)]
fn without_avx512<W: WithSimd>(work: W) -> W::Output {
    Arch::new().dispatch(work)
}

/// Runs `work` with arrays of eight numbers instead of registers. Every number is computed by the same operations in
/// the same order as with AVX-512.
#[cfg(all(target_arch = "x86_64", feature = "emulate-avx512"))]
fn without_avx512<W: WithSimd>(work: W) -> W::Output {
    match pulp::x86::V3::try_new() {
        // The loops over the arrays are compiled with fused multiply-add instructions. Without these instructions, each
        // multiply-add would be a function call.
        Some(simd) => Simd::vectorize(simd, InArrays(work)),
        None => work.with_simd(pulp::Scalar512b),
    }
}

/// Wrapper that runs the contained work with arrays of eight numbers, whichever instructions are selected.
#[cfg(all(target_arch = "x86_64", feature = "emulate-avx512"))]
struct InArrays<W>(W);

#[cfg(all(target_arch = "x86_64", feature = "emulate-avx512"))]
impl<W: WithSimd> WithSimd for InArrays<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> W::Output {
        self.0.with_simd(pulp::Scalar512b)
    }
}
