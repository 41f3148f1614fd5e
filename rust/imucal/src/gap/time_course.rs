//! Distinguishes four time courses of a sensor parameter that varies: random walk, smooth variation, switching between
//! two levels, and independent deviations.
//!
//! A generic hypothesis is a variation of a bias or scale that no effect of the catalogue describes. A generic
//! hypothesis with the kernel of a random walk explains any slow variation. If this hypothesis has the largest
//! evidence, the deviation x of the parameter from a constant value is examined in each epoch. An epoch is a rest or a
//! move. After elimination of the other parameters, the residuals give the following log likelihood of x:
//!
//! ```text
//! log likelihood of x = eta^T x - 1/2 x^T Lambda x + constant
//!
//! walk        x ~ N(0, a_i^2 min(t, t') / T)                    a_i the size on axis i
//! smooth      x ~ N(0, a_i^2 exp(-(t - t')^2 / 2 l^2))          l between 1/40 of T and T
//! switching   x = s v,   s of 0 or 1 in each epoch, v ~ N(0, a^2)
//! white       x ~ N(0, a_i^2) in each epoch
//! ```
//!
//! Lambda is the information matrix of x, and eta is the gradient of the log likelihood at x = 0. t and t' are the
//! times of two epochs, T is the time of the last epoch, l is a correlation length, and v is the difference between the
//! two levels. The first three time courses also contain white scatter from epoch to epoch. The evidence of each time
//! course is maximised over trial values of the sizes a_i and of the white scatter. For the switching time course, only
//! the white scatter is varied. The evidence of the switching time course is computed for the most likely states s.
//! This evidence is reduced by the information, nats, that is needed to describe the states: the number of changes, the
//! epochs of the changes, and the intermediate state of each epoch that contains a change.

use faer::Mat;
use faer::linalg::solvers::{Llt, Solve};
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};
use statrs::function::factorial::ln_binomial;

use super::forward_search::ForwardSearch;
use super::generic::Block;
use super::kernel::Kernel;
use super::moments::{Epoch, Setting};
use super::stage::{Beside, Member};
use super::weighing::Weighing;
use crate::calibrate::EffectChoice;
use crate::cancellation::checkpoint;
use crate::error::Error;
use crate::joint::{Kinds, Prepared, Terms};

/// A smooth or switching time course replaces the random walk only if its log evidence exceeds that of the random walk
/// and that of independent deviations by more than this number of nats. 8 nats are odds of 3000 to 1.
const LEAST: f64 = 8.0;
/// Minimum number of epochs (rests and moves). With fewer epochs, the time courses are not distinguished.
const LEAST_EPOCHS: usize = 8;
/// Trial sizes a_i of the deviation, in multiples of a first estimate for each axis. The first estimate includes the
/// noise of the epochs, so it may be many times too large. For a random walk, the first estimate is computed from
/// differences between consecutive epochs. The steps of the walk are often smaller than the noise of these differences.
const SIZES: [f64; 10] = [0.025, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 2.0, 4.0];
/// Trial values of the white scatter from epoch to epoch: its standard deviation in multiples of the typical deviation
/// of the parameter ([`Block::typical`]).
const SCATTERS: [f64; 4] = [1e-3, 0.1, 0.3, 1.0];
/// Trial correlation lengths of a smooth time course, as shares of the time of the last epoch.
const LENGTHS: [f64; 6] = [0.025, 0.05, 0.1, 0.2, 0.5, 1.0];
/// Trial states of an epoch: 0 at the first level, 1 at the second level, and a value between 0 and 1 if the level
/// switches within the epoch.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Maximum number of passes over all epochs in the search for the most likely states of a switching time course.
const MOST_PASSES: usize = 12;

impl ForwardSearch<'_> {
    /// Selects the kernel (the time course) of a variation that a random walk explains. `block` is the sensor parameter
    /// that varies, `open` are the candidate effects, and `members` are the effects in the model.
    pub(super) fn course(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        block: Block,
    ) -> Result<Kernel, Error> {
        let kinds = self.kinds;
        self.kinds = Kinds { in_motion: false, encoders: false };
        let found = self.observed(prepared, triads, open, members, block);
        self.kinds = kinds;
        Ok(found?.and_then(|observed| observed.kernel()).unwrap_or(Kernel::RandomWalk))
    }

    /// Computes the log likelihood of the deviations of the sensor parameter `block` in all epochs (rests and moves).
    /// It uses the residuals at the rests and the residuals of the gravity directions after the moves. `None` if there
    /// are too few epochs, or if the fit of the model fails.
    fn observed(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        block: Block,
    ) -> Result<Option<Observed>, Error> {
        let seen: Vec<EffectChoice> = open.iter().filter(|c| Kinds::needed_by(&[**c]) == self.kinds).copied().collect();
        let is_seen = |member: &&Member| {
            seen.iter().any(|choice| choice.effect.name == member.name)
                || self.user_fields.iter().any(|field| field.name == member.name)
        };
        let members: Vec<Member> = members.iter().filter(is_seen).cloned().collect();
        let Ok(stage) = self.stage(prepared, triads, &seen, &members, Beside::Nothing) else { return Ok(None) };
        let (own, fields) = self.of_members(&seen, &stage.members);
        let terms = Terms::try_new(&own, &fields, &self.samples, self.kinds)?;
        let setting = Setting::new(prepared, &terms, &stage.model)?;
        if !setting.has_axes(stage.design.axes()) {
            return Ok(None);
        }
        let (epochs, columns) = setting.by_epoch(block);
        if epochs.len() < LEAST_EPOCHS {
            return Ok(None);
        }
        let known = stage.design.known();
        let gram = known.with(&known.others(&columns));
        let first = stage.design.gram.residual;
        let beside = (first..first + columns.ncols()).map(|place| (place, block.typical())).collect();
        let weighing = Weighing::new(&gram, &stage.design.model, beside);
        // Residuals are weighted by sensor noise only. The noise scales (chi2 per degree of freedom) are not estimated,
        // because the variation itself would increase them.
        let Some(swept) = weighing.sweep(&vec![1.0; gram.sums.len()]) else { return Ok(None) };
        let (information, slope) = weighing.left(&swept).information();
        Ok(Some(Observed { epochs, information, slope }))
    }
}

/// Log likelihood of the deviations x: slope^T x - 1/2 x^T information x. x contains the deviation of the parameter in
/// each epoch, in multiples of its typical deviation ([`Block::typical`]). All epochs of the x axis come first, then
/// all epochs of the y axis and of the z axis.
struct Observed {
    epochs: Vec<Epoch>,
    information: Mat<f64>,
    slope: Vec<f64>,
}

impl Observed {
    /// Selects the time course and returns its kernel; `None` for a random walk. A smooth or switching time course is
    /// selected if its log evidence exceeds that of the random walk and that of independent deviations by more than
    /// [`LEAST`] nats. Otherwise, the random walk and independent deviations are compared, and the one with the larger
    /// log evidence is selected.
    fn kernel(&self) -> Option<Kernel> {
        let end_s = self.epochs.iter().map(|epoch| epoch.time_s).fold(0.0, f64::max);
        let walk = self.best_of(self.steps()?, |a, b| a.time_s.min(b.time_s) / end_s)?;
        let rms = self.rms()?;
        let smooth = LENGTHS.iter().filter_map(|share| {
            let length_s = share * end_s;
            self.best_of(rms, |a, b| (-0.5 * ((a.time_s - b.time_s) / length_s).powi(2)).exp())
        });
        let smooth = smooth.reduce(f64::max).map(|log| (log, Kernel::Time));
        let switching = self.switching().map(|log| (log, Kernel::Switching));
        let white = SIZES.iter().filter_map(|size| self.white(rms.map(|rms| size * rms)).map(|found| found.log));
        let white = white.reduce(f64::max).unwrap_or(f64::NEG_INFINITY);
        let best = smooth.into_iter().chain(switching).max_by(|a, b| a.0.total_cmp(&b.0));
        match best.filter(|(log, _)| *log > walk.max(white) + LEAST) {
            Some((_, kernel)) => Some(kernel),
            None => (walk < white).then_some(Kernel::White),
        }
    }

    /// For each axis: the rms of the deviations over all epochs, after subtraction of their mean. The deviations are
    /// estimated by a fit in which the deviation of each epoch has an independent prior.
    fn rms(&self) -> Option<[f64; 3]> {
        let n = self.epochs.len();
        let x = self.most_likely(1.0)?;
        Some([0, 1, 2].map(|axis| {
            let own = &x[axis * n..(axis + 1) * n];
            let mean = own.iter().sum::<f64>() / n as f64;
            (own.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n as f64).sqrt().max(1e-3)
        }))
    }

    /// Estimated size of a random walk (its standard deviation at the last epoch) on each axis: rms(d) x sqrt(n), where
    /// d are the n differences between consecutive epochs.
    fn steps(&self) -> Option<[f64; 3]> {
        let n = self.epochs.len();
        let x = self.most_likely(1.0)?;
        Some([0, 1, 2].map(|axis| {
            let own = &x[axis * n..(axis + 1) * n];
            own.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>().sqrt().max(1e-3)
        }))
    }

    /// Most likely deviations if the prior in each epoch has the standard deviation `width`.
    fn most_likely(&self, width: f64) -> Option<Vec<f64>> {
        let mut normal = self.information.clone();
        (0..normal.nrows()).for_each(|i| normal[(i, i)] += width.powi(-2));
        let right = Mat::from_fn(self.slope.len(), 1, |i, _| self.slope[i]);
        let solved = normal.llt(faer::Side::Lower).ok()?.solve(&right);
        Some(solved.col_as_slice(0).to_vec())
    }

    /// Largest log evidence of a Gaussian process over all trial sizes and trial scatters. `covariance` is the
    /// covariance of the process in two epochs, for unit size. The trial sizes are multiples of `sizes`.
    fn best_of(&self, sizes: [f64; 3], covariance: impl Fn(&Epoch, &Epoch) -> f64) -> Option<f64> {
        let n = self.epochs.len();
        let unit = Mat::from_fn(n, n, |i, j| {
            let (a, b) = (&self.epochs[i], &self.epochs[j]);
            if a.recording == b.recording { covariance(a, b) } else { 0.0 }
        });
        let log = |size: f64, scatter: f64| -> Option<f64> {
            checkpoint();
            let mut normal = self.information.clone();
            let mut volume = 0.0;
            for axis in 0..3 {
                let own = Mat::from_fn(n, n, |i, j| {
                    (size * sizes[axis]).powi(2) * unit[(i, j)] + if i == j { scatter * scatter } else { 0.0 }
                });
                let factor = own.llt(faer::Side::Lower).ok()?;
                volume += log_determinant(factor.L());
                let inverse = factor.solve(Mat::<f64>::identity(n, n));
                for j in 0..n {
                    (0..n).for_each(|i| normal[(axis * n + i, axis * n + j)] += inverse[(i, j)]);
                }
            }
            let factor = normal.llt(faer::Side::Lower).ok()?;
            let right = Mat::from_fn(3 * n, 1, |i, _| self.slope[i]);
            let solved = factor.solve(&right);
            let gain: f64 = (0..3 * n).map(|i| solved[(i, 0)] * self.slope[i]).sum();
            Some(0.5 * (gain - volume - log_determinant(factor.L())))
        };
        let trials = SIZES.iter().flat_map(|size| SCATTERS.map(|scatter| (*size, scatter)));
        trials.filter_map(|(size, scatter)| log(size, scatter)).reduce(f64::max)
    }

    /// Log evidence of the switching time course with the most likely states, maximised over the trial scatters.
    fn switching(&self) -> Option<f64> {
        let rms = self.rms()?;
        let size = rms.iter().map(|rms| rms * rms).sum::<f64>().sqrt();
        let x = self.most_likely(1.0)?;
        let starts = starts_of(&x);
        let log = |scatter: f64| -> Option<f64> {
            let scattered = self.scattered(scatter)?;
            let all = starts.iter().map(|start| scattered.most_likely_states(start, 2.0 * size));
            all.reduce(f64::max).map(|log| log + scattered.log)
        };
        SCATTERS.iter().filter_map(|scatter| log(*scatter)).reduce(f64::max)
    }

    /// Fits deviations that are independent in each epoch. `scatter` is the standard deviation of their prior on each
    /// axis.
    fn white(&self, scatter: [f64; 3]) -> Option<White> {
        checkpoint();
        let n = self.slope.len();
        let scatter = |i: usize| scatter[i / self.epochs.len()];
        let mut normal = self.information.clone();
        (0..n).for_each(|i| normal[(i, i)] += scatter(i).powi(-2));
        let factor = normal.llt(faer::Side::Lower).ok()?;
        let right = Mat::from_fn(n, 1, |i, _| self.slope[i]);
        let most_likely = factor.solve(&right).col_as_slice(0).to_vec();
        let gain: f64 = most_likely.iter().zip(&self.slope).map(|(x, slope)| x * slope).sum();
        let volume: f64 = (0..n).map(|i| 2.0 * scatter(i).ln()).sum();
        let log = 0.5 * (gain - volume - log_determinant(factor.L()));
        Some(White { factor, most_likely, log })
    }

    /// Eliminates the white scatter of the deviation from epoch to epoch, and returns the remaining information about
    /// the time course. `scatter` is the standard deviation of this scatter.
    fn scattered(&self, scatter: f64) -> Option<Scattered> {
        let White { factor, most_likely, log } = self.white([scatter; 3])?;
        // White scatter adds w^2 I to the covariance Lambda^-1 of the deviations. Lambda is `self.information`, w is
        // `scatter`, and `factor` is the Cholesky factor of Lambda + w^-2 I. The information that remains about the
        // time course is (Lambda^-1 + w^2 I)^-1 = Lambda - Lambda (Lambda + w^-2 I)^-1 Lambda.
        let information = &self.information - &self.information * factor.solve(&self.information);
        let slope = most_likely.iter().map(|x| x / (scatter * scatter)).collect();
        Some(Scattered { information, slope, log })
    }
}

fn log_determinant(factor: faer::MatRef<'_, f64>) -> f64 {
    2.0 * (0..factor.nrows()).map(|i| factor[(i, i)].ln()).sum::<f64>()
}

/// Start values for the states (0 or 1) of a switching time course: returns three lists with a state for each epoch.
/// `x` contains the deviation of the parameter in each epoch, first along x, then along y, then along z. The deviations
/// are projected on their principal direction, and a threshold divides the projections into the two states. Each of the
/// three lists results from a different threshold.
fn starts_of(x: &[f64]) -> Vec<Vec<f64>> {
    let n = x.len() / 3;
    let at = |k: usize| Vector3::new(x[k], x[n + k], x[2 * n + k]);
    let mean = (0..n).map(at).sum::<Vector3<f64>>() / n as f64;
    let spread: Matrix3<f64> = (0..n).map(|k| (at(k) - mean) * (at(k) - mean).transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let along: Vec<f64> = (0..n).map(|k| direction.dot(&at(k))).collect();
    let (low, high) = along.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    let divided = |share: f64| along.iter().map(|x| f64::from(u8::from(*x > low + share * (high - low)))).collect();
    [0.3, 0.5, 0.7].map(divided).to_vec()
}

/// The fit of independent deviations with a normal prior.
struct White {
    /// Cholesky factor of the information matrix of the deviations plus the precisions of their prior.
    factor: Llt<f64>,
    most_likely: Vec<f64>,
    /// Log evidence.
    log: f64,
}

/// Information about the time course of a deviation after elimination of the white scatter from epoch to epoch.
struct Scattered {
    information: Mat<f64>,
    slope: Vec<f64>,
    /// Log evidence of white scatter without a time course.
    log: f64,
}

impl Scattered {
    /// Submatrix (3 x 3, axis x axis) of the information matrix for the deviations in the epochs `k` and `j`.
    fn between(&self, k: usize, j: usize) -> Matrix3<f64> {
        let n = self.slope.len() / 3;
        Matrix3::from_fn(|a, b| self.information[(a * n + k, b * n + j)])
    }

    fn slope_at(&self, k: usize) -> Vector3<f64> {
        let n = self.slope.len() / 3;
        Vector3::from_fn(|a, _| self.slope[a * n + k])
    }

    /// Largest log evidence of a switching time course with white scatter, relative to white scatter only. The search
    /// starts at `states`, and changes one state at a time as long as the evidence increases. `size` is the standard
    /// deviation of the prior of the difference between the two levels.
    fn most_likely_states(&self, states: &[f64], size: f64) -> f64 {
        let n = states.len();
        let mut states = states.to_vec();
        // For each epoch k: the sum over all epochs j of between(k, j) x state of j.
        let mut beside: Vec<Matrix3<f64>> =
            (0..n).map(|k| (0..n).map(|j| self.between(k, j) * states[j]).sum()).collect();
        let mut information: Matrix3<f64> = (0..n).map(|k| beside[k] * states[k]).sum();
        let mut slope: Vector3<f64> = (0..n).map(|k| self.slope_at(k) * states[k]).sum();
        let mut best = log_of_levels(&information, &slope, size) - cost(&states);
        for _ in 0..MOST_PASSES {
            checkpoint();
            let before = best;
            for k in 0..n {
                let (last, own) = (states[k], self.between(k, k));
                let mut chosen = None;
                for state in SHARES.into_iter().filter(|state| *state != last) {
                    let change = state - last;
                    let with = information + (beside[k] + beside[k].transpose()) * change + own * (change * change);
                    let slope = slope + self.slope_at(k) * change;
                    states[k] = state;
                    let log = log_of_levels(&with, &slope, size) - cost(&states);
                    if log > best {
                        (best, chosen) = (log, Some((state, with, slope)));
                    }
                }
                states[k] = last;
                if let Some((state, with, with_slope)) = chosen {
                    (states[k], information, slope) = (state, with, with_slope);
                    (0..n).for_each(|j| beside[j] += self.between(j, k) * (state - last));
                }
            }
            if best <= before {
                break;
            }
        }
        best
    }
}

/// Log evidence of a difference between the two levels, relative to equal levels. `information` and `slope` (gradient
/// at zero) describe the log likelihood of the difference on the three axes. Its prior has the standard deviation
/// `size` on each axis.
fn log_of_levels(information: &Matrix3<f64>, slope: &Vector3<f64>, size: f64) -> f64 {
    let Some(factor) = (information + Matrix3::identity() / (size * size)).cholesky() else {
        return f64::NEG_INFINITY;
    };
    0.5 * (slope.dot(&factor.solve(slope)) - factor.ln_determinant()) - 3.0 * size.ln()
}

/// Information needed to describe the states, nats: the number of changes, the epochs of the changes, and the state of
/// each epoch that contains a change.
fn cost(states: &[f64]) -> f64 {
    let n = states.len();
    let parts = states.iter().filter(|state| state.fract() != 0.0).count();
    // An epoch that contains a change differs from both neighbours, so such a change gives two pairs of unequal states.
    let changes = states.windows(2).filter(|pair| pair[0] != pair[1]).count().saturating_sub(parts);
    let places = ln_binomial(n as u64, changes as u64);
    (n as f64).ln() + places + parts as f64 * (SHARES.len() as f64).ln()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::cancellation::Cancellation;

    const EPOCHS: usize = 60;
    const STEP_S: f64 = 5.0;
    /// Standard deviation of the noise in the simulated observation of one epoch, in multiples of the typical deviation
    /// of the parameter.
    const NOISE: f64 = 0.15;

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        random.sample(StandardNormal)
    }

    /// Simulates noisy observations of the deviation `x` in epochs of 5 s, and returns the log likelihood of `x`. The
    /// mean of the deviation is unknown.
    fn observed(x: impl Fn(usize) -> [f64; 3], random: &mut ChaCha8Rng) -> Observed {
        let epochs = (0..EPOCHS).map(|k| Epoch { recording: 0, time_s: (k as f64 + 0.5) * STEP_S }).collect();
        let weight = NOISE.powi(-2);
        let mut read: Vec<f64> = (0..3 * EPOCHS).map(|i| x(i % EPOCHS)[i / EPOCHS] + NOISE * normal(random)).collect();
        for own in read.chunks_mut(EPOCHS) {
            let mean = own.iter().sum::<f64>() / EPOCHS as f64;
            own.iter_mut().for_each(|x| *x -= mean);
        }
        let information = Mat::from_fn(3 * EPOCHS, 3 * EPOCHS, |i, j| {
            let same_axis = if i / EPOCHS == j / EPOCHS { weight / EPOCHS as f64 } else { 0.0 };
            if i == j { weight - same_axis } else { -same_axis }
        });
        Observed { epochs, information, slope: read.iter().map(|x| x * weight).collect() }
    }

    fn kernels(course: impl Fn(&mut ChaCha8Rng) -> Box<dyn Fn(usize) -> [f64; 3]>) -> Vec<Option<Kernel>> {
        let of_seed = |seed| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let x = course(&mut random);
            observed(x, &mut random).kernel()
        };
        (0..20).map(of_seed).collect()
    }

    fn count(found: &[Option<Kernel>], wanted: Option<Kernel>) -> usize {
        found.iter().filter(|own| **own == wanted).count()
    }

    /// Simulates a random walk, and returns the deviation in each epoch. `step` is the standard deviation of its steps
    /// from epoch to epoch.
    fn random_walk(step: f64, random: &mut ChaCha8Rng) -> Box<dyn Fn(usize) -> [f64; 3]> {
        let mut at = [0.0; 3];
        let path: Vec<[f64; 3]> = (0..EPOCHS)
            .map(|_| {
                at.iter_mut().for_each(|x| *x += step * normal(random));
                at
            })
            .collect();
        Box::new(move |k| path[k])
    }

    #[test]
    fn a_random_walk_stays_a_random_walk() {
        let found = kernels(|random| random_walk(0.4, random));
        assert!(count(&found, None) >= 19, "{found:?}");
    }

    /// The steps of this walk are smaller than the noise of the epochs, so the walk is hardly more likely than
    /// independent deviations.
    #[test]
    fn a_weak_random_walk_stays_a_random_walk() {
        let found = kernels(|random| random_walk(0.1 * NOISE, random));
        assert!(count(&found, None) >= 14, "{found:?}");
    }

    #[test]
    fn independent_deviations_are_no_random_walk() {
        for size in [0.2, 0.6, 2.0] {
            let found = kernels(|random| {
                let x: Vec<[f64; 3]> = (0..EPOCHS).map(|_| [(); 3].map(|()| size * normal(random))).collect();
                Box::new(move |k| x[k])
            });
            assert!(count(&found, Some(Kernel::White)) >= 19, "{size}: {found:?}");
        }
    }

    #[test]
    fn a_slow_swing_is_smooth() {
        let found = kernels(|random| {
            let (period, phase) = (random.random_range(12.0..30.0), random.random_range(0.0..6.0));
            let size = [(); 3].map(|()| normal(random));
            Box::new(move |k| size.map(|size| 2.0 * size * (std::f64::consts::TAU * k as f64 / period + phase).sin()))
        });
        // A slow oscillation with a period of only 12 epochs may resemble a switch with intermediate states.
        assert!(count(&found, None) == 0 && count(&found, Some(Kernel::Time)) >= 18, "{found:?}");
    }

    #[test]
    fn a_load_that_switches_has_two_levels() {
        let found = kernels(|random| {
            let mut is_on = false;
            // For each epoch: the share of time in which the load that shifts the parameter is switched on.
            let states: Vec<f64> = (0..EPOCHS)
                .map(|_| {
                    let changes = random.random_range(0.0..1.0) < 0.15;
                    let before = f64::from(u8::from(is_on));
                    is_on ^= changes;
                    let share: f64 = random.random_range(0.0..1.0);
                    if changes { share * before + (1.0 - share) * (1.0 - before) } else { before }
                })
                .collect();
            let size = [(); 3].map(|()| normal(random));
            Box::new(move |k| size.map(|size| 2.0 * size * states[k]))
        });
        assert!(count(&found, Some(Kernel::Switching)) >= 19, "{found:?}");
    }

    #[test]
    fn the_comparison_of_courses_can_be_cancelled() {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let observed = observed(|_| [0.0; 3], &mut random);
        let cancellation = Cancellation::new();
        cancellation.cancel();
        assert!(matches!(cancellation.run(|| Ok(observed.kernel())), Err(Error::Cancelled)));
    }
}
