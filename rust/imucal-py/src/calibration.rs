//! Converts calibrations from Python objects to the types of the library.

use imucal::error::Error;
use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays::{matrix, vector};
use crate::effects::EffectArrays;
use crate::error::ToPython;

/// An `imucal.Triad`, converted from its attributes sensitivity (3, 3) and bias (3,).
#[derive(FromPyObject)]
pub(crate) struct TriadArrays<'py> {
    sensitivity: PyReadonlyArray2<'py, f64>,
    bias: PyReadonlyArray1<'py, f64>,
}

impl TriadArrays<'_> {
    pub(crate) fn triad(&self, py: Python<'_>, name: &str) -> PyResult<Triad<f64>> {
        let sensitivity = matrix(py, &self.sensitivity, &format!("sensitivity of the {name}"))?;
        let bias = vector(py, &self.bias, &format!("bias of the {name}"))?;
        Triad::try_new(sensitivity, bias).map_err(|error| Error::Input(format!("{name}: {error}"))).to_python(py)
    }
}

/// An `imucal.Calibration`, converted from its attributes.
#[derive(FromPyObject)]
pub(crate) struct CalibrationArrays<'py> {
    accelerometer: TriadArrays<'py>,
    gyroscope: Option<TriadArrays<'py>>,
    effects: Vec<EffectArrays<'py>>,
}

impl CalibrationArrays<'_> {
    /// The calibration of both sensors. Raises InputError for an accelerometer without a gyroscope.
    pub(crate) fn calibration(&self, py: Python<'_>) -> PyResult<Calibration<f64>> {
        let Some(gyroscope) = &self.gyroscope else {
            let message = "the calibration has no gyroscope, and this needs one [sensor_missing]: calibrate both sensors; \
                           docs/one-sensor.md lists what one sensor alone allows";
            return Err(Error::Input(message.into())).to_python(py);
        };
        Ok(Calibration {
            accelerometer: self.accelerometer.triad(py, "accelerometer")?,
            gyroscope: gyroscope.triad(py, "gyroscope")?,
            effects: EffectArrays::set(py, &self.effects)?,
        })
    }
}
