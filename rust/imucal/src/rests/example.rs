//! Simulates recordings for tests. Provides the true calibration of the simulated unit, and the model of the hand that
//! is estimated from a recording.

use imucal_core::sensor::Triad;

use super::segment::Segments;
use super::tremor::{Hand, Sensors};
use crate::recording::Recording;
use crate::simulate::motion::Motion;
use crate::simulate::{Faults, Setup, Simulation, Temperature, Unit, run};

/// Magnitude of gravity in the simulated recordings, m/s^2.
pub(super) const GRAVITY_MPS2: f64 = 9.81;

/// Simulates a recording of `unit` at 25 degC.
pub(super) fn simulated(motion: &Motion, unit: &Unit, rate_hz: f64, seed: u64) -> Simulation {
    let setup = Setup {
        motion,
        unit,
        rate_hz,
        gravity_mps2: GRAVITY_MPS2,
        temperature: &Temperature::constant(25.0),
        faults: Faults::none(),
        added: None,
        seed,
        threads: None,
    };
    run(&setup).unwrap()
}

/// The true calibration of the accelerometer and of the gyroscope of `unit`.
pub(super) fn triads(unit: &Unit) -> [Triad<f64>; 2] {
    let accelerometer = Triad::try_new(unit.accelerometer.sensitivity, unit.accelerometer.bias);
    let gyroscope = Triad::try_new(unit.gyroscope.sensitivity, unit.gyroscope.bias);
    [accelerometer.unwrap(), gyroscope.unwrap()]
}

/// Estimates the model of the hand from all rests of a recording of `unit`; `None` if the unit is not hand-held.
pub(super) fn hand(recording: &Recording<'_>, unit: &Unit) -> Option<Hand> {
    let segments = Segments::find(recording, 1.0).unwrap();
    let [accelerometer, gyroscope] = &triads(unit);
    Hand::of(recording, &segments.rests.iter().collect::<Vec<_>>(), Sensors { accelerometer, gyroscope })
}
