//! Estimates the noise parameters and their confidence bands by maximum likelihood (section (32) of `docs/model.md`).
//!
//! ```text
//! -2 ln L = sum over powers of dof (P / mu - 1 - ln(P / mu))
//! mu = rounding expected_w + sum over kinds of theta_k expected_k
//! ```
//!
//! L is the likelihood, P is a measured power with `dof` degrees of freedom, and mu is its expectation. theta_k is the
//! parameter of noise kind k, expected_k is the expected power for theta_k = 1, and w is white noise. rounding is the
//! variance of the rounding error of a sample. -2 ln L is the deviance.
//!
//! theta is estimated by Fisher scoring with the constraint theta >= 0. D(theta_k) is the deviance for a fixed theta_k,
//! minimised over the other parameters. A value of theta_k is inside the confidence band if D(theta_k) exceeds its
//! minimum by at most 3.84, the 95 % quantile of chi-square with one degree of freedom. Such bands remain valid with
//! few degrees of freedom, where the distribution of an estimate is far from normal.

use nalgebra::{Matrix4, Vector4};

use super::cosines::Power;
use super::power_law::{KINDS, PerKind, dot};

/// 95 % quantile of the chi-square distribution with one degree of freedom. A confidence band ends where the deviance
/// exceeds its minimum by this value.
const BAND: f64 = 3.841_458_820_694_124;
/// Maximum number of iterations of Fisher scoring.
const ITERATIONS: usize = 60;
/// Maximum number of bisections that find an end of a confidence band. The same number limits how often the search
/// interval for the upper end is doubled, and how often a step of Fisher scoring is halved.
const HALVINGS: usize = 40;

/// The likelihood of a noise model for the power spectrum of one axis.
pub(super) struct Likelihood<'a> {
    pub(super) powers: &'a [Power],
    /// Variance of the error of a sample due to rounding to counts. This error is white noise of known variance.
    pub(super) rounding: f64,
    /// For each kind of noise: whether the model contains it.
    pub(super) kinds: [bool; KINDS],
}

/// A vector of noise parameters, and the deviance (-2 ln L) of the model with these parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub(super) theta: PerKind,
    pub(super) deviance: f64,
}

/// The 95 % confidence band of a parameter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    pub(super) low: f64,
    pub(super) high: f64,
}

/// Permitted values of the noise parameters when the likelihood is maximised.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Domain {
    /// Parameters must not be negative, because they are power densities.
    Physical,
    /// Parameters can be negative as long as the expected value of every power is positive.
    Free,
}

impl Likelihood<'_> {
    /// Maximum-likelihood estimate with non-negative parameters.
    pub(super) fn fit(&self) -> Fit {
        self.maximize(self.start(), None, Domain::Physical)
    }

    /// Standard deviations of the parameters, computed from the Fisher information at `theta`; zero for kinds that are
    /// not in the model.
    pub(super) fn standard_deviations(&self, theta: &PerKind) -> PerKind {
        let (_, information) = self.slope(theta);
        let (matrix, scale) = scaled(&information, &self.kinds);
        let covariance = matrix.try_inverse().unwrap_or_else(Matrix4::zeros);
        std::array::from_fn(
            |kind| {
                if self.kinds[kind] { covariance[(kind, kind)].max(0.0).sqrt() * scale[kind] } else { 0.0 }
            },
        )
    }

    /// Returns by how many standard deviations the measured powers deviate from the model with the parameters `theta`.
    /// Only powers for which `of` is true are used. The sum of dof x power / expected power has a chi-square
    /// distribution. This sum is converted to a standard normal variable (Wilson and Hilferty).
    pub(super) fn excess(&self, theta: &PerKind, of: impl Fn(&Power) -> bool) -> f64 {
        let (mut chi2, mut dof) = (0.0, 0.0);
        for power in self.powers.iter().filter(|power| of(power)) {
            chi2 += power.dof * power.value / self.model(theta, power);
            dof += power.dof;
        }
        let ninth = 2.0 / (9.0 * dof);
        if dof > 0.0 { ((chi2 / dof).cbrt() - 1.0 + ninth) / ninth.sqrt() } else { 0.0 }
    }

    /// 95 % confidence band of the parameter of noise kind `kind`.
    ///
    /// The result is the union of two bands. In the first band, the parameters of the other kinds of noise are limited
    /// to values >= 0. In the second band, these parameters may be negative. The second band is needed if another kind
    /// of noise is absent, so that the true parameter of this kind is zero. With the limit >= 0, the estimate of this
    /// parameter is often exactly zero, and the first band is then nearly as narrow as if the zero were known. Such a
    /// band is too narrow.
    pub(super) fn band(&self, best: &Fit, kind: usize) -> Band {
        let std = self.standard_deviations(&best.theta);
        let free = self.maximize(best.theta, None, Domain::Free);
        let bands = [(Domain::Physical, best), (Domain::Free, &free)].map(|(domain, peak)| {
            let excess = |value: f64| {
                // The gradient of the deviance does not exist where the expected value of a power is zero. The start
                // values of the other parameters are therefore positive, so that all expected powers are positive.
                let start = std::array::from_fn(|k| if k == kind { value } else { best.theta[k].max(1e-3 * std[k]) });
                self.maximize(start, Some(kind), domain).deviance - peak.deviance - BAND
            };
            self.crossings(peak.theta[kind], std[kind], excess)
        });
        Band { low: bands[0].low.min(bands[1].low), high: bands[0].high.max(bands[1].high) }
    }

    /// The two zeros of `excess`, which are the ends of a confidence band. `excess` is negative at `peak`, the best
    /// estimate, and positive outside the band. The lower end of the band is at least zero.
    fn crossings(&self, peak: f64, std: f64, excess: impl Fn(f64) -> f64) -> Band {
        let bisect = |mut inside: f64, mut outside: f64| {
            for _ in 0..HALVINGS {
                let middle = 0.5 * (inside + outside);
                if (outside - inside).abs() <= 1e-4 * std.min(middle.abs()) {
                    break;
                }
                *(if excess(middle) < 0.0 { &mut inside } else { &mut outside }) = middle;
            }
            0.5 * (inside + outside)
        };
        let low = if peak <= 0.0 || excess(0.0) < 0.0 { 0.0 } else { bisect(peak, 0.0) };
        let (mut inside, mut step) = (peak.max(0.0), 2.0 * std);
        if peak < 0.0 && excess(0.0) >= 0.0 {
            return Band { low, high: 0.0 };
        }
        for _ in 0..HALVINGS {
            if step <= 0.0 || excess(inside + step) >= 0.0 {
                break;
            }
            inside += step;
            step *= 2.0;
        }
        Band { low, high: bisect(inside, inside + step) }
    }

    fn model(&self, theta: &PerKind, power: &Power) -> f64 {
        dot(theta, &power.expected) + self.rounding * power.expected[super::power_law::WHITE]
    }

    /// Start value of the parameter of each kind of noise: 0.1 x the smallest ratio of a measured power to the power
    /// that is expected for a parameter of one. Powers of zero are ignored.
    fn start(&self) -> PerKind {
        let least = |kind: usize| {
            let ratios = self.powers.iter().map(|power| power.value / power.expected[kind]);
            ratios.filter(|ratio| *ratio > 0.0).fold(f64::INFINITY, f64::min)
        };
        std::array::from_fn(|kind| {
            let ratio = least(kind);
            if self.kinds[kind] && ratio.is_finite() { 0.1 * ratio } else { 0.0 }
        })
    }

    fn deviance(&self, theta: &PerKind) -> f64 {
        let mut sum = 0.0;
        for power in self.powers {
            let ratio = power.value / self.model(theta, power);
            if !(ratio >= 0.0 && ratio.is_finite()) {
                return f64::INFINITY;
            }
            sum += power.dof * (ratio - 1.0 - ratio.max(f64::MIN_POSITIVE).ln());
        }
        sum
    }

    /// Returns half the negative gradient of the deviance at `theta`, and the Fisher information, which is half the
    /// expected Hessian of the deviance.
    fn slope(&self, theta: &PerKind) -> (Vector4<f64>, Matrix4<f64>) {
        let (mut slope, mut information) = (Vector4::zeros(), Matrix4::zeros());
        for power in self.powers {
            let model = self.model(theta, power);
            let row = Vector4::from(power.expected) / model;
            slope += row * (0.5 * power.dof * (power.value / model - 1.0));
            information += row * row.transpose() * (0.5 * power.dof);
        }
        (slope, information)
    }

    /// Maximises the likelihood by Fisher scoring, in which a step is halved until the deviance decreases. The
    /// parameter of the noise kind `held` keeps its start value.
    fn maximize(&self, start: PerKind, held: Option<usize>, domain: Domain) -> Fit {
        let mut best = Fit { theta: start, deviance: self.deviance(&start) };
        for _ in 0..ITERATIONS {
            let (slope, information) = self.slope(&best.theta);
            let free: [bool; KINDS] = std::array::from_fn(|kind| {
                let stays = domain == Domain::Physical && best.theta[kind] <= 0.0 && slope[kind] <= 0.0;
                self.kinds[kind] && held != Some(kind) && !stays
            });
            let (matrix, scale) = scaled(&information, &free);
            let wanted = Vector4::from_fn(|kind, _| if free[kind] { slope[kind] * scale[kind] } else { 0.0 });
            let Some(step) = matrix.lu().solve(&wanted).map(|step| step.component_mul(&scale)) else {
                break;
            };
            let try_at = |length: f64| {
                let theta = std::array::from_fn(|kind| {
                    let value = best.theta[kind] + length * step[kind];
                    if free[kind] && domain == Domain::Physical { value.max(0.0) } else { value }
                });
                Fit { theta, deviance: self.deviance(&theta) }
            };
            let lengths = std::iter::successors(Some(1.0), |length| Some(length * 0.5)).take(HALVINGS);
            let Some(next) = lengths.map(try_at).find(|next| next.deviance < best.deviance) else {
                break;
            };
            let gain = best.deviance - next.deviance;
            best = next;
            if gain < 1e-7 {
                break;
            }
        }
        best
    }
}

/// Scales the Fisher information `matrix` so that all diagonal entries are one. Returns the scaled matrix and the scale
/// factors. Scaling is needed because the parameter of a random walk is smaller than the parameter of white noise by
/// ten orders of magnitude. In the rows and columns of parameters that are not estimated (`free` is false), the matrix
/// equals the identity matrix.
fn scaled(matrix: &Matrix4<f64>, free: &[bool; KINDS]) -> (Matrix4<f64>, Vector4<f64>) {
    let scale = Vector4::from_fn(|k, _| if matrix[(k, k)] > 0.0 { matrix[(k, k)].sqrt().recip() } else { 1.0 });
    let scaled = Matrix4::from_fn(|i, j| match (free[i] && free[j], i == j) {
        (true, _) => matrix[(i, j)] * scale[i] * scale[j],
        (false, true) => 1.0,
        (false, false) => 0.0,
    });
    (scaled, scale)
}
