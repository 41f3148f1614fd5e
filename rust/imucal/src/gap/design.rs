//! All columns that hypotheses are made of, linearised at one model.

use std::ops::Range;
use std::rc::Rc;

use faer::Mat;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::evidence::{Column, Gram};
use super::generic::{Block, Epoch, Kernel, factor};
use super::predict::Held;
use crate::error::Error;
use crate::joint::{BASE, Joint, Kinds, Linear, Model, Prepared, Source, Terms};

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

/// A generic hypothesis in the design.
pub(crate) struct Generic {
    pub(crate) block: Block,
    pub(crate) kernel: Kernel,
    pub(crate) columns: Range<usize>,
    pub(crate) typical: f64,
    /// Epochs x kernel columns, to read back what each epoch has.
    pub(crate) factor: Mat<f64>,
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
    let mut parts = vec![jacobian.subcols(0, BASE).to_owned()];
    for term in &own.all {
        parts.push(jacobian.subcols(BASE + place_in_all(term.name()), term.count()).to_owned());
    }
    parts.push(jacobian.subcols(BASE + all.count, full.len() - BASE - all.count).to_owned());
    let mut width = parameters.len();
    let mut candidates = Vec::new();
    for term in all.all.iter().filter(|term| !own.all.iter().any(|own| own.name() == term.name())) {
        parts.push(jacobian.subcols(BASE + term.first, term.linear).to_owned());
        candidates.push(Candidate {
            name: term.name().to_owned(),
            columns: width..width + term.linear,
            typical: term.typical()[..term.linear].to_vec(),
            shape: term.frozen_shape(),
        });
        width += term.linear;
    }
    let mut generics = Vec::new();
    if with_generics {
        let epochs = epochs(prepared, &linear);
        let [gyroscope, accelerometer] = problem.by_biases_of_rests(&linear);
        for (block, by_bias) in [(Block::GyroscopeBias, gyroscope), (Block::AccelerometerBias, accelerometer)] {
            for kernel in Kernel::ALL {
                let used: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
                let Some(factor) = factor(kernel, &epochs) else { continue };
                let r = factor.ncols();
                let columns = Mat::from_fn(by_bias.nrows(), 3 * r, |row, c| {
                    used.iter().enumerate().map(|(e, k)| by_bias[(row, 3 * k + c % 3)] * factor[(e, c / 3)]).sum()
                });
                let typical = block.typical_si() * problem.raw_scale(block.sensor(), &full);
                generics.push(Generic { block, kernel, columns: width..width + 3 * r, typical, factor });
                parts.push(columns);
                width += 3 * r;
            }
        }
    }
    let mut all = Mat::zeros(residual.nrows(), width + 1);
    let mut at = 0;
    for part in parts.iter().chain([&residual]) {
        all.as_mut().subcols_mut(at, part.ncols()).copy_from(part);
        at += part.ncols();
    }
    let model = (0..parameters.len())
        .map(|p| {
            let effect = p.checked_sub(BASE).filter(|p| *p < own.count);
            let precision = effect.map_or(0.0, |p| precisions[p]);
            Column { place: p, precision, value: if effect.is_some() { parameters[p] } else { 0.0 } }
        })
        .collect();
    let (groups, items) = (linear.groups_of_rows(), items_of_rows(prepared, &linear, own.kinds));
    Ok(Design { gram: Gram::new(&all, &groups), model, candidates, generics, columns: all, groups, items })
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
    let inside = in_moves(kinds.in_motion, 2);
    let stand_moves = in_moves(kinds.encoders, if kinds.in_motion { 0 } else { 2 });
    lines.chain(rates).chain(inside).chain(stand_rests).chain(stand_moves).collect()
}

/// What the kernels need to know of the rests that take part.
fn epochs(prepared: &Prepared<'_>, linear: &Linear) -> Vec<Epoch> {
    let mut attitude = UnitQuaternion::identity();
    let mut arrived: Vec<Option<(UnitQuaternion<f64>, Vector3<f64>)>> = vec![None; prepared.rests.len()];
    for (m, at_move) in prepared.moves.iter().zip(linear.moves.iter()) {
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(at_move.pass.rotation));
        let start = arrived[m.from].map_or(attitude, |(attitude, _)| attitude);
        attitude = start * turn;
        arrived[m.to] = Some((attitude, turn.scaled_axis()));
    }
    let epoch = |k: usize, up: &Vector3<f64>| {
        let rest = &prepared.rests[k];
        let recording = &prepared.recordings[rest.recording];
        let (attitude, turn) = arrived[k].unwrap_or((UnitQuaternion::identity(), Vector3::zeros()));
        let range = rest.rest.first..rest.rest.end;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        Epoch {
            recording: rest.recording,
            time_s: (rest.rest.start_s + rest.rest.end_s) / 2.0,
            up: *up,
            ahead: attitude.inverse() * Vector3::x(),
            temperature_degc: recording.temperature_degc.map(|t| mean(&t[range])),
            turn,
        }
    };
    linear.directions().map(|(k, up)| epoch(k, up)).collect()
}
