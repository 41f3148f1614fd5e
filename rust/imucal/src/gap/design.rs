//! Linearises the residuals of a model. The Jacobian has columns for the parameters of the model and for the parameters
//! of all candidate effects.

use std::borrow::Cow;
use std::iter::once;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use faer::Mat;

use super::evidence::{Column, Gram};
use super::known::Known;
use super::predict::Held;
use crate::error::Error;
use crate::held;
use crate::joint::{EPOCH_RATES, INSIDE, Insides, Joint, Kinds, Lanes, Linear, Prepared, Source, Term, Terms};
use crate::parameters::BASE;
use crate::rests::moves::axis_aside;

/// A candidate effect in one form (for example linear or quadratic). An effect with several forms has one candidate for
/// each form, and the form with the fewest parameters comes first. An effect with a time constant has one candidate for
/// each trial value of the time constant.
#[derive(Clone)]
pub(crate) struct Candidate {
    pub(crate) name: String,
    /// Indices of the candidate's columns in the Gram matrices. Candidates for the forms of one effect share columns.
    pub(crate) columns: Range<usize>,
    /// Typical size of each parameter, SI units.
    pub(crate) typical: Vec<f64>,
    /// Trial time constant at which the columns are evaluated, s; `None` if the effect has no time constant.
    pub(crate) shape: Option<f64>,
}

/// Residuals of a model, with the Jacobian columns of the model and of the candidates.
#[derive(Clone)]
pub(crate) struct Design {
    /// Gram matrices (products of Jacobian columns), one for each group of residuals. Products of two columns from
    /// different candidate effects are NaN until one of these effects has been added to the model.
    pub(crate) gram: Gram,
    /// Jacobian columns of the model: base parameters (sensitivities and biases), effects, stand parameters.
    pub(crate) model: Vec<Column>,
    pub(crate) candidates: Vec<Candidate>,
    pub(crate) residual: Vec<f64>,
    pub(crate) rows: Arc<Rows>,
}

/// The Jacobian at one linearisation point, and the group (kind) of the residual in each row.
pub(crate) struct Rows {
    /// The Jacobian as computed from the samples; `None` if `columns` was given instead.
    made: Option<Made>,
    /// All Jacobian columns in one matrix, without the residual; computed when first needed.
    columns: OnceLock<Mat<f64>>,
    /// Gram matrices of all columns, one for each residual group; computed when first needed.
    products: OnceLock<Vec<Mat<f64>>>,
    /// Group (kind) of the residual in each row, as an index.
    groups: Vec<usize>,
    /// Index of the rest or move to which the residual of each row belongs. Rests and moves are numbered together in
    /// order of time.
    items: Vec<usize>,
    /// For each end of a move and each rest: the body axis that defines the directions of the two tilt residuals, see
    /// [`axes_of`].
    axes: Vec<usize>,
    /// Whether the Jacobian includes columns of generic hypotheses (unknown variations of a bias or scale).
    has_variations: bool,
}

/// Whitened Jacobian columns, and the whitened residual as the last column.
struct Made {
    /// Rows of all residuals except those of the specific force inside moves. If `inside` is `None`, there are no other
    /// rows.
    head: Lanes,
    inside: Option<Insides>,
    /// For each column: the position of its value within a stored row.
    order: Vec<usize>,
}

impl Made {
    /// The whole Jacobian as one matrix, without the residual.
    fn together(&self, rows: usize) -> Mat<f64> {
        let Self { head, inside, order } = self;
        let columns = &order[..order.len() - 1];
        let mut all = Mat::zeros(rows, columns.len());
        head.copy_columns(columns.iter().copied(), &mut all, 0);
        let Some(insides) = inside else { return all };
        let (mut lanes, mut first) = (insides.no_rows().clone(), head.rows());
        for k in 0..insides.moves() {
            insides.look(k, &mut lanes);
            lanes.copy_columns(columns.iter().copied(), &mut all, first);
            first += lanes.rows();
        }
        all
    }
}

impl Rows {
    /// The whole Jacobian as one matrix, without the residual.
    pub(crate) fn columns(&self) -> &Mat<f64> {
        let rows = self.groups.len();
        self.columns.get_or_init(|| self.made.as_ref().map_or_else(|| Mat::zeros(rows, 0), |made| made.together(rows)))
    }

    /// Group (kind) of the residual in each row, as an index.
    pub(crate) fn groups(&self) -> &[usize] {
        &self.groups
    }

    /// Index of the rest or move to which the residual of each row belongs. Rests and moves are numbered together in
    /// order of time.
    pub(crate) fn items(&self) -> &[usize] {
        &self.items
    }
}

/// Computes the whitened residuals and Jacobian of a model from `linear`, the linearisation at the parameters of the
/// model. `own` contains the effects of the model, and `precisions` are the precisions of their priors. `all` contains
/// the effects of the model and all candidates.
pub(crate) fn design(
    prepared: &Prepared<'_>,
    (own, precisions): (&Terms<'_>, &[f64]),
    all: &Terms<'_>,
    linear: &Arc<Linear>,
) -> Result<Design, Error> {
    let (head, inside) = Joint::of_noise(prepared, all, Arc::clone(linear))?.whiten_apart(linear);
    let place_in_all = |name: &str| all.all.iter().find(|term| term.name() == name).map_or(0, |term| term.first);
    let of_own: Vec<_> = own.all.iter().map(|t| (place_in_all(t.name()), t.count())).map(|(p, n)| p..p + n).collect();
    let values: Vec<f64> = of_own.iter().flat_map(|places| &linear.model.values[places.clone()]).copied().collect();
    let of_own = of_own.into_iter().map(|places| BASE + places.start..BASE + places.end);
    let mut parts: Vec<_> = once(0..BASE).chain(of_own).chain(once(BASE + all.count..all.total())).collect();
    let mut width = own.total();
    let (mut candidates, mut blocks) = (Vec::new(), Vec::new());
    for term in all.all.iter().filter(|term| !own.all.iter().any(|own| own.name() == term.name())) {
        parts.push(BASE + term.first..BASE + term.first + term.linear);
        candidates.extend(term.forms().map(|count| Candidate {
            name: term.name().to_owned(),
            columns: width..width + count,
            typical: term.typical()[..count].to_vec(),
            shape: term.frozen_shape(),
        }));
        blocks.push(width..width + term.linear);
        width += term.linear;
    }
    let order: Vec<usize> = parts.into_iter().flatten().chain([all.total()]).collect();
    let (groups, items) = (linear.groups_of_rows(), items_of_rows(prepared, linear, own.kinds));
    let of_head = (&head, &groups[..head.rows()]);
    let (gram, of_insides) = Gram::beside(of_head, inside.as_ref(), &order, (own.total(), &blocks));
    let residual = head.column(all.total()).chain(of_insides).collect();
    let made = Some(Made { head, inside, order });
    let rows = Rows {
        made,
        columns: OnceLock::new(),
        products: OnceLock::new(),
        groups,
        items,
        axes: axes_of(linear),
        has_variations: false,
    };
    Ok(Design {
        gram,
        model: columns_of((own, precisions), &values, &base_of(prepared, linear), 0..own.total()),
        candidates,
        residual,
        rows: Arc::new(rows),
    })
}

/// For each base parameter: the precision of its prior, and its value minus the mean of the prior.
fn base_of(prepared: &Prepared<'_>, linear: &Linear) -> [(f64, f64); BASE] {
    held::precisions(prepared.held, &linear.model.parameters())
}

/// The columns of a model. `places` are the indices of these columns in the Gram matrices. `values` are the parameters
/// of the model's effects. `base` contains, for each base parameter, the precision of its prior and its value minus the
/// mean of the prior.
fn columns_of(
    (own, precisions): (&Terms<'_>, &[f64]),
    values: &[f64],
    base: &[(f64, f64); BASE],
    places: impl Iterator<Item = usize>,
) -> Vec<Column> {
    let column = |(p, place): (usize, usize)| {
        let effect = p.checked_sub(BASE).filter(|p| *p < own.count);
        let of_effect = effect.map(|effect| (precisions[effect], values[effect]));
        let (precision, value) = of_effect.or_else(|| base.get(p).copied()).unwrap_or((0.0, 0.0));
        Column { place, precision, value }
    };
    places.enumerate().map(column).collect()
}

/// For each end of a move and each rest: the body axis from which two directions perpendicular to gravity are
/// constructed. The two tilt residuals are the components along these directions. The residual rows of two models can
/// be compared only if these axes are equal.
pub(super) fn axes_of(linear: &Linear) -> Vec<usize> {
    let ends = linear.moves.iter().flat_map(|at_move| [&at_move.before.up, &at_move.after.up]);
    ends.chain(linear.directions().map(|(_, up)| up)).map(axis_aside).collect()
}

impl Design {
    /// The candidates in the form with the most parameters: one for each effect and each of its trial time constants.
    /// The columns of a smaller form are part of the columns of this form.
    pub(crate) fn full_forms(&self) -> impl Iterator<Item = &Candidate> {
        let is_part = |own: &Range<usize>, other: &Range<usize>| own.start == other.start && own.end < other.end;
        let is_full =
            move |own: &&Candidate| !self.candidates.iter().any(|other| is_part(&own.columns, &other.columns));
        self.candidates.iter().filter(is_full)
    }

    /// This design with some candidates moved into the model, and with the residuals of the new model. `None` if this
    /// design has no candidate for an effect of the new model, or if the residuals of the two models cannot be compared
    /// row by row (see [`axes_of`]). The Jacobian of the old model is reused. Its relative error is about the size of
    /// the effects relative to the signals, typically at most 1 %. The new residuals are computed exactly at the fitted
    /// parameters of the new model.
    pub(crate) fn joined(
        &self,
        prepared: &Prepared<'_>,
        (own, precisions): (&Terms<'_>, &[f64]),
        linear: &Arc<Linear>,
    ) -> Result<Option<Self>, Error> {
        let of_term = |term: &Term<'_>| {
            let same = |c: &&Candidate| c.name == term.name() && c.shape.is_none() && c.columns.len() == term.count();
            self.candidates.iter().find(same).map(|candidate| candidate.columns.clone())
        };
        let Some(joining) = own.all.iter().map(of_term).collect::<Option<Vec<_>>>() else { return Ok(None) };
        if axes_of(linear) != self.rows.axes {
            return Ok(None);
        }
        let (residual, _) = Joint::of_noise(prepared, own, Arc::clone(linear))?.whiten(linear);
        // The residuals of the priors are dropped, because in a design each column stores the precision of its prior
        // instead.
        let residual = residual.col_as_slice(0)[..self.rows.groups.len()].to_vec();
        let places = (0..BASE).chain(joining.into_iter().flatten()).chain(BASE..self.model.len());
        let is_left = |candidate: &&Candidate| !own.all.iter().any(|term| term.name() == candidate.name);
        Ok(Some(Self {
            gram: self.whole_gram(&residual),
            model: columns_of((own, precisions), &linear.model.values, &base_of(prepared, linear), places),
            candidates: self.candidates.iter().filter(is_left).cloned().collect(),
            residual,
            rows: Arc::clone(&self.rows),
        }))
    }

    /// Gram matrices of all columns, with the given vector as the residual.
    fn whole_gram(&self, residual: &[f64]) -> Gram {
        let Rows { products, groups, .. } = &*self.rows;
        self.gram.with_residual(products, self.rows.columns(), residual, groups)
    }

    /// This design without the candidates whose names satisfy `is_out`.
    pub(crate) fn without(&self, is_out: impl Fn(&str) -> bool) -> Self {
        let mut left = self.clone();
        left.candidates.retain(|candidate| !is_out(&candidate.name));
        left
    }

    /// Gram matrices of the groups of residuals. The specific-force residuals inside moves are divided into one group
    /// for each recording. The second result contains the indices of these groups.
    pub(crate) fn insides_apart(&self, prepared: &Prepared<'_>) -> (Cow<'_, Gram>, Range<usize>) {
        if prepared.recordings.len() == 1 {
            let gram = match self.candidates.is_empty() {
                true => Cow::Borrowed(&self.gram),
                false => Cow::Owned(self.whole_gram(&self.residual)),
            };
            return (gram, INSIDE..INSIDE + 1);
        }
        let Rows { groups, items, .. } = &*self.rows;
        let columns = self.rows.columns();
        let first = EPOCH_RATES + 1;
        let apart = |(&group, &item): (&usize, &usize)| {
            if group == INSIDE { first + prepared.rests[item / 2].recording } else { group }
        };
        let groups: Vec<usize> = groups.iter().zip(items).map(apart).collect();
        let (rows, last) = (columns.nrows(), columns.ncols());
        let all = Mat::from_fn(rows, last + 1, |i, j| if j < last { columns[(i, j)] } else { self.residual[i] });
        (Cow::Owned(Gram::of(&all, &groups)), first..first + prepared.recordings.len())
    }

    /// Residuals and Jacobian columns for a cross-validation in which each fold holds out some rests and moves.
    pub(crate) fn held(&self) -> Held<'_> {
        let Rows { groups, items, has_variations, .. } = &*self.rows;
        Held {
            columns: self.rows.columns(),
            residual: &self.residual,
            gram: &self.gram,
            groups,
            items,
            has_variations: *has_variations,
        }
    }

    /// The columns and Gram matrices of this design, prepared for the addition of columns of generic hypotheses.
    pub(crate) fn known(&self) -> Known<'_> {
        Known::new(self.rows.columns(), &self.residual, &self.rows.groups, &self.gram)
    }

    /// This design with additional columns in the model. `precisions` are the precisions of the priors of these
    /// columns.
    pub(crate) fn with_columns(&self, more: &Mat<f64>, precisions: &[f64]) -> Self {
        let Rows { groups, items, axes, .. } = &*self.rows;
        let known = self.known();
        let (columns, first) = (self.rows.columns(), self.gram.residual);
        // The new columns may have additional rows for the priors of parameters. The design has no such rows, so these
        // rows are dropped.
        let more = &more.subrows(0, columns.nrows()).to_owned();
        let gram = known.with(&known.others(more));
        let mut all = Mat::zeros(columns.nrows(), first + more.ncols());
        all.subcols_mut(0, first).copy_from(columns);
        all.subcols_mut(first, more.ncols()).copy_from(more);
        let added =
            precisions.iter().enumerate().map(|(k, &precision)| Column { place: first + k, precision, value: 0.0 });
        let model = self.model.iter().copied().chain(added).collect();
        let rows = Rows {
            made: None,
            columns: OnceLock::from(all),
            products: OnceLock::new(),
            groups: groups.clone(),
            items: items.clone(),
            axes: axes.clone(),
            has_variations: true,
        };
        Self { gram, model, candidates: self.candidates.clone(), residual: self.residual.clone(), rows: Arc::new(rows) }
    }

    /// For each end of a move and each rest: the body axis that defines the directions of the two tilt residuals, see
    /// [`axes_of`].
    pub(crate) fn axes(&self) -> &[usize] {
        &self.rows.axes
    }
}

/// Index, in order of time, of the rest or move to which each whitened residual belongs. Rests have even indices and
/// moves have odd indices.
fn items_of_rows(prepared: &Prepared<'_>, linear: &Linear, kinds: Kinds) -> Vec<usize> {
    let of_move = |k: usize| 2 * prepared.moves[k].from + 1;
    let lines = linear.lines.iter().map(|line| match line.source {
        Source::Norm(k) => 2 * k,
        Source::Move(k) => of_move(k),
    });
    let rates = linear.rates.iter().flat_map(|(k, _)| [2 * k; 3]);
    let in_moves = |seen: bool, ends: usize| {
        let moves = linear.moves.iter().enumerate().filter(move |_| seen);
        moves.flat_map(move |(k, m)| std::iter::repeat_n(of_move(k), 3 * m.pass.blocks.len() + ends))
    };
    let stand_rests = linear.directions().filter(|_| kinds.encoders).flat_map(|(k, _)| [2 * k; 2]);
    let inside = in_moves(kinds.in_motion, if kinds.encoders { 0 } else { 2 });
    let stand_moves = in_moves(kinds.encoders, 0);
    lines.chain(rates).chain(inside).chain(stand_rests).chain(stand_moves).collect()
}
