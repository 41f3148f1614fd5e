//! Fits the accelerometer to its mean readings at the rests by maximum likelihood (model.md (5)).
//!
//! ```text
//! r_k = (|T^-1 (a_k - b)| - g) / sigma_k
//! with f = T^-1 (a - b), u = f / |f|, v = T^-T u:   d|f|/db = -v,   d|f|/dT = -v f^T
//! ```
//!
//! r_k is the residual of rest k, and a_k is the mean reading of this rest. sigma_k is the standard deviation of the
//! norm |T^-1 (a_k - b)| due to the noise and rounding of a_k. T is the sensitivity, b the bias, and g local gravity.
//!
//! The fit uses the symmetric frame, which is the body frame in which T is a symmetric matrix. The nine parameters are
//! `[b_x, b_y, b_z, T_xx, T_yy, T_zz, T_xy, T_xz, T_yz]`.

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, SVector, Vector3};

use crate::error::Error;
use crate::frame::SYMMETRIC;
use crate::held::{HeldParameter, StageRows};
use crate::numerics::fit_report::FitReport;
use crate::numerics::lsq::Termination;
use crate::numerics::lsq::{self, Residuals, Solution};
use crate::numerics::{robust, second_order, stats};
use crate::parameters::ACCEL;
use crate::rests::rest::{Rest, sigma_norm};
use crate::two_stage::ellipsoid::{self, Start};
use crate::two_stage::observability::{self, LARGEST_SHIFT, REST_ERROR_MPS2};

/// The ellipsoid (or sphere) through the mean readings is used as the start value only if the ratio of the noise of the
/// mean readings to the size of the ellipsoid is below this limit. The ratio is `noise |T^-1| / g`. `noise` is the
/// median standard deviation of a mean reading, |T^-1| is the Frobenius norm of the inverse sensitivity, and g is local
/// gravity. Even for a noisy sensor, the ratio is only about 0.001. If all rests have the same pose, the ellipsoid is
/// fitted to the noise of the mean readings, and the ratio is about 0.5.
const NOISE_OVER_SIZE: f64 = 0.02;

/// Result of the accelerometer fit.
#[derive(Clone, Debug)]
pub(crate) struct AccelerometerFit {
    /// The fitted accelerometer.
    pub(crate) triad: Triad<f64>,
    /// For each rest, whether the fit uses it. The other rests were excluded as outliers.
    pub(crate) used: Vec<bool>,
    /// Gain of the fit: the negative derivatives of the nine parameters (rows) with respect to the errors of |f| at the
    /// rests (columns), per m/s^2. |f| is the norm of the mean force at a rest. The columns of rests that are not used
    /// are zero.
    pub(crate) gain: Mat<f64>,
    /// Derivatives of the nine parameters (rows) with respect to the errors of the means of the priors (columns). The
    /// unit of each error is the standard deviation of its prior.
    pub(crate) prior_gain: Mat<f64>,
    /// Expected value of e e^T, 9 x 9, where the vector e contains the second-order errors of the nine parameters that
    /// the errors of the priors cause.
    pub(crate) second_order: Mat<f64>,
    pub(crate) report: FitReport,
    /// Whether the rests alone determine all parameters for which no prior was given. If it is false ([`fit_near`]),
    /// the moves must determine the remaining parameters.
    pub(crate) is_determined: bool,
}

/// Fits the nine parameters. Rests that contradict all others are excluded one by one (model.md (14)).
///
/// The start value is an ellipsoid or a sphere that is fitted to the mean readings. If the rests determine neither an
/// ellipsoid nor a sphere, or if the ellipsoid or sphere is not much larger than the noise of the mean readings, the
/// fit starts from `nominal`. If `nominal` is `None` in this case, the start value for recordings in SI units
/// (`raw_is_si`) is the identity matrix as sensitivity and zero bias. For other recordings, an error is returned. The
/// parameters in `held` have a prior, so the rests need not determine these parameters.
///
/// # Errors
/// * [`Error::NotEnoughMotion`] if the rests do not determine the parameters.
/// * [`Error::Fit`] if the result is not finite.
pub(crate) fn fit(
    rests: &[&Rest],
    gravity_mps2: f64,
    nominal: Option<Start>,
    raw_is_si: bool,
    held: &StageRows<'_>,
) -> Result<AccelerometerFit, Error> {
    let means: Vec<Vector3<f64>> = rests.iter().map(|rest| rest.specific_force.mean).collect();
    // With priors, the poses need not determine all parameters. An ellipsoid through the means may then be far from the
    // true ellipsoid, so a sphere is fitted instead.
    let found = if held.count() == 0 {
        ellipsoid::fit(&means, gravity_mps2)?
    } else {
        ellipsoid::smallest_sphere(&means, gravity_mps2)?
    };
    let mut start = match found.filter(|start| exceeds_noise(start, rests, gravity_mps2)) {
        Some(start) => start,
        None => nominal
            .or_else(|| raw_is_si.then(|| Start { sensitivity: Matrix3::identity(), bias: Vector3::zeros() }))
            .ok_or_else(|| Error::NotEnoughMotion(observability::no_start(means.len())))?,
    };
    if let Some(known) = held.known() {
        let triad = triad_of(&known)?;
        start = Start { sensitivity: *triad.sensitivity(), bias: *triad.bias() };
    }
    for (p, scale) in held.scales() {
        (start.sensitivity[(p - 3, p - 3)], start.bias) = (scale, Vector3::zeros());
    }
    check_design(&means, &start, gravity_mps2, held)?;
    fit_from(rests, gravity_mps2, &start, held, true)
}

/// Fits the accelerometer to rests that do not determine some of its parameters. These parameters stay near the values
/// of `start`, and all others are fitted. For this purpose, every parameter has a prior around its start value, with a
/// standard deviation of 1 % of its size (the reading at 1 g for a bias, the mean scale for an entry of the
/// sensitivity). This prior hardly changes a parameter that the rests determine.
///
/// No rest is excluded as an outlier, because the residuals of a few rests on the faces of a box-shaped unit do not
/// show which rest is wrong. The joint fit, which follows, excludes outliers.
///
/// # Errors
/// [`Error::Fit`] if the result is not finite.
pub(crate) fn fit_near(rests: &[&Rest], gravity_mps2: f64, start: &Triad<f64>) -> Result<AccelerometerFit, Error> {
    let start = Start { sensitivity: *start.sensitivity(), bias: *start.bias() };
    let scale = start.sensitivity.trace() / 3.0;
    let size = |j: usize| if j < 3 { gravity_mps2 * scale } else { scale };
    let values = parameters_of(&start).into_iter().enumerate();
    let near: Vec<HeldParameter> =
        values.map(|(j, value)| HeldParameter::near(j, value, LARGEST_SHIFT * size(j))).collect();
    fit_from(rests, gravity_mps2, &start, &StageRows::new(&near, ACCEL), false)
}

/// Fits the parameters from a start value. `is_determined` states whether the rests determine all parameters for which
/// no prior was given.
fn fit_from(
    rests: &[&Rest],
    gravity_mps2: f64,
    start: &Start,
    held: &StageRows<'_>,
    is_determined: bool,
) -> Result<AccelerometerFit, Error> {
    let mut used = vec![true; rests.len()];
    let mut parameters = parameters_of(start);
    loop {
        let problem = Norms::new(rests, &used, gravity_mps2, &parameters, held)?;
        let solution = lsq::minimize(&problem, &parameters, lsq::EXACT)?;
        if solution.termination == Termination::NotFinite {
            return Err(Error::Fit(
                "the accelerometer fit has residuals that are not finite: check units and gravity".into(),
            ));
        }
        parameters = solution.parameters.clone();
        let scores = robust::leave_one_out(&solution.residuals, &solution.jacobian, 1);
        match robust::worst_outlier(&scores[..problem.means.len()], 1) {
            Some(row) if is_determined && robust::may_exclude(&used, 9 + 3) => used[problem.rest_of_row[row]] = false,
            _ => return finish(rests, used, &problem, &solution, is_determined),
        }
    }
}

/// Whether the ellipsoid is much larger than the noise of the means (see [`NOISE_OVER_SIZE`]). If all rests have the
/// same pose, an ellipsoid can also be fitted to the means, but this ellipsoid is only as large as the noise.
fn exceeds_noise(start: &Start, rests: &[&Rest], gravity_mps2: f64) -> bool {
    let mut noise: Vec<f64> = rests.iter().map(|rest| rest.specific_force.whole_variance().max().sqrt()).collect();
    let noise = stats::median(&mut noise);
    start.sensitivity.try_inverse().is_some_and(|inverse| noise * inverse.norm() < NOISE_OVER_SIZE * gravity_mps2)
}

/// Returns an error if the rests do not determine all parameters that have no prior.
fn check_design(means: &[Vector3<f64>], start: &Start, gravity_mps2: f64, held: &StageRows<'_>) -> Result<(), Error> {
    let parameters = parameters_of(start);
    let triad = triad_of(&parameters)?;
    let gradients: Vec<_> = means.iter().map(|mean| norm_and_gradient(&triad, mean).1).collect();
    // The columns of the design matrix are derivatives with respect to dimensionless parameters: a bias divided by the
    // reading at 1 g, or an entry of the sensitivity divided by the mean scale.
    let scale = start.sensitivity.trace() / 3.0;
    let unit = |j: usize| if j < 3 { gravity_mps2 * scale } else { scale };
    let (mut residuals, mut priors) = (Mat::zeros(held.count(), 1), Mat::zeros(held.count(), 9));
    held.write(&parameters, 0, &mut residuals, &mut priors);
    let design = Mat::from_fn(means.len() + held.count(), 9, |k, j| match gradients.get(k) {
        Some(gradient) => gradient[j] * unit(j),
        None => priors[(k - means.len(), j)] * unit(j) * REST_ERROR_MPS2,
    });
    let up: Vec<Vector3<f64>> = means.iter().map(|mean| triad.correct(*mean).normalize()).collect();
    observability::check_accelerometer(&design, &up, &held.columns())
}

fn finish(
    rests: &[&Rest],
    used: Vec<bool>,
    problem: &Norms<'_>,
    solution: &Solution,
    is_determined: bool,
) -> Result<AccelerometerFit, Error> {
    let triad = triad_of(&solution.parameters)?;
    let row_gain = lsq::gain(&solution.jacobian);
    let mut gain = Mat::zeros(9, rests.len());
    for (row, &k) in problem.rest_of_row.iter().enumerate() {
        for i in 0..9 {
            gain[(i, k)] = row_gain[(i, row)] / problem.sigma[row];
        }
    }
    let first = problem.means.len();
    let prior_gain = Mat::from_fn(9, row_gain.ncols() - first, |i, row| row_gain[(i, first + row)]);
    let residuals_at = |parameters: &[f64]| {
        let (mut residuals, mut jacobian) = (Mat::zeros(problem.count(), 1), Mat::zeros(problem.count(), 9));
        problem.evaluate(parameters, &mut residuals, &mut jacobian);
        Ok(residuals)
    };
    let second_order = second_order::mean_square(solution, &row_gain, first..problem.count(), residuals_at)?;
    let mut report = FitReport::of(solution);
    if !is_determined {
        // The degrees of freedom include only the residuals of the rests, and not the residuals of the priors. They are
        // the number of used rests minus the sum of the leverages of the residuals of these rests. This sum is the
        // number of parameters that the rests determine.
        let of_rests: f64 = lsq::leverages(&solution.jacobian)[..problem.means.len()].iter().sum();
        report.degrees_of_freedom = problem.means.len().saturating_sub(of_rests.round() as usize);
    }
    Ok(AccelerometerFit { triad, used, gain, prior_gain, second_order, report, is_determined })
}

pub(crate) fn parameters_of(start: &Start) -> Vec<f64> {
    let entries = SYMMETRIC.map(|(i, j)| start.sensitivity[(i, j)]);
    start.bias.iter().copied().chain(entries).collect()
}

pub(crate) fn triad_of(parameters: &[f64]) -> Result<Triad<f64>, Error> {
    let mut sensitivity = Matrix3::zeros();
    for (&(i, j), &entry) in SYMMETRIC.iter().zip(&parameters[3..9]) {
        sensitivity[(i, j)] = entry;
        sensitivity[(j, i)] = entry;
    }
    let bias = Vector3::from_column_slice(&parameters[..3]);
    Triad::try_new(sensitivity, bias).map_err(|error| Error::Fit(format!("accelerometer: {error}")))
}

/// Computes the norm |f| of the corrected force at a rest, and its derivative with respect to the nine parameters.
/// `mean` is the mean reading of the rest.
pub(crate) fn norm_and_gradient(triad: &Triad<f64>, mean: &Vector3<f64>) -> (f64, SVector<f64, 9>) {
    let f = triad.correct(*mean);
    let norm = f.norm();
    let v = triad.inverse().tr_mul(&f) / norm;
    let mut gradient = SVector::<f64, 9>::zeros();
    for i in 0..3 {
        gradient[i] = -v[i];
    }
    for (row, (i, j)) in SYMMETRIC.into_iter().enumerate() {
        gradient[3 + row] = if i == j { -v[i] * f[i] } else { -v[i] * f[j] - v[j] * f[i] };
    }
    (norm, gradient)
}

/// The residuals of the rests that the fit uses, followed by the residuals of the priors. The weights of the rests are
/// computed from the start value of each minimisation and stay fixed during this minimisation.
struct Norms<'a> {
    means: Vec<Vector3<f64>>,
    sigma: Vec<f64>,
    rest_of_row: Vec<usize>,
    gravity_mps2: f64,
    held: &'a StageRows<'a>,
}

impl<'a> Norms<'a> {
    fn new(
        rests: &[&Rest],
        used: &[bool],
        gravity_mps2: f64,
        parameters: &[f64],
        held: &'a StageRows<'a>,
    ) -> Result<Self, Error> {
        let triad = triad_of(parameters)?;
        let rest_of_row: Vec<usize> = (0..rests.len()).filter(|&k| used[k]).collect();
        let sigma: Vec<f64> = rest_of_row.iter().map(|&k| sigma_norm(rests[k], &triad)).collect();
        Ok(Self {
            means: rest_of_row.iter().map(|&k| rests[k].specific_force.mean).collect(),
            sigma,
            rest_of_row,
            gravity_mps2,
            held,
        })
    }
}

impl Residuals for Norms<'_> {
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        let Ok(triad) = triad_of(parameters) else {
            residuals.fill(f64::NAN); // the solver then takes a shorter step
            return;
        };
        for (k, (mean, sigma)) in self.means.iter().zip(&self.sigma).enumerate() {
            let (norm, gradient) = norm_and_gradient(&triad, mean);
            residuals[(k, 0)] = (norm - self.gravity_mps2) / sigma;
            for j in 0..9 {
                jacobian[(k, j)] = gradient[j] / sigma;
            }
        }
        self.held.write(parameters, self.means.len(), residuals, jacobian);
    }

    fn count(&self) -> usize {
        self.means.len() + self.held.count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_meets_a_finite_difference() {
        let parameters = [0.3, -0.2, 0.1, 1.02, 0.97, 1.01, 0.004, -0.006, 0.003];
        let mean = Vector3::new(3.0, -7.0, 6.0);
        let (_, gradient) = norm_and_gradient(&triad_of(&parameters).unwrap(), &mean);
        for j in 0..9 {
            let shifted = |h: f64| {
                let mut p = parameters;
                p[j] += h;
                norm_and_gradient(&triad_of(&p).unwrap(), &mean).0
            };
            let difference = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
            assert!((gradient[j] - difference).abs() < 1e-8, "{j}: {} {difference}", gradient[j]);
        }
    }
}
