//! Outlier detection of the joint fit: finds the rests and moves that contradict all others (model.md (25)).
//!
//! ```text
//! d = (A^T P r)^T (A^T P A)^-1 (A^T P r),   P = C^-1 - C^-1 J (J^T C^-1 J)^-1 J^T C^-1
//! ```
//!
//! r are the residuals, C is their covariance, and J is their Jacobian with respect to the parameters.
//!
//! d is the decrease of chi2 if the residuals may change freely along the columns of A and all parameters are fitted
//! again. There are two kinds of columns of A. A column of the first kind selects one residual: a component of the
//! gravity direction after a move, or the norm or a mean rate of a rest. A column of the second kind describes an error
//! of the mean force of a rest, which changes the norm of this rest and the residuals of the adjacent moves. Under the
//! null hypothesis, d has a chi2 distribution for any correlation of the residuals. Its degrees of freedom equal the
//! number of columns of A. C is due to sensor noise only. If all residuals of a kind (for example all force norms) have
//! excess scatter, their d are divided by a common scale, which is computed from the median of d. An item is a rest or
//! a move. The item with the smallest p-value is excluded, and all other items are tested again, until no p-value is
//! below `SIGNIFICANCE`.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use faer::Mat;
use imucal_core::STANDARD_GRAVITY_MPS2;
use nalgebra::{DMatrix, DVector};
use statrs::function::gamma::ln_gamma;

use super::choices::Kinds;
use super::linear::{Linear, Source};
use super::model::Model;
use super::prepared::Prepared;
use super::problem::Joint;
use super::terms::Terms;
use crate::error::Error;
use crate::numerics::lsq;
use crate::numerics::robust::may_exclude;
use crate::numerics::stats::{dot, median, p_value};
use crate::parameters::ACCEL;
use crate::two_stage::observability::{FARTHEST, LARGEST_SHIFT, REST_ERROR_MPS2};

/// Significance level. An item with a smaller p-value is excluded. With 400 tests (three for each of 100 rests, one for
/// each of 100 moves), the probability is 0.4 % that any item of a run without outliers is excluded.
const SIGNIFICANCE: f64 = 1e-5;
/// An error of a measurement changes the residuals, and the fit compensates a part of this change by a change of the
/// parameters. The error is tested only if more than this share of the change (squared norm of the whitened residuals)
/// remains after the fit. The share is 1 - h, where h is the leverage.
const MIN_RESIDUAL_SHARE: f64 = 0.05;
/// Limit of the diagonal entry R_kk in the QR decomposition of the scaled Jacobian. If |R_kk| is at most this limit,
/// column k is linearly dependent on the other columns. The limit is far above rounding errors.
const LINEAR_DEPENDENCE: f64 = 1e-9;
/// The residual of a prior is tested only if 1 - h is above this limit, where h is the leverage of the residual. With a
/// smaller 1 - h, rounding errors dominate the standardised residual.
const MIN_JUDGED: f64 = 1e-6;
/// Minimum number of rests that remain after exclusion (model.md (25)).
const MIN_REMAINING_RESTS: usize = 12;
/// Minimum number of moves that remain after exclusion (model.md (25)).
const MIN_REMAINING_MOVES: usize = 9;

/// A rest or a move of the fit, by its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Item {
    Rest(usize),
    Move(usize),
}

/// A rest or move, and the columns of A that are tested together for it. A column of A is an error pattern: the changes
/// of all residuals due to a unit error (model.md (25)).
struct Group {
    item: Item,
    columns: Vec<usize>,
    kind: Kind,
    /// Whether the item is the second or a later epoch (part) of a long rest, or the move that leads to such an epoch.
    /// The d of these items (decreases of chi2) have a separate scale, because all epochs of a rest have one attitude,
    /// and thus one common model error.
    is_of_later_epoch: bool,
}

impl Group {
    fn new(item: Item, columns: Vec<usize>, kind: Kind, is_of_later_epoch: bool) -> Self {
        Self { item, columns, kind, is_of_later_epoch }
    }
}

/// Kinds of residuals. Each kind has a scale: the decreases d of chi2 (model.md (25)) of all residuals of the kind are
/// divided by it.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Norm,
    Rate,
    Move,
    /// Error of the mean force of a rest. It changes the norm and the gravity direction of the rest, and thus also the
    /// residuals of the adjacent moves. Its scale is that of the norms or that of the moves, whichever is larger.
    Mean,
}

/// Finds the rests and moves that contradict all others, and returns them in the order of their exclusion. `model` must
/// be close to the best fit, because the residuals are linearised at `model`.
///
/// Moves are tested only with the gravity directions at their ends, even if the fit also uses the force inside the
/// moves or the stand. `known` contains residuals and derivatives that were already computed for `model`. It must
/// contain all rests and moves to be tested.
pub(crate) fn outliers(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    model: &Model,
    known: Option<&Arc<Linear>>,
) -> Result<Vec<Item>, Error> {
    const DIRECTIONS: Kinds = Kinds { in_motion: false, encoders: false };
    let known = known.filter(|_| terms.kinds == DIRECTIONS);
    let terms = Terms { kinds: DIRECTIONS, ..terms.clone() };
    let parameters = Model { stand: Vec::new(), ..model.clone() }.parameters();
    let linear =
        known.map_or_else(|| prepared.linearise(&terms, &parameters).map(Arc::new), |known| Ok(Arc::clone(known)))?;
    let problem = Joint::of_noise(prepared, &terms, Arc::clone(&linear))?;
    let groups = groups(&linear);
    let only_moves_judge = only_moves_judge(&linear);
    let (residuals, jacobian) = problem.whiten(&linear);
    let mut without = LeaveOut::new(&problem, &linear, (&residuals, &jacobian));
    let (mut rests, mut moves) = (prepared.used.to_vec(), vec![true; linear.moves.len()]);
    let mut found = Vec::new();
    loop {
        let open = |group: &&Group| match group.item {
            Item::Rest(k) => rests[k],
            Item::Move(k) => moves[k],
        };
        let judged: Vec<(&Group, f64, usize)> = groups
            .iter()
            .filter(open)
            .map(|group| (group, without.misfit(&group.columns)))
            .map(|(group, (misfit, freedom))| (group, misfit, freedom))
            .collect();
        let scales =
            [false, true].map(|later| [Kind::Norm, Kind::Rate, Kind::Move].map(|kind| scale((kind, later), &judged)));
        let log_p = |(group, misfit, freedom): &(&Group, f64, usize)| {
            let scales = scales[usize::from(group.is_of_later_epoch)];
            let scale = match group.kind {
                Kind::Norm if only_moves_judge.contains(&group.item) => scales[0].max(scales[2]),
                Kind::Norm => scales[0],
                Kind::Rate => scales[1],
                Kind::Move => scales[2],
                Kind::Mean => scales[0].max(scales[2]),
            };
            log_p_value(misfit / scale, *freedom)
        };
        let Some(worst) = judged.iter().min_by(|a, b| log_p(a).total_cmp(&log_p(b))) else { return Ok(found) };
        let item = worst.0.item;
        let is_later_rest = |k: usize| prepared.rests[k].is_later_epoch();
        let is_step = |k: usize| prepared.moves[k].is_within_rest(prepared.rests);
        let is_alike: &dyn Fn(usize) -> bool = match item {
            Item::Rest(_) => &|k| is_later_rest(k) == worst.0.is_of_later_epoch,
            Item::Move(_) => &|k| is_step(k) == worst.0.is_of_later_epoch,
        };
        let (used, fewest) = match item {
            Item::Rest(_) => (&mut rests, MIN_REMAINING_RESTS),
            Item::Move(_) => (&mut moves, MIN_REMAINING_MOVES),
        };
        // The later epochs (parts) of long rests do not count among the rests that must remain, because they have no
        // new attitude.
        let alike: Vec<bool> = (0..used.len()).filter(|&k| is_alike(k)).map(|k| used[k]).collect();
        let fewest = if worst.0.is_of_later_epoch { 0 } else { fewest };
        if log_p(worst) > SIGNIFICANCE.ln() || !may_exclude(&alike, fewest) {
            return Ok(found);
        }
        let (Item::Rest(k) | Item::Move(k)) = item;
        used[k] = false;
        found.push(item);
        // All residuals of the rest or move are excluded, even if only one of them was significant.
        let all = groups.iter().filter(|group| group.item == item).flat_map(|group| &group.columns);
        all.for_each(|&column| without.leave_out(column));
    }
}

/// Finds rests whose force norm the other rests do not predict, for example the only rest of a box-shaped unit on one
/// of its faces. Only the moves predict this norm, so its d (decrease of chi2) is divided by the scale of the norms or
/// by that of the moves, whichever is larger. Such a rest has a leverage above 0.95 in the design matrix of model.md
/// (12). This matrix has one row for each rest: the derivatives of the norm divided by a typical error of |f| that the
/// sensor model does not describe. It also has one row for each parameter, for a prior of the parameter about its
/// nominal value.
fn only_moves_judge(linear: &Linear) -> Vec<Item> {
    let scale = linear.model.accelerometer.sensitivity().norm() / 3f64.sqrt();
    let norms: Vec<(Item, &[f64])> = linear
        .lines
        .iter()
        .filter_map(|line| match line.source {
            Source::Norm(k) => Some((Item::Rest(k), &line.jacobian[ACCEL])),
            Source::Move(_) => None,
        })
        .collect();
    // Converts a derivative with respect to a parameter to one with respect to its relative change. A bias is relative
    // to the reading at 1 g, and an entry of the sensitivity is relative to the mean scale.
    let size = |p: usize| if p < 3 { STANDARD_GRAVITY_MPS2 * scale } else { scale };
    let design = Mat::from_fn(norms.len() + ACCEL.len(), ACCEL.len(), |i, p| match norms.get(i) {
        Some((_, by)) => by[p] * size(p) * LARGEST_SHIFT / REST_ERROR_MPS2,
        None => f64::from(u8::from(i - norms.len() == p)) * LARGEST_SHIFT / FARTHEST,
    });
    let leverages = lsq::leverages(&design);
    norms.iter().zip(leverages).filter(|(_, h)| 1.0 - h < MIN_RESIDUAL_SHARE).map(|((item, _), _)| *item).collect()
}

/// Computes the logarithm of the p-value of chi2. If the p-value underflows, an asymptotic expansion is used, so that
/// extreme outliers can still be ranked.
fn log_p_value(misfit: f64, freedom: usize) -> f64 {
    let p = p_value(misfit, freedom);
    let (half, x) = (freedom as f64 / 2.0, misfit / 2.0);
    if p > 1e-200 { p.ln() } else { (half - 1.0) * x.ln() - x - ln_gamma(half) }
}

/// Groups the columns of A (error patterns) that are tested together. There is one column for each residual (force
/// norms, gravity directions after moves, mean rates), then three columns for the mean force of each rest.
fn groups(linear: &Linear) -> Vec<Group> {
    let lines = &linear.lines;
    let mut groups: Vec<Group> =
        (0..linear.moves.len()).map(|k| Group::new(Item::Move(k), Vec::new(), Kind::Move, false)).collect();
    let mut norm_of = vec![None; linear.rates.iter().map(|(k, _)| k + 1).max().unwrap_or(0)];
    // At a hand-held rest, the gravity directions at the two ends are weighted means of the samples near these ends.
    // They are not computed from the mean force of the rest, so the adjacent moves do not depend on it.
    let mut in_moves = vec![false; norm_of.len()];
    for (row, line) in lines.iter().enumerate() {
        match line.source {
            Source::Move(k) => {
                groups[k].columns.push(row);
                groups[k].is_of_later_epoch = line.is_of_later_epoch;
                line.by_means.iter().for_each(|(k, _)| in_moves[*k] = true);
            }
            Source::Norm(k) => norm_of[k] = Some(row),
        }
    }
    for (place, (k, rates)) in linear.rates.iter().enumerate() {
        let (item, is_later) = (Item::Rest(*k), rates[0].is_of_later_epoch);
        let (rates, means) = (lines.len() + 3 * place, linear.head_rows() + 3 * place);
        groups.push(Group::new(item, norm_of[*k].into_iter().collect(), Kind::Norm, is_later));
        groups.push(Group::new(item, (rates..rates + 3).collect(), Kind::Rate, is_later));
        if in_moves[*k] {
            groups.push(Group::new(item, (means..means + 3).collect(), Kind::Mean, is_later));
        }
    }
    groups
}

/// Computes the changes of the whitened residuals due to a unit error of the mean force, for each rest and axis.
/// `units` are the changes due to a unit error of each force norm and each gravity direction after a move. Each result
/// is a vector, stored as the index of its first nonzero entry and the entries from there on.
pub(super) fn by_means(linear: &Linear, units: &[(usize, Vec<f64>)]) -> Vec<(usize, Vec<f64>)> {
    let of_axis = |rest: usize, axis: usize| {
        let lines = linear.lines.iter().zip(units);
        let seen = lines.flat_map(|(line, unit)| {
            line.by_means.iter().filter(move |(k, _)| *k == rest).map(move |(_, by)| (unit, by[axis]))
        });
        let seen: Vec<(&(usize, Vec<f64>), f64)> = seen.collect();
        let first = seen.iter().map(|((first, _), _)| *first).min().unwrap_or(0);
        let end = seen.iter().map(|((first, unit), _)| first + unit.len()).max().unwrap_or(0);
        let mut column = vec![0.0; end - first];
        for ((start, unit), by) in seen {
            column[start - first..].iter_mut().zip(unit).for_each(|(sum, value)| *sum += by * value);
        }
        (first, column)
    };
    linear.rates.iter().flat_map(|(rest, _)| [0, 1, 2].map(|axis| of_axis(*rest, axis))).collect()
}

/// Computes the scale (at least 1) of one kind of residuals relative to noise. Each decrease d of chi2 (model.md (25))
/// is divided by its expected median under the null hypothesis. The scale is the median of these ratios.
fn scale((kind, later): (Kind, bool), judged: &[(&Group, f64, usize)]) -> f64 {
    let is_own = |group: &Group| group.kind == kind && group.is_of_later_epoch == later;
    let of_kind = judged.iter().filter(|(group, _, freedom)| is_own(group) && *freedom > 0);
    // Median of the chi2 distribution (Wilson and Hilferty).
    let median_of = |freedom: f64| freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    let mut ratios: Vec<f64> = of_kind.map(|(_, misfit, freedom)| misfit / median_of(*freedom as f64)).collect();
    if ratios.is_empty() { 1.0 } else { median(&mut ratios).max(1.0) }
}

/// Linearised and whitened fit from which residuals can be excluded. To exclude a residual, the fit gets an additional
/// free parameter: the error of this residual. The derivatives of all residuals with respect to this error are a column
/// of A (model.md (25)).
pub(super) struct LeaveOut {
    /// Columns of `L^-1 A` (model.md (25)), where L is the Cholesky factor of the residual covariance C. Each is stored
    /// as the index of its first nonzero row and the values from that row on.
    columns: Vec<(usize, Vec<f64>)>,
    /// Orthonormal basis of the columns of the whitened Jacobian and of the excluded entries of `columns`.
    basis: Vec<Vec<f64>>,
    /// For each entry of `columns`: its dot products with the basis vectors.
    seen: Vec<Vec<f64>>,
    /// Residuals of the linearised fit: the whitened residuals after projection orthogonal to the basis.
    residuals: Vec<f64>,
}

impl LeaveOut {
    /// `residuals` and `jacobian` are those of `linear`, whitened by `problem`.
    pub(super) fn new(problem: &Joint<'_>, linear: &Linear, (residuals, jacobian): (&Mat<f64>, &Mat<f64>)) -> Self {
        let mut columns = problem.whitened_units(linear);
        columns.extend(by_means(linear, &columns));
        let all = residuals.nrows();
        let mut without = Self {
            seen: vec![Vec::new(); columns.len()],
            columns,
            basis: Vec::new(),
            residuals: (0..all).map(|row| residuals[(row, 0)]).collect(),
        };
        let q = {
            let size: Vec<f64> = (0..jacobian.ncols()).map(|p| jacobian.col(p).norm_l2()).collect();
            let kept: Vec<usize> = (0..size.len()).filter(|&p| size[p] > 0.0).collect();
            let qr = Mat::from_fn(all, kept.len(), |row, p| jacobian[(row, kept[p])] / size[kept[p]]).col_piv_qr();
            // An effect and the biases may have linearly dependent columns, which do not increase the rank.
            let rank = (0..kept.len()).take_while(|&k| qr.thin_R()[(k, k)].abs() > LINEAR_DEPENDENCE).count();
            qr.compute_thin_Q().subcols(0, rank).to_owned()
        };
        (0..q.ncols()).for_each(|p| without.push((0..all).map(|row| q[(row, p)]).collect()));
        without
    }

    fn push(&mut self, direction: Vec<f64>) {
        let along = dot(&direction, &self.residuals);
        self.residuals.iter_mut().zip(&direction).for_each(|(r, d)| *r -= along * d);
        for ((first, column), seen) in self.columns.iter().zip(&mut self.seen) {
            seen.push(dot(&direction[*first..first + column.len()], column));
        }
        self.basis.push(direction);
    }

    /// Returns two values for the residual with the index `row`: the residual divided by its standard deviation after
    /// the fit, and 1 - h, where h is its leverage. 1 - h is the share of its variance that remains after the fit.
    /// `None` if the fit reproduces any value of the measurement, because h is close to one.
    pub(super) fn standardised(&self, row: usize) -> Option<(f64, f64)> {
        let free = 1.0 - self.basis.iter().map(|direction| direction[row] * direction[row]).sum::<f64>();
        (free > MIN_JUDGED).then(|| (self.residuals[row] / free.sqrt(), free))
    }

    /// chi2 of all residuals that are not excluded, and its number of degrees of freedom.
    pub(super) fn whole(&self) -> (f64, usize) {
        (dot(&self.residuals, &self.residuals), self.residuals.len().saturating_sub(self.basis.len()))
    }

    /// Computes by how much chi2 decreases if the error patterns of these columns (how an error changes the residuals)
    /// are fitted with free amplitudes. The second value is the number of degrees of freedom. Directions along which
    /// the fit reproduces any error (leverage near one) cannot be tested and are not counted.
    pub(super) fn misfit(&self, columns: &[usize]) -> (f64, usize) {
        let n = columns.len();
        if n == 0 {
            return (0.0, 0);
        }
        let whole = DMatrix::from_fn(n, n, |a, b| {
            let ((i, x), (j, y)) = (&self.columns[columns[a]], &self.columns[columns[b]]);
            let (start, end) = ((*i).max(*j), (i + x.len()).min(j + y.len()));
            if start < end { dot(&x[start - i..end - i], &y[start - j..end - j]) } else { 0.0 }
        });
        let Some(factor) = whole.clone().cholesky() else { return (0.0, 0) };
        let spent = DMatrix::from_fn(n, n, |a, b| dot(&self.seen[columns[a]], &self.seen[columns[b]]));
        let half = |m: &DMatrix<f64>| factor.l().solve_lower_triangular(m);
        let Some(spent) = half(&spent).and_then(|m| half(&m.transpose())) else { return (0.0, 0) };
        let seen = DVector::from_fn(n, |a, _| {
            let (first, column) = &self.columns[columns[a]];
            dot(&self.residuals[*first..first + column.len()], column)
        });
        let Some(seen) = factor.l().solve_lower_triangular(&seen) else { return (0.0, 0) };
        // An eigenvector is a linear combination of the error patterns. The eigenvalue is 1 - h, where h is the
        // leverage of the combination: the share of such an error that remains in the residuals after the fit.
        let eigen = (DMatrix::identity(n, n) - spent).symmetric_eigen();
        let free = (0..n).filter(|&k| eigen.eigenvalues[k] > MIN_RESIDUAL_SHARE);
        let misfit = free.clone().map(|k| eigen.eigenvectors.column(k).dot(&seen).powi(2) / eigen.eigenvalues[k]).sum();
        (misfit, free.count())
    }

    fn leave_out(&mut self, column: usize) {
        let (first, column) = &self.columns[column];
        let mut direction = vec![0.0; self.residuals.len()];
        direction[*first..first + column.len()].copy_from_slice(column);
        let size = dot(column, column).sqrt();
        // Gram-Schmidt orthogonalisation. Two passes give machine precision.
        for _ in 0..2 {
            for known in &self.basis {
                let along = dot(known, &direction);
                direction.iter_mut().zip(known).for_each(|(d, k)| *d -= along * k);
            }
        }
        let left = dot(&direction, &direction).sqrt();
        if left > 1e-6 * size {
            direction.iter_mut().for_each(|d| *d /= left);
            self.push(direction);
        }
    }
}
