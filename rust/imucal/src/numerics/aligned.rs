//! Lists of numbers whose memory starts at a cache line. The values of one SIMD register are then never split between
//! two cache lines.

use std::ops::{Deref, DerefMut};

/// Number of `f64` values in the widest SIMD register, which equals the number in a cache line.
pub(crate) const WIDEST: usize = 8;
/// Size of a cache line of current processors, bytes.
const CACHE_LINE_BYTES: usize = 64;

/// A list of numbers that starts at a cache line. Its length is a multiple of [`WIDEST`].
#[derive(Default)]
pub(crate) struct Aligned {
    /// Storage. Up to [`WIDEST`] - 1 values before the first cache-line boundary are unused.
    buffer: Vec<f64>,
    /// Index in `buffer` of the first value of the list.
    start: usize,
    /// Number of values in the list.
    len: usize,
}

impl Aligned {
    /// An empty list with capacity for `numbers` values.
    pub(crate) fn with_capacity(numbers: usize) -> Self {
        Self { len: 0, ..Self::zeros(numbers) }
    }

    /// A list of zeros; its length is `numbers` rounded up to a multiple of [`WIDEST`].
    pub(crate) fn zeros(numbers: usize) -> Self {
        let len = numbers.next_multiple_of(WIDEST);
        let buffer = vec![0.0; if len == 0 { 0 } else { len + WIDEST - 1 }];
        let start = buffer.as_ptr().align_offset(CACHE_LINE_BYTES).min(buffer.len() - len);
        Self { buffer, start, len }
    }

    /// Changes the length to `numbers`, rounded up to a multiple of [`WIDEST`]. New values are zero.
    #[inline(always)]
    pub(crate) fn resize(&mut self, numbers: usize) {
        let len = numbers.next_multiple_of(WIDEST);
        if self.start + len > self.buffer.len() {
            let mut larger = Self::zeros(len.max(2 * self.len));
            larger.buffer[larger.start..][..self.len].copy_from_slice(self);
            larger.len = len;
            *self = larger;
        } else {
            let (new, start) = (len.max(self.len), self.start);
            self.buffer[start + self.len..start + new].fill(0.0);
            self.len = len;
        }
    }
}

impl Clone for Aligned {
    /// Copies the values to an aligned position. In a plain copy of the buffer, the value at the index `start` would in
    /// general not be at a cache-line boundary.
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Aligned {
    type Target = [f64];

    #[inline(always)]
    fn deref(&self) -> &[f64] {
        &self.buffer[self.start..self.start + self.len]
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.buffer[self.start..self.start + self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_a_cache_line_and_new_ones_are_zero() {
        let mut numbers = Aligned::zeros(3 * WIDEST);
        numbers.iter_mut().for_each(|number| *number = 1.0);
        for len in [500, 2, 4] {
            numbers.resize(len * WIDEST);
            let ones = len.min(3).min(numbers.iter().filter(|number| **number == 1.0).count() / WIDEST);
            assert_eq!((numbers.as_ptr() as usize) % CACHE_LINE_BYTES, 0);
            assert_eq!((numbers.len(), numbers.iter().sum::<f64>()), (len * WIDEST, (ones * WIDEST) as f64));
        }
        assert_eq!(numbers.iter().sum::<f64>(), (2 * WIDEST) as f64);
        assert_eq!((numbers.clone().as_ptr() as usize) % CACHE_LINE_BYTES, 0);
        assert!(Aligned::with_capacity(5).is_empty() && Aligned::default().is_empty());
    }
}
