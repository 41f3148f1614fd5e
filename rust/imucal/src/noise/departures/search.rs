//! Searches for steps and drifts of the mean (components). Each iteration adds the component with the largest penalised
//! increase of the likelihood to the model. The search ends if no further component is significant, or if the maximum
//! number of components is reached.

use nalgebra::{DMatrix, DVector};

use super::{Blocks, Component, NoiseModel, Shape};
use crate::noise::cosines::{Power, pooled};
use crate::noise::likelihood::Likelihood;
use crate::noise::power_law::{KINDS, PerKind, WALK, WHITE, dot};

/// A component is added only if it increases 2 ln L by at least this value plus the penalty of its shape, where L is
/// the likelihood. If only one component (with known shape and time) were tried, no penalty would be needed. The
/// penalty accounts for the number of shapes and times that are tried. For a record without steps, the probability of a
/// false alarm is then about 1e-3.
const GAIN: f64 = 16.0;
/// Additional penalty of a drift, in units of 2 ln L. A drift has one more parameter than a step, so a drift must
/// increase 2 ln L by 4 more than a step. An increase by 4 is a likelihood ratio of exp(4 / 2) = 7.
const LENGTH: f64 = 4.0;
/// Maximum number of steps and drifts of one axis.
const MAX_COMPONENTS: usize = 12;
/// Number of iterations of the alternating estimation of amplitudes and noise parameters.
const ROUNDS: usize = 4;

/// Data of the search for steps and drifts of one axis. The search uses `z`, the cosine transform of the block means.
pub(super) struct Search<'a> {
    pub(super) blocks: &'a Blocks,
    pub(super) z: &'a [f64],
    pub(super) noise: &'a NoiseModel,
    pub(super) shapes: Vec<Shape>,
}

/// A model with several steps and drifts: their shapes and amplitudes, and the parameters of the noise that remains
/// when these components are subtracted.
struct Explained {
    shapes: Vec<Shape>,
    /// The cosine transform of each shape.
    columns: Vec<Vec<f64>>,
    /// Amplitude of each component, and the standard deviation of the amplitude.
    sizes: Vec<(f64, f64)>,
    /// Noise parameters.
    theta: PerKind,
    /// -2 ln L plus a constant, where L is the likelihood.
    cost: f64,
}

impl Search<'_> {
    /// Runs the search, and returns the components in the order in which they were added.
    pub(super) fn run(&self) -> Vec<Component> {
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

    /// Penalty of a shape: 2 ln(number of candidate shapes of its kind). A drift has the additional penalty `LENGTH`
    /// for its additional parameter: the length of a ramp, or the time constant of a warm-up.
    fn penalty(&self, shape: Shape) -> f64 {
        let is_same = |other: &&Shape| std::mem::discriminant(*other) == std::mem::discriminant(&shape);
        let length = if shape.is_step() { 0.0 } else { LENGTH };
        2.0 * (self.shapes.iter().filter(is_same).count() as f64).ln() + length
    }

    /// Extends the model `present` by the best further component. Candidates are scored twice: with the noise
    /// parameters of `present`, and with noise parameters that are fitted without a random walk. The second score is
    /// needed because a large step that is not yet in the model increases the estimated random walk. With this random
    /// walk, the step would not be significant.
    fn next(&self, present: &Explained) -> Option<Explained> {
        let mut without_walk = self.noise.kinds;
        without_walk[WALK] = false;
        let residual = self.residual(present);
        let steady = self.fit(&residual, without_walk).0;
        let candidates = [present.theta, steady].map(|theta| self.best_shapes(&residual, &theta, present));
        // The likelihood may have two maxima: one with a strong random walk, and one with a weak random walk. The fit
        // is therefore started near each maximum.
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

    /// Finds the best step, the best ramp and the best warm-up for the noise parameters `theta`. The best shape of a
    /// kind increases 2 ln L most when it is fitted to `residual`, the data minus the components of the model
    /// `present`.
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

    /// Finds the time, to a fraction of a block, at which a step near the start of block `first` fits `residual` best.
    /// The cosine transform of a step within a block is a weighted sum of the transforms of steps at the two ends of
    /// the block. The weights are fitted to `residual`.
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
            // `at_start` and `at_end` are the sizes of the two steps, both multiplied by the determinant of the normal
            // equations. The determinant cancels in their ratio, which gives the fraction of a block.
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

    /// Number of elements z_j of the cosine transform, from the lowest frequency on, that are used to score a
    /// component. These elements contain 99 % of the information about a step. The information of z_j about a step is
    /// (power of the step in z_j) / (power of the noise in z_j). The power of the step is proportional to 1 / j^2,
    /// whereas the power of white noise does not decrease with j. High frequencies therefore contribute little.
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

    /// Estimates the amplitudes of the components `shapes` and the noise parameters alternately. The iteration starts
    /// with the noise parameters `theta`, which were fitted to the data before any component was subtracted. The first
    /// fit of the noise parameters includes only the kinds of noise in `kinds`. All other fits include all kinds of the
    /// noise model.
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

    /// Amplitudes of the components, each with its standard deviation, from a weighted least-squares fit to `z`.
    /// `columns` contains the cosine transforms of the shapes.
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

    /// Fits the noise parameters to `residual`, which is the cosine transform of the block means minus the cosine
    /// transforms of the components. Returns the noise parameters, and -2 ln L of the fit up to a constant.
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
