//! Linearises the sensors: computes the derivatives of the readings with respect to the parameters.
//!
//! The parameters have the order of the joint fit: accelerometer bias (3), accelerometer sensitivity (6, because the
//! body frame is chosen so that this matrix is symmetric), gyroscope bias (3), gyroscope sensitivity (9, row by row),
//! and then the parameters of the effects (sensor errors that bias and sensitivity do not describe).

use imucal_core::effects::{Columns, Effect, MAX_PARAMETERS, Need, Sensor as Kind, State, Surroundings};
use nalgebra::{Matrix3, Vector3};

use super::DIRECTION;
use crate::error::Error;
use crate::frame::SYMMETRIC;
use crate::held::{HeldParameter, Priors, precisions};
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::rounding::Rounding;
use crate::simulate::{Converter, Moment, Sensor, Unit};
use crate::two_stage::observability::FARTHEST;

/// Maximum share of the gyroscope's range that a plan uses. The remaining 5 % are a margin for noise and for overshoot
/// of the motors.
const NEAR_RAILS: f64 = 0.95;
/// Assumed time constant of an effect (for effects that have one), as a share of the duration of the planned run.
const SHAPE_SHARE: f64 = 0.3;

/// Model of a unit for planning: the sensitivities, the white noise, and the effects to be estimated.
#[derive(Clone, Debug)]
pub struct Sensors {
    accelerometer: Matrix3<f64>,
    gyroscope: Matrix3<f64>,
    gyroscope_bias: Vector3<f64>,
    from_gyroscope: Matrix3<f64>,
    /// Variance of the mean accelerometer reading over one second, (m/s^2)^2.
    pub(super) force_variance: f64,
    /// Variance of the mean gyroscope reading over one second at rest, (rad/s)^2.
    pub(super) rate_variance: f64,
    /// Variance of the mean gyroscope reading over one second during a move, (rad/s)^2.
    pub(super) moving_variance: f64,
    /// Variance of the rounding error in the mean accelerometer reading at a rest, (m/s^2)^2.
    pub(super) force_rounding: f64,
    /// Variance of the rounding error in the mean gyroscope reading at a rest, (rad/s)^2. All rests have the same
    /// rounding error, because the gyroscope has the same reading at all rests.
    pub(super) rate_rounding: f64,
    gyroscope_range: f64,
    gravity_mps2: f64,
    effects: Vec<&'static Effect<f64>>,
    held: Vec<HeldParameter>,
    /// Approximate duration of the run, s. It determines the assumed time constants of effects.
    pub(super) run_s: f64,
}

/// Variance of the rounding error of a mean reading at rest, squared SI unit (model.md (37)).
fn rounding_error(sensor: &Sensor, rate_hz: f64) -> f64 {
    // The noise bandwidth of a second-order Butterworth filter is 1.11 times its -3 dB bandwidth. The factor 2 includes
    // negative frequencies, because the noise density is two-sided.
    let passed_hz = sensor.low_pass.map_or(rate_hz, |low_pass| rate_hz.min(2.0 * 1.11 * low_pass.bandwidth_hz));
    let noise = sensor.noise_density * passed_hz.sqrt();
    let rounding = sensor.converter.and_then(|converter| Rounding::of_noise(converter.lsb, noise));
    rounding.map_or(0.0, |rounding| rounding.error_variance)
}

impl Sensors {
    /// Creates the model of a unit for a sampling rate, Hz, and the local gravity, m/s^2. The model does not contain
    /// the effects of the unit.
    pub fn of(unit: &Unit, rate_hz: f64, gravity_mps2: f64) -> Self {
        let variance = |sensor: &Sensor, factor: f64| {
            let rounding = sensor.converter.map_or(0.0, |converter| converter.lsb * converter.lsb / 12.0);
            (sensor.noise_density * factor).powi(2) + rounding / rate_hz
        };
        let rails = |Converter { lsb, bits }: Converter| lsb * 2_f64.powi(bits as i32 - 1);
        let gyroscope = unit.gyroscope.sensitivity;
        Self {
            accelerometer: unit.accelerometer.sensitivity,
            gyroscope,
            gyroscope_bias: unit.gyroscope.bias,
            from_gyroscope: gyroscope.try_inverse().unwrap_or_else(Matrix3::identity),
            force_variance: variance(&unit.accelerometer, 1.0),
            rate_variance: variance(&unit.gyroscope, 1.0),
            moving_variance: variance(&unit.gyroscope, unit.gyroscope.noise_in_motion),
            force_rounding: rounding_error(&unit.accelerometer, rate_hz),
            rate_rounding: rounding_error(&unit.gyroscope, rate_hz),
            gyroscope_range: unit.gyroscope.converter.map_or(f64::INFINITY, rails),
            gravity_mps2,
            effects: Vec::new(),
            held: Vec::new(),
            run_s: 0.0,
        }
    }

    /// Adds effects to the estimated parameters. `run_s` is the approximate duration of the run, s.
    ///
    /// # Errors
    /// [`Error::Input`] for unknown effects, for effects on the encoders, and for temperature effects, because no
    /// motion makes temperature effects observable.
    pub fn with_effects(mut self, names: &[String], run_s: f64) -> Result<Self, Error> {
        for name in names {
            let Some(effect) = Effect::<f64>::find(name) else {
                return Err(Error::Input(format!("effects has {name:?}: no effect of the catalogue has this name")));
            };
            if effect.sensor == Kind::Encoder {
                return Err(Error::Input(format!(
                    "{name} is an effect on the encoders of the stand: a plan is made for the sensors of the unit"
                )));
            }
            if effect.needs.contains(&Need::Temperature) {
                return Err(Error::Input(format!(
                    "{name} depends on the temperature, which no motion changes: {}",
                    effect.observable
                )));
            }
            self.effects.push(effect);
        }
        self.run_s = run_s;
        Ok(self)
    }

    /// Adds the priors that the user gave, in the same form as for a calibration.
    ///
    /// # Errors
    /// [`Error::Input`] for unknown names and invalid priors.
    pub fn with_priors(mut self, priors: &Priors) -> Result<Self, Error> {
        self.held = priors.held([Some(1.0); 2])?;
        Ok(self)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        BASE + self.effects.iter().map(|effect| effect.plain).sum::<usize>()
    }

    /// Name and SI unit of each parameter of the effects. All lists of parameters begin with the 21 parameters of the
    /// triads (three-axis sensors). The parameters of the effects follow, in the order that is returned here.
    pub fn effect_parameters(&self) -> Vec<(String, &'static str)> {
        let named = |effect: &&'static Effect<f64>| {
            let name = effect.name;
            effect.parameters[..effect.plain].iter().map(move |p| (format!("{name}_{}", p.name), p.unit))
        };
        self.effects.iter().flat_map(named).collect()
    }

    /// Prior precision 1 / sigma^2 of each parameter. By default, sigma is a tenth of the mean scale for a sensitivity,
    /// a tenth of the reading at 1 g or at 1 rad/s for a bias, and ten times the typical size for a parameter of an
    /// effect. If the user gave a narrower prior, its sigma is used.
    pub(super) fn prior_precision(&self) -> Vec<f64> {
        let scale = |matrix: &Matrix3<f64>| matrix.norm() / 3f64.sqrt();
        let (accelerometer, gyroscope) = (scale(&self.accelerometer), scale(&self.gyroscope));
        let base = (0..BASE).map(|p| match p {
            0..3 => accelerometer * self.gravity_mps2,
            3..9 => accelerometer,
            _ => gyroscope,
        });
        let effects =
            self.effects.iter().flat_map(|e| e.parameters[..e.plain].iter().map(|p| p.typical / FARTHEST.powi(2)));
        let widest = base.chain(effects).map(|size| 1.0 / (FARTHEST * size).powi(2));
        // The user's priors are linearised at the parameters of a sensor without errors. This linearisation is accurate
        // enough, because the derivatives of the priors hardly depend on the parameters.
        let perfect: [f64; BASE] = std::array::from_fn(|p| if [3, 4, 5, 12, 16, 20].contains(&p) { 1.0 } else { 0.0 });
        let held = precisions(&self.held, &perfect).map(|(precision, _)| precision);
        widest.zip(held.into_iter().chain(std::iter::repeat(0.0))).map(|(widest, held)| widest.max(held)).collect()
    }

    /// Whether the plan uses the specific forces during moves. As in the joint fit, they are used only if an effect
    /// depends on the angular acceleration.
    pub(super) fn uses_forces_in_moves(&self) -> bool {
        self.effects.iter().any(|effect| effect.needs.contains(&Need::AngularAcceleration))
    }

    /// Whether the derivatives of the readings with respect to the parameters depend on the time since the start of the
    /// run, because an estimated effect depends on it.
    pub(super) fn depend_on_time(&self) -> bool {
        self.effects.iter().any(|effect| effect.needs.contains(&Need::Time))
    }

    /// Ratio of the gyroscope reading at this body rate to the usable range of the gyroscope (95 % of its range, minus
    /// the bias), for the axis with the largest ratio. If the ratio is above 1, the rate is too high for a plan.
    pub(super) fn too_fast(&self, rate: &Vector3<f64>) -> f64 {
        let reading = self.gyroscope * rate;
        let share = |axis: usize| {
            reading[axis].abs() / (NEAR_RAILS * self.gyroscope_range - self.gyroscope_bias[axis].abs()).max(1e-9)
        };
        (0..3).map(share).fold(0.0, f64::max)
    }

    /// Derivatives of the three accelerometer readings, m/s^2, with respect to the gravity direction and the
    /// parameters, one row for each reading. They are not divided by the standard deviations of the readings.
    pub(super) fn force_rows(&self, moment: &Moment, time_s: f64) -> [Vec<f64>; 3] {
        let to_world = moment.rotation_world_from_body.to_rotation_matrix();
        let [x, y, z] = [0, 1, 2].map(|row| to_world.matrix().row(row).transpose());
        let force = z * self.gravity_mps2;
        let by_direction = [self.accelerometer * -y * self.gravity_mps2, self.accelerometer * x * self.gravity_mps2];
        let mut rows: [Vec<f64>; 3] = std::array::from_fn(|i| {
            let mut row = vec![0.0; DIRECTION + self.parameters()];
            (row[0], row[1]) = (by_direction[0][i], by_direction[1][i]);
            row[DIRECTION + i] = 1.0;
            row
        });
        for (p, (i, j)) in SYMMETRIC.into_iter().enumerate() {
            rows[i][DIRECTION + 3 + p] = force[j];
            rows[j][DIRECTION + 3 + p] = force[i];
        }
        self.effect_columns(Kind::Accelerometer, moment, time_s, |p, column| {
            let raw = self.accelerometer * column;
            (0..3).for_each(|i| rows[i][DIRECTION + p] = raw[i]);
        });
        rows
    }

    /// Derivatives of the three gyroscope readings at rest, rad/s, with respect to the gravity direction and the
    /// parameters, one row for each reading. They are not divided by the standard deviations of the readings.
    pub(super) fn rate_rows(&self, moment: &Moment, time_s: f64) -> [Vec<f64>; 3] {
        let mut rows: [Vec<f64>; 3] = std::array::from_fn(|i| {
            let mut row = vec![0.0; DIRECTION + self.parameters()];
            row[DIRECTION + GYRO_BIAS.start + i] = 1.0;
            row
        });
        self.effect_columns(Kind::Gyroscope, moment, time_s, |p, column| {
            let raw = self.gyroscope * column;
            (0..3).for_each(|i| rows[i][DIRECTION + p] = raw[i]);
        });
        rows
    }

    /// Extends a propagation of the gravity direction by an interval of the length `duration_s` with its middle at
    /// `time_s`. The contribution of this interval to the Jacobian C of
    /// [`Propagation`](super::information_filter::Propagation) is added to `by`. Returns, for each of the two angles of
    /// the direction, the factors with which the noise of the three gyroscope axes contributes to the rate of change of
    /// the angle.
    pub(super) fn add_propagation(
        &self,
        moment: &Moment,
        time_s: f64,
        duration_s: f64,
        by: &mut [Vec<f64>; 2],
    ) -> [Vector3<f64>; 2] {
        let to_world = moment.rotation_world_from_body.to_rotation_matrix();
        let across = [0, 1].map(|row| to_world.matrix().row(row).transpose());
        let seen = across.map(|axis| self.from_gyroscope.tr_mul(&axis));
        for (row, seen) in by.iter_mut().zip(&seen) {
            for i in 0..3 {
                row[GYRO_BIAS.start + i] += seen[i] * duration_s;
                for j in 0..3 {
                    row[GYRO_SENSITIVITY.start + 3 * i + j] += seen[i] * moment.angular_rate[j] * duration_s;
                }
            }
        }
        self.effect_columns(Kind::Gyroscope, moment, time_s, |p, column| {
            for (row, across) in by.iter_mut().zip(&across) {
                row[p] += across.dot(&column) * duration_s;
            }
        });
        seen
    }

    /// For every parameter of the effects on a sensor, calls `take` with the index of the parameter and the derivatives
    /// of the sensor's rate or force with respect to the parameter.
    fn effect_columns(&self, sensor: Kind, moment: &Moment, time_s: f64, mut take: impl FnMut(usize, Vector3<f64>)) {
        let mut place = BASE;
        for effect in &self.effects {
            if effect.sensor == sensor {
                let up = moment.rotation_world_from_body.inverse() * Vector3::z();
                let state = State {
                    angular_rate: moment.angular_rate,
                    specific_force: up * self.gravity_mps2,
                    surroundings: Surroundings {
                        angular_acceleration: Some(moment.angular_acceleration),
                        rotation_world_from_body: Some(moment.rotation_world_from_body),
                        time_s: Some(time_s),
                        stand: moment.stand,
                        ..Surroundings::unknown()
                    },
                };
                let mut columns: Columns<f64> = [Vector3::zeros(); MAX_PARAMETERS];
                effect.field(&state, SHAPE_SHARE * self.run_s, &mut columns);
                columns[..effect.plain].iter().enumerate().for_each(|(k, column)| take(place + k, *column));
            }
            place += effect.plain;
        }
    }
}
