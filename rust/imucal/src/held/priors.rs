//! Selects the parameters with a prior and the standard deviations of their priors. A parameter gets a prior if the
//! chosen model ([`ParameterModel`]) does not leave it free, or if a request ([`Hold`]) names it.

use super::{GROUPS, HeldParameter, KnownAccelerometer, PriorSource, Quantity};
use crate::error::Error;
use crate::parameters::{GYRO_BIAS, GYRO_SENSITIVITY};

/// Default standard deviation of a misalignment of the accelerometer, rad. Datasheets specify cross-axis sensitivities
/// of 2 % (MPU-6050), 1 % (ICM-42688-P) and 0.5 % (BMI088). In the symmetric frame, a misalignment is half the sum of
/// two cross-axis sensitivities.
const ACCEL_MISALIGNMENT: f64 = 0.01;
/// Default standard deviation of a misalignment of the gyroscope, rad. Datasheets specify cross-axis sensitivities of
/// 2 % (MPU-6050), 1.25 % (ICM-42688-P) and 1 % (BMI088). The body frame is fixed to the accelerometer. The
/// misalignment of the gyroscope therefore also contains half the difference of two cross-axis sensitivities of the
/// accelerometer.
const GYRO_MISALIGNMENT: f64 = 0.015;
/// Default standard deviation of a scale as a fraction of the nominal scale. Datasheets specify scale tolerances of 3 %
/// (MPU-6050), 1 % (LSM6DSO, BMI088) and 0.5 % (ICM-42688-P). The default is the largest of them.
const SCALE: f64 = 0.03;
/// Default standard deviation of a bias of the accelerometer, m/s^2. Datasheets specify offsets of 50 mg (MPU-6050) and
/// 20 mg (ICM-42688-P, BMI088, LSM6DSO). The default corresponds to the larger of them.
const ACCEL_BIAS: f64 = 0.5;
/// Default standard deviation of a bias of the gyroscope, rad/s. Datasheets specify offsets of 20 deg/s (MPU-6050) and
/// 0.5 to 1 deg/s (ICM-42688-P, BMI088, LSM6DSO). The default corresponds to the largest of them.
const GYRO_BIAS_SIGMA: f64 = 0.35;

/// A choice of the parameters that a calibration estimates without a prior.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ParameterModel {
    /// All 21 parameters are estimated without a prior.
    #[default]
    Full,
    /// Biases and scales are estimated without a prior. The misalignments of both sensors have a prior.
    Orthogonal,
    /// Biases are estimated without a prior. The misalignments and the scales of both sensors have a prior.
    Bias,
}

impl ParameterModel {
    /// All models, in the order of decreasing number of free parameters.
    pub const ALL: [Self; 3] = [Self::Full, Self::Orthogonal, Self::Bias];

    /// Name of the model in options and JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Orthogonal => "orthogonal",
            Self::Bias => "bias",
        }
    }

    /// The model with this name.
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown name. The message lists the names.
    pub fn named(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|model| model.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::Input(format!("model is {name:?}: give one of {names}"))
        })
    }

    /// Groups of parameters for which the model has a prior.
    fn groups(self) -> &'static [&'static str] {
        match self {
            Self::Full => &[],
            Self::Orthogonal => &["accel_misalignment", "gyro_misalignment"],
            Self::Bias => &["accel_scale", "accel_misalignment", "gyro_scale", "gyro_misalignment"],
        }
    }
}

/// A request for a prior of one parameter, or of all parameters of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct Hold {
    /// Name of the parameter (for example `accel_misalignment_xy`) or of the group (for example `accel_misalignment`).
    pub name: String,
    /// Mean of the prior. `None` means the value of a sensor without errors: bias 0, scale 1, misalignment 0.
    pub value: Option<f64>,
    /// Standard deviation of the prior. `None` means the value of the unit's profile. If there is no profile, it means
    /// the default.
    pub sigma: Option<f64>,
}

/// The priors of a calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Priors {
    /// Parameters that are estimated without a prior.
    pub model: ParameterModel,
    /// Requests for priors in addition to the priors of `model`. A request replaces the prior of the model for the same
    /// parameter.
    pub hold: Vec<Hold>,
    /// Standard deviations of priors from the unit's profile. Each entry contains the name of a group, and either one
    /// value for all parameters of the group or three values for x, y and z. Biases are in SI units, scales are
    /// relative, and misalignments are in rad.
    pub profile: Vec<(String, Vec<f64>)>,
    /// An accelerometer that is already calibrated. Its prior replaces all other priors of the accelerometer.
    pub accelerometer: Option<KnownAccelerometer>,
}

/// Nominal sensitivity of each sensor in raw units per SI unit, accelerometer first. It is 1 for readings in SI units,
/// and `None` for counts with unknown sensitivity.
pub(super) type Nominal = [Option<f64>; 2];

/// A parameter for which a prior can be requested.
struct Holdable {
    name: String,
    group: &'static str,
    /// Index of the axis to which the parameter belongs. If the unit's profile contains one standard deviation per
    /// axis, this index selects the standard deviation.
    axis: usize,
    /// Value of the parameter for a sensor without errors, and the default standard deviation of its prior, in SI
    /// units.
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

/// All parameters for which a prior can be requested, in the order of the groups.
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
        self.model == ParameterModel::Full && self.hold.is_empty() && self.accelerometer.is_none()
    }

    /// Returns the held parameters (parameters with a prior) in the order of [`GROUPS`]. The linear combinations of the
    /// parameters of a calibrated accelerometer come first. `nominal` is the nominal sensitivity of each sensor.
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown name (the message lists the known names), for values out of range, and if the
    /// nominal sensitivity is needed but unknown.
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
                // A request that names the parameter has priority over a request that names its group.
                let of = |name: &str| self.hold.iter().rev().find(|hold| hold.name == name);
                of(&p.name).or_else(|| of(p.group))
            })
            .collect();
        let is_held =
            |p: &Holdable, request: &Option<&Hold>| request.is_some() || self.model.groups().contains(&p.group);
        let held = all.iter().zip(&requests).filter(|(p, request)| is_held(p, request));
        let Some(known) = &self.accelerometer else {
            return held.map(|(p, request)| self.prior(p, *request, nominal)).collect();
        };
        let of_gyroscope = held.filter(|(p, _)| p.group.starts_with("gyro"));
        let priors =
            of_gyroscope.map(|(p, request)| self.prior(p, *request, nominal)).collect::<Result<Vec<_>, _>>()?;
        Ok(known.combinations()?.into_iter().chain(priors).collect())
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
        // A request gives the standard deviation of a bias in the raw unit. The profile and the default are in SI units
        // and must be converted.
        let mut usual = Some(default);
        let (quantity, sigma) = match p.kind {
            Kind::Bias(parameter) => {
                usual = nominal.map(|nominal| default * nominal);
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
        Ok(HeldParameter { name: p.name.clone(), value, sigma, source, usual, quantity })
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
            accelerometer: None,
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
