//! Gives Python access to the catalogue of effects. Evaluates the fields of effects (the derivatives of an effect's
//! error with respect to its parameters), and converts effects and their parameter values from Python objects to the
//! types of the library.

use imucal::calibrate::EffectChoice;
use imucal::correct::temperature_history_of;
use imucal::error::Error;
use imucal::recording::REFERENCE_TEMPERATURE_DEGC;
use imucal_core::effects::{self as library, Columns, EffectSet, MAX_PARAMETERS, StandState, State, Surroundings};
use imucal_core::so3;
use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};
use nalgebra::Vector3;
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::arrays::{column, rows};
use crate::error::ToPython;

/// Name, unit and typical size of a parameter.
type ParameterTuple = (&'static str, &'static str, f64);

/// One effect of the catalogue.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Effect {
    name: &'static str,
    /// Number of the effect in the binary form of a calibration; 0 if the binary form cannot store the effect.
    number: u8,
    sensor: &'static str,
    parameters: Vec<ParameterTuple>,
    plain: usize,
    shape: Option<ParameterTuple>,
    needs: Vec<&'static str>,
    formula: &'static str,
    observable: &'static str,
    /// Other effects or causes with which this effect is easily confused. For each: its name, and the measurements that
    /// distinguish it from this effect.
    aliases: Vec<(&'static str, &'static str)>,
}

impl From<&library::Effect<f64>> for Effect {
    fn from(effect: &library::Effect<f64>) -> Self {
        let parameter = |p: &library::Parameter| (p.name, p.unit, p.typical);
        Self {
            name: effect.name,
            number: library::Effect::<f64>::numbered(effect.number).map_or(0, |effect| effect.number),
            sensor: match effect.sensor {
                library::Sensor::Accelerometer => "accelerometer",
                library::Sensor::Gyroscope => "gyroscope",
                library::Sensor::Encoder => "encoder",
            },
            parameters: effect.parameters.iter().map(parameter).collect(),
            plain: effect.plain,
            shape: effect.shape.as_ref().map(parameter),
            needs: effect.needs.iter().map(need).collect(),
            formula: effect.formula,
            observable: effect.observable,
            aliases: effect.aliases.iter().map(|alias| (alias.with, alias.told_apart_by)).collect(),
        }
    }
}

fn need(need: &library::Need) -> &'static str {
    match need {
        library::Need::AngularAcceleration => "angular_acceleration",
        library::Need::Attitude => "attitude",
        library::Need::Temperature => "temperature",
        library::Need::TemperatureHistory => "temperature_history",
        library::Need::Time => "time",
        library::Need::Stand => "stand",
    }
}

/// All effects of the catalogue.
#[pyfunction]
pub(crate) fn effects() -> Vec<Effect> {
    library::Effect::<f64>::catalogue().map(Effect::from).collect()
}

pub(crate) fn find(name: &str) -> Result<&'static library::Effect<f64>, Error> {
    library::Effect::find(name).ok_or_else(|| {
        Error::Input(format!("the effect {name:?} is not in the catalogue: imucal.effects.catalogue() lists it"))
    })
}

/// An `imucal.EffectValues`, converted from its attributes.
#[derive(FromPyObject)]
pub(crate) struct EffectArrays<'py> {
    name: String,
    values: PyReadonlyArray1<'py, f64>,
    shape: Option<f64>,
}

impl EffectArrays<'_> {
    /// Converts the effects of a unit from Python to the set that the library uses.
    pub(crate) fn set(py: Python<'_>, effects: &[Self]) -> PyResult<EffectSet<f64>> {
        let mut set = EffectSet::none();
        for effect in effects {
            let values = column(py, &effect.values, &format!("the values of {}", effect.name))?;
            let row = find(&effect.name).to_python(py)?;
            library::EffectValues::try_new(row, values, effect.shape)
                .and_then(|values| set.push(values))
                .map_err(|error| Error::Input(error.to_string()))
                .to_python(py)?;
        }
        Ok(set)
    }
}

/// An `imucal.effects.State`, read from its attributes. Each array has one row for each sample. None means that a
/// quantity is unknown.
#[derive(FromPyObject)]
pub(crate) struct StateArrays<'py> {
    angular_rate: PyReadonlyArray2<'py, f64>,
    specific_force: PyReadonlyArray2<'py, f64>,
    angular_acceleration: Option<PyReadonlyArray2<'py, f64>>,
    time_s: PyReadonlyArray1<'py, f64>,
    temperature_degc: Option<PyReadonlyArray1<'py, f64>>,
    rotation_wxyz: Option<PyReadonlyArray2<'py, f64>>,
    stand_rad: Option<PyReadonlyArray2<'py, f64>>,
    stand_rate_radps: Option<PyReadonlyArray2<'py, f64>>,
    stand_direction: Option<PyReadonlyArray2<'py, f64>>,
}

impl StateArrays<'_> {
    /// The true state at each sample. `shape` is the time constant with which the temperature lag is computed, s.
    fn states(&self, py: Python<'_>, shape: Option<f64>) -> PyResult<Vec<State<f64>>> {
        let rate = rows(py, &self.angular_rate, "angular_rate")?;
        let force = rows(py, &self.specific_force, "specific_force")?;
        let time_s = column(py, &self.time_s, "time_s")?;
        let acceleration = known_rows(py, &self.angular_acceleration, "angular_acceleration")?;
        let stand_rad = known_rows(py, &self.stand_rad, "stand_rad")?;
        let stand_rate = known_rows(py, &self.stand_rate_radps, "stand_rate_radps")?;
        let stand_direction = known_rows(py, &self.stand_direction, "stand_direction")?;
        let temperature_degc = match &self.temperature_degc {
            Some(values) => Some(column(py, values, "temperature_degc")?),
            None => None,
        };
        let rotation = match &self.rotation_wxyz {
            Some(values) => Some(quaternions(py, values, "rotation_wxyz")?),
            None => None,
        };
        let lengths = [
            ("specific_force", Some(force.len())),
            ("time_s", Some(time_s.len())),
            ("angular_acceleration", acceleration.map(<[_]>::len)),
            ("temperature_degc", temperature_degc.map(<[_]>::len)),
            ("rotation_wxyz", rotation.map(<[_]>::len)),
            ("stand_rad", stand_rad.map(<[_]>::len)),
            ("stand_rate_radps", stand_rate.map(<[_]>::len)),
            ("stand_direction", stand_direction.map(<[_]>::len)),
        ];
        if let Some((name, len)) = lengths.iter().find(|(_, len)| len.is_some_and(|len| len != rate.len())) {
            let message = format!("{name} has {} rows, angular_rate {}", len.unwrap_or(0), rate.len());
            return Err(Error::Input(message)).to_python(py);
        }
        let memory = TemperatureMemory::with_time_constants(shape, shape);
        let history: Option<Vec<_>> =
            temperature_degc.map(|degc| temperature_history_of(memory, time_s, degc).collect());
        let state = |i: usize| {
            let mut surroundings = Surroundings::unknown();
            surroundings.temperature_history = history.as_ref().map(|history| history[i]);
            surroundings.time_s = Some(time_s[i]);
            surroundings.angular_acceleration = acceleration.map(|values| values[i].into());
            surroundings.temperature_difference_k = temperature_degc.map(|degc| degc[i] - REFERENCE_TEMPERATURE_DEGC);
            // A quaternion that is zero or not finite is treated as an unknown attitude.
            surroundings.rotation_world_from_body = rotation.and_then(|wxyz| so3::from_wxyz(wxyz[i]));
            surroundings.stand = stand_rad.map(|angle| StandState {
                angle_rad: angle[i].into(),
                rate_radps: stand_rate.map_or_else(Vector3::zeros, |values| values[i].into()),
                direction: stand_direction.map_or_else(Vector3::zeros, |values| values[i].into()),
            });
            State { angular_rate: rate[i].into(), specific_force: force[i].into(), surroundings }
        };
        Ok((0..rate.len()).map(state).collect())
    }
}

/// Returns the rows of an optional array (N, 3), without a copy.
fn known_rows<'a>(
    py: Python<'_>,
    array: &'a Option<PyReadonlyArray2<'_, f64>>,
    name: &str,
) -> PyResult<Option<&'a [[f64; 3]]>> {
    array.as_ref().map(|values| rows(py, values, name)).transpose()
}

/// Returns the rows of an array (N, 4), which must be in C order, without a copy.
fn quaternions<'a>(py: Python<'_>, array: &'a PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<&'a [[f64; 4]]> {
    match array.as_slice() {
        Ok(values) if array.is_c_contiguous() && array.shape()[1] == 4 => Ok(values.as_chunks::<4>().0),
        _ => Err(Error::Input(format!("{name} is not (N, 4) in C order"))).to_python(py),
    }
}

/// The field of an effect, (N, 3, p): the derivatives of the error on the three axes with respect to the p parameters,
/// at each of the N samples of `state`.
#[pyfunction]
pub(crate) fn effect_field<'py>(
    py: Python<'py>,
    name: &str,
    shape: Option<f64>,
    state: StateArrays<'py>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let effect = find(name).to_python(py)?;
    let count = effect.parameters.len();
    // This call only checks that `shape` (the nonlinear parameter, for example a time constant) is given if and only if
    // the effect has a shape. The parameter values, all zero, are not used.
    let checked = library::EffectValues::try_new(effect, &[0.0; MAX_PARAMETERS][..count], shape);
    checked.map_err(|error| Error::Input(error.to_string())).to_python(py)?;
    let states = state.states(py, shape)?;
    let field = py.detach(|| {
        let mut field = Vec::with_capacity(states.len() * 3 * count);
        for state in &states {
            let mut columns: Columns<f64> = [Vector3::zeros(); MAX_PARAMETERS];
            effect.field(state, shape.unwrap_or(1.0), &mut columns);
            field.extend((0..3).flat_map(|axis| columns[..count].iter().map(move |column| column[axis])));
        }
        field
    });
    field.into_pyarray(py).reshape([states.len(), 3, count])
}

/// For each sample: the rate of change of the temperature, K/s, the direction of the last temperature change, from -1
/// to 1, and the lag of the temperature, K.
type History<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// The temperature history at each sample: the rate of change of the temperature, the direction of the last temperature
/// change, and the lag. The lag is the output of a low-pass of the temperature with the time constant `tau_s` minus the
/// temperature.
#[pyfunction]
pub(crate) fn temperature_history<'py>(
    py: Python<'py>,
    time_s: PyReadonlyArray1<'py, f64>,
    temperature_degc: PyReadonlyArray1<'py, f64>,
    tau_s: f64,
) -> PyResult<History<'py>> {
    let times = column(py, &time_s, "time_s")?;
    let degc = column(py, &temperature_degc, "temperature_degc")?;
    if times.len() != degc.len() || !(tau_s.is_finite() && tau_s > 0.0) {
        let message = format!("{} times, {} temperatures, tau_s {tau_s}", times.len(), degc.len());
        return Err(Error::Input(message)).to_python(py);
    }
    let memory = TemperatureMemory::with_time_constants(Some(tau_s), None);
    let history: Vec<_> = py.detach(|| temperature_history_of(memory, times, degc).collect());
    let array = |of: fn(&TemperatureHistory<f64>) -> f64| history.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
    Ok((array(|own| own.rate_kps), array(|own| own.direction), array(|own| own.gyroscope_lag_k)))
}

/// Looks up the effects of the catalogue for `candidates`. Each candidate consists of the name of an effect and a
/// number of parameters, because some effects can be used with different numbers of parameters.
pub(crate) fn choices(candidates: &[(String, usize)]) -> Result<Vec<EffectChoice>, Error> {
    candidates.iter().map(|(name, parameters)| choice(name, *parameters)).collect()
}

fn choice(name: &str, parameters: usize) -> Result<EffectChoice, Error> {
    let effect = find(name)?;
    if effect.has_form(parameters) {
        Ok(EffectChoice { effect, parameters })
    } else {
        Err(Error::Input(format!("{name} has no form with {parameters} parameters")))
    }
}
