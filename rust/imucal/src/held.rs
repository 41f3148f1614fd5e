//! Held parameters: parameters with a normal prior, for recordings that do not determine all of them (model.md (40)).
//!
//! ```text
//! r = (h(p) - value) / sigma
//! h = b_i             bias, raw unit
//! h = T_ii / nominal  scale; the nominal sensitivity is 1 in SI units
//! h = T_ij / T_ii     misalignment: angle by which sensitive axis i is tilted towards body axis j, rad
//! ```
//!
//! Each held parameter adds one residual r to the joint fit. A held parameter is not fixed: the recordings change it as
//! far as they determine it, and the covariance of the result contains the width of the prior. All held parameters are
//! those of the symmetric body frame.

use std::fmt;
use std::ops::Range;

use faer::Mat;

use crate::error::Error;
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};

/// Default standard deviation of a misalignment of the accelerometer, rad. Datasheets give cross-axis sensitivities of
/// 2 % (MPU-6050), 1 % (ICM-42688-P) and 0.5 % (BMI088). The symmetric frame contains half of the sum of two of them.
const ACCEL_MISALIGNMENT: f64 = 0.01;
/// Default standard deviation of a misalignment of the gyroscope, rad. Datasheets give cross-axis sensitivities of 2 %
/// (MPU-6050), 1.25 % (ICM-42688-P) and 1 % (BMI088). The frame of the accelerometer adds half of the difference of two
/// of its cross-axis sensitivities.
const GYRO_MISALIGNMENT: f64 = 0.015;
/// Default standard deviation of a scale as a fraction of the nominal scale. Datasheets give 3 % (MPU-6050), 1 %
/// (LSM6DSO, BMI088) and 0.5 % (ICM-42688-P).
const SCALE: f64 = 0.03;
/// Default standard deviation of a bias of the accelerometer, m/s^2. Datasheets give 50 mg (MPU-6050) and 20 mg
/// (ICM-42688-P, BMI088, LSM6DSO).
const ACCEL_BIAS: f64 = 0.5;
/// Default standard deviation of a bias of the gyroscope, rad/s. Datasheets give 20 deg/s (MPU-6050) and 0.5 to 1 deg/s
/// (ICM-42688-P, BMI088, LSM6DSO).
const GYRO_BIAS_SIGMA: f64 = 0.35;

/// Names of the groups of parameters that can be held together.
pub const GROUPS: [&str; 6] =
    ["accel_bias", "accel_scale", "accel_misalignment", "gyro_bias", "gyro_scale", "gyro_misalignment"];

/// Parameters that a calibration estimates without a prior.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ParameterModel {
    /// All 21 parameters.
    #[default]
    Full,
    /// Biases and scales. The misalignments of both sensors are held.
    Orthogonal,
    /// Biases. The misalignments and the scales of both sensors are held.
    Bias,
}

impl ParameterModel {
    /// All models, that with the most free parameters first.
    pub const ALL: [Self; 3] = [Self::Full, Self::Orthogonal, Self::Bias];

    /// Name of the model in options and documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Orthogonal => "orthogonal",
            Self::Bias => "bias",
        }
    }

    /// The model of this name.
    ///
    /// # Errors
    /// [`Error::Input`] lists the names.
    pub fn named(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|model| model.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::Input(format!("model is {name:?}: give one of {names}"))
        })
    }

    /// Groups of parameters that the model holds.
    fn groups(self) -> &'static [&'static str] {
        match self {
            Self::Full => &[],
            Self::Orthogonal => &["accel_misalignment", "gyro_misalignment"],
            Self::Bias => &["accel_scale", "accel_misalignment", "gyro_scale", "gyro_misalignment"],
        }
    }
}

/// A request to hold one parameter, or all parameters of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct Hold {
    /// Name of the parameter, such as `accel_misalignment_xy`, or of the group, such as `accel_misalignment`.
    pub name: String,
    /// Mean of the prior; `None` for that of a perfect sensor: bias 0, scale 1, misalignment 0.
    pub value: Option<f64>,
    /// Standard deviation of the prior; `None` for that of the unit's profile, or else for the default.
    pub sigma: Option<f64>,
}

/// The priors of a calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Priors {
    /// Parameters that are estimated without a prior.
    pub model: ParameterModel,
    /// Parameters held in addition to those of the model. They replace those of the model with the same name.
    pub hold: Vec<Hold>,
    /// Standard deviations of the unit's profile: name of the group, and the value of each parameter of the group (one
    /// for all, or three for x, y and z). Biases in SI units, scales relative, misalignments in rad.
    pub profile: Vec<(String, Vec<f64>)>,
}

/// Origin of the standard deviation of a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PriorSource {
    /// Given with the request.
    Given,
    /// The unit's profile.
    Profile,
    /// The default for MEMS sensors.
    Default,
}

impl PriorSource {
    /// Name in documents: `given`, `unit` or `default`.
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
    /// Name of the parameter, such as `accel_misalignment_xy`.
    pub name: String,
    /// Mean of the prior: bias in the raw unit, scale relative to the nominal scale, misalignment in rad.
    pub value: f64,
    /// Standard deviation of the prior, in the same unit.
    pub sigma: f64,
    /// Origin of the standard deviation.
    pub source: PriorSource,
    quantity: Quantity,
}

/// Errors that the uncertainty of the held parameters leaves: one standard deviation, mean over all directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorCost {
    /// Error of the direction of gravity from the accelerometer, deg.
    pub gravity_direction_deg: f64,
    /// Error of a rotation by 90 deg from the gyroscope, deg.
    pub rotation_deg: f64,
}

/// Function h of the parameters that has the prior.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Quantity {
    /// A parameter divided by a constant.
    Entry { parameter: usize, nominal: f64 },
    /// An off-diagonal entry of a sensitivity divided by the diagonal entry of its row.
    Misalignment { parameter: usize, diagonal: usize },
}

/// Residual of a held parameter: its value, and its derivatives with the indices of the parameters.
pub(crate) struct HeldRow {
    pub(crate) residual: f64,
    pub(crate) derivatives: [(usize, f64); 2],
}

impl HeldParameter {
    /// A prior that keeps parameter `parameter` near a start value; it is not part of a result.
    pub(crate) fn near(parameter: usize, value: f64, sigma: f64) -> Self {
        let quantity = Quantity::Entry { parameter, nominal: 1.0 };
        Self { name: String::new(), value, sigma, source: PriorSource::Given, quantity }
    }

    /// Index of the parameter among the 21.
    pub(crate) fn parameter(&self) -> usize {
        match self.quantity {
            Quantity::Entry { parameter, .. } | Quantity::Misalignment { parameter, .. } => parameter,
        }
    }

    fn is_scale(&self) -> bool {
        self.name.starts_with(GROUPS[1]) || self.name.starts_with(GROUPS[4])
    }

    /// Value of the held quantity h for these parameters.
    pub(crate) fn estimate(&self, parameters: &[f64]) -> f64 {
        match self.quantity {
            Quantity::Entry { parameter, nominal } => parameters[parameter] / nominal,
            Quantity::Misalignment { parameter, diagonal } => parameters[parameter] / parameters[diagonal],
        }
    }

    /// Residual of the prior, in standard deviations. The indices count all parameters from 0.
    pub(crate) fn row(&self, parameters: &[f64]) -> HeldRow {
        let residual = (self.estimate(parameters) - self.value) / self.sigma;
        let derivatives = match self.quantity {
            Quantity::Entry { parameter, nominal } => [(parameter, 1.0 / nominal), (parameter, 0.0)],
            Quantity::Misalignment { parameter, diagonal } => {
                let scale = parameters[diagonal];
                [(parameter, 1.0 / scale), (diagonal, -parameters[parameter] / (scale * scale))]
            }
        };
        HeldRow { residual, derivatives: derivatives.map(|(p, by)| (p, by / self.sigma)) }
    }
}

/// The held parameters in one stage of the two-stage fit.
pub(crate) struct StageRows<'a> {
    held: Vec<&'a HeldParameter>,
    /// Indices of the parameters of the stage among the 21.
    stage: Range<usize>,
}

impl<'a> StageRows<'a> {
    /// The held parameters with these indices.
    pub(crate) fn new(held: &'a [HeldParameter], stage: Range<usize>) -> Self {
        Self { held: held.iter().filter(|held| stage.contains(&held.parameter())).collect(), stage }
    }

    /// Number of held parameters.
    pub(crate) fn count(&self) -> usize {
        self.held.len()
    }

    /// Indices of the held parameters, counted from the first one of the stage.
    pub(crate) fn columns(&self) -> Vec<usize> {
        self.held.iter().map(|held| held.parameter() - self.stage.start).collect()
    }

    /// Means of the priors, with the index of each parameter counted from the first one of the stage.
    pub(crate) fn scales(&self) -> impl Iterator<Item = (usize, f64)> {
        let start = self.stage.start;
        self.held.iter().filter_map(move |held| match held.quantity {
            Quantity::Entry { parameter, nominal } if held.is_scale() => {
                Some((parameter - start, held.value * nominal))
            }
            _ => None,
        })
    }

    /// Writes the residuals and their derivatives from row `first` on. `parameters` are those of the stage.
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

/// Precision of the prior of each of the 21 parameters, and the difference between the parameter and the mean of its
/// prior; zero without a prior.
pub(crate) fn precisions(held: &[HeldParameter], parameters: &[f64]) -> [(f64, f64); BASE] {
    let mut all = [(0.0, 0.0); BASE];
    for held in held {
        let HeldRow { residual, derivatives: [(p, by), _] } = held.row(parameters);
        all[p] = (by * by, residual / by);
    }
    all
}

/// Nominal sensitivity of each sensor in raw units per SI unit, accelerometer first: 1 in SI units, `None` if it is not
/// known for counts.
pub(crate) type Nominal = [Option<f64>; 2];

/// A parameter that can be held.
struct Holdable {
    name: String,
    group: &'static str,
    /// Index of its axis, for figures of a profile by axis.
    axis: usize,
    /// Value of a perfect sensor, and default standard deviation, in SI units.
    standard: (f64, f64),
    kind: Kind,
}

#[derive(Clone, Copy)]
enum Kind {
    Bias(usize),
    Scale(usize),
    Misalignment { parameter: usize, diagonal: usize },
}

const AXES: [char; 3] = ['x', 'y', 'z'];

/// All parameters that can be held, in the order of the groups.
fn holdable() -> Vec<Holdable> {
    let mut all = Vec::new();
    let mut add = |group: &'static str, suffix: String, axis: usize, standard: (f64, f64), kind: Kind| {
        all.push(Holdable { name: format!("{group}_{suffix}"), group, axis, standard, kind });
    };
    for axis in 0..3 {
        add(GROUPS[0], AXES[axis].to_string(), axis, (0.0, ACCEL_BIAS), Kind::Bias(axis));
    }
    for axis in 0..3 {
        add(GROUPS[1], AXES[axis].to_string(), axis, (1.0, SCALE), Kind::Scale(3 + axis));
    }
    for (k, (i, j)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
        let kind = Kind::Misalignment { parameter: 6 + k, diagonal: 3 + i };
        add(GROUPS[2], format!("{}{}", AXES[i], AXES[j]), i, (0.0, ACCEL_MISALIGNMENT), kind);
    }
    for axis in 0..3 {
        add(GROUPS[3], AXES[axis].to_string(), axis, (0.0, GYRO_BIAS_SIGMA), Kind::Bias(GYRO_BIAS.start + axis));
    }
    for axis in 0..3 {
        let kind = Kind::Scale(GYRO_SENSITIVITY.start + 4 * axis);
        add(GROUPS[4], AXES[axis].to_string(), axis, (1.0, SCALE), kind);
    }
    for (i, j) in [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)] {
        let entry = |i: usize, j: usize| GYRO_SENSITIVITY.start + 3 * i + j;
        let kind = Kind::Misalignment { parameter: entry(i, j), diagonal: entry(i, i) };
        add(GROUPS[5], format!("{}{}", AXES[i], AXES[j]), i, (0.0, GYRO_MISALIGNMENT), kind);
    }
    all
}

impl Priors {
    /// Whether no parameter is held.
    pub fn is_empty(&self) -> bool {
        self.model == ParameterModel::Full && self.hold.is_empty()
    }

    /// The held parameters in the order of the parameters. `nominal` is the nominal sensitivity of each sensor.
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown name, with the possible ones, for values out of range, and if the nominal
    /// sensitivity is needed and not known.
    pub(crate) fn held(&self, nominal: Nominal) -> Result<Vec<HeldParameter>, Error> {
        if self.is_empty() {
            return Ok(Vec::new());
        }
        let all = holdable();
        for hold in &self.hold {
            if !all.iter().any(|p| p.name == hold.name || p.group == hold.name) {
                return Err(Error::Input(unknown(&hold.name, &all)));
            }
            let is_wrong = |number: Option<f64>, least: f64| number.is_some_and(|n| !(n.is_finite() && n > least));
            if is_wrong(hold.value, f64::NEG_INFINITY) || is_wrong(hold.sigma, 0.0) {
                return Err(Error::Input(format!(
                    "hold {}: give a finite value, and a positive standard deviation after +-",
                    hold.name
                )));
            }
        }
        let requests: Vec<Option<&Hold>> = all
            .iter()
            .map(|p| {
                // A request for the parameter precedes one for its group.
                let of = |name: &str| self.hold.iter().rev().find(|hold| hold.name == name);
                of(&p.name).or_else(|| of(p.group))
            })
            .collect();
        let is_held =
            |p: &Holdable, request: &Option<&Hold>| request.is_some() || self.model.groups().contains(&p.group);
        let held = all.iter().zip(&requests).filter(|(p, request)| is_held(p, request));
        held.map(|(p, request)| self.prior(p, *request, nominal)).collect()
    }

    /// The prior of one parameter.
    fn prior(&self, p: &Holdable, request: Option<&Hold>, nominal: Nominal) -> Result<HeldParameter, Error> {
        let of_gyroscope = p.group.starts_with("gyro");
        let nominal = nominal[usize::from(of_gyroscope)];
        let required = || {
            let (option, unit) = if of_gyroscope { ("gyro", "rad/s") } else { ("accel", "m/s^2") };
            nominal.ok_or_else(|| {
                Error::Input(format!(
                    "{} is held, but its nominal value in counts is not known: give {option}_nominal, the nominal \
                     sensitivity in lsb per {unit}",
                    p.name
                ))
            })
        };
        let of_profile = self.profile.iter().find(|(name, _)| name == p.group).and_then(|(_, values)| {
            let value = if values.len() == 3 { values.get(p.axis) } else { values.first() };
            value.copied().filter(|sigma| sigma.is_finite() && *sigma > 0.0)
        });
        let (perfect, default) = p.standard;
        let given = request.and_then(|request| request.sigma);
        let (sigma_si, source) =
            of_profile.map_or((default, PriorSource::Default), |sigma| (sigma, PriorSource::Profile));
        // Biases are given in the raw unit, but profile and default are in SI units.
        let (quantity, sigma) = match p.kind {
            Kind::Bias(parameter) => {
                let sigma = given.map_or_else(|| Ok(sigma_si * required()?), Ok)?;
                (Quantity::Entry { parameter, nominal: 1.0 }, sigma)
            }
            Kind::Scale(parameter) => (Quantity::Entry { parameter, nominal: required()? }, given.unwrap_or(sigma_si)),
            Kind::Misalignment { parameter, diagonal } => {
                (Quantity::Misalignment { parameter, diagonal }, given.unwrap_or(sigma_si))
            }
        };
        let source = if given.is_some() { PriorSource::Given } else { source };
        let value = request.and_then(|request| request.value).unwrap_or(perfect);
        Ok(HeldParameter { name: p.name.clone(), value, sigma, source, quantity })
    }
}

fn unknown(name: &str, all: &[Holdable]) -> String {
    let groups = GROUPS.map(|group| {
        let own = all.iter().filter(|p| p.group == group);
        let suffixes: Vec<&str> = own.map(|p| &p.name[group.len()..]).collect();
        format!("{group} ({})", suffixes.join(", "))
    });
    format!(
        "hold {name:?}: there is no parameter of this name; give one of the groups, or one of its members with the \
             suffix in brackets: {}",
        groups.join(", ")
    )
}

impl fmt::Display for HeldParameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {} +- {}", self.name, self.value, self.sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hold(name: &str, value: Option<f64>, sigma: Option<f64>) -> Hold {
        Hold { name: name.into(), value, sigma }
    }

    #[test]
    fn a_request_for_a_parameter_precedes_that_for_its_group_and_the_model() {
        let priors = Priors {
            model: ParameterModel::Orthogonal,
            hold: vec![
                hold("accel_misalignment_xz", Some(0.002), Some(0.001)),
                hold("accel_misalignment", None, Some(0.005)),
            ],
            profile: vec![("gyro_misalignment".into(), vec![0.007])],
        };
        let held = priors.held([None, None]).unwrap();
        assert_eq!(held.len(), 9);
        let of = |name: &str| held.iter().find(|p| p.name == name).unwrap();
        let xz = of("accel_misalignment_xz");
        assert_eq!((xz.value, xz.sigma, xz.source), (0.002, 0.001, PriorSource::Given));
        assert_eq!(of("accel_misalignment_xy").sigma, 0.005);
        let zy = of("gyro_misalignment_zy");
        assert_eq!((zy.sigma, zy.source), (0.007, PriorSource::Profile));
    }

    #[test]
    fn an_unknown_name_and_a_missing_nominal_sensitivity_are_errors() {
        let of =
            |name: &str| Priors { hold: vec![hold(name, None, None)], ..Priors::default() }.held([None, Some(1.0)]);
        let error = of("acel_misalignment").unwrap_err().to_string();
        assert!(error.contains("accel_misalignment (_xy, _xz, _yz), gyro_bias (_x, _y, _z)"), "{error}");
        let error = of("accel_scale_x").unwrap_err().to_string();
        assert!(error.contains("give accel_nominal"), "{error}");
        assert_eq!(of("gyro_scale").unwrap().len(), 3);
    }

    #[test]
    fn the_derivatives_meet_finite_differences() {
        let priors = Priors { model: ParameterModel::Bias, ..Priors::default() };
        let parameters: Vec<f64> = (0..21).map(|p| 1.0 + 0.1 * p as f64).collect();
        for held in priors.held([Some(1.2), Some(0.8)]).unwrap() {
            let row = held.row(&parameters);
            for p in 0..21 {
                let at = |step: f64| {
                    let mut changed = parameters.clone();
                    changed[p] += step;
                    held.row(&changed).residual
                };
                let expected: f64 = row.derivatives.iter().filter(|(index, _)| *index == p).map(|(_, by)| by).sum();
                let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((difference - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{} {p}", held.name);
            }
        }
    }
}
