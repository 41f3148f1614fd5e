//! Uncertainty of a calibration due to its two references: local gravity and the clock that provides the time stamps.
//!
//! Rests and moves determine every parameter only relative to gravity and to the time stamps. An error of a reference
//! therefore changes the parameters, but not the residuals. Let gravity have the relative error e, and the unit of time
//! the relative error d. Gravity is the only reference for lengths. A length is an acceleration times a squared time,
//! so it has the relative error e + 2 d. A parameter with the unit m^a s^b therefore has the relative error
//!
//! ```text
//! a e + (2 a + b) d                                                                           model.md (38)
//! ```
//!
//! For example, an accelerometer sensitivity (raw unit per m/s^2) has the relative error -e, and a gyroscope
//! sensitivity (raw unit per rad/s) has the relative error d. Biases in raw units are not affected.

use imucal_core::effects::Effect;

use super::Outcome;
use crate::error::Error;

/// Standard deviations of the two references of a calibration: local gravity and the clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct References {
    /// Standard deviation of local gravity, m/s^2.
    pub gravity_sigma_mps2: f64,
    /// Relative standard deviation of the rate of the clock that provides the time stamps, ppm.
    pub clock_ppm: f64,
}

/// Largest accepted standard deviation of gravity, m/s^2. It is half the width of the accepted range of gravity,
/// 9.7 to 9.9 m/s^2.
const MAX_GRAVITY_SIGMA_MPS2: f64 = 0.1;
/// Largest accepted standard deviation of a clock, ppm (10 %). A clock with a larger error is not a usable reference.
const MAX_CLOCK_PPM: f64 = 1e5;

impl References {
    pub(super) fn check(&self) -> Result<(), Error> {
        let Self { gravity_sigma_mps2, clock_ppm } = *self;
        if !(0.0..=MAX_GRAVITY_SIGMA_MPS2).contains(&gravity_sigma_mps2) {
            return Err(Error::Input(format!(
                "gravity_sigma_mps2 = {gravity_sigma_mps2}: give the standard deviation of local gravity, from 0 to \
                 {MAX_GRAVITY_SIGMA_MPS2} m/s^2"
            )));
        }
        if !(0.0..=MAX_CLOCK_PPM).contains(&clock_ppm) {
            return Err(Error::Input(format!(
                "clock_ppm = {clock_ppm}: give the standard deviation of the clock's rate, from 0 to {MAX_CLOCK_PPM} ppm"
            )));
        }
        Ok(())
    }
}

impl Outcome {
    /// Returns the covariance matrix of the parameters, as a list of its rows, including the uncertainty of local
    /// gravity and of the clock rate. The variances of user-defined effects do not include this uncertainty, because
    /// the units of these effects are not known.
    pub fn covariance_with_references(&self, references: &References, gravity_mps2: f64) -> Vec<Vec<f64>> {
        let variance_of_gravity = (references.gravity_sigma_mps2 / gravity_mps2).powi(2);
        let variance_of_clock = (1e-6 * references.clock_ppm).powi(2);
        let exponents = self.exponents();
        let mut covariance = self.covariance.clone();
        for (i, row) in covariance.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                let ([gravity_i, clock_i], [gravity_j, clock_j]) = (exponents[i], exponents[j]);
                let common = gravity_i * gravity_j * variance_of_gravity + clock_i * clock_j * variance_of_clock;
                *entry += self.values[i] * self.values[j] * common;
            }
        }
        covariance
    }

    /// Returns two factors for each parameter: (its relative error) / (relative error of gravity), and (its relative
    /// error) / (relative error of the unit of time).
    fn exponents(&self) -> Vec<[f64; 2]> {
        let base = (0..21).map(|p| match p {
            3..9 => [-1.0, 0.0],
            12..21 => [0.0, 1.0],
            _ => [0.0, 0.0],
        });
        let effects = self.effects.iter().flat_map(|estimate| {
            let effect = Effect::<f64>::find(&estimate.name).filter(|_| estimate.in_catalogue);
            let units = effect.into_iter().flat_map(|effect| {
                let parameters = effect.parameters.iter().take(estimate.values.len());
                parameters.chain(effect.shape.iter()).map(|parameter| in_references(parameter.unit))
            });
            units.chain(std::iter::repeat([0.0; 2])).take(estimate.parameter_names.len())
        });
        base.chain(effects).collect()
    }
}

/// Returns the two factors of equation (38) (module documentation) for the unit `unit` = m^a s^b, for example
/// `rad/s/(m/s^2)`. The factor a multiplies the relative error e of gravity. The factor 2 a + b multiplies the relative
/// error d of the unit of time.
fn in_references(unit: &str) -> [f64; 2] {
    let [metres, seconds] = exponents_of(&mut unit.chars().peekable());
    [metres, 2.0 * metres + seconds]
}

/// Parses the text of a unit and returns its exponents of metre and second. The unit ends at a closing bracket or at
/// the end of the text. Other units (rad, K) are ignored.
fn exponents_of(unit: &mut std::iter::Peekable<std::str::Chars<'_>>) -> [f64; 2] {
    let (mut sum, mut sign) = ([0.0; 2], 1.0);
    while let Some(next) = unit.next() {
        let factor = match next {
            ')' => break,
            '/' => {
                sign = -1.0;
                continue;
            }
            '*' | ' ' => {
                sign = 1.0;
                continue;
            }
            '(' => exponents_of(unit),
            first => {
                let mut name = String::from(first);
                while let Some(letter) = unit.next_if(|next| next.is_alphanumeric()) {
                    name.push(letter);
                }
                match name.as_str() {
                    "m" => [1.0, 0.0],
                    "s" => [0.0, 1.0],
                    _ => [0.0, 0.0],
                }
            }
        };
        let mut power = 1.0;
        if unit.next_if_eq(&'^').is_some() {
            let digits: String = std::iter::from_fn(|| unit.next_if(char::is_ascii_digit)).collect();
            power = digits.parse().unwrap_or(1.0);
        }
        sum = [sum[0] + sign * power * factor[0], sum[1] + sign * power * factor[1]];
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{EffectChoice, Options, calibrate};
    use crate::recording::Recording;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};

    #[test]
    fn exponents_are_those_of_the_units() {
        for (unit, expected) in [
            ("1", [0.0, 0.0]),
            ("m/s^2", [1.0, 0.0]),
            ("1/(m/s^2)^2", [-2.0, 0.0]),
            ("rad/s/(m/s^2)", [-1.0, -1.0]),
            ("rad/s/s", [0.0, -2.0]),
            ("s^2/rad^2", [0.0, 2.0]),
            ("m/s^2/K^2", [1.0, 0.0]),
            ("m", [1.0, 2.0]),
        ] {
            assert_eq!(in_references(unit), expected, "{unit}");
        }
    }

    /// Calibrates a simulated run with a value of gravity that is 0.1 % too large, and again with time stamps that are
    /// 0.1 % too large. The relative change of each estimate must be the change that model.md (38) predicts from the
    /// unit of the parameter. The model contains effects with various units.
    #[test]
    fn derivatives_are_those_of_the_fit() {
        let program = Program::random(&RandomMoves { moves: 25, ..RandomMoves::default() }, 1).unwrap();
        let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 1).unwrap();
        let recording = run.recording("run");
        let choices = ["gyro_g_sensitivity", "gyro_bias_drift", "accel_scale_quadratic"];
        let effects: Vec<EffectChoice> = choices.map(|name| EffectChoice::plain(Effect::find(name).unwrap())).into();
        let options = Options { effects, ..Options::default() };
        let fit = |recording: &Recording<'_>, options: &Options<'_>| calibrate(&[*recording], options).unwrap();
        let nominal = fit(&recording, &options);
        let step = 1e-3;
        let heavier = fit(&recording, &Options { gravity_mps2: 9.80665 * (1.0 + step), ..options.clone() });
        let slower: Vec<f64> = recording.time_s.iter().map(|time| time * (1.0 + step)).collect();
        let slower = fit(&Recording { time_s: &slower, ..recording }, &options);
        for (p, exponents) in nominal.exponents().iter().enumerate() {
            for (other, exponent) in [&heavier, &slower].iter().zip(exponents) {
                let change = other.values[p] - nominal.values[p];
                let expected = nominal.values[p] * ((1.0 + step).powf(*exponent) - 1.0);
                let sigma = nominal.covariance[p][p].sqrt();
                assert!((change - expected).abs() < 0.05 * sigma, "{}: {change} {expected}", nominal.names[p]);
            }
        }
    }

    #[test]
    fn references_have_limits() {
        let good = References { gravity_sigma_mps2: 0.1, clock_ppm: 1e5 };
        assert!(good.check().is_ok());
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(References { gravity_sigma_mps2: bad, ..good }.check().is_err());
            assert!(References { clock_ppm: bad, ..good }.check().is_err());
        }
    }
}
