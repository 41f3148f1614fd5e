//! Sums of the rotations, and of those times each part of the rate, over all samples or at nodes.
//!
//! A node is `n` steps that are summed as one. To the sum of `R w` over its samples it adds `R W + R' D`: the rotation R in its middle
//! times the sum W of its samples, whose ends count for half, and `R'` there times D, a difference of samples. Of an oscillation with
//! the phase x from end to end W is `n w (1 - a x^2 + b x^4)`. D is `n a x w (1 - b / a x^2)` and has its phase late by a quarter; as
//! `R' w'` sums up to what `-R w''` does, and to what only the ends of a path have, nothing up to the fifth power is left out.

use pulp::Simd;

use super::lanes::{Lanes, Three, cross, three};

/// Steps of a node.
pub(super) const STEPS_OF_A_NODE: usize = 16;
const N: f64 = STEPS_OF_A_NODE as f64;
/// Of W: a, and b / a.
pub(super) const SECOND: f64 = (1.0 + 2.0 / (N * N)) / 24.0;
const FOURTH: f64 = (1.0 / 1920.0 + 1.0 / (288.0 * N * N) - 1.0 / (720.0 * N * N * N * N)) / SECOND;
/// What the difference of the sums of both halves, and that of the samples at both ends, have in the place of b / a.
const OF_HALVES: f64 = 1.0 / 48.0 + 1.0 / (12.0 * N * N);
const OF_ENDS: f64 = 1.0 / 24.0;
/// How much of D comes from the ends.
const SHARE_OF_ENDS: f64 = (FOURTH - OF_HALVES) / (OF_ENDS - OF_HALVES);
/// D over either difference, where a rate is a sixth of the turn in one step.
pub(super) const BY_HALVES: f64 = (1.0 - SHARE_OF_ENDS) * 24.0 * SECOND * N;
pub(super) const BY_ENDS: f64 = SHARE_OF_ENDS * 6.0 * SECOND * N * N;

/// What a sample adds.
#[derive(Clone, Copy)]
#[repr(align(64))] // As terms are.
pub(super) struct Sample<S: Simd> {
    /// Times its weight.
    pub(super) rate: Three<S>,
    pub(super) weight: Lanes<S>,
    /// Columns of the rotation there.
    pub(super) rotation: [Three<S>; 3],
}

impl<S: Simd> Sample<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self { rate: [zero; 3], weight: zero, rotation: [[zero; 3]; 3] }
    }
}

/// What a node adds.
pub(super) struct Node<S: Simd> {
    /// The samples where it begins, in its middle and where it ends.
    begin: Three<S>,
    middle: Three<S>,
    end: Three<S>,
    /// Columns of the rotation in its middle.
    rotation: [Three<S>; 3],
    /// The sums of the samples of its halves, the ends by half.
    halves: [Three<S>; 2],
}

impl<S: Simd> Node<S> {
    /// The first one begins at this sample.
    #[inline(always)]
    pub(super) fn new(simd: S, begin: Three<S>) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self { begin, middle: zero, end: begin, rotation: [zero; 3], halves: [zero; 2] }
    }

    /// Goes on from the end of the last one to the middle.
    #[inline(always)]
    pub(super) fn reach_middle(&mut self, middle: Three<S>, half: Three<S>, rotation: [Three<S>; 3]) {
        (self.begin, self.middle, self.halves[0], self.rotation) = (self.end, middle, half, rotation);
    }

    #[inline(always)]
    pub(super) fn reach_end(&mut self, end: Three<S>, half: Three<S>) {
        (self.end, self.halves[1]) = (end, half);
    }
}

/// Sums of all lanes for a column of the rotation, over samples with their weights.
#[derive(Clone, Copy)]
struct Column<S: Simd> {
    by_one: Three<S>,
    /// By each part of the rate.
    by_rate: [Three<S>; 3],
}

/// Sums of all lanes. The column c by part j of the rate is summed for `j >= c` only: the others follow from where the path ends.
#[repr(align(64))]
pub(super) struct Totals<S: Simd>([Column<S>; 3]);

impl<S: Simd> Totals<S> {
    #[inline(always)]
    pub(super) fn nothing(simd: S) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self([Column { by_one: zero, by_rate: [zero; 3] }; 3])
    }

    /// Adds the samples of a tile to some sums, then to the next: there are more sums than registers.
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
            by_one =
                three(|r| if EVEN { by_one[r] + column[r] } else { column[r].times_plus(sample.weight, by_one[r]) });
            for j in C..3 {
                by_rate[j] = three(|r| column[r].times_plus(sample.rate[j], by_rate[j][r]));
            }
        }
        self.0[C] = Column { by_one, by_rate };
    }

    /// Adds a node.
    #[inline(always)]
    pub(super) fn add_node(&mut self, simd: S, node: &Node<S>) {
        let splat = |value: f64| Lanes::splat(simd, value);
        let (by_halves, by_ends) = (splat(BY_HALVES), splat(BY_ENDS));
        let [left, right] = &node.halves;
        let rate = three(|c| left[c] + right[c]);
        let late = three(|c| (node.end[c] - node.begin[c]).times_plus(by_ends, (right[c] - left[c]) * by_halves));
        let turned = derivative(&node.rotation, &node.middle);
        self.add::<false>(&[
            Sample { rate, weight: splat(N), rotation: node.rotation },
            Sample { rate: late, weight: splat(0.0), rotation: turned },
        ]);
    }

    /// Columns of the summed rotations, and of those times each part of the rate.
    #[inline(always)]
    pub(super) fn columns(&self) -> [[Three<S>; 3]; 4] {
        let [x, y, z] = &self.0;
        let by_rate = |j: usize| [x.by_rate[j], y.by_rate[j], z.by_rate[j]];
        [[x.by_one, y.by_one, z.by_one], by_rate(0), by_rate(1), by_rate(2)]
    }
}

/// What only the ends of a path have, at the sample where nodes end, or with a `sign` of minus one begin.
#[inline(always)]
pub(super) fn end_of_nodes<S: Simd>(simd: S, sign: f64, rate: Three<S>, rotation: &[Three<S>; 3]) -> Sample<S> {
    let factor = Lanes::splat(simd, sign * 6.0 * SECOND * N * N);
    let rotation = derivative(rotation, &three(|c| rate[c] * factor));
    Sample { rate, weight: Lanes::splat(simd, 1.0), rotation }
}

/// Columns of R', `R [w]x`.
#[inline(always)]
fn derivative<S: Simd>(rotation: &[Three<S>; 3], rate: &Three<S>) -> [Three<S>; 3] {
    let row = |r: usize| cross(&three(|c| rotation[c][r]), rate);
    let rows = [row(0), row(1), row(2)];
    let column = |c: usize| three(|r| rows[r][c]);
    [column(0), column(1), column(2)]
}
