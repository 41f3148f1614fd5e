//! Joint maximum-likelihood estimate of both sensor models and of the selected effects (model.md (17) to (20)). An
//! effect is a sensor error that bias and sensitivity do not describe, for example a dependence on temperature. A rest
//! is an interval without motion, and a move is the motion from one rest to the next.
//!
//! ```text
//! rest norms   |f_k| - g
//! rest rates   mean(m_k) - b - T mean(Phi)_k theta
//! moves        E_k (R_k^T u_k - u_(k+1))
//! in the move  R(t) f(t) - g u_k,   used for effects that are observable only while the unit rotates
//! ```
//!
//! k is the index of a rest, or of the move after this rest. f_k is the mean force at rest k, u_k its direction, and g
//! local gravity. m_k are the rates measured at rest k, b is the bias of the gyroscope, and T its sensitivity. An
//! effect with the parameters theta adds Phi theta to the rate. Its field Phi contains the derivatives of the rate with
//! respect to theta, and mean(Phi)_k is the mean of Phi over rest k. R_k is the rotation over move k. R(t) is the
//! rotation from the body frame at time t to the body frame at the start of the move. Both rotations are integrated
//! from the gyroscope rates. The two rows of E_k span the plane perpendicular to u_(k+1).
//!
//! The quantities f, u and R are corrected for the effects. An error of the mean force at a rest changes the residuals
//! of both adjacent moves, so these residuals are correlated. Whitening multiplies the residuals by the inverse of the
//! Cholesky factor of their covariance. The attitude error grows inside a move as a random walk, so the residuals
//! inside a move are correlated, too. A Kalman filter replaces the residuals inside a move by its normalised
//! innovations, which are white (module `inside`). The weights of the residuals are estimated from a fit, and the next
//! fit uses the new weights. Fits are repeated until the parameters converge.

mod choices;
mod encoders;
mod fields;
mod histories;
mod inside;
mod lanes;
mod linear;
mod misfit;
mod model;
mod move_ends;
mod outliers;
mod pass;
mod prepared;
mod problem;
mod rests;
mod reweighting;
mod scatter;
mod settle;
mod start;
mod terms;
mod wander;
mod weights;

#[cfg(test)]
mod derivatives;
#[cfg(test)]
mod tests;

use crate::parameters::BASE;
pub use choices::{EffectChoice, Kinds, UserField};

pub(crate) use encoders::{Encoders, StandModel, mount_rotation};
pub(crate) use fields::{Field, move_segments};
pub(crate) use histories::SharedHistories;
pub(crate) use lanes::Lanes;
pub(crate) use linear::{
    EPOCH_RATES, INSIDE, Insides, Line, Linear, MOVE_DIRECTIONS, STAND_MOVES, STAND_RESTS, Source,
};
pub use misfit::Misfit;
pub(crate) use misfit::Misfits;
pub(crate) use model::{Model, force_by_parameters};
pub(crate) use outliers::{Item, outliers};
pub(crate) use pass::BLOCK_S;
pub(crate) use pass::segments::MoveSegments;
pub(crate) use prepared::Prepared;
pub(crate) use problem::Joint;
pub(crate) use problem::report::JointFit;
pub use problem::report::{ResidualScales, TermEstimate};
pub use start::WarmStart;
pub(crate) use start::start_model;
pub(crate) use terms::{Term, Terms};
pub(crate) use wander::Wander;
pub use wander::{BiasWander, UnitWander};

use std::sync::Arc;

use faer::Mat;
use imucal_core::effects::{Effect, Need};
use imucal_core::sensor::Triad;
use nalgebra::Matrix3;

use crate::error::Error;
use crate::numerics::lsq::Termination;
use crate::numerics::lsq::{self, Solution};
use crate::rests::moves::Ends;
use problem::report::moves_of;
use reweighting::Reweighting;
use start::Prior;
use weights::Weights;

/// Observability limit of an effect. If its parameters change by one typical size (`Term::typical`) in their least
/// observable direction, the norm of the change of the whitened residuals must be at least this value. At the limit of
/// 0.1, a change by ten typical sizes changes chi2 by one (model.md (18)).
const LEAST_CHANGE: f64 = 0.1;
/// Observability limit of an effect with a prior. It is defined like `LEAST_CHANGE`, but for a change of the parameters
/// in their most observable direction. At 0.01, a change by a hundred typical sizes changes chi2 by one.
pub(crate) const LEAST_CHANGE_PARTLY: f64 = 0.01;
/// Initial standard deviation of the prior of an effect, in typical sizes of its parameters. Only effects that are
/// permitted even if the recordings do not determine all their parameters (`Term::partly`) have such a prior.
const WIDE: f64 = 100.0;
/// Convergence limit of the fits that are repeated with new weights: largest change of a parameter from one fit to the
/// next, in standard deviations of the parameter (model.md (18)).
const SETTLED: f64 = 1e-3;
/// If a parameter changes by more than this number of standard deviations in the last permitted fit, the weights are
/// reported as not converged. The convergence test of a single fit, which uses the gradient of chi2, has the same
/// limit. An estimate whose last change is between `SETTLED` and this limit is usable. Slow hand-held runs with a
/// temperature cycle give such estimates: the changes decrease only by a constant factor per fit and may exceed
/// `SETTLED` after `MAX_ROUNDS` fits.
const NOT_SETTLED: f64 = 0.1;
/// Maximum number of fits with new weights. If the parameters have not converged after this number, the result is
/// reported as not converged. Most runs converge within five fits.
const MAX_ROUNDS: usize = 16;
/// A search for effects estimates its first weights from the residuals of its start model. If these residuals scatter
/// by more than this multiple of their noise, the errors of the start model make the weights far too small. The fit is
/// then repeated with new weights.
const MISLEADING: f64 = 10.0;
/// The repeated fits of a search for effects end if, for every kind of residuals, the ratio of scatter to noise changes
/// by less than this factor from one fit to the next.
const FAR: f64 = 1.5;
/// Relative tolerance of the solver (see `lsq::EXACT`) in a search for effects, and in the first of the fits that are
/// repeated with new weights. The weights of the first fit are preliminary, so a coarse tolerance suffices.
const SEARCH: f64 = 1e-5;
/// Start values for the time constant of a warm-up, each as a fraction of the longest recording's duration (model.md
/// (23)).
const SHAPE_SHARES: [f64; 4] = [0.03, 0.1, 0.3, 1.0];
/// Start values for the time constant of a temperature lag, each as a fraction of the longest recording's duration. A
/// warm-up occurs only once, but a lag causes an error at each change of the temperature. A time constant much shorter
/// than the recording is therefore observable for a lag. A lag with a time constant as long as the recording causes
/// nearly the same errors as the temperature itself, so this start value is not tried.
const LAG_SHARES: [f64; 5] = [0.002, 0.006, 0.02, 0.06, 0.2];

/// Effects that depend on the angular acceleration and cause a rotation error over a whole move. They are observable
/// from the gravity directions at the rests, even if the force inside the moves is not used.
const OBSERVABLE_AT_RESTS: [&str; 1] = ["gyro_angular_acceleration"];

/// Whether an effect is not observable in hand-held recordings. The hand adds an unknown acceleration to the force
/// inside the moves, so an effect that is observable only from this force is not observable.
pub(crate) fn is_unobservable_hand_held(name: &str) -> bool {
    let effect = Effect::<f64>::find(name);
    effect.is_some_and(|e| e.needs.contains(&Need::AngularAcceleration)) && !OBSERVABLE_AT_RESTS.contains(&name)
}

/// Estimates all parameters. The fit starts from `warm_start` if the warm start has the same effects as `terms`.
/// Otherwise it starts from the given sensor models `triads` with zero effects.
pub(crate) fn fit(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    triads: [&Triad<f64>; 2],
    warm_start: Option<&WarmStart>,
) -> Result<JointFit, Error> {
    check_columns(prepared, terms)?;
    let mut parameters = start::start(prepared, terms, triads, warm_start).parameters();
    let mut problem = Joint::new(prepared, terms, &parameters)?;
    let (mut iterations, most) = (0, prepared.max_iterations);
    begin(&mut problem, terms, &parameters, |term| term.partly.then_some(WIDE))?;
    choose_shapes(&mut problem, terms, &mut parameters)?;
    let mut reweighting = Reweighting::default();
    for round in 0..MAX_ROUNDS {
        // The weights of the first round are preliminary, so a coarse tolerance suffices.
        let tolerance = if round == 0 { SEARCH } else { lsq::EXACT };
        let mut found = minimize_within(&problem, &parameters, tolerance, most - iterations)?;
        iterations += found.iterations;
        let priors_have_settled = !problem.widen(&found);
        let change = if round > 0 { largest_move(&parameters, &found) } else { f64::INFINITY };
        let is_last = round + 1 == MAX_ROUNDS || iterations >= most;
        if (priors_have_settled && change < SETTLED) || is_last {
            // The reported residuals must be computed from the samples at the final parameters. A first-order update
            // from the residuals at nearby parameters is not accurate enough.
            if problem.refresh(&found.parameters)? && iterations < most {
                found = minimize_within(&problem, &found.parameters, lsq::EXACT, most - iterations)?;
                iterations += found.iterations;
            }
            let ending = match priors_have_settled && change < NOT_SETTLED {
                true => None,
                false if iterations >= most => Some(Termination::IterationLimit),
                false => Some(Termination::WeightsNotSettled),
            };
            return JointFit::new(&problem, terms, found, (iterations, ending));
        }
        parameters.clone_from(&found.parameters);
        reweighting.update(&mut problem, &found)?;
    }
    Err(Error::Fit("the joint fit made no step".into()))
}

/// Runs the joint fit of a search for effects, from the model `start`, with a relative tolerance of 1e-5. If the
/// residuals of this model are far above noise, the fit is repeated with new weights until the weights hardly change.
/// Otherwise, with encoders, it is repeated once. `width` returns the standard deviation of an effect's prior, in
/// typical sizes of its parameters, or `None` for no prior. Returns the residuals and derivatives at the estimate.
pub(crate) fn fit_for_search(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    start: &Model,
    width: impl Fn(&Term<'_>) -> Option<f64>,
) -> Result<Arc<Linear>, Error> {
    let parameters = start.parameters();
    let mut problem = Joint::new(prepared, terms, &parameters)?;
    begin(&mut problem, terms, &parameters, width)?;
    let mut found = minimize(&problem, &parameters, SEARCH)?;
    // The first weights strongly reduce the influence of residuals that the start model does not explain, for example
    // due to a misaligned stand or a very large effect. The weights are therefore estimated again after the fit.
    let mut taken = problem.weights.times_noise(prepared);
    let is_misled = !terms.all.is_empty() && taken.iter().any(|times| *times > MISLEADING);
    let rounds = if is_misled { MAX_ROUNDS } else { usize::from(terms.kinds.encoders) };
    for round in 0..rounds {
        problem.weigh_by(&found)?;
        let before = std::mem::replace(&mut taken, problem.weights.times_noise(prepared));
        if round > 0 && before.iter().zip(taken).all(|(b, a)| (FAR.recip()..FAR).contains(&(a / b))) {
            break;
        }
        found = minimize(&problem, &found.parameters, SEARCH)?;
    }
    problem.linear_at_end(&found)
}

fn minimize(problem: &Joint<'_>, start: &[f64], tolerance: f64) -> Result<Solution, Error> {
    minimize_within(problem, start, tolerance, problem.prepared.max_iterations)
}

/// Fits all parameters, starting from `start`, with at most `iterations` iterations.
fn minimize_within(problem: &Joint<'_>, start: &[f64], tolerance: f64, iterations: u64) -> Result<Solution, Error> {
    let found = lsq::minimize_within(problem, start, tolerance, iterations.min(lsq::ITERATION_LIMIT))?;
    if found.termination == Termination::NotFinite {
        let message = "the joint fit has residuals that are not finite: leave effects out, or check units";
        return Err(Error::Fit(message.into()));
    }
    Ok(found)
}

/// Computes the gravity directions at the ends of each move and the rotation over the move, with the known model
/// `model`.
pub(crate) fn predict(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    model: &Model,
) -> Result<Vec<(Ends, Matrix3<f64>)>, Error> {
    let parameters = model.parameters();
    let linear = prepared.linearise(terms, &parameters)?;
    let weights = Weights::of(prepared, terms, &linear);
    Ok(moves_of(&linear, &weights))
}

/// Prepares the first fit: sets the priors of the effects (see `check_determined`), and estimates the weights from the
/// residuals at the start values `parameters`.
///
/// With weights from noise only, the large residuals at the start values could move the estimate of an effect far from
/// its true value. For example, a g-sensitivity that is equal on all axes adds a rate that is parallel to gravity at
/// rest. This rate rotates the attitude about gravity, and the residuals of the moves do not depend on this rotation.
/// The fit could therefore end at a very large g-sensitivity, at which the computed attitude rotates about gravity so
/// fast that the contributions of all other errors to the residuals average out.
fn begin(
    problem: &mut Joint<'_>,
    terms: &Terms<'_>,
    parameters: &[f64],
    width: impl Fn(&Term<'_>) -> Option<f64>,
) -> Result<(), Error> {
    let (residuals, jacobian) = problem.whitened(parameters)?;
    let priors = check_determined(&jacobian, terms, width)?;
    let (residuals, jacobian) = if priors.is_empty() {
        (residuals, jacobian)
    } else {
        problem.hold(priors);
        problem.whitened(parameters)?
    };
    problem.weigh_by(&Solution::at(parameters, residuals, jacobian))
}

/// Returns the largest change of a parameter from `before` to the fit `found`, in standard deviations of the parameter.
fn largest_move(before: &[f64], found: &Solution) -> f64 {
    let covariance = lsq::covariance(&found.jacobian);
    let change = |p: usize| (found.parameters[p] - before[p]).abs() / covariance[(p, p)].sqrt();
    (0..before.len()).map(change).fold(0.0, f64::max)
}

/// Returns an error if an effect depends on a temperature or heading that a recording does not provide.
fn check_columns(prepared: &Prepared<'_>, terms: &Terms<'_>) -> Result<(), Error> {
    let recordings = prepared.recordings;
    for term in &terms.all {
        let needs = |need| term.effect().is_some_and(|effect| effect.needs.contains(&need));
        if needs(Need::Temperature)
            && let Some(recording) = recordings.iter().find(|recording| !recording.has_temperature())
        {
            let lacks = match recording.temperature_degc {
                None => "no temp_degc column: record it",
                Some(_) => {
                    "samples without temperature: repair the temp_degc column (imucal convert --hold-temperature)"
                }
            };
            return Err(Error::Input(format!(
                "{} depends on temperature and {} has {lacks}, or leave the effect out",
                term.name(),
                recording.name
            )));
        }
        if needs(Need::Attitude) && recordings.len() > 1 {
            return Err(Error::Input(format!(
                "{} needs the heading, but the change of heading between two recordings is not known: give a single \
                 recording",
                term.name()
            )));
        }
        if needs(Need::Attitude)
            && let Some(lost) = prepared.heading_lost()
        {
            return Err(Error::Input(format!(
                "{} needs the heading, which is lost at {:.2} s, because the fit leaves out the move before this time: \
                 repair the data of this move, or leave the effect out",
                term.name(),
                prepared.rests[lost].rest.start_s
            )));
        }
    }
    Ok(())
}

/// Returns the priors of the effects. An effect for which `width` returns a standard deviation gets a prior with this
/// standard deviation, if the recordings determine at least one direction of its parameters. For any other effect, the
/// recordings must determine all directions of its parameters. If they do not, the function returns an error with the
/// explanation from the catalogue of effects.
fn check_determined(
    jacobian: &Mat<f64>,
    terms: &Terms<'_>,
    width: impl Fn(&Term<'_>) -> Option<f64>,
) -> Result<Vec<Prior>, Error> {
    let mut priors = Vec::new();
    // A prior acts in all directions. The initial prior of a calibration is so wide (100 typical sizes) that it hardly
    // changes the estimate in observable directions, so no limit between observable and unobservable directions is
    // needed.
    for term in &terms.all {
        // Jacobian columns of zeros are omitted from the QR decomposition. While an effect is zero, the derivatives of
        // the residuals with respect to its time constant are zero, and the decomposition would give this column an
        // arbitrary direction.
        let own = BASE + term.first..BASE + term.first + term.linear;
        let others = (BASE..terms.total()).filter(|p| !own.contains(p)).filter(|&p| jacobian.col(p).norm_l2() > 0.0);
        let order: Vec<usize> = (0..BASE).chain(others).chain(own.clone()).collect();
        let typical = term.typical();
        let first = order.len() - term.linear;
        let columns = Mat::from_fn(jacobian.nrows(), order.len(), |row, c| {
            let size = if c < first { 1.0 } else { typical[c - first] };
            jacobian[(row, order[c])] * size
        });
        let r = columns.qr().thin_R().to_owned();
        let seen = Mat::from_fn(term.linear, term.linear, |i, j| r[(first + i, first + j)]);
        let (values, _) = lsq::singular(&seen)?;
        let open = values.iter().filter(|value| **value < LEAST_CHANGE).count();
        let width = width(term).filter(|_| values.iter().any(|value| *value >= LEAST_CHANGE_PARTLY));
        if let Some(width) = width {
            priors.push(Prior { first: own.start, typical: typical[..term.linear].to_vec(), width });
        } else if open > 0 {
            return Err(Error::NotEnoughMotion(not_determined(term, open)));
        }
    }
    Ok(priors)
}

fn not_determined(term: &terms::Term<'_>, open: usize) -> String {
    let mut message = format!(
        "{open} of {} directions of {} are not determined by these recordings: an effect of ten times its typical size \
         along one of these directions would not be detected",
        term.linear,
        term.name()
    );
    if let Some(effect) = term.effect() {
        message += &format!("; it needs {}", effect.observable);
        for alias in effect.aliases {
            message += &format!("; {} is told apart by {}", alias.with, alias.told_apart_by);
        }
    }
    message
}

/// Returns the start values for the time constant of `effect`, each as a fraction of the longest recording's duration.
pub(crate) fn start_shares(effect: &Effect<f64>) -> &'static [f64] {
    if effect.needs.contains(&Need::TemperatureHistory) { &LAG_SHARES } else { &SHAPE_SHARES }
}

/// For each time constant, tries several values, and fits all other parameters for each value. The value with the
/// smallest chi2 becomes the centre of a wide prior of the time constant.
fn choose_shapes(problem: &mut Joint<'_>, terms: &Terms<'_>, parameters: &mut Vec<f64>) -> Result<(), Error> {
    for term in terms.all.iter().filter(|term| term.has_shape()) {
        let place = BASE + term.first + term.linear;
        let mut best: Option<(f64, Vec<f64>)> = None;
        for shape in
            term.effect().map_or(&[][..], start_shares).iter().map(|share| share * problem.prepared.longest_s())
        {
            let mut start = parameters.clone();
            start[place] = shape;
            problem.fixed = vec![place];
            // A coarse tolerance would end the fit before the first step, so chi2 would be equal for all values of the
            // time constant. The tolerance is relative to the norm of all parameters. The sensitivities dominate this
            // norm, but the first step changes mainly the small parameters of an effect.
            let found = lsq::minimize(&*problem, &start, lsq::EXACT)?;
            if best.as_ref().is_none_or(|(chi2, _)| found.chi2 < *chi2) {
                best = Some((found.chi2, found.parameters));
            }
        }
        problem.fixed.clear();
        if let Some((_, found)) = best {
            *parameters = found;
        }
    }
    problem.hold_shapes(parameters);
    Ok(())
}
