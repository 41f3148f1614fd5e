//! Whitened derivatives by fields that are no effects: a value at each rest and at each stretch of a move (model.md (24)).
//!
//! ```text
//! rest rates   -T Phi_k                      moves   E (R^T u) x turn(end)
//! rest norms   -u^T Phi_k                    inside  turn x f,  or -R Phi
//! turn(t) = -sum A Phi dt from the start of the move to t
//! ```

use faer::Mat;
use imucal_core::effects::Sensor;
use nalgebra::{Matrix2x3, Matrix3, Vector3};

use super::inside::{self, EndDirection};
use super::linear::{AtMove, Linear, Prepared, Source};
use super::model::GYRO_BIAS;
use super::pass::{Block, Pass, Route};
use super::problem::Joint;
use super::terms::{Kinds, Terms};
use crate::error::Error;
use crate::moves::{Move, rows_across};

/// A short stretch of a move.
pub(crate) struct Stretch {
    /// Since the first sample of the recording, s.
    pub(crate) time_s: f64,
    /// The sample in its middle.
    pub(crate) sample: usize,
    /// `v_start = attitude v_here`.
    pub(crate) attitude: Matrix3<f64>,
    pub(crate) rate: Vector3<f64>,
    /// What a constant error of the rate, of one about each axis, has turned until then.
    turn: Matrix3<f64>,
}

/// The stretches of a move, and what a constant error has turned at its end.
pub(crate) struct Way {
    pub(crate) stretches: Vec<Stretch>,
    end: Matrix3<f64>,
}

/// Columns of a field, SI units.
pub(crate) struct Field {
    pub(crate) sensor: Sensor,
    pub(crate) width: usize,
    /// By rest.
    pub(crate) rests: Vec<Vec<Vector3<f64>>>,
    /// By move, stretch by stretch.
    pub(crate) moves: Vec<Vec<Vec<Vector3<f64>>>>,
}

/// The way of each move at a linearisation without effects; of the blocks inside the moves only one in `every`.
pub(crate) fn ways(prepared: &Prepared<'_>, linear: &Linear, every: usize) -> Result<Vec<Way>, Error> {
    let kinds = Kinds { in_motion: false, encoders: false };
    let none = Terms::try_new(&[], &[], &[], kinds)?;
    let model = &linear.model;
    let sensitivity = *model.gyroscope.sensitivity();
    let by_rate = |turn: &[Vector3<f64>]| {
        Matrix3::from_columns(&[0, 1, 2].map(|axis| turn[GYRO_BIAS.start + axis])) * sensitivity
    };
    let way = |(span, at_move): (&Move, &AtMove)| {
        let recording = &prepared.recordings[span.recording];
        let gravity_at_start = at_move.before.up * prepared.gravity_mps2;
        let route = Route { recording, span, rotation_world_from_start: None, gravity_at_start, with_blocks: true };
        let own = (!linear.sees_inside()).then(|| route.pass(model, &none));
        let pass = own.as_ref().unwrap_or(&at_move.pass);
        let first = (every / 2).min(pass.blocks.len().saturating_sub(1));
        let stretch = |block: &Block| {
            let middle = usize::midpoint(block.samples.start, block.samples.end);
            let sample = (span.first + middle).min(span.last);
            let rows = recording.angular_rate.slice(span.first + block.samples.start..span.first + block.samples.end);
            let mean = rows.iter().map(Vector3::from).sum::<Vector3<f64>>() / rows.len().max(1) as f64;
            Stretch {
                time_s: recording.time_s[sample] - recording.time_s[0],
                sample,
                attitude: pass.attitudes[sample - span.first],
                rate: model.gyroscope.correct(mean),
                turn: by_rate(&block.turn),
            }
        };
        Way { stretches: pass.blocks[first..].iter().step_by(every).map(stretch).collect(), end: by_rate(&pass.turn) }
    };
    Ok(prepared.moves.iter().zip(linear.moves.iter()).map(way).collect())
}

impl Way {
    /// What a field has turned at each stretch, and at the end: it goes straight from one stretch to the next.
    fn turns(&self, columns: &[Vec<Vector3<f64>>], width: usize) -> Vec<Vec<Vector3<f64>>> {
        let mut sums = vec![Vector3::zeros(); width];
        let mut turns = Vec::with_capacity(self.stretches.len() + 1);
        let mut before = Matrix3::zeros();
        for (k, turn) in self.stretches.iter().map(|s| s.turn).chain([self.end]).enumerate() {
            let here = columns.get(k).or(columns.last());
            let last = k.checked_sub(1).and_then(|k| columns.get(k)).or(here);
            let more = turn - before;
            if let (Some(here), Some(last)) = (here, last) {
                for ((sum, here), last) in sums.iter_mut().zip(here).zip(last) {
                    *sum += more * ((here + last) * 0.5);
                }
            }
            turns.push(sums.clone());
            before = turn;
        }
        turns
    }
}

impl Joint<'_> {
    /// Whitened derivatives of all residuals but those against the stand by the columns of a field.
    pub(crate) fn by_field(&self, linear: &Linear, ways: &[Way], field: &Field) -> Mat<f64> {
        let (head, width) = (linear.lines.len(), field.width);
        let of_gyroscope = field.sensor == Sensor::Gyroscope;
        let raw = |columns: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            let triad = if of_gyroscope { &linear.model.gyroscope } else { &linear.model.accelerometer };
            columns.iter().map(|column| triad.sensitivity() * column).collect()
        };
        let at_rests: Vec<Vec<Vector3<f64>>> = field.rests.iter().map(|columns| raw(columns)).collect();
        let turns: Vec<Vec<Vec<Vector3<f64>>>> = ways
            .iter()
            .zip(&field.moves)
            .map(|(way, columns)| if of_gyroscope { way.turns(columns, width) } else { Vec::new() })
            .collect();
        let mut lines = Mat::zeros(head, width);
        let mut component = 0;
        for (row, line) in linear.lines.iter().enumerate() {
            if !of_gyroscope {
                for (rest, by) in &line.by_means {
                    for (c, column) in at_rests[*rest].iter().enumerate() {
                        lines[(row, c)] -= by.dot(column);
                    }
                }
            } else if let Source::Move(k) = line.source {
                let along = across(&linear.moves[k]).row(component).transpose();
                component = 1 - component;
                for (c, turn) in turns[k].last().into_iter().flatten().enumerate() {
                    lines[(row, c)] = along.dot(turn);
                }
            }
        }
        self.weights.whitening.apply(&mut lines);
        let mut all = Mat::zeros(self.rows(), width);
        all.as_mut().subrows_mut(0, head).copy_from(&lines);
        if of_gyroscope {
            for (place, (rest, _)) in linear.rates.iter().enumerate() {
                for (c, column) in at_rests[*rest].iter().enumerate() {
                    let white = self.weights.rates[*rest] * column;
                    (0..3).for_each(|axis| all[(head + 3 * place + axis, c)] = -white[axis]);
                }
            }
        }
        self.let_wander(&mut all);
        if linear.sees_inside() {
            let mut row = head + 3 * linear.rates.len();
            for (k, at_move) in linear.moves.iter().enumerate() {
                let (from, to) = (self.prepared.moves[k].from, self.prepared.moves[k].to);
                let end = |up: &Vector3<f64>, rest: usize| EndDirection {
                    up: *up,
                    jacobian: if of_gyroscope {
                        vec![Vector3::zeros(); width]
                    } else {
                        field.rests[rest].iter().map(|c| (up * up.dot(c) - c) / self.prepared.gravity_mps2).collect()
                    },
                };
                let (before, after) = (end(&at_move.before.up, from), end(&at_move.after.up, to));
                let pass = moved(&at_move.pass, &ways[k], &field.moves[k], turns[k].as_slice(), width);
                let noise = &self.weights.inside[k];
                inside::innovations(&pass, &before, &after, noise, self.prepared.gravity_mps2, |z| {
                    (0..width).for_each(|c| all[(row, c)] = z[c]);
                    row += 1;
                });
            }
        }
        all
    }
}

/// What a turn at the end of a move does to its two residuals.
fn across(at_move: &AtMove) -> Matrix2x3<f64> {
    let AtMove { pass, before, after } = at_move;
    let across = rows_across(&after.up);
    across * pass.rotation.transpose() * before.up.cross_matrix()
}

/// The pass of a move with the derivatives by a field in place of those by the parameters.
fn moved(pass: &Pass, way: &Way, columns: &[Vec<Vector3<f64>>], turns: &[Vec<Vector3<f64>>], width: usize) -> Pass {
    let still = vec![Vector3::zeros(); width];
    let block = |(k, block): (usize, &Block)| {
        let turn = turns.get(k).unwrap_or(&still);
        let jacobian = if turns.is_empty() {
            columns[k].iter().map(|column| -(way.stretches[k].attitude * column)).collect()
        } else {
            turn.iter().map(|turn| turn.cross(&block.force)).collect()
        };
        Block { turn: Vec::new(), jacobian, samples: block.samples.clone(), ..*block }
    };
    Pass {
        rotation: pass.rotation,
        turn: turns.last().unwrap_or(&still).clone(),
        blocks: pass.blocks.iter().enumerate().map(block).collect(),
        attitudes: Vec::new(),
    }
}
