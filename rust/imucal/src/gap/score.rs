//! Computes the scores and detection limits of all candidate effects relative to a model (docs/model.md (23)).

use std::collections::BTreeSet;
use std::ops::Range;

use faer::Mat;
use faer::linalg::solvers::Solve;
use imucal_core::effects::{Effect, Sensor};

use super::Scattering;
use super::common::{Common, SweptCommon};
use super::design::{Candidate, Design};
use super::detect::Detection;
use super::evidence::{Column, Evidence, Gram};
use super::predict::Gain;
use super::stage::Stage;
use super::weighing::Aside;
use super::{Score, Trace};
use crate::joint::{LEAST_CHANGE_PARTLY, STAND_MOVES, STAND_RESTS};
use crate::numerics::stats::p_value;
use crate::numerics::workers::{in_order, processors};

/// Trial widths (standard deviations) of the prior of an effect, in multiples of the typical sizes of the effect's
/// parameters.
const WIDTHS: [f64; 8] = [0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
/// Prior width, in multiples of the typical size, that is too large to influence the fit.
const NO_PRIOR: f64 = 1e4;
/// A direction in parameter space is observable if a change of the parameters by one typical size in this direction
/// changes chi2 by at least this value, 1e-4. A change by a hundred typical sizes then changes chi2 by at least 1.
const LEAST_CHANGE: f64 = LEAST_CHANGE_PARTLY * LEAST_CHANGE_PARTLY;
/// Sensor noise explains the residuals of a group (kind of residual) if the p-value of their chi2 is above this value.
/// If noise explains all groups, cross-validation is skipped.
const NOISE_CHANCE: f64 = 0.01;
/// The scatter of residuals at rests is significant if its p-value is below this value.
const SCATTER_CHANCE: f64 = 1e-6;
/// The scatter of the residuals at rests is reported only if their standard deviation is larger than WIDE x their
/// standard deviation from white noise. Coloured noise and bias instability may cause ratios up to this value.
const WIDE: f64 = 2.5;
/// If effects were selected, scatter is not reported if its variance is at most this share of the residual variance of
/// the model without effects. Linearisation errors of a large effect may cause such scatter.
const REMAINDER: f64 = 0.05;

/// A candidate's score at the prior width and the trial time constant with the largest evidence.
pub(super) struct Judged {
    pub(super) score: Score,
    pub(super) width: f64,
    pub(super) shape: Option<f64>,
}

/// Scores and detection limits of all candidates.
pub(super) struct Judgement {
    pub(super) scores: Vec<Judged>,
    /// Name of each effect that is not observable, and the data that would make it observable.
    pub(super) blind: Vec<(String, String)>,
    /// Detection limit of each candidate: the name of the effect, the smallest detectable rms value of its parameters,
    /// and the unit of this value.
    pub(super) visible: Vec<(String, f64, String)>,
}

/// Computes the scores and detection limits of all candidates relative to the model of one stage of the search.
pub(super) fn judge(stage: &Stage) -> Judgement {
    let Design { gram, model, candidates, .. } = &*stage.design;
    let (mut scores, mut blind, mut visible): (Vec<Judged>, Vec<_>, Vec<_>) = (Vec::new(), Vec::new(), Vec::new());
    // Observability is computed with all noise scales s_g^2 (chi2 per degree of freedom of each group of residuals)
    // equal to one. A missing effect increases the estimated noise scales. With the increased scales, a large missing
    // effect would seem less observable than it is.
    let unwidened = vec![1.0; stage.evidence.scales.len()];
    let all = Common::new(gram, model, candidates.iter().flat_map(Candidate::asides).collect());
    let widened = all.sweep(&stage.evidence.scales);
    let plain = if stage.evidence.scales == unwidened { None } else { all.sweep(&unwidened) };
    let ends = candidates.iter().scan(0, |end, candidate| {
        *end += candidate.typical.len();
        Some(*end)
    });
    let own: Vec<Range<usize>> = ends.zip(candidates).map(|(end, c)| end - c.typical.len()..end).collect();
    let look =
        |place: usize| look_at(&candidates[place], &all, own[place].clone(), [&plain, &widened], &stage.evidence);
    let looks: Vec<Option<Look>> = in_order(processors(), candidates.len(), look);
    let tests = {
        let seen = candidates.iter().zip(&looks).filter(|(_, look)| look.is_some()).map(|(c, _)| c.name.as_str());
        seen.collect::<BTreeSet<&str>>().len()
    };
    let mut detection = Detection::new(tests);
    for (candidate, look) in candidates.iter().zip(looks) {
        let Some(look) = look else {
            if !blind.iter().any(|(name, _)| *name == candidate.name) {
                blind.push((candidate.name.clone(), observable(&candidate.name)));
            }
            continue;
        };
        let size = detection.limit(&look.information, look.dof) * candidate.typical[0];
        // The detection limit refers to the form of the effect with the fewest parameters.
        let is_plain = Effect::<f64>::find(&candidate.name).is_none_or(|own| own.plain >= candidate.typical.len());
        match visible.iter_mut().find(|(name, _, _): &&mut (String, f64, String)| *name == candidate.name) {
            Some(entry) if is_plain => entry.1 = entry.1.min(size),
            Some(_) => {}
            None => visible.push((candidate.name.clone(), size, unit(&candidate.name))),
        }
        let Some(judged) = look.judged else { continue };
        match scores.iter_mut().find(|other| other.score.name == candidate.name) {
            Some(other) if other.score.log_bayes_factor >= judged.score.log_bayes_factor => {}
            Some(other) => *other = judged,
            None => scores.push(judged),
        }
    }
    blind.retain(|(name, _)| !scores.iter().any(|judged| judged.score.name == *name));
    Judgement { scores, blind, visible }
}

/// Observability and score of a candidate relative to a model.
struct Look {
    /// Number of observable directions in the space of the candidate's parameters. The noise variances are not scaled
    /// (all noise scales s_g^2 are one).
    dof: usize,
    /// One eigenvalue for each parameter of the candidate: the change of chi2 if the parameters change by one typical
    /// size in the direction of an eigenvector.
    information: Vec<f64>,
    judged: Option<Judged>,
}

/// Scores the candidate with the columns `own`. `plain` and `widened` are the normal matrix after elimination of the
/// model's parameters. In `plain`, the noise variances are not scaled. In `widened`, they are multiplied by the noise
/// scales s_g^2 of the model. `plain` is `None` if the model's scales are all one, because both matrices are then
/// equal. `before` is the evidence of the model without the candidate. Returns `None` if the candidate is not
/// observable.
fn look_at(
    candidate: &Candidate,
    all: &Common<'_>,
    own: Range<usize>,
    [plain, widened]: [&Option<SweptCommon>; 2],
    before: &Evidence,
) -> Option<Look> {
    let beside = all.weighing(own.clone());
    let swept = all.part_of(widened.as_ref()?, &beside, own.clone());
    let left = beside.left(&swept);
    let unwidened = plain.as_ref().map(|plain| beside.left(&all.part_of(plain, &beside, own)));
    let dof = unwidened.as_ref().unwrap_or(&left).directions(LEAST_CHANGE);
    let judged = || {
        // The noise scales depend little on the prior width. They are therefore estimated only once, with a prior that
        // is too wide to influence the fit.
        let (free, settled) = beside.evidence(NO_PRIOR, swept)?;
        let (width, _) = beside.left(&settled).best_width(&WIDTHS)?;
        let statistic = (before.deviance - free.deviance).max(0.0);
        let score = Score {
            name: candidate.name.clone(),
            log_bayes_factor: beside.evidence(width, settled)?.0.log - before.log,
            parameters: candidate.typical.len(),
            statistic,
            dof,
            p_value: p_value(statistic, dof + usize::from(candidate.shape.is_some())),
            rivals: Vec::new(),
        };
        Some(Judged { score, width, shape: candidate.shape })
    };
    (dof > 0).then(|| Look { dof, information: left.eigenvalues(), judged: judged() })
}

/// Increase of the log predictive density of held-out rests and moves due to a candidate. `None` if sensor noise
/// explains the residuals of the model with the candidate. In this case, the p-value of the candidate is reliable, so
/// cross-validation is not needed.
pub(super) fn gain(stage: &Stage, judged: &Judged) -> Option<Gain> {
    let Design { gram, model, candidates, .. } = &*stage.design;
    let same = |c: &&Candidate| {
        (&c.name, c.typical.len(), c.shape) == (&judged.score.name, judged.score.parameters, judged.shape)
    };
    let candidate = candidates.iter().find(same)?;
    let with: Vec<Column> = model.iter().copied().chain(candidate.columns(judged.width)).collect();
    let scales = gram.evidence_near(&with, &stage.evidence.scales)?.scales;
    // A noise scale is chi2 per degree of freedom. The number of rows approximates the degrees of freedom.
    let mut chances = scales.iter().zip(&gram.rows).map(|(scale, rows)| p_value(scale * rows, *rows as usize));
    if chances.all(|chance| chance > NOISE_CHANCE) {
        return None;
    }
    stage.design.held().gain((model, &stage.evidence.scales), (&with, &scales))
}

fn observable(name: &str) -> String {
    Effect::<f64>::find(name)
        .map_or_else(|| "data in which its field changes".to_owned(), |effect| effect.observable.to_owned())
}

fn unit(name: &str) -> String {
    let effect = Effect::<f64>::find(name);
    effect.and_then(|effect| effect.parameters.first()).map_or_else(String::new, |p| p.unit.to_owned())
}

impl Candidate {
    fn asides(&self) -> impl Iterator<Item = Aside> {
        self.columns.clone().zip(self.typical.iter().copied())
    }

    /// The columns of the candidate. Each parameter has a prior, whose standard deviation is `width` times its typical
    /// size.
    pub(super) fn columns(&self, width: f64) -> impl Iterator<Item = Column> {
        self.columns.clone().zip(&self.typical).map(move |(place, typical)| Column {
            place,
            precision: 1.0 / (width * typical).powi(2),
            value: 0.0,
        })
    }
}

/// For each candidate: the size of the residuals if the unit has this effect at its typical size and the model lacks
/// it, after a refit of the model's parameters. For an effect with a time constant, the result is for the trial value
/// at which the refit removes the smallest share of chi2.
pub(super) fn traces(stage: &Stage) -> Vec<Trace> {
    const NAMES: [&str; 11] = [
        "rest_norm",
        "move_direction",
        "rest_rate_x",
        "rest_rate_y",
        "rest_rate_z",
        "move_force",
        "stand_rest",
        "stand_move",
        "epoch_norm",
        "epoch_direction",
        "epoch_rate",
    ];
    let Design { gram, model, candidates, .. } = &*stage.design;
    let mut traces: Vec<Trace> = Vec::new();
    for candidate in candidates {
        let Some((left, given)) = left_in_groups(gram, model, candidate) else { continue };
        let total: f64 = left.iter().sum();
        let times_noise = |g: usize| (NAMES[gram.groups[g]], (left[g].max(0.0) / gram.rows[g]).sqrt());
        let trace = Trace {
            name: candidate.name.clone(),
            times_noise: (0..left.len()).map(times_noise).collect(),
            taken_up: if given > 0.0 { (1.0 - total / given).clamp(0.0, 1.0) } else { 1.0 },
        };
        match traces.iter_mut().find(|other| other.name == trace.name) {
            Some(other) if other.taken_up <= trace.taken_up => {}
            Some(other) => *other = trace,
            None => traces.push(trace),
        }
    }
    traces
}

/// Expected chi2 in each group of residuals if an effect of typical size is missing from the model. The expectation is
/// over random signs of the effect's parameters. The parameters of the model are refitted before chi2 is computed. The
/// second value is the expected chi2 of all groups together without this refit.
fn left_in_groups(gram: &Gram, model: &[Column], candidate: &Candidate) -> Option<(Vec<f64>, f64)> {
    let n = model.len();
    let p = candidate.typical.len();
    let place = |k: usize| candidate.columns.start + k;
    let total = |i: usize, j: usize| gram.sums.iter().map(|g| g[(i, j)]).sum::<f64>();
    let size: Vec<f64> = model.iter().map(|c| total(c.place, c.place).sqrt().max(1e-300)).collect();
    let normal_of =
        |sum: &Mat<f64>| Mat::from_fn(n, n, |i, j| sum[(model[i].place, model[j].place)] / (size[i] * size[j]));
    let cross_of =
        |sum: &Mat<f64>| Mat::from_fn(n, p, |i, k| sum[(model[i].place, place(k))] / size[i] * candidate.typical[k]);
    let (normals, crosses): (Vec<_>, Vec<_>) = gram.sums.iter().map(|sum| (normal_of(sum), cross_of(sum))).unzip();
    let mut normal = Mat::from_fn(n, n, |i, j| if i == j { 1e-12 } else { 0.0 });
    let mut cross = Mat::<f64>::zeros(n, p);
    for (own, by) in normals.iter().zip(&crosses) {
        normal += own;
        cross += by;
    }
    let x = normal.llt(faer::Side::Lower).ok()?.solve(&cross);
    let mut given = 0.0;
    let left = gram.sums.iter().zip(normals.iter().zip(&crosses)).map(|(sum, (normal, cross))| {
        let bent = x.transpose() * normal * &x;
        let met = cross.transpose() * &x;
        let own = |k: usize| sum[(place(k), place(k))] * candidate.typical[k].powi(2);
        given += (0..p).map(own).sum::<f64>();
        (0..p).map(|k| own(k) - 2.0 * met[(k, k)] + bent[(k, k)]).sum()
    });
    let left: Vec<f64> = left.collect();
    Some((left, given))
}

/// The kind of residuals with the largest significant excess over noise. Only residuals at rests and residuals relative
/// to the stand are tested. Residuals of moves are not tested, because gyroscope noise may increase in motion without a
/// missing effect. If effects were selected, only residuals of their sensors and of the stand are tested, because the
/// other sensors of a real unit also deviate slightly from the model. An excess that linearisation errors of large
/// effects may cause (see [`REMAINDER`]) is tolerated. `before` are the noise scales of the model without effects.
pub(super) fn scattering_rests(stage: &Stage, before: &[f64]) -> Option<Scattering> {
    const NAMES: [(usize, Sensor, &str); 6] = [
        (0, Sensor::Accelerometer, "accel_norm"),
        (2, Sensor::Gyroscope, "gyro_rate_x"),
        (3, Sensor::Gyroscope, "gyro_rate_y"),
        (4, Sensor::Gyroscope, "gyro_rate_z"),
        (STAND_RESTS, Sensor::Encoder, "stand_direction"),
        (STAND_MOVES, Sensor::Encoder, "stand_attitude"),
    ];
    let gram = &stage.design.gram;
    let is_meant = |sensor: Sensor, scale: f64, before: f64| {
        if sensor == Sensor::Encoder && !stage.sensors.contains(&sensor) {
            // Residuals relative to the stand contain no coloured noise, so their standard deviation need not exceed
            // [`WIDE`] x noise. Only an excess that linearisation errors of the selected effects may cause is
            // tolerated.
            return stage.sensors.is_empty() || scale - 1.0 > REMAINDER * (before - 1.0);
        }
        let beside = stage.sensors.is_empty() || (stage.sensors.contains(&sensor) && scale > REMAINDER * before);
        beside && scale > WIDE * WIDE
    };
    let of = |(group, sensor, name)| {
        let place = gram.groups.iter().position(|g| *g == group)?;
        let (scale, rows) = (stage.evidence.scales[place], gram.rows[place]);
        // A noise scale is chi2 per degree of freedom. The number of rows approximates the degrees of freedom.
        let chance = p_value(scale * rows, rows as usize);
        (chance < SCATTER_CHANCE && is_meant(sensor, scale, before[place])).then(|| (name, scale.sqrt(), chance))
    };
    NAMES.into_iter().filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Compares the sensor effects that are estimated with and without the stand's angles (Hausman, Econometrica 46, 1978,
/// 1251-1271). A significant difference shows that the stand does not follow the stand model. The test divides by the
/// variance of the estimate without the stand's angles, which is an upper bound of the variance of the difference.
pub(super) fn contradiction_of_stand(alone: &Stage, with_stand: &Stage) -> Option<Scattering> {
    let (mut chi2, mut dof) = (0.0, 0);
    for member in &alone.members {
        let other = with_stand.members.iter().find(|other| other.name == member.name)?;
        let own: Vec<usize> = alone.place(&member.name)?.collect();
        let covariance = alone.design.gram.covariance(&alone.design.model, &alone.evidence.scales, &own)?;
        let n = own.len().min(other.values.len());
        let change = Mat::from_fn(n, 1, |k, _| member.values[k] - other.values[k]);
        let of_linear = Mat::from_fn(n, n, |i, j| covariance[(i, j)]);
        let solved = of_linear.llt(faer::Side::Lower).ok()?.solve(&change);
        chi2 += (0..n).map(|k| change[(k, 0)] * solved[(k, 0)]).sum::<f64>();
        dof += n;
    }
    let chance = p_value(chi2, dof);
    (dof > 0 && chance < SCATTER_CHANCE).then(|| ("stand_and_sensors", (chi2 / dof as f64).sqrt(), chance))
}
