//! A recording: what one unit measured, as borrowed columns.
//!
//! Rows are samples. Time is in seconds; a triad is either in SI units (m/s^2, rad/s) or in raw counts (`lsb`).
//! A still sensor reads +g on the axis that points up.

use crate::error::Error;

/// The temperature, degC, that sensitivities and biases are for: the effects of temperature count from here.
pub const REFERENCE_TEMPERATURE_DEGC: f64 = 25.0;

/// The unit in which a triad's samples are given. Physical units (g, deg/s, ...) are converted to SI on reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawUnit {
    /// m/s^2 for the accelerometer, rad/s for the gyroscope.
    Si,
    /// Raw counts of the converter.
    Lsb,
}

/// Borrowed columns of one recording; all columns have the same length.
#[derive(Clone, Copy, Debug)]
pub struct Recording<'a> {
    /// What messages call this recording, usually the file's name.
    pub name: &'a str,
    /// Time of each sample, s.
    pub time_s: &'a [f64],
    /// Accelerometer, in `accel_unit`.
    pub specific_force: &'a [[f64; 3]],
    /// Gyroscope, in `gyro_unit`.
    pub angular_rate: &'a [[f64; 3]],
    /// Temperature, degC.
    pub temperature_degc: Option<&'a [f64]>,
    /// Angles of the stand's motors from their encoders, rad.
    pub stand_rad: Option<&'a [[f64; 3]]>,
    /// Unit of `specific_force`.
    pub accel_unit: RawUnit,
    /// Unit of `angular_rate`.
    pub gyro_unit: RawUnit,
}

impl<'a> Recording<'a> {
    /// A recording in SI units, without temperature and encoders.
    ///
    /// # Errors
    /// [`Error::Input`] if the columns differ in length.
    pub fn try_new(
        name: &'a str,
        time_s: &'a [f64],
        specific_force: &'a [[f64; 3]],
        angular_rate: &'a [[f64; 3]],
    ) -> Result<Self, Error> {
        let recording = Self {
            name,
            time_s,
            specific_force,
            angular_rate,
            temperature_degc: None,
            stand_rad: None,
            accel_unit: RawUnit::Si,
            gyro_unit: RawUnit::Si,
        };
        recording.check_lengths()?;
        Ok(recording)
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no sample at all.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Whether the temperature of every sample is known.
    pub(crate) fn has_temperature(&self) -> bool {
        self.temperature_degc.is_some_and(|column| column.iter().all(|degc| degc.is_finite()))
    }

    /// Whether the stand's angles are known at every sample.
    pub(crate) fn has_stand(&self) -> bool {
        self.stand_rad.is_some_and(|rows| rows.iter().flatten().all(|angle| angle.is_finite()))
    }

    /// Every column must have as many rows as there are time stamps.
    pub(crate) fn check_lengths(&self) -> Result<(), Error> {
        let n = self.len();
        let columns = [
            ("specific_force", Some(self.specific_force.len())),
            ("angular_rate", Some(self.angular_rate.len())),
            ("temperature_degc", self.temperature_degc.map(<[f64]>::len)),
            ("stand_rad", self.stand_rad.map(<[[f64; 3]]>::len)),
        ];
        match columns.iter().find(|(_, len)| len.is_some_and(|len| len != n)) {
            None => Ok(()),
            Some((column, len)) => Err(Error::Input(format!(
                "{}: {column} has {} rows but time_s has {n}: all columns need one row per sample",
                self.name,
                len.unwrap_or(0)
            ))),
        }
    }
}
