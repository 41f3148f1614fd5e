//! All columns that hypotheses are made of, linearised at one model.

use std::iter::once;
use std::ops::Range;
use std::rc::Rc;

use faer::Mat;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::evidence::{Column, Gram, Known};
use super::generic::{Block, Hypothesis, Kernel, Moment, Moments, hypotheses};
use super::predict::Held;
use crate::error::Error;
use crate::joint::{BASE, Field, Joint, Kinds, Linear, Model, Prepared, Source, Terms, Way, ways};

/// One effect in the design.
pub(crate) struct Candidate {
    pub(crate) name: String,
    /// Its columns in the sums.
    pub(crate) columns: Range<usize>,
    /// Typical size of each parameter.
    pub(crate) typical: Vec<f64>,
    /// The time constant that its columns are for.
    pub(crate) shape: Option<f64>,
}

/// A generic hypothesis beside the model.
pub(crate) struct Generic {
    pub(crate) block: Block,
    pub(crate) kernel: Kernel,
    pub(crate) typical: f64,
    /// The sums of the model's columns, then its own, then the residual.
    pub(crate) gram: Gram,
    /// Its own columns in them.
    pub(crate) columns: Range<usize>,
    /// Each rest, or the rest before each move, and what the columns are there.
    pub(crate) shares: Vec<(usize, Vec<Vector3<f64>>)>,
}

/// Columns of one linearisation.
pub(crate) struct Design {
    pub(crate) gram: Gram,
    /// Columns of the model that is there: base, its effects, the stand.
    pub(crate) model: Vec<Column>,
    pub(crate) candidates: Vec<Candidate>,
    pub(crate) generics: Vec<Generic>,
    /// All columns, the residual last.
    pub(crate) columns: Mat<f64>,
    /// The group of each row, and the rest or move that it is about.
    groups: Vec<usize>,
    items: Vec<usize>,
}

/// Columns at a model: `own` are its effects with the precisions of their priors, `all` these and the candidates beside
/// them, with their values.
pub(crate) fn design(
    prepared: &Prepared<'_>,
    (own, precisions): (&Terms<'_>, &[f64]),
    (all, values): (&Terms<'_>, &[f64]),
    model: &Model,
    with_generics: bool,
) -> Result<Design, Error> {
    let parameters = model.parameters();
    // One pass serves all: the columns of the candidates are those of the corrected state.
    let full: Vec<f64> =
        parameters[..BASE].iter().chain(values).chain(&parameters[BASE + own.count..]).copied().collect();
    let linear = Rc::new(prepared.linearise(all, &full)?);
    let problem = Joint::of_noise(prepared, all, Rc::clone(&linear))?;
    let (residual, jacobian) = problem.whiten(&linear);
    let place_in_all = |name: &str| all.all.iter().find(|term| term.name() == name).map_or(0, |term| term.first);
    let of_own = own.all.iter().map(|term| {
        let first = BASE + place_in_all(term.name());
        first..first + term.count()
    });
    let mut parts: Vec<_> = once(0..BASE).chain(of_own).chain(once(BASE + all.count..full.len())).collect();
    let mut width = parameters.len();
    let mut candidates = Vec::new();
    for term in all.all.iter().filter(|term| !own.all.iter().any(|own| own.name() == term.name())) {
        parts.push(BASE + term.first..BASE + term.first + term.linear);
        candidates.push(Candidate {
            name: term.name().to_owned(),
            columns: width..width + term.linear,
            typical: term.typical()[..term.linear].to_vec(),
            shape: term.frozen_shape(),
        });
        width += term.linear;
    }
    let (groups, items) = (linear.groups_of_rows(), items_of_rows(prepared, &linear, own.kinds));
    let mut columns = Mat::zeros(residual.nrows(), width + 1);
    for (to, from) in parts.into_iter().flatten().enumerate() {
        columns.col_as_slice_mut(to).copy_from_slice(jacobian.col_as_slice(from));
    }
    columns.col_as_slice_mut(width).copy_from_slice(residual.col_as_slice(0));
    let known = Known::new(&columns, &groups);
    let generics =
        if with_generics { generics(prepared, &problem, &linear, parameters.len(), &known)? } else { Vec::new() };
    let model = (0..parameters.len())
        .map(|p| {
            let effect = p.checked_sub(BASE).filter(|p| *p < own.count);
            let precision = effect.map_or(0.0, |p| precisions[p]);
            Column { place: p, precision, value: if effect.is_some() { parameters[p] } else { 0.0 } }
        })
        .collect();
    Ok(Design { gram: known.alone(), model, candidates, generics, columns, groups, items })
}

impl Design {
    /// Its residuals, to be predicted item by item.
    pub(crate) fn held(&self) -> Held<'_> {
        Held { columns: &self.columns, gram: &self.gram, groups: &self.groups, items: &self.items }
    }
}

/// The rest or move that each row of the whitened residuals is about, in order of time: even numbers are rests.
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

/// Of the blocks inside a move one in so many is enough for what changes slowly.
const EVERY: usize = 5;

/// Generic hypotheses beside `count` columns that are known.
fn generics(
    prepared: &Prepared<'_>,
    problem: &Joint<'_>,
    linear: &Linear,
    count: usize,
    known: &Known,
) -> Result<Vec<Generic>, Error> {
    let inside = linear.sees_inside();
    let ways = ways(prepared, &linear.model, if inside { 1 } else { EVERY })?;
    let moments = moments(prepared, linear, &ways);
    let of_hypothesis = |hypothesis: Hypothesis| {
        let at = |moment: &Moment| hypothesis.columns(moment);
        let mut rests = vec![Vec::new(); prepared.rests.len()];
        for (k, moment) in &moments.rests {
            rests[*k] = at(moment);
        }
        let width = moments.rests.first().map_or(0, |(_, moment)| at(moment).len());
        let moves = moments.moves.iter().map(|way| way.iter().map(at).collect()).collect();
        let field = Field { sensor: hypothesis.block.sensor(), width, rests, moves };
        let own = problem.by_field(linear, &ways, &field);
        let shares = if hypothesis.is_of_moves() {
            let middle = |(m, way): (usize, &Vec<Moment>)| {
                Some((prepared.moves[m].from, hypothesis.shares(way.get(way.len() / 2)?)))
            };
            moments.moves.iter().enumerate().filter_map(middle).collect()
        } else {
            moments.rests.iter().map(|(k, moment)| (*k, hypothesis.shares(moment))).collect()
        };
        Generic {
            block: hypothesis.block,
            kernel: hypothesis.kernel,
            typical: hypothesis.typical(),
            gram: known.with(&own),
            columns: count..count + width,
            shares,
        }
    };
    Ok(hypotheses(&moments, inside, prepared.gravity_mps2).into_iter().map(of_hypothesis).collect())
}

/// What the kernels need to know of the rests that take part and of the moves between them.
fn moments(prepared: &Prepared<'_>, linear: &Linear, ways: &[Way]) -> Moments {
    let mut attitude = UnitQuaternion::identity();
    let mut arrived: Vec<Option<(UnitQuaternion<f64>, Vector3<f64>)>> = vec![None; prepared.rests.len()];
    let mut moves = Vec::with_capacity(ways.len());
    for ((m, at_move), way) in prepared.moves.iter().zip(linear.moves.iter()).zip(ways) {
        let quaternion = |m: &_| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*m));
        let whole = quaternion(&at_move.pass.rotation);
        let (start, turn) = (arrived[m.from].map_or(attitude, |(attitude, _)| attitude), whole.scaled_axis());
        let recording = &prepared.recordings[m.recording];
        let rate_and_time = |k: usize| (way.stretches[k].rate, way.stretches[k].time_s);
        let moment = |k: usize| {
            let stretch = &way.stretches[k];
            let here = quaternion(&stretch.attitude);
            let ((w0, t0), (w1, t1)) =
                (rate_and_time(k.saturating_sub(1)), rate_and_time((k + 1).min(way.stretches.len() - 1)));
            Moment {
                recording: m.recording,
                time_s: stretch.time_s,
                up: here.inverse() * at_move.before.up,
                ahead: (start * here).inverse() * Vector3::x(),
                temperature_degc: recording.temperature_degc.map(|t| t[stretch.sample]),
                turn,
                rate: stretch.rate,
                acceleration: if t1 > t0 { (w1 - w0) / (t1 - t0) } else { Vector3::zeros() },
            }
        };
        moves.push((0..way.stretches.len()).map(moment).collect());
        attitude = start * whole;
        arrived[m.to] = Some((attitude, turn));
    }
    let at_rest = |k: usize, up: &Vector3<f64>| {
        let rest = &prepared.rests[k];
        let recording = &prepared.recordings[rest.recording];
        let (attitude, turn) = arrived[k].unwrap_or((UnitQuaternion::identity(), Vector3::zeros()));
        let range = rest.rest.first..rest.rest.end;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        Moment {
            recording: rest.recording,
            time_s: f64::midpoint(rest.rest.start_s, rest.rest.end_s) - recording.time_s[0],
            up: *up,
            ahead: attitude.inverse() * Vector3::x(),
            temperature_degc: recording.temperature_degc.map(|t| mean(&t[range])),
            turn,
            rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
        }
    };
    Moments { rests: linear.directions().map(|(k, up)| (k, at_rest(k, up))).collect(), moves }
}
