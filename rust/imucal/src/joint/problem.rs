//! The residuals of the joint fit and their derivatives.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use faer::Mat;
use imucal_core::effects::{Need, Sensor, Surroundings};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::attitude;
use super::encoders::{self, EncoderMove, Encoders, StandModel};
use super::inside::{self, EndDirection};
use super::model::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY, Model, force_by_parameters, moments};
use super::pass::{Pass, Route};
use super::terms::{Kinds, Term, Terms};
use super::wander::{UnitWander, Wandering};
use super::weights::Weights;
use crate::error::Error;
use crate::lsq::{Residuals, Solution};
use crate::moves::{End, Ends, Move, UnitRest};
use crate::recording::Recording;
use crate::segment::NoiseDensity;

/// What the fit is made of.
pub(crate) struct Prepared<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// Which rests take part.
    pub(crate) used: &'a [bool],
    pub(crate) moves: &'a [Move],
    /// Before and after each move.
    pub(crate) ends: &'a [[End; 2]],
    pub(crate) noise: &'a [NoiseDensity],
    pub(crate) gravity_mps2: f64,
    /// How the biases wander, if that is known.
    pub(crate) wander: Option<UnitWander>,
    /// Where an effect of the encoders is to be estimated.
    pub(crate) encoders: Option<Encoders>,
}

/// A rest at given parameters.
pub(crate) struct AtRest {
    pub(crate) force: Vector3<f64>,
    /// Derivative of the force by every parameter.
    force_jacobian: Vec<Vector3<f64>>,
    /// Derivative of the force by the accelerometer's mean.
    by_mean: Matrix3<f64>,
    /// What the effects add to the rate, and their columns.
    on_rate: Vector3<f64>,
    columns: Vec<Vector3<f64>>,
}

/// A residual, its derivatives by the parameters and by the means of the rests.
#[derive(Clone)]
pub(crate) struct Line {
    pub(crate) residual: f64,
    pub(crate) jacobian: Vec<f64>,
    pub(crate) by_means: Vec<(usize, Vector3<f64>)>,
    pub(crate) source: Source,
}

impl Line {
    /// Of the residual, for a small change of the parameters.
    fn change(&self, change: &[f64]) -> f64 {
        self.jacobian.iter().zip(change).map(|(by, change)| by * change).sum()
    }
}

/// What a line is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    Norm(usize),
    Move(usize),
}

/// One move at given parameters.
pub(crate) struct AtMove {
    pub(crate) pass: Pass,
    pub(crate) before: EndDirection,
    pub(crate) after: EndDirection,
}

/// All residuals at given parameters, not whitened.
#[derive(Clone)]
pub(crate) struct Linear {
    pub(crate) model: Model,
    pub(crate) lines: Vec<Line>,
    /// Three for each rest that takes part: seen minus predicted mean rate, raw units, axis by axis.
    pub(crate) rates: Vec<(usize, [Line; 3])>,
    pub(crate) moves: Rc<Vec<AtMove>>,
    /// Direction of gravity at the rests that take part.
    directions: Vec<(usize, EndDirection)>,
    kinds: Kinds,
}

/// Rows of the whitened residuals beyond the lines and the rates.
pub(crate) struct Groups {
    pub(crate) inside: Range<usize>,
    pub(crate) stand_rests: Range<usize>,
    pub(crate) stand_moves: Range<usize>,
}

impl Linear {
    /// Index and direction of gravity of the rests that take part.
    pub(crate) fn directions(&self) -> impl Iterator<Item = (usize, &Vector3<f64>)> {
        self.directions.iter().map(|(k, direction)| (*k, &direction.up))
    }

    /// The residuals after a small change of the parameters; all else stays.
    fn moved(&self, change: &[f64], model: Model) -> Self {
        let mut moved = Self { model, ..self.clone() };
        for line in moved.lines.iter_mut().chain(moved.rates.iter_mut().flat_map(|(_, lines)| lines)) {
            line.residual += line.change(change);
        }
        moved
    }

    pub(crate) fn groups(&self) -> Groups {
        let start = self.lines.len() + 3 * self.rates.len();
        let inside: usize =
            if self.kinds.in_motion { self.moves.iter().map(|m| inside::count(&m.pass)).sum() } else { 0 };
        let rests = if self.kinds.encoders { 2 * self.directions.len() } else { 0 };
        let count = |m: &AtMove| encoders::count(&m.pass, !self.kinds.in_motion);
        let moves: usize = if self.kinds.encoders { self.moves.iter().map(count).sum() } else { 0 };
        let (a, b, c) = (start + inside, start + inside + rests, start + inside + rests + moves);
        Groups { inside: start..a, stand_rests: a..b, stand_moves: b..c }
    }

    /// The group that each row of the whitened residuals belongs to: norms, moves, rates x, y and z, inside the moves,
    /// rests and moves against the stand.
    pub(crate) fn groups_of_rows(&self) -> Vec<usize> {
        let groups = self.groups();
        let lines = self.lines.iter().map(|line| usize::from(matches!(line.source, Source::Move(_))));
        let rates = (0..3 * self.rates.len()).map(|row| 2 + row % 3);
        let rest = [(INSIDE, groups.inside), (6, groups.stand_rests), (7, groups.stand_moves)];
        let rest = rest.into_iter().flat_map(|(group, range)| range.map(move |_| group));
        lines.chain(rates).chain(rest).collect()
    }
}

/// Within so many standard deviations of a linearisation the residuals follow their derivatives: what is left out is of second
/// order in the parameters' errors, a part in 10^8 of a standard deviation for those of a good sensor.
const NEAR: f64 = 0.01;

/// The group of the residuals inside the moves.
pub(crate) const INSIDE: usize = 5;

/// The joint problem.
pub(crate) struct Joint<'a> {
    pub(crate) prepared: &'a Prepared<'a>,
    terms: &'a Terms<'a>,
    pub(crate) weights: Weights,
    wandering: Option<Wandering>,
    /// Parameters that stay where they start.
    pub(crate) fixed: Vec<usize>,
    /// The last linearisation, which took a pass over the samples.
    last: RefCell<Place>,
    /// What was made of it nearby.
    near: RefCell<Place>,
    rows: usize,
}

/// A linearisation and its parameters.
#[derive(Clone)]
struct Place {
    parameters: Vec<f64>,
    linear: Rc<Linear>,
}

impl<'a> Joint<'a> {
    pub(crate) fn new(prepared: &'a Prepared<'a>, terms: &'a Terms<'a>, parameters: &[f64]) -> Result<Self, Error> {
        Self::at(prepared, terms, parameters, Rc::new(prepared.linearise(terms, parameters)?))
    }

    /// As [`new`](Self::new), where the linearisation is there already.
    pub(crate) fn at(
        prepared: &'a Prepared<'a>,
        terms: &'a Terms<'a>,
        parameters: &[f64],
        linear: Rc<Linear>,
    ) -> Result<Self, Error> {
        let weights = Weights::of(prepared, terms, &linear, None);
        let rows = linear.groups().stand_moves.end;
        let place = Place { parameters: parameters.to_vec(), linear: Rc::clone(&linear) };
        let (last, near) = (RefCell::new(place.clone()), RefCell::new(place));
        let mut joint = Self { prepared, terms, weights, wandering: None, fixed: Vec::new(), last, near, rows };
        joint.let_biases_wander(&linear)?;
        Ok(joint)
    }

    fn let_biases_wander(&mut self, linear: &Linear) -> Result<(), Error> {
        self.wandering = None;
        if let Some(unit) = &self.prepared.wander {
            self.wandering = Some(Wandering::new(self, linear, unit)?);
        }
        Ok(())
    }

    /// The linearisation at these parameters, or what the last one makes of them if it is near.
    pub(crate) fn linear(&self, parameters: &[f64]) -> Result<Rc<Linear>, Error> {
        for place in [&self.last, &self.near] {
            if place.borrow().parameters == parameters {
                return Ok(Rc::clone(&place.borrow().linear));
            }
        }
        let Some(moved) = self.moved(parameters)? else { return self.linear_anew(parameters) };
        let linear = Rc::new(moved);
        *self.near.borrow_mut() = Place { parameters: parameters.to_vec(), linear: Rc::clone(&linear) };
        Ok(linear)
    }

    /// The linearisation at these parameters.
    fn linear_anew(&self, parameters: &[f64]) -> Result<Rc<Linear>, Error> {
        let linear = Rc::new(self.prepared.linearise(self.terms, parameters)?);
        *self.last.borrow_mut() = Place { parameters: parameters.to_vec(), linear: Rc::clone(&linear) };
        Ok(linear)
    }

    /// Linearises at these parameters if only a linearisation nearby is known; says whether that was so.
    pub(crate) fn refresh(&self, parameters: &[f64]) -> Result<bool, Error> {
        let is_moved = self.last.borrow().parameters != parameters && self.moved(parameters)?.is_some();
        if is_moved {
            self.linear_anew(parameters)?;
        }
        Ok(is_moved)
    }

    /// What the last linearisation makes of these parameters, if they are near and all residuals are lines.
    ///
    /// A time constant has no derivative where there is no effect yet, so that how far it goes is not seen.
    fn moved(&self, parameters: &[f64]) -> Result<Option<Linear>, Error> {
        let Place { parameters: from, linear } = &*self.last.borrow();
        let Kinds { in_motion, encoders } = self.terms.kinds;
        if in_motion || encoders || self.terms.all.iter().any(Term::has_shape) {
            return Ok(None);
        }
        let change: Vec<f64> = parameters.iter().zip(from).map(|(to, from)| to - from).collect();
        let mut lines = Mat::from_fn(linear.lines.len(), 1, |row, _| linear.lines[row].change(&change));
        self.weights.whitening.apply(&mut lines);
        let rates = linear.rates.iter().map(|(rest, rates)| {
            let change = Vector3::from_fn(|axis, _| rates[axis].change(&change));
            (self.weights.rates[*rest] * change).norm_squared()
        });
        let is_near = lines.squared_norm_l2() + rates.sum::<f64>() < NEAR * NEAR;
        is_near.then(|| Ok(linear.moved(&change, Model::of(parameters, self.terms)?))).transpose()
    }

    /// Takes the weights that a fit leaves.
    pub(crate) fn weigh_by(&mut self, found: &Solution) -> Result<(), Error> {
        let linear = self.linear(&found.parameters)?;
        self.weights = Weights::of(self.prepared, self.terms, &linear, Some((found, &self.weights.scales)));
        self.let_biases_wander(&linear)
    }

    /// Takes the weights of noise alone.
    pub(crate) fn weigh_by_noise(&mut self, linear: &Linear) -> Result<(), Error> {
        self.weights = Weights::of_noise(self.prepared, self.terms, linear);
        self.let_biases_wander(linear)
    }

    /// Raw units per SI unit of a sensor.
    pub(crate) fn raw_scale(&self, sensor: Sensor, parameters: &[f64]) -> f64 {
        let entries = if sensor == Sensor::Gyroscope { &parameters[GYRO_SENSITIVITY] } else { &parameters[3..6] };
        (entries.iter().map(|e| e * e).sum::<f64>() / 3.0).sqrt()
    }

    /// Whitened derivatives by a bias of its own at each rest, three columns for each: of the gyroscope and of the
    /// accelerometer. A move has the mean of the gyroscope's bias at its two rests. Rows of lines and rates only.
    pub(crate) fn by_biases_of_rests(&self, linear: &Linear) -> [Mat<f64>; 2] {
        let (head, count) = (linear.lines.len(), 3 * self.prepared.rests.len());
        let (mut gyroscope, mut accelerometer) = (Mat::zeros(head, count), Mat::zeros(head, count));
        for (row, line) in linear.lines.iter().enumerate() {
            for (rest, by) in &line.by_means {
                for axis in 0..3 {
                    accelerometer[(row, 3 * rest + axis)] = -by[axis];
                }
            }
            if let Source::Move(k) = line.source {
                let m = &self.prepared.moves[k];
                for (rest, axis) in [m.from, m.to].into_iter().flat_map(|rest| (0..3).map(move |axis| (rest, axis))) {
                    gyroscope[(row, 3 * rest + axis)] += line.jacobian[GYRO_BIAS.start + axis] / 2.0;
                }
            }
        }
        let whole = |mut lines: Mat<f64>| {
            self.weights.whitening.apply(&mut lines);
            let mut all = Mat::zeros(self.rows, count);
            all.as_mut().subrows_mut(0, head).copy_from(&lines);
            all
        };
        let (mut gyroscope, accelerometer) = (whole(gyroscope), whole(accelerometer));
        for (k, (rest, _)) in linear.rates.iter().enumerate() {
            for (row, axis) in (0..3).flat_map(|row| (0..=row).map(move |axis| (row, axis))) {
                gyroscope[(head + 3 * k + row, 3 * rest + axis)] = -self.weights.rates[*rest][(row, axis)];
            }
        }
        [gyroscope, accelerometer]
    }

    /// What whitening makes of an error of one in each line and each rate: the first row, and the values from there on.
    pub(crate) fn whitened_units(&self, linear: &Linear) -> Vec<(usize, Vec<f64>)> {
        let head = linear.lines.len();
        let lines = (0..head).map(|row| (row, self.weights.whitening.unit(row)));
        let rates = linear.rates.iter().enumerate().flat_map(|(place, (k, _))| {
            let column = |axis: usize| self.weights.rates[*k].column(axis).iter().skip(axis).copied().collect();
            [0, 1, 2].map(|axis| (head + 3 * place + axis, column(axis)))
        });
        let white = |(first, column): (usize, Vec<f64>)| match &self.wandering {
            None => (first, column),
            Some(wandering) => (first, wandering.unit(first, &column)),
        };
        lines.chain(rates).map(white).collect()
    }

    /// Whitened residuals and Jacobian: first the lines, then the rates, then what is inside the moves.
    pub(crate) fn whitened(&self, parameters: &[f64]) -> Result<(Mat<f64>, Mat<f64>), Error> {
        Ok(self.whiten(&*self.linear(parameters)?))
    }

    /// As [`whitened`](Self::whitened), of a linearisation that is there.
    pub(crate) fn whiten(&self, linear: &Linear) -> (Mat<f64>, Mat<f64>) {
        let n = self.terms.total();
        let head = linear.lines.len();
        let mut lines = Mat::from_fn(head, n + 1, |i, p| {
            let line = &linear.lines[i];
            if p < n { line.jacobian[p] } else { line.residual }
        });
        self.weights.whitening.apply(&mut lines);
        let mut all = Mat::zeros(self.rows, n + 1);
        all.as_mut().subrows_mut(0, head).copy_from(&lines);
        let mut row = head;
        for (rest, rates) in &linear.rates {
            let whitening = &self.weights.rates[*rest];
            for p in 0..=n {
                let at = |line: &Line| if p < n { line.jacobian[p] } else { line.residual };
                let white = whitening * Vector3::from_fn(|axis, _| at(&rates[axis]));
                (0..3).for_each(|axis| all[(row + axis, p)] = white[axis]);
            }
            row += 3;
        }
        if let Some(wandering) = &self.wandering {
            wandering.apply(&mut all);
        }
        if self.terms.kinds.in_motion {
            for (k, m) in linear.moves.iter().enumerate() {
                let noise = &self.weights.inside[k];
                inside::innovations(&m.pass, &m.before, &m.after, noise, self.prepared.gravity_mps2, |z| {
                    for (p, value) in z.iter().enumerate() {
                        all[(row, p)] = *value;
                    }
                    row += 1;
                });
            }
        }
        if let Some(encoders) = self.prepared.encoders.as_ref().filter(|_| self.terms.kinds.encoders) {
            self.stand_rows(encoders, linear, |z, sigma| {
                for (p, value) in z.iter().enumerate() {
                    all[(row, p)] = *value / sigma;
                }
                row += 1;
            });
        }
        for &p in &self.fixed {
            all.col_mut(p).fill(0.0);
        }
        (all.subcols(n, 1).to_owned(), all.subcols(0, n).to_owned())
    }
}

impl Joint<'_> {
    /// Residuals against the stand; `push` takes each with its standard deviation.
    fn stand_rows(&self, encoders: &Encoders, linear: &Linear, mut push: impl FnMut(&[f64], f64)) {
        let (prepared, terms, model) = (self.prepared, self.terms, &linear.model);
        let stand = StandModel::of(&model.stand);
        for (k, direction) in &linear.directions {
            let angles = encoders.at_rest(*k, &prepared.rests[*k], &model.values, terms);
            for z in encoders::rest_rows(&angles, terms, &stand, direction) {
                push(&z, self.weights.stand_sigma_rad);
            }
        }
        for ((m, at_move), noise) in prepared.moves.iter().zip(linear.moves.iter()).zip(&self.weights.encoders) {
            let angles = encoders.in_move(&prepared.recordings[m.recording], m, &model.values, terms);
            let rest = encoders.at_rest(m.from, &prepared.rests[m.from], &model.values, terms);
            let seen = EncoderMove { span: m, angles: &angles, rest: &rest, stand: &stand };
            let ends = [&at_move.before, &at_move.after];
            seen.innovations(&at_move.pass, terms, ends, noise, |z| push(z, 1.0));
        }
    }
}

impl Residuals for Joint<'_> {
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        match self.whitened(parameters) {
            Ok((r, j)) => (*residuals, *jacobian) = (r, j),
            Err(_) => residuals.fill(f64::NAN), // the solver takes a shorter step
        }
    }

    fn count(&self) -> usize {
        self.rows
    }
}

impl Prepared<'_> {
    /// Residuals and derivatives at these parameters.
    pub(crate) fn linearise(&self, terms: &Terms<'_>, parameters: &[f64]) -> Result<Linear, Error> {
        let model = Model::of(parameters, terms)?;
        let with_attitude = terms.needs(Need::Attitude);
        let mut rests: Vec<Option<AtRest>> = (0..self.rests.len()).map(|_| None).collect();
        let mut attitudes: Vec<Option<UnitQuaternion<f64>>> = vec![None; self.rests.len()];
        let mut moves: Vec<AtMove> = Vec::with_capacity(self.moves.len());
        let mut next_move = 0;
        for k in (0..self.rests.len()).filter(|&k| self.used[k]) {
            let mean = self.rests[k].rest.specific_force.mean;
            let mut at_rest = self.at_rest(k, &mean, attitudes[k], &model, terms);
            if with_attitude && attitudes[k].is_none() {
                attitudes[k] = Some(attitude::first(&at_rest.force.normalize()));
                at_rest = self.at_rest(k, &mean, attitudes[k], &model, terms);
            }
            while let Some(m) = self.moves.get(next_move).filter(|m| m.from == k) {
                let ends = &self.ends[next_move];
                let route = Route {
                    recording: &self.recordings[m.recording],
                    span: m,
                    rotation_world_from_start: attitudes[k],
                    with_blocks: terms.kinds.in_motion || terms.kinds.encoders,
                };
                let pass = route.pass(&model, terms);
                let direction =
                    |rest: usize, end: &End| self.at_rest(rest, &end.raw, attitudes[k], &model, terms).direction();
                let (before, after) = (direction(k, &ends[0]), direction(m.to, &ends[1]));
                attitudes[m.to] = attitudes[k].map(|start| attitude::after(&start, &pass.rotation, &after.up));
                moves.push(AtMove { pass, before, after });
                next_move += 1;
            }
            rests[k] = Some(at_rest);
        }
        Ok(self.lines(model, terms, &rests, moves))
    }

    /// The unit at a rest, `reading` being the mean of its accelerometer.
    fn at_rest(
        &self,
        k: usize,
        reading: &Vector3<f64>,
        attitude: Option<UnitQuaternion<f64>>,
        model: &Model,
        terms: &Terms<'_>,
    ) -> AtRest {
        let UnitRest { recording, rest, .. } = &self.rests[k];
        let seen = model.accelerometer.correct(*reading);
        // Without effects nothing depends on them.
        let moments =
            if terms.count == 0 { Vec::new() } else { moments(&self.recordings[*recording], rest.first..rest.end) };
        let around: Vec<Surroundings<f64>> =
            moments.into_iter().map(|moment| Surroundings { rotation_world_from_body: attitude, ..moment }).collect();
        let mut columns = vec![Vector3::zeros(); terms.count];
        let (on_rate, force) =
            terms.at_rest(&model.values, seen, &around, *recording, rest.first..rest.end, &mut columns);
        let mut force_jacobian = vec![Vector3::zeros(); terms.total()];
        let by_parameters = force_by_parameters(&model.accelerometer, &seen);
        for p in ACCEL {
            force_jacobian[p] = by_parameters.column(p).into_owned();
        }
        for (p, column) in columns.iter().enumerate() {
            if terms.sensors[p] == Sensor::Accelerometer {
                force_jacobian[BASE + p] = -column;
            }
        }
        AtRest { force, force_jacobian, by_mean: *model.accelerometer.inverse(), on_rate, columns }
    }

    fn lines(&self, model: Model, terms: &Terms<'_>, rests: &[Option<AtRest>], moves: Vec<AtMove>) -> Linear {
        let n = terms.total();
        let mut directions = Vec::new();
        let (mut lines, mut rates) = (Vec::new(), Vec::new());
        let mut next_move = 0;
        for (k, at_rest) in rests.iter().enumerate() {
            let Some(at_rest) = at_rest else { continue };
            let up = at_rest.force.normalize();
            lines.push(Line {
                residual: at_rest.force.norm() - self.gravity_mps2,
                jacobian: at_rest.force_jacobian.iter().map(|column| up.dot(column)).collect(),
                by_means: vec![(k, at_rest.by_mean.tr_mul(&up))],
                source: Source::Norm(k),
            });
            while self.moves.get(next_move).is_some_and(|m| m.from == k) {
                if !terms.kinds.in_motion && !terms.kinds.encoders {
                    lines.extend(self.move_lines(next_move, &moves[next_move], rests));
                }
                next_move += 1;
            }
            directions.push((k, at_rest.direction()));
            rates.push((k, self.rate_lines(k, at_rest, &model, n, terms)));
        }
        Linear { model, lines, rates, moves: Rc::new(moves), directions, kinds: terms.kinds }
    }

    /// Components of the carried minus the measured direction, across the latter.
    fn move_lines(&self, index: usize, at_move: &AtMove, rests: &[Option<AtRest>]) -> [Line; 2] {
        let m = &self.moves[index];
        let AtMove { pass, before, after } = at_move;
        let carried = pass.rotation.tr_mul(&before.up);
        let across = Ends { before: before.up, after: after.up, sigma_rad: 1.0 }.across();
        let residual = across * (carried - after.up);
        let columns: Vec<_> = (0..before.jacobian.len())
            .map(|p| {
                let by_turn = pass.rotation.tr_mul(&before.up.cross(&pass.turn[p]));
                across * (by_turn + pass.rotation.tr_mul(&before.jacobian[p]) - after.jacobian[p])
            })
            .collect();
        let by_mean = |rest: usize, end: &End| -> Option<Matrix3<f64>> {
            let at_rest = rests[rest].as_ref().filter(|_| end.steady)?;
            let up = at_rest.force.normalize();
            Some((Matrix3::identity() - up * up.transpose()) * at_rest.by_mean / at_rest.force.norm())
        };
        let [end_before, end_after] = &self.ends[index];
        let from = by_mean(m.from, end_before).map(|by| (m.from, across * pass.rotation.transpose() * by));
        let to = by_mean(m.to, end_after).map(|by| (m.to, -across * by));
        [0, 1].map(|c| Line {
            residual: residual[c],
            jacobian: columns.iter().map(|column| column[c]).collect(),
            by_means: from.iter().chain(&to).map(|(rest, by)| (*rest, by.row(c).transpose())).collect(),
            source: Source::Move(index),
        })
    }

    fn rate_lines(&self, k: usize, at_rest: &AtRest, model: &Model, n: usize, terms: &Terms<'_>) -> [Line; 3] {
        let sensitivity = model.gyroscope.sensitivity();
        let seen = self.rests[k].rest.angular_rate.mean;
        let residual = seen - model.gyroscope.measure(at_rest.on_rate);
        [0, 1, 2].map(|axis| {
            let mut jacobian = vec![0.0; n];
            jacobian[GYRO_BIAS.start + axis] = -1.0;
            for j in 0..3 {
                jacobian[GYRO_SENSITIVITY.start + 3 * axis + j] = -at_rest.on_rate[j];
            }
            for (p, column) in at_rest.columns.iter().enumerate() {
                if terms.sensors[p] == Sensor::Gyroscope {
                    jacobian[BASE + p] = -sensitivity.row(axis).transpose().dot(column);
                }
            }
            Line { residual: residual[axis], jacobian, by_means: Vec::new(), source: Source::Norm(k) }
        })
    }
}

impl AtRest {
    /// Direction of gravity and its derivatives.
    fn direction(&self) -> EndDirection {
        let up = self.force.normalize();
        let across = (Matrix3::identity() - up * up.transpose()) / self.force.norm();
        EndDirection { up, jacobian: self.force_jacobian.iter().map(|column| across * column).collect() }
    }
}
