//! Converts arrays between Python and Rust.
//!
//! `as_slice` of rust-numpy accepts Fortran-ordered arrays as contiguous and returns them column by column. This module
//! therefore verifies that all arrays are in C order. The Python package converts its arrays beforehand; other callers
//! get an error for an array in another order.

use imucal::calibrate::{MeanNoise, MeanReadings, UserField};
use imucal::check::sensor_missing;
use imucal::error::Error;
use imucal::recording::{RawUnit, Recording, Samples};
use imucal_core::effects::Sensor;
use nalgebra::{Matrix3, Vector3};
use numpy::{Element, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::ToPython;

/// Arrays, name and units of an `imucal.Recording`, read from its attributes.
#[derive(FromPyObject)]
pub(crate) struct RecordingColumns<'py> {
    name: String,
    time_s: PyReadonlyArray1<'py, f64>,
    specific_force: Option<SampleArray<'py>>,
    angular_rate: Option<SampleArray<'py>>,
    temperature_degc: Option<PyReadonlyArray1<'py, f64>>,
    stand_rad: Option<PyReadonlyArray2<'py, f64>>,
    accel_unit: String,
    gyro_unit: String,
    column_units: (Option<String>, Option<String>),
}

impl RecordingColumns<'_> {
    /// The recordings in the form that the library uses, without a copy of the arrays. This function is for callers
    /// that need both sensors. It raises InputError with the finding `sensor_missing` for a recording with only one
    /// sensor.
    pub(crate) fn views<'a>(py: Python<'_>, recordings: &'a [Self]) -> PyResult<Vec<Recording<'a>>> {
        let views = Self::views_of_any(py, recordings)?;
        let missing: Vec<_> = views.iter().filter_map(sensor_missing).collect();
        if missing.is_empty() { Ok(views) } else { Err(Error::Data(missing)).to_python(py) }
    }

    /// Like [`Self::views`], but for a function that needs only one sensor. Recordings with only one sensor are
    /// accepted.
    pub(crate) fn views_of_any<'a>(py: Python<'_>, recordings: &'a [Self]) -> PyResult<Vec<Recording<'a>>> {
        recordings
            .iter()
            .map(|r| {
                let samples = |sensor: &'a Option<SampleArray<'_>>, name: &str| match sensor {
                    Some(array) => array.view(py, name),
                    None => Ok(Samples::Absent(r.time_s.as_array().len())),
                };
                Ok(Recording {
                    name: &r.name,
                    time_s: column(py, &r.time_s, "time_s")?,
                    specific_force: samples(&r.specific_force, "specific_force")?,
                    angular_rate: samples(&r.angular_rate, "angular_rate")?,
                    temperature_degc: match &r.temperature_degc {
                        Some(values) => Some(column(py, values, "temperature_degc")?),
                        None => None,
                    },
                    stand_rad: match &r.stand_rad {
                        Some(values) => Some(rows(py, values, "stand_rad")?),
                        None => None,
                    },
                    accel_unit: raw_unit(&r.accel_unit),
                    gyro_unit: raw_unit(&r.gyro_unit),
                    column_units: [r.column_units.0.as_deref(), r.column_units.1.as_deref()],
                })
            })
            .collect()
    }
}

/// Arrays, name and units of an `imucal.Means` (a table of mean readings at rests), read from its attributes.
#[derive(FromPyObject)]
pub(crate) struct MeanColumns<'py> {
    name: String,
    specific_force: PyReadonlyArray2<'py, f64>,
    angular_rate: Option<PyReadonlyArray2<'py, f64>>,
    specific_force_std: Option<PyReadonlyArray2<'py, f64>>,
    accel_unit: String,
    gyro_unit: String,
}

impl MeanColumns<'_> {
    /// The table in the form that the library uses, without a copy of the arrays. `noise_mps2` is the standard
    /// deviation of every mean. It is used if the table contains no standard deviations.
    pub(crate) fn view(&self, py: Python<'_>, noise_mps2: Option<f64>) -> PyResult<MeanReadings<'_>> {
        Ok(MeanReadings {
            name: &self.name,
            specific_force: rows(py, &self.specific_force, "specific_force")?,
            angular_rate: match &self.angular_rate {
                Some(values) => Some(rows(py, values, "angular_rate")?),
                None => None,
            },
            accel_unit: raw_unit(&self.accel_unit),
            gyro_unit: raw_unit(&self.gyro_unit),
            noise: match (&self.specific_force_std, noise_mps2) {
                (Some(values), _) => MeanNoise::Each(rows(py, values, "specific_force_std")?),
                (None, Some(noise)) => MeanNoise::Common(noise),
                (None, None) => MeanNoise::Unknown,
            },
        })
    }
}

/// Samples of a triad, (N, 3), in the number type of the Python array.
#[derive(FromPyObject)]
enum SampleArray<'py> {
    F64(PyReadonlyArray2<'py, f64>),
    F32(PyReadonlyArray2<'py, f32>),
    I16(PyReadonlyArray2<'py, i16>),
}

impl SampleArray<'_> {
    fn view(&self, py: Python<'_>, name: &str) -> PyResult<Samples<'_>> {
        Ok(match self {
            Self::F64(array) => Samples::F64(rows(py, array, name)?),
            Self::F32(array) => Samples::F32(rows(py, array, name)?),
            Self::I16(array) => Samples::I16(rows(py, array, name)?),
        })
    }
}

/// A user-defined effect, evaluated at each sample of each recording.
#[derive(FromPyObject)]
pub(crate) struct UserFieldArrays<'py> {
    name: String,
    sensor: String,
    typical: Vec<f64>,
    /// For each recording, an array (N, 3, p): the derivatives of the error on the three axes with respect to the p
    /// parameters of the effect, at each of the N samples.
    columns: Vec<PyReadonlyArray3<'py, f64>>,
}

impl UserFieldArrays<'_> {
    /// The effect as the type that the library uses, without a copy of the arrays.
    pub(crate) fn view(&self, py: Python<'_>) -> PyResult<UserField<'_>> {
        let sensor = match self.sensor.as_str() {
            "accelerometer" => Ok(Sensor::Accelerometer),
            "gyroscope" => Ok(Sensor::Gyroscope),
            other => Err(Error::Input(format!("{}: sensor is {other:?}: give accelerometer or gyroscope", self.name))),
        };
        let columns = self.columns.iter().map(|array| match array.as_slice() {
            Ok(values) if array.is_c_contiguous() => Ok(values),
            _ => Err(Error::Input(format!("the field of {} is not in C order", self.name))).to_python(py),
        });
        Ok(UserField {
            name: &self.name,
            sensor: sensor.to_python(py)?,
            typical: self.typical.clone(),
            columns: columns.collect::<PyResult<_>>()?,
        })
    }
}

fn raw_unit(name: &str) -> RawUnit {
    if name == "lsb" { RawUnit::Lsb } else { RawUnit::Si }
}

/// Returns the values of an array (N,), without a copy.
pub(crate) fn column<'a>(py: Python<'_>, array: &'a PyReadonlyArray1<'_, f64>, name: &str) -> PyResult<&'a [f64]> {
    match array.as_slice() {
        Ok(values) if array.is_c_contiguous() => Ok(values),
        _ => Err(Error::Input(format!("{name} is strided: pass numpy.ascontiguousarray of it"))).to_python(py),
    }
}

/// Returns the rows of an array (N, 3), which must be in C order, without a copy.
pub(crate) fn rows<'a, T: Element>(
    py: Python<'_>,
    array: &'a PyReadonlyArray2<'_, T>,
    name: &str,
) -> PyResult<&'a [[T; 3]]> {
    if array.shape()[1] != 3 {
        let shape = array.shape();
        return Err(Error::Input(format!("{name} has shape ({}, {}), (N, 3) is needed", shape[0], shape[1])))
            .to_python(py);
    }
    match array.as_slice() {
        Ok(values) if array.is_c_contiguous() => Ok(values.as_chunks::<3>().0),
        _ => Err(Error::Input(format!("{name} is not in C order: pass numpy.ascontiguousarray of it"))).to_python(py),
    }
}

/// Converts an array (3, 3) to a matrix.
pub(crate) fn matrix(py: Python<'_>, array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Matrix3<f64>> {
    match rows(py, array, name)? {
        [x, y, z] => Ok(Matrix3::from_rows(&[(*x).into(), (*y).into(), (*z).into()])),
        other => Err(Error::Input(format!("{name} has {} rows, 3 are needed", other.len()))).to_python(py),
    }
}

/// Converts an array (3,) to a vector.
pub(crate) fn vector(py: Python<'_>, array: &PyReadonlyArray1<'_, f64>, name: &str) -> PyResult<Vector3<f64>> {
    match column(py, array, name)? {
        &[x, y, z] => Ok(Vector3::new(x, y, z)),
        other => Err(Error::Input(format!("{name} has {} entries, 3 are needed", other.len()))).to_python(py),
    }
}

/// A new NumPy array (N, W) from N rows of W numbers.
pub(crate) fn to_rows<const W: usize>(py: Python<'_>, values: Vec<[f64; W]>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let shape = [values.len(), W];
    numpy::PyArrayMethods::reshape(&numpy::PyArray1::from_vec(py, values.into_flattened()), shape)
}
