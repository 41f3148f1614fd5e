//! Computes the goodness of fit of each kind of residuals, relative to noise (model.md (26)). One kind is, for example,
//! the force norms at all rests.
//!
//! The degrees of freedom of a kind are the sum of 1 - h over its residuals, where h is the leverage of a residual. The
//! residuals are those of the final fit. In this fit, kinds of residuals with excess scatter have reduced weights. With
//! weights from noise only, these kinds would distort the fit and thus the residuals of other kinds.

use faer::Mat;
use nalgebra::Vector3;

use crate::joint::linear::{
    EPOCH_NORMS, EPOCH_RATES, EPOCH_STEPS, INSIDE, Line, Linear, MOVE_DIRECTIONS, STAND_MOVES, STAND_RESTS, Source,
};
use crate::joint::pass::BLOCK_S;
use crate::joint::weights::Weights;
use crate::numerics::lsq;
use crate::numerics::stats::rms;
use crate::verdict::{GroupMisfit, ResidualGroup};

/// A kind of residuals is tested only if it has at least this number of degrees of freedom. With fewer degrees of
/// freedom, the fit reproduces any values of the measurements.
const MIN_FREEDOM: f64 = 1.0;

/// Computes the goodness of fit of each kind of residuals. `residuals` and `jacobian` are those at the end of the fit.
/// They are whitened with `noise`, the weights from noise only.
pub(super) fn group_misfits(
    linear: &Linear,
    (residuals, jacobian): (&Mat<f64>, &Mat<f64>),
    noise: &Weights,
) -> Vec<GroupMisfit> {
    let (leverages, kinds) = (lsq::leverages(jacobian), linear.groups_of_rows());
    let of = |is_own: &dyn Fn(usize) -> bool| {
        let own = || kinds.iter().enumerate().filter(|(_, kind)| is_own(**kind)).map(|(row, _)| row);
        let free: f64 = own().map(|row| 1.0 - leverages[row]).sum();
        (own().map(|row| residuals[(row, 0)].powi(2)).sum::<f64>(), free)
    };
    // A long rest is divided into epochs, each with its own mean. Residuals of rests (first epochs) and of later epochs
    // are tested separately, and the worse result is reported. In a common test, many epochs of a long rest would mask
    // the scatter from rest to rest, or many rests would mask the drift within a rest.
    let worse = |poses: (f64, f64), epochs: (f64, f64)| {
        let are_worse = epochs.1 >= MIN_FREEDOM && epochs.0 / epochs.1 > poses.0 / poses.1;
        if are_worse { (epochs, true) } else { (poses, false) }
    };
    let (norms, are_of_epochs) = worse(of(&|kind| kind == 0), of(&|kind| kind == EPOCH_NORMS));
    let of_norms = of_lines(linear, true, are_of_epochs);
    let (moves, are_of_epochs) = worse(of(&|kind| kind == MOVE_DIRECTIONS), of(&|kind| kind == EPOCH_STEPS));
    let of_moves = of_lines(linear, false, are_of_epochs);
    let (rates, are_of_epochs) = worse(of(&|kind| (2..=4).contains(&kind)), of(&|kind| kind == EPOCH_RATES));
    let of_rates = linear.rates.iter().filter(|(_, lines)| lines[0].is_of_later_epoch == are_of_epochs);
    let [inside, rests, encoders] = [INSIDE, STAND_RESTS, STAND_MOVES].map(|kind| of(&|own| own == kind));
    let inverse = linear.model.gyroscope.inverse();
    let rate = |lines: &[Line; 3]| <[f64; 3]>::from(inverse * Vector3::from_fn(|axis, _| lines[axis].residual));
    // A whitened residual inside a move or relative to the stand is dimensionless. Multiplication by the standard
    // deviation of its noise gives its size in SI units.
    let of_noise = |(chi2, free): (f64, f64), sigma: f64| sigma * (chi2 / free).sqrt();
    let force_sigma = rms(noise.inside.iter().map(|noise| (noise.force / BLOCK_S).sqrt()));
    let against_stand = [(rests, noise.stand_sigma_rad), (encoders, noise.reading.sqrt())];
    let worst = against_stand.into_iter().filter(|((_, free), _)| *free >= MIN_FREEDOM);
    let worst = worst.max_by(|((a, n), _), ((b, m), _)| (a / n).total_cmp(&(b / m)));
    let groups = [
        Some((ResidualGroup::RestNorms, norms, rms(of_norms))),
        // The rms angle is sqrt(2) times the rms of its two components.
        Some((ResidualGroup::MoveDirections, moves, rms(of_moves) * 2f64.sqrt())),
        Some((ResidualGroup::RestRates, rates, rms(of_rates.flat_map(|(_, lines)| rate(lines))))),
        Some((ResidualGroup::MoveForces, inside, of_noise(inside, force_sigma))),
        worst.map(|(found, sigma)| (ResidualGroup::StandAttitudes, found, of_noise(found, sigma))),
    ];
    let judged = groups.into_iter().flatten().filter(|(_, (_, free), _)| *free >= MIN_FREEDOM);
    judged
        .map(|(group, (chi2, degrees_of_freedom), rms)| GroupMisfit { group, rms, chi2, degrees_of_freedom })
        .collect()
}

/// Returns residuals before whitening: those of force norms if `are_norms` is true, otherwise those of gravity
/// directions after moves. If `are_of_epochs` is true, only residuals of the second and later epochs (parts) of long
/// rests are returned, otherwise only the other residuals.
fn of_lines(linear: &Linear, are_norms: bool, are_of_epochs: bool) -> impl Iterator<Item = f64> {
    let is_own = move |line: &&Line| {
        matches!(line.source, Source::Norm(_)) == are_norms && line.is_of_later_epoch == are_of_epochs
    };
    linear.lines.iter().filter(is_own).map(|line| line.residual)
}
