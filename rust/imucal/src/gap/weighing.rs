//! A model and columns beside it, weighed with several widths of their prior.
//!
//! At scales that are held the model is swept out of the sums first, and what it leaves of the columns tells the gain of every width:
//!
//! ```text
//! S = D - C^T N^-1 C,   z = r_own - C^T N^-1 r      in typical sizes, all sums over s_g^2
//! log E(s) - log E = 1/2 (z^T (S + I/s^2)^-1 z - ln det(I + s^2 S))      for a prior N(0, (s typical_p)^2)
//! ```
//!
//! With the scales that the evidence itself settles at this is its gain; with others it tells which widths are worth asking it for.

use std::ops::Range;

use faer::Mat;
use pulp::{Arch, Simd, WithSimd};

use super::evidence::{Column, Evidence, Gram, RIDGE};
use super::upper::Upper;

/// Scales and parameters depend on each other; the last round is taken as it is.
const SCALE_ROUNDS: usize = 20;
/// Scales have settled where the evidence at them is so near to its maximum, nats.
const SETTLED: f64 = 1e-4;

/// A column beside a model: its place in the sums, and the typical size of its parameter.
pub(crate) type Aside = (usize, f64);

/// A model's columns, and those beside it, each divided by its length.
pub(crate) struct Weighing<'a> {
    gram: &'a Gram,
    model: &'a [Column],
    beside: Vec<Aside>,
    /// One over the length of each column, and of the residual, which comes last and is as it is.
    unit: Vec<f64>,
    /// Their sums, group by group.
    parts: Vec<Upper>,
}

/// The sums of a weighing at some scales, out of which the model is swept.
#[derive(Clone)]
pub(crate) struct Swept {
    pub(crate) scales: Vec<f64>,
    sums: Upper,
    /// What each column beside the model is without it.
    whole: Vec<f64>,
    /// Logarithm of the determinant of what the model has.
    volume: f64,
}

/// What a model leaves of columns beside it, in typical sizes, and of the residuals, which come last.
pub(crate) struct Left {
    sums: Upper,
    /// What each column is without the model.
    whole: Vec<f64>,
}

impl<'a> Weighing<'a> {
    pub(crate) fn new(gram: &'a Gram, model: &'a [Column], beside: Vec<Aside>) -> Self {
        let n = model.len() + beside.len();
        let faint = |&(place, typical): &Aside| Column { place, precision: typical.powi(-2) * RIDGE, value: 0.0 };
        let columns: Vec<Column> = model.iter().copied().chain(beside.iter().map(faint)).collect();
        // Columns of length one: sums of squares would lose the small ones otherwise.
        let unit: Vec<f64> = gram.sizes(&columns).iter().map(|size| 1.0 / size).chain([1.0]).collect();
        let place: Vec<usize> = columns.iter().map(|column| column.place).chain([gram.residual]).collect();
        let part = |sum: &Mat<f64>| {
            let mut part = Upper::zeros(n + 1);
            for i in 0..=n {
                let from = sum.col_as_slice(place[i]);
                let to = part.row_mut(i).iter_mut().zip(&place[i..]).zip(&unit[i..]);
                to.for_each(|((to, place), own)| *to = from[*place] * own * unit[i]);
            }
            part
        };
        let parts = gram.sums.iter().map(part).collect();
        Self { gram, model, beside, unit, parts }
    }

    /// The same model with some of the columns beside it.
    pub(crate) fn part(&self, own: Range<usize>) -> Self {
        let columns = self.own(own.clone());
        Self {
            beside: self.beside[own].to_vec(),
            unit: columns.iter().flat_map(|run| &self.unit[run.clone()]).copied().collect(),
            parts: self.parts.iter().map(|part| part.part(&columns)).collect(),
            ..*self
        }
    }

    /// The columns of the model, some of those beside it, and the residual.
    fn own(&self, beside: Range<usize>) -> [Range<usize>; 3] {
        let (n, last) = (self.model.len(), self.model.len() + self.beside.len());
        [0..n, n + beside.start..n + beside.end, last..last + 1]
    }

    /// Sweeps the model out of the sums at these scales; `None` where it is not determined.
    pub(crate) fn sweep(&self, scales: &[f64]) -> Option<Swept> {
        Arch::new().dispatch(Sweep(self, scales))
    }

    /// Of some of the columns beside the model, what is swept of all.
    pub(crate) fn part_of(&self, swept: &Swept, own: Range<usize>) -> Swept {
        let sums = swept.sums.part(&self.own(own.clone()));
        Swept { scales: swept.scales.clone(), sums, whole: swept.whole[own].to_vec(), volume: swept.volume }
    }

    /// What the model leaves.
    pub(crate) fn left(&self, swept: &Swept) -> Left {
        let (n, k) = (self.model.len(), self.beside.len());
        let sizes: Vec<f64> =
            self.beside.iter().zip(&self.unit[n..]).map(|((_, typical), unit)| typical / unit).chain([1.0]).collect();
        let mut sums = Upper::zeros(k + 1);
        for a in 0..=k {
            let to = sums.row_mut(a).iter_mut().zip(swept.sums.row(n + a)).zip(&sizes[a..]);
            to.for_each(|((to, from), size)| *to = from * size * sizes[a]);
        }
        let whole = swept.whole.iter().zip(&sizes).map(|(whole, size)| whole * size * size).collect();
        Left { sums, whole }
    }

    /// The evidence with a prior of so many typical sizes for what is beside the model, the scales beginning at those of what is swept;
    /// `None` where it is not determined.
    pub(crate) fn evidence(&self, width: f64, swept: &Swept) -> Option<Evidence> {
        Arch::new().dispatch(Settle(self, width, swept))
    }

    #[inline(always)] // With the widest registers.
    fn swept<S: Simd>(&self, simd: S, scales: &[f64]) -> Option<Swept> {
        let (n, k) = (self.model.len(), self.beside.len());
        let mut sums = Upper::zeros(n + k + 1);
        sums.set_sum(simd, self.parts.iter().zip(scales).map(|(part, scale)| (1.0 / scale, part)));
        for (i, column) in self.model.iter().enumerate() {
            let precision = column.precision * self.unit[i] * self.unit[i];
            *sums.at(i, i) += precision + RIDGE;
            *sums.at(i, n + k) += precision * column.value / self.unit[i];
        }
        let whole = (n..n + k).map(|i| *sums.at(i, i)).collect();
        let volume = sums.sweep(simd, 0..n)?;
        Some(Swept { scales: scales.to_vec(), sums, whole, volume })
    }

    #[inline(always)] // With the widest registers.
    fn settled<S: Simd>(&self, simd: S, width: f64, swept: &Swept) -> Option<Evidence> {
        let Self { gram, model, beside, unit, parts } = self;
        let n = model.len() + beside.len();
        let of_beside = beside.iter().map(|(_, typical)| ((width * typical).powi(-2), 0.0));
        let priors = model.iter().map(|column| (column.precision, column.value)).chain(of_beside);
        let (precision, offset): (Vec<f64>, Vec<f64>) =
            priors.zip(unit).map(|((precision, value), unit)| (precision * unit * unit, value / unit)).unzip();
        let Swept { mut scales, sums: mut normal, volume: mut of_model, .. } = swept.clone();
        let mut chi2 = vec![0.0; parts.len()];
        for round in 1..=SCALE_ROUNDS {
            (model.len()..n).for_each(|i| *normal.at(i, i) += precision[i] + RIDGE);
            let volume = of_model + normal.sweep(simd, model.len()..n)?;
            // What is left of the residual is it less so much of each column.
            let delta = normal.vector((0..n).map(|i| -normal.row(i)[n - i]).chain([1.0]));
            (0..=n).for_each(|i| *normal.at(i, n) = 0.0);
            // The evidence at these scales, and what it lacks: where it is largest it bends by half the rows in the logarithm of a scale.
            let (mut held, mut lacking) = (0.0, 0.0);
            for (g, part) in parts.iter().enumerate() {
                let [left, unspent] = part.between(simd, &delta, &normal);
                chi2[g] = left.max(0.0);
                let free = gram.rows[g] + unspent / scales[g];
                let scale = if free < 1.0 { scales[g] } else { (chi2[g] / free).max(1.0) };
                held += gram.rows[g] * scales[g].ln() + chi2[g] / scales[g];
                lacking += gram.rows[g] / 4.0 * (scale / scales[g] - 1.0).powi(2);
                scales[g] = scale;
            }
            if lacking < SETTLED || round == SCALE_ROUNDS {
                let theta: Vec<f64> = (0..n).map(|i| offset[i] + delta[i]).collect();
                let deviance: f64 = (0..parts.len()).map(|g| gram.rows[g] * scales[g].ln() + chi2[g] / scales[g]).sum();
                let prior: f64 = (0..n).map(|i| precision[i] * theta[i] * theta[i]).sum();
                let given: f64 = precision.iter().filter(|p| **p > 0.0).map(|p| p.ln()).sum();
                // The lengths of the base columns are the same in all models, those of the others cancel.
                return Some(Evidence {
                    log: -0.5 * (held + prior + volume - given),
                    deviance,
                    chi2: chi2.iter().sum(),
                    scales,
                    theta: theta.iter().zip(unit).map(|(theta, unit)| theta * unit).collect(),
                });
            }
            Swept { sums: normal, volume: of_model, .. } = self.swept(simd, &scales)?;
        }
        None
    }
}

impl Left {
    fn columns(&self) -> usize {
        self.sums.size() - 1
    }

    /// Of some of the columns.
    pub(crate) fn part(&self, own: Range<usize>) -> Self {
        let k = self.columns();
        Self { sums: self.sums.part(&[own.clone(), k..k + 1]), whole: self.whole[own].to_vec() }
    }

    /// The width of the prior, in typical sizes, with the largest gain of the logarithm of the evidence, and that gain; `None` where none
    /// can be computed.
    pub(crate) fn best_width(&self, widths: &[f64]) -> Option<(f64, f64)> {
        Arch::new().dispatch(BestWidth(self, widths))
    }

    #[inline(always)]
    fn gain<S: Simd>(&self, simd: S, width: f64) -> Option<f64> {
        let (mut sums, k) = (self.sums.clone(), self.columns());
        let residual = *sums.at(k, k);
        (0..k).for_each(|a| *sums.at(a, a) += 1.0 / (width * width));
        let volume = sums.sweep(simd, 0..k)? + 2.0 * k as f64 * width.ln();
        Some(0.5 * (residual - *sums.at(k, k) - volume))
    }

    /// What each direction of the parameters moves chi2 by; what is below the rounding of what was subtracted is nothing.
    pub(crate) fn spectrum(&self) -> Vec<f64> {
        let k = self.columns();
        let normal = Mat::from_fn(k, k, |a, b| self.sums.row(a.min(b))[a.abs_diff(b)]);
        let Ok(values) = normal.self_adjoint_eigenvalues(faer::Side::Lower) else { return Vec::new() };
        let rounding = 1e-9 * self.whole.iter().sum::<f64>();
        values.into_iter().map(|value| if value > rounding { value } else { 0.0 }).collect()
    }

    /// The sum of these.
    pub(crate) fn trace(&self) -> f64 {
        (0..self.columns()).map(|a| self.sums.row(a)[0].max(0.0)).sum()
    }
}

struct Settle<'a>(&'a Weighing<'a>, f64, &'a Swept);

impl WithSimd for Settle<'_> {
    type Output = Option<Evidence>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        self.0.settled(simd, self.1, self.2)
    }
}

struct Sweep<'a>(&'a Weighing<'a>, &'a [f64]);

impl WithSimd for Sweep<'_> {
    type Output = Option<Swept>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        self.0.swept(simd, self.1)
    }
}

struct BestWidth<'a>(&'a Left, &'a [f64]);

impl WithSimd for BestWidth<'_> {
    type Output = Option<(f64, f64)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut best: Option<(f64, f64)> = None;
        // Not in a closure, which would be compiled for other registers.
        for &width in self.1 {
            if let Some(gain) = self.0.gain(simd, width).filter(|gain| best.is_none_or(|(_, most)| *gain > most)) {
                best = Some((width, gain));
            }
        }
        best
    }
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
        let gram = Gram::of(&columns, &vec![0; rows]);
        let model = [Column { place: 0, precision: 0.0, value: 0.0 }, Column { place: 1, precision: 4.0, value: 0.3 }];
        let plain = gram.evidence(&model).unwrap();
        assert_eq!(plain.scales, vec![1.0]);
        let weighing = Weighing::new(&gram, &model, vec![(2, 0.2)]);
        let swept = weighing.sweep(&plain.scales).unwrap();
        let left = weighing.left(&swept);
        for width in [0.1, 1.0, 10.0] {
            let precision = 1.0 / (width * 0.2f64).powi(2);
            let with = [model[0], model[1], Column { place: 2, precision, value: 0.0 }];
            let gain = gram.evidence(&with).unwrap().log - plain.log;
            assert!((left.gain(pulp::Scalar, width).unwrap() - gain).abs() < 1e-9, "{width}: {gain}");
            let beside = weighing.evidence(width, &swept).unwrap().log - plain.log;
            assert!((beside - gain).abs() < 1e-9, "{width}: {beside} {gain}");
        }
    }
}
