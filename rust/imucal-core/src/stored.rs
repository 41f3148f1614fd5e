//! Binary form of a calibration: a few hundred bytes in flash or EEPROM. The calibration is stored as data, so the same
//! firmware runs on all units.
//!
//! `imucal export --to blob` writes the bytes. All numbers are little-endian; floats are IEEE 754 single precision. The
//! shape of an effect is the parameter on which the effect depends nonlinearly, for example a time constant.
//!
//! | offset | size | content |
//! |---|---|---|
//! | 0 | 4 | `IMUC` |
//! | 4 | 1 | version of the binary form, 1 |
//! | 5 | 1 | flags: 1 raw rate in counts, 2 raw force in counts, 4 the temperature range is known |
//! | 6 | 2 | length of the whole binary form, bytes |
//! | 8 | 1 | number of effects |
//! | 9 | 1 | number of effects of the calibration that this form omits |
//! | 10 | 3 | signed bytes a_1, a_2, a_3: corrected component i is body axis \|a_i\| (1, 2 or 3) with the sign of a_i |
//! | 13 | 3 | 0 |
//! | 16 | 12 | lowest, highest and reference temperature, degC |
//! | 28 | 48 | gyroscope: inverse sensitivity by rows, then bias in raw units |
//! | 76 | 48 | accelerometer: inverse sensitivity by rows, then bias in raw units |
//! | 124 | | for each effect: number, count of values, 2 zero bytes, shape (1 if the effect has no shape), values |
//! | length - 4 | 4 | CRC-32 of all bytes before it, as in zlib and Ethernet |

use crate::{
    calibration::Calibration,
    effects::{Effect, EffectValues, MAX_EFFECTS, MAX_PARAMETERS, Surroundings},
    sensor::Triad,
};
use core::{error::Error, fmt};
use nalgebra::{Matrix3, RealField, Vector3, convert};

/// Version of the binary form that this crate reads.
pub const VERSION: u8 = 1;
/// Length of the binary form of a calibration without effects, bytes.
pub const SHORTEST: usize = 128;
/// Maximum length of the binary form, bytes. A buffer of this size can contain any calibration.
pub const LONGEST: usize = SHORTEST + MAX_EFFECTS * (8 + 4 * MAX_PARAMETERS);

const MAGIC: [u8; 4] = *b"IMUC";

/// A calibration that was read from its binary form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredCalibration<F: RealField + Copy> {
    /// Both triads and the effects.
    pub calibration: Calibration<F>,
    /// Whether the raw rate is in counts. Otherwise it is in rad/s.
    pub rate_in_counts: bool,
    /// Whether the raw force is in counts. Otherwise it is in m/s^2.
    pub force_in_counts: bool,
    /// Number of effects of the calibration that the binary form does not contain, for example user-defined formulas.
    /// The errors that these effects describe are not corrected.
    pub omitted_effects: u8,
    /// Lowest and highest temperature of the calibration recordings, degC; `None` if unknown.
    pub temperature_range_degc: Option<[F; 2]>,
    /// Reference temperature, degC. The temperature effects are zero at this temperature.
    pub reference_temperature_degc: F,
    axes: [Axis; 3],
}

/// A signed axis of the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis {
    number: u8,
    negative: bool,
}

impl<F: RealField + Copy> StoredCalibration<F> {
    /// Reads the binary form. Bytes after the end of the form are ignored, so the caller can pass a whole page of
    /// memory.
    ///
    /// # Errors
    /// [`StoredError`] states why the bytes are not a valid calibration.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, StoredError> {
        let mut all = Bytes(bytes);
        if all.take::<4>()? != MAGIC {
            return Err(StoredError::Magic);
        }
        let [version, flags] = all.take()?;
        if version != VERSION {
            return Err(StoredError::Version { given: version });
        }
        let length = usize::from(u16::from_le_bytes(all.take()?));
        let content_length = length.checked_sub(4).ok_or(StoredError::Length)?;
        let content = bytes.get(..content_length).ok_or(StoredError::Length)?;
        let crc = Bytes(bytes.get(content_length..).ok_or(StoredError::Length)?).take()?;
        if crc32(content) != u32::from_le_bytes(crc) {
            return Err(StoredError::Crc);
        }
        let mut rest = Bytes(content.get(8..).ok_or(StoredError::Length)?);
        let [count, omitted_effects] = rest.take()?;
        let axes = axes(rest.take()?)?;
        let _reserved: [u8; 3] = rest.take()?;
        let [lowest, highest, reference]: [F; 3] = [rest.float()?, rest.float()?, rest.float()?];
        let temperature_range_degc = if flags & 4 == 0 {
            None
        } else if lowest <= highest && lowest.is_finite() && highest.is_finite() {
            Some([lowest, highest])
        } else {
            return Err(StoredError::Content);
        };
        let (gyroscope, accelerometer) = (rest.triad()?, rest.triad()?);
        let mut calibration = Calibration::new(accelerometer, gyroscope);
        for _ in 0..count {
            calibration.effects.push(rest.effect()?).map_err(|_| StoredError::Content)?;
        }
        if !rest.0.is_empty() || !reference.is_finite() {
            return Err(StoredError::Content);
        }
        Ok(Self {
            calibration,
            rate_in_counts: flags & 1 != 0,
            force_in_counts: flags & 2 != 0,
            omitted_effects,
            temperature_range_degc,
            reference_temperature_degc: reference,
            axes,
        })
    }

    /// Corrects one raw sample: returns the true `(rate, force)`, rad/s and m/s^2, along the axes specified in the
    /// binary form. The values of temperature effects are unknown outside the temperature range of the calibration
    /// recordings. A temperature outside this range is therefore replaced by the nearest end of the range.
    pub fn correct(
        &self,
        raw_rate: Vector3<F>,
        raw_force: Vector3<F>,
        surroundings: &Surroundings<F>,
    ) -> (Vector3<F>, Vector3<F>) {
        let mut surroundings = *surroundings;
        if let (Some(difference), Some([lowest, highest])) =
            (surroundings.temperature_difference_k, self.temperature_range_degc)
        {
            let degc = difference + self.reference_temperature_degc;
            if degc < lowest {
                surroundings.temperature_difference_k = Some(lowest - self.reference_temperature_degc);
            } else if degc > highest {
                surroundings.temperature_difference_k = Some(highest - self.reference_temperature_degc);
            }
        }
        let (rate, force) = self.calibration.correct_at(raw_rate, raw_force, &surroundings);
        (self.along_axes(&rate), self.along_axes(&force))
    }

    /// Like [`correct`](Self::correct), but for the 16-bit counts that the sensors output. Returns `None` if the
    /// calibration is not for raw data in counts.
    pub fn correct_counts(
        &self,
        raw_rate: [i16; 3],
        raw_force: [i16; 3],
        surroundings: &Surroundings<F>,
    ) -> Option<(Vector3<F>, Vector3<F>)> {
        let vector = |[x, y, z]: [i16; 3]| {
            let real = |count: i16| convert::<f32, F>(f32::from(count));
            Vector3::new(real(x), real(y), real(z))
        };
        (self.rate_in_counts && self.force_in_counts)
            .then(|| self.correct(vector(raw_rate), vector(raw_force), surroundings))
    }

    fn along_axes(&self, v: &Vector3<F>) -> Vector3<F> {
        let [x, y, z] = self.axes;
        let component = |axis: Axis| {
            let value = match axis.number {
                1 => v.x,
                2 => v.y,
                _ => v.z,
            };
            if axis.negative { -value } else { value }
        };
        Vector3::new(component(x), component(y), component(z))
    }
}

/// Decodes the three signed axes from their signed bytes. Each body axis must occur exactly once.
fn axes(codes: [u8; 3]) -> Result<[Axis; 3], StoredError> {
    let axis = |code: u8| {
        let number = (code as i8).unsigned_abs();
        if (1..=3).contains(&number) { Ok(Axis { number, negative: code >= 128 }) } else { Err(StoredError::Content) }
    };
    let [x, y, z] = codes;
    let [x, y, z] = [axis(x)?, axis(y)?, axis(z)?];
    if x.number == y.number || x.number == z.number || y.number == z.number {
        return Err(StoredError::Content);
    }
    Ok([x, y, z])
}

/// The bytes that have not been read yet. Each method reads the value at the start and removes the bytes of this value.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], StoredError> {
        let (first, rest) = self.0.split_first_chunk().ok_or(StoredError::Length)?;
        self.0 = rest;
        Ok(*first)
    }

    fn float<F: RealField + Copy>(&mut self) -> Result<F, StoredError> {
        Ok(convert(f32::from_le_bytes(self.take()?)))
    }

    fn vector<F: RealField + Copy>(&mut self) -> Result<Vector3<F>, StoredError> {
        Ok(Vector3::new(self.float()?, self.float()?, self.float()?))
    }

    fn triad<F: RealField + Copy>(&mut self) -> Result<Triad<F>, StoredError> {
        let (x, y, z) = (self.vector()?, self.vector()?, self.vector()?);
        let inverse = Matrix3::new(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z);
        Triad::from_inverse(inverse, self.vector()?).map_err(|_| StoredError::Content)
    }

    fn effect<F: RealField + Copy>(&mut self) -> Result<EffectValues<F>, StoredError> {
        let [number, count, _, _] = self.take()?;
        let effect = Effect::numbered(number).ok_or(StoredError::Effect { number })?;
        let shape = self.float()?;
        let mut values = [F::zero(); MAX_PARAMETERS];
        let values = values.get_mut(..usize::from(count)).ok_or(StoredError::Content)?;
        for value in values.iter_mut() {
            *value = self.float()?;
        }
        EffectValues::try_new(effect, values, effect.is_shaped.then_some(shape)).map_err(|_| StoredError::Content)
    }
}

/// CRC-32 with the polynomial 0x04C11DB7, reflected, as in zlib.
fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xEDB8_8320 };
        }
    }
    !crc
}

/// Reasons why a sequence of bytes is not a valid calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StoredError {
    /// The bytes end before the end of the calibration.
    Length,
    /// The bytes do not start with `IMUC`, for example because the memory is erased.
    Magic,
    /// The binary form has a version that this crate does not read.
    Version {
        /// Version of the binary form.
        given: u8,
    },
    /// The check sum is wrong, so the bytes have changed since they were written.
    Crc,
    /// No effect in this version of the catalogue has this number.
    Effect {
        /// Number of the effect.
        number: u8,
    },
    /// The check sum is correct, but the content is not a calibration. For example, a number is not finite, a matrix
    /// has no inverse, or an effect has a wrong number of values.
    Content,
}

impl fmt::Display for StoredError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length => f.write_str("the bytes end before the calibration does"),
            Self::Magic => f.write_str("there is no calibration: the bytes do not start with IMUC"),
            Self::Version { given } => {
                write!(f, "the binary form has version {given}, but only version {VERSION} can be read")
            }
            Self::Crc => f.write_str("the check sum is wrong: the bytes were damaged"),
            Self::Effect { number } => {
                write!(f, "this version of the catalogue has no effect with the number {number}")
            }
            Self::Content => f.write_str("the check sum is right, but the content is not a calibration"),
        }
    }
}

impl Error for StoredError {}

#[cfg(test)]
mod tests;
