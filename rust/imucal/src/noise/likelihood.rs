//! Maximum likelihood of the kinds of noise, and bands that hold the truth: model.md (32).
//!
//! ```text
//! -2 log L = sum over powers of dof (P / mu - 1 - ln(P / mu)),    mu = rounding + sum over kinds of theta_k expected_k
//! ```
//!
//! theta is found by Fisher scoring, non-negative. A band is where the least deviance with this theta_k held exceeds the least
//! of all by no more than chi-square of one degree of freedom allows: such bands are right for few degrees of freedom, too,
//! where a theta scatters far from normally.

use nalgebra::{Matrix4, Vector4};

use super::cosines::Power;
use super::power_law::{KINDS, PerKind, dot};

/// 95 % of chi-square with one degree of freedom.
const BAND: f64 = 3.841_458_820_694_124;
const ITERATIONS: usize = 60;
const HALVINGS: usize = 40;

/// The powers of one axis, and which kinds may explain them.
pub(super) struct Likelihood<'a> {
    pub(super) powers: &'a [Power],
    /// Variance of the rounding to counts, white and known.
    pub(super) rounding: f64,
    /// Kinds in the model.
    pub(super) kinds: [bool; KINDS],
}

/// A point of the likelihood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub(super) theta: PerKind,
    pub(super) deviance: f64,
}

/// A parameter and its 95 % band.
#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    pub(super) low: f64,
    pub(super) high: f64,
}

/// Which values of the parameters are allowed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Domain {
    /// A density is not negative.
    Physical,
    /// Whatever leaves every power positive.
    Free,
}

impl Likelihood<'_> {
    /// The best non-negative parameters.
    pub(super) fn fit(&self) -> Fit {
        self.maximize(self.start(), None, Domain::Physical)
    }

    /// Standard deviations of the parameters, from the information at `theta`; zero for kinds that are not in the model.
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

    /// By how many standard deviations these powers together exceed the model's, as a normal number (Wilson and Hilferty).
    pub(super) fn excess(&self, theta: &PerKind, of: impl Fn(&Power) -> bool) -> f64 {
        let (mut chi2, mut dof) = (0.0, 0.0);
        for power in self.powers.iter().filter(|power| of(power)) {
            chi2 += power.dof * power.value / self.model(theta, power);
            dof += power.dof;
        }
        let ninth = 2.0 / (9.0 * dof);
        if dof > 0.0 { ((chi2 / dof).cbrt() - 1.0 + ninth) / ninth.sqrt() } else { 0.0 }
    }

    /// 95 % band of one parameter about the best fit.
    ///
    /// It holds the band of the other kinds as they can be, non-negative, and the one that lets them be negative as well. The first
    /// alone is too narrow where another kind is absent: its estimate can then only err to one side.
    pub(super) fn band(&self, best: &Fit, kind: usize) -> Band {
        let std = self.standard_deviations(&best.theta);
        let free = self.maximize(best.theta, None, Domain::Free);
        let bands = [(Domain::Physical, best), (Domain::Free, &free)].map(|(domain, peak)| {
            let excess = |value: f64| {
                // Off the edge: a power that nothing explains has no likelihood to climb.
                let start = std::array::from_fn(|k| if k == kind { value } else { best.theta[k].max(1e-3 * std[k]) });
                self.maximize(start, Some(kind), domain).deviance - peak.deviance - BAND
            };
            self.crossings(peak.theta[kind], std[kind], excess)
        });
        Band { low: bands[0].low.min(bands[1].low), high: bands[0].high.max(bands[1].high) }
    }

    /// Where `excess`, negative at `peak`, crosses zero on both sides, zero at the least.
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

    /// Of each kind a tenth of what the power that has least room for it allows.
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

    /// Half the derivative of the deviance, downwards, and its expected second one.
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

    /// Fisher scoring with steps that are halved until they help; `held` keeps its start value.
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

/// The matrix of those that are free, in units that make its diagonal one, and these units: a random walk's parameter is smaller
/// than that of white noise by ten orders of magnitude. The others have rows and columns of the identity.
fn scaled(matrix: &Matrix4<f64>, free: &[bool; KINDS]) -> (Matrix4<f64>, Vector4<f64>) {
    let scale = Vector4::from_fn(|k, _| if matrix[(k, k)] > 0.0 { matrix[(k, k)].sqrt().recip() } else { 1.0 });
    let scaled = Matrix4::from_fn(|i, j| match (free[i] && free[j], i == j) {
        (true, _) => matrix[(i, j)] * scale[i] * scale[j],
        (false, true) => 1.0,
        (false, false) => 0.0,
    });
    (scaled, scale)
}
