//! Computes the goodness of fit relative to noise, for the whole fit and for each rest and move (model.md (26)).
//!
//! ```text
//! chi2 = r^T P r,     p = probability that chi2 with N - n degrees of freedom is larger
//! ```
//!
//! r are all N residuals, and n is the number of fitted parameters. P is the inverse covariance of the residuals, minus
//! the part that the parameters explain (formula: model.md (25)). The chi2 of a rest or of a move is d of equation
//! (25): the decrease of chi2 if the residuals of this rest or move are excluded. The residuals of a rest are those of
//! its force norm and of its mean rates about the three axes. If noise explains the residuals, d has a chi2
//! distribution for any leverage of the rest or move. The weights are from sensor noise only: standard deviations are
//! not increased for excess scatter.

mod groups;

use faer::Mat;
use faer::linalg::solvers::Solve;
use std::ops::Range;
use std::sync::Arc;

use super::linear::{Linear, Source};
use super::outliers::LeaveOut;
use super::prepared::Prepared;
use super::problem::Joint;
use super::terms::Terms;
use crate::error::Error;
use crate::joint::move_ends::move_direction;
use crate::joint::outliers::by_means;
use crate::numerics::stats::{dot, p_value};
use crate::verdict::GroupMisfit;
use groups::group_misfits;

/// Goodness of fit of a set of residuals, relative to noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Sum of squares of the residuals, after each residual is divided by its standard deviation.
    pub chi2: f64,
    /// Degrees of freedom of chi2. They equal the expected value of chi2 if noise explains the residuals.
    pub degrees_of_freedom: usize,
    /// Probability of a larger chi2 if noise explains the residuals.
    pub p_value: f64,
}

impl Misfit {
    /// Goodness of fit with this chi2; `None` if there are no degrees of freedom.
    fn new(chi2: f64, degrees_of_freedom: usize) -> Option<Self> {
        let p_value = p_value(chi2, degrees_of_freedom);
        (degrees_of_freedom > 0).then_some(Self { chi2, degrees_of_freedom, p_value })
    }
}

/// Goodness of fit of all residuals, of each rest and of each move. It is `None` for rests and moves that the fit does
/// not use. It is also `None` if a parameter is not determined without the rest or move. The fit then reproduces any
/// measured value of this rest or move (leverage near one).
pub(crate) struct Misfits {
    pub(crate) all: Option<Misfit>,
    pub(crate) rests: Vec<Option<Misfit>>,
    pub(crate) moves: Vec<Option<Misfit>>,
    /// Goodness of fit of each kind of residuals that has degrees of freedom.
    pub(crate) groups: Vec<GroupMisfit>,
    /// Two values for each parameter with a prior: the residual of the prior divided by its standard deviation after
    /// the fit, and 1 - h, where h is the leverage of this residual. 1 - h is the share of its variance that remains
    /// after the fit. `None` if no other residual depends on the parameter.
    pub(crate) held: Vec<Option<(f64, f64)>>,
}

impl Misfits {
    /// Computes the goodness of fit. `linear` contains the residuals at the end of the fit and their derivatives.
    pub(crate) fn of(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Arc<Linear>) -> Result<Self, Error> {
        let problem = Joint::of_noise(prepared, terms, Arc::clone(linear))?;
        let (residuals, jacobian) = problem.whiten(linear);
        let without = LeaveOut::new(&problem, linear, (&residuals, &jacobian));
        // All epochs (parts) of a long rest are tested together as one rest.
        let (whole, count) =
            (|k: usize| prepared.rests[k].whole, prepared.rests.last().map_or(0, |rest| rest.whole + 1));
        let (mut of_rests, mut of_moves) = (vec![Vec::new(); count], vec![Vec::new(); linear.moves.len()]);
        for (row, line) in linear.lines.iter().enumerate() {
            match line.source {
                Source::Norm(k) => of_rests[whole(k)].push(row),
                Source::Move(k) => of_moves[k].push(row),
            }
        }
        for (place, (k, _)) in linear.rates.iter().enumerate() {
            let first = linear.lines.len() + 3 * place;
            of_rests[whole(*k)].extend(first..first + 3);
        }
        let judged = |groups: Vec<Vec<usize>>| -> Vec<Option<Misfit>> {
            let judge = |rows: Vec<usize>| {
                let (chi2, degrees_of_freedom) = without.misfit(&rows);
                Misfit::new(chi2, degrees_of_freedom)
            };
            groups.into_iter().map(judge).collect()
        };
        let (chi2, degrees_of_freedom) = without.whole();
        Ok(Self {
            all: Misfit::new(chi2, degrees_of_freedom),
            rests: judged(of_rests),
            moves: judged(of_moves),
            groups: group_misfits(linear, (&residuals, &jacobian), &problem.weights),
            held: (0..prepared.held.len()).map(|k| without.standardised(linear.groups().stand_moves.end + k)).collect(),
        })
    }
}

/// A vector (a Jacobian column, or the change of the residuals due to one error) is treated as linearly dependent on
/// other vectors if its part orthogonal to them is shorter than this fraction of its length. The value is far above
/// rounding errors.
const LEAST: f64 = 1e-6;

/// Prediction errors of held-out rests and moves (model.md (34)). An error is `None` if the other residuals do not
/// determine all parameters.
pub(crate) struct HeldOut {
    /// Angle between the propagated and the measured gravity direction after each move, rad, computed with parameters
    /// that are estimated without this move.
    pub(crate) direction_rad: Vec<Option<f64>>,
    /// For each rest that the fit uses: its index, and |f| - g, m/s^2, computed with parameters that are estimated
    /// without this rest.
    pub(crate) norm_mps2: Vec<(usize, Option<f64>)>,
}

impl Joint<'_> {
    /// Cross-validates the fit with `folds` folds of moves and `folds` folds of rests. Fold i holds out every
    /// `folds`-th move, or every `folds`-th rest, starting with index i.
    pub(crate) fn held_out(&self, linear: &Linear, folds: usize) -> HeldOut {
        let parts = Parts::new(self, linear);
        let mut direction_rad = vec![None; linear.moves.len()];
        let norms: Vec<(usize, usize)> = (linear.lines.iter().enumerate())
            .filter_map(|(row, line)| if let Source::Norm(k) = line.source { Some((k, row)) } else { None })
            .collect();
        let mut norm_mps2: Vec<(usize, Option<f64>)> = norms.iter().map(|(k, _)| (*k, None)).collect();
        for fold in 0..folds {
            let is_out = |k: usize| k % folds == fold;
            let of_fold = |line: usize| matches!(linear.lines[line].source, Source::Move(k) if is_out(k));
            let columns = (0..linear.lines.len()).filter(|&row| of_fold(row)).collect::<Vec<_>>();
            if let Some(change) = parts.without(&columns, |item| matches!(item, Source::Move(k) if is_out(k))) {
                for k in (fold..linear.moves.len()).step_by(folds) {
                    let (residual, jacobian) = move_direction(&linear.moves[k]);
                    let moved =
                        |c: usize| residual[c] + jacobian.iter().zip(&change).map(|(j, d)| j[c] * d).sum::<f64>();
                    direction_rad[k] = Some(moved(0).hypot(moved(1)).min(1.0).asin());
                }
            }
            let rests: Vec<usize> = norms.iter().skip(fold).step_by(folds).map(|(k, _)| *k).collect();
            let columns = parts.columns_of(linear, &rests);
            if let Some(change) = parts.without(&columns, |item| matches!(item, Source::Norm(k) if rests.contains(&k)))
            {
                for place in (fold..norms.len()).step_by(folds) {
                    let line = &linear.lines[norms[place].1];
                    norm_mps2[place].1 = Some(line.residual + line.change(&change));
                }
            }
        }
        HeldOut { direction_rad, norm_mps2 }
    }
}

/// Whitened residuals, divided into residuals with correlated errors and residuals with independent errors. Each fit of
/// a cross-validation omits the rests or moves of one fold. The cross-validation is fast, because the Gram matrices of
/// the residuals with independent errors are computed only once for all fits.
struct Parts {
    /// Length of each column of the whitened Jacobian, before the column is scaled to length one.
    size: Vec<f64>,
    /// Indices of the Jacobian columns that are not zero.
    kept: Vec<usize>,
    /// Whitened residuals of force norms at rests, gravity directions after moves, and mean rates at rests. Their
    /// errors are correlated before whitening. The first columns are the columns of the Jacobian, scaled to length one.
    /// The last column contains the residuals.
    shared: Mat<f64>,
    /// For each rest or move: Gram matrix `[J r]^T [J r]` of its independent residuals, which are the residuals
    /// inside moves and the residuals relative to the stand. J and r are their whitened Jacobian and residuals.
    others: Vec<(Source, Mat<f64>)>,
    /// Gram matrix `[J r]^T [J r]` of the residuals of the priors.
    given: Mat<f64>,
    /// For each possible error of a force norm, of a gravity direction after a move, of a mean rate, or of a component
    /// of a mean force: the change of the whitened residuals due to a unit error. The change is stored as the index of
    /// its first nonzero entry and the entries from there on.
    units: Vec<(usize, Vec<f64>)>,
}

impl Parts {
    fn new(problem: &Joint<'_>, linear: &Linear) -> Self {
        let (residuals, jacobian) = problem.whiten(linear);
        let size: Vec<f64> = (0..jacobian.ncols()).map(|p| jacobian.col(p).norm_l2()).collect();
        let kept: Vec<usize> = (0..size.len()).filter(|&p| size[p] > 0.0).collect();
        let n = kept.len();
        let part = |rows: std::ops::Range<usize>| {
            Mat::from_fn(rows.len(), n + 1, |i, p| {
                let row = rows.start + i;
                if p < n { jacobian[(row, kept[p])] / size[kept[p]] } else { residuals[(row, 0)] }
            })
        };
        let head = linear.head_rows();
        let of_rows = |(source, rows): (Source, std::ops::Range<usize>)| {
            let own = part(rows);
            (source, own.transpose() * &own)
        };
        let last = linear.groups().stand_moves.end..residuals.nrows();
        let given = part(last.clone()).transpose() * &part(last);
        let others = linear.rows_beyond_rates().into_iter().map(of_rows).collect();
        let mut units = problem.whitened_units(linear);
        units.extend(by_means(linear, &units));
        let shared = part(0..head);
        Self { size, kept, shared, others, given, units }
    }

    /// Indices into `units` of the errors that become free parameters if `rests` are held out: the errors of their mean
    /// rates and of their mean forces.
    fn columns_of(&self, linear: &Linear, rests: &[usize]) -> Vec<usize> {
        let places = linear.rates.iter().enumerate().filter(|(_, (k, _))| rests.contains(k)).map(|(place, _)| place);
        let (rates, means) = (linear.lines.len(), linear.head_rows());
        places.flat_map(|place| [rates, means].map(|first| first + 3 * place)).flat_map(|at| at..at + 3).collect()
    }

    /// Repeats the fit without some of the residuals, and returns the change of the parameters; `None` if this fit does
    /// not determine all parameters. Residuals with independent errors are omitted if `is_out` is true for their rest
    /// or move. Force norms, gravity directions after moves and mean rates have errors in common with other residuals,
    /// so they are not omitted. Instead, such a residual is held out by a free parameter for its error, because a
    /// residual with an unknown error has no influence on the fit. `columns` are the indices of these errors in
    /// `units`.
    fn without(&self, columns: &[usize], is_out: impl Fn(Source) -> bool) -> Option<Vec<f64>> {
        let (rows, n) = (self.shared.nrows(), self.kept.len());
        let mut basis: Vec<Stretch> = Vec::with_capacity(columns.len());
        for &column in columns {
            let (first, values) = &self.units[column];
            let mut direction = Stretch { first: *first, values: values.clone() };
            let length = norm(&direction.values);
            // Gram-Schmidt orthogonalisation. Two passes give machine precision.
            for _ in 0..2 {
                basis.iter().for_each(|known| direction.leave_out(known));
            }
            let left = norm(&direction.values);
            if left > LEAST * length {
                direction.values.iter_mut().for_each(|d| *d /= left);
                basis.push(direction);
            }
        }
        let basis = Mat::from_fn(rows, basis.len(), |row, c| basis[c].at(row));
        let seen = &self.shared - &basis * (basis.transpose() * &self.shared);
        let mut normal = seen.transpose() * &seen + &self.given;
        for (_, own) in self.others.iter().filter(|(source, _)| !is_out(*source)) {
            normal += own;
        }
        let factor = normal.submatrix(0, 0, n, n).to_owned().llt(faer::Side::Lower).ok()?;
        if (0..n).any(|p| factor.L()[(p, p)] < LEAST) {
            return None;
        }
        let right = Mat::from_fn(n, 1, |p, _| -normal[(p, n)]);
        let solved = factor.solve(&right);
        let mut change = vec![0.0; self.size.len()];
        for (place, &p) in self.kept.iter().enumerate() {
            change[p] = solved[(place, 0)] / self.size[p];
        }
        Some(change)
    }
}

/// Vector with one entry per residual. Only consecutive entries, from index `first` on, are nonzero. The nonzero ranges
/// of two vectors rarely overlap, because only neighbouring residuals are correlated.
struct Stretch {
    first: usize,
    values: Vec<f64>,
}

impl Stretch {
    fn rows(&self) -> Range<usize> {
        self.first..self.first + self.values.len()
    }

    fn at(&self, row: usize) -> f64 {
        row.checked_sub(self.first).and_then(|k| self.values.get(k)).copied().unwrap_or(0.0)
    }

    /// Subtracts the component along `known`, a vector of length one.
    fn leave_out(&mut self, known: &Self) {
        let (own, other) = (self.rows(), known.rows());
        let both = own.start.max(other.start)..own.end.min(other.end);
        if both.is_empty() {
            return;
        }
        let all = own.start.min(other.start)..own.end.max(other.end);
        let part = |of: &Self| both.start - of.first..both.end - of.first;
        let along = dot(&self.values[part(self)], &known.values[part(known)]);
        self.values.splice(0..0, std::iter::repeat_n(0.0, own.start - all.start));
        self.values.resize(all.len(), 0.0);
        self.first = all.start;
        let to = &mut self.values[other.start - all.start..];
        to.iter_mut().zip(&known.values).for_each(|(d, k)| *d -= along * k);
    }
}

fn norm(values: &[f64]) -> f64 {
    dot(values, values).sqrt()
}
