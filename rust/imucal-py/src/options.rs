//! Converts the options of a calibration from Python.

use imucal::calibrate::{BiasWander, Kinds, Options, References, UnitWander};
use imucal::error::Error;
use imucal::frame::Frame;
use imucal::held::{Hold, KnownAccelerometer, ParameterModel, Priors};
use pyo3::prelude::*;

use crate::arrays::UserFieldArrays;
use crate::effects::choices;
use crate::error::ToPython;

pub(crate) fn frame_named(name: &str) -> Result<Frame, Error> {
    match name {
        "symmetric" => Ok(Frame::Symmetric),
        "triangular" => Ok(Frame::Triangular),
        _ => Err(Error::Input(format!("frame is {name:?}: give symmetric or triangular"))),
    }
}

/// Bias instability and random walk of a sensor's biases, x, y and z, in SI units.
#[derive(FromPyObject)]
struct Wander {
    bias_instability: [f64; 3],
    random_walk: [f64; 3],
}

impl Wander {
    fn to_library(&self) -> BiasWander {
        BiasWander { bias_instability: self.bias_instability, random_walk: self.random_walk }
    }
}

/// Options of a calibration, converted from the attributes of `imucal.estimation.options.Options`.
#[derive(FromPyObject)]
pub(crate) struct CalibrateOptions<'py> {
    gravity_mps2: f64,
    gravity_sigma_mps2: Option<f64>,
    clock_ppm: Option<f64>,
    frame: String,
    min_rest_s: f64,
    exclude_saturated: bool,
    accel_nominal: Option<f64>,
    gyro_nominal: Option<f64>,
    /// Parameters that are estimated without a prior: "full" (all 21 parameters), "orthogonal" (biases and scales) or
    /// "bias" (biases).
    model: String,
    hold: Vec<HeldTuple>,
    /// Standard deviations of the parameters between units, from the unit profile. They are used as standard deviations
    /// of priors. For each group of parameters, for example `gyro_misalignment`: the name of the group and its standard
    /// deviations.
    profile: Vec<(String, Vec<f64>)>,
    joint: bool,
    /// Bias instability and random walk of the accelerometer and of the gyroscope.
    wander: Option<(Wander, Wander)>,
    /// For each effect in the model: its name, and the number of its parameters that are estimated.
    effects: Vec<(String, usize)>,
    /// Names of the effects that are estimated even if the data determine only some linear combinations of their
    /// parameters (`NAME:seen` on the command line). A prior determines the other linear combinations.
    partly: Vec<String>,
    user_fields: Vec<UserFieldArrays<'py>>,
    folds: Option<usize>,
    /// Nine parameters of a calibrated accelerometer in the symmetric frame, and the covariance of these parameters by
    /// rows. They are used as a prior.
    accelerometer: Option<([f64; 9], [[f64; 9]; 9])>,
    max_iterations: u64,
}

/// The prior of one parameter, or of each parameter of a group: the name of the parameter or group, and the mean and
/// the standard deviation of the prior. None stands for the default mean or the default standard deviation.
pub(crate) type HeldTuple = (String, Option<f64>, Option<f64>);

pub(crate) fn priors(model: &str, hold: &[HeldTuple], profile: &[(String, Vec<f64>)]) -> Result<Priors, Error> {
    let hold = hold.iter().map(|(name, value, sigma)| Hold { name: name.clone(), value: *value, sigma: *sigma });
    let model = ParameterModel::named(model)?;
    Ok(Priors { model, hold: hold.collect(), profile: profile.to_vec(), accelerometer: None })
}

impl CalibrateOptions<'_> {
    pub(crate) fn options(&self, py: Python<'_>) -> PyResult<Options<'_>> {
        let effects = choices(&self.effects);
        Ok(Options {
            gravity_mps2: self.gravity_mps2,
            references: References {
                gravity_sigma_mps2: self.gravity_sigma_mps2.unwrap_or(0.0),
                clock_ppm: self.clock_ppm.unwrap_or(0.0),
            },
            frame: frame_named(&self.frame).to_python(py)?,
            min_rest_s: self.min_rest_s,
            exclude_saturated: self.exclude_saturated,
            accel_nominal: self.accel_nominal,
            gyro_nominal: self.gyro_nominal,
            priors: Priors {
                accelerometer: self
                    .accelerometer
                    .map(|(parameters, covariance)| KnownAccelerometer { parameters, covariance }),
                ..priors(&self.model, &self.hold, &self.profile).to_python(py)?
            },
            joint: self.joint,
            wander: self.wander.as_ref().map(|(accelerometer, gyroscope)| UnitWander {
                accelerometer: accelerometer.to_library(),
                gyroscope: gyroscope.to_library(),
            }),
            effects: effects.to_python(py)?,
            partly: self.partly.clone(),
            user_fields: self.user_fields.iter().map(|field| field.view(py)).collect::<PyResult<_>>()?,
            kinds: Kinds::default(),
            folds: self.folds,
            max_iterations: self.max_iterations,
        })
    }
}
