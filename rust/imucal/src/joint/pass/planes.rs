//! Columns of many parameters in many states.
//!
//! A state has three planes, x, y and z, of one number for each parameter, so that as many parameters as a register has lanes take
//! part in each multiplication.

use nalgebra::Vector3;
use pulp::Simd;

use crate::numerics::aligned::{Aligned, WIDEST};

/// Columns of some parameters.
pub(crate) struct Planes {
    /// Their places among all columns.
    parameters: Vec<usize>,
    /// Length of a plane: full registers.
    width: usize,
    numbers: Aligned,
}

impl Planes {
    /// No state yet, and room for so many; the parameters have these places among all columns.
    pub(crate) fn new(parameters: Vec<usize>, states: usize) -> Self {
        let width = parameters.len().next_multiple_of(WIDEST);
        Self { parameters, width, numbers: Aligned::with_capacity(states * 3 * width) }
    }

    /// So many states of zeros.
    pub(super) fn zeros(parameters: Vec<usize>, states: usize) -> Self {
        let mut planes = Self::new(parameters, 0);
        planes.numbers.resize(states * 3 * planes.width);
        planes
    }

    /// Places of the parameters among all columns.
    pub(crate) fn parameters(&self) -> &[usize] {
        &self.parameters
    }

    /// Length of a plane.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// The planes of a next state, all zero.
    #[inline(always)]
    pub(crate) fn next(&mut self) -> &mut [f64] {
        let start = self.numbers.len();
        self.numbers.resize(start + 3 * self.width);
        &mut self.numbers[start..]
    }

    /// The planes of the last state.
    #[inline(always)]
    pub(super) fn last_mut(&mut self) -> &mut [f64] {
        let start = self.numbers.len() - 3 * self.width;
        &mut self.numbers[start..]
    }

    /// Takes the column of a single parameter in the next state.
    pub(crate) fn push_one(&mut self, column: &Vector3<f64>) {
        let width = self.width;
        let state = self.next();
        (0..3).for_each(|axis| state[axis * width] = column[axis]);
    }

    /// Planes of zeros.
    pub(crate) fn zero(&self) -> Vec<f64> {
        vec![0.0; 3 * self.width]
    }

    /// Puts columns in planes as these are, with the other sign, where their parameters have their places.
    pub(crate) fn write_negative(&self, planes: &[f64], to: &mut [Vector3<f64>]) {
        self.parameters.iter().enumerate().for_each(|(k, p)| to[*p] = -self.column(planes, k));
    }

    /// The column of parameter `k` of these.
    pub(crate) fn column(&self, planes: &[f64], k: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| planes[axis * self.width + k])
    }

    /// The planes of all states, one after the other.
    #[inline(always)]
    pub(crate) fn registers<S: Simd>(&self, _: S) -> &[S::f64s] {
        S::as_simd_f64s(&self.numbers).0
    }

    /// The planes of a state, one after the other.
    #[inline(always)]
    pub(crate) fn of(&self, state: usize) -> &[f64] {
        &self.numbers[state * 3 * self.width..][..3 * self.width]
    }

    /// The same, to be set.
    pub(super) fn of_mut(&mut self, state: usize) -> &mut [f64] {
        &mut self.numbers[state * 3 * self.width..][..3 * self.width]
    }
}
