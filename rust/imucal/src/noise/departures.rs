//! Detection of steps and drifts of the mean of a unit at rest, which are distinguished from random noise by their
//! likelihood: `docs/model.md` (36).
//!
//! ```text
//! z_j = sum over components of a_c s_cj + noise,     noise ~ N(0, mu_j(theta)),     j = 1 to W - 1
//! ```
//!
//! z are the cosines of W block means, in which white noise and a random walk are uncorrelated. A component is a step
//! at a time, a ramp between two times, or an exponential approach to a final value (warm-up). A step has the power
//! spectrum of a random walk. However, the signs of its cosines follow from the time of the step, whereas those of a
//! random walk are random. Components are added one at a time. The component that is added has the largest gain of
//! twice the log-likelihood minus its penalty, after amplitudes and noise parameters are estimated again. If no gain
//! exceeds its penalty, noise explains the record.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};

use super::cosines::{Power, expected_powers, pooled};
use super::likelihood::Likelihood;
use super::power_law::{KINDS, PerKind, WALK, WHITE, dot};

/// Maximum number of blocks. With more blocks, the time of a step is more accurate, but the computing time grows with
/// the square of the number.
const MAX_BLOCKS: usize = 1024;
/// Minimum number of blocks. With fewer, steps cannot be distinguished from noise, so the search is omitted.
const MIN_BLOCKS: usize = 64;
/// Minimum gain of twice the log-likelihood for a component at a known time. Together with the penalty for the choice
/// of the time, the false-alarm probability is about 1e-3 for a record without steps.
const GAIN: f64 = 16.0;
/// Additional penalty of a drift, because it has one more parameter than a step: the gain of twice the log-likelihood
/// that this parameter must provide. It corresponds to a likelihood ratio of 7.
const LENGTH: f64 = 4.0;
/// Maximum number of components.
const MAX_COMPONENTS: usize = 12;
/// Ratios of the time constant of a warm-up to the duration of the record. The last ratio represents a change at a
/// constant rate.
const TIME_CONSTANTS: [f64; 9] = [0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2, 2.5, LINEAR];
/// Ratio of the time constant to the duration of the record at which the rate of change is practically constant.
const LINEAR: f64 = 1e3;
/// Maximum duration of a change that counts as a step, s. A unit settles within this time after a bump, and no unit
/// warms up so fast.
pub(super) const ABRUPT_S: f64 = 10.0;
/// Maximum duration of a change that counts as a step, in blocks. Changes this short cannot be resolved by the blocks.
/// The longer of this duration and `ABRUPT_S` applies.
const ABRUPT_BLOCKS: usize = 2;
/// Number of iterations of the alternating estimation of amplitudes and noise parameters.
const ROUNDS: usize = 4;

/// Shape of a component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// A step that occurs `fraction` of a block after the start of block `first`.
    Step { first: usize, fraction: f64 },
    /// A change at a constant rate that starts at block `first` and takes `blocks` blocks.
    Ramp { first: usize, blocks: usize },
    /// Exponential approach to a final value. The time constant is in blocks.
    WarmUp { time_constant: f64 },
}

/// A step or a drift of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Component {
    pub(super) shape: Shape,
    /// Change of the mean, in the unit of the samples.
    pub(super) size: f64,
    /// Standard deviation of the size.
    pub(super) sigma: f64,
    /// Increase of twice the log-likelihood due to this component.
    pub(super) gain: f64,
}

/// Blocks of a record of a given length, with their expected powers, shared by all axes.
pub(super) struct Blocks {
    /// Number of samples in a block.
    pub(super) samples: usize,
    count: usize,
    expected: Vec<PerKind>,
    /// `sin(pi k / (2 W))` for k from 0 to 4 W.
    sines: Vec<f64>,
    warm_ups: Vec<(Shape, Vec<f64>)>,
}

/// Noise model of an axis in the search: kinds of noise, variance of rounding, and number of omitted octaves at the
/// highest frequencies.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseModel {
    pub(super) kinds: [bool; KINDS],
    pub(super) rounding: f64,
    pub(super) filtered: u32,
}

impl Blocks {
    /// Blocks for a record of `samples` samples; `None` if it is too short.
    pub(super) fn try_new(samples: usize) -> Option<Self> {
        let length = samples.div_ceil(MAX_BLOCKS).max(1);
        let count = samples / length;
        if count < MIN_BLOCKS {
            return None;
        }
        let sines = (0..=4 * count).map(|k| (PI * k as f64 / (2.0 * count as f64)).sin()).collect();
        let mut blocks = Self {
            samples: length,
            count,
            expected: expected_powers(length as f64, count),
            sines,
            warm_ups: Vec::new(),
        };
        let warm_up = |share: &f64| {
            let time_constant = share * count as f64;
            // The shape is scaled to increase from 0 to 1, so that its amplitude is the change over the record.
            let end = 1.0 - (-(count as f64) / time_constant).exp();
            let values = (0..count).map(|t| (1.0 - (-(t as f64 + 0.5) / time_constant).exp()) / end);
            (Shape::WarmUp { time_constant }, blocks.cosines(&values.collect::<Vec<_>>()))
        };
        let warm_ups = TIME_CONSTANTS.iter().map(warm_up).collect();
        blocks.warm_ups = warm_ups;
        Some(blocks)
    }

    /// Steps and drifts of a record, in the order of their gain. The record must have the number of samples for which
    /// the blocks were created. `rate_hz`, the sampling rate, is needed to compare durations with `ABRUPT_S`.
    pub(super) fn components(
        &self,
        values: impl Iterator<Item = f64>,
        noise: &NoiseModel,
        rate_hz: f64,
    ) -> Vec<Component> {
        let z = self.cosines(&self.means(values));
        let search = Search { blocks: self, z: &z, noise, shapes: self.shapes(rate_hz) };
        search.run()
    }

    fn means(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut values = values;
        let mean = |_| {
            let sum: f64 = values.by_ref().take(self.samples).sum();
            sum / self.samples as f64
        };
        (0..self.count).map(mean).collect()
    }

    /// `z_j = sqrt(2 / W) sum over t of y_t cos(pi j (t + 1/2) / W)` for j = 1 to W - 1.
    fn cosines(&self, window: &[f64]) -> Vec<f64> {
        let width = self.count;
        let origin = window.first().copied().unwrap_or(0.0);
        let scale = (2.0 / width as f64).sqrt();
        (1..width)
            .map(|j| {
                // cos(x) is sin(x + pi / 2), and pi / 2 is W steps of the table.
                let mut at = (j + width) % (4 * width);
                let mut sum = 0.0;
                for value in window {
                    sum += (value - origin) * self.sines[at];
                    at = (at + 2 * j) % (4 * width);
                }
                scale * sum
            })
            .collect()
    }

    /// Element j of the cosine transform of a change from 0 to 1 that starts at block `first` and takes `blocks`
    /// blocks.
    fn change(&self, j: usize, first: usize, blocks: usize) -> f64 {
        let width = self.count;
        let scale = (2.0 / width as f64).sqrt();
        let half_sine = self.sines[j];
        if blocks <= 1 {
            return -scale * self.sines[(2 * j * first) % (4 * width)] / (2.0 * half_sine);
        }
        // The sum of the sines of steps at `first`, `first + 1`, ... is a difference of cosines.
        let cosine = |half_steps: usize| self.sines[(j * half_steps + width) % (4 * width)];
        let difference = cosine(2 * first - 1) - cosine(2 * (first + blocks) - 1);
        -scale * difference / (4.0 * half_sine * half_sine * blocks as f64)
    }

    /// Cosine transform of a shape, for j = 1 to W - 1.
    fn column(&self, shape: Shape) -> Vec<f64> {
        match shape {
            Shape::Step { first, fraction } => {
                let at =
                    |j: usize| (1.0 - fraction) * self.change(j, first, 1) + fraction * self.change(j, first + 1, 1);
                (1..self.count).map(at).collect()
            }
            Shape::Ramp { first, blocks } => (1..self.count).map(|j| self.change(j, first, blocks)).collect(),
            Shape::WarmUp { .. } => {
                self.warm_ups.iter().find(|(other, _)| *other == shape).map_or_else(Vec::new, |(_, z)| z.clone())
            }
        }
    }

    /// All shapes that the search tries: a step at every block, and ramps at positions spaced by a quarter of their
    /// length.
    fn shapes(&self, rate_hz: f64) -> Vec<Shape> {
        let mut shapes: Vec<Shape> = (1..self.count).map(|first| Shape::Step { first, fraction: 0.0 }).collect();
        let mut blocks = self.abrupt_blocks(rate_hz) * 2;
        while blocks < self.count {
            let last = self.count - blocks;
            shapes.extend((1..=last).step_by((blocks / 4).max(1)).map(|first| Shape::Ramp { first, blocks }));
            blocks *= 2;
        }
        shapes.extend(self.warm_ups.iter().map(|(shape, _)| *shape));
        shapes
    }

    /// Number of blocks within which a change counts as a step.
    fn abrupt_blocks(&self, rate_hz: f64) -> usize {
        ((ABRUPT_S * rate_hz / self.samples as f64) as usize).max(ABRUPT_BLOCKS)
    }
}

impl Shape {
    /// Whether the shape is a step. All other shapes are drifts.
    fn is_step(self) -> bool {
        matches!(self, Self::Step { .. })
    }

    /// Whether a warm-up with this time constant, in blocks, has a constant rate over `blocks` blocks.
    pub(super) fn is_linear(time_constant: f64, blocks: usize) -> bool {
        time_constant > 0.5 * LINEAR * blocks as f64
    }
}

struct Search<'a> {
    blocks: &'a Blocks,
    z: &'a [f64],
    noise: &'a NoiseModel,
    shapes: Vec<Shape>,
}

/// Components with their amplitudes, and the noise parameters after they are subtracted.
struct Explained {
    shapes: Vec<Shape>,
    columns: Vec<Vec<f64>>,
    sizes: Vec<(f64, f64)>,
    theta: PerKind,
    /// Minus twice the log-likelihood, up to a constant.
    cost: f64,
}

impl Search<'_> {
    fn run(&self) -> Vec<Component> {
        let kinds = self.noise.kinds;
        let mut best = self.explained(Vec::new(), Vec::new(), (kinds, self.fit(self.z, kinds).0));
        let mut gains = Vec::new();
        while gains.len() < MAX_COMPONENTS {
            let Some(next) = self.next(&best) else { break };
            let gain = best.cost - next.cost;
            let added = next.shapes.last().copied();
            if added.is_none_or(|shape| gain < GAIN + self.penalty(shape)) {
                break;
            }
            gains.push(gain);
            best = next;
        }
        let parts = best.shapes.iter().zip(&best.sizes).zip(gains);
        parts
            .map(|((shape, (size, sigma)), gain)| Component { shape: *shape, size: *size, sigma: *sigma, gain })
            .collect()
    }

    /// Penalty of a shape: twice the logarithm of the number of candidate shapes of its kind, plus `LENGTH` for a shape
    /// with one more parameter than a step (the length of a ramp, or the time constant of a warm-up).
    fn penalty(&self, shape: Shape) -> f64 {
        let is_same = |other: &&Shape| std::mem::discriminant(*other) == std::mem::discriminant(&shape);
        let length = if shape.is_step() { 0.0 } else { LENGTH };
        2.0 * (self.shapes.iter().filter(is_same).count() as f64).ln() + length
    }

    /// The present explanation extended by the best further component. Candidates are scored twice, with the noise
    /// parameters of the present explanation and with noise parameters fitted without a random walk. The second score
    /// is needed because a large step increases the estimated random walk so much that the step is no longer
    /// significant.
    fn next(&self, present: &Explained) -> Option<Explained> {
        let mut without_walk = self.noise.kinds;
        without_walk[WALK] = false;
        let residual = self.residual(present);
        let steady = self.fit(&residual, without_walk).0;
        let candidates = [present.theta, steady].map(|theta| self.best_shapes(&residual, &theta, present));
        // The likelihood may have two maxima, one with a strong and one with a weak random walk. The fit is therefore
        // started from both.
        let starts = [self.noise.kinds, without_walk].map(|kinds| (kinds, self.fit(self.z, kinds).0));
        let mut tried: Vec<Shape> = Vec::new();
        let mut best: Option<(f64, Explained)> = None;
        for shape in candidates.into_iter().flatten() {
            if tried.contains(&shape) {
                continue;
            }
            tried.push(shape);
            let shapes = [&present.shapes[..], &[shape]].concat();
            let columns = [&present.columns[..], &[self.blocks.column(shape)]].concat();
            for start in starts {
                let next = self.explained(shapes.clone(), columns.clone(), start);
                let cost = next.cost + self.penalty(shape);
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, next));
                }
            }
        }
        best.map(|(_, explained)| explained)
    }

    /// The best step and the two best drifts for given noise parameters.
    fn best_shapes(&self, residual: &[f64], theta: &PerKind, present: &Explained) -> Vec<Shape> {
        let weights: Vec<f64> = self.blocks.expected.iter().map(|expected| 1.0 / self.power(theta, expected)).collect();
        let used = self.used(&weights);
        let score = |column: &dyn Fn(usize) -> f64| {
            let (mut product, mut square) = (0.0, 0.0);
            for k in 0..used {
                let value = column(k);
                product += weights[k] * residual[k] * value;
                square += weights[k] * value * value;
            }
            if square > 0.0 { product * product / square } else { 0.0 }
        };
        let mut best: [(f64, Option<Shape>); 3] = [(0.0, None); 3];
        for &shape in self.shapes.iter().filter(|shape| !present.shapes.contains(shape)) {
            let (place, gain) = match shape {
                Shape::Step { first, .. } => (0, score(&|k| self.blocks.change(k + 1, first, 1))),
                Shape::Ramp { first, blocks } => (1, score(&|k| self.blocks.change(k + 1, first, blocks))),
                Shape::WarmUp { .. } => {
                    let column = self.blocks.warm_ups.iter().find(|(other, _)| *other == shape);
                    (2, column.map_or(0.0, |(_, column)| score(&|k| column[k])))
                }
            };
            if gain > best[place].0 {
                best[place] = (gain, Some(shape));
            }
        }
        let within = |shape: Shape| match shape {
            Shape::Step { first, .. } => self.within_block(first, residual, &weights),
            _ => shape,
        };
        best.into_iter().filter_map(|(_, shape)| shape.map(within)).collect()
    }

    /// The step near block `first` at the best time within a block. A step within a block is a sum of steps at its two
    /// ends, whose sizes follow from the residual.
    fn within_block(&self, first: usize, residual: &[f64], weights: &[f64]) -> Shape {
        let product = |a: &[f64], b: &[f64]| -> f64 { (0..weights.len()).map(|k| weights[k] * a[k] * b[k]).sum() };
        let plain = Shape::Step { first, fraction: 0.0 };
        let score = |shape: Shape| {
            let column = self.blocks.column(shape);
            product(&column, residual).powi(2) / product(&column, &column)
        };
        let mut best = (score(plain), plain);
        for start in [first.saturating_sub(1), first] {
            if start < 1 || start + 1 >= self.blocks.count {
                continue;
            }
            let [a, b] = [start, start + 1].map(|first| self.blocks.column(Shape::Step { first, fraction: 0.0 }));
            let (aa, ab, bb) = (product(&a, &a), product(&a, &b), product(&b, &b));
            let (ra, rb) = (product(&a, residual), product(&b, residual));
            // Both sizes are multiplied by the determinant of the normal equations. It cancels in the fraction.
            let (at_start, at_end) = (ra * bb - rb * ab, rb * aa - ra * ab);
            let fraction = at_end / (at_start + at_end);
            if (0.0..=1.0).contains(&fraction) {
                let shape = Shape::Step { first: start, fraction };
                let gain = score(shape);
                if gain > best.0 {
                    best = (gain, shape);
                }
            }
        }
        best.1
    }

    /// Number of cosines, from the first one on, that are used to detect a component. They contain 99 % of the
    /// information about a step. The power of a step in cosine j is proportional to 1 / j^2, so frequencies far above
    /// the crossover of white noise and random walk contribute little.
    fn used(&self, weights: &[f64]) -> usize {
        const FEWEST: usize = 128;
        let mut total: f64 = (0..weights.len()).map(|k| weights[k] / ((k + 1) as f64).powi(2)).sum();
        total *= 0.01;
        let mut end = weights.len();
        let mut tail = 0.0;
        while end > FEWEST && tail < total {
            end -= 1;
            tail += weights[end] / ((end + 1) as f64).powi(2);
        }
        end.max(FEWEST.min(weights.len()))
    }

    /// Amplitudes of these components and noise parameters, estimated alternately. The iteration starts from noise of
    /// the kinds in `start`, fitted to the data without components. The final noise parameters contain all kinds of the
    /// model.
    fn explained(
        &self,
        shapes: Vec<Shape>,
        columns: Vec<Vec<f64>>,
        (kinds, mut theta): ([bool; KINDS], PerKind),
    ) -> Explained {
        let mut sizes = Vec::new();
        let mut cost = f64::INFINITY;
        for round in 0..ROUNDS {
            sizes = self.amplitudes(&columns, &theta);
            let residual = self.without(&columns, &sizes);
            let kinds = if round == 0 { kinds } else { self.noise.kinds };
            (theta, cost) = self.fit(&residual, kinds);
            if columns.is_empty() {
                break;
            }
        }
        Explained { shapes, columns, sizes, theta, cost }
    }

    /// Amplitudes and their standard deviations by weighted least squares.
    fn amplitudes(&self, columns: &[Vec<f64>], theta: &PerKind) -> Vec<(f64, f64)> {
        let weights: Vec<f64> = self.blocks.expected.iter().map(|expected| 1.0 / self.power(theta, expected)).collect();
        let product = |a: &[f64], b: &[f64]| -> f64 { (0..weights.len()).map(|k| weights[k] * a[k] * b[k]).sum() };
        let size = columns.len();
        let normal = DMatrix::from_fn(size, size, |i, j| product(&columns[i], &columns[j]));
        let right = DVector::from_fn(size, |i, _| product(&columns[i], self.z));
        match normal.cholesky() {
            Some(factor) => {
                let covariance = factor.inverse();
                let solution = factor.solve(&right);
                (0..size).map(|i| (solution[i], covariance[(i, i)].max(0.0).sqrt())).collect()
            }
            None => vec![(0.0, f64::INFINITY); size],
        }
    }

    fn residual(&self, explained: &Explained) -> Vec<f64> {
        self.without(&explained.columns, &explained.sizes)
    }

    fn without(&self, columns: &[Vec<f64>], sizes: &[(f64, f64)]) -> Vec<f64> {
        let mut residual = self.z.to_vec();
        for (column, (size, _)) in columns.iter().zip(sizes) {
            residual.iter_mut().zip(column).for_each(|(z, value)| *z -= size * value);
        }
        residual
    }

    /// Noise parameters fitted to the cosines `residual`, and minus twice their log-likelihood.
    fn fit(&self, residual: &[f64], kinds: [bool; KINDS]) -> (PerKind, f64) {
        let squares: Vec<f64> = residual.iter().map(|z| z * z).collect();
        let mut powers = pooled(&squares, &self.blocks.expected, self.blocks.samples as f64);
        powers.retain(|power| power.octave() >= self.noise.filtered);
        let likelihood = Likelihood { powers: &powers, rounding: self.noise.rounding, kinds };
        let theta = likelihood.fit().theta;
        let cost = |power: &Power| {
            let expected = self.power(&theta, &power.expected);
            power.dof * (power.value / expected + expected.ln())
        };
        (theta, powers.iter().map(cost).sum())
    }

    fn power(&self, theta: &PerKind, expected: &PerKind) -> f64 {
        dot(theta, expected) + self.noise.rounding * expected[WHITE]
    }
}
