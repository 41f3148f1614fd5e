//! What a real sensor does beyond a sensitivity and a bias: the catalogue of effects, each defined once.
//!
//! ```text
//! measured = sensitivity * (true + sum_c Phi_c(state) theta_c) + bias      model.md (15)
//! ```
//!
//! An [`Effect`] is a name, a sensor, parameters theta with units and typical sizes, and one function, the field Phi: the
//! (3, p) derivative of what the sensor sees, in the body frame, by the parameters. The simulation adds `Phi theta`, the
//! device takes it away again ([`EffectSet::remove`]), and every Jacobian of an estimate is Phi carried through that estimate.
//!
//! A family of effects is a file with a table of rows. To add an effect, write its field function and its row there.
//!
//! ```
//! use imucal_core::effects::{Effect, EffectValues, State, Surroundings};
//! use nalgebra::Vector3;
//!
//! // A gyroscope at 20 K above the calibration's temperature that drifts by 1e-4 rad/s per kelvin on x.
//! let effect = Effect::<f64>::find("gyro_bias_temperature").expect("it is in the catalogue");
//! let drifting = EffectValues::try_new(effect, &[1e-4, 0.0, 0.0], None)?;
//! let surroundings = Surroundings { temperature_difference_k: Some(20.0), ..Surroundings::unknown() };
//! let state = State { angular_rate: Vector3::zeros(), specific_force: Vector3::z() * 9.80665, surroundings };
//! assert!((drifting.at(&state) - Vector3::new(2e-3, 0.0, 0.0)).norm() < 1e-15);
//! # Ok::<(), imucal_core::effects::EffectError>(())
//! ```
//!
//! # What is not here
//!
//! Noise, bias instability and random walks (they have no field), the geometry of the stand that moves the unit, and faults of the
//! data (saturation, lost samples). What the encoders of a stand read wrong is here: their fields are motor angles, and the
//! device, which has no stand, does without them.

mod drift;
mod dynamics;
mod encoder;
mod g_sensitivity;
mod scale;
mod temperature;
mod values;

#[cfg(test)]
mod tests;

pub use values::{EffectError, EffectSet, EffectValues, MAX_EFFECTS};

use nalgebra::{RealField, UnitQuaternion, Vector3};

/// The largest number of parameters of an effect.
pub const MAX_PARAMETERS: usize = 18;

/// Room for the columns of any field; an effect fills the first ones, one for each parameter.
pub type Columns<F> = [Vector3<F>; MAX_PARAMETERS];

/// The true state of a sample, on which the effects depend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<F: RealField + Copy> {
    /// Angular rate of the body against the world, in the body frame, rad/s.
    pub angular_rate: Vector3<F>,
    /// Specific force in the body frame, m/s^2.
    pub specific_force: Vector3<F>,
    /// What the accelerometer and the gyroscope do not measure themselves.
    pub surroundings: Surroundings<F>,
}

/// What an effect may depend on besides rate and force. `None` is not known: the terms of an effect that depend on it are
/// left out. [`Effect::needs`] says which effects that concerns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings<F: RealField + Copy> {
    /// Derivative of the angular rate in the body frame, rad/s^2.
    pub angular_acceleration: Option<Vector3<F>>,
    /// Attitude: takes a vector from the body to the world, `v_w = r_wb * v_b`.
    pub rotation_world_from_body: Option<UnitQuaternion<F>>,
    /// Temperature of the sensor less the temperature that the sensitivities and biases are for, K.
    pub temperature_difference_k: Option<F>,
    /// Time since the sensor was switched on, or since another start that the calibration is for, s.
    pub time_s: Option<F>,
    /// The stand that moves the body.
    pub stand: Option<StandState<F>>,
}

/// True state of a stand's three motors; outer motor first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandState<F: RealField + Copy> {
    /// Angles, rad; more than a full turn is kept as such.
    pub angle_rad: Vector3<F>,
    /// Their derivatives, rad/s.
    pub rate_radps: Vector3<F>,
    /// Sign of the last motion of each motor, the one that goes on included: -1, 1, or 0 before any.
    pub direction: Vector3<F>,
}

impl<F: RealField + Copy> StandState<F> {
    /// Motors that stand still and have not moved yet.
    pub fn still(angle_rad: Vector3<F>) -> Self {
        Self { angle_rad, rate_radps: Vector3::zeros(), direction: Vector3::zeros() }
    }
}

impl<F: RealField + Copy> Surroundings<F> {
    /// Nothing is known.
    pub fn unknown() -> Self {
        Self {
            angular_acceleration: None,
            rotation_world_from_body: None,
            temperature_difference_k: None,
            time_s: None,
            stand: None,
        }
    }
}

/// One row of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Effect<F: RealField + Copy> {
    /// The name by which files, commands and reports know it.
    pub name: &'static str,
    /// The sensor that it acts on.
    pub sensor: Sensor,
    /// The parameters theta, in the order of the columns of the field.
    pub parameters: &'static [Parameter],
    /// The plain form has this many of the parameters, the first ones; the full form has them all.
    pub plain: usize,
    /// A number that the field depends on other than linearly, such as a time constant. It is positive.
    pub shape: Option<Parameter>,
    /// Of which sensors the field depends on the true values: where these do not change, it stays as it is.
    pub reads: &'static [Sensor],
    /// Which of the [`Surroundings`] the field depends on.
    pub needs: &'static [Need],
    /// The field times its parameters, as text.
    pub formula: &'static str,
    /// The data that shows it.
    pub observable: &'static str,
    /// What it is easily mistaken for.
    pub aliases: &'static [Alias],
    /// The field function: sets the columns of Phi, one for each parameter, given the state and the shape.
    pub columns: fn(&State<F>, F, &mut Columns<F>),
}

/// Two are equal when they have the same name.
impl<F: RealField + Copy> PartialEq for Effect<F> {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// The sensor that an effect acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// The field is a specific force, m/s^2.
    Accelerometer,
    /// The field is an angular rate, rad/s.
    Gyroscope,
    /// The field is the angle of each motor of the stand, rad; no sensor of the unit.
    Encoder,
}

/// One number of an effect. Its name in a list of all parameters is that of the effect, `_`, and this one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// What tells it from the others of its effect: an axis (`x`), an entry (`xy`: seen on x, caused by y; `x_yz`: by the
    /// product of y and z), or a letter of the formula.
    pub name: &'static str,
    /// SI unit.
    pub unit: &'static str,
    /// Size in this unit of an ordinary MEMS sensor, after datasheets.
    pub typical: f64,
}

/// A quantity of [`Surroundings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// [`Surroundings::angular_acceleration`].
    AngularAcceleration,
    /// [`Surroundings::rotation_world_from_body`].
    Attitude,
    /// [`Surroundings::temperature_difference_k`].
    Temperature,
    /// [`Surroundings::time_s`].
    Time,
    /// [`Surroundings::stand`].
    Stand,
}

/// Something whose trace in the data is alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alias {
    /// The name of another effect, or of what else explains the data.
    pub with: &'static str,
    /// What makes the difference.
    pub told_apart_by: &'static str,
}

impl<F: RealField + Copy> Effect<F> {
    const FAMILIES: [&'static [Self]; 6] =
        [Self::G_SENSITIVITY, Self::SCALE, Self::TEMPERATURE, Self::DRIFT, Self::DYNAMICS, Self::ENCODER];

    /// All effects, family by family.
    pub fn catalogue() -> impl Iterator<Item = &'static Self> {
        Self::FAMILIES.into_iter().flatten()
    }

    /// The effect of this name.
    pub fn find(name: &str) -> Option<&'static Self> {
        Self::catalogue().find(|effect| effect.name == name)
    }

    /// Sets the first columns of Phi, as many as there are [`parameters`](Self::parameters); `shape` is not used where
    /// [`shape`](Self::shape) is `None`.
    #[inline]
    pub fn field(&self, state: &State<F>, shape: F, columns: &mut Columns<F>) {
        (self.columns)(state, shape, columns);
    }
}

const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// One parameter for each sensor axis.
const AXES: [&str; 3] = ["x", "y", "z"];
/// The entries of a matrix, row by row.
const ENTRIES: [&str; 9] = ["xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"];

/// Parameters of one unit and one typical size.
const fn parameters<const N: usize>(names: [&'static str; N], unit: &'static str, typical: f64) -> [Parameter; N] {
    let mut all = [Parameter { name: "", unit, typical }; N];
    let mut i = 0;
    while i < N {
        all[i].name = names[i];
        i += 1;
    }
    all
}

/// The field of `diag(theta) cause`, with the parameters [`AXES`].
#[inline]
fn set_axes<F: RealField + Copy>(cause: Vector3<F>, columns: &mut [Vector3<F>]) {
    for (i, column) in columns.iter_mut().take(3).enumerate() {
        *column = Vector3::ith(i, cause[i]);
    }
}

/// The field of a matrix times `cause`, its [`ENTRIES`] being the parameters.
#[inline]
fn set_entries<F: RealField + Copy>(cause: Vector3<F>, columns: &mut [Vector3<F>]) {
    for (k, column) in columns.iter_mut().take(9).enumerate() {
        *column = Vector3::ith(k / 3, cause[k % 3]);
    }
}

/// `(x^2, y^2, z^2)`.
#[inline]
fn squares<F: RealField + Copy>(v: &Vector3<F>) -> Vector3<F> {
    v.component_mul(v)
}

/// `(y z, x z, x y)`.
#[inline]
fn cross_products<F: RealField + Copy>(v: &Vector3<F>) -> Vector3<F> {
    Vector3::new(v.y * v.z, v.x * v.z, v.x * v.y)
}
