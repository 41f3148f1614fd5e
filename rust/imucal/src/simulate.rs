//! Simulation of calibration runs: the samples that a unit with sensor errors measures during a motion, and the true
//! values of force and rate.
//!
//! * [`program`]: the commands to the motors of a stand, either one of the two programs of the paper cited in
//!   `docs/model.md` or any list of steps.
//! * [`profile`]: the motion of the motors in closed form, with limited jerk.
//! * [`gimbal`]: the attitude as a function of the three motor angles.
//! * [`stand`]: errors of the stand. [`tremor`] and [`slip`]: motions of the unit relative to the stand. [`tumble`]: a
//!   hand-held run. [`motion`]: the resulting motion as a function of time.
//! * [`earth`]: gravity and the rate of the Earth at a location.
//! * [`mod@unit`]: sensitivity, bias, noise, filter and converter of the sensors, and the unit of the paper cited in
//!   `docs/model.md`. Errors that a sensitivity and a bias do not describe are called effects. They are from the
//!   catalogue in [`imucal_core::effects`] and are evaluated at the true state.
//! * [`temperature`]: the temperature of the unit over the run. [`faults`]: clock errors and lost or repeated samples.
//!
//! Motion and true values are closed-form functions of time, without numerical integration. The true values therefore
//! do not depend on the sampling rate. The same setup always gives the same run, bit for bit, on any number of threads.
//!
//! ```
//! use imucal::simulate::{Program, RandomMoves, Unit, simulate};
//!
//! let (rate_hz, gravity_mps2, seed) = (100.0, 9.80665, 7);
//! let program = Program::random(&RandomMoves::default(), seed)?;
//! let run = simulate(&program, &Unit::paper(), rate_hz, gravity_mps2, seed)?;
//! assert_eq!(run.time_s.len(), 32_000);
//! assert_eq!(run.rests.len(), 46);
//! # Ok::<(), imucal::error::Error>(())
//! ```

mod attitude;
mod block;
pub mod earth;
pub mod faults;
pub mod gimbal;
mod moment;
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
pub use moment::Moment;
pub use motion::Motion;
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

/// Maximum number of samples in a run. A run of this length takes 19 GB of memory (192 bytes per sample), which is
/// about the memory of an ordinary PC.
const MAX_SAMPLES: f64 = 1e8;

/// All inputs of a simulated run.
#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// Motion of the unit.
    pub motion: &'a Motion,
    /// The unit: its sensors and their errors.
    pub unit: &'a Unit,
    /// Sampling rate, Hz: samples per second of the unit's clock.
    pub rate_hz: f64,
    /// Local gravity, m/s^2.
    pub gravity_mps2: f64,
    /// Temperature of the unit over the run.
    pub temperature: &'a Temperature,
    /// Faults of the recording, such as lost samples.
    pub faults: Faults,
    /// Additional errors of force and rate given by the user, for example an effect that is not in the catalogue of
    /// effects; `None` for no additional errors.
    pub added: Option<Added<'a>>,
    /// Seed of all random numbers, except those of the motion.
    pub seed: u64,
    /// Number of threads; `None` uses all processors. The result does not depend on the number of threads.
    pub threads: Option<NonZeroUsize>,
}

/// Errors that are added to the true force and rate at the input of the sensors. Each array has one row per simulated
/// sample, including the samples that [`Setup::faults`] then removes from the recording.
#[derive(Clone, Copy, Debug)]
pub struct Added<'a> {
    /// Error of the specific force, m/s^2; `None` for no error.
    pub force: Option<&'a [[f64; 3]]>,
    /// Error of the angular rate, rad/s; `None` for no error.
    pub rate: Option<&'a [[f64; 3]]>,
}

/// A simulated run: the columns of a recording, and the true values. All columns have one row per sample. True values
/// refer to the true instant of the sample, which equals the time stamp unless the clock has a fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulation {
    /// Time stamps, s: the sample number divided by the sampling rate. The first time stamp is 0, and the last is
    /// before the end of the motion.
    pub time_s: Vec<f64>,
    /// Measured specific force, m/s^2.
    pub specific_force: Vec<[f64; 3]>,
    /// Measured angular rate, rad/s.
    pub angular_rate: Vec<[f64; 3]>,
    /// Temperature of the unit, degC.
    pub temperature_degc: Vec<f64>,
    /// Motor angles read by the encoders of the stand, rad, outermost motor first; `None` without a stand.
    pub stand_rad: Option<Vec<[f64; 3]>>,
    /// True specific force in the body frame, m/s^2.
    pub true_specific_force: Vec<[f64; 3]>,
    /// True angular rate in the body frame, rad/s.
    pub true_angular_rate: Vec<[f64; 3]>,
    /// True derivative of the angular rate in the body frame, rad/s^2.
    pub true_angular_acceleration: Vec<[f64; 3]>,
    /// True attitude as a unit quaternion `[w, x, y, z]`: the rotation from the body frame to the world frame.
    pub rotation_world_from_body: Vec<[f64; 4]>,
    /// Start and end of each rest as time stamps of the unit's clock, s.
    pub rests: Vec<(f64, f64)>,
    /// Number of lost samples.
    pub missing: usize,
    /// Number of samples that repeat the previous sample, including repeated samples that were then lost.
    pub duplicated: usize,
}

impl Simulation {
    /// The simulated measurements as a recording.
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
            column_units: [None; 2],
        }
    }

    /// Creates a run in which only the time stamps and rests are set. All other columns are zero until [`block::fill`]
    /// computes their values.
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

    /// Simulates repeated and lost samples. The measured force and rate of a repeated sample are overwritten by those
    /// of the previous sample. The rows of lost samples are removed from all columns.
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

/// Simulates a run. The same setup always gives the same run, bit for bit.
///
/// # Errors
/// [`Error::Input`] if a value of the setup is invalid, or if the run has no samples or too many.
pub fn run(setup: &Setup) -> Result<Simulation, Error> {
    let Setup { motion, unit, rate_hz, gravity_mps2, temperature, seed, .. } = *setup;
    motion.check()?;
    setup.faults.check()?;
    if !(gravity_mps2.is_finite() && gravity_mps2 > 0.0) {
        return Err(Error::Input(format!("gravity_mps2 is {gravity_mps2}: give a positive value")));
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

/// Simulates a program on a stand without errors, at the reference temperature of the calibration. This function is a
/// short form of [`run`].
///
/// # Errors
/// The errors are those of [`run`].
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
        return Err(Error::Input(format!(
            "added {name} has {given} rows, but the run has {samples} samples: give one row per sample"
        )));
    }
    if !rows.as_flattened().iter().all(|value| value.is_finite()) {
        return Err(Error::Input(format!("added {name} has values that are not finite")));
    }
    Ok(())
}

/// Number of samples with time stamps from 0 to before `duration_s`.
fn sample_count(duration_s: f64, rate_hz: f64) -> Result<usize, Error> {
    // Rounding errors can make `duration_s * rate_hz` slightly larger than an integer. The tolerance of 1e-6 samples
    // prevents an additional sample in this case.
    let samples = (duration_s * rate_hz - 1e-6).ceil();
    if rate_hz.is_finite() && rate_hz > 0.0 && (1.0..=MAX_SAMPLES).contains(&samples) {
        return Ok(samples as usize);
    }
    Err(Error::Input(format!(
        "rate_hz is {rate_hz} and the program lasts {duration_s} s: together they must give 1 to {MAX_SAMPLES:.0} samples"
    )))
}
