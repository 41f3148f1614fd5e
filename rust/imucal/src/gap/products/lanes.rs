//! Computes, with SIMD instructions, the Gram matrices of a Jacobian that is stored row by row.

use std::iter::once;
use std::ops::Range;

use faer::Mat;
use pulp::{Simd, WithSimd};

use super::asked::Asked;
use super::{Rows, in_parts};
use crate::joint::{Insides, Lanes};
use crate::numerics::instructions::Instructions;
use crate::numerics::workers::{in_order, processors};

/// Number of moves in each partial sum of a Gram matrix. It is fixed, so that rounding errors do not depend on the
/// number of threads.
const MOVES: usize = 8;
/// Number of model columns in one [`Job`] (a part of a Gram matrix). In each row, a job multiplies the values of these
/// columns by the values in one SIMD register. The 21 columns of the base parameters (sensitivities and biases) fill
/// three jobs of seven columns.
const OF_MODEL: usize = 7;
/// Maximum number of columns other than model columns (candidate columns and the residual) in one [`Job`].
const OF_OTHERS: usize = 4;
/// Number of rows that are processed together. The values of these rows fit into the first-level cache of the
/// processor.
const NEAR: usize = 32;

/// Gram matrices with the products that `asked` selects, one for each group of rows. `order` contains the position of
/// each column within a row.
pub(super) fn of_groups(lanes: &Lanes, groups: &[Rows], order: &[usize], asked: &Asked<'_>) -> Vec<Mat<f64>> {
    let plan = Plan::new(lanes, order, asked);
    let of_group = |group: &Rows| {
        let rows: Vec<usize> = group.runs.iter().flat_map(Range::clone).collect();
        let of_part = |part: Range<usize>| {
            let mut sums = plan.nothing_yet();
            rows[part].chunks(NEAR).for_each(|rows| plan.add(rows.iter().map(|row| lanes.row(*row)), &mut sums));
            sums
        };
        let mut sum = asked.nothing_yet();
        in_parts(processors(), rows.len(), of_part).iter().for_each(|sums| plan.take(sums, &mut sum));
        asked.mirror(&mut sum);
        sum
    };
    groups.iter().map(of_group).collect()
}

/// Gram matrix with the products that `asked` selects, summed over all rows inside moves, and the residuals of these
/// rows.
pub(super) fn of_insides(insides: &Insides, order: &[usize], asked: &Asked<'_>) -> (Mat<f64>, Vec<f64>) {
    let (mut sum, mut residual) = (asked.nothing_yet(), Vec::with_capacity(insides.rows()));
    let none = insides.no_rows();
    let plan = Plan::new(none, order, asked);
    let of_part = |part: usize| {
        let (mut lanes, mut sums, mut residual) = (none.clone(), plan.nothing_yet(), Vec::new());
        for k in part * MOVES..insides.moves().min((part + 1) * MOVES) {
            insides.look(k, &mut lanes);
            residual.extend(lanes.column(order[asked.last]));
            let near = lanes.numbers().chunks(NEAR * lanes.width());
            near.for_each(|numbers| plan.add(numbers.chunks_exact(lanes.width()), &mut sums));
        }
        (sums, residual)
    };
    for (sums, of_part) in in_order(processors(), insides.moves().div_ceil(MOVES), of_part) {
        plan.take(&sums, &mut sum);
        residual.extend(of_part);
    }
    asked.mirror(&mut sum);
    (sum, residual)
}

/// A job computes part of a Gram matrix: the products of some columns with a few neighbouring columns, whose values fit
/// into one SIMD register. In each row, the value of each column is multiplied by all values of the register. The
/// products are summed over the rows.
struct Job {
    columns: Vec<usize>,
    /// Position of each column within a row. If there are fewer than [`OF_MODEL`] columns, the last position is
    /// repeated.
    places: [usize; OF_MODEL],
    /// In each row, the register contains the values from position `first` on. Only products with the columns in the
    /// range `with` are added to the Gram matrix.
    first: usize,
    with: Range<usize>,
}

/// All jobs of a Gram matrix.
struct Plan {
    /// Index of the column at each position of a row; `None` for padding.
    columns: Vec<Option<usize>>,
    of_model: Vec<Job>,
    of_others: Vec<Job>,
    /// Number of values in a SIMD register.
    register: usize,
}

impl Plan {
    /// Plans three sets of products: model column x any column, column x column within each block of candidate columns,
    /// and residual x (candidate column or residual).
    fn new(lanes: &Lanes, order: &[usize], asked: &Asked<'_>) -> Self {
        let register = Instructions::Best.run(Register);
        let places: Vec<Option<usize>> = order.iter().map(|column| lanes.place(*column)).collect();
        let mut columns = vec![None; lanes.width()];
        let seen = places.iter().enumerate().filter_map(|(column, place)| Some((column, (*place)?)));
        seen.for_each(|(column, place)| columns[place] = Some(column));
        let is_seen = |column: &usize| places[*column].is_some();
        let job = |own: &[usize], first: usize, with: Range<usize>| {
            let place = |k: usize| places[own[k.min(own.len() - 1)]].unwrap_or(0);
            Job { columns: own.to_vec(), places: std::array::from_fn(place), first, with }
        };
        let (mut of_model, mut of_others) = (Vec::new(), Vec::new());
        let model: Vec<usize> = (0..asked.model).filter(is_seen).collect();
        for own in model.chunks(OF_MODEL) {
            let firsts = (0..columns.len() / register).map(|k| k * register);
            let firsts = firsts.filter(|first| columns[*first..first + register].iter().any(Option::is_some));
            of_model.extend(firsts.map(|first| job(own, first, 0..asked.last + 1)));
        }
        for block in asked.blocks.iter().cloned().chain(once(asked.last..asked.last + 1)) {
            let own: Vec<usize> = block.clone().filter(is_seen).collect();
            let ends = own.first().zip(own.last()).and_then(|(first, last)| places[*first].zip(places[*last]));
            let Some((first, last)) = ends else { continue };
            let residual = Some(asked.last).filter(|last| !block.contains(last));
            let with_residual: Vec<usize> = own.iter().copied().chain(residual).collect();
            for own in with_residual.chunks(OF_OTHERS) {
                let firsts = (first..=last).step_by(register);
                of_others.extend(firsts.map(|first| job(own, first, block.clone())));
            }
        }
        Self { columns, of_model, of_others, register }
    }

    /// Initial sums of all jobs: zeros. Each column of a job needs as many sums as a SIMD register has numbers.
    fn nothing_yet(&self) -> Vec<f64> {
        vec![0.0; (self.of_model.len() * OF_MODEL + self.of_others.len() * OF_OTHERS) * self.register]
    }

    /// Adds the products in the given rows to the sums of all jobs.
    fn add<'r>(&self, rows: impl Iterator<Item = &'r [f64]> + Clone, sums: &mut [f64]) {
        Instructions::Best.run(Add { plan: self, rows, sums });
    }

    /// Adds the sums of the jobs to the requested entries of the Gram matrix `to`.
    fn take(&self, sums: &[f64], to: &mut Mat<f64>) {
        let (of_model, of_others) = sums.split_at(self.of_model.len() * OF_MODEL * self.register);
        let of_model = self.of_model.iter().zip(of_model.chunks_exact(OF_MODEL * self.register));
        let of_others = self.of_others.iter().zip(of_others.chunks_exact(OF_OTHERS * self.register));
        for (Job { columns, first, with, .. }, sums) in of_model.chain(of_others) {
            let others = &self.columns[*first..first + self.register];
            for (i, sums) in columns.iter().zip(sums.chunks_exact(self.register)) {
                let others = others.iter().zip(sums).filter_map(|(j, sum)| Some(((*j)?, sum)));
                others.filter(|(j, _)| with.contains(j)).for_each(|(j, sum)| to[(j, *i)] += sum);
            }
        }
    }
}

struct Register;

impl WithSimd for Register {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F64_LANES
    }
}

struct Add<'a, R> {
    plan: &'a Plan,
    rows: R,
    sums: &'a mut [f64],
}

impl<'r, R: Iterator<Item = &'r [f64]> + Clone> WithSimd for Add<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { plan, rows, sums } = self;
        let (sums, _) = S::as_mut_simd_f64s(sums);
        let (of_model, of_others) = sums.split_at_mut(plan.of_model.len() * OF_MODEL);
        for (job, sums) in plan.of_model.iter().zip(of_model.chunks_exact_mut(OF_MODEL)) {
            add::<S, OF_MODEL>(simd, rows.clone(), job, sums);
        }
        for (job, sums) in plan.of_others.iter().zip(of_others.chunks_exact_mut(OF_OTHERS)) {
            add::<S, OF_OTHERS>(simd, rows.clone(), job, sums);
        }
    }
}

/// For each row, multiplies the first `N` columns of a job by the values in the job's register, and adds the products
/// to `sums`.
#[inline(always)]
fn add<'r, S: Simd, const N: usize>(simd: S, rows: impl Iterator<Item = &'r [f64]>, job: &Job, sums: &mut [S::f64s]) {
    let (places, first) = (&job.places, job.first);
    let mut own = [simd.splat_f64s(0.0); N];
    for row in rows {
        let register = S::as_simd_f64s(&row[first..first + S::F64_LANES]).0[0];
        for k in 0..N {
            own[k] = simd.mul_add_e_f64s(simd.splat_f64s(row[places[k]]), register, own[k]);
        }
    }
    for (sum, own) in sums.iter_mut().zip(own) {
        *sum = simd.add_f64s(*sum, own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::evidence::Gram;

    #[test]
    fn what_stands_side_by_side_has_the_products_of_columns() {
        // In this example, the columns of the model are not contiguous, the columns of the third block are zero and
        // therefore not stored, and the columns are permuted.
        let (rows, model, blocks) = (420, 6, [6..7, 7..12, 12..14, 14..17]);
        let places: Vec<Option<usize>> =
            (0..18).map(|j| if (12..14).contains(&j) { None } else { Some(if j < 3 { j } else { j + 10 }) }).collect();
        let order: Vec<usize> = [3, 4, 5, 0, 1, 2].into_iter().chain(6..18).collect();
        let number = |i: usize, column: usize| ((1 + i) as f64 * (0.3 + 0.17 * column as f64)).sin();
        let lanes = Lanes::of(&places, rows, number);
        let columns = Mat::from_fn(rows, 18, |i, j| places[order[j]].map_or(0.0, |_| number(i, order[j])));
        let all = &Gram::of(&columns, &vec![0; rows]).sums[0];
        let asked = Asked::new(model, 17, &blocks);
        let plan = Plan::new(&lanes, &order, &asked);
        let (mut sums, mut some) = (plan.nothing_yet(), asked.nothing_yet());
        plan.add(lanes.numbers().chunks_exact(lanes.width()), &mut sums);
        plan.take(&sums, &mut some);
        asked.mirror(&mut some);
        let block = |j: usize| blocks.iter().position(|block| block.contains(&j));
        for (i, j) in (0..18).flat_map(|i| (0..18).map(move |j| (i, j))) {
            let is_there = i.min(j) < model || i.max(j) == 17 || block(i) == block(j);
            let difference = (all[(i, j)] - some[(i, j)]).abs();
            assert!(if is_there { difference < 1e-10 } else { difference.is_nan() }, "{i} {j}: {difference}");
        }
    }
}
