//! The simulator for Python.

use imucal::error::Error;
use imucal::simulate::{self as library, Grid, Program, RandomMoves, Step, Unit};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::to_rows;
use crate::error::ToPython;

/// Turn of the three motors in rad, duration of the turn and of the hold after it in s.
type StepTuple = ([f64; 3], f64, f64);

/// A simulated run and the truth beside it.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Simulation {
    time_s: Py<PyArray1<f64>>,
    specific_force: Py<PyArray2<f64>>,
    angular_rate: Py<PyArray2<f64>>,
    true_specific_force: Py<PyArray2<f64>>,
    true_angular_rate: Py<PyArray2<f64>>,
    stand_rad: Py<PyArray2<f64>>,
    /// Start and end of each rest, s.
    rests: Vec<(f64, f64)>,
    accel_sensitivity: Py<PyArray2<f64>>,
    accel_bias: Py<PyArray1<f64>>,
    gyro_sensitivity: Py<PyArray2<f64>>,
    gyro_bias: Py<PyArray1<f64>>,
}

fn steps(program: &Program) -> Vec<StepTuple> {
    program.steps().iter().map(|step| (step.turn_rad, step.move_s, step.hold_s)).collect()
}

/// Steps of the grid program: rests on a grid of two motors.
#[pyfunction]
pub(crate) fn grid_program(py: Python<'_>, step_rad: f64, move_s: f64, hold_s: f64) -> PyResult<Vec<StepTuple>> {
    Ok(steps(&Program::grid(&Grid { step_rad, move_s, hold_s }).to_python(py)?))
}

/// Steps of the random program: turns of all three motors at random speeds.
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

/// Runs a program with a unit (`paper` or `ideal`) on the stand.
#[pyfunction]
pub(crate) fn simulate(
    py: Python<'_>,
    program: Vec<StepTuple>,
    unit: &str,
    rate_hz: f64,
    gravity_mps2: f64,
    seed: u64,
) -> PyResult<Simulation> {
    let unit = match unit {
        "paper" => Unit::paper(),
        "ideal" => Unit::ideal(),
        other => return Err(Error::Input(format!("unit is {other:?}: give paper or ideal"))).to_python(py),
    };
    let steps = program.into_iter().map(|(turn_rad, move_s, hold_s)| Step { turn_rad, move_s, hold_s }).collect();
    let run =
        py.detach(|| library::simulate(&Program::try_new(steps)?, &unit, rate_hz, gravity_mps2, seed)).to_python(py)?;
    let matrix = |m: nalgebra::Matrix3<f64>| Ok::<_, PyErr>(to_rows(py, m.transpose().data.0.to_vec())?.unbind());
    let vector = |v: nalgebra::Vector3<f64>| PyArray1::from_slice(py, v.as_slice()).unbind();
    Ok(Simulation {
        time_s: PyArray1::from_vec(py, run.time_s).unbind(),
        specific_force: to_rows(py, run.specific_force)?.unbind(),
        angular_rate: to_rows(py, run.angular_rate)?.unbind(),
        true_specific_force: to_rows(py, run.true_specific_force)?.unbind(),
        true_angular_rate: to_rows(py, run.true_angular_rate)?.unbind(),
        stand_rad: to_rows(py, run.stand_rad)?.unbind(),
        rests: run.rests,
        accel_sensitivity: matrix(unit.accelerometer.sensitivity)?,
        accel_bias: vector(unit.accelerometer.bias),
        gyro_sensitivity: matrix(unit.gyroscope.sensitivity)?,
        gyro_bias: vector(unit.gyroscope.bias),
    })
}
