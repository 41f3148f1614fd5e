//! A recording: the measurements of one inertial measurement unit. The columns are borrowed arrays of the caller.
//!
//! Each row is one sample. Time is in seconds. The samples of each three-axis sensor (triad) are in SI units (m/s^2,
//! rad/s) or in raw counts (`lsb`). An accelerometer at rest reads +g on the axis that points up.

use std::borrow::Cow;
use std::ops::Range;

use crate::error::Error;

/// Reference temperature of sensitivities and biases, degC. Effects of temperature are functions of the difference
/// (temperature of the unit) - (this reference).
pub const REFERENCE_TEMPERATURE_DEGC: f64 = 25.0;

/// A time step of at least this length is a pause in the recording, s. Every inertial sensor that can be calibrated has
/// a shorter sampling interval.
const PAUSE_S: f64 = 1.0;

/// Unit of the samples of a three-axis sensor. Other physical units (g, deg/s, ...) are converted to SI when a file is
/// read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawUnit {
    /// SI: m/s^2 for the accelerometer, rad/s for the gyroscope.
    Si,
    /// Counts of the analogue-to-digital converter.
    Lsb,
}

/// Samples of a three-axis sensor: N rows of three values. The samples keep the number type of the caller's array, so
/// that no copy is needed.
#[derive(Clone, Copy, Debug)]
pub enum Samples<'a> {
    /// Double precision.
    F64(&'a [[f64; 3]]),
    /// Single precision.
    F32(&'a [[f32; 3]]),
    /// 16-bit counts.
    I16(&'a [[i16; 3]]),
    /// The sensor is missing in a recording with this number of samples. Every value is NaN, so that an absent sensor
    /// differs from a sensor that reads zero.
    Absent(usize),
}

impl<'a> Samples<'a> {
    /// Number of samples.
    pub fn len(self) -> usize {
        match self {
            Self::F64(rows) => rows.len(),
            Self::F32(rows) => rows.len(),
            Self::I16(rows) => rows.len(),
            Self::Absent(samples) => samples,
        }
    }

    /// Whether there are no samples.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Whether the sensor is missing.
    pub fn is_absent(self) -> bool {
        matches!(self, Self::Absent(_))
    }

    /// One sample as f64.
    #[inline(always)]
    pub fn at(self, sample: usize) -> [f64; 3] {
        match self {
            Self::F64(rows) => rows[sample],
            Self::F32(rows) => widened(rows[sample]),
            Self::I16(rows) => widened(rows[sample]),
            Self::Absent(_) => [f64::NAN; 3],
        }
    }

    /// Consecutive samples as f64: borrowed if they are stored as f64, otherwise copied.
    #[inline(always)]
    pub fn part(self, samples: Range<usize>) -> Cow<'a, [[f64; 3]]> {
        match self {
            Self::F64(rows) => Cow::Borrowed(&rows[samples]),
            Self::F32(rows) => Cow::Owned(rows[samples].iter().copied().map(widened).collect()),
            Self::I16(rows) => Cow::Owned(rows[samples].iter().copied().map(widened).collect()),
            Self::Absent(_) => Cow::Owned(vec![[f64::NAN; 3]; samples.len()]),
        }
    }

    /// A range of samples in the same number type, without a copy.
    #[must_use]
    pub fn slice(self, samples: Range<usize>) -> Self {
        match self {
            Self::F64(rows) => Self::F64(&rows[samples]),
            Self::F32(rows) => Self::F32(&rows[samples]),
            Self::I16(rows) => Self::I16(&rows[samples]),
            Self::Absent(_) => Self::Absent(samples.len()),
        }
    }

    /// All samples in order, as f64.
    #[inline(always)]
    pub fn iter(self) -> impl ExactSizeIterator<Item = [f64; 3]> + DoubleEndedIterator + Clone + 'a {
        (0..self.len()).map(move |sample| self.at(sample))
    }

    /// One axis of all samples, as f64.
    #[inline(always)]
    pub fn axis(self, axis: usize) -> impl ExactSizeIterator<Item = f64> + DoubleEndedIterator + Clone + 'a {
        self.iter().map(move |row| row[axis])
    }

    /// Calls `each` with every pair of consecutive values of one axis. The number type is selected once for all
    /// pairs, instead of once for each pair.
    #[inline(always)]
    pub(crate) fn neighbours(self, axis: usize, each: impl FnMut(f64, f64)) {
        match self {
            Self::F64(rows) => neighbours_of(rows, axis, each),
            Self::F32(rows) => neighbours_of(rows, axis, each),
            Self::I16(rows) => neighbours_of(rows, axis, each),
            Self::Absent(_) => {}
        }
    }
}

#[inline(always)]
fn neighbours_of<T: Into<f64> + Copy>(rows: &[[T; 3]], axis: usize, mut each: impl FnMut(f64, f64)) {
    for (before, after) in rows.iter().zip(rows.get(1..).unwrap_or_default()) {
        each(before[axis].into(), after[axis].into());
    }
}

/// Number of values processed together in [`each_step`]: eight rows of three axes. A vector register has at most eight
/// lanes, so 24 values fill whole registers.
pub(crate) const SIDE_BY_SIDE: usize = 3 * 8;

/// Calls `each` for every number of every row except the last row. The arguments are an index, the number, and the
/// number of the same axis in the next row. The index counts from 0 within each group of [`SIDE_BY_SIDE`] numbers, and
/// the index modulo 3 is the axis.
#[inline(always)]
pub(crate) fn each_step(rows: &[[f64; 3]], mut each: impl FnMut(usize, f64, f64)) {
    let after = rows.get(1..).unwrap_or_default().as_flattened();
    let (fulls_before, before) = rows.as_flattened()[..after.len()].as_chunks::<SIDE_BY_SIDE>();
    let (fulls_after, after) = after.as_chunks::<SIDE_BY_SIDE>();
    for (before, after) in fulls_before.iter().zip(fulls_after) {
        (0..SIDE_BY_SIDE).for_each(|k| each(k, before[k], after[k]));
    }
    before.iter().zip(after).enumerate().for_each(|(k, (before, after))| each(k, *before, *after));
}

#[inline(always)]
fn widened<T: Into<f64>>([x, y, z]: [T; 3]) -> [f64; 3] {
    [x.into(), y.into(), z.into()]
}

macro_rules! samples_from {
    ($($kind:ty => $kept:ident),*) => {$(
        impl<'a> From<&'a [[$kind; 3]]> for Samples<'a> {
            fn from(rows: &'a [[$kind; 3]]) -> Self {
                Self::$kept(rows)
            }
        }

        impl<'a> From<&'a Vec<[$kind; 3]>> for Samples<'a> {
            fn from(rows: &'a Vec<[$kind; 3]>) -> Self {
                Self::$kept(rows)
            }
        }
    )*};
}

samples_from!(f64 => F64, f32 => F32, i16 => I16);

impl<'a, const N: usize> From<&'a [[f64; 3]; N]> for Samples<'a> {
    fn from(rows: &'a [[f64; 3]; N]) -> Self {
        Self::F64(rows)
    }
}

/// Borrowed columns of a recording; all columns have the same length.
#[derive(Clone, Copy, Debug)]
pub struct Recording<'a> {
    /// Name of the recording in messages, usually the name of its file.
    pub name: &'a str,
    /// Time of each sample, s.
    pub time_s: &'a [f64],
    /// Samples of the accelerometer, in `accel_unit`; [`Samples::Absent`] if only a gyroscope was recorded.
    pub specific_force: Samples<'a>,
    /// Samples of the gyroscope, in `gyro_unit`; [`Samples::Absent`] if only an accelerometer was recorded.
    pub angular_rate: Samples<'a>,
    /// Temperature of the unit at each sample, degC; `None` if unknown.
    pub temperature_degc: Option<&'a [f64]>,
    /// Motor angles that the encoders of the stand read at each sample, rad; `None` without a stand.
    pub stand_rad: Option<&'a [[f64; 3]]>,
    /// Unit of `specific_force`.
    pub accel_unit: RawUnit,
    /// Unit of `angular_rate`.
    pub gyro_unit: RawUnit,
    /// Units of the accelerometer and gyroscope columns in the file that was read, as written in its column names (`g`,
    /// `dps`); `None` if unknown. Only messages use them.
    pub column_units: [Option<&'a str>; 2],
}

impl<'a> Recording<'a> {
    /// A recording in SI units, without temperature and encoder angles.
    ///
    /// # Errors
    /// [`Error::Input`] if the columns have different lengths.
    pub fn try_new(
        name: &'a str,
        time_s: &'a [f64],
        specific_force: impl Into<Samples<'a>>,
        angular_rate: impl Into<Samples<'a>>,
    ) -> Result<Self, Error> {
        let recording = Self {
            name,
            time_s,
            specific_force: specific_force.into(),
            angular_rate: angular_rate.into(),
            temperature_degc: None,
            stand_rad: None,
            accel_unit: RawUnit::Si,
            gyro_unit: RawUnit::Si,
            column_units: [None; 2],
        };
        recording.check_lengths()?;
        Ok(recording)
    }

    /// This recording without its gyroscope.
    #[must_use]
    pub fn accelerometer_alone(&self) -> Self {
        Self { angular_rate: Samples::Absent(self.len()), gyro_unit: RawUnit::Si, ..*self }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Mean sampling rate, Hz: the number of time steps divided by the sum of the time steps, without pauses (see
    /// `PAUSE_S`). If every time step is a pause, all time steps are counted. NaN if the time does not increase.
    ///
    /// The median time step is not used. If samples come in bursts, or if the resolution of the time stamps is coarse,
    /// the median may differ from the mean time step by ten per cent or more.
    pub fn mean_rate_hz(&self) -> f64 {
        let of = |is_counted: &dyn Fn(f64) -> bool| {
            let steps = self.time_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step_s| is_counted(*step_s));
            steps.fold((0.0, 0.0), |(count, sum_s), step_s| (count + 1.0, sum_s + step_s))
        };
        let (count, sum_s) = match of(&|step_s| step_s < PAUSE_S) {
            (0.0, _) => of(&|step_s| step_s.is_finite()),
            counted => counted,
        };
        if sum_s > 0.0 { count / sum_s } else { f64::NAN }
    }

    /// Time of the first and of the last sample, s.
    pub(crate) fn span_s(&self) -> [f64; 2] {
        [self.time_s[0], self.time_s[self.len() - 1]]
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Whether the temperature of every sample is known and finite.
    pub(crate) fn has_temperature(&self) -> bool {
        self.temperature_degc.is_some_and(|column| column.iter().all(|degc| degc.is_finite()))
    }

    /// Whether the motor angles of every sample are known and finite.
    pub(crate) fn has_stand(&self) -> bool {
        self.stand_rad.is_some_and(|rows| rows.iter().flatten().all(|angle| angle.is_finite()))
    }

    /// Checks that every column has as many rows as there are time stamps.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_all_samples_without_pauses() {
        let rows = vec![[0.0; 3]; 3000];
        let rate_hz = |stamp_s: &dyn Fn(usize) -> f64| {
            let time_s: Vec<f64> = (0..3000).map(stamp_s).collect();
            Recording::try_new("r", &time_s, &rows, &rows).unwrap().mean_rate_hz()
        };
        // Nine of ten steps are 11 ms and one is 1 ms, so the median step is 11 ms and the mean step is 10 ms.
        let bursts = rate_hz(&|i| (i / 10) as f64 * 0.1 + (i % 10) as f64 * 0.011);
        assert!((bursts - 100.0).abs() < 0.05, "{bursts}");
        let paused = rate_hz(&|i| i as f64 * 0.01 + if i < 1000 { 0.0 } else { 600.0 });
        assert!((paused - 100.0).abs() < 1e-6, "{paused}");
        assert!((rate_hz(&|i| 2.0 * i as f64) - 0.5).abs() < 1e-9);
        assert!(rate_hz(&|_| 7.0).is_nan());
    }

    #[test]
    fn samples_are_the_same_numbers_in_every_type() {
        let counts: Vec<[i16; 3]> = (0..20).map(|k| [k, -k * k, i16::MIN + k]).collect();
        let single: Vec<[f32; 3]> = counts.iter().map(|row| row.map(f32::from)).collect();
        let double: Vec<[f64; 3]> = counts.iter().map(|row| row.map(f64::from)).collect();
        for samples in [Samples::from(&counts), Samples::from(&single), Samples::from(&double)] {
            assert_eq!((samples.len(), samples.is_empty()), (20, false));
            assert_eq!(samples.at(7), double[7]);
            assert_eq!(samples.part(3..9).as_ref(), &double[3..9]);
            assert!(samples.slice(3..9).iter().eq(double[3..9].iter().copied()));
            assert!(samples.axis(2).rev().eq(double.iter().rev().map(|row| row[2])));
            let mut pairs = Vec::new();
            samples.neighbours(1, |before, after| pairs.push((before, after)));
            assert!(pairs.into_iter().eq(double.windows(2).map(|pair| (pair[0][1], pair[1][1]))));
            samples.slice(0..0).neighbours(0, |_, _| panic!("there is none"));
        }
    }
}
