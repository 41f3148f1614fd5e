//! Effects with the numerical values of their parameters, as a calibration stores them.
//!
//! ```text
//! seen = true + sum_c Phi_c(true) theta_c
//! true <- seen - sum_c Phi_c(true) theta_c,   starting at seen      model.md (16)
//! ```
//!
//! `seen` is the rate or force with the errors of the effects. theta_c are the parameters of effect c. Phi_c is the
//! field of effect c: the derivatives, with respect to theta_c, of the error that the effect adds.

use super::{Effect, MAX_PARAMETERS, Sensor, State, Surroundings};
use crate::vector::{add, largest, sub};
use core::{error::Error, fmt};
use nalgebra::{RealField, Vector3, convert};

/// Maximum number of effects in a calibration. It fixes the size of [`EffectSet`], because this crate uses no
/// allocator.
pub const MAX_EFFECTS: usize = 12;

/// Maximum number of iterations of [`EffectSet::remove`]. If each iteration reduces the error to at most 0.83 of its
/// previous value, 200 iterations reduce it to the rounding error of f64. Effects of usual sizes need at most seven
/// iterations.
pub const MAX_PASSES: usize = 200;

/// An effect and the values of its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectValues<F: RealField + Copy> {
    effect: &'static Effect<F>,
    values: [F; MAX_PARAMETERS],
    count: usize,
    shape: F,
}

impl<F: RealField + Copy> EffectValues<F> {
    /// Creates an effect from the parameter values of one of its forms (the plain form, the full form or a form between
    /// them), in the units of the catalogue. `shape` is the parameter on which the effect depends nonlinearly, for
    /// example a time constant. It must be given if and only if the effect has such a parameter.
    ///
    /// # Errors
    /// [`EffectError`] states which argument does not match the effect.
    pub fn try_new(effect: &'static Effect<F>, values: &[F], shape: Option<F>) -> Result<Self, EffectError> {
        let (name, count, all) = (effect.label(), values.len(), effect.count);
        if !effect.has_form(count) {
            return Err(EffectError::Count { name, plain: effect.plain, all, given: count });
        }
        if !values.iter().all(F::is_finite) {
            return Err(EffectError::NotFinite { name });
        }
        let shape = match (effect.shape_label(), shape) {
            (None, None) => F::one(),
            (Some(_), Some(shape)) if shape.is_finite() && shape > F::zero() => shape,
            (wanted, _) => return Err(EffectError::Shape { name, wanted }),
        };
        let mut all_values = [F::zero(); MAX_PARAMETERS];
        for (place, value) in all_values.iter_mut().zip(values) {
            *place = *value;
        }
        Ok(Self { effect, values: all_values, count, shape })
    }

    /// The effect, as the catalogue defines it.
    pub fn effect(&self) -> &'static Effect<F> {
        self.effect
    }

    /// The parameter values with which the effect was created.
    pub fn values(&self) -> &[F] {
        self.values.get(..self.count).unwrap_or_default()
    }

    /// Value of the shape (the nonlinear parameter); `None` if the effect has no shape.
    pub fn shape(&self) -> Option<F> {
        self.effect.is_shaped.then_some(self.shape)
    }

    /// The error `Phi(state) theta` that the effect adds to the true rate (rad/s) or force (m/s^2), in the body frame,
    /// or to the motor angles (rad).
    #[inline]
    pub fn at(&self, state: &State<F>) -> Vector3<F> {
        (self.effect.sum)(state, self.shape, &self.values)
    }
}

/// Set of effects of a unit, at most [`MAX_EFFECTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectSet<F: RealField + Copy> {
    members: [Option<EffectValues<F>>; MAX_EFFECTS],
}

impl<F: RealField + Copy> EffectSet<F> {
    /// The empty set.
    pub fn none() -> Self {
        Self { members: [None; MAX_EFFECTS] }
    }

    /// Adds an effect.
    ///
    /// # Errors
    /// [`EffectError::Full`] if the set already contains [`MAX_EFFECTS`] effects.
    pub fn push(&mut self, values: EffectValues<F>) -> Result<(), EffectError> {
        let place = self.members.iter_mut().find(|member| member.is_none()).ok_or(EffectError::Full)?;
        *place = Some(values);
        Ok(())
    }

    /// Whether the set is empty.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }

    /// The effects, in the order in which they were pushed.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = &EffectValues<F>> {
        self.members.iter().map_while(Option::as_ref)
    }

    /// Sum of the errors that all effects add to the true rate, rad/s, and to the true force, m/s^2. Effects on
    /// encoders are not included.
    pub fn at(&self, state: &State<F>) -> (Vector3<F>, Vector3<F>) {
        let (mut on_rate, mut on_force) = (zeros(), zeros());
        for member in self.iter() {
            let sum = match member.effect.sensor {
                Sensor::Gyroscope => &mut on_rate,
                Sensor::Accelerometer => &mut on_force,
                Sensor::Encoder => continue,
            };
            *sum = add(sum, &member.at(state));
        }
        (on_rate, on_force)
    }

    /// Whether any effect depends on the true value of the quantity that `sensor` measures.
    fn reads(&self, sensor: Sensor) -> bool {
        // A loop is used instead of `contains`. Without optimisation, `contains` would add code that can panic.
        for member in self.iter() {
            for read in member.effect.reads {
                if *read == sensor {
                    return true;
                }
            }
        }
        false
    }

    /// Sum of the errors, rad, that all effects add to the encoder readings of the stand; one component for each motor.
    #[cfg(feature = "catalogue")]
    pub fn on_encoders(&self, state: &State<F>) -> Vector3<F> {
        let encoders = self.iter().filter(|member| member.effect.sensor == Sensor::Encoder);
        encoders.fold(Vector3::zeros(), |sum, member| sum + member.at(state))
    }

    /// Computes the true `(rate, force)`, in rad/s and m/s^2 in the body frame, from the values `seen` that contain the
    /// errors of the effects. The method solves `seen = true + at(true)` for the true values, where [`at`](Self::at) is
    /// the sum of these errors (`docs/model.md` (16)).
    ///
    /// The method iterates `true <- seen - effects(true)`. It stops when an iteration changes rate and force only by
    /// rounding errors. If no effect depends on the rate, the change of the rate is not tested. If no effect depends on
    /// the force, the change of the force is not tested. Each iteration multiplies the error by at most D, the norm of
    /// the derivative of the effects with respect to rate and force, for example by 0.002 for a scale asymmetry of
    /// 0.2 %. A single effect of typical size needs one iteration if the error that it adds does not depend on the
    /// quantity to which it is added. Otherwise, it needs two or three iterations in `f32`, and two to seven in `f64`.
    /// If D exceeds about 0.83, the iteration does not converge in [`MAX_PASSES`] steps, and both results are NaN.
    pub fn remove(
        &self,
        seen_rate: Vector3<F>,
        seen_force: Vector3<F>,
        surroundings: &Surroundings<F>,
    ) -> (Vector3<F>, Vector3<F>) {
        let reads = [self.reads(Sensor::Gyroscope), self.reads(Sensor::Accelerometer)];
        self.remove_reading(reads, seen_rate, seen_force, surroundings, |_| (zeros(), zeros()))
    }

    /// Like [`remove`](Self::remove), but with further effects that the caller defines. `own` returns the errors that
    /// these effects add to the true rate and to the true force in a given state.
    pub fn remove_with(
        &self,
        seen_rate: Vector3<F>,
        seen_force: Vector3<F>,
        surroundings: &Surroundings<F>,
        own: impl Fn(&State<F>) -> (Vector3<F>, Vector3<F>),
    ) -> (Vector3<F>, Vector3<F>) {
        // `own` may depend on both rate and force.
        self.remove_reading([true; 2], seen_rate, seen_force, surroundings, own)
    }

    /// The iteration of [`remove`](Self::remove). The first element of `reads` states whether any effect depends on the
    /// rate, and the second whether any effect depends on the force.
    #[inline]
    fn remove_reading(
        &self,
        reads: [bool; 2],
        seen_rate: Vector3<F>,
        seen_force: Vector3<F>,
        surroundings: &Surroundings<F>,
        own: impl Fn(&State<F>) -> (Vector3<F>, Vector3<F>),
    ) -> (Vector3<F>, Vector3<F>) {
        let mut state = State { angular_rate: seen_rate, specific_force: seen_force, surroundings: *surroundings };
        let [rate_counts, force_counts] = reads;
        let (rate_size, force_size) = (largest(&seen_rate), largest(&seen_force));
        // A `while` loop is used because, without optimisation, a `for` loop over a range contains a check that can
        // panic (Rust 1.96).
        let mut passes = 0;
        while passes < MAX_PASSES {
            passes += 1;
            let (on_rate, on_force) = self.at(&state);
            let (own_rate, own_force) = own(&state);
            let (on_rate, on_force) = (add(&on_rate, &own_rate), add(&on_force, &own_force));
            let (rate, force) = (sub(&seen_rate, &on_rate), sub(&seen_force, &on_force));
            let settled = is_rounding(rate_counts, &sub(&rate, &state.angular_rate), rate_size, &on_rate)
                && is_rounding(force_counts, &sub(&force, &state.specific_force), force_size, &on_force);
            if settled {
                return (rate, force);
            }
            (state.angular_rate, state.specific_force) = (rate, force);
        }
        let nan: F = convert(f64::NAN);
        let nan = Vector3::new(nan, nan, nan);
        (nan, nan)
    }
}

#[inline]
fn zeros<F: RealField + Copy>() -> Vector3<F> {
    Vector3::new(F::zero(), F::zero(), F::zero())
}

/// Whether the iteration of a quantity (rate or force) has converged. It has converged if the last iteration changed
/// the quantity (`change`) by no more than about a rounding error. `seen` is the largest absolute component of the
/// quantity before the effects are removed, and `effects` is the error that the effects add to the quantity. If no
/// effect depends on the quantity (`counts` is false), any change is permitted.
fn is_rounding<F: RealField + Copy>(counts: bool, change: &Vector3<F>, seen: F, effects: &Vector3<F>) -> bool {
    let rounding: F = convert::<f64, F>(16.0) * F::default_epsilon();
    let limit = rounding * (seen + largest(effects));
    // If the effects diverge to infinity, the limit is infinite. The iteration has then not converged.
    if counts { largest(change) <= limit && limit.is_finite() } else { F::zero() <= limit && limit.is_finite() }
}

/// Reasons why parameter values do not match an effect, or why an effect cannot be added to a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EffectError {
    /// The number of parameters matches no form of the effect.
    Count {
        /// Name of the effect.
        name: &'static str,
        /// Number of parameters of the plain form, which has the fewest parameters.
        plain: usize,
        /// Number of parameters of the full form, which has all parameters.
        all: usize,
        /// Number of parameters given.
        given: usize,
    },
    /// A parameter is infinite or NaN.
    NotFinite {
        /// Name of the effect.
        name: &'static str,
    },
    /// The shape (the nonlinear parameter) is missing, or is given for an effect without a shape, or is not a positive
    /// number.
    Shape {
        /// Name of the effect.
        name: &'static str,
        /// Name of the shape, if the effect has one.
        wanted: Option<&'static str>,
    },
    /// The set already contains [`MAX_EFFECTS`] effects.
    Full,
}

impl fmt::Display for EffectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Count { name, plain, all, given } if plain == all => {
                write!(f, "{name} has {all} parameters, {given} were given")
            }
            Self::Count { name, plain, all, given } if 2 * plain < all => {
                write!(f, "{name} has {plain}, {} or {all} parameters; {given} were given", 2 * plain)
            }
            Self::Count { name, plain, all, given } => {
                write!(f, "{name} has {plain} parameters, or {all} in its full form; {given} were given")
            }
            Self::NotFinite { name } => write!(f, "a parameter of {name} is not a finite number"),
            Self::Shape { name, wanted: Some(shape) } => write!(f, "{name} needs its {shape}, a positive number"),
            Self::Shape { name, wanted: None } => write!(f, "{name} has no shape; one was given"),
            Self::Full => write!(f, "a calibration can have at most {MAX_EFFECTS} effects"),
        }
    }
}

impl Error for EffectError {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::StandState;

    fn values(name: &str, values: &[f64], shape: Option<f64>) -> Result<EffectValues<f64>, EffectError> {
        EffectValues::try_new(Effect::find(name).unwrap(), values, shape)
    }

    fn still() -> State<f64> {
        State {
            angular_rate: Vector3::zeros(),
            specific_force: Vector3::z() * 9.8,
            surroundings: Surroundings::unknown(),
        }
    }

    #[test]
    fn what_was_given_comes_back() -> Result<(), EffectError> {
        let warmup = values("gyro_bias_warmup", &[1.0, 2.0, 3.0], Some(60.0))?;
        assert_eq!((warmup.effect().name, warmup.values()), ("gyro_bias_warmup", &[1.0, 2.0, 3.0][..]));
        assert_eq!(warmup.shape(), Some(60.0));
        assert_eq!(values("gyro_bias_drift", &[1.0, 2.0, 3.0], None)?.shape(), None);
        Ok(())
    }

    #[test]
    fn what_does_not_fit_the_effect_is_refused() {
        let name = "gyro_bias_warmup";
        for given in [0, 2, 4, 19] {
            let count = EffectError::Count { name, plain: 3, all: 3, given };
            assert_eq!(values(name, &[0.0; 19][..given], Some(60.0)), Err(count));
        }
        let not_finite = Err(EffectError::NotFinite { name });
        assert_eq!(values(name, &[0.0, f64::NAN, 0.0], Some(60.0)), not_finite);
        for shape in [None, Some(0.0), Some(-1.0), Some(f64::NAN), Some(f64::INFINITY)] {
            assert_eq!(values(name, &[0.0; 3], shape), Err(EffectError::Shape { name, wanted: Some("tau") }));
        }
        let name = "earth_rate";
        assert_eq!(values(name, &[0.0; 3], Some(1.0)), Err(EffectError::Shape { name, wanted: None }));
    }

    #[test]
    fn a_set_adds_its_effects_sensor_by_sensor() -> Result<(), EffectError> {
        let mut set = EffectSet::none();
        assert!(set.is_empty());
        set.push(values("gyro_g_sensitivity", &[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], None)?)?;
        set.push(values("accel_scale_asymmetry", &[0.0, 0.0, 0.1], None)?)?;
        set.push(values("accel_scale_quadratic", &[0.0, 0.0, 0.01], None)?)?;
        assert!(set.iter().map(|member| member.effect().name).eq([
            "gyro_g_sensitivity",
            "accel_scale_asymmetry",
            "accel_scale_quadratic"
        ]));
        let (rate, force) = set.at(&still());
        assert!((rate - Vector3::new(9.8e-3, 0.0, 0.0)).norm() < 1e-17);
        assert!((force - Vector3::new(0.0, 0.0, 0.98 + 0.9604)).norm() < 1e-15);
        Ok(())
    }

    #[test]
    fn a_full_set_takes_no_more() -> Result<(), EffectError> {
        let (mut set, one) = (EffectSet::none(), values("gyro_time_offset", &[1e-3], None)?);
        for _ in 0..MAX_EFFECTS {
            set.push(one)?;
        }
        assert_eq!(set.push(one), Err(EffectError::Full));
        assert_eq!(set.iter().count(), MAX_EFFECTS);
        Ok(())
    }

    #[test]
    fn effects_of_encoders_act_on_encoders_alone() -> Result<(), EffectError> {
        let mut set = EffectSet::none();
        set.push(values("encoder_backlash", &[1e-3, 2e-3, 3e-3], None)?)?;
        set.push(values("gyro_g_sensitivity", &[1e-3; 9], None)?)?;
        set.push(values("encoder_time_offset", &[0.5], None)?)?;
        let stand = StandState {
            angle_rad: Vector3::new(1.0, 2.0, 3.0),
            rate_radps: Vector3::new(0.0, -2.0, 4.0),
            direction: Vector3::new(1.0, -1.0, 0.0),
        };
        let state = State { surroundings: Surroundings { stand: Some(stand), ..Surroundings::unknown() }, ..still() };
        assert!((set.on_encoders(&state) - Vector3::new(1e-3, -1.002, 2.0)).norm() < 1e-15);

        let mut without = EffectSet::none();
        without.push(values("gyro_g_sensitivity", &[1e-3; 9], None)?)?;
        assert_eq!(without.on_encoders(&state), Vector3::zeros());
        assert_eq!(set.at(&state), without.at(&state));
        let (rate, force) = (Vector3::new(0.1, -0.2, 0.3), state.specific_force);
        let surroundings = &state.surroundings;
        assert_eq!(set.remove(rate, force, surroundings), without.remove(rate, force, surroundings));
        Ok(())
    }

    #[test]
    fn the_inverse_is_that_of_the_quadratic_equation() -> Result<(), EffectError> {
        // seen = w + k w^2. An iteration multiplies the error by about 2 k w. For the two values of k, this factor is
        // up to 0.2 and up to 0.8.
        let rate = Vector3::new(5.0, -4.0, 0.0);
        for (k, tolerance) in [(0.02, 1e-14), (0.08, 2e-13)] {
            let mut set = EffectSet::none();
            set.push(values("gyro_scale_quadratic", &[k; 3], None)?)?;
            let seen = rate + rate.component_mul(&rate) * k;
            let (back, force) = set.remove(seen, Vector3::zeros(), &Surroundings::unknown());
            assert!((back - rate).norm() < tolerance, "{back:?}");
            assert_eq!(force, Vector3::zeros());
        }
        Ok(())
    }

    #[test]
    fn an_effect_given_as_a_function_is_removed_like_one_of_the_catalogue() -> Result<(), EffectError> {
        let (k, m) = (0.02, 1e-3);
        let mut both = EffectSet::none();
        both.push(values("gyro_scale_quadratic", &[k; 3], None)?)?;
        let one = both;
        both.push(values("gyro_g_sensitivity", &[m; 9], None)?)?;
        let own = |state: &State<f64>| (Vector3::repeat(m * state.specific_force.sum()), Vector3::zeros());
        let (rate, force, nothing) =
            (Vector3::new(3.0, -2.0, 0.5), Vector3::new(1.0, 9.0, -2.0), Surroundings::unknown());
        let (expected, found) = (both.remove(rate, force, &nothing), one.remove_with(rate, force, &nothing, own));
        assert!((expected.0 - found.0).norm() < 1e-14 && expected.1 == found.1, "{found:?}");
        assert!((one.remove(rate, force, &nothing).0 - found.0).norm() > 1e-3);

        let diverges = |state: &State<f64>| (state.angular_rate * 2.0, Vector3::zeros());
        assert!(one.remove_with(rate, force, &nothing, diverges).0.x.is_nan());
        Ok(())
    }

    #[test]
    fn what_cannot_be_undone_is_not_a_number() -> Result<(), EffectError> {
        let mut set = EffectSet::none();
        set.push(values("gyro_scale_cubic", &[1.0; 3], None)?)?;
        for seen in [2.0, 1e6, f64::INFINITY, f64::NAN] {
            let (rate, force) = set.remove(Vector3::repeat(seen), Vector3::zeros(), &Surroundings::unknown());
            assert!(rate.iter().chain(force.iter()).all(|value| value.is_nan()), "{seen}: {rate:?}");
        }
        Ok(())
    }
}
