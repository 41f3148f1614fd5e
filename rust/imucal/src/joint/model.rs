//! The model of both sensors that the joint fit estimates, and its conversion to and from the parameter vector.

use std::ops::Range;

use imucal_core::effects::Surroundings;
use imucal_core::sensor::Triad;
use nalgebra::{SMatrix, Vector3};

use super::terms::Terms;
use crate::error::Error;
use crate::frame::SYMMETRIC;
use crate::parameters::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use crate::two_stage::{accelerometer, gyroscope};

/// Sensitivity and bias of both sensors, the parameters of the effects, and the parameters of the stand.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) accelerometer: Triad<f64>,
    pub(crate) gyroscope: Triad<f64>,
    pub(crate) values: Vec<f64>,
    /// Parameters of the stand, rad: mount rotation (3), base tilt (2), non-orthogonality of the axes (2), zero error
    /// of the second motor (1). Empty without encoder effects.
    pub(crate) stand: Vec<f64>,
}

impl Model {
    pub(crate) fn of(parameters: &[f64], terms: &Terms<'_>) -> Result<Self, Error> {
        let bias = Vector3::from_column_slice(&parameters[GYRO_BIAS]);
        Ok(Self {
            accelerometer: accelerometer::triad_of(&parameters[ACCEL])?,
            gyroscope: gyroscope::triad_of(&parameters[GYRO_SENSITIVITY], bias)?,
            values: parameters[BASE..BASE + terms.count].to_vec(),
            stand: parameters[BASE + terms.count..].to_vec(),
        })
    }

    pub(crate) fn parameters(&self) -> Vec<f64> {
        let entries = SYMMETRIC.map(|(i, j)| self.accelerometer.sensitivity()[(i, j)]);
        let rows = self.gyroscope.sensitivity().transpose();
        let base =
            self.accelerometer.bias().iter().chain(&entries).chain(self.gyroscope.bias().iter()).chain(rows.iter());
        base.chain(&self.values).chain(&self.stand).copied().collect()
    }
}

/// Computes the derivative of the corrected force `seen = T^-1 (m - b)` with respect to the nine accelerometer
/// parameters, a 3 x 9 matrix. m is the measured force in raw units. The parameters are the bias b (x, y, z) and the
/// six entries of the symmetric sensitivity T.
pub(crate) fn force_by_parameters(accelerometer: &Triad<f64>, seen: &Vector3<f64>) -> SMatrix<f64, 3, 9> {
    let inverse = -accelerometer.inverse();
    let mut columns = SMatrix::<f64, 3, 9>::zeros();
    columns.fixed_columns_mut::<3>(0).copy_from(&inverse);
    for (p, (i, j)) in SYMMETRIC.into_iter().enumerate() {
        let mut column = inverse.column(i) * seen[j];
        if i != j {
            column += inverse.column(j) * seen[i];
        }
        columns.set_column(3 + p, &column);
    }
    columns
}

/// Temperature (minus the reference temperature) and time (since the first sample) of the sample `index`. Effects
/// depend on them.
pub(crate) fn surroundings(recording: &Recording<'_>, index: usize) -> Surroundings<f64> {
    Surroundings {
        temperature_difference_k: recording.temperature_degc.map(|t| t[index] - REFERENCE_TEMPERATURE_DEGC),
        time_s: Some(recording.time_s[index] - recording.time_s[0]),
        ..Surroundings::unknown()
    }
}

/// Number of parts into which a rest is divided to average temperature and time. It is large enough to resolve drifts
/// and warm-up within a rest.
const PARTS: usize = 16;

/// A part of a rest, with the mean temperature and time on which effects depend.
pub(super) struct Part {
    pub(super) samples: Range<usize>,
    /// Mean temperature and mean time of the samples of the part.
    pub(super) surroundings: Surroundings<f64>,
}

/// Divides the samples `range` of a rest into at most `PARTS` parts of about equal size.
pub(super) fn parts(recording: &Recording<'_>, range: Range<usize>) -> Vec<Part> {
    let parts = PARTS.min(range.len()).max(1);
    let edge = |part: usize| range.start + range.len() * part / parts;
    let part = |part: usize| {
        let samples = edge(part)..edge(part + 1);
        Part { surroundings: mean_surroundings(recording, samples.clone()), samples }
    };
    (0..parts).map(part).collect()
}

/// Mean temperature and time over a non-empty range of samples.
#[inline]
pub(super) fn mean_surroundings(recording: &Recording<'_>, range: Range<usize>) -> Surroundings<f64> {
    let mean = |values: &[f64]| {
        let values = &values[range.clone()];
        // Subtracting the first value avoids cancellation for large time stamps. Four independent sums are formed,
        // because the processor can add them in parallel.
        let (first, (fours, rest)) = (values[0], values.as_chunks::<4>());
        let mut sums = [0.0; 4];
        fours.iter().for_each(|four| sums.iter_mut().zip(four).for_each(|(sum, value)| *sum += value - first));
        let sum = sums.iter().sum::<f64>() + rest.iter().map(|value| value - first).sum::<f64>();
        first + sum / values.len() as f64
    };
    Surroundings {
        temperature_difference_k: recording.temperature_degc.map(|t| mean(t) - REFERENCE_TEMPERATURE_DEGC),
        time_s: Some(mean(recording.time_s) - recording.time_s[0]),
        ..Surroundings::unknown()
    }
}
