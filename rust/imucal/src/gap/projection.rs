//! Columns beside a model at scales that are held: the model's part is factored once for all of them.
//!
//! ```text
//! S = D - C^T N^-1 C,   z = r_own - C^T N^-1 r      in typical sizes, all sums over s_g^2
//! log E(s) - log E = 1/2 (z^T (S + I/s^2)^-1 z - ln det(I + s^2 S))      for a prior N(0, (s typical_p)^2)
//! ```
//!
//! With the scales that the evidence itself settles at this is its gain; with others it tells which widths are worth asking it for.

use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Par};
use std::ops::Range;

use super::evidence::{Column, Gram, RIDGE};

/// A model at given scales.
pub(crate) struct Projection<'a> {
    model: &'a [Column],
    scales: &'a [f64],
    /// Of its columns, which are divided by these sizes.
    factor: Llt<f64>,
    size: Vec<f64>,
    /// `L^-1` times what the residuals say of it.
    right: Mat<f64>,
}

/// What a model leaves of columns beside it, in typical sizes.
pub(crate) struct Left {
    normal: Mat<f64>,
    gradient: Mat<f64>,
    /// Trace of what they are without the model.
    whole: f64,
}

impl<'a> Projection<'a> {
    /// `None` where the model is not determined.
    pub(crate) fn new(gram: &Gram, model: &'a [Column], scales: &'a [f64]) -> Option<Self> {
        let n = model.len();
        let all = gram.at_scales(scales, |i| if i < n { model[i].place } else { gram.residual }, n + 1, 0..n);
        let size: Vec<f64> = (0..n).map(|i| all[(i, i)].max(model[i].precision).sqrt().max(1e-300)).collect();
        let precision = |i: usize| model[i].precision / (size[i] * size[i]) + RIDGE;
        let normal =
            Mat::from_fn(n, n, |i, j| all[(i, j)] / (size[i] * size[j]) + if i == j { precision(i) } else { 0.0 });
        let factor = normal.llt(faer::Side::Lower).ok()?;
        let right = |i: usize| (all[(n, i)] + model[i].precision * model[i].value) / size[i];
        let mut right = Mat::from_fn(n, 1, |i, _| right(i));
        solve_lower(&factor, &mut right);
        Some(Self { model, scales, factor, size, right })
    }

    /// What is left of these columns of `gram`, which has the model's columns where they were.
    pub(crate) fn left(&self, gram: &Gram, columns: &Range<usize>, typical: impl Fn(usize) -> f64) -> Left {
        let (n, k) = (self.model.len(), columns.len());
        let place = |i: usize| match i.checked_sub(n) {
            None => self.model[i].place,
            Some(own) if own < k => columns.start + own,
            Some(_) => gram.residual,
        };
        let all = gram.at_scales(self.scales, place, n + k + 1, n..n + k);
        let mut cross = Mat::from_fn(n, k, |i, c| all[(i, c)] / self.size[i] * typical(c));
        solve_lower(&self.factor, &mut cross);
        let own = |a: usize, b: usize| all[(n + a, b)] * typical(a) * typical(b);
        let taken = cross.transpose() * &cross;
        let given = cross.transpose() * &self.right;
        Left {
            normal: Mat::from_fn(k, k, |a, b| own(a, b) - taken[(a, b)]),
            gradient: Mat::from_fn(k, 1, |a, _| all[(n + k, a)] * typical(a) - given[(a, 0)]),
            whole: (0..k).map(|a| own(a, a)).sum(),
        }
    }
}

impl Left {
    /// Logarithm of the evidence that these columns add with a prior of so many typical sizes; `None` where it cannot be computed.
    pub(crate) fn gain(&self, width: f64) -> Option<f64> {
        let k = self.normal.ncols();
        let precision = 1.0 / (width * width);
        let with = Mat::from_fn(k, k, |a, b| self.normal[(a, b)] + if a == b { precision } else { 0.0 });
        let factor = with.llt(faer::Side::Lower).ok()?;
        let solved = factor.solve(&self.gradient);
        let explained: f64 = (0..k).map(|a| self.gradient[(a, 0)] * solved[(a, 0)]).sum();
        let volume: f64 = (0..k).map(|a| 2.0 * (factor.L()[(a, a)] * width).ln()).sum();
        Some(0.5 * (explained - volume))
    }

    /// The width with the largest gain, and the gain.
    pub(crate) fn best_width(&self, widths: &[f64]) -> Option<(f64, f64)> {
        let gains = widths.iter().filter_map(|&width| Some((width, self.gain(width)?)));
        gains.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// What each direction of the parameters moves chi2 by; what is below the rounding of what was subtracted is nothing.
    pub(crate) fn spectrum(&self) -> Vec<f64> {
        let k = self.normal.ncols();
        let Ok(eigen) = self.normal.self_adjoint_eigen(faer::Side::Lower) else { return Vec::new() };
        let rounding = 1e-9 * self.whole;
        (0..k).map(|a| eigen.S()[a]).map(|value| if value > rounding { value } else { 0.0 }).collect()
    }

    /// The sum of these.
    pub(crate) fn trace(&self) -> f64 {
        (0..self.normal.ncols()).map(|a| self.normal[(a, a)].max(0.0)).sum()
    }
}

fn solve_lower(factor: &Llt<f64>, right: &mut Mat<f64>) {
    faer::linalg::triangular_solve::solve_lower_triangular_in_place(factor.L(), right.as_mut(), Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With scales of one the gain is the difference of two evidences, whatever the width.
    #[test]
    fn the_gain_is_that_of_the_evidence() {
        let rows = 60;
        let noise = |i: usize| ((i * 7919 + 13) % 97) as f64 / 97.0 * 2.8 - 1.4;
        let columns = Mat::from_fn(rows, 4, |i, j| match j {
            0 => 1.0,
            1 => (i as f64 * 0.3).sin() + 0.5,
            2 => (i as f64 * 0.11).cos() + 0.1 * noise(i + 7),
            _ => noise(i) + 0.4 * (i as f64 * 0.3).sin(),
        });
        let gram = Gram::new(&columns, &vec![0; rows]);
        let model = [Column { place: 0, precision: 0.0, value: 0.0 }, Column { place: 1, precision: 4.0, value: 0.3 }];
        let plain = gram.evidence(&model).unwrap();
        assert_eq!(plain.scales, vec![1.0]);
        let projection = Projection::new(&gram, &model, &plain.scales).unwrap();
        let left = projection.left(&gram, &(2..3), |_| 0.2);
        for width in [0.1, 1.0, 10.0] {
            let precision = 1.0 / (width * 0.2f64).powi(2);
            let with = [model[0], model[1], Column { place: 2, precision, value: 0.0 }];
            let gain = gram.evidence(&with).unwrap().log - plain.log;
            assert!((left.gain(width).unwrap() - gain).abs() < 1e-9, "{width}: {gain}");
        }
    }
}
