//! Joint maximum-likelihood estimate of both triads and of the selected effects (model.md (17) to (20)).
//!
//! ```text
//! rest norms   |f_k| - g
//! rest rates   mean(w_k) - b - T mean(Phi)_k theta
//! moves        E_k (R_k^T u_k - u_(k+1))
//! in the move  R(t) f(t) - g u_k,   where an effect acts only while the unit turns
//! ```
//!
//! where f, u and w are corrected for the effects. Residuals of neighbouring moves share the error of a rest's mean;
//! their covariance is whitened in `whiten`. The random walk of the attitude error within a move is whitened by its
//! innovations in `inside`. The weights depend on the result, and the result depends on the weights, so both are
//! iterated until they settle.

mod encoders;
mod fields;
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
pub use terms::{EffectChoice, UserField};

pub(crate) use encoders::{Encoders, StandModel, mount_rotation};
pub(crate) use fields::{Field, move_segments};
pub(crate) use lanes::Lanes;
pub(crate) use linear::{INSIDE, Insides, Line, Linear, STAND_MOVES, STAND_RESTS, Source};
pub use misfit::Misfit;
pub(crate) use misfit::Misfits;
pub(crate) use model::Model;
pub(crate) use outliers::{Item, outliers};
pub(crate) use pass::BLOCK_S;
pub(crate) use pass::segments::MoveSegments;
pub(crate) use prepared::Prepared;
pub(crate) use problem::Joint;
pub(crate) use problem::report::JointFit;
pub use problem::report::{ResidualScales, TermEstimate};
pub use start::WarmStart;
pub(crate) use start::start_model;
pub(crate) use terms::{Kinds, Term, Terms};
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
use start::Prior;
use weights::Weights;

/// An effect is determined if ten times its typical size changes chi2 by at least one in every direction of its
/// parameters.
const LEAST_CHANGE: f64 = 0.1;
/// Limit for effects that may be determined in part: a hundred times the typical size in the best determined direction.
pub(crate) const LEAST_CHANGE_PARTLY: f64 = 0.01;
/// Initial width of the prior of a partly determined effect, in typical sizes of the effect.
const WIDE: f64 = 100.0;
/// The weights have settled if no parameter changes by more than this share of its standard deviation between two
/// rounds.
const SETTLED: f64 = 1e-3;
const MAX_ROUNDS: usize = 8;
/// Start residuals above `MISLEADING` times their noise give misleading weights. The weights are then updated until
/// each changes by a factor below `FAR`.
const MISLEADING: f64 = 10.0;
const FAR: f64 = 1.5;
/// Relative tolerance of fits in a search, which only need a new linearisation.
const SEARCH: f64 = 1e-5;
/// Start values of a time constant, as shares of the duration of the recording.
pub(crate) const SHAPE_SHARES: [f64; 4] = [0.03, 0.1, 0.3, 1.0];

/// Effects of angular acceleration that rotate with the unit, so that their sum from rest to rest is not zero.
const OBSERVABLE_AT_RESTS: [&str; 1] = ["gyro_angular_acceleration"];

/// Whether an effect is not observable in hand-held recordings: it appears only in the specific force within moves, and
/// the hand adds an unknown force there.
pub(crate) fn is_unobservable_hand_held(name: &str) -> bool {
    let effect = Effect::<f64>::find(name);
    effect.is_some_and(|e| e.needs.contains(&Need::AngularAcceleration)) && !OBSERVABLE_AT_RESTS.contains(&name)
}

/// Estimates all parameters. The fit starts from the warm start if its effects match, otherwise from the two triads
/// with zero effects.
pub(crate) fn fit(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    triads: [&Triad<f64>; 2],
    warm_start: Option<&WarmStart>,
) -> Result<JointFit, Error> {
    check_columns(prepared, terms)?;
    let mut parameters = start::start(prepared, terms, triads, warm_start).parameters();
    let mut problem = Joint::new(prepared, terms, &parameters)?;
    let mut iterations = 0;
    begin(&mut problem, terms, &parameters, |term| term.partly.then_some(WIDE))?;
    choose_shapes(&mut problem, terms, &mut parameters)?;
    for round in 0..MAX_ROUNDS {
        // The weights of the first round are preliminary, so a coarse fit suffices.
        let tolerance = if round == 0 { SEARCH } else { lsq::EXACT };
        let mut found = minimize(&problem, &parameters, tolerance)?;
        iterations += found.iterations;
        let settled = !problem.widen(&found) && round > 0 && largest_move(&parameters, &found) < SETTLED;
        if settled || round + 1 == MAX_ROUNDS {
            // The reported result is linearised from the samples at the result itself.
            if problem.refresh(&found.parameters)? {
                found = minimize(&problem, &found.parameters, lsq::EXACT)?;
                iterations += found.iterations;
            }
            return JointFit::new(&problem, terms, found, (iterations, settled));
        }
        parameters.clone_from(&found.parameters);
        problem.weigh_by(&found)?;
    }
    Err(Error::Fit("the joint fit made no step".into()))
}

/// As [`fit`] from a warm start, to a relative tolerance of 1e-5, for a search. The weights are updated only if those
/// of the start were misleading. Returns the linearisation at the result. `width` gives the prior width of an effect
/// that the recordings determine only in part.
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
    // Residuals that the start does not explain, such as a misaligned stand or a very large effect, are strongly
    // down-weighted.
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
    let found = lsq::minimize(problem, start, tolerance)?;
    if found.termination == Termination::NotFinite {
        return Err(Error::Fit("the joint fit left the range of numbers: leave effects out, or check units".into()));
    }
    Ok(found)
}

/// Directions of gravity and rotations of moves, predicted by a known model.
pub(crate) fn predict(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    model: &Model,
) -> Result<Vec<(Ends, Matrix3<f64>)>, Error> {
    let parameters = model.parameters();
    let linear = prepared.linearise(terms, &parameters)?;
    let weights = Weights::of(prepared, terms, &linear, None);
    Ok(moves_of(&linear, &weights))
}

/// Returns an error for undetermined effects, gives partly determined effects a prior of `width`, and sets the weights
/// so that the residuals at the start are consistent with their standard deviations.
///
/// With the weights of noise alone, unexplained residuals at the start can drive an effect far from its true value: a
/// g-sensitivity with equal diagonal entries rotates the unit about gravity, which moves do not observe, and at a high
/// rate this rotation averages out all other errors.
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

/// The largest change of a parameter, in units of its standard deviation.
fn largest_move(before: &[f64], found: &Solution) -> f64 {
    let covariance = lsq::covariance(&found.jacobian);
    let change = |p: usize| (found.parameters[p] - before[p]).abs() / covariance[(p, p)].sqrt();
    (0..before.len()).map(change).fold(0.0, f64::max)
}

/// Returns an error if a recording lacks a column that an effect depends on.
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
                "{} needs the heading, which is not known from one recording to the next: give one recording",
                term.name()
            )));
        }
        if needs(Need::Attitude)
            && let Some(lost) = prepared.heading_lost()
        {
            return Err(Error::Input(format!(
                "{} needs the heading, which is lost at {:.2} s, where a move is left out: mend that move, or leave the effect out",
                term.name(),
                prepared.rests[lost].rest.start_s
            )));
        }
    }
    Ok(())
}

/// Returns an error with the text of the catalogue if the recordings do not determine an effect. Where `width` allows
/// it, an effect that is determined in some directions gets a prior instead.
fn check_determined(
    jacobian: &Mat<f64>,
    terms: &Terms<'_>,
    width: impl Fn(&Term<'_>) -> Option<f64>,
) -> Result<Vec<Prior>, Error> {
    let mut priors = Vec::new();
    // A prior this wide barely shrinks observable directions, so the exact threshold of observability has no effect on
    // the result.
    for term in &terms.all {
        // While an effect is zero, its time constant has no derivative; columns of zeros are left out, so that other
        // effects do not take their place.
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
        "{open} of {} directions of {} are not determined by these recordings: ten times its typical size would not be seen",
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

/// Tries several time constants with the linear parameters free, and keeps the one with the smallest chi2.
fn choose_shapes(problem: &mut Joint<'_>, terms: &Terms<'_>, parameters: &mut Vec<f64>) -> Result<(), Error> {
    for term in terms.all.iter().filter(|term| term.has_shape()) {
        let place = BASE + term.first + term.linear;
        let longest_s = problem.prepared.longest_s();
        let mut best: Option<(f64, Vec<f64>)> = None;
        for share in SHAPE_SHARES {
            let mut start = parameters.clone();
            start[place] = share * longest_s;
            problem.fixed = vec![place];
            let found = lsq::minimize(&*problem, &start, lsq::ROUGH)?;
            if best.as_ref().is_none_or(|(chi2, _)| found.chi2 < *chi2) {
                best = Some((found.chi2, found.parameters));
            }
        }
        problem.fixed.clear();
        if let Some((_, found)) = best {
            *parameters = found;
        }
    }
    Ok(())
}
