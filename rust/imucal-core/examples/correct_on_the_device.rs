//! Corrects each raw sample and integrates the corrected angular rate to a rotation, in f32 and without an allocator,
//! as firmware on a device does.
//!
//! `cargo run --release -p imucal-core --example correct_on_the_device`

use imucal_core::calibration::Calibration;
use imucal_core::integrate::Integrator;
use imucal_core::sensor::{SensorError, Triad};
use nalgebra::{Matrix3, Vector3};

/// The parameters of one unit, as in its calibration file.
fn calibration() -> Result<Calibration<f32>, SensorError> {
    Ok(Calibration::new(
        Triad::try_new(
            Matrix3::new(0.9804, 0.0012, 0.0055, 0.0012, 0.9727, 0.0043, 0.0055, 0.0043, 0.9921),
            Vector3::new(-0.4187, 0.2363, 0.3942),
        )?,
        Triad::try_new(
            Matrix3::new(0.9771, 0.0097, -0.0060, -0.0084, 1.0309, -0.0031, 0.0087, 0.0036, 1.0030),
            Vector3::new(-0.0350, 0.0042, 0.0010),
        )?,
    ))
}

fn main() -> Result<(), SensorError> {
    let calibration = calibration()?;
    // The raw samples that this unit measures during a rotation by 90 deg about z in one second at 100 Hz.
    let true_rate = Vector3::new(0.0, 0.0, core::f32::consts::FRAC_PI_2);
    let raw_rate = calibration.gyroscope.measure(true_rate);
    let raw_force = calibration.accelerometer.measure(Vector3::new(0.0, 0.0, 9.80665));

    let mut turn = Integrator::new();
    let mut force = Vector3::zeros();
    for _ in 0..=100 {
        let (rate, corrected) = calibration.correct(raw_rate, raw_force);
        turn.push(0.01, rate);
        force = corrected;
    }
    println!("raw rate {:.4} {:.4} {:.4} rad/s", raw_rate.x, raw_rate.y, raw_rate.z);
    println!("turned by {:.3} deg", turn.rotation().angle().to_degrees());
    println!("specific force {:.4} {:.4} {:.4} m/s^2", force.x, force.y, force.z);
    Ok(())
}
