//! Weights of the residuals of the joint fit (model.md (19)).
//!
//! White noise is estimated from the rests of the recording. If residuals scatter significantly more than noise
//! explains, the excess is estimated from them. For mean rates it is a covariance between rests. For norms, moves, the
//! force inside moves and residuals against the stand it is one factor per kind.

mod whiten;

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::encoders::Encoders;
use super::inside::InsideNoise;
use super::linear::{Line, Linear, Source};
use super::model::Model;
use super::prepared::Prepared;
use super::scatter::{Excess, Modes, Scatter};
use super::terms::Terms;
use super::wander::Wander;
use crate::joint::BiasWander;
use crate::joint::wander::MOST_ROWS;
use crate::numerics::fit_report::significance_limit;
use crate::numerics::lsq::{self, Solution};
use crate::numerics::stats::median;
use crate::rests::moves::FINEST_RAD;
use crate::rests::noise_density::{random_walk_rad, variance_per_axis};
use crate::rests::rest::FINEST_MPS2;
use whiten::{Shares, Whitening};

/// Lower limit of the standard deviation of a mean rate, rad/s. It prevents infinite weights in noise-free simulations.
const FINEST_RADPS: f64 = 1e-6;

/// Weights of all residuals.
#[derive(Clone)]
pub(crate) struct Weights {
    pub(crate) whitening: Whitening,
    /// Whitening matrix of the mean rate of each rest, per raw unit: inverse of the lower Cholesky factor of its
    /// covariance.
    pub(crate) rates: Vec<Matrix3<f64>>,
    /// Bias instability of the gyroscope estimated from the mean rates, raw units. Zero if it is not significant or is
    /// known from the profile.
    pub(crate) bias_instability: [f64; 3],
    /// Noise inside each move.
    pub(crate) inside: Vec<InsideNoise>,
    /// Standard deviation of the gravity direction at a rest, stand minus measured, rad.
    pub(crate) stand_sigma_rad: f64,
    /// Variance of one encoder reading, rad^2.
    pub(crate) reading: f64,
    /// Standard deviation of each component of the direction residual of a move, from noise alone, rad.
    pub(crate) move_sigma_rad: Vec<f64>,
    pub(crate) scales: Scales,
}

/// Factors by which the standard deviations of the residuals are widened beyond noise; 1 if noise explains the
/// residuals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scales {
    pub(crate) norms: f64,
    pub(crate) moves: f64,
    pub(crate) inside: f64,
    pub(crate) stand_rests: f64,
    pub(crate) stand_moves: f64,
}

impl Weights {
    /// Weights of noise alone, without any widening.
    pub(crate) fn of_noise(prepared: &Prepared<'_>, terms: &Terms<'_>, linear: &Linear) -> Self {
        Self::new(prepared, terms, linear, None, true)
    }

    /// Weights at a linearisation. `found` is the fit that ended there, if any, together with the scales used in that
    /// fit.
    pub(crate) fn of(
        prepared: &Prepared<'_>,
        terms: &Terms<'_>,
        linear: &Linear,
        found: Option<(&Solution, &Scales)>,
    ) -> Self {
        Self::new(prepared, terms, linear, found, false)
    }

    fn new(
        prepared: &Prepared<'_>,
        terms: &Terms<'_>,
        linear: &Linear,
        found: Option<(&Solution, &Scales)>,
        noise_alone: bool,
    ) -> Self {
        let model = &linear.model;
        let leverages = found.map(|(solution, _)| lsq::leverages(&solution.jacobian));
        let scales = match (found, &leverages) {
            (Some((solution, before)), Some(leverages)) => before.refined(linear, solution, leverages),
            _ => Scales::NONE,
        };
        let head = linear.lines.len();
        let free = |axis: usize| {
            if noise_alone {
                return f64::INFINITY;
            }
            let spent =
                leverages.as_ref().map_or(1.0, |h| (0..linear.rates.len()).map(|k| h[head + 3 * k + axis]).sum());
            linear.rates.len() as f64 - spent
        };
        let own: Vec<f64> =
            linear.lines.iter().map(|line| own_variance(prepared, model, line.source, &scales)).collect();
        let shares: Vec<Shares> = linear
            .lines
            .iter()
            .map(|line| {
                let scale = if matches!(line.source, Source::Norm(_)) { scales.norms } else { 1.0 };
                line.by_means.iter().flat_map(|(rest, by)| share(prepared, *rest, by, scale)).collect()
            })
            .collect();
        let (rates, bias_instability) = rate_whitenings(prepared, model, linear, [0, 1, 2].map(free));
        Self {
            whitening: Whitening::new(&own, &shares, 3 * prepared.rests.len()),
            rates,
            bias_instability,
            inside: if linear.sees_inside() || terms.kinds.encoders {
                inside_noise(prepared, model, &scales)
            } else {
                Vec::new()
            },
            stand_sigma_rad: stand_sigma_rad(prepared, &scales),
            reading: reading_variance(prepared, &scales),
            move_sigma_rad: (0..prepared.moves.len()).map(|k| move_sigma_rad(prepared, model, k)).collect(),
            scales,
        }
    }

    /// Scatter of each kind of residuals relative to noise, as assumed by the weights. The mean rates are last.
    pub(crate) fn times_noise(&self, prepared: &Prepared<'_>) -> [f64; 6] {
        let Scales { norms, moves, inside, stand_rests, stand_moves } = self.scales;
        let mut rates = 1.0f64;
        for (rest, whitening) in prepared.rests.iter().zip(&self.rates) {
            let seen = whitening * rest.rate_covariance * whitening.transpose();
            for axis in (0..3).filter(|&axis| seen[(axis, axis)] > 0.0) {
                let wandering = self.bias_instability[axis].powi(2) / rest.rate_covariance[(axis, axis)];
                rates = rates.max((seen[(axis, axis)].recip() + wandering).sqrt());
            }
        }
        [norms, moves, inside, stand_rests, stand_moves, rates]
    }
}

/// Standard deviation of each component of the direction residual of a move, from noise alone, rad.
fn move_sigma_rad(prepared: &Prepared<'_>, model: &Model, k: usize) -> f64 {
    let shared: f64 = prepared.ends[k].iter().map(|end| end.shared_variance).sum();
    (own_variance(prepared, model, Source::Move(k), &Scales::NONE) + shared).sqrt()
}

/// Contribution of the mean-force errors of a rest to a residual: index of each error, and standard deviation times
/// derivative.
fn share(prepared: &Prepared<'_>, rest: usize, by: &Vector3<f64>, scale: f64) -> [(usize, f64); 3] {
    let variance = prepared.rests[rest].rest.specific_force.variance_of_mean;
    [0, 1, 2].map(|axis| (3 * rest + axis, by[axis] * variance[axis].sqrt() * scale))
}

/// Variance of a residual that is independent of all other residuals.
fn own_variance(prepared: &Prepared<'_>, model: &Model, source: Source, scales: &Scales) -> f64 {
    match source {
        Source::Norm(_) => (FINEST_MPS2 * scales.norms).powi(2),
        Source::Move(k) => {
            let m = &prepared.moves[k];
            let density = &prepared.noise[m.recording].angular_rate;
            let walk = random_walk_rad(density, model.gyroscope.inverse(), m.duration_s);
            let ends: f64 = prepared.ends[k].iter().map(|end| end.own_variance).sum();
            (walk * walk + ends + FINEST_RAD * FINEST_RAD) * scales.moves * scales.moves
        }
    }
}

/// Whitening matrices of the mean rates, and the bias instability of the gyroscope. Excess scatter between rests is
/// either independent from rest to rest or due to bias instability, whichever has the larger likelihood.
fn rate_whitenings(
    prepared: &Prepared<'_>,
    model: &Model,
    linear: &Linear,
    free: [f64; 3],
) -> (Vec<Matrix3<f64>>, [f64; 3]) {
    let finest = model.gyroscope.sensitivity().norm() / 3f64.sqrt() * FINEST_RADPS;
    let covariance = |k: usize| prepared.rests[k].rate_covariance + Matrix3::from_diagonal_element(finest * finest);
    let of_axis = |axis: usize| -> (Vec<f64>, Vec<f64>) {
        let rounding = |k: usize| prepared.rests[k].rest.angular_rate.rounding[axis].error_variance;
        let of_rest = |(k, lines): &(usize, [Line; 3])| {
            // Errors of rounding differ between rests only if the readings differ, so this variance is an upper bound.
            (lines[axis].residual, covariance(*k)[(axis, axis)] + rounding(*k))
        };
        linear.rates.iter().map(of_rest).unzip()
    };
    let axes = [0, 1, 2].map(of_axis);
    let one_by_one = [0, 1, 2].map(|axis| {
        let scatter = Scatter::from_rest_to_rest(&axes[axis].0, &axes[axis].1);
        scatter.is_significant(free[axis]).then(|| scatter.excess(free[axis])).flatten()
    });
    let (mut between_rests, mut bias_instability) = (one_by_one.map(|e| e.map_or(0.0, |e| e.variance)), [0.0; 3]);
    if prepared.wander == Wander::Seen
        && one_by_one.iter().any(Option::is_some)
        && let Some(modes) = prepared.flicker.get_or_init(|| {
            let flicker = flicker_of_rests(prepared)?;
            let [x, y, z] = axes.each_ref().map(|(_, variances)| Modes::new(variances, &flicker));
            Some([x?, y?, z?])
        })
    {
        // If one axis shows bias instability, the instability of all axes is estimated.
        let wandering = [0, 1, 2].map(|axis| modes[axis].scatter(&axes[axis].0).excess(free[axis]));
        let cost = |axis: usize, found: &[Option<Excess>; 3]| found[axis].map_or(f64::INFINITY, |e| e.cost);
        let beyond: Vec<usize> = (0..3).filter(|&axis| one_by_one[axis].is_some()).collect();
        let [wanders, scatters] =
            [&wandering, &one_by_one].map(|found| beyond.iter().map(|&axis| cost(axis, found)).sum::<f64>());
        if wanders < scatters {
            bias_instability = wandering.map(|e| e.map_or(0.0, |e| e.variance.sqrt()));
            between_rests = [0.0; 3];
        }
    }
    let mut whitenings = vec![Matrix3::zeros(); prepared.rests.len()];
    for (k, _) in &linear.rates {
        let whole = covariance(*k) + Matrix3::from_diagonal(&Vector3::from(between_rests));
        let factor = whole.cholesky().map(|factor| factor.l());
        whitenings[*k] = factor.and_then(|l| l.solve_lower_triangular(&Matrix3::identity())).unwrap_or_default();
    }
    (whitenings, bias_instability)
}

/// Noise variances inside each move, in SI units.
fn inside_noise(prepared: &Prepared<'_>, model: &Model, scales: &Scales) -> Vec<InsideNoise> {
    prepared
        .moves
        .iter()
        .zip(prepared.ends)
        .map(|(m, [before, after])| {
            let noise = &prepared.noise[m.recording];
            let finest = FINEST_RAD * FINEST_RAD;
            InsideNoise {
                start: before.own_variance + before.shared_variance + finest,
                end: after.own_variance + after.shared_variance + finest,
                walk: variance_per_axis(model.gyroscope.inverse(), &noise.angular_rate) + finest / m.duration_s,
                force: (variance_per_axis(model.accelerometer.inverse(), &noise.specific_force)
                    + FINEST_MPS2 * FINEST_MPS2)
                    * scales.inside
                    * scales.inside,
            }
        })
        .collect()
}

/// Standard deviation of the gravity direction at a rest against the stand, rad: noise of the accelerometer (median
/// over all ends of moves) and of the encoders.
fn stand_sigma_rad(prepared: &Prepared<'_>, scales: &Scales) -> f64 {
    let mut shared: Vec<f64> =
        prepared.ends.iter().flatten().map(|end| end.shared_variance + end.own_variance).collect();
    let reading = prepared.encoders.as_ref().map_or(0.0, Encoders::mean_variance);
    (median(&mut shared) + reading + FINEST_RAD * FINEST_RAD).sqrt() * scales.stand_rests
}

/// Variance of one encoder reading in motion, rad^2; zero without encoders.
fn reading_variance(prepared: &Prepared<'_>, scales: &Scales) -> f64 {
    let variance = |encoders: &Encoders| encoders.reading_variance() + FINEST_RAD * FINEST_RAD;
    prepared.encoders.as_ref().map_or(0.0, variance) * scales.stand_moves * scales.stand_moves
}

impl Scales {
    /// Largest of all factors.
    pub(crate) fn largest(&self) -> f64 {
        [self.norms, self.moves, self.inside, self.stand_rests, self.stand_moves].into_iter().fold(1.0, f64::max)
    }

    pub(crate) const NONE: Self = Self { norms: 1.0, moves: 1.0, inside: 1.0, stand_rests: 1.0, stand_moves: 1.0 };

    /// Scales for which chi2 of each kind equals its degrees of freedom.
    fn refined(&self, linear: &Linear, solution: &Solution, leverages: &[f64]) -> Self {
        let lines = &linear.lines;
        let groups = linear.groups();
        let norm = |row: usize| row < lines.len() && matches!(lines[row].source, Source::Norm(_));
        let a_move = |row: usize| row < lines.len() && matches!(lines[row].source, Source::Move(_));
        let refined =
            |scale: f64, chosen: &dyn Fn(usize) -> bool| refine(scale, &solution.residuals, leverages, chosen);
        Self {
            norms: refined(self.norms, &norm),
            moves: refined(self.moves, &a_move),
            inside: refined(self.inside, &|row| groups.inside.contains(&row)),
            stand_rests: refined(self.stand_rests, &|row| groups.stand_rests.contains(&row)),
            stand_moves: refined(self.stand_moves, &|row| groups.stand_moves.contains(&row)),
        }
    }
}

/// New scale with which the chosen residuals have unit variance; 1 if noise alone explains them.
fn refine(scale: f64, residuals: &Mat<f64>, leverages: &[f64], chosen: impl Fn(usize) -> bool) -> f64 {
    let rows: Vec<usize> = (0..residuals.nrows()).filter(|&row| chosen(row)).collect();
    let free = rows.len() as f64 - rows.iter().map(|&row| leverages[row]).sum::<f64>();
    if free < 1.0 {
        return scale;
    }
    let reduced = scale * scale * rows.iter().map(|&row| residuals[(row, 0)].powi(2)).sum::<f64>() / free;
    if reduced > significance_limit(free) { reduced.sqrt() } else { 1.0 }
}

/// Covariance of the mean gyroscope biases at the rests in use, for unit bias instability. `None` if there are too many
/// residuals to factor their covariance.
pub(crate) fn flicker_of_rests(prepared: &Prepared<'_>) -> Option<Mat<f64>> {
    let places: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
    if rows(places.len(), prepared.moves.len()) > MOST_ROWS {
        return None;
    }
    let unit = BiasWander { bias_instability: [1.0; 3], random_walk: [0.0; 3] };
    let mut covariance = Mat::zeros(places.len(), places.len());
    for (index, recording) in prepared.recordings.iter().enumerate() {
        let (rests, spans) = prepared.rests_of(index);
        let at: Vec<usize> = rests.iter().map(|k| places.partition_point(|place| place < k)).collect();
        let own = unit.of_rests(0, &spans, recording.span_s());
        for (i, j) in (0..at.len()).flat_map(|i| (0..at.len()).map(move |j| (i, j))) {
            covariance[(at[i], at[j])] = own[(i, j)];
        }
    }
    Some(covariance)
}

/// Number of residuals: one norm and three mean rates per rest, two direction components per move.
fn rows(rests: usize, moves: usize) -> usize {
    4 * rests + 2 * moves
}
