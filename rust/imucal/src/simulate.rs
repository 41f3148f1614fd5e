//! A unit on the stand: the motion, what the unit undergoes, and what it says about it.
//!
//! * [`program`]: what the motors are told to do; the paper's two programs, or any list of steps.
//! * [`profile`]: how they do it, in closed form, with limited jerk.
//! * [`gimbal`]: from three motor angles to the attitude.
//! * [`stand`]: what is wrong with the stand; [`tumble`]: a run by hand; [`motion`]: any of these as a function of time.
//! * [`earth`]: gravity and the rate of the Earth at a place.
//! * [`mod@unit`]: sensitivity, bias, noise and counts; the paper's unit.
//!
//! Motion and truth are exact functions of time: nothing is integrated, so truth does not depend on the sample rate.
//! Sampling and noise are those of the `sensor` room: point samples, `sigma = noise_density * sqrt(rate_hz)`.
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
pub mod earth;
pub mod gimbal;
pub mod motion;
pub mod profile;
pub mod program;
mod sensor;
pub mod stand;
mod stream;
pub mod tumble;
pub mod unit;

pub use motion::{Moment, Motion};
pub use program::{Grid, Program, RandomMoves, Step};
pub use stand::Stand;
pub use tumble::{HandMoves, Tumble};
pub use unit::{Converter, Sensor, Unit};

use crate::error::Error;
use crate::recording::{RawUnit, Recording};
use nalgebra::Vector3;
use sensor::Sampler;
use stream::Stream;

/// More samples than this do not fit into an ordinary computer's memory (128 bytes each).
const MAX_SAMPLES: f64 = 1e8;

/// A simulated run: what a recording has, and the truth beside it. One row per sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulation {
    /// Time, s: sample number / rate, from 0 up to but without the program's end.
    pub time_s: Vec<f64>,
    /// What the accelerometer says, m/s^2.
    pub specific_force: Vec<[f64; 3]>,
    /// What the gyroscope says, rad/s.
    pub angular_rate: Vec<[f64; 3]>,
    /// Specific force in the body frame, m/s^2.
    pub true_specific_force: Vec<[f64; 3]>,
    /// Angular rate in the body frame, rad/s.
    pub true_angular_rate: Vec<[f64; 3]>,
    /// Motor angles, rad; outer motor first. [`gimbal::rotation_world_from_body`] gives the attitude.
    pub stand_rad: Vec<[f64; 3]>,
    /// Start and end of each rest, s.
    pub rests: Vec<(f64, f64)>,
}

impl Simulation {
    /// The columns that a real run would have.
    pub fn recording<'a>(&'a self, name: &'a str) -> Recording<'a> {
        Recording {
            name,
            time_s: &self.time_s,
            specific_force: &self.specific_force,
            angular_rate: &self.angular_rate,
            temperature_degc: None,
            stand_rad: Some(&self.stand_rad),
            accel_unit: RawUnit::Si,
            gyro_unit: RawUnit::Si,
        }
    }
}

/// Runs a program with a unit on the stand. The same arguments give the same bytes.
///
/// # Errors
/// [`Error::Input`] if the rate, gravity or a figure of the unit cannot be used, or the run has no or too many samples.
pub fn simulate(
    program: &Program,
    unit: &Unit,
    rate_hz: f64,
    gravity_mps2: f64,
    seed: u64,
) -> Result<Simulation, Error> {
    unit.accelerometer.check("accelerometer")?;
    unit.gyroscope.check("gyroscope")?;
    if !(gravity_mps2.is_finite() && gravity_mps2 > 0.0) {
        return Err(Error::Input(format!("gravity_mps2 is {gravity_mps2}: a positive value is needed")));
    }
    let samples = sample_count(program.duration_s(), rate_hz)?;

    let mut accelerometer = Sampler::new(
        &unit.accelerometer,
        rate_hz,
        [0, 1, 2].map(|axis| Stream::AccelerometerNoise(axis).generator(seed)),
    );
    let mut gyroscope =
        Sampler::new(&unit.gyroscope, rate_hz, [0, 1, 2].map(|axis| Stream::GyroscopeNoise(axis).generator(seed)));
    let mut run = Simulation {
        time_s: Vec::with_capacity(samples),
        specific_force: Vec::with_capacity(samples),
        angular_rate: Vec::with_capacity(samples),
        true_specific_force: Vec::with_capacity(samples),
        true_angular_rate: Vec::with_capacity(samples),
        stand_rad: Vec::with_capacity(samples),
        rests: program.rests(),
    };
    let motion = Motion::Stand { program: program.clone(), stand: Stand::perfect() };
    motion.check()?;
    let mut moment = motion.at(0.0);
    let mut still_until = motion.still_until(0.0);
    for i in 0..samples {
        let time_s = i as f64 / rate_hz;
        // Most of a program is rest, where nothing changes.
        if still_until.is_none_or(|until_s| time_s > until_s) {
            moment = motion.at(time_s);
            still_until = motion.still_until(time_s);
        }
        let force = moment.rotation_world_from_body.inverse_transform_vector(&(Vector3::z() * gravity_mps2));
        run.time_s.push(time_s);
        run.specific_force.push(accelerometer.measure(&force));
        run.angular_rate.push(gyroscope.measure(&moment.angular_rate));
        run.true_specific_force.push(force.into());
        run.true_angular_rate.push(moment.angular_rate.into());
        run.stand_rad.push(moment.stand.map_or([0.0; 3], |stand| stand.angle_rad.into()));
    }
    Ok(run)
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

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    const GRAVITY_MPS2: f64 = 9.80665;

    fn random_run(unit: &Unit, rate_hz: f64, seed: u64) -> Simulation {
        let program = Program::random(&RandomMoves::default(), 1).unwrap();
        simulate(&program, unit, rate_hz, GRAVITY_MPS2, seed).unwrap()
    }

    /// Mean and standard deviation of (measured - ideal) per axis.
    fn error_statistics(measured: &[[f64; 3]], ideal: impl Fn(usize) -> Vector3<f64>) -> [(f64, f64); 3] {
        [0, 1, 2].map(|axis| {
            let errors: Vec<f64> = (0..measured.len()).map(|i| measured[i][axis] - ideal(i)[axis]).collect();
            let n = errors.len() as f64;
            let mean = errors.iter().sum::<f64>() / n;
            let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / n;
            (mean, variance.sqrt())
        })
    }

    #[test]
    fn an_ideal_unit_says_the_truth() {
        let run = random_run(&Unit::ideal(), 100.0, 1);
        assert_eq!(run.specific_force, run.true_specific_force);
        assert_eq!(run.angular_rate, run.true_angular_rate);
        for force in &run.true_specific_force {
            assert!((Vector3::from(*force).norm() - GRAVITY_MPS2).abs() < 1e-13);
        }
        assert_eq!(run.recording("run").len(), 32_000);
    }

    /// Midpoint steps have an error of second order: it must be small, and a quarter at twice the rate.
    #[test]
    fn integrating_the_true_rate_gives_the_attitude() {
        let error_rad = |rate_hz: f64| {
            let program = Program::random(&RandomMoves { moves: 5, ..RandomMoves::default() }, 2).unwrap();
            // Twice the rate, so that every second sample is the midpoint of a step.
            let run = simulate(&program, &Unit::ideal(), 2.0 * rate_hz, GRAVITY_MPS2, 0).unwrap();
            let mut attitude = UnitQuaternion::identity();
            let mut worst = 0.0_f64;
            for i in (0..run.time_s.len() - 2).step_by(2) {
                attitude *= UnitQuaternion::from_scaled_axis(Vector3::from(run.true_angular_rate[i + 1]) / rate_hz);
                let truth = gimbal::rotation_world_from_body(&run.stand_rad[i + 2].into());
                worst = worst.max(attitude.angle_to(&truth));
            }
            worst
        };
        let (coarse, fine) = (error_rad(1000.0), error_rad(2000.0));
        assert!(fine < 1e-5, "{fine} rad");
        assert!((coarse / fine - 4.0).abs() < 0.1, "{coarse} rad, {fine} rad");
    }

    #[test]
    fn measured_is_sensitivity_times_true_plus_bias_plus_noise_of_the_stated_size() {
        let mut unit = Unit::paper();
        unit.accelerometer.converter = None;
        unit.gyroscope.converter = None;
        for rate_hz in [100.0, 400.0] {
            let run = random_run(&unit, rate_hz, 5);
            let n = run.time_s.len() as f64;
            for (sensor, measured, truth) in [
                (&unit.accelerometer, &run.specific_force, &run.true_specific_force),
                (&unit.gyroscope, &run.angular_rate, &run.true_angular_rate),
            ] {
                let std = sensor.noise_density * rate_hz.sqrt();
                let ideal = |i: usize| sensor.sensitivity * Vector3::from(truth[i]) + sensor.bias;
                for (mean, found) in error_statistics(measured, ideal) {
                    assert!((found / std - 1.0).abs() < 5.0 / (2.0 * n).sqrt(), "{found}, not {std}");
                    assert!(mean.abs() < 5.0 * std / n.sqrt());
                }
            }
        }
    }

    #[test]
    fn noise_is_white_and_differs_between_channels() {
        let mut unit = Unit::ideal();
        unit.accelerometer.noise_density = 1.0;
        unit.gyroscope.noise_density = 1.0;
        let program = Program::try_new(vec![Step::hold(1000.0)]).unwrap();
        let run = simulate(&program, &unit, 100.0, GRAVITY_MPS2, 9).unwrap();
        let n = run.time_s.len();
        let channel = |c: usize| -> Vec<f64> {
            match c {
                0..=2 => (0..n).map(|i| run.specific_force[i][c] - run.true_specific_force[i][c]).collect(),
                _ => (0..n).map(|i| run.angular_rate[i][c - 3]).collect(),
            }
        };
        let channels: Vec<Vec<f64>> = (0..6).map(channel).collect();
        let correlation = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / (100.0 * n as f64);
        let bound = 5.0 / (n as f64).sqrt();
        for a in 0..6 {
            assert!(correlation(&channels[a], &channels[a][1..]).abs() < bound, "channel {a}");
            for b in 0..a {
                assert!(correlation(&channels[a], &channels[b]).abs() < bound, "channels {a} and {b}");
            }
        }
    }

    #[test]
    fn same_seed_same_bytes() {
        let run = random_run(&Unit::paper(), 100.0, 11);
        assert_eq!(run, random_run(&Unit::paper(), 100.0, 11));
        assert_ne!(run.angular_rate, random_run(&Unit::paper(), 100.0, 12).angular_rate);
        // A channel's noise does not depend on the other sensor's.
        let mut quiet = Unit::paper();
        quiet.accelerometer = Sensor::ideal();
        assert_eq!(run.angular_rate, random_run(&quiet, 100.0, 11).angular_rate);
    }

    #[test]
    fn counts_are_whole_and_the_papers_run_does_not_clip() {
        let unit = Unit::paper();
        let run = random_run(&unit, 100.0, 3);
        for (sensor, measured) in [(unit.accelerometer, &run.specific_force), (unit.gyroscope, &run.angular_rate)] {
            let converter = sensor.converter.unwrap();
            let rail = 2_f64.powi(converter.bits as i32 - 1) - 1.0;
            for value in measured.as_flattened() {
                let counts = value / converter.lsb;
                assert!((counts - counts.round()).abs() < 1e-9);
                assert!(counts.abs() < rail);
            }
        }
    }

    #[test]
    fn arguments_that_cannot_be_used_are_refused() {
        let program = Program::try_new(vec![Step::hold(1.0)]).unwrap();
        for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9, 1e12] {
            assert!(simulate(&program, &Unit::ideal(), rate_hz, GRAVITY_MPS2, 0).is_err(), "{rate_hz} Hz");
        }
        for gravity_mps2 in [0.0, -9.8, f64::NAN] {
            assert!(simulate(&program, &Unit::ideal(), 100.0, gravity_mps2, 0).is_err(), "{gravity_mps2} m/s^2");
        }
    }
}
