//! Estimates by how much the residuals of a fit exceed their noise (model.md (19)).

use faer::Mat;

use super::{FINEST_RADPS, flicker_of_rests};
use crate::joint::linear::{Line, Linear, Source};
use crate::joint::model::Model;
use crate::joint::prepared::Prepared;
use crate::joint::scatter::{Excess, Modes, Scatter};
use crate::joint::wander::Wander;
use crate::numerics::fit_report::significance_limit;
use crate::numerics::lsq::{self, Solution};
use nalgebra::Matrix3;

/// Number of quantities in a `Widening`. Six of them are factors on standard deviations. The other nine are three
/// quantities with one value per gyroscope axis: the variance with which the mean rates vary from rest to rest, the
/// bias instability, and the variance from epoch to epoch (part to part) of long rests.
pub(in crate::joint) const WIDENINGS: usize = FACTORS + 9;
/// Number of factors in `Scales`. They are the first quantities of a `Widening`.
pub(in crate::joint) const FACTORS: usize = 6;

/// Excess of the residuals over noise: factors on the standard deviations, variances that are added, and a bias
/// instability.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Widening {
    pub(crate) scales: Scales,
    /// For each gyroscope axis: variance with which the mean rates vary from rest to rest in excess of noise, squared
    /// raw units.
    pub(super) between_rests: [f64; 3],
    /// Bias instability of each axis of the gyroscope, raw units.
    pub(super) bias_instability: [f64; 3],
    /// For each gyroscope axis: variance with which the mean rates vary from epoch to epoch (part to part) of a long
    /// rest in excess of noise, squared raw units.
    pub(super) epoch_rates: [f64; 3],
}

/// Factors by which the standard deviations that noise causes are multiplied; 1 if noise explains the residuals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scales {
    pub(crate) norms: f64,
    pub(crate) moves: f64,
    pub(crate) inside: f64,
    pub(crate) stand_rests: f64,
    pub(crate) stand_moves: f64,
    /// Factor for the mean forces at the second and later epochs of long rests. An epoch is a part of a rest with its
    /// own mean.
    pub(crate) epochs: f64,
}

/// Kinds of residuals whose standard deviations are increased (widened), because the residuals scatter more than their
/// noise explains.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::joint) struct Widened {
    /// One flag for each kind, in the order of `Scales`.
    kinds: [bool; FACTORS],
    /// For each gyroscope axis: whether the variances of the mean rates at rests are increased.
    rates: [bool; 3],
    /// For each gyroscope axis: whether the variances of the mean rates at the second and later epochs are increased.
    /// An epoch is a part of a long rest with its own mean.
    epoch_rates: [bool; 3],
    /// Whether the excess scatter of the mean rates is modelled as bias instability. If false, it is modelled as errors
    /// that are independent from rest to rest.
    wanders: bool,
}

impl Widened {
    /// Kinds of residuals whose standard deviations are increased in `self` or in `other`. The flag `wanders`, which
    /// selects the model of the excess scatter of the mean rates, is taken from `other`.
    pub(in crate::joint) fn union(self, other: Self) -> Self {
        let either = |(a, b): (bool, bool)| a || b;
        let mut all = other;
        all.kinds.iter_mut().zip(self.kinds).for_each(|(to, from)| *to = either((*to, from)));
        all.rates.iter_mut().zip(self.rates).for_each(|(to, from)| *to = either((*to, from)));
        all.epoch_rates.iter_mut().zip(self.epoch_rates).for_each(|(to, from)| *to = either((*to, from)));
        all
    }
}

impl Widening {
    pub(super) const NONE: Self =
        Self { scales: Scales::NONE, between_rests: [0.0; 3], bias_instability: [0.0; 3], epoch_rates: [0.0; 3] };

    /// Estimates by how much the residuals in `linear` exceed their noise. If they are the residuals at the end of a
    /// fit, `found` contains this fit and the scales (factors on standard deviations) used in it. The standard
    /// deviations of a kind of residuals are increased if its excess is significant, or if `kept` contains the kind.
    pub(super) fn of(
        prepared: &Prepared<'_>,
        linear: &Linear,
        found: Option<(&Solution, &Scales)>,
        kept: Option<&Widened>,
    ) -> Self {
        let leverages = found.map(|(solution, _)| lsq::leverages(&solution.jacobian));
        let scales = match (found, &leverages) {
            (Some((solution, before)), Some(leverages)) => before.refined(linear, solution, leverages, kept),
            _ => Scales::NONE,
        };
        let head = linear.lines.len();
        let free = |axis: usize, later: bool| {
            let is_own = |k: &usize| linear.rates[*k].1[axis].is_of_later_epoch == later;
            let own = || (0..linear.rates.len()).filter(is_own);
            let spent: f64 = leverages.as_ref().map_or(1.0, |h| own().map(|k| h[head + 3 * k + axis]).sum());
            own().count() as f64 - spent
        };
        let free = [false, true].map(|later| [0, 1, 2].map(|axis| free(axis, later)));
        let (between_rests, bias_instability) = excess_of_rates(prepared, linear, free[0], kept);
        let epoch_rates = excess_of_epochs(prepared, linear, free[1], kept);
        Self { scales, between_rests, bias_instability, epoch_rates }
    }

    pub(in crate::joint) fn widened(&self) -> Widened {
        Widened {
            kinds: self.scales.all().map(|scale| scale > 1.0),
            rates: [0, 1, 2].map(|axis| self.between_rests[axis] > 0.0 || self.bias_instability[axis] > 0.0),
            epoch_rates: self.epoch_rates.map(|variance| variance > 0.0),
            wanders: self.bias_instability != [0.0; 3],
        }
    }

    /// Logarithms of all quantities of the widening. If a variance or a bias instability is zero, its logarithm is
    /// minus infinity.
    pub(in crate::joint) fn logarithms(&self) -> [f64; WIDENINGS] {
        let mut all = [0.0; WIDENINGS];
        let values = self.scales.all().into_iter().chain(self.between_rests).chain(self.bias_instability);
        let values = values.chain(self.epoch_rates);
        all.iter_mut().zip(values).for_each(|(to, value)| *to = value.ln());
        all
    }

    /// Computes a widening from the logarithms of its quantities. Factors below 1 are set to 1.
    pub(in crate::joint) fn from_logarithms(all: &[f64; WIDENINGS]) -> Self {
        let value = |i: usize| all[i].exp();
        let [norms, moves, inside, stand_rests, stand_moves, epochs] = [0, 1, 2, 3, 4, 5].map(|i| value(i).max(1.0));
        Self {
            scales: Scales { norms, moves, inside, stand_rests, stand_moves, epochs },
            between_rests: [6, 7, 8].map(value),
            bias_instability: [9, 10, 11].map(value),
            epoch_rates: [12, 13, 14].map(value),
        }
    }
}

/// Covariance of the mean rate of rest k from noise only.
pub(super) fn rate_covariance(prepared: &Prepared<'_>, model: &Model, k: usize) -> Matrix3<f64> {
    let finest = model.gyroscope.sensitivity().norm() / 3f64.sqrt() * FINEST_RADPS;
    prepared.rests[k].rate_covariance + Matrix3::from_diagonal_element(finest * finest)
}

/// Estimates the excess scatter of the mean rates of rests on each axis. The scatter is modelled either as errors that
/// are independent from rest to rest or as bias instability of the gyroscope. The model with the larger likelihood is
/// chosen. Returns the variance from rest to rest and the bias instability. The value of the model that is not chosen
/// is zero.
fn excess_of_rates(
    prepared: &Prepared<'_>,
    linear: &Linear,
    free: [f64; 3],
    kept: Option<&Widened>,
) -> ([f64; 3], [f64; 3]) {
    let axes = [0, 1, 2].map(|axis| rates_of(prepared, linear, axis, false));
    let one_by_one = [0, 1, 2].map(|axis| {
        let scatter = Scatter::from_rest_to_rest(&axes[axis].0, &axes[axis].1);
        let is_widened = kept.is_some_and(|kept| kept.rates[axis]) || scatter.is_significant(free[axis]);
        is_widened.then(|| scatter.excess(free[axis])).flatten()
    });
    let between_rests = one_by_one.map(|e| e.map_or(0.0, |e| e.variance));
    if prepared.wander == Wander::Seen
        && one_by_one.iter().any(Option::is_some)
        && let Some(modes) = prepared.flicker.get_or_init(|| {
            let flicker = flicker_of_rests(prepared)?;
            let [x, y, z] = axes.each_ref().map(|(_, variances)| Modes::new(variances, &flicker));
            Some([x?, y?, z?])
        })
    {
        // If bias instability explains the significant scatter better than errors that are independent from rest to
        // rest, it is estimated for all axes.
        let wandering = [0, 1, 2].map(|axis| modes[axis].scatter(&axes[axis].0).excess(free[axis]));
        let cost = |axis: usize, found: &[Option<Excess>; 3]| found[axis].map_or(f64::INFINITY, |e| e.cost);
        let beyond: Vec<usize> = (0..3).filter(|&axis| one_by_one[axis].is_some()).collect();
        let [wanders, scatters] =
            [&wandering, &one_by_one].map(|found| beyond.iter().map(|&axis| cost(axis, found)).sum::<f64>());
        if kept.map_or(wanders < scatters, |kept| kept.wanders) {
            return ([0.0; 3], wandering.map(|e| e.map_or(0.0, |e| e.variance.sqrt())));
        }
    }
    (between_rests, [0.0; 3])
}

/// Estimates the excess scatter of the mean rates of the second and later epochs (parts) of long rests, as a variance
/// for each axis. It is separate from the variance from rest to rest, because the drift within a long rest does not
/// predict the biases at other rests.
fn excess_of_epochs(prepared: &Prepared<'_>, linear: &Linear, free: [f64; 3], kept: Option<&Widened>) -> [f64; 3] {
    [0, 1, 2].map(|axis| {
        let (residuals, variances) = rates_of(prepared, linear, axis, true);
        let scatter = Scatter::from_rest_to_rest(&residuals, &variances);
        let is_widened = kept.is_some_and(|kept| kept.epoch_rates[axis]) || scatter.is_significant(free[axis]);
        let excess = is_widened.then(|| scatter.excess(free[axis])).flatten();
        excess.map_or(0.0, |excess| excess.variance)
    })
}

/// Residuals of the mean rates on one axis, and their variances from noise, in raw units. If `later` is true, they are
/// the residuals of the second and later epochs (parts) of long rests, otherwise all other residuals.
fn rates_of(prepared: &Prepared<'_>, linear: &Linear, axis: usize, later: bool) -> (Vec<f64>, Vec<f64>) {
    let rounding = |k: usize| prepared.rests[k].rest.angular_rate.rounding[axis].error_variance;
    let of_rest = |(k, lines): &(usize, [Line; 3])| {
        // The variance of the rounding errors is added. It is an upper limit of their scatter between rests, because
        // rests with equal readings have equal rounding errors.
        let covariance = rate_covariance(prepared, &linear.model, *k);
        (lines[axis].residual, covariance[(axis, axis)] + rounding(*k))
    };
    linear.rates.iter().filter(|(_, lines)| lines[axis].is_of_later_epoch == later).map(of_rest).unzip()
}

impl Scales {
    pub(crate) const NONE: Self =
        Self { norms: 1.0, moves: 1.0, inside: 1.0, stand_rests: 1.0, stand_moves: 1.0, epochs: 1.0 };

    fn all(&self) -> [f64; FACTORS] {
        [self.norms, self.moves, self.inside, self.stand_rests, self.stand_moves, self.epochs]
    }

    /// The largest factor on a standard deviation.
    pub(crate) fn largest(&self) -> f64 {
        self.all().into_iter().fold(1.0, f64::max)
    }

    /// Computes, for each kind of residuals, the scale (factor on the standard deviations) at which chi2 equals the
    /// degrees of freedom. The scale is 1 if the excess is not significant (see [`refine`]).
    fn refined(&self, linear: &Linear, solution: &Solution, leverages: &[f64], kept: Option<&Widened>) -> Self {
        let lines = &linear.lines;
        let groups = linear.groups();
        let is_later = |row: usize| row < lines.len() && lines[row].is_of_later_epoch;
        let is_other = |row: usize| row < lines.len() && !lines[row].is_of_later_epoch;
        let norm = |row: usize| is_other(row) && matches!(lines[row].source, Source::Norm(_));
        let a_move = |row: usize| is_other(row) && matches!(lines[row].source, Source::Move(_));
        let kept = kept.copied().unwrap_or_default().kinds;
        let refined = |scale: f64, kept: bool, chosen: &dyn Fn(usize) -> bool| {
            refine((scale, kept), &solution.residuals, leverages, chosen)
        };
        Self {
            norms: refined(self.norms, kept[0], &norm),
            moves: refined(self.moves, kept[1], &a_move),
            inside: refined(self.inside, kept[2], &|row| groups.inside.contains(&row)),
            stand_rests: refined(self.stand_rests, kept[3], &|row| groups.stand_rests.contains(&row)),
            stand_moves: refined(self.stand_moves, kept[4], &|row| groups.stand_moves.contains(&row)),
            epochs: refined(self.epochs, kept[5], &is_later),
        }
    }
}

/// Computes the new scale of the chosen residuals. The candidate is the scale at which these residuals have unit
/// variance. It is used if it is significantly above 1, or if it is above 1 and `is_kept` is set. Otherwise, the new
/// scale is 1. With less than one degree of freedom, the scale is not changed.
fn refine(
    (scale, is_kept): (f64, bool),
    residuals: &Mat<f64>,
    leverages: &[f64],
    chosen: impl Fn(usize) -> bool,
) -> f64 {
    let rows: Vec<usize> = (0..residuals.nrows()).filter(|&row| chosen(row)).collect();
    let free = rows.len() as f64 - rows.iter().map(|&row| leverages[row]).sum::<f64>();
    if free < 1.0 {
        return scale;
    }
    let reduced = scale * scale * rows.iter().map(|&row| residuals[(row, 0)].powi(2)).sum::<f64>() / free;
    if reduced > significance_limit(free) || (is_kept && reduced > 1.0) { reduced.sqrt() } else { 1.0 }
}
