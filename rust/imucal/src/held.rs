//! Held parameters: parameters with a normal (Gaussian) prior. Priors are needed if the recordings do not determine all
//! parameters (model.md (40)).
//!
//! ```text
//! r = (h(p) - value) / sigma
//! h = b_i             bias, raw unit
//! h = T_ii / nominal  scale; the nominal sensitivity is 1 in SI units
//! h = T_ij / T_ii     misalignment: angle by which sensitive axis i is tilted towards body axis j, rad
//! ```
//!
//! h(p) is a function of the fitted parameters p: the bias b_i of axis i, or a ratio of entries of the sensitivity T.
//! `value` and `sigma` are the mean and the standard deviation of the prior. Each held parameter adds one residual r to
//! the joint fit. A held parameter is not fixed: the recordings can change its estimate. The covariance of the result
//! includes the uncertainty of the prior. Held parameters refer to the symmetric frame, which is the body frame in
//! which the accelerometer sensitivity is a symmetric matrix.

mod known;
mod priors;

use std::ops::Range;

use faer::Mat;

use crate::parameters::BASE;
pub use known::KnownAccelerometer;
pub(crate) use known::most_changed;
pub use priors::{Hold, ParameterModel, Priors};

/// Names of the groups of parameters. A prior can be requested for all parameters of a group together.
pub const GROUPS: [&str; 6] =
    ["accel_bias", "accel_scale", "accel_misalignment", "gyro_bias", "gyro_scale", "gyro_misalignment"];

/// Origin of the standard deviation of a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PriorSource {
    /// The user gave the standard deviation.
    Given,
    /// The standard deviation is from the unit's profile, which contains known properties of this unit.
    Profile,
    /// The standard deviation is the default for MEMS sensors.
    Default,
}

impl PriorSource {
    /// Name in JSON documents: `given`, `unit` or `default`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Profile => "unit",
            Self::Default => "default",
        }
    }
}

/// One held parameter with its prior.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldParameter {
    /// Name of the parameter, for example `accel_misalignment_xy`.
    pub name: String,
    /// Mean of the prior: bias in the raw unit, scale relative to the nominal scale, misalignment in rad.
    pub value: f64,
    /// Standard deviation of the prior, in the unit of `value`.
    pub sigma: f64,
    /// Origin of the standard deviation.
    pub source: PriorSource,
    /// Default standard deviation of the prior for MEMS sensors, in the unit of `value`. `None` for a bias in counts if
    /// the nominal sensitivity is not known.
    pub usual: Option<f64>,
    quantity: Quantity,
}

/// Errors of a measured gravity direction and of a measured rotation that are due to the uncertainty of the held
/// parameters. Each error is a standard deviation. It is averaged (rms) over gravity directions or rotation axes that
/// point to the faces, edges and corners of a cube fixed to the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorCost {
    /// Error of the direction of gravity from the accelerometer, deg.
    pub gravity_direction_deg: f64,
    /// Error of a rotation by 90 deg measured by the gyroscope, deg; NaN for an accelerometer without a gyroscope.
    pub rotation_deg: f64,
}

/// Function h of the parameters. The prior of a held parameter applies to the value of h.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Quantity {
    /// A parameter divided by the constant `nominal`: the nominal sensitivity for a scale, and 1 for a bias.
    Entry { parameter: usize, nominal: f64 },
    /// An off-diagonal entry of a sensitivity divided by the diagonal entry of its row.
    Misalignment { parameter: usize, diagonal: usize },
    /// One of nine uncorrelated linear combinations of the parameters of a calibrated accelerometer. For the nine
    /// parameters p and their calibrated values `at`, the combination is `by . (p - at)`. `number` is the index of the
    /// combination, 0 to 8.
    Combination { number: usize, by: [f64; 9], at: [f64; 9] },
}

/// Residual of the prior of a held parameter, with its derivatives.
pub(crate) struct HeldRow {
    pub(crate) residual: f64,
    /// Nonzero derivatives of the residual, each with the index of its parameter.
    pub(crate) derivatives: Vec<(usize, f64)>,
}

impl HeldParameter {
    /// Creates a prior that keeps the parameter with the index `parameter` near a start value. This prior is used only
    /// inside a fit and is not part of a result.
    pub(crate) fn near(parameter: usize, value: f64, sigma: f64) -> Self {
        let quantity = Quantity::Entry { parameter, nominal: 1.0 };
        Self { name: String::new(), value, sigma, source: PriorSource::Given, usual: None, quantity }
    }

    /// Index of the parameter among the 21 base parameters. For a linear combination of parameters, it is the number of
    /// the combination (0 to 8).
    pub(crate) fn parameter(&self) -> usize {
        match self.quantity {
            Quantity::Entry { parameter, .. } | Quantity::Misalignment { parameter, .. } => parameter,
            Quantity::Combination { number, .. } => number,
        }
    }

    /// Whether the prior is part of a given calibration of the accelerometer.
    pub(crate) fn is_of_calibration(&self) -> bool {
        matches!(self.quantity, Quantity::Combination { .. })
    }

    fn is_scale(&self) -> bool {
        self.name.starts_with(GROUPS[1]) || self.name.starts_with(GROUPS[4])
    }

    /// Value of the held quantity h at these parameters.
    pub(crate) fn estimate(&self, parameters: &[f64]) -> f64 {
        match self.quantity {
            Quantity::Entry { parameter, nominal } => parameters[parameter] / nominal,
            Quantity::Misalignment { parameter, diagonal } => parameters[parameter] / parameters[diagonal],
            Quantity::Combination { by, at, .. } => (0..9).map(|p| by[p] * (parameters[p] - at[p])).sum(),
        }
    }

    /// Whether the held quantity is a linear combination of the parameters of an accelerometer that was calibrated
    /// earlier. Otherwise, it is a bias, a scale or a misalignment.
    pub(crate) fn is_combination(&self) -> bool {
        matches!(self.quantity, Quantity::Combination { .. })
    }

    /// Computes the residual of the prior, in standard deviations of the prior, and its derivatives. `parameters`
    /// begins with the first base parameter, and the indices of the derivatives are counted from this parameter.
    pub(crate) fn row(&self, parameters: &[f64]) -> HeldRow {
        let residual = (self.estimate(parameters) - self.value) / self.sigma;
        let derivatives = match self.quantity {
            Quantity::Entry { parameter, nominal } => vec![(parameter, 1.0 / nominal)],
            Quantity::Misalignment { parameter, diagonal } => {
                let scale = parameters[diagonal];
                vec![(parameter, 1.0 / scale), (diagonal, -parameters[parameter] / (scale * scale))]
            }
            Quantity::Combination { by, .. } => by.into_iter().enumerate().collect(),
        };
        HeldRow { residual, derivatives: derivatives.into_iter().map(|(p, by)| (p, by / self.sigma)).collect() }
    }
}

/// The held parameters in one stage (accelerometer or gyroscope) of the two-stage fit.
pub(crate) struct StageRows<'a> {
    held: Vec<&'a HeldParameter>,
    /// Indices of the stage's parameters among the 21 base parameters.
    stage: Range<usize>,
}

impl<'a> StageRows<'a> {
    /// The parameters in `held` that belong to the stage. `stage` contains the indices of the stage's parameters.
    pub(crate) fn new(held: &'a [HeldParameter], stage: Range<usize>) -> Self {
        Self { held: held.iter().filter(|held| stage.contains(&held.parameter())).collect(), stage }
    }

    /// Number of held parameters.
    pub(crate) fn count(&self) -> usize {
        self.held.len()
    }

    /// Indices of the held parameters, counted from the first parameter of the stage.
    pub(crate) fn columns(&self) -> Vec<usize> {
        self.held.iter().map(|held| held.parameter() - self.stage.start).collect()
    }

    /// The calibrated parameters of an accelerometer that was calibrated earlier; `None` if no prior in this stage is
    /// from such an accelerometer.
    pub(crate) fn known(&self) -> Option<[f64; 9]> {
        self.held.iter().find_map(|held| match held.quantity {
            Quantity::Combination { at, .. } => Some(at),
            _ => None,
        })
    }

    /// Index and prior mean of each held scale. The index is counted from the first parameter of the stage. The mean is
    /// an entry of the sensitivity, in raw units per SI unit.
    pub(crate) fn scales(&self) -> impl Iterator<Item = (usize, f64)> {
        let start = self.stage.start;
        self.held.iter().filter_map(move |held| match held.quantity {
            Quantity::Entry { parameter, nominal } if held.is_scale() => {
                Some((parameter - start, held.value * nominal))
            }
            _ => None,
        })
    }

    /// Writes the residuals of the priors and their derivatives to `residuals` and `jacobian`, from row `first` on.
    /// `parameters` are the parameters of the stage.
    pub(crate) fn write(&self, parameters: &[f64], first: usize, residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        let all: Vec<f64> = std::iter::repeat_n(0.0, self.stage.start).chain(parameters.iter().copied()).collect();
        for (row, held) in (first..).zip(&self.held) {
            let HeldRow { residual, derivatives } = held.row(&all);
            residuals[(row, 0)] = residual;
            (0..parameters.len()).for_each(|p| jacobian[(row, p)] = 0.0);
            derivatives.into_iter().for_each(|(p, by)| jacobian[(row, p - self.stage.start)] += by);
        }
    }
}

/// Returns, for each of the 21 parameters, the precision (inverse variance) of its prior, and the parameter minus the
/// mean of its prior. Both are zero for a parameter without a prior.
pub(crate) fn precisions(held: &[HeldParameter], parameters: &[f64]) -> [(f64, f64); BASE] {
    let mut all = [(0.0, 0.0); BASE];
    for held in held {
        let HeldRow { residual, derivatives } = held.row(parameters);
        if let Quantity::Combination { at, .. } = held.quantity {
            // The sum of the squared derivatives is the precision of a parameter if all other parameters are known.
            derivatives.into_iter().for_each(|(p, by)| all[p] = (all[p].0 + by * by, parameters[p] - at[p]));
        } else if let Some((p, by)) = derivatives.first() {
            all[*p] = (by * by, residual / by);
        }
    }
    all
}
