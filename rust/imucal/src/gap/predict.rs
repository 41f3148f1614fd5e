//! Cross-validation: tests whether an effect improves the prediction of held-out rests and moves.
//!
//! ```text
//! delta_f = -(P + sum J^T J / s_g^2)^-1 (P theta_0 + sum J^T r / s_g^2),     sums over the rows that are not in fold f
//! l_i = -1/2 sum [(r + J delta_f)^2 / v + ln v],     v = s_g^2 + u,     sum over the rows of item i,   f: fold of i
//! gain = sum_i d_i,   std^2 = n var(d_i),   d_i = (l_i with the effect) - (l_i without the effect)
//! ```
//!
//! r are the residuals and J is their Jacobian at the parameters theta_0. An item is a rest or a move, and a fold is a
//! contiguous period of time. delta_f is the change of the parameters that is estimated without fold f. s_g^2 is the
//! noise scale of the group g of a row, and P contains the precisions of the priors. l_i is the log predictive density
//! of item i, and n is the number of items. u is 0, or the variance of the prediction J delta_f if the model contains
//! generic hypotheses. This variance is needed because, for example, the rows outside a fold do not determine how a
//! random walk continues within the fold. With u = 0, the error of the predicted walk would hide all other differences
//! between two models.
//!
//! If residuals exceed sensor noise, p-values computed from sensor noise are too small. Cross-validation remains valid
//! in this case, because an effect that only fits excess scatter does not improve the prediction. Each superfluous
//! parameter decreases the log predictive density by about half a nat. The standard deviation of the gain is estimated
//! from the gains of the individual items (Vuong, Econometrica 57, 1989, 307-333). A few outliers increase this
//! standard deviation as well, and therefore cannot make an effect significant. A fold is a period and not a single
//! rest, because biases vary slowly. Any model would predict a single rest well from the rests before and after it.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::evidence::{Column, Gram, RIDGE};

/// Number of cross-validation folds. Each fold is a contiguous period of the recordings.
const FOLDS: usize = 6;
/// A gain is significant if it is larger than this multiple of its standard deviation.
const SURE: f64 = 2.0;

/// Increase of the log predictive density due to an effect, and the standard deviation of this increase, nats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gain {
    pub(crate) nats: f64,
    pub(crate) std: f64,
}

impl Gain {
    /// Increase of the log predictive density from the model `without` an effect to the model `with` it. Each list
    /// contains one log density for each rest and move.
    pub(crate) fn of(without: &[Option<f64>], with: &[Option<f64>]) -> Self {
        let gains: Vec<f64> =
            with.iter().zip(without).filter_map(|(with, without)| Some((*with)? - (*without)?)).collect();
        let n = gains.len() as f64;
        let nats: f64 = gains.iter().sum();
        let variance = gains.iter().map(|d| (d - nats / n).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        Self { nats, std: (n * variance).sqrt() }
    }

    pub(crate) fn is_sure(&self) -> bool {
        self.nats > SURE * self.std
    }
}

/// Residuals and Jacobian for a cross-validation, which divides their rows into folds.
pub(crate) struct Held<'a> {
    /// Jacobian of a design (a linearised model), one column for each parameter, without the residual.
    pub(crate) columns: &'a Mat<f64>,
    pub(crate) residual: &'a [f64],
    pub(crate) gram: &'a Gram,
    /// Group (kind) of the residual in each row, as an index.
    pub(crate) groups: &'a [usize],
    /// Index of the rest or move to which the residual of each row belongs. Rests and moves are numbered together in
    /// order of time.
    pub(crate) items: &'a [usize],
    /// Whether the models contain columns of generic hypotheses (unknown variations of a bias or scale).
    pub(crate) has_variations: bool,
}

impl Held<'_> {
    /// Increase of the log predictive density from the model `without` to the model `with`. Each model is given by its
    /// columns and its noise scales. `None` if the rows outside a fold do not determine the parameters of one of the
    /// models.
    pub(crate) fn gain(&self, without: (&[Column], &[f64]), with: (&[Column], &[f64])) -> Option<Gain> {
        Some(Gain::of(&self.log_densities(without)?, &self.log_densities(with)?))
    }

    /// Log predictive density of the residuals of each rest and move, for a model with these columns and noise scales.
    /// It is computed with a fit to the folds that do not contain the rest or move.
    pub(crate) fn log_densities(&self, (columns, scales): (&[Column], &[f64])) -> Option<Vec<Option<f64>>> {
        let n = columns.len();
        let scale_of = |group: usize| {
            let place = self.gram.groups.iter().position(|g| *g == group).unwrap_or(0);
            scales[place]
        };
        let scale: Vec<f64> = self.groups.iter().map(|group| scale_of(*group)).collect();
        let weight: Vec<f64> = scale.iter().map(|scale| 1.0 / scale.sqrt()).collect();
        let place = |c: usize| columns.get(c).map_or(self.gram.residual, |column| column.place);
        let mut all = self.gram.at_scales(scales, place, n + 1, 0..n + 1);
        // `all` is the sum of the Gram matrices of all groups, each divided by the noise scale of its group. The last
        // row and column belong to the residual. Each row and column of a parameter is now divided by the length of its
        // Jacobian column or, if it is larger, by the square root of its prior precision.
        let length = |c: usize| columns.get(c).map_or(1.0, |own| all[(c, c)].max(own.precision).sqrt().max(1e-300));
        let size: Vec<f64> = (0..=n).map(length).collect();
        for (j, of_column) in size.iter().enumerate() {
            all.col_as_slice_mut(j).iter_mut().zip(&size).for_each(|(sum, of_row)| *sum /= of_row * of_column);
        }
        let items = self.items.iter().max().map_or(0, |last| last + 1);
        let rows_of = |fold: usize| -> Vec<usize> {
            (0..scale.len()).filter(|&row| self.items[row] * FOLDS / items == fold).collect()
        };
        let part = |rows: &[usize]| {
            let mut part = Mat::zeros(rows.len(), n + 1);
            for c in 0..=n {
                let from = columns.get(c).map_or(self.residual, |column| self.columns.col_as_slice(column.place));
                let to = part.col_as_slice_mut(c).iter_mut().zip(rows);
                to.for_each(|(to, &row)| *to = from[row] * weight[row] / size[c]);
            }
            part
        };
        let precision: Vec<f64> = (0..n).map(|c| columns[c].precision / (size[c] * size[c])).collect();
        let mut densities = vec![None; items];
        for fold in 0..FOLDS {
            let rows = rows_of(fold);
            if rows.is_empty() {
                continue;
            }
            let own = part(&rows);
            let seen = &all - own.transpose() * &own;
            let normal = Mat::from_fn(n, n, |i, j| seen[(i, j)] + if i == j { precision[i] + RIDGE } else { 0.0 });
            let right = Mat::from_fn(n, 1, |i, _| -(seen[(i, n)] + precision[i] * columns[i].value * size[i]));
            let factor = normal.llt(faer::Side::Lower).ok()?;
            let jacobian = own.subcols(0, n);
            let left = jacobian * factor.solve(&right) + own.subcols(n, 1);
            // Inverse normal matrix x (Jacobian of the held-out rows)^T. The variance of the predictions, in units of
            // the noise scales, is computed from this product.
            let uncertain = self.has_variations.then(|| factor.solve(jacobian.transpose()));
            for (k, (left, &row)) in left.col_as_slice(0).iter().zip(&rows).enumerate() {
                let of_row = |solved: &Mat<f64>| (0..n).map(|j| jacobian[(k, j)] * solved[(j, k)]).sum::<f64>();
                let variance = 1.0 + uncertain.as_ref().map_or(0.0, of_row);
                let density = left * left / variance + (scale[row] * variance).ln();
                *densities[self.items[row]].get_or_insert(0.0) -= 0.5 * density;
            }
        }
        Some(densities)
    }
}

#[cfg(test)]
mod tests {
    use std::iter::once;

    use super::*;

    const ROWS: usize = 60;

    /// Simulates residuals (noise plus `size` times a sine), and returns the gain of a model with the sine and a
    /// constant relative to a model with only the constant. In one row, `spike` is added to the sine and 3 x `spike` to
    /// the residual.
    fn gain_of(size: f64, spike: f64) -> Gain {
        let noise = |i: usize| ((i * 7919 + 13) % 97) as f64 / 97.0 * 3.4 - 1.7;
        let columns = Mat::from_fn(ROWS, 3, |i, j| match j {
            0 => 1.0,
            1 => (i as f64 * 0.3).sin() + if i == 5 { spike } else { 0.0 },
            _ => noise(i) + size * (i as f64 * 0.3).sin() + if i == 5 { 3.0 * spike } else { 0.0 },
        });
        let (groups, items) = (vec![0; ROWS], (0..ROWS).collect::<Vec<usize>>());
        let gram = Gram::of(&columns, &groups);
        let base = [Column { place: 0, precision: 0.0, value: 0.0 }];
        let more = [base[0], Column { place: 1, precision: 1e-4, value: 0.0 }];
        let scales = |model: &[Column]| gram.evidence(model).unwrap().scales;
        let residual = columns.col_as_slice(2);
        let held =
            Held { columns: &columns, residual, gram: &gram, groups: &groups, items: &items, has_variations: false };
        held.gain((&base, &scales(&base)), (&more, &scales(&more))).unwrap()
    }

    #[test]
    fn what_is_there_predicts_and_what_is_not_costs_half_a_nat_or_so() {
        let there = gain_of(2.0, 0.0);
        // Without the sine in the model, the noise scale is about 3: the noise variance 1 plus the mean square 2 of a
        // sine with the amplitude 2. With the sine, the noise scale is 1. Each of the 60 rows therefore gains about 1/2
        // ln 3 nats, together 33 nats.
        assert!(there.is_sure() && (30.0..90.0).contains(&there.nats), "{there:?}");
        let absent = gain_of(0.0, 0.0);
        assert!(!absent.is_sure() && (-2.0..1.0).contains(&absent.nats), "{absent:?}");
    }

    /// Simulates residuals with an effect of size `size` and a slowly oscillating bias, and returns the gain of the
    /// effect. The models with and without the effect both contain a constant and a random walk.
    fn gain_beside_a_swing(size: f64, has_variations: bool) -> Gain {
        const STEPS: usize = ROWS - 1;
        let noise = |i: usize| ((i * 7919 + 13) % 97) as f64 / 97.0 * 3.4 - 1.7;
        let effect = |i: usize| ((i * 37) % 11) as f64 / 5.0 - 1.0;
        let columns = Mat::from_fn(ROWS, STEPS + 3, |i, j| match j {
            0 => 1.0,
            1 => effect(i),
            j if j < STEPS + 2 => f64::from(u8::from(i > j - 2)),
            _ => noise(i) + size * effect(i) + 10.0 * (i as f64 / 8.0).sin(),
        });
        let (groups, items) = (vec![0; ROWS], (0..ROWS).collect::<Vec<usize>>());
        let gram = Gram::of(&columns, &groups);
        let walk = (2..STEPS + 2).map(|place| Column { place, precision: 1.0 / 9.0, value: 0.0 });
        let base: Vec<Column> = once(Column { place: 0, precision: 0.0, value: 0.0 }).chain(walk).collect();
        let mut more = base.clone();
        more.push(Column { place: 1, precision: 1e-4, value: 0.0 });
        let scales = |model: &[Column]| gram.evidence(model).unwrap().scales;
        let residual = columns.col_as_slice(STEPS + 2);
        let held = Held { columns: &columns, residual, gram: &gram, groups: &groups, items: &items, has_variations };
        held.gain((&base, &scales(&base)), (&more, &scales(&more))).unwrap()
    }

    #[test]
    fn the_unknown_course_of_a_variation_does_not_hide_an_effect() {
        let (plain, there) = (gain_beside_a_swing(4.0, false), gain_beside_a_swing(4.0, true));
        assert!(!plain.is_sure() && there.is_sure(), "{plain:?} {there:?}");
        let absent = gain_beside_a_swing(0.0, true);
        assert!(!absent.is_sure(), "{absent:?}");
    }

    #[test]
    fn one_bad_item_cannot_carry_an_effect() {
        let carried = gain_of(0.0, 3.0);
        assert!(!carried.is_sure(), "{carried:?}");
    }
}
