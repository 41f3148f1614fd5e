//! Computes sums over the samples of a move: the sum of R, and the sums of R times each component of the rate. R is the
//! rotation from the frame at a sample to the frame at the first sample. The sums are computed sample by sample, or
//! faster, node by node (in groups of time steps).
//!
//! A node combines n = 16 short time steps. The sum of `R w` over the samples of a node is approximated by `R W + R'
//! D`. Here R is the rotation matrix in the middle of the node, and R' is its derivative with respect to time, in units
//! of the node's duration. W is the sum of w over the samples of the node, with half weight for the first and the last
//! sample (trapezoidal rule). D is a linear combination of differences between the rates of the node.
//!
//! The coefficients of D are derived for a sinusoidal rate whose phase changes by x, rad, over a node. w and w' are
//! this rate and its derivative in the middle of the node. The unit of time is the node's duration. For this rate, W
//! has the value below, and the coefficients of D are chosen so that D has the value below:
//!
//! ```text
//! W = n w (1 - a x^2 + b x^4),     D = n a w' (1 - (b / a) x^2)
//! ```
//!
//! Higher powers of x are neglected. The coefficients a and b are given by the constants `SECOND` (a) and `FOURTH` (b /
//! a). Integration by parts transforms the sum of `R' w'` over the nodes of a segment into the sum of `-R w''`. For the
//! sinusoidal rate, `w'' = -x^2 w`, so this is the sum of `x^2 R w`. Integration by parts also gives terms at the ends
//! of the segment, for which [`end_of_nodes`] corrects. The sum of `R' D` therefore cancels the error of W, and the
//! result is exact up to the fifth power of x.

use pulp::Simd;

use super::lanes::{Lanes, Three, cross, three};

/// Number of time steps in a node, a group of steps that is summed together.
pub(super) const STEPS_OF_A_NODE: usize = 16;
const N: f64 = STEPS_OF_A_NODE as f64;
/// Coefficient a of W (see the start of this file): the relative difference between W and n w, divided by the squared
/// phase change x^2.
pub(super) const SECOND: f64 = (1.0 + 2.0 / (N * N)) / 24.0;
/// Ratio b / a of the coefficients a and b of W (see the start of this file).
const FOURTH: f64 = (1.0 / 1920.0 + 1.0 / (288.0 * N * N) - 1.0 / (720.0 * N * N * N * N)) / SECOND;
/// D must be `n a w' (1 - (b / a) x^2)`, and is computed as the weighted sum of two differences (see the start of this
/// file). If D were computed only from the difference between the sums over the two halves of a node, the factor of x^2
/// would be this value instead of b / a.
const OF_HALVES: f64 = 1.0 / 48.0 + 1.0 / (12.0 * N * N);
/// If D were computed only from the difference between the samples at the two ends of a node, the factor of x^2 would
/// be this value instead of b / a.
const OF_ENDS: f64 = 1.0 / 24.0;
/// Relative weight, in D, of the difference between the samples at the two ends of a node. The difference between the
/// sums over the two halves has the weight 1 - share. The share follows from the required factor of x^2: `share x
/// OF_ENDS + (1 - share) x OF_HALVES = b / a`.
const SHARE_OF_ENDS: f64 = (FOURTH - OF_HALVES) / (OF_ENDS - OF_HALVES);
/// In D, the difference between the sums over the two halves of a node is multiplied by this factor. The factor is
/// valid for the rates in the vectorised integration, which are multiplied by a sixth of the time step.
pub(super) const BY_HALVES: f64 = (1.0 - SHARE_OF_ENDS) * 24.0 * SECOND * N;
/// In D, the difference between the samples at the two ends of a node is multiplied by this factor. The factor is valid
/// for the rates in the vectorised integration, which are multiplied by a sixth of the time step.
pub(super) const BY_ENDS: f64 = SHARE_OF_ENDS * 6.0 * SECOND * N * N;

/// Contribution of a sample to the sums, in each SIMD lane.
#[derive(Clone, Copy)]
#[repr(align(64))] // A SIMD vector that crosses a cache line takes twice as long to load and to store.
pub(super) struct Sample<S: Simd> {
    /// Rate times the weight of the sample.
    pub(super) rate: Three<S>,
    pub(super) weight: Lanes<S>,
    /// Columns of the rotation matrix at the sample.
    pub(super) rotation: [Three<S>; 3],
}

impl<S: Simd> Sample<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self { rate: [zero; 3], weight: zero, rotation: [[zero; 3]; 3] }
    }
}

/// Quantities of a node (16 time steps) from which its contribution to the sums is computed.
pub(super) struct Node<S: Simd> {
    /// Rate of the sample at the start of the node.
    begin: Three<S>,
    /// Rate of the sample in the middle of the node.
    middle: Three<S>,
    /// Rate of the sample at the end of the node.
    end: Three<S>,
    /// Columns of the rotation matrix in the middle of the node.
    rotation: [Three<S>; 3],
    /// Sums of the rates over the first and over the second half of the node. The two samples at the ends of each half
    /// have half weight.
    halves: [Three<S>; 2],
}

impl<S: Simd> Node<S> {
    /// The first node. `begin` is the rate of the sample at its start.
    #[inline(always)]
    pub(super) fn new(simd: S, begin: Three<S>) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self { begin, middle: zero, end: begin, rotation: [zero; 3], halves: [zero; 2] }
    }

    /// Starts the next node at the end of the previous node. Sets the rate and the rotation in the middle of the node,
    /// and the sum of the rates over its first half.
    #[inline(always)]
    pub(super) fn reach_middle(&mut self, middle: Three<S>, half: Three<S>, rotation: [Three<S>; 3]) {
        (self.begin, self.middle, self.halves[0], self.rotation) = (self.end, middle, half, rotation);
    }

    #[inline(always)]
    pub(super) fn reach_end(&mut self, end: Three<S>, half: Three<S>) {
        (self.end, self.halves[1]) = (end, half);
    }
}

/// Sums over the samples for one column of the rotation matrix. Each lane has its own sums.
#[derive(Clone, Copy)]
struct Column<S: Simd> {
    /// Sum of the column times the weight of the sample.
    by_one: Three<S>,
    /// Sums of the column times each component of the rate.
    by_rate: [Three<S>; 3],
}

/// Sums in all lanes. For column c of R and rate component j, only the sums with `j >= c` are accumulated. The other
/// sums are computed from these sums and the final rotation.
#[repr(align(64))]
pub(super) struct Totals<S: Simd>([Column<S>; 3]);

impl<S: Simd> Totals<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self([Column { by_one: zero, by_rate: [zero; 3] }; 3])
    }

    /// Adds samples to the sums, usually the samples of a tile (8 steps). There are more sums than registers, so the
    /// sums of one column of R are completed before the sums of the next column.
    #[inline(always)]
    pub(super) fn add<const EVEN: bool>(&mut self, samples: &[Sample<S>]) {
        self.add_column::<EVEN, 0>(samples);
        self.add_column::<EVEN, 1>(samples);
        self.add_column::<EVEN, 2>(samples);
    }

    #[inline(always)]
    fn add_column<const EVEN: bool, const C: usize>(&mut self, samples: &[Sample<S>]) {
        let Column { mut by_one, mut by_rate } = self.0[C];
        for sample in samples {
            let column = &sample.rotation[C];
            by_one = three(|r| if EVEN { by_one[r] + column[r] } else { column[r].mul_add(sample.weight, by_one[r]) });
            for j in C..3 {
                by_rate[j] = three(|r| column[r].mul_add(sample.rate[j], by_rate[j][r]));
            }
        }
        self.0[C] = Column { by_one, by_rate };
    }

    /// Adds the contribution of a node.
    #[inline(always)]
    pub(super) fn add_node(&mut self, simd: S, node: &Node<S>) {
        let splat = |value: f64| Lanes::splat(simd, value);
        let (by_halves, by_ends) = (splat(BY_HALVES), splat(BY_ENDS));
        let [left, right] = &node.halves;
        let rate = three(|c| left[c] + right[c]);
        let late = three(|c| (node.end[c] - node.begin[c]).mul_add(by_ends, (right[c] - left[c]) * by_halves));
        let turned = derivative(&node.rotation, &node.middle);
        self.add::<false>(&[
            Sample { rate, weight: splat(N), rotation: node.rotation },
            Sample { rate: late, weight: splat(0.0), rotation: turned },
        ]);
    }

    /// Four sums, each given by its three columns: the sum of R, and the sums of R times each of the three components
    /// of the rate.
    #[inline(always)]
    pub(super) fn columns(&self) -> [[Three<S>; 3]; 4] {
        let [x, y, z] = &self.0;
        let by_rate = |j: usize| [x.by_rate[j], y.by_rate[j], z.by_rate[j]];
        [[x.by_one, y.by_one, z.by_one], by_rate(0), by_rate(1), by_rate(2)]
    }
}

/// Computes the contribution of the sample at the start (`sign` -1) or at the end (`sign` 1) of a series of nodes to
/// the sums. It is the boundary term of the integration by parts that the start of this file describes.
#[inline(always)]
pub(super) fn end_of_nodes<S: Simd>(simd: S, sign: f64, rate: Three<S>, rotation: &[Three<S>; 3]) -> Sample<S> {
    let factor = Lanes::splat(simd, sign * 6.0 * SECOND * N * N);
    let rotation = derivative(rotation, &three(|c| rate[c] * factor));
    Sample { rate, weight: Lanes::splat(simd, 1.0), rotation }
}

/// Columns of the derivative `R' = R [w]x`.
#[inline(always)]
fn derivative<S: Simd>(rotation: &[Three<S>; 3], rate: &Three<S>) -> [Three<S>; 3] {
    let row = |r: usize| cross(&three(|c| rotation[c][r]), rate);
    let rows = [row(0), row(1), row(2)];
    let column = |c: usize| three(|r| rows[r][c]);
    [column(0), column(1), column(2)]
}
