//! Simulated runs: a motion, a unit with all its errors, and the truth beside what it says.
//!
//! * [`program`]: what the motors of a stand are told to do; the paper's two programs, or any list of steps.
//! * [`profile`]: how they do it, in closed form, with limited jerk.
//! * [`gimbal`]: from three motor angles to the attitude.
//! * [`stand`]: what is wrong with the stand; [`tremor`] and [`slip`] of the unit on it; [`tumble`]: a run by hand; [`motion`]: any of
//!   these as a function of time.
//! * [`earth`]: gravity and the rate of the Earth at a place.
//! * [`mod@unit`]: sensitivity, bias, noise, filter and counts; the paper's unit. Its effects are those of the catalogue
//!   ([`imucal_core::effects`]), at the true state.
//! * [`temperature`] of the unit over the run, [`faults`] of the record.
//!
//! Motion and truth are exact functions of time: nothing is integrated, so truth does not depend on the sample rate. The same
//! setup gives the same bytes, on any number of threads.
//!
//! ```
//! use imucal::simulate::{Program, RandomMoves, Unit, simulate};
//!
//! let program = Program::random(&RandomMoves::default(), 7)?;
//! let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 7)?;
//! assert_eq!(run.time_s.len(), 32_000);
//! assert_eq!(run.rests.len(), 46);
//! # Ok::<(), imucal::error::Error>(())
//! ```

mod attitude;
mod block;
pub mod earth;
pub mod faults;
pub mod gimbal;
pub mod motion;
mod noise;
pub mod profile;
pub mod program;
pub mod sampling;
mod sensor;
pub mod slip;
pub mod stand;
mod stream;
pub mod temperature;
pub mod tremor;
mod truth;
pub mod tumble;
pub mod unit;

#[cfg(test)]
mod tests;

pub use faults::Faults;
pub use motion::{Moment, Motion};
pub use program::{Grid, Program, RandomMoves, Step};
pub use sampling::LowPass;
pub use slip::Slip;
pub use stand::Stand;
pub use temperature::Temperature;
pub use tremor::Tremor;
pub use tumble::{HandMoves, Tumble};
pub use unit::{Converter, Sensor, Unit};

use std::num::NonZeroUsize;

use crate::error::Error;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, RawUnit, Recording};
use block::Plan;
use faults::Clock;
use sensor::Sampler;
use stream::Triad;
use truth::Truth;

/// More samples than this do not fit into an ordinary computer's memory (192 bytes each).
const MAX_SAMPLES: f64 = 1e8;

/// All that a run depends on.
#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// How the unit moves.
    pub motion: &'a Motion,
    /// What moves.
    pub unit: &'a Unit,
    /// Samples per second of the unit's clock.
    pub rate_hz: f64,
    /// Local gravity, m/s^2.
    pub gravity_mps2: f64,
    /// Temperature of the unit.
    pub temperature: &'a Temperature,
    /// What is wrong with the record.
    pub faults: Faults,
    /// An effect that is not in the catalogue.
    pub added: Option<Added<'a>>,
    /// Of all random numbers but those of the motion.
    pub seed: u64,
    /// Threads to use; `None` is as many as there are processors. The result does not depend on it.
    pub threads: Option<NonZeroUsize>,
}

/// What is added to the true force and rate before the sensors see them: one row per sample of a run without losses.
#[derive(Clone, Copy, Debug)]
pub struct Added<'a> {
    /// Specific force, m/s^2.
    pub force: Option<&'a [[f64; 3]]>,
    /// Angular rate, rad/s.
    pub rate: Option<&'a [[f64; 3]]>,
}

/// A simulated run: what a recording has, and the truth beside it. One row per sample; true is at the true instant of the
/// sample, which only a fault of the clock tells from its stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulation {
    /// Time stamps, s: sample number / rate, from 0 up to but without the end of the motion.
    pub time_s: Vec<f64>,
    /// What the accelerometer says, m/s^2.
    pub specific_force: Vec<[f64; 3]>,
    /// What the gyroscope says, rad/s.
    pub angular_rate: Vec<[f64; 3]>,
    /// Temperature of the unit, degC.
    pub temperature_degc: Vec<f64>,
    /// What the encoders of the stand say, rad, outer motor first; `None` without a stand.
    pub stand_rad: Option<Vec<[f64; 3]>>,
    /// Specific force in the body frame, m/s^2.
    pub true_specific_force: Vec<[f64; 3]>,
    /// Angular rate in the body frame, rad/s.
    pub true_angular_rate: Vec<[f64; 3]>,
    /// Derivative of the angular rate in the body frame, rad/s^2.
    pub true_angular_acceleration: Vec<[f64; 3]>,
    /// Attitude `[w, x, y, z]`, `v_w = r_wb * v_b`.
    pub rotation_world_from_body: Vec<[f64; 4]>,
    /// Start and end of each rest, s, as the unit's clock shows them.
    pub rests: Vec<(f64, f64)>,
    /// How many samples were lost.
    pub missing: usize,
    /// How many samples repeat the one before.
    pub duplicated: usize,
}

impl Simulation {
    /// The columns that a real run would have.
    pub fn recording<'a>(&'a self, name: &'a str) -> Recording<'a> {
        Recording {
            name,
            time_s: &self.time_s,
            specific_force: (&self.specific_force).into(),
            angular_rate: (&self.angular_rate).into(),
            temperature_degc: Some(&self.temperature_degc),
            stand_rad: self.stand_rad.as_deref(),
            accel_unit: RawUnit::Si,
            gyro_unit: RawUnit::Si,
        }
    }

    /// Rows to be filled, with their stamps.
    fn blank(samples: usize, setup: &Setup, clock: &Clock) -> Self {
        let on_a_stand = matches!(setup.motion, Motion::Stand { .. });
        let rests = setup.motion.rests().into_iter();
        Self {
            time_s: (0..samples).map(|i| i as f64 / setup.rate_hz).collect(),
            specific_force: vec![[0.0; 3]; samples],
            angular_rate: vec![[0.0; 3]; samples],
            temperature_degc: vec![0.0; samples],
            stand_rad: on_a_stand.then(|| vec![[0.0; 3]; samples]),
            true_specific_force: vec![[0.0; 3]; samples],
            true_angular_rate: vec![[0.0; 3]; samples],
            true_angular_acceleration: vec![[0.0; 3]; samples],
            rotation_world_from_body: vec![[0.0; 4]; samples],
            rests: rests.map(|(start_s, end_s)| (clock.stamp_s(start_s), clock.stamp_s(end_s))).collect(),
            missing: 0,
            duplicated: 0,
        }
    }

    /// Repeats and loses samples.
    fn spoil(&mut self, faults: &Faults, seed: u64) {
        let samples = self.time_s.len();
        let count = |chosen: &[bool]| chosen.iter().filter(|chosen| **chosen).count();
        if let Some(duplicated) = faults.duplicated(samples, seed) {
            faults::duplicate(&mut self.specific_force, &duplicated);
            faults::duplicate(&mut self.angular_rate, &duplicated);
            self.duplicated = count(&duplicated);
        }
        if let Some(missing) = faults.missing(samples, seed) {
            faults::lose(&mut self.time_s, &missing);
            faults::lose(&mut self.temperature_degc, &missing);
            faults::lose(&mut self.rotation_world_from_body, &missing);
            let columns = [
                &mut self.specific_force,
                &mut self.angular_rate,
                &mut self.true_specific_force,
                &mut self.true_angular_rate,
                &mut self.true_angular_acceleration,
            ];
            for column in columns.into_iter().chain(&mut self.stand_rad) {
                faults::lose(column, &missing);
            }
            self.missing = count(&missing);
        }
    }
}

/// Runs a motion with a unit. The same setup gives the same bytes.
///
/// # Errors
/// [`Error::Input`] if a figure of the setup cannot be used, or the run has no or too many samples.
pub fn run(setup: &Setup) -> Result<Simulation, Error> {
    let Setup { motion, unit, rate_hz, gravity_mps2, temperature, seed, .. } = *setup;
    motion.check()?;
    setup.faults.check()?;
    if !(gravity_mps2.is_finite() && gravity_mps2 > 0.0) {
        return Err(Error::Input(format!("gravity_mps2 is {gravity_mps2}: a positive value is needed")));
    }
    let mut clock = Clock::new(&setup.faults, seed);
    let samples = sample_count(clock.stamp_s(motion.duration_s()), rate_hz)?;
    unit.accelerometer.check("accelerometer", rate_hz)?;
    unit.gyroscope.check("gyroscope", rate_hz)?;
    if let Some(added) = setup.added {
        check_rows("force", added.force, samples)?;
        check_rows("rate", added.rate, samples)?;
    }

    let steps = unit.accelerometer.steps(rate_hz).max(unit.gyroscope.steps(rate_hz));
    let sampler = |sensor, triad| Sampler::new(sensor, triad, rate_hz, samples, steps, seed);
    let mut accelerometer = sampler(&unit.accelerometer, Triad::Accelerometer);
    let mut gyroscope = sampler(&unit.gyroscope, Triad::Gyroscope);
    let plan = Plan {
        setup,
        truth: Truth::new(motion, unit, gravity_mps2, temperature),
        stand: if let Motion::Stand { stand, .. } = motion { Some(stand) } else { None },
        steps,
        threads: setup.threads.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get),
    };
    let mut run = Simulation::blank(samples, setup, &clock);
    block::fill(&plan, &mut run, [&mut accelerometer, &mut gyroscope], &mut clock);
    run.spoil(&setup.faults, seed);
    Ok(run)
}

/// Runs a program with a unit on a perfect stand, at the temperature of its calibration: the short form of [`run`].
///
/// # Errors
/// As [`run`].
pub fn simulate(
    program: &Program,
    unit: &Unit,
    rate_hz: f64,
    gravity_mps2: f64,
    seed: u64,
) -> Result<Simulation, Error> {
    run(&Setup {
        motion: &Motion::Stand { program: program.clone(), stand: Stand::perfect() },
        unit,
        rate_hz,
        gravity_mps2,
        temperature: &Temperature::constant(REFERENCE_TEMPERATURE_DEGC),
        faults: Faults::none(),
        added: None,
        seed,
        threads: None,
    })
}

fn check_rows(name: &str, rows: Option<&[[f64; 3]]>, samples: usize) -> Result<(), Error> {
    let Some(rows) = rows else { return Ok(()) };
    if rows.len() != samples {
        let given = rows.len();
        return Err(Error::Input(format!("{given} rows of {name} are added to a run of {samples} samples")));
    }
    if !rows.as_flattened().iter().all(|value| value.is_finite()) {
        return Err(Error::Input(format!("the {name} that is added has values that are not finite")));
    }
    Ok(())
}

/// How many samples lie in `[0, duration)`.
fn sample_count(duration_s: f64, rate_hz: f64) -> Result<usize, Error> {
    // The tolerance keeps a duration that is a sum of rounded times from gaining a sample.
    let samples = (duration_s * rate_hz - 1e-6).ceil();
    if rate_hz.is_finite() && rate_hz > 0.0 && (1.0..=MAX_SAMPLES).contains(&samples) {
        return Ok(samples as usize);
    }
    Err(Error::Input(format!(
        "rate_hz is {rate_hz} and the program lasts {duration_s} s: this needs to give from 1 to {MAX_SAMPLES:.0} samples"
    )))
}
