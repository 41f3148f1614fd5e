//! Numbers in memory that begin where a cache line does, so that no register of them lies across two.

use std::ops::{Deref, DerefMut};

use pulp::bytemuck::{cast_slice, cast_slice_mut};
use wide::f64x8;

/// As many numbers as the widest register has, and a cache line.
pub(crate) const WIDEST: usize = 8;

/// A list of numbers, so many times [`WIDEST`].
#[derive(Clone, Default)]
pub(crate) struct Aligned(Vec<f64x8>);

impl Aligned {
    /// None, with room for so many.
    pub(crate) fn with_capacity(numbers: usize) -> Self {
        Self(Vec::with_capacity(numbers.div_ceil(WIDEST)))
    }

    /// So many zeros.
    pub(crate) fn zeros(numbers: usize) -> Self {
        Self(vec![f64x8::ZERO; numbers.div_ceil(WIDEST)])
    }

    /// Makes them so many; new ones are zero.
    #[inline(always)]
    pub(crate) fn resize(&mut self, numbers: usize) {
        self.0.resize(numbers.div_ceil(WIDEST), f64x8::ZERO);
    }
}

impl Deref for Aligned {
    type Target = [f64];

    #[inline(always)]
    fn deref(&self) -> &[f64] {
        cast_slice(&self.0)
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f64] {
        cast_slice_mut(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_a_cache_line_and_new_ones_are_zero() {
        let mut numbers = Aligned::zeros(3 * WIDEST);
        numbers.iter_mut().for_each(|number| *number = 1.0);
        numbers.resize(500 * WIDEST);
        assert_eq!((numbers.as_ptr() as usize) % 64, 0);
        assert_eq!((numbers.len(), numbers.iter().sum::<f64>()), (500 * WIDEST, 24.0));
        assert!(Aligned::with_capacity(5).is_empty());
    }
}
