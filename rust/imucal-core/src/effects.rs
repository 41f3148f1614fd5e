//! Catalogue of effects. Effects are sensor errors that a sensitivity and a bias do not describe. Simulation,
//! correction and estimation all use the definitions in this module.
//!
//! ```text
//! measured = sensitivity * (true + sum_c Phi_c(state) theta_c) + bias      model.md (15)
//! ```
//!
//! An [`Effect`] has a name, a sensor, parameters theta with units and typical sizes, and a function, the field Phi.
//! Phi is a 3 x p matrix. It contains the derivatives of the error that the effect adds, in the body frame, with
//! respect to the p parameters of the effect. The simulation adds `Phi theta` to the true quantity. The correction on
//! the device subtracts `Phi theta` ([`EffectSet::remove`]). An estimator computes the Jacobians of its residuals from
//! Phi by the chain rule.
//!
//! Each family of effects has its own file. To add an effect, add its definition to the file of its family and a line
//! to the family's list. The formula of the field is written only once: the columns of Phi and the product `Phi theta`
//! are both generated from it.
//!
//! ```
//! use imucal_core::effects::{Effect, EffectValues, State, Surroundings};
//! use nalgebra::Vector3;
//!
//! // A gyroscope whose x bias changes by 1e-4 rad/s per kelvin, 20 K above the temperature of its calibration.
//! let drifting = EffectValues::<f64>::try_new(Effect::GYRO_BIAS_TEMPERATURE, &[1e-4, 0.0, 0.0], None)?;
//! let surroundings = Surroundings { temperature_difference_k: Some(20.0), ..Surroundings::unknown() };
//! let state = State { angular_rate: Vector3::zeros(), specific_force: Vector3::z() * 9.80665, surroundings };
//! assert!((drifting.at(&state) - Vector3::new(2e-3, 0.0, 0.0)).norm() < 1e-15);
//! # Ok::<(), imucal_core::effects::EffectError>(())
//! ```
//!
//! # What the catalogue does not contain
//!
//! The catalogue does not contain noise, bias instability and random walks. They are random, so no function of the
//! state describes them. The catalogue also does not contain the geometry of the stand that moves the unit, or faults
//! of the data such as saturation or lost samples. The only errors of the stand in the catalogue are those of its
//! encoders, which need the feature `catalogue`. An encoder error is added to a motor angle, rad. The correction on
//! the device ignores encoder errors, because a device has no stand.

mod drift;
mod dynamics;
#[cfg(feature = "catalogue")]
mod encoder;
mod g_sensitivity;
mod scale;
mod temperature;
mod temperature_history;
pub mod temperature_memory;
mod terms;
mod values;

#[cfg(test)]
mod tests;

use crate::effects::temperature_memory::TemperatureHistory;
use crate::vector::each;
use terms::{Terms, effect, same};
pub use values::{EffectError, EffectSet, EffectValues, MAX_EFFECTS, MAX_PASSES};

use nalgebra::{RealField, UnitQuaternion, Vector3};

/// Largest number of parameters of an effect.
pub const MAX_PARAMETERS: usize = 18;

/// Storage for the columns of the field Phi of any effect. An effect with p parameters sets the first p columns.
pub type Columns<F> = [Vector3<F>; MAX_PARAMETERS];

/// True state of the unit at the instant of a sample. Effects depend on this state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<F: RealField + Copy> {
    /// Angular rate of the body relative to the world, in the body frame, rad/s.
    pub angular_rate: Vector3<F>,
    /// Specific force in the body frame, m/s^2.
    pub specific_force: Vector3<F>,
    /// Quantities that neither the accelerometer nor the gyroscope measures.
    pub surroundings: Surroundings<F>,
}

/// Quantities other than rate and force on which an effect may depend. `None` means that the quantity is unknown. If an
/// effect has terms that depend on an unknown quantity, these terms are omitted. [`Effect::needs`] lists the quantities
/// on which an effect depends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings<F: RealField + Copy> {
    /// Derivative of the angular rate in the body frame, rad/s^2.
    pub angular_acceleration: Option<Vector3<F>>,
    /// Mean of the angular acceleration over the delay tau of the gyroscope, `(w(t) - w(t - tau)) / tau`, rad/s^2,
    /// where w is the angular rate. If this field is `None`, the angular acceleration is used instead, which neglects
    /// terms of the order tau^2.
    pub mean_angular_acceleration: Option<Vector3<F>>,
    /// Attitude: rotation from the body frame to the world frame, `v_w = r_wb * v_b`.
    pub rotation_world_from_body: Option<UnitQuaternion<F>>,
    /// Temperature of the sensor minus the reference temperature of the sensitivities and biases, K.
    pub temperature_difference_k: Option<F>,
    /// Variables of the temperature history, from [`TemperatureMemory`](temperature_memory::TemperatureMemory).
    pub temperature_history: Option<TemperatureHistory<F>>,
    /// Time since power-on, or since another reference instant that the calibration defines, s.
    pub time_s: Option<F>,
    /// State of the stand that moves the unit.
    #[cfg(feature = "catalogue")]
    pub stand: Option<StandState<F>>,
}

/// True state of the three motors of a stand, outermost motor first.
#[cfg(feature = "catalogue")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandState<F: RealField + Copy> {
    /// Motor angles, rad. They are not reduced to one revolution.
    pub angle_rad: Vector3<F>,
    /// Motor rates, rad/s.
    pub rate_radps: Vector3<F>,
    /// Sign of the motion of each motor: -1 or 1. While a motor is at rest, the sign of its last motion is kept. The
    /// sign is 0 before the first motion.
    pub direction: Vector3<F>,
}

#[cfg(feature = "catalogue")]
impl<F: RealField + Copy> StandState<F> {
    /// State of motors that are at rest and have not moved yet.
    pub fn still(angle_rad: Vector3<F>) -> Self {
        Self { angle_rad, rate_radps: Vector3::zeros(), direction: Vector3::zeros() }
    }
}

impl<F: RealField + Copy> Surroundings<F> {
    /// Surroundings in which no quantity is known.
    pub fn unknown() -> Self {
        Self {
            angular_acceleration: None,
            mean_angular_acceleration: None,
            rotation_world_from_body: None,
            temperature_difference_k: None,
            temperature_history: None,
            time_s: None,
            #[cfg(feature = "catalogue")]
            stand: None,
        }
    }
}

/// An effect of the catalogue. The field Phi of the effect contains the derivatives of the error that the effect adds
/// with respect to its parameters theta. Firmware refers to an effect by its constant, for example
/// `Effect::GYRO_G_SENSITIVITY`. Without the feature `catalogue`, the constant contains no name, unit or other text.
#[derive(Clone, Copy, Debug)]
pub struct Effect<F: RealField + Copy> {
    /// Number that identifies the effect in the binary form of a calibration; see [`Effect::numbered`]. A number is
    /// never reused. It is 0 for effects on encoders, because the binary form cannot store them.
    pub number: u8,
    /// Sensor on which the effect acts.
    pub sensor: Sensor,
    /// Number of parameters of the plain form, which is the form with the fewest parameters. A form with n parameters
    /// uses the first n parameters of the effect. n is a multiple of `plain`, and the full form has n = `count`.
    pub plain: usize,
    /// Number of parameters of the full form.
    pub count: usize,
    /// Whether the field depends on a further, nonlinear parameter, called the shape, for example a time constant. The
    /// shape is positive.
    pub is_shaped: bool,
    /// The measured quantities on which the field depends, each named by its sensor. The list contains `Gyroscope` if
    /// the field depends on the true angular rate, and `Accelerometer` if it depends on the true specific force.
    /// `needs` contains the other quantities.
    pub reads: &'static [Sensor],
    /// Quantities of [`Surroundings`] on which the field depends.
    pub needs: &'static [Need],
    /// Computes the field times the parameters, `Phi theta`, from the state, the shape (nonlinear parameter) and theta.
    /// Entries of theta after the last parameter are zero.
    pub sum: fn(&State<F>, F, &[F; MAX_PARAMETERS]) -> Vector3<F>,
    /// Computes the field: sets the columns of Phi, one for each parameter, from the state and the shape.
    #[cfg(feature = "catalogue")]
    pub columns: fn(&State<F>, F, &mut Columns<F>),
    /// Name of the effect in files, commands and reports.
    #[cfg(feature = "catalogue")]
    pub name: &'static str,
    /// The parameters theta, in the order of the columns of the field.
    #[cfg(feature = "catalogue")]
    pub parameters: &'static [Parameter],
    /// Name, unit and typical size of the shape; `None` if the field does not depend on a shape.
    #[cfg(feature = "catalogue")]
    pub shape: Option<Parameter>,
    /// Formula of the error `Phi theta` that the effect adds, as text.
    #[cfg(feature = "catalogue")]
    pub formula: &'static str,
    /// Measurements in which the effect is observable, as text.
    #[cfg(feature = "catalogue")]
    pub observable: &'static str,
    /// Other effects or causes that change the data in a similar way and are easily confused with this effect.
    #[cfg(feature = "catalogue")]
    pub aliases: &'static [Alias],
}

/// Two effects are equal if they have the same name. Without the feature `catalogue`, they are equal if they have the
/// same number and the same function `sum`.
impl<F: RealField + Copy> PartialEq for Effect<F> {
    fn eq(&self, other: &Self) -> bool {
        #[cfg(feature = "catalogue")]
        let same = self.name == other.name;
        #[cfg(not(feature = "catalogue"))]
        let same = self.number == other.number && core::ptr::fn_addr_eq(self.sum, other.sum);
        same
    }
}

/// Sensor on which an effect acts. The sensor determines the quantity and the unit of the error that the effect adds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// The effect adds a specific force, m/s^2.
    Accelerometer,
    /// The effect adds an angular rate, rad/s.
    Gyroscope,
    /// The effect adds an angle to the encoder reading of each motor of the stand, rad. Encoders are part of the stand
    /// and not of the unit.
    Encoder,
}

/// A parameter of an effect. Its full name in a list of all parameters is `EFFECT_NAME`: the name of the effect, an
/// underscore, and the name of the parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name of the parameter, unique within its effect. It is an axis (`x`), an entry of a matrix, or a letter of the
    /// formula. The parameter `xy` adds an error on the x axis that is proportional to the y component of the cause,
    /// for example of the specific force. The parameter `x_yz` adds an error on the x axis that is proportional to the
    /// product of the y and z components of the cause.
    pub name: &'static str,
    /// SI unit.
    pub unit: &'static str,
    /// Typical magnitude for an ordinary MEMS sensor, from datasheets, in the unit `unit`.
    pub typical: f64,
}

/// A quantity of [`Surroundings`] on which an effect depends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Angular acceleration, [`Surroundings::angular_acceleration`].
    AngularAcceleration,
    /// Attitude, [`Surroundings::rotation_world_from_body`].
    Attitude,
    /// Temperature difference, [`Surroundings::temperature_difference_k`].
    Temperature,
    /// Variables of the temperature history, [`Surroundings::temperature_history`].
    TemperatureHistory,
    /// Time since the reference instant, [`Surroundings::time_s`].
    Time,
    /// State of the stand, [`Surroundings::stand`].
    Stand,
}

/// Another effect or cause that changes the data in a similar way, so that it is easily confused with an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alias {
    /// Name of another effect, or of another cause.
    pub with: &'static str,
    /// Measurements that distinguish the effect from the other cause.
    pub told_apart_by: &'static str,
}

impl<F: RealField + Copy> Effect<F> {
    /// The effect with this number in the binary form of a calibration; `None` if no effect has this number. The Earth
    /// rate is not returned, because it is not a sensor error.
    pub fn numbered(number: u8) -> Option<&'static Self> {
        match number {
            1 => Some(Self::GYRO_G_SENSITIVITY),
            2 => Some(Self::GYRO_G2_SENSITIVITY),
            3 => Some(Self::GYRO_SCALE_G_SENSITIVITY),
            4 => Some(Self::GYRO_SCALE_QUADRATIC),
            5 => Some(Self::GYRO_SCALE_CUBIC),
            6 => Some(Self::GYRO_SCALE_ASYMMETRY),
            7 => Some(Self::GYRO_CROSS_AXIS_QUADRATIC),
            8 => Some(Self::ACCEL_SCALE_QUADRATIC),
            9 => Some(Self::ACCEL_SCALE_CUBIC),
            10 => Some(Self::ACCEL_SCALE_ASYMMETRY),
            11 => Some(Self::ACCEL_CROSS_AXIS_QUADRATIC),
            12 => Some(Self::GYRO_BIAS_TEMPERATURE),
            13 => Some(Self::GYRO_SCALE_TEMPERATURE),
            14 => Some(Self::ACCEL_BIAS_TEMPERATURE),
            15 => Some(Self::ACCEL_SCALE_TEMPERATURE),
            16 => Some(Self::GYRO_BIAS_DRIFT),
            17 => Some(Self::GYRO_BIAS_WARMUP),
            18 => Some(Self::GYRO_SCALE_DRIFT),
            19 => Some(Self::ACCEL_BIAS_DRIFT),
            20 => Some(Self::ACCEL_BIAS_WARMUP),
            21 => Some(Self::GYRO_ANGULAR_ACCELERATION),
            22 => Some(Self::GYRO_TIME_OFFSET),
            24 => Some(Self::ACCEL_LEVER_ARM),
            25 => Some(Self::ACCEL_SIZE_EFFECT),
            26 => Some(Self::GYRO_BIAS_TEMPERATURE_LAG),
            27 => Some(Self::GYRO_BIAS_TEMPERATURE_RATE),
            28 => Some(Self::GYRO_BIAS_TEMPERATURE_HYSTERESIS),
            29 => Some(Self::ACCEL_BIAS_TEMPERATURE_LAG),
            30 => Some(Self::ACCEL_BIAS_TEMPERATURE_RATE),
            31 => Some(Self::ACCEL_BIAS_TEMPERATURE_HYSTERESIS),
            _ => None,
        }
    }

    /// Whether the effect has a form with this number of parameters. The forms of an effect differ in the number of
    /// terms of the field.
    pub fn has_form(&self, parameters: usize) -> bool {
        parameters > 0 && parameters <= self.count && parameters.checked_rem(self.plain) == Some(0)
    }

    /// Whether the effect depends on the quantity `need` of the [`Surroundings`].
    pub fn has_need(&self, need: Need) -> bool {
        // A loop is used instead of `contains`. Without optimisation, `contains` would add code that can panic.
        for own in self.needs {
            if *own == need {
                return true;
            }
        }
        false
    }

    /// Name of the effect for messages. Without the feature `catalogue`, effects have no names.
    fn label(&self) -> &'static str {
        #[cfg(feature = "catalogue")]
        let label = self.name;
        #[cfg(not(feature = "catalogue"))]
        let label = "the effect";
        label
    }

    /// Name of the shape for messages. The shape is the parameter on which the effect depends nonlinearly, for example
    /// a time constant. `None` if the effect has no shape. Without the feature `catalogue`, the name is always "shape".
    fn shape_label(&self) -> Option<&'static str> {
        #[cfg(feature = "catalogue")]
        let label = self.shape.map(|shape| shape.name);
        #[cfg(not(feature = "catalogue"))]
        let label = self.is_shaped.then_some("shape");
        label
    }
}

#[cfg(feature = "catalogue")]
impl<F: RealField + Copy> Effect<F> {
    const FAMILIES: [&'static [&'static Self]; 7] = [
        Self::G_SENSITIVITY,
        Self::SCALE,
        Self::TEMPERATURE,
        Self::TEMPERATURE_HISTORY,
        Self::DRIFT,
        Self::DYNAMICS,
        Self::ENCODER,
    ];

    /// All effects of the catalogue, family by family.
    pub fn catalogue() -> impl Iterator<Item = &'static Self> {
        Self::FAMILIES.into_iter().flatten().copied()
    }

    /// The effect with this name; `None` if the catalogue does not contain it.
    pub fn find(name: &str) -> Option<&'static Self> {
        Self::catalogue().find(|effect| effect.name == name)
    }

    /// Computes the field Phi at a state: sets the first entries of `columns` to the columns of Phi, one for each of
    /// the [`parameters`](Self::parameters). The argument `shape` is the value of the nonlinear parameter. It is
    /// ignored if [`shape`](Self::shape) is `None`.
    #[inline]
    pub fn field(&self, state: &State<F>, shape: F, columns: &mut Columns<F>) {
        (self.columns)(state, shape, columns);
    }
}

const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// Parameter names of an effect with one parameter for each sensor axis.
const AXES: [&str; 3] = ["x", "y", "z"];
/// Parameter names of an effect with a 3x3 matrix, row by row.
const ENTRIES: [&str; 9] = ["xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"];

/// Array of parameters with the same unit and the same typical magnitude.
const fn parameters<const N: usize>(names: [&'static str; N], unit: &'static str, typical: f64) -> [Parameter; N] {
    let mut all = [Parameter { name: "", unit, typical }; N];
    let mut i = 0;
    while i < N {
        all[i].name = names[i];
        i += 1;
    }
    all
}

/// Squares of the components: `(x^2, y^2, z^2)`.
#[inline(always)]
fn squares<F: RealField + Copy>(v: &Vector3<F>) -> Vector3<F> {
    each(v, v)
}

/// Products of two different components: `(y z, x z, x y)`.
#[inline(always)]
fn cross_products<F: RealField + Copy>(v: &Vector3<F>) -> Vector3<F> {
    Vector3::new(v.y * v.z, v.x * v.z, v.x * v.y)
}
