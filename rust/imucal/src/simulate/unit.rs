//! The simulated unit: models of its accelerometer and its gyroscope.

use std::f64::consts::FRAC_1_SQRT_2;

use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::effects::EffectSet;
use nalgebra::{Matrix3, Vector3};

use super::sampling::{LowPass, MAX_STEPS, MIN_STEPS};
use crate::error::Error;

/// A unit with an accelerometer and a gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// The accelerometer, which measures specific force, m/s^2.
    pub accelerometer: Sensor,
    /// The gyroscope, which measures angular rate, rad/s.
    pub gyroscope: Sensor,
    /// Effects: sensor errors that a sensitivity and a bias do not describe. Effects on encoders act on the encoders of
    /// the stand that carries the unit.
    pub effects: EffectSet<f64>,
}

/// Model of a triad: `measured = convert(sample(low_pass(sensitivity * (true + effects) + bias + noise)))`,
/// `docs/model.md` (22).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Sensitivity matrix; the identity for a sensor without errors. In the paper cited in docs/model.md, it is the
    /// product M S of the misalignment matrix M and the scale matrix S.
    pub sensitivity: Matrix3<f64>,
    /// Bias at the start of the run, SI unit.
    pub bias: Vector3<f64>,
    /// Density of the continuous white noise, SI unit/sqrt(Hz). It is the square root of the two-sided power density,
    /// as in Allan plots. Datasheets state one-sided densities, which are larger by the factor sqrt(2). A point sample
    /// has the standard deviation `noise_density * sqrt(rate_hz)`, and a mean over the time T has the standard
    /// deviation `noise_density / sqrt(T)`.
    pub noise_density: f64,
    /// Factor that multiplies the standard deviation of the white noise while the unit moves; 1 if the noise does not
    /// change.
    pub noise_in_motion: f64,
    /// Bias instability B, SI unit: flicker noise with an Allan deviation of `sqrt(2 ln(2) / pi) B = 0.664 B`.
    pub bias_instability: f64,
    /// Random walk K of the bias of each axis, SI unit/s/sqrt(Hz). The change of the bias during a time t has a
    /// standard deviation of `K sqrt(t)`.
    pub random_walk: Vector3<f64>,
    /// Low-pass filter before sampling, which also filters the noise; `None` for no filter.
    pub low_pass: Option<LowPass>,
    /// Whether a sample is the mean over the interval since the previous sample. If false, a sample is the value at the
    /// instant of the sample.
    pub averaging: bool,
    /// Converter that rounds to counts and clips to its range; `None` for samples without rounding and clipping.
    pub converter: Option<Converter>,
}

/// An analogue-to-digital converter with two's complement output. The output is an integer number of counts, from
/// `-2^(bits-1)` to `2^(bits-1) - 1`, times the size `lsb` of one count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    /// Size of one count, SI unit.
    pub lsb: f64,
    /// Number of bits of the output word.
    pub bits: u32,
}

impl Converter {
    /// Converts an input `value`, SI unit, to the rounded and clipped output. `bits` must be valid (see
    /// [`Sensor::check`]).
    #[inline]
    pub(super) fn convert(&self, value: f64) -> f64 {
        // Near WHOLE, consecutive f64 numbers differ by one. Adding and then subtracting WHOLE therefore rounds to the
        // nearest integer, ties to even. These two operations replace the rounding instruction, which older processors
        // lack. Clipped counts are far smaller than WHOLE, so the sum stays in the range in which consecutive numbers
        // differ by one.
        const WHOLE: f64 = 1.5 * (1_u64 << 52) as f64;
        let half = (1_u64 << (self.bits - 1)) as f64;
        let counts = (value / self.lsb).clamp(-half, half - 1.0);
        ((counts + WHOLE) - WHOLE) * self.lsb
    }
}

impl Sensor {
    /// A sensor without errors and noise.
    pub fn ideal() -> Self {
        Self {
            sensitivity: Matrix3::identity(),
            bias: Vector3::zeros(),
            noise_density: 0.0,
            noise_in_motion: 1.0,
            bias_instability: 0.0,
            random_walk: Vector3::zeros(),
            low_pass: None,
            averaging: false,
            converter: None,
        }
    }

    /// Whether a sample depends only on the input at its own instant.
    pub(super) fn is_point_sampled(&self) -> bool {
        self.low_pass.is_none() && !self.averaging
    }

    /// Number of internal time steps per sample that are needed to simulate the filter and the averaging.
    pub(super) fn steps(&self, rate_hz: f64) -> usize {
        match self.low_pass {
            Some(low_pass) => low_pass.steps(rate_hz),
            None if self.averaging => MIN_STEPS,
            None => 1,
        }
    }

    /// Returns an error if a value cannot be used. `name` is the name of the sensor in error messages.
    pub(super) fn check(&self, name: &str, rate_hz: f64) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(format!("{name} of the unit: {message}")));
        if !self.sensitivity.iter().chain(&self.bias).all(|value| value.is_finite()) {
            return input("sensitivity and bias need finite entries".to_owned());
        }
        let [walk_x, walk_y, walk_z] = self.random_walk.into();
        for (name, value) in [
            ("noise_density", self.noise_density),
            ("noise_in_motion", self.noise_in_motion),
            ("bias_instability", self.bias_instability),
            ("random_walk of x", walk_x),
            ("random_walk of y", walk_y),
            ("random_walk of z", walk_z),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return input(format!("{name} is {value}: give zero or a positive value"));
            }
        }
        if let Some(low_pass @ LowPass { bandwidth_hz }) = self.low_pass {
            // The condition is negated as a whole, so that NaN is refused.
            if !(bandwidth_hz > 0.0 && low_pass.steps(rate_hz) <= MAX_STEPS) {
                return input(format!(
                    "the low-pass filter has a bandwidth of {bandwidth_hz} Hz: give a positive value up to four times the \
                     rate of {rate_hz} Hz; a wider filter has no effect"
                ));
            }
        }
        match self.converter {
            Some(Converter { lsb, .. }) if !(lsb.is_finite() && lsb > 0.0) => {
                input(format!("the size of one count (lsb) is {lsb}: give a positive value"))
            }
            Some(Converter { bits, .. }) if !(2..=32).contains(&bits) => {
                input(format!("the output word has {bits} bits: give 2 to 32"))
            }
            _ => Ok(()),
        }
    }
}

impl Unit {
    /// A unit without errors and noise.
    pub fn ideal() -> Self {
        Self { accelerometer: Sensor::ideal(), gyroscope: Sensor::ideal(), effects: EffectSet::none() }
    }

    /// The unit of the paper cited in docs/model.md, with the accelerometer NXP FXOS8700CQ and the gyroscope NXP
    /// FXAS21002CQ. Sensitivity and bias are from Tables 1 and 2 of the paper, and noise and resolution are from the
    /// datasheets.
    ///
    /// Densities in datasheets are one-sided, so they are divided by sqrt(2) (`docs/model.md` (22)).
    ///
    /// * FXOS8700CQ: 126 ug/sqrt(Hz); 14 bit, range +-2 g, 0.244 mg per count (2 g / 8192).
    /// * FXAS21002CQ: 0.025 deg/s/sqrt(Hz); 16 bit, range +-500 deg/s, 15.625 mdeg/s per count (clips at 512 deg/s).
    ///   The paper does not state the range. With +-250 deg/s the random program would clip, because it reaches up to
    ///   358 deg/s.
    pub fn paper() -> Self {
        // Table 2 of the paper interchanges the labels of the gyroscope's misalignment matrix and scale matrix. The
        // variables here have the correct names.
        let misalignment = Matrix3::new(1.0, 0.0094, -0.0060, -0.0086, 1.0, -0.0031, 0.0089, 0.0035, 1.0);
        let scale = Matrix3::from_diagonal(&Vector3::new(0.9771, 1.0309, 1.0030));
        Self {
            accelerometer: Sensor {
                sensitivity: Matrix3::new(
                    0.9804, 0.0012, 0.0055, //
                    0.0012, 0.9727, 0.0043, //
                    0.0055, 0.0043, 0.9921,
                ),
                bias: Vector3::new(-0.0427, 0.0241, 0.0402) * STANDARD_GRAVITY_MPS2,
                noise_density: 126e-6 * STANDARD_GRAVITY_MPS2 * FRAC_1_SQRT_2,
                converter: Some(Converter { lsb: 2.0 * STANDARD_GRAVITY_MPS2 / 8192.0, bits: 14 }),
                ..Sensor::ideal()
            },
            gyroscope: Sensor {
                sensitivity: misalignment * scale,
                bias: Vector3::new(-0.0350, 0.0042, 0.0010),
                noise_density: 0.025_f64.to_radians() * FRAC_1_SQRT_2,
                converter: Some(Converter { lsb: 0.015625_f64.to_radians(), bits: 16 }),
                ..Sensor::ideal()
            },
            effects: EffectSet::none(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn converter_rounds_to_counts_and_clips() {
        let converter = Converter { lsb: 0.25, bits: 4 };
        assert_eq!(converter.convert(0.3), 0.25);
        assert_eq!(converter.convert(-0.38), -0.5);
        assert_eq!([0.125, 0.375, -0.125, -0.375].map(|tie| converter.convert(tie)), [0.0, 0.5, 0.0, -0.5]);
        let wide = Converter { lsb: 1.0, bits: 32 };
        assert_eq!([-2e9 + 0.25, 2e9 - 0.75, 1e300].map(|value| wide.convert(value)), [-2e9, 2e9 - 1.0, 2147483647.0]);
        assert_eq!(converter.convert(100.0), 1.75);
        assert_eq!(converter.convert(-100.0), -2.0);
    }

    #[test]
    fn the_papers_unit_has_the_printed_figures() {
        let unit = Unit::paper();
        assert_eq!(unit.accelerometer.sensitivity, unit.accelerometer.sensitivity.transpose());
        // The expected sensitivities are misalignments from rows 1 and 2 of Table 2, each multiplied by the scale of
        // its column.
        assert!((unit.gyroscope.sensitivity[(0, 1)] - 0.0094 * 1.0309).abs() < 1e-15);
        assert!((unit.gyroscope.sensitivity[(1, 0)] + 0.0086 * 0.9771).abs() < 1e-15);
        // The paper states a bias of -0.0427 g.
        assert!((unit.accelerometer.bias.x + 0.41874).abs() < 1e-5);
        for (sensor, name) in [(unit.accelerometer, "accelerometer"), (unit.gyroscope, "gyroscope")] {
            assert!(sensor.check(name, 100.0).is_ok());
        }
    }

    #[test]
    fn sensors_that_cannot_be_are_refused() {
        let bad = [
            Sensor { noise_density: -1.0, ..Sensor::ideal() },
            Sensor { noise_in_motion: f64::NAN, ..Sensor::ideal() },
            Sensor { bias_instability: -1e-3, ..Sensor::ideal() },
            Sensor { random_walk: Vector3::new(0.0, 0.0, -1e-6), ..Sensor::ideal() },
            Sensor { low_pass: Some(LowPass { bandwidth_hz: 0.0 }), ..Sensor::ideal() },
            Sensor { low_pass: Some(LowPass { bandwidth_hz: 1e4 }), ..Sensor::ideal() },
            Sensor { bias: Vector3::new(f64::NAN, 0.0, 0.0), ..Sensor::ideal() },
            Sensor { converter: Some(Converter { lsb: 0.0, bits: 16 }), ..Sensor::ideal() },
            Sensor { converter: Some(Converter { lsb: 1.0, bits: 0 }), ..Sensor::ideal() },
        ];
        for sensor in bad {
            let message = sensor.check("gyroscope", 100.0).unwrap_err().to_string();
            assert!(message.starts_with("gyroscope"), "{message}");
        }
    }
}
