//! Python bindings of the simulation.

use std::num::NonZeroUsize;

use imucal::error::Error;
use imucal::simulate::{
    self as library, Added, Converter, Faults, Grid, HandMoves, LowPass, Program, RandomMoves, Sensor, Setup, Slip,
    Step, Temperature, Tremor, Tumble, Unit, earth,
};
use imucal_core::effects::EffectSet;
use imucal_core::so3;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays::{column, matrix, rows, to_rows, vector};
use crate::effects::EffectArrays;
use crate::error::ToPython;
use crate::interrupt::interruptible;

/// One step of a program: the angles by which the three motors turn (rad), the duration of the turn (s), and the
/// duration of the hold after the turn (s).
pub(crate) type StepTuple = ([f64; 3], f64, f64);

/// A simulated run with its true values.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Simulation {
    time_s: Py<PyArray1<f64>>,
    specific_force: Py<PyArray2<f64>>,
    angular_rate: Py<PyArray2<f64>>,
    temperature_degc: Py<PyArray1<f64>>,
    /// Motor angles from the encoders of the stand, rad; None without a stand.
    stand_rad: Option<Py<PyArray2<f64>>>,
    true_specific_force: Py<PyArray2<f64>>,
    true_angular_rate: Py<PyArray2<f64>>,
    true_angular_acceleration: Py<PyArray2<f64>>,
    rotation_wxyz: Py<PyArray2<f64>>,
    /// Start and end of each rest, s.
    rests: Vec<(f64, f64)>,
}

/// Inputs of a simulation, converted from the attributes of a Python object.
#[derive(FromPyObject)]
pub(crate) struct SetupArrays<'py> {
    motion: Motion,
    unit: UnitArrays<'py>,
    effects: Vec<EffectArrays<'py>>,
    rate_hz: f64,
    gravity_mps2: f64,
    temperature_time_s: PyReadonlyArray1<'py, f64>,
    temperature_degc: PyReadonlyArray1<'py, f64>,
    missing_share: f64,
    duplicated_share: f64,
    clock_rate_error: f64,
    clock_jitter_s: f64,
    added_force: Option<PyReadonlyArray2<'py, f64>>,
    added_rate: Option<PyReadonlyArray2<'py, f64>>,
    seed: u64,
    /// Number of threads. If it is None or the attribute is missing, all processors are used.
    #[pyo3(default)]
    threads: Option<NonZeroUsize>,
}

/// A motion of the unit, converted from a Python object. The first variant whose fields are all attributes of the
/// object is chosen.
#[derive(FromPyObject)]
pub(crate) enum Motion {
    Stand { steps: Vec<StepTuple>, stand: Stand },
    Tumble { poses: usize, hold_s: f64, move_s: f64, tremor_rad: f64, translation_m: f64, seed: u64 },
    Static { rotation_wxyz: [f64; 4], duration_s: f64 },
}

#[derive(FromPyObject)]
pub(crate) struct Stand {
    mount_rotation_rad: [f64; 3],
    base_tilt_rad: [f64; 2],
    non_orthogonality_rad: [f64; 2],
    flexure_rad: f64,
    vibration_rad: f64,
    vibration_m: f64,
    vibration_hz: f64,
    encoder_noise_rad: f64,
    encoder_counts: Option<u32>,
    tremor_rad: f64,
    tremor_seed: u64,
    slip_rad: [f64; 3],
    slip_time_s: f64,
}

#[derive(FromPyObject)]
pub(crate) struct UnitArrays<'py> {
    accelerometer: SensorArrays<'py>,
    gyroscope: SensorArrays<'py>,
}

#[derive(FromPyObject)]
struct SensorArrays<'py> {
    sensitivity: PyReadonlyArray2<'py, f64>,
    bias: PyReadonlyArray1<'py, f64>,
    noise_density: f64,
    noise_in_motion: f64,
    bias_instability: f64,
    random_walk: PyReadonlyArray1<'py, f64>,
    lsb: Option<f64>,
    bits: Option<u32>,
    filter_hz: Option<f64>,
    averaging: bool,
}

impl Motion {
    pub(crate) fn motion(self) -> Result<library::Motion, Error> {
        Ok(match self {
            Self::Stand { steps, stand } => library::Motion::Stand {
                program: Program::try_new(
                    steps.into_iter().map(|(turn_rad, move_s, hold_s)| Step { turn_rad, move_s, hold_s }).collect(),
                )?,
                stand: library::Stand {
                    mount_rotation_rad: stand.mount_rotation_rad.into(),
                    base_tilt_rad: stand.base_tilt_rad,
                    non_orthogonality_rad: stand.non_orthogonality_rad,
                    flexure_rad: stand.flexure_rad,
                    vibration_rad: stand.vibration_rad,
                    vibration_m: stand.vibration_m,
                    vibration_hz: stand.vibration_hz,
                    encoder_noise_rad: stand.encoder_noise_rad,
                    encoder_counts: stand.encoder_counts,
                    tremor: (stand.tremor_rad != 0.0).then(|| Tremor::random(stand.tremor_rad, stand.tremor_seed)),
                    slip: (stand.slip_rad != [0.0; 3])
                        .then_some(Slip { time_s: stand.slip_time_s, turn_rad: stand.slip_rad.into() }),
                },
            },
            Self::Tumble { poses, hold_s, move_s, tremor_rad, translation_m, seed } => library::Motion::Tumble(
                Tumble::random(&HandMoves { poses, hold_s, move_s, tremor_rad, translation_m }, seed)?,
            ),
            Self::Static { rotation_wxyz, duration_s } => library::Motion::Static {
                rotation_world_from_body: so3::from_wxyz(rotation_wxyz).ok_or_else(|| {
                    Error::Input(format!("rotation_wxyz is {rotation_wxyz:?}: a quaternion that is not zero is needed"))
                })?,
                duration_s,
            },
        })
    }
}

impl UnitArrays<'_> {
    /// The simulated unit: errors and noise of its two sensors, without effects.
    pub(crate) fn unit(&self, py: Python<'_>) -> PyResult<Unit> {
        Ok(Unit {
            accelerometer: self.accelerometer.sensor(py, "accelerometer")?,
            gyroscope: self.gyroscope.sensor(py, "gyroscope")?,
            effects: EffectSet::none(),
        })
    }
}

impl SensorArrays<'_> {
    fn sensor(&self, py: Python<'_>, name: &str) -> PyResult<Sensor> {
        let converter = match (self.lsb, self.bits) {
            (Some(lsb), Some(bits)) => Some(Converter { lsb, bits }),
            (None, None) => None,
            _ => {
                let message = format!("{name}: a converter needs both the size of a count (lsb) and its bits");
                return Err(Error::Input(message)).to_python(py);
            }
        };
        Ok(Sensor {
            sensitivity: matrix(py, &self.sensitivity, &format!("sensitivity of the {name}"))?,
            bias: vector(py, &self.bias, &format!("bias of the {name}"))?,
            noise_density: self.noise_density,
            noise_in_motion: self.noise_in_motion,
            bias_instability: self.bias_instability,
            random_walk: vector(py, &self.random_walk, &format!("random walk of the {name}"))?,
            low_pass: self.filter_hz.map(|bandwidth_hz| LowPass { bandwidth_hz }),
            averaging: self.averaging,
            converter,
        })
    }
}

pub(crate) fn steps(program: &Program) -> Vec<StepTuple> {
    program.steps().iter().map(|step| (step.turn_rad, step.move_s, step.hold_s)).collect()
}

/// Returns the steps of the grid program, whose rests form a grid in the angles of two motors.
#[pyfunction]
pub(crate) fn grid_program(py: Python<'_>, step_rad: f64, move_s: f64, hold_s: f64) -> PyResult<Vec<StepTuple>> {
    Ok(steps(&Program::grid(&Grid { step_rad, move_s, hold_s }).to_python(py)?))
}

/// Returns the steps of the random program, in which all three motors make random turns.
#[pyfunction]
pub(crate) fn random_program(
    py: Python<'_>,
    moves: usize,
    max_rate_radps: f64,
    move_s: f64,
    hold_s: f64,
    seed: u64,
) -> PyResult<Vec<StepTuple>> {
    let random = RandomMoves { moves, max_rate_radps, move_s, hold_s };
    Ok(steps(&Program::random(&random, seed).to_python(py)?))
}

/// Normal gravity, m/s^2, at a geodetic latitude, deg, and a height above the ellipsoid, m.
#[pyfunction]
pub(crate) fn gravity_mps2(latitude_deg: f64, height_m: f64) -> f64 {
    earth::gravity_mps2(latitude_deg.to_radians(), height_m)
}

/// Standard deviation of the difference between actual and normal gravity, m/s^2. For an unknown height, it includes
/// the uncertainty of the height.
#[pyfunction]
pub(crate) fn normal_gravity_sigma_mps2(height_is_known: bool) -> f64 {
    earth::normal_gravity_sigma_mps2(height_is_known)
}

/// Rotation rate of the Earth, rad/s, in the world frame (x north, y west, z up).
#[pyfunction]
pub(crate) fn earth_rate_radps(py: Python<'_>, latitude_deg: f64) -> Py<PyArray1<f64>> {
    PyArray1::from_slice(py, earth::rate_radps(latitude_deg.to_radians()).as_slice()).unbind()
}

/// Simulates a unit during a motion.
#[pyfunction]
pub(crate) fn simulate(py: Python<'_>, setup: SetupArrays<'_>) -> PyResult<Simulation> {
    let motion = setup.motion.motion().to_python(py)?;
    let unit = Unit { effects: EffectArrays::set(py, &setup.effects)?, ..setup.unit.unit(py)? };
    let temperature = Temperature::try_new(
        column(py, &setup.temperature_time_s, "temperature_time_s")?.to_vec(),
        column(py, &setup.temperature_degc, "temperature_degc")?.to_vec(),
    );
    let added = Added {
        force: setup.added_force.as_ref().map(|values| rows(py, values, "added_force")).transpose()?,
        rate: setup.added_rate.as_ref().map(|values| rows(py, values, "added_rate")).transpose()?,
    };
    let setup = Setup {
        motion: &motion,
        unit: &unit,
        rate_hz: setup.rate_hz,
        gravity_mps2: setup.gravity_mps2,
        temperature: &temperature.to_python(py)?,
        faults: Faults {
            missing_share: setup.missing_share,
            duplicated_share: setup.duplicated_share,
            clock_rate_error: setup.clock_rate_error,
            clock_jitter_s: setup.clock_jitter_s,
        },
        added: Some(added),
        seed: setup.seed,
        threads: setup.threads,
    };
    let run = interruptible(py, || library::run(&setup))?;
    Ok(Simulation {
        time_s: PyArray1::from_vec(py, run.time_s).unbind(),
        specific_force: to_rows(py, run.specific_force)?.unbind(),
        angular_rate: to_rows(py, run.angular_rate)?.unbind(),
        temperature_degc: PyArray1::from_vec(py, run.temperature_degc).unbind(),
        stand_rad: run.stand_rad.map(|values| Ok::<_, PyErr>(to_rows(py, values)?.unbind())).transpose()?,
        true_specific_force: to_rows(py, run.true_specific_force)?.unbind(),
        true_angular_rate: to_rows(py, run.true_angular_rate)?.unbind(),
        true_angular_acceleration: to_rows(py, run.true_angular_acceleration)?.unbind(),
        rotation_wxyz: to_rows(py, run.rotation_world_from_body)?.unbind(),
        rests: run.rests,
    })
}
